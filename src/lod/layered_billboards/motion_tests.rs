//! How layered billboards move: in the wind, towards a viewer, and the wood that goes with them.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3, Vec3, Vec4};

use super::frame::Frame;
use super::pose::{Joint, Motion, facing, poses, slopes, swing};
use super::tests::{FRONT, build, params, tree};
use super::{Grouping, Params, Turn, WoodAs};
use crate::draw_list::Blend;
use crate::job::Job;
use crate::lod::full_mesh::FullMesh;
use crate::lod::made::{
    Leaf, crown_at, emit, facing as square, from_azimuth, perspective, plant_at, random_crown,
};
use crate::lod::wind::{Gust, Wind};
use crate::lod::wood::Wood;
use crate::lod::{Crown, Representation};
use crate::plant::{Branch, Structure};
use crate::texture::Filter;

fn joint(parent: Option<usize>, anchor: DVec3, level: u32) -> Joint {
    Joint { parent, anchor, level, lag: 0.0 }
}

#[test]
fn a_child_goes_where_its_parent_puts_it() {
    // slope 3/4: cosine 4/5, sine 3/5; twice that angle: 7/25 and 24/25
    let joints = [joint(None, DVec3::ZERO, 0), joint(Some(0), DVec3::Y * 2.0, 1)];
    let turned = poses(&joints, &[0.75, 0.75], &FRONT, Motion::Rotate);
    let near = |a: DVec3, b: DVec3| a.distance(b) < 1e-12;
    let [trunk, limb] = [turned[0], turned[1]];
    assert!(near(trunk.transform_point3(DVec3::ZERO), DVec3::ZERO), "the base stays");
    let joint_at = DVec3::new(1.2, 1.6, 0.0);
    assert!(near(trunk.transform_point3(DVec3::Y * 2.0), joint_at), "where the limb hangs");
    assert!(near(limb.transform_point3(DVec3::Y * 2.0), joint_at), "and hangs on");
    let tip = limb.transform_point3(DVec3::new(0.0, 3.0, 5.0));
    assert!(near(tip, joint_at + DVec3::new(0.96, 0.28, 5.0)), "turned twice, in its plane: {tip}");
    let expected =
        DMat3::from_cols(DVec3::new(0.28, -0.96, 0.0), DVec3::new(0.96, 0.28, 0.0), DVec3::Z);
    assert!(limb.matrix3.abs_diff_eq(expected, 1e-12), "{}", limb.matrix3);
    let sheared = poses(&joints, &[0.75, 0.5], &FRONT, Motion::Shear);
    assert_eq!(sheared[0].transform_point3(DVec3::new(1.0, 4.0, 7.0)), DVec3::new(4.0, 4.0, 7.0));
    // at its anchor 2 * 0.75, then a metre above it 0.75 of the trunk's and 0.5 of its own
    assert_eq!(sheared[1].transform_point3(DVec3::Y * 3.0), DVec3::new(2.75, 3.0, 0.0), "both");
}

#[test]
fn without_wind_nothing_moves_by_a_bit() {
    let frame = Frame::new(DVec3::new(0.3, 0.2, 0.9)).expect("valid");
    let joints = [
        joint(None, DVec3::new(0.1, 0.2, 0.3), 0),
        joint(Some(0), DVec3::new(1.1, 7.2, -0.3), 1),
        joint(Some(1), DVec3::new(1e6, 1e-6, 0.7), 2),
    ];
    for motion in [Motion::Rotate, Motion::Shear] {
        let still = poses(&joints, &[0.0; 3], &frame, motion);
        assert_eq!(still, [DAffine3::IDENTITY; 3], "{motion:?}");
    }
}

fn wind(lean: f64, sway: f64) -> Wind {
    Wind { lean, sway, period_secs: 2.0, toward: None, seed: 5 }
}

