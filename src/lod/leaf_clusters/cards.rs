//! A level's cards: baked into one texture, and drawn where they are or on their way to the next
//! level's planes.
//!
//! A card has a picture for its front and, if it is two-sided, one for its back; which of them is
//! drawn depends on the side of its plane that the eye is on.

use std::ops::Range;
use std::sync::Arc;

use glam::{DAffine3, DVec2, DVec3, Vec2, Vec3, Vec4};

use crate::bake::{self, BakeRect, bake};
use crate::draw_list::{Blend, Buffers, Geometry, Instance, Item, Primitive, Source, Surface};
use crate::error::{LodError, check_limit};
use crate::job::Job;
use crate::lod::leaf_clusters::impostor::Impostor;
use crate::lod::leaf_clusters::indirect::{Indirect, LeafPicture, Map, MapSide};
use crate::lod::leaf_clusters::plane::Plane;
use crate::lod::leaf_clusters::{Drawing, Params, Texels};
use crate::lod::leaves::Leaves;
use crate::lod::{Crown, ListBuilder};
use crate::plant::Plant;
use crate::raster::Renderer;
use crate::texture::atlas::Atlas;
use crate::texture::mips::Keep;
use crate::texture::texture::MAX_TEXTURE_SIDE;
use crate::texture::{Distribution, Filter, Sampler, Texture, Wrap};
use crate::view::View;

/// Alpha from which a tested card is there.
const CUTOFF: f32 = 0.5;

/// Texels of all levels together: 2 GiB of RGBA8.
const MAX_TOTAL_TEXELS: u64 = 1 << 29;

/// Tested cards with no more texels than pixels are baked with up to this many halvings more.
const FINER_LEVELS: u32 = 3;

/// And up to so many texels a side.
const MAX_FINER_SIDE: u32 = 2048;

/// Front and back.
const SIDES: [Side; 2] = [Side::Front, Side::Back];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Front,
    Back,
}

/// A level's cards with the texels that each side gets, where it is baked.
pub(super) struct Sized {
    impostors: Vec<Impostor>,
    sizes: Vec<[Option<(u32, u32)>; 2]>,
}

impl Sized {
    pub(super) fn tile_count(&self) -> usize {
        self.sizes.iter().flatten().flatten().count()
    }

    /// Root mean square distance of leaf vertices from their planes.
    pub(super) fn error(&self) -> f64 {
        let sum: f64 = self.impostors.iter().map(|impostor| impostor.deviation_sq).sum();
        let count: usize = self.impostors.iter().map(|impostor| impostor.vertex_count).sum();
        (sum / count as f64).sqrt()
    }
}

/// Bakes cards.
pub(super) struct Baker<'a> {
    plant: &'a Plant,
    params: &'a Params,
    job: &'a Job,
    renderer: Renderer,
    texel_count: u64,
    leaf_picture: Option<LeafPicture>,
}

impl<'a> Baker<'a> {
    pub(super) fn new(plant: &'a Plant, params: &'a Params, job: &'a Job) -> Self {
        let renderer = Renderer::default();
        Self { plant, params, job, renderer, texel_count: 0, leaf_picture: None }
    }

    /// Bakes the leaf that stands for all where cards name their leaves; `leaves` as they grow.
    pub(super) fn prepare(&mut self, leaves: &Leaves<'_>) -> Result<(), LodError> {
        let Self { params, job, .. } = *self;
        let (keep, samples) = (self.keep(), params.sample_count);
        if let Some(indirect) = &params.indirect {
            let renderer = &mut self.renderer;
            let picture = LeafPicture::new(leaves, indirect, samples, keep, renderer, job)?;
            self.leaf_picture = Some(picture);
        }
        Ok(())
    }

    /// Decides what is baked of a level, and how large; refuses more than there may be.
    pub(super) fn sizes(
        &mut self,
        leaves: &Leaves<'_>,
        impostors: Vec<Impostor>,
    ) -> Result<Sized, LodError> {
        let sizes: Vec<_> = impostors.iter().map(|card| self.size(leaves, card)).collect();
        if self.params.indirect.is_none() {
            for (width, height) in sizes.iter().flatten().flatten() {
                self.texel_count += u64::from(*width) * u64::from(*height);
            }
        }
        check_limit(self.argument(), self.texel_count, MAX_TOTAL_TEXELS, "texels")?;
        Ok(Sized { impostors, sizes })
    }

