//! Shares and areas by hand, and pruned crowns against the full mesh.

use glam::DAffine3;

use super::*;
use crate::lod::full_mesh::FullMesh;
use crate::lod::made::{
    cameras, crown_at, crowns, draw, emit, facing, parallel, perspective, plant, plant_at,
    random_crown,
};
use crate::plant::AlphaMode;

fn params() -> Params {
    Params {
        leaf_width_px: 4.0,
        half_ratio: 2.0,
        shrink: 0.0,
        contrast: false,
        seed: 1,
        wood: Wood::Full,
    }
}

fn build(plant: &Plant, params: &Params) -> StochasticPruning {
    StochasticPruning::build(plant, params, &Job::default()).expect("valid")
}

#[test]
fn shares_by_hand() {
    let cases = [(0.5, 2.0, 1.0), (1.0, 2.0, 1.0), (2.0, 2.0, 0.5), (8.0, 2.0, 0.125)];
    for (z, h, share) in cases {
        assert!((kept_share(z, h) - share).abs() < 1e-15, "{z}, {h}");
    }
    assert!((kept_share(9.0, 3.0) - 0.25).abs() < 1e-15, "half at 3, a quarter at 9");
    // half are left; with 0.5 of them shrinking, places 1/4 to 1/2 go from whole to nothing
    let level = Level::new(0.5, 0.5, 0.0);
    assert_eq!((level.window, level.area_scale), (0.25, 1.0 / 0.375), "by hand");
    let factors = [0.0, 0.2, 0.25, 0.375, 0.5, 0.9].map(|x| level.area_factor(x) * 0.375);
    assert_eq!(factors, [1.0, 1.0, 1.0, 0.5, 0.0, 0.0], "whole, whole, whole, half, gone");
    let all = Level::new(1.0, 0.5, 0.0);
    assert_eq!((all.window, all.area_factor(0.999)), (0.0, 1.0), "nothing shrinks yet");
}

#[test]
fn contrast_by_hand() {
    // 16 leaves a pixel of which a quarter is left: four times the variance, half the contrast
    assert_eq!(Level::new(0.25, 0.0, 1.0 / 16.0).contrast, 0.5, "half");
    assert_eq!(Level::new(0.25, 0.0, 4.0).contrast, 1.0, "leaves of several pixels");
    assert_eq!(Level::new(0.25, 0.0, 0.5).contrast, 0.5_f64.sqrt(), "no less than one leaf");
    assert_eq!(Level::new(0.25, 0.0, 0.0).contrast, 1.0, "not wanted");
}

/// Area of all triangles that a list draws from its own buffers.
fn area(list: &crate::draw_list::DrawList) -> f64 {
    let own = &list.own.buffers;
    let corners = own.indices.chunks_exact(3);
    let area = |c: &[u32]| {
        crate::plant::mesh::triangle_area([c[0], c[1], c[2]].map(|v| own.positions[v as usize]))
    };
    corners.map(area).sum()
}

#[test]
fn area_is_kept_at_any_share() {
    let same: Vec<_> = (0_u8..=199).map(|i| facing(f32::from(i), 0.0, 0.0, 0.5)).collect();
    let view = parallel(DVec3::Z, DVec3::Y, 10.0, 8);
    for (leaves, tolerance) in [(same, 0.01), (random_crown(200), 0.15)] {
        let plant = plant(&leaves);
        let whole = plant.foliage.mesh.area();
        for shrink in [0.0, 0.3, 1.0] {
            let lod = build(&plant, &Params { shrink, ..params() });
            for share in [1.0, 0.9, 0.5, 0.25, 0.1] {
                let lod = lod.at(share).expect("in range");
                let list = emit(&lod, &view, &[crown_at(DAffine3::IDENTITY, 0)]);
                let found = area(&list) / whole;
                // equal leaves: half a leaf of 20; others: chance
                let allowed = if share == 1.0 { 1e-5 } else { tolerance / share.min(0.4) };
                assert!((found - 1.0).abs() < allowed, "{share}, {shrink}: {found}");
            }
        }
    }
}

#[test]
fn fewer_leaves_are_some_of_more_leaves() {
    let lod = build(&plant(&random_crown(100)), &params());
    let view = parallel(DVec3::Z, DVec3::Y, 3.0, 8);
    let ids = |share: f64| {
        let list = emit(&lod.at(share).expect("valid"), &view, &[crown_at(DAffine3::IDENTITY, 0)]);
        list.own.buffers.source_ids
    };
    let mut before = ids(1.0);
    assert_eq!(before.len(), 200, "two triangles a leaf");
    for share in [0.8, 0.5, 0.13, 0.001] {
        let now = ids(share);
        assert!(now.len() < before.len() && now[..] == before[..now.len()], "{share}: a prefix");
        before = now;
    }
    assert_eq!(before.len(), 2, "one leaf is always left");
}

