//! Leaves that collapse into larger leaves, and levels of detail that depend on the view.
//!
//! Built once: every leaf becomes a quad, quads collapse two by two until few are left, and what
//! collapsed into what is kept as a forest. Any level between is a list of its nodes: the same detail
//! everywhere, or finer where a criterion asks for it. The wood is simplified in levels of its own.
//!
//! This work is based on: I. Remolar, M. Chover, J. Ribelles, O. Belmonte. View-Dependent
//! Multiresolution Model for Foliage. Journal of WSCG 11(1), 2003; and its simplification on: I. Remolar,
//! M. Chover, O. Belmonte, J. Ribelles, C. Rebollo. Geometric Simplification of Foliage.
//! Eurographics 2002, short presentations.

pub mod active;
pub mod active_tree;
pub mod ball;
pub mod collapse;
pub mod cost;
mod coverage;
pub mod criteria;
pub mod cut;
pub mod depth_first;
mod drawing;
pub mod forest;
pub mod leaf_quads;
#[cfg(test)]
mod made;
pub mod naive;
pub mod new_leaf;
pub mod quad;
pub mod stored;
pub mod uniform;
pub mod walk;
pub mod zone;

use std::sync::Arc;

use glam::{DVec3, Vec3};

use crate::error::{LodError, check_in};
use crate::job::Job;
use crate::lod::foliage_hierarchy::active::Changes;
use crate::lod::foliage_hierarchy::collapse::{CollapseParams, Collapsed, collapse};
use crate::lod::foliage_hierarchy::coverage::keep_coverage;
use crate::lod::foliage_hierarchy::criteria::{Criterion, Placed};
use crate::lod::foliage_hierarchy::cut::{Cut, Rule, Steps, scratch};
use crate::lod::foliage_hierarchy::depth_first::DepthFirst;
use crate::lod::foliage_hierarchy::drawing::{NodeVertices, Quads};
use crate::lod::foliage_hierarchy::forest::Forest;
use crate::lod::foliage_hierarchy::leaf_quads::{LeafQuad, leaf_quads};
use crate::lod::foliage_hierarchy::uniform::uniform;
use crate::lod::foliage_hierarchy::zone::Zone;
use crate::lod::solid::ready_to_draw;
use crate::lod::wood::Wood;
use crate::lod::wood_levels::WoodLevels;
use crate::lod::{
    Crown, Footprint, ListBuilder, NamedTexture, Representation, foot_of, largest_scale,
};
use crate::plant::Plant;
use crate::texture::Filter;
use crate::view::View;
use crate::view_state::ViewState;

/// Which nodes are drawn.
#[derive(Debug, Clone)]
pub enum Selection {
    /// The same number of quads in every view.
    Level {
        /// Between the number of roots and that of leaves.
        leaf_count: usize,
    },
    /// The same detail in all of a crown: so many quads that the side of one of mean area, at the
    /// nearest point of the ball around the crown, is this long in the picture.
    Uniform {
        /// Pixels, above 0.
        quad_px: f64,
    },
    /// More of them where a criterion holds.
    Variable {
        /// What is drawn finer.
        criterion: Criterion,
        /// When a node is replaced by its children.
        rule: Rule,
    },
}

impl Drawing {
    fn check(&self) -> Result<(), LodError> {
        check_in("wood_error_px", self.wood_error_px, 0.0..=1e6)
    }
}

impl Selection {
    /// Whether its numbers are in range, as far as that can be told without a plant.
    ///
    /// # Errors
    /// [`LodError::OutOfRange`] and what [`Criterion::check`] returns.
    pub fn check(&self) -> Result<(), LodError> {
        match self {
            Self::Level { .. } => Ok(()),
            Self::Uniform { quad_px } => check_in("quad_px", *quad_px, 1e-3..=1e6),
            Self::Variable { criterion, .. } => criterion.check(),
        }
    }
}

/// What a hierarchy is built with.
#[derive(Debug, Clone)]
pub struct Params {
    /// How leaves collapse.
    pub collapse: CollapseParams,
    /// Whether nodes are scaled further, so that crowns at every level cover what all leaves cover.
    pub keep_coverage: bool,
    /// How it is drawn.
    pub drawing: Drawing,
}

/// How a hierarchy is drawn, whatever is selected.
#[derive(Debug, Clone)]
pub struct Drawing {
    /// How textures are read.
    pub filter: Filter,
    /// Which wood is drawn.
    pub wood: Wood,
    /// Whether the wood is simplified further with the foliage.
    pub has_wood_levels: bool,
    /// By how many pixels simplified wood may be off, where no fixed level is drawn.
    pub wood_error_px: f64,
}

