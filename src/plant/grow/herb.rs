//! Flowering herbs: bent stems with a flower head on each, and large leaves.
//!
//! Stems, leaf stalks and the bodies of the flower heads are solid and count as wood; leaves, rays,
//! bracts and the florets of the disc are foliage. Florets sit in Vogel's spiral.
//!
//! This work is based on:
//! Helmut Vogel. A better way to construct the sunflower head. 1979

use glam::{DVec3, Vec3};

use crate::error::LodError;
use crate::job::Job;
use crate::plant::Mesh;
use crate::plant::grow::Grown;
use crate::plant::grow::blade::{Elements, Pose};
use crate::plant::grow::params::{Bark, Blade, Vary};
use crate::plant::grow::skeleton::Stem;
use crate::plant::grow::tube::{add_tube, wood_index};
use crate::plant::grow::turn::{across, around_axis, level_side, side_direction, turn};
use crate::random::{Purpose, Stream};

const BARK: Purpose = Purpose::named("grow.herb.bark");
const STEM: Purpose = Purpose::named("grow.herb.stem");
const LEAF: Purpose = Purpose::named("grow.herb.leaf");
const HEAD: Purpose = Purpose::named("grow.herb.head");

/// Degrees from one floret, or stalk, to the next.
const GOLDEN_ANGLE: f64 = 137.507_764;

/// How far a leaf reaches into its stalk, as a share of its length.
const JOINT: f64 = 0.02;

/// Corners around a flower head's body.
const HEAD_SIDES: usize = 20;

/// Profile of a flower head's body from the stem to the middle of the disc: height (below 0 as a
/// share of the depth, above as one of the dome), share of the disc's radius.
const PROFILE: [(f64, f64); 6] =
    [(-1.0, 0.2), (-0.7, 0.6), (-0.25, 0.94), (0.0, 1.0), (0.55, 0.67), (0.88, 0.35)];

/// The rings of the profile that are green.
const GREEN_RINGS: usize = 3;

/// Heights and radii of the stump that several stems grow from, in radii of a stem.
const STUMP: [(f64, f64); 3] = [(0.0, 2.4), (4.0, 2.0), (9.0, 0.5)];

/// What a herb is made of. Lengths in metres, angles in degrees.
#[derive(Debug)]
pub(super) struct Herb {
    pub(super) name: &'static str,
    pub(super) stems: Stems,
    pub(super) leaves: Leaves,
    pub(super) head: Head,
    /// Of stems, stalks and the backs of the heads.
    pub(super) green: [f64; 3],
}

/// The stems that bear flowers. A single one is the plant's trunk, several grow from a stump.
#[derive(Debug)]
pub(super) struct Stems {
    pub(super) count: usize,
    pub(super) height: Vary,
    pub(super) radius: f64,
    /// Angle to the vertical at the foot.
    pub(super) lean: Vary,
    /// Angle to the vertical of the flower, and from which share of the length on it is reached.
    pub(super) nod: Vary,
    pub(super) nod_from: f64,
    pub(super) segments: usize,
    pub(super) sides: usize,
}

/// Leaves on stalks along a single stem, or without stalks around a stump.
#[derive(Debug)]
pub(super) struct Leaves {
    pub(super) count: usize,
    pub(super) blade: Blade,
    /// Of the lowest and of the topmost leaf.
    pub(super) length: (f64, f64),
    /// Length of a stalk as a share of its leaf's.
    pub(super) stalk: f64,
    /// Share of the stem at the lowest and at the topmost leaf.
    pub(super) along: (f64, f64),
    /// Angle of the lowest and of the topmost leaf above the horizontal.
    pub(super) lift: (f64, f64),
    pub(super) curl: Vary,
    pub(super) color: [f64; 3],
}

