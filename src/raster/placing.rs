//! From an instance's local coordinates to the picture.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8, mask32x8};
use glam::{DMat3, Mat3, Vec3};

use crate::raster::clip::ClipSpace;
use crate::raster::samples::SUBPIXEL_COUNT;
use crate::raster::setup::flags;
use crate::simd::{Kernel, LANE_COUNT, Level};
use crate::texture::texture::floor_to_i32;
use crate::view::View;

/// Corners further out than this many pixels are clipped, so that fixed-point sums fit in i64.
pub(crate) const GUARD_PX: f32 = 1_048_576.0;

/// A vertex on the picture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScreenVertex {
    /// Pixels.
    pub(crate) x: f32,
    pub(crate) y: f32,
    /// Grows towards the viewer: 1 / depth (perspective) or -depth (orthographic). NaN: to be
    /// clipped.
    pub(crate) key: f32,
    /// Index into the item's vertex arrays.
    pub(crate) source: u32,
    /// The nearest sub-pixel steps; meaningless where the key is NaN.
    pub(crate) snapped: [i32; 2],
}

/// From local coordinates to the picture, for one instance.
pub(crate) struct Placing {
    rows: [Vec3; 3],
    offset: Vec3,
    center: [f32; 2],
    near: f32,
    perspective: bool,
    mirrored: bool,
    /// The same in f64, for clipping.
    pub(crate) exact: ClipSpace,
    linear: Mat3,
    translation: Vec3,
    back: Vec3,
    normals: Mat3,
}

impl Placing {
    #[expect(clippy::cast_possible_truncation, reason = "planes and picture sides in f32")]
    pub(crate) fn new(view: &View, linear: Mat3, translation: Vec3) -> Self {
        let scale = view.pixels_per_metre_at_one();
        let axes = DMat3::from_cols(
            view.right * (scale * view.pixel_aspect),
            -view.up * scale,
            -view.back,
        )
        .transpose();
        let local = (axes * linear.as_dmat3()).transpose();
        let rows = [local.x_axis, local.y_axis, local.z_axis];
        let offset = axes * translation.as_dvec3();
        let center = [f64::from(view.width) * 0.5, f64::from(view.height) * 0.5];
        let perspective = !view.is_orthographic();
        Self {
            rows: rows.map(|row| row.as_vec3()),
            offset: offset.as_vec3(),
            center: center.map(|c| c as f32),
            near: view.near as f32,
            perspective,
            mirrored: linear.determinant() < 0.0,
            exact: ClipSpace { rows, offset, center, near: view.near, perspective },
            linear,
            translation,
            back: view.back.as_vec3(),
            normals: normal_matrix(linear),
        }
    }

    /// Places vertices and appends them to `placed`.
    pub(crate) fn vertices(
        &self,
        level: Level,
        vertices: Chosen<'_>,
        placed: &mut Vec<ScreenVertex>,
    ) {
        level.run(Place { placing: self, vertices, placed });
    }

    /// Pixels and depth key of eight points, and which of them are in front and not too far out.
    #[inline(always)]
    pub(crate) fn lanes<S: Simd>(
        &self,
        simd: S,
        local: [f32x8<S>; 3],
    ) -> ([f32x8<S>; 3], mask32x8<S>) {
        let (x, y) = (self.row(0, local), self.row(1, local));
        let z = self.row(2, local);
        let (x, y, key) = if self.perspective {
            let inverse = 1.0 / z;
            (x * inverse + self.center[0], y * inverse + self.center[1], inverse)
        } else {
            (x + self.center[0], y + self.center[1], -z)
        };
        let guard = f32x8::splat(simd, GUARD_PX);
        let in_front = z.simd_ge(f32x8::splat(simd, self.near));
        ([x, y, key], in_front & x.abs().simd_le(guard) & y.abs().simd_le(guard))
    }

    /// As [`Self::side_seen`], by lanes: where the back is seen.
    #[inline(always)]
    pub(crate) fn backs_seen<S: Simd>(
        &self,
        simd: S,
        position: [f32x8<S>; 3],
        normal: [f32x8<S>; 3],
    ) -> mask32x8<S> {
        let turned = times(&self.normals, normal);
        let to_eye = if self.perspective {
            let [x, y, z] = times(&self.linear, position);
            let Vec3 { x: a, y: b, z: c } = self.translation;
            [-(x + a), -(y + b), -(z + c)]
        } else {
            self.back.to_array().map(|axis| f32x8::splat(simd, axis))
        };
        let dot = turned[0] * to_eye[0] + turned[1] * to_eye[1] + turned[2] * to_eye[2];
        dot.simd_lt(f32x8::splat(simd, 0.0))
    }

    #[inline(always)]
    fn row<S: Simd>(&self, row: usize, [x, y, z]: [f32x8<S>; 3]) -> f32x8<S> {
        let Vec3 { x: a, y: b, z: c } = self.rows[row];
        x * a + y * b + z * c + self.offset[row]
    }

    /// [`flags::FRONT`] if a point's normal leans towards the eye or is zero.
    pub(crate) fn side_seen(&self, position: Vec3, normal: Vec3) -> u32 {
        let to_eye =
            if self.perspective { -(self.linear * position + self.translation) } else { self.back };
        if (self.normals * normal).dot(to_eye) < 0.0 { 0 } else { flags::FRONT }
    }

