//! A map of where copies of one small picture lie: which of its turned versions, and where.
//!
//! Cards full of like leaves need not store each leaf's texels. A texel of the map names, for each of
//! a few layers, the leaf that is seen there: the corner of its square in texture space, how it is
//! turned, and its tint. The leaf itself is drawn from a second texture that holds it at evenly spread
//! angles. The map is read without filtering and has no levels; the second texture has both.
//!
//! This work is based on:
//! Ismael Garcia, Mateu Sbert, László Szirmay-Kalos. Leaf Cluster Impostors for Tree Rendering with
//! Parallax. 2005

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{Vec2, Vec3, Vec4};

use crate::error::{LodError, check_in};
use crate::texture::srgb::LINEAR_FROM_SRGB8;
use crate::texture::texture::{Sampler, Texture, check_size};

/// Alpha from which a layer hides those behind it.
const HIDES: f32 = 0.5;

/// Steps of a corner's coordinate; the code above them all is no leaf.
const CORNER_STEPS: f32 = 65_534.0;

/// Layers, at most.
pub const MAX_LAYER_COUNT: usize = 8;

/// Turned versions, at most: seven bits, and one for mirrored leaves.
pub const MAX_ROTATION_COUNT: usize = 128;

/// One leaf as the map stores it: eight bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LeafPlace {
    /// Least u and v of the leaf's square, in steps over the map and a leaf's size around it; all ones
    /// where there is no leaf.
    corner: [u16; 2],
    /// Which turned version, and whether it is mirrored first (the highest bit).
    rotation: u8,
    /// sRGB share of the map's largest tint.
    tint: [u8; 3],
}

impl LeafPlace {
    /// No leaf.
    pub const NONE: Self = Self { corner: [u16::MAX; 2], rotation: 0, tint: [0; 3] };

    /// A leaf whose square, of side `leaf_size`, has its least coordinates at `corner`.
    ///
    /// The square may reach out of the map by its own size.
    pub fn new(corner: Vec2, leaf_size: Vec2, rotation: u8, mirrored: bool, tint: [u8; 3]) -> Self {
        let corner = (corner + leaf_size) / (leaf_size * 2.0 + 1.0);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let step = |at: f32| (at * CORNER_STEPS + 0.5).clamp(0.0, CORNER_STEPS) as u16;
        let mirror = if mirrored { 0x80 } else { 0 };
        Self { corner: [step(corner.x), step(corner.y)], rotation: rotation | mirror, tint }
    }

    /// As two words, the first byte lowest: the corner; rotation and tint.
    #[cfg(feature = "gpu")]
    pub(crate) fn words(self) -> [u32; 2] {
        let [u, v] = self.corner;
        let [r, g, b] = self.tint;
        [u32::from(u) | u32::from(v) << 16, u32::from_le_bytes([self.rotation, r, g, b])]
    }

    #[inline]
    fn corner(self, leaf_size: Vec2) -> Option<Vec2> {
        let [u, v] = self.corner.map(f32::from);
        let share = Vec2::new(u, v) * (1.0 / CORNER_STEPS);
        let there = self.corner != [u16::MAX; 2];
        there.then(|| share * (leaf_size * 2.0 + 1.0) - leaf_size)
    }
}

/// Where leaves lie. Immutable, with an id that no other of this process has.
#[derive(Debug)]
pub struct Distribution {
    id: u64,
    width: u32,
    height: u32,
    layer_count: usize,
    /// Side of a leaf's square in texture space.
    leaf_size: Vec2,
    /// Upper left corner of each turned version in the second texture.
    versions: Vec<Vec2>,
    /// Side of a version in the second texture.
    version_size: Vec2,
    largest_tint: f32,
    /// Layer after layer, the nearest first; rows from the top.
    places: Vec<LeafPlace>,
}

/// What another renderer needs to read a distribution.
#[cfg(feature = "gpu")]
#[derive(Debug)]
pub(crate) struct Layout<'a> {
    pub(crate) size: (u32, u32),
    pub(crate) layer_count: u32,
    pub(crate) leaf_size: Vec2,
    pub(crate) versions: &'a [Vec2],
    pub(crate) version_size: Vec2,
    pub(crate) largest_tint: f32,
    pub(crate) places: &'a [LeafPlace],
}

/// What a distribution is made of.
#[derive(Debug, Clone)]
pub struct Parts {
    /// Texels of a layer, width and height.
    pub size: (u32, u32),
    /// Layers, the nearest first.
    pub layers: Vec<Vec<LeafPlace>>,
    /// Side of a leaf's square in texture space.
    pub leaf_size: Vec2,
    /// Upper left corner of each turned version in the second texture.
    pub versions: Vec<Vec2>,
    /// Side of a version in the second texture.
    pub version_size: Vec2,
    /// Tint that a code of 255 stands for.
    pub largest_tint: f32,
}

