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
        if range.is_empty() {
            continue;
        }
        let indices: Vec<u32> = wood.triangles[range.clone()].iter().flatten().copied().collect();
        // each material keeps its share, and at least a triangle
        let share = (target * range.len()).div_ceil(total).max(1);
        let simplify = |count: usize| {
            let options = meshopt::SimplifyOptions::Prune;
            meshopt::simplify(&indices, &vertices, count * 3, TARGET_ERROR, options, None)
        };
        let mut count = share;
        let mut kept = simplify(count);
        // a few triangles may fold up or be pruned, and wood that is asked for must not vanish
        while kept.is_empty() && count < range.len() {
            // never more than there are: meshoptimizer ends the process
            count = (count * 2).min(range.len());
            kept = simplify(count);
        }
        let start = u32::try_from(mesh.triangles.len()).expect("fewer than before");
        mesh.triangles.extend(kept.chunks_exact(3).map(|corner| [corner[0], corner[1], corner[2]]));
        let end = u32::try_from(mesh.triangles.len()).expect("fewer than before");
        if end > start {
            mesh.parts.push(Part { material: part.material, triangles: start..end });
        }
    }
    mesh.without_unused_vertices()
}

#[cfg(test)]
mod tests {
    use glam::{Vec2, Vec3, Vec4};

    use super::*;
    use crate::job::Job;
    use crate::plant::{AlphaMode, Lighting, Material};
    use crate::texture::Sampler;

    /// A wavy closed tube of `2 * around * along` triangles, the second half of another material.
    fn tube(around: u32, along: u32) -> Mesh {
        let mut mesh = Mesh::default();
        for ring in 0..=along {
            for step in 0..around {
                let angle = step as f32 / around as f32 * std::f32::consts::TAU;
                let radius = 1.0 + 0.1 * libm::sinf(ring as f32 * 0.7);
                let (x, z) = (libm::cosf(angle) * radius, libm::sinf(angle) * radius);
                mesh.positions.push(Vec3::new(x, ring as f32 * 0.2, z));
                mesh.normals.push(Vec3::new(x, 0.0, z).normalize());
                mesh.uvs.push(Vec2::ZERO);
                mesh.base.push(Vec4::ONE);
            }
        }
        for ring in 0..along {
            for step in 0..around {
                let next = (step + 1) % around;
                let [a, b] = [ring * around + step, ring * around + next];
                mesh.triangles.extend([[a, b, b + around], [a, b + around, a + around]]);
            }
        }
        let half = mesh.triangles.len() / 2;
        let ids: Vec<u32> = (0..mesh.triangles.len()).map(|t| u32::from(t >= half)).collect();
        mesh.parts = Mesh::parts_from_ids(&ids);
        mesh
    }

    fn plant_of(wood: Mesh, leaves: Mesh, offsets: Vec<u32>) -> Plant {
        let material = Material {
            name: "bark".to_owned(),
            texture: None,
            sampler: Sampler::default(),
            alpha_mode: AlphaMode::Opaque,
            double_sided: false,
        };
        let materials = vec![material.clone(), material];
        let (name, lighting) = ("test".to_owned(), Lighting::default());
        Plant::new(
            name,
            glam::DVec3::ZERO,
            materials,
            wood,
            leaves,
            offsets,
            lighting,
            &Job::default(),
        )
        .expect("valid")
    }

    #[test]
    fn about_as_many_triangles_are_left_as_asked_for() {
        let plant = plant_of(tube(32, 40), Mesh::default(), vec![0]);
        assert_eq!(plant.wood.triangles.len(), 2560, "2 * 32 * 40");
        for target in [2000, 1000, 400, 200] {
            let mesh = Wood::Simplified(target).of(&plant).expect("valid");
            let found = mesh.triangles.len();
            // an edge takes two triangles with it, and each material stops by itself
            assert!(found.abs_diff(target) <= 6, "{found} for {target}");
            assert_eq!(mesh.parts.len(), 2, "both materials are left");
            let first = mesh.parts[0].triangles.len();
            assert!((first * 2).abs_diff(found) <= 6, "each keeps its share: {first} of {found}");
            mesh.check(2, &Job::default()).expect("consistent");
            assert!(mesh.positions.len() < found, "and only the vertices in use");
            assert!(mesh.front.iter().all(|c| plant.wood.front.contains(c)), "light is kept");
        }
        for target in 1..20 {
            let least = Wood::Simplified(target).of(&plant).expect("valid");
            assert!(!least.is_empty() && least.triangles.len() < 100, "{target}");
        }
        // pieces that hardly can be simplified, and a material without any triangle
        let mut few = tube(3, 1);
        few.parts.insert(1, Part { material: 0, triangles: 3..3 });
        let few = plant_of(few, Mesh::default(), vec![0]);
        for target in 1..6 {
            let least = Wood::Simplified(target).of(&few).expect("valid");
            assert!((1..=6).contains(&least.triangles.len()), "{target} of 6");
        }
    }

    #[test]
    fn all_or_none_of_it_is_left_alone() {
        let wood = plant_of(tube(8, 4), Mesh::default(), vec![0]);
        for all in [Wood::Full, Wood::Simplified(64), Wood::Simplified(usize::MAX)] {
            assert_eq!(all.of(&wood).expect("valid"), wood.wood, "{all:?}");
        }
        assert!(Wood::None.of(&wood).expect("valid").is_empty(), "none");
        let error = Wood::Simplified(0).of(&wood).expect_err("refused");
        assert!(error.to_string().starts_with("wood_triangle_count"), "{error}");
        let bare = plant_of(Mesh::default(), tube(3, 1), vec![0, 6]);
        assert!(Wood::Simplified(5).of(&bare).expect("valid").is_empty(), "nothing to simplify");
    }
}
