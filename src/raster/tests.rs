//! The renderer against small pictures drawn by hand, and against its naive twin.

use std::f64::consts::FRAC_PI_3;
use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec2, Vec3, Vec4};

use super::{EMPTY_ID, Frame, Outputs, Renderer, Settings, draw_naive};
use crate::draw_list::{Blend, Buffers, DrawList, Geometry, Instance, Item, Primitive, Surface};
use crate::job::{self, Job};
use crate::simd::Level;
use crate::texture::distribution::{Distribution, LeafPlace, Parts};
use crate::texture::srgb::unorm8;
use crate::texture::{Filter, Image, Sampler, Texture, Wrap};
use crate::view::{Projection, View};

pub(crate) const ALL: Outputs =
    Outputs { color: true, depth: true, ids: true, normal: true, albedo: true, color8: true };

/// Parallel view along -z from z = 10: x and y are pixels, x right, y down from the top left.
pub(crate) fn pixel_view(width: u32, height: u32) -> View {
    let middle = DVec3::new(f64::from(width) / 2.0, -f64::from(height) / 2.0, 0.0);
    let projection = Projection::Orthographic { height: f64::from(height) };
    View::new(middle + DVec3::Z * 10.0, middle, DVec3::Y, projection, (width, height), 1e-3)
        .expect("valid")
}

/// White vertices at pixel coordinates (y down) and a height z towards the viewer.
pub(crate) fn buffers(points: &[[f32; 3]], indices: &[u32]) -> Buffers {
    let count = points.len();
    Buffers {
        positions: points.iter().map(|p| Vec3::new(p[0], -p[1], p[2])).collect(),
        normals: vec![Vec3::Z; count],
        uvs: vec![Vec2::ZERO; count],
        base: vec![Vec4::ONE; count],
        front: vec![Vec3::ONE; count],
        back: vec![Vec3::new(0.5, 0.5, 0.5); count],
        indices: indices.to_vec(),
        source_ids: Vec::new(),
    }
}

pub(crate) fn add(
    list: &mut DrawList,
    view: &View,
    primitive: Primitive,
    data: Buffers,
    blend: Blend,
) {
    let count = u32::try_from(data.indices.len() / primitive.index_count()).expect("few");
    let source = list.geometry(&Geometry::new(data));
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
}

fn draw(list: &DrawList, view: &View, sample_count: u32) -> Frame {
    draw_outputs(list, view, sample_count, ALL)
}

fn draw_outputs(list: &DrawList, view: &View, sample_count: u32, outputs: Outputs) -> Frame {
    let settings =
        Settings { sample_count, outputs, background: Vec4::ZERO, counts_fragments: true };
    let renderer = || Renderer { max_tile_side: 16, ..Renderer::default() };
    let render = || renderer().render(list, view, &settings, &Job::default());
    job::run(Some(2), render).expect("valid")
}

/// `#` full, `.` empty, a digit for tenths of alpha.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 10")]
fn ascii(frame: &Frame) -> String {
    let mut text = String::new();
    for row in frame.color.chunks(frame.width) {
        for pixel in row {
            let tenths = (pixel.w * 10.0).round();
            text.push(match tenths as u8 {
                0 => '.',
                10 => '#',
                digit => char::from(b'0' + digit),
            });
        }
        text.push('\n');
    }
    text
}

/// The same small numbers on every machine.
struct Numbers(u64);

impl Numbers {
    /// In [0, 1).
    fn next(&mut self) -> f32 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / 16_777_216.0
    }
}

