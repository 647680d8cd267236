//! Frames through the renderer: by hand, and against the naive twin.

use std::f64::consts::FRAC_PI_3;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3, Vec4};

use crate::draw_list::{Blend, Buffers, DrawList, Geometry, Instance, Item, Primitive, Surface};
use crate::job::{self, Job};
use crate::raster::{Frame as Picture, Outputs, Renderer, Settings, draw_naive};
use crate::simd::Level;
use crate::texture::depth_map::{self, DepthMap};
use crate::texture::frames::{Frame, Frames, Parts, Relit};
use crate::texture::{Filter, Image, Light, LinearImage, NormalMap, Sampler, Texture, Wrap};
use crate::view::{Projection, View};

const ALL: Outputs =
    Outputs { color: true, depth: true, ids: true, normal: true, albedo: true, color8: false };

/// The same small numbers on every machine.
struct Numbers(u64);

impl Numbers {
    fn byte(&mut self) -> u8 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0.to_be_bytes()[1]
    }

    /// In [0, 1].
    fn next(&mut self) -> f32 {
        f32::from(self.byte()) / 255.0
    }
}

/// Levels of random texels, an eighth of them empty.
fn texture(numbers: &mut Numbers, (mut width, mut height): (u32, u32)) -> Arc<Texture> {
    let mut levels = Vec::new();
    for _ in 0..4 {
        let mut texel = || {
            let alpha = if numbers.byte() < 32 { 0 } else { numbers.byte() };
            [numbers.byte(), numbers.byte(), numbers.byte(), alpha]
        };
        let texels = (0..width * height).map(|_| texel()).collect();
        levels.push(Image::new(width, height, texels).expect("valid"));
        (width, height) = (width / 2, height / 2);
    }
    Texture::new(levels).expect("halves")
}

/// Random normals under a sun that does not shine straight down.
fn relit(numbers: &mut Numbers, size: (u32, u32)) -> Relit {
    let normal = Arc::new(NormalMap::new(texture(numbers, size).levels().to_vec()).expect("fits"));
    let light = Light {
        sun_direction: Vec3::new(0.6, 0.8, 0.0),
        sun: Vec3::new(0.7, 0.6, 0.5),
        sky: Vec3::splat(0.3),
        ground: Vec3::splat(0.1),
        translucency: 0.25,
    };
    Relit { normal, light }
}

/// Four frames in a ball of 1 m, in a row.
fn frames(numbers: &mut Numbers, is_relit: bool) -> Arc<Frames> {
    let size = (64, 16);
    let toward = [Vec3::Z, Vec3::X, Vec3::Y, Vec3::ONE.normalize()];
    let frame = |(number, toward): (usize, Vec3)| {
        let (right, up) = toward.any_orthonormal_pair();
        Some(Frame { toward, right, up, corner: Vec2::new(number as f32 * 0.25, 0.0) })
    };
    let texels = (0..size.0 * size.1).map(|_| depth_map::texel(numbers.next(), 1.0)).collect();
    let base = LinearImage { width: size.0, height: size.1, texels };
    let depth = depth_map::levels(&base, 4, 16, &|| Ok(())).expect("nobody stops it");
    Frames::new(Parts {
        center: Vec3::ZERO,
        reach: 1.0,
        bounds: [-Vec3::ONE, Vec3::new(1.0, 0.8, 1.0)],
        frames: toward.into_iter().enumerate().map(frame).collect(),
        size: Vec2::new(0.25, 1.0),
        color: texture(numbers, size).bounded(),
        depth: Arc::new(DepthMap::new(depth, 16).expect("fits")),
        relit: is_relit.then(|| relit(numbers, size)),
    })
    .expect("fits")
}

/// A square window of side `2 half` through a point, which faces along an axis.
fn window(middle: Vec3, toward: Vec3, half: f32) -> Buffers {
    let (right, up) = toward.any_orthonormal_pair();
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    Buffers {
        positions: corners.map(|(x, y)| middle + (right * x + up * y) * half).to_vec(),
        normals: vec![toward; 4],
        uvs: vec![Vec2::ZERO; 4],
        base: vec![Vec4::ONE; 4],
        front: vec![Vec3::ONE; 4],
        back: vec![Vec3::ONE; 4],
        indices: vec![0, 1, 2, 3],
        source_ids: vec![7],
    }
}

