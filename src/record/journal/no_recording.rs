//! Replaces recordings in a build that cannot write them.

use std::io;
use std::path::Path;
use std::time::Duration;

use super::about::About;
use super::writing::JournalError;
use crate::capture::Frame;
use crate::monitor::judge::Verdict;

/// A recording, which this build cannot make.
pub enum RecordingJournal {}

impl RecordingJournal {
    /// Always fails.
    ///
    /// # Errors
    /// Always.
    pub fn create(path: &Path, _taps: &[String], _about: &About) -> Result<Self, JournalError> {
        Err(JournalError {
            path: path.to_owned(),
            error: io::Error::other(
                "this build writes no MCAP recordings (build with --features lab)",
            ),
        })
    }

    /// Never called.
    pub fn begin_at(&mut self, _began_at: Duration) {
        match *self {}
    }

    /// Never called.
    ///
    /// # Errors
    /// Never.
    pub fn add_image(&mut self, _frame: &Frame) -> Result<(), JournalError> {
        match *self {}
    }

    /// Never called.
    ///
    /// # Errors
    /// Never.
    pub fn add(&mut self, _verdict: &Verdict, _latency: Duration) -> Result<(), JournalError> {
        match *self {}
    }

    /// Never called.
    ///
    /// # Errors
    /// Never.
    pub fn finish(self) -> Result<(), JournalError> {
        match self {}
    }
}
