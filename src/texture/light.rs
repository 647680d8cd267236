//! Light on surfaces of which only the normal is known: what pictures that keep normals are lit by.
//!
//! The formula is that of plants, for the side that is seen. Where a normal is the mean of many, sky and
//! ground are exact, as they are linear in it. The sun's term is not: as many normals as the mean is
//! long are taken to point its way, and the others to point anywhere, which gives a quarter of the sun.

use glam::Vec3;

/// A sun, a sky above and a ground below. Colours are linear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Unit vector towards the sun.
    pub sun_direction: Vec3,
    /// Irradiance of a surface facing the sun.
    pub sun: Vec3,
    /// Irradiance of a surface facing up, without the sun.
    pub sky: Vec3,
    /// Irradiance of a surface facing down.
    pub ground: Vec3,
    /// Share of the light that goes through a leaf.
    pub translucency: f32,
}

impl Light {
    /// What multiplies the colour of surfaces with a mean normal, towards their viewer and at most of
    /// length 1, of which a share is leaves and lets light through.
    #[inline]
    pub fn on(&self, normal: Vec3, leaf_share: f32) -> Vec3 {
        let t = leaf_share * self.translucency;
        self.irradiance(normal) * (1.0 - t) + self.irradiance(-normal) * t
    }

    #[inline]
    fn irradiance(&self, normal: Vec3) -> Vec3 {
        let up = normal.y;
        let anywhere = (1.0 - normal.length()).max(0.0) * 0.25;
        self.sun * (normal.dot(self.sun_direction).max(0.0) + anywhere)
            + self.sky * (0.5 + 0.5 * up)
            + self.ground * (0.5 - 0.5 * up)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_lit_by_hand() {
        let light = Light {
            sun_direction: Vec3::Y,
            sun: Vec3::new(0.5, 0.25, 0.0),
            sky: Vec3::splat(0.5),
            ground: Vec3::new(0.0, 0.0, 0.25),
            translucency: 0.5,
        };
        // sun and sky from above, ground from below, half of sky and ground from the side
        let (up, down) = (Vec3::new(1.0, 0.75, 0.5), Vec3::new(0.0, 0.0, 0.25));
        assert_eq!(light.on(Vec3::Y, 0.0), up, "wood that faces up");
        assert_eq!(light.on(Vec3::NEG_Y, 0.0), down, "wood that faces down");
        assert_eq!(light.on(Vec3::X, 0.0), Vec3::new(0.25, 0.25, 0.375), "upright wood");
        assert_eq!(light.on(Vec3::Y, 1.0), (up + down) * 0.5, "half goes through a leaf");
        assert_eq!(light.on(Vec3::Y, 0.5), up * 0.75 + down * 0.25, "half of it is leaves");
        // a quarter of the sun, half of sky and ground
        let anywhere = Vec3::new(0.375, 0.3125, 0.375);
        assert_eq!(light.on(Vec3::ZERO, 1.0), anywhere, "normals that cancel out");
        assert_eq!(light.on(Vec3::Y * 0.5, 0.0), (up + anywhere) * 0.5, "half of them agree");
    }
}
