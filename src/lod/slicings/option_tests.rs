//! Slicings with fewer slices, shared or parted textures, cells of their own, and branches.

use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec3, Vec4};

use super::tests::{baked_slices, build, cards, params};
use super::{Correction, LargeLeaves, Params, Slicings};
use crate::draw_list::{Blend, DrawList};
use crate::error::LodError;
use crate::job::Job;
use crate::lod::level_rule::LevelRule;
use crate::lod::made::{
    Leaf, cameras, crown_at, crowns, draw, emit, facing, from_azimuth, parallel, perspective,
    plant, random_crown,
};
use crate::lod::view_blend::{ViewBlend, circle};
use crate::lod::{Crown, ListBuilder, Representation};
use crate::plant::{Lighting, Plant, grow};
use crate::view::View;
use crate::view_state::ViewState;

fn here() -> [Crown; 1] {
    [crown_at(DAffine3::IDENTITY, 0)]
}

fn at_distance(distance: f64, degrees: f64) -> View {
    perspective(from_azimuth(degrees) * distance, DVec3::ZERO, DVec3::Y)
}

/// Opacity of each blended item, in paint order.
fn opacities(list: &DrawList) -> Vec<f32> {
    let blended = list.items.iter().filter(|item| item.blend == Blend::Over);
    blended.map(|item| list.instances[item.instances.start as usize].tint.w).collect()
}

fn refused(crown: &Plant, with: &Params) -> String {
    Slicings::build(crown, with, &Job::default()).expect_err("refused").to_string()
}

// Fewer slices

#[test]
fn the_rearmost_slices_are_left_out() {
    let crown = plant(&random_crown(300));
    let with = |drop_back| Params { drop_back, ..params(1, 4, 16) };
    let order = |drop_back: usize, view: &View| -> Vec<usize> {
        let (lod, _) = build(&crown, &with(drop_back));
        cards(&lod, &emit(&lod, view, &here())).into_iter().map(|(_, slice)| slice).collect()
    };
    assert_eq!(order(0, &at_distance(9.0, 0.0)), [0, 1, 2, 3], "all");
    assert_eq!(order(1, &at_distance(9.0, 0.0)), [1, 2, 3], "but the farthest");
    assert_eq!(order(3, &at_distance(9.0, 0.0)), [3], "the nearest alone");
    assert_eq!(order(2, &at_distance(9.0, 180.0)), [1, 0], "from behind the others are rear");
    assert!(refused(&crown, &with(4)).starts_with("drop_back"), "something must be left");
    // a stack of one slice keeps it
    let sheet = plant(&[facing(0.0, 0.0, 0.0, 0.5), facing(1.0, 0.0, 0.0, 0.5)]);
    let (lod, _) = build(&sheet, &with(2));
    assert_eq!(emit(&lod, &at_distance(9.0, 0.0), &here()).items.len(), 1, "flat");
    let all = build(&crown, &with(0)).0.footprint();
    assert_eq!(build(&crown, &with(2)).0.footprint(), all, "other views need what this one drops");
}

