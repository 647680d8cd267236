//! Which adapters there are, and the one device that is opened on each.
//!
//! A device is opened by the first picture that is drawn with it and kept for the next ones. It belongs to
//! the process that opened it: a child of a fork gets [`LodError::Forked`]. [`close_all`] drops every
//! device before the process ends, because some drivers hang when it is left to them. What a device
//! refuses is kept and becomes an error of the call that caused it; a device that is lost is forgotten,
//! so that the next call opens another.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use wgpu::{
    Adapter, Backends, Device, DeviceDescriptor, DeviceType, ErrorFilter, Features, Instance,
    InstanceDescriptor, InstanceFlags, Limits, PollType, Queue, SubmissionIndex, TextureFormat,
    TextureFormatFeatureFlags, TextureUsages,
};

use crate::error::LodError;
use crate::gpu::renderer::Renderer;
use crate::job::Job;

/// Names the adapter where a call states none.
pub const ADAPTER_VARIABLE: &str = "TREELOD_ADAPTER";

/// What to do where there is no adapter.
const WHAT_TO_INSTALL: &str = "install the graphics card's Vulkan driver, or Mesa's, which also draws \
                               without a card (Debian: apt-get install mesa-vulkan-drivers libvulkan1)";

/// Storage buffers that the vertex stage of a shape reads.
const STORAGE_BUFFER_COUNT: u32 = 11;

/// Of the memory that the driver says there is: more is refused where the driver itself would not.
const MEMORY_PERCENT: u8 = 90;

/// Bytes that may wait to be copied: they are memory, too.
const MOST_WAITING_BYTES: u64 = 1 << 26;

/// How long the end of a process waits for its devices.
const LONGEST_END: Duration = Duration::from_secs(5);

/// How long a wait for the device lasts before it looks whether somebody wants it to stop.
const PATIENCE: Duration = Duration::from_millis(20);

/// A graphics adapter, as its driver describes it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AdapterFacts {
    /// Its name, which chooses it.
    pub name: String,
    /// "discrete", "integrated", "virtual", "cpu" or "other".
    pub kind: &'static str,
    /// "vulkan", "metal" or "dx12".
    pub api: String,
    /// The driver and its version.
    pub driver: String,
    /// Whether it tells how long it takes itself.
    pub has_timestamps: bool,
}

impl AdapterFacts {
    fn of(adapter: &Adapter) -> Self {
        let info = adapter.get_info();
        let driver = format!("{} {}", info.driver, info.driver_info);
        Self {
            name: info.name,
            kind: match info.device_type {
                DeviceType::DiscreteGpu => "discrete",
                DeviceType::IntegratedGpu => "integrated",
                DeviceType::VirtualGpu => "virtual",
                DeviceType::Cpu => "cpu",
                DeviceType::Other => "other",
            },
            api: info.backend.to_string(),
            driver: driver.trim().to_owned(),
            has_timestamps: adapter.features().contains(Features::TIMESTAMP_QUERY),
        }
    }

    /// Which is taken where nobody chooses: cards before what draws on the processor.
    fn rank(&self) -> usize {
        let order = ["discrete", "integrated", "virtual", "other", "cpu"];
        order.iter().position(|kind| *kind == self.kind).unwrap_or(order.len())
    }
}

/// What is shared by all that is done with a device.
#[derive(Debug)]
pub(crate) struct Gpu {
    pub(crate) device: Device,
    pub(crate) queue: Queue,
    pub(crate) facts: AdapterFacts,
    pub(crate) limits: Limits,
    /// Of pictures while they are drawn: floats, or halves where floats cannot be blended.
    pub(crate) color_format: TextureFormat,
    /// Of one number a pixel that is multiplied.
    pub(crate) product_format: TextureFormat,
    /// Whether four samples of the colour format can be drawn at once.
    pub(crate) has_four_samples: bool,
    /// Whether the card itself takes the mean of those.
    pub(crate) resolves: bool,
    /// Why it is of no more use.
    lost: Arc<Mutex<Option<String>>>,
    /// What it refused.
    refused: Arc<Mutex<Vec<String>>>,
    /// Bytes that wait to be copied to the card.
    waiting_bytes: AtomicU64,
}

