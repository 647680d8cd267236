//! The brute-force twin of the renderer: which sample sees which triangle?
//!
//! The twin shares nothing with the renderer but the definition of the picture: where a view's pixels
//! are, sample positions, corners snapped to 1/256 pixel with half a step rounding up, the top-left
//! rule, the nearest depth, the earlier of equals. It asks every triangle at every sample. Where the
//! soup's numbers make the renderer's f32 exact, the twin's edge functions are integers and coverage
//! must agree sample by sample. Elsewhere, and for depths, each tolerance follows from the rounding
//! of the numbers at hand.
//!
//! Each triangle's colour is a digit of its own in the picture's sum, so that one frame tells how many
//! of a pixel's samples see which triangle.

use glam::{DAffine3, DVec2, DVec3, Vec2, Vec3, Vec4};

use crate::draw_list::{Blend, Buffers, DrawList, Geometry, Instance, Item, Primitive, Surface};
use crate::job::{self, Job};
use crate::raster::samples::{self, SUBPIXEL_COUNT};
use crate::raster::{EMPTY_ID, Frame, Outputs, Renderer, Settings};
use crate::view::{Projection, View};

/// Pixels a metre at depth 1 of a perspective view of 90 degrees.
const FOCAL: f64 = 16.0;

/// Triangles a soup has at most: twelve digits fit the three channels.
pub(super) const MAX_TRIANGLE_COUNT: usize = 12;

/// Base of the digits in which a channel counts samples: more than the most samples a pixel.
const DIGIT: f32 = 32.0;

/// Half the spacing of f32 numbers above 1.
const ROUNDING: f64 = 1.0 / 16_777_216.0;

/// Rounding errors that one result may gather: a dozen operations, each off by half a unit.
const OPERATIONS: f64 = 12.0;

/// How far snapping moves an edge at most: half a step on both axes, and a little.
const SNAP_PX: f64 = 0.75 / 256.0;

/// A corner on the picture. Its key is linear there and grows towards the viewer.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Corner {
    /// x and y in pixels from the picture's middle, and 1: times depth in perspective.
    homogeneous: DVec3,
    depth: f64,
    /// The key times the last of `homogeneous`: 1, or -depth in a parallel view.
    key: f64,
    /// Largest rounding error of a pixel coordinate, and of the key.
    error_px: f64,
    key_error: f64,
}

/// What to draw, and how.
#[derive(Clone, Debug)]
pub(super) struct Soup {
    pub(super) view: View,
    pub(super) triangles: Vec<[Vec3; 3]>,
    pub(super) sample_count: u32,
    /// Whether the renderer's f32 pixels are exact, so that coverage must be.
    pub(super) exact: bool,
}

/// A triangle as the twin sees it.
struct Placed {
    corners: [Corner; 3],
    /// In 1/256 pixel from the top left; only used where they are exact.
    snapped: [[i64; 2]; 3],
    in_front: bool,
    /// The same corners as an earlier triangle's: never seen.
    is_copy: bool,
}

/// What the twin knows of a triangle at a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Hit {
    triangle: usize,
    /// Else the sample lies within rounding of the triangle's rim.
    sure: bool,
    /// The key lies in this range.
    low: f64,
    high: f64,
}

impl Soup {
    fn middle(&self) -> DVec2 {
        DVec2::new(f64::from(self.view.width), f64::from(self.view.height)) * 0.5
    }

    fn corner(&self, position: Vec3) -> Corner {
        let relative = position.as_dvec3() - self.view.eye;
        // sums of this size are rounded on the way
        let size = position.as_dvec3().abs().element_sum() + self.view.eye.abs().element_sum();
        let across = relative.dot(self.view.right);
        let down = -relative.dot(self.view.up);
        let depth = -relative.dot(self.view.back);
        match self.view.projection {
            Projection::Orthographic { height } => {
                let scale = f64::from(self.view.height) / height;
                let rounding = if self.exact { 0.0 } else { OPERATIONS * ROUNDING * size };
                Corner {
                    homogeneous: DVec3::new(across * scale, down * scale, 1.0),
                    depth,
                    key: -depth,
                    error_px: rounding * scale,
                    key_error: rounding,
                }
            }
            Projection::Perspective { .. } => {
                let rounding =
                    if self.exact { 0.0 } else { OPERATIONS * ROUNDING * size / depth.abs() };
                let slope = across.abs().max(down.abs()) / depth.abs();
                Corner {
                    homogeneous: DVec3::new(across * FOCAL, down * FOCAL, depth),
                    depth,
                    key: 1.0,
                    error_px: rounding * (1.0 + slope) * FOCAL,
                    key_error: rounding / depth.abs(),
                }
            }
        }
    }

