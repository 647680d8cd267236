//! What lists share, on the graphics card: uploaded when it is first drawn, kept as long as it is used.
//!
//! Entries are found by the ids that buffers and textures have in this process, and dropped when nothing
//! else holds what they were made from. Texels are stored premultiplied and linear as halves, so that the
//! card's own filter does what filtering here means; that rounds a texel by at most 2^-12 of itself, or by 2^-25 where it is nearly black.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::ops::Range;
use std::sync::{Arc, Weak};

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};
use half::f16;
use wgpu::{
    AddressMode, BindGroup, BindGroupDescriptor, BindGroupEntry, BindGroupLayout, BindingResource,
    Buffer, BufferDescriptor, BufferUsages, Extent3d, FilterMode, MipmapFilterMode, Origin3d,
    SamplerDescriptor, TexelCopyBufferLayout, TexelCopyTextureInfo, TextureAspect,
    TextureDescriptor, TextureDimension, TextureFormat, TextureUsages, TextureView,
};

use crate::draw_list::{Buffers, DrawList, Geometry, OwnBuffers, Source};
use crate::error::{LodError, check_limit};
use crate::gpu::device::Gpu;
use crate::gpu::packing::{PATTERN_QUADS, Reads, bounds_of};
use crate::gpu::pipelines::Pipelines;
use crate::job::Job;
use crate::texture::frames::Relit;
use crate::texture::texture::decode;
use crate::texture::{Distribution, Filter, Frames, Image, Sampler, Texture, Wrap};

/// Bytes that are handed over at once.
const CHUNK_BYTES: usize = 1 << 22;

/// Something on the card, and what it was made from.
#[derive(Debug)]
struct Kept<S, T> {
    source: Weak<S>,
    made: T,
}

type Cache<S, T> = HashMap<u64, Kept<S, T>>;

fn sweep<S, T>(cache: &mut Cache<S, T>) {
    cache.retain(|_, kept| kept.source.strong_count() > 0);
}

/// Uploads what is not there yet.
fn keep<S, T>(
    cache: &mut Cache<S, T>,
    id: u64,
    source: &Arc<S>,
    upload: impl FnOnce() -> Result<T, LodError>,
) -> Result<(), LodError> {
    if let Entry::Vacant(entry) = cache.entry(id) {
        let made = upload()?;
        entry.insert(Kept { source: Arc::downgrade(source), made });
    }
    Ok(())
}

/// Vertex arrays and indices.
#[derive(Debug)]
pub(crate) struct Arrays {
    pub(crate) vertices: BindGroup,
    pub(crate) indices: BindGroup,
    pub(crate) index_buffer: Buffer,
    /// Positions, normals, texture coordinates, base, front and back.
    pub(crate) vertex_buffers: [Buffer; 6],
    /// Least and greatest coordinates of shared vertices.
    bounds: [Vec3; 2],
}

/// What one surface reads, by how it reads it.
type SurfaceKey = (u8, u64, u64, Sampler);

/// Everything uploaded.
#[derive(Debug)]
pub(crate) struct Resources {
    geometries: Cache<Geometry, Arrays>,
    textures: Cache<Texture, TextureView>,
    distributions: Cache<Distribution, [Buffer; 2]>,
    frames: Cache<Frames, FrameParts>,
    samplers: HashMap<Sampler, wgpu::Sampler>,
    surfaces: HashMap<SurfaceKey, BindGroup>,
    own: Option<Own>,
    /// Corners of quads: 0, 1, 2, 0, 2, 3, and so on.
    pub(crate) pattern: Buffer,
}

#[derive(Debug)]
struct FrameParts {
    facts: Buffer,
    list: Buffer,
    depths: TextureView,
    normals: TextureView,
}

/// A frame's own arrays, in buffers that grow.
#[derive(Debug)]
struct Own {
    buffers: [Buffer; 8],
    arrays: Arrays,
}

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct DistributionFacts {
    size: [u32; 4],
    leaf_size: Vec2,
    version_size: Vec2,
    largest_tint: [f32; 4],
    versions: [Vec2; 128],
}

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct FramesFacts {
    center: [f32; 4],
    low: [f32; 4],
    high: [f32; 4],
    size: [f32; 4],
    light: [[f32; 4]; 4],
}

