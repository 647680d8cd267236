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

use std::sync::Arc;

use glam::{DAffine3, DVec2, DVec3, Vec2, Vec3, Vec4};
use rayon::prelude::*;

use crate::bake::{BakeRect, Format, bake, finish};
use crate::draw_list::{
    Blend, Buffers, DrawList, Geometry, Instance, Item, Primitive, Source, Surface,
};
use crate::error::{LodError, check_in};
use crate::job::Job;
use crate::lod::solid::{Solid, blend_of};
use crate::lod::view_blend::{ViewBlend, circle};
use crate::lod::wood::Wood;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture, Representation};
use crate::plant::{Mesh, Plant};
use crate::raster::{Outputs, Renderer, Settings};
use crate::texture::mips::Keep;
use crate::texture::texture::check_size;
use crate::texture::{Filter, LinearImage, Sampler, Texture, Wrap};
use crate::view::{Projection, View};
use crate::view_state::ViewState;

/// A crown thinner than this share of its radius along a direction is one slice.
const FLAT: f64 = 1e-6;

/// An eye nearer to the centre than this share of the radius sees along its own direction.
const INSIDE: f64 = 1e-3;

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
    rect: BakeRect,
    texture: Option<Arc<Texture>>,
}

/// A slicing: its slices from the farthest to the nearest along its direction.
#[derive(Debug, Clone)]
struct Slicing {
    slices: Vec<Slice>,
    /// Index of its first card in the shared geometry.
    first_card: u32,
}

/// The technique's representation of a plant.
#[derive(Debug)]
pub struct Slicings {
    blend: ViewBlend,
    /// `None` where no view needs it.
    slicings: Vec<Option<Slicing>>,
    cards: Arc<Geometry>,
    solid: Solid,
    opacity: Opacity,
    center: DVec3,
    radius: f64,
    bounds: (DVec3, DVec3),
    origin: DVec3,
}

/// A correction with its numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Opacity {
    Linear { m: f64 },
    Optical { tau: f64 },
}

/// What was measured while building, for the report.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// The multiplier in use; `None` with the optical correction.
    pub m: Option<f64>,
    /// Whether `correction="fit"` found a root, or took the nearer end of its interval.
    pub fitted: Option<bool>,
    /// Optical depth of a slicing: minus the logarithm of 1 - the mean slice alpha.
    pub tau: f64,
    /// Leaves cut between slices, or left in the mesh, summed over slicings.
    pub large_leaf_count: usize,
}

impl Opacity {
    /// Opacities of the shares, in the same order.
    fn of(self, shares: &[(usize, f64)]) -> Vec<f64> {
        let largest = shares.iter().map(|&(_, share)| share).fold(0.0, f64::max);
        shares
            .iter()
            .map(|&(_, share)| match self {
                Self::Linear { m } => (share * (1.0 + m * (1.0 - largest))).min(1.0),
                Self::Optical { tau } if tau > 0.0 => libm::expm1(-share * tau) / libm::expm1(-tau),
                Self::Optical { .. } => share,
            })
            .collect()
    }
}

/// A direction's axes and its slabs.
#[derive(Debug, Clone, Copy)]
struct Layout {
    right: DVec3,
    up: DVec3,
    toward: DVec3,
    spacing: f64,
    count: usize,
}

impl Layout {
    fn new(toward: DVec3, centers: &[DVec3], slice_count: usize, radius: f64) -> Self {
        // world up, or -z for a direction that is up itself
        let up_hint = if toward.y.abs() > 1.0 - 1e-9 { DVec3::NEG_Z } else { DVec3::Y };
        let right = up_hint.cross(toward).normalize();
        let up = toward.cross(right);
        let depth = 2.0 * centers.iter().map(|p| toward.dot(*p).abs()).fold(0.0, f64::max);
        let flat = depth < FLAT * radius;
        let count = if flat { 1 } else { slice_count };
        let spacing = if flat { 0.0 } else { depth / count as f64 };
        Self { right, up, toward, spacing, count }
    }

