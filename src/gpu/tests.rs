//! The same lists on the card and on the processor: random ones that hold everything a list can, and
//! what random ones do not.

use std::fmt::Debug;
use std::sync::Arc;

use glam::{DAffine3, DVec3, Mat3, Vec2, Vec3, Vec4};
use naga::back::{hlsl, msl};
use naga::front::wgsl;
use naga::valid::{Capabilities, ValidationFlags, Validator};

use super::device::renderer_of_its_own;
use super::render;
use crate::draw_list::{Blend, DrawList, Instance, Primitive, Surface};
use crate::error::LodError;
use crate::job::Job;
use crate::raster::parallax::tests as windows;
use crate::raster::tests::{add, buffers, pixel_view, soup, soup_views};
use crate::raster::{Frame, Outputs, Renderer, Settings};
use crate::texture::{Filter, Image, Sampler, Texture, Wrap};
use crate::view::{Projection, View};

const ALL: Outputs =
    Outputs { color: true, depth: true, ids: true, normal: true, albedo: true, color8: true };

/// Of colours: texels are halves on a card, and some cards filter with weights in steps of 1/256. Both
/// together stay below a code of eight bits.
const COLOR_TOLERANCE: f32 = 1.0 / 255.0;

/// Of normals: those of an untextured shape are taken at each sample on a card, and in the middle of the
/// samples on the processor, and noise has short ones, which are made long.
const NORMAL_TOLERANCE: f32 = 0.06;

/// Of depths, as a share: f32 numbers that were computed in another order.
const DEPTH_TOLERANCE: f32 = 1e-4;

/// Share of a soup's pixels that may differ by more: rims of shapes that rounding moves over a sample.
/// Seen: 0.004.
const RIM: f64 = 0.008;

/// The same of four samples at once, whose untextured colours are taken somewhere inside what is covered.
const FOUR_RIM: f64 = 0.016;

/// The same of windows on random depths, which a step of parallax carries far. Seen: 0.023.
const RIM_OF_DEPTHS: f64 = 0.04;

/// The same where levels of detail are read, which a card measures over two by two pixels; the levels of
/// a soup's textures have nothing to do with one another. Seen: 0.077 and 0.123.
const LEVELS: f64 = 0.15;

/// Translates a shader as wgpu does for Metal and for DirectX 12, which these tests do not run on.
pub(super) fn check_translation(source: &str, what: &dyn Debug) {
    let module = wgsl::parse_str(source)
        .unwrap_or_else(|error| panic!("{what:?}: {}", error.emit_to_string(source)));
    let capabilities = Capabilities::default() | Capabilities::MULTISAMPLED_SHADING;
    let info = Validator::new(ValidationFlags::all(), capabilities)
        .validate(&module)
        .unwrap_or_else(|error| panic!("{what:?}: {}", error.emit_to_string(source)));
    let (options, pipeline) = (hlsl::Options::default(), hlsl::PipelineOptions::default());
    let mut text = String::new();
    let written = hlsl::Writer::new(&mut text, &options, &pipeline)
        .write(&module, &info, None)
        .unwrap_or_else(|error| panic!("{what:?} in HLSL: {error}"));
    for name in written.entry_point_names {
        name.unwrap_or_else(|error| panic!("{what:?} in HLSL: {error}"));
    }
    // of macOS 10.14 and iOS 12, the first with invariant positions
    let options = msl::Options { lang_version: (2, 1), ..msl::Options::default() };
    let pipeline = msl::PipelineOptions::default();
    let (_, written) = msl::write_string(&module, &info, &options, &pipeline)
        .unwrap_or_else(|error| panic!("{what:?} in MSL: {error}"));
    for name in written.entry_point_names {
        name.unwrap_or_else(|error| panic!("{what:?} in MSL: {error}"));
    }
}

fn settings(sample_count: u32, outputs: Outputs) -> Settings {
    let background = Vec4::new(0.1, 0.2, 0.3, 0.5);
    Settings { sample_count, outputs, background, counts_fragments: false }
}

