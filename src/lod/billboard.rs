//! Billboards: a whole plant as one textured quad that turns with the camera.
//!
//! Pictures are taken from all around. A view shows the nearest of them, or fades between the two that
//! it lies between: each sample shows one or the other, in shares that add up to one. The quad faces
//! the eye, or the picture plane, or turns between the two by a limited angle.
//!
//! Billboards of many plants share one texture, and all their quads are written into the frame's own
//! buffers, side by side: a forest is one item.
//!
//! This work is based on:
//! Daniel Sanchez-Crespo Dalmau. Core Techniques and Algorithms in Game Programming. 2003 (chapter 20)
//!
//! Deviations: quads have no roll, so a camera tilted sideways sees upright plants; several pictures
//! may be taken, also from above; in the wind the quad's own right is the screen's horizontal.

pub mod alignment;
mod pictures;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use glam::DVec3;

use crate::draw_list::{Blend, Buffers, Instance, Item, Primitive, Source, Surface};
use crate::error::{LodError, check_in, check_limit};
use crate::job::Job;
use crate::lod::solid::Solid;
use crate::lod::wood::Wood;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture, Representation, foot_of};
use crate::plant::Plant;
use crate::raster::samples;
use crate::texture::texture::{MAX_TEXEL_COUNT, check_size};
use crate::texture::{Filter, Format, Sampler, Texture, Wrap};
use crate::view::View;
use crate::view_state::ViewState;
use alignment::{Align, Axis, Frame, Seen};
use pictures::{CUTOFF, Picture, Pictures, Rings, Sitter};

/// More pictures on a ring, or rings, than this are taken for a mistake.
const MAX_COUNT: usize = 4096;

/// Pictures of all plants, at most: pictures of 7 x 7 texels are already too many for a texture.
const MAX_PICTURE_COUNT: u64 = 1 << 20;

/// Bytes of a picture's place: its sides and its corners in the texture.
const PICTURE_BYTES: u64 = 8 * size_of::<f32>() as u64;

/// Which pictures a view shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PictureBlend {
    /// The nearest.
    Nearest,
    /// The two nearest of a ring, each in its share of the samples.
    CrossFade,
}

/// How quads join the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drawing {
    /// Where alpha is at least one half, with depth.
    Test,
    /// In as many samples as alpha asks for, with depth.
    Coverage,
    /// Blended, far to near, without depth.
    Blend,
}

/// How the wood is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WoodAs {
    /// In the pictures.
    Picture,
    /// As a mesh beside them.
    Mesh,
}

/// How billboards are built.
#[derive(Debug, Clone)]
pub struct Params {
    /// Which way quads face.
    pub align: Align,
    /// About what they turn.
    pub axis: Axis,
    /// Pictures a ring.
    pub view_count: usize,
    /// Radians above the horizon from which pictures are taken, one a ring.
    pub elevations: Vec<f64>,
    /// Which pictures a view shows.
    pub picture_blend: PictureBlend,
    /// Most texels a picture, width and height.
    pub resolution: (u32, u32),
    /// Samples a texel.
    pub sample_count: u32,
    /// How quads join the picture.
    pub drawing: Drawing,
    /// Texel format.
    pub format: Format,
    /// Which wood is drawn.
    pub wood: Wood,
    /// And how.
    pub wood_as: WoodAs,
    /// The cameras that will look, in the plant's own world; `None` takes all pictures.
    pub views: Option<Vec<View>>,
}

impl Params {
    fn check(&self) -> Result<(), LodError> {
        check_in("view_count", self.view_count, 1..=MAX_COUNT)?;
        check_in("elevations_deg", self.elevations.len(), 1..=MAX_COUNT)?;
        for (index, &elevation) in self.elevations.iter().enumerate() {
            let degrees = elevation.to_degrees();
            check_in("elevations_deg", degrees, -90.0..=90.0)?;
            if self.elevations[..index].contains(&elevation) {
                let why = format!("{degrees} is there twice");
                return Err(LodError::Invalid { name: "elevations_deg", why });
            }
        }
        if self.axis == Axis::Vertical && self.elevations != [0.0] {
            let why =
                "a quad with a vertical axis stands for a view from the horizon: must be 0 alone";
            return Err(LodError::Invalid { name: "elevations_deg", why: why.to_owned() });
        }
        if let Align::Limited(most) = self.align {
            check_in("max_turn_deg", most.to_degrees(), 0.0..=180.0)?;
        }
        check_size("resolution", self.resolution.0, self.resolution.1)?;
        samples::positions(self.sample_count)?;
        if self.views.as_ref().is_some_and(Vec::is_empty) {
            let why = "give at least one camera, or None for all directions";
            return Err(LodError::Empty { name: "views", why });
        }
        Ok(())
    }

