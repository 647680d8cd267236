//! Placed plants: what a view can see of them, in the order it must be painted.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use crate::draw_list::DrawList;
use crate::error::{LodError, check_limit};
use crate::lod::{Crown, ListBuilder, Representation};
use crate::raster::Outputs;
use crate::view::View;
use crate::view_state::ViewState;

/// Instances that one scene may hold.
pub const MAX_INSTANCE_COUNT: u64 = 1 << 28;

/// One picture to draw; a later pass may read what an earlier one made.
#[derive(Debug)]
pub struct Pass {
    /// From where.
    pub view: View,
    /// What.
    pub list: DrawList,
    /// Which planes it must leave behind.
    pub targets: Outputs,
}

/// A representation and where its copies stand.
#[derive(Debug, Clone)]
struct Group {
    representation: Arc<dyn Representation>,
    placements: Vec<DAffine3>,
}

/// Representations with their copies.
#[derive(Debug, Clone, Default)]
pub struct Scene {
    groups: Vec<Group>,
}

impl Scene {
    /// A plant where its file put it.
    ///
    /// # Errors
    /// As [`Scene::add`].
    pub fn single(representation: Arc<dyn Representation>) -> Result<Self, LodError> {
        let mut scene = Self::default();
        scene.add(representation, &[DAffine3::IDENTITY])?;
        Ok(scene)
    }

    /// Adds copies of a representation; a transform maps the plant's own world to the scene's.
    ///
    /// # Errors
    /// `transforms` that are not finite or flatten the plant, or too many of them.
    pub fn add(
        &mut self,
        representation: Arc<dyn Representation>,
        transforms: &[DAffine3],
    ) -> Result<(), LodError> {
        let count = self.instance_count() + transforms.len() as u64;
        check_limit("transforms", count, MAX_INSTANCE_COUNT, "instances")?;
        if let Some(index) = transforms.iter().position(|transform| !transform.is_finite()) {
            return Err(LodError::NotFinite { name: "transforms", index });
        }
        let flat = |transform: &DAffine3| {
            let inverse = transform.matrix3.determinant().recip();
            !inverse.is_finite()
        };
        if let Some(index) = transforms.iter().position(flat) {
            let why = format!("transform {index} has no inverse");
            return Err(LodError::Invalid { name: "transforms", why });
        }
        let to_world = DAffine3::from_translation(representation.origin());
        let placements = transforms.iter().map(|&transform| transform * to_world).collect();
        self.groups.push(Group { representation, placements });
        Ok(())
    }

    /// Copies of all representations.
    pub fn instance_count(&self) -> u64 {
        self.groups.iter().map(|group| group.placements.len() as u64).sum()
    }

    /// World box around every copy, or `None` without any.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let boxes = self.groups.iter().flat_map(|group| {
            let (low, high) = group.representation.bounds();
            group.placements.iter().map(move |placement| world_box(placement, low, high))
        });
        boxes.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }

    /// The passes that draw this scene from a view.
    ///
    /// # Errors
    /// If a representation was built for other views.
    pub fn plan(
        &self,
        view: &View,
        targets: Outputs,
        state: &mut ViewState,
    ) -> Result<Vec<Pass>, LodError> {
        let mut visible: Vec<(usize, Crown)> = Vec::new();
        for (number, group) in self.groups.iter().enumerate() {
            let (low, high) = group.representation.bounds();
            let (center, radius) = ((low + high) * 0.5, (high - low).length() * 0.5);
            for (index, placement) in group.placements.iter().enumerate() {
                let world_center = placement.transform_point3(center);
                if !view.sees_ball(world_center, radius * largest_scale(placement)) {
                    continue;
                }
                let distance = if view.is_orthographic() {
                    view.view_from_world(world_center).z
                } else {
                    world_center.distance(view.eye)
                };
                let key = (
                    u32::try_from(number).expect("few representations"),
                    u32::try_from(index).expect("checked when added"),
                );
                let crown = Crown { world_from_local: *placement, distance, rank: 0, key };
                visible.push((number, crown));
            }
        }
        // far to near; equal distances by representation and copy
        visible.sort_by(|(_, a), (_, b)| b.distance.total_cmp(&a.distance).then(a.key.cmp(&b.key)));
        let mut by_group: Vec<Vec<Crown>> = vec![Vec::new(); self.groups.len()];
        for (rank, (number, crown)) in (0_u32..).zip(visible) {
            by_group[number].push(Crown { rank, ..crown });
        }
        let mut builder = ListBuilder::default();
        for (group, crowns) in self.groups.iter().zip(&by_group) {
            group.representation.emit(view, crowns, state, &mut builder)?;
        }
        Ok(vec![Pass { view: view.clone(), list: builder.finish(), targets }])
    }
}

/// World box around the transformed corners of a local box.
fn world_box(placement: &DAffine3, low: DVec3, high: DVec3) -> (DVec3, DVec3) {
    let center = placement.transform_point3((low + high) * 0.5);
    let half = (high - low) * 0.5;
    let m = placement.matrix3;
    let reach = m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z;
    (center - reach, center + reach)
}

/// An upper bound on how much a transform stretches any length.
fn largest_scale(placement: &DAffine3) -> f64 {
    let m = placement.matrix3;
    (m.x_axis.length_squared() + m.y_axis.length_squared() + m.z_axis.length_squared()).sqrt()
}