    /// The argument that decides how large cards are.
    fn argument(&self) -> &'static str {
        match self.params.texels {
            Texels::Each(..) => "resolution",
            Texels::PerMetre(_) => "texels_per_metre",
        }
    }

    fn size(&self, leaves: &Leaves<'_>, card: &Impostor) -> [Option<(u32, u32)>; 2] {
        let BakeRect { width, height, .. } = card.rect;
        let texels = |metres: f64, density: f64, most: u32| {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
            let texels = (metres * density).ceil().clamp(1.0, f64::from(most)) as u32;
            texels
        };
        let (most, density) = match self.params.texels {
            Texels::Each(wide, high) => ((wide, high), f64::INFINITY),
            Texels::PerMetre(density) => ((MAX_TEXTURE_SIDE, MAX_TEXTURE_SIDE), density),
        };
        let size = |density: f64| (texels(width, density, most.0), texels(height, density, most.1));
        let Some(views) = &self.params.views else {
            let size = Some(size(density));
            return [size, size.filter(|_| self.params.two_sided)];
        };
        // placed as a scene places a single copy
        let world_from_local = DAffine3::from_translation(self.plant.origin);
        let crown = Crown::alone(world_from_local);
        let mut needed = [None::<f64>; 2];
        for view in views {
            let side = if self.params.two_sided {
                Viewer::new(view, &crown).side(&card.plane)
            } else {
                Side::Front
            };
            let center = crown.world_from_local.transform_point3(leaves.center);
            let nearest = ((center - view.eye).length() - leaves.radius).max(view.near);
            let per_metre = 1.0 / view.pixel_size_at(nearest);
            let most = needed[side as usize].get_or_insert(0.0);
            *most = most.max(per_metre);
        }
        needed.map(|needed| needed.map(|per_metre| size(density.min(per_metre))))
    }

    /// Draws a level's cards into one texture, or maps their leaves.
    pub(super) fn bake(&mut self, leaves: &Leaves<'_>, sized: Sized) -> Result<Cards, LodError> {
        let Sized { impostors, sizes } = sized;
        // every side that is baked, with its card
        let tiles: Vec<Tile<'_>> = impostors
            .iter()
            .zip(&sizes)
            .flat_map(|(impostor, sizes)| {
                SIDES.into_iter().zip(sizes).filter_map(move |(side, size)| {
                    let rect = match side {
                        Side::Front => impostor.rect,
                        Side::Back => impostor.back(),
                    };
                    Some(Tile { impostor, side, rect, size: (*size)? })
                })
            })
            .collect();
        let (picture, parts, fill) = match self.params.indirect {
            None => self.direct(leaves, &tiles)?,
            Some(indirect) => self.indirect(leaves, &tiles, &indirect)?,
        };
        let mut buffers = Buffers::default();
        let mut cards: Vec<Card> = impostors.iter().map(Card::new).collect();
        let first_id = u32::try_from(self.plant.wood.triangles.len()).expect("checked");
        let mut number = 0;
        for (tile, part) in tiles.iter().zip(parts) {
            while !std::ptr::eq(&raw const impostors[number], tile.impostor) {
                number += 1;
            }
            let id = first_id + u32::try_from(number).expect("few cards");
            cards[number].sides[tile.side as usize] =
                Some(push_side(&mut buffers, tile, &part, id));
        }
        Ok(Cards { cards, geometry: Geometry::new(buffers), picture, fill })
    }

    fn keep(&self) -> Keep {
        match self.params.drawing {
            Drawing::Test => Keep::Coverage { cutoff: CUTOFF },
            Drawing::Coverage | Drawing::Blend => Keep::MeanAlpha,
        }
    }

    fn direct(&mut self, leaves: &Leaves<'_>, tiles: &[Tile<'_>]) -> Result<Baked, LodError> {
        let sizes: Vec<(u32, u32)> = tiles.iter().map(|tile| tile.size).collect();
        let atlas = Atlas::new(self.argument(), &sizes)?;
        let keep = self.keep();
        let mut levels = atlas.levels();
        for (number, tile) in tiles.iter().enumerate() {
            self.job.check()?;
            // alpha tests on texels as large as a pixel would lose what is thinner: such a card keeps
            // the coverage of a finer one
            let (width, height) = tile.size;
            let finer_levels = self.finer_levels(tile.size);
            let view = tile.rect.view((width << finer_levels, height << finer_levels))?;
            let list = leaves.list(&view, &tile.impostor.leaves, [0.0, f32::INFINITY]);
            let count = self.params.sample_count;
            let image = bake(&mut self.renderer, &list, &view, count, self.job)?;
            let padded = atlas.padded(number, &image);
            let made = bake::levels(&padded, keep, self.job)?;
            atlas.put(number, &made[finer_levels as usize..], &mut levels);
            self.job.advance();
        }
        #[expect(clippy::cast_possible_truncation, reason = "texture coordinates are f32")]
        let at = |tile: usize, share: [f64; 2]| {
            let [u, v] = atlas.uv(tile, share);
            Vec2::new(u as f32, v as f32)
        };
        let part = |tile: usize| {
            let ([x, y], (width, height)) = (atlas.places[tile], sizes[tile]);
            let corner = at(tile, [0.0; 2]);
            let size = at(tile, [1.0; 2]) - corner;
            Part { corner, size, texels: Some([x, y, width, height]) }
        };
        let parts = (0..tiles.len()).map(part).collect();
        let texture = bake::stored(levels, self.params.format, self.job)?;
        Ok((Picture::Direct(texture), parts, atlas.fill()))
    }

    /// Levels that a card of a size is baked with and does not keep.
    fn finer_levels(&self, (width, height): (u32, u32)) -> u32 {
        let tested = self.params.drawing == Drawing::Test && self.params.views.is_some();
        let side = width.max(height);
        (0..=FINER_LEVELS)
            .rev()
            .find(|levels| tested && side << levels <= MAX_FINER_SIDE)
            .unwrap_or(0)
    }

    fn indirect(
        &mut self,
        leaves: &Leaves<'_>,
        tiles: &[Tile<'_>],
        indirect: &Indirect,
    ) -> Result<Baked, LodError> {
        let job = self.job;
        let picture = self.leaf_picture.as_ref().expect("baked before the cards");
        let sides: Vec<MapSide<'_>> =
            tiles.iter().map(|tile| MapSide { impostor: tile.impostor, rect: tile.rect }).collect();
        let map = Map::new(leaves, picture, &sides, indirect, job)?;
        job.advance_by(tiles.len());
        let leaf = Arc::clone(&picture.texture);
        let part = |[corner, size]: [Vec2; 2]| Part { corner, size, texels: None };
        let parts = map.parts.into_iter().map(part).collect();
        Ok((Picture::Indirect { map: map.distribution, leaf }, parts, map.fill))
    }
}

