//! Frames and verdicts on their way to the folder: a bounded queue, and a writer beside the frame loop.

use std::collections::{BTreeMap, VecDeque};
use std::io;
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

/// Shortest time between two frames that are kept.
const STEP: Duration = Duration::from_millis(200);
/// Time before and after the beginning of an alarm for which frames are kept.
const AROUND: Duration = Duration::from_secs(2);
/// An event ends after this time, also if alarms begin again and again, because it stays in memory until then.
const LONGEST: Duration = Duration::from_secs(10);
/// An event ends when no frame has come for this long.
const NO_MORE: Duration = Duration::from_secs(10);
/// Largest number of frames in memory before an alarm: those of [`AROUND`].
const RING_MAX: usize = 10;
/// Time between two checks whether events are too old.
const EXPIRE_EVERY: Duration = Duration::from_secs(600);
/// Largest number of messages on their way to the writer.
const QUEUE_MAX: usize = 16;
/// Priority of the writer from 0 to 99; on Linux this is niceness 10, a tenth of a verdict's share of a busy processor.
const WRITER_PRIORITY: u8 = 22;

/// Counts of the evidence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EventCounts {
    /// Events written.
    pub events: u64,
    /// Older events that were removed, to make room or because of their age.
    pub removed: u64,
    /// Events that could not be written.
    pub failed: u64,
    /// Frames for which the writer had no time.
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
pub struct EventRecorder {
    sender: SyncSender<Message>,
    /// Whether frames wait for the writer.
    patient: bool,
    writer: JoinHandle<EventCounts>,
    state: AlarmState,
    handed_at: Option<Duration>,
    dropped_frames: u64,
}

/// Lowers the priority of this thread, because pictures may be late, but verdicts may not.
fn yield_to_verdicts() {
    let priority = ThreadPriorityValue::try_from(WRITER_PRIORITY);
    let lowered = priority.map(|value| ThreadPriority::Crossplatform(value).set_for_current());
    if !matches!(lowered, Ok(Ok(()))) {
        log::debug!("the evidence writer keeps its priority: {lowered:?}");
    }
}

impl EventRecorder {
    /// Begins to record into `folder`, which is created if it is missing. Events that are already there stay, within
    /// the quota. An event is a folder that is named by a number and has an `event.json` in it; everything else is left
    /// alone and does not count.
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

    /// A recorder with a queue of `messages` messages and without a writer.
    #[cfg(test)]
    pub(crate) fn in_memory(messages: usize) -> (Self, Receiver<Message>) {
        let (sender, receiver) = sync_channel(messages);
        let recorder = Self {
            sender,
            patient: false,
            writer: std::thread::spawn(EventCounts::default),
            state: AlarmState::Init,
            handed_at: None,
            dropped_frames: 0,
        };
        (recorder, receiver)
    }

    /// Number of frames for which the queue had no room.
    #[cfg(test)]
    pub(crate) fn dropped_frames(&self) -> u64 {
        self.dropped_frames
    }

    /// For a recorded drive, in which there is time: each frame waits for the writer, and none is left out.
    pub fn patient(self) -> Self {
        Self {
            patient: true,
            ..self
        }
    }

    /// Offers a frame with its verdict; never waits unless [patient](Self::patient), and copies no picture. `look` is
    /// called only at the beginning of an alarm.
    pub fn offer(&mut self, frame: Frame, verdict: &Verdict, look: impl FnOnce() -> Look) {
        let before = std::mem::replace(&mut self.state, verdict.state);
        let alarming = |state| matches!(state, AlarmState::Suspect | AlarmState::Gap);
        let edge = before != verdict.state
            && (matches!(verdict.state, AlarmState::Gap | AlarmState::SensorFault)
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
                gap: verdict.gap,
                change: verdict.change,
                lanes: verdict.lanes,
                cause: verdict.cause.map(|likely| likely.cause),
                cause_probability: verdict.cause.map(|likely| likely.probability),
                frame: format!("frame-{:06}.jpg", frame.sequence),
                heat: BTreeMap::new(),
                profiles: Vec::new(),
            },
            at: frame.captured_at,
            edge,
            pixels,
            look: (edge && verdict.gap.is_some()).then(look),
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
    pub fn finish(self) -> EventCounts {
        drop(self.sender);
        let kept = self.writer.join().unwrap_or_else(|_| {
            log::warn!("evidence: the writer ended with an internal error");
            EventCounts::default()
        });
        EventCounts {
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
    /// Index of the moment at which the alarm began, and its time.
    edge: usize,
    began: Duration,
    until: Duration,
}

/// The thread that receives from the queue.
struct Writer {
    folder: EventFolder,
    taps: Vec<String>,
    /// The last moments, as their source gave them. Nothing is compressed as long as there is no alarm.
    ring: VecDeque<Message>,
    /// The event that is being gathered.
    open: Option<Open>,
    kept: EventCounts,
}

impl Writer {
    fn new(folder: EventFolder, taps: Vec<String>) -> Self {
        Self {
            folder,
            taps,
            ring: VecDeque::with_capacity(RING_MAX),
            open: None,
            kept: EventCounts::default(),
        }
    }

    fn run(mut self, messages: &Receiver<Message>) -> EventCounts {
        let mut expired = None;
        loop {
            let message = messages.recv_timeout(NO_MORE);
            // Done also while no frame comes, because a car may be parked for weeks.
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
        EventCounts {
            removed: self.folder.removed(),
            ..self.kept
        }
    }

    fn expire(&mut self) {
        if let Err(error) = self.folder.expire(SystemTime::now()) {
            let path = self.folder.path().display();
            log::warn!("evidence {path}: old events cannot be removed: {error}");
        }
    }

    fn take(&mut self, message: Message) {
        let (edge, at) = (message.edge, message.at);
        let within = |open: &Open| (open.began..=open.until).contains(&at);
        if self.open.as_ref().is_some_and(|open| !within(open)) {
            self.close();
        }
        match (&mut self.open, edge) {
            // From suspicion to gap: the same event continues.
            (Some(open), true) => {
                open.moments.extend(held(message, &self.taps));
                open.until = (at + AROUND).min(open.began + LONGEST);
            }
            (Some(open), false) => open.moments.extend(held(message, &self.taps)),
            (None, true) => {
                let before = self.ring.drain(..);
                // After a pause, the ring still holds moments from long before.
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

/// A moment as it is written; `None` if the picture cannot be compressed.
fn held(message: Message, taps: &[String]) -> Option<Held> {
    compressed(message, taps)
        .inspect_err(|error| log::warn!("evidence: {error}"))
        .ok()
}

fn compressed(message: Message, taps: &[String]) -> io::Result<Held> {
    let mut moment = message.moment;
    let mut files = vec![(moment.frame.clone(), jpeg(&message.pixels.picture())?)];
    if let Some(look) = message.look {
        moment.profiles = look.profiles;
        for ((tap, energies), number) in taps.iter().zip(&look.energies).zip(1..) {
            // Files are numbered, because names of taps may contain any character.
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
mod tests;
