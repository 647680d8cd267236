//! Set-up of lines, which are rectangles with butt ends, and of points, which are squares along the
//! picture's axes. Eight points are set up at once; of lines the two triangles that each consists of.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8};
use glam::Vec3;

use super::{Batch, Context, Origin, Shape, Unit, flags};
use crate::raster::grid::pixel_u16;
use crate::raster::placing::{GUARD_PX, ScreenVertex, snap, snap_lanes};
use crate::raster::samples::{SUBPIXEL_BITS, SUBPIXEL_COUNT};
use crate::simd::{Kernel, LANE_COUNT};

impl Unit {
    /// Lines as two triangles each.
    pub(super) fn lines(&mut self, context: &Context<'_>, width_px: f32) {
        let Context { list, item, placing, .. } = context;
        let buffers = list.vertices_of(item);
        let indices = &list.indices_of(item).indices;
        let mut batch = Batch { sides: Some([0; LANE_COUNT]), ..Batch::default() };
        for primitive in context.primitives.clone() {
            let at = primitive as usize * 2;
            let ends = [indices[at], indices[at + 1]];
            let local = ends.map(|v| buffers.positions[v as usize]);
            self.vertex_count += 2;
            let ends_local = local.map(|p| p.as_dvec3());
            let cut = placing.exact.line(ends_local, f64::from(GUARD_PX));
            let Some([a, b]) = cut else { continue };
            let along = [b[0] - a[0], b[1] - a[1]];
            let length = libm::hypotf(along[0], along[1]);
            if length == 0.0 {
                continue;
            }
            let half = width_px * 0.5 / length;
            let across = [-along[1] * half, along[0] * half];
            let corner = |end: [f32; 3], sign: f32, source: u32| {
                let (x, y) = (end[0] + sign * across[0], end[1] + sign * across[1]);
                ScreenVertex { x, y, key: end[2], source, snapped: [snap(x), snap(y)] }
            };
            let quad = [
                corner(a, -1.0, ends[0]),
                corner(b, -1.0, ends[1]),
                corner(b, 1.0, ends[1]),
                corner(a, 1.0, ends[0]),
            ];
            if quad.iter().any(|c| !(c.x.abs() <= GUARD_PX && c.y.abs() <= GUARD_PX)) {
                continue;
            }
            let side = placing.side_seen(local[0], buffers.normals[ends[0] as usize]);
            let base = u32::try_from(self.vertices.len()).expect("a unit is small");
            self.vertices.extend(quad);
            for corners in [[0, 1, 2], [0, 2, 3]] {
                if let Some(sides) = &mut batch.sides {
                    sides[batch.length % LANE_COUNT] = side;
                }
                let vertices = corners.map(|c| base + c);
                self.push(context, &buffers.positions, &mut batch, vertices, primitive);
            }
        }
        self.flush(context, &buffers.positions, &mut batch);
    }

    /// Points as rectangles.
    pub(super) fn points(&mut self, context: &Context<'_>, size_px: f32) {
        let Context { level, primitives, .. } = context;
        self.vertex_count += u64::from(primitives.end - primitives.start);
        level.run(SetUpPoints { unit: self, context, half: size_px * 0.5 });
    }
}

/// Sets up points, eight at a time, and appends those that may be seen.
struct SetUpPoints<'a> {
    unit: &'a mut Unit,
    context: &'a Context<'a>,
    half: f32,
}

