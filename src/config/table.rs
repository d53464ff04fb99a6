//! The settings as text: their documentation, and the values in force.

use super::{Effective, SETTINGS};

/// The table of `docs/configuration.md`.
pub fn table() -> String {
    let mut text = String::from("| key | values | default | what it does |\n|---|---|---|---|\n");
    for setting in SETTINGS {
        let default = if setting.default.is_empty() { "".into() } else { format!("`{}`", setting.default) };
        let doc = setting.doc.trim();
        text += &format!("| `{}` | {} | {default} | {doc} |\n", setting.key, (setting.kind)());
    }
    text
}

/// The values in force as a file that would give them, each with its origin.
pub fn show(effective: &[Effective]) -> String {
    let lines: Vec<(String, String)> =
        effective.iter().map(|e| (format!("{} = {}", e.setting.key, literal(&e.text)), e.origin.to_string())).collect();
    let width = lines.iter().map(|(line, _)| line.len()).max().unwrap_or(0);
    lines.into_iter().map(|(line, origin)| format!("{line:width$}  # {origin}\n")).collect()
}

fn literal(text: &str) -> String {
    let bare = text.parse::<i64>().is_ok() || text.parse::<bool>().is_ok();
    if bare { text.into() } else { toml::Value::String(text.into()).to_string() }
}
