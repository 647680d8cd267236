//! Leaf clusters of tiny hand-made crowns, and of every crown and camera that is awkward.

use glam::{DAffine3, DQuat, DVec3, Vec3, Vec4};

use super::cards::between;
use super::indirect::Indirect;
use super::kmeans::Init;
use super::plane::{Eigen, Plane};
use super::{Alpha, Drawing, Flatten, LeafClusters, Outline, Params, Texels, Transition};
use crate::draw_list::{Blend, DrawList, Source, Surface};
use crate::error::LodError;
use crate::job::Job;
use crate::lod::full_mesh::FullMesh;
use crate::lod::level_rule::LevelRule;
use crate::lod::made::{
    Leaf, cameras, crown_at, crowns, draw, emit, facing, from_azimuth, parallel, perspective,
    plant, plant_at, random_crown,
};
use crate::lod::wood::Wood;
use crate::lod::{Crown, Representation};
use crate::plant::Plant;
use crate::texture::{Filter, Format};
use crate::view::View;

fn params(cluster_counts: &[usize], side: u32) -> Params {
    Params {
        cluster_counts: cluster_counts.to_vec(),
        alpha: Alpha::Relative(0.1),
        init: Init::PlusPlus,
        seed: 1,
        restart_count: 1,
        max_iterations: 100,
        eigen: Eigen::Exact,
        flatten: Flatten::Project,
        two_sided: true,
        texels: Texels::Each(side, side),
        sample_count: 16,
        format: Format::Rgba8,
        indirect: None,
        drawing: Drawing::Test,
        outline: Outline::Rectangle,
        rule: LevelRule::Pixels(1.0),
        transition: Transition { morph: true, fade_share: 0.0 },
        wood: Wood::Full,
        views: None,
    }
}

const INDIRECT: Indirect =
    Indirect { layer_count: 2, rotation_count: 8, leaf_resolution: 16, texels_per_leaf: 4 };

fn build(plant: &Plant, params: &Params) -> LeafClusters {
    LeafClusters::build(plant, params, &Job::default()).expect("valid")
}

/// Squares of side 1 in the planes z = -2 and x = 3, two each.
fn two_planes() -> [Leaf; 4] {
    let side = |y: f32, z: f32| (Vec3::new(3.0, y, z), Vec3::Z * 0.5, Vec3::Y * 0.5);
    [facing(0.0, 0.0, -2.0, 0.5), facing(1.0, 2.0, -2.0, 0.5), side(0.0, 0.5), side(2.0, 0.5)]
}

fn single(lod: &LeafClusters) -> [Crown; 1] {
    [crown_at(DAffine3::from_translation(lod.origin()), 0)]
}

/// Corners of the items' triangles relative to the eye, in draw order.
fn corners(list: &DrawList) -> Vec<Vec3> {
    let mut corners = Vec::new();
    for item in &list.items {
        let (vertices, indices) = (list.vertices_of(item), list.indices_of(item));
        for instance in item.instances.clone() {
            let placed = &list.instances[instance as usize];
            let range = item.primitives.start as usize * 3..item.primitives.end as usize * 3;
            let at = |&v: &u32| placed.linear * vertices.positions[v as usize] + placed.translation;
            corners.extend(indices.indices[range].iter().map(at));
        }
    }
    corners
}

fn mean_alpha(lod: &dyn Representation, view: &View) -> f64 {
    let frame = draw(lod, view);
    frame.color.iter().map(|p| f64::from(p.w)).sum::<f64>() / frame.color.len() as f64
}

