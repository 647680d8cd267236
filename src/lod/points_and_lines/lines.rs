//! The line that stands for a long thin piece: a blade, a needle, a twig.
//!
//! It lies along the piece's main axis through its centre, from the lowest vertex along that axis to
//! the highest. Its *deviation* is the largest distance of a vertex from it. Each end has the mean
//! colour of the piece, weighted towards that end, where it is opaque.
//!
//! A flat piece faces where its surface faces. A closed one faces everywhere; it gets the side of its
//! axis that looks towards the sun, so that it is bright from the sun's side and dark from the other.

use glam::{DVec3, Vec3, Vec4};

use crate::lod::points_and_lines::opaque::Cover;
use crate::lod::points_and_lines::pieces::Form;
use crate::plant::Mesh;
use crate::plant::mesh::area_normal;

/// An end of a line, as it is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct End {
    /// Metres, relative to the plant's origin.
    pub position: Vec3,
    /// Linear unlit colour; opaque.
    pub base: Vec4,
    /// Linear lit colour of the side that the normal points to.
    pub front: Vec3,
    /// Of the other side.
    pub back: Vec3,
}

/// A piece as a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// From the lowest end along the axis.
    pub ends: [End; 2],
    /// Unit length, or zero for a piece without area.
    pub normal: Vec3,
    /// Metres.
    pub length: f64,
    /// Largest distance of a vertex from the line, in metres.
    pub deviation: f64,
}

/// Where a piece's line begins and ends, as offsets along the axis from its centre, and how far its
/// vertices are from it.
pub fn reach(mesh: &Mesh, triangles: &[u32], form: &Form) -> ([f64; 2], f64) {
    let (mut low, mut high, mut deviation) = (f64::INFINITY, f64::NEG_INFINITY, 0.0_f64);
    for corner in triangles.iter().flat_map(|&t| mesh.corners(t as usize)) {
        let from = corner.as_dvec3() - form.center;
        let along = from.dot(form.axis);
        low = low.min(along);
        high = high.max(along);
        // not the root of a difference, which cancels for thin pieces
        deviation = deviation.max((from - form.axis * along).length());
    }
    ([low, high], deviation)
}

