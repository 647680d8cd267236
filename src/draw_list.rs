//! What a representation hands to a renderer: shared buffers, instances, and items in paint order.
//!
//! Geometry and textures are immutable, shared and carry ids, so a renderer can keep its own copies
//! between frames. What belongs to one frame alone is in [`DrawList::own`].

pub mod signature;

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DAffine3, Mat3, Vec2, Vec3, Vec4};

use crate::error::LodError;
use crate::plant::Mesh;
use crate::texture::{Distribution, Frames, Sampler, Texture};
use crate::view::View;

/// Largest width of a line and side of a point: that of the largest picture.
pub const MAX_SIZE_PX: f32 = 16384.0;

/// Vertex arrays of one length, and the indices of a kind of primitive into them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Buffers {
    /// In the space that an instance's transform maps to the eye.
    pub positions: Vec<Vec3>,
    /// Unit length or zero.
    pub normals: Vec<Vec3>,
    /// v = 0 is a texture's top row.
    pub uvs: Vec<Vec2>,
    /// Linear unlit colour with opacity as straight alpha.
    pub base: Vec<Vec4>,
    /// Linear lit colour of the counter-clockwise side.
    pub front: Vec<Vec3>,
    /// Linear lit colour of the other side.
    pub back: Vec<Vec3>,
    /// 3 a triangle, 4 a card (around its edge), 2 a line, 1 a point.
    pub indices: Vec<u32>,
    /// What the "ids" output shows for each primitive; empty means the primitive's own index.
    pub source_ids: Vec<u32>,
}

impl Buffers {
    /// Ids of a mesh's triangles that count on from its first one's.
    pub fn ids_from(first_id: u32, mesh: &Mesh) -> Vec<u32> {
        let triangle_count = u32::try_from(mesh.triangles.len()).expect("checked by Mesh::check");
        (first_id..first_id + triangle_count).collect()
    }

    /// The triangles of a mesh, with an id for each.
    pub fn from_mesh(mesh: &Mesh, source_ids: Vec<u32>) -> Self {
        assert_eq!(source_ids.len(), mesh.triangles.len(), "one id a triangle");
        Self {
            positions: mesh.positions.clone(),
            normals: mesh.normals.clone(),
            uvs: mesh.uvs.clone(),
            base: mesh.base.clone(),
            front: mesh.front.clone(),
            back: mesh.back.clone(),
            indices: mesh.triangles.iter().flatten().copied().collect(),
            source_ids,
        }
    }

    /// Appends other buffers, whose vertices then start at `first_vertex`.
    pub fn append(&mut self, other: Self, first_vertex: u32) {
        self.positions.extend(other.positions);
        self.normals.extend(other.normals);
        self.uvs.extend(other.uvs);
        self.base.extend(other.base);
        self.front.extend(other.front);
        self.back.extend(other.back);
        self.indices.extend(other.indices.into_iter().map(|vertex| vertex + first_vertex));
        self.source_ids.extend(other.source_ids);
    }

    /// Bytes a renderer must hold to draw these buffers.
    pub fn byte_count(&self) -> u64 {
        let vertex = size_of::<Vec3>() * 4 + size_of::<Vec2>() + size_of::<Vec4>();
        (self.positions.len() * vertex + self.indices.len() * size_of::<u32>()) as u64
    }
}

/// Immutable buffers with an id that no others of this process have.
#[derive(Debug)]
pub struct Geometry {
    id: u64,
    buffers: Buffers,
}

impl Geometry {
    /// Freezes the buffers.
    pub fn new(buffers: Buffers) -> Arc<Self> {
        static NEXT_ID: AtomicU64 = AtomicU64::new(0);
        Arc::new(Self { id: NEXT_ID.fetch_add(1, Ordering::Relaxed), buffers })
    }

    /// Unique in this process; the cache key of a renderer.
    pub fn id(&self) -> u64 {
        self.id
    }

    /// The arrays.
    pub fn buffers(&self) -> &Buffers {
        &self.buffers
    }
}

/// How the indices of an item form shapes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Primitive {
    /// Three indices each.
    Triangles,
    /// Textured quads, four indices each, drawn as triangles (0, 1, 2) and (0, 2, 3).
    Cards,
    /// Rectangles with butt ends, two indices each.
    Lines {
        /// Pixels across.
        width_px: f32,
    },
    /// Axis-aligned squares, one index each.
    Points {
        /// Pixels a side.
        size_px: f32,
    },
}

impl Primitive {
    /// Indices that one primitive takes.
    pub fn index_count(self) -> usize {
        match self {
            Self::Triangles => 3,
            Self::Cards => 4,
            Self::Lines { .. } => 2,
            Self::Points { .. } => 1,
        }
    }
}

