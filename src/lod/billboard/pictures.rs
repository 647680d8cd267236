//! A billboard's pictures: from where they are taken, and the one texture that they all share.
//!
//! Pictures stand on rings around the plant, evenly in azimuth. Each is a parallel view that fits what
//! it shows. All pictures of all plants go into one atlas, so that a forest is drawn with one texture.
//!
//! The mean alpha of a picture is the area that it covers. A test at one half would lose a thin crown and
//! fill a dense one; so the alpha of pictures that are tested is scaled until they cover as much as
//! they should, before their levels are made to keep that.

use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec2};

use crate::bake::{self, BakeRect, bake};
use crate::draw_list::Buffers;
use crate::error::{LodError, check_limit};
use crate::job::{ELEMENTS_PER_CHECK, Job};
use crate::lod::billboard::alignment::{Frame, Seen};
use crate::lod::billboard::{Drawing, Params, WoodAs};
use crate::lod::leaves::LEAST_SIZE;
use crate::lod::solid::Solid;
use crate::lod::view_blend::{ViewBlend, circle};
use crate::lod::{Crown, ListBuilder};
use crate::plant::{Mesh, Plant};
use crate::raster::Renderer;
use crate::texture::atlas::Atlas;
use crate::texture::mips::{self, Keep};
use crate::texture::texture::MAX_TEXEL_COUNT;
use crate::texture::{Filter, Texture};
use crate::view::View;
use crate::view_state::ViewState;

/// Alpha from which a tested billboard is there.
pub(super) const CUTOFF: f32 = 0.5;

/// From where pictures are taken.
#[derive(Debug, Clone)]
pub(super) struct Rings {
    /// Radians above the horizon, one a ring.
    elevations: Vec<f64>,
    blend: ViewBlend,
}

impl Rings {
    pub(super) fn new(view_count: usize, elevations: &[f64]) -> Result<Self, LodError> {
        Ok(Self {
            elevations: elevations.to_vec(),
            blend: ViewBlend::new(&circle(view_count), None)?,
        })
    }

    /// The frame of each picture, ring by ring.
    pub(super) fn frames(&self) -> impl Iterator<Item = Frame> {
        self.elevations.iter().flat_map(|&elevation| {
            let (sin, cos) = (libm::sin(elevation), libm::cos(elevation));
            self.blend.directions().iter().map(move |&level| {
                let right = DVec3::Y.cross(level);
                let toward = level * cos + DVec3::Y * sin;
                Frame { right, up: toward.cross(right), toward }
            })
        })
    }

    /// Pictures to show, with shares that add up to 1, the largest last: those on both sides of the
    /// viewer, on the ring whose elevation is nearest (ties to the first).
    pub(super) fn shares(&self, seen: &Seen) -> Vec<(usize, f64)> {
        let elevation = libm::asin(seen.eye.y.clamp(-1.0, 1.0));
        let distance = |&(_, ring): &(usize, &f64)| (ring - elevation).abs();
        let rings = self.elevations.iter().enumerate();
        let nearest = rings.min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let first = nearest.expect("there is a ring").0 * self.blend.directions().len();
        let shares = self.blend.shares(seen.eye, seen.up);
        shares.into_iter().map(|(number, share)| (first + number, share)).collect()
    }
}

/// A picture of the plant.
#[derive(Debug, Clone)]
pub(super) struct Picture {
    /// How the camera stood that took it.
    pub(super) frame: Frame,
    /// Metres from the plant's centre to its left, right, lower and upper side.
    pub(super) sides: [f64; 4],
    /// Its upper left and lower right corner in the texture.
    pub(super) uvs: [Vec2; 2],
    /// Upper left texel, width and height.
    pub(super) texels: [u32; 4],
}

impl Picture {
    /// Corners in a frame, right and up from the centre: counter-clockwise from the lower left.
    pub(super) fn corners(&self) -> [[f64; 2]; 4] {
        let [left, right, low, high] = self.sides;
        [[left, low], [right, low], [right, high], [left, high]]
    }

    /// Texture coordinates of the corners.
    pub(super) fn corner_uvs(&self) -> [Vec2; 4] {
        let [upper_left, lower_right] = self.uvs;
        let (left, top, right, bottom) = (upper_left.x, upper_left.y, lower_right.x, lower_right.y);
        [
            Vec2::new(left, bottom),
            Vec2::new(right, bottom),
            Vec2::new(right, top),
            Vec2::new(left, top),
        ]
    }
}