#[test]
fn a_triangle_covers_the_centres_inside_it() {
    // corners (1, 1), (5, 1), (1, 5): the slanted edge runs through the centres of a diagonal,
    // which is neither its left nor its upper edge
    let view = pixel_view(6, 6);
    let mut list = DrawList::default();
    let corners = buffers(&[[1.0, 1.0, 0.0], [1.0, 5.0, 0.0], [5.0, 1.0, 0.0]], &[0, 1, 2]);
    add(&mut list, &view, Primitive::Triangles, corners, Blend::Opaque);
    let frame = draw(&list, &view, 1);
    assert_eq!(ascii(&frame), "......\n.###..\n.##...\n.#....\n......\n......\n", "half a square");
    assert_eq!(frame.depth[7], 10.0, "the plane z = 0 seen from z = 10");
    assert_eq!(frame.ids[7], 0, "the first triangle");
    assert_eq!((frame.depth[0], frame.ids[0]), (f32::INFINITY, EMPTY_ID), "nothing there");
    assert_eq!(frame.color[7], Vec4::ONE, "counter-clockwise: the front");
    assert_eq!(frame.normal[7], Vec3::Z, "towards the viewer");
    let mut turned = list.clone();
    let back = buffers(&[[1.0, 1.0, 0.0], [5.0, 1.0, 0.0], [1.0, 5.0, 0.0]], &[0, 1, 2]);
    turned.geometries[0] = Geometry::new(back);
    let frame = draw(&turned, &view, 1);
    assert_eq!(frame.color[7], Vec4::new(0.5, 0.5, 0.5, 1.0), "clockwise: the back");
    assert_eq!(frame.normal[7], -Vec3::Z, "turned towards the viewer");
}

#[test]
fn a_mirrored_instance_shows_the_same_side() {
    let view = pixel_view(4, 4);
    let mut list = DrawList::default();
    let corners = buffers(&[[-4.0, 0.0, 0.0], [-4.0, 4.0, 0.0], [0.0, 0.0, 0.0]], &[0, 1, 2]);
    add(&mut list, &view, Primitive::Triangles, corners, Blend::Opaque);
    list.instances[0] = Instance::new(&DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0)), &view);
    let frame = draw(&list, &view, 4);
    assert_eq!(frame.color[2], Vec4::ONE, "the front, though its winding is turned round");
}

#[test]
fn samples_lie_where_vulkan_puts_them() {
    // the left half of a pixel holds two of Vulkan's four samples, the left quarter one
    let view = pixel_view(1, 1);
    for (right, alpha) in [(0.5, 0.5), (0.25, 0.25), (0.2, 0.25), (0.1, 0.0)] {
        let mut list = DrawList::default();
        let quad = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [right, 1.0, 0.0], [right, 0.0, 0.0]];
        add(&mut list, &view, Primitive::Cards, buffers(&quad, &[0, 1, 2, 3]), Blend::Opaque);
        assert_eq!(draw(&list, &view, 4).color[0].w, alpha, "right edge at {right}");
    }
}

#[test]
fn a_shared_edge_is_drawn_exactly_once() {
    // a fan around a centre with all kinds of slopes, half transparent: a sample drawn twice would
    // have alpha 0.75, one left out 0
    let view = pixel_view(64, 64);
    for sample_count in [1, 4, 8, 16] {
        for shift in [0.0, 0.25, 0.371] {
            let count = 23_u32;
            let mut points = vec![[32.0 + shift, 32.0, 0.0]];
            for i in 0..count {
                let angle = i as f32 / count as f32 * std::f32::consts::TAU;
                let (sin, cos) = (libm::sinf(angle), libm::cosf(angle));
                points.push([32.0 + 100.0 * cos, 32.0 + 100.0 * sin, 0.0]);
            }
            let fan: Vec<u32> = (0..count).flat_map(|i| [0, 1 + i, 1 + (i + 1) % count]).collect();
            let mut data = buffers(&points, &fan);
            data.base.fill(Vec4::new(1.0, 1.0, 1.0, 0.5));
            let mut list = DrawList::default();
            add(&mut list, &view, Primitive::Triangles, data, Blend::Over);
            let frame = draw(&list, &view, sample_count);
            let wrong = frame.color.iter().position(|pixel| pixel.w != 0.5);
            assert_eq!(wrong, None, "{sample_count} samples, shifted by {shift}");
        }
    }
}

