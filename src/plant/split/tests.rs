//! Wood and leaves told apart on tiny plants made by hand.

use std::f32::consts::TAU;

use glam::Vec4;

use super::*;
use crate::plant::Part;
use crate::texture::{Image, Wrap};

/// Triangles as a file has them: three vertices each, none shared.
#[derive(Default)]
struct Soup {
    corners: Vec<[Vec3; 3]>,
    uvs: Vec<[Vec2; 3]>,
    material_ids: Vec<u32>,
}

impl Soup {
    fn triangle(&mut self, material: u32, corners: [Vec3; 3]) {
        self.corners.push(corners);
        self.uvs.push(corners.map(Vec3::truncate));
        self.material_ids.push(material);
    }

    /// d c
    /// a b
    fn quad(&mut self, material: u32, [a, b, c, d]: [Vec3; 4]) {
        self.triangle(material, [a, b, c]);
        self.triangle(material, [a, c, d]);
    }

    /// A square card of side `size` in the plane of z.
    fn card(&mut self, material: u32, at: Vec3, size: f32) {
        let (x, y) = (Vec3::X * size, Vec3::Y * size);
        self.quad(material, [at, at + x, at + x + y, at + y]);
    }

    /// An upright tube with open ends: `sides` quads.
    fn tube(&mut self, material: u32, at: Vec3, radius: f32, height: f32, sides: u16) {
        let ring = |side: u16| {
            let angle = TAU * f32::from(side % sides) / f32::from(sides);
            at + Vec3::new(radius * angle.cos(), 0.0, -radius * angle.sin())
        };
        let up = Vec3::Y * height;
        for side in 0..sides {
            let (a, b) = (ring(side), ring(side + 1));
            self.quad(material, [a, b, b + up, a + up]);
        }
    }

    /// A closed double pyramid.
    fn octahedron(&mut self, material: u32, at: Vec3, radius: f32) {
        let (x, y, z) = (Vec3::X * radius, Vec3::Y * radius, Vec3::Z * radius);
        let ring = [x, -z, -x, z].map(|corner| at + corner);
        for side in 0..4 {
            let (a, b) = (ring[side], ring[(side + 1) % 4]);
            self.triangle(material, [a, b, at + y]);
            self.triangle(material, [b, a, at - y]);
        }
    }

    fn mesh(&self) -> Mesh {
        let positions: Vec<Vec3> = self.corners.iter().flatten().copied().collect();
        let count = positions.len();
        Mesh {
            normals: vec![Vec3::Y; count],
            uvs: self.uvs.iter().flatten().copied().collect(),
            base: vec![Vec4::ONE; count],
            front: vec![Vec3::ZERO; count],
            back: vec![Vec3::ZERO; count],
            triangles: (0..index(count / 3)).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
            parts: Mesh::parts_from_ids(&self.material_ids),
            positions,
        }
    }

    fn split(&self, materials: &[Material]) -> Split {
        split(&self.mesh(), materials, None, &Job::default()).expect("valid")
    }
}

fn plain(name: &str) -> Material {
    Material {
        name: name.to_owned(),
        texture: None,
        sampler: Sampler::default(),
        alpha_mode: AlphaMode::Opaque,
        double_sided: true,
    }
}

/// A masked texture of one row.
fn masked(alphas: &[u8], cutoff: f32) -> Material {
    let texels = alphas.iter().map(|&alpha| [255, 255, 255, alpha]).collect();
    let image = Image::new(index(alphas.len()), 1, texels).expect("valid");
    Material {
        texture: Some(Texture::new(vec![image]).expect("valid")),
        alpha_mode: AlphaMode::Mask { cutoff },
        sampler: Sampler { wrap: [Wrap::Repeat; 2], filter: Filter::Bilinear },
        ..plain("masked")
    }
}

fn reasons(split: &Split) -> Vec<(u32, Reason, u32, u32)> {
    let row = |t: &Tally| (t.material, t.reason, t.piece_count, t.triangle_count);
    split.tallies.iter().map(row).collect()
}

#[test]
fn a_tree_of_tubes_and_equal_leaves_in_one_material() {
    // a trunk, 30 twigs down to a fortieth of it, 200 leaves of two triangles
    let mut soup = Soup::default();
    soup.tube(0, Vec3::ZERO, 0.1, 4.0, 8);
    for twig in 0..30_u16 {
        let at = Vec3::new(f32::from(twig) * 0.1, 4.0, 1.0);
        soup.tube(0, at, 0.01, 0.1 + f32::from(twig) * 0.01, 3);
    }
    for leaf in 0..200_u16 {
        let (column, row) = (f32::from(leaf % 20), f32::from(leaf / 20));
        soup.card(0, Vec3::new(column * 0.2, 2.0 + row * 0.2, 2.0), 0.1);
    }
    let split = soup.split(&[plain("all")]);
    let expected = [(0, Reason::Sheet, 200, 400), (0, Reason::Limb, 31, 16 + 180)];
    assert_eq!(reasons(&split), expected, "tubes are wood, cards are leaves");
    assert_eq!(split.leaf_offsets.len(), 201, "one range a leaf");
    assert_eq!(split.leaves.positions.len(), 1200, "only the vertices that leaves use");
}

