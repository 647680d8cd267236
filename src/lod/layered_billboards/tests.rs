//! Layered billboards of trees made by hand, and of every crown and camera that is awkward.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DAffine3, DVec2, DVec3, Vec3, Vec4};

use super::frame::{Frame, Grid};
use super::groups::{Moment, groups};
use super::pose::Motion;
use super::slabs::Slabs;
use super::{Drawing, Grouping, LayeredBillboards, Params, Turn, WoodAs};
use crate::draw_list::{Blend, DrawList};
use crate::error::LodError;
use crate::job::{self, Job};
use crate::lod::Representation;
use crate::lod::full_mesh::FullMesh;
use crate::lod::leaves::{Leaves, Placed};
use crate::lod::made::{
    Leaf, cameras, crown_at, crowns, draw, emit, facing as square, from_azimuth, parallel,
    perspective, plant, plant_at, random_crown,
};
use crate::lod::wood::Wood;
use crate::plant::limbs::Limbs;
use crate::plant::{Branch, Plant, Structure};
use crate::texture::{Filter, Format};
use crate::view::View;

pub(super) fn params(layer_count: usize, resolution: u32) -> Params {
    Params {
        direction: DVec3::Z,
        grouping: Grouping::Auto,
        layer_count,
        tilt: true,
        turn: Turn::Fixed,
        motion: Motion::Rotate,
        growth: 1.25,
        drawing: Drawing::Blend,
        resolution,
        sample_count: 1,
        format: Format::Rgba8,
        wood: Wood::Full,
        wood_as: WoodAs::Baked,
        views: None,
    }
}

pub(super) fn build(plant: &Plant, params: &Params) -> LayeredBillboards {
    LayeredBillboards::build(plant, params, &Job::default()).expect("valid")
}

pub(super) const FRONT: Frame = Frame { right: DVec3::X, up: DVec3::Y, toward: DVec3::Z };

/// Two limbs on a trunk, and a twig on the first limb.
///
/// ```text
///  2 2
///   │3           leaves, by limb: 0 on the trunk, 1 on limb 1, 2 and 2 on its twig, 3 on the other
/// 1─┘   ┌──3     limb 1 leaves the trunk at y = 2, limb 3 at y = 3; limb 2 leaves limb 1 at x = -1
///   └─0─┘
///     0
/// ```
pub(super) fn tree() -> Plant {
    let wood = [
        (Vec3::Y * 2.0, Vec3::X * 0.1, Vec3::Y * 2.0),
        (Vec3::new(-1.0, 2.0, 0.0), Vec3::X, Vec3::Y * 0.05),
        (Vec3::new(-1.0, 3.0, 0.0), Vec3::X * 0.05, Vec3::Y),
        (Vec3::new(1.0, 3.0, -0.5), Vec3::X, Vec3::Y * 0.05),
    ];
    let leaves = [
        square(0.0, 4.5, 0.0, 0.25),
        square(-2.0, 2.0, 0.25, 0.25),
        square(-1.0, 4.25, 0.5, 0.25),
        square(-1.5, 4.25, 0.5, 0.25),
        square(2.0, 3.0, -0.5, 0.25),
    ];
    let mut plant = plant_at(DVec3::ZERO, &wood, &leaves);
    let branch = |parent, start: Vec3, wood: u32, leaves: std::ops::Range<u32>| Branch {
        parent,
        level: 0,
        start,
        end: start,
        radius: 0.1,
        wood_triangles: wood..wood + 2,
        leaves,
    };
    let branches = vec![
        branch(None, Vec3::ZERO, 0, 0..1),
        branch(Some(0), Vec3::Y * 2.0, 2, 1..2),
        branch(Some(1), Vec3::new(-1.0, 2.0, 0.0), 4, 2..4),
        branch(Some(0), Vec3::Y * 3.0, 6, 4..5),
    ];
    plant.structure = Some(Arc::new(Structure { branches, leaf_branches: vec![0, 1, 2, 2, 3] }));
    plant
}

