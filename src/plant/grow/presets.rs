//! What can be grown, as data.

mod blades;
mod broadleaves;
mod herbs;
mod palm;
mod pine;

use crate::plant::grow::grass::Tuft;
use crate::plant::grow::herb::Herb;
use crate::plant::grow::params::{Level, Species, vary};

/// A plant, by how it is grown.
#[derive(Debug, Clone, Copy)]
pub(super) enum Preset {
    /// Trunk, limbs, twigs and leaves.
    Tree(&'static Species),
    /// Stems with a flower head each.
    Herb(&'static Herb),
    /// Blades from the ground.
    Tuft(&'static Tuft),
}

/// Every plant, in the order in which messages list them.
pub(super) const PRESETS: [Preset; 8] = [
    Preset::Tree(&broadleaves::CHESTNUT),
    Preset::Tree(&broadleaves::BROADLEAF),
    Preset::Tree(&broadleaves::GROVE),
    Preset::Tree(&pine::PINE),
    Preset::Tree(&palm::PALM),
    Preset::Herb(&herbs::SUNFLOWER),
    Preset::Herb(&herbs::DAISY),
    Preset::Tuft(&herbs::GRASS),
];

impl Preset {
    /// How Python names it.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Tree(species) => species.name,
            Self::Herb(herb) => herb.name,
            Self::Tuft(tuft) => tuft.name,
        }
    }
}

/// The trees among them.
#[cfg(test)]
pub(super) fn trees() -> impl Iterator<Item = &'static Species> {
    PRESETS.iter().filter_map(|preset| match preset {
        Preset::Tree(species) => Some(*species),
        _ => None,
    })
}

/// What a level has unless its species says otherwise.
const LEVEL: Level = Level {
    length: vary(1.0, 0.0),
    radius_power: 1.3,
    taper: 0.95,
    segment_length: 0.5,
    max_segments: 8,
    sides: 6,
    spacing: 0.3,
    jitter: 0.35,
    whorl: 1,
    bare: 0.1,
    down: (60.0, 40.0),
    down_spread: 8.0,
    around: vary(137.5, 20.0),
    curve: (0.0, 0.0),
    curve_spread: 10.0,
    upward: (0.0, 0.0),
    forks: 0.0,
    forks_from: 0.3,
    fork_angle: vary(45.0, 10.0),
};
