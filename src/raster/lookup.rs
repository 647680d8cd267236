//! Textures of shapes, read for eight samples at a time: weights, texture coordinates and levels of
//! detail as vectors, texels one by one.
//!
//! Every lane computes what [`Material`](crate::raster::shade::Material) does for a sample, in the same
//! order, so both give the same bytes.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8, mask32x8, u32x8};
use glam::Vec2;

use crate::raster::coverage::{Covered, Lanes};
use crate::raster::shade::{Kind, Look, Planar};
use crate::raster::visible::bits;
use crate::simd::LANE_COUNT;
use crate::texture::texture::wrap_pair;
use crate::texture::{Filter, Sampler, Texture, Wrap};

/// How the texture of a shape is read.
pub(crate) struct Lookup<'a> {
    pub(crate) kind: Kind,
    /// Texture coordinates and opacities of the corners.
    pub(crate) uvs: [Vec2; 3],
    pub(crate) opacities: [f32; 3],
    /// Opacity of the instance.
    pub(crate) tint: f32,
    pub(crate) look: Look<'a>,
    /// Texels over a step in texture space, if levels are wanted.
    pub(crate) texels: Option<Vec2>,
}

/// What is known of eight samples before a texel is read.
pub(crate) struct Points<S: Simd> {
    /// Weights of the second and the third corner.
    pub(crate) weights: [f32x8<S>; 2],
    pub(crate) u: f32x8<S>,
    pub(crate) v: f32x8<S>,
    /// Between the corners'.
    pub(crate) opacity: f32x8<S>,
    pub(crate) lods: [f32; LANE_COUNT],
}

impl Lookup<'_> {
    #[inline(always)]
    pub(crate) fn points<S: Simd>(&self, simd: S, lanes: &Lanes, hit: &Covered<S>) -> Points<S> {
        let x = lanes.pixels(simd, hit.block, 0) + hit.x as f32;
        let y = lanes.pixels(simd, hit.block, 1) + hit.y as f32;
        let weights = self.weights::<S, true>(simd, x, y);
        let [w1, w2] = weights;
        let [a, b, c] = self.uvs;
        let u = mix([a.x, b.x, c.x], w1, w2);
        let v = mix([a.y, b.y, c.y], w1, w2);
        let opacity = mix(self.opacities, w1, w2);
        Points { weights, u, v, opacity, lods: self.lods(simd, lanes, hit) }
    }

    /// What no lane's texel is more opaque than: 1 where nothing is known.
    #[inline(always)]
    pub(crate) fn most_alpha<S: Simd>(&self, simd: S, points: &Points<S>, asked: u64) -> f32x8<S> {
        match self.look.filtered() {
            Some((texture, sampler)) => {
                let levels = Levels::new(texture, sampler, points.lods);
                levels.most_alpha(simd, points.u, points.v, asked)
            }
            None => f32x8::splat(simd, 1.0),
        }
    }

    /// Alphas of the texels of the lanes that are asked; 0 of the others.
    #[inline(always)]
    pub(crate) fn texel_alpha<S: Simd>(&self, simd: S, points: &Points<S>, asked: u64) -> f32x8<S> {
        let &Points { u, v, lods, .. } = points;
        if let Some((texture, sampler)) = self.look.filtered() {
            return Levels::new(texture, sampler, lods).alpha(simd, u, v, asked);
        }
        let (u, v): ([f32; LANE_COUNT], [f32; LANE_COUNT]) = (u.into(), v.into());
        let mut alphas = [0.0; LANE_COUNT];
        for lane in bits(asked) {
            alphas[lane] = self.look.alpha(Vec2::new(u[lane], v[lane]), lods[lane]);
        }
        f32x8::simd_from(simd, alphas)
    }

    /// Weights of the second and the third corner; `INSIDE` clamps them to the triangle.
    #[inline(always)]
    fn weights<S: Simd, const INSIDE: bool>(
        &self,
        simd: S,
        x: f32x8<S>,
        y: f32x8<S>,
    ) -> [f32x8<S>; 2] {
        match &self.kind {
            Kind::Planar(planar) => {
                let Planar { origin, second, third, keys } = *planar;
                let (from_x, from_y) = (x - origin.x, y - origin.y);
                let l1 = from_x * second.x + from_y * second.y;
                let l2 = from_x * third.x + from_y * third.y;
                let mut weights = [1.0 - l1 - l2, l1, l2];
                if INSIDE {
                    let zero = f32x8::splat(simd, 0.0);
                    weights = weights.map(|weight| weight.max(zero));
                }
                let [a, b, c] = weights;
                let (a, b, c) = (a * keys[0], b * keys[1], c * keys[2]);
                let scale = 1.0 / (a + b + c);
                [b * scale, c * scale]
            }
            // always clamped
            Kind::Clipped(forms) => {
                let (x, y): ([f32; LANE_COUNT], [f32; LANE_COUNT]) = (x.into(), y.into());
                let (mut w1, mut w2) = ([0.0; LANE_COUNT], [0.0; LANE_COUNT]);
                for lane in 0..LANE_COUNT {
                    let weights = forms.at([f64::from(x[lane]), f64::from(y[lane])]);
                    (w1[lane], w2[lane]) = (weights[1], weights[2]);
                }
                [f32x8::simd_from(simd, w1), f32x8::simd_from(simd, w2)]
            }
        }
    }

    /// Levels of detail of the lanes' pixels.
    #[inline(always)]
    fn lods<S: Simd>(&self, simd: S, lanes: &Lanes, hit: &Covered<S>) -> [f32; LANE_COUNT] {
        let Some(texels) = self.texels else { return [0.0; LANE_COUNT] };
        let x = lanes.columns(simd) + (hit.x as f32 + 0.5);
        let y = f32x8::splat(simd, hit.y as f32 + 0.5);
        let here = self.at_texels(simd, texels, x, y);
        let right = squared_distance(here, self.at_texels(simd, texels, x + 1.0, y));
        let down = squared_distance(here, self.at_texels(simd, texels, x, y + 1.0));
        (log2(simd, right.max_precise(down)) * 0.5).into()
    }

    /// Texel coordinates at points that may lie outside.
    #[inline(always)]
    fn at_texels<S: Simd>(&self, simd: S, texels: Vec2, x: f32x8<S>, y: f32x8<S>) -> [f32x8<S>; 2] {
        let [w1, w2] = self.weights::<S, false>(simd, x, y);
        let [a, b, c] = self.uvs;
        let u = mix([a.x, b.x, c.x], w1, w2) * texels.x;
        [u, mix([a.y, b.y, c.y], w1, w2) * texels.y]
    }
}

