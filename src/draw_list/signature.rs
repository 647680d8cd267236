//! Do two draw lists draw the same things, wherever those stand and however they are faded?
//!
//! A signature holds what changes in jumps when the camera moves: which primitives of which buffers, in
//! which order, with which surface and blend. Left out is what may change at every step without a jump:
//! transforms, tints, fades, sizes in pixels, and the vertices of a frame's own buffers. Identity is that of
//! ids, so signatures can only be compared within a process.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::mem::discriminant;

use crate::draw_list::{Blend, DrawList, Item, Primitive, Source, Surface};

/// What one item draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ItemSignature {
    /// Kind of primitive, in the words of a footprint.
    pub kind: &'static str,
    /// Primitives, copies counted.
    pub count: u64,
    /// Equal where the same is drawn in the same way.
    pub key: u64,
}

impl DrawList {
    /// What is drawn, item by item in paint order.
    pub fn signature(&self) -> Vec<ItemSignature> {
        self.items.iter().map(|item| self.item_signature(item)).collect()
    }

    fn item_signature(&self, item: &Item) -> ItemSignature {
        let mut hasher = DefaultHasher::new();
        let copies = item.instances.end.saturating_sub(item.instances.start);
        let primitives = item.primitives.end.saturating_sub(item.primitives.start);
        discriminant(&item.primitive).hash(&mut hasher);
        self.source_id(item.vertices).hash(&mut hasher);
        self.source_id(item.indices).hash(&mut hasher);
        if item.indices == Source::Own {
            // where a frame's own indices begin depends on what else it draws
            let own = &self.own.buffers;
            let range = item.primitives.start as usize..item.primitives.end as usize;
            let step = item.primitive.index_count();
            own.indices.get(range.start * step..range.end * step).hash(&mut hasher);
            own.source_ids.get(range).hash(&mut hasher);
        } else {
            item.primitives.hash(&mut hasher);
        }
        copies.hash(&mut hasher);
        match item.surface {
            Surface::VertexColor => 0_u64.hash(&mut hasher),
            Surface::Textured { texture, .. } => {
                self.textures[texture as usize].id().hash(&mut hasher);
            }
            Surface::Indirect { distribution, leaves, .. } => {
                self.distributions[distribution as usize].id().hash(&mut hasher);
                self.textures[leaves as usize].id().hash(&mut hasher);
            }
            Surface::Parallax { frames, .. } => {
                self.frames[frames as usize].id().hash(&mut hasher);
            }
        }
        discriminant(&item.surface).hash(&mut hasher);
        discriminant(&item.blend).hash(&mut hasher);
        if let Blend::Test(cutoff) = item.blend {
            cutoff.to_bits().hash(&mut hasher);
        }
        item.depth_write.hash(&mut hasher);
        item.slab.is_some().hash(&mut hasher);
        ItemSignature {
            kind: match item.primitive {
                Primitive::Triangles => "triangles",
                Primitive::Cards => "cards",
                Primitive::Lines { .. } => "lines",
                Primitive::Points { .. } => "points",
            },
            count: u64::from(primitives) * u64::from(copies),
            key: hasher.finish(),
        }
    }

    fn source_id(&self, source: Source) -> Option<u64> {
        match source {
            Source::Shared(index) => Some(self.geometries[index as usize].id()),
            Source::Own => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{Mat3, Vec3, Vec4};

    use super::*;
    use crate::draw_list::{Buffers, Geometry, Instance};

    fn buffers(triangles: usize) -> Buffers {
        Buffers {
            positions: vec![Vec3::ZERO; 3 * triangles],
            indices: (0..).take(3 * triangles).collect(),
            ..Buffers::default()
        }
    }

    fn instance() -> Instance {
        Instance {
            linear: Mat3::IDENTITY,
            translation: Vec3::ZERO,
            tint: Vec4::ONE,
            fade: 1.0,
            seed: 0,
            params: [0.0; 8],
        }
    }

    /// One item of 4 shared triangles and one of 2 of the frame's own.
    fn list(geometry: &Arc<Geometry>) -> DrawList {
        let mut list = DrawList::default();
        let shared = list.geometry(geometry);
        list.instance(instance());
        list.own.buffers = buffers(2);
        for (source, primitives) in [(shared, 0..4), (Source::Own, 0..2)] {
            list.items.push(Item {
                primitive: Primitive::Triangles,
                vertices: source,
                indices: source,
                primitives,
                instances: 0..1,
                surface: Surface::VertexColor,
                blend: Blend::Opaque,
                depth_write: true,
                slab: None,
            });
        }
        list
    }

    #[test]
    fn tells_kind_and_count_in_paint_order() {
        let geometry = Geometry::new(buffers(4));
        let mut list = list(&geometry);
        list.items[1].primitive = Primitive::Points { size_px: 2.0 };
        list.items[1].primitives = 0..6;
        list.instance(instance());
        list.items[0].instances = 0..2;
        let told: Vec<_> = list.signature().iter().map(|item| (item.kind, item.count)).collect();
        assert_eq!(told, [("triangles", 8), ("points", 6)], "4 triangles twice, 6 points");
    }

    #[test]
    fn what_moves_without_a_jump_leaves_it_as_it_is() {
        let geometry = Geometry::new(buffers(4));
        let before = list(&geometry).signature();
        let mut moved = list(&geometry);
        moved.instances[0] = Instance {
            translation: Vec3::ONE,
            tint: Vec4::splat(0.5),
            fade: -0.25,
            seed: 7,
            ..instance()
        };
        moved.own.buffers.positions[0] = Vec3::X;
        assert_eq!(moved.signature(), before, "transform, tint, fade, own vertices");
        let points = |size_px| {
            let mut list = list(&geometry);
            list.items[0].primitive = Primitive::Points { size_px };
            list.signature()
        };
        assert_eq!(points(1.0), points(1.5), "a size in pixels");
    }

    #[test]
    fn every_jump_changes_it() {
        let geometry = Geometry::new(buffers(4));
        let before = list(&geometry).signature();
        type Jump = (&'static str, fn(&mut DrawList));
        let jumps: [Jump; 10] = [
            ("range", |list| list.items[0].primitives = 0..3),
            ("start", |list| list.items[0].primitives = 1..4),
            ("order", |list| list.items.swap(0, 1)),
            ("own indices", |list| list.own.buffers.indices.swap(0, 3)),
            ("own ids", |list| list.own.buffers.source_ids = vec![1, 0]),
            ("blend", |list| list.items[0].blend = Blend::Over),
            ("cutoff", |list| list.items[0].blend = Blend::Test(0.5)),
            ("depth", |list| list.items[0].depth_write = false),
            ("kind", |list| list.items[1].primitive = Primitive::Lines { width_px: 1.0 }),
            ("geometry", |list| list.geometries[0] = Geometry::new(buffers(4))),
        ];
        for (name, jump) in jumps {
            let mut list = list(&geometry);
            jump(&mut list);
            assert_ne!(list.signature(), before, "{name}");
        }
    }
}