    fn placed(&self) -> Vec<Placed> {
        let place = |(number, triangle): (usize, &[Vec3; 3])| {
            let corners = triangle.map(|position| self.corner(position));
            let in_front = corners.iter().all(|corner| corner.depth >= self.view.near);
            assert!(in_front || !self.exact, "exact soups lie in front of the eye");
            Placed {
                corners,
                snapped: corners.map(|corner| self.snapped(corner)),
                in_front,
                is_copy: self.triangles[..number].contains(triangle),
            }
        };
        self.triangles.iter().enumerate().map(place).collect()
    }

    /// The nearest step; half a step rounds up.
    fn snapped(&self, corner: Corner) -> [i64; 2] {
        let pixel = corner.homogeneous.truncate() / corner.homogeneous.z + self.middle();
        #[expect(clippy::cast_possible_truncation, reason = "soups are small; casts saturate")]
        let steps = (pixel * f64::from(SUBPIXEL_COUNT) + 0.5).floor().to_array().map(|v| v as i64);
        steps
    }

    /// Whether and where a triangle is hit at a point in sub-pixel steps.
    fn hit(&self, triangle: usize, placed: &Placed, at: [i32; 2]) -> Option<Hit> {
        let Placed { corners, snapped, in_front, .. } = *placed;
        let point = DVec2::new(f64::from(at[0]), f64::from(at[1])) / f64::from(SUBPIXEL_COUNT)
            - self.middle();
        let sure = if self.exact {
            if !covers(snapped, at) {
                return None;
            }
            true
        } else {
            let inset = self.inset_px(corners, point);
            let tolerance = SNAP_PX
                + if in_front {
                    corners.iter().map(|corner| corner.error_px).fold(0.0, f64::max)
                } else {
                    self.clip_error_px(corners)
                };
            if inset < -tolerance {
                return None;
            }
            inset > tolerance
        };
        let (low, high) = self.key_range(corners, in_front, point);
        Some(Hit { triangle, sure, low, high })
    }

    pub(super) fn is_perspective(&self) -> bool {
        !self.view.is_orthographic()
    }

    /// Pixels to the nearest edge, or to the near plane's cut: negative outside.
    ///
    /// Corners may lie behind the eye: an edge's line on the picture is where the plane through the
    /// edge and the eye meets it.
    fn inset_px(&self, corners: [Corner; 3], point: DVec2) -> f64 {
        let [a, b, c] = corners.map(|corner| corner.homogeneous);
        let ray = point.extend(1.0);
        let planes = [b.cross(c), c.cross(a), a.cross(b)];
        let determinant = a.dot(planes[0]);
        let side = if determinant < 0.0 { -1.0 } else { 1.0 };
        let distances = planes.map(|plane| {
            let distance = side * plane.dot(ray) / plane.truncate().length();
            // corners on one another bound nothing
            if distance.is_nan() { 0.0 } else { distance }
        });
        let nearest = distances.into_iter().fold(f64::INFINITY, f64::min);
        if determinant == 0.0 {
            // seen from the side
            return if distances.iter().all(|distance| distance.abs() <= SNAP_PX) {
                0.0
            } else {
                f64::NEG_INFINITY
            };
        }
        let weighted = [0, 1, 2].map(|corner| planes[corner] * corners[corner].key);
        let plane = weighted.iter().sum::<DVec3>() / determinant;
        let margin = self.near_key() - plane.dot(ray);
        let rounding = corners.iter().map(|corner| corner.key_error).fold(0.0, f64::max);
        if margin.abs() <= rounding {
            return nearest.min(0.0);
        }
        let to_near = margin / plane.truncate().length();
        if to_near.is_nan() { nearest } else { nearest.min(to_near) }
    }

    /// Key of the near plane.
    fn near_key(&self) -> f64 {
        if self.is_perspective() { 1.0 / self.view.near } else { -self.view.near }
    }

