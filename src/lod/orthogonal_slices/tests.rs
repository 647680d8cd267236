//! Orthogonal slices of tiny hand-made crowns, and of every crown and camera that is awkward.

use std::collections::BTreeMap;

use glam::{DAffine3, DVec3, Vec3, Vec4};

use super::{
    AXES, Correction, Crossing, Law, Measured, Order, OrthogonalSlices, Params, Shares, Treetop,
};
use crate::draw_list::{Blend, DrawList};
use crate::error::LodError;
use crate::job::Job;
use crate::lod::full_mesh::FullMesh;
use crate::lod::made::{
    Leaf, cameras, crown_at, crowns, draw, emit, facing, from_azimuth, parallel, perspective,
    plant, plant_at, random_crown,
};
use crate::lod::viewer::Viewer;
use crate::lod::wind::{Gust, Wind};
use crate::lod::wood::Wood;
use crate::lod::{Crown, ListBuilder, Representation};
use crate::plant::Plant;
use crate::texture::{Filter, Format};
use crate::view::View;
use crate::view_state::ViewState;

const NO_TREETOP: Treetop = Treetop { slice_count: 0, height_rel: 0.3 };

fn params(axis_count: usize, slice_count: usize, side: u32) -> Params {
    Params {
        axis_count,
        slice_count,
        resolution: (side, side),
        sample_count: 1,
        law: Law::Linear,
        correction: Correction::Linear(0.5),
        order: Order::Slices,
        treetop: NO_TREETOP,
        format: Format::Rgba8,
        wood: Wood::Full,
        bakes_wood: false,
        views: None,
    }
}

fn build(plant: &Plant, params: &Params) -> (OrthogonalSlices, Measured) {
    OrthogonalSlices::build(plant, params, &Job::default()).expect("valid")
}

/// Alphas of an axis's slices, 0 to 255, at the finest level; nothing where no leaf is.
fn alphas(crossing: &Crossing, axis: usize) -> Vec<Vec<u8>> {
    let stack = crossing.stacks[axis].as_ref().expect("baked");
    let of = |slice: &crate::lod::stack::Slice| {
        slice.baked.as_ref().map_or_else(Vec::new, |baked| {
            baked.tiles[0].texture.levels()[0].texels.iter().map(|texel| texel[3]).collect()
        })
    };
    stack.slices.iter().map(of).collect()
}

/// Axis and slice of every card of a list that is not cut, in paint order.
fn cards(lod: &OrthogonalSlices, list: &DrawList) -> Vec<(usize, usize)> {
    let mut places: BTreeMap<u32, (usize, usize)> = BTreeMap::new();
    for (axis, stack) in lod.crown.stacks.iter().enumerate() {
        let baked = stack.iter().flat_map(|stack| stack.baked());
        places.extend(baked.map(|(slice, baked)| (baked.tiles[0].cards.start, (axis, slice))));
    }
    let blended = list.items.iter().filter(|item| item.blend == Blend::Over);
    blended.map(|item| places[&item.primitives.start]).collect()
}

/// A sheet that leans through a box of 4 x 2 x 4 m: where x is, z is too.
fn leaning() -> Leaf {
    (Vec3::ZERO, Vec3::new(2.0, 0.0, 2.0), Vec3::Y)
}

#[test]
fn a_leaning_sheet_is_shared_out_in_equal_parts() {
    //  seen along z, 8 x 4 texels: slice 0 has x in [-2, -1], slice 1 x in [-1, 0], ...
    //  | 0 0 | 1 1 | 2 2 | 3 3 |
    let with = Params { resolution: (8, 4), ..params(3, 4, 1) };
    let (lod, measured) = build(&plant(&[leaning()]), &with);
    assert_eq!(measured.treetop_leaf_count, 0, "none was asked for");
    let columns = |slice: usize, texels: &[u8]| {
        let row = &texels[..8];
        assert!(texels.chunks(8).all(|other| other == row), "slice {slice}: rows are alike");
        (0..8).filter(|&x| row[x] == 255).collect::<Vec<_>>()
    };
    let along_z = alphas(&lod.crown, 0);
    for (slice, texels) in along_z.iter().enumerate() {
        assert_eq!(columns(slice, texels), [2 * slice, 2 * slice + 1], "along z");
    }
    // seen along x, right is -z, which falls as x rises
    for (slice, texels) in alphas(&lod.crown, 1).iter().enumerate() {
        assert_eq!(columns(slice, texels), [6 - 2 * slice, 7 - 2 * slice], "along x");
    }
    // seen along y it is a line, without any texel
    assert!(alphas(&lod.crown, 2).iter().all(Vec::is_empty), "edge on");
    let stack = lod.crown.stacks[0].as_ref().expect("baked");
    let offsets: Vec<f64> = stack.slices.iter().map(|slice| slice.offset).collect();
    assert_eq!(offsets, [-1.5, -0.5, 0.5, 1.5], "in the middles of the slabs");
    let (_, baked) = stack.baked().next().expect("shown");
    assert_eq!((baked.rect.width, baked.rect.height), (4.0, 2.0), "the box as seen along z");
    assert_eq!(baked.rect.center, DVec3::Z * -1.5, "on its plane");
}

