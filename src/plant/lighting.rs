//! Light that belongs to the plant: one colour a vertex and side, the same for every technique.
//!
//! Errors then measure the technique and not its shading. Irradiance on the side a normal `n`
//! points to is `E+ = sun max(n.l, 0) + sky (1 + n_y)/2 + ground (1 - n_y)/2`, on the other side `E-`
//! the same for `-n`. A leaf lets the share `t` through:
//! `front = base ((1 - t) E+ + t E-)`, `back = base ((1 - t) E- + t E+)`. Wood has `t = 0`.
//! All irradiances are scaled so that a white leaf facing the sun is at most 1.
//!
//! With an occlusion `s` above 0, the sky's term is multiplied by `1 - s (1 - v)`, `v` the share of the
//! sky that this side sees past the rest of the plant, and the ground's term likewise; the sun's is
//! not, as the sun throws shadows and not twilight. See [`occlusion`](crate::plant::occlusion).
//!
//! This work is based on:
//! Aleks Jakulin. Interactive Vegetation Rendering with Slicing and Blending. 2000
//! (light the vertices once and draw every representation from them)

use glam::{DVec3, Vec3};

use crate::error::{LodError, check_finite, check_in};
use crate::job::Job;
use crate::plant::mesh::Mesh;
use crate::plant::occlusion::Seen;

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
    /// How much of the sky's and the ground's light the plant keeps from itself, in [0, 1].
    pub occlusion: f64,
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
            occlusion: 0.0,
        }
    }
}

