//! Draws a list: uploads what is new, records a pass for each set of samples, and waits for it.

use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec4, Vec4Swizzles};
use wgpu::{
    BindGroup, Buffer, BufferUsages, Color, CommandEncoder, CommandEncoderDescriptor,
    ComputePassTimestampWrites, IndexFormat, LoadOp, Operations, QuerySet, QuerySetDescriptor,
    QueryType, RenderPass, RenderPassColorAttachment, RenderPassDepthStencilAttachment,
    RenderPassDescriptor, RenderPassTimestampWrites, StoreOp, SubmissionIndex, TextureView,
};

use crate::draw_list::{Blend, DrawList, Geometry, Source};
use crate::error::{LodError, check_finite, check_limit};
use crate::gpu::device::{Gpu, go_on};
use crate::gpu::packing::{Packed, Run, greatest_depth};
use crate::gpu::pipelines::{Mixing, Pipelines, Search, Shapes, Targets, trimmed};
use crate::gpu::readback::read;
use crate::gpu::resources::{Resources, empty_buffer, group};
use crate::gpu::sums::{Planes, Shape};
use crate::job::Job;
use crate::raster::samples::{self, SUBPIXEL_COUNT, SamplePosition};
use crate::raster::{EMPTY_ID, Frame, MAX_PIXEL_COUNT, Settings, Stats};
use crate::view::View;

/// The samples of a pixel's middle: what a set of four is drawn at on the card.
const MIDDLE: SamplePosition = [SUBPIXEL_COUNT / 2; 2];

/// What shaders know of the view, and of the set of samples that is drawn.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct ViewFacts {
    right: [f32; 4],
    down: [f32; 4],
    away: [f32; 4],
    scale: [f32; 4],
    sample: [u32; 4],
    size: [u32; 4],
}

/// A buffer that is written for each frame, and grows.
#[derive(Debug)]
struct Growing {
    label: &'static str,
    usage: BufferUsages,
    buffer: Option<Buffer>,
}

impl Growing {
    fn new(label: &'static str, usage: BufferUsages) -> Self {
        Self { label, usage, buffer: None }
    }

    fn write(&mut self, gpu: &Gpu, bytes: &[u8]) -> Result<&Buffer, LodError> {
        let kept = self.buffer.take().filter(|buffer| buffer.size() >= bytes.len() as u64);
        let buffer = match kept {
            Some(buffer) => buffer,
            None => empty_buffer(gpu, self.label, self.usage, bytes.len() as u64)?,
        };
        gpu.queue.write_buffer(&buffer, 0, bytes);
        Ok(self.buffer.insert(buffer))
    }
}

/// Two times of the card, and where they are read from.
#[derive(Debug)]
struct Clock {
    queries: QuerySet,
    resolved: Buffer,
    /// Milliseconds of a tick.
    period: f64,
}

impl Clock {
    fn new(gpu: &Gpu) -> Result<Option<Self>, LodError> {
        if !gpu.facts.has_timestamps {
            return Ok(None);
        }
        let queries = gpu.device.create_query_set(&QuerySetDescriptor {
            label: Some("clock"),
            ty: QueryType::Timestamp,
            count: 2,
        });
        let usage = BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC;
        let resolved = empty_buffer(gpu, "clock", usage, 16)?;
        let period = f64::from(gpu.queue.get_timestamp_period()) * 1e-6;
        Ok(Some(Self { queries, resolved, period }))
    }
}

/// A device with all that it keeps between pictures.
#[derive(Debug)]
pub(crate) struct Renderer {
    // dropped before the device
    pipelines: Pipelines,
    resources: Resources,
    planes: Option<Planes>,
    /// Whether the last picture's samples have been added up.
    is_summed: bool,
    clock: Option<Clock>,
    view: Buffer,
    instances: Growing,
    draws: Growing,
    items: Growing,
    arguments: Growing,
    gpu: Gpu,
}

/// What the passes over one list share.
struct Picture<'a> {
    list: &'a DrawList,
    view: &'a View,
    settings: &'a Settings,
    packed: &'a Packed,
    far: f64,
    frame: BindGroup,
    job: &'a Job,
}

