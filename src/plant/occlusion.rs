//! How much of the sky and of the ground the two sides of each vertex see: ambient occlusion.
//!
//! A crown is too fine for rays against its triangles to be worth their time, and what dims the
//! light in it is the sum of many leaves; so it is taken for a cloud. The plant's box is divided into
//! cubes, 64 along its longest side. A cube dims light by `k` a metre: half the area of
//! leaves in it over its volume (a sheet's mean projection over all directions is half its area; what
//! the texture cuts out does not count), and a quarter of the area of wood, which is closed. Along a
//! ray the share `exp(-sum k_i l_i)` gets through (Beer and Lambert). Rays begin at the middle of the
//! vertex's cube, go 64 fixed ways, and skip that cube and its 26 neighbours: a leaf does
//! not darken itself. A side sees the mean over the upper directions, weighted with their cosine to
//! its normal, of the sky, and that over the lower ones of the ground.
//!
//! Cost: O(cubes that hold vertices * DIRECTIONS * CELLS), and linear in vertices and triangles.
//! The chestnut takes 0.3 s of processor time on all cores together, one of 10^6 leaves 9 s.
//!
//! This work is based on:
//! Kyle Hegeman, Simon Premoze, Michael Ashikhmin, George Drettakis. Approximate Ambient Occlusion
//! For Trees. 2006 (a crown dims ambient light as a cloud of leaves)
//! John Amanatides, Andrew Woo. A Fast Voxel Traversal Algorithm for Ray Tracing. 1987
//! Juhan Ross. The Radiation Regime and Architecture of Plant Stands. 1981 (mean projections)

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use crate::error::LodError;
use crate::job::Job;
use crate::plant::mesh::triangle_area;
use crate::plant::split::cutout_shares;
use crate::plant::{Foliage, Material, Mesh};

/// Cubes along the longest side of the plant's box.
const CELLS: usize = 64;

/// Directions that rays take, evenly over the sphere.
const DIRECTIONS: usize = 64;

/// Projected area over all directions as a share of the area: of a sheet, and of a closed surface.
const SHEET_SHARE: f64 = 0.5;
const CLOSED_SHARE: f64 = 0.25;

/// A triangle's area is spread over at most this many points along an edge.
const MAX_SPREAD: u32 = 16;

/// Cubes with vertices in one rayon job, and triangles between two looks at the job.
const CELLS_PER_JOB: usize = 64;
const TRIANGLES_PER_CHECK: usize = 1 << 15;

/// Shares, each in [0, 1], that a vertex sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Of sky and ground, by the side that the normal points to.
    pub front: [f32; 2],
    /// The same for the other side.
    pub back: [f32; 2],
}

impl Seen {
    /// Nothing in the way.
    pub const ALL: Self = Self { front: [1.0; 2], back: [1.0; 2] };
}

/// What every vertex of the wood and of the foliage sees.
///
/// # Errors
/// [`LodError::Cancelled`].
pub fn seen(
    wood: &Mesh,
    foliage: &Foliage,
    materials: &[Material],
    job: &Job,
) -> Result<[Vec<Seen>; 2], LodError> {
    let meshes = [wood, &foliage.mesh];
    let Some(mut grid) = Grid::around(meshes) else {
        return Ok(meshes.map(|mesh| vec![Seen::ALL; mesh.positions.len()]));
    };
    grid.add(wood, CLOSED_SHARE, materials, job)?;
    grid.add(&foliage.mesh, SHEET_SHARE, materials, job)?;
    let directions = directions();
    let paths: Vec<Path> =
        directions.iter().map(|&direction| Path::new(direction, &grid)).collect();

    let vertices: Vec<(Vec3, Vec3)> = meshes
        .iter()
        .flat_map(|mesh| mesh.positions.iter().copied().zip(mesh.normals.iter().copied()))
        .collect();
    // vertices of one cube share its rays
    let mut order: Vec<(u32, u32)> = (0_u32..)
        .zip(&vertices)
        .map(|(vertex, &(position, _))| (grid.index(grid.cell_of(position)), vertex))
        .collect();
    order.par_sort_unstable();
    let groups: Vec<&[(u32, u32)]> = order.chunk_by(|a, b| a.0 == b.0).collect();
    job.begin(groups.len().div_ceil(CELLS_PER_JOB) as u64);
    let parts: Vec<Vec<(u32, Seen)>> = groups
        .par_chunks(CELLS_PER_JOB)
        .map(|groups| {
            job.check()?;
            let mut out = Vec::new();
            for group in groups {
                let cell = grid.cell(group[0].0);
                let open: Vec<f64> =
                    paths.iter().map(|path| grid.transmittance(cell, path)).collect();
                out.extend(group.iter().map(|&(_, vertex)| {
                    let normal = vertices[vertex as usize].1.as_dvec3();
                    (vertex, both_sides(normal, &directions, &open))
                }));
            }
            job.advance();
            Ok(out)
        })
        .collect::<Result<_, LodError>>()?;
    let mut all = vec![Seen::ALL; vertices.len()];
    for (vertex, seen) in parts.into_iter().flatten() {
        all[vertex as usize] = seen;
    }
    let leaves = all.split_off(wood.positions.len());
    Ok([all, leaves])
}

