//! Shapes that are windows on pictures with depth: which ray a sample follows, and what it meets.
//!
//! The shape only says which samples look; where it lies does not matter. So its own depth hides
//! nothing, and depth is that of what the ray meets. Rays run in the pictures' own space, where the
//! eye may be far away: they begin at the shape, which must be near what it shows.

#[cfg(test)]
pub(crate) mod tests;

use fearless_simd::prelude::*;
use glam::{Mat3, Vec2, Vec3, Vec4, Vec4Swizzles};

use crate::draw_list::Instance;
use crate::raster::coverage::{Before, Covered, Lanes, covered};
use crate::raster::placing::normal_matrix;
use crate::raster::setup::Shape;
use crate::raster::shade::Weigher;
use crate::raster::visible::{Sample, bits, dither_bits, index, pixels_in};
use crate::simd::Kernel;
use crate::texture::frames::{Chosen, Colors, Ray, Reading};
use crate::texture::{Filter, Frames, Sampler};
use crate::view::View;

/// Frames, and how the samples of an instance look at them.
pub(crate) struct Parallax<'a> {
    frames: &'a Frames,
    chosen: Chosen,
    step_count: u32,
    tolerance: f32,
    sampler: Sampler,
    linear: Mat3,
    /// The eye of a perspective view.
    eye: Vec3,
    /// Away from the viewer of a parallel view.
    away: Vec3,
    /// How depth grows along each axis, and at the frames' origin.
    depth: Vec3,
    depth_at_origin: f32,
    is_perspective: bool,
    near: f32,
}

/// What a sample's ray has met.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// Without the instance's opacity; above 0.
    pub(crate) alpha: f32,
    /// Depth key.
    pub(crate) key: f32,
}

impl<'a> Parallax<'a> {
    pub(crate) fn new(
        frames: &'a Frames,
        view: &View,
        instance: &Instance,
        (step_count, tolerance): (u32, f32),
        sampler: Sampler,
    ) -> Self {
        let [a, b, c, weights @ ..] = instance.params;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
        let number = |stored: f32| stored as u32;
        #[expect(clippy::cast_possible_truncation, reason = "a depth in f32")]
        let near = view.near as f32;
        let back = view.back.as_vec3();
        let Instance { linear, translation, .. } = *instance;
        let local_from_world = linear.inverse();
        Self {
            frames,
            chosen: [(number(a), weights[0]), (number(b), weights[1]), (number(c), weights[2])],
            step_count,
            tolerance,
            sampler,
            linear,
            eye: local_from_world * -translation,
            away: (local_from_world * -back).normalize_or_zero(),
            depth: linear.transpose() * -back,
            depth_at_origin: -translation.dot(back),
            is_perspective: !view.is_orthographic(),
            near,
        }
    }

    /// The ray through a point of the shape.
    #[inline]
    fn ray(&self, point: Vec3) -> Ray {
        if !self.is_perspective {
            return Ray { point, direction: self.away, start: f32::NEG_INFINITY };
        }
        let from_eye = point - self.eye;
        let length = from_eye.length();
        let direction = if length > 0.0 { from_eye * (1.0 / length) } else { Vec3::ZERO };
        Ray { point, direction, start: -length }
    }

    fn reading(&self, lod: f32) -> Reading {
        let Self { chosen, step_count, tolerance, sampler, .. } = *self;
        Reading { chosen, step_count, tolerance, sampler, lod }
    }

    /// What the ray through a point of the picture meets.
    #[inline]
    pub(crate) fn seen(
        &self,
        weigher: &Weigher,
        positions: &[Vec3],
        at: Vec2,
        lod: f32,
    ) -> Option<Seen> {
        let ray = self.ray(weigher.position(positions, at));
        let met = self.frames.met(&ray, &self.reading(lod))?;
        let point = ray.point + ray.direction * met.along;
        let depth = self.depth.dot(point) + self.depth_at_origin;
        let is_there = depth >= self.near;
        let key = if self.is_perspective { 1.0 / depth } else { -depth };
        is_there.then_some(Seen { alpha: met.alpha, key })
    }

    /// The colours that the ray through a point of the picture sees.
    #[inline]
    pub(crate) fn colors(
        &self,
        weigher: &Weigher,
        positions: &[Vec3],
        at: Vec2,
        lod: f32,
    ) -> Colors {
        let ray = self.ray(weigher.position(positions, at));
        self.frames.colors(&ray, &self.reading(lod))
    }

