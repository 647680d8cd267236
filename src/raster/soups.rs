//! Random triangle soups through the renderer and through a brute-force twin in f64.
//!
//! Coordinates are drawn where they hurt: on samples, on half steps of the renderer's grid, level with
//! one another, a hair apart, twice the same, far outside, through the near plane and behind the eye.

mod twin;

use glam::{DVec3, Vec2, Vec3, Vec4};
use proptest::prelude::*;
use proptest::test_runner::{RngSeed, TestError, TestRunner};

use self::twin::{MAX_TRIANGLE_COUNT, Soup};
use super::samples::{self, SUBPIXEL_COUNT};
use crate::draw_list::{Blend, Buffers, Primitive};
use crate::view::{Projection, View};

/// Two columns of tiles and a ragged one, several rows of them.
const SIZE: (u32, u32) = (40, 32);

/// Steps a pixel of the soups' coordinates: every second one lies half way between two of the
/// renderer's.
const STEPS_PER_PX: i32 = 2 * SUBPIXEL_COUNT;

/// A parallel view whose pixels are metres: x to the right and y down from the top left, z = 0 at
/// depth 16.
fn pixel_view() -> View {
    let (width, height) = SIZE;
    let middle = DVec3::new(f64::from(width) / 2.0, -f64::from(height) / 2.0, 0.0);
    let projection = Projection::Orthographic { height: f64::from(height) };
    View::new(middle + DVec3::Z * 16.0, middle, DVec3::Y, projection, SIZE, 1e-3).expect("valid")
}

/// 90 degrees from the origin along -z.
fn straight_view() -> View {
    let projection = Projection::Perspective { fov_y: std::f64::consts::FRAC_PI_2 };
    View::new(DVec3::ZERO, DVec3::NEG_Z, DVec3::Y, projection, SIZE, 1.0 / 16.0).expect("valid")
}

/// Where a corner lies on the picture; what the numbers mean depends on the first.
type Place = (u8, i32, i32, usize);

fn place() -> impl Strategy<Value = Place> {
    (0..10_u8, -40 * 512..40 * 512_i32, -40 * 512..40 * 512_i32, 0..64_usize)
}

/// Places of corners in soup steps from the top left: anywhere in or near the picture, far out, on a
/// sample, a few steps from an earlier corner, or exactly level with it.
fn resolve(places: &[Place], sample_count: u32) -> Vec<[i32; 2]> {
    let positions = samples::positions(sample_count).expect("an allowed count");
    let mut found: Vec<[i32; 2]> = Vec::new();
    for &(kind, x, y, pick) in places {
        let earlier = found.get(pick % found.len().max(1)).copied();
        let near = |v: i32| v + 20 * STEPS_PER_PX;
        found.push(match (kind, earlier) {
            (0..=2, _) | (6.., None) => [near(x), near(y)],
            (3, _) => [near(x) * 50, near(y) * 50],
            (4 | 5, _) => {
                let sample = positions[pick % positions.len()];
                [x / 512 + 20, y / 512 + 20]
                    .iter()
                    .zip(sample)
                    .map(|(pixel, step)| pixel * STEPS_PER_PX + 2 * step)
                    .collect::<Vec<_>>()
                    .try_into()
                    .expect("two coordinates")
            }
            (6 | 7, Some(at)) => [at[0] + x % 5, at[1] + y % 5],
            (8, Some(at)) => [at[0], near(y)],
            (_, Some(at)) => [near(x), at[1]],
        });
    }
    found
}

fn to_px(steps: i32) -> f32 {
    steps as f32 / STEPS_PER_PX as f32
}

/// Three indices into the places and one number more for each triangle.
type Faces = Vec<([usize; 3], i8)>;

fn faces() -> impl Strategy<Value = Faces> {
    prop::collection::vec((prop::array::uniform3(0..64_usize), 0..4_i8), 1..=MAX_TRIANGLE_COUNT)
}

fn sample_counts() -> impl Strategy<Value = u32> {
    prop::sample::select(vec![1, 4, 8, 16, 21])
}

/// Corners of faces from what is at each place.
fn assemble(faces: &Faces, place_count: usize, at: impl Fn(usize, i8) -> Vec3) -> Vec<[Vec3; 3]> {
    faces.iter().map(|(corners, own)| corners.map(|c| at(c % place_count, *own))).collect()
}

