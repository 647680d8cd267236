//! One pipeline for each way in which shapes are drawn, made when it is first needed.

use std::collections::HashMap;

use wgpu::{
    BindGroupLayout, BindGroupLayoutDescriptor, BindGroupLayoutEntry, BindingType, BlendComponent,
    BlendFactor, BlendOperation, BlendState, BufferBindingType, ColorTargetState, ColorWrites,
    CompareFunction, DepthStencilState, FragmentState, MultisampleState, PipelineLayout,
    PipelineLayoutDescriptor, PrimitiveState, RenderPipeline, RenderPipelineDescriptor,
    SamplerBindingType, ShaderModule, ShaderModuleDescriptor, ShaderSource, ShaderStages,
    TextureFormat, TextureSampleType, TextureViewDimension, VertexAttribute, VertexBufferLayout,
    VertexFormat, VertexState, VertexStepMode,
};

use crate::error::LodError;
use crate::gpu::device::Gpu;
use crate::gpu::template::filled;

/// Of depth while a picture is drawn: 1 at the near plane, 0 far away.
pub(crate) const DEPTH_FORMAT: TextureFormat = TextureFormat::Depth32Float;

/// Of ids.
pub(crate) const ID_FORMAT: TextureFormat = TextureFormat::R32Uint;

/// How corners are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Shapes {
    /// Triangles from an index buffer, which do not know their numbers.
    Indexed,
    /// Triangles that know their numbers.
    Triangles,
    Cards,
    Lines,
    Points,
}

/// What gives shapes their colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Look {
    Vertex,
    Textured { trilinear: bool },
    Indirect { trilinear: bool },
    Parallax { trilinear: bool, relit: bool },
}

/// How shapes join the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Mixing {
    Opaque,
    Test,
    Coverage,
    Over,
}

/// Planes that are drawn besides depth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct Targets {
    pub(crate) color: bool,
    pub(crate) albedo: bool,
    pub(crate) normal: bool,
    pub(crate) ids: bool,
}

/// The two drawings of the search for half opacity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Search {
    /// What shapes from some paint order on let through.
    Product,
    /// Depth and id of the shape that was found.
    Found,
}

/// What tells pipelines apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Key {
    pub(crate) shapes: Shapes,
    pub(crate) look: Look,
    pub(crate) mixing: Mixing,
    pub(crate) writes_depth: bool,
    pub(crate) has_slab: bool,
    pub(crate) is_dithered: bool,
    pub(crate) targets: Targets,
    /// Four samples at once.
    pub(crate) four: bool,
    pub(crate) search: Option<Search>,
}

impl Key {
    /// The same shapes in a drawing of the search.
    pub(crate) fn searched(self, search: Search) -> Self {
        let shapes = if self.shapes == Shapes::Indexed { Shapes::Triangles } else { self.shapes };
        Self { shapes, search: Some(search), ..self }
    }

    /// Whether a condition of the shaders' sources holds.
    fn holds(&self, name: &str) -> bool {
        let Self { shapes, look, mixing, targets, search, .. } = *self;
        let draws = search.is_none();
        let is_parallax = matches!(look, Look::Parallax { .. });
        match name {
            "INDEXED" => shapes == Shapes::Indexed,
            "POINTS" => shapes == Shapes::Points,
            "LINES" => shapes == Shapes::Lines,
            "POINTS_OR_LINES" => matches!(shapes, Shapes::Points | Shapes::Lines),
            "SURFACE" => matches!(look, Look::Textured { .. } | Look::Indirect { .. }),
            "PARALLAX" | "LOCAL" => is_parallax,
            "UV" => self.holds("SURFACE"),
            "TRILINEAR" => matches!(
                look,
                Look::Textured { trilinear: true }
                    | Look::Indirect { trilinear: true }
                    | Look::Parallax { trilinear: true, .. }
            ),
            "RELIT" => matches!(look, Look::Parallax { relit: true, .. }),
            "TEST" => mixing == Mixing::Test,
            "COVERAGE" => mixing == Mixing::Coverage,
            "OVER" => mixing == Mixing::Over,
            "HIDES" => mixing == Mixing::Over && self.writes_depth,
            "WHAT" => {
                let asks = ["TEST", "COVERAGE", "SLAB", "DITHER", "NORMAL", "PARALLAX", "IDS"];
                asks.iter().any(|name| self.holds(name))
            }
            "TINTED" => ["ALPHA", "LIT", "BASE"].iter().any(|name| self.holds(name)),
            "BASE_OR_ALPHA" => self.holds("BASE") || self.holds("ALPHA"),
            "ALPHA" => mixing != Mixing::Opaque && !is_parallax,
            "SLAB" | "DEPTH" => self.has_slab,
            "DITHER" => self.is_dithered,
            "FOUR" => self.rate() == "sample",
            "SAMPLED" => self.is_dithered || mixing == Mixing::Coverage,
            "COLOR" => draws && targets.color,
            "ALBEDO" => draws && targets.albedo,
            "NORMAL" => draws && targets.normal,
            "LIT" => draws && targets.color && !is_parallax,
            "BASE" => draws && targets.albedo && !is_parallax,
            "FACING" => draws && !is_parallax && (targets.color || targets.normal),
            "IDS" => targets.ids || mixing == Mixing::Coverage,
            "ID_TARGET" => match search {
                None => targets.ids && mixing != Mixing::Over,
                Some(search) => targets.ids && search == Search::Found,
            },
            "ORDER" => search.is_some(),
            "PRODUCT" => search == Some(Search::Product),
            "ANY_TARGET" => ["COLOR", "ALBEDO", "NORMAL", "ID_TARGET", "PRODUCT", "PARALLAX"]
                .iter()
                .any(|name| self.holds(name)),
            _ => unreachable!("no condition is called {name}"),
        }
    }

