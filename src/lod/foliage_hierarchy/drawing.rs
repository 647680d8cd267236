//! Drawing nodes of the forest: a quad for each, in the material of the leaf whose texture it has.
//!
//! The vertices of all nodes are shared by all frames; a frame's own buffers hold the indices of the
//! active ones, material by material. Quads of a blended material come after the others, far to near.

use std::sync::Arc;

use glam::DVec3;

use crate::draw_list::{Blend, Buffers, Geometry, Item, Primitive, Source};
use crate::error::LodError;
use crate::job::{ELEMENTS_PER_CHECK, Job};
use crate::lod::foliage_hierarchy::forest::Forest;
use crate::lod::foliage_hierarchy::leaf_quads::LeafQuad;
use crate::lod::foliage_hierarchy::quad::measure;
use crate::lod::solid::{blend_of, surface_of, textures_of};
use crate::lod::{Crown, ListBuilder, NamedTexture};
use crate::plant::Material;
use crate::view::View;

/// Corners of a quad's two triangles.
pub(super) const CORNERS: [u32; 6] = [0, 1, 2, 0, 2, 3];

/// The vertices of all nodes, four each, before they are frozen for drawing.
#[derive(Debug)]
pub(super) struct NodeVertices {
    /// All but positions, which [`NodeVertices::freeze`] adds.
    pub(super) buffers: Buffers,
    /// Ready to be drawn.
    pub(super) materials: Vec<Material>,
    /// Material of each leaf of the plant.
    leaf_materials: Vec<u32>,
    /// Materials in use, blended ones last.
    pub(super) paint_order: Vec<u32>,
    /// What the "ids" output shows for each leaf: its first triangle, and how many it has, up to 2.
    leaf_ids: Vec<[u32; 2]>,
}

impl NodeVertices {
    /// Vertices of all nodes of a forest that was made of `quads`.
    ///
    /// `materials` are ready to be drawn. `first_id` is the id of the foliage's first triangle; leaf `i` has `triangle_counts[i]` of them.
    pub(super) fn new(
        forest: &Forest,
        quads: &[LeafQuad],
        triangle_counts: impl Iterator<Item = u32>,
        first_id: u32,
        materials: Vec<Material>,
        job: &Job,
    ) -> Result<Self, LodError> {
        let count = forest.nodes.len() * 4;
        let mut buffers = Buffers {
            normals: Vec::with_capacity(count),
            uvs: Vec::with_capacity(count),
            base: Vec::with_capacity(count),
            front: Vec::with_capacity(count),
            back: Vec::with_capacity(count),
            ..Buffers::default()
        };
        let normals: Vec<DVec3> = quads
            .iter()
            .map(|quad| measure(&quad.corners.map(|corner| corner.as_dvec3())).normal)
            .collect();
        for (node, record) in (0_u32..).zip(&forest.nodes) {
            if (node as usize).is_multiple_of(ELEMENTS_PER_CHECK) {
                job.check()?;
            }
            let normal = measure(&forest.quad(node)).normal;
            let source = forest.corners[node as usize];
            let uvs = &quads[source.leaf as usize].uvs;
            for (corner, vertex) in record.vertices.into_iter().enumerate() {
                let (leaf, own) = ((vertex / 4) as usize, (vertex % 4) as usize);
                let quad = &quads[leaf];
                // a leaf that faces the other way was lit with its sides swapped
                let is_turned = normals[leaf].dot(normal) < 0.0;
                let (front, back) = (quad.front[own], quad.back[own]);
                let (front, back) = if is_turned { (back, front) } else { (front, back) };
                buffers.normals.push(if is_turned {
                    -quad.normals[own]
                } else {
                    quad.normals[own]
                });
                buffers.uvs.push(uvs[source.corner(corner)]);
                buffers.base.push(quad.base[own]);
                buffers.front.push(front);
                buffers.back.push(back);
            }
        }
        let leaf_materials: Vec<u32> = quads.iter().map(|quad| quad.material).collect();
        let mut paint_order = leaf_materials.clone();
        paint_order.sort_unstable();
        paint_order.dedup();
        let is_blended = |id: &u32| blend_of(&materials[*id as usize]) == Blend::Over;
        paint_order.sort_by_key(is_blended);
        let ids = quads.iter().zip(triangle_counts);
        Ok(Self {
            buffers,
            materials,
            leaf_materials,
            paint_order,
            leaf_ids: ids.map(|(quad, count)| [first_id + quad.triangle, count.min(2)]).collect(),
        })
    }

    /// Material of a node.
    pub(super) fn material_of(&self, forest: &Forest, node: u32) -> u32 {
        self.leaf_materials[forest.corners[node as usize].leaf as usize]
    }

