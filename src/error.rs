//! Which inputs the core refuses, and the words it refuses them with.
//!
//! A message names the *Python* argument, because that is what the reader of the message typed.

use std::fmt::{Debug, Display};
use std::ops::RangeInclusive;

use glam::{DVec3, Vec2, Vec3, Vec4};

/// Why a kernel could not do what it was asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LodError {
    /// A number lies outside the range its argument allows.
    #[error("{name} must be in {range}, got {value}")]
    OutOfRange {
        /// The Python argument.
        name: &'static str,
        /// What was given.
        value: String,
        /// What would have been accepted.
        range: String,
    },
    /// An array holds a NaN or an infinity.
    #[error("{name} must be finite: element {index} is not")]
    NotFinite {
        /// The Python argument.
        name: &'static str,
        /// Index of the first offending row.
        index: usize,
    },
    /// Something that must hold at least one element holds none.
    #[error("{name} is empty: {why}")]
    Empty {
        /// The Python argument.
        name: &'static str,
        /// What is missing, or what to do about it.
        why: &'static str,
    },
    /// An argument contradicts itself or another one.
    #[error("{name}: {why}")]
    Invalid {
        /// The Python argument.
        name: &'static str,
        /// What is wrong with it.
        why: String,
    },
    /// The request would need more memory or larger indices than the stated limit.
    #[error("{name} needs {asked} {unit}, the limit is {limit}")]
    Limit {
        /// The Python argument or the thing that grows with it.
        name: &'static str,
        /// What the request would need.
        asked: u64,
        /// The limit, in the same unit.
        limit: u64,
        /// The unit of both.
        unit: &'static str,
    },
    /// Stored bytes are damaged, or belong to something else.
    #[error("{name}: {why}")]
    Store {
        /// What was stored.
        name: &'static str,
        /// What is wrong with it.
        why: String,
    },
    /// A function of the caller's own has failed, in a way that only the caller knows.
    #[error("a function of the caller's own has failed")]
    Callback {
        /// Under which the caller finds why.
        id: u64,
    },
    /// The process was forked after the thread pool had started.
    #[error(
        "this process was forked after treelod had started its threads, which a fork does not copy; \
         start workers with the 'spawn' or 'forkserver' method"
    )]
    Forked,
    /// No graphics adapter fits.
    #[error("{why}")]
    NoAdapter {
        /// What was looked for, what there is, and what to install.
        why: String,
    },
    /// A graphics device was lost, ran out of memory or refused a command.
    #[error("the graphics device {why}")]
    Device {
        /// What it did.
        why: String,
    },
    /// The caller asked for a stop.
    #[error("cancelled")]
    Cancelled,
}

/// Checks that a number lies in a range, and names the argument if it does not.
///
/// # Errors
/// [`LodError::OutOfRange`].
pub fn check_in<T: PartialOrd + Display + Debug>(
    name: &'static str,
    value: T,
    range: RangeInclusive<T>,
) -> Result<(), LodError> {
    if range.contains(&value) {
        return Ok(());
    }
    let range = format!("[{}, {}]", range.start(), range.end());
    Err(LodError::OutOfRange { name, value: value.to_string(), range })
}

/// Anything whose components can be tested for NaN and infinity.
pub trait Finite {
    /// Whether every component is finite.
    fn all_finite(&self) -> bool;
}

macro_rules! finite {
    ($($t:ty),*) => {$(impl Finite for $t { fn all_finite(&self) -> bool { self.is_finite() } })*};
}
finite!(f32, f64, Vec2, Vec3, Vec4, DVec3);

/// Checks that every row of an array is finite.
///
/// # Errors
/// [`LodError::NotFinite`] with the index of the first row that is not.
pub fn check_finite<T: Finite>(name: &'static str, rows: &[T]) -> Result<(), LodError> {
    match rows.iter().position(|row| !row.all_finite()) {
        None => Ok(()),
        Some(index) => Err(LodError::NotFinite { name, index }),
    }
}

/// Checks that a length or size fits its limit before anything of that size is allocated.
///
/// # Errors
/// [`LodError::Limit`].
pub fn check_limit(
    name: &'static str,
    asked: u64,
    limit: u64,
    unit: &'static str,
) -> Result<(), LodError> {
    if asked <= limit { Ok(()) } else { Err(LodError::Limit { name, asked, limit, unit }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_name_the_argument() {
        let error = check_in("resolution", 0, 1..=16384).expect_err("0 is out of range");
        assert_eq!(error.to_string(), "resolution must be in [1, 16384], got 0");
        let error = check_finite("positions", &[Vec3::ZERO, Vec3::NAN]).expect_err("NaN");
        assert_eq!(error.to_string(), "positions must be finite: element 1 is not");
        assert!(check_finite("positions", &[f64::INFINITY]).is_err(), "infinity is not finite");
        let error = check_limit("size", 10, 9, "pixels").expect_err("over the limit");
        assert_eq!(error.to_string(), "size needs 10 pixels, the limit is 9");
    }
}