    /// Rounding of a clipped corner, which is computed in f64, to an f32 pixel.
    fn clip_error_px(&self, corners: [Corner; 3]) -> f64 {
        let furthest = corners.iter().map(|corner| corner.homogeneous.truncate().length());
        let nearest = if self.is_perspective() { self.view.near } else { 1.0 };
        2.0 * ROUNDING * furthest.fold(0.0, f64::max) / nearest
    }

    /// Where the key may lie: the plane through the corners at the point, never beyond the corners,
    /// give and take what rounding does to a plane of this triangle's shape.
    fn key_range(&self, corners: [Corner; 3], in_front: bool, point: DVec2) -> (f64, f64) {
        if !in_front {
            // what a clipped triangle is cut into decides its rounding
            let furthest = corners.map(|corner| corner.depth).into_iter().fold(0.0, f64::max);
            let lowest = if self.is_perspective() { 1.0 / furthest } else { -furthest };
            let units = OPERATIONS * ROUNDING;
            let highest = self.near_key();
            return (lowest - units * lowest.abs(), highest + units * highest.abs());
        }
        let pixels = corners.map(|corner| corner.homogeneous.truncate() / corner.homogeneous.z);
        let keys = corners.map(|corner| corner.key / corner.homogeneous.z);
        let moved = corners.iter().map(|corner| corner.error_px).fold(0.0, f64::max);
        let key_error = corners.iter().map(|corner| corner.key_error).fold(0.0, f64::max);
        let lowest = keys.into_iter().fold(f64::INFINITY, f64::min) - key_error;
        let highest = keys.into_iter().fold(f64::NEG_INFINITY, f64::max) + key_error;
        if lowest == highest {
            return (lowest, highest);
        }
        let (u, v) = (pixels[1] - pixels[0], pixels[2] - pixels[0]);
        let (p, q) = (keys[1] - keys[0], keys[2] - keys[0]);
        let units = OPERATIONS * ROUNDING;
        let area = u.perp_dot(v);
        let sides = u.abs().element_sum() + v.abs().element_sum();
        let area_error =
            units * ((u.x * v.y).abs() + (u.y * v.x).abs()) + 4.0 * moved * (sides + moved);
        if area.abs() <= 4.0 * area_error {
            return (lowest, highest);
        }
        let slope = DVec2::new(p * v.y - q * u.y, q * u.x - p * v.x) / area;
        let slope_error = |first: f64, second: f64, slope: f64| {
            let products = units * ((p * first).abs() + (q * second).abs());
            let keys = 2.0 * moved * (p.abs() + q.abs());
            let places = 4.0 * key_error * (first.abs() + second.abs() + moved);
            (products + keys + places + slope.abs() * area_error) / (0.75 * area.abs())
                + units * slope.abs()
        };
        let errors = [slope_error(v.y, u.y, slope.x), slope_error(v.x, u.x, slope.y)];
        let from = point - pixels[0];
        let value = keys[0] + slope.dot(from);
        let error = errors[0] * (from.x.abs() + moved)
            + errors[1] * (from.y.abs() + moved)
            + slope.abs().element_sum() * moved
            + key_error
            + units * (keys[0].abs() + (slope.x * from.x).abs() + (slope.y * from.y).abs());
        ((value - error).clamp(lowest, highest), (value + error).clamp(lowest, highest))
    }

    /// Triangles that a sample may see, and whether it may see none.
    fn seen(&self, placed: &[Placed], at: [i32; 2]) -> (Vec<Hit>, bool) {
        let triangles = placed.iter().enumerate().filter(|(_, triangle)| !triangle.is_copy);
        let hits: Vec<Hit> =
            triangles.filter_map(|(number, triangle)| self.hit(number, triangle, at)).collect();
        let hidden = |hit: &Hit| {
            hits.iter().any(|other| {
                let earlier = other.triangle < hit.triangle;
                other.sure && (other.low > hit.high || (earlier && other.low >= hit.high))
            })
        };
        let seen = hits.iter().filter(|hit| !hidden(hit)).copied().collect();
        (seen, !hits.iter().any(|hit| hit.sure))
    }

