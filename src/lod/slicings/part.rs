//! One crown with its slicings, in one level of detail or several: the whole crown, or a branch.

use std::sync::Arc;

use glam::DVec3;
use rayon::prelude::*;

use super::sub_slices::{Cells, Grid};
use super::{LargeLeaves, Params};
use crate::draw_list::Geometry;
use crate::error::LodError;
use crate::job::Job;
use crate::lod::leaves::Leaves;
use crate::lod::level_rule::{LevelRule, Seen};
use crate::lod::opacity::{self, Correction, Opacity, SilhouetteAlpha, all_around};
use crate::lod::slabs::{Cut, Layout};
use crate::lod::stack::{Baker, Drawing, Mixed, Stack, cards_at_most, push_stacks};
use crate::lod::view_blend::{ViewBlend, ordered};
use crate::lod::viewer::{self, Viewer};
use crate::lod::{Crown, ListBuilder, NamedTexture};
use crate::texture::quadtree;
use crate::view::View;

/// Two orientations that add up to less than this are opposite.
const OPPOSITE: f64 = 1e-9;

/// What is going to be baked of a crown.
pub(super) struct Plan<'a> {
    leaves: Leaves<'a>,
    mixing: Mixing,
    name: String,
    rule: LevelRule,
    levels: Vec<PlannedLevel>,
    /// Leaves that stay in the mesh.
    in_mesh: Vec<bool>,
    /// Leaves longer than a spacing of the finest level, summed over slicings.
    pub(super) large_leaf_count: usize,
}

/// A level that is going to be baked.
struct PlannedLevel {
    layouts: Vec<Layout>,
    /// Cells of the slices, where they have shares of their own.
    grids: Vec<Grid>,
    error: f64,
    /// Texels of each slicing, `None` where no view needs it.
    sizes: Vec<Option<(u32, u32)>>,
}

/// Which stacks a crown mixes towards a viewer.
#[derive(Debug, Clone)]
pub(super) struct Mixing {
    blend: ViewBlend,
    /// For each slicing the one whose slices it shows: itself, or its opposite.
    shown: Vec<usize>,
}

impl Mixing {
    fn new(blend: ViewBlend, mirrored: bool) -> Result<Self, LodError> {
        let directions = blend.directions();
        let opposite = |number: usize| {
            let is_opposite = |other: &DVec3| (*other + directions[number]).length() < OPPOSITE;
            directions[..number].iter().position(is_opposite)
        };
        let shown: Vec<usize> = (0..directions.len())
            .map(|number| if mirrored { opposite(number).unwrap_or(number) } else { number })
            .collect();
        if mirrored && shown.iter().enumerate().all(|(number, &shown)| number == shown) {
            let why = "needs two orientations that are opposite".to_owned();
            return Err(LodError::Invalid { name: "mirrored", why });
        }
        Ok(Self { blend, shown })
    }

    /// Whether a slicing has slices of its own.
    pub(super) fn is_stored(&self, slicing: usize) -> bool {
        self.shown[slicing] == slicing
    }

    /// Slicings with their shares in the order of drawing, those that are shown by another one's
    /// slices with it.
    pub(super) fn shares(&self, toward: DVec3, up: DVec3) -> Vec<(usize, f64)> {
        let shares = self.blend.shares(toward, up);
        let mut merged: Vec<(usize, f64)> = Vec::new();
        for (number, share) in shares {
            let shown = self.shown[number];
            match merged.iter_mut().find(|(other, _)| *other == shown) {
                Some((_, sum)) => *sum += share,
                None => merged.push((shown, share)),
            }
        }
        ordered(merged)
    }
}

impl<'a> Plan<'a> {
    /// Lays the slabs of a crown. `whole` is the radius of the whole plant's crown, which the stated
    /// resolution is for.
    pub(super) fn new(
        leaves: Leaves<'a>,
        blend: ViewBlend,
        name: String,
        whole: f64,
        params: &Params,
        job: &Job,
    ) -> Result<Self, LodError> {
        let directions = blend.directions().to_vec();
        let worst = libm::sin(blend.largest_angle().min(std::f64::consts::FRAC_PI_2));
        let mixing = Mixing::new(blend, params.mirrored)?;
        let mut error: f64 = 0.0;
        let mut levels: Vec<PlannedLevel> = Vec::new();
        for &slice_count in &params.slice_counts {
            let mut layouts: Vec<Layout> = Vec::new();
            let mut grids = Vec::new();
            for &toward in &directions {
                job.check()?;
                let centers = &leaves.leaf_centers;
                let layout = Layout::new(toward, centers, slice_count, leaves.radius);
                if params.sub_slices > 1 {
                    grids.push(grid(&layout, &leaves, params));
                }
                layouts.push(layout);
            }
            let spacing = layouts.iter().map(|layout| layout.spacing).fold(0.0, f64::max);
            error = error.max(spacing / 2.0 * worst);
            levels.push(PlannedLevel { layouts, grids, error, sizes: Vec::new() });
        }
        let (in_mesh, large_leaf_count) = large_leaves(&leaves, &levels[0].layouts, params, job)?;
        let rule = params.rule.clone();
        let mut plan = Self { leaves, mixing, name, rule, levels, in_mesh, large_leaf_count };
        plan.size(whole, params, job)?;
        Ok(plan)
    }