#[test]
fn slabs_share_out_the_box_of_the_vertices() {
    // the middle of the box of vertices lies at (2, 1, 0.5); that of the centres does not
    let leaves = [
        (Vec3::new(1.0, 0.0, 0.0), Vec3::X, Vec3::Y),
        (Vec3::new(3.5, 2.5, 1.0), Vec3::X * 0.5, Vec3::Y * 0.5),
    ];
    let (lod, _) = build(&plant(&leaves), &params(2, 2, 8));
    let middle = |axis: usize| {
        let stack = lod.crown.stacks[axis].as_ref().expect("baked");
        let offsets = stack.slices.iter().map(|slice| slice.offset);
        offsets.sum::<f64>() / 2.0 + lod.crown.center.dot(AXES[axis])
    };
    assert!((middle(0) - 0.5).abs() < 1e-12, "along z: {}", middle(0));
    assert!((middle(1) - 2.0).abs() < 1e-12, "along x: {}", middle(1));
    for stack in lod.crown.stacks.iter().flatten() {
        for (_, baked) in stack.baked() {
            assert!((baked.rect.center.y - 1.0).abs() < 1e-12, "from -1 to 3: {:?}", baked.rect);
            assert!((baked.rect.height - 4.0).abs() < 1e-12, "4 m: {:?}", baked.rect);
        }
    }
}

#[test]
fn the_slabs_of_an_axis_sum_to_the_whole() {
    // leaves that no axis sees behind one another, so that what is covered can be added up
    let small = |x: f32, y: f32, z: f32| {
        (Vec3::new(x, y, z), Vec3::new(0.3, 0.1, 0.4), Vec3::new(-0.1, 0.35, 0.2))
    };
    let mut leaves = vec![small(-3.0, -3.0, -3.0), small(0.1, 0.2, -0.1), small(3.0, 3.0, 3.0)];
    leaves.push((Vec3::new(1.5, 1.4, 1.6), Vec3::new(0.5, 0.1, 0.4), Vec3::new(0.1, -0.4, 0.3)));
    for count in [2, 3, 5, 8] {
        let with = |count| params(3, count, 61);
        let (whole, sliced) =
            (build(&plant(&leaves), &with(1)).0, build(&plant(&leaves), &with(count)).0);
        for axis in 0..3 {
            let wanted = &alphas(&whole.crown, axis)[0];
            let slices = alphas(&sliced.crown, axis);
            assert!(slices.iter().filter(|slice| !slice.is_empty()).count() >= 2, "{count}");
            for (texel, &alpha) in wanted.iter().enumerate() {
                let of = slices.iter().filter(|slice| !slice.is_empty()).map(|slice| slice[texel]);
                let sum: u32 = of.map(u32::from).sum();
                assert_eq!(sum, u32::from(alpha), "{count} slices, axis {axis}, texel {texel}");
            }
            let covered = wanted.iter().filter(|&&alpha| alpha > 0).count();
            assert!(covered > 60, "axis {axis} shows something: {covered}");
        }
    }
}

fn viewer(toward: DVec3) -> Viewer {
    let up = if toward.x == 0.0 && toward.z == 0.0 { DVec3::NEG_Z } else { DVec3::Y };
    let view = perspective(toward * 9.0, DVec3::ZERO, up);
    Viewer::new(&view, &crown_at(DAffine3::IDENTITY, 0), DVec3::ZERO, 1.0)
}

fn shares(law: Law, axis_count: usize, toward: DVec3) -> Vec<(usize, f64)> {
    let found = Shares::new(law, axis_count).expect("valid").of(&viewer(toward));
    found.into_iter().map(|(axis, share)| (axis, (share * 1e9).round() / 1e9)).collect()
}