/// A side that is baked.
struct Tile<'a> {
    impostor: &'a Impostor,
    side: Side,
    rect: BakeRect,
    size: (u32, u32),
}

/// What a tile has of the picture that a level's cards show.
struct Part {
    /// Upper left corner and size in texture space.
    corner: Vec2,
    size: Vec2,
    texels: Option<[u32; 4]>,
}

/// What cards show, each tile's part of it, and the share of it that is in use.
type Baked = (Picture, Vec<Part>, f64);

/// What a level's cards show.
#[derive(Debug)]
pub(super) enum Picture {
    Direct(Arc<Texture>),
    Indirect { map: Arc<Distribution>, leaf: Arc<Texture> },
}

/// A side's vertices and triangles in the shared geometry, and what it shows.
#[derive(Debug, Clone)]
struct Drawn {
    vertices: Range<u32>,
    triangles: Range<u32>,
    rect: BakeRect,
    /// Upper left texel in the level's texture, width and height, if it has one.
    texels: Option<[u32; 4]>,
}

/// One side of a card, for looking at.
#[derive(Debug, Clone, PartialEq)]
pub struct CardSide {
    /// The card's cluster.
    pub cluster: usize,
    /// Whether this is the side behind the card's plane.
    pub is_back: bool,
    /// What it shows, relative to the plant's origin.
    pub rect: BakeRect,
    /// Corners of the card, relative to the plant's origin.
    pub outline: Vec<DVec3>,
    /// Upper left texel in the level's texture, width and height; `None` for indirect cards.
    pub texels: Option<[u32; 4]>,
}

/// A card as it is drawn.
#[derive(Debug, Clone)]
struct Card {
    plane: Plane,
    mean: DVec3,
    /// Corners in the plant's space.
    corners: Vec<DVec3>,
    sides: [Option<Drawn>; 2],
}

impl Card {
    fn new(impostor: &Impostor) -> Self {
        let corners = impostor.outline.iter().map(|&at| impostor.point(at)).collect();
        Self { plane: impostor.plane, mean: impostor.mean, corners, sides: [None, None] }
    }

