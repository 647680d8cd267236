//! Slicings: parallel slices through the crown, baked for several directions and blended.
//!
//! Leaves go to the nearest of a slicing's equidistant planes; leaves longer than the planes' spacing
//! are cut at the middle between planes, sample by sample, so that the slices together hold every
//! leaf exactly once. A view paints the slicings that it lies between, interleaved from the farthest
//! slice to the nearest, with opacities that follow the angle. Wood stays a mesh.
//!
//! This work is based on:
//! Aleks Jakulin. Interactive Vegetation Rendering with Slicing and Blending. 2000
//!
//! Deviations: the centre is that of the box of leaf centres; the outermost slabs reach to infinity;
//! angles are measured along the circle; two more opacity corrections can be chosen.

mod opacity;
mod slabs;
#[cfg(test)]
mod tests;

use std::sync::{Arc, Mutex, PoisonError};

use glam::{DAffine3, DVec3, Vec2, Vec3, Vec4};
use rayon::prelude::*;

use crate::bake::{BakeRect, bake, finish};
use crate::draw_list::{Blend, Buffers, Geometry, Item, Primitive, Surface};
use crate::error::{LodError, check_in, check_limit};
use crate::job::Job;
use crate::lod::leaves::Leaves;
use crate::lod::solid::Solid;
use crate::lod::view_blend::ViewBlend;
use crate::lod::wood::Wood;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture, Representation, foot_of};
use crate::plant::{Mesh, Plant};
use crate::raster::{Renderer, samples};
use crate::texture::mips::Keep;
use crate::texture::texture::check_size;
use crate::texture::{Filter, Format, Sampler, Texture, Wrap};
use crate::view::View;
use crate::view_state::ViewState;
use opacity::{Opacity, SilhouetteAlpha};
use slabs::Layout;

/// An eye nearer to the centre than this share of the radius sees along its own direction.
const INSIDE: f64 = 1e-3;

/// Texels of all slices together: 2 GiB of RGBA8 without mips.
const MAX_TOTAL_TEXELS: u64 = 1 << 29;

/// Texels of slices that are drawn side by side: half a gigabyte of planes and their copies.
const MAX_TEXELS_AT_ONCE: u64 = 1 << 24;

/// More slicings or slices than this are taken for a mistake.
const MAX_COUNT: usize = 4096;

/// How blended slices are made as opaque as single ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Correction {
    /// Opacities times `1 + m (1 - largest share)`, at most 1. Jakulin starts from m = 0.5.
    Linear(f64),
    /// As `Linear`, with the m that gives the crown its on-axis mean alpha from all around.
    Fit,
    /// `(1 - exp(-share tau)) / (1 - exp(-tau))`: keeps the mean opacity of random leaves.
    Optical,
}

/// What becomes of leaves longer than the planes' spacing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LargeLeaves {
    /// Cut between the planes.
    Split,
    /// Drawn as they are, beside the wood.
    Mesh,
}

/// How slicings are built.
#[derive(Debug, Clone)]
pub struct Params {
    /// One slicing each.
    pub blend: ViewBlend,
    /// Slices a slicing.
    pub slice_count: usize,
    /// Texels a slice, width and height.
    pub resolution: (u32, u32),
    /// Samples a texel.
    pub sample_count: u32,
    /// Opacity correction.
    pub correction: Correction,
    /// Leaves longer than the spacing.
    pub large_leaves: LargeLeaves,
    /// Texel format.
    pub format: Format,
    /// The wood that stays a mesh.
    pub wood: Wood,
    /// The cameras that will look, in the plant's own world; `None` bakes for all.
    pub views: Option<Vec<View>>,
}

/// One slice: a card with a texture, or nothing where no leaf is.
#[derive(Debug, Clone)]
struct Slice {
    /// Of its plane from the centre, along the slicing's direction.
    offset: f64,
    baked: Option<Baked>,
}

#[derive(Debug, Clone)]
struct Baked {
    rect: BakeRect,
    texture: Arc<Texture>,
    /// Index of its card in the shared geometry.
    card: u32,
}

