//! Points and lines: a plant seen from afar is a prefix of its points and lines.
//!
//! Compact pieces become random points on their surface, long thin ones a line each. How many a view
//! needs follows from the projected area and the wanted distance between samples on the picture; where
//! it needs more vertices than points offer, triangles take their place one by one. Everything is stored
//! in one random order, so that any level of detail is a prefix.
//!
//! This work is based on:
//! Oliver Deussen, Carsten Colditz, Marc Stamminger, George Drettakis. Interactive Visualization of
//! Complex Plant Ecosystems. 2002
//!
//! Deviations: what a texture leaves out is no area and gets no points; the two points of a triangle are
//! kept apart in the order; parts are told apart and weighed by themselves; wood takes part.

pub mod color_distance;
pub mod coverage;
pub mod groups;
pub mod lines;
pub mod octree;
pub mod opaque;
pub mod parts;
pub mod pieces;
pub mod sampling;
pub mod selection;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use glam::{DVec3, Vec4};

use crate::draw_list::{
    Blend, Buffers, DrawList, Instance, Item, MAX_SIZE_PX, Primitive, Source, Surface,
};
use crate::error::{LodError, check_in, check_limit};
use crate::job::Job;
use crate::lod::points_and_lines::coverage::FactorTable;
use crate::lod::points_and_lines::groups::{Group, Groups, Input};
use crate::lod::points_and_lines::octree::{Cells, MAX_DEPTH};
use crate::lod::points_and_lines::parts::{Class, Part, Wishes, parts};
use crate::lod::points_and_lines::pieces::{forms, pieces};
use crate::lod::points_and_lines::selection::{
    LineDraw, PointDraw, line_draw, line_share, needed_points, point_draw, whole,
};
pub use crate::lod::points_and_lines::selection::{PairOrder, Sampling};
use crate::lod::solid::{blend_of, ready_to_draw, surface_of, textures_of};
use crate::lod::wood::Wood;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture, Representation, largest_scale};
use crate::plant::mesh::MAX_ELEMENT_COUNT;
use crate::plant::{Material, Mesh, Part as MeshPart, Plant};
use crate::texture::Filter;
use crate::view::View;
use crate::view_state::ViewState;

/// Ranges of what can be chosen for each view.
const SAMPLE_DISTANCES_PX: [f64; 2] = [0.01, 256.0];
const SPLAT_FACTORS: [f64; 2] = [0.01, 256.0];

/// How large a splat is, as a share of the square of the distance between samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SplatFactor {
    /// The same always.
    Fixed(f64),
    /// What covers as much as the polygons.
    Coverage,
}

/// What becomes of splats and lines that are thinner than a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Antialias {
    /// They are drawn as thin as they are.
    Off,
    /// They are a pixel wide, and there in as many samples as their area asks for.
    Coverage,
    /// They are a pixel wide, and blended by their area without an order.
    Blend,
}

/// What can be chosen without building anew.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drawing {
    /// Area of a splat.
    pub splat_factor: SplatFactor,
    /// Pixels between samples.
    pub sample_distance_px: f64,
    /// What becomes of thin ones.
    pub antialias: Antialias,
}

impl Drawing {
    fn check(&self) -> Result<(), LodError> {
        let [low, high] = SAMPLE_DISTANCES_PX;
        check_in("sample_distance_px", self.sample_distance_px, low..=high)?;
        if let SplatFactor::Fixed(factor) = self.splat_factor {
            let [low, high] = SPLAT_FACTORS;
            check_in("splat_factor", factor, low..=high)?;
        }
        Ok(())
    }
}

/// How points and lines are built.
#[derive(Debug, Clone)]
pub struct Params {
    /// What can be changed later.
    pub drawing: Drawing,
    /// How points are chosen; `None` decides for each group by how even its triangles are.
    pub sampling: Option<Sampling>,
    /// Which points belong to a triangle.
    pub pair_order: PairOrder,
    /// What is said about parts.
    pub wishes: Wishes,
    /// Mean length of a line on the picture over its length, seen from a random side.
    pub orientation_factor: f64,
    /// Divisions of the octree, at most.
    pub octree_depth: usize,
    /// Triangles of a cell, at most, above that depth.
    pub cell_triangle_count: u64,
    /// Of every random choice.
    pub seed: u64,
    /// The wood that takes part.
    pub wood: Wood,
}