    /// Refuses more pictures than can be, before any is planned.
    fn check_count(&self, plant_count: usize) -> Result<(), LodError> {
        let factors = [
            ("plants", plant_count),
            ("elevations_deg", self.elevations.len()),
            ("view_count", self.view_count),
        ];
        let (name, _) = factors.into_iter().max_by_key(|&(_, count)| count).expect("three");
        let count =
            factors.into_iter().fold(1_u64, |all, (_, count)| all.saturating_mul(count as u64));
        check_limit(name, count, MAX_PICTURE_COUNT, "pictures")?;
        // with known views, pictures may be smaller and fewer
        let texels = if self.views.is_none() { pictures::texels(self.resolution) } else { 0 };
        check_limit("resolution", count * texels, MAX_TEXEL_COUNT, "texels")
    }

    /// Of pictures on both sides of a viewer, those that are shown.
    fn shown(&self, shares: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
        match (self.picture_blend, shares.last()) {
            (PictureBlend::Nearest, Some(&(nearest, _))) => vec![(nearest, 1.0)],
            _ => shares,
        }
    }
}

/// A picture as it was taken, for looking at.
#[derive(Debug, Clone, PartialEq)]
pub struct PictureFacts {
    /// Its number: ring by ring, by rising azimuth.
    pub number: usize,
    /// What it shows, relative to the plant's origin; its plane passes through the plant's centre.
    pub corners: [DVec3; 4],
    /// Upper left texel in the texture, width and height.
    pub texels: [u32; 4],
}

/// The technique's representation of a plant.
#[derive(Debug)]
pub struct Billboard {
    params: Params,
    rings: Rings,
    pictures: Pictures,
    texture: Arc<Texture>,
    /// This plant's part of the texture.
    texture_bytes: u64,
    /// The wood that stays a mesh.
    solid: Solid,
    /// Of the first picture's triangles: after those of the mesh.
    first_id: u32,
    center: DVec3,
    radius: f64,
    bounds: (DVec3, DVec3),
    foot: DVec3,
    origin: DVec3,
}

impl Billboard {
    /// Takes pictures of a plant.
    ///
    /// # Errors
    /// `foliage` if nothing would be seen; any parameter that is out of range; `view_count` or
    /// `elevations_deg`, whichever is more, if there are too many pictures; `resolution` if they do not
    /// fit into one texture; [`LodError::Cancelled`].
    pub fn build(plant: &Plant, params: &Params, job: &Job) -> Result<Self, LodError> {
        let mut built = Self::forest(&[plant], params, job)?;
        Ok(built.pop().expect("one for each plant"))
    }

    /// Takes pictures of several plants, in one texture.
    ///
    /// # Errors
    /// As [`Billboard::build`]; `plants` without any, or with so many that there are too many pictures.
    pub fn forest(plants: &[&Plant], params: &Params, job: &Job) -> Result<Vec<Self>, LodError> {
        params.check()?;
        if plants.is_empty() {
            return Err(LodError::Empty { name: "plants", why: "a forest needs at least one" });
        }
        params.check_count(plants.len())?;
        let rings = Rings::new(params.view_count, &params.elevations)?;
        let sitters: Vec<Sitter<'_>> = plants
            .iter()
            .map(|plant| Sitter::new(plant, params, job))
            .collect::<Result<_, LodError>>()?;
        let (pictures, texture) = pictures::take(&sitters, &rings, params, job)?;
        let texels = |pictures: &Pictures| -> u64 {
            let area = |picture: &Picture| {
                let [_, _, width, height] = picture.texels;
                u64::from(width) * u64::from(height)
            };
            pictures.iter().flatten().map(area).sum()
        };
        let all: u64 = pictures.iter().map(texels).sum();
        let mut used = 0;
        let mut built = Vec::new();
        for ((plant, sitter), pictures) in plants.iter().zip(&sitters).zip(pictures) {
            // rounded so that the parts add up to the texture
            let part = |used: u64| {
                let part = u128::from(texture.byte_count()) * u128::from(used) / u128::from(all);
                u64::try_from(part).expect("less than all of it")
            };
            let before = part(used);
            used += texels(&pictures);
            let mesh = (&sitter.mesh, Buffers::ids_from(0, &sitter.mesh));
            built.push(Self {
                params: params.clone(),
                rings: rings.clone(),
                bounds: bounds(sitter, params.axis, &pictures),
                pictures,
                texture: Arc::clone(&texture),
                texture_bytes: part(used) - before,
                first_id: u32::try_from(sitter.mesh.triangles.len()).expect("checked by the plant"),
                solid: Solid::new(&[mesh], &plant.materials, Filter::Bilinear, job)?,
                center: sitter.center,
                radius: sitter.radius,
                foot: foot_of(sitter.boxes()),
                origin: plant.origin,
            });
        }
        Ok(built)
    }

