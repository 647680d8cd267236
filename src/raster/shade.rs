//! What a shape looks like at a point of the picture.
//!
//! Weights of the corners come from the corners as they were before snapping, are perspective-correct
//! and clamped to the triangle, so a sample that snapping pushed outside takes the nearest colour
//! inside instead of an extrapolated one.

use std::ops::{Add, Mul, Sub};

use glam::{Vec2, Vec3, Vec4, Vec4Swizzles};

use crate::draw_list::{Blend, Buffers, DrawList, Instance, Item, Surface};
use crate::raster::setup::{Placing, ScreenVertex, Shape, Unit, flags, normal_matrix};
use crate::texture::{Filter, Sampler, Texture};
use crate::view::View;

/// Everything that shading a shape needs, looked up once.
pub(crate) struct Material<'a> {
    pub(crate) item: &'a Item,
    pub(crate) instance: &'a Instance,
    pub(crate) texture: Option<(&'a Texture, Sampler)>,
    buffers: &'a Buffers,
    indices: &'a Buffers,
}

/// What can be interpolated.
trait Mixed: Copy + Mul<f32, Output = Self> + Add<Output = Self> + Sub<Output = Self> {}
impl<T: Copy + Mul<f32, Output = T> + Add<Output = T> + Sub<Output = T>> Mixed for T {}

/// A value between three corners'; exact where all are equal.
#[inline]
fn mix<T: Mixed>([a, b, c]: [T; 3], weights: [f32; 3]) -> T {
    a + (b - a) * weights[1] + (c - a) * weights[2]
}

impl<'a> Material<'a> {
    pub(crate) fn new(list: &'a DrawList, unit: &Unit, shape: &Shape) -> Self {
        let segment = &unit.segments[shape.segment as usize];
        let item = &list.items[segment.item as usize];
        let texture = match item.surface {
            Surface::VertexColor => None,
            Surface::Textured { texture, sampler } => {
                Some((&*list.textures[texture as usize], sampler))
            }
        };
        Self {
            item,
            instance: &list.instances[segment.instance as usize],
            texture,
            buffers: list.vertices_of(item),
            indices: list.indices_of(item),
        }
    }

    /// Whether every sample of a shape may be shaded at one point.
    pub(crate) fn is_smooth(&self) -> bool {
        self.texture.is_none()
    }

    /// What the "ids" output shows.
    pub(crate) fn source_id(&self, shape: &Shape) -> u32 {
        let ids = &self.indices.source_ids;
        if ids.is_empty() { shape.primitive } else { ids[shape.primitive as usize] }
    }

    fn mix<T: Mixed>(&self, array: &[T], sources: [u32; 3], weights: [f32; 3]) -> T {
        mix(sources.map(|v| array[v as usize]), weights)
    }

    /// Opacity alone: cheaper than the colour, for alpha tests.
    pub(crate) fn alpha(&self, weigher: &Weigher, at: Vec2, lod: f32) -> f32 {
        let weights = weigher.at(at);
        let opacity = mix(weigher.opacities, weights);
        let texel = self.texture.map_or(1.0, |(texture, sampler)| {
            texture.alpha(sampler, mix(weigher.uvs, weights), lod)
        });
        opacity * texel * self.instance.tint.w
    }

    /// Level of detail of the texture at a pixel; 0 unless it is read with mips.
    pub(crate) fn lod(&self, weigher: &Weigher, center: Vec2) -> f32 {
        let Some((texture, Sampler { filter: Filter::Trilinear, .. })) = self.texture else {
            return 0.0;
        };
        let (width, height) = texture.size();
        let size = Vec2::new(width as f32, height as f32);
        let uv = |offset: Vec2| mix(weigher.uvs, weigher.unclamped(center + offset)) * size;
        let middle = uv(Vec2::ZERO);
        let longest =
            (uv(Vec2::X) - middle).length_squared().max((uv(Vec2::Y) - middle).length_squared());
        0.5 * log2(longest)
    }

    /// Premultiplied linear colour, albedo and normal at a point; of the latter two what is wanted.
    #[inline]
    pub(crate) fn shade(
        &self,
        shape: &Shape,
        weigher: &Weigher,
        at: Vec2,
        lod: f32,
        [_, want_albedo, want_normal]: [bool; 3],
    ) -> [Vec4; 3] {
        let weights = weigher.at(at);
        let sources = weigher.sources;
        let front = shape.flags & flags::FRONT != 0;
        let tint = self.instance.tint;
        let mut alpha = 1.0;
        let mut texel = Vec3::ONE;
        if let Some((texture, sampler)) = self.texture {
            let sampled = texture.sample(sampler, mix(weigher.uvs, weights), lod);
            if sampled.w == 0.0 {
                // nothing to see where it is blended; black where its alpha does not count
                texel = Vec3::ZERO;
            } else {
                texel = sampled.xyz() * (1.0 / sampled.w);
            }
            alpha = sampled.w;
        }
        let blended = self.item.blend == Blend::Over;
        if blended {
            if alpha == 0.0 {
                return [Vec4::ZERO; 3];
            }
            alpha = (alpha * mix(weigher.opacities, weights) * tint.w).clamp(0.0, 1.0);
        } else {
            alpha = 1.0;
        }
        let side = if front { &self.buffers.front } else { &self.buffers.back };
        let lit = self.mix(side, sources, weights) * texel * tint.xyz();
        let mut shaded = [(lit * alpha).extend(alpha), Vec4::ZERO, Vec4::ZERO];
        if want_albedo {
            let base = self.mix(&self.buffers.base, sources, weights).xyz();
            shaded[1] = (base * texel * tint.xyz() * alpha).extend(alpha);
        }
        if want_normal {
            let local = self.mix(&self.buffers.normals, sources, weights);
            let normal = (normal_matrix(self.instance.linear) * local).normalize_or_zero();
            let normal = if front { normal } else { -normal };
            shaded[2] = (normal * alpha).extend(alpha);
        }
        shaded
    }
}

