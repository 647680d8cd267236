//! Pictures of one thing from many directions, with depth: what a ray sees of them.
//!
//! A frame is a square parallel picture on a plane through the middle, seen along the plane's normal. Its
//! depths say how far before or behind the plane each texel lies. A ray that does not run along the
//! normal meets the plane where it meets nothing of the plant; it is followed to the stored depth, which
//! shifts the point that is read: parallax. Each step reads the depth at the point found so far and
//! goes on to where the ray has that depth. A few frames are read for one ray and mixed by weight. Where
//! the steps have not ended on a surface, the depth at the point found is not the ray's: that frame
//! shows something that lies elsewhere, a ghost, and counts the less the further off it is.
//!
//! This work is based on:
//! Ryan Brucks. Octahedral Impostors. 2018 (what engines do: three frames, one step of parallax)

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{Vec2, Vec3, Vec4, Vec4Swizzles};

use crate::error::LodError;
use crate::texture::depth_map::DepthMap;
use crate::texture::light::Light;
use crate::texture::normal_map::NormalMap;
use crate::texture::texture::{Filter, Sampler, Texture};

/// A frame whose normal a ray meets at a smaller cosine than this is seen from the side: not at all.
const LEAST_COSINE: f32 = 0.02;

/// Frames that one ray reads, at most.
pub const MAX_CHOSEN: usize = 3;

/// Where a frame is looked up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Unit vector from the middle to the frame's viewer.
    pub toward: Vec3,
    /// Unit vector along the picture's rows.
    pub right: Vec3,
    /// Unit vector to the picture's top.
    pub up: Vec3,
    /// Upper left corner in the atlas.
    pub corner: Vec2,
}

/// What frames are made of.
#[derive(Debug, Clone)]
pub struct Parts {
    /// The middle of all planes.
    pub center: Vec3,
    /// Half a frame's side in metres; depths reach as far to both sides of the plane.
    pub reach: f32,
    /// Least and greatest coordinates of what is shown: rays that pass by see nothing.
    pub bounds: [Vec3; 2],
    /// By number; `None` where a frame was not baked.
    pub frames: Vec<Option<Frame>>,
    /// A frame's sides in the atlas, as texture coordinates.
    pub size: Vec2,
    /// Colour with alpha: lit, or without light where `relit` says how it is lit.
    pub color: Arc<Texture>,
    /// Laid out as the colour.
    pub depth: Arc<DepthMap>,
    /// What lights the colour.
    pub relit: Option<Relit>,
}

/// Light that falls on frames when they are looked at.
#[derive(Debug, Clone)]
pub struct Relit {
    /// Laid out as the colour.
    pub normal: Arc<NormalMap>,
    /// In the frames' own space.
    pub light: Light,
}

/// An atlas of frames. Immutable, with an id that no other of this process has.
#[derive(Debug)]
pub struct Frames {
    id: u64,
    parts: Parts,
    /// Texels of a frame's side.
    texels: f32,
}

/// A line of sight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// A point on it.
    pub point: Vec3,
    /// Unit vector away from the viewer.
    pub direction: Vec3,
    /// Nothing nearer is seen: metres along `direction` from `point`, negative towards the viewer.
    pub start: f32,
}

/// Frames to read, by number, with weights; those without weight are not read.
pub type Chosen = [(u32, f32); MAX_CHOSEN];

/// How a ray reads its frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Frames and weights.
    pub chosen: Chosen,
    /// Steps of parallax.
    pub step_count: u32,
    /// How far the depth at the point found may be from the ray's, in shares of the reach, for the frame
    /// to count half. Infinite: all count alike.
    pub tolerance: f32,
    /// How texels are filtered.
    pub sampler: Sampler,
    /// Level of detail.
    pub lod: f32,
}

/// What a ray meets in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Hit {
    frame: u32,
    weight: f32,
    /// From 0 to 1: whether the depth that is stored there is the ray's.
    trust: f32,
    uv: Vec2,
    /// Metres along the ray.
    along: f32,
}

/// Alpha where a ray meets the frames, and how far along it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Met {
    /// Sum of the frames' alphas by weight; above 0.
    pub alpha: f32,
    /// Metres along the ray: the frames' mean, by weight and alpha.
    pub along: f32,
}

