//! The program as the tests start it.

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
