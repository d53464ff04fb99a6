use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::*;

fn map(pairs: &[(&str, &str)]) -> BTreeMap<String, String> {
    pairs.iter().map(|(key, value)| (key.to_string(), value.to_string())).collect()
}

fn file(text: &str) -> Result<Sources, ConfigError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("effigy.toml");
    std::fs::write(&path, text).unwrap();
    Sources::default().with_file(&path)
}

fn resolve(text: &str) -> Result<Config, ConfigError> {
    Ok(Config::resolve(&file(text)?)?.0)
}

#[test]
fn a_flag_wins_over_a_variable_over_the_file_over_the_default() {
    let mut sources = file("retain_days = 1\nlog = \"info\"").unwrap();
    let expect = |sources: &Sources, days: Option<u32>, origin: &str| {
        let (config, effective) = Config::resolve(sources).unwrap();
        let found = effective.iter().find(|e| e.setting.key == "retain_days").unwrap();
        assert_eq!((config.retain_days, found.origin.to_string().contains(origin)), (days, true), "{effective:?}");
    };
    expect(&Sources::default(), None, "default");
    expect(&sources, Some(1), "effigy.toml");
    sources.variables = map(&[("retain_days", "2")]);
    expect(&sources, Some(2), "EFFIGY_RETAIN_DAYS");
    sources.flags = map(&[("retain_days", "3")]);
    expect(&sources, Some(3), "--retain-days");
    sources.flags = map(&[("retain_days", "")]);
    expect(&sources, None, "--retain-days");
}

#[test]
fn an_unknown_key_is_an_error_that_names_the_nearest() {
    for (text, nearest) in
        [("lisen = \"x\"", "listen"), ("max_upload_byte = 1", "max_upload_bytes"), ("[log_fromat]", "log_format")]
    {
        let error = resolve(text).unwrap_err().to_string();
        assert!(error.contains(&format!("did you mean {nearest:?}?")), "{error}");
    }
    let far = resolve("colour_of_the_sky = 1").unwrap_err().to_string();
    assert!(far.contains("colour_of_the_sky") && !far.contains("did you mean"), "{far}");
}

#[test]
fn a_wrong_value_names_its_origin_and_what_was_expected() {
    for (text, key) in [
        ("listen = 8080", "listen"),
        ("workers = 2", "workers"),
        ("max_upload_bytes = \"4 GB\"", "max_upload_bytes"),
        ("max_upload_bytes = -1", "max_upload_bytes"),
        ("retain_days = \"soon\"", "retain_days"),
        ("log_format = \"xml\"", "log_format"),
    ] {
        let error = resolve(text).unwrap_err().to_string();
        let kind = (Setting::of(key).unwrap().kind)();
        assert!(error.contains(&format!("{key} is")) && error.contains(&kind), "{error}");
        assert!(error.contains("effigy.toml"), "{error}");
    }
    assert!(resolve("listen = ").unwrap_err().to_string().contains("no TOML"));
    assert!(resolve("[listen]").unwrap_err().to_string().contains("listen is a table"));
    assert!(matches!(Sources::default().with_file(Path::new("/nowhere")), Err(ConfigError::Read { .. })));
}

#[test]
fn what_is_shown_reads_back_as_the_same() {
    let mut sources =
        Sources { flags: map(&[("max_upload_bytes", "3 MiB"), ("data_dir", "/a \"b\"")]), ..Sources::default() };
    sources.variables = map(&[("retain_days", "30")]);
    let (_, effective) = Config::resolve(&sources).unwrap();
    let again = file(&show(&effective)).unwrap();
    let (config, second) = Config::resolve(&again).unwrap();
    let texts = |all: &[Effective]| all.iter().map(|e| e.text.clone()).collect::<Vec<_>>();
    assert_eq!(texts(&effective), texts(&second));
    assert_eq!((config.max_upload_bytes, config.retain_days), (Bytes(3 << 20), Some(30)));
    assert_eq!(config.data_dir, Some(PathBuf::from("/a \"b\"")));
}

#[test]
fn variables_are_taken_by_their_exact_names() {
    let all = ["EFFIGY_LISTEN", "EFFIGY_LISTNE", "EFFIGY_DEVICE", "EFFIGY_listen", "LISTEN", "EFFIGY_SOMETHING_ELSE"];
    let all = all.iter().map(|name| (name.to_string(), "127.0.0.1:1".to_string()));
    let (sources, strange) = Sources::default().with_variables(all);
    assert_eq!(sources.variables, map(&[("listen", "127.0.0.1:1")]));
    assert!(strange.contains(&("EFFIGY_LISTNE".into(), "EFFIGY_LISTEN".into())), "{strange:?}");
    assert!(!strange.iter().any(|(name, _)| name == "EFFIGY_DEVICE" || name == "EFFIGY_SOMETHING_ELSE"));
}

#[test]
fn the_file_is_the_named_one_or_the_users() {
    let home = tempfile::tempdir().unwrap();
    let users = home.path().join(".config/effigy/effigy.toml");
    std::fs::create_dir_all(users.parent().unwrap()).unwrap();
    std::fs::write(&users, "").unwrap();
    let variable = |name: &str| (name == "HOME").then(|| home.path().to_path_buf());
    assert_eq!(find_file(None, variable), Some(users));
    assert_eq!(find_file(Some(Path::new("/x.toml")), variable), Some("/x.toml".into()));
    assert_eq!(find_file(Some(Path::new("")), variable), None);
    assert_eq!(find_file(None, |name| (name == "EFFIGY_CONFIG").then(|| "/y".into())), Some("/y".into()));
}

#[test]
fn sizes_have_units() {
    for (text, bytes) in [("0", 0), ("17", 17), ("2KiB", 2048), ("4 GiB", 4 << 30), ("1TiB", 1 << 40)] {
        assert_eq!(Bytes::parse(text), Some(Bytes(bytes)), "{text}");
        assert_eq!(Bytes::parse(&Bytes(bytes).text()), Some(Bytes(bytes)));
    }
    for text in ["", "GiB", "1.5GiB", "-1", "99999999TiB", "4 gib"] {
        assert_eq!(Bytes::parse(text), None, "{text}");
    }
}

#[test]
fn a_time_that_would_stop_all_work_is_refused() {
    for key in ["stall_secs", "upload_ttl_secs"] {
        let error = resolve(&format!("{key} = 0")).unwrap_err().to_string();
        assert!(error.contains("1 or more"), "{error}");
    }
}

#[test]
fn origins_are_as_browsers_write_them() {
    let origins = |text: &str| Origins::parse(text).map(|origins| origins.0.join(" "));
    let read = origins("https://Example.org/, http://localhost:3000,*");
    assert_eq!(read.as_deref(), Some("https://example.org http://localhost:3000 *"));
    assert_eq!(origins("").as_deref(), Some(""));
    let read = origins("https://example.org:443,http://Bücher.example,capacitor://localhost,null");
    assert_eq!(read.as_deref(), Some("https://example.org http://xn--bcher-kva.example capacitor://localhost null"));
    for text in ["example.org", "https://", "https://example.org/page", "https://h:abc", "https://*.example.org"] {
        assert_eq!(origins(text), None, "{text}");
    }
}

#[test]
fn the_documented_table_is_that_of_the_settings() {
    let page = include_str!("../../docs/configuration.md");
    assert!(page.contains(&table()), "docs/configuration.md is stale: `effigy config --table` prints the table");
}
