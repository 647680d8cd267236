//! Octahedral impostors: pictures of the whole plant from all around, with depth, three of which a view
//! mixes.
//!
//! Directions are spread over a square by the octahedral map, and at each point of a grid there the plant
//! is drawn in parallel onto a square: lit colour with alpha, and depth. A view takes the triangle of the
//! grid that holds its direction. Each sample's ray meets the three frames' planes, the stored depths
//! shift the points that are read, and the colours are mixed by the direction's weights in the
//! triangle. It writes the depth of what it shows. Engines draw far trees like that today.
//!
//! This work is based on:
//! Ryan Brucks. Octahedral Impostors. 2018
//!
//! Deviations: by default lit colour is stored, since light belongs to the plant; rays are followed at
//! each sample instead of being interpolated between a card's corners; a frame whose depth at the
//! point found is not the ray's counts less; levels of alpha-tested frames keep coverage.

mod baker;
mod ball;
pub mod octahedron;
#[cfg(test)]
mod tests;
mod viewer;

use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec2, Vec3, Vec4};

use crate::bake;
use crate::draw_list::{Blend, Buffers, Item, Primitive, Source, Surface};
use crate::error::{LodError, check_in};
use crate::job::Job;
use crate::lod::octahedral_impostor::baker::{Baker, Layers};
use crate::lod::octahedral_impostor::ball::Ball;
use crate::lod::octahedral_impostor::octahedron::Grid;
use crate::lod::octahedral_impostor::viewer::Viewer;
use crate::lod::solid::Solid;
use crate::lod::wood::Wood;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture, Representation, foot_of};
use crate::plant::{Lighting, Mesh, Plant};
use crate::raster::samples;
use crate::texture::atlas::Atlas;
use crate::texture::depth_map::{self, DepthLevel};
use crate::texture::frames::{Frame, Parts, Relit};
use crate::texture::texture::check_size;
use crate::texture::{
    DepthMap, Filter, Format, Frames, Image, Light, NormalMap, Sampler, Texture, Wrap,
};
use crate::view::View;
use crate::view_state::ViewState;

/// Steps of parallax, at most.
const MAX_STEP_COUNT: u32 = 64;

/// How the frames of a view are mixed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mix {
    /// The corners of the direction's triangle, by barycentric weights.
    Three,
    /// The heaviest of them alone.
    Nearest,
}

/// How impostors join the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drawing {
    /// Where the mixed alpha is at least this, with depth.
    Test(f32),
    /// On as many of a pixel's samples as alpha asks for, other samples for each copy, with depth.
    Coverage,
    /// Blended from the farthest copy to the nearest, without depth.
    Blend,
}

/// What frames hold of the light.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shading {
    /// Colours under the plant's light.
    Baked,
    /// Colours without light, and normals, which are lit when they are looked at.
    Relit,
}

/// How octahedral impostors are built.
#[derive(Debug, Clone)]
pub struct Params {
    /// Where the frames are seen from.
    pub grid: Grid,
    /// Texels a frame's side.
    pub resolution: u32,
    /// Samples a texel.
    pub sample_count: u32,
    /// How frames are mixed.
    pub mix: Mix,
    /// How they are drawn.
    pub drawing: Drawing,
    /// Steps of parallax.
    pub step_count: u32,
    /// How far off the depth found may be for a frame to count half, in radii of the plant; `None`: all
    /// frames count by weight alone.
    pub tolerance: Option<f64>,
    /// Bits of a depth.
    pub depth_bit_count: u32,
    /// What frames hold of the light.
    pub shading: Shading,
    /// How colours are stored.
    pub format: Format,
    /// The wood that is in the pictures.
    pub wood: Wood,
    /// The cameras that will look, in the plant's own world; `None` bakes for all.
    pub views: Option<Vec<View>>,
}

/// The technique's representation of a plant.
#[derive(Debug, Clone)]
pub struct OctahedralImpostor {
    grid: Grid,
    /// For each frame of the grid, the frame that shows its direction.
    stand_ins: Vec<usize>,
    frames: Arc<Frames>,
    mix: Mix,
    drawing: Drawing,
    step_count: u32,
    tolerance: f32,
    fill: f64,
    ball: Ball,
    foot: DVec3,
    origin: DVec3,
}

/// A single copy where the plant's file has put it.
fn at_home(origin: DVec3) -> Crown {
    Crown::alone(DAffine3::from_translation(origin))
}