/// Name, anchor, leaves and triangles of wood of each layer.
fn facts(lod: &LayeredBillboards) -> Vec<(&str, DVec3, usize, usize)> {
    let of = |layer: &'_ super::Layer| (layer.anchor, layer.leaf_count, layer.wood_triangle_count);
    lod.layers()
        .iter()
        .map(|layer| {
            let (anchor, leaves, wood) = of(layer);
            (layer.name.as_str(), anchor, leaves, wood)
        })
        .collect()
}

#[test]
fn layers_of_a_tree_by_hand() {
    let (trunk, limb, twig) = (DVec3::ZERO, DVec3::Y * 2.0, DVec3::new(-1.0, 2.0, 0.0));
    let other = DVec3::Y * 3.0;
    let of = |count: usize| build(&tree(), &params(count, 64));
    assert_eq!(facts(&of(1)), [("trunk", trunk, 5, 8)], "all of it");
    let four = [
        ("trunk", trunk, 1, 2),
        ("trunk/0", limb, 1, 2),
        ("trunk/0/0", twig, 2, 2),
        ("trunk/1", other, 1, 2),
    ];
    assert_eq!(facts(&of(4)), four, "each limb");
    assert_eq!(facts(&of(25)), four, "and no more than there are");
    let three = [("trunk", trunk, 1, 2), ("trunk/0", limb, 3, 4), ("trunk/1", other, 1, 2)];
    assert_eq!(facts(&of(3)), three, "the two limbs lie farther apart than limb and twig");
    let parents: Vec<Option<usize>> = of(4).layers().iter().map(|layer| layer.parent).collect();
    assert_eq!(parents, [None, Some(0), Some(1), Some(0)], "what hangs from what");
    // both limbs in one group: the anchor is weighed by area, 3 leaves of 0.25 m2 and 0.2 + 0.2 m2 of
    // wood at y = 2 against one leaf and 0.2 m2 at y = 3
    let two = of(2);
    let (left, right) = (0.75 + 0.4, 0.25 + 0.2);
    let anchor = DVec3::Y * ((left * 2.0 + right * 3.0) / (left + right));
    let (name, found, leaf_count, wood_count) = facts(&two)[1];
    assert_eq!((name, leaf_count, wood_count), ("trunk/0", 4, 6), "everything on the trunk");
    assert!(found.distance(anchor) < 1e-6, "{found} for {anchor}");
}

#[test]
fn a_layer_lies_at_the_mean_depth_of_what_it_shows() {
    let lod = build(&tree(), &Params { tilt: false, ..params(4, 64) });
    let depth = |layer: usize| {
        let depths = lod.layers()[layer].corners.expect("shows something").map(|corner| corner.z);
        assert_eq!(depths, [depths[0]; 4], "across the direction");
        depths[0]
    };
    assert!(depth(0).abs() < 1e-9, "trunk and its leaf");
    // a leaf of 0.25 m2 at 0.25 m, wood of 0.2 m2 at 0
    assert!((depth(1) - 0.25 * 0.25 / 0.45).abs() < 1e-6, "{}", depth(1));
    assert!((depth(2) - 0.5 * 0.5 / 0.7).abs() < 1e-6, "{}", depth(2));
    assert!((depth(3) + 0.5).abs() < 1e-6, "all at one depth: {}", depth(3));
    // far to near: the other limb, the trunk, limb 1, its twig
    let order: Vec<usize> = lod.cards.all().iter().map(|card| card.layer).collect();
    assert_eq!(order, [3, 0, 1, 2], "painted in this order");
}

