//! Colour for texels that show nothing, so that no dark rim appears where a filter reaches them.
//!
//! Push-pull: colours are averaged into ever coarser levels, weighted by alpha, and empty texels take
//! the colour of the finest level that has one. Texels with any alpha keep theirs.
//!
//! This work is based on:
//! Steven Gortler, Radek Grzeszczuk, Richard Szeliski, Michael Cohen. The Lumigraph. 1996

use glam::{Vec3, Vec4, Vec4Swizzles};

use crate::texture::linear::LinearImage;
use crate::texture::srgb::{srgb8_from_linear, unorm8};
use crate::texture::texture::Image;

/// Straight 8-bit sRGB of a premultiplied picture, with colour in every texel if any has one.
pub fn dilated(image: &LinearImage) -> Image {
    let mut levels = vec![image.clone()];
    while levels.last().is_some_and(|level| level.width > 1 || level.height > 1) {
        let halved = levels.last().expect("just seen").halved();
        levels.push(halved);
    }
    let texels = (0..image.height)
        .flat_map(|y| (0..image.width).map(move |x| (x, y)))
        .map(|(x, y)| {
            let own = image.texel(x, y);
            let [r, g, b] = color_at(&levels, x, y).to_array().map(srgb8_from_linear);
            [r, g, b, unorm8(own.w)]
        })
        .collect();
    Image { width: image.width, height: image.height, texels }
}

/// Straight colour of the finest level that has one above a texel; black if none has.
fn color_at(levels: &[LinearImage], x: u32, y: u32) -> Vec3 {
    for level in levels {
        let base = &levels[0];
        // the level's texel that lies over this one
        let column = u64::from(x) * u64::from(level.width) / u64::from(base.width);
        let row = u64::from(y) * u64::from(level.height) / u64::from(base.height);
        let texel: Vec4 = level
            .texel(u32::try_from(column).expect("inside"), u32::try_from(row).expect("inside"));
        if texel.w > 0.0 {
            return texel.xyz() / texel.w;
        }
    }
    Vec3::ZERO
}

#[cfg(test)]
mod tests {
    use super::*;

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
