//! Layered billboards: a plant as flat layers seen from one side, hung one from the other.
//!
//! Every layer shows what grows on some limbs, or what lies in a slab, flattened along the direction
//! that the plant is seen from. It hangs from its parent at an anchor, about which the wind turns it and
//! all that grows from it. Layers are painted far to near. The picture holds for viewers who stay on
//! that side and move across it; layers may also turn towards the viewer, on wood that stays a mesh.
//!
//! This work is based on:
//! Daniel Sanchez-Crespo Dalmau. Core Techniques and Algorithms in Game Programming. 2003 (chapter 20,
//! "parallel IBR")
//!
//! Deviations: layers are found and not drawn by hand; each leans with what it shows.

mod cards;
mod content;
mod depth;
mod frame;
mod groups;
#[cfg(test)]
mod motion_tests;
mod pose;
mod slabs;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use crate::draw_list::{Blend, Item, Primitive, Surface};
use crate::error::{LodError, check_in};
use crate::job::Job;
use crate::lod::leaves::{Leaves, Placed};
use crate::lod::solid::Solid;
use crate::lod::wood::Wood;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture, Representation, foot_of};
use crate::plant::limbs::Limbs;
use crate::plant::{Mesh, Plant};
use crate::raster::samples;
use crate::texture::texture::check_size;
use crate::texture::{Filter, Format, Sampler, Wrap};
use crate::view::View;
use crate::view_state::ViewState;
use cards::{Baker, Cards, Plan};
use content::Content;
use depth::Depth;
use frame::{Frame, Grid};
pub use pose::Motion;
use pose::{Joint, facing, in_wind, swing, turned};
use slabs::Slabs;

/// More layers than this are taken for a mistake.
const MAX_LAYER_COUNT: usize = 4096;

/// Alpha from which a tested layer is there.
const CUTOFF: f32 = 0.5;

/// An eye this share of the plant's radius from an anchor sees the layer along its own direction.
const AT_ANCHOR: f64 = 1e-9;

/// Share of a swing by which the slab nearest to the viewer is ahead of the farthest.
const SLAB_LAG: f64 = 0.25;

/// What layers are made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grouping {
    /// Limbs, where there are at least two; else slabs.
    Auto,
    /// Limbs.
    Branches,
    /// Slabs across the direction.
    Slabs,
}

/// Where the wood is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WoodAs {
    /// In the layers.
    Baked,
    /// Beside them.
    Mesh,
}

/// Which way layers face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Turn {
    /// As they were baked.
    Fixed,
    /// To the viewer, in yaw and in pitch, each by at most so many radians.
    Viewer {
        /// In [0, pi].
        max_turn: f64,
    },
}

/// How layers join the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drawing {
    /// Blended, far to near.
    Blend,
    /// Tested against one half, in any order.
    Test,
}

/// How layers are built.
#[derive(Debug, Clone)]
pub struct Params {
    /// From the plant to the viewer, any length.
    pub direction: DVec3,
    /// What a layer is made of.
    pub grouping: Grouping,
    /// Layers at most.
    pub layer_count: usize,
    /// Whether a layer of limbs leans towards or away from the viewer with what it shows, through its
    /// anchor; layers that turn do not.
    pub tilt: bool,
    /// Which way layers face.
    pub turn: Turn,
    /// What the wind does to a layer.
    pub motion: Motion,
    /// How much farther a layer swings than its parent.
    pub growth: f64,
    /// How layers join the picture.
    pub drawing: Drawing,
    /// Texels along the longer side of the picture of the whole plant.
    pub resolution: u32,
    /// Samples a texel.
    pub sample_count: u32,
    /// Texel format.
    pub format: Format,
    /// Which wood is drawn.
    pub wood: Wood,
    /// And how.
    pub wood_as: WoodAs,
    /// The cameras that will look, in the plant's own world; `None` bakes for all.
    pub views: Option<Vec<View>>,
}