#[test]
fn shares_follow_their_laws() {
    let diagonal = DVec3::new(1.0, 0.0, 1.0);
    for law in [Law::Linear, Law::Power { k: 1.0 }, Law::Power { k: 3.0 }] {
        for axis_count in [2, 3] {
            assert_eq!(shares(law, axis_count, DVec3::Z), [(0, 1.0)], "{law:?}: along z");
            assert_eq!(shares(law, axis_count, -DVec3::X), [(1, 1.0)], "{law:?}: from behind");
            assert_eq!(shares(law, axis_count, diagonal), [(1, 0.5), (0, 0.5)], "{law:?}");
        }
        let third = 0.333_333_333;
        let corner = shares(law, 3, DVec3::new(-1.0, 1.0, 1.0));
        assert_eq!(corner, [(2, third), (1, third), (0, third)], "{law:?}: a corner");
        assert_eq!(shares(law, 3, DVec3::NEG_Y), [(2, 1.0)], "{law:?}: from below");
    }
    // 30 degrees from z: a third of the way; tan 30 = 1 / sqrt(3)
    let aside = from_azimuth(30.0);
    assert_eq!(shares(Law::Linear, 2, aside), [(1, 0.333_333_333), (0, 0.666_666_667)], "linear");
    assert_eq!(shares(Law::Power { k: 2.0 }, 2, aside), [(1, 0.25), (0, 0.75)], "1 to 3");
    assert_eq!(shares(Law::Power { k: 4.0 }, 2, aside), [(1, 0.1), (0, 0.9)], "1 to 9");
    assert_eq!(shares(Law::Power { k: 0.0 }, 2, aside), [(1, 0.5), (0, 0.5)], "always equal");
    // with two axes only the horizontal part counts
    let raised = DVec3::new(aside.x, 3.0, aside.z);
    assert_eq!(shares(Law::Power { k: 2.0 }, 2, raised), [(1, 0.25), (0, 0.75)], "from above");
    assert_eq!(shares(Law::Power { k: 2.0 }, 2, DVec3::Y), [(1, 0.5), (0, 0.5)], "straight above");
    // linear: as from +z with the head bent, since the picture's up is -z
    assert_eq!(shares(Law::Linear, 2, DVec3::Y), [(0, 1.0)], "straight above");
    assert_eq!(
        shares(Law::Linear, 3, DVec3::new(3.0, 2.0, -5.0)),
        [(2, 0.2), (1, 0.3), (0, 0.5)],
        "with three axes the barycentric coordinates"
    );
    // a power so high that squares of small numbers vanish
    let steep = shares(Law::Power { k: 64.0 }, 2, DVec3::new(1e-6, 1.0, 1e-6));
    assert_eq!(steep, [(1, 0.5), (0, 0.5)], "nearly straight above, and still the diagonal");
}

#[test]
fn opacities_are_corrected_shares() {
    let (lod, _) = build(&plant(&random_crown(100)), &params(2, 3, 8));
    let list = emit(&lod, &perspective(from_azimuth(45.0) * 9.0, DVec3::ZERO, DVec3::Y), &here());
    let opacities: Vec<f32> = list.instances.iter().map(|instance| instance.tint.w).collect();
    assert_eq!(opacities, [0.625, 0.625], "0.5 (1 + 0.5 * 0.5)");
    let (lod, _) = build(&plant(&random_crown(100)), &params(3, 3, 8));
    let corner = DVec3::new(1.0, 1.0, 1.0);
    let list = emit(&lod, &parallel(corner, DVec3::Y, 4.0, 8), &here());
    for instance in &list.instances {
        let wanted = (1.0 + 0.5 * 2.0 / 3.0) / 3.0;
        assert!((f64::from(instance.tint.w) - wanted).abs() < 1e-6, "{}", instance.tint.w);
    }
}

fn here() -> [Crown; 1] {
    [crown_at(DAffine3::IDENTITY, 0)]
}

