//! From flags, variables and the file to values.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use super::{SETTINGS, Setting, Value};

/// What was said, and where. Keys are the settings' own.
#[derive(Clone, Debug, Default)]
pub struct Sources {
    pub flags: BTreeMap<String, String>,
    pub variables: BTreeMap<String, String>,
    pub file: BTreeMap<String, String>,
    /// Which file was read.
    pub path: Option<PathBuf>,
}

/// Where a value came from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    Flag(String),
    Variable(String),
    File(PathBuf),
    Default,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Origin::Flag(name) => write!(f, "--{name}"),
            Origin::Variable(name) => f.write_str(name),
            Origin::File(path) => write!(f, "{}", path.display()),
            Origin::Default => f.write_str("default"),
        }
    }
}

/// A setting's value as text.
#[derive(Clone, Debug)]
pub struct Effective {
    pub setting: &'static Setting,
    pub text: String,
    pub origin: Origin,
}

/// Why the settings cannot be used: the file, or a value with the place that it came from.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    #[error("the configuration {path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    #[error("the configuration {path} is no TOML: {message}")]
    Syntax { path: PathBuf, message: String },
    #[error("{path}: there is no setting {key:?}{}", hint(nearest))]
    Unknown { path: PathBuf, key: String, nearest: Option<&'static str> },
    #[error("{origin}: {key} is {got:?}, expected {expected}")]
    Wrong { origin: Origin, key: &'static str, got: String, expected: String },
}

fn hint(nearest: &Option<&'static str>) -> String {
    nearest.map(|key| format!("; did you mean {key:?}?")).unwrap_or_default()
}

/// Variables of this prefix are ours.
const PREFIX: &str = "EFFIGY_";
/// Variables of ours that are no settings: they are for the command line and for measuring.
const OTHER_VARIABLES: [&str; 7] =
    ["CONFIG", "DEVICE", "GPU_CHECKED", "GPU_PROFILE", "NO_WIDE_ATOMICS", "WIDE_KERNELS", "GOLDEN_DIR"];

impl Sources {
    /// Takes the settings among the process's variables; the others of our prefix come back with the nearest setting,
    /// where one is near: a later version may know them, so they are no errors.
    pub fn with_variables(mut self, all: impl Iterator<Item = (String, String)>) -> (Self, Vec<(String, String)>) {
        let mut strange = Vec::new();
        for (name, value) in all {
            let Some(rest) = name.strip_prefix(PREFIX) else { continue };
            let key = rest.to_lowercase();
            if let Some(setting) = Setting::of(&key).filter(|setting| setting.variable() == name) {
                self.variables.insert(setting.key.into(), value);
            } else if !OTHER_VARIABLES.contains(&rest)
                && let Some(nearest) = nearest(&key)
            {
                strange.push((name, format!("{PREFIX}{}", nearest.to_uppercase())));
            }
        }
        (self, strange)
    }

    pub fn with_file(mut self, path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path).map_err(|source| ConfigError::Read { path: path.into(), source })?;
        let syntax = |message: String| ConfigError::Syntax { path: path.into(), message };
        let table: toml::Table = text.parse().map_err(|error: toml::de::Error| syntax(error.to_string()))?;
        for (key, value) in table {
            let text = plain(&value).ok_or_else(|| syntax(format!("{key} is a {}", value.type_str())));
            // An unknown table is told as unknown, not as ill-formed.
            let text = if Setting::of(&key).is_some() { text? } else { String::new() };
            self.file.insert(key, text);
        }
        self.path = Some(path.into());
        Ok(self)
    }

    /// Only the file can name what does not exist: flags are checked by the command line.
    pub(super) fn check_keys(&self) -> Result<(), ConfigError> {
        match self.file.keys().find(|key| Setting::of(key).is_none()) {
            None => Ok(()),
            Some(key) => Err(ConfigError::Unknown {
                path: self.path.clone().unwrap_or_default(),
                key: key.clone(),
                nearest: nearest(key),
            }),
        }
    }

    pub(super) fn value<T: Value>(&self, key: &'static str, effective: &mut Vec<Effective>) -> Result<T, ConfigError> {
        let setting = Setting::of(key).expect("the list made this call");
        let (text, origin) = self.find(setting);
        let Some(value) = T::parse(text) else {
            return Err(ConfigError::Wrong { origin, key, got: text.into(), expected: T::kind() });
        };
        effective.push(Effective { setting, text: value.text(), origin });
        Ok(value)
    }

    fn find(&self, setting: &'static Setting) -> (&str, Origin) {
        if let Some(text) = self.flags.get(setting.key) {
            return (text, Origin::Flag(setting.flag()));
        }
        if let Some(text) = self.variables.get(setting.key) {
            return (text, Origin::Variable(setting.variable()));
        }
        if let Some(text) = self.file.get(setting.key) {
            return (text, Origin::File(self.path.clone().unwrap_or_default()));
        }
        (setting.default, Origin::Default)
    }
}

/// A value of the file as it would stand in a variable; lists are separated by commas.
fn plain(value: &toml::Value) -> Option<String> {
    match value {
        toml::Value::String(text) => Some(text.clone()),
        toml::Value::Integer(number) => Some(number.to_string()),
        toml::Value::Float(number) => Some(number.to_string()),
        toml::Value::Boolean(truth) => Some(truth.to_string()),
        toml::Value::Array(all) => all.iter().map(plain).collect::<Option<Vec<_>>>().map(|all| all.join(",")),
        _ => None,
    }
}

/// The setting whose key is most like this one, unless all are quite different.
fn nearest(key: &str) -> Option<&'static str> {
    let near = SETTINGS.iter().map(|setting| (strsim::damerau_levenshtein(setting.key, key), setting.key)).min()?;
    (near.0 <= 2 + key.len() / 4).then_some(near.1)
}

/// The file to read: the one that is named, else the user's, else the system's, where there is one.
pub fn find_file(named: Option<&Path>, variable: impl Fn(&str) -> Option<PathBuf>) -> Option<PathBuf> {
    // An empty name says: none.
    if let Some(path) = named.map(Path::to_path_buf).or_else(|| variable("EFFIGY_CONFIG")) {
        return (!path.as_os_str().is_empty()).then_some(path);
    }
    let home = variable("XDG_CONFIG_HOME").or_else(|| variable("HOME").map(|home| home.join(".config")));
    let places = home.map(|folder| folder.join("effigy/effigy.toml")).into_iter();
    places.chain([PathBuf::from("/etc/effigy/effigy.toml")]).find(|path| path.is_file())
}
