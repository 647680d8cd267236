//! Frames of an impostor: the plant drawn in parallel, and the levels of what is kept of it.
//!
//! Frames that will be lit when they are looked at keep colour without light and normals in place of lit
//! colour. The normal is that of the side which is seen, and beside it stands whether the texel's
//! nearest sample is a leaf.

use glam::{DVec3, Vec3, Vec4};
use rayon::prelude::*;

use crate::bake::{self, BakeRect, Renderers, bake_frame};
use crate::error::LodError;
use crate::job::Job;
use crate::lod::octahedral_impostor::ball::Ball;
use crate::lod::octahedral_impostor::{Drawing, Params, Shading};
use crate::lod::solid::Solid;
use crate::lod::{Crown, ListBuilder};
use crate::raster::{EMPTY_ID, Frame as Picture, Outputs};
use crate::texture::atlas::Atlas;
use crate::texture::depth_map::{self, DepthLevel};
use crate::texture::mips::Keep;
use crate::texture::{Image, LinearImage, normal_map};
use crate::view_state::ViewState;

/// Texels of frames that are drawn side by side.
const MAX_TEXELS_AT_ONCE: u64 = 1 << 24;

/// Levels of an atlas of frames, or what one frame's bake adds to it.
pub(super) struct Layers {
    /// Lit colour, or colour without light.
    pub(super) color: Vec<Image>,
    pub(super) depth: Vec<DepthLevel>,
    /// Where colour is without light.
    pub(super) normal: Option<Vec<Image>>,
}

/// Draws frames and makes their levels.
pub(super) struct Baker<'a> {
    pub(super) solid: &'a Solid,
    pub(super) params: &'a Params,
    pub(super) atlas: &'a Atlas,
    pub(super) ball: Ball,
    /// Triangles with smaller ids are wood.
    pub(super) first_leaf_id: u32,
    /// Texels a frame's side.
    pub(super) resolution: u32,
    pub(super) job: &'a Job,
}

impl Layers {
    fn of(atlas: &Atlas, shading: Shading) -> Self {
        let color = atlas.levels();
        let depth = |&Image { width, height, ref texels }: &Image| DepthLevel {
            width,
            height,
            codes: vec![0; texels.len()],
        };
        let depth = color.iter().map(depth).collect();
        let normal = (shading == Shading::Relit).then(|| atlas.levels());
        Self { color, depth, normal }
    }

    /// Takes a frame's levels over.
    fn put(&mut self, card: usize, from: &Self, atlas: &Atlas) {
        atlas.put(card, &from.color, &mut self.color);
        for (level, (from, to)) in from.depth.iter().zip(&mut self.depth).enumerate() {
            atlas.put_level(card, level, &from.codes, from.width, &mut to.codes);
        }
        if let (Some(from), Some(to)) = (&from.normal, &mut self.normal) {
            atlas.put(card, from, to);
        }
    }
}

impl Baker<'_> {
    /// Bakes a frame for each direction, in the atlas's order.
    pub(super) fn bake(&self, directions: &[DVec3]) -> Result<Layers, LodError> {
        let mut layers = Layers::of(self.atlas, self.params.shading);
        let renderers = Renderers::default();
        let cards: Vec<usize> = (0..directions.len()).collect();
        self.job.begin(cards.len() as u64);
        for batch in cards.chunks(at_once(self.resolution)) {
            let frame = |&card: &usize| {
                let made = self.frame(card, directions[card], &renderers)?;
                self.job.advance();
                Ok(made)
            };
            let baked: Vec<Layers> =
                batch.par_iter().map(frame).collect::<Result<_, LodError>>()?;
            for (&card, baked) in batch.iter().zip(&baked) {
                layers.put(card, baked, self.atlas);
            }
        }
        Ok(layers)
    }

    fn frame(&self, card: usize, toward: DVec3, renderers: &Renderers) -> Result<Layers, LodError> {
        let Self { params, atlas, job, resolution, .. } = *self;
        let rect = self.ball.rect(toward);
        let view = rect.view((resolution, resolution))?;
        let mut builder = ListBuilder::default();
        let crown = Crown::alone(glam::DAffine3::IDENTITY);
        self.solid.emit(&view, &[crown], &mut ViewState::default(), &mut builder);
        let list = builder.finish();
        let is_relit = params.shading == Shading::Relit;
        let outputs =
            Outputs { albedo: is_relit, normal: is_relit, ids: is_relit, ..Outputs::COLOR_DEPTH };
        let picture = renderers.with(|renderer| {
            bake_frame(renderer, &list, &view, params.sample_count, outputs, job)
        })?;
        let padded = |texels: Vec<Vec4>| {
            atlas.padded(card, &LinearImage { width: resolution, height: resolution, texels })
        };
        let keep = match params.drawing {
            Drawing::Test(cutoff) => Keep::Coverage { cutoff },
            Drawing::Coverage | Drawing::Blend => Keep::MeanAlpha,
        };
        let (check, level_count) = (|| job.check(), atlas.level_count);
        let depth = padded(depths(&picture, &rect, self.ball.radius));
        let depth = depth_map::levels(&depth, level_count, params.depth_bit_count, &check)?;
        let normal = is_relit.then(|| {
            let (normals, shares) = normals(&picture, self.first_leaf_id);
            normal_map::levels(&padded(normals), &padded(shares), level_count, &check)
        });
        let color = padded(if is_relit { picture.albedo } else { picture.color });
        Ok(Layers { color: bake::levels(&color, keep, job)?, depth, normal: normal.transpose()? })
    }
}

/// Frames drawn side by side: one a thread, unless their texels would take much memory.
fn at_once(resolution: u32) -> usize {
    let fitting = MAX_TEXELS_AT_ONCE / (u64::from(resolution) * u64::from(resolution));
    usize::try_from(fitting).unwrap_or(usize::MAX).clamp(1, rayon::current_num_threads())
}

/// Depths of a picture as shares of the ball's, times alpha.
fn depths(picture: &Picture, rect: &BakeRect, radius: f64) -> Vec<Vec4> {
    let texel = |(color, &depth): (&Vec4, &f32)| {
        if depth.is_infinite() {
            return Vec4::ZERO;
        }
        let offset = rect.depth_of(0.0) - f64::from(depth);
        #[expect(clippy::cast_possible_truncation, reason = "a share")]
        let share = (0.5 + 0.5 * offset / radius) as f32;
        depth_map::texel(share, color.w)
    };
    picture.color.iter().zip(&picture.depth).map(texel).collect()
}

/// Normals of a picture, and in red whether leaves are seen; both times alpha.
fn normals(picture: &Picture, first_leaf_id: u32) -> (Vec<Vec4>, Vec<Vec4>) {
    let texel = |((color, &normal), &id): ((&Vec4, &Vec3), &u32)| {
        let is_leaf = id >= first_leaf_id && id != EMPTY_ID;
        let share = if is_leaf { color.w } else { 0.0 };
        (normal_map::texel(normal, color.w), Vec4::new(share, 0.0, 0.0, color.w))
    };
    picture.color.iter().zip(&picture.normal).zip(&picture.ids).map(texel).unzip()
}
