//! Leaf clusters: leaves near a common plane become one textured card in it.
//!
//! K-means finds the planes, by the distance of leaf centres and the angle between leaves and plane.
//! A cluster's leaves are flattened into its plane and baked on a card there. Cards do not turn with
//! the viewer; they are tested against alpha and write their depth, so they hide one another as the
//! leaves did. A hierarchy of clusterings gives coarser levels, and a level's cards move into the next
//! level's planes as the viewer leaves. Wood stays a mesh.
//!
//! This work is based on:
//! Ismael Garcia, Mateu Sbert, László Szirmay-Kalos. Leaf Cluster Impostors for Tree Rendering with
//! Parallax. 2005
//!
//! Deviations: planes are fitted by an eigensolver instead of the published iteration; k-means starts
//! from planes of leaves; alpha is given relative to the crown's radius; levels come from merging.

mod assign;
mod cards;
pub mod hierarchy;
pub mod impostor;
pub mod indirect;
pub mod kmeans;
mod leaves;
pub mod misses;
pub mod moments;
mod moves;
mod nearest;
pub mod peak;
pub mod plane;
mod start;
mod sums;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use glam::DVec3;

use crate::draw_list::Buffers;
use crate::error::{LodError, check_in};
use crate::job::Job;
pub use crate::lod::leaf_clusters::cards::CardSide;
use crate::lod::leaf_clusters::cards::{Baker, Cards, Emitter};
use crate::lod::leaf_clusters::hierarchy::Level;
use crate::lod::leaf_clusters::impostor::{Flatten, Outline, flattened, impostors};
use crate::lod::leaf_clusters::indirect::Indirect;
use crate::lod::leaf_clusters::kmeans::{Init, cluster};
use crate::lod::leaf_clusters::plane::{Eigen, Plane};
use crate::lod::leaves::Leaves;
use crate::lod::level_rule::{Choice, LevelRule, Seen};
use crate::lod::solid::Solid;
use crate::lod::wood::Wood;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture, Representation, foot_of};
use crate::plant::{Mesh, Plant};
use crate::raster::samples;
use crate::texture::texture::check_size;
use crate::texture::{Filter, Format};
use crate::view::View;
use crate::view_state::ViewState;

/// More clusters than this are taken for a mistake.
pub const MAX_CLUSTER_COUNT: usize = 4096;

/// Weight of the angle between leaf and plane against their distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Alpha {
    /// In square metres.
    SquareMetres(f64),
    /// Times the square of the crown's radius.
    Relative(f64),
}

/// Texels of a card.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Texels {
    /// The same for all: width and height.
    Each(u32, u32),
    /// So many a metre.
    PerMetre(f64),
}

/// How cards join the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drawing {
    /// Where alpha is at least one half, with depth.
    Test,
    /// On as many of a pixel's samples as alpha asks for, other samples for each card, with depth.
    Coverage,
    /// Blended from the farthest card to the nearest, without depth.
    Blend,
}

/// How one level becomes the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transition {
    /// Whether cards move into the next level's planes.
    pub morph: bool,
    /// Last share of the way over which the next level is faded in.
    pub fade_share: f64,
}

/// How leaf clusters are built.
#[derive(Debug, Clone)]
pub struct Params {
    /// Clusters of each level, falling.
    pub cluster_counts: Vec<usize>,
    /// Weight of the angle.
    pub alpha: Alpha,
    /// First planes.
    pub init: Init,
    /// Of every random choice.
    pub seed: u64,
    /// Runs of k-means of which the best counts.
    pub restart_count: usize,
    /// Iterations of a run, at most.
    pub max_iterations: usize,
    /// How planes are fitted.
    pub eigen: Eigen,
    /// How leaves get into their plane.
    pub flatten: Flatten,
    /// Whether a card shows another picture from behind.
    pub two_sided: bool,
    /// Size of cards.
    pub texels: Texels,
    /// Samples a texel.
    pub sample_count: u32,
    /// Texel format.
    pub format: Format,
    /// Whether cards name their leaves instead of storing their texels.
    pub indirect: Option<Indirect>,
    /// How cards are drawn.
    pub drawing: Drawing,
    /// Shape of cards.
    pub outline: Outline,
    /// What decides the level.
    pub rule: LevelRule,
    /// How levels change.
    pub transition: Transition,
    /// The wood that stays a mesh.
    pub wood: Wood,
    /// The cameras that will look, in the plant's own world; `None` bakes for all.
    pub views: Option<Vec<View>>,
}