/// What it took to collapse a plant's leaves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effort {
    /// Costs that were computed.
    pub cost_count: u64,
    /// Distance at which two parallel leaves cost 1, in metres.
    pub d_ref: f64,
}

/// A plant whose leaves collapse, and what of it is drawn.
#[derive(Debug, Clone)]
pub struct FoliageHierarchy {
    built: Arc<Built>,
    selection: Selection,
    /// Around whatever the selection may draw.
    bounds: (DVec3, DVec3),
    has_wood_levels: bool,
    wood_error_px: f64,
}

/// What all selections share.
#[derive(Debug)]
struct Built {
    /// Shared with criteria that ask the caller.
    forest: Arc<Forest>,
    order: DepthFirst,
    /// Area of all leaves, in square metres.
    area: f64,
    /// Around the quads of all leaves, relative to the plant's origin. Nodes made late reach far
    /// beyond them, but are seldom drawn.
    ball: (DVec3, f64),
    quads: Quads,
    wood: WoodLevels,
    /// Of the plant's own meshes, beyond which quads may reach.
    foot: DVec3,
    origin: DVec3,
}

impl Built {
    /// Box around the wood and every node that a selection may draw.
    fn bounds(&self, selection: &Selection) -> (DVec3, DVec3) {
        let node_count = match selection {
            Selection::Level { leaf_count } => 2 * self.forest.leaf_count as usize - leaf_count,
            Selection::Uniform { .. } | Selection::Variable { .. } => self.forest.nodes.len(),
        };
        let (low, high) = self.quads.bounds(node_count);
        self.wood.bounds().map_or((low, high), |(a, b)| (low.min(a), high.max(b)))
    }
}

/// What a camera remembers of a copy.
#[derive(Debug, Default)]
struct Memory {
    /// The geometry that the list belongs to.
    owner: Option<u64>,
    kept: Kept,
}

#[derive(Debug, Default)]
enum Kept {
    #[default]
    Nothing,
    /// The nodes of a level of one count.
    Uniform(Vec<u32>),
    /// The nodes of a first view: most pictures have no second one.
    Once(Vec<u32>),
    /// What it takes to follow the view.
    Followed(Box<Cut>),
}

impl FoliageHierarchy {
    /// Collapses a plant's leaves; all of them are drawn until something else is selected.
    ///
    /// # Errors
    /// [`LodError::Empty`] if the plant has no leaves; a parameter out of range; [`LodError::Limit`];
    /// [`LodError::Cancelled`].
    pub fn build(plant: &Plant, params: &Params, job: &Job) -> Result<(Self, Effort), LodError> {
        let drawing = &params.drawing;
        drawing.check()?;
        let quads = quads_of(plant, job)?;
        let corners: Vec<[Vec3; 4]> = quads.iter().map(|quad| quad.corners).collect();
        let areas: Vec<f64> = plant.foliage.areas.iter().map(|&area| f64::from(area)).collect();
        let Collapsed { mut forest, rule, cost_count } =
            collapse(&corners, &areas, &params.collapse, job)?;
        let vertices = vertices_of(plant, &forest, &quads, drawing.filter, job)?;
        drop(quads);
        if params.keep_coverage {
            keep_coverage(&mut forest, &vertices, plant, job)?;
        }
        let built = Self::new(plant, vertices, forest, drawing, job)?;
        Ok((built, Effort { cost_count, d_ref: rule.d_ref }))
    }

    /// Draws a plant with a forest that was made of it before.
    ///
    /// # Errors
    /// As [`FoliageHierarchy::build`]; [`LodError::Invalid`] if the forest is of other leaves.
    pub fn from_forest(
        plant: &Plant,
        forest: Forest,
        drawing: &Drawing,
        job: &Job,
    ) -> Result<Self, LodError> {
        drawing.check()?;
        let quads = quads_of(plant, job)?;
        let corners = quads.iter().flat_map(|quad| quad.corners);
        if !corners.eq(forest.positions.iter().copied()) {
            let why = "the hierarchy was made of other leaves than this plant's".to_owned();
            return Err(LodError::Invalid { name: "plant", why });
        }
        let vertices = vertices_of(plant, &forest, &quads, drawing.filter, job)?;
        Self::new(plant, vertices, forest, drawing, job)
    }

