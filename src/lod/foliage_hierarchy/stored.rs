//! A forest as bytes, and back.
//!
//! ```text
//! magic    8 bytes    "treelodF"
//! version  u32        1
//! leaves   u32        L
//! nodes    u32        N
//! plant    32 bytes   whatever the caller tells plants apart by
//! note     u32 bytes  how many, and whatever the caller wants to know again
//! positions  4 L x 3 f32        spheres  N x 4 f32       scales          N x f32
//! nodes        N x 7 u32        costs    (N - L) x f64   texture leaves  N x u32
//!                               areas    N x f64         texture turns   N x u8
//! checksum u32        CRC-32 of all before
//! ```
//!
//! The arrays follow one another column by column as listed, little-endian. The bytes depend on the
//! forest alone, and each forest has one form: what is read is written again as it was.
//!
//! Reading trusts nothing. The length must be what the counts say before anything is allocated, and
//! every link, number and corner must hold, whether or not the checksum does. What is refused is a
//! [`LodError::Store`].

use glam::Vec3;

use crate::error::LodError;
use crate::lod::foliage_hierarchy::forest::{Forest, NONE, Node, Sphere, TextureCorners};

/// The first bytes of a stored forest.
pub const MAGIC: [u8; 8] = *b"treelodF";

/// The one version there is.
pub const VERSION: u32 = 1;

/// What tells plants apart.
pub type Digest = [u8; 32];

/// Longest note.
pub const MAX_NOTE_BYTES: usize = 1 << 16;

/// By which share of its radius, and of its place, what a node draws may lie beyond its ball: rounding.
const BALL_SLACK: f64 = 1e-5;

const HEADER_BYTES: usize = 8 + 3 * 4 + 32 + 4;
const CHECKSUM_BYTES: usize = 4;
const LEAF_BYTES: u64 = 4 * 3 * 4;
const NODE_BYTES: u64 = 7 * 4 + 4 * 4 + 8 + 4 + 4 + 1;
const COLLAPSE_BYTES: u64 = 8;

/// A stored forest, read.
#[derive(Debug, Clone, PartialEq)]
pub struct Stored {
    /// The forest.
    pub forest: Forest,
    /// The plant it was made of.
    pub plant: Digest,
    /// The caller's own.
    pub note: Vec<u8>,
}

/// A forest as bytes, with the digest of the plant that it stands for, and a note of up to
/// [`MAX_NOTE_BYTES`].
pub fn write(forest: &Forest, plant: &Digest, note: &[u8]) -> Vec<u8> {
    assert!(note.len() <= MAX_NOTE_BYTES, "a note is short");
    let node_count = u32::try_from(forest.nodes.len()).expect("nodes are counted in 32 bits");
    let length = length(forest.leaf_count, node_count, note.len());
    let mut bytes = Vec::with_capacity(usize::try_from(length).expect("as large as the forest"));
    bytes.extend(MAGIC);
    for number in [VERSION, forest.leaf_count, node_count] {
        bytes.extend(number.to_le_bytes());
    }
    bytes.extend(plant);
    bytes.extend(u32::try_from(note.len()).expect("short").to_le_bytes());
    bytes.extend(note);
    bytes.extend(forest.positions.iter().flat_map(|p| p.to_array()).flat_map(f32::to_le_bytes));
    bytes.extend(forest.nodes.iter().flat_map(words).flat_map(u32::to_le_bytes));
    for sphere in &forest.spheres {
        let numbers = sphere.center.extend(sphere.radius).to_array();
        bytes.extend(numbers.into_iter().flat_map(f32::to_le_bytes));
    }
    bytes.extend(forest.costs.iter().flat_map(|cost| cost.to_le_bytes()));
    bytes.extend(forest.areas.iter().flat_map(|area| area.to_le_bytes()));
    bytes.extend(forest.scales.iter().flat_map(|scale| scale.to_le_bytes()));
    bytes.extend(forest.corners.iter().flat_map(|corners| corners.leaf.to_le_bytes()));
    let turns = forest.corners.iter().map(|corners| corners.turn);
    // what does not fit is refused when it is read
    bytes.extend(turns.map(|turn| u8::try_from(turn).unwrap_or(u8::MAX)));
    let checksum = crc32fast::hash(&bytes);
    bytes.extend(checksum.to_le_bytes());
    assert_eq!(bytes.len() as u64, length, "a forest's arrays are as long as its counts say");
    bytes
}

