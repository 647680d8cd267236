//! Where the zone of interest lies in one view: asked of a node, or of all that lies below it.
//!
//! Each criterion is a number that is at least 0 in the zone and changes no faster than one walks. So
//! its value at the centre of a ball, with the ball's radius, answers for all that lies in the ball:
//! none, all, or maybe. It also tells by how much the view may change before the answer can: its
//! *margin*. Two views have a *drift* between them: the most by which that number differs anywhere in
//! the crown. As long as the drifts add up to less than the margin, nobody need ask again.
//!
//! Everything is 64 bits, in the plant's own space; the view's planes and eye are brought there. What
//! is measured in the scene's metres or in pixels goes through the linear part of the transform, so
//! mirrored and skewed copies are as right as others.

use glam::{DMat3, DVec3};

use crate::error::LodError;
use crate::lod::foliage_hierarchy::criteria::{Criterion, Placed};
use crate::lod::foliage_hierarchy::depth_first::{DepthFirst, Place};
use crate::lod::foliage_hierarchy::forest::Forest;
use crate::view::Projection;

/// Rounding of the numbers here, as a share of the lengths that go in; a few times that of f64.
const ROUNDING: f64 = 1e-14;

/// What holds for all nodes of a sub-tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Below {
    /// None is in the zone.
    None,
    /// All are.
    All,
    /// Each must be asked.
    Maybe,
}

/// A criterion's number and how far rounding may be off.
#[derive(Debug, Clone, Copy)]
struct Field {
    kind: Kind,
    slack: f64,
}

#[derive(Debug, Clone, Copy)]
enum Kind {
    /// `radius - |p - center|`; negated if the outside is fine.
    Sphere { center: DVec3, radius: f64, is_fine_inside: bool },
    /// `normal . p + offset`.
    Plane { normal: DVec3, offset: f64 },
    /// The least of five planes, plus the radius.
    Frustum([(DVec3, f64); 5]),
    /// `stretch * radius - slope * |linear (p - eye)| - least`.
    Size { eye: DVec3, linear: DMat3, stretch: f64, slope: f64, least: f64 },
    /// `limit - |linear (p - eye)|`.
    Near { eye: DVec3, linear: DMat3, stretch: f64, limit: f64 },
}

#[derive(Debug, Clone)]
enum Test {
    Field(Field),
    And(Vec<Self>),
    Or(Vec<Self>),
    Not(Box<Self>),
    /// Nodes in the zone, and how many of them are before each place.
    Mask {
        is_fine: Vec<bool>,
        counts: Vec<u32>,
    },
}

/// The zone of interest of one view.
#[derive(Debug, Clone)]
pub struct Zone {
    test: Test,
    crown: (DVec3, f64),
    has_mask: bool,
}

impl Zone {
    /// Brings a criterion and a view into a plant's space. Masks are asked here, once each.
    ///
    /// # Errors
    /// As [`Criterion::check`]; what a mask returns; `transforms` without an inverse.
    pub fn new(
        criterion: &Criterion,
        forest: &Forest,
        order: &DepthFirst,
        placed: &Placed<'_>,
    ) -> Result<Self, LodError> {
        criterion.check()?;
        let local_from_world = placed.world_from_local.inverse();
        if !placed.world_from_local.is_finite() || !local_from_world.is_finite() {
            let why = "the transform of a copy has no inverse".to_owned();
            return Err(LodError::Invalid { name: "transforms", why });
        }
        let eye = local_from_world.transform_point3(placed.view.eye);
        let maker = Maker { forest, order, placed, eye };
        let mut has_mask = false;
        let test = maker.test(criterion, &mut has_mask)?;
        Ok(Self { test, crown: order.crown, has_mask })
    }

    /// Whether the node at a place is in the zone, and the margin.
    pub fn holds(&self, at: usize, place: &Place) -> (bool, f64) {
        self.test.holds(at, place)
    }

