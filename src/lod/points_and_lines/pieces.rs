//! What a plant is reduced by: its leaves, and the pieces its wood falls into.
//!
//! Wood is taken branch by branch where the plant knows its branches and the wood is complete, else by
//! connected triangles (equal positions). A piece of several materials counts as several pieces.
//!
//! Each piece knows its main axis: the longest of the principal axes of its surface, weighted by area.
//! The *elongation* is how much longer the surface is along it than along the next: the length over
//! the width of a rectangle.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::error::LodError;
use crate::job::{ELEMENTS_PER_CHECK, Job};
use crate::lod::eigen::smallest_eigenvector;
use crate::plant::mesh::area_normal;
use crate::plant::split::{find, unite};
use crate::plant::weld::weld;
use crate::plant::{Mesh, Structure};

/// `|sum of area vectors| / sum of areas` below which a piece is closed, as where wood and leaves are
/// told apart: 0 for closed surfaces and leaves of two faces, 1 for flat ones.
const MIN_SHEET_SHARE: f64 = 0.3;

/// Share of a piece's area that must lie on the same three positions as another triangle.
const MIN_TWIN_SHARE: f64 = 0.5;

/// A leaf or a piece of wood, of one material.
#[derive(Debug, Clone, PartialEq)]
pub struct Piece {
    /// Of the mesh that wood and leaves were joined to; rising.
    pub triangles: Vec<u32>,
    /// Index into the plant's materials.
    pub material: u32,
    /// Whether it belongs to the wood.
    pub is_wood: bool,
}

/// What a piece looks like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Form {
    /// Area of all triangles, in square metres.
    pub area: f64,
    /// Mean of its surface; of its vertices if it has no area.
    pub center: DVec3,
    /// Unit vector along which it is longest.
    pub axis: DVec3,
    /// How much longer than wide; infinite without any width, 1 for a point.
    pub elongation: f64,
    /// Share of its area that is seen from a random direction on average: 1/2 for a single sheet, 1/4
    /// for a closed or doubled surface.
    pub seen_share: f64,
    /// Sum of its triangles' area vectors, signs aligned to the largest; zero for closed ones.
    pub normal: DVec3,
}

/// The pieces of wood and leaves that were joined to `mesh`, the wood's triangles first.
///
/// `leaf_offsets` count from the first leaf's first triangle. `structure` is of use only if no wood was
/// left out.
///
/// # Errors
/// [`LodError::Cancelled`].
pub fn pieces(
    mesh: &Mesh,
    materials: &[u32],
    wood_count: usize,
    leaf_offsets: &[u32],
    structure: Option<&Structure>,
    job: &Job,
) -> Result<Vec<Piece>, LodError> {
    let mut found = Vec::new();
    match structure {
        Some(structure) => {
            let mut owned = vec![false; wood_count];
            for branch in &structure.branches {
                let range = branch.wood_triangles.clone();
                owned[range.start as usize..range.end as usize].fill(true);
                push_runs(&mut found, range, materials, true);
            }
            let left: Vec<u32> = numbers(wood_count).filter(|&t| !owned[t as usize]).collect();
            push_connected(&mut found, mesh, left, materials, job)?;
        }
        None => push_connected(&mut found, mesh, numbers(wood_count).collect(), materials, job)?,
    }
    let first = u32::try_from(wood_count).expect("triangles are counted in u32");
    for (number, ends) in leaf_offsets.windows(2).enumerate() {
        if number % ELEMENTS_PER_CHECK == 0 {
            job.check()?;
        }
        push_runs(&mut found, first + ends[0]..first + ends[1], materials, false);
    }
    Ok(found)
}

fn numbers(count: usize) -> std::ops::Range<u32> {
    0..u32::try_from(count).expect("triangles are counted in u32")
}

/// A piece for each material in a range of triangles.
fn push_runs(
    found: &mut Vec<Piece>,
    range: std::ops::Range<u32>,
    materials: &[u32],
    is_wood: bool,
) {
    let mut triangles: Vec<u32> = range.collect();
    triangles.sort_by_key(|&t| materials[t as usize]);
    for run in triangles.chunk_by(|&a, &b| materials[a as usize] == materials[b as usize]) {
        let material = materials[run[0] as usize];
        found.push(Piece { triangles: run.to_vec(), material, is_wood });
    }
}

