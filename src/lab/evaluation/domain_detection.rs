//! How soon and how often the monitor enters `Gap` after an event that leaves the domain, on drives that were not used
//! for tuning.

use serde::{Deserialize, Serialize};

use super::resampling::binomial_interval;
use super::scripts::{Script, Shown};
use crate::calibration::DriveScores;
use crate::lab::scene::{Condition, ConditionKind, Look};
use crate::monitor::alarm::AlarmState;
use crate::reference::EvidenceKind;

/// Frames a second of the drives.
pub const FPS: f64 = 4.0;
/// Onset of an event, seconds: a condition has reached its severity, or another look or noise begins. Conditions grow
/// for 2 s before. The road has a past of 40 s by then.
const ONSET_S: f64 = 42.0;
/// An event counts as found soon if `Gap` is entered at most this long after its onset.
pub const WITHIN_S: f64 = 2.0;
/// Later times for which found events are counted too, seconds.
pub const LATER_S: [f64; 2] = [10.0, 30.0];
/// Time that is judged after the onset; a drive that begins under its condition is judged for the first of the later
/// times.
const AFTER_S: f64 = LATER_S[1] + 1.0;
/// First seed of the drives, which are not used in any calibration, training or other evaluation.
pub const FIRST_SEED: u64 = 50_001;

/// The drives on which events happen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Roads {
    /// The nominal look.
    pub nominal: Look,
    /// Mean length of the stretches of a road that changes, metres; 0 for roads of one kind.
    pub stretch_m: u32,
    /// The drive begins under the condition, so that the road has no other past.
    pub from_start: bool,
}

