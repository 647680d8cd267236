//! The quad that stands for each leaf of a plant before anything collapses.
//!
//! A leaf of two triangles that share an edge, of one material, is a quad already and stays as it
//! is. Any other leaf gets the smallest rectangle around it in its own plane, scaled about its centre
//! to the leaf's area, in the material that most of the leaf has, with its mean colours there. The
//! texture coordinates of such a rectangle are those of the affine map that fits the leaf's own best;
//! where no affine map comes near them, as with several cards in one leaf, those of its largest
//! triangle, kept inside what the leaf uses.

use glam::{DVec2, DVec3, Vec2, Vec3, Vec4};

use crate::error::LodError;
use crate::job::Job;
use crate::plant::leaf_rectangle::{Rectangle3, leaf_rectangle};
use crate::plant::{Foliage, Plant};

/// Mean square by which a fitted map may miss texture coordinates, as a share of their variance.
const MISFIT_SHARE: f64 = 0.05;

/// A determinant this small, as a share of the product of the variances, spans no plane.
const FLAT_SHARE: f64 = 1e-9;

/// A leaf as a quad, with what drawing it needs.
#[derive(Debug, Clone, PartialEq)]
pub struct LeafQuad {
    /// In order around it, cut along 0 and 2; relative to the plant's origin.
    pub corners: [Vec3; 4],
    /// Unit length, or zero.
    pub normals: [Vec3; 4],
    /// v = 0 on the texture's top row.
    pub uvs: [Vec2; 4],
    /// Linear base colour with straight alpha.
    pub base: [Vec4; 4],
    /// Linear lit colour of the side from which the corners run counter-clockwise.
    pub front: [Vec3; 4],
    /// Linear lit colour of the other side.
    pub back: [Vec3; 4],
    /// Index into the plant's materials.
    pub material: u32,
    /// The first triangle of the leaf, among those of the foliage.
    pub triangle: u32,
}

/// The quads of all leaves, in their order.
///
/// # Errors
/// [`LodError::Cancelled`].
pub fn leaf_quads(plant: &Plant, job: &Job) -> Result<Vec<LeafQuad>, LodError> {
    let materials: Vec<u32> = plant.foliage.mesh.triangle_materials().collect();
    let foliage = &plant.foliage;
    job.collect(foliage.leaf_count(), |leaf| {
        own_quad(foliage, leaf, &materials).unwrap_or_else(|| rectangle(foliage, leaf, &materials))
    })
}

/// The quad that a leaf is, if it is one.
fn own_quad(foliage: &Foliage, leaf: usize, materials: &[u32]) -> Option<LeafQuad> {
    let triangles = foliage.triangles_of(leaf);
    let mesh = &foliage.mesh;
    let (first, second) = (triangles.start, triangles.start + 1);
    if triangles.len() != 2 || materials[first] != materials[second] {
        return None;
    }
    let at = |vertex: u32| mesh.positions[vertex as usize];
    let shared = |vertex: u32, others: [u32; 3]| others.iter().any(|&o| at(o) == at(vertex));
    let (one, two) = (mesh.triangles[first], mesh.triangles[second]);
    // the corner of each that the other lacks; vertices may be doubled at seams
    let lone = |corners: [u32; 3], others: [u32; 3]| {
        let mut lone = (0..3).filter(|&k| !shared(corners[k], others));
        lone.next().filter(|_| lone.next().is_none())
    };
    let (apex, other) = (lone(one, two)?, lone(two, one)?);
    let [from, to] = [one[(apex + 1) % 3], one[(apex + 2) % 3]];
    // triangle (apex, from, to) and, across the edge, (other, to, from)
    let is_turned = at(two[(other + 1) % 3]) != at(to);
    let vertices = [to, one[apex], from, two[other]].map(|vertex| vertex as usize);
    let lit = |corner: usize| {
        let (front, back) = (mesh.front[vertices[corner]], mesh.back[vertices[corner]]);
        if corner == 3 && is_turned { (back, front) } else { (front, back) }
    };
    let corners = [0, 1, 2, 3];
    Some(LeafQuad {
        corners: vertices.map(|vertex| mesh.positions[vertex]),
        normals: vertices.map(|vertex| mesh.normals[vertex]),
        uvs: vertices.map(|vertex| mesh.uvs[vertex]),
        base: vertices.map(|vertex| mesh.base[vertex]),
        front: corners.map(|corner| lit(corner).0),
        back: corners.map(|corner| lit(corner).1),
        material: materials[first],
        triangle: u32::try_from(first).expect("checked by the plant"),
    })
}

