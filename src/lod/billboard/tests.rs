use glam::{DAffine3, Vec3, Vec4};

use super::*;
use crate::draw_list::DrawList;
use crate::lod::made::{
    Leaf, cameras, crown_at, crowns, draw, emit, facing, from_azimuth, parallel, perspective,
    plant, plant_at, random_crown,
};
use crate::lod::wind::{Gust, Wind};
use crate::raster::{Outputs, Renderer, Settings};
use crate::view::Projection;

fn params() -> Params {
    Params {
        align: Align::Camera,
        axis: Axis::Vertical,
        view_count: 4,
        elevations: vec![0.0],
        picture_blend: PictureBlend::Nearest,
        resolution: (32, 32),
        sample_count: 16,
        drawing: Drawing::Blend,
        format: Format::Rgba8,
        wood: Wood::Full,
        wood_as: WoodAs::Picture,
        views: None,
    }
}

fn build(plant: &Plant, params: &Params) -> Billboard {
    Billboard::build(plant, params, &Job::default()).expect("valid")
}

/// A wall of 2 x 4 m that faces +z and stands on the ground, with a leaf at each end of its depth.
fn wall() -> Vec<Leaf> {
    vec![
        (Vec3::new(0.0, 2.0, 0.0), Vec3::X, Vec3::Y * 2.0),
        (Vec3::new(0.0, 2.0, 0.5), Vec3::X * 0.25, Vec3::Y * 0.25),
        (Vec3::new(0.0, 2.0, -0.5), Vec3::X * 0.25, Vec3::Y * 0.25),
    ]
}

/// Quads of a copy where the plant's file put it.
fn quads(lod: &Billboard, view: &View) -> Vec<Quad> {
    lod.quads(view, &Crown::alone(DAffine3::from_translation(lod.origin()))).expect("taken")
}

fn assert_corners(found: &[DVec3; 4], expected: [[f64; 3]; 4], what: &str) {
    for (found, expected) in found.iter().zip(expected) {
        assert!(found.abs_diff_eq(DVec3::from(expected), 1e-12), "{what}: {found} {expected:?}");
    }
}

#[test]
fn the_corners_stand_about_the_centre() {
    let plant = plant(&wall());
    let lod = build(&plant, &params());
    assert_eq!((lod.center, lod.foot), (DVec3::Y * 2.0, DVec3::ZERO), "of the box");
    // from +z the picture is 2 x 4 m, from +x it is 1 x 4 m
    let ahead = perspective(DVec3::new(0.0, 2.0, 20.0), DVec3::Y * 2.0, DVec3::Y);
    let [quad] = quads(&lod, &ahead)[..] else { panic!("one picture") };
    assert_eq!((quad.number, quad.fade), (0, 1.0), "the picture from +z, all of it");
    let corners = [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 4.0, 0.0], [-1.0, 4.0, 0.0]];
    assert_corners(&quad.corners, corners, "from +z");
    let aside = perspective(DVec3::new(20.0, 5.0, 0.0), DVec3::Y * 2.0, DVec3::new(1.0, 1.0, 1.0));
    let [quad] = quads(&lod, &aside)[..] else { panic!("one picture") };
    assert_eq!(quad.number, 1, "the picture from +x");
    let corners = [[0.0, 0.0, 0.5], [0.0, 0.0, -0.5], [0.0, 4.0, -0.5], [0.0, 4.0, 0.5]];
    assert_corners(&quad.corners, corners, "from +x, above, and rolled");
    // in the plane through the centre that is parallel to the picture
    let half = 0.5_f64.sqrt();
    let tipped = Params { align: Align::ViewPlane, axis: Axis::Free, ..params() };
    let lod = build(&plant, &tipped);
    let view = parallel(DVec3::new(0.0, half, half), DVec3::Y, 9.0, 16);
    let [quad] = quads(&lod, &view)[..] else { panic!("one picture") };
    let (low, high) = ([2.0 - 2.0 * half, 2.0 * half], [2.0 + 2.0 * half, -2.0 * half]);
    let corners = [
        [-1.0, low[0], low[1]],
        [1.0, low[0], low[1]],
        [1.0, high[0], high[1]],
        [-1.0, high[0], high[1]],
    ];
    assert_corners(&quad.corners, corners, "tipped back by 45 degrees");
}

