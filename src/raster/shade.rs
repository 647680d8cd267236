//! What a shape looks like at a point of the picture.
//!
//! Weights of the corners come from the corners as they were before snapping, are perspective-correct
//! and clamped to the triangle, so a sample that snapping pushed outside takes the nearest colour
//! inside instead of an extrapolated one.

use std::ops::{Add, Mul, Sub};

use glam::{Vec2, Vec3, Vec4, Vec4Swizzles};

use crate::draw_list::{Blend, Buffers, DrawList, Instance, Item, Surface};
use crate::raster::clip::WeightForms;
use crate::raster::cut_out::CutOut;
use crate::raster::lookup::Lookup;
use crate::raster::over::Over;
use crate::raster::parallax::Parallax;
use crate::raster::placing::{Placing, ScreenVertex, normal_matrix};
use crate::raster::samples::SUBPIXEL_COUNT;
use crate::raster::setup::{Shape, Unit, flags};
use crate::texture::{Distribution, Filter, Sampler, Texture};
use crate::view::View;

/// Everything that shading a shape needs, looked up once.
pub(crate) struct Material<'a> {
    pub(crate) item: &'a Item,
    pub(crate) instance: &'a Instance,
    look: Option<Look<'a>>,
    /// In a box: others' materials stay small.
    parallax: Option<Box<Parallax<'a>>>,
    pub(crate) buffers: &'a Buffers,
    indices: &'a Buffers,
}

/// A texture, and how it is read.
#[derive(Clone, Copy)]
pub(crate) struct Look<'a> {
    texture: &'a Texture,
    sampler: Sampler,
    /// Where in the texture a coordinate is looked up, if not at itself.
    distribution: Option<&'a Distribution>,
}

impl Look<'_> {
    #[inline]
    pub(crate) fn alpha(&self, uv: Vec2, lod: f32) -> f32 {
        match self.distribution {
            None => self.texture.alpha(self.sampler, uv, lod),
            Some(distribution) => distribution.alpha(self.texture, self.sampler, uv, lod),
        }
    }

    /// The texture itself, if it is looked up at the coordinate and between texels.
    #[inline]
    pub(crate) fn filtered(&self) -> Option<(&Texture, Sampler)> {
        let plain = self.distribution.is_none() && self.sampler.filter != Filter::Nearest;
        plain.then_some((self.texture, self.sampler))
    }

    /// Premultiplied linear colour.
    #[inline]
    pub(crate) fn sample(&self, uv: Vec2, lod: f32) -> Vec4 {
        match self.distribution {
            None => self.texture.sample(self.sampler, uv, lod),
            Some(distribution) => distribution.sample(self.texture, self.sampler, uv, lod),
        }
    }

    /// Texels over a step in texture space, if levels are wanted.
    fn texels(&self) -> Option<Vec2> {
        let (width, height) = self.texture.size();
        let itself = || Vec2::new(width as f32, height as f32);
        let texels = self.distribution.map_or_else(itself, |d| d.texels(self.texture));
        (self.sampler.filter == Filter::Trilinear).then_some(texels)
    }
}

/// What can be interpolated.
pub(crate) trait Mixed:
    Copy + Mul<f32, Output = Self> + Add<Output = Self> + Sub<Output = Self>
{
}
impl<T: Copy + Mul<f32, Output = T> + Add<Output = T> + Sub<Output = T>> Mixed for T {}

/// A value between three corners'; exact where all are equal.
#[inline(always)]
pub(crate) fn mix<T: Mixed>([a, b, c]: [T; 3], weights: [f32; 3]) -> T {
    a + (b - a) * weights[1] + (c - a) * weights[2]
}