/// Unit vectors on a Fibonacci spiral: the first half points up, the second down, none is level.
fn directions() -> Vec<DVec3> {
    let golden_angle = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let spiral = |number: usize| {
        let y = 1.0 - (2 * number + 1) as f64 / DIRECTIONS as f64;
        let angle = golden_angle * number as f64;
        let level = (1.0 - y * y).sqrt();
        DVec3::new(level * libm::cos(angle), y, level * libm::sin(angle))
    };
    (0..DIRECTIONS).map(spiral).collect()
}

/// What the two sides of a vertex see, by what comes through along each direction.
fn both_sides(normal: DVec3, directions: &[DVec3], open: &[f64]) -> Seen {
    let mut seen = Seen::ALL;
    // without a normal, all directions weigh alike
    let any_way = f64::from(u8::from(normal == DVec3::ZERO));
    let halves = directions.chunks(DIRECTIONS / 2).zip(open.chunks(DIRECTIONS / 2));
    for (half, (directions, open)) in halves.enumerate() {
        let (mut front, mut back) = (DVec2::ZERO, DVec2::ZERO);
        for (direction, &open) in directions.iter().zip(open) {
            let cosine = normal.dot(*direction);
            front += DVec2::new(open, 1.0) * (cosine.max(0.0) + any_way);
            back += DVec2::new(open, 1.0) * ((-cosine).max(0.0) + any_way);
        }
        #[expect(clippy::cast_possible_truncation, reason = "shares are stored in f32")]
        let share = |sum: DVec2| if sum.y > 0.0 { (sum.x / sum.y) as f32 } else { 1.0 };
        seen.front[half] = share(front);
        seen.back[half] = share(back);
    }
    seen
}

/// A cube that a ray passes, relative to where it begins, and the length in it, in cubes.
#[derive(Debug, Clone, Copy)]
struct Step {
    offset: [i32; 3],
    length: f32,
}

/// The cubes along a direction, from the middle of one that is left out with its neighbours, until
/// `reach` cubes away.
fn steps(direction: DVec3, reach: i32) -> Vec<Step> {
    let direction = direction.to_array();
    let mut offset = [0; 3];
    // where the ray leaves the cube along each axis
    let mut exits = direction.map(|d| if d == 0.0 { f64::INFINITY } else { 0.5 / d.abs() });
    let mut at = 0.0;
    let mut steps = Vec::new();
    while offset.iter().all(|along: &i32| along.abs() < reach) {
        let axis = (0..3).fold(0, |best, axis| if exits[axis] < exits[best] { axis } else { best });
        if offset.iter().any(|along| along.abs() > 1) {
            #[expect(clippy::cast_possible_truncation, reason = "at most the square root of 3")]
            let length = (exits[axis] - at) as f32;
            steps.push(Step { offset, length });
        }
        at = exits[axis];
        offset[axis] += if direction[axis] > 0.0 { 1 } else { -1 };
        exits[axis] += 1.0 / direction[axis].abs();
    }
    steps
}

/// Steps along a direction, ready for one grid.
struct Path {
    /// Of the cube's index, and the length in it.
    steps: Vec<(isize, f32)>,
    /// Along each axis: 1 if the ray goes up, and `[n]` steps until it is more than `n` cubes away.
    axes: [(bool, Vec<usize>); 3],
}

impl Path {
    fn new(direction: DVec3, grid: &Grid) -> Self {
        let reach = grid.sides.into_iter().fold(1, i32::max);
        let steps = steps(direction, reach);
        let [width, height, _] = grid.sides;
        let delta = |[x, y, z]: [i32; 3]| ((z * height + y) * width + x) as isize;
        let axes = std::array::from_fn(|axis| {
            let within = |room: i32| steps.partition_point(|step| step.offset[axis].abs() <= room);
            (direction[axis] > 0.0, (0..reach).map(within).collect())
        });
        Self { steps: steps.iter().map(|step| (delta(step.offset), step.length)).collect(), axes }
    }
}