/// A buffer of at least one row, filled.
pub(crate) fn filled_buffer(
    gpu: &Gpu,
    label: &str,
    usage: BufferUsages,
    bytes: &[u8],
    job: &Job,
) -> Result<Buffer, LodError> {
    let buffer = empty_buffer(gpu, label, usage, bytes.len() as u64)?;
    write(gpu, &buffer, bytes, job)?;
    Ok(buffer)
}

/// A buffer of so many bytes, at least 16.
pub(crate) fn empty_buffer(
    gpu: &Gpu,
    label: &str,
    usage: BufferUsages,
    byte_count: u64,
) -> Result<Buffer, LodError> {
    let size = byte_count.next_multiple_of(16).max(16);
    let is_bound = usage.contains(BufferUsages::STORAGE);
    let limit = if is_bound {
        gpu.limits.max_buffer_size.min(gpu.limits.max_storage_buffer_binding_size)
    } else {
        gpu.limits.max_buffer_size
    };
    check_limit("a buffer of the graphics card", size, limit, "bytes")?;
    let usage = usage | BufferUsages::COPY_DST;
    let descriptor =
        BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false };
    gpu.allocating(|| gpu.device.create_buffer(&descriptor))
}

fn write(gpu: &Gpu, buffer: &Buffer, bytes: &[u8], job: &Job) -> Result<(), LodError> {
    for (number, part) in bytes.chunks(CHUNK_BYTES).enumerate() {
        let offset = (number * CHUNK_BYTES) as u64;
        gpu.allocating(|| gpu.queue.write_buffer(buffer, offset, part))?;
        gpu.handed_over(part.len(), job)?;
    }
    Ok(())
}

