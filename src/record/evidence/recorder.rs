//! Frames and verdicts on their way to the folder: a bounded queue, a writer beside the frame loop.

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use thread_priority::{ThreadPriority, ThreadPriorityValue};

use crate::capture::pixels::Pixels;
use crate::capture::{Frame, jpeg};
use crate::features::heat;
use crate::monitor::alarm::AlarmState;
use crate::monitor::judge::Verdict;
use crate::monitor::pipeline::Look;

use super::event::{Event, Moment};
use super::folder::EventFolder;
use super::quota::Quota;

/// Least time between two frames that are kept.
const STEP: Duration = Duration::from_millis(200);
/// How long before and after the beginning frames are kept.
const AROUND: Duration = Duration::from_secs(2);
/// An event ends after this long, also when alarms begin again and again: it lies in memory until then.
const LONGEST: Duration = Duration::from_secs(10);
/// An event ends when no frame has come for this long.
const NO_MORE: Duration = Duration::from_secs(10);
/// Frames in memory before an alarm: those of [`AROUND`].
const RING_MAX: usize = 10;
/// How often it is looked whether an event has been kept long enough.
const EXPIRE_EVERY: Duration = Duration::from_secs(600);
/// Messages on their way to the writer.
const QUEUE_MAX: usize = 16;
/// Priority of the writer from 0 to 99; on Linux this is niceness 10, a tenth of a verdict's share of a busy processor.
const WRITER_PRIORITY: u8 = 22;

/// What became of the evidence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Kept {
    /// Events written.
    pub events: u64,
    /// Older events removed, for them or because they were kept long enough.
    pub removed: u64,
    /// Events that could not be written.
    pub failed: u64,
    /// Frames that the writer had no time for.
    pub dropped_frames: u64,
}

/// A frame on its way to the writer.
pub(crate) struct Message {
    pub(crate) moment: Moment,
    at: Duration,
    pub(crate) edge: bool,
    pixels: Pixels,
    look: Option<Look>,
}

/// Hands frames over to the writer.
pub struct Recorder {
    sender: SyncSender<Message>,
    /// Whether frames wait for the writer.
    patient: bool,
    writer: JoinHandle<Kept>,
    state: AlarmState,
    handed_at: Option<Duration>,
    dropped_frames: u64,
}

/// Pictures may be late, verdicts may not.
fn yield_to_verdicts() {
    let priority = ThreadPriorityValue::try_from(WRITER_PRIORITY);
    let lowered = priority.map(|value| ThreadPriority::Crossplatform(value).set_for_current());
    if !matches!(lowered, Ok(Ok(()))) {
        log::debug!("the evidence writer keeps its priority: {lowered:?}");
    }
}

impl Recorder {
    /// Begins to record into `folder`, which is made if it is missing; events that are there stay, within the quota. What is no
    /// event, which is a folder named by a number with an `event.json` in it, is left alone and does not count.
    ///
    /// # Errors
    /// When nothing can be written there.
    pub fn start(folder: &Path, quota: Quota, taps: &[String]) -> std::io::Result<Self> {
        let folder = EventFolder::open(folder, quota)?;
        let taps = taps.to_vec();
        let (sender, receiver) = sync_channel(QUEUE_MAX);
        let writer = std::thread::Builder::new()
            .name("evidence".to_owned())
            .spawn(move || {
                yield_to_verdicts();
                Writer::new(folder, taps).run(&receiver)
            })?;
        Ok(Self {
            sender,
            patient: false,
            writer,
            state: AlarmState::Init,
            handed_at: None,
            dropped_frames: 0,
        })
    }

    /// Hands over to a queue of so many messages that nobody writes.
    #[cfg(test)]
    pub(crate) fn in_memory(messages: usize) -> (Self, Receiver<Message>) {
        let (sender, receiver) = sync_channel(messages);
        let recorder = Self {
            sender,
            patient: false,
            writer: std::thread::spawn(Kept::default),
            state: AlarmState::Init,
            handed_at: None,
            dropped_frames: 0,
        };
        (recorder, receiver)
    }