    /// Puts every node where the forest draws it.
    pub(super) fn freeze(mut self, forest: &Forest, job: &Job) -> Result<Quads, LodError> {
        let mut positions = Vec::with_capacity(self.buffers.uvs.len());
        for node in 0..u32::try_from(forest.nodes.len()).expect("checked when it was made") {
            if (node as usize).is_multiple_of(ELEMENTS_PER_CHECK) {
                job.check()?;
            }
            positions.extend(forest.drawn_quad(node).map(|corner| corner.as_vec3()));
        }
        self.buffers.positions = positions;
        let geometry = Geometry::new(std::mem::take(&mut self.buffers));
        Ok(Quads { geometry, nodes: self })
    }
}

/// The quads of all nodes, ready to be drawn.
#[derive(Debug)]
pub(super) struct Quads {
    geometry: Arc<Geometry>,
    nodes: NodeVertices,
}

impl Quads {
    /// Unique in this process.
    pub(super) fn id(&self) -> u64 {
        self.geometry.id()
    }

    /// The box around the quads of the first nodes, relative to the plant's origin.
    pub(super) fn bounds(&self, node_count: usize) -> (DVec3, DVec3) {
        let corners = &self.geometry.buffers().positions[..node_count * 4];
        let corners = corners.iter().map(|p| p.as_dvec3());
        corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), corner| {
            (low.min(corner), high.max(corner))
        })
    }

    /// Bytes of the vertices of all nodes, and of six indices for each leaf: the longest list.
    pub(super) fn byte_count(&self) -> u64 {
        let indices = self.nodes.leaf_materials.len() * CORNERS.len() * size_of::<u32>();
        self.geometry.buffers().byte_count() + indices as u64
    }

    /// The textures that leaves use.
    pub(super) fn textures(&self) -> Vec<NamedTexture> {
        textures_of(&self.nodes.materials, self.nodes.paint_order.iter().copied())
    }

    /// Appends some nodes for one copy.
    pub(super) fn emit(
        &self,
        forest: &Forest,
        nodes: &[u32],
        view: &View,
        crown: &Crown,
        builder: &mut ListBuilder,
    ) {
        if nodes.is_empty() {
            return;
        }
        let instances = builder.list.instance(crown.instance(view));
        for &material_id in &self.nodes.paint_order {
            let material = &self.nodes.materials[material_id as usize];
            let blend = blend_of(material);
            let of_material = |node: &u32| self.nodes.material_of(forest, *node) == material_id;
            let start = triangle_count(builder);
            if blend == Blend::Over {
                let mut sorted: Vec<(f64, u32)> = nodes
                    .iter()
                    .copied()
                    .filter(of_material)
                    .map(|node| (distance(forest, node, view, crown), node))
                    .collect();
                sorted.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
                self.push(forest, sorted.into_iter().map(|(_, node)| node), builder);
            } else if self.nodes.paint_order.len() == 1 {
                self.push(forest, nodes.iter().copied(), builder);
            } else {
                self.push(forest, nodes.iter().copied().filter(of_material), builder);
            }
            let end = triangle_count(builder);
            if start == end {
                continue;
            }
            builder.list.own.dirty_indices.push(start * 3..end * 3);
            let item = Item {
                primitive: Primitive::Triangles,
                vertices: builder.list.geometry(&self.geometry),
                indices: Source::Own,
                primitives: start..end,
                instances: instances.clone(),
                surface: surface_of(material, &mut builder.list),
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

    /// Appends the indices of some nodes and the ids of their triangles.
    fn push(&self, forest: &Forest, nodes: impl Iterator<Item = u32>, builder: &mut ListBuilder) {
        let own = &mut builder.list.own.buffers;
        for node in nodes {
            own.indices.extend(CORNERS.map(|corner| node * 4 + corner));
            let [first, count] = self.nodes.leaf_ids[forest.corners[node as usize].leaf as usize];
            own.source_ids.extend([first, first + count - 1]);
        }
    }
}

fn triangle_count(builder: &ListBuilder) -> u32 {
    u32::try_from(builder.list.own.buffers.indices.len() / 3).expect("fits in u32")
}

/// What far comes before near by: as for the triangles of a mesh.
fn distance(forest: &Forest, node: u32, view: &View, crown: &Crown) -> f64 {
    let center = measure(&forest.drawn_quad(node)).center;
    let world = crown.world_from_local.transform_point3(center);
    if view.is_orthographic() {
        view.view_from_world(world).z
    } else {
        world.distance_squared(view.eye)
    }
}
