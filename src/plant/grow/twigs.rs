//! Twigs that are foliage: a folded strip each, as sparse as a leaf.
//!
//! Jakulin (2000) counts twigs with the leaves: solid wood is what a mesh simplifier can reduce,
//! and a twig cannot become less than a triangle. Each twig is an element of the foliage of its
//! own, followed by the leaves that grow on it.

use glam::DVec3;

use crate::error::LodError;
use crate::job::Job;
use crate::plant::Mesh;
use crate::plant::grow::blade::Elements;
use crate::plant::grow::params::{Species, Twigs};
use crate::plant::grow::skeleton::Stem;
use crate::plant::grow::turn::{across, level_side};

/// A roof over the twig's axis, bent once: left, ridge and right at the foot and half way, and the
/// tip. The first triangle can be spared: the strip then begins with a point on the left.
const TRIANGLES: [[u8; 3]; 6] = [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [3, 4, 6], [4, 5, 6]];

/// How many twigs have so many triangles.
pub(super) fn twig_count(triangle_count: usize) -> usize {
    triangle_count.div_ceil(TRIANGLES.len())
}

/// Elements of the foliage that are no leaves.
pub(super) fn element_count(species: &Species) -> usize {
    match species.twigs {
        Twigs::Wood => 0,
        Twigs::Foliage(triangle_count) => twig_count(triangle_count),
    }
}

/// Drops twigs, evenly over the plant, until `count` are left.
///
/// # Panics
/// If there are fewer: a preset must ask for stems enough.
pub(super) fn thin_out(species: &Species, stems: &mut Vec<Stem>, count: usize) {
    let is_twig = |stem: &Stem| species.is_foliage(stem.level);
    let all = stems.iter().filter(|stem| is_twig(stem)).count();
    assert!(all >= count, "{}: {all} twigs of {count}", species.name);
    let mut seen = 0;
    let mut new_ids = Vec::with_capacity(stems.len());
    let mut next = 0;
    stems.retain(|stem| {
        let keep = if is_twig(stem) {
            seen += 1;
            seen * count / all > (seen - 1) * count / all
        } else {
            true
        };
        new_ids.push(next);
        next += u32::from(keep);
        keep
    });
    for stem in stems {
        stem.parent = stem.parent.map(|parent| new_ids[parent as usize]);
    }
}

/// The twigs of a plant and its leaves, stem by stem.
///
/// # Errors
/// [`LodError::Cancelled`].
pub(super) fn with_leaves(
    species: &Species,
    stems: &[Stem],
    leaves: &Mesh,
    owners: &[u32],
    job: &Job,
) -> Result<Elements, LodError> {
    let mut twigs = Elements::new();
    let wanted = match species.twigs {
        Twigs::Wood => 0,
        Twigs::Foliage(triangle_count) => triangle_count,
    };
    let mut spared = element_count(species) * TRIANGLES.len() - wanted;
    let mut next_leaf = 0;
    for (id, stem) in (0_u32..).zip(stems) {
        if species.is_foliage(stem.level) {
            add_twig(&mut twigs, id, species, stem, spared > 0);
            spared = spared.saturating_sub(1);
        }
        while owners.get(next_leaf) == Some(&id) {
            job.check()?;
            twigs.copy(id, &species.leaves.blade, leaves, next_leaf);
            next_leaf += 1;
        }
    }
    Ok(twigs)
}

fn add_twig(out: &mut Elements, id: u32, species: &Species, stem: &Stem, spare: bool) {
    let mut points = Vec::with_capacity(7);
    let mut side = level_side(stem.nodes[0].direction);
    for share in [0.0, 0.5] {
        let node = stem.at(stem.length() * share);
        // carried along: the level side of a steep twig may jump to the other side
        side = across(side, node.direction);
        let up = side.cross(node.direction);
        points.extend([-side, up, side].map(|corner| node.position + corner * node.radius));
    }
    points.push(stem.nodes[stem.nodes.len() - 1].position);
    let triangles = if spare { &TRIANGLES[1..] } else { &TRIANGLES[..] };
    let color = DVec3::from(species.bark.young);
    out.push_points(id, &points, triangles, DVec3::Y, std::iter::repeat(color));
}
