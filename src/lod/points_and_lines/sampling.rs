//! Points on triangles: two on each, or as many as its area asks for; never where a texture leaves
//! the leaf out.
//!
//! A point is drawn evenly over what is opaque of its triangle, by trying again where it is not. Its
//! normal is the triangle's own, so that the side it shows is the side the triangle shows.

use glam::{Vec3, Vec4};

use crate::lod::points_and_lines::opaque::{Cover, Weights, mix, weights_of};
use crate::lod::points_and_lines::selection::Sampling;
use crate::plant::Mesh;
use crate::plant::mesh::area_normal;
use crate::random::{Purpose, Stream};

const PLACE: Purpose = Purpose::named("points_and_lines.place");
const JITTER: Purpose = Purpose::named("points_and_lines.jitter");

/// The order of a group's triangles, or of its lines.
pub const ORDER: Purpose = Purpose::named("points_and_lines.shuffle");

/// The order of points that are no triangle's.
pub const POINT_ORDER: Purpose = Purpose::named("points_and_lines.point_order");

/// Largest coefficient of variation of the triangles' areas at which each of them gets two points.
const MAX_VARIATION: f64 = 0.5;

/// Places that are tried for a point before the most opaque known one is taken.
const MAX_TRIES: usize = 64;

/// A point, as it is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Splat {
    /// Metres, relative to the plant's origin.
    pub position: Vec3,
    /// Of its triangle; zero if that has no area.
    pub normal: Vec3,
    /// Linear unlit colour; opaque.
    pub base: Vec4,
    /// Linear lit colour of the counter-clockwise side.
    pub front: Vec3,
    /// Of the other side.
    pub back: Vec3,
}

/// Whether triangles of such areas are sampled alike, two points each.
pub fn automatic(areas: &[f64]) -> Sampling {
    let count = areas.len() as f64;
    let mean = areas.iter().sum::<f64>() / count;
    let variance = areas.iter().map(|area| (area - mean) * (area - mean)).sum::<f64>() / count;
    if variance.sqrt() <= MAX_VARIATION * mean { Sampling::Stratified } else { Sampling::Area }
}

/// The order of `count` things, the same for the same seed and number.
pub fn permutation(seed: u64, purpose: Purpose, number: u64, count: usize) -> Vec<u32> {
    let mut order: Vec<u32> = (0..u32::try_from(count).expect("counted in u32")).collect();
    let mut stream = Stream::new(seed, purpose, number);
    for last in (1..count).rev() {
        let with = usize::try_from(stream.below(last as u64 + 1)).expect("below a usize");
        order.swap(last, with);
    }
    order
}

/// For each of `count` points the triangle it lies on, by area: evenly spaced along the running sum of
/// areas, each moved at random within its own step.
pub fn by_area(areas: &[f64], count: usize, seed: u64, number: u64) -> Vec<u32> {
    let total: f64 = areas.iter().sum();
    let mut stream = Stream::new(seed, JITTER, number);
    let mut chosen = Vec::with_capacity(count);
    let (mut triangle, mut sum) = (0, areas.first().copied().unwrap_or(0.0));
    for point in 0..count {
        let at = (point as f64 + stream.unit()) / count as f64 * total;
        while at >= sum && triangle + 1 < areas.len() {
            triangle += 1;
            sum += areas[triangle];
        }
        chosen.push(u32::try_from(triangle).expect("counted in u32"));
    }
    chosen
}

/// Points on a triangle: `keys` are unique numbers of them, which decide where they lie.
pub fn splats(
    mesh: &Mesh,
    cover: &Cover<'_>,
    triangle: usize,
    seed: u64,
    keys: &[u64],
) -> Vec<Splat> {
    let places: Vec<Weights> =
        keys.iter().map(|&key| place(mesh, cover, triangle, seed, key)).collect();
    let texels = cover.texels(mesh, triangle, &places);
    let corners = mesh.triangles[triangle].map(|v| v as usize);
    let normal = area_normal(mesh.corners(triangle)).normalize_or_zero().as_vec3();
    let splat = |(&weights, texel): (&Weights, Vec3)| {
        let of = |colors: &[Vec3]| mix(corners.map(|v| colors[v]), weights) * texel;
        let base = mix(corners.map(|v| mesh.base[v].truncate()), weights) * texel;
        Splat {
            position: mix(corners.map(|v| mesh.positions[v]), weights),
            normal,
            base: base.extend(1.0),
            front: of(&mesh.front),
            back: of(&mesh.back),
        }
    };
    places.iter().zip(texels).map(splat).collect()
}

