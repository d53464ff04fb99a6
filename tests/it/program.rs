//! The program, and others, as the tests start them.

use std::path::Path;
use std::process::Command;

use effigy::config::SETTINGS;

/// `effigy` on its defaults: the file and the variables of the service that this machine may run are none of a test's, and
/// its proxy neither. Variables that are no settings (`EFFIGY_DEVICE`) stay.
pub fn effigy() -> Command {
    let mut effigy = Command::new(env!("CARGO_BIN_EXE_effigy"));
    for setting in SETTINGS {
        effigy.env_remove(setting.variable());
    }
    // An empty name says: no file.
    effigy.env("EFFIGY_CONFIG", "");
    for proxy in ["http_proxy", "https_proxy", "all_proxy"] {
        effigy.env_remove(proxy).env_remove(proxy.to_uppercase());
    }
    effigy
}

/// A script of `tools/`, or `None` after saying that `test` is ignored: its packages are not installed. CI installs them.
pub fn tool(test: &str, folder: &str, script: &str) -> Option<Command> {
    let tool = Path::new(env!("CARGO_MANIFEST_DIR")).join("tools").join(folder);
    if !tool.join("node_modules").exists() {
        assert!(std::env::var_os("CI").is_none(), "{test}: CI installs tools/{folder}");
        eprintln!("{test}: ignored, `npm ci --prefix tools/{folder}` was not run");
        return None;
    }
    let mut node = Command::new("node");
    node.arg(tool.join(script));
    Some(node)
}
