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

pub mod error;
pub mod job;
pub mod plant;
#[cfg(feature = "python")]
mod py;
pub mod random;
pub mod texture;

pub use error::LodError;
