//! Which vector instructions kernels use: found out once, or chosen by `TREELOD_SIMD`.
//!
//! Results are the same bytes at every level: kernels use the same operations in the same order in
//! each lane, and never a fused multiply-add.

use std::sync::OnceLock;
use std::time::Instant;

use fearless_simd::prelude::*;
#[cfg(target_arch = "x86_64")]
use fearless_simd::{Avx2, Avx512, Sse2};
use fearless_simd::{Fallback, f32x8};

use crate::error::LodError;

/// Instructions that kernels may use.
#[derive(Debug, Clone, Copy)]
pub enum Level {
    /// No vectors of ours; the compiler may still find some.
    Scalar(Fallback),
    /// Four lanes, which every x86-64 has.
    #[cfg(target_arch = "x86_64")]
    Sse2(Sse2),
    /// Eight lanes.
    #[cfg(target_arch = "x86_64")]
    Avx2(Avx2),
    /// Eight lanes, with masks of their own and more registers.
    #[cfg(target_arch = "x86_64")]
    Avx512(Avx512),
}

/// Numbers that kernels work on at once; levels with shorter vectors use several.
pub(crate) const LANE_COUNT: usize = 8;

/// Names of the levels, as `TREELOD_SIMD` takes them.
pub const NAMES: [&str; 4] = ["scalar", "sse2", "avx2", "avx512"];

impl Level {
    /// The level of a name.
    ///
    /// # Errors
    /// [`LodError::Invalid`] for a name that is none of [`NAMES`], or if this machine lacks it.
    pub fn named(argument: &'static str, name: &str) -> Result<Self, LodError> {
        #[cfg(target_arch = "x86_64")]
        let best = fearless_simd::Level::new();
        let found = match name {
            "scalar" => fallback().map(Self::Scalar),
            #[cfg(target_arch = "x86_64")]
            "sse2" => best.as_sse2().map(Self::Sse2),
            #[cfg(target_arch = "x86_64")]
            "avx2" => best.as_avx2().map(Self::Avx2),
            #[cfg(target_arch = "x86_64")]
            "avx512" => best.as_avx512().map(Self::Avx512),
            _ if NAMES.contains(&name) => None,
            _ => {
                let why = format!("must be one of {NAMES:?}, got {name:?}");
                return Err(LodError::Invalid { name: argument, why });
            }
        };
        let why = || format!("this machine has no {name}");
        found.ok_or_else(|| LodError::Invalid { name: argument, why: why() })
    }

    /// What `TREELOD_SIMD` asks for; unset or empty, the best that this machine has. Read once.
    ///
    /// # Errors
    /// As [`Level::named`].
    pub fn chosen() -> Result<Self, LodError> {
        static CHOSEN: OnceLock<Result<Level, LodError>> = OnceLock::new();
        CHOSEN
            .get_or_init(|| match std::env::var("TREELOD_SIMD") {
                // empty is how a shell leaves a variable that it has not unset
                Ok(name) if !name.trim().is_empty() => Self::named("TREELOD_SIMD", name.trim()),
                _ => Self::best(),
            })
            .clone()
    }

    /// Every level that this machine has, slowest first.
    pub fn all() -> Vec<Self> {
        NAMES.iter().filter_map(|name| Self::named("simd", name).ok()).collect()
    }

    fn best() -> Result<Self, LodError> {
        let last = Self::all().pop();
        last.ok_or_else(|| LodError::Invalid { name: "simd", why: "no level works".to_owned() })
    }

    /// Runs a kernel, compiled for the level.
    #[inline]
    pub(crate) fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self {
            Self::Scalar(simd) => kernel.run(simd),
            #[cfg(target_arch = "x86_64")]
            Self::Sse2(simd) => simd.vectorize(
                #[inline(always)]
                || kernel.run(simd),
            ),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2(simd) => simd.vectorize(
                #[inline(always)]
                || kernel.run(simd),
            ),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512(simd) => simd.vectorize(
                #[inline(always)]
                || kernel.run(simd),
            ),
        }
    }
}

fn fallback() -> Option<Fallback> {
    match fearless_simd::Level::fallback() {
        fearless_simd::Level::Fallback(fallback) => Some(fallback),
        _ => None,
    }
}

/// Code that is compiled once for each level. `run` must be `#[inline(always)]`, and so must be all
/// it calls in its hot loops.
pub(crate) trait Kernel {
    type Output;
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

/// Vectors that are worked on at once to keep every unit of a core busy.
const CHAIN_COUNT: usize = 12;

/// Keeps a core's arithmetic busy; gives a number that depends on all of it.
struct Busy {
    round_count: u32,
}

impl Kernel for Busy {
    type Output = f32;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> f32 {
        let mut chains = [f32x8::splat(simd, 1.0); CHAIN_COUNT];
        for (chain, start) in chains.iter_mut().zip(1_u8..) {
            // the compiler must not know what comes of it
            *chain = f32x8::splat(simd, std::hint::black_box(f32::from(start)));
        }
        for _ in 0..self.round_count {
            for chain in &mut chains {
                *chain = *chain * 0.999 + 0.001;
            }
        }
        let sum = chains.iter().fold(f32x8::splat(simd, 0.0), |sum, &chain| sum + chain);
        <[f32; LANE_COUNT]>::from(sum).iter().sum()
    }
}

/// Multiplications and additions a second that a thread does at best, without the fused ones that
/// kernels never use.
pub fn peak_rate(level: Level) -> f64 {
    let round_count = 2_000_000;
    let start = Instant::now();
    std::hint::black_box(level.run(Busy { round_count: std::hint::black_box(round_count) }));
    let operations = f64::from(round_count) * (2 * CHAIN_COUNT * LANE_COUNT) as f64;
    operations / start.elapsed().as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn busy_chains_go_to_one() {
        // each of 96 numbers goes to 1, and its distance shrinks by a factor of 20,000
        for level in Level::all() {
            let sum = level.run(Busy { round_count: 10_000 });
            assert!((sum - 96.0).abs() < 0.1, "{level:?}: {sum}");
        }
    }

    #[test]
    fn names_are_levels_and_others_are_refused() {
        assert!(matches!(Level::named("simd", "scalar"), Ok(Level::Scalar(_))), "everywhere");
        let text = Level::named("simd", "avx9").expect_err("no such level").to_string();
        assert_eq!(
            text, r#"simd: must be one of ["scalar", "sse2", "avx2", "avx512"], got "avx9""#,
            "named"
        );
        assert!(!Level::all().is_empty(), "scalar at least");
    }
}