/// Materials ready to be drawn with.
#[derive(Debug)]
pub struct Surfaces {
    materials: Vec<Material>,
}

impl Surfaces {
    /// What a material looks like and how it joins the picture.
    fn of(&self, material: u32, list: &mut DrawList) -> (Surface, Blend) {
        let material = &self.materials[material as usize];
        (surface_of(material, list), blend_of(material))
    }
}

/// What all choices of a drawing share.
#[derive(Debug)]
struct Built {
    groups: Groups,
    parts: Vec<Part>,
    surfaces: Surfaces,
    pair_order: PairOrder,
    orientation_factor: f64,
    factors: OnceLock<FactorTable>,
    bounds: (DVec3, DVec3),
    origin: DVec3,
}

/// The technique's representation of a plant.
#[derive(Debug, Clone)]
pub struct PointsAndLines {
    built: Arc<Built>,
    drawing: Drawing,
}

/// What a view needs of a group.
#[derive(Debug, Clone, PartialEq)]
pub struct Chosen {
    /// Which of [`PointsAndLines::groups`].
    pub group: usize,
    /// Distance of the eye from the group's middle (1 in parallel views), in the plant's own metres.
    pub distance: f64,
    /// Samples that its area needs: p before rounding.
    pub needed: f64,
    /// Share of its lines whose area is that of its polygons: q.
    pub line_share: f64,
    /// The first so many triangles of the group.
    pub triangle_count: u32,
    /// Of the group's points.
    pub points: [std::ops::Range<u32>; 2],
    /// Of the group's lines.
    pub lines: std::ops::Range<u32>,
    /// Side of a point and width of a line, in pixels.
    pub sizes_px: [f64; 2],
}

impl Chosen {
    /// Vertices drawn.
    pub fn vertex_count(&self) -> u64 {
        let points: u32 = self.points.iter().map(|range| range.end - range.start).sum();
        let lines = self.lines.end - self.lines.start;
        3 * u64::from(self.triangle_count) + u64::from(points) + 2 * u64::from(lines)
    }
}

/// Where a copy is seen from.
struct Seen {
    /// In the copy's own coordinates; `None` in parallel views.
    eye: Option<DVec3>,
    /// Distance between samples at distance 1 from the eye, in the copy's own metres.
    sample: f64,
}

impl PointsAndLines {
    /// Turns a plant into points and lines.
    ///
    /// # Errors
    /// An argument out of range; nothing to draw; too many triangles to count their points;
    /// [`LodError::Cancelled`].
    pub fn build(plant: &Plant, params: &Params, job: &Job) -> Result<Self, LodError> {
        params.drawing.check()?;
        check_in("orientation_factor", params.orientation_factor, 0.01..=1.0)?;
        check_in("octree_depth", params.octree_depth, 0..=MAX_DEPTH)?;
        check_in("cell_triangle_count", params.cell_triangle_count, 1..=u64::MAX)?;
        let wood = params.wood.of(plant)?;
        let leaves = &plant.foliage.mesh;
        if wood.is_empty() && leaves.is_empty() {
            let why = "without wood there is nothing to draw";
            return Err(LodError::Empty { name: "foliage", why });
        }
        let counts = |count: fn(&Mesh) -> usize| (count(&wood) + count(leaves)) as u64;
        let vertex_count = counts(|mesh| mesh.positions.len());
        check_limit("positions", vertex_count, MAX_ELEMENT_COUNT, "vertices")?;
        let point_count = counts(|mesh| mesh.triangles.len()) * 2;
        check_limit("triangles", point_count, MAX_ELEMENT_COUNT, "points")?;
        let (mesh, source_ids) = joined(&wood, leaves, plant);
        let materials: Vec<u32> = mesh.triangle_materials().collect();
        let structure = match params.wood {
            Wood::Full => plant.structure.as_deref(),
            Wood::None | Wood::Simplified(_) => None,
        };
        let offsets = &plant.foliage.leaf_offsets;
        let pieces = pieces(&mesh, &materials, wood.triangles.len(), offsets, structure, job)?;
        let forms = forms(&mesh, &pieces, job)?;
        let (parts, part_of) =
            parts(&mesh, &plant.materials, &pieces, &forms, &params.wishes, job)?;
        let centers: Vec<DVec3> = forms.iter().map(|form| form.center).collect();
        let sizes: Vec<u32> = pieces
            .iter()
            .map(|piece| u32::try_from(piece.triangles.len()).expect("checked above"))
            .collect();
        let cells = Cells::new(&centers, &sizes, params.octree_depth, params.cell_triangle_count);
        let input = Input {
            mesh: &mesh,
            source_ids: &source_ids,
            materials: &plant.materials,
            pieces: &pieces,
            forms: &forms,
            parts: &parts,
            part_of: &part_of,
            cells: &cells,
            sun: plant.lighting.sun_direction,
            sampling: params.sampling,
            pair_order: params.pair_order,
            seed: params.seed,
        };
        let groups = Groups::new(&input, job)?;
        let (low, high) = mesh.bounds().expect("there is a triangle");
        let built = Built {
            groups,
            parts,
            surfaces: Surfaces {
                materials: ready_to_draw(&plant.materials, Filter::Bilinear, job)?,
            },
            pair_order: params.pair_order,
            orientation_factor: params.orientation_factor,
            factors: OnceLock::new(),
            bounds: (low.as_dvec3(), high.as_dvec3()),
            origin: plant.origin,
        };
        Self { built: Arc::new(built), drawing: params.drawing }.measured(job)
    }

