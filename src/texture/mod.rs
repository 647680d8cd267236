//! Textures: stored as 8-bit sRGB with straight alpha, filtered linear and premultiplied.

pub(crate) mod alpha_bounds;
pub mod atlas;
mod blocks;
pub mod dilate;
pub mod distribution;
pub mod formats;
pub mod linear;
pub mod mips;
mod palette;
pub mod quadtree;
pub mod srgb;
#[expect(clippy::module_inception, reason = "the file is named for the type it holds")]
pub mod texture;

pub use distribution::Distribution;
pub use formats::Format;
pub use linear::LinearImage;
pub use texture::{Filter, Image, Sampler, Texture, Wrap};
