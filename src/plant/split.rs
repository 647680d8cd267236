//! Which triangles of a plant are leaves: connected pieces, each classed as wood or leaf.
//!
//! A piece is a set of triangles of one material that share positions (exactly equal ones, see
//! [`weld`](crate::plant::weld)). It is classed by the first of these that holds:
//!
//! 1. its texture cuts it out: texels it really uses are below the alpha cutoff — a leaf. The
//!    material's alpha mode alone says nothing: exporters write MASK on bark too;
//! 2. it is a sheet: its area vectors do not cancel, as they do on anything closed and on a tube
//!    with open ends — a leaf;
//! 3. it is thin: nearly flat, or every triangle has a twin on the other side, as leaves with two
//!    faces are modelled — a leaf;
//! 4. it is a solid. If the largest solid of its material is large against the plant, that is a
//!    limb and all solids of the material are wood, twigs and stumps included; if even the
//!    largest is small, they are buds, fruit or solid needles, which is foliage.
//!
//! Limits: a crown modelled as a few large closed blobs is a solid like a vase and counts as wood,
//! and so do solid needles that share their material with the trunk. Naming the foliage overrides
//! everything above.
//!
//! Near-linear time, O(V + T) memory. Everything but the alpha lookups runs on one thread, so the
//! result is the same on any number of them.

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use crate::error::LodError;
use crate::job::Job;
use crate::plant::mesh::{area_normal, triangle_area};
use crate::plant::weld::weld;
use crate::plant::{AlphaMode, Material, Mesh};
use crate::texture::{Filter, Sampler, Texture};

/// Share of a piece's area that the texture must leave out for rule 1. Of ten real plants with
/// cut-out leaves the barks have 0, whole leaf cards 0.16 to 0.82; what bleeds in at the edges of an
/// atlas stays below this.
const MIN_CUTOUT_SHARE: f64 = 0.05;

/// `|sum of area vectors| / sum of areas` from which a piece is a sheet (rule 2): 0 for closed
/// surfaces, 1 for flat ones. On the same ten plants wood has at most 0.13, leaves, flower stems and
/// petals at least 0.51.
const MIN_SHEET_SHARE: f64 = 0.3;

/// Share of a piece's area that is seen along the normal of its largest triangle, from which it is
/// flat (rule 3): 1 for a leaf with two faces, 0.64 for a round tube, 0.67 for a three-sided one.
const MIN_FLAT_SHARE: f64 = 0.85;

/// Share of a piece's area that must have a twin, a triangle on the same three positions (rule 3).
const MIN_TWIN_SHARE: f64 = 0.5;

/// Diameter of the largest solid of a material, against the plant's, from which it is a limb (rule
/// 4). On the ten plants trunks and vases have 0.46 to 0.81, solid flower heads at most 0.04.
const MIN_LIMB_DIAMETER: f64 = 0.1;

/// A texture is looked up at the centres of the n^2 equal triangles that a triangle divides into.
const ALPHA_SUBDIVISION: u16 = 4;

/// Alpha below which a blended material counts as cut out; a masked one has its own cutoff.
const BLEND_CUTOFF: f32 = 0.5;

/// Triangles per rayon job.
const MIN_TRIANGLES_PER_JOB: usize = 4096;

/// Triangles between two looks at whether the caller still wants the result.
const TRIANGLES_PER_CHECK: usize = 1 << 16;

/// Why a piece was classed as it was.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reason {
    /// Foliage: its material or mesh was named.
    Named,
    /// Foliage by rule 1.
    Cutout,
    /// Foliage by rule 2.
    Sheet,
    /// Foliage by rule 3.
    Thin,
    /// Foliage by rule 4.
    Small,
    /// Wood by rule 4.
    Limb,
    /// Wood: foliage was named, and this was not.
    Unnamed,
}

impl Reason {
    /// Whether a piece classed for this reason is a leaf.
    pub fn is_leaf(self) -> bool {
        !matches!(self, Self::Limb | Self::Unnamed)
    }

    /// One lower-case word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Named => "named",
            Self::Cutout => "cutout",
            Self::Sheet => "sheet",
            Self::Thin => "thin",
            Self::Small => "small",
            Self::Limb => "limb",
            Self::Unnamed => "unnamed",
        }
    }
}

