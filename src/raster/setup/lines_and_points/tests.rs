//! Eight at once against one by one, and lines against the two triangles that they stand for.

use glam::{DAffine3, DVec3, Vec2, Vec4};

use super::*;
use crate::draw_list::{Blend, Buffers, DrawList, Instance, Primitive};
use crate::job::Job;
use crate::raster::grid::Grid;
use crate::raster::placing::{Chosen, Placing};
use crate::raster::setup::cut;
use crate::raster::tests::{ALL, add, buffers, pixel_view};
use crate::raster::{EMPTY_ID, Frame, Outputs, Renderer, Settings, samples};
use crate::simd::Level;
use crate::view::{Projection, View};

/// Points around the eye, on the near plane and far out, with normals of all directions.
fn cloud(count: u32) -> Buffers {
    let number = |index: u32, axis: u32| {
        let hash = (index * 3 + axis).wrapping_mul(0x9E37_79B9) ^ 0x85EB_CA6B;
        ((hash ^ hash >> 15).wrapping_mul(0x2C1B_3C6D) >> 8) as f32 / 8_388_608.0 - 1.0
    };
    let vector = |index| Vec3::new(number(index, 0), number(index, 1), number(index, 2));
    let mut positions: Vec<Vec3> = (0..count).map(|index| vector(index) * 4.0).collect();
    positions[1] = Vec3::new(0.0, 0.0, -0.25);
    positions[2] = Vec3::new(1e30, 0.0, -1.0);
    positions[3] = Vec3::ZERO;
    Buffers {
        normals: (0..count).map(|index| vector(index + count).normalize_or_zero()).collect(),
        uvs: vec![Vec2::ZERO; positions.len()],
        base: vec![Vec4::ONE; positions.len()],
        front: vec![Vec3::ONE; positions.len()],
        back: vec![Vec3::ZERO; positions.len()],
        indices: (0..count).rev().collect(),
        source_ids: Vec::new(),
        positions,
    }
}

/// A list of these alone, stretched and mirrored.
fn placed(data: Buffers, view: &View, primitive: Primitive, blend: Blend) -> DrawList {
    let mut list = DrawList::default();
    add(&mut list, view, primitive, data, blend);
    let place = DAffine3::from_scale(DVec3::new(1.0, 0.8, -1.1));
    list.instances[0] = Instance::new(&place, view);
    list
}

/// Box in steps, pixels, key bits, whether the front is seen, and the vertex.
type Facts = ([i32; 4], [u16; 4], u32, bool, u32);

/// One point after the other, by the definition.
fn by_definition(list: &DrawList, view: &View, grid: &Grid, half: f32) -> Vec<Facts> {
    let buffers = list.vertices_of(&list.items[0]);
    let instance = &list.instances[0];
    let placing = Placing::new(view, instance.linear, instance.translation);
    let mut placed = Vec::new();
    let level = Level::named("simd", "scalar").expect("everywhere");
    let chosen = Chosen::Indexed(&buffers.positions, &buffers.indices);
    placing.vertices(level, chosen, &mut placed);
    let facts = |vertex: &ScreenVertex| {
        let low = [snap(vertex.x - half), snap(vertex.y - half)];
        let high = [snap(vertex.x + half) - 1, snap(vertex.y + half) - 1];
        if vertex.key.is_nan() || low[0] > high[0] || low[1] > high[1] {
            return None;
        }
        let pixels = grid.pixel_box(low, high)?;
        let at = vertex.source as usize;
        let front = placing.side_seen(buffers.positions[at], buffers.normals[at]) != 0;
        let rect = [low[0], low[1], high[0], high[1]];
        Some((rect, pixels, vertex.key.to_bits(), front, vertex.source))
    };
    placed.iter().filter_map(facts).collect()
}

