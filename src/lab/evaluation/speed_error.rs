//! The cost of looking and its benefit: one lane model with several windows, frame rates and sets of taps, all from one
//! look at the same drives as in [`lane_failure`](super::lane_failure).
//!
//! Every point has its own reference and thresholds, for the same rate of false alarms.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::lane_failure::{
    Entered, Judged, LaneFailureError, Looked, RATES_PER_HOUR, Ranks, SEVERE, Sizes, onset_s,
};
use super::resampling::binomial_interval;
use crate::calibration::survey::{Survey, SurveyFrame};
use crate::calibration::{
    Domain, DriveScores, LabelledMeans, Target, calibrate, drive_scores, is_judging,
};
use crate::lab::labelled::LabelledSurvey;
use crate::model::encoder::Encoder;
use crate::model::preprocess::Preprocessing;
use crate::reference::Component;
use crate::reference::EvidenceKind;
use crate::reference::gap::Metric;
use crate::statistics::event_rate::poisson_interval;

/// Windows that are tried, seconds.
const WINDOWS_S: [f64; 3] = [0.4, 1.0, 2.0];
/// Every frame, every second frame or every fourth frame of the five frames a second is looked at.
const EVERY: [usize; 3] = [1, 2, 4];
/// Frames a second of the judged drives.
const FPS: f64 = 5.0;

/// A quick check on some nominal drives and three roads.
pub const SIZES: Sizes = Sizes {
    fitted: 150,
    held_out: 16,
    held_out_s: 300.0,
    labelled: 8,
    roads: 3,
};

/// One point: a way to look, with its cost and its errors.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SpeedError {
    /// Name of the lane model.
    pub model: String,
    /// The taps that are looked at.
    pub taps: Vec<String>,
    /// Length of the window, seconds.
    pub window_s: f64,
    /// Judged frames a second.
    pub fps: f64,
    /// CPU time of one frame on one thread, from a camera's buffer of 1280x720 YUYV to its verdict with all taps, ms.
    pub frame_ms: f64,
    /// CPU time of a judged second of driving, ms.
    pub second_ms: f64,
    /// Number of drives under a condition of severity 3 or more.
    pub severe: u64,
    /// Number of these in which `Gap` was not entered within 2 s after the condition had reached its severity.
    pub missed: u64,
    /// 95 % interval of their share (Wilson).
    pub missed_interval: (f64, f64),
    /// Median time from the beginning of the condition, which grows for 2 s, to the entry into `Gap`, for the drives
    /// found, seconds.
    pub delay_median_s: Option<f64>,
    /// Area under the ROC curve of the score for failed seconds, see [`super::lane_failure::LaneFailure`].
    pub auroc: Option<f64>,
    /// The same for the metric `lane-risk`.
    pub risk_auroc: Option<f64>,
    /// Entries into `Gap` on nominal drives that were not used for thresholds.
    pub false_alarms: u64,
    /// Hours of these drives.
    pub nominal_hours: f64,
    /// 95 % interval of entries an hour (Poisson, exact).
    pub false_alarms_interval: (f64, f64),
}

impl SpeedError {
    /// Share of severe drives that are missed.
    #[allow(clippy::cast_precision_loss)]
    pub fn missed_share(&self) -> f64 {
        self.missed as f64 / (self.severe as f64).max(1.0)
    }
}

/// Which points are on the front: each other point costs more, misses more, warns later, or predicts failures of the
/// lane model less well.
pub fn front(rows: &[SpeedError]) -> Vec<bool> {
    let criteria = |of: &SpeedError| {
        [
            of.second_ms,
            of.missed_share(),
            of.delay_median_s.unwrap_or(f64::INFINITY),
            -of.risk_auroc.unwrap_or(0.0),
        ]
    };
    let beats = |a: &SpeedError, b: &SpeedError| {
        let pairs = criteria(a).into_iter().zip(criteria(b));
        let worse = pairs.clone().any(|(a, b)| a > b);
        !worse && pairs.into_iter().any(|(a, b)| a < b)
    };
    let is_best = |row: &SpeedError| !rows.iter().any(|other| beats(other, row));
    rows.iter().map(is_best).collect()
}