fn add(list: &mut DrawList, data: Buffers, instance: Instance, surface: Surface, blend: Blend) {
    let source = list.geometry(&Geometry::new(data));
    let instances = list.instance(instance);
    list.items.push(Item {
        primitive: Primitive::Cards,
        vertices: source,
        indices: source,
        primitives: 0..1,
        instances,
        surface,
        blend,
        depth_write: blend != Blend::Over,
        slab: None,
    });
}

fn surface(list: &mut DrawList, frames: &Arc<Frames>, step_count: u32, filter: Filter) -> Surface {
    let sampler = Sampler { wrap: [Wrap::Clamp; 2], filter };
    // even numbers of steps trust all
    let tolerance = if step_count.is_multiple_of(2) { f32::INFINITY } else { 0.2 };
    Surface::Parallax { frames: list.frames(frames), step_count, tolerance, sampler }
}

/// Windows of all kinds, and plain cards between them.
pub(crate) fn list(seed: u64, view: &View) -> DrawList {
    let mut numbers = Numbers(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let mut list = DrawList::default();
    let pictures = [frames(&mut numbers, false), frames(&mut numbers, true)];
    let blends = [Blend::Opaque, Blend::Test(0.4), Blend::Coverage, Blend::Over];
    let filters = [Filter::Trilinear, Filter::Bilinear];
    for round in 0..12_u8 {
        let mut at = || numbers.next() - 0.5;
        let place = DVec3::new(at().into(), at().into(), at().into()) * 3.0;
        let turn = DMat3::from_euler(glam::EulerRot::YXZ, f64::from(at()) * 6.0, 0.4, 0.2);
        let mirror = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 0.7));
        let matrix3 = if round % 3 == 0 { turn * mirror } else { turn };
        let mut instance = Instance::new(&DAffine3 { matrix3, translation: place }, view);
        instance.tint = Vec4::new(0.9, 0.8, 0.7, if round % 4 == 1 { 0.8 } else { 1.0 });
        instance.seed = round.into();
        let weights = [numbers.next(), numbers.next(), numbers.next()];
        for (index, weight) in weights.into_iter().enumerate() {
            instance.params[index] = ((usize::from(round) + index) % 4) as f32;
            instance.params[index + 3] = weight / weights.iter().sum::<f32>();
        }
        let blend = blends[usize::from(round) % 4];
        if round % 5 == 4 {
            let data = window(Vec3::ZERO, Vec3::new(0.3, 0.2, 1.0).normalize(), 0.8);
            add(&mut list, data, instance, Surface::VertexColor, Blend::Opaque);
            continue;
        }
        let toward = (view.eye - place).normalize().as_vec3();
        let local = instance.linear.inverse() * toward;
        let data = window(Vec3::ZERO, local.normalize(), 1.3);
        let steps = u32::from(round) % 4;
        let looked = &pictures[usize::from(round) % 2];
        let surface = surface(&mut list, looked, steps, filters[usize::from(round) / 2 % 2]);
        add(&mut list, data, instance, surface, blend);
        if round % 6 == 2 {
            list.items.last_mut().expect("just added").slab = Some([2.0, 4.5]);
        }
    }
    list.items.sort_by_key(|item| item.blend == Blend::Over);
    list
}

pub(crate) fn views() -> [View; 3] {
    let eye = DVec3::new(1.0, 2.0, 3.0);
    let view = |eye: DVec3, kind: Projection| {
        View::new(eye, DVec3::ZERO, DVec3::Y, kind, (61, 47), 0.1).expect("valid")
    };
    [
        view(eye, Projection::Perspective { fov_y: FRAC_PI_3 }),
        view(eye, Projection::Orthographic { height: 5.0 }),
        // among the windows, some of which reach behind the eye
        view(eye * 0.2, Projection::Perspective { fov_y: 1.6 }),
    ]
}

