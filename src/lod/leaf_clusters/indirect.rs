//! Cards that name their leaves instead of storing their texels.
//!
//! One leaf stands for all: of the commonest kind, the one whose area is nearest to the mean. It is
//! baked once at evenly spread angles. For every leaf of a card the angle is found that lays the
//! picture best over it, mirrored where that fits better; its size is the mean of all. A card's map
//! then names, for each of its texels, the leaves that show most of themselves there.
//!
//! Right for plants of like leaves; flowers among leaves turn into leaves.
//!
//! This work is based on:
//! Ismael Garcia, Mateu Sbert, László Szirmay-Kalos. Leaf Cluster Impostors for Tree Rendering with
//! Parallax. 2005
//!
//! Deviations: a leaf's square may lie anywhere, at steps of 1/65534 of the map; leaves have a tint,
//! since light belongs to vertices; leaves seen from behind are mirrored.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::sync::Arc;

use glam::{DVec2, DVec3, Vec2, Vec3};
use rayon::prelude::*;

use crate::bake::{self, BakeRect, bake};
use crate::error::{LodError, check_in, check_limit};
use crate::job::Job;
use crate::lod::leaf_clusters::impostor::Impostor;
use crate::lod::leaves::{LEAST_SIZE, Leaves, Placed};
use crate::raster::Renderer;
use crate::texture::atlas::Atlas;
use crate::texture::distribution::{LeafPlace, MAX_LAYER_COUNT, MAX_ROTATION_COUNT, Parts};
use crate::texture::mips::Keep;
use crate::texture::srgb::srgb8_from_linear;
use crate::texture::{Distribution, Filter, Format, Sampler, Texture, Wrap};

/// Points a side of a texel at which it is asked which leaves show there; 64 in all, a bit each.
const PROBES: u32 = 8;

/// Texels that are filled between looks at the job.
const TEXELS_PER_CHECK: usize = 1 << 14;

/// Pairs of a leaf and a texel that it may show in, of a level: gigabytes beyond.
const MAX_PAIRS: u64 = 1 << 27;

/// Texels of a level's map, all layers.
const MAX_MAP_TEXELS: u64 = 1 << 26;

/// How leaves are named.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Indirect {
    /// Leaves that a texel can name, one behind the other.
    pub layer_count: usize,
    /// Angles at which the leaf is baked.
    pub rotation_count: usize,
    /// Texels a side of the leaf's picture.
    pub leaf_resolution: u32,
    /// Texels of the map along the side of a leaf's square.
    pub texels_per_leaf: u32,
}

impl Indirect {
    /// Refuses what no map can hold.
    ///
    /// # Errors
    /// [`LodError::OutOfRange`].
    pub fn check(&self) -> Result<(), LodError> {
        check_in("layers", self.layer_count, 1..=MAX_LAYER_COUNT)?;
        check_in("rotation_count", self.rotation_count, 1..=MAX_ROTATION_COUNT)?;
        check_in("leaf_resolution", self.leaf_resolution, 1..=1024)?;
        check_in("texels_per_leaf", self.texels_per_leaf, 1..=64)
    }
}

/// The leaf that stands for all, at every angle.
pub(super) struct LeafPicture {
    pub(super) texture: Arc<Texture>,
    versions: Vec<Vec2>,
    version_size: Vec2,
    /// Side of its square in metres.
    side: f64,
    /// Square metres as seen along its normal.
    area: f64,
    /// Its vertices about its centre, in its plane.
    points: Vec<DVec2>,
    /// Mean lit colour of the side that was baked.
    color: Vec3,
}

