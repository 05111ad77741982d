//! When which frame is sent.
//!
//! `GapStatus` goes out on a fixed grid, and at once when the car must hear of a change;
//! `GapHealth` goes out on its own grid. Owns the schedules, the queue in front of the sink and
//! the E2E counters. Refuses to read a clock: time is told, and frames that fell due between two
//! calls are sent with their own due times and with what was valid then, so a drive gives the
//! same frames whatever the steps in which it is replayed.

use std::time::Duration;

use heapless::Deque;

use super::e2e::E2eSender;
use super::message::{GapHealth, GapStatus};
use super::{CanFrame, CanSettings, CanSettingsError, SinkError, WarningSink};

/// Frames that may wait for the sink: the newest health frame and the status of the last 0.3 s.
/// Our own choice: what is older says nothing of the road ahead.
const QUEUE: usize = 4;

/// What became of the frames since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SendCounts {
    /// Frames that the sink took.
    pub sent: u64,
    /// Writes that the sink refused; the frame is offered again.
    pub failed_writes: u64,
    /// Frames given up because newer ones were waiting.
    pub dropped: u64,
}

/// Sends [`GapStatus`] and [`GapHealth`] at their times.
///
/// For every frame of the drive call [`update`](Self::update), then [`poll`](Self::poll). On a
/// live bus also call `poll` at least every minimum gap, whatever the encoder is doing.
pub struct StatusSender {
    settings: CanSettings,
    status: Schedule<GapStatus>,
    health: Schedule<GapHealth>,
    queue: Deque<Waiting, QUEUE>,
    status_e2e: E2eSender,
    health_e2e: E2eSender,
    last_poll: Duration,
    /// When the sink took the last frame, and the last status frame.
    last_taken: Duration,
    last_status_taken: Option<Duration>,
    counts: SendCounts,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Message {
    Status,
    Health,
}

/// A frame without counter and CRC that the sink has not taken yet.
struct Waiting {
    message: Message,
    due: Duration,
    data: [u8; 8],
}

impl StatusSender {
    /// Sends nothing before the first update.
    ///
    /// # Errors
    /// When the settings cannot be kept, see [`CanSettings::check`].
    pub fn new(settings: CanSettings) -> Result<Self, CanSettingsError> {
        settings.check()?;
        Ok(Self {
            status: Schedule::new(
                settings.status_period,
                settings.minimum_gap,
                |told, status| {
                    (told.state, told.reason, told.gap_stored)
                        != (status.state, status.reason, status.gap_stored)
                },
            ),
            health: Schedule::new(settings.health_period, Duration::ZERO, |_, _| false),
            queue: Deque::new(),
            status_e2e: E2eSender::new(settings.status.data_id),
            health_e2e: E2eSender::new(settings.health.data_id),
            last_poll: Duration::ZERO,
            last_taken: Duration::ZERO,
            last_status_taken: None,
            counts: SendCounts::default(),
            settings,
        })
    }

    /// From `now` on this is the status; the next [`poll`](Self::poll) sends what follows from
    /// it. Of several updates before a poll the last one counts.
    pub fn update(&mut self, now: Duration, status: &GapStatus) {
        self.status.update = Some((now, *status));
    }

    /// From `now` on this is the health; as [`update`](Self::update).
    pub fn update_health(&mut self, now: Duration, health: &GapHealth) {
        self.health.update = Some((now, *health));
    }

    /// Gives up cyclic frames that fell due before `now` when that was more than a cycle ago, as when the program was
    /// stopped: on a live bus nobody is to hear what was valid then. Call it before an [`update`](Self::update).
    pub fn skip_missed(&mut self, now: Duration) {
        self.status.skip_missed(now);
        self.health.skip_missed(now);
    }

    /// Sends all frames due up to and including `now`, in the order of their due times. A frame
    /// that the sink refuses is offered again by the next call, and sent with the time of that.
    ///
    /// # Errors
    /// The refusal of the sink, after which nothing more is offered in this call. What fell due
    /// waits, as far as the queue holds it; to go on with the next call is right.
    pub fn poll(&mut self, now: Duration, sink: &mut dyn WarningSink) -> Result<(), SinkError> {
        let mut outcome = Ok(());
        loop {
            let (status, health) = (self.status.due(now), self.health.due(now));
            let (message, due, data) = match (status, health) {
                (Some(due), health) if health.is_none_or(|health| due <= health) => {
                    let (since, mut status) = self.status.take(due);
                    status.frame_age = status.frame_age.map(|age| age + (due - since));
                    (Message::Status, due, status.to_bytes())
                }
                (_, Some(due)) => (Message::Health, due, self.health.take(due).1.to_bytes()),
                (_, None) => break,
            };
            self.push(Waiting { message, due, data });
            outcome = outcome.and_then(|()| self.drain(due, sink));
        }
        outcome = outcome.and_then(|()| self.drain(now, sink));
        self.last_poll = now;
        outcome
    }