#[test]
fn eight_points_at_once_are_as_one_by_one() {
    let projections =
        [Projection::Perspective { fov_y: 1.2 }, Projection::Orthographic { height: 3.0 }];
    for (projection, count) in projections.into_iter().flat_map(|p| [(p, 9), (p, 5000)]) {
        let (eye, to) = (DVec3::new(0.1, 0.2, 0.0), DVec3::new(0.0, 0.1, -3.0));
        let view = View::new(eye, to, DVec3::Y, projection, (70, 50), 0.25).expect("valid");
        for (size_px, sample_count) in [(0.004, 4), (0.7, 1), (2.3, 16), (300.0, 8)] {
            let list = placed(cloud(count), &view, Primitive::Points { size_px }, Blend::Opaque);
            let positions = samples::positions(sample_count).expect("allowed");
            let grid = Grid::new(&view, 32, 0..2, &positions);
            let expected = by_definition(&list, &view, &grid, size_px * 0.5);
            for level in Level::all() {
                let mut found: Vec<Facts> = Vec::new();
                for segments in cut(&list) {
                    let mut unit = Unit::default();
                    unit.build(level, &list, &view, &grid, &segments);
                    found.extend(unit.shapes.iter().zip(&unit.origins).map(|(s, o)| {
                        let rect = [s.x[0], s.y[0], s.x[1], s.y[1]];
                        let front = s.tag.has(flags::FRONT);
                        (rect, s.pixels, s.key[0].to_bits(), front, o.vertices[0])
                    }));
                }
                assert_eq!(found, expected, "{level:?}, {count} of {size_px} px");
            }
            let fronts = expected.iter().filter(|facts| facts.3).count();
            let mixed = fronts > 0 && fronts < expected.len();
            assert!(count < 10 || size_px < 0.1 || mixed, "some seen from either side");
        }
    }
}

/// Lines of all directions and of lengths from nothing to most of the picture, a few of them behind the
/// eye, in colours that change along them.
fn sticks(count: u32) -> Buffers {
    let mut data = cloud(2 * count);
    for line in 0..count as usize {
        let (near, far) = (2 * line, 2 * line + 1);
        let share = [0.0, 0.02, 0.1, 0.3, 1.0][line % 5];
        let start = data.positions[near] * Vec3::new(0.5, 0.5, 1.0);
        data.positions[near] = start;
        data.positions[far] = start + (data.positions[far] - start) * share;
        data.front[near] = data.normals[near].abs();
        data.front[far] = data.normals[far].abs();
        data.back[near] = Vec3::X;
        data.back[far] = Vec3::Y;
    }
    data.indices.reverse();
    data
}

fn list_of(
    data: &Buffers,
    view: &View,
    width_px: f32,
    (blend, slab): (Blend, Option<[f32; 2]>),
) -> DrawList {
    let mut list = placed(data.clone(), view, Primitive::Lines { width_px }, blend);
    list.items[0].slab = slab;
    list
}

fn drawn(list: &DrawList, view: &View, sample_count: u32, outputs: Outputs) -> Frame {
    let settings =
        Settings { sample_count, outputs, background: Vec4::ZERO, counts_fragments: false };
    Renderer::default().render(list, view, &settings, &Job::default()).expect("valid")
}

/// Share of the pixels that either picture covers: lines are snapped at three corners, triangles at each.
/// Seen: 0.0011.
const MOVED: f64 = 0.003;

/// Of a channel: where on a line a sample lies is told from snapped corners. Seen: 0.009.
const COLOR_TOLERANCE: f32 = 0.02;

/// Of a normal's components, which are longer than colours are bright. Seen: 0.022.
const NORMAL_TOLERANCE: f32 = 0.05;

/// Of a depth, as a share: both are computed from corners before snapping. Seen: 4e-6.
const DEPTH_TOLERANCE: f32 = 2e-5;

