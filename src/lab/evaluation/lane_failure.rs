//! Does the gap predict that the lane model fails? Labelled drives under conditions that grow and fade are judged with
//! every metric and with simpler baselines at the same rates of false alarms.
//!
//! A second is a failure if the lane model's F1 within the tolerance is below a half in it, but not in the same second on
//! a plain day. A drive has at most one event, because the condition grows once. All thresholds come from nominal drives
//! that are not judged, and the forecast `lane-risk` is also judged under kinds of condition to which it was not fitted.

mod method;
mod row;
mod shipped;
mod sizes;

use rayon::prelude::*;

use super::domain_detection::WITHIN_S;
use super::ranking::{auroc, spearman};
use super::resampling::binomial_interval;
use crate::calibration::survey::{Keep, Survey};
use crate::calibration::{
    Calibrated, CalibrationError, Domain, DriveScores, LabelledMeans, Target, calibrate,
    drive_scores, is_judging,
};
use crate::features::lane::Agreement;
use crate::lab::labelled::{LabelledSurvey, loss, training_frames};
use crate::lab::scene::{Condition, ConditionKind, DriveSpec, RAMP_S};
use crate::model::encoder::{Encoder, EncoderError};
use crate::model::preprocess::Preprocessing;
use crate::monitor::alarm::AlarmState;
use crate::reference::gap::Metric;
use crate::reference::{Component, EvidenceKind, Reference};
use crate::statistics::bootstrap::{ROUNDS, percentile_interval};
use crate::statistics::event_rate::poisson_interval;
use crate::statistics::random::SplitMix64;
use method::Method;
pub use row::LaneFailure;
pub use sizes::Sizes;

/// Frames a second of drives.
const FPS: f64 = 5.0;
/// Frames a second of the hours of nominal drives that set and judge thresholds.
const HELD_OUT_FPS: f64 = 2.0;
/// Time from which on the condition has its severity, after growing for 2 s.
const FULL_S: f64 = 8.0;
/// Time at which the condition is gone, after fading for 2 s.
const GONE_S: f64 = 18.0;
/// Length of a drive with a condition.
const DRIVE_S: f64 = 22.0;
/// A warning counts for a failure from this long before its onset,
const BEFORE_S: f64 = 5.0;
/// to this long after it.
const AFTER_S: f64 = 1.0;
/// Loss of F1 that is a failure.
const FAILURE: f64 = 0.5;
/// Largest loss of F1 over the whole condition, beyond that on a plain day, for a benign drive.
const BENIGN: f64 = 0.1;
/// Severity from which on a condition should be found, whether there is a failure or not.
pub(super) const SEVERE: f32 = 3.0;
/// A warning up to this long after the onset counts as late.
const LATE_S: f64 = 3.0;
/// Entries into `Gap` an hour of nominal driving at which all methods are compared.
pub const RATES_PER_HOUR: [f64; 2] = [1.0, 0.1];

/// First seeds of the drives: for references, for setting and judging thresholds, for fitting `lane-risk`, and for the
/// evaluation.
pub const FIRST_SEEDS: [u64; 4] = [60_001, 61_001, 62_001, 63_001];