/// What gives a fragment its colour. Renderers know these and nothing else.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Surface {
    /// The lit colour of the side seen.
    VertexColor,
    /// The lit colour of the side seen times a texel; alpha is the vertex opacity times the texel's.
    Textured {
        /// Index into [`DrawList::textures`].
        texture: u32,
        /// How it is read.
        sampler: Sampler,
    },
    /// As `Textured`, but the texture coordinate is looked up in a distribution, which says which
    /// point of a texture of turned leaves is there, and its tint.
    Indirect {
        /// Index into [`DrawList::distributions`].
        distribution: u32,
        /// Index into [`DrawList::textures`]: the turned leaves.
        leaves: u32,
        /// How the leaves are read.
        sampler: Sampler,
    },
    /// What a ray from the eye meets in up to three pictures with depth; where the shape lies only says
    /// which rays are followed. Depth is that of what is met. The instance's first three parameters
    /// are the pictures' numbers, the next three their weights.
    Parallax {
        /// Index into [`DrawList::frames`].
        frames: u32,
        /// How often the stored depth moves the point that is read.
        step_count: u32,
        /// How far the depth there may be from the ray's for a picture to count half, in shares of the
        /// frames' reach; infinite: all count alike.
        tolerance: f32,
        /// How the pictures are read.
        sampler: Sampler,
    },
}

/// How a fragment joins what is already there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Blend {
    /// Replaces what lies behind; alpha is ignored.
    Opaque,
    /// As opaque where alpha is at least the cutoff, nothing elsewhere.
    Test(f32),
    /// As opaque in as many of a pixel's samples as alpha asks for. Which samples those are depends on
    /// the instance's seed and the primitive's source id, so that shapes of equal alpha do not hide
    /// one another. With one sample it is a test at one half.
    Coverage,
    /// `source + (1 - source alpha) * destination`, premultiplied, in paint order.
    Over,
}

/// Where an item's vertices or indices come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// Index into [`DrawList::geometries`].
    Shared(u32),
    /// [`DrawList::own`].
    Own,
}

/// One placed copy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instance {
    /// World axes relative to the eye, from the buffers' space: linear part.
    pub linear: Mat3,
    /// World axes relative to the eye, from the buffers' space: offset.
    pub translation: Vec3,
    /// Multiplies colour (rgb) and opacity (a).
    pub tint: Vec4,
    /// Share of samples drawn in a fixed dither pattern; negative draws the complementary samples.
    pub fade: f32,
    /// Shifts the dither pattern.
    pub seed: u32,
    /// For surfaces that need more.
    pub params: [f32; 8],
}

impl Instance {
    /// A copy placed by `world_from_local`, which is composed with the eye in f64.
    pub fn new(world_from_local: &DAffine3, view: &View) -> Self {
        Self {
            linear: world_from_local.matrix3.as_mat3(),
            translation: (world_from_local.translation - view.eye).as_vec3(),
            tint: Vec4::ONE,
            fade: 1.0,
            seed: 0,
            params: [0.0; 8],
        }
    }

    /// The only copy of what is relative to the eye already.
    pub fn at_eye() -> Self {
        Self {
            linear: Mat3::IDENTITY,
            translation: Vec3::ZERO,
            tint: Vec4::ONE,
            fade: 1.0,
            seed: 0,
            params: [0.0; 8],
        }
    }
}

/// Primitives of one kind and state, drawn for each of some instances.
#[derive(Debug, Clone, PartialEq)]
pub struct Item {
    /// Kind of shape.
    pub primitive: Primitive,
    /// Where the vertices are.
    pub vertices: Source,
    /// Where the indices are: with the vertices, or this frame's own.
    pub indices: Source,
    /// Which primitives, counted in the index buffer; a prefix is a range.
    pub primitives: Range<u32>,
    /// Which of [`DrawList::instances`], each drawn in turn.
    pub instances: Range<u32>,
    /// What it looks like.
    pub surface: Surface,
    /// How it joins the picture.
    pub blend: Blend,
    /// Whether later fragments behind it are hidden.
    pub depth_write: bool,
    /// Keeps only fragments at depths from the first to before the second, in metres.
    pub slab: Option<[f32; 2]>,
}

/// Buffers of this frame alone, with what changed in them since the frame before.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct OwnBuffers {
    /// The arrays.
    pub buffers: Buffers,
    /// Vertices that differ from the last frame of the same view state.
    pub dirty_vertices: Vec<Range<u32>>,
    /// Indices that differ from the last frame of the same view state.
    pub dirty_indices: Vec<Range<u32>>,
}

/// Everything needed to draw one picture.
#[derive(Debug, Clone, Default)]
pub struct DrawList {
    /// Shared vertex and index buffers.
    pub geometries: Vec<Arc<Geometry>>,
    /// Shared textures.
    pub textures: Vec<Arc<Texture>>,
    /// Shared maps of where leaves lie.
    pub distributions: Vec<Arc<Distribution>>,
    /// Shared pictures with depth.
    pub frames: Vec<Arc<Frames>>,
    /// This frame's own vertices and indices.
    pub own: OwnBuffers,
    /// Placed copies.
    pub instances: Vec<Instance>,
    /// In paint order.
    pub items: Vec<Item>,
}