#[test]
fn points_are_squares_and_lines_are_rectangles() {
    let view = pixel_view(6, 5);
    let mut list = DrawList::default();
    let data = buffers(&[[1.5, 1.5, 0.0], [4.5, 2.5, 0.0]], &[0, 1]);
    add(&mut list, &view, Primitive::Points { size_px: 1.0 }, data.clone(), Blend::Opaque);
    let frame = draw(&list, &view, 1);
    assert_eq!(ascii(&frame), "......\n.#....\n....#.\n......\n......\n", "one pixel each");
    let mut list = DrawList::default();
    add(&mut list, &view, Primitive::Points { size_px: 2.0 }, data, Blend::Opaque);
    let frame = draw(&list, &view, 4);
    assert_eq!(
        ascii(&frame),
        "353...\n5#5353\n3535#5\n...353\n......\n",
        "two pixels across, half and quarter pixels at the rim"
    );
    let mut list = DrawList::default();
    let data = buffers(&[[1.0, 2.5, 0.0], [5.0, 2.5, 0.0]], &[0, 1]);
    add(&mut list, &view, Primitive::Lines { width_px: 3.0 }, data, Blend::Opaque);
    let frame = draw(&list, &view, 1);
    assert_eq!(ascii(&frame), "......\n.####.\n.####.\n.####.\n......\n", "butt ends");
    assert_eq!((frame.stats.line_count, frame.stats.vertex_count), (1, 2), "one line");
}

#[test]
fn the_nearest_wins_and_the_earlier_of_equals() {
    let view = pixel_view(2, 1);
    let square = |z: f32| {
        let corners = [[0.0, 0.0, z], [0.0, 1.0, z], [2.0, 1.0, z], [2.0, 0.0, z]];
        let mut data = buffers(&corners, &[0, 1, 2, 3]);
        data.source_ids = vec![z.to_bits()];
        data
    };
    let mut list = DrawList::default();
    for z in [1.0, 3.0, 3.0, 2.0] {
        add(&mut list, &view, Primitive::Cards, square(z), Blend::Opaque);
    }
    let mut second = Vec::clone(&list.geometries);
    let mut marked = square(3.0);
    marked.source_ids = vec![7];
    second[2] = Geometry::new(marked);
    list.geometries = second;
    let frame = draw(&list, &view, 4);
    assert_eq!(frame.ids, [3.0_f32.to_bits(); 2], "the first of the two at z = 3");
    assert_eq!(frame.depth, [7.0; 2], "seen from z = 10");
}

#[test]
fn blending_follows_paint_order_and_depth_is_where_half_is_reached() {
    let view = pixel_view(1, 1);
    let layer = |z: f32, color: Vec3, alpha: f32| {
        let corners = [[0.0, 0.0, z], [0.0, 1.0, z], [1.0, 1.0, z], [1.0, 0.0, z]];
        let mut data = buffers(&corners, &[0, 1, 2, 3]);
        data.front.fill(color);
        data.base.fill(color.extend(alpha));
        data.source_ids = vec![z.to_bits()];
        data
    };
    let mut list = DrawList::default();
    add(&mut list, &view, Primitive::Cards, layer(0.0, Vec3::X, 1.0), Blend::Opaque);
    add(&mut list, &view, Primitive::Cards, layer(1.0, Vec3::Y, 0.25), Blend::Over);
    add(&mut list, &view, Primitive::Cards, layer(2.0, Vec3::Z, 0.25), Blend::Over);
    add(&mut list, &view, Primitive::Cards, layer(3.0, Vec3::Y, 0.25), Blend::Over);
    let frame = draw(&list, &view, 1);
    // 0.75^3 of red; green 0.25 * 0.75^2 + 0.25; blue 0.25 * 0.75
    assert_eq!(frame.color[0], Vec4::new(0.421_875, 0.390_625, 0.1875, 1.0), "by hand");
    // opacity 0.25, 0.4375, 0.578 front to back: the third layer, at z = 1
    assert_eq!((frame.depth[0], frame.ids[0]), (9.0, 1.0_f32.to_bits()), "half at the third");
    list.items.pop();
    let frame = draw(&list, &view, 1);
    assert_eq!((frame.depth[0], frame.ids[0]), (10.0, 0), "never half: the wood behind");
    list.items.truncate(1);
    assert_eq!(draw(&list, &view, 1).color8[0], [255, 0, 0, 255], "8-bit red");
}

