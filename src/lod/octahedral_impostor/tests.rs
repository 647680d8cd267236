//! Impostors of tiny hand-made plants, and of every crown and camera that is awkward.

use glam::{DAffine3, DMat3, DVec3, Vec3, Vec4};

use super::ball::Ball;
use super::octahedron::Grid;
use super::viewer::Viewer;
use super::{Drawing, Mix, OctahedralImpostor, Params, Shading};
use crate::draw_list::Blend;
use crate::error::LodError;
use crate::job::{self, Job};
use crate::lod::full_mesh::FullMesh;
use crate::lod::made::{
    Leaf, cameras, crown_at, crowns, draw, emit, facing, from_azimuth, parallel, perspective,
    plant, plant_at, random_crown,
};
use crate::lod::wood::Wood;
use crate::lod::{ListBuilder, Representation};
use crate::plant::{Lighting, Plant};
use crate::raster::{Frame, Outputs, Renderer, Settings};
use crate::texture::atlas::Atlas;
use crate::texture::{Filter, Format};
use crate::view::{Projection, View};
use crate::view_state::ViewState;

fn params(side: usize, resolution: u32) -> Params {
    Params {
        grid: Grid::new(side, true).expect("in range"),
        resolution,
        sample_count: 4,
        mix: Mix::Three,
        drawing: Drawing::Test(0.5),
        step_count: 1,
        tolerance: None,
        depth_bit_count: 16,
        shading: Shading::Baked,
        format: Format::Rgba8,
        wood: Wood::Full,
        views: None,
    }
}

fn build(plant: &Plant, params: &Params) -> OctahedralImpostor {
    OctahedralImpostor::build(plant, params, &Job::default()).expect("valid")
}

fn full(plant: &Plant) -> FullMesh {
    FullMesh::build(plant, Wood::Full, Filter::Bilinear, &Job::default()).expect("leaves")
}

/// The picture of one copy where its file has put it.
fn picture(lod: &dyn Representation, view: &View, sample_count: u32) -> Frame {
    let list = emit(lod, view, &[crown_at(DAffine3::from_translation(lod.origin()), 0)]);
    let outputs = Outputs { albedo: true, normal: true, ..Outputs::COLOR_DEPTH };
    let settings =
        Settings { sample_count, outputs, background: Vec4::ZERO, counts_fragments: false };
    Renderer::default().render(&list, view, &settings, &Job::default()).expect("valid")
}

/// The view that a frame was baked from.
fn bakers_view(lod: &OctahedralImpostor, frame: usize, side: u32) -> View {
    let Ball { center, .. } = lod.ball;
    let ball = Ball { center: center + lod.origin, ..lod.ball };
    ball.rect(lod.grid.direction(frame)).view((side, side)).expect("valid")
}

fn mean_alpha(frame: &Frame) -> f64 {
    let sum: f64 = frame.color.iter().map(|pixel| f64::from(pixel.w)).sum();
    sum / frame.color.len() as f64
}

/// Mean column of a picture, by alpha, from its middle.
fn mean_column(frame: &Frame) -> f64 {
    let (mut sum, mut weight) = (0.0, 0.0);
    for (index, pixel) in frame.color.iter().enumerate() {
        let from_middle = (index % frame.width) as f64 + 0.5 - frame.width as f64 / 2.0;
        sum += from_middle * f64::from(pixel.w);
        weight += f64::from(pixel.w);
    }
    sum / weight
}

