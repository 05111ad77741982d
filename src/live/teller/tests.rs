#![allow(clippy::unwrap_used)]
use std::io::{self, Write};
use std::path::Path;

use AlarmState::{Gap, Init, Ok as Fine, SensorFault, Unavailable};

use super::super::bus::tests::{SharedWire, bus, full, ms, refused};
use super::*;
use crate::can::CanFrame;
use crate::can::e2e::E2eSender;
use crate::can::message::ClearRequest;
use crate::capture::clock::ClockTime;
use crate::record::journal::{About, Journal};

/// A teller with 200 ms between frames, for a car that is parked when it has not moved for a second.
struct Rig {
    teller: Teller,
    wire: SharedWire,
    /// What was shown: a verdict, its age in ms, and whether it is a change.
    said: Vec<(Verdict, u128, bool)>,
}

impl Rig {
    fn new() -> Self {
        Self::with_frames_every(ms(200))
    }

    fn with_frames_every(period: Duration) -> Self {
        let (bus, wire) = bus();
        let outputs = Outputs {
            bus: bus.live(),
            journal: None,
            recording: None,
        };
        let service = Service::new(period, Some(ms(3_000)));
        Self {
            teller: Teller::new(outputs, period, ms(1_000), service),
            wire,
            said: vec![],
        }
    }

    /// A teller that has begun at 0.
    fn begun() -> Self {
        let mut rig = Self::new();
        rig.begin(0).unwrap();
        rig.said.clear();
        rig
    }

    /// A teller whose car is parked at 1,000 ms, with a clear road before.
    fn parked() -> Self {
        let mut rig = Self::begun();
        for at in [0, 500, 1_000] {
            rig.wire.borrow_mut().say_kmh(0);
            let orders = rig.tick(at, [word(ok(at))]).unwrap();
            assert_eq!(orders.parked, at == 1_000);
        }
        let last = rig.said.split_off(3);
        assert_eq!(last, [(without_frame(1_000, Reason::Parked), 0, true)]);
        rig.said.clear();
        rig
    }

    fn begin(&mut self, now: u64) -> Result<(), OutputError> {
        self.teller.begin(ms(now), &mut note(&mut self.said))
    }

    fn tick(
        &mut self,
        now: u64,
        words: impl IntoIterator<Item = Word>,
    ) -> Result<Orders, OutputError> {
        self.teller.tick(ms(now), words, &mut note(&mut self.said))
    }

    fn stop(&mut self, now: u64) -> Result<(), OutputError> {
        self.teller.stop(ms(now), &mut note(&mut self.said))
    }

    /// What was shown since the last time.
    fn news(&mut self) -> Vec<(AlarmState, Reason)> {
        let said = std::mem::take(&mut self.said).into_iter();
        said.map(|(it, ..)| (it.state, it.reason)).collect()
    }

    /// State and reason of each status frame, with its time in ms.
    fn sent(&self) -> Vec<(u128, AlarmState, Reason)> {
        let statuses = self.wire.borrow().statuses().into_iter();
        statuses.map(|(at, it)| (at, it.state, it.reason)).collect()
    }
}

fn note(said: &mut Vec<(Verdict, u128, bool)>) -> impl FnMut(Said<'_>) {
    |it| said.push((it.verdict.clone(), it.latency.as_millis(), it.is_change))
}

fn word(verdict: Verdict) -> Word {
    Word::Verdict {
        verdict,
        dropped: 0,
    }
}

/// Verdict on a frame that was taken at a time in ms.
fn verdict(at: u64, state: AlarmState, reason: Reason) -> Verdict {
    Verdict {
        at: ms(at),
        sequence: Some(at),
        state,
        reason,
        ..Verdict::nothing_yet()
    }
}

fn ok(at: u64) -> Verdict {
    Verdict {
        score: Some(0.1),
        gap: Some(0.1),
        ..verdict(at, Fine, Reason::None)
    }
}

