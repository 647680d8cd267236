//! Leaves that collapse into larger leaves, and levels of detail that depend on the view.

pub mod forest;
pub mod quad;