/// A layer, for looking at.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Its place in the hierarchy.
    pub name: String,
    /// Index of the layer that it hangs from.
    pub parent: Option<usize>,
    /// Where it hangs, relative to the plant's origin.
    pub anchor: DVec3,
    /// Its corners at rest, from the lower left as seen, relative to the plant's origin, unless it shows
    /// nothing.
    pub corners: Option<[DVec3; 4]>,
    /// Upper left texel in the texture, width and height.
    pub texels: Option<[u32; 4]>,
    /// Leaves that it shows, or whose centres it shows where leaves are cut.
    pub leaf_count: usize,
    /// Triangles of the wood that is drawn which go with it, baked or as a mesh.
    pub wood_triangle_count: usize,
}

/// The technique's representation of a plant.
#[derive(Debug, Clone)]
pub struct LayeredBillboards {
    layers: Vec<Layer>,
    joints: Vec<Joint>,
    /// Far to near as baked.
    cards: Cards,
    solid: Solid,
    /// The same wood by layer.
    limbs: Vec<(usize, Solid)>,
    frame: Frame,
    radius: f64,
    bounds: (DVec3, DVec3),
    foot: DVec3,
    reach: f64,
    origin: DVec3,
    turn: Turn,
    motion: Motion,
    growth: f64,
    drawing: Drawing,
}

fn check(params: &Params) -> Result<(), LodError> {
    check_in("layer_count", params.layer_count, 1..=MAX_LAYER_COUNT)?;
    check_size("resolution", params.resolution, params.resolution)?;
    check_in("growth", params.growth, 0.0..=10.0)?;
    samples::positions(params.sample_count)?;
    if let Turn::Viewer { max_turn } = params.turn {
        check_in("max_turn_deg", max_turn.to_degrees(), 0.0..=180.0)?;
        if params.wood_as == WoodAs::Baked && params.wood != Wood::None {
            let why = "layers that turn leave the wood where it is: it must be a mesh".to_owned();
            return Err(LodError::Invalid { name: "wood_as", why });
        }
    }
    if params.wood_as == WoodAs::Baked && matches!(params.wood, Wood::Simplified(_)) {
        let why = "only a mesh is simplified: see wood_as".to_owned();
        return Err(LodError::Invalid { name: "wood_triangle_count", why });
    }
    Ok(())
}

/// What layers are, before they are baked.
struct Hierarchy {
    layers: Vec<Layer>,
    joints: Vec<Joint>,
    plans: Vec<Plan>,
    /// Layer of each triangle of the plant's wood; all of it goes with one layer in slabs.
    wood_layers: Vec<usize>,
    /// Whether pieces are cut at borders that slabs share.
    is_cut: bool,
}