/// A forest from its bytes; `plant`, if given, is the digest that it must carry.
///
/// # Errors
/// [`LodError::Store`] if the bytes are no forest, damaged, or of another plant.
pub fn read(bytes: &[u8], plant: Option<&Digest>) -> Result<Stored, LodError> {
    let Some((header, rest)) = bytes.split_first_chunk::<HEADER_BYTES>() else {
        return Err(refused(format!("{} bytes are less than its header takes", bytes.len())));
    };
    let mut header = Reader { bytes: header };
    if header.raw(MAGIC.len()) != MAGIC {
        return Err(refused("this is none: other bytes stand at its beginning".to_owned()));
    }
    let [version, leaf_count, node_count] = [header.u32(), header.u32(), header.u32()];
    if version != VERSION {
        return Err(refused(format!("version {version} is not read, only {VERSION}")));
    }
    let (fewest, most) = (u64::from(leaf_count), (2 * u64::from(leaf_count)).saturating_sub(1));
    if !(fewest..=most.max(fewest)).contains(&u64::from(node_count)) {
        return Err(refused(format!("{leaf_count} leaves cannot make {node_count} nodes")));
    }
    let digest: Digest = header.raw(32).try_into().expect("the rest of the header");
    let note_bytes = header.u32() as usize;
    if note_bytes > MAX_NOTE_BYTES {
        return Err(refused(format!("a note of {note_bytes} bytes is too long")));
    }
    let asked = length(leaf_count, node_count, note_bytes);
    if bytes.len() as u64 != asked {
        let why = format!("it should take {asked} bytes, but there are {}", bytes.len());
        return Err(refused(why));
    }
    let (body, checksum) = bytes.split_at(bytes.len() - CHECKSUM_BYTES);
    if checksum != crc32fast::hash(body).to_le_bytes() {
        return Err(refused("its checksum does not fit: it has been altered".to_owned()));
    }
    if plant.is_some_and(|plant| *plant != digest) {
        return Err(refused("it belongs to another plant".to_owned()));
    }
    let mut reader = Reader { bytes: rest };
    let note = reader.raw(note_bytes).to_vec();
    let forest = reader.forest(leaf_count, node_count as usize);
    check(&forest)?;
    Ok(Stored { forest, plant: digest, note })
}

fn refused(why: String) -> LodError {
    LodError::Store { name: "stored foliage", why }
}

/// Bytes of a stored forest.
fn length(leaf_count: u32, node_count: u32, note_bytes: usize) -> u64 {
    let (leaves, nodes) = (u64::from(leaf_count), u64::from(node_count));
    (HEADER_BYTES + note_bytes + CHECKSUM_BYTES) as u64
        + leaves * LEAF_BYTES
        + nodes * NODE_BYTES
        + (nodes - leaves) * COLLAPSE_BYTES
}

fn words(node: &Node) -> [u32; 7] {
    let ([a, b, c, d], [first, second]) = (node.vertices, node.children);
    [a, b, c, d, node.parent, first, second]
}

/// Bytes of which enough are there.
struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    fn raw(&mut self, count: usize) -> &'a [u8] {
        let (taken, rest) = self.bytes.split_at(count);
        self.bytes = rest;
        taken
    }

    fn chunk<const N: usize>(&mut self) -> [u8; N] {
        self.raw(N).try_into().expect("as many as were taken")
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.chunk())
    }

    fn f32(&mut self) -> f32 {
        f32::from_le_bytes(self.chunk())
    }

    fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.chunk())
    }

    fn vec3(&mut self) -> Vec3 {
        Vec3::new(self.f32(), self.f32(), self.f32())
    }

    fn node(&mut self) -> Node {
        let vertices = [self.u32(), self.u32(), self.u32(), self.u32()];
        Node { vertices, parent: self.u32(), children: [self.u32(), self.u32()] }
    }

    fn sphere(&mut self) -> Sphere {
        Sphere { center: self.vec3(), radius: self.f32() }
    }

    fn rows<T>(&mut self, count: usize, read: impl Fn(&mut Self) -> T) -> Vec<T> {
        (0..count).map(|_| read(self)).collect()
    }

    fn forest(&mut self, leaf_count: u32, node_count: usize) -> Forest {
        let leaves = leaf_count as usize;
        let positions = self.rows(4 * leaves, Self::vec3);
        let nodes = self.rows(node_count, Self::node);
        let spheres = self.rows(node_count, Self::sphere);
        let costs = self.rows(node_count - leaves, Self::f64);
        let areas = self.rows(node_count, Self::f64);
        let scales = self.rows(node_count, Self::f32);
        let mut corners =
            self.rows(node_count, |reader| TextureCorners { leaf: reader.u32(), turn: 0 });
        for (corners, &turn) in corners.iter_mut().zip(self.raw(node_count)) {
            corners.turn = u32::from(turn);
        }
        Forest { leaf_count, positions, nodes, spheres, costs, areas, scales, corners }
    }
}