#[test]
fn whole_cards_are_painted_in_turn_far_to_near() {
    let trunk = (Vec3::new(0.0, -2.0, 0.0), Vec3::X * 0.1, Vec3::Y);
    let crown = plant_at(DVec3::ZERO, &[trunk], &random_crown(300));
    let (lod, _) = build(&crown, &params(3, 2, 16));
    let order = |toward: DVec3| {
        let up = if toward.y.abs() > 0.9 { DVec3::NEG_Z } else { DVec3::Y };
        cards(&lod, &emit(&lod, &perspective(toward * 9.0, DVec3::ZERO, up), &here()))
    };
    assert_eq!(order(from_azimuth(20.0)), [(1, 0), (0, 0), (1, 1), (0, 1)], "the lesser first");
    assert_eq!(order(from_azimuth(70.0)), [(0, 0), (1, 0), (0, 1), (1, 1)], "beyond 45 degrees");
    assert_eq!(order(from_azimuth(160.0)), [(1, 0), (0, 1), (1, 1), (0, 0)], "z from behind");
    assert_eq!(order(DVec3::Y), [(2, 0), (2, 1)], "from above");
    assert_eq!(order(DVec3::NEG_Y), [(2, 1), (2, 0)], "from below");
    let list = emit(&lod, &perspective(DVec3::Z * 9.0, DVec3::ZERO, DVec3::Y), &here());
    assert_eq!(list.items[0].blend, Blend::Opaque, "wood first");
    assert!(list.items[1..].iter().all(|item| !item.depth_write), "slices hide nothing");
}

#[test]
fn pieces_cover_their_cards_once() {
    for axis_count in [2, 3] {
        let crown = plant(&random_crown(200));
        let with = Params { order: Order::Exact, ..params(axis_count, 3, 8) };
        let (lod, _) = build(&crown, &with);
        let pieces = lod.crown.pieces.as_ref().expect("cut");
        // three planes part a card in four along each side that they cross
        let each = if axis_count == 2 { 4 } else { 16 };
        assert_eq!(pieces.pieces.len(), 3 * axis_count * each, "{axis_count} axes");
        assert_eq!(lod.footprint().card_count, (3 * axis_count * each) as u64, "counted as cards");
        let buffers = lod.crown.cards.buffers();
        let mut areas: BTreeMap<(usize, usize), f64> = BTreeMap::new();
        for piece in &pieces.pieces {
            let corners = &buffers.indices[piece.card as usize * 4..piece.card as usize * 4 + 4];
            let uvs: Vec<_> = corners.iter().map(|&v| buffers.uvs[v as usize].as_dvec2()).collect();
            let size = uvs[2] - uvs[0];
            assert!(size.x > 0.0 && size.y < 0.0, "lower left to upper right: {size}");
            *areas.entry((piece.axis, piece.slice)).or_default() += -size.x * size.y;
        }
        for (which, area) in areas {
            assert!((area - 1.0).abs() < 1e-6, "{which:?}: {area}");
        }
    }
}

#[test]
fn pieces_are_painted_in_the_order_of_every_ray() {
    let crown = plant(&random_crown(200));
    for axis_count in [2, 3] {
        let with = Params { order: Order::Exact, ..params(axis_count, 4, 8) };
        let (lod, _) = build(&crown, &with);
        let pieces = lod.crown.pieces.as_ref().expect("cut");
        let buffers = lod.crown.cards.buffers();
        let views = [
            perspective(DVec3::new(3.0, 2.0, 5.0), DVec3::ZERO, DVec3::Y),
            perspective(DVec3::new(-0.3, 0.2, 0.4), DVec3::new(1.0, 0.0, -1.0), DVec3::Y),
            perspective(DVec3::new(0.0, 0.1, -4.0), DVec3::ZERO, DVec3::Y),
            parallel(DVec3::new(-1.0, -0.7, 0.4), DVec3::Y, 4.0, 24),
        ];
        for view in views {
            let viewer = Viewer::new(&view, &here()[0], lod.crown.center, lod.crown.radius);
            let axes: Vec<usize> = (0..axis_count).collect();
            let order = pieces.far_to_near(&viewer, &axes);
            assert_eq!(order.len(), pieces.pieces.len(), "all of them");
            let mut crossed = 0;
            for ray in 0..300 {
                let spread = |k: i32| f64::from((ray * k) % 101) / 50.5 - 1.0;
                let aim = DVec3::new(spread(17), spread(31), spread(59));
                let (from, along) = if view.is_orthographic() {
                    (aim + view.back * 20.0, -view.back)
                } else {
                    (view.eye, aim - view.eye)
                };
                let hit = |piece: &&super::pieces::Piece| -> Option<f64> {
                    let first = piece.card as usize * 4;
                    let corners: Vec<DVec3> = buffers.indices[first..first + 4]
                        .iter()
                        .map(|&v| buffers.positions[v as usize].as_dvec3())
                        .collect();
                    let axis = AXES[piece.axis];
                    let at = (corners[0] - from).dot(axis) / along.dot(axis);
                    let point = from + along * at;
                    let (across, up) = (corners[1] - corners[0], corners[3] - corners[0]);
                    let (u, v) = (
                        (point - corners[0]).dot(across) / across.length_squared(),
                        (point - corners[0]).dot(up) / up.length_squared(),
                    );
                    let inside = |x: f64| x > 1e-6 && x < 1.0 - 1e-6;
                    (at > 1e-9 && inside(u) && inside(v)).then_some(at)
                };
                let distances: Vec<f64> = order.iter().filter_map(hit).collect();
                crossed += distances.len();
                assert!(
                    distances.is_sorted_by(|a, b| a > b),
                    "{axis_count} axes, ray {ray}: {distances:?}"
                );
            }
            assert!(crossed > 500, "rays meet pieces: {crossed}");
        }
    }
}

