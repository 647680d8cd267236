//! The renderer's slow twin: every sample asks every shape. The tests' reference, and a benchmark row.
//!
//! It shares set-up and shading with the renderer and nothing else: no tiles, no visibility buffer,
//! no incremental edges, one thread.

use glam::{Vec2, Vec4};

use crate::draw_list::{Blend, DrawList};
use crate::error::LodError;
use crate::job::Job;
use crate::raster::frame::{EMPTY_ID, Frame};
use crate::raster::grid::Grid;
use crate::raster::samples::{self, SUBPIXEL_COUNT};
use crate::raster::setup::{Shape, Unit, cut, flags};
use crate::raster::shade::{Material, Weigher};
use crate::raster::tile::slab_keys;
use crate::simd::Level;
use crate::view::View;

/// Draws colour, depth and ids, shading every sample by itself.
///
/// # Errors
/// As the renderer.
pub fn draw_naive(
    list: &DrawList,
    view: &View,
    sample_count: u32,
    job: &Job,
) -> Result<Frame, LodError> {
    list.check()?;
    let positions = samples::positions(sample_count)?;
    let level = Level::named("simd", "scalar")?;
    let side = view.width.max(view.height).next_power_of_two();
    let side = i32::try_from(side).expect("at most 16384");
    let grid = Grid::new(view, side, 0..1, &positions);
    let units: Vec<Unit> = cut(list)
        .iter()
        .map(|segments| {
            let mut unit = Unit::default();
            unit.build(level, list, view, &grid, segments);
            unit
        })
        .collect();
    let places = places_in_passes(positions.len());
    let (width, height) = (view.width as usize, view.height as usize);
    let mut frame = Frame { width, height, ..Frame::default() };
    for y in 0..i32::try_from(height).expect("at most 16384") {
        job.check()?;
        for x in 0..i32::try_from(width).expect("at most 16384") {
            let mut sum = Vec4::ZERO;
            let (mut depth, mut id) = (f32::INFINITY, EMPTY_ID);
            for (number, &[sx, sy]) in positions.iter().enumerate() {
                let at = [x * SUBPIXEL_COUNT + sx, y * SUBPIXEL_COUNT + sy];
                let (color, sample_depth, sample_id) =
                    sample(list, view, &units, at, places[number]);
                sum += color;
                if sample_depth < depth {
                    (depth, id) = (sample_depth, sample_id);
                }
            }
            frame.color.push(sum * (1.0 / sample_count as f32));
            frame.depth.push(depth);
            frame.ids.push(id);
        }
    }
    Ok(frame)
}

/// Place and size of the pass that each sample is drawn in.
fn places_in_passes(sample_count: usize) -> Vec<(usize, usize)> {
    let mut places = Vec::new();
    while places.len() < sample_count {
        let size = samples::pass_size(sample_count - places.len());
        places.extend((0..size).map(|place| (place, size)));
    }
    places
}

/// Colour, depth and id at a point in sub-pixel steps, which is the sample of some place in its pass.
fn sample(
    list: &DrawList,
    view: &View,
    units: &[Unit],
    at: [i32; 2],
    (place, pass_size): (usize, usize),
) -> (Vec4, f32, u32) {
    let point = Vec2::new(at[0] as f32, at[1] as f32) * (1.0 / SUBPIXEL_COUNT as f32);
    let center = point.floor() + 0.5;
    let mut color = Vec4::ZERO;
    let mut nearest = f32::NEG_INFINITY;
    let mut id = EMPTY_ID;
    // (key, alpha, id) of blended shapes, in paint order
    let mut blended: Vec<(f32, f32, u32)> = Vec::new();
    for unit in units {
        for (index, shape) in unit.shapes.iter().enumerate() {
            if !contains(shape, at) {
                continue;
            }
            let from = point - Vec2::from(shape.origin);
            let key = shape.key[0] + (shape.key[1] * from.x + shape.key[2] * from.y);
            let mut key = key.max(shape.key_range[0]).min(shape.key_range[1]);
            let material = Material::new(list, view, unit, shape);
            let weigher = Weigher::new(view, &material, unit, index);
            let lod = material.lod(&weigher, center);
            let alpha = if let Some(parallax) = material.parallax() {
                let positions = &list.vertices_of(material.item).positions;
                let Some(seen) = parallax.seen(&weigher, positions, point, lod) else { continue };
                key = seen.key;
                seen.alpha * material.instance.tint.w
            } else {
                material.alpha(&weigher, point, lod)
            };
            let (lowest, highest) = slab_keys(view, material.item.slab);
            if key <= nearest || key <= lowest || key > highest {
                continue;
            }
            let source_id = material.source_id(unit.origins[index].primitive);
            let source = material.shade(shape, &weigher, point, lod, [true, false, false])[0];
            let hides = match material.item.blend {
                Blend::Opaque => true,
                Blend::Test(cutoff) => alpha >= cutoff,
                Blend::Coverage => {
                    let seed = material.instance.seed;
                    alpha >= samples::alpha_threshold(place, pass_size, seed, source_id)
                }
                Blend::Over => {
                    color = source + color * (1.0 - source.w);
                    blended.push((key, alpha.clamp(0.0, 1.0), source_id));
                    continue;
                }
            };
            if hides {
                color = source;
                (nearest, id) = (key, source_id);
            }
        }
    }
    let mut opacity = 0.0_f32;
    for &(key, alpha, blended_id) in blended.iter().rev() {
        opacity += (1.0 - opacity) * alpha;
        if key > nearest && opacity >= 0.5 {
            (nearest, id) = (key, blended_id);
            break;
        }
    }
    let depth = if nearest == f32::NEG_INFINITY {
        f32::INFINITY
    } else if view.is_orthographic() {
        -nearest
    } else {
        1.0 / nearest
    };
    (color, depth, id)
}

/// Whether a shape covers a point, by the definition of the top-left rule.
pub(crate) fn contains(shape: &Shape, [x, y]: [i32; 2]) -> bool {
    if shape.tag.has(flags::RECT) {
        return (shape.x[0]..=shape.x[1]).contains(&x) && (shape.y[0]..=shape.y[1]).contains(&y);
    }
    let corner = |number: usize| [shape.x[number], shape.y[number]];
    let [first, second, third] = [corner(0), corner(1), corner(2)];
    let mut corners = vec![first, second, third];
    if shape.tag.has(flags::LINE) {
        corners.insert(2, [0, 1].map(|axis| second[axis] + third[axis] - first[axis]));
    }
    (0..corners.len()).all(|number| {
        let (from, to) = (corners[number], corners[(number + 1) % corners.len()]);
        let along = (to[0] - from[0], to[1] - from[1]);
        let across = (x - from[0], y - from[1]);
        let side =
            i64::from(along.0) * i64::from(across.1) - i64::from(along.1) * i64::from(across.0);
        let top_or_left = along.1 < 0 || (along.1 == 0 && along.0 > 0);
        side > 0 || (side == 0 && top_or_left)
    })
}
