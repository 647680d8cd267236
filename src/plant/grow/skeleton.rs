//! The stems of a plant as chains of nodes: position, direction and radius.
//!
//! A stem is a chain of segments. At every node it bends by its curve, by chance and towards the
//! light; it may fork there into two arms of the same level; and it bears side branches at even
//! distances. Deviations from the paper: side branches have a spacing instead of a number, so that
//! long and short limbs are equally dense; crown outlines are a pair of ellipse quarters; an arm of
//! a fork is thinner than the stem below it.
//!
//! This work is based on:
//! Jason Weber, Joseph Penn. Creation and Rendering of Realistic Trees. 1995

use glam::DVec3;

use crate::error::LodError;
use crate::job::Job;
use crate::plant::grow::params::{Level, Outline, Species, Twigs, Vary};
use crate::plant::grow::turn::{across, around_axis, level_side, side_direction, turn};
use crate::plant::grow::twigs;
use crate::random::{Purpose, Stream};

const STEM: Purpose = Purpose::named("grow.stem");
const BENDS: Purpose = Purpose::named("grow.bends");
const CHILD: Purpose = Purpose::named("grow.child");

/// No stem is thinner, in metres.
const MIN_RADIUS: f64 = 0.002;

/// No side branch is shorter, in metres.
const MIN_LENGTH: f64 = 0.06;

/// Radius of either arm of a fork as a share of the stem's: two such cross-sections make up one.
const FORK_THINNING: f64 = 0.75;

/// Radius of an arm at the fork itself: just inside the stem, so that both run into one surface.
const FORK_INSET: f64 = 0.98;

/// Side branches are numbered from here, arms of forks by their segment.
const FIRST_BRANCH: u64 = 1 << 32;

/// A limb that leaves the crown's outline is cut to this share of its length, so many times at most.
const CUT: f64 = 0.92;
const MAX_CUTS: usize = 16;

/// Branches that hang lower than this share of the height of the lowest limb's base are cut too.
const LOWEST: f64 = 0.95;

/// Depth of the hollows in the crown's outline as a share of its radius.
const OUTLINE_DEPTH: f64 = 0.1;

/// Growth of a limb's radius inside its parent, so that it leaves it with a collar.
const COLLAR: f64 = 0.45;

/// How often the twigs' spacing is corrected at most, and the share of triangles that is near enough.
const MAX_FITS: usize = 8;
const FIT_TOLERANCE: f64 = 0.002;

/// A side branch is at most this thick against its parent where it leaves it.
const MAX_SIDE_RADIUS: f64 = 0.85;

/// A point of a stem's axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    pub(super) position: DVec3,
    /// Unit length, towards the tip.
    pub(super) direction: DVec3,
    pub(super) radius: f64,
    /// Metres from the stem's first node.
    pub(super) arc: f64,
    /// Depth of the root ridges as a share of the radius.
    pub(super) ridge: f64,
    /// Share of the stem's side branches that an arm bears, per length: less after each fork.
    share: f64,
}

/// A stem from base to tip.
#[derive(Debug, Clone)]
pub(super) struct Stem {
    pub(super) parent: Option<u32>,
    pub(super) level: usize,
    /// At least two.
    pub(super) nodes: Vec<Node>,
}

impl Stem {
    /// A stem along a chain of points, each with its radius.
    pub(super) fn through(parent: Option<u32>, level: usize, points: &[(DVec3, f64)]) -> Self {
        let mut arc = 0.0;
        let mut nodes: Vec<Node> = Vec::with_capacity(points.len());
        for &(position, radius) in points {
            arc += nodes.last().map_or(0.0, |last| last.position.distance(position));
            nodes.push(Node { position, direction: DVec3::Y, radius, arc, ridge: 0.0, share: 1.0 });
        }
        smooth_directions(&mut nodes);
        if level > 0 {
            // inside its parent a side stem need not lie flat
            nodes[0].direction = (nodes[1].position - nodes[0].position).normalize();
        }
        Self { parent, level, nodes }
    }

