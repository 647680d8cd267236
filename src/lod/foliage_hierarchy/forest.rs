//! The leaves of a crown and what they collapse into: a forest of binary trees.
//!
//! Nodes 0 to L - 1 are the leaves of the plant, each a quad with four vertices of its own. Node
//! L + t is what collapse t made of two others: a quad on two vertices of each. So children come
//! before parents, the first n nodes and their links are the state after n - L collapses, and a level
//! of detail is a set of nodes that holds each leaf's one ancestor, or itself.
//!
//! The structure takes 7 words a node and 3 a vertex, as in the paper; everything else is a side
//! table.
//!
//! This work is based on: I. Remolar, M. Chover, J. Ribelles, O. Belmonte. View-Dependent
//! Multiresolution Model for Foliage. Journal of WSCG 11(1), 2003.

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};

use crate::lod::foliage_hierarchy::quad::measure;

/// A link to no node.
pub const NONE: u32 = u32::MAX;

/// A quad and its place in the forest: seven words.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Node {
    /// Corners in order around the quad, which is the triangles (0, 1, 2) and (0, 2, 3).
    pub vertices: [u32; 4],
    /// What it collapses into, or [`NONE`].
    pub parent: u32,
    /// What it was made of, the lower index first, or twice [`NONE`].
    pub children: [u32; 2],
}

impl Node {
    /// Whether it is a leaf of the plant.
    pub fn is_leaf(&self) -> bool {
        self.children[0] == NONE
    }
}

/// A ball.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Sphere {
    /// Relative to the plant's origin, in metres.
    pub center: Vec3,
    /// Metres.
    pub radius: f32,
}

/// Where a node's texture coordinates come from: corner `k` takes those of corner `(k + turn) % 4` of
/// a leaf. Two words.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct TextureCorners {
    /// The leaf of the plant.
    pub leaf: u32,
    /// Below 4.
    pub turn: u32,
}

impl TextureCorners {
    /// Which corner of the leaf lends its texture coordinates to a corner of the node.
    pub fn corner(self, node_corner: usize) -> usize {
        (self.turn as usize + node_corner) % 4
    }
}

/// A crown at every level of detail.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Forest {
    /// Leaves of the plant, L.
    pub leaf_count: u32,
    /// Corners of the leaves' quads, 4 L, relative to the plant's origin.
    pub positions: Vec<Vec3>,
    /// Leaves, then what each collapse made: 2 L - R for R roots.
    pub nodes: Vec<Node>,
    /// Around all quads, as drawn, of a node and of what lies below it.
    pub spheres: Vec<Sphere>,
    /// Of each collapse, in order.
    pub costs: Vec<f64>,
    /// Area of the plant's leaves below each node, in square metres.
    pub areas: Vec<f64>,
    /// About its centre, what gives each node as drawn that area; 1 where it has none of its
    /// own, or where areas are not kept.
    pub scales: Vec<f32>,
    /// Texture coordinates of each node.
    pub corners: Vec<TextureCorners>,
}

impl Forest {
    /// Nodes without a parent: the fewest quads that the crown can be drawn with.
    pub fn root_count(&self) -> usize {
        // every collapse takes one away
        self.leaf_count as usize - self.costs.len()
    }

    /// Nodes without a parent, in their order.
    pub fn roots(&self) -> impl Iterator<Item = u32> {
        let count = u32::try_from(self.nodes.len()).expect("checked when it was made");
        (0..count).filter(|&node| self.nodes[node as usize].parent == NONE)
    }

    /// A node's corners, not scaled, relative to the plant's origin.
    pub fn quad(&self, node: u32) -> [DVec3; 4] {
        self.nodes[node as usize].vertices.map(|vertex| self.positions[vertex as usize].as_dvec3())
    }

    /// A node's corners as drawn, relative to the plant's origin.
    pub fn drawn_quad(&self, node: u32) -> [DVec3; 4] {
        let quad = self.quad(node);
        let scale = f64::from(self.scales[node as usize]);
        if scale == 1.0 {
            return quad;
        }
        let center = measure(&quad).center;
        quad.map(|corner| center + (corner - center) * scale)
    }

    /// Bytes of nodes and vertices.
    pub fn structure_bytes(&self) -> u64 {
        (size_of_val(&self.nodes[..]) + size_of_val(&self.positions[..])) as u64
    }

    /// Bytes of the side tables.
    pub fn side_bytes(&self) -> u64 {
        let floats = size_of_val(&self.costs[..]) + size_of_val(&self.areas[..]);
        let rest = size_of_val(&self.spheres[..]) + size_of_val(&self.scales[..]);
        (floats + rest + size_of_val(&self.corners[..])) as u64
    }
}
