//! Vertex normals for files that bring none: the sum of the area normals of the triangles that
//! meet at a position, so that the seams of a texture do not show as creases.
//!
//! Sums run in f64 in triangle order: the same bytes on any number of threads.

use glam::{DVec3, Vec3};

use crate::error::LodError;
use crate::plant::mesh::area_normal;
use crate::plant::weld::weld;

/// Unit normals, one a vertex; zero where the triangles cancel, have no area, or do not exist.
///
/// # Errors
/// [`LodError::Invalid`] if a corner is no vertex.
pub fn smooth(positions: &[Vec3], triangles: &[[u32; 3]]) -> Result<Vec<Vec3>, LodError> {
    let beyond = |corners: &[u32; 3]| corners.iter().any(|&v| v as usize >= positions.len());
    if let Some(triangle) = triangles.iter().position(beyond) {
        let why = format!("triangle {triangle} has a corner beyond {} vertices", positions.len());
        return Err(LodError::Invalid { name: "triangles", why });
    }
    let (ids, count) = weld(positions);
    let mut sums = vec![DVec3::ZERO; count as usize];
    for corners in triangles {
        let normal = area_normal(corners.map(|v| positions[v as usize]));
        for vertex in corners {
            sums[ids[*vertex as usize] as usize] += normal;
        }
    }
    let units: Vec<Vec3> = sums.into_iter().map(|sum| sum.normalize_or_zero().as_vec3()).collect();
    Ok(ids.into_iter().map(|id| units[id as usize]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn larger_triangles_weigh_more_across_a_seam() {
        //  2          the fold 0-1 is stored twice: vertices 0, 1 and 3, 4
        //  |\         triangle 0 lies in z = 0, area 1.5; triangle 1 in y = 0, area 2
        //  0-1/3-4
        let o = Vec3::ZERO;
        let positions = [o, Vec3::X, Vec3::Y * 3.0, Vec3::X, o, Vec3::Z * 4.0];
        let normals = smooth(&positions, &[[0, 1, 2], [3, 4, 5]]).expect("valid");
        // area normals (0, 0, 1.5) and (0, 2, 0); their sum has length 2.5
        let fold = Vec3::new(0.0, 0.8, 0.6);
        assert_eq!(normals[0], fold, "both triangles meet at 0");
        assert_eq!(normals[4], fold, "and at its twin");
        assert_eq!(normals[2], Vec3::Z, "triangle 0 alone");
        assert_eq!(normals[5], Vec3::Y, "triangle 1 alone");
    }

    #[test]
    fn no_area_gives_no_normal() {
        let positions = [Vec3::ZERO, Vec3::X, Vec3::X * 2.0, Vec3::Y];
        let normals = smooth(&positions, &[[0, 1, 2], [0, 1, 3], [0, 3, 1]]).expect("valid");
        assert_eq!(normals, [Vec3::ZERO; 4], "collinear, or cancelling");
        assert!(smooth(&positions, &[[0, 1, 4]]).is_err(), "there is no vertex 4");
    }
}