impl Renderer {
    pub(crate) fn new(gpu: Gpu) -> Result<Self, LodError> {
        let storage = BufferUsages::STORAGE;
        let view_size = size_of::<ViewFacts>() as u64;
        Ok(Self {
            pipelines: Pipelines::new(&gpu),
            resources: Resources::new(&gpu)?,
            planes: None,
            is_summed: false,
            clock: Clock::new(&gpu)?,
            view: empty_buffer(&gpu, "view", BufferUsages::UNIFORM, view_size)?,
            instances: Growing::new("instances", storage),
            draws: Growing::new("draws", storage),
            items: Growing::new("items", storage),
            arguments: Growing::new("arguments", BufferUsages::INDIRECT),
            gpu,
        })
    }

    pub(crate) fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    #[cfg(test)]
    pub(crate) fn resources(&self) -> &Resources {
        &self.resources
    }

    /// Draws a list and copies the picture out.
    ///
    /// # Errors
    /// As [`Renderer::draw`].
    pub(crate) fn render(
        &mut self,
        list: &DrawList,
        view: &View,
        settings: &Settings,
        job: &Job,
    ) -> Result<Frame, LodError> {
        let stats = self.draw(list, view, settings, job)?;
        let planes = self.planes.as_ref().expect("just drawn");
        if !self.is_summed {
            let mut encoder = self.encoder();
            planes.add(&mut encoder, None);
            let submission = self.gpu.queue.submit([encoder.finish()]);
            self.gpu.wait(&submission, job)?;
        }
        let (width, height) = (view.width as usize, view.height as usize);
        let length = width * height;
        let count = |wanted: bool| if wanted { length } else { 0 };
        let (gpu, sums, outputs) = (&self.gpu, &planes.sums, settings.outputs);
        let normal: Vec<Vec4> = read(gpu, &sums.normal, count(outputs.normal), job)?;
        Ok(Frame {
            width,
            height,
            color: read(gpu, &sums.color, count(outputs.color), job)?,
            depth: read(gpu, &sums.depth, count(outputs.depth), job)?,
            ids: read(gpu, &sums.ids, count(outputs.ids), job)?,
            normal: normal.iter().map(|normal| normal.xyz()).collect(),
            albedo: read(gpu, &sums.albedo, count(outputs.albedo), job)?,
            color8: read(gpu, &sums.color8, count(outputs.color8), job)?,
            stats,
        })
    }

    /// Draws a list; the picture stays on the card. What the list shares is uploaded before time is taken;
    /// what is this frame's own is part of it.
    ///
    /// # Errors
    /// What the CPU renderer refuses; [`LodError::Limit`] for what the card cannot hold,
    /// [`LodError::Device`], [`LodError::Cancelled`].
    pub(crate) fn draw(
        &mut self,
        list: &DrawList,
        view: &View,
        settings: &Settings,
        job: &Job,
    ) -> Result<Stats, LodError> {
        self.gpu.begin();
        list.check()?;
        check_finite("background", &[settings.background])?;
        let pixel_count = u64::from(view.width) * u64::from(view.height);
        check_limit("size", pixel_count, MAX_PIXEL_COUNT, "pixels")?;
        let positions = samples::positions(settings.sample_count)?;
        let mut stats = Stats::default();
        stats.count(list);
        let shape = self.shape_of(list, view, settings);
        if self.planes.as_ref().is_none_or(|planes| planes.shape != shape) {
            // first the old ones' memory
            self.planes = None;
            self.planes = Some(Planes::new(&self.gpu, shape)?);
        }
        self.resources.prepare(&self.gpu, &self.pipelines, list, job)?;
        let start = Instant::now();
        let packed = Packed::new(list, view, shape.targets, shape.four)?;
        let packing = start.elapsed();
        for run in &packed.runs {
            go_on(job)?;
            self.pipelines.prepare(&self.gpu, run.key)?;
            if shape.searches && run.key.mixing == Mixing::Over {
                for search in [Search::Product, Search::Found] {
                    self.pipelines.prepare(&self.gpu, run.key.searched(search))?;
                }
            }
            self.resources.prepare_surface(&self.gpu, &self.pipelines, list, run.reads)?;
        }
        // what was uploaded is there before time is taken
        self.gpu.copied(job)?;
        let start = Instant::now();
        let is_own = |source: Source| source == Source::Own;
        if packed.runs.iter().any(|run| is_own(run.vertices) || is_own(run.indices)) {
            self.resources.upload_own(&self.gpu, &self.pipelines, &list.own, job)?;
        }
        let frame = self.upload(&packed)?;
        let bounds = |geometry: &Geometry| self.resources.bounds(geometry);
        let is_parallel = view.is_orthographic();
        let far = if is_parallel { greatest_depth(list, view, bounds) } else { 0.0 };
        let picture = Picture { list, view, settings, packed: &packed, far, frame, job };
        let (last, is_summed) = self.passes(&picture, &positions)?;
        self.is_summed = is_summed;
        self.gpu.wait(&last, job)?;
        stats.draw_millis = (packing + start.elapsed()).as_secs_f64() * 1e3;
        stats.vertex_count =
            packed.corner_count * if shape.four { 1 } else { positions.len() as u64 };
        if let Some(clock) = &self.clock {
            let ticks: Vec<u64> = read(&self.gpu, &clock.resolved, 2, job)?;
            let passed = ticks[1].saturating_sub(ticks[0]) as f64;
            stats.gpu_millis = Some(passed * clock.period);
        }
        Ok(stats)
    }