#[test]
fn leaves_in_two_planes_are_two_cards_that_look_alike() {
    let crown = plant(&two_planes());
    for outline in [Outline::Rectangle, Outline::Hull { max_corner_count: 6 }] {
        let lod = build(&crown, &Params { outline, ..params(&[2], 64) });
        assert_eq!(lod.footprint().card_count, 2, "one a plane");
        assert!(lod.errors()[0] < 1e-6, "nothing is moved: {}", lod.errors()[0]);
        let ids = lod.cluster_ids(0);
        assert!(ids[0] == ids[1] && ids[2] == ids[3] && ids[0] != ids[2], "{ids:?}");
        let full =
            FullMesh::build(&crown, Wood::Full, Filter::Bilinear, &Job::default()).expect("leaves");
        for toward in [DVec3::new(0.5, 0.2, 1.0), DVec3::new(-1.0, 0.3, -0.7)] {
            let view = perspective(toward * 8.0, DVec3::new(1.0, 1.0, -0.5), DVec3::Y);
            let (card, mesh) = (draw(&lod, &view), draw(&full, &view));
            let far = card.color.iter().zip(&mesh.color).filter(|(a, b)| !a.abs_diff_eq(**b, 0.3));
            // a texel of the card's 64 is a quarter of a pixel: only outlines may differ
            assert!(far.count() < 20, "from {toward}");
            let alphas = [mean_alpha(&lod, &view), mean_alpha(&full, &view)];
            assert!((alphas[0] / alphas[1] - 1.0).abs() < 0.05, "from {toward}: {alphas:?}");
            for (pixel, (a, b)) in card.depth.iter().zip(&mesh.depth).enumerate() {
                // where all samples of both are covered, the nearest is the same
                if card.color[pixel].w == 1.0 && mesh.color[pixel].w == 1.0 {
                    assert!((a - b).abs() < 1e-4, "from {toward}: {a} for {b}");
                }
            }
        }
    }
}

#[test]
fn cards_lie_in_their_planes_around_their_leaves() {
    let crown = plant(&random_crown(60));
    let lod = build(&crown, &params(&[5], 16));
    let view = perspective(DVec3::Z * 6.0, DVec3::ZERO, DVec3::Y);
    let list = emit(&lod, &view, &single(&lod));
    let found: Vec<DVec3> = corners(&list).iter().map(|c| c.as_dvec3() + view.eye).collect();
    assert_eq!(found.len(), 5 * 6, "two triangles each");
    for (plane, corners) in lod.planes(0).iter().zip(found.chunks(6)) {
        for corner in corners {
            // f32 relative to an eye 6 m away
            assert!(plane.distance(*corner).abs() < 2e-6, "{plane:?}: {corner}");
        }
    }
}

#[test]
fn the_side_that_is_seen_decides_the_picture() {
    // leaves that are red in front and green behind
    let mut crown = plant(&[facing(0.0, 0.0, 0.0, 1.0)]);
    crown.foliage.mesh.front.fill(Vec3::X);
    crown.foliage.mesh.back.fill(Vec3::Y);
    let middle =
        |lod: &LeafClusters, toward: DVec3| draw(lod, &parallel(toward, DVec3::Y, 1.0, 1)).color[0];
    let both = build(&crown, &params(&[1], 8));
    assert_eq!(middle(&both, DVec3::Z), Vec4::new(1.0, 0.0, 0.0, 1.0), "in front");
    assert_eq!(middle(&both, DVec3::NEG_Z), Vec4::new(0.0, 1.0, 0.0, 1.0), "behind");
    let one = build(&crown, &Params { two_sided: false, ..params(&[1], 8) });
    assert_eq!(middle(&one, DVec3::NEG_Z), middle(&one, DVec3::Z), "the same from both");
    // the side that looks up is the one that is baked
    let lying = |flip: f32| {
        let mut crown = plant(&[(Vec3::ZERO, Vec3::X * flip, Vec3::Z)]);
        crown.foliage.mesh.front.fill(Vec3::X);
        crown.foliage.mesh.back.fill(Vec3::Y);
        let lod = build(&crown, &Params { two_sided: false, ..params(&[1], 8) });
        draw(&lod, &parallel(DVec3::NEG_Y, DVec3::Z, 1.0, 1)).color[0]
    };
    assert_eq!(lying(-1.0), Vec4::new(1.0, 0.0, 0.0, 1.0), "its front looks up");
    assert_eq!(lying(1.0), Vec4::new(0.0, 1.0, 0.0, 1.0), "its back looks up");
}

#[test]
fn turned_leaves_keep_their_area_and_projected_ones_do_not() {
    // a leaf that leans by 60 degrees between two that lie in the plane and decide it
    let leaning = (Vec3::X * 3.0, Vec3::new(0.5, 0.0, 0.866_025_4) * 0.5, Vec3::Y * 0.5);
    let flat = (0..8_u8)
        .map(|i| facing(f32::from(i % 4) * 2.0 - 6.0, f32::from(i / 4) * 3.0 + 1.5, 0.0, 0.5));
    let crown = plant(&flat.chain([leaning]).collect::<Vec<_>>());
    let view = parallel(DVec3::Z, DVec3::Y, 20.0, 256);
    let full =
        FullMesh::build(&crown, Wood::Full, Filter::Bilinear, &Job::default()).expect("leaves");
    let seen = |flatten| {
        // the plane is given, so that it is level to the bit
        let plane = Plane { normal: DVec3::Z, d: 0.0 };
        let with = Params {
            flatten,
            alpha: Alpha::SquareMetres(1e6),
            init: Init::Planes(vec![plane]),
            ..params(&[1], 256)
        };
        let lod = build(&crown, &with);
        mean_alpha(&lod, &view) / mean_alpha(&full, &view)
    };
    let (projected, turned) = (seen(Flatten::Project), seen(Flatten::Rotate));
    // the plane leans a little towards the leaning leaf; seen along z all that is projected agrees
    assert!((projected - 1.0).abs() < 0.03, "as the leaves are seen: {projected}");
    assert!((turned - 9.0 / 8.5).abs() < 0.03, "a whole leaf instead of half of one: {turned}");
}