/// The levels of a texture that lanes read.
struct Levels<'a> {
    texture: &'a Texture,
    wrap: [Wrap; 2],
    finer: [usize; LANE_COUNT],
    /// Of the next level.
    shares: [f32; LANE_COUNT],
}

impl<'a> Levels<'a> {
    #[inline(always)]
    fn new(texture: &'a Texture, sampler: Sampler, lods: [f32; LANE_COUNT]) -> Self {
        let (mut finer, mut shares) = ([0; LANE_COUNT], [0.0; LANE_COUNT]);
        if sampler.filter == Filter::Trilinear {
            for lane in 0..LANE_COUNT {
                (finer[lane], shares[lane]) = texture.level_pair(lods[lane]);
            }
        }
        Self { texture, wrap: sampler.wrap, finer, shares }
    }

    /// Widths and heights of each lane's level, `coarser` by so many.
    #[inline(always)]
    fn sizes<S: Simd>(&self, simd: S, coarser: usize) -> [f32x8<S>; 2] {
        let levels = self.texture.levels();
        let (mut widths, mut heights) = ([0.0; LANE_COUNT], [0.0; LANE_COUNT]);
        for (lane, &level) in self.finer.iter().enumerate() {
            let image = &levels[level.wrapping_add(coarser).min(levels.len().wrapping_sub(1))];
            (widths[lane], heights[lane]) = (image.width as f32, image.height as f32);
        }
        [f32x8::simd_from(simd, widths), f32x8::simd_from(simd, heights)]
    }

    /// What no lane's alpha is above: 1 where nothing is known.
    #[inline(always)]
    fn most_alpha<S: Simd>(&self, simd: S, u: f32x8<S>, v: f32x8<S>, asked: u64) -> f32x8<S> {
        let bounds = match self.texture.alpha_bounds() {
            Some(bounds) if self.wrap == [Wrap::Clamp; 2] => bounds,
            _ => return f32x8::splat(simd, 1.0),
        };
        let [widths, heights] = self.sizes(simd, 0);
        let (x, y): ([f32; LANE_COUNT], [f32; LANE_COUNT]) =
            ((u * widths).into(), (v * heights).into());
        let mut most = [0.0; LANE_COUNT];
        for lane in bits(asked) {
            most[lane] = f32::from(bounds.at(self.finer[lane], x[lane], y[lane]));
        }
        f32x8::simd_from(simd, most) * (1.0 / 255.0)
    }