impl LayeredBillboards {
    /// Groups a plant's limbs, or cuts it into slabs, and bakes a layer for each.
    ///
    /// # Errors
    /// `foliage` without leaves, where there is no wood to bake either; `layer_count`, `resolution`,
    /// `samples`, `direction`, `growth`, `max_turn_deg` or `views` out of range; `groups` that the plant
    /// has not; wood that is to be baked and cannot be; [`LodError::Cancelled`].
    pub fn build(plant: &Plant, params: &Params, job: &Job) -> Result<Self, LodError> {
        check(params)?;
        let frame = Frame::new(params.direction)?;
        let limbs = match params.grouping {
            Grouping::Slabs => None,
            Grouping::Auto => Limbs::of(plant, job)?,
            Grouping::Branches => match Limbs::of(plant, job)? {
                Some(limbs) => Some(limbs),
                None => {
                    let why = "the plant's wood has no branches to tell apart; use 'slabs'";
                    return Err(LodError::Invalid { name: "groups", why: why.to_owned() });
                }
            },
        };
        let wood = params.wood.of(plant)?;
        let content = Content::new(plant, &wood, params.wood_as, job)?;
        let leaves = Leaves::new(&content.plant)?;
        let hierarchy = match &limbs {
            Some(limbs) => by_limbs(limbs, &content, &leaves, &frame, params, job)?,
            None => by_slabs(plant, &content, &leaves, &frame, params),
        };
        let Hierarchy { mut layers, joints, plans, wood_layers, is_cut } = hierarchy;
        let most_per_metre = needed_per_metre(&leaves, params)?;
        let grid = Grid::new(
            frame,
            leaves.center,
            // depths of all layers count from one plane, so that slabs share their borders
            leaves.radius.max(content::least_side(&leaves)) * 4.0,
            content::seen_box(&leaves, &frame),
            params.resolution,
            most_per_metre,
        );
        let first_id = u32::try_from(plant.wood.triangles.len()).expect("checked by the plant");
        let baker = Baker { leaves: &leaves, grid: &grid, params, first_id, is_cut, job };
        let cards = baker.bake(&plans)?;
        for card in cards.all() {
            layers[card.layer].corners = Some(card.corners);
            layers[card.layer].texels = Some(card.texels);
        }
        let mesh = match params.wood_as {
            WoodAs::Mesh => content::by_layer(&wood, &plant.wood, &wood_layers, layers.len()),
            WoodAs::Baked => content::ByLayer::default(),
        };
        for (layer, count) in layers.iter_mut().zip(mesh.counts()) {
            layer.wood_triangle_count = count;
        }
        let solid = Solid::new(&[(&mesh.mesh, mesh.ids)], &plant.materials, Filter::Bilinear, job)?;
        let pieces = solid.cut(&mesh.ends);
        let pieces = pieces.into_iter().enumerate().filter(|(_, piece)| !piece.is_empty());
        let mut built = Self {
            layers,
            joints,
            cards,
            limbs: pieces.collect(),
            solid,
            frame,
            radius: leaves.radius,
            bounds: (DVec3::ZERO, DVec3::ZERO),
            foot: foot_of([&plant.foliage.mesh, &wood].into_iter().filter_map(Mesh::bounds)),
            reach: 0.0,
            origin: plant.origin,
            turn: params.turn,
            motion: params.motion,
            growth: params.growth,
            drawing: params.drawing,
        };
        built.measure(plant, &wood);
        Ok(built)
    }

    /// The layers, a parent before its children.
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// Share of the texture that layers cover.
    pub fn fill(&self) -> f64 {
        self.cards.fill
    }

    /// Where each layer goes in a copy, relative to its rest, in the plant's space.
    pub fn poses(&self, view: &View, crown: &Crown) -> Vec<DAffine3> {
        let still = || vec![DAffine3::IDENTITY; self.joints.len()];
        let poses = self.moved(view, crown).unwrap_or_else(still);
        self.turned(view, crown, poses)
    }

    fn moved(&self, view: &View, crown: &Crown) -> Option<Vec<DAffine3>> {
        in_wind(&self.joints, &self.frame, self.motion, self.growth, crown, view)
    }

    fn turned(&self, view: &View, crown: &Crown, poses: Vec<DAffine3>) -> Vec<DAffine3> {
        let Turn::Viewer { max_turn } = self.turn else { return poses };
        let back = crown.local_direction(view.back);
        let eye = (!view.is_orthographic()).then(|| crown.local_eye(view));
        let turn = |(pose, joint): (DAffine3, &Joint)| {
            let anchor = pose.transform_point3(joint.anchor);
            let toward = eye.map(|eye| eye - anchor);
            let toward = toward.filter(|to| to.length() > AT_ANCHOR * self.radius);
            let turn = facing(&self.frame, toward.unwrap_or(back), max_turn);
            turned(&pose, joint.anchor, turn)
        };
        poses.into_iter().zip(&self.joints).map(turn).collect()
    }

