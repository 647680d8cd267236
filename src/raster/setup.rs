//! From a draw list to shapes in pixels: transform, clip, snap, cull, and sort into tiles.
//!
//! The list is cut into units of consecutive primitives; units are independent, so they are built in
//! parallel and drawn in order. Corners are snapped to 1/256 pixel for coverage; depth and attributes
//! come from the corners as they were. A triangle that reaches behind the near plane or far outside
//! the picture is clipped in f64.

use std::ops::Range;

use glam::{DMat3, Mat3, Vec3};

use crate::draw_list::{DrawList, Item, Primitive};
use crate::raster::clip::{ClipSpace, clip_polygon};
use crate::raster::samples::{SUBPIXEL_BITS, SUBPIXEL_COUNT, SamplePosition};
use crate::texture::texture::floor_to_i32;
use crate::view::View;

/// Primitives a unit holds: enough to pay for its tile table, few enough to share among threads.
pub(crate) const UNIT_PRIMITIVE_COUNT: u32 = 2048;

/// Corners further out than this many pixels are clipped, so that fixed-point sums fit in i64.
const GUARD_PX: f32 = 1_048_576.0;

/// A vertex on the picture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScreenVertex {
    /// Pixels.
    pub(crate) x: f32,
    pub(crate) y: f32,
    /// Grows towards the viewer: 1 / depth (perspective) or -depth (orthographic). NaN: to be
    /// clipped.
    pub(crate) key: f32,
    /// Index into the item's vertex arrays.
    pub(crate) source: u32,
}

/// What a shape is, beside its corners.
pub(crate) mod flags {
    /// The counter-clockwise side is seen.
    pub(crate) const FRONT: u8 = 1;
    /// `vertices` index the item's arrays; attributes come from f64 clip space.
    pub(crate) const CLIPPED: u8 = 2;
    /// An axis-aligned rectangle: `x[0]..=x[1]` by `y[0]..=y[1]`.
    pub(crate) const RECT: u8 = 4;
    /// Fixed-point sums need i64.
    pub(crate) const WIDE: u8 = 8;
}

/// A triangle or rectangle ready to be drawn.
#[derive(Clone, Debug)]
pub(crate) struct Shape {
    /// Snapped corners, clockwise as seen on the picture (y down), in sub-pixel steps.
    pub(crate) x: [i32; 3],
    pub(crate) y: [i32; 3],
    /// Depth key at `origin`, and its change a pixel.
    pub(crate) key: [f32; 3],
    pub(crate) key_range: [f32; 2],
    pub(crate) origin: [f32; 2],
    /// Pixels of the picture that it can touch: x0, y0, x1, y1, ends inclusive.
    pub(crate) pixels: [u16; 4],
    /// Indices into the unit's `vertices`, in the item's order of corners.
    pub(crate) vertices: [u32; 3],
    /// Index of the primitive in the item's index buffer.
    pub(crate) primitive: u32,
    /// Index into the unit's `segments`.
    pub(crate) segment: u32,
    pub(crate) flags: u8,
}

/// Consecutive primitives of one item, for one instance.
#[derive(Clone, Debug)]
pub(crate) struct Segment {
    pub(crate) item: u32,
    pub(crate) instance: u32,
    pub(crate) primitives: Range<u32>,
}

/// What one job sets up.
#[derive(Debug, Default)]
pub(crate) struct Unit {
    pub(crate) segments: Vec<Segment>,
    pub(crate) vertices: Vec<ScreenVertex>,
    pub(crate) shapes: Vec<Shape>,
    /// Shapes of tile `t`: `tile_shapes[tile_offsets[t]..tile_offsets[t + 1]]`, in order.
    tile_offsets: Vec<u32>,
    tile_shapes: Vec<u32>,
    /// Vertices transformed.
    pub(crate) vertex_count: u64,
}

