//! Stochastic pruning: from afar fewer leaves, each larger.
//!
//! Leaves are in a random order. Of them a share `u` is drawn that falls with distance, and the area of
//! each is scaled by `1/u`, so that the total area stays. The last leaves of the share shrink before
//! they leave. Wood stays a mesh.
//!
//! With `z` the distance over the one at which pruning begins, and `h` the `z` at which half of the
//! leaves are left, `u = z^(-log_h 2)`. A leaf at place `x` of the order, in [0, 1), has the area factor
//! `f(x) = clamp((u - x) / w, 0, 1)`, where `w = shrink min(u, 1 - u)`; all are then scaled by
//! `1 / (u - w / 2)`, which is one over the sum of the factors.
//!
//! This work is based on:
//! Robert L. Cook, John Halstead, Maxwell Planck, David Ryu. Stochastic Simplification of Aggregate
//! Detail. 2007
//!
//! Deviations: distance is measured by the width of a mean leaf on the picture, whatever the camera; the
//! window of shrinking is closed where all leaves are drawn; contrast is counted by whole leaves.

#[cfg(test)]
mod tests;

use std::f64::consts::SQRT_2;
use std::ops::Range;
use std::sync::Arc;

use glam::{DVec3, Vec3};
use rayon::slice::ParallelSliceMut;

use crate::draw_list::{Blend, Buffers, Geometry, Instance, Item, OwnBuffers, Primitive, Source};
use crate::error::{LodError, check_in};
use crate::job::{ELEMENTS_PER_CHECK, Job};
use crate::lod::leaves::Leaves;
use crate::lod::solid::{Solid, blend_of, ready_to_draw, surface_of, textures_of};
use crate::lod::wood::Wood;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture, Representation, foot_of};
use crate::plant::{Material, Mesh, Plant};
use crate::random::{Purpose, Stream};
use crate::texture::Filter;
use crate::view::View;
use crate::view_state::ViewState;

const ORDER: Purpose = Purpose::named("stochastic_pruning.order");

/// How leaves are pruned.
#[derive(Debug, Clone)]
pub struct Params {
    /// Width in pixels of a mean leaf (the root of its area) where pruning begins.
    pub leaf_width_px: f64,
    /// How many times farther half of the leaves are left: h.
    pub half_ratio: f64,
    /// Share of the leaves that are left, or of those that are not if they are fewer, which are
    /// shrinking.
    pub shrink: f64,
    /// Whether colours are drawn towards their mean, as averaging more leaves would.
    pub contrast: bool,
    /// Of the order.
    pub seed: u64,
    /// The wood that stays a mesh.
    pub wood: Wood,
}

/// Share of leaves, and how they are drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// Of all leaves: u.
    pub kept_share: f64,
    /// Places over which leaves shrink: w.
    pub window: f64,
    /// What a whole leaf's area is multiplied by.
    pub area_scale: f64,
    /// What a colour's distance from the mean is multiplied by.
    pub contrast: f64,
}

impl Level {
    /// The level of a share, where a mean leaf has `leaf_area_px` square pixels; 0 for no contrast.
    pub fn new(kept_share: f64, shrink: f64, leaf_area_px: f64) -> Self {
        let window = shrink * kept_share.min(1.0 - kept_share);
        // leaves that share a pixel: those of the plant, and those that are left, which are larger
        let in_pixel = if leaf_area_px > 0.0 { 1.0 / leaf_area_px } else { 1.0 };
        let contrast = ((in_pixel * kept_share).max(1.0) / in_pixel.max(1.0)).sqrt();
        let area_scale = 1.0 / (kept_share - window / 2.0);
        Self { kept_share, window, area_scale, contrast }
    }

    /// What the area of the leaf at a place in [0, 1) is multiplied by; 0 for one that is not drawn.
    pub fn area_factor(&self, place: f64) -> f64 {
        if place >= self.kept_share {
            return 0.0;
        }
        let left = self.kept_share - place;
        if left < self.window { left / self.window * self.area_scale } else { self.area_scale }
    }
}

