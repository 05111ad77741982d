#![allow(clippy::unwrap_used)]
use super::*;
use proptest::prelude::*;

const STATES: [(AlarmState, u8); 6] = [
    (AlarmState::Init, 0),
    (AlarmState::Ok, 1),
    (AlarmState::Suspect, 2),
    (AlarmState::Gap, 3),
    (AlarmState::SensorFault, 4),
    (AlarmState::Unavailable, 5),
];
const REASONS: [(Reason, u8); 17] = [
    (Reason::None, 0),
    (Reason::Starting, 1),
    (Reason::Abrupt, 2),
    (Reason::Drift, 3),
    (Reason::Black, 4),
    (Reason::Uniform, 5),
    (Reason::Corrupt, 6),
    (Reason::Frozen, 7),
    (Reason::Covered, 8),
    (Reason::Lagging, 9),
    (Reason::Stale, 10),
    (Reason::Stopped, 11),
    (Reason::Parked, 12),
    (Reason::Undefined, 13),
    (Reason::TooSmall, 14),
    (Reason::Change, 15),
    (Reason::Lanes, 16),
];
const CAUSES: [(Cause, u8); 12] = [
    (Cause::Fog, 1),
    (Cause::Night, 2),
    (Cause::Rain, 3),
    (Cause::Snow, 4),
    (Cause::Glare, 5),
    (Cause::Dirt, 6),
    (Cause::Blur, 7),
    (Cause::Noise, 8),
    (Cause::Askew, 9),
    (Cause::Tunnel, 10),
    (Cause::AnotherRoad, 11),
    (Cause::Other, 12),
];

fn status() -> GapStatus {
    GapStatus {
        state: AlarmState::Gap,
        reason: Reason::Abrupt,
        gap_stored: true,
        cause: Some(Cause::Dirt),
        gap: Some(1.0),
        change: Some(5.08),
        lanes: Some(0.25),
        fault_detection_counter: 127,
        frame_age: Some(Duration::from_millis(300)),
    }
}

fn health() -> GapHealth {
    GapHealth {
        strict: true,
        bus_state: BusState::Unknown,
        frame_rate_hz: Some(10.0),
        dropped_frames: 3,
        latency_p50: Some(Duration::from_millis(24)),
        latency_p99: None,
        window_fill: Some(1.0),
        cause_probability: Some(0.84),
    }
}

fn version() -> GapVersion {
    GapVersion {
        reference_id: [0xC3, 0x01, 0x02, 0xFE],
        program: [3, 14],
    }
}

#[test]
fn status_has_the_bytes_computed_by_hand() {
    // Age 3 in the high nibble; state 3 + stored 8 + cause 6 in the high nibble; reason 2; 1.0 = 50; a quarter = 50.
    let bytes = [0, 0x30, 0x6B, 2, 50, 254, 50, 127];
    assert_eq!(status().to_bytes(), bytes);
    assert_eq!(GapStatus::from_bytes(&bytes), Ok(status()));
}

#[test]
fn health_has_the_bytes_computed_by_hand() {
    let bytes = [0, 0x10, 40, 3, 12, 255, 200, 168];
    assert_eq!(health().to_bytes(), bytes);
    assert_eq!(GapHealth::from_bytes(&bytes), Ok(health()));
}

#[test]
fn version_has_the_bytes_computed_by_hand() {
    // The first number of the program's version in the high nibble; the reference in the order of its hash.
    let bytes = [0, 0x30, 3, 0xC3, 0x01, 0x02, 0xFE, 14];
    assert_eq!(version().to_bytes(), bytes);
    assert_eq!(GapVersion::from_bytes(&bytes), Ok(version()));
    let later = GapVersion {
        program: [16, 255],
        ..version()
    };
    assert_eq!(later.to_bytes()[1..3], [0xF0, 3]);
    assert_eq!(later.to_bytes()[7], 255);
}

#[test]
fn the_version_is_that_of_the_dbc_and_any_other_is_refused() {
    let dbc = include_str!("../gapwatch.dbc");
    assert!(dbc.starts_with(&format!("VERSION \"{DBC_VERSION}\"\n")));
    for other in [0, 1, 2, 4, 255] {
        let mut bytes = version().to_bytes();
        bytes[2] = other;
        let refused = GapVersion::from_bytes(&bytes).unwrap_err();
        assert_eq!((refused.signal, refused.code), ("DbcVersion", other));
    }
}

#[test]
fn of_this_program_is_its_own_version() {
    let [major, minor] = GapVersion::of_this_program([1, 2, 3, 4]).program;
    assert!(env!("CARGO_PKG_VERSION").starts_with(&format!("{major}.{minor}.")));
}