    /// The same points and lines, drawn otherwise.
    ///
    /// # Errors
    /// A number out of range; [`LodError::Cancelled`].
    pub fn drawn(&self, drawing: Drawing, job: &Job) -> Result<Self, LodError> {
        drawing.check()?;
        Self { built: Arc::clone(&self.built), drawing }.measured(job)
    }

    /// With factors that cover as the polygons do, if those are asked for.
    fn measured(self, job: &Job) -> Result<Self, LodError> {
        let Built { groups, parts, surfaces, pair_order, factors, .. } = &*self.built;
        if self.drawing.splat_factor == SplatFactor::Coverage && factors.get().is_none() {
            let found = FactorTable::measured(groups, parts, surfaces, *pair_order, job)?;
            // another thread may have been quicker, with the same numbers
            let _ = factors.set(found);
        }
        Ok(self)
    }

    /// How it is drawn.
    pub fn drawing(&self) -> Drawing {
        self.drawing
    }

    /// The plant's parts.
    pub fn parts(&self) -> &[Part] {
        &self.built.parts
    }

    /// Pieces that are drawn together.
    pub fn groups(&self) -> &[Group] {
        &self.built.groups.groups
    }

    /// Splat factors that cover as polygons do, by halving numbers of points from 2 for each triangle;
    /// empty unless they were asked for.
    pub fn factors(&self) -> &[f64] {
        if self.drawing.splat_factor != SplatFactor::Coverage {
            return &[];
        }
        self.built.factors.get().map_or(&[], |table| &table.factors)
    }

    /// The arrays of all points, and of all lines.
    pub fn samples(&self) -> [&Buffers; 2] {
        [self.built.groups.points.buffers(), self.built.groups.lines.buffers()]
    }

    /// Bytes of points and lines, and of the triangles.
    pub fn bytes(&self) -> [u64; 2] {
        let Groups { triangles, points, lines, piece_ends, groups } = &self.built.groups;
        let tables = piece_ends.len() * size_of::<u32>() + groups.len() * size_of::<Group>();
        let samples = points.buffers().byte_count() + lines.buffers().byte_count();
        [samples + tables as u64, triangles.buffers().byte_count()]
    }

    /// What a view needs of the plant where its file put it, group by group; what the view cannot see is
    /// chosen all the same.
    pub fn selection(&self, view: &View) -> Vec<Chosen> {
        let world_from_local = glam::DAffine3::from_translation(self.built.origin);
        let crown = Crown { distance: 1.0, ..Crown::alone(world_from_local) };
        let seen = self.seen(view, &crown);
        (0..self.groups().len()).map(|group| self.choose(group, &seen)).collect()
    }

    fn seen(&self, view: &View, crown: &Crown) -> Seen {
        let sample = self.drawing.sample_distance_px / view.pixels_per_metre_at_one();
        if view.is_orthographic() {
            let scale = libm::cbrt(crown.world_from_local.matrix3.determinant().abs());
            return Seen { eye: None, sample: sample / scale };
        }
        Seen { eye: Some(crown.local_eye(view)), sample }
    }