#[test]
fn from_near_it_is_the_full_mesh() {
    let wood = [facing(0.0, -1.0, 0.0, 0.4)];
    let mut plant = plant_at(DVec3::new(1e3, -5.0, 7.0), &wood, &random_crown(40));
    let near = parallel(DVec3::new(0.2, 0.3, 1.0), DVec3::Y, 3.0, 128);
    let eye = near.eye + plant.origin;
    let view = View::new(eye, plant.origin, DVec3::Y, near.projection, (128, 128), 0.1);
    let view = view.expect("valid");
    for mode in [AlphaMode::Opaque, AlphaMode::Blend] {
        plant.materials[0].alpha_mode = mode;
        if mode == AlphaMode::Blend {
            // wood that blends is sorted by itself
            plant.wood = Mesh::default();
        }
        let lod = build(&plant, &Params { contrast: true, shrink: 0.5, ..params() });
        let full =
            FullMesh::build(&plant, Wood::Full, Filter::Bilinear, &Job::default()).expect("valid");
        let (found, expected) = (draw(&lod, &view), draw(&full, &view));
        assert!(found.color == expected.color, "{mode:?}: another picture");
        assert!(found.depth == expected.depth, "{mode:?}: another depth");
        let fewer = lod.at(0.5).expect("in range");
        assert!(draw(&fewer, &view).color != expected.color, "the check can fail");
    }
}

#[test]
fn the_foot_is_the_plants_whatever_its_leaves_have_grown_to() {
    let wood = [facing(0.5, -1.0, 0.0, 0.4)];
    let plant = plant_at(DVec3::ZERO, &wood, &random_crown(100));
    let full =
        FullMesh::build(&plant, Wood::Full, Filter::Bilinear, &Job::default()).expect("valid");
    let lod = build(&plant, &params());
    let few = lod.at(0.01).expect("in range");
    assert!(few.bounds().0.y < full.bounds().0.y - 0.5, "the one that is left is large");
    assert_eq!((few.foot(), lod.foot()), (full.foot(), full.foot()), "on the ground");
}

#[test]
fn farther_eyes_see_fewer_leaves() {
    let plant = plant(&random_crown(200));
    let lod = build(&plant, &params());
    let width = lod.built.leaf_width;
    let mut before = 1.1;
    for distance in [2.0, 20.0, 80.0, 320.0] {
        let view = perspective(DVec3::Z * distance, DVec3::ZERO, DVec3::Y);
        let share = lod.level(&view).kept_share;
        let z = 4.0 / (width / view.pixel_size_at(distance));
        // the crown's centre is at 0
        assert!((share - kept_share(z, 2.0).max(0.005)).abs() < 1e-3, "{distance}: {share}");
        assert!(share < before, "{distance}: {share}");
        before = share;
    }
}

#[test]
fn awkward_crowns_are_drawn_from_everywhere() {
    for (name, leaves) in crowns() {
        let lod = build(&plant(&leaves), &Params { shrink: 0.5, contrast: true, ..params() });
        for (from, view) in cameras() {
            let frame = draw(&lod, &view);
            assert!(frame.color.iter().all(|color| color.is_finite()), "{name}, {from}");
        }
    }
}

#[test]
fn arguments_out_of_range_are_refused() {
    let plant = plant(&[facing(0.0, 0.0, 0.0, 1.0)]);
    let says = |params: Params| {
        let built = StochasticPruning::build(&plant, &params, &Job::default());
        built.expect_err("refused").to_string()
    };
    assert!(says(Params { leaf_width_px: 0.0, ..params() }).starts_with("leaf_width_px"), "0");
    assert!(says(Params { half_ratio: 1.0, ..params() }).starts_with("half_ratio"), "1");
    assert!(says(Params { shrink: f64::NAN, ..params() }).starts_with("shrink"), "NaN");
    let lod = build(&plant, &params());
    assert!(lod.at(0.0).is_err() && lod.at(1.5).is_err(), "shares");
    let bare = plant_at(DVec3::ZERO, &[facing(0.0, 0.0, 0.0, 1.0)], &[]);
    let error = StochasticPruning::build(&bare, &params(), &Job::default()).expect_err("none");
    assert!(error.to_string().starts_with("foliage is empty"), "{error}");
}