/// How many pieces of a material were classed for one reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tally {
    /// Index of the material.
    pub material: u32,
    /// Why.
    pub reason: Reason,
    /// Leaves, or connected pieces of wood.
    pub piece_count: u32,
    /// Their triangles.
    pub triangle_count: u32,
}

/// A plant's triangles, told apart.
#[derive(Debug, Clone, PartialEq)]
pub struct Split {
    /// Everything that is no leaf, by material.
    pub wood: Mesh,
    /// The leaves, by material, then in order of their first triangle.
    pub leaves: Mesh,
    /// Leaf `i` is triangles `leaf_offsets[i]..leaf_offsets[i + 1]` of `leaves`.
    pub leaf_offsets: Vec<u32>,
    /// By material, then by reason.
    pub tallies: Vec<Tally>,
}

/// Splits a mesh; `named[t]` says whether triangle `t` is foliage, `None` decides by the rules.
///
/// # Errors
/// Whatever [`Mesh::check`] finds; [`LodError::Invalid`] unless `named` has a value a triangle;
/// [`LodError::Cancelled`].
pub fn split(
    mesh: &Mesh,
    materials: &[Material],
    named: Option<&[bool]>,
    job: &Job,
) -> Result<Split, LodError> {
    mesh.check(materials.len(), job)?;
    if let Some(named) = named
        && named.len() != mesh.triangles.len()
    {
        let why = format!("{} values for {} triangles", named.len(), mesh.triangles.len());
        return Err(LodError::Invalid { name: "foliage_mask", why });
    }
    let groups = groups(mesh, named);
    let (position_of, position_count) = weld(&mesh.positions);
    let pieces = pieces(mesh, &position_of, position_count, &groups, job)?;
    let reasons = match named {
        Some(_) => pieces.iter().map(|piece| piece.named_reason()).collect(),
        None => classify(mesh, &position_of, materials, &pieces, job)?,
    };
    job.check()?;
    let mut wood = Vec::new();
    let mut leaves = Vec::new();
    let mut leaf_offsets = vec![0];
    let mut tallies: Vec<Tally> = Vec::new();
    for (piece, &reason) in pieces.iter().zip(&reasons) {
        if reason.is_leaf() {
            leaves.extend_from_slice(piece.triangles);
            leaf_offsets.push(index(leaves.len()));
        } else {
            wood.extend_from_slice(piece.triangles);
        }
        let entry = tallies
            .iter_mut()
            .find(|tally| tally.material == piece.material && tally.reason == reason);
        let triangle_count = index(piece.triangles.len());
        match entry {
            Some(tally) => {
                tally.piece_count += 1;
                tally.triangle_count += triangle_count;
            }
            None => tallies.push(Tally {
                material: piece.material,
                reason,
                piece_count: 1,
                triangle_count,
            }),
        }
    }
    tallies.sort_by_key(|tally| (tally.material, tally.reason));
    let material_of: Vec<u32> = mesh.triangle_materials().collect();
    Ok(Split {
        wood: gather(mesh, &material_of, &wood),
        leaves: gather(mesh, &material_of, &leaves),
        leaf_offsets,
        tallies,
    })
}

/// Triangle and vertex counts were checked to fit.
fn index(value: usize) -> u32 {
    u32::try_from(value).expect("checked against MAX_ELEMENT_COUNT")
}

/// Triangles that may be connected: those of one material and, if any are named, one class.
struct Group {
    material: u32,
    named: bool,
    triangles: Vec<u32>,
}

fn groups(mesh: &Mesh, named: Option<&[bool]>) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    let mut group_of = std::collections::BTreeMap::new();
    for (triangle, material) in (0_u32..).zip(mesh.triangle_materials()) {
        let named = named.is_some_and(|named| named[triangle as usize]);
        let slot = *group_of.entry((material, named)).or_insert_with(|| {
            groups.push(Group { material, named, triangles: Vec::new() });
            groups.len() - 1
        });
        groups[slot].triangles.push(triangle);
    }
    groups.sort_by_key(|group| (group.material, group.named));
    groups
}

/// Connected triangles.
struct Piece<'a> {
    material: u32,
    named: bool,
    /// In the order of the mesh.
    triangles: &'a [u32],
}