#[test]
fn a_tilted_layer_hangs_at_its_anchor_and_looks_the_same() {
    let (tilted, flat) =
        (build(&tree(), &params(4, 64)), build(&tree(), &Params { tilt: false, ..params(4, 64) }));
    // the plane through three corners, at the anchor
    for layer in tilted.layers() {
        let [a, b, _, d] = layer.corners.expect("shows something");
        let normal = (b - a).cross(d - a).normalize();
        assert!((layer.anchor - a).dot(normal).abs() < 1e-9, "{}", layer.name);
        assert!(normal.z > 0.7, "{}: at most 45 degrees", layer.name);
    }
    // limb 1 bears its leaf 0.25 m nearer to the viewer, 2 m to the left
    let [left, right, ..] = tilted.layers()[1].corners.expect("shows something");
    assert!(left.z > right.z + 0.1, "nearer on the left: {left}, {right}");
    let view = baked_view(&flat);
    let (a, b) = (one_sample(&tilted, &view), one_sample(&flat, &view));
    let (covered, unlike) = different(&a, &b, 1e-3);
    assert!(covered > 100 && unlike == 0, "{unlike} of {covered} from where both were baked");
    let aside = perspective(from_azimuth(40.0) * 9.0 + DVec3::Y * 2.5, DVec3::Y * 2.5, DVec3::Y);
    assert!(draw(&tilted, &aside).color != draw(&flat, &aside).color, "but not from elsewhere");
}

#[test]
fn several_stems_are_trunks_of_their_own() {
    let mut plant = tree();
    let mut structure = plant.structure.as_deref().expect("given").clone();
    structure.branches[3].parent = None;
    plant.structure = Some(Arc::new(structure));
    let lod = build(&plant, &params(9, 32));
    let names: Vec<&str> = facts(&lod).into_iter().map(|layer| layer.0).collect();
    assert_eq!(names, ["0", "0/0", "0/0/0", "1"], "by number");
}

#[test]
fn every_leaf_is_in_exactly_one_layer() {
    for count in [1, 2, 3, 5, 8, 40] {
        let grown = crate::plant::grow::grow(
            "chestnut",
            3,
            Some(900),
            crate::plant::Lighting::default(),
            &Job::default(),
        )
        .expect("grown");
        let limbs = Limbs::of(&grown, &Job::default()).expect("runs").expect("many");
        let content: Vec<Moment> = (0..limbs.parents.len())
            .map(|limb| Moment::new(1.0 + (limb % 5) as f64, limbs.starts[limb]))
            .collect();
        let (found, group_of) = groups(&limbs, &content, count, &Job::default()).expect("runs");
        assert_eq!(found.len(), count, "as many as asked for");
        for (number, &group) in (0_u32..).zip(&group_of) {
            let limb = number as usize;
            // a limb is with its parent, or begins its group, which then hangs from the parent's
            match limbs.parents[limb] {
                Some(parent) if group_of[parent as usize] == group => {}
                Some(parent) => {
                    assert!(found[group].roots.contains(&number), "limb {limb} begins it");
                    assert_eq!(found[group].parent, Some(group_of[parent as usize]), "{limb}");
                }
                None => assert_eq!((group, found[group].parent), (0, None), "the trunk"),
            }
        }
        assert_eq!(found[0].roots, [0], "the trunk alone");
        let lod = build(&grown, &params(count, 48));
        let sum: usize = lod.layers().iter().map(|layer| layer.leaf_count).sum();
        assert_eq!(sum, 900, "{count} layers");
    }
}

#[test]
fn groups_without_area_are_not_parted() {
    let limbs = Limbs {
        parents: vec![None, Some(0), Some(0)],
        starts: vec![DVec3::ZERO, DVec3::Y, DVec3::X],
        leaf_limbs: vec![],
        wood_limbs: vec![],
    };
    let nothing = [Moment::default(); 3];
    let (found, _) = groups(&limbs, &nothing, 9, &Job::default()).expect("runs");
    let names: Vec<&str> = found.iter().map(|group| group.name.as_str()).collect();
    assert_eq!(names, ["trunk", "trunk/0"], "nothing to gain");
    assert_eq!(found[1].anchor, DVec3::new(0.5, 0.5, 0.0), "half way between two that weigh alike");
    let stopped = Job::default();
    stopped.cancel();
    assert_eq!(groups(&limbs, &nothing, 9, &stopped), Err(LodError::Cancelled), "stopped");
}