/// A flower head.
#[derive(Debug)]
pub(super) struct Head {
    /// Of the disc.
    pub(super) radius: f64,
    /// Height of the disc's middle and depth of the body behind, as shares of the radius.
    pub(super) dome: f64,
    pub(super) depth: f64,
    pub(super) floret_count: usize,
    pub(super) floret: Blade,
    /// In the middle and at the rim of the disc.
    pub(super) disc: ([f64; 3], [f64; 3]),
    pub(super) ray_count: usize,
    pub(super) ray: Blade,
    pub(super) ray_length: Vary,
    /// Angle of the rays above the disc's plane.
    pub(super) ray_lift: Vary,
    pub(super) ray_curl: Vary,
    pub(super) ray_color: [f64; 3],
    pub(super) bract_count: usize,
    pub(super) bract: Blade,
}

impl Herb {
    /// Leaves and parts of flowers, as many as there always are.
    pub(super) fn fixed_count(&self) -> usize {
        self.leaves.count + self.stems.count * (self.head.ray_count + self.head.bract_count)
    }

    /// Elements of the foliage unless another number is asked for.
    pub(super) fn usual_count(&self) -> usize {
        self.fixed_count() + self.stems.count * self.head.floret_count
    }
}

/// A herb whose foliage has `leaf_count` elements: what is no leaf, ray or bract is a floret.
///
/// # Errors
/// [`LodError::Cancelled`].
pub(super) fn herb(
    herb: &Herb,
    seed: u64,
    leaf_count: usize,
    job: &Job,
) -> Result<Grown, LodError> {
    let mut grower = Grower { herb, seed, stems: Vec::new(), flower_stems: Vec::new() };
    grower.grow_stems();
    let (stems, flower_stems) = (&grower.stems, &grower.flower_stems);
    let mut foliage = Elements::new();
    // in the order of the stems: a stump's leaves come before its flowers, a stem's flower before
    // the leaves on its stalks
    let has_stump = flower_stems.len() > 1;
    if has_stump {
        grower.add_leaves(&mut foliage);
    }
    let first_petal = wood_index(foliage.mesh.triangles.len());
    let bark = Bark { old: herb.green, young: herb.green, spread: 0.08 };
    let mut wood = Mesh::default();
    let mut wood_ranges = Vec::with_capacity(stems.len());
    let floret_count = leaf_count - herb.fixed_count();
    job.begin(floret_count as u64);
    for (id, stem) in (0_u32..).zip(stems) {
        let first = wood_index(wood.triangles.len());
        let stream = Stream::new(seed, BARK, u64::from(id));
        add_tube(herb.stems.sides, 0.0, &bark, stem, stream, &mut wood);
        if let Some(flower) = flower_stems.iter().position(|&other| other == id) {
            let tip = &stem.nodes[stem.nodes.len() - 1];
            let side = level_side(tip.direction);
            let frame = Frame { center: tip.position, axis: tip.direction, side };
            add_body(herb, &frame, &mut wood);
            let (from, to) = (flower * floret_count, (flower + 1) * floret_count);
            let here = to / flower_stems.len() - from / flower_stems.len();
            let mut stream = Stream::new(seed, HEAD, u64::from(id));
            add_florets(&herb.head, &frame, here, &mut stream, id, &mut foliage, job)?;
            add_rim(&herb.head, &frame, herb.green, stream, id, &mut foliage);
        }
        wood_ranges.push(first..wood_index(wood.triangles.len()));
    }
    let petals = first_petal..wood_index(foliage.mesh.triangles.len());
    if !has_stump {
        grower.add_leaves(&mut foliage);
    }
    wood.uvs.resize(wood.positions.len(), glam::Vec2::ZERO);
    let materials = &["stems", "leaves", "flowers"];
    Ok(Grown { stems: grower.stems, wood, wood_ranges, foliage, materials, petals })
}

struct Grower<'a> {
    herb: &'a Herb,
    seed: u64,
    stems: Vec<Stem>,
    flower_stems: Vec<u32>,
}