#[test]
fn levels_change_where_their_slices_seem_too_far_from_the_leaves() {
    let crown = plant(&random_crown(300));
    let with =
        Params { slice_counts: vec![5, 3, 1], rule: LevelRule::Pixels(2.0), ..params(6, 1, 64) };
    let (lod, measured) = build(&crown, &with);
    // the widest slicing decides: half a spacing, seen at 30 degrees
    let spread = circle(6)
        .iter()
        .flat_map(|u| crown.foliage.centers.iter().map(|p| p.as_dvec3().dot(*u).abs()))
        .fold(0.0, f64::max);
    for (level, count) in measured.levels.iter().zip([5.0, 3.0, 1.0]) {
        let wanted = spread / count * 0.5;
        assert!((level.error - wanted).abs() < 1e-9, "{level:?}: {wanted}");
    }
    // 24 rows show 2 tan(0.5) m at 1 m: two pixels are as large as an error at this depth
    let radius = lod.parts[0].radius;
    let depth = |level: usize| measured.levels[level].error / 2.0 * 24.0 / (2.0 * libm::tan(0.5));
    for (level, slices) in [(1, 3), (2, 1)] {
        let switch = depth(level) + radius;
        let count =
            |distance: f64| cards_of_any_level(&emit(&lod, &at_distance(distance, 0.0), &here()));
        let before = [5, 3][level - 1];
        assert_eq!(count(switch * 0.999), before, "up to {switch} m");
        assert_eq!(count(switch * 1.001), slices, "from {switch} m");
        assert_eq!(lod.level(&at_distance(switch * 1.001, 0.0)), level, "as reported");
    }
    // a larger copy is seen larger
    let doubled = crown_at(DAffine3::from_scale(DVec3::splat(2.0)), 0);
    let far = at_distance((depth(1) + radius) * 1.5, 0.0);
    assert_eq!(emit(&lod, &far, &[doubled]).items.len(), 5, "twice as large");
    assert_eq!(emit(&lod, &far, &here()).items.len(), 3, "as it is");
    // textures of a level have no more texels than its nearest view has pixels
    for (level, error) in measured.levels.iter().map(|level| level.error).enumerate().skip(1) {
        for stack in lod.parts[0].levels[level].stacks.iter().flatten() {
            for (_, baked) in stack.baked() {
                let side = |metres: f64| (metres * 2.0 / error).ceil().clamp(1.0, 64.0);
                let (width, height) = baked.tiles[0].texture.size();
                let found = (f64::from(width), f64::from(height));
                assert_eq!(found, (side(baked.rect.width), side(baked.rect.height)), "{level}");
            }
        }
    }
    let names: Vec<String> = lod.textures().into_iter().map(|named| named.name).collect();
    assert_eq!(names.first().map(String::as_str), Some("level 0, slicing 0, slice 0"), "named");
    assert_eq!(names.last().map(String::as_str), Some("level 2, slicing 5, slice 0"), "named");
}

#[test]
fn levels_change_at_stated_distances() {
    let crown = plant(&random_crown(300));
    let with = |distances: &[f64], counts: &[usize]| Params {
        slice_counts: counts.to_vec(),
        rule: LevelRule::Distances(distances.to_vec()),
        ..params(6, 1, 16)
    };
    let (lod, _) = build(&crown, &with(&[5.0, 20.0], &[4, 2, 1]));
    let radius = lod.parts[0].radius;
    let drawn =
        |radii: f64| cards_of_any_level(&emit(&lod, &at_distance(radii * radius, 0.0), &here()));
    assert_eq!([4.9, 5.1, 19.0, 21.0, 900.0].map(drawn), [4, 2, 2, 1, 1], "by radii");
    for (distances, counts, name) in [
        (&[5.0][..], &[4, 2, 1][..], "level_distances"),
        (&[5.0, 4.0], &[4, 2, 1], "level_distances"),
        (&[5.0], &[2, 2], "slice_count"),
        (&[5.0], &[2, 4], "slice_count"),
        (&[], &[], "slice_count"),
    ] {
        let message = refused(&crown, &with(distances, counts));
        assert!(message.starts_with(name), "{distances:?}, {counts:?}: {message}");
    }
    let negative = Params { rule: LevelRule::Pixels(-1.0), ..params(6, 1, 16) };
    assert!(refused(&crown, &negative).starts_with("level_error_px"), "below 0");
}

fn cards_of_any_level(list: &DrawList) -> usize {
    list.items.iter().filter(|item| item.blend == Blend::Over).count()
}

#[test]
fn views_bake_the_levels_that_they_show() {
    let crown = plant(&random_crown(300));
    let with = |views: Vec<View>| Params {
        slice_counts: vec![4, 1],
        rule: LevelRule::Distances(vec![10.0]),
        views: Some(views),
        ..params(6, 1, 16)
    };
    let (near, far) = (at_distance(9.0, 20.0), at_distance(90.0, 20.0));
    let (lod, _) = build(&crown, &with(vec![near.clone()]));
    let counts = |lod: &Slicings| -> Vec<usize> {
        let levels = lod.parts[0].levels.iter();
        levels.map(|level| level.stacks.iter().flatten().count()).collect()
    };
    assert_eq!(counts(&lod), [2, 0], "the pair of the near level");
    let mut builder = ListBuilder::default();
    let message = lod.emit(&far, &here(), &mut ViewState::default(), &mut builder);
    let message = message.expect_err("not baked").to_string();
    assert!(message.starts_with("camera: this camera needs slicing 1 of level 1"), "{message}");
    let (lod, _) = build(&crown, &with(vec![near, far.clone()]));
    assert_eq!(counts(&lod), [2, 2], "both");
    assert_eq!(cards_of_any_level(&emit(&lod, &far, &here())), 2, "one slice of each");
    let fit = Params { correction: Correction::Fit, ..with(vec![far]) };
    assert!(refused(&crown, &fit).starts_with("correction"), "not all slicings");
}

