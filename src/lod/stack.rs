//! Stacks of parallel slices: how a slab's leaves become a card with a texture, and how the slices of
//! several stacks are painted over one another.

use std::ops::Range;
use std::sync::Arc;

use glam::{DVec2, DVec3, Vec2, Vec3, Vec4};
use rayon::prelude::*;

use crate::bake::{BakeRect, Renderers, bake, finish, levels, stored};
use crate::draw_list::{Blend, Buffers, DrawList, Geometry, Item, Primitive, Source, Surface};
use crate::error::{LodError, check_in};
use crate::job::Job;
use crate::lod::leaves::Leaves;
use crate::lod::opacity::SilhouetteAlpha;
use crate::lod::slabs::Assignment;
use crate::lod::viewer::Viewer;
use crate::lod::{Crown, Footprint, ListBuilder, NamedTexture};
use crate::plant::Mesh;
use crate::raster::samples;
use crate::texture::mips::Keep;
use crate::texture::quadtree;
use crate::texture::texture::check_size;
use crate::texture::{Filter, Format, LinearImage, Sampler, Texture, Wrap};
use crate::view::View;

/// Texels of all slices together: 2 GiB of RGBA8 without mips.
pub(crate) const MAX_TOTAL_TEXELS: u64 = 1 << 29;

/// Texels of slices that are drawn side by side: half a gigabyte of planes and their copies.
const MAX_TEXELS_AT_ONCE: u64 = 1 << 24;

/// More stacks or slices than this are taken for a mistake.
pub(crate) const MAX_COUNT: usize = 4096;

/// How slices are read.
const SAMPLER: Sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: Filter::Trilinear };

/// One slice: a card with a texture, or nothing where no leaf is.
#[derive(Debug, Clone)]
pub(crate) struct Slice {
    /// Of its plane from the crown's centre, along the stack's direction.
    pub(crate) offset: f64,
    pub(crate) baked: Option<Baked>,
}

/// What a slice shows.
#[derive(Debug, Clone)]
pub(crate) struct Baked {
    pub(crate) rect: BakeRect,
    /// One for all of the picture, or those squares of it that are not empty.
    pub(crate) tiles: Vec<Tile>,
    /// What stands for squares from afar.
    far: Option<Far>,
}

/// A texture on a part of a slice's card.
#[derive(Debug, Clone)]
pub(crate) struct Tile {
    pub(crate) texture: Arc<Texture>,
    /// Its cards in the shared geometry, one for each cell.
    pub(crate) cards: Range<u32>,
    /// Column and row, among the cells of the whole slice, of each card.
    pub(crate) cells: Vec<[usize; 2]>,
    /// The part of the slice's card that it covers.
    pub(crate) area: Area,
    /// Coordinates of its own texture at the corners of that part.
    pub(crate) uvs: Area,
}

/// The coarser levels of a picture that is kept in squares.
#[derive(Debug, Clone)]
struct Far {
    tile: Tile,
    /// Metres of a pixel from which on these levels are enough.
    pixel_size: f64,
}

impl Baked {
    /// What is drawn where a pixel is that large, in metres.
    pub(crate) fn shown(&self, pixel_size: f64) -> &[Tile] {
        match &self.far {
            Some(far) if pixel_size >= far.pixel_size => std::slice::from_ref(&far.tile),
            _ => &self.tiles,
        }
    }

    /// All its textures.
    fn all(&self) -> impl Iterator<Item = &Tile> {
        self.tiles.iter().chain(self.far.iter().map(|far| &far.tile))
    }

