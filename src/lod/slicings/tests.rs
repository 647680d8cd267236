//! Slicings of tiny hand-made crowns, and of every crown and camera that is awkward.

use std::collections::BTreeMap;

use glam::{DAffine3, DQuat, DVec3, Vec3, Vec4};

use super::{Correction, LargeLeaves, Measured, Params, Slicings};
use crate::draw_list::{Blend, DrawList};
use crate::error::LodError;
use crate::job::Job;
use crate::lod::full_mesh::FullMesh;
use crate::lod::leaves::{Leaves, Placed};
use crate::lod::level_rule::LevelRule;
use crate::lod::made::{
    Leaf, cameras, crown_at, crowns, draw, emit, facing, from_azimuth, parallel, perspective,
    plant, plant_at, random_crown,
};
use crate::lod::opacity::{Opacity, all_around};
use crate::lod::slabs::{Assignment, Cut, Layout};
use crate::lod::stack::Baked;
use crate::lod::view_blend::{ViewBlend, circle};
use crate::lod::wood::Wood;
use crate::lod::{Footprint, ListBuilder, Representation};
use crate::plant::{AlphaMode, Plant};
use crate::texture::{Filter, Format};
use crate::view::View;
use crate::view_state::ViewState;

pub(super) fn params(slicing_count: usize, slice_count: usize, side: u32) -> Params {
    Params {
        blend: ViewBlend::new(&circle(slicing_count), None).expect("even"),
        slice_counts: vec![slice_count],
        rule: LevelRule::Pixels(1.0),
        resolution: (side, side),
        sample_count: 1,
        correction: Correction::Linear(0.5),
        large_leaves: LargeLeaves::Split,
        drop_back: 0,
        mirrored: false,
        sub_slices: 1,
        quadtree: None,
        branch_level: None,
        format: Format::Rgba8,
        wood: Wood::Full,
        views: None,
    }
}

pub(super) fn build(plant: &Plant, params: &Params) -> (Slicings, Measured) {
    Slicings::build(plant, params, &Job::default()).expect("valid")
}

/// Slicing, slice, and what was baked for it.
pub(super) fn baked_slices(lod: &Slicings) -> impl Iterator<Item = (usize, usize, &Baked)> {
    let stacks = lod.parts[0].levels[0].stacks.iter().enumerate();
    let stacks = stacks.filter_map(|(number, stack)| Some((number, stack.as_ref()?)));
    stacks.flat_map(|(number, stack)| stack.baked().map(move |(index, b)| (number, index, b)))
}

fn assign(layout: Layout, leaves: &Leaves<'_>, in_mesh: &[bool]) -> Assignment {
    layout.assign(leaves, layout.rect(leaves), Cut::Large, |leaf| in_mesh[leaf])
}

/// Slicing and slice of every card of a list, in paint order.
pub(super) fn cards(lod: &Slicings, list: &DrawList) -> Vec<(usize, usize)> {
    let places: BTreeMap<u32, (usize, usize)> = baked_slices(lod)
        .map(|(number, index, baked)| (baked.tiles[0].cards.start, (number, index)))
        .collect();
    let blended = list.items.iter().filter(|item| item.blend == Blend::Over);
    blended.map(|item| places[&item.primitives.start]).collect()
}

/// Alphas of a slicing's slices, each 0 to 255, at the finest level.
pub(super) fn alphas(lod: &Slicings, slicing: usize) -> Vec<Vec<u8>> {
    baked_slices(lod)
        .filter(|&(number, ..)| number == slicing)
        .map(|(_, _, baked)| {
            baked.tiles[0].texture.levels()[0].texels.iter().map(|t| t[3]).collect()
        })
        .collect()
}

fn layout(offsets: &[f64], slice_count: usize) -> Layout {
    let centers: Vec<DVec3> = offsets.iter().map(|&z| DVec3::Z * z).collect();
    Layout::new(DVec3::Z, &centers, slice_count, 2.0)
}

#[test]
fn a_leaf_goes_to_the_nearest_slice_and_on_a_tie_to_the_lower() {
    //  slices        0       1       2       3       planes at -1.5, -0.5, 0.5, 1.5
    //            |-------|-------|-------|-------|   borders at -2, -1, 0, 1, 2
    let four = layout(&[-2.0, 2.0], 4);
    let planes: Vec<f64> = (0..4).map(|slice| four.offset(slice)).collect();
    assert_eq!((four.spacing, planes), (1.0, vec![-1.5, -0.5, 0.5, 1.5]), "evenly about 0");
    for (offset, slice) in [(-2.0, 0), (-1.2, 0), (-0.8, 1), (0.3, 2), (1.1, 3), (2.0, 3)] {
        assert_eq!(four.nearest(offset), slice, "at {offset}");
    }
    for (offset, slice) in [(-1.0, 0), (0.0, 1), (1.0, 2)] {
        assert_eq!(four.nearest(offset), slice, "between two at {offset}");
        assert_eq!(four.nearest(offset + 1e-12), slice, "rounding at {offset}");
        assert_eq!(four.nearest(offset + 1e-6), slice + 1, "above {offset}");
    }
    assert_eq!((four.nearest(-1e9), four.nearest(1e9)), (0, 3), "beyond the outermost");
    // borders that no f64 holds
    let three = layout(&[-0.1, 0.1], 3);
    assert_eq!(three.nearest(0.1 / 3.0), 1, "between the second and the third");
    assert_eq!(three.nearest(-0.1 / 3.0), 0, "between the first and the second");
}