/// Groups resources for a layout, in order of their bindings.
pub(crate) fn group(
    gpu: &Gpu,
    label: &str,
    layout: &BindGroupLayout,
    resources: &[BindingResource<'_>],
) -> BindGroup {
    let entries: Vec<BindGroupEntry<'_>> = (0..)
        .zip(resources)
        .map(|(binding, resource)| BindGroupEntry { binding, resource: resource.clone() })
        .collect();
    let descriptor = BindGroupDescriptor { label: Some(label), layout, entries: &entries };
    gpu.device.create_bind_group(&descriptor)
}

/// Bytes of the arrays that vertices and indices consist of, with their labels.
fn arrays_of(buffers: &Buffers) -> [(&'static str, &[u8]); 8] {
    [
        ("positions", bytemuck::cast_slice(&buffers.positions)),
        ("normals", bytemuck::cast_slice(&buffers.normals)),
        ("uvs", bytemuck::cast_slice(&buffers.uvs)),
        ("base", bytemuck::cast_slice(&buffers.base)),
        ("front", bytemuck::cast_slice(&buffers.front)),
        ("back", bytemuck::cast_slice(&buffers.back)),
        ("indices", bytemuck::cast_slice(&buffers.indices)),
        ("source ids", bytemuck::cast_slice(&buffers.source_ids)),
    ]
}

fn usage_of(label: &str) -> BufferUsages {
    let more = match label {
        "indices" => BufferUsages::INDEX,
        "source ids" => BufferUsages::empty(),
        _ => BufferUsages::VERTEX,
    };
    BufferUsages::STORAGE | more
}

fn grouped(gpu: &Gpu, pipelines: &Pipelines, buffers: &[Buffer; 8]) -> Arrays {
    let resources: Vec<BindingResource<'_>> =
        buffers.iter().map(Buffer::as_entire_binding).collect();
    Arrays {
        vertices: group(gpu, "vertices", &pipelines.vertices, &resources[..6]),
        indices: group(gpu, "indices", &pipelines.indices, &resources[6..]),
        index_buffer: buffers[6].clone(),
        vertex_buffers: std::array::from_fn(|number| buffers[number].clone()),
        bounds: [Vec3::ZERO; 2],
    }
}

impl Resources {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self, LodError> {
        let corners: Vec<u32> = (0..PATTERN_QUADS)
            .flat_map(|quad| [0, 1, 2, 0, 2, 3].map(|at| 4 * quad + at))
            .collect();
        let bytes = bytemuck::cast_slice(&corners);
        let pattern = filled_buffer(gpu, "quads", BufferUsages::INDEX, bytes, &Job::default())?;
        Ok(Self {
            geometries: Cache::new(),
            textures: Cache::new(),
            distributions: Cache::new(),
            frames: Cache::new(),
            samplers: HashMap::new(),
            surfaces: HashMap::new(),
            own: None,
            pattern,
        })
    }

    /// Uploads what a list shares and is not there yet, and drops what nobody uses any more.
    ///
    /// # Errors
    /// [`LodError::Limit`] for what no buffer or texture of the card can hold, [`LodError::Device`],
    /// [`LodError::Cancelled`].
    pub(crate) fn prepare(
        &mut self,
        gpu: &Gpu,
        pipelines: &Pipelines,
        list: &DrawList,
        job: &Job,
    ) -> Result<(), LodError> {
        let held = self.shared_count();
        sweep(&mut self.geometries);
        sweep(&mut self.textures);
        sweep(&mut self.distributions);
        sweep(&mut self.frames);
        if self.shared_count() < held {
            self.surfaces.clear();
        }
        for source in &list.geometries {
            let upload = || uploaded(gpu, pipelines, source.buffers(), job);
            keep(&mut self.geometries, source.id(), source, upload)?;
        }
        let colors = list.frames.iter().map(|frames| &frames.parts().color);
        for source in list.textures.iter().chain(colors) {
            keep(&mut self.textures, source.id(), source, || color_texture(gpu, source, job))?;
        }
        for source in &list.distributions {
            let upload = || distribution_buffers(gpu, source, job);
            keep(&mut self.distributions, source.id(), source, upload)?;
        }
        for source in &list.frames {
            keep(&mut self.frames, source.id(), source, || frame_parts(gpu, source, job))?;
        }
        Ok(())
    }

    /// Geometries, textures, distributions and frames that are held.
    #[cfg(test)]
    pub(crate) fn held(&self) -> [usize; 4] {
        let Self { geometries, textures, distributions, frames, .. } = self;
        [geometries.len(), textures.len(), distributions.len(), frames.len()]
    }

    fn shared_count(&self) -> usize {
        self.textures.len() + self.distributions.len() + self.frames.len()
    }

    /// Uploads a frame's own arrays.
    ///
    /// # Errors
    /// As [`Resources::prepare`].
    pub(crate) fn upload_own(
        &mut self,
        gpu: &Gpu,
        pipelines: &Pipelines,
        own: &OwnBuffers,
        job: &Job,
    ) -> Result<(), LodError> {
        let arrays = arrays_of(&own.buffers);
        let fits = |own: &Own| {
            own.buffers
                .iter()
                .zip(&arrays)
                .all(|(buffer, (_, bytes))| buffer.size() >= bytes.len() as u64)
        };
        let reused = self.own.take().filter(fits);
        let kept = match reused {
            Some(own) => own,
            None => {
                let mut made = Vec::new();
                for (label, bytes) in arrays {
                    // half as much again, so that a growing frame does not always ask for more
                    let size = bytes.len() as u64 * 3 / 2;
                    let limit =
                        gpu.limits.max_storage_buffer_binding_size.min(gpu.limits.max_buffer_size);
                    let size = if size > limit { bytes.len() as u64 } else { size };
                    made.push(empty_buffer(gpu, label, usage_of(label), size)?);
                }
                let buffers: [Buffer; 8] = made.try_into().expect("eight arrays");
                let arrays = grouped(gpu, pipelines, &buffers);
                Own { buffers, arrays }
            }
        };
        for (buffer, (_, bytes)) in kept.buffers.iter().zip(arrays) {
            write(gpu, buffer, bytes, job)?;
        }
        self.own = Some(kept);
        Ok(())
    }

    /// Arrays that were prepared.
    pub(crate) fn arrays(&self, list: &DrawList, source: Source) -> &Arrays {
        match source {
            Source::Shared(index) => &self.geometries[&list.geometries[index as usize].id()].made,
            Source::Own => &self.own.as_ref().expect("uploaded before").arrays,
        }
    }

    /// Least and greatest coordinates of vertices that were prepared.
    pub(crate) fn bounds(&self, geometry: &Geometry) -> [Vec3; 2] {
        self.geometries[&geometry.id()].made.bounds
    }

    /// Makes the group of what a surface reads unless it is there.
    ///
    /// # Errors
    /// [`LodError::Device`].
    pub(crate) fn prepare_surface(
        &mut self,
        gpu: &Gpu,
        pipelines: &Pipelines,
        list: &DrawList,
        reads: Reads,
    ) -> Result<(), LodError> {
        let Some(key) = surface_key(list, reads) else { return Ok(()) };
        if self.surfaces.contains_key(&key) {
            return Ok(());
        }
        let (.., sampler) = key;
        for wanted in [sampler, NORMAL_SAMPLER] {
            let make = || gpu.device.create_sampler(&sampler_of(wanted));
            self.samplers.entry(wanted).or_insert_with(make);
        }
        let sampled = BindingResource::Sampler(&self.samplers[&sampler]);
        let texture =
            |texture: &Texture| BindingResource::TextureView(&self.textures[&texture.id()].made);
        let made = match reads {
            Reads::Nothing => return Ok(()),
            Reads::Texture(index, _) => {
                let read = texture(&list.textures[index as usize]);
                group(gpu, "textured", &pipelines.textured, &[read, sampled])
            }
            Reads::Distribution(distribution, leaves, _) => {
                let read = texture(&list.textures[leaves as usize]);
                let id = list.distributions[distribution as usize].id();
                let [facts, places] = &self.distributions[&id].made;
                let (facts, places) = (facts.as_entire_binding(), places.as_entire_binding());
                let resources = [read, sampled, facts, places];
                group(gpu, "indirect", &pipelines.indirect, &resources)
            }
            Reads::Frames(index, _) => {
                let frames = &list.frames[index as usize];
                let read = texture(&frames.parts().color);
                let FrameParts { facts, list, depths, normals } = &self.frames[&frames.id()].made;
                let resources = [
                    read,
                    sampled,
                    facts.as_entire_binding(),
                    list.as_entire_binding(),
                    BindingResource::TextureView(depths),
                    BindingResource::TextureView(normals),
                    BindingResource::Sampler(&self.samplers[&NORMAL_SAMPLER]),
                ];
                group(gpu, "parallax", &pipelines.parallax, &resources)
            }
        };
        gpu.check()?;
        self.surfaces.insert(key, made);
        Ok(())
    }

    /// The group of a surface that was prepared.
    pub(crate) fn surface(&self, list: &DrawList, reads: Reads) -> Option<&BindGroup> {
        surface_key(list, reads).map(|key| &self.surfaces[&key])
    }
}

fn surface_key(list: &DrawList, reads: Reads) -> Option<SurfaceKey> {
    match reads {
        Reads::Nothing => None,
        Reads::Texture(texture, sampler) => {
            Some((0, list.textures[texture as usize].id(), 0, sampler))
        }
        Reads::Distribution(distribution, leaves, sampler) => {
            let id = list.distributions[distribution as usize].id();
            Some((1, id, list.textures[leaves as usize].id(), sampler))
        }
        Reads::Frames(frames, sampler) => Some((2, list.frames[frames as usize].id(), 0, sampler)),
    }
}

/// How maps of normals are read.
const NORMAL_SAMPLER: Sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: Filter::Trilinear };

fn sampler_of(sampler: Sampler) -> SamplerDescriptor<'static> {
    let [u, v] = sampler.wrap.map(|wrap| match wrap {
        Wrap::Repeat => AddressMode::Repeat,
        Wrap::Mirror => AddressMode::MirrorRepeat,
        Wrap::Clamp => AddressMode::ClampToEdge,
    });
    let is_nearest = sampler.filter == Filter::Nearest;
    let filter = if is_nearest { FilterMode::Nearest } else { FilterMode::Linear };
    let has_levels = sampler.filter == Filter::Trilinear;
    SamplerDescriptor {
        label: Some("texels"),
        address_mode_u: u,
        address_mode_v: v,
        mag_filter: filter,
        min_filter: filter,
        mipmap_filter: if has_levels {
            MipmapFilterMode::Linear
        } else {
            MipmapFilterMode::Nearest
        },
        ..SamplerDescriptor::default()
    }
}

