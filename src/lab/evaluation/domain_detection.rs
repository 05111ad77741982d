//! How soon and how often the monitor enters `Gap` after an event that leaves the domain, on drives that were not used
//! for tuning.

use serde::{Deserialize, Serialize};

use super::resampling::binomial_interval;
use super::scripts::{Script, Shown};
use crate::calibration::DriveScores;
use crate::lab::scene::{Condition, ConditionKind, Look};
use crate::monitor::alarm::AlarmState;

/// Frames a second of the drives.
const FPS: f64 = 4.0;
/// Onset of an event, seconds: a condition has reached its severity, or another look or noise begins. Conditions grow
/// for 2 s before.
const ONSET_S: f64 = 5.0;
/// An event counts as found if `Gap` is entered at most this long after its onset.
pub const WITHIN_S: f64 = 2.0;
/// Length of the drives.
const SECONDS: f64 = ONSET_S + 3.0;
/// First seed of the drives, which are not used in any calibration, training or other evaluation.
pub const FIRST_SEED: u64 = 50_001;

/// Something that leaves the domain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// A condition grows to a severity.
    Condition(ConditionKind, u8),
    /// The world changes its look.
    Look(Look),
    /// The picture becomes random pixels.
    Noise,
}

impl Event {
    /// Every condition with severities 1 to 5, every look except the nominal one, and noise.
    pub fn all(nominal: Look) -> Vec<Self> {
        let conditions = ConditionKind::ALL
            .into_iter()
            .flat_map(|kind| (1..=5).map(move |severity| Self::Condition(kind, severity)));
        let looks = Look::ALL.into_iter().filter(|&look| look != nominal);
        conditions
            .chain(looks.map(Self::Look))
            .chain([Self::Noise])
            .collect()
    }

    fn name(self) -> &'static str {
        match self {
            Self::Condition(kind, _) => kind.name(),
            Self::Look(look) => look.name(),
            Self::Noise => "random",
        }
    }

    /// The event on the drive with this number.
    pub fn script(self, nominal: Look, number: u64) -> Script {
        let seed = FIRST_SEED + number;
        let drive = |look: Look, conditions: Vec<Condition>| Shown::Drive {
            look,
            seed,
            conditions,
        };
        let parts = match self {
            Self::Condition(kind, severity) => {
                let condition = Condition {
                    kind,
                    severity: f32::from(severity),
                    span_s: Some((ONSET_S, 10.0 * ONSET_S)),
                };
                vec![(0.0, drive(nominal, vec![condition]))]
            }
            Self::Look(look) => vec![
                (0.0, drive(nominal, vec![])),
                (ONSET_S, drive(look, vec![])),
            ],
            Self::Noise => vec![
                (0.0, drive(nominal, vec![])),
                (ONSET_S, Shown::Noise { seed }),
            ],
        };
        Script {
            parts,
            seconds: SECONDS,
            fps: FPS,
        }
    }

    /// Time from which on an entry counts, seconds.
    fn begins_s(self) -> f64 {
        match self {
            // The portal of a tunnel can be seen during the whole drive before it is reached.
            Self::Condition(ConditionKind::Tunnel, _) => 0.0,
            Self::Condition(..) => ONSET_S - crate::lab::scene::RAMP_S,
            Self::Look(_) | Self::Noise => ONSET_S,
        }
    }
}

/// How an event was found at one rate of false alarms.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Detection {
    /// The nominal look.
    pub nominal: String,
    /// Kind of condition, look, or `random`.
    pub event: String,
    /// Severity of a condition, 1 to 5.
    pub severity: Option<u8>,
    /// Entries into `Gap` an hour of nominal driving for which the thresholds are made.
    pub false_alarms_per_hour: f64,
    /// Number of drives with the event.
    pub drives: u64,
    /// Drives that entered `Gap` between its beginning and 2 s after its onset.
    pub found: u64,
    /// Share of these drives.
    pub found_share: f64,
    /// 95 % interval of the share (Wilson).
    pub interval: (f64, f64),
    /// Drives that were already in `Gap` when the event began.
    pub alarmed_before: u64,
    /// Drives that reported a fault of the sensor instead.
    pub sensor_fault: u64,
    /// All other drives.
    pub missed: u64,
    /// Median time from onset to `Gap` of the events found, seconds; negative if the condition was still growing.
    pub delay_median_s: Option<f64>,
    /// Longest time from onset to `Gap`.
    pub delay_max_s: Option<f64>,
}

