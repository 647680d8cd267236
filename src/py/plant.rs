//! Plants for Python: built from arrays and dicts of plain facts, and read back as arrays.

use std::sync::Arc;

use glam::{DVec3, Vec2, Vec3, Vec4};
use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyReadonlyArray3, PyUntypedArrayMethods, ToPyArray,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{matrix, rows, slice};
use super::run::run;
use super::structure::{StructureArrays, structure_arrays};
use crate::error::{LodError, check_finite};
use crate::plant::leaf_rectangle::leaf_rectangles;
use crate::plant::split::{Tally, split};
use crate::plant::{self as core, AlphaMode, Lighting, Material, Mesh, normals};
use crate::texture::{Filter, Image, Sampler, Texture, Wrap};

/// Wood, foliage and materials, lit once. Immutable, and shared by everything built from it.
#[pyclass(frozen, module = "treelod._core")]
pub(super) struct Plant {
    /// What the kernels take.
    pub(super) inner: Arc<core::Plant>,
}

impl From<core::Plant> for Plant {
    fn from(plant: core::Plant) -> Self {
        Self { inner: Arc::new(plant) }
    }
}

/// A material as Python states it.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct MaterialFacts<'py> {
    name: String,
    texture: Option<PyReadonlyArray3<'py, u8>>,
    wrap: (String, String),
    alpha_mode: String,
    alpha_cutoff: f32,
    double_sided: bool,
}

/// Arrays of one mesh as Python states them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct MeshArrays<'py> {
    positions: PyReadonlyArray2<'py, f32>,
    normals: PyReadonlyArray2<'py, f32>,
    uvs: PyReadonlyArray2<'py, f32>,
    colors: PyReadonlyArray2<'py, f32>,
    triangles: PyReadonlyArray2<'py, u32>,
    material_ids: PyReadonlyArray1<'py, u32>,
}

/// Lighting as Python states it.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct LightingFacts {
    sun_direction: [f64; 3],
    sun: [f64; 3],
    sky: [f64; 3],
    ground: [f64; 3],
    translucency: f64,
    occlusion: f64,
}

impl From<LightingFacts> for Lighting {
    fn from(facts: LightingFacts) -> Self {
        Self {
            sun_direction: facts.sun_direction.into(),
            sun: facts.sun.into(),
            sky: facts.sky.into(),
            ground: facts.ground.into(),
            translucency: facts.translucency,
            occlusion: facts.occlusion,
        }
    }
}

/// Materials from facts; those that share an array share the texture.
pub(super) fn materials_from(facts: &[MaterialFacts<'_>]) -> PyResult<Vec<Material>> {
    let mut made: Vec<(&PyReadonlyArray3<'_, u8>, Arc<Texture>)> = Vec::new();
    facts
        .iter()
        .map(|facts| {
            let texture = match &facts.texture {
                None => None,
                Some(array) => match made.iter().find(|(other, _)| other.is(array.as_any())) {
                    Some((_, texture)) => Some(Arc::clone(texture)),
                    None => {
                        made.push((array, texture_from(array)?));
                        made.last().map(|(_, texture)| Arc::clone(texture))
                    }
                },
            };
            facts.material(texture)
        })
        .collect()
}

impl MaterialFacts<'_> {
    fn material(&self, texture: Option<Arc<Texture>>) -> PyResult<Material> {
        let alpha_mode = match self.alpha_mode.as_str() {
            "opaque" => AlphaMode::Opaque,
            "mask" => AlphaMode::Mask { cutoff: self.alpha_cutoff },
            "blend" => AlphaMode::Blend,
            other => {
                let text = format!("alpha_mode must be 'opaque', 'mask' or 'blend', got {other:?}");
                return Err(PyValueError::new_err(text));
            }
        };
        let wrap = [wrap_from(&self.wrap.0)?, wrap_from(&self.wrap.1)?];
        Ok(Material {
            name: self.name.clone(),
            texture,
            sampler: Sampler { wrap, filter: Filter::default() },
            alpha_mode,
            double_sided: self.double_sided,
        })
    }
}

impl MeshArrays<'_> {
    fn mesh(&self) -> PyResult<Mesh> {
        let material_ids = slice("material_ids", &self.material_ids)?;
        let triangles: Vec<[u32; 3]> = rows("triangles", &self.triangles)?;
        if material_ids.len() != triangles.len() {
            let text = format!(
                "material_ids has {} rows for {} triangles",
                material_ids.len(),
                triangles.len()
            );
            return Err(PyValueError::new_err(text));
        }
        Ok(Mesh {
            positions: rows("positions", &self.positions)?,
            normals: rows("normals", &self.normals)?,
            uvs: rows("uvs", &self.uvs)?,
            base: rows("colors", &self.colors)?,
            front: Vec::new(),
            back: Vec::new(),
            triangles,
            parts: Mesh::parts_from_ids(material_ids),
        })
    }
}

