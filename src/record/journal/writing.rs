//! Writes a journal.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Serialize;

use super::about::{About, FirstLine, VERSION, begins_like_one};
use super::line::Line;
use crate::capture::clock::ClockTime;
use crate::files::live_file::LiveFile;
use crate::files::output::{Output, Stream};
use crate::files::whole_file::WholeFile;
use crate::monitor::judge::Verdict;

/// A journal that cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("journal {}: {error}", path.display())]
pub struct JournalError {
    pub(super) path: PathBuf,
    pub(super) error: io::Error,
}

/// Writes a journal.
pub struct Journal {
    path: PathBuf,
    lines: Box<dyn Output>,
    taps: Vec<String>,
    /// When the verdict of the last line was reported.
    told_at: Duration,
}

impl Journal {
    /// Begins a journal of a model with these taps. Its file appears whole when it is finished.
    ///
    /// # Errors
    /// When nothing can be written there.
    pub fn create(
        path: &Path,
        taps: &[String],
        began: &ClockTime,
        about: &About,
    ) -> Result<Self, JournalError> {
        let lines = WholeFile::create(path).map_err(|error| failed(path, error))?;
        Self::begin(path, Box::new(lines), taps, began, about)
    }

    /// Like [`create`](Self::create), in a file whose lines are present as soon as they are written.
    ///
    /// # Errors
    /// When nothing can be written there.
    pub fn live(
        path: &Path,
        taps: &[String],
        began: &ClockTime,
        about: &About,
    ) -> Result<Self, JournalError> {
        let lines = LiveFile::create(path, begins_like_one).map_err(|error| failed(path, error))?;
        Self::begin(path, Box::new(lines), taps, began, about)
    }

    /// Like [`create`](Self::create), into a stream; `path` names it in errors.
    ///
    /// # Errors
    /// When the stream cannot be written to.
    pub fn stream(
        path: &Path,
        out: impl io::Write + Send + 'static,
        taps: &[String],
        began: &ClockTime,
        about: &About,
    ) -> Result<Self, JournalError> {
        Self::begin(path, Box::new(Stream(out)), taps, began, about)
    }

    fn begin(
        path: &Path,
        lines: Box<dyn Output>,
        taps: &[String],
        began: &ClockTime,
        about: &About,
    ) -> Result<Self, JournalError> {
        let mut journal = Self {
            path: path.to_owned(),
            lines,
            taps: taps.to_vec(),
            told_at: Duration::ZERO,
        };
        let first = FirstLine {
            gapwatch_journal: VERSION,
            began,
            about,
        };
        write_line(&mut journal.lines, &first).map_err(|error| failed(path, error))?;
        Ok(journal)
    }

    /// Adds a verdict that is reported at `now`, `latency` after its frame was taken. A time before that of the last
    /// line is replaced by that of the last line.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn add(
        &mut self,
        now: Duration,
        verdict: &Verdict,
        latency: Duration,
    ) -> Result<(), JournalError> {
        self.told_at = self.told_at.max(now);
        let line = Line::new(&self.taps, self.told_at, verdict, latency);
        write_line(&mut self.lines, &line).map_err(|error| failed(&self.path, error))
    }

    /// Ends the journal: its file is in place, and on the disk.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(self) -> Result<(), JournalError> {
        let finished = self.lines.finish();
        finished.map_err(|error| failed(&self.path, error))
    }
}

/// Writes the line with one call, as an [`Output`] requires.
fn write_line(out: &mut Box<dyn Output>, line: &impl Serialize) -> io::Result<()> {
    let mut bytes = serde_json::to_vec(line)?;
    bytes.push(b'\n');
    out.write_all(&bytes)
}

fn failed(path: &Path, error: io::Error) -> JournalError {
    JournalError {
        path: path.to_owned(),
        error,
    }
}