    /// Which of a vertex's arrays the card reads by itself: their numbers, and the numbers in each.
    pub(crate) fn attributes(&self) -> impl Iterator<Item = (u32, VertexFormat)> {
        let arrays = [
            (true, VertexFormat::Float32x3),
            (self.holds("NORMAL"), VertexFormat::Float32x3),
            (self.holds("UV"), VertexFormat::Float32x2),
            (self.holds("BASE_OR_ALPHA"), VertexFormat::Float32x4),
            (self.holds("LIT"), VertexFormat::Float32x3),
            (self.holds("LIT"), VertexFormat::Float32x3),
        ];
        let is_indexed = self.shapes == Shapes::Indexed;
        (0..).zip(arrays).filter_map(move |(number, (is_read, format))| {
            (is_indexed && is_read).then_some((number, format))
        })
    }

    /// Whether fragments must be asked: for colours, or whether they are there.
    fn has_fragments(&self) -> bool {
        let asked = ["ANY_TARGET", "TEST", "COVERAGE", "SLAB", "DITHER", "ORDER", "HIDES"];
        asked.iter().any(|name| self.holds(name))
    }

    /// Where in a pixel values are taken. Smooth opaque shapes are shaded once a pixel.
    fn rate(&self) -> &'static str {
        let is_smooth = self.look == Look::Vertex && self.mixing == Mixing::Opaque;
        match (self.four, is_smooth && !self.has_slab && !self.is_dithered) {
            (false, _) => "center",
            (true, true) => "centroid",
            (true, false) => "sample",
        }
    }

    fn source(&self) -> String {
        let surface = match self.look {
            Look::Vertex => "",
            Look::Textured { .. } => include_str!("textured.wgsl"),
            Look::Indirect { .. } => include_str!("indirect.wgsl"),
            Look::Parallax { .. } => include_str!("parallax.wgsl"),
        };
        let parts = [include_str!("shapes.wgsl"), include_str!("fragments.wgsl"), surface];
        let corners = if self.shapes == Shapes::Triangles { "3u" } else { "4u" };
        filled(&parts.join("\n"), &|name| self.holds(name))
            .replace("RATE)", &format!("{})", self.rate()))
            .replace("CORNERS", corners)
    }
}

impl Key {
    fn module(&self, gpu: &Gpu) -> ShaderModule {
        gpu.device.create_shader_module(ShaderModuleDescriptor {
            label: Some(&format!("{self:?}")),
            source: ShaderSource::Wgsl(self.source().into()),
        })
    }
}

/// Layouts of what shapes read, and the pipelines made so far.
#[derive(Debug)]
pub(crate) struct Pipelines {
    pub(crate) frame: BindGroupLayout,
    pub(crate) vertices: BindGroupLayout,
    pub(crate) indices: BindGroupLayout,
    pub(crate) textured: BindGroupLayout,
    pub(crate) indirect: BindGroupLayout,
    pub(crate) parallax: BindGroupLayout,
    made: HashMap<Key, RenderPipeline>,
}

/// A buffer that shaders read.
pub(crate) fn buffer_entry(
    binding: u32,
    visibility: ShaderStages,
    ty: BufferBindingType,
) -> BindGroupLayoutEntry {
    let ty = BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
    BindGroupLayoutEntry { binding, visibility, ty, count: None }
}

/// A texture that shaders read.
pub(crate) fn texture_entry(
    binding: u32,
    visibility: ShaderStages,
    sample_type: TextureSampleType,
    multisampled: bool,
) -> BindGroupLayoutEntry {
    let view_dimension = TextureViewDimension::D2;
    let ty = BindingType::Texture { sample_type, view_dimension, multisampled };
    BindGroupLayoutEntry { binding, visibility, ty, count: None }
}

