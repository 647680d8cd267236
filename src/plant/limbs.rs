//! The limbs of any plant: what grows from what, and which leaves grow where.
//!
//! A grown plant knows it. For a mesh it is guessed from the connected pieces of the wood, each a
//! limb: the largest is the trunk; every other one begins at its thicker end, and grows from that
//! larger piece whose surface is nearest to there. A leaf belongs to the limb nearest to its centre.
//! Wood that is one piece has no limbs to tell apart.
//!
//! Limits: a limb must be thicker at its base than at its tip, and smaller than what it grows from.
//! Pieces beyond the 1024 largest are no limbs of their own; they belong to the nearest.
//! O(n log n) for n triangles and leaves.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::error::LodError;
use crate::job::Job;
use crate::plant::mesh::{Mesh, triangle_area};
use crate::plant::near_points::{Labelled, NearPoints};
use crate::plant::split::{find, unite};
use crate::plant::weld::weld;
use crate::plant::{Foliage, Plant, Structure};

/// Pieces that may be limbs.
const MAX_LIMB_COUNT: usize = 1024;

/// Points on the wood's surface lie at most about this share of its size apart.
const SPACING: f64 = 1.0 / 256.0;

/// But a triangle has at most this many along an edge.
const MAX_SPREAD: u32 = 8;

/// Share of a limb's length that is its end, where its thickness is measured.
const END: f64 = 0.2;

/// Share of a limb's length at its base whose middle is where it begins: a tube's first ring.
const BASE: f64 = 0.1;

/// A limb that begins within so many radii of another one's base grows beside it.
const BESIDE: f64 = 1.5;

/// What reaches down to this share of the wood's height stands on the ground.
const GROUND: f32 = 0.05;

/// Triangles between two looks at the job.
const TRIANGLES_PER_CHECK: usize = 1 << 16;

/// What grows from what.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Limbs {
    /// For each limb the one it grows from, which comes before it.
    pub parents: Vec<Option<u32>>,
    /// Where each begins, in metres, relative to the plant's origin.
    pub starts: Vec<DVec3>,
    /// Limb of each leaf.
    pub leaf_limbs: Vec<u32>,
    /// Limb of each triangle of the wood.
    pub wood_limbs: Vec<u32>,
}

impl Limbs {
    /// What the plant knows of itself, or what its wood tells; `None` where that is not two limbs.
    ///
    /// # Errors
    /// [`LodError::Cancelled`].
    pub fn of(plant: &Plant, job: &Job) -> Result<Option<Self>, LodError> {
        let limbs = match &plant.structure {
            Some(structure) => Self::known(structure),
            None => return Self::guessed(&plant.wood, &plant.foliage, job),
        };
        Ok((limbs.parents.len() > 1).then_some(limbs))
    }

    /// The branches of a grown plant.
    pub fn known(structure: &Structure) -> Self {
        let mut wood_limbs = Vec::new();
        for (number, branch) in (0_u32..).zip(&structure.branches) {
            wood_limbs.extend(branch.wood_triangles.clone().map(|_| number));
        }
        Self {
            parents: structure.branches.iter().map(|branch| branch.parent).collect(),
            starts: structure.branches.iter().map(|branch| branch.start.as_dvec3()).collect(),
            leaf_limbs: structure.leaf_branches.clone(),
            wood_limbs,
        }
    }