/// Level triangles with many exact ties: everything must agree to the bit.
fn flat_soups() -> impl Strategy<Value = Soup> {
    (prop::collection::vec(place(), 3..10), faces(), sample_counts()).prop_map(
        |(places, faces, sample_count)| {
            let places = resolve(&places, sample_count);
            let triangles = assemble(&faces, places.len(), |corner, level| {
                let [x, y] = places[corner].map(to_px);
                Vec3::new(x, -y, f32::from(level))
            });
            Soup { view: pixel_view(), triangles, sample_count, exact: true }
        },
    )
}

/// Slanted triangles that cut through one another, in a parallel view.
fn slanted_soups() -> impl Strategy<Value = Soup> {
    let heights = prop::collection::vec(-32..=32_i8, 10);
    (prop::collection::vec(place(), 3..10), heights, faces(), sample_counts()).prop_map(
        |(places, heights, faces, sample_count)| {
            let places = resolve(&places, sample_count);
            let triangles = assemble(&faces, places.len(), |corner, _| {
                let [x, y] = places[corner].map(to_px);
                Vec3::new(x, -y, f32::from(heights[corner]) / 8.0)
            });
            Soup { view: pixel_view(), triangles, sample_count, exact: true }
        },
    )
}

/// Perspective at depths of powers of two, whose divisions are exact.
fn perspective_soups() -> impl Strategy<Value = Soup> {
    let depths = prop::collection::vec(-3..=3_i32, 10);
    (prop::collection::vec(place(), 3..10), depths, faces(), sample_counts()).prop_map(
        |(places, depths, faces, sample_count)| {
            let places = resolve(&places, sample_count);
            let view = straight_view();
            let triangles = assemble(&faces, places.len(), |corner, _| {
                let depth = 2.0_f32.powi(depths[corner]);
                let [x, y] = places[corner].map(to_px);
                let middle = [view.width as f32 / 2.0, view.height as f32 / 2.0];
                let scale = depth / 16.0;
                Vec3::new((x - middle[0]) * scale, (middle[1] - y) * scale, -depth)
            });
            Soup { view, triangles, sample_count, exact: true }
        },
    )
}

/// Any place of the eye, any direction, and triangles through the near plane and behind the eye.
fn free_soups() -> impl Strategy<Value = Soup> {
    let points = prop::collection::vec(prop::array::uniform3(-256..=256_i16), 3..10);
    let eye = prop::array::uniform3(-8..=8_i8);
    let toward = (-4..=4_i8, -4..=4_i8, prop::sample::select(vec![-3_i8, -1, 1, 2]));
    (points, eye, toward, any::<bool>(), faces(), sample_counts()).prop_map(
        |(points, eye, toward, parallel, faces, sample_count)| {
            let eye = DVec3::from(eye.map(f64::from)) / 4.0;
            let toward = DVec3::new(toward.0.into(), toward.1.into(), toward.2.into());
            let projection = if parallel {
                Projection::Orthographic { height: 3.0 }
            } else {
                Projection::Perspective { fov_y: std::f64::consts::FRAC_PI_2 }
            };
            let view = View::new(eye, eye + toward, DVec3::Y, projection, SIZE, 1.0 / 16.0);
            let triangles = assemble(&faces, points.len(), |corner, _| {
                Vec3::from(points[corner].map(f32::from)) / 64.0
            });
            Soup { view: view.expect("valid"), triangles, sample_count, exact: false }
        },
    )
}

/// Draws the same soups on every run, more of them if `PROPTEST_CASES` says so; a failure is shrunk and
/// printed.
fn run<S: Strategy<Value = Soup>>(soups: S, check: impl Fn(&Soup) -> Result<(), String>) {
    let config = ProptestConfig {
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(7),
        ..ProptestConfig::default()
    };
    let result =
        TestRunner::new(config).run(&soups, |soup| check(&soup).map_err(TestCaseError::fail));
    match result {
        Ok(()) => {}
        Err(TestError::Fail(reason, _)) => panic!("{reason}"),
        Err(other) => panic!("{other}"),
    }
}

/// One triangle over most of the picture, and something small before it.
fn sparse(view: View, exact: bool, lift: [f32; 3]) -> Soup {
    let large = [[1.0, 1.0], [3.0, 30.0], [37.0, 5.0]];
    let small = [[10.0, 10.0], [11.0, 17.0], [19.0, 12.0]];
    let at = |[x, y]: [f32; 2], lift: f32| {
        if view.is_orthographic() {
            return Vec3::new(x, -y, lift);
        }
        let depth = 4.0 - lift;
        let scale = depth / 16.0;
        Vec3::new((x - 20.0) * scale, (16.0 - y) * scale, -depth)
    };
    let triangles = vec![
        [at(large[0], lift[0]), at(large[1], lift[1]), at(large[2], lift[2])],
        small.map(|corner| at(corner, 2.0)),
    ];
    Soup { view, triangles, sample_count: 16, exact }
}