/// The seeds of what is rendered, as text.
pub fn seeds_of(sizes: Sizes) -> String {
    let Sizes {
        fitted,
        held_out,
        labelled,
        roads,
        ..
    } = sizes;
    let [a, b, c, d] = FIRST_SEEDS;
    format!(
        "references {a} and {fitted} drives on, thresholds {b} and {held_out} on, lane-risk {c} and {labelled} on, judged {d} and {roads} on"
    )
}

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
pub enum LaneFailureError {
    /// The encoder cannot be run.
    #[error(transparent)]
    Encoder(#[from] EncoderError),
    /// A method has no thresholds.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
}

/// Everything that the encoder saw, once for all methods.
pub(super) struct Looked {
    taps: Vec<String>,
    pub(super) fitted: Vec<LabelledSurvey>,
    pub(super) held_out: Vec<LabelledSurvey>,
    pub(super) labelled: Vec<(ConditionKind, LabelledMeans)>,
    pub(super) judged: Vec<Judged>,
}

/// A drive with a condition.
pub(super) struct Judged {
    road: usize,
    pub(super) condition: Condition,
    pub(super) drive: LabelledSurvey,
    /// Loss of each second; `None` if it is a failure on a plain day too.
    losses: Vec<Option<f64>>,
    /// Whether the condition causes almost no loss.
    benign: bool,
}

/// Judges every metric that has a window, `lane-risk`, the baselines, and the forecast of `reference`, which was made for
/// `encoder`, if it has one. `encoder` must have a lane head; `seen` is called after each drive.
///
/// # Errors
/// When the encoder cannot be run, or when a method gets no thresholds from the nominal drives.
pub fn rows(
    taps: &[String],
    encoder: &Encoder,
    preprocessing: &Preprocessing,
    reference: Option<&Reference>,
    sizes: Sizes,
    seen: &(dyn Fn() + Sync),
) -> Result<Vec<LaneFailure>, LaneFailureError> {
    let looked = Looked::at(taps, encoder, preprocessing, sizes, seen)?;
    let windowed = Metric::all()
        .into_iter()
        .filter(|&metric| metric != Metric::Frechet)
        .map(Method::Metric);
    let methods: Vec<Method> = windowed
        .chain([
            Method::LaneRiskOfOtherKinds,
            Method::QuickLaneRisk,
            Method::MeanAttention,
            Method::BrightnessAndContrast,
        ])
        .collect();
    let rows = methods
        .par_iter()
        .map(|method| looked.rows_of(*method))
        .collect::<Result<Vec<_>, _>>()?;
    let shipped = reference.filter(|of| of.lanes.is_some());
    let shipped = shipped.map(|of| looked.rows_as_shipped(of));
    Ok(rows.into_iter().chain(shipped).flatten().collect())
}

/// Thresholds of a method, and its scores of the drives that judge them.
struct Thresholds {
    components: Vec<Component>,
    /// For each rate, the factor on the thresholds of the components.
    factors: Vec<f64>,
}

impl Looked {
    pub(super) fn at(
        taps: &[String],
        encoder: &Encoder,
        preprocessing: &Preprocessing,
        sizes: Sizes,
        seen: &(dyn Fn() + Sync),
    ) -> Result<Self, EncoderError> {
        let [fitted, held_out, labelled, judged] = FIRST_SEEDS;
        let look = |spec: &DriveSpec| {
            let drive = LabelledSurvey::of(spec, encoder, preprocessing, Keep::Maps)?;
            seen();
            Ok::<_, EncoderError>(drive)
        };
        let nominal = |first: u64, count: u64, seconds: f64, fps: f64| {
            (first..first + count)
                .into_par_iter()
                .map(|seed| look(&drive_spec(seed, seconds, fps)))
                .collect::<Result<Vec<_>, _>>()
        };
        let labelled_drives: Vec<DriveSpec> = (labelled..labelled + sizes.labelled)
            .map(|seed| drive_spec(seed, 4.0, HELD_OUT_FPS))
            .collect();
        let clean = nominal(judged, sizes.roads, DRIVE_S, FPS)?;
        let cases: Vec<(usize, Condition)> = (0..clean.len())
            .flat_map(|road| {
                let kinds = ConditionKind::ALL.into_iter();
                kinds.flat_map(move |kind| {
                    (1..=5_u8).map(move |severity| {
                        let condition = Condition {
                            kind,
                            severity: f32::from(severity),
                            span_s: Some((FULL_S, GONE_S)),
                        };
                        (road, condition)
                    })
                })
            })
            .collect();
        let judged = cases
            .into_par_iter()
            .map(|(road, condition)| {
                let mut spec = drive_spec(judged + road as u64, DRIVE_S, FPS);
                spec.conditions.push(condition);
                let drive = look(&spec)?;
                Ok(Judged::new(road, condition, drive, &clean[road]))
            })
            .collect::<Result<Vec<_>, EncoderError>>()?;
        Ok(Self {
            taps: taps.to_vec(),
            fitted: nominal(fitted, sizes.fitted, 2.0, FPS)?,
            held_out: nominal(held_out, sizes.held_out, sizes.held_out_s, HELD_OUT_FPS)?,
            labelled: training_frames(&labelled_drives, encoder, preprocessing, seen)?,
            judged,
        })
    }