#[test]
fn leaves_are_contiguous_and_grouped_by_material() {
    // cards 0, 1, 2 of materials 1, 0, 1, their triangles interleaved
    let mut soup = Soup::default();
    let cards = [(1, 0.0), (0, 5.0), (1, 9.0)];
    let mut halves = Soup::default();
    for (material, x) in cards {
        halves.card(material, Vec3::X * x, 1.0);
    }
    for triangle in [0, 2, 4, 1, 3, 5] {
        soup.triangle(halves.material_ids[triangle], halves.corners[triangle]);
    }
    let split = soup.split(&[plain("a"), plain("b")]);
    assert_eq!(split.leaf_offsets, [0, 2, 4, 6], "three leaves of two triangles");
    let first_x: Vec<f32> = (0..6).map(|t| split.leaves.corners(t)[0].x).collect();
    assert_eq!(first_x, [5.0, 5.0, 0.0, 0.0, 9.0, 9.0], "material 0, then 1 by first triangle");
    let parts = [Part { material: 0, triangles: 0..2 }, Part { material: 1, triangles: 2..6 }];
    assert_eq!(split.leaves.parts, parts, "one part a material");
    assert!(split.wood.is_empty(), "no wood");
}

#[test]
fn touching_pieces_of_two_materials_stay_apart() {
    let mut soup = Soup::default();
    soup.card(0, Vec3::ZERO, 1.0);
    soup.card(1, Vec3::X, 1.0);
    soup.card(1, Vec3::X * 2.0, 1.0);
    let split = soup.split(&[plain("a"), plain("b")]);
    let expected = [(0, Reason::Sheet, 1, 2), (1, Reason::Sheet, 1, 4)];
    assert_eq!(reasons(&split), expected, "joined within material 1 only");
}

#[test]
fn texels_decide_not_the_alpha_mode() {
    //  alpha | 255 255 255 0 |   u = 0 to 1
    let mut soup = Soup::default();
    soup.tube(0, Vec3::ZERO, 0.1, 4.0, 8);
    soup.octahedron(1, Vec3::new(0.375, 2.0, 0.0), 0.3);
    soup.octahedron(1, Vec3::new(0.5, 3.0, 0.0), 0.45);
    soup.tube(1, Vec3::new(0.3, 4.0, 0.0), 0.2, 9.0, 8);
    let leaves = masked(&[255, 255, 255, 0], 0.5);
    let opaque = masked(&[255, 255, 255, 128], 0.5);
    let split = soup.split(&[opaque.clone(), leaves.clone()]);
    let expected = [(0, Reason::Limb, 1, 16), (1, Reason::Cutout, 1, 8), (1, Reason::Limb, 2, 24)];
    assert_eq!(reasons(&split), expected, "only the second octahedron reaches u > 0.75");
    let ignored = Material { alpha_mode: AlphaMode::Opaque, ..leaves };
    let expected = [(0, Reason::Limb, 1, 16), (1, Reason::Limb, 3, 32)];
    assert_eq!(reasons(&soup.split(&[opaque, ignored])), expected, "opaque ignores alpha");
}

#[test]
fn the_cutout_share_is_that_of_the_triangle() {
    // the left half of the texture is cut out; a triangle over u = 0..1 has 3/4 of its area there
    let material = masked(&[0, 255], 0.5);
    let mask = Mask::of(&material).expect("some alpha");
    let share = mask.cutout_share([Vec2::ZERO, Vec2::new(1.0, 0.0), Vec2::new(0.0, 1.0)]);
    assert_eq!(share, 0.75, "12 of the 16 centres");
    assert!(Mask::of(&masked(&[255, 255], 0.5)).is_none(), "nothing to cut out");
}

#[test]
fn two_faced_leaves_are_thin() {
    // material 0 has a limb; its leaves: one bent by 90 degrees with a twin behind every triangle,
    // and a flat box a twentieth as thick as wide
    let mut soup = Soup::default();
    soup.tube(0, Vec3::X * 9.0, 0.1, 9.0, 8);
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    let mut face = Soup::default();
    face.quad(0, [Vec3::ZERO, x, x + y, y]);
    face.quad(0, [y, x + y, x + y + z, y + z]);
    for [a, b, c] in face.corners {
        soup.triangle(0, [a, b, c]);
        soup.triangle(0, [a, c, b]);
    }
    soup.tube(0, Vec3::new(3.0, 0.0, 0.0), 1.0, 0.05, 4);
    let ring = [x, -z, -x, z].map(|corner| corner + x * 3.0);
    let [a, b, c, d] = ring;
    soup.quad(0, [a, d, c, b]);
    soup.quad(0, [a, b, c, d].map(|corner| corner + y * 0.05));
    let split = soup.split(&[plain("all")]);
    let expected = [(0, Reason::Thin, 2, 8 + 12), (0, Reason::Limb, 1, 16)];
    assert_eq!(reasons(&split), expected, "the tube alone is solid");
}