#[pymethods]
impl Plant {
    #[new]
    #[pyo3(signature = (
        name, origin, materials, wood, foliage, leaf_offsets, lighting, structure=None
    ))]
    #[expect(clippy::too_many_arguments, reason = "called from one place, by its Python face")]
    fn new(
        py: Python<'_>,
        name: String,
        origin: [f64; 3],
        materials: Vec<MaterialFacts<'_>>,
        wood: MeshArrays<'_>,
        foliage: MeshArrays<'_>,
        leaf_offsets: PyReadonlyArray1<'_, u32>,
        lighting: LightingFacts,
        structure: Option<StructureArrays<'_>>,
    ) -> PyResult<Self> {
        let materials = materials_from(&materials)?;
        let structure = structure.map(|arrays| arrays.structure()).transpose()?;
        let (wood, foliage) = (wood.mesh()?, foliage.mesh()?);
        let leaf_offsets = slice("leaf_offsets", &leaf_offsets)?.to_vec();
        let lighting = Lighting::from(lighting);
        let plant = run(py, None, None, move |job| {
            let origin = DVec3::from(origin);
            let (count, leaf_count) = (wood.triangles.len(), leaf_offsets.len().saturating_sub(1));
            if let Some(structure) = &structure {
                structure.check(count, leaf_count)?;
            }
            let mut plant = core::Plant::new(
                name,
                origin,
                materials,
                wood,
                foliage,
                leaf_offsets,
                lighting,
                job,
            )?;
            plant.structure = structure.map(Arc::new);
            Ok(plant)
        })?;
        Ok(plant.into())
    }

    /// The same plant under other light.
    #[pyo3(signature = (lighting, *, threads=None, progress=None))]
    fn lit(
        &self,
        py: Python<'_>,
        lighting: LightingFacts,
        threads: Option<usize>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let lighting = lighting.into();
        Ok(run(py, threads, progress, |job| self.inner.lit(lighting, job))?.into())
    }

    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    #[getter]
    fn origin(&self) -> [f64; 3] {
        self.inner.origin.to_array()
    }

    #[getter]
    fn triangle_count(&self) -> usize {
        self.inner.triangle_count()
    }

    /// Lowest and highest corner of the box around the plant, in world coordinates.
    #[getter]
    fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let (low, high) = self.inner.bounds();
        (low.to_array(), high.to_array())
    }

    /// Centre of the box around the plant and largest distance of a used vertex from it.
    #[getter]
    fn sphere(&self) -> ([f64; 3], f64) {
        let (center, radius) = self.inner.sphere();
        (center.to_array(), radius)
    }

    /// A dict of what the lighting was made from.
    #[getter]
    fn lighting<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let Lighting { sun_direction, sun, sky, ground, translucency, occlusion } =
            self.inner.lighting;
        let facts = PyDict::new(py);
        facts.set_item("sun_direction", sun_direction.to_array())?;
        facts.set_item("sun", sun.to_array())?;
        facts.set_item("sky", sky.to_array())?;
        facts.set_item("ground", ground.to_array())?;
        facts.set_item("translucency", translucency)?;
        facts.set_item("occlusion", occlusion)?;
        Ok(facts)
    }

    /// One dict a material, as the constructor takes them: materials that share a texture share
    /// its array.
    #[getter]
    fn materials<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let mut made: Vec<(&Arc<Texture>, Bound<'py, PyArray3<u8>>)> = Vec::new();
        self.inner
            .materials
            .iter()
            .map(|material| {
                let texels = match &material.texture {
                    None => None,
                    Some(texture) => {
                        Some(match made.iter().find(|(t, _)| Arc::ptr_eq(t, texture)) {
                            Some((_, array)) => array.clone(),
                            None => {
                                made.push((texture, texels(py, texture)?));
                                made[made.len() - 1].1.clone()
                            }
                        })
                    }
                };
                material_facts(py, material, texels)
            })
            .collect()
    }

    /// How it branches, as the constructor takes it, or None.
    #[getter]
    fn structure<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        self.inner.structure.as_ref().map(|known| structure_arrays(py, known)).transpose()
    }

    /// Arrays of the wood.
    #[getter]
    fn wood<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        mesh_arrays(py, &self.inner.wood)
    }

    /// Arrays of the foliage's mesh.
    #[getter]
    fn foliage<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        mesh_arrays(py, &self.inner.foliage.mesh)
    }

    /// Offsets, centres, normals and areas of the leaves.
    #[getter]
    fn leaves<'py>(&self, py: Python<'py>) -> PyResult<LeafArrays<'py>> {
        let foliage = &self.inner.foliage;
        Ok((
            foliage.leaf_offsets.to_pyarray(py),
            matrix::<f32, Vec3>(py, &foliage.centers)?,
            matrix::<f32, Vec3>(py, &foliage.normals)?,
            foliage.areas.to_pyarray(py),
        ))
    }

    /// Corners of the leaves' smallest rectangles, of shape (L, 4, 3).
    fn leaf_rectangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let corners = run(py, None, None, |job| {
            let rectangles = leaf_rectangles(&self.inner.foliage, job)?;
            job.collect(rectangles.len(), |leaf| rectangles[leaf].corners())
        })?;
        matrix::<f64, [DVec3; 4]>(py, &corners)?.reshape([corners.len(), 4, 3])
    }
}