#[test]
fn placed_copies_face_the_eye_too() {
    let lod = build(&plant(&wall()), &params());
    let view = perspective(DVec3::new(10.0, 2.0, 10.0), DVec3::new(10.0, 2.0, 0.0), DVec3::Y);
    // turned by a quarter about +y, twice as large, and mirrored: at (10, 0, 0), straight ahead
    let scale = DVec3::new(-2.0, 2.0, 2.0);
    let placed = DAffine3::from_translation(DVec3::X * 10.0)
        * DAffine3::from_rotation_y(std::f64::consts::FRAC_PI_2)
        * DAffine3::from_scale(scale);
    let [quad] = lod.quads(&view, &Crown::alone(placed)).expect("taken")[..] else {
        panic!("one picture")
    };
    // what faces the eye at +z is the plant's own -x, mirrored to +x
    assert_eq!(quad.number, 1, "its side");
    let corners = [[11.0, 0.0, 0.0], [9.0, 0.0, 0.0], [9.0, 8.0, 0.0], [11.0, 8.0, 0.0]];
    assert_corners(&quad.corners, corners, "twice the size, left and right exchanged");
    assert!(quad.normal.abs_diff_eq(DVec3::Z, 1e-12), "{}", quad.normal);
}

#[test]
fn the_nearest_picture_is_shown_or_two_fade() {
    let plant = plant(&random_crown(20));
    let from = |degrees: f64, height: f64| {
        let eye = lod_center(&plant) + (from_azimuth(degrees) + DVec3::Y * height) * 30.0;
        perspective(eye, lod_center(&plant), DVec3::Y)
    };
    let shown = |params: &Params, view: &View| -> Vec<(usize, f32)> {
        let quads = quads(&build(&plant, params), view);
        quads.iter().map(|quad| (quad.number, quad.fade)).collect()
    };
    let nearest = params();
    for (degrees, number) in [(0.0, 0), (44.0, 0), (46.0, 1), (180.0, 2), (315.5, 0), (300.0, 3)] {
        assert_eq!(shown(&nearest, &from(degrees, 0.2)), [(number, 1.0)], "{degrees}");
    }
    let fading = Params { picture_blend: PictureBlend::CrossFade, ..params() };
    let near = |(number, fade): (usize, f32), expected: (usize, f32)| {
        number == expected.0 && (fade - expected.1).abs() < 1e-6
    };
    let [a, b] = shown(&fading, &from(22.5, 0.2))[..] else { panic!("two pictures") };
    assert!(near(a, (0, 0.75)) && near(b, (1, -0.25)), "{a:?} {b:?}");
    assert_eq!(a.1 - b.1, 1.0, "they fill every sample between them");
    let [a, b] = shown(&fading, &from(300.0, 0.2))[..] else { panic!("two pictures") };
    assert!(near(a, (0, 1.0 / 3.0)) && near(b, (3, -2.0 / 3.0)), "{a:?} {b:?}");
    // on both sides of the middle the same picture has the same samples
    for (degrees, share) in [(44.0, 46.0 / 90.0), (46.0, 44.0 / 90.0)] {
        let [a, b] = shown(&fading, &from(degrees, 0.2))[..] else { panic!("two pictures") };
        assert!(near(a, (0, share)) && near(b, (1, share - 1.0)), "{degrees}: {a:?} {b:?}");
    }
    assert_eq!(shown(&fading, &from(90.0, 0.0)), [(1, 1.0)], "on a picture's azimuth");
    let rings = [0.0_f64, 60.0].map(f64::to_radians).to_vec();
    let ringed = Params { axis: Axis::Free, elevations: rings, ..params() };
    for (height, number) in [(0.0, 1), (0.5, 1), (0.65, 5), (9.0, 5), (-2.0, 1)] {
        // the rings part at 30 degrees, where the height is 0.577
        assert_eq!(shown(&ringed, &from(90.0, height)), [(number, 1.0)], "{height}");
    }
}

