//! An orthographic picture of chosen primitives as a texture: how every baker makes its cards.
//!
//! A bake goes through the same renderer as a frame, so both share one accuracy. It is filtered with
//! many samples a texel, premultiplied and linear; empty texels take a neighbour's colour; and its
//! levels keep mean alpha or coverage, by how the card will be drawn.

use std::sync::{Arc, Mutex, PoisonError};

use glam::{DVec3, Vec4};

use crate::draw_list::DrawList;
use crate::error::{LodError, check_in};
use crate::job::Job;
use crate::raster::{Frame, Outputs, Renderer, Settings};
use crate::texture::dilate::dilated;
use crate::texture::linear::LinearImage;
use crate::texture::mips::{self, Keep};
use crate::texture::{Format, Image, Texture};
use crate::view::{Projection, View};

/// A rectangle in space that a texture covers, seen from `toward`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BakeRect {
    /// Its middle.
    pub center: DVec3,
    /// Unit vector along the texture's rows.
    pub right: DVec3,
    /// Unit vector to the texture's top.
    pub up: DVec3,
    /// Metres along `right`.
    pub width: f64,
    /// Metres along `up`.
    pub height: f64,
    /// Everything drawn lies within this distance of the plane.
    pub reach: f64,
}

impl BakeRect {
    /// Unit vector from the plane towards its viewer.
    pub fn toward(&self) -> DVec3 {
        self.right.cross(self.up)
    }

    /// The parallel view that fills a texture of `size` texels with the rectangle.
    ///
    /// Depth is [`BakeRect::depth_of`] the signed distance from the plane.
    ///
    /// # Errors
    /// If `size` or the rectangle is out of range.
    pub fn view(&self, size: (u32, u32)) -> Result<View, LodError> {
        let distance = self.eye_distance();
        let eye = self.center + self.toward() * distance;
        let projection = Projection::Orthographic { height: self.height };
        let near = distance * 1e-3;
        let mut view = View::new(eye, self.center, self.up, projection, size, near)?;
        view.pixel_aspect = (f64::from(size.0) / self.width) / (f64::from(size.1) / self.height);
        Ok(view)
    }

    /// Depth in [`BakeRect::view`] of points `offset` metres in front of the plane.
    pub fn depth_of(&self, offset: f64) -> f64 {
        self.eye_distance() - offset
    }

    /// The four corners, counter-clockwise from the texture's lower left.
    pub fn corners(&self) -> [DVec3; 4] {
        let (across, along) = (self.right * (self.width * 0.5), self.up * (self.height * 0.5));
        [
            self.center - across - along,
            self.center + across - along,
            self.center + across + along,
            self.center - across + along,
        ]
    }

    fn eye_distance(&self) -> f64 {
        2.0 * self.reach.max(self.width).max(self.height)
    }
}

/// Renderers that bakes side by side take in turn: as many as there are bakes at a time, each with the
/// planes that it has allocated before.
#[derive(Debug, Default)]
pub(crate) struct Renderers {
    idle: Mutex<Vec<Renderer>>,
}

impl Renderers {
    /// Draws with a renderer that nothing else has meanwhile. One that has failed is not used again.
    ///
    /// # Errors
    /// What `draw` returns.
    pub(crate) fn with<T>(
        &self,
        draw: impl FnOnce(&mut Renderer) -> Result<T, LodError>,
    ) -> Result<T, LodError> {
        // never held while something is drawn
        let idle = || self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        let mut renderer = idle().pop().unwrap_or_default();
        let drawn = draw(&mut renderer)?;
        idle().push(renderer);
        Ok(drawn)
    }
}

/// Draws a list that was emitted for `rect.view(size)` and returns premultiplied linear texels.
///
/// # Errors
/// As the renderer's, `samples` out of range among them.
pub fn bake(
    renderer: &mut Renderer,
    list: &DrawList,
    view: &View,
    sample_count: u32,
    job: &Job,
) -> Result<LinearImage, LodError> {
    let frame = bake_frame(renderer, list, view, sample_count, Outputs::COLOR, job)?;
    Ok(LinearImage { width: view.width, height: view.height, texels: frame.color })
}