/// Share of leaves that are left: `z^(-log_h 2)` beyond z = 1, all before.
pub fn kept_share(z: f64, half_ratio: f64) -> f64 {
    if z > 1.0 { libm::pow(z, -core::f64::consts::LN_2 / libm::log(half_ratio)) } else { 1.0 }
}

/// Leaves of one material, in the order in which they are left out last to first.
#[derive(Debug)]
struct Run {
    material: u32,
    leaves: Vec<Leaf>,
}

/// What a leaf has of one material.
#[derive(Debug)]
struct Leaf {
    /// In the order, in [0, 1).
    place: f64,
    center: DVec3,
    /// A range of the mesh's.
    triangles: Range<u32>,
    /// A range of [`Built::vertices`].
    vertices: Range<u32>,
}

/// What all choices of a share have in common.
#[derive(Debug)]
struct Built {
    geometry: Arc<Geometry>,
    materials: Vec<Material>,
    runs: Vec<Run>,
    /// Vertices of each leaf, once each.
    vertices: Vec<u32>,
    /// Corners of each of the mesh's triangles, counted in its leaf's vertices.
    corners: Vec<[u32; 3]>,
    solid: Solid,
    params: Params,
    leaf_count: usize,
    /// Root of the mean leaf area, in metres.
    leaf_width: f64,
    /// Largest distance of a vertex from its leaf's centre, in metres.
    leaf_reach: f64,
    mean_color: Vec3,
    center: DVec3,
    /// Of all leaves in their own size.
    bounds: (DVec3, DVec3),
    foot: DVec3,
    origin: DVec3,
}

/// The technique's representation of a plant.
#[derive(Debug, Clone)]
pub struct StochasticPruning {
    built: Arc<Built>,
    /// The share of every view, if it is fixed.
    fixed: Option<f64>,
}

