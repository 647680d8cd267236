//! Triangles drawn as they are: the full mesh, and the part of other techniques that stays a mesh.
//!
//! Opaque and alpha-tested triangles are drawn for all copies at once. Blended ones come after them,
//! far to near by centroid, copy by copy.

use std::ops::Range;
use std::sync::Arc;

use glam::DVec3;

use crate::draw_list::{Blend, Buffers, Geometry, Item, Primitive, Source, Surface};
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture};
use crate::plant::{AlphaMode, Material, Mesh};
use crate::texture::{Filter, Sampler};
use crate::view::View;
use crate::view_state::ViewState;

/// Consecutive triangles of one material.
#[derive(Debug, Clone)]
struct Run {
    material: u32,
    triangles: Range<u32>,
}

/// Triangles with their materials.
#[derive(Debug, Clone)]
pub struct Solid {
    geometry: Arc<Geometry>,
    materials: Vec<Material>,
    runs: Vec<Run>,
    /// Material and centroid of each blended triangle, by triangle index.
    blended: Vec<(u32, u32, DVec3)>,
}

/// How a material's fragments join the picture.
pub fn blend_of(material: &Material) -> Blend {
    match material.alpha_mode {
        AlphaMode::Opaque => Blend::Opaque,
        AlphaMode::Mask { cutoff } => Blend::Test(cutoff),
        AlphaMode::Blend => Blend::Over,
    }
}

impl Solid {
    /// Takes meshes over, in order; `first_ids` are the ids of each one's first triangle.
    pub fn new(meshes: &[(&Mesh, u32)], materials: &[Material], filter: Filter) -> Self {
        let mut buffers = Buffers::default();
        let mut runs: Vec<Run> = Vec::new();
        let mut blended = Vec::new();
        for &(mesh, first_id) in meshes {
            let first_vertex =
                u32::try_from(buffers.positions.len()).expect("checked by the plant");
            let first_triangle =
                u32::try_from(buffers.indices.len() / 3).expect("checked by the plant");
            for part in &mesh.parts {
                let range =
                    part.triangles.start + first_triangle..part.triangles.end + first_triangle;
                if blend_of(&materials[part.material as usize]) == Blend::Over {
                    blended.extend(part.triangles.clone().map(|triangle| {
                        let corners = mesh.corners(triangle as usize).map(|p| p.as_dvec3());
                        let centroid = corners.iter().sum::<DVec3>() / 3.0;
                        (triangle + first_triangle, part.material, centroid)
                    }));
                } else {
                    runs.push(Run { material: part.material, triangles: range });
                }
            }
            buffers.append(Buffers::from_mesh(mesh, first_id), first_vertex);
        }
        let materials = materials
            .iter()
            .map(|material| Material {
                sampler: Sampler { filter, ..material.sampler },
                ..material.clone()
            })
            .collect();
        Self { geometry: Geometry::new(buffers), materials, runs, blended }
    }

    /// Whether there is nothing to draw.
    pub fn is_empty(&self) -> bool {
        self.runs.is_empty() && self.blended.is_empty()
    }

    /// Triangles, and the bytes of their vertices, indices and textures.
    pub fn footprint(&self) -> Footprint {
        let textures = self.textures();
        Footprint {
            triangle_count: (self.geometry.buffers().indices.len() / 3) as u64,
            geometry_bytes: self.geometry.buffers().byte_count(),
            texture_bytes: textures.iter().map(|named| named.texture.byte_count()).sum(),
            ..Footprint::default()
        }
    }

    /// The textures that its triangles use, each once.
    pub fn textures(&self) -> Vec<NamedTexture> {
        let used = self.runs.iter().map(|run| run.material);
        let mut indices: Vec<u32> =
            used.chain(self.blended.iter().map(|&(_, material, _)| material)).collect();
        indices.sort_unstable();
        indices.dedup();
        let mut named: Vec<NamedTexture> = Vec::new();
        for index in indices {
            let material = &self.materials[index as usize];
            if let Some(texture) = &material.texture
                && !named.iter().any(|known| known.texture.id() == texture.id())
            {
                named.push(NamedTexture {
                    name: material.name.clone(),
                    texture: Arc::clone(texture),
                    rect: None,
                });
            }
        }
        named
    }

    /// Appends the triangles for every copy.
    pub fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) {
        if self.is_empty() || crowns.is_empty() {
            return;
        }
        let source = builder.list.geometry(&self.geometry);
        let start = u32::try_from(builder.list.instances.len()).expect("under 2^32 instances");
        // near copies first, so that they hide what lies behind them
        builder.list.instances.extend(crowns.iter().rev().map(|crown| crown.instance(view)));
        let end = u32::try_from(builder.list.instances.len()).expect("under 2^32 instances");
        for run in &self.runs {
            let item = self.item(builder, source, run.material, run.triangles.clone(), start..end);
            builder.list.items.push(item);
        }
        for (crown, instance) in crowns.iter().zip((start..end).rev()) {
            self.emit_blended(view, crown, instance, source, state, builder);
        }
    }

    fn emit_blended(
        &self,
        view: &View,
        crown: &Crown,
        instance: u32,
        source: Source,
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) {
        if self.blended.is_empty() {
            return;
        }
        // the last frame's order is nearly this one's, which a stable sort finishes quickly
        let order: &mut Vec<u32> = state.slot(crown.key);
        let count = u32::try_from(self.blended.len()).expect("triangles fit in u32");
        if order.len() != self.blended.len() {
            *order = (0..count).collect();
        }
        let distance = |index: u32| {
            let world = crown.world_from_local.transform_point3(self.blended[index as usize].2);
            if view.is_orthographic() {
                view.view_from_world(world).z
            } else {
                world.distance_squared(view.eye)
            }
        };
        order.sort_by(|&a, &b| distance(b).total_cmp(&distance(a)).then(a.cmp(&b)));
        let shared = self.geometry.buffers();
        let material_of = |index: u32| self.blended[index as usize].1;
        for run in order.chunk_by(|&a, &b| material_of(a) == material_of(b)) {
            let own = &mut builder.list.own;
            let start = u32::try_from(own.buffers.indices.len() / 3).expect("fits in u32");
            for &index in run {
                let triangle = self.blended[index as usize].0 as usize;
                let corners = &shared.indices[triangle * 3..triangle * 3 + 3];
                own.buffers.indices.extend_from_slice(corners);
                own.buffers.source_ids.push(shared.source_ids[triangle]);
            }
            let end = start + u32::try_from(run.len()).expect("fits in u32");
            own.dirty_indices.push(start * 3..end * 3);
            let instances = instance..instance + 1;
            let item = self.item(builder, source, material_of(run[0]), start..end, instances);
            builder.push_blended(crown, Item { indices: Source::Own, ..item });
        }
    }

    fn item(
        &self,
        builder: &mut ListBuilder,
        source: Source,
        material: u32,
        primitives: Range<u32>,
        instances: Range<u32>,
    ) -> Item {
        let material = &self.materials[material as usize];
        let blend = blend_of(material);
        let surface = material.texture.as_ref().map_or(Surface::VertexColor, |texture| {
            Surface::Textured { texture: builder.list.texture(texture), sampler: material.sampler }
        });
        Item {
            primitive: Primitive::Triangles,
            vertices: source,
            indices: source,
            primitives,
            instances,
            surface,
            blend,
            depth_write: blend != Blend::Over,
            slab: None,
        }
    }
}
