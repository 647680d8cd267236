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
use crate::gpu::renderer::Renderer;
use crate::job::Job;
use crate::raster::{Frame, Settings, Stats};
use crate::view::View;

pub use device::{ADAPTER_VARIABLE, AdapterFacts, adapters, close_all, release};

/// Draws a list and copies the picture out; with the adapter that drew it.
///
/// `adapter` is a part of an adapter's name, in any case, a kind of adapter, an interface, or a place in the
/// list of [`adapters`] such as `#1`; `None`: what `TREELOD_ADAPTER` names, else the first.
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
    with_renderer(adapter, job, |renderer| renderer.render(list, view, settings, job))
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
    with_renderer(adapter, job, |renderer| renderer.draw(list, view, settings, job))
}

/// Gives a renderer to one picture, and says whose it is.
fn with_renderer<T>(
    adapter: Option<&str>,
    job: &Job,
    draw: impl FnOnce(&mut Renderer) -> Result<T, LodError>,
) -> Result<(T, AdapterFacts), LodError> {
    loop {
        let shared = device::renderer_of(adapter, job)?;
        let mut renderer = device::taken(&shared, job)?;
        // lost while others drew: their loss, and another one is open for us
        if !renderer.gpu().is_lost() && !shared.is_poisoned() {
            let drawn = draw(&mut renderer)?;
            return Ok((drawn, renderer.gpu().facts.clone()));
        }
    }
}

/// Makes a device fail, to show that callers survive it: "lost", "memory" or "command".
///
/// # Errors
/// What the failure is.
pub fn fail(adapter: Option<&str>, kind: &str) -> Result<(), LodError> {
    let job = Job::default();
    with_renderer(adapter, &job, |renderer| renderer.gpu().fail(kind)).map(|_| ())
}
