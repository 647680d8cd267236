//! Given points or lines, drawn as they are: what benchmarks hand to every tool alike.

use std::sync::Arc;

use glam::{DVec3, Vec2, Vec3};

use crate::draw_list::{Blend, Buffers, Geometry, Item, MAX_SIZE_PX, Primitive, Surface};
use crate::error::{LodError, check_finite, check_limit};
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture, Representation};
use crate::plant::mesh::MAX_ELEMENT_COUNT;
use crate::view::View;
use crate::view_state::ViewState;

/// Points or lines of one size.
#[derive(Debug)]
pub struct Cloud {
    geometry: Arc<Geometry>,
    primitive: Primitive,
    bounds: (DVec3, DVec3),
}

impl Cloud {
    /// Points at the positions, or lines between each two of them, in linear colours.
    ///
    /// # Errors
    /// Positions that are not finite, of another number than colours, none, or an odd number for
    /// lines; a size that is not in (0, 16384] pixels.
    pub fn new(
        positions: &[Vec3],
        colors: &[Vec3],
        lines: bool,
        size_px: f32,
    ) -> Result<Self, LodError> {
        check_finite("positions", positions)?;
        check_finite("colors", colors)?;
        check_limit("positions", positions.len() as u64, MAX_ELEMENT_COUNT, "vertices")?;
        if colors.len() != positions.len() {
            let why = format!("has {} rows for {} positions", colors.len(), positions.len());
            return Err(LodError::Invalid { name: "colors", why });
        }
        let Some(&first) = positions.first() else {
            return Err(LodError::Empty { name: "positions", why: "give at least one" });
        };
        if lines && !positions.len().is_multiple_of(2) {
            let why = format!("lines have two ends, got {} positions", positions.len());
            return Err(LodError::Invalid { name: "positions", why });
        }
        if !(size_px > 0.0 && size_px <= MAX_SIZE_PX) {
            let range = format!("(0, {MAX_SIZE_PX}]");
            return Err(LodError::OutOfRange {
                name: "size_px",
                value: size_px.to_string(),
                range,
            });
        }
        let (low, high) =
            positions.iter().fold((first, first), |(low, high), &p| (low.min(p), high.max(p)));
        let count = positions.len();
        let buffers = Buffers {
            positions: positions.to_vec(),
            normals: vec![Vec3::ZERO; count],
            uvs: vec![Vec2::ZERO; count],
            base: colors.iter().map(|color| color.extend(1.0)).collect(),
            front: colors.to_vec(),
            back: colors.to_vec(),
            indices: (0..u32::try_from(count).expect("checked above")).collect(),
            source_ids: Vec::new(),
        };
        let primitive = if lines {
            Primitive::Lines { width_px: size_px }
        } else {
            Primitive::Points { size_px }
        };
        let bounds = (low.as_dvec3(), high.as_dvec3());
        Ok(Self { geometry: Geometry::new(buffers), primitive, bounds })
    }

    fn count(&self) -> usize {
        self.geometry.buffers().indices.len() / self.primitive.index_count()
    }
}

impl Representation for Cloud {
    fn bounds(&self) -> (DVec3, DVec3) {
        self.bounds
    }

    fn origin(&self) -> DVec3 {
        DVec3::ZERO
    }

    fn footprint(&self) -> Footprint {
        let count = self.count() as u64;
        let is_lines = matches!(self.primitive, Primitive::Lines { .. });
        let (line_count, point_count) = if is_lines { (count, 0) } else { (0, count) };
        let geometry_bytes = self.geometry.buffers().byte_count();
        Footprint { line_count, point_count, geometry_bytes, ..Footprint::default() }
    }

    fn textures(&self) -> Vec<NamedTexture> {
        Vec::new()
    }

    fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        _state: &mut ViewState,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        let source = builder.list.geometry(&self.geometry);
        let count = u32::try_from(self.count()).expect("checked when made");
        for crown in crowns.iter().rev() {
            let instances = builder.list.instance(crown.instance(view));
            builder.list.items.push(Item {
                primitive: self.primitive,
                vertices: source,
                indices: source,
                primitives: 0..count,
                instances,
                surface: Surface::VertexColor,
                blend: Blend::Opaque,
                depth_write: true,
                slab: None,
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lod::made::{draw, parallel};

    #[test]
    fn a_point_and_a_line_by_hand() {
        let view = parallel(DVec3::Z, DVec3::Y, 4.0, 4);
        // a pixel is a metre; its middle is at (-1.5, 1.5)
        let point = Cloud::new(&[Vec3::new(-1.5, 1.5, 0.0)], &[Vec3::X], false, 1.0);
        let frame = draw(&point.expect("valid"), &view);
        let covered: Vec<usize> = (0..16).filter(|&at| frame.color[at].w > 0.0).collect();
        assert_eq!((covered, frame.color[0].x), (vec![0], 1.0), "the first pixel, red");
        let ends = [Vec3::new(-2.0, -0.5, 0.0), Vec3::new(2.0, -0.5, 0.0)];
        let line = Cloud::new(&ends, &[Vec3::Y; 2], true, 1.0).expect("valid");
        let frame = draw(&line, &view);
        let covered: Vec<usize> = (0..16).filter(|&at| frame.color[at].w > 0.0).collect();
        assert_eq!(covered, [8, 9, 10, 11], "the third row");
        assert_eq!((line.footprint().line_count, line.footprint().point_count), (1, 0), "one line");
    }

    #[test]
    fn what_is_wrong_is_refused() {
        let one = [Vec3::ZERO];
        let says = |result: Result<Cloud, LodError>| result.expect_err("refused").to_string();
        assert!(says(Cloud::new(&[], &[], false, 1.0)).starts_with("positions is empty"), "none");
        assert!(says(Cloud::new(&one, &[], false, 1.0)).starts_with("colors:"), "no colour");
        assert!(says(Cloud::new(&one, &one, true, 1.0)).starts_with("positions:"), "one end");
        assert!(says(Cloud::new(&[Vec3::NAN], &one, false, 1.0)).contains("finite"), "NaN");
        assert!(says(Cloud::new(&one, &one, false, 0.0)).starts_with("size_px"), "no size");
    }
}