    /// Finds the box around everything it may draw at rest, and how far the wind may move that.
    fn measure(&mut self, plant: &Plant, wood: &Mesh) {
        let mut low = DVec3::INFINITY;
        let mut high = DVec3::NEG_INFINITY;
        let mut add = |point: DVec3| {
            low = low.min(point);
            high = high.max(point);
        };
        for mesh in [&plant.foliage.mesh, wood] {
            let bounds = mesh.bounds().map(|(low, high)| [low, high]);
            bounds.into_iter().flatten().for_each(|corner| add(corner.as_dvec3()));
        }
        for card in self.cards.all() {
            for corner in card.corners {
                add(corner);
                if self.turn != Turn::Fixed {
                    let anchor = self.joints[card.layer].anchor;
                    let radius = corner.distance(anchor);
                    add(anchor - radius);
                    add(anchor + radius);
                }
            }
        }
        self.bounds = (low, high);
        // a lean moves what hangs from a joint by its distance from there, at most
        let mut reaches: Vec<f64> = Vec::with_capacity(self.joints.len());
        for joint in &self.joints {
            let scale = swing(self.growth, joint.level);
            let farthest = (joint.anchor - low).abs().max((high - joint.anchor).abs()).length();
            reaches.push(joint.parent.map_or(0.0, |parent| reaches[parent]) + scale * farthest);
        }
        self.reach = reaches.into_iter().fold(0.0, f64::max);
    }

    fn emit_wood(
        &self,
        view: &View,
        crowns: &[Crown],
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) {
        if crowns.iter().all(|crown| crown.wind.is_none()) {
            self.solid.emit(view, crowns, state, builder);
            return;
        }
        for crown in crowns {
            let Some(poses) = self.moved(view, crown) else {
                self.solid.emit(view, std::slice::from_ref(crown), state, builder);
                continue;
            };
            for (layer, piece) in &self.limbs {
                let placed = posed(crown, &poses[*layer]);
                piece.emit(view, std::slice::from_ref(&placed), state, builder);
            }
        }
    }

    /// Cards far to near.
    fn order(&self, view: &View, crown: &Crown, poses: &[DAffine3]) -> Vec<usize> {
        let eye = (!view.is_orthographic()).then(|| crown.local_eye(view));
        let back = crown.local_direction(view.back);
        let toward = self.frame.toward;
        let distance = |card: &cards::Card| match (self.turn, eye) {
            // no ray meets parallel layers on both sides of the eye
            (Turn::Fixed, Some(eye)) => (eye.dot(toward) - card.depth).abs(),
            (Turn::Fixed, None) if back.dot(toward) < 0.0 => card.depth,
            (Turn::Fixed, None) => -card.depth,
            (Turn::Viewer { .. }, _) => {
                let center = poses[card.layer].transform_point3(card.center());
                eye.map_or(-center.dot(back), |eye| center.distance_squared(eye))
            }
        };
        let distances: Vec<f64> = self.cards.all().iter().map(distance).collect();
        let mut order: Vec<usize> = (0..distances.len()).collect();
        order.sort_by(|&a, &b| distances[b].total_cmp(&distances[a]).then(a.cmp(&b)));
        order
    }

    fn emit_cards(&self, view: &View, crown: &Crown, builder: &mut ListBuilder) {
        let moved = self.moved(view, crown);
        let is_still = moved.is_none() && self.turn == Turn::Fixed;
        let poses = moved.unwrap_or_else(|| vec![DAffine3::IDENTITY; self.joints.len()]);
        let poses = self.turned(view, crown, poses);
        let source = builder.list.geometry(self.cards.geometry());
        let texture = builder.list.texture(self.cards.texture());
        let sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: Filter::Trilinear };
        let mut push = |first: usize, count: usize, placed: &Crown| {
            let instances = builder.list.instance(placed.instance(view));
            let number = |at: usize| u32::try_from(at).expect("few layers");
            let item = Item {
                primitive: Primitive::Cards,
                vertices: source,
                indices: source,
                primitives: number(first)..number(first + count),
                instances,
                surface: Surface::Textured { texture, sampler },
                blend: match self.drawing {
                    Drawing::Blend => Blend::Over,
                    Drawing::Test => Blend::Test(CUTOFF),
                },
                depth_write: self.drawing == Drawing::Test,
                slab: None,
            };
            match self.drawing {
                Drawing::Blend => builder.push_blended(crown, item),
                Drawing::Test => builder.list.items.push(item),
            }
        };
        let order = self.order(view, crown, &poses);
        if is_still && order.is_sorted() {
            push(0, order.len(), crown);
            return;
        }
        for number in order {
            let layer = self.cards.all()[number].layer;
            push(number, 1, &posed(crown, &poses[layer]));
        }
    }
}