fn sampler_entry(binding: u32) -> BindGroupLayoutEntry {
    let ty = BindingType::Sampler(SamplerBindingType::Filtering);
    BindGroupLayoutEntry { binding, visibility: ShaderStages::FRAGMENT, ty, count: None }
}

const READ: BufferBindingType = BufferBindingType::Storage { read_only: true };
const FILTERED: TextureSampleType = TextureSampleType::Float { filterable: true };

impl Pipelines {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        let (vertex, fragment) = (ShaderStages::VERTEX, ShaderStages::FRAGMENT);
        let layout = |label: &str, entries: &[BindGroupLayoutEntry]| {
            let descriptor = BindGroupLayoutDescriptor { label: Some(label), entries };
            gpu.device.create_bind_group_layout(&descriptor)
        };
        let storages = |count: u32| -> Vec<BindGroupLayoutEntry> {
            (0..count).map(|binding| buffer_entry(binding, vertex, READ)).collect()
        };
        let frame = [
            buffer_entry(0, vertex | fragment, BufferBindingType::Uniform),
            buffer_entry(1, vertex | fragment, READ),
            buffer_entry(2, vertex, READ),
            buffer_entry(3, vertex | fragment, READ),
            buffer_entry(4, fragment, READ),
        ];
        let textured = [texture_entry(0, fragment, FILTERED, false), sampler_entry(1)];
        let uniform = buffer_entry(2, fragment, BufferBindingType::Uniform);
        let list = buffer_entry(3, fragment, READ);
        let depths = texture_entry(4, fragment, TextureSampleType::Uint, false);
        let normals = [texture_entry(5, fragment, FILTERED, false), sampler_entry(6)];
        let indirect = [textured[0], textured[1], uniform, list];
        let parallax = [textured[0], textured[1], uniform, list, depths, normals[0], normals[1]];
        Self {
            frame: layout("frame", &frame),
            vertices: layout("vertices", &storages(6)),
            indices: layout("indices", &storages(2)),
            textured: layout("textured", &textured),
            indirect: layout("indirect", &indirect),
            parallax: layout("parallax", &parallax),
            made: HashMap::new(),
        }
    }

    /// Makes the pipeline of a key unless it is there.
    ///
    /// # Errors
    /// [`LodError::Device`] if the driver refuses it.
    pub(crate) fn prepare(&mut self, gpu: &Gpu, key: Key) -> Result<(), LodError> {
        if !self.made.contains_key(&key) {
            let pipeline = self.make(gpu, key);
            gpu.check()?;
            self.made.insert(key, pipeline);
        }
        Ok(())
    }

    /// A pipeline that was prepared.
    pub(crate) fn get(&self, key: &Key) -> &RenderPipeline {
        &self.made[key]
    }

    fn layout_of(&self, gpu: &Gpu, look: Look) -> PipelineLayout {
        let surface = match look {
            Look::Vertex => None,
            Look::Textured { .. } => Some(&self.textured),
            Look::Indirect { .. } => Some(&self.indirect),
            Look::Parallax { .. } => Some(&self.parallax),
        };
        let mut layouts = vec![Some(&self.frame), Some(&self.vertices), Some(&self.indices)];
        layouts.extend(surface.map(Some));
        gpu.device.create_pipeline_layout(&PipelineLayoutDescriptor {
            label: Some("shapes"),
            bind_group_layouts: &layouts,
            immediate_size: 0,
        })
    }

    fn make(&self, gpu: &Gpu, key: Key) -> RenderPipeline {
        let label = format!("{key:?}");
        let module = key.module(gpu);
        let targets = targets_of(gpu, &key);
        let attributes: Vec<[VertexAttribute; 1]> = key
            .attributes()
            .map(|(shader_location, format)| {
                [VertexAttribute { format, offset: 0, shader_location }]
            })
            .collect();
        let arrays: Vec<Option<VertexBufferLayout<'_>>> = attributes
            .iter()
            .map(|attributes| {
                let array_stride = attributes[0].format.size();
                let step_mode = VertexStepMode::Vertex;
                Some(VertexBufferLayout { array_stride, step_mode, attributes })
            })
            .collect();
        gpu.device.create_render_pipeline(&RenderPipelineDescriptor {
            label: Some(&label),
            layout: Some(&self.layout_of(gpu, key.look)),
            vertex: VertexState {
                module: &module,
                entry_point: Some("place"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &arrays,
            },
            primitive: PrimitiveState::default(),
            depth_stencil: Some(DepthStencilState {
                format: DEPTH_FORMAT,
                depth_write_enabled: Some(match key.search {
                    None => key.writes_depth,
                    Some(search) => search == Search::Found,
                }),
                depth_compare: Some(CompareFunction::Greater),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: MultisampleState {
                count: if key.four { 4 } else { 1 },
                ..MultisampleState::default()
            },
            fragment: key.has_fragments().then_some(FragmentState {
                module: &module,
                entry_point: Some("shade"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &targets,
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

/// Formats of the targets and how shapes join what is there.
fn targets_of(gpu: &Gpu, key: &Key) -> Vec<Option<ColorTargetState>> {
    if key.search == Some(Search::Product) {
        // multiplies what is there by what the shape lets through
        let through = BlendComponent {
            src_factor: BlendFactor::Zero,
            dst_factor: BlendFactor::OneMinusSrc,
            operation: BlendOperation::Add,
        };
        let blend = Some(BlendState { color: through, alpha: BlendComponent::REPLACE });
        let format = gpu.product_format;
        return vec![Some(ColorTargetState { format, blend, write_mask: ColorWrites::ALL })];
    }
    let blend = (key.mixing == Mixing::Over).then_some(BlendState::PREMULTIPLIED_ALPHA_BLENDING);
    let drawn = |wanted: bool| {
        let (format, write_mask) = (gpu.color_format, ColorWrites::ALL);
        (wanted && key.search.is_none()).then_some(ColorTargetState { format, blend, write_mask })
    };
    let Targets { color, albedo, normal, ids } = key.targets;
    let write_mask = if key.holds("ID_TARGET") { ColorWrites::ALL } else { ColorWrites::empty() };
    let ids = ids.then_some(ColorTargetState { format: ID_FORMAT, blend: None, write_mask });
    trimmed(vec![drawn(color), drawn(albedo), drawn(normal), ids])
}

/// A list of targets without those at its end that are not there: pipelines and passes must agree.
pub(crate) fn trimmed<T>(mut targets: Vec<Option<T>>) -> Vec<Option<T>> {
    let length = targets.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
    targets.truncate(length);
    targets
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::device;
    use crate::gpu::tests::check_translation;
    use crate::job::Job;

    /// Keys of all shapes, looks, mixings, slabs and fades, for pictures of colour, of all planes and of
    /// depth alone.
    fn keys() -> Vec<Key> {
        let flags = [false, true];
        let color = Targets { color: true, ..Targets::default() };
        let all = Targets { albedo: true, normal: true, ids: true, ..color };
        let pictures = [(color, false), (color, true), (all, false), (Targets::default(), false)];
        let looks = [
            Look::Vertex,
            Look::Textured { trilinear: true },
            Look::Indirect { trilinear: false },
            Look::Parallax { trilinear: false, relit: false },
            Look::Parallax { trilinear: true, relit: true },
        ];
        let shapes =
            [Shapes::Indexed, Shapes::Triangles, Shapes::Cards, Shapes::Lines, Shapes::Points];
        let mixings = [Mixing::Opaque, Mixing::Test, Mixing::Coverage, Mixing::Over];
        let mut keys = Vec::new();
        for (shapes, look) in shapes.into_iter().flat_map(|s| looks.map(|look| (s, look))) {
            for (mixing, has_slab) in mixings.into_iter().flat_map(|m| flags.map(|f| (m, f))) {
                for (is_dithered, (targets, four)) in
                    flags.into_iter().flat_map(|d| pictures.map(|picture| (d, picture)))
                {
                    let search = None;
                    let writes_depth = true;
                    let key = Key {
                        shapes,
                        look,
                        mixing,
                        writes_depth,
                        has_slab,
                        is_dithered,
                        targets,
                        four,
                        search,
                    };
                    keys.push(key);
                    if mixing == Mixing::Over && !four {
                        keys.extend([Search::Product, Search::Found].map(|s| key.searched(s)));
                    }
                }
            }
        }
        keys
    }

    #[test]
    fn every_key_is_a_shader_of_metal_and_directx_too() {
        for key in keys() {
            check_translation(&key.source(), &key);
        }
    }

    #[test]
    fn every_key_has_a_shader() {
        let shared = match device::renderer_of(None, &Job::default()) {
            Err(LodError::NoAdapter { .. }) if std::env::var_os("CI").is_none() => return,
            found => found.expect("a card"),
        };
        let renderer = device::taken(&shared, &Job::default()).expect("nobody stops it");
        let gpu = renderer.gpu();
        let keys = keys();
        assert!(keys.len() > 1000, "{} keys", keys.len());
        for key in keys {
            drop(key.module(gpu));
            gpu.check().unwrap_or_else(|error| panic!("{key:?}: {error}"));
        }
    }
}