#[test]
fn on_an_axis_both_orders_show_the_same() {
    let crown = plant(&random_crown(200));
    let [whole, exact] = [Order::Slices, Order::Exact].map(|order| {
        let (lod, _) = build(&crown, &Params { order, ..params(2, 4, 32) });
        draw(&lod, &parallel(DVec3::Z, DVec3::Y, 3.0, 48)).color
    });
    assert!(whole.iter().any(|pixel| pixel.w > 0.9), "something is there");
    for (a, b) in whole.iter().zip(&exact) {
        // texture coordinates are rounded anew at every cut
        assert!((*a - *b).abs().max_element() < 1e-3, "{a} and {b}");
    }
}

#[test]
fn wood_is_a_mesh_or_in_the_slices() {
    let trunk = (Vec3::new(0.0, -2.0, 0.1), Vec3::X * 0.4, Vec3::Y);
    let crown = plant_at(DVec3::ZERO, &[trunk], &random_crown(100));
    let view = parallel(DVec3::Z, DVec3::Y, 8.0, 64);
    let full = FullMesh::build(&crown, Wood::Full, Filter::Bilinear, &Job::default());
    let mean = |lod: &dyn Representation| {
        draw(lod, &view).color.iter().map(|pixel| f64::from(pixel.w)).sum::<f64>() / 4096.0
    };
    let wanted = mean(&full.expect("valid"));
    for (bakes_wood, wood, triangles) in
        [(false, Wood::Full, 2), (true, Wood::Full, 0), (true, Wood::Simplified(1), 0)]
    {
        let (lod, _) = build(&crown, &Params { bakes_wood, wood, ..params(2, 5, 64) });
        assert_eq!(lod.footprint().triangle_count, triangles, "{bakes_wood}");
        if wood == Wood::Full {
            let found = mean(&lod);
            assert!((found - wanted).abs() < 0.01, "baked {bakes_wood}: {found} for {wanted}");
        }
        let [low, high] = [lod.bounds().0, lod.bounds().1];
        assert!(low.y <= -3.0 + 1e-6 && high.y > 1.0, "from foot to top: {low} to {high}");
    }
    let none = Params { bakes_wood: true, wood: Wood::None, ..params(2, 5, 64) };
    let without = mean(&build(&crown, &none).0);
    assert!(without < wanted - 0.02, "no wood at all: {without} for {wanted}");
    // a plant that has no wood
    let bare = plant(&random_crown(50));
    let both = [false, true].map(|bakes_wood| {
        draw(&build(&bare, &Params { bakes_wood, ..params(2, 3, 16) }).0, &view).color
    });
    assert_eq!(both[0], both[1], "there is nothing to bake in");
}

