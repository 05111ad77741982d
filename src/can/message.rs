//! The messages as Rust values, to and from the 8 bytes of their frames.
//!
//! It defines the meaning of the signals: which code a state has, how a number is rounded, and what means not
//! available. Codes, start bits and lengths come from `gapwatch.dbc` through the generated code. Counter and CRC are
//! not handled here: both are left 0 and written when a frame is sent, and bytes must be checked ([`super::e2e`])
//! before they are read here.

use std::time::Duration;

use thiserror::Error;

use super::BusState;
use super::generated::{
    self, GapClearClearCode as ClearCode, GapHealthBusState as BusCode,
    GapStatusCause as CauseCode, GapStatusReason as ReasonCode, GapStatusState as StateCode,
};
use crate::monitor::alarm::{AlarmState, Reason};
use crate::reference::cause::Cause;

/// Version of `gapwatch.dbc`: that of the frames that are written and read here.
pub const DBC_VERSION: u8 = 3;

// The generated accessors of scaled signals round towards zero and give "not available" the physical value 255, so the
// raw accessors are used and the factors of the DBC are repeated here; a test checks that they agree.
const SCORE_STEP: f64 = 0.02;
const FRAME_RATE_STEP_HZ: f64 = 0.25;
const SHARE_STEP: f64 = 0.005;
const FRAME_AGE_STEP: Duration = Duration::from_millis(100);
const LATENCY_STEP: Duration = Duration::from_millis(2);

/// Code for not available in a signal of 8 bits.
const NOT_AVAILABLE: u8 = 255;
/// Largest available value in a signal of 8 bits.
const LARGEST: u8 = 254;
/// Code for not available in the frame age, 4 bits.
const AGE_NOT_AVAILABLE: u8 = 15;
/// Largest frame age, 4 bits.
const LARGEST_AGE: u8 = 14;
/// Code of a share of 1: a full window, all lanes, certainty.
const WHOLE: u8 = 200;
/// Largest number of the first part of the program's version, 4 bits.
const LARGEST_MAJOR: u8 = 15;

/// The bytes hold a code that has no meaning.
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

