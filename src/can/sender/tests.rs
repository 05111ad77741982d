#![allow(clippy::unwrap_used)]
use super::*;
use crate::can::e2e::{E2eReceiver, Sequence};
use crate::monitor::alarm::{AlarmState, Reason};
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
        gap: Some(0.5),
        cause: None,
        change: None,
        lanes: None,
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
    cause_probability: None,
};

const VERSION: GapVersion = GapVersion {
    reference_id: [7, 8, 9, 10],
    program: [0, 1],
};

/// Keeps the frames, and can be set to refuse them for a while.
#[derive(Default)]
struct Bus {
    taken: Vec<(Duration, CanFrame)>,
    refuses: bool,
    /// It has not yet sent what it accepted before.
    busy: bool,
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

    fn is_ready(&mut self, _now: Duration) -> bool {
        !self.busy
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

/// Polls in every `step` up to `end`. The updates are given with their own times, at the first poll that is not before
/// them.
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
    let (mut sender, mut bus) = (sender(), Bus::default());
    sender.update(ms(0), &status(Init));
    sender.poll(ms(0), &mut bus).unwrap();
    assert!(!sender.is_waiting());
    sender.update(ms(5), &status(Gap));
    for now in 5..20 {
        sender.poll(ms(now), &mut bus).unwrap();
        assert!(sender.is_waiting(), "{now} ms");
    }
    sender.poll(ms(20), &mut bus).unwrap();
    assert!(!sender.is_waiting());
    assert_eq!(bus.states(), [(0, Init), (20, Gap)]);
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
    let (mut sender, mut bus) = (sender().live(), Bus::default());
    for now in [0, 20, 40, 60, 80, 110, 1_150, 1_160, 1_210, 1_310] {
        let state = if now < 1_150 { Fine } else { Init };
        sender.update(ms(now), &status(state));
        sender.poll(ms(now), &mut bus).unwrap();
    }
    let wanted = [
        (0, Fine),
        (110, Fine),
        (1_150, Init),
        (1_210, Init),
        (1_310, Init),
    ];
    assert_eq!(bus.states(), wanted);
}

#[test]
fn on_a_live_bus_a_frame_carries_what_is_valid_when_it_is_sent() {
    let (mut sender, mut bus) = (sender().live(), Bus::default());
    sender.update(ms(0), &status(Fine));
    sender.poll(ms(0), &mut bus).unwrap();
    // Due at 100 ms, sent at 107, when something else is valid for 2 ms.
    sender.update(ms(105), &status(Gap));
    sender.poll(ms(107), &mut bus).unwrap();
    sender.poll(ms(199), &mut bus).unwrap();
    sender.poll(ms(200), &mut bus).unwrap();
    assert_eq!(bus.states(), [(0, Fine), (107, Gap), (200, Gap)]);
    // The age is rounded up to 100 ms.
    let ages = bus.of(0x5D0).map(|(_, data)| {
        let status = GapStatus::from_bytes(data).unwrap();
        status.frame_age.unwrap().as_millis()
    });
    assert_eq!(ages.collect::<Vec<u128>>(), [0, 100, 100]);
}

#[test]
fn a_sink_that_is_not_ready_gets_the_newest_state_alone_and_with_its_age() {
    for live in [false, true] {
        let mut sender = if live { sender().live() } else { sender() };
        let mut bus = Bus::default();
        sender.update_health(ms(0), &HEALTH);
        sender.update(ms(0), &status(Fine));
        sender.poll(ms(0), &mut bus).unwrap();
        assert!(!sender.is_waiting());
        bus.busy = true;
        for now in (10..=30_000).step_by(10) {
            if now == 14_310 {
                sender.update(ms(now), &status(Gap));
            }
            sender.poll(ms(now), &mut bus).unwrap();
        }
        assert!(sender.is_waiting());
        bus.busy = false;
        for now in (30_010..=30_200).step_by(10) {
            sender.poll(ms(now), &mut bus).unwrap();
        }
        let wanted = [(0, Fine), (30_010, Gap), (30_100, Gap), (30_200, Gap)];
        assert_eq!(bus.states(), wanted);
        let health: Vec<u128> = bus.of(0x5D1).map(|(at, _)| at.as_millis()).collect();
        assert_eq!(health, [0, 30_010]);
        assert_eq!(bus.counters(0x5D0), [0, 1, 2, 3]);
        // 15.7 s are more than the signal can represent.
        let late = GapStatus::from_bytes(bus.of(0x5D0).nth(1).unwrap().1).unwrap();
        assert_eq!(late.frame_age, Some(ms(1_400)));
        let wanted = SendCounts {
            sent: 6,
            failed_writes: 0,
            dropped: 299 + 29,
        };
        assert_eq!(sender.counts(), wanted);
    }
}

#[test]
fn reason_and_stored_bit_are_changes_and_the_score_is_not() {
    let (mut sender, mut bus) = (sender(), Bus::default());
    let mut latest = status(Gap);
    sender.update(ms(0), &latest);
    sender.poll(ms(0), &mut bus).unwrap();
    latest.gap = Some(3.0);
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
fn the_version_comes_once_at_the_start_and_then_in_its_own_cycle() {
    for live in [false, true] {
        let mut sender = if live { sender().live() } else { sender() };
        let mut bus = Bus::default();
        for now in (0..=3_000).step_by(10) {
            sender.update(ms(now), &status(Fine));
            sender.update_version(ms(now), &VERSION);
            sender.poll(ms(now), &mut bus).unwrap();
        }
        let times: Vec<u128> = bus.of(0x5D3).map(|(at, _)| at.as_millis()).collect();
        assert_eq!(times, [0, 1_000, 2_000, 3_000]);
        assert_eq!(bus.counters(0x5D3), [0, 1, 2, 3]);
        let mut receiver = E2eReceiver::new(0x5D3);
        for (_, data) in bus.of(0x5D3) {
            receiver.check(data).unwrap();
            assert_eq!(GapVersion::from_bytes(data), Ok(VERSION));
        }
        // What the car must know first is sent first.
        assert_eq!(bus.taken[0].1.id, 0x5D0);
        assert_eq!(bus.taken[1].1.id, 0x5D3);
    }
}

#[test]
fn a_version_that_is_refused_waits_and_is_sent_once() {
    let (mut sender, mut bus) = (sender().live(), Bus::default());
    sender.update_version(ms(0), &VERSION);
    bus.refuses = true;
    for now in (0..=2_500).step_by(10) {
        assert!(sender.poll(ms(now), &mut bus).is_err());
        assert!(sender.is_waiting());
    }
    bus.refuses = false;
    sender.poll(ms(2_510), &mut bus).unwrap();
    assert!(!sender.is_waiting());
    assert_eq!(bus.counters(0x5D3), [0]);
    // Those of 1 s and 2 s became due while the first one waited.
    assert_eq!(sender.counts().dropped, 2);
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
fn of_a_blocked_bus_the_newest_frames_are_left_and_the_grid_goes_on() {
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
    let sent: Vec<(u128, u16)> = bus
        .taken
        .iter()
        .map(|(at, frame)| (at.as_millis(), frame.id))
        .collect();
    assert_eq!(sent, [(3010, 0x5D0), (3010, 0x5D1), (3100, 0x5D0)]);
    assert!(bus.states().iter().all(|(_, state)| *state == Gap));
    assert_eq!(bus.counters(0x5D0), [0, 1]);
    assert_eq!(bus.counters(0x5D1), [0]);
    // 31 status and 4 health frames of the cycles became due up to 3000 ms, and one of each was left.
    assert_eq!(sender.counts().dropped, 31 + 4 - 2);
    assert_eq!(sender.counts().sent, 3);
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
        live in proptest::bool::ANY,
    ) {
        let states = [Init, Fine, Suspect, Gap];
        let (mut sender, mut bus) = (sender(), Bus::default());
        sender = if live { sender.live() } else { sender };
        let mut now = Duration::ZERO;
        for ((step, state), refuses) in steps.into_iter().zip(refusals) {
            bus.refuses = refuses;
            now += ms(step);
            sender.update(now, &status(states[state]));
            sender.update_health(now, &HEALTH);
            sender.update_version(now, &VERSION);
            let _ = sender.poll(now, &mut bus);
        }
        bus.refuses = false;
        sender.poll(now + ms(500), &mut bus).unwrap();

        prop_assert!(bus.taken.is_sorted_by_key(|(at, _)| *at));
        for (id, data_id) in [(0x5D0, 0x5D0), (0x5D1, 0x5D1), (0x5D3, 0x5D3)] {
            let mut receiver = E2eReceiver::new(data_id);
            for (n, (_, data)) in bus.of(id).enumerate() {
                let wanted = if n == 0 { Sequence::First } else { Sequence::Next };
                prop_assert_eq!(receiver.check(data), Ok(wanted));
            }
        }
        let times: Vec<Duration> = bus.of(0x5D0).map(|(at, _)| at).collect();
        for pair in times.windows(2) {
            prop_assert!(pair[1] - pair[0] >= ms(20), "{:?}", pair);
            if sender.counts().failed_writes == 0 && !live {
                prop_assert!(pair[1] - pair[0] <= ms(100), "{:?}", pair);
            }
        }
    }
}