/// The picture's grid of tiles and the rows that are drawn now.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grid {
    pub(crate) width: i32,
    pub(crate) height: i32,
    /// Pixels a tile's side, a power of two.
    pub(crate) tile: i32,
    tile_bits: u32,
    pub(crate) columns: i32,
    /// Tile rows drawn, end exclusive.
    pub(crate) first_row: i32,
    pub(crate) last_row: i32,
    /// Smallest and largest sample position inside a pixel, in sub-pixel steps, x then y.
    sample_low: [i32; 2],
    sample_high: [i32; 2],
}

impl Grid {
    pub(crate) fn new(
        view: &View,
        tile: i32,
        rows: Range<i32>,
        samples: &[SamplePosition],
    ) -> Self {
        let width = i32::try_from(view.width).expect("at most 16384");
        let height = i32::try_from(view.height).expect("at most 16384");
        let bound = |axis: usize| {
            let positions = samples.iter().map(|p| p[axis]);
            (positions.clone().min().unwrap_or(0), positions.max().unwrap_or(SUBPIXEL_COUNT - 1))
        };
        let ((low_x, high_x), (low_y, high_y)) = (bound(0), bound(1));
        Self {
            width,
            height,
            tile,
            tile_bits: tile.trailing_zeros(),
            columns: (width + tile - 1) / tile,
            first_row: rows.start,
            last_row: rows.end,
            sample_low: [low_x, low_y],
            sample_high: [high_x, high_y],
        }
    }

    pub(crate) fn tile_count(&self) -> usize {
        usize::try_from(self.columns * (self.last_row - self.first_row)).expect("not negative")
    }

    fn column_count(&self) -> usize {
        usize::try_from(self.columns).expect("not negative")
    }

    /// Rows of tiles that a shape touches, counted from the first drawn.
    #[inline]
    fn tile_rows(&self, shape: &Shape) -> std::ops::RangeInclusive<usize> {
        let first = usize::try_from(self.first_row).expect("not negative");
        let [_, y0, _, y1] = shape.pixels;
        (usize::from(y0) >> self.tile_bits) - first..=(usize::from(y1) >> self.tile_bits) - first
    }

    /// Columns of tiles that a shape touches.
    #[inline]
    fn tile_columns(&self, shape: &Shape) -> std::ops::RangeInclusive<usize> {
        let [x0, _, x1, _] = shape.pixels;
        usize::from(x0) >> self.tile_bits..=usize::from(x1) >> self.tile_bits
    }

    /// Pixel box (x0, y0, x1, y1; ends exclusive) of a tile.
    pub(crate) fn tile_box(&self, tile: usize) -> [i32; 4] {
        let tile = i32::try_from(tile).expect("inside the grid");
        let x0 = tile % self.columns * self.tile;
        let y0 = (tile / self.columns + self.first_row) * self.tile;
        [x0, y0, (x0 + self.tile).min(self.width), (y0 + self.tile).min(self.height)]
    }

    /// Pixels on one axis whose samples can lie in `low..=high` (sub-pixel steps).
    #[inline]
    fn pixels(&self, axis: usize, low: i32, high: i32) -> (i32, i32) {
        let first = (low - self.sample_high[axis] + SUBPIXEL_COUNT - 1) >> SUBPIXEL_BITS;
        let last = (high - self.sample_low[axis]) >> SUBPIXEL_BITS;
        (first, last)
    }

    /// Pixels (x0, y0, x1, y1; ends inclusive) of the drawn rows with samples in a box of sub-pixel
    /// steps (ends inclusive).
    #[inline]
    fn pixel_box(&self, low: [i32; 2], high: [i32; 2]) -> Option<[u16; 4]> {
        let (x0, x1) = self.pixels(0, low[0], high[0]);
        let (y0, y1) = self.pixels(1, low[1], high[1]);
        let (x0, x1) = (x0.max(0), x1.min(self.width - 1));
        let y0 = y0.max(self.first_row * self.tile);
        let y1 = y1.min(self.height.min(self.last_row * self.tile) - 1);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below 16384")]
        let pixels = [x0 as u16, y0 as u16, x1 as u16, y1 as u16];
        (x0 <= x1 && y0 <= y1).then_some(pixels)
    }
}