    /// Chooses the texels of every slicing: what was asked for, but no more than any view can show.
    fn size(&mut self, whole: f64, params: &Params, job: &Job) -> Result<(), LodError> {
        let needed = self.needed(params, job)?;
        let count = self.mixing.shown.len();
        // a part of a crown has its share of the crown's texels
        let share = if whole > 0.0 && params.branch_level.is_some() {
            (self.leaves.radius / whole).min(1.0)
        } else {
            1.0
        };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let part = |texels: u32| (f64::from(texels) * share).ceil().max(1.0) as u32;
        let limit = (part(params.resolution.0), part(params.resolution.1));
        let multiple = params.quadtree.map_or(1, |side| 1 << quadtree::border_levels(side));
        for (number, level) in self.levels.iter_mut().enumerate() {
            // a coarser level is only shown where pixels are that large
            let shown_from = match params.rule {
                LevelRule::Pixels(error_px) if number > 0 && level.error > 0.0 => {
                    error_px / level.error
                }
                _ => f64::INFINITY,
            };
            for (slicing, layout) in level.layouts.iter().enumerate() {
                job.check()?;
                let views = match &needed {
                    None => Some(f64::INFINITY),
                    Some(needed) => needed[number * count + slicing],
                };
                let is_stored = self.mixing.is_stored(slicing);
                let size = views.filter(|_| is_stored).map(|per_metre| {
                    let rect = layout.rect(&self.leaves);
                    let (width, height) = viewer::texels(per_metre.min(shown_from), &rect, limit);
                    let up = |texels: u32| texels.next_multiple_of(multiple);
                    (up(width), up(height))
                });
                level.sizes.push(size);
            }
            let left_out = |(slicing, size): (usize, &Option<(u32, u32)>)| {
                size.is_none() && self.mixing.is_stored(slicing)
            };
            let sizes = level.sizes.iter().enumerate();
            let some = level.sizes.iter().any(Option::is_some);
            if params.correction == Correction::Fit && some && sizes.clone().any(left_out) {
                let why = "'fit' needs all slicings, and these views leave some out".to_owned();
                return Err(LodError::Invalid { name: "correction", why });
            }
        }
        Ok(())
    }

    /// Pixels a metre of the nearest view that shows each slicing of each level.
    fn needed(&self, params: &Params, job: &Job) -> Result<Option<Vec<Option<f64>>>, LodError> {
        let Some(views) = &params.views else { return Ok(None) };
        let count = self.mixing.shown.len();
        let errors: Vec<f64> = self.levels.iter().map(|level| level.error).collect();
        let (center, radius) = (self.leaves.center, self.leaves.radius);
        let mixed = |view: &View, crown: &Crown, viewer: &Viewer| {
            let seen = Seen::new(view, crown, center, radius);
            let level = self.rule.choose(&errors, &seen).level;
            let grids = &self.levels[level].grids;
            let mut numbers: Vec<usize> = Vec::new();
            if grids.is_empty() {
                let shares = self.mixing.shares(viewer.toward, viewer.up);
                numbers.extend(shares.into_iter().map(|(number, _)| number));
            }
            for (slicing, grid) in grids.iter().enumerate() {
                if grid.is_seen(slicing, &self.mixing, viewer, (center, radius), job)? {
                    numbers.push(slicing);
                }
            }
            Ok(numbers.into_iter().map(|number| level * count + number).collect())
        };
        viewer::needed(views, &self.leaves, self.levels.len() * count, mixed, job).map(Some)
    }

