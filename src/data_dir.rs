//! Where Effigy keeps what it makes: bodies, jobs, avatars.

use std::path::PathBuf;

/// `$EFFIGY_DATA_DIR`, else `$XDG_DATA_HOME/effigy`, else `~/.local/share/effigy`; the working directory's
/// `effigy-data` where there is not even a home.
pub fn data_dir() -> PathBuf {
    choose(|name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from))
}

/// The file of a named body. Whatever is no letter, digit, `-` or `_` in the name becomes `_`, so that no name leads
/// out of the folder.
pub fn body_path(name: &str) -> PathBuf {
    let name: String = name.chars().map(|c| if c.is_alphanumeric() || c == '-' { c } else { '_' }).collect();
    data_dir().join("bodies").join(format!("{name}.body.npz"))
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

    #[test]
    fn a_name_cannot_leave_the_folder() {
        let folder = data_dir().join("bodies");
        for name in ["../../etc/passwd", "/etc/passwd", "a/b", ".."] {
            assert_eq!(body_path(name).parent(), Some(folder.as_path()), "{name}");
        }
        assert!(body_path("smpl-neutral").ends_with("bodies/smpl-neutral.body.npz"));
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
