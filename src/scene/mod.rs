//! Placed plants: what a view can see of them, in the order it must be painted.

pub mod variety;

use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec3};

use crate::draw_list::DrawList;
use crate::error::{LodError, check_limit};
use crate::lod::wind::{Gust, Wind};
use crate::lod::{Crown, ListBuilder, Representation, largest_scale};
use crate::raster::Outputs;
use crate::scene::variety::Variety;
use crate::view::{MAX_COORDINATE, View};
use crate::view_state::{Key, ViewState};

/// Instances that one scene may hold.
pub const MAX_INSTANCE_COUNT: u64 = 1 << 28;

/// Axes that span less than this share of the volume of a box of their lengths lie in one plane.
const FLAT: f64 = 1e-12;

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
    wind: Option<Wind>,
    variety: Option<Variety>,
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
        if let Some(index) = transforms.iter().position(is_too_large) {
            let why = format!("transform {index} reaches beyond {MAX_COORDINATE:e} m");
            return Err(LodError::Invalid { name: "transforms", why });
        }
        if let Some(index) = transforms.iter().position(is_flat) {
            let why = format!("transform {index} flattens the plant");
            return Err(LodError::Invalid { name: "transforms", why });
        }
        let to_world = DAffine3::from_translation(representation.origin());
        let placements = transforms.iter().map(|&transform| transform * to_world).collect();
        self.groups.push(Group { representation, placements });
        Ok(())
    }

    /// The same scene in a wind, which moves with the time of each view.
    ///
    /// # Errors
    /// As [`Wind::check`].
    pub fn in_wind(self, wind: Wind) -> Result<Self, LodError> {
        wind.check()?;
        Ok(Self { wind: Some(wind), ..self })
    }

    /// The same scene with copies that differ from one another.
    ///
    /// # Errors
    /// As [`Variety::check`].
    pub fn varied(self, variety: Variety) -> Result<Self, LodError> {
        variety.check()?;
        Ok(Self { variety: Some(variety), ..self })
    }

    /// Where a copy stands, with its own size and side, and the tint of its colours.
    fn copy(&self, group: &Group, foot: DVec3, key: Key) -> (DAffine3, Vec3) {
        let placement = group.placements[key.1 as usize];
        self.variety.map_or((placement, Vec3::ONE), |variety| {
            let variant = variety.of(key);
            (placement * variant.placed(foot), variety.tint(&variant))
        })
    }

    /// Copies of all representations.
    pub fn instance_count(&self) -> u64 {
        self.groups.iter().map(|group| group.placements.len() as u64).sum()
    }

    /// World box around every copy, wherever the wind may move it, or `None` without any.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let boxes = (0..).zip(&self.groups).flat_map(|(number, group)| {
            let (mut low, mut high) = group.representation.bounds();
            let foot = group.representation.foot();
            if let Some(wind) = self.wind {
                let far = wind.reach() * group.representation.sway_reach();
                // a shear is level
                let upwards = if group.representation.sways() { far } else { 0.0 };
                low -= DVec3::new(far, upwards, far);
                high += DVec3::new(far, upwards, far);
            }
            let copies = (0..).zip(&group.placements);
            copies.map(move |(index, _)| {
                world_box(&self.copy(group, foot, (number, index)).0, low, high)
            })
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
            let margin_px = group.representation.margin_px();
            let (foot, sways) = (group.representation.foot(), group.representation.sways());
            for index in 0..group.placements.len() {
                let key = (
                    u32::try_from(number).expect("few representations"),
                    u32::try_from(index).expect("checked when added"),
                );
                let wind = self.wind.map(|wind| Gust { wind, time_secs: view.time_secs, key });
                let (mut placement, tint) = self.copy(group, foot, key);
                let mut radius = radius;
                match wind {
                    Some(gust) if sways => {
                        radius += gust.wind.reach() * group.representation.sway_reach();
                    }
                    Some(gust) => placement = placement * gust.shear(view, &placement, foot),
                    None => {}
                }
                let world_center = placement.transform_point3(center);
                let world_radius = radius * largest_scale(&placement);
                let farthest = view.view_from_world(world_center).z + world_radius;
                let margin = margin_px * view.pixel_size_at(farthest.max(view.near));
                if !view.sees_ball(world_center, world_radius + margin) {
                    continue;
                }
                let distance = if view.is_orthographic() {
                    view.view_from_world(world_center).z
                } else {
                    world_center.distance(view.eye)
                };
                let wind = wind.filter(|_| sways);
                visible
                    .push((number, Crown { distance, key, tint, wind, ..Crown::alone(placement) }));
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

fn is_too_large(transform: &DAffine3) -> bool {
    let rows = [transform.matrix3.x_axis, transform.matrix3.y_axis, transform.matrix3.z_axis];
    rows.iter().chain([&transform.translation]).any(|v| v.abs().max_element() > MAX_COORDINATE)
}

/// Whether a transform has no inverse: axes too short to be an f32, or in one plane but for rounding.
fn is_flat(transform: &DAffine3) -> bool {
    let m = transform.matrix3;
    let lengths = [m.x_axis, m.y_axis, m.z_axis].map(DVec3::length);
    let volume = m.determinant().abs();
    lengths.iter().any(|&length| length < 1.0 / MAX_COORDINATE)
        || volume <= FLAT * lengths.iter().product::<f64>()
}

/// World box around the transformed corners of a local box.
fn world_box(placement: &DAffine3, low: DVec3, high: DVec3) -> (DVec3, DVec3) {
    let center = placement.transform_point3((low + high) * 0.5);
    let half = (high - low) * 0.5;
    let m = placement.matrix3;
    let reach = m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z;
    (center - reach, center + reach)
}

#[cfg(test)]
mod tests {
    use glam::DMat3;

    use super::*;
    use crate::draw_list::{Blend, Item, Primitive, Source, Surface};
    use crate::lod::{Footprint, NamedTexture};
    use crate::view::Projection;

    /// A ball's box of radius 1 that emits one blended item a copy.
    #[derive(Debug)]
    struct Probe {
        origin: DVec3,
    }

    impl Representation for Probe {
        fn bounds(&self) -> (DVec3, DVec3) {
            (DVec3::splat(-1.0), DVec3::ONE)
        }

        fn origin(&self) -> DVec3 {
            self.origin
        }

        fn footprint(&self) -> Footprint {
            Footprint::default()
        }

        fn textures(&self) -> Vec<NamedTexture> {
            Vec::new()
        }

        fn emit(
            &self,
            view: &View,
            crowns: &[Crown],
            _state: &mut ViewState,
            builder: &mut ListBuilder,
        ) -> Result<(), LodError> {
            for crown in crowns {
                let instances = builder.list.instance(crown.instance(view));
                let item = Item {
                    primitive: Primitive::Triangles,
                    vertices: Source::Own,
                    indices: Source::Own,
                    primitives: 0..0,
                    instances,
                    surface: Surface::VertexColor,
                    blend: Blend::Over,
                    depth_write: false,
                    slab: None,
                };
                builder.push_blended(crown, item);
            }
            Ok(())
        }
    }

    fn probe(origin: DVec3) -> Arc<dyn Representation> {
        Arc::new(Probe { origin })
    }

    fn view(projection: Projection) -> View {
        View::new(DVec3::Z * 10.0, DVec3::ZERO, DVec3::Y, projection, (8, 8), 0.1).expect("valid")
    }

    fn perspective() -> View {
        view(Projection::Perspective { fov_y: std::f64::consts::FRAC_PI_2 })
    }

    /// Depths of the copies that are drawn, in paint order.
    fn depths(scene: &Scene, view: &View) -> Vec<f32> {
        let passes = scene.plan(view, Outputs::COLOR, &mut ViewState::default()).expect("valid");
        let [pass] = &passes[..] else { panic!("one pass, got {}", passes.len()) };
        assert_eq!((&pass.view, pass.targets), (view, Outputs::COLOR), "as asked for");
        let of = |item: &Item| -pass.list.instances[item.instances.start as usize].translation.z;
        pass.list.items.iter().map(of).collect()
    }

    fn at(x: f64, y: f64, z: f64) -> DAffine3 {
        DAffine3::from_translation(DVec3::new(x, y, z))
    }

    #[test]
    fn copies_of_all_groups_are_painted_far_to_near() {
        let mut scene = Scene::default();
        scene.add(probe(DVec3::ZERO), &[at(0.0, 0.0, 4.0), at(0.0, 0.0, -20.0)]).expect("valid");
        scene.add(probe(DVec3::ZERO), &[at(0.0, 0.0, 0.0), at(0.0, 0.0, -8.0)]).expect("valid");
        assert_eq!(scene.instance_count(), 4, "two and two");
        let parallel = view(Projection::Orthographic { height: 9.0 });
        for view in [perspective(), parallel] {
            assert_eq!(depths(&scene, &view), [30.0, 18.0, 10.0, 6.0], "groups interleave");
        }
        // nearer along the view, farther from the eye
        let mut scene = Scene::default();
        scene.add(probe(DVec3::ZERO), &[at(7.0, 0.0, 0.0), at(0.0, 0.0, -1.0)]).expect("valid");
        assert_eq!(depths(&scene, &perspective()), [10.0, 11.0], "by distance from the eye");
        let wide = view(Projection::Orthographic { height: 40.0 });
        assert_eq!(depths(&scene, &wide), [11.0, 10.0], "in parallel by depth");
    }

    #[test]
    fn what_no_camera_sees_is_not_emitted() {
        // the ball around the box has radius sqrt(3); at depth 10 the view reaches 10 m up
        let seen = |transform: DAffine3| {
            let mut scene = Scene::default();
            scene.add(probe(DVec3::ZERO), &[transform]).expect("valid");
            depths(&scene, &perspective()).len() == 1
        };
        assert!(seen(at(0.0, 12.4, 0.0)), "the ball touches: 12.4 < 10 + sqrt(3) sqrt(2)");
        assert!(!seen(at(0.0, 12.5, 0.0)), "above");
        assert!(!seen(at(0.0, 0.0, 12.0)), "behind the eye");
        assert!(seen(at(0.0, 0.0, 11.0)), "around the eye");
        let grown = DAffine3::from_scale_rotation_translation(
            DVec3::splat(4.0),
            glam::DQuat::IDENTITY,
            DVec3::Y * 16.0,
        );
        assert!(seen(grown), "four times as large");
        let slanted = DAffine3 {
            matrix3: DMat3::from_cols(DVec3::X, DVec3::new(3.0, 1.0, 0.0), DVec3::Z),
            translation: DVec3::X * 13.5,
        };
        assert!(seen(slanted), "sheared by 3: its left end is at x = 9.5");
        let stretched = DAffine3 {
            matrix3: DMat3::from_diagonal(DVec3::new(1.0, -9.0, 1.0)),
            translation: DVec3::Y * 18.0,
        };
        assert!(seen(stretched), "mirrored and stretched towards the picture");
    }

    #[test]
    fn a_plant_stands_where_its_file_put_it() {
        let scene = Scene::single(probe(DVec3::new(100.0, 0.0, 0.0))).expect("valid");
        let (low, high) = scene.bounds().expect("one copy");
        assert_eq!((low, high), (DVec3::new(99.0, -1.0, -1.0), DVec3::new(101.0, 1.0, 1.0)), "box");
        let mut scene = Scene::default();
        assert_eq!(scene.bounds(), None, "nothing anywhere");
        assert!(depths(&scene, &perspective()).is_empty(), "an empty picture");
        // a transform moves the plant's world, not the plant about itself
        let quarter = DAffine3::from_rotation_y(std::f64::consts::FRAC_PI_2);
        let mirror = DAffine3::from_scale(DVec3::new(-2.0, 1.0, 1.0));
        scene.add(probe(DVec3::X * 10.0), &[quarter, mirror]).expect("valid");
        let (low, high) = scene.bounds().expect("two copies");
        let expected = (DVec3::new(-22.0, -1.0, -11.0), DVec3::new(1.0, 1.0, 1.0));
        assert!(
            low.abs_diff_eq(expected.0, 1e-12) && high.abs_diff_eq(expected.1, 1e-12),
            "{low} {high}"
        );
    }

    fn steady(lean: f64) -> Wind {
        Wind { lean, sway: 0.0, period_secs: 1.0, toward: None, seed: 0 }
    }

    #[test]
    fn copies_are_sheared_about_their_feet() {
        let mut scene = Scene::default();
        let turned = at(0.0, 3.0, 0.0) * DAffine3::from_rotation_y(2.0);
        scene.add(probe(DVec3::ZERO), &[turned]).expect("valid");
        let scene = scene.in_wind(steady(0.25)).expect("a breeze");
        let plan = scene.plan(&perspective(), Outputs::COLOR, &mut ViewState::default());
        let instance = plan.expect("valid").remove(0).list.instances[0];
        let shown = |p: DVec3| instance.linear * p.as_vec3() + instance.translation;
        let still = |p: DVec3| (turned.transform_point3(p) - DVec3::Z * 10.0).as_vec3();
        let (foot, top) = (DVec3::new(0.5, -1.0, 0.5), DVec3::new(0.5, 1.0, 0.5));
        assert!(shown(foot).abs_diff_eq(still(foot), 1e-6), "what stands on the ground stays");
        let moved = shown(top) - still(top);
        assert!(moved.abs_diff_eq(Vec3::X * 0.5, 1e-6), "2 m times 0.25: {moved}");
        let (low, high) = scene.bounds().expect("one copy");
        let calm = Scene { wind: None, ..scene }.bounds().expect("one copy");
        assert!(high.y == calm.1.y && low.y == calm.0.y, "as high as before");
        assert!(high.x > calm.1.x + 0.5 && low.x < calm.0.x - 0.5, "wider: 2 m times 0.25");
    }

    #[test]
    fn copies_differ_as_their_variety_says() {
        let mut scene = Scene::default();
        let origin = DVec3::new(0.0, 100.0, 0.0);
        let transforms = [at(0.0, -100.0, 0.0), at(1.0, -100.0, 0.0)];
        scene.add(probe(origin), &transforms).expect("valid");
        let color = DVec3::new(0.1, 0.2, 0.05);
        let (size, hue_deg, value) = (0.15, 20.0, 0.1);
        let variety = Variety { size, hue_deg, value, mirror: true, color, seed: 5 };
        let scene = scene.varied(variety).expect("mild");
        let plan = scene.plan(&perspective(), Outputs::COLOR, &mut ViewState::default());
        let list = plan.expect("valid").remove(0).list;
        let bounds = scene.bounds().expect("two copies");
        let mut expected = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for item in &list.items {
            let instance = list.instances[item.instances.start as usize];
            // the probe's foot is at (0, -1, 0) of its own
            let foot = instance.linear * -Vec3::Y + instance.translation;
            let index = u32::from(foot.x > 0.5);
            let variant = variety.of((0, index));
            let place = Vec3::new(index as f32, -1.0, -10.0);
            assert!(foot.abs_diff_eq(place, 1e-5), "copy {index} stands where it was put: {foot}");
            let side = if variant.is_mirrored { -1.0 } else { 1.0 };
            let axes = DVec3::new(side, 1.0, 1.0) * variant.scale;
            let linear = glam::Mat3::from_diagonal(axes.as_vec3());
            assert!(instance.linear.abs_diff_eq(linear, 1e-6), "copy {index}: {variant:?}");
            assert_eq!(instance.tint, variety.tint(&variant).extend(1.0), "copy {index}");
            let middle = DVec3::new(f64::from(index), variant.scale - 1.0, 0.0);
            expected.0 = expected.0.min(middle - variant.scale);
            expected.1 = expected.1.max(middle + variant.scale);
        }
        assert_eq!(list.items.len(), 2, "both are seen");
        assert!(bounds.0.abs_diff_eq(expected.0, 1e-12), "{bounds:?} {expected:?}");
        assert!(bounds.1.abs_diff_eq(expected.1, 1e-12), "{bounds:?} {expected:?}");
    }

    #[test]
    fn a_leaning_copy_is_seen_where_it_leans_to() {
        // still, 12.5 is just outside; the middle moves 1 m aside, and the ball grows with the shear
        for (x, lean, is_seen) in [(14.0, -1.0, true), (16.0, 1.0, false), (14.0, 0.0, false)] {
            let mut scene = Scene::default();
            scene.add(probe(DVec3::ZERO), &[at(x, 0.0, 0.0)]).expect("valid");
            let scene = scene.in_wind(steady(lean)).expect("a storm");
            let seen = scene.plan(&perspective(), Outputs::COLOR, &mut ViewState::default());
            let count = seen.expect("valid")[0].list.items.len();
            assert_eq!(count == 1, is_seen, "{x} m aside, leaning by {lean}");
        }
    }

    #[test]
    fn bad_transforms_are_refused() {
        let scaled = |x: f64, y: f64, z: f64| DAffine3::from_scale(DVec3::new(x, y, z));
        let sheared = DMat3::from_cols(DVec3::X, DVec3::new(1.0, 1e-13, 0.0), DVec3::Z);
        let bad = [
            at(f64::NAN, 0.0, 0.0),
            at(0.0, f64::INFINITY, 0.0),
            at(0.0, 0.0, 1e19),
            scaled(1.0, 1.0, 0.0),
            scaled(1e-19, 1.0, 1.0),
            scaled(1e19, 1.0, 1.0),
            DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::X, DVec3::Z)),
            DAffine3::from_mat3(sheared),
        ];
        for transform in bad {
            let mut scene = Scene::default();
            let result = scene.add(probe(DVec3::ZERO), &[DAffine3::IDENTITY, transform]);
            let message = result.expect_err("refused").to_string();
            assert!(message.starts_with("transforms"), "{message}");
            assert!(message.contains('1'), "says which one: {message}");
            assert_eq!(scene.instance_count(), 0, "and adds none");
        }
        for transform in [scaled(-1.0, 1.0, 1.0), scaled(1e-9, 1e-9, 1e-9), scaled(1e9, 1.0, 1e-3)]
        {
            let mut scene = Scene::default();
            scene.add(probe(DVec3::ZERO), &[transform]).expect("mirrors and sizes are fine");
        }
    }

    #[test]
    fn equal_distances_are_painted_in_order() {
        let mut scene = Scene::default();
        let ring: Vec<DAffine3> = (0..5).map(|i| at(0.0, 0.0, -f64::from(i % 2))).collect();
        scene.add(probe(DVec3::ZERO), &ring).expect("valid");
        let view = perspective();
        let passes = scene.plan(&view, Outputs::COLOR, &mut ViewState::default()).expect("valid");
        let order: Vec<u32> =
            passes[0].list.items.iter().map(|item| item.instances.start).collect();
        assert_eq!(order, [0, 1, 2, 3, 4], "the crowns come sorted");
        assert_eq!(depths(&scene, &view), [11.0, 11.0, 10.0, 10.0, 10.0], "far to near");
    }
}