#[test]
fn planes_move_at_a_constant_rate() {
    let from = Plane { normal: DVec3::Z, d: 0.0 };
    let to = Plane { normal: DVec3::X, d: -1.0 };
    let mean = DVec3::new(0.0, 2.0, 0.0);
    for (t, angle) in [(0.0, 0.0), (0.5, 45.0_f64), (1.0, 90.0)] {
        let plane = between(&from, &to, mean, t);
        let expected = DVec3::new(angle.to_radians().sin(), 0.0, angle.to_radians().cos());
        assert!(plane.normal.abs_diff_eq(expected, 1e-15), "{t}: {}", plane.normal);
        let foot = DVec3::new(t, 2.0, 0.0);
        assert!(plane.distance(foot).abs() < 1e-15, "{t}: through {foot}");
    }
    let opposite = Plane { normal: -DVec3::Z, d: 1.0 };
    let plane = between(&from, &opposite, mean, 0.5);
    assert_eq!((plane.normal, plane.d), (DVec3::Z, -0.5), "half way up, and not turned");
}

/// A crown with levels of 8, 4 and 2 cards.
fn levels(with: Params) -> LeafClusters {
    let lod = build(&plant(&random_crown(80)), &Params { cluster_counts: vec![8, 4, 2], ..with });
    assert_eq!(lod.level_count(), 3, "as asked for");
    lod
}

#[test]
fn levels_are_nested_and_ever_coarser() {
    let lod = levels(params(&[1], 8));
    for level in 0..2 {
        let (fine, coarse) = (lod.cluster_ids(level), lod.cluster_ids(level + 1));
        let parents = lod.parents(level);
        assert_eq!(parents.len(), lod.planes(level).len(), "one each");
        for (fine, coarse) in fine.iter().zip(coarse) {
            assert_eq!(parents[*fine as usize], *coarse, "level {level}");
        }
        assert!(lod.errors()[level] < lod.errors()[level + 1], "level {level}");
    }
    assert_eq!(lod.planes(2).len(), 2, "the coarsest");
    assert!(lod.parents(2).is_empty(), "has no parents");
    assert_eq!(lod.footprint().card_count, 14, "all levels are held");
}

#[test]
fn cards_arrive_in_the_next_levels_planes() {
    // one-sided, so that all corners come in the same order
    let lod = levels(Params { two_sided: false, ..params(&[1], 8) });
    let view = perspective(DVec3::new(1.0, 2.0, 5.0), DVec3::ZERO, DVec3::Y);
    let at = |level, t| {
        let lod = lod.at(level, t).expect("a level");
        let list = emit(&lod, &view, &single(&lod));
        corners(&list).iter().map(|c| c.as_dvec3() + view.eye).collect::<Vec<_>>()
    };
    let resting = at(0, 0.0);
    let arrived = at(0, 1.0);
    assert_eq!(resting.len(), arrived.len(), "the same cards");
    for (number, corners) in arrived.chunks(6).enumerate() {
        let parent = lod.parents(0)[number] as usize;
        for (corner, before) in corners.iter().zip(&resting[number * 6..]) {
            let plane = &lod.planes(1)[parent];
            // f32 relative to the plant and to the eye
            assert!(plane.distance(*corner).abs() < 5e-6, "card {number}: {corner}");
            let moved = *before - *corner;
            assert!(moved.cross(plane.normal).length() < 5e-6, "card {number}: straight down");
        }
    }
    // a step of a hundredth moves no corner by more than so much of its whole way, and a turn's share
    for step in 0..100 {
        let (a, b) = (at(0, f64::from(step) / 100.0), at(0, f64::from(step + 1) / 100.0));
        for (a, b) in a.iter().zip(&b) {
            assert!(a.distance(*b) < 0.05, "step {step}: {}", a.distance(*b));
        }
    }
}