impl Distribution {
    /// Freezes the parts.
    ///
    /// # Errors
    /// `layers`, `rotation_count` or a size out of range, or a place that names no version.
    pub fn new(parts: Parts) -> Result<Arc<Self>, LodError> {
        static NEXT_ID: AtomicU64 = AtomicU64::new(0);
        let Parts { size, layers, leaf_size, versions, version_size, largest_tint } = parts;
        check_size("distribution", size.0, size.1)?;
        check_in("layers", layers.len(), 1..=MAX_LAYER_COUNT)?;
        check_in("rotation_count", versions.len(), 1..=MAX_ROTATION_COUNT)?;
        let texel_count = size.0 as usize * size.1 as usize;
        let layer_count = layers.len();
        let places: Vec<LeafPlace> = layers.into_iter().flatten().collect();
        let named = |place: &LeafPlace| usize::from(place.rotation & 0x7F) < versions.len();
        let sized = leaf_size.min_element() > 0.0 && version_size.min_element() > 0.0;
        if places.len() != texel_count * layer_count || !places.iter().all(named) || !sized {
            let why = "its layers, versions and sizes do not fit together".to_owned();
            return Err(LodError::Invalid { name: "distribution", why });
        }
        let id = NEXT_ID.fetch_add(1, Ordering::Relaxed);
        let (width, height) = size;
        Ok(Arc::new(Self {
            id,
            width,
            height,
            layer_count,
            leaf_size,
            versions,
            version_size,
            largest_tint,
            places,
        }))
    }

    /// Unique in this process; the cache key of a renderer.
    pub fn id(&self) -> u64 {
        self.id
    }