    /// What is known of a sub-tree, and the margin.
    pub fn below(&self, at: usize, place: &Place) -> (Below, f64) {
        self.test.below(at, place)
    }

    /// The most by which any of the numbers differs in another view, anywhere in the crown; infinite
    /// for another criterion, or where masks were asked.
    pub fn drift_from(&self, other: &Self) -> f64 {
        if self.has_mask || other.has_mask {
            return f64::INFINITY;
        }
        let drift = self.test.drift_from(&other.test, self.crown);
        if drift.is_nan() { f64::INFINITY } else { drift }
    }

    /// Drifts beyond this many metres in all are no longer added up exactly enough.
    pub fn longest_drift(&self) -> f64 {
        let (center, radius) = self.crown;
        (center.length() + radius) * 16.0
    }
}

struct Maker<'a> {
    forest: &'a Forest,
    order: &'a DepthFirst,
    placed: &'a Placed<'a>,
    eye: DVec3,
}

impl Maker<'_> {
    fn test(&self, criterion: &Criterion, has_mask: &mut bool) -> Result<Test, LodError> {
        // not deeper than `Criterion::check` allows
        let mut all = |parts: &[Criterion]| -> Result<Vec<Test>, LodError> {
            parts.iter().map(|part| self.test(part, has_mask)).collect()
        };
        Ok(match criterion {
            Criterion::And(parts) => Test::And(all(parts)?),
            Criterion::Or(parts) => Test::Or(all(parts)?),
            Criterion::Not(part) => Test::Not(Box::new(self.test(part, has_mask)?)),
            Criterion::Mask(mask) => {
                *has_mask = true;
                let by_node = mask.ask(self.forest, self.placed)?;
                let places = self.order.places.iter();
                let is_fine: Vec<bool> = places.map(|place| by_node[place.node as usize]).collect();
                let mut counts = Vec::with_capacity(is_fine.len() + 1);
                counts.push(0);
                counts.extend(is_fine.iter().scan(0, |count, &fine| {
                    *count += u32::from(fine);
                    Some(*count)
                }));
                Test::Mask { is_fine, counts }
            }
            _ => Test::Field(self.field(criterion)),
        })
    }

    fn field(&self, criterion: &Criterion) -> Field {
        let (center, radius) = self.order.crown;
        let crown = center.length() + radius;
        let placed = self.placed;
        let linear = placed.world_from_local.matrix3;
        let stretch = stretch(&linear);
        // of a distance from the eye
        let seen = (self.eye.length() + crown) * stretch;
        let (kind, lengths) = match *criterion {
            Criterion::Sphere { center, radius, is_fine_inside, growth } => {
                let radius = radius + growth * self.eye.distance(center);
                let kind = Kind::Sphere { center, radius, is_fine_inside };
                (kind, crown + center.length() + radius)
            }
            Criterion::Plane { point, normal } => {
                let normal = normal.normalize();
                let offset = -normal.dot(point);
                (Kind::Plane { normal, offset }, crown + point.length())
            }
            Criterion::Frustum => {
                let planes = local_planes(placed);
                let offsets = planes.iter().map(|plane| plane.1.abs()).fold(0.0, f64::max);
                (Kind::Frustum(planes), crown + offsets)
            }
            Criterion::ScreenSize { pixels } => {
                // the tangent of half the angle, or half the length
                let half = pixels * 0.5 / placed.view.pixels_per_metre_at_one();
                let (slope, least) = match placed.view.projection {
                    // r / sqrt(d^2 - r^2) > half  <=>  r / d > half / sqrt(1 + half^2)
                    Projection::Perspective { .. } => (half / half.hypot(1.0), 0.0),
                    Projection::Orthographic { .. } => (0.0, half),
                };
                let kind = Kind::Size { eye: self.eye, linear, stretch, slope, least };
                (kind, seen * slope + crown * stretch + least)
            }
            Criterion::Distance { max_distance } => {
                let kind = Kind::Near { eye: self.eye, linear, stretch, limit: max_distance };
                (kind, seen + max_distance)
            }
            Criterion::And(_) | Criterion::Or(_) | Criterion::Not(_) | Criterion::Mask(_) => {
                unreachable!("has parts, or is a mask")
            }
        };
        Field { kind, slack: lengths * ROUNDING }
    }
}