/// The technique's representation of a plant.
#[derive(Debug)]
pub struct Slicings {
    blend: ViewBlend,
    /// Slices in order of rising offset; `None` where no view needs them.
    slicings: Vec<Option<Vec<Slice>>>,
    cards: Arc<Geometry>,
    solid: Solid,
    opacity: Opacity,
    center: DVec3,
    radius: f64,
    bounds: (DVec3, DVec3),
    foot: DVec3,
    origin: DVec3,
}

/// What was measured while building, for the report.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// The multiplier in use; `None` with the optical correction.
    pub m: Option<f64>,
    /// Whether `correction="fit"` found a root, or took the nearer end of its interval.
    pub fitted: Option<bool>,
    /// Optical depth of a slice: minus the logarithm of 1 - the mean slice alpha.
    pub tau: f64,
    /// Leaves cut between slices, or left in the mesh, summed over slicings.
    pub large_leaf_count: usize,
}

/// Slices drawn side by side: one a thread, unless their texels would take much memory.
fn at_once((width, height): (u32, u32)) -> usize {
    let fitting = MAX_TEXELS_AT_ONCE / (u64::from(width) * u64::from(height));
    usize::try_from(fitting).unwrap_or(usize::MAX).clamp(1, rayon::current_num_threads())
}

/// Appends a slice's card, which is white: its texture is lit.
fn push_card(buffers: &mut Buffers, rect: &BakeRect) -> u32 {
    let first = u32::try_from(buffers.positions.len()).expect("few cards");
    let uvs = [Vec2::new(0.0, 1.0), Vec2::ONE, Vec2::new(1.0, 0.0), Vec2::ZERO];
    for (corner, uv) in rect.corners().into_iter().zip(uvs) {
        buffers.positions.push(corner.as_vec3());
        buffers.normals.push(rect.toward().as_vec3());
        buffers.uvs.push(uv);
        buffers.base.push(Vec4::ONE);
        buffers.front.push(Vec3::ONE);
        buffers.back.push(Vec3::ONE);
    }
    buffers.indices.extend(first..first + 4);
    first / 4
}

