//! The messages as Rust values, to and from the 8 bytes of their frames.
//!
//! Owns the meaning of the signals: which code a state has, how a number is rounded, what stands
//! for not available. Codes, start bits and lengths come from `gapwatch.dbc` through the generated
//! code. Refuses to know of counter and CRC: both are left 0 here and written when a frame is
//! sent, and bytes are to be checked ([`super::e2e`]) before they are read here.

use std::time::Duration;

use thiserror::Error;

use super::BusState;
use super::generated::{
    self, GapClearClearCode as ClearCode, GapHealthBusState as BusCode,
    GapStatusReason as ReasonCode, GapStatusState as StateCode,
};
use crate::monitor::alarm::{AlarmState, Reason};

// The generated accessors of scaled signals round towards zero and give "not available" the
// physical value 255, so the raw accessors are used and the factors of the DBC are repeated here;
// a test holds the two together.
const SCORE_STEP: f64 = 0.02;
const FRAME_RATE_STEP_HZ: f64 = 0.25;
const WINDOW_FILL_STEP: f64 = 0.005;
const FRAME_AGE_STEP: Duration = Duration::from_millis(100);
const LATENCY_STEP: Duration = Duration::from_millis(2);

/// Code for not available in a signal of 8 bits.
const NOT_AVAILABLE: u8 = 255;
/// Largest value in a signal of 8 bits.
const LARGEST: u8 = 254;
/// Code for not available in the frame age, 4 bits.
const AGE_NOT_AVAILABLE: u8 = 15;
/// Largest frame age, 4 bits.
const LARGEST_AGE: u8 = 14;
/// A full window.
const WINDOW_FULL: u8 = 200;

/// Bytes that hold a code without a meaning.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("{message}.{signal} holds the code {code}, which has no meaning")]
pub struct MessageError {
    /// Message of the DBC.
    pub message: &'static str,
    /// Signal of the DBC.
    pub signal: &'static str,
    /// Raw value.
    pub code: u8,
}

/// What the monitor says of the road: message `GapStatus`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GapStatus {
    /// What the car is told.
    pub state: AlarmState,
    /// Why.
    pub reason: Reason,
    /// Whether there was a gap since the last clear request.
    pub gap_stored: bool,
    /// Largest gap over the taps in use, 1 = alarm threshold; on the bus 0 to 5.08 in steps of
    /// 0.02. Below 0 is sent as 0, infinity as 5.08, NaN and `None` as not available.
    pub score: Option<f64>,
    /// Gap of the first, second and third tap, on the scale of `score`.
    pub block_scores: [Option<f64>; 3],
    /// Debounce after AUTOSAR Dem: 127 = failed, -128 = passed.
    pub fault_detection_counter: i8,
    /// Age of the last judged frame; on the bus 0 to 1.4 s in steps of 0.1 s, rounded up so that
    /// no frame looks younger than it is.
    pub frame_age: Option<Duration>,
}

impl GapStatus {
    /// The 8 bytes of the frame, counter and CRC 0. Never panics, whatever the numbers are.
    pub fn to_bytes(&self) -> [u8; 8] {
        let mut message =
            generated::GapStatus::try_from([0; 8].as_slice()).expect("a message of 8 bytes");
        message.set_frame_age_raw_val(steps_of_time(
            self.frame_age,
            FRAME_AGE_STEP,
            LARGEST_AGE,
            AGE_NOT_AVAILABLE,
        ));
        message.set_state_raw_val(state_code(self.state).into());
        message.set_gap_stored_raw_val(self.gap_stored.into());
        message.set_reason_raw_val(reason_code(self.reason).into());
        let [tap1, tap2, tap3] = self.block_scores;
        message.set_score_raw_val(steps(self.score, SCORE_STEP, LARGEST));
        message.set_score_tap1_raw_val(steps(tap1, SCORE_STEP, LARGEST));
        message.set_score_tap2_raw_val(steps(tap2, SCORE_STEP, LARGEST));
        message.set_score_tap3_raw_val(steps(tap3, SCORE_STEP, LARGEST));
        message.set_fault_detection_counter_raw_val(self.fault_detection_counter);
        *message.raw()
    }

    /// Reads the 8 bytes of a checked frame.
    ///
    /// # Errors
    /// [`MessageError`] when state or reason hold a code without a meaning.
    pub fn from_bytes(data: &[u8; 8]) -> Result<Self, MessageError> {
        let message =
            generated::GapStatus::try_from(data.as_slice()).expect("a message of 8 bytes");
        let unknown = |signal, code| MessageError {
            message: "GapStatus",
            signal,
            code,
        };
        Ok(Self {
            state: state_of(message.state())
                .ok_or_else(|| unknown("State", message.state_raw_val()))?,
            reason: reason_of(message.reason())
                .ok_or_else(|| unknown("Reason", message.reason_raw_val()))?,
            gap_stored: message.gap_stored(),
            score: number(message.score_raw_val(), SCORE_STEP),
            block_scores: [
                number(message.score_tap1_raw_val(), SCORE_STEP),
                number(message.score_tap2_raw_val(), SCORE_STEP),
                number(message.score_tap3_raw_val(), SCORE_STEP),
            ],
            fault_detection_counter: message.fault_detection_counter(),
            frame_age: time(
                message.frame_age_raw_val(),
                FRAME_AGE_STEP,
                AGE_NOT_AVAILABLE,
            ),
        })
    }
}

