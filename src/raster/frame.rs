//! What a renderer gives back: planes of a picture, and what drawing it took.

use glam::{Vec3, Vec4, Vec4Swizzles};
use rayon::prelude::*;

use crate::draw_list::{DrawList, Primitive};
use crate::texture::srgb::{srgb8_from_linear, unorm8};

/// Id of a pixel that shows nothing.
pub const EMPTY_ID: u32 = u32::MAX;

/// Pixels per rayon job of the passes over whole planes.
const MIN_PIXELS_PER_JOB: usize = 16_384;

/// Which planes a picture has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Outputs {
    /// Premultiplied linear colour.
    pub color: bool,
    /// Distance along the viewing direction.
    pub depth: bool,
    /// Source primitive of the nearest sample.
    pub ids: bool,
    /// Mean world-space normal of the sides seen, weighted by opacity.
    pub normal: bool,
    /// As colour, without light.
    pub albedo: bool,
    /// Colour as 8-bit sRGB, premultiplied before encoding; alpha linear.
    pub color8: bool,
}

impl Outputs {
    /// Colour and depth.
    pub const COLOR_DEPTH: Self = Self { depth: true, ..Self::COLOR };
    /// Colour alone.
    pub const COLOR: Self =
        Self { color: true, depth: false, ids: false, normal: false, albedo: false, color8: false };
}

/// What a picture took.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Stats {
    /// Building the draw list, milliseconds.
    pub emit_millis: f64,
    /// Clear, transform, bin, raster and resolve, milliseconds.
    pub draw_millis: f64,
    /// What a graphics card says that drawing took, from its first command to its last, milliseconds;
    /// `None` on the processor, and for cards that do not tell.
    pub gpu_millis: Option<f64>,
    /// Triangles submitted, instances counted.
    pub triangle_count: u64,
    /// Cards submitted.
    pub card_count: u64,
    /// Lines submitted.
    pub line_count: u64,
    /// Points submitted.
    pub point_count: u64,
    /// Items in the list: calls of a renderer that draws one at a time.
    pub item_count: u64,
    /// Textures in the list.
    pub texture_count: u64,
    /// Vertices transformed; corners submitted to a graphics card.
    pub vertex_count: u64,
    /// (primitive, pixel) pairs of which a sample is covered, hidden ones included, summed over the
    /// sets of up to 16 samples that a picture is drawn in; `None` unless it was asked for.
    pub fragment_count: Option<u64>,
    /// Threads of the pool that drew it; 0 where a graphics card did.
    pub thread_count: usize,
}

impl Stats {
    /// Counts what a list submits.
    pub(crate) fn count(&mut self, list: &DrawList) {
        self.item_count += list.items.len() as u64;
        self.texture_count += list.textures.len() as u64;
        for item in &list.items {
            let count = item.primitives.len() as u64 * item.instances.len() as u64;
            match item.primitive {
                Primitive::Triangles => self.triangle_count += count,
                Primitive::Cards => self.card_count += count,
                Primitive::Lines { .. } => self.line_count += count,
                Primitive::Points { .. } => self.point_count += count,
            }
        }
    }
}

/// A picture: rows top to bottom; planes that were not asked for are empty.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Frame {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Premultiplied linear colour.
    pub color: Vec<Vec4>,
    /// Depth of the nearest sample, infinite where there is none.
    pub depth: Vec<f32>,
    /// Source primitive of the nearest sample, [`EMPTY_ID`] where there is none.
    pub ids: Vec<u32>,
    /// Normal times opacity.
    pub normal: Vec<Vec3>,
    /// Premultiplied linear colour without light.
    pub albedo: Vec<Vec4>,
    /// 8-bit sRGB of the premultiplied colour.
    pub color8: Vec<[u8; 4]>,
    /// What it took.
    pub stats: Stats,
}

/// Planes while a picture is drawn; kept between pictures so that their memory stays warm.
#[derive(Debug, Default)]
pub(crate) struct Planes {
    pub(crate) color: Vec<Vec4>,
    pub(crate) depth: Vec<f32>,
    pub(crate) ids: Vec<u32>,
    pub(crate) normal: Vec<Vec4>,
    pub(crate) albedo: Vec<Vec4>,
    pub(crate) color8: Vec<[u8; 4]>,
}

impl Planes {
    /// Makes the planes that are wanted as long as the picture; what they hold is overwritten.
    pub(crate) fn resize(&mut self, pixel_count: usize, outputs: Outputs) {
        let length = |wanted: bool| if wanted { pixel_count } else { 0 };
        self.color.resize(length(outputs.color || outputs.color8), Vec4::ZERO);
        self.depth.resize(length(outputs.depth || outputs.ids), f32::INFINITY);
        self.ids.resize(length(outputs.ids), EMPTY_ID);
        self.normal.resize(length(outputs.normal), Vec4::ZERO);
        self.albedo.resize(length(outputs.albedo), Vec4::ZERO);
        self.color8.resize(length(outputs.color8), [0; 4]);
    }

    /// Puts a premultiplied colour behind everything and encodes the 8-bit plane.
    pub(crate) fn finish(&mut self, background: Vec4) {
        for plane in [&mut self.color, &mut self.albedo] {
            if background != Vec4::ZERO {
                plane
                    .par_iter_mut()
                    .with_min_len(MIN_PIXELS_PER_JOB)
                    .for_each(|pixel| *pixel += background * (1.0 - pixel.w));
            }
        }
        self.color8.par_iter_mut().zip(&self.color).with_min_len(MIN_PIXELS_PER_JOB).for_each(
            |(coded, pixel)| {
                let [r, g, b] = [pixel.x, pixel.y, pixel.z].map(srgb8_from_linear);
                *coded = [r, g, b, unorm8(pixel.w)];
            },
        );
    }

    /// A copy of the planes that were asked for.
    pub(crate) fn to_frame(&self, width: usize, height: usize, outputs: Outputs) -> Frame {
        Frame {
            width,
            height,
            color: if outputs.color { self.color.clone() } else { Vec::new() },
            depth: if outputs.depth { self.depth.clone() } else { Vec::new() },
            ids: self.ids.clone(),
            normal: self.normal.iter().map(|normal| normal.xyz()).collect(),
            albedo: self.albedo.clone(),
            color8: self.color8.clone(),
            stats: Stats::default(),
        }
    }
}
