//! Tiny hand-made crowns and awkward cameras, for the tests of every technique.

use glam::{DAffine3, DVec3, Vec2, Vec3, Vec4};

use crate::draw_list::DrawList;
use crate::job::Job;
use crate::lod::{Crown, ListBuilder, Representation};
use crate::plant::{AlphaMode, Lighting, Material, Mesh, Plant};
use crate::raster::{Frame, Outputs, Renderer, Settings};
use crate::texture::Sampler;
use crate::view::{Projection, View};
use crate::view_state::ViewState;

/// A rectangle: its middle and the vectors from there to two of its sides.
pub(crate) type Leaf = (Vec3, Vec3, Vec3);

pub(crate) fn quads(leaves: &[Leaf]) -> Mesh {
    let mut mesh = Mesh::default();
    for (&(center, across, along), first) in leaves.iter().zip((0..).step_by(4)) {
        for (x, y) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
            mesh.positions.push(center + across * x + along * y);
            mesh.normals.push(across.cross(along).normalize_or_zero());
            mesh.uvs.push(Vec2::ZERO);
            mesh.base.push(Vec4::ONE);
        }
        mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    mesh.parts = Mesh::parts_from_ids(&vec![0; mesh.triangles.len()]);
    mesh
}

pub(crate) fn plant_at(origin: DVec3, wood: &[Leaf], leaves: &[Leaf]) -> Plant {
    let material = Material {
        name: "white".to_owned(),
        texture: None,
        sampler: Sampler::default(),
        alpha_mode: AlphaMode::Opaque,
        double_sided: true,
    };
    let offsets = (0..=u32::try_from(leaves.len()).expect("few")).map(|leaf| leaf * 2).collect();
    let name = "test".to_owned();
    let lighting = Lighting::default();
    let (wood, leaves) = (quads(wood), quads(leaves));
    Plant::new(name, origin, vec![material], wood, leaves, offsets, lighting, &Job::default())
        .expect("valid")
}

pub(crate) fn plant(leaves: &[Leaf]) -> Plant {
    plant_at(DVec3::ZERO, &[], leaves)
}

/// A square of side `2 half` that faces +z.
pub(crate) fn facing(x: f32, y: f32, z: f32, half: f32) -> Leaf {
    (Vec3::new(x, y, z), Vec3::X * half, Vec3::Y * half)
}

/// Leaves of all orientations in a cube, the same on every machine; its centre is at 0.
pub(crate) fn random_crown(count: usize) -> Vec<Leaf> {
    let mut state = 20_240_611_u64;
    let mut number = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963);
        (state >> 40) as f32 / 8_388_608.0 - 1.0
    };
    let mut vector = move || Vec3::new(number(), number(), number());
    // the two outermost, whose middle is the centre
    let corners = [-1.1, 1.1].map(|at| (Vec3::splat(at), Vec3::X * 0.1, Vec3::new(0.0, 0.1, 0.1)));
    let inner = (2..count).map(|_| {
        let (center, across) = (vector(), vector());
        let along = across.cross(vector()).normalize_or_zero() * 0.15;
        (center, across.normalize_or_zero() * 0.1, along)
    });
    inner.chain(corners).collect()
}

pub(crate) fn parallel(toward: DVec3, up: DVec3, height: f64, side: u32) -> View {
    let projection = Projection::Orthographic { height };
    View::new(toward * (8.0 * height), DVec3::ZERO, up, projection, (side, side), height * 1e-3)
        .expect("valid")
}

pub(crate) fn from_azimuth(degrees: f64) -> DVec3 {
    let angle = degrees.to_radians();
    DVec3::new(libm::sin(angle), 0.0, libm::cos(angle))
}

pub(crate) fn perspective(eye: DVec3, target: DVec3, up: DVec3) -> View {
    let near = eye.distance(target) * 1e-3;
    View::new(eye, target, up, Projection::Perspective { fov_y: 1.0 }, (24, 24), near)
        .expect("valid")
}