fn lod_center(plant: &Plant) -> DVec3 {
    let (low, high) = plant.bounds();
    (low + high) * 0.5
}

fn settings(sample_count: u32) -> Settings {
    let outputs = Outputs::COLOR_DEPTH;
    Settings { sample_count, outputs, background: Vec4::ZERO, counts_fragments: false }
}

/// What storage may change: half a code of sRGB is at most 0.0045 in linear light, half a step of alpha
/// 0.002, and both meet in a premultiplied colour.
const STORED: f32 = 0.0066;

/// Largest difference of a channel, and mean alpha of the first.
fn difference(a: &[Vec4], b: &[Vec4]) -> (f32, f64) {
    let largest = a.iter().zip(b).map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max);
    let alpha: f64 = a.iter().map(|pixel| f64::from(pixel.w)).sum();
    (largest, alpha / a.len() as f64)
}

#[test]
fn from_where_it_was_taken_a_picture_is_the_plant() {
    let leaves = random_crown(60);
    for origin in [DVec3::ZERO, DVec3::new(1e6, -2e5, 3e6)] {
        let plant = plant_at(origin, &[facing(0.0, -1.5, 0.0, 0.2)], &leaves);
        let rings = [0.0_f64, 40.0, 90.0].map(f64::to_radians).to_vec();
        let free = Params { axis: Axis::Free, elevations: rings, ..params() };
        for params in [params(), free] {
            let lod = build(&plant, &params);
            let full = crate::lod::full_mesh::FullMesh::build(
                &plant,
                Wood::Full,
                Filter::Bilinear,
                &Job::default(),
            );
            let full = full.expect("valid");
            for (number, picture) in lod.pictures.iter().enumerate() {
                let picture = picture.as_ref().expect("all were taken");
                let [left, right, low, high] = picture.sides;
                let Frame { right: across, up, toward } = picture.frame;
                let middle =
                    lod.center + across * ((left + right) / 2.0) + up * ((low + high) / 2.0);
                let projection = Projection::Orthographic { height: high - low };
                let (eye, target) = (origin + middle + toward * 20.0, origin + middle);
                let mut view =
                    View::new(eye, target, up, projection, (32, 32), 0.1).expect("valid");
                view.pixel_aspect = (high - low) / (right - left);
                let [quad] = quads(&lod, &view)[..] else { panic!("one picture") };
                assert_eq!(quad.number, number, "the nearest is itself");
                // a sample in the middle of each texel: others would mix it with its neighbours
                let picture_of = |lod: &dyn Representation, sample_count: u32| {
                    let list = emit(lod, &view, &[crown_at(DAffine3::from_translation(origin), 0)]);
                    let (settings, job) = (settings(sample_count), Job::default());
                    Renderer::default().render(&list, &view, &settings, &job).expect("valid").color
                };
                let (reference, shown) = (picture_of(&full, 16), picture_of(&lod, 1));
                let (largest, alpha) = difference(&reference, &shown);
                assert!(alpha > 0.05, "there is something to see: {alpha}");
                assert!(largest < STORED, "picture {number} is off by {largest}");
                // the control: one column of texels beside it
                let mut beside = shown.clone();
                beside.rotate_right(1);
                let (off, _) = difference(&reference, &beside);
                assert!(off > 0.3, "a texel beside it would be seen to differ: {off}");
                // the control: the same plant from behind
                let eye = target * 2.0 - view.eye;
                let behind = View { eye, right: -view.right, back: -view.back, ..view.clone() };
                let list = emit(&lod, &behind, &[crown_at(DAffine3::from_translation(origin), 0)]);
                let frame =
                    Renderer::default().render(&list, &behind, &settings(16), &Job::default());
                let (off, _) = difference(&reference, &frame.expect("valid").color);
                assert!(off > 0.3, "from behind it would be seen to differ: {off}");
            }
        }
    }
}