    /// Which planes a picture needs.
    fn shape_of(&self, list: &DrawList, view: &View, settings: &Settings) -> Shape {
        let outputs = settings.outputs;
        let targets = Targets {
            color: outputs.color || outputs.color8,
            albedo: outputs.albedo,
            normal: outputs.normal,
            ids: outputs.ids,
        };
        let depth = outputs.depth || outputs.ids;
        let searches = depth && list.items.iter().any(|item| item.blend == Blend::Over);
        let color_alone = Targets { color: true, ..Targets::default() };
        let four = settings.sample_count == 4
            && self.gpu.has_four_samples
            && targets == color_alone
            && !searches;
        let color8 = outputs.color8;
        Shape { width: view.width, height: view.height, targets, depth, color8, four, searches }
    }

    /// Writes what is packed, and groups what all passes read.
    fn upload(&mut self, packed: &Packed) -> Result<BindGroup, LodError> {
        let gpu = &self.gpu;
        let instances = self.instances.write(gpu, bytemuck::cast_slice(&packed.instances))?;
        let draws = self.draws.write(gpu, bytemuck::cast_slice(&packed.draws))?;
        let items = self.items.write(gpu, bytemuck::cast_slice(&packed.items))?;
        self.arguments.write(gpu, bytemuck::cast_slice(&packed.arguments))?;
        let planes = self.planes.as_ref().expect("made before");
        let bound = [&self.view, instances, draws, items, &planes.found];
        let resources = bound.map(Buffer::as_entire_binding);
        Ok(group(gpu, "frame", &self.pipelines.frame, &resources))
    }

    /// One pass for each set of samples; the last submission, and whether samples were added up.
    fn passes(
        &self,
        picture: &Picture<'_>,
        positions: &[SamplePosition],
    ) -> Result<(SubmissionIndex, bool), LodError> {
        let planes = self.planes.as_ref().expect("made before");
        let four = planes.shape.four;
        // sample, its number in its set, and the size of that
        let mut passes: Vec<(SamplePosition, u32, u32)> = Vec::new();
        let mut left = positions;
        while !left.is_empty() {
            let (set, rest) = left.split_at(samples::pass_size(left.len()));
            left = rest;
            let size = u32::try_from(set.len()).expect("at most 16");
            passes.extend((0..).zip(set).map(|(number, &position)| (position, number, size)));
        }
        if four {
            passes = vec![(MIDDLE, 0, 4)];
        }
        let weight = 1.0 / picture.settings.sample_count as f32;
        let background = picture.settings.background;
        let (sums, finishes) =
            (planes.needs_sum(passes.len(), background), planes.needs_finish(background));
        let clock = self.clock.as_ref();
        let end = |is_end: bool| {
            clock.filter(|_| is_end).map(|clock| ComputePassTimestampWrites {
                query_set: &clock.queries,
                beginning_of_pass_write_index: None,
                end_of_pass_write_index: Some(1),
            })
        };
        let mut submitted = None;
        for (number, &(position, in_set, set_size)) in passes.iter().enumerate() {
            let (is_first, is_last) = (number == 0, number + 1 == passes.len());
            let facts = (weight, is_first);
            planes.write_facts(&self.gpu, picture.view, picture.far, background, facts);
            let sample = [in_set, set_size, 0, 0];
            let mut encoder = self.encoder();
            self.write_view(picture, position, sample);
            self.draw_set(&mut encoder, picture, (is_first, is_last && !sums));
            if planes.shape.searches {
                self.submit(encoder, &mut submitted, picture.job)?;
                self.search(picture, (position, sample), &mut submitted)?;
                encoder = self.encoder();
            }
            if sums {
                planes.add(&mut encoder, end(is_last && !finishes));
            }
            if is_last && finishes {
                planes.finish(&mut encoder, end(true));
            }
            if let Some(clock) = clock.filter(|_| is_last) {
                encoder.resolve_query_set(&clock.queries, 0..2, &clock.resolved, 0);
            }
            self.submit(encoder, &mut submitted, picture.job)?;
        }
        Ok((submitted.expect("at least one sample"), sums))
    }