    fn new(
        plant: &Plant,
        vertices: NodeVertices,
        forest: Forest,
        drawing: &Drawing,
        job: &Job,
    ) -> Result<Self, LodError> {
        let max_level_count = if drawing.has_wood_levels { usize::MAX } else { 1 };
        let materials = &vertices.materials;
        let wood = WoodLevels::build(plant, drawing.wood, max_level_count, materials, job)?;
        let drawn = vertices.freeze(&forest, job)?;
        let leaf_count = forest.leaf_count as usize;
        let (low, high) = drawn.bounds(leaf_count);
        let middle = (low + high) * 0.5;
        let of_wood = wood.bounds().map(|(low, high)| (low.as_vec3(), high.as_vec3()));
        let boxes = plant.foliage.mesh.bounds().into_iter().chain(of_wood);
        let built = Built {
            order: DepthFirst::new(&forest),
            area: forest.roots().map(|root| forest.areas[root as usize]).sum(),
            forest: Arc::new(forest),
            ball: (middle, (high - low).length() * 0.5),
            quads: drawn,
            foot: foot_of(boxes),
            wood,
            origin: plant.origin,
        };
        let selection = Selection::Level { leaf_count };
        Ok(Self {
            bounds: built.bounds(&selection),
            built: Arc::new(built),
            selection,
            has_wood_levels: drawing.has_wood_levels,
            wood_error_px: drawing.wood_error_px,
        })
    }

    /// The same hierarchy with another selection.
    ///
    /// # Errors
    /// A number out of range.
    pub fn with_selection(&self, selection: Selection) -> Result<Self, LodError> {
        selection.check()?;
        if let Selection::Level { leaf_count } = selection {
            let forest = &self.built.forest;
            check_in("leaf_count", leaf_count, forest.root_count()..=forest.leaf_count as usize)?;
        }
        let bounds = self.built.bounds(&selection);
        Ok(Self { selection, bounds, ..self.clone() })
    }

    /// The forest.
    pub fn forest(&self) -> &Arc<Forest> {
        &self.built.forest
    }

    /// The forest in depth-first order.
    pub fn order(&self) -> &DepthFirst {
        &self.built.order
    }

    /// The wood's levels.
    pub fn wood(&self) -> &WoodLevels {
        &self.built.wood
    }

    /// Nodes that a view draws of a copy, and what it took to find them from the last view's.
    ///
    /// # Errors
    /// What a criterion of the caller's own returns.
    pub fn active(
        &self,
        view: &View,
        crown: &Crown,
        state: &mut ViewState,
    ) -> Result<(Vec<u32>, Steps), LodError> {
        let mut steps = Steps::default();
        let nodes = self.select(view, crown, state, &mut steps)?;
        Ok((nodes.to_vec(), steps))
    }

    fn select<'a>(
        &self,
        view: &View,
        crown: &Crown,
        state: &'a mut ViewState,
        steps: &mut Steps,
    ) -> Result<std::borrow::Cow<'a, [u32]>, LodError> {
        let Built { forest, order, .. } = &*self.built;
        match &self.selection {
            Selection::Level { leaf_count } => Ok(uniform(order, *leaf_count)?.into()),
            Selection::Uniform { quad_px } => {
                let leaf_count = self.uniform_count(view, crown, *quad_px);
                let memory = self.memory(crown, state);
                if !matches!(memory.kept, Kept::Uniform(_)) {
                    memory.kept = Kept::Uniform(uniform(order, leaf_count)?);
                }
                let Kept::Uniform(nodes) = &mut memory.kept else { unreachable!("just made") };
                uniform::step(order, nodes, leaf_count, &mut Changes::default())?;
                Ok((&nodes[..]).into())
            }
            Selection::Variable { criterion, rule } => {
                let placed = Placed { view, world_from_local: crown.world_from_local };
                let zone = Zone::new(criterion, forest, order, &placed)?;
                let memory = self.memory(crown, state);
                let mut cut = match std::mem::take(&mut memory.kept) {
                    Kept::Followed(cut) => cut,
                    Kept::Once(nodes) => {
                        let mut cut = Cut::new(forest, order);
                        cut.set_active(order, nodes).expect("a list of this forest");
                        Box::new(cut)
                    }
                    Kept::Nothing | Kept::Uniform(_) => {
                        let (nodes, found) = scratch(order, &zone, *rule);
                        *steps = found;
                        memory.kept = Kept::Once(nodes);
                        let Kept::Once(nodes) = &memory.kept else { unreachable!("just made") };
                        return Ok((&nodes[..]).into());
                    }
                };
                *steps = cut.update(forest, order, zone, *rule);
                memory.kept = Kept::Followed(cut);
                let Kept::Followed(cut) = &memory.kept else { unreachable!("just made") };
                Ok(cut.active().into())
            }
        }
    }

    /// What a camera remembers of a copy of this hierarchy.
    fn memory<'a>(&self, crown: &Crown, state: &'a mut ViewState) -> &'a mut Memory {
        let memory: &mut Memory = state.slot(crown.key);
        let owner = Some(self.built.quads.id());
        if memory.owner != owner {
            *memory = Memory { owner, kept: Kept::Nothing };
        }
        memory
    }

    /// How many quads of the mean area are as large as asked for.
    fn uniform_count(&self, view: &View, crown: &Crown, quad_px: f64) -> usize {
        let forest = &self.built.forest;
        let (fewest, most) = (forest.root_count(), forest.leaf_count as usize);
        let side = quad_px * pixel_size(view, crown, self.built.ball);
        if side <= 0.0 {
            return most;
        }
        let count = (self.built.area / (side * side)).ceil();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let count = count.min(most as f64) as usize;
        count.max(fewest)
    }
}