#[test]
fn levels_follow_distance_and_pixels() {
    let far = |lod: &LeafClusters, distance: f64| {
        let view = perspective(DVec3::Z * distance, DVec3::ZERO, DVec3::Y);
        let list = emit(lod, &view, &single(lod));
        corners(&list).len() / 6
    };
    let still = Transition { morph: false, fade_share: 0.0 };
    let rule = LevelRule::Distances(vec![3.0, 10.0]);
    let lod = levels(Params { rule, transition: still, ..params(&[1], 8) });
    // the crown's radius is about 2
    let radius = lod.built.radius;
    for (distance, count) in [(2.9, 8), (3.1, 4), (9.9, 4), (10.1, 2), (1e6, 2)] {
        assert_eq!(far(&lod, distance * radius), count, "{distance} radii");
    }
    let lod = levels(Params { rule: LevelRule::Pixels(0.5), transition: still, ..params(&[1], 8) });
    let mut last = usize::MAX;
    for exponent in 0..12 {
        let count = far(&lod, radius * 2.0_f64.powi(exponent));
        assert!(count <= last, "never finer from farther away");
        last = count;
    }
    assert_eq!(last, 2, "the coarsest from afar");
    assert_eq!(far(&lod, radius * 0.5), 8, "the finest from inside");
    // a pixel at a distance d is 2 tan(0.5) d / 24 metres; half of it is the error of level 1
    let switch = lod.errors()[1] * 2.0 * 24.0 / (2.0 * 0.5_f64.tan()) + radius;
    assert_eq!((far(&lod, switch * 0.999), far(&lod, switch * 1.001)), (8, 4), "at {switch}");
    // twice as large and twice as far away looks the same
    let view = perspective(DVec3::Z * (switch * 2.0 * 0.999), DVec3::ZERO, DVec3::Y);
    let list = emit(&lod, &view, &[crown_at(DAffine3::from_scale(DVec3::splat(2.0)), 0)]);
    assert_eq!(corners(&list).len() / 6, 8, "not yet");
}

#[test]
fn the_next_level_fades_in_over_the_last_share() {
    let fading = Transition { morph: true, fade_share: 0.25 };
    let lod = levels(Params { transition: fading, ..params(&[1], 8) });
    let view = perspective(DVec3::Z * 5.0, DVec3::ZERO, DVec3::Y);
    let fades = |t: f64| {
        let lod = lod.at(0, t).expect("a level");
        let list = emit(&lod, &view, &single(&lod));
        let faded = |item: &crate::draw_list::Item| {
            (item.primitives.len() / 2, list.instances[item.instances.start as usize].fade)
        };
        list.items.iter().map(faded).collect::<Vec<_>>()
    };
    assert_eq!(fades(0.75), [(8, 1.0)], "the fine level alone");
    assert_eq!(fades(0.875), [(8, 0.5), (4, -0.5)], "half of the samples each");
    assert_eq!(fades(1.0), [(4, 1.0)], "the coarse level alone");
    // what the one leaves out the other shows: nowhere less than where both are drawn
    let half = draw(&lod.at(0, 0.875).expect("a level"), &view);
    let ends = [
        draw(&lod.at(0, 0.75).expect("a level"), &view),
        draw(&lod.at(1, 0.0).expect("a level"), &view),
    ];
    for (pixel, alpha) in half.color.iter().map(|p| p.w).enumerate() {
        let both = ends.iter().map(|frame| frame.color[pixel].w).fold(1.0, f32::min);
        assert!(both < 1.0 || alpha == 1.0, "pixel {pixel}: {alpha}");
    }
}