#[test]
fn every_level_has_a_fit_of_its_own() {
    let crown = plant(&random_crown(400));
    let with = Params {
        slice_counts: vec![5, 2],
        rule: LevelRule::Distances(vec![10.0]),
        correction: Correction::Fit,
        sample_count: 4,
        ..params(4, 1, 48)
    };
    let (_, measured) = build(&crown, &with);
    let [fine, coarse] = &measured.levels[..] else { panic!("two levels: {measured:?}") };
    assert_eq!((fine.fitted, coarse.fitted), (Some(true), Some(true)), "{measured:?}");
    assert!(coarse.tau > 1.5 * fine.tau, "a slice has more leaves: {measured:?}");
    assert!(coarse.m > fine.m, "{measured:?}");
}

// Shared textures

#[test]
fn opposite_slicings_share_slices() {
    let crown = plant(&random_crown(300));
    let with = |mirrored| Params { mirrored, ..params(6, 3, 16) };
    let (shared, _) = build(&crown, &with(true));
    let (own, _) = build(&crown, &with(false));
    assert_eq!(shared.footprint().texture_bytes * 2, own.footprint().texture_bytes, "half");
    assert_eq!(shared.baked(), [true; 6], "all can be drawn");
    let order = |degrees: f64| cards(&shared, &emit(&shared, &at_distance(9.0, degrees), &here()));
    let pair = |secondary: usize, primary: usize, slices: [usize; 3]| -> Vec<(usize, usize)> {
        slices.into_iter().flat_map(|slice| [(secondary, slice), (primary, slice)]).collect()
    };
    assert_eq!(order(20.0), pair(1, 0, [0, 1, 2]), "as without");
    assert_eq!(order(200.0), pair(1, 0, [2, 1, 0]), "4 and 3 are shown by 1 and 0 from behind");
    // from in front the very same picture
    let view = at_distance(9.0, 20.0);
    assert_eq!(draw(&shared, &view).color, draw(&own, &view).color, "the stored side");
    // from behind it covers the same samples: the leaves have not moved
    let behind = parallel(DVec3::NEG_Z, DVec3::Y, 3.0, 32);
    for (a, b) in draw(&shared, &behind).color.iter().zip(&draw(&own, &behind).color) {
        // the texels are mirrored, and so is the rounding of samples that lie on an edge
        assert!((a.w - b.w).abs() < 0.26, "{a} and {b}");
    }
    let mean = |lod: &Slicings| -> f32 { draw(lod, &behind).color.iter().map(|p| p.w).sum() };
    assert!((mean(&shared) / mean(&own) - 1.0).abs() < 0.02, "as opaque in all");
    let odd = Params { mirrored: true, ..params(5, 3, 16) };
    assert!(refused(&crown, &odd).starts_with("mirrored"), "no two of five are opposite");
}

#[test]
fn two_opposite_slicings_that_share_are_one() {
    let crown = plant(&random_crown(300));
    let (lod, _) = build(&crown, &Params { mirrored: true, ..params(2, 3, 16) });
    let list = emit(&lod, &at_distance(9.0, 60.0), &here());
    assert_eq!(opacities(&list), [1.0; 3], "both shares are those of the same slices");
    // beside a third their shares add up: 30 degrees up that has one third
    let blend = ViewBlend::new(&circle(2), None).and_then(ViewBlend::with_vertical);
    let blend = blend.expect("level");
    let correction = Correction::Linear(0.0);
    let with = Params { mirrored: true, blend, correction, ..params(2, 1, 16) };
    let (lod, _) = build(&crown, &with);
    let raised = from_azimuth(60.0) * 3.0_f64.sqrt() + DVec3::Y;
    let list = emit(&lod, &perspective(raised * 9.0, DVec3::ZERO, DVec3::Y), &here());
    for (found, wanted) in opacities(&list).into_iter().zip([1.0 / 3.0, 2.0 / 3.0]) {
        assert!((f64::from(found) - wanted).abs() < 1e-6, "{found}: {wanted}");
    }
}