#[test]
fn from_a_frames_own_direction_it_shows_the_reference() {
    let crown = plant(&random_crown(60));
    let all = Params { drawing: Drawing::Blend, sample_count: 16, ..params(3, 32) };
    for hemisphere in [true, false] {
        let grid = Grid::new(3, hemisphere).expect("in range");
        let lod = build(&crown, &Params { grid, ..all.clone() });
        let relit = Params { grid, shading: Shading::Relit, ..all.clone() };
        let relit = build(&crown, &relit);
        let tested = build(&crown, &Params { grid, drawing: Drawing::Test(0.5), ..all.clone() });
        for frame in (0..9).filter(|&frame| lod.stand_ins[frame] == frame) {
            let view = bakers_view(&lod, frame, 32);
            assert_eq!(lod.mixed(&view), [(frame, 1.0)], "alone");
            let reference = picture(&full(&crown), &view, 16);
            assert!(mean_alpha(&reference) > 0.03, "frame {frame} shows something");
            // Straight colours lie within half a code of sRGB, which is at most 0.0045 in linear light,
            // alpha within half of 1/255; the rest is rounding where texels are read at their centres.
            let found = picture(&lod, &view, 1);
            let most = |a: &[Vec4], b: &[Vec4]| {
                let differences = a.iter().zip(b).map(|(a, b)| (*a - *b).abs().max_element());
                differences.fold(0.0, f32::max)
            };
            let difference = most(&found.color, &reference.color);
            assert!(difference < 0.0066, "frame {frame}: {difference}");
            let found = picture(&relit, &view, 1);
            assert!(most(&found.albedo, &reference.albedo) < 0.0066, "frame {frame}: albedo");
            let normals = found.normal.iter().zip(&reference.normal).zip(&reference.color);
            for ((a, b), color) in normals {
                // a mean normal is stored at unit length; on an edge it is of several leaves
                let b = b.normalize_or_zero() * color.w;
                assert!((*a - b).length() < 0.02, "frame {frame}: {a} for {b}");
            }
            let found = picture(&tested, &view, 1);
            let depths = found.depth.iter().zip(&reference.depth).zip(&found.color);
            let mut compared = 0;
            for ((a, b), _) in depths.filter(|(_, color)| color.w > 0.0) {
                // 16 bits over the ball, half a step of 3.5 m
                assert!((a - b).abs() < 1e-4, "frame {frame}: {a} for {b}");
                compared += 1;
            }
            assert!(compared > 50, "frame {frame}: {compared} depths");
        }
    }
}

/// A leaf to the left and wood to the right, both in the middle's plane, and a light of the plant's own.
fn leaf_and_wood(lighting: Lighting) -> Plant {
    let right = |leaf: Leaf| (leaf.0, leaf.1, leaf.2 + Vec3::Z * 0.4);
    let (leaf, wood) = (facing(-0.5, 0.0, 0.0, 0.4), facing(0.5, 0.0, 0.0, 0.4));
    let plant = plant_at(DVec3::ZERO, &[right(wood)], &[right(leaf)]);
    plant.relit(lighting, &Job::default()).expect("valid")
}

/// A low sun behind leaves that let much of it through.
fn evening() -> Lighting {
    Lighting {
        sun_direction: DVec3::new(0.3, 0.4, -1.0),
        sun: DVec3::new(0.9, 0.5, 0.2),
        translucency: 0.75,
        ..Lighting::default()
    }
}

#[test]
fn kept_normals_show_the_plant_under_any_light() {
    let with = Params { shading: Shading::Relit, ..params(3, 64) };
    let noon = build(&leaf_and_wood(Lighting::default()), &with);
    let late = noon.relit(&evening()).expect("a light");
    // from a frame's direction, a pixel for each texel
    let view = bakers_view(&noon, 2, 64);
    for (lod, light) in [(&noon, Lighting::default()), (&late, evening())] {
        let found = picture(lod, &view, 1);
        let wanted = picture(&full(&leaf_and_wood(light)), &view, 1);
        let mut compared = [0, 0];
        for (index, (a, b)) in found.color.iter().zip(&wanted.color).enumerate() {
            if a.w == 1.0 && b.w == 1.0 {
                // codes of sRGB, of normals and of shares
                assert!((*a - *b).abs().max_element() < 0.01, "{index}: {a} for {b}");
                compared[usize::from(index % 64 < 32)] += 1;
            }
        }
        assert!(compared.iter().all(|&count| count > 200), "wood and leaf: {compared:?}");
    }
    let again = build(&leaf_and_wood(evening()), &with);
    let color = |lod: &OctahedralImpostor| picture(lod, &view, 4).color;
    assert!(color(&late) == color(&again), "nothing has to be baked");
    assert!(color(&late) != color(&noon), "it is darker");
    let baked = build(&leaf_and_wood(Lighting::default()), &params(3, 8));
    let text = baked.relit(&evening()).expect_err("lit for good").to_string();
    assert!(text.starts_with("shading"), "{text}");
}

