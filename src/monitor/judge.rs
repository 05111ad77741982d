//! What was seen → what is known: the alarm, and the verdict on each frame or on a missing frame. Pure; time is an
//! argument.

use std::time::Duration;

use crate::capture::undefined::Undefined;
use crate::features::image_quality::ImageQuality;
use crate::model::TAPS_MAX;
use crate::monitor::alarm::{Alarm, AlarmState, Judgement, Reason};
use crate::monitor::detector::{BlockScore, Evidence};
use crate::monitor::warn::WarnOn;
use crate::reference::cause::LikelyCause;

/// What a frame adds to what was seen before.
#[derive(Clone, Debug, PartialEq)]
pub struct Sighting {
    /// Time of the frame.
    pub at: Duration,
    /// Number of the frame.
    pub sequence: u64,
    /// How good the picture was; `None` when the frame cannot be judged.
    pub quality: Option<ImageQuality>,
    /// What the window says about the road, or why nothing can be said.
    pub evidence: Result<Evidence, Undefined>,
}

impl Sighting {
    /// What the frame contributes to the alarm, if some answers raise it.
    pub fn judgement(&self, warn: WarnOn) -> Judgement {
        match &self.evidence {
            Ok(evidence) => evidence.judgement(warn),
            Err(why) => Judgement::Cannot(Reason::from(why)),
        }
    }
}

/// What is known after a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// Time of the frame.
    pub at: Duration,
    /// Number of the frame; `None` for a verdict without a frame.
    pub sequence: Option<u64>,
    /// The state that is reported to the car.
    pub state: AlarmState,
    /// The reason for the state.
    pub reason: Reason,
    /// Why this frame has no score.
    pub undefined: Option<Undefined>,
    /// The largest score of the answers that raise the warning: 0 nominal, 1 alarm threshold; `None` when none of them
    /// is known.
    pub score: Option<f64>,
    /// How far the road is from the nearest nominal domain: 0 nominal median, 1 alarm threshold; `None` when the frame
    /// cannot be judged.
    pub gap: Option<f64>,
    /// How far the road differs from its own past: 0 nominal median, 1 alarm threshold; `None` when this is not known.
    pub change: Option<f64>,
    /// Forecast of the share of lanes that the model loses, 0..1; `None` when there is no forecast.
    pub lanes: Option<f64>,
    /// What most likely causes the evidence, in `Suspect` and `Gap`; `None` when nothing is known of it.
    pub cause: Option<LikelyCause>,
    /// One entry for each tap; empty if the frame cannot be judged.
    pub blocks: heapless::Vec<BlockScore, TAPS_MAX>,
    /// How good the picture was; `None` when the frame cannot be judged.
    pub quality: Option<ImageQuality>,
    /// Frames in the detector's window; `None` when the frame cannot be judged.
    pub window_frames: Option<usize>,
    /// The nominal domain that is nearest to the window, by its index in the reference.
    pub nominal_domain: Option<usize>,
    /// How far scores have added up; 1 is a drift.
    pub drift: Option<f64>,
    /// Share of the detector's window that is filled, 0..1; `None` when the frame cannot be judged.
    pub window_fill: Option<f64>,
    /// Fault detection counter, -128..127.
    pub fault_detection_counter: i8,
    /// A gap was reported since the start.
    pub gap_stored: bool,
}

impl Verdict {
    /// Before the first frame.
    pub fn nothing_yet() -> Self {
        Self {
            at: Duration::ZERO,
            sequence: None,
            state: AlarmState::Init,
            reason: Reason::Starting,
            undefined: None,
            score: None,
            gap: None,
            change: None,
            lanes: None,
            cause: None,
            quality: None,
            blocks: heapless::Vec::new(),
            window_frames: None,
            nominal_domain: None,
            drift: None,
            window_fill: None,
            fault_detection_counter: 0,
            gap_stored: false,
        }
    }

    /// Nothing could be judged, whatever the cause is.
    pub fn is_unjudged(&self) -> bool {
        matches!(
            self.state,
            AlarmState::Unavailable | AlarmState::SensorFault
        )
    }
}

/// Judges what was seen.
#[derive(Clone, Debug, Default)]
pub struct Judge {
    alarm: Alarm,
    /// The answers that raise the warning.
    warn: WarnOn,
    /// What was told last in `Suspect` or `Gap`.
    cause: Option<LikelyCause>,
}

impl Judge {
    /// Frames may come as slowly as one every `period`: see [`Alarm::with_frames_every`].
    pub fn with_frames_every(period: Duration) -> Self {
        Self {
            alarm: Alarm::with_frames_every(period),
            ..Self::default()
        }
    }

    /// These answers raise the warning.
    #[must_use]
    pub fn warning_on(self, warn: WarnOn) -> Self {
        Self { warn, ..self }
    }

    /// What is known after a frame.
    pub fn judge(&mut self, seen: Sighting) -> Verdict {
        self.alarm.step(seen.at, seen.judgement(self.warn));
        let told = seen.evidence.as_ref().ok().and_then(|of| of.cause);
        self.keep_cause(told);
        let (evidence, undefined) = match seen.evidence {
            Ok(evidence) => (Some(evidence), None),
            Err(why) => (None, Some(why)),
        };
        let known = Verdict {
            sequence: Some(seen.sequence),
            undefined,
            quality: seen.quality,
            ..self.verdict(seen.at)
        };
        match evidence {
            None => known,
            Some(evidence) => Verdict {
                score: evidence.score_of(self.warn),
                gap: Some(evidence.gap),
                change: evidence.change,
                lanes: evidence.lanes,
                window_frames: Some(evidence.frames),
                nominal_domain: Some(evidence.component),
                drift: Some(evidence.drift),
                window_fill: Some(evidence.fill),
                blocks: evidence.blocks,
                ..known
            },
        }
    }

