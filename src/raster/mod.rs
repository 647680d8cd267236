//! The CPU renderer: draws a [`DrawList`] into a [`Frame`], and is the engine of every bake.
//!
//! Units of primitives are set up in parallel, then tiles are drawn in parallel, each tile taking its
//! shapes in paint order: the picture is the same on any number of threads. Lists of more than
//! [`MAX_BATCH_UNITS`] units are drawn in batches, so memory stays bounded for any list.
//!
//! This work is based on:
//! Fabian Giesen. Optimizing Software Occlusion Culling. 2013 (fixed-point tiles on CPUs)
//! Christopher Burns, Warren Hunt. The Visibility Buffer. 2013 (colour once it is known what is seen)

mod clip;
mod colors;
mod coverage;
mod cut_out;
mod frame;
mod grid;
mod lookup;
mod naive;
mod over;
pub(crate) mod parallax;
mod placing;
mod plain;
pub mod samples;
mod setup;
mod shade;
#[cfg(test)]
mod soups;
mod spans;
#[cfg(test)]
pub(crate) mod tests;
mod tile;
mod visible;

use std::ops::Range;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use glam::Vec4;
use rayon::prelude::*;

pub use frame::{EMPTY_ID, Frame, Outputs, Stats};
pub use naive::draw_naive;

use crate::draw_list::{Blend, DrawList};
use crate::error::{LodError, check_finite, check_limit};
use crate::job::Job;
use crate::raster::frame::Planes;
use crate::raster::grid::Grid;
use crate::raster::samples::SamplePosition;
use crate::raster::setup::{Segment, Unit};
use crate::raster::tile::{Scene, TileBuffer, TileTarget, leave_blank};
use crate::simd::Level;
use crate::view::View;

/// Units set up at once: about a million primitives, a few hundred megabytes.
pub const MAX_BATCH_UNITS: usize = 256;

/// Sample memory that lists of several batches may hold at once; larger pictures go in bands.
const MAX_BAND_BYTES: u64 = 1 << 29;

/// Largest picture: 16384 x 16384 would be 4 GiB of colour alone.
pub const MAX_PIXEL_COUNT: u64 = 1 << 27;

/// Pixels a tile's side, by samples a pixel: a tile's samples stay in a core's cache.
fn tile_side(sample_count: usize) -> i32 {
    if sample_count == 1 { 64 } else { 32 }
}

/// How a list is drawn.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Samples a pixel; see [`samples::positions`].
    pub sample_count: u32,
    /// Planes to make.
    pub outputs: Outputs,
    /// Premultiplied linear colour behind everything.
    pub background: Vec4,
    /// Whether to count fragments, which takes time.
    pub counts_fragments: bool,
}

/// Draws lists and keeps its memory between them.
#[derive(Debug)]
pub struct Renderer {
    units: Vec<Unit>,
    tiles: Vec<Mutex<TileBuffer>>,
    planes: Planes,
    max_batch_units: usize,
    /// Tests make it small, so that small pictures have several tiles.
    max_tile_side: i32,
    simd: Option<Level>,
}

impl Default for Renderer {
    fn default() -> Self {
        Self {
            units: Vec::new(),
            tiles: Vec::new(),
            planes: Planes::default(),
            max_batch_units: MAX_BATCH_UNITS,
            max_tile_side: i32::MAX,
            simd: None,
        }
    }
}

impl Renderer {
    /// A renderer that uses the given vector instructions; others use [`Level::chosen`].
    pub fn with_simd(level: Level) -> Self {
        Self { simd: Some(level), ..Self::default() }
    }

    /// Draws a list and copies the picture out.
    ///
    /// # Errors
    /// As [`Renderer::draw`].
    pub fn render(
        &mut self,
        list: &DrawList,
        view: &View,
        settings: &Settings,
        job: &Job,
    ) -> Result<Frame, LodError> {
        let stats = self.draw(list, view, settings, job)?;
        let (width, height) = (view.width as usize, view.height as usize);
        Ok(Frame { stats, ..self.planes.to_frame(width, height, settings.outputs) })
    }