    /// Offset of a slice's plane from the centre.
    fn offset(&self, slice: usize) -> f64 {
        (slice as f64 - (self.count as f64 - 1.0) / 2.0) * self.spacing
    }

    /// The slice nearest to an offset; between two, the lower.
    fn nearest(&self, offset: f64) -> usize {
        if self.spacing == 0.0 {
            return 0;
        }
        let at = (offset / self.spacing + self.count as f64 / 2.0).ceil() - 1.0;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let slice = at.clamp(0.0, self.count as f64 - 1.0) as usize;
        slice
    }

    /// Offsets between which a slice owns cut leaves; the outermost reach to infinity.
    fn slab(&self, slice: usize) -> (f64, f64) {
        let low =
            if slice == 0 { f64::NEG_INFINITY } else { self.offset(slice) - self.spacing / 2.0 };
        let high = if slice + 1 == self.count {
            f64::INFINITY
        } else {
            // the same number as the next slab's lower end
            self.offset(slice + 1) - self.spacing / 2.0
        };
        (low, high)
    }
}

/// The foliage as the baker sees it, with positions relative to the crown's centre in f64.
struct Crowned<'a> {
    plant: &'a Plant,
    geometry: Arc<Geometry>,
    center: DVec3,
    /// Largest distance of a leaf's vertex from the centre.
    radius: f64,
    /// Leaf centres relative to `center`.
    leaf_centers: Vec<DVec3>,
    /// Material of each triangle.
    materials: Vec<u32>,
}

/// Where a slicing's leaves go.
struct Assignment {
    layout: Layout,
    /// The shared rectangle, through the crown's centre.
    rect: BakeRect,
    /// By slice: leaves drawn whole, and leaves cut by the slab.
    leaves: Vec<(Vec<usize>, Vec<usize>)>,
}

impl<'a> Crowned<'a> {
    fn new(plant: &'a Plant) -> Result<Self, LodError> {
        let foliage = &plant.foliage;
        let Some(&first) = foliage.centers.first() else {
            let why = "slicings need leaves; choose them with foliage=";
            return Err(LodError::Empty { name: "foliage", why });
        };
        let spread = |(low, high): (Vec3, Vec3), &p: &Vec3| (low.min(p), high.max(p));
        let (low, high) = foliage.centers.iter().fold((first, first), spread);
        let center = (low.as_dvec3() + high.as_dvec3()) * 0.5;
        let mut crowned = Self {
            plant,
            geometry: Geometry::new(Buffers::from_mesh(&foliage.mesh, 0)),
            center,
            radius: 0.0,
            leaf_centers: foliage.centers.iter().map(|p| p.as_dvec3() - center).collect(),
            materials: foliage.mesh.triangle_materials().collect(),
        };
        let leaves = 0..crowned.leaf_centers.len();
        let distances = leaves.flat_map(|leaf| crowned.vertices_of(leaf)).map(DVec3::length);
        crowned.radius = distances.fold(0.0, f64::max);
        Ok(crowned)
    }

    fn vertices_of(&self, leaf: usize) -> impl Iterator<Item = DVec3> {
        let mesh = &self.plant.foliage.mesh;
        let triangles = self.plant.foliage.triangles_of(leaf);
        triangles.flat_map(move |t| mesh.corners(t)).map(|p| p.as_dvec3() - self.center)
    }

