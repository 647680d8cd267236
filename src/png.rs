//! Pictures as PNG files' bytes; whoever calls writes the file.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use crate::error::{LodError, check_in};
use crate::view::MAX_FRAME_SIDE;

/// A PNG of 8-bit sRGB pixels: 3 channels, or 4 with straight alpha.
///
/// # Errors
/// [`LodError::OutOfRange`] for sides of 0 or above 16384; [`LodError::Invalid`] for other channel
/// counts or a wrong number of bytes.
pub fn encode(
    width: usize,
    height: usize,
    channels: usize,
    pixels: &[u8],
) -> Result<Vec<u8>, LodError> {
    let side = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
    let (width, height) = (side(width), side(height));
    check_in("picture", width, 1..=MAX_FRAME_SIDE)?;
    check_in("picture", height, 1..=MAX_FRAME_SIDE)?;
    let invalid = |why: String| LodError::Invalid { name: "picture", why };
    let color = match channels {
        3 => ExtendedColorType::Rgb8,
        4 => ExtendedColorType::Rgba8,
        _ => return Err(invalid(format!("must have 3 or 4 channels, got {channels}"))),
    };
    if pixels.len() as u64 != u64::from(width) * u64::from(height) * channels as u64 {
        let why = format!("{} bytes for {width} x {height} x {channels}", pixels.len());
        return Err(invalid(why));
    }
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Default, FilterType::Adaptive)
        .write_image(pixels, width, height, color)
        .map_err(|error| invalid(error.to_string()))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_survive() {
        let pixels: Vec<u8> = (0..5 * 3 * 4).collect();
        let bytes = encode(5, 3, 4, &pixels).expect("valid");
        let decoded = image::load_from_memory(&bytes).expect("a PNG").into_rgba8();
        assert_eq!((decoded.dimensions(), decoded.into_raw()), ((5, 3), pixels), "unchanged");
    }

    #[test]
    fn bad_pictures_are_refused() {
        assert!(encode(0, 3, 4, &[]).is_err(), "no column");
        assert!(encode(1, 1, 2, &[0; 2]).is_err(), "two channels");
        assert!(encode(2, 2, 3, &[0; 11]).is_err(), "a byte short");
    }
}