#[test]
fn a_background_shows_through() {
    let view = pixel_view(1, 1);
    let settings = Settings {
        sample_count: 1,
        outputs: ALL,
        background: Vec4::new(0.25, 0.5, 1.0, 1.0),
        counts_fragments: true,
    };
    let empty = DrawList::default();
    let frame = Renderer::default().render(&empty, &view, &settings, &Job::default());
    let frame = frame.expect("an empty list is a valid one");
    assert_eq!(frame.color, [settings.background], "nothing in front");
    assert_eq!(frame.depth, [f32::INFINITY], "and nothing there");
}

#[test]
fn slabs_take_each_sample_once() {
    // a slanted plane cut at depth 10: together the two slabs are the whole
    let view = pixel_view(32, 32);
    let mut list = DrawList::default();
    let slanted = [[2.0, 3.0, -3.0], [4.0, 30.0, 2.0], [29.0, 11.0, 3.0]];
    add(&mut list, &view, Primitive::Triangles, buffers(&slanted, &[0, 1, 2]), Blend::Opaque);
    let whole = draw(&list, &view, 4);
    let mut slab = |range: [f32; 2]| {
        list.items[0].slab = Some(range);
        draw(&list, &view, 4)
    };
    let near = slab([0.0, 10.0]);
    let far = slab([10.0, f32::INFINITY]);
    for pixel in 0..whole.color.len() {
        let sum = near.color[pixel] + far.color[pixel];
        assert_eq!(sum, whole.color[pixel], "pixel {pixel}");
    }
    for slab in [near, far] {
        let covered: f32 = slab.color.iter().map(|pixel| pixel.w).sum();
        assert!(covered > 50.0, "both hold a part: {covered}");
    }
}

/// Random triangles, cards, lines and points of all surfaces and blends, some behind the eye.
pub(crate) fn soup(seed: u64, view: &View) -> DrawList {
    let mut numbers = Numbers(seed);
    let mut list = DrawList::default();
    let mut texels = Vec::new();
    for _ in 0..16 * 16 {
        texels.push([0; 4].map(|_| unorm8(numbers.next())));
    }
    let mut levels = vec![Image::new(16, 16, texels).expect("valid")];
    while levels.last().expect("one").width > 1 {
        let last = levels.last().expect("one");
        let side = last.width / 2;
        let half: Vec<[u8; 4]> =
            (0..side * side).map(|i| last.texel(i % side * 2, i / side * 2)).collect();
        levels.push(Image::new(side, side, half).expect("valid"));
    }
    // the same with little in it, which its bounds know
    let mut sparse = levels.clone();
    for level in &mut sparse {
        let width = level.width;
        for (i, texel) in (0..).zip(&mut level.texels) {
            let is_empty = width > 1 && (i % width > width / 2 || i / width > width / 2);
            texel[3] = if is_empty { 0 } else { texel[3] };
        }
    }
    let sparse = Texture::new(sparse).expect("halves").bounded();
    let texture = Texture::new(levels).expect("halves");
    let kinds = [
        Primitive::Triangles,
        Primitive::Cards,
        Primitive::Lines { width_px: 1.7 },
        Primitive::Points { size_px: 2.3 },
    ];
    let filters = [Filter::Nearest, Filter::Bilinear, Filter::Trilinear];
    for round in 0..30 {
        let primitive = kinds[round % 4];
        let size = if (4..24).contains(&round) { 0.5 } else { 4.0 };
        let corner_count = primitive.index_count();
        let mut points = Vec::new();
        for _ in 0..12 {
            let mut at = || (numbers.next() - 0.5) * 8.0;
            let middle = Vec3::new(at(), at(), at());
            let mut offset = || Vec3::from([0; 3].map(|_| (numbers.next() - 0.5) * size));
            if primitive == Primitive::Cards {
                let (u, v) = (offset(), offset());
                points.extend([middle - u, middle - v, middle + u, middle + v]);
            } else {
                points.extend((0..corner_count).map(|_| middle + offset()));
            }
        }
        let count = u32::try_from(points.len()).expect("few");
        let mut data = buffers(&vec![[0.0; 3]; points.len()], &(0..count).collect::<Vec<_>>());
        data.positions = points;
        for i in 0..data.positions.len() {
            data.base[i] = Vec4::new(0.2, 0.4, 0.6, 0.3 + 0.7 * numbers.next());
            data.front[i] = Vec3::new(numbers.next(), numbers.next(), numbers.next());
            data.back[i] = data.front[i] * 0.5;
            data.uvs[i] = Vec2::new(numbers.next() * 3.0 - 1.0, numbers.next() * 2.0);
            if round >= 18 {
                data.uvs[i] = data.uvs[i].fract().abs();
            }
            data.normals[i] = Vec3::new(numbers.next() - 0.5, 0.3, 0.2).normalize();
        }
        let mut blend = [Blend::Opaque, Blend::Test(0.4), Blend::Over][round % 3];
        if round >= 12 && blend == Blend::Opaque {
            blend = Blend::Coverage;
        }
        add(&mut list, view, primitive, data, blend);
        let item = list.items.last_mut().expect("just added");
        if round % 5 == 0 {
            item.slab = Some([2.0, 4.0]);
        }
        let instance = &mut list.instances[item.instances.start as usize];
        if round >= 18 {
            let sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: filters[round / 2 % 3] };
            item.surface = Surface::Textured { texture: 1, sampler };
            instance.tint = Vec4::from([0; 4].map(|_| 0.4 + 0.6 * numbers.next()));
        } else if round >= 15 {
            let sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: filters[round % 3] };
            item.surface = Surface::Indirect { distribution: 0, leaves: 0, sampler };
        } else if round % 2 == 0 {
            let wrap = [[Wrap::Repeat; 2], [Wrap::Mirror, Wrap::Clamp]][round / 2 % 2];
            item.surface = Surface::Textured {
                texture: 0,
                sampler: Sampler { wrap, filter: filters[round / 2 % 3] },
            };
        }
    }
    list.textures.push(Arc::clone(&texture));
    list.textures.push(sparse);
    list.distributions.push(distribution(&mut numbers));
    // blended items are painted last, as every technique does
    list.items.sort_by_key(|item| item.blend == Blend::Over);
    list
}

