//! Level of detail of trees and foliage: every technique built, drawn and measured.
//!
//! ```text
//! Plant ─ build ─▶ Representation ─ emit ─▶ DrawList ─ render ─▶ Frame
//! ```
//!
//! A technique is one file in [`lod`] that turns a [`plant::Plant`] into a representation and emits
//! a draw list for a view. A renderer draws a draw list and knows no technique. Baking a texture is
//! rendering: an orthographic view of some leaves through the same rasteriser.
//!
//! The core opens no file and knows no Python; the Python face is behind the `python` feature.
//! Right-handed, y up, metres; cameras look along -z; row 0 is on top; colours are linear.

pub mod bake;
pub mod draw_list;
pub mod error;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod job;
pub mod lod;
pub mod plant;
pub mod png;
pub mod random;
pub mod raster;
pub mod scene;
pub mod simd;
pub mod texture;
pub mod view;
pub mod view_state;

#[cfg(feature = "python")]
mod py;

pub use error::LodError;