#[test]
fn two_pictures_that_fade_sum_to_the_whole() {
    // both pictures are full: whatever the shares, every sample is covered once
    let cube: Vec<Leaf> = vec![
        (Vec3::Z * 0.5, Vec3::X * 0.5, Vec3::Y * 0.5),
        (Vec3::Z * -0.5, Vec3::X * 0.5, Vec3::Y * 0.5),
        (Vec3::X * 0.5, Vec3::Z * 0.5, Vec3::Y * 0.5),
        (Vec3::X * -0.5, Vec3::Z * 0.5, Vec3::Y * 0.5),
    ];
    let plant = plant(&cube);
    for drawing in [Drawing::Test, Drawing::Blend, Drawing::Coverage] {
        let fading = Params { picture_blend: PictureBlend::CrossFade, drawing, ..params() };
        let lod = build(&plant, &fading);
        for degrees in [10.0, 30.0, 45.0, 77.0] {
            // 0.8 m of a quad of 1 m fill the picture
            let view = parallel(from_azimuth(degrees), DVec3::Y, 0.8, 24);
            assert_eq!(quads(&lod, &view).len(), 2, "{degrees}: two pictures");
            let least = draw(&lod, &view).color.iter().map(|p| p.w).fold(1.0, f32::min);
            assert!(least > 0.98, "{drawing:?} {degrees}: every sample is covered: {least}");
        }
    }
}

#[test]
fn the_wind_moves_the_top_alone() {
    let lod = build(&plant(&wall()), &params());
    let view = perspective(DVec3::new(0.0, 2.0, 20.0), DVec3::Y * 2.0, DVec3::Y);
    let still = quads(&lod, &view)[0];
    let blown = |wind: Wind, placed: DAffine3| {
        let gust = Gust { wind, time_secs: 0.0, key: (0, 0) };
        let crown = Crown { wind: Some(gust), ..Crown::alone(placed) };
        lod.quads(&view, &crown).expect("taken")[0]
    };
    let steady = Wind { lean: 0.25, sway: 0.0, period_secs: 1.0, toward: None, seed: 0 };
    let moved = blown(steady, DAffine3::IDENTITY);
    let expected = [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 4.0, 0.0], [0.0, 4.0, 0.0]];
    assert_corners(&moved.corners, expected, "4 m up, 1 m to the right");
    let mirrored = blown(steady, DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0)));
    let expected = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 4.0, 0.0], [2.0, 4.0, 0.0]];
    assert_corners(&mirrored.corners, expected, "to the picture's right all the same");
    let large = blown(steady, DAffine3::from_scale(DVec3::splat(2.0)));
    assert!(large.corners[2].abs_diff_eq(DVec3::new(4.0, 8.0, 0.0), 1e-12), "8 m up, 2 m aside");
    let past = blown(Wind { toward: Some(DVec3::NEG_Z), ..steady }, DAffine3::IDENTITY);
    assert_corners(&past.corners, still.corners.map(|c| c.to_array()), "it blows past");
    let slant = Wind { toward: Some(DVec3::new(0.6, 0.0, -0.8)), ..steady };
    let slanted = blown(slant, DAffine3::IDENTITY);
    assert!(slanted.corners[3].abs_diff_eq(DVec3::new(-0.4, 4.0, 0.0), 1e-12), "0.6 of it");
    // the mesh beside the pictures leans as far
    let trunk = [(Vec3::new(0.0, 2.0, 0.0), Vec3::X * 0.1, Vec3::Y * 2.0)];
    let plant = plant_at(DVec3::ZERO, &trunk, &wall());
    let lod = build(&plant, &Params { wood_as: WoodAs::Mesh, ..params() });
    let gust = Gust { wind: steady, time_secs: 0.0, key: (0, 0) };
    let list = emit(&lod, &view, &[Crown { wind: Some(gust), ..crown_at(DAffine3::IDENTITY, 0) }]);
    let instance = list.instances[list.items[0].instances.start as usize];
    let top = instance.linear * (Vec3::Y * 4.0) + instance.translation;
    assert!(top.abs_diff_eq(Vec3::new(1.0, 2.0, -20.0), 1e-6), "relative to the eye: {top}");
}

