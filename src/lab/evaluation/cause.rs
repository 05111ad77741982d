//! Which cause the monitor tells of an event whose cause is known, on drives that were not used for tuning.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::resampling::binomial_interval;
use super::scripts::{Script, Shown};
use crate::lab::scene::{Condition, ConditionKind, Look};
use crate::monitor::alarm::AlarmState;
use crate::monitor::judge::Verdict;
use crate::reference::cause::Cause;

/// Frames a second of the drives.
const FPS: f64 = 4.0;
/// Onset of a condition, seconds; it grows for 2 s before, after a past that is long enough for a change.
const CONDITION_S: f64 = 28.0;
/// Time from which on another look or road is seen, seconds.
const SPLICE_S: f64 = 40.0;
/// The cause is taken this long after the onset, or from the first verdict in `Gap` after that.
pub const AFTER_S: f64 = 3.0;
/// Length of a drive after the onset, seconds.
const REST_S: f64 = 10.0;
/// First seed of the drives, which are not used in any calibration of the shipped reference and in no training.
pub const FIRST_SEED: u64 = 60_001;
/// Distance of the seeds of the roads that are changed to.
const OTHER_SEEDS: u64 = 5_000;
/// Severity from which on a cause must be told right.
pub const SEVERE: u8 = 3;

/// Something with a known cause.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// A condition grows to a severity.
    Condition(ConditionKind, u8),
    /// The world changes its look, which no cause explains.
    Look(Look),
    /// A road of the same look follows.
    Road,
}

/// Which causes were told of an event.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ToldCauses {
    /// Kind of condition, look, or `another-road`.
    pub event: String,
    /// Severity of a condition, 2 to 5.
    pub severity: Option<u8>,
    /// The cause that is right.
    pub cause: Cause,
    /// Number of drives with the event.
    pub drives: u64,
    /// Drives by the cause that was told.
    pub told: BTreeMap<Cause, u64>,
    /// Drives without a cause, because they were neither in `Suspect` nor in `Gap`.
    pub untold: u64,
    /// Drives whose cause was told right.
    pub right: u64,
    /// Share of these among the drives of which a cause was told; `None` if there are none.
    pub right_share: Option<f64>,
    /// 95 % interval of the share (Wilson).
    pub interval: (f64, f64),
}

impl Event {
    /// Every condition with severities 2 to 5, another look and another road.
    pub fn all(nominal: Look) -> Vec<Self> {
        let conditions = ConditionKind::ALL
            .into_iter()
            .flat_map(|kind| (2..=5).map(move |severity| Self::Condition(kind, severity)));
        let other = [Look::Game, Look::Sim]
            .into_iter()
            .find(|&of| of != nominal);
        conditions
            .chain(other.map(Self::Look))
            .chain([Self::Road])
            .collect()
    }

    fn name(self) -> &'static str {
        match self {
            Self::Condition(kind, _) => kind.name(),
            Self::Look(look) => look.name(),
            Self::Road => Cause::AnotherRoad.name(),
        }
    }

    /// The cause that is right.
    fn cause(self) -> Cause {
        match self {
            Self::Look(_) => Cause::Other,
            // Kinds of condition have the names of causes.
            Self::Condition(..) | Self::Road => self.name().parse().unwrap_or(Cause::Other),
        }
    }

    fn onset_s(self) -> f64 {
        match self {
            Self::Condition(..) => CONDITION_S,
            Self::Look(_) | Self::Road => SPLICE_S,
        }
    }

    /// The event on the drive with this number; `stretch_m` is the mean length of the stretches of its road, metres, 0
    /// for a road of one kind.
    pub fn script(self, nominal: Look, stretch_m: u32, number: u64) -> Script {
        let drive = |look: Look, seed: u64, conditions: Vec<Condition>| Shown::Drive {
            look,
            seed,
            stretch_m,
            conditions,
        };
        let seed = FIRST_SEED + number;
        let parts = match self {
            Self::Condition(kind, severity) => {
                let condition = Condition {
                    kind,
                    severity: f32::from(severity),
                    span_s: Some((CONDITION_S, 10.0 * CONDITION_S)),
                };
                vec![(0.0, drive(nominal, seed, vec![condition]))]
            }
            Self::Look(look) => vec![
                (0.0, drive(nominal, seed, vec![])),
                (SPLICE_S, drive(look, seed, vec![])),
            ],
            Self::Road => vec![
                (0.0, drive(nominal, seed, vec![])),
                (SPLICE_S, drive(nominal, seed + OTHER_SEEDS, vec![])),
            ],
        };
        Script {
            parts,
            seconds: self.onset_s() + REST_S,
            fps: FPS,
        }
    }

    /// The cause that is told of a drive with the event.
    fn told(self, drive: &[Verdict]) -> Option<Cause> {
        let at_s = self.onset_s() + AFTER_S;
        let mut later = drive.iter().filter(|of| of.at.as_secs_f64() >= at_s);
        let first = later.next()?;
        let first = first.cause.or_else(|| {
            later
                .find(|of| of.state == AlarmState::Gap && of.cause.is_some())
                .and_then(|of| of.cause)
        });
        first.map(|likely| likely.cause)
    }
}

