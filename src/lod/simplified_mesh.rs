//! Simplified mesh: what a general simplifier makes of loose leaves, to compare techniques with.
//!
//! meshoptimizer simplifies the foliage to a count of triangles, each material by itself to its share.
//! The simplifier knows surfaces and not leaves: leaves it cannot merge it shrinks to single triangles
//! and then drops. Vertices stay, with their textures and light. Wood is as in every technique.

use glam::DVec3;

use crate::draw_list::Buffers;
use crate::error::{LodError, check_in};
use crate::job::Job;
use crate::lod::simplify::{self, Method, Simplifier};
use crate::lod::solid::Solid;
use crate::lod::wood::Wood;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture, Representation};
use crate::plant::{Mesh, Part, Plant};
use crate::texture::Filter;
use crate::view::View;
use crate::view_state::ViewState;

/// Largest weight of an attribute.
pub const MAX_WEIGHT: f32 = 1e6;

/// How many triangles the foliage is to have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// So many.
    Triangles(usize),
    /// This share of those it has, in (0, 1].
    Share(f64),
}

/// How the foliage is simplified.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Params {
    /// Where it ends.
    pub target: Target,
    /// By what.
    pub method: Method,
    /// Where it ends earlier: meshoptimizer's error over the largest side of the foliage's box.
    pub target_error_rel: Option<f64>,
    /// The wood that is drawn.
    pub wood: Wood,
    /// How textures are read.
    pub filter: Filter,
}

/// The technique's representation of a plant.
#[derive(Debug)]
pub struct SimplifiedMesh {
    solid: Solid,
    bounds: (DVec3, DVec3),
    origin: DVec3,
    triangle_count: usize,
    error: f64,
}

impl SimplifiedMesh {
    /// Simplifies a plant's foliage.
    ///
    /// # Errors
    /// `foliage` without triangles; an argument out of range; [`LodError::Cancelled`].
    pub fn build(plant: &Plant, params: &Params, job: &Job) -> Result<Self, LodError> {
        check(params)?;
        let leaves = &plant.foliage.mesh;
        let Some((low, high)) = leaves.bounds() else {
            let why = "this technique needs leaves; choose them with foliage=";
            return Err(LodError::Empty { name: "foliage", why });
        };
        let wood = params.wood.of(plant)?;
        let largest_side = f64::from((high - low).max_element());
        let max_error = params.target_error_rel.map_or(f64::INFINITY, |rel| rel * largest_side);
        let total = leaves.triangles.len();
        let target = params.target.count(total);
        let groups = simplify::by_material(leaves);
        let simplifier = Simplifier::new(leaves);
        job.begin(groups.len() as u64);
        let mut mesh = Mesh { triangles: Vec::new(), parts: Vec::new(), ..leaves.clone() };
        let mut error: f64 = 0.0;
        for (material, triangles) in groups {
            let share = simplify::share(target, triangles.len(), total);
            let found = simplifier.simplify(&triangles, share, max_error, params.method, job)?;
            error = error.max(found.error);
            let start = u32::try_from(mesh.triangles.len()).expect("fewer than before");
            mesh.triangles.extend(found.triangles);
            let end = u32::try_from(mesh.triangles.len()).expect("fewer than before");
            if end > start {
                mesh.parts.push(Part { material, triangles: start..end });
            }
            job.advance();
        }
        let mesh = mesh.without_unused_vertices();
        let wood_count = u32::try_from(plant.wood.triangles.len()).expect("checked by the plant");
        let meshes =
            [(&wood, Buffers::ids_from(0, &wood)), (&mesh, Buffers::ids_from(wood_count, &mesh))];
        let solid = Solid::new(&meshes, &plant.materials, params.filter, job)?;
        // of the leaves as they were: what is left of them is never outside
        let boxes = [wood.bounds(), Some((low, high))].into_iter().flatten();
        let bounds = boxes
            .map(|(low, high)| (low.as_dvec3(), high.as_dvec3()))
            .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
            .expect("the leaves have one");
        let triangle_count = mesh.triangles.len();
        Ok(Self { solid, bounds, origin: plant.origin, triangle_count, error })
    }