#[test]
fn slabs_share_their_borders_to_the_bit() {
    let crown = plant(&[facing(0.3, 0.0, -0.7, 0.2), facing(0.0, 0.1, 0.9, 0.1)]);
    let crowned = Leaves::new(&crown).expect("leaves");
    for count in [1, 2, 3, 5, 7, 64] {
        for toward in circle(7) {
            let layout = Layout::new(toward, &crowned.leaf_centers, count, crowned.radius);
            let assignment = assign(layout, &crowned, &[false; 2]);
            assert_eq!(layout.slab(0).0, f64::NEG_INFINITY, "{count}: the first is open");
            assert_eq!(layout.slab(count - 1).1, f64::INFINITY, "{count}: so is the last");
            assert_eq!(assignment.slab(0)[1], f32::INFINITY, "{count}: any depth");
            assert_eq!(assignment.slab(count - 1)[0], 0.0, "{count}: from the eye");
            for slice in 1..count {
                assert_eq!(layout.slab(slice - 1).1, layout.slab(slice).0, "{count}, {slice}");
                let (far, near) = (assignment.slab(slice - 1), assignment.slab(slice));
                assert_eq!(far[0], near[1], "{count}, {slice}: depths");
                let middle = (layout.offset(slice - 1) + layout.offset(slice)) / 2.0;
                assert!((layout.slab(slice).0 - middle).abs() < 1e-12, "half way between planes");
            }
        }
    }
}

#[test]
fn a_crown_without_depth_is_one_slice() {
    let sheet = [facing(0.0, 0.0, 0.0, 0.1), facing(1.0, 0.0, 0.0, 0.1)];
    let (lod, _) = build(&plant(&sheet), &params(4, 5, 8));
    let counts: Vec<usize> = lod.parts[0].stacks().map(|stack| stack.slices.len()).collect();
    assert_eq!(counts, [1, 5, 1, 5], "flat as seen along z, deep along x");
    // nothing is cut where there is nothing to cut between
    let deep = [facing(0.0, 0.0, 0.0, 0.1), (Vec3::X, Vec3::Z * 9.0, Vec3::Y * 0.1)];
    let crown = plant(&deep);
    let crowned = Leaves::new(&crown).expect("leaves");
    let layout = Layout::new(DVec3::Z, &crowned.leaf_centers, 5, crowned.radius);
    assert!(!layout.is_large(&crowned, 1), "one slice holds it all");
}

#[test]
fn leaves_are_large_above_the_spacing() {
    // spacing 1 along z; lengths along z of 0, 1 (exactly the spacing) and 1.2
    let ends = [facing(-3.0, 0.0, -2.5, 0.1), facing(3.0, 0.0, 2.5, 0.1)];
    let long = |half: f32| (Vec3::new(0.0, 0.0, 0.25), Vec3::Z * half, Vec3::Y * 0.2);
    let crown = plant(&[ends[0], ends[1], long(0.5), long(0.6)]);
    let crowned = Leaves::new(&crown).expect("leaves");
    let layout = Layout::new(DVec3::Z, &crowned.leaf_centers, 5, crowned.radius);
    assert_eq!(layout.spacing, 1.0, "5 m of centres");
    let large: Vec<bool> = (0..4).map(|leaf| layout.is_large(&crowned, leaf)).collect();
    assert_eq!(large, [false, false, false, true], "only what is longer");
    let leaves = assign(layout, &crowned, &[false; 4]).leaves;
    let whole = |leaf| Placed { leaf, cut: false };
    let cut = |leaf| Placed { leaf, cut: true };
    // the long one reaches from -0.35 to 0.85, over the border at 0.5
    let expected = [vec![whole(0)], vec![], vec![whole(2), cut(3)], vec![cut(3)], vec![whole(1)]];
    assert_eq!(leaves, expected, "cut leaves go to every slab that they reach");
    let leaves = assign(layout, &crowned, &[false, false, false, true]).leaves;
    assert_eq!(leaves[2..4], [vec![whole(2)], vec![]], "left out");
}

/// A card that leans through all of a crown of 5 m, and two small leaves that give it its depth.
fn leaning() -> [Leaf; 3] {
    [
        (Vec3::new(-1.4, 0.9, -2.5), Vec3::new(0.05, 0.0, -0.05), Vec3::Y * 0.05),
        (Vec3::ZERO, Vec3::new(0.5, 0.1, 2.4), Vec3::new(-0.1, 0.6, 0.0)),
        (Vec3::new(1.4, -0.9, 2.5), Vec3::new(0.05, 0.0, -0.05), Vec3::Y * 0.05),
    ]
}

