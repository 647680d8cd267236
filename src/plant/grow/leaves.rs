//! Leaves: where along the twigs they sit, how they are turned, and their triangles.
//!
//! Leaves are shared out over all leafy wood by its length, to the exact number asked for, and the
//! outermost leaf of a twig sits on its tip. Each leaf depends on the seed, its place and its index
//! only, so they are built in parallel with the same result on any number of threads.

use glam::{DVec3, Vec2, Vec3, Vec4};
use rayon::prelude::*;

use crate::error::LodError;
use crate::job::Job;
use crate::plant::Mesh;
use crate::plant::grow::blade::{Pose, Vertices};
use crate::plant::grow::params::{Species, bulge};
use crate::plant::grow::skeleton::Stem;
use crate::plant::grow::turn::{across, around_axis, level_side, side_direction};
use crate::random::{Purpose, Stream};

/// Where along a twig its longest leaves sit, if they differ.
const LONGEST_LEAF: f64 = 0.4;

const LEAF: Purpose = Purpose::named("grow.leaf");

/// Leaves per rayon job: half a millisecond.
const LEAVES_PER_JOB: usize = 512;

/// Where a leaf sits.
#[derive(Debug, Clone, Copy)]
struct Site {
    stem: u32,
    /// Distance from the stem's base.
    arc: f64,
    /// Azimuth about the stem in radians.
    around: f64,
    /// Share of the leafy part below it, in [0, 1].
    along: f64,
}

/// The ellipsoid that the leafy wood fills.
struct Crown {
    center: DVec3,
    half_size: DVec3,
}

/// The foliage's triangles, `blade.triangles.len()` a leaf, and each leaf's stem.
///
/// # Errors
/// [`LodError::Cancelled`].
pub(super) fn leaves(
    species: &Species,
    seed: u64,
    stems: &[Stem],
    count: usize,
    job: &Job,
) -> Result<(Mesh, Vec<u32>), LodError> {
    let crown = Crown::around(species, stems);
    let sites = sites(species, seed, stems, count, job)?;
    // more leaves than usual are smaller ones: the crown keeps its leaf area and its gaps
    let scale = (species.leaves.count as f64 / count as f64).min(1.0).sqrt();
    let blade = species.leaves.blade;
    let per_leaf = blade.vertices.len();

    let mut mesh = Mesh {
        positions: job.collect(count * per_leaf, |_| Vec3::ZERO)?,
        normals: job.collect(count * per_leaf, |_| Vec3::ZERO)?,
        uvs: job.collect(count * per_leaf, |_| Vec2::ZERO)?,
        base: job.collect(count * per_leaf, |_| Vec4::ONE)?,
        ..Mesh::default()
    };
    let outputs = (
        mesh.positions.par_chunks_mut(per_leaf * LEAVES_PER_JOB),
        mesh.normals.par_chunks_mut(per_leaf * LEAVES_PER_JOB),
        mesh.uvs.par_chunks_mut(per_leaf * LEAVES_PER_JOB),
        mesh.base.par_chunks_mut(per_leaf * LEAVES_PER_JOB),
    );
    job.begin(count as u64);
    let parts = sites.par_chunks(LEAVES_PER_JOB).enumerate();
    (parts, outputs.0, outputs.1, outputs.2, outputs.3).into_par_iter().try_for_each(
        |((part, sites), positions, normals, uvs, base)| {
            job.check()?;
            for (i, site) in sites.iter().enumerate() {
                let stream = Stream::new(seed, LEAF, (part * LEAVES_PER_JOB + i) as u64);
                let here = i * per_leaf..(i + 1) * per_leaf;
                let out = Vertices {
                    positions: &mut positions[here.clone()],
                    normals: &mut normals[here.clone()],
                    uvs: &mut uvs[here.clone()],
                    base: &mut base[here],
                };
                fill(out, species, &stems[site.stem as usize], site, &crown, scale, stream);
            }
            job.advance_by(sites.len());
            Ok::<_, LodError>(())
        },
    )?;
    let per_blade = blade.triangles.len();
    mesh.triangles = job.collect(count * per_blade, |triangle| {
        let first = triangle / per_blade * per_leaf;
        blade.triangles[triangle % per_blade].map(|corner| {
            u32::try_from(first + usize::from(corner)).expect("the leaf limit keeps to u32")
        })
    })?;
    Ok((mesh, job.collect(count, |leaf| sites[leaf].stem)?))
}