/// What is taken pictures of.
pub(super) struct Sitter<'a> {
    plant: &'a Plant,
    /// The wood that shows in pictures, if any.
    wood: Mesh,
    /// The wood that stays a mesh, if any.
    pub(super) mesh: Mesh,
    /// Middle of the box around what pictures show, relative to the plant's origin.
    pub(super) center: DVec3,
    /// Largest distance from there of what pictures show.
    pub(super) radius: f64,
}

impl<'a> Sitter<'a> {
    pub(super) fn new(plant: &'a Plant, params: &Params, job: &Job) -> Result<Self, LodError> {
        let wood = params.wood.of(plant)?;
        let (wood, mesh) = match params.wood_as {
            WoodAs::Picture => (wood, Mesh::default()),
            WoodAs::Mesh => (Mesh::default(), wood),
        };
        let boxes = [&plant.foliage.mesh, &wood].into_iter().filter_map(Mesh::bounds);
        let Some((low, high)) = boxes.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))) else {
            let why = "without leaves, and with its wood left out or kept as a mesh, a plant has no \
                       picture";
            return Err(LodError::Empty { name: "foliage", why });
        };
        let center = (low.as_dvec3() + high.as_dvec3()) * 0.5;
        let mut sitter = Self { plant, wood, mesh, center, radius: 0.0 };
        let mut radius_sq = 0.0_f64;
        sitter.each_corner(job, |p| radius_sq = radius_sq.max(p.length_squared()))?;
        sitter.radius = radius_sq.sqrt();
        Ok(sitter)
    }

    /// Boxes around all that is drawn, mesh and pictures.
    pub(super) fn boxes(&self) -> impl Iterator<Item = (glam::Vec3, glam::Vec3)> {
        [&self.plant.foliage.mesh, &self.wood, &self.mesh].into_iter().filter_map(Mesh::bounds)
    }

    /// Corners of all triangles that pictures show, relative to the centre.
    fn each_corner(&self, job: &Job, mut see: impl FnMut(DVec3)) -> Result<(), LodError> {
        for mesh in [&self.plant.foliage.mesh, &self.wood] {
            for triangles in mesh.triangles.chunks(ELEMENTS_PER_CHECK) {
                job.check()?;
                for &vertex in triangles.iter().flatten() {
                    see(mesh.positions[vertex as usize].as_dvec3() - self.center);
                }
            }
        }
        Ok(())
    }

    /// The rectangle that fits what a frame shows, and its sides from the centre.
    fn rect(&self, frame: &Frame, job: &Job) -> Result<(BakeRect, [f64; 4]), LodError> {
        let mut sides = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        let mut reach = 0.0_f64;
        self.each_corner(job, |p| {
            let (x, y) = (p.dot(frame.right), p.dot(frame.up));
            sides = [sides[0].min(x), sides[1].max(x), sides[2].min(y), sides[3].max(y)];
            reach = reach.max(p.dot(frame.toward).abs());
        })?;
        // what is seen on edge needs a rectangle too
        let least = LEAST_SIZE.max(1e-6 * self.radius);
        let [left, right] = widened(sides[0], sides[1], least);
        let [low, high] = widened(sides[2], sides[3], least);
        let rect = BakeRect {
            center: self.center
                + frame.right * ((left + right) * 0.5)
                + frame.up * ((low + high) * 0.5),
            right: frame.right,
            up: frame.up,
            width: right - left,
            height: high - low,
            reach,
        };
        Ok((rect, [left, right, low, high]))
    }

    /// Pixels a metre that the nearest of the views has on each picture; `None` where no view shows it.
    fn needed(&self, rings: &Rings, count: usize, params: &Params) -> Vec<Option<f64>> {
        let Some(views) = &params.views else {
            return vec![Some(f64::INFINITY); count];
        };
        // placed as a scene places a single copy, so that both choose the same pictures
        let crown = Crown::alone(DAffine3::from_translation(self.plant.origin));
        let mut needed: Vec<Option<f64>> = vec![None; count];
        for view in views {
            let seen = Seen::new(view, &crown, self.center, self.radius);
            let from_eye = crown.local_eye(view).distance(self.center);
            let nearest = (from_eye - self.radius).max(view.near);
            let per_metre = 1.0 / view.pixel_size_at(nearest);
            for (number, _) in params.shown(rings.shares(&seen)) {
                let most = needed[number].get_or_insert(0.0);
                *most = most.max(per_metre);
            }
        }
        needed
    }
}