#[test]
fn every_sample_of_a_cut_leaf_is_in_exactly_one_slice() {
    let crown = plant(&leaning());
    for (sample_count, side) in [(1, 61), (16, 32)] {
        for slice_count in [2, 5, 16] {
            let with = |slice_count| Params { sample_count, ..params(5, slice_count, side) };
            let (whole, _) = build(&crown, &with(1));
            let (sliced, measured) = build(&crown, &with(slice_count));
            assert!(measured.large_leaf_count >= 1, "{measured:?}");
            for slicing in 0..5 {
                let wanted = &alphas(&whole, slicing)[0];
                let slices = alphas(&sliced, slicing);
                let of = |texel: usize| slices.iter().map(move |slice| slice[texel]);
                let sums: Vec<u32> =
                    (0..wanted.len()).map(|texel| of(texel).map(u32::from).sum()).collect();
                let total: u32 = wanted.iter().map(|&alpha| u32::from(alpha)).sum();
                assert!(total > 255 * 10, "slicing {slicing} shows something: {total}");
                if sample_count == 1 {
                    for (texel, &alpha) in wanted.iter().enumerate() {
                        let what = (slice_count, slicing, texel);
                        assert_eq!(sums[texel], u32::from(alpha), "all of it, once: {what:?}");
                        assert!(of(texel).all(|a| a == 0 || a == 255), "all or nothing: {what:?}");
                    }
                } else {
                    // what 8-bit storage of several parts instead of one may add up to
                    let bias = (f64::from(sums.iter().sum::<u32>()) - f64::from(total))
                        / (255.0 * wanted.len() as f64);
                    assert!(bias.abs() <= 1e-3, "{slice_count} slices, {slicing}: {bias}");
                }
            }
            if slice_count == 5 {
                assert!(alphas(&sliced, 0).len() == 5, "the card reaches all slabs along z");
            }
        }
    }
}

#[test]
fn the_baked_picture_has_the_leaves_size() {
    // seen along z, 1.2 x 0.8 m in a rectangle of 4 x 2 m, at (1.0, 0.4) from its middle
    let leaf = (Vec3::new(1.0, 0.4, 0.0), Vec3::X * 0.6, Vec3::Y * 0.4);
    let ends = [facing(-1.9, -0.9, -1.0, 0.1), facing(1.9, 0.9, 1.0, 0.1)];
    let crown = plant(&[leaf, ends[0], ends[1]]);
    let (lod, _) = build(&crown, &Params { resolution: (40, 20), ..params(1, 2, 1) });
    let (_, _, baked) = baked_slices(&lod).next().expect("the lower slice");
    assert_eq!((baked.rect.width, baked.rect.height), (4.0, 2.0), "encloses every vertex");
    assert_eq!(baked.rect.center, DVec3::Z * -0.5, "the lower of two planes");
    let alpha = |slice: usize, x: usize, y: usize| alphas(&lod, 0)[slice][y * 40 + x];
    let count = |slice: usize| alphas(&lod, 0)[slice].iter().filter(|&&a| a == 255).count();
    // 10 texels a metre; a tie in depth goes to the lower slice
    assert_eq!((count(0), count(1)), (12 * 8 + 2 * 2, 2 * 2), "areas in texels");
    assert_eq!((alpha(0, 24, 2), alpha(0, 35, 9)), (255, 255), "opposite corners of the leaf");
    assert_eq!((alpha(0, 23, 2), alpha(0, 36, 9), alpha(0, 35, 10)), (0, 0, 0), "beside them");
    assert_eq!((alpha(0, 0, 19), alpha(1, 39, 0)), (255, 255), "left below behind, right above");
}

#[test]
fn large_leaves_in_the_mesh_are_drawn_there_and_nowhere_else() {
    let trunk = (Vec3::new(0.0, -3.0, 0.0), Vec3::X * 0.1, Vec3::Y * 2.0);
    let crown = plant_at(DVec3::ZERO, &[trunk], &leaning());
    let with = Params { large_leaves: LargeLeaves::Mesh, ..params(4, 5, 61) };
    let (lod, measured) = build(&crown, &with);
    let (split, same) = build(&crown, &params(4, 5, 61));
    assert_eq!(measured.large_leaf_count, same.large_leaf_count, "counted alike");
    assert_eq!(lod.footprint().triangle_count, 4, "the trunk's two and the leaning card's two");
    assert_eq!(split.footprint().triangle_count, 2, "the trunk alone");
    for slicing in 0..4 {
        let slices = alphas(&lod, slicing);
        assert_eq!(slices.len(), 2, "only the outermost hold a small leaf");
        let texels = slices.iter().flatten().filter(|&&alpha| alpha > 0).count();
        let small = alphas(&split, slicing).iter().flatten().filter(|&&a| a > 0).count();
        assert!(texels * 20 < small, "{texels} texels without the card, {small} with it");
    }
    // the card's own triangles: the trunk has 0 and 1, the first small leaf 2 and 3
    let list =
        emit(&lod, &parallel(DVec3::Z, DVec3::Y, 8.0, 8), &[crown_at(DAffine3::IDENTITY, 0)]);
    assert_eq!(list.geometries[0].buffers().source_ids, [0, 1, 4, 5], "ids of the plant");
    // nothing is lost: from an axis the same samples are covered as by the full mesh
    let full =
        FullMesh::build(&crown, Wood::Full, Filter::Bilinear, &Job::default()).expect("valid");
    let view = parallel(DVec3::X, DVec3::Y, 8.0, 64);
    let alpha = |lod: &dyn Representation| -> f64 {
        draw(lod, &view).color.iter().map(|pixel| f64::from(pixel.w)).sum::<f64>() / (64.0 * 64.0)
    };
    let difference = alpha(&lod) - alpha(&full);
    assert!(difference.abs() < 2e-3, "small leaves are blurred, no more: {difference}");
}

