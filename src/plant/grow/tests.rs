//! Does every preset have its counts, sizes and shape, and does it stay the same?

use std::collections::HashMap;

use super::*;
use crate::plant::mesh::{area_normal, triangle_area};

/// What is known of a preset.
struct Facts {
    name: &'static str,
    /// Elements and triangles of the foliage, triangles of the wood.
    leaves: usize,
    leaf_triangles: usize,
    wood: usize,
    /// In metres, of the whole.
    heights: [f64; 2],
    widths: [f64; 2],
}

#[rustfmt::skip]
const FACTS: [Facts; 8] = [
    Facts { name: "chestnut", leaves: 11_291, leaf_triangles: 112_910, wood: 46_174,
        heights: [15.0, 18.0], widths: [11.0, 15.0] },
    Facts { name: "broadleaf", leaves: 20_376, leaf_triangles: 40_752, wood: 47_691,
        heights: [11.5, 14.0], widths: [7.5, 10.0] },
    Facts { name: "grove", leaves: 5_782 + 1_349, leaf_triangles: 11_564 + 8_093, wood: 2_054,
        heights: [6.5, 9.5], widths: [4.0, 7.0] },
    Facts { name: "pine", leaves: 80_000, leaf_triangles: 80_000, wood: 36_000,
        heights: [6.4, 7.8], widths: [3.2, 5.0] },
    Facts { name: "palm", leaves: 2_520, leaf_triangles: 20_160, wood: 3_012,
        heights: [7.0, 9.5], widths: [4.4, 6.6] },
    Facts { name: "sunflower", leaves: 581, leaf_triangles: 1_492, wood: 928,
        heights: [1.5, 2.1], widths: [0.55, 0.95] },
    Facts { name: "daisy", leaves: 1_438, leaf_triangles: 4_772, wood: 3_480,
        heights: [0.2, 0.36], widths: [0.15, 0.35] },
    Facts { name: "grass", leaves: 450, leaf_triangles: 4_050, wood: 0,
        heights: [0.35, 0.65], widths: [0.5, 1.0] },
];

/// Share by which the wood of another seed may differ: twigs are spaced until their triangles come
/// to the right number, but the nearest number of twigs is not always found. The wood of a grove has
/// no twigs, so that limbs and forks alone decide.
const WOOD_TOLERANCE: f64 = 0.01;
const GROVE_WOOD_TOLERANCE: f64 = 0.3;

fn grown(preset: &str, seed: u64, leaf_count: Option<usize>) -> Plant {
    grow(preset, seed, leaf_count, Lighting::default(), &Job::default()).expect("valid arguments")
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
    assert_eq!(FACTS.map(|facts| facts.name).to_vec(), preset_names().collect::<Vec<_>>(), "all");
    for Facts { name, leaves, leaf_triangles, wood, heights, widths } in FACTS {
        for seed in [0, 1, 2, u64::MAX] {
            let plant = grown(name, seed, None);
            assert_eq!(plant.foliage.leaf_count(), leaves, "{name} {seed}");
            assert_eq!(plant.foliage.mesh.triangles.len(), leaf_triangles, "{name} {seed}");
            let share = if name == "grove" { GROVE_WOOD_TOLERANCE } else { WOOD_TOLERANCE };
            let off = plant.wood.triangles.len().abs_diff(wood) as f64;
            let count = plant.wood.triangles.len();
            assert!(off <= share * wood as f64, "{name} {seed}: {count} triangles of wood");
            let (low, high) = plant.bounds();
            assert_eq!(low.y, 0.0, "{name} {seed} stands on the ground");
            let size = high - low;
            assert!((heights[0]..heights[1]).contains(&size.y), "{name} {seed}: {size}");
            for width in [size.x, size.z] {
                assert!((widths[0]..widths[1]).contains(&width), "{name} {seed}: {size}");
            }
        }
    }
}

