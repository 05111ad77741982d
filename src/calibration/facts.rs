//! What drives are before anything is made of them: how long they are, and whether their frames follow each other.

use super::drive::SurveyedDrive;
use super::error::CalibrationError;
use super::stretch::{Stretch, look_at_all};
use super::survey::SurveyFrame;
use super::timed::independent_spans;
use super::windows::Part;
use crate::reference::Span;
use crate::reference::gap::moments::EPSILON_SHARE;
use crate::statistics::quantile::{median, quantile};

/// Fewest frames from which it can be said whether they follow each other: of fewer, the ratios of videos and of still
/// pictures overlap.
const FRAMES_COMPARED: usize = 20;
/// The energy whose ratio is taken: 2 of 100 have a smaller one. Most energies of an even road are noise, but some follow light,
/// surroundings or other cars.
const SLOW_QUANTILE: f64 = 0.02;
/// Standard score of this quantile, with which ratios of independent frames scatter.
const SLOW_SCORE: f64 = 2.05;
/// Ratio of a drive to that of independent frames, from which on its frames do not follow each other. Chosen between the
/// largest of rendered drives at 2 frames a second in daylight, 0.47, and the smallest of the same frames in random order,
/// 0.94 of 120 frames and 0.64 of 20. An unlit night on which nothing changes reached 0.82.
const UNRELATED: f64 = 0.75;
/// Smallest variance of an energy that changes, nats squared.
const VARIANCE_MIN: f64 = 1e-9;

/// What a drive is.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveFacts {
    /// As typed.
    pub source: String,
    /// Number of frames.
    pub frames: usize,
    /// Its length, seconds.
    pub seconds: f64,
    /// Number of spans of each kind that do not overlap, in the order of [`Span::ALL`].
    pub spans: [usize; Span::ALL.len()],
    /// Number of energies of each block; empty without frames.
    pub energies: Vec<usize>,
    /// Von Neumann ratio of the slow log energies, as a share of what it is for independent frames; `None` for too few frames,
    /// or for frames that are all the same.
    pub succession: Option<f64>,
}

impl DriveFacts {
    /// Whether the frames do not follow each other in time, as still pictures do not.
    ///
    /// The von Neumann ratio is half the mean squared difference between each frame and the next, over the variance. It is 1
    /// on average for pictures that have nothing to do with each other, and near 0 for a video.
    /// Source: von Neumann 1941, Distribution of the ratio of the mean square successive difference to the variance.
    pub fn is_of_stills(&self) -> bool {
        self.succession.is_some_and(|ratio| ratio >= UNRELATED)
    }
}

/// Looks at whole drives once, one at a time on each thread.
///
/// # Errors
/// When a frame cannot be judged, or when a drive can no longer be read.
pub fn facts_of<D: SurveyedDrive>(drives: &[D]) -> Result<Vec<DriveFacts>, CalibrationError> {
    let whole: Vec<Stretch<'_, D>> = drives.iter().map(Stretch::whole).collect();
    look_at_all(&whole, |part| {
        let period_s = part.frames_hz().map_or(0.0, f64::recip);
        let ends = part.times().first().zip(part.times().last());
        let lasted_s = ends.map_or(0.0, |(first, last)| {
            last.saturating_sub(*first).as_secs_f64()
        });
        let first = part.frames.first();
        let energies = first.map(|of| of.means.iter().map(|of| of.energy.len()).collect());
        Ok(DriveFacts {
            source: part.source().to_owned(),
            frames: part.frames.len(),
            seconds: lasted_s + period_s,
            spans: Span::ALL.map(|span| independent_spans(part.times(), span)),
            energies: energies.unwrap_or_default(),
            succession: succession(part),
        })
    })
}

/// Von Neumann ratio of the slow log energies of all blocks, as a share of what it is for independent frames.
#[allow(clippy::cast_precision_loss)]
fn succession(part: &Part<'_>) -> Option<f64> {
    let frames = part.frames.len();
    if frames < FRAMES_COMPARED {
        return None;
    }
    let mut ratios = Vec::new();
    for (tap, means) in part.frames[0].means.iter().enumerate() {
        let peaks = part.frames.iter().map(|of| of.peaks[tap]).collect();
        let epsilon = EPSILON_SHARE * median(peaks)?;
        for place in 0..means.energy.len() {
            let level = |of: &&SurveyFrame| {
                let energy = of.means[tap].energy.get(place)?;
                Some((energy / epsilon).ln_1p())
            };
            let levels: Vec<f64> = part.frames.iter().map(level).collect::<Option<_>>()?;
            ratios.extend(von_neumann_ratio(&levels));
        }
    }
    ratios.sort_by(f64::total_cmp);
    let independent = 1.0 - SLOW_SCORE / (frames as f64).sqrt();
    Some(quantile(&ratios, SLOW_QUANTILE)? / independent)
}

/// Half the sum of squared differences between neighbours, over the sum of squared deviations from the mean; `None` if all
/// values are the same.
#[allow(clippy::cast_precision_loss)]
fn von_neumann_ratio(values: &[f64]) -> Option<f64> {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let deviations: f64 = values.iter().map(|of| (of - mean).powi(2)).sum();
    let pairs = values.windows(2);
    let steps: f64 = pairs.map(|pair| (pair[1] - pair[0]).powi(2)).sum();
    let ratio = 0.5 * steps / deviations;
    (deviations > VARIANCE_MIN * values.len() as f64 && ratio.is_finite()).then_some(ratio)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::cast_precision_loss)]
    use super::*;

    #[test]
    fn the_ratio_is_near_0_for_what_drifts_and_by_hand_for_what_alternates() {
        let drift: Vec<f64> = (0..100).map(|at| at as f64).collect();
        assert!(von_neumann_ratio(&drift).unwrap() < 0.001);
        // Three steps of 2 between values that are 1 from their mean.
        let back_and_forth = von_neumann_ratio(&[1.0, -1.0, 1.0, -1.0]).unwrap();
        assert!((back_and_forth - 0.5 * 12.0 / 4.0).abs() < 1e-12);
        assert_eq!(von_neumann_ratio(&[3.0; 9]), None);
    }
}