impl Piece<'_> {
    fn named_reason(&self) -> Reason {
        if self.named { Reason::Named } else { Reason::Unnamed }
    }
}

/// All pieces, by group, then by their first triangle.
struct Pieces<'a> {
    groups: &'a [Group],
    /// The group of each piece.
    group_of: Vec<u32>,
    /// Piece `i` is `triangles[offsets[i]..offsets[i + 1]]`.
    offsets: Vec<u32>,
    triangles: Vec<u32>,
}

impl Pieces<'_> {
    fn count(&self) -> usize {
        self.group_of.len()
    }

    fn get(&self, piece: usize) -> Piece<'_> {
        let group = &self.groups[self.group_of[piece] as usize];
        let range = self.offsets[piece] as usize..self.offsets[piece + 1] as usize;
        Piece { material: group.material, named: group.named, triangles: &self.triangles[range] }
    }

    fn iter(&self) -> impl Iterator<Item = Piece<'_>> {
        (0..self.count()).map(|piece| self.get(piece))
    }
}

fn pieces<'a>(
    mesh: &Mesh,
    position_of: &[u32],
    position_count: u32,
    groups: &'a [Group],
    job: &Job,
) -> Result<Pieces<'a>, LodError> {
    const NONE: u32 = u32::MAX;
    // the first triangle of the current group at each position
    let mut first_at = vec![NONE; position_count as usize];
    let mut parents: Vec<u32> = (0..index(mesh.triangles.len())).collect();
    let mut piece_of = vec![NONE; mesh.triangles.len()];
    let mut group_of = Vec::new();
    let mut sizes: Vec<u32> = Vec::new();
    for (number, group) in (0_u32..).zip(groups) {
        for chunk in group.triangles.chunks(TRIANGLES_PER_CHECK) {
            job.check()?;
            for &triangle in chunk {
                for vertex in mesh.triangles[triangle as usize] {
                    let first = &mut first_at[position_of[vertex as usize] as usize];
                    if *first == NONE {
                        *first = triangle;
                    } else {
                        unite(&mut parents, *first, triangle);
                    }
                }
            }
        }
        for &triangle in &group.triangles {
            // the root is the lowest triangle, so it is numbered before the rest of its piece
            let root = find(&mut parents, triangle) as usize;
            if piece_of[root] == NONE {
                piece_of[root] = index(sizes.len());
                group_of.push(number);
                sizes.push(0);
            }
            piece_of[triangle as usize] = piece_of[root];
            sizes[piece_of[root] as usize] += 1;
            for vertex in mesh.triangles[triangle as usize] {
                first_at[position_of[vertex as usize] as usize] = NONE;
            }
        }
    }
    let mut offsets = vec![0];
    let mut end = 0;
    for size in sizes {
        end += size;
        offsets.push(end);
    }
    let mut next = offsets.clone();
    let mut triangles = vec![0; mesh.triangles.len()];
    for (triangle, &piece) in (0_u32..).zip(&piece_of) {
        let slot = &mut next[piece as usize];
        triangles[*slot as usize] = triangle;
        *slot += 1;
    }
    Ok(Pieces { groups, group_of, offsets, triangles })
}

/// The root of a node; paths get shorter on the way.
pub(crate) fn find(parents: &mut [u32], mut node: u32) -> u32 {
    while parents[node as usize] != node {
        let grandparent = parents[parents[node as usize] as usize];
        parents[node as usize] = grandparent;
        node = grandparent;
    }
    node
}

/// The lower index becomes the root, so that roots do not depend on the order of unions.
pub(crate) fn unite(parents: &mut [u32], a: u32, b: u32) {
    let (a, b) = (find(parents, a), find(parents, b));
    parents[a.max(b) as usize] = a.min(b);
}

/// What the rules look at.
struct Shape {
    /// Diagonal of the box.
    diameter: f64,
    area: f64,
    /// Length of the sum of the area vectors.
    net_area: f64,
    /// Seen along the normal of the largest triangle, from both sides.
    seen_area: f64,
    /// Of triangles that have a twin.
    twin_area: f64,
    /// Area that the texture leaves out.
    cutout_area: f64,
}

