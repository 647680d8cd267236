//! Triangles with everything that drawing them needs: the wood of a plant, or its foliage.
//!
//! Positions are f32 relative to [`Plant::origin`](crate::plant::Plant::origin), so a plant far
//! from the world's origin keeps its detail.

use std::ops::Range;

use glam::{DVec3, Vec2, Vec3, Vec4};

use crate::error::{Finite, LodError, check_limit};
use crate::job::Job;

/// Vertices or triangles that one mesh may hold: indices are u32 with one value kept back.
pub const MAX_ELEMENT_COUNT: u64 = u32::MAX as u64 - 1;

/// Consecutive triangles that share a material.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Part {
    /// Index into [`Plant::materials`](crate::plant::Plant::materials).
    pub material: u32,
    /// The triangles, as a range of indices into [`Mesh::triangles`].
    pub triangles: Range<u32>,
}

/// Indexed triangles. All per-vertex arrays have the same length.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Metres, relative to the plant's origin.
    pub positions: Vec<Vec3>,
    /// Unit length, or zero where none is known.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, v = 0 on the texture's top row; zero where there is no texture.
    pub uvs: Vec<Vec2>,
    /// Linear base colour (factor times vertex colour) with straight alpha.
    pub base: Vec<Vec4>,
    /// Lit linear colour of the side from which a triangle's corners run counter-clockwise.
    pub front: Vec<Vec3>,
    /// Lit linear colour of the other side.
    pub back: Vec<Vec3>,
    /// Corner indices into the vertex arrays.
    pub triangles: Vec<[u32; 3]>,
    /// Covers `triangles` exactly, in order.
    pub parts: Vec<Part>,
}

