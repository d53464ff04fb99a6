//! Which part of `src/` may use which: the rule of ARCHITECTURE.md, read off the `use` lines and paths.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Folder or file → those that it may name.
const RULE: &[(&str, &[&str])] = &[
    ("http", &["jobs", "storage", "capture"]),
    ("worker", &["jobs", "storage", "capture", "fit", "avatar", "eval", "quality", "page", "gpu", "body"]),
    ("quality", &["capture", "ops"]),
    ("fit", &["ops", "body", "gpu", "capture"]),
    ("avatar", &["ops", "body", "gpu"]),
    ("bench", &["fit", "avatar", "ops", "body", "gpu", "capture"]),
    ("eval", &["fit", "avatar", "page", "capture"]),
    ("synth", &["avatar", "ops", "body", "gpu"]),
    ("study", &["fit", "avatar", "eval", "synth", "bench", "ops", "body", "gpu", "capture"]),
    ("robustness", &["eval", "synth", "avatar", "page", "gpu", "body"]),
    ("ops", &["gpu", "body"]),
    ("jobs", &[]),
    ("storage", &[]),
    ("capture", &[]),
    ("body", &[]),
    ("gpu", &[]),
    ("config", &[]),
    ("page", &[]),
    ("webhooks", &["jobs"]),
    ("telemetry", &[]),
    ("fuzz_entries", &["http", "jobs", "capture", "body"]),
];

/// Files that all may use, and that use only each other.
const ROOT_LEAVES: &[&str] = &[
    "atomic_file",
    "camera",
    "npz",
    "data_dir",
    "distance",
    "fingerprint",
    "json",
    "keypoints",
    "mask",
    "math",
    "novel",
    "picture",
    "video_writer",
];

/// The program itself, which may use everything.
const EXEMPT: &[&str] = &["lib", "main", "cli"];

/// Where a folder may use only some names of another: its types, or one part of what it does.
const ONLY: &[(&str, &str, &[&str])] =
    &[("fit", "capture", &["Capture", "Frame", "KnownPoses"]), ("quality", "capture", &["Capture", "Frame"])];

fn src() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// The sources under a folder, or the one file.
fn rust_files(path: &Path, found: &mut Vec<PathBuf>) {
    if path.is_dir() {
        for entry in fs::read_dir(path).unwrap() {
            rust_files(&entry.unwrap().path(), found);
        }
    } else if path.extension().is_some_and(|e| e == "rs") {
        found.push(path.into());
    }
}

/// What is compiled outside tests, without comments. Where an item of tests ends is told by rustfmt's indentation.
fn without_tests(source: &str) -> String {
    let mut kept = String::new();
    let mut lines = source.lines();
    while let Some(line) = lines.next() {
        let text = line.trim_start();
        let indent = line.len() - text.len();
        if text == "#[cfg(test)]" {
            let ends = |l: &&str| l.len() - l.trim_start().len() == indent && l.ends_with([';', '}', ',']);
            lines.by_ref().find(ends);
        } else if !text.starts_with("//") {
            kept.push_str(line);
            kept.push('\n');
        }
    }
    kept
}

/// Adds the paths of a use tree, or the one path of an expression; what comes after it.
fn add_paths<'a>(rest: &'a str, parent: &str, found: &mut Vec<String>) -> &'a str {
    let is_name = |c: char| c.is_alphanumeric() || c == '_' || c == '*';
    let Some(mut rest) = rest.strip_prefix('{') else {
        let (name, rest) = rest.split_at(rest.find(|c| !is_name(c)).unwrap_or(rest.len()));
        let path = if parent.is_empty() { name.to_string() } else { format!("{parent}::{name}") };
        return match rest.strip_prefix("::") {
            Some(rest) if rest.starts_with(|c| is_name(c) || c == '{') => add_paths(rest, &path, found),
            _ => {
                found.push(path);
                rest
            }
        };
    };
    loop {
        rest = rest.trim_start();
        if rest.is_empty() || rest.starts_with('}') {
            return rest.get(1..).unwrap_or_default();
        }
        rest = add_paths(rest, parent, found);
        // Another name (`as`) may stand before the end.
        rest = &rest[rest.find([',', '}']).unwrap_or(rest.len())..];
        rest = rest.strip_prefix(',').unwrap_or(rest);
    }
}

/// What a source names of this crate, as paths from its root, which lies `depth` modules above.
fn named_paths(source: &str, depth: usize) -> Vec<String> {
    let code = without_tests(source);
    let mut found = Vec::new();
    for root in ["crate::".to_string(), "super::".repeat(depth)] {
        for (at, _) in code.match_indices(&root) {
            if !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == '$' || c == ':') {
                add_paths(&code[at + root.len()..], "", &mut found);
            }
        }
    }
    found
}

/// How many modules the crate's root lies above a file.
fn depth(file: &Path) -> usize {
    let below = file.strip_prefix(src()).unwrap().components().count();
    below - usize::from(file.ends_with("mod.rs"))
}

