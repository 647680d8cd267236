//! Random numbers that depend on (seed, purpose, index) and on nothing else.
//!
//! Item `index` of a kernel draws from its own stream, so the result is the same on any number of
//! threads and in any order, and one kernel's draws never shift another's. Integer arithmetic
//! only, and the conversions to floats are exact: the same bytes on every machine.
//! Not for cryptography.
//!
//! This work is based on:
//! Guy L. Steele, Doug Lea, Christine H. Flood. Fast Splittable Pseudorandom Number Generators. 2014
//! (the mixing function, with the constants of Sebastiano Vigna's `splitmix64.c`)

/// The step of the counter: 2^64 divided by the golden ratio, odd.
const STEP: u64 = 0x9E37_79B9_7F4A_7C15;

/// What a stream is for; streams of different purposes are unrelated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Purpose(u64);

impl Purpose {
    /// A purpose from a name that is unique in the crate, such as `"grow.stem"`.
    pub const fn named(name: &str) -> Self {
        // FNV-1a, because it is short enough to run at compile time
        let bytes = name.as_bytes();
        let mut hash = 0xCBF2_9CE4_8422_2325_u64;
        let mut i = 0;
        while i < bytes.len() {
            hash = (hash ^ bytes[i] as u64).wrapping_mul(0x0000_0100_0000_01B3);
            i += 1;
        }
        Self(hash)
    }
}

/// The random numbers of one item.
#[derive(Debug, Clone)]
pub struct Stream {
    state: u64,
}

impl Stream {
    /// The stream of item `index` for a purpose under a seed.
    pub fn new(seed: u64, purpose: Purpose, index: u64) -> Self {
        let keyed = mix(seed.wrapping_add(STEP) ^ mix(purpose.0));
        Self { state: mix(keyed ^ mix(index.wrapping_mul(STEP).wrapping_add(STEP))) }
    }

    /// The next 64 random bits.
    #[inline]
    pub fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(STEP);
        mix(self.state)
    }

    /// Uniform in [0, 1), a multiple of 2^-53.
    #[inline]
    pub fn unit(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
    }

    /// Uniform in [-1, 1).
    #[inline]
    pub fn signed(&mut self) -> f64 {
        2.0 * self.unit() - 1.0
    }

    /// Uniform in 0..count, without bias worth naming (below 2^-32 for counts below 2^32).
    ///
    /// # Panics
    /// If `count` is 0.
    #[inline]
    pub fn below(&mut self, count: u64) -> u64 {
        assert!(count > 0, "there is nothing to choose from");
        let product = u128::from(self.next_u64()) * u128::from(count);
        (product >> 64) as u64
    }
}

/// A bijection of 64 bits in which every input bit reaches every output bit.
#[inline]
const fn mix(bits: u64) -> u64 {
    let bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    bits ^ (bits >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: Purpose = Purpose::named("test.one");
    const TWO: Purpose = Purpose::named("test.two");

    #[test]
    fn the_mixer_is_splitmix64() {
        // the first outputs of splitmix64.c from state 0, as in Vigna's test vectors
        let mut stream = Stream { state: 0 };
        let drawn = [stream.next_u64(), stream.next_u64(), stream.next_u64()];
        let expected = [0xE220_A839_7B1D_CDAF, 0x6E78_9E6A_A1B9_65F4, 0x06C4_5D18_8009_454F];
        assert_eq!(drawn, expected, "published sequence");
    }

    #[test]
    fn seed_purpose_and_index_each_give_another_stream() {
        let first = |seed, purpose, index| Stream::new(seed, purpose, index).next_u64();
        let reference = first(1, ONE, 1);
        assert_eq!(reference, first(1, ONE, 1), "the same key");
        assert_ne!(reference, first(2, ONE, 1), "another seed");
        assert_ne!(reference, first(1, TWO, 1), "another purpose");
        assert_ne!(reference, first(1, ONE, 2), "another index");
        assert_ne!(first(1, ONE, 2), first(2, ONE, 1), "seed and index are not interchangeable");
    }

    #[test]
    fn draws_fill_their_range_evenly() {
        // 16 bins of 4096 expected draws each; 5 standard deviations of a bin are 310
        let mut bins = [0_u32; 16];
        let mut below = [0_u32; 16];
        for index in 0..65_536 {
            let unit = Stream::new(7, ONE, index).unit();
            assert!((0.0..1.0).contains(&unit), "{unit} is out of range");
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below 16")]
            let bin = (unit * 16.0) as usize;
            bins[bin] += 1;
            let chosen = Stream::new(7, TWO, index).below(16);
            below[usize::try_from(chosen).expect("below 16")] += 1;
        }
        for count in bins.iter().chain(&below) {
            assert!(count.abs_diff(4096) < 310, "{bins:?} {below:?}");
        }
    }
}