#[test]
fn tips_swing_farther_than_the_trunk() {
    let joints = [
        joint(None, DVec3::ZERO, 0),
        joint(Some(0), DVec3::Y, 1),
        joint(Some(1), DVec3::Y * 2.0, 2),
    ];
    let mut most = [0.0_f64; 3];
    let mut moved = [0.0_f64; 3];
    for step in 0..200 {
        let gust = Gust { wind: wind(0.0, 0.1), time_secs: f64::from(step) * 0.01, key: (0, 0) };
        let found = slopes(&joints, &gust, 1.5);
        let posed = poses(&joints, &found, &FRONT, Motion::Rotate);
        for layer in 0..3 {
            most[layer] = most[layer].max(found[layer].abs());
            let tip = joints[layer].anchor + DVec3::Y;
            moved[layer] = moved[layer].max(posed[layer].transform_point3(tip).distance(tip));
        }
        assert_eq!(posed[0].transform_point3(DVec3::ZERO), DVec3::ZERO, "the base stays");
    }
    for (layer, expected) in [0.1, 0.15, 0.225].into_iter().enumerate() {
        // the farthest of 200 times is within a hundredth of a swing of the end
        assert!(most[layer] <= expected && most[layer] > 0.999 * expected, "{layer}: {most:?}");
    }
    assert!(moved[0] < moved[1] && moved[1] < moved[2], "{moved:?}");
    let lean = Gust { wind: wind(0.2, 0.0), time_secs: 3.0, key: (0, 0) };
    assert_eq!(slopes(&joints, &lean, 1.5), [0.2, 0.0, 0.0], "a lean is the trunk's alone");
}

#[test]
fn no_layer_is_moved_beyond_its_reach() {
    for (motion, at_least) in [(Motion::Rotate, 5.0), (Motion::Shear, 9.0)] {
        let lod = build(&tree(), &Params { motion, growth: 1.0, ..params(4, 32) });
        // all lean the same way at once, as far as a wind whose reach is 1 may lean them
        let places = poses(&lod.joints, &[1.0; 4], &lod.frame, motion);
        let moved = lod.cards.all().iter().flat_map(|card| {
            card.corners.map(|corner| places[card.layer].transform_point3(corner).distance(corner))
        });
        let most = moved.fold(0.0, f64::max);
        let reach = lod.sway_reach();
        assert!(at_least < most && most <= reach, "{motion:?}: {most} of {reach}");
    }
}

#[test]
fn long_chains_of_layers_stay_finite() {
    let count = 2000_u32;
    let frame = Frame::new(DVec3::new(0.3, 0.2, 0.9)).expect("valid");
    let joints: Vec<Joint> = (0..count)
        .map(|level| {
            let parent = level.checked_sub(1).map(|parent| parent as usize);
            joint(parent, DVec3::new(0.3, 1.0, 0.2) * f64::from(level) * 0.01, level)
        })
        .collect();
    let gust = Gust { wind: wind(0.0, 1.0), time_secs: 0.3, key: (0, 0) };
    let slopes = slopes(&joints, &gust, 10.0);
    assert!(slopes.iter().all(|slope| slope.abs() <= 1e3), "none beyond the largest");
    assert!(slopes.iter().any(|slope| slope.abs() > 500.0), "though some swing far");
    for motion in [Motion::Rotate, Motion::Shear] {
        let poses = poses(&joints, &slopes, &frame, motion);
        assert!(poses.iter().all(DAffine3::is_finite), "{motion:?}");
    }
    let factors = [(10.0, 0), (10.0, 2), (10.0, 3), (10.0, 400), (0.0, 0), (0.0, 1), (0.5, 2)]
        .map(|(growth, level)| swing(growth, level));
    assert_eq!(factors, [1.0, 100.0, 1e3, 1e3, 1.0, 0.0, 0.25], "by hand");
}

#[test]
fn the_reach_of_a_long_chain_is_finite() {
    // a branch on a branch, and so on
    let count = 400_u16;
    let at = |level: u16| Vec3::Y * f32::from(level);
    let leaves: Vec<Leaf> = (0..count).map(|i| square(0.0, f32::from(i), 0.0, 0.5)).collect();
    let mut plant = plant_at(DVec3::ZERO, &[], &leaves);
    let branch = |level: u16| Branch {
        parent: level.checked_sub(1).map(u32::from),
        level: 0,
        start: at(level),
        end: at(level + 1),
        radius: 0.1,
        wood_triangles: 0..0,
        leaves: u32::from(level)..u32::from(level) + 1,
    };
    plant.structure = Some(Arc::new(Structure {
        branches: (0..count).map(branch).collect(),
        leaf_branches: (0..u32::from(count)).collect(),
    }));
    let with = Params { growth: 10.0, ..params(usize::from(count), 64) };
    let lod = build(&plant, &with);
    let deepest = lod.joints.iter().map(|joint| joint.level).max().expect("many");
    assert!(deepest > 308, "ten to that is infinite: {deepest}");
    assert!(lod.sway_reach().is_finite(), "{}", lod.sway_reach());
}

