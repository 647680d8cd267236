//! Procedural plants: a preset, a seed, and a tree that is the same on every machine.
//!
//! Stems first, then the wood around them, then the leaves on the twigs; flowers and grass have
//! files of their own. Everything is in metres, y up, with the foot on the ground at the origin. The
//! wood depends on the preset and the seed only; the number of leaves is exact, whatever is asked
//! for. Up to the preset's own number, leaves keep their size; more of them are smaller, so that leaf
//! area and gaps stay.
//! A tree takes 20 to 200 ms on two cores, a herb 4; a million chestnut leaves 4 s and 1.4 GB.
//!
//! This work is based on:
//! Jason Weber, Joseph Penn. Creation and Rendering of Realistic Trees. 1995

mod blade;
mod grass;
mod herb;
mod leaves;
mod params;
mod presets;
mod skeleton;
#[cfg(test)]
mod tests;
mod tree;
mod tube;
mod turn;
mod twigs;

use std::ops::Range;
use std::sync::Arc;

use glam::DVec3;

use crate::error::{LodError, check_in};
use crate::job::Job;
use crate::plant::grow::blade::Elements;
use crate::plant::grow::presets::{PRESETS, Preset};
use crate::plant::grow::skeleton::Stem;
use crate::plant::{AlphaMode, Branch, Lighting, Material, Mesh, Part, Plant, Structure};
use crate::texture::Sampler;

/// Most leaves of a grown plant: 7 GB while ten triangles a leaf are grown.
pub const MAX_LEAF_COUNT: usize = 5_000_000;

/// Names that [`grow`] takes.
pub fn preset_names() -> impl Iterator<Item = &'static str> {
    PRESETS.iter().map(|preset| preset.name())
}

/// What a plant consists of before it is lit.
struct Grown {
    stems: Vec<Stem>,
    wood: Mesh,
    /// Each stem's triangles.
    wood_ranges: Vec<Range<u32>>,
    foliage: Elements,
    /// The first is that of the wood, if there is any.
    materials: &'static [&'static str],
    /// Triangles of the foliage that are of the last material and not of the leaves'.
    petals: Range<u32>,
}

/// Grows a plant of a preset, with the preset's own number of leaves unless another is asked for.
///
/// The job's steps are leaves, those that can be many.
///
/// # Errors
/// [`LodError::Invalid`] for an unknown preset; [`LodError::OutOfRange`] if `leaf_count` is above
/// [`MAX_LEAF_COUNT`], or leaves no leaf beside what the preset always has (twigs, parts of flowers);
/// whatever [`Lighting::check`] refuses; [`LodError::Cancelled`].
pub fn grow(
    preset: &str,
    seed: u64,
    leaf_count: Option<usize>,
    lighting: Lighting,
    job: &Job,
) -> Result<Plant, LodError> {
    let Some(chosen) = PRESETS.iter().find(|known| known.name() == preset) else {
        let known = preset_names().collect::<Vec<_>>().join(", ");
        let why = format!("there is no {preset:?}; there are {known}");
        return Err(LodError::Invalid { name: "preset", why });
    };
    let (usual, fixed) = chosen.leaf_counts();
    let leaf_count = leaf_count.unwrap_or(usual);
    check_in("leaf_count", leaf_count, fixed + 1..=MAX_LEAF_COUNT)?;
    lighting.check()?;
    let grown = match chosen {
        Preset::Tree(species) => tree::tree(species, seed, leaf_count, job)?,
        Preset::Herb(herb) => herb::herb(herb, seed, leaf_count, job)?,
        Preset::Tuft(tuft) => grass::tuft(tuft, seed, leaf_count, job)?,
    };
    grown.plant(preset, lighting, job)
}

impl Preset {
    /// Elements of the foliage, usually, and how many of those are there in any case.
    fn leaf_counts(self) -> (usize, usize) {
        match self {
            Self::Tree(species) => {
                let twigs = twigs::element_count(species);
                (species.leaves.count + twigs, twigs)
            }
            Self::Herb(herb) => (herb.usual_count(), herb.fixed_count()),
            Self::Tuft(tuft) => (tuft.blade_count, 0),
        }
    }
}

impl Grown {
    fn plant(self, name: &str, lighting: Lighting, job: &Job) -> Result<Plant, LodError> {
        let Self { stems, mut wood, wood_ranges, foliage, materials, petals } = self;
        let Elements { mut mesh, offsets, owners } = foliage;
        let count = |mesh: &Mesh| u32::try_from(mesh.triangles.len()).expect("leaves are limited");
        let all = count(&mesh);
        if !wood.is_empty() {
            wood.parts = vec![Part { material: 0, triangles: 0..count(&wood) }];
        }
        let leaves = u32::from(!wood.is_empty());
        let parts =
            [(leaves, 0..petals.start), (leaves + 1, petals.clone()), (leaves, petals.end..all)];
        let some = |(material, triangles): (u32, Range<u32>)| Part { material, triangles };
        mesh.parts =
            parts.into_iter().map(some).filter(|part| !part.triangles.is_empty()).collect();
        let structure = (!stems.is_empty()).then(|| {
            let branches = branches(&stems, wood_ranges, &owners);
            Arc::new(Structure { branches, leaf_branches: owners })
        });
        let materials =
            materials.iter().enumerate().map(|(id, name)| material(name, id > 0)).collect();
        let name = name.to_owned();
        let mut plant =
            Plant::new(name, DVec3::ZERO, materials, wood, mesh, offsets, lighting, job)?;
        plant.structure = structure;
        Ok(plant)
    }
}

fn material(name: &str, double_sided: bool) -> Material {
    Material {
        name: name.to_owned(),
        texture: None,
        sampler: Sampler::default(),
        alpha_mode: AlphaMode::Opaque,
        double_sided,
    }
}

/// The stems as other kernels see them.
fn branches(stems: &[Stem], wood_ranges: Vec<Range<u32>>, leaf_branches: &[u32]) -> Vec<Branch> {
    let mut next = 0;
    stems
        .iter()
        .zip(wood_ranges)
        .enumerate()
        .map(|(id, (stem, wood_triangles))| {
            let first = next;
            next += leaf_branches[first..].iter().take_while(|&&stem| stem as usize == id).count();
            let leaf = |index| u32::try_from(index).expect("leaves are limited");
            let (base, tip) = (stem.nodes[0], stem.nodes[stem.nodes.len() - 1]);
            #[expect(clippy::cast_possible_truncation, reason = "radii are stored in f32")]
            let radius = base.radius as f32;
            Branch {
                parent: stem.parent,
                level: u32::try_from(stem.level).expect("levels are few"),
                start: base.position.as_vec3(),
                end: tip.position.as_vec3(),
                radius,
                wood_triangles,
                leaves: leaf(first)..leaf(next),
            }
        })
        .collect()
}