    fn rows_of(&self, method: Method) -> Result<Vec<LaneFailure>, CalibrationError> {
        let views = |drives: &[LabelledSurvey]| -> Vec<Survey> {
            drives.iter().map(|drive| method.survey(drive)).collect()
        };
        let (fitted, held_out) = (views(&self.fitted), views(&self.held_out));
        let judge = |left_out: Option<ConditionKind>| {
            let labelled = self.labelled_without(method, left_out);
            Thresholds::new(method, &self.taps, &fitted, &held_out, &labelled)
        };
        let judges: Vec<(Option<ConditionKind>, Thresholds)> = match method {
            Method::LaneRiskOfOtherKinds => ConditionKind::ALL
                .into_iter()
                .map(|kind| Ok((Some(kind), judge(Some(kind))?)))
                .collect::<Result<_, CalibrationError>>()?,
            _ => vec![(None, judge(None)?)],
        };
        let (metric, window_s) = (method.metric(), method.window_s());
        // There is one judge for each kind. Nominal drives are judged by each of them, and the one with the most
        // entries counts.
        let mut drives: Vec<(&Judged, DriveScores, usize)> = Vec::new();
        for (index, (kind, judge)) in judges.iter().enumerate() {
            for judged in &self.judged {
                if kind.is_none_or(|kind| kind == judged.condition.kind) {
                    let view = method.survey(&judged.drive);
                    let scores = drive_scores(&view, metric, window_s, &judge.components);
                    drives.push((judged, scores, index));
                }
            }
        }
        let judging: Vec<Vec<DriveScores>> = judges
            .iter()
            .map(|(_, judge)| {
                let judging = held_out
                    .iter()
                    .enumerate()
                    .filter(|(index, _)| is_judging(*index))
                    .map(|(_, drive)| drive);
                judging
                    .map(|drive| drive_scores(drive, metric, window_s, &judge.components))
                    .collect()
            })
            .collect();
        let ranks = Ranks::of(&drives);
        let ranked = ranks.row(method.name(), method.is_baseline());
        let rate = |(index, &wanted): (usize, &f64)| {
            let factor = |judge: usize| judges[judge].1.factors[index];
            let mut row = LaneFailure {
                wanted_per_hour: wanted,
                ..ranked.clone()
            };
            row.count(
                drives
                    .iter()
                    .map(|(judged, scores, judge)| (*judged, Entered::of(scores, factor(*judge)))),
            );
            let nominal = judging.iter().enumerate().map(|(judge, drives)| {
                let hours: f64 = drives.iter().map(DriveScores::hours).sum();
                let entries: u64 = drives.iter().map(|d| d.entries(factor(judge))).sum();
                (entries, hours)
            });
            row.count_nominal(nominal.collect());
            row
        };
        Ok(RATES_PER_HOUR.iter().enumerate().map(rate).collect())
    }

    fn labelled_without(
        &self,
        method: Method,
        left_out: Option<ConditionKind>,
    ) -> Vec<LabelledMeans> {
        if method.metric() != Metric::LaneRisk {
            return Vec::new();
        }
        let kept = self
            .labelled
            .iter()
            .filter(|(kind, _)| Some(*kind) != left_out);
        kept.map(|(_, frame)| frame.clone()).collect()
    }
}

fn drive_spec(seed: u64, seconds: f64, fps: f64) -> DriveSpec {
    DriveSpec {
        seed,
        seconds,
        fps,
        ..DriveSpec::default()
    }
}

impl Thresholds {
    fn new(
        method: Method,
        taps: &[String],
        fitted: &[Survey],
        held_out: &[Survey],
        labelled: &[LabelledMeans],
    ) -> Result<Self, CalibrationError> {
        let domain = Domain {
            name: "simulation".to_owned(),
            drives: fitted,
        };
        // One window: metrics are compared, and not what more evidence adds.
        let wanted = Target {
            evidence: EvidenceKind::Frames,
            ..Target::new(method.metric(), method.window_s(), RATES_PER_HOUR[0])
        };
        let Calibrated {
            components,
            false_alarms,
            ..
        } = calibrate(&[domain], held_out, labelled, &method.taps(taps), wanted)?;
        let factors = RATES_PER_HOUR.map(|rate| {
            let of = |per_hour: f64| per_hour.total_cmp(&rate).is_eq();
            let found = false_alarms.factors.iter().find(|f| of(f.per_hour));
            found.map_or(1.0, |f| f.factor / false_alarms.factor)
        });
        Ok(Self {
            components,
            factors: factors.to_vec(),
        })
    }
}

impl Judged {
    fn new(
        road: usize,
        condition: Condition,
        drive: LabelledSurvey,
        clean: &LabelledSurvey,
    ) -> Self {
        let of_seconds = |of: &LabelledSurvey, wanted: &dyn Fn(f64) -> bool| {
            let frames = of.survey.times.iter().zip(&of.agreements);
            let own = frames.filter(|(at, _)| wanted(at.as_secs_f64()));
            loss(Agreement::pooled(own.map(|(_, &agreement)| agreement)))
        };
        let second = |of: &LabelledSurvey, second: usize| {
            #[allow(clippy::cast_precision_loss)]
            let whole = second as f64..(second + 1) as f64;
            of_seconds(of, &|at| whole.contains(&at))
        };
        // It is a few tens of seconds.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let seconds = DRIVE_S as usize;
        let losses = (0..seconds)
            .map(|at| {
                let plain = second(clean, at).filter(|&loss| loss <= FAILURE);
                plain.and(second(&drive, at))
            })
            .collect();
        let full = |of: &LabelledSurvey| {
            let whole = FULL_S..GONE_S - RAMP_S;
            of_seconds(of, &|at| whole.contains(&at))
        };
        let more = full(&drive).zip(full(clean)).map(|(of, plain)| of - plain);
        Self {
            road,
            condition,
            benign: more.is_some_and(|more| more <= BENIGN),
            drive,
            losses,
        }
    }

