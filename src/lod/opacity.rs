//! How opaque stacks of slices are drawn where several share a view: Jakulin's law, the multiplier
//! that fits a crown, and the law of random leaves.
//!
//! This work is based on:
//! Aleks Jakulin. Interactive Vegetation Rendering with Slicing and Blending. 2000

use glam::{DAffine3, DVec3, Vec4};
use rayon::prelude::*;

use crate::error::{LodError, check_in};
use crate::job::Job;
use crate::lod::leaves::LEAST_SIZE;
use crate::lod::view_blend::{circle, sphere};
use crate::lod::{Crown, ListBuilder};
use crate::raster::{Outputs, Renderer, Settings};
use crate::texture::LinearImage;
use crate::view::{Projection, View};

/// Largest multiplier that a fit tries.
const MAX_M: f64 = 4.0;

/// Directions over which a fit averages; a multiple of the usual slicing counts.
const FIT_AZIMUTHS: usize = 36;

/// Cuts of [0, 4], the first at a guess and the others in halves: what is left is at most 4 / 2^11 wide,
/// and its middle is within 1e-3 of the root.
const FIT_STEPS: usize = 12;

/// Pixels a side of a fit's pictures: slices are read through mips, so few are enough.
const FIT_SIDE: u32 = 96;

/// How blended slices are made as opaque as single ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Correction {
    /// Opacities times `1 + m (1 - largest share)`, at most 1. Jakulin starts from m = 0.5.
    Linear(f64),
    /// As `Linear`, with the m that gives the crown its on-axis mean alpha from all around.
    Fit,
    /// `(1 - exp(-share tau)) / (1 - exp(-tau))`: keeps the mean opacity of random leaves.
    Optical,
}

impl Correction {
    /// # Errors
    /// A multiplier that is negative or no number.
    pub(crate) fn check(self) -> Result<(), LodError> {
        match self {
            Self::Linear(m) => check_in("correction", m, 0.0..=1e6),
            Self::Fit | Self::Optical => Ok(()),
        }
    }

    /// Its law where nothing is fitted. For a fit that is the law of random leaves, by which slices are
    /// measured on their own axes, where all laws are the same.
    pub(crate) fn unfitted(self, tau: f64) -> Opacity {
        match self {
            Self::Linear(m) => Opacity::Linear { m },
            Self::Optical | Self::Fit => Opacity::Optical { tau },
        }
    }
}

/// A correction with its numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Opacity {
    Linear { m: f64 },
    Optical { tau: f64 },
}

impl Opacity {
    /// Jakulin's multiplier, where that is the law.
    pub(crate) fn m(self) -> Option<f64> {
        match self {
            Self::Linear { m } => Some(m),
            Self::Optical { .. } => None,
        }
    }

    /// Opacities of the shares, in the same order.
    pub(crate) fn of(self, shares: &[(usize, f64)]) -> Vec<f64> {
        let largest = shares.iter().map(|&(_, share)| share).fold(0.0, f64::max);
        shares
            .iter()
            .map(|&(_, share)| match self {
                Self::Linear { m } => (share * (1.0 + m * (1.0 - largest))).min(1.0),
                Self::Optical { tau } if tau > 0.0 => libm::expm1(-share * tau) / libm::expm1(-tau),
                Self::Optical { .. } => share,
            })
            .collect()
    }
}

/// Mean alpha of slices inside the silhouettes of their slicings.
#[derive(Debug, Default)]
pub(crate) struct SilhouetteAlpha {
    /// Texels of the slicing at hand in which a slice seen so far has coverage.
    covered: Vec<bool>,
    slice_count: usize,
    sum: f64,
    count: f64,
}

impl SilhouetteAlpha {
    /// Adds a slice of the slicing at hand.
    pub(crate) fn add(&mut self, image: &LinearImage) {
        self.covered.resize(image.texels.len(), false);
        self.slice_count += 1;
        // in the order of the texels, so the same on any number of threads
        for (covered, texel) in self.covered.iter_mut().zip(&image.texels) {
            *covered |= texel.w > 0.0;
            self.sum += f64::from(texel.w);
        }
    }

    /// Goes on to the next slicing.
    pub(crate) fn next_slicing(&mut self) {
        let covered = self.covered.iter().filter(|&&covered| covered).count();
        self.count += (covered * self.slice_count) as f64;
        self.covered.clear();
        self.slice_count = 0;
    }