/// The rectangle that stands for a leaf.
fn rectangle(foliage: &Foliage, leaf: usize, materials: &[u32]) -> LeafQuad {
    let rectangle = leaf_rectangle(foliage, leaf);
    let material = main_material(foliage, leaf, materials);
    let area = f64::from(foliage.areas[leaf]);
    let rectangle_area = 4.0 * rectangle.half.x * rectangle.half.y;
    let scale =
        if rectangle_area > 0.0 && area > 0.0 { (area / rectangle_area).sqrt() } else { 1.0 };
    let center = foliage.centers[leaf].as_dvec3();
    let corners = rectangle.corners().map(|corner| center + (corner - center) * scale);
    let colors = Colors::of(foliage, leaf, material, materials);
    LeafQuad {
        corners: corners.map(|corner| corner.as_vec3()),
        normals: [foliage.normals[leaf]; 4],
        uvs: texture_corners(foliage, leaf, material, materials, &rectangle),
        base: [colors.base; 4],
        front: [colors.front; 4],
        back: [colors.back; 4],
        material,
        triangle: foliage.leaf_offsets[leaf],
    }
}

/// The material with the largest area in a leaf; of equals, the lower index.
fn main_material(foliage: &Foliage, leaf: usize, materials: &[u32]) -> u32 {
    let triangles = foliage.triangles_of(leaf);
    let mut areas: Vec<(u32, f64)> = Vec::new();
    for triangle in triangles.clone() {
        let (material, area) = (materials[triangle], vector_area(foliage, triangle).length());
        match areas.iter_mut().find(|known| known.0 == material) {
            Some(known) => known.1 += area,
            None => areas.push((material, area)),
        }
    }
    areas.sort_by_key(|known| known.0);
    let first = areas[0];
    areas.into_iter().fold(first, |best, next| if next.1 > best.1 { next } else { best }).0
}

fn vector_area(foliage: &Foliage, triangle: usize) -> DVec3 {
    let [a, b, c] = foliage.mesh.corners(triangle).map(|p| p.as_dvec3());
    (b - a).cross(c - a) * 0.5
}

/// Means over the area that a leaf has of one material; plain means of the corners without area.
struct Colors {
    base: Vec4,
    front: Vec3,
    back: Vec3,
}

impl Colors {
    fn of(foliage: &Foliage, leaf: usize, material: u32, materials: &[u32]) -> Self {
        let mesh = &foliage.mesh;
        let normal = foliage.normals[leaf].as_dvec3();
        let mut sums = [[0.0; 10]; 2];
        let mut weights = [0.0; 2];
        for triangle in foliage.triangles_of(leaf).filter(|&t| materials[t] == material) {
            let across = vector_area(foliage, triangle);
            // seen from where the leaf's normal points to
            let is_turned = across.dot(normal) < 0.0;
            for vertex in mesh.triangles[triangle].map(|vertex| vertex as usize) {
                let (front, back) = (mesh.front[vertex], mesh.back[vertex]);
                let (front, back) = if is_turned { (back, front) } else { (front, back) };
                let base = mesh.base[vertex];
                let row = [
                    base.x, base.y, base.z, base.w, front.x, front.y, front.z, back.x, back.y,
                    back.z,
                ];
                for (kind, weight) in [across.length(), 1.0].into_iter().enumerate() {
                    weights[kind] += weight;
                    for (sum, value) in sums[kind].iter_mut().zip(row) {
                        *sum += f64::from(value) * weight;
                    }
                }
            }
        }
        let kind = usize::from(weights[0] <= 0.0);
        #[expect(clippy::cast_possible_truncation, reason = "colours are stored in f32")]
        let mean = sums[kind].map(|sum| (sum / weights[kind]) as f32);
        Self {
            base: Vec4::new(mean[0], mean[1], mean[2], mean[3]),
            front: Vec3::new(mean[4], mean[5], mean[6]),
            back: Vec3::new(mean[7], mean[8], mean[9]),
        }
    }
}