#[test]
fn a_treetop_takes_the_upper_leaves_and_loses_none() {
    let leaves = [-1.0, 0.0, 0.8, 1.0].map(|y| facing(y * 0.5, y, y * 0.3, 0.2));
    let treetop = Treetop { slice_count: 1, height_rel: 0.25 };
    // the crown is 2 m high by its leaves' centres: what is above 0.5 is treetop
    let (lod, measured) = build(&plant(&leaves), &Params { treetop, ..params(2, 3, 32) });
    assert_eq!(measured.treetop_leaf_count, 2, "those at 0.8 and 1.0");
    assert!((lod.treetop_foot - 0.5).abs() < 1e-6, "{}", lod.treetop_foot);
    let names: Vec<String> = lod.textures().into_iter().map(|named| named.name).collect();
    assert!(names.contains(&"treetop, axis z, slice 0".to_owned()), "{names:?}");
    let (whole, _) = build(&plant(&leaves), &params(2, 3, 32));
    let view = parallel(DVec3::Z, DVec3::Y, 3.0, 60);
    let mean = |lod: &OrthogonalSlices| {
        draw(lod, &view).color.iter().map(|pixel| f64::from(pixel.w)).sum::<f64>() / 3600.0
    };
    let (parted, together) = (mean(&lod), mean(&whole));
    assert!((parted - together).abs() < 5e-3, "{parted} for {together}: texels of other sizes");
    // a crown as flat as a sheet has no top
    let flat = [facing(0.0, 0.0, 0.0, 0.2), facing(1.0, 0.0, 1.0, 0.2)];
    let (lod, measured) = build(&plant(&flat), &Params { treetop, ..params(2, 3, 8) });
    assert_eq!(measured.treetop_leaf_count, 0, "all at one height");
    assert!(lod.treetop.is_none() && !lod.sways(), "nothing moves by itself");
}

#[test]
fn a_treetop_is_painted_last_from_above_and_first_from_below() {
    let treetop = Treetop { slice_count: 1, height_rel: 0.4 };
    let (lod, _) = build(&plant(&random_crown(200)), &Params { treetop, ..params(2, 2, 8) });
    let top = lod.treetop.as_ref().expect("there").cards.id();
    let is_top = |toward: DVec3| -> Vec<bool> {
        let list = emit(&lod, &perspective(toward * 9.0, DVec3::ZERO, DVec3::Y), &here());
        let number = list.geometries.iter().position(|geometry| geometry.id() == top);
        let number = u32::try_from(number.expect("drawn")).expect("few");
        let of = |item: &crate::draw_list::Item| {
            item.vertices == crate::draw_list::Source::Shared(number)
        };
        list.items.iter().map(of).collect()
    };
    assert_eq!(is_top(DVec3::new(0.0, 0.5, 1.0)), [false, false, true], "from above");
    assert_eq!(is_top(DVec3::new(0.0, -0.5, 1.0)), [true, false, false], "from below");
}

#[test]
fn a_treetop_swings_on_top_of_the_crown() {
    let leaves = [-1.0, 0.0, 0.8, 1.0].map(|y| facing(y * 0.5, y, y * 0.3, 0.2));
    let treetop = Treetop { slice_count: 1, height_rel: 0.25 };
    let (lod, _) = build(&plant(&leaves), &Params { treetop, ..params(2, 3, 8) });
    assert!(lod.sways(), "by itself");
    let foot = lod.foot().y;
    assert!((foot + 1.2).abs() < 1e-6, "the lowest leaf's lower side: {foot}");
    let wind = Wind { lean: 0.0, sway: 0.2, period_secs: 4.0, toward: Some(DVec3::X), seed: 3 };
    let view = perspective(DVec3::Z * 9.0, DVec3::ZERO, DVec3::Y);
    for time_secs in [0.0, 0.7, 3.1] {
        let gust = Gust { wind, time_secs, key: (0, 0) };
        let crown = Crown { wind: Some(gust), ..crown_at(DAffine3::IDENTITY, 0) };
        let (crown, top) = lod.moved(&view, &crown);
        let slope = gust.slope();
        let x = |placed: &Crown, y: f64| placed.world_from_local.transform_point3(DVec3::Y * y).x;
        let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!(close(x(&crown, foot), 0.0), "the foot stays");
        assert!(close(x(&crown, 0.5), slope * (0.5 - foot)), "sheared");
        assert!(close(x(&top, 0.5), x(&crown, 0.5)), "the treetop stands on the crown");
        let own = gust.slope_at(gust.phase() + 0.25);
        let moved = x(&top, 1.0) - x(&top, 0.5);
        assert!(close(moved, own * 0.5), "and swings by itself: {moved}");
        assert!((slope - own).abs() > 1e-3, "at another phase: {slope}, {own}");
        let most = wind.reach() * (1.2 - foot);
        assert!(x(&top, 1.2).abs() <= most + 1e-9, "no farther than the box is told");
    }
    let still = lod.moved(&view, &here()[0]);
    assert_eq!(still.1.world_from_local, DAffine3::IDENTITY, "without wind");
}