impl Slicings {
    /// Bakes the slices of a plant.
    ///
    /// # Errors
    /// `foliage` without leaves; `slice_count`, `resolution`, `samples`, `correction` or `views` out
    /// of range; [`LodError::Cancelled`].
    pub fn build(plant: &Plant, params: &Params, job: &Job) -> Result<(Self, Measured), LodError> {
        check_in("slice_count", params.slice_count, 1..=MAX_COUNT)?;
        check_in("slicing_count", params.blend.directions().len(), 1..=MAX_COUNT)?;
        check_size("resolution", params.resolution.0, params.resolution.1)?;
        if let Correction::Linear(m) = params.correction {
            check_in("correction", m, 0.0..=1e6)?;
        }
        samples::positions(params.sample_count)?;
        let leaves = Leaves::new(plant)?;
        let layouts: Vec<Layout> = params
            .blend
            .directions()
            .iter()
            .map(|&toward| {
                Layout::new(toward, &leaves.leaf_centers, params.slice_count, leaves.radius)
            })
            .collect();
        let resolutions = needed_resolutions(&leaves, &layouts, params, job)?;
        if params.correction == Correction::Fit && resolutions.contains(&None) {
            let why = "'fit' needs all slicings, and these views leave some out".to_owned();
            return Err(LodError::Invalid { name: "correction", why });
        }
        let baked = || layouts.iter().zip(&resolutions).filter_map(|(l, r)| Some((l, (*r)?)));
        let texels = |(layout, (width, height)): (&Layout, (u32, u32))| {
            layout.count as u64 * u64::from(width) * u64::from(height)
        };
        check_limit("resolution", baked().map(texels).sum(), MAX_TOTAL_TEXELS, "texels")?;
        job.begin(baked().map(|(layout, _)| layout.count as u64).sum());
        let (in_mesh, large_leaf_count) = large_leaves(&leaves, &layouts, params, job)?;
        let wood = params.wood.of(plant)?;
        let renderers: Mutex<Vec<Renderer>> = Mutex::default();
        let mut slicings = Vec::new();
        let mut cards = Buffers::default();
        let mut alpha = SilhouetteAlpha::default();
        for (layout, resolution) in layouts.iter().zip(&resolutions) {
            let Some(resolution) = *resolution else {
                slicings.push(None);
                continue;
            };
            job.check()?;
            let assignment = layout.assign(&leaves, &in_mesh);
            let view = assignment.rect.view(resolution)?;
            let draw = |slice: usize| {
                let list = leaves.list(&view, &assignment.leaves[slice], assignment.slab(slice));
                let idle = || renderers.lock().unwrap_or_else(PoisonError::into_inner);
                let mut renderer = idle().pop().unwrap_or_default();
                let image = bake(&mut renderer, &list, &view, params.sample_count, job)?;
                idle().push(renderer);
                let is_empty = image.texels.iter().all(|texel| texel.w == 0.0);
                let texture = if is_empty {
                    None
                } else {
                    Some(finish(&image, Keep::MeanAlpha, params.format, job)?)
                };
                job.advance();
                Ok((image, texture))
            };
            let mut slices = Vec::new();
            while slices.len() < layout.count {
                let next = slices.len()..layout.count.min(slices.len() + at_once(resolution));
                let drawn: Result<Vec<_>, LodError> = next.into_par_iter().map(draw).collect();
                for (image, texture) in drawn? {
                    alpha.add(&image);
                    let slice = slices.len();
                    let rect = assignment.card(slice);
                    let baked = texture.map(|texture| Baked {
                        rect,
                        texture,
                        card: push_card(&mut cards, &rect),
                    });
                    slices.push(Slice { offset: layout.offset(slice), baked });
                }
            }
            alpha.next_slicing();
            slicings.push(Some(slices));
        }
        let tau = alpha.tau();
        let (large, large_ids) = leaves_mesh(&leaves, &in_mesh);
        let meshes = [(&wood, Buffers::ids_from(0, &wood)), (&large, large_ids)];
        let boxes = || [&plant.foliage.mesh, &wood].into_iter().filter_map(Mesh::bounds);
        let foot = foot_of(boxes());
        let corners = boxes()
            .flat_map(|(low, high)| [low, high])
            .chain(cards.positions.iter().copied())
            .map(|p| p.as_dvec3());
        let bounds = corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), corner| {
            (low.min(corner), high.max(corner))
        });
        let mut built = Self {
            blend: params.blend.clone(),
            slicings,
            cards: Geometry::new(cards),
            solid: Solid::new(&meshes, &plant.materials, Filter::Bilinear, job)?,
            opacity: Opacity::Optical { tau },
            center: leaves.center,
            radius: leaves.radius,
            bounds,
            foot,
            origin: plant.origin,
        };
        let fitted = built.correct(params.correction, tau, job)?;
        let m = match built.opacity {
            Opacity::Linear { m } => Some(m),
            Opacity::Optical { .. } => None,
        };
        Ok((built, Measured { m, fitted, tau, large_leaf_count }))
    }

    /// Which slicings have been baked.
    pub fn baked(&self) -> Vec<bool> {
        self.slicings.iter().map(Option::is_some).collect()
    }

    /// Slicing, slice, and what was baked for it.
    fn baked_slices(&self) -> impl Iterator<Item = (usize, usize, &Baked)> {
        self.slicings.iter().enumerate().flat_map(|(number, slices)| {
            let slices = slices.iter().flatten().enumerate();
            slices.filter_map(move |(index, slice)| Some((number, index, slice.baked.as_ref()?)))
        })
    }

    fn emit_slices(
        &self,
        view: &View,
        crown: &Crown,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        let viewer = Viewer::new(view, crown, self.center, self.radius);
        let shares = viewer.shares(&self.blend);
        let opacities = self.opacity.of(&shares);
        let source = builder.list.geometry(&self.cards);
        // (depth rank in [0, 1], place among the shares, item)
        let mut items: Vec<(f64, usize, Item)> = Vec::new();
        for (place, (&(number, _), opacity)) in shares.iter().zip(opacities).enumerate() {
            let Some(slices) = &self.slicings[number] else {
                let why = format!(
                    "this camera needs slicing {number}, which was not baked; build with it in views"
                );
                return Err(LodError::Invalid { name: "camera", why });
            };
            let mut instance = crown.instance(view);
            #[expect(clippy::cast_possible_truncation, reason = "an opacity")]
            let stored = opacity as f32;
            instance.tint.w = stored;
            let instances = builder.list.instance(instance);
            let distance =
                |slice: &Slice| viewer.distance(self.blend.directions()[number], slice.offset);
            let mut far_to_near: Vec<&Slice> = slices.iter().collect();
            far_to_near.sort_by(|a, b| distance(b).total_cmp(&distance(a)));
            for (index, slice) in far_to_near.into_iter().enumerate() {
                let Some(baked) = &slice.baked else { continue };
                let sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: Filter::Trilinear };
                let texture = builder.list.texture(&baked.texture);
                let rank = (index as f64 + 0.5) / slices.len() as f64;
                let item = Item {
                    primitive: Primitive::Cards,
                    vertices: source,
                    indices: source,
                    primitives: baked.card..baked.card + 1,
                    instances: instances.clone(),
                    surface: Surface::Textured { texture, sampler },
                    blend: Blend::Over,
                    depth_write: false,
                    slab: None,
                };
                items.push((rank, place, item));
            }
        }
        // the farthest of every slicing, then the second farthest, ...: small shares first
        items.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for (_, _, item) in items {
            builder.push_blended(crown, item);
        }
        Ok(())
    }
}