/// One level, ready to be drawn.
#[derive(Debug)]
struct DrawnLevel {
    level: Level,
    cards: Cards,
}

/// What all choices of a level share.
#[derive(Debug)]
struct Built {
    /// Finest first.
    levels: Vec<DrawnLevel>,
    /// Root mean square distance in metres of leaf vertices from their planes, or the finer level's
    /// if that is larger.
    errors: Vec<f64>,
    solid: Solid,
    center: DVec3,
    radius: f64,
    bounds: (DVec3, DVec3),
    foot: DVec3,
    origin: DVec3,
    drawing: Drawing,
    transition: Transition,
    /// Total k-means error after each iteration.
    kmeans_errors: Vec<f64>,
    converged: bool,
    /// In square metres.
    alpha: f64,
}

/// The technique's representation of a plant.
#[derive(Debug, Clone)]
pub struct LeafClusters {
    built: Arc<Built>,
    rule: LevelRule,
}

impl LeafClusters {
    /// Clusters the leaves of a plant and bakes their cards.
    ///
    /// # Errors
    /// `foliage` without leaves; an argument out of range; [`LodError::Cancelled`].
    pub fn build(plant: &Plant, params: &Params, job: &Job) -> Result<Self, LodError> {
        check(params)?;
        let leaves = Leaves::new(plant)?;
        let alpha = match params.alpha {
            Alpha::SquareMetres(alpha) => alpha,
            Alpha::Relative(alpha) => alpha * leaves.radius * leaves.radius,
        };
        let found = cluster(
            &plant.foliage.centers,
            &plant.foliage.normals,
            &kmeans::Params {
                cluster_count: params.cluster_counts[0],
                alpha,
                init: params.init.clone(),
                seed: params.seed,
                restarts: params.restart_count,
                max_iterations: params.max_iterations,
                eigen: params.eigen,
            },
            job,
        )?;
        let finest = Level {
            cluster_ids: found.cluster_ids,
            planes: found.planes,
            moments: found.moments,
            parents: Vec::new(),
        };
        let levels = finest.coarsened(&params.cluster_counts[1..], alpha, params.eigen, job)?;
        params.rule.check(levels.len())?;
        let mut baker = Baker::new(plant, params, job);
        let mut drawn: Vec<DrawnLevel> = Vec::new();
        let mut errors: Vec<f64> = Vec::new();
        let made: Vec<_> = levels
            .into_iter()
            .map(|level| {
                let flat = flattened(&leaves, &level, params.flatten);
                let impostors = impostors(&leaves, &flat, &level, params.outline);
                baker.sizes(&leaves, impostors).map(|sized| (level, sized))
            })
            .collect::<Result<_, LodError>>()?;
        baker.prepare(&leaves)?;
        job.begin(made.iter().map(|(_, sized)| sized.tile_count() as u64).sum());
        for (level, sized) in made {
            // made again, since all levels' leaves at once would be many times the plant
            let flat = flattened(&leaves, &level, params.flatten);
            let error = sized.error();
            errors.push(errors.last().map_or(error, |&last| error.max(last)));
            let cards = baker.bake(&flat, sized)?;
            drawn.push(DrawnLevel { level, cards });
        }
        let wood = params.wood.of(plant)?;
        let solid = Solid::new(
            &[(&wood, Buffers::ids_from(0, &wood))],
            &plant.materials,
            Filter::Bilinear,
            job,
        )?;
        let boxes = || [&plant.foliage.mesh, &wood].into_iter().filter_map(Mesh::bounds);
        let foot = foot_of(boxes());
        let corners = boxes().flat_map(|(low, high)| [low.as_dvec3(), high.as_dvec3()]);
        let card_corners = drawn.iter().flat_map(|drawn| drawn.cards.corners());
        let bounds = corners
            .chain(card_corners)
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), corner| {
                (low.min(corner), high.max(corner))
            });
        let built = Built {
            levels: drawn,
            errors,
            solid,
            center: leaves.center,
            radius: leaves.radius,
            bounds,
            foot,
            origin: plant.origin,
            drawing: params.drawing,
            transition: params.transition,
            kmeans_errors: found.errors,
            converged: found.converged,
            alpha,
        };
        Ok(Self { built: Arc::new(built), rule: params.rule.clone() })
    }

    /// The same, always at one level and share of the way to the next.
    ///
    /// # Errors
    /// `level` or `t` out of range; `t` above 0 at the coarsest level.
    pub fn at(&self, level: usize, t: f64) -> Result<Self, LodError> {
        let last = self.built.levels.len() - 1;
        check_in("level", level, 0..=last)?;
        check_in("t", t, 0.0..=if level == last { 0.0 } else { 1.0 })?;
        let rule = LevelRule::Fixed(Choice { level, t });
        Ok(Self { built: Arc::clone(&self.built), rule })
    }

    /// How many levels there are.
    pub fn level_count(&self) -> usize {
        self.built.levels.len()
    }

    /// Cluster of each leaf at a level.
    pub fn cluster_ids(&self, level: usize) -> &[u32] {
        &self.built.levels[level].level.cluster_ids
    }

    /// Planes of a level in the plant's world.
    pub fn planes(&self, level: usize) -> Vec<Plane> {
        let planes = self.built.levels[level].level.planes.iter();
        planes.map(|plane| plane.relative_to(-self.built.origin)).collect()
    }

    /// For each cluster of a level, its cluster of the next; empty at the coarsest.
    pub fn parents(&self, level: usize) -> &[u32] {
        &self.built.levels[level].level.parents
    }

    /// Errors of the levels in metres: root mean square distance of leaf vertices from their planes.
    pub fn errors(&self) -> &[f64] {
        &self.built.errors
    }

    /// Total error of k-means after each iteration, and whether it ended in a fixed point.
    pub fn kmeans_errors(&self) -> (&[f64], bool) {
        (&self.built.kmeans_errors, self.built.converged)
    }

    /// Weight of the angle in square metres.
    pub fn alpha(&self) -> f64 {
        self.built.alpha
    }

    /// Sides of a level's cards.
    pub fn card_sides(&self, level: usize) -> Vec<CardSide> {
        self.built.levels[level].cards.sides()
    }

    /// Share of each level's texture that cards cover.
    pub fn atlas_fills(&self) -> Vec<f64> {
        self.built.levels.iter().map(|drawn| drawn.cards.fill).collect()
    }

    fn choose(&self, view: &View, crown: &Crown) -> Choice {
        let Built { errors, center, radius, .. } = &*self.built;
        self.rule.choose(errors, &Seen::new(view, crown, *center, *radius))
    }
}