#[test]
fn light_that_frames_cannot_know_is_refused() {
    let with = Params { shading: Shading::Relit, ..params(3, 8) };
    let hidden = Lighting { occlusion: 0.5, ..evening() };
    let crown = leaf_and_wood(hidden);
    let error = OctahedralImpostor::build(&crown, &with, &Job::default()).expect_err("refused");
    assert!(error.to_string().starts_with("shading"), "{error}");
    build(&crown, &params(3, 8));
    let lod = build(&leaf_and_wood(evening()), &with);
    for (name, light) in [
        ("occlusion", hidden),
        ("sun_direction", Lighting { sun_direction: DVec3::ZERO, ..evening() }),
        ("translucency", Lighting { translucency: 1.5, ..evening() }),
    ] {
        let text = lod.relit(&light).expect_err("refused").to_string();
        assert!(text.starts_with(name), "{text}");
    }
}

#[test]
fn a_swap_of_the_one_frame_that_is_shown_is_a_jump_and_other_steps_are_none() {
    let crown = plant(&random_crown(20));
    // both sides of the middle between two frames of the horizon: 18.4 degrees, whose tangent is 1/3
    let views = [17.0, 18.0, 19.0].map(|angle| parallel(from_azimuth(angle), DVec3::Y, 3.0, 8));
    for (mix, jumps) in [(Mix::Nearest, true), (Mix::Three, false)] {
        let lod = build(&crown, &Params { mix, ..params(3, 8) });
        let home = [crown_at(DAffine3::IDENTITY, 0)];
        let [a, b, c] = views.each_ref().map(|view| emit(&lod, view, &home).signature());
        assert_eq!(a, b, "on the same side");
        assert_eq!(b != c, jumps, "{mix:?}");
    }
}

/// A square before the middle, and two specks that put the ball's middle at 0.
fn off_centre() -> Plant {
    let speck = |z: f32| (Vec3::Z * z, Vec3::X * 1e-3, Vec3::Y * 1e-3);
    plant(&[facing(0.0, 0.0, 0.5, 0.2), speck(1.0), speck(-1.0)])
}

#[test]
fn a_plane_before_the_middle_lands_where_it_should_between_frames() {
    // the frame towards +z alone, seen from 20 degrees beside it
    let crown = off_centre();
    let angle = 20.0_f64;
    let view = parallel(from_azimuth(angle), DVec3::Y, 2.0, 128);
    let pixels_per_metre = 64.0;
    // The square's middle at (0, 0, 0.5) lies 0.5 sin(20 degrees) to the left of the view's middle: to
    // the right is (cos, 0, -sin). Without parallax it is shown where the frame's plane is, at 0.
    let there = -0.5 * libm::sin(angle.to_radians()) * pixels_per_metre;
    for (step_count, wanted) in [(0, 0.0), (1, there), (2, there), (5, there)] {
        let with = Params { mix: Mix::Nearest, step_count, ..params(2, 128) };
        let lod = build(&crown, &with);
        assert_eq!(lod.mixed(&view), [(1, 1.0)], "+z");
        let frame = picture(&lod, &view, 4);
        let found = mean_column(&frame);
        // half a texel of 1/64 m, which is half a pixel
        assert!((found - wanted).abs() < 0.5, "{step_count} steps: {found} for {wanted}");
    }
    let reference = mean_column(&picture(&full(&crown), &view, 16));
    assert!((reference - there).abs() < 0.1, "so does the mesh: {reference} for {there}");
}

#[test]
fn an_impostor_hides_what_lies_behind_its_leaves_and_not_behind_its_middle() {
    // the impostor's square at z = 0.5; another plant's at z = 0.3 or 0.7, and the card's plane at 0
    let lod = build(&off_centre(), &params(3, 64));
    let view = perspective(DVec3::Z * 5.0, DVec3::ZERO, DVec3::Y);
    for (z, nearest) in [(0.3, 0.5), (0.7, 0.7)] {
        let other = full(&plant(&[facing(0.0, 0.0, z, 0.1)]));
        let mut builder = ListBuilder::default();
        let crown = [crown_at(DAffine3::IDENTITY, 0)];
        for lod in [&other as &dyn Representation, &lod] {
            lod.emit(&view, &crown, &mut ViewState::default(), &mut builder).expect("baked");
        }
        let list = builder.finish();
        let settings = Settings {
            sample_count: 1,
            outputs: Outputs::COLOR_DEPTH,
            background: Vec4::ZERO,
            counts_fragments: false,
        };
        let frame = Renderer::default().render(&list, &view, &settings, &Job::default());
        let depth = frame.expect("valid").depth[12 * 24 + 12];
        assert!((f64::from(depth) - (5.0 - nearest)).abs() < 1e-3, "{depth} with one at {z}");
    }
}