    /// Where a tile's texture lies, its border included.
    fn rect_of(&self, tile: &Tile) -> BakeRect {
        let [area, uvs] = [tile.area, tile.uvs].map(|corners| corners.map(|c| c.as_dvec2()));
        let scale = (area[1] - area[0]) / (uvs[1] - uvs[0]);
        let (low, high) = (area[0] - uvs[0] * scale, area[1] + (DVec2::ONE - uvs[1]) * scale);
        let middle = (low + high) / 2.0 - DVec2::splat(0.5);
        let rect = &self.rect;
        let across = rect.right * (middle.x * rect.width) - rect.up * (middle.y * rect.height);
        BakeRect {
            center: rect.center + across,
            width: rect.width * (high.x - low.x),
            height: rect.height * (high.y - low.y),
            ..*rect
        }
    }
}

/// Parallel slices.
#[derive(Debug, Clone)]
pub(crate) struct Stack {
    /// Unit vector across the slices, from the crown to a viewer.
    pub(crate) toward: DVec3,
    /// In order of rising offset.
    pub(crate) slices: Vec<Slice>,
}

impl Stack {
    /// Slices that show something, with their indices.
    pub(crate) fn baked(&self) -> impl Iterator<Item = (usize, &Baked)> {
        let slices = self.slices.iter().enumerate();
        slices.filter_map(|(index, slice)| Some((index, slice.baked.as_ref()?)))
    }

    /// Its textures, `name` before the number of the slice.
    pub(crate) fn textures(&self, name: &str) -> impl Iterator<Item = NamedTexture> {
        self.baked().flat_map(move |(index, baked)| {
            let slice = format!("{name}, slice {index}");
            let alone = baked.far.is_none();
            baked.all().enumerate().map(move |(number, tile)| NamedTexture {
                name: if alone {
                    slice.clone()
                } else if number < baked.tiles.len() {
                    format!("{slice}, square {number}")
                } else {
                    format!("{slice}, from afar")
                },
                texture: Arc::clone(&tile.texture),
                rect: Some(baked.rect_of(tile)),
            })
        })
    }

    /// Its slices from the farthest to the nearest but for the first so many, with the rank of each in
    /// [0, 1]. The nearest is always among them.
    pub(crate) fn far_to_near(
        &self,
        viewer: &Viewer,
        drop_back: usize,
    ) -> impl Iterator<Item = (f64, &Slice)> {
        let distance = |slice: &Slice| viewer.distance(self.toward, slice.offset);
        let mut sorted: Vec<&Slice> = self.slices.iter().collect();
        sorted.sort_by(|a, b| distance(b).total_cmp(&distance(a)));
        let count = sorted.len() as f64;
        let ranked = sorted.into_iter().enumerate();
        let dropped = drop_back.min(self.slices.len().saturating_sub(1));
        ranked.skip(dropped).map(move |(index, slice)| ((index as f64 + 0.5) / count, slice))
    }
}

/// The numbers that every baker of slices checks.
///
/// # Errors
/// `slice_count`, `resolution` or `samples` out of range.
pub(crate) fn check(
    slice_count: usize,
    resolution: (u32, u32),
    sample_count: u32,
) -> Result<(), LodError> {
    check_in("slice_count", slice_count, 1..=MAX_COUNT)?;
    check_size("resolution", resolution.0, resolution.1)?;
    samples::positions(sample_count).map(|_| ())
}

/// Cards of a slice with so many cells along each side, at most: squares are cut at the cells' borders.
pub(crate) fn cards_at_most(
    (width, height): (u32, u32),
    grid: usize,
    quadtree: Option<u32>,
) -> u64 {
    let cells = (grid * grid) as u64;
    let Some(least_side) = quadtree else { return cells };
    let [columns, rows] =
        [width, height].map(|side| grid as u64 + u64::from(side.div_ceil(least_side)) - 1);
    columns * rows + cells
}

/// Draws slices and stores them.
#[derive(Debug)]
pub(crate) struct Baker<'a> {
    pictures: Pictures<'a>,
    cards: Cards,
}

/// How pictures are drawn and stored.
#[derive(Debug)]
struct Pictures<'a> {
    sample_count: u32,
    format: Format,
    /// Least side of the squares that pictures are kept in.
    quadtree: Option<u32>,
    job: &'a Job,
    renderers: Renderers,
}

