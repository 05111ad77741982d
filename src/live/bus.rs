//! The CAN side of a run: verdicts become the messages of the bus.

use std::time::Duration;

use crate::can::detail::{DetailSender, GapDetail};
use crate::can::message::{GapHealth, GapStatus, GapVersion};
use crate::can::receiver::{Heard, Receiver};
use crate::can::sender::StatusSender;
use crate::can::{CanSettings, CanSettingsError, SinkError, WarningSink};
use crate::monitor::detector::BlockScore;
use crate::monitor::judge::Verdict;
use crate::monitor::timing::Timing;
use crate::reference::Reference;

/// Shortest time between two lines of the program's log about the same error.
const COMPLAINT: Duration = Duration::from_secs(1);

/// A sink and the messages that are sent to it.
pub struct Bus {
    sender: StatusSender,
    receiver: Receiver,
    details: Option<DetailSender>,
    detail: GapDetail,
    sink: Box<dyn WarningSink>,
    health: Timing,
    strict: bool,
    version: GapVersion,
    cause_probability: Option<f64>,
    /// When the last judged frame was taken.
    judged_at: Option<Duration>,
    complained_at: Option<Duration>,
    window_fill: Option<f64>,
    /// Number of frames that came and were never judged.
    pub dropped_frames: u64,
}

impl Bus {
    /// A bus for a replay.
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
            health: Timing::default(),
            strict: reference.strict,
            version: GapVersion::of_this_program(reference.id()),
            cause_probability: None,
            judged_at: None,
            complained_at: None,
            window_fill: None,
            dropped_frames: 0,
        })
    }

    /// A bus for a live run: see [`StatusSender::live`].
    pub fn live(self) -> Self {
        Self {
            sender: self.sender.live(),
            ..self
        }
    }

    /// Sends what a verdict changes, and what became due up to `now`, when its frame is `latency` old. In a replay,
    /// time does not pass while a frame is judged.
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
            self.health.note(verdict.at, latency, verdict.gap.is_some());
        }
        if verdict.gap.is_some() {
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
            cause: verdict.cause.map(|likely| likely.cause),
            gap: verdict.gap,
            change: verdict.change,
            lanes: verdict.lanes,
            fault_detection_counter: verdict.fault_detection_counter,
            frame_age: self.judged_at.map(age),
        };
        self.window_fill = verdict.window_fill;
        self.cause_probability = verdict.cause.map(|likely| likely.probability);
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

    /// Gives `GapHealth` and `GapVersion` the time when there is nothing to report.
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
            cause_probability: self.cause_probability,
        };
        self.sender.update_health(now, &health);
        self.sender.update_version(now, &self.version);
    }

    /// Sends what became due up to `now`. A bus that accepts nothing does not end the run: the newest message waits for
    /// it.
    ///
    /// # Errors
    /// When the log that replaces the bus cannot be written.
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
                        "the bus {sink} accepts no frame: {source}; {:?}",
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

    /// What was received from the bus and concerns the monitor.
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
    /// When it cannot be written.
    pub fn finish(self) -> Result<(), SinkError> {
        self.sink.finish()
    }
}

/// Whether a line may be logged now; at most one each second.
pub(super) fn may_complain(complained_at: &mut Option<Duration>, now: Duration) -> bool {
    let may = complained_at.is_none_or(|at| now >= at + COMPLAINT);
    if may {
        *complained_at = Some(now);
    }
    may
}

#[cfg(test)]
pub(super) mod tests {
    #![allow(clippy::unwrap_used)]
    use std::cell::RefCell;
    use std::collections::VecDeque;
    use std::io;
    use std::rc::Rc;

    use sha2::{Digest, Sha256};

    use super::*;
    use crate::can::speed::SpeedSignal;
    use crate::can::{BusState, CanFrame};
    use crate::monitor::alarm::{AlarmState, Reason};
    use crate::reference::cause::{Cause, LikelyCause};

    pub const SPEED_ID: u16 = 0x1A0;

    /// A bus in memory, as its other nodes see it.
    #[derive(Default)]
    pub struct Wire {
        /// Frames that were accepted, and when.
        taken: Vec<(Duration, CanFrame)>,
        /// When frames of CAN FD were accepted.
        taken_fd: Vec<Duration>,
        /// Error that is returned for every frame, and at the end.
        pub trouble: Option<fn() -> SinkError>,
        /// Frames that other nodes have sent.
        pub heard: VecDeque<CanFrame>,
    }

    pub type SharedWire = Rc<RefCell<Wire>>;

    impl Wire {
        /// Time in ms and content of each status frame.
        pub fn statuses(&self) -> Vec<(u128, GapStatus)> {
            self.of(0x5D0, |data| GapStatus::from_bytes(data).unwrap())
        }

        /// Time in ms and content of each version frame.
        fn versions(&self) -> Vec<(u128, GapVersion)> {
            self.of(0x5D3, |data| GapVersion::from_bytes(data).unwrap())
        }