#[test]
fn the_same_bytes_on_any_number_of_threads() {
    let crown = plant(&random_crown(80));
    let with = Params { shading: Shading::Relit, ..params(4, 24) };
    let build_on = |threads: usize| {
        let job = Job::default();
        let build = || OctahedralImpostor::build(&crown, &with, &job);
        let lod = job::run(Some(threads), build).expect("valid");
        assert_eq!(job.progress(), (16, 16), "all frames were announced and made");
        lod
    };
    let (one, two) = (build_on(1), build_on(2));
    for (a, b) in one.textures().iter().zip(two.textures()) {
        assert_eq!(a.texture.levels(), b.texture.levels(), "{}", a.name);
    }
    assert_eq!(one.textures().len(), 3, "all layers");
}

#[test]
fn bytes_are_those_of_the_layers() {
    let crown = plant(&random_crown(10));
    // 3 x 3 frames of 16 texels with one around each: 52 x 52
    let texels = 52 * 52;
    let bytes = |with: Params| build(&crown, &with).footprint().texture_bytes;
    assert_eq!(bytes(params(3, 16)), texels * 6, "colour and 16 bits");
    assert_eq!(bytes(Params { depth_bit_count: 8, ..params(3, 16) }), texels * 5, "8 bits");
    let relit = Params { shading: Shading::Relit, ..params(3, 16) };
    assert_eq!(bytes(relit.clone()), texels * 10, "a normal and a share of leaves too");
    // two bytes for each colour
    let short = Params { format: Format::Rgb5a1, ..relit };
    assert_eq!(bytes(short), texels * 8, "the format is that of colours alone");
    let lod = build(&crown, &params(3, 16));
    assert_eq!((lod.footprint().card_count, lod.footprint().triangle_count), (1, 0), "one card");
}

#[test]
fn every_awkward_crown_and_camera_gives_a_picture() {
    for (name, leaves) in crowns() {
        let crown = plant(&leaves);
        for (side, hemisphere, drawing, step_count, mix) in [
            (2, true, Drawing::Test(0.5), 0, Mix::Three),
            (4, true, Drawing::Coverage, 2, Mix::Nearest),
            (3, false, Drawing::Blend, 1, Mix::Three),
            (5, false, Drawing::Test(0.3), 5, Mix::Three),
        ] {
            let grid = Grid::new(side, hemisphere).expect("in range");
            let with = Params { grid, drawing, step_count, mix, ..params(side, 8) };
            let lod = build(&crown, &with);
            let (low, high) = lod.bounds();
            let what = format!("{name}: {side}, {drawing:?}");
            assert!(low.is_finite() && high.is_finite(), "{what}: {low} to {high}");
            for (camera, view) in cameras() {
                let frame = draw(&lod, &view);
                let fine = |pixel: &Vec4| {
                    pixel.is_finite() && pixel.min_element() >= 0.0 && pixel.w <= 1.0 + 1e-6
                };
                assert!(frame.color.iter().all(fine), "{what}, {camera}");
                let depths = frame.depth.iter().all(|&d| d > 0.0);
                assert!(depths, "{what}, {camera}: no NaN, nothing behind");
            }
        }
    }
}

#[test]
fn what_has_area_is_seen_from_its_axis() {
    let view = parallel(DVec3::Z, DVec3::Y, 6.0, 48);
    for (name, leaves) in crowns() {
        let lod = build(&plant(&leaves), &Params { drawing: Drawing::Blend, ..params(3, 32) });
        let (baked, wanted) =
            (mean_alpha(&draw(&lod, &view)), mean_alpha(&draw(&full(&plant(&leaves)), &view)));
        // the outline is smeared by half a texel, which is a 32nd of the ball, on both sides
        assert!((baked - wanted).abs() <= 0.012, "{name}: {baked} for {wanted}");
        if ["no area", "a point", "needles"].contains(&name) {
            assert_eq!(baked, 0.0, "{name}: nothing to see");
        }
    }
}

