//! Settings through the program itself.

use effigy::config::{Config, Sources};
use effigy::http::Limits;
use effigy::jobs::Policy;
use effigy::worker::WorkerSettings;

use crate::program::effigy;

fn config(arguments: &[&str], variables: &[(&str, &str)]) -> (bool, String, String) {
    let output = effigy().arg("config").args(arguments).envs(variables.iter().copied()).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.success(), text(output.stdout), text(output.stderr))
}

#[test]
fn the_program_tells_where_each_setting_comes_from() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("effigy.toml");
    std::fs::write(&file, "listen = \"127.0.0.1:9\"\nretain_days = 7\nlog = \"debug\"").unwrap();
    let file = file.to_str().unwrap();
    let variables = [("EFFIGY_CONFIG", file), ("EFFIGY_LOG", "info"), ("EFFIGY_RETAIN_DAYS", "8")];
    let (ok, said, _) = config(&["--retain-days", "9"], &variables);
    assert!(ok, "{said}");
    let line = |key: &str| said.lines().find(|line| line.starts_with(key)).unwrap_or_else(|| panic!("{key}: {said}"));
    assert!(line("retain_days").starts_with("retain_days = 9 ") && line("retain_days").ends_with("# --retain-days"));
    assert!(line("log ").contains("\"info\"") && line("log ").ends_with("# EFFIGY_LOG"));
    assert!(line("listen").contains("127.0.0.1:9") && line("listen").ends_with(&format!("# {file}")));
    assert!(line("workers").ends_with("# default"));

    // What was printed is a file that gives the same.
    let printed = folder.path().join("printed.toml");
    std::fs::write(&printed, &said).unwrap();
    let (ok, again, _) = config(&["--config", printed.to_str().unwrap()], &[]);
    let values =
        |text: &str| text.lines().map(|l| l.split("  #").next().unwrap().trim().to_string()).collect::<Vec<_>>();
    assert!(ok && values(&said) == values(&again), "{again}");
}

#[test]
fn a_misspelt_key_ends_the_program_and_names_the_right_one() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("effigy.toml");
    std::fs::write(&file, "retian_days = 7").unwrap();
    let (ok, _, said) = config(&["--config", file.to_str().unwrap()], &[]);
    assert!(!ok && said.contains("did you mean \"retain_days\""), "{said}");
    let (ok, _, said) = config(&["--config", ""], &[("EFFIGY_LISTNE", "x")]);
    assert!(ok && said.contains("did you mean EFFIGY_LISTEN"), "{said}");
}

#[test]
fn what_a_part_takes_by_itself_is_what_the_settings_say() {
    let (config, _) = Config::resolve(&Sources::default()).unwrap();
    let (limits, policy, worker) = (Limits::default(), Policy::default(), WorkerSettings::default());
    assert_eq!(limits.upload_bytes, config.max_upload_bytes.0);
    assert_eq!(
        (limits.open_uploads, limits.open_upload_bytes),
        (config.max_open_uploads as usize, config.max_open_upload_bytes.0)
    );
    assert_eq!(limits.upload_ttl, config.upload_ttl_secs.duration());
    assert_eq!(policy.max_queued, u64::from(config.max_queued));
    assert_eq!((policy.retention, worker.stall), (None, config.stall_secs.duration()));
    assert_eq!(config.retain_days, None);
}