    /// Smallest and largest offset of a leaf's vertices along a direction.
    fn extent(&self, leaf: usize, direction: DVec3) -> (f64, f64) {
        let offsets = self.vertices_of(leaf).map(|p| p.dot(direction));
        offsets
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)))
    }

    /// Whether a leaf is longer than the spacing along a layout's direction.
    fn is_large(&self, leaf: usize, layout: &Layout) -> bool {
        let (low, high) = self.extent(leaf, layout.toward);
        layout.count > 1 && high - low > layout.spacing
    }

    /// The rectangle through the centre that encloses every leaf as seen along a layout's direction.
    fn rect(&self, layout: &Layout) -> BakeRect {
        let half = (0..self.leaf_centers.len())
            .into_par_iter()
            .map(|leaf| {
                self.vertices_of(leaf).fold(DVec2::ZERO, |half, p| {
                    half.max(DVec2::new(p.dot(layout.right).abs(), p.dot(layout.up).abs()))
                })
            })
            .reduce(|| DVec2::ZERO, DVec2::max);
        // a crown that is a line or a point from here still needs a rectangle
        let least = if self.radius > 0.0 { self.radius * FLAT } else { FLAT };
        BakeRect {
            center: self.center,
            right: layout.right,
            up: layout.up,
            width: 2.0 * half.x.max(least),
            height: 2.0 * half.y.max(least),
            reach: 2.0 * self.radius.max(least),
        }
    }

    /// Sorts the leaves of a slicing into its slices; `in_mesh` leaves go to none.
    fn assign(&self, layout: Layout, in_mesh: &[bool]) -> Assignment {
        let mut leaves = vec![(Vec::new(), Vec::new()); layout.count];
        let placed: Vec<(bool, usize, usize)> = (0..self.leaf_centers.len())
            .into_par_iter()
            .map(|leaf| {
                if self.is_large(leaf, &layout) {
                    let (low, high) = self.extent(leaf, layout.toward);
                    // a little wider than it is, since slabs are cut at f32 depths
                    let margin = layout.spacing * 1e-3;
                    (true, layout.nearest(low - margin), layout.nearest(high + margin))
                } else {
                    let slice = layout.nearest(self.leaf_centers[leaf].dot(layout.toward));
                    (false, slice, slice)
                }
            })
            .collect();
        for (leaf, (large, first, last)) in placed.into_iter().enumerate() {
            if in_mesh[leaf] {
                continue;
            }
            for (whole, cut) in &mut leaves[first..=last] {
                if large { cut.push(leaf) } else { whole.push(leaf) }
            }
        }
        Assignment { layout, rect: self.rect(&layout), leaves }
    }

    /// The list that draws a slice's leaves for its bake.
    fn list(&self, view: &View, assignment: &Assignment, slice: usize) -> DrawList {
        let mut list = DrawList::default();
        let source = list.geometry(&self.geometry);
        let instances = list.instance(Instance::new(&DAffine3::IDENTITY, view));
        let (whole, cut) = &assignment.leaves[slice];
        let slab = assignment.slab(slice);
        for (leaves, slab) in [(whole, None), (cut, Some(slab))] {
            let mut triangles: Vec<usize> =
                leaves.iter().flat_map(|&leaf| self.plant.foliage.triangles_of(leaf)).collect();
            // blended leaves after the others and far to near, the rest as they come
            let key = |t: usize| -> (bool, f64) {
                let material = &self.plant.materials[self.materials[t] as usize];
                let corners = self.plant.foliage.mesh.corners(t);
                let height = corners.iter().map(|p| p.as_dvec3().dot(view.back)).sum();
                let blended = blend_of(material) == Blend::Over;
                (blended, if blended { height } else { 0.0 })
            };
            triangles.sort_by(|&a, &b| {
                let (a, b) = (key(a), key(b));
                a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
            });
            for run in triangles.chunk_by(|&a, &b| self.materials[a] == self.materials[b]) {
                let material = &self.plant.materials[self.materials[run[0]] as usize];
                let blend = blend_of(material);
                let own = &mut list.own.buffers.indices;
                let start = u32::try_from(own.len() / 3).expect("fits in u32");
                let corners = &self.geometry.buffers().indices;
                own.extend(run.iter().flat_map(|&t| &corners[t * 3..t * 3 + 3]));
                let end = u32::try_from(own.len() / 3).expect("fits in u32");
                let surface = material.texture.as_ref().map_or(Surface::VertexColor, |texture| {
                    Surface::Textured { texture: list.texture(texture), sampler: material.sampler }
                });
                list.items.push(Item {
                    primitive: Primitive::Triangles,
                    vertices: source,
                    indices: Source::Own,
                    primitives: start..end,
                    instances: instances.clone(),
                    surface,
                    blend,
                    depth_write: blend != Blend::Over,
                    slab,
                });
            }
        }
        list.items.sort_by_key(|item| item.blend == Blend::Over);
        list
    }
}

