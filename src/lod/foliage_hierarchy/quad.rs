//! What a quad of two triangles measures: centre, normal and area, by the rules that leaves have.

use glam::DVec3;

/// What leaves, and the quads they collapse into, are compared by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measures {
    /// Centroid by area; the mean of the corners if there is no area.
    pub center: DVec3,
    /// Unit normal by area, signs aligned to the larger triangle's; zero if there is no area.
    pub normal: DVec3,
    /// Of both triangles, in square metres.
    pub area: f64,
}

/// Area vectors of the triangles (0, 1, 2) and (0, 2, 3): across them, half the cross product long.
pub fn area_vectors(quad: &[DVec3; 4]) -> [DVec3; 2] {
    let [a, b, c, d] = *quad;
    [(b - a).cross(c - a) * 0.5, (c - a).cross(d - a) * 0.5]
}

/// Centre, normal and area of a quad that is cut along corners 0 and 2.
pub fn measure(quad: &[DVec3; 4]) -> Measures {
    let [a, b, c, d] = *quad;
    let [first, second] = area_vectors(quad);
    let (first_area, second_area) = (first.length(), second.length());
    let area = first_area + second_area;
    if area == 0.0 {
        return Measures { center: (a + b + c + d) / 4.0, normal: DVec3::ZERO, area };
    }
    let center = ((a + b + c) * first_area + (a + c + d) * second_area) / (3.0 * area);
    let larger = if second_area > first_area { second } else { first };
    let aligned = |vector: DVec3| if vector.dot(larger) < 0.0 { -vector } else { vector };
    let normal = (aligned(first) + aligned(second)).normalize_or_zero();
    Measures { center, normal, area }
}
