//! Evidence over time → the state that is reported to the car.
//!
//! ```text
//!            verdict for one window                     score >= 1
//!   Init ------------------------------> Ok <--------------------------> Suspect
//!                                        ^       counter back at 0          |
//!                                        |                                  | counter reaches 127
//!                                        +-------------- Gap <--------------+
//!                                        counter back at 0
//!
//!   any --- no verdict for 500 ms ---> Unavailable, or SensorFault when the picture itself is at fault
//!   Unavailable, SensorFault --- a verdict ---> where the counter says: Gap, Suspect or Ok
//! ```
//!
//! The fault detection counter follows AUTOSAR's diagnostic event manager (Dem, counter-based debouncing with jump-up),
//! but moves with elapsed time, so that the reaction does not depend on the frame rate. "Cannot judge" is never
//! reported as "no gap": while nothing can be judged, the counter does not move, and after 500 ms the state says so.
//! Suspicion from before an interruption (`continuity`) does not count after it. A gap continues to count until the
//! road is seen to be nominal again.

use std::time::Duration;

use crate::capture::undefined::Undefined;
use crate::monitor::continuity::Continuity;

/// Seconds of continuous evidence from 0 to the counter's upper end: a gap.
const UP_S: f64 = 1.0;
/// Seconds without evidence from the upper end back to 0, and again from 0 to the lower end.
const DOWN_S: f64 = 2.0;
/// Longest time by which one frame moves the counter: one frame is not enough for a gap.
const STEP_MAX: Duration = Duration::from_millis(500);

const COUNTER_MAX: f64 = 127.0;
const COUNTER_MIN: f64 = -128.0;

/// The state that is reported to the car.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AlarmState {
    /// Too little has been seen yet.
    Init,
    /// The road looks like the domain that the model knows.
    Ok,
    /// The road may have left the domain; the evidence is being debounced.
    Suspect,
    /// The road has left the domain.
    Gap,
    /// The camera shows something that no scene could produce.
    SensorFault,
    /// There is no verdict, and the camera is not the reason.
    Unavailable,
}

impl AlarmState {
    /// The name, which is the same everywhere.
    pub fn name(self) -> &'static str {
        match self {
            Self::Init => "Init",
            Self::Ok => "Ok",
            Self::Suspect => "Suspect",
            Self::Gap => "Gap",
            Self::SensorFault => "SensorFault",
            Self::Unavailable => "Unavailable",
        }
    }
}

/// The reason for the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// Nothing to explain.
    None,
    /// The first window is not full.
    Starting,
    /// The short window is beyond its threshold.
    Abrupt,
    /// The window is below its threshold, but has been near it for too long.
    Drift,
    /// The road differs from its own past.
    Change,
    /// The lane model is forecast to lose its lanes.
    Lanes,
    /// The picture is black.
    Black,
    /// The picture has one colour.
    Uniform,
    /// The picture is too small to judge.
    TooSmall,
    /// The picture cannot be read, or frames are out of order.
    Corrupt,
    /// No frame came for too long.
    Stale,
    /// The gap of the frame is undefined: undefined activations or histograms.
    Undefined,
    /// The picture has not changed by a single bit for too long.
    Frozen,
    /// Most of the lens is covered.
    Covered,
    /// The computer does not keep up: verdicts come too late.
    Lagging,
    /// The car is parked, so no frame is judged.
    Parked,
    /// The monitor is ending.
    Stopped,
}

impl Reason {
    /// The name used in journals and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Starting => "starting",
            Self::Abrupt => "abrupt",
            Self::Drift => "drift",
            Self::Change => "change",
            Self::Lanes => "lanes",
            Self::Black => "black",
            Self::Uniform => "uniform",
            Self::TooSmall => "too-small",
            Self::Corrupt => "corrupt",
            Self::Stale => "stale",
            Self::Undefined => "undefined",
            Self::Frozen => "frozen",
            Self::Covered => "covered",
            Self::Lagging => "lagging",
            Self::Parked => "parked",
            Self::Stopped => "stopped",
        }
    }

    /// Whether the camera is the cause.
    fn is_sensor_fault(self) -> bool {
        matches!(
            self,
            Self::Black | Self::Uniform | Self::Corrupt | Self::Frozen | Self::Covered
        )
    }
}

impl From<&Undefined> for Reason {
    fn from(why: &Undefined) -> Self {
        match why {
            Undefined::Black => Self::Black,
            Undefined::Uniform => Self::Uniform,
            Undefined::TooSmall { .. } => Self::TooSmall,
            Undefined::Corrupt(_) | Undefined::OutOfOrder { .. } => Self::Corrupt,
            Undefined::Frozen(_) => Self::Frozen,
            Undefined::Covered { .. } => Self::Covered,
            Undefined::Late(_) => Self::Lagging,
            _ => Self::Undefined,
        }
    }
}

/// What a frame contributes to the alarm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Judgement {
    /// A score: at least 1 is evidence of a gap.
    Score {
        /// 0 nominal, 1 alarm threshold.
        score: f64,
        /// The detector has seen frames for at least one window's length.
        settled: bool,
    },
    /// No window is beyond its threshold, but their sum over time is: evidence of a gap.
    Drift {
        /// As in `Score`.
        settled: bool,
    },
    /// The road is within a nominal domain, but differs from its own past: evidence of a gap.
    Change {
        /// As in `Score`.
        settled: bool,
    },
    /// The lane model is forecast to lose its lanes: evidence of a gap.
    Lanes {
        /// As in `Score`.
        settled: bool,
    },
    /// No verdict.
    Cannot(Reason),
}