/// Why the part of `src/` may not name the path.
fn breaks(part: &str, path: &str, rule: &BTreeMap<&str, &[&str]>) -> Option<String> {
    let mut segments = path.split("::");
    let (other, name) = (segments.next().unwrap_or_default(), segments.next().unwrap_or_default());
    if other == part || ROOT_LEAVES.contains(&other) {
        return None;
    }
    if !rule.contains_key(other) {
        return Some(format!("`crate::{other}` is not in the rule"));
    }
    if !rule.get(part).is_some_and(|allowed| allowed.contains(&other)) {
        return Some(format!("{part} may not use {other}"));
    }
    let only = ONLY.iter().find(|(user, used, _)| (*user, *used) == (part, other));
    only.filter(|(_, _, names)| !names.contains(&name)).map(|_| format!("{part} may not use {path}"))
}

#[test]
fn all_parts_keep_to_the_import_rule() {
    let rule: BTreeMap<_, _> = RULE.iter().copied().collect();
    let mut missing: BTreeSet<_> = rule.keys().chain(ROOT_LEAVES).chain(EXEMPT).copied().collect();
    let mut broken = Vec::new();
    for entry in fs::read_dir(src()).unwrap().map(|entry| entry.unwrap().path()) {
        let part = entry.file_stem().unwrap().to_str().unwrap();
        if !missing.remove(part) {
            broken.push(format!("{}: not in the rule, or there twice", entry.display()));
        }
        if EXEMPT.contains(&part) {
            continue;
        }
        let mut files = Vec::new();
        rust_files(&entry, &mut files);
        // Tests may look further: they compare a part with its neighbours.
        files.retain(|file| !file.ends_with("tests.rs") && file.components().all(|c| c.as_os_str() != "tests"));
        for file in files {
            let named = named_paths(&fs::read_to_string(&file).unwrap(), depth(&file));
            let reasons = named.iter().filter_map(|path| breaks(part, path, &rule));
            broken.extend(reasons.map(|reason| format!("{}: {reason}", file.display())));
        }
    }
    broken.extend(missing.iter().map(|part| format!("{part} is gone: mend the rule")));
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn architecture_tells_this_rule() {
    let page = fs::read_to_string(src().with_file_name("ARCHITECTURE.md")).unwrap();
    let mut told = BTreeMap::new();
    for line in page.lines().filter_map(|line| line.strip_prefix("- `")) {
        let (names, rest) = line.split_once('`').unwrap_or((line, ""));
        if let Some((part, used)) = names.split_once(" → ") {
            told.insert(part, used.split(' ').collect());
        } else if rest.starts_with(" are leaves") {
            told.extend(names.split(' ').map(|leaf| (leaf, BTreeSet::new())));
        }
    }
    let rule: BTreeMap<_, _> = RULE.iter().map(|&(part, used)| (part, used.iter().copied().collect())).collect();
    assert_eq!(told, rule);
}

#[test]
fn the_reference_twins_know_no_device() {
    let mut files = Vec::new();
    rust_files(&src().join("ops"), &mut files);
    let twins: Vec<_> = files.iter().filter(|f| f.ends_with("cpu.rs")).collect();
    assert!(!twins.is_empty(), "the twins are gone: mend the rule");
    for twin in twins {
        let source = fs::read_to_string(twin).unwrap();
        assert!(!source.contains("wgpu") && !source.contains("gpu::"), "{} names the device", twin.display());
    }
}

#[test]
fn paths_are_seen_in_every_form() {
    let named = |source| named_paths(source, 2);
    assert_eq!(
        named("use crate::gpu::Gpu;\nuse crate::{body::Body as B, ops::{adam, nmr::{self, N}},\n};"),
        ["gpu::Gpu", "body::Body", "ops::adam", "ops::nmr::self", "ops::nmr::N"]
    );
    assert_eq!(named("let x = crate::fit::run::<crate::npz::Npz>(y);"), ["fit::run", "npz::Npz"]);
    assert_eq!(named("use super::super::http::App;\nuse super::own::Part;"), ["http::App"]);
    assert!(named("// crate::http::x\n").is_empty());
}

#[test]
fn what_follows_tests_is_seen() {
    let source = "\
#[cfg(test)]
use crate::a::A;
#[cfg(test)]
mod tests {
    use crate::b::B;
}
use crate::c::C;
impl C {
    #[cfg(test)]
    fn slow(
        b: crate::b::B,
    ) -> f64 {
        1.0
    }

    fn quick(d: crate::d::D) {}
}
";
    assert_eq!(named_paths(source, 1), ["c::C", "d::D"]);
}

#[test]
fn a_breach_is_told() {
    let rule: BTreeMap<_, _> = RULE.iter().copied().collect();
    let tells = |part, path| breaks(part, path, &rule).is_some();
    assert!(!tells("fit", "capture::Capture") && tells("fit", "capture::inspect") && tells("fit", "capture"));
    assert!(!tells("worker", "capture::inspect") && !tells("http", "camera::Camera") && !tells("npz", "camera"));
    assert!(tells("http", "gpu::Gpu") && tells("npz", "capture::Capture") && tells("gpu", "new_folder::X"));
}