impl Roads {
    fn onset_s(self) -> f64 {
        if self.from_start { 0.0 } else { ONSET_S }
    }
}

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
    /// Every condition with severities 2 to 5, every look except the nominal one, and noise.
    pub fn all(nominal: Look) -> Vec<Self> {
        let conditions = ConditionKind::ALL
            .into_iter()
            .flat_map(|kind| (2..=5).map(move |severity| Self::Condition(kind, severity)));
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
    pub fn script(self, roads: Roads, number: u64) -> Script {
        let seed = FIRST_SEED + number;
        let Roads {
            nominal,
            stretch_m,
            from_start,
        } = roads;
        let drive = |look: Look, conditions: Vec<Condition>| Shown::Drive {
            look,
            seed,
            stretch_m,
            conditions,
        };
        let before = |event: Shown| match from_start {
            true => vec![(0.0, event)],
            false => vec![(0.0, drive(nominal, vec![])), (ONSET_S, event)],
        };
        let parts = match self {
            Self::Condition(kind, severity) => {
                let condition = Condition {
                    kind,
                    severity: f32::from(severity),
                    span_s: (!from_start).then_some((ONSET_S, 10.0 * ONSET_S)),
                };
                vec![(0.0, drive(nominal, vec![condition]))]
            }
            Self::Look(look) => before(drive(look, vec![])),
            Self::Noise => before(Shown::Noise { seed }),
        };
        Script {
            parts,
            seconds: if from_start {
                LATER_S[0] + 1.0
            } else {
                ONSET_S + AFTER_S
            },
            fps: FPS,
        }
    }

    /// Time from which on an entry counts, seconds.
    fn begins_s(self, roads: Roads) -> f64 {
        match self {
            _ if roads.from_start => 0.0,
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
    /// Mean length of the stretches of the roads, metres; 0 for roads of one kind.
    #[serde(default)]
    pub stretch_m: u32,
    /// The drives begin under the condition.
    #[serde(default)]
    pub from_start: bool,
    /// What the road is judged by: `windows` and changes, or `frames`.
    #[serde(default)]
    pub evidence: String,
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
    /// Drives that entered it at most 10 s and 30 s after its onset.
    #[serde(default)]
    pub found_later: [u64; 2],
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
    roads: Roads,
    event: Event,
    drives: &[&DriveScores],
    evidence: EvidenceKind,
    (false_alarms_per_hour, factor): (f64, f64),
) -> Detection {
    let (mut delays, mut before, mut faults, mut missed) = (Vec::new(), 0, 0, 0);
    for drive in drives {
        match outcome(roads, event, drive, factor) {
            Outcome::Before => before += 1,
            Outcome::Found(delay_s) => delays.push(delay_s),
            Outcome::SensorFault => faults += 1,
            Outcome::Missed => missed += 1,
        }
    }
    delays.sort_by(f64::total_cmp);
    let within = |limit_s: f64| delays.iter().filter(|&&delay_s| delay_s <= limit_s).count() as u64;
    let (found, all) = (within(WITHIN_S), drives.len() as u64);
    // Counts of drives are small.
    #[allow(clippy::cast_precision_loss)]
    let found_share = found as f64 / all.max(1) as f64;
    Detection {
        nominal: roads.nominal.name().to_owned(),
        stretch_m: roads.stretch_m,
        from_start: roads.from_start,
        evidence: evidence.to_string(),
        event: event.name().to_owned(),
        severity: match event {
            Event::Condition(_, severity) => Some(severity),
            _ => None,
        },
        false_alarms_per_hour,
        drives: all,
        found,
        found_later: LATER_S.map(within),
        found_share,
        interval: binomial_interval(found, all),
        alarmed_before: before,
        sensor_fault: faults,
        missed,
        delay_median_s: delays.get(delays.len() / 2).copied(),
        delay_max_s: delays.last().copied(),
    }
}

/// A drive that is in `Gap` when the event begins does not count as found.
fn outcome(roads: Roads, event: Event, drive: &DriveScores, factor: f64) -> Outcome {
    let begins_s = event.begins_s(roads);
    let (mut fault, mut in_gap) = (false, false);
    for (at, state) in drive.states(factor) {
        let at_s = at.as_secs_f64();
        if at_s < begins_s {
            in_gap = state == AlarmState::Gap;
            continue;
        }
        if in_gap {
            return Outcome::Before;
        }
        match state {
            AlarmState::Gap => return Outcome::Found(at_s - roads.onset_s()),
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

    const ROADS: Roads = Roads {
        nominal: Look::Sim,
        stretch_m: 0,
        from_start: false,
    };

    /// Scores at 4 frames a second: 0.1 but for a time, in which there is another score or none.
    fn drive(from_s: f64, to_s: f64, score: Option<f64>) -> DriveScores {
        let mut drive = DriveScores::default();
        for i in 0..300_u32 {
            let at_s = f64::from(i) / FPS;
            let at = Duration::from_secs_f64(at_s);
            match score {
                Some(score) if (from_s..to_s).contains(&at_s) => drive.add(at, score, true),
                None if (from_s..to_s).contains(&at_s) => drive.add_unjudged(at, Reason::Black),
                _ => drive.add(at, 0.1, at_s >= 1.0),
            }
        }
        drive
    }

    #[test]
    fn found_missed_faults_and_alarms_before_are_told_apart() {
        let drives = [
            drive(42.0, 99.0, Some(3.0)),
            drive(43.5, 99.0, Some(3.0)),
            drive(38.0, 99.0, Some(3.0)),
            drive(42.0, 99.0, None),
            drive(99.0, 99.0, None),
            // A false alarm that is over when the event begins.
            drive(10.0, 15.0, Some(3.0)),
            drive(60.0, 99.0, Some(3.0)),
        ];
        let drives: Vec<&DriveScores> = drives.iter().collect();
        let judged = |factor| {
            detection(
                ROADS,
                Event::Noise,
                &drives,
                EvidenceKind::Windows,
                (1.0, factor),
            )
        };
        let found = judged(1.0);
        let counted = (
            found.found,
            found.alarmed_before,
            found.sensor_fault,
            found.missed,
        );
        // The second drive enters Gap 2.5 s after the onset, and the last one 19 s after it.
        assert_eq!(counted, (1, 1, 1, 2));
        assert_eq!(found.found_later, [2, 3]);
        assert!(
            (0.75..=1.25).contains(&found.delay_median_s.unwrap())
                || found.delay_median_s.unwrap() > 2.0
        );
        // Thresholds four times as far away are not reached.
        assert_eq!(judged(4.0).found_later, [0, 0]);
    }

    #[test]
    fn a_drive_that_begins_under_its_condition_has_its_onset_at_the_start() {
        let roads = Roads {
            from_start: true,
            ..ROADS
        };
        let under = drive(0.0, 99.0, Some(3.0));
        let found = detection(
            roads,
            Event::Condition(ConditionKind::Fog, 3),
            &[&under],
            EvidenceKind::Windows,
            (1.0, 1.0),
        );
        assert_eq!((found.found, found.alarmed_before), (1, 0));
    }
}
