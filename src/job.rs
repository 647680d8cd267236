//! How a kernel runs: on which threads, how it is stopped, and how far it has come.
//!
//! Pools are made once for each thread count and kept. A pool belongs to the process that made it:
//! after a fork its threads are gone and waiting for them would hang, so a child gets
//! [`LodError::Forked`] instead.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::{LodError, check_in};

/// More threads than this in one pool is taken for a mistake.
pub const MAX_THREAD_COUNT: usize = 1024;

/// Elements between two looks at a job where an element takes well below a microsecond.
pub const ELEMENTS_PER_CHECK: usize = 1 << 14;

/// Shared between a running kernel and whoever waits for it.
#[derive(Debug, Default)]
pub struct Job {
    cancelled: AtomicBool,
    done: AtomicU64,
    total: AtomicU64,
}

impl Job {
    /// Asks the kernel to stop; it does so at its next check.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// Called by kernels at least every few milliseconds.
    ///
    /// # Errors
    /// [`LodError::Cancelled`] once [`Job::cancel`] was called.
    pub fn check(&self) -> Result<(), LodError> {
        if self.cancelled.load(Ordering::Relaxed) { Err(LodError::Cancelled) } else { Ok(()) }
    }

    /// Announces how many steps the kernel will take.
    pub fn begin(&self, total: u64) {
        self.done.store(0, Ordering::Relaxed);
        self.total.store(total, Ordering::Relaxed);
    }

    /// Counts one step as done.
    pub fn advance(&self) {
        self.advance_by(1);
    }

    /// Counts steps as done.
    pub fn advance_by(&self, step_count: usize) {
        self.done.fetch_add(step_count as u64, Ordering::Relaxed);
    }

    /// Steps done and steps in all; (0, 0) before [`Job::begin`].
    pub fn progress(&self) -> (u64, u64) {
        (self.done.load(Ordering::Relaxed), self.total.load(Ordering::Relaxed))
    }

    /// `make(0)` to `make(count - 1)`, made in parallel.
    ///
    /// Memory is touched only as it is filled: to reserve gigabytes takes no time, to clear them
    /// would take seconds without a look at the job.
    ///
    /// # Errors
    /// [`LodError::Cancelled`].
    pub fn collect<T: Send>(
        &self,
        count: usize,
        make: impl Fn(usize) -> T + Sync,
    ) -> Result<Vec<T>, LodError> {
        let mut made = Vec::with_capacity(count);
        for first in (0..count).step_by(ELEMENTS_PER_CHECK) {
            self.check()?;
            let end = count.min(first + ELEMENTS_PER_CHECK);
            made.par_extend((first..end).into_par_iter().map(&make));
        }
        Ok(made)
    }

    /// Index of the first row for which `holds` is true.
    ///
    /// # Errors
    /// [`LodError::Cancelled`].
    pub fn position<T>(
        &self,
        rows: &[T],
        holds: impl Fn(&T) -> bool,
    ) -> Result<Option<usize>, LodError> {
        for (part, rows) in rows.chunks(ELEMENTS_PER_CHECK).enumerate() {
            self.check()?;
            if let Some(row) = rows.iter().position(&holds) {
                return Ok(Some(part * ELEMENTS_PER_CHECK + row));
            }
        }
        Ok(None)
    }
}

static POOLS: Mutex<BTreeMap<usize, Arc<ThreadPool>>> = Mutex::new(BTreeMap::new());

/// Process that made the first pool; 0 before that. Not under the lock, which another thread may
/// have held at the moment of the fork and which then stays locked in the child.
static OWNER: AtomicU32 = AtomicU32::new(0);