/// What the monitor reports of the road: message `GapStatus`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GapStatus {
    /// The state that is reported to the car.
    pub state: AlarmState,
    /// The reason for the state.
    pub reason: Reason,
    /// Whether there was a gap since the last clear request.
    pub gap_stored: bool,
    /// What most likely causes the evidence. `None` is sent as "none" in the state `Ok`, in which there is nothing to
    /// explain, and as not available in every other state.
    pub cause: Option<Cause>,
    /// How far the road is from the nearest nominal domain, 1 = alarm threshold; on the bus 0 to 5.08 in steps of 0.02.
    /// Below 0 is sent as 0, infinity as 5.08, NaN and `None` as not available.
    pub gap: Option<f64>,
    /// How far the road differs from its own past, on the scale of `gap`.
    pub change: Option<f64>,
    /// Forecast of the share of lanes that the model loses, 0 to 1; on the bus in steps of 0.005.
    pub lanes: Option<f64>,
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
        message.set_cause_raw_val(cause_code(self.cause, self.state).into());
        message.set_reason_raw_val(reason_code(self.reason).into());
        message.set_gap_raw_val(steps(self.gap, SCORE_STEP, LARGEST));
        message.set_change_raw_val(steps(self.change, SCORE_STEP, LARGEST));
        message.set_lanes_raw_val(steps(self.lanes, SHARE_STEP, WHOLE));
        message.set_fault_detection_counter_raw_val(self.fault_detection_counter);
        *message.raw()
    }

    /// Reads the 8 bytes of a checked frame.
    ///
    /// # Errors
    /// [`MessageError`] when state, cause, reason or lanes hold a code without a meaning.
    pub fn from_bytes(data: &[u8; 8]) -> Result<Self, MessageError> {
        let message =
            generated::GapStatus::try_from(data.as_slice()).expect("a message of 8 bytes");
        let unknown = |signal, code| MessageError {
            message: "GapStatus",
            signal,
            code,
        };
        let lanes = message.lanes_raw_val();
        Ok(Self {
            state: state_of(message.state())
                .ok_or_else(|| unknown("State", message.state_raw_val()))?,
            reason: reason_of(message.reason())
                .ok_or_else(|| unknown("Reason", message.reason_raw_val()))?,
            gap_stored: message.gap_stored(),
            cause: cause_of(message.cause())
                .ok_or_else(|| unknown("Cause", message.cause_raw_val()))?,
            gap: number(message.gap_raw_val(), SCORE_STEP),
            change: number(message.change_raw_val(), SCORE_STEP),
            lanes: share(lanes).ok_or_else(|| unknown("Lanes", lanes))?,
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
    /// Whether the reference holds only simulation, so that any real road is a gap.
    pub strict: bool,
    /// State of our controller on the bus.
    pub bus_state: BusState,
    /// Judged frames a second; on the bus 0 to 63.5 Hz in steps of 0.25 Hz.
    pub frame_rate_hz: Option<f64>,
    /// Frames dropped since the start; on the bus at most 254.
    pub dropped_frames: u64,
    /// Median time from frame to verdict; on the bus 0 to 508 ms in steps of 2 ms, rounded up.
    pub latency_p50: Option<Duration>,
    /// 99th percentile of the time from frame to verdict, on the scale of `latency_p50`.
    pub latency_p99: Option<Duration>,
    /// How full the window of judged frames is, 0 to 1; on the bus in steps of 0.005.
    pub window_fill: Option<f64>,
    /// How likely the cause in `GapStatus` is, 0 to 1; on the bus in steps of 0.005.
    pub cause_probability: Option<f64>,
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
        message.set_window_fill_raw_val(steps(self.window_fill, SHARE_STEP, WHOLE));
        message.set_cause_probability_raw_val(steps(self.cause_probability, SHARE_STEP, WHOLE));
        *message.raw()
    }

    /// Reads the 8 bytes of a checked frame. The value 254 of `dropped_frames` may mean more.
    ///
    /// # Errors
    /// [`MessageError`] if the window is more than full, if a cause is more than certain, if the bus state has no
    /// meaning, or if the dropped frames are not available, which gapwatch never sends.
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
        let probability = message.cause_probability_raw_val();
        Ok(Self {
            strict: message.strict(),
            bus_state: bus_of(message.bus_state())
                .ok_or_else(|| unknown("BusState", message.bus_state_raw_val()))?,
            frame_rate_hz: number(message.frame_rate_raw_val(), FRAME_RATE_STEP_HZ),
            dropped_frames: dropped.into(),
            latency_p50: time(message.latency_p50_raw_val(), LATENCY_STEP, NOT_AVAILABLE),
            latency_p99: time(message.latency_p99_raw_val(), LATENCY_STEP, NOT_AVAILABLE),
            window_fill: share(window_fill).ok_or_else(|| unknown("WindowFill", window_fill))?,
            cause_probability: share(probability)
                .ok_or_else(|| unknown("CauseProbability", probability))?,
        })
    }
}

/// Which version of the DBC the frames follow, and which reference is in use: message `GapVersion`. Its layout is the
/// same in every version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GapVersion {
    /// First four bytes of the SHA-256 of the reference in use.
    pub reference_id: [u8; 4],
    /// First two numbers of the version of gapwatch; on the bus at most 15 and 255.
    pub program: [u8; 2],
}

impl GapVersion {
    /// That of this program with a reference ([`Reference::id`](crate::reference::Reference::id)).
    pub fn of_this_program(reference_id: [u8; 4]) -> Self {
        let part = |text: &str| text.parse().unwrap_or(u8::MAX);
        Self {
            reference_id,
            program: [
                part(env!("CARGO_PKG_VERSION_MAJOR")),
                part(env!("CARGO_PKG_VERSION_MINOR")),
            ],
        }
    }