impl<'a> Material<'a> {
    pub(crate) fn new(list: &'a DrawList, view: &View, unit: &Unit, shape: &Shape) -> Self {
        let segment = &unit.segments[shape.tag.segment() as usize];
        let item = &list.items[segment.item as usize];
        let instance = &list.instances[segment.instance as usize];
        let texture = |index: u32| &*list.textures[index as usize];
        let mut parallax = None;
        let look = match item.surface {
            Surface::VertexColor => None,
            Surface::Textured { texture: index, sampler } => {
                Some(Look { texture: texture(index), sampler, distribution: None })
            }
            Surface::Indirect { distribution, leaves, sampler } => {
                let distribution = Some(&*list.distributions[distribution as usize]);
                Some(Look { texture: texture(leaves), sampler, distribution })
            }
            Surface::Parallax { frames, step_count, tolerance, sampler } => {
                let frames = &*list.frames[frames as usize];
                let seen = Parallax::new(frames, view, instance, (step_count, tolerance), sampler);
                parallax = Some(Box::new(seen));
                None
            }
        };
        Self {
            item,
            instance,
            look,
            parallax,
            buffers: list.vertices_of(item),
            indices: list.indices_of(item),
        }
    }

    /// Whether every sample of a shape may be shaded at one point.
    pub(crate) fn is_smooth(&self) -> bool {
        self.look.is_none() && self.parallax.is_none()
    }