    pub(super) fn draw(&self) -> Frame {
        assert!(self.triangles.len() <= MAX_TRIANGLE_COUNT, "a digit each");
        let positions: Vec<Vec3> = self.triangles.as_flattened().to_vec();
        let colors = (0..positions.len()).map(|vertex| digit_color(vertex / 3)).collect::<Vec<_>>();
        let count = positions.len();
        draw(
            &self.view,
            Buffers {
                normals: vec![Vec3::Z; count],
                uvs: vec![Vec2::ZERO; count],
                base: vec![Vec4::ONE; count],
                back: colors.clone(),
                front: colors,
                indices: (0..).take(count).collect(),
                source_ids: Vec::new(),
                positions,
            },
            Primitive::Triangles,
            Blend::Opaque,
            self.sample_count,
        )
    }

    /// Every pixel with the places of its samples, in sub-pixel steps of the picture.
    fn pixels(&self) -> impl Iterator<Item = (usize, Vec<[i32; 2]>)> {
        let positions = samples::positions(self.sample_count).expect("an allowed count");
        let width = self.view.width as usize;
        (0..width * self.view.height as usize).map(move |pixel| {
            let corner = [pixel % width, pixel / width]
                .map(|index| i32::try_from(index).expect("small") * SUBPIXEL_COUNT);
            let places = positions.iter().map(|p| [corner[0] + p[0], corner[1] + p[1]]);
            (pixel, places.collect())
        })
    }

    /// Compares the renderer's picture with the twin's.
    pub(super) fn check(&self) -> Result<(), String> {
        self.compare(&self.draw())
    }

    /// Compares any picture with the twin's.
    pub(super) fn compare(&self, frame: &Frame) -> Result<(), String> {
        let placed = self.placed();
        for (pixel, places) in self.pixels() {
            let seen: Vec<(Vec<Hit>, bool)> =
                places.iter().map(|&at| self.seen(&placed, at)).collect();
            check_pixel(frame, pixel, &seen, self).map_err(|what| {
                let place = (pixel % frame.width, pixel / frame.width);
                format!("pixel {place:?}: {what}\n{seen:?}\n{self:?}")
            })?;
        }
        Ok(())
    }

    /// Compares how many triangles lie on one another at each sample, hidden ones included.
    pub(super) fn check_layers(&self) -> Result<(), String> {
        let positions: Vec<Vec3> = self.triangles.as_flattened().to_vec();
        let count = positions.len();
        let buffers = Buffers {
            normals: vec![Vec3::Z; count],
            uvs: vec![Vec2::ZERO; count],
            base: vec![Vec4::new(1.0, 1.0, 1.0, 0.5); count],
            front: vec![Vec3::ONE; count],
            back: vec![Vec3::ONE; count],
            indices: (0..).take(count).collect(),
            source_ids: Vec::new(),
            positions,
        };
        let frame = draw(&self.view, buffers, Primitive::Triangles, Blend::Over, self.sample_count);
        let placed = self.placed();
        for (pixel, places) in self.pixels() {
            let clear: f32 = places
                .iter()
                .map(|&at| {
                    let layers = placed.iter().filter(|layer| covers(layer.snapped, at)).count();
                    0.5_f32.powi(i32::try_from(layers).expect("few"))
                })
                .sum();
            let expected = 1.0 - clear / self.sample_count as f32;
            let alpha = frame.color[pixel].w;
            // all but 1/21 are exact
            let tolerance = if self.sample_count == 21 { 1e-6 } else { 0.0 };
            if (alpha - expected).abs() > tolerance {
                let place = (pixel % frame.width, pixel / frame.width);
                return Err(format!("pixel {place:?}: opacity {alpha}, not {expected}\n{self:?}"));
            }
        }
        Ok(())
    }
}

/// Draws the primitives of some buffers.
pub(super) fn draw(
    view: &View,
    buffers: Buffers,
    primitive: Primitive,
    blend: Blend,
    sample_count: u32,
) -> Frame {
    let mut list = DrawList::default();
    let count =
        u32::try_from(buffers.indices.len() / primitive.index_count()).expect("u32 indices");
    let source = list.geometry(&Geometry::new(buffers));
    let instances = list.instance(Instance::new(&DAffine3::IDENTITY, view));
    list.items.push(Item {
        primitive,
        vertices: source,
        indices: source,
        primitives: 0..count,
        instances,
        surface: Surface::VertexColor,
        blend,
        depth_write: blend != Blend::Over,
        slab: None,
    });
    let outputs = Outputs { ids: true, ..Outputs::COLOR_DEPTH };
    let settings =
        Settings { sample_count, outputs, background: Vec4::ZERO, counts_fragments: false };
    let renderer = || Renderer { max_tile_side: 16, ..Renderer::default() };
    let render = || renderer().render(&list, view, &settings, &Job::default());
    job::run(Some(2), render).expect("a valid list")
}