    /// When the first failing second begins.
    #[allow(clippy::cast_precision_loss)]
    fn failure_s(&self) -> Option<f64> {
        let failed = |loss: &Option<f64>| loss.is_some_and(|loss| loss > FAILURE);
        self.losses.iter().position(failed).map(|at| at as f64)
    }
}

/// When a condition begins to grow, seconds.
pub(super) fn onset_s() -> f64 {
    FULL_S - RAMP_S
}

/// Entries into `Gap` of one drive.
pub(super) struct Entered {
    at_s: Vec<f64>,
}

impl Entered {
    pub(super) fn of(scores: &DriveScores, factor: f64) -> Self {
        let mut before = AlarmState::Init;
        let entries = scores.states(factor).filter_map(|(at, state)| {
            let entered = state == AlarmState::Gap && before != AlarmState::Gap;
            before = state;
            entered.then_some(at.as_secs_f64())
        });
        Self {
            at_s: entries.collect(),
        }
    }

    /// Entries after the condition began to grow.
    fn in_condition(&self) -> bool {
        self.at_s.iter().any(|&at| at >= onset_s() && at <= GONE_S)
    }

    /// An entry at most 2 s after the condition has reached its severity. The portal of a tunnel can be seen during the
    /// whole time before.
    pub(super) fn soon(&self, kind: ConditionKind) -> Option<f64> {
        let from = match kind {
            ConditionKind::Tunnel => 0.0,
            _ => onset_s(),
        };
        let soon = from..=FULL_S + WITHIN_S;
        self.at_s.iter().copied().find(|at| soon.contains(at))
    }

    /// The entry that warns of a failure, at most `after_s` after its onset.
    fn warning(&self, failure_s: f64, after_s: f64) -> Option<f64> {
        let counts = failure_s - BEFORE_S..=failure_s + after_s;
        self.at_s.iter().copied().find(|at| counts.contains(at))
    }
}

impl LaneFailure {
    fn count<'a>(&mut self, drives: impl Iterator<Item = (&'a Judged, Entered)>) {
        let mut leads = Vec::new();
        for (judged, entered) in drives {
            if judged.condition.severity >= SEVERE {
                self.severe += 1;
                self.severe_found += u64::from(entered.soon(judged.condition.kind).is_some());
            }
            let alarmed = entered.in_condition();
            self.alarmed += u64::from(alarmed);
            if let Some(failure_s) = judged.failure_s() {
                self.failures += 1;
                let late = entered.warning(failure_s, LATE_S).is_some();
                self.found_late += u64::from(late);
                if let Some(warning_s) = entered.warning(failure_s, AFTER_S) {
                    self.found += 1;
                    leads.push(failure_s - warning_s);
                }
            } else if judged.benign {
                self.benign += 1;
                self.benign_alarmed += u64::from(alarmed);
            }
        }
        self.severe_interval = binomial_interval(self.severe_found, self.severe);
        leads.sort_by(f64::total_cmp);
        self.lead_median_s = leads.get(leads.len() / 2).copied();
        self.recall = share(self.found, self.failures);
        self.recall_interval = binomial_interval(self.found, self.failures);
        self.precision = share(self.found, self.alarmed);
        self.benign_share = share(self.benign_alarmed, self.benign);
        self.benign_interval = binomial_interval(self.benign_alarmed, self.benign);
    }

    /// Adds entries and hours by judge; of several judges, the one with the most entries counts.
    #[allow(clippy::cast_precision_loss)]
    fn count_nominal(&mut self, by_judge: Vec<(u64, f64)>) {
        let worst = by_judge.into_iter().max_by_key(|&(entries, _)| entries);
        let (entries, hours) = worst.unwrap_or_default();
        self.false_alarms = entries;
        self.nominal_hours = hours;
        self.false_alarms_per_hour = entries as f64 / hours.max(f64::MIN_POSITIVE);
        self.false_alarms_interval = poisson_interval(entries, hours);
    }
}