/// A frame of version 1: state 3 and stored bit as now, its reason (2) where the cause is now, its score (1.0 = 50)
/// where the reason is now, then three scores of taps.
const VERSION_1: [u8; 8] = [0, 0x30, 0x2B, 50, 50, 40, 30, 127];

#[test]
fn a_frame_of_version_1_is_not_taken_for_this_one_when_its_score_is_no_reason() {
    let refused = GapStatus::from_bytes(&VERSION_1).unwrap_err();
    assert_eq!((refused.signal, refused.code), ("Reason", 50));
    // A low score looks like a reason: only the missing GapVersion tells that the frame is of version 1.
    let mut low = VERSION_1;
    low[3] = 5;
    let misread = GapStatus::from_bytes(&low).unwrap();
    assert_eq!(
        (misread.state, misread.reason),
        (AlarmState::Gap, Reason::Uniform)
    );
}

#[test]
fn what_a_receiver_of_version_1_reads_of_state_stored_bit_age_and_debounce_is_right() {
    for (state, code) in STATES {
        let bytes = GapStatus { state, ..status() }.to_bytes();
        // The places of version 1.
        assert_eq!(bytes[1] >> 4, 3, "age");
        assert_eq!((bytes[2] & 7, bytes[2] >> 3 & 1), (code, 1));
        assert_eq!(bytes[7], 127);
        // Its score is at most that of the largest reason, 0.32, and therefore never an alarm.
        assert!(
            REASONS
                .iter()
                .all(|&(_, reason)| f64::from(reason) * SCORE_STEP < 0.33)
        );
    }
}

#[test]
fn clear_request_has_the_bytes_computed_by_hand() {
    let mut bytes = [0, 0, 0xA5, 0, 0, 0, 0, 0];
    assert_eq!(ClearRequest.to_bytes(), bytes);
    assert_eq!(ClearRequest::from_bytes(&bytes), Ok(ClearRequest));
    bytes[2] = 0xA4;
    let refused = ClearRequest::from_bytes(&bytes).unwrap_err();
    assert_eq!((refused.signal, refused.code), ("ClearCode", 0xA4));
}

#[test]
fn every_state_and_reason_has_its_code_and_comes_back() {
    for (state, code) in STATES {
        let bytes = GapStatus { state, ..status() }.to_bytes();
        assert_eq!(bytes[2] & 7, code);
        assert_eq!(GapStatus::from_bytes(&bytes).unwrap().state, state);
    }
    for (reason, code) in REASONS {
        let bytes = GapStatus { reason, ..status() }.to_bytes();
        assert_eq!(bytes[3], code);
        assert_eq!(GapStatus::from_bytes(&bytes).unwrap().reason, reason);
    }
}

#[test]
fn every_cause_has_its_code_and_comes_back() {
    assert_eq!(CAUSES.map(|(cause, _)| cause), Cause::ALL);
    for (cause, code) in CAUSES {
        let cause = Some(cause);
        let bytes = GapStatus { cause, ..status() }.to_bytes();
        assert_eq!(bytes[2] >> 4, code);
        assert_eq!(GapStatus::from_bytes(&bytes).unwrap().cause, cause);
    }
}

#[test]
fn no_cause_is_none_while_the_road_is_ok_and_not_available_otherwise() {
    for (state, _) in STATES {
        let sent = GapStatus {
            state,
            cause: None,
            ..status()
        };
        let bytes = sent.to_bytes();
        let wanted = if state == AlarmState::Ok { 0 } else { 15 };
        assert_eq!(bytes[2] >> 4, wanted, "{state:?}");
        assert_eq!(GapStatus::from_bytes(&bytes), Ok(sent));
    }
}