/// From local coordinates to the picture, for one instance.
pub(crate) struct Placing {
    rows: [Vec3; 3],
    offset: Vec3,
    center: [f32; 2],
    near: f32,
    perspective: bool,
    mirrored: bool,
    /// The same in f64, for clipping.
    pub(crate) exact: ClipSpace,
    linear: Mat3,
    translation: Vec3,
    back: Vec3,
    normals: Mat3,
}

impl Placing {
    #[expect(clippy::cast_possible_truncation, reason = "planes and picture sides in f32")]
    pub(crate) fn new(view: &View, linear: Mat3, translation: Vec3) -> Self {
        let scale = view.pixels_per_metre_at_one();
        let axes = DMat3::from_cols(
            view.right * (scale * view.pixel_aspect),
            -view.up * scale,
            -view.back,
        )
        .transpose();
        let local = (axes * linear.as_dmat3()).transpose();
        let rows = [local.x_axis, local.y_axis, local.z_axis];
        let offset = axes * translation.as_dvec3();
        let center = [f64::from(view.width) * 0.5, f64::from(view.height) * 0.5];
        let perspective = !view.is_orthographic();
        Self {
            rows: rows.map(|row| row.as_vec3()),
            offset: offset.as_vec3(),
            center: center.map(|c| c as f32),
            near: view.near as f32,
            perspective,
            mirrored: linear.determinant() < 0.0,
            exact: ClipSpace { rows, offset, center, near: view.near, perspective },
            linear,
            translation,
            back: view.back.as_vec3(),
            normals: normal_matrix(linear),
        }
    }

    #[inline]
    fn vertex(&self, position: Vec3, source: u32) -> ScreenVertex {
        let x = self.rows[0].dot(position) + self.offset.x;
        let y = self.rows[1].dot(position) + self.offset.y;
        let z = self.rows[2].dot(position) + self.offset.z;
        let (x, y, key) = if self.perspective {
            let inverse = 1.0 / z;
            (x * inverse + self.center[0], y * inverse + self.center[1], inverse)
        } else {
            (x + self.center[0], y + self.center[1], -z)
        };
        let inside = z >= self.near && x.abs() <= GUARD_PX && y.abs() <= GUARD_PX;
        ScreenVertex { x, y, key: if inside { key } else { f32::NAN }, source }
    }

    /// [`flags::FRONT`] if a point's normal leans towards the eye or is zero.
    fn side_seen(&self, position: Vec3, normal: Vec3) -> u8 {
        let to_eye =
            if self.perspective { -(self.linear * position + self.translation) } else { self.back };
        if (self.normals * normal).dot(to_eye) < 0.0 { 0 } else { flags::FRONT }
    }

    /// [`flags::FRONT`] for corners that run counter-clockwise as stored.
    fn stored_winding(&self) -> u8 {
        if self.mirrored { 0 } else { flags::FRONT }
    }
}

/// How normals turn under a linear map: the cofactors, so that they stay upright on a surface that
/// is stretched or mirrored. Their lengths change.
pub(crate) fn normal_matrix(linear: Mat3) -> Mat3 {
    let Mat3 { x_axis: x, y_axis: y, z_axis: z } = linear;
    let sign = if linear.determinant() < 0.0 { -1.0 } else { 1.0 };
    Mat3::from_cols(y.cross(z) * sign, z.cross(x) * sign, x.cross(y) * sign)
}

/// Nearest sub-pixel step; half a step rounds up.
#[inline]
fn snap(pixels: f32) -> i32 {
    floor_to_i32(pixels * SUBPIXEL_COUNT as f32 + 0.5)
}