    /// [`flags::FRONT`] for corners that run counter-clockwise as stored.
    pub(crate) fn stored_winding(&self) -> u32 {
        if self.mirrored { 0 } else { flags::FRONT }
    }
}

/// Vertices to be placed.
#[derive(Clone, Copy)]
pub(crate) enum Chosen<'a> {
    /// Consecutive ones, of which the first has the given index.
    Range(&'a [Vec3], u32),
    /// Those of all that the indices name.
    Indexed(&'a [Vec3], &'a [u32]),
}

impl Chosen<'_> {
    fn len(&self) -> usize {
        match self {
            Self::Range(positions, _) => positions.len(),
            Self::Indexed(_, indices) => indices.len(),
        }
    }

    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "indices of vertices are u32")]
    fn get(&self, at: usize) -> (Vec3, u32) {
        match self {
            Self::Range(positions, first) => (positions[at], first.wrapping_add(at as u32)),
            Self::Indexed(positions, indices) => (positions[indices[at] as usize], indices[at]),
        }
    }
}

/// Places eight vertices at a time.
struct Place<'a> {
    placing: &'a Placing,
    vertices: Chosen<'a>,
    placed: &'a mut Vec<ScreenVertex>,
}

impl Kernel for Place<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { placing, vertices, placed } = self;
        let count = vertices.len();
        placed.reserve(count);
        for first in (0..count).step_by(LANE_COUNT) {
            let lane_count = LANE_COUNT.min(count.wrapping_sub(first));
            let [mut x, mut y, mut z] = [[0.0; LANE_COUNT]; 3];
            let mut sources = [0; LANE_COUNT];
            for lane in 0..lane_count {
                let (position, source) = vertices.get(first.wrapping_add(lane));
                (x[lane], y[lane], z[lane]) = (position.x, position.y, position.z);
                sources[lane] = source;
            }
            let x = f32x8::simd_from(simd, x);
            let y = f32x8::simd_from(simd, y);
            let z = f32x8::simd_from(simd, z);
            let local = [x, y, z];
            let ([x, y, key], inside) = placing.lanes(simd, local);
            let key: [f32; LANE_COUNT] = inside.select(key, f32x8::splat(simd, f32::NAN)).into();
            let snapped_x: [i32; LANE_COUNT] = snap_lanes(x).into();
            let snapped_y: [i32; LANE_COUNT] = snap_lanes(y).into();
            let x: [f32; LANE_COUNT] = x.into();
            let y: [f32; LANE_COUNT] = y.into();
            for lane in 0..lane_count {
                let snapped = [snapped_x[lane], snapped_y[lane]];
                let (x, y, key, source) = (x[lane], y[lane], key[lane], sources[lane]);
                placed.push(ScreenVertex { x, y, key, source, snapped });
            }
        }
    }
}

/// A matrix times eight vectors, added up as [`Mat3`] does.
#[inline(always)]
fn times<S: Simd>(matrix: &Mat3, [x, y, z]: [f32x8<S>; 3]) -> [f32x8<S>; 3] {
    let Mat3 { x_axis: a, y_axis: b, z_axis: c } = *matrix;
    [x * a.x + y * b.x + z * c.x, x * a.y + y * b.y + z * c.y, x * a.z + y * b.z + z * c.z]
}

/// How normals turn under a linear map: the cofactors, so that they stay upright on a surface that
/// is stretched or mirrored. Their lengths change.
pub(crate) fn normal_matrix(linear: Mat3) -> Mat3 {
    let Mat3 { x_axis: x, y_axis: y, z_axis: z } = linear;
    let sign = if linear.determinant() < 0.0 { -1.0 } else { 1.0 };
    Mat3::from_cols(y.cross(z) * sign, z.cross(x) * sign, x.cross(y) * sign)
}

/// Nearest sub-pixel step; half a step rounds up.
#[inline]
pub(crate) fn snap(pixels: f32) -> i32 {
    floor_to_i32(pixels * SUBPIXEL_COUNT as f32 + 0.5)
}

/// As [`snap`] within [`GUARD_PX`]; anything beyond.
#[inline(always)]
pub(crate) fn snap_lanes<S: Simd>(pixels: f32x8<S>) -> i32x8<S> {
    let steps = pixels * SUBPIXEL_COUNT as f32 + 0.5;
    let toward_zero: i32x8<S> = steps.to_int();
    let float: f32x8<S> = toward_zero.to_float();
    // a mask is -1 where it holds
    toward_zero + float.simd_gt(steps).to_vector()
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Snap([f32; LANE_COUNT]);

    impl Kernel for Snap {
        type Output = [i32; LANE_COUNT];
        #[inline(always)]
        fn run<S: Simd>(self, simd: S) -> Self::Output {
            snap_lanes(f32x8::simd_from(simd, self.0)).into()
        }
    }

    #[test]
    fn lanes_snap_as_one() {
        let step = 1.0 / SUBPIXEL_COUNT as f32;
        let pixels =
            [0.0, 0.49 * step, 0.5 * step, -0.5 * step, -0.51 * step, -3.0, 7.25, -GUARD_PX];
        let expected = [0, 0, 1, 0, -1, -768, 1856, -268_435_456];
        assert_eq!(pixels.map(snap), expected, "half a step rounds up");
        for level in Level::all() {
            assert_eq!(level.run(Snap(pixels)), expected, "{level:?}");
        }
    }
}