#[test]
fn an_eye_inside_or_near_sees_the_leaves_before_it() {
    // a wall of leaves at z = -1 and one at z = 1, seen from between and from just outside
    let crown = plant(&[facing(0.0, 0.0, -1.0, 1.0), facing(0.0, 0.0, 1.0, 1.0)]);
    let lod = build(&crown, &params(3, 32));
    let (_, radius) = lod.ball();
    assert!((radius - 3.0_f64.sqrt()).abs() < 1e-6, "to a corner: {radius}");
    for (eye, depth) in [(DVec3::Z * 0.5, 1.5), (DVec3::Z * 1.5, 0.5), (DVec3::Z * 1.8, 0.8)] {
        let frame = draw(&lod, &perspective(eye, DVec3::NEG_Z, DVec3::Y));
        let found = f64::from(frame.depth[12 * 24 + 12]);
        if eye.z > 1.0 {
            assert!((found - depth).abs() < 1e-3, "from {eye}: {found} for {depth}");
        } else {
            // the frame towards +z knows only the nearer wall, which is behind the eye
            assert!(found.is_infinite(), "from {eye}: {found}");
        }
    }
}

/// Mean difference of alpha.
fn difference(a: &Frame, b: std::slice::Iter<'_, Vec4>) -> f64 {
    let sum: f64 = a.color.iter().zip(b).map(|(a, b)| f64::from((a.w - b.w).abs())).sum();
    sum / a.color.len() as f64
}

#[test]
fn turned_mirrored_and_stretched_copies_show_what_they_should() {
    let crown = plant(&[
        facing(0.8, 0.6, 0.3, 0.4),
        facing(-0.9, 0.1, -0.4, 0.3),
        (Vec3::new(0.2, -0.8, 0.6), Vec3::Z * 0.4, Vec3::new(0.3, 0.3, 0.0)),
    ]);
    let lod = build(&crown, &Params { drawing: Drawing::Blend, ..params(9, 64) });
    let (eye, up) = (DVec3::new(0.5, 1.0, 4.0), DVec3::Y);
    let copy = |lod: &dyn Representation, matrix3: DMat3, view: &View| {
        let translation = DVec3::new(0.4, 0.0, -0.3);
        let list = emit(lod, view, &[crown_at(DAffine3 { matrix3, translation }, 0)]);
        let settings = Settings {
            sample_count: 4,
            outputs: Outputs::COLOR,
            background: Vec4::ZERO,
            counts_fragments: false,
        };
        Renderer::default().render(&list, view, &settings, &Job::default()).expect("valid")
    };
    let as_it_is = copy(&lod, DMat3::IDENTITY, &perspective(eye, DVec3::ZERO, up));
    let turn = DMat3::from_euler(glam::EulerRot::YXZ, 0.7, 0.3, -0.2);
    let mirror = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
    // a copy that is moved with its camera looks the same, or like its mirror image
    for (matrix3, is_mirrored) in
        [(turn, false), (mirror, true), (turn * mirror, true), (turn * 1.5, false)]
    {
        let translation = DVec3::new(0.4, 0.0, -0.3);
        let moved = |p: DVec3| matrix3 * (p - translation) + translation;
        let view = perspective(moved(eye), moved(DVec3::ZERO), matrix3 * up);
        let found = copy(&lod, matrix3, &view);
        let mirrored: Vec<Vec4> =
            as_it_is.color.chunks(24).flat_map(|row| row.iter().rev()).copied().collect();
        let straight = difference(&found, as_it_is.color.iter());
        let turned_round = difference(&found, mirrored.iter());
        let (right, wrong) =
            if is_mirrored { (turned_round, straight) } else { (straight, turned_round) };
        // rounding moves a sample across an edge here and there
        assert!(right < 1e-3, "{matrix3}: {right}");
        assert!(wrong > 0.03, "{matrix3}: the other way round {wrong}");
    }
    // a stretched one shows about what the mesh shows
    let stretched = turn * DMat3::from_diagonal(DVec3::new(1.5, 0.8, 1.1));
    let view = perspective(eye, DVec3::ZERO, up);
    let (found, wanted) = (copy(&lod, stretched, &view), copy(&full(&crown), stretched, &view));
    let right = difference(&found, wanted.color.iter());
    let wrong = difference(&found, copy(&full(&crown), turn, &view).color.iter());
    assert!(right < 0.5 * wrong, "{right} for the stretched mesh, {wrong} for one that is not");
}