impl LeafPicture {
    /// Bakes the leaf that stands for all.
    pub(super) fn new(
        leaves: &Leaves<'_>,
        params: &Indirect,
        sample_count: u32,
        keep: Keep,
        renderer: &mut Renderer,
        job: &Job,
    ) -> Result<Self, LodError> {
        let leaf = representative(leaves);
        let foliage = &leaves.plant.foliage;
        let normal = foliage.normals[leaf].as_dvec3().normalize_or(DVec3::Z);
        let x = normal.any_orthonormal_vector();
        let y = normal.cross(x);
        let center = leaves.leaf_centers[leaf];
        let points = flat_points(leaves, leaf, x, y);
        let radius = points.iter().map(|p| p.length()).fold(0.0, f64::max);
        let side = (2.0 * radius).max(LEAST_SIZE);
        let resolution = params.leaf_resolution;
        let sizes = vec![(resolution, resolution); params.rotation_count];
        let atlas = Atlas::new("leaf_resolution", &sizes)?;
        let mut levels = atlas.levels();
        for version in 0..params.rotation_count {
            job.check()?;
            let (sine, cosine) = libm::sincos(version as f64 / params.rotation_count as f64 * TAU);
            let rect = BakeRect {
                center: center + leaves.center,
                right: x * cosine - y * sine,
                up: x * sine + y * cosine,
                width: side,
                height: side,
                reach: side,
            };
            let view = rect.view((resolution, resolution))?;
            let list = leaves.list(&view, &[Placed { leaf, cut: false }], [0.0, f32::INFINITY]);
            let image = bake(renderer, &list, &view, sample_count, job)?;
            let padded = atlas.padded(version, &image);
            atlas.put(version, &bake::levels(&padded, keep, job)?, &mut levels);
        }
        #[expect(clippy::cast_possible_truncation, reason = "texture coordinates are f32")]
        let in_atlas = |version: usize, at: [f64; 2]| {
            let [u, v] = atlas.uv(version, at);
            Vec2::new(u as f32, v as f32)
        };
        let corner = |version| in_atlas(version, [0.0, 0.0]);
        Ok(Self {
            texture: bake::stored(levels, Format::Rgba8, job)?,
            versions: (0..params.rotation_count).map(corner).collect(),
            version_size: in_atlas(0, [1.0, 1.0]) - corner(0),
            side,
            area: flat_area(&points),
            points,
            color: leaves.mean_lit(leaf, normal),
        })
    }

    /// How a version has to be laid over a leaf, from the leaf's vertices about its centre: its
    /// number, and whether it is mirrored from left to right first.
    fn version_of(&self, points: &[DVec2]) -> (u8, bool) {
        // the turn that brings the picture's points nearest to the leaf's, and how near
        let turn = |mirror: f64| {
            let sum = self.points.iter().zip(points).fold(DVec2::ZERO, |sum, (p, q)| {
                let p = DVec2::new(p.x * mirror, p.y);
                sum + DVec2::new(p.dot(*q), p.perp_dot(*q))
            });
            (sum.length(), libm::atan2(sum.y, sum.x))
        };
        let (angle, mirrored) = if points.len() == self.points.len() {
            let ((plain, angle), (turned, other)) = (turn(1.0), turn(-1.0));
            // to turn and then mirror is to mirror and then turn back
            if turned > plain { (-other, true) } else { (angle, false) }
        } else {
            (long_axis(points) - long_axis(&self.points), false)
        };
        let count = self.versions.len();
        let share = (angle / TAU).rem_euclid(1.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "in [0, count]"
        )]
        let version = (share * count as f64).round() as usize % count;
        (u8::try_from(version).expect("at most 128 versions"), mirrored)
    }
}

/// One side of a card, as its map sees it.
pub(super) struct MapSide<'a> {
    pub(super) impostor: &'a Impostor,
    pub(super) rect: BakeRect,
}

/// The map of a level's card sides, and for each the part of it that is the whole card: its upper
/// left corner, and its size.
pub(super) struct Map {
    pub(super) distribution: Arc<Distribution>,
    pub(super) parts: Vec<[Vec2; 2]>,
    pub(super) fill: f64,
}

/// A leaf on a card.
struct Laid {
    /// About the card's upper left, in metres, y down.
    center: DVec2,
    version: u8,
    mirrored: bool,
    /// Over the picture's colour.
    tint: Vec3,
}