    /// Draws a list into the renderer's own memory: what a time contains.
    ///
    /// # Errors
    /// `samples` or `background` out of range, a picture over [`MAX_PIXEL_COUNT`], an inconsistent
    /// list, or [`LodError::Cancelled`].
    pub fn draw(
        &mut self,
        list: &DrawList,
        view: &View,
        settings: &Settings,
        job: &Job,
    ) -> Result<Stats, LodError> {
        list.check()?;
        check_finite("background", &[settings.background])?;
        let pixel_count = u64::from(view.width) * u64::from(view.height);
        check_limit("size", pixel_count, MAX_PIXEL_COUNT, "pixels")?;
        let positions = samples::positions(settings.sample_count)?;
        let mut stats = Stats {
            thread_count: rayon::current_num_threads(),
            fragment_count: settings.counts_fragments.then_some(0),
            ..Stats::default()
        };
        stats.count(list);
        let level = self.simd.map_or_else(Level::chosen, Ok)?;
        let start = Instant::now();
        let length = usize::try_from(pixel_count).expect("checked above");
        self.planes.resize(length, settings.outputs);
        let cut = setup::cut(list);
        let weight = 1.0 / settings.sample_count as f32;
        let mut left = &positions[..];
        let mut first = true;
        while !left.is_empty() {
            let (pass, rest) = left.split_at(samples::pass_size(left.len()));
            left = rest;
            let state = PassState { list, view, settings, cut: &cut, weight, first, level, job };
            match pass.len() {
                1 => self.pass::<1>(&state, pass, &mut stats)?,
                4 => self.pass::<4>(&state, pass, &mut stats)?,
                8 => self.pass::<8>(&state, pass, &mut stats)?,
                _ => self.pass::<16>(&state, pass, &mut stats)?,
            }
            first = false;
        }
        self.planes.finish(settings.background);
        stats.draw_millis = start.elapsed().as_secs_f64() * 1e3;
        Ok(stats)
    }

    /// Adds the samples of one set of positions to the picture.
    fn pass<const S: usize>(
        &mut self,
        state: &PassState<'_>,
        positions: &[SamplePosition],
        stats: &mut Stats,
    ) -> Result<(), LodError> {
        let samples: [SamplePosition; S] = positions.try_into().expect("S positions");
        let PassState { list, view, settings, cut, weight, first, level, job } = *state;
        let outputs = Outputs {
            color: settings.outputs.color || settings.outputs.color8,
            depth: settings.outputs.depth || settings.outputs.ids,
            ..settings.outputs
        };
        let blends = list.items.iter().any(|item| item.blend == Blend::Over);
        let batches: Vec<&[Vec<Segment>]> = cut.chunks(self.max_batch_units).collect();
        let side = tile_side(S).min(self.max_tile_side);
        let tile_rows = i32::try_from(view.height).expect("checked").div_euclid(side)
            + i32::from(!view.height.is_multiple_of(side.unsigned_abs()));
        let layered = blends || batches.len() > 1;
        for rows in bands(view, S, side, tile_rows, batches.len()) {
            let grid = Grid::new(view, side, rows, &samples);
            let tile_count = grid.tile_count();
            // one buffer a thread is enough unless samples must outlive a batch
            let one_batch = batches.len() <= 1;
            let buffer_count =
                if one_batch { rayon::current_num_threads() + 1 } else { tile_count };
            self.tiles.resize_with(buffer_count.max(self.tiles.len()), Mutex::default);
            let Self { units, tiles, planes, .. } = self;
            let buffer_of = |tile: usize| {
                let thread = rayon::current_thread_index().unwrap_or(tiles.len() - 1);
                let slot = if one_batch { thread.min(tiles.len() - 1) } else { tile };
                tiles[slot].lock().unwrap_or_else(PoisonError::into_inner)
            };
            if !one_batch {
                (0..tile_count).into_par_iter().for_each(|tile| {
                    buffer_of(tile).clear(&grid, S, outputs, layered);
                });
            }
            let mut targets = split(planes, &grid, view);
            if batches.is_empty() && first {
                targets.par_iter_mut().for_each(leave_blank);
            }
            for (number, batch) in batches.iter().enumerate() {
                let units = set_up(units, batch, state, &grid)?;
                stats.vertex_count += units.iter().map(|unit| unit.vertex_count).sum::<u64>();
                let mut scene = Scene::new(level, list, view, units, grid, &samples, outputs);
                scene.counts_fragments = settings.counts_fragments;
                let last = number + 1 == batches.len();
                let fragments: Result<Vec<u64>, LodError> = targets
                    .par_iter_mut()
                    .enumerate()
                    .map(|(tile, target)| {
                        job.check()?;
                        if one_batch && scene.is_empty(tile) {
                            if first {
                                leave_blank(target);
                            }
                            return Ok(0);
                        }
                        let mut buffer = buffer_of(tile);
                        if one_batch {
                            buffer.clear(&grid, S, outputs, layered);
                        }
                        buffer.fragment_count = 0;
                        buffer.draw(&scene, tile);
                        if layered {
                            buffer.color_waiting(&scene, tile);
                        }
                        if one_batch && blends && outputs.depth {
                            buffer.find_half_opacity(&scene, tile);
                        }
                        if last && (one_batch || !(blends && outputs.depth)) {
                            buffer.resolve(&scene, tile, weight, first, target);
                        }
                        Ok(buffer.fragment_count)
                    })
                    .collect();
                let fragments = fragments?.iter().sum::<u64>();
                if let Some(count) = &mut stats.fragment_count {
                    *count += fragments;
                }
            }
            if !one_batch && blends && outputs.depth {
                // nearest first: the batches again, last to first
                for (number, batch) in batches.iter().enumerate().rev() {
                    let units = set_up(units, batch, state, &grid)?;
                    let scene = Scene::new(level, list, view, units, grid, &samples, outputs);
                    targets.par_iter_mut().enumerate().try_for_each(|(tile, target)| {
                        job.check()?;
                        let mut buffer = buffer_of(tile);
                        buffer.find_half_opacity(&scene, tile);
                        if number == 0 {
                            buffer.resolve(&scene, tile, weight, first, target);
                        }
                        Ok(())
                    })?;
                }
            }
        }
        Ok(())
    }
}