#[test]
fn a_vertical_slicing_is_mixed_in_from_above() {
    let crown = plant(&random_crown(300));
    let blend = ViewBlend::new(&circle(6), None).and_then(ViewBlend::with_vertical);
    let (lod, _) = build(&crown, &Params { blend: blend.expect("level"), ..params(6, 2, 16) });
    let order = |toward: DVec3| {
        let up = if toward.y.abs() > 0.9 { DVec3::NEG_Z } else { DVec3::Y };
        let view = perspective(toward * 9.0, DVec3::ZERO, up);
        let list = emit(&lod, &view, &here());
        (cards(&lod, &list), opacities(&list))
    };
    let on_axis = order(DVec3::new(0.0, 1.0, 3.0_f64.sqrt()));
    assert_eq!(on_axis.0, [(6, 0), (0, 0), (6, 1), (0, 1)], "30 degrees up: a third");
    let (lesser, greater) = (1.0 / 3.0 * (1.0 + 0.5 / 3.0), 2.0 / 3.0 * (1.0 + 0.5 / 3.0));
    for (found, wanted) in on_axis.1.iter().zip([lesser, greater, lesser, greater]) {
        assert!((f64::from(*found) - wanted).abs() < 1e-6, "{found}: {wanted}");
    }
    assert_eq!(order(DVec3::Y).0, [(6, 0), (6, 1)], "alone from above");
    assert_eq!(order(DVec3::NEG_Y).0, [(6, 1), (6, 0)], "and from below, the other way round");
    assert_eq!(order(DVec3::Z).0, [(0, 0), (0, 1)], "not at all from the horizon");
}

// Cells

#[test]
fn a_cell_has_the_share_of_its_own_place() {
    // two slicings at right angles, one slice each, two by two cells
    let crown = plant(&random_crown(300));
    let level = ViewBlend::new(&circle(4), None).expect("even");
    // heights count only where a slicing faces up
    let vertical = level.clone().with_vertical().expect("level");
    for (blend, slicing_count) in [(level, 2), (vertical, 3)] {
        a_cell_has_the_share_of_a_blend(&crown, &blend, slicing_count);
    }
}

fn a_cell_has_the_share_of_a_blend(crown: &Plant, blend: &ViewBlend, slicing_count: usize) {
    let with = Params {
        sub_slices: 2,
        correction: Correction::Linear(0.0),
        blend: blend.clone(),
        ..params(4, 1, 16)
    };
    let (lod, _) = build(crown, &with);
    let eye = DVec3::new(0.3, 0.2, 2.5);
    let view = perspective(eye, DVec3::ZERO, DVec3::Y);
    let list = emit(&lod, &view, &here());
    let mut found = Vec::new();
    for item in &list.items {
        let opacity = list.instances[item.instances.start as usize].tint.w;
        let buffers = lod.cards.buffers();
        for card in item.primitives.clone() {
            let corners = &buffers.indices[card as usize * 4..card as usize * 4 + 4];
            let middle: DVec3 =
                corners.iter().map(|&v| buffers.positions[v as usize].as_dvec3()).sum::<DVec3>()
                    / 4.0;
            let facing = buffers.normals[corners[0] as usize].as_dvec3();
            let slicing = blend.directions().iter().position(|u| u.distance(facing) < 1e-6);
            let shares = blend.shares(eye - middle, DVec3::Y);
            let share = shares.iter().find(|&&(number, _)| Some(number) == slicing);
            let wanted = share.expect("drawn for its share").1;
            assert!((f64::from(opacity) - wanted).abs() < 1e-6, "{opacity} for {wanted}");
            found.push((slicing, opacity));
        }
    }
    // cells of the slicing that faces -x see the eye on their other side, and are not drawn
    let slicings: std::collections::BTreeSet<_> =
        found.iter().map(|&(slicing, _)| slicing).collect();
    assert_eq!(slicings.len(), slicing_count, "{found:?}");
    let of_first: Vec<f32> = found
        .iter()
        .filter(|(slicing, _)| *slicing == Some(0))
        .map(|&(_, opacity)| opacity)
        .collect();
    assert_eq!(of_first.len(), 4, "all cells of the slicing that faces the eye");
    assert!(of_first.windows(2).any(|pair| pair[0] != pair[1]), "of different shares");
}

