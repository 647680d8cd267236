//! The leaves that a technique bakes: where they lie in their crown, and how they are drawn.
//!
//! Every baker of leaves draws them the same way: opaque and alpha-tested triangles near to far, so
//! that what they hide needs no alpha test, then the blended ones far to near.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3, Vec3};
use rayon::prelude::*;

use crate::draw_list::{
    Blend, Buffers, DrawList, Geometry, Instance, Item, Primitive, Source, Surface,
};
use crate::error::LodError;
use crate::lod::solid::blend_of;
use crate::plant::{Mesh, Plant};
use crate::view::View;

/// A crown is flat along a direction where it is thinner than this share of its radius.
pub(crate) const FLAT: f64 = 1e-6;

/// A crown smaller than this, in metres, is baked as if it were as large: a point needs a rectangle.
pub(crate) const LEAST_SIZE: f64 = 1e-6;

/// A leaf in a bake.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Placed {
    pub(crate) leaf: usize,
    /// Whether only the part inside the bake's slab is drawn.
    pub(crate) cut: bool,
}

/// A plant's leaves, with positions relative to the crown's centre in f64.
#[derive(Clone)]
pub(crate) struct Leaves<'a> {
    pub(crate) plant: &'a Plant,
    /// Which of the plant's leaves these are; `None` for all.
    numbers: Option<Arc<[usize]>>,
    /// The plant's own, unless leaves have been turned.
    mesh: Cow<'a, Mesh>,
    geometry: Arc<Geometry>,
    /// Middle of the box of leaf centres, relative to the plant's origin.
    pub(crate) center: DVec3,
    /// Largest distance of a leaf's vertex from the centre.
    pub(crate) radius: f64,
    /// Leaf centres relative to `center`.
    pub(crate) leaf_centers: Vec<DVec3>,
    /// Material of each triangle.
    pub(crate) materials: Arc<[u32]>,
}

impl<'a> Leaves<'a> {
    pub(crate) fn new(plant: &'a Plant) -> Result<Self, LodError> {
        let foliage = &plant.foliage;
        let Some(&first) = foliage.centers.first() else { return Err(Self::missing()) };
        let spread = |(low, high): (Vec3, Vec3), &p: &Vec3| (low.min(p), high.max(p));
        let (low, high) = foliage.centers.iter().fold((first, first), spread);
        let center = (low.as_dvec3() + high.as_dvec3()) * 0.5;
        let mut leaves = Self {
            plant,
            numbers: None,
            mesh: Cow::Borrowed(&foliage.mesh),
            geometry: Geometry::new(Buffers::from_mesh(
                &foliage.mesh,
                Buffers::ids_from(0, &foliage.mesh),
            )),
            center,
            radius: 0.0,
            leaf_centers: foliage.centers.iter().map(|p| p.as_dvec3() - center).collect(),
            materials: foliage.mesh.triangle_materials().collect(),
        };
        leaves.radius = leaves.largest_distance();
        Ok(leaves)
    }

    /// What is wrong with a plant that has none.
    pub(crate) fn missing() -> LodError {
        let why = "this technique needs leaves; choose them with foliage=";
        LodError::Empty { name: "foliage", why }
    }

    /// Of a vertex from the centre.
    fn largest_distance(&self) -> f64 {
        (0..self.leaf_centers.len())
            .into_par_iter()
            .map(|leaf| self.vertices_of(leaf).map(DVec3::length).fold(0.0, f64::max))
            .reduce(|| 0.0, f64::max)
    }

    /// Some of these leaves, at least one, as a crown of their own with its own centre and radius.
    pub(crate) fn chosen(&self, chosen: &[usize]) -> Self {
        assert!(!chosen.is_empty(), "a crown has leaves");
        let center_of = |&leaf: &usize| self.leaf_centers[leaf] + self.center;
        let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let spread = |(low, high): (DVec3, DVec3), p: DVec3| (low.min(p), high.max(p));
        let (low, high) = chosen.iter().map(center_of).fold(none, spread);
        let center = (low + high) * 0.5;
        let mut leaves = Self {
            numbers: Some(chosen.iter().map(|&leaf| self.number(leaf)).collect()),
            center,
            leaf_centers: chosen.iter().map(|leaf| center_of(leaf) - center).collect(),
            plant: self.plant,
            mesh: self.mesh.clone(),
            geometry: Arc::clone(&self.geometry),
            radius: 0.0,
            materials: Arc::clone(&self.materials),
        };
        leaves.radius = leaves.largest_distance();
        leaves
    }

    /// Index of a leaf among the plant's.
    pub(crate) fn number(&self, leaf: usize) -> usize {
        self.numbers.as_ref().map_or(leaf, |numbers| numbers[leaf])
    }

    /// A leaf's triangles among the foliage's.
    pub(crate) fn triangles_of(&self, leaf: usize) -> Range<usize> {
        self.plant.foliage.triangles_of(self.number(leaf))
    }

    /// A leaf's vertices, some of them several times.
    pub(crate) fn vertices_of(&self, leaf: usize) -> impl Iterator<Item = DVec3> {
        let triangles = self.triangles_of(leaf);
        triangles.flat_map(|t| self.mesh.corners(t)).map(|p| p.as_dvec3() - self.center)
    }

