//! Orthogonal slices: the crown cut into slabs across two or three axes, each slab a card that stays
//! where it is, and the cards of an axis more opaque the more they face the viewer.
//!
//! Leaves, and the wood where it is baked in, are clipped at the borders of the slabs sample by sample,
//! so that the slabs of each axis together hold every leaf exactly once. The cards of two axes cross;
//! they are painted either stack by stack in turn, or cut at one another and in exact order.
//!
//! This work is based on:
//! Daniel Sanchez-Crespo Dalmau. Core Techniques and Algorithms in Game Programming. 2003 (chapter 20)
//!
//! Deviations: the two laws of opacity and their correction, which the book leaves to trial and error;
//! the exact order; treetops whose leaves are taken out of the other slices.

mod pieces;
#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::ops::RangeInclusive;
use std::sync::Arc;

use glam::{DAffine3, DVec3};

use crate::draw_list::{Buffers, Geometry};
use crate::error::{LodError, check_in, check_limit};
use crate::job::Job;
use crate::lod::leaves::Leaves;
use crate::lod::opacity::{self, Correction, Opacity, SilhouetteAlpha, all_around};
use crate::lod::slabs::{Cut, Layout};
use crate::lod::solid::Solid;
use crate::lod::stack::{
    self, Baker, Drawing, MAX_COUNT, MAX_TOTAL_TEXELS, Mixed, Stack, push_stacks,
};
use crate::lod::view_blend::{ViewBlend, ordered};
use crate::lod::viewer::{self, Viewer};
use crate::lod::wood::Wood;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture, Representation, foot_of};
use crate::plant::{Foliage, Mesh, Part, Plant};
use crate::texture::{Filter, Format};
use crate::view::View;
use crate::view_state::ViewState;
use pieces::Pieces;

/// The axes: the first two are those of a technique with two.
pub const AXES: [DVec3; 3] = [DVec3::Z, DVec3::X, DVec3::Y];

/// Exponents of the power law.
pub const K_RANGE: RangeInclusive<f64> = 0.0..=64.0;

/// What textures and messages call them.
const NAMES: [&str; 3] = ["z", "x", "y"];

/// Where in its swing a treetop is when the rest of the crown is at the beginning.
const TREETOP_PHASE: f64 = 0.25;

/// In which shares a view mixes the axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Law {
    /// `|u.v|^k` of each axis `u` and the direction `v` to the eye, over their sum; equal where all
    /// are 0.
    Power {
        /// In [0, 64].
        k: f64,
    },
    /// As slicings: linear in the angle along the horizon. With three axes the barycentric
    /// coordinates on the octahedron, which are those of `Power` with 1.
    Linear,
}

/// How crossing cards are painted over one another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Whole: the farthest of each axis, then the second farthest of each, and so on.
    Slices,
    /// Cut where they cross, each piece behind all that hide it.
    Exact,
}

/// A part of the crown that moves by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Treetop {
    /// Slices of each axis; 0 for no treetop.
    pub slice_count: usize,
    /// Share of the height of the box of leaf centres that is treetop, in (0, 1).
    pub height_rel: f64,
}

/// How orthogonal slices are built.
#[derive(Debug, Clone)]
pub struct Params {
    /// 2 for z and x, 3 for y too.
    pub axis_count: usize,
    /// Slices an axis.
    pub slice_count: usize,
    /// Texels a slice, width and height.
    pub resolution: (u32, u32),
    /// Samples a texel.
    pub sample_count: u32,
    /// Shares of the axes.
    pub law: Law,
    /// Opacity correction.
    pub correction: Correction,
    /// Order of the cards.
    pub order: Order,
    /// Leaves at the top that sway by themselves.
    pub treetop: Treetop,
    /// Texel format.
    pub format: Format,
    /// The wood.
    pub wood: Wood,
    /// Whether the wood is in the slices instead of staying a mesh.
    pub bakes_wood: bool,
    /// The cameras that will look, in the plant's own world; `None` bakes all axes.
    pub views: Option<Vec<View>>,
}

/// What was measured while building, for the report.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// The multiplier in use; `None` with the optical correction.
    pub m: Option<f64>,
    /// Whether `correction="fit"` found a root, or took the nearer end of its interval.
    pub fitted: Option<bool>,
    /// Optical depth of a slice: minus the logarithm of 1 - the mean slice alpha.
    pub tau: f64,
    /// Leaves in the treetop.
    pub treetop_leaf_count: usize,
}