/// All points of a model whose frames cost `frame_ms` each. `encoder` must have a lane head; `seen` is called after
/// each drive.
///
/// # Errors
/// When the encoder cannot be run, or when the nominal drives give no thresholds.
pub fn rows(
    model: &str,
    taps: &[String],
    encoder: &Encoder,
    preprocessing: &Preprocessing,
    sizes: Sizes,
    frame_ms: f64,
    seen: &(dyn Fn() + Sync),
) -> Result<Vec<SpeedError>, LaneFailureError> {
    let looked = Looked::at(taps, encoder, preprocessing, sizes, seen)?;
    let last = taps.len().saturating_sub(1);
    let all: Vec<usize> = (0..taps.len()).collect();
    let subsets = [all, vec![last]];
    let points: Vec<(&[usize], f64)> = subsets
        .iter()
        .flat_map(|subset| WINDOWS_S.map(|window_s| (subset.as_slice(), window_s)))
        .collect();
    let rows = points
        .par_iter()
        .map(|&(subset, window_s)| {
            let gap = Point::new(&looked, taps, subset, Metric::DEFAULT, window_s)?;
            let risk = Point::new(&looked, taps, subset, Metric::LaneRisk, window_s)?;
            let of_rate = |every: usize| {
                let mut row = gap.row(every);
                row.model = model.to_owned();
                row.taps = subset.iter().map(|&tap| taps[tap].clone()).collect();
                row.frame_ms = frame_ms;
                row.second_ms = frame_ms * row.fps;
                row.risk_auroc = risk.row(every).auroc;
                row
            };
            Ok(EVERY.map(of_rate).to_vec())
        })
        .collect::<Result<Vec<_>, LaneFailureError>>()?;
    Ok(rows.concat())
}

/// A metric with some taps and one window, and its thresholds.
struct Point<'a> {
    looked: &'a Looked,
    subset: &'a [usize],
    metric: Metric,
    window_s: f64,
    components: Vec<Component>,
    judging: Vec<Survey>,
}

impl<'a> Point<'a> {
    fn new(
        looked: &'a Looked,
        taps: &[String],
        subset: &'a [usize],
        metric: Metric,
        window_s: f64,
    ) -> Result<Self, LaneFailureError> {
        let view = |drive: &LabelledSurvey| view(drive, subset, 1);
        let fitted: Vec<Survey> = looked.fitted.iter().map(view).collect();
        let held_out: Vec<Survey> = looked.held_out.iter().map(view).collect();
        let labelled = looked.labelled.iter().map(|(_, frame)| LabelledMeans {
            means: of_taps(&frame.means, subset),
            loss: frame.loss,
        });
        let labelled: Vec<LabelledMeans> = match metric {
            Metric::LaneRisk => labelled.collect(),
            _ => Vec::new(),
        };
        let domain = Domain {
            name: "simulation".to_owned(),
            drives: &fitted,
        };
        // One window: metrics are compared, and not what more evidence adds.
        let wanted = Target {
            evidence: EvidenceKind::Frames,
            ..Target::new(metric, window_s, RATES_PER_HOUR[0])
        };
        let names: Vec<String> = subset.iter().map(|&tap| taps[tap].clone()).collect();
        let made = calibrate(&[domain], &held_out, &labelled, &names, wanted)?;
        let judging = held_out.into_iter().enumerate();
        Ok(Self {
            looked,
            subset,
            metric,
            window_s,
            components: made.components,
            judging: judging
                .filter(|(index, _)| is_judging(*index))
                .map(|(_, drive)| drive)
                .collect(),
        })
    }