fn uploaded(
    gpu: &Gpu,
    pipelines: &Pipelines,
    buffers: &Buffers,
    job: &Job,
) -> Result<Arrays, LodError> {
    let mut made = Vec::new();
    for (label, bytes) in arrays_of(buffers) {
        made.push(filled_buffer(gpu, label, usage_of(label), bytes, job)?);
    }
    let made: [Buffer; 8] = made.try_into().expect("eight arrays");
    Ok(Arrays { bounds: bounds_of(buffers), ..grouped(gpu, pipelines, &made) })
}

/// A texture whose levels are filled one after the other.
fn texture<T: Pod>(
    gpu: &Gpu,
    label: &str,
    format: TextureFormat,
    sizes: &[(u32, u32)],
    texels_of: impl Fn(usize, Range<usize>) -> Vec<T>,
    job: &Job,
) -> Result<TextureView, LodError> {
    let (width, height) = sizes[0];
    let limit = u64::from(gpu.limits.max_texture_dimension_2d);
    check_limit(
        "a texture of the graphics card",
        width.max(height).into(),
        limit,
        "texels a side",
    )?;
    let size = Extent3d { width, height, depth_or_array_layers: 1 };
    let descriptor = TextureDescriptor {
        label: Some(label),
        size,
        mip_level_count: u32::try_from(sizes.len()).expect("few levels"),
        sample_count: 1,
        dimension: TextureDimension::D2,
        format,
        usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
        view_formats: &[],
    };
    let made = gpu.allocating(|| gpu.device.create_texture(&descriptor))?;
    for (level, &(width, height)) in (0_u32..).zip(sizes) {
        let row_texels = width as usize;
        let row_bytes = row_texels * size_of::<T>();
        let rows_at_once = u32::try_from(CHUNK_BYTES / row_bytes).expect("small").max(1);
        for y in (0..height).step_by(rows_at_once as usize) {
            let rows = rows_at_once.min(height - y);
            let first = y as usize * row_texels;
            let part = texels_of(level as usize, first..first + rows as usize * row_texels);
            let write = || {
                gpu.queue.write_texture(
                    TexelCopyTextureInfo {
                        texture: &made,
                        mip_level: level,
                        origin: Origin3d { x: 0, y, z: 0 },
                        aspect: TextureAspect::All,
                    },
                    bytemuck::cast_slice(&part),
                    TexelCopyBufferLayout {
                        offset: 0,
                        bytes_per_row: Some(u32::try_from(row_bytes).expect("16384 texels")),
                        rows_per_image: Some(rows),
                    },
                    Extent3d { width, height: rows, depth_or_array_layers: 1 },
                );
            };
            gpu.allocating(write)?;
            gpu.handed_over(part.len() * size_of::<T>(), job)?;
        }
    }
    gpu.check()?;
    Ok(made.create_view(&wgpu::TextureViewDescriptor::default()))
}