fn gap(at: u64) -> Verdict {
    Verdict {
        score: Some(3.0),
        gap: Some(3.0),
        fault_detection_counter: 127,
        gap_stored: true,
        ..verdict(at, Gap, Reason::Abrupt)
    }
}

fn without_frame(at: u64, reason: Reason) -> Verdict {
    Verdict {
        sequence: None,
        ..verdict(at, Unavailable, reason)
    }
}

fn silence(at: u64) -> Verdict {
    Verdict {
        undefined: Some(Undefined::Silence),
        ..without_frame(at, Reason::Stale)
    }
}

/// Error that says that there is no reader any more.
fn broken() -> SinkError {
    SinkError::Write {
        sink: "log:-".to_owned(),
        source: io::ErrorKind::BrokenPipe.into(),
    }
}

const NOTHING: [(AlarmState, Reason); 0] = [];
const STALE_NEWS: [(AlarmState, Reason); 1] = [(Unavailable, Reason::Stale)];

#[test]
fn the_first_word_is_of_now_and_silence_counts_from_then() {
    let mut rig = Rig::new();
    rig.begin(3_000).unwrap();
    let first = Verdict {
        at: ms(3_000),
        ..Verdict::nothing_yet()
    };
    assert_eq!(rig.said, [(first, 0, true)]);
    assert_eq!(rig.sent(), [(3_000, Init, Reason::Starting)]);
    rig.said.clear();
    rig.tick(3_550, []).unwrap();
    assert_eq!(rig.news(), NOTHING);
    rig.tick(3_551, []).unwrap();
    assert_eq!(rig.news(), STALE_NEWS);
}

#[test]
fn silence_is_told_once_with_the_counter_and_the_stored_bit() {
    let mut rig = Rig::begun();
    rig.tick(110, [word(gap(100))]).unwrap();
    assert_eq!(rig.said, [(gap(100), 10, true)]);
    rig.said.clear();
    rig.tick(660, []).unwrap();
    assert_eq!(rig.news(), NOTHING);
    rig.tick(661, []).unwrap();
    let wanted = Verdict {
        fault_detection_counter: 127,
        gap_stored: true,
        ..silence(661)
    };
    assert_eq!(rig.said, [(wanted, 0, true)]);
    rig.said.clear();
    for now in (700..9_000).step_by(100) {
        rig.tick(now, []).unwrap();
    }
    assert_eq!(rig.news(), NOTHING);
    // A silence that comes late is no news either.
    rig.tick(9_000, [word(silence(8_990))]).unwrap();
    assert_eq!(rig.news(), NOTHING);
}

#[test]
fn slow_frames_leave_more_time() {
    let mut rig = Rig::with_frames_every(ms(1_000));
    rig.begin(0).unwrap();
    rig.said.clear();
    rig.tick(1_550, []).unwrap();
    assert_eq!(rig.news(), NOTHING);
    rig.tick(1_551, []).unwrap();
    assert_eq!(rig.news(), STALE_NEWS);
}

#[test]
fn a_fault_says_already_that_there_is_no_verdict() {
    let mut rig = Rig::begun();
    let black = (SensorFault, Reason::Black);
    rig.tick(100, [word(verdict(100, black.0, black.1))])
        .unwrap();
    rig.tick(5_000, [word(silence(5_000))]).unwrap();
    assert_eq!(rig.news(), [black]);
}

#[test]
fn the_judge_may_be_the_first_to_tell_of_silence() {
    let mut rig = Rig::begun();
    rig.tick(100, [word(ok(100)), word(silence(60))]).unwrap();
    let said = [(ok(100), 0, true), (silence(60), 40, true)];
    assert_eq!(rig.said, said);
}