impl DrawList {
    /// Adds a shared geometry unless it is there, and says where it is.
    pub fn geometry(&mut self, geometry: &Arc<Geometry>) -> Source {
        let known = self.geometries.iter().position(|g| g.id() == geometry.id());
        let index = known.unwrap_or_else(|| {
            self.geometries.push(Arc::clone(geometry));
            self.geometries.len() - 1
        });
        Source::Shared(u32::try_from(index).expect("few geometries"))
    }

    /// Adds a shared texture unless it is there, and gives its index.
    pub fn texture(&mut self, texture: &Arc<Texture>) -> u32 {
        let known = self.textures.iter().position(|t| t.id() == texture.id());
        let index = known.unwrap_or_else(|| {
            self.textures.push(Arc::clone(texture));
            self.textures.len() - 1
        });
        u32::try_from(index).expect("few textures")
    }

    /// Adds a shared distribution unless it is there, and gives its index.
    pub fn distribution(&mut self, distribution: &Arc<Distribution>) -> u32 {
        let known = self.distributions.iter().position(|d| d.id() == distribution.id());
        let index = known.unwrap_or_else(|| {
            self.distributions.push(Arc::clone(distribution));
            self.distributions.len() - 1
        });
        u32::try_from(index).expect("few distributions")
    }

    /// Adds shared frames unless they are there, and gives their index.
    pub fn frames(&mut self, frames: &Arc<Frames>) -> u32 {
        let known = self.frames.iter().position(|f| f.id() == frames.id());
        let index = known.unwrap_or_else(|| {
            self.frames.push(Arc::clone(frames));
            self.frames.len() - 1
        });
        u32::try_from(index).expect("few of them")
    }

    /// Adds an instance and gives the range that holds it alone.
    pub fn instance(&mut self, instance: Instance) -> Range<u32> {
        let index = u32::try_from(self.instances.len()).expect("under 2^32 instances");
        self.instances.push(instance);
        index..index + 1
    }

    /// Vertex arrays of an item.
    pub fn vertices_of(&self, item: &Item) -> &Buffers {
        self.buffers(item.vertices)
    }

    /// Index array of an item and the ids of its primitives.
    pub fn indices_of(&self, item: &Item) -> &Buffers {
        self.buffers(item.indices)
    }

    fn buffers(&self, source: Source) -> &Buffers {
        match source {
            Source::Shared(index) => self.geometries[index as usize].buffers(),
            Source::Own => &self.own.buffers,
        }
    }

    /// Checks that every range and index is inside its array.
    ///
    /// # Errors
    /// [`LodError::Invalid`] with the first item that is not.
    pub fn check(&self) -> Result<(), LodError> {
        let wrong = |item: usize, what: String| LodError::Invalid {
            name: "draw list",
            why: format!("item {item}: {what}"),
        };
        for (number, item) in self.items.iter().enumerate() {
            for source in [item.vertices, item.indices] {
                if let Source::Shared(index) = source
                    && index as usize >= self.geometries.len()
                {
                    return Err(wrong(number, format!("no geometry {index}")));
                }
            }
            if let Surface::Textured { texture, .. } | Surface::Indirect { leaves: texture, .. } =
                item.surface
                && texture as usize >= self.textures.len()
            {
                return Err(wrong(number, format!("no texture {texture}")));
            }
            if let Surface::Indirect { distribution, .. } = item.surface
                && distribution as usize >= self.distributions.len()
            {
                return Err(wrong(number, format!("no distribution {distribution}")));
            }
            if let Surface::Parallax { frames, .. } = item.surface {
                if frames as usize >= self.frames.len() {
                    return Err(wrong(number, format!("no frames {frames}")));
                }
                if !matches!(item.primitive, Primitive::Triangles | Primitive::Cards) {
                    return Err(wrong(number, "frames are seen through triangles".to_owned()));
                }
            }
            if let Primitive::Lines { width_px: size } | Primitive::Points { size_px: size } =
                item.primitive
                && !(size > 0.0 && size <= MAX_SIZE_PX)
            {
                let what = format!("{size} pixels are not in (0, {MAX_SIZE_PX}]");
                return Err(wrong(number, what));
            }
            let indices = &self.indices_of(item).indices;
            let primitive_count = indices.len() / item.primitive.index_count();
            let range = &item.primitives;
            if range.start > range.end || range.end as usize > primitive_count {
                let what = format!("primitives {range:?} of {primitive_count}");
                return Err(wrong(number, what));
            }
            if item.instances.end as usize > self.instances.len() {
                let what = format!("instances {:?} of {}", item.instances, self.instances.len());
                return Err(wrong(number, what));
            }
        }
        Ok(())
    }
}
