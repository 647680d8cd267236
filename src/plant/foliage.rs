//! The sparse part of a plant: a mesh cut into leaves, with each leaf's centre, normal and area.
//!
//! A leaf is a contiguous range of triangles: a blade, a card, a needle, a twig. Its centre is the
//! area-weighted centroid of its triangles (the mean of its vertices if it has no area), its normal
//! the area-weighted mean of its triangles' normals with signs aligned to the largest triangle's
//! (zero if it has no area), its area their sum.

use std::ops::Range;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::error::LodError;
use crate::plant::mesh::{Mesh, area_normal};

/// Leaves per rayon job.
const MIN_LEAVES_PER_JOB: usize = 1024;

/// A mesh whose triangles are grouped into leaves.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Foliage {
    /// All leaves' triangles; leaf `i` owns `leaf_offsets[i]..leaf_offsets[i + 1]`.
    pub mesh: Mesh,
    /// One more than there are leaves; begins with 0 and never decreases.
    pub leaf_offsets: Vec<u32>,
    /// Relative to the plant's origin, in metres.
    pub centers: Vec<Vec3>,
    /// Unit length, or zero for a leaf without area.
    pub normals: Vec<Vec3>,
    /// Square metres.
    pub areas: Vec<f32>,
}

impl Foliage {
    /// Groups a mesh into leaves and measures each of them.
    ///
    /// # Errors
    /// [`LodError::Invalid`] unless `leaf_offsets` begins with 0, ends with the triangle count and
    /// rises at every step (a leaf has at least one triangle).
    pub fn new(mesh: Mesh, leaf_offsets: Vec<u32>) -> Result<Self, LodError> {
        let ends = (leaf_offsets.first().copied(), leaf_offsets.last().copied());
        let rising = leaf_offsets.windows(2).all(|pair| pair[0] < pair[1]);
        let covers = ends.1.is_some_and(|end| end as usize == mesh.triangles.len());
        if ends.0 != Some(0) || !covers || !rising {
            let why = format!(
                "must rise from 0 to the triangle count {} with no empty leaf",
                mesh.triangles.len()
            );
            return Err(LodError::Invalid { name: "leaf_offsets", why });
        }
        let measured: Vec<(Vec3, Vec3, f32)> = leaf_offsets
            .par_windows(2)
            .with_min_len(MIN_LEAVES_PER_JOB)
            .map(|pair| measure(&mesh, pair[0] as usize..pair[1] as usize))
            .collect();
        let centers = measured.iter().map(|leaf| leaf.0).collect();
        let normals = measured.iter().map(|leaf| leaf.1).collect();
        let areas = measured.iter().map(|leaf| leaf.2).collect();
        Ok(Self { mesh, leaf_offsets, centers, normals, areas })
    }

    /// How many leaves there are.
    pub fn leaf_count(&self) -> usize {
        self.centers.len()
    }

    /// The triangles of a leaf.
    pub fn triangles_of(&self, leaf: usize) -> Range<usize> {
        self.leaf_offsets[leaf] as usize..self.leaf_offsets[leaf + 1] as usize
    }
}

/// Centre, normal and area of the triangles in `range`, summed in f64.
fn measure(mesh: &Mesh, range: Range<usize>) -> (Vec3, Vec3, f32) {
    let vectors: Vec<DVec3> = range.clone().map(|t| area_normal(mesh.corners(t))).collect();
    let area: f64 = vectors.iter().map(|vector| vector.length()).sum();
    if area == 0.0 {
        let vertices: Vec<DVec3> =
            range.flat_map(|t| mesh.corners(t)).map(|p| p.as_dvec3()).collect();
        let mean = vertices.iter().copied().sum::<DVec3>() / vertices.len() as f64;
        return (mean.as_vec3(), Vec3::ZERO, 0.0);
    }
    let mut largest = DVec3::ZERO;
    for &vector in &vectors {
        if vector.length_squared() > largest.length_squared() {
            largest = vector;
        }
    }
    let mut center = DVec3::ZERO;
    let mut normal = DVec3::ZERO;
    for (triangle, &vector) in range.zip(&vectors) {
        let [a, b, c] = mesh.corners(triangle).map(|p| p.as_dvec3());
        center += (a + b + c) * (vector.length() / 3.0);
        normal += if vector.dot(largest) < 0.0 { -vector } else { vector };
    }
    let unit = normal.normalize_or_zero();
    #[expect(clippy::cast_possible_truncation, reason = "areas are stored in f32")]
    let stored_area = area as f32;
    ((center / area).as_vec3(), unit.as_vec3(), stored_area)
}
