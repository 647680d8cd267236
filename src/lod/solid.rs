//! Triangles drawn as they are: the full mesh, and the part of other techniques that stays a mesh.
//!
//! Opaque and alpha-tested triangles are drawn for all copies at once. Blended ones come after them,
//! far to near by centroid, copy by copy.

use std::ops::Range;
use std::sync::Arc;

use glam::DVec3;

use crate::draw_list::{Blend, Buffers, DrawList, Geometry, Item, Primitive, Source, Surface};
use crate::error::LodError;
use crate::job::Job;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture};
use crate::plant::{AlphaMode, Material, Mesh};
use crate::texture::mips::{self, Keep};
use crate::texture::{Filter, Sampler, Texture};
use crate::view::View;
use crate::view_state::ViewState;

/// Consecutive triangles of one material.
#[derive(Debug, Clone)]
struct Run {
    material: u32,
    triangles: Range<u32>,
}

/// Triangles with their materials.
#[derive(Debug, Clone)]
pub struct Solid {
    geometry: Arc<Geometry>,
    materials: Vec<Material>,
    runs: Vec<Run>,
    /// Material and centroid of each blended triangle, by triangle index.
    blended: Vec<(u32, u32, DVec3)>,
}

/// How a material's fragments join the picture.
pub fn blend_of(material: &Material) -> Blend {
    match material.alpha_mode {
        AlphaMode::Opaque => Blend::Opaque,
        AlphaMode::Mask { cutoff } => Blend::Test(cutoff),
        AlphaMode::Blend => Blend::Over,
    }
}

/// A texture ready to be read: decoded ahead, and with the levels that its blend and the filter ask
/// for. Materials that share a texture keep sharing it.
fn prepare(
    texture: &Arc<Texture>,
    blend: Blend,
    filter: Filter,
    prepared: &mut Vec<(u64, Blend, Arc<Texture>)>,
    job: &Job,
) -> Result<Arc<Texture>, LodError> {
    job.check()?;
    let known = prepared.iter().find(|known| known.0 == texture.id() && known.1 == blend);
    if let Some((_, _, known)) = known {
        return Ok(Arc::clone(known));
    }
    let ready = if filter == Filter::Trilinear {
        let keep = match blend {
            Blend::Test(cutoff) => Keep::Coverage { cutoff },
            Blend::Opaque | Blend::Coverage | Blend::Over => Keep::MeanAlpha,
        };
        let mut levels = mips::levels(texture.levels()[0].clone(), keep, &|| job.check())?;
        if let Keep::Coverage { cutoff } = keep {
            mips::drop_levels_without_coverage(&mut levels, cutoff);
        }
        Texture::new(levels).expect("levels that halve")
    } else {
        Arc::clone(texture)
    };
    let ready = ready.decoded_ahead();
    let ready = if matches!(blend, Blend::Test(_)) { ready.bounded() } else { ready };
    prepared.push((texture.id(), blend, Arc::clone(&ready)));
    Ok(ready)
}

/// Materials whose textures are ready to be read with a filter.
///
/// # Errors
/// [`LodError::Cancelled`].
pub(crate) fn ready_to_draw(
    materials: &[Material],
    filter: Filter,
    job: &Job,
) -> Result<Vec<Material>, LodError> {
    let mut prepared: Vec<(u64, Blend, Arc<Texture>)> = Vec::new();
    let ready = materials.iter().map(|material| {
        let mut ready = |texture| prepare(texture, blend_of(material), filter, &mut prepared, job);
        Ok(Material {
            sampler: Sampler { filter, ..material.sampler },
            texture: material.texture.as_ref().map(&mut ready).transpose()?,
            ..material.clone()
        })
    });
    ready.collect()
}

/// What a material looks like in a draw list.
pub(crate) fn surface_of(material: &Material, list: &mut DrawList) -> Surface {
    material.texture.as_ref().map_or(Surface::VertexColor, |texture| Surface::Textured {
        texture: list.texture(texture),
        sampler: material.sampler,
    })
}