/// A camera as a crown sees it, in the crown's coordinates.
struct Viewer {
    /// Relative to the crown's centre; `None` for parallel views.
    eye: Option<DVec3>,
    /// From the crown to the viewer, any length.
    toward: DVec3,
    /// The picture's up.
    up: DVec3,
}

impl Viewer {
    fn new(view: &View, crown: &Crown, center: DVec3, radius: f64) -> Self {
        let back = crown.local_direction(view.back);
        let eye = (!view.is_orthographic()).then(|| crown.local_eye(view) - center);
        // equal where both are 0
        let outside = eye.filter(|eye| eye.length() > INSIDE * radius);
        let up = crown.local_direction(view.up);
        Self { eye, toward: outside.unwrap_or(back), up }
    }

    fn shares(&self, blend: &ViewBlend) -> Vec<(usize, f64)> {
        blend.shares(self.toward, self.up)
    }

    /// How far behind others of its slicing a slice is seen. No ray from an eye meets slices on both
    /// sides of it, so the distance from the slice's plane orders those in front as well as those
    /// behind; a parallel view sees all from the same side.
    fn distance(&self, direction: DVec3, offset: f64) -> f64 {
        match self.eye {
            Some(eye) => (eye.dot(direction) - offset).abs(),
            None if self.toward.dot(direction) < 0.0 => offset,
            None => -offset,
        }
    }
}

/// Which leaves stay in the mesh, and how many are longer than a spacing, summed over slicings. A leaf
/// that is too long for one slicing stays there for all, or views between two would draw it twice.
fn large_leaves(
    leaves: &Leaves<'_>,
    layouts: &[Layout],
    params: &Params,
    job: &Job,
) -> Result<(Vec<bool>, usize), LodError> {
    let mut large_in = vec![0_usize; leaves.leaf_centers.len()];
    for layout in layouts {
        job.check()?;
        large_in
            .par_iter_mut()
            .enumerate()
            .for_each(|(leaf, count)| *count += usize::from(layout.is_large(leaves, leaf)));
    }
    let to_mesh = params.large_leaves == LargeLeaves::Mesh;
    let in_mesh = large_in.iter().map(|&count| to_mesh && count > 0).collect();
    Ok((in_mesh, large_in.iter().sum()))
}

