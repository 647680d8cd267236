//! The planes of a picture on the card: what is drawn into, what it is added up in, and how.

use bytemuck::{Pod, Zeroable};
use glam::Vec4;
use wgpu::{
    BindGroup, BindGroupLayout, BindGroupLayoutDescriptor, BindingResource, Buffer,
    BufferBindingType, BufferUsages, CommandEncoder, ComputePassDescriptor,
    ComputePassTimestampWrites, ComputePipeline, ComputePipelineDescriptor, Extent3d,
    PipelineLayoutDescriptor, ShaderModuleDescriptor, ShaderSource, ShaderStages,
    TextureDescriptor, TextureDimension, TextureFormat, TextureSampleType, TextureUsages,
    TextureView,
};

use crate::error::{LodError, check_limit};
use crate::gpu::device::Gpu;
use crate::gpu::pipelines::{DEPTH_FORMAT, ID_FORMAT, Targets, buffer_entry, texture_entry};
use crate::gpu::resources::{empty_buffer, group};
use crate::gpu::template::filled;
use crate::view::View;

/// Pixels a side of what one group of threads adds up.
const GROUP_SIDE: u32 = 8;

/// What tells sets of planes apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shape {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) targets: Targets,
    pub(crate) depth: bool,
    pub(crate) color8: bool,
    /// Four samples at once.
    pub(crate) four: bool,
    /// Whether blended shapes' depths are searched.
    pub(crate) searches: bool,
}

/// What is drawn into; a plane that is not wanted is a single texel.
#[derive(Debug)]
pub(crate) struct Drawn {
    pub(crate) color: TextureView,
    pub(crate) albedo: TextureView,
    pub(crate) normal: TextureView,
    pub(crate) ids: TextureView,
    pub(crate) depth: TextureView,
    /// What blended shapes let through.
    pub(crate) product: TextureView,
    /// The mean of four samples of colour, where the card takes it.
    pub(crate) resolved: Option<TextureView>,
}

/// What samples are added up in; a plane that is not wanted is empty.
#[derive(Debug)]
pub(crate) struct Sums {
    pub(crate) color: Buffer,
    pub(crate) albedo: Buffer,
    pub(crate) normal: Buffer,
    pub(crate) depth: Buffer,
    pub(crate) ids: Buffer,
    pub(crate) color8: Buffer,
}

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct SumFacts {
    size: [u32; 4],
    depth: [f32; 4],
    background: [f32; 4],
}

/// The planes of one kind of picture, and the kernels that add them up.
#[derive(Debug)]
pub(crate) struct Planes {
    pub(crate) shape: Shape,
    pub(crate) drawn: Drawn,
    pub(crate) sums: Sums,
    /// Numbers of the search, a pixel each.
    pub(crate) found: Buffer,
    facts: Buffer,
    search_facts: Buffer,
    add: (ComputePipeline, BindGroup),
    finish: (ComputePipeline, BindGroup),
    search: (ComputePipeline, BindGroup),
}

impl Planes {
    /// # Errors
    /// [`LodError::Limit`] for a picture that the card cannot hold, [`LodError::Device`].
    pub(crate) fn new(gpu: &Gpu, shape: Shape) -> Result<Self, LodError> {
        let Shape { width, height, targets, .. } = shape;
        let side = u64::from(width.max(height));
        let limit = u64::from(gpu.limits.max_texture_dimension_2d);
        check_limit("size", side, limit, "pixels a side of this card's pictures")?;
        let pixel_count = u64::from(width) * u64::from(height);
        let storage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        let plane = |label: &str, wanted: bool, bytes: u64| {
            let limit = gpu.limits.max_storage_buffer_binding_size.min(gpu.limits.max_buffer_size);
            let asked = if wanted { pixel_count * bytes } else { 0 };
            check_limit("size", asked, limit, "bytes of this card's memory at once")?;
            empty_buffer(gpu, label, storage, asked)
        };
        let sums = Sums {
            color: plane("color", targets.color, 16)?,
            albedo: plane("albedo", targets.albedo, 16)?,
            normal: plane("normal", targets.normal, 16)?,
            depth: plane("depth", shape.depth, 4)?,
            ids: plane("ids", targets.ids, 4)?,
            color8: plane("color8", shape.color8, 4)?,
        };
        let found = plane("found", shape.searches, 4)?;
        let drawn = Drawn::new(gpu, &shape)?;
        let facts_size = size_of::<SumFacts>() as u64;
        let facts = empty_buffer(gpu, "sum", BufferUsages::UNIFORM, facts_size)?;
        let search_facts = empty_buffer(gpu, "search", BufferUsages::UNIFORM, 16)?;
        let add = kernel(gpu, &shape, Kernel::Add, &facts, &drawn, &sums, &found);
        let finish = kernel(gpu, &shape, Kernel::Finish, &facts, &drawn, &sums, &found);
        let search = kernel(gpu, &shape, Kernel::Search, &search_facts, &drawn, &sums, &found);
        gpu.check()?;
        Ok(Self { shape, drawn, sums, found, facts, search_facts, add, finish, search })
    }

