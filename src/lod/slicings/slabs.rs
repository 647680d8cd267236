//! Which leaf goes to which slice: the slabs of a direction, and the leaves that lie in each.

use std::sync::Arc;

use glam::{DAffine3, DVec2, DVec3, Vec3};
use rayon::prelude::*;

use crate::bake::BakeRect;
use crate::draw_list::{
    Blend, Buffers, DrawList, Geometry, Instance, Item, Primitive, Source, Surface,
};
use crate::error::LodError;
use crate::lod::solid::blend_of;
use crate::plant::Plant;
use crate::view::View;

/// A crown thinner than this share of its radius along a direction is one slice.
const FLAT: f64 = 1e-6;

/// A leaf this share of the spacing beyond the middle between two slices still lies there: rounding.
const TIE: f64 = 1e-9;

/// A crown smaller than this, in metres, is baked as if it were as large: a point needs a rectangle.
pub(super) const LEAST_SIZE: f64 = 1e-6;

/// A direction's axes and its slabs.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    right: DVec3,
    up: DVec3,
    pub(super) toward: DVec3,
    pub(super) spacing: f64,
    pub(super) count: usize,
}

impl Layout {
    /// Slabs across `toward` for leaf centres relative to the crown's centre.
    pub(super) fn new(toward: DVec3, centers: &[DVec3], slice_count: usize, radius: f64) -> Self {
        // world up, or -z for a direction that is up itself
        let up_hint = if toward.y.abs() > 1.0 - 1e-9 { DVec3::NEG_Z } else { DVec3::Y };
        let right = up_hint.cross(toward).normalize();
        let up = toward.cross(right);
        let depth = 2.0 * centers.iter().map(|p| toward.dot(*p).abs()).fold(0.0, f64::max);
        // equal where the crown is a single point
        let flat = depth <= FLAT * radius;
        let count = if flat { 1 } else { slice_count };
        let spacing = if flat { 0.0 } else { depth / count as f64 };
        Self { right, up, toward, spacing, count }
    }

    /// Offset of a slice's plane from the centre.
    pub(super) fn offset(&self, slice: usize) -> f64 {
        (slice as f64 - (self.count as f64 - 1.0) / 2.0) * self.spacing
    }

    /// The slice nearest to an offset; between two, the lower.
    pub(super) fn nearest(&self, offset: f64) -> usize {
        if self.spacing == 0.0 {
            return 0;
        }
        let at = (offset / self.spacing + self.count as f64 / 2.0 - TIE).ceil() - 1.0;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let slice = at.clamp(0.0, self.count as f64 - 1.0) as usize;
        slice
    }

    /// Whether what lies between two offsets is longer than the spacing.
    fn is_exceeded_by(&self, (low, high): (f64, f64)) -> bool {
        self.count > 1 && high - low > self.spacing * (1.0 + TIE)
    }

    /// Offsets between which a slice owns cut leaves; the outermost reach to infinity.
    pub(super) fn slab(&self, slice: usize) -> (f64, f64) {
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
pub(super) struct Crowned<'a> {
    pub(super) plant: &'a Plant,
    geometry: Arc<Geometry>,
    /// Middle of the box of leaf centres, relative to the plant's origin.
    pub(super) center: DVec3,
    /// Largest distance of a leaf's vertex from the centre.
    pub(super) radius: f64,
    /// Leaf centres relative to `center`.
    pub(super) leaf_centers: Vec<DVec3>,
    /// Material of each triangle.
    pub(super) materials: Vec<u32>,
}

/// A leaf in a slice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Placed {
    pub(super) leaf: usize,
    /// Whether only the part inside the slab belongs to the slice.
    pub(super) cut: bool,
}

/// Where a slicing's leaves go.
pub(super) struct Assignment {
    pub(super) layout: Layout,
    /// The shared rectangle, through the crown's centre.
    pub(super) rect: BakeRect,
    /// By slice, in the order of the leaves.
    pub(super) leaves: Vec<Vec<Placed>>,
}

impl<'a> Crowned<'a> {
    pub(super) fn new(plant: &'a Plant) -> Result<Self, LodError> {
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
            geometry: Geometry::new(Buffers::from_mesh(
                &foliage.mesh,
                Buffers::ids_from(0, &foliage.mesh),
            )),
            center,
            radius: 0.0,
            leaf_centers: foliage.centers.iter().map(|p| p.as_dvec3() - center).collect(),
            materials: foliage.mesh.triangle_materials().collect(),
        };
        crowned.radius = (0..crowned.leaf_centers.len())
            .into_par_iter()
            .map(|leaf| crowned.vertices_of(leaf).map(DVec3::length).fold(0.0, f64::max))
            .reduce(|| 0.0, f64::max);
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
    pub(super) fn is_large(&self, leaf: usize, layout: &Layout) -> bool {
        layout.is_exceeded_by(self.extent(leaf, layout.toward))
    }