/// The leaves that stay in the mesh, with the plant's own ids of their triangles.
fn leaves_mesh(leaves: &Leaves<'_>, in_mesh: &[bool]) -> (Mesh, Vec<u32>) {
    let foliage = &leaves.plant.foliage;
    if !in_mesh.contains(&true) {
        return (Mesh::default(), Vec::new());
    }
    let kept: Vec<usize> = (0..in_mesh.len())
        .filter(|&leaf| in_mesh[leaf])
        .flat_map(|leaf| foliage.triangles_of(leaf))
        .collect();
    let material_ids: Vec<u32> = kept.iter().map(|&t| leaves.materials[t]).collect();
    let first = leaves.plant.wood.triangles.len();
    let id = |&t: &usize| u32::try_from(first + t).expect("checked by the plant");
    let mesh = Mesh {
        triangles: kept.iter().map(|&t| foliage.mesh.triangles[t]).collect(),
        parts: Mesh::parts_from_ids(&material_ids),
        ..foliage.mesh.clone()
    };
    (mesh.without_unused_vertices(), kept.iter().map(id).collect())
}

/// Texels of each slicing: those of the nearest view that shows it, `None` if no view does.
fn needed_resolutions(
    leaves: &Leaves<'_>,
    layouts: &[Layout],
    params: &Params,
    job: &Job,
) -> Result<Vec<Option<(u32, u32)>>, LodError> {
    let Some(views) = &params.views else {
        return Ok(vec![Some(params.resolution); layouts.len()]);
    };
    if views.is_empty() {
        let why = "give at least one camera, or None for all directions";
        return Err(LodError::Empty { name: "views", why });
    }
    // placed as a scene places a single copy, so that both come to the same shares
    let world_from_local = DAffine3::from_translation(leaves.plant.origin);
    let crown = Crown::alone(world_from_local);
    let mut needed: Vec<Option<f64>> = vec![None; layouts.len()];
    for view in views {
        let viewer = Viewer::new(view, &crown, leaves.center, leaves.radius);
        let from_eye = viewer.eye.map_or(0.0, DVec3::length);
        let nearest = (from_eye - leaves.radius).max(view.near);
        let per_metre = 1.0 / view.pixel_size_at(nearest);
        for (number, _) in viewer.shares(&params.blend) {
            let most = needed[number].get_or_insert(0.0);
            *most = most.max(per_metre);
        }
    }
    let texels = |per_metre: f64, metres: f64, limit: u32| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let texels = (per_metre * metres).ceil().clamp(1.0, f64::from(limit)) as u32;
        texels
    };
    layouts
        .iter()
        .zip(needed)
        .map(|(layout, per_metre)| {
            job.check()?;
            let Some(per_metre) = per_metre else { return Ok(None) };
            let rect = layout.rect(leaves);
            Ok(Some((
                texels(per_metre, rect.width, params.resolution.0),
                texels(per_metre, rect.height, params.resolution.1),
            )))
        })
        .collect()
}

impl Representation for Slicings {
    fn bounds(&self) -> (DVec3, DVec3) {
        self.bounds
    }

    fn foot(&self) -> DVec3 {
        self.foot
    }

    fn origin(&self) -> DVec3 {
        self.origin
    }

    fn footprint(&self) -> Footprint {
        let solid = self.solid.footprint();
        let baked = || self.baked_slices().map(|(_, _, baked)| baked);
        Footprint {
            card_count: baked().count() as u64,
            geometry_bytes: solid.geometry_bytes + self.cards.buffers().byte_count(),
            texture_bytes: solid.texture_bytes
                + baked().map(|baked| baked.texture.byte_count()).sum::<u64>(),
            ..solid
        }
    }

    fn textures(&self) -> Vec<NamedTexture> {
        let named = |(number, index, baked): (usize, usize, &Baked)| NamedTexture {
            name: format!("slicing {number}, slice {index}"),
            texture: Arc::clone(&baked.texture),
            rect: Some(baked.rect),
        };
        self.baked_slices().map(named).chain(self.solid.textures()).collect()
    }

    fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        self.solid.emit(view, crowns, state, builder);
        for crown in crowns {
            self.emit_slices(view, crown, builder)?;
        }
        Ok(())
    }
}
