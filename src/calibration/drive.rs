//! A drive that can be looked at again and again, in memory or on disk.

use std::borrow::Cow;
use std::io;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::survey::Survey;
use crate::features::energies::BlockMeans;

/// Version of a survey file.
pub const VERSION: u32 = 1;

/// A survey that cannot be kept or read.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The file or folder cannot be read or written.
    #[error("{}: {error}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// The file is not a survey, or was changed after it was written.
    #[error("{}: {found}; wanted a survey of {source_name}, version {VERSION}", path.display())]
    Damaged {
        /// Which file.
        path: PathBuf,
        /// What was found.
        found: String,
        /// The drive to which it should belong.
        source_name: String,
    },
}

/// A drive that can be looked at as often as needed: in memory, or kept on disk.
pub trait SurveyedDrive: Sync {
    /// Its name, as typed.
    fn source(&self) -> &str;

    /// Number of frames of the whole drive.
    fn frames(&self) -> usize;

    /// What the encoder saw of it.
    ///
    /// # Errors
    /// When it can no longer be read.
    fn survey(&self) -> Result<Cow<'_, Survey>, StoreError>;
}

impl SurveyedDrive for Survey {
    fn source(&self) -> &str {
        &self.source
    }

    fn frames(&self) -> usize {
        self.frames.len()
    }

    fn survey(&self) -> Result<Cow<'_, Survey>, StoreError> {
        Ok(Cow::Borrowed(self))
    }
}

/// Frames with lane labels that can be looked at as often as needed: in memory, or kept on disk.
pub trait LabelledDrive: Sync {
    /// Number of frames.
    fn frames(&self) -> usize;

    /// The frames.
    ///
    /// # Errors
    /// When they can no longer be read.
    fn means(&self) -> Result<Cow<'_, [LabelledMeans]>, StoreError>;
}

impl LabelledDrive for LabelledMeans {
    fn frames(&self) -> usize {
        1
    }

    fn means(&self) -> Result<Cow<'_, [LabelledMeans]>, StoreError> {
        Ok(Cow::Borrowed(std::slice::from_ref(self)))
    }
}

/// A frame with lane labels: what the encoder saw, and what the lane model lost.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LabelledMeans {
    /// Means of each block.
    pub means: Vec<BlockMeans>,
    /// 1 - IoU / IoU of the same frame on a plain day, 0 to 1.
    pub loss: f64,
}