/// Colours that a ray sees, premultiplied, and a normal of any length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Colors {
    /// Lit colour.
    pub lit: Vec4,
    /// Colour without light; the lit one where no other is kept.
    pub albedo: Vec4,
    /// Normal, towards the frames' viewers where none is kept.
    pub normal: Vec3,
}

impl Frames {
    /// Freezes the parts.
    ///
    /// # Errors
    /// If sizes or layers do not fit together.
    pub fn new(parts: Parts) -> Result<Arc<Self>, LodError> {
        static NEXT_ID: AtomicU64 = AtomicU64::new(0);
        let sizes = |texture: &Texture| {
            texture.levels().iter().map(|level| (level.width, level.height)).collect::<Vec<_>>()
        };
        let layout = sizes(&parts.color);
        let depths: Vec<_> =
            parts.depth.levels().iter().map(|level| (level.width, level.height)).collect();
        let normals = parts.relit.as_ref().map(|relit| {
            relit
                .normal
                .levels()
                .iter()
                .map(|level| (level.width, level.height))
                .collect::<Vec<_>>()
        });
        let fits = depths == layout && normals.is_none_or(|normals| normals == layout);
        let sized = parts.reach > 0.0 && parts.reach.is_finite() && parts.size.min_element() > 0.0;
        let [low, high] = parts.bounds;
        let boxed = low.is_finite() && high.is_finite() && low.cmple(high).all();
        if !fits || !sized || !boxed || !parts.center.is_finite() {
            let why = "its layers and sizes do not fit together".to_owned();
            return Err(LodError::Invalid { name: "frames", why });
        }
        let texels = parts.size.x * parts.color.size().0 as f32;
        let id = NEXT_ID.fetch_add(1, Ordering::Relaxed);
        Ok(Arc::new(Self { id, parts, texels }))
    }

    /// Unique in this process; the cache key of a renderer.
    pub fn id(&self) -> u64 {
        self.id
    }

    /// What they are made of.
    pub fn parts(&self) -> &Parts {
        &self.parts
    }

    /// Whether a number is that of a frame that was baked.
    pub fn has(&self, frame: u32) -> bool {
        self.parts.frames.get(frame as usize).is_some_and(Option::is_some)
    }

    /// Bytes of all layers as stored.
    pub fn byte_count(&self) -> u64 {
        let Parts { color, depth, relit, .. } = &self.parts;
        let normals = relit.as_ref().map_or(0, |relit| relit.normal.byte_count());
        color.byte_count() + depth.byte_count() + normals
    }

    /// Where a ray meets a frame's plane, in texels along its rows and columns.
    #[inline]
    pub fn on_plane(&self, ray: &Ray, frame: u32) -> Option<Vec2> {
        let at = self.parts.frames.get(frame as usize)?.as_ref()?;
        let (cosine, height) = self.facing(ray, at)?;
        let met = ray.point - self.parts.center + ray.direction * (height / cosine);
        let texel = self.texels / (2.0 * self.parts.reach);
        Some(Vec2::new(met.dot(at.right), met.dot(at.up)) * texel)
    }

    /// Cosine between a ray and a frame's normal, and how far before the plane the ray's point lies.
    #[inline]
    fn facing(&self, ray: &Ray, at: &Frame) -> Option<(f32, f32)> {
        let cosine = -ray.direction.dot(at.toward);
        let height = (ray.point - self.parts.center).dot(at.toward);
        (cosine >= LEAST_COSINE).then_some((cosine, height))
    }

