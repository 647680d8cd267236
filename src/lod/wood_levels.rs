//! Which wood to draw from afar: ever coarser meshes of it, and the rule that picks one for a view.
//!
//! Level 0 is the wood as asked for. Each further level has about half the triangles of the one
//! before, simplified by meshoptimizer from level 0, until it gets no further. All levels share level
//! 0's vertices: one vertex buffer, and a range of indices a level.
//!
//! Materials are simplified one by one, so that a gap as wide as the error may open between two.
//!
//! A level's error is meshoptimizer's, in metres and against level 0: the largest over all collapses
//! of the weighted mean distance from the planes of the triangles that a vertex stands for, or the
//! radius of the largest piece that was dropped whole, if that is larger. What is left lies within
//! 1.4 times that of where wood was (measured on a tube and a chestnut). What is gone may lie much
//! farther from what is left, for a twig that is thinner than the error is drawn back along its
//! length at little cost. It is thin, though: where the error is one pixel, silhouettes of a level and
//! of level 0 differ nowhere by a square of 5 pixels, and by one of 3 at fewer than one in a thousand
//! pixels. Twig by twig, 8, 19, 31, 40 and 48 % of a chestnut's silhouette change at levels 1 to 5.

use glam::DVec3;

use crate::error::LodError;
use crate::job::Job;
use crate::lod::simplify::{self, EdgeOptions, Method, Simplified, Simplifier};
use crate::lod::solid::Solid;
use crate::lod::wood::Wood;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture, largest_scale};
use crate::plant::{Material, Mesh, Part, Plant};
use crate::view::View;
use crate::view_state::ViewState;

/// A level that keeps more than this share of the triangles of the one before is not worth having.
const WORTHWHILE: f64 = 0.75;

const METHOD: Method = Method::Edges(EdgeOptions { prune: true, lock_border: false });

/// Levels of a plant's wood; the finest alone, without a triangle, where there is no wood.
#[derive(Debug, Clone)]
pub struct WoodLevels {
    /// Finest first; all share one geometry.
    levels: Vec<Solid>,
    triangle_counts: Vec<usize>,
    errors: Vec<f64>,
    bounds: Option<(DVec3, DVec3)>,
    center: DVec3,
    /// Largest distance of a vertex from the centre.
    radius: f64,
}

impl WoodLevels {
    /// Simplifies the wood of a plant to at most so many levels, with materials ready to be drawn.
    ///
    /// # Errors
    /// As [`Wood::of`]; [`LodError::Cancelled`].
    pub(crate) fn build(
        plant: &Plant,
        wood: Wood,
        max_level_count: usize,
        materials: &[Material],
        job: &Job,
    ) -> Result<Self, LodError> {
        let finest = wood.of(plant)?;
        let levels = levels_of(&finest, max_level_count, job)?;
        let bounds = finest.bounds().map(|(low, high)| (low.as_dvec3(), high.as_dvec3()));
        let center = bounds.map_or(DVec3::ZERO, |(low, high)| (low + high) * 0.5);
        let used = finest.triangles.iter().flatten();
        let away = used.map(|&v| finest.positions[v as usize].as_dvec3().distance(center));
        let radius = away.fold(0.0, f64::max);
        // one mesh with the triangles of all levels, one after the other
        let mut mesh = Mesh { triangles: Vec::new(), parts: Vec::new(), ..finest };
        let (mut ids, mut ends) = (Vec::new(), Vec::new());
        for level in &levels {
            let first = u32::try_from(mesh.triangles.len()).expect("twice the wood's at most");
            mesh.triangles.extend_from_slice(&level.triangles);
            mesh.parts.extend(level.parts.iter().map(|part| Part {
                triangles: part.triangles.start + first..part.triangles.end + first,
                ..part.clone()
            }));
            ends.push(u32::try_from(mesh.triangles.len()).expect("twice the wood's at most"));
            ids.extend((0_u32..).take(level.triangles.len()));
        }
        let solid = Solid::of_ready(&[(&mesh, ids)], materials.to_vec());
        Ok(Self {
            levels: solid.cut(&ends),
            triangle_counts: levels.iter().map(|level| level.triangles.len()).collect(),
            errors: levels.iter().map(|level| level.error).collect(),
            bounds,
            center,
            radius,
        })
    }