#[test]
fn a_change_is_another_state_or_another_reason() {
    let mut rig = Rig::new();
    rig.begin(0).unwrap();
    let words = [
        verdict(10, Init, Reason::Starting),
        ok(20),
        ok(30),
        gap(40),
        verdict(50, Gap, Reason::Drift),
        verdict(60, Gap, Reason::Drift),
    ];
    rig.tick(60, words.map(word)).unwrap();
    let changes: Vec<bool> = rig.said.iter().map(|(.., change)| *change).collect();
    assert_eq!(changes, [true, false, true, false, true, true, false]);
}

#[test]
fn a_verdict_that_comes_late_is_lagging_and_no_silence() {
    let mut rig = Rig::begun();
    rig.tick(549, [word(ok(50))]).unwrap();
    assert_eq!(rig.said, [(ok(50), 499, true)]);
    rig.said.clear();
    rig.tick(600, [word(ok(100))]).unwrap();
    let late = Verdict {
        score: None,
        gap: None,
        undefined: Some(Undefined::Late(ms(500))),
        ..verdict(100, Unavailable, Reason::Lagging)
    };
    assert_eq!(rig.said, [(late, 500, true)]);
    rig.said.clear();
    rig.tick(1_300, []).unwrap();
    assert_eq!(rig.news(), NOTHING);
}

#[test]
fn while_parked_only_the_stored_bit_is_news() {
    let mut rig = Rig::parked();
    rig.tick(1_010, [word(ok(990))]).unwrap();
    assert_eq!(rig.news(), NOTHING);
    rig.tick(1_020, [gap(991), gap(992)].map(word)).unwrap();
    let stored = Verdict {
        gap_stored: true,
        ..without_frame(1_000, Reason::Parked)
    };
    assert_eq!(rig.said, [(stored, 20, false)]);
    rig.said.clear();
    rig.tick(1_030, [Word::Cleared(false)]).unwrap();
    assert_eq!(rig.news(), NOTHING);
    rig.tick(1_040, [Word::Cleared(true)]).unwrap();
    let cleared = without_frame(1_000, Reason::Parked);
    assert_eq!(rig.said, [(cleared, 40, false)]);
}

#[test]
fn parked_is_told_once_and_behind_it_silence_is_news_again() {
    let mut rig = Rig::parked();
    for now in (1_500..=4_000).step_by(500) {
        rig.wire.borrow_mut().say_kmh(0);
        assert!(rig.tick(now, []).unwrap().parked);
    }
    assert_eq!(rig.news(), NOTHING);
    // No frame was to be judged until then.
    rig.wire.borrow_mut().say_kmh(50);
    assert!(!rig.tick(4_400, []).unwrap().parked);
    rig.tick(4_950, []).unwrap();
    assert_eq!(rig.news(), NOTHING);
    rig.tick(4_951, []).unwrap();
    assert_eq!(rig.said, [(silence(4_951), 0, true)]);
    rig.said.clear();
    rig.tick(9_000, []).unwrap();
    assert_eq!(rig.news(), NOTHING);
}

#[test]
fn a_car_that_drives_off_hears_of_the_first_frame() {
    let mut rig = Rig::parked();
    rig.wire.borrow_mut().say_kmh(50);
    rig.tick(1_100, []).unwrap();
    rig.tick(1_200, [word(ok(1_190))]).unwrap();
    assert_eq!(rig.said, [(ok(1_190), 10, true)]);
}

#[test]
fn a_cleared_bit_is_told_with_what_was_known_and_is_no_sign_of_the_judge() {
    let mut rig = Rig::begun();
    rig.tick(100, [word(gap(100))]).unwrap();
    rig.said.clear();
    rig.tick(300, [Word::Cleared(false)]).unwrap();
    assert_eq!(rig.news(), NOTHING);
    rig.tick(300, [Word::Cleared(true), Word::Cleared(true)])
        .unwrap();
    let cleared = Verdict {
        sequence: None,
        gap_stored: false,
        ..gap(100)
    };
    assert_eq!(rig.said, [(cleared, 200, false)]);
    rig.said.clear();
    rig.tick(650, []).unwrap();
    assert_eq!(rig.news(), NOTHING);
    rig.tick(651, []).unwrap();
    assert_eq!(rig.news(), STALE_NEWS);
}