    fn scores(&self, drive: &Survey) -> DriveScores {
        drive_scores(drive, self.metric, self.window_s, &self.components)
    }

    #[allow(clippy::cast_precision_loss)]
    fn row(&self, every: usize) -> SpeedError {
        let drives: Vec<(&Judged, DriveScores, usize)> = (self.looked.judged.iter())
            .map(|judged| {
                let view = view(&judged.drive, self.subset, every);
                (judged, self.scores(&view), 0)
            })
            .collect();
        let severe: Vec<Option<f64>> = drives
            .iter()
            .filter(|(judged, ..)| judged.condition.severity >= SEVERE)
            .map(|(judged, scores, _)| Entered::of(scores, 1.0).soon(judged.condition.kind))
            .collect();
        let mut delays: Vec<f64> = severe.iter().flatten().map(|at| at - onset_s()).collect();
        delays.sort_by(f64::total_cmp);
        let missed = (severe.len() - delays.len()) as u64;
        let judging: Vec<DriveScores> = self.judging.iter().map(|d| self.scores(d)).collect();
        let hours: f64 = judging.iter().map(DriveScores::hours).sum();
        let false_alarms = judging.iter().map(|drive| drive.entries(1.0)).sum();
        SpeedError {
            model: String::new(),
            taps: Vec::new(),
            window_s: self.window_s,
            fps: FPS / every as f64,
            frame_ms: 0.0,
            second_ms: 0.0,
            severe: severe.len() as u64,
            missed,
            missed_interval: binomial_interval(missed, severe.len() as u64),
            delay_median_s: delays.get(delays.len() / 2).copied(),
            auroc: Ranks::of(&drives).auroc(),
            risk_auroc: None,
            false_alarms,
            nominal_hours: hours,
            false_alarms_interval: poisson_interval(false_alarms, hours),
        }
    }
}

/// Some taps of every `every`-th frame of a drive.
fn view(drive: &LabelledSurvey, subset: &[usize], every: usize) -> Survey {
    let of = &drive.survey;
    let frames = of.frames.iter().step_by(every);
    Survey {
        source: of.source.clone(),
        times: of.times.iter().step_by(every).copied().collect(),
        frames: frames
            .map(|frame| match frame {
                Ok(frame) => Ok(SurveyFrame {
                    maps: Vec::new(),
                    peaks: of_taps(&frame.peaks, subset),
                    means: of_taps(&frame.means, subset),
                }),
                Err(why) => Err(why.clone()),
            })
            .collect(),
        common_size: of.common_size,
    }
}

fn of_taps<T: Clone>(all: &[T], subset: &[usize]) -> Vec<T> {
    subset
        .iter()
        .filter_map(|&tap| all.get(tap).cloned())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(second_ms: f64, missed: u64) -> SpeedError {
        SpeedError {
            model: String::new(),
            taps: Vec::new(),
            window_s: 1.0,
            fps: 5.0,
            frame_ms: second_ms / 5.0,
            second_ms,
            severe: 100,
            missed,
            missed_interval: (0.0, 1.0),
            delay_median_s: None,
            auroc: None,
            risk_auroc: None,
            false_alarms: 0,
            nominal_hours: 1.0,
            false_alarms_interval: (0.0, 3.7),
        }
    }

    #[test]
    fn the_front_is_what_nothing_beats() {
        let rows = [
            point(10.0, 30),
            point(20.0, 10),
            point(20.0, 12),
            point(30.0, 10),
            point(5.0, 60),
        ];
        assert_eq!(front(&rows), [true, true, false, false, true]);
        // Equal points are both on the front.
        assert_eq!(front(&[point(1.0, 1), point(1.0, 1)]), [true, true]);
        // Worse in two numbers, but sooner.
        let mut sooner = point(2.0, 2);
        sooner.delay_median_s = Some(0.4);
        assert_eq!(front(&[point(1.0, 1), sooner]), [true, true]);
    }
}