/// Whether everything holds that the rest of the code relies on.
fn check(forest: &Forest) -> Result<(), LodError> {
    let row = |what: &str, index: Option<usize>, why: &str| match index {
        None => Ok(()),
        Some(index) => Err(refused(format!("{what} {index} {why}"))),
    };
    let positions = forest.positions.iter().position(|position| !position.is_finite());
    row("position", positions, "is not finite")?;
    let is_length = |length: f64| length.is_finite() && length >= 0.0;
    let spheres = forest.spheres.iter();
    let spheres = spheres
        .clone()
        .position(|ball| !ball.center.is_finite() || !is_length(f64::from(ball.radius)));
    row("ball", spheres, "is none")?;
    let costs = forest.costs.iter().position(|&cost| !is_length(cost));
    row("cost", costs, "is negative or not finite")?;
    let areas = forest.areas.iter().position(|&area| !is_length(area));
    row("area", areas, "is negative or not finite")?;
    let scales = forest.scales.iter().position(|&scale| !is_length(f64::from(scale)));
    row("scale", scales, "is negative or not finite")?;
    let leaves = forest.corners.iter().position(|corners| corners.leaf >= forest.leaf_count);
    row("node", leaves, "takes its texture from no leaf")?;
    let turns = forest.corners.iter().position(|corners| corners.turn >= 4);
    row("node", turns, "has corners that are turned too far")?;
    let links = (0..forest.nodes.len()).find(|&node| !is_linked(forest, node));
    row("node", links, "is not linked to its parent and children")?;
    let vertices = (0..forest.nodes.len()).find(|&node| !has_corners(forest, node));
    row("node", vertices, "does not stand on corners of its own, or on two of each child")?;
    let drawn = (0_u32..).zip(&forest.spheres).position(|(node, ball)| {
        let (center, radius) = (ball.center.as_dvec3(), f64::from(ball.radius));
        let outside = radius * (1.0 + BALL_SLACK) + center.abs().max_element() * BALL_SLACK;
        !forest.drawn_quad(node).iter().all(|corner| corner.distance(center) <= outside)
    });
    row("node", drawn, "is drawn beyond its ball")
}

/// Whether a node's parent has it for a child, its children have it for a parent and come before it,
/// and the leaves of the plant are those without children.
fn is_linked(forest: &Forest, at: usize) -> bool {
    let node = forest.nodes[at];
    let index = u32::try_from(at).expect("counted in 32 bits");
    let has_parent = node.parent == NONE
        || forest.nodes.get(node.parent as usize).is_some_and(|p| p.children.contains(&index));
    let [first, second] = node.children;
    let has_children = if index < forest.leaf_count {
        node.children == [NONE; 2]
    } else {
        let is_child = |child: u32| child < index && forest.nodes[child as usize].parent == index;
        first < second && is_child(first) && is_child(second)
    };
    has_parent && has_children
}

/// For nodes whose links hold. Each leaf has four corners that no other has, so two of each child are
/// four.
fn has_corners(forest: &Forest, at: usize) -> bool {
    let node = forest.nodes[at];
    let mut sorted = node.vertices;
    sorted.sort_unstable();
    if node.is_leaf() {
        let first = 4 * at as u64;
        return sorted.iter().zip(first..).all(|(&vertex, own)| u64::from(vertex) == own);
    }
    let is_apart = sorted.windows(2).all(|pair| pair[0] < pair[1]);
    let shared = |child: u32| {
        let of_child = forest.nodes[child as usize].vertices;
        sorted.iter().filter(|vertex| of_child.contains(vertex)).count()
    };
    is_apart && node.children.iter().all(|&child| shared(child) == 2)
}

#[cfg(test)]
mod tests;
