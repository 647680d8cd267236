//! Is every file a whole forest, which is written as it was, or refused without a panic?
//!
//! A checksum would stop nearly all inputs, so each is also tried with one that fits.

#![no_main]

use libfuzzer_sys::fuzz_target;
use treelod::lod::foliage_hierarchy::depth_first::DepthFirst;
use treelod::lod::foliage_hierarchy::stored::{Stored, read, write};
use treelod::lod::foliage_hierarchy::uniform::uniform;

fuzz_target!(|bytes: &[u8]| {
    holds(bytes);
    holds(&[bytes, &crc32fast::hash(bytes).to_le_bytes()].concat());
});

fn holds(bytes: &[u8]) {
    let Ok(Stored { forest, plant, note }) = read(bytes, None) else { return };
    let order = DepthFirst::new(&forest);
    let roots = uniform(&order, order.root_count).expect("as many as there are");
    assert!(forest.roots().eq(roots), "the coarsest level is the roots");
    assert_eq!(write(&forest, &plant, &note), bytes, "each forest has one form");
}