impl OctahedralImpostor {
    /// Bakes the frames of a plant.
    ///
    /// # Errors
    /// `foliage` without leaves where there is no wood either; an argument out of range;
    /// [`LodError::Cancelled`].
    pub fn build(plant: &Plant, params: &Params, job: &Job) -> Result<Self, LodError> {
        check(params)?;
        if params.shading == Shading::Relit {
            light(&plant.lighting, "shading")?;
        }
        let wood = params.wood.of(plant)?;
        let leaves = &plant.foliage.mesh;
        let Some(ball) = Ball::around(&[&wood, leaves], job)? else {
            let why = "without wood there is nothing to draw";
            return Err(LodError::Empty { name: "foliage", why });
        };
        let stand_ins = params.grid.stand_ins();
        let (needed, resolution) = needed(plant, params, &ball, &stand_ins, job)?;
        let ball = ball.smeared(resolution);
        let sizes = vec![(resolution, resolution); needed.len()];
        let atlas = Atlas::new("resolution", &sizes)?;
        let first_leaf_id = u32::try_from(wood.triangles.len()).expect("checked by the plant");
        let ids = Buffers::ids_from(first_leaf_id, leaves);
        let meshes = [(&wood, Buffers::ids_from(0, &wood)), (leaves, ids)];
        let solid = Solid::new(&meshes, &plant.materials, Filter::Bilinear, job)?;
        let baker =
            Baker { solid: &solid, params, atlas: &atlas, ball, first_leaf_id, resolution, job };
        let directions: Vec<DVec3> = needed.iter().map(|&f| params.grid.direction(f)).collect();
        let Layers { color, depth, normal } = baker.bake(&directions)?;
        let mut frames: Vec<Option<Frame>> = vec![None; params.grid.frame_count()];
        let in_atlas = |card: usize, at: [f64; 2]| Vec2::from(atlas.uv(card, at).map(narrowed));
        for (card, &frame) in needed.iter().enumerate() {
            let rect = ball.rect(params.grid.direction(frame));
            frames[frame] = Some(Frame {
                toward: rect.toward().as_vec3(),
                right: rect.right.as_vec3(),
                up: rect.up.as_vec3(),
                corner: in_atlas(card, [0.0; 2]),
            });
        }
        let relit = normal.map(|levels| {
            let light = light(&plant.lighting, "shading")?;
            Ok::<_, LodError>(Relit { normal: Arc::new(NormalMap::new(levels)?), light })
        });
        let frames = Frames::new(Parts {
            center: ball.center.as_vec3(),
            reach: narrowed(ball.radius),
            bounds: [ball.center - ball.half, ball.center + ball.half].map(|p| p.as_vec3()),
            frames,
            size: in_atlas(0, [1.0; 2]) - in_atlas(0, [0.0; 2]),
            color: bake::stored(color, params.format, job)?,
            depth: Arc::new(DepthMap::new(depth, params.depth_bit_count)?),
            relit: relit.transpose()?,
        })?;
        Ok(Self {
            grid: params.grid,
            stand_ins,
            frames,
            mix: params.mix,
            drawing: params.drawing,
            step_count: params.step_count,
            tolerance: params.tolerance.map_or(f32::INFINITY, narrowed),
            fill: atlas.fill(),
            ball,
            foot: foot_of([&wood, leaves].into_iter().filter_map(Mesh::bounds)),
            origin: plant.origin,
        })
    }

    /// The same pictures under another light.
    ///
    /// # Errors
    /// `shading` of pictures that hold lit colours; an argument of `lighting` out of range, `occlusion`
    /// above 0 among them.
    pub fn relit(&self, lighting: &Lighting) -> Result<Self, LodError> {
        let parts = self.frames.parts();
        let Some(Relit { normal, .. }) = &parts.relit else {
            let why = "must be \"relit\": these frames hold lit colours and no normals".to_owned();
            return Err(LodError::Invalid { name: "shading", why });
        };
        lighting.check()?;
        let relit = Relit { normal: Arc::clone(normal), light: light(lighting, "occlusion")? };
        let frames = Frames::new(Parts { relit: Some(relit), ..parts.clone() })?;
        Ok(Self { frames, ..self.clone() })
    }

    /// The pictures, with their layers.
    pub fn frames(&self) -> &Frames {
        &self.frames
    }

    /// The ball that frames show, in the plant's world: its middle and radius.
    pub fn ball(&self) -> (DVec3, f64) {
        (self.ball.center + self.origin, self.ball.radius)
    }

    /// Share of the atlas that frames cover.
    pub fn atlas_fill(&self) -> f64 {
        self.fill
    }

    /// Which frames have been baked.
    pub fn baked(&self) -> Vec<bool> {
        self.frames.parts().frames.iter().map(Option::is_some).collect()
    }