/// The technique's representation of a plant.
#[derive(Debug)]
pub struct OrthogonalSlices {
    shares: Shares,
    /// All of the crown but the treetop.
    crown: Crossing,
    treetop: Option<Crossing>,
    /// Height, above the plant's origin, at which the treetop begins.
    treetop_foot: f64,
    solid: Solid,
    opacity: Opacity,
    center: DVec3,
    radius: f64,
    bounds: (DVec3, DVec3),
    foot: DVec3,
    origin: DVec3,
}

/// A stack of slices for each axis.
#[derive(Debug)]
struct Crossing {
    /// `None` where no view needs the axis.
    stacks: Vec<Option<Stack>>,
    cards: Arc<Geometry>,
    /// The cards cut at one another, where they are painted in exact order.
    pieces: Option<Pieces>,
    /// Of its leaves, relative to the plant's origin.
    center: DVec3,
    radius: f64,
}

/// A law for a number of axes.
#[derive(Debug, Clone)]
enum Shares {
    Power {
        k: f64,
        axis_count: usize,
    },
    /// Axes in turn around the horizon.
    Around(ViewBlend),
}

impl Shares {
    fn new(law: Law, axis_count: usize) -> Result<Self, LodError> {
        Ok(match law {
            Law::Power { k } => {
                check_in("k", k, K_RANGE)?;
                Self::Power { k, axis_count }
            }
            Law::Linear if axis_count == 2 => {
                let [z, x, _] = AXES;
                Self::Around(ViewBlend::new(&[z, x, -z, -x], None).expect("level and different"))
            }
            Law::Linear => Self::Power { k: 1.0, axis_count },
        })
    }

    /// Axes to mix towards a viewer, with shares that add up to 1, in the order of drawing.
    fn of(&self, viewer: &Viewer) -> Vec<(usize, f64)> {
        match self {
            Self::Power { k, axis_count } => {
                let facing = AXES[..*axis_count].iter().map(|u| u.dot(viewer.toward).abs());
                let facing: Vec<f64> = facing.collect();
                let most = facing.iter().copied().fold(0.0, f64::max);
                // relative to the largest, so that a high power of small numbers is not 0 everywhere
                let power = |at: f64| if most > 0.0 { libm::pow(at / most, *k) } else { 1.0 };
                let powers: Vec<f64> = facing.into_iter().map(power).collect();
                let total: f64 = powers.iter().sum();
                ordered(powers.into_iter().map(|power| power / total).enumerate().collect())
            }
            Self::Around(blend) => {
                let shares = blend.shares(viewer.toward, viewer.up);
                ordered(shares.into_iter().map(|(number, share)| (number % 2, share)).collect())
            }
        }
    }
}

