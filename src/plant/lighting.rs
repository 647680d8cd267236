//! Light that belongs to the plant: one colour a vertex and side, the same for every technique.
//!
//! Errors then measure the technique and not its shading. Irradiance on the side a normal `n`
//! points to is `E+ = sun max(n.l, 0) + sky (1 + n_y)/2 + ground (1 - n_y)/2`, on the other side `E-`
//! the same for `-n`. A leaf lets the share `t` through:
//! `front = base ((1 - t) E+ + t E-)`, `back = base ((1 - t) E- + t E+)`. Wood has `t = 0`.
//! All irradiances are scaled so that a white leaf facing the sun is at most 1.
//!
//! This work is based on:
//! Aleks Jakulin. Interactive Vegetation Rendering with Slicing and Blending. 2000
//! (light the vertices once and draw every representation from them)

use glam::{DVec3, Vec3};

use crate::error::{LodError, check_finite, check_in};
use crate::plant::mesh::Mesh;

/// A sun, a sky above and a ground below. Colours are linear and at least 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lighting {
    /// Towards the sun; any length above 0.
    pub sun_direction: DVec3,
    /// Irradiance of a surface facing the sun.
    pub sun: DVec3,
    /// Irradiance of a surface facing up, without the sun.
    pub sky: DVec3,
    /// Irradiance of a surface facing down.
    pub ground: DVec3,
    /// Share of the light that goes through a leaf, in [0, 1].
    pub translucency: f64,
}

impl Default for Lighting {
    /// A warm sun at 50 degrees of elevation, a cooler sky, a dim ground.
    fn default() -> Self {
        Self {
            sun_direction: DVec3::new(0.45, 0.77, 0.45),
            sun: DVec3::new(1.0, 0.95, 0.85),
            sky: DVec3::new(0.32, 0.38, 0.48),
            ground: DVec3::new(0.12, 0.11, 0.09),
            translucency: 0.25,
        }
    }
}

impl Lighting {
    /// Checks ranges.
    ///
    /// # Errors
    /// The first argument that is not finite, negative, or (translucency) above 1.
    pub fn check(&self) -> Result<(), LodError> {
        check_finite("sun_direction", &[self.sun_direction])?;
        if self.sun_direction.length() == 0.0 {
            let why = "must not be the zero vector".to_owned();
            return Err(LodError::Invalid { name: "sun_direction", why });
        }
        for (name, color) in [("sun", self.sun), ("sky", self.sky), ("ground", self.ground)] {
            check_finite(name, &[color])?;
            check_in(name, color.min_element(), 0.0..=f64::MAX)?;
        }
        check_in("translucency", self.translucency, 0.0..=1.0)
    }

    /// Share of the sun in the light of a leaf that faces it, averaged over the channels, in [0, 1].
    pub fn sun_share(&self) -> f64 {
        let facing = self.facing_sun();
        let total = facing.element_sum();
        if total > 0.0 { self.sun.element_sum() / total } else { 0.0 }
    }

    /// Front and back light of a surface with normal `n` and translucency `t`, scaled.
    pub fn front_back(&self, normal: Vec3, translucency: f64) -> (DVec3, DVec3) {
        let normal = normal.as_dvec3();
        let scale = self.scale();
        let plus = self.irradiance(normal) * scale;
        let minus = self.irradiance(-normal) * scale;
        let t = translucency;
        (plus * (1.0 - t) + minus * t, minus * (1.0 - t) + plus * t)
    }

    /// Fills `front` and `back` of a mesh from its base colours and normals.
    pub fn light(&self, mesh: &mut Mesh, translucency: f64) {
        let lit: Vec<(Vec3, Vec3)> = mesh
            .normals
            .iter()
            .zip(&mesh.base)
            .map(|(&normal, base)| {
                let (front, back) = self.front_back(normal, translucency);
                let base = base.truncate().as_dvec3();
                ((base * front).as_vec3(), (base * back).as_vec3())
            })
            .collect();
        mesh.front = lit.iter().map(|sides| sides.0).collect();
        mesh.back = lit.iter().map(|sides| sides.1).collect();
    }

    fn irradiance(&self, normal: DVec3) -> DVec3 {
        let up = normal.y;
        self.sun * normal.dot(self.sun_direction.normalize()).max(0.0)
            + self.sky * ((1.0 + up) / 2.0)
            + self.ground * ((1.0 - up) / 2.0)
    }

    fn facing_sun(&self) -> DVec3 {
        self.irradiance(self.sun_direction.normalize())
    }

    /// At most 1, so that dim light stays dim.
    fn scale(&self) -> f64 {
        let brightest = self.facing_sun().max_element();
        if brightest > 1.0 { 1.0 / brightest } else { 1.0 }
    }
}