impl StochasticPruning {
    /// Puts a plant's leaves in a random order.
    ///
    /// # Errors
    /// `foliage` without leaves; an argument out of range; [`LodError::Cancelled`].
    pub fn build(plant: &Plant, params: &Params, job: &Job) -> Result<Self, LodError> {
        check_in("leaf_width_px", params.leaf_width_px, 1e-3..=1e6)?;
        check_in("half_ratio", params.half_ratio, 1.01..=1e6)?;
        check_in("shrink", params.shrink, 0.0..=1.0)?;
        let foliage = &plant.foliage;
        let leaves = Leaves::new(plant)?;
        let wood = params.wood.of(plant)?;
        let wood_count = u32::try_from(plant.wood.triangles.len()).expect("checked by the plant");
        let leaf_count = foliage.leaf_count();
        // sorted random numbers, the lower index first among equals
        let mut order: Vec<(u64, usize)> = job.collect(leaf_count, |leaf| {
            (Stream::new(params.seed, ORDER, leaf as u64).next_u64(), leaf)
        })?;
        order.par_sort_unstable();
        job.check()?;
        let mut runs: Vec<Run> = Vec::new();
        let mut vertices: Vec<u32> = Vec::new();
        let mut corners = vec![[0_u32; 3]; foliage.mesh.triangles.len()];
        // where in `vertices` a vertex was put last
        let mut last_put = vec![u32::MAX; foliage.mesh.positions.len()];
        for (number, &(_, leaf)) in order.iter().enumerate() {
            if number.is_multiple_of(ELEMENTS_PER_CHECK) {
                job.check()?;
            }
            let place = number as f64 / leaf_count as f64;
            let triangles = foliage.triangles_of(leaf);
            let center = foliage.centers[leaf].as_dvec3();
            let mut start = triangles.start;
            while start < triangles.end {
                let material = leaves.materials[start];
                let alike = (start..triangles.end).take_while(|&t| leaves.materials[t] == material);
                let end = start + alike.count();
                let first = u32::try_from(vertices.len()).expect("as many as corners at most");
                for (triangle, local) in (start..end).zip(&mut corners[start..end]) {
                    *local = foliage.mesh.triangles[triangle].map(|vertex| {
                        let put = last_put[vertex as usize];
                        if put == u32::MAX || put < first {
                            let at = u32::try_from(vertices.len()).expect("as many as corners");
                            last_put[vertex as usize] = at;
                            vertices.push(vertex);
                            return at - first;
                        }
                        put - first
                    });
                }
                let [from, to, last] = [start, end, vertices.len()]
                    .map(|at| u32::try_from(at).expect("checked by the plant"));
                let at = runs.iter().position(|run| run.material == material);
                let at = at.unwrap_or_else(|| {
                    runs.push(Run { material, leaves: Vec::new() });
                    runs.len() - 1
                });
                runs[at].leaves.push(Leaf {
                    place,
                    center,
                    triangles: from..to,
                    vertices: first..last,
                });
                start = end;
            }
        }
        runs.sort_by_key(|run| run.material);
        let mesh = &foliage.mesh;
        let area: f64 = foliage.areas.iter().map(|&area| f64::from(area)).sum();
        let mean = |colors: &[Vec3]| {
            let sum: DVec3 =
                mesh.triangles.iter().flatten().map(|&v| colors[v as usize].as_dvec3()).sum();
            (sum / (3 * mesh.triangles.len()) as f64).as_vec3()
        };
        job.check()?;
        let solid = Solid::new(
            &[(&wood, Buffers::ids_from(0, &wood))],
            &plant.materials,
            Filter::Bilinear,
            job,
        )?;
        let leaf_width = (area / leaf_count as f64).sqrt();
        let boxes = || [mesh, &wood].into_iter().filter_map(Mesh::bounds);
        let (low, high) = boxes()
            .map(|(low, high)| (low.as_dvec3(), high.as_dvec3()))
            .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
            .expect("there are leaves");
        let vertices_of = |leaf: usize| foliage.triangles_of(leaf).flat_map(|t| mesh.corners(t));
        let reaches = job.collect(leaf_count, |leaf| {
            let center = foliage.centers[leaf].as_dvec3();
            vertices_of(leaf).map(|p| p.as_dvec3().distance(center)).fold(0.0, f64::max)
        })?;
        let leaf_reach = reaches.into_iter().fold(0.0, f64::max);
        job.check()?;
        let built = Built {
            geometry: Geometry::new(Buffers::from_mesh(mesh, Buffers::ids_from(wood_count, mesh))),
            materials: ready_to_draw(&plant.materials, Filter::Bilinear, job)?,
            runs,
            vertices,
            corners,
            solid,
            params: params.clone(),
            leaf_count,
            leaf_width,
            mean_color: (mean(&mesh.front) + mean(&mesh.back)) * 0.5,
            center: leaves.center,
            leaf_reach,
            bounds: (low, high),
            foot: foot_of(boxes()),
            origin: plant.origin,
        };
        Ok(Self { built: Arc::new(built), fixed: None })
    }

    /// The same with a fixed share of the leaves.
    ///
    /// # Errors
    /// A share that is not in [1e-9, 1].
    pub fn at(&self, kept_share: f64) -> Result<Self, LodError> {
        check_in("kept_share", kept_share, 1e-9..=1.0)?;
        Ok(Self { built: Arc::clone(&self.built), fixed: Some(kept_share) })
    }

    /// How the leaves are drawn for a view of the plant where its file put it.
    pub fn level(&self, view: &View) -> Level {
        let world_from_local = glam::DAffine3::from_translation(self.built.origin);
        self.choose(view, &Crown { distance: 1.0, ..Crown::alone(world_from_local) })
    }