/// Puts a leaf where it belongs.
fn fill(
    out: Vertices<'_>,
    species: &Species,
    stem: &Stem,
    site: &Site,
    crown: &Crown,
    scale: f64,
    mut stream: Stream,
) {
    let leaves = &species.leaves;
    let node = stem.at(site.arc);
    let side = level_side(node.direction);
    let (low, high) = leaves.down;
    let down = low + (high - low) * site.along + leaves.down_spread * stream.signed();
    let outward = around_axis(node.direction, side, site.around);
    let mut direction = side_direction(node.direction, side, site.around, down.to_radians());
    direction -= DVec3::Y * leaves.droop.at(stream.signed()).max(0.0);
    let direction = direction.try_normalize().unwrap_or(outward);

    let (up, out_share, any) = leaves.facing;
    let anywhere = DVec3::new(stream.signed(), stream.signed(), stream.signed());
    let facing = DVec3::Y * up + crown.outward(node.position) * out_share + anywhere * any;
    let normal = across(facing, direction);

    let share = bulge(site.along, LONGEST_LEAF, leaves.ends);
    let full = leaves.length.at(stream.signed()) * share;
    let length = full * scale;
    // a small leaf of a dense crown stands anywhere in the room of a full-size one
    let room = (full - length) * stream.unit();
    let foot = node.position + outward * node.radius.min(length) + direction * room;
    let curl = leaves.curl.at(stream.signed());

    // squaring keeps most leaves near the main colour
    let other = stream.unit();
    let color = DVec3::from(leaves.color).lerp(DVec3::from(leaves.other_color), other * other);
    let light = leaves.inner + (1.0 - leaves.inner) * crown.depth(node.position);
    let color = color * (light * (1.0 + leaves.spread * stream.signed()));
    leaves.blade.write(&Pose { foot, direction, normal, length, curl }, color, out);
}

impl Crown {
    fn around(species: &Species, stems: &[Stem]) -> Self {
        let mut low = DVec3::INFINITY;
        let mut high = DVec3::NEG_INFINITY;
        for stem in stems {
            let bare = bare_length(species, stem);
            for arc in [bare, stem.length()] {
                let position = stem.at(arc).position;
                low = low.min(position);
                high = high.max(position);
            }
        }
        Self { center: (low + high) * 0.5, half_size: ((high - low) * 0.5).max(DVec3::splat(1e-3)) }
    }

    /// Unit vector away from the middle.
    fn outward(&self, position: DVec3) -> DVec3 {
        ((position - self.center) / self.half_size).normalize_or_zero()
    }

    /// 0 in the middle, 1 on the rim, rising towards it.
    fn depth(&self, position: DVec3) -> f64 {
        ((position - self.center) / self.half_size).length_squared().min(1.0)
    }
}

/// Length of a stem below its leaves.
fn bare_length(species: &Species, stem: &Stem) -> f64 {
    if stem.level + 1 == species.levels.len() {
        stem.length() * species.leaves.bare
    } else {
        (stem.length() - species.leaves.end).max(0.0)
    }
}