impl OrthogonalSlices {
    /// Bakes the slices of a plant.
    ///
    /// # Errors
    /// `foliage` without leaves; `axes`, `slice_count`, `resolution`, `samples`, `k`, `correction`,
    /// `treetop_slice_count`, `treetop_height_rel` or `views` out of range; [`LodError::Cancelled`].
    pub fn build(plant: &Plant, params: &Params, job: &Job) -> Result<(Self, Measured), LodError> {
        check_in("axes", params.axis_count, 2..=AXES.len())?;
        stack::check(params.slice_count, params.resolution, params.sample_count)?;
        params.correction.check()?;
        let treetop = params.treetop;
        check_in("treetop_slice_count", treetop.slice_count, 0..=MAX_COUNT)?;
        check_in("treetop_height_rel", treetop.height_rel, 1e-6..=1.0 - 1e-6)?;
        let shares = Shares::new(params.law, params.axis_count)?;
        let wood = params.wood.of(plant)?;
        if plant.foliage.leaf_count() == 0 {
            return Err(Leaves::missing());
        }
        let in_slices = if params.bakes_wood { &wood } else { &Mesh::default() };
        let whole = with_wood(plant, in_slices, job)?;
        let leaves = Leaves::new(&whole)?;
        let needed = needed(&leaves, &shares, params, job)?;
        if params.correction == Correction::Fit && needed.contains(&None) {
            let why = "'fit' needs all axes, and these views leave some out".to_owned();
            return Err(LodError::Invalid { name: "correction", why });
        }
        let (lower, upper, treetop_foot) = parted(&leaves, plant.foliage.leaf_count(), params);
        let treetop_leaf_count = upper.len();
        let crown = if upper.is_empty() { leaves.clone() } else { leaves.chosen(&lower) };
        let upper = (!upper.is_empty()).then(|| (treetop.slice_count, leaves.chosen(&upper)));
        // the counts before any texel is allocated
        let sets: Vec<(usize, &Leaves<'_>)> = [(params.slice_count, &crown)]
            .into_iter()
            .chain(upper.as_ref().map(|(count, leaves)| (*count, leaves)))
            .collect();
        let plans: Vec<Vec<Option<Planned>>> =
            sets.iter().map(|(count, leaves)| plan(leaves, *count, &needed, params)).collect();
        let planned = || plans.iter().flatten().flatten();
        let texels =
            |p: &Planned| p.layout.count as u64 * u64::from(p.size.0) * u64::from(p.size.1);
        check_limit("resolution", planned().map(texels).sum(), MAX_TOTAL_TEXELS, "texels")?;
        if params.order == Order::Exact {
            let counts = planned().map(|p| p.layout.count as u64 + 1).collect::<Vec<_>>();
            let others = u32::try_from(params.axis_count - 1).expect("two or three");
            let most = counts.iter().copied().max().unwrap_or(1).saturating_pow(others);
            let pieces = counts.iter().map(|count| count.saturating_mul(most)).sum();
            check_limit("slice_count", pieces, MAX_PIECES, "pieces of cards")?;
        }
        job.begin(planned().map(|planned| planned.layout.count as u64).sum());
        let mut alpha = SilhouetteAlpha::default();
        let mut crossings = Vec::new();
        for ((_, leaves), plan) in sets.iter().zip(&plans) {
            crossings.push(Crossing::bake(leaves, plan, params, &mut alpha, job)?);
        }
        let tau = alpha.tau();
        let as_mesh = if params.bakes_wood { &Mesh::default() } else { &wood };
        let cards: Vec<&Geometry> = crossings.iter().map(|crossing| &*crossing.cards).collect();
        let meshes = [&plant.foliage.mesh, &wood];
        let bounds = stack::bounds(&meshes, &cards);
        let mut crossings = crossings.into_iter();
        let mut built = Self {
            shares,
            bounds,
            foot: foot_of(meshes.into_iter().filter_map(Mesh::bounds)),
            crown: crossings.next().expect("the crown itself"),
            treetop: crossings.next(),
            treetop_foot,
            solid: Solid::new(
                &[(as_mesh, Buffers::ids_from(0, as_mesh))],
                &plant.materials,
                Filter::Bilinear,
                job,
            )?,
            opacity: Opacity::Optical { tau },
            center: leaves.center,
            radius: leaves.radius,
            origin: plant.origin,
        };
        let (opacity, fitted) = opacity::chosen(params.correction, tau, |law| {
            let axes = &AXES[..params.axis_count];
            let over = match law {
                None => axes.iter().flat_map(|&axis| [axis, -axis]).collect(),
                Some(_) => all_around(params.axis_count == 2),
            };
            built.mean_alpha(law.unwrap_or(built.opacity), &over, job)
        })?;
        built.opacity = opacity;
        Ok((built, Measured { m: opacity.m(), fitted, tau, treetop_leaf_count }))
    }

    /// Mean alpha of the slices over directions, by a law.
    fn mean_alpha(&self, law: Opacity, over: &[DVec3], job: &Job) -> Result<f64, LodError> {
        let emit = |view: &View, crown: &Crown, builder: &mut ListBuilder| {
            self.emit_slices(view, crown, crown, law, builder)
        };
        opacity::Measured { center: self.center, radius: self.radius, emit }.mean_alpha(over, job)
    }

    /// Which axes have been baked.
    pub fn baked(&self) -> Vec<bool> {
        self.crown.stacks.iter().map(Option::is_some).collect()
    }

    fn crossings(&self) -> impl Iterator<Item = &Crossing> {
        [&self.crown].into_iter().chain(&self.treetop)
    }

    /// The slices of a crown whose treetop stands where `top` says.
    fn emit_slices(
        &self,
        view: &View,
        crown: &Crown,
        top: &Crown,
        law: Opacity,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        let viewer = Viewer::new(view, crown, self.center, self.radius);
        let shares = self.shares.of(&viewer);
        let mixed: Vec<(usize, f64)> =
            shares.iter().map(|&(axis, _)| axis).zip(law.of(&shares)).collect();
        for &(axis, _) in &mixed {
            if self.crown.stacks[axis].is_none() {
                let why = format!(
                    "this camera needs axis {}, which was not baked; build with it in views",
                    NAMES[axis]
                );
                return Err(LodError::Invalid { name: "camera", why });
            }
        }
        let Some(treetop) = &self.treetop else {
            self.crown.emit(view, crown, &mixed, builder);
            return Ok(());
        };
        // a level plane parts the two: what lies on the eye's side of it comes last
        let is_above = match viewer.eye {
            Some(eye) => eye.y + self.center.y > self.treetop_foot,
            None => viewer.toward.y > 0.0,
        };
        if is_above {
            self.crown.emit(view, crown, &mixed, builder);
            treetop.emit(view, top, &mixed, builder);
        } else {
            treetop.emit(view, top, &mixed, builder);
            self.crown.emit(view, crown, &mixed, builder);
        }
        Ok(())
    }

    /// A crown in the wind, and its treetop, which swings a quarter of a swing ahead above its foot.
    fn moved(&self, view: &View, crown: &Crown) -> (Crown, Crown) {
        let Some(gust) = crown.wind else { return (crown.clone(), crown.clone()) };
        let placed = crown.world_from_local;
        let shear = gust.shear(view, &placed, self.foot());
        let treetop_foot = DVec3::Y * self.treetop_foot;
        let slope = gust.slope_at(gust.phase() + TREETOP_PHASE);
        let top = gust.shear_by(view, &placed, treetop_foot, slope);
        // what the crown's shear does to the treetop's foot it does to all of the treetop
        let carried = shear.transform_point3(treetop_foot) - treetop_foot;
        let top = DAffine3::from_translation(carried) * top;
        let of = |local: DAffine3| Crown { world_from_local: placed * local, ..crown.clone() };
        (of(shear), of(top))
    }
}

/// Pieces of cards, all together.
const MAX_PIECES: u64 = 1 << 20;

/// Slices to be baked.
struct Planned {
    layout: Layout,
    size: (u32, u32),
}

/// Slices of some leaves for each axis that is needed.
fn plan(
    leaves: &Leaves<'_>,
    slice_count: usize,
    needed: &[Option<Option<f64>>],
    params: &Params,
) -> Vec<Option<Planned>> {
    let planned = AXES.iter().zip(needed).map(|(&axis, per_metre)| {
        let layout = Layout::of_vertices(axis, leaves, slice_count);
        let size = match (*per_metre)? {
            None => params.resolution,
            Some(per_metre) => {
                viewer::texels(per_metre, &layout.least_rect(leaves), params.resolution)
            }
        };
        Some(Planned { layout, size })
    });
    planned.collect()
}

/// For each axis whether it is needed, and with at least how many texels a metre, where that is known.
fn needed(
    leaves: &Leaves<'_>,
    shares: &Shares,
    params: &Params,
    job: &Job,
) -> Result<Vec<Option<Option<f64>>>, LodError> {
    let Some(views) = &params.views else { return Ok(vec![Some(None); params.axis_count]) };
    let mixed = |_: &View, _: &Crown, viewer: &Viewer| {
        Ok(shares.of(viewer).into_iter().map(|(axis, _)| axis).collect())
    };
    let needed = viewer::needed(views, leaves, params.axis_count, mixed, job)?;
    Ok(needed.into_iter().map(|per_metre| per_metre.map(Some)).collect())
}

/// The plant with some wood among its leaves, a triangle a leaf, after all others.
fn with_wood<'p>(plant: &'p Plant, wood: &Mesh, job: &Job) -> Result<Cow<'p, Plant>, LodError> {
    if wood.is_empty() {
        return Ok(Cow::Borrowed(plant));
    }
    let mut mesh = plant.foliage.mesh.clone();
    let count = |count: usize| u32::try_from(count).expect("checked by the plant");
    let (first_vertex, first) = (count(mesh.positions.len()), count(mesh.triangles.len()));
    mesh.positions.extend_from_slice(&wood.positions);
    mesh.normals.extend_from_slice(&wood.normals);
    mesh.uvs.extend_from_slice(&wood.uvs);
    mesh.base.extend_from_slice(&wood.base);
    mesh.front.extend_from_slice(&wood.front);
    mesh.back.extend_from_slice(&wood.back);
    mesh.triangles.extend(wood.triangles.iter().map(|corners| corners.map(|v| v + first_vertex)));
    mesh.parts.extend(wood.parts.iter().map(|part| Part {
        material: part.material,
        triangles: part.triangles.start + first..part.triangles.end + first,
    }));
    let mut offsets = plant.foliage.leaf_offsets.clone();
    offsets.extend(first + 1..=first + count(wood.triangles.len()));
    let foliage = Foliage::new(mesh, offsets, job)?;
    // no branch has this wood, or these leaves
    Ok(Cow::Owned(Plant { foliage, wood: Mesh::default(), structure: None, ..plant.clone() }))
}