fn widened(low: f64, high: f64, least: f64) -> [f64; 2] {
    if high - low >= least {
        return [low, high];
    }
    let middle = (low + high) * 0.5;
    [middle - least * 0.5, middle + least * 0.5]
}

/// A picture to be taken.
struct Planned {
    sitter: usize,
    number: usize,
    frame: Frame,
    rect: BakeRect,
    sides: [f64; 4],
    size: (u32, u32),
}

/// The pictures of one plant, by number; `None` where no view needs one.
pub(super) type Pictures = Vec<Option<Picture>>;

/// Texels that a picture takes of a texture, at least: its own, and what keeps it apart.
pub(super) fn texels((width, height): (u32, u32)) -> u64 {
    (u64::from(width) + 1) * (u64::from(height) + 1)
}

/// Takes all pictures of all plants, in one texture.
pub(super) fn take(
    sitters: &[Sitter<'_>],
    rings: &Rings,
    params: &Params,
    job: &Job,
) -> Result<(Vec<Pictures>, Arc<Texture>), LodError> {
    let frames: Vec<Frame> = rings.frames().collect();
    let mut planned: Vec<Planned> = Vec::new();
    let mut texel_count = 0;
    for (number_of_sitter, sitter) in sitters.iter().enumerate() {
        let needed = sitter.needed(rings, frames.len(), params);
        for (number, (&frame, needed)) in frames.iter().zip(needed).enumerate() {
            let Some(per_metre) = needed else { continue };
            let (rect, sides) = sitter.rect(&frame, job)?;
            let side = |metres: f64, most: u32| {
                let asked = (per_metre * metres).ceil().clamp(1.0, f64::from(most));
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "clamped"
                )]
                let side = asked as u32;
                side
            };
            let (wide, high) = params.resolution;
            let size = (side(rect.width, wide), side(rect.height, high));
            texel_count += texels(size);
            check_limit("resolution", texel_count, MAX_TEXEL_COUNT, "texels")?;
            planned.push(Planned { sitter: number_of_sitter, number, frame, rect, sides, size });
        }
    }
    let sizes: Vec<(u32, u32)> = planned.iter().map(|picture| picture.size).collect();
    let atlas = Atlas::new("resolution", &sizes)?;
    job.begin(planned.len() as u64);
    let mut pictures: Vec<Pictures> = vec![vec![None; frames.len()]; sitters.len()];
    let mut levels = atlas.levels();
    let mut renderer = Renderer::default();
    let mut solids = (usize::MAX, None);
    for (place, picture) in planned.iter().enumerate() {
        job.check()?;
        if solids.0 != picture.sitter {
            let Sitter { plant, wood, .. } = &sitters[picture.sitter];
            let meshes = [wood, &plant.foliage.mesh].map(|mesh| (mesh, Buffers::ids_from(0, mesh)));
            let solid = Solid::new(&meshes, &plant.materials, Filter::Bilinear, job)?;
            solids = (picture.sitter, Some(solid));
        }
        let solid = solids.1.as_ref().expect("made above");
        let view = picture.rect.view(picture.size)?;
        let image = bake(&mut renderer, &list_of(solid, &view), &view, params.sample_count, job)?;
        let (keep, image) = match params.drawing {
            Drawing::Coverage | Drawing::Blend => (Keep::MeanAlpha, image),
            Drawing::Test => {
                let covering = mips::with_mean_as_coverage(&image, CUTOFF, &|| job.check())?;
                (Keep::Coverage { cutoff: CUTOFF }, covering)
            }
        };
        let made = bake::levels(&atlas.padded(place, &image), keep, job)?;
        atlas.put(place, &made, &mut levels);
        let ([x, y], (width, height)) = (atlas.places[place], picture.size);
        pictures[picture.sitter][picture.number] = Some(Picture {
            frame: picture.frame,
            sides: picture.sides,
            uvs: [[0.0; 2], [1.0; 2]].map(|share| {
                let [u, v] = atlas.uv(place, share);
                #[expect(clippy::cast_possible_truncation, reason = "texture coordinates are f32")]
                let uv = Vec2::new(u as f32, v as f32);
                uv
            }),
            texels: [x, y, width, height],
        });
        job.advance();
    }
    Ok((pictures, bake::stored(levels, params.format, job)?))
}

/// The list that draws a plant as it is.
fn list_of(solid: &Solid, view: &View) -> crate::draw_list::DrawList {
    let mut builder = ListBuilder::default();
    let crown = Crown::alone(DAffine3::IDENTITY);
    solid.emit(view, &[crown], &mut ViewState::default(), &mut builder);
    builder.finish()
}
