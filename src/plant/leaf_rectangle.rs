//! The smallest rectangle around each leaf, in the leaf's own plane.
//!
//! The plane goes through the leaf's centre, across its normal, and its vertices are projected onto
//! it. A leaf without a normal has no area, yet may have an extent: its plane is then spanned by
//! the direction to the vertex farthest from the first, and by that to the one farthest from that
//! line. All in f64 and relative to the leaf's centre, so a leaf far out keeps its detail; the same
//! bytes on any number of threads.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::error::LodError;
use crate::job::Job;
use crate::plant::Foliage;
use crate::plant::rectangle::min_area_rectangle;

/// Sine of an angle to the vertical, squared, below which a leaf counts as level.
const LEVEL_SQ: f64 = 1e-12;

/// Share of its length by which a leaf without area must spread to be no line: f32 coordinates of
/// points on a line miss it by up to 1e-7.
const LINE_REL: f64 = 1e-6;

/// A rectangle in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle3 {
    /// Where its diagonals meet, relative to the plant's origin, in metres.
    pub center: DVec3,
    /// Unit vector along the longer side.
    pub along: DVec3,
    /// Unit vector along the shorter side; `along` x `across` is the leaf's normal.
    pub across: DVec3,
    /// Half the longer side and half the shorter one, in metres.
    pub half: DVec2,
}

impl Rectangle3 {
    /// The corners, counter-clockwise as seen by whom the normal points to.
    pub fn corners(&self) -> [DVec3; 4] {
        let (along, across) = (self.along * self.half.x, self.across * self.half.y);
        [-along - across, along - across, along + across, across - along].map(|o| self.center + o)
    }
}

/// The smallest rectangle around a leaf.
///
/// Ties and the direction of `along` are as in
/// [`min_area_rectangle`], with x level and y up as seen by whom the normal points to; for a level
/// leaf x is x, and y is -z seen from above.
pub fn leaf_rectangle(foliage: &Foliage, leaf: usize) -> Rectangle3 {
    let center = foliage.centers[leaf].as_dvec3();
    let vertices: Vec<DVec3> = foliage
        .triangles_of(leaf)
        .flat_map(|triangle| foliage.mesh.corners(triangle))
        .map(|position| position.as_dvec3() - center)
        .collect();
    let normal = foliage.normals[leaf].as_dvec3();
    let [x, y] = match normal.try_normalize() {
        Some(normal) => upright_axes(normal),
        None => spanned_axes(&vertices),
    };
    let points: Vec<DVec2> = vertices.iter().map(|p| DVec2::new(x.dot(*p), y.dot(*p))).collect();
    let flat = min_area_rectangle(&points).expect("a leaf has at least one triangle");
    let placed = |v: DVec2| x * v.x + y * v.y;
    Rectangle3 {
        center: center + placed(flat.center),
        along: placed(flat.axis),
        across: placed(flat.across()),
        half: flat.half,
    }
}

/// The smallest rectangles around all leaves, in their order.
///
/// # Errors
/// [`LodError::Cancelled`].
pub fn leaf_rectangles(foliage: &Foliage, job: &Job) -> Result<Vec<Rectangle3>, LodError> {
    (0..foliage.leaf_count())
        .into_par_iter()
        .map(|leaf| {
            job.check()?;
            Ok(leaf_rectangle(foliage, leaf))
        })
        .collect()
}

/// Right and up in the plane across a unit normal, for whom it points to.
fn upright_axes(normal: DVec3) -> [DVec3; 2] {
    let level = DVec3::Y.cross(normal);
    let right = if level.length_squared() > LEVEL_SQ {
        level.normalize()
    } else {
        DVec3::X.reject_from_normalized(normal).normalize()
    };
    [right, normal.cross(right)]
}