impl Gpu {
    fn open(adapter: &Adapter) -> Result<Self, LodError> {
        let facts = AdapterFacts::of(adapter);
        let wanted = Features::TIMESTAMP_QUERY
            | Features::FLOAT32_BLENDABLE
            | Features::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES
            | Features::INDIRECT_FIRST_INSTANCE;
        let features = adapter.features() & wanted;
        let limits = adapter.limits();
        let descriptor = DeviceDescriptor {
            label: Some("treelod"),
            required_features: features,
            required_limits: limits.clone(),
            ..DeviceDescriptor::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| LodError::Device { why: format!("did not open: {error}") })?;
        let lost = Arc::new(Mutex::new(None));
        let refused = Arc::new(Mutex::new(Vec::new()));
        let told = Arc::clone(&lost);
        device.set_device_lost_callback(move |reason, message| {
            *locked(&told) = Some(format!("{reason:?}: {message}"));
        });
        let told = Arc::clone(&refused);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            locked(&told).push(error.to_string());
        }));
        let blends_floats = features.contains(Features::FLOAT32_BLENDABLE);
        let (color_format, product_format) = if blends_floats {
            (TextureFormat::Rgba32Float, TextureFormat::R32Float)
        } else {
            (TextureFormat::Rgba16Float, TextureFormat::R16Float)
        };
        let drawn = adapter.get_texture_format_features(color_format);
        let has_four_samples = drawn.flags.sample_count_supported(4)
            && drawn.allowed_usages.contains(TextureUsages::RENDER_ATTACHMENT)
            && (!blends_floats
                || features.contains(Features::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES));
        let resolves = drawn.flags.contains(TextureFormatFeatureFlags::MULTISAMPLE_RESOLVE);
        Ok(Self {
            device,
            queue,
            facts,
            limits,
            color_format,
            product_format,
            has_four_samples,
            resolves,
            lost,
            refused,
            waiting_bytes: AtomicU64::new(0),
        })
    }

    /// Forgets what a call before has left.
    pub(crate) fn begin(&self) {
        locked(&self.refused).clear();
    }

    /// Counts bytes that were handed over to be copied, and waits for the copies before they take much
    /// memory.
    ///
    /// # Errors
    /// As [`Gpu::wait`].
    pub(crate) fn handed_over(&self, byte_count: usize, job: &Job) -> Result<(), LodError> {
        let waiting = self.waiting_bytes.fetch_add(byte_count as u64, Ordering::Relaxed);
        if waiting + byte_count as u64 >= MOST_WAITING_BYTES {
            self.copied(job)?;
        }
        go_on(job)
    }

    /// Waits until what was handed over is on the card.
    ///
    /// # Errors
    /// As [`Gpu::wait`].
    pub(crate) fn copied(&self, job: &Job) -> Result<(), LodError> {
        self.waiting_bytes.store(0, Ordering::Relaxed);
        let submission = self.queue.submit([]);
        self.wait(&submission, job)
    }

    /// Lets it tell what has happened to it.
    fn look(&self) {
        // what it answers is told to those who wait
        let _ = self.device.poll(PollType::Poll);
    }

    /// Whether it is of no more use.
    pub(crate) fn is_lost(&self) -> bool {
        self.look();
        locked(&self.lost).is_some()
    }

    /// What it has refused since the last call, or why it was lost.
    ///
    /// # Errors
    /// [`LodError::Device`].
    pub(crate) fn check(&self) -> Result<(), LodError> {
        let refused = std::mem::take(&mut *locked(&self.refused));
        if let Some(why) = &*locked(&self.lost) {
            return Err(LodError::Device { why: format!("was lost ({why})") });
        }
        match refused.first() {
            None => Ok(()),
            Some(first) => Err(LodError::Device { why: format!("refused a command: {first}") }),
        }
    }

    /// Runs what allocates, and says if the device ran out of memory.
    ///
    /// # Errors
    /// [`LodError::Device`].
    pub(crate) fn allocating<T>(&self, allocate: impl FnOnce() -> T) -> Result<T, LodError> {
        let scope = self.device.push_error_scope(ErrorFilter::OutOfMemory);
        let made = allocate();
        match pollster::block_on(scope.pop()) {
            None => self.check().map(|()| made),
            Some(error) => {
                locked(&self.refused).clear();
                Err(LodError::Device { why: format!("is out of memory: {error}") })
            }
        }
    }

    /// Fails on purpose.
    ///
    /// # Errors
    /// What a failure of that kind is.
    pub(crate) fn fail(&self, kind: &str) -> Result<(), LodError> {
        match kind {
            "lost" => {
                self.device.destroy();
                self.wait(&self.queue.submit([]), &Job::default())
            }
            "memory" => {
                // 16 GiB each, more of them than any card has
                let side = self.limits.max_texture_dimension_2d;
                let descriptor = wgpu::TextureDescriptor {
                    label: Some("too much"),
                    size: wgpu::Extent3d { width: side, height: side, depth_or_array_layers: 1 },
                    mip_level_count: 1,
                    sample_count: if self.has_four_samples { 4 } else { 1 },
                    dimension: wgpu::TextureDimension::D2,
                    format: self.color_format,
                    usage: TextureUsages::RENDER_ATTACHMENT,
                    view_formats: &[],
                };
                let create = || self.device.create_texture(&descriptor);
                let held: Result<Vec<_>, LodError> =
                    (0..256).map(|_| self.allocating(create)).collect();
                held.map(drop)
            }
            _ => {
                // a size that no limit allows
                let _ = self.device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("too large"),
                    size: u64::MAX - 3,
                    usage: wgpu::BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                });
                self.check()
            }
        }
    }

    /// Waits until a submission is done.
    ///
    /// # Errors
    /// [`LodError::Cancelled`], and what the device refused or why it was lost.
    pub(crate) fn wait(&self, submission: &SubmissionIndex, job: &Job) -> Result<(), LodError> {
        loop {
            go_on(job)?;
            let wait = PollType::Wait {
                submission_index: Some(submission.clone()),
                timeout: Some(PATIENCE),
            };
            match self.device.poll(wait) {
                Ok(_) => return self.check(),
                Err(wgpu::PollError::Timeout) => self.check()?,
                Err(error) => {
                    // nothing is submitted to a device that is lost
                    self.look();
                    self.check()?;
                    return Err(LodError::Device { why: format!("cannot be waited for: {error}") });
                }
            }
        }
    }
}