#[test]
fn copies_share_an_item_or_bring_their_own() {
    let crown = plant(&random_crown(40));
    let far_to_near: Vec<Crown> = (0..3)
        .map(|rank| {
            let at = DAffine3::from_translation(DVec3::Z * (f64::from(rank) * 4.0 - 12.0));
            crown_at(at, rank)
        })
        .collect();
    let view = perspective(DVec3::Z * 6.0, DVec3::ZERO, DVec3::Y);
    let one = build(&crown, &Params { two_sided: false, ..params(&[4], 8) });
    let list = emit(&one, &view, &far_to_near);
    assert_eq!(list.items.len(), 1, "one item for all");
    assert_eq!(list.items[0].instances, 0..3, "an instance each");
    assert!(list.own.buffers.indices.is_empty(), "nothing of this frame alone");
    assert!(list.instances[0].translation.z > list.instances[2].translation.z, "near ones first");
    let two = build(&crown, &params(&[4], 8));
    let list = emit(&two, &view, &far_to_near);
    assert_eq!(list.items.len(), 3, "an item each: sides differ");
    assert!(list.items.iter().all(|item| item.indices == Source::Own), "indices of this frame");
    assert_eq!(list.textures.len(), 1, "one atlas");
    let blended = build(&crown, &Params { drawing: Drawing::Blend, ..params(&[4], 8) });
    let list = emit(&blended, &view, &far_to_near);
    let depths: Vec<f32> = list
        .items
        .iter()
        .map(|item| list.instances[item.instances.start as usize].translation.z)
        .collect();
    assert!(depths.is_sorted(), "far copies are painted first: {depths:?}");
    assert!(list.items.iter().all(|i| i.blend == Blend::Over && !i.depth_write), "blended");
}

#[test]
fn blended_cards_are_painted_far_to_near() {
    let stack = [-3.0, 0.0, 3.0].map(|z| facing(0.0, 0.0, z, 1.0));
    let with =
        Params { drawing: Drawing::Blend, alpha: Alpha::SquareMetres(0.1), ..params(&[3], 8) };
    let lod = build(&plant(&stack), &with);
    for toward in [DVec3::Z, DVec3::NEG_Z] {
        for view in
            [perspective(toward * 9.0, DVec3::ZERO, DVec3::Y), parallel(toward, DVec3::Y, 4.0, 8)]
        {
            let list = emit(&lod, &view, &single(&lod));
            let depths: Vec<f64> =
                corners(&list).chunks(6).map(|card| -card[0].as_dvec3().dot(view.back)).collect();
            assert!(depths.is_sorted_by(|a, b| a > b), "from {toward}: {depths:?}");
        }
    }
}

#[test]
fn indirect_cards_show_the_leaves_too() {
    // crosses of two squares, so that a turn shows; like ones at any angle
    let crown = random_crown(60);
    let crown: Vec<Leaf> =
        crown.iter().map(|&(p, a, b)| (p, a.normalize() * 0.3, b.normalize() * 0.1)).collect();
    let crown = plant(&crown);
    for flatten in [Flatten::Project, Flatten::Rotate] {
        let direct = build(&crown, &Params { flatten, ..params(&[6], 256) });
        let with = Params {
            flatten,
            indirect: Some(Indirect {
                layer_count: 4,
                rotation_count: 64,
                leaf_resolution: 64,
                texels_per_leaf: 8,
            }),
            ..params(&[6], 256)
        };
        let indirect = build(&crown, &with);
        assert!(indirect.textures()[0].name.starts_with("leaf"), "its picture");
        let list =
            emit(&indirect, &perspective(DVec3::Z, DVec3::ZERO, DVec3::Y), &single(&indirect));
        assert!(matches!(list.items[0].surface, Surface::Indirect { .. }), "looked up");
        let bytes = |lod: &LeafClusters| lod.footprint().texture_bytes;
        assert!(bytes(&indirect) < bytes(&direct), "{} bytes", bytes(&indirect));
        let mut sums = [0.0; 2];
        for azimuth in 0..12_u8 {
            let eye = from_azimuth(f64::from(azimuth) * 30.0 + 5.0) * 4.0;
            // large enough for level 0: coarser ones lose what is thin
            let view = perspective(eye, DVec3::ZERO, DVec3::Y);
            let view = View { width: 128, height: 128, ..view };
            sums[0] += mean_alpha(&direct, &view);
            sums[1] += mean_alpha(&indirect, &view);
        }
        // projected leaves are shorter, which a picture of one size can only hold on average
        let most = if flatten == Flatten::Rotate { 0.03 } else { 0.1 };
        assert!((sums[1] / sums[0] - 1.0).abs() < most, "{flatten:?}: {sums:?}");
    }
}

