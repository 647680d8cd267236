//! Techniques: each file turns a plant into a [`Representation`] and emits draw lists for views.
//!
//! No technique knows another, and nothing outside this folder knows any.

pub mod billboard;
pub mod cloud;
pub mod eigen;
pub mod foliage_hierarchy;
pub mod full_mesh;
pub mod layered_billboards;
pub mod leaf_clusters;
pub mod octahedral_impostor;
pub mod orthogonal_slices;
pub mod points_and_lines;
pub mod simplified_mesh;
pub mod slicings;
pub mod stochastic_pruning;

pub(crate) mod leaves;
pub mod level_rule;
#[cfg(test)]
pub(crate) mod made;
pub mod opacity;
pub mod simplify;
pub(crate) mod slabs;
pub mod solid;
pub(crate) mod stack;
pub mod view_blend;
pub(crate) mod viewer;
pub mod wind;
pub mod wood;
pub mod wood_levels;

use std::fmt::Debug;
use std::ops::Range;
use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec3};

use crate::bake::BakeRect;
use crate::draw_list::{DrawList, Instance, Item, OwnBuffers, Primitive, Source};
use crate::error::LodError;
use crate::lod::wind::Gust;
use crate::texture::Texture;
use crate::view::View;
use crate::view_state::{Key, ViewState};

/// What a representation holds, whether or not a view needs it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Footprint {
    /// Triangles of meshes.
    pub triangle_count: u64,
    /// Textured quads.
    pub card_count: u64,
    /// Lines.
    pub line_count: u64,
    /// Points.
    pub point_count: u64,
    /// Vertices, indices and side tables.
    pub geometry_bytes: u64,
    /// All mip levels, in the format they are stored in.
    pub texture_bytes: u64,
}

/// A texture of a representation, for looking at.
#[derive(Debug, Clone)]
pub struct NamedTexture {
    /// What it shows.
    pub name: String,
    /// As drawn.
    pub texture: Arc<Texture>,
    /// Where in the plant's space it lies, if it is a bake.
    pub rect: Option<BakeRect>,
}

/// One placed copy that a view can see.
#[derive(Debug, Clone)]
pub struct Crown {
    /// Where it stands: maps the representation's local space to the world.
    pub world_from_local: DAffine3,
    /// Distance of its centre from the eye (perspective) or the picture plane (parallel).
    pub distance: f64,
    /// Paint rank among all copies of the scene: 0 is the farthest.
    pub rank: u32,
    /// Whose memory it has.
    pub key: Key,
    /// Multiplies its colours.
    pub tint: Vec3,
    /// The wind, for techniques that sway by themselves; for all others it is in the transform.
    pub wind: Option<Gust>,
}

impl Crown {
    /// A single copy, as a scene places the first of its first group.
    pub fn alone(world_from_local: DAffine3) -> Self {
        let (distance, rank, key, tint) = (0.0, 0, (0, 0), Vec3::ONE);
        Self { world_from_local, distance, rank, key, tint, wind: None }
    }

    /// An instance of this copy.
    pub fn instance(&self, view: &View) -> Instance {
        let tint = self.tint.extend(1.0);
        Instance { tint, ..Instance::new(&self.world_from_local, view) }
    }

    /// The eye in local coordinates.
    pub fn local_eye(&self, view: &View) -> DVec3 {
        self.world_from_local.inverse().transform_point3(view.eye)
    }

    /// The same copy as the wind leans it, for a mesh that is sheared as a whole.
    #[must_use]
    pub fn leaning(&self, view: &View, foot: DVec3) -> Self {
        let placed = self.world_from_local;
        let shear = |gust: Gust| placed * gust.shear(view, &placed, foot);
        Self { world_from_local: self.wind.map_or(placed, shear), ..self.clone() }
    }

    /// How much larger it is than the representation itself, in the mean of all directions.
    pub fn scale(&self) -> f64 {
        libm::cbrt(self.world_from_local.matrix3.determinant().abs())
    }

    /// A world direction in local coordinates, unit length.
    pub fn local_direction(&self, direction: DVec3) -> DVec3 {
        self.world_from_local.inverse().transform_vector3(direction).normalize()
    }
}

/// The middle of the lower side of the box around some boxes.
pub(crate) fn foot_of(boxes: impl Iterator<Item = (Vec3, Vec3)>) -> DVec3 {
    let around = boxes.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    let (low, high) = around.expect("a representation has something to draw");
    let (low, high) = (low.as_dvec3(), high.as_dvec3());
    DVec3::new((low.x + high.x) * 0.5, low.y, (low.z + high.z) * 0.5)
}