    /// Frames and weights with which a view shows the plant where it stands.
    pub fn mixed(&self, view: &View) -> Vec<(usize, f64)> {
        let viewer = Viewer::new(view, &at_home(self.origin), &self.ball);
        mixed(&self.grid, self.mix, &self.stand_ins, &viewer)
    }

    fn emit_crown(
        &self,
        view: &View,
        crown: &Crown,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        let viewer = Viewer::new(view, crown, &self.ball);
        let chosen = mixed(&self.grid, self.mix, &self.stand_ins, &viewer);
        let mut instance = crown.instance(view);
        instance.seed = crown.key.1;
        for (place, &(frame, weight)) in chosen.iter().enumerate() {
            if !self.frames.has(u32::try_from(frame).expect("few frames")) {
                let why = format!(
                    "this camera needs frame {frame}, which was not baked; build with it in views"
                );
                return Err(LodError::Invalid { name: "camera", why });
            }
            instance.params[place] = frame as f32;
            instance.params[place + 3] = narrowed(weight);
        }
        let corners = viewer.card(view, crown, &self.ball);
        let Self { step_count, tolerance, .. } = *self;
        let list = &mut builder.list;
        let own = &mut list.own;
        let first = u32::try_from(own.buffers.positions.len()).expect("few corners");
        let card = u32::try_from(own.buffers.indices.len() / 4).expect("few cards");
        let start = u32::try_from(own.buffers.indices.len()).expect("few corners");
        // where one frame alone is shown, the next is a jump, which the id tells
        let shown = if self.mix == Mix::Nearest { chosen[0].0 } else { 0 };
        let id = u32::try_from(shown).expect("few frames");
        push_card(&mut own.buffers, corners, viewer.toward, first, id);
        own.dirty_vertices.push(first..first + 4);
        own.dirty_indices.push(start..start + 4);
        let instances = list.instance(instance);
        let frames = list.frames(&self.frames);
        let sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: Filter::Trilinear };
        let blend = match self.drawing {
            Drawing::Test(cutoff) => Blend::Test(cutoff),
            Drawing::Coverage => Blend::Coverage,
            Drawing::Blend => Blend::Over,
        };
        let item = Item {
            primitive: Primitive::Cards,
            vertices: Source::Own,
            indices: Source::Own,
            primitives: card..card + 1,
            instances,
            surface: Surface::Parallax { frames, step_count, tolerance, sampler },
            blend,
            depth_write: blend != Blend::Over,
            slab: None,
        };
        if blend == Blend::Over {
            builder.push_blended(crown, item);
        } else {
            builder.list.items.push(item);
        }
        Ok(())
    }
}

/// Appends a card, all of whose look is in its frames.
fn push_card(buffers: &mut Buffers, corners: [DVec3; 4], toward: DVec3, first: u32, id: u32) {
    for corner in corners {
        buffers.positions.push(corner.as_vec3());
        buffers.normals.push(toward.as_vec3());
        buffers.uvs.push(Vec2::ZERO);
        buffers.base.push(Vec4::ONE);
        buffers.front.push(Vec3::ONE);
        buffers.back.push(Vec3::ONE);
    }
    buffers.indices.extend(first..first + 4);
    buffers.source_ids.push(id);
}

/// Frames and weights that a viewer sees; those of one direction as one.
fn mixed(grid: &Grid, mix: Mix, stand_ins: &[usize], viewer: &Viewer) -> Vec<(usize, f64)> {
    let direction = if grid.hemisphere { viewer.upright() } else { viewer.toward };
    let mut found: Vec<(usize, f64)> = Vec::new();
    for (frame, weight) in grid.frames(direction, mix == Mix::Nearest) {
        let frame = stand_ins[frame];
        match found.iter_mut().find(|(known, _)| *known == frame) {
            Some((_, sum)) => *sum += weight,
            None => found.push((frame, weight)),
        }
    }
    found
}

#[expect(clippy::cast_possible_truncation, reason = "in range of f32")]
fn narrowed(value: f64) -> f32 {
    value as f32
}

/// A plant's light as frames are lit by it; what a surface sees past the rest of its plant they do not
/// know.
fn light(lighting: &Lighting, name: &'static str) -> Result<Light, LodError> {
    let Lighting { occlusion, sun_direction, translucency, .. } = *lighting;
    if occlusion > 0.0 {
        let why = format!("frames that are lit anew know no occlusion, got {occlusion} of it");
        return Err(LodError::Invalid { name, why });
    }
    let Lighting { sun, sky, ground, .. } = lighting.scaled();
    Ok(Light {
        sun_direction: sun_direction.normalize().as_vec3(),
        sun: sun.as_vec3(),
        sky: sky.as_vec3(),
        ground: ground.as_vec3(),
        translucency: narrowed(translucency),
    })
}

