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
const REASONS: [(Reason, u8); 15] = [
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
];

fn status() -> GapStatus {
    GapStatus {
        state: AlarmState::Gap,
        reason: Reason::Abrupt,
        gap_stored: true,
        score: Some(1.0),
        block_scores: [Some(0.02), Some(5.08), None],
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
        reference_id: 0xC3,
    }
}

#[test]
fn status_has_the_bytes_computed_by_hand() {
    // Age 3 in the high nibble; state 3 + stored 8 + reason 2 in the high nibble; 1.0 = 50.
    let bytes = [0, 0x30, 0x2B, 50, 1, 254, 255, 127];
    assert_eq!(status().to_bytes(), bytes);
    assert_eq!(GapStatus::from_bytes(&bytes), Ok(status()));
}

#[test]
fn health_has_the_bytes_computed_by_hand() {
    let bytes = [0, 0x10, 40, 3, 12, 255, 200, 0xC3];
    assert_eq!(health().to_bytes(), bytes);
    assert_eq!(GapHealth::from_bytes(&bytes), Ok(health()));
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
        assert_eq!(bytes[2] >> 4, code);
        assert_eq!(GapStatus::from_bytes(&bytes).unwrap().reason, reason);
    }
}

#[test]
fn codes_without_a_meaning_are_refused() {
    let with_byte_2 = |byte| GapStatus::from_bytes(&[0, 0, byte, 0, 0, 0, 0, 0]);
    for code in [6, 7] {
        let refused = with_byte_2(code).unwrap_err();
        assert_eq!((refused.signal, refused.code), ("State", code));
    }
    let refused = with_byte_2(15 << 4).unwrap_err();
    assert_eq!((refused.signal, refused.code), ("Reason", 15));
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
    assert_eq!(status.score(), generated::GapStatusScore::NotAvailable);
    assert_eq!(
        status.score_tap1(),
        generated::GapStatusScoreTap1::NotAvailable
    );
    assert_eq!(
        status.score_tap2(),
        generated::GapStatusScoreTap2::NotAvailable
    );
    assert_eq!(
        status.score_tap3(),
        generated::GapStatusScoreTap3::NotAvailable
    );
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

    let close = |physical: f32, ours: f64| assert!((f64::from(physical) - ours).abs() < 1e-5);
    let (status, health) = read([0, 0xE0, 200, 200, 200, 200, 200, 200]);
    match status.frame_age() {
        generated::GapStatusFrameAge::_Other(ms) => assert_eq!(ms, 1400),
        other => panic!("{other:?}"),
    }
    match status.score() {
        generated::GapStatusScore::_Other(score) => close(score, 200.0 * SCORE_STEP),
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
            close(percent, 200.0 * WINDOW_FILL_STEP * 100.0);
        }
        other => panic!("{other:?}"),
    }
}

proptest! {
    #[test]
    fn any_status_is_packed_and_comes_back_within_half_a_step(
        (state, _) in proptest::sample::select(&STATES),
        (reason, _) in proptest::sample::select(&REASONS),
        gap_stored: bool,
        score in proptest::option::of(proptest::num::f64::ANY),
        tap in proptest::option::of(0.0..5.08),
        fault_detection_counter: i8,
        age_ms in proptest::option::of(0u64..3000),
    ) {
        let sent = GapStatus {
            state,
            reason,
            gap_stored,
            score,
            block_scores: [tap, None, tap],
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
        prop_assert_eq!(read.score.is_some(), score.is_some_and(|s| !s.is_nan()));
        if let (Some(read), Some(sent)) = (read.block_scores[2], tap) {
            prop_assert!((read - sent).abs() <= SCORE_STEP / 2.0 + 1e-9);
        }
        prop_assert_eq!(read.to_bytes(), bytes);
    }

    #[test]
    fn any_bytes_are_read_or_refused_and_never_panic(bytes: [u8; 8]) {
        let _ = GapStatus::from_bytes(&bytes);
        let _ = GapHealth::from_bytes(&bytes);
        let _ = ClearRequest::from_bytes(&bytes);
    }
}
