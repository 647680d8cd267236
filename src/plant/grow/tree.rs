//! Trees: stems, wood around them, leaves on their twigs.

use crate::error::LodError;
use crate::job::Job;
use crate::plant::grow::Grown;
use crate::plant::grow::blade::Elements;
use crate::plant::grow::params::Species;
use crate::plant::grow::{leaves, skeleton, tube, twigs};

/// A tree whose foliage has `leaf_count` elements, twigs that are foliage among them.
///
/// # Errors
/// [`LodError::Cancelled`].
pub(super) fn tree(
    species: &Species,
    seed: u64,
    leaf_count: usize,
    job: &Job,
) -> Result<Grown, LodError> {
    let blade = species.leaves.blade;
    let blade_count = leaf_count - twigs::element_count(species);
    let stems = skeleton::grow_stems(species, seed, job)?;
    let (wood, wood_ranges) = tube::wood(species, seed, &stems);
    let (mesh, owners) = leaves::leaves(species, seed, &stems, blade_count, job)?;
    let foliage = if blade_count == leaf_count {
        let offsets = job.collect(leaf_count + 1, |leaf| {
            u32::try_from(leaf * blade.triangles.len()).expect("the leaf limit keeps to u32")
        })?;
        Elements { mesh, offsets, owners }
    } else {
        twigs::with_leaves(species, &stems, &mesh, &owners, job)?
    };
    let materials = &["wood", "leaves"];
    Ok(Grown { stems, wood, wood_ranges, foliage, materials, petals: 0..0 })
}
