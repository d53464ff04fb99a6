//! The look at an upload: its clip and the body that it asks for.

use std::sync::Arc;

use super::app::{InspectError, Inspector};
use crate::capture::{self, CaptureError, CaptureInputs};
use crate::jobs::{Clip, JobOptions};
use crate::storage::Store;

/// Checks everything against everything, by the rules of [`capture::inspect`].
pub struct ClipInspector {
    pub store: Arc<Store>,
}

impl Inspector for ClipInspector {
    fn inspect(&self, files: &CaptureInputs, options: &JobOptions) -> Result<Clip, InspectError> {
        self.check_body(&options.body)?;
        let found = capture::inspect(files).map_err(|error| match error {
            CaptureError::Bad(bad) => InspectError::Bad {
                part: bad.part.to_string(),
                frame: bad.frame,
                message: bad.message,
                expected: bad.expected,
            },
            error => InspectError::Internal(error.into()),
        })?;
        let capture::Inspection { frames, width, height, fps, warnings, .. } = found;
        Ok(Clip { frames, width, height, fps, warnings })
    }
}

impl ClipInspector {
    fn check_body(&self, name: &str) -> Result<(), InspectError> {
        let bodies = self.store.body_names().map_err(|error| InspectError::Internal(error.into()))?;
        if bodies.iter().any(|body| body == name) {
            return Ok(());
        }
        let expected = match bodies.join(", ") {
            none if none.is_empty() => "an imported body; this server has none (see `effigy body import`)".into(),
            names => format!("one of: {names}"),
        };
        let message = format!("there is no body {name:?} on this server");
        Err(InspectError::Bad { part: "options.body".into(), frame: None, message, expected })
    }
}
