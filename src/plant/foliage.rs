//! The sparse part of a plant: a mesh cut into leaves, with each leaf's centre, normal and area.
//!
//! A leaf is a contiguous range of triangles: a blade, a card, a needle, a twig. Its centre is the
//! area-weighted centroid of its triangles (the mean of its vertices if it has no area), its normal
//! the area-weighted mean of its triangles' normals with signs aligned to the largest triangle's
//! (zero if it has no area), its area their sum.

use std::ops::Range;

use crate::error::LodError;
use crate::job::Job;
use crate::plant::mesh::{Mesh, area_normal};
use glam::{DVec3, Vec3};

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
    /// rises at every step (a leaf has at least one triangle); [`LodError::Cancelled`].
    pub fn new(mesh: Mesh, leaf_offsets: Vec<u32>, job: &Job) -> Result<Self, LodError> {
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
        let measured: Vec<(Vec3, Vec3, f32)> = job.collect(leaf_offsets.len() - 1, |leaf| {
            measure(&mesh, leaf_offsets[leaf] as usize..leaf_offsets[leaf + 1] as usize)
        })?;
        let centers = job.collect(measured.len(), |leaf| measured[leaf].0)?;
        let normals = job.collect(measured.len(), |leaf| measured[leaf].1)?;
        let areas = job.collect(measured.len(), |leaf| measured[leaf].2)?;
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

#[cfg(test)]
mod tests {
    use glam::{Vec2, Vec4};

    use super::*;

    fn foliage(positions: &[Vec3], triangles: &[[u32; 3]], offsets: &[u32]) -> Foliage {
        let count = positions.len();
        let mesh = Mesh {
            positions: positions.to_vec(),
            normals: vec![Vec3::Y; count],
            uvs: vec![Vec2::ZERO; count],
            base: vec![Vec4::ONE; count],
            front: vec![Vec3::ZERO; count],
            back: vec![Vec3::ZERO; count],
            triangles: triangles.to_vec(),
            parts: Mesh::parts_from_ids(&vec![0; triangles.len()]),
        };
        Foliage::new(mesh, offsets.to_vec(), &Job::default()).expect("valid")
    }

    #[test]
    fn centre_and_normal_are_weighted_by_area() {
        //  2         triangle 0: area 2, centroid (2/3, 2/3, 0), normal z
        //  |\        triangle 1: area 1, centroid (2/3, 0, 1/3), normal y
        //  0-1  3 is at z = 1
        let positions = [Vec3::ZERO, Vec3::X * 2.0, Vec3::Y * 2.0, Vec3::Z];
        let leaves = foliage(&positions, &[[0, 1, 2], [0, 3, 1]], &[0, 2]);
        assert_eq!(leaves.leaf_count(), 1, "one leaf");
        assert_eq!(leaves.areas, [3.0], "2 + 1");
        let center = DVec3::new(2.0 / 3.0, 4.0 / 9.0, 1.0 / 9.0).as_vec3();
        assert!(leaves.centers[0].abs_diff_eq(center, 1e-7), "{}", leaves.centers[0]);
        let normal = DVec3::new(0.0, 1.0, 2.0).normalize().as_vec3();
        assert!(leaves.normals[0].abs_diff_eq(normal, 1e-7), "{}", leaves.normals[0]);
    }

    #[test]
    fn opposite_triangles_do_not_cancel() {
        // two halves of a square, wound against each other; the larger one gives the sign
        let positions = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::new(2.0, 2.0, 0.0)];
        let leaves = foliage(&positions, &[[0, 1, 2], [1, 2, 3]], &[0, 2]);
        assert_eq!(leaves.areas, [2.0], "0.5 + 1.5");
        assert_eq!(leaves.normals, [-Vec3::Z], "triangle 1 is larger and faces -z");
        let twin = foliage(&positions, &[[0, 1, 2], [0, 2, 1]], &[0, 2]);
        assert_eq!(twin.normals, [Vec3::Z], "equally large: the first gives the sign");
        assert_eq!(twin.areas, [1.0], "both faces count");
    }

    #[test]
    fn a_leaf_without_area_has_a_centre() {
        let positions = [Vec3::ZERO, Vec3::X, Vec3::X * 5.0];
        let leaves = foliage(&positions, &[[0, 1, 2], [0, 0, 0]], &[0, 1, 2]);
        assert_eq!(leaves.centers, [Vec3::X * 2.0, Vec3::ZERO], "mean of the corners");
        assert_eq!(leaves.normals, [Vec3::ZERO; 2], "no normal");
        assert_eq!(leaves.areas, [0.0; 2], "no area");
    }

    #[test]
    fn offsets_must_cover_the_triangles() {
        let mesh = foliage(&[Vec3::ZERO, Vec3::X, Vec3::Y], &[[0, 1, 2]; 3], &[0, 1, 3]).mesh;
        for offsets in [&[][..], &[0], &[0, 2], &[1, 3], &[0, 1, 1, 3], &[0, 2, 1, 3], &[0, 4]] {
            let result = Foliage::new(mesh.clone(), offsets.to_vec(), &Job::default());
            assert!(result.is_err(), "{offsets:?}");
        }
        let leaves = Foliage::new(mesh, vec![0, 1, 3], &Job::default()).expect("valid");
        assert_eq!(leaves.triangles_of(1), 1..3, "the second leaf");
        let none = Foliage::new(Mesh::default(), vec![0], &Job::default()).expect("valid");
        assert_eq!(none.leaf_count(), 0, "no leaves at all");
    }
}