    /// The frames that are looked through the shape, if that is how it is coloured.
    #[inline]
    pub(crate) fn parallax(&self) -> Option<&Parallax<'a>> {
        self.parallax.as_deref()
    }

    /// What the "ids" output shows.
    pub(crate) fn source_id(&self, primitive: u32) -> u32 {
        let ids = &self.indices.source_ids;
        if ids.is_empty() { primitive } else { ids[primitive as usize] }
    }

    fn mix<T: Mixed>(&self, array: &[T], sources: [u32; 3], weights: [f32; 3]) -> T {
        mix(sources.map(|v| array[v as usize]), weights)
    }

    /// Opacity alone: cheaper than the colour, for alpha tests.
    pub(crate) fn alpha(&self, weigher: &Weigher, at: Vec2, lod: f32) -> f32 {
        let weights = weigher.at(at);
        let opacity = mix(weigher.opacities, weights);
        let texel = self.look.map_or(1.0, |look| look.alpha(mix(weigher.uvs, weights), lod));
        opacity * texel * self.instance.tint.w
    }

    /// How the texture of a shape is read by vectors, if it has one.
    pub(crate) fn lookup(&self, weigher: &Weigher) -> Option<Lookup<'a>> {
        let look = self.look?;
        let Weigher { kind, uvs, opacities, .. } = *weigher;
        Some(Lookup {
            kind,
            uvs,
            opacities,
            tint: self.instance.tint.w,
            look,
            texels: look.texels(),
        })
    }

    /// The alpha test of a textured shape, as vectors take it.
    pub(crate) fn cut_out(
        &self,
        weigher: &Weigher,
        cutoff: impl Fn(usize) -> f32,
        sample_count: usize,
    ) -> Option<CutOut<'a>> {
        let lookup = self.lookup(weigher)?;
        let mut cutoffs = [0.0; 16];
        for (sample, stored) in cutoffs.iter_mut().take(sample_count).enumerate() {
            *stored = cutoff(sample);
        }
        Some(CutOut { lookup, cutoffs })
    }

    /// A blended textured shape, as vectors paint its colour.
    pub(crate) fn over(&self, shape: &Shape, weigher: &Weigher) -> Option<Over<'a>> {
        let lookup = self.lookup(weigher)?;
        let side = self.side(shape);
        let lit = weigher.sources.map(|v| side[v as usize]);
        Some(Over { lookup, lit, tint: self.instance.tint })
    }

    /// Lit colours of the vertices on the side of a shape that is seen.
    fn side(&self, shape: &Shape) -> &'a [Vec3] {
        let Buffers { front, back, .. } = self.buffers;
        if shape.tag.has(flags::FRONT) { front } else { back }
    }

    /// Level of detail of the texture at a pixel; 0 unless it is read with mips.
    pub(crate) fn lod(&self, weigher: &Weigher, center: Vec2) -> f32 {
        if let Some(parallax) = self.parallax() {
            return 0.5
                * log2(parallax.texels_a_pixel_squared(weigher, &self.buffers.positions, center));
        }
        let Some(size) = self.look.and_then(|look| look.texels()) else { return 0.0 };
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
        wanted: [bool; 3],
    ) -> [Vec4; 3] {
        let tint = self.instance.tint;
        if let Some(parallax) = self.parallax() {
            let colors = parallax.colors(weigher, &self.buffers.positions, at, lod);
            return parallax.shade(&colors, tint, self.item.blend == Blend::Over);
        }
        let [_, want_albedo, want_normal] = wanted;
        let weights = weigher.at(at);
        let sources = weigher.sources;
        let front = shape.tag.has(flags::FRONT);
        let mut alpha = 1.0;
        let mut texel = Vec3::ONE;
        if let Some(look) = self.look {
            let sampled = look.sample(mix(weigher.uvs, weights), lod);
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
        let lit = self.mix(self.side(shape), sources, weights) * texel * tint.xyz();
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

#[derive(Clone, Copy, Debug)]
pub(crate) enum Kind {
    Planar(Planar),
    /// Reaches behind the eye.
    Clipped(WeightForms),
}

/// The second and third weight are linear on the picture, then divided by depth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Planar {
    pub(crate) origin: Vec2,
    pub(crate) second: Vec2,
    pub(crate) third: Vec2,
    /// Depth keys of the corners; all 1 where depth does not matter.
    pub(crate) keys: [f32; 3],
}

impl Planar {
    /// The first corner everywhere: a point's.
    const LEVEL: Self =
        Self { origin: Vec2::ZERO, second: Vec2::ZERO, third: Vec2::ZERO, keys: [1.0; 3] };

    /// Of corners that lie on a line the first counts alone.
    #[inline]
    fn new(view: &View, corners: [&ScreenVertex; 3]) -> Self {
        let [a, b, c] = corners.map(|c| Vec2::new(c.x, c.y));
        let (u, v) = (b - a, c - a);
        let inverse_area = 1.0 / (u.x * v.y - u.y * v.x);
        let mut second = Vec2::new(v.y, -v.x) * inverse_area;
        let mut third = Vec2::new(-u.y, u.x) * inverse_area;
        if !(second.is_finite() && third.is_finite()) {
            (second, third) = (Vec2::ZERO, Vec2::ZERO);
        }
        let keys = if view.is_orthographic() { [1.0; 3] } else { corners.map(|c| c.key) };
        Self { origin: a, second, third, keys }
    }

    /// Of a line's ends, the far one twice: values change along it alone.
    #[inline]
    fn of_line(view: &View, shape: &Shape) -> Self {
        let step = 1.0 / SUBPIXEL_COUNT as f32;
        let [x, y] = [shape.x, shape.y].map(|at| (at[1] - at[0]) as f32 * step);
        let along = Vec2::new(x, y);
        let [key, slope_x, slope_y] = shape.key;
        let [farthest, nearest] = shape.key_range;
        let far = (key + (slope_x * x + slope_y * y)).max(farthest).min(nearest);
        let keys = if view.is_orthographic() { [1.0; 3] } else { [key, far, far] };
        let second = along * (1.0 / along.length_squared());
        Self { origin: shape.origin.into(), second, third: Vec2::ZERO, keys }
    }

    /// Weights at a point, clamped to the triangle.
    #[inline]
    fn at(&self, point: Vec2) -> [f32; 3] {
        let from = point - self.origin;
        let (l1, l2) = (self.second.dot(from), self.third.dot(from));
        self.normalized([(1.0 - l1 - l2).max(0.0), l1.max(0.0), l2.max(0.0)])
    }

    /// Weights at a point that may lie outside.
    #[inline]
    fn unclamped(&self, point: Vec2) -> [f32; 3] {
        let from = point - self.origin;
        let (l1, l2) = (self.second.dot(from), self.third.dot(from));
        self.normalized([1.0 - l1 - l2, l1, l2])
    }

    #[inline]
    fn normalized(&self, weights: [f32; 3]) -> [f32; 3] {
        let [a, b, c] = std::array::from_fn(|i| weights[i] * self.keys[i]);
        let scale = 1.0 / (a + b + c);
        [a * scale, b * scale, c * scale]
    }
}

/// Colour of an untextured opaque shape, ready to be asked for at many points.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Smooth {
    planar: Planar,
    colors: [Vec4; 3],
    tint: Vec4,
    /// What the "ids" output shows.
    pub(crate) id: u32,
}