impl Mesh {
    /// Whether there is nothing to draw.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// The three corners of a triangle.
    #[inline]
    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        let at = |vertex: u32| self.positions[vertex as usize];
        let [a, b, c] = self.triangles[triangle];
        [at(a), at(b), at(c)]
    }

    /// Smallest box around every vertex that a triangle uses, or `None` without triangles.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let mut corners = self.triangles.iter().flatten().map(|&v| self.positions[v as usize]);
        let first = corners.next()?;
        Some(corners.fold((first, first), |(low, high), p| (low.min(p), high.max(p))))
    }

    /// Sum of all triangle areas, in square metres.
    pub fn area(&self) -> f64 {
        (0..self.triangles.len()).map(|triangle| triangle_area(self.corners(triangle))).sum()
    }

    /// Material of each triangle, in triangle order.
    pub fn triangle_materials(&self) -> impl Iterator<Item = u32> {
        self.parts.iter().flat_map(|part| part.triangles.clone().map(|_| part.material))
    }

    /// Checks lengths, indices, finiteness and that `parts` covers the triangles.
    ///
    /// # Errors
    /// The first thing that is wrong, under the name of the array it is wrong in;
    /// [`LodError::Cancelled`].
    pub fn check(&self, material_count: usize, job: &Job) -> Result<(), LodError> {
        let vertex_count = self.positions.len();
        check_limit("positions", vertex_count as u64, MAX_ELEMENT_COUNT, "vertices")?;
        check_limit("triangles", self.triangles.len() as u64, MAX_ELEMENT_COUNT, "triangles")?;
        let lengths = [
            ("normals", self.normals.len()),
            ("uvs", self.uvs.len()),
            ("colors", self.base.len()),
            ("front", self.front.len()),
            ("back", self.back.len()),
        ];
        for (name, length) in lengths {
            if length != vertex_count {
                let why = format!("has {length} rows for {vertex_count} vertices");
                return Err(LodError::Invalid { name, why });
            }
        }
        check_finite("positions", &self.positions, job)?;
        check_finite("normals", &self.normals, job)?;
        check_finite("uvs", &self.uvs, job)?;
        check_finite("colors", &self.base, job)?;
        if let Some(row) = job.position(&self.base, |color| color.min_element() < 0.0)? {
            let why = format!("row {row} is negative: {:?}", self.base[row].to_array());
            return Err(LodError::Invalid { name: "colors", why });
        }
        let beyond = |corners: &[u32; 3]| corners.iter().any(|&v| v as usize >= vertex_count);
        if let Some(triangle) = job.position(&self.triangles, beyond)? {
            let corners = self.triangles[triangle];
            let why = format!(
                "triangle {triangle} has corners {corners:?} but there are {vertex_count} vertices"
            );
            return Err(LodError::Invalid { name: "triangles", why });
        }
        let mut next = 0;
        for part in &self.parts {
            if part.triangles.start != next || part.triangles.end < next {
                let why = "parts must follow one another without gaps".to_owned();
                return Err(LodError::Invalid { name: "material_ids", why });
            }
            next = part.triangles.end;
            if part.material as usize >= material_count {
                let why = format!("material {} of {material_count}", part.material);
                return Err(LodError::Invalid { name: "material_ids", why });
            }
        }
        if next as usize != self.triangles.len() {
            let why = format!("parts cover {next} of {} triangles", self.triangles.len());
            return Err(LodError::Invalid { name: "material_ids", why });
        }
        Ok(())
    }

    /// Adds another mesh's vertices and triangles after its own; both together are as many as a plant
    /// may have.
    pub fn append(&mut self, other: &Self) {
        let count = |length: usize| u32::try_from(length).expect("checked by the plant");
        let (vertices, triangles) = (count(self.positions.len()), count(self.triangles.len()));
        self.positions.extend_from_slice(&other.positions);
        self.normals.extend_from_slice(&other.normals);
        self.uvs.extend_from_slice(&other.uvs);
        self.base.extend_from_slice(&other.base);
        self.front.extend_from_slice(&other.front);
        self.back.extend_from_slice(&other.back);
        let moved = |corners: &[u32; 3]| corners.map(|vertex| vertex + vertices);
        self.triangles.extend(other.triangles.iter().map(moved));
        self.parts.extend(other.parts.iter().map(|part| Part {
            material: part.material,
            triangles: part.triangles.start + triangles..part.triangles.end + triangles,
        }));
    }

    /// The same triangles with only the vertices they use, in order of first use.
    #[must_use]
    pub fn without_unused_vertices(self) -> Self {
        const UNUSED: u32 = u32::MAX;
        let mut remap = vec![UNUSED; self.positions.len()];
        let mut used = Self { triangles: self.triangles, parts: self.parts, ..Self::default() };
        for vertex in used.triangles.iter_mut().flatten() {
            let old = *vertex as usize;
            if remap[old] == UNUSED {
                remap[old] = u32::try_from(used.positions.len()).expect("fewer than before");
                used.positions.push(self.positions[old]);
                used.normals.push(self.normals[old]);
                used.uvs.push(self.uvs[old]);
                used.base.push(self.base[old]);
                used.front.push(self.front[old]);
                used.back.push(self.back[old]);
            }
            *vertex = remap[old];
        }
        used
    }

    /// Consecutive parts from one material id a triangle.
    pub fn parts_from_ids(material_ids: &[u32]) -> Vec<Part> {
        let mut parts: Vec<Part> = Vec::new();
        for (triangle, &material) in (0_u32..).zip(material_ids) {
            match parts.last_mut() {
                Some(part) if part.material == material => part.triangles.end = triangle + 1,
                _ => parts.push(Part { material, triangles: triangle..triangle + 1 }),
            }
        }
        parts
    }
}

/// As [`error::check_finite`](crate::error::check_finite), for arrays that may be long.
fn check_finite<T: Finite>(name: &'static str, rows: &[T], job: &Job) -> Result<(), LodError> {
    match job.position(rows, |row| !row.all_finite())? {
        None => Ok(()),
        Some(index) => Err(LodError::NotFinite { name, index }),
    }
}

/// Area of a triangle, in f64 so that sums over a crown stay exact enough.
pub fn triangle_area([a, b, c]: [Vec3; 3]) -> f64 {
    area_normal([a, b, c]).length()
}