/// The cards of all slices so far.
#[derive(Debug)]
struct Cards {
    buffers: Buffers,
    /// Cells along each side of a slice, with a card each.
    grid: usize,
}

impl<'a> Baker<'a> {
    pub(crate) fn new(
        sample_count: u32,
        format: Format,
        quadtree: Option<u32>,
        grid: usize,
        job: &'a Job,
    ) -> Self {
        let renderers = Renderers::default();
        let pictures = Pictures { sample_count, format, quadtree, job, renderers };
        Self { pictures, cards: Cards { buffers: Buffers::default(), grid } }
    }

    /// The slices of an assignment; adds their coverage to `alpha`, and a step to the job for each.
    ///
    /// # Errors
    /// If the rectangle is out of range; [`LodError::Cancelled`].
    pub(crate) fn stack(
        &mut self,
        leaves: &Leaves<'_>,
        assignment: &Assignment,
        resolution: (u32, u32),
        alpha: &mut SilhouetteAlpha,
    ) -> Result<Stack, LodError> {
        let pictures = &self.pictures;
        pictures.job.check()?;
        let layout = &assignment.layout;
        let view = assignment.rect.view(resolution)?;
        let draw = |slice: usize| {
            let list = leaves.list(&view, &assignment.leaves[slice], assignment.slab(slice));
            let image = pictures.drawn(&list, &view)?;
            let is_empty = image.texels.iter().all(|texel| texel.w == 0.0);
            let textures = if is_empty { None } else { Some(pictures.stored(&image)?) };
            pictures.job.advance();
            Ok((image, textures))
        };
        let mut slices = Vec::new();
        while slices.len() < layout.count {
            let next = slices.len()..layout.count.min(slices.len() + at_once(resolution));
            let drawn: Result<Vec<_>, LodError> = next.into_par_iter().map(draw).collect();
            for (image, textures) in drawn? {
                alpha.add(&image);
                let slice = slices.len();
                let rect = assignment.card(slice);
                let baked = textures.map(|textures| self.cards.placed(rect, textures, resolution));
                slices.push(Slice { offset: layout.offset(slice), baked });
            }
        }
        alpha.next_slicing();
        Ok(Stack { toward: layout.toward, slices })
    }

    /// All cards, in the order in which they were baked.
    pub(crate) fn into_cards(self) -> Arc<Geometry> {
        Geometry::new(self.cards.buffers)
    }
}

impl Pictures<'_> {
    fn drawn(&self, list: &DrawList, view: &View) -> Result<LinearImage, LodError> {
        self.renderers.with(|renderer| bake(renderer, list, view, self.sample_count, self.job))
    }

    /// A picture as it is stored: its squares, and what stands for them from afar; the picture itself
    /// without a quad-tree.
    fn stored(&self, image: &LinearImage) -> Result<Stored, LodError> {
        let Some(least_side) = self.quadtree else {
            let texture = finish(image, Keep::MeanAlpha, self.format, self.job)?;
            return Ok(Stored { squares: vec![(WHOLE, WHOLE, texture)], far: None });
        };
        let mut levels = levels(image, Keep::MeanAlpha, self.job)?;
        let border_levels = quadtree::border_levels(least_side);
        let border = 1_u32 << border_levels;
        let size = Vec2::new(image.width as f32, image.height as f32);
        let squares: Result<Vec<_>, LodError> = quadtree::cells(&levels[0], least_side, border)
            .iter()
            .map(|cell| {
                let low = Vec2::new(cell.x as f32, cell.y as f32);
                let sides = Vec2::new(cell.width as f32, cell.height as f32);
                let edge = Vec2::splat(border as f32);
                let full = sides + edge * 2.0;
                let levels = quadtree::cut(&levels, cell, border_levels);
                let texture = stored(levels, self.format, self.job)?;
                let area = [low / size, (low + sides) / size];
                Ok((area, [edge / full, (edge + sides) / full], texture))
            })
            .collect();
        let coarsest = (border_levels as usize).min(levels.len() - 1);
        let far = stored(levels.split_off(coarsest), self.format, self.job)?;
        Ok(Stored { squares: squares?, far: Some((far, f64::from(border))) })
    }
}