#[test]
fn turned_leaves_are_named_as_they_grow() {
    // leaves that face x, in a plane that faces z: the leaf that stands for all is seen along its own
    // normal, not along one that has been turned away
    let leaf = |i: u8| {
        let at = Vec3::new(f32::from(i % 5) * 2.0, f32::from(i / 5) * 2.0, 0.0);
        (at, Vec3::Y * 0.5, Vec3::Z * 0.5)
    };
    let crown = plant(&(0..25).map(leaf).collect::<Vec<_>>());
    let with =
        Params { alpha: Alpha::SquareMetres(0.0), flatten: Flatten::Rotate, ..params(&[1], 256) };
    let view = View { eye: DVec3::new(4.0, 4.0, 90.0), ..parallel(DVec3::Z, DVec3::Y, 12.0, 96) };
    let direct = mean_alpha(&build(&crown, &with), &view);
    let fine = Indirect { leaf_resolution: 64, texels_per_leaf: 8, ..INDIRECT };
    let indirect = mean_alpha(&build(&crown, &Params { indirect: Some(fine), ..with }), &view);
    assert!((direct / (25.0 / 144.0) - 1.0).abs() < 0.05, "a square metre each: {direct}");
    assert!((indirect / direct - 1.0).abs() < 0.05, "{indirect} for {direct}");
}

#[test]
fn an_indirect_leaf_lies_where_the_leaf_does() {
    // long thin leaves in one plane: only the right turn covers them
    let leaf = |i: u8| {
        let angle = f32::from(i) * 0.7;
        let (sine, cosine) = (libm::sinf(angle), libm::cosf(angle));
        let across = Vec3::new(cosine, sine, 0.0) * 0.9;
        let along = Vec3::new(-sine, cosine, 0.0) * 0.2;
        (Vec3::new(f32::from(i % 3) * 2.0, f32::from(i / 3) * 2.0, 0.0), across, along)
    };
    let mut crown = plant(&(0..9).map(leaf).collect::<Vec<_>>());
    // every leaf with its own colour, on both sides
    for vertex in 0..36 {
        let shade = vertex as f32 / 4.0;
        crown.foliage.mesh.front[vertex] = Vec3::new(0.1, 0.1 + 0.09 * shade.floor(), 0.2);
        crown.foliage.mesh.back[vertex] = crown.foliage.mesh.front[vertex];
    }
    let fine =
        Indirect { rotation_count: 128, leaf_resolution: 64, texels_per_leaf: 8, ..INDIRECT };
    let lod = build(&crown, &Params { indirect: Some(fine), ..params(&[1], 8) });
    let full =
        FullMesh::build(&crown, Wood::Full, Filter::Bilinear, &Job::default()).expect("leaves");
    for toward in [DVec3::Z, DVec3::NEG_Z] {
        let view = View {
            eye: DVec3::new(2.0, 2.0, 0.0) + toward * 9.0,
            ..parallel(toward, DVec3::Y, 6.4, 64)
        };
        let (card, mesh) = (draw(&lod, &view), draw(&full, &view));
        let pairs = || card.color.iter().zip(&mesh.color);
        let wrong = pairs().filter(|(a, b)| (a.w - b.w).abs() > 0.6).count();
        // half a step of 128 turns the tip of a leaf by a quarter of a pixel
        assert!(wrong < 20, "from {toward}: {wrong} pixels");
        let both = || pairs().filter(|(a, b)| a.w == 1.0 && b.w == 1.0);
        // 648 pixels' worth of leaves, and what their outlines touch is not full
        assert!(both().count() > 450, "from {toward}: {}", both().count());
        for (a, b) in both() {
            // eight bits of sRGB, twice
            assert!(a.abs_diff_eq(*b, 0.02), "from {toward}: {a} for {b}");
        }
    }
}

#[test]
fn views_bake_the_sides_they_see_and_no_more_texels_than_pixels() {
    let crown = plant(&two_planes());
    let view = View {
        width: 96,
        height: 96,
        ..perspective(DVec3::new(-3.0, 1.0, 9.0), DVec3::ZERO, DVec3::Y)
    };
    let all = build(&crown, &params(&[2], 256));
    let seen = build(&crown, &Params { views: Some(vec![view.clone()]), ..params(&[2], 256) });
    assert!(seen.footprint().texture_bytes * 4 < all.footprint().texture_bytes, "few pixels");
    let [a, b] = [&all, &seen].map(|lod| mean_alpha(lod, &view));
    assert!((a / b - 1.0).abs() < 0.1, "and the same picture: {b} for {a}");
    // the other side is not baked: what there is stands in for it
    let behind = perspective(DVec3::new(9.0, 1.0, -9.0), DVec3::ZERO, DVec3::Y);
    assert!(mean_alpha(&seen, &behind) > 0.0, "not empty");
    let error = LeafClusters::build(
        &crown,
        &Params { views: Some(vec![]), ..params(&[2], 8) },
        &Job::default(),
    );
    assert!(error.expect_err("no view").to_string().starts_with("views"), "named");
}