        /// Time in ms and content of each health frame.
        pub fn healths(&self) -> Vec<(u128, GapHealth)> {
            self.of(0x5D1, |data| GapHealth::from_bytes(data).unwrap())
        }

        fn of<T>(&self, id: u16, read: fn(&[u8; 8]) -> T) -> Vec<(u128, T)> {
            let frames = self.taken.iter().filter(|(_, frame)| frame.id == id);
            frames
                .map(|(at, frame)| (at.as_millis(), read(&frame.data)))
                .collect()
        }

        /// Another node sends the speed of the car.
        pub fn say_kmh(&mut self, kmh: u8) {
            let data = [kmh, 0, 0, 0, 0, 0, 0, 0];
            self.heard.push_back(CanFrame { id: SPEED_ID, data });
        }

        fn answer(&self) -> Result<(), SinkError> {
            self.trouble.map_or(Ok(()), |trouble| Err(trouble()))
        }
    }

    struct Sink(SharedWire);

    impl WarningSink for Sink {
        fn send(&mut self, at: Duration, frame: &CanFrame) -> Result<(), SinkError> {
            let mut wire = self.0.borrow_mut();
            wire.answer()?;
            wire.taken.push((at, *frame));
            Ok(())
        }

        fn send_fd(&mut self, at: Duration, _: u16, _: &[u8]) -> Result<(), SinkError> {
            let mut wire = self.0.borrow_mut();
            wire.answer()?;
            wire.taken_fd.push(at);
            Ok(())
        }

        fn receive(&mut self) -> Option<CanFrame> {
            self.0.borrow_mut().heard.pop_front()
        }

        fn bus_state(&self) -> BusState {
            BusState::Passive
        }

        fn finish(self: Box<Self>) -> Result<(), SinkError> {
            self.0.borrow().answer()
        }
    }

    /// Error that says that the bus may accept a frame later.
    pub fn refused() -> SinkError {
        SinkError::Refused {
            sink: "can0".to_owned(),
            source: io::ErrorKind::NetworkDown.into(),
        }
    }

    /// Error that says that a log cannot be written.
    pub fn full() -> SinkError {
        SinkError::Write {
            sink: "log:x".to_owned(),
            source: io::ErrorKind::StorageFull.into(),
        }
    }

    pub fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    pub fn settings() -> CanSettings {
        CanSettings {
            fd: true,
            speed: Some(SpeedSignal {
                id: SPEED_ID,
                start_bit: 0,
                length: 8,
                big_endian: false,
                factor: 1.0,
                offset: 0.0,
                parked_below_kmh: 1.0,
                parked_after: ms(1_000),
            }),
            ..CanSettings::default()
        }
    }

    /// A bus that is not yet live, and its wire.
    pub fn bus() -> (Bus, SharedWire) {
        let wire = SharedWire::default();
        let sink = Box::new(Sink(Rc::clone(&wire)));
        let reference = Reference::read(None).unwrap();
        (Bus::new(sink, settings(), &reference).unwrap(), wire)
    }

    /// Verdict on a judged frame that was taken at a time in ms.
    fn judged(at: u64) -> Verdict {
        let block = |score| BlockScore {
            gap: 0.0,
            similarity: 0.5,
            score,
        };
        Verdict {
            at: ms(at),
            sequence: Some(at),
            state: AlarmState::Suspect,
            reason: Reason::Abrupt,
            gap: Some(1.5),
            change: Some(0.5),
            lanes: Some(0.25),
            cause: Some(LikelyCause {
                cause: Cause::Glare,
                probability: 0.75,
            }),
            blocks: [1.5, 0.5].map(block).into_iter().collect(),
            window_fill: Some(0.5),
            fault_detection_counter: 9,
            gap_stored: true,
            ..Verdict::nothing_yet()
        }
    }

    /// Verdict without a frame, at a time in ms.
    fn silence(at: u64) -> Verdict {
        Verdict {
            at: ms(at),
            state: AlarmState::Unavailable,
            reason: Reason::Stale,
            ..Verdict::nothing_yet()
        }
    }

    #[test]
    fn the_bus_hears_what_is_known_and_how_old_the_last_judged_frame_is() {
        let (mut bus, wire) = bus();
        bus.tell(ms(0), &silence(0), ms(0)).unwrap();
        bus.tell(ms(1_050), &judged(1_000), ms(50)).unwrap();
        bus.tell(ms(1_700), &silence(1_500), ms(200)).unwrap();
        let statuses = wire.borrow().statuses();
        let at = |at| statuses.iter().find(|(sent, _)| *sent == at).unwrap().1;
        assert_eq!(at(0).frame_age, None);
        let wanted = GapStatus {
            state: AlarmState::Suspect,
            reason: Reason::Abrupt,
            gap_stored: true,
            cause: Some(Cause::Glare),
            gap: Some(1.5),
            change: Some(0.5),
            lanes: Some(0.25),
            fault_detection_counter: 9,
            frame_age: Some(ms(100)),
        };
        assert_eq!(at(1_050), wanted);
        let wanted = GapStatus {
            state: AlarmState::Unavailable,
            reason: Reason::Stale,
            gap_stored: false,
            cause: None,
            gap: None,
            change: None,
            lanes: None,
            fault_detection_counter: 0,
            frame_age: Some(ms(700)),
        };
        assert_eq!(at(1_700), wanted);
    }