    /// The same leaves, each turned about its centre.
    pub(crate) fn turned(&self, turn_of: impl Fn(usize) -> DMat3) -> Self {
        let mut mesh = Mesh { triangles: Vec::new(), ..Mesh::default() };
        mesh.parts.clone_from(&self.mesh.parts);
        // where a vertex went, and for which leaf: leaves may share it
        let mut moved = vec![(usize::MAX, 0_u32); self.mesh.positions.len()];
        for (leaf, &center) in self.leaf_centers.iter().enumerate() {
            let turn = turn_of(leaf);
            let center = center + self.center;
            for triangle in self.triangles_of(leaf) {
                let corners = self.mesh.triangles[triangle].map(|vertex| {
                    let from = vertex as usize;
                    if moved[from].0 != leaf {
                        let next = u32::try_from(mesh.positions.len()).expect("as many as corners");
                        moved[from] = (leaf, next);
                        let offset = self.mesh.positions[from].as_dvec3() - center;
                        mesh.positions.push((center + turn * offset).as_vec3());
                        let normal = self.mesh.normals[from].as_dvec3();
                        mesh.normals.push((turn * normal).as_vec3());
                        mesh.uvs.push(self.mesh.uvs[from]);
                        mesh.base.push(self.mesh.base[from]);
                        mesh.front.push(self.mesh.front[from]);
                        mesh.back.push(self.mesh.back[from]);
                    }
                    moved[from].1
                });
                mesh.triangles.push(corners);
            }
        }
        let geometry = Geometry::new(Buffers::from_mesh(&mesh, Buffers::ids_from(0, &mesh)));
        Self { mesh: Cow::Owned(mesh), geometry, ..self.clone() }
    }

    /// Mean lit colour of a leaf as seen from a direction, over the area seen from there.
    pub(crate) fn mean_lit(&self, leaf: usize, toward: DVec3) -> Vec3 {
        let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
        for triangle in self.triangles_of(leaf) {
            let [a, b, c] = self.mesh.corners(triangle).map(|p| p.as_dvec3());
            let weight = (b - a).cross(c - a).dot(toward);
            let side = if weight < 0.0 { &self.mesh.back } else { &self.mesh.front };
            let lit: Vec3 = self.mesh.triangles[triangle].iter().map(|&v| side[v as usize]).sum();
            sum += lit.as_dvec3() * (weight.abs() / 3.0);
            weights += weight.abs();
        }
        if weights > 0.0 { (sum / weights).as_vec3() } else { Vec3::ZERO }
    }

    /// Smallest and largest offset of a leaf's vertices along a direction.
    pub(crate) fn extent(&self, leaf: usize, direction: DVec3) -> (f64, f64) {
        let offsets = self.vertices_of(leaf).map(|p| p.dot(direction));
        offsets
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)))
    }

    /// The list that draws some leaves for a bake; cut ones only between the slab's depths.
    pub(crate) fn list(&self, view: &View, leaves: &[Placed], slab: [f32; 2]) -> DrawList {
        struct Drawn {
            triangle: usize,
            cut: bool,
            blended: bool,
            /// By how near to the viewer.
            rank: i64,
            /// Among those that were given.
            place: usize,
        }
        let mesh = &self.mesh;
        let material_of = |t: usize| &self.plant.materials[self.materials[t] as usize];
        let mut drawn: Vec<Drawn> = leaves
            .iter()
            .flat_map(|&Placed { leaf, cut }| {
                self.triangles_of(leaf).map(move |triangle| (triangle, cut))
            })
            .enumerate()
            .map(|(place, (triangle, cut))| {
                let blended = blend_of(material_of(triangle)) == Blend::Over;
                let corners = mesh.corners(triangle);
                let height: f64 = corners.iter().map(|p| p.as_dvec3().dot(view.back)).sum();
                // in the order of `total_cmp`
                let bits = height.to_bits().cast_signed();
                let upwards = bits ^ ((bits >> 63).cast_unsigned() >> 1).cast_signed();
                let rank = if blended { upwards } else { !upwards };
                Drawn { triangle, cut, blended, rank, place }
            })
            .collect();
        // blended triangles after the others and far to near; the others near to far, so that what
        // they hide needs no alpha test
        drawn.sort_unstable_by_key(|drawn| (drawn.blended, drawn.rank, drawn.place));
        let mut list = DrawList::default();
        let source = list.geometry(&self.geometry);
        let instances = list.instance(Instance::new(&DAffine3::IDENTITY, view));
        let alike = |a: &Drawn, b: &Drawn| {
            (self.materials[a.triangle], a.cut) == (self.materials[b.triangle], b.cut)
        };
        for run in drawn.chunk_by(alike) {
            let material = material_of(run[0].triangle);
            let blend = blend_of(material);
            let own = &mut list.own.buffers.indices;
            let start = u32::try_from(own.len() / 3).expect("fits in u32");
            let corners = &self.geometry.buffers().indices;
            own.extend(run.iter().flat_map(|d| &corners[d.triangle * 3..d.triangle * 3 + 3]));
            let end = u32::try_from(own.len() / 3).expect("fits in u32");
            let surface = material.texture.as_ref().map_or(Surface::VertexColor, |texture| {
                Surface::Textured { texture: list.texture(texture), sampler: material.sampler }
            });
            list.items.push(Item {
                primitive: Primitive::Triangles,
                vertices: source,
                indices: Source::Own,
                primitives: start..end,
                instances: instances.clone(),
                surface,
                blend,
                depth_write: blend != Blend::Over,
                slab: run[0].cut.then_some(slab),
            });
        }
        list
    }
}