#[test]
fn copies_and_layers_have_phases_of_their_own() {
    let joints =
        [joint(None, DVec3::ZERO, 0), joint(Some(0), DVec3::Y, 1), joint(Some(0), DVec3::X, 1)];
    let at = |copy: u32, seed: u64| {
        let wind = Wind { seed, ..wind(0.0, 1.0) };
        slopes(&joints, &Gust { wind, time_secs: 0.3, key: (0, copy) }, 1.0)
    };
    assert_eq!(at(4, 1), at(4, 1), "always the same");
    assert_ne!(at(4, 1)[0], at(5, 1)[0], "another copy");
    assert_ne!(at(4, 1)[1], at(5, 1)[1], "and its limbs");
    assert_ne!(at(4, 1)[1], at(4, 1)[2], "two limbs");
    assert_ne!(at(4, 1), at(4, 2), "another seed");
}

#[test]
fn layers_face_the_viewer_as_far_as_they_may() {
    let up = |degrees: f64| DVec3::new(0.0, degrees.to_radians().sin(), degrees.to_radians().cos());
    let quarter = std::f64::consts::FRAC_PI_2;
    let faces = |direction: DVec3, max_turn: f64| facing(&FRONT, direction, max_turn) * DVec3::Z;
    let near = |a: DVec3, b: DVec3| a.distance(b) < 1e-12;
    assert!(facing(&FRONT, DVec3::Z * 7.0, 1.0).abs_diff_eq(DMat3::IDENTITY, 1e-15), "as baked");
    assert!(near(faces(from_azimuth(70.0) * 3.0, quarter), from_azimuth(70.0)), "yaw");
    assert!(near(faces(up(-40.0), quarter), up(-40.0)), "pitch");
    let both = DVec3::new(1.0, 2.0, 3.0).normalize();
    assert!(near(faces(both, quarter), both), "both");
    assert!(near(faces(from_azimuth(70.0), 0.5), from_azimuth(0.5_f64.to_degrees())), "limited");
    assert!(near(faces(from_azimuth(-170.0), 4.0), from_azimuth(-170.0)), "behind");
    assert!(near(faces(DVec3::Y, 2.0), DVec3::Y), "from straight above");
    let turn = facing(&FRONT, both, quarter);
    assert!((turn.determinant() - 1.0).abs() < 1e-12, "a turn");
    assert!((turn * DVec3::X).y.abs() < 1e-12, "upright");
}

#[test]
fn a_still_wind_changes_no_bit() {
    let plant = tree();
    for with in [params(4, 64), Params { wood_as: WoodAs::Mesh, ..params(4, 64) }] {
        let lod = build(&plant, &with);
        let view = perspective(DVec3::new(0.7, 2.0, 9.0), DVec3::Y * 2.5, DVec3::Y);
        let still = Crown::alone(DAffine3::IDENTITY);
        let gust = Gust { wind: wind(0.0, 0.0), time_secs: 1.3, key: (0, 0) };
        let calm = Crown { wind: Some(gust), ..still.clone() };
        let storm = Gust { wind: wind(0.1, 0.2), ..gust };
        let storm = Crown { wind: Some(storm), ..still.clone() };
        let picture = |crown: &Crown| {
            let settings = crate::raster::Settings {
                sample_count: 4,
                outputs: crate::raster::Outputs::COLOR,
                background: Vec4::ZERO,
                counts_fragments: false,
            };
            let list = emit(&lod, &view, std::slice::from_ref(crown));
            let mut renderer = crate::raster::Renderer::default();
            renderer.render(&list, &view, &settings, &Job::default()).expect("valid").color
        };
        assert!(picture(&still) == picture(&calm), "the same picture: {:?}", with.wood_as);
        assert!(picture(&still) != picture(&storm), "and another one in a storm");
    }
}

