//! Where a triangle is opaque, and in which colours: what its texture leaves out is not leaf.
//!
//! Each triangle is looked at in 64 places that are spread evenly: an additive sequence of two numbers,
//! folded into the triangle, that starts elsewhere on each, so that errors do not add up. A material that masks
//! is opaque where alpha reaches its cutoff, as the mesh is drawn; one that blends by as much as alpha
//! says; an opaque one everywhere. Opacities of vertices count as they do for the mesh. Textures are
//! read as the mesh reads them: level 0, bilinear.
//!
//! This work is based on:
//! Martin Roberts. The Unreasonable Effectiveness of Quasirandom Sequences. 2018 (the sequence)

use std::ops::{Add, Mul, Sub};

use glam::{Vec2, Vec3, Vec4Swizzles};

use crate::plant::{AlphaMode, Material, Mesh};
use crate::random::{Purpose, Stream};
use crate::texture::{Filter, Sampler, Texture};

/// Places on a triangle.
pub const LOOK_COUNT: usize = 64;

/// Weights of a triangle's corners.
pub type Weights = [f32; 3];

const LOOK: Purpose = Purpose::named("points_and_lines.look");

/// The places on a triangle.
fn places(triangle: usize) -> [Weights; LOOK_COUNT] {
    const STEPS: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_3];
    let mut stream = Stream::new(0, LOOK, triangle as u64);
    let start = [stream.unit(), stream.unit()];
    std::array::from_fn(|number| {
        weights_of([0, 1].map(|axis| (start[axis] + STEPS[axis] * number as f64).fract()))
    })
}

/// The point of a triangle that a point of the unit square stands for.
#[expect(clippy::cast_possible_truncation, reason = "weights are f32")]
pub fn weights_of([u, v]: [f64; 2]) -> Weights {
    let [u, v] = if u + v > 1.0 { [1.0 - u, 1.0 - v] } else { [u, v] };
    [(1.0 - u - v) as f32, u as f32, v as f32]
}

/// A value between three corners'; exact where all are equal.
pub fn mix<T>([a, b, c]: [T; 3], weights: Weights) -> T
where
    T: Copy + Mul<f32, Output = T> + Add<Output = T> + Sub<Output = T>,
{
    a + (b - a) * weights[1] + (c - a) * weights[2]
}

/// A material, as its triangles are looked at.
pub struct Cover<'a> {
    texture: Option<&'a Texture>,
    sampler: Sampler,
    alpha_mode: AlphaMode,
}

/// What is at a place of a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// 0 to 1.
    pub opacity: f32,
    /// Linear colour of the texture alone; white without one.
    pub texel: Vec3,
}

impl<'a> Cover<'a> {
    /// Of a material.
    pub fn new(material: &'a Material) -> Self {
        Self {
            texture: material.texture.as_deref(),
            sampler: Sampler { filter: Filter::Bilinear, ..material.sampler },
            alpha_mode: material.alpha_mode,
        }
    }

    /// Whether it is the same everywhere on every triangle.
    pub fn is_plain(&self) -> bool {
        self.texture.is_none() && self.alpha_mode == AlphaMode::Opaque
    }

    /// What is at a place of a triangle.
    pub fn look(&self, mesh: &Mesh, triangle: usize, weights: Weights) -> Look {
        let corners = mesh.triangles[triangle].map(|v| v as usize);
        let (texel, alpha) = match self.texture {
            None => (Vec3::ONE, 1.0),
            Some(texture) => {
                let uv: Vec2 = mix(corners.map(|v| mesh.uvs[v]), weights);
                let sampled = texture.sample(self.sampler, uv, 0.0);
                let straight =
                    if sampled.w > 0.0 { sampled.xyz() * (1.0 / sampled.w) } else { Vec3::ZERO };
                (straight, sampled.w)
            }
        };
        let alpha = alpha * mix(corners.map(|v| mesh.base[v].w), weights);
        let opacity = match self.alpha_mode {
            AlphaMode::Opaque => 1.0,
            AlphaMode::Mask { cutoff } => f32::from(u8::from(alpha >= cutoff)),
            AlphaMode::Blend => alpha.clamp(0.0, 1.0),
        };
        Look { opacity, texel }
    }

    /// Share of a triangle that is opaque.
    pub fn share(&self, mesh: &Mesh, triangle: usize) -> f32 {
        if self.is_plain() {
            return 1.0;
        }
        let sum: f32 =
            places(triangle).map(|weights| self.look(mesh, triangle, weights).opacity).iter().sum();
        sum / LOOK_COUNT as f32
    }

