//! Replays the fuzz corpus on the stable toolchain.
//!
//! A failing input of a fuzz target, minimised, goes to `fuzz/corpus/<target>/` and stays there.

#[allow(dead_code)] // each test takes what it needs
#[path = "../fuzz/src/lib.rs"]
mod fuzz;

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;

use fuzz::checks;

type Check = fn(&[u8]);

/// The fuzz targets, and what each calls.
const TARGETS: [(&str, Check); 8] = [
    ("chunking", checks::chunking),
    ("codec", checks::codec),
    ("decode", checks::decode),
    ("fast_is_plain", checks::fast_is_plain),
    ("parallel", checks::parallel),
    ("parts", checks::parts),
    ("shape", checks::shape),
    ("unwrap", checks::unwrap),
];

fn folder(target: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "fuzz", "corpus", target].iter().collect()
}

fn replay(target: &str) {
    let (_, check) = TARGETS.into_iter().find(|(name, _)| *name == target).expect("one of the targets");
    let mut files = 0;
    for file in fs::read_dir(folder(target)).expect("a folder of the repository") {
        let path = file.expect("a file of the repository").path();
        let data = fs::read(&path).expect("a file of the repository");
        let checked = std::panic::catch_unwind(|| check(&data));
        assert!(checked.is_ok(), "{}", path.display());
        files += 1;
    }
    assert!(files > 5);
}

#[test]
fn chunking() {
    replay("chunking");
}

#[test]
fn codec() {
    replay("codec");
}

#[test]
fn decode() {
    replay("decode");
}

#[test]
fn fast_is_plain() {
    replay("fast_is_plain");
}

#[test]
fn parallel() {
    replay("parallel");
}

#[test]
fn parts() {
    replay("parts");
}

#[test]
fn shape() {
    replay("shape");
}

#[test]
fn unwrap() {
    replay("unwrap");
}

/// If they differ, the test rewrites the files and fails once.
#[test]
fn seeds_match_the_program() {
    let mut written = vec![];
    for (target, _) in TARGETS {
        fs::create_dir_all(folder(target)).expect("the repository can be written");
        let seeds = fuzz::seeds::seeds(target);
        for (name, bytes) in &seeds {
            let path = folder(target).join(name);
            if fs::read(&path).ok().as_ref() != Some(bytes) {
                fs::write(&path, bytes).expect("the repository can be written");
                written.push(path);
            }
        }
        let names: BTreeSet<_> = seeds.into_iter().map(|(name, _)| name).collect();
        for file in fs::read_dir(folder(target)).expect("a folder of the repository") {
            let name = file.expect("a file of the repository").file_name().into_string().expect("a plain name");
            assert!(names.contains(&name) || !name.starts_with("seed-"), "{target}/{name}: no such seed any more");
        }
    }
    assert!(written.is_empty(), "written anew: {written:?}");
}

#[test]
fn every_fuzz_target_is_replayed() {
    let manifest = include_str!("../fuzz/Cargo.toml");
    let programs: Vec<_> = manifest.lines().filter_map(|line| line.strip_prefix("path = \"fuzz_targets/")).collect();
    let expected: Vec<_> = TARGETS.iter().map(|(target, _)| format!("{target}.rs\"")).collect();
    assert_eq!(programs, expected);
}