impl Grower<'_> {
    fn grow_stems(&mut self) {
        let shape = &self.herb.stems;
        let has_stump = shape.count > 1;
        if has_stump {
            let radius = shape.radius;
            let points =
                STUMP.map(|(height, width)| (DVec3::Y * (height * radius), width * radius));
            self.stems.push(Stem::through(None, 0, &points));
        }
        for number in 0..shape.count {
            self.flower_stems.push(u32::try_from(self.stems.len()).expect("stems are few"));
            self.grow_stem(number, has_stump);
        }
    }

    fn grow_stem(&mut self, number: usize, has_stump: bool) {
        let shape = &self.herb.stems;
        let mut stream = Stream::new(self.seed, STEM, number as u64);
        let around = (number as f64 * GOLDEN_ANGLE + 15.0 * stream.signed()).to_radians();
        let outward = around_axis(DVec3::Y, DVec3::X, around + 6.0 * f64::from(!has_stump));
        let hinge = DVec3::Y.cross(outward).normalize();
        // the innermost stem stands upright
        let share = if has_stump { number as f64 / (shape.count - 1) as f64 } else { 1.0 };
        let lean = shape.lean.at(stream.signed()) * share.sqrt();
        let nod = shape.nod.at(stream.signed()) * share.sqrt();
        let length = shape.height.at(stream.signed());
        let step = length / shape.segments as f64;
        let mut position =
            if has_stump { DVec3::Y * shape.radius + outward * shape.radius } else { DVec3::ZERO };
        let mut points = vec![(position, shape.radius)];
        for segment in 0..shape.segments {
            let along = (segment as f64 + 1.0) / shape.segments as f64;
            let nodded = ((along - shape.nod_from) / (1.0 - shape.nod_from)).clamp(0.0, 1.0);
            // upright below, so that the lean does not carry the flower far away
            let angle = lean * (1.0 - 0.5 * along) + (nod - 0.5 * lean) * nodded;
            let sway = 3.0 * stream.signed();
            position += turn(DVec3::Y, hinge, (angle + sway).to_radians()) * step;
            points.push((position, shape.radius * (1.0 - 0.45 * along)));
        }
        let id = u32::try_from(self.stems.len()).expect("stems are few");
        let level = usize::from(has_stump);
        self.stems.push(Stem::through(has_stump.then_some(0), level, &points));
        if !has_stump {
            self.grow_stalks(id);
        }
    }

    /// A stalk for every leaf along a stem.
    fn grow_stalks(&mut self, parent: u32) {
        let leaves = &self.herb.leaves;
        let stem = self.stems[parent as usize].clone();
        for number in 0..leaves.count {
            let place = Place::of(self.herb, self.seed, number);
            let node = stem.at(stem.length() * place.along);
            let side = level_side(node.direction);
            let lift = place.lift.to_radians();
            let direction = |down| side_direction(node.direction, side, place.around, down);
            let length = place.length * leaves.stalk;
            let middle = node.position + direction(0.9 - lift) * (length * 0.5);
            let tip = middle + direction(1.3 - lift) * (length * 0.5);
            let radius = self.herb.stems.radius * 0.3;
            let points = [(node.position, radius), (middle, radius * 0.8), (tip, radius * 0.5)];
            self.stems.push(Stem::through(Some(parent), 1, &points));
        }
    }

    fn add_leaves(&self, foliage: &mut Elements) {
        let leaves = &self.herb.leaves;
        for number in 0..leaves.count {
            let place = Place::of(self.herb, self.seed, number);
            let stalks = self.stems.len() - leaves.count.min(self.stems.len());
            let (owner, foot, outward) = if self.flower_stems.len() == 1 {
                let stalk = &self.stems[stalks + number];
                let tip = &stalk.nodes[2];
                let flat = DVec3::new(tip.direction.x, 0.0, tip.direction.z);
                // not on the tip itself: parts that share a point are one to those who read a file
                let foot = tip.position - tip.direction * (JOINT * place.length);
                (stalks + number, foot, flat.normalize_or(DVec3::X))
            } else {
                let outward = around_axis(DVec3::Y, DVec3::X, place.around);
                // on the side of the stump
                let root = self.herb.stems.radius;
                (0, (outward * 2.0 + DVec3::Y * 2.0) * root, outward)
            };
            let lift = place.lift.to_radians();
            let direction = outward * libm::cos(lift) + DVec3::Y * libm::sin(lift);
            let normal = across(DVec3::Y + place.aside * 0.35, direction);
            let pose = Pose { foot, direction, normal, length: place.length, curl: place.curl };
            let owner = u32::try_from(owner).expect("stems are few");
            let color = DVec3::from(leaves.color) * place.light;
            foliage.push(owner, &leaves.blade, &pose, color);
        }
    }
}