    /// What another renderer needs.
    #[cfg(feature = "gpu")]
    pub(crate) fn layout(&self) -> Layout<'_> {
        Layout {
            size: (self.width, self.height),
            layer_count: u32::try_from(self.layer_count).expect("checked when made"),
            leaf_size: self.leaf_size,
            versions: &self.versions,
            version_size: self.version_size,
            largest_tint: self.largest_tint,
            places: &self.places,
        }
    }

    /// Bytes of all layers as stored.
    pub fn byte_count(&self) -> u64 {
        (self.places.len() * size_of::<LeafPlace>()) as u64
    }

    /// Texels of `leaves`, the second texture, that a step in texture space crosses.
    pub fn texels(&self, leaves: &Texture) -> Vec2 {
        let (width, height) = leaves.size();
        Vec2::new(width as f32, height as f32) * self.version_size / self.leaf_size
    }

    /// The leaf of a layer at a texel, and the point of its square that a coordinate is.
    #[inline]
    fn at(&self, layer: usize, texel: usize, uv: Vec2) -> Option<(LeafPlace, Vec2)> {
        let place = self.places[layer * self.width as usize * self.height as usize + texel];
        let mut inside = (uv - place.corner(self.leaf_size)?) / self.leaf_size;
        if place.rotation & 0x80 != 0 {
            inside.x = 1.0 - inside.x;
        }
        let outside = inside.min_element() < 0.0 || inside.max_element() > 1.0;
        (!outside).then_some((place, inside))
    }

    #[inline]
    fn texel(&self, uv: Vec2) -> usize {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let index = |at: f32, size: u32| (at * size as f32).clamp(0.0, (size - 1) as f32) as usize;
        index(uv.y, self.height) * self.width as usize + index(uv.x, self.width)
    }

    #[inline]
    fn in_leaves(&self, place: LeafPlace, inside: Vec2) -> Vec2 {
        self.versions[usize::from(place.rotation & 0x7F)] + inside * self.version_size
    }

    /// The nearest layer whose alpha hides what is behind it, else that of the largest alpha.
    #[inline]
    fn seen(
        &self,
        leaves: &Texture,
        sampler: Sampler,
        uv: Vec2,
        lod: f32,
    ) -> Option<(LeafPlace, Vec2, f32)> {
        let texel = self.texel(uv);
        let mut seen: Option<(LeafPlace, Vec2, f32)> = None;
        for layer in 0..self.layer_count {
            let Some((place, inside)) = self.at(layer, texel, uv) else { continue };
            let at = self.in_leaves(place, inside);
            let alpha = leaves.alpha(sampler, at, lod);
            if seen.is_none_or(|(.., most)| alpha > most) {
                seen = Some((place, at, alpha));
            }
            if alpha >= HIDES {
                break;
            }
        }
        seen
    }

    /// Alpha at a point of the map.
    #[inline]
    pub fn alpha(&self, leaves: &Texture, sampler: Sampler, uv: Vec2, lod: f32) -> f32 {
        self.seen(leaves, sampler, uv, lod).map_or(0.0, |(.., alpha)| alpha)
    }

    /// Premultiplied linear colour at a point of the map.
    #[inline]
    pub fn sample(&self, leaves: &Texture, sampler: Sampler, uv: Vec2, lod: f32) -> Vec4 {
        let Some((place, at, _)) = self.seen(leaves, sampler, uv, lod) else { return Vec4::ZERO };
        let table = &*LINEAR_FROM_SRGB8;
        let [r, g, b] = place.tint.map(|code| table[usize::from(code)]);
        leaves.sample(sampler, at, lod) * (Vec3::new(r, g, b) * self.largest_tint).extend(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texture::{Filter, Image, Wrap};

    const NEAREST: Sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: Filter::Nearest };

    const HALF: Vec2 = Vec2::splat(0.5);

    /// Two versions side by side: the left half of the first is there, the top half of the second.
    fn leaves() -> Arc<Texture> {
        let there = |x: u32, y: u32| if x < 2 { x == 0 } else { y == 0 };
        let texel = |i: u32| [255, 255, 255, if there(i % 4, i / 4) { 255 } else { 0 }];
        let image = Image::new(4, 2, (0..8).map(texel).collect()).expect("valid");
        Texture::new(vec![image]).expect("valid")
    }

    fn map(layers: Vec<Vec<LeafPlace>>) -> Arc<Distribution> {
        let versions = vec![Vec2::ZERO, Vec2::new(0.5, 0.0)];
        Distribution::new(Parts {
            size: (2, 1),
            layers,
            leaf_size: HALF,
            versions,
            version_size: Vec2::new(0.5, 1.0),
            largest_tint: 2.0,
        })
        .expect("valid")
    }

    #[test]
    fn a_leaf_lies_where_its_corner_says() {
        //  texel 0: a leaf from (0, 0) to (0.5, 0.5)   texel 1: nothing
        let leaf = LeafPlace::new(Vec2::ZERO, HALF, 0, false, [255, 0, 0]);
        let (map, leaves) = (map(vec![vec![leaf, LeafPlace::NONE]]), leaves());
        let alpha = |u: f32, v: f32| map.alpha(&leaves, NEAREST, Vec2::new(u, v), 0.0);
        assert_eq!(alpha(0.2, 0.1), 1.0, "left half of the leaf");
        assert_eq!(alpha(0.3, 0.1), 0.0, "right half of the leaf");
        assert_eq!(alpha(0.2, 0.6), 0.0, "below its square");
        assert_eq!(alpha(0.7, 0.1), 0.0, "another texel");
        let color = map.sample(&leaves, NEAREST, Vec2::new(0.2, 0.1), 0.0);
        assert_eq!(color, Vec4::new(2.0, 0.0, 0.0, 1.0), "tinted");
        assert_eq!(map.texels(&leaves), Vec2::new(4.0, 4.0), "a square holds two texels");
        assert_eq!(map.byte_count(), 16, "eight a texel");
    }

    #[test]
    fn leaves_are_mirrored_and_turned() {
        let mirrored = LeafPlace::new(Vec2::ZERO, HALF, 0, true, [255; 3]);
        let turned = LeafPlace::new(Vec2::new(0.5, 0.0), HALF, 1, false, [255; 3]);
        let (map, leaves) = (map(vec![vec![mirrored, turned]]), leaves());
        let alpha = |u: f32, v: f32| map.alpha(&leaves, NEAREST, Vec2::new(u, v), 0.0);
        assert_eq!((alpha(0.2, 0.1), alpha(0.3, 0.1)), (0.0, 1.0), "right half");
        assert_eq!((alpha(0.9, 0.2), alpha(0.9, 0.3)), (1.0, 0.0), "top half");
    }

    #[test]
    fn near_layers_hide_far_ones() {
        let near = LeafPlace::new(Vec2::ZERO, HALF, 0, false, [255, 0, 0]);
        let far = LeafPlace::new(Vec2::ZERO, HALF, 1, false, [0, 255, 0]);
        let map = map(vec![vec![near, LeafPlace::NONE], vec![far, LeafPlace::NONE]]);
        let leaves = leaves();
        let color = |u: f32, v: f32| map.sample(&leaves, NEAREST, Vec2::new(u, v), 0.0);
        assert_eq!(color(0.1, 0.1), Vec4::new(2.0, 0.0, 0.0, 1.0), "both: the nearer");
        assert_eq!(color(0.4, 0.1), Vec4::new(0.0, 2.0, 0.0, 1.0), "the far one alone");
        assert_eq!(color(0.4, 0.4), Vec4::ZERO, "neither");
    }

    #[test]
    fn parts_must_fit_together() {
        let good = Parts {
            size: (1, 1),
            layers: vec![vec![LeafPlace::NONE]],
            leaf_size: Vec2::ONE,
            versions: vec![Vec2::ZERO],
            version_size: Vec2::ONE,
            largest_tint: 1.0,
        };
        assert!(Distribution::new(good.clone()).is_ok(), "fits");
        let stray = LeafPlace::new(Vec2::ZERO, HALF, 1, false, [0; 3]);
        for (bad, name) in [
            (Parts { layers: vec![], ..good.clone() }, "layers"),
            (Parts { layers: vec![vec![]], ..good.clone() }, "distribution"),
            (Parts { layers: vec![vec![stray]], ..good.clone() }, "distribution"),
            (Parts { versions: vec![], ..good.clone() }, "rotation_count"),
            (Parts { leaf_size: Vec2::ZERO, ..good.clone() }, "distribution"),
            (Parts { size: (0, 1), ..good }, "distribution"),
        ] {
            let text = Distribution::new(bad).expect_err("refused").to_string();
            assert!(text.starts_with(name), "{text}");
        }
    }
}
