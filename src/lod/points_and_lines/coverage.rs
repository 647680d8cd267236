//! Which splat factor makes points cover as much as the polygons they stand for.
//!
//! Polygons of a leaf do not overlap; splats thrown on it do. So splats of the polygons' total area
//! leave holes where a leaf is larger than a splat, and the more the nearer the view. How many depends
//! on how many points there are for each triangle, and hardly on the direction. That relation is
//! measured: for ever fewer points, in parallel views from several sides, the factor is searched by
//! bisection whose splats cover what the polygons cover.

use glam::{DAffine3, DVec3, Vec4};
use rayon::prelude::*;

use crate::draw_list::{Blend, DrawList, Instance, Item, Primitive, Surface};
use crate::error::LodError;
use crate::job::Job;
use crate::lod::points_and_lines::groups::Groups;
use crate::lod::points_and_lines::parts::{Class, Part};
use crate::lod::points_and_lines::selection::{needed_points, point_draw, whole};
use crate::lod::points_and_lines::{PairOrder, Surfaces};
use crate::raster::{Outputs, Renderer, Settings};
use crate::view::{Projection, View};

/// Pixels of a picture that is measured, each side.
const SIDE: u32 = 256;

/// Samples of such a picture.
const SAMPLE_COUNT: u32 = 4;

/// Steps of the bisection: the factor is found to 2 % of its size.
const STEP_COUNT: usize = 8;

/// Factors that are looked for.
const FACTORS: [f64; 2] = [0.25, 16.0];

/// Fewer points than this in all say nothing about others.
const MIN_POINT_COUNT: f64 = 48.0;

/// Points for a triangle where the table begins; half as many at each following row.
const MOST_POINTS: f64 = 2.0;

/// Splat factors by points drawn for each triangle.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FactorTable {
    /// Of 2 points for each triangle, 1, 1/2, and so on; empty without points.
    pub factors: Vec<f64>,
    /// Mean projected area of a triangle, in square metres, over all groups of points.
    pub triangle_area: f64,
}

impl FactorTable {
    /// The factor for so many points a triangle: between rows by the logarithm of their numbers.
    pub fn at(&self, points_per_triangle: f64) -> f64 {
        let [Some(&first), Some(&last)] = [self.factors.first(), self.factors.last()] else {
            return 1.0;
        };
        if points_per_triangle >= MOST_POINTS {
            return first;
        }
        let row = libm::log2(MOST_POINTS / points_per_triangle);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
        let fine = row as usize;
        match self.factors.get(fine..fine.saturating_add(2)) {
            Some(&[a, b]) => a + (b - a) * row.fract(),
            _ => last,
        }
    }

    /// The factor at a distance between samples, in metres where the points are and before importance
    /// divides it: what the plant's groups share, however they are weighed.
    pub fn at_spacing(&self, spacing: f64) -> f64 {
        self.at(self.triangle_area / (spacing * spacing))
    }