#[test]
fn size_and_place_do_not_change_the_picture() {
    let crown: Vec<Leaf> = random_crown(60);
    let lod = build(&plant(&crown), &params(5, 16));
    let view = |scale: f64, origin: DVec3| {
        let eye = DVec3::new(1.5, 0.5, 3.25);
        perspective(origin + eye * scale, origin, DVec3::Y)
    };
    let wanted = draw(&lod, &view(1.0, DVec3::ZERO));
    assert!(wanted.color.iter().any(|pixel| pixel.w > 0.5), "it is in the picture");
    // powers of two, with which every rounding stays the same: 0.1 mm, 8 km, and 1e6 m away
    for exponent in [-13, 13] {
        let scale = 2.0_f32.powi(exponent);
        let scaled: Vec<Leaf> =
            crown.iter().map(|&(a, b, c)| (a * scale, b * scale, c * scale)).collect();
        let lod = build(&plant(&scaled), &params(5, 16));
        let frame = draw(&lod, &view(f64::from(scale), DVec3::ZERO));
        assert_eq!(frame.color, wanted.color, "2^{exponent} times as large");
    }
    let origin = DVec3::new(1_048_576.0, -524_288.0, 2_097_152.0);
    let far = build(&plant_at(origin, &[], &crown), &params(5, 16));
    assert_eq!(draw(&far, &view(1.0, origin)).color, wanted.color, "far from the world's origin");
    assert_eq!(far.origin(), origin, "where it stands");
}

#[test]
fn views_leave_out_what_they_do_not_see() {
    let crown = plant(&random_crown(30));
    let (near, other) = (
        perspective(DVec3::new(0.3, 0.2, 40.0), DVec3::ZERO, DVec3::Y),
        perspective(DVec3::new(-9.0, 8.0, -9.0), DVec3::ZERO, DVec3::Y),
    );
    let with = Params { views: Some(vec![near.clone()]), ..params(8, 64) };
    let lod = build(&crown, &with);
    let mixed = lod.mixed(&near);
    let baked: Vec<usize> = (0..64).filter(|&frame| lod.baked()[frame]).collect();
    let mut seen: Vec<usize> = mixed.iter().map(|&(frame, _)| frame).collect();
    seen.sort_unstable();
    assert_eq!(baked, seen, "only what the camera sees");
    // 24 pixels are 40 tan(0.5) * 2 = 43.7 m: the ball of 2 m has fewer than 4
    let texels = lod.textures()[0].texture.size();
    assert!(texels.0 < 24 && texels.1 < 24, "no finer than its pixels: {texels:?}");
    assert_eq!(draw(&lod, &near).color.len(), 576, "drawn");
    let crowns = [crown_at(DAffine3::IDENTITY, 0)];
    let mut builder = ListBuilder::default();
    let error = lod.emit(&other, &crowns, &mut ViewState::default(), &mut builder);
    let text = error.expect_err("not baked").to_string();
    assert!(text.starts_with("camera") && text.contains("frame"), "{text}");
}

#[test]
fn wood_is_in_the_pictures() {
    let (trunk, leaf) = (facing(0.0, -1.0, 0.0, 0.3), facing(0.0, 1.0, 0.0, 0.3));
    let view = parallel(DVec3::Z, DVec3::Y, 4.0, 32);
    let alpha = |plant: &Plant, wood: Wood| {
        mean_alpha(&draw(&build(plant, &Params { wood, ..params(3, 64) }), &view))
    };
    let both = plant_at(DVec3::ZERO, &[trunk], &[leaf]);
    // each square of 0.6 m in 4 m: 0.0225 of the picture
    assert!((alpha(&both, Wood::Full) - 0.045).abs() < 0.004, "both");
    assert!((alpha(&both, Wood::None) - 0.0225).abs() < 0.002, "leaf alone");
    let bare = plant_at(DVec3::ZERO, &[trunk], &[]);
    assert!((alpha(&bare, Wood::Full) - 0.0225).abs() < 0.002, "trunk alone");
    let with = Params { wood: Wood::None, ..params(3, 8) };
    let error = OctahedralImpostor::build(&bare, &with, &Job::default()).expect_err("nothing");
    assert!(error.to_string().starts_with("foliage is empty"), "{error}");
}

