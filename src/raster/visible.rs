//! In which samples of a tile a shape is in front, and what becomes of them.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, mask32x8, u32x8};
use glam::{Vec2, Vec4};

use crate::raster::coverage::{Before, Covered, Lanes, covered};
use crate::raster::cut_out::CutOut;
use crate::raster::grid::PixelBox;
use crate::raster::over::{HalfOpacity, Over};
use crate::raster::setup::Shape;
use crate::simd::{Kernel, LANE_COUNT};

/// A shape that is drawn into a tile; running it counts the pixels that it covers.
pub(crate) struct Visible<'a, 'v> {
    pub(crate) lanes: &'a Lanes,
    pub(crate) shape: &'a Shape,
    /// Pixels of the tile: x0, y0, x1, y1, ends exclusive.
    pub(crate) tile_box: [i32; 4],
    /// Pixels a row of the tile's arrays.
    pub(crate) side: i32,
    /// Only keys above the first and up to the second are drawn.
    pub(crate) slab_keys: (f32, f32),
    /// Seed and fade of an instance that is not fully there.
    pub(crate) dither: Option<(u32, f32)>,
    /// Depth keys of the tile's samples.
    pub(crate) keys: &'a mut [f32],
    pub(crate) sink: Sink<'a, 'v>,
}

/// What happens to the samples in which a shape is in front.
pub(crate) enum Sink<'a, 'v> {
    /// They take the shape's key, if `write`, and its reference.
    Store { waiting: &'a mut [u32], reference: u32, write: bool },
    /// As `Store`, where a texture's alpha passes a test.
    Test { cut_out: &'v CutOut<'v>, waiting: &'a mut [u32], reference: u32, write: bool },
    /// A texture is painted over their colours; they take the shape's key where it shows, if `write`.
    Over { over: &'v Over<'v>, colors: &'a mut [Vec4], write: bool },
    /// Where opacity reaches a half they take the shape's key, and its id, if ids are wanted.
    HalfOpacity { half: &'v HalfOpacity<'v>, opacities: &'a mut [f32], ids: &'a mut [u32], id: u32 },
    /// Each is visited; what visitors do takes far longer than the call.
    Visit(&'v mut dyn FnMut(&Sample, &mut [f32])),
}

/// A sample in which a shape is in front.
pub(crate) struct Sample {
    pub(crate) pixel: [i32; 2],
    /// Which of the pixel's.
    pub(crate) number: usize,
    /// Index in the tile's arrays.
    pub(crate) at: usize,
    /// Depth key of the shape.
    pub(crate) key: f32,
}

impl Sample {
    /// The middle of its pixel.
    pub(crate) fn pixel_center(&self) -> Vec2 {
        let [x, y] = self.pixel.map(|at| at as f32 + 0.5);
        Vec2::new(x, y)
    }
}

impl Kernel for Visible<'_, '_> {
    type Output = u64;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> u64 {
        if self.lanes.block_count == 1 { self.draw::<S, 1>(simd) } else { self.draw::<S, 2>(simd) }
    }
}

impl Visible<'_, '_> {
    #[inline(always)]
    fn draw<S: Simd, const BLOCKS: usize>(self, simd: S) -> u64 {
        let Self { lanes, shape, tile_box, side, slab_keys, dither, keys, mut sink } = self;
        let (lowest, highest) = slab_keys;
        let pixels = pixels_in(shape, tile_box);
        let left = pixels[0].wrapping_sub(tile_box[0]);
        let first =
            index(left, pixels[1].wrapping_sub(tile_box[1]), side).wrapping_mul(lanes.sample_count);
        let depth = Depth::new(simd, lanes, shape);
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
                let stored = &mut keys[at..at.wrapping_add(LANE_COUNT)];
                let key = depth.keys(simd, &hit);
                let old = f32x8::from_slice(simd, stored);
                let seen = key.simd_gt(old) & key.simd_gt(lowest) & key.simd_le(highest);
                let mut front = (hit.inside & seen).to_bitmask();
                let Covered { x, y, block, .. } = hit;
                if let Some(dither) = dither {
                    front &= dither_bits(lanes, dither, x, y, block);
                }
                if front == 0 {
                    return;
                }
                if let Sink::Test { cut_out, .. } = &sink {
                    front = cut_out.passing(simd, lanes, &hit, front);
                }
                match &mut sink {
                    Sink::Store { waiting, reference, write }
                    | Sink::Test { waiting, reference, write, .. } => {
                        let front = mask32x8::from_bitmask(simd, front);
                        if *write {
                            front.select(key, old).store_slice(stored);
                        }
                        let waiting = &mut waiting[at..at.wrapping_add(LANE_COUNT)];
                        let old = u32x8::from_slice(simd, waiting);
                        let reference = u32x8::splat(simd, *reference);
                        front.select(reference, old).store_slice(waiting);
                    }
                    Sink::Over { over, colors, write } => {
                        let colors = &mut colors[at..at.wrapping_add(LANE_COUNT)];
                        let painted = over.paint(simd, lanes, &hit, front, colors);
                        if *write {
                            mask32x8::from_bitmask(simd, painted)
                                .select(key, old)
                                .store_slice(stored);
                        }
                    }
                    Sink::HalfOpacity { half, opacities, ids, id } => {
                        let opacities = &mut opacities[at..at.wrapping_add(LANE_COUNT)];
                        let reached = half.reached(simd, lanes, &hit, front, opacities);
                        // what lies behind cannot be nearer, so the key doubles as the answer
                        mask32x8::from_bitmask(simd, reached).select(key, old).store_slice(stored);
                        for lane in bits(reached) {
                            if let Some(stored) = ids.get_mut(at.wrapping_add(lane)) {
                                *stored = *id;
                            }
                        }
                    }
                    Sink::Visit(visit) => {
                        let shape_keys: [f32; LANE_COUNT] = key.into();
                        for lane in bits(front) {
                            let (column, number) = lanes.place(lane, block);
                            let sample = Sample {
                                pixel: [x.wrapping_add(column), y],
                                number,
                                at: at.wrapping_add(lane),
                                key: shape_keys[lane],
                            };
                            visit(&sample, keys);
                        }
                    }
                }
            },
        );
        count
    }
}

/// A shape's pixels in a tile: x0, y0, x1, y1, ends inclusive.
#[inline(always)]
pub(crate) fn pixels_in(shape: &Shape, tile_box: [i32; 4]) -> PixelBox {
    let [x0, y0, x1, y1] = shape.pixels.map(i32::from);
    [
        x0.max(tile_box[0]),
        y0.max(tile_box[1]),
        x1.min(tile_box[2].wrapping_sub(1)),
        y1.min(tile_box[3].wrapping_sub(1)),
    ]
}

/// A shape's plane of depth keys, within those of its corners.
pub(crate) struct Depth<'a, S: Simd> {
    lanes: &'a Lanes,
    shape: &'a Shape,
    farthest: f32x8<S>,
    nearest: f32x8<S>,
}

impl<'a, S: Simd> Depth<'a, S> {
    #[inline(always)]
    pub(crate) fn new(simd: S, lanes: &'a Lanes, shape: &'a Shape) -> Self {
        let [farthest, nearest] = shape.key_range;
        let (farthest, nearest) = (f32x8::splat(simd, farthest), f32x8::splat(simd, nearest));
        Self { lanes, shape, farthest, nearest }
    }