type LeafArrays<'py> = (
    Bound<'py, PyArray1<u32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<f32>>,
);

/// Material index, reason, pieces, triangles: why how much of a material became what it is.
type TallyRow = (u32, &'static str, u32, u32);

/// A plant from one mesh, told apart into wood and leaves, and the reasons.
///
/// `foliage_mask[t]` says whether triangle `t` is foliage; without it the rules decide.
#[pyfunction]
pub(super) fn split_plant(
    py: Python<'_>,
    name: String,
    origin: [f64; 3],
    materials: Vec<MaterialFacts<'_>>,
    mesh: MeshArrays<'_>,
    foliage_mask: Option<PyReadonlyArray1<'_, bool>>,
    lighting: LightingFacts,
) -> PyResult<(Plant, Vec<TallyRow>)> {
    let materials = materials_from(&materials)?;
    let mut mesh = mesh.mesh()?;
    let mask = foliage_mask.as_ref().map(|mask| slice("foliage_mask", mask)).transpose()?;
    let lighting = Lighting::from(lighting);
    let (plant, tallies) = run(py, None, None, move |job| {
        mesh.front.resize(mesh.positions.len(), Vec3::ZERO);
        mesh.back.resize(mesh.positions.len(), Vec3::ZERO);
        let parts = split(&mesh, &materials, mask, job)?;
        drop(mesh);
        let (wood, leaves, offsets) = (parts.wood, parts.leaves, parts.leaf_offsets);
        let origin = DVec3::from(origin);
        let plant =
            core::Plant::new(name, origin, materials, wood, leaves, offsets, lighting, job)?;
        Ok((plant, parts.tallies))
    })?;
    let row = |t: Tally| (t.material, t.reason.name(), t.piece_count, t.triangle_count);
    Ok((plant.into(), tallies.into_iter().map(row).collect()))
}

/// Area-weighted vertex normals, smooth across vertices at the same position.
#[pyfunction]
pub(super) fn smooth_normals<'py>(
    py: Python<'py>,
    positions: PyReadonlyArray2<'py, f32>,
    triangles: PyReadonlyArray2<'py, u32>,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let positions: Vec<Vec3> = rows("positions", &positions)?;
    let triangles: Vec<[u32; 3]> = rows("triangles", &triangles)?;
    let normals = run(py, None, None, move |_| {
        check_finite("positions", &positions)?;
        normals::smooth(&positions, &triangles)
    })?;
    matrix(py, &normals)
}