fn check(params: &Params) -> Result<(), LodError> {
    let Some(&most) = params.cluster_counts.first() else {
        return Err(LodError::Empty { name: "cluster_count", why: "give at least one count" });
    };
    check_in("cluster_count", most, 1..=MAX_CLUSTER_COUNT)?;
    if params.cluster_counts.contains(&0) || params.cluster_counts.windows(2).any(|w| w[1] >= w[0])
    {
        let why = format!("levels must have ever fewer clusters, got {:?}", params.cluster_counts);
        return Err(LodError::Invalid { name: "cluster_count", why });
    }
    match params.alpha {
        Alpha::SquareMetres(alpha) => check_in("alpha", alpha, 0.0..=1e12)?,
        Alpha::Relative(alpha) => check_in("alpha_rel", alpha, 0.0..=1e12)?,
    }
    match params.texels {
        Texels::Each(width, height) => check_size("resolution", width, height)?,
        Texels::PerMetre(density) => check_in("texels_per_metre", density, 1e-9..=1e9)?,
    }
    if let Outline::Hull { max_corner_count } = params.outline {
        check_in("outline", max_corner_count, 3..=64)?;
    }
    if let Some(indirect) = &params.indirect {
        indirect.check()?;
    }
    check_in("fade_share", params.transition.fade_share, 0.0..=1.0)?;
    if let LevelRule::Pixels(error_px) = params.rule {
        check_in("level_error_px", error_px, 0.0..=1e9)?;
    }
    samples::positions(params.sample_count)?;
    if params.views.as_ref().is_some_and(Vec::is_empty) {
        let why = "give at least one camera, or None for all directions";
        return Err(LodError::Empty { name: "views", why });
    }
    Ok(())
}