#[test]
fn every_awkward_crown_and_camera_gives_a_picture() {
    for (name, leaves) in crowns() {
        let crown = plant(&leaves);
        for counts in [&[1][..], &[3], &[64, 5, 2]] {
            for (kind, with) in [
                ("test", params(counts, 8)),
                ("coverage", Params { drawing: Drawing::Coverage, ..params(counts, 8) }),
                ("blend", Params { drawing: Drawing::Blend, ..params(counts, 8) }),
                (
                    "one side",
                    Params { two_sided: false, format: Format::Rgb5a1, ..params(counts, 8) },
                ),
                ("turned", Params { flatten: Flatten::Rotate, ..params(counts, 8) }),
                (
                    "hull",
                    Params { outline: Outline::Hull { max_corner_count: 5 }, ..params(counts, 8) },
                ),
                ("indirect", Params { indirect: Some(INDIRECT), ..params(counts, 8) }),
                (
                    "fading",
                    Params {
                        transition: Transition { morph: false, fade_share: 1.0 },
                        ..params(counts, 8)
                    },
                ),
            ] {
                let job = Job::default();
                let what = format!("{name}: {counts:?}, {kind}");
                let lod = LeafClusters::build(&crown, &with, &job)
                    .unwrap_or_else(|error| panic!("{what}: {error}"));
                let (done, total) = job.progress();
                assert_eq!(done, total, "{what}: all steps that were announced");
                let (low, high) = lod.bounds();
                assert!(low.is_finite() && high.is_finite(), "{what}: {low} to {high}");
                assert!(lod.planes(0).len() <= leaves.len(), "{what}: no more planes than leaves");
                for (camera, view) in cameras() {
                    let frame = draw(&lod, &view);
                    let fine = |pixel: &Vec4| {
                        pixel.is_finite() && pixel.min_element() >= 0.0 && pixel.w <= 1.0 + 1e-6
                    };
                    assert!(frame.color.iter().all(fine), "{what}, {camera}");
                    assert!(frame.depth.iter().all(|&d| d > 0.0), "{what}, {camera}: depth");
                }
            }
        }
    }
}

#[test]
fn size_and_place_do_not_change_the_picture() {
    let crown: Vec<Leaf> = random_crown(60);
    for with in [params(&[6, 3], 16), Params { indirect: Some(INDIRECT), ..params(&[6, 3], 16) }] {
        let lod = build(&plant(&crown), &with);
        let view = |scale: f64, origin: DVec3| {
            perspective(origin + DVec3::new(1.5, 0.5, 3.25) * scale, origin, DVec3::Y)
        };
        let wanted = draw(&lod, &view(1.0, DVec3::ZERO));
        assert!(wanted.color.iter().any(|pixel| pixel.w > 0.5), "it is in the picture");
        // powers of two, with which every rounding stays the same: 0.1 mm, 8 km
        for exponent in [-13, 13] {
            let scale = 2.0_f32.powi(exponent);
            let scaled: Vec<Leaf> =
                crown.iter().map(|&(a, b, c)| (a * scale, b * scale, c * scale)).collect();
            let frame = draw(&build(&plant(&scaled), &with), &view(f64::from(scale), DVec3::ZERO));
            assert_eq!(frame.color, wanted.color, "2^{exponent} times as large");
        }
        let origin = DVec3::new(1_048_576.0, -524_288.0, 2_097_152.0);
        let far = build(&plant_at(origin, &[], &crown), &with);
        assert_eq!(
            draw(&far, &view(1.0, origin)).color,
            wanted.color,
            "far from the world's origin"
        );
        assert_eq!(far.origin(), origin, "where it stands");
    }
}