#[test]
fn any_number_of_leaves_is_exact_and_leaves_the_wood_alone() {
    for preset in PRESETS {
        let name = preset.name();
        let (leaf_count, fixed) = preset.leaf_counts();
        let usual = grown(name, 3, None);
        for asked in [fixed + 1, fixed + 7, leaf_count - 1, leaf_count + 1, 100_000] {
            let plant = grown(name, 3, Some(asked));
            assert_eq!(plant.foliage.leaf_count(), asked, "{name}");
            assert!(plant.wood == usual.wood, "{name}: {asked} leaves changed the wood");
            assert!(plant.foliage.areas.iter().all(|&area| area > 0.0), "{name} {asked}");
        }
        let few = grow(name, 3, Some(fixed), Lighting::default(), &Job::default());
        let few = few.expect_err("no leaf of its own");
        let range = format!("leaf_count must be in [{}, 5000000], got {fixed}", fixed + 1);
        assert_eq!(few.to_string(), range, "{name}");
    }
}

/// Share of the leaf area by which 100,000 leaves may differ from the usual number: their sizes are
/// drawn anew. The fewest are the 450 blades of grass, whose areas vary by a quarter of their mean, so
/// that this is four standard errors.
const AREA_TOLERANCE: f64 = 0.05;

#[test]
fn more_leaves_than_usual_are_smaller() {
    let mut tested = Vec::new();
    for preset in PRESETS {
        // of a herb only the florets grow in number, and their size is that of the flower head
        if matches!(preset, Preset::Herb(_)) {
            continue;
        }
        let name = preset.name();
        let (_, fixed) = preset.leaf_counts();
        let of_leaves = |plant: &Plant| {
            let foliage = &plant.foliage;
            // twigs are foliage too, of five or six triangles each, and stay as they are
            let is_leaf = |leaf: usize| fixed == 0 || foliage.triangles_of(leaf).len() == 2;
            let leaves = (0..foliage.leaf_count()).filter(|&leaf| is_leaf(leaf));
            leaves.map(|leaf| f64::from(foliage.areas[leaf])).sum::<f64>()
        };
        let usual = of_leaves(&grown(name, 3, None));
        let share = of_leaves(&grown(name, 3, Some(100_000))) / usual;
        assert!((share - 1.0).abs() < AREA_TOLERANCE, "{name}: {share} of the area");
        tested.push(name);
    }
    assert_eq!(tested, ["chestnut", "broadleaf", "grove", "pine", "palm", "grass"], "all of them");
}

#[test]
fn the_same_bytes_on_any_thread_count_and_machine() {
    assert_eq!(FROZEN.map(|frozen| frozen.0).to_vec(), preset_names().collect::<Vec<_>>(), "all");
    for thread_count in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(thread_count).build();
        let hashes = pool
            .expect("pool")
            .install(|| FROZEN.map(|(preset, _)| (preset, hash(&grown(preset, 1, None)))));
        assert_eq!(hashes, FROZEN, "on {thread_count} threads");
    }
    for (preset, expected) in FROZEN {
        assert_ne!(hash(&grown(preset, 2, None)), expected, "{preset}: another seed");
    }
}

/// Hashes of seed 1; a change of a preset or of the generator changes them and is no error.
const FROZEN: [(&str, u64); 8] = [
    ("chestnut", 15_357_538_163_967_372_860),
    ("broadleaf", 8_011_302_081_397_872_515),
    ("grove", 4_448_787_528_151_443_184),
    ("pine", 13_459_961_852_682_191_496),
    ("palm", 4_040_161_656_896_958_765),
    ("sunflower", 12_516_157_764_384_210_120),
    ("daisy", 7_964_498_683_451_167_513),
    ("grass", 1_912_866_051_022_185_001),
];

#[test]
fn arguments_are_checked_before_anything_is_allocated() {
    let message = |preset, leaf_count| {
        let grown = grow(preset, 1, leaf_count, Lighting::default(), &Job::default());
        grown.expect_err("out of range").to_string()
    };
    let expected = r#"preset: there is no "oak"; there are chestnut, broadleaf, grove, pine, palm, sunflower, daisy, grass"#;
    assert_eq!(message("oak", None), expected, "unknown preset");
    let expected = "leaf_count must be in [1, 5000000], got 0";
    assert_eq!(message("chestnut", Some(0)), expected, "no leaf");
    let expected = format!("leaf_count must be in [1, 5000000], got {}", usize::MAX);
    assert_eq!(message("chestnut", Some(usize::MAX)), expected, "too many leaves");
    let dark = Lighting { translucency: 2.0, ..Lighting::default() };
    assert!(grow("chestnut", 1, None, dark, &Job::default()).is_err(), "translucency above 1");
}