pub(crate) fn crown_at(world_from_local: DAffine3, rank: u32) -> Crown {
    Crown { distance: 1.0, rank, key: (0, rank), ..Crown::alone(world_from_local) }
}

pub(crate) fn emit(lod: &dyn Representation, view: &View, crowns: &[Crown]) -> DrawList {
    let mut builder = ListBuilder::default();
    lod.emit(view, crowns, &mut ViewState::default(), &mut builder).expect("baked");
    let list = builder.finish();
    list.check().expect("consistent");
    list
}

pub(crate) fn draw(lod: &dyn Representation, view: &View) -> Frame {
    let list = emit(lod, view, &[crown_at(DAffine3::from_translation(lod.origin()), 0)]);
    let settings = Settings {
        sample_count: 4,
        outputs: Outputs::COLOR_DEPTH,
        background: Vec4::ZERO,
        counts_fragments: false,
    };
    let frame = Renderer::default().render(&list, view, &settings, &Job::default());
    frame.expect("valid")
}

/// Awkward crowns, by name.
pub(crate) fn crowns() -> Vec<(&'static str, Vec<Leaf>)> {
    let line = |i: f32| (Vec3::Y * i, Vec3::X * 0.1, Vec3::Y * 0.3);
    let nothing = (Vec3::ONE, Vec3::ZERO, Vec3::ZERO);
    vec![
        ("one leaf", vec![facing(0.3, 0.1, 0.2, 0.5)]),
        ("two equal leaves", vec![facing(0.3, 0.1, 0.2, 0.5); 2]),
        ("no area", vec![nothing, (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO)]),
        ("a point", vec![nothing]),
        ("needles", vec![(Vec3::ZERO, Vec3::X, Vec3::ZERO), (Vec3::X, Vec3::Z, Vec3::ZERO)]),
        ("coplanar", (-2_i8..3).map(|i| facing(f32::from(i), 0.0, 0.0, 0.4)).collect()),
        ("level", (-2_i8..3).map(|i| (Vec3::X * f32::from(i), Vec3::X, Vec3::Z)).collect()),
        ("on a line", (-2_i8..3).map(|i| line(f32::from(i))).collect()),
        ("between slices", [-1.0, 0.0, 1.0].map(|z| facing(z, 0.0, z, 0.3)).to_vec()),
        ("random", random_crown(40)),
    ]
}

/// Awkward cameras for a crown of about a metre, by name.
pub(crate) fn cameras() -> Vec<(&'static str, View)> {
    let from = |toward: DVec3, up: DVec3| perspective(toward * 4.0, DVec3::ZERO, up);
    let mut views = vec![
        ("on an orientation", from(DVec3::Z, DVec3::Y)),
        ("between two", from(from_azimuth(30.0), DVec3::Y)),
        ("opposite", from(DVec3::NEG_Z, DVec3::Y)),
        ("straight down", from(DVec3::Y, DVec3::NEG_Z)),
        ("straight up", from(DVec3::NEG_Y, DVec3::X)),
        ("inside", perspective(DVec3::new(0.1, 0.05, -0.2), DVec3::X * 3.0, DVec3::Y)),
        ("at the centre", perspective(DVec3::ZERO, DVec3::new(1.0, 0.3, 1.0), DVec3::Y)),
        ("on a slice's plane", perspective(DVec3::X * 3.0, DVec3::ZERO, DVec3::Y)),
        ("above, looking ahead", perspective(DVec3::Y * 0.7, DVec3::new(0.0, 0.7, 1.0), DVec3::Y)),
        ("far away", from(DVec3::new(1e17, 1e16, 1e17), DVec3::Y)),
    ];
    for (name, toward) in [("parallel", DVec3::Z), ("parallel, down", DVec3::Y)] {
        views.push((name, parallel(toward, DVec3::new(0.6, 0.4, -0.7), 3.0, 24)));
    }
    views
}