/// The thread count used where a call states none: `TREELOD_NUM_THREADS`, if not empty, else
/// all cores.
///
/// # Errors
/// [`LodError::Invalid`] if the variable is set to something that is no thread count.
pub fn default_thread_count() -> Result<usize, LodError> {
    // empty is how a shell leaves a variable that it has not unset
    let stated = std::env::var("TREELOD_NUM_THREADS").ok().filter(|text| !text.trim().is_empty());
    let Some(text) = stated else {
        return Ok(std::thread::available_parallelism().map_or(1, |count| count.get()));
    };
    match text.trim().parse() {
        Ok(count) if (1..=MAX_THREAD_COUNT).contains(&count) => Ok(count),
        _ => Err(LodError::Invalid {
            name: "TREELOD_NUM_THREADS",
            why: format!("must be in [1, {MAX_THREAD_COUNT}], got {text:?}"),
        }),
    }
}

/// Runs `kernel` inside the pool of `thread_count` threads (`None`: the default count).
///
/// # Errors
/// Whatever the kernel returns; [`LodError::OutOfRange`] for a thread count of 0 or above
/// [`MAX_THREAD_COUNT`]; [`LodError::Forked`] in a child of the process that made the pools.
pub fn run<T: Send>(
    thread_count: Option<usize>,
    kernel: impl FnOnce() -> Result<T, LodError> + Send,
) -> Result<T, LodError> {
    let count = match thread_count {
        Some(count) => count,
        None => default_thread_count()?,
    };
    check_in("threads", count, 1..=MAX_THREAD_COUNT)?;
    pool(count)?.install(kernel)
}

fn pool(thread_count: usize) -> Result<Arc<ThreadPool>, LodError> {
    let process_id = std::process::id();
    let owner = OWNER.compare_exchange(0, process_id, Ordering::AcqRel, Ordering::Acquire);
    if owner.is_err_and(|owner| owner != process_id) {
        return Err(LodError::Forked);
    }
    // A panic while the lock was held leaves the map whole, so a poisoned lock is still good.
    let mut pools = POOLS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(pool) = pools.get(&thread_count) {
        return Ok(Arc::clone(pool));
    }
    let built = ThreadPoolBuilder::new()
        .num_threads(thread_count)
        .thread_name(|index| format!("treelod-{index}"))
        .build();
    let pool = Arc::new(built.map_err(|error| LodError::Invalid {
        name: "threads",
        why: format!("the system gave no {thread_count} threads: {error}"),
    })?);
    pools.insert(thread_count, Arc::clone(&pool));
    Ok(pool)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_on_the_stated_number_of_threads() {
        for count in [1, 3] {
            let seen = run(Some(count), || Ok(rayon::current_num_threads()));
            assert_eq!(seen, Ok(count), "{count} threads");
        }
        assert!(run(Some(0), || Ok(())).is_err(), "0 threads can do nothing");
    }

    #[test]
    fn a_cancelled_job_says_so() {
        let job = Job::default();
        assert_eq!(job.check(), Ok(()), "not cancelled yet");
        job.begin(3);
        job.advance();
        assert_eq!(job.progress(), (1, 3), "one of three steps");
        job.cancel();
        assert_eq!(job.check(), Err(LodError::Cancelled), "cancelled");
        assert_eq!(job.collect(1, |row| row), Err(LodError::Cancelled), "makes nothing");
        assert_eq!(job.position(&[1], |_| true), Err(LodError::Cancelled), "looks for nothing");
    }

    #[test]
    fn long_rows_are_made_and_searched_in_order() {
        let job = Job::default();
        for count in [0, 1, ELEMENTS_PER_CHECK, 3 * ELEMENTS_PER_CHECK + 7] {
            let rows = job.collect(count, |row| row).expect("not cancelled");
            assert!(rows.iter().copied().eq(0..count), "{count} rows in order");
            for wanted in [0, count / 2, count.saturating_sub(1)] {
                let found = job.position(&rows, |&row| row >= wanted).expect("not cancelled");
                assert_eq!(found, (count > 0).then_some(wanted), "first of {count} rows");
            }
            assert_eq!(job.position(&rows, |_| false), Ok(None), "none of {count} rows");
        }
    }
}