    /// Frames that the queue had no room for.
    #[cfg(test)]
    pub(crate) fn dropped_frames(&self) -> u64 {
        self.dropped_frames
    }

    /// For a recorded drive, which has time: a frame waits for the writer, and none is left out.
    pub fn patient(self) -> Self {
        Self {
            patient: true,
            ..self
        }
    }

    /// Offers a frame with its verdict; never waits unless [patient](Self::patient), and copies no picture. `look` is asked for
    /// at the beginning of an alarm only.
    pub fn offer(&mut self, frame: Frame, verdict: &Verdict, look: impl FnOnce() -> Look) {
        let before = std::mem::replace(&mut self.state, verdict.state);
        let alarming = |state| matches!(state, AlarmState::Suspect | AlarmState::Gap);
        let edge = before != verdict.state
            && (verdict.state == AlarmState::Gap
                || (verdict.state == AlarmState::Suspect && !alarming(before)));
        let due = self
            .handed_at
            .is_none_or(|at| frame.captured_at.saturating_sub(at) >= STEP);
        let (true, Ok(pixels)) = (edge || due, frame.picture) else {
            return;
        };
        self.handed_at = Some(frame.captured_at);
        let message = Message {
            moment: Moment {
                t_s: frame.captured_at.as_secs_f64(),
                seq: frame.sequence,
                state: verdict.state.name().to_owned(),
                reason: verdict.reason.name().to_owned(),
                score: verdict.score,
                frame: format!("frame-{:06}.jpg", frame.sequence),
                heat: BTreeMap::new(),
                profiles: Vec::new(),
            },
            at: frame.captured_at,
            edge,
            pixels,
            look: (edge && verdict.score.is_some()).then(look),
        };
        let taken = if self.patient {
            self.sender.send(message).is_ok()
        } else {
            self.sender.try_send(message).is_ok()
        };
        if !taken {
            self.dropped_frames += 1;
            if edge {
                // The next frame begins the event instead.
                self.state = before;
                self.handed_at = None;
            }
        }
    }

    /// Waits until everything is written.
    pub fn finish(self) -> Kept {
        drop(self.sender);
        let kept = self.writer.join().unwrap_or_else(|_| {
            log::warn!("evidence: the writer broke off");
            Kept::default()
        });
        Kept {
            dropped_frames: self.dropped_frames,
            ..kept
        }
    }
}

/// A moment with its files.
struct Held {
    moment: Moment,
    files: Vec<(String, Vec<u8>)>,
}

/// An event that is being gathered.
struct Open {
    moments: Vec<Held>,
    /// Which moment is the beginning of the alarm, and when that was.
    edge: usize,
    began: Duration,
    until: Duration,
}

/// The other side of the queue.
struct Writer {
    folder: EventFolder,
    taps: Vec<String>,
    /// The last moments, as their source gave them: nothing is compressed while nothing happens.
    ring: VecDeque<Message>,
    /// The event that is being gathered.
    open: Option<Open>,
    kept: Kept,
}

impl Writer {
    fn new(folder: EventFolder, taps: Vec<String>) -> Self {
        Self {
            folder,
            taps,
            ring: VecDeque::with_capacity(RING_MAX),
            open: None,
            kept: Kept::default(),
        }
    }