/// How well the monitor sees: message `GapHealth`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GapHealth {
    /// Whether the reference holds simulation alone, so that any real road is a gap.
    pub strict: bool,
    /// How our controller stands on the bus.
    pub bus_state: BusState,
    /// Judged frames a second; on the bus 0 to 63.5 Hz in steps of 0.25 Hz.
    pub frame_rate_hz: Option<f64>,
    /// Frames dropped since start; on the bus 254 at most.
    pub dropped_frames: u64,
    /// Median time from frame to verdict; on the bus 0 to 508 ms in steps of 2 ms, rounded up.
    pub latency_p50: Option<Duration>,
    /// 99th percentile of the time from frame to verdict, on the scale of `latency_p50`.
    pub latency_p99: Option<Duration>,
    /// How full the window of judged frames is, 0 to 1; on the bus in steps of 0.005.
    pub window_fill: Option<f64>,
    /// First byte of the SHA-256 of the reference in use.
    pub reference_id: u8,
}

impl GapHealth {
    /// The 8 bytes of the frame, counter and CRC 0. Never panics, whatever the numbers are.
    pub fn to_bytes(&self) -> [u8; 8] {
        let mut message =
            generated::GapHealth::try_from([0; 8].as_slice()).expect("a message of 8 bytes");
        let latency = |time| steps_of_time(time, LATENCY_STEP, LARGEST, NOT_AVAILABLE);
        let dropped = u8::try_from(self.dropped_frames).unwrap_or(LARGEST);
        message.set_strict_raw_val(self.strict.into());
        message.set_bus_state_raw_val(bus_code(self.bus_state).into());
        message.set_frame_rate_raw_val(steps(self.frame_rate_hz, FRAME_RATE_STEP_HZ, LARGEST));
        message.set_dropped_frames_raw_val(dropped.min(LARGEST));
        message.set_latency_p50_raw_val(latency(self.latency_p50));
        message.set_latency_p99_raw_val(latency(self.latency_p99));
        message.set_window_fill_raw_val(steps(self.window_fill, WINDOW_FILL_STEP, WINDOW_FULL));
        message.set_reference_id_raw_val(self.reference_id);
        *message.raw()
    }

    /// Reads the 8 bytes of a checked frame. The value 254 of `dropped_frames` may mean more.
    ///
    /// # Errors
    /// [`MessageError`] when the window is more than full, the bus state has no meaning, or the
    /// dropped frames are not available, which gapwatch never sends.
    pub fn from_bytes(data: &[u8; 8]) -> Result<Self, MessageError> {
        let message =
            generated::GapHealth::try_from(data.as_slice()).expect("a message of 8 bytes");
        let unknown = |signal, code| MessageError {
            message: "GapHealth",
            signal,
            code,
        };
        let dropped = message.dropped_frames_raw_val();
        if dropped == NOT_AVAILABLE {
            return Err(unknown("DroppedFrames", dropped));
        }
        let window_fill = message.window_fill_raw_val();
        if window_fill > WINDOW_FULL && window_fill != NOT_AVAILABLE {
            return Err(unknown("WindowFill", window_fill));
        }
        Ok(Self {
            strict: message.strict(),
            bus_state: bus_of(message.bus_state())
                .ok_or_else(|| unknown("BusState", message.bus_state_raw_val()))?,
            frame_rate_hz: number(message.frame_rate_raw_val(), FRAME_RATE_STEP_HZ),
            dropped_frames: dropped.into(),
            latency_p50: time(message.latency_p50_raw_val(), LATENCY_STEP, NOT_AVAILABLE),
            latency_p99: time(message.latency_p99_raw_val(), LATENCY_STEP, NOT_AVAILABLE),
            window_fill: number(window_fill, WINDOW_FILL_STEP),
            reference_id: message.reference_id(),
        })
    }
}

/// Asks to clear the stored bit: message `GapClear`, with the clear code 0xA5.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClearRequest;

impl ClearRequest {
    /// The 8 bytes of the frame, counter and CRC 0.
    pub fn to_bytes(&self) -> [u8; 8] {
        let mut message =
            generated::GapClear::try_from([0; 8].as_slice()).expect("a message of 8 bytes");
        message.set_clear_code_raw_val(ClearCode::ClearStored.into());
        *message.raw()
    }

    /// Reads the 8 bytes of a checked frame.
    ///
    /// # Errors
    /// [`MessageError`] for any other clear code.
    pub fn from_bytes(data: &[u8; 8]) -> Result<Self, MessageError> {
        let message = generated::GapClear::try_from(data.as_slice()).expect("a message of 8 bytes");
        match message.clear_code() {
            ClearCode::ClearStored => Ok(Self),
            ClearCode::_Other(code) => Err(MessageError {
                message: "GapClear",
                signal: "ClearCode",
                code,
            }),
        }
    }
}

