//! The ball around a plant: what every frame of an impostor shows, and the square that it fills.

use glam::DVec3;

use crate::bake::BakeRect;
use crate::error::LodError;
use crate::job::Job;
use crate::lod::leaves::LEAST_SIZE;
use crate::plant::Mesh;

/// The box around the plant is larger by this share of the radius, for what rounding may move.
const ROUNDING: f64 = 1e-5;

/// Directions from the vertical, by the sine, whose frames have no up of their own.
pub(super) const VERTICAL: f64 = 1e-6;

/// The ball that a plant's frames show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ball {
    /// Middle of the box around the plant's vertices.
    pub(super) center: DVec3,
    /// Of the farthest vertex.
    pub(super) radius: f64,
    /// Half the box's sides.
    pub(super) half: DVec3,
}

impl Ball {
    /// Around the vertices of meshes: the middle of their box, and the farthest vertex from it.
    pub(super) fn around(meshes: &[&Mesh], job: &Job) -> Result<Option<Self>, LodError> {
        let boxes = meshes.iter().filter_map(|mesh| mesh.bounds());
        let Some((low, high)) = boxes.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))) else {
            return Ok(None);
        };
        let center = (low.as_dvec3() + high.as_dvec3()) * 0.5;
        let mut farthest: f64 = 0.0;
        for triangles in meshes.iter().flat_map(|mesh| {
            mesh.triangles.chunks(1 << 16).map(|triangles| (&mesh.positions, triangles))
        }) {
            job.check()?;
            let (positions, triangles) = triangles;
            let corners = triangles.iter().flatten();
            let distance =
                |&corner: &u32| (positions[corner as usize].as_dvec3() - center).length_squared();
            farthest = corners.map(distance).fold(farthest, f64::max);
        }
        let half = (high.as_dvec3() - low.as_dvec3()) * 0.5;
        Ok(Some(Self { center, radius: farthest.sqrt().max(LEAST_SIZE), half }))
    }

    /// The same with a box that holds what frames of so many texels smear beyond the plant.
    pub(super) fn smeared(self, resolution: u32) -> Self {
        let texel = 2.0 * self.radius / f64::from(resolution);
        Self { half: self.half + texel + self.radius * ROUNDING, ..self }
    }

    /// The square that a frame shows.
    pub(super) fn rect(&self, toward: DVec3) -> BakeRect {
        // seen from above and below, the picture's top is north
        let vertical = toward.x.hypot(toward.z) < VERTICAL;
        let upright = if vertical { DVec3::NEG_Z } else { DVec3::Y };
        let right = upright.cross(toward).normalize();
        let side = 2.0 * self.radius;
        BakeRect {
            center: self.center,
            right,
            up: toward.cross(right),
            width: side,
            height: side,
            reach: self.radius,
        }
    }
}