#[test]
fn opacities_follow_their_laws() {
    let linear = |m: f64, shares: &[f64]| {
        Opacity::Linear { m }.of(&shares.iter().copied().enumerate().collect::<Vec<_>>())
    };
    assert_eq!(linear(0.5, &[1.0]), [1.0], "on axis");
    assert_eq!(linear(0.5, &[0.5, 0.5]), [0.625, 0.625], "half way: 0.5 (1 + 0.5 * 0.5)");
    assert_eq!(linear(1.0, &[0.5, 0.5]), [0.75, 0.75], "half way, m = 1");
    assert_eq!(linear(0.5, &[0.25, 0.75]), [0.28125, 0.84375], "f = 1.125");
    assert_eq!(linear(4.0, &[0.5, 0.5]), [1.0, 1.0], "clamped");
    assert_eq!(linear(0.0, &[0.25, 0.75]), [0.25, 0.75], "none");
    assert_eq!(linear(2.0, &[0.25, 0.25, 0.5]), [0.5, 0.5, 1.0], "three: by the largest share");
    for tau in [1e-9, 0.3, 2.0, 20.0] {
        for share in [0.1, 0.5, 0.9] {
            let found = Opacity::Optical { tau }.of(&[(0, share), (1, 1.0 - share)]);
            for (opacity, share) in found.iter().zip([share, 1.0 - share]) {
                // what both let through together is what one lets through
                let through = 1.0 - opacity * (1.0 - libm::exp(-tau));
                assert!((through - libm::exp(-share * tau)).abs() < 1e-12, "tau {tau}, {share}");
            }
        }
        assert_eq!(Opacity::Optical { tau }.of(&[(3, 1.0)]), [1.0], "on axis, tau {tau}");
    }
    assert_eq!(Opacity::Optical { tau: 0.0 }.of(&[(0, 0.3)]), [0.3], "nothing there");
}

#[test]
fn tau_is_the_depth_of_the_mean_alpha_inside_the_silhouette() {
    // two slices that fill the left half of the rectangle, one behind the other, and 2 x 2 texels
    // in the right half of the nearer: of 8 x 8 texels 36 are inside
    let left = |z: f32| (Vec3::new(-1.0, 0.0, z), Vec3::X, Vec3::Y * 2.0);
    let right = (Vec3::new(1.0, 0.0, 1.0), Vec3::X * 0.3, Vec3::Y * 0.3);
    let (_, measured) = build(&plant(&[left(-1.0), left(1.0), right]), &params(1, 2, 8));
    let mean: f64 = (32.0 + 36.0) / (2.0 * 36.0);
    assert!((measured.levels[0].tau + libm::log1p(-mean)).abs() < 1e-9, "{measured:?}");
    let sheet = plant(&[(Vec3::ZERO, Vec3::X, Vec3::Y)]);
    let (_, measured) = build(&sheet, &params(1, 1, 8));
    assert!(
        measured.levels[0].tau > 20.0 && measured.levels[0].tau.is_finite(),
        "no hole: {measured:?}"
    );
}

#[test]
fn a_fit_is_as_opaque_from_all_around_as_on_its_axes() {
    let crown = plant(&random_crown(400));
    let with = |correction| Params { correction, sample_count: 4, ..params(4, 3, 64) };
    let job = Job::default();
    let (fitted, measured) = build(&crown, &with(Correction::Fit));
    let (plain, _) = build(&crown, &with(Correction::Linear(0.0)));
    assert_eq!(measured.levels[0].fitted, Some(true), "{measured:?}");
    let mean = |lod: &Slicings, over: &[DVec3]| {
        let law = lod.parts[0].levels[0].opacity;
        lod.parts[0].mean_alpha((0, law), &lod.cards, over, &job).expect("valid")
    };
    let around = all_around(true);
    let wanted = mean(&plain, &circle(4));
    let (before, after) = (mean(&plain, &around), mean(&fitted, &around));
    assert!(before < 0.95 * wanted, "too thin between the axes: {before} for {wanted}");
    // m is within 1e-3 of the root, and alpha changes by less than m does
    assert!((after - wanted).abs() < 1e-3 * wanted, "{after} for {wanted}");
    // one slicing cannot be opaque from its side, whatever m
    let (_, measured) = build(&crown, &Params { correction: Correction::Fit, ..params(1, 3, 16) });
    assert_eq!(
        (measured.levels[0].fitted, measured.levels[0].m),
        (Some(false), Some(0.0)),
        "the nearer end"
    );
}