#[test]
fn blended_copies_are_painted_far_to_near() {
    let lod = build(&plant(&random_crown(10)), &Params { drawing: Drawing::Blend, ..params(3, 8) });
    let view = perspective(DVec3::Z * 9.0, DVec3::ZERO, DVec3::Y);
    let at = |z: f64, rank: u32| crown_at(DAffine3::from_translation(DVec3::Z * z), rank);
    let list = emit(&lod, &view, &[at(-3.0, 0), at(1.0, 1)]);
    let depths: Vec<f32> = list
        .items
        .iter()
        .map(|item| list.instances[item.instances.start as usize].translation.z)
        .collect();
    assert_eq!(depths, [-12.0, -8.0], "the farther one first");
    assert!(list.items.iter().all(|item| item.blend == Blend::Over && !item.depth_write), "blend");
}

#[test]
fn the_plant_lies_behind_the_card() {
    let crown = plant(&random_crown(40));
    let lod = build(&crown, &params(3, 8));
    let (center, radius) = lod.ball();
    for toward in [DVec3::new(0.3, 0.4, -0.8), DVec3::Y, DVec3::NEG_Y, DVec3::X] {
        for distance in [1.0, 1.5, 3.0, 100.0] {
            let eye = center + toward.normalize() * (distance * radius);
            let up = if toward.x == 0.0 && toward.z == 0.0 { DVec3::X } else { DVec3::Y };
            for view in [perspective(eye, center, up), parallel(toward.normalize(), up, 3.0, 8)] {
                let near = !view.is_orthographic() && distance < 1.9;
                let home = crown_at(DAffine3::IDENTITY, 0);
                let viewer = Viewer::new(&view, &home, &lod.ball);
                let [a, b, _, d] = viewer.card(&view, &home, &lod.ball);
                let (across, along) = (b - a, d - a);
                let normal = across.cross(along).normalize();
                let mut outside = 0;
                for vertex in &crown.foliage.mesh.positions {
                    let vertex = vertex.as_dvec3();
                    let ray = if view.is_orthographic() { -view.back } else { vertex - view.eye };
                    let met = vertex + ray * ((a - vertex).dot(normal) / ray.dot(normal)) - a;
                    let (x, y) = (
                        met.dot(across) / across.length_squared(),
                        met.dot(along) / along.length_squared(),
                    );
                    outside += usize::from(!(0.0..=1.0).contains(&x) || !(0.0..=1.0).contains(&y));
                }
                // a card across the whole picture hides only what the picture shows
                assert!(outside == 0 || near, "{toward} from {distance}: {outside} outside");
                let size = across.length().max(along.length());
                assert!(near || size < 4.0 * radius, "no larger than it must be: {size}");
            }
        }
    }
}

#[test]
fn bad_parameters_are_refused_by_name() {
    let crown = plant(&random_crown(10));
    let refused = |with: Params| {
        OctahedralImpostor::build(&crown, &with, &Job::default()).expect_err("refused").to_string()
    };
    let good = || params(3, 8);
    let grid = Grid::new(64, true).expect("in range");
    let cases = [
        ("resolution", Params { resolution: 0, ..good() }),
        ("resolution", Params { resolution: 1_000_000, ..good() }),
        ("resolution", Params { resolution: 8192, ..good() }),
        ("resolution", Params { grid, resolution: 256, ..good() }),
        ("samples", Params { sample_count: 2, ..good() }),
        ("parallax_steps", Params { step_count: 65, ..good() }),
        ("depth_bits", Params { depth_bit_count: 12, ..good() }),
        ("depth_tolerance", Params { tolerance: Some(0.0), ..good() }),
        ("depth_tolerance", Params { tolerance: Some(f64::NAN), ..good() }),
        ("cutoff", Params { drawing: Drawing::Test(0.0), ..good() }),
        ("cutoff", Params { drawing: Drawing::Test(f32::NAN), ..good() }),
        ("views", Params { views: Some(vec![]), ..good() }),
        ("wood_triangle_count", Params { wood: Wood::Simplified(0), ..good() }),
    ];
    for (name, with) in cases {
        let message = refused(with);
        assert!(message.starts_with(name), "{name}: {message}");
    }
    let job = Job::default();
    job.cancel();
    let stopped = OctahedralImpostor::build(&crown, &good(), &job).expect_err("cancelled");
    assert_eq!(stopped, LodError::Cancelled, "stopped");
}