impl Cards {
    /// A stored picture on its rectangle.
    fn placed(&mut self, rect: BakeRect, stored: Stored, (width, height): (u32, u32)) -> Baked {
        let grid = self.grid;
        let mut tile = |(area, uvs, texture): (Area, Area, Arc<Texture>)| {
            let first = self.buffers.indices.len() / 4;
            let mut cells = Vec::new();
            for cell in (0..grid * grid).map(|cell| [cell % grid, cell / grid]) {
                let corner = |step: usize| {
                    let at = cell.map(|at| (at + step) as f32 / grid as f32);
                    Vec2::from(at).clamp(area[0], area[1])
                };
                let part = [corner(0), corner(1)];
                if part[0].x < part[1].x && part[0].y < part[1].y {
                    let scale = (uvs[1] - uvs[0]) / (area[1] - area[0]);
                    let uv = |at: Vec2| uvs[0] + (at - area[0]) * scale;
                    let coordinates = if part == area { uvs } else { part.map(uv) };
                    push_card(&mut self.buffers, &rect, part, coordinates);
                    cells.push(cell);
                }
            }
            let cards = [first, self.buffers.indices.len() / 4];
            let [start, end] = cards.map(|at| u32::try_from(at).expect("few cards"));
            Tile { texture, cards: start..end, cells, area, uvs }
        };
        let tiles = stored.squares.into_iter().map(&mut tile).collect();
        let far = stored.far.map(|(texture, texels)| {
            let texel = (rect.width / f64::from(width)).max(rect.height / f64::from(height));
            Far { tile: tile((WHOLE, WHOLE, texture)), pixel_size: texel * texels }
        });
        Baked { rect, tiles, far }
    }
}

/// Smallest box around the corners of meshes and cards, one of which is not empty.
pub(crate) fn bounds(meshes: &[&Mesh], cards: &[&Geometry]) -> (DVec3, DVec3) {
    let of_mesh = |mesh: &Mesh| mesh.bounds().map(|(low, high)| [low, high]);
    let boxes = meshes.iter().filter_map(|mesh| of_mesh(mesh)).flatten();
    let of_cards = cards.iter().flat_map(|cards| cards.buffers().positions.iter().copied());
    let corners = boxes.chain(of_cards).map(|p| p.as_dvec3());
    let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    corners.fold(none, |(low, high), corner| (low.min(corner), high.max(corner)))
}

/// What stacks hold beside the part of a plant that stays a mesh.
pub(crate) fn footprint(stacks: &[&Stack], cards: &Geometry, solid: Footprint) -> Footprint {
    let baked = stacks.iter().flat_map(|stack| stack.baked());
    let tiles = baked.flat_map(|(_, baked)| baked.all());
    let texture_bytes: u64 = tiles.map(|tile| tile.texture.byte_count()).sum();
    let buffers = cards.buffers();
    Footprint {
        card_count: solid.card_count + (buffers.indices.len() / 4) as u64,
        geometry_bytes: solid.geometry_bytes + buffers.byte_count(),
        texture_bytes: solid.texture_bytes + texture_bytes,
        ..solid
    }
}

/// Textures of a slice.
struct Stored {
    /// Part of the slice, coordinates of the texture there, the texture.
    squares: Vec<(Area, Area, Arc<Texture>)>,
    /// The coarser levels, and how many texels a pixel must be wide for them.
    far: Option<(Arc<Texture>, f64)>,
}

/// Slices drawn side by side: one a thread, unless their texels would take much memory.
fn at_once((width, height): (u32, u32)) -> usize {
    let fitting = MAX_TEXELS_AT_ONCE / (u64::from(width) * u64::from(height));
    usize::try_from(fitting).unwrap_or(usize::MAX).clamp(1, rayon::current_num_threads())
}

