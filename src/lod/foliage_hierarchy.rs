//! Leaves that collapse into larger leaves, and levels of detail that depend on the view.

pub mod active;
pub mod active_tree;
pub mod ball;
pub mod collapse;
pub mod cost;
pub mod criteria;
pub mod cut;
pub mod depth_first;
pub mod forest;
pub mod leaf_quads;
#[cfg(test)]
mod made;
pub mod new_leaf;
pub mod quad;
pub mod stored;
pub mod uniform;
pub mod walk;
pub mod zone;