#[test]
fn slender_and_bent_tubes_stay_wood() {
    // three sides, 2000 radii long, open at both ends; the second half at a right angle
    let mut soup = Soup::default();
    soup.tube(0, Vec3::ZERO, 0.001, 1.0, 3);
    let mut bent = Soup::default();
    bent.tube(0, Vec3::ZERO, 0.001, 1.0, 3);
    for corners in bent.corners {
        soup.triangle(0, corners.map(|p| Vec3::new(1.0 - p.y, 1.0 - p.x, p.z)));
    }
    let split = soup.split(&[plain("all")]);
    assert!(split.leaves.is_empty(), "{:?}", split.tallies);
}

#[test]
fn small_solids_are_foliage_unless_their_material_has_a_limb() {
    let mut soup = Soup::default();
    soup.tube(0, Vec3::ZERO, 0.2, 10.0, 8);
    soup.octahedron(0, Vec3::X * 2.0, 0.1);
    soup.octahedron(1, Vec3::X * 4.0, 0.1);
    let split = soup.split(&[plain("bark"), plain("berry")]);
    let expected = [(0, Reason::Limb, 2, 24), (1, Reason::Small, 1, 8)];
    assert_eq!(reasons(&split), expected, "a bud in the bark's material stays wood");
}

#[test]
fn naming_overrides_the_rules() {
    // the trunk and one of two cards are named
    let mut soup = Soup::default();
    soup.tube(0, Vec3::ZERO, 0.1, 4.0, 4);
    soup.card(1, Vec3::X * 2.0, 1.0);
    soup.card(1, Vec3::X * 3.0, 1.0);
    let mut named = vec![true; 10];
    named.extend([false; 2]);
    let materials = [plain("bark"), plain("leaf")];
    let job = Job::default();
    let split = split(&soup.mesh(), &materials, Some(&named), &job).expect("valid");
    let expected = [(0, Reason::Named, 1, 8), (1, Reason::Named, 1, 2), (1, Reason::Unnamed, 1, 2)];
    assert_eq!(reasons(&split), expected, "the cards touch but differ in class");
    assert_eq!(split.leaf_offsets, [0, 8, 10], "the tube is one leaf");
    assert_eq!(split.wood.corners(0)[0], Vec3::X * 3.0, "the card that was not named");
}

#[test]
fn pieces_without_area_follow_their_material() {
    let flat = [Vec3::X * 5.0, Vec3::X * 6.0, Vec3::X * 7.0];
    let mut soup = Soup::default();
    soup.tube(0, Vec3::ZERO, 0.1, 4.0, 4);
    soup.triangle(0, flat);
    soup.card(1, Vec3::X * 2.0, 1.0);
    soup.triangle(1, flat);
    let split = soup.split(&[plain("bark"), plain("leaf")]);
    let expected = [(0, Reason::Limb, 2, 9), (1, Reason::Sheet, 1, 2), (1, Reason::Small, 1, 1)];
    assert_eq!(reasons(&split), expected, "bark with the bark, leaf with the leaves");
    let mut point = Soup::default();
    point.triangle(0, [Vec3::ONE; 3]);
    let expected = [(0, Reason::Small, 1, 1)];
    assert_eq!(reasons(&point.split(&[plain("all")])), expected, "a plant without extent");
}

#[test]
fn bad_input_is_named() {
    let mut soup = Soup::default();
    soup.card(0, Vec3::ZERO, 1.0);
    let job = Job::default();
    let materials = [plain("all")];
    let mut mesh = soup.mesh();
    let error = split(&mesh, &materials, Some(&[true]), &job).expect_err("1 value");
    assert_eq!(error.to_string(), "foliage_mask: 1 values for 2 triangles");
    assert!(split(&mesh, &[], None, &job).is_err(), "there is no material 0");
    mesh.uvs[3].y = f32::NAN;
    let error = split(&mesh, &materials, None, &job).expect_err("NaN");
    assert_eq!(error.to_string(), "uvs must be finite: element 3 is not");
    mesh.uvs[3].y = 0.0;
    job.cancel();
    let cancelled = split(&mesh, &materials, None, &job);
    assert_eq!(cancelled, Err(LodError::Cancelled), "the caller gave up");
}

#[test]
fn any_thread_count_gives_the_same() {
    let mut soup = Soup::default();
    for leaf in 0..5000_u16 {
        soup.card(0, Vec3::X * f32::from(leaf) * 1.01, 1.0);
    }
    let materials = [masked(&[255, 0, 255], 0.5)];
    let mesh = soup.mesh();
    let on = |threads| {
        crate::job::run(Some(threads), || split(&mesh, &materials, None, &Job::default()))
    };
    assert_eq!(on(1), on(3), "bytes do not depend on threads");
}