#[test]
fn a_forest_is_one_item_with_one_texture() {
    let plants = [plant(&wall()), plant(&random_crown(30)), plant(&[facing(0.0, 1.0, 0.0, 1.0)])];
    let borrowed: Vec<&Plant> = plants.iter().collect();
    let view = perspective(DVec3::new(0.0, 3.0, 12.0), DVec3::ZERO, DVec3::Y);
    for drawing in [Drawing::Test, Drawing::Coverage, Drawing::Blend] {
        let params = Params { drawing, ..params() };
        let lods = Billboard::forest(&borrowed, &params, &Job::default()).expect("valid");
        let apart: Vec<Billboard> = plants.iter().map(|plant| build(plant, &params)).collect();
        let bytes: u64 = lods.iter().map(|lod| lod.footprint().texture_bytes).sum();
        assert_eq!(bytes, lods[0].texture.byte_count(), "the parts add up");
        // interleaved in depth, some of them behind others
        let list_of = |lods: &[Billboard]| {
            let mut builder = ListBuilder::default();
            for (number, lod) in (0_u32..).zip(lods) {
                let copy = |row: u32| {
                    let depth = 3 * row + number;
                    let x = f64::from(number) - 1.0;
                    let place = DVec3::new(x, 0.0, -f64::from(depth));
                    crown_at(DAffine3::from_translation(place), 14 - depth)
                };
                let crowns: Vec<Crown> = (0..5).rev().map(copy).collect();
                let state = &mut ViewState::default();
                lod.emit(&view, &crowns, state, &mut builder).expect("taken");
            }
            let list = builder.finish();
            list.check().expect("consistent");
            list
        };
        let (together, apart) = (list_of(&lods), list_of(&apart));
        assert_eq!((together.items.len(), together.textures.len()), (1, 1), "{drawing:?}");
        let Item { primitives, .. } = together.items[0].clone();
        assert_eq!(primitives.len(), 30, "two triangles for each of 15 copies");
        if drawing == Drawing::Blend {
            let Buffers { positions, indices, .. } = &together.own.buffers;
            let quads =
                indices[primitives.start as usize * 3..primitives.end as usize * 3].chunks(6);
            let depths: Vec<f32> = quads.map(|quad| positions[quad[0] as usize].z).collect();
            assert!(depths.is_sorted(), "far to near, whatever plant they are of: {depths:?}");
        }
        assert_eq!(apart.textures.len(), 3, "{drawing:?}: a texture each");
        assert!(apart.items.len() >= 3, "{drawing:?}: and at least an item each");
        let picture = |list: &DrawList| {
            let frame = Renderer::default().render(list, &view, &settings(4), &Job::default());
            frame.expect("valid").color
        };
        let (largest, alpha) = difference(&picture(&together), &picture(&apart));
        assert!(alpha > 0.01, "there is something to see: {alpha}");
        // texture coordinates are rounded to f32 at other places of other textures
        assert!(largest <= 1e-3, "{drawing:?}: the same picture but for {largest}");
    }
}