    /// The rectangle through the centre that encloses every leaf as seen along a layout's direction.
    pub(super) fn rect(&self, layout: &Layout) -> BakeRect {
        let half = (0..self.leaf_centers.len())
            .into_par_iter()
            .map(|leaf| {
                self.vertices_of(leaf).fold(DVec2::ZERO, |half, p| {
                    half.max(DVec2::new(p.dot(layout.right).abs(), p.dot(layout.up).abs()))
                })
            })
            .reduce(|| DVec2::ZERO, DVec2::max);
        // a crown that is a line or a point from here still needs a rectangle
        let least = (self.radius * FLAT).max(LEAST_SIZE * FLAT);
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
    pub(super) fn assign(&self, layout: Layout, in_mesh: &[bool]) -> Assignment {
        let placed: Vec<(bool, usize, usize)> = (0..self.leaf_centers.len())
            .into_par_iter()
            .map(|leaf| {
                let (low, high) = self.extent(leaf, layout.toward);
                if layout.is_exceeded_by((low, high)) {
                    // wider than it is, since slabs are cut at f32 depths of up to 8 radii
                    let margin = layout.spacing * 1e-3 + self.radius * 1e-5;
                    (true, layout.nearest(low - margin), layout.nearest(high + margin))
                } else {
                    let slice = layout.nearest(self.leaf_centers[leaf].dot(layout.toward));
                    (false, slice, slice)
                }
            })
            .collect();
        let mut leaves = vec![Vec::new(); layout.count];
        for (leaf, (cut, first, last)) in placed.into_iter().enumerate() {
            if !in_mesh[leaf] {
                leaves[first..=last].iter_mut().for_each(|slice| slice.push(Placed { leaf, cut }));
            }
        }
        Assignment { layout, rect: self.rect(&layout), leaves }
    }

    /// The list that draws a slice's leaves for its bake.
    pub(super) fn list(&self, view: &View, assignment: &Assignment, slice: usize) -> DrawList {
        struct Drawn {
            triangle: usize,
            cut: bool,
            blended: bool,
            /// By how near to the viewer.
            rank: i64,
            /// Among those that were assigned.
            place: usize,
        }
        let mesh = &self.plant.foliage.mesh;
        let material_of = |t: usize| &self.plant.materials[self.materials[t] as usize];
        let mut drawn: Vec<Drawn> = assignment.leaves[slice]
            .iter()
            .flat_map(|&Placed { leaf, cut }| {
                self.plant.foliage.triangles_of(leaf).map(move |triangle| (triangle, cut))
            })
            .enumerate()
            .map(|(place, (triangle, cut))| {
                let blended = blend_of(material_of(triangle)) == Blend::Over;
                let corners = mesh.corners(triangle);
                let height: f64 = corners.iter().map(|p| p.as_dvec3().dot(view.back)).sum();
                // in the order of `total_cmp`
                let bits = height.to_bits().cast_signed();
                let upwards = bits ^ ((bits >> 63).cast_unsigned() >> 1).cast_signed();
                let rank = if blended { upwards } else { !upwards };
                Drawn { triangle, cut, blended, rank, place }
            })
            .collect();
        // blended triangles after the others and far to near; the others near to far, so that what
        // they hide needs no alpha test
        drawn.sort_unstable_by_key(|drawn| (drawn.blended, drawn.rank, drawn.place));
        let mut list = DrawList::default();
        let source = list.geometry(&self.geometry);
        let instances = list.instance(Instance::new(&DAffine3::IDENTITY, view));
        let alike = |a: &Drawn, b: &Drawn| {
            (self.materials[a.triangle], a.cut) == (self.materials[b.triangle], b.cut)
        };
        for run in drawn.chunk_by(alike) {
            let material = material_of(run[0].triangle);
            let blend = blend_of(material);
            let own = &mut list.own.buffers.indices;
            let start = u32::try_from(own.len() / 3).expect("fits in u32");
            let corners = &self.geometry.buffers().indices;
            own.extend(run.iter().flat_map(|d| &corners[d.triangle * 3..d.triangle * 3 + 3]));
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
                slab: run[0].cut.then(|| assignment.slab(slice)),
            });
        }
        list
    }
}

impl Assignment {
    /// Depths, as the shared view measures them, between which a slice owns cut leaves. Neighbours
    /// share the very same number, so each sample belongs to exactly one.
    pub(super) fn slab(&self, slice: usize) -> [f32; 2] {
        let (low, high) = self.layout.slab(slice);
        #[expect(clippy::cast_possible_truncation, reason = "depths are compared in f32")]
        let depths = [self.rect.depth_of(high) as f32, self.rect.depth_of(low) as f32];
        [depths[0].max(0.0), depths[1]]
    }

    /// Where a slice's card lies.
    pub(super) fn card(&self, slice: usize) -> BakeRect {
        let offset = self.layout.toward * self.layout.offset(slice);
        BakeRect { center: self.rect.center + offset, ..self.rect }
    }
}