    /// Length along the axis.
    pub(super) fn length(&self) -> f64 {
        self.nodes[self.nodes.len() - 1].arc
    }

    /// The axis at a distance from the base, interpolated.
    pub(super) fn at(&self, arc: f64) -> Node {
        let after = self.nodes.partition_point(|node| node.arc <= arc);
        let upper = after.clamp(1, self.nodes.len() - 1);
        let (a, b) = (&self.nodes[upper - 1], &self.nodes[upper]);
        let t = ((arc - a.arc) / (b.arc - a.arc)).clamp(0.0, 1.0);
        Node {
            position: a.position.lerp(b.position, t),
            direction: a.direction.lerp(b.direction, t).normalize(),
            radius: a.radius + (b.radius - a.radius) * t,
            arc,
            ridge: 0.0,
            share: a.share,
        }
    }

    /// Triangles of a tube around it.
    fn triangle_count(&self, species: &Species) -> usize {
        let rings = self.nodes.len() - 1;
        species.levels[self.level].sides * (2 * rings - 1)
    }
}

/// Where and how a stem begins.
struct Start {
    /// Names the stem by its path from the trunk, so that more twigs leave the limbs as they are.
    key: u64,
    parent: Option<u32>,
    level: usize,
    position: DVec3,
    direction: DVec3,
    /// Direction of the first ring where that is another: an arm's lies in its stem's.
    along: Option<DVec3>,
    /// Unit vector across `direction`; bends turn about it.
    hinge: DVec3,
    /// Of the whole stem; the arm of a fork begins part of the way.
    length: f64,
    /// At the base of the whole stem.
    radius: f64,
    /// Segments of the whole stem, and the one it begins with.
    segments: usize,
    first_segment: usize,
    /// See [`Node::share`].
    share: f64,
    /// Radius of the parent where a side branch leaves it; 0 for an arm of a fork.
    parent_radius: f64,
    /// Angle to be bent back over the rest of the arm, in radians.
    recover: f64,
}

/// Grows every stem; a parent stands before its children and a sub-tree before the next sibling.
///
/// Twigs are spaced so that the wood has the species' number of triangles, whatever the seed.
///
/// # Errors
/// [`LodError::Cancelled`].
pub(super) fn grow_stems(species: &Species, seed: u64, job: &Job) -> Result<Vec<Stem>, LodError> {
    let mut stems = grow_to_fit(species, seed, job)?;
    if let Twigs::Foliage(triangle_count) = species.twigs {
        twigs::thin_out(species, &mut stems, twigs::twig_count(triangle_count));
    }
    Ok(stems)
}

fn grow_to_fit(species: &Species, seed: u64, job: &Job) -> Result<Vec<Stem>, LodError> {
    let target = species.stem_triangle_count as f64;
    let mut density = 1.0;
    let mut stems = Vec::new();
    for _ in 0..MAX_FITS {
        stems = grow_at(species, seed, density, job)?;
        let count = |twigs: bool| {
            let of = stems.iter().filter(|stem| (stem.level + 1 == species.levels.len()) == twigs);
            of.map(|stem| stem.triangle_count(species)).sum::<usize>() as f64
        };
        let (limbs, twigs) = (count(false), count(true));
        if (limbs + twigs - target).abs() <= FIT_TOLERANCE * target || twigs == 0.0 {
            break;
        }
        density *= ((target - limbs) / twigs).clamp(0.3, 3.0);
    }
    Ok(stems)
}

