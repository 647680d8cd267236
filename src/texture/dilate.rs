//! Colour for texels that show nothing, so that no dark rim appears where a filter reaches them.
//!
//! Push-pull: colours are averaged into ever coarser levels, weighted by alpha, and empty texels take
//! the colour of the finest level that has one. Texels with any alpha keep theirs.
//!
//! This work is based on:
//! Steven Gortler, Radek Grzeszczuk, Richard Szeliski, Michael Cohen. The Lumigraph. 1996

use glam::{Vec3, Vec4, Vec4Swizzles};
use rayon::prelude::*;

use crate::error::LodError;
use crate::texture::linear::LinearImage;
use crate::texture::srgb::{srgb8_from_linear, unorm8};
use crate::texture::texture::Image;

/// Called often by what may take long; its error ends the work.
pub type Check<'a> = dyn Fn() -> Result<(), LodError> + Sync + 'a;

/// Straight 8-bit sRGB of a premultiplied picture, with colour in every texel if any has one.
///
/// # Errors
/// Whatever `check` returns.
pub fn dilated(image: &LinearImage, check: &Check<'_>) -> Result<Image, LodError> {
    let texels = dilated_as(image, check, |color, alpha| {
        let [r, g, b] = color.to_array().map(srgb8_from_linear);
        [r, g, b, unorm8(alpha)]
    })?;
    Ok(Image { width: image.width, height: image.height, texels })
}

/// What `encode` makes of each texel's straight colour, which every texel has if any has one, and its
/// alpha.
///
/// # Errors
/// Whatever `check` returns.
pub fn dilated_as<T: Copy + Default + Send>(
    image: &LinearImage,
    check: &Check<'_>,
    encode: impl Fn(Vec3, f32) -> T + Sync,
) -> Result<Vec<T>, LodError> {
    let mut coarser: Vec<LinearImage> = Vec::new();
    loop {
        check()?;
        let last = coarser.last().unwrap_or(image);
        if last.width == 1 && last.height == 1 {
            break;
        }
        let halved = last.halved();
        coarser.push(halved);
    }
    // where each column of the image lies on every coarser level
    let columns: Vec<Vec<usize>> = coarser
        .iter()
        .map(|level| (0..image.width).map(|x| place(x, level.width, image.width)).collect())
        .collect();
    let width = image.width as usize;
    let mut texels = vec![T::default(); image.texels.len()];
    let rows =
        texels.par_chunks_mut(width).zip(image.texels.par_chunks(width)).zip(0..image.height);
    rows.try_for_each(|((row, finest), y)| {
        check()?;
        let coarser_rows: Vec<(&[Vec4], &[usize])> = coarser
            .iter()
            .zip(&columns)
            .map(|(level, columns)| {
                let start = place(y, level.height, image.height) * level.width as usize;
                (&level.texels[start..start + level.width as usize], &columns[..])
            })
            .collect();
        for (x, (texel, finest)) in row.iter_mut().zip(finest).enumerate() {
            let above = || coarser_rows.iter().map(|(row, columns)| row[columns[x]]);
            // the finest level that has a colour here
            let seen = if finest.w > 0.0 { Some(*finest) } else { above().find(|t| t.w > 0.0) };
            let color = seen.map_or(Vec3::ZERO, |seen| seen.xyz() / seen.w);
            *texel = encode(color, finest.w);
        }
        Ok(())
    })?;
    Ok(texels)
}

/// The column or row of a level that lies over one of its base.
fn place(at: u32, size: u32, base_size: u32) -> usize {
    let inside = u64::from(at) * u64::from(size) / u64::from(base_size);
    usize::try_from(inside).expect("inside")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dilated(image: &LinearImage) -> Image {
        super::dilated(image, &|| Ok(())).expect("nobody stops it")
    }

    #[test]
    fn empty_texels_take_their_neighbours_colour() {
        //  g . . .
        //  . . . .     g green, r half-transparent red
        //  . . . .
        //  . . . r
        let mut texels = vec![Vec4::ZERO; 16];
        texels[0] = Vec4::new(0.0, 1.0, 0.0, 1.0);
        texels[15] = Vec4::new(0.5, 0.0, 0.0, 0.5);
        let image = dilated(&LinearImage { width: 4, height: 4, texels });
        assert_eq!(image.texel(0, 0), [0, 255, 0, 255], "kept");
        assert_eq!(image.texel(1, 1), [0, 255, 0, 0], "green, still transparent");
        assert_eq!(image.texel(3, 3), [255, 0, 0, 128], "straight red");
        assert_eq!(image.texel(2, 2), [255, 0, 0, 0], "red beside it");
        // the far corners see both: two parts green to one part red, by alpha
        let corner = image.texel(3, 0);
        assert_eq!(corner[3], 0, "transparent");
        assert!(corner[1] > corner[0] && corner[0] > 0, "a mixture: {corner:?}");
    }

    #[test]
    fn nothing_gives_black() {
        let image = dilated(&LinearImage { width: 3, height: 2, texels: vec![Vec4::ZERO; 6] });
        assert_eq!(image.texels, [[0; 4]; 6], "no colour anywhere");
    }
}