#[test]
fn a_cancelled_job_grows_nothing() {
    let job = Job::default();
    job.cancel();
    for preset in preset_names() {
        let grown = grow(preset, 1, None, Lighting::default(), &job);
        assert_eq!(grown.err(), Some(LodError::Cancelled), "{preset}");
    }
}

#[test]
fn progress_counts_leaves() {
    for preset in PRESETS {
        let job = Job::default();
        let (count, fixed) = preset.leaf_counts();
        grow(preset.name(), 1, None, Lighting::default(), &job).expect("not cancelled");
        let steps = (count - fixed) as u64;
        assert_eq!(job.progress(), (steps, steps), "{}", preset.name());
    }
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

/// Presets that know their stems, grown.
fn structured(seed: u64) -> impl Iterator<Item = (Preset, Plant, Arc<Structure>)> {
    PRESETS.into_iter().filter_map(move |preset| {
        let plant = grown(preset.name(), seed, None);
        let structure = plant.structure.clone()?;
        Some((preset, plant, structure))
    })
}

/// Corners of a stem's rings; 0 if it is no wood.
fn sides_of(preset: Preset, level: u32) -> usize {
    match preset {
        Preset::Tree(species) if species.is_foliage(level as usize) => 0,
        Preset::Tree(species) => species.levels[level as usize].sides,
        Preset::Herb(herb) => herb.stems.sides,
        Preset::Tuft(_) => 0,
    }
}

#[test]
fn tubes_are_open_at_the_base_only() {
    for (preset, plant, structure) in structured(5) {
        for branch in &structure.branches {
            let range = branch.wood_triangles.start as usize..branch.wood_triangles.end as usize;
            let open = open_edge_count(&plant.wood.triangles[range]);
            assert_eq!(open, sides_of(preset, branch.level), "{}", preset.name());
        }
    }
}

/// Area of a triangle that is taken for flat, as a share of the square of the plant's diagonal:
/// a tenth of a millimetre squared for a tree.
const FLAT: f64 = 1e-10;

#[test]
fn no_triangle_is_flat_and_all_normals_are_units() {
    for preset in PRESETS {
        let name = preset.name();
        let plant = grown(name, 5, None);
        let (low, high) = plant.bounds();
        for mesh in [&plant.wood, &plant.foliage.mesh] {
            let areas = (0..mesh.triangles.len()).map(|t| triangle_area(mesh.corners(t)));
            let smallest = areas.fold(f64::INFINITY, f64::min);
            assert!(smallest > FLAT * low.distance_squared(high), "{name}: {smallest} m2");
            let unit = mesh.normals.iter().all(|normal| (normal.length() - 1.0).abs() < 1e-5);
            assert!(unit, "{name}: normals of unit length");
            for colors in [&mesh.front, &mesh.back] {
                let lit = colors.iter().all(|color| color.min_element() > 0.0 && color.is_finite());
                assert!(lit && colors.len() == mesh.positions.len(), "{name}: colours");
            }
        }
    }
}

#[test]
fn wood_faces_outwards() {
    // a closed surface has positive volume exactly if its triangles face outwards; the open
    // base is closed by measuring from the branch's start, which lies in the base's plane
    for (preset, plant, structure) in structured(1) {
        for branch in structure.branches.iter().filter(|branch| !branch.wood_triangles.is_empty()) {
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
            assert!(volume > 0.0, "{}: volume {volume}", preset.name());
        }
    }
}

#[test]
fn flower_heads_face_as_their_normals_do() {
    for (preset, plant, _) in structured(1) {
        if !matches!(preset, Preset::Herb(_)) {
            continue;
        }
        for (triangle, corners) in plant.wood.triangles.iter().enumerate() {
            let normal: DVec3 =
                corners.iter().map(|&v| plant.wood.normals[v as usize].as_dvec3()).sum();
            let facing = area_normal(plant.wood.corners(triangle)).dot(normal);
            assert!(facing > 0.0, "{}: triangle {triangle} faces inwards", preset.name());
        }
    }
}

#[test]
fn the_structure_covers_wood_and_leaves_in_order() {
    for (preset, plant, structure) in structured(1) {
        let leaf_count = plant.foliage.leaf_count();
        assert_eq!(structure.leaf_branches.len(), leaf_count, "{}", preset.name());
        let (mut next_triangle, mut next_leaf) = (0, 0);
        for (id, branch) in structure.branches.iter().enumerate() {
            assert_eq!(branch.wood_triangles.start, next_triangle, "branch {id}");
            assert_eq!(branch.leaves.start, next_leaf, "{}: branch {id}", preset.name());
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
        assert_eq!(next_leaf as usize, leaf_count, "all leaves");
        assert_eq!(structure.subtree(0), 0..structure.branches.len(), "all of it");
    }
}

#[test]
fn twigs_of_a_grove_are_foliage() {
    let (name, twig_triangles) = ("grove", 8_093);
    for seed in 0..20 {
        let plant = grown(name, seed, None);
        let counts: Vec<usize> = (0..plant.foliage.leaf_count())
            .map(|leaf| plant.foliage.triangles_of(leaf).len())
            .collect();
        let of = |size: usize| counts.iter().filter(|&&count| count == size).count();
        assert_eq!(of(2), 5_782, "{seed}: folded quads");
        assert_eq!(6 * of(6) + 5 * of(5), twig_triangles, "{seed}: twigs");
        let structure = plant.structure.as_deref().expect("trees know it");
        let twigs = structure.branches.iter().filter(|branch| branch.wood_triangles.is_empty());
        for twig in twigs {
            let first = plant.foliage.triangles_of(twig.leaves.start as usize).len();
            assert!(first >= 5, "{seed}: a twig comes before its leaves");
        }
    }
}

/// Distance of two points of foliage and wood that are taken for joined, as a share of the plant's
/// diagonal: a millimetre for a daisy, five for a sunflower.
const JOINED: f64 = 2.5e-3;

#[test]
fn no_part_of_a_herb_floats() {
    for (preset, plant, structure) in structured(1) {
        let Preset::Herb(herb) = preset else { continue };
        let (low, high) = plant.bounds();
        let limit = low.distance(high) * JOINED;
        for leaf in 0..plant.foliage.leaf_count() {
            let stem = &structure.branches[structure.leaf_branches[leaf] as usize];
            let foot = plant.foliage.mesh.triangles[plant.foliage.triangles_of(leaf).start][0];
            let foot = plant.foliage.mesh.positions[foot as usize].as_dvec3();
            let is_on_wood = stem.wood_triangles.clone().any(|t| {
                let corners = plant.wood.corners(t as usize).map(|corner| corner.as_dvec3());
                distance_to_triangle(foot, corners) < limit
            });
            assert!(is_on_wood, "{}: leaf {leaf} floats", herb.name);
        }
        for branch in &structure.branches[1..] {
            let start = branch.start.as_dvec3();
            let parent =
                &structure.branches[branch.parent.expect("only the trunk has none") as usize];
            let near = parent.wood_triangles.clone().any(|t| {
                let corners = plant.wood.corners(t as usize).map(|corner| corner.as_dvec3());
                distance_to_triangle(start, corners) < limit + f64::from(parent.radius)
            });
            assert!(near, "{}: a stem begins in the air", herb.name);
        }
    }
}

fn distance_to_triangle(point: DVec3, corners: [DVec3; 3]) -> f64 {
    let [a, b, c] = corners;
    let normal = (b - a).cross(c - a);
    let edges = [(a, b), (b, c), (c, a)];
    if edges.iter().all(|&(from, to)| (to - from).cross(point - from).dot(normal) >= 0.0) {
        return ((point - a).dot(normal) / normal.length()).abs();
    }
    let to_edge = |&(from, to): &(DVec3, DVec3)| {
        let t = (point - from).dot(to - from) / from.distance_squared(to);
        point.distance(from.lerp(to, t.clamp(0.0, 1.0)))
    };
    edges.iter().map(to_edge).fold(f64::INFINITY, f64::min)
}