/// Refuses to go on when nobody wants the picture any more, or the process ends.
///
/// # Errors
/// [`LodError::Cancelled`], [`LodError::Device`].
pub(crate) fn go_on(job: &Job) -> Result<(), LodError> {
    job.check()?;
    check_open()
}

fn check_open() -> Result<(), LodError> {
    if CLOSES.load(Ordering::Acquire) {
        return Err(LodError::Device { why: "is closed: the process ends".to_owned() });
    }
    Ok(())
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Devices that are open, by their adapter.
struct Registry {
    instance: Option<Instance>,
    /// All there are, once somebody asked; the one that is taken where nobody chooses first.
    adapters: Vec<(AdapterFacts, Adapter)>,
    /// By their adapters' places in that list.
    open: Vec<(usize, Arc<Mutex<Renderer>>)>,
}

static REGISTRY: Mutex<Registry> =
    Mutex::new(Registry { instance: None, adapters: Vec::new(), open: Vec::new() });

/// Set when the process ends: whoever still waits for a device must let go of it.
static CLOSES: AtomicBool = AtomicBool::new(false);

/// Process that used the registry first; 0 before that. Beside the lock, which a fork may leave locked.
static OWNER: AtomicU32 = AtomicU32::new(0);

/// Waits for whoever opens a device, but not after that is of no use.
fn registry(job: &Job) -> Result<MutexGuard<'static, Registry>, LodError> {
    let process = std::process::id();
    match OWNER.compare_exchange(0, process, Ordering::AcqRel, Ordering::Acquire) {
        Err(owner) if owner != process => Err(LodError::Forked),
        _ => taken(&REGISTRY, job),
    }
}

impl Registry {
    fn adapters(&mut self) -> Result<&[(AdapterFacts, Adapter)], LodError> {
        check_open()?;
        if self.adapters.is_empty() {
            let instance = self.instance.get_or_insert_with(|| {
                let mut descriptor = InstanceDescriptor::new_without_display_handle();
                descriptor.backends = Backends::VULKAN | Backends::METAL | Backends::DX12;
                descriptor.flags = InstanceFlags::from_build_config().with_env();
                if !cfg!(windows) {
                    // the arguments of indirect draws are our own; DirectX 12 numbers corners and copies
                    // from 0 without the check
                    descriptor.flags.remove(InstanceFlags::VALIDATION_INDIRECT_CALL);
                }
                descriptor.memory_budget_thresholds.for_resource_creation = Some(MEMORY_PERCENT);
                Instance::new(descriptor)
            });
            let found = pollster::block_on(instance.enumerate_adapters(Backends::all()));
            let facts = |adapter: Adapter| (AdapterFacts::of(&adapter), adapter);
            self.adapters = found.into_iter().filter(can_draw).map(facts).collect();
            self.adapters.sort_by_key(|(facts, _)| facts.rank());
        }
        Ok(&self.adapters)
    }
}

/// Whether an adapter has what drawing needs: old ones lack it.
fn can_draw(adapter: &Adapter) -> bool {
    adapter.limits().max_storage_buffers_per_shader_stage >= STORAGE_BUFFER_COUNT
        && adapter.features().contains(Features::INDIRECT_FIRST_INSTANCE)
}

/// The adapters of this machine, the one that is taken where nobody chooses first.
///
/// # Errors
/// [`LodError::Forked`] in a child of the process that asked first.
pub fn adapters(job: &Job) -> Result<Vec<AdapterFacts>, LodError> {
    Ok(registry(job)?.adapters()?.iter().map(|(facts, _)| facts.clone()).collect())
}