impl Map {
    pub(super) fn new(
        leaves: &Leaves<'_>,
        picture: &LeafPicture,
        sides: &[MapSide<'_>],
        params: &Indirect,
        job: &Job,
    ) -> Result<Self, LodError> {
        let scale = size_of_all(leaves, picture, sides);
        // leaves without area have a picture without any, of whatever size
        let any = leaves.radius.max(LEAST_SIZE);
        let side = if picture.area > 0.0 { picture.side * scale } else { any };
        let texel = side / f64::from(params.texels_per_leaf);
        let texels: f64 =
            sides.iter().map(|s| s.rect.width * s.rect.height / (texel * texel)).sum();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
        let asked = (texels * params.layer_count as f64) as u64;
        check_limit("texels_per_leaf", asked, MAX_MAP_TEXELS, "texels")?;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "checked above"
        )]
        let size = |metres: f64| (metres / texel).ceil().max(1.0) as u32;
        let sizes: Vec<_> =
            sides.iter().map(|s| (size(s.rect.width), size(s.rect.height))).collect();
        let named: u64 = sides.iter().map(|side| side.impostor.leaves.len() as u64).sum();
        let across = u64::from(params.texels_per_leaf) + 1;
        check_limit("texels_per_leaf", named * across * across, MAX_PAIRS, "leaves in texels")?;
        let atlas = Atlas::with_levels("texels_per_leaf", &sizes, 1)?;
        let map_size = DVec2::new(f64::from(atlas.width), f64::from(atlas.height));
        let leaf_size = DVec2::splat(f64::from(params.texels_per_leaf)) / map_size;
        let laid: Vec<Vec<Laid>> = sides
            .par_iter()
            .map(|side| {
                job.check()?;
                Ok(laid_leaves(leaves, picture, side))
            })
            .collect::<Result<_, LodError>>()?;
        let largest = laid.iter().flatten().map(|leaf| leaf.tint.max_element()).fold(0.0, f32::max);
        let largest_tint = if largest > 0.0 { largest } else { 1.0 };
        let place = |leaf: &Laid, at: [u32; 2]| {
            let middle = DVec2::new(f64::from(at[0]), f64::from(at[1])) + leaf.center / texel;
            let corner = middle / map_size - leaf_size * 0.5;
            let tint = (leaf.tint / largest_tint).to_array().map(srgb8_from_linear);
            let sizes = leaf_size.as_vec2();
            LeafPlace::new(corner.as_vec2(), sizes, leaf.version, leaf.mirrored, tint)
        };
        let filled: Vec<Vec<Vec<LeafPlace>>> = laid
            .par_iter()
            .zip(&atlas.places)
            .zip(&sizes)
            .map(|((laid, &at), &size)| {
                job.check()?;
                let places = laid.iter().map(|leaf| place(leaf, at)).collect::<Vec<_>>();
                fill(picture, laid, &places, size, side / texel, texel, params.layer_count, job)
            })
            .collect::<Result<_, LodError>>()?;
        let texel_count = atlas.width as usize * atlas.height as usize;
        let mut layers = vec![vec![LeafPlace::NONE; texel_count]; params.layer_count];
        for ((filled, &[x, y]), &(width, _)) in filled.iter().zip(&atlas.places).zip(&sizes) {
            for (layer, filled) in layers.iter_mut().zip(filled) {
                for (row, texels) in (y as usize..).zip(filled.chunks_exact(width as usize)) {
                    let start = row * atlas.width as usize + x as usize;
                    layer[start..start + texels.len()].copy_from_slice(texels);
                }
            }
        }
        let parts = sides.iter().zip(&atlas.places).map(|(side, &[x, y])| {
            let corner = DVec2::new(f64::from(x), f64::from(y)) / map_size;
            let size = DVec2::new(side.rect.width, side.rect.height) / texel / map_size;
            [corner.as_vec2(), size.as_vec2()]
        });
        Ok(Self {
            parts: parts.collect(),
            fill: atlas.fill(),
            distribution: Distribution::new(Parts {
                size: (atlas.width, atlas.height),
                layers,
                leaf_size: leaf_size.as_vec2(),
                versions: picture.versions.clone(),
                version_size: picture.version_size,
                largest_tint,
            })?,
        })
    }
}