#[test]
fn slices_are_painted_far_to_near_and_the_secondary_first() {
    let trunk = (Vec3::new(0.0, -2.0, 0.0), Vec3::X * 0.1, Vec3::Y);
    let (lod, _) = build(&plant_at(DVec3::ZERO, &[trunk], &random_crown(300)), &params(6, 3, 16));
    let here = [crown_at(DAffine3::IDENTITY, 0)];
    let order = |view: &View| cards(&lod, &emit(&lod, view, &here));
    let from = |degrees: f64| perspective(from_azimuth(degrees) * 9.0, DVec3::ZERO, DVec3::Y);
    let pair = |secondary: usize, primary: usize| -> Vec<(usize, usize)> {
        (0..3).flat_map(|slice| [(secondary, slice), (primary, slice)]).collect()
    };
    assert_eq!(order(&from(20.0)), pair(1, 0), "a third of the way");
    assert_eq!(order(&from(40.0)), pair(0, 1), "two thirds");
    assert_eq!(order(&from(30.0)), pair(1, 0), "half way: the lower index is primary");
    assert_eq!(order(&from(330.0)), pair(5, 0), "half way across 0");
    assert_eq!(order(&from(120.0)), [(2, 0), (2, 1), (2, 2)], "on an axis");
    let list = emit(&lod, &from(20.0), &here);
    assert_eq!(list.items[0].blend, Blend::Opaque, "wood first");
    assert!(list.items[1..].iter().all(|item| item.blend == Blend::Over), "then slices");
    assert!(list.items[1..].iter().all(|item| !item.depth_write), "which hide nothing");
    // shares 1/3 and 2/3, f = 1 + 0.5 / 3
    let opacity = |item: usize| list.instances[list.items[item].instances.start as usize].tint.w;
    assert!((opacity(1) - 7.0 / 18.0).abs() < 1e-6, "secondary: {}", opacity(1));
    assert!((opacity(2) - 7.0 / 9.0).abs() < 1e-6, "primary: {}", opacity(2));
    // the crown decides, not where the camera looks
    let aside = perspective(from_azimuth(20.0) * 9.0, DVec3::X * 3.0, DVec3::Y);
    assert_eq!(order(&aside), pair(1, 0), "the camera turned aside");
    let parallel_view = parallel(from_azimuth(20.0), DVec3::Y, 4.0, 8);
    assert_eq!(order(&parallel_view), pair(1, 0), "a parallel view");
    // straight down with -z up: as from +z
    let above = perspective(DVec3::Y * 9.0, DVec3::ZERO, DVec3::NEG_Z);
    assert_eq!(order(&above).iter().filter(|card| card.0 == 0).count(), 3, "slicing 0 alone");
}

#[test]
fn slices_seen_from_behind_are_painted_the_other_way_round() {
    let crown = plant(&random_crown(300));
    let (lod, _) = build(&crown, &params(1, 4, 16));
    let here = [crown_at(DAffine3::IDENTITY, 0)];
    let order = |view: &View| -> Vec<usize> {
        cards(&lod, &emit(&lod, view, &here)).into_iter().map(|(_, slice)| slice).collect()
    };
    let from = |z: f64, to: f64| perspective(DVec3::Z * z, DVec3::Z * to, DVec3::Y);
    assert_eq!(order(&from(9.0, 0.0)), [0, 1, 2, 3], "from the front");
    assert_eq!(order(&from(-9.0, 0.0)), [3, 2, 1, 0], "from behind");
    assert_eq!(order(&parallel(DVec3::NEG_Z, DVec3::Y, 4.0, 8)), [3, 2, 1, 0], "in parallel");
    assert_eq!(order(&parallel(DVec3::X, DVec3::Y, 4.0, 8)), [0, 1, 2, 3], "edge on");
    // between the second and the third, whose planes are at -0.25 and 0.25 of the depth
    let inside = order(&from(0.01, 3.0));
    let place = |slice: usize| inside.iter().position(|&s| s == slice).expect("drawn");
    assert!(place(3) < place(2), "ahead, the farther one first: {inside:?}");
    assert!(place(0) < place(1), "and behind the eye too: {inside:?}");
}

#[test]
fn far_crowns_are_painted_before_near_ones() {
    let (lod, _) = build(&plant(&random_crown(100)), &params(4, 2, 8));
    let at = |z: f64, rank: u32| crown_at(DAffine3::from_translation(DVec3::Z * z), rank);
    let view = perspective(DVec3::new(0.1, 0.0, 30.0), DVec3::ZERO, DVec3::Y);
    let list = emit(&lod, &view, &[at(-10.0, 0), at(0.0, 1), at(10.0, 2)]);
    let depths: Vec<f32> = list
        .items
        .iter()
        .map(|item| -list.instances[item.instances.start as usize].translation.z)
        .collect();
    assert!(depths.is_sorted_by(|a, b| a >= b), "by copy: {depths:?}");
    assert!(depths[0] > 39.0 && depths[depths.len() - 1] < 21.0, "all three: {depths:?}");
}

