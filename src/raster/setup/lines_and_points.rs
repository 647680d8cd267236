//! Set-up of lines, which are rectangles with butt ends, and of points, which are squares along the
//! picture's axes.

use super::{Context, Origin, Shape, Tag, Unit, flags, u32_from};
use crate::raster::placing::{Chosen, GUARD_PX, ScreenVertex, snap};

impl Unit {
    /// Lines as two triangles each.
    pub(super) fn lines(&mut self, context: &Context<'_>, width_px: f32) {
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
            for corners in [[0_u8, 1, 2], [0, 2, 3]] {
                let points = corners.map(|c| quad[usize::from(c)]).map(|c| [c.x, c.y, c.key]);
                let vertices = corners.map(|c| base + u32::from(c));
                let first = self.shapes.len();
                self.extend(context, points, vertices, primitive, 0);
                let made = self.shapes[first..].iter_mut().zip(&mut self.origins[first..]);
                for (shape, origin) in made {
                    shape.tag = Tag(shape.tag.0 & !flags::FRONT | side);
                    origin.tag = shape.tag;
                }
            }
        }
    }

    /// Points as rectangles.
    pub(super) fn points(&mut self, context: &Context<'_>, size_px: f32) {
        let Context { level, list, item, placing, primitives, .. } = context;
        let buffers = list.vertices_of(item);
        let range = primitives.start as usize..primitives.end as usize;
        let indices = &list.indices_of(item).indices[range];
        let half = size_px * 0.5;
        let base = self.vertices.len();
        let chosen = Chosen::Indexed(&buffers.positions, indices);
        placing.vertices(*level, chosen, &mut self.vertices);
        self.vertex_count += indices.len() as u64;
        for (at, primitive) in (base..).zip(primitives.clone()) {
            let vertex = self.vertices[at];
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
            let source = vertex.source as usize;
            let side = placing.side_seen(buffers.positions[source], buffers.normals[source]);
            let plain = context.plain([vertex.key; 2]);
            let tag = context.tag.with(flags::RECT | side | plain);
            self.shapes.push(Shape {
                x: [low[0], high[0], 0],
                y: [low[1], high[1], 0],
                key: [vertex.key, 0.0, 0.0],
                key_range: [vertex.key; 2],
                origin: [vertex.x, vertex.y],
                pixels,
                tag,
            });
            self.origins.push(Origin { vertices: [u32_from(at); 3], primitive, tag });
        }
    }
}