/// Texture coordinates of a rectangle's corners.
fn texture_corners(
    foliage: &Foliage,
    leaf: usize,
    material: u32,
    materials: &[u32],
    rectangle: &Rectangle3,
) -> [Vec2; 4] {
    let mesh = &foliage.mesh;
    let place = |p: Vec3| {
        let offset = p.as_dvec3() - rectangle.center;
        DVec2::new(offset.dot(rectangle.along), offset.dot(rectangle.across))
    };
    let mut largest = (usize::MAX, -1.0);
    let mut samples: Vec<(DVec2, DVec2, f64)> = Vec::new();
    for triangle in foliage.triangles_of(leaf).filter(|&t| materials[t] == material) {
        let area = vector_area(foliage, triangle).length();
        if area > largest.1 {
            largest = (triangle, area);
        }
        samples.extend(mesh.triangles[triangle].map(|vertex| {
            let vertex = vertex as usize;
            (place(mesh.positions[vertex]), mesh.uvs[vertex].as_dvec2(), area)
        }));
    }
    let first = samples[0].1;
    let (low, high) =
        samples.iter().fold((first, first), |(low, high), s| (low.min(s.1), high.max(s.1)));
    if low == high {
        return [first.as_vec2(); 4];
    }
    let half = rectangle.half;
    let corners = [-half, DVec2::new(half.x, -half.y), half, DVec2::new(-half.x, half.y)];
    let map = fit(&samples).or_else(|| {
        let corners = mesh.triangles[largest.0].map(|vertex| {
            let vertex = vertex as usize;
            (place(mesh.positions[vertex]), mesh.uvs[vertex].as_dvec2(), 1.0)
        });
        fit(&corners)
    });
    match map {
        Some(map) => corners.map(|corner| map.at(corner).clamp(low, high).as_vec2()),
        // a leaf without area: all of what it uses, upright
        None => [low, DVec2::new(high.x, low.y), high, DVec2::new(low.x, high.y)]
            .map(|corner| corner.as_vec2()),
    }
}

/// `uv = origin + x_axis x + y_axis y`.
struct Affine {
    origin: DVec2,
    x_axis: DVec2,
    y_axis: DVec2,
}

impl Affine {
    fn at(&self, point: DVec2) -> DVec2 {
        self.origin + self.x_axis * point.x + self.y_axis * point.y
    }
}