    fn choose(&self, number: usize, seen: &Seen) -> Chosen {
        let group = &self.groups()[number];
        let importance = self.built.parts[group.part as usize].importance;
        let sample = seen.sample / importance;
        let distance = seen.eye.map_or(1.0, |eye| eye.distance(group.center));
        let needed = needed_points(group.seen_area, distance, sample);
        let width = self.drawing.sample_distance_px / importance;
        let mut chosen = Chosen {
            group: number,
            distance,
            needed,
            line_share: 0.0,
            triangle_count: group.triangles.end - group.triangles.start,
            points: [0..0, 0..0],
            lines: 0..0,
            sizes_px: [width, width],
        };
        match group.class {
            Class::Mesh => {}
            Class::Points => {
                let wanted = whole(needed, group.offset);
                let count = group.opaque_count;
                let draw = point_draw(wanted, count, group.sampling, self.built.pair_order);
                let PointDraw { triangle_count, points } = draw;
                let factor = match self.drawing.splat_factor {
                    SplatFactor::Fixed(factor) => factor,
                    SplatFactor::Coverage => {
                        let table = self.built.factors.get().expect("measured when chosen");
                        table.at_spacing(distance * seen.sample)
                    }
                };
                chosen.points = points;
                chosen.sizes_px[0] *= factor.sqrt();
                // with all that can become points comes what cannot
                if triangle_count < count || wanted == 0 {
                    chosen.triangle_count = triangle_count;
                }
            }
            Class::Lines => {
                let factor = self.built.orientation_factor;
                let share =
                    line_share(group.seen_area, group.line_length, distance, sample, factor);
                let deviation = group.deviation / (distance * sample);
                let count = group.lines.end - group.lines.start;
                let LineDraw { piece_count, lines } =
                    line_draw(share, deviation, count, group.offset);
                chosen.line_share = share;
                chosen.lines = lines;
                let ends = &self.built.groups.piece_ends[group.piece_ends.clone()];
                chosen.triangle_count =
                    piece_count.checked_sub(1).map_or(0, |last| ends[last as usize]);
            }
        }
        chosen
    }

    /// Whether any of a group may be seen, splats included.
    fn sees(&self, view: &View, crown: &Crown, chosen: &Chosen) -> bool {
        let group = &self.groups()[chosen.group];
        let center = crown.world_from_local.transform_point3(group.center);
        let radius = group.radius * largest_scale(&crown.world_from_local);
        let depth = view.view_from_world(center).z + radius;
        let [side, width] = chosen.sizes_px;
        // splats and lines reach beyond their middle, and antialiased ones are a pixel wide
        let margin = side.max(width).max(1.0) * view.pixel_size_at(depth.max(view.near));
        view.sees_ball(center, radius + margin)
    }
}

/// Wood and leaves as one mesh, the wood first, with the ids of the plant's triangles.
fn joined(wood: &Mesh, leaves: &Mesh, plant: &Plant) -> (Mesh, Vec<u32>) {
    let first_vertex = u32::try_from(wood.positions.len()).expect("checked above");
    let first_triangle = u32::try_from(wood.triangles.len()).expect("checked above");
    let wood_count = u32::try_from(plant.wood.triangles.len()).expect("checked by the plant");
    let mut mesh = wood.clone();
    mesh.positions.extend_from_slice(&leaves.positions);
    mesh.normals.extend_from_slice(&leaves.normals);
    mesh.uvs.extend_from_slice(&leaves.uvs);
    mesh.base.extend_from_slice(&leaves.base);
    mesh.front.extend_from_slice(&leaves.front);
    mesh.back.extend_from_slice(&leaves.back);
    let moved = leaves.triangles.iter().map(|corners| corners.map(|v| v + first_vertex));
    mesh.triangles.extend(moved);
    mesh.parts.extend(leaves.parts.iter().map(|part| MeshPart {
        material: part.material,
        triangles: part.triangles.start + first_triangle..part.triangles.end + first_triangle,
    }));
    let ids = Buffers::ids_from(0, wood).into_iter().chain(Buffers::ids_from(wood_count, leaves));
    (mesh, ids.collect())
}