    /// What became of the frames so far.
    pub fn counts(&self) -> SendCounts {
        self.counts
    }

    /// Lets a frame wait. An old health frame makes place for a new one; when the queue is full
    /// the oldest status goes.
    fn push(&mut self, waiting: Waiting) {
        let before = self.queue.len();
        if waiting.message == Message::Health {
            self.queue.retain(|old| old.message == Message::Status);
        }
        if self.queue.is_full() {
            let mut found = false;
            self.queue.retain(|old| {
                let oldest = !found && old.message == Message::Status;
                found |= oldest;
                !oldest
            });
        }
        self.counts.dropped += (before - self.queue.len()) as u64;
        if self.queue.push_back(waiting).is_err() {
            unreachable!("one health frame at most, so a full queue held a status");
        }
    }

    /// Offers the waiting frames to the sink, up to the time `until` or the first refusal.
    fn drain(&mut self, until: Duration, sink: &mut dyn WarningSink) -> Result<(), SinkError> {
        while let Some(waiting) = self.queue.front() {
            let (id, e2e, earliest) = match waiting.message {
                Message::Status => {
                    let gap_over = |last| last + self.settings.minimum_gap;
                    let earliest = self.last_status_taken.map_or(Duration::ZERO, gap_over);
                    (self.settings.status.id, &mut self.status_e2e, earliest)
                }
                Message::Health => (
                    self.settings.health.id,
                    &mut self.health_e2e,
                    Duration::ZERO,
                ),
            };
            // Left over from the call before: it is late, and goes out with the time of now.
            let late = waiting.due <= self.last_poll;
            let wanted = if late { until } else { waiting.due };
            let at = wanted.max(earliest).max(self.last_taken);
            if at > until {
                break;
            }
            let taken = e2e.protect(waiting.data, |data| sink.send(at, &CanFrame { id, data }));
            if let Err(refusal) = taken {
                self.counts.failed_writes += 1;
                return Err(refusal);
            }
            self.counts.sent += 1;
            self.last_taken = at;
            if waiting.message == Message::Status {
                self.last_status_taken = Some(at);
            }
            self.queue.pop_front();
        }
        Ok(())
    }
}

/// When the frames of one message fall due, and what they carry.
struct Schedule<T> {
    period: Duration,
    minimum_gap: Duration,
    /// Whether the car must hear at once of the step from what it was told to what is valid.
    urgent: fn(&T, &T) -> bool,
    /// What is valid, and since when.
    valid: Option<(Duration, T)>,
    /// What will be valid, and from when on.
    update: Option<(Duration, T)>,
    /// What the car was told, and when that was due.
    told: Option<(Duration, T)>,
    /// Next point of the grid, which starts with the first frame.
    next_cyclic: Duration,
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
            next_cyclic: Duration::ZERO,
        }
    }

    fn skip_missed(&mut self, now: Duration) {
        if self.told.is_some() && self.next_cyclic + self.period <= now {
            self.next_cyclic = now;
        }
    }

    /// When the next frame is due, unless that is after `until`. An update comes into force as
    /// soon as no frame is due before it.
    fn due(&mut self, until: Duration) -> Option<Duration> {
        if let Some((from, _)) = self.update
            && self.planned().is_none_or(|at| from <= at)
        {
            self.valid = self.update.take();
        }
        self.planned().filter(|&at| at <= until)
    }

    /// When the next frame is due as things stand.
    fn planned(&self) -> Option<Duration> {
        let (since, valid) = self.valid.as_ref()?;
        let Some((last, told)) = &self.told else {
            return Some(*since);
        };
        let wanted = if (self.urgent)(told, valid) {
            *since
        } else {
            self.next_cyclic
        };
        Some(wanted.max(*last + self.minimum_gap))
    }

    /// What the frame due at `at` carries. It stands for the cyclic frame as well, if that has
    /// fallen due meanwhile.
    fn take(&mut self, at: Duration) -> (Duration, T) {
        let (since, valid) = self
            .valid
            .expect("a frame is due only when a content is valid");
        if self.told.is_none() {
            self.next_cyclic = at;
        }
        while self.next_cyclic <= at {
            self.next_cyclic += self.period;
        }
        self.told = Some((at, valid));
        (since, valid)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::alarm::{AlarmState, Reason};
    use crate::can::e2e::{E2eReceiver, Sequence};
    use proptest::prelude::*;
    use std::io;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn status(state: AlarmState) -> GapStatus {
        GapStatus {
            state,
            reason: Reason::None,
            gap_stored: false,
            score: Some(0.5),
            block_scores: [Some(0.5), None, None],
            fault_detection_counter: -128,
            frame_age: Some(Duration::ZERO),
        }
    }

    const HEALTH: GapHealth = GapHealth {
        strict: false,
        bus_state: crate::can::BusState::Unknown,
        frame_rate_hz: Some(10.0),
        dropped_frames: 0,
        latency_p50: None,
        latency_p99: None,
        window_fill: Some(1.0),
        reference_id: 7,
    };

    /// Keeps the frames, and refuses them for a while when told to.
    #[derive(Default)]
    struct Bus {
        taken: Vec<(Duration, CanFrame)>,
        refuses: bool,
    }

    impl WarningSink for Bus {
        fn send(&mut self, at: Duration, frame: &CanFrame) -> Result<(), SinkError> {
            if self.refuses {
                return Err(SinkError::Write {
                    sink: "bus".to_owned(),
                    source: io::ErrorKind::StorageFull.into(),
                });
            }
            self.taken.push((at, *frame));
            Ok(())
        }
    }

    impl Bus {
        /// Time in ms and state of each status frame.
        fn states(&self) -> Vec<(u128, AlarmState)> {
            self.of(0x5D0)
                .map(|(at, data)| (at.as_millis(), GapStatus::from_bytes(data).unwrap().state))
                .collect()
        }

        fn of(&self, id: u16) -> impl Iterator<Item = (Duration, &[u8; 8])> {
            self.taken
                .iter()
                .filter(move |(_, frame)| frame.id == id)
                .map(|(at, frame)| (*at, &frame.data))
        }

        fn counters(&self, id: u16) -> Vec<u8> {
            self.of(id).map(|(_, data)| data[1] & 0x0F).collect()
        }
    }

    fn sender() -> StatusSender {
        StatusSender::new(CanSettings::default()).unwrap()
    }

    /// Polls each `step` up to `end`; the updates are told at their own times, at the first poll
    /// that is not before them.
    fn drive(updates: &[(u64, AlarmState)], step: Duration, end: Duration) -> Bus {
        let (mut sender, mut bus) = (sender(), Bus::default());
        let mut updates = updates.iter().peekable();
        let mut now = Duration::ZERO;
        sender.update_health(now, &HEALTH);
        loop {
            while let Some((at, state)) = updates.next_if(|(at, _)| ms(*at) <= now) {
                sender.update(ms(*at), &status(*state));
                if updates.peek().is_some_and(|(at, _)| ms(*at) <= now) {
                    sender.poll(ms(*at), &mut bus).unwrap();
                }
            }
            sender.poll(now, &mut bus).unwrap();
            if now == end {
                return bus;
            }
            now = (now + step).min(end);
        }
    }

    use AlarmState::{Gap, Init, Ok as Fine, Suspect};

    #[test]
    fn nothing_is_sent_before_the_first_update() {
        let (mut sender, mut bus) = (sender(), Bus::default());
        sender.poll(ms(5000), &mut bus).unwrap();
        assert!(bus.taken.is_empty());
        sender.update(ms(5030), &status(Init));
        sender.poll(ms(5230), &mut bus).unwrap();
        assert_eq!(bus.states(), [(5030, Init), (5130, Init), (5230, Init)]);
    }

    #[test]
    fn change_is_sent_at_once_and_the_grid_goes_on() {
        let bus = drive(&[(0, Init), (150, Gap)], ms(10), ms(300));
        let wanted = [(0, Init), (100, Init), (150, Gap), (200, Gap), (300, Gap)];
        assert_eq!(bus.states(), wanted);
    }

    #[test]
    fn change_on_the_grid_is_one_frame_with_the_new_state() {
        let bus = drive(&[(0, Init), (100, Gap)], ms(100), ms(200));
        assert_eq!(bus.states(), [(0, Init), (100, Gap), (200, Gap)]);
    }

    #[test]
    fn change_inside_the_minimum_gap_waits_for_its_end() {
        let changes = [(0, Init), (105, Suspect), (112, Gap)];
        let bus = drive(&changes, ms(1), ms(200));
        assert_eq!(
            bus.states(),
            [(0, Init), (100, Init), (120, Gap), (200, Gap)]
        );
    }

    #[test]
    fn change_that_is_gone_before_the_gap_ends_is_not_sent() {
        let bus = drive(&[(0, Fine), (105, Suspect), (112, Fine)], ms(1), ms(200));
        assert_eq!(bus.states(), [(0, Fine), (100, Fine), (200, Fine)]);
    }

    #[test]
    fn cyclic_frame_keeps_the_minimum_gap_after_a_change() {
        let bus = drive(&[(0, Fine), (90, Suspect), (105, Gap)], ms(1), ms(300));
        let wanted = [(0, Fine), (90, Suspect), (110, Gap), (200, Gap), (300, Gap)];
        assert_eq!(bus.states(), wanted);
    }

    #[test]
    fn update_told_ahead_of_its_time_waits_for_it() {
        let (mut sender, mut bus) = (sender(), Bus::default());
        sender.update(ms(0), &status(Init));
        sender.poll(ms(0), &mut bus).unwrap();
        sender.update(ms(250), &status(Gap));
        sender.poll(ms(200), &mut bus).unwrap();
        sender.poll(ms(300), &mut bus).unwrap();
        let wanted = [(0, Init), (100, Init), (200, Init), (250, Gap), (300, Gap)];
        assert_eq!(bus.states(), wanted);
    }

    #[test]
    fn a_program_that_was_stopped_does_not_say_what_was_valid_before() {
        let (mut sender, mut bus) = (sender(), Bus::default());
        sender.update(ms(0), &status(Fine));
        sender.poll(ms(110), &mut bus).unwrap();
        sender.skip_missed(ms(1_150));
        sender.update(ms(1_150), &status(Init));
        sender.poll(ms(1_250), &mut bus).unwrap();
        let wanted = [(0, Fine), (100, Fine), (1_150, Init), (1_250, Init)];
        assert_eq!(bus.states(), wanted);
    }

    #[test]
    fn reason_and_stored_bit_are_changes_and_the_score_is_not() {
        let (mut sender, mut bus) = (sender(), Bus::default());
        let mut latest = status(Gap);
        sender.update(ms(0), &latest);
        sender.poll(ms(0), &mut bus).unwrap();
        latest.score = Some(3.0);
        sender.update(ms(30), &latest);
        sender.poll(ms(30), &mut bus).unwrap();
        latest.reason = Reason::Abrupt;
        sender.update(ms(40), &latest);
        sender.poll(ms(40), &mut bus).unwrap();
        latest.gap_stored = true;
        sender.update(ms(70), &latest);
        sender.poll(ms(100), &mut bus).unwrap();
        let times: Vec<u128> = bus.states().iter().map(|(at, _)| *at).collect();
        assert_eq!(times, [0, 40, 70, 100]);
    }

    #[test]
    fn frames_of_both_messages_come_in_the_order_of_time() {
        let bus = drive(&[(0, Fine), (1950, Gap)], ms(1000), ms(2000));
        let mut wanted: Vec<(u128, u16)> = (0..=20).map(|n| (n * 100, 0x5D0)).collect();
        wanted.insert(20, (1950, 0x5D0));
        for (place, at) in [(1, 0), (12, 1000), (24, 2000)] {
            wanted.insert(place, (at, 0x5D1));
        }
        let sent: Vec<(u128, u16)> = bus
            .taken
            .iter()
            .map(|(at, frame)| (at.as_millis(), frame.id))
            .collect();
        assert_eq!(sent, wanted);
        let read = GapHealth::from_bytes(bus.of(0x5D1).next().unwrap().1);
        assert_eq!(read, Ok(HEALTH));
    }

    #[test]
    fn steps_of_the_replay_do_not_change_the_frames() {
        let updates = [
            (0, Init),
            (40, Fine),
            (1270, Suspect),
            (1999, Gap),
            (2000, Fine),
        ];
        let fine = drive(&updates, ms(1), ms(4000));
        assert_eq!(fine.states().len(), 41 + 3);
        assert_eq!(fine.states()[..3], [(0, Init), (40, Fine), (100, Fine)]);
        for step in [33, 100, 1000] {
            let coarse = drive(&updates, ms(step), ms(4000));
            assert_eq!(coarse.taken, fine.taken, "steps of {step} ms");
        }
    }

    #[test]
    fn counter_is_followed_by_0_after_14_and_each_message_has_its_own() {
        let bus = drive(&[(0, Fine)], ms(100), ms(16_000));
        let wanted: Vec<u8> = (0..=14).cycle().take(161).collect();
        assert_eq!(bus.counters(0x5D0), wanted);
        let wanted: Vec<u8> = (0..=14).chain(0..=1).collect();
        assert_eq!(bus.counters(0x5D1), wanted);
    }

    #[test]
    fn refused_frame_is_offered_again_with_the_same_counter() {
        let (mut sender, mut bus) = (sender(), Bus::default());
        sender.update(ms(0), &status(Fine));
        sender.poll(ms(0), &mut bus).unwrap();
        bus.refuses = true;
        assert!(sender.poll(ms(100), &mut bus).is_err());
        assert!(sender.poll(ms(100), &mut bus).is_err());
        bus.refuses = false;
        sender.poll(ms(160), &mut bus).unwrap();
        sender.poll(ms(200), &mut bus).unwrap();
        assert_eq!(bus.states(), [(0, Fine), (160, Fine), (200, Fine)]);
        assert_eq!(bus.counters(0x5D0), [0, 1, 2]);
        let wanted = SendCounts {
            sent: 3,
            failed_writes: 2,
            dropped: 0,
        };
        assert_eq!(sender.counts(), wanted);
    }

    #[test]
    fn blocked_bus_drops_old_status_first_and_recovers_with_the_minimum_gap() {
        let (mut sender, mut bus) = (sender(), Bus::default());
        sender.update(ms(0), &status(Fine));
        sender.update_health(ms(0), &HEALTH);
        bus.refuses = true;
        for now in (0..=3000).step_by(10) {
            if now == 2750 {
                sender.update(ms(now), &status(Gap));
            }
            assert!(sender.poll(ms(now), &mut bus).is_err());
        }
        bus.refuses = false;
        for now in (3010..=3100).step_by(10) {
            sender.poll(ms(now), &mut bus).unwrap();
            let ahead = bus.taken.iter().find(|(at, _)| *at > ms(now));
            assert!(ahead.is_none(), "{ahead:?} at {now} ms");
        }
        // Kept: the status of 2800, 2900 and 3000, the health of 3000.
        let sent: Vec<(u128, u16)> = bus
            .taken
            .iter()
            .map(|(at, frame)| (at.as_millis(), frame.id))
            .collect();
        let wanted = [
            (3010, 0x5D0),
            (3030, 0x5D0),
            (3050, 0x5D0),
            (3050, 0x5D1),
            (3100, 0x5D0),
        ];
        assert_eq!(sent, wanted);
        assert!(bus.states().iter().all(|(_, state)| *state == Gap));
        assert_eq!(bus.counters(0x5D0), [0, 1, 2, 3]);
        assert_eq!(bus.counters(0x5D1), [0]);
        // 32 status and 4 health frames fell due up to 3000 ms, and one status after that.
        assert_eq!(sender.counts().dropped, 32 + 4 - 4);
        assert_eq!(sender.counts().sent, 5);
    }

    #[test]
    fn settings_that_cannot_be_kept_are_refused() {
        let settings = CanSettings {
            status_period: Duration::ZERO,
            ..CanSettings::default()
        };
        assert!(StatusSender::new(settings).is_err());
    }

    proptest! {
        #[test]
        fn any_drive_keeps_the_rules_of_the_bus(
            steps in proptest::collection::vec((0u64..300, 0usize..4), 1..60),
            refusals in proptest::collection::vec(proptest::bool::weighted(0.1), 60),
        ) {
            let states = [Init, Fine, Suspect, Gap];
            let (mut sender, mut bus) = (sender(), Bus::default());
            let mut now = Duration::ZERO;
            for ((step, state), refuses) in steps.into_iter().zip(refusals) {
                bus.refuses = refuses;
                now += ms(step);
                sender.update(now, &status(states[state]));
                sender.update_health(now, &HEALTH);
                let _ = sender.poll(now, &mut bus);
            }
            bus.refuses = false;
            sender.poll(now + ms(500), &mut bus).unwrap();

            prop_assert!(bus.taken.is_sorted_by_key(|(at, _)| *at));
            for (id, data_id) in [(0x5D0, 0x5D0), (0x5D1, 0x5D1)] {
                let mut receiver = E2eReceiver::new(data_id);
                for (n, (_, data)) in bus.of(id).enumerate() {
                    let wanted = if n == 0 { Sequence::First } else { Sequence::Next };
                    prop_assert_eq!(receiver.check(data), Ok(wanted));
                }
            }
            let times: Vec<Duration> = bus.of(0x5D0).map(|(at, _)| at).collect();
            for pair in times.windows(2) {
                prop_assert!(pair[1] - pair[0] >= ms(20), "{:?}", pair);
                if sender.counts().failed_writes == 0 {
                    prop_assert!(pair[1] - pair[0] <= ms(100), "{:?}", pair);
                }
            }
        }
    }
}
