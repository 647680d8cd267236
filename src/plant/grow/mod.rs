//! Procedural plants: a preset, a seed, and a tree that is the same on every machine.
//!
//! Stems first, then the wood around them, then the leaves on the twigs. Everything is in metres, y
//! up, with the trunk's foot on the ground at the origin. The wood depends on the preset and the
//! seed only; the number of leaves is exact, whatever is asked for. Up to the preset's own number,
//! leaves keep their size; more of them are smaller, so that leaf area and gaps stay.
//! The presets take about 50 ms each on two cores; a million chestnut leaves 4 s and 1.4 GB.
//!
//! This work is based on:
//! Jason Weber, Joseph Penn. Creation and Rendering of Realistic Trees. 1995

mod leaves;
mod params;
mod presets;
mod skeleton;
mod tube;
mod turn;

use std::sync::Arc;

use glam::DVec3;

use crate::error::{LodError, check_in, check_limit};
use crate::plant::grow::presets::PRESETS;
use crate::plant::grow::skeleton::Stem;
use crate::plant::mesh::MAX_ELEMENT_COUNT;
use crate::plant::{AlphaMode, Branch, Lighting, Material, Part, Plant, Structure};
use crate::texture::Sampler;

/// Most leaves of a grown plant: 7 GB while ten triangles a leaf are grown.
pub const MAX_LEAF_COUNT: usize = 5_000_000;

/// Names that [`grow`] takes.
pub fn preset_names() -> impl Iterator<Item = &'static str> {
    PRESETS.iter().map(|species| species.name)
}