    /// Writes what the next sum needs to know.
    pub(crate) fn write_facts(
        &self,
        gpu: &Gpu,
        view: &View,
        far: f64,
        background: Vec4,
        (weight, is_first): (f32, bool),
    ) {
        let Shape { width, height, four, .. } = self.shape;
        #[expect(clippy::cast_possible_truncation, reason = "depths are f32 on the card")]
        let (near, far) = (view.near as f32, far as f32);
        let is_perspective = if view.is_orthographic() { 0.0 } else { 1.0 };
        let facts = SumFacts {
            size: [width, height, if four { 4 } else { 1 }, u32::from(is_first)],
            depth: [near, far, is_perspective, weight],
            background: background.to_array(),
        };
        gpu.queue.write_buffer(&self.facts, 0, bytemuck::bytes_of(&facts));
    }

    /// Whether a picture of so many sets of samples is whole only once they are added up. One of a single
    /// set lies in what was drawn.
    pub(crate) fn needs_sum(&self, set_count: usize, background: Vec4) -> bool {
        let is_resolved = !self.shape.four || self.drawn.resolved.is_some();
        set_count > 1 || !is_resolved || self.shape.searches || self.needs_finish(background)
    }

    /// Whether something lies behind the picture, or it is wanted in eight bits.
    pub(crate) fn needs_finish(&self, background: Vec4) -> bool {
        self.shape.color8 || background != Vec4::ZERO
    }

    /// Adds what was drawn.
    pub(crate) fn add(
        &self,
        encoder: &mut CommandEncoder,
        timestamps: Option<ComputePassTimestampWrites<'_>>,
    ) {
        self.run(encoder, &self.add, timestamps);
    }

    /// Puts the background behind the picture and encodes it.
    pub(crate) fn finish(
        &self,
        encoder: &mut CommandEncoder,
        timestamps: Option<ComputePassTimestampWrites<'_>>,
    ) {
        self.run(encoder, &self.finish, timestamps);
    }

    /// Takes a step of the search from what was drawn.
    pub(crate) fn search(&self, gpu: &Gpu, encoder: &mut CommandEncoder, step: u32) {
        let Shape { width, height, .. } = self.shape;
        let facts = [width, height, step, 0];
        gpu.queue.write_buffer(&self.search_facts, 0, bytemuck::cast_slice(&facts));
        self.run(encoder, &self.search, None);
    }

    fn run(
        &self,
        encoder: &mut CommandEncoder,
        (pipeline, bound): &(ComputePipeline, BindGroup),
        timestamp_writes: Option<ComputePassTimestampWrites<'_>>,
    ) {
        let label = Some("sum");
        let mut pass =
            encoder.begin_compute_pass(&ComputePassDescriptor { label, timestamp_writes });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, bound, &[]);
        let groups = |pixels: u32| pixels.div_ceil(GROUP_SIDE);
        pass.dispatch_workgroups(groups(self.shape.width), groups(self.shape.height), 1);
    }
}

