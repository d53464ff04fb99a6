//! `effigy openapi`: the description of the API, as `openapi.yaml` holds it.

use anyhow::Result;

pub fn run() -> Result<()> {
    print!("{}", effigy::http::openapi::yaml()?);
    Ok(())
}