    /// The side's, or the other's if that alone was baked.
    fn drawn(&self, side: Side) -> &Drawn {
        let [front, back] = &self.sides;
        let either = match side {
            Side::Front => front.as_ref().or(back.as_ref()),
            Side::Back => back.as_ref().or(front.as_ref()),
        };
        either.expect("every card has a side")
    }
}

/// Appends a side's corners and the triangles between them, which are white: what they show is lit.
fn push_side(buffers: &mut Buffers, tile: &Tile<'_>, part: &Part, id: u32) -> Drawn {
    let Tile { impostor, side, .. } = tile;
    let first = u32::try_from(buffers.positions.len()).expect("few corners");
    let first_triangle = u32::try_from(buffers.indices.len() / 3).expect("few triangles");
    let normal = match side {
        Side::Front => impostor.plane.normal,
        Side::Back => -impostor.plane.normal,
    };
    for &at in &impostor.outline {
        // from behind left and right are exchanged
        let seen = match side {
            Side::Front => at,
            Side::Back => DVec2::new(1.0 - at.x, at.y),
        };
        buffers.positions.push(impostor.point(at).as_vec3());
        buffers.normals.push(normal.as_vec3());
        buffers.uvs.push(part.corner + seen.as_vec2() * part.size);
        buffers.base.push(Vec4::ONE);
        buffers.front.push(Vec3::ONE);
        buffers.back.push(Vec3::ONE);
    }
    let count = u32::try_from(impostor.outline.len()).expect("few corners");
    for corner in 1..count - 1 {
        let [a, b, c] = [first, first + corner, first + corner + 1];
        // the side that is seen is the front, also of the back
        buffers.indices.extend(match side {
            Side::Front => [a, b, c],
            Side::Back => [a, c, b],
        });
        buffers.source_ids.push(id);
    }
    Drawn {
        vertices: first..first + count,
        triangles: first_triangle..first_triangle + count - 2,
        rect: tile.rect,
        texels: part.texels,
    }
}

/// The cards of a level.
#[derive(Debug)]
pub(super) struct Cards {
    cards: Vec<Card>,
    geometry: Arc<Geometry>,
    picture: Picture,
    /// Share of the texture, or of the map, that cards cover.
    pub(super) fill: f64,
}

impl Cards {
    pub(super) fn count(&self) -> usize {
        self.cards.len()
    }

    /// Every side that was baked, card by card.
    pub(super) fn sides(&self) -> Vec<CardSide> {
        let sides = |(cluster, card): (usize, &Card)| {
            let side = |(side, drawn): (Side, &Option<Drawn>)| {
                let drawn = drawn.as_ref()?;
                Some(CardSide {
                    cluster,
                    is_back: side == Side::Back,
                    rect: drawn.rect,
                    outline: card.corners.clone(),
                    texels: drawn.texels,
                })
            };
            SIDES.into_iter().zip(&card.sides).filter_map(side).collect::<Vec<_>>()
        };
        self.cards.iter().enumerate().flat_map(sides).collect()
    }

    /// Bytes of the level's own texture or map.
    pub(super) fn texture_bytes(&self) -> u64 {
        match &self.picture {
            Picture::Direct(texture) => texture.byte_count(),
            Picture::Indirect { map, .. } => map.byte_count(),
        }
    }

    /// The level's own texture, if it has one.
    pub(super) fn texture(&self) -> Option<&Arc<Texture>> {
        match &self.picture {
            Picture::Direct(texture) => Some(texture),
            Picture::Indirect { .. } => None,
        }
    }

    /// The picture of a leaf that all levels share, if there is one.
    pub(super) fn leaf(&self) -> Option<&Arc<Texture>> {
        match &self.picture {
            Picture::Direct(_) => None,
            Picture::Indirect { leaf, .. } => Some(leaf),
        }
    }

    pub(super) fn geometry_bytes(&self) -> u64 {
        self.geometry.buffers().byte_count()
    }

    /// Corners of all cards in the plant's space.
    pub(super) fn corners(&self) -> impl Iterator<Item = DVec3> {
        self.cards.iter().flat_map(|card| card.corners.iter().copied())
    }

    /// Whether every view draws the whole index buffer in its order.
    fn is_fixed(&self) -> bool {
        self.cards.iter().all(|card| card.sides[1].is_none())
    }
}