fn state_code(state: AlarmState) -> StateCode {
    match state {
        AlarmState::Init => StateCode::Init,
        AlarmState::Ok => StateCode::Ok,
        AlarmState::Suspect => StateCode::Suspect,
        AlarmState::Gap => StateCode::Gap,
        AlarmState::SensorFault => StateCode::SensorFault,
        AlarmState::Unavailable => StateCode::Unavailable,
    }
}

fn state_of(code: StateCode) -> Option<AlarmState> {
    match code {
        StateCode::Init => Some(AlarmState::Init),
        StateCode::Ok => Some(AlarmState::Ok),
        StateCode::Suspect => Some(AlarmState::Suspect),
        StateCode::Gap => Some(AlarmState::Gap),
        StateCode::SensorFault => Some(AlarmState::SensorFault),
        StateCode::Unavailable => Some(AlarmState::Unavailable),
        StateCode::NotAvailable | StateCode::_Other(_) => None,
    }
}

fn reason_code(reason: Reason) -> ReasonCode {
    match reason {
        Reason::None => ReasonCode::None,
        Reason::Starting => ReasonCode::Starting,
        Reason::Abrupt => ReasonCode::Abrupt,
        Reason::Drift => ReasonCode::Drift,
        Reason::Black => ReasonCode::Black,
        Reason::Uniform => ReasonCode::Uniform,
        Reason::TooSmall => ReasonCode::TooSmall,
        Reason::Corrupt => ReasonCode::Corrupt,
        Reason::Stale => ReasonCode::Stale,
        Reason::Undefined => ReasonCode::Undefined,
        Reason::Frozen => ReasonCode::Frozen,
        Reason::Covered => ReasonCode::Covered,
        Reason::Lagging => ReasonCode::Lagging,
        Reason::Parked => ReasonCode::Parked,
        Reason::Stopped => ReasonCode::Stopped,
    }
}

fn reason_of(code: ReasonCode) -> Option<Reason> {
    match code {
        ReasonCode::None => Some(Reason::None),
        ReasonCode::Starting => Some(Reason::Starting),
        ReasonCode::Abrupt => Some(Reason::Abrupt),
        ReasonCode::Drift => Some(Reason::Drift),
        ReasonCode::Black => Some(Reason::Black),
        ReasonCode::Uniform => Some(Reason::Uniform),
        ReasonCode::TooSmall => Some(Reason::TooSmall),
        ReasonCode::Corrupt => Some(Reason::Corrupt),
        ReasonCode::Stale => Some(Reason::Stale),
        ReasonCode::Undefined => Some(Reason::Undefined),
        ReasonCode::Frozen => Some(Reason::Frozen),
        ReasonCode::Covered => Some(Reason::Covered),
        ReasonCode::Lagging => Some(Reason::Lagging),
        ReasonCode::Parked => Some(Reason::Parked),
        ReasonCode::Stopped => Some(Reason::Stopped),
        ReasonCode::NotAvailable | ReasonCode::_Other(_) => None,
    }
}

fn bus_code(state: BusState) -> BusCode {
    match state {
        BusState::Unknown => BusCode::Unknown,
        BusState::Active => BusCode::Active,
        BusState::Warning => BusCode::Warning,
        BusState::Passive => BusCode::Passive,
        BusState::Off => BusCode::Off,
    }
}

fn bus_of(code: BusCode) -> Option<BusState> {
    match code {
        BusCode::Unknown => Some(BusState::Unknown),
        BusCode::Active => Some(BusState::Active),
        BusCode::Warning => Some(BusState::Warning),
        BusCode::Passive => Some(BusState::Passive),
        BusCode::Off => Some(BusState::Off),
        BusCode::_Other(_) => None,
    }
}

/// Nearest number of steps, 0 to `largest`; NaN and `None` are not available.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
pub(super) fn steps(value: Option<f64>, step: f64, largest: u8) -> u8 {
    match value {
        Some(value) if !value.is_nan() => {
            (value / step).round().clamp(0.0, f64::from(largest)) as u8
        }
        _ => NOT_AVAILABLE,
    }
}

fn number(steps: u8, step: f64) -> Option<f64> {
    (steps != NOT_AVAILABLE).then_some(f64::from(steps) * step)
}

/// Number of steps begun, 0 to `largest`; `None` is `not_available`.
fn steps_of_time(time: Option<Duration>, step: Duration, largest: u8, not_available: u8) -> u8 {
    time.map_or(not_available, |time| {
        let begun = time.as_nanos().div_ceil(step.as_nanos());
        u8::try_from(begun).unwrap_or(largest).min(largest)
    })
}

fn time(steps: u8, step: Duration, not_available: u8) -> Option<Duration> {
    (steps != not_available).then_some(step * u32::from(steps))
}

#[cfg(test)]
mod tests {
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
            // Per cent in the DBC, a share here.
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
}
