//! Does a forest come back as it was, and is everything else refused?

use proptest::prelude::*;

use super::*;
use crate::lod::foliage_hierarchy::depth_first::DepthFirst;
use crate::lod::foliage_hierarchy::made::{Maker, forest, random_forest, square};

const NOTE: &[u8] = br#"{"made": "by hand"}"#;

const PLANT: Digest = *b"a plant that is 32 bytes long...";

/// As written by version 1; never write it again: a later version must still read it.
const SAMPLE: &[u8] = include_bytes!("sample_v1.bin");

/// Three leaves, two collapses with corners, scales and turns of all kinds.
fn sample() -> Forest {
    let leaves = [0.0, 1.5, 4.0].map(|x| square(Vec3::new(x, x * 0.25, -x)));
    let mut maker = Maker::new(&leaves);
    maker.collapse([0, 1], 6, 1.25);
    maker.collapse([2, 3], 11, 1.0);
    maker.finish()
}

/// The bytes with a checksum that fits.
fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    bytes.truncate(bytes.len() - CHECKSUM_BYTES);
    let checksum = crc32fast::hash(&bytes);
    bytes.extend(checksum.to_le_bytes());
    bytes
}

/// What is read is a whole forest and is written as it was: the fuzz target's claim.
fn holds(bytes: &[u8]) -> bool {
    let Ok(Stored { forest, plant, note }) = read(bytes, None) else { return false };
    let order = DepthFirst::new(&forest);
    assert_eq!(order.roots().count(), forest.root_count(), "trees");
    assert_eq!(order.leaves.len(), forest.leaf_count as usize, "leaves");
    assert_eq!(write(&forest, &plant, &note), bytes, "each forest has one form");
    true
}

fn refusal(bytes: &[u8]) -> String {
    match read(bytes, None) {
        Ok(_) => panic!("read what it should refuse"),
        Err(error @ LodError::Store { .. }) => error.to_string(),
        Err(error) => panic!("another kind of error: {error}"),
    }
}

#[test]
fn the_frozen_sample_is_read_and_written_as_it_is() {
    let Stored { forest, plant, note } = read(SAMPLE, Some(&PLANT)).expect("written by version 1");
    assert_eq!(plant, PLANT, "the plant it belongs to");
    assert_eq!(note, NOTE, "what was noted");
    assert_eq!(forest, sample(), "every number");
    assert_eq!(write(&forest, &plant, &note), SAMPLE, "byte for byte");
}

#[test]
fn another_plants_forest_is_refused() {
    let error = read(SAMPLE, Some(&[0; 32])).expect_err("of another plant").to_string();
    assert_eq!(error, "stored foliage: it belongs to another plant", "said");
}

#[test]
fn the_smallest_forests_come_back() {
    for leaf_count in [0, 1, 2] {
        let forest = forest(leaf_count, &[]);
        let bytes = write(&forest, &PLANT, NOTE);
        let expected = HEADER_BYTES + NOTE.len() + CHECKSUM_BYTES + leaf_count * (48 + 61);
        assert_eq!(bytes.len(), expected, "{leaf_count} leaves");
        assert_eq!(
            read(&bytes, None),
            Ok(Stored { forest, plant: PLANT, note: NOTE.to_vec() }),
            "{leaf_count} leaves"
        );
    }
}

#[test]
fn cut_short_at_any_length_it_is_refused() {
    for length in 0..SAMPLE.len() {
        refusal(&SAMPLE[..length]);
    }
    let longer = [SAMPLE, &[0]].concat();
    assert!(refusal(&longer).contains("should take"), "a byte too many");
}

#[test]
fn with_any_byte_altered_it_is_refused() {
    for at in 0..SAMPLE.len() {
        for bit in 0..8 {
            let mut bytes = SAMPLE.to_vec();
            bytes[at] ^= 1 << bit;
            refusal(&bytes);
        }
    }
}

#[test]
fn altered_and_sealed_again_it_is_refused_or_still_whole() {
    let mut read_count = 0;
    for at in 0..SAMPLE.len() {
        for value in [0, 1, 2, 3, 4, 5, 127, 128, 255] {
            let mut bytes = SAMPLE.to_vec();
            bytes[at] = value;
            read_count += usize::from(holds(&sealed(bytes)));
        }
    }
    // numbers may be others, links may not
    assert!(read_count > 500, "the digest and most numbers may be any: {read_count}");
}