#[test]
fn a_turned_or_mirrored_copy_shows_what_faces_the_viewer() {
    let (lod, _) = build(&plant(&random_crown(100)), &params(4, 2, 8));
    let numbers = |placement: DAffine3| -> Vec<usize> {
        let view = perspective(DVec3::Z * 9.0, DVec3::ZERO, DVec3::Y);
        let list = emit(&lod, &view, &[crown_at(placement, 0)]);
        let mut numbers: Vec<usize> = cards(&lod, &list).into_iter().map(|card| card.0).collect();
        numbers.dedup();
        numbers
    };
    assert_eq!(numbers(DAffine3::IDENTITY), [0], "slicing 0 faces +z");
    let quarter = DAffine3::from_quat(DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2));
    assert_eq!(numbers(quarter), [3], "turned a quarter: its -x faces +z");
    assert_eq!(numbers(DAffine3::from_scale(DVec3::new(1.0, 1.0, -1.0))), [2], "mirrored");
    assert_eq!(numbers(DAffine3::from_scale(DVec3::splat(7.0))), [0], "seven times as large");
}

#[test]
fn stored_bytes_are_those_of_the_format() {
    let crown = plant(&random_crown(100));
    let with = |format| Params { format, ..params(2, 2, 8) };
    let texels = 64 + 16 + 4 + 1;
    let bytes = |format| build(&crown, &with(format)).0.footprint();
    let Footprint { texture_bytes, card_count, .. } = bytes(Format::Rgba8);
    assert_eq!((texture_bytes, card_count), (4 * texels * 4, 4), "four slices of four bytes");
    assert_eq!(bytes(Format::Rgb5a1).texture_bytes, 4 * texels * 2, "two bytes");
    let (short, _) = build(&crown, &with(Format::Rgb5a1));
    let alphas = alphas(&short, 0);
    assert!(alphas.iter().flatten().all(|a| [0, 255].contains(a)), "one bit of alpha");
}

#[test]
fn levels_of_a_slice_keep_its_mean_alpha() {
    let with = Params { sample_count: 16, ..params(3, 3, 48) };
    let (lod, _) = build(&plant(&random_crown(200)), &with);
    for (number, index, baked) in baked_slices(&lod) {
        let mean = |level: &crate::texture::Image| {
            let sum: f64 = level.texels.iter().map(|texel| f64::from(texel[3])).sum();
            sum / (255.0 * level.texels.len() as f64)
        };
        let base = mean(&baked.tiles[0].texture.levels()[0]);
        assert!(base > 0.01, "slicing {number}, slice {index} shows something: {base}");
        for (level, image) in baked.tiles[0].texture.levels().iter().enumerate() {
            // each level is rounded to 8 bits from unrounded sums
            let miss = (mean(image) - base).abs();
            assert!(miss <= 0.5 / 255.0, "slicing {number}, slice {index}, level {level}: {miss}");
        }
    }
}

#[test]
fn views_bake_what_they_show_and_no_more() {
    let crown = plant(&random_crown(300));
    let view = perspective(from_azimuth(20.0) * 9.0, DVec3::ZERO, DVec3::Y);
    let narrow = Params { views: Some(vec![view.clone()]), ..params(6, 3, 64) };
    let (lod, _) = build(&crown, &narrow);
    assert_eq!(lod.baked(), [true, true, false, false, false, false], "a pair");
    // the nearest point of the crown's ball is at 9 m - R; 24 rows show 2 tan(0.5) m at 1 m
    let nearest = 9.0 - lod.parts[0].radius;
    let per_metre = 24.0 / (2.0 * libm::tan(0.5) * nearest);
    for (_, _, baked) in baked_slices(&lod) {
        let side = |metres: f64| (per_metre * metres).ceil();
        let wanted = (side(baked.rect.width), side(baked.rect.height));
        let (width, height) = baked.tiles[0].texture.size();
        let found = (f64::from(width), f64::from(height));
        assert_eq!(found, wanted, "a texel for each pixel of the nearest view");
        assert!(width < 64 && height < 64, "fewer than asked for");
    }
    let everywhere = Params { resolution: (64, 64), ..params(6, 3, 64) };
    assert_eq!(cards(&lod, &emit(&lod, &view, &[crown_at(DAffine3::IDENTITY, 0)])).len(), 6, "all");
    // the nearest of several decides
    let far = perspective(from_azimuth(20.0) * 20.0, DVec3::ZERO, DVec3::Y);
    for views in [[view.clone(), far.clone()], [far, view.clone()]] {
        let both = Params { views: Some(views.to_vec()), ..params(6, 3, 64) };
        assert_eq!(build(&crown, &both).0.footprint(), lod.footprint(), "as for the nearer one");
    }
    let other = perspective(from_azimuth(200.0) * 9.0, DVec3::ZERO, DVec3::Y);
    let mut builder = ListBuilder::default();
    let crowns = [crown_at(DAffine3::IDENTITY, 0)];
    let refused = lod.emit(&other, &crowns, &mut ViewState::default(), &mut builder);
    let message = refused.expect_err("not baked").to_string();
    assert!(message.starts_with("camera: this camera needs slicing 4"), "{message}");
    // from close by the stated resolution is the limit, and the picture that of a full build
    let close = perspective(from_azimuth(20.0) * 2.5, DVec3::ZERO, DVec3::Y);
    let capped = Params { views: Some(vec![view, close.clone()]), ..params(6, 3, 8) };
    let (few, _) = build(&crown, &capped);
    assert!(
        baked_slices(&few).all(|(_, _, baked)| baked.tiles[0].texture.size() == (8, 8)),
        "capped"
    );
    let (all, _) = build(&crown, &Params { resolution: (8, 8), ..everywhere });
    assert_eq!(draw(&few, &close).color, draw(&all, &close).color, "the same picture");
    for (views, name) in [(vec![], "views"), (vec![close], "correction")] {
        let with = Params { views: Some(views), correction: Correction::Fit, ..params(6, 3, 8) };
        let error = Slicings::build(&crown, &with, &Job::default()).expect_err("refused");
        assert!(error.to_string().starts_with(name), "{error}");
    }
}