    /// Where a ray enters and leaves the box around what is shown; `None` where it misses it.
    #[inline]
    fn chord(&self, ray: &Ray) -> Option<(f32, f32)> {
        let [low, high] = self.parts.bounds;
        let (mut near, mut far) = (ray.start, f32::INFINITY);
        for axis in 0..3 {
            let inverse = 1.0 / ray.direction[axis];
            let (a, b) = (low[axis] - ray.point[axis], high[axis] - ray.point[axis]);
            // along a side that the ray lies in, a product may be NaN, which the other one replaces
            let (a, b) = (a * inverse, b * inverse);
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        (near <= far).then_some((near, far))
    }

    #[inline]
    fn hit(
        &self,
        ray: &Ray,
        (near, far): (f32, f32),
        (frame, weight): (u32, f32),
        reading: &Reading,
    ) -> Option<Hit> {
        let Parts { center, reach, depth, size, .. } = &self.parts;
        let at = self.parts.frames.get(frame as usize)?.as_ref()?;
        let (cosine, height) = self.facing(ray, at)?;
        let from = ray.point - *center;
        let (x, y) = (from.dot(at.right), from.dot(at.up));
        let (across, down) = (ray.direction.dot(at.right), ray.direction.dot(at.up));
        let scale = 0.5 / reach;
        // a point of the picture, from its upper left, in shares of its sides
        let point = |along: f32| {
            Vec2::new(0.5 + (x + across * along) * scale, 0.5 - (y + down * along) * scale)
        };
        let in_atlas = |point: Vec2| at.corner + point * *size;
        let mut along = height / cosine;
        if reading.step_count > 0 {
            // what is shown lies in the box
            along = along.clamp(near, far);
        }
        let mut met = point(along);
        let mut last = 0.0;
        for _ in 0..reading.step_count {
            let inside = met.clamp(Vec2::ZERO, Vec2::ONE);
            let share = depth.share(in_atlas(inside), reading.lod);
            last = share;
            along = (height - (share * 2.0 - 1.0) * reach) / cosine;
            met = point(along);
        }
        if met.min_element() < 0.0 || met.max_element() > 1.0 {
            return None;
        }
        let uv = in_atlas(met);
        let mut trust = 1.0;
        if reading.step_count == 0 {
            let share = depth.share(uv, reading.lod);
            along = (height - (share * 2.0 - 1.0) * reach) / cosine;
        } else if reading.tolerance.is_finite() {
            let off = 2.0 * (depth.share(uv, reading.lod) - last) / reading.tolerance;
            trust = 1.0 / (1.0 + off * off);
        }
        (along > ray.start).then_some(Hit { frame, weight, trust, uv, along })
    }

    /// Visits what a ray meets in each of its frames.
    #[inline(always)]
    fn hits(&self, ray: &Ray, reading: &Reading, mut visit: impl FnMut(Hit)) {
        let Some(chord) = self.chord(ray) else { return };
        let mut hits = [None; MAX_CHOSEN];
        let (mut sum, mut trusted) = (0.0, 0.0);
        for (hit, &(frame, weight)) in hits.iter_mut().zip(&reading.chosen) {
            if weight > 0.0 {
                *hit = self.hit(ray, chord, (frame, weight), reading);
                sum += weight;
                trusted += weight * hit.map_or(1.0, |hit| hit.trust);
            }
        }
        // what is taken from some frames is given to the others
        let scale = sum / trusted;
        for hit in hits.into_iter().flatten() {
            visit(Hit { weight: hit.weight * hit.trust * scale, ..hit });
        }
    }

    /// Where a ray meets what the frames show; `None` where it meets nothing.
    #[inline]
    pub fn met(&self, ray: &Ray, reading: &Reading) -> Option<Met> {
        let (mut alpha, mut along) = (0.0, 0.0);
        self.hits(ray, reading, |hit| {
            let there = self.alpha(hit.uv, reading) * hit.weight;
            alpha += there;
            along += there * hit.along;
        });
        (alpha > 0.0).then(|| Met { alpha, along: along / alpha })
    }

    /// Alpha of the colour, without reading texels where all around have none.
    #[inline]
    fn alpha(&self, uv: Vec2, reading: &Reading) -> f32 {
        let color = &self.parts.color;
        if let Some(bounds) = color.alpha_bounds() {
            let (level, _) = match reading.sampler.filter {
                Filter::Trilinear => color.level_pair(reading.lod),
                Filter::Nearest | Filter::Bilinear => (0, 0.0),
            };
            let image = &color.levels()[level];
            let (x, y) = (uv.x * image.width as f32, uv.y * image.height as f32);
            if bounds.at(level, x, y) == 0 {
                return 0.0;
            }
        }
        color.alpha(reading.sampler, uv, reading.lod)
    }

    /// What a ray sees.
    #[inline]
    pub fn colors(&self, ray: &Ray, reading: &Reading) -> Colors {
        let mut seen = Colors { lit: Vec4::ZERO, albedo: Vec4::ZERO, normal: Vec3::ZERO };
        self.hits(ray, reading, |hit| {
            let base = self.parts.color.sample(reading.sampler, hit.uv, reading.lod);
            let (lit, normal) = match &self.parts.relit {
                Some(Relit { normal, light }) => {
                    let (normal, leaf_share) = normal.at(hit.uv, reading.lod);
                    ((base.xyz() * light.on(normal, leaf_share)).extend(base.w), normal)
                }
                None => {
                    (base, self.parts.frames[hit.frame as usize].map_or(Vec3::ZERO, |f| f.toward))
                }
            };
            seen.lit += lit * hit.weight;
            seen.albedo += base * hit.weight;
            seen.normal += normal * (base.w * hit.weight);
        });
        seen
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texture::depth_map::{DepthLevel, encode};
    use crate::texture::{Image, Wrap};

    const SAMPLER: Sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: Filter::Bilinear };

    const RED: [u8; 4] = [255, 0, 0, 255];
    const GREEN: [u8; 4] = [0, 255, 0, 255];

    fn image(texels: Vec<[u8; 4]>) -> Image {
        Image::new(4, 4, texels).expect("valid")
    }

    /// A frame that looks along -z at a square of 2 m: red on the left, green on the right, at z = 0.5.
    fn parts() -> Parts {
        let color = image((0..16).map(|i| if i % 4 < 2 { RED } else { GREEN }).collect());
        let depth = DepthLevel { width: 4, height: 4, codes: vec![encode(0.75, 16); 16] };
        let frame = Frame { toward: Vec3::Z, right: Vec3::X, up: Vec3::Y, corner: Vec2::ZERO };
        Parts {
            center: Vec3::ZERO,
            reach: 1.0,
            bounds: [-Vec3::ONE, Vec3::ONE],
            frames: vec![Some(frame), None],
            size: Vec2::ONE,
            color: Texture::new(vec![color]).expect("valid").bounded(),
            depth: depths(depth),
            relit: None,
        }
    }

    fn depths(level: DepthLevel) -> Arc<DepthMap> {
        Arc::new(DepthMap::new(vec![level], 16).expect("valid"))
    }

    fn frames() -> Arc<Frames> {
        Frames::new(parts()).expect("fits")
    }

    fn reading(step_count: u32) -> Reading {
        let chosen = [(0, 1.0), (1, 0.0), (0, 0.0)];
        Reading { chosen, step_count, tolerance: f32::INFINITY, sampler: SAMPLER, lod: 0.0 }
    }

    /// The ray of a viewer towards +x +z through a point, which begins two metres before it.
    fn slanted(through: Vec3) -> Ray {
        let direction = Vec3::new(-1.0, 0.0, -1.0).normalize();
        Ray { point: through - direction * 2.0, direction, start: f32::NEG_INFINITY }
    }

    fn color(ray: &Ray, step_count: u32) -> Vec4 {
        frames().colors(ray, &reading(step_count)).lit
    }

    /// What f32 loses in some steps on numbers of about 1, and 16 bits of depth on 2 m.
    const CLOSE: f32 = 4e-5;

    #[test]
    fn a_straight_ray_sees_the_texel_before_it_at_its_depth() {
        let down = |x: f32, y: f32| Ray {
            point: Vec3::new(x, y, 2.0),
            direction: Vec3::NEG_Z,
            start: f32::NEG_INFINITY,
        };
        for step_count in 0..3 {
            let met = frames().met(&down(0.25, 0.3), &reading(step_count)).expect("there");
            assert_eq!(met.alpha, 1.0, "{step_count} steps");
            assert!((met.along - 1.5).abs() < CLOSE, "from 2 to 0.5: {}", met.along);
            assert_eq!(color(&down(0.25, 0.3), step_count), Vec4::new(0.0, 1.0, 0.0, 1.0), "right");
            assert_eq!(color(&down(-0.25, 0.3), step_count), Vec4::new(1.0, 0.0, 0.0, 1.0), "left");
        }
        // half way between the texels of both
        assert_eq!(color(&down(0.0, 0.0), 0), Vec4::new(0.5, 0.5, 0.0, 1.0), "between");
        assert_eq!(frames().met(&down(1.1, 0.0), &reading(0)), None, "beside the picture");
        let mut made = parts();
        made.bounds = [-Vec3::ONE, Vec3::new(0.8, 1.0, 1.0)];
        let narrow = Frames::new(made).expect("fits");
        for step_count in 0..2 {
            let met = |x: f32| narrow.met(&down(x, 0.0), &reading(step_count));
            assert!(met(0.9).is_none() && met(0.7).is_some(), "beside the box and in it");
        }
    }

    #[test]
    fn parallax_finds_the_plane_that_is_there() {
        // a plane half a metre before the middle, seen from 45 degrees: the ray that meets it at x = 0.25
        // meets the frame's own plane half a metre further left
        let ray = slanted(Vec3::new(0.25, 0.0, 0.5));
        let is = |ray: &Ray, step_count: u32, wanted: Vec4| {
            (color(ray, step_count) - wanted).length() < CLOSE
        };
        let (red, green) = (Vec4::new(1.0, 0.0, 0.0, 1.0), Vec4::new(0.0, 1.0, 0.0, 1.0));
        assert!(is(&ray, 0, red), "without parallax: at x = -0.25");
        for step_count in [1, 2, 7] {
            assert!(is(&ray, step_count, green), "{step_count} steps");
            let met = frames().met(&ray, &reading(step_count)).expect("there");
            assert!((met.along - 2.0).abs() < CLOSE, "on the plane: {}", met.along);
        }
        // just left of where colours meet
        let left = slanted(Vec3::new(-0.25, 0.0, 0.5));
        assert!(is(&left, 1, red), "the other half");
    }

    #[test]
    fn a_second_step_reads_the_depth_that_the_first_has_led_to() {
        // the left half lies at z = 0.5, the right half at z = -0.5
        let mut made = parts();
        let code = |i: usize| encode(if i % 4 < 2 { 0.75 } else { 0.25 }, 16);
        let depth = DepthLevel { width: 4, height: 4, codes: (0..16).map(code).collect() };
        made.depth = depths(depth);
        let frames = Frames::new(made).expect("fits");
        // from the right at 45 degrees to z = 0 at x = 0.3: right of it, so on to z = -0.5 at
        // x = -0.2, which is left: back to z = 0.5 at x = 0.8, and so on for ever
        let ray = slanted(Vec3::new(0.3, 0.0, 0.0));
        let at = |step_count: u32| {
            let met = frames.met(&ray, &reading(step_count)).expect("there");
            ray.point.x + ray.direction.x * met.along
        };
        // depths are mixed between texels from x = -0.25 to 0.25, where 1 m lies between them
        let first = -0.2;
        let second = first + 0.5 - 1.0 * (first + 0.25) / 0.5 + 0.5;
        for (steps, wanted) in [(1, first), (2, second)] {
            assert!((at(steps) - wanted).abs() < CLOSE, "{steps}: {} for {wanted}", at(steps));
        }
    }

    #[test]
    fn frames_are_mixed_by_weight_and_depths_by_alpha() {
        // the second frame has half the alpha, all of it blue, at z = -0.5
        let mut made = parts();
        let side = [0.0, 0.5];
        let texel = |i: usize| if i % 8 < 4 { RED } else { [0, 0, 255, 128] };
        let color = Image::new(8, 4, (0..32).map(texel).collect()).expect("valid");
        let code = |i: usize| encode(if i % 8 < 4 { 0.75 } else { 0.25 }, 16);
        let depth = DepthLevel { width: 8, height: 4, codes: (0..32).map(code).collect() };
        let frame = made.frames[0].expect("first");
        made.frames = side.map(|u| Some(Frame { corner: Vec2::new(u, 0.0), ..frame })).to_vec();
        made.size = Vec2::new(0.5, 1.0);
        made.color = Texture::new(vec![color]).expect("valid");
        made.depth = depths(depth);
        let frames = Frames::new(made).expect("fits");
        let ray = Ray { point: Vec3::ZERO, direction: Vec3::NEG_Z, start: f32::NEG_INFINITY };
        let chosen = [(0, 0.25), (1, 0.75), (0, 0.0)];
        let reading = Reading { chosen, ..reading(1) };
        let met = frames.met(&ray, &reading).expect("there");
        let half = 128.0 / 255.0;
        let alpha = 0.25 + 0.75 * half;
        assert!((met.alpha - alpha).abs() < 1e-6, "{met:?}");
        let along = (0.25 * -0.5 + 0.75 * half * 0.5) / alpha;
        assert!((met.along - along).abs() < CLOSE, "{met:?} for {along}");
        let seen = frames.colors(&ray, &reading);
        let wanted = Vec4::new(0.25, 0.0, 0.75 * half, alpha);
        assert!((seen.lit - wanted).length() < 1e-6, "{seen:?}");
        assert_eq!(seen.albedo, seen.lit, "no other is kept");
        assert!((seen.normal - Vec3::Z * alpha).length() < 1e-6, "that of the frames: {seen:?}");
        // who stands between the two sees only the far one
        let inside = Ray { start: 0.0, ..ray };
        let met = frames.met(&inside, &reading).expect("there");
        assert!((met.alpha - 0.75 * half).abs() < 1e-6, "{met:?}");
        assert!((met.along - 0.5).abs() < CLOSE, "{met:?}");
    }

    #[test]
    fn a_frame_whose_depth_is_not_the_rays_counts_less() {
        // the first frame is empty; the second is blue, its left half at z = 1 and its right half at -0.5
        let mut made = parts();
        let texel = |i: usize| if i % 8 < 4 { [0; 4] } else { [0, 0, 255, 255] };
        let color = Image::new(8, 4, (0..32).map(texel).collect()).expect("valid");
        made.color = Texture::new(vec![color]).expect("valid");
        let share = |i: usize| [0.5, 0.5, 1.0, 0.25][i % 8 / 2];
        let codes = (0..32).map(|i| encode(share(i), 16)).collect();
        made.depth = depths(DepthLevel { width: 8, height: 4, codes });
        let frame = made.frames[0].expect("first");
        let at = |u: f32| Some(Frame { corner: Vec2::new(u, 0.0), ..frame });
        made.frames = vec![at(0.0), at(0.5)];
        made.size = Vec2::new(0.5, 1.0);
        let frames = Frames::new(made).expect("fits");
        // from the right to z = 0 at x = -0.75, which is left; so to z = 1 at x = 0.25, which is right, 1.5
        // times the reach below
        let ray = slanted(Vec3::new(-0.75, 0.0, 0.0));
        let alpha = |tolerance: f32, chosen: Chosen| {
            let reading = Reading { chosen, tolerance, ..reading(1) };
            let found = frames.met(&ray, &reading).expect("there").alpha;
            let lit = frames.colors(&ray, &reading).lit;
            assert!((lit - Vec4::new(0.0, 0.0, found, found)).length() < 1e-6, "{lit}");
            found
        };
        let (both, alone) = ([(0, 0.5), (1, 0.5), (0, 0.0)], [(1, 1.0), (0, 0.0), (0, 0.0)]);
        // at the tolerance it counts half, at twice the tolerance a fifth
        for (tolerance, trust) in [(f32::INFINITY, 1.0), (1.5, 0.5), (0.75, 0.2)] {
            let wanted = 0.5 * trust / (0.5 + 0.5 * trust);
            let found = alpha(tolerance, both);
            assert!((found - wanted).abs() < 1e-4, "{tolerance}: {found} for {wanted}");
            assert!((alpha(tolerance, alone) - 1.0).abs() < 1e-6, "the others take it over");
        }
    }

    #[test]
    fn nothing_is_seen_from_behind_or_the_side() {
        for direction in [Vec3::Z, Vec3::X, Vec3::new(1.0, 0.0, -0.01).normalize()] {
            let ray = Ray { point: Vec3::ZERO, direction, start: f32::NEG_INFINITY };
            for step_count in 0..2 {
                assert_eq!(frames().met(&ray, &reading(step_count)), None, "along {direction}");
            }
            assert_eq!(frames().on_plane(&ray, 0), None, "along {direction}");
        }
        let ray = Ray { point: Vec3::ZERO, direction: Vec3::NEG_Z, start: f32::NEG_INFINITY };
        let missing = Reading { chosen: [(1, 1.0), (7, 1.0), (0, 0.0)], ..reading(1) };
        assert_eq!(frames().met(&ray, &missing), None, "not baked, and no frame");
        assert_eq!(
            (frames().has(0), frames().has(1), frames().has(7)),
            (true, false, false),
            "one"
        );
    }

    #[test]
    fn texels_are_counted_on_the_plane() {
        let ray = slanted(Vec3::new(0.5, 0.25, 0.0));
        let at = frames().on_plane(&ray, 0).expect("seen");
        // two texels a metre
        assert!((at - Vec2::new(1.0, 0.5)).length() < 1e-6, "{at}");
    }

    /// White frames whose normals are all the same, half leaves, under a sun along +x.
    fn relit(normal: [u8; 3]) -> Parts {
        let [x, y, z] = normal;
        let map = NormalMap::new(vec![image(vec![[x, y, z, 255]; 16])]).expect("valid");
        let light = Light {
            sun_direction: Vec3::X,
            sun: Vec3::new(0.5, 0.25, 0.0),
            sky: Vec3::ZERO,
            ground: Vec3::ZERO,
            translucency: 0.25,
        };
        Parts {
            color: Texture::new(vec![image(vec![[255, 255, 255, 128]; 16])]).expect("valid"),
            relit: Some(Relit { normal: Arc::new(map), light }),
            ..parts()
        }
    }

    #[test]
    fn kept_normals_are_lit_when_they_are_looked_at() {
        let ray = Ray { point: Vec3::ZERO, direction: Vec3::NEG_Z, start: f32::NEG_INFINITY };
        // 127 and 128 are either side of 0
        for (normal, share) in [([255, 127, 127], 0.75), ([0, 127, 127], 0.25)] {
            let seen = Frames::new(relit(normal)).expect("fits").colors(&ray, &reading(0));
            let alpha = 128.0 / 255.0;
            assert!((seen.albedo - Vec4::splat(alpha)).abs().max_element() < 1e-6, "{seen:?}");
            let wanted = Vec4::new(0.5 * share, 0.25 * share, 0.0, 1.0) * alpha;
            assert!((seen.lit - wanted).abs().max_element() < 1e-4, "{seen:?} for {wanted}");
            let toward = if normal[0] == 255 { Vec3::X } else { Vec3::NEG_X };
            assert!((seen.normal - toward * alpha).length() < 4e-3, "{seen:?}");
        }
        let kept = Frames::new(relit([255, 127, 127])).expect("fits");
        assert_eq!(kept.byte_count(), 16 * (4 + 2 + 4), "colour, depth and normal");
        assert_eq!(frames().byte_count(), 16 * 6, "colour and depth");
    }

    #[test]
    fn parts_must_fit_together() {
        let small = Texture::new(vec![Image::new(1, 1, vec![RED]).expect("valid")]).expect("valid");
        let one = NormalMap::new(vec![Image::new(1, 1, vec![RED]).expect("valid")]);
        let light = relit([0; 3]).relit.expect("lit").light;
        let small_normals = Relit { normal: Arc::new(one.expect("valid")), light };
        for bad in [
            Parts { relit: Some(small_normals), ..parts() },
            Parts { color: small, ..parts() },
            Parts { reach: 0.0, ..parts() },
            Parts { reach: f32::NAN, ..parts() },
            Parts { bounds: [Vec3::ONE, Vec3::ZERO], ..parts() },
            Parts { bounds: [Vec3::NAN, Vec3::ZERO], ..parts() },
            Parts { center: Vec3::NAN, ..parts() },
            Parts { size: Vec2::ZERO, ..parts() },
        ] {
            let text = Frames::new(bad).expect_err("refused").to_string();
            assert!(text.starts_with("frames"), "{text}");
        }
    }
}