fn grow_at(species: &Species, seed: u64, density: f64, job: &Job) -> Result<Vec<Stem>, LodError> {
    let mut trunk = Stream::new(seed, STEM, 0);
    let height = species.trunk.height.at(trunk.signed());
    let mut grower = Grower {
        species,
        seed,
        height,
        twig_density: density,
        stems: Vec::new(),
        fork_debts: vec![0.0; species.levels.len()],
        branch_debts: vec![0.0; species.levels.len()],
        job,
    };
    let start = Start {
        key: 0,
        parent: None,
        level: 0,
        position: DVec3::ZERO,
        direction: DVec3::Y,
        along: None,
        hinge: around_axis(DVec3::Y, DVec3::X, trunk.unit() * std::f64::consts::TAU),
        length: height,
        radius: height * species.trunk.radius,
        segments: segment_count(&species.levels[0], height),
        first_segment: 0,
        share: 1.0,
        parent_radius: 0.0,
        recover: 0.0,
    };
    grower.grow(start)?;
    Ok(grower.stems)
}

struct Grower<'a> {
    species: &'a Species,
    seed: u64,
    height: f64,
    /// Multiplies the number of twigs.
    twig_density: f64,
    stems: Vec<Stem>,
    /// Fractions of forks and side branches owed to a level by the rounding so far, so that their
    /// totals hardly depend on the seed.
    fork_debts: Vec<f64>,
    branch_debts: Vec<f64>,
    job: &'a Job,
}