    /// The connected pieces of the wood; `None` where there are not two of them.
    ///
    /// # Errors
    /// [`LodError::Cancelled`].
    pub fn guessed(wood: &Mesh, foliage: &Foliage, job: &Job) -> Result<Option<Self>, LodError> {
        if wood.is_empty() {
            return Ok(None);
        }
        let (wood_limbs, count) = pieces_by_area(wood, job)?;
        if count < 2 {
            return Ok(None);
        }
        let (low, high) = wood.bounds().expect("not empty");
        let spacing = low.as_dvec3().distance(high.as_dvec3()) * SPACING;
        let limb_count = count.min(MAX_LIMB_COUNT);
        let mut triangles: Vec<Vec<usize>> = vec![Vec::new(); limb_count];
        let mut points = Vec::new();
        for (triangle, &limb) in wood_limbs.iter().enumerate() {
            if triangle.is_multiple_of(TRIANGLES_PER_CHECK) {
                job.check()?;
            }
            if (limb as usize) < limb_count {
                triangles[limb as usize].push(triangle);
                spread(wood, triangle, limb, spacing, &mut points);
            }
        }
        let surface = NearPoints::new(points, job)?;
        let ends: Result<Vec<[End; 2]>, LodError> =
            triangles.par_iter().map(|triangles| ends(wood, triangles, job)).collect();
        let ends = ends?;
        let mut limbs = Self::default();
        let mut radii: Vec<f64> = Vec::new();
        for (limb, ends) in (0_u32..).zip(&ends) {
            job.check()?;
            let (base, parent) = if limb == 0 {
                // a trunk stands on its lower end
                let [a, b] = ends;
                (if b.middle.y < a.middle.y { b } else { a }, None)
            } else {
                let near = ends
                    .each_ref()
                    .map(|end| surface.nearest(end.middle, limb).expect("the trunk is larger"));
                let [a, b] = ends;
                // a tip may touch another limb too, but a base is thick
                let is_second = near[1].0 - b.radius < near[0].0 - a.radius;
                let base = &ends[usize::from(is_second)];
                let mut parent = near[usize::from(is_second)].1;
                while let Some(below) = limbs.parents[parent as usize]
                    && limbs.starts[parent as usize].distance(base.middle)
                        <= BESIDE * radii[parent as usize].max(base.radius)
                {
                    parent = below;
                }
                (base, Some(parent))
            };
            limbs.parents.push(parent);
            limbs.starts.push(base.middle);
            radii.push(base.radius);
        }
        let any = u32::MAX;
        let nearest = |place: DVec3| surface.nearest(place, any).expect("there is wood").1;
        limbs.leaf_limbs =
            job.collect(foliage.leaf_count(), |leaf| nearest(foliage.centers[leaf].as_dvec3()))?;
        limbs.wood_limbs = job.collect(wood_limbs.len(), |triangle| {
            let limb = wood_limbs[triangle];
            if (limb as usize) < limb_count { limb } else { nearest(centroid(wood, triangle)) }
        })?;
        Ok(Some(limbs))
    }
}

fn centroid(mesh: &Mesh, triangle: usize) -> DVec3 {
    mesh.corners(triangle).iter().map(|p| p.as_dvec3()).sum::<DVec3>() / 3.0
}

/// For each triangle its connected piece, the largest piece first, and how many pieces there are.
fn pieces_by_area(mesh: &Mesh, job: &Job) -> Result<(Vec<u32>, usize), LodError> {
    const NONE: u32 = u32::MAX;
    let (position_of, position_count) = weld(&mesh.positions);
    let mut first_at = vec![NONE; position_count as usize];
    let count = u32::try_from(mesh.triangles.len()).expect("checked by the plant");
    let mut parents: Vec<u32> = (0..count).collect();
    for (triangle, corners) in (0_u32..).zip(&mesh.triangles) {
        if (triangle as usize).is_multiple_of(TRIANGLES_PER_CHECK) {
            job.check()?;
        }
        for &vertex in corners {
            let first = &mut first_at[position_of[vertex as usize] as usize];
            if *first == NONE {
                *first = triangle;
            } else {
                unite(&mut parents, *first, triangle);
            }
        }
    }
    job.check()?;
    // a piece's root is its first triangle
    let roots: Vec<u32> = (0..count).map(|triangle| find(&mut parents, triangle)).collect();
    let mut areas = vec![0.0; mesh.triangles.len()];
    for (triangle, &root) in roots.iter().enumerate() {
        areas[root as usize] += triangle_area(mesh.corners(triangle));
    }
    let mut lowest = vec![f32::INFINITY; mesh.triangles.len()];
    for (triangle, &root) in roots.iter().enumerate() {
        let low = mesh.corners(triangle).map(|p| p.y).into_iter().fold(f32::INFINITY, f32::min);
        lowest[root as usize] = lowest[root as usize].min(low);
    }
    let mut order: Vec<u32> = (0..count).filter(|&t| roots[t as usize] == t).collect();
    order.sort_by(|&a, &b| areas[b as usize].total_cmp(&areas[a as usize]).then(a.cmp(&b)));
    // a trunk stands on the ground
    let (low, high) = mesh.bounds().expect("not empty");
    let ground = low.y + (high.y - low.y) * GROUND;
    if let Some(at) = order.iter().position(|&root| lowest[root as usize] <= ground) {
        order[..=at].rotate_right(1);
    }
    let mut rank_of = vec![NONE; mesh.triangles.len()];
    for (rank, &root) in (0_u32..).zip(&order) {
        rank_of[root as usize] = rank;
    }
    Ok((roots.iter().map(|&root| rank_of[root as usize]).collect(), order.len()))
}