#[test]
fn cells_of_a_parallel_view_are_those_of_whole_slices() {
    let crown = plant(&random_crown(300));
    for quadtree in [None, Some(16)] {
        let [whole, cells] = [1, 3].map(|sub_slices| {
            build(&crown, &Params { sub_slices, quadtree, ..params(6, 3, 32) }).0
        });
        let view = parallel(from_azimuth(20.0), DVec3::Y, 3.0, 48);
        let (a, b) = (draw(&whole, &view), draw(&cells, &view));
        assert!(a.color.iter().any(|pixel| pixel.w > 0.9), "something is there");
        for (a, b) in a.color.iter().zip(&b.color) {
            // texture coordinates are rounded anew at every cut
            assert!((*a - *b).abs().max_element() < 2e-3, "{quadtree:?}: {a} and {b}");
        }
    }
}

#[test]
fn views_bake_what_cells_need() {
    let crown = plant(&random_crown(300));
    let near = perspective(DVec3::new(0.0, 0.0, 1.6), DVec3::ZERO, DVec3::Y);
    let with = |sub_slices, views| Params { sub_slices, views, ..params(6, 2, 16) };
    let (whole, _) = build(&crown, &with(1, Some(vec![near.clone()])));
    let (cells, _) = build(&crown, &with(4, Some(vec![near.clone()])));
    let count = |lod: &Slicings| lod.baked().iter().filter(|&&baked| baked).count();
    assert_eq!(count(&whole), 1, "on axis one is enough for all");
    assert!(count(&cells) >= 3, "but not for the sides: {:?}", cells.baked());
    let (all, _) = build(&crown, &with(4, None));
    assert_eq!(
        cards_of_any_level(&emit(&cells, &near, &here())),
        cards_of_any_level(&emit(&all, &near, &here())),
        "nothing is missing"
    );
    let mut builder = ListBuilder::default();
    let other = perspective(DVec3::new(0.0, 0.0, -1.6), DVec3::ZERO, DVec3::Y);
    let message = cells.emit(&other, &here(), &mut ViewState::default(), &mut builder);
    let message = message.expect_err("not baked").to_string();
    assert!(message.starts_with("camera: this camera needs slicing"), "{message}");
    for sub_slices in [0, 65] {
        assert!(refused(&crown, &with(sub_slices, None)).starts_with("sub_slices"), "out of range");
    }
}

#[test]
fn mirrored_cells_bake_what_their_opposites_show() {
    let crown = plant(&random_crown(300));
    let near = perspective(DVec3::new(0.0, 0.0, -1.6), DVec3::ZERO, DVec3::Y);
    let with = |views| Params { sub_slices: 4, mirrored: true, views, ..params(6, 2, 16) };
    let (seen, _) = build(&crown, &with(Some(vec![near.clone()])));
    let (all, _) = build(&crown, &with(None));
    let stacks = |lod: &Slicings| -> Vec<bool> {
        lod.parts[0].levels[0].stacks.iter().map(Option::is_some).collect()
    };
    assert_eq!(stacks(&all), [true, true, true, false, false, false], "half of them");
    assert!(stacks(&seen).starts_with(&[true]), "3 faces the eye, and 0 shows it");
    let [items, wanted] = [&seen, &all].map(|lod| emit(lod, &near, &here()).items.len());
    assert!(items > 0 && items == wanted, "nothing is missing: {items} of {wanted}");
}

#[test]
fn views_are_asked_for_their_cells_until_the_job_ends() {
    let crown = plant(&random_crown(30));
    let view = perspective(DVec3::new(0.0, 0.0, 1.6), DVec3::ZERO, DVec3::Y);
    let leaves = crate::lod::leaves::Leaves::new(&crown).expect("leaves");
    let job = Job::default();
    let asked = std::cell::Cell::new(0);
    let mixed = |_: &View, _: &Crown, _: &crate::lod::viewer::Viewer| {
        asked.set(asked.get() + 1);
        job.cancel();
        Ok(vec![0])
    };
    let views = [view.clone(), view];
    let found = crate::lod::viewer::needed(&views, &leaves, 1, mixed, &job);
    assert!(matches!(found, Err(LodError::Cancelled)), "between two views: {found:?}");
    assert_eq!(asked.get(), 1, "the first alone");
}