/// A copy moved in its own space.
fn posed(crown: &Crown, pose: &DAffine3) -> Crown {
    Crown { world_from_local: crown.world_from_local * *pose, ..crown.clone() }
}

/// Layers of limbs.
fn by_limbs(
    limbs: &Limbs,
    content: &Content,
    leaves: &Leaves<'_>,
    frame: &Frame,
    params: &Params,
    job: &Job,
) -> Result<Hierarchy, LodError> {
    let element_limbs = content.element_limbs(limbs);
    let mut moments = vec![groups::Moment::default(); limbs.parents.len()];
    for (&limb, (&center, &area)) in
        element_limbs.iter().zip(leaves.leaf_centers.iter().zip(content.areas()))
    {
        moments[limb as usize].add(groups::Moment::new(f64::from(area), center + leaves.center));
    }
    let (groups, group_of) = groups::groups(limbs, &moments, params.layer_count, job)?;
    let mut plans: Vec<Plan> = (0..groups.len()).map(Plan::new).collect();
    let mut sums = vec![groups::Moment::default(); groups.len()];
    for (element, &limb) in element_limbs.iter().enumerate() {
        let group = group_of[limb as usize];
        plans[group].add(element);
        let area = f64::from(content.areas()[element]);
        sums[group].add(groups::Moment::new(area, leaves.leaf_centers[element]));
    }
    for (plan, sum) in plans.iter_mut().zip(&sums) {
        // without any area, the first element decides
        let first = plan.first().map_or(DVec3::ZERO, |element| leaves.leaf_centers[element]);
        let mean = sum.mean_or(first).dot(frame.toward);
        // layers that turn face the viewer with their whole width
        plan.depth = if params.tilt && params.turn == Turn::Fixed {
            let weighed = |placed: &Placed| {
                (leaves.leaf_centers[placed.leaf], f64::from(content.areas()[placed.leaf]))
            };
            let anchor = groups[plan.layer].anchor - leaves.center;
            Depth::through(anchor, mean, plan.placed.iter().map(weighed), frame)
        } else {
            Depth::flat(mean)
        };
    }
    let wood_layers: Vec<usize> =
        limbs.wood_limbs.iter().map(|&limb| group_of[limb as usize]).collect();
    let mut leaf_counts = vec![0; groups.len()];
    limbs.leaf_limbs.iter().for_each(|&limb| leaf_counts[group_of[limb as usize]] += 1);
    let mut wood_counts = vec![0; groups.len()];
    let baked_wood = &element_limbs[..content.wood_count()];
    baked_wood.iter().for_each(|&limb| wood_counts[group_of[limb as usize]] += 1);
    let layer = |(number, group): (usize, &groups::Group)| Layer {
        name: group.name.clone(),
        parent: group.parent,
        anchor: group.anchor,
        corners: None,
        texels: None,
        leaf_count: leaf_counts[number],
        wood_triangle_count: wood_counts[number],
    };
    let joint = |group: &groups::Group| Joint {
        parent: group.parent,
        anchor: group.anchor,
        level: group.level,
        lag: 0.0,
    };
    Ok(Hierarchy {
        layers: groups.iter().enumerate().map(layer).collect(),
        joints: groups.iter().map(joint).collect(),
        plans,
        wood_layers,
        is_cut: false,
    })
}

