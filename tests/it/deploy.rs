//! The files of `deploy/` say what the program knows.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use effigy::config::SETTINGS;
use serde_json::Value;

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy").join(name)
}

fn text(name: &str) -> String {
    std::fs::read_to_string(path(name)).unwrap()
}

fn effigy(arguments: &[&str]) -> std::process::Output {
    crate::program::effigy().args(arguments).output().unwrap()
}

fn is_there(tool: &str) -> bool {
    let there = Command::new(tool).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok();
    if !there {
        eprintln!("{tool} is not installed: its look at deploy/ is left out");
    }
    there
}

const FILES: [&str; 7] =
    ["Dockerfile", "entrypoint.sh", "compose.yaml", "effigy.toml", "effigy.service", "nginx.conf", "README.md"];

/// Calls of the program in a text, as the words after its name.
fn calls(text: &str) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    for line in text.lines() {
        let words: Vec<&str> =
            line.split(|c: char| c.is_whitespace() || "`\"[]".contains(c)).filter(|w| !w.is_empty()).collect();
        for (at, word) in words.iter().enumerate() {
            let program = *word == "effigy" || word.ends_with("bin/effigy");
            // `effigy effigy` of compose: a service, then the program.
            let command =
                words.get(at + 1).filter(|next| next.chars().all(|c| c.is_ascii_lowercase()) && **next != "effigy");
            if let (true, Some(command)) = (program, command) {
                let flags =
                    words[at + 2..].iter().take_while(|word| **word != "effigy").filter(|word| word.starts_with("--"));
                found.push([*command].iter().chain(flags).map(ToString::to_string).collect());
            }
        }
    }
    found
}

#[test]
fn every_command_and_flag_that_they_name_exists() {
    let commands = String::from_utf8(effigy(&["--help"]).stdout).unwrap();
    let known = |name: &str| commands.lines().any(|line| line.trim_start().starts_with(&format!("{name} ")));
    let mut seen = 0;
    for file in FILES {
        for call in calls(&text(file)).iter().filter(|call| known(&call[0])) {
            seen += 1;
            let help = String::from_utf8(effigy(&[&call[0], "--help"]).stdout).unwrap();
            for flag in &call[1..] {
                assert!(help.contains(flag.split('=').next().unwrap()), "deploy/{file}: effigy {}", call.join(" "));
            }
        }
    }
    // The unit's start, the doctor and the keys of the README: the search finds what is there.
    assert!(seen >= 4, "only {seen} calls were found");
    for (file, call) in [("effigy.service", "serve"), ("README.md", "doctor"), ("README.md", "keys")] {
        assert!(known(call) && calls(&text(file)).iter().any(|found| found[0] == call), "deploy/{file} calls {call}");
    }
}

#[test]
fn every_variable_that_they_set_is_a_setting() {
    let mut seen = 0;
    for file in FILES {
        let text = text(file);
        for (at, _) in text.match_indices("EFFIGY_") {
            let name: String = text[at..].chars().take_while(|c| c.is_ascii_uppercase() || *c == '_').collect();
            let known = SETTINGS.iter().any(|setting| setting.variable() == name);
            assert!(known || name == "EFFIGY_DEVICE" || name == "EFFIGY_CONFIG", "deploy/{file}: {name}");
            seen += 1;
        }
    }
    assert!(seen >= 6);
    let file = path("effigy.toml");
    let shown = effigy(&["config", "--config", file.to_str().unwrap()]);
    assert!(shown.status.success(), "{}", String::from_utf8_lossy(&shown.stderr));
}

#[test]
fn the_compose_file_is_yaml_of_what_the_dockerfile_makes() {
    let compose: Value = yaml_serde::from_str(&text("compose.yaml")).unwrap();
    let dockerfile = text("Dockerfile");
    for (name, service) in compose["services"].as_object().unwrap() {
        let build = &service["build"];
        assert_eq!(build["dockerfile"], "deploy/Dockerfile");
        assert!(dockerfile.contains(&format!(" AS {}\n", build["target"].as_str().unwrap())), "{name}");
        assert_eq!(service["image"], format!("effigy:{}", build["target"].as_str().unwrap()));
    }
    assert_eq!(compose["services"].as_object().unwrap().len(), 2);
    // What is copied into the image is there.
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let copies =
        dockerfile.lines().filter_map(|line| line.strip_prefix("COPY ")).filter(|line| !line.starts_with("--from"));
    for source in copies.filter_map(|line| line.split(' ').next()) {
        assert!(root.join(source).exists(), "COPY {source}");
    }
}

/// Each of these, alone, makes systemd (some before 252) a list of the devices that the unit may open: no GPU is on it.
#[test]
fn the_unit_keeps_the_graphics_device() {
    let unit = text("effigy.service");
    let takes = ["PrivateDevices=", "DevicePolicy=", "DeviceAllow=", "ProtectClock="];
    let found: Vec<_> = unit.lines().filter(|line| takes.iter().any(|name| line.starts_with(name))).collect();
    assert!(found.is_empty(), "{found:?}");
    assert!(unit.contains("SupplementaryGroups=video render"));
}

#[test]
fn the_unit_is_one_that_systemd_takes() {
    if !is_there("systemd-analyze") {
        return;
    }
    // The unit names the place of an installation; here the program lies elsewhere.
    let folder = tempfile::tempdir().unwrap();
    let unit = folder.path().join("effigy.service");
    let here = text("effigy.service").replace("/usr/local/bin/effigy", env!("CARGO_BIN_EXE_effigy"));
    std::fs::write(&unit, here).unwrap();
    let verdict = Command::new("systemd-analyze").args(["verify", "--man=no"]).arg(&unit).output().unwrap();
    let said = String::from_utf8_lossy(&verdict.stderr);
    let ours: Vec<&str> = said.lines().filter(|line| line.contains("effigy.service")).collect();
    assert!(ours.is_empty(), "{}", ours.join("\n"));
}

#[test]
fn the_proxy_is_one_that_nginx_takes() {
    let conf = text("nginx.conf");
    let idle = conf.lines().find_map(|line| line.trim().strip_prefix("keepalive_timeout ")?.strip_suffix("s;"));
    assert!(idle.unwrap().parse::<u32>().unwrap() < 15, "the server ends idle connections after 15 s, and first");
    assert!(conf.contains("proxy_buffering off") && conf.contains("proxy_request_buffering off"));
    if !is_there("nginx") || !is_there("openssl") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let (key, certificate) = (at("privkey.pem"), at("fullchain.pem"));
    let made = Command::new("openssl")
        .args(["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=effigy.example", "-days", "1"])
        .args(["-keyout", &key, "-out", &certificate])
        .output()
        .unwrap();
    assert!(made.status.success());
    let conf = conf.replace("/etc/ssl/effigy/", &at("")).replace("listen 443", "listen 8443");
    let whole =
        format!("pid {};\nerror_log stderr;\nevents {{}}\nhttp {{\naccess_log off;\n{conf}\n}}\n", at("nginx.pid"));
    std::fs::write(at("nginx.conf"), whole).unwrap();
    let verdict = Command::new("nginx").args(["-t", "-p", &at(""), "-c", &at("nginx.conf")]).output().unwrap();
    assert!(verdict.status.success(), "{}", String::from_utf8_lossy(&verdict.stderr));
}