/// A camera in a crown's coordinates.
struct Viewer {
    /// `None` for parallel views.
    eye: Option<DVec3>,
    /// From the crown to the viewer, in parallel views.
    back: DVec3,
}

impl Viewer {
    fn new(view: &View, crown: &Crown) -> Self {
        let eye = (!view.is_orthographic()).then(|| crown.local_eye(view));
        // what lies on which side of a plane is kept by the inverse's transpose alone, so a direction
        // goes through the inverse like a difference of points
        Self { eye, back: crown.local_direction(view.back) }
    }

    /// From which side a plane is seen; on the plane itself, from the front.
    fn side(&self, plane: &Plane) -> Side {
        let toward = self.eye.map_or(plane.normal.dot(self.back), |eye| plane.distance(eye));
        if toward < 0.0 { Side::Back } else { Side::Front }
    }

    /// Larger for what is farther.
    fn distance(&self, point: DVec3) -> f64 {
        self.eye.map_or(-point.dot(self.back), |eye| point.distance_squared(eye))
    }
}

/// Puts cards of several copies into a list.
pub(super) struct Emitter<'a> {
    view: &'a View,
    drawing: Drawing,
    builder: &'a mut ListBuilder,
    /// Copies whose cards are drawn alike, one after another.
    waiting: Option<(u64, Item)>,
}

impl<'a> Emitter<'a> {
    pub(super) fn new(view: &'a View, drawing: Drawing, builder: &'a mut ListBuilder) -> Self {
        Self { view, drawing, builder, waiting: None }
    }

    /// Draws a copy's cards where they are; `fade` as an instance's.
    pub(super) fn plain(&mut self, crown: &Crown, cards: &Cards, fade: f64) {
        if self.drawing == Drawing::Blend || !cards.is_fixed() {
            let source = self.builder.list.geometry(&cards.geometry);
            self.chosen(crown, cards, |card| cards.cards[card].plane, source, 0, fade);
            return;
        }
        let instances = self.instance(crown, fade);
        let geometry = cards.geometry.id();
        if let Some((waiting, item)) = &mut self.waiting
            && *waiting == geometry
            && item.instances.end == instances.start
        {
            item.instances.end = instances.end;
            return;
        }
        self.flush();
        let source = self.builder.list.geometry(&cards.geometry);
        let count = cards.geometry.buffers().indices.len() / 3;
        let triangles = 0..u32::try_from(count).expect("few triangles");
        self.waiting = Some((geometry, self.item(cards, [source; 2], triangles, instances)));
    }

    /// Draws a copy's cards a share `t` of the way to the planes of the next level, one a parent.
    pub(super) fn moved(
        &mut self,
        crown: &Crown,
        cards: &Cards,
        parents: &[u32],
        planes: &[Plane],
        t: f64,
        fade: f64,
    ) {
        let shared = cards.geometry.buffers();
        let own = &mut self.builder.list.own;
        let base = u32::try_from(own.buffers.positions.len()).expect("few corners");
        let moved: Vec<Plane> = cards
            .cards
            .iter()
            .zip(parents)
            .map(|(card, &parent)| between(&card.plane, &planes[parent as usize], card.mean, t))
            .collect();
        // in the shared geometry's own order, so that its indices hold here too
        for (card, plane) in cards.cards.iter().zip(&moved) {
            for (side, drawn) in SIDES.into_iter().zip(&card.sides) {
                let Some(drawn) = drawn else { continue };
                let normal = match side {
                    Side::Front => plane.normal,
                    Side::Back => -plane.normal,
                };
                for &corner in &card.corners {
                    let foot = corner - plane.normal * plane.distance(corner);
                    own.buffers.positions.push(foot.as_vec3());
                    own.buffers.normals.push(normal.as_vec3());
                }
                let range = drawn.vertices.start as usize..drawn.vertices.end as usize;
                own.buffers.uvs.extend_from_slice(&shared.uvs[range.clone()]);
                own.buffers.base.extend_from_slice(&shared.base[range.clone()]);
                own.buffers.front.extend_from_slice(&shared.front[range.clone()]);
                own.buffers.back.extend_from_slice(&shared.back[range]);
            }
        }
        let end = u32::try_from(own.buffers.positions.len()).expect("few corners");
        own.dirty_vertices.push(base..end);
        self.chosen(crown, cards, |card| moved[card], Source::Own, base, fade);
    }