/// What the primitives of one segment have in common while they are set up.
struct Context<'a> {
    list: &'a DrawList,
    item: &'a Item,
    grid: &'a Grid,
    placing: Placing,
    segment: u32,
    primitives: Range<u32>,
}

impl Unit {
    /// Sets up the segments; `self` may hold an earlier unit, whose memory is used again.
    pub(crate) fn build(
        &mut self,
        list: &DrawList,
        view: &View,
        grid: &Grid,
        segments: &[Segment],
    ) {
        self.segments.clear();
        self.segments.extend_from_slice(segments);
        self.vertices.clear();
        self.shapes.clear();
        self.vertex_count = 0;
        for (number, segment) in (0_u32..).zip(segments) {
            let item = &list.items[segment.item as usize];
            let instance = &list.instances[segment.instance as usize];
            let context = Context {
                list,
                item,
                grid,
                placing: Placing::new(view, instance.linear, instance.translation),
                segment: number,
                primitives: segment.primitives.clone(),
            };
            match item.primitive {
                Primitive::Triangles | Primitive::Cards => self.triangles(&context),
                Primitive::Lines { width_px } => self.lines(&context, width_px),
                Primitive::Points { size_px } => self.points(&context, size_px),
            }
        }
        self.sort_into_tiles(grid);
    }

    fn triangles(&mut self, context: &Context<'_>) {
        let Context { list, item, placing, primitives, .. } = context;
        let positions = &list.vertices_of(item).positions;
        let corner_count = item.primitive.index_count();
        let first = primitives.start as usize * corner_count;
        let last = primitives.end as usize * corner_count;
        let indices = &list.indices_of(item).indices[first..last];
        if indices.is_empty() {
            return;
        }
        // Neighbouring primitives share vertices: where the range they span is no longer than the
        // index list, each vertex of it is transformed once.
        let (low, high) =
            indices.iter().fold((u32::MAX, 0), |(low, high), &v| (low.min(v), high.max(v)));
        let span = (high - low) as usize + 1;
        let shared = span <= indices.len();
        let base = u32::try_from(self.vertices.len()).expect("a unit is small");
        if shared {
            let spanned = &positions[low as usize..low as usize + span];
            let placed = (low..).zip(spanned).map(|(source, &p)| placing.vertex(p, source));
            self.vertices.extend(placed);
        } else {
            let placed = indices.iter().map(|&v| placing.vertex(positions[v as usize], v));
            self.vertices.extend(placed);
        }
        self.vertex_count += self.vertices.len() as u64 - u64::from(base);
        let mut next = base;
        for (primitive, corners) in primitives.clone().zip(indices.chunks_exact(corner_count)) {
            let mut at = [0; 4];
            for (slot, &vertex) in at.iter_mut().zip(corners) {
                *slot = if shared { base + vertex - low } else { next };
                next += 1;
            }
            self.triangle(context, positions, primitive, [at[0], at[1], at[2]]);
            if corner_count == 4 {
                self.triangle(context, positions, primitive, [at[0], at[2], at[3]]);
            }
        }
    }

    #[inline]
    fn triangle(
        &mut self,
        context: &Context<'_>,
        positions: &[Vec3],
        primitive: u32,
        vertices: [u32; 3],
    ) {
        let corners = vertices.map(|v| self.vertices[v as usize]);
        if corners.iter().any(|c| c.key.is_nan()) {
            self.clipped_triangle(context, positions, primitive, corners.map(|c| c.source));
            return;
        }
        let points = corners.map(|c| [c.x, c.y, c.key]);
        let winding = context.placing.stored_winding();
        self.shapes.extend(shape(
            points,
            vertices,
            context.segment,
            primitive,
            winding,
            context.grid,
        ));
    }

