//! The arrays that are drawn: groups of pieces, each with its triangles, points and lines in one order.
//!
//! A group holds the pieces of one cell, part and class; pieces that become lines are also told apart
//! by the power of two below their deviation, since a group is drawn as lines only where the worst of
//! them may be. Inside a group triangles are in random order, points in the same (see
//! [`PairOrder`]), and so are pieces and their lines: what is drawn is
//! always a prefix.

use std::ops::Range;
use std::sync::Arc;

use glam::{DVec3, Vec2};
use rayon::prelude::*;

use crate::draw_list::{Buffers, Geometry};
use crate::error::LodError;
use crate::job::Job;
use crate::lod::points_and_lines::lines::{Line, line, reach};
use crate::lod::points_and_lines::octree::Cells;
use crate::lod::points_and_lines::opaque::Cover;
use crate::lod::points_and_lines::parts::{Class, Part};
use crate::lod::points_and_lines::pieces::{Form, Piece};
use crate::lod::points_and_lines::sampling::{
    ORDER, POINT_ORDER, Splat, automatic, by_area, permutation, splats,
};
use crate::lod::points_and_lines::selection::{POINTS_PER_TRIANGLE, PairOrder, Sampling};
use crate::plant::mesh::triangle_area;
use crate::plant::{Material, Mesh};

/// Triangles between two looks at the job while points are drawn from textures.
const TRIANGLES_PER_CHECK: usize = 2048;

/// Pieces of one cell, part and class.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// Which part.
    pub part: u32,
    /// Which cell of the octree.
    pub cell: u32,
    /// What it is drawn as where it is small.
    pub class: Class,
    /// How its points were chosen.
    pub sampling: Sampling,
    /// In the index buffer of triangles; those that can become points come first.
    pub triangles: Range<u32>,
    /// How many of them can become points: those that are opaque anywhere.
    pub opaque_count: u32,
    /// In the index buffer of points: two for each of these.
    pub points: Range<u32>,
    /// In the index buffer of lines: one a piece.
    pub lines: Range<u32>,
    /// In [`Groups::piece_ends`]: one a piece of a group of lines.
    pub piece_ends: Range<usize>,
    /// Mean projected area over all directions in square metres: a share of the opaque area.
    pub seen_area: f64,
    /// Of all lines together, in metres.
    pub line_length: f64,
    /// Largest distance of a vertex from its piece's line, in metres.
    pub deviation: f64,
    /// Mean of its surface, relative to the plant's origin.
    pub center: DVec3,
    /// Largest distance of a vertex from there.
    pub radius: f64,
    /// For rounding: in [0, 1), spread evenly over the groups.
    pub offset: f64,
}

/// All groups of a plant, with the arrays that they share.
#[derive(Debug)]
pub struct Groups {
    /// By cell, part, class and deviation.
    pub groups: Vec<Group>,
    /// Triangles of wood and leaves.
    pub triangles: Arc<Geometry>,
    /// All groups' points.
    pub points: Arc<Geometry>,
    /// All groups' lines.
    pub lines: Arc<Geometry>,
    /// Triangles of a group up to the end of each of its pieces.
    pub piece_ends: Vec<u32>,
}

/// What groups are made of.
pub struct Input<'a> {
    /// Wood and leaves, joined.
    pub mesh: &'a Mesh,
    /// What the "ids" output shows for each of its triangles.
    pub source_ids: &'a [u32],
    /// The plant's.
    pub materials: &'a [Material],
    /// Of the mesh.
    pub pieces: &'a [Piece],
    /// One a piece.
    pub forms: &'a [Form],
    /// Of the plant.
    pub parts: &'a [Part],
    /// One a piece.
    pub part_of: &'a [u32],
    /// Of the pieces.
    pub cells: &'a Cells,
    /// Towards the sun.
    pub sun: DVec3,
    /// How points are chosen; `None` decides for each group.
    pub sampling: Option<Sampling>,
    /// Which points belong to a triangle.
    pub pair_order: PairOrder,
    /// Of every random choice.
    pub seed: u64,
}

