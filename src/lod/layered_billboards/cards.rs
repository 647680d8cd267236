//! Layers as cards: each baked from the side that all are seen from, all of them in one texture.

use std::sync::Arc;

use glam::{DVec2, DVec3, Vec2, Vec3, Vec4};
use rayon::prelude::*;

use crate::bake::{self, Renderers, bake};
use crate::draw_list::{Buffers, Geometry};
use crate::error::LodError;
use crate::job::Job;
use crate::lod::layered_billboards::content::seen_box_of;
use crate::lod::layered_billboards::depth::Depth;
use crate::lod::layered_billboards::frame::{Cells, Grid};
use crate::lod::layered_billboards::{CUTOFF, Drawing, Params};
use crate::lod::leaves::{Leaves, Placed};
use crate::raster::Renderer;
use crate::texture::atlas::Atlas;
use crate::texture::linear::LinearImage;
use crate::texture::mips::Keep;
use crate::texture::{Image, Texture};

/// Texels of layers that are drawn side by side: half a gigabyte of planes and their copies.
const MAX_TEXELS_AT_ONCE: u64 = 1 << 24;

/// Tested layers with no more texels than pixels are baked with up to this many halvings more.
const FINER_LEVELS: u32 = 3;

/// And up to so many texels a side.
const MAX_FINER_SIDE: u32 = 2048;

/// What a layer is to show.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plan {
    pub(super) layer: usize,
    pub(super) placed: Vec<Placed>,
    /// Where it lies.
    pub(super) depth: Depth,
    /// Offsets between which it owns what is cut.
    pub(super) ends: (f64, f64),
}

impl Plan {
    /// A layer that shows nothing yet.
    pub(super) fn new(layer: usize) -> Self {
        let ends = (f64::NEG_INFINITY, f64::INFINITY);
        Self { layer, placed: Vec::new(), depth: Depth::default(), ends }
    }

    pub(super) fn add(&mut self, element: usize) {
        self.placed.push(Placed { leaf: element, cut: false });
    }

    pub(super) fn first(&self) -> Option<usize> {
        self.placed.first().map(|placed| placed.leaf)
    }
}

/// A layer as it is drawn.
#[derive(Debug, Clone, Copy)]
pub(super) struct Card {
    pub(super) layer: usize,
    /// Around its edge, from the lower left as seen.
    pub(super) corners: [DVec3; 4],
    /// Mean of what it shows, towards the viewer from the plant's origin.
    pub(super) depth: f64,
    /// Upper left texel in the texture, width and height.
    pub(super) texels: [u32; 4],
}

/// All layers that show something, the farthest from the viewer first.
#[derive(Debug, Clone)]
pub(super) struct Cards {
    cards: Vec<Card>,
    geometry: Arc<Geometry>,
    texture: Arc<Texture>,
    /// Share of the texture that cards cover.
    pub(super) fill: f64,
}

impl Card {
    /// Its middle.
    pub(super) fn center(&self) -> DVec3 {
        (self.corners[0] + self.corners[2]) * 0.5
    }
}

impl Cards {
    pub(super) fn all(&self) -> &[Card] {
        &self.cards
    }

    /// Four indices a card, in the order of the cards.
    pub(super) fn geometry(&self) -> &Arc<Geometry> {
        &self.geometry
    }

    pub(super) fn texture(&self) -> &Arc<Texture> {
        &self.texture
    }
}

/// Bakes layers.
pub(super) struct Baker<'a> {
    pub(super) leaves: &'a Leaves<'a>,
    pub(super) grid: &'a Grid,
    pub(super) params: &'a Params,
    /// Of the first layer, in the "ids" output.
    pub(super) first_id: u32,
    /// Whether layers share borders at which they are cut, and therefore a view.
    pub(super) is_cut: bool,
    pub(super) job: &'a Job,
}