    /// The part of a triangle in front of the near plane and near the picture.
    #[cold]
    fn clipped_triangle(
        &mut self,
        context: &Context<'_>,
        positions: &[Vec3],
        primitive: u32,
        sources: [u32; 3],
    ) {
        let local = sources.map(|v| positions[v as usize].as_dvec3());
        let polygon = clip_polygon(&context.placing.exact, local, f64::from(GUARD_PX));
        let winding = context.placing.stored_winding() | flags::CLIPPED;
        for pair in polygon.windows(2).skip(1) {
            let points = [polygon[0], pair[0], pair[1]];
            let made = shape(points, sources, context.segment, primitive, winding, context.grid);
            self.shapes.extend(made);
        }
    }

    fn lines(&mut self, context: &Context<'_>, width_px: f32) {
        let Context { list, item, placing, .. } = context;
        let buffers = list.vertices_of(item);
        let indices = &list.indices_of(item).indices;
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
            let corner = |end: [f32; 3], sign: f32, source: u32| ScreenVertex {
                x: end[0] + sign * across[0],
                y: end[1] + sign * across[1],
                key: end[2],
                source,
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
            for corners in [[0_u8, 1, 2], [0, 2, 3]] {
                let points = corners.map(|c| quad[usize::from(c)]).map(|c| [c.x, c.y, c.key]);
                let vertices = corners.map(|c| base + u32::from(c));
                let made = shape(points, vertices, context.segment, primitive, 0, context.grid);
                let sided =
                    |made: Shape| Shape { flags: made.flags & !flags::FRONT | side, ..made };
                self.shapes.extend(made.map(sided));
            }
        }
    }

    fn points(&mut self, context: &Context<'_>, size_px: f32) {
        let Context { list, item, placing, .. } = context;
        let buffers = list.vertices_of(item);
        let indices = &list.indices_of(item).indices;
        let half = size_px * 0.5;
        for primitive in context.primitives.clone() {
            let source = indices[primitive as usize];
            let local = buffers.positions[source as usize];
            let vertex = placing.vertex(local, source);
            self.vertex_count += 1;
            if vertex.key.is_nan() {
                continue;
            }
            // a sample on the right or lower edge belongs to the next square
            let low = [snap(vertex.x - half), snap(vertex.y - half)];
            let high = [snap(vertex.x + half) - 1, snap(vertex.y + half) - 1];
            if low[0] > high[0] || low[1] > high[1] {
                continue;
            }
            let Some(pixels) = context.grid.pixel_box(low, high) else { continue };
            let side = placing.side_seen(local, buffers.normals[source as usize]);
            self.shapes.push(Shape {
                x: [low[0], high[0], 0],
                y: [low[1], high[1], 0],
                key: [vertex.key, 0.0, 0.0],
                key_range: [vertex.key; 2],
                origin: [vertex.x, vertex.y],
                pixels,
                vertices: [u32::try_from(self.vertices.len()).expect("a unit is small"); 3],
                primitive,
                segment: context.segment,
                flags: flags::RECT | side,
            });
            self.vertices.push(vertex);
        }
    }

    /// Counting sort of the shapes by tile; within a tile they keep their order.
    fn sort_into_tiles(&mut self, grid: &Grid) {
        let Self { shapes, tile_offsets, tile_shapes, .. } = self;
        let tile_count = grid.tile_count();
        tile_offsets.clear();
        tile_offsets.resize(tile_count + 1, 0);
        for shape in shapes.iter() {
            for row in grid.tile_rows(shape) {
                for column in grid.tile_columns(shape) {
                    tile_offsets[row * grid.column_count() + column + 1] += 1;
                }
            }
        }
        for tile in 0..tile_count {
            tile_offsets[tile + 1] += tile_offsets[tile];
        }
        tile_shapes.clear();
        tile_shapes.resize(tile_offsets[tile_count] as usize, 0);
        for (index, shape) in (0_u32..).zip(shapes.iter()) {
            for row in grid.tile_rows(shape) {
                for column in grid.tile_columns(shape) {
                    // offsets run ahead while filling and are set back below
                    let next = &mut tile_offsets[row * grid.column_count() + column];
                    tile_shapes[*next as usize] = index;
                    *next += 1;
                }
            }
        }
        tile_offsets.copy_within(0..tile_count, 1);
        tile_offsets[0] = 0;
    }