    /// Triangles of each level, falling.
    pub fn triangle_counts(&self) -> &[usize] {
        &self.triangle_counts
    }

    /// Error of each level in metres, never falling; 0 for the first.
    pub fn errors(&self) -> &[f64] {
        &self.errors
    }

    /// Box around the wood, relative to the plant's origin.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.bounds
    }

    /// The coarsest level whose error is at most `max_error_px` pixels where the copy's wood is
    /// nearest to the eye.
    ///
    /// In perspective a pixel is as large there as in the middle of the picture at the distance of
    /// the nearest point of a ball around the wood, so that turning the camera changes nothing. With
    /// the eye inside the ball it is level 0. In parallel views pixels have the same size everywhere.
    /// A copy that is stretched has its errors stretched as far as its longest way.
    pub fn pick(&self, view: &View, crown: &Crown, max_error_px: f64) -> usize {
        let scale = largest_scale(&crown.world_from_local);
        let pixel_size = if view.is_orthographic() {
            view.pixel_size_at(1.0)
        } else {
            let center = crown.world_from_local.transform_point3(self.center);
            let nearest = center.distance(view.eye) - self.radius * scale;
            if nearest <= 0.0 {
                return 0;
            }
            view.pixel_size_at(nearest)
        };
        let allowed = max_error_px * pixel_size / scale;
        self.errors.partition_point(|&error| error <= allowed).saturating_sub(1)
    }

    /// The level that goes with a share of the leaves, in [0, 1]: the one whose triangle count is
    /// nearest to that share of level 0's; of equally near ones the finer.
    pub fn pick_share(&self, keep_fraction: f64) -> usize {
        let wanted = keep_fraction * self.triangle_counts[0] as f64;
        let away = |level: usize| (self.triangle_counts[level] as f64 - wanted).abs();
        (1..self.levels.len())
            .fold(0, |best, level| if away(level) < away(best) { level } else { best })
    }

    /// Appends a level's triangles for some copies, given far to near.
    pub fn emit(
        &self,
        level: usize,
        view: &View,
        crowns: &[Crown],
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) {
        self.levels[level].emit(view, crowns, state, builder);
    }

    /// Appends for each copy the level that `level_of` gives it; copies are given far to near.
    pub fn emit_each(
        &self,
        view: &View,
        crowns: &[Crown],
        level_of: impl Fn(&Crown) -> usize,
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) {
        let mut groups: Vec<Vec<Crown>> = vec![Vec::new(); self.levels.len()];
        for crown in crowns {
            groups[level_of(crown)].push(crown.clone());
        }
        // copies of fine levels are near: first, so that they hide what lies behind them
        for (level, crowns) in groups.iter().enumerate() {
            self.emit(level, view, crowns, state, builder);
        }
    }

    /// Triangles of all levels together, and the bytes of the vertices, which they share, of all
    /// indices and of the textures.
    pub fn footprint(&self) -> Footprint {
        self.levels[0].footprint()
    }

    /// The textures that the wood uses, each once.
    pub fn textures(&self) -> Vec<NamedTexture> {
        self.levels[0].textures()
    }
}

/// Triangles of a level, with the vertices of the finest.
struct Level {
    triangles: Vec<[u32; 3]>,
    parts: Vec<Part>,
    error: f64,
}