    /// The 8 bytes of the frame, counter and CRC 0.
    pub fn to_bytes(&self) -> [u8; 8] {
        let mut message =
            generated::GapVersion::try_from([0; 8].as_slice()).expect("a message of 8 bytes");
        let [major, minor] = self.program;
        message.set_program_major_raw_val(major.min(LARGEST_MAJOR));
        message.set_program_minor_raw_val(minor);
        message.set_dbc_version_raw_val(DBC_VERSION);
        message.set_reference_id_raw_val(u32::from_be_bytes(self.reference_id));
        *message.raw()
    }

    /// Reads the 8 bytes of a checked frame.
    ///
    /// # Errors
    /// [`MessageError`] when the frames follow another version of the DBC than [`DBC_VERSION`]: then the other messages
    /// cannot be read here.
    pub fn from_bytes(data: &[u8; 8]) -> Result<Self, MessageError> {
        let message =
            generated::GapVersion::try_from(data.as_slice()).expect("a message of 8 bytes");
        let version = message.dbc_version_raw_val();
        if version != DBC_VERSION {
            return Err(MessageError {
                message: "GapVersion",
                signal: "DbcVersion",
                code: version,
            });
        }
        Ok(Self {
            reference_id: message.reference_id_raw_val().to_be_bytes(),
            program: [
                message.program_major_raw_val(),
                message.program_minor_raw_val(),
            ],
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
        Reason::Change => ReasonCode::Change,
        Reason::Lanes => ReasonCode::Lanes,
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
        ReasonCode::Change => Some(Reason::Change),
        ReasonCode::Lanes => Some(Reason::Lanes),
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

fn cause_code(cause: Option<Cause>, state: AlarmState) -> CauseCode {
    match cause {
        Some(Cause::Fog) => CauseCode::Fog,
        Some(Cause::Night) => CauseCode::Night,
        Some(Cause::Rain) => CauseCode::Rain,
        Some(Cause::Snow) => CauseCode::Snow,
        Some(Cause::Glare) => CauseCode::Glare,
        Some(Cause::Dirt) => CauseCode::Dirt,
        Some(Cause::Blur) => CauseCode::Blur,
        Some(Cause::Noise) => CauseCode::Noise,
        Some(Cause::Askew) => CauseCode::Askew,
        Some(Cause::Tunnel) => CauseCode::Tunnel,
        Some(Cause::AnotherRoad) => CauseCode::AnotherRoad,
        Some(Cause::Other) => CauseCode::Other,
        None if state == AlarmState::Ok => CauseCode::None,
        None => CauseCode::NotAvailable,
    }
}

/// The cause, if there is one; `None` for a code without a meaning.
#[allow(clippy::option_option)]
fn cause_of(code: CauseCode) -> Option<Option<Cause>> {
    match code {
        CauseCode::Fog => Some(Some(Cause::Fog)),
        CauseCode::Night => Some(Some(Cause::Night)),
        CauseCode::Rain => Some(Some(Cause::Rain)),
        CauseCode::Snow => Some(Some(Cause::Snow)),
        CauseCode::Glare => Some(Some(Cause::Glare)),
        CauseCode::Dirt => Some(Some(Cause::Dirt)),
        CauseCode::Blur => Some(Some(Cause::Blur)),
        CauseCode::Noise => Some(Some(Cause::Noise)),
        CauseCode::Askew => Some(Some(Cause::Askew)),
        CauseCode::Tunnel => Some(Some(Cause::Tunnel)),
        CauseCode::AnotherRoad => Some(Some(Cause::AnotherRoad)),
        CauseCode::Other => Some(Some(Cause::Other)),
        CauseCode::None | CauseCode::NotAvailable => Some(None),
        CauseCode::_Other(_) => None,
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

/// A share of 1; `None` for a code without a meaning.
#[allow(clippy::option_option)]
fn share(steps: u8) -> Option<Option<f64>> {
    (steps <= WHOLE || steps == NOT_AVAILABLE).then(|| number(steps, SHARE_STEP))
}

fn number(steps: u8, step: f64) -> Option<f64> {
    (steps != NOT_AVAILABLE).then_some(f64::from(steps) * step)
}

/// Number of steps, rounded up, 0 to `largest`; `None` is `not_available`.
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
mod tests;
