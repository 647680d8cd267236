//! Scaling collapsed leaves so that a crown covers as much as before, seen from all around.
//!
//! Leaves hide one another; what they collapse into hides itself less, or has lost area. So neither the
//! corners of the leaves nor their area gives a crown of fewer quads the coverage of the whole one.
//! Here it is measured: the foliage is drawn from a few directions, then the crown at levels of ever
//! fewer quads, and at each the nodes made since the level before are scaled by what is missing. The
//! factor goes on smoothly from level to level, by the logarithm of the quads that were left when a
//! node was made.

use glam::{DAffine3, DVec3};

use crate::bake::{BakeRect, bake};
use crate::draw_list::{Blend, Buffers, DrawList, Instance, Item, Primitive, Source};
use crate::error::LodError;
use crate::job::Job;
use crate::lod::foliage_hierarchy::ball::node_ball;
use crate::lod::foliage_hierarchy::drawing::{CORNERS, NodeVertices};
use crate::lod::foliage_hierarchy::forest::{Forest, NONE};
use crate::lod::leaves::{Leaves, Placed};
use crate::lod::solid::{blend_of, surface_of};
use crate::plant::{Material, Plant};
use crate::raster::Renderer;
use crate::texture::{Filter, Sampler};
use crate::view::View;

/// Texels along the longer side of a picture that coverage is measured in.
const RESOLUTION: u32 = 256;

/// Samples of a texel: what a mean over all of them needs.
const SAMPLE_COUNT: u32 = 1;

/// Level and from 45 degrees above, 60 degrees apart; from the other side everything covers the same.
const DIRECTION_COUNT: usize = 6;

/// Each level has this share of the quads of the one before.
const LEVEL_SHARE: f64 = 0.707;

/// Trials at a level.
const MAX_TRIALS: usize = 5;

/// Coverage that is this near is left at that.
const NEAR_ENOUGH: f64 = 0.01;

/// Exponent of coverage over scale where a trial has yet to tell: 2 without overlap.
const FIRST_EXPONENT: f64 = 1.5;

/// No node is scaled by more than this for its own area: two leaves that cross may leave a sliver, whose
/// area would stretch it right through the crown. Of a chestnut's nodes 0.1 % would be.
const MAX_OWN_SCALE: f32 = 3.0;

/// Scales by which a node may be drawn larger or smaller than its area asks for.
const SCALES: [f64; 2] = [0.05, 4.0];

/// Multiplies the forest's scales, and puts its balls around what is then drawn.
pub(super) fn keep_coverage(
    forest: &mut Forest,
    vertices: &NodeVertices,
    plant: &Plant,
    job: &Job,
) -> Result<(), LodError> {
    let leaves = Leaves::new(plant)?;
    let reach = leaves.radius.max(crate::lod::leaves::LEAST_SIZE);
    let mut painter = Painter::new(leaves.center, reach)?;
    let every: Vec<Placed> =
        (0..plant.foliage.leaf_count()).map(|leaf| Placed { leaf, cut: false }).collect();
    let target = painter.mean(job, |view| leaves.list(view, &every, [0.0; 2]))?;
    if target <= 0.0 {
        return Ok(());
    }
    let materials: Vec<Material> = vertices
        .materials
        .iter()
        .map(|material| Material {
            // as the full plant is tested: level 0, bilinear
            sampler: Sampler { filter: Filter::Bilinear, ..material.sampler },
            ..material.clone()
        })
        .collect();
    let leaf_count = forest.leaf_count as usize;
    let own_scales: Vec<f32> = forest.scales.iter().map(|s| s.min(MAX_OWN_SCALE)).collect();
    let (mut count, mut log_scale) = (leaf_count, 0.0_f64);
    while count > forest.root_count() {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count")]
        let next = ((count as f64 * LEVEL_SHARE) as usize).max(forest.root_count());
        let band = Band { leaf_count, from: count, to: next, start: log_scale };
        let active = band.active(forest);
        let mut trial = log_scale;
        // scale and what is missing with it, of the last trial and of the best one
        let mut last: Option<(f64, f64)> = None;
        let mut best = (log_scale, f64::INFINITY);
        let mut exponent = FIRST_EXPONENT;
        for _ in 0..MAX_TRIALS {
            band.apply(forest, &own_scales, trial);
            let found =
                painter.mean(job, |view| list_of(forest, &active, vertices, &materials, view))?;
            let missing = libm::log(target / found.max(f64::MIN_POSITIVE));
            if missing.abs() < best.1.abs() {
                best = (trial, missing);
            }
            if missing.abs() < NEAR_ENOUGH {
                break;
            }
            if let Some((scale, before)) = last
                && (trial - scale).abs() > 1e-6
            {
                let slope = (before - missing) / (trial - scale);
                if slope > 0.1 {
                    exponent = slope;
                }
            }
            last = Some((trial, missing));
            let [low, high] = SCALES.map(libm::log);
            trial = (trial + missing / exponent).clamp(low, high);
        }
        let end = best.0;
        band.apply(forest, &own_scales, end);
        (count, log_scale) = (next, end);
    }
    for node in 0..u32::try_from(forest.nodes.len()).expect("checked when it was made") {
        if node.is_multiple_of(4096) {
            job.check()?;
        }
        forest.spheres[node as usize] = node_ball(forest, node);
    }
    Ok(())
}