#[test]
fn an_eye_at_the_centre_counts_as_looking_from_behind_itself() {
    let (lod, _) = build(&plant(&random_crown(100)), &params(6, 2, 8));
    let primary = |eye: DVec3| {
        let view = perspective(eye, eye - from_azimuth(70.0), DVec3::Y);
        let list = emit(&lod, &view, &[crown_at(DAffine3::IDENTITY, 0)]);
        cards(&lod, &list).last().map(|card| card.0)
    };
    let aside = from_azimuth(180.0) * lod.parts[0].radius;
    assert_eq!(primary(aside * 0.9e-3), Some(1), "70 degrees: the viewing direction");
    assert_eq!(primary(aside * 1.1e-3), Some(3), "180 degrees: where it stands");
}

#[test]
fn far_away_cards_are_read_through_their_levels() {
    // stripes of one texel on, one off; 64 texels on 5 pixels, whose samples lie anywhere between
    let mut stripes: Vec<Leaf> = (0..32_u8)
        .map(|i| (Vec3::X * (f32::from(i) * 2.0 - 31.0), Vec3::X * 0.5, Vec3::Y * 32.0))
        .collect();
    stripes.extend([-31.5, 31.5].map(|x| (Vec3::X * x, Vec3::X * 0.5, Vec3::ZERO)));
    let (lod, _) = build(&plant(&stripes), &params(1, 1, 64));
    let (_, _, baked) = baked_slices(&lod).next().expect("one slice");
    assert_eq!((baked.rect.width, baked.rect.height), (64.0, 64.0), "a metre a texel");
    let view = parallel(DVec3::Z, DVec3::Y, 64.0, 5);
    for pixel in draw(&lod, &view).color {
        assert!((pixel.w - 0.5).abs() < 0.01, "half covered: {}", pixel.w);
    }
}

#[test]
fn a_leaf_at_one_edge_does_not_show_at_the_other() {
    // the left column of texels, and nothing but a point on the right
    let left = (Vec3::X * -3.5, Vec3::X * 0.5, Vec3::Y * 4.0);
    let right = (Vec3::X * 3.5, Vec3::X * 0.5, Vec3::ZERO);
    let (lod, _) = build(&plant(&[left, right]), &params(1, 1, 8));
    let frame = draw(&lod, &parallel(DVec3::Z, DVec3::Y, 8.0, 64));
    let row = &frame.color[32 * 64..33 * 64];
    assert!(row[0].w > 0.99, "opaque up to the edge: {}", row[0].w);
    assert!(row[16..].iter().all(|pixel| pixel.w == 0.0), "and nothing on the other side");
}

#[test]
fn every_awkward_crown_and_camera_gives_a_picture() {
    for (name, leaves) in crowns() {
        let crown = plant(&leaves);
        for (slicing_count, slice_count) in [(1, 1), (2, 2), (6, 5)] {
            for correction in [Correction::Linear(0.5), Correction::Optical, Correction::Fit] {
                let job = Job::default();
                let with = Params { correction, ..params(slicing_count, slice_count, 8) };
                let built = Slicings::build(&crown, &with, &job);
                let what = format!("{name}: {slicing_count} x {slice_count}, {correction:?}");
                let (lod, measured) = built.unwrap_or_else(|error| panic!("{what}: {error}"));
                let (done, total) = job.progress();
                assert_eq!(done, total, "{what}: all steps that were announced");
                assert!(
                    measured.levels[0].tau.is_finite() && measured.levels[0].tau >= 0.0,
                    "{what}: {measured:?}"
                );
                let (low, high) = lod.bounds();
                assert!(low.is_finite() && high.is_finite(), "{what}: {low} to {high}");
                if correction == Correction::Fit {
                    assert!(
                        measured.levels[0].m.is_some_and(|m| (0.0..=4.0).contains(&m)),
                        "{what}"
                    );
                    continue;
                }
                for (camera, view) in cameras() {
                    let frame = draw(&lod, &view);
                    let fine = |pixel: &Vec4| {
                        pixel.is_finite() && pixel.min_element() >= 0.0 && pixel.w <= 1.0 + 1e-6
                    };
                    assert!(frame.color.iter().all(fine), "{what}, {camera}");
                    let depths = frame.depth.iter().all(|&d| d > 0.0);
                    assert!(depths, "{what}, {camera}: no NaN, nothing behind");
                }
            }
        }
    }
}