    /// The pictures that were taken.
    pub fn pictures(&self) -> Vec<PictureFacts> {
        let facts = |(number, picture): (usize, &Option<Picture>)| {
            let picture = picture.as_ref()?;
            let Frame { right, up, .. } = picture.frame;
            let corners = picture.corners().map(|[x, y]| self.center + right * x + up * y);
            Some(PictureFacts { number, corners, texels: picture.texels })
        };
        self.pictures.iter().enumerate().filter_map(facts).collect()
    }

    /// The quads that a copy is drawn as in a view: for each its picture's number, the share of samples
    /// that show it (negative: those that the one before it leaves), its corners in the world,
    /// counter-clockwise from the lower left as the plant sees it, and its normal.
    ///
    /// # Errors
    /// `camera` if a picture is needed that was not taken.
    pub fn quads(&self, view: &View, crown: &Crown) -> Result<Vec<Quad>, LodError> {
        let seen = Seen::new(view, crown, self.center, self.radius);
        let frame = Frame::new(self.params.align, self.params.axis, &seen);
        let Frame { right, up, toward } = frame;
        let placed = &crown.world_from_local;
        let lean = Lean::new(view, crown, &frame, (self.foot - self.center).dot(up));
        let mut shown = self.params.shown(self.rings.shares(&seen));
        // not the nearer first: where the two are equal, they would exchange their samples
        shown.sort_by_key(|&(number, _)| number);
        let mut quads = Vec::new();
        let mut left = 1.0_f32;
        for (number, share) in shown {
            let Some(picture) = &self.pictures[number] else {
                let why = format!(
                    "this camera needs picture {number}, which was not taken; build with it in views"
                );
                return Err(LodError::Invalid { name: "camera", why });
            };
            let corners = picture.corners().map(|[x, y]| {
                placed.transform_point3(self.center + right * x + up * y) + lean.at(y)
            });
            let fade = if left == 1.0 { narrow(share) } else { -left };
            left -= fade.abs();
            let normal = placed.transform_vector3(toward).normalize();
            quads.push(Quad { number, fade, corners, normal });
        }
        Ok(quads)
    }
}

#[expect(clippy::cast_possible_truncation, reason = "a share")]
fn narrow(share: f64) -> f32 {
    share as f32
}

/// A quad of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quad {
    /// Of the picture that it shows.
    pub number: usize,
    /// As an instance's.
    pub fade: f32,
    /// In the world.
    pub corners: [DVec3; 4],
    /// Unit vector.
    pub normal: DVec3,
}

/// How far the wind moves the points of a quad.
struct Lean {
    /// Metres in the world a metre of the quad's own above the foot.
    across: DVec3,
    /// Where the foot is along the quad's up.
    foot: f64,
}

impl Lean {
    fn new(view: &View, crown: &Crown, frame: &Frame, foot: f64) -> Self {
        let Some(gust) = crown.wind else { return Self { across: DVec3::ZERO, foot } };
        let right = crown.world_from_local.transform_vector3(frame.right).normalize();
        let stretch = crown.world_from_local.transform_vector3(frame.up).length();
        // what blows past the quad does not move it
        let along = match gust.wind.toward {
            Some(toward) => right.dot(toward),
            None => right.dot(gust.toward(view)).signum(),
        };
        Self { across: right * (gust.slope() * along * stretch), foot }
    }

    fn at(&self, height: f64) -> DVec3 {
        self.across * (height - self.foot)
    }
}

/// A box around the quads of all views, and the wood.
fn bounds(sitter: &Sitter<'_>, axis: Axis, pictures: &Pictures) -> (DVec3, DVec3) {
    let (mut across, mut low, mut high) = (0.0_f64, 0.0_f64, 0.0_f64);
    for [left, right, bottom, top] in pictures.iter().flatten().map(|picture| picture.sides) {
        across = across.max(right).max(-left);
        (low, high) = (low.min(bottom), high.max(top));
    }
    let (least, most) = match axis {
        Axis::Vertical => (DVec3::new(-across, low, -across), DVec3::new(across, high, across)),
        Axis::Free => {
            let reach = across.hypot(high.max(-low));
            (DVec3::splat(-reach), DVec3::splat(reach))
        }
    };
    let quads = (sitter.center + least, sitter.center + most);
    let meshes = sitter.boxes().map(|(low, high)| (low.as_dvec3(), high.as_dvec3()));
    meshes.fold(quads, |a, b| (a.0.min(b.0), a.1.max(b.1)))
}