#[test]
fn the_twin_notices_what_is_wrong() {
    let soups = [
        sparse(pixel_view(), true, [0.0; 3]),
        sparse(pixel_view(), true, [0.0, 0.5, -1.5]),
        sparse(straight_view(), true, [0.0; 3]),
        sparse(straight_view(), false, [0.0, 0.5, -1.5]),
    ];
    for soup in soups {
        assert_eq!(soup.check(), Ok(()), "as it is");
        let with = |change: &dyn Fn(&mut Soup)| {
            let mut other = soup.clone();
            change(&mut other);
            soup.compare(&other.draw())
        };
        // a triangle of this size has a sample within a step of its rim, and hundreds within ten
        let steps = if soup.exact { 1.0 } else { 10.0 };
        let move_right = |other: &mut Soup| {
            for corner in &mut other.triangles[0] {
                let pixel = if soup.is_perspective() { -corner.z / 16.0 } else { 1.0 };
                corner.x += steps / 256.0 * pixel;
            }
        };
        assert!(with(&move_right).is_err(), "moved by {steps} steps");
        let push_back = |other: &mut Soup| {
            for corner in &mut other.triangles[0] {
                *corner *= 1.0 + 3e-5;
            }
        };
        if soup.is_perspective() {
            assert!(with(&push_back).is_err(), "30 millionths further away, at the same place");
        }
        let swap = |other: &mut Soup| other.triangles.swap(0, 1);
        assert!(with(&swap).is_err(), "numbered the other way round");
        let hide = |other: &mut Soup| other.triangles[1] = [Vec3::ZERO; 3];
        assert!(with(&hide).is_err(), "without the small one");
        let double = |other: &mut Soup| other.triangles.insert(0, soup.triangles[1]);
        assert!(with(&double).is_err(), "the later of two equal ones");
    }
}

#[test]
fn level_soups_agree_to_the_bit() {
    run(flat_soups(), Soup::check);
}

#[test]
fn every_layer_of_a_soup_is_drawn_once() {
    run(flat_soups(), Soup::check_layers);
}

#[test]
fn slanted_soups_agree() {
    run(slanted_soups(), Soup::check);
}

#[test]
fn soups_in_perspective_agree() {
    run(perspective_soups(), Soup::check);
}

#[test]
fn soups_around_the_eye_agree() {
    run(free_soups(), Soup::check);
}

#[test]
fn a_million_points_on_one_pixel_are_one_pixel() {
    // two batches, the nearest point and its equals in both; on the border of four pixels too
    let count = 1_050_000_u32;
    let view = pixel_view();
    let height =
        |index: u32| if index % 100_000 == 70_007 { 3.0 } else { (index % 97) as f32 / 64.0 };
    for (middle, size_px, pixel) in [([20.5, 10.5], 1.0, (20, 10)), ([20.0, 10.0], 2.0, (19, 9))] {
        let positions: Vec<Vec3> =
            (0..count).map(|index| Vec3::new(middle[0], -middle[1], height(index))).collect();
        let number = |index: u32| Vec3::splat(f32::from(u8::from(index == 70_007)));
        let front: Vec<Vec3> = (0..count).map(number).collect();
        let length = positions.len();
        let buffers = Buffers {
            normals: vec![Vec3::Z; length],
            uvs: vec![Vec2::ZERO; length],
            base: vec![Vec4::new(0.0, 0.0, 0.0, 0.25); length],
            back: front.clone(),
            front,
            indices: (0..count).collect(),
            source_ids: Vec::new(),
            positions,
        };
        let points = Primitive::Points { size_px };
        let frame = twin::draw(&view, buffers.clone(), points, Blend::Opaque, 4);
        let at = pixel.1 * frame.width + pixel.0;
        assert_eq!((frame.ids[at], frame.depth[at]), (70_007, 13.0), "the earliest of the nearest");
        assert_eq!(frame.color[at], Vec4::ONE, "its colour at all samples");
        let covered = frame.color.iter().filter(|color| color.w > 0.0).count();
        assert_eq!(covered, if size_px == 1.0 { 1 } else { 4 }, "points of {size_px} pixels");
        assert_eq!(frame.stats.point_count, u64::from(count), "all of them submitted");
        let blended = twin::draw(&view, buffers, points, Blend::Over, 4);
        // a rounding of each step is a quarter forgotten by the next
        let clear = (1.0 - blended.color[at].w).abs();
        assert!(clear <= 4.0 * f32::EPSILON, "a million times a quarter is opaque, not {clear}");
    }
}
