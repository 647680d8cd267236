//! The one gate between Python and a kernel: detached, stoppable, and safe against panics.
//!
//! A kernel runs on a thread of its own inside the chosen pool, without the interpreter. The
//! caller's thread waits and looks up at short intervals: a pending signal or an exception of the
//! progress callback cancels the [`Job`], and the call returns once the kernel has stopped. A panic
//! becomes `treelod.InternalError`; pyo3's own `PanicException` would slip past `except Exception`.
//!
//! A kernel touches no Python object, but for a criterion's function, which attaches to the interpreter
//! while the caller waits without it. Such a function must not start another kernel: it would wait for
//! the thread that it runs on, so that is refused.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use rayon::prelude::*;

use crate::error::{LodError, check_in};
use crate::job::{self, Job};

/// How often the waiting thread looks for signals: soon enough to feel immediate.
const POLL_INTERVAL: Duration = Duration::from_millis(40);

type Outcome<T> = Result<Result<T, LodError>, Box<dyn Any + Send>>;

/// Runs `kernel` in the pool of `thread_count` threads (`None`: the default) without the
/// interpreter.
///
/// `progress` is called as `progress(done, total)` while the kernel runs, whenever `done` has
/// changed, and once at its end; what it raises cancels the kernel.
///
/// # Errors
/// What the kernel returned, as a Python exception; `InternalError` if it panicked; the signal
/// handler's or the callback's exception if one of them raised.
pub(super) fn run<T: Send>(
    py: Python<'_>,
    thread_count: Option<usize>,
    progress: Option<Py<PyAny>>,
    kernel: impl FnOnce(&Job) -> Result<T, LodError> + Send,
) -> PyResult<T> {
    super::criteria::check_not_inside()?;
    let mut watch = Watch { progress, reported: (0, 0) };
    py.detach(|| {
        let job = Job::default();
        let (outcome, interruption) = thread::scope(|scope| {
            let (sender, receiver) = mpsc::channel::<Outcome<T>>();
            let work = || job::run(thread_count, || kernel(&job));
            let worker = thread::Builder::new().name("treelod-call".to_owned());
            let spawned = worker.spawn_scoped(scope, move || {
                // fails only if nobody waits any more, and then nobody wants the outcome
                let _ = sender.send(catch_unwind(AssertUnwindSafe(work)));
            });
            if let Err(error) = spawned {
                let why = format!("the system gave no thread to run on: {error}");
                return (Ok(Err(LodError::Invalid { name: "threads", why })), None);
            }
            let mut interruption = None;
            loop {
                match receiver.recv_timeout(POLL_INTERVAL) {
                    Ok(outcome) => return (outcome, interruption),
                    Err(RecvTimeoutError::Timeout) if interruption.is_none() => {
                        if let Err(error) = Python::attach(|py| watch.look(py, &job)) {
                            job.cancel();
                            interruption = Some(error);
                        }
                    }
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => {
                        let text: Box<dyn Any + Send> = Box::new("the kernel's thread vanished");
                        return (Err(text), interruption);
                    }
                }
            }
        });
        match outcome {
            Err(panic) => Err(super::internal_error(format!(
                "{} (a bug in treelod: please report it)",
                panic_text(panic.as_ref())
            ))),
            Ok(result) => {
                if let Some(error) = interruption {
                    if let Err(unseen) = &result {
                        super::criteria::forget_raised(unseen);
                    }
                    return Err(error);
                }
                let value = result?;
                Python::attach(|py| watch.report(py, &job))?;
                Ok(value)
            }
        }
    })
}

/// What the waiting thread looks after.
struct Watch {
    progress: Option<Py<PyAny>>,
    reported: (u64, u64),
}

impl Watch {
    fn look(&mut self, py: Python<'_>, job: &Job) -> PyResult<()> {
        py.check_signals()?;
        self.report(py, job)
    }

    fn report(&mut self, py: Python<'_>, job: &Job) -> PyResult<()> {
        let now = job.progress();
        if let Some(progress) = &self.progress
            && now != self.reported
        {
            self.reported = now;
            progress.call1(py, now)?;
        }
        Ok(())
    }
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    match (panic.downcast_ref::<&str>(), panic.downcast_ref::<String>()) {
        (Some(text), _) => text,
        (_, Some(text)) => text,
        _ => "a panic without a text",
    }
}

/// Panics on a thread of the pool, to prove what becomes of a panic.
#[pyfunction]
pub(super) fn _panic_for_test(py: Python<'_>) -> PyResult<()> {
    run(py, None, None, |_| {
        (0..64).into_par_iter().for_each(|index| assert!(index != 13, "panic at index {index}"));
        Ok(())
    })
}

/// Keeps one thread of the pool for `secs` seconds, in steps of a millisecond.
#[pyfunction]
#[pyo3(signature = (secs, *, threads=None, progress=None))]
pub(super) fn _spin_for_test(
    py: Python<'_>,
    secs: f64,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<()> {
    check_in("secs", secs, 0.0..=3600.0)?;
    run(py, threads, progress, |job| {
        let start = Instant::now();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "3600 s at most"
        )]
        let step_count = (secs * 1000.0).ceil() as u64;
        job.begin(step_count);
        for step in 1..=step_count {
            job.check()?;
            let due = Duration::from_millis(step);
            thread::sleep(due.saturating_sub(start.elapsed()));
            job.advance();
        }
        Ok(())
    })
}
