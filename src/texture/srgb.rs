//! The sRGB transfer function, both ways, and its table for 8-bit values.
//!
//! This work is based on:
//! IEC 61966-2-1:1999 (sRGB)

use std::sync::LazyLock;

/// Linear value of every 8-bit sRGB code.
pub static LINEAR_FROM_SRGB8: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|code| {
        #[expect(clippy::cast_possible_truncation, reason = "a table in f32")]
        let linear = linear_from_srgb(code as f64 / 255.0) as f32;
        linear
    })
});

/// Linear value in [0, 1] of an sRGB value in [0, 1].
pub fn linear_from_srgb(encoded: f64) -> f64 {
    if encoded <= 0.04045 { encoded / 12.92 } else { libm::pow((encoded + 0.055) / 1.055, 2.4) }
}

/// sRGB value in [0, 1] of a linear value in [0, 1].
pub fn srgb_from_linear(linear: f64) -> f64 {
    if linear <= 0.003_130_8 {
        linear * 12.92
    } else {
        1.055 * libm::pow(linear, 1.0 / 2.4) - 0.055
    }
}

/// Steps of linear values from which [`Encoder`] guesses: codes lie further apart than these.
const GUESS_COUNT: usize = 4096;

/// What encoding needs to look up.
struct Encoder {
    /// Smallest linear value that rounds to each code; nothing reaches the one after the last.
    starts: [f32; 257],
    /// Code of each step's start. No step holds the starts of two codes.
    guesses: [u8; GUESS_COUNT + 1],
}

static ENCODER: LazyLock<Encoder> = LazyLock::new(|| {
    let mut starts = [f32::INFINITY; 257];
    starts[0] = f32::NEG_INFINITY;
    for (code, start) in starts.iter_mut().enumerate().take(256).skip(1) {
        #[expect(clippy::cast_possible_truncation, reason = "a table in f32")]
        let linear = linear_from_srgb((code as f64 - 0.5) / 255.0) as f32;
        *start = linear;
    }
    let guesses = std::array::from_fn(|step| {
        let linear = step as f32 / GUESS_COUNT as f32;
        let code = starts.partition_point(|&start| start <= linear) - 1;
        u8::try_from(code).expect("256 codes fit in u8")
    });
    Encoder { starts, guesses }
});

/// Nearest 8-bit sRGB code of a linear value; below 0 is 0, above 1 is 255, NaN is 0.
pub fn srgb8_from_linear(linear: f32) -> u8 {
    let steps = GUESS_COUNT as f32;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the guesses"
    )]
    let step = (linear * steps).clamp(0.0, steps) as usize;
    let Encoder { starts, guesses } = &*ENCODER;
    let guess = guesses[step];
    guess.wrapping_add(u8::from(starts[usize::from(guess) + 1] <= linear))
}

/// Nearest 8-bit code of a value in [0, 1] that is stored without a transfer function.
pub fn unorm8(value: f32) -> u8 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let code = (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    code
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_survives_the_round_trip() {
        for code in 0..=255_u8 {
            let linear = LINEAR_FROM_SRGB8[usize::from(code)];
            assert_eq!(srgb8_from_linear(linear), code, "code {code}");
        }
        for (code, &start) in (0..255).zip(&ENCODER.starts[1..256]) {
            assert_eq!(srgb8_from_linear(start), code + 1, "where code {code} ends");
            assert_eq!(srgb8_from_linear(start.next_down()), code, "just before");
        }
        assert_eq!(srgb8_from_linear(-1.0), 0, "below the range");
        assert_eq!(srgb8_from_linear(2.0), 255, "above the range");
        assert_eq!(srgb8_from_linear(f32::NAN), 0, "NaN");
    }

    #[test]
    fn encoding_equals_the_formula() {
        for i in 0..=100_000_u32 {
            let linear = i as f32 / 100_000.0;
            let exact = srgb_from_linear(f64::from(linear)) * 255.0;
            let error = (f64::from(srgb8_from_linear(linear)) - exact).abs();
            assert!(error <= 0.5 + 1e-4, "{linear}: off by {error} codes");
        }
    }
}