/// Two axes of the plane that the vertices of a leaf without area spread in.
fn spanned_axes(vertices: &[DVec3]) -> [DVec3; 2] {
    let farthest = |offset: &dyn Fn(DVec3) -> DVec3| {
        vertices.iter().map(|&p| offset(p)).fold(DVec3::ZERO, |far, next| {
            if next.length_squared() > far.length_squared() { next } else { far }
        })
    };
    let first = vertices[0];
    let reach = farthest(&|p| p - first);
    let Some(right) = reach.try_normalize() else { return [DVec3::X, DVec3::Y] };
    let aside = farthest(&|p| (p - first).reject_from_normalized(right));
    if aside.length() > LINE_REL * reach.length() {
        // once more, since a small rejection of a large vector is not quite across
        return [right, aside.normalize().reject_from_normalized(right).normalize()];
    }
    // a line: any plane through it
    [right, upright_axes(right)[1]]
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, Vec2, Vec3, Vec4};

    use super::*;
    use crate::plant::Mesh;

    /// Of a leaf's size: positions, centres and normals are f32.
    const F32: f64 = 3e-7;

    fn foliage(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>, offsets: &[u32]) -> Foliage {
        let count = positions.len();
        let mesh = Mesh {
            positions,
            normals: vec![Vec3::Y; count],
            uvs: vec![Vec2::ZERO; count],
            base: vec![Vec4::ONE; count],
            front: vec![Vec3::ZERO; count],
            back: vec![Vec3::ZERO; count],
            parts: Mesh::parts_from_ids(&vec![0; triangles.len()]),
            triangles,
        };
        Foliage::new(mesh, offsets.to_vec(), &Job::default()).expect("valid")
    }

    #[test]
    fn corners_run_counter_clockwise_in_front() {
        //  3-------2      2 high and 4 wide, in the plane z = 5
        //  | \     |
        //  0-------1
        let positions = [[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]];
        let positions = positions.map(|[x, y]: [f32; 2]| Vec3::new(x, y, 5.0)).to_vec();
        let front = foliage(positions.clone(), vec![[0, 1, 3], [1, 2, 3]], &[0, 2]);
        let corners = leaf_rectangle(&front, 0).corners();
        let expected = [0, 1, 2, 3].map(|corner: usize| positions[corner].as_dvec3());
        assert_eq!(corners, expected, "as the leaf's own, which faces +z");
        let back = foliage(positions, vec![[0, 3, 1], [1, 3, 2]], &[0, 2]);
        let corners = leaf_rectangle(&back, 0).corners();
        assert_eq!(corners, [1, 0, 3, 2].map(|corner: usize| expected[corner]), "seen from -z");
    }

    #[test]
    fn a_level_leaf_has_x_and_minus_z_for_axes() {
        let far = Vec3::new(4.0, 0.0, -2.0);
        let positions = vec![Vec3::ZERO, Vec3::X * 4.0, far, Vec3::NEG_Z * 2.0];
        let triangles = vec![[0, 1, 2], [0, 2, 3]];
        let above = leaf_rectangle(&foliage(positions.clone(), triangles, &[0, 2]), 0);
        assert_eq!((above.along, above.across), (DVec3::X, DVec3::NEG_Z), "faces up");
        let triangles = vec![[0, 2, 1], [0, 3, 2]];
        let below = leaf_rectangle(&foliage(positions, triangles, &[0, 2]), 0);
        assert_eq!((below.along, below.across), (DVec3::X, DVec3::Z), "faces down");
    }

    #[test]
    fn any_leaf_lies_in_its_rectangle() {
        //    5---4         2 long and 1 wide, of every size, place and orientation
        //   0     3
        //    1---2
        let hexagon = [[0.0, 0.0], [0.3, -0.5], [1.7, -0.5], [2.0, 0.0], [1.7, 0.5], [0.3, 0.5]];
        for (size, away) in [(1.0, 0.0), (1e-4, 0.0), (1e4, 0.0), (1.0, 1e6), (1e-4, 10.0)] {
            for turn in 0..60 {
                let angle = f64::from(turn);
                let axis = DVec3::new(angle.sin(), (2.0 * angle).cos(), 0.3).normalize();
                let rotation = DQuat::from_axis_angle(axis, angle);
                let place = |[x, y]: [f64; 2]| rotation * DVec3::new(x, y, 0.0) * size + away;
                let positions = hexagon.map(|p| place(p).as_vec3()).to_vec();
                let triangles = vec![[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]];
                let leaves = foliage(positions.clone(), triangles, &[0, 4]);
                let Rectangle3 { center, along, across, half } = leaf_rectangle(&leaves, 0);
                let slack = F32 * (size + away);
                let normal = leaves.normals[0].as_dvec3();
                assert!(along.cross(across).abs_diff_eq(normal, F32), "the leaf's own plane");
                for position in positions {
                    let offset = position.as_dvec3() - center;
                    assert!(offset.dot(along).abs() <= half.x + slack, "{position} beyond an end");
                    assert!(offset.dot(across).abs() <= half.y + slack, "{position} beyond a side");
                    let off_plane = offset.dot(normal).abs();
                    assert!(off_plane <= slack, "{position} is {off_plane} off the plane");
                }
                if away == 0.0 {
                    let sides = half / size;
                    assert!(sides.abs_diff_eq(DVec2::new(1.0, 0.5), F32), "{sides} of {size}");
                }
            }
        }
    }

    #[test]
    fn leaves_without_area_have_a_rectangle() {
        let (o, x) = (Vec3::ZERO, Vec3::new(3.0, 4.0, 0.0));
        let y = Vec3::Z * 2.0;
        // a point, a line, an upright line, and two lines that cross: flat, but of no area
        let triangles = vec![[0, 0, 0], [0, 1, 2], [3, 0, 3], [0, 1, 0], [0, 4, 0]];
        let positions = vec![o, x, x * 0.5, Vec3::Y * -6.0, y];
        let leaves = foliage(positions, triangles, &[0, 1, 2, 3, 5]);
        assert_eq!(leaves.normals, [Vec3::ZERO; 4], "none has a normal");
        let found: Vec<Rectangle3> = (0..4).map(|leaf| leaf_rectangle(&leaves, leaf)).collect();
        assert_eq!(found[0].corners(), [DVec3::ZERO; 4], "a point");
        let halves: Vec<DVec2> = found.iter().map(|rectangle| rectangle.half).collect();
        let near = |a: DVec2, x: f64, y: f64| a.abs_diff_eq(DVec2::new(x, y), 1e-15);
        assert!(near(halves[1], 2.5, 0.0), "{:?}", found[1]);
        assert!(near(halves[2], 3.0, 0.0), "{:?}", found[2]);
        // a right triangle with legs of 5 and 2: of its legs' rectangle and the hypotenuse's, which
        // are equal, the legs' is along the first edge
        assert!(near(halves[3], 2.5, 1.0), "{:?}", found[3]);
        for rectangle in &found {
            let Rectangle3 { along, across, .. } = rectangle;
            assert!(along.dot(*across).abs() < 1e-15, "a right angle: {rectangle:?}");
            assert!((along.cross(*across).length() - 1.0).abs() < 1e-15, "units: {rectangle:?}");
        }
        let middle = x.as_dvec3() * 0.5;
        assert!(found[1].center.abs_diff_eq(middle, 1e-15), "{:?}", found[1]);
    }

    #[test]
    fn all_leaves_on_any_thread_count_and_none_when_cancelled() {
        let corner = |k: u32| Vec3::new((k * k % 97) as f32, (k * 7 % 31) as f32, (k % 13) as f32);
        let positions: Vec<Vec3> = (0..3000).map(corner).collect();
        let triangles = (0..1000).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let offsets: Vec<u32> = (0..=1000).collect();
        let leaves = foliage(positions, triangles, &offsets);
        let one: Vec<Rectangle3> = (0..1000).map(|leaf| leaf_rectangle(&leaves, leaf)).collect();
        for threads in [1, 3] {
            let job = Job::default();
            let all = crate::job::run(Some(threads), || leaf_rectangles(&leaves, &job));
            assert_eq!(all.as_ref(), Ok(&one), "{threads} threads");
        }
        let job = Job::default();
        job.cancel();
        assert_eq!(leaf_rectangles(&leaves, &job), Err(LodError::Cancelled), "cancelled");
    }
}
