//! A plant: wood, foliage and the materials of both, in one frame of reference.

use std::sync::Arc;

use glam::{DVec3, Vec3};

use crate::error::{LodError, check_finite, check_in};
use crate::job::Job;
use crate::plant::{Foliage, Lighting, Mesh, Structure, occlusion};
use crate::texture::{Sampler, Texture};

/// What a material's alpha means.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AlphaMode {
    /// Alpha is ignored.
    Opaque,
    /// Drawn where alpha is at least the cutoff.
    Mask {
        /// At least 0.
        cutoff: f32,
    },
    /// Blended over what lies behind.
    Blend,
}

/// How triangles of one part are coloured.
#[derive(Debug, Clone)]
pub struct Material {
    /// As in the file.
    pub name: String,
    /// Multiplies the lit vertex colour; `None` draws the vertex colour alone.
    pub texture: Option<Arc<Texture>>,
    /// How the texture is read outside [0, 1].
    pub sampler: Sampler,
    /// What alpha means.
    pub alpha_mode: AlphaMode,
    /// As in the file; both sides are always drawn.
    pub double_sided: bool,
}

/// Wood and foliage, lit once.
#[derive(Debug, Clone)]
pub struct Plant {
    /// For tables and file names.
    pub name: String,
    /// World position that all meshes' coordinates are relative to.
    pub origin: DVec3,
    /// Shared by wood and foliage.
    pub materials: Vec<Material>,
    /// Trunk and limbs; may be empty.
    pub wood: Mesh,
    /// Leaves; may be empty, but not together with the wood.
    pub foliage: Foliage,
    /// What `front` and `back` colours were computed from.
    pub lighting: Lighting,
    /// How it branches, where that is known: grown plants know it, files do not say.
    pub structure: Option<Arc<Structure>>,
}

impl Plant {
    /// Checks every array, measures the leaves and lights the plant.
    ///
    /// # Errors
    /// The first array that is wrong, by name; [`LodError::Empty`] without any triangle;
    /// [`LodError::Cancelled`].
    #[expect(clippy::too_many_arguments, reason = "what a plant consists of, and the job")]
    pub fn new(
        name: String,
        origin: DVec3,
        materials: Vec<Material>,
        mut wood: Mesh,
        mut leaves: Mesh,
        leaf_offsets: Vec<u32>,
        lighting: Lighting,
        job: &Job,
    ) -> Result<Self, LodError> {
        check_finite("origin", &[origin])?;
        lighting.check()?;
        for material in &materials {
            if let AlphaMode::Mask { cutoff } = material.alpha_mode {
                check_in("alpha_cutoff", cutoff, 0.0..=f32::MAX)?;
            }
        }
        for (mesh, translucency) in [(&mut wood, 0.0), (&mut leaves, lighting.translucency)] {
            // lighting fills two of the arrays that are checked
            lighting.light(mesh, translucency, None, job)?;
            mesh.check(materials.len(), job)?;
        }
        if wood.is_empty() && leaves.is_empty() {
            return Err(LodError::Empty { name: "plant", why: "it has no triangles" });
        }
        let foliage = Foliage::new(leaves, leaf_offsets, job)?;
        let lit = lighting.without_occlusion();
        let plant = Self { name, origin, materials, wood, foliage, lighting: lit, structure: None };
        plant.relit(lighting, job)
    }

    /// The same plant under other light.
    ///
    /// # Errors
    /// If the lighting is out of range; [`LodError::Cancelled`].
    pub fn lit(&self, lighting: Lighting, job: &Job) -> Result<Self, LodError> {
        self.clone().relit(lighting, job)
    }

    /// This plant under other light.
    ///
    /// # Errors
    /// As [`Plant::lit`].
    pub fn relit(mut self, lighting: Lighting, job: &Job) -> Result<Self, LodError> {
        lighting.check()?;
        if lighting == self.lighting {
            return Ok(self);
        }
        let seen = if lighting.occlusion > 0.0 {
            Some(occlusion::seen(&self.wood, &self.foliage, &self.materials, job)?)
        } else {
            None
        };
        let of = |mesh: usize| seen.as_ref().map(|seen| &seen[mesh][..]);
        lighting.light(&mut self.wood, 0.0, of(0), job)?;
        lighting.light(&mut self.foliage.mesh, lighting.translucency, of(1), job)?;
        self.lighting = lighting;
        Ok(self)
    }

    /// Triangles of wood and foliage together.
    pub fn triangle_count(&self) -> usize {
        self.wood.triangles.len() + self.foliage.mesh.triangles.len()
    }

    /// Smallest box around the plant, relative to its origin.
    pub fn local_bounds(&self) -> (Vec3, Vec3) {
        match (self.wood.bounds(), self.foliage.mesh.bounds()) {
            (Some(wood), Some(leaves)) => (wood.0.min(leaves.0), wood.1.max(leaves.1)),
            (Some(only), None) | (None, Some(only)) => only,
            (None, None) => unreachable!("a plant has at least one triangle"),
        }
    }

    /// Smallest box around the plant, in world coordinates.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let (low, high) = self.local_bounds();
        (low.as_dvec3() + self.origin, high.as_dvec3() + self.origin)
    }

    /// Centre of the box around the plant, in world coordinates, and the largest distance of a
    /// vertex that a triangle uses from it.
    pub fn sphere(&self) -> (DVec3, f64) {
        let (low, high) = self.local_bounds();
        let center = (low.as_dvec3() + high.as_dvec3()) * 0.5;
        let radius_sq = [&self.wood, &self.foliage.mesh]
            .into_iter()
            .flat_map(|mesh| mesh.triangles.iter().flatten().map(|&v| mesh.positions[v as usize]))
            .map(|position| position.as_dvec3().distance_squared(center))
            .fold(0.0, f64::max);
        (center + self.origin, radius_sq.sqrt())
    }
}