    /// Shapes that touch a tile, in paint order.
    pub(crate) fn shapes_in(&self, tile: usize) -> &[u32] {
        let range = self.tile_offsets[tile] as usize..self.tile_offsets[tile + 1] as usize;
        &self.tile_shapes[range]
    }
}

/// A triangle from corners (x, y, key), or nothing where no sample can be covered.
///
/// `winding` is [`flags::FRONT`] if corners that run counter-clockwise on the picture show the front.
#[inline]
fn shape(
    points: [[f32; 3]; 3],
    vertices: [u32; 3],
    segment: u32,
    primitive: u32,
    winding: u8,
    grid: &Grid,
) -> Option<Shape> {
    let mut x = points.map(|p| snap(p[0]));
    let mut y = points.map(|p| snap(p[1]));
    let edge = |to: usize| (i64::from(x[to] - x[0]), i64::from(y[to] - y[0]));
    let ((ux, uy), (vx, vy)) = (edge(1), edge(2));
    let doubled_area = ux * vy - uy * vx;
    if doubled_area == 0 {
        return None;
    }
    let mut shape_flags = winding;
    if doubled_area < 0 {
        // counter-clockwise as seen, since y points down
        x.swap(1, 2);
        y.swap(1, 2);
    } else {
        shape_flags ^= flags::FRONT;
    }
    let low = [x[0].min(x[1]).min(x[2]), y[0].min(y[1]).min(y[2])];
    let high = [x[0].max(x[1]).max(x[2]), y[0].max(y[1]).max(y[2])];
    let pixels = grid.pixel_box(low, high)?;
    // 2^14 steps are 64 pixels: products of two such distances, and sums of two products, fit in i32
    if high[0] - low[0] >= 1 << 14 || high[1] - low[1] >= 1 << 14 {
        shape_flags |= flags::WIDE;
    }
    let [[x0, y0, k0], [x1, y1, k1], [x2, y2, k2]] = points;
    let area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
    let slope_x = ((k1 - k0) * (y2 - y0) - (k2 - k0) * (y1 - y0)) / area;
    let slope_y = ((k2 - k0) * (x1 - x0) - (k1 - k0) * (x2 - x0)) / area;
    let sloped = slope_x.is_finite() && slope_y.is_finite();
    Some(Shape {
        x,
        y,
        key: if sloped { [k0, slope_x, slope_y] } else { [k0, 0.0, 0.0] },
        key_range: [k0.min(k1).min(k2), k0.max(k1).max(k2)],
        origin: [x0, y0],
        pixels,
        vertices,
        primitive,
        segment,
        flags: shape_flags,
    })
}

/// Units' segments: the list's primitives in order, cut into pieces of a unit's size.
pub(crate) fn cut(list: &DrawList) -> Vec<Vec<Segment>> {
    let mut units = Vec::new();
    let mut current: Vec<Segment> = Vec::new();
    let mut room = UNIT_PRIMITIVE_COUNT;
    for (number, item) in (0_u32..).zip(&list.items) {
        for instance in item.instances.clone() {
            let mut next = item.primitives.start;
            while next < item.primitives.end {
                let end = item.primitives.end.min(next + room);
                current.push(Segment { item: number, instance, primitives: next..end });
                room -= end - next;
                next = end;
                if room == 0 {
                    units.push(std::mem::take(&mut current));
                    room = UNIT_PRIMITIVE_COUNT;
                }
            }
        }
    }
    if !current.is_empty() {
        units.push(current);
    }
    units
}
