//! Names what the core is compiled from, so that stored results can say which code made them.
//!
//! The hash covers every Rust file and shader below `src` but tests, with its path, and `Cargo.lock`. It is FNV-1a
//! with 128 bits: nobody forges sources here, and it needs no library. Line ends of a checkout with
//! carriage returns do not count.
//!
//! This work is based on:
//! Glenn Fowler, Landon Curt Noll, Phong Vo. FNV hash. 1991

use std::fs;
use std::path::{Path, PathBuf};

const OFFSET: u128 = 0x6c62_272e_07bb_0142_62b8_2175_6295_c58d;
const PRIME: u128 = 0x0000_0000_0100_0000_0000_0000_0000_013b;

fn main() {
    let root = PathBuf::from(std::env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets it"));
    let mut files = Vec::new();
    collect(&root.join("src"), &mut files);
    files.push(root.join("Cargo.lock"));
    files.sort();
    let mut hash = OFFSET;
    let mut feed = |bytes: &[u8]| {
        for &byte in bytes {
            hash = (hash ^ u128::from(byte)).wrapping_mul(PRIME);
        }
    };
    for file in &files {
        // a library that is a dependency has no lock file of its own
        let Ok(bytes) = fs::read(file) else { continue };
        let name = file.strip_prefix(&root).expect("all lie below the root");
        let parts: Vec<_> = name.iter().map(|part| part.to_string_lossy()).collect();
        let text: Vec<u8> = bytes.into_iter().filter(|&byte| byte != b'\r').collect();
        // lengths keep apart what would read the same when joined
        feed(format!("{}\n{}\n", parts.join("/"), text.len()).as_bytes());
        feed(&text);
    }
    println!("cargo:rustc-env=KERNEL_SOURCE_HASH={hash:032x}");
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=src");
    println!("cargo:rerun-if-changed=Cargo.lock");
}

/// All Rust files and shaders below a folder but those that hold nothing but tests.
fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("the sources can be read") {
        let path = entry.expect("the sources can be read").path();
        let is_test = path.file_stem().is_some_and(|stem| stem == "tests");
        if path.is_dir() {
            collect(&path, files);
        } else if path.extension().is_some_and(|kind| kind == "rs" || kind == "wgsl") && !is_test {
            files.push(path);
        }
    }
}