/// The textures of some of the materials, each once, in their order.
pub(crate) fn textures_of(
    materials: &[Material],
    indices: impl Iterator<Item = u32>,
) -> Vec<NamedTexture> {
    let mut named: Vec<NamedTexture> = Vec::new();
    for index in indices {
        let material = &materials[index as usize];
        if let Some(texture) = &material.texture
            && !named.iter().any(|known| known.texture.id() == texture.id())
        {
            let (name, texture) = (material.name.clone(), Arc::clone(texture));
            named.push(NamedTexture { name, texture, rect: None });
        }
    }
    named
}

impl Solid {
    /// Takes meshes over, in order, each with the ids of its triangles.
    ///
    /// # Errors
    /// [`LodError::Cancelled`].
    pub fn new(
        meshes: &[(&Mesh, Vec<u32>)],
        materials: &[Material],
        filter: Filter,
        job: &Job,
    ) -> Result<Self, LodError> {
        Ok(Self::of_ready(meshes, ready_to_draw(materials, filter, job)?))
    }

    /// The same with materials that are ready to be drawn.
    pub(crate) fn of_ready(meshes: &[(&Mesh, Vec<u32>)], materials: Vec<Material>) -> Self {
        let mut buffers = Buffers::default();
        let mut runs: Vec<Run> = Vec::new();
        let mut blended = Vec::new();
        for (mesh, ids) in meshes {
            let first_vertex =
                u32::try_from(buffers.positions.len()).expect("checked by the plant");
            let first_triangle =
                u32::try_from(buffers.indices.len() / 3).expect("checked by the plant");
            for part in &mesh.parts {
                let range =
                    part.triangles.start + first_triangle..part.triangles.end + first_triangle;
                if blend_of(&materials[part.material as usize]) == Blend::Over {
                    blended.extend(part.triangles.clone().map(|triangle| {
                        let corners = mesh.corners(triangle as usize).map(|p| p.as_dvec3());
                        let centroid = corners.iter().sum::<DVec3>() / 3.0;
                        (triangle + first_triangle, part.material, centroid)
                    }));
                } else {
                    runs.push(Run { material: part.material, triangles: range });
                }
            }
            buffers.append(Buffers::from_mesh(mesh, ids.clone()), first_vertex);
        }
        Self { geometry: Geometry::new(buffers), materials, runs, blended }
    }

    /// Cuts it into several that share its geometry: the first one ends before triangle `ends[0]`, the
    /// second before `ends[1]`, and so on. No run of a material may reach across.
    #[must_use]
    pub fn cut(&self, ends: &[u32]) -> Vec<Self> {
        let mut start = 0;
        let cut = ends.iter().map(|&end| {
            let range = start..end;
            start = end;
            let inside = |run: &&Run| run.triangles.start < end && run.triangles.end > range.start;
            let runs: Vec<Run> = self.runs.iter().filter(inside).cloned().collect();
            let is_whole =
                |run: &Run| run.triangles.start >= range.start && run.triangles.end <= end;
            assert!(runs.iter().all(is_whole), "a run reaches across a cut");
            let blended = self.blended.iter().filter(|(triangle, _, _)| range.contains(triangle));
            Self { runs, blended: blended.copied().collect(), ..self.clone() }
        });
        cut.collect()
    }

    /// Whether there is nothing to draw.
    pub fn is_empty(&self) -> bool {
        self.runs.is_empty() && self.blended.is_empty()
    }

    /// Triangles, and the bytes of their vertices, indices and textures.
    pub fn footprint(&self) -> Footprint {
        let textures = self.textures();
        Footprint {
            triangle_count: (self.geometry.buffers().indices.len() / 3) as u64,
            geometry_bytes: self.geometry.buffers().byte_count(),
            texture_bytes: textures.iter().map(|named| named.texture.byte_count()).sum(),
            ..Footprint::default()
        }
    }

    /// The textures that its triangles use, each once.
    pub fn textures(&self) -> Vec<NamedTexture> {
        let used = self.runs.iter().map(|run| run.material);
        let mut indices: Vec<u32> =
            used.chain(self.blended.iter().map(|&(_, material, _)| material)).collect();
        indices.sort_unstable();
        indices.dedup();
        textures_of(&self.materials, indices.into_iter())
    }