#[test]
fn the_foot_is_that_of_the_mesh() {
    // far from square and off the origin, with texels of half a metre
    let leaves = [facing(2.0, 6.0, 1.0, 0.5), facing(4.0, 9.0, -2.0, 1.5)];
    let trunk = [facing(3.0, 1.0, 0.0, 1.0)];
    for wood in [&[][..], &trunk] {
        let crown = plant_at(DVec3::new(5.0, -7.0, 3.0), wood, &leaves);
        let lod = build(&crown, &params(3, 16));
        assert_eq!(lod.foot(), full(&crown).foot(), "of wood and leaves");
        assert!(lod.bounds().0.y < lod.foot().y - 0.1, "its box is a texel larger");
    }
    // where wood is left out, what is left is what stays in the wind
    let bare = Params { wood: Wood::None, ..params(3, 16) };
    let lod = build(&plant_at(DVec3::ZERO, &trunk, &leaves), &bare);
    assert_eq!(lod.foot(), full(&plant(&leaves)).foot(), "of leaves alone");
}

#[test]
fn straight_below_the_upper_half_the_pictures_up_decides() {
    let lod = build(&plant(&random_crown(10)), &params(3, 8));
    for (up, frame) in [(DVec3::X, 8), (DVec3::Z, 2), (DVec3::NEG_X, 0)] {
        let projection = Projection::Perspective { fov_y: 1.0 };
        let view = View::new(DVec3::NEG_Y * 9.0, DVec3::ZERO, up, projection, (8, 8), 0.01);
        assert_eq!(lod.mixed(&view.expect("valid")), [(frame, 1.0)], "up is {up}");
    }
}

#[test]
fn as_many_texels_are_taken_as_fit_into_one_texture() {
    let crown = plant(&random_crown(10));
    let refused = |with: Params| {
        OctahedralImpostor::build(&crown, &with, &Job::default()).expect_err("refused")
    };
    // what the page states; 2^26 texels are 8192 x 8192, with borders of 1 to 64 texels
    for (side, hemisphere, most) in [
        (2, true, 3968),
        (8, true, 960),
        (64, true, 120),
        (3, false, 3200),
        (8, false, 1088),
        (64, false, 124),
    ] {
        let grid = Grid::new(side, hemisphere).expect("in range");
        let stand_ins = grid.stand_ins();
        let count = (0..stand_ins.len()).filter(|&frame| stand_ins[frame] == frame).count();
        let fits = Atlas::new("resolution", &vec![(most, most); count]);
        assert!(fits.is_ok(), "{side} {hemisphere}: {most} fit");
        let error = refused(Params { grid, resolution: most + 1, ..params(3, 8) });
        let is_limit = matches!(error, LodError::Limit { name: "resolution", .. });
        assert!(is_limit, "{side} {hemisphere}: {error}");
    }
    // cameras that need few texels may be asked for with any number that one frame could have
    let far = perspective(DVec3::Z * 400.0, DVec3::ZERO, DVec3::Y);
    let seen = |resolution: u32| Params { views: Some(vec![far.clone()]), ..params(3, resolution) };
    let texels = build(&crown, &seen(8192)).textures()[0].texture.levels()[0].texels.len();
    assert!(texels < 64, "as many as the camera has pixels: {texels}");
    let error = refused(seen(8193));
    assert!(matches!(error, LodError::Limit { name: "resolution", .. }), "{error}");
}
