//! The kinds of values. Each is read from text, whether that came from a flag, a variable or the file.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// A kind of setting's value: [`Value::parse`] reads what [`Value::text`] writes.
pub trait Value: Sized {
    /// What its values look like, for the documentation and for errors.
    fn kind() -> String;
    /// None where the text is no such value.
    fn parse(text: &str) -> Option<Self>;
    /// Text that reads as this value.
    fn text(&self) -> String;
}

/// A size, written as a number of bytes or with a unit: `512MiB`, `4 GiB`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bytes(pub u64);

const UNITS: [(&str, u64); 4] = [("TiB", 1 << 40), ("GiB", 1 << 30), ("MiB", 1 << 20), ("KiB", 1 << 10)];

impl Value for Bytes {
    fn kind() -> String {
        "bytes, or with KiB, MiB, GiB or TiB".into()
    }

    fn parse(text: &str) -> Option<Self> {
        let (number, unit) = UNITS
            .iter()
            .find_map(|(name, bytes)| Some((text.strip_suffix(name)?.trim_end(), *bytes)))
            .unwrap_or((text, 1));
        number.parse::<u64>().ok()?.checked_mul(unit).map(Bytes)
    }

    fn text(&self) -> String {
        let unit = UNITS.iter().find(|(_, bytes)| self.0 >= *bytes && self.0.is_multiple_of(*bytes));
        unit.map_or_else(|| self.0.to_string(), |(name, bytes)| format!("{}{name}", self.0 / bytes))
    }
}

/// Worker processes that the server runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Workers(pub u8);

impl Value for Workers {
    fn kind() -> String {
        "0 or 1".into()
    }

    fn parse(text: &str) -> Option<Self> {
        text.parse().ok().filter(|n| *n <= 1).map(Workers)
    }

    fn text(&self) -> String {
        self.0.to_string()
    }
}

/// A time that is none to be switched off by 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seconds(pub u32);

impl Seconds {
    pub fn duration(self) -> Duration {
        Duration::from_secs(self.0.into())
    }
}

impl Value for Seconds {
    fn kind() -> String {
        "a number, 1 or more".into()
    }

    fn parse(text: &str) -> Option<Self> {
        text.parse().ok().filter(|secs| *secs > 0).map(Seconds)
    }

    fn text(&self) -> String {
        self.0.to_string()
    }
}

/// An origin as browsers write it: in lower case, a name of other letters in its own spelling, without the scheme's own port.
fn origin(text: &str) -> Option<String> {
    if ["*", "null"].contains(&text) {
        return Some(text.into());
    }
    let (scheme, host) = text.split_once("://")?;
    let host = host.trim_end_matches('/');
    if host.is_empty() || host.chars().any(|c| c.is_whitespace() || "/?#@*".contains(c)) {
        return None;
    }
    match scheme.to_lowercase().as_str() {
        "http" | "https" => Some(reqwest::Url::parse(text).ok()?.origin().ascii_serialization()),
        // Of apps and extensions.
        other => Some(format!("{other}://{}", host.to_lowercase())),
    }
}

/// Where pages come from, as browsers write it in `Origin`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origins(pub Vec<String>);

impl Value for Origins {
    fn kind() -> String {
        "a list of `scheme://host` or `scheme://host:port`, `null` or `*`".into()
    }

    fn parse(text: &str) -> Option<Self> {
        text.split(',').map(str::trim).filter(|item| !item.is_empty()).map(origin).collect::<Option<_>>().map(Origins)
    }

    fn text(&self) -> String {
        self.0.join(",")
    }
}

/// An enumeration whose values have names.
macro_rules! choice {
    ($(#[doc = $doc:literal])+ $name:ident { $($(#[doc = $what:literal])+ $variant:ident = $text:literal,)+ }) => {
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name { $($(#[doc = $what])+ $variant,)+ }

        impl Value for $name {
            fn kind() -> String {
                [$(concat!("`", $text, "`")),+].join(" or ")
            }

            fn parse(text: &str) -> Option<Self> {
                match text { $($text => Some($name::$variant),)+ _ => None }
            }

            fn text(&self) -> String {
                match self { $($name::$variant => $text.into(),)+ }
            }
        }
    };
}

choice! {
    /// Whether callers must show a key.
    Auth {
        /// Where others can reach the server, or there is a key.
        Auto = "auto",
        /// Always.
        Keys = "keys",
        /// Never: whoever reaches the server may do everything.
        Open = "open",
    }
}

choice! {
    /// The form of the log.
    LogFormat {
        /// Lines for people.
        Text = "text",
        /// An object a line.
        Json = "json",
    }
}

macro_rules! parsed {
    ($($type:ty: $kind:literal),+) => { $(
        impl Value for $type {
            fn kind() -> String {
                $kind.into()
            }

            fn parse(text: &str) -> Option<Self> {
                text.parse().ok()
            }

            fn text(&self) -> String {
                self.to_string()
            }
        }
    )+ };
}

parsed!(SocketAddr: "address:port", u32: "a number", String: "text", bool: "true or false");

impl Value for PathBuf {
    fn kind() -> String {
        "a path".into()
    }

    fn parse(text: &str) -> Option<Self> {
        (!text.is_empty()).then(|| text.into())
    }

    fn text(&self) -> String {
        self.to_string_lossy().into_owned()
    }
}

/// Empty text is none.
impl<T: Value> Value for Option<T> {
    fn kind() -> String {
        format!("{}, or empty", T::kind())
    }

    fn parse(text: &str) -> Option<Self> {
        if text.is_empty() { Some(None) } else { T::parse(text).map(Some) }
    }

    fn text(&self) -> String {
        self.as_ref().map(T::text).unwrap_or_default()
    }
}