/// Draws of one view: where they go, and what is there already.
struct Emitter<'a> {
    view: &'a View,
    builder: &'a mut ListBuilder,
    sources: [Source; 3],
    /// Copies of an instance whose splats fade: opacity, and the instance.
    /// Instances by the bits of their opacity.
    faded: BTreeMap<u32, u32>,
    /// Triangles that blend: distance, material, index, of the copy at hand.
    blended: Vec<(f64, u32, u32)>,
}

impl Emitter<'_> {
    /// The item of some primitives.
    fn item(
        &self,
        primitive: Primitive,
        source: Source,
        primitives: std::ops::Range<u32>,
        instance: u32,
    ) -> Item {
        Item {
            primitive,
            vertices: source,
            indices: source,
            primitives,
            instances: instance..instance + 1,
            surface: Surface::VertexColor,
            blend: Blend::Opaque,
            depth_write: true,
            slab: None,
        }
    }

    /// An instance like another, less opaque.
    fn faded(&mut self, instance: u32, opacity: f32) -> u32 {
        if let Some(&known) = self.faded.get(&opacity.to_bits()) {
            return known;
        }
        let of = self.builder.list.instances[instance as usize];
        let faded = Instance { tint: Vec4::ONE.with_w(opacity), ..of };
        let number = self.builder.list.instance(faded).start;
        self.faded.insert(opacity.to_bits(), number);
        number
    }
}

impl PointsAndLines {
    fn emit_group(&self, emitter: &mut Emitter<'_>, crown: &Crown, instance: u32, chosen: &Chosen) {
        let group = &self.groups()[chosen.group];
        let material = self.built.parts[group.part as usize].material;
        if chosen.triangle_count > 0 {
            let first = group.triangles.start;
            let range = first..first + chosen.triangle_count;
            let (surface, blend) = self.built.surfaces.of(material, &mut emitter.builder.list);
            if blend == Blend::Over {
                self.gather_blended(emitter, crown, material, range);
            } else {
                let item = emitter.item(Primitive::Triangles, emitter.sources[0], range, instance);
                emitter.builder.list.items.push(Item { surface, blend, ..item });
            }
        }
        let [side, width] = chosen.sizes_px;
        for range in chosen.points.iter().filter(|range| !range.is_empty()) {
            let first = group.points.start;
            let range = first + range.start..first + range.end;
            let points = |size_px: f32| Primitive::Points { size_px };
            self.emit_thin(emitter, crown, instance, 1, range, (side, 2), &points);
        }
        if !chosen.lines.is_empty() {
            let first = group.lines.start;
            let range = first + chosen.lines.start..first + chosen.lines.end;
            let lines = |width_px: f32| Primitive::Lines { width_px };
            self.emit_thin(emitter, crown, instance, 2, range, (width, 1), &lines);
        }
    }

    /// Points or lines; those thinner than a pixel as they are asked to be drawn. Their area goes with
    /// a power of their size.
    #[expect(clippy::too_many_arguments, reason = "what an item consists of")]
    fn emit_thin(
        &self,
        emitter: &mut Emitter<'_>,
        crown: &Crown,
        instance: u32,
        source: usize,
        range: std::ops::Range<u32>,
        (size, power): (f64, i32),
        primitive: &dyn Fn(f32) -> Primitive,
    ) {
        #[expect(clippy::cast_possible_truncation, reason = "pixels")]
        let [size_px, opacity] = [size as f32, size.powi(power) as f32];
        let source = emitter.sources[source];
        let is_thin = size_px < 1.0 && self.drawing.antialias != Antialias::Off;
        if !is_thin {
            let size_px = size_px.clamp(f32::MIN_POSITIVE, MAX_SIZE_PX);
            let item = emitter.item(primitive(size_px), source, range, instance);
            emitter.builder.list.items.push(item);
            return;
        }
        let instance = emitter.faded(instance, opacity);
        let item = emitter.item(primitive(1.0), source, range, instance);
        match self.drawing.antialias {
            Antialias::Off | Antialias::Coverage => {
                emitter.builder.list.items.push(Item { blend: Blend::Coverage, ..item });
            }
            Antialias::Blend => {
                let item = Item { blend: Blend::Over, depth_write: false, ..item };
                emitter.builder.push_blended(crown, item);
            }
        }
    }