/// Gives the weights of a shape's corners at any point of the picture.
pub(crate) struct Weigher {
    /// Vertices of the corners.
    sources: [u32; 3],
    kind: Kind,
    /// Texture coordinates and opacities of the corners, which every alpha test needs.
    uvs: [Vec2; 3],
    opacities: [f32; 3],
}

enum Kind {
    /// One vertex everywhere.
    Constant,
    /// The second and third weight are linear on the picture, then divided by depth.
    Planar { origin: Vec2, second: Vec2, third: Vec2, keys: Option<[f32; 3]> },
    /// Reaches behind the eye.
    Clipped { space: Box<Placing>, corners: [glam::DVec3; 3] },
}

impl Kind {
    fn planar(view: &View, corners: [ScreenVertex; 3]) -> Self {
        let [a, b, c] = corners.map(|c| Vec2::new(c.x, c.y));
        let (u, v) = (b - a, c - a);
        let inverse_area = 1.0 / (u.x * v.y - u.y * v.x);
        let second = Vec2::new(v.y, -v.x) * inverse_area;
        let third = Vec2::new(-u.y, u.x) * inverse_area;
        if !(second.is_finite() && third.is_finite()) {
            return Self::Constant;
        }
        let keys = (!view.is_orthographic()).then(|| corners.map(|c| c.key));
        Self::Planar { origin: a, second, third, keys }
    }
}

impl Weigher {
    #[inline]
    pub(crate) fn new(view: &View, material: &Material<'_>, unit: &Unit, shape: &Shape) -> Self {
        let (sources, kind) = if shape.flags & flags::CLIPPED != 0 {
            let instance = material.instance;
            let placing = Placing::new(view, instance.linear, instance.translation);
            let positions = &material.buffers.positions;
            let corners = shape.vertices.map(|v| positions[v as usize].as_dvec3());
            (shape.vertices, Kind::Clipped { space: Box::new(placing), corners })
        } else {
            let corners = shape.vertices.map(|v| unit.vertices[v as usize]);
            let flat = shape.flags & flags::RECT != 0;
            let kind = if flat { Kind::Constant } else { Kind::planar(view, corners) };
            (corners.map(|c| c.source), kind)
        };
        let buffers = material.buffers;
        Self {
            sources,
            kind,
            uvs: sources.map(|v| buffers.uvs[v as usize]),
            opacities: sources.map(|v| buffers.base[v as usize].w),
        }
    }

    /// Weights at a point, clamped to the triangle.
    #[inline]
    fn at(&self, point: Vec2) -> [f32; 3] {
        match &self.kind {
            Kind::Constant => [1.0, 0.0, 0.0],
            Kind::Planar { origin, second, third, keys } => {
                let from = point - *origin;
                let (l1, l2) = (second.dot(from), third.dot(from));
                let clamped = [(1.0 - l1 - l2).max(0.0), l1.max(0.0), l2.max(0.0)];
                normalized(clamped, *keys)
            }
            Kind::Clipped { space, corners } => {
                space.exact.weights(*corners, [f64::from(point.x), f64::from(point.y)])
            }
        }
    }

    /// Weights at a point that may lie outside, for differences between pixels.
    #[inline]
    fn unclamped(&self, point: Vec2) -> [f32; 3] {
        match &self.kind {
            Kind::Planar { origin, second, third, keys } => {
                let from = point - *origin;
                let (l1, l2) = (second.dot(from), third.dot(from));
                normalized([1.0 - l1 - l2, l1, l2], *keys)
            }
            Kind::Constant | Kind::Clipped { .. } => self.at(point),
        }
    }
}

#[inline]
fn normalized(weights: [f32; 3], keys: Option<[f32; 3]>) -> [f32; 3] {
    let [a, b, c] = match keys {
        Some(keys) => [weights[0] * keys[0], weights[1] * keys[1], weights[2] * keys[2]],
        None => weights,
    };
    let scale = 1.0 / (a + b + c);
    [a * scale, b * scale, c * scale]
}

/// Base-2 logarithm to 0.01, the same on every machine; 0 and below give a large negative number.
#[inline]
fn log2(value: f32) -> f32 {
    if value <= f32::MIN_POSITIVE {
        return -126.0;
    }
    let bits = value.to_bits();
    let exponent = (bits >> 23) as f32 - 127.0;
    let mantissa = f32::from_bits(bits & 0x007F_FFFF | 0x3F80_0000) - 1.0;
    // x + c x (1 - x) with the c that halves the largest error over [0, 1]
    exponent + mantissa + 0.343_7 * mantissa * (1.0 - mantissa)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log2_is_close_enough_for_mips() {
        for i in 1..100_000_u32 {
            let value = i as f32 * 0.003;
            let error = (log2(value) - libm::log2f(value)).abs();
            assert!(error < 0.01, "log2({value}) is off by {error}");
        }
        assert_eq!(log2(0.0), -126.0, "no change at all");
        assert_eq!(log2(8.0), 3.0, "exact at powers of two");
    }
}