    fn encoder(&self) -> CommandEncoder {
        let label = Some("picture");
        self.gpu.device.create_command_encoder(&CommandEncoderDescriptor { label })
    }

    /// Hands commands over once the ones before the last are done: what was asked for and is not wanted
    /// any more does not keep the card busy for long.
    fn submit(
        &self,
        encoder: CommandEncoder,
        submitted: &mut Option<SubmissionIndex>,
        job: &Job,
    ) -> Result<(), LodError> {
        let index = self.gpu.queue.submit([encoder.finish()]);
        if let Some(before) = submitted.replace(index) {
            self.gpu.wait(&before, job)?;
        }
        Ok(())
    }

    fn write_view(&self, picture: &Picture<'_>, [x, y]: SamplePosition, sample: [u32; 4]) {
        let Picture { view, far, .. } = picture;
        let scale = view.pixels_per_metre_at_one();
        let shift = |at: i32| (SUBPIXEL_COUNT / 2 - at) as f32 / SUBPIXEL_COUNT as f32;
        let row = |axis: DVec3, last: f32| axis.as_vec3().extend(last).to_array();
        #[expect(clippy::cast_possible_truncation, reason = "numbers of the card are f32")]
        let (near, far) = (view.near as f32, *far as f32);
        let (width, height) = (view.width, view.height);
        let facts = ViewFacts {
            right: row(view.right * (scale * view.pixel_aspect), shift(x)),
            down: row(-view.up * scale, shift(y)),
            away: row(-view.back, near),
            scale: [
                2.0 / width as f32,
                2.0 / height as f32,
                far,
                if view.is_orthographic() { 0.0 } else { 1.0 },
            ],
            sample,
            size: [width, height, 0, 0],
        };
        self.gpu.queue.write_buffer(&self.view, 0, bytemuck::bytes_of(&facts));
    }

    /// Draws everything once; whether that is the picture's first pass, and whether its last.
    fn draw_set(
        &self,
        encoder: &mut CommandEncoder,
        picture: &Picture<'_>,
        (is_first, is_last): (bool, bool),
    ) {
        let planes = self.planes.as_ref().expect("made before");
        let (drawn, targets) = (&planes.drawn, planes.shape.targets);
        let mut colors = trimmed(vec![
            attachment(&drawn.color, targets.color, Color::TRANSPARENT),
            attachment(&drawn.albedo, targets.albedo, Color::TRANSPARENT),
            attachment(&drawn.normal, targets.normal, Color::TRANSPARENT),
            attachment(&drawn.ids, targets.ids, Color { r: f64::from(EMPTY_ID), ..Color::BLACK }),
        ]);
        if let (Some(Some(color)), Some(resolved)) = (colors.first_mut(), &drawn.resolved) {
            color.resolve_target = Some(resolved);
            color.ops.store = StoreOp::Discard;
        }
        let mut depth = depth_attachment(&drawn.depth, LoadOp::Clear(0.0));
        if let Some(ops) = depth.depth_ops.as_mut().filter(|_| !planes.shape.depth) {
            ops.store = StoreOp::Discard;
        }
        let clock = self.clock.as_ref().filter(|_| is_first || is_last);
        let mut pass = encoder.begin_render_pass(&RenderPassDescriptor {
            label: Some("shapes"),
            color_attachments: &colors,
            depth_stencil_attachment: Some(depth),
            timestamp_writes: clock.map(|clock| RenderPassTimestampWrites {
                query_set: &clock.queries,
                beginning_of_pass_write_index: is_first.then_some(0),
                end_of_pass_write_index: is_last.then_some(1),
            }),
            occlusion_query_set: None,
            multiview_mask: None,
        });
        self.draw_runs(&mut pass, picture, None);
    }