#[test]
fn texels_lie_on_one_grid() {
    let bounds = (DVec2::new(-1.0, -2.0), DVec2::new(3.0, 6.0));
    let grid = Grid::new(FRONT, DVec3::ZERO, 9.0, bounds, 16, f64::INFINITY);
    assert_eq!(grid.texel, 0.5, "8 m are 16 texels");
    let whole = grid.cells(bounds);
    assert_eq!(whole.size, (8, 16), "all of it");
    let part = grid.cells((DVec2::new(0.1, 0.0), DVec2::new(0.9, 1.25)));
    assert_eq!(part.size, (2, 3), "what is touched");
    let rect = grid.rect(part, 4.0);
    assert_eq!((rect.center, rect.width, rect.height), (DVec3::new(0.5, 0.75, 4.0), 1.0, 1.5));
    assert_eq!(Grid::inside(whole, part), (2, 9), "columns from the left, rows from the top");
    assert_eq!(grid.cells((DVec2::ONE, DVec2::ONE)).size, (1, 1), "a point still has a texel");
    let corner = grid.cells((bounds.1, bounds.1));
    assert_eq!(corner.size, (1, 1), "also on the last line");
    assert_eq!((Grid::inside(whole, corner), grid.whole()), ((7, 0), whole), "inside");
    let few = Grid::new(FRONT, DVec3::ZERO, 9.0, bounds, 16, 1.0);
    assert_eq!(few.cells(bounds).size, (4, 8), "a texel a metre is enough");
    let one = Grid::new(FRONT, DVec3::ZERO, 9.0, bounds, 16, 1e-9);
    assert_eq!(one.cells(bounds).size, (1, 1), "never less than one");
}

#[test]
fn what_reaches_over_a_border_is_cut_there() {
    // slabs of 1 m from -2 to 2
    let long = (Vec3::new(0.0, 0.0, 0.25), Vec3::Z * 0.5, Vec3::Y * 0.2);
    let crown = plant(&[
        square(-3.0, 0.0, -2.0, 0.1),
        square(3.0, 0.0, 2.0, 0.1),
        square(0.0, 0.0, -0.5, 0.3),
        long,
        square(0.0, 0.0, 1.0, 0.3),
    ]);
    let leaves = Leaves::new(&crown).expect("leaves");
    let slabs = Slabs::new(&leaves, DVec3::Z, 4);
    let offsets: Vec<f64> = (0..4).map(|slab| slabs.offset(slab)).collect();
    assert_eq!(offsets, [-1.5, -0.5, 0.5, 1.5], "planes in the middle");
    assert_eq!(slabs.ends(0), (f64::NEG_INFINITY, -1.0), "the first is open");
    assert_eq!(slabs.ends(3), (1.0, f64::INFINITY), "so is the last");
    let held: Vec<usize> =
        [-9.0, -1.5, -1.0, -0.1, 0.0, 0.999, 1.0, 9.0].map(|at| slabs.holding(at)).to_vec();
    assert_eq!(held, [0, 0, 1, 1, 2, 2, 3, 3], "on a border, the nearer to the viewer");
    let whole = |leaf| Placed { leaf, cut: false };
    let cut = |leaf| Placed { leaf, cut: true };
    let expected = [
        vec![whole(0)],
        vec![whole(2), cut(3)],
        // what lies on a border may be on either side, by rounding of its depth
        vec![cut(3), cut(4)],
        vec![whole(1), cut(4)],
    ];
    assert_eq!(slabs.assign(&leaves, DVec3::Z), expected, "cut ones are in both");
    let sheet = plant(&[square(0.0, 0.0, 1.0, 0.1), square(1.0, 0.0, 1.0, 0.1)]);
    let leaves = Leaves::new(&sheet).expect("leaves");
    assert_eq!(Slabs::new(&leaves, DVec3::Z, 9).count(), 1, "no depth to part");
    assert_eq!(Slabs::new(&leaves, DVec3::X, 9).count(), 9, "but from the side");
}

