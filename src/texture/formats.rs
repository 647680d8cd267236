//! How a bake is stored: what its texels become, and how many bytes they take.
//!
//! A texture is drawn from what its format gives back and not from what went in, so an error shows
//! what the bytes beside it cost.

use crate::error::LodError;
use crate::texture::blocks::Blocks;
use crate::texture::dilate::Check;
use crate::texture::palette;
use crate::texture::texture::Image;

/// How a bake is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Format {
    /// Eight bits a colour and eight of alpha: four bytes a texel.
    #[default]
    Rgba8,
    /// Five bits a colour and one of alpha: two bytes a texel.
    Rgb5a1,
    /// Eight bits a colour, and black is transparent: three bytes a texel.
    Rgb8,
    /// One of 256 colours with alpha: a byte a texel, and 1 KiB a texture.
    Palette8,
    /// Blocks of 4 x 4 with alpha of one bit: half a byte a texel.
    Bc1,
    /// Blocks of 4 x 4 with alpha of its own: a byte a texel.
    Bc3,
    /// Blocks of 4 x 4, each in the way that suits it best: a byte a texel.
    Bc7,
}

impl Format {
    /// Every format by its name.
    pub const ALL: [(&'static str, Self); 7] = [
        ("rgba8", Self::Rgba8),
        ("rgb5a1", Self::Rgb5a1),
        ("rgb8", Self::Rgb8),
        ("palette8", Self::Palette8),
        ("bc1", Self::Bc1),
        ("bc3", Self::Bc3),
        ("bc7", Self::Bc7),
    ];

    /// Replaces the texels of a texture's levels by those that the format gives back.
    ///
    /// # Errors
    /// Whatever `check` returns, which is called often so that a long run can be stopped.
    pub fn store(self, levels: &mut [Image], check: &Check<'_>) -> Result<(), LodError> {
        match self {
            Self::Rgba8 => Ok(()),
            Self::Rgb5a1 => each_texel(levels, rgb5a1, check),
            Self::Rgb8 => each_texel(levels, rgb8, check),
            Self::Palette8 => palette::store(levels, check),
            Self::Bc1 => each_level(levels, Blocks::Bc1, check),
            Self::Bc3 => each_level(levels, Blocks::Bc3, check),
            Self::Bc7 => each_level(levels, Blocks::Bc7, check),
        }
    }

    /// Bytes of a texture's levels.
    pub fn byte_count(self, levels: &[Image]) -> u64 {
        let texel_count: u64 = levels.iter().map(|level| level.texels.len() as u64).sum();
        let of_blocks = |blocks: Blocks| {
            levels.iter().map(|level| blocks.byte_count(level.width, level.height)).sum()
        };
        match self {
            Self::Rgba8 => texel_count * 4,
            Self::Rgb5a1 => texel_count * 2,
            Self::Rgb8 => texel_count * 3,
            Self::Palette8 => texel_count + palette::PALETTE_BYTES,
            Self::Bc1 => of_blocks(Blocks::Bc1),
            Self::Bc3 => of_blocks(Blocks::Bc3),
            Self::Bc7 => of_blocks(Blocks::Bc7),
        }
    }
}

fn each_texel(
    levels: &mut [Image],
    store: fn([u8; 4]) -> [u8; 4],
    check: &Check<'_>,
) -> Result<(), LodError> {
    for level in levels {
        check()?;
        level.texels.iter_mut().for_each(|texel| *texel = store(*texel));
    }
    Ok(())
}

fn each_level(levels: &mut [Image], blocks: Blocks, check: &Check<'_>) -> Result<(), LodError> {
    levels.iter_mut().try_for_each(|level| blocks.store(level, check))
}

/// The nearest texel that five bits a colour and one of alpha can hold.
fn rgb5a1([r, g, b, a]: [u8; 4]) -> [u8; 4] {
    let five = |code: u8| {
        let short = (u16::from(code) * 31 + 127) / 255;
        u8::try_from((short << 3) | (short >> 2)).expect("eight bits")
    };
    [five(r), five(g), five(b), if a >= 128 { 255 } else { 0 }]
}

/// The texel that black stands for, if it shows less than half; black itself becomes the next blue.
fn rgb8([r, g, b, a]: [u8; 4]) -> [u8; 4] {
    match [r, g, b] {
        _ if a < 128 => [0; 4],
        [0, 0, 0] => [0, 0, 1, 255],
        _ => [r, g, b, 255],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texture::srgb::srgb8_from_linear;

    fn image(width: u32, height: u32, texels: Vec<[u8; 4]>) -> Image {
        Image::new(width, height, texels).expect("valid")
    }

    #[test]
    fn short_texels_keep_white_and_black() {
        assert_eq!(rgb5a1([255, 0, 8, 127]), [255, 0, 8, 0], "one step of 8");
        assert_eq!(rgb5a1([128, 4, 250, 128]), [132, 0, 247, 255], "the nearest of 32 steps");
    }

    #[test]
    fn black_is_transparent_and_what_was_black_is_not() {
        assert_eq!(rgb8([9, 8, 7, 127]), [0; 4], "shows less than half");
        assert_eq!(rgb8([9, 8, 7, 128]), [9, 8, 7, 255], "shows half");
        assert_eq!(rgb8([0, 0, 0, 255]), [0, 0, 1, 255], "a black that shows");
    }

    #[test]
    fn bytes_are_those_of_every_level() {
        // 6 x 5, 3 x 2 and 1 x 1: 37 texels in 4, 1 and 1 blocks
        let levels = [
            image(6, 5, vec![[1; 4]; 30]),
            image(3, 2, vec![[1; 4]; 6]),
            image(1, 1, vec![[1; 4]; 1]),
        ];
        let bytes = Format::ALL.map(|(_, format)| format.byte_count(&levels));
        assert_eq!(bytes, [148, 74, 111, 37 + 1024, 48, 96, 96], "in the order of the names");
    }

    #[test]
    fn what_is_stored_stays_when_it_is_stored_again() {
        let texels = |side: u32| -> Vec<[u8; 4]> {
            let code = |value: u32| u8::try_from(value % 256).expect("below 256");
            (0..side * side)
                .map(|i| [code(i * 3), code(i * 5), code(i / 7), code(i * 11)])
                .collect()
        };
        for (name, format) in Format::ALL {
            let mut once = [image(32, 32, texels(32)), image(16, 16, texels(16))];
            let before = once.clone();
            format.store(&mut once, &|| Ok(())).expect("never stopped");
            assert_eq!(once == before, format == Format::Rgba8, "{name} changes texels");
            // blocks are fitted anew, and may fit what they gave back better
            if matches!(format, Format::Rgba8 | Format::Rgb5a1 | Format::Rgb8 | Format::Palette8) {
                let mut twice = once.clone();
                format.store(&mut twice, &|| Ok(())).expect("never stopped");
                assert_eq!(twice, once, "{name}");
            }
        }
    }

    #[test]
    fn better_formats_are_nearer() {
        let side = 64_u32;
        let wave = |x: f32| srgb8_from_linear(libm::sinf(x) * 0.5 + 0.5);
        let texels: Vec<[u8; 4]> = (0..side * side)
            .map(|i| {
                let [x, y] =
                    [i % side, i / side].map(|side| f32::from(u16::try_from(side).expect("small")));
                [wave(x * 0.3), wave(y * 0.2), wave(x * 0.1 + y * 0.1), wave(x * 0.2 - y * 0.15)]
            })
            .collect();
        let error = |format: Format| {
            let mut levels = [image(side, side, texels.clone())];
            format.store(&mut levels, &|| Ok(())).expect("never stopped");
            let shown =
                |[r, g, b, a]: [u8; 4]| [r, g, b].map(|c| f64::from(c) * f64::from(a) / 255.0);
            let squares = levels[0].texels.iter().zip(&texels).map(|(found, texel)| {
                let (found, texel) = (shown(*found), shown(*texel));
                (0..3).map(|c| (found[c] - texel[c]).powi(2)).sum::<f64>()
            });
            (squares.sum::<f64>() / texels.len() as f64).sqrt()
        };
        let [bc1, bc3, bc7] = [Format::Bc1, Format::Bc3, Format::Bc7].map(error);
        assert!(bc7 < bc3 && bc3 < bc1, "{bc7} {bc3} {bc1}");
        // four waves of their own directions: no two ends of a block follow them all
        assert!(bc7 < 12.0, "{bc7}: of 255");
        assert!(error(Format::Palette8) < error(Format::Rgb5a1), "alpha of one bit costs more");
    }
}