/// Adds points all over a triangle: the middles of the equal triangles that it divides into.
fn spread(mesh: &Mesh, triangle: usize, label: u32, spacing: f64, points: &mut Vec<Labelled>) {
    let [a, b, c] = mesh.corners(triangle);
    let longest = (b - a).length().max((c - b).length()).max((a - c).length());
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a positive number, and casts of floats saturate"
    )]
    let n = ((f64::from(longest) / spacing).ceil() as u32).clamp(1, MAX_SPREAD);
    for i in 0..n {
        // upright ones and those on their heads in turn
        for j in 0..2 * (n - i) - 1 {
            let third = 1 + j % 2;
            let u = (3 * i + third) as f32 / (3 * n) as f32;
            let v = (3 * (j / 2) + third) as f32 / (3 * n) as f32;
            points.push(Labelled { position: a + (b - a) * u + (c - a) * v, label });
        }
    }
}

/// An end of a limb.
#[derive(Debug, Clone, Copy, PartialEq)]
struct End {
    /// Of its last corners.
    middle: DVec3,
    /// Mean distance of its corners from its own axis.
    radius: f64,
}

/// Both ends of a piece along its longest axis.
fn ends(mesh: &Mesh, triangles: &[usize], job: &Job) -> Result<[End; 2], LodError> {
    let each_corner = |look: &mut dyn FnMut(DVec3)| -> Result<(), LodError> {
        for some in triangles.chunks(TRIANGLES_PER_CHECK) {
            job.check()?;
            some.iter().flat_map(|&t| mesh.corners(t)).for_each(|p| look(p.as_dvec3()));
        }
        Ok(())
    };
    let mut sum = DVec3::ZERO;
    each_corner(&mut |corner| sum += corner)?;
    let mean = sum / (3 * triangles.len()) as f64;
    let mut spread = DMat3::ZERO;
    each_corner(&mut |corner| {
        let offset = corner - mean;
        spread += DMat3::from_cols(offset * offset.x, offset * offset.y, offset * offset.z);
    })?;
    let axis = longest_axis(&spread);
    let along = |p: DVec3| (p - mean).dot(axis);
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    each_corner(&mut |corner| {
        low = low.min(along(corner));
        high = high.max(along(corner));
    })?;
    let length = high - low;
    let end_at = |side: f64| {
        // metres from this end; rounding must not leave it empty
        let depth = |p: DVec3| if side > 0.0 { along(p) - low } else { high - along(p) };
        let middle_of = |share: f64| {
            let (mut sum, mut count) = (DVec3::ZERO, 0.0);
            each_corner(&mut |corner| {
                if depth(corner) <= share * length {
                    sum += corner;
                    count += 1.0;
                }
            })?;
            Ok::<DVec3, LodError>(sum / count)
        };
        let end = middle_of(END)?;
        let (mut sum, mut count) = (0.0, 0.0);
        each_corner(&mut |corner| {
            if depth(corner) <= END * length {
                sum += (corner - end).reject_from_normalized(axis).length();
                count += 1.0;
            }
        })?;
        Ok::<End, LodError>(End { middle: middle_of(BASE)?, radius: sum / count })
    };
    Ok([end_at(1.0)?, end_at(-1.0)?])
}

/// The direction along which a spread is largest: power iteration would stall where two are equal, so
/// the matrix is squared instead, which doubles its exponent at every step.
fn longest_axis(spread: &DMat3) -> DVec3 {
    let mut power = *spread;
    for _ in 0..12 {
        let largest = power.to_cols_array().into_iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        if largest == 0.0 {
            return DVec3::Y;
        }
        power *= 1.0 / largest;
        power = power * power;
    }
    let columns = [power.x_axis, power.y_axis, power.z_axis];
    let longest = columns.into_iter().fold(DVec3::ZERO, |most, column| {
        if column.length_squared() > most.length_squared() { column } else { most }
    });
    longest.normalize_or(DVec3::Y)
}