/// The line of a piece.
pub fn line(mesh: &Mesh, triangles: &[u32], form: &Form, cover: &Cover<'_>, sun: DVec3) -> Line {
    let ([low, high], deviation) = reach(mesh, triangles, form);
    let length = high - low;
    let is_closed = form.normal == DVec3::ZERO;
    let normal = if is_closed {
        (sun - form.axis * sun.dot(form.axis)).normalize_or(form.axis.any_orthonormal_vector())
    } else {
        form.normal.normalize_or_zero()
    };
    // base, front and back of both ends, with the weights of each
    let mut sums = [[(DVec3::ZERO, 0.0); 3]; 2];
    for &triangle in triangles {
        let corners = mesh.corners(triangle as usize);
        let vector = area_normal(corners);
        let (texel, share) = cover.mean(mesh, triangle as usize);
        let area = vector.length() * f64::from(share);
        let middle = corners.iter().map(|p| p.as_dvec3()).sum::<DVec3>() / 3.0;
        let along = (middle - form.center).dot(form.axis) - low;
        let at = if length > 0.0 { (along / length).clamp(0.0, 1.0) } else { 0.5 };
        let vertices = mesh.triangles[triangle as usize].map(|v| v as usize);
        let mean = |colors: &[Vec3]| -> DVec3 {
            let sum: Vec3 = vertices.iter().map(|&v| colors[v]).sum();
            (sum * texel).as_dvec3() / 3.0
        };
        let (front, back) = (mean(&mesh.front), mean(&mesh.back));
        let base = vertices.iter().map(|&v| mesh.base[v].truncate()).sum::<Vec3>() * texel;
        let facing = vector.dot(normal);
        // what is seen from the normal's side and from the other, and how much of it
        let sides = if is_closed {
            let seen = facing.abs() * f64::from(share);
            if facing >= 0.0 {
                [(front, seen), (front, 0.0)]
            } else {
                [(front, 0.0), (front, seen)]
            }
        } else if facing >= 0.0 {
            [(front, area), (back, area)]
        } else {
            [(back, area), (front, area)]
        };
        let colors = [(base.as_dvec3() / 3.0, area), sides[0], sides[1]];
        for (end, toward) in sums.iter_mut().zip([1.0 - at, at]) {
            for ((sum, weights), (color, weight)) in end.iter_mut().zip(colors) {
                *sum += color * (weight * toward);
                *weights += weight * toward;
            }
        }
    }
    let ends = [(low, 0), (high, 1)].map(|(along, number)| {
        let of = |kind: usize| {
            let (sum, weight) = sums[number][kind];
            let (other_sum, other) = sums[1 - number][kind];
            // a piece of one triangle may have nothing towards an end
            if weight > 0.0 {
                sum / weight
            } else if other > 0.0 {
                other_sum / other
            } else {
                DVec3::ZERO
            }
        };
        End {
            position: (form.center + form.axis * along).as_vec3(),
            base: of(0).as_vec3().extend(1.0),
            front: of(1).as_vec3(),
            back: of(2).as_vec3(),
        }
    });
    Line { ends, normal: normal.as_vec3(), length, deviation }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::Job;
    use crate::lod::made::{Leaf, quads};
    use crate::lod::points_and_lines::pieces::{Piece, forms};
    use crate::plant::{AlphaMode, Material};
    use crate::texture::Sampler;

    fn line_of(mesh: &Mesh, sun: DVec3) -> Line {
        let count = u32::try_from(mesh.triangles.len()).expect("few");
        let piece = Piece { triangles: (0..count).collect(), material: 0, is_wood: false };
        let form = forms(mesh, std::slice::from_ref(&piece), &Job::default()).expect("runs")[0];
        let material = Material {
            name: "white".to_owned(),
            texture: None,
            sampler: Sampler::default(),
            alpha_mode: AlphaMode::Opaque,
            double_sided: true,
        };
        line(mesh, &piece.triangles, &form, &Cover::new(&material), sun)
    }

    fn lit(leaves: &[Leaf], front: impl Fn(Vec3) -> f32) -> Mesh {
        let mut mesh = quads(leaves);
        mesh.front = mesh.positions.iter().map(|&p| Vec3::splat(front(p))).collect();
        mesh.back = mesh.front.iter().map(|c| *c * 0.5).collect();
        mesh
    }

    #[test]
    fn a_blade_by_hand() {
        // 0.5 by 8 along y, its middle at (1, 0, 0), brighter at the top
        let mesh = lit(&[(Vec3::X, Vec3::X * 0.25, Vec3::Y * 4.0)], |p| (p.y + 4.0) / 8.0);
        let found = line_of(&mesh, DVec3::Y);
        let at = found.ends.map(|end| end.position);
        let (up, down) = (Vec3::new(1.0, 4.0, 0.0), Vec3::new(1.0, -4.0, 0.0));
        assert!(at == [down, up] || at == [up, down], "{at:?}");
        assert_eq!((found.length, found.deviation), (8.0, 0.25), "half as wide as the blade");
        assert_eq!(found.normal, Vec3::Z, "faces as the blade does");
        // triangle means are 1/3 and 2/3, at 1/3 and 2/3 of the way
        let upper = usize::from(at[1] == up);
        let bright = [found.ends[1 - upper], found.ends[upper]].map(|end| end.front.x);
        let expected = [1.0 / 3.0 * 2.0 / 3.0 + 2.0 / 3.0 / 3.0, 2.0 / 3.0 * 2.0 / 3.0 + 1.0 / 9.0];
        for (found, expected) in bright.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6, "{bright:?}");
        }
        assert!((found.ends[0].back - found.ends[0].front * 0.5).length() < 1e-6, "other side");
    }

    #[test]
    fn a_twig_is_bright_towards_the_sun() {
        // four sides along y; the one towards +x is lit
        let sides = [Vec3::X, Vec3::Z, -Vec3::X, -Vec3::Z];
        let leaves = sides.map(|out| (out * 0.1, out.cross(Vec3::Y) * 0.1, Vec3::Y * -2.0));
        let mesh = lit(&leaves, |p| if p.x > 0.05 { 1.0 } else { 0.0 });
        let found = line_of(&mesh, DVec3::new(1.0, 5.0, 0.0));
        assert!(found.normal.abs_diff_eq(Vec3::X, 1e-6), "across the axis: {}", found.normal);
        assert!(found.ends[0].front.x > 0.9, "from the sun's side: {:?}", found.ends[0]);
        assert!(found.ends[0].back.x < 0.1, "from the other: {:?}", found.ends[0]);
        assert!((found.deviation - 0.02_f64.sqrt()).abs() < 1e-6, "to an edge of the twig");
    }
}