/// Side of a leaf's square in texture space.
const LEAF: Vec2 = Vec2::new(0.4, 0.5);

/// Two layers of leaves in four versions, at random places.
fn distribution(numbers: &mut Numbers) -> Arc<Distribution> {
    let mut layer = || {
        let mut place = || {
            let corner = Vec2::new(numbers.next(), numbers.next()) * 0.7;
            let tint = [0; 3].map(|_| unorm8(numbers.next()));
            let rotation = if numbers.next() < 0.5 { 1 } else { 3 };
            LeafPlace::new(corner, LEAF, rotation, numbers.next() < 0.5, tint)
        };
        let mut places: Vec<LeafPlace> = (0..64).map(|_| place()).collect();
        places[7] = LeafPlace::NONE;
        places
    };
    let parts = Parts {
        size: (8, 8),
        layers: vec![layer(), layer()],
        leaf_size: LEAF,
        versions: [[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [0.5, 0.5]].map(Vec2::from).to_vec(),
        version_size: Vec2::splat(0.5),
        largest_tint: 1.5,
    };
    Distribution::new(parts).expect("valid")
}

#[test]
fn coverage_takes_as_many_samples_as_alpha_asks_for() {
    let view = pixel_view(1, 1);
    let quad = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 0.0, 0.0]];
    let card = |alpha: f32, height: f32, id: u32| {
        let mut data = buffers(&quad.map(|[x, y, _]| [x, y, height]), &[0, 1, 2, 3]);
        data.base.iter_mut().for_each(|base| base.w = alpha);
        data.source_ids = vec![id];
        data
    };
    for (samples, alpha, covered) in [
        (1, 0.49, 0.0),
        (1, 0.5, 1.0),
        (4, 0.3, 0.25),
        (4, 0.7, 0.75),
        (16, 0.5, 0.5),
        (16, 1.0, 1.0),
    ] {
        let mut list = DrawList::default();
        add(&mut list, &view, Primitive::Cards, card(alpha, 0.0, 5), Blend::Coverage);
        assert_eq!(draw(&list, &view, samples).color[0].w, covered, "{alpha}, {samples} samples");
    }
    // one half behind one half: on average three quarters, as for independent samples
    let mut sum = 0.0;
    for id in 0..1024 {
        let mut list = DrawList::default();
        add(&mut list, &view, Primitive::Cards, card(0.5, 1.0, id), Blend::Coverage);
        add(&mut list, &view, Primitive::Cards, card(0.5, 0.0, id + 5000), Blend::Coverage);
        sum += draw(&list, &view, 16).color[0].w;
    }
    let mean = sum / 1024.0;
    // two random halves of 16 samples share 4 of them, with a standard deviation of 1.03 or 0.065 of
    // all: four of a mean of 1024
    assert!((mean - 0.75).abs() < 0.008, "{mean}");
}