fn quads_of(plant: &Plant, job: &Job) -> Result<Vec<LeafQuad>, LodError> {
    if plant.foliage.leaf_count() == 0 {
        let why = "this technique needs leaves; choose them with foliage=";
        return Err(LodError::Empty { name: "foliage", why });
    }
    leaf_quads(plant, job)
}

fn vertices_of(
    plant: &Plant,
    forest: &Forest,
    quads: &[LeafQuad],
    filter: Filter,
    job: &Job,
) -> Result<NodeVertices, LodError> {
    let first_id = u32::try_from(plant.wood.triangles.len()).expect("checked by the plant");
    let triangle_counts = plant.foliage.leaf_offsets.windows(2).map(|pair| pair[1] - pair[0]);
    let materials = ready_to_draw(&plant.materials, filter, job)?;
    NodeVertices::new(forest, quads, triangle_counts, first_id, materials, job)
}

/// Metres of a copy's own space that a pixel shows at the nearest point of a ball; 0 with the eye in it.
fn pixel_size(view: &View, crown: &Crown, (center, radius): (DVec3, f64)) -> f64 {
    let scale = largest_scale(&crown.world_from_local);
    let distance = crown.world_from_local.transform_point3(center).distance(view.eye);
    let nearest = (distance - radius * scale).max(0.0);
    if scale > 0.0 { view.pixel_size_at(nearest) / scale } else { f64::INFINITY }
}

impl Representation for FoliageHierarchy {
    fn bounds(&self) -> (DVec3, DVec3) {
        self.bounds
    }

    fn foot(&self) -> DVec3 {
        self.built.foot
    }

    fn origin(&self) -> DVec3 {
        self.built.origin
    }

    fn footprint(&self) -> Footprint {
        let Built { forest, quads, wood, .. } = &*self.built;
        let wood = wood.footprint();
        let textures: u64 = self.textures().iter().map(|named| named.texture.byte_count()).sum();
        let own = forest.structure_bytes() + forest.side_bytes() + quads.byte_count();
        Footprint {
            triangle_count: wood.triangle_count + 2 * forest.nodes.len() as u64,
            geometry_bytes: wood.geometry_bytes + own,
            texture_bytes: textures,
            ..Footprint::default()
        }
    }

    fn textures(&self) -> Vec<NamedTexture> {
        let mut named = self.built.wood.textures();
        for leaf in self.built.quads.textures() {
            if !named.iter().any(|known| known.texture.id() == leaf.texture.id()) {
                named.push(leaf);
            }
        }
        named
    }

    fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        let Built { forest, quads, wood, .. } = &*self.built;
        let share = match self.selection {
            Selection::Level { leaf_count } => {
                Some(leaf_count as f64 / f64::from(forest.leaf_count))
            }
            _ => None,
        };
        let level_of = |crown: &Crown| match (self.has_wood_levels, share) {
            (false, _) => 0,
            (true, Some(share)) => wood.pick_share(share),
            (true, None) => wood.pick(view, crown, self.wood_error_px),
        };
        wood.emit_each(view, crowns, level_of, state, builder);
        // near copies first, so that they hide what lies behind them
        for crown in crowns.iter().rev() {
            let nodes = self.select(view, crown, state, &mut Steps::default())?;
            quads.emit(forest, &nodes, view, crown, builder);
        }
        Ok(())
    }
}