/// Covered pixels of a picture, and those of another that differ in colour by more than `most`.
fn different(a: &[Vec4], b: &[Vec4], most: f32) -> (usize, usize) {
    let covered = a.iter().filter(|pixel| pixel.w > 0.0).count();
    let unlike = a.iter().zip(b).filter(|(a, b)| (**a - **b).abs().max_element() > most).count();
    (covered, unlike)
}

/// Half a code of 8-bit sRGB is at most this in linear light.
const STORED: f32 = 0.0046;

#[test]
fn slabs_are_the_picture_from_where_they_were_baked() {
    let trunk = (Vec3::new(0.0, -1.0, 0.2), Vec3::new(0.1, 0.0, 0.2), Vec3::Y);
    let mut plant = plant_at(DVec3::ZERO, &[trunk], &random_crown(300));
    for (vertex, front) in plant.foliage.mesh.front.iter_mut().enumerate() {
        *front = Vec3::new((vertex / 4 % 7) as f32 / 7.0, (vertex / 4 % 5) as f32 / 5.0, 0.5);
        plant.foliage.mesh.back[vertex] = *front;
    }
    let full =
        FullMesh::build(&plant, Wood::Full, Filter::Bilinear, &Job::default()).expect("valid");
    for azimuth in [0.0, 25.0] {
        for count in [1, 2, 7, 25] {
            let with = Params {
                direction: from_azimuth(azimuth),
                grouping: Grouping::Slabs,
                ..params(count, 96)
            };
            let lod = build(&plant, &with);
            assert_eq!(lod.layers().len(), count, "as asked for");
            // a pixel a texel: the view of all the grid's texels
            let view = baked_view(&lod);
            let (a, b) = (one_sample(&full, &view), one_sample(&lod, &view));
            let (covered, unlike) = different(&a, &b, STORED);
            assert!(covered > 1500, "{covered} pixels show something");
            assert_eq!(unlike, 0, "{azimuth} degrees, {count} slabs, of {covered}");
            // the control: from elsewhere, or without one of the slabs, it is another picture
            let mut aside = view.clone();
            aside.eye += aside.right * 0.05;
            assert!(different(&a, &one_sample(&lod, &aside), STORED).1 > 100, "moved");
            let here = [crown_at(DAffine3::from_translation(lod.origin()), 0)];
            let mut fewer = emit(&lod, &view, &here);
            assert_eq!(fewer.items.len(), 1, "all of them");
            fewer.items[0].primitives.end -= 1;
            assert!(different(&a, &rendered(&fewer, &view), STORED).1 > 0, "{count}: one less");
        }
    }
}

/// Metres a texel.
fn texel(lod: &LayeredBillboards) -> f64 {
    let card = &lod.cards.all()[0];
    let [left, right, ..] = card.corners.map(|corner| lod.frame.seen(corner).x);
    (right - left) / f64::from(card.texels[2])
}

/// A parallel view from where layers were baked, with a pixel a texel of the whole grid.
fn baked_view(lod: &LayeredBillboards) -> View {
    let none = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    let (low, high) = lod.cards.all().iter().fold(none, |(low, high), card| {
        let corners = card.corners.map(|corner| lod.frame.seen(corner));
        (low.min(corners[0]), high.max(corners[2]))
    });
    let texel = texel(lod);
    let size = (high - low) / texel;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "few texels")]
    let size = (size.x.round() as u32, size.y.round() as u32);
    let middle = (low + high) * 0.5;
    let center = lod.frame.right * middle.x + lod.frame.up * middle.y;
    let rect = crate::bake::BakeRect {
        center,
        right: lod.frame.right,
        up: lod.frame.up,
        width: f64::from(size.0) * texel,
        height: f64::from(size.1) * texel,
        reach: 50.0,
    };
    rect.view(size).expect("valid")
}

fn one_sample(lod: &dyn Representation, view: &View) -> Vec<Vec4> {
    rendered(&emit(lod, view, &[crown_at(DAffine3::from_translation(lod.origin()), 0)]), view)
}