/// Grows a plant of a preset, with the preset's own number of leaves unless another is asked for.
///
/// # Errors
/// [`LodError::Invalid`] for an unknown preset; [`LodError::OutOfRange`] unless
/// `1 <= leaf_count <= MAX_LEAF_COUNT`; whatever [`Lighting::check`] refuses.
pub fn grow(
    preset: &str,
    seed: u64,
    leaf_count: Option<usize>,
    lighting: Lighting,
) -> Result<Plant, LodError> {
    let Some(species) = PRESETS.iter().find(|species| species.name == preset) else {
        let known = preset_names().collect::<Vec<_>>().join(", ");
        let why = format!("there is no {preset:?}; there are {known}");
        return Err(LodError::Invalid { name: "preset", why });
    };
    let leaf_count = leaf_count.unwrap_or(species.leaves.count);
    check_in("leaf_count", leaf_count, 1..=MAX_LEAF_COUNT)?;
    let blade = species.leaves.blade;
    let widest = blade.vertices.len().max(blade.triangles.len());
    check_limit("leaf_count", leaf_count as u64 * widest as u64, MAX_ELEMENT_COUNT, "vertices")?;
    lighting.check()?;

    let stems = skeleton::grow_stems(species, seed);
    let (mut wood, wood_ranges) = tube::wood(species, seed, &stems);
    let (mut leaves, leaf_branches) = leaves::leaves(species, seed, &stems, leaf_count);
    let count = |triangles: &[[u32; 3]]| u32::try_from(triangles.len()).expect("checked above");
    wood.parts = vec![Part { material: 0, triangles: 0..count(&wood.triangles) }];
    leaves.parts = vec![Part { material: 1, triangles: 0..count(&leaves.triangles) }];
    let per_leaf = blade.triangles.len();
    let leaf_offsets = (0..=leaf_count)
        .map(|leaf| u32::try_from(leaf * per_leaf).expect("checked above"))
        .collect();

    let branches = branches(&stems, wood_ranges, &leaf_branches);
    let materials = vec![material("wood", false), material("leaves", true)];
    let name = preset.to_owned();
    let mut plant = Plant::new(name, DVec3::ZERO, materials, wood, leaves, leaf_offsets, lighting)?;
    plant.structure = Some(Arc::new(Structure { branches, leaf_branches }));
    Ok(plant)
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
fn branches(
    stems: &[Stem],
    wood_ranges: Vec<std::ops::Range<u32>>,
    leaf_branches: &[u32],
) -> Vec<Branch> {
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

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;
    use crate::plant::Mesh;
    use crate::plant::mesh::triangle_area;

    /// Name, leaves, triangles a leaf, wood triangles, height and width of the whole in metres.
    type Facts = (&'static str, usize, usize, usize, [f64; 2], [f64; 2]);

    const FACTS: [Facts; 2] = [
        ("chestnut", 11_291, 10, 46_174, [15.0, 18.0], [11.0, 15.0]),
        ("broadleaf", 20_376, 2, 47_691, [11.5, 14.0], [7.5, 10.0]),
    ];

    fn grown(preset: &str, seed: u64, leaf_count: Option<usize>) -> Plant {
        grow(preset, seed, leaf_count, Lighting::default()).expect("valid arguments")
    }

    /// FNV-1a over everything that is grown; light is not.
    fn hash(plant: &Plant) -> u64 {
        let mut hash = 0xCBF2_9CE4_8422_2325_u64;
        for mesh in [&plant.wood, &plant.foliage.mesh] {
            let arrays: [&[u8]; 5] = [
                bytemuck::cast_slice(&mesh.positions),
                bytemuck::cast_slice(&mesh.normals),
                bytemuck::cast_slice(&mesh.uvs),
                bytemuck::cast_slice(&mesh.base),
                bytemuck::cast_slice(&mesh.triangles),
            ];
            for byte in arrays.into_iter().flatten() {
                hash = (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01B3);
            }
        }
        hash
    }

    #[test]
    fn counts_and_sizes_are_those_of_the_preset() {
        for (preset, leaf_count, per_leaf, wood_count, heights, widths) in FACTS {
            for seed in [0, 1, 2, u64::MAX] {
                let plant = grown(preset, seed, None);
                assert_eq!(plant.foliage.leaf_count(), leaf_count, "{preset} {seed}");
                let triangle_count = plant.foliage.mesh.triangles.len();
                assert_eq!(triangle_count, leaf_count * per_leaf, "{preset} {seed}");
                let wood = plant.wood.triangles.len();
                // the nearest number of twigs is not always found
                assert!(wood.abs_diff(wood_count) <= wood_count / 100, "{preset} {seed}: {wood}");
                let (low, high) = plant.bounds();
                assert_eq!(low.y, 0.0, "{preset} {seed} stands on the ground");
                let size = high - low;
                assert!((heights[0]..heights[1]).contains(&size.y), "{preset} {seed}: {size}");
                for width in [size.x, size.z] {
                    assert!((widths[0]..widths[1]).contains(&width), "{preset} {seed}: {size}");
                }
            }
        }
    }

    #[test]
    fn any_number_of_leaves_is_exact_and_leaves_the_wood_alone() {
        for (preset, leaf_count, ..) in FACTS {
            let usual = grown(preset, 3, None);
            for asked in [1, 7, leaf_count - 1, leaf_count + 1, 100_000] {
                let plant = grown(preset, 3, Some(asked));
                assert_eq!(plant.foliage.leaf_count(), asked, "{preset}");
                assert!(plant.wood == usual.wood, "{preset}: {asked} leaves changed the wood");
                assert!(plant.foliage.areas.iter().all(|&area| area > 0.0), "{preset} {asked}");
            }
            let many = grown(preset, 3, Some(100_000)).foliage.mesh.area();
            let share = many / usual.foliage.mesh.area();
            assert!((share - 1.0).abs() < 0.02, "{preset}: {share} of the leaf area");
        }
    }

    #[test]
    fn the_same_bytes_on_any_thread_count_and_machine() {
        for (preset, expected) in FROZEN {
            for thread_count in [1, 3] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(thread_count).build();
                let plant = pool.expect("pool").install(|| grown(preset, 1, None));
                assert_eq!(hash(&plant), expected, "{preset} on {thread_count} threads");
            }
            assert_ne!(hash(&grown(preset, 2, None)), expected, "{preset}: another seed");
        }
    }

    /// Hashes of seed 1; a change of a preset or of the generator changes them and is no error.
    const FROZEN: [(&str, u64); 2] =
        [("chestnut", 15_357_538_163_967_372_860), ("broadleaf", 8_011_302_081_397_872_515)];

    #[test]
    fn arguments_are_checked_before_anything_is_allocated() {
        let message = |preset, leaf_count| {
            let grown = grow(preset, 1, leaf_count, Lighting::default());
            grown.expect_err("out of range").to_string()
        };
        let expected = r#"preset: there is no "oak"; there are chestnut, broadleaf"#;
        assert_eq!(message("oak", None), expected, "unknown preset");
        let expected = "leaf_count must be in [1, 5000000], got 0";
        assert_eq!(message("chestnut", Some(0)), expected, "no leaf");
        let expected = format!("leaf_count must be in [1, 5000000], got {}", usize::MAX);
        assert_eq!(message("chestnut", Some(usize::MAX)), expected, "too many leaves");
        let dark = Lighting { translucency: 2.0, ..Lighting::default() };
        assert!(grow("chestnut", 1, None, dark).is_err(), "translucency above 1");
    }

    /// Edges that only one triangle has, out of some triangles.
    fn open_edge_count(triangles: &[[u32; 3]]) -> usize {
        let mut uses: HashMap<[u32; 2], u32> = HashMap::new();
        for &[a, b, c] in triangles {
            for [from, to] in [[a, b], [b, c], [c, a]] {
                *uses.entry([from.min(to), from.max(to)]).or_default() += 1;
            }
        }
        assert!(uses.values().all(|&count| count <= 2), "an edge of three triangles");
        uses.values().filter(|&&count| count == 1).count()
    }

    #[test]
    fn tubes_are_open_at_the_base_only() {
        for species in PRESETS {
            let plant = grown(species.name, 5, None);
            let structure = plant.structure.as_deref().expect("grown plants know it");
            let wood = &plant.wood;
            for branch in &structure.branches {
                let range =
                    branch.wood_triangles.start as usize..branch.wood_triangles.end as usize;
                let sides = species.levels[branch.level as usize].sides;
                assert_eq!(open_edge_count(&wood.triangles[range]), sides, "{}", species.name);
            }
            let flat = |mesh: &Mesh| {
                let areas = (0..mesh.triangles.len()).map(|t| triangle_area(mesh.corners(t)));
                areas.filter(|&area| area < 1e-7).count()
            };
            assert_eq!(flat(wood), 0, "{}: flat triangles of wood", species.name);
            assert_eq!(flat(&plant.foliage.mesh), 0, "{}: flat triangles of leaves", species.name);
            for mesh in [wood, &plant.foliage.mesh] {
                let unit = mesh.normals.iter().all(|normal| (normal.length() - 1.0).abs() < 1e-5);
                assert!(unit, "{}: normals of unit length", species.name);
            }
        }
    }

    #[test]
    fn wood_faces_outwards() {
        // a closed surface has positive volume exactly if its triangles face outwards; the open
        // base is closed by measuring from the branch's start, which lies in the base's plane
        for species in PRESETS {
            let plant = grown(species.name, 1, None);
            let structure = plant.structure.as_deref().expect("grown plants know it");
            for branch in &structure.branches {
                let start = branch.start.as_dvec3();
                let volume: f64 = branch
                    .wood_triangles
                    .clone()
                    .map(|triangle| {
                        let corners = plant.wood.corners(triangle as usize);
                        let [a, b, c] = corners.map(|corner| corner.as_dvec3() - start);
                        a.dot(b.cross(c)) / 6.0
                    })
                    .sum();
                assert!(volume > 0.0, "{}: volume {volume}", species.name);
            }
        }
    }

    #[test]
    fn the_structure_covers_wood_and_leaves_in_order() {
        for species in PRESETS {
            let plant = grown(species.name, 1, None);
            let structure = plant.structure.as_deref().expect("grown plants know it");
            assert_eq!(structure.leaf_branches.len(), species.leaves.count, "{}", species.name);
            let (mut next_triangle, mut next_leaf) = (0, 0);
            for (id, branch) in structure.branches.iter().enumerate() {
                assert_eq!(branch.wood_triangles.start, next_triangle, "branch {id}");
                assert_eq!(branch.leaves.start, next_leaf, "branch {id}");
                (next_triangle, next_leaf) = (branch.wood_triangles.end, branch.leaves.end);
                for leaf in branch.leaves.clone() {
                    assert_eq!(structure.leaf_branches[leaf as usize] as usize, id, "leaf {leaf}");
                }
                let parent = branch.parent.map(|parent| &structure.branches[parent as usize]);
                match parent {
                    None => assert_eq!((id, branch.level), (0, 0), "one trunk"),
                    Some(parent) => {
                        let risen = branch.level - parent.level;
                        assert!(risen == 1 || risen == 0 && branch.level < 2, "branch {id}");
                    }
                }
            }
            assert_eq!(next_triangle as usize, plant.wood.triangles.len(), "all wood");
            assert_eq!(next_leaf as usize, plant.foliage.leaf_count(), "all leaves");
            assert_eq!(structure.subtree(0), 0..structure.branches.len(), "all of it");
        }
    }
}