impl Assignment {
    /// Depths, as the shared view measures them, between which a slice owns cut leaves. Neighbours
    /// share the very same number, so each sample belongs to exactly one.
    fn slab(&self, slice: usize) -> [f32; 2] {
        let (low, high) = self.layout.slab(slice);
        #[expect(clippy::cast_possible_truncation, reason = "depths are compared in f32")]
        let depths = [self.rect.depth_of(high) as f32, self.rect.depth_of(low) as f32];
        [depths[0].max(0.0), depths[1]]
    }

    /// Where a slice's card lies.
    fn card(&self, slice: usize) -> BakeRect {
        let offset = self.layout.toward * self.layout.offset(slice);
        BakeRect { center: self.rect.center + offset, ..self.rect }
    }
}

/// Alpha of a slicing's texels inside its silhouette, summed over slices, and how many there are.
fn silhouette_alpha(images: &[LinearImage]) -> (f64, f64) {
    let Some(first) = images.first() else { return (0.0, 0.0) };
    let mut sum = (0.0, 0.0);
    for texel in 0..first.texels.len() {
        let alphas = images.iter().map(|image| f64::from(image.texels[texel].w));
        let total: f64 = alphas.sum();
        if total > 0.0 {
            sum.0 += total;
            sum.1 += images.len() as f64;
        }
    }
    sum
}

/// Cards of all slicings in one geometry: lit by their textures, so white.
struct Cards {
    buffers: Buffers,
}

