//! The triangles of single leaves: blades put in their places.

use glam::{DVec3, Vec2, Vec3, Vec4};

use crate::plant::Mesh;
use crate::plant::grow::params::Blade;

/// Where a blade is, and how it is turned.
pub(super) struct Pose {
    pub(super) foot: DVec3,
    /// Unit vector from the foot to the tip.
    pub(super) direction: DVec3,
    /// Unit vector across `direction`, out of the upper side.
    pub(super) normal: DVec3,
    pub(super) length: f64,
    /// See [`Leaves::curl`](crate::plant::grow::params::Leaves::curl).
    pub(super) curl: f64,
}

/// The arrays' parts that belong to one leaf.
pub(super) struct Vertices<'a> {
    pub(super) positions: &'a mut [Vec3],
    pub(super) normals: &'a mut [Vec3],
    pub(super) uvs: &'a mut [Vec2],
    pub(super) base: &'a mut [Vec4],
}

impl Blade {
    /// Writes the vertices of one leaf.
    pub(super) fn write(&self, pose: &Pose, color: DVec3, out: Vertices<'_>) {
        let &Pose { foot, direction, normal, length, curl } = pose;
        let right = direction.cross(normal);
        let points: Vec<DVec3> = self
            .vertices
            .iter()
            .map(|&[x, y, z]| {
                let z = z - curl * (x * x + y * y);
                foot + (right * x + direction * y + normal * z) * length
            })
            .collect();
        write_points(&points, self.triangles, normal, out.positions, out.normals);
        for ((out, uv), vertex) in out.base.iter_mut().zip(out.uvs).zip(self.vertices) {
            // slightly brighter towards the tip
            let shade = 0.9 + 0.15 * vertex[1].clamp(0.0, 1.0);
            *out = (color * shade).as_vec3().min(Vec3::ONE).extend(1.0);
            *uv = DVec3::new(0.5 + 0.5 * vertex[0], 1.0 - vertex[1], 0.0).as_vec3().truncate();
        }
    }
}

/// Writes positions, and normals weighted by area; `normal` where triangles cancel.
fn write_points(
    points: &[DVec3],
    triangles: &[[u8; 3]],
    normal: DVec3,
    positions: &mut [Vec3],
    normals: &mut [Vec3],
) {
    for (out, point) in positions.iter_mut().zip(points) {
        *out = point.as_vec3();
    }
    let mut sums = vec![DVec3::ZERO; points.len()];
    for &corners in triangles {
        let [a, b, c] = corners.map(|corner| points[usize::from(corner)]);
        let area = (b - a).cross(c - a);
        for corner in corners {
            sums[usize::from(corner)] += area;
        }
    }
    for (out, sum) in normals.iter_mut().zip(&sums) {
        *out = sum.normalize_or(normal).as_vec3();
    }
}

/// Foliage that grows leaf by leaf.
pub(super) struct Elements {
    pub(super) mesh: Mesh,
    /// Leaf `i` is triangles `offsets[i]..offsets[i + 1]`.
    pub(super) offsets: Vec<u32>,
    /// Stem of each leaf.
    pub(super) owners: Vec<u32>,
}

impl Elements {
    pub(super) fn new() -> Self {
        Self { mesh: Mesh::default(), offsets: vec![0], owners: Vec::new() }
    }

    /// Adds a blade.
    pub(super) fn push(&mut self, owner: u32, blade: &Blade, pose: &Pose, color: DVec3) {
        let first = self.make_room(blade.vertices.len());
        let mesh = &mut self.mesh;
        let out = Vertices {
            positions: &mut mesh.positions[first..],
            normals: &mut mesh.normals[first..],
            uvs: &mut mesh.uvs[first..],
            base: &mut mesh.base[first..],
        };
        blade.write(pose, color, out);
        self.close(owner, first, blade.triangles);
    }

    /// Adds triangles that are no blade's. `normal` is theirs where they cancel.
    pub(super) fn push_points(
        &mut self,
        owner: u32,
        points: &[DVec3],
        triangles: &[[u8; 3]],
        normal: DVec3,
        colors: impl Iterator<Item = DVec3>,
    ) {
        let first = self.make_room(points.len());
        let mesh = &mut self.mesh;
        let (positions, normals) = (&mut mesh.positions[first..], &mut mesh.normals[first..]);
        write_points(points, triangles, normal, positions, normals);
        for (out, color) in mesh.base[first..].iter_mut().zip(colors) {
            *out = color.as_vec3().min(Vec3::ONE).extend(1.0);
        }
        self.close(owner, first, triangles);
    }

    /// Adds leaf `leaf` of a mesh in which every leaf is a `blade`.
    pub(super) fn copy(&mut self, owner: u32, blade: &Blade, leaves: &Mesh, leaf: usize) {
        let per_leaf = blade.vertices.len();
        let from = leaf * per_leaf..(leaf + 1) * per_leaf;
        let first = self.mesh.positions.len();
        self.mesh.positions.extend_from_slice(&leaves.positions[from.clone()]);
        self.mesh.normals.extend_from_slice(&leaves.normals[from.clone()]);
        self.mesh.uvs.extend_from_slice(&leaves.uvs[from.clone()]);
        self.mesh.base.extend_from_slice(&leaves.base[from]);
        self.close(owner, first, blade.triangles);
    }

    fn make_room(&mut self, count: usize) -> usize {
        let first = self.mesh.positions.len();
        let all = first + count;
        self.mesh.positions.resize(all, Vec3::ZERO);
        self.mesh.normals.resize(all, Vec3::ZERO);
        self.mesh.uvs.resize(all, Vec2::ZERO);
        self.mesh.base.resize(all, Vec4::ONE);
        first
    }

    fn close(&mut self, owner: u32, first: usize, triangles: &[[u8; 3]]) {
        let index = |count: usize| u32::try_from(count).expect("the leaf limit keeps to u32");
        let corners = |t: &[u8; 3]| t.map(|corner| index(first + usize::from(corner)));
        self.mesh.triangles.extend(triangles.iter().map(corners));
        self.offsets.push(index(self.mesh.triangles.len()));
        self.owners.push(owner);
    }
}