    /// Triangles that are left of the foliage.
    pub fn triangle_count(&self) -> usize {
        self.triangle_count
    }

    /// The largest of the materials' errors, in metres, as meshoptimizer states it.
    pub fn error(&self) -> f64 {
        self.error
    }
}

impl Target {
    fn count(self, total: usize) -> usize {
        match self {
            Self::Triangles(count) => count,
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a share of a count"
            )]
            Self::Share(fraction) => ((total as f64 * fraction).round() as usize).max(1),
        }
    }
}

fn check(params: &Params) -> Result<(), LodError> {
    match params.target {
        Target::Triangles(count) => check_in("triangle_count", count, 1..=usize::MAX)?,
        Target::Share(fraction) if fraction > 0.0 && fraction <= 1.0 => {}
        Target::Share(fraction) => {
            let (value, range) = (fraction.to_string(), "(0, 1]".to_owned());
            return Err(LodError::OutOfRange { name: "keep_fraction", value, range });
        }
    }
    if let Some(rel) = params.target_error_rel {
        check_in("target_error_rel", rel, 0.0..=1.0)?;
    }
    if let Method::Attributes { normal_weight, uv_weight, .. } = params.method {
        check_in("normal_weight", normal_weight, 0.0..=MAX_WEIGHT)?;
        check_in("uv_weight", uv_weight, 0.0..=MAX_WEIGHT)?;
    }
    Ok(())
}

impl Representation for SimplifiedMesh {
    fn bounds(&self) -> (DVec3, DVec3) {
        self.bounds
    }

    fn origin(&self) -> DVec3 {
        self.origin
    }

    fn footprint(&self) -> Footprint {
        self.solid.footprint()
    }

    fn textures(&self) -> Vec<NamedTexture> {
        self.solid.textures()
    }

    fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) -> Result<(), LodError> {
        self.solid.emit(view, crowns, state, builder);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, Vec3};

    use super::*;
    use crate::draw_list::Source;
    use crate::lod::made::{self, Leaf, facing};
    use crate::lod::simplify::EdgeOptions;

    const METHODS: [Method; 3] = [
        Method::Edges(EdgeOptions { prune: true, lock_border: false }),
        Method::Attributes {
            options: EdgeOptions { prune: false, lock_border: false },
            normal_weight: 0.5,
            uv_weight: 1.0,
        },
        Method::Sloppy,
    ];

    fn params(target: Target, method: Method) -> Params {
        Params {
            target,
            method,
            target_error_rel: None,
            wood: Wood::Full,
            filter: Filter::Bilinear,
        }
    }

    fn built(plant: &Plant, params: &Params) -> SimplifiedMesh {
        SimplifiedMesh::build(plant, params, &Job::default()).expect("valid")
    }

    /// A row of squares of the given half sides, two metres apart.
    fn row(halves: &[f32]) -> Vec<Leaf> {
        let places = (0_u8..).map(|index| f32::from(index) * 2.0);
        places.zip(halves).map(|(x, &half)| facing(x, 0.0, 0.0, half)).collect()
    }

    /// Corners of what is drawn, triangle by triangle.
    fn triangles(lod: &SimplifiedMesh) -> Vec<[Vec3; 3]> {
        let view = made::parallel(DVec3::Z, DVec3::Y, 40.0, 16);
        let list = made::emit(lod, &view, &[made::crown_at(DAffine3::IDENTITY, 0)]);
        let item_triangles = list.items.iter().flat_map(|item| {
            assert!(matches!(item.indices, Source::Shared(0)), "of the one geometry");
            let buffers = list.indices_of(item);
            item.primitives.clone().map(|triangle| {
                [0, 1, 2].map(|corner| {
                    let index = buffers.indices[triangle as usize * 3 + corner];
                    buffers.positions[index as usize]
                })
            })
        });
        item_triangles.collect()
    }

    #[test]
    fn leaves_shrink_to_a_triangle_and_the_small_ones_go_first() {
        // 8 triangles in 4 loose squares, of which the first two are small
        let plant = made::plant(&row(&[0.1, 0.2, 0.4, 0.8]));
        let left = |count: usize| {
            let mut lost = vec![0; 4];
            let lod = built(&plant, &params(Target::Triangles(count), METHODS[0]));
            assert_eq!(lod.triangle_count(), count, "reached");
            for corners in triangles(&lod) {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "places are 0, 2, 4 and 6"
                )]
                let leaf = ((corners[0].x + 1.0) / 2.0) as usize;
                lost[leaf] += 1;
            }
            lost
        };
        // a triangle of a square that is gone takes the other one with it, not a larger square's
        assert_eq!(left(8), [2, 2, 2, 2], "all of it");
        assert_eq!(left(7), [1, 2, 2, 2], "half of the smallest");
        assert_eq!(left(4), [0, 0, 2, 2], "the smallest are gone");
        assert_eq!(left(1), [0, 0, 0, 1], "half of the largest");
    }

    #[test]
    fn each_material_keeps_its_share() {
        let mut leaves = made::quads(&row(&[0.5; 20]));
        let ids: Vec<u32> = (0..40).map(|triangle| u32::from(triangle % 10 == 0)).collect();
        leaves.parts = Mesh::parts_from_ids(&ids);
        let made = made::plant(&row(&[0.5; 20]));
        let offsets: Vec<u32> = (0..=20).map(|leaf| leaf * 2).collect();
        let plant = Plant::new(
            "two materials".to_owned(),
            DVec3::ZERO,
            vec![made.materials[0].clone(), made.materials[0].clone()],
            Mesh::default(),
            leaves,
            offsets,
            made.lighting,
            &Job::default(),
        )
        .expect("valid");
        // 36 triangles of one material and 4 of the other
        for (count, shares) in [(40, 36 + 4), (20, 18 + 2), (10, 9 + 1), (5, 5 + 1)] {
            let lod = built(&plant, &params(Target::Triangles(count), METHODS[0]));
            assert_eq!(lod.triangle_count(), shares, "{count}: shares are rounded up");
        }
        let list = made::emit(
            &built(&plant, &params(Target::Triangles(10), METHODS[0])),
            &made::parallel(DVec3::Z, DVec3::Y, 40.0, 16),
            &[made::crown_at(DAffine3::IDENTITY, 0)],
        );
        let counts: Vec<usize> = list.items.iter().map(|item| item.primitives.len()).collect();
        assert_eq!(counts, [9, 1], "one item a material");
    }

    #[test]
    fn a_share_is_a_count() {
        let plant = made::plant(&made::random_crown(50));
        for (fraction, count) in [(1.0, 100), (0.5, 50), (0.014, 1), (1e-9, 1)] {
            let share = built(&plant, &params(Target::Share(fraction), METHODS[0]));
            assert_eq!(share.triangle_count(), count, "{fraction} of 100");
            let stated = built(&plant, &params(Target::Triangles(count), METHODS[0]));
            assert_eq!(triangles(&share), triangles(&stated), "{fraction}");
        }
        let all = built(&plant, &params(Target::Triangles(usize::MAX), METHODS[2]));
        assert_eq!((all.triangle_count(), all.error()), (100, 0.0), "as they are");
    }

    #[test]
    fn an_error_stops_before_the_count() {
        let plant = made::plant(&made::random_crown(200));
        let mut last = (usize::MAX, 0.0);
        for rel in [0.0, 0.02, 0.04, 1.0] {
            let stopped =
                Params { target_error_rel: Some(rel), ..params(Target::Triangles(10), METHODS[0]) };
            let lod = built(&plant, &stopped);
            let (low, high) = plant.foliage.mesh.bounds().expect("leaves");
            let allowed = rel * f64::from((high - low).max_element());
            assert!(lod.error() <= allowed * (1.0 + 1e-6), "{} of {allowed} m", lod.error());
            assert!(lod.triangle_count() <= last.0, "a larger error leaves fewer: {rel}");
            assert!(lod.error() >= last.1, "errors rise: {rel}");
            last = (lod.triangle_count(), lod.error());
        }
        assert_eq!(last.0, 10, "in the end the count stops");
    }

    #[test]
    fn awkward_leaves_have_a_picture_by_every_method() {
        for (name, leaves) in made::crowns() {
            let plant = made::plant(&leaves);
            let (low, high) = plant.foliage.mesh.bounds().expect("leaves");
            for method in METHODS {
                for count in [1, 2, leaves.len(), leaves.len() * 2] {
                    let lod = built(&plant, &params(Target::Triangles(count), method));
                    // edges of equal leaves, or of leaves without area, may have to stay
                    let stops = method != Method::Sloppy && name != "random";
                    let most = if stops { leaves.len() * 2 } else { count };
                    assert!(lod.triangle_count() <= most, "{name}, {method:?}, {count}");
                    assert!(lod.error().is_finite(), "{name}, {method:?}, {count}");
                    for corner in triangles(&lod).into_iter().flatten() {
                        assert!(corner.cmpge(low).all() && corner.cmple(high).all(), "{name}");
                    }
                    for (camera, view) in made::cameras() {
                        let frame = made::draw(&lod, &view);
                        let finite = frame.color.iter().all(|color| color.is_finite());
                        assert!(finite, "{name} {camera}, {method:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn wood_is_as_in_every_technique_and_ids_follow_it() {
        let wood = [facing(0.0, -3.0, 0.0, 1.0)];
        let plant = made::plant_at(DVec3::X * 7.0, &wood, &row(&[0.5; 4]));
        for (wood, count) in [(Wood::None, 0), (Wood::Full, 2), (Wood::Simplified(1), 1)] {
            let lod = built(&plant, &Params { wood, ..params(Target::Triangles(4), METHODS[0]) });
            assert_eq!(lod.footprint().triangle_count, count + 4, "{wood:?}");
            assert_eq!(lod.origin(), plant.origin, "where its file put it");
            let bottom = if count > 0 { -4.0 } else { -0.5 };
            assert_eq!(lod.bounds().0.y, bottom, "of what is drawn: {wood:?}");
            let view = made::parallel(DVec3::Z, DVec3::Y, 40.0, 16);
            let list = made::emit(&lod, &view, &[made::crown_at(DAffine3::IDENTITY, 0)]);
            let ids = &list.geometries[0].buffers().source_ids;
            assert_eq!(ids[ids.len() - 4..], [2, 3, 4, 5], "foliage after all wood");
        }
    }

    #[test]
    fn bad_arguments_are_refused_by_name() {
        let plant = made::plant(&row(&[0.5; 4]));
        let good = params(Target::Share(0.5), METHODS[0]);
        let attributes = |normal_weight: f32, uv_weight: f32| Method::Attributes {
            options: EdgeOptions { prune: true, lock_border: false },
            normal_weight,
            uv_weight,
        };
        let bad = [
            ("triangle_count", Params { target: Target::Triangles(0), ..good }),
            ("keep_fraction", Params { target: Target::Share(0.0), ..good }),
            ("keep_fraction", Params { target: Target::Share(1.1), ..good }),
            ("keep_fraction", Params { target: Target::Share(f64::NAN), ..good }),
            ("target_error_rel", Params { target_error_rel: Some(-1e-9), ..good }),
            ("target_error_rel", Params { target_error_rel: Some(f64::NAN), ..good }),
            ("normal_weight", Params { method: attributes(f32::NAN, 1.0), ..good }),
            ("uv_weight", Params { method: attributes(1.0, -1.0), ..good }),
            ("wood_triangle_count", Params { wood: Wood::Simplified(0), ..good }),
        ];
        for (name, params) in bad {
            let error = SimplifiedMesh::build(&plant, &params, &Job::default()).expect_err(name);
            assert!(error.to_string().starts_with(name), "{name}: {error}");
        }
        let bare = made::plant_at(DVec3::ZERO, &[facing(0.0, 0.0, 0.0, 1.0)], &[]);
        let error = SimplifiedMesh::build(&bare, &good, &Job::default()).expect_err("no leaves");
        assert!(error.to_string().starts_with("foliage"), "{error}");
        let job = Job::default();
        job.cancel();
        let result = SimplifiedMesh::build(&plant, &good, &job).map(|lod| lod.triangle_count());
        assert_eq!(result, Err(LodError::Cancelled), "stopped");
    }
}