    fn choose(&self, view: &View, crown: &Crown) -> Level {
        let Built { params, leaf_width, center, leaf_count, .. } = &*self.built;
        let scale = crown.scale();
        let distance = crown.world_from_local.transform_point3(*center).distance(view.eye);
        let width_px = leaf_width * scale / view.pixel_size_at(distance.max(view.near));
        let of_view = || kept_share(params.leaf_width_px / width_px, params.half_ratio);
        // leaves without area are as far as can be; one leaf is left at least
        let share = self.fixed.unwrap_or_else(of_view).max(1.0 / *leaf_count as f64);
        let area_px = if params.contrast { width_px * width_px } else { 0.0 };
        Level::new(share, params.shrink, area_px)
    }

    /// Appends the leaves that are left, in their size, to this frame's own buffers; for each material
    /// the range of its triangles.
    fn append(&self, level: &Level, own: &mut OwnBuffers) -> Vec<(u32, Range<u32>)> {
        let Built { geometry, runs, vertices, corners, mean_color, .. } = &*self.built;
        let shared = geometry.buffers();
        let to = &mut own.buffers;
        #[expect(clippy::cast_possible_truncation, reason = "sizes and colours in f32")]
        let contrast = level.contrast as f32;
        let colored = |color: Vec3| {
            // exact where nothing changes
            if contrast == 1.0 { color } else { *mean_color + (color - *mean_color) * contrast }
        };
        let mut ranges = Vec::new();
        for run in runs {
            let start = to.indices.len() / 3;
            let end = run.leaves.partition_point(|leaf| leaf.place < level.kept_share);
            for leaf in &run.leaves[..end] {
                #[expect(clippy::cast_possible_truncation, reason = "sizes and colours in f32")]
                let scale = level.area_factor(leaf.place).sqrt() as f32;
                let center = leaf.center.as_vec3();
                let first = u32::try_from(to.positions.len()).expect("fits in u32");
                for &vertex in &vertices[leaf.vertices.start as usize..leaf.vertices.end as usize] {
                    let from = vertex as usize;
                    let position = shared.positions[from];
                    let moved = center + (position - center) * scale;
                    to.positions.push(if scale == 1.0 { position } else { moved });
                    to.normals.push(shared.normals[from]);
                    to.uvs.push(shared.uvs[from]);
                    to.base.push(shared.base[from]);
                    to.front.push(colored(shared.front[from]));
                    to.back.push(colored(shared.back[from]));
                }
                let triangles = leaf.triangles.start as usize..leaf.triangles.end as usize;
                to.indices.extend(corners[triangles.clone()].iter().flatten().map(|c| first + c));
                to.source_ids.extend_from_slice(&shared.source_ids[triangles]);
            }
            let range = [start, to.indices.len() / 3];
            let [start, end] = range.map(|at| u32::try_from(at).expect("fits in u32"));
            if start < end {
                ranges.push((run.material, start..end));
            }
        }
        ranges
    }

    fn emit_crown(&self, view: &View, crown: &Crown, builder: &mut ListBuilder) {
        let level = self.choose(view, crown);
        let instance = Instance { seed: crown.key.1, ..crown.instance(view) };
        let instances = builder.list.instance(instance);
        let (vertex, index) =
            (builder.list.own.buffers.positions.len(), builder.list.own.buffers.indices.len());
        let ranges = self.append(&level, &mut builder.list.own);
        let own = &mut builder.list.own;
        let ends = [vertex, own.buffers.positions.len(), index, own.buffers.indices.len()];
        let [v0, v1, i0, i1] = ends.map(|at| u32::try_from(at).expect("fits in u32"));
        own.dirty_vertices.push(v0..v1);
        own.dirty_indices.push(i0..i1);
        for (material, primitives) in ranges {
            let material = &self.built.materials[material as usize];
            let blend = blend_of(material);
            if blend == Blend::Over {
                sort_far_to_near(&mut builder.list.own.buffers, primitives.clone(), view, crown);
            }
            let surface = surface_of(material, &mut builder.list);
            let item = Item {
                primitive: Primitive::Triangles,
                vertices: Source::Own,
                indices: Source::Own,
                primitives,
                instances: instances.clone(),
                surface,
                blend,
                depth_write: blend != Blend::Over,
                slab: None,
            };
            if blend == Blend::Over {
                builder.push_blended(crown, item);
            } else {
                builder.list.items.push(item);
            }
        }
    }
}