/// Shares `count` leaves out over the leafy wood, by length.
fn sites(
    species: &Species,
    seed: u64,
    stems: &[Stem],
    count: usize,
    job: &Job,
) -> Result<Vec<Site>, LodError> {
    const SITE: Purpose = Purpose::named("grow.site");
    let ends: Vec<f64> = stems
        .iter()
        .scan(0.0, |sum, stem| {
            *sum += stem.length() - bare_length(species, stem);
            Some(*sum)
        })
        .collect();
    let total = ends[ends.len() - 1];
    let mut sites = Vec::with_capacity(count);
    for (id, (stem, end)) in stems.iter().zip(&ends).enumerate() {
        // rounding the running sum makes the last one exactly `count`
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most count"
        )]
        let until = (end / total * count as f64).round() as usize;
        let here = until - sites.len();
        if here == 0 {
            continue;
        }
        let mut stream = Stream::new(seed, SITE, id as u64);
        let bare = bare_length(species, stem);
        let leafy = stem.length() - bare;
        let whorls = here.div_ceil(species.leaves.whorl);
        let anywhere = stream.unit() * 360.0;
        let mut around = species.leaves.first.unwrap_or(anywhere);
        for whorl in 0..whorls {
            job.check()?;
            // the topmost whorl is the one on the tip, and the one that is always full
            let from_tip = whorls - 1 - whorl;
            let jitter = if from_tip == 0 { 0.0 } else { 0.4 * stream.signed() };
            let along = 1.0 - (from_tip as f64 + jitter) / whorls as f64;
            around += species.leaves.around.at(stream.signed());
            let left = until - sites.len();
            let size = left - (from_tip * species.leaves.whorl).min(left);
            for leaf in 0..size {
                let turn = around + 360.0 * leaf as f64 / size as f64;
                sites.push(Site {
                    stem: u32::try_from(id).expect("stems are few"),
                    arc: bare + leafy * along,
                    around: turn.to_radians(),
                    along,
                });
            }
        }
    }
    Ok(sites)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::grow::presets::trees;
    use crate::plant::grow::skeleton::grow_stems;

    #[test]
    fn leaves_are_shared_out_by_length() {
        for species in trees() {
            let job = Job::default();
            let stems = grow_stems(species, 1, &job).expect("not cancelled");
            for count in [1, 2, 7, species.leaves.count] {
                let sites = sites(species, 1, &stems, count, &job).expect("not cancelled");
                assert_eq!(sites.len(), count, "{}", species.name);
            }
            let count = species.leaves.count;
            let sites = sites(species, 1, &stems, count, &job).expect("not cancelled");
            let leafy = |stem: &Stem| stem.length() - bare_length(species, stem);
            let total: f64 = stems.iter().map(leafy).sum();
            for (id, stem) in stems.iter().enumerate() {
                let here = sites.iter().filter(|site| site.stem as usize == id).count();
                let due = leafy(stem) / total * species.leaves.count as f64;
                assert!((here as f64 - due).abs() < 1.0 + 1e-6, "{here} leaves for {due}");
            }
        }
    }

    #[test]
    fn no_leaf_floats_and_no_twig_is_bare() {
        for species in trees() {
            let job = Job::default();
            let stems = grow_stems(species, 1, &job).expect("not cancelled");
            let count = species.leaves.count;
            let grown = leaves(species, 1, &stems, count, &job);
            let (mesh, owners) = grown.expect("not cancelled");
            let sites = sites(species, 1, &stems, count, &job).expect("not cancelled");
            let per_leaf = species.leaves.blade.vertices.len();
            for (leaf, site) in sites.iter().enumerate() {
                // a blade's first vertex is where it is fixed
                let foot = mesh.positions[leaf * per_leaf].as_dvec3();
                let node = stems[site.stem as usize].at(site.arc);
                let gap = foot.distance(node.position) - node.radius;
                assert!(gap < 1e-5, "{}: leaf {leaf} is {gap} m away", species.name);
            }
            let mut leafy = owners.clone();
            leafy.dedup();
            // the trunk of a palm is
            let share = leafy.len() as f64 / (stems.len() - 1) as f64;
            assert!(share > 0.99, "{}: only {share} of the stems bear leaves", species.name);
        }
    }
}
