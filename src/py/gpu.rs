//! Graphics adapters for Python, and what draws a list: the processor or a card.

use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::run::run;
use crate::draw_list::DrawList;
use crate::error::LodError;
use crate::job::Job;
use crate::raster::{self, Frame, Settings, Stats};
use crate::view::View;

/// What draws.
#[derive(Debug, Clone)]
pub(super) enum Backend {
    Cpu,
    /// A card, by a part of its name; `None`: the default one.
    Gpu(Option<String>),
}

/// Who has drawn a picture on a card.
#[derive(Debug, Clone)]
pub(super) struct Card {
    pub(super) name: String,
    pub(super) driver: String,
}

impl Backend {
    /// # Errors
    /// [`LodError::Invalid`] for other names.
    pub(super) fn named(name: &str, adapter: Option<String>) -> Result<Self, LodError> {
        match name {
            "cpu" => Ok(Self::Cpu),
            "gpu" => Ok(Self::Gpu(adapter)),
            _ => {
                let why = format!("must be 'cpu' or 'gpu', got {name:?}");
                Err(LodError::Invalid { name: "backend", why })
            }
        }
    }

    pub(super) fn render(
        &self,
        renderer: &mut raster::Renderer,
        list: &DrawList,
        view: &View,
        settings: &Settings,
        job: &Job,
    ) -> Result<(Frame, Option<Card>), LodError> {
        match self {
            Self::Cpu => Ok((renderer.render(list, view, settings, job)?, None)),
            Self::Gpu(adapter) => card::render(adapter.as_deref(), list, view, settings, job),
        }
    }

    pub(super) fn draw(
        &self,
        renderer: &mut raster::Renderer,
        list: &DrawList,
        view: &View,
        settings: &Settings,
        job: &Job,
    ) -> Result<(Stats, Option<Card>), LodError> {
        match self {
            Self::Cpu => Ok((renderer.draw(list, view, settings, job)?, None)),
            Self::Gpu(adapter) => card::draw(adapter.as_deref(), list, view, settings, job),
        }
    }
}

#[cfg(feature = "gpu")]
mod card {
    use super::{Card, DrawList, Frame, Job, LodError, Settings, Stats, View};
    use crate::gpu::{self, AdapterFacts};

    fn card(facts: AdapterFacts) -> Option<Card> {
        Some(Card { name: facts.name, driver: facts.driver })
    }

    pub(super) fn render(
        adapter: Option<&str>,
        list: &DrawList,
        view: &View,
        settings: &Settings,
        job: &Job,
    ) -> Result<(Frame, Option<Card>), LodError> {
        let (frame, facts) = gpu::render(adapter, list, view, settings, job)?;
        Ok((frame, card(facts)))
    }

    pub(super) fn draw(
        adapter: Option<&str>,
        list: &DrawList,
        view: &View,
        settings: &Settings,
        job: &Job,
    ) -> Result<(Stats, Option<Card>), LodError> {
        let (stats, facts) = gpu::draw(adapter, list, view, settings, job)?;
        Ok((stats, card(facts)))
    }

    /// Name, kind, interface, driver, and whether it tells times.
    pub(super) fn adapters(job: &Job) -> Result<Vec<[String; 4]>, LodError> {
        let words =
            |facts: AdapterFacts| [facts.name, facts.kind.to_owned(), facts.api, facts.driver];
        Ok(gpu::adapters(job)?.into_iter().map(words).collect())
    }

    pub(super) use gpu::{close_all, fail, release};
}

#[cfg(not(feature = "gpu"))]
mod card {
    use super::{Card, DrawList, Frame, Job, LodError, Settings, Stats, View};

    fn missing<T>() -> Result<T, LodError> {
        let why = "this build of treelod draws on the processor alone: build it with the cargo \
                   feature 'gpu', which wheels have";
        Err(LodError::NoAdapter { why: why.to_owned() })
    }

    pub(super) fn render(
        _: Option<&str>,
        _: &DrawList,
        _: &View,
        _: &Settings,
        _: &Job,
    ) -> Result<(Frame, Option<Card>), LodError> {
        missing()
    }

    pub(super) fn draw(
        _: Option<&str>,
        _: &DrawList,
        _: &View,
        _: &Settings,
        _: &Job,
    ) -> Result<(Stats, Option<Card>), LodError> {
        missing()
    }

    pub(super) fn adapters(_: &Job) -> Result<Vec<[String; 4]>, LodError> {
        Ok(Vec::new())
    }

    pub(super) fn close_all() {}

    pub(super) fn release(_: &Job) -> Result<(), LodError> {
        Ok(())
    }

    pub(super) fn fail(_: Option<&str>, _: &str) -> Result<(), LodError> {
        missing()
    }
}

/// Adapters, the one that is taken where nobody chooses first: their name, kind, interface and driver.
#[pyfunction]
pub(super) fn adapters(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    run(py, None, None, card::adapters)?
        .into_iter()
        .map(|[name, kind, api, driver]| {
            let facts = PyDict::new(py);
            facts.set_item("name", name)?;
            facts.set_item("kind", kind)?;
            facts.set_item("api", api)?;
            facts.set_item("driver", driver)?;
            Ok(facts)
        })
        .collect()
}

/// Lets go of every device with all that is on it; the next picture opens another.
#[pyfunction]
pub(super) fn release_devices(py: Python<'_>) -> PyResult<()> {
    run(py, None, None, card::release)
}

/// Drops every device; none can be opened after that.
#[pyfunction]
pub(super) fn close_devices(py: Python<'_>) {
    py.detach(card::close_all);
}

/// Makes a device fail: "lost", "memory" or "command".
#[pyfunction]
#[pyo3(signature = (kind, *, adapter = None))]
pub(super) fn _fail_for_test(py: Python<'_>, kind: &str, adapter: Option<String>) -> PyResult<()> {
    run(py, None, None, |_| card::fail(adapter.as_deref(), kind))
}