/// Checks what [`Drawing::Test`] tests against.
///
/// # Errors
/// `cutoff` out of range.
pub fn check_cutoff(cutoff: f32) -> Result<(), LodError> {
    // at 0 every sample of a card would pass
    check_in("cutoff", cutoff, 1.0 / 255.0..=1.0)
}

fn check(params: &Params) -> Result<(), LodError> {
    check_size("resolution", params.resolution, params.resolution)?;
    check_in("parallax_steps", params.step_count, 0..=MAX_STEP_COUNT)?;
    if let Some(tolerance) = params.tolerance {
        check_in("depth_tolerance", tolerance, 1e-6..=1e6)?;
    }
    depth_map::check_bit_count(params.depth_bit_count)?;
    if let Drawing::Test(cutoff) = params.drawing {
        check_cutoff(cutoff)?;
    }
    samples::positions(params.sample_count)?;
    if params.views.as_ref().is_some_and(Vec::is_empty) {
        let why = "give at least one camera, or None for all directions";
        return Err(LodError::Empty { name: "views", why });
    }
    Ok(())
}

/// The frames to bake, rising, and the texels of their sides: no finer than the nearest view's pixels.
fn needed(
    plant: &Plant,
    params: &Params,
    ball: &Ball,
    stand_ins: &[usize],
    job: &Job,
) -> Result<(Vec<usize>, u32), LodError> {
    let Some(views) = &params.views else {
        let all = (0..stand_ins.len()).filter(|&frame| stand_ins[frame] == frame);
        return Ok((all.collect(), params.resolution));
    };
    let crown = at_home(plant.origin);
    let mut is_needed = vec![false; stand_ins.len()];
    let mut finest: f64 = 0.0;
    for (number, view) in views.iter().enumerate() {
        if number % 1024 == 0 {
            job.check()?;
        }
        let viewer = Viewer::new(view, &crown, ball);
        for (frame, _) in mixed(&params.grid, params.mix, stand_ins, &viewer) {
            is_needed[frame] = true;
        }
        let from_eye = viewer.eye.map_or(0.0, DVec3::length);
        let nearest = (from_eye - ball.radius).max(view.near);
        finest = finest.max(1.0 / view.pixel_size_at(nearest));
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let texels =
        (2.0 * ball.radius * finest).ceil().clamp(1.0, f64::from(params.resolution)) as u32;
    Ok(((0..is_needed.len()).filter(|&frame| is_needed[frame]).collect(), texels))
}

impl Representation for OctahedralImpostor {
    fn bounds(&self) -> (DVec3, DVec3) {
        let Ball { center, half, .. } = self.ball;
        (center - half, center + half)
    }

    fn foot(&self) -> DVec3 {
        self.foot
    }

    fn origin(&self) -> DVec3 {
        self.origin
    }

    fn footprint(&self) -> Footprint {
        let frame = size_of::<Option<Frame>>() as u64;
        let card = {
            let mut buffers = Buffers::default();
            push_card(&mut buffers, [DVec3::ZERO; 4], DVec3::Z, 0, 0);
            buffers.byte_count()
        };
        Footprint {
            card_count: 1,
            geometry_bytes: card + frame * self.grid.frame_count() as u64,
            texture_bytes: self.frames.byte_count(),
            ..Footprint::default()
        }
    }

    fn textures(&self) -> Vec<NamedTexture> {
        let Parts { color, depth, relit, .. } = self.frames.parts();
        let named = |name: &str, texture: &Arc<Texture>| NamedTexture {
            name: name.to_owned(),
            texture: Arc::clone(texture),
            rect: None,
        };
        let depth = Texture::new(depth.levels().iter().map(shown).collect()).expect("its levels");
        let name = if relit.is_some() { "albedo" } else { "color" };
        let mut textures =
            vec![named(name, color), named("depth: high byte red, low byte green", &depth)];
        if let Some(Relit { normal, .. }) = relit {
            let normal = Texture::new(normal.levels().to_vec()).expect("its levels");
            textures.push(named("normal, and the share of leaves in alpha", &normal));
        }
        textures
    }

    fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        _state: &mut ViewState,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        // near copies first, so that they hide what lies behind them
        crowns.iter().rev().try_for_each(|crown| self.emit_crown(view, crown, builder))
    }
}

/// A level of depths as a picture that holds all their bits.
fn shown(level: &DepthLevel) -> Image {
    let texel = |code: &u16| {
        let [high, low] = code.to_be_bytes();
        [high, low, 0, 255]
    };
    let &DepthLevel { width, height, ref codes } = level;
    Image { width, height, texels: codes.iter().map(texel).collect() }
}