#[test]
fn only_pictures_that_are_seen_are_taken() {
    let plant = plant(&random_crown(30));
    let from = |degrees: f64, distance: f64| {
        perspective(from_azimuth(degrees) * distance, DVec3::ZERO, DVec3::Y)
    };
    let views = vec![from(95.0, 40.0), from(-10.0, 40.0), from(-5.0, 20.0)];
    let lod = build(&plant, &Params { views: Some(views.clone()), ..params() });
    let numbers: Vec<usize> = lod.pictures().iter().map(|facts| facts.number).collect();
    assert_eq!(numbers, [0, 1], "from +z and from +x");
    for view in &views {
        assert_eq!(quads(&lod, view).len(), 1, "every view finds its own");
    }
    let crown = Crown::alone(DAffine3::IDENTITY);
    let error = lod.quads(&from(180.0, 40.0), &crown).expect_err("not taken");
    assert!(error.to_string().starts_with("camera"), "{error}");
    // a picture has the pixels that its nearest view has, at the nearest point of the plant's ball
    let [_, _, near_wide, _] = lod.pictures()[0].texels;
    let [_, _, far_wide, far_high] = lod.pictures()[1].texels;
    assert!(far_wide < near_wide && near_wide < 32, "{far_wide} from 40 m, {near_wide} from 20 m");
    let nearest = views[0].eye.distance(lod.center) - lod.radius;
    let per_metre = 24.0 / (2.0 * libm::tan(0.5) * nearest);
    let picture = lod.pictures[1].as_ref().expect("taken");
    let high = ((picture.sides[3] - picture.sides[2]) * per_metre).ceil();
    assert_eq!(f64::from(far_high), high, "a texel a pixel");
    let fading = Params { picture_blend: PictureBlend::CrossFade, views: Some(views), ..params() };
    let numbers: Vec<usize> =
        build(&plant, &fading).pictures().iter().map(|facts| facts.number).collect();
    assert_eq!(numbers, [0, 1, 2, 3], "95 degrees fade to the next, and -10 to the last");
}

#[test]
fn wood_is_in_the_pictures_beside_them_or_nowhere() {
    let trunk = [(Vec3::new(0.0, -3.0, 0.0), Vec3::X * 0.5, Vec3::Y * 2.0)];
    let plant = plant_at(DVec3::ZERO, &trunk, &random_crown(30));
    let of = |wood: Wood, wood_as: WoodAs| build(&plant, &Params { wood, wood_as, ..params() });
    let low = |lod: &Billboard| lod.pictures[0].as_ref().expect("taken").sides[2] + lod.center.y;
    let baked = of(Wood::Full, WoodAs::Picture);
    assert_eq!((low(&baked), baked.foot.y), (-5.0, -5.0), "down to the ground");
    assert_eq!(baked.footprint().triangle_count, 0, "no mesh");
    let beside = of(Wood::Full, WoodAs::Mesh);
    assert!(low(&beside) > -1.5, "leaves alone: {}", low(&beside));
    assert_eq!((beside.foot.y, beside.footprint().triangle_count), (-5.0, 2), "and the trunk");
    let bare = of(Wood::None, WoodAs::Picture);
    assert_eq!(bare.footprint().triangle_count, 0, "none at all");
    assert_eq!(low(&bare), low(&beside), "leaves alone");
    // the trunk is seen below the crown, in front of it in the mesh's case
    let view = parallel(DVec3::Z, DVec3::Y, 12.0, 24);
    let at_trunk = |lod: &Billboard| draw(lod, &view).color[20 * 24 + 12].w;
    assert!(at_trunk(&baked) > 0.9 && at_trunk(&beside) > 0.9, "both show it");
    assert_eq!(at_trunk(&bare), 0.0, "and this does not");
}

#[test]
fn a_tint_colours_and_a_test_has_depth() {
    let plant = plant(&[facing(0.0, 0.0, 0.0, 1.0)]);
    let view = parallel(DVec3::Z, DVec3::Y, 4.0, 16);
    let picture = |drawing: Drawing, tint: Vec3| {
        let lod = build(&plant, &Params { drawing, ..params() });
        let list = emit(&lod, &view, &[Crown { tint, ..crown_at(DAffine3::IDENTITY, 0) }]);
        let frame = Renderer::default().render(&list, &view, &settings(4), &Job::default());
        let frame = frame.expect("valid");
        (frame.color[8 * 16 + 8], frame.depth[8 * 16 + 8])
    };
    for drawing in [Drawing::Test, Drawing::Coverage, Drawing::Blend] {
        let (plain, depth) = picture(drawing, Vec3::ONE);
        let (tinted, _) = picture(drawing, Vec3::new(0.5, 1.0, 0.25));
        let expected = plain * Vec4::new(0.5, 1.0, 0.25, 1.0);
        assert!(tinted.abs_diff_eq(expected, 1e-6), "{drawing:?}: {plain} {tinted}");
        // the eye stands at 32 m; a blended card's depth is where the opacity reaches one half
        assert!((depth - 32.0).abs() < 1e-3, "{drawing:?}: {depth}");
    }
}