/// The affine map from places to texture coordinates with the least weighted square error, if the
/// places span a plane and it explains the coordinates.
fn fit(samples: &[(DVec2, DVec2, f64)]) -> Option<Affine> {
    let weight: f64 = samples.iter().map(|sample| sample.2).sum();
    if weight <= 0.0 {
        return None;
    }
    let mean = |of: &dyn Fn(&(DVec2, DVec2, f64)) -> DVec2| {
        samples.iter().map(|sample| of(sample) * sample.2).sum::<DVec2>() / weight
    };
    let (place, uv) = (mean(&|sample| sample.0), mean(&|sample| sample.1));
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    let (mut xt, mut yt, mut tt) = (DVec2::ZERO, DVec2::ZERO, 0.0);
    for &(at, target, weight) in samples {
        let (at, target) = (at - place, target - uv);
        xx += at.x * at.x * weight;
        xy += at.x * at.y * weight;
        yy += at.y * at.y * weight;
        xt += target * (at.x * weight);
        yt += target * (at.y * weight);
        tt += target.length_squared() * weight;
    }
    let determinant = xx * yy - xy * xy;
    if determinant <= FLAT_SHARE * xx * yy {
        return None;
    }
    let x_axis = (xt * yy - yt * xy) / determinant;
    let y_axis = (yt * xx - xt * xy) / determinant;
    let explained = x_axis.dot(xt) + y_axis.dot(yt);
    let origin = uv - x_axis * place.x - y_axis * place.y;
    (tt - explained <= MISFIT_SHARE * tt).then_some(Affine { origin, x_axis, y_axis })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::Mesh;

    /// A leaf of some triangles over points of the plane z = 0, each with its own coordinates as uv.
    fn foliage(points: &[[f32; 2]], triangles: &[[u32; 3]], offsets: &[u32]) -> Foliage {
        let count = points.len();
        let gray = |k: usize| Vec3::splat(0.1 * (k + 1) as f32);
        let mesh = Mesh {
            positions: points.iter().map(|&[x, y]| Vec3::new(x, y, 0.0)).collect(),
            normals: vec![Vec3::Z; count],
            uvs: points.iter().map(|&[x, y]| Vec2::new(x, 1.0 - y)).collect(),
            base: vec![Vec4::ONE; count],
            front: (0..count).map(gray).collect(),
            back: (0..count).map(|k| -gray(k)).collect(),
            triangles: triangles.to_vec(),
            parts: Mesh::parts_from_ids(&vec![0; triangles.len()]),
        };
        Foliage::new(mesh, offsets.to_vec(), &Job::default()).expect("valid")
    }

    fn quad_of(foliage: &Foliage) -> LeafQuad {
        let materials: Vec<u32> = foliage.mesh.triangle_materials().collect();
        own_quad(foliage, 0, &materials).unwrap_or_else(|| rectangle(foliage, 0, &materials))
    }

    #[test]
    fn two_triangles_on_an_edge_are_a_quad_already() {
        //  3---2      cut along 0 and 2, whatever corner a triangle begins with
        //  | / |
        //  0---1
        let points = [[0.0, 0.0], [2.0, 0.0], [2.5, 1.0], [0.0, 1.0]];
        for triangles in [[[0, 1, 2], [0, 2, 3]], [[2, 0, 1], [3, 0, 2]], [[0, 2, 3], [1, 2, 0]]] {
            let quad = quad_of(&foliage(&points, &triangles, &[0, 2]));
            let corners = quad.corners.map(|p| [p.x, p.y]);
            let cut = [corners[0], corners[2]];
            assert!(cut == [points[0], points[2]] || cut == [points[2], points[0]], "{corners:?}");
            let first = points.iter().position(|p| *p == corners[0]).expect("one of them");
            let around = [0, 1, 2, 3].map(|k| points[(first + k) % 4]);
            assert_eq!(corners, around, "counter-clockwise");
            let own = corners.map(|p| Vec2::new(p[0], 1.0 - p[1]));
            assert_eq!(quad.uvs, own, "each with its own coordinates");
            let gray = |p: [f32; 2]| points.iter().position(|q| *q == p).expect("one of them") + 1;
            let front = corners.map(|p| Vec3::splat(0.1 * gray(p) as f32));
            assert_eq!((quad.front, quad.back), (front, front.map(|c| -c)), "and colours");
        }
    }

    #[test]
    fn a_seam_and_a_turned_triangle_are_no_hindrance() {
        let points = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 0.0], [2.0, 1.0], [0.0, 1.0]];
        let seam = quad_of(&foliage(&points, &[[0, 1, 2], [3, 4, 5]], &[0, 2]));
        let around = [points[0], points[1], points[2], points[5]];
        assert_eq!(seam.corners.map(|p| [p.x, p.y]), around, "four places");
        let turned = quad_of(&foliage(&points, &[[0, 1, 2], [3, 5, 4]], &[0, 2]));
        assert_eq!(turned.corners, seam.corners, "the same quad");
        assert_eq!(turned.front[3], seam.back[3], "whose last corner was lit from behind");
        assert_eq!(turned.front[..3], seam.front[..3], "and no other");
    }

    #[test]
    fn other_leaves_get_a_rectangle_of_their_area() {
        //      2        a triangle of area 1 in a rectangle of 2 by 1: scaled by sqrt(1/2)
        //     / \       about its centre (1, 1/3)
        //    0---1
        let quad = quad_of(&foliage(&[[0.0, 0.0], [2.0, 0.0], [1.0, 1.0]], &[[0, 1, 2]], &[0, 1]));
        let s = 0.5_f32.sqrt();
        let expected = [[-1.0, -1.0 / 3.0], [1.0, -1.0 / 3.0], [1.0, 2.0 / 3.0], [-1.0, 2.0 / 3.0]];
        for (corner, [x, y]) in quad.corners.iter().zip(expected) {
            let wanted = Vec3::new(1.0 + x * s, 1.0 / 3.0 + y * s, 0.0);
            assert!(corner.distance(wanted) < 1e-6, "{corner} for {wanted}");
        }
        // all of the texture that the leaf uses
        let uvs = [[0.0, 1.0], [2.0, 1.0], [2.0, 0.0], [0.0, 0.0]].map(Vec2::from_array);
        for (uv, wanted) in quad.uvs.iter().zip(uvs) {
            assert!(uv.distance(wanted) < 1e-6, "{uv} for {wanted}");
        }
        // the mean of 0.1, 0.2 and 0.3
        assert!((quad.front[0].x - 0.2).abs() < 1e-6, "{}", quad.front[0]);
        assert!((quad.back[0].x + 0.2).abs() < 1e-6, "{}", quad.back[0]);
    }

    #[test]
    fn several_cards_in_one_leaf_keep_one_cards_coordinates() {
        // three cards side by side, each with the whole texture
        let mut points = Vec::new();
        let mut triangles = Vec::new();
        for card in 0..3_u8 {
            let (x, first) = (f32::from(card), u32::from(card) * 4);
            points.extend([[x, 0.0], [x + 1.0, 0.0], [x + 1.0, 1.0], [x, 1.0]]);
            triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        let mut foliage = foliage(&points, &triangles, &[0, 6]);
        for uv in &mut foliage.mesh.uvs {
            uv.x = 0.0;
        }
        for (vertex, uv) in foliage.mesh.uvs.iter_mut().enumerate() {
            uv.x = if matches!(vertex % 4, 1 | 2) { 1.0 } else { 0.0 };
        }
        let quad = quad_of(&foliage);
        let [low, high] = [[0.0, 1.0], [1.0, 0.0]].map(Vec2::from_array);
        let inside = |uv: Vec2| uv.x >= low.x && uv.x <= high.x && uv.y >= 0.0 && uv.y <= 1.0;
        assert!(quad.uvs.into_iter().all(inside), "{:?}", quad.uvs);
        let spread = quad.uvs[2] - quad.uvs[0];
        assert_eq!(spread.abs(), Vec2::ONE, "and all of it: {:?}", quad.uvs);
    }

    #[test]
    fn leaves_without_area_stay_lines_and_points() {
        let line = quad_of(&foliage(&[[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]], &[[0, 1, 2]], &[0, 1]));
        let ends = line.corners.map(|p| p.x);
        assert_eq!(ends.iter().copied().fold(f32::INFINITY, f32::min), 0.0, "from end");
        assert_eq!(ends.iter().copied().fold(0.0, f32::max), 3.0, "to end");
        assert!(line.front.iter().all(|c| c.is_finite()), "with a colour");
        let point = quad_of(&foliage(&[[1.0, 1.0]], &[[0, 0, 0]], &[0, 1]));
        assert_eq!(point.corners, [Vec3::new(1.0, 1.0, 0.0); 4], "a point");
    }

    #[test]
    fn the_material_of_most_of_the_area_is_kept() {
        let points = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 4.0]];
        let mut foliage = foliage(&points, &[[0, 1, 2], [0, 2, 3]], &[0, 2]);
        foliage.mesh.parts = Mesh::parts_from_ids(&[0, 1]);
        let quad = quad_of(&foliage);
        assert_eq!(quad.material, 1, "area 4 of 5");
        // the mean of 0.1, 0.3 and 0.4, not 0.2
        assert!((quad.front[0].x - 0.8 / 3.0).abs() < 1e-6, "{}", quad.front[0]);
    }
}