#[test]
fn a_turned_copy_is_seen_from_its_own_side() {
    let mut crown = plant(&[facing(0.0, 0.0, 0.0, 1.0)]);
    crown.foliage.mesh.front.fill(Vec3::X);
    crown.foliage.mesh.back.fill(Vec3::Y);
    let lod = build(&crown, &params(&[1], 8));
    let view = parallel(DVec3::Z, DVec3::Y, 1.0, 1);
    let seen = |world_from_local: DAffine3| {
        let list = emit(&lod, &view, &[crown_at(world_from_local, 0)]);
        let settings = crate::raster::Settings {
            sample_count: 1,
            outputs: crate::raster::Outputs::COLOR,
            background: Vec4::ZERO,
            counts_fragments: false,
        };
        let mut renderer = crate::raster::Renderer::default();
        renderer.render(&list, &view, &settings, &Job::default()).expect("valid").color[0]
    };
    let turned = DAffine3::from_quat(DQuat::from_rotation_y(std::f64::consts::PI));
    let mirrored = DAffine3::from_scale(DVec3::new(1.0, 1.0, -1.0));
    let sheared = DAffine3::from_mat3(glam::DMat3::from_cols(
        DVec3::X,
        DVec3::new(0.0, 1.0, 0.4),
        DVec3::new(0.7, 0.0, 1.0),
    ));
    for (what, placed, color) in [
        ("as it is", DAffine3::IDENTITY, Vec4::new(1.0, 0.0, 0.0, 1.0)),
        ("turned round", turned, Vec4::new(0.0, 1.0, 0.0, 1.0)),
        ("mirrored", mirrored, Vec4::new(0.0, 1.0, 0.0, 1.0)),
        ("sheared", sheared, Vec4::new(1.0, 0.0, 0.0, 1.0)),
    ] {
        assert_eq!(seen(placed), color, "{what}");
    }
}

#[test]
fn bad_parameters_are_refused_by_name() {
    let crown = plant(&random_crown(10));
    let good = || params(&[2], 8);
    let indirect = |change: &dyn Fn(&mut Indirect)| {
        let mut with = INDIRECT;
        change(&mut with);
        Params { indirect: Some(with), ..good() }
    };
    let cases = [
        ("cluster_count", params(&[], 8)),
        ("cluster_count", params(&[0], 8)),
        ("cluster_count", params(&[5000], 8)),
        ("cluster_count", params(&[4, 4], 8)),
        ("cluster_count", params(&[4, 0], 8)),
        ("alpha", Params { alpha: Alpha::SquareMetres(-1.0), ..good() }),
        ("alpha_rel", Params { alpha: Alpha::Relative(f64::NAN), ..good() }),
        ("resolution", Params { texels: Texels::Each(0, 8), ..good() }),
        ("resolution", Params { texels: Texels::Each(8192, 8192), ..good() }),
        ("texels_per_metre", Params { texels: Texels::PerMetre(0.0), ..good() }),
        ("texels_per_metre", Params { texels: Texels::PerMetre(1e7), ..good() }),
        ("outline", Params { outline: Outline::Hull { max_corner_count: 2 }, ..good() }),
        (
            "fade_share",
            Params { transition: Transition { morph: true, fade_share: 1.5 }, ..good() },
        ),
        ("level_error_px", Params { rule: LevelRule::Pixels(-1.0), ..good() }),
        ("level_distances", Params { rule: LevelRule::Distances(vec![1.0]), ..good() }),
        ("level_distances", Params { rule: LevelRule::Distances(vec![]), ..params(&[2, 1], 8) }),
        (
            "level_distances",
            Params { rule: LevelRule::Distances(vec![3.0, 2.0]), ..params(&[4, 2, 1], 8) },
        ),
        ("layers", indirect(&|with| with.layer_count = 0)),
        ("rotation_count", indirect(&|with| with.rotation_count = 200)),
        ("leaf_resolution", indirect(&|with| with.leaf_resolution = 0)),
        ("texels_per_leaf", indirect(&|with| with.texels_per_leaf = 0)),
        ("samples", Params { sample_count: 2, ..good() }),
        ("wood_triangle_count", Params { wood: Wood::Simplified(0), ..good() }),
    ];
    for (name, with) in cases {
        let error = LeafClusters::build(&crown, &with, &Job::default()).expect_err(name);
        assert!(error.to_string().starts_with(name), "{name}: {error}");
    }
    let lod = build(&crown, &params(&[4, 2], 8));
    for (name, level, t) in [("level", 2, 0.0), ("t", 0, 1.5), ("t", 1, 0.5), ("t", 0, f64::NAN)] {
        assert!(lod.at(level, t).expect_err(name).to_string().starts_with(name), "{level}, {t}");
    }
    let bare = plant_at(DVec3::ZERO, &[facing(0.0, 0.0, 0.0, 1.0)], &[]);
    let error = LeafClusters::build(&bare, &good(), &Job::default()).expect_err("no leaves");
    assert!(error.to_string().starts_with("foliage is empty"), "{error}");
    let job = Job::default();
    job.cancel();
    let stopped = LeafClusters::build(&crown, &good(), &job).expect_err("cancelled");
    assert_eq!(stopped, LodError::Cancelled, "stopped");
}
