//! Text as other systems write it.

use super::{BadInput, Part};

/// A text, or its beginning, without the mark that tools on Windows put before it.
///
/// # Errors
/// [`BadInput`] for UTF-16, which the mark tells.
pub(super) fn plain(part: Part, bytes: &[u8]) -> Result<&[u8], BadInput> {
    if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") {
        return Err(BadInput::new(part, "the text is UTF-16", "JSON in UTF-8"));
    }
    Ok(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes))
}
