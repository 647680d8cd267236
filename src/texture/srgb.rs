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

/// Smallest linear value that rounds to each 8-bit code, so that encoding is a search.
static CODE_STARTS: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|code| {
        if code == 0 {
            return f32::NEG_INFINITY;
        }
        #[expect(clippy::cast_possible_truncation, reason = "a table in f32")]
        let start = linear_from_srgb((code as f64 - 0.5) / 255.0) as f32;
        start
    })
});

/// First guesses for [`srgb8_from_linear`]: the code of `i / 4096`.
static FIRST_CODES: LazyLock<[u8; 4097]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let linear = i as f32 / 4096.0;
        let code = CODE_STARTS.partition_point(|&start| start <= linear) - 1;
        u8::try_from(code).expect("256 codes fit in u8")
    })
});

/// Nearest 8-bit sRGB code of a linear value; below 0 is 0, above 1 is 255, NaN is 0.
pub fn srgb8_from_linear(linear: f32) -> u8 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to [0, 4096]"
    )]
    let bucket = (linear * 4096.0).clamp(0.0, 4096.0) as usize;
    let mut code = FIRST_CODES[bucket];
    while code < 255 && CODE_STARTS[usize::from(code) + 1] <= linear {
        code += 1;
    }
    code
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