fn sizes_of(levels: &[Image]) -> Vec<(u32, u32)> {
    levels.iter().map(|level| (level.width, level.height)).collect()
}

fn color_texture(gpu: &Gpu, source: &Texture, job: &Job) -> Result<TextureView, LodError> {
    let levels = source.levels();
    let texels = |level: usize, range: Range<usize>| -> Vec<[f16; 4]> {
        let halves = |texel: &[u8; 4]| decode(*texel).to_array().map(f16::from_f32);
        levels[level].texels[range].iter().map(halves).collect()
    };
    texture(gpu, "texels", TextureFormat::Rgba16Float, &sizes_of(levels), texels, job)
}

fn distribution_buffers(
    gpu: &Gpu,
    source: &Distribution,
    job: &Job,
) -> Result<[Buffer; 2], LodError> {
    let layout = source.layout();
    let mut versions = [Vec2::ZERO; 128];
    versions[..layout.versions.len()].copy_from_slice(layout.versions);
    let facts = DistributionFacts {
        size: [layout.size.0, layout.size.1, layout.layer_count, 0],
        leaf_size: layout.leaf_size,
        version_size: layout.version_size,
        largest_tint: [layout.largest_tint, 0.0, 0.0, 0.0],
        versions,
    };
    let places: Vec<[u32; 2]> = layout.places.iter().map(|place| place.words()).collect();
    let uniform = BufferUsages::UNIFORM;
    let places = bytemuck::cast_slice(&places);
    Ok([
        filled_buffer(gpu, "distribution", uniform, bytemuck::bytes_of(&facts), job)?,
        filled_buffer(gpu, "places", BufferUsages::STORAGE, places, job)?,
    ])
}