    /// Moves the depth and id of pixels whose blended shapes hide half of what is behind to the shape that
    /// does it.
    fn search(
        &self,
        picture: &Picture<'_>,
        (position, sample): (SamplePosition, [u32; 4]),
        submitted: &mut Option<SubmissionIndex>,
    ) -> Result<(), LodError> {
        let planes = self.planes.as_ref().expect("made before");
        let drawn = &planes.drawn;
        let bits = u32::BITS - picture.packed.blended_count.leading_zeros();
        for bit in (0..bits).rev() {
            let step = 1 << bit;
            self.write_view(picture, position, [sample[0], sample[1], step, 0]);
            let mut encoder = self.encoder();
            if bit + 1 == bits {
                encoder.clear_buffer(&planes.found, 0, None);
            }
            let colors = [attachment(&drawn.product, true, Color::WHITE)];
            {
                let mut pass = encoder.begin_render_pass(&RenderPassDescriptor {
                    label: Some("what is let through"),
                    color_attachments: &colors,
                    depth_stencil_attachment: Some(depth_attachment(&drawn.depth, LoadOp::Load)),
                    ..RenderPassDescriptor::default()
                });
                self.draw_runs(&mut pass, picture, Some(Search::Product));
            }
            planes.search(&self.gpu, &mut encoder, step);
            self.submit(encoder, submitted, picture.job)?;
        }
        let mut encoder = self.encoder();
        let mut ids = attachment(&drawn.ids, planes.shape.targets.ids, Color::BLACK);
        if let Some(ids) = &mut ids {
            ids.ops.load = LoadOp::Load;
        }
        {
            let mut pass = encoder.begin_render_pass(&RenderPassDescriptor {
                label: Some("what was found"),
                color_attachments: &trimmed(vec![None, None, None, ids]),
                depth_stencil_attachment: Some(depth_attachment(&drawn.depth, LoadOp::Load)),
                ..RenderPassDescriptor::default()
            });
            self.draw_runs(&mut pass, picture, Some(Search::Found));
        }
        self.submit(encoder, submitted, picture.job)
    }

    /// Calls that draw a list, or its blended shapes for a search.
    fn draw_runs(&self, pass: &mut RenderPass<'_>, picture: &Picture<'_>, search: Option<Search>) {
        let Picture { list, packed, frame, .. } = picture;
        let arguments = self.arguments.buffer.as_ref().expect("written before");
        pass.set_bind_group(0, frame, &[]);
        let wanted = |run: &&Run| search.is_none() || run.key.mixing == Mixing::Over;
        for run in packed.runs.iter().filter(wanted) {
            let key = search.map_or(run.key, |search| run.key.searched(search));
            pass.set_pipeline(self.pipelines.get(&key));
            let vertices = self.resources.arrays(list, run.vertices);
            pass.set_bind_group(1, &vertices.vertices, &[]);
            for (slot, (number, _)) in (0..).zip(key.attributes()) {
                let buffer = &vertices.vertex_buffers[number as usize];
                pass.set_vertex_buffer(slot, buffer.slice(..));
            }
            let indices = self.resources.arrays(list, run.indices);
            pass.set_bind_group(2, &indices.indices, &[]);
            if let Some(surface) = self.resources.surface(list, run.reads) {
                pass.set_bind_group(3, surface, &[]);
            }
            let offset = (run.first_word * size_of::<u32>()) as u64;
            if run.key.shapes == Shapes::Indexed && key.shapes == Shapes::Triangles {
                // the same triangles by their numbers
                for words in run.arguments(&packed.arguments) {
                    let [count, copies, first, _, first_copy] = *words else { continue };
                    pass.draw(first..first + count, first_copy..first_copy + copies);
                }
            } else if run.is_indexed() {
                let buffer = match run.key.shapes {
                    Shapes::Indexed => &indices.index_buffer,
                    _ => &self.resources.pattern,
                };
                pass.set_index_buffer(buffer.slice(..), IndexFormat::Uint32);
                pass.multi_draw_indexed_indirect(arguments, offset, run.call_count);
            } else {
                pass.multi_draw_indirect(arguments, offset, run.call_count);
            }
        }
    }
}

fn attachment(
    view: &TextureView,
    wanted: bool,
    clear: Color,
) -> Option<RenderPassColorAttachment<'_>> {
    let ops = Operations { load: LoadOp::Clear(clear), store: StoreOp::Store };
    wanted.then_some(RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops,
    })
}

fn depth_attachment(view: &TextureView, load: LoadOp<f32>) -> RenderPassDepthStencilAttachment<'_> {
    let depth_ops = Some(Operations { load, store: StoreOp::Store });
    RenderPassDepthStencilAttachment { view, depth_ops, stencil_ops: None }
}