    /// Appends the triangles for every copy.
    pub fn emit(
        &self,
        view: &View,
        crowns: &[Crown],
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) {
        if self.is_empty() || crowns.is_empty() {
            return;
        }
        let source = builder.list.geometry(&self.geometry);
        let start = u32::try_from(builder.list.instances.len()).expect("under 2^32 instances");
        // near copies first, so that they hide what lies behind them
        builder.list.instances.extend(crowns.iter().rev().map(|crown| crown.instance(view)));
        let end = u32::try_from(builder.list.instances.len()).expect("under 2^32 instances");
        for run in &self.runs {
            let item = self.item(builder, source, run.material, run.triangles.clone(), start..end);
            builder.list.items.push(item);
        }
        for (crown, instance) in crowns.iter().zip((start..end).rev()) {
            self.emit_blended(view, crown, instance, source, state, builder);
        }
    }

    fn emit_blended(
        &self,
        view: &View,
        crown: &Crown,
        instance: u32,
        source: Source,
        state: &mut ViewState,
        builder: &mut ListBuilder,
    ) {
        if self.blended.is_empty() {
            return;
        }
        // the last frame's order is nearly this one's, which a stable sort finishes quickly
        let order: &mut Vec<u32> = state.slot(crown.key);
        let count = u32::try_from(self.blended.len()).expect("triangles fit in u32");
        if order.len() != self.blended.len() {
            *order = (0..count).collect();
        }
        let distance = |index: u32| {
            let world = crown.world_from_local.transform_point3(self.blended[index as usize].2);
            if view.is_orthographic() {
                view.view_from_world(world).z
            } else {
                world.distance_squared(view.eye)
            }
        };
        order.sort_by(|&a, &b| distance(b).total_cmp(&distance(a)).then(a.cmp(&b)));
        let shared = self.geometry.buffers();
        let material_of = |index: u32| self.blended[index as usize].1;
        for run in order.chunk_by(|&a, &b| material_of(a) == material_of(b)) {
            let own = &mut builder.list.own;
            let start = u32::try_from(own.buffers.indices.len() / 3).expect("fits in u32");
            for &index in run {
                let triangle = self.blended[index as usize].0 as usize;
                let corners = &shared.indices[triangle * 3..triangle * 3 + 3];
                own.buffers.indices.extend_from_slice(corners);
                own.buffers.source_ids.push(shared.source_ids[triangle]);
            }
            let end = start + u32::try_from(run.len()).expect("fits in u32");
            own.dirty_indices.push(start * 3..end * 3);
            let instances = instance..instance + 1;
            let item = self.item(builder, source, material_of(run[0]), start..end, instances);
            builder.push_blended(crown, Item { indices: Source::Own, ..item });
        }
    }