    /// Slices that will be baked, with the texels of each.
    fn baked(&self) -> impl Iterator<Item = (u64, (u32, u32))> {
        self.levels.iter().flat_map(|level| {
            let sized = level.layouts.iter().zip(&level.sizes);
            sized.filter_map(|(layout, size)| Some((layout.count as u64, (*size)?)))
        })
    }

    pub(super) fn texel_count(&self) -> u64 {
        let texels = |(width, height): (u32, u32)| u64::from(width) * u64::from(height);
        self.baked().map(|(slices, size)| slices * texels(size)).sum()
    }

    /// Cards of all slices, at most.
    pub(super) fn card_count(&self, params: &Params) -> u64 {
        let cards = |size| cards_at_most(size, params.sub_slices, params.quadtree);
        self.baked().map(|(slices, size)| slices * cards(size)).sum()
    }

    pub(super) fn slice_count(&self) -> u64 {
        self.baked().map(|(slices, _)| slices).sum()
    }

    /// Marks the leaves, among all of the plant's, that stay in the mesh.
    pub(super) fn mark_in_mesh(&self, in_mesh: &mut [bool]) {
        for leaf in (0..self.in_mesh.len()).filter(|&leaf| self.in_mesh[leaf]) {
            in_mesh[self.leaves.number(leaf)] = true;
        }
    }

    /// Bakes what was planned.
    pub(super) fn bake(self, baker: &mut Baker<'_>, params: &Params) -> Result<Part, LodError> {
        let mut levels = Vec::new();
        for level in self.levels {
            let mut alpha = SilhouetteAlpha::default();
            let mut stacks = Vec::new();
            for (layout, size) in level.layouts.iter().zip(&level.sizes) {
                let Some(size) = *size else {
                    stacks.push(None);
                    continue;
                };
                let rect = layout.rect(&self.leaves);
                let in_mesh = |leaf: usize| self.in_mesh[leaf];
                let assignment = layout.assign(&self.leaves, rect, Cut::Large, in_mesh);
                stacks.push(Some(baker.stack(&self.leaves, &assignment, size, &mut alpha)?));
            }
            let tau = alpha.tau();
            let opacity = params.correction.unfitted(tau);
            let PlannedLevel { grids, error, .. } = level;
            levels.push(Level { stacks, grids, opacity, tau, error });
        }
        let errors = levels.iter().map(|level| level.error).collect();
        Ok(Part {
            mixing: self.mixing,
            name: self.name,
            rule: self.rule,
            levels,
            errors,
            drop_back: params.drop_back,
            center: self.leaves.center,
            radius: self.leaves.radius,
        })
    }
}

/// The cells of a slicing's slices.
fn grid(layout: &Layout, leaves: &Leaves<'_>, params: &Params) -> Grid {
    let offsets = (0..layout.count).map(|slice| layout.offset(slice)).collect();
    Grid::new(layout.rect(leaves), offsets, params.sub_slices)
}

/// Which leaves stay in the mesh, and how many are longer than a spacing, summed over slicings. A leaf
/// that is too long for one slicing stays there for all, or views between two would draw it twice.
fn large_leaves(
    leaves: &Leaves<'_>,
    layouts: &[Layout],
    params: &Params,
    job: &Job,
) -> Result<(Vec<bool>, usize), LodError> {
    let mut large_in = vec![0_usize; leaves.leaf_centers.len()];
    for layout in layouts {
        job.check()?;
        large_in
            .par_iter_mut()
            .enumerate()
            .for_each(|(leaf, count)| *count += usize::from(layout.is_large(leaves, leaf)));
    }
    let to_mesh = params.large_leaves == LargeLeaves::Mesh;
    let in_mesh = large_in.iter().map(|&count| to_mesh && count > 0).collect();
    Ok((in_mesh, large_in.iter().sum()))
}

/// A crown with its slicings.
#[derive(Debug)]
pub(super) struct Part {
    mixing: Mixing,
    /// What its slicings are called, before their number.
    name: String,
    rule: LevelRule,
    /// The finest first.
    pub(super) levels: Vec<Level>,
    errors: Vec<f64>,
    drop_back: usize,
    pub(super) center: DVec3,
    pub(super) radius: f64,
}

/// All slicings with one number of slices.
#[derive(Debug)]
pub(super) struct Level {
    /// `None` where no view needs the slicing, or where another one's slices show it.
    pub(super) stacks: Vec<Option<Stack>>,
    /// Cells of the slices, where they have shares of their own.
    grids: Vec<Grid>,
    pub(super) opacity: Opacity,
    pub(super) tau: f64,
    /// How far a leaf may seem to be from its place, in metres.
    pub(super) error: f64,
}