/// Pieces that form a group.
struct Members {
    part: u32,
    cell: u32,
    class: Class,
    pieces: Vec<u32>,
}

impl Groups {
    /// Makes all groups.
    ///
    /// # Errors
    /// [`LodError::Cancelled`].
    pub fn new(input: &Input<'_>, job: &Job) -> Result<Self, LodError> {
        let members = members(input);
        let count = members.iter().map(|m| m.pieces.len()).sum::<usize>();
        job.begin(count as u64);
        let covers: Vec<Cover<'_>> = input.materials.iter().map(Cover::new).collect();
        let mut making = Making {
            input,
            covers: &covers,
            indices: Vec::new(),
            ids: Vec::new(),
            points: Buffers::default(),
            lines: Buffers::default(),
            piece_ends: Vec::new(),
        };
        let mut groups = Vec::with_capacity(members.len());
        for (number, members) in (0_u64..).zip(&members) {
            job.check()?;
            groups.push(making.group(number, members, job)?);
            job.advance_by(members.pieces.len());
        }
        let mesh = input.mesh;
        let triangles = Buffers {
            positions: mesh.positions.clone(),
            normals: mesh.normals.clone(),
            uvs: mesh.uvs.clone(),
            base: mesh.base.clone(),
            front: mesh.front.clone(),
            back: mesh.back.clone(),
            indices: making.indices,
            source_ids: making.ids,
        };
        Ok(Self {
            groups,
            triangles: Geometry::new(triangles),
            points: Geometry::new(making.points),
            lines: Geometry::new(making.lines),
            piece_ends: making.piece_ends,
        })
    }
}

/// The power of two below a length; the same for all that are 0.
fn octave(length: f64) -> u64 {
    length.to_bits() >> 52
}

fn members(input: &Input<'_>) -> Vec<Members> {
    let mut found = Vec::new();
    for (cell, range) in (0_u32..).zip(&input.cells.cells) {
        let mut keyed: Vec<((u32, Class, u64), u32)> = input.cells.order[range.clone()]
            .iter()
            .map(|&piece| {
                let form = &input.forms[piece as usize];
                let part = input.part_of[piece as usize];
                let class = input.parts[part as usize].class_of(form);
                let of = if class == Class::Lines {
                    let triangles = &input.pieces[piece as usize].triangles;
                    octave(reach(input.mesh, triangles, form).1)
                } else {
                    0
                };
                ((part, class, of), piece)
            })
            .collect();
        keyed.sort_unstable();
        for run in keyed.chunk_by(|a, b| a.0 == b.0) {
            let (part, class, _) = run[0].0;
            let pieces = run.iter().map(|&(_, piece)| piece).collect();
            found.push(Members { part, cell, class, pieces });
        }
    }
    found
}

/// Arrays in the making.
struct Making<'a> {
    input: &'a Input<'a>,
    covers: &'a [Cover<'a>],
    indices: Vec<u32>,
    ids: Vec<u32>,
    points: Buffers,
    lines: Buffers,
    piece_ends: Vec<u32>,
}