fn draw(list: &DrawList, view: &View, sample_count: u32, level: Level, threads: usize) -> Picture {
    let settings =
        Settings { sample_count, outputs: ALL, background: Vec4::ZERO, counts_fragments: true };
    let mut renderer = Renderer::with_simd(level);
    renderer.max_tile_side = 16;
    let render = || renderer.render(list, view, &settings, &Job::default());
    job::run(Some(threads), render).expect("valid")
}

#[test]
fn windows_equal_the_naive_twin() {
    let scalar = Level::named("simd", "scalar").expect("always");
    let mut seen = 0;
    for seed in 0..6 {
        for view in views() {
            let list = list(seed, &view);
            list.check().expect("consistent");
            for sample_count in [1, 4, 16, 21] {
                let fast = draw(&list, &view, sample_count, scalar, 2);
                let naive = draw_naive(&list, &view, sample_count, &Job::default()).expect("valid");
                assert_eq!(fast.depth, naive.depth, "seed {seed}, {sample_count} samples");
                assert_eq!(fast.ids, naive.ids, "seed {seed}, {sample_count} samples");
                let colors = fast.color.iter().zip(&naive.color);
                // samples are added in another order
                let most = colors.map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max);
                assert!(most < 2e-6, "seed {seed}, {sample_count} samples: {most}");
                seen += fast.ids.iter().filter(|&&id| id == 7).count();
            }
        }
    }
    assert!(seen > 10_000, "windows show something: {seen} pixels");
}

#[test]
fn windows_are_the_same_on_every_level_and_thread_count() {
    let scalar = Level::named("simd", "scalar").expect("always");
    for view in views() {
        let list = list(11, &view);
        for sample_count in [1, 4, 16] {
            let once = draw(&list, &view, sample_count, scalar, 1);
            for level in Level::all() {
                let mut again = draw(&list, &view, sample_count, level, 2);
                again.stats = once.stats;
                assert_eq!(again, once, "{level:?}, {sample_count} samples");
            }
        }
    }
}

/// A frame towards +z of a wall at some depth, opaque.
fn wall(share: f32) -> Arc<Frames> {
    let color = Image::new(1, 1, vec![[255, 0, 0, 255]]).expect("valid");
    let base = LinearImage { width: 1, height: 1, texels: vec![depth_map::texel(share, 1.0)] };
    let depth = depth_map::levels(&base, 1, 16, &|| Ok(())).expect("nobody stops it");
    let frame = Frame { toward: Vec3::Z, right: Vec3::X, up: Vec3::Y, corner: Vec2::ZERO };
    Frames::new(Parts {
        center: Vec3::ZERO,
        reach: 2.0,
        bounds: [Vec3::splat(-2.0), Vec3::splat(2.0)],
        frames: vec![Some(frame)],
        size: Vec2::ONE,
        color: Texture::new(vec![color]).expect("valid"),
        depth: Arc::new(DepthMap::new(depth, 16).expect("fits")),
        relit: None,
    })
    .expect("fits")
}

#[test]
fn depth_is_that_of_what_is_seen_and_not_of_the_window() {
    // a wall one metre before the window's plane, seen from 10 m away, and a card before or behind it
    let projection = Projection::Orthographic { height: 2.0 };
    let view = View::new(DVec3::Z * 10.0, DVec3::ZERO, DVec3::Y, projection, (4, 4), 1e-3);
    let view = view.expect("valid");
    let frames = wall(0.75);
    for (card_at, depth, red) in [(0.9, 9.0, true), (-0.5, 9.0, true), (1.1, 8.9, false)] {
        for window_first in [true, false] {
            let mut list = DrawList::default();
            let mut instance = Instance::new(&DAffine3::IDENTITY, &view);
            instance.params[3] = 1.0;
            let looked = surface(&mut list, &frames, 1, Filter::Bilinear);
            let through = window(Vec3::ZERO, Vec3::Z, 1.5);
            let card = window(Vec3::Z * card_at, Vec3::Z, 1.5);
            add(&mut list, through, instance, looked, Blend::Test(0.5));
            add(&mut list, card, instance, Surface::VertexColor, Blend::Opaque);
            if !window_first {
                list.items.swap(0, 1);
            }
            let frame = draw(&list, &view, 4, Level::chosen().expect("one"), 1);
            let (color, found) = (frame.color[5], frame.depth[5]);
            // 16 bits over 4 m
            assert!((found - depth).abs() < 4e-5, "card at {card_at}: {found}");
            let wanted = if red { Vec4::new(1.0, 0.0, 0.0, 1.0) } else { Vec4::ONE };
            assert_eq!(color, wanted, "card at {card_at}, window first: {window_first}");
        }
    }
}

