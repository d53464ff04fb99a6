//! The corpora of the fuzz targets, and random changes of them, through the same parsers. `cargo fuzz` looks further.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

use effigy::fuzz_entries::{ENTRIES, Entry};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Inputs of a target, sorted by name.
fn corpus(name: &str) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(name);
    let entries = std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut inputs: Vec<_> = entries
        .map(|entry| {
            let path = entry.unwrap().path();
            (path.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read(path).unwrap())
        })
        .collect();
    inputs.sort();
    if name == "body" {
        // Too large to be committed.
        let mut whole = std::io::Cursor::new(Vec::new());
        effigy::body::Body::test_body().write(&mut whole).unwrap();
        inputs.push(("the test body".into(), whole.into_inner()));
    }
    assert!(inputs.len() >= 3, "{name} has a corpus");
    inputs
}

/// What a parser must do with whatever comes: return soon.
fn parse(name: &str, entry: Entry, input: &[u8], which: &str) {
    let begun = Instant::now();
    let survived = catch_unwind(AssertUnwindSafe(|| entry(input)));
    assert!(survived.is_ok(), "{name} panics on {which} ({} bytes)", input.len());
    assert!(begun.elapsed() < Duration::from_secs(10), "{name} takes {:?} for {which}", begun.elapsed());
}

#[test]
fn the_committed_corpora_harm_no_parser() {
    for (name, entry) in ENTRIES {
        for (file, input) in corpus(name) {
            parse(name, entry, &input, &file);
        }
    }
}

/// Each target has its folder and its program, and no other is there.
#[test]
fn targets_corpora_and_parsers_are_the_same_set() {
    let names = |folder: &str, ending: &str| {
        let entries = std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join(folder)).unwrap();
        let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().to_string_lossy().replace(ending, "")).collect();
        names.sort();
        names
    };
    let mut parsers: Vec<_> = ENTRIES.iter().map(|(name, _)| name.to_string()).collect();
    parsers.sort();
    assert_eq!(names("fuzz/corpus", ""), parsers);
    assert_eq!(names("fuzz/fuzz_targets", ".rs"), parsers);
    for name in &parsers {
        let program = std::fs::read_to_string(format!("{}/fuzz/fuzz_targets/{name}.rs", env!("CARGO_MANIFEST_DIR")));
        assert!(program.unwrap().contains(&format!("fuzz_entries::{name}(bytes)")), "{name}");
    }
}

/// Flips, cuts, doubles, exchanges with another input, puts numbers where parsers are wrong about sizes.
fn mutate(input: &[u8], other: &[u8], random: &mut Pcg64Mcg) -> Vec<u8> {
    const NUMBERS: [u64; 8] = [0, 1, 0x7f, 0xff, 0xffff, 0x7fff_ffff, 0xffff_ffff, u64::MAX];
    let mut bytes = input.to_vec();
    for _ in 0..random.random_range(1..5) {
        let at = random.random_range(0..bytes.len() + 1);
        let end = (at + random.random_range(1..64)).min(bytes.len());
        match random.random_range(0..7) {
            0 => bytes.truncate(at),
            1 => bytes.extend_from_within(at..end),
            2 => drop(bytes.drain(at..end)),
            3 if !other.is_empty() => {
                let from = random.random_range(0..other.len());
                let piece = &other[from..(from + 64).min(other.len())];
                drop(bytes.splice(at..end, piece.iter().copied()));
            }
            4 => {
                let number = NUMBERS[random.random_range(0..NUMBERS.len())].to_le_bytes();
                let size = [1, 2, 4, 8][random.random_range(0..4)];
                drop(bytes.splice(at..(at + size).min(bytes.len()), number[..size].iter().copied()));
            }
            5 => drop(bytes.splice(at..at, b"999999999999999999999".iter().copied())),
            _ => (0..4).for_each(|_| {
                if let Some(n) = bytes.len().checked_sub(1) {
                    bytes[random.random_range(0..n + 1)] ^= 1 << random.random_range(0..8);
                }
            }),
        }
    }
    bytes
}

/// `EFFIGY_TORTURE_MUTATIONS` of each parser.
#[test]
fn changed_inputs_harm_no_parser() {
    let count = std::env::var("EFFIGY_TORTURE_MUTATIONS").map_or(2000, |text| text.parse::<u64>().unwrap());
    let begun = Instant::now();
    for (name, entry) in ENTRIES {
        let corpus = corpus(name);
        for seed in 0..count {
            let mut random = Pcg64Mcg::seed_from_u64(seed);
            let (file, input) = &corpus[random.random_range(0..corpus.len())];
            let (_, other) = &corpus[random.random_range(0..corpus.len())];
            parse(name, entry, &mutate(input, other, &mut random), &format!("{file}, changed by seed {seed}"));
        }
    }
    eprintln!("{count} changed inputs for each of {} parsers in {:.1?}", ENTRIES.len(), begun.elapsed());
}
