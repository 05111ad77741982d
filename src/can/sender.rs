//! When each frame is sent.
//!
//! `GapStatus` is sent in a fixed cycle, and at once if the car must be informed of a change; `GapHealth` and
//! `GapVersion` are sent in their own cycles. The sender manages the schedules, what waits for the sink, and the E2E counters. Only the newest
//! state waits: a frame gets its content, its age, its counter and its CRC when the sink accepts it. It reads no clock:
//! time is an argument.
//!
//! In a replay, frames that became due between two calls are sent with their own due times and with what was valid
//! then, so that a drive gives the same frames whatever the steps of the replay are. On a live bus, no receiver must
//! get what was valid before: a call sends each message at most once, with what is valid now.

use std::time::Duration;

use super::e2e::E2eSender;
use super::message::{GapHealth, GapStatus, GapVersion};
use super::{CanFrame, CanSettings, CanSettingsError, SinkError, WarningSink};

/// Counts of frames since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SendCounts {
    /// Frames that the sink accepted.
    pub sent: u64,
    /// Writes that the sink refused; the message is offered again.
    pub failed_writes: u64,
    /// Frames that became due while a frame of the same message was still waiting, which then counted for both.
    pub dropped: u64,
}

/// Sends [`GapStatus`], [`GapHealth`] and [`GapVersion`] at their times.
///
/// For every frame of the drive, call [`update`](Self::update) and then [`poll`](Self::poll). On a live bus, also call
/// `poll` at least once in every minimum gap, whatever the encoder does.
pub struct StatusSender {
    settings: CanSettings,
    live: bool,
    status: Schedule<GapStatus>,
    health: Schedule<GapHealth>,
    version: Schedule<GapVersion>,
    status_e2e: E2eSender,
    health_e2e: E2eSender,
    version_e2e: E2eSender,
    last_poll: Option<Duration>,
    /// When the sink accepted the last frame.
    last_taken: Duration,
    counts: SendCounts,
}

/// What is due at the same time is sent in this order.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Message {
    Status,
    Health,
    Version,
}

impl StatusSender {
    /// A sender for a replay. It sends nothing before the first update.
    ///
    /// # Errors
    /// When the settings cannot be kept, see [`CanSettings::check`].
    pub fn new(settings: CanSettings) -> Result<Self, CanSettingsError> {
        settings.check()?;
        Ok(Self {
            live: false,
            status: Schedule::new(
                settings.status_period,
                settings.minimum_gap,
                |told, status| {
                    (told.state, told.reason, told.gap_stored)
                        != (status.state, status.reason, status.gap_stored)
                },
            ),
            health: Schedule::new(settings.health_period, Duration::ZERO, |_, _| false),
            version: Schedule::new(settings.version_period, Duration::ZERO, |_, _| false),
            status_e2e: E2eSender::new(settings.status.data_id),
            health_e2e: E2eSender::new(settings.health.data_id),
            version_e2e: E2eSender::new(settings.version.data_id),
            last_poll: None,
            last_taken: Duration::ZERO,
            counts: SendCounts::default(),
            settings,
        })
    }

    /// A sender for a live bus: no frame is sent with a time or a content from before the call that sends it.
    pub fn live(self) -> Self {
        Self { live: true, ..self }
    }

    /// Sets the status from `now` on; the next [`poll`](Self::poll) sends what follows from it. Of several updates
    /// before a poll, the last one counts.
    pub fn update(&mut self, now: Duration, status: &GapStatus) {
        self.status.update = Some((now, *status));
    }

    /// Sets the health from `now` on, like [`update`](Self::update).
    pub fn update_health(&mut self, now: Duration, health: &GapHealth) {
        self.health.update = Some((now, *health));
    }

    /// Sets the version from `now` on, like [`update`](Self::update).
    pub fn update_version(&mut self, now: Duration, version: &GapVersion) {
        self.version.update = Some((now, *version));
    }

    /// Sends all frames due up to and including `now`, in the order of their due times. What the sink refuses or is not
    /// ready for is offered again by the next call, with the time and the newest content of that call.
    ///
    /// # Errors
    /// The error of the sink, after which nothing more is offered in this call. What is due waits, and the caller can
    /// continue with the next call.
    pub fn poll(&mut self, now: Duration, sink: &mut dyn WarningSink) -> Result<(), SinkError> {
        let mut outcome = Ok(());
        while let Some(due) = self.fall_due(now) {
            outcome = outcome.and_then(|()| self.offer(due, sink));
        }
        outcome = outcome.and_then(|()| self.offer(now, sink));
        self.last_poll = Some(now);
        outcome
    }

    /// Whether something waits for the sink, or for the end of the minimum gap.
    pub fn is_waiting(&self) -> bool {
        self.status.is_waiting() || self.health.is_waiting() || self.version.is_waiting()
    }

    /// The counts of frames so far.
    pub fn counts(&self) -> SendCounts {
        self.counts
    }

    /// Makes the message that is due next, up to `until`, wait for the sink; returns the time from which it waits.
    fn fall_due(&mut self, until: Duration) -> Option<Duration> {
        let due = [
            (self.status.due(until), Message::Status),
            (self.health.due(until), Message::Health),
            (self.version.due(until), Message::Version),
        ];
        let due = due
            .into_iter()
            .filter_map(|(at, message)| Some((at?, message)));
        let (due, message) = due.min()?;
        let at = if self.live { until } else { due };
        let is_new = match message {
            Message::Status => self.status.fall_due(at),
            Message::Health => self.health.fall_due(at),
            Message::Version => self.version.fall_due(at),
        };
        self.counts.dropped += u64::from(!is_new);
        Some(at)
    }

