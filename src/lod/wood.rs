//! The wood of any technique: all of it, fewer triangles of it, or none.
//!
//! meshoptimizer simplifies each material's share of the wood; loose pieces that fall below the error
//! are pruned. The count it stops at may miss the target where the surface allows no further step.

use crate::error::LodError;
use crate::plant::{Mesh, Part, Plant};

/// Which wood a representation carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wood {
    /// None.
    None,
    /// As it is.
    Full,
    /// Simplified to about this many triangles.
    Simplified(usize),
}

impl Wood {
    /// The wood of a plant as asked for.
    ///
    /// # Errors
    /// `wood_triangle_count` of 0: leave the wood out instead.
    pub fn of(self, plant: &Plant) -> Result<Mesh, LodError> {
        match self {
            Self::None => Ok(Mesh::default()),
            Self::Full => Ok(plant.wood.clone()),
            Self::Simplified(0) => Err(LodError::OutOfRange {
                name: "wood_triangle_count",
                value: "0".to_owned(),
                range: "1 and above; wood=False leaves it out".to_owned(),
            }),
            Self::Simplified(target) if target >= plant.wood.triangles.len() => {
                Ok(plant.wood.clone())
            }
            Self::Simplified(target) => Ok(simplified(&plant.wood, target)),
        }
    }
}

/// Any error is allowed: the target decides.
const TARGET_ERROR: f32 = 1.0;

fn simplified(wood: &Mesh, target: usize) -> Mesh {
    let mut mesh = Mesh { triangles: Vec::new(), parts: Vec::new(), ..wood.clone() };
    let total = wood.triangles.len();
    let positions: Vec<[f32; 3]> = wood.positions.iter().map(|p| p.to_array()).collect();
    let bytes = bytemuck::cast_slice(&positions);
    let vertices = meshopt::VertexDataAdapter::new(bytes, size_of::<[f32; 3]>(), 0)
        .expect("whole vertices of three floats");
    for part in &wood.parts {
        let range = part.triangles.start as usize..part.triangles.end as usize;
        let indices: Vec<u32> = wood.triangles[range.clone()].iter().flatten().copied().collect();
        // each material keeps its share, and at least a triangle
        let share = (target * range.len()).div_ceil(total).max(1);
        let kept = meshopt::simplify(
            &indices,
            &vertices,
            share * 3,
            TARGET_ERROR,
            meshopt::SimplifyOptions::Prune,
            None,
        );
        let start = u32::try_from(mesh.triangles.len()).expect("fewer than before");
        mesh.triangles.extend(kept.chunks_exact(3).map(|corner| [corner[0], corner[1], corner[2]]));
        let end = u32::try_from(mesh.triangles.len()).expect("fewer than before");
        if end > start {
            mesh.parts.push(Part { material: part.material, triangles: start..end });
        }
    }
    mesh.without_unused_vertices()
}