/// A piece of wood for each connected set of triangles of a material, by its first triangle.
fn push_connected(
    found: &mut Vec<Piece>,
    mesh: &Mesh,
    triangles: Vec<u32>,
    materials: &[u32],
    job: &Job,
) -> Result<(), LodError> {
    const NONE: u32 = u32::MAX;
    if triangles.is_empty() {
        return Ok(());
    }
    let (position_of, position_count) = weld(&mesh.positions);
    let mut parents: Vec<u32> = numbers(mesh.triangles.len()).collect();
    let mut by_material = triangles;
    by_material.sort_by_key(|&t| materials[t as usize]);
    let mut first_at = vec![NONE; position_count as usize];
    for run in by_material.chunk_by(|&a, &b| materials[a as usize] == materials[b as usize]) {
        for chunk in run.chunks(ELEMENTS_PER_CHECK) {
            job.check()?;
            for &triangle in chunk {
                for vertex in mesh.triangles[triangle as usize] {
                    let first = &mut first_at[position_of[vertex as usize] as usize];
                    if *first == NONE {
                        *first = triangle;
                    } else {
                        unite(&mut parents, *first, triangle);
                    }
                }
            }
        }
        first_at.fill(NONE);
    }
    // the root is the lowest triangle of a piece
    by_material.sort_by_key(|&t| (find(&mut parents, t), t));
    for run in by_material.chunk_by(|&a, &b| parents_of(&parents, a) == parents_of(&parents, b)) {
        let material = materials[run[0] as usize];
        found.push(Piece { triangles: run.to_vec(), material, is_wood: true });
    }
    Ok(())
}

/// The root of a node, without shortening paths.
fn parents_of(parents: &[u32], mut node: u32) -> u32 {
    while parents[node as usize] != node {
        node = parents[node as usize];
    }
    node
}

/// The form of every piece.
///
/// # Errors
/// [`LodError::Cancelled`].
pub fn forms(mesh: &Mesh, pieces: &[Piece], job: &Job) -> Result<Vec<Form>, LodError> {
    let mut forms = Vec::with_capacity(pieces.len());
    for chunk in pieces.chunks(ELEMENTS_PER_CHECK / 8) {
        job.check()?;
        forms.par_extend(chunk.par_iter().map(|piece| form(mesh, &piece.triangles)));
    }
    Ok(forms)
}

/// The form of some triangles, summed in f64 in their order.
fn form(mesh: &Mesh, triangles: &[u32]) -> Form {
    let corners = |t: u32| mesh.corners(t as usize).map(|p| p.as_dvec3());
    let vectors = || triangles.iter().map(|&t| area_normal(mesh.corners(t as usize)));
    let area: f64 = vectors().map(DVec3::length).sum();
    let (mut net, mut largest) = (DVec3::ZERO, DVec3::ZERO);
    for vector in vectors() {
        net += vector;
        if vector.length_squared() > largest.length_squared() {
            largest = vector;
        }
    }
    // without an area all vertices weigh the same
    let weight = |vector: DVec3| {
        if area > 0.0 { vector.length() / area } else { 1.0 / triangles.len() as f64 }
    };
    let weighted = || triangles.iter().zip(vectors()).map(|(&t, v)| (corners(t), weight(v)));
    let center: DVec3 = weighted().map(|([a, b, c], w)| (a + b + c) * (w / 3.0)).sum();
    let mut spread = DMat3::ZERO;
    for ([a, b, c], w) in weighted() {
        let middle = (a + b + c) / 3.0;
        let square = |v: DVec3| DMat3::from_cols(v * v.x, v * v.y, v * v.z);
        // second moments of a triangle: those of its corners over 4, and of its own middle
        let own = square(a - middle) + square(b - middle) + square(c - middle);
        spread += (own * (1.0 / 12.0) + square(middle - center)) * w;
    }
    let (negative, axis) = smallest_eigenvector(&(spread * -1.0));
    let (least, _) = smallest_eigenvector(&spread);
    let most = -negative;
    let trace = spread.x_axis.x + spread.y_axis.y + spread.z_axis.z;
    let second = (trace - most - least).max(0.0);
    // what rounding leaves of a width that is none
    let elongation = if most <= 0.0 {
        1.0
    } else if second <= most * 1e-14 {
        f64::INFINITY
    } else {
        (most / second).sqrt()
    };
    let is_closed = area > 0.0
        && (net.length() < MIN_SHEET_SHARE * area
            || twin_area(mesh, triangles) > MIN_TWIN_SHARE * area);
    let aligned = vectors().map(|v| if v.dot(largest) < 0.0 { -v } else { v }).sum();
    Form {
        area,
        center,
        axis,
        elongation,
        seen_share: if is_closed { 0.25 } else { 0.5 },
        normal: if is_closed { DVec3::ZERO } else { aligned },
    }
}