impl Kernel for SetUpPoints<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { unit, context, half } = self;
        let Context { list, item, placing, primitives, grid, .. } = context;
        let buffers = list.vertices_of(item);
        let range = primitives.start as usize..primitives.end as usize;
        let indices = &list.indices_of(item).indices[range];
        unit.shapes.reserve(indices.len());
        unit.origins.reserve(indices.len());
        let up = SUBPIXEL_COUNT - 1;
        let [low_x, low_y] = grid.sample_low;
        let [high_x, high_y] = grid.sample_high;
        let [left, top, right, bottom] = grid.drawn();
        let (lowest, highest) = context.plain_keys;
        let mut first_primitive = primitives.start;
        for chosen in indices.chunks(LANE_COUNT) {
            let position = gathered(simd, &buffers.positions, chosen);
            let normal = gathered(simd, &buffers.normals, chosen);
            let ([x, y, key], inside) = placing.lanes(simd, position);
            let backs = placing.backs_seen(simd, position, normal).to_bitmask();
            // a sample on the right or lower edge belongs to the next square
            let [rect_x0, rect_y0] = [snap_lanes(x - half), snap_lanes(y - half)];
            let [rect_x1, rect_y1] = [snap_lanes(x + half) - 1, snap_lanes(y + half) - 1];
            let x0 = ((rect_x0 + (up - high_x)) >> SUBPIXEL_BITS).max(i32x8::splat(simd, left));
            let y0 = ((rect_y0 + (up - high_y)) >> SUBPIXEL_BITS).max(i32x8::splat(simd, top));
            let x1 = ((rect_x1 - low_x) >> SUBPIXEL_BITS).min(i32x8::splat(simd, right));
            let y1 = ((rect_y1 - low_y) >> SUBPIXEL_BITS).min(i32x8::splat(simd, bottom));
            let drawn = inside
                & x0.simd_le(x1)
                & y0.simd_le(y1)
                & rect_x0.simd_le(rect_x1)
                & rect_y0.simd_le(rect_y1);
            let plain = (key.simd_gt(f32x8::splat(simd, lowest))
                & key.simd_le(f32x8::splat(simd, highest)))
            .to_bitmask();
            let rect: [[i32; LANE_COUNT]; 4] =
                [rect_x0.into(), rect_y0.into(), rect_x1.into(), rect_y1.into()];
            let pixels: [[i32; LANE_COUNT]; 4] = [x0.into(), y0.into(), x1.into(), y1.into()];
            let place: [[f32; LANE_COUNT]; 3] = [x.into(), y.into(), key.into()];
            let mut left_over = drawn.to_bitmask() & ((1_u64 << chosen.len()) - 1);
            while left_over != 0 {
                let lane = left_over.trailing_zeros() as usize % LANE_COUNT;
                left_over &= left_over.wrapping_sub(1);
                let side = if backs >> lane & 1 == 1 { 0 } else { flags::FRONT };
                let plain = if plain >> lane & 1 == 1 { flags::PLAIN } else { 0 };
                let tag = context.tag.with(flags::RECT | side | plain);
                let key = place[2][lane];
                unit.shapes.push(Shape {
                    x: [rect[0][lane], rect[2][lane], 0],
                    y: [rect[1][lane], rect[3][lane], 0],
                    key: [key, 0.0, 0.0],
                    key_range: [key; 2],
                    origin: [place[0][lane], place[1][lane]],
                    pixels: [
                        pixel_u16(pixels[0][lane]),
                        pixel_u16(pixels[1][lane]),
                        pixel_u16(pixels[2][lane]),
                        pixel_u16(pixels[3][lane]),
                    ],
                    tag,
                });
                let primitive = first_primitive.wrapping_add(super::u32_from(lane));
                unit.origins.push(Origin { vertices: [chosen[lane]; 3], primitive, tag });
            }
            first_primitive = first_primitive.wrapping_add(super::u32_from(LANE_COUNT));
        }
    }
}

/// Components of up to eight vectors; the lanes after them are 0.
#[inline(always)]
fn gathered<S: Simd>(simd: S, vectors: &[Vec3], chosen: &[u32]) -> [f32x8<S>; 3] {
    let [mut x, mut y, mut z] = [[0.0; LANE_COUNT]; 3];
    for (lane, &index) in chosen.iter().take(LANE_COUNT).enumerate() {
        let vector = vectors[index as usize];
        (x[lane], y[lane], z[lane]) = (vector.x, vector.y, vector.z);
    }
    [f32x8::simd_from(simd, x), f32x8::simd_from(simd, y), f32x8::simd_from(simd, z)]
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3, Vec2, Vec4};

    use super::*;
    use crate::draw_list::{
        Blend, Buffers, DrawList, Geometry, Instance, Item, Primitive, Surface,
    };
    use crate::raster::grid::Grid;
    use crate::raster::placing::{Chosen, Placing};
    use crate::raster::samples;
    use crate::raster::setup::cut;
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
                let mut list = DrawList::default();
                let source = list.geometry(&Geometry::new(cloud(count)));
                let place = DAffine3::from_scale(DVec3::new(1.0, 0.8, -1.1));
                let instances = list.instance(Instance::new(&place, &view));
                list.items.push(Item {
                    primitive: Primitive::Points { size_px },
                    vertices: source,
                    indices: source,
                    primitives: 0..count,
                    instances,
                    surface: Surface::VertexColor,
                    blend: Blend::Opaque,
                    depth_write: true,
                    slab: None,
                });
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
}