/// Puts quads into a frame's own buffers.
struct Writer<'a> {
    lod: &'a Billboard,
    view: &'a View,
    builder: &'a mut ListBuilder,
    surface: Surface,
}

impl Writer<'_> {
    /// Vertices and indices in the frame's own buffers.
    fn ends(&self) -> [u32; 2] {
        let buffers = &self.builder.list.own.buffers;
        let counts = [buffers.positions.len(), buffers.indices.len()];
        counts.map(|count| u32::try_from(count).expect("fits in u32"))
    }

    /// Appends a quad's vertices and two triangles, and gives the first.
    fn push(&mut self, crown: &Crown, quad: &Quad) -> u32 {
        let picture = self.lod.pictures[quad.number].as_ref().expect("checked with the quad");
        let own = &mut self.builder.list.own;
        let buffers = &mut own.buffers;
        let first = u32::try_from(buffers.positions.len()).expect("fits in u32");
        let triangle = u32::try_from(buffers.indices.len() / 3).expect("fits in u32");
        for (corner, uv) in quad.corners.iter().zip(picture.corner_uvs()) {
            buffers.positions.push((*corner - self.view.eye).as_vec3());
            buffers.normals.push(quad.normal.as_vec3());
            buffers.uvs.push(uv);
            // white: the picture is lit
            buffers.base.push(crown.tint.extend(1.0));
            buffers.front.push(crown.tint);
            buffers.back.push(crown.tint);
        }
        buffers.indices.extend([0, 1, 2, 0, 2, 3].map(|corner| first + corner));
        let id = self.lod.first_id + u32::try_from(quad.number).expect("few pictures");
        buffers.source_ids.extend([id; 2]);
        triangle
    }

    fn emit(&mut self, crown: &Crown) -> Result<(), LodError> {
        for quad in self.lod.quads(self.view, crown)? {
            let triangle = self.push(crown, &quad);
            let instances = if quad.fade == 1.0 {
                self.builder.at_eye()
            } else {
                // neighbours fade in other patterns
                let at_eye = Instance::at_eye();
                let faded = Instance { fade: quad.fade, seed: crown.key.1, ..at_eye };
                self.builder.list.instance(faded)
            };
            let blend = match self.lod.params.drawing {
                Drawing::Test => Blend::Test(CUTOFF),
                Drawing::Coverage => Blend::Coverage,
                Drawing::Blend => Blend::Over,
            };
            let item = Item {
                primitive: Primitive::Triangles,
                vertices: Source::Own,
                indices: Source::Own,
                primitives: triangle..triangle + 2,
                instances,
                surface: self.surface,
                blend,
                depth_write: blend != Blend::Over,
                slab: None,
            };
            if blend == Blend::Over {
                self.builder.push_blended(crown, item);
            } else {
                self.builder.list.items.push(item);
            }
        }
        Ok(())
    }
}

impl Representation for Billboard {
    fn bounds(&self) -> (DVec3, DVec3) {
        self.bounds
    }

    fn foot(&self) -> DVec3 {
        self.foot
    }

    fn sways(&self) -> bool {
        true
    }

    fn origin(&self) -> DVec3 {
        self.origin
    }

    fn footprint(&self) -> Footprint {
        let solid = self.solid.footprint();
        let count = self.pictures.iter().flatten().count() as u64;
        Footprint {
            card_count: count,
            geometry_bytes: solid.geometry_bytes + count * PICTURE_BYTES,
            texture_bytes: solid.texture_bytes + self.texture_bytes,
            ..solid
        }
    }

    fn textures(&self) -> Vec<NamedTexture> {
        let count = self.pictures.iter().flatten().count();
        let (name, texture) = (format!("{count} pictures"), Arc::clone(&self.texture));
        let mut named = vec![NamedTexture { name, texture, rect: None }];
        named.extend(self.solid.textures());
        named
    }

    fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        if !self.solid.is_empty() {
            let leaning: Vec<Crown> = crowns.iter().map(|c| c.leaning(view, self.foot)).collect();
            self.solid.emit(view, &leaning, state, builder);
        }
        let sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: Filter::Trilinear };
        let surface = Surface::Textured { texture: builder.list.texture(&self.texture), sampler };
        let mut writer = Writer { lod: self, view, builder, surface };
        // near copies first, so that they hide what lies behind them; blended ones are sorted anyway
        let before = writer.ends();
        crowns.iter().rev().try_for_each(|crown| writer.emit(crown))?;
        let after = writer.ends();
        let own = &mut builder.list.own;
        own.dirty_vertices.push(before[0]..after[0]);
        own.dirty_indices.push(before[1]..after[1]);
        Ok(())
    }
}