impl Grower<'_> {
    fn grow(&mut self, mut start: Start) -> Result<(), LodError> {
        self.job.check()?;
        let id = self.stems.len();
        let mut stream = Stream::new(self.seed, STEM, start.key);
        let level = self.species.levels[start.level];
        let room = 1.0 - OUTLINE_DEPTH * stream.unit();
        let fork_debt = self.fork_debts[start.level];
        let full = (start.length, start.radius);
        let mut cuts = 0;
        let (nodes, arms) = loop {
            // bends and forks draw from a stream of their own: a cut stem is the same one, shorter
            let mut bends = Stream::new(self.seed, BENDS, start.key);
            let (nodes, arms) = self.chain(&start, &level, &mut bends, id);
            if cuts == MAX_CUTS || self.fits(&start, &nodes, room) {
                break (nodes, arms);
            }
            cuts += 1;
            self.fork_debts[start.level] = fork_debt;
            start.length *= CUT;
            if start.level > 0 && start.first_segment == 0 {
                start.radius = full.1 * libm::pow(start.length / full.0, level.radius_power);
            }
        };
        self.stems.push(Stem { parent: start.parent, level: start.level, nodes });
        let branches = self.side_branches(&start, id, &mut stream);
        for child in arms.into_iter().chain(branches) {
            self.grow(child)?;
        }
        Ok(())
    }

    /// Whether a stem does not hang below the crown, and a limb or an arm of the trunk keeps inside
    /// the crown's outline, scaled by `room`.
    fn fits(&self, start: &Start, nodes: &[Node], room: f64) -> bool {
        let trunk = start.level == 0 && start.first_segment == 0;
        if trunk || self.species.crown.outline == Outline::Free {
            return true;
        }
        let foot = self.species.levels[1].bare * self.height;
        let reach = self.species.crown.radius * self.height * room;
        let inside = |position: DVec3| {
            if position.y < foot * LOWEST {
                return false;
            }
            let r = (self.height - position.y) / (self.height - foot);
            let across = DVec3::new(position.x, 0.0, position.z).length();
            start.level > 1
                || r >= 0.0 && across <= reach * self.species.crown.limb_share(r.min(1.0))
        };
        nodes[1..].iter().all(|node| inside(node.position))
    }

    /// The nodes of a stem, and where other arms fork off.
    fn chain(
        &mut self,
        start: &Start,
        level: &Level,
        stream: &mut Stream,
        id: usize,
    ) -> (Vec<Node>, Vec<Start>) {
        let segments = start.segments;
        let step = start.length / segments as f64;
        let mut direction = start.direction;
        let mut hinge = start.hinge;
        let mut position = start.position;
        let mut radius = start.radius;
        let mut recover = start.recover;
        let mut nodes = Vec::with_capacity(segments + 1 - start.first_segment);
        let mut arms = Vec::new();
        let mut share = start.share;
        let mut arc = 0.0;
        for segment in start.first_segment..=segments {
            let along = segment as f64 / segments as f64;
            let bare_radius = (radius * (1.0 - level.taper * along)).max(MIN_RADIUS);
            let (flare, ridge) = self.foot(start.level, along);
            let mut node_radius = bare_radius * (1.0 + flare);
            if segment == start.first_segment {
                if start.first_segment > 0 {
                    node_radius *= FORK_INSET / FORK_THINNING;
                } else {
                    node_radius *= 1.0 + self.collar(start);
                }
            }
            nodes.push(Node { position, direction, radius: node_radius, arc, ridge, share });
            if segment == segments {
                break;
            }
            if segment > start.first_segment && along >= level.forks_from && along < 0.9 {
                // forks are due evenly over the part of the stem that may fork
                self.fork_debts[start.level] +=
                    level.forks / (segments as f64 * (0.9 - level.forks_from));
                if self.fork_debts[start.level] >= 0.5 + 0.5 * stream.unit() {
                    self.fork_debts[start.level] -= 1.0;
                    let half = level.fork_angle.at(stream.signed()).to_radians() / 2.0;
                    // forks open sideways, seldom up and down
                    let axis = across(DVec3::Y, direction);
                    let axis = turn(axis, direction, stream.signed() * 1.2);
                    radius *= FORK_THINNING;
                    share *= FORK_THINNING * FORK_THINNING;
                    recover = -half * 0.6;
                    arms.push(Start {
                        key: child_key(start.key, segment as u64),
                        parent: u32::try_from(id).ok(),
                        level: start.level,
                        position,
                        direction: turn(direction, axis, -half).normalize(),
                        along: Some(direction),
                        hinge: axis,
                        length: start.length * (1.0 - 0.12 * stream.unit()),
                        radius,
                        segments,
                        first_segment: segment,
                        share,
                        parent_radius: 0.0,
                        recover: half * 0.6,
                    });
                    direction = turn(direction, axis, half).normalize();
                    hinge = axis;
                }
            }
            let left = (segments - segment) as f64;
            let back = recover / left;
            recover -= back;
            direction = turn(direction, hinge, back).normalize();
            direction = self.bend(direction, &mut hinge, level, along, segments, stream);
            if start.level == 0 && segment == 0 {
                // the flare bends too much for one segment
                for along in [0.2, 0.5] {
                    let (flare, ridge) = self.foot(0, along / segments as f64);
                    let position = position + direction * (step * along);
                    let radius = bare_radius * (1.0 + flare);
                    let arc = arc + step * along;
                    nodes.push(Node { position, direction, radius, arc, ridge, share });
                }
            }
            if segment == 0 && self.collar(start) > 0.0 {
                // just outside the parent the collar is half gone
                let along = (1.4 * start.parent_radius / step).clamp(0.1, 0.6);
                let radius = bare_radius * (1.0 + 0.3 * self.collar(start));
                let arc = arc + step * along;
                let position = position + direction * (step * along);
                nodes.push(Node { position, direction, radius, arc, ridge: 0.0, share });
            }
            position += direction * step;
            arc += step;
        }
        smooth_directions(&mut nodes);
        if let Some(along) = start.along {
            nodes[0].direction = along;
        }
        (nodes, arms)
    }

    /// Growth of the radius and depth of the ridges where the trunk meets its roots, as shares of
    /// the radius.
    fn foot(&self, level: usize, along: f64) -> (f64, f64) {
        if level > 0 || along > 0.25 {
            return (0.0, 0.0);
        }
        // the paper's flare: nearly gone at an eighth of the height
        let share = libm::pow(100.0, -8.0 * along);
        (self.species.trunk.flare * share, self.species.trunk.lobes.1 * share.sqrt())
    }

    /// Growth of a stem's radius at its base, as a share; thin stems need none.
    fn collar(&self, start: &Start) -> f64 {
        if start.level != 1 || start.parent_radius == 0.0 {
            return 0.0;
        }
        // never so wide that it looks out of the parent's other side
        COLLAR.min(MAX_SIDE_RADIUS * start.parent_radius / start.radius - 1.0).max(0.0)
    }

    /// The direction of the next segment.
    fn bend(
        &self,
        direction: DVec3,
        hinge: &mut DVec3,
        level: &Level,
        along: f64,
        segments: usize,
        stream: &mut Stream,
    ) -> DVec3 {
        let first_half = along < 0.5;
        let share = 1.0 / segments as f64;
        let curve = if first_half { level.curve.0 } else { level.curve.1 };
        let planned = curve.to_radians() * 2.0 * share;
        // independent bends add up like a random walk, so each is the whole one over the root
        let chance = level.curve_spread.to_radians() * share.sqrt();
        *hinge = across(*hinge, direction);
        let mut bent = turn(direction, *hinge, planned + chance * stream.signed());
        bent = turn(bent, across(hinge.cross(bent), bent), chance * stream.signed()).normalize();
        let upward = if first_half { level.upward.0 } else { level.upward.1 };
        let horizontal = (1.0 - bent.y * bent.y).max(0.0).sqrt();
        if horizontal > 1e-6 {
            let angle = upward.to_radians() * 2.0 * share * horizontal;
            bent = turn(bent, level_side(bent), angle).normalize();
        }
        bent
    }

    /// Where side branches of a finished stem begin.
    fn side_branches(&mut self, start: &Start, id: usize, stream: &mut Stream) -> Vec<Start> {
        let Some(&child) = self.species.levels.get(start.level + 1) else {
            return Vec::new();
        };
        let stem = self.stems[id].clone();
        let begun = start.length - stem.length();
        let bare = (child.bare * start.length - begun).max(0.0);
        // length that bears, weighted with the shares of the arms of forks
        let weights: Vec<f64> = stem
            .nodes
            .windows(2)
            .map(|pair| (pair[1].arc - pair[0].arc.max(bare)).max(0.0) * pair[0].share)
            .collect();
        let weight: f64 = weights.iter().sum();
        let twigs = start.level + 2 == self.species.levels.len();
        let spacing = child.spacing / if twigs { self.twig_density } else { 1.0 };
        let exact = weight / spacing + self.branch_debts[start.level + 1];
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few dozen")]
        let count = exact.round().max(0.0) as usize;
        self.branch_debts[start.level + 1] = exact - count as f64;
        let mut around = if start.level == 0 { stream.unit() * 360.0 } else { 0.0 };
        let mut starts = Vec::with_capacity(count);
        let whorls = count.div_ceil(child.whorl);
        for number in 0..count {
            let jitter = child.jitter * stream.signed();
            let whorl = (number / child.whorl) as f64;
            let mut left = weight * (whorl + 0.5 + jitter) / whorls as f64;
            let segment = weights.iter().position(|&here| {
                let inside = left < here;
                if !inside {
                    left -= here;
                }
                inside
            });
            let arc = segment.map_or(stem.length(), |segment| {
                let node = &stem.nodes[segment];
                node.arc.max(bare) + left / node.share
            });
            // metres from the base of the whole stem, of which a fork's arm is the upper part
            let offset = begun + arc;
            let node = stem.at(arc);
            let along = offset / start.length;
            let turn = if number.is_multiple_of(child.whorl) {
                child.around
            } else {
                Vary { mean: 360.0 / child.whorl as f64, ..child.around }
            };
            around += turn.at(stream.signed());
            let (low, high) = child.down;
            let down = low + (high - low) * along + child.down_spread * stream.signed();
            let length = child.length.at(stream.signed())
                * if start.level == 0 {
                    let crown_share = (1.0 - along) / (1.0 - child.bare);
                    self.height * self.species.crown.limb_share(crown_share)
                } else {
                    start.length - 0.6 * offset
                };
            if length < MIN_LENGTH {
                continue;
            }
            let side = level_side(node.direction);
            let outward = around_axis(node.direction, side, around.to_radians());
            let thick = start.radius * libm::pow(length / start.length, child.radius_power);
            starts.push(Start {
                key: child_key(start.key, FIRST_BRANCH + number as u64),
                parent: u32::try_from(id).ok(),
                level: start.level + 1,
                position: node.position,
                direction: side_direction(
                    node.direction,
                    side,
                    around.to_radians(),
                    down.to_radians(),
                ),
                along: None,
                hinge: node.direction.cross(outward).normalize(),
                length,
                radius: thick.min(node.radius * MAX_SIDE_RADIUS * 0.85).max(MIN_RADIUS),
                segments: segment_count(&child, length),
                first_segment: 0,
                share: 1.0,
                parent_radius: node.radius,
                recover: 0.0,
            });
        }
        starts
    }
}