/// Colour and depth of a picture of 4 x 4 pixels, one sample each, through a window on a wall.
fn through_a_window(view: &View, turn: f64) -> Picture {
    draw(&window_on_a_wall(view, turn), view, 1, Level::chosen().expect("one"), 1)
}

/// A window on a wall one metre before the middle of a copy that stands at the origin, turned about the
/// vertical.
pub(crate) fn window_on_a_wall(view: &View, turn: f64) -> DrawList {
    let mut list = DrawList::default();
    let matrix3 = DMat3::from_rotation_y(turn);
    let placed = DAffine3 { matrix3, translation: DVec3::ZERO };
    let mut instance = Instance::new(&placed, view);
    instance.params[3] = 1.0;
    let looked = surface(&mut list, &wall(0.75), 1, Filter::Bilinear);
    let toward = (matrix3.transpose() * DVec3::Z).as_vec3();
    add(&mut list, window(Vec3::ZERO, toward, 1.5), instance, looked, Blend::Test(0.5));
    list
}

#[test]
fn depth_is_measured_in_the_world_and_not_in_the_copy() {
    let projection = Projection::Orthographic { height: 2.0 };
    let view = View::new(DVec3::Z * 10.0, DVec3::ZERO, DVec3::Y, projection, (4, 4), 1e-3);
    let turn = 30.0_f64.to_radians();
    let frame = through_a_window(&view.expect("valid"), turn);
    // the wall is the plane x sin + z cos = 1; the second pixel lies at x = -0.25
    for (pixel, x) in [(5, -0.25), (6, 0.25)] {
        let wanted = 10.0 - (1.0 - x * libm::sin(turn)) / libm::cos(turn);
        let found = f64::from(frame.depth[pixel]);
        assert!((found - wanted).abs() < 1e-4, "at {x}: {found} for {wanted}");
    }
}

#[test]
fn what_is_nearer_than_the_near_plane_is_not_seen() {
    let projection = Projection::Perspective { fov_y: 0.5 };
    for (eye, is_seen) in [(1.5, true), (1.25, true), (1.15, false)] {
        let view = View::new(DVec3::Z * eye, DVec3::ZERO, DVec3::Y, projection, (4, 4), 0.2);
        let frame = through_a_window(&view.expect("valid"), 0.0);
        let found = frame.depth[5];
        assert_eq!(found.is_finite(), is_seen, "from {eye}, 0.2 before it nothing is: {found}");
    }
}

#[test]
fn lists_that_name_no_frames_are_refused() {
    let view = &views()[0];
    let mut list = DrawList::default();
    let instance = Instance::new(&DAffine3::IDENTITY, view);
    let sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: Filter::Bilinear };
    let nowhere = Surface::Parallax { frames: 0, step_count: 1, tolerance: 0.1, sampler };
    add(&mut list, window(Vec3::ZERO, Vec3::Z, 1.0), instance, nowhere, Blend::Opaque);
    let text = list.check().expect_err("refused").to_string();
    assert!(text.contains("no frames 0"), "{text}");
    let looked = surface(&mut list, &wall(0.5), 1, Filter::Bilinear);
    list.items[0].surface = looked;
    list.check().expect("there");
    list.items[0].primitive = Primitive::Points { size_px: 2.0 };
    assert!(list.check().is_err(), "a point is no window");
}