fn rendered(list: &DrawList, view: &View) -> Vec<Vec4> {
    let settings = crate::raster::Settings {
        sample_count: 1,
        outputs: crate::raster::Outputs::COLOR,
        background: Vec4::ZERO,
        counts_fragments: false,
    };
    let mut renderer = crate::raster::Renderer::default();
    renderer.render(list, view, &settings, &Job::default()).expect("valid").color
}

fn cards(list: &DrawList) -> Vec<u32> {
    let over = list.items.iter().filter(|item| item.blend == Blend::Over);
    over.flat_map(|item| item.primitives.clone()).collect()
}

#[test]
fn layers_are_painted_far_to_near_from_either_side() {
    let lod =
        build(&plant(&random_crown(200)), &Params { grouping: Grouping::Slabs, ..params(4, 32) });
    let here = [crown_at(DAffine3::IDENTITY, 0)];
    let order = |view: &View| cards(&emit(&lod, view, &here));
    let from = |z: f64, to: f64| perspective(DVec3::Z * z, DVec3::Z * to, DVec3::Y);
    assert_eq!(order(&from(9.0, 0.0)), [0, 1, 2, 3], "from the front");
    assert_eq!(emit(&lod, &from(9.0, 0.0), &here).items.len(), 1, "in one item");
    assert_eq!(order(&from(-9.0, 0.0)), [3, 2, 1, 0], "from behind");
    assert_eq!(order(&parallel(DVec3::NEG_Z, DVec3::Y, 4.0, 8)), [3, 2, 1, 0], "in parallel");
    let inside = order(&from(0.01, 3.0));
    let place = |card: u32| inside.iter().position(|&c| c == card).expect("drawn");
    assert!(place(3) < place(2) && place(0) < place(1), "around an eye inside: {inside:?}");
    // turned to a viewer on the other side, what was behind is in front again
    let turning = Params {
        grouping: Grouping::Slabs,
        turn: Turn::Viewer { max_turn: PI },
        wood: Wood::None,
        ..params(4, 32)
    };
    let lod = build(&plant(&random_crown(200)), &turning);
    assert_eq!(cards(&emit(&lod, &from(-9.0, 0.0), &here)), [0, 1, 2, 3], "all turned round");
    let tested = Params { drawing: Drawing::Test, ..params(4, 32) };
    let lod = build(&plant(&random_crown(200)), &tested);
    let list = emit(&lod, &from(9.0, 0.0), &here);
    assert!(list.items.iter().all(|item| item.blend == Blend::Test(0.5) && item.depth_write), "z");
}

#[test]
fn turned_layers_look_the_same_from_all_around() {
    // one leaf in front of its anchor: wherever the viewer is, it faces him
    let mut plant =
        plant_at(DVec3::ZERO, &[(Vec3::Y, Vec3::X * 0.01, Vec3::Y)], &[square(0.0, 2.0, 0.0, 0.5)]);
    let branch = |parent, start: Vec3, leaves, wood| Branch {
        parent,
        level: 0,
        start,
        end: start,
        radius: 0.1,
        wood_triangles: wood,
        leaves,
    };
    plant.structure = Some(Arc::new(Structure {
        branches: vec![
            branch(None, Vec3::ZERO, 0..0, 0..2),
            branch(Some(0), Vec3::Y * 2.0, 0..1, 2..2),
        ],
        leaf_branches: vec![1],
    }));
    let turn = Turn::Viewer { max_turn: PI };
    let lod = build(&plant, &Params { turn, wood: Wood::None, ..params(2, 32) });
    let alpha = |lod: &LayeredBillboards, toward: DVec3| -> f32 {
        let view = perspective(toward * 6.0 + DVec3::Y * 2.0, DVec3::Y * 2.0, DVec3::Y);
        draw(lod, &view).color.iter().map(|pixel| pixel.w).sum()
    };
    let front = alpha(&lod, DVec3::Z);
    assert!(front > 10.0, "seen: {front}");
    for toward in [from_azimuth(80.0), from_azimuth(180.0), DVec3::new(0.0, 0.6, 0.8)] {
        let there = alpha(&lod, toward);
        assert!((there - front).abs() < 0.02 * front, "{there} from {toward}, {front} from +z");
    }
    let limited =
        Params { turn: Turn::Viewer { max_turn: 0.3 }, wood: Wood::None, ..params(2, 32) };
    assert!(alpha(&build(&plant, &limited), from_azimuth(100.0)) < 0.5 * front, "not that far");
}