#[test]
fn awkward_crowns_and_cameras_are_drawn() {
    for (name, leaves) in crowns() {
        let plant = plant(&leaves);
        for axis in [Axis::Vertical, Axis::Free] {
            let limited = Params {
                align: Align::Limited(0.5),
                picture_blend: PictureBlend::CrossFade,
                axis,
                drawing: Drawing::Test,
                resolution: (8, 8),
                ..params()
            };
            let lod = build(&plant, &limited);
            for (camera, view) in cameras() {
                let frame = draw(&lod, &view);
                assert!(frame.color.iter().all(|p| p.is_finite()), "{name}, {camera}");
            }
        }
    }
}

#[test]
fn any_size_and_any_place_is_drawn_alike() {
    let leaves = random_crown(30);
    let picture = |scale: f32, origin: DVec3| {
        let leaves: Vec<Leaf> =
            leaves.iter().map(|&(c, a, b)| (c * scale, a * scale, b * scale)).collect();
        let lod = build(&plant_at(origin, &[], &leaves), &params());
        let eye = origin + DVec3::new(1.0, 0.5, 4.0) * f64::from(scale);
        draw(&lod, &perspective(eye, origin, DVec3::Y)).color
    };
    let metre = picture(1.0, DVec3::ZERO);
    let alpha: f32 = metre.iter().map(|pixel| pixel.w).sum();
    assert!(alpha > 10.0, "there is something to see: {alpha}");
    for (scale, origin) in [
        (1e-4, DVec3::ZERO),
        (1e4, DVec3::ZERO),
        (1.0, DVec3::new(1e6, 1e6, -1e6)),
        (1e3, DVec3::splat(1e6)),
    ] {
        let (largest, _) = difference(&metre, &picture(scale, origin));
        assert!(largest < 0.05, "{scale} at {origin}: off by {largest}");
    }
}

#[test]
fn the_same_bytes_on_any_thread_count() {
    let plant = plant(&random_crown(60));
    let of = |threads: usize| {
        let made = crate::job::run(Some(threads), || {
            let tested = Params { drawing: Drawing::Test, ..params() };
            let lod = Billboard::build(&plant, &tested, &Job::default())?;
            let view = perspective(DVec3::new(3.0, 1.0, 6.0), DVec3::ZERO, DVec3::Y);
            Ok((lod.texture.levels().to_vec(), draw(&lod, &view).color))
        });
        made.expect("valid")
    };
    assert_eq!(of(1), of(3), "1 and 3 threads");
}