/// How much a transform stretches what it stretches most: the root of the largest eigenvalue of
/// `M^T M`, in closed form.
pub fn stretch(linear: &DMat3) -> f64 {
    let m = linear.transpose() * *linear;
    let (x, y, z) = (m.x_axis, m.y_axis, m.z_axis);
    let mean = (x.x + y.y + z.z) / 3.0;
    let aside = x.y * x.y + x.z * x.z + y.z * y.z;
    let along = [x.x, y.y, z.z].map(|d| (d - mean) * (d - mean)).iter().sum::<f64>();
    let spread = ((along + 2.0 * aside) / 6.0).sqrt();
    if spread == 0.0 {
        return mean.sqrt();
    }
    let unit = (m - DMat3::from_diagonal(DVec3::splat(mean))) * (1.0 / spread);
    let angle = libm::acos((unit.determinant() * 0.5).clamp(-1.0, 1.0)) / 3.0;
    (mean + 2.0 * spread * libm::cos(angle)).sqrt()
}

/// The near plane and the four sides, pointing inwards, in the plant's space.
fn local_planes(placed: &Placed<'_>) -> [(DVec3, f64); 5] {
    let view = placed.view;
    let pixels = view.pixels_per_metre_at_one();
    let half_width = f64::from(view.width) * 0.5 / pixels / view.pixel_aspect;
    let half_height = f64::from(view.height) * 0.5 / pixels;
    let side = |across: DVec3, half: f64| match view.projection {
        // leans outward by `half` a metre of depth
        Projection::Perspective { .. } => (across - view.back * half, 0.0),
        Projection::Orthographic { .. } => (across, half),
    };
    let world = [
        (-view.back, -view.near),
        side(view.right, half_width),
        side(-view.right, half_width),
        side(view.up, half_height),
        side(-view.up, half_height),
    ];
    let transform = &placed.world_from_local;
    world.map(|(normal, offset)| {
        let local = transform.matrix3.transpose() * normal;
        let length = local.length();
        (local / length, (normal.dot(transform.translation - view.eye) + offset) / length)
    })
}

fn plane_at((normal, offset): (DVec3, f64), point: DVec3) -> f64 {
    normal.dot(point) + offset
}

fn least_plane(planes: &[(DVec3, f64); 5], point: DVec3) -> f64 {
    planes.iter().map(|&plane| plane_at(plane, point)).fold(f64::INFINITY, f64::min)
}

impl Field {
    fn holds(&self, place: &Place) -> (bool, f64) {
        let center = place.center.as_dvec3();
        let ball = place.ball.center.as_dvec3();
        let radius = f64::from(place.ball.radius);
        let (value, is_fine) = match &self.kind {
            &Kind::Sphere { center: middle, radius, is_fine_inside } => {
                let value = radius - center.distance(middle);
                (value, (value >= 0.0) == is_fine_inside)
            }
            &Kind::Plane { normal, offset } => {
                let value = plane_at((normal, offset), center);
                (value, value > 0.0)
            }
            Kind::Frustum(planes) => {
                let value = least_plane(planes, ball) + radius;
                (value, value >= 0.0)
            }
            &Kind::Size { eye, linear, stretch, slope, least } => {
                let distance = (linear * (ball - eye)).length();
                let value = stretch * radius - slope * distance - least;
                (value, value > 0.0)
            }
            &Kind::Near { eye, linear, limit, .. } => {
                let value = limit - (linear * (center - eye)).length();
                (value, value > 0.0)
            }
        };
        (is_fine, (value.abs() - self.slack).max(0.0))
    }