/// Where a leaf belongs.
struct Place {
    along: f64,
    /// Radians.
    around: f64,
    /// Degrees.
    lift: f64,
    length: f64,
    curl: f64,
    aside: DVec3,
    light: f64,
}

impl Place {
    fn of(herb: &Herb, seed: u64, number: usize) -> Self {
        let leaves = &herb.leaves;
        let mut stream = Stream::new(seed, LEAF, number as u64);
        let share = (number as f64 + 0.3 * stream.unit()) / leaves.count as f64;
        let between = |ends: (f64, f64)| ends.0 + (ends.1 - ends.0) * share;
        Self {
            along: between(leaves.along),
            around: (number as f64 * GOLDEN_ANGLE + 12.0 * stream.signed()).to_radians(),
            lift: between(leaves.lift) + 8.0 * stream.signed(),
            length: between(leaves.length) * (1.0 + 0.12 * stream.signed()),
            curl: leaves.curl.at(stream.signed()),
            aside: DVec3::new(stream.signed(), 0.0, stream.signed()),
            light: 1.0 + 0.15 * stream.signed(),
        }
    }
}

/// Where a flower head is.
struct Frame {
    /// Middle of the disc's rim.
    center: DVec3,
    /// Unit vector out of the disc.
    axis: DVec3,
    /// Unit vector across the axis.
    side: DVec3,
}

impl Frame {
    /// Unit vector across the axis at an angle in radians.
    fn outward(&self, angle: f64) -> DVec3 {
        around_axis(self.axis, self.side, angle)
    }
}

/// Adds the closed body behind and under the disc to the wood.
fn add_body(herb: &Herb, frame: &Frame, wood: &mut Mesh) {
    let head = &herb.head;
    let first = wood.positions.len();
    let height =
        |height: f64| height * head.radius * if height < 0.0 { head.depth } else { head.dome };
    let mut add = |point: DVec3, normal: DVec3, color: DVec3| {
        wood.positions.push(point.as_vec3());
        wood.normals.push(normal.normalize_or(frame.axis).as_vec3());
        wood.base.push(color.as_vec3().min(Vec3::ONE).extend(1.0));
    };
    let (middle, rim) = (DVec3::from(head.disc.0), DVec3::from(head.disc.1));
    for (ring, &(level, share)) in PROFILE.iter().enumerate() {
        let green = ring < GREEN_RINGS;
        let color = if green { DVec3::from(herb.green) } else { middle.lerp(rim, share) * 0.8 };
        for corner in 0..HEAD_SIDES {
            let angle = std::f64::consts::TAU * corner as f64 / HEAD_SIDES as f64;
            let outward = frame.outward(angle);
            let point = frame.center + frame.axis * height(level) + outward * (share * head.radius);
            let tilt = if green { -0.6 } else { 1.5 };
            add(point, outward + frame.axis * tilt, color);
        }
    }
    add(frame.center + frame.axis * height(-1.1), -frame.axis, DVec3::from(herb.green));
    add(frame.center + frame.axis * height(1.0), frame.axis, middle * 0.8);

    let corner =
        |ring: usize, side: usize| wood_index(first + ring * HEAD_SIDES + side % HEAD_SIDES);
    let last = PROFILE.len() - 1;
    let (bottom, top) = (corner(last + 1, 0), corner(last + 1, 1));
    for side in 0..HEAD_SIDES {
        wood.triangles.push([bottom, corner(0, side + 1), corner(0, side)]);
        for ring in 1..=last {
            let low = [corner(ring - 1, side), corner(ring - 1, side + 1)];
            let high = [corner(ring, side), corner(ring, side + 1)];
            wood.triangles.push([low[0], low[1], high[1]]);
            wood.triangles.push([low[0], high[1], high[0]]);
        }
        wood.triangles.push([corner(last, side), corner(last, side + 1), top]);
    }
}