#[test]
fn counts_beyond_the_bytes_allocate_nothing() {
    // 4 billion leaves would take 400 GB
    for (leaf_count, node_count) in [(u32::MAX, u32::MAX), (1 << 31, u32::MAX), (3, u32::MAX)] {
        let mut bytes = SAMPLE.to_vec();
        bytes[12..16].copy_from_slice(&leaf_count.to_le_bytes());
        bytes[16..20].copy_from_slice(&node_count.to_le_bytes());
        let why = refusal(&sealed(bytes));
        assert!(why.contains("should take") || why.contains("cannot make"), "{why}");
    }
}

#[test]
fn what_does_not_hold_is_named() {
    let edit = |change: &dyn Fn(&mut Forest)| {
        let mut forest = sample();
        change(&mut forest);
        refusal(&write(&forest, &PLANT, NOTE))
    };
    type Change = fn(&mut Forest);
    let cases: [(Change, &str); 18] = [
        (|f| f.scales[4] = 3e38, "node 4 is drawn beyond its ball"),
        (|f| f.positions[5].y = f32::NAN, "position 5 is not finite"),
        (|f| f.spheres[1].radius = -1.0, "ball 1 is none"),
        (|f| f.spheres[2].center.z = f32::INFINITY, "ball 2 is none"),
        (|f| f.costs[1] = -1.0, "cost 1 is negative or not finite"),
        (|f| f.areas[4] = f64::NAN, "area 4 is negative or not finite"),
        (|f| f.scales[3] = f32::INFINITY, "scale 3 is negative or not finite"),
        (|f| f.corners[4].leaf = 3, "node 4 takes its texture from no leaf"),
        (|f| f.corners[4].turn = 8, "node 4 has corners that are turned too far"),
        (|f| f.nodes[0].parent = NONE, "node 3 is not linked to its parent and children"),
        (|f| f.nodes[0].parent = 4, "node 0 is not linked to its parent and children"),
        (|f| f.nodes[4].parent = 3, "node 4 is not linked to its parent and children"),
        (|f| f.nodes[4].parent = 99, "node 4 is not linked to its parent and children"),
        (|f| f.nodes[3].children = [1, 0], "node 3 is not linked to its parent and children"),
        (|f| f.nodes[3].children = [0, 0], "node 1 is not linked to its parent and children"),
        (|f| f.nodes[1].children = [0, 2], "node 1 is not linked to its parent and children"),
        (
            |f| f.nodes[1].vertices[2] = 8,
            "node 1 does not stand on corners of its own, or on two of each child",
        ),
        (
            |f| f.nodes[3].vertices[0] = f.nodes[3].vertices[1],
            "node 3 does not stand on corners of its own, or on two of each child",
        ),
    ];
    for (change, expected) in cases {
        assert_eq!(edit(&change), format!("stored foliage: {expected}"), "named");
    }
    let mut version = SAMPLE.to_vec();
    version[8] = 2;
    assert_eq!(refusal(&version), "stored foliage: version 2 is not read, only 1", "said");
}

#[test]
fn what_fuzzing_has_found_still_holds() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz/corpus/stored_forest");
    let files = std::fs::read_dir(folder).expect("the corpus is part of the sources");
    let mut read_count = 0;
    for file in files {
        let bytes = std::fs::read(file.expect("listed").path()).expect("a file");
        // as the fuzz target does: as it is, and with a checksum that fits
        let whole = [&bytes[..], &crc32fast::hash(&bytes).to_le_bytes()].concat();
        read_count += usize::from(holds(&bytes)) + usize::from(holds(&whole));
    }
    assert!(read_count > 0, "some of them are whole");
}

proptest! {
    #[test]
    fn any_forest_comes_back_as_it_was(forest in random_forest(80), plant: [u8; 32]) {
        let bytes = write(&forest, &plant, &[]);
        let whole = Stored { forest, plant, note: vec![] };
        prop_assert_eq!(read(&bytes, Some(&plant)), Ok(whole));
    }

    #[test]
    fn any_bytes_are_refused_or_whole(
        forest in random_forest(6),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
    ) {
        let mut bytes = write(&forest, &PLANT, NOTE);
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        holds(&bytes);
        holds(&sealed(bytes));
    }
}