impl Lighting {
    /// Checks ranges.
    ///
    /// # Errors
    /// The first argument that is not finite, negative, or (translucency, occlusion) above 1.
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
        check_in("translucency", self.translucency, 0.0..=1.0)?;
        check_in("occlusion", self.occlusion, 0.0..=1.0)
    }

    /// The same light without occlusion.
    #[must_use]
    pub fn without_occlusion(self) -> Self {
        Self { occlusion: 0.0, ..self }
    }

    /// The same light with every irradiance scaled, so that a white leaf facing the sun is at most 1.
    #[must_use]
    pub fn scaled(self) -> Self {
        let scale = self.scale();
        let [sun, sky, ground] = [self.sun, self.sky, self.ground].map(|color| color * scale);
        Self { sun, sky, ground, ..self }
    }

    /// Front and back light of a surface with normal `n` and translucency `t`, scaled.
    pub fn front_back(&self, normal: Vec3, translucency: f64, seen: Seen) -> (DVec3, DVec3) {
        let normal = normal.as_dvec3();
        let scale = self.scale();
        let plus = self.irradiance(normal, seen.front) * scale;
        let minus = self.irradiance(-normal, seen.back) * scale;
        let t = translucency;
        (plus * (1.0 - t) + minus * t, minus * (1.0 - t) + plus * t)
    }

    /// Fills `front` and `back` of a mesh from its base colours and normals.
    ///
    /// `seen` has one value a vertex; `None`: every vertex sees everything.
    ///
    /// # Errors
    /// [`LodError::Cancelled`].
    pub fn light(
        &self,
        mesh: &mut Mesh,
        translucency: f64,
        seen: Option<&[Seen]>,
        job: &Job,
    ) -> Result<(), LodError> {
        let lit: Vec<(Vec3, Vec3)> =
            job.collect(mesh.normals.len().min(mesh.base.len()), |vertex| {
                let seen = seen.map_or(Seen::ALL, |seen| seen[vertex]);
                let (front, back) = self.front_back(mesh.normals[vertex], translucency, seen);
                let base = mesh.base[vertex].truncate().as_dvec3();
                ((base * front).as_vec3(), (base * back).as_vec3())
            })?;
        mesh.front = job.collect(lit.len(), |vertex| lit[vertex].0)?;
        mesh.back = job.collect(lit.len(), |vertex| lit[vertex].1)?;
        Ok(())
    }

    fn irradiance(&self, normal: DVec3, seen: [f32; 2]) -> DVec3 {
        let up = normal.y;
        let [sky, ground] = seen.map(|seen| 1.0 - self.occlusion * (1.0 - f64::from(seen)));
        self.sun * normal.dot(self.sun_direction.normalize()).max(0.0)
            + self.sky * ((1.0 + up) / 2.0 * sky)
            + self.ground * ((1.0 - up) / 2.0 * ground)
    }

    fn facing_sun(&self) -> DVec3 {
        self.irradiance(self.sun_direction.normalize(), Seen::ALL.front)
    }

    /// At most 1, so that dim light stays dim.
    fn scale(&self) -> f64 {
        let brightest = self.facing_sun().max_element();
        if brightest > 1.0 { 1.0 / brightest } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use glam::{Vec2, Vec4};

    use super::*;

    /// The sun straight above; every number below is a power of two, so that sums are exact.
    fn noon(translucency: f64) -> Lighting {
        Lighting {
            sun_direction: DVec3::Y * 3.0,
            sun: DVec3::new(0.5, 0.25, 0.0),
            sky: DVec3::splat(0.5),
            ground: DVec3::new(0.0, 0.0, 0.25),
            translucency,
            occlusion: 0.0,
        }
    }

    /// Irradiance of surfaces facing up, down and sideways: sun + sky, ground, (sky + ground) / 2.
    const UP: DVec3 = DVec3::new(1.0, 0.75, 0.5);
    const DOWN: DVec3 = DVec3::new(0.0, 0.0, 0.25);
    const SIDE: DVec3 = DVec3::new(0.25, 0.25, 0.375);

    #[test]
    fn front_and_back_by_hand() {
        let light = noon(0.25);
        let cases = [(Vec3::Y, UP, DOWN), (-Vec3::Y, DOWN, UP), (Vec3::X, SIDE, SIDE)];
        for (normal, plus, minus) in cases {
            assert_eq!(
                light.front_back(normal, 0.0, Seen::ALL),
                (plus, minus),
                "{normal}: none goes through"
            );
            assert_eq!(
                light.front_back(normal, 1.0, Seen::ALL),
                (minus, plus),
                "{normal}: all goes through"
            );
            let mixed = plus * 0.75 + minus * 0.25;
            assert_eq!(light.front_back(normal, 0.25, Seen::ALL).0, mixed, "{normal}: a quarter");
            let (front, back) = light.front_back(normal, 0.5, Seen::ALL);
            assert_eq!(front, back, "{normal}: half and half is the same on both sides");
        }
    }

    #[test]
    fn bright_light_is_scaled_to_one_and_dim_light_stays() {
        let bright = Lighting { sun: DVec3::splat(3.5), ..noon(0.0) };
        // facing the sun: 3.5 + 0.5 = 4 in every channel
        assert_eq!(bright.front_back(Vec3::Y, 0.0, Seen::ALL).0, DVec3::ONE, "4 becomes 1");
        assert_eq!(
            bright.front_back(-Vec3::Y, 0.0, Seen::ALL).0,
            DOWN * 0.25,
            "the rest shrinks with it"
        );
        let dim = Lighting { sun: DVec3::ZERO, ..noon(0.0) };
        assert_eq!(dim.front_back(Vec3::Y, 0.0, Seen::ALL).0, DVec3::splat(0.5), "not brightened");
        let default = Lighting::default();
        let facing =
            default.front_back(default.sun_direction.normalize().as_vec3(), 0.0, Seen::ALL).0;
        assert!((facing.max_element() - 1.0).abs() < 1e-6, "the default's brightest is 1");
    }

    #[test]
    fn light_multiplies_the_base_colour() {
        let base = Vec4::new(0.5, 1.0, 0.25, 0.125);
        let mut mesh = Mesh {
            positions: vec![Vec3::ZERO; 2],
            normals: vec![Vec3::Y, Vec3::ZERO],
            uvs: vec![Vec2::ZERO; 2],
            base: vec![base; 2],
            ..Mesh::default()
        };
        noon(0.25).light(&mut mesh, 0.0, None, &Job::default()).expect("not cancelled");
        assert_eq!(mesh.front[0], Vec3::new(0.5, 0.75, 0.125), "base times UP; alpha stays out");
        assert_eq!(mesh.back[0], Vec3::new(0.0, 0.0, 0.0625), "base times DOWN");
        assert_eq!(mesh.front[1], mesh.back[1], "no normal: the mean of sky and ground");
        assert_eq!(mesh.front[1], Vec3::new(0.125, 0.25, 0.09375), "base times SIDE");
    }

    #[test]
    fn occlusion_dims_sky_and_ground_and_not_the_sun() {
        let light = Lighting { occlusion: 0.5, ..noon(0.0) };
        let seen = Seen { front: [0.5, 0.0], back: [1.0, 0.0] };
        // sun and three quarters of the sky; half of the ground below
        let up = DVec3::new(0.5, 0.25, 0.0) + DVec3::splat(0.375);
        let expected = (up, DVec3::new(0.0, 0.0, 0.125));
        assert_eq!(light.front_back(Vec3::Y, 0.0, seen), expected, "up");
        let sideways = DVec3::splat(0.5 * 0.75 / 2.0) + DVec3::Z * (0.25 * 0.5 / 2.0);
        assert_eq!(light.front_back(Vec3::X, 0.0, seen).0, sideways, "half sky, half ground");
        let through = light.front_back(Vec3::Y, 1.0, seen);
        assert_eq!(through, (expected.1, expected.0), "what goes through was dimmed outside");
        assert_eq!(noon(0.0).front_back(Vec3::Y, 0.0, seen), (UP, DOWN), "0 is off");
        assert_eq!(light.front_back(Vec3::Y, 0.0, Seen::ALL), (UP, DOWN), "nothing in the way");
    }

    #[test]
    fn ranges_are_checked() {
        let says = |lighting: Lighting| lighting.check().map_err(|error| error.to_string());
        assert_eq!(says(noon(1.0)), Ok(()), "1 is allowed");
        assert!(says(noon(1.5)).is_err(), "more than all");
        for occlusion in [-0.1, 1.1, f64::NAN] {
            let error = says(Lighting { occlusion, ..noon(0.0) }).expect_err("out of range");
            assert!(error.starts_with("occlusion must be in [0, 1]"), "{error}");
        }
        assert!(
            says(Lighting { sun_direction: DVec3::ZERO, ..noon(0.0) }).is_err(),
            "no direction"
        );
        let dark = Lighting { sky: DVec3::new(0.0, -0.5, 0.0), ..noon(0.0) };
        assert!(says(dark).is_err(), "negative light");
        let error = Lighting { sun: DVec3::NAN, ..noon(0.0) }.check().expect_err("NaN");
        assert_eq!(error, LodError::NotFinite { name: "sun", index: 0 }, "named");
    }
}