impl Baker<'_> {
    /// Draws every layer that shows something into one texture.
    pub(super) fn bake(&self, plans: &[Plan]) -> Result<Cards, LodError> {
        let mut plans: Vec<&Plan> = plans.iter().filter(|plan| !plan.placed.is_empty()).collect();
        let mean = |plan: &Plan| plan.depth.mean;
        plans.sort_by(|a, b| mean(a).total_cmp(&mean(b)).then(a.layer.cmp(&b.layer)));
        let cells: Vec<Cells> = plans.iter().map(|plan| self.cells(plan)).collect();
        let sizes: Vec<(u32, u32)> = cells.iter().map(|cells| cells.size).collect();
        let atlas = Atlas::new("resolution", &sizes)?;
        self.job.begin(plans.len() as u64);
        let mut levels = atlas.levels();
        let renderers = Renderers::default();
        let whole = self.grid.whole();
        let draw = |card: usize| {
            self.job.check()?;
            // the same eye for all that share a border: the same numbers for the depth of a sample
            let seen = if self.is_cut { whole } else { cells[card] };
            let parts = Parts { plan: plans[card], cells: cells[card], seen };
            let made = renderers.with(|renderer| self.levels(&parts, card, &atlas, renderer))?;
            self.job.advance();
            Ok(made)
        };
        let mut next = 0;
        while next < plans.len() {
            let end = plans.len().min(next + self.at_once(&sizes[next..]));
            let drawn: Result<Vec<Vec<Image>>, LodError> =
                (next..end).into_par_iter().map(draw).collect();
            for (card, made) in (next..end).zip(drawn?) {
                atlas.put(card, &made, &mut levels);
            }
            next = end;
        }
        let texture = bake::stored(levels, self.params.format, self.job)?;
        let mut buffers = Buffers::default();
        let cards = plans.iter().zip(&cells).enumerate().map(|(number, (plan, &cells))| {
            let rect = self.grid.rect(cells, 0.0);
            let frame = &self.grid.frame;
            let corners = rect.corners().map(|corner| {
                let depth = plan.depth.at(frame.seen(corner - self.leaves.center));
                corner + frame.toward * depth
            });
            let layer = u32::try_from(plan.layer).expect("few layers");
            push_card(&mut buffers, &corners, &atlas, number, self.first_id + layer);
            let ([x, y], (width, height)) = (atlas.places[number], sizes[number]);
            let depth = plan.depth.mean + self.leaves.center.dot(frame.toward);
            Card { layer: plan.layer, corners, depth, texels: [x, y, width, height] }
        });
        let cards = cards.collect();
        Ok(Cards { cards, geometry: Geometry::new(buffers), texture, fill: atlas.fill() })
    }

    fn cells(&self, plan: &Plan) -> Cells {
        let elements = plan.placed.par_iter().map(|placed| placed.leaf);
        self.grid.cells(seen_box_of(self.leaves, &self.grid.frame, elements))
    }

    /// Layers to be drawn side by side: one a thread, unless their texels would take much memory.
    fn at_once(&self, sizes: &[(u32, u32)]) -> usize {
        let mut left = MAX_TEXELS_AT_ONCE;
        let whole = self.grid.whole().size;
        let mut fits = |&size: &(u32, u32)| {
            let size = if self.is_cut { whole } else { size };
            let texels = (u64::from(size.0) * u64::from(size.1)) << (2 * self.finer_levels(size));
            let fits = texels <= left;
            left = left.saturating_sub(texels);
            fits
        };
        let fitting = sizes.iter().map_while(|size| fits(size).then_some(())).count();
        fitting.clamp(1, rayon::current_num_threads())
    }

    /// A layer's levels with its border in the atlas.
    fn levels(
        &self,
        &Parts { plan, cells, seen }: &Parts<'_>,
        card: usize,
        atlas: &Atlas,
        renderer: &mut Renderer,
    ) -> Result<Vec<Image>, LodError> {
        let Params { sample_count, drawing, .. } = *self.params;
        let finer_levels = self.finer_levels(seen.size);
        let (width, height) = seen.size;
        let rect = self.grid.rect(seen, 0.0);
        let view = rect.view((width << finer_levels, height << finer_levels))?;
        #[expect(clippy::cast_possible_truncation, reason = "depths are compared in f32")]
        let slab = [plan.ends.1, plan.ends.0].map(|offset| rect.depth_of(offset) as f32);
        let list = self.leaves.list(&view, &plan.placed, [slab[0].max(0.0), slab[1]]);
        let image = bake(renderer, &list, &view, sample_count, self.job)?;
        let image = cropped(image, seen, cells, finer_levels);
        let keep = match drawing {
            Drawing::Blend => Keep::MeanAlpha,
            Drawing::Test => Keep::Coverage { cutoff: CUTOFF },
        };
        let mut made = bake::levels(&atlas.padded(card, &image), keep, self.job)?;
        made.drain(..finer_levels as usize);
        Ok(made)
    }

    /// Halvings that a layer is baked with and does not keep: alpha tests on texels as large as a pixel
    /// would lose what is thinner.
    fn finer_levels(&self, (width, height): (u32, u32)) -> u32 {
        let tested = self.params.drawing == Drawing::Test && self.params.views.is_some();
        let side = width.max(height);
        (0..=FINER_LEVELS)
            .rev()
            .find(|levels| tested && side << levels <= MAX_FINER_SIDE)
            .unwrap_or(0)
    }
}

/// What a layer shows, and the texels that it keeps of those that are drawn.
struct Parts<'a> {
    plan: &'a Plan,
    cells: Cells,
    seen: Cells,
}

/// The part of a picture of some cells that shows others of them.
fn cropped(image: LinearImage, seen: Cells, cells: Cells, finer_levels: u32) -> LinearImage {
    if seen == cells {
        return image;
    }
    let (x, y) = Grid::inside(seen, cells);
    let [x, y, width, height] =
        [x, y, cells.size.0, cells.size.1].map(|texels| (texels << finer_levels) as usize);
    let rows = image.texels.chunks_exact(image.width as usize).skip(y).take(height);
    let texels = rows.flat_map(|row| &row[x..x + width]).copied().collect();
    let side = |texels: u32| texels << finer_levels;
    LinearImage { width: side(cells.size.0), height: side(cells.size.1), texels }
}

/// Appends a layer's card, which is white: what it shows is lit.
fn push_card(buffers: &mut Buffers, corners: &[DVec3; 4], atlas: &Atlas, card: usize, id: u32) {
    let first = u32::try_from(buffers.positions.len()).expect("few cards");
    let shares = [DVec2::new(0.0, 1.0), DVec2::ONE, DVec2::new(1.0, 0.0), DVec2::ZERO];
    let normal = (corners[1] - corners[0]).cross(corners[3] - corners[0]).normalize_or_zero();
    for (corner, share) in corners.iter().zip(shares) {
        let [u, v] = atlas.uv(card, share.to_array());
        #[expect(clippy::cast_possible_truncation, reason = "texture coordinates are f32")]
        let uv = Vec2::new(u as f32, v as f32);
        buffers.positions.push(corner.as_vec3());
        buffers.normals.push(normal.as_vec3());
        buffers.uvs.push(uv);
        buffers.base.push(Vec4::ONE);
        buffers.front.push(Vec3::ONE);
        buffers.back.push(Vec3::ONE);
    }
    buffers.indices.extend(first..first + 4);
    buffers.source_ids.push(id);
}
