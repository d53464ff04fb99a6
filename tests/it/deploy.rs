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

/// What of a file is run: shell, or the words after the program's name where a file gives only these.
fn commands(file: &str) -> Vec<String> {
    let text = text(file);
    let mut fenced = false;
    let mut found: Vec<String> = Vec::new();
    for line in text.lines() {
        let comment = line.trim_start().strip_prefix('#').map(str::trim_start);
        let command = match file.rsplit('.').next().unwrap() {
            "md" if line.starts_with("```") => {
                fenced = !fenced;
                None
            }
            "md" => fenced.then(|| line.to_string()),
            "service" => line.strip_prefix("Exec").map(|rest| rest.split_once('=').unwrap().1.to_string()),
            "yaml" => comment.filter(|said| said.starts_with("docker ")).map(String::from),
            "Dockerfile" | "sh" if comment.is_some() => None,
            "Dockerfile" if line.starts_with("CMD [") => {
                let words: Vec<String> = serde_json::from_str(&line["CMD ".len()..]).unwrap();
                Some(format!("effigy {}", words.join(" ")))
            }
            "Dockerfile" | "sh" => Some(line.to_string()),
            _ => None,
        };
        found.extend(command);
        // In a sentence.
        if !fenced {
            let code = line.split('`').skip(1).step_by(2);
            found.extend(code.filter(|code| code.starts_with("effigy ")).map(String::from));
        }
    }
    if file == "compose.yaml" {
        let compose: Value = yaml_serde::from_str(&text).unwrap();
        let services = compose["services"].as_object().unwrap().values().chain([&compose["x-effigy"]]);
        for command in services.filter_map(|service| service.get("command")) {
            let words = command.as_array().into_iter().flatten().chain([command]).filter_map(Value::as_str);
            found.push(format!("effigy {}", words.collect::<Vec<_>>().join(" ")));
        }
    }
    found
}

/// Calls of the program in a command, as the words after its name.
fn calls(command: &str) -> Vec<Vec<&str>> {
    let command = command.split(" #").next().unwrap();
    let words: Vec<&str> = command.split_whitespace().map(|word| word.trim_matches('"')).collect();
    let mut found = Vec::new();
    for (at, word) in words.iter().enumerate() {
        let program = *word == "effigy" || word.ends_with("/bin/effigy");
        // A user, a group or a service of compose; and what ends a command is an argument of another program.
        let other = at > 0 && ["-u", "-g", "-o", "exec"].contains(&words[at - 1]);
        let own = words[at + 1..].iter().take_while(|word| !["|", "||", "&&", ";", ">"].contains(word));
        let own: Vec<&str> = own.copied().collect();
        if program && !other && !own.is_empty() {
            found.push(own);
        }
    }
    found
}

/// What is wrong with a call: a command that does not exist, or a flag that is none of the command's.
fn fault(call: &[&str]) -> Option<String> {
    let mut path = Vec::new();
    loop {
        let name = ["effigy"].iter().chain(&path).copied().collect::<Vec<_>>().join(" ");
        let help = String::from_utf8(effigy(&[&path[..], &["--help"]].concat()).stdout).unwrap();
        let (_, lists) = help.split_once("Usage: ").unwrap();
        let commands = lists.split_once("\nCommands:\n").map(|(_, rest)| rest.split("\n\n").next().unwrap());
        let next = call.get(path.len()).filter(|word| !word.starts_with('-'));
        if let (Some(commands), Some(next)) = (commands, next) {
            if !commands.lines().any(|line| line.split_whitespace().next() == Some(next)) {
                return Some(format!("there is no {name} {next}"));
            }
            path.push(*next);
            continue;
        }
        // A line of flags is `-s, --long <VALUE>  What it does`.
        let lines = lists.lines().map(str::trim_start).filter(|line| line.starts_with('-'));
        let words = lines.flat_map(|line| line.split("  ").next().unwrap().split([' ', ',']));
        let flags: Vec<&str> = words.filter(|word| word.starts_with('-')).collect();
        let given = call[path.len()..].iter().filter(|word| word.starts_with('-') && word.len() > 1);
        let unknown = given.map(|word| word.split('=').next().unwrap()).find(|flag| !flags.contains(flag));
        return unknown.map(|flag| format!("{name} has no {flag}"));
    }
}

#[test]
fn every_command_and_flag_that_they_name_exists() {
    let mut seen = Vec::new();
    for file in FILES {
        for command in commands(file) {
            for call in calls(&command) {
                assert_eq!(fault(&call), None, "deploy/{file}: {command}");
                seen.push((file, call[0].to_string()));
            }
        }
    }
    // The search finds what is there: fences and sentences, the unit's start, the image's command, compose's comments.
    for (file, call) in [
        ("README.md", "doctor"),
        ("README.md", "keys"),
        ("effigy.service", "serve"),
        ("effigy.toml", "config"),
        ("Dockerfile", "serve"),
        ("compose.yaml", "keys"),
    ] {
        assert!(seen.contains(&(file, call.into())), "deploy/{file} calls {call}: {seen:?}");
    }
}

#[test]
fn a_call_of_what_does_not_exist_is_found() {
    for (command, wrong) in [
        ("effigy frobnicate --x", "no effigy frobnicate"),
        ("docker compose -f deploy/compose.yaml exec effigy effigy docter", "no effigy docter"),
        ("runuser -u effigy -- effigy keys destroy me", "no effigy keys destroy"),
        ("/usr/local/bin/effigy serve --conf /etc/effigy/effigy.toml", "effigy serve has no --conf"),
        ("effigy keys create me --listen=127.0.0.1:1", "effigy keys create has no --listen"),
    ] {
        let calls = calls(command);
        let said = calls.first().and_then(|call| fault(call));
        assert!(calls.len() == 1 && said.as_ref().is_some_and(|said| said.contains(wrong)), "{command}: {said:?}");
    }
    assert_eq!(fault(&["keys", "create", "me", "--config=a", "--per-minute", "9"]), None);
    for argument in ["install -d -o effigy -g effigy /var/lib/effigy", "scripts/body.sh /usr/local/bin/effigy"] {
        assert_eq!(calls(argument).len(), 0, "{argument}");
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
