//! The CAN side of a run: verdicts into the messages of the bus.

use std::time::Duration;

use crate::can::detail::{DetailSender, GapDetail};
use crate::can::message::{GapHealth, GapStatus};
use crate::can::receiver::{Heard, Receiver};
use crate::can::sender::StatusSender;
use crate::can::{CanSettings, CanSettingsError, SinkError, WarningSink};
use crate::monitor::detector::BlockScore;
use crate::monitor::health::Health;
use crate::monitor::judge::Verdict;
use crate::reference::Reference;

/// Shortest time between two lines of the program's log about the same trouble.
const COMPLAINT: Duration = Duration::from_secs(1);

/// A sink and what is said on it.
pub struct Bus {
    sender: StatusSender,
    receiver: Receiver,
    details: Option<DetailSender>,
    detail: GapDetail,
    sink: Box<dyn WarningSink>,
    health: Health,
    strict: bool,
    reference_id: u8,
    /// When the last judged frame was taken.
    judged_at: Option<Duration>,
    complained_at: Option<Duration>,
    window_fill: Option<f64>,
    /// Frames that came and were never judged.
    pub dropped_frames: u64,
}

impl Bus {
    /// For a replay.
    ///
    /// # Errors
    /// When the settings cannot be kept.
    pub fn new(
        sink: Box<dyn WarningSink>,
        settings: CanSettings,
        reference: &Reference,
    ) -> Result<Self, CanSettingsError> {
        Ok(Self {
            sink,
            details: DetailSender::new(&settings),
            detail: GapDetail::default(),
            receiver: Receiver::new(&settings),
            sender: StatusSender::new(settings)?,
            health: Health::default(),
            strict: reference.strict,
            reference_id: reference.id(),
            judged_at: None,
            complained_at: None,
            window_fill: None,
            dropped_frames: 0,
        })
    }

    /// For a live run: see [`StatusSender::live`].
    pub fn live(self) -> Self {
        Self {
            sender: self.sender.live(),
            ..self
        }
    }

    /// Sends what a verdict changes and what fell due up to `now`, when its frame is `latency` old. In a replay time stands
    /// still while a frame is judged.
    ///
    /// # Errors
    /// As [`poll`](Self::poll).
    pub fn tell(
        &mut self,
        now: Duration,
        verdict: &Verdict,
        latency: Duration,
    ) -> Result<(), SinkError> {
        if verdict.sequence.is_some() {
            self.health
                .note(verdict.at, latency, verdict.score.is_some());
        }
        if verdict.score.is_some() {
            self.judged_at = Some(verdict.at);
        }
        let mut block_scores = [None; 3];
        block_scores
            .iter_mut()
            .zip(&verdict.blocks)
            .for_each(|(score, block): (_, &BlockScore)| *score = Some(block.score));
        let age = |judged_at| verdict.at.saturating_sub(judged_at) + latency;
        let status = GapStatus {
            state: verdict.state,
            reason: verdict.reason,
            gap_stored: verdict.gap_stored,
            score: verdict.score,
            block_scores,
            fault_detection_counter: verdict.fault_detection_counter,
            frame_age: self.judged_at.map(age),
        };
        self.window_fill = verdict.window_fill;
        self.detail = GapDetail {
            window_frames: verdict.window_frames,
            nominal_domain: verdict.nominal_domain,
            drift: verdict.drift,
            quality: verdict.quality,
            similarities: std::array::from_fn(|tap| Some(verdict.blocks.get(tap)?.similarity)),
            scores: block_scores,
        };
        self.sender.update(now, &status);
        self.tell_health_of(now, verdict.at);
        self.poll(now)
    }

    /// Lets `GapHealth` know what time it is when there is nothing to tell.
    pub fn tell_health(&mut self, now: Duration) {
        self.tell_health_of(now, now);
    }

    fn tell_health_of(&mut self, now: Duration, at: Duration) {
        let health = GapHealth {
            strict: self.strict,
            bus_state: self.sink.bus_state(),
            frame_rate_hz: Some(self.health.judged_rate_hz(at)),
            dropped_frames: self.dropped_frames,
            latency_p50: self.health.latency(0.5),
            latency_p99: self.health.latency(0.99),
            window_fill: self.window_fill,
            reference_id: self.reference_id,
        };
        self.sender.update_health(now, &health);
    }

    /// Sends what fell due up to `now`. A bus that takes nothing is no end: the newest waits for it.
    ///
    /// # Errors
    /// When the log in the place of a bus does not take a frame.
    pub fn poll(&mut self, now: Duration) -> Result<(), SinkError> {
        let sink = self.sink.as_mut();
        let mut polled = self.sender.poll(now, sink);
        if let (Ok(()), Some(details)) = (&polled, &mut self.details) {
            polled = details.poll(now, &self.detail, sink);
        }
        match polled {
            Err(SinkError::Refused { sink, source }) => {
                if may_complain(&mut self.complained_at, now) {
                    log::warn!(
                        "the bus {sink} takes no frame: {source}; {:?}",
                        self.sender.counts()
                    );
                }
                Ok(())
            }
            other => other,
        }
    }

    /// Whether something waits for the bus.
    pub fn is_waiting(&self) -> bool {
        self.sender.is_waiting()
    }

    /// What was heard on the bus and concerns us.
    pub fn hear(&mut self) -> Option<Heard> {
        while let Some(frame) = self.sink.receive() {
            if let Some(heard) = self.receiver.hear(&frame) {
                return Some(heard);
            }
        }
        None
    }

    /// Completes a log.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn finish(self) -> Result<(), SinkError> {
        self.sink.finish()
    }
}

/// Whether the log may have a line now; at most one a second.
pub(super) fn may_complain(complained_at: &mut Option<Duration>, now: Duration) -> bool {
    let may = complained_at.is_none_or(|at| now >= at + COMPLAINT);
    if may {
        *complained_at = Some(now);
    }
    may
}
