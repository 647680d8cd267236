//! The renderer that draws on graphics cards: the same lists as [`crate::raster`], the same pictures.
//!
//! It goes through wgpu, so through Vulkan, Metal or DirectX 12. A picture of four samples is drawn at
//! once where the card can, with the card's own four samples, which lie where ours do; other numbers of
//! samples, and planes besides colour and depth, are one-sample pictures that are added up, each shifted
//! so that its sample lies in the middle of the pixel. Shapes, surfaces, blending, fades and thresholds are
//! the twins of those of the CPU renderer, in WGSL, line by line.
//!
//! This work is based on:
//! The World Wide Web Consortium. WebGPU, and WebGPU Shading Language. 2024

mod device;
mod packing;
mod pipelines;
mod readback;
mod renderer;
mod resources;
mod sums;
mod template;
#[cfg(test)]
mod tests;

use crate::draw_list::DrawList;
use crate::error::LodError;
use crate::job::Job;
use crate::raster::{Frame, Settings, Stats};
use crate::view::View;

pub use device::{ADAPTER_VARIABLE, AdapterFacts, adapters, close_all};

/// Draws a list and copies the picture out; with the adapter that drew it.
///
/// `adapter` is a part of an adapter's name, in any case, or a kind of adapter; `None`: what
/// `TREELOD_ADAPTER` names, else the first.
///
/// # Errors
/// As [`draw`].
pub fn render(
    adapter: Option<&str>,
    list: &DrawList,
    view: &View,
    settings: &Settings,
    job: &Job,
) -> Result<(Frame, AdapterFacts), LodError> {
    let shared = device::renderer_of(adapter)?;
    let mut renderer = device::taken(&shared, job)?;
    let frame = renderer.render(list, view, settings, job)?;
    Ok((frame, renderer.gpu().facts.clone()))
}

/// Draws a list and leaves the picture on the card: what a time contains.
///
/// # Errors
/// What the CPU renderer refuses; [`LodError::NoAdapter`], [`LodError::Device`], [`LodError::Limit`] for
/// what the card cannot hold, [`LodError::Forked`], [`LodError::Cancelled`].
pub fn draw(
    adapter: Option<&str>,
    list: &DrawList,
    view: &View,
    settings: &Settings,
    job: &Job,
) -> Result<(Stats, AdapterFacts), LodError> {
    let shared = device::renderer_of(adapter)?;
    let mut renderer = device::taken(&shared, job)?;
    let stats = renderer.draw(list, view, settings, job)?;
    Ok((stats, renderer.gpu().facts.clone()))
}

/// Makes a device fail, to show that callers survive it: "lost", "memory" or "command".
///
/// # Errors
/// What the failure is.
pub fn fail(adapter: Option<&str>, kind: &str) -> Result<(), LodError> {
    let shared = device::renderer_of(adapter)?;
    let renderer = device::taken(&shared, &Job::default())?;
    renderer.gpu().fail(kind)
}