/// An upper bound on how much a transform stretches any length; exact for turns, mirrors and sizes.
pub(crate) fn largest_scale(placement: &DAffine3) -> f64 {
    let m = placement.matrix3;
    // the largest eigenvalue is at most the largest sum of a row's magnitudes
    let squared = m.transpose() * m;
    let rows = [squared.x_axis, squared.y_axis, squared.z_axis];
    rows.map(|row| row.abs().element_sum()).into_iter().fold(0.0, f64::max).sqrt()
}

/// A draw list in the making: opaque items as they come, blended ones sorted by copy at the end.
#[derive(Debug, Default)]
pub struct ListBuilder {
    /// What has been emitted; add opaque items to `list.items`.
    pub list: DrawList,
    blended: Vec<(u32, Item)>,
    at_eye: Option<Range<u32>>,
}

impl ListBuilder {
    /// Adds an item that is painted with its copy, far copies before near ones.
    pub fn push_blended(&mut self, crown: &Crown, item: Item) {
        self.blended.push((crown.rank, item));
    }

    /// The instance of what is written into the frame's own buffers relative to the eye. Items that are
    /// alike but for their primitives and follow one another become one, whichever copy or
    /// representation they are of.
    pub fn at_eye(&mut self) -> Range<u32> {
        let list = &mut self.list;
        self.at_eye.get_or_insert_with(|| list.instance(Instance::at_eye())).clone()
    }

    /// Opaque items first, then the blended ones, copy by copy.
    pub fn finish(mut self) -> DrawList {
        self.blended.sort_by_key(|(rank, _)| *rank);
        let opaque = std::mem::take(&mut self.list.items);
        for item in opaque.into_iter().chain(self.blended.into_iter().map(|(_, item)| item)) {
            let last = self.list.items.last_mut();
            let is_free = self.at_eye.as_ref() == Some(&item.instances);
            match last.filter(|last| is_free && is_alike(last, &item)) {
                Some(last) => join(&mut self.list.own, last, &item),
                None => self.list.items.push(item),
            }
        }
        self.list
    }
}

/// Whether two items of triangles in a frame's own buffers differ in their primitives alone.
fn is_alike(a: &Item, b: &Item) -> bool {
    let is_own = a.indices == Source::Own && a.primitive == Primitive::Triangles;
    is_own && *a == Item { primitives: a.primitives.clone(), ..b.clone() }
}

/// Draws an item's triangles after those of the item before it, which is alike.
fn join(own: &mut OwnBuffers, last: &mut Item, item: &Item) {
    if last.primitives.end == item.primitives.start {
        last.primitives.end = item.primitives.end;
        return;
    }
    let is_last = last.primitives.end as usize * 3 == own.buffers.indices.len();
    let mut append = |primitives: &Range<u32>| {
        let (start, end) = (primitives.start as usize, primitives.end as usize);
        let buffers = &mut own.buffers;
        let first = buffers.indices.len();
        buffers.indices.extend_from_within(start * 3..end * 3);
        buffers.source_ids.extend_from_within(start..end);
        let range =
            [first, buffers.indices.len()].map(|at| u32::try_from(at).expect("fits in u32"));
        own.dirty_indices.push(range[0]..range[1]);
        range[0] / 3..range[1] / 3
    };
    if !is_last {
        last.primitives = append(&last.primitives);
    }
    last.primitives.end = append(&item.primitives).end;
}

/// A plant as one technique stands for it.
pub trait Representation: Debug + Send + Sync {
    /// Local-space box around everything it may draw.
    fn bounds(&self) -> (DVec3, DVec3);

    /// Pixels by which it may draw beyond that box: points and lines have their size in pixels.
    fn margin_px(&self) -> f64 {
        0.0
    }

    /// What stays in the wind: the middle of the lower side of the box around wood and leaves, which
    /// cards may reach beyond.
    fn foot(&self) -> DVec3 {
        let (low, high) = self.bounds();
        DVec3::new((low.x + high.x) * 0.5, low.y, (low.z + high.z) * 0.5)
    }

    /// Whether it moves in the wind by itself, rather than being sheared as a whole.
    fn sways(&self) -> bool {
        false
    }

    /// Metres that a wind whose reach is 1 moves any part of it, at most: as far as its top is sheared,
    /// or what is drawn below its foot.
    fn sway_reach(&self) -> f64 {
        let ((low, high), foot) = (self.bounds(), self.foot());
        (high.y - foot.y).max(foot.y - low.y)
    }

    /// World position of local zero when the plant stands where its file put it.
    fn origin(&self) -> DVec3;

    /// What it holds.
    fn footprint(&self) -> Footprint;

    /// Its textures, for looking at.
    fn textures(&self) -> Vec<NamedTexture>;

    /// Appends what `view` needs of the copies it can see, given far to near.
    ///
    /// # Errors
    /// If the representation was built for other views than this one.
    fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError>;
}