impl Drawn {
    fn new(gpu: &Gpu, shape: &Shape) -> Result<Self, LodError> {
        let plane = |label: &str, format: TextureFormat, wanted: bool, four: bool| {
            let (width, height) = if wanted { (shape.width, shape.height) } else { (1, 1) };
            let descriptor = TextureDescriptor {
                label: Some(label),
                size: Extent3d { width, height, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: if four { 4 } else { 1 },
                dimension: TextureDimension::D2,
                format,
                usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            };
            let texture = gpu.allocating(|| gpu.device.create_texture(&descriptor))?;
            Ok::<_, LodError>(texture.create_view(&wgpu::TextureViewDescriptor::default()))
        };
        let Targets { color, albedo, normal, ids } = shape.targets;
        Ok(Self {
            color: plane("color", gpu.color_format, color, shape.four)?,
            albedo: plane("albedo", gpu.color_format, albedo, false)?,
            normal: plane("normal", gpu.color_format, normal, false)?,
            ids: plane("ids", ID_FORMAT, ids, false)?,
            depth: plane("depth", DEPTH_FORMAT, true, shape.four)?,
            product: plane("product", gpu.product_format, shape.searches, false)?,
            resolved: (shape.four && gpu.resolves)
                .then(|| plane("resolved", gpu.color_format, color, false))
                .transpose()?,
        })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kernel {
    Add,
    Finish,
    Search,
}

fn source_of(kernel: Kernel, shape: &Shape, has_four_colors: bool) -> String {
    let source = match kernel {
        Kernel::Add | Kernel::Finish => include_str!("sum.wgsl"),
        Kernel::Search => include_str!("search.wgsl"),
    };
    let Targets { color, albedo, normal, ids } = shape.targets;
    filled(source, &|name| match name {
        "FINISH" => kernel == Kernel::Finish,
        "FOUR" => shape.four,
        "FOUR_COLORS" => has_four_colors,
        "COLOR" => color,
        "COLOR8" => shape.color8,
        "ALBEDO" => albedo,
        "NORMAL" => normal,
        "DEPTH" => shape.depth,
        "IDS" => ids,
        _ => unreachable!("no condition is called {name}"),
    })
}

fn kernel(
    gpu: &Gpu,
    shape: &Shape,
    kernel: Kernel,
    facts: &Buffer,
    drawn: &Drawn,
    sums: &Sums,
    found: &Buffer,
) -> (ComputePipeline, BindGroup) {
    let stage = ShaderStages::COMPUTE;
    let written = BufferBindingType::Storage { read_only: false };
    let uniform = buffer_entry(0, stage, BufferBindingType::Uniform);
    let float = TextureSampleType::Float { filterable: false };
    let has_four_colors = shape.four && drawn.resolved.is_none();
    let entry_point = match kernel {
        Kernel::Add => "add",
        Kernel::Finish => "finish",
        Kernel::Search => "step",
    };
    let entries = if kernel == Kernel::Search {
        vec![uniform, texture_entry(1, stage, float, false), buffer_entry(2, stage, written)]
    } else {
        let mut entries = vec![uniform];
        entries.extend((1..7).map(|binding| buffer_entry(binding, stage, written)));
        if kernel == Kernel::Add {
            entries.extend([
                texture_entry(7, stage, float, has_four_colors),
                texture_entry(8, stage, TextureSampleType::Depth, shape.four),
                texture_entry(9, stage, float, false),
                texture_entry(10, stage, float, false),
                texture_entry(11, stage, TextureSampleType::Uint, false),
            ]);
        }
        entries
    };
    let view = BindingResource::TextureView;
    let mut resources = vec![facts.as_entire_binding()];
    if kernel == Kernel::Search {
        resources.extend([view(&drawn.product), found.as_entire_binding()]);
    } else {
        let Sums { color, albedo, normal, depth, ids, color8 } = sums;
        let buffers = [color, albedo, normal, depth, ids, color8];
        resources.extend(buffers.map(Buffer::as_entire_binding));
        if kernel == Kernel::Add {
            let Drawn { color, albedo, normal, ids, depth, resolved, .. } = drawn;
            let color = resolved.as_ref().unwrap_or(color);
            resources.extend([color, depth, albedo, normal, ids].map(view));
        }
    }
    let source = source_of(kernel, shape, has_four_colors);
    let layout: BindGroupLayout = gpu.device.create_bind_group_layout(&BindGroupLayoutDescriptor {
        label: Some(entry_point),
        entries: &entries,
    });
    let pipeline_layout = gpu.device.create_pipeline_layout(&PipelineLayoutDescriptor {
        label: Some(entry_point),
        bind_group_layouts: &[Some(&layout)],
        immediate_size: 0,
    });
    let module = gpu.device.create_shader_module(ShaderModuleDescriptor {
        label: Some(entry_point),
        source: ShaderSource::Wgsl(source.into()),
    });
    let pipeline = gpu.device.create_compute_pipeline(&ComputePipelineDescriptor {
        label: Some(entry_point),
        layout: Some(&pipeline_layout),
        module: &module,
        entry_point: Some(entry_point),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    });
    (pipeline, group(gpu, entry_point, &layout, &resources))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::tests::check_translation;

    #[test]
    fn every_kernel_is_a_shader_of_metal_and_directx_too() {
        let flags = [false, true];
        let mut count = 0;
        for bits in 0..1_u32 << 7 {
            let [color, albedo, normal, ids, depth, color8, four] =
                std::array::from_fn(|place| bits >> place & 1 == 1);
            let targets = Targets { color, albedo, normal, ids };
            let shape =
                Shape { width: 8, height: 8, targets, depth, color8, four, searches: false };
            for has_four_colors in flags.into_iter().filter(|wanted| !wanted || four) {
                for kernel in [Kernel::Add, Kernel::Finish, Kernel::Search] {
                    check_translation(&source_of(kernel, &shape, has_four_colors), &kernel);
                    count += 1;
                }
            }
        }
        assert_eq!(count, 3 * (64 + 2 * 64), "of all planes");
    }
}