/// Sorts triangles by the distance of their centroids; equal ones by their ids.
fn sort_far_to_near(buffers: &mut Buffers, triangles: Range<u32>, view: &View, crown: &Crown) {
    let range = triangles.start as usize..triangles.end as usize;
    let mut keyed: Vec<(f64, u32, [u32; 3])> = range
        .clone()
        .map(|t| {
            let corners = [0, 1, 2].map(|c| buffers.indices[t * 3 + c]);
            let sum: DVec3 =
                corners.iter().map(|&v| buffers.positions[v as usize].as_dvec3()).sum();
            let world = crown.world_from_local.transform_point3(sum / 3.0);
            let distance = if view.is_orthographic() {
                view.view_from_world(world).z
            } else {
                world.distance_squared(view.eye)
            };
            (distance, buffers.source_ids[t], corners)
        })
        .collect();
    keyed.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    for (t, (_, id, corners)) in range.zip(keyed) {
        buffers.indices[t * 3..t * 3 + 3].copy_from_slice(&corners);
        buffers.source_ids[t] = id;
    }
}

impl Representation for StochasticPruning {
    fn bounds(&self) -> (DVec3, DVec3) {
        let Built { bounds: (low, high), leaf_reach, leaf_count, params, .. } = &*self.built;
        if self.fixed.is_none() && params.half_ratio >= SQRT_2 {
            // leaves that grow as they become fewer: `margin_px` says how far
            return (*low, *high);
        }
        // of the largest leaves that the fixed share, or any view, has left
        let share = self.fixed.unwrap_or(0.0).max(1.0 / *leaf_count as f64);
        let largest = Level::new(share, params.shrink, 0.0).area_factor(0.0).sqrt();
        let reach = leaf_reach * (largest - 1.0).max(0.0);
        (*low - reach, *high + reach)
    }

    fn margin_px(&self) -> f64 {
        let Built { leaf_reach, leaf_width, params, .. } = &*self.built;
        if self.fixed.is_some() || params.half_ratio < SQRT_2 || *leaf_width <= 0.0 {
            return 0.0;
        }
        // at z times the distance at which pruning begins leaves are 1/z as wide and, for they are
        // z^(-log_h 2) as many, z^(log_h 2 / 2) <= z times as large; twice the area while some shrink
        SQRT_2 * params.leaf_width_px * leaf_reach / leaf_width
    }

    fn foot(&self) -> DVec3 {
        self.built.foot
    }

    fn origin(&self) -> DVec3 {
        self.built.origin
    }

    fn footprint(&self) -> Footprint {
        let Built { geometry, runs, vertices, corners, solid, .. } = &*self.built;
        let wood = solid.footprint();
        let leaves = geometry.buffers();
        let leaf_bytes: usize = runs.iter().map(|run| size_of_val(&run.leaves[..])).sum();
        let tables = leaf_bytes + size_of_val(&vertices[..]) + size_of_val(&corners[..]);
        let textures = self.textures();
        Footprint {
            triangle_count: wood.triangle_count + (leaves.indices.len() / 3) as u64,
            geometry_bytes: wood.geometry_bytes + leaves.byte_count() + tables as u64,
            texture_bytes: textures.iter().map(|named| named.texture.byte_count()).sum(),
            ..wood
        }
    }

    fn textures(&self) -> Vec<NamedTexture> {
        let mut named = self.built.solid.textures();
        let leaves = self.built.runs.iter().map(|run| run.material);
        for found in textures_of(&self.built.materials, leaves) {
            // wood and leaves read a shared material's texture by copies that are equal
            if !named.iter().any(|known| known.name == found.name) {
                named.push(found);
            }
        }
        named
    }

    fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        self.built.solid.emit(view, crowns, state, builder);
        for crown in crowns.iter().rev() {
            self.emit_crown(view, crown, builder);
        }
        Ok(())
    }
}