fn levels_of(finest: &Mesh, max_level_count: usize, job: &Job) -> Result<Vec<Level>, LodError> {
    let simplifier = Simplifier::new(finest);
    let groups = simplify::by_material(finest);
    let mut levels = vec![Level {
        triangles: finest.triangles.clone(),
        parts: finest.parts.clone(),
        error: 0.0,
    }];
    while levels.len() < max_level_count {
        let last = levels.last().expect("the finest");
        let target = last.triangles.len() / 2;
        let mut next = Level { triangles: Vec::new(), parts: Vec::new(), error: last.error };
        for (material, triangles) in &groups {
            let share = simplify::share(target, triangles.len(), finest.triangles.len());
            let Simplified { triangles, error } = something(&simplifier, triangles, share, job)?;
            let start = u32::try_from(next.triangles.len()).expect("fewer than before");
            next.triangles.extend(triangles);
            let end = u32::try_from(next.triangles.len()).expect("fewer than before");
            next.parts.push(Part { material: *material, triangles: start..end });
            next.error = next.error.max(error);
        }
        if next.triangles.len() as f64 > WORTHWHILE * last.triangles.len() as f64
            || next.triangles.is_empty()
        {
            break;
        }
        levels.push(next);
    }
    Ok(levels)
}

/// About `count` of some triangles, and at least one: wood must not vanish.
fn something(
    simplifier: &Simplifier,
    triangles: &[[u32; 3]],
    mut count: usize,
    job: &Job,
) -> Result<Simplified, LodError> {
    loop {
        let found = simplifier.simplify(triangles, count, f64::INFINITY, METHOD, job)?;
        if !found.triangles.is_empty() {
            return Ok(found);
        }
        count *= 2;
    }
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DQuat, Vec2, Vec3, Vec4};

    use super::*;
    use crate::draw_list::{Blend, DrawList};
    use crate::lod::made;
    use crate::plant::{AlphaMode, Lighting, grow};
    use crate::raster::{Outputs, Renderer, Settings};
    use crate::texture::Sampler;
    use crate::view::Projection;

    /// Distance of a point from a triangle (Ericson, Real-Time Collision Detection, 5.1.5).
    fn distance(p: Vec3, [a, b, c]: [Vec3; 3]) -> f64 {
        let [p, a, b, c] = [p, a, b, c].map(|v| v.as_dvec3());
        let (ab, ac, ap) = (b - a, c - a, p - a);
        let (d1, d2) = (ab.dot(ap), ac.dot(ap));
        if d1 <= 0.0 && d2 <= 0.0 {
            return p.distance(a);
        }
        let bp = p - b;
        let (d3, d4) = (ab.dot(bp), ac.dot(bp));
        if d3 >= 0.0 && d4 <= d3 {
            return p.distance(b);
        }
        let vc = d1 * d4 - d3 * d2;
        if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
            return p.distance(a + ab * (d1 / (d1 - d3)));
        }
        let cp = p - c;
        let (d5, d6) = (ab.dot(cp), ac.dot(cp));
        if d6 >= 0.0 && d5 <= d6 {
            return p.distance(c);
        }
        let vb = d5 * d2 - d1 * d6;
        if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
            return p.distance(a + ac * (d2 / (d2 - d6)));
        }
        let va = d3 * d6 - d5 * d4;
        if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
            return p.distance(b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6))));
        }
        let sum = va + vb + vc;
        if sum == 0.0 {
            return p.distance(a);
        }
        p.distance(a + ab * (vb / sum) + ac * (vc / sum))
    }

    /// The largest distance of about `count` of some triangles' corners and middles from others.
    fn farthest(mesh: &Mesh, from: &[[u32; 3]], to: &[[u32; 3]], count: usize) -> f64 {
        let corners = |triangle: &[u32; 3]| triangle.map(|v| mesh.positions[v as usize]);
        let triangles = from.iter().step_by(from.len().div_ceil(count).max(1));
        let points = triangles.flat_map(|triangle| {
            let [a, b, c] = corners(triangle);
            [a, b, c, (a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0, (a + b + c) / 3.0]
        });
        let nearest = |point: Vec3| {
            to.iter().map(|t| distance(point, corners(t))).fold(f64::INFINITY, f64::min)
        };
        points.map(nearest).fold(0.0, f64::max)
    }

    /// A tube of `2 * around * along` triangles, open at its ends, bent and wavy by `wave`.
    fn tube(around: u32, along: u32, wave: f32) -> Mesh {
        let mut mesh = Mesh::default();
        for ring in 0..=along {
            for step in 0..around {
                let angle = step as f32 / around as f32 * std::f32::consts::TAU;
                let radius = 1.0 + wave * libm::sinf(ring as f32 * 0.7);
                let (x, z) = (libm::cosf(angle) * radius, libm::sinf(angle) * radius);
                let bend = wave * 5.0 * libm::sinf(ring as f32 * 0.1);
                mesh.positions.push(Vec3::new(x + bend, ring as f32 * 0.25, z));
                mesh.normals.push(Vec3::new(x, 0.0, z).normalize());
                mesh.uvs.push(Vec2::ZERO);
                mesh.base.push(Vec4::ONE);
            }
        }
        for ring in 0..along {
            for step in 0..around {
                let next = (step + 1) % around;
                let [a, b] = [ring * around + step, ring * around + next];
                mesh.triangles.extend([[a, b + around, b], [a, a + around, b + around]]);
            }
        }
        mesh.parts = Mesh::parts_from_ids(&vec![0; mesh.triangles.len()]);
        mesh
    }

    fn plant_of(wood: Mesh, modes: &[AlphaMode]) -> Plant {
        let materials: Vec<Material> = modes
            .iter()
            .map(|&alpha_mode| Material {
                name: "bark".to_owned(),
                texture: None,
                sampler: Sampler::default(),
                alpha_mode,
                double_sided: false,
            })
            .collect();
        let leaf = made::quads(&[made::facing(0.0, 3.0, 0.0, 1.0)]);
        let lighting = Lighting::default();
        let name = "test".to_owned();
        Plant::new(name, DVec3::ZERO, materials, wood, leaf, vec![0, 2], lighting, &Job::default())
            .expect("valid")
    }

    fn built(plant: &Plant, wood: Wood) -> WoodLevels {
        WoodLevels::build(plant, wood, usize::MAX, &plant.materials, &Job::default())
            .expect("valid")
    }

    fn emitted(wood: &WoodLevels, level: usize, view: &View, crowns: &[Crown]) -> DrawList {
        let mut builder = ListBuilder::default();
        wood.emit(level, view, crowns, &mut ViewState::default(), &mut builder);
        let list = builder.finish();
        list.check().expect("consistent");
        list
    }

    fn here() -> Crown {
        made::crown_at(DAffine3::IDENTITY, 0)
    }

    /// Levels of given counts and errors without any triangle, in a ball of radius 2 about (0, 3, 0).
    fn bare(triangle_counts: &[usize], errors: &[f64]) -> WoodLevels {
        let nothing = Solid::of_ready(&[], Vec::new());
        WoodLevels {
            levels: vec![nothing; errors.len()],
            triangle_counts: triangle_counts.to_vec(),
            errors: errors.to_vec(),
            bounds: None,
            center: DVec3::Y * 3.0,
            radius: 2.0,
        }
    }

    #[test]
    fn a_straight_tube_loses_its_rings_at_no_cost() {
        // 4 sides and 16 rings between its ends: 8 triangles are enough
        let plant = plant_of(tube(4, 16, 0.0), &[AlphaMode::Opaque]);
        let wood = built(&plant, Wood::Full);
        assert_eq!(wood.triangle_counts()[..5], [128, 64, 32, 16, 8], "halves");
        // but for what meshoptimizer adds for a vertex's own way: the root of 1e-7 of it
        assert!(wood.errors()[4] < 4.0 * 3.2e-4, "{:?}", wood.errors());
        assert!(wood.errors()[5..].iter().all(|&e| e > 0.1), "then sides go: {:?}", wood.errors());
        let levels = levels_of(&plant.wood, usize::MAX, &Job::default()).expect("not cancelled");
        let mesh = &plant.wood;
        for level in &levels[..5] {
            let triangles = &level.triangles;
            let area = Mesh { triangles: triangles.clone(), ..mesh.clone() }.area();
            assert!((area / mesh.area() - 1.0).abs() < 1e-5, "{} of {}", area, mesh.area());
        }
    }

    #[test]
    fn what_is_left_lies_within_the_error() {
        let grown = grow::grow("chestnut", 1, Some(1), Lighting::default(), &Job::default());
        let meshes = [("tube", tube(24, 60, 0.1)), ("chestnut", grown.expect("grown").wood)];
        for (name, mesh) in meshes {
            let levels = levels_of(&mesh, usize::MAX, &Job::default()).expect("not cancelled");
            assert!(levels.len() > 5, "{name}: {} levels", levels.len());
            for level in [&levels[1], &levels[3], &levels[5]] {
                let left = farthest(&mesh, &level.triangles, &mesh.triangles, 40) / level.error;
                assert!(left < 1.5, "{name}: {left} times the error; 1.38 was found");
                assert!(left > 0.5, "{name}: {left} times the error, which says too little");
                if name == "tube" {
                    // which is thick everywhere: nothing is drawn back
                    let lost = farthest(&mesh, &mesh.triangles, &level.triangles, 200);
                    assert!(lost / level.error < 1.5, "{lost} of {} m", level.error);
                }
            }
        }
    }

    #[test]
    fn counts_fall_and_errors_rise_for_each_material() {
        let mut mesh = tube(16, 40, 0.1);
        // a strip of another material, and a third that turns up again and again
        let triangles = 0..u32::try_from(mesh.triangles.len()).expect("few");
        let ids: Vec<u32> = triangles.map(|t| if t < 300 { 1 } else { (t / 90) % 2 * 2 }).collect();
        mesh.parts = Mesh::parts_from_ids(&ids);
        let plant = plant_of(mesh, &[AlphaMode::Opaque; 3]);
        let levels = levels_of(&plant.wood, usize::MAX, &Job::default()).expect("not cancelled");
        assert_eq!(levels[0].triangles, plant.wood.triangles, "as it is");
        assert_eq!(levels[0].error, 0.0, "against itself");
        assert!(levels.len() > 3, "{} levels", levels.len());
        for pair in levels.windows(2) {
            let counts = [0, 1].map(|level| pair[level].triangles.len() as f64);
            assert!(counts[1] <= WORTHWHILE * counts[0], "{counts:?}");
            assert!(counts[1] >= 0.35 * counts[0], "about half: {counts:?}");
            assert!(pair[1].error >= pair[0].error, "{} {}", pair[0].error, pair[1].error);
            let materials: Vec<u32> = pair[1].parts.iter().map(|part| part.material).collect();
            assert_eq!(materials, [0, 1, 2], "none is lost, and each is one run");
            let level = Mesh {
                triangles: pair[1].triangles.clone(),
                parts: pair[1].parts.clone(),
                ..plant.wood.clone()
            };
            level.check(3, &Job::default()).expect("consistent");
        }
        let wood = built(&plant, Wood::Full);
        let errors: Vec<f64> = levels.iter().map(|level| level.error).collect();
        assert_eq!(wood.errors(), errors, "as found");
    }

    #[test]
    fn levels_share_their_vertices() {
        let mesh = tube(16, 40, 0.1);
        let (vertex_count, triangle_count) = (mesh.positions.len(), mesh.triangles.len());
        let plant = plant_of(mesh, &[AlphaMode::Opaque]);
        let wood = built(&plant, Wood::Full);
        let total: usize = wood.triangle_counts().iter().sum();
        let footprint = wood.footprint();
        assert_eq!(footprint.triangle_count, total as u64, "of all levels");
        assert!(total < 2 * triangle_count, "which is less than twice the finest");
        let bytes = vertex_count * 18 * 4 + total * 3 * 4;
        assert_eq!(footprint.geometry_bytes, bytes as u64, "vertices once, indices of each level");
        let view = made::parallel(DVec3::Z, DVec3::Y, 20.0, 16);
        let lists: Vec<DrawList> = (0..wood.triangle_counts().len())
            .map(|level| emitted(&wood, level, &view, &[here()]))
            .collect();
        let mut end = 0;
        for (list, &count) in lists.iter().zip(wood.triangle_counts()) {
            assert_eq!(list.geometries[0].id(), lists[0].geometries[0].id(), "the same buffers");
            let [item] = &list.items[..] else { panic!("one item, got {}", list.items.len()) };
            assert_eq!(item.primitives.len(), count, "a range of its own");
            assert_eq!(item.primitives.start, end, "after the one before");
            end = item.primitives.end;
            let buffers = list.geometries[0].buffers();
            assert_eq!(buffers.source_ids[item.primitives.start as usize], 0, "ids from 0");
        }
    }

    #[test]
    fn the_same_again() {
        let plant = plant_of(tube(16, 40, 0.1), &[AlphaMode::Opaque]);
        let [one, two] =
            [0, 1].map(|_| levels_of(&plant.wood, usize::MAX, &Job::default()).expect("valid"));
        assert_eq!(one.len(), two.len(), "levels");
        for (a, b) in one.iter().zip(&two) {
            assert_eq!((&a.triangles, a.error), (&b.triangles, b.error), "bit for bit");
        }
        let job = Job::default();
        job.cancel();
        let result = WoodLevels::build(&plant, Wood::Full, usize::MAX, &plant.materials, &job);
        assert_eq!(result.err(), Some(LodError::Cancelled), "stopped");
    }

    #[test]
    fn a_view_picks_the_coarsest_level_that_it_cannot_tell() {
        let wood = bare(&[100, 50, 25, 12], &[0.0, 0.1, 0.1, 0.5]);
        let from = |eye: DVec3| {
            // 24 pixels a tangent of 2 tan(0.5)
            made::perspective(eye, DVec3::Y * 3.0, DVec3::X)
        };
        let scale = 12.0 / libm::tan(0.5);
        // the ball ends 2 m before its centre: 0.5 m are half a pixel at `scale` metres from there
        for (away, error_px, level) in [
            (2.0 + scale, 0.51, 3),
            (2.0 + scale, 0.49, 2),
            (2.0 + scale, 0.11, 2),
            (2.0 + scale, 0.09, 0),
            (2.0 + scale * 10.0, 0.051, 3),
            (2.0 + scale * 10.0, 0.009, 0),
            (1.99, 1e9, 0),
            (1e-3, 1e9, 0),
            (2.0 + scale, 0.0, 0),
        ] {
            for toward in [DVec3::Z, DVec3::Y, DVec3::new(0.6, 0.0, -0.8)] {
                let view = from(DVec3::Y * 3.0 + toward * away);
                assert_eq!(wood.pick(&view, &here(), error_px), level, "{away} m, {error_px}");
            }
        }
        // twice as large, seen from twice as far, is the same; so is a mirrored and moved one
        let grown = DAffine3::from_scale_rotation_translation(
            DVec3::new(-2.0, 2.0, 2.0),
            DQuat::from_rotation_z(0.4),
            DVec3::X * 100.0,
        );
        let center = grown.transform_point3(wood.center);
        let crown = made::crown_at(grown, 0);
        for (error_px, level) in [(0.51, 3), (0.49, 2), (0.09, 0)] {
            let eye = center + DVec3::Z * 2.0 * (2.0 + scale);
            let view = made::perspective(eye, center, DVec3::Y);
            assert_eq!(wood.pick(&view, &crown, error_px), level, "{error_px} of a large one");
        }
        // parallel: 24 pixels for 12 m, wherever it is
        for away in [1.0, 50.0] {
            let projection = Projection::Orthographic { height: 12.0 };
            let eye = DVec3::Z * away;
            let view = View::new(eye, DVec3::ZERO, DVec3::Y, projection, (24, 24), 1e-3);
            let view = view.expect("valid");
            for (error_px, level) in [(1.01, 3), (0.99, 2), (0.21, 2), (0.19, 0)] {
                assert_eq!(wood.pick(&view, &here(), error_px), level, "{error_px}, {away} m");
            }
        }
    }

    #[test]
    fn a_share_picks_the_nearest_count() {
        let wood = bare(&[100, 50, 20, 4], &[0.0, 0.1, 0.2, 0.3]);
        for (share, level) in [
            (1.0, 0),
            (0.76, 0),
            (0.75, 0),
            (0.74, 1),
            (0.36, 1),
            (0.35, 1),
            (0.34, 2),
            (0.13, 2),
            (0.11, 3),
            (0.0, 3),
        ] {
            assert_eq!(wood.pick_share(share), level, "{share}");
        }
        assert_eq!(bare(&[0], &[0.0]).pick_share(0.5), 0, "no wood");
    }

    #[test]
    fn hard_cases_have_a_level() {
        let views = made::cameras();
        let one = Mesh {
            triangles: vec![[0, 1, 5]],
            parts: Mesh::parts_from_ids(&[0]),
            ..tube(4, 2, 0.0)
        };
        let point = Mesh { positions: vec![Vec3::ONE; one.positions.len()], ..one.clone() };
        let cases = [
            ("no wood", Mesh::default(), Wood::Full, 0),
            ("left out", tube(8, 8, 0.1), Wood::None, 0),
            ("one triangle", one, Wood::Full, 1),
            ("no area", point, Wood::Full, 1),
            ("simplified", tube(8, 8, 0.1), Wood::Simplified(40), 40),
        ];
        for (name, mesh, wood, count) in cases {
            let wood = built(&plant_of(mesh, &[AlphaMode::Opaque]), wood);
            assert_eq!(wood.triangle_counts()[0], count, "{name}");
            assert_eq!(wood.bounds().is_some(), count > 0, "{name}");
            assert_eq!(wood.errors()[0], 0.0, "{name}");
            for (camera, view) in &views {
                let level = wood.pick(view, &here(), 1.0);
                let list = emitted(&wood, level, view, &[here()]);
                let drawn: usize = list.items.iter().map(|item| item.primitives.len()).sum();
                assert_eq!(drawn, wood.triangle_counts()[level], "{name}, {camera}");
            }
        }
        let plant = plant_of(tube(8, 8, 0.1), &[AlphaMode::Opaque]);
        let result =
            WoodLevels::build(&plant, Wood::Simplified(0), 1, &plant.materials, &Job::default());
        let error = result.expect_err("refused");
        assert!(error.to_string().starts_with("wood_triangle_count"), "{error}");
    }

    #[test]
    fn each_copy_has_its_level_and_blended_wood_keeps_its_order() {
        let mut mesh = tube(16, 40, 0.1);
        let ids: Vec<u32> =
            (0..mesh.triangles.len()).map(|t| u32::from(t / 200 % 2 == 0)).collect();
        mesh.parts = Mesh::parts_from_ids(&ids);
        let plant = plant_of(mesh, &[AlphaMode::Opaque, AlphaMode::Blend]);
        let wood = built(&plant, Wood::Full);
        let counts = wood.triangle_counts();
        assert!(counts.len() > 2, "{counts:?}");
        let view = made::perspective(DVec3::new(0.0, 5.0, 30.0), DVec3::Y * 5.0, DVec3::Y);
        let crowns: Vec<Crown> = (0..3_u8)
            .map(|rank| {
                let place = DVec3::Z * (f64::from(rank) * 5.0 - 10.0);
                made::crown_at(DAffine3::from_translation(place), u32::from(rank))
            })
            .collect();
        let level_of = |crown: &Crown| 2 - crown.rank as usize;
        let mut used = ViewState::default();
        for turn in 0..3 {
            let lists = [&mut ViewState::default(), &mut used].map(|state| {
                let mut builder = ListBuilder::default();
                wood.emit_each(&view, &crowns, level_of, state, &mut builder);
                let list = builder.finish();
                list.check().expect("consistent");
                list
            });
            let [list, again] = &lists;
            assert_eq!(list.items, again.items, "a fresh memory and a used one, turn {turn}");
            assert_eq!(list.own, again.own, "turn {turn}");
            let drawn: usize =
                list.items.iter().map(|i| i.primitives.len() * i.instances.len()).sum();
            assert_eq!(drawn, counts[0] + counts[1] + counts[2], "each copy once");
            let depths: Vec<f32> = list
                .items
                .iter()
                .filter(|item| item.blend == Blend::Over)
                .map(|item| list.instances[item.instances.start as usize].translation.z)
                .collect();
            assert!(depths.is_sorted(), "blended: far copies first, {depths:?}");
            let first = &list.items[0];
            let near = list.instances[first.instances.start as usize].translation.z;
            assert_eq!(near, -30.0, "opaque: the nearest first");
        }
    }

    /// Whether each pixel of a parallel view is covered; the picture shows all of the wood.
    fn silhouette(
        wood: &WoodLevels,
        level: usize,
        pixel_size: f64,
        toward: DVec3,
    ) -> (usize, Vec<bool>) {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below 4096")]
        let side = (wood.radius * 2.0 / pixel_size).ceil() as u32 + 4;
        let projection = Projection::Orthographic { height: f64::from(side) * pixel_size };
        let eye = wood.center + toward * 3.0 * wood.radius;
        let view = View::new(eye, wood.center, DVec3::Y, projection, (side, side), 1e-3);
        let view = view.expect("valid");
        let list = emitted(wood, level, &view, &[here()]);
        let settings = Settings {
            sample_count: 1,
            outputs: Outputs::COLOR,
            background: Vec4::ZERO,
            counts_fragments: false,
        };
        let frame = Renderer::default().render(&list, &view, &settings, &Job::default());
        let color = frame.expect("valid").color;
        (side as usize, color.iter().map(|color| color.w > 0.0).collect())
    }

    /// Pixels around which a square of `2 * reach + 1` is true.
    fn eroded(side: usize, pixels: &[bool], reach: usize) -> usize {
        let inner = reach..side - reach;
        let is_full = |x: usize, y: usize| {
            (y - reach..=y + reach).all(|row| {
                pixels[row * side + x - reach..=row * side + x + reach].iter().all(|&p| p)
            })
        };
        inner.clone().map(|y| inner.clone().filter(|&x| is_full(x, y)).count()).sum()
    }

    #[test]
    fn silhouettes_differ_by_no_more_than_the_error() {
        let plant = grow::grow("chestnut", 1, Some(1), Lighting::default(), &Job::default());
        let wood = built(&plant.expect("grown"), Wood::Full);
        // squares of 3 and of 5 pixels that show in one of two silhouettes alone
        let squares = |levels: [usize; 2], pixel_size: f64| {
            let [(side, fine), (_, coarse)] =
                levels.map(|level| silhouette(&wood, level, pixel_size, DVec3::Z));
            let differs: Vec<bool> = fine.iter().zip(&coarse).map(|(a, b)| a != b).collect();
            let covered = fine.iter().filter(|&&pixel| pixel).count();
            assert!(eroded(side, &fine, 2) > covered / 10, "a trunk is wider than that");
            (eroded(side, &differs, 1) as f64 / covered as f64, eroded(side, &differs, 2))
        };
        for level in 2..6 {
            // where it has just become fine enough for one pixel: from the finest and the next finer
            for before in [0, level - 1] {
                let (share, large) = squares([before, level], wood.errors()[level]);
                assert!(share < 1e-3, "{share} of the pixels, level {level} for {before}");
                assert_eq!(large, 0, "level {level} for {before}");
            }
        }
        let (share, large) = squares([0, 4], wood.errors()[4] / 4.0);
        assert!(share > 1e-3 && large > 0, "four times as near it shows: {share}, {large}");
    }
}