/// The leaves below the treetop and those in it, and the height of its foot. Wood, which comes after
/// `leaf_count` leaves, is in no treetop.
fn parted(
    leaves: &Leaves<'_>,
    leaf_count: usize,
    params: &Params,
) -> (Vec<usize>, Vec<usize>, f64) {
    let heights = || leaves.leaf_centers[..leaf_count].iter().map(|center| center.y);
    let low = heights().fold(f64::INFINITY, f64::min);
    let high = heights().fold(f64::NEG_INFINITY, f64::max);
    let Treetop { slice_count, height_rel } = params.treetop;
    let foot = high - height_rel * (high - low);
    let is_treetop =
        |&leaf: &usize| leaf < leaf_count && slice_count > 0 && leaves.leaf_centers[leaf].y > foot;
    let (upper, lower) = (0..leaves.leaf_centers.len()).partition(is_treetop);
    (lower, upper, foot + leaves.center.y)
}

impl Crossing {
    fn bake(
        leaves: &Leaves<'_>,
        plan: &[Option<Planned>],
        params: &Params,
        alpha: &mut SilhouetteAlpha,
        job: &Job,
    ) -> Result<Self, LodError> {
        let mut baker = Baker::new(params.sample_count, params.format, None, 1, job);
        let stacks: Result<Vec<Option<Stack>>, LodError> = plan
            .iter()
            .map(|planned| {
                let Some(Planned { layout, size }) = planned else { return Ok(None) };
                let rect = layout.least_rect(leaves);
                let assignment = layout.assign(leaves, rect, Cut::All, |_| false);
                baker.stack(leaves, &assignment, *size, alpha).map(Some)
            })
            .collect();
        let stacks = stacks?;
        let (cards, pieces) = match params.order {
            Order::Slices => (baker.into_cards(), None),
            Order::Exact => {
                let (pieces, cards) = Pieces::cut(&stacks, leaves.center);
                (cards, Some(pieces))
            }
        };
        Ok(Self { stacks, cards, pieces, center: leaves.center, radius: leaves.radius })
    }