/// Counts the causes that were told of an event.
pub fn told_causes(event: Event, drives: &[Vec<Verdict>]) -> ToldCauses {
    let mut told: BTreeMap<Cause, u64> = BTreeMap::new();
    for cause in drives.iter().filter_map(|drive| event.told(drive)) {
        *told.entry(cause).or_default() += 1;
    }
    let (all, of_told) = (drives.len() as u64, told.values().sum::<u64>());
    let right = told.get(&event.cause()).copied().unwrap_or(0);
    // Counts of drives are small.
    #[allow(clippy::cast_precision_loss)]
    let share = right as f64 / of_told.max(1) as f64;
    ToldCauses {
        event: event.name().to_owned(),
        severity: match event {
            Event::Condition(_, severity) => Some(severity),
            _ => None,
        },
        cause: event.cause(),
        drives: all,
        told,
        untold: all - of_told,
        right,
        right_share: (of_told > 0).then_some(share),
        interval: binomial_interval(right, of_told),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use std::time::Duration;

    use super::*;
    use crate::reference::cause::LikelyCause;

    /// Verdicts at 4 Hz: a state and a cause from a time on.
    fn drive(from_s: f64, state: AlarmState, cause: Option<Cause>) -> Vec<Verdict> {
        let verdict = |number: u32| {
            let at_s = f64::from(number) / FPS;
            let cause = cause.map(|cause| LikelyCause {
                cause,
                probability: 0.9,
            });
            let seen = at_s >= from_s;
            Verdict {
                at: Duration::from_secs_f64(at_s),
                state: if seen { state } else { AlarmState::Ok },
                cause: cause.filter(|_| seen),
                ..Verdict::nothing_yet()
            }
        };
        (0..152).map(verdict).collect()
    }

    #[test]
    fn kinds_of_condition_are_causes() {
        for event in Event::all(Look::Sim) {
            let known = matches!(event, Event::Look(_)) == (event.cause() == Cause::Other);
            assert!(known, "{event:?}");
        }
        assert_eq!(Event::Road.cause(), Cause::AnotherRoad);
    }

    #[test]
    fn told_late_wrong_and_untold_are_counted_by_hand() {
        let fog = Event::Condition(ConditionKind::Fog, 4);
        let drives = [
            drive(29.0, AlarmState::Gap, Some(Cause::Fog)),
            drive(29.0, AlarmState::Suspect, Some(Cause::Fog)),
            // Found after 3 s: only Gap counts.
            drive(33.0, AlarmState::Gap, Some(Cause::Rain)),
            drive(33.0, AlarmState::Suspect, Some(Cause::Fog)),
            drive(60.0, AlarmState::Gap, Some(Cause::Fog)),
        ];
        let of = told_causes(fog, &drives);
        assert_eq!((of.drives, of.right, of.untold), (5, 2, 2));
        assert_eq!(of.told[&Cause::Rain], 1);
        assert_eq!(of.right_share, Some(2.0 / 3.0));
        assert_eq!((of.event.as_str(), of.severity), ("fog", Some(4)));
        let none = told_causes(fog, &drives[4..]);
        assert_eq!((none.right_share, none.untold), (None, 1));
    }
}