    fn gather_blended(
        &self,
        emitter: &mut Emitter<'_>,
        crown: &Crown,
        material: u32,
        range: std::ops::Range<u32>,
    ) {
        let view = emitter.view;
        let buffers = self.built.groups.triangles.buffers();
        emitter.blended.extend(range.map(|index| {
            let at = index as usize * 3;
            let corners = buffers.indices[at..at + 3].iter();
            let sum: DVec3 = corners.map(|&v| buffers.positions[v as usize].as_dvec3()).sum();
            let world = crown.world_from_local.transform_point3(sum / 3.0);
            let distance = if view.is_orthographic() {
                view.view_from_world(world).z
            } else {
                world.distance_squared(view.eye)
            };
            (distance, material, index)
        }));
    }

    /// The copy's triangles that blend, far to near.
    fn emit_blended(&self, emitter: &mut Emitter<'_>, crown: &Crown, instance: u32) {
        let mut blended = std::mem::take(&mut emitter.blended);
        let shared = self.built.groups.triangles.buffers();
        let id = |index: u32| shared.source_ids[index as usize];
        blended.sort_by(|a, b| b.0.total_cmp(&a.0).then(id(a.2).cmp(&id(b.2))));
        for run in blended.chunk_by(|a, b| a.1 == b.1) {
            let (surface, blend) = self.built.surfaces.of(run[0].1, &mut emitter.builder.list);
            let own = &mut emitter.builder.list.own;
            let start = u32::try_from(own.buffers.indices.len() / 3).expect("fits in u32");
            for &(_, _, index) in run {
                let at = index as usize * 3;
                own.buffers.indices.extend_from_slice(&shared.indices[at..at + 3]);
                own.buffers.source_ids.push(id(index));
            }
            let end = start + u32::try_from(run.len()).expect("fits in u32");
            own.dirty_indices.push(start * 3..end * 3);
            let item = emitter.item(Primitive::Triangles, emitter.sources[0], start..end, instance);
            let item = Item { surface, blend, depth_write: false, indices: Source::Own, ..item };
            emitter.builder.push_blended(crown, item);
        }
        blended.clear();
        emitter.blended = blended;
    }
}

impl Representation for PointsAndLines {
    fn bounds(&self) -> (DVec3, DVec3) {
        self.built.bounds
    }

    fn margin_px(&self) -> f64 {
        let Drawing { splat_factor, sample_distance_px, .. } = self.drawing;
        let factor = match splat_factor {
            SplatFactor::Fixed(factor) => factor,
            SplatFactor::Coverage => self.factors().iter().copied().fold(1.0, f64::max),
        };
        // a line is as wide as samples are apart, an antialiased one a pixel
        (factor.max(1.0).sqrt() * sample_distance_px).max(1.0)
    }

    fn origin(&self) -> DVec3 {
        self.built.origin
    }

    fn footprint(&self) -> Footprint {
        let Groups { triangles, points, lines, .. } = &self.built.groups;
        let textures = self.textures();
        Footprint {
            triangle_count: (triangles.buffers().indices.len() / 3) as u64,
            card_count: 0,
            line_count: (lines.buffers().indices.len() / 2) as u64,
            point_count: points.buffers().indices.len() as u64,
            geometry_bytes: self.bytes().iter().sum(),
            texture_bytes: textures.iter().map(|named| named.texture.byte_count()).sum(),
        }
    }

    fn textures(&self) -> Vec<NamedTexture> {
        let materials = &self.built.surfaces.materials;
        textures_of(materials, self.parts().iter().map(|part| part.material))
    }

    fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        _state: &mut ViewState,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        let Groups { triangles, points, lines, .. } = &self.built.groups;
        let sources = [triangles, points, lines].map(|shared| builder.list.geometry(shared));
        let mut emitter =
            Emitter { view, builder, sources, faded: BTreeMap::new(), blended: Vec::new() };
        // near copies first, so that they hide what lies behind them
        for crown in crowns.iter().rev() {
            let seen = self.seen(view, crown);
            let seed = crown.key.1;
            let instance = Instance { seed, ..crown.instance(view) };
            let instance = emitter.builder.list.instance(instance).start;
            emitter.faded.clear();
            for number in 0..self.groups().len() {
                let chosen = self.choose(number, &seen);
                if chosen.vertex_count() > 0 && self.sees(view, crown, &chosen) {
                    self.emit_group(&mut emitter, crown, instance, &chosen);
                }
            }
            self.emit_blended(&mut emitter, crown, instance);
        }
        Ok(())
    }
}