    /// Which message the sink may accept next, and when, up to `until`.
    fn next(&self, until: Duration) -> Option<(Duration, Message)> {
        let at = |waiting: Option<Duration>, earliest: Duration| {
            // It is left over from the call before: it is late, and is sent with the present time.
            let late = |since: Duration| self.last_poll.is_some_and(|last| since <= last);
            let wanted = waiting.map(|since| if late(since) { until } else { since })?;
            Some(wanted.max(earliest).max(self.last_taken))
        };
        let told = self.status.told.as_ref();
        let gap_over = told.map_or(Duration::ZERO, |(at, _)| *at + self.settings.minimum_gap);
        let status = at(self.status.waiting, gap_over).map(|at| (at, Message::Status));
        let health = at(self.health.waiting, Duration::ZERO).map(|at| (at, Message::Health));
        let version = at(self.version.waiting, Duration::ZERO).map(|at| (at, Message::Version));
        let next = status.into_iter().chain(health).chain(version).min();
        next.filter(|&(at, _)| at <= until)
    }

    /// Offers what waits to the sink, up to the time `until` or the first refusal.
    fn offer(&mut self, until: Duration, sink: &mut dyn WarningSink) -> Result<(), SinkError> {
        while let Some((at, message)) = self.next(until) {
            if !sink.is_ready(at) {
                break;
            }
            let (id, data, e2e) = match message {
                Message::Status => {
                    let (since, mut status) = self.status.content(at);
                    status.frame_age = status.frame_age.map(|age| age + (at - since));
                    let id = self.settings.status.id;
                    (id, status.to_bytes(), &mut self.status_e2e)
                }
                Message::Health => {
                    let (_, health) = self.health.content(at);
                    let id = self.settings.health.id;
                    (id, health.to_bytes(), &mut self.health_e2e)
                }
                Message::Version => {
                    let (_, version) = self.version.content(at);
                    let id = self.settings.version.id;
                    (id, version.to_bytes(), &mut self.version_e2e)
                }
            };
            let taken = e2e.protect(data, |data| sink.send(at, &CanFrame { id, data }));
            if let Err(refusal) = taken {
                self.counts.failed_writes += 1;
                return Err(refusal);
            }
            self.counts.sent += 1;
            self.last_taken = at;
            match message {
                Message::Status => self.status.taken(at),
                Message::Health => self.health.taken(at),
                Message::Version => self.version.taken(at),
            }
        }
        Ok(())
    }
}

/// When the frames of one message are due, and what they contain.
struct Schedule<T> {
    period: Duration,
    minimum_gap: Duration,
    /// Whether the change from the content sent last to the valid content must be sent at once.
    urgent: fn(&T, &T) -> bool,
    /// The valid content, and since when it is valid.
    valid: Option<(Duration, T)>,
    /// The content that will be valid, and from when on.
    update: Option<(Duration, T)>,
    /// The content that was sent last, and when.
    told: Option<(Duration, T)>,
    /// Since when a frame waits for the sink.
    waiting: Option<Duration>,
    /// Next time of the cycle, which starts with the first frame.
    next_cyclic: Option<Duration>,
}

impl<T: Copy> Schedule<T> {
    fn new(period: Duration, minimum_gap: Duration, urgent: fn(&T, &T) -> bool) -> Self {
        Self {
            period,
            minimum_gap,
            urgent,
            valid: None,
            update: None,
            told: None,
            waiting: None,
            next_cyclic: None,
        }
    }

    /// When the next frame is due, unless that is after `until`. An update becomes valid as soon as no frame is due
    /// before it.
    fn due(&mut self, until: Duration) -> Option<Duration> {
        if let Some((from, _)) = self.update
            && self.planned().is_none_or(|at| from <= at)
        {
            self.valid = self.update.take();
        }
        self.planned().filter(|&at| at <= until)
    }

    /// When the next frame is due in the present state.
    fn planned(&self) -> Option<Duration> {
        let (since, valid) = self.valid.as_ref()?;
        let cyclic = self.next_cyclic.unwrap_or(*since);
        match &self.told {
            // The frame that waits will contain the change.
            Some((last, told)) if self.waiting.is_none() => {
                let wanted = if (self.urgent)(told, valid) {
                    *since
                } else {
                    cyclic
                };
                Some(wanted.max(*last + self.minimum_gap))
            }
            _ => Some(cyclic),
        }
    }

    /// Whether a frame waits, or a change that must be sent.
    fn is_waiting(&self) -> bool {
        let newest = self.update.as_ref().or(self.valid.as_ref());
        let told = self.told.as_ref().zip(newest);
        self.waiting.is_some() || told.is_some_and(|((_, told), (_, new))| (self.urgent)(told, new))
    }

    /// Makes a frame wait from `at` on. It counts for the cyclic frame too if that has become due. Returns `false` if a
    /// frame was already waiting.
    fn fall_due(&mut self, at: Duration) -> bool {
        let mut next = self.next_cyclic.unwrap_or(at);
        while next <= at {
            next += self.period;
        }
        self.next_cyclic = Some(next);
        let is_new = self.waiting.is_none();
        self.waiting.get_or_insert(at);
        is_new
    }

    /// The content of a frame sent at `at`, and since when it is valid.
    fn content(&mut self, at: Duration) -> (Duration, T) {
        if self.update.is_some_and(|(from, _)| from <= at) {
            self.valid = self.update.take();
        }
        self.valid
            .expect("a frame is due only when a content is valid")
    }

    /// Records that the sink accepted the waiting frame at `at`.
    fn taken(&mut self, at: Duration) {
        self.waiting = None;
        self.told = self.valid.map(|(_, valid)| (at, valid));
    }
}

#[cfg(test)]
mod tests;
