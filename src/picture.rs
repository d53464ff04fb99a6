//! How a picture of an avatar shall look, as those who ask for it say it.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// The light of a picture: `captured`, in which the clip was filmed, or `none`, which shows the base colour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Light {
    /// That in which the clip was filmed; it stands still in the world.
    #[default]
    Captured,
    /// None: the bare base colour.
    None,
}

/// What lies behind the person: nothing, or sRGB.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Background {
    #[default]
    Transparent,
    Colour([u8; 3]),
}

/// A text that names no background.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not {}", Background::EXPECTED)]
pub struct NoBackground;

impl Background {
    /// What is read as a background.
    pub const EXPECTED: &str = "transparent or #rrggbb";
}

impl FromStr for Background {
    type Err = NoBackground;

    fn from_str(text: &str) -> Result<Self, NoBackground> {
        if text == "transparent" {
            return Ok(Background::Transparent);
        }
        let is_colour = |hex: &&str| hex.len() == 6 && hex.bytes().all(|b| b.is_ascii_hexdigit());
        let hex = text.strip_prefix('#').filter(is_colour).ok_or(NoBackground)?;
        let [_, r, g, b] = u32::from_str_radix(hex, 16).map_err(|_| NoBackground)?.to_be_bytes();
        Ok(Background::Colour([r, g, b]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backgrounds_are_colours_or_none() {
        assert_eq!("transparent".parse(), Ok(Background::Transparent));
        assert_eq!("#ff8000".parse(), Ok(Background::Colour([255, 128, 0])));
        assert_eq!("#FF8000".parse(), Ok(Background::Colour([255, 128, 0])));
        for text in ["", "#", "ff8000", "#ff800", "#ff80000", "#ff800g", "#+f8000", "red", "Transparent"] {
            assert_eq!(text.parse::<Background>(), Err(NoBackground), "{text}");
        }
    }
}