    fn below(&self, place: &Place) -> (Below, f64) {
        let ball = place.ball.center.as_dvec3();
        let centers = f64::from(place.center_reach);
        let balls = f64::from(place.ball_reach);
        // least and greatest value of any node of the sub-tree
        let (low, high, is_flipped) = match &self.kind {
            &Kind::Sphere { center: middle, radius, is_fine_inside } => {
                let value = radius - ball.distance(middle);
                (value - centers, value + centers, !is_fine_inside)
            }
            &Kind::Plane { normal, offset } => {
                let value = plane_at((normal, offset), ball);
                (value - centers, value + centers, false)
            }
            Kind::Frustum(planes) => {
                let value = least_plane(planes, ball);
                // a ball of radius r within has its centre within `balls - r`
                (value - balls, value + balls, false)
            }
            &Kind::Size { eye, linear, stretch, slope, least } => {
                let away = slope * (linear * (ball - eye)).length() + least;
                let reach = stretch * balls;
                // slopes are at most 1: what a smaller ball gains by being nearer, it lacks in size
                let smallest = stretch * f64::from(place.least_radius);
                (smallest - away - slope * reach, reach - away, false)
            }
            &Kind::Near { eye, linear, stretch, limit } => {
                let value = limit - (linear * (ball - eye)).length();
                (value - stretch * centers, value + stretch * centers, false)
            }
        };
        let (none, all) = (-high - self.slack, low - self.slack);
        let (answer, margin) = if none > 0.0 {
            (Below::None, none)
        } else if all > 0.0 {
            (Below::All, all)
        } else {
            (Below::Maybe, (-none).min(-all))
        };
        if is_flipped { (answer.flipped(), margin) } else { (answer, margin) }
    }

    fn drift_from(&self, other: &Self, (center, radius): (DVec3, f64)) -> f64 {
        let plane_drift = |a: (DVec3, f64), b: (DVec3, f64)| {
            (plane_at(a, center) - plane_at(b, center)).abs() + (a.0 - b.0).length() * radius
        };
        // a distance from the eye
        let eye_drift = |a: (DVec3, DMat3), b: (DVec3, DMat3)| {
            let at_center = (a.1 * (center - a.0) - b.1 * (center - b.0)).length();
            at_center + frobenius(&(a.1 - b.1)) * radius
        };
        match (&self.kind, &other.kind) {
            (
                &Kind::Sphere { center: a, radius: at_a, is_fine_inside: fine_a },
                &Kind::Sphere { center: b, radius: at_b, is_fine_inside: fine_b },
            ) if fine_a == fine_b => a.distance(b) + (at_a - at_b).abs(),
            (
                &Kind::Plane { normal: a, offset: at_a },
                &Kind::Plane { normal: b, offset: at_b },
            ) => plane_drift((a, at_a), (b, at_b)),
            (Kind::Frustum(a), Kind::Frustum(b)) => {
                a.iter().zip(b).map(|(&a, &b)| plane_drift(a, b)).fold(0.0, f64::max)
            }
            (&Kind::Size { .. }, &Kind::Size { .. }) => {
                self.size_drift(other, center, radius, eye_drift)
            }
            (
                &Kind::Near { eye: a, linear: by_a, limit: at_a, .. },
                &Kind::Near { eye: b, linear: by_b, limit: at_b, .. },
            ) => eye_drift((a, by_a), (b, by_b)) + (at_a - at_b).abs(),
            _ => f64::INFINITY,
        }
    }

    fn size_drift(
        &self,
        other: &Self,
        center: DVec3,
        radius: f64,
        eye_drift: impl Fn((DVec3, DMat3), (DVec3, DMat3)) -> f64,
    ) -> f64 {
        let (
            &Kind::Size { eye: a, linear: by_a, stretch: sa, slope: ta, least: la },
            &Kind::Size { eye: b, linear: by_b, stretch: sb, slope: tb, least: lb },
        ) = (&self.kind, &other.kind)
        else {
            return f64::INFINITY;
        };
        // |ta da - tb db| <= ta |da - db| + |ta - tb| db
        let farthest = (by_b * (center - b)).length() + sb * radius;
        (sa - sb).abs() * radius
            + ta * eye_drift((a, by_a), (b, by_b))
            + (ta - tb).abs() * farthest
            + (la - lb).abs()
    }
}

