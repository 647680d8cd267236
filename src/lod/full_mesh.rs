//! The plant as it is: the reference, and the technique that every other one has to beat.

use glam::DVec3;

use crate::draw_list::Buffers;
use crate::error::LodError;
use crate::job::Job;
use crate::lod::solid::Solid;
use crate::lod::wood::Wood;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture, Representation};
use crate::plant::{Mesh, Plant};
use crate::texture::Filter;
use crate::view::View;
use crate::view_state::ViewState;

/// Every triangle of the foliage, with the wood as asked for.
#[derive(Debug)]
pub struct FullMesh {
    solid: Solid,
    bounds: (DVec3, DVec3),
    origin: DVec3,
}

impl FullMesh {
    /// Takes the plant's triangles over; textures are read with `filter`.
    ///
    /// # Errors
    /// `wood_triangle_count` of 0; [`LodError::Empty`] if nothing is left to draw;
    /// [`LodError::Cancelled`].
    pub fn build(plant: &Plant, wood: Wood, filter: Filter, job: &Job) -> Result<Self, LodError> {
        let mesh = wood.of(plant)?;
        let wood_count = u32::try_from(plant.wood.triangles.len()).expect("checked by the plant");
        let leaves = &plant.foliage.mesh;
        if mesh.is_empty() && leaves.is_empty() {
            let why = "without wood there is nothing to draw";
            return Err(LodError::Empty { name: "foliage", why });
        }
        let meshes =
            [(&mesh, Buffers::ids_from(0, &mesh)), (leaves, Buffers::ids_from(wood_count, leaves))];
        let solid = Solid::new(&meshes, &plant.materials, filter, job)?;
        // of what is drawn: without its wood a plant is smaller
        let boxes = [&mesh, leaves].into_iter().filter_map(Mesh::bounds);
        let bounds = boxes
            .map(|(low, high)| (low.as_dvec3(), high.as_dvec3()))
            .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
            .expect("one of the two has a triangle");
        Ok(Self { solid, bounds, origin: plant.origin })
    }
}

impl Representation for FullMesh {
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