#[test]
fn a_fit_is_as_opaque_from_all_around_as_on_its_axes() {
    let crown = plant(&random_crown(400));
    let with = |correction| Params { correction, sample_count: 4, ..params(2, 5, 64) };
    let (fitted, measured) = build(&crown, &with(Correction::Fit));
    let (plain, _) = build(&crown, &with(Correction::Linear(0.0)));
    assert_eq!(measured.fitted, Some(true), "{measured:?}");
    let mean = |lod: &OrthogonalSlices, over: &[DVec3]| {
        lod.mean_alpha(lod.opacity, over, &Job::default()).expect("valid")
    };
    let axes = [DVec3::Z, DVec3::X, DVec3::NEG_Z, DVec3::NEG_X];
    let around = super::all_around(true);
    let wanted = mean(&plain, &axes);
    let (before, after) = (mean(&plain, &around), mean(&fitted, &around));
    assert!(before < 0.97 * wanted, "too thin between the axes: {before} for {wanted}");
    // m is within 1e-3 of the root, and alpha changes by less than m does
    assert!((after - wanted).abs() < 1e-3 * wanted, "{after} for {wanted}");
}

#[test]
fn views_bake_what_they_show_and_no_more() {
    let crown = plant(&random_crown(300));
    let on_z = parallel(DVec3::Z, DVec3::Y, 8.0, 20);
    let with = |views: &[View], axis_count| Params {
        views: Some(views.to_vec()),
        ..params(axis_count, 3, 64)
    };
    let (lod, _) = build(&crown, &with(std::slice::from_ref(&on_z), 3));
    assert_eq!(lod.baked(), [true, false, false], "z alone");
    for (_, baked) in lod.crown.stacks[0].iter().flat_map(|stack| stack.baked()) {
        let (width, height) = baked.tiles[0].texture.size();
        let texels = |metres: f64| (metres * 20.0 / 8.0).ceil();
        let wanted = (texels(baked.rect.width), texels(baked.rect.height));
        assert_eq!((f64::from(width), f64::from(height)), wanted, "a texel a pixel");
    }
    let level = perspective(from_azimuth(20.0) * 9.0, DVec3::ZERO, DVec3::Y);
    let (lod, _) = build(&crown, &with(&[on_z, level.clone()], 3));
    assert!(lod.baked()[1], "x from 20 degrees");
    let (lod, _) = build(&crown, &with(&[parallel(DVec3::Z, DVec3::Y, 8.0, 20)], 2));
    let mut builder = ListBuilder::default();
    let refused = lod.emit(&level, &here(), &mut ViewState::default(), &mut builder);
    let message = refused.expect_err("not baked").to_string();
    assert!(message.starts_with("camera: this camera needs axis x"), "{message}");
    let fit =
        Params { correction: Correction::Fit, ..with(&[parallel(DVec3::Z, DVec3::Y, 8.0, 20)], 2) };
    let error = OrthogonalSlices::build(&crown, &fit, &Job::default()).expect_err("refused");
    assert!(error.to_string().starts_with("correction"), "{error}");
}

#[test]
fn every_awkward_crown_and_camera_gives_a_picture() {
    let treetop = Treetop { slice_count: 1, height_rel: 0.5 };
    for (name, leaves) in crowns() {
        let crown = plant(&leaves);
        for (axis_count, slice_count, treetop) in
            [(2, 1, NO_TREETOP), (3, 1, treetop), (2, 5, treetop), (3, 4, NO_TREETOP)]
        {
            for order in [Order::Slices, Order::Exact] {
                let job = Job::default();
                let law = if slice_count == 1 { Law::Linear } else { Law::Power { k: 2.0 } };
                let with = Params { order, treetop, law, ..params(axis_count, slice_count, 8) };
                let what = format!("{name}: {axis_count} x {slice_count}, {order:?}");
                let (lod, measured) = OrthogonalSlices::build(&crown, &with, &job)
                    .unwrap_or_else(|error| panic!("{what}: {error}"));
                let (done, total) = job.progress();
                assert_eq!(done, total, "{what}: all steps that were announced");
                assert!(measured.tau.is_finite() && measured.tau >= 0.0, "{what}: {measured:?}");
                let (low, high) = lod.bounds();
                assert!(low.is_finite() && high.is_finite(), "{what}: {low} to {high}");
                for (camera, view) in cameras() {
                    let frame = draw(&lod, &view);
                    let fine = |pixel: &Vec4| {
                        pixel.is_finite() && pixel.min_element() >= 0.0 && pixel.w <= 1.0 + 1e-6
                    };
                    assert!(frame.color.iter().all(fine), "{what}, {camera}");
                    assert!(frame.depth.iter().all(|&d| d > 0.0), "{what}, {camera}: no NaN");
                }
            }
        }
    }
}