/// Layers of slabs, each of which stands on the ground.
fn by_slabs(
    plant: &Plant,
    content: &Content,
    leaves: &Leaves<'_>,
    frame: &Frame,
    params: &Params,
) -> Hierarchy {
    let slabs = Slabs::new(leaves, frame.toward, params.layer_count);
    let foot = foot_of([&plant.foliage.mesh, &plant.wood].into_iter().filter_map(Mesh::bounds));
    let mut leaf_counts = vec![0; slabs.count()];
    for center in &leaves.leaf_centers[content.wood_count()..] {
        leaf_counts[slabs.holding(center.dot(frame.toward))] += 1;
    }
    let assigned = slabs.assign(leaves, frame.toward);
    let mut wood_counts = vec![0; slabs.count()];
    for center in &leaves.leaf_centers[..content.wood_count()] {
        wood_counts[slabs.holding(center.dot(frame.toward))] += 1;
    }
    let layer = |number: usize| Layer {
        name: format!("slab/{number}"),
        parent: None,
        anchor: foot,
        corners: None,
        texels: None,
        leaf_count: leaf_counts[number],
        wood_triangle_count: wood_counts[number],
    };
    let last = (slabs.count() - 1).max(1) as f64;
    let joint = |number: usize| Joint {
        parent: None,
        anchor: foot,
        level: 0,
        // a swing passes through the plant, so that neighbours hardly part
        lag: SLAB_LAG * (1.0 - number as f64 / last),
    };
    let plans = assigned.into_iter().enumerate().map(|(number, placed)| Plan {
        layer: number,
        placed,
        depth: Depth::flat(slabs.offset(number)),
        ends: slabs.ends(number),
    });
    Hierarchy {
        layers: (0..slabs.count()).map(layer).collect(),
        joints: (0..slabs.count()).map(joint).collect(),
        plans: plans.collect(),
        wood_layers: vec![slabs.count() / 2; plant.wood.triangles.len()],
        is_cut: true,
    }
}

/// Texels a metre that the nearest of the views can tell apart.
fn needed_per_metre(leaves: &Leaves<'_>, params: &Params) -> Result<f64, LodError> {
    let Some(views) = &params.views else { return Ok(f64::INFINITY) };
    if views.is_empty() {
        let why = "give at least one camera, or None for all";
        return Err(LodError::Empty { name: "views", why });
    }
    let center = leaves.center + leaves.plant.origin;
    let per_metre = views.iter().map(|view| {
        let from_eye =
            if view.is_orthographic() { 0.0 } else { center.distance(view.eye) - leaves.radius };
        1.0 / view.pixel_size_at(from_eye.max(view.near))
    });
    Ok(per_metre.fold(0.0, f64::max))
}

impl Representation for LayeredBillboards {
    fn bounds(&self) -> (DVec3, DVec3) {
        self.bounds
    }

    fn foot(&self) -> DVec3 {
        self.foot
    }

    fn sways(&self) -> bool {
        true
    }

    fn sway_reach(&self) -> f64 {
        self.reach
    }

    fn origin(&self) -> DVec3 {
        self.origin
    }

    fn footprint(&self) -> Footprint {
        let solid = self.solid.footprint();
        Footprint {
            card_count: self.cards.all().len() as u64,
            geometry_bytes: solid.geometry_bytes
                + self.cards.geometry().buffers().byte_count()
                + size_of_val(&self.joints[..]) as u64,
            texture_bytes: solid.texture_bytes + self.cards.texture().byte_count(),
            ..solid
        }
    }

    fn textures(&self) -> Vec<NamedTexture> {
        let texture = Arc::clone(self.cards.texture());
        let own = NamedTexture { name: "layers".to_owned(), texture, rect: None };
        std::iter::once(own).chain(self.solid.textures()).collect()
    }

    fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        self.emit_wood(view, crowns, state, builder);
        for crown in crowns {
            self.emit_cards(view, crown, builder);
        }
        Ok(())
    }
}