#[test]
fn codes_without_a_meaning_are_refused() {
    let with_byte_2 = |byte| GapStatus::from_bytes(&[0, 0, byte, 0, 0, 0, 0, 0]);
    for code in [6, 7] {
        let refused = with_byte_2(code).unwrap_err();
        assert_eq!((refused.signal, refused.code), ("State", code));
    }
    for code in [13, 14] {
        let refused = with_byte_2(code << 4).unwrap_err();
        assert_eq!((refused.signal, refused.code), ("Cause", code));
    }
    for code in [17, 254, 255] {
        let refused = GapStatus::from_bytes(&[0, 0, 0, code, 0, 0, 0, 0]).unwrap_err();
        assert_eq!((refused.signal, refused.code), ("Reason", code));
    }
    for code in [201, 254] {
        let refused = GapStatus::from_bytes(&[0, 0, 0, 0, 0, 0, code, 0]).unwrap_err();
        assert_eq!((refused.signal, refused.code), ("Lanes", code));
    }
    let refused = GapHealth::from_bytes(&[0, 0, 0, 0, 0, 0, 0, 201]).unwrap_err();
    assert_eq!((refused.signal, refused.code), ("CauseProbability", 201));
    let refused = GapHealth::from_bytes(&[0, 0, 0, 255, 0, 0, 0, 0]).unwrap_err();
    assert_eq!((refused.signal, refused.code), ("DroppedFrames", 255));
    let refused = GapHealth::from_bytes(&[0, 0xE0, 0, 0, 0, 0, 0, 0]).unwrap_err();
    assert_eq!((refused.signal, refused.code), ("BusState", 7));
    let refused = GapHealth::from_bytes(&[0, 0, 0, 0, 0, 0, 201, 0]).unwrap_err();
    assert_eq!((refused.signal, refused.code), ("WindowFill", 201));
}

#[test]
fn every_bus_state_has_its_code() {
    for (bus_state, code) in [
        (BusState::Unknown, 0),
        (BusState::Active, 1),
        (BusState::Warning, 2),
        (BusState::Passive, 3),
        (BusState::Off, 4),
    ] {
        let sent = GapHealth {
            strict: false,
            bus_state,
            ..health()
        };
        let bytes = sent.to_bytes();
        assert_eq!(bytes[1], code << 5);
        assert_eq!(GapHealth::from_bytes(&bytes).unwrap().bus_state, bus_state);
    }
}

#[test]
fn numbers_out_of_range_saturate() {
    let score = |value| steps(Some(value), SCORE_STEP, LARGEST);
    assert_eq!(score(f64::NAN), 255);
    assert_eq!(score(f64::INFINITY), 254);
    assert_eq!(score(f64::NEG_INFINITY), 0);
    assert_eq!(score(-0.5), 0);
    assert_eq!(score(5.1), 254);
    assert_eq!(score(0.06), 3);
    assert_eq!(steps(None, SCORE_STEP, LARGEST), 255);

    let full = GapHealth {
        dropped_frames: 255,
        window_fill: Some(1.5),
        frame_rate_hz: Some(1e9),
        ..health()
    };
    assert_eq!(full.to_bytes()[2..4], [254, 254]);
    assert_eq!(full.to_bytes()[6], 200);
    let beyond = GapStatus {
        change: Some(f64::INFINITY),
        lanes: Some(1.5),
        ..status()
    };
    assert_eq!(beyond.to_bytes()[5..7], [254, 200]);
    let unknown = GapStatus {
        change: None,
        lanes: Some(f64::NAN),
        ..status()
    };
    assert_eq!(unknown.to_bytes()[5..7], [255, 255]);
}

#[test]
fn times_are_rounded_up_and_saturate() {
    let age = |ms| {
        let time = Some(Duration::from_millis(ms));
        steps_of_time(time, FRAME_AGE_STEP, LARGEST_AGE, AGE_NOT_AVAILABLE)
    };
    assert_eq!([age(0), age(1), age(100), age(101)], [0, 1, 1, 2]);
    assert_eq!([age(1400), age(1401), age(90_000)], [14, 14, 14]);
    let latency = |time| steps_of_time(time, LATENCY_STEP, LARGEST, NOT_AVAILABLE);
    assert_eq!(latency(Some(Duration::from_millis(3))), 2);
    assert_eq!(latency(Some(Duration::MAX)), 254);
    assert_eq!(latency(None), 255);
}