    #[test]
    fn the_health_is_of_judged_frames_and_of_now() {
        let (mut bus, wire) = bus();
        let reference = Reference::read(None).unwrap();
        bus.tell(ms(1_050), &judged(1_000), ms(50)).unwrap();
        let wanted = GapHealth {
            strict: reference.strict,
            bus_state: BusState::Passive,
            frame_rate_hz: Some(1.0),
            dropped_frames: 0,
            latency_p50: Some(ms(50)),
            latency_p99: Some(ms(50)),
            window_fill: Some(0.5),
            cause_probability: Some(0.75),
        };
        assert_eq!(wire.borrow().healths(), [(1_050, wanted)]);
        // Silence has no latency.
        bus.tell(ms(1_700), &silence(1_500), ms(200)).unwrap();
        bus.dropped_frames = 3;
        bus.tell_health(ms(2_050));
        bus.poll(ms(2_050)).unwrap();
        let wanted = GapHealth {
            frame_rate_hz: Some(0.0),
            dropped_frames: 3,
            window_fill: None,
            cause_probability: None,
            ..wanted
        };
        assert_eq!(wire.borrow().healths()[1..], [(2_050, wanted)]);
    }

    #[test]
    fn the_version_names_the_reference_at_once_and_every_second_also_when_nothing_is_judged() {
        for live in [false, true] {
            let (bus, wire) = bus();
            let mut bus = if live { bus.live() } else { bus };
            let file = Reference::read(None).unwrap().to_json();
            // What `sha256sum` prints for the file.
            let printed = Sha256::digest(file.as_bytes());
            bus.tell(ms(30), &silence(30), ms(0)).unwrap();
            for now in (50..=2_030).step_by(20) {
                bus.tell_health(ms(now));
                bus.poll(ms(now)).unwrap();
            }
            let versions = wire.borrow().versions();
            let times: Vec<u128> = versions.iter().map(|(at, _)| *at).collect();
            assert_eq!(times, [30, 1_030, 2_030]);
            for (_, version) in versions {
                assert_eq!(version.reference_id, printed[..4]);
            }
        }
    }

    #[test]
    fn a_bus_that_is_down_gets_the_newest_later_and_a_log_that_is_full_is_an_error() {
        let (bus, wire) = bus();
        let mut bus = bus.live();
        assert!(!bus.is_waiting());
        wire.borrow_mut().trouble = Some(refused);
        bus.tell(ms(0), &judged(0), ms(0)).unwrap();
        assert!(bus.is_waiting());
        bus.poll(ms(10)).unwrap();
        wire.borrow_mut().trouble = Some(full);
        assert!(matches!(bus.poll(ms(20)), Err(SinkError::Write { .. })));
        let told = bus.tell(ms(30), &silence(30), ms(0));
        assert!(matches!(told, Err(SinkError::Write { .. })));
        wire.borrow_mut().trouble = None;
        bus.poll(ms(40)).unwrap();
        assert!(!bus.is_waiting());
        let sent = wire.borrow().statuses();
        let sent: Vec<_> = sent.iter().map(|(at, it)| (*at, it.state)).collect();
        assert_eq!(sent, [(40, AlarmState::Unavailable)]);
        assert_eq!(wire.borrow().taken_fd, [ms(40)]);
        wire.borrow_mut().trouble = Some(full);
        assert!(bus.finish().is_err());
    }

    #[test]
    fn a_replay_sends_what_fell_due_and_a_live_bus_only_what_is_valid_now() {
        for (live, wanted) in [(false, vec![0, 100, 200, 300]), (true, vec![0, 350])] {
            let (bus, wire) = bus();
            let mut bus = if live { bus.live() } else { bus };
            bus.tell(ms(0), &judged(0), ms(0)).unwrap();
            bus.poll(ms(350)).unwrap();
            let sent = wire.borrow().statuses();
            let sent: Vec<u128> = sent.iter().map(|(at, _)| *at).collect();
            assert_eq!(sent, wanted, "live: {live}");
            bus.finish().unwrap();
        }
    }

    #[test]
    fn what_concerns_nobody_here_is_not_heard() {
        let (mut bus, wire) = bus();
        for id in [0x123, 0x5D1, 0x124, 0x5D3] {
            let data = [0; 8];
            wire.borrow_mut().heard.push_back(CanFrame { id, data });
        }
        assert_eq!(bus.hear(), Some(Heard::Foreign(0x5D1)));
        assert_eq!(bus.hear(), Some(Heard::Foreign(0x5D3)));
        assert_eq!(bus.hear(), None);
    }
}