    /// Premultiplied linear colour, albedo and normal: half-transparent where they are blended, whole
    /// elsewhere.
    #[inline]
    pub(crate) fn shade(&self, colors: &Colors, tint: Vec4, is_blended: bool) -> [Vec4; 3] {
        let alpha = colors.lit.w;
        if alpha <= 0.0 {
            return [Vec4::ZERO; 3];
        }
        let shown = if is_blended { (alpha * tint.w).clamp(0.0, 1.0) } else { 1.0 };
        let straight = |color: Vec4| {
            let part = if color.w > 0.0 { color.xyz() * (1.0 / color.w) } else { Vec3::ZERO };
            (part * tint.xyz() * shown).extend(shown)
        };
        let normal = (normal_matrix(self.linear) * colors.normal).normalize_or_zero();
        [straight(colors.lit), straight(colors.albedo), (normal * shown).extend(shown)]
    }

    /// Square of the texels that a pixel is wide where its ray meets the plane of the heaviest frame; the
    /// longer of the steps right and down.
    pub(crate) fn texels_a_pixel_squared(
        &self,
        weigher: &Weigher,
        positions: &[Vec3],
        center: Vec2,
    ) -> f32 {
        if self.sampler.filter != Filter::Trilinear {
            return 1.0;
        }
        let heaviest =
            self.chosen.iter().fold(self.chosen[0], |best, c| if c.1 > best.1 { *c } else { best });
        let on_plane = |offset: Vec2| {
            let point = weigher.position_beside(positions, center + offset);
            self.frames.on_plane(&self.ray(point), heaviest.0)
        };
        let (Some(here), Some(right), Some(down)) =
            (on_plane(Vec2::ZERO), on_plane(Vec2::X), on_plane(Vec2::Y))
        else {
            return 1.0;
        };
        (right - here).length_squared().max((down - here).length_squared())
    }
}

/// Visits the samples that a shape covers; running it counts its pixels.
pub(crate) struct Covers<'a, 'v> {
    pub(crate) lanes: &'a Lanes,
    pub(crate) shape: &'a Shape,
    /// Pixels of the tile: x0, y0, x1, y1, ends exclusive.
    pub(crate) tile_box: [i32; 4],
    /// Pixels a row of the tile's arrays.
    pub(crate) side: i32,
    /// Seed and fade of an instance that is not fully there.
    pub(crate) dither: Option<(u32, f32)>,
    /// What a visit does takes far longer than the call.
    pub(crate) visit: &'v mut dyn FnMut(&Sample),
}

impl Kernel for Covers<'_, '_> {
    type Output = u64;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> u64 {
        if self.lanes.block_count == 1 {
            self.cover::<S, 1>(simd)
        } else {
            self.cover::<S, 2>(simd)
        }
    }
}

impl Covers<'_, '_> {
    #[inline(always)]
    fn cover<S: Simd, const BLOCKS: usize>(self, simd: S) -> u64 {
        let Self { lanes, shape, tile_box, side, dither, visit } = self;
        let pixels = pixels_in(shape, tile_box);
        let left = pixels[0].wrapping_sub(tile_box[0]);
        let top = pixels[1].wrapping_sub(tile_box[1]);
        let first = index(left, top, side).wrapping_mul(lanes.sample_count);
        let row = index(0, 1, side);
        let mut count = 0_u64;
        let mut before = Before::default();
        covered::<S, BLOCKS, false>(
            simd,
            lanes,
            shape,
            pixels,
            row,
            #[inline(always)]
            |hit| {
                count = count.wrapping_add(lanes.pixel_count(&hit, &mut before));
                let at = first.wrapping_add(hit.at);
                let Covered { x, y, block, .. } = hit;
                let mut inside = hit.inside.to_bitmask();
                if let Some(dither) = dither {
                    inside &= dither_bits(lanes, dither, x, y, block);
                }
                for lane in bits(inside) {
                    let (column, number) = lanes.place(lane, block);
                    let pixel = [x.wrapping_add(column), y];
                    let sample = Sample { pixel, number, at: at.wrapping_add(lane), key: 0.0 };
                    visit(&sample);
                }
            },
        );
        count
    }
}
