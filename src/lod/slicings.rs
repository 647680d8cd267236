//! Slicings: parallel slices through the crown, baked for several directions and blended.
//!
//! Leaves go to the nearest of a slicing's equidistant planes; leaves longer than the planes' spacing
//! are cut at the middle between planes, sample by sample, so that the slices together hold every
//! leaf exactly once. A view paints the slicings that it lies between, interleaved from the farthest
//! slice to the nearest, with opacities that follow the angle. Wood stays a mesh.
//!
//! This work is based on:
//! Aleks Jakulin. Interactive Vegetation Rendering with Slicing and Blending. 2000
//!
//! Deviations: the centre is that of the box of leaf centres; the outermost slabs reach to infinity;
//! angles are measured along the circle; two more opacity corrections can be chosen.

mod branches;
#[cfg(test)]
mod option_tests;
mod part;
mod sub_slices;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use glam::DVec3;

use crate::draw_list::{Buffers, Geometry};
use crate::error::{LodError, check_in, check_limit};
use crate::job::Job;
use crate::lod::leaves::Leaves;
use crate::lod::level_rule::LevelRule;
pub use crate::lod::opacity::Correction;
use crate::lod::solid::Solid;
use crate::lod::stack::{self, Baker, MAX_COUNT, MAX_TOTAL_TEXELS, Stack};
use crate::lod::view_blend::ViewBlend;
use crate::lod::wood::Wood;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture, Representation, foot_of};
use crate::plant::{Mesh, Plant};
use crate::texture::quadtree;
use crate::texture::{Filter, Format};
use crate::view::View;
use crate::view_state::ViewState;
use part::{Part, Plan};

/// More cells along a side of a slice than this are taken for a mistake.
const MAX_SUB_SLICES: usize = 64;

/// Cards of all cells together.
const MAX_CARDS: u64 = 1 << 20;

/// Sides of the smallest and of the largest squares that textures may be kept in. The border of a smaller
/// one would only do for the finest level, and all others would be stored twice.
const QUADTREE_SIDES: std::ops::RangeInclusive<u32> = 16..=1024;

/// What becomes of leaves longer than the planes' spacing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LargeLeaves {
    /// Cut between the planes.
    Split,
    /// Drawn as they are, beside the wood.
    Mesh,
}

/// How slicings are built.
#[derive(Debug, Clone)]
pub struct Params {
    /// One slicing each.
    pub blend: ViewBlend,
    /// Slices a slicing, by level: falling, the finest first.
    pub slice_counts: Vec<usize>,
    /// What decides the level of a view.
    pub rule: LevelRule,
    /// Texels a slice, width and height.
    pub resolution: (u32, u32),
    /// Samples a texel.
    pub sample_count: u32,
    /// Opacity correction.
    pub correction: Correction,
    /// Leaves longer than the spacing.
    pub large_leaves: LargeLeaves,
    /// Rearmost slices of each slicing that are not drawn.
    pub drop_back: usize,
    /// Whether opposite slicings share textures.
    pub mirrored: bool,
    /// Cells along each side of a slice, each with shares of its own.
    pub sub_slices: usize,
    /// Least side, in texels, of the squares that textures are kept in; `None` keeps them whole.
    pub quadtree: Option<u32>,
    /// Generation of the branches that get a slicing each, instead of the crown; 1 are those that grow
    /// from the trunk.
    pub branch_level: Option<u32>,
    /// Texel format.
    pub format: Format,
    /// The wood that stays a mesh.
    pub wood: Wood,
    /// The cameras that will look, in the plant's own world; `None` bakes for all.
    pub views: Option<Vec<View>>,
}

/// What was measured of a level while building, for the report.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredLevel {
    /// Slices of each slicing, where the crown is deep.
    pub slice_count: usize,
    /// The multiplier in use; `None` with the optical correction.
    pub m: Option<f64>,
    /// Whether `correction="fit"` found a root, or took the nearer end of its interval.
    pub fitted: Option<bool>,
    /// Optical depth of a slice: minus the logarithm of 1 - the mean slice alpha.
    pub tau: f64,
    /// How far, in metres, a leaf may seem to be from its place where a view faces a slicing worst.
    pub error: f64,
}

/// What was measured while building, for the report.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// The finest first.
    pub levels: Vec<MeasuredLevel>,
    /// Leaves cut between slices of the finest level, or left in the mesh, summed over slicings.
    pub large_leaf_count: usize,
    /// Crowns with slicings of their own: branches, or 1.
    pub part_count: usize,
}