/// The nodes made between two levels.
struct Band {
    leaf_count: usize,
    from: usize,
    to: usize,
    /// Logarithm of the factor at its finer end.
    start: f64,
}

impl Band {
    /// Nodes of the crown at its coarser end.
    fn active(&self, forest: &Forest) -> Vec<u32> {
        let made = u32::try_from(2 * self.leaf_count - self.to).expect("nodes are u32");
        (0..made)
            .filter(|&node| {
                let parent = forest.nodes[node as usize].parent;
                parent == NONE || parent >= made
            })
            .collect()
    }

    /// Scales its nodes, up to a factor whose logarithm is `end`.
    fn apply(&self, forest: &mut Forest, own_scales: &[f32], end: f64) {
        let span = libm::log(self.from as f64 / self.to as f64);
        for left in self.to..self.from {
            // the collapse that left so many quads
            let node = 2 * self.leaf_count - left - 1;
            let share = libm::log(self.from as f64 / left as f64) / span;
            let factor = libm::exp(self.start + (end - self.start) * share);
            #[expect(clippy::cast_possible_truncation, reason = "scales are stored in f32")]
            let scale = (f64::from(own_scales[node]) * factor) as f32;
            forest.scales[node] = scale;
        }
    }
}

/// Draws from all directions into a picture that holds the crown.
struct Painter {
    renderer: Renderer,
    views: Vec<View>,
}

impl Painter {
    fn new(center: DVec3, radius: f64) -> Result<Self, LodError> {
        let views = (0..DIRECTION_COUNT).map(|number| {
            let half = DIRECTION_COUNT / 2;
            let (ring, step) = (number / half, number % half);
            let azimuth = (step as f64 + 0.5 * ring as f64) * std::f64::consts::PI / half as f64;
            let elevation = ring as f64 * std::f64::consts::FRAC_PI_4;
            let flat = DVec3::new(libm::sin(azimuth), 0.0, libm::cos(azimuth));
            let toward = flat * libm::cos(elevation) + DVec3::Y * libm::sin(elevation);
            let right = DVec3::Y.cross(toward).normalize();
            // collapsed quads may reach beyond the leaves
            let (side, reach) = (2.5 * radius, 4.0 * radius);
            let up = toward.cross(right);
            let rect = BakeRect { center, right, up, width: side, height: side, reach };
            rect.view((RESOLUTION, RESOLUTION))
        });
        Ok(Self { renderer: Renderer::default(), views: views.collect::<Result<_, _>>()? })
    }

    /// Mean alpha of the pictures.
    fn mean(&mut self, job: &Job, list_of: impl Fn(&View) -> DrawList) -> Result<f64, LodError> {
        let mut sum = 0.0;
        for view in &self.views {
            job.check()?;
            let image = bake(&mut self.renderer, &list_of(view), view, SAMPLE_COUNT, job)?;
            let alpha: f64 = image.texels.iter().map(|texel| f64::from(texel.w)).sum();
            sum += alpha / image.texels.len() as f64;
        }
        Ok(sum / self.views.len() as f64)
    }
}

/// Some nodes as the forest draws them. Blended ones are drawn in their order: alpha does not depend
/// on it.
fn list_of(
    forest: &Forest,
    nodes: &[u32],
    vertices: &NodeVertices,
    materials: &[Material],
    view: &View,
) -> DrawList {
    let mut list = DrawList::default();
    let instances = list.instance(Instance::new(&DAffine3::IDENTITY, view));
    for &material_id in &vertices.paint_order {
        let material = &materials[material_id as usize];
        let blend = blend_of(material);
        let mut own = Buffers::default();
        let start = u32::try_from(list.own.buffers.indices.len() / 3).expect("fits in u32");
        let is_of = |node: &u32| vertices.material_of(forest, *node) == material_id;
        let mut sorted: Vec<u32> = nodes.iter().copied().filter(is_of).collect();
        // near to far: what they hide needs no alpha test
        let height = |node: u32| forest.spheres[node as usize].center.as_dvec3().dot(view.back);
        sorted.sort_by(|&a, &b| height(b).total_cmp(&height(a)).then(a.cmp(&b)));
        for node in sorted {
            let first = u32::try_from(own.positions.len()).expect("fits in u32");
            own.positions.extend(forest.drawn_quad(node).map(|corner| corner.as_vec3()));
            let range = node as usize * 4..node as usize * 4 + 4;
            own.normals.extend_from_slice(&vertices.buffers.normals[range.clone()]);
            own.uvs.extend_from_slice(&vertices.buffers.uvs[range.clone()]);
            own.base.extend_from_slice(&vertices.buffers.base[range.clone()]);
            own.front.extend_from_slice(&vertices.buffers.front[range.clone()]);
            own.back.extend_from_slice(&vertices.buffers.back[range]);
            own.indices.extend(CORNERS.map(|corner| first + corner));
            own.source_ids.extend([node; 2]);
        }
        let first_vertex = u32::try_from(list.own.buffers.positions.len()).expect("fits in u32");
        list.own.buffers.append(own, first_vertex);
        let end = u32::try_from(list.own.buffers.indices.len() / 3).expect("fits in u32");
        let surface = surface_of(material, &mut list);
        list.items.push(Item {
            primitive: Primitive::Triangles,
            vertices: Source::Own,
            indices: Source::Own,
            primitives: start..end,
            instances: instances.clone(),
            surface,
            blend,
            depth_write: blend != Blend::Over,
            slab: None,
        });
    }
    list
}