/// A list on the card; `None` where there is none and nobody promised one.
fn on_card(list: &DrawList, view: &View, settings: &Settings) -> Option<Frame> {
    match render(None, list, view, settings, &Job::default()) {
        Ok((frame, _)) => Some(frame),
        Err(LodError::NoAdapter { why }) => {
            let promised = std::env::var_os("CI").is_some();
            assert!(!promised, "a check of the whole project needs a card: {why}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

fn on_processor(list: &DrawList, view: &View, settings: &Settings) -> Frame {
    Renderer::default().render(list, view, settings, &Job::default()).expect("valid")
}

/// Share of the pixels of each plane that differ by more than its tolerance.
fn differences(a: &Frame, b: &Frame) -> [(&'static str, f64); 6] {
    let length = a.width * a.height;
    let share = |differs: &dyn Fn(usize) -> bool, is_there: bool| {
        let count = if is_there { (0..length).filter(|&at| differs(at)).count() } else { 0 };
        count as f64 / length as f64
    };
    let far = |a: Vec4, b: Vec4| (a - b).abs().max_element() > COLOR_TOLERANCE;
    let near = |a: f32, b: f32| a == b || (a - b).abs() <= DEPTH_TOLERANCE * b.abs();
    // a code's rounding, and what the colour may be off
    let coded = |at: usize| a.color8[at].iter().zip(b.color8[at]).any(|(a, b)| a.abs_diff(b) > 2);
    let turned = |a: Vec3, b: Vec3| (a - b).abs().max_element() > NORMAL_TOLERANCE;
    [
        ("color", share(&|at| far(a.color[at], b.color[at]), !b.color.is_empty())),
        ("albedo", share(&|at| far(a.albedo[at], b.albedo[at]), !b.albedo.is_empty())),
        ("depth", share(&|at| !near(a.depth[at], b.depth[at]), !b.depth.is_empty())),
        ("ids", share(&|at| a.ids[at] != b.ids[at], !b.ids.is_empty())),
        ("normal", share(&|at| turned(a.normal[at], b.normal[at]), !b.normal.is_empty())),
        ("color8", share(&|at| coded(at), !b.color8.is_empty())),
    ]
}

/// Largest of them.
fn difference(a: &Frame, b: &Frame) -> f64 {
    differences(a, b).into_iter().fold(0.0, |most, (_, share)| share.max(most))
}

/// Checks that a list looks alike on both.
fn check(
    what: &str,
    list: &DrawList,
    view: &View,
    (sample_count, outputs): (u32, Outputs),
    most: f64,
) {
    let settings = settings(sample_count, outputs);
    let Some(card) = on_card(list, view, &settings) else { return };
    let found = differences(&card, &on_processor(list, view, &settings));
    let fits = found.iter().all(|&(_, share)| share <= most);
    assert!(fits, "{what}, {sample_count} samples, more than {most}: {found:?}");
}

/// The same without levels of detail.
fn flat(mut list: DrawList) -> DrawList {
    for item in &mut list.items {
        let sampler: &mut Sampler = match &mut item.surface {
            Surface::VertexColor => continue,
            Surface::Textured { sampler, .. }
            | Surface::Indirect { sampler, .. }
            | Surface::Parallax { sampler, .. } => sampler,
        };
        if sampler.filter == Filter::Trilinear {
            sampler.filter = Filter::Bilinear;
        }
    }
    list
}

#[test]
fn soups_look_alike() {
    for (seed, view) in (0..3).flat_map(|seed| soup_views().map(|view| (seed, view))) {
        let list = soup(seed, &view);
        let flat = flat(list.clone());
        for sample_count in [1, 8, 21] {
            check("soup", &flat, &view, (sample_count, ALL), RIM);
            check("soup with levels", &list, &view, (sample_count, ALL), LEVELS);
        }
        // colour alone is drawn with four samples at once
        check("soup", &flat, &view, (4, Outputs::COLOR), FOUR_RIM);
        check("soup with levels", &list, &view, (4, Outputs::COLOR), LEVELS);
        check("soup", &flat, &view, (4, Outputs::COLOR_DEPTH), RIM);
        // nothing but depth: what a shadow map is
        check("soup", &flat, &view, (1, Outputs { color: false, ..Outputs::COLOR_DEPTH }), RIM);
    }
}

#[test]
fn opaque_soups_have_their_nearest_samples_depth() {
    // without blended shapes, whose depth is searched, four samples are drawn at once with depth, too
    for view in soup_views() {
        let mut list = flat(soup(2, &view));
        list.items.retain(|item| item.blend != Blend::Over);
        check("opaque soup", &list, &view, (4, Outputs::COLOR_DEPTH), FOUR_RIM);
    }
}

#[test]
fn blended_shapes_that_write_depth_hide_where_they_show() {
    for view in soup_views() {
        let mut list = flat(soup(4, &view));
        for item in &mut list.items {
            item.depth_write = true;
        }
        let found: usize = list.items.iter().filter(|item| item.blend == Blend::Over).count();
        assert!(found > 5, "{found} blended items");
        check("blended soup", &list, &view, (1, ALL), RIM);
    }
}

/// One card over the whole of a picture, from texture coordinates (0, 0) to so many.
fn card(view: &View, size: Vec2, alpha: f32, surface: Surface, blend: Blend) -> DrawList {
    let (width, height) = (view.width as f32, view.height as f32);
    let corners = [[0.0, 0.0], [0.0, height], [width, height], [width, 0.0]];
    let mut data = buffers(&corners.map(|[x, y]| [x, y, 0.0]), &[0, 1, 2, 3]);
    data.uvs =
        [[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]].map(|uv| Vec2::from(uv) * size).to_vec();
    data.base.iter_mut().for_each(|base| base.w = alpha);
    let mut list = DrawList::default();
    add(&mut list, view, Primitive::Cards, data, blend);
    list.items[0].surface = surface;
    list
}

const REPEATED: Sampler = Sampler { wrap: [Wrap::Repeat; 2], filter: Filter::Trilinear };

#[test]
fn levels_of_detail_are_those_of_the_longer_step() {
    // levels that are known by their grey: the picture says which is read
    let level = |number: u8| {
        let side = 64 >> number;
        let grey = 40 * number + 10;
        Image::new(side, side, vec![[grey, grey, grey, 255]; (side * side) as usize])
    };
    let levels = (0..=6).map(|number| level(number).expect("valid")).collect();
    let texture = Texture::new(levels).expect("halves");
    let view = pixel_view(64, 32);
    // texels a pixel: 1 and 1, 8 and 1, 1 and 8, 3 and 5
    for size in [[1.0, 0.5], [8.0, 0.5], [1.0, 4.0], [3.0, 2.5]] {
        let surface = Surface::Textured { texture: 0, sampler: REPEATED };
        let mut list = card(&view, Vec2::from(size), 1.0, surface, Blend::Opaque);
        list.textures.push(Arc::clone(&texture));
        check("levels", &list, &view, (1, Outputs::COLOR), 0.0);
    }
}

#[test]
fn mapped_leaves_look_alike() {
    for (seed, view) in (0..4).flat_map(|seed| soup_views().map(|view| (seed, view))) {
        let others = soup(seed, &view);
        let view = pixel_view(96, 64);
        let sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: Filter::Bilinear };
        let surface = Surface::Indirect { distribution: 0, leaves: 0, sampler };
        for blend in [Blend::Opaque, Blend::Test(0.4)] {
            let mut list = card(&view, Vec2::ONE, 1.0, surface, blend);
            list.textures = others.textures.clone();
            list.distributions = others.distributions.clone();
            check("leaves", &list, &view, (1, ALL), RIM);
        }
    }
}

#[test]
fn alpha_that_equals_a_cutoff_passes() {
    // 51 of 255 as a half is below 0.2
    let view = pixel_view(4, 4);
    for (code, cutoff) in [(51, 0.2), (102, 0.4), (128, 128.0 / 255.0), (204, 0.8)] {
        let texel = Image::new(1, 1, vec![[255, 255, 255, code]]).expect("valid");
        let surface = Surface::Textured { texture: 0, sampler: REPEATED };
        let mut list = card(&view, Vec2::ONE, 1.0, surface, Blend::Test(cutoff));
        list.textures.push(Texture::new(vec![texel]).expect("one level"));
        check("equal", &list, &view, (1, Outputs::COLOR), 0.0);
        list.items[0].blend = Blend::Test(cutoff + 1.0 / 255.0);
        check("below", &list, &view, (1, Outputs::COLOR), 0.0);
    }
    let half = card(&view, Vec2::ONE, 0.5, Surface::VertexColor, Blend::Coverage);
    check("half covered", &half, &view, (1, Outputs::COLOR), 0.0);
}

#[test]
fn windows_are_cut_at_the_near_plane() {
    // the wall stands one metre before the window: at 0.5, at 0.25, and at 0.15 before a plane at 0.2
    let projection = Projection::Perspective { fov_y: 0.5 };
    for eye in [1.5, 1.25, 1.15] {
        let view = View::new(DVec3::Z * eye, DVec3::ZERO, DVec3::Y, projection, (4, 4), 0.2);
        let view = view.expect("valid");
        check("wall", &windows::window_on_a_wall(&view, 0.0), &view, (1, ALL), 0.0);
    }
}

#[test]
fn windows_look_alike() {
    for (seed, view) in (0..2).flat_map(|seed| windows::views().map(|view| (seed, view))) {
        let list = windows::list(seed, &view);
        let flat = flat(list.clone());
        for sample_count in [1, 4] {
            let outputs = Outputs { color8: false, ..ALL };
            check("windows", &flat, &view, (sample_count, outputs), RIM_OF_DEPTHS);
            check("windows with levels", &list, &view, (sample_count, outputs), LEVELS);
        }
        check("windows", &flat, &view, (4, Outputs::COLOR), RIM_OF_DEPTHS);
    }
}

#[test]
fn copies_that_fade_and_are_mirrored_look_alike() {
    for view in soup_views() {
        let mut list = flat(soup(5, &view));
        for (number, instance) in (0_u8..).zip(&mut list.instances) {
            instance.fade = [1.0, 0.4, -0.6, 0.75][usize::from(number) % 4];
            instance.seed = number.into();
            if number % 3 == 0 {
                instance.linear *= Mat3::from_diagonal(Vec3::new(-1.2, 0.8, 1.0));
            }
        }
        // two copies of everything, of which one fades and one does not
        let mut doubled = list.clone();
        for item in &mut doubled.items {
            let first = doubled.instances[item.instances.start as usize];
            let start = u32::try_from(doubled.instances.len()).expect("few");
            let moved = first.translation + Vec3::new(0.3, -0.2, 0.1);
            doubled.instances.extend([Instance { translation: moved, fade: 1.0, ..first }, first]);
            item.instances = start..start + 2;
        }
        for sample_count in [1, 4, 16] {
            check("fading soup", &list, &view, (sample_count, ALL), RIM);
            check("doubled soup", &doubled, &view, (sample_count, ALL), RIM);
        }
        check("fading soup", &list, &view, (4, Outputs::COLOR), FOUR_RIM);
    }
}

/// So many points of one pixel, row after row over a picture, each a little nearer than the one before.
fn rows_of_points(view: &View, count: u32, blend: Blend) -> DrawList {
    let at = |index: u32| {
        let (x, y) = (index % view.width, index / view.width % view.height);
        [x as f32 + 0.5, y as f32 + 0.5, index as f32 * 1e-6]
    };
    let points: Vec<[f32; 3]> = (0..count).map(at).collect();
    let mut data = buffers(&points, &(0..count).collect::<Vec<u32>>());
    for (index, front) in (0_u32..).zip(&mut data.front) {
        *front = Vec3::new((index % 7) as f32 / 7.0, (index % 11) as f32 / 11.0, 0.5);
    }
    data.base.iter_mut().for_each(|base| base.w = 0.3);
    data.source_ids = (0..count).map(|index| index ^ 5).collect();
    let mut list = DrawList::default();
    add(&mut list, view, Primitive::Points { size_px: 1.0 }, data, blend);
    list
}

#[test]
fn items_longer_than_one_call_are_drawn_in_order() {
    // more points than a call draws, twice over
    let view = pixel_view(64, 32);
    for blend in [Blend::Opaque, Blend::Over] {
        let mut list = rows_of_points(&view, 600_000, blend);
        let behind = Instance::new(&DAffine3::from_translation(DVec3::NEG_Z), &view);
        list.instances.insert(0, behind);
        list.items[0].instances = 0..2;
        check("points", &list, &view, (1, ALL), 0.0);
    }
}

#[test]
fn what_differs_is_noticed() {
    let [view, _] = soup_views();
    let list = flat(soup(1, &view));
    let settings = settings(1, ALL);
    let Some(card) = on_card(&list, &view, &settings) else { return };
    let noticed = |change: &dyn Fn(&mut DrawList)| {
        let mut other = list.clone();
        change(&mut other);
        difference(&card, &on_processor(&other, &view, &settings))
    };
    assert!(noticed(&|_| {}) <= RIM, "the same");
    type Change = (&'static str, fn(&mut DrawList));
    let changes: [Change; 5] = [
        ("tints", |list| list.instances.iter_mut().for_each(|i| i.tint *= 0.97)),
        ("places", |list| list.instances.iter_mut().for_each(|i| i.translation.x += 0.03)),
        ("fades", |list| list.instances.iter_mut().for_each(|i| i.fade = 0.9)),
        ("slabs", |list| list.items.iter_mut().for_each(|i| i.slab = Some([2.1, 4.0]))),
        ("paint order", |list| list.items.reverse()),
    ];
    for (what, change) in changes {
        let found = noticed(&change);
        assert!(found > 2.0 * RIM, "other {what}: {found}");
    }
}

#[test]
fn what_lists_share_is_uploaded_once_and_kept_as_long_as_it_is_used() {
    let Some(mut renderer) = renderer_of_its_own() else {
        assert!(std::env::var_os("CI").is_none(), "a check of the whole project needs a card");
        return;
    };
    let [view, _] = soup_views();
    let (first, second) = (soup(0, &view), soup(1, &view));
    let settings = settings(1, ALL);
    let mut draw = |list: &DrawList| {
        renderer.draw(list, &view, &settings, &Job::default()).expect("drawn");
        let index_buffer = list
            .items
            .first()
            .map(|item| renderer.resources().arrays(list, item.indices).index_buffer.clone());
        (renderer.resources().held(), index_buffer)
    };
    let (held, buffer) = draw(&first);
    assert_eq!(held, [30, 2, 1, 0], "30 items, two textures and a map");
    assert_eq!(draw(&first), (held, buffer.clone()), "nothing new");
    assert_eq!(draw(&first.clone()), (held, buffer.clone()), "another frame of the same");
    assert_eq!(draw(&second).0, [60, 4, 2, 0], "both are in use");
    assert_eq!(draw(&first), ([60, 4, 2, 0], buffer), "still there");
    drop(first);
    assert_eq!(draw(&second).0, held, "nobody uses the first any more");
    drop(second);
    assert_eq!(draw(&DrawList::default()).0, [0; 4], "nor the second");
}

#[test]
fn a_picture_that_no_card_holds_is_refused_at_once() {
    let view = pixel_view(16384, 8192);
    let settings = settings(1, ALL);
    match render(None, &DrawList::default(), &view, &settings, &Job::default()) {
        // a large card holds it
        Ok(_) | Err(LodError::NoAdapter { .. }) => {}
        Err(error) => {
            assert!(matches!(error, LodError::Limit { name: "size", .. }), "{error}");
        }
    }
}

#[test]
fn a_picture_that_nobody_wants_any_more_is_not_drawn() {
    let [view, _] = soup_views();
    let job = Job::default();
    job.cancel();
    let list = soup(0, &view);
    match render(None, &list, &view, &settings(64, ALL), &job) {
        Err(LodError::Cancelled | LodError::NoAdapter { .. }) => {}
        other => panic!("not cancelled: {:?}", other.map(|(frame, _)| frame.stats)),
    }
    // and the next one is as if nothing had been
    check("after a cancelled one", &flat(list), &view, (1, ALL), RIM);
}