#[test]
fn too_many_cells_are_refused_before_they_are_baked() {
    let crown = plant(&random_crown(30));
    // 4 slicings of 65 slices of 64 x 64 cells
    let many = Params { sub_slices: 64, ..params(4, 65, 8) };
    let expected = "sub_slices needs 1064960 cards, the limit is 1048576";
    assert_eq!(refused(&crown, &many), expected, "one card a cell");
    // 4 x 64 slices of 16 x 16 squares, cut by 40 cells, and once more from afar
    let parted = Params { sub_slices: 40, quadtree: Some(16), ..params(4, 64, 256) };
    let expected = format!("sub_slices needs {} cards, the limit is 1048576", 256 * (3025 + 1600));
    assert_eq!(refused(&crown, &parted), expected, "squares are cut");
    // as many cards as there are at most
    let full = plant(&[(Vec3::ZERO, Vec3::X, Vec3::Y)]);
    let few = Params { sub_slices: 3, quadtree: Some(16), ..params(1, 1, 64) };
    let cards = build(&full, &few).0.footprint().card_count;
    let most = crate::lod::stack::cards_at_most((64, 64), 3, Some(16));
    assert!(cards > 9 && cards <= most, "{cards} of {most}");
}

// Squares

/// A crown with a gap: leaves in two opposite corners.
fn corners() -> Vec<Leaf> {
    let leaf = |x: f32, y: f32, z: f32| facing(x, y, z, 0.2);
    vec![leaf(-1.0, -1.0, -1.0), leaf(-0.7, -0.8, 0.3), leaf(1.0, 1.0, 1.0), leaf(0.8, 0.7, -0.2)]
}

#[test]
fn squares_show_what_the_whole_picture_shows() {
    let crowns = [plant(&corners()), plant(&random_crown(150))];
    for crown in &crowns {
        let with = |quadtree| Params { quadtree, sample_count: 4, ..params(6, 3, 64) };
        let whole = build(crown, &with(None)).0;
        for side in [16, 32] {
            let parted = build(crown, &with(Some(side))).0;
            // near: a texel is a pixel or more; far: the coarse picture; none in between
            let border = side / 8;
            for pixels in [320, 64 / border] {
                let view =
                    parallel(from_azimuth(20.0), DVec3::Y, 2.0 * whole.parts[0].radius, pixels);
                let (a, b) = (draw(&whole, &view), draw(&parted, &view));
                for (pixel, (a, b)) in a.color.iter().zip(&b.color).enumerate() {
                    let miss = (*a - *b).abs().max_element();
                    assert!(miss < 2e-3, "{side}, {pixels} pixels, {pixel}: {a} and {b}");
                }
            }
        }
    }
}

#[test]
fn empty_squares_are_neither_stored_nor_drawn() {
    let crown = plant(&corners());
    let with = |quadtree| Params { quadtree, ..params(1, 2, 64) };
    let (whole, _) = build(&crown, &with(None));
    let (parted, _) = build(&crown, &with(Some(16)));
    let bytes = |lod: &Slicings| lod.footprint().texture_bytes;
    let texels: u64 = 64 * 64 + 32 * 32 + 16 * 16 + 8 * 8 + 4 * 4 + 2 * 2 + 1;
    assert_eq!(bytes(&whole), 2 * 4 * texels, "two slices");
    let mut stored = 0;
    for (_, _, baked) in baked_slices(&parted) {
        // squares of 16 to 64 with a border of two texels, in two levels; and all levels but the finest
        for tile in &baked.tiles {
            let (width, height) = tile.texture.size();
            assert!(width == height && (width - 4).is_power_of_two() && width >= 20, "{width}");
            let level_count = tile.texture.levels().len();
            assert_eq!(level_count, 2, "the border of the next would be half a texel");
            stored += u64::from(width) * u64::from(height) * 5;
        }
        stored += 4 * (texels - 64 * 64);
        let near: Vec<_> = baked.shown(0.0).iter().map(|tile| tile.texture.id()).collect();
        let far: Vec<_> = baked.shown(1e9).iter().map(|tile| tile.texture.id()).collect();
        assert!(far.len() == 1 && !near.contains(&far[0]), "one for all from afar");
    }
    assert_eq!(bytes(&parted), stored, "all of it is counted");
    assert!(bytes(&parted) < bytes(&whole), "{} for {}", bytes(&parted), bytes(&whole));
    let names: Vec<String> = parted.textures().into_iter().map(|named| named.name).collect();
    assert!(names.contains(&"slicing 0, slice 0, square 1".to_owned()), "{names:?}");
    assert!(names.contains(&"slicing 0, slice 1, from afar".to_owned()), "{names:?}");
    for (name, with) in [
        ("quadtree", Params { quadtree: Some(8), ..with(None) }),
        ("quadtree", Params { quadtree: Some(24), ..with(None) }),
        ("resolution", Params { quadtree: Some(32), resolution: (64, 66), ..with(None) }),
    ] {
        let message = refused(&crown, &with);
        assert!(message.starts_with(name), "{message}");
    }
}

