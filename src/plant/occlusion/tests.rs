//! Does what a vertex sees agree with Beer and Lambert, and with rays against the triangles?

use glam::{Vec2, Vec4};

use super::*;
use crate::plant::AlphaMode;
use crate::random::{Purpose, Stream};
use crate::texture::{Image, Sampler, Texture};

fn mesh(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Mesh {
    let count = positions.len();
    Mesh {
        normals: vec![Vec3::Y; count],
        uvs: vec![Vec2::ZERO; count],
        base: vec![Vec4::ONE; count],
        front: vec![Vec3::ZERO; count],
        back: vec![Vec3::ZERO; count],
        parts: Mesh::parts_from_ids(&vec![0; triangles.len()]),
        positions,
        triangles,
    }
}

/// Level squares of two triangles, each a leaf.
fn squares(centers: &[Vec3], half: f32) -> Foliage {
    let corners = [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]];
    let positions: Vec<Vec3> = centers
        .iter()
        .flat_map(|&c| corners.map(|[x, z]| c + Vec3::new(x * half, 0.0, z * half)))
        .collect();
    let count = u32::try_from(centers.len()).expect("few");
    let triangles =
        (0..count).flat_map(|i| [[4 * i, 4 * i + 1, 4 * i + 2], [4 * i, 4 * i + 2, 4 * i + 3]]);
    let offsets = (0..=count).map(|leaf| 2 * leaf).collect();
    Foliage::new(mesh(positions, triangles.collect()), offsets, &Job::default()).expect("valid")
}

fn opaque() -> Vec<Material> {
    vec![Material {
        name: "leaf".to_owned(),
        texture: None,
        sampler: Sampler::default(),
        alpha_mode: AlphaMode::Opaque,
        double_sided: true,
    }]
}

fn leaves_see(foliage: &Foliage) -> Vec<Seen> {
    let [_, seen] = seen(&Mesh::default(), foliage, &opaque(), &Job::default()).expect("valid");
    seen
}

#[test]
fn depths_add_up_along_a_path() {
    let grid = Grid { low: DVec3::ZERO, edge: 1.0, sides: [5, 9, 5], depths: vec![0.125; 225] };
    let up = Path::new(DVec3::Y, &grid);
    // of nine cubes the first two are left out
    assert_eq!(grid.transmittance([2, 0, 2], &up), libm::exp(-7.0 * 0.125), "from the bottom");
    assert_eq!(grid.transmittance([2, 8, 2], &up), 1.0, "from the top");
    assert_eq!(grid.transmittance([2, 0, 2], &Path::new(-DVec3::Y, &grid)), 1.0, "downwards");
}

#[test]
fn paths_pass_the_cubes_that_they_name() {
    const ROUNDING: f64 = 1e-5; // lengths are f32
    for direction in directions() {
        let steps = steps(direction, 40);
        // where the first step begins: behind the neighbours, at an exit of the inner cubes
        let begins = 1.5 / direction.abs().max_element();
        let mut at = begins;
        for step in &steps {
            let length = f64::from(step.length);
            let middle = DVec3::splat(0.5) + direction * (at + length / 2.0);
            let cell = middle.floor().to_array();
            if length > 2.0 * ROUNDING {
                assert_eq!(step.offset.map(f64::from), cell, "{direction} at {at}");
            }
            at += length;
        }
        let along =
            steps.last().map_or(0, |step| step.offset.map(i32::abs).into_iter().max().unwrap_or(0));
        assert_eq!(along, 39, "{direction}: as far as it should");
    }
}

/// How far means over the 64 directions may be from those over all: directions at random would
/// be off by 0.04 (of a cosine) to 0.12 (of their sum).
const EVEN_TOLERANCE: f64 = 0.01;

#[test]
fn directions_are_even() {
    let directions = directions();
    let up = directions.iter().filter(|direction| direction.y > 0.0).count();
    assert_eq!((directions.len(), up), (DIRECTIONS, DIRECTIONS / 2), "half of them upwards");
    assert!(directions.is_sorted_by(|a, b| a.y > b.y), "those first");
    let mean = directions.iter().sum::<DVec3>() / DIRECTIONS as f64;
    assert!(mean.length() < EVEN_TOLERANCE, "balanced: {mean}");
    for normal in [DVec3::X, DVec3::Y, DVec3::new(0.6, 0.0, -0.8)] {
        let cosines: f64 = directions.iter().map(|d| d.dot(normal).max(0.0)).sum();
        assert!((cosines / DIRECTIONS as f64 - 0.25).abs() < EVEN_TOLERANCE, "{normal}: a quarter");
    }
}