#[test]
fn views_need_no_more_texels_than_they_have_pixels() {
    let plant = tree();
    let near = perspective(DVec3::Z * 12.0, DVec3::ZERO, DVec3::Y);
    let far = perspective(DVec3::Z * 50.0, DVec3::ZERO, DVec3::Y);
    let with = |views: &[&View]| {
        let views = views.iter().map(|&view| view.clone()).collect();
        build(&plant, &Params { views: Some(views), ..params(4, 512) })
    };
    let bytes = |lod: &LayeredBillboards| lod.footprint().texture_bytes;
    let (one, both) = (with(&[&near]), with(&[&far, &near]));
    assert_eq!(bytes(&one), bytes(&both), "the nearest decides");
    let leaves = Leaves::new(&build_elements(&plant)).expect("elements").radius;
    let nearest = DVec3::Z * 12.0;
    let center = Leaves::new(&build_elements(&plant)).expect("elements").center;
    let expected = near.pixel_size_at(center.distance(nearest) - leaves);
    assert!((texel(&one) - expected).abs() < 1e-12, "a pixel's size: {}", texel(&one));
    assert!(bytes(&with(&[&far])) < bytes(&one), "fewer for a farther one");
    let limited = build(&plant, &Params { views: Some(vec![near]), ..params(4, 8) });
    assert_eq!(bytes(&limited), bytes(&build(&plant, &params(4, 8))), "no more than asked for");
    let none = Params { views: Some(vec![]), ..params(4, 16) };
    let error = LayeredBillboards::build(&plant, &none, &Job::default()).expect_err("refused");
    assert!(error.to_string().starts_with("views is empty"), "{error}");
}

/// Wood and leaves as what is baked.
fn build_elements(plant: &Plant) -> Plant {
    super::Content::new(plant, &plant.wood, WoodAs::Baked, &Job::default())
        .expect("valid")
        .plant
        .into_owned()
}

#[test]
fn the_same_on_any_number_of_threads() {
    let plant = tree();
    for with in [params(4, 64), Params { grouping: Grouping::Slabs, ..params(5, 64) }] {
        let built = |threads: usize| {
            job::run(Some(threads), || LayeredBillboards::build(&plant, &with, &Job::default()))
                .expect("valid")
        };
        let (one, three) = (built(1), built(3));
        assert_eq!(one.layers(), three.layers(), "layers");
        let texels = |lod: &LayeredBillboards| lod.cards.texture().levels().to_vec();
        assert!(texels(&one) == texels(&three), "texels");
    }
}