impl Shape {
    fn is_cutout(&self) -> bool {
        self.area > 0.0 && self.cutout_area >= MIN_CUTOUT_SHARE * self.area
    }

    fn is_sheet(&self) -> bool {
        self.area > 0.0 && self.net_area >= MIN_SHEET_SHARE * self.area
    }

    fn is_thin(&self) -> bool {
        let is_flat = self.seen_area >= MIN_FLAT_SHARE * self.area;
        self.area > 0.0 && (is_flat || self.twin_area >= MIN_TWIN_SHARE * self.area)
    }

    /// What rules 1 to 3 say; `None` for a solid.
    fn leaf_reason(&self) -> Option<Reason> {
        if self.is_cutout() {
            Some(Reason::Cutout)
        } else if self.is_sheet() {
            Some(Reason::Sheet)
        } else if self.is_thin() {
            Some(Reason::Thin)
        } else {
            None
        }
    }
}

fn classify(
    mesh: &Mesh,
    position_of: &[u32],
    materials: &[Material],
    pieces: &Pieces<'_>,
    job: &Job,
) -> Result<Vec<Reason>, LodError> {
    let cutouts = cutout_shares(mesh, materials, job)?;
    let plant_diameter =
        mesh.bounds().map_or(0.0, |(low, high)| low.as_dvec3().distance(high.as_dvec3()));
    let shapes: Vec<Shape> = (0..pieces.count())
        .into_par_iter()
        .map(|piece| shape(mesh, position_of, pieces.get(piece).triangles, &cutouts))
        .collect();
    job.check()?;
    let mut largest_solid = vec![0.0_f64; materials.len()];
    for (piece, shape) in pieces.iter().zip(&shapes) {
        if shape.area > 0.0 && shape.leaf_reason().is_none() {
            let largest = &mut largest_solid[piece.material as usize];
            *largest = largest.max(shape.diameter);
        }
    }
    let reason = |(piece, shape): (Piece<'_>, &Shape)| {
        shape.leaf_reason().unwrap_or_else(|| {
            let largest = largest_solid[piece.material as usize];
            let has_limb = largest >= MIN_LIMB_DIAMETER * plant_diameter && largest > 0.0;
            if has_limb { Reason::Limb } else { Reason::Small }
        })
    };
    Ok(pieces.iter().zip(&shapes).map(reason).collect())
}

/// Sums in f64 in triangle order.
fn shape(mesh: &Mesh, position_of: &[u32], triangles: &[u32], cutouts: &[f32]) -> Shape {
    let vectors = || triangles.iter().map(|&t| area_normal(mesh.corners(t as usize)));
    let mut low = Vec3::INFINITY;
    let mut high = Vec3::NEG_INFINITY;
    let (mut area, mut net, mut cutout_area) = (0.0, DVec3::ZERO, 0.0);
    let mut largest = DVec3::ZERO;
    for (&triangle, vector) in triangles.iter().zip(vectors()) {
        for corner in mesh.corners(triangle as usize) {
            low = low.min(corner);
            high = high.max(corner);
        }
        area += vector.length();
        net += vector;
        cutout_area += vector.length() * f64::from(cutouts[triangle as usize]);
        if vector.length_squared() > largest.length_squared() {
            largest = vector;
        }
    }
    let axis = largest.normalize_or_zero();
    let seen_area = vectors().map(|vector| vector.dot(axis).abs()).sum();
    let diameter = low.as_dvec3().distance(high.as_dvec3());
    let mut shape =
        Shape { diameter, area, net_area: net.length(), seen_area, twin_area: 0.0, cutout_area };
    // sorting is only worth its while where nothing else has decided
    if shape.leaf_reason().is_none() {
        shape.twin_area = twin_area(mesh, position_of, triangles);
    }
    shape
}

/// Area of the triangles that lie on the same three positions as another one.
fn twin_area(mesh: &Mesh, position_of: &[u32], triangles: &[u32]) -> f64 {
    let mut keyed: Vec<([u32; 3], f64)> = triangles
        .iter()
        .map(|&triangle| {
            let corners = mesh.triangles[triangle as usize];
            let mut key = corners.map(|vertex| position_of[vertex as usize]);
            key.sort_unstable();
            (key, triangle_area(mesh.corners(triangle as usize)))
        })
        .collect();
    keyed.sort_by_key(|&(key, _)| key);
    let groups = keyed.chunk_by(|a, b| a.0 == b.0).filter(|group| group.len() > 1);
    groups.flatten().map(|&(_, area)| area).sum()
}