/// A rectangle of texture coordinates: its upper left corner and its lower right one.
pub(crate) type Area = [Vec2; 2];

/// All of a picture.
pub(crate) const WHOLE: Area = [Vec2::ZERO, Vec2::ONE];

/// Appends the part of a slice's card that an area of its picture covers; it is white, for its texture
/// is lit. `uvs` are the texture's coordinates at the corners of the area.
pub(crate) fn push_card(buffers: &mut Buffers, rect: &BakeRect, area: Area, uvs: Area) -> u32 {
    let first = u32::try_from(buffers.positions.len()).expect("few cards");
    let [lower_left, lower_right, _, upper_left] = rect.corners();
    let (across, down) = (lower_right - lower_left, lower_left - upper_left);
    // counter-clockwise from the lower left
    for (x, y) in [(0, 1), (1, 1), (1, 0), (0, 0)] {
        let [u, v] = [area[x].x, area[y].y].map(f64::from);
        buffers.positions.push((upper_left + across * u + down * v).as_vec3());
        buffers.normals.push(rect.toward().as_vec3());
        buffers.uvs.push(Vec2::new(uvs[x].x, uvs[y].y));
        buffers.base.push(Vec4::ONE);
        buffers.front.push(Vec3::ONE);
        buffers.back.push(Vec3::ONE);
    }
    buffers.indices.extend(first..first + 4);
    first / 4
}

/// A stack with the opacity that a view draws it with.
pub(crate) type Mixed<'a> = (&'a Stack, f64);

/// An instance of a crown's cards, as opaque as that.
pub(crate) fn instance(
    view: &View,
    crown: &Crown,
    opacity: f64,
    builder: &mut ListBuilder,
) -> Range<u32> {
    let mut instance = crown.instance(view);
    #[expect(clippy::cast_possible_truncation, reason = "an opacity")]
    let stored = opacity as f32;
    instance.tint.w = stored;
    builder.list.instance(instance)
}

/// Cards that are blended over what lies behind.
pub(crate) fn card_item(
    source: Source,
    cards: Range<u32>,
    texture: &Arc<Texture>,
    instances: Range<u32>,
    builder: &mut ListBuilder,
) -> Item {
    Item {
        primitive: Primitive::Cards,
        vertices: source,
        indices: source,
        primitives: cards,
        instances,
        surface: Surface::Textured { texture: builder.list.texture(texture), sampler: SAMPLER },
        blend: Blend::Over,
        depth_write: false,
        slab: None,
    }
}

/// How slices are drawn that a view mixes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Drawing {
    /// Slices of each stack that are left out, the farthest first.
    pub(crate) drop_back: usize,
    /// Metres of a pixel where the crown is nearest.
    pub(crate) pixel_size: f64,
}

/// Paints stacks: the farthest slice of each, then the second farthest of each, and so on; of one rank
/// in the order given.
pub(crate) fn push_stacks(
    view: &View,
    crown: &Crown,
    viewer: &Viewer,
    (cards, drawing): (&Arc<Geometry>, Drawing),
    stacks: &[Mixed<'_>],
    builder: &mut ListBuilder,
) {
    let source = builder.list.geometry(cards);
    // (depth rank in [0, 1], item)
    let mut items: Vec<(f64, Item)> = Vec::new();
    for &(stack, opacity) in stacks {
        let instances = instance(view, crown, opacity, builder);
        for (rank, slice) in stack.far_to_near(viewer, drawing.drop_back) {
            let tiles = slice.baked.iter().flat_map(|baked| baked.shown(drawing.pixel_size));
            for tile in tiles {
                let (cards, instances) = (tile.cards.clone(), instances.clone());
                items.push((rank, card_item(source, cards, &tile.texture, instances, builder)));
            }
        }
    }
    // stable: of one rank in the order given
    items.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (_, item) in items {
        builder.push_blended(crown, item);
    }
}