#[test]
fn size_and_place_do_not_change_the_picture() {
    let crown: Vec<Leaf> = random_crown(60);
    let with = Params { order: Order::Exact, ..params(2, 5, 16) };
    let (lod, _) = build(&plant(&crown), &with);
    let view = |scale: f64, origin: DVec3| {
        perspective(origin + DVec3::new(1.5, 0.5, 3.25) * scale, origin, DVec3::Y)
    };
    let wanted = draw(&lod, &view(1.0, DVec3::ZERO));
    assert!(wanted.color.iter().any(|pixel| pixel.w > 0.5), "it is in the picture");
    // powers of two, with which every rounding stays the same
    for exponent in [-13, 13] {
        let scale = 2.0_f32.powi(exponent);
        let scaled: Vec<Leaf> =
            crown.iter().map(|&(a, b, c)| (a * scale, b * scale, c * scale)).collect();
        let (lod, _) = build(&plant(&scaled), &with);
        let frame = draw(&lod, &view(f64::from(scale), DVec3::ZERO));
        assert_eq!(frame.color, wanted.color, "2^{exponent} times as large");
    }
    let origin = DVec3::new(1_048_576.0, -524_288.0, 2_097_152.0);
    let (far, _) = build(&plant_at(origin, &[], &crown), &with);
    assert_eq!(draw(&far, &view(1.0, origin)).color, wanted.color, "far from the world's origin");
    assert_eq!(far.origin(), origin, "where it stands");
}

#[test]
fn bad_parameters_are_refused_by_name() {
    let crown = plant(&random_crown(10));
    let good = || params(2, 2, 8);
    let treetop = |slice_count, height_rel| Treetop { slice_count, height_rel };
    let cases = [
        ("axes", Params { axis_count: 1, ..good() }),
        ("axes", Params { axis_count: 4, ..good() }),
        ("slice_count", Params { slice_count: 0, ..good() }),
        ("slice_count", Params { slice_count: 5000, ..good() }),
        ("slice_count", Params { slice_count: 4000, order: Order::Exact, ..good() }),
        ("resolution", Params { resolution: (0, 8), ..good() }),
        ("resolution", Params { slice_count: 4096, resolution: (4096, 4096), ..good() }),
        ("samples", Params { sample_count: 2, ..good() }),
        ("k", Params { law: Law::Power { k: -1.0 }, ..good() }),
        ("k", Params { law: Law::Power { k: f64::NAN }, ..good() }),
        ("correction", Params { correction: Correction::Linear(-0.1), ..good() }),
        ("treetop_slice_count", Params { treetop: treetop(5000, 0.5), ..good() }),
        ("treetop_height_rel", Params { treetop: treetop(1, 0.0), ..good() }),
        ("treetop_height_rel", Params { treetop: treetop(1, 1.0), ..good() }),
        ("wood_triangle_count", Params { wood: Wood::Simplified(0), ..good() }),
        ("views", Params { views: Some(vec![]), ..good() }),
    ];
    for (name, with) in cases {
        let error = OrthogonalSlices::build(&crown, &with, &Job::default()).expect_err(name);
        assert!(error.to_string().starts_with(name), "{name}: {error}");
    }
    let bare = plant_at(DVec3::ZERO, &[facing(0.0, 0.0, 0.0, 1.0)], &[]);
    for bakes_wood in [false, true] {
        let with = Params { bakes_wood, ..good() };
        let error = OrthogonalSlices::build(&bare, &with, &Job::default()).expect_err("no leaves");
        assert!(error.to_string().starts_with("foliage is empty"), "{error}");
    }
    let job = Job::default();
    job.cancel();
    let stopped = OrthogonalSlices::build(&crown, &good(), &job).expect_err("cancelled");
    assert_eq!(stopped, LodError::Cancelled, "stopped");
}