#[test]
fn steps_and_codes_are_those_of_the_dbc() {
    let read = |raw: [u8; 8]| {
        (
            generated::GapStatus::try_from(raw.as_slice()).unwrap(),
            generated::GapHealth::try_from(raw.as_slice()).unwrap(),
        )
    };
    let (status, health) = read([0, 0xF0, 255, 255, 255, 255, 255, 255]);
    assert_eq!(
        status.frame_age(),
        generated::GapStatusFrameAge::NotAvailable
    );
    assert_eq!(status.gap(), generated::GapStatusGap::NotAvailable);
    assert_eq!(status.cause(), generated::GapStatusCause::NotAvailable);
    assert_eq!(status.reason(), generated::GapStatusReason::NotAvailable);
    assert_eq!(status.change(), generated::GapStatusChange::NotAvailable);
    assert_eq!(status.lanes(), generated::GapStatusLanes::NotAvailable);
    assert_eq!(
        health.frame_rate(),
        generated::GapHealthFrameRate::NotAvailable
    );
    assert_eq!(
        health.dropped_frames(),
        generated::GapHealthDroppedFrames::NotAvailable
    );
    assert_eq!(
        health.latency_p50(),
        generated::GapHealthLatencyP50::NotAvailable
    );
    assert_eq!(
        health.latency_p99(),
        generated::GapHealthLatencyP99::NotAvailable
    );
    assert_eq!(
        health.window_fill(),
        generated::GapHealthWindowFill::NotAvailable
    );
    assert_eq!(
        health.cause_probability(),
        generated::GapHealthCauseProbability::NotAvailable
    );

    let close = |physical: f32, ours: f64| assert!((f64::from(physical) - ours).abs() < 1e-5);
    let (status, health) = read([0, 0xE0, 200, 200, 200, 200, 200, 200]);
    match status.frame_age() {
        generated::GapStatusFrameAge::_Other(ms) => assert_eq!(ms, 1400),
        other => panic!("{other:?}"),
    }
    match status.gap() {
        generated::GapStatusGap::_Other(gap) => close(gap, 200.0 * SCORE_STEP),
        other => panic!("{other:?}"),
    }
    match health.frame_rate() {
        generated::GapHealthFrameRate::_Other(hz) => close(hz, 200.0 * FRAME_RATE_STEP_HZ),
        other => panic!("{other:?}"),
    }
    match health.latency_p99() {
        generated::GapHealthLatencyP99::_Other(ms) => assert_eq!(ms, 400),
        other => panic!("{other:?}"),
    }
    match health.window_fill() {
        // It is per cent in the DBC and a share here.
        generated::GapHealthWindowFill::_Other(percent) => {
            close(percent, 200.0 * SHARE_STEP * 100.0);
        }
        other => panic!("{other:?}"),
    }
    match health.cause_probability() {
        generated::GapHealthCauseProbability::_Other(percent) => {
            close(percent, 200.0 * SHARE_STEP * 100.0);
        }
        other => panic!("{other:?}"),
    }
    match status.change() {
        generated::GapStatusChange::_Other(change) => close(change, 200.0 * SCORE_STEP),
        other => panic!("{other:?}"),
    }
    match status.lanes() {
        generated::GapStatusLanes::_Other(percent) => close(percent, 200.0 * SHARE_STEP * 100.0),
        other => panic!("{other:?}"),
    }
}

proptest! {
    #[test]
    fn any_status_is_packed_and_comes_back_within_half_a_step(
        (state, _) in proptest::sample::select(&STATES),
        (reason, _) in proptest::sample::select(&REASONS),
        gap_stored: bool,
        gap in proptest::option::of(proptest::num::f64::ANY),
        cause in proptest::option::of(proptest::sample::select(&Cause::ALL)),
        change in proptest::option::of(0.0..5.08),
        lanes in proptest::option::of(0.0..=1.0),
        fault_detection_counter: i8,
        age_ms in proptest::option::of(0u64..3000),
    ) {
        let sent = GapStatus {
            state,
            reason,
            gap_stored,
            cause,
            gap,
            change,
            lanes,
            fault_detection_counter,
            frame_age: age_ms.map(Duration::from_millis),
        };
        let bytes = sent.to_bytes();
        prop_assert_eq!(bytes[0], 0);
        prop_assert_eq!(bytes[1] & 0x0F, 0);
        let read = GapStatus::from_bytes(&bytes).unwrap();
        prop_assert_eq!(read.state, state);
        prop_assert_eq!(read.reason, reason);
        prop_assert_eq!(read.gap_stored, gap_stored);
        prop_assert_eq!(read.fault_detection_counter, fault_detection_counter);
        prop_assert_eq!(read.frame_age.is_some(), sent.frame_age.is_some());
        prop_assert_eq!(read.gap.is_some(), gap.is_some_and(|s| !s.is_nan()));
        prop_assert_eq!(read.cause, cause);
        for (read, sent, step) in [(read.change, change, SCORE_STEP), (read.lanes, lanes, SHARE_STEP)] {
            prop_assert_eq!(read.is_some(), sent.is_some());
            if let (Some(read), Some(sent)) = (read, sent) {
                prop_assert!((read - sent).abs() <= step / 2.0 + 1e-9);
            }
        }
        prop_assert_eq!(read.to_bytes(), bytes);
    }

    #[test]
    fn any_bytes_are_read_or_refused_and_never_panic(bytes: [u8; 8]) {
        let _ = GapStatus::from_bytes(&bytes);
        let _ = GapHealth::from_bytes(&bytes);
        let _ = GapVersion::from_bytes(&bytes);
        let _ = ClearRequest::from_bytes(&bytes);
    }
}