    /// Measures the points of a plant.
    ///
    /// # Errors
    /// [`LodError::Cancelled`].
    pub fn measured(
        groups: &Groups,
        parts: &[Part],
        surfaces: &Surfaces,
        pair_order: PairOrder,
        job: &Job,
    ) -> Result<Self, LodError> {
        let measuring = Measuring::new(groups, parts, surfaces, pair_order);
        let Some(measuring) = measuring else { return Ok(Self::default()) };
        let triangle_count: u32 = measuring.groups().map(|group| group.opaque_count).sum();
        let mut factors = Vec::new();
        let mut points = MOST_POINTS * f64::from(triangle_count);
        let wanted = measuring.covered_by_polygons(job)?;
        while factors.is_empty() || points >= MIN_POINT_COUNT {
            let [mut low, mut high] = FACTORS;
            for _ in 0..STEP_COUNT {
                let middle = (low * high).sqrt();
                if measuring.covered_by_points(points, middle, job)? < wanted {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            factors.push((low * high).sqrt());
            points /= 2.0;
        }
        let triangle_area = measuring.seen_area / f64::from(triangle_count);
        Ok(Self { factors, triangle_area })
    }
}

/// Parallel views of a plant's points.
struct Measuring<'a> {
    groups: &'a Groups,
    parts: &'a [Part],
    surfaces: &'a Surfaces,
    pair_order: PairOrder,
    views: Vec<View>,
    /// Mean projected area of all points' triangles, in square metres.
    seen_area: f64,
    pixel: f64,
}

impl<'a> Measuring<'a> {
    fn new(
        groups: &'a Groups,
        parts: &'a [Part],
        surfaces: &'a Surfaces,
        pair_order: PairOrder,
    ) -> Option<Self> {
        let of_points = || groups.groups.iter().filter(|group| group.opaque_count > 0);
        let seen_area: f64 = of_points().map(|group| group.seen_area).sum();
        let bounds = of_points().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), g| {
            (low.min(g.center - g.radius), high.max(g.center + g.radius))
        });
        let height = (bounds.1 - bounds.0).length();
        if seen_area <= 0.0 || !height.is_finite() {
            return None;
        }
        let center = (bounds.0 + bounds.1) * 0.5;
        let projection = Projection::Orthographic { height };
        let directions = [
            (DVec3::Z, DVec3::Y),
            (DVec3::X, DVec3::Y),
            (DVec3::new(1.0, 0.7, 1.0), DVec3::Y),
            (DVec3::new(1.0, -0.3, -1.0), DVec3::Y),
        ];
        let view = |(toward, up): (DVec3, DVec3)| {
            let eye = center + toward.normalize() * height * 2.0;
            View::new(eye, center, up, projection, (SIDE, SIDE), height * 1e-3)
        };
        let views: Option<Vec<View>> = directions.into_iter().map(|d| view(d).ok()).collect();
        let pixel = height / f64::from(SIDE);
        Some(Self { groups, parts, surfaces, pair_order, views: views?, seen_area, pixel })
    }

    fn groups(&self) -> impl Iterator<Item = &super::groups::Group> {
        self.groups.groups.iter().filter(|group| group.class == Class::Points)
    }

    fn covered_by_polygons(&self, job: &Job) -> Result<f64, LodError> {
        self.covered(job, |list| {
            let source = list.geometry(&self.groups.triangles);
            for group in self.groups() {
                let material = self.parts[group.part as usize].material;
                let (surface, blend) = self.surfaces.of(material, list);
                list.items.push(Item {
                    primitive: Primitive::Triangles,
                    vertices: source,
                    indices: source,
                    primitives: group.triangles.clone(),
                    instances: 0..1,
                    surface,
                    blend,
                    depth_write: blend != Blend::Over,
                    slab: None,
                });
            }
        })
    }

    /// What `count` points cover, spread over the groups as a view from afar spreads them.
    fn covered_by_points(&self, count: f64, factor: f64, job: &Job) -> Result<f64, LodError> {
        let sample = (self.seen_area / count).sqrt();
        self.covered(job, |list| {
            let source = list.geometry(&self.groups.points);
            for group in self.groups() {
                let own = sample / self.parts[group.part as usize].importance;
                let wanted = whole(needed_points(group.seen_area, 1.0, own), group.offset);
                let most = 2 * u64::from(group.opaque_count);
                let draw = point_draw(
                    wanted.min(most),
                    group.opaque_count,
                    group.sampling,
                    self.pair_order,
                );
                #[expect(clippy::cast_possible_truncation, reason = "pixels")]
                let size_px = (factor.sqrt() * own / self.pixel) as f32;
                for range in draw.points.iter().filter(|range| !range.is_empty()) {
                    let start = group.points.start;
                    list.items.push(Item {
                        primitive: Primitive::Points { size_px: size_px.max(f32::MIN_POSITIVE) },
                        vertices: source,
                        indices: source,
                        primitives: start + range.start..start + range.end,
                        instances: 0..1,
                        surface: Surface::VertexColor,
                        blend: Blend::Opaque,
                        depth_write: true,
                        slab: None,
                    });
                }
            }
        })
    }

    /// Mean coverage over all views.
    fn covered(&self, job: &Job, fill: impl Fn(&mut DrawList) + Sync) -> Result<f64, LodError> {
        let settings = Settings {
            sample_count: SAMPLE_COUNT,
            outputs: Outputs::COLOR_DEPTH,
            background: Vec4::ZERO,
            counts_fragments: false,
        };
        let sums: Result<Vec<f64>, LodError> = self
            .views
            .par_iter()
            .map(|view| {
                let mut list = DrawList::default();
                list.instance(Instance::new(&DAffine3::IDENTITY, view));
                fill(&mut list);
                let frame = Renderer::default().render(&list, view, &settings, job)?;
                Ok(frame.color.iter().map(|color| f64::from(color.w)).sum())
            })
            .collect();
        Ok(sums?.into_iter().sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factors_lie_between_rows() {
        let table = FactorTable { factors: vec![2.0, 1.5, 1.0], triangle_area: 4.0 };
        let cases = [(9.0, 2.0), (2.0, 2.0), (1.0, 1.5), (0.5, 1.0), (0.1, 1.0), (0.0, 1.0)];
        for (points, factor) in cases {
            assert_eq!(table.at(points), factor, "{points} points a triangle");
        }
        let between = table.at(std::f64::consts::SQRT_2);
        assert!((between - 1.75).abs() < 1e-12, "half way by the logarithm: {between}");
        assert_eq!(table.at_spacing(2.0), 1.5, "4 square metres are one sample of 2 by 2");
        assert_eq!(FactorTable::default().at(1.0), 1.0, "no points, no factor");
    }
}
