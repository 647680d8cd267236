//! Varieties for Python.

use glam::DVec3;
use pyo3::prelude::*;

use crate::error::LodError;
use crate::scene::variety::Variety;

/// A variety as Python states it.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct VarietyFacts {
    size: f64,
    hue_deg: f64,
    value: f64,
    mirror: bool,
    color: [f64; 3],
    seed: u64,
}

impl VarietyFacts {
    pub(super) fn variety(&self) -> Result<Variety, LodError> {
        let Self { size, hue_deg, value, mirror, color, seed } = *self;
        let variety = Variety { size, hue_deg, value, mirror, color: DVec3::from(color), seed };
        variety.check()?;
        Ok(variety)
    }
}

/// What a copy is like: times as large, whether it is mirrored, and what its colours are multiplied by.
#[pyfunction]
pub(super) fn variant(
    variety: VarietyFacts,
    group: u32,
    copy: u32,
) -> Result<(f64, bool, [f32; 3]), LodError> {
    let variety = variety.variety()?;
    let variant = variety.of((group, copy));
    Ok((variant.scale, variant.is_mirrored, variety.tint(&variant).to_array()))
}