/// What every pass over a list shares.
#[derive(Clone, Copy)]
struct PassState<'a> {
    list: &'a DrawList,
    view: &'a View,
    settings: &'a Settings,
    cut: &'a [Vec<Segment>],
    weight: f32,
    /// Whether the picture holds nothing yet, not even zeros.
    first: bool,
    level: Level,
    job: &'a Job,
}

/// Tile rows drawn at once: all of them, unless samples must outlive a batch and would not fit.
fn bands(
    view: &View,
    sample_count: usize,
    side: i32,
    tile_rows: i32,
    batch_count: usize,
) -> Vec<Range<i32>> {
    if batch_count <= 1 {
        return std::iter::once(0..tile_rows).collect();
    }
    let row_samples = u64::from(view.width + side.unsigned_abs())
        * sample_count as u64
        * side.unsigned_abs() as u64;
    let rows = (MAX_BAND_BYTES / (row_samples * TileBuffer::LAYERED_SAMPLE_BYTES)).max(1);
    let rows = i32::try_from(rows).unwrap_or(tile_rows).min(tile_rows);
    (0..tile_rows)
        .step_by(usize::try_from(rows).expect("positive"))
        .map(|first| first..(first + rows).min(tile_rows))
        .collect()
}

/// Builds a batch's units in parallel, in memory that earlier ones left.
fn set_up<'a>(
    units: &'a mut Vec<Unit>,
    batch: &[Vec<Segment>],
    state: &PassState<'_>,
    grid: &Grid,
) -> Result<&'a [Unit], LodError> {
    let PassState { list, view, level, job, .. } = *state;
    units.resize_with(batch.len().max(units.len()), Unit::default);
    let used = &mut units[..batch.len()];
    used.par_iter_mut().zip(batch).try_for_each(|(unit, segments)| {
        job.check()?;
        unit.build(level, list, view, grid, segments);
        Ok(())
    })?;
    Ok(used)
}

/// Each tile's rows of every plane.
fn split<'a>(planes: &'a mut Planes, grid: &Grid, view: &View) -> Vec<TileTarget<'a>> {
    let mut targets: Vec<TileTarget<'a>> = Vec::new();
    targets.resize_with(grid.tile_count(), TileTarget::default);
    let width = view.width as usize;
    let side = usize::try_from(grid.tile).expect("positive");
    let columns = usize::try_from(grid.columns).expect("positive");
    let first = usize::try_from(grid.first_row).expect("not negative") * side;
    let last = usize::try_from(grid.last_row * grid.tile).expect("positive");
    let rows = first..last.min(view.height as usize);
    let Planes { color, depth, ids, normal, albedo, .. } = planes;
    let mut place = PlaceRows { targets: &mut targets, width, side, columns, rows };
    place.each(color, |target| &mut target.color);
    place.each(depth, |target| &mut target.depth);
    place.each(ids, |target| &mut target.ids);
    place.each(normal, |target| &mut target.normal);
    place.each(albedo, |target| &mut target.albedo);
    targets
}

struct PlaceRows<'t, 'a> {
    targets: &'t mut [TileTarget<'a>],
    width: usize,
    side: usize,
    columns: usize,
    rows: Range<usize>,
}

impl<'a> PlaceRows<'_, 'a> {
    fn each<T>(
        &mut self,
        plane: &'a mut [T],
        of: impl for<'x> Fn(&'x mut TileTarget<'a>) -> &'x mut Vec<&'a mut [T]>,
    ) {
        if plane.is_empty() {
            return;
        }
        let wanted = &mut plane[self.rows.start * self.width..self.rows.end * self.width];
        for (y, row) in wanted.chunks_mut(self.width).enumerate() {
            for (column, piece) in row.chunks_mut(self.side).enumerate() {
                of(&mut self.targets[y / self.side * self.columns + column]).push(piece);
            }
        }
    }
}
