//! Leaves that collapse into larger leaves, and levels of detail that depend on the view.

pub mod active_tree;
pub mod ball;
pub mod collapse;
pub mod cost;
pub mod forest;
pub mod leaf_quads;
pub mod new_leaf;
pub mod quad;