#[test]
fn what_is_too_old_is_not_told_again_for_a_cleared_bit() {
    let mut rig = Rig::begun();
    rig.tick(100, [word(gap(100))]).unwrap();
    rig.said.clear();
    rig.tick(651, [Word::Cleared(true)]).unwrap();
    let wanted = Verdict {
        fault_detection_counter: 127,
        ..silence(651)
    };
    assert_eq!(rig.said, [(wanted, 0, true)]);
}

#[test]
fn a_request_to_clear_is_an_order_once_and_nothing_else_on_the_bus_is() {
    let mut rig = Rig::begun();
    let mut sender = E2eSender::new(0x5D8);
    let heard = |data| CanFrame { id: 0x5D8, data };
    let protected = sender.protect(ClearRequest.to_bytes(), |data| {
        rig.wire.borrow_mut().heard.push_back(heard(data));
        Ok::<(), ()>(())
    });
    protected.unwrap();
    let foreign = CanFrame {
        id: 0x5D0,
        data: [0; 8],
    };
    rig.wire.borrow_mut().heard.push_back(foreign);
    assert!(rig.tick(10, []).unwrap().clear);
    assert!(!rig.tick(20, []).unwrap().clear);
    rig.wire.borrow_mut().heard.push_back(heard([0; 8]));
    rig.wire.borrow_mut().heard.push_back(foreign);
    rig.wire.borrow_mut().say_kmh(0);
    assert_eq!(rig.tick(30, []).unwrap(), Orders::default());
}

#[test]
fn the_health_of_the_bus_goes_on_and_counts_dropped_frames() {
    let mut rig = Rig::begun();
    let word = Word::Verdict {
        verdict: ok(100),
        dropped: 7,
    };
    rig.tick(100, [word]).unwrap();
    rig.tick(1_000, []).unwrap();
    rig.tick(2_000, []).unwrap();
    let healths = rig.wire.borrow().healths();
    let healths: Vec<_> = (healths.iter())
        .map(|(at, it)| (*at, it.dropped_frames, it.frame_rate_hz))
        .collect();
    let wanted = [
        (0, 0, Some(0.0)),
        (1_000, 7, Some(1.0)),
        (2_000, 7, Some(0.0)),
    ];
    assert_eq!(healths, wanted);
}

#[test]
fn a_stream_that_nobody_reads_is_the_end_and_people_hear_it_first() {
    let mut rig = Rig::new();
    rig.wire.borrow_mut().trouble = Some(broken);
    assert!(rig.begin(0).is_err());
    assert!(rig.tick(100, []).is_err());
    assert!(rig.tick(200, [word(gap(200))]).is_err());
    assert!(rig.stop(300).is_err());
    let wanted = [
        (Init, Reason::Starting),
        (Gap, Reason::Abrupt),
        (Unavailable, Reason::Stopped),
    ];
    assert_eq!(rig.news(), wanted);
    rig.teller.offer(ms(400));
    assert_eq!(rig.teller.finish().len(), 1);
}

#[test]
fn any_other_trouble_is_no_end() {
    for trouble in [full, refused] {
        let mut rig = Rig::new();
        rig.wire.borrow_mut().trouble = Some(trouble);
        rig.begin(0).unwrap();
        rig.tick(100, []).unwrap();
        rig.tick(200, [word(gap(200))]).unwrap();
        rig.stop(300).unwrap();
        rig.teller.offer(ms(400));
        assert_eq!(rig.said.len(), 3);
    }
}

/// Accepts one line.
struct OneLine(bool);

