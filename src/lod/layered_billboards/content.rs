//! What is baked into layers, the elements: leaves, and each triangle of the wood if that is baked too.

use std::borrow::Cow;

use glam::DVec2;
use rayon::prelude::*;

use crate::error::LodError;
use crate::job::Job;
use crate::lod::layered_billboards::WoodAs;
use crate::lod::layered_billboards::frame::Frame;
use crate::lod::leaves::{FLAT, LEAST_SIZE, Leaves};
use crate::plant::limbs::Limbs;
use crate::plant::{Foliage, Mesh, Part, Plant};

/// The elements of a plant: its wood's triangles first, if those are baked, then its leaves.
pub(super) struct Content<'a> {
    /// The elements as the leaves of a plant.
    pub(super) plant: Cow<'a, Plant>,
    wood_count: usize,
}

impl<'a> Content<'a> {
    pub(super) fn new(
        plant: &'a Plant,
        wood: &Mesh,
        wood_as: WoodAs,
        job: &Job,
    ) -> Result<Self, LodError> {
        if wood_as == WoodAs::Mesh || wood.is_empty() {
            return Ok(Self { plant: Cow::Borrowed(plant), wood_count: 0 });
        }
        let wood_count = wood.triangles.len();
        let mut mesh = wood.clone();
        mesh.append(&plant.foliage.mesh);
        job.check()?;
        let first = u32::try_from(wood_count).expect("checked by the plant");
        let leaf_offsets = plant.foliage.leaf_offsets.iter().map(|&offset| offset + first);
        let offsets = (0..first).chain(leaf_offsets).collect();
        let elements = Plant {
            name: plant.name.clone(),
            origin: plant.origin,
            materials: plant.materials.clone(),
            wood: Mesh::default(),
            foliage: Foliage::new(mesh, offsets, job)?,
            lighting: plant.lighting,
            structure: None,
        };
        Ok(Self { plant: Cow::Owned(elements), wood_count })
    }

    /// Elements that are wood.
    pub(super) fn wood_count(&self) -> usize {
        self.wood_count
    }

    /// Square metres of each element.
    pub(super) fn areas(&self) -> &[f32] {
        &self.plant.foliage.areas
    }

    /// The limb of each element.
    pub(super) fn element_limbs(&self, limbs: &Limbs) -> Vec<u32> {
        let wood = &limbs.wood_limbs[..self.wood_count];
        wood.iter().chain(&limbs.leaf_limbs).copied().collect()
    }
}

/// The smallest box around some elements as seen along the frame's direction, from the crown's centre.
pub(super) fn seen_box_of(
    leaves: &Leaves<'_>,
    frame: &Frame,
    elements: impl IntoParallelIterator<Item = usize>,
) -> (DVec2, DVec2) {
    let none = || (DVec2::INFINITY, DVec2::NEG_INFINITY);
    elements
        .into_par_iter()
        .map(|element| {
            leaves.vertices_of(element).fold(none(), |(low, high), p| {
                let seen = frame.seen(p);
                (low.min(seen), high.max(seen))
            })
        })
        .reduce(none, |a, b| (a.0.min(b.0), a.1.max(b.1)))
}

/// The same around all elements; what is seen as a line or as a point still has a width.
pub(super) fn seen_box(leaves: &Leaves<'_>, frame: &Frame) -> (DVec2, DVec2) {
    let (low, high) = seen_box_of(leaves, frame, 0..leaves.leaf_centers.len());
    let least = least_side(leaves);
    let missing = (DVec2::splat(least) - (high - low)).max(DVec2::ZERO) / 2.0;
    (low - missing, high + missing)
}

/// Width of what is seen as a line or as a point.
pub(super) fn least_side(leaves: &Leaves<'_>) -> f64 {
    (leaves.radius * FLAT).max(LEAST_SIZE * FLAT)
}

/// A mesh whose triangles are sorted by layer.
#[derive(Default)]
pub(super) struct ByLayer {
    pub(super) mesh: Mesh,
    /// One past the last triangle of each layer.
    pub(super) ends: Vec<u32>,
    /// Where each triangle was before.
    pub(super) ids: Vec<u32>,
}

impl ByLayer {
    /// Triangles of each layer.
    pub(super) fn counts(&self) -> impl Iterator<Item = usize> {
        let starts = std::iter::once(&0).chain(&self.ends);
        starts.zip(&self.ends).map(|(start, end)| (end - start) as usize)
    }
}

/// Sorts wood by layer; `layers` has a layer for each triangle of all the plant's wood, of which `wood`
/// is a part or a simpler form on some of the same vertices.
pub(super) fn by_layer(wood: &Mesh, all: &Mesh, layers: &[usize], layer_count: usize) -> ByLayer {
    let layer_of: Vec<usize> =
        if wood == all { layers.to_vec() } else { layers_by_place(wood, all, layers) };
    let count = u32::try_from(wood.triangles.len()).expect("checked by the plant");
    let mut ids: Vec<u32> = (0..count).collect();
    ids.sort_by_key(|&triangle| layer_of[triangle as usize]);
    let materials: Vec<u32> = wood.triangle_materials().collect();
    let mut parts: Vec<Part> = Vec::new();
    let mut ends = vec![0; layer_count];
    let mut last = None;
    for (at, &triangle) in (0_u32..).zip(&ids) {
        let (layer, material) = (layer_of[triangle as usize], materials[triangle as usize]);
        match parts.last_mut() {
            Some(part) if last == Some((layer, material)) => part.triangles.end = at + 1,
            _ => parts.push(Part { material, triangles: at..at + 1 }),
        }
        last = Some((layer, material));
        ends[layer] = at + 1;
    }
    // layers without wood end where the one before does
    let mut end = 0;
    for layer_end in &mut ends {
        end = end.max(*layer_end);
        *layer_end = end;
    }
    let triangles = ids.iter().map(|&triangle| wood.triangles[triangle as usize]).collect();
    ByLayer { mesh: Mesh { triangles, parts, ..wood.clone() }, ends, ids }
}

/// For each triangle the layer of what had its first corner: the lowest, where several meet.
fn layers_by_place(wood: &Mesh, all: &Mesh, layers: &[usize]) -> Vec<usize> {
    let key = |mesh: &Mesh, vertex: u32| {
        let place = mesh.positions[vertex as usize];
        place.to_array().map(f32::to_bits)
    };
    let mut known: Vec<([u32; 3], usize)> = all
        .triangles
        .iter()
        .zip(layers)
        .flat_map(|(corners, &layer)| corners.map(|vertex| (key(all, vertex), layer)))
        .collect();
    known.par_sort_unstable();
    let layer = |corners: &[u32; 3]| {
        let wanted = key(wood, corners[0]);
        let at = known.partition_point(|(place, _)| *place < wanted);
        known[at].1
    };
    wood.triangles.iter().map(layer).collect()
}