/// Cubes over the plant's box.
struct Grid {
    low: DVec3,
    /// Metres.
    edge: f64,
    sides: [i32; 3],
    /// Optical depth of each cube along its edge.
    depths: Vec<f32>,
}

impl Grid {
    /// `None` if the plant is one point.
    fn around(meshes: [&Mesh; 2]) -> Option<Self> {
        let mut low = Vec3::INFINITY;
        let mut high = Vec3::NEG_INFINITY;
        for bounds in meshes.iter().filter_map(|mesh| mesh.bounds()) {
            low = low.min(bounds.0);
            high = high.max(bounds.1);
        }
        let (low, high) = (low.as_dvec3(), high.as_dvec3());
        let edge = (high - low).max_element() / CELLS as f64;
        // a tiny plant's cube must have a volume
        if !(edge > 0.0 && (edge * edge * edge).is_normal()) {
            return None;
        }
        #[expect(clippy::cast_possible_truncation, reason = "at most CELLS")]
        let sides = ((high - low) / edge).to_array().map(|side| (side.ceil() as i32).max(1));
        let count = sides.iter().map(|&side| side.unsigned_abs() as usize).product();
        Some(Self { low, edge, sides, depths: vec![0.0; count] })
    }

    /// The cube of a point; of the nearest in the grid for what no triangle uses.
    fn cell_of(&self, position: Vec3) -> [i32; 3] {
        let place = ((position.as_dvec3() - self.low) / self.edge).to_array();
        #[expect(clippy::cast_possible_truncation, reason = "casts of floats saturate")]
        std::array::from_fn(|axis| (place[axis].floor() as i32).clamp(0, self.sides[axis] - 1))
    }

    fn index(&self, [x, y, z]: [i32; 3]) -> u32 {
        ((z * self.sides[1] + y) * self.sides[0] + x).unsigned_abs()
    }

    fn cell(&self, index: u32) -> [i32; 3] {
        let [width, height, _] = self.sides.map(i32::unsigned_abs);
        let part = |value: u32| i32::try_from(value).expect("at most CELLS");
        [part(index % width), part(index / width % height), part(index / width / height)]
    }

    /// Adds what a mesh's triangles dim.
    fn add(
        &mut self,
        mesh: &Mesh,
        projected: f64,
        materials: &[Material],
        job: &Job,
    ) -> Result<(), LodError> {
        let cutouts = cutout_shares(mesh, materials, job)?;
        let depth_per_area = projected / (self.edge * self.edge);
        let mut depths = vec![0.0_f64; self.depths.len()];
        for (triangle, cutout) in cutouts.iter().enumerate() {
            if triangle % TRIANGLES_PER_CHECK == 0 {
                job.check()?;
            }
            let corners = mesh.corners(triangle);
            let depth = triangle_area(corners) * (1.0 - f64::from(*cutout)) * depth_per_area;
            let [a, b, c] = corners;
            let longest = (b - a).length().max((c - b).length()).max((a - c).length());
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a positive number, and casts of floats saturate"
            )]
            let n = ((f64::from(longest) / self.edge).ceil() as u32).clamp(1, MAX_SPREAD);
            let share = depth / f64::from(n * n);
            // middles of the n^2 equal triangles that it divides into, upright ones and others
            for i in 0..n {
                for j in 0..2 * (n - i) - 1 {
                    let third = 1 + j % 2;
                    let u = (3 * i + third) as f32 / (3 * n) as f32;
                    let v = (3 * (j / 2) + third) as f32 / (3 * n) as f32;
                    let cell = self.cell_of(a + (b - a) * u + (c - a) * v);
                    depths[self.index(cell) as usize] += share;
                }
            }
        }
        for (sum, depth) in self.depths.iter_mut().zip(depths) {
            #[expect(clippy::cast_possible_truncation, reason = "depths are stored in f32")]
            let depth = depth as f32;
            *sum += depth;
        }
        Ok(())
    }

    /// Share of the light that comes to the middle of a cube along a path.
    fn transmittance(&self, cell: [i32; 3], path: &Path) -> f64 {
        let mut count = path.steps.len();
        for (axis, (is_upward, within)) in path.axes.iter().enumerate() {
            let room = if *is_upward { self.sides[axis] - 1 - cell[axis] } else { cell[axis] };
            count = count.min(within[room.unsigned_abs() as usize]);
        }
        let base = self.index(cell) as usize;
        let mut depth = 0.0_f32;
        for &(delta, length) in &path.steps[..count] {
            depth += self.depths[base.wrapping_add_signed(delta)] * length;
        }
        libm::exp(-f64::from(depth))
    }
}

#[cfg(test)]
mod tests;