#[test]
fn every_awkward_crown_and_camera_gives_a_picture() {
    let turns = [Turn::Fixed, Turn::Viewer { max_turn: PI }];
    for (name, leaves) in crowns() {
        let crown = plant(&leaves);
        for count in [1, 5] {
            for (turn, drawing) in turns.into_iter().zip([Drawing::Blend, Drawing::Test]) {
                let job = Job::default();
                let wood = if turn == Turn::Fixed { Wood::Full } else { Wood::None };
                let with = Params { turn, drawing, wood, ..params(count, 16) };
                let built = LayeredBillboards::build(&crown, &with, &job);
                let what = format!("{name}: {count}, {turn:?}");
                let lod = built.unwrap_or_else(|error| panic!("{what}: {error}"));
                let (done, total) = job.progress();
                assert_eq!(done, total, "{what}: all steps that were announced");
                let (low, high) = lod.bounds();
                assert!(low.is_finite() && high.is_finite(), "{what}: {low} to {high}");
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
    let of = |leaves: &[Leaf], origin: DVec3| build(&plant_at(origin, &[], leaves), &params(5, 32));
    let view = |scale: f64, origin: DVec3| {
        perspective(origin + DVec3::new(0.5, 0.5, 3.25) * scale, origin, DVec3::Y)
    };
    let wanted = draw(&of(&crown, DVec3::ZERO), &view(1.0, DVec3::ZERO));
    assert!(wanted.color.iter().any(|pixel| pixel.w > 0.5), "it is in the picture");
    for exponent in [-13, 13] {
        let scale = 2.0_f32.powi(exponent);
        let scaled: Vec<Leaf> =
            crown.iter().map(|&(a, b, c)| (a * scale, b * scale, c * scale)).collect();
        let frame = draw(&of(&scaled, DVec3::ZERO), &view(f64::from(scale), DVec3::ZERO));
        assert!(frame.color == wanted.color, "2^{exponent} times as large");
    }
    let origin = DVec3::new(1_048_576.0, -524_288.0, 2_097_152.0);
    let far = of(&crown, origin);
    assert!(draw(&far, &view(1.0, origin)).color == wanted.color, "far from the world's origin");
    assert_eq!(far.origin(), origin, "where it stands");
}

#[test]
fn bad_parameters_are_refused_by_name() {
    let plant = tree();
    let good = || params(4, 16);
    let viewer = |max_turn: f64| Turn::Viewer { max_turn };
    let cases = [
        ("layer_count", Params { layer_count: 0, ..good() }),
        ("layer_count", Params { layer_count: 4097, ..good() }),
        ("resolution", Params { resolution: 0, ..good() }),
        ("resolution", Params { resolution: 8193, ..good() }),
        ("samples", Params { sample_count: 2, ..good() }),
        ("growth", Params { growth: -0.1, ..good() }),
        ("growth", Params { growth: f64::NAN, ..good() }),
        ("direction", Params { direction: DVec3::ZERO, ..good() }),
        ("direction", Params { direction: DVec3::NAN, ..good() }),
        ("direction", Params { direction: DVec3::INFINITY, ..good() }),
        ("max_turn_deg", Params { turn: viewer(f64::NAN), wood: Wood::None, ..good() }),
        ("max_turn_deg", Params { turn: viewer(-0.1), wood: Wood::None, ..good() }),
        ("wood_as", Params { turn: viewer(1.0), ..good() }),
        ("wood_triangle_count", Params { wood: Wood::Simplified(4), ..good() }),
        (
            "wood_triangle_count",
            Params { wood: Wood::Simplified(0), wood_as: WoodAs::Mesh, ..good() },
        ),
        (
            "resolution needs",
            Params { grouping: Grouping::Slabs, layer_count: 500, resolution: 8192, ..good() },
        ),
    ];
    let refused = |plant: &Plant, with: &Params| {
        LayeredBillboards::build(plant, with, &Job::default()).expect_err("refused").to_string()
    };
    for (name, with) in cases {
        let message = refused(&plant, &with);
        assert!(message.starts_with(name), "{name}: {message}");
    }
    let no_branches = plant_at(DVec3::ZERO, &[], &random_crown(10));
    let message = refused(&no_branches, &Params { grouping: Grouping::Branches, ..good() });
    assert!(message.starts_with("groups"), "{message}");
    let bare = plant_at(DVec3::ZERO, &[square(0.0, 0.0, 0.0, 1.0)], &[]);
    let message = refused(&bare, &Params { wood_as: WoodAs::Mesh, ..good() });
    assert!(message.starts_with("foliage is empty"), "{message}");
    let leafless = build(&bare, &good());
    assert_eq!(leafless.footprint().card_count, 1, "bare wood can be baked");
    let job = Job::default();
    job.cancel();
    let stopped = LayeredBillboards::build(&plant, &good(), &job).expect_err("cancelled");
    assert_eq!(stopped, LodError::Cancelled, "stopped");
}