/// The technique's representation of a plant.
#[derive(Debug)]
pub struct Slicings {
    parts: Vec<Part>,
    cards: Arc<Geometry>,
    solid: Solid,
    bounds: (DVec3, DVec3),
    foot: DVec3,
    origin: DVec3,
}

fn check(params: &Params) -> Result<(), LodError> {
    let Some(&most) = params.slice_counts.first() else {
        return Err(LodError::Empty { name: "slice_count", why: "give at least one count" });
    };
    for &slice_count in &params.slice_counts {
        stack::check(slice_count, params.resolution, params.sample_count)?;
    }
    if !params.slice_counts.is_sorted_by(|a, b| a > b) {
        let why = format!("must fall from level to level, got {:?}", params.slice_counts);
        return Err(LodError::Invalid { name: "slice_count", why });
    }
    params.rule.check(params.slice_counts.len())?;
    check_in("slicing_count", params.blend.directions().len(), 1..=MAX_COUNT)?;
    params.correction.check()?;
    check_in("drop_back", params.drop_back, 0..=most - 1)?;
    check_in("sub_slices", params.sub_slices, 1..=MAX_SUB_SLICES)?;
    if let Some(least_side) = params.quadtree {
        check_in("quadtree", least_side, QUADTREE_SIDES)?;
        let multiple = 1 << quadtree::border_levels(least_side);
        let (width, height) = params.resolution;
        if !least_side.is_power_of_two() {
            let why = format!("must be a power of two, got {least_side}");
            return Err(LodError::Invalid { name: "quadtree", why });
        }
        if width % multiple != 0 || height % multiple != 0 {
            let why = format!(
                "must be multiples of {multiple} for a quad-tree of {least_side}, got {width} x {height}"
            );
            return Err(LodError::Invalid { name: "resolution", why });
        }
    }
    if params.branch_level.is_some() {
        let refused = |name, what| {
            let why = format!("{what}, and a branch of branch_level has only one slicing");
            Err(LodError::Invalid { name, why })
        };
        if params.correction == Correction::Fit {
            return refused("correction", "'fit' measures the blend of slicings");
        }
        if params.blend.is_vertical() {
            return refused("vertical", "adds a slicing to others");
        }
        if params.sub_slices > 1 {
            return refused("sub_slices", "cells are blended with those of other slicings");
        }
    }
    if params.views.as_ref().is_some_and(Vec::is_empty) {
        let why = "give at least one camera, or None for all directions";
        return Err(LodError::Empty { name: "views", why });
    }
    Ok(())
}

impl Slicings {
    /// Bakes the slices of a plant.
    ///
    /// # Errors
    /// `foliage` without leaves; a parameter out of range; `branch_level` for a plant whose structure
    /// is not known, or with what blends several slicings; [`LodError::Cancelled`].
    pub fn build(plant: &Plant, params: &Params, job: &Job) -> Result<(Self, Measured), LodError> {
        check(params)?;
        let leaves = Leaves::new(plant)?;
        let crowns = match params.branch_level {
            None => vec![(leaves.clone(), params.blend.clone(), "slicing".to_owned())],
            Some(level) => branches::crowns(&leaves, level, job)?,
        };
        let whole = leaves.radius;
        let plans: Result<Vec<Plan<'_>>, LodError> = crowns
            .into_iter()
            .map(|(leaves, blend, name)| Plan::new(leaves, blend, name, whole, params, job))
            .collect();
        let plans = plans?;
        let texels = plans.iter().map(Plan::texel_count).sum();
        check_limit("resolution", texels, MAX_TOTAL_TEXELS, "texels")?;
        if params.sub_slices > 1 {
            let cards = plans.iter().map(|plan| plan.card_count(params)).sum();
            check_limit("sub_slices", cards, MAX_CARDS, "cards")?;
        }
        job.begin(plans.iter().map(Plan::slice_count).sum());
        let wood = params.wood.of(plant)?;
        let (quadtree, grid) = (params.quadtree, params.sub_slices);
        let mut baker = Baker::new(params.sample_count, params.format, quadtree, grid, job);
        let mut in_mesh = vec![false; plant.foliage.leaf_count()];
        let mut large_leaf_count = 0;
        let mut parts = Vec::new();
        for plan in plans {
            large_leaf_count += plan.large_leaf_count;
            plan.mark_in_mesh(&mut in_mesh);
            parts.push(plan.bake(&mut baker, params)?);
        }
        let cards = baker.into_cards();
        let levels = (0..params.slice_counts.len()).map(|level| {
            let errors = parts.iter().map(|part| part.levels[level].error);
            let taus = parts.iter().map(|part| part.levels[level].tau);
            MeasuredLevel {
                slice_count: params.slice_counts[level],
                m: parts[0].levels[level].opacity.m(),
                fitted: None,
                tau: taus.sum::<f64>() / parts.len() as f64,
                error: errors.fold(0.0, f64::max),
            }
        });
        let mut levels: Vec<MeasuredLevel> = levels.collect();
        if params.correction == Correction::Fit {
            for (level, measured) in levels.iter_mut().enumerate() {
                measured.fitted = parts[0].fit(level, &cards, job)?;
                measured.m = parts[0].levels[level].opacity.m();
            }
        }
        let (large, large_ids) = leaves_mesh(&leaves, &in_mesh);
        let solid = [(&wood, Buffers::ids_from(0, &wood)), (&large, large_ids)];
        let measured = Measured { levels, large_leaf_count, part_count: parts.len() };
        let meshes = [&plant.foliage.mesh, &wood];
        let built = Self {
            parts,
            bounds: stack::bounds(&meshes, &[&cards]),
            foot: foot_of(meshes.into_iter().filter_map(Mesh::bounds)),
            cards,
            solid: Solid::new(&solid, &plant.materials, Filter::Bilinear, job)?,
            origin: plant.origin,
        };
        Ok((built, measured))
    }