impl Cards {
    fn push(&mut self, rect: &BakeRect) {
        let buffers = &mut self.buffers;
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
    }
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
        let wood = params.wood.of(plant)?;
        let crowned = Crowned::new(plant)?;
        let directions = params.blend.directions();
        let layouts: Vec<Layout> = directions
            .iter()
            .map(|&toward| {
                Layout::new(toward, &crowned.leaf_centers, params.slice_count, crowned.radius)
            })
            .collect();
        let leaf_count = plant.foliage.leaf_count();
        let large_in: Vec<usize> = (0..leaf_count)
            .into_par_iter()
            .map(|leaf| layouts.iter().filter(|layout| crowned.is_large(leaf, layout)).count())
            .collect();
        let in_mesh: Vec<bool> = large_in
            .iter()
            .map(|&count| params.large_leaves == LargeLeaves::Mesh && count > 0)
            .collect();
        let resolutions = needed_resolutions(&crowned, params)?;
        job.begin(resolutions.iter().flatten().count() as u64 * params.slice_count as u64);
        let mut renderer = Renderer::default();
        let mut slicings = Vec::new();
        let mut cards = Cards { buffers: Buffers::default() };
        let mut alpha = (0.0, 0.0);
        for (layout, resolution) in layouts.iter().zip(&resolutions) {
            let Some(resolution) = *resolution else {
                slicings.push(None);
                continue;
            };
            let assignment = crowned.assign(*layout, &in_mesh);
            let view = assignment.rect.view(resolution)?;
            let mut images = Vec::new();
            let mut slices = Vec::new();
            let first_card = u32::try_from(cards.buffers.indices.len() / 4).expect("few cards");
            for slice in 0..layout.count {
                let list = crowned.list(&view, &assignment, slice);
                let image = bake(&mut renderer, &list, &view, params.sample_count, job)?;
                let rect = assignment.card(slice);
                cards.push(&rect);
                let empty = image.texels.iter().all(|texel| texel.w == 0.0);
                let texture = if empty {
                    None
                } else {
                    Some(finish(&image, Keep::MeanAlpha, params.format)?)
                };
                slices.push(Slice { rect, texture });
                images.push(image);
                job.advance();
            }
            let (sum, count) = silhouette_alpha(&images);
            alpha = (alpha.0 + sum, alpha.1 + count);
            slicings.push(Some(Slicing { slices, first_card }));
        }
        let mean = if alpha.1 > 0.0 { alpha.0 / alpha.1 } else { 0.0 };
        let tau = -libm::log1p(-mean.min(1.0 - 1e-9));
        let large = leaves_mesh(plant, &in_mesh);
        let wood_count = u32::try_from(plant.wood.triangles.len()).expect("checked by the plant");
        let meshes = [(&wood, 0), (&large, wood_count)];
        let mut bounds = box_of_cards(&cards.buffers);
        for mesh in [&wood, &large] {
            if let Some((low, high)) = mesh.bounds() {
                bounds = (bounds.0.min(low.as_dvec3()), bounds.1.max(high.as_dvec3()));
            }
        }
        let mut built = Self {
            blend: params.blend.clone(),
            slicings,
            cards: Geometry::new(cards.buffers),
            solid: Solid::new(&meshes, &plant.materials, Filter::Bilinear),
            opacity: Opacity::Optical { tau },
            center: crowned.center,
            radius: crowned.radius,
            bounds,
            origin: plant.origin,
        };
        let mut fitted = None;
        match params.correction {
            Correction::Linear(m) => built.opacity = Opacity::Linear { m },
            Correction::Optical => {}
            Correction::Fit => fitted = Some(built.fit(tau, job)?),
        }
        let m = match built.opacity {
            Opacity::Linear { m } => Some(m),
            Opacity::Optical { .. } => None,
        };
        let large_leaf_count = large_in.iter().sum();
        Ok((built, Measured { m, fitted, tau, large_leaf_count }))
    }

    /// Which slicings have been baked.
    pub fn baked(&self) -> Vec<bool> {
        self.slicings.iter().map(Option::is_some).collect()
    }

    /// Shares and opacities for one copy: ascending share, the last is primary.
    fn shares(&self, view: &View, crown: &Crown) -> Vec<(usize, f64)> {
        let from_center = crown.local_eye(view) - self.center;
        let inside = from_center.length() < INSIDE * self.radius;
        let toward = if view.is_orthographic() || inside {
            crown.local_direction(view.back)
        } else {
            from_center
        };
        self.blend.shares(toward, crown.local_direction(view.up))
    }

    fn emit_slices(
        &self,
        view: &View,
        crown: &Crown,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        let shares = self.shares(view, crown);
        let opacities = self.opacity.of(&shares);
        let source = builder.list.geometry(&self.cards);
        // (depth rank in [0, 1], place among the shares, item)
        let mut items: Vec<(f64, usize, Item)> = Vec::new();
        for (place, (&(number, _), opacity)) in shares.iter().zip(opacities).enumerate() {
            let Some(slicing) = &self.slicings[number] else {
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
            for (index, slice) in slicing.slices.iter().enumerate() {
                let Some(texture) = &slice.texture else { continue };
                let card = slicing.first_card + u32::try_from(index).expect("few slices");
                let sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: Filter::Trilinear };
                let texture = builder.list.texture(texture);
                let rank = (index as f64 + 0.5) / slicing.slices.len() as f64;
                let item = Item {
                    primitive: Primitive::Cards,
                    vertices: source,
                    indices: source,
                    primitives: card..card + 1,
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

    /// Mean alpha of the slices in a parallel view that frames the crown.
    fn mean_alpha(&self, toward: DVec3, job: &Job) -> Result<f64, LodError> {
        let projection = Projection::Orthographic { height: 2.0 * self.radius };
        let up = if toward.y.abs() > 0.99 { DVec3::NEG_Z } else { DVec3::Y };
        let eye = self.center + toward * (4.0 * self.radius);
        let size = (FIT_SIDE, FIT_SIDE);
        let view = View::new(eye, self.center, up, projection, size, self.radius * 1e-3)?;
        let crown =
            Crown { world_from_local: DAffine3::IDENTITY, distance: 0.0, rank: 0, key: (0, 0) };
        let mut builder = ListBuilder::default();
        self.emit_slices(&view, &crown, &mut builder)?;
        let settings =
            Settings { sample_count: 1, outputs: Outputs::COLOR, background: Vec4::ZERO };
        let frame = Renderer::default().render(&builder.finish(), &view, &settings, job)?;
        let sum: f64 = frame.color.iter().map(|pixel| f64::from(pixel.w)).sum();
        Ok(sum / frame.color.len() as f64)
    }

    /// Bisects for the multiplier with which the crown is as opaque from all around as on its
    /// directions; whether there is one in the interval.
    fn fit(&mut self, tau: f64, job: &Job) -> Result<bool, LodError> {
        let directions = self.blend.directions().to_vec();
        if self.slicings.iter().any(Option::is_none) {
            let why = "needs all slicings: use it without views".to_owned();
            return Err(LodError::Invalid { name: "correction", why });
        }
        let level = directions.iter().all(|d| d.y.abs() < 1e-9);
        let around: Vec<DVec3> = if level { circle(FIT_AZIMUTHS) } else { sphere(FIT_AZIMUTHS) };
        let mean = |lod: &Self, over: &[DVec3]| -> Result<f64, LodError> {
            let alphas: Result<Vec<f64>, LodError> =
                over.par_iter().map(|&toward| lod.mean_alpha(toward, job)).collect();
            Ok(alphas?.iter().sum::<f64>() / over.len() as f64)
        };
        let wanted = mean(self, &directions)?;
        let mut excess = |m: f64| -> Result<f64, LodError> {
            self.opacity = Opacity::Linear { m };
            Ok(mean(self, &around)? - wanted)
        };
        let (mut low, mut high) = (0.0, MAX_M);
        let ends = (excess(low)?, excess(high)?);
        if ends.0 > 0.0 || ends.1 < 0.0 {
            let nearer = if ends.0.abs() <= ends.1.abs() { low } else { high };
            self.opacity = Opacity::Linear { m: nearer };
            return Ok(false);
        }
        let mut m = (2.0 * libm::tanh(tau / 4.0)).clamp(low, high);
        for _ in 0..FIT_STEPS {
            if excess(m)? < 0.0 {
                low = m
            } else {
                high = m
            }
            m = (low + high) * 0.5;
        }
        self.opacity = Opacity::Linear { m };
        Ok(true)
    }
}

/// Largest multiplier that a fit tries.
const MAX_M: f64 = 4.0;

/// Directions over which a fit averages; a multiple of the usual slicing counts.
const FIT_AZIMUTHS: usize = 36;

/// Halvings of [0, 4]: the last interval is 1e-3 wide.
const FIT_STEPS: usize = 12;

/// Pixels a side of a fit's pictures: slices are read through mips, so few are enough.
const FIT_SIDE: u32 = 96;

/// `count` directions evenly on the sphere: a Fibonacci lattice.
pub fn sphere(count: usize) -> Vec<DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..count)
        .map(|index| {
            let y = 1.0 - (2.0 * index as f64 + 1.0) / count as f64;
            let across = (1.0 - y * y).sqrt();
            let angle = golden * index as f64;
            DVec3::new(across * libm::sin(angle), y, across * libm::cos(angle))
        })
        .collect()
}

/// The leaves that stay in the mesh.
fn leaves_mesh(plant: &Plant, in_mesh: &[bool]) -> Mesh {
    let foliage = &plant.foliage;
    if !in_mesh.contains(&true) {
        return Mesh::default();
    }
    let materials: Vec<u32> = foliage.mesh.triangle_materials().collect();
    let kept: Vec<usize> = (0..in_mesh.len())
        .filter(|&leaf| in_mesh[leaf])
        .flat_map(|leaf| foliage.triangles_of(leaf))
        .collect();
    let ids: Vec<u32> = kept.iter().map(|&t| materials[t]).collect();
    Mesh {
        triangles: kept.iter().map(|&t| foliage.mesh.triangles[t]).collect(),
        parts: Mesh::parts_from_ids(&ids),
        ..foliage.mesh.clone()
    }
    .without_unused_vertices()
}

fn box_of_cards(buffers: &Buffers) -> (DVec3, DVec3) {
    let corners = buffers.positions.iter().map(|p| p.as_dvec3());
    let empty = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    corners.fold(empty, |(low, high), p| (low.min(p), high.max(p)))
}

/// Texels of each slicing: those of the nearest view that shows it, `None` if no view does.
fn needed_resolutions(
    crowned: &Crowned<'_>,
    params: &Params,
) -> Result<Vec<Option<(u32, u32)>>, LodError> {
    let count = params.blend.directions().len();
    let Some(views) = &params.views else { return Ok(vec![Some(params.resolution); count]) };
    if views.is_empty() {
        let why = "give at least one camera, or None for all directions";
        return Err(LodError::Empty { name: "views", why });
    }
    let mut needed: Vec<Option<f64>> = vec![None; count];
    for view in views {
        let from_center = view.eye - (crowned.center + crowned.plant.origin);
        let inside = from_center.length() < INSIDE * crowned.radius;
        let toward = if view.is_orthographic() || inside { view.back } else { from_center };
        let nearest = (from_center.length() - crowned.radius).max(view.near);
        let per_metre = 1.0 / view.pixel_size_at(nearest);
        for (number, _) in params.blend.shares(toward, view.up) {
            let most = needed[number].get_or_insert(0.0);
            *most = most.max(per_metre);
        }
    }
    let texels = |per_metre: f64, metres: f64, limit: u32| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let texels = (per_metre * metres).ceil().clamp(1.0, f64::from(limit)) as u32;
        texels
    };
    Ok(params
        .blend
        .directions()
        .iter()
        .zip(needed)
        .map(|(&toward, per_metre)| {
            let layout =
                Layout::new(toward, &crowned.leaf_centers, params.slice_count, crowned.radius);
            let rect = crowned.rect(&layout);
            per_metre.map(|per_metre| {
                (
                    texels(per_metre, rect.width, params.resolution.0),
                    texels(per_metre, rect.height, params.resolution.1),
                )
            })
        })
        .collect())
}

