//! Which samples of which pixels a shape covers: exact fixed-point edges, the top-left rule.
//!
//! A sample on an edge belongs to the shape whose left or upper edge it is, so triangles that share
//! an edge cover every sample on it exactly once.
//!
//! This work is based on:
//! Juan Pineda. A parallel algorithm for polygon rasterization. 1988

use crate::raster::samples::{SUBPIXEL_COUNT, SamplePosition};
use crate::raster::setup::{Shape, flags};

/// Calls `visit(x, y, mask)` for every pixel of the box (ends inclusive) of which the shape covers a
/// sample; bit `s` of the mask is sample `s`.
#[inline]
pub(crate) fn covered<const S: usize>(
    shape: &Shape,
    pixels: [i32; 4],
    samples: &[SamplePosition; S],
    visit: impl FnMut(i32, i32, u32),
) {
    if shape.flags & flags::RECT != 0 {
        rectangle(shape, pixels, samples, visit);
    } else if shape.flags & flags::WIDE != 0 {
        wide_triangle(shape, pixels, samples, visit);
    } else {
        triangle(shape, pixels, samples, visit);
    }
}

/// Change of an edge's function a step in x and y, and 1 for edges that own their samples.
#[inline]
fn edge(shape: &Shape, from: usize) -> (i32, i32, i32) {
    let to = if from == 2 { 0 } else { from + 1 };
    let dx = shape.x[to].wrapping_sub(shape.x[from]);
    let dy = shape.y[to].wrapping_sub(shape.y[from]);
    // corners run clockwise with y down: inside is right of an edge that goes up, below one that
    // goes right
    let owns = dy < 0 || (dy == 0 && dx > 0);
    (dy.wrapping_neg(), dx, i32::from(owns))
}

/// A triangle under 64 pixels a side: every sum fits in i32.
#[inline]
fn triangle<const S: usize>(
    shape: &Shape,
    [x0, y0, x1, y1]: [i32; 4],
    samples: &[SamplePosition; S],
    mut visit: impl FnMut(i32, i32, u32),
) {
    // Nothing here can pass i32's range before the last pixel, see `flags::WIDE`; the wrapping
    // operations only keep checks out of the loops.
    let mut at_row = [0_i32; 3];
    let mut step_x = [0_i32; 3];
    let mut step_y = [0_i32; 3];
    let mut offsets = [[0_i32; S]; 3];
    for k in 0..3 {
        let (a, b, owns) = edge(shape, k);
        let from_x = (x0 * SUBPIXEL_COUNT).wrapping_sub(shape.x[k]);
        let from_y = (y0 * SUBPIXEL_COUNT).wrapping_sub(shape.y[k]);
        let at = a.wrapping_mul(from_x).wrapping_add(b.wrapping_mul(from_y));
        // inside is where the value is not negative, also for edges that do not own their samples
        at_row[k] = at.wrapping_add(owns - 1);
        step_x[k] = a.wrapping_mul(SUBPIXEL_COUNT);
        step_y[k] = b.wrapping_mul(SUBPIXEL_COUNT);
        for (offset, sample) in offsets[k].iter_mut().zip(samples) {
            *offset = a.wrapping_mul(sample[0]).wrapping_add(b.wrapping_mul(sample[1]));
        }
    }
    for y in y0..=y1 {
        let mut at = at_row;
        for x in x0..=x1 {
            let mut outside = [0_i32; S];
            for s in 0..S {
                outside[s] = at[0].wrapping_add(offsets[0][s])
                    | at[1].wrapping_add(offsets[1][s])
                    | at[2].wrapping_add(offsets[2][s]);
            }
            let mut mask = 0;
            for (s, outside) in outside.into_iter().enumerate() {
                mask |= u32::from(outside >= 0) << s;
            }
            if mask != 0 {
                visit(x, y, mask);
            }
            for k in 0..3 {
                at[k] = at[k].wrapping_add(step_x[k]);
            }
        }
        for k in 0..3 {
            at_row[k] = at_row[k].wrapping_add(step_y[k]);
        }
    }
}

/// A triangle of any size.
fn wide_triangle<const S: usize>(
    shape: &Shape,
    [x0, y0, x1, y1]: [i32; 4],
    samples: &[SamplePosition; S],
    mut visit: impl FnMut(i32, i32, u32),
) {
    // Corners lie within 2^29 steps of the picture, so products fit in i64 with room to spare; the
    // wrapping operations only keep checks out of the loops.
    let step = i64::from(SUBPIXEL_COUNT);
    let mut at_row = [0_i64; 3];
    let mut step_x = [0_i64; 3];
    let mut step_y = [0_i64; 3];
    let mut offsets = [[0_i64; S]; 3];
    for k in 0..3 {
        let (a, b, owns) = edge(shape, k);
        let (a, b) = (i64::from(a), i64::from(b));
        let from_x = i64::from(x0) * step - i64::from(shape.x[k]);
        let from_y = i64::from(y0) * step - i64::from(shape.y[k]);
        at_row[k] = a * from_x + b * from_y + i64::from(owns - 1);
        (step_x[k], step_y[k]) = (a * step, b * step);
        offsets[k] = samples.map(|sample| a * i64::from(sample[0]) + b * i64::from(sample[1]));
    }
    let lowest = offsets.map(|offset| offset.into_iter().min().unwrap_or(0));
    let highest = offsets.map(|offset| offset.into_iter().max().unwrap_or(0));
    let full = (1 << S) - 1;
    for y in y0..=y1 {
        let mut at = at_row;
        for x in x0..=x1 {
            let none = at[0].wrapping_add(highest[0])
                | at[1].wrapping_add(highest[1])
                | at[2].wrapping_add(highest[2]);
            if none >= 0 {
                let all = at[0].wrapping_add(lowest[0])
                    | at[1].wrapping_add(lowest[1])
                    | at[2].wrapping_add(lowest[2]);
                let mut mask = full;
                if all < 0 {
                    let [first, second, third] = &offsets;
                    mask = 0;
                    for (s, ((&first, &second), &third)) in
                        first.iter().zip(second).zip(third).enumerate()
                    {
                        let outside = at[0].wrapping_add(first)
                            | at[1].wrapping_add(second)
                            | at[2].wrapping_add(third);
                        mask |= u32::from(outside >= 0) << s;
                    }
                }
                if mask != 0 {
                    visit(x, y, mask);
                }
            }
            for k in 0..3 {
                at[k] = at[k].wrapping_add(step_x[k]);
            }
        }
        for k in 0..3 {
            at_row[k] = at_row[k].wrapping_add(step_y[k]);
        }
    }
}

/// The axis-aligned rectangle `x[0]..=x[1]` by `y[0]..=y[1]`.
#[inline]
fn rectangle<const S: usize>(
    shape: &Shape,
    [x0, y0, x1, y1]: [i32; 4],
    samples: &[SamplePosition; S],
    mut visit: impl FnMut(i32, i32, u32),
) {
    for y in y0..=y1 {
        for x in x0..=x1 {
            let mut mask = 0;
            for (s, sample) in samples.iter().enumerate() {
                let at = [x * SUBPIXEL_COUNT + sample[0], y * SUBPIXEL_COUNT + sample[1]];
                let inside = at[0] >= shape.x[0]
                    && at[0] <= shape.x[1]
                    && at[1] >= shape.y[0]
                    && at[1] <= shape.y[1];
                mask |= u32::from(inside) << s;
            }
            if mask != 0 {
                visit(x, y, mask);
            }
        }
    }
}