    /// Which slicings can be drawn; of branches, all.
    pub fn baked(&self) -> Vec<bool> {
        self.parts.iter().flat_map(Part::baked).collect()
    }

    /// Index of the level that a view shows, of the first crown where a plant stands as it was built.
    #[cfg(test)]
    fn level(&self, view: &View) -> usize {
        let crown = Crown::alone(glam::DAffine3::from_translation(self.origin));
        self.parts[0].level(view, &crown)
    }

    /// Crowns from the farthest to the nearest; equally far ones in their own order.
    fn far_to_near(&self, view: &View, crown: &Crown) -> Vec<&Part> {
        let distance = |part: &Part| {
            let center = crown.world_from_local.transform_point3(part.center);
            if view.is_orthographic() {
                view.view_from_world(center).z
            } else {
                center.distance(view.eye)
            }
        };
        let mut sorted: Vec<&Part> = self.parts.iter().collect();
        sorted.sort_by(|a, b| distance(b).total_cmp(&distance(a)));
        sorted
    }
}

/// The leaves that stay in the mesh, with the plant's own ids of their triangles.
fn leaves_mesh(leaves: &Leaves<'_>, in_mesh: &[bool]) -> (Mesh, Vec<u32>) {
    let foliage = &leaves.plant.foliage;
    if !in_mesh.contains(&true) {
        return (Mesh::default(), Vec::new());
    }
    let kept: Vec<usize> = (0..in_mesh.len())
        .filter(|&leaf| in_mesh[leaf])
        .flat_map(|leaf| foliage.triangles_of(leaf))
        .collect();
    let material_ids: Vec<u32> = kept.iter().map(|&t| leaves.materials[t]).collect();
    let first = leaves.plant.wood.triangles.len();
    let id = |&t: &usize| u32::try_from(first + t).expect("checked by the plant");
    let mesh = Mesh {
        triangles: kept.iter().map(|&t| foliage.mesh.triangles[t]).collect(),
        parts: Mesh::parts_from_ids(&material_ids),
        ..foliage.mesh.clone()
    };
    (mesh.without_unused_vertices(), kept.iter().map(id).collect())
}

impl Representation for Slicings {
    fn bounds(&self) -> (DVec3, DVec3) {
        self.bounds
    }

    fn foot(&self) -> DVec3 {
        self.foot
    }

    fn origin(&self) -> DVec3 {
        self.origin
    }

    fn footprint(&self) -> Footprint {
        let stacks: Vec<&Stack> = self.parts.iter().flat_map(Part::stacks).collect();
        stack::footprint(&stacks, &self.cards, self.solid.footprint())
    }

    fn textures(&self) -> Vec<NamedTexture> {
        self.parts.iter().flat_map(Part::textures).chain(self.solid.textures()).collect()
    }

    fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        self.solid.emit(view, crowns, state, builder);
        for crown in crowns {
            for part in self.far_to_near(view, crown) {
                part.emit(view, crown, &self.cards, builder)?;
            }
        }
        Ok(())
    }
}