/// The renderer of the adapter whose name contains `name`, in any case, or which is of that kind or spoken to
/// through that interface, or whose place in the list of [`adapters`] that is, as in `#1`, from 0; nothing: what
/// `TREELOD_ADAPTER` names, else the first.
///
/// # Errors
/// [`LodError::NoAdapter`] if there is none, [`LodError::Device`] if it does not open.
pub(crate) fn renderer_of(name: Option<&str>, job: &Job) -> Result<Arc<Mutex<Renderer>>, LodError> {
    let stated = |text: String| Some(text.trim().to_lowercase()).filter(|text| !text.is_empty());
    let variable = || std::env::var(ADAPTER_VARIABLE).ok().and_then(stated);
    let argument = name.map(str::to_owned).and_then(stated);
    let is_variable = argument.is_none();
    let wanted = argument.or_else(variable);
    let mut registry = registry(job)?;
    let adapters = registry.adapters()?;
    let fits = |(place, (facts, _)): (usize, &(AdapterFacts, Adapter))| {
        let name = facts.name.to_lowercase();
        wanted.as_ref().is_none_or(|wanted| {
            let is_name = name.contains(wanted) || facts.kind == wanted || facts.api == *wanted;
            is_name || *wanted == format!("#{place}")
        })
    };
    let Some(place) = adapters.iter().enumerate().position(fits) else {
        let names: Vec<String> = adapters.iter().map(|(f, _)| format!("{:?}", f.name)).collect();
        let why = match wanted {
            Some(wanted) if !names.is_empty() => {
                let said = if is_variable { ADAPTER_VARIABLE } else { "adapter" };
                let there = names.join(", ");
                format!(
                    "{said} is {wanted:?}, and no graphics adapter is called so; there are {there}"
                )
            }
            _ => format!("there is no graphics adapter: {WHAT_TO_INSTALL}"),
        };
        return Err(LodError::NoAdapter { why });
    };
    let (_, adapter) = adapters[place].clone();
    registry.open.retain(|(_, renderer)| match renderer.try_lock() {
        Ok(renderer) => !renderer.gpu().is_lost(),
        Err(TryLockError::WouldBlock) => true,
        Err(TryLockError::Poisoned(_)) => false,
    });
    if let Some((_, renderer)) = registry.open.iter().find(|(open, _)| *open == place) {
        return Ok(Arc::clone(renderer));
    }
    let renderer = Arc::new(Mutex::new(Renderer::new(Gpu::open(&adapter)?)?));
    registry.open.push((place, Arc::clone(&renderer)));
    Ok(renderer)
}

/// A renderer of the first adapter that nobody else draws with; `None` without an adapter.
#[cfg(test)]
pub(crate) fn renderer_of_its_own() -> Option<Renderer> {
    let mut registry = registry(&Job::default()).expect("not forked");
    let adapters = registry.adapters().expect("open");
    let (_, adapter) = adapters.first()?;
    let gpu = Gpu::open(adapter).expect("it opens");
    Some(Renderer::new(gpu).expect("a renderer"))
}

/// Waits for others to be done with something, unless somebody wants it to stop.
///
/// # Errors
/// As [`go_on`].
pub(crate) fn taken<'a, T>(shared: &'a Mutex<T>, job: &Job) -> Result<MutexGuard<'a, T>, LodError> {
    loop {
        go_on(job)?;
        match shared.try_lock() {
            Ok(guard) => return Ok(guard),
            Err(TryLockError::Poisoned(poisoned)) => return Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(1)),
        }
    }
}

/// Lets go of every device with all that is on it; the next picture opens another.
///
/// # Errors
/// [`LodError::Forked`], [`LodError::Cancelled`].
pub fn release(job: &Job) -> Result<(), LodError> {
    registry(job)?.open.clear();
    Ok(())
}

/// Drops every device, if this process has any, once whoever draws has let go of it; none can be opened
/// after that. A device that does not come to rest is left to the end of the process.
pub fn close_all() {
    if OWNER.load(Ordering::Acquire) != std::process::id() {
        return;
    }
    CLOSES.store(true, Ordering::Release);
    let deadline = Instant::now() + LONGEST_END;
    let mut registry = loop {
        match REGISTRY.try_lock() {
            Ok(registry) => break registry,
            Err(TryLockError::Poisoned(poisoned)) => break poisoned.into_inner(),
            Err(TryLockError::WouldBlock) if Instant::now() > deadline => return,
            Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(1)),
        }
    };
    for (_, renderer) in registry.open.drain(..) {
        while Instant::now() < deadline {
            if let Ok(renderer) = renderer.try_lock() {
                // what was submitted goes on until it is done
                let timeout = Some(deadline.saturating_duration_since(Instant::now()));
                let wait = PollType::Wait { submission_index: None, timeout };
                let _ = renderer.gpu().device.poll(wait);
                break;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    registry.adapters.clear();
    registry.instance = None;
}
