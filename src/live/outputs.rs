//! Everybody who hears of a verdict. The trouble of one is no other's.

use std::time::Duration;

use super::bus::Bus;
use crate::can::SinkError;
use crate::monitor::judge::Verdict;
use crate::record::journal::{Journal, JournalError, RecordingJournal};

/// The bus, and what is written.
pub struct Outputs {
    /// The bus.
    pub bus: Bus,
    /// The journal, if one is asked for.
    pub journal: Option<Journal>,
    /// The recording, if one is asked for.
    pub recording: Option<RecordingJournal>,
}

/// One of them that does not take something.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The bus, or the log in its place.
    #[error(transparent)]
    Bus(#[from] SinkError),
    /// The journal or the recording.
    #[error(transparent)]
    Journal(#[from] JournalError),
}

impl Outputs {
    /// Tells all of a verdict at `now`, when its frame is `latency` old; gives what did not take it.
    pub fn tell(
        &mut self,
        now: Duration,
        verdict: &Verdict,
        latency: Duration,
    ) -> Vec<OutputError> {
        let bus = self.bus.tell(now, verdict, latency);
        let journal = (self.journal.as_mut()).map_or(Ok(()), |j| j.add(now, verdict, latency));
        let recording = self.recording.as_mut();
        let recording = recording.map_or(Ok(()), |recording| recording.add(verdict, latency));
        troubles(bus, [journal, recording])
    }

    /// Ends all; gives what could not be ended.
    pub fn finish(self) -> Vec<OutputError> {
        let bus = self.bus.finish();
        let journal = self.journal.map_or(Ok(()), Journal::finish);
        let recording = self.recording.map_or(Ok(()), RecordingJournal::finish);
        troubles(bus, [journal, recording])
    }
}

fn troubles(
    bus: Result<(), SinkError>,
    journals: [Result<(), JournalError>; 2],
) -> Vec<OutputError> {
    let bus = bus.err().map(OutputError::from);
    let journals = journals.into_iter().filter_map(Result::err);
    bus.into_iter()
        .chain(journals.map(OutputError::from))
        .collect()
}