#[test]
fn a_square_lies_where_its_texture_says() {
    let (lod, _) = build(&plant(&corners()), &Params { quadtree: Some(16), ..params(1, 1, 64) });
    let (_, _, baked) = baked_slices(&lod).next().expect("one slice");
    let named = lod.textures();
    assert_eq!(named.len(), baked.tiles.len() + 1, "squares, and one from afar");
    for (tile, named) in baked.tiles.iter().zip(&named) {
        let rect = named.rect.expect("a bake");
        let (width, _) = tile.texture.size();
        let texel = baked.rect.width / 64.0;
        assert!((rect.width - texel * f64::from(width)).abs() < 1e-6, "its border included");
        let buffers = lod.cards.buffers();
        let card: Vec<usize> = buffers.indices[tile.cards.start as usize * 4..][..4]
            .iter()
            .map(|&v| v as usize)
            .collect();
        for vertex in card {
            let uv = buffers.uvs[vertex].as_dvec2();
            let on_rect = rect.center + rect.right * ((uv.x - 0.5) * rect.width)
                - rect.up * ((uv.y - 0.5) * rect.height);
            let miss = on_rect.distance(buffers.positions[vertex].as_dvec3());
            assert!(miss < 1e-6, "the corner of the card: {miss}");
        }
    }
}

// Branches

fn grown() -> Plant {
    grow::grow("chestnut", 1, Some(600), Lighting::default(), &Job::default()).expect("valid")
}

#[test]
fn branches_share_out_the_leaves() {
    let crown = grown();
    let structure = Arc::clone(crown.structure.as_ref().expect("grown"));
    let leaves = crate::lod::leaves::Leaves::new(&crown).expect("leaves");
    for level in [0, 1, 2, 99] {
        let crowns = super::branches::crowns(&leaves, level, &Job::default()).expect("known");
        let mut seen = vec![0; crown.foliage.leaf_count()];
        for (part, blend, name) in &crowns {
            assert_eq!(blend.directions().len(), 1, "{name}: one slicing");
            for leaf in 0..part.leaf_centers.len() {
                seen[part.number(leaf)] += 1;
                let center = part.leaf_centers[leaf] + part.center;
                let wanted = crown.foliage.centers[part.number(leaf)].as_dvec3();
                assert!(center.distance(wanted) < 1e-9, "{name}: leaf {leaf}");
            }
        }
        assert!(seen.iter().all(|&count| count == 1), "level {level}: each leaf in one branch");
    }
    let limbs = super::branches::crowns(&leaves, 1, &Job::default()).expect("known").len();
    let grown_on_trunk = structure.branches.iter().filter(|b| b.level == 1).count();
    assert_eq!((limbs, grown_on_trunk), (55, 84), "limbs with leaves, of all");
    let job = Job::default();
    job.cancel();
    let cancelled = super::branches::crowns(&leaves, 1, &job);
    assert!(matches!(cancelled, Err(LodError::Cancelled)), "asked for each branch");
    let bare = plant(&random_crown(10));
    let with = Params { branch_level: Some(1), ..params(6, 3, 16) };
    assert!(refused(&bare, &with).starts_with("branch_level"), "no structure");
    let fit = Params { correction: Correction::Fit, ..with.clone() };
    assert!(refused(&crown, &fit).starts_with("correction"), "one slicing has no blend");
    let cells = Params { sub_slices: 2, ..with.clone() };
    assert!(refused(&crown, &cells).starts_with("sub_slices"), "nor do its cells");
    let blend = with.blend.clone().with_vertical().expect("level");
    let vertical = Params { blend, ..with };
    assert!(refused(&crown, &vertical).starts_with("vertical"), "nor is there one that faces up");
}