    /// Draws the side of each card that the view sees, in indices of this frame's own.
    fn chosen(
        &mut self,
        crown: &Crown,
        cards: &Cards,
        plane_of: impl Fn(usize) -> Plane,
        vertices: Source,
        base: u32,
        fade: f64,
    ) {
        self.flush();
        let viewer = Viewer::new(self.view, crown);
        let mut order: Vec<usize> = (0..cards.cards.len()).collect();
        if self.drawing == Drawing::Blend {
            let distances: Vec<f64> = order
                .iter()
                .map(|&card| {
                    let (plane, mean) = (plane_of(card), cards.cards[card].mean);
                    viewer.distance(mean - plane.normal * plane.distance(mean))
                })
                .collect();
            order.sort_by(|&a, &b| distances[b].total_cmp(&distances[a]).then(a.cmp(&b)));
        }
        let shared = cards.geometry.buffers();
        let own = &mut self.builder.list.own;
        let start = u32::try_from(own.buffers.indices.len() / 3).expect("fits in u32");
        for card in order {
            let drawn = cards.cards[card].drawn(viewer.side(&plane_of(card)));
            let range = drawn.triangles.start as usize..drawn.triangles.end as usize;
            let corners = &shared.indices[range.start * 3..range.end * 3];
            own.buffers.indices.extend(corners.iter().map(|corner| corner + base));
            own.buffers.source_ids.extend_from_slice(&shared.source_ids[range]);
        }
        let end = u32::try_from(own.buffers.indices.len() / 3).expect("fits in u32");
        own.dirty_indices.push(start * 3..end * 3);
        let instances = self.instance(crown, fade);
        let item = self.item(cards, [vertices, Source::Own], start..end, instances);
        if self.drawing == Drawing::Blend {
            self.builder.push_blended(crown, item);
        } else {
            self.builder.list.items.push(item);
        }
    }

    fn instance(&mut self, crown: &Crown, fade: f64) -> Range<u32> {
        #[expect(clippy::cast_possible_truncation, reason = "a share")]
        let fade = fade as f32;
        // neighbours fade in other patterns
        let seed = crown.key.1;
        self.builder.list.instance(Instance { fade, seed, ..crown.instance(self.view) })
    }

    fn item(
        &mut self,
        cards: &Cards,
        [vertices, indices]: [Source; 2],
        primitives: Range<u32>,
        instances: Range<u32>,
    ) -> Item {
        let sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: Filter::Trilinear };
        let list = &mut self.builder.list;
        let surface = match &cards.picture {
            Picture::Direct(texture) => {
                Surface::Textured { texture: list.texture(texture), sampler }
            }
            Picture::Indirect { map, leaf } => {
                let (distribution, leaves) = (list.distribution(map), list.texture(leaf));
                Surface::Indirect { distribution, leaves, sampler }
            }
        };
        let blend = match self.drawing {
            Drawing::Test => Blend::Test(CUTOFF),
            Drawing::Coverage => Blend::Coverage,
            Drawing::Blend => Blend::Over,
        };
        Item {
            primitive: Primitive::Triangles,
            vertices,
            indices,
            primitives,
            instances,
            surface,
            blend,
            depth_write: blend != Blend::Over,
            slab: None,
        }
    }

    fn flush(&mut self) {
        if let Some((_, item)) = self.waiting.take() {
            self.builder.list.items.push(item);
        }
    }

    /// Adds what still waits.
    pub(super) fn finish(mut self) {
        self.flush();
    }
}

/// A plane a share `t` of the way to another: its normal turns at a constant rate, and the foot of the
/// leaves' mean wanders in a straight line.
pub(super) fn between(from: &Plane, to: &Plane, mean: DVec3, t: f64) -> Plane {
    let sign = if from.normal.dot(to.normal) < 0.0 { -1.0 } else { 1.0 };
    let target = to.normal * sign;
    let angle = libm::atan2(from.normal.cross(target).length(), from.normal.dot(target));
    let sine = libm::sin(angle);
    let normal = if sine > 0.0 {
        let (rest, gone) = (libm::sin((1.0 - t) * angle) / sine, libm::sin(t * angle) / sine);
        (from.normal * rest + target * gone).normalize()
    } else {
        from.normal
    };
    let foot = mean - to.normal * to.distance(mean);
    let on_plane = mean - from.normal * from.distance(mean);
    // not with the sign of a fitted plane: its front stays its front
    Plane { normal, d: -on_plane.lerp(foot, t).dot(normal) }
}