fn texture_from(texels: &PyReadonlyArray3<'_, u8>) -> PyResult<Arc<Texture>> {
    let &[height, width, channels] = texels.shape() else { unreachable!("three dimensions") };
    if channels != 4 {
        let text =
            format!("texture must have shape (H, W, 4), got ({height}, {width}, {channels})");
        return Err(PyValueError::new_err(text));
    }
    let side = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
    crate::texture::texture::check_size("texture", side(width), side(height))?;
    let texels = bytemuck::cast_slice::<u8, [u8; 4]>(texels.as_slice()?).to_vec();
    Ok(Texture::new(vec![Image::new(side(width), side(height), texels)?])?)
}

fn wrap_from(name: &str) -> Result<Wrap, LodError> {
    match name {
        "repeat" => Ok(Wrap::Repeat),
        "mirror" => Ok(Wrap::Mirror),
        "clamp" => Ok(Wrap::Clamp),
        other => Err(LodError::Invalid {
            name: "wrap",
            why: format!("must be 'repeat', 'mirror' or 'clamp', got {other:?}"),
        }),
    }
}

fn wrap_name(wrap: Wrap) -> &'static str {
    match wrap {
        Wrap::Repeat => "repeat",
        Wrap::Mirror => "mirror",
        Wrap::Clamp => "clamp",
    }
}

fn material_facts<'py>(
    py: Python<'py>,
    material: &Material,
    texture: Option<Bound<'py, PyArray3<u8>>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (alpha_mode, cutoff) = match material.alpha_mode {
        AlphaMode::Opaque => ("opaque", 0.5),
        AlphaMode::Mask { cutoff } => ("mask", cutoff),
        AlphaMode::Blend => ("blend", 0.5),
    };
    let [u, v] = material.sampler.wrap.map(wrap_name);
    let facts = PyDict::new(py);
    facts.set_item("name", &material.name)?;
    facts.set_item("texture", texture)?;
    facts.set_item("wrap", (u, v))?;
    facts.set_item("alpha_mode", alpha_mode)?;
    facts.set_item("alpha_cutoff", cutoff)?;
    facts.set_item("double_sided", material.double_sided)?;
    Ok(facts)
}

fn texels<'py>(py: Python<'py>, texture: &Texture) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let image = &texture.levels()[0];
    let size = [image.height as usize, image.width as usize, 4];
    PyArray1::from_slice(py, bytemuck::cast_slice::<[u8; 4], u8>(&image.texels)).reshape(size)
}

fn mesh_arrays<'py>(py: Python<'py>, mesh: &Mesh) -> PyResult<Bound<'py, PyDict>> {
    let material_ids: Vec<u32> = mesh.triangle_materials().collect();
    let arrays = PyDict::new(py);
    arrays.set_item("positions", matrix::<f32, Vec3>(py, &mesh.positions)?)?;
    arrays.set_item("normals", matrix::<f32, Vec3>(py, &mesh.normals)?)?;
    arrays.set_item("uvs", matrix::<f32, Vec2>(py, &mesh.uvs)?)?;
    arrays.set_item("base", matrix::<f32, Vec4>(py, &mesh.base)?)?;
    arrays.set_item("front", matrix::<f32, Vec3>(py, &mesh.front)?)?;
    arrays.set_item("back", matrix::<f32, Vec3>(py, &mesh.back)?)?;
    arrays.set_item("triangles", matrix::<u32, [u32; 3]>(py, &mesh.triangles)?)?;
    arrays.set_item("material_ids", material_ids.to_pyarray(py))?;
    Ok(arrays)
}