fn frobenius(m: &DMat3) -> f64 {
    (m.x_axis.length_squared() + m.y_axis.length_squared() + m.z_axis.length_squared()).sqrt()
}

impl Below {
    fn flipped(self) -> Self {
        match self {
            Self::None => Self::All,
            Self::All => Self::None,
            Self::Maybe => Self::Maybe,
        }
    }
}

impl Test {
    fn holds(&self, at: usize, place: &Place) -> (bool, f64) {
        match self {
            Self::Field(field) => field.holds(place),
            // one part that does not hold is enough: the one that will not for longest
            Self::And(parts) => joined(parts.iter().map(|part| part.holds(at, place)), false),
            Self::Or(parts) => joined(parts.iter().map(|part| part.holds(at, place)), true),
            Self::Not(part) => {
                let (is_fine, margin) = part.holds(at, place);
                (!is_fine, margin)
            }
            Self::Mask { is_fine, .. } => (is_fine[at], 0.0),
        }
    }

    fn below(&self, at: usize, place: &Place) -> (Below, f64) {
        match self {
            Self::Field(field) => field.below(place),
            Self::And(parts) => {
                joined_below(parts.iter().map(|part| part.below(at, place)), Below::None)
            }
            Self::Or(parts) => {
                joined_below(parts.iter().map(|part| part.below(at, place)), Below::All)
            }
            Self::Not(part) => {
                let (answer, margin) = part.below(at, place);
                (answer.flipped(), margin)
            }
            Self::Mask { counts, .. } => {
                let end = place.end as usize;
                let fine_count = (counts[end] - counts[at]) as usize;
                let answer = if fine_count == 0 {
                    Below::None
                } else if fine_count == end - at {
                    Below::All
                } else {
                    Below::Maybe
                };
                (answer, 0.0)
            }
        }
    }

    fn drift_from(&self, other: &Self, crown: (DVec3, f64)) -> f64 {
        match (self, other) {
            (Self::Field(a), Self::Field(b)) => a.drift_from(b, crown),
            (Self::And(a), Self::And(b)) | (Self::Or(a), Self::Or(b)) if a.len() == b.len() => {
                a.iter().zip(b).map(|(a, b)| a.drift_from(b, crown)).fold(0.0, f64::max)
            }
            (Self::Not(a), Self::Not(b)) => a.drift_from(b, crown),
            _ => f64::INFINITY,
        }
    }
}

/// The answer `decisive` if any part gives it, for as long as one of those does; else the other one,
/// for as long as all do.
fn joined(parts: impl Iterator<Item = (bool, f64)>, decisive: bool) -> (bool, f64) {
    let (mut longest, mut shortest) = (None, f64::INFINITY);
    for (answer, margin) in parts {
        if answer == decisive {
            longest = Some(longest.map_or(margin, |longest: f64| longest.max(margin)));
        } else {
            shortest = shortest.min(margin);
        }
    }
    longest.map_or((!decisive, shortest), |longest| (decisive, longest))
}

fn joined_below(parts: impl Iterator<Item = (Below, f64)>, decisive: Below) -> (Below, f64) {
    let (mut longest, mut shortest) = (None, f64::INFINITY);
    let mut is_unsure = false;
    for (answer, margin) in parts {
        if answer == decisive {
            longest = Some(longest.map_or(margin, |longest: f64| longest.max(margin)));
        } else {
            is_unsure |= answer == Below::Maybe;
            shortest = shortest.min(margin);
        }
    }
    match longest {
        Some(longest) => (decisive, longest),
        None if is_unsure => (Below::Maybe, shortest),
        None => (decisive.flipped(), shortest),
    }
}
