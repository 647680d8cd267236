//! What a plant is: wood and foliage with materials, lit once.

pub mod foliage;
pub mod grow;
pub mod leaf_rectangle;
pub mod lighting;
pub mod limbs;
pub mod mesh;
pub(crate) mod near_points;
pub mod normals;
pub mod occlusion;
#[expect(clippy::module_inception, reason = "the file is named for the type it holds")]
pub mod plant;
pub mod rectangle;
pub mod split;
pub mod structure;
pub mod weld;

pub use foliage::Foliage;
pub use lighting::Lighting;
pub use mesh::{Mesh, Part};
pub use plant::{AlphaMode, Material, Plant};
pub use structure::{Branch, Structure};