pub(crate) fn soup_views() -> [View; 2] {
    let eye = DVec3::new(1.0, 2.0, 3.0);
    [Projection::Perspective { fov_y: FRAC_PI_3 }, Projection::Orthographic { height: 7.0 }]
        .map(|kind| View::new(eye, DVec3::ZERO, DVec3::Y, kind, (61, 47), 0.1).expect("valid"))
}

#[test]
fn equals_the_naive_twin() {
    for seed in 0..12 {
        for view in soup_views() {
            let list = soup(seed, &view);
            for sample_count in [1, 4, 8, 16, 21] {
                let fast = draw(&list, &view, sample_count);
                let naive = draw_naive(&list, &view, sample_count, &Job::default()).expect("valid");
                assert_eq!(fast.ids, naive.ids, "seed {seed}, {sample_count} samples");
                assert_eq!(fast.depth, naive.depth, "seed {seed}, {sample_count} samples");
                // sums in another order, and untextured triangles at the samples' centroid: colour
                // over depth bends inside a pixel where a triangle is small or very close
                let (most, mean) = if sample_count == 1 { (0.0, 0.0) } else { (0.1, 2e-4) };
                // colour alone is painted by vectors; with other layers a sample at a time
                let alone = Outputs { depth: true, ..Outputs::COLOR };
                let alone = draw_outputs(&list, &view, sample_count, alone);
                assert_eq!(alone.depth, naive.depth, "seed {seed}, {sample_count} samples");
                for color in [&fast.color, &alone.color] {
                    let errors: Vec<f32> = color
                        .iter()
                        .zip(&naive.color)
                        .map(|(a, b)| (*a - *b).abs().max_element())
                        .collect();
                    let largest = errors.iter().copied().fold(0.0, f32::max);
                    let average = errors.iter().sum::<f32>() / errors.len() as f32;
                    assert!(
                        largest <= most && average <= mean,
                        "seed {seed}, {sample_count} samples: {largest} at most, {average} on average"
                    );
                }
            }
        }
    }
}

#[test]
fn the_same_bytes_on_any_number_of_threads_and_in_batches() {
    for view in soup_views() {
        let list = soup(99, &view);
        // every item 200 times over, so that there are several units
        let mut long = list.clone();
        for item in &mut long.items {
            let first = long.instances[item.instances.start as usize];
            let start = u32::try_from(long.instances.len()).expect("few");
            for i in 0..200_u8 {
                let shift = Vec3::splat(f32::from(i) * 0.01);
                long.instances.push(Instance { translation: first.translation + shift, ..first });
            }
            item.instances = start..start + 200;
        }
        for sample_count in [4, 16] {
            let settings = Settings {
                sample_count,
                outputs: ALL,
                background: Vec4::ZERO,
                counts_fragments: true,
            };
            let with = |thread_count: usize, max_batch_units: usize| {
                let mut renderer =
                    Renderer { max_batch_units, max_tile_side: 16, ..Renderer::default() };
                let draw = || renderer.render(&long, &view, &settings, &Job::default());
                let mut frame = job::run(Some(thread_count), draw).expect("valid");
                frame.stats = super::Stats::default();
                frame
            };
            let one = with(1, 512);
            assert!(one == with(3, 512), "{sample_count} samples: three threads");
            let batches = with(2, 3);
            assert!(one.depth == batches.depth, "{sample_count} samples: depth in batches");
            assert!(one.ids == batches.ids, "{sample_count} samples: ids in batches");
            // a shape that a later batch hides in part was coloured before, at another centroid
            let differences = one.color.iter().zip(&batches.color).map(|(a, b)| (*a - *b).abs());
            let largest = differences.fold(Vec4::ZERO, Vec4::max).max_element();
            // seen: 0.0224 of these soups; a step between colours would be tenths
            assert!(largest <= 0.03, "{sample_count} samples: colour in batches, {largest}");
        }
    }
}