/// For each triangle the share that its texture leaves out.
pub(super) fn cutout_shares(
    mesh: &Mesh,
    materials: &[Material],
    job: &Job,
) -> Result<Vec<f32>, LodError> {
    let mut shares = vec![0.0; mesh.triangles.len()];
    for part in &mesh.parts {
        job.check()?;
        let Some(mask) = Mask::of(&materials[part.material as usize]) else { continue };
        let range = part.triangles.start as usize..part.triangles.end as usize;
        shares[range.clone()]
            .par_iter_mut()
            .zip(&mesh.triangles[range])
            .with_min_len(MIN_TRIANGLES_PER_JOB)
            .for_each(|(share, corners)| {
                *share = mask.cutout_share(corners.map(|vertex| mesh.uvs[vertex as usize]));
            });
    }
    Ok(shares)
}

/// A texture whose alpha means something.
struct Mask<'a> {
    texture: &'a Texture,
    sampler: Sampler,
    cutoff: f32,
}

impl<'a> Mask<'a> {
    fn of(material: &'a Material) -> Option<Self> {
        let texture = material.texture.as_deref()?;
        let cutoff = match material.alpha_mode {
            AlphaMode::Opaque => return None,
            AlphaMode::Mask { cutoff } => cutoff,
            AlphaMode::Blend => BLEND_CUTOFF,
        };
        if texture.levels()[0].texels.iter().all(|texel| texel[3] == u8::MAX) {
            return None;
        }
        let sampler = Sampler { filter: Filter::Nearest, ..material.sampler };
        Some(Self { texture, sampler, cutoff })
    }

    fn cutout_share(&self, [a, b, c]: [Vec2; 3]) -> f32 {
        let n = ALPHA_SUBDIVISION;
        let step = 1.0 / f32::from(3 * n);
        let mut below = 0_u16;
        // row i, column j: the upright triangle's centre is at (3i + 1, 3j + 1) thirds of a step,
        // the upside-down one's at (3i + 2, 3j + 2)
        for (i, j, third) in (0..n)
            .flat_map(|i| (0..n - i).map(move |j| (i, j)))
            .flat_map(|(i, j)| [(i, j, 1), (i, j, 2)])
            .filter(|&(i, j, third)| third == 1 || i + j < n - 1)
        {
            let u = f32::from(3 * i + third) * step;
            let v = f32::from(3 * j + third) * step;
            let uv = a + (b - a) * u + (c - a) * v;
            below += u16::from(self.texture.alpha(self.sampler, uv, 0.0) < self.cutoff);
        }
        f32::from(below) / f32::from(n * n)
    }
}

/// The chosen triangles in the given order, with the vertices that they use, in order of use.
fn gather(mesh: &Mesh, material_of: &[u32], triangles: &[u32]) -> Mesh {
    const NONE: u32 = u32::MAX;
    let mut slot_of = vec![NONE; mesh.positions.len()];
    let mut used: Vec<u32> = Vec::new();
    let gathered = triangles
        .iter()
        .map(|&triangle| {
            mesh.triangles[triangle as usize].map(|vertex| {
                let slot = &mut slot_of[vertex as usize];
                if *slot == NONE {
                    *slot = index(used.len());
                    used.push(vertex);
                }
                *slot
            })
        })
        .collect();
    let material_ids: Vec<u32> =
        triangles.iter().map(|&triangle| material_of[triangle as usize]).collect();
    Mesh {
        positions: pick(&mesh.positions, &used),
        normals: pick(&mesh.normals, &used),
        uvs: pick(&mesh.uvs, &used),
        base: pick(&mesh.base, &used),
        front: pick(&mesh.front, &used),
        back: pick(&mesh.back, &used),
        triangles: gathered,
        parts: Mesh::parts_from_ids(&material_ids),
    }
}

fn pick<T: Copy>(values: &[T], indices: &[u32]) -> Vec<T> {
    indices.iter().map(|&index| values[index as usize]).collect()
}

#[cfg(test)]
mod tests;