/// Areas are sums of depths that are f32.
const AREA_TOLERANCE: f64 = 1e-5;

/// Area that may be off of the 6 m2 that a texture leaves: what it cuts out of a triangle is looked up
/// at a grid of points, of which those on the border of two texels fall to one side.
const CUT_TOLERANCE: f64 = 0.01;

#[test]
fn all_area_is_in_the_grid_but_what_a_texture_cuts_out() {
    let foliage = squares(&[Vec3::ZERO, Vec3::new(9.0, 4.0, -3.0), Vec3::new(2.0, 9.5, 1.0)], 1.0);
    let deposited = |materials: &[Material], mesh: &Mesh| {
        let mut grid = Grid::around([mesh, &Mesh::default()]).expect("it has a size");
        grid.add(mesh, SHEET_SHARE, materials, &Job::default()).expect("not cancelled");
        let sum: f64 = grid.depths.iter().map(|&depth| f64::from(depth)).sum();
        sum * grid.edge * grid.edge / SHEET_SHARE
    };
    let area = deposited(&opaque(), &foliage.mesh);
    assert!((area - 12.0).abs() < AREA_TOLERANCE, "three squares of 4: {area}");
    // the right half of the texture is empty
    let texels = vec![[255; 4], [255, 255, 255, 0]];
    let texture = Texture::new(vec![Image::new(2, 1, texels).expect("2 x 1")]).expect("a level");
    let alpha_mode = AlphaMode::Mask { cutoff: 0.5 };
    let masked = [Material { texture: Some(texture), alpha_mode, ..opaque().swap_remove(0) }];
    let mut mesh = foliage.mesh.clone();
    for (vertex, uv) in mesh.uvs.iter_mut().enumerate() {
        *uv = Vec2::new(if vertex % 4 < 2 { 0.0 } else { 1.0 }, 0.5);
    }
    let half = deposited(&masked, &mesh);
    assert!((half - 6.0).abs() < CUT_TOLERANCE, "half of it: {half}");
}

/// Share of the sky that may be seen through the roof: its twelve layers, of a leaf area of 1 and a
/// mean projection of one half each, let `e^-6` or 0.0025 through straight up, and level directions
/// less; this leaves room for those that pass below the rim.
const THROUGH_THE_ROOF: f32 = 0.1;

/// Share that must be seen of a half of the world without leaves: some directions that are nearly
/// level pass through cubes that hold leaves of the vertex's own height.
const ALMOST_ALL: f32 = 0.95;

#[test]
fn under_a_roof_there_is_no_sky_and_all_the_ground() {
    // twelve layers of a floor of squares, and one leaf below in the middle
    let layer = |y: f32| (0..400).map(move |i| Vec3::new((i % 20) as f32, y, (i / 20) as f32));
    let mut centers: Vec<Vec3> = (0..12).flat_map(|k| layer(10.0 + 0.5 * k as f32)).collect();
    centers.push(Vec3::new(9.5, 8.0, 9.5));
    let foliage = squares(&centers, 0.5);
    let seen = leaves_see(&foliage);
    let below = seen[seen.len() - 1];
    assert!(below.front[0] < THROUGH_THE_ROOF, "no sky above: {below:?}");
    assert!(below.back[1] > ALMOST_ALL, "all the ground below: {below:?}");
    // the roof's upper side sees all of the sky, also at its rim
    let top = seen[11 * 400 * 4 + 4 * 210];
    assert!(top.front[0] > ALMOST_ALL, "all the sky: {top:?}");
    assert_eq!((top.front[1], top.back[0]), (1.0, 1.0), "a level side sees one of the two");
}

#[test]
fn small_leaves_far_apart_see_everything() {
    let ends = [Vec3::ZERO, Vec3::splat(10.0)];
    for seen in leaves_see(&squares(&ends, 0.05)) {
        for share in seen.front.into_iter().chain(seen.back) {
            assert!((0.99..=1.0).contains(&share), "{seen:?}");
        }
    }
}