impl Making<'_> {
    fn group(&mut self, number: u64, members: &Members, job: &Job) -> Result<Group, LodError> {
        let Members { part, cell, class, pieces } = members;
        let input = self.input;
        let material = input.parts[*part as usize].material as usize;
        let pieces_of = |order: Vec<u32>| -> Vec<u32> {
            order.into_iter().map(|at| pieces[at as usize]).collect()
        };
        let pieces = match class {
            Class::Lines => pieces_of(permutation(input.seed, ORDER, number, pieces.len())),
            Class::Points | Class::Mesh => pieces.clone(),
        };
        let triangles: Vec<u32> =
            pieces.iter().flat_map(|&p| &input.pieces[p as usize].triangles).copied().collect();
        let seen: Vec<f64> = pieces
            .iter()
            .flat_map(|&p| {
                let share = input.forms[p as usize].seen_share;
                input.pieces[p as usize].triangles.iter().map(move |_| share)
            })
            .collect();
        let cover = &self.covers[material];
        let areas: Vec<f64> = job.collect(triangles.len(), |at| {
            let triangle = triangles[at] as usize;
            let area = triangle_area(input.mesh.corners(triangle));
            area * f64::from(cover.share(input.mesh, triangle))
        })?;
        let area: f64 = areas.iter().sum();
        let mut group = Group {
            part: *part,
            cell: *cell,
            class: *class,
            sampling: Sampling::Stratified,
            triangles: 0..0,
            opaque_count: 0,
            points: 0..0,
            lines: 0..0,
            piece_ends: 0..0,
            seen_area: areas.iter().zip(&seen).map(|(area, share)| area * share).sum(),
            line_length: 0.0,
            deviation: 0.0,
            center: center(input, &pieces, &triangles, &areas, area),
            radius: 0.0,
            offset: spread(number),
        };
        let corners = triangles.iter().flat_map(|&t| input.mesh.corners(t as usize));
        group.radius = corners.map(|p| p.as_dvec3().distance(group.center)).fold(0.0, f64::max);
        match class {
            Class::Mesh => self.push_triangles(&mut group, &triangles),
            Class::Points => self.push_points(&mut group, number, &triangles, &areas, job)?,
            Class::Lines => self.push_lines(&mut group, &pieces, &triangles),
        }
        Ok(group)
    }

    fn push_triangles(&mut self, group: &mut Group, triangles: &[u32]) {
        let start = length(self.ids.len());
        self.indices.extend(triangles.iter().flat_map(|&t| self.input.mesh.triangles[t as usize]));
        self.ids.extend(triangles.iter().map(|&t| self.input.source_ids[t as usize]));
        group.triangles = start..length(self.ids.len());
    }

    fn push_points(
        &mut self,
        group: &mut Group,
        number: u64,
        triangles: &[u32],
        areas: &[f64],
        job: &Job,
    ) -> Result<(), LodError> {
        let input = self.input;
        let cover = &self.covers[input.parts[group.part as usize].material as usize];
        let order = permutation(input.seed, ORDER, number, triangles.len());
        let is_there = |&at: &u32| areas[at as usize] > 0.0;
        // what is nowhere opaque can only be drawn with all the others
        let (opaque, clear): (Vec<u32>, Vec<u32>) = order.into_iter().partition(is_there);
        let areas: Vec<f64> = opaque.iter().map(|&at| areas[at as usize]).collect();
        let of = |at: &u32| triangles[*at as usize];
        let opaque: Vec<u32> = opaque.iter().map(of).collect();
        let all: Vec<u32> = opaque.iter().copied().chain(clear.iter().map(of)).collect();
        self.push_triangles(group, &all);
        group.opaque_count = length(opaque.len());
        group.sampling = input.sampling.unwrap_or_else(|| automatic(&areas));
        let wanted = opaque.len() * POINTS_PER_TRIANGLE as usize;
        // for each point its triangle's place; points of one triangle together
        let place_of: Vec<u32> = match group.sampling {
            Sampling::Stratified => (0..group.opaque_count).flat_map(|at| [at, at]).collect(),
            Sampling::Area => by_area(&areas, wanted, input.seed, number),
        };
        let runs: Vec<(&[u32], u64)> = place_of
            .chunk_by(|a, b| a == b)
            .scan(0_u64, |first, run| {
                let own = *first;
                *first += run.len() as u64;
                Some((run, own))
            })
            .collect();
        let mut found: Vec<(Splat, u32)> = Vec::with_capacity(wanted);
        for runs in runs.chunks(TRIANGLES_PER_CHECK) {
            job.check()?;
            let made: Vec<Vec<(Splat, u32)>> = runs
                .par_iter()
                .map(|&(run, first)| {
                    let triangle = opaque[run[0] as usize];
                    let keys: Vec<u64> =
                        (first..).take(run.len()).map(|key| number << 32 | key).collect();
                    let id = input.source_ids[triangle as usize];
                    let made = splats(input.mesh, cover, triangle as usize, input.seed, &keys);
                    made.into_iter().map(|splat| (splat, id)).collect()
                })
                .collect();
            found.extend(made.into_iter().flatten());
        }
        let order: Vec<usize> = match (group.sampling, input.pair_order) {
            (Sampling::Stratified, PairOrder::Paired) => (0..wanted).collect(),
            (Sampling::Stratified, PairOrder::Split) => {
                (0..wanted).step_by(2).chain((1..wanted).step_by(2)).collect()
            }
            (Sampling::Area, _) => {
                let order = permutation(input.seed, POINT_ORDER, number, wanted);
                order.into_iter().map(|at| at as usize).collect()
            }
        };
        let start = length(self.points.positions.len());
        for at in order {
            let (splat, id) = found[at];
            let index = length(self.points.positions.len());
            self.points.indices.push(index);
            self.points.source_ids.push(id);
            self.points.positions.push(splat.position);
            self.points.normals.push(splat.normal);
            self.points.uvs.push(Vec2::ZERO);
            self.points.base.push(splat.base);
            self.points.front.push(splat.front);
            self.points.back.push(splat.back);
        }
        group.points = start..length(self.points.positions.len());
        Ok(())
    }

    fn push_lines(&mut self, group: &mut Group, pieces: &[u32], triangles: &[u32]) {
        self.push_triangles(group, triangles);
        let input = self.input;
        let cover = &self.covers[input.parts[group.part as usize].material as usize];
        let made: Vec<(Line, u32, u32)> = pieces
            .par_iter()
            .map(|&piece| {
                let triangles = &input.pieces[piece as usize].triangles;
                let form = &input.forms[piece as usize];
                let made = line(input.mesh, triangles, form, cover, input.sun);
                (made, input.source_ids[triangles[0] as usize], length(triangles.len()))
            })
            .collect();
        let start = length(self.lines.source_ids.len());
        let first_end = self.piece_ends.len();
        let mut end = 0;
        for (line, id, triangle_count) in made {
            group.line_length += line.length;
            group.deviation = group.deviation.max(line.deviation);
            end += triangle_count;
            self.piece_ends.push(end);
            self.lines.source_ids.push(id);
            for corner in line.ends {
                let index = length(self.lines.positions.len());
                self.lines.indices.push(index);
                self.lines.positions.push(corner.position);
                self.lines.normals.push(line.normal);
                self.lines.uvs.push(Vec2::ZERO);
                self.lines.base.push(corner.base);
                self.lines.front.push(corner.front);
                self.lines.back.push(corner.back);
            }
        }
        group.lines = start..length(self.lines.source_ids.len());
        group.piece_ends = first_end..self.piece_ends.len();
    }
}

fn length(count: usize) -> u32 {
    u32::try_from(count).expect("checked before points were made")
}

/// The mean of a group's opaque surface; of its pieces' centres if it has none.
fn center(input: &Input<'_>, pieces: &[u32], triangles: &[u32], areas: &[f64], area: f64) -> DVec3 {
    if area > 0.0 {
        let middle =
            |t: u32| input.mesh.corners(t as usize).map(|p| p.as_dvec3()).iter().sum::<DVec3>();
        let sum: DVec3 = triangles.iter().zip(areas).map(|(&t, &a)| middle(t) * a).sum();
        return sum / (3.0 * area);
    }
    let sum: DVec3 = pieces.iter().map(|&p| input.forms[p as usize].center).sum();
    sum / pieces.len() as f64
}

/// A number in [0, 1) for each group: the golden ratio spreads any run of them evenly; the first is 1/2.
fn spread(number: u64) -> f64 {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    (0.5 + number as f64 * GOLDEN).fract()
}