#[test]
fn wood_that_stays_a_mesh_moves_with_its_layers() {
    let lod = build(&tree(), &Params { wood_as: WoodAs::Mesh, ..params(4, 64) });
    assert_eq!(lod.footprint().triangle_count, 8, "all wood");
    let view = perspective(DVec3::new(0.0, 2.0, 9.0), DVec3::Y * 2.5, DVec3::Y);
    let gust = Gust { wind: wind(0.0, 0.3), time_secs: 0.2, key: (0, 0) };
    let crown = Crown { wind: Some(gust), ..Crown::alone(DAffine3::IDENTITY) };
    let places = lod.poses(&view, &crown);
    let list = emit(&lod, &view, std::slice::from_ref(&crown));
    let opaque: Vec<_> = list.items.iter().filter(|item| item.blend == Blend::Opaque).collect();
    assert_eq!(opaque.len(), 4, "a piece a layer");
    for (layer, item) in opaque.into_iter().enumerate() {
        let instance = list.instances[item.instances.start as usize];
        let expected = (places[layer].translation - view.eye).as_vec3();
        assert_eq!(instance.translation, expected, "layer {layer}");
        assert_eq!(instance.linear, places[layer].matrix3.as_mat3(), "layer {layer}");
        let buffers = list.vertices_of(item);
        let ids: Vec<u32> =
            item.primitives.clone().map(|p| buffers.source_ids[p as usize]).collect();
        let first = u32::try_from(layer).expect("few") * 2;
        assert_eq!(ids, [first, first + 1], "the layer's own triangles");
    }
    let bare = build(&tree(), &Params { wood: Wood::None, ..params(4, 64) });
    assert_eq!(bare.footprint().triangle_count, 0, "none");
    let fewer = Params { wood: Wood::Simplified(4), wood_as: WoodAs::Mesh, ..params(4, 64) };
    let fewer = build(&tree(), &fewer);
    assert!((1..=8).contains(&fewer.footprint().triangle_count), "simplified");
}

#[test]
fn layers_count_the_wood_that_is_drawn() {
    let counts = |with: Params| -> (Vec<usize>, u64) {
        let lod = build(&tree(), &with);
        let counts = lod.layers().iter().map(|layer| layer.wood_triangle_count).collect();
        (counts, lod.footprint().triangle_count)
    };
    let mesh = |grouping, wood| Params { grouping, wood, wood_as: WoodAs::Mesh, ..params(4, 32) };
    assert_eq!(counts(mesh(Grouping::Branches, Wood::Full)), (vec![2; 4], 8), "by limb");
    assert_eq!(counts(mesh(Grouping::Slabs, Wood::Full)), (vec![0, 0, 8, 0], 8), "in the middle");
    for grouping in [Grouping::Branches, Grouping::Slabs] {
        let none = Params { grouping, wood: Wood::None, ..params(4, 32) };
        assert_eq!(counts(none), (vec![0; 4], 0), "{grouping:?}: none is drawn");
        let (fewer, all) = counts(mesh(grouping, Wood::Simplified(4)));
        assert_eq!(fewer.iter().sum::<usize>() as u64, all, "{grouping:?}: what is left");
        assert!(all < 8, "{grouping:?}: simplified to {all}");
        let (baked, _) = counts(Params { grouping, ..params(4, 32) });
        assert_eq!(baked.iter().sum::<usize>(), 8, "{grouping:?}: baked, all of it");
    }
}

#[test]
fn the_wood_of_a_copy_without_wind_is_drawn_beside_one_with() {
    let lod = build(&tree(), &Params { wood_as: WoodAs::Mesh, ..params(4, 64) });
    let view = perspective(DVec3::new(0.0, 2.0, 9.0), DVec3::Y * 2.5, DVec3::Y);
    let gust = Gust { wind: wind(0.0, 0.3), time_secs: 0.2, key: (0, 0) };
    let still = crown_at(DAffine3::from_translation(DVec3::X * 3.0), 1);
    let windy = Crown { wind: Some(gust), ..crown_at(DAffine3::IDENTITY, 0) };
    let drawn = |crowns: &[Crown]| -> usize {
        let list = emit(&lod, &view, crowns);
        let opaque = list.items.iter().filter(|item| item.blend == Blend::Opaque);
        opaque.map(|item| item.primitives.len() * item.instances.len()).sum()
    };
    assert_eq!(drawn(&[windy.clone(), still.clone()]), 16, "all wood of both");
    assert_eq!((drawn(&[windy]), drawn(&[still])), (8, 8), "of each");
}

#[test]
fn the_foot_is_the_plants_however_far_layers_turn() {
    for plant in [tree(), plant_at(DVec3::ONE, &[], &random_crown(30))] {
        let full =
            FullMesh::build(&plant, Wood::Full, Filter::Bilinear, &Job::default()).expect("valid");
        for turn in [Turn::Fixed, Turn::Viewer { max_turn: PI }] {
            for grouping in [Grouping::Auto, Grouping::Slabs] {
                let with = Params { turn, grouping, wood_as: WoodAs::Mesh, ..params(4, 32) };
                let lod = build(&plant, &with);
                assert_eq!(lod.foot(), full.foot(), "{turn:?}, {grouping:?}");
                let below = full.bounds().0.y - lod.bounds().0.y;
                assert!(turn == Turn::Fixed || below > 0.1, "{below} m lower: the check can fail");
            }
        }
    }
}