impl Part {
    pub(super) fn stacks(&self) -> impl Iterator<Item = &Stack> {
        self.levels.iter().flat_map(|level| level.stacks.iter().flatten())
    }

    /// For each slicing whether it can be drawn in some level.
    pub(super) fn baked(&self) -> Vec<bool> {
        let can = |&shown: &usize| self.levels.iter().any(|level| level.stacks[shown].is_some());
        self.mixing.shown.iter().map(can).collect()
    }

    pub(super) fn textures(&self) -> Vec<NamedTexture> {
        let levels = self.levels.iter().enumerate().flat_map(|(number, level)| {
            let prefix =
                if self.levels.len() > 1 { format!("level {number}, ") } else { String::new() };
            let stacks = level.stacks.iter().enumerate();
            stacks.flat_map(move |(slicing, stack)| {
                let name = format!("{prefix}{} {slicing}", self.name);
                let textures =
                    stack.iter().flat_map(move |stack| stack.textures(&name).collect::<Vec<_>>());
                textures.collect::<Vec<_>>()
            })
        });
        levels.collect()
    }

    /// The level that a view shows.
    pub(super) fn level(&self, view: &View, crown: &Crown) -> usize {
        let seen = Seen::new(view, crown, self.center, self.radius);
        self.rule.choose(&self.errors, &seen).level
    }

    pub(super) fn emit(
        &self,
        view: &View,
        crown: &Crown,
        cards: &Arc<Geometry>,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        let level = self.level(view, crown);
        self.emit_level(view, crown, (level, self.levels[level].opacity), cards, builder)
    }

    fn emit_level(
        &self,
        view: &View,
        crown: &Crown,
        (number, law): (usize, Opacity),
        cards: &Arc<Geometry>,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        let level = &self.levels[number];
        let viewer = Viewer::new(view, crown, self.center, self.radius);
        let pixel_size = Seen::new(view, crown, self.center, self.radius).pixel_size();
        let drawing = Drawing { drop_back: self.drop_back, pixel_size };
        let missing = |slicing: usize| LodError::Invalid {
            name: "camera",
            why: format!(
                "this camera needs {} {slicing}{}, which was not baked; build with it in views",
                self.name,
                if number > 0 { format!(" of level {number}") } else { String::new() },
            ),
        };
        if !level.grids.is_empty() {
            let cells = Cells {
                mixing: &self.mixing,
                stacks: &level.stacks,
                grids: &level.grids,
                crowned: (self.center, self.radius),
                law,
                drawing,
            };
            return cells.emit(view, crown, &viewer, cards, builder).map_err(missing);
        }
        let shares = self.mixing.shares(viewer.toward, viewer.up);
        let mut mixed: Vec<Mixed<'_>> = Vec::new();
        for (&(slicing, _), opacity) in shares.iter().zip(law.of(&shares)) {
            let stack = level.stacks[slicing].as_ref().ok_or_else(|| missing(slicing))?;
            mixed.push((stack, opacity));
        }
        push_stacks(view, crown, &viewer, (cards, drawing), &mixed, builder);
        Ok(())
    }

    /// Mean alpha of a level's slices over directions, by a law.
    pub(super) fn mean_alpha(
        &self,
        (level, law): (usize, Opacity),
        cards: &Arc<Geometry>,
        over: &[DVec3],
        job: &Job,
    ) -> Result<f64, LodError> {
        let emit = |view: &View, crown: &Crown, builder: &mut ListBuilder| {
            self.emit_level(view, crown, (level, law), cards, builder)
        };
        opacity::Measured { center: self.center, radius: self.radius, emit }.mean_alpha(over, job)
    }

    /// Fits the law of a level; whether a root was found.
    pub(super) fn fit(
        &mut self,
        level: usize,
        cards: &Arc<Geometry>,
        job: &Job,
    ) -> Result<Option<bool>, LodError> {
        let (tau, plain) = (self.levels[level].tau, self.levels[level].opacity);
        if self.levels[level].stacks.iter().all(Option::is_none) {
            // no view shows it
            return Ok(None);
        }
        let (law, fitted) = opacity::chosen(Correction::Fit, tau, |law| {
            let blend = &self.mixing.blend;
            let over = match law {
                None => blend.directions().to_vec(),
                Some(_) => all_around(blend.is_level()),
            };
            self.mean_alpha((level, law.unwrap_or(plain)), cards, &over, job)
        })?;
        self.levels[level].opacity = law;
        Ok(fitted)
    }
}