    /// Mean colours of the texture around some points of a triangle: each place counts for the nearest
    /// point, by its opacity; ties go to the first. Where none counts it is the colour at the point.
    pub fn texels(&self, mesh: &Mesh, triangle: usize, points: &[Weights]) -> Vec<Vec3> {
        if self.texture.is_none() {
            return vec![Vec3::ONE; points.len()];
        }
        let corners = mesh.corners(triangle);
        let at = |weights: Weights| mix(corners, weights);
        let mut sums = vec![(Vec3::ZERO, 0.0_f32); points.len()];
        for weights in places(triangle) {
            let look = self.look(mesh, triangle, weights);
            let place = at(weights);
            let mut nearest = (f32::INFINITY, 0);
            for (number, &point) in points.iter().enumerate() {
                let distance = at(point).distance_squared(place);
                if distance < nearest.0 {
                    nearest = (distance, number);
                }
            }
            if let Some((color, weight)) = sums.get_mut(nearest.1) {
                *color += look.texel * look.opacity;
                *weight += look.opacity;
            }
        }
        let mean = |((color, weight), &point): ((Vec3, f32), &Weights)| {
            if weight > 0.0 { color / weight } else { self.look(mesh, triangle, point).texel }
        };
        sums.into_iter().zip(points).map(mean).collect()
    }

    /// Mean colour of a triangle's texture where it is opaque, and that share.
    pub fn mean(&self, mesh: &Mesh, triangle: usize) -> (Vec3, f32) {
        if self.is_plain() {
            return (Vec3::ONE, 1.0);
        }
        let (mut color, mut opacity) = (Vec3::ZERO, 0.0);
        for weights in places(triangle) {
            let look = self.look(mesh, triangle, weights);
            color += look.texel * look.opacity;
            opacity += look.opacity;
        }
        let mean = if opacity > 0.0 { color / opacity } else { Vec3::ZERO };
        (mean, opacity / LOOK_COUNT as f32)
    }

    /// The place of largest opacity, the first of equals.
    pub fn most_opaque(&self, mesh: &Mesh, triangle: usize) -> Weights {
        let mut best = (-1.0, [1.0, 0.0, 0.0]);
        for weights in places(triangle) {
            let opacity = self.look(mesh, triangle, weights).opacity;
            if opacity > best.0 {
                best = (opacity, weights);
            }
        }
        best.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lod::made::{facing, quads};
    use crate::texture::Image;

    /// A quad whose left half is opaque red and whose right half is clear blue.
    fn half_cut() -> (Mesh, Material) {
        let mut mesh = quads(&[facing(0.0, 0.0, 0.0, 1.0)]);
        for (uv, position) in mesh.uvs.iter_mut().zip(&mesh.positions) {
            *uv = (position.truncate() + 1.0) * 0.5;
        }
        let texels = [[255, 0, 0, 255], [0, 0, 255, 0]];
        let row: Vec<[u8; 4]> = (0..64).map(|x| texels[usize::from(x >= 32)]).collect();
        let image = Image::new(64, 1, row).expect("64 texels");
        let material = Material {
            name: "half".to_owned(),
            texture: Some(Texture::new(vec![image]).expect("one level")),
            sampler: Sampler { wrap: [crate::texture::Wrap::Clamp; 2], ..Sampler::default() },
            alpha_mode: AlphaMode::Mask { cutoff: 0.5 },
            double_sided: true,
        };
        (mesh, material)
    }

    #[test]
    fn half_a_leaf_has_half_the_area_and_the_colour_of_what_is_there() {
        let (mesh, material) = half_cut();
        let cover = Cover::new(&material);
        // the lower right triangle has its right angle where nothing is: a quarter is opaque
        let shares = [cover.share(&mesh, 0), cover.share(&mesh, 1)];
        // two of 64 places may fall on the wrong side
        assert!((shares[0] - 0.25).abs() <= 2.0 / 64.0, "{shares:?}");
        assert!((shares[1] - 0.75).abs() <= 2.0 / 64.0, "{shares:?}");
        for triangle in 0..2 {
            assert_eq!(cover.mean(&mesh, triangle).0, Vec3::X, "no blue in triangle {triangle}");
            let points = [weights_of([0.1, 0.1]), weights_of([0.5, 0.4])];
            let texels = cover.texels(&mesh, triangle, &points);
            assert!(texels.contains(&Vec3::X) && texels[0].x + texels[1].x >= 1.0, "{texels:?}");
            let best = cover.most_opaque(&mesh, triangle);
            assert_eq!(cover.look(&mesh, triangle, best).opacity, 1.0, "an opaque place");
        }
        let opaque = Material { alpha_mode: AlphaMode::Opaque, ..material.clone() };
        assert_eq!(Cover::new(&opaque).share(&mesh, 0), 1.0, "alpha does not count");
        let clear = Material { alpha_mode: AlphaMode::Mask { cutoff: 1.5 }, ..material };
        assert_eq!(Cover::new(&clear).share(&mesh, 0), 0.0, "nothing reaches the cutoff");
    }

    #[test]
    fn places_are_spread_evenly() {
        // 4 equal triangles: of 64 places, 16 each but for the edges
        for triangle in 0..50 {
            let mut counts = [0; 4];
            for [a, b, c] in places(triangle) {
                assert!(a >= 0.0 && b >= 0.0 && c >= 0.0, "inside");
                assert!((a + b + c - 1.0).abs() < 1e-6, "weights");
                let part = [a, b, c].iter().position(|&w| w > 0.5).unwrap_or(3);
                counts[part] += 1;
            }
            assert!(counts.iter().all(|count| (12..=20).contains(count)), "{counts:?}");
        }
    }
}