#[test]
fn too_many_pictures_are_refused_before_any_is_planned() {
    let plant = plant(&wall());
    let rings = |count: i32| {
        let elevation = |ring: i32| (f64::from(ring) / f64::from(count) * 80.0).to_radians();
        (0..count).map(elevation).collect::<Vec<f64>>()
    };
    let with = |view_count: usize, ring_count: i32, side: u32| Params {
        axis: Axis::Free,
        view_count,
        elevations: rings(ring_count),
        resolution: (side, side),
        ..params()
    };
    // nobody asks whether to stop before a picture is planned, so this is what comes first if one is
    let stopped = Job::default();
    stopped.cancel();
    let refused = |params: &Params, plants: &[&Plant]| {
        Billboard::forest(plants, params, &stopped).expect_err("refused").to_string()
    };
    let view = perspective(DVec3::Z * 9.0, DVec3::ZERO, DVec3::Y);
    let seen = Params { views: Some(vec![view]), ..with(4096, 4096, 1) };
    for (params, plant_count, message) in [
        (with(4096, 4096, 1), 1, "view_count needs 16777216 pictures, the limit is 1048576"),
        (seen, 1, "view_count needs 16777216 pictures, the limit is 1048576"),
        (with(1024, 1025, 1), 1, "elevations_deg needs 1049600 pictures, the limit is 1048576"),
        (with(512, 512, 1), 5, "view_count needs 1310720 pictures, the limit is 1048576"),
        (with(1, 1, 1), (1 << 20) + 1, "plants needs 1048577 pictures, the limit is 1048576"),
        // each with a texel on two sides of it
        (with(256, 256, 32), 1, "resolution needs 71368704 texels, the limit is 67108864"),
        (with(128, 256, 32), 2, "resolution needs 71368704 texels, the limit is 67108864"),
    ] {
        assert_eq!(refused(&params, &vec![&plant; plant_count]), message, "{plant_count} plants");
    }
    // where views leave few pictures or texels, as many as there may be
    let view = parallel(DVec3::Z, DVec3::Y, 9.0, 16);
    let seen = Params { views: Some(vec![view]), ..with(256, 256, 32) };
    assert_eq!(build(&plant, &seen).pictures().len(), 1, "all but one are left out");
}

#[test]
fn bad_parameters_are_refused() {
    let plant = plant(&wall());
    let degrees = |values: &[f64]| values.iter().map(|d| d.to_radians()).collect::<Vec<f64>>();
    let free = Params { axis: Axis::Free, ..params() };
    let bad = [
        (Params { view_count: 0, ..params() }, "view_count"),
        (Params { view_count: 5000, ..params() }, "view_count"),
        (Params { elevations: vec![], ..params() }, "elevations_deg"),
        (Params { elevations: degrees(&[0.0, 30.0]), ..params() }, "elevations_deg"),
        (Params { elevations: degrees(&[10.0, 10.0]), ..free.clone() }, "elevations_deg"),
        (Params { elevations: degrees(&[91.0]), ..free.clone() }, "elevations_deg"),
        (Params { elevations: vec![f64::NAN], ..free }, "elevations_deg"),
        (Params { align: Align::Limited(f64::NAN), ..params() }, "max_turn_deg"),
        (Params { align: Align::Limited(4.0), ..params() }, "max_turn_deg"),
        (Params { resolution: (0, 8), ..params() }, "resolution"),
        (Params { resolution: (8, 20_000), ..params() }, "resolution"),
        (Params { resolution: (8192, 8192), ..params() }, "resolution"),
        (Params { view_count: 4096, resolution: (256, 256), ..params() }, "resolution"),
        (Params { sample_count: 3, ..params() }, "samples"),
        (Params { views: Some(vec![]), ..params() }, "views"),
        (Params { wood: Wood::Simplified(0), ..params() }, "wood_triangle_count"),
    ];
    for (params, name) in bad {
        let result = Billboard::build(&plant, &params, &Job::default());
        let message = result.expect_err(name).to_string();
        assert!(message.starts_with(name), "{name}: {message}");
    }
    let none = Billboard::forest(&[], &params(), &Job::default()).expect_err("no plant");
    assert!(none.to_string().starts_with("plants"), "{none}");
    let trunk = plant_at(DVec3::ZERO, &wall(), &[]);
    build(&trunk, &params());
    for (wood, wood_as) in [(Wood::None, WoodAs::Picture), (Wood::Full, WoodAs::Mesh)] {
        let nothing = Params { wood, wood_as, ..params() };
        let error = Billboard::build(&trunk, &nothing, &Job::default()).expect_err("nothing");
        assert!(error.to_string().starts_with("foliage"), "{error}");
    }
    let job = Job::default();
    job.cancel();
    let error = Billboard::build(&plant, &params(), &job).expect_err("stopped");
    assert_eq!(error, LodError::Cancelled, "at once");
}