    /// Optical depth of a slice: minus the logarithm of what its mean alpha lets through.
    pub(crate) fn tau(&self) -> f64 {
        let mean = if self.count > 0.0 { self.sum / self.count } else { 0.0 };
        // a slice without any hole would have an infinite one
        -libm::log1p(-mean.min(1.0 - 1e-9))
    }
}

/// Chooses the law of a correction; whether a fit found a root, or took the nearer end of its interval;
/// `None` where nothing is fitted.
///
/// `mean_alpha` measures the mean alpha of the slices with a law: from all around, or, without one, on
/// their own axes.
pub(crate) fn chosen(
    correction: Correction,
    tau: f64,
    mean_alpha: impl FnMut(Option<Opacity>) -> Result<f64, LodError>,
) -> Result<(Opacity, Option<bool>), LodError> {
    match correction {
        Correction::Linear(_) | Correction::Optical => Ok((correction.unfitted(tau), None)),
        Correction::Fit => fit(tau, mean_alpha).map(|(opacity, found)| (opacity, Some(found))),
    }
}

/// Bisects for the multiplier with which a crown is as opaque from all around as on its own axes;
/// whether there is one in the interval.
fn fit(
    tau: f64,
    mut mean_alpha: impl FnMut(Option<Opacity>) -> Result<f64, LodError>,
) -> Result<(Opacity, bool), LodError> {
    let wanted = mean_alpha(None)?;
    let mut excess = |m: f64| Ok(mean_alpha(Some(Opacity::Linear { m }))? - wanted);
    let (mut low, mut high) = (0.0, MAX_M);
    let ends: (f64, f64) = (excess(low)?, excess(high)?);
    if ends.0 > 0.0 || ends.1 < 0.0 {
        let nearer = if ends.0.abs() <= ends.1.abs() { low } else { high };
        return Ok((Opacity::Linear { m: nearer }, false));
    }
    // half way between two slicings, where both have a share of one half, that is the law of random leaves
    let mut m = (2.0 * libm::tanh(tau / 4.0)).clamp(low, high);
    for _ in 0..FIT_STEPS {
        if excess(m)? < 0.0 {
            low = m;
        } else {
            high = m;
        }
        m = (low + high) * 0.5;
    }
    Ok((Opacity::Linear { m }, true))
}

/// Where a fit measures, and the slices that it measures.
pub(crate) struct Measured<F> {
    /// The crown's centre, in its own coordinates.
    pub(crate) center: DVec3,
    /// The crown's radius.
    pub(crate) radius: f64,
    /// Appends the slices that a view shows.
    pub(crate) emit: F,
}

impl<F: Fn(&View, &Crown, &mut ListBuilder) -> Result<(), LodError> + Sync> Measured<F> {
    /// Mean alpha of the slices over directions, each in a parallel view that frames the crown.
    pub(crate) fn mean_alpha(&self, over: &[DVec3], job: &Job) -> Result<f64, LodError> {
        let alphas: Result<Vec<f64>, LodError> =
            over.par_iter().map(|&toward| self.mean_alpha_from(toward, job)).collect();
        Ok(alphas?.iter().sum::<f64>() / over.len() as f64)
    }

    fn mean_alpha_from(&self, toward: DVec3, job: &Job) -> Result<f64, LodError> {
        let radius = self.radius.max(LEAST_SIZE);
        let projection = Projection::Orthographic { height: 2.0 * radius };
        let up = if toward.y.abs() > 0.99 { DVec3::NEG_Z } else { DVec3::Y };
        let eye = self.center + toward * (4.0 * radius);
        let size = (FIT_SIDE, FIT_SIDE);
        let view = View::new(eye, self.center, up, projection, size, radius * 1e-3)?;
        let crown = Crown::alone(DAffine3::IDENTITY);
        let mut builder = ListBuilder::default();
        (self.emit)(&view, &crown, &mut builder)?;
        let settings = Settings {
            sample_count: 1,
            outputs: Outputs::COLOR,
            background: Vec4::ZERO,
            counts_fragments: false,
        };
        let frame = Renderer::default().render(&builder.finish(), &view, &settings, job)?;
        let sum: f64 = frame.color.iter().map(|pixel| f64::from(pixel.w)).sum();
        Ok(sum / frame.color.len() as f64)
    }
}

/// The directions over which a fit averages: around the horizon, or on the whole sphere.
pub(crate) fn all_around(is_level: bool) -> Vec<DVec3> {
    if is_level { circle(FIT_AZIMUTHS) } else { sphere(FIT_AZIMUTHS) }
}