    fn item(
        &self,
        builder: &mut ListBuilder,
        source: Source,
        material: u32,
        primitives: Range<u32>,
        instances: Range<u32>,
    ) -> Item {
        let material = &self.materials[material as usize];
        let blend = blend_of(material);
        let surface = surface_of(material, &mut builder.list);
        Item {
            primitive: Primitive::Triangles,
            vertices: source,
            indices: source,
            primitives,
            instances,
            surface,
            blend,
            depth_write: blend != Blend::Over,
            slab: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, Vec2, Vec3, Vec4};

    use super::*;
    use crate::texture::Image;
    use crate::view::Projection;

    fn material(alpha_mode: AlphaMode, texture: Option<&Arc<Texture>>) -> Material {
        Material {
            name: "m".to_owned(),
            texture: texture.cloned(),
            sampler: Sampler::default(),
            alpha_mode,
            double_sided: false,
        }
    }

    /// A triangle around each point of the z axis, with a material each.
    fn stack(heights: &[f32], material_ids: &[u32]) -> Mesh {
        let positions: Vec<Vec3> = heights
            .iter()
            .flat_map(|&z| {
                [Vec3::X, Vec3::Y, -Vec3::ONE].map(|p| p * 0.1 + Vec3::Z * (z + 0.1 / 3.0))
            })
            .collect();
        let count = u32::try_from(positions.len()).expect("few");
        Mesh {
            normals: vec![Vec3::Z; positions.len()],
            uvs: vec![Vec2::ZERO; positions.len()],
            base: vec![Vec4::ONE; positions.len()],
            front: vec![Vec3::ONE; positions.len()],
            back: vec![Vec3::ONE; positions.len()],
            triangles: (0..count).step_by(3).map(|v| [v, v + 1, v + 2]).collect(),
            parts: Mesh::parts_from_ids(material_ids),
            positions,
        }
    }

    fn view(eye: DVec3, projection: Projection) -> View {
        View::new(eye, DVec3::ZERO, DVec3::Y, projection, (8, 8), 1e-3).expect("valid")
    }

    fn crowns(places: &[f64]) -> Vec<Crown> {
        (0..)
            .zip(places)
            .map(|(rank, &z)| {
                let world_from_local = DAffine3::from_translation(DVec3::Z * z);
                Crown { rank, key: (0, rank), ..Crown::alone(world_from_local) }
            })
            .collect()
    }

    fn emit(solid: &Solid, view: &View, crowns: &[Crown], state: &mut ViewState) -> DrawList {
        let mut builder = ListBuilder::default();
        solid.emit(view, crowns, state, &mut builder);
        let list = builder.finish();
        list.check().expect("consistent");
        list
    }

    /// World depths of a list's blended triangles, in paint order.
    fn blended_ids(list: &DrawList) -> Vec<(u32, f32)> {
        let over = list.items.iter().filter(|item| item.blend == Blend::Over);
        over.flat_map(|item| {
            let z = list.instances[item.instances.start as usize].translation.z;
            item.primitives.clone().map(move |p| (list.own.buffers.source_ids[p as usize], z))
        })
        .collect()
    }

    const MODES: [AlphaMode; 3] =
        [AlphaMode::Opaque, AlphaMode::Mask { cutoff: 0.25 }, AlphaMode::Blend];

    fn solid() -> Solid {
        // opaque, tested, and two blended materials in turn: 2 and 3
        let mesh = stack(&[5.0, 0.0, 2.0, -1.0, 1.0, 2.0], &[0, 1, 2, 3, 2, 2]);
        let blended = material(AlphaMode::Blend, None);
        let materials =
            [material(MODES[0], None), material(MODES[1], None), blended.clone(), blended];
        Solid::new(
            &[(&mesh, vec![10, 11, 12, 13, 14, 15])],
            &materials,
            Filter::Trilinear,
            &Job::default(),
        )
        .expect("not cancelled")
    }

    #[test]
    fn blended_triangles_go_far_to_near_after_the_others() {
        let solid = solid();
        let parallel = Projection::Orthographic { height: 4.0 };
        for projection in [Projection::Perspective { fov_y: 1.0 }, parallel] {
            let order = |eye: f64| {
                let view = view(DVec3::Z * eye, projection);
                let list = emit(&solid, &view, &crowns(&[0.0]), &mut ViewState::default());
                let kinds: Vec<Blend> = list.items.iter().map(|item| item.blend).collect();
                assert_eq!(kinds[..2], [Blend::Opaque, Blend::Test(0.25)], "first");
                assert!(list.items.iter().all(|i| i.depth_write == (i.blend != Blend::Over)), "z");
                blended_ids(&list).into_iter().map(|(id, _)| id).collect::<Vec<_>>()
            };
            assert_eq!(order(9.0), [13, 14, 12, 15], "from the front; equals by index");
            assert_eq!(order(-9.0), [12, 15, 14, 13], "from behind");
        }
    }

    #[test]
    fn a_fresh_memory_and_a_used_one_give_the_same_list() {
        let solid = solid();
        let mut used = ViewState::default();
        let placed = crowns(&[-3.0, 0.5]);
        for step in 0..20 {
            let angle = f64::from(step) * 0.5;
            let eye = DVec3::new(libm::sin(angle), 0.2, libm::cos(angle)) * 9.0;
            let view = view(eye, Projection::Perspective { fov_y: 1.0 });
            let fresh = emit(&solid, &view, &placed, &mut ViewState::default());
            let again = emit(&solid, &view, &placed, &mut used);
            assert_eq!(fresh.items, again.items, "step {step}");
            assert_eq!(fresh.own, again.own, "step {step}");
            assert_eq!(fresh.instances, again.instances, "step {step}");
        }
        // from +x all lie equally far, whatever was nearer from +z
        let parallel = Projection::Orthographic { height: 4.0 };
        let [_, aside] = [DVec3::Z, DVec3::X].map(|eye| {
            let view = view(eye * 9.0, parallel);
            (
                emit(&solid, &view, &placed, &mut ViewState::default()),
                emit(&solid, &view, &placed, &mut used),
            )
        });
        assert_eq!(aside.0.own, aside.1.own, "ties by index");
        let ids: Vec<u32> = blended_ids(&aside.0).into_iter().map(|(id, _)| id).collect();
        assert_eq!(ids, [12, 13, 14, 15, 12, 13, 14, 15], "in the order of the plant");
        // a memory of another plant's
        used.slot::<Vec<u32>>((0, 0)).truncate(2);
        *used.slot::<String>((0, 1)) = "of another kind".to_owned();
        let view = view(DVec3::Z * 9.0, Projection::Perspective { fov_y: 1.0 });
        let fresh = emit(&solid, &view, &placed, &mut ViewState::default());
        assert_eq!(fresh.own, emit(&solid, &view, &placed, &mut used).own, "from a wrong one");
    }

    #[test]
    fn copies_share_opaque_items_and_are_blended_one_by_one() {
        let solid = solid();
        let view = view(DVec3::Z * 30.0, Projection::Perspective { fov_y: 1.0 });
        let list = emit(&solid, &view, &crowns(&[-8.0, 0.0, 8.0]), &mut ViewState::default());
        assert_eq!(list.items[0].instances, 0..3, "one item for all copies");
        let depths: Vec<f32> = list.instances.iter().map(|i| i.translation.z).collect();
        assert_eq!(depths, [-22.0, -30.0, -38.0], "near ones first, which hide the others");
        let expected: Vec<(u32, f32)> = [-38.0, -30.0, -22.0]
            .into_iter()
            .flat_map(|z| [13, 14, 12, 15].map(|id| (id, z)))
            .collect();
        assert_eq!(blended_ids(&list), expected, "far copies first");
        assert!(emit(&solid, &view, &[], &mut ViewState::default()).items.is_empty(), "no copy");
        let nothing = Solid::of_ready(&[], Vec::new());
        let list = emit(&nothing, &view, &crowns(&[0.0]), &mut ViewState::default());
        assert!(list.items.is_empty() && list.instances.is_empty(), "no triangle");
    }

    #[test]
    fn meshes_are_joined_and_counted() {
        let texture = Texture::new(vec![Image::new(1, 1, vec![[9; 4]]).expect("valid")]);
        let texture = texture.expect("valid");
        let materials = [
            material(MODES[0], Some(&texture)),
            material(MODES[1], Some(&texture)),
            material(MODES[2], None),
        ];
        let (one, two) = (stack(&[1.0], &[0]), stack(&[2.0, 3.0], &[1, 2]));
        let meshes = [(&one, vec![7]), (&two, vec![20, 3])];
        let solid = Solid::new(&meshes, &materials, Filter::Nearest, &Job::default());
        let solid = solid.expect("not cancelled");
        let footprint = solid.footprint();
        assert_eq!(footprint.triangle_count, 3, "one and two");
        // 9 vertices of 4 vectors of 3, one of 2 and one of 4 floats; 9 indices
        assert_eq!(footprint.geometry_bytes, 9 * (4 * 3 + 2 + 4) * 4 + 9 * 4, "bytes");
        assert_eq!(footprint.texture_bytes, 4, "one texel, counted once");
        assert_eq!(solid.textures().len(), 1, "named once");
        let view = view(DVec3::Z * 9.0, Projection::Perspective { fov_y: 1.0 });
        let list = emit(&solid, &view, &crowns(&[0.0]), &mut ViewState::default());
        let buffers = list.geometries[0].buffers();
        assert_eq!(buffers.indices, (0..9).collect::<Vec<u32>>(), "vertices follow on");
        assert_eq!(buffers.source_ids, [7, 20, 3], "ids as given");
        assert_eq!(blended_ids(&list), [(3, -9.0)], "and kept when sorted");
        let filters: Vec<Filter> = list
            .items
            .iter()
            .filter_map(|item| match item.surface {
                Surface::Textured { sampler, .. } => Some(sampler.filter),
                Surface::VertexColor | Surface::Indirect { .. } | Surface::Parallax { .. } => None,
            })
            .collect();
        assert_eq!(filters, [Filter::Nearest; 2], "read as asked for");
    }
}
