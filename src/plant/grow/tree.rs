//! Trees: stems, wood around them, leaves on their twigs.

use crate::plant::grow::Grown;
use crate::plant::grow::blade::Elements;
use crate::plant::grow::params::Species;
use crate::plant::grow::{leaves, skeleton, tube, twigs};

/// A tree whose foliage has `leaf_count` elements, twigs that are foliage among them.
pub(super) fn tree(species: &Species, seed: u64, leaf_count: usize) -> Grown {
    let blade = species.leaves.blade;
    let blade_count = leaf_count - twigs::element_count(species);
    let stems = skeleton::grow_stems(species, seed);
    let (wood, wood_ranges) = tube::wood(species, seed, &stems);
    let (mesh, owners) = leaves::leaves(species, seed, &stems, blade_count);
    let foliage = if blade_count == leaf_count {
        let end = |leaf: usize| u32::try_from(leaf * blade.triangles.len());
        let offsets =
            (0..=leaf_count).map(|leaf| end(leaf).expect("the leaf limit keeps to u32")).collect();
        Elements { mesh, offsets, owners }
    } else {
        twigs::with_leaves(species, &stems, &mesh, &owners)
    };
    Grown { stems, wood, wood_ranges, foliage, materials: &["wood", "leaves"], petals: 0..0 }
}