#[test]
fn a_line_is_what_its_two_triangles_are() {
    let projections =
        [Projection::Perspective { fov_y: 1.2 }, Projection::Orthographic { height: 6.0 }];
    // before the lines, and among them
    for (projection, z, near) in
        projections.into_iter().flat_map(|p| [(p, 4.0, 0.25), (p, 0.5, 1.5)])
    {
        let (eye, to) = (DVec3::new(0.1, 0.2, z), DVec3::new(0.0, 0.1, -3.0));
        let view = View::new(eye, to, DVec3::Y, projection, (200, 150), near).expect("valid");
        let settings = [(1.0, 1, None), (0.7, 4, None), (3.0, 1, None), (12.0, 16, None)];
        for (width_px, sample_count, slab) in
            settings.into_iter().chain([(2.0, 1, Some([1.5, 3.5]))])
        {
            let data = sticks(400);
            let list = list_of(&data, &view, width_px, (Blend::Opaque, slab));
            let in_two = list_of(&data, &view, width_px, (Blend::Test(0.0), slab));
            let whole = drawn(&list, &view, sample_count, ALL);
            let triangles = drawn(&in_two, &view, sample_count, ALL);
            let alone = drawn(&list, &view, sample_count, Outputs::COLOR).color;
            let apart = |(a, b): (&Vec4, &Vec4)| (*a - *b).abs().max_element();
            let most = alone.iter().zip(&whole.color).map(apart).fold(0.0_f32, f32::max);
            assert!(most <= 1e-5, "{width_px} px: colour alone is {most} from that among planes");
            let (mut covered, mut moved, mut worst) = (0_u32, 0_u32, [0.0_f32; 3]);
            for at in 0..whole.ids.len() {
                let is_drawn = [whole.ids[at], triangles.ids[at]] != [EMPTY_ID; 2];
                covered += u32::from(is_drawn);
                let alphas = [whole.color[at].w, triangles.color[at].w];
                if whole.ids[at] != triangles.ids[at] || alphas[0] != alphas[1] {
                    moved += 1;
                } else if is_drawn {
                    let apart = [
                        (whole.color[at] - triangles.color[at]).abs().max_element(),
                        (whole.normal[at] - triangles.normal[at]).abs().max_element(),
                        (whole.depth[at] / triangles.depth[at] - 1.0).abs(),
                    ];
                    worst = std::array::from_fn(|kind| worst[kind].max(apart[kind]));
                }
            }
            let case =
                format!("{projection:?}, z = {z}, {width_px} px, {sample_count} samples, {slab:?}");
            assert!(covered > 2000, "{case}: {covered} pixels covered");
            assert!(f64::from(moved) <= MOVED * f64::from(covered), "{case}: {moved} moved");
            let [color, normal, depth] = worst;
            let is_alike =
                color <= COLOR_TOLERANCE && normal <= NORMAL_TOLERANCE && depth <= DEPTH_TOLERANCE;
            // with more samples each triangle of the two has its colour in the middle of its own, and
            // a rim's depth may be that of a sample which only one way covers
            assert!(is_alike || sample_count > 1, "{case}: {worst:?}");
            let flagged = |list: &DrawList, flag: u32| {
                let positions = samples::positions(sample_count).expect("allowed");
                let grid = Grid::new(&view, 64, 0..3, &positions);
                let mut unit = Unit::default();
                let best = Level::all().pop().expect("scalar code works everywhere");
                unit.build(best, list, &view, &grid, &cut(list)[0]);
                let all = unit.shapes.len();
                (unit.shapes.iter().filter(|shape| shape.tag.has(flag)).count(), all)
            };
            let (lines, all) = flagged(&list, flags::LINE);
            assert!(lines > 20 && lines < all, "{case}: {lines} of {all}, and others");
            assert_eq!(flagged(&in_two, flags::LINE).0, 0, "{case}: tested, so in two");
        }
    }
}

#[test]
fn lines_of_one_depth_keep_their_order() {
    // the first is long, so it is two triangles; the second is a parallelogram inside of it
    let view = pixel_view(100, 5);
    let ends = [[1.0, 2.5, 0.0], [99.0, 2.5, 0.0], [20.0, 2.5, 0.0], [40.0, 2.5, 0.0]];
    for (indices, ids) in [([0, 1, 2, 3], [0, 0, 0]), ([2, 3, 0, 1], [1, 0, 1])] {
        let mut list = DrawList::default();
        let data = buffers(&ends, &indices);
        add(&mut list, &view, Primitive::Lines { width_px: 1.0 }, data, Blend::Opaque);
        let frame = drawn(&list, &view, 1, ALL);
        let row = &frame.ids[2 * 100..3 * 100];
        assert_eq!([row[10], row[30], row[50]], ids, "the first of each pixel");
    }
}