/// Adds the florets of one head.
fn add_florets(
    head: &Head,
    frame: &Frame,
    floret_count: usize,
    stream: &mut Stream,
    owner: u32,
    out: &mut Elements,
    job: &Job,
) -> Result<(), LodError> {
    let Head { radius, dome, .. } = *head;
    let (middle, rim) = (DVec3::from(head.disc.0), DVec3::from(head.disc.1));
    let floret_length = 2.4 * radius / (floret_count.max(1) as f64).sqrt();
    for number in 0..floret_count {
        job.check()?;
        let share = ((number as f64 + 0.5) / floret_count as f64).sqrt() * 0.97;
        let outward = frame.outward((number as f64 * GOLDEN_ANGLE).to_radians());
        let height = dome * radius * (1.0 - share * share);
        let foot = frame.center + outward * (share * radius) + frame.axis * height;
        let direction = (outward + frame.axis * 0.9).normalize();
        let normal = across(frame.axis, direction);
        let length = floret_length * (1.0 + 0.2 * stream.signed());
        let foot = foot - direction * (length * 0.3);
        let color = middle.lerp(rim, share * share) * (1.0 + 0.25 * stream.signed());
        out.push(owner, &head.floret, &Pose { foot, direction, normal, length, curl: 0.0 }, color);
        job.advance();
    }
    Ok(())
}

/// Adds the rays and bracts of one head.
fn add_rim(
    head: &Head,
    frame: &Frame,
    green: [f64; 3],
    mut stream: Stream,
    owner: u32,
    out: &mut Elements,
) {
    let Head { radius, dome, depth, .. } = *head;
    let start = stream.unit();
    for number in 0..head.ray_count {
        let place = number as f64 + start + 0.25 * stream.signed();
        let outward = frame.outward(std::f64::consts::TAU * place / head.ray_count as f64);
        // every other ray belongs to an inner ring, a little higher
        let inner = number % 2 == 1;
        let lift = head.ray_lift.at(stream.signed()) + if inner { 9.0 } else { 0.0 };
        let lift = lift.to_radians();
        let direction = outward * libm::cos(lift) + frame.axis * libm::sin(lift);
        let roll = turn(frame.axis, outward, 0.2 * stream.signed());
        let (share, height) = if inner { (0.9, 0.19 * dome) } else { (0.94, -0.05) };
        let foot = frame.center + (outward * share + frame.axis * height) * radius;
        let pose = Pose {
            foot,
            direction,
            normal: across(roll, direction),
            length: head.ray_length.at(stream.signed()),
            curl: head.ray_curl.at(stream.signed()),
        };
        let color = DVec3::from(head.ray_color) * (1.0 + 0.08 * stream.signed());
        out.push(owner, &head.ray, &pose, color);
    }
    for number in 0..head.bract_count {
        let place = number as f64 + 0.3 * stream.signed();
        let outward = frame.outward(std::f64::consts::TAU * place / head.bract_count as f64);
        let foot = frame.center + outward * (radius * 0.93) - frame.axis * (radius * depth * 0.3);
        let direction = (outward * 0.75 + frame.axis * (0.35 + 0.3 * stream.signed())).normalize();
        let length = radius * (0.5 + 0.1 * stream.signed());
        let normal = across(frame.axis, direction);
        let color = DVec3::from(green) * (0.9 + 0.15 * stream.signed());
        out.push(owner, &head.bract, &Pose { foot, direction, normal, length, curl: 0.1 }, color);
    }
}