#[cfg(test)]
mod tests {
    use glam::{Vec2, Vec3, Vec4};

    use super::*;
    use crate::job;
    use crate::plant::Lighting;
    use crate::plant::grow::grow;

    /// Square tubes that narrow from one point to another, each a piece of its own.
    fn tubes(tubes: &[(Vec3, Vec3, f32)]) -> Mesh {
        let mut mesh = Mesh::default();
        for &(base, tip, radius) in tubes {
            let axis = (tip - base).normalize();
            let across = axis.any_orthonormal_vector();
            let along = axis.cross(across);
            let first = u32::try_from(mesh.positions.len()).expect("few");
            for (end, radius) in [(base, radius), (tip, radius * 0.5)] {
                for side in [across, along, -across, -along] {
                    mesh.positions.push(end + side * radius);
                    mesh.normals.push(side);
                    mesh.uvs.push(Vec2::ZERO);
                    mesh.base.push(Vec4::ONE);
                }
            }
            for side in 0..4 {
                let next = (side + 1) % 4;
                let [a, b, c, d] = [side, next, next + 4, side + 4].map(|at| at + first);
                mesh.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        mesh.parts = Mesh::parts_from_ids(&vec![0; mesh.triangles.len()]);
        mesh
    }

    fn leaves(places: &[Vec3]) -> Foliage {
        let mut mesh = Mesh::default();
        for &place in places {
            let first = u32::try_from(mesh.positions.len()).expect("few");
            for corner in [Vec3::ZERO, Vec3::X, Vec3::Y] {
                mesh.positions.push(place + (corner - Vec3::splat(1.0 / 3.0)) * 0.1);
                mesh.normals.push(Vec3::Z);
                mesh.uvs.push(Vec2::ZERO);
                mesh.base.push(Vec4::ONE);
                mesh.front.push(Vec3::ONE);
                mesh.back.push(Vec3::ONE);
            }
            mesh.triangles.push([first, first + 1, first + 2]);
        }
        mesh.parts = Mesh::parts_from_ids(&vec![0; mesh.triangles.len()]);
        let offsets = (0..=u32::try_from(places.len()).expect("few")).collect();
        Foliage::new(mesh, offsets, &Job::default()).expect("valid")
    }

    /// A trunk of 6 m, limbs at 3 and at 4 m, and a twig on the first limb; the smallest comes first.
    ///
    /// ```text
    ///       │ twig
    ///   ────┴──┐  limb      y = 3
    ///          ├─────       y = 4 in truth, the other way
    /// ```
    fn wood() -> Mesh {
        tubes(&[
            (Vec3::new(-2.0, 3.0, 0.0), Vec3::new(-2.0, 4.0, 0.0), 0.04),
            (Vec3::new(0.0, 4.0, 0.0), Vec3::new(2.5, 4.5, 0.0), 0.1),
            (Vec3::new(0.0, 3.0, 0.0), Vec3::new(-3.0, 3.0, 0.0), 0.12),
            (Vec3::ZERO, Vec3::Y * 6.0, 0.3),
        ])
    }

    #[test]
    fn pieces_of_wood_are_limbs() {
        let foliage = leaves(&[
            Vec3::new(-2.0, 4.2, 0.0),
            Vec3::new(2.6, 4.5, 0.1),
            Vec3::new(-3.0, 3.2, 0.0),
            Vec3::Y * 6.3,
        ]);
        let found = Limbs::guessed(&wood(), &foliage, &Job::default());
        let found = found.expect("runs").expect("four pieces");
        // by area: trunk, the longer limb, the other limb, twig
        assert_eq!(found.parents, [None, Some(0), Some(0), Some(1)], "what grows from what");
        let starts = [DVec3::ZERO, DVec3::Y * 3.0, DVec3::Y * 4.0, DVec3::new(-2.0, 3.0, 0.0)];
        for (limb, (found, expected)) in found.starts.iter().zip(starts).enumerate() {
            assert!(found.distance(expected) < 1e-6, "limb {limb}: {found} for {expected}");
        }
        assert_eq!(found.leaf_limbs, [3, 2, 1, 0], "the nearest limb");
        let of_tubes: Vec<u32> = found.wood_limbs.chunks(8).map(|tube| tube[0]).collect();
        assert_eq!(of_tubes, [3, 2, 1, 0], "as they come in the mesh");
        assert!(found.wood_limbs.chunks(8).all(|tube| tube.iter().all(|l| *l == tube[0])), "whole");
    }

    #[test]
    fn limbs_side_by_side_grow_from_what_is_below_both() {
        // two limbs from the same place on the trunk
        let wood = tubes(&[
            (Vec3::ZERO, Vec3::Y * 6.0, 0.3),
            (Vec3::Y * 3.0, Vec3::new(-3.0, 3.0, 0.0), 0.12),
            (Vec3::Y * 3.0, Vec3::new(-1.5, 3.0, 1.5), 0.1),
        ]);
        let found = Limbs::guessed(&wood, &leaves(&[Vec3::ZERO]), &Job::default());
        let found = found.expect("runs").expect("three pieces");
        assert_eq!(found.parents, [None, Some(0), Some(0)], "not one from the other");
    }

    #[test]
    fn a_grown_tree_is_found_again_in_its_wood() {
        let plant = grow("palm", 1, Some(300), Lighting::default(), &Job::default());
        let plant = plant.expect("grown");
        let known = Limbs::of(&plant, &Job::default()).expect("runs").expect("it knows");
        let mut unknown = plant.clone();
        unknown.structure = None;
        let found = Limbs::of(&unknown, &Job::default()).expect("runs").expect("it is told");
        assert_eq!(found.parents.len(), known.parents.len(), "as many");
        // fronds stand close together, and the foot of one may be nearest to another's
        let from_trunk = found.parents.iter().filter(|parent| **parent == Some(0)).count();
        assert!(from_trunk * 4 >= (known.parents.len() - 1) * 3, "{from_trunk} from the trunk");
        let same = |(a, b): (&u32, &u32)| {
            let own =
                &plant.structure.as_ref().expect("known").branches[*a as usize].wood_triangles;
            found.wood_limbs[own.start as usize] == *b
        };
        let right = known.leaf_limbs.iter().zip(&found.leaf_limbs).filter(|&pair| same(pair));
        // leaflets of crossing fronds: 2255 of 2520 at full size
        assert!(right.count() * 5 >= known.leaf_limbs.len() * 4, "leaves of their own fronds");
    }

    #[test]
    fn wood_of_one_piece_has_no_limbs() {
        let foliage = leaves(&[Vec3::Y]);
        let one = Limbs::guessed(&tubes(&[(Vec3::ZERO, Vec3::Y, 0.1)]), &foliage, &Job::default());
        assert_eq!(one, Ok(None), "a trunk");
        let none = Limbs::guessed(&Mesh::default(), &foliage, &Job::default());
        assert_eq!(none, Ok(None), "no wood");
        let points = tubes(&[(Vec3::ZERO, Vec3::Y, 0.0), (Vec3::Y * 2.0, Vec3::Y * 3.0, 0.0)]);
        let thin = Limbs::guessed(&points, &foliage, &Job::default());
        let thin = thin.expect("runs").expect("two pieces");
        assert_eq!(thin.parents, [None, Some(0)], "without thickness");
        let stopped = Job::default();
        stopped.cancel();
        let result = Limbs::guessed(&wood(), &foliage, &stopped);
        assert_eq!(result, Err(LodError::Cancelled), "stopped");
        assert_eq!(ends(&wood(), &[0, 1], &stopped), Err(LodError::Cancelled), "inside a piece");
    }

    #[test]
    fn the_same_on_any_number_of_threads() {
        let foliage = leaves(&[Vec3::new(-2.0, 4.2, 0.0), Vec3::new(2.6, 4.5, 0.1)]);
        let run = |threads| {
            let found = || Limbs::guessed(&wood(), &foliage, &Job::default());
            job::run(Some(threads), found).expect("runs")
        };
        assert_eq!(run(1), run(3), "limbs");
    }
}