    /// Alpha of the lanes that are asked, as [`Texture::alpha`] gives it; 0 of the others.
    #[inline(always)]
    fn alpha<S: Simd>(&self, simd: S, u: f32x8<S>, v: f32x8<S>, asked: u64) -> f32x8<S> {
        let fine = self.bilinear(simd, u, v, 0, asked);
        let mut mixed = 0;
        for lane in bits(asked) {
            mixed |= u64::from(self.shares[lane] != 0.0) << lane;
        }
        if mixed == 0 {
            return fine;
        }
        let coarse = self.bilinear(simd, u, v, 1, mixed);
        let both = fine + (coarse - fine) * f32x8::simd_from(simd, self.shares);
        mask32x8::from_bitmask(simd, mixed).select(both, fine)
    }

    #[inline(always)]
    fn bilinear<S: Simd>(
        &self,
        simd: S,
        u: f32x8<S>,
        v: f32x8<S>,
        coarser: usize,
        asked: u64,
    ) -> f32x8<S> {
        let [widths, heights] = self.sizes(simd, coarser);
        let (x, fx) = split(u * widths - 0.5);
        let (y, fy) = split(v * heights - 0.5);
        let (x, y): ([i32; LANE_COUNT], [i32; LANE_COUNT]) = (x.into(), y.into());
        let levels = self.texture.levels();
        let mut corners = [[0.0; LANE_COUNT]; 4];
        for lane in bits(asked) {
            let image = &levels[self.finer[lane].wrapping_add(coarser)];
            let (x0, x1) = wrap_pair(x[lane], image.width, self.wrap[0]);
            let (y0, y1) = wrap_pair(y[lane], image.height, self.wrap[1]);
            let width = image.width as usize;
            let (row0, row1) = (y0.wrapping_mul(width), y1.wrapping_mul(width));
            for (corner, (row, x)) in
                corners.iter_mut().zip([(row0, x0), (row0, x1), (row1, x0), (row1, x1)])
            {
                corner[lane] = f32::from(image.texels[row.wrapping_add(x)][3]);
            }
        }
        let [a, b, c, d] = corners;
        let (a, b) = (f32x8::simd_from(simd, a), f32x8::simd_from(simd, b));
        let (c, d) = (f32x8::simd_from(simd, c), f32x8::simd_from(simd, d));
        let top = a + (b - a) * fx;
        let bottom = c + (d - c) * fx;
        (top + (bottom - top) * fy) * (1.0 / 255.0)
    }
}

/// The next integers below and what is left over.
#[inline(always)]
fn split<S: Simd>(scaled: f32x8<S>) -> (i32x8<S>, f32x8<S>) {
    let toward_zero: i32x8<S> = scaled.to_int_precise();
    let float: f32x8<S> = toward_zero.to_float();
    // a mask is -1 where it holds
    let below: i32x8<S> = float.simd_gt(scaled).to_vector();
    let floor = toward_zero.saturating_add(below);
    let float: f32x8<S> = floor.to_float();
    (floor, scaled - float)
}

/// A value between three corners'; exact where all are equal.
#[inline(always)]
fn mix<S: Simd>([a, b, c]: [f32; 3], w1: f32x8<S>, w2: f32x8<S>) -> f32x8<S> {
    w1 * (b - a) + a + w2 * (c - a)
}

#[inline(always)]
fn squared_distance<S: Simd>([u, v]: [f32x8<S>; 2], [to_u, to_v]: [f32x8<S>; 2]) -> f32x8<S> {
    let (du, dv) = (to_u - u, to_v - v);
    du * du + dv * dv
}

/// As the scalar one of [`shade`](crate::raster::shade).
#[inline(always)]
fn log2<S: Simd>(simd: S, value: f32x8<S>) -> f32x8<S> {
    let bits = value.to_bits();
    let exponent: f32x8<S> = (bits >> 23).to_float();
    let exponent = exponent - 127.0;
    let one = u32x8::splat(simd, 0x3F80_0000);
    let mantissa = f32x8::from_bits(bits & 0x007F_FFFF | one) - 1.0;
    let found = exponent + mantissa + mantissa * 0.343_7 * (1.0 - mantissa);
    let tiny = value.simd_le(f32x8::splat(simd, f32::MIN_POSITIVE));
    tiny.select(f32x8::splat(simd, -126.0), found)
}