fn place(mesh: &Mesh, cover: &Cover<'_>, triangle: usize, seed: u64, key: u64) -> Weights {
    let mut stream = Stream::new(seed, PLACE, key);
    for _ in 0..MAX_TRIES {
        let weights = weights_of([stream.unit(), stream.unit()]);
        // an opacity between 0 and 1 is the share of points that are there
        let opacity = || f64::from(cover.look(mesh, triangle, weights).opacity);
        if cover.is_plain() || stream.unit() < opacity() {
            return weights;
        }
    }
    cover.most_opaque(mesh, triangle)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lod::made::{facing, quads};
    use crate::plant::{AlphaMode, Material};
    use crate::texture::{Image, Sampler, Texture, Wrap};

    #[test]
    fn even_triangles_get_two_points_each() {
        assert_eq!(automatic(&[1.0, 1.0, 1.0]), Sampling::Stratified, "equal");
        // mean 1, deviation one half: the last that is even enough
        assert_eq!(automatic(&[0.5, 1.5]), Sampling::Stratified, "0.5");
        assert_eq!(automatic(&[0.49, 1.51]), Sampling::Area, "0.51");
        assert_eq!(automatic(&[0.0, 0.0]), Sampling::Stratified, "no area at all");
    }

    #[test]
    fn permutations_are_what_they_say() {
        for count in [0, 1, 2, 1000] {
            let mut order = permutation(7, ORDER, 3, count);
            assert_eq!(order, permutation(7, ORDER, 3, count), "the same again");
            if count == 1000 {
                assert_ne!(order, permutation(8, ORDER, 3, count), "another seed");
                assert_ne!(order, permutation(7, ORDER, 4, count), "another group");
                assert_ne!(order, permutation(7, POINT_ORDER, 3, count), "another purpose");
            }
            order.sort_unstable();
            assert!(order.iter().enumerate().all(|(i, &at)| i == at as usize), "{count} things");
        }
    }

    #[test]
    fn equal_areas_get_equal_numbers_of_points() {
        let chosen = by_area(&[1.0, 0.0, 2.0, 1.0], 8, 1, 0);
        assert_eq!(chosen, [0, 0, 2, 2, 2, 2, 3, 3], "two a square metre, none without area");
        assert_eq!(by_area(&[0.0, 0.0], 2, 1, 0), [1, 1], "no area at all: somewhere");
        // 3 : 5 of 10 points are 3.75 : 6.25: either way rounded
        let count = by_area(&[3.0, 5.0], 10, 2, 0).iter().filter(|&&t| t == 0).count();
        assert!((3..=4).contains(&count), "{count}");
    }

    #[test]
    fn points_lie_on_what_is_opaque_and_have_its_colour() {
        let mut mesh = quads(&[facing(0.0, 0.0, 0.0, 1.0)]);
        for (uv, position) in mesh.uvs.iter_mut().zip(&mesh.positions) {
            *uv = (position.truncate() + 1.0) * 0.5;
        }
        mesh.front = vec![Vec3::splat(0.5); 4];
        mesh.back = vec![Vec3::splat(0.25); 4];
        let texels = (0..64).map(|x| if x < 16 { [255, 0, 0, 255] } else { [0, 255, 0, 0] });
        let image = Image::new(64, 1, texels.collect()).expect("64 texels");
        let material = Material {
            name: "cut".to_owned(),
            texture: Some(Texture::new(vec![image]).expect("one level")),
            sampler: Sampler { wrap: [Wrap::Clamp; 2], ..Sampler::default() },
            alpha_mode: AlphaMode::Mask { cutoff: 0.5 },
            double_sided: true,
        };
        let cover = Cover::new(&material);
        let keys: Vec<u64> = (0..400).collect();
        let found = splats(&mesh, &cover, 1, 5, &keys);
        for splat in &found {
            assert!(splat.position.x <= -0.499, "{} is not leaf", splat.position);
            // a mean of reds is rounded
            let colors = [splat.front * 2.0, splat.back * 4.0, splat.base.truncate()];
            assert!(colors.iter().all(|c| c.abs_diff_eq(Vec3::X, 1e-6)), "{colors:?}");
            assert_eq!((splat.normal, splat.base.w), (Vec3::Z, 1.0), "faces as its triangle does");
        }
        // evenly: the left quarter of the upper triangle, from y = x to 1, is a trapezium
        let mean = found.iter().map(|s| s.position.x).sum::<f32>() / 400.0;
        // centroid of x over [-1, -1/2] with weight 1 - x: -0.7619; a standard error is 0.007
        assert!((mean + 0.7619).abs() < 0.03, "{mean}");
        let clear = Material { alpha_mode: AlphaMode::Blend, ..material };
        let blended = splats(&mesh, &Cover::new(&clear), 1, 5, &keys);
        assert!(blended.iter().all(|s| s.position.x <= -0.45), "in proportion to alpha");
    }
}
