//! Where Effigy keeps what it makes: bodies, jobs, avatars.

use std::path::{Path, PathBuf};

/// `$EFFIGY_DATA_DIR`, else `$XDG_DATA_HOME/effigy`, else `~/.local/share/effigy`; the working directory's
/// `effigy-data` where there is not even a home.
pub fn data_dir() -> PathBuf {
    choose(|name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from))
}

/// What [`is_body_name`] takes, for errors.
pub const BODY_NAME: &str = "1 to 64 letters, digits, hyphens or underscores";

const MAX_NAME_LEN: usize = 64;

/// Whether a body may be called so: a job names it in its options, and the name becomes a file name.
pub fn is_body_name(name: &str) -> bool {
    (1..=MAX_NAME_LEN).contains(&name.len()) && name.chars().all(is_plain)
}

fn is_plain(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '-' || c == '_'
}

/// The name that is nearest to a text: whatever is no letter, digit, `-` or `_` becomes `_`, and what is too long is cut.
pub fn body_name(text: &str) -> String {
    let name: String = text.chars().take(MAX_NAME_LEN).map(|c| if is_plain(c) { c } else { '_' }).collect();
    if name.is_empty() { "_".to_owned() } else { name }
}

/// The file of a named body. No name leads out of the folder.
pub fn body_path(name: &str) -> PathBuf {
    body_path_in(&data_dir(), name)
}

/// As [`body_path`], of another data folder.
pub fn body_path_in(data_dir: &Path, name: &str) -> PathBuf {
    data_dir.join("bodies").join(format!("{}.body.npz", body_name(name)))
}

/// Makes a data folder where there is none, for this user alone: its database will hold the secrets that sign links and webhooks.
pub fn create(root: &Path) -> std::io::Result<()> {
    let mut private = std::fs::DirBuilder::new();
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut private, 0o700);
    private.recursive(true).create(root)
}

fn choose(variable: impl Fn(&str) -> Option<PathBuf>) -> PathBuf {
    variable("EFFIGY_DATA_DIR")
        .or_else(|| variable("XDG_DATA_HOME").map(|path| path.join("effigy")))
        .or_else(|| variable("HOME").map(|path| path.join(".local/share/effigy")))
        .unwrap_or_else(|| PathBuf::from("effigy-data"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn a_folder_that_is_made_is_this_users_alone() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let made = folder.path().join("share/effigy");
        create(&made).unwrap();
        create(&made).unwrap();
        assert_eq!(made.metadata().unwrap().permissions().mode() & 0o777, 0o700);
    }

    #[test]
    fn a_name_cannot_leave_the_folder() {
        let folder = data_dir().join("bodies");
        for name in ["../../etc/passwd", "/etc/passwd", "a/b", ".."] {
            assert_eq!(body_path(name).parent(), Some(folder.as_path()), "{name}");
        }
        assert!(body_path("smpl-neutral").ends_with("bodies/smpl-neutral.body.npz"));
    }

    #[test]
    fn whatever_a_body_is_called_after_its_name_is_one() {
        let long = "x".repeat(65);
        for (text, expected) in [
            ("smpl-neutral", "smpl-neutral"),
            ("lbs-10-207-0-v1.1.0", "lbs-10-207-0-v1_1_0"),
            ("körper (1)", "k_rper__1_"),
            ("", "_"),
            (&long, &long[..64]),
        ] {
            assert_eq!(body_name(text), expected);
            assert!(is_body_name(expected) && is_body_name(text) == (text == expected), "{text}");
        }
    }

    #[test]
    fn the_most_special_variable_wins() {
        let all = [("EFFIGY_DATA_DIR", "/a"), ("XDG_DATA_HOME", "/b"), ("HOME", "/c")];
        let expected = ["/a", "/b/effigy", "/c/.local/share/effigy", "effigy-data"];
        for (n, expected) in expected.iter().enumerate() {
            let set = |name: &str| all[n..].iter().find(|(key, _)| *key == name).map(|(_, value)| PathBuf::from(value));
            assert_eq!(choose(set), PathBuf::from(expected));
        }
    }
}