/// The key of a stem's child, which no other stem has.
fn child_key(parent: u64, number: u64) -> u64 {
    Stream::new(parent, CHILD, number).next_u64()
}

/// Segments of a whole stem.
fn segment_count(level: &Level, length: f64) -> usize {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few dozen")]
    let wanted = (length / level.segment_length).round() as usize;
    wanted.clamp(2, level.max_segments)
}

/// Turns each inner node's direction from that of the segment above it to the mean of both.
fn smooth_directions(nodes: &mut [Node]) {
    let segment: Vec<DVec3> =
        nodes.windows(2).map(|pair| (pair[1].position - pair[0].position).normalize()).collect();
    let last = nodes.len() - 1;
    // the foot keeps its own, so that the trunk stands flat on the ground
    for (i, node) in nodes.iter_mut().enumerate().skip(1) {
        node.direction =
            if i == last { segment[i - 1] } else { (segment[i - 1] + segment[i]).normalize() };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::grow::presets::trees;

    /// Distance from a point to a stem's axis.
    fn distance(stem: &Stem, point: DVec3) -> f64 {
        let to_segment = |pair: &[Node]| {
            let (a, b) = (pair[0].position, pair[1].position);
            let t = (point - a).dot(b - a) / a.distance_squared(b);
            point.distance(a.lerp(b, t.clamp(0.0, 1.0)))
        };
        stem.nodes.windows(2).map(to_segment).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn every_stem_begins_inside_its_parent() {
        for species in trees() {
            let stems = grow_stems(species, 1, &Job::default()).expect("not cancelled");
            for stem in &stems[1..] {
                let parent = &stems[stem.parent.expect("only the trunk has none") as usize];
                let base = &stem.nodes[0];
                assert!(distance(parent, base.position) < 1e-9, "{}: on the axis", species.name);
                let widest = parent.nodes.iter().map(|node| node.radius).fold(0.0, f64::max);
                assert!(base.radius <= widest.max(MIN_RADIUS), "{}: not thicker", species.name);
            }
        }
    }

    #[test]
    fn stems_taper_and_their_arcs_are_lengths() {
        for species in trees() {
            for stem in grow_stems(species, 1, &Job::default()).expect("not cancelled") {
                let mut length = 0.0;
                for pair in stem.nodes.windows(2) {
                    length += pair[0].position.distance(pair[1].position);
                    assert!((pair[1].arc - length).abs() < 1e-9, "{}: arc", species.name);
                    assert!(pair[1].radius <= pair[0].radius, "{}: taper", species.name);
                }
            }
        }
    }

    #[test]
    fn more_twigs_leave_the_limbs_as_they_are() {
        for species in trees() {
            let limbs = |density| {
                let grown = grow_at(species, 1, density, &Job::default());
                let mut stems = grown.expect("not cancelled");
                stems.retain(|stem| stem.level + 1 < species.levels.len());
                stems.iter().map(|stem| stem.nodes[1].position).collect::<Vec<_>>()
            };
            assert_eq!(limbs(0.5), limbs(2.0), "{}", species.name);
        }
    }
}
