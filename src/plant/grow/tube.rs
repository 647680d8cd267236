//! Wood: one closed tube of triangles around each stem.
//!
//! A tube is a ring of corners at every node and a single corner at the tip. It begins on its
//! parent's axis, so the joint lies inside the parent; only the trunk's foot, on the ground, is
//! open. Rings are carried along without twist, and normals lean with the taper.

use std::ops::Range;

use glam::{DVec3, Vec2, Vec3, Vec4};

use crate::plant::Mesh;
use crate::plant::grow::params::{Bark, Species};
use crate::plant::grow::skeleton::{Node, Stem};
use crate::plant::grow::turn::{across, level_side};
use crate::random::{Purpose, Stream};

const BARK: Purpose = Purpose::named("grow.bark");

/// The wood of a plant and each stem's range of triangles, in the order of the stems.
pub(super) fn wood(species: &Species, seed: u64, stems: &[Stem]) -> (Mesh, Vec<Range<u32>>) {
    let mut mesh = Mesh::default();
    let ranges = stems
        .iter()
        .enumerate()
        .map(|(id, stem)| {
            let first = wood_index(mesh.triangles.len());
            if !species.is_foliage(stem.level) {
                let stream = Stream::new(seed, BARK, id as u64);
                let sides = species.levels[stem.level].sides;
                add_tube(sides, species.trunk.lobes.0, &species.bark, stem, stream, &mut mesh);
            }
            first..wood_index(mesh.triangles.len())
        })
        .collect();
    mesh.uvs = vec![Vec2::ZERO; mesh.positions.len()];
    (mesh, ranges)
}

/// Adds the tube of one stem; its triangles follow the mesh's.
pub(super) fn add_tube(
    sides: usize,
    ridge_count: f64,
    colors: &Bark,
    stem: &Stem,
    mut stream: Stream,
    mesh: &mut Mesh,
) {
    let first = mesh.positions.len();
    let (tip, rings) = stem.nodes.split_last().expect("a stem has at least two nodes");
    let mut side = level_side(stem.nodes[0].direction);
    for (i, node) in rings.iter().enumerate() {
        side = across(side, node.direction);
        let lean = slope(&stem.nodes, i);
        for corner in 0..sides {
            let angle = std::f64::consts::TAU * corner as f64 / sides as f64;
            let (sin, cos) = (libm::sin(angle), libm::cos(angle));
            let outward = side * cos + node.direction.cross(side) * sin;
            let ridge = 1.0 + node.ridge * libm::cos(angle * ridge_count);
            mesh.positions.push((node.position + outward * (node.radius * ridge)).as_vec3());
            mesh.normals.push((outward - node.direction * lean).normalize().as_vec3());
            mesh.base.push(bark(colors, node.radius, &mut stream));
        }
    }
    mesh.positions.push(tip.position.as_vec3());
    mesh.normals.push(tip.direction.as_vec3());
    mesh.base.push(bark(colors, tip.radius, &mut stream));

    let corner = |ring: usize, side: usize| wood_index(first + ring * sides + side % sides);
    for ring in 1..rings.len() {
        for side in 0..sides {
            let low = [corner(ring - 1, side), corner(ring - 1, side + 1)];
            let high = [corner(ring, side), corner(ring, side + 1)];
            mesh.triangles.push([low[0], low[1], high[1]]);
            mesh.triangles.push([low[0], high[1], high[0]]);
        }
    }
    let apex = wood_index(first + rings.len() * sides);
    for side in 0..sides {
        let last = rings.len() - 1;
        mesh.triangles.push([corner(last, side), corner(last, side + 1), apex]);
    }
}

/// Change of the radius along the axis at a ring.
fn slope(nodes: &[Node], ring: usize) -> f64 {
    let (below, above) = (&nodes[ring.saturating_sub(1)], &nodes[ring + 1]);
    let above_radius = if ring + 2 == nodes.len() { 0.0 } else { above.radius };
    (above_radius - below.radius) / (above.arc - below.arc)
}

/// The colour of a corner: young bark on thin wood, old bark from a few centimetres on.
fn bark(bark: &Bark, radius: f64, stream: &mut Stream) -> Vec4 {
    let age = (radius / 0.04).min(1.0).sqrt();
    let color = DVec3::from(bark.young).lerp(DVec3::from(bark.old), age);
    let color = (color * (1.0 + bark.spread * stream.signed())).as_vec3();
    color.min(Vec3::ONE).extend(1.0)
}

/// An index into an array that [`Mesh::check`] holds to the range of u32.
pub(super) fn wood_index(count: usize) -> u32 {
    u32::try_from(count).expect("presets are far below the limit of indices")
}