#[test]
fn fragments_are_pixels_of_which_a_sample_is_covered() {
    // thin enough that of some pixels only the later samples are covered, and wide enough for i64
    let view = pixel_view(80, 80);
    let thin = buffers(&[[1.0, 1.0, 0.0], [30.3, 75.1, 0.0], [30.6, 74.7, 0.0]], &[0, 1, 2]);
    let large = buffers(&[[-9e4, 3.0, 0.0], [9e4, 40.2, 0.0], [9e4, 40.0, 0.0]], &[0, 1, 2]);
    let point = buffers(&[[40.3, 40.6, 0.0]], &[0]);
    let shapes = [
        (Primitive::Triangles, thin),
        (Primitive::Triangles, large),
        (Primitive::Points { size_px: 0.7 }, point),
    ];
    for (primitive, data) in shapes {
        for blend in [Blend::Opaque, Blend::Test(0.5), Blend::Over] {
            for sample_count in [1, 4, 8, 16] {
                let mut list = DrawList::default();
                add(&mut list, &view, primitive, data.clone(), blend);
                let frame = draw(&list, &view, sample_count);
                let shown = frame.color.iter().filter(|pixel| pixel.w > 0.0).count() as u64;
                let counted = frame.stats.fragment_count.expect("asked for");
                assert_eq!(counted, shown, "{primitive:?}, {blend:?}, {sample_count} samples");
                let settings = Settings {
                    sample_count,
                    outputs: ALL,
                    background: Vec4::ZERO,
                    counts_fragments: false,
                };
                let uncounted =
                    Renderer::default().render(&list, &view, &settings, &Job::default());
                let uncounted = uncounted.expect("valid");
                assert_eq!(uncounted.stats.fragment_count, None, "not asked for");
                assert_eq!(uncounted.color, frame.color, "the same picture, in larger tiles");
            }
        }
    }
}

#[test]
fn sizes_that_no_picture_has_are_refused() {
    let view = pixel_view(4, 4);
    for size_px in [0.0, -1.0, 1e9, f32::NAN, f32::INFINITY] {
        for primitive in [Primitive::Points { size_px }, Primitive::Lines { width_px: size_px }] {
            let mut list = DrawList::default();
            let data = buffers(&[[1.0, 1.0, 0.0], [2.0, 2.0, 0.0]], &[0, 1]);
            add(&mut list, &view, primitive, data, Blend::Opaque);
            let settings = Settings {
                sample_count: 1,
                outputs: ALL,
                background: Vec4::ZERO,
                counts_fragments: true,
            };
            let drawn = Renderer::default().render(&list, &view, &settings, &Job::default());
            let text = drawn.expect_err("refused").to_string();
            assert!(text.contains("pixels are not in (0, 16384]"), "{primitive:?}: {text}");
        }
    }
}

#[test]
fn the_same_bytes_at_every_level() {
    let levels = Level::all();
    for (seed, view) in (20..).zip(soup_views().iter().cycle()).take(8) {
        let list = soup(seed, view);
        for sample_count in [1, 4, 8, 16, 21] {
            let settings = Settings {
                sample_count,
                outputs: ALL,
                background: Vec4::ZERO,
                counts_fragments: true,
            };
            let frames = levels.iter().map(|&level| {
                let mut renderer = Renderer::with_simd(level);
                renderer.render(&list, view, &settings, &Job::default()).expect("valid")
            });
            let frames: Vec<Frame> = frames
                .map(|frame| Frame {
                    stats: super::Stats { draw_millis: 0.0, ..frame.stats },
                    ..frame
                })
                .collect();
            for (frame, level) in frames.iter().zip(&levels) {
                assert!(*frame == frames[0], "seed {seed}, {sample_count} samples, {level:?}");
            }
        }
    }
}

