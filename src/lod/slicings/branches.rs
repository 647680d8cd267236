//! The branches of a plant whose structure is known, each as a crown with one slicing of its own.
//!
//! A branch is flat, or at least flatter than the crown: its slices lie across the direction in which
//! its leaves spread least, so that few of them keep its leaves near their places.
//!
//! This work is based on:
//! Aleks Jakulin. Interactive Vegetation Rendering with Slicing and Blending. 2000 (section 4)

use std::ops::Range;

use glam::{DMat3, DVec3};

use crate::error::LodError;
use crate::job::Job;
use crate::lod::eigen::smallest_eigenvector;
use crate::lod::leaves::Leaves;
use crate::lod::view_blend::ViewBlend;

/// The crowns of all branches of a generation, with everything that grows on them, and of what grows on
/// branches before it; each with the direction of its slicing and its name.
///
/// # Errors
/// [`LodError::Invalid`] under `branch_level` if the plant's structure is not known;
/// [`LodError::Cancelled`].
pub(super) fn crowns<'a>(
    leaves: &Leaves<'a>,
    level: u32,
    job: &Job,
) -> Result<Vec<(Leaves<'a>, ViewBlend, String)>, LodError> {
    let Some(structure) = &leaves.plant.structure else {
        let why = "needs a plant whose branches are known: a grown one".to_owned();
        return Err(LodError::Invalid { name: "branch_level", why });
    };
    let branches = &structure.branches;
    let mut ranges: Vec<(usize, Range<u32>)> = Vec::new();
    let mut branch = 0;
    while branch < branches.len() {
        let own = branches[branch].leaves.clone();
        // branches are stored depth first, and leaves in their order
        let after = if branches[branch].level < level {
            ranges.push((branch, own));
            branch + 1
        } else {
            let inside = structure.subtree(branch);
            let end = branches[inside.end - 1].leaves.end;
            ranges.push((branch, own.start..end));
            inside.end
        };
        branch = after;
    }
    let crowns =
        ranges.into_iter().filter(|(_, range)| !range.is_empty()).map(|(branch, range)| {
            job.check()?;
            let chosen: Vec<usize> = range.map(|leaf| leaf as usize).collect();
            let crown = leaves.chosen(&chosen);
            let outward = crown.center - leaves.center;
            let direction = flattest(&crown.leaf_centers, outward);
            let blend = ViewBlend::new(&[direction], None).expect("one unit vector");
            Ok((crown, blend, format!("branch {branch}, slicing")))
        });
    crowns.collect()
}

/// The direction in which points spread least, on the side of another direction; that direction where
/// they do not spread at all.
fn flattest(points: &[DVec3], outward: DVec3) -> DVec3 {
    let mean = points.iter().sum::<DVec3>() / points.len() as f64;
    let mut spread = DMat3::ZERO;
    for &point in points {
        let d = point - mean;
        spread += DMat3::from_cols(d * d.x, d * d.y, d * d.z);
    }
    let fallback = outward.try_normalize().unwrap_or(DVec3::Z);
    if spread == DMat3::ZERO {
        return fallback;
    }
    let (_, direction) = smallest_eigenvector(&spread);
    if direction.dot(outward) < 0.0 { -direction } else { direction }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slices_lie_across_the_flattest_direction() {
        // a sheet across y, a little bent
        let sheet: Vec<DVec3> = [(0, 0), (1, 0), (0, 2), (1, 2), (2, 1)]
            .into_iter()
            .map(|(x, z)| DVec3::new(f64::from(x), 0.01 * f64::from(x * z), f64::from(z)))
            .collect();
        assert!(flattest(&sheet, DVec3::NEG_Y).y < -0.99, "towards the outside");
        assert!(flattest(&sheet, DVec3::Y).y > 0.99, "on either side");
        let alone = flattest(&[DVec3::ONE; 3], DVec3::X * 4.0);
        assert_eq!(alone, DVec3::X, "a single place is seen from outside");
        assert_eq!(flattest(&[DVec3::ONE], DVec3::ZERO), DVec3::Z, "or from anywhere");
    }
}