enum Outcome {
    Before,
    Found(f64),
    SensorFault,
    Missed,
}

/// Judges the drives of one event at a rate for which the thresholds are `factor` times as far from their medians as
/// those of the scores.
pub fn detection(
    nominal: Look,
    event: Event,
    drives: &[&DriveScores],
    false_alarms_per_hour: f64,
    factor: f64,
) -> Detection {
    let (mut delays, mut before, mut faults, mut missed) = (Vec::new(), 0, 0, 0);
    for drive in drives {
        match outcome(event, drive, factor) {
            Outcome::Before => before += 1,
            Outcome::Found(delay_s) => delays.push(delay_s),
            Outcome::SensorFault => faults += 1,
            Outcome::Missed => missed += 1,
        }
    }
    delays.sort_by(f64::total_cmp);
    let (found, all) = (delays.len() as u64, drives.len() as u64);
    // Counts of drives are small.
    #[allow(clippy::cast_precision_loss)]
    let found_share = found as f64 / all.max(1) as f64;
    Detection {
        nominal: nominal.name().to_owned(),
        event: event.name().to_owned(),
        severity: match event {
            Event::Condition(_, severity) => Some(severity),
            _ => None,
        },
        false_alarms_per_hour,
        drives: all,
        found,
        found_share,
        interval: binomial_interval(found, all),
        alarmed_before: before,
        sensor_fault: faults,
        missed,
        delay_median_s: delays.get(delays.len() / 2).copied(),
        delay_max_s: delays.last().copied(),
    }
}

fn outcome(event: Event, drive: &DriveScores, factor: f64) -> Outcome {
    let begins_s = event.begins_s();
    let mut fault = false;
    for (at, state) in drive.states(factor) {
        let at_s = at.as_secs_f64();
        if at_s > ONSET_S + WITHIN_S {
            break;
        }
        match state {
            AlarmState::Gap if at_s < begins_s => return Outcome::Before,
            AlarmState::Gap => return Outcome::Found(at_s - ONSET_S),
            AlarmState::SensorFault => fault = true,
            _ => {}
        }
    }
    if fault {
        Outcome::SensorFault
    } else {
        Outcome::Missed
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use std::time::Duration;

    use super::*;
    use crate::monitor::alarm::Reason;

    /// Scores at 4 frames a second: 0.1 up to a time, then another score.
    fn drive(from_s: f64, score: Option<f64>) -> DriveScores {
        let mut drive = DriveScores::default();
        for i in 0..32_u32 {
            let at_s = f64::from(i) / FPS;
            let at = Duration::from_secs_f64(at_s);
            match score {
                Some(score) if at_s >= from_s => drive.add(at, score, true),
                None if at_s >= from_s => drive.add_unjudged(at, Reason::Black),
                _ => drive.add(at, 0.1, at_s >= 1.0),
            }
        }
        drive
    }

    #[test]
    fn found_missed_faults_and_alarms_before_are_told_apart() {
        let drives = [
            drive(5.0, Some(3.0)),
            drive(6.5, Some(3.0)),
            drive(1.0, Some(3.0)),
            drive(5.0, None),
            drive(9.0, Some(3.0)),
        ];
        let drives: Vec<&DriveScores> = drives.iter().collect();
        let found = detection(Look::Sim, Event::Noise, &drives, 1.0, 1.0);
        let counted = (
            found.found,
            found.alarmed_before,
            found.sensor_fault,
            found.missed,
        );
        // The second drive enters Gap 2.5 s after the onset, which is too late.
        assert_eq!(counted, (1, 1, 1, 2));
        assert!(
            (0.75..=1.25).contains(&found.delay_median_s.unwrap()),
            "{found:?}"
        );
        // Thresholds four times as far away are not reached.
        assert_eq!(
            detection(Look::Sim, Event::Noise, &drives, 1.0, 4.0).found,
            0
        );
    }
}