    #[inline(always)]
    pub(crate) fn keys(&self, simd: S, hit: &Covered<S>) -> f32x8<S> {
        let x = self.lanes.pixels(simd, hit.block, 0) + hit.x as f32;
        let y = self.lanes.pixels(simd, hit.block, 1) + hit.y as f32;
        self.keys_at([x, y])
    }

    /// Keys at points of the picture.
    #[inline(always)]
    pub(crate) fn keys_at(&self, [x, y]: [f32x8<S>; 2]) -> f32x8<S> {
        let [at_origin, slope_x, slope_y] = self.shape.key;
        let (from_x, from_y) = (x - self.shape.origin[0], y - self.shape.origin[1]);
        let key = from_x * slope_x + from_y * slope_y + at_origin;
        key.max(self.farthest).min(self.nearest)
    }
}

/// Index of a pixel of a tile.
#[inline(always)]
#[expect(clippy::cast_sign_loss, reason = "inside the tile")]
pub(crate) fn index(x: i32, y: i32, side: i32) -> usize {
    y.wrapping_mul(side).wrapping_add(x) as usize
}

/// Indices of the bits that are set, lowest first.
#[inline(always)]
pub(crate) fn bits(mut mask: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lowest = mask.trailing_zeros();
        mask &= mask.wrapping_sub(1);
        (lowest < 64).then_some(lowest as usize)
    })
}

/// Lanes that an instance's fade keeps.
#[cold]
#[inline(never)]
pub(crate) fn dither_bits(
    lanes: &Lanes,
    (seed, fade): (u32, f32),
    x: i32,
    y: i32,
    block: usize,
) -> u64 {
    let kept = |lane: usize| {
        let (column, sample) = lanes.place(lane, block);
        dithered(x + column, y, sample, seed, fade)
    };
    (0..LANE_COUNT).map(|lane| u64::from(kept(lane)) << lane).sum()
}

/// Whether a fade keeps a sample: if its fixed random number is below it; for a negative fade the
/// others, so that `fade` and `fade - 1` complete one another.
fn dithered(x: i32, y: i32, sample: usize, seed: u32, fade: f32) -> bool {
    let mut hash = seed.wrapping_mul(0x9E37_79B9);
    for part in [x.unsigned_abs(), y.unsigned_abs(), u32::try_from(sample).expect("under 32")] {
        hash = (hash ^ part).wrapping_mul(0x85EB_CA6B);
        hash ^= hash >> 15;
    }
    hash = hash.wrapping_mul(0xC2B2_AE35);
    let number = ((hash ^ hash >> 16) >> 8) as f32 * (1.0 / 16_777_216.0);
    if fade >= 0.0 { number < fade } else { number >= 1.0 + fade }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fade_and_its_complement_share_the_samples() {
        for fade in [0.0, 0.25, 0.7] {
            let mut kept = 0_u32;
            for (x, y) in (0..64).flat_map(|x| (0..64).map(move |y| (x, y))) {
                for s in 0..4 {
                    let here = dithered(x, y, s, 7, fade);
                    let there = fade == 0.0 || dithered(x, y, s, 7, fade - 1.0);
                    assert_ne!(here, there, "sample {s} once at ({x}, {y})");
                    kept += u32::from(here);
                }
            }
            let share = f64::from(kept) / f64::from(64 * 64 * 4);
            // four standard deviations of 16384 draws
            assert!((share - f64::from(fade)).abs() < 0.016, "{share} for {fade}");
        }
    }
}