impl Representation for Slicings {
    fn bounds(&self) -> (DVec3, DVec3) {
        self.bounds
    }

    fn origin(&self) -> DVec3 {
        self.origin
    }

    fn footprint(&self) -> Footprint {
        let solid = self.solid.footprint();
        let slices = || self.slicings.iter().flatten().flat_map(|slicing| &slicing.slices);
        let stored = slices().filter_map(|slice| slice.texture.as_ref());
        Footprint {
            card_count: slices().filter(|slice| slice.texture.is_some()).count() as u64,
            geometry_bytes: solid.geometry_bytes + self.cards.buffers().byte_count(),
            texture_bytes: solid.texture_bytes
                + stored.map(|texture| texture.byte_count()).sum::<u64>(),
            ..solid
        }
    }

    fn textures(&self) -> Vec<NamedTexture> {
        let mut named = Vec::new();
        for (number, slicing) in self.slicings.iter().enumerate() {
            for (index, slice) in slicing.iter().flat_map(|s| s.slices.iter().enumerate()) {
                if let Some(texture) = &slice.texture {
                    named.push(NamedTexture {
                        name: format!("slicing {number}, slice {index}"),
                        texture: Arc::clone(texture),
                        rect: Some(slice.rect),
                    });
                }
            }
        }
        named.extend(self.solid.textures());
        named
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