#[test]
fn what_has_area_is_seen_from_its_axis() {
    let view = parallel(DVec3::Z, DVec3::Y, 6.0, 48);
    for (name, leaves) in crowns() {
        let (lod, _) = build(&plant(&leaves), &params(6, 5, 32));
        let mean = |lod: &dyn Representation| {
            let frame = draw(lod, &view);
            frame.color.iter().map(|pixel| f64::from(pixel.w)).sum::<f64>() / (48.0 * 48.0)
        };
        let full = FullMesh::build(&plant(&leaves), Wood::Full, Filter::Bilinear, &Job::default())
            .expect("leaves");
        let (sliced, wanted) = (mean(&lod), mean(&full));
        // texels of 1/32 of the crown's width smear its outline by half a texel on each side
        assert!((sliced - wanted).abs() <= 0.012, "{name}: {sliced} for {wanted}");
        if ["no area", "a point", "needles"].contains(&name) {
            assert_eq!((sliced, lod.footprint().card_count), (0.0, 0), "{name}: nothing to see");
        }
    }
}

#[test]
fn size_and_place_do_not_change_the_picture() {
    let crown: Vec<Leaf> = random_crown(60);
    let (lod, _) = build(&plant(&crown), &params(6, 5, 16));
    let view = |scale: f64, origin: DVec3| {
        let eye = DVec3::new(1.5, 0.5, 3.25);
        perspective(origin + eye * scale, origin, DVec3::Y)
    };
    let wanted = draw(&lod, &view(1.0, DVec3::ZERO));
    assert!(wanted.color.iter().any(|pixel| pixel.w > 0.5), "it is in the picture");
    // powers of two, with which every rounding stays the same: 0.1 mm, 8 km, and 1e6 m away
    for exponent in [-13, 13] {
        let scale = 2.0_f32.powi(exponent);
        let scaled: Vec<Leaf> =
            crown.iter().map(|&(a, b, c)| (a * scale, b * scale, c * scale)).collect();
        let (lod, _) = build(&plant(&scaled), &params(6, 5, 16));
        let frame = draw(&lod, &view(f64::from(scale), DVec3::ZERO));
        assert_eq!(frame.color, wanted.color, "2^{exponent} times as large");
    }
    let origin = DVec3::new(1_048_576.0, -524_288.0, 2_097_152.0);
    let (far, _) = build(&plant_at(origin, &[], &crown), &params(6, 5, 16));
    assert_eq!(draw(&far, &view(1.0, origin)).color, wanted.color, "far from the world's origin");
    assert_eq!(far.origin(), origin, "where it stands");
}

#[test]
fn bad_parameters_are_refused_by_name() {
    let crown = plant(&random_crown(10));
    let refused = |with: Params| {
        Slicings::build(&crown, &with, &Job::default()).expect_err("refused").to_string()
    };
    let good = || params(2, 2, 8);
    let cases = [
        ("slice_count", Params { slice_counts: vec![0], ..good() }),
        ("slice_count", Params { slice_counts: vec![5000], ..good() }),
        ("resolution", Params { resolution: (0, 8), ..good() }),
        ("resolution", Params { resolution: (8, 1_000_000), ..good() }),
        ("resolution", Params { slice_counts: vec![4096], resolution: (4096, 4096), ..good() }),
        ("samples", Params { sample_count: 2, ..good() }),
        ("samples", Params { sample_count: 0, ..good() }),
        ("correction", Params { correction: Correction::Linear(-0.1), ..good() }),
        ("correction", Params { correction: Correction::Linear(f64::NAN), ..good() }),
        ("wood_triangle_count", Params { wood: Wood::Simplified(0), ..good() }),
    ];
    for (name, with) in cases {
        let message = refused(with);
        assert!(message.starts_with(name), "{name}: {message}");
    }
    let bare = plant_at(DVec3::ZERO, &[facing(0.0, 0.0, 0.0, 1.0)], &[]);
    let error = Slicings::build(&bare, &good(), &Job::default()).expect_err("no leaves");
    assert!(error.to_string().starts_with("foliage is empty"), "{error}");
    let job = Job::default();
    job.cancel();
    let stopped = Slicings::build(&crown, &good(), &job).expect_err("cancelled");
    assert_eq!(stopped, LodError::Cancelled, "stopped");
}

#[test]
fn blended_leaves_are_baked_far_to_near() {
    // two half-transparent squares on one another, the nearer one first in the file
    let mut crown = plant(&[facing(0.0, 0.0, 0.1, 1.0), facing(0.0, 0.0, -0.1, 1.0)]);
    crown.materials[0].alpha_mode = AlphaMode::Blend;
    let mesh = &mut crown.foliage.mesh;
    for (vertex, base) in mesh.base.iter_mut().enumerate() {
        base.w = 0.5;
        mesh.front[vertex] = if vertex < 4 { Vec3::X } else { Vec3::Y };
    }
    let (lod, _) = build(&crown, &params(1, 1, 4));
    let (_, _, baked) = baked_slices(&lod).next().expect("one slice");
    let [red, green, _, alpha] = baked.tiles[0].texture.levels()[0].texel(1, 1);
    assert_eq!(alpha, 191, "0.75 of 255");
    assert!(red > green, "the nearer one on top: {red} to {green}");
}