#[allow(clippy::cast_precision_loss)]
fn share(of: u64, all: u64) -> Option<f64> {
    (all > 0).then(|| of as f64 / all as f64)
}

/// Scores and losses of seconds under a condition, for each road.
pub(super) struct Ranks {
    by_road: Vec<Vec<(f64, f64)>>,
    unjudged: u64,
}

impl Ranks {
    pub(super) fn of(drives: &[(&Judged, DriveScores, usize)]) -> Self {
        let roads = drives.iter().map(|(judged, ..)| judged.road + 1).max();
        let mut ranks = Self {
            by_road: vec![Vec::new(); roads.unwrap_or(0)],
            unjudged: 0,
        };
        for (judged, scores, _) in drives {
            for (second, loss) in judged.losses.iter().enumerate() {
                #[allow(clippy::cast_precision_loss)]
                let under = (onset_s()..GONE_S).contains(&(second as f64));
                let Some(loss) = loss.filter(|_| under) else {
                    continue;
                };
                // The window of the last frame of a second is this second.
                let frames = scores
                    .scores()
                    .filter(|(at, _)| at.as_secs() == second as u64);
                match frames.last().and_then(|(_, score)| score) {
                    Some(score) => ranks.by_road[judged.road].push((score, loss)),
                    None => ranks.unjudged += 1,
                }
            }
        }
        ranks
    }

    /// The area under the ROC curve over all roads.
    pub(super) fn auroc(&self) -> Option<f64> {
        auroc(&self.by_road.concat(), FAILURE)
    }

    fn row(&self, method: String, baseline: bool) -> LaneFailure {
        let all = self.by_road.concat();
        let mut dice = SplitMix64::new(0);
        let (mut aurocs, mut spearmans) = (Vec::new(), Vec::new());
        for _ in 0..ROUNDS {
            let drawn: Vec<(f64, f64)> = (0..self.by_road.len())
                .flat_map(|_| &self.by_road[dice.below(self.by_road.len())])
                .copied()
                .collect();
            aurocs.extend(auroc(&drawn, FAILURE));
            spearmans.extend(spearman(&drawn));
        }
        LaneFailure {
            method,
            baseline,
            wanted_per_hour: 0.0,
            seconds: all.len() as u64,
            unjudged_seconds: self.unjudged,
            failed_seconds: all.iter().filter(|(_, loss)| *loss > FAILURE).count() as u64,
            auroc: auroc(&all, FAILURE),
            auroc_interval: percentile_interval(aurocs),
            spearman: spearman(&all),
            spearman_interval: percentile_interval(spearmans),
            failures: 0,
            found: 0,
            found_late: 0,
            recall: None,
            recall_interval: (0.0, 1.0),
            lead_median_s: None,
            alarmed: 0,
            precision: None,
            benign: 0,
            benign_alarmed: 0,
            benign_share: None,
            benign_interval: (0.0, 1.0),
            severe: 0,
            severe_found: 0,
            severe_interval: (0.0, 1.0),
            false_alarms: 0,
            nominal_hours: 0.0,
            false_alarms_per_hour: 0.0,
            false_alarms_interval: (0.0, 0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    #[test]
    fn an_entry_warns_from_5_s_before_to_1_s_after() {
        let entered = Entered {
            at_s: vec![6.5, 17.0],
        };
        assert_eq!(entered.warning(11.5, AFTER_S), Some(6.5));
        assert_eq!(entered.warning(5.5, AFTER_S), Some(6.5));
        assert_eq!(entered.warning(12.0, AFTER_S), None);
        assert_eq!(entered.warning(16.0, AFTER_S), Some(17.0));
        assert!(entered.in_condition());
        assert!(
            !Entered {
                at_s: vec![3.0, 19.0]
            }
            .in_condition()
        );
    }
}