#[test]
fn a_plant_without_a_size_sees_everything() {
    let point = mesh(vec![Vec3::ONE; 3], vec![[0, 1, 2]]);
    let foliage = Foliage::new(point, vec![0, 1], &Job::default()).expect("valid");
    assert_eq!(leaves_see(&foliage), [Seen::ALL; 3], "one point");
    let tiny = squares(&[Vec3::ZERO, Vec3::splat(1e-30)], 1e-31);
    assert!(leaves_see(&tiny).iter().all(|seen| seen.front[0].is_finite()), "10^-30 m");
}

const CLOUD: Purpose = Purpose::named("test.cloud");

/// Triangles at random places in a ball, turned at random.
fn cloud(count: u32) -> Foliage {
    let mut stream = Stream::new(1, CLOUD, 0);
    let mut anywhere = || loop {
        let point = DVec3::new(stream.signed(), stream.signed(), stream.signed());
        if (1e-3..1.0).contains(&point.length_squared()) {
            return point;
        }
    };
    let mut positions = Vec::new();
    for _ in 0..count {
        let center = anywhere();
        let normal = anywhere().normalize();
        let side = normal.any_orthonormal_vector();
        for corner in [side, normal.cross(side), -side] {
            positions.push((center + corner * 0.04).as_vec3());
        }
    }
    let triangles = (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    Foliage::new(mesh(positions, triangles), (0..=count).collect(), &Job::default()).expect("valid")
}

/// Mean difference allowed between the cloud and rays against its triangles. A cube and its
/// neighbours are left out, 0.05 of the ball's radius, and 64 rays a leaf are 1,280 in all, of which
/// a share of one half has a standard error of 0.014.
const CLOUD_TOLERANCE: f64 = 0.04;

#[test]
fn a_cloud_agrees_with_rays_against_its_triangles() {
    let foliage = cloud(3000);
    let seen = leaves_see(&foliage);
    let hits = |from: DVec3, direction: DVec3, own: usize| {
        (0..foliage.leaf_count()).filter(|&leaf| leaf != own).any(|leaf| {
            let [a, b, c] = foliage.mesh.corners(leaf).map(|corner| corner.as_dvec3());
            let volume = |p: DVec3, q: DVec3| direction.dot((p - from).cross(q - from));
            let sides = [volume(a, b), volume(b, c), volume(c, a)];
            let normal = (b - a).cross(c - a);
            let ahead = (a - from).dot(normal) / direction.dot(normal) > 0.0;
            ahead && (sides.iter().all(|&s| s > 0.0) || sides.iter().all(|&s| s < 0.0))
        })
    };
    let (mut by_rays, mut by_cloud, mut count) = (0.0, 0.0, 0.0);
    for leaf in (0..foliage.leaf_count()).step_by(150) {
        let from = foliage.centers[leaf].as_dvec3();
        let (mut open, mut all) = (0.0, 0.0);
        for direction in directions() {
            let weight = direction.y.max(0.0);
            open += weight * f64::from(u8::from(!hits(from, direction, leaf)));
            all += weight;
        }
        by_rays += open / all;
        by_cloud += f64::from(seen[3 * leaf].front[0]);
        count += 1.0;
    }
    let (by_rays, by_cloud) = (by_rays / count, by_cloud / count);
    assert!((0.2..0.8).contains(&by_rays), "neither dense nor empty: {by_rays}");
    assert!((by_rays - by_cloud).abs() < CLOUD_TOLERANCE, "{by_cloud} for {by_rays} by rays");
}

#[test]
fn the_same_on_any_thread_count_and_stoppable() {
    let foliage = cloud(500);
    let on = |thread_count| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(thread_count).build();
        pool.expect("pool").install(|| leaves_see(&foliage))
    };
    assert_eq!(on(1), on(3), "1 and 3 threads");
    let job = Job::default();
    job.cancel();
    let stopped = seen(&Mesh::default(), &foliage, &opaque(), &job);
    assert_eq!(stopped, Err(LodError::Cancelled), "cancelled");
    let job = Job::default();
    seen(&Mesh::default(), &foliage, &opaque(), &job).expect("not cancelled");
    let (done, total) = job.progress();
    assert!(done == total && total > 0, "{done} of {total}");
}
