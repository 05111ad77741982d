//! All receivers of verdicts. An error of one receiver does not affect the others.

use std::time::Duration;

use super::bus::Bus;
use crate::can::SinkError;
use crate::monitor::judge::Verdict;
use crate::record::journal::{Journal, JournalError, RecordingJournal};

/// The bus, and the files that are written.
pub struct Outputs {
    /// The bus.
    pub bus: Bus,
    /// The journal, if one is asked for.
    pub journal: Option<Journal>,
    /// The recording, if one is asked for.
    pub recording: Option<RecordingJournal>,
}

/// An error of one of the outputs.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The bus, or the log that replaces it.
    #[error(transparent)]
    Bus(#[from] SinkError),
    /// The journal or the recording.
    #[error(transparent)]
    Journal(#[from] JournalError),
}

impl Outputs {
    /// Reports a verdict to all outputs at `now`, when its frame is `latency` old; returns their errors.
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

    /// Ends all outputs; returns their errors.
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::io::{self, Write};
    use std::path::Path;
    use std::sync::{Arc, Mutex};

    use super::super::bus::tests::{SharedWire, bus, full, ms};
    use super::*;
    use crate::capture::clock::ClockTime;
    use crate::record::journal::About;

    /// Holds lines while there is room.
    #[derive(Clone, Default)]
    struct Paper(Arc<Mutex<(Vec<u8>, bool)>>);

    impl Paper {
        fn set_full(&self, full: bool) {
            self.0.lock().unwrap().1 = full;
        }

        fn lines(&self) -> usize {
            let paper = self.0.lock().unwrap();
            paper.0.iter().filter(|&&byte| byte == b'\n').count()
        }

        fn answer(&self) -> io::Result<()> {
            let is_full = self.0.lock().unwrap().1;
            if is_full {
                return Err(io::ErrorKind::StorageFull.into());
            }
            Ok(())
        }
    }

    impl Write for Paper {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.answer()?;
            self.0.lock().unwrap().0.extend(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            self.answer()
        }
    }

    /// All outputs, with a recording in `folder`.
    fn outputs(folder: &Path) -> (Outputs, SharedWire, Paper) {
        let ((bus, wire), paper) = (bus(), Paper::default());
        let (began, about) = (ClockTime::default(), About::default());
        let journal = Journal::stream(Path::new("j"), paper.clone(), &[], &began, &about);
        let recording = RecordingJournal::create(&folder.join("r"), &[], &about);
        let outputs = Outputs {
            bus,
            journal: Some(journal.unwrap()),
            recording: Some(recording.unwrap()),
        };
        (outputs, wire, paper)
    }

    /// The output of each error.
    fn of(troubles: &[OutputError]) -> Vec<&'static str> {
        let of = |trouble: &OutputError| match trouble {
            OutputError::Bus(_) => "bus",
            OutputError::Journal(_) => "journal",
        };
        troubles.iter().map(of).collect()
    }

    #[test]
    fn the_trouble_of_one_keeps_no_other_from_hearing() {
        let folder = tempfile::tempdir().unwrap();
        let (mut outputs, wire, paper) = outputs(folder.path());
        let (mut frames, mut lines) = (0, paper.lines());
        for (second, (down, no_room, wanted)) in (0..).zip([
            (false, false, vec![]),
            (true, false, vec!["bus"]),
            (false, true, vec!["journal"]),
            (true, true, vec!["bus", "journal"]),
            (false, false, vec![]),
        ]) {
            wire.borrow_mut().trouble = down.then_some(full);
            paper.set_full(no_room);
            let troubles = outputs.tell(ms(1_000 * second), &Verdict::nothing_yet(), ms(0));
            assert_eq!(of(&troubles), wanted);
            lines += usize::from(!no_room);
            assert_eq!(paper.lines(), lines);
            let taken = wire.borrow().statuses().len();
            assert_eq!(taken > frames, !down);
            frames = taken;
        }
        assert!(outputs.finish().is_empty());
        assert!(folder.path().join("r").is_file());
    }

    #[test]
    fn what_could_not_be_ended_is_told_of_each() {
        let folder = tempfile::tempdir().unwrap();
        let (outputs, wire, paper) = outputs(folder.path());
        wire.borrow_mut().trouble = Some(full);
        paper.set_full(true);
        folder.close().unwrap();
        assert_eq!(of(&outputs.finish()), ["bus", "journal", "journal"]);
    }

    #[test]
    fn who_was_not_asked_for_has_no_trouble() {
        let (bus, wire) = bus();
        let mut outputs = Outputs {
            bus,
            journal: None,
            recording: None,
        };
        assert!(
            outputs
                .tell(ms(0), &Verdict::nothing_yet(), ms(0))
                .is_empty()
        );
        assert_eq!(wire.borrow().statuses().len(), 1);
        assert!(outputs.finish().is_empty());
    }
}