    fn run(mut self, messages: &Receiver<Message>) -> Kept {
        let mut expired = None;
        loop {
            let message = messages.recv_timeout(NO_MORE);
            // Also while no frame comes: a parked car stands for weeks.
            if expired.is_none_or(|at: Instant| at.elapsed() >= EXPIRE_EVERY) {
                expired = Some(Instant::now());
                self.expire();
            }
            match message {
                Ok(message) => self.take(message),
                Err(RecvTimeoutError::Timeout) => self.close(),
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        self.close();
        Kept {
            removed: self.folder.removed(),
            ..self.kept
        }
    }

    fn expire(&mut self) {
        if let Err(error) = self.folder.expire(SystemTime::now()) {
            let path = self.folder.path().display();
            log::warn!("evidence {path}: kept for longer than it may be: {error}");
        }
    }

    fn take(&mut self, message: Message) {
        let (edge, at) = (message.edge, message.at);
        let within = |open: &Open| (open.began..=open.until).contains(&at);
        if self.open.as_ref().is_some_and(|open| !within(open)) {
            self.close();
        }
        match (&mut self.open, edge) {
            // From suspicion to gap: the same event, for longer.
            (Some(open), true) => {
                open.moments.extend(held(message, &self.taps));
                open.until = (at + AROUND).min(open.began + LONGEST);
            }
            (Some(open), false) => open.moments.extend(held(message, &self.taps)),
            (None, true) => {
                let before = self.ring.drain(..);
                // After a pause the ring still holds what was long before it.
                let just_before =
                    |held: &Message| at.checked_sub(held.at).is_some_and(|ago| ago <= AROUND);
                let mut moments: Vec<Held> = before
                    .filter(just_before)
                    .filter_map(|before| held(before, &self.taps))
                    .collect();
                let edge = moments.len();
                moments.extend(held(message, &self.taps));
                if edge < moments.len() {
                    self.open = Some(Open {
                        moments,
                        edge,
                        began: at,
                        until: at + AROUND,
                    });
                }
            }
            (None, false) => {
                if self.ring.len() == RING_MAX {
                    self.ring.pop_front();
                }
                self.ring.push_back(message);
            }
        }
    }

    fn close(&mut self) {
        let Some(Open { moments, edge, .. }) = self.open.take() else {
            return;
        };
        let event = Event {
            edge,
            moments: moments.iter().map(|held| held.moment.clone()).collect(),
        };
        let files: Vec<_> = moments.into_iter().flat_map(|held| held.files).collect();
        match self.folder.add(&event, &files) {
            Ok(()) => self.kept.events += 1,
            Err(error) => {
                self.kept.failed += 1;
                log::warn!("evidence {}: {error}", self.folder.path().display());
            }
        }
    }
}

/// A moment as it is written; `None` of a picture that cannot be.
fn held(message: Message, taps: &[String]) -> Option<Held> {
    compressed(message, taps)
        .inspect_err(|error| log::warn!("evidence: {error}"))
        .ok()
}

fn compressed(message: Message, taps: &[String]) -> image::ImageResult<Held> {
    let mut moment = message.moment;
    let mut files = vec![(moment.frame.clone(), jpeg(&message.pixels.picture())?)];
    if let Some(look) = message.look {
        moment.profiles = look.profiles;
        for ((tap, energies), number) in taps.iter().zip(&look.energies).zip(1..) {
            // Numbered, for names of taps may hold anything.
            let name = format!("heat-{:06}-{}.jpg", moment.seq, number);
            files.push((
                name.clone(),
                jpeg(&heat::with_energy(&look.seen, energies))?,
            ));
            moment.heat.insert(tap.clone(), name);
        }
    }
    Ok(Held { moment, files })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::reading::read;
    use super::*;
    use crate::capture::Picture;
    use crate::features::attention::EnergyMap;
    use crate::monitor::alarm::Reason;
    use crate::monitor::profile::ProfileKind;
    use crate::monitor::profile::TapProfile;
    use std::fs;

    fn picture() -> Picture {
        Picture {
            width: 32,
            height: 16,
            rgb: [40, 90, 200].repeat(32 * 16),
        }
    }

    fn offer(recorder: &mut Recorder, tenth: u64, state: AlarmState) {
        let at = Duration::from_millis(100 * tenth);
        let frame = Frame {
            sequence: tenth,
            captured_at: at,
            picture: Ok(picture().into()),
        };
        let verdict = Verdict {
            at,
            sequence: Some(tenth),
            state,
            reason: Reason::None,
            undefined: None,
            score: Some(1.5),
            quality: None,
            window_frames: None,
            nominal_domain: None,
            drift: None,
            blocks: heapless::Vec::new(),
            window_fill: Some(1.0),
            fault_detection_counter: 0,
            gap_stored: false,
        };
        recorder.offer(frame, &verdict, || Look {
            seen: picture(),
            energies: vec![EnergyMap {
                width: 2,
                height: 1,
                energy: vec![1.0, 2.0],
            }],
            profiles: vec![TapProfile {
                tap: "../e2".to_owned(),
                kind: ProfileKind::Histogram,
                live: vec![0.25, 0.75],
                nominal: vec![0.5, 0.5],
                spread: vec![],
            }],
        });
    }

    /// `count` alarms, one every 10 s, each with a second of suspicion before the gap.
    fn record(folder: &Path, quota: Quota, count: u64) -> Kept {
        let recorder = Recorder::start(folder, quota, &["../e2".to_owned()]).unwrap();
        let mut recorder = recorder.patient();
        for tenth in 0..100 * count {
            let state = match tenth % 100 {
                50..60 => AlarmState::Suspect,
                60..70 => AlarmState::Gap,
                _ => AlarmState::Ok,
            };
            offer(&mut recorder, tenth, state);
            if tenth % 100 == 99 {
                // A slow disk has the time between two alarms to write the first.
                std::thread::sleep(Duration::from_millis(500));
            }
        }
        recorder.finish()
    }

    #[test]
    fn an_event_holds_the_frames_around_its_beginning_and_where_the_encoder_looked() {
        let folder = tempfile::tempdir().unwrap();
        let kept = record(folder.path(), Quota::default(), 1);
        assert_eq!((kept.events, kept.failed), (1, 0));
        let events = read(folder.path()).unwrap();
        let (_, event) = &events[0];
        let moment = &event.moments[event.edge];
        assert_eq!((moment.t_s, moment.state.as_str()), (5.0, "Suspect"));
        assert_eq!((moment.heat.len(), moment.profiles.len()), (1, 1));
        assert_eq!(moment.profiles[0].live, [0.25, 0.75]);
        let (first, last) = (&event.moments[0], event.moments.last().unwrap());
        // Two seconds before the suspicion, two after the gap began.
        assert!((2.8..=3.2).contains(&first.t_s), "{}", first.t_s);
        assert!((7.8..=8.0).contains(&last.t_s), "{}", last.t_s);
        assert!(
            event
                .moments
                .windows(2)
                .all(|pair| pair[0].t_s < pair[1].t_s)
        );
        assert_eq!(
            event.moments.iter().filter(|m| !m.heat.is_empty()).count(),
            2
        );
    }

    #[test]
    fn what_was_long_before_an_alarm_is_not_of_its_event() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::start(folder.path(), Quota::default(), &[])
            .unwrap()
            .patient();
        // One frame, ten minutes of nothing, and an alarm with the first frame, as of a camera that was unplugged; then a frame
        // every second, as of a parked car, and another alarm; then one that begins before the last frame.
        let (ok, gap) = (AlarmState::Ok, AlarmState::Gap);
        for (tenth, state) in [
            (0, ok),
            (6_000, gap),
            (7_000, ok),
            (7_010, ok),
            (7_020, ok),
            (7_030, ok),
            (7_040, gap),
            (7_500, ok),
            (7_510, ok),
            (100, gap),
        ] {
            offer(&mut recorder, tenth, state);
        }
        assert_eq!(recorder.finish().events, 3);
        let events = read(folder.path()).unwrap();
        let times = |event: &Event| event.moments.iter().map(|m| m.seq).collect::<Vec<_>>();
        let times: Vec<Vec<u64>> = events.iter().map(|(_, event)| times(event)).collect();
        assert_eq!(times, [vec![6_000], vec![7_020, 7_030, 7_040], vec![100]]);
    }

    #[test]
    fn the_last_moments_are_written_when_the_program_ends() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::start(folder.path(), Quota::default(), &[]).unwrap();
        // Fewer than wait for the writer, and the alarm with the last.
        for tenth in [0, 2, 4, 6] {
            offer(&mut recorder, tenth, AlarmState::Ok);
        }
        offer(&mut recorder, 7, AlarmState::Gap);
        let kept = recorder.finish();
        assert_eq!((kept.events, kept.dropped_frames), (1, 0));
        let events = read(folder.path()).unwrap();
        assert_eq!((events[0].1.edge, events[0].1.moments.len()), (4, 5));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_writer_comes_after_the_verdicts() {
        let folder = tempfile::tempdir().unwrap();
        let recorder = Recorder::start(folder.path(), Quota::default(), &[]).unwrap();
        let niceness = || {
            let threads = std::fs::read_dir("/proc/self/task").unwrap();
            let stats = threads.filter_map(|entry| {
                std::fs::read_to_string(entry.unwrap().path().join("stat")).ok()
            });
            let of_writers = stats.filter_map(|stat| {
                let (_, rest) = stat.split_once("(evidence) ")?;
                rest.split(' ').nth(16)?.parse::<i32>().ok()
            });
            of_writers.max()
        };
        let until = Instant::now() + Duration::from_secs(10);
        while niceness() != Some(10) && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(5));
        }
        assert_eq!(niceness(), Some(10));
        recorder.finish();
    }

    #[test]
    fn the_quota_is_kept_and_the_oldest_go_first() {
        let folder = tempfile::tempdir().unwrap();
        let quota = Quota {
            bytes: u64::MAX,
            events: 3,
            keep: None,
        };
        let kept = record(folder.path(), quota, 5);
        assert_eq!((kept.events, kept.removed), (5, 2));
        let begun = |events: &[(std::path::PathBuf, Event)]| -> Vec<f64> {
            events.iter().map(|(_, e)| e.moments[e.edge].t_s).collect()
        };
        assert_eq!(begun(&read(folder.path()).unwrap()), [25.0, 35.0, 45.0]);
        // A later run goes on in the same folder, now with room for the bytes of one event and a half.
        let size: u64 = fs::read_dir(folder.path().join("000005"))
            .unwrap()
            .map(|file| file.unwrap().metadata().unwrap().len())
            .sum();
        let quota = Quota {
            bytes: size + size / 2,
            events: 100,
            keep: None,
        };
        let kept = record(folder.path(), quota, 1);
        assert_eq!((kept.events, kept.removed), (1, 3));
        assert_eq!(begun(&read(folder.path()).unwrap()), [5.0]);
        // What is larger than the whole quota is not written, and nothing goes for it.
        let quota = Quota {
            bytes: size / 2,
            events: 100,
            keep: None,
        };
        let kept = record(folder.path(), quota, 1);
        assert_eq!((kept.events, kept.failed), (0, 1));
    }

    #[test]
    fn what_was_kept_long_enough_goes_without_a_new_event() {
        let folder = tempfile::tempdir().unwrap();
        record(folder.path(), Quota::default(), 2);
        let day = Duration::from_secs(86_400);
        let old = fs::File::open(folder.path().join("000001")).unwrap();
        old.set_modified(SystemTime::now() - 3 * day).unwrap();
        let quota = Quota {
            keep: Some(2 * day),
            ..Quota::default()
        };
        let mut recorder = Recorder::start(folder.path(), quota, &[])
            .unwrap()
            .patient();
        offer(&mut recorder, 0, AlarmState::Ok);
        assert_eq!(
            (
                recorder.finish().removed,
                read(folder.path()).unwrap().len()
            ),
            (1, 1)
        );
    }

    #[test]
    fn a_folder_that_takes_nothing_is_counted_and_not_fatal() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("evidence");
        let mut recorder = Recorder::start(&folder, Quota::default(), &[])
            .unwrap()
            .patient();
        fs::remove_dir_all(&folder).unwrap();
        fs::write(&folder, "a file").unwrap();
        for tenth in 0..30 {
            let state = if tenth < 10 {
                AlarmState::Ok
            } else {
                AlarmState::Gap
            };
            offer(&mut recorder, tenth, state);
        }
        let kept = recorder.finish();
        assert_eq!((kept.events, kept.failed), (0, 1));
        assert!(Recorder::start(&folder, Quota::default(), &[]).is_err());
    }
}
