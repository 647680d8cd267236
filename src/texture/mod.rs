//! Textures: stored as 8-bit sRGB with straight alpha, filtered linear and premultiplied.

pub(crate) mod alpha_bounds;
pub mod atlas;
mod blocks;
pub mod depth_map;
pub mod dilate;
pub mod distribution;
pub mod formats;
pub mod frames;
pub mod light;
pub mod linear;
pub mod mips;
pub mod normal_map;
mod palette;
pub mod quadtree;
pub mod srgb;
#[expect(clippy::module_inception, reason = "the file is named for the type it holds")]
pub mod texture;

pub use depth_map::DepthMap;
pub use distribution::Distribution;
pub use formats::Format;
pub use frames::Frames;
pub use light::Light;
pub use linear::LinearImage;
pub use normal_map::NormalMap;
pub use texture::{Filter, Image, Sampler, Texture, Wrap};