impl Representation for LeafClusters {
    fn bounds(&self) -> (DVec3, DVec3) {
        self.built.bounds
    }

    fn foot(&self) -> DVec3 {
        self.built.foot
    }

    fn origin(&self) -> DVec3 {
        self.built.origin
    }

    fn footprint(&self) -> Footprint {
        let solid = self.built.solid.footprint();
        let cards = || self.built.levels.iter().map(|drawn| &drawn.cards);
        let leaf = self.built.levels[0].cards.leaf();
        let tables: u64 = self.built.levels.iter().map(|drawn| drawn.table_bytes()).sum();
        Footprint {
            card_count: cards().map(|cards| cards.count() as u64).sum(),
            geometry_bytes: solid.geometry_bytes
                + tables
                + cards().map(Cards::geometry_bytes).sum::<u64>(),
            texture_bytes: solid.texture_bytes
                + cards().map(Cards::texture_bytes).sum::<u64>()
                + leaf.map_or(0, |leaf| leaf.byte_count()),
            ..solid
        }
    }

    fn textures(&self) -> Vec<NamedTexture> {
        let levels = self.built.levels.iter().enumerate();
        let named = levels.filter_map(|(number, drawn)| {
            let texture = Arc::clone(drawn.cards.texture()?);
            let name = format!("level {number}, {} cards", drawn.cards.count());
            Some(NamedTexture { name, texture, rect: None })
        });
        let leaf = self.built.levels[0].cards.leaf().map(|texture| NamedTexture {
            name: "leaf at every angle".to_owned(),
            texture: Arc::clone(texture),
            rect: None,
        });
        named.chain(leaf).chain(self.built.solid.textures()).collect()
    }

    fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        let built = &*self.built;
        built.solid.emit(view, crowns, state, builder);
        let mut emitter = Emitter::new(view, built.drawing, builder);
        // near copies first, so that they hide what lies behind them
        for crown in crowns.iter().rev() {
            let Choice { level, t } = self.choose(view, crown);
            let drawn = &built.levels[level];
            let Some(next) = built.levels.get(level + 1).filter(|_| t > 0.0) else {
                emitter.plain(crown, &drawn.cards, 1.0);
                continue;
            };
            let Transition { morph, fade_share } = built.transition;
            let begin = 1.0 - fade_share;
            let faded = if t > begin { (t - begin) / fade_share } else { 0.0 };
            if faded < 1.0 {
                if morph {
                    let parents = &drawn.level.parents;
                    emitter.moved(crown, &drawn.cards, parents, &next.level.planes, t, 1.0 - faded);
                } else {
                    emitter.plain(crown, &drawn.cards, 1.0 - faded);
                }
            }
            if faded > 0.0 {
                emitter.plain(crown, &next.cards, if faded < 1.0 { -faded } else { 1.0 });
            }
        }
        emitter.finish();
        Ok(())
    }
}

impl DrawnLevel {
    /// What moving into the next level's planes needs beside the cards: a parent each, and each
    /// card's plane and mean in f32.
    fn table_bytes(&self) -> u64 {
        (self.level.parents.len() * (size_of::<u32>() + 7 * size_of::<f32>())) as u64
    }
}