    /// The verdict on silence, if at `now` the last frame came too long ago. Its time is the moment at which the
    /// silence became too long. `None` before that moment, and after the silence has been reported.
    pub fn silence(&mut self, now: Duration) -> Option<Verdict> {
        let at = self
            .alarm
            .stale_at()
            .filter(|&at| at < now && self.alarm.state() != AlarmState::Unavailable)?;
        self.alarm.step(at, Judgement::Cannot(Reason::Stale));
        self.keep_cause(None);
        Some(Verdict {
            undefined: Some(Undefined::Silence),
            ..self.verdict(at)
        })
    }

    /// No frame was judged until `now`: see [`Alarm::rest`].
    pub fn rest(&mut self, now: Duration) {
        self.alarm.rest(now);
        self.keep_cause(None);
    }

    /// Keeps the cause that was told last while there is something to explain.
    fn keep_cause(&mut self, told: Option<LikelyCause>) {
        self.cause = match self.alarm.state() {
            AlarmState::Suspect | AlarmState::Gap => told.or(self.cause),
            _ => None,
        };
    }

    /// Clears the stored bit, and returns whether it did. It is refused while there is a gap.
    pub fn clear_stored(&mut self) -> bool {
        self.alarm.clear_stored()
    }

    /// The verdict of the alarm at the time `at`.
    fn verdict(&self, at: Duration) -> Verdict {
        Verdict {
            at,
            state: self.alarm.state(),
            reason: self.alarm.reason(),
            fault_detection_counter: self.alarm.fault_detection_counter(),
            gap_stored: self.alarm.gap_stored(),
            cause: self.cause,
            ..Verdict::nothing_yet()
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::reference::cause::Cause;

    /// A frame every 100 ms with a gap, and the cause that was told.
    fn seen(number: u32, gap: f64, cause: Option<Cause>) -> Sighting {
        let cause = cause.map(|cause| LikelyCause {
            cause,
            probability: 0.75,
        });
        Sighting {
            at: 100 * number * Duration::from_millis(1),
            sequence: number.into(),
            quality: None,
            evidence: Ok(Evidence {
                cause,
                ..Evidence::of_gap(gap)
            }),
        }
    }

    #[test]
    fn the_last_cause_is_kept_while_there_is_something_to_explain() {
        let mut judge = Judge::default();
        let cause = |verdict: &Verdict| verdict.cause.map(|likely| likely.cause);
        for number in 0..20 {
            assert_eq!(judge.judge(seen(number, 0.1, None)).cause, None);
        }
        let mut states = Vec::new();
        for number in 20..60 {
            let told = if number < 40 { Cause::Fog } else { Cause::Rain };
            // Every third frame tells nothing.
            let none = number % 3 == 1;
            let verdict = judge.judge(seen(number, 3.0, (!none).then_some(told)));
            states.push(verdict.state);
            let last = if number == 40 { Cause::Fog } else { told };
            assert_eq!(cause(&verdict), Some(last), "{number}");
        }
        assert!(states.contains(&AlarmState::Suspect) && states.contains(&AlarmState::Gap));
        // The alarm fades: nothing new is told, and the cause stays until there is no alarm.
        let mut verdict = judge.judge(seen(60, 0.1, None));
        let mut number = 61;
        while verdict.state != AlarmState::Ok {
            assert_eq!(cause(&verdict), Some(Cause::Rain), "{number}");
            verdict = judge.judge(seen(number, 0.1, None));
            number += 1;
        }
        assert_eq!(verdict.cause, None);
        // What was told before is not told of the next alarm.
        assert_eq!(judge.judge(seen(number, 3.0, None)).cause, None);
    }

    #[test]
    fn lost_lanes_are_a_gap_where_they_raise_the_warning() {
        let lost = |number: u32| Sighting {
            evidence: Ok(Evidence {
                lanes: Some(0.8),
                ..Evidence::of_gap(0.1)
            }),
            ..seen(number, 0.1, None)
        };
        let lanes = WarnOn {
            lanes: true,
            ..WarnOn::default()
        };
        let mut asked = Judge::default().warning_on(lanes);
        let mut not_asked = Judge::default();
        for number in 0..30 {
            asked.judge(lost(number));
            not_asked.judge(lost(number));
        }
        let found = asked.judge(lost(30));
        assert_eq!(
            (found.state, found.reason),
            (AlarmState::Gap, Reason::Lanes)
        );
        assert_eq!((found.gap, found.score), (Some(0.1), Some(1.6)));
        let calm = not_asked.judge(lost(30));
        assert_eq!((calm.state, calm.score), (AlarmState::Ok, Some(0.1)));
        assert_eq!(calm.lanes, Some(0.8));
    }

    #[test]
    fn silence_has_no_cause() {
        let mut judge = Judge::default();
        for number in 0..60 {
            judge.judge(seen(number, 3.0, Some(Cause::Dirt)));
        }
        let silence = judge.silence(Duration::from_secs(60)).unwrap();
        assert_eq!(
            (silence.state, silence.cause),
            (AlarmState::Unavailable, None)
        );
        assert_eq!(judge.judge(seen(601, 3.0, None)).cause, None);
    }
}