    /// Paints the axes with their opacities.
    fn emit(&self, view: &View, crown: &Crown, mixed: &[(usize, f64)], builder: &mut ListBuilder) {
        let viewer = Viewer::new(view, crown, self.center, self.radius);
        let stack = |axis: usize| self.stacks[axis].as_ref().expect("axes are needed together");
        if let Some(pieces) = &self.pieces {
            pieces.emit(view, crown, &viewer, (&self.cards, &self.stacks), mixed, builder);
        } else {
            let stacks: Vec<Mixed<'_>> = mixed.iter().map(|&(axis, a)| (stack(axis), a)).collect();
            let drawing = Drawing { drop_back: 0, pixel_size: 0.0 };
            push_stacks(view, crown, &viewer, (&self.cards, drawing), &stacks, builder);
        }
    }
}

impl Representation for OrthogonalSlices {
    fn bounds(&self) -> (DVec3, DVec3) {
        self.bounds
    }

    fn foot(&self) -> DVec3 {
        self.foot
    }

    fn origin(&self) -> DVec3 {
        self.origin
    }

    fn sways(&self) -> bool {
        self.treetop.is_some()
    }

    fn footprint(&self) -> Footprint {
        let mut total = self.solid.footprint();
        for crossing in self.crossings() {
            let stacks: Vec<&Stack> = crossing.stacks.iter().flatten().collect();
            total = stack::footprint(&stacks, &crossing.cards, total);
        }
        total
    }

    fn textures(&self) -> Vec<NamedTexture> {
        let named = self.crossings().zip(["", "treetop, "]).flat_map(|(crossing, which)| {
            let stacks = crossing.stacks.iter().zip(NAMES);
            stacks.filter_map(move |(stack, name)| {
                let name = format!("{which}axis {name}");
                Some(stack.as_ref()?.textures(&name).collect::<Vec<_>>())
            })
        });
        named.flatten().chain(self.solid.textures()).collect()
    }

    fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        let moved: Vec<(Crown, Crown)> =
            crowns.iter().map(|crown| self.moved(view, crown)).collect();
        let still: Vec<Crown> = moved.iter().map(|(crown, _)| crown.clone()).collect();
        self.solid.emit(view, &still, state, builder);
        for (crown, top) in &moved {
            self.emit_slices(view, crown, top, self.opacity, builder)?;
        }
        Ok(())
    }
}