/// The top-left rule with integers: a sample on an edge counts as if it lay a hair further right, and
/// on a level edge a hair further down.
fn covers(corners: [[i64; 2]; 3], at: [i32; 2]) -> bool {
    let at = at.map(i64::from);
    let sides = [(0, 1), (1, 2), (2, 0)].map(|(from, to)| {
        let ([x, y], [to_x, to_y]) = (corners[from], corners[to]);
        let along = [to_x - x, to_y - y];
        let value = along[0] * (at[1] - y) - along[1] * (at[0] - x);
        if value != 0 {
            value.signum()
        } else if along[1] != 0 {
            -along[1].signum()
        } else {
            along[0].signum()
        }
    });
    sides == [1; 3] || sides == [-1; 3]
}

/// A digit of one channel.
fn digit_color(triangle: usize) -> Vec3 {
    let mut color = Vec3::ZERO;
    color[triangle % 3] = DIGIT.powi(i32::try_from(triangle / 3).expect("few"));
    color
}

/// How many of a pixel's samples see each triangle.
fn digits(color: Vec4, sample_count: u32) -> [u32; MAX_TRIANGLE_COUNT] {
    let sums = color.truncate() * sample_count as f32;
    std::array::from_fn(|triangle| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below 2^20")]
        let sum = sums[triangle % 3].round() as u32;
        let power = u32::try_from(triangle / 3).expect("few");
        sum / 32_u32.pow(power) % 32
    })
}

fn check_pixel(
    frame: &Frame,
    pixel: usize,
    seen: &[(Vec<Hit>, bool)],
    soup: &Soup,
) -> Result<(), String> {
    let color = frame.color[pixel];
    let counts = digits(color, soup.sample_count);
    for (triangle, &count) in counts.iter().enumerate() {
        let may = |(hits, _): &&(Vec<Hit>, bool)| hits.iter().any(|h| h.triangle == triangle);
        let most = seen.iter().filter(may).count();
        let must = |sample: &&(Vec<Hit>, bool)| may(sample) && sample.0.len() == 1 && !sample.1;
        let least = seen.iter().filter(must).count();
        if !(least..=most).contains(&(count as usize)) {
            let range = format!("{least} to {most}");
            return Err(format!("{count} samples see triangle {triangle}, expected {range}"));
        }
    }
    let covered = (color.w * soup.sample_count as f32).round();
    let total: u32 = counts.iter().sum();
    let close = (color.w * soup.sample_count as f32 - covered).abs() <= 1e-4;
    if !close || covered != total as f32 {
        return Err(format!("opacity {} where {total} samples are covered", color.w));
    }
    let (id, depth) = (frame.ids[pixel], frame.depth[pixel]);
    if id == EMPTY_ID {
        let empty = depth == f32::INFINITY && total == 0;
        return if empty { Ok(()) } else { Err(format!("no id, but depth {depth}")) };
    }
    let key = if soup.is_perspective() { 1.0 / f64::from(depth) } else { -f64::from(depth) };
    let slack = 2.0 * ROUNDING * key.abs();
    let hits = || seen.iter().flat_map(|(hits, _)| hits);
    let fits = |hit: &Hit| {
        let inside = (hit.low - slack..=hit.high + slack).contains(&key);
        hit.triangle == id as usize && inside
    };
    if !hits().any(fits) {
        return Err(format!("id {id} at depth {depth} (key {key})"));
    }
    // a sample that is surely covered lies at least as near as the furthest that it may see
    let nearest = seen
        .iter()
        .filter(|(_, empty)| !empty)
        .map(|(hits, _)| hits.iter().map(|hit| hit.low).fold(f64::INFINITY, f64::min));
    let nearest = nearest.fold(f64::NEG_INFINITY, f64::max);
    if key < nearest - slack {
        return Err(format!("depth {depth} (key {key}), but a sample has key {nearest}"));
    }
    Ok(())
}