#[test]
fn a_renderer_can_be_used_again() {
    let mut renderer = Renderer::default();
    let settings =
        Settings { sample_count: 4, outputs: ALL, background: Vec4::ZERO, counts_fragments: true };
    let [first_view, other_view] = soup_views();
    let mut first = None;
    for view in [&first_view, &other_view, &first_view] {
        let list = soup(5, view);
        let frame = renderer.render(&list, view, &settings, &Job::default()).expect("valid");
        let color = frame.color;
        if first.is_none() {
            first = Some(color);
        } else if std::ptr::eq(view, &first_view) {
            assert!(first.as_ref() == Some(&color), "the same picture after another one");
        }
    }
    // what was there before does not show through what is empty
    let nothing = DrawList::default();
    let frame = renderer.render(&nothing, &first_view, &settings, &Job::default()).expect("valid");
    assert!(frame.color.iter().all(|&pixel| pixel == Vec4::ZERO), "no colour");
    assert!(frame.depth.iter().all(|&depth| depth == f32::INFINITY), "no depth");
    assert!(frame.ids.iter().all(|&id| id == EMPTY_ID), "no id");
}

#[test]
fn a_cancelled_picture_is_an_error() {
    let view = pixel_view(4, 4);
    let settings =
        Settings { sample_count: 1, outputs: ALL, background: Vec4::ZERO, counts_fragments: true };
    let job = Job::default();
    job.cancel();
    let result = Renderer::default().render(&soup(1, &view), &view, &settings, &job);
    assert_eq!(result.expect_err("cancelled"), crate::LodError::Cancelled, "at the first check");
}

#[test]
fn normals_stay_upright_on_stretched_instances() {
    // a plane at 45 degrees, stretched twice along x: its normal leans towards y
    let view = pixel_view(4, 4);
    let mut data = buffers(&[[0.0, 0.0, 0.0], [0.0, 8.0, 0.0], [8.0, 0.0, 0.0]], &[0, 1, 2]);
    data.normals.fill(Vec3::new(1.0, 1.0, 0.0).normalize());
    let mut list = DrawList::default();
    add(&mut list, &view, Primitive::Triangles, data, Blend::Opaque);
    list.instances[0] = Instance::new(&DAffine3::from_scale(DVec3::new(2.0, 1.0, 1.0)), &view);
    let normal = draw(&list, &view, 1).normal[0];
    let expected = Vec3::new(0.5, 1.0, 0.0).normalize();
    assert!((normal - expected).length() < 1e-6, "{normal} for {expected}");
}

#[test]
fn colours_follow_perspective() {
    // ground at y = -1 from depth 1 (black) to 3 (white): row 74.5 of 100 shows depth 50 / 24.5
    let projection = Projection::Perspective { fov_y: std::f64::consts::FRAC_PI_2 };
    let view = View::new(DVec3::ZERO, DVec3::NEG_Z, DVec3::Y, projection, (100, 100), 0.01);
    let view = view.expect("valid");
    let ground = [[-1.0, 1.0, -1.0], [1.0, 1.0, -1.0], [3.0, 1.0, -3.0], [-3.0, 1.0, -3.0]];
    let mut data = buffers(&ground, &[0, 1, 2, 3]);
    data.front = vec![Vec3::ZERO, Vec3::ZERO, Vec3::ONE, Vec3::ONE];
    data.back.clone_from(&data.front);
    let mut list = DrawList::default();
    add(&mut list, &view, Primitive::Cards, data, Blend::Opaque);
    let seen = draw(&list, &view, 1).color[74 * 100 + 50].x;
    let expected = (50.0 / 24.5 - 1.0) / 2.0;
    assert!((seen - expected).abs() < 1e-4, "{seen} for {expected}, and 0.765 without perspective");
}