/// The leaf of the commonest kind whose area is nearest to the mean of its kind.
fn representative(leaves: &Leaves<'_>) -> usize {
    let foliage = &leaves.plant.foliage;
    let kind = |leaf: usize| {
        let triangles = foliage.triangles_of(leaf);
        (leaves.materials[triangles.start], triangles.len())
    };
    let mut kinds: BTreeMap<(u32, usize), (usize, f64)> = BTreeMap::new();
    for leaf in 0..foliage.leaf_count() {
        let (count, area) = kinds.entry(kind(leaf)).or_default();
        *count += 1;
        *area += f64::from(foliage.areas[leaf]);
    }
    // of equally common ones the first
    let commonest = kinds.iter().rev().max_by_key(|(_, (count, _))| *count);
    let (&chosen, &(count, area)) = commonest.expect("a crown has leaves");
    let mean = area / count as f64;
    let off = |leaf: usize| (f64::from(foliage.areas[leaf]) - mean).abs();
    (0..foliage.leaf_count())
        .filter(|&leaf| kind(leaf) == chosen)
        .min_by(|&a, &b| off(a).total_cmp(&off(b)))
        .expect("the kind was counted")
}

/// A leaf's vertices about its centre along two directions, three a triangle.
fn flat_points(leaves: &Leaves<'_>, leaf: usize, right: DVec3, up: DVec3) -> Vec<DVec2> {
    let center = leaves.leaf_centers[leaf];
    let flat = |v: DVec3| DVec2::new((v - center).dot(right), (v - center).dot(up));
    leaves.vertices_of(leaf).map(flat).collect()
}

fn flat_area(points: &[DVec2]) -> f64 {
    let doubled = |t: &[DVec2; 3]| (t[1] - t[0]).perp_dot(t[2] - t[0]).abs();
    points.as_chunks::<3>().0.iter().map(doubled).sum::<f64>() / 2.0
}

/// Angle of the direction in which points reach farthest from their mean, towards the longer end.
fn long_axis(points: &[DVec2]) -> f64 {
    let mean = points.iter().copied().sum::<DVec2>() / points.len() as f64;
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for p in points {
        let from = *p - mean;
        (xx, xy, yy) = (xx + from.x * from.x, xy + from.x * from.y, yy + from.y * from.y);
    }
    let angle = 0.5 * libm::atan2(2.0 * xy, xx - yy);
    let (sine, cosine) = libm::sincos(angle);
    let skew: f64 = points.iter().map(|p| (*p - mean).dot(DVec2::new(cosine, sine)).powi(3)).sum();
    if skew < 0.0 { angle + TAU / 2.0 } else { angle }
}

/// The size at which the picture covers as much as all leaves do, over its own.
fn size_of_all(leaves: &Leaves<'_>, picture: &LeafPicture, sides: &[MapSide<'_>]) -> f64 {
    let areas: Vec<(f64, usize)> = sides
        .par_iter()
        .map(|MapSide { impostor, rect }| {
            let area =
                |placed: &Placed| flat_area(&flat_points(leaves, placed.leaf, rect.right, rect.up));
            (impostor.leaves.iter().map(area).sum(), impostor.leaves.len())
        })
        .collect();
    let (area, count) = areas.iter().fold((0.0, 0), |sum, part| (sum.0 + part.0, sum.1 + part.1));
    if area > 0.0 && picture.area > 0.0 {
        (area / (count as f64 * picture.area)).sqrt()
    } else {
        1.0
    }
}