/// Debounces scores into a state. Time comes from the caller.
#[derive(Clone, Debug)]
pub struct Alarm {
    state: AlarmState,
    reason: Reason,
    counter: f64,
    in_gap: bool,
    gap_stored: bool,
    settled: bool,
    /// When the last frame came, judged or not.
    last_frame: Option<Duration>,
    /// When the last frame was judged, or when the first frame came that was not judged.
    last_judged: Option<Duration>,
    /// Continuity of the frames that are judged.
    judged: Continuity,
    /// What the last evidence was.
    evidence: Reason,
}

impl Default for Alarm {
    fn default() -> Self {
        Self {
            state: AlarmState::Init,
            reason: Reason::Starting,
            counter: 0.0,
            in_gap: false,
            gap_stored: false,
            settled: false,
            last_frame: None,
            last_judged: None,
            judged: Continuity::default(),
            evidence: Reason::Abrupt,
        }
    }
}

impl Alarm {
    /// An alarm whose frames may come as slowly as one every `period`: silence is reported after one and a half
    /// periods, and after 500 ms at the earliest.
    pub fn with_frames_every(period: Duration) -> Self {
        Self {
            judged: Continuity::with_frames_every(period),
            ..Self::default()
        }
    }

    /// Longest time without a verdict before the state says so.
    pub fn patience(&self) -> Duration {
        self.judged.patience()
    }

    /// The current state.
    pub fn state(&self) -> AlarmState {
        self.state
    }

    /// The reason for the state.
    pub fn reason(&self) -> Reason {
        self.reason
    }

    /// Fault detection counter, -128 (long without evidence) to 127 (gap).
    #[allow(clippy::cast_possible_truncation)]
    pub fn fault_detection_counter(&self) -> i8 {
        self.counter.clamp(COUNTER_MIN, COUNTER_MAX) as i8
    }

    /// Whether a gap was reported since the start, or since the bit was last cleared.
    pub fn gap_stored(&self) -> bool {
        self.gap_stored
    }

    /// Clears the stored bit, and returns whether it did. It is refused while the state is `Gap`, or would be `Gap` if
    /// the road could be seen.
    pub fn clear_stored(&mut self) -> bool {
        self.gap_stored &= self.in_gap;
        !self.gap_stored
    }

    /// Takes the judgement of a frame at time `now`, which never goes back, or the judgement `Stale` if there was no
    /// frame.
    pub fn step(&mut self, now: Duration, judgement: Judgement) {
        if judgement != Judgement::Cannot(Reason::Stale) {
            self.last_frame = Some(now);
        }
        match judgement {
            Judgement::Score { score, settled } => {
                self.judged(now, (score >= 1.0).then_some(Reason::Abrupt), settled);
            }
            Judgement::Drift { settled } => self.judged(now, Some(Reason::Drift), settled),
            Judgement::Change { settled } => self.judged(now, Some(Reason::Change), settled),
            Judgement::Lanes { settled } => self.judged(now, Some(Reason::Lanes), settled),
            Judgement::Cannot(reason) => self.not_judged(now, reason),
        }
    }

    /// No frame was judged until `now`, because the car is parked: silence counts from then on, and suspicion begins
    /// anew.
    pub fn rest(&mut self, now: Duration) {
        self.judged.interrupt();
        (self.state, self.reason) = (AlarmState::Unavailable, Reason::Parked);
        self.last_frame = Some(now);
        self.last_judged = Some(now);
    }

    fn judged(&mut self, now: Duration, found: Option<Reason>, settled: bool) {
        let evidence = found.is_some();
        self.evidence = found.unwrap_or(self.evidence);
        let since = self.judged.step(now);
        if since.is_none() && !self.in_gap {
            self.counter = self.counter.min(0.0);
        }
        let since_s = since.unwrap_or_default().min(STEP_MAX).as_secs_f64();
        self.last_judged = Some(now);
        self.settled |= settled;
        if !self.settled {
            (self.state, self.reason) = (AlarmState::Init, Reason::Starting);
            return;
        }
        self.counter = if evidence {
            (self.counter.max(0.0) + COUNTER_MAX * since_s / UP_S).min(COUNTER_MAX)
        } else {
            (self.counter - COUNTER_MAX * since_s / DOWN_S).max(COUNTER_MIN)
        };
        if self.counter >= COUNTER_MAX {
            (self.in_gap, self.gap_stored) = (true, true);
        } else if self.counter <= 0.0 {
            self.in_gap = false;
        }
        (self.state, self.reason) = if self.in_gap {
            (AlarmState::Gap, self.evidence)
        } else if evidence || self.counter > 0.0 {
            (AlarmState::Suspect, self.evidence)
        } else {
            (AlarmState::Ok, Reason::None)
        };
    }

    /// When the silence after the last frame becomes too long; `None` before the first frame.
    pub fn stale_at(&self) -> Option<Duration> {
        self.last_frame.map(|last| last + self.patience())
    }

    fn not_judged(&mut self, now: Duration, reason: Reason) {
        let since = *self.last_judged.get_or_insert(now);
        if now.saturating_sub(since) < self.patience() {
            return;
        }
        // Silence between slow frames does not yet mean that nothing can be seen: whether the frames are continuous is
        // known when the next one comes.
        if reason != Reason::Stale {
            self.judged.interrupt();
        }
        self.state = if reason.is_sensor_fault() {
            AlarmState::SensorFault
        } else {
            AlarmState::Unavailable
        };
        self.reason = reason;
    }
}

#[cfg(test)]
mod tests;