impl Smooth {
    /// `None` for a shape that has a texture, blends or reaches behind the eye.
    #[inline(always)]
    pub(crate) fn new(view: &View, list: &DrawList, unit: &Unit, index: usize) -> Option<Self> {
        let origin = &unit.origins[index];
        let segment = &unit.segments[origin.tag.segment() as usize];
        let item = &list.items[segment.item as usize];
        let opaque = item.blend != Blend::Over && item.surface == Surface::VertexColor;
        if !opaque || origin.tag.has(flags::CLIPPED) {
            return None;
        }
        let buffers = list.vertices_of(item);
        let side = if origin.tag.has(flags::FRONT) { &buffers.front } else { &buffers.back };
        let ids = &list.indices_of(item).source_ids;
        let color = |source: u32| side[source as usize].extend(1.0);
        let (planar, colors) = if origin.tag.has(flags::RECT) {
            (Planar::LEVEL, [color(origin.vertices[0]); 3])
        } else if origin.tag.has(flags::LINE) {
            let [near, far, _] = origin.vertices.map(color);
            (Planar::of_line(view, &unit.shapes[index]), [near, far, far])
        } else {
            let corners = origin.vertices.map(|v| &unit.vertices[v as usize]);
            (Planar::new(view, corners), corners.map(|c| color(c.source)))
        };
        Some(Self {
            planar,
            colors,
            tint: list.instances[segment.instance as usize].tint.with_w(1.0),
            id: ids.get(origin.primitive as usize).copied().unwrap_or(origin.primitive),
        })
    }

    /// As [`Material::shade`]: opaque.
    #[inline]
    pub(crate) fn color(&self, at: Vec2) -> Vec4 {
        mix(self.colors, self.planar.at(at)) * self.tint
    }
}

impl Weigher {
    #[inline]
    pub(crate) fn new(view: &View, material: &Material<'_>, unit: &Unit, index: usize) -> Self {
        let shape = &unit.shapes[index];
        let vertices = unit.origins[index].vertices;
        let (sources, kind) = if shape.tag.has(flags::RECT) {
            (vertices, Kind::Planar(Planar::LEVEL))
        } else if shape.tag.has(flags::LINE) {
            (vertices, Kind::Planar(Planar::of_line(view, shape)))
        } else if shape.tag.has(flags::CLIPPED) {
            let instance = material.instance;
            let placing = Placing::new(view, instance.linear, instance.translation);
            let positions = &material.buffers.positions;
            let corners = vertices.map(|v| positions[v as usize].as_dvec3());
            (vertices, Kind::Clipped(placing.exact.weight_forms(corners)))
        } else {
            let corners = vertices.map(|v| &unit.vertices[v as usize]);
            (corners.map(|c| c.source), Kind::Planar(Planar::new(view, corners)))
        };
        let buffers = material.buffers;
        Self {
            sources,
            kind,
            uvs: sources.map(|v| buffers.uvs[v as usize]),
            opacities: sources.map(|v| buffers.base[v as usize].w),
        }
    }

    /// Where on the shape a point of the picture is, in the vertices' own space.
    #[inline]
    pub(crate) fn position(&self, positions: &[Vec3], at: Vec2) -> Vec3 {
        mix(self.sources.map(|v| positions[v as usize]), self.at(at))
    }

    /// The same on the shape's plane, for points beside the shape.
    #[inline]
    pub(crate) fn position_beside(&self, positions: &[Vec3], at: Vec2) -> Vec3 {
        mix(self.sources.map(|v| positions[v as usize]), self.unclamped(at))
    }

    /// Weights at a point, clamped to the triangle.
    #[inline]
    fn at(&self, point: Vec2) -> [f32; 3] {
        match &self.kind {
            Kind::Planar(planar) => planar.at(point),
            Kind::Clipped(forms) => forms.at([f64::from(point.x), f64::from(point.y)]),
        }
    }

    /// Weights at a point that may lie outside, for differences between pixels.
    #[inline]
    fn unclamped(&self, point: Vec2) -> [f32; 3] {
        match &self.kind {
            Kind::Planar(planar) => planar.unclamped(point),
            Kind::Clipped(_) => self.at(point),
        }
    }
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