/// A card's leaves, those nearest to its viewer first.
fn laid_leaves(leaves: &Leaves<'_>, picture: &LeafPicture, side: &MapSide<'_>) -> Vec<Laid> {
    let MapSide { impostor, rect } = side;
    let (right, up, toward) = (rect.right, rect.up, rect.toward());
    let upper_left = rect.center - right * (rect.width * 0.5) + up * (rect.height * 0.5);
    let mut order: Vec<(f64, usize)> = impostor
        .leaves
        .iter()
        .map(|placed| (leaves.leaf_centers[placed.leaf].dot(toward), placed.leaf))
        .collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let laid = |&(_, leaf): &(f64, usize)| {
        let from = leaves.leaf_centers[leaf] + leaves.center - upper_left;
        let (version, mirrored) = picture.version_of(&flat_points(leaves, leaf, right, up));
        let tint = leaves.mean_lit(leaf, toward) / picture.color.max(Vec3::splat(1e-6));
        Laid { center: DVec2::new(from.dot(right), -from.dot(up)), version, mirrored, tint }
    };
    order.iter().map(laid).collect()
}

/// Which leaves each texel of a card names, layer by layer.
///
/// A leaf is named where most of what is not hidden by named leaves before it is, until the layers
/// are full; the nearest is then put first.
#[expect(clippy::too_many_arguments, reason = "called from one place")]
fn fill(
    picture: &LeafPicture,
    laid: &[Laid],
    places: &[LeafPlace],
    (width, height): (u32, u32),
    texels_per_leaf: f64,
    texel: f64,
    layer_count: usize,
    job: &Job,
) -> Result<Vec<Vec<LeafPlace>>, LodError> {
    let sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: Filter::Bilinear };
    let mut shown: Vec<Vec<(usize, u64)>> = vec![Vec::new(); width as usize * height as usize];
    for (number, leaf) in laid.iter().enumerate() {
        job.check()?;
        let corner = leaf.center / texel - texels_per_leaf * 0.5;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let range = |low: f64, size: u32| {
            let end = (low + texels_per_leaf).ceil().clamp(0.0, f64::from(size)) as u32;
            (low.floor().clamp(0.0, f64::from(size)) as u32)..end
        };
        for y in range(corner.y, height) {
            for x in range(corner.x, width) {
                let mut mask = 0_u64;
                for probe in 0..PROBES * PROBES {
                    let within = DVec2::new(f64::from(probe % PROBES), f64::from(probe / PROBES));
                    let at =
                        DVec2::new(f64::from(x), f64::from(y)) + (within + 0.5) / f64::from(PROBES);
                    let mut inside = ((at - corner) / texels_per_leaf).as_vec2();
                    if leaf.mirrored {
                        inside.x = 1.0 - inside.x;
                    }
                    if inside.min_element() < 0.0 || inside.max_element() > 1.0 {
                        continue;
                    }
                    let uv =
                        picture.versions[usize::from(leaf.version)] + inside * picture.version_size;
                    let there = picture.texture.alpha(sampler, uv, 0.0) >= 0.5;
                    mask |= u64::from(there) << probe;
                }
                if mask != 0 {
                    shown[(y * width + x) as usize].push((number, mask));
                }
            }
        }
    }
    let mut layers = vec![vec![LeafPlace::NONE; shown.len()]; layer_count];
    for (at, candidates) in shown.iter().enumerate() {
        if at % TEXELS_PER_CHECK == 0 {
            job.check()?;
        }
        let mut named: Vec<usize> = Vec::new();
        let mut covered = 0_u64;
        while named.len() < layer_count {
            let gain = |(_, mask): &(usize, u64)| (mask & !covered).count_ones();
            // of equals the nearest, which comes first
            let best = candidates.iter().rev().max_by_key(|candidate| gain(candidate));
            let Some(&(number, mask)) = best.filter(|candidate| gain(candidate) > 0) else { break };
            covered |= mask;
            named.push(number);
        }
        named.sort_unstable();
        for (layer, number) in layers.iter_mut().zip(named) {
            layer[at] = places[number];
        }
    }
    Ok(layers)
}
