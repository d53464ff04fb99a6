//! Which folder may use which: the rule of ARCHITECTURE.md, read off the `use` lines and paths.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Folder → the folders that it may name. Root leaves (`camera`, `npz`, `data_dir`, `distance`, `fingerprint`) are open to all.
const RULE: &[(&str, &[&str])] = &[
    ("http", &["jobs", "storage", "capture"]),
    ("worker", &["jobs", "storage", "capture", "fit", "avatar", "eval", "quality", "page", "gpu", "body"]),
    ("quality", &["capture", "ops"]),
    ("fit", &["ops", "body", "gpu", "capture"]),
    ("avatar", &["ops", "body", "gpu"]),
    ("bench", &["fit", "avatar", "ops", "body", "gpu", "capture"]),
    ("eval", &["fit", "avatar", "page", "body", "capture"]),
    ("synth", &["avatar", "ops", "body", "gpu"]),
    ("study", &["fit", "avatar", "eval", "synth", "bench", "ops", "body", "gpu", "capture"]),
    ("robustness", &["eval", "synth", "avatar", "page", "gpu"]),
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
];

const ROOT_LEAVES: &[&str] = &["camera", "npz", "data_dir", "distance", "fingerprint"];

fn rust_files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
        if entry.is_dir() {
            rust_files(&entry, found);
        } else if entry.extension().is_some_and(|e| e == "rs") {
            found.push(entry);
        }
    }
}

/// The first segments after `crate::` in a source, grouped imports (`crate::{a::…, b::…}`) included; comments excluded.
fn named_folders(source: &str) -> Vec<String> {
    let code: String = source.lines().filter(|l| !l.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n");
    let mut found = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        if code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == '$') {
            continue;
        }
        let rest = &code[at + "crate::".len()..];
        if let Some(group) = rest.strip_prefix('{') {
            let mut depth = 0;
            let mut start = true;
            let mut word = String::new();
            for c in group.chars() {
                match c {
                    '{' => depth += 1,
                    '}' if depth == 0 => break,
                    '}' => depth -= 1,
                    ',' if depth == 0 => start = true,
                    c if depth == 0 && start && (c.is_alphanumeric() || c == '_') => word.push(c),
                    _ if !word.is_empty() => {
                        found.push(std::mem::take(&mut word));
                        start = false;
                    }
                    _ => {}
                }
            }
            if !word.is_empty() {
                found.push(word);
            }
        } else {
            found.push(rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect());
        }
    }
    found
}

#[test]
fn folders_keep_to_the_import_rule() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let rule: BTreeMap<_, _> = RULE.iter().copied().collect();
    let mut broken = Vec::new();
    for (folder, allowed) in &rule {
        let mut files = Vec::new();
        rust_files(&src.join(folder), &mut files);
        assert!(!files.is_empty(), "{folder} is gone: mend the rule");
        for file in files {
            // Tests may look further: they compare a part with its neighbours.
            if file.ends_with("tests.rs") || file.components().any(|c| c.as_os_str() == "tests") {
                continue;
            }
            let source = fs::read_to_string(&file).unwrap();
            let source = source.split("#[cfg(test)]\nmod tests {").next().unwrap();
            for name in named_folders(source) {
                let known = rule.contains_key(name.as_str());
                if known && name != *folder && !allowed.contains(&name.as_str()) {
                    broken.push(format!("{}: {folder} may not use {name}", file.display()));
                } else if !known && !ROOT_LEAVES.contains(&name.as_str()) {
                    broken.push(format!("{}: `crate::{name}` is not in the rule", file.display()));
                }
            }
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn the_reference_twins_know_no_device() {
    let mut files = Vec::new();
    rust_files(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src/ops"), &mut files);
    let twins: Vec<_> = files.iter().filter(|f| f.ends_with("cpu.rs")).collect();
    assert!(!twins.is_empty(), "the twins are gone: mend the rule");
    for twin in twins {
        let source = fs::read_to_string(twin).unwrap();
        assert!(!source.contains("wgpu") && !source.contains("gpu::"), "{} names the device", twin.display());
    }
}

#[test]
fn grouped_and_plain_imports_are_seen() {
    assert_eq!(
        named_folders("use crate::gpu::Gpu;\nuse crate::{body::Body, ops::{adam, nmr}};"),
        ["gpu", "body", "ops"]
    );
    assert!(named_folders("// crate::http::x\n").is_empty());
}