#[test]
fn branches_are_painted_far_to_near() {
    let crown = grown();
    let with = Params { branch_level: Some(1), sample_count: 4, ..params(6, 3, 64) };
    let (lod, measured) = build(&crown, &with);
    assert_eq!(measured.part_count, lod.parts.len(), "as reported");
    let view = perspective(DVec3::new(3.0, 4.0, 12.0), DVec3::Y * 4.0, DVec3::Y);
    let order = lod.far_to_near(&view, &here()[0]);
    let distances: Vec<f64> = order.iter().map(|part| part.center.distance(view.eye)).collect();
    assert!(distances.is_sorted_by(|a, b| a >= b), "{distances:?}");
    let list = emit(&lod, &view, &here());
    assert!(opacities(&list).iter().all(|&opacity| opacity == 1.0), "nothing is mixed");
    // a branch has its share of the texels that a crown would have
    let whole = build(&crown, &params(1, 3, 64)).0.parts[0].radius;
    for (part, bytes) in lod.parts.iter().map(|part| (part, part.stacks())) {
        let side = (64.0 * part.radius / whole).ceil();
        for (_, baked) in bytes.flat_map(|stack| stack.baked()) {
            assert_eq!(f64::from(baked.tiles[0].texture.size().0), side, "{}", part.radius);
        }
    }
    let frame = draw(&lod, &view);
    assert!(frame.color.iter().any(|pixel| pixel.w > 0.5), "it shows");
    // leaves too long for a branch's slices stay in the mesh, once
    let mesh = Params { large_leaves: LargeLeaves::Mesh, ..with };
    let (kept, measured) = build(&crown, &mesh);
    let triangles = kept.footprint().triangle_count - lod.footprint().triangle_count;
    assert!(measured.large_leaf_count > 0 && triangles > 0, "{measured:?}, {triangles}");
}

// All of it

#[test]
fn every_awkward_crown_and_camera_gives_a_picture_with_options() {
    let vertical = || {
        let blend = ViewBlend::new(&circle(6), None).and_then(ViewBlend::with_vertical);
        blend.expect("level")
    };
    let options: [(&str, Params); 5] = [
        (
            "levels",
            Params {
                slice_counts: vec![5, 3, 1],
                rule: LevelRule::Pixels(1.0),
                drop_back: 1,
                ..params(6, 1, 8)
            },
        ),
        ("mirrored", Params { mirrored: true, blend: vertical(), ..params(6, 3, 8) }),
        ("cells", Params { sub_slices: 3, blend: vertical(), ..params(6, 3, 8) }),
        ("squares", Params { quadtree: Some(16), sub_slices: 2, ..params(6, 2, 16) }),
        (
            "one",
            Params { slice_counts: vec![1], sub_slices: 2, quadtree: Some(16), ..params(1, 1, 8) },
        ),
    ];
    for (name, leaves) in crowns() {
        let crown = plant(&leaves);
        for (option, with) in &options {
            let job = Job::default();
            let built = Slicings::build(&crown, with, &job);
            let (lod, _) = built.unwrap_or_else(|error| panic!("{name}, {option}: {error}"));
            let (done, total) = job.progress();
            assert_eq!(done, total, "{name}, {option}: all steps that were announced");
            for (camera, view) in cameras() {
                let frame = draw(&lod, &view);
                let fine = |pixel: &Vec4| {
                    pixel.is_finite() && pixel.min_element() >= 0.0 && pixel.w <= 1.0 + 1e-6
                };
                assert!(frame.color.iter().all(fine), "{name}, {option}, {camera}");
                assert!(frame.depth.iter().all(|&d| d > 0.0), "{name}, {option}, {camera}");
            }
        }
    }
}

#[test]
fn a_leaf_between_two_cells_or_squares_is_drawn_once() {
    // a sheet over all of the rectangle: every seam would show
    let sheet = plant(&[(Vec3::ZERO, Vec3::X, Vec3::Y)]);
    for (sub_slices, quadtree) in [(5, None), (1, Some(16)), (3, Some(16))] {
        let (lod, _) = build(&sheet, &Params { sub_slices, quadtree, ..params(1, 1, 64) });
        for pixels in [50, 64, 97] {
            let frame = draw(&lod, &parallel(DVec3::Z, DVec3::Y, 1.8, pixels));
            let full = frame.color.iter().all(|pixel| (pixel.w - 1.0).abs() < 1e-5);
            assert!(full, "{sub_slices}, {quadtree:?}, {pixels}");
        }
    }
}