fn frame_parts(gpu: &Gpu, source: &Frames, job: &Job) -> Result<FrameParts, LodError> {
    let parts = source.parts();
    let levels = parts.depth.levels();
    let sizes: Vec<(u32, u32)> = levels.iter().map(|level| (level.width, level.height)).collect();
    let codes = |level: usize, range: Range<usize>| levels[level].codes[range].to_vec();
    let depths = texture(gpu, "depths", TextureFormat::R16Uint, &sizes, codes, job)?;
    let normals = match &parts.relit {
        Some(Relit { normal, .. }) => {
            let levels = normal.levels();
            let codes = |level: usize, range: Range<usize>| levels[level].texels[range].to_vec();
            let format = TextureFormat::Rgba8Unorm;
            texture(gpu, "normals", format, &sizes_of(levels), codes, job)?
        }
        None => {
            let none = |_: usize, _: Range<usize>| vec![[0_u8; 4]];
            texture(gpu, "no normals", TextureFormat::Rgba8Unorm, &[(1, 1)], none, job)?
        }
    };
    let list: Vec<[[f32; 4]; 4]> = parts
        .frames
        .iter()
        .map(|frame| {
            frame.map_or([[0.0; 4]; 4], |frame| {
                [
                    frame.toward.extend(1.0).to_array(),
                    frame.right.extend(0.0).to_array(),
                    frame.up.extend(0.0).to_array(),
                    [frame.corner.x, frame.corner.y, 0.0, 0.0],
                ]
            })
        })
        .collect();
    let light = parts.relit.as_ref().map_or([[0.0; 4]; 4], |Relit { light, .. }| {
        [
            light.sun_direction.extend(light.translucency).to_array(),
            light.sun.extend(0.0).to_array(),
            light.sky.extend(0.0).to_array(),
            light.ground.extend(0.0).to_array(),
        ]
    });
    let [low, high] = parts.bounds;
    let texels = parts.size.x * parts.color.size().0 as f32;
    let facts = FramesFacts {
        center: parts.center.extend(parts.reach).to_array(),
        low: low.extend(0.0).to_array(),
        high: high.extend(0.0).to_array(),
        size: [parts.size.x, parts.size.y, texels, levels.len() as f32],
        light,
    };
    let (uniform, facts) = (BufferUsages::UNIFORM, bytemuck::bytes_of(&facts));
    Ok(FrameParts {
        facts: filled_buffer(gpu, "frames", uniform, facts, job)?,
        list: filled_buffer(gpu, "list", BufferUsages::STORAGE, bytemuck::cast_slice(&list), job)?,
        depths,
        normals,
    })
}