/// As [`bake`], with the planes that are asked for.
///
/// # Errors
/// As [`bake`].
pub fn bake_frame(
    renderer: &mut Renderer,
    list: &DrawList,
    view: &View,
    sample_count: u32,
    outputs: Outputs,
    job: &Job,
) -> Result<Frame, LodError> {
    check_in("samples", sample_count, 1..=crate::raster::samples::MAX_SAMPLE_COUNT)?;
    let settings =
        Settings { sample_count, outputs, background: Vec4::ZERO, counts_fragments: false };
    renderer.render(list, view, &settings, job)
}

/// Dilates, encodes and builds the levels of a bake.
///
/// # Errors
/// If the image's size is out of range; [`LodError::Cancelled`].
pub fn finish(
    image: &LinearImage,
    keep: Keep,
    format: Format,
    job: &Job,
) -> Result<Arc<Texture>, LodError> {
    stored(levels(image, keep, job)?, format, job)
}

/// The levels of a bake, dilated, before they are stored in a format.
///
/// # Errors
/// As [`finish`].
pub fn levels(image: &LinearImage, keep: Keep, job: &Job) -> Result<Vec<Image>, LodError> {
    let check = || job.check();
    mips::levels(dilated(image, &check)?, keep, &check)
}

/// A texture of levels as a format gives them back, which knows the format's bytes.
///
/// # Errors
/// If a level has a size that it should not have; [`LodError::Cancelled`].
pub fn stored(mut levels: Vec<Image>, format: Format, job: &Job) -> Result<Arc<Texture>, LodError> {
    format.store(&mut levels, &|| job.check())?;
    let byte_count = format.byte_count(&levels);
    Ok(Texture::with_byte_count(levels, byte_count)?.decoded_ahead().bounded())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_land_on_the_pictures_corners() {
        let rect = BakeRect {
            center: DVec3::new(1.0, 2.0, 3.0),
            right: DVec3::NEG_Z,
            up: DVec3::Y,
            width: 4.0,
            height: 1.0,
            reach: 5.0,
        };
        assert_eq!(rect.toward(), DVec3::X, "seen from +x");
        let view = rect.view((8, 16)).expect("valid");
        let [lower_left, _, upper_right, _] = rect.corners();
        let (pixel, depth) = view.project(lower_left).expect("parallel");
        assert!((pixel - glam::DVec2::new(0.0, 16.0)).length() < 1e-12, "{pixel}");
        assert!((depth - rect.depth_of(0.0)).abs() < 1e-12, "on the plane");
        let (pixel, _) = view.project(upper_right).expect("parallel");
        assert!((pixel - glam::DVec2::new(8.0, 0.0)).length() < 1e-12, "{pixel}");
        let (_, depth) = view.project(rect.center + DVec3::X).expect("parallel");
        assert!((depth - rect.depth_of(1.0)).abs() < 1e-12, "one metre nearer");
    }

    #[test]
    fn renderers_are_taken_in_turn() {
        let renderers = Renderers::default();
        let idle = || renderers.idle.lock().expect("no panic").len();
        let inside = renderers.with(|_| {
            // one inside the other, as on two threads
            let other = renderers.with(|_| Ok(idle()))?;
            Ok((other, idle()))
        });
        assert_eq!(inside.expect("nothing fails"), (0, 1), "the inner is back before the outer");
        assert_eq!(idle(), 2, "as many as there were at a time");
        assert_eq!(renderers.with(|_| Ok(idle())).expect("nothing fails"), 1, "one of them again");
        let failed: Result<(), LodError> = renderers.with(|_| Err(LodError::Cancelled));
        assert!(failed.is_err(), "its own error");
        assert_eq!(idle(), 1, "what failed is gone");
    }

    #[test]
    fn bytes_are_those_of_the_format() {
        let image = LinearImage { width: 2, height: 2, texels: vec![Vec4::ONE; 4] };
        let texture =
            finish(&image, Keep::MeanAlpha, Format::Rgb5a1, &Job::default()).expect("valid");
        assert_eq!(texture.byte_count(), 5 * 2, "four texels and one");
    }
}