/// Half the cross product of two edges: the normal, as long as the area is large.
pub fn area_normal([a, b, c]: [Vec3; 3]) -> DVec3 {
    let a = a.as_dvec3();
    (b.as_dvec3() - a).cross(c.as_dvec3() - a) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One triangle, and a fourth vertex that nothing uses.
    fn triangle() -> Mesh {
        Mesh {
            positions: vec![Vec3::ZERO, Vec3::X * 3.0, Vec3::Y * 4.0, Vec3::ONE * 99.0],
            normals: vec![Vec3::Z; 4],
            uvs: vec![Vec2::ZERO; 4],
            base: vec![Vec4::ONE; 4],
            front: vec![Vec3::ZERO; 4],
            back: vec![Vec3::ZERO; 4],
            triangles: vec![[0, 1, 2]],
            parts: vec![Part { material: 0, triangles: 0..1 }],
        }
    }

    #[test]
    fn measures_use_only_vertices_of_triangles() {
        let mesh = triangle();
        assert_eq!(mesh.bounds(), Some((Vec3::ZERO, Vec3::new(3.0, 4.0, 0.0))), "without vertex 3");
        assert_eq!(mesh.area(), 6.0, "3 * 4 / 2");
        assert_eq!(area_normal(mesh.corners(0)), DVec3::Z * 6.0, "counter-clockwise from +z");
        assert_eq!(Mesh::default().bounds(), None, "nothing");
    }

    #[test]
    fn a_mesh_appended_to_another_keeps_its_triangles() {
        let mut both = triangle();
        let second = Mesh {
            base: vec![Vec4::ZERO; 4],
            front: vec![Vec3::X; 4],
            back: vec![Vec3::Y; 4],
            uvs: vec![Vec2::ONE; 4],
            normals: vec![Vec3::X; 4],
            triangles: vec![[3, 2, 1]],
            parts: vec![Part { material: 1, triangles: 0..1 }],
            ..triangle()
        };
        both.append(&second);
        both.check(2, &Job::default()).expect("valid");
        assert_eq!(both.triangles, [[0, 1, 2], [7, 6, 5]], "corners after the first's vertices");
        assert_eq!((both.corners(0), both.corners(1)), (triangle().corners(0), second.corners(0)));
        assert_eq!(both.triangle_materials().collect::<Vec<_>>(), [0, 1], "each its own");
        assert_eq!((both.normals[4], both.uvs[4], both.base[4]), (Vec3::X, Vec2::ONE, Vec4::ZERO));
        assert_eq!((both.front[4], both.back[4]), (Vec3::X, Vec3::Y), "its light");
        let mut alone = Mesh::default();
        alone.append(&second);
        assert_eq!(alone, second, "to nothing");
    }

    #[test]
    fn parts_follow_the_ids() {
        let parts = Mesh::parts_from_ids(&[1, 1, 0, 1]);
        let of = |material, triangles| Part { material, triangles };
        assert_eq!(parts, [of(1, 0..2), of(0, 2..3), of(1, 3..4)], "runs of equal ids");
        let mesh = Mesh { parts, ..Mesh::default() };
        assert_eq!(mesh.triangle_materials().collect::<Vec<_>>(), [1, 1, 0, 1], "and back");
    }

    #[test]
    fn check_names_what_is_wrong() {
        let says = |change: &dyn Fn(&mut Mesh)| {
            let mut mesh = triangle();
            change(&mut mesh);
            mesh.check(1, &Job::default()).map_err(|error| error.to_string())
        };
        assert_eq!(says(&|_| ()), Ok(()), "valid");
        type Case<'a> = (&'a dyn Fn(&mut Mesh), &'a str);
        let cases: [Case<'_>; 8] = [
            (&|m| m.normals.truncate(3), "normals: has 3 rows for 4 vertices"),
            (&|m| m.uvs.push(Vec2::ZERO), "uvs: has 5 rows for 4 vertices"),
            (&|m| m.positions[3].x = f32::NAN, "positions must be finite: element 3 is not"),
            (&|m| m.base[1].w = f32::INFINITY, "colors must be finite: element 1 is not"),
            (
                &|m| m.triangles[0][2] = 4,
                "triangles: triangle 0 has corners [0, 1, 4] but there are 4 vertices",
            ),
            (&|m| m.parts[0].material = 1, "material_ids: material 1 of 1"),
            (&|m| m.parts.clear(), "material_ids: parts cover 0 of 1 triangles"),
            (
                &|m| m.parts[0].triangles = 1..2,
                "material_ids: parts must follow one another without gaps",
            ),
        ];
        for (change, message) in cases {
            assert_eq!(says(change), Err(message.to_owned()), "{message}");
        }
    }
}