impl Write for OneLine {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if std::mem::replace(&mut self.0, true) {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_journal_that_nobody_reads_is_no_end() {
    let mut rig = Rig::new();
    let (began, about) = (ClockTime::default(), About::default());
    let journal = Journal::stream(Path::new("j"), OneLine(false), &[], &began, &about);
    rig.teller.outputs.journal = Some(journal.unwrap());
    rig.begin(0).unwrap();
    rig.tick(100, [word(gap(100))]).unwrap();
    assert_eq!(rig.sent().last(), Some(&(100, Gap, Reason::Abrupt)));
    assert_eq!(rig.teller.complained_at, [None, Some(ms(0))]);
}

#[test]
fn the_last_word_waits_for_its_time_on_the_bus() {
    let mut rig = Rig::begun();
    assert!(!rig.teller.is_waiting());
    rig.stop(10).unwrap();
    assert_eq!(rig.said, [(without_frame(10, Reason::Stopped), 0, true)]);
    assert!(rig.teller.is_waiting());
    rig.teller.offer(ms(19));
    assert!(rig.teller.is_waiting());
    rig.teller.offer(ms(20));
    assert!(!rig.teller.is_waiting());
    let wanted = [
        (0, Init, Reason::Starting),
        (20, Unavailable, Reason::Stopped),
    ];
    assert_eq!(rig.sent(), wanted);
    assert!(rig.teller.finish().is_empty());
}

#[test]
fn the_monitor_is_ready_with_a_score_or_a_fault() {
    for (verdict, ready) in [
        (verdict(10, Init, Reason::Starting), false),
        (ok(10), true),
        (verdict(10, SensorFault, Reason::Black), true),
    ] {
        let mut rig = Rig::begun();
        assert_eq!(rig.teller.service(ms(0), 1), ServiceWords::default());
        rig.tick(10, [word(verdict)]).unwrap();
        let wanted = ServiceWords {
            ready,
            alive: false,
        };
        assert_eq!(rig.teller.service(ms(10), 2), wanted);
        let alive = rig.teller.service(ms(1_000), 3).alive;
        assert_eq!(alive, ready);
    }
}

#[test]
fn a_late_verdict_is_lagging_whatever_it_says() {
    let just = LATE - Duration::from_nanos(1);
    for state in [AlarmState::Ok, AlarmState::Gap, AlarmState::SensorFault] {
        let verdict = Verdict {
            at: Duration::from_secs(3),
            sequence: Some(7),
            state,
            score: Some(0.1),
            gap: Some(0.1),
            window_fill: Some(0.5),
            fault_detection_counter: 9,
            gap_stored: true,
            ..Verdict::nothing_yet()
        };
        assert_eq!(in_time(verdict.clone(), just), verdict);
        let late = in_time(verdict.clone(), LATE);
        let wanted = Verdict {
            state: AlarmState::Unavailable,
            reason: Reason::Lagging,
            undefined: Some(Undefined::Late(LATE)),
            score: None,
            gap: None,
            ..verdict
        };
        assert_eq!(late, wanted);
    }
    // Silence is never late.
    let silence = Verdict {
        state: AlarmState::Unavailable,
        reason: Reason::Stale,
        ..Verdict::nothing_yet()
    };
    assert_eq!(in_time(silence.clone(), 2 * LATE), silence);
}

#[test]
fn trouble_is_told_once_a_second() {
    let s = Duration::from_secs_f64;
    let mut complained_at = None;
    let told = [0.0, 0.999, 1.0, 1.5, 2.0, 9.0].map(|at| may_complain(&mut complained_at, s(at)));
    assert_eq!(told, [true, false, true, false, true, true]);
}

#[test]
fn an_error_is_told_with_what_caused_it() {
    let error = OutputError::Bus(SinkError::Write {
        sink: "log:-".to_owned(),
        source: std::io::ErrorKind::StorageFull.into(),
    });
    let said = with_causes(&error);
    assert!(
        said.contains("log:-") && said.ends_with(": no storage space"),
        "{said}"
    );
}