/// Area of the triangles that lie on the same three positions as another one.
fn twin_area(mesh: &Mesh, triangles: &[u32]) -> f64 {
    let mut keyed: Vec<([[u32; 3]; 3], f64)> = triangles
        .iter()
        .map(|&t| {
            let corners = mesh.corners(t as usize);
            // adding 0 turns -0 into 0
            let mut key = corners.map(|p| (p + glam::Vec3::ZERO).to_array().map(f32::to_bits));
            key.sort_unstable();
            (key, area_normal(corners).length())
        })
        .collect();
    keyed.sort_by_key(|&(key, _)| key);
    let groups = keyed.chunk_by(|a, b| a.0 == b.0).filter(|group| group.len() > 1);
    groups.flatten().map(|&(_, area)| area).sum()
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::lod::made::quads;

    fn form_of(leaves: &[crate::lod::made::Leaf]) -> Form {
        let mesh = quads(leaves);
        form(&mesh, &numbers(mesh.triangles.len()).collect::<Vec<_>>())
    }

    #[test]
    fn a_rectangle_is_as_elongated_as_it_is_long() {
        let blade = form_of(&[(Vec3::new(1.0, 2.0, 3.0), Vec3::X * 0.5, Vec3::Y * 3.0)]);
        assert!((blade.elongation - 6.0).abs() < 1e-12, "{}", blade.elongation);
        assert_eq!(blade.area, 6.0, "6 by 1");
        // thirds are rounded
        assert!(blade.center.abs_diff_eq(DVec3::new(1.0, 2.0, 3.0), 1e-15), "{}", blade.center);
        assert!(blade.axis.dot(DVec3::Y).abs() > 1.0 - 1e-12, "{}", blade.axis);
        assert_eq!((blade.seen_share, blade.normal), (0.5, DVec3::Z * 6.0), "one sheet");
        let square = form_of(&[(Vec3::ZERO, Vec3::X, Vec3::Y)]);
        assert!((square.elongation - 1.0).abs() < 1e-12, "{}", square.elongation);
        let needle = form_of(&[(Vec3::ZERO, Vec3::X, Vec3::ZERO)]);
        assert_eq!((needle.area, needle.elongation), (0.0, f64::INFINITY), "no width");
        let point = form_of(&[(Vec3::ONE, Vec3::ZERO, Vec3::ZERO)]);
        assert_eq!(point.elongation, 1.0, "a point");
        assert!(point.center.abs_diff_eq(DVec3::ONE, 1e-15), "{}", point.center);
    }

    #[test]
    fn closed_and_doubled_pieces_show_a_quarter() {
        let side = |n: Vec3, u: Vec3| (n, u, n.cross(u));
        let axes = [Vec3::X, Vec3::Y, Vec3::Z];
        let cube: Vec<_> = (0..3)
            .flat_map(|i| [side(axes[i], axes[(i + 1) % 3]), side(-axes[i], axes[(i + 1) % 3])])
            .collect();
        assert_eq!(form_of(&cube).seen_share, 0.25, "a cube");
        assert_eq!(form_of(&cube).normal, DVec3::ZERO, "which faces nowhere");
        let twice = [(Vec3::ZERO, Vec3::X, Vec3::Y); 2];
        assert_eq!(form_of(&twice).seen_share, 0.25, "two faces in one place");
        let crossed = [(Vec3::ZERO, Vec3::X, Vec3::Y), (Vec3::ZERO, Vec3::Z, Vec3::Y)];
        assert_eq!(form_of(&crossed).seen_share, 0.5, "two cards across one another");
    }

    #[test]
    fn wood_falls_into_connected_pieces_and_leaves_stay_whole() {
        // two strips of two quads that share an edge each, then a leaf of two materials
        let quad = |x: f32, y: f32| (Vec3::new(x, y, 0.0), Vec3::X * 0.5, Vec3::Y * 0.5);
        let mesh = quads(&[quad(0.0, 0.0), quad(5.0, 0.0), quad(1.0, 0.0), quad(9.0, 0.0)]);
        let materials = [0, 0, 0, 0, 0, 0, 1, 0];
        let job = Job::default();
        let found = pieces(&mesh, &materials, 6, &[0, 2], None, &job).expect("not cancelled");
        let facts: Vec<_> =
            found.iter().map(|p| (&p.triangles[..], p.material, p.is_wood)).collect();
        let expected: [(&[u32], u32, bool); 4] =
            [(&[0, 1, 4, 5], 0, true), (&[2, 3], 0, true), (&[7], 0, false), (&[6], 1, false)];
        assert_eq!(facts, expected, "by first triangle, then by material");
        job.cancel();
        assert!(pieces(&mesh, &materials, 6, &[0, 2], None, &job).is_err(), "cancelled");
    }
}
