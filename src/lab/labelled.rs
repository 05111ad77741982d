//! Rendered drives with lane labels, as a lane model sees them: what its encoder saw, and how well it found the lanes.

use rayon::prelude::*;

use crate::calibration::LabelledMeans;
use crate::calibration::survey::{Keep, Survey, SurveyFrame};
use crate::capture::{Picture, time_of};
use crate::features::energies::EnergyStage;
use crate::features::lane::{Agreement, LaneMask};
use crate::lab::scene::{Condition, ConditionKind, Drive, DriveSpec, Renderer};
use crate::model::encoder::{Encoder, EncoderError};
use crate::model::preprocess::Preprocessing;

/// Number of severities that the conditions have in turn.
const SEVERITIES: usize = 5;

/// A drive as a lane model sees it.
pub struct LabelledSurvey {
    /// What the encoder saw.
    pub survey: Survey,
    /// For every frame, how well the model's lanes agree with the true lanes.
    pub agreements: Vec<Agreement>,
    /// For every frame, mean and standard deviation of its grey levels, 0 to 255.
    pub grey: Vec<[f64; 2]>,
}

impl LabelledSurvey {
    /// Renders a drive at the encoder's size and looks at every frame. `encoder` must have a lane head.
    ///
    /// # Errors
    /// When the encoder cannot be run at all.
    pub fn of(
        spec: &DriveSpec,
        encoder: &Encoder,
        preprocessing: &Preprocessing,
        keep: Keep,
    ) -> Result<Self, EncoderError> {
        let (width, height) = (preprocessing.width, preprocessing.height);
        let mut stage = EnergyStage::new(encoder, preprocessing)?;
        let mut renderer = Renderer::new(width, height);
        let drive = Drive::new(&spec.world, spec.seed, &spec.conditions);
        let mut labelled = Self {
            survey: Survey {
                source: String::new(),
                times: Vec::new(),
                frames: Vec::new(),
                common_size: stage.common_size(),
            },
            agreements: Vec::new(),
            grey: Vec::new(),
        };
        for sequence in 0..spec.frames() {
            let at = time_of(sequence, spec.fps);
            let scene = renderer.render(&drive, at.as_secs_f64());
            let truth = LaneMask::of_labels(width as usize, scene.mask);
            let picture = Picture {
                width,
                height,
                rgb: scene.rgb.to_vec(),
            };
            labelled.grey.push(grey(&picture.rgb));
            let judged = stage.energies_of(&picture.into()).map(|_| ());
            let answer = judged.as_ref().ok().and(stage.lane());
            labelled.agreements.push(Agreement::of(answer, &truth));
            labelled.survey.times.push(at);
            let frame = judged.map(|()| SurveyFrame::of(&stage, keep));
            labelled.survey.frames.push(frame);
        }
        Ok(labelled)
    }
}

/// Mean and standard deviation of the mean of red, green and blue.
#[allow(clippy::cast_precision_loss)]
fn grey(rgb: &[u8]) -> [f64; 2] {
    let (mut sum, mut squares) = (0_u64, 0_u64);
    for pixel in rgb.chunks_exact(3) {
        let level: u64 = pixel.iter().map(|&level| u64::from(level)).sum();
        sum += level;
        squares += level * level;
    }
    let pixels = (rgb.len() / 3).max(1) as f64;
    let mean = sum as f64 / pixels;
    let variance = squares as f64 / pixels - mean * mean;
    [mean / 3.0, variance.max(0.0).sqrt() / 3.0]
}

/// The share of its lanes that the model loses, 0 to 1: 1 - F1 within the tolerance; `None` where there are no lanes.
pub fn loss(agreement: Agreement) -> Option<f64> {
    agreement.f1().map(|f1| 1.0 - f1)
}

/// The conditions under which the drive with this number is seen: each kind, with severities 1 to 5 in turn.
pub fn conditions(number: usize) -> impl Iterator<Item = Condition> {
    let kinds = ConditionKind::ALL.into_iter().enumerate();
    kinds.map(move |(index, kind)| Condition {
        kind,
        // It is 1 to 5.
        #[allow(clippy::cast_precision_loss)]
        severity: ((number % SEVERITIES + index) % SEVERITIES + 1) as f32,
        span_s: None,
    })
}

/// Frames from which a forecast of the lane model's loss is learnt: every drive plain and under each kind of condition,
/// with severities in turn. `seen` is called after each drive.
///
/// # Errors
/// When the encoder cannot be run at all.
pub fn training_frames(
    drives: &[DriveSpec],
    encoder: &Encoder,
    preprocessing: &Preprocessing,
    seen: &(dyn Fn() + Sync),
) -> Result<Vec<(ConditionKind, LabelledMeans)>, EncoderError> {
    let of_drive = |(number, plain): (usize, &DriveSpec)| {
        let frames = frames_of(plain, number, encoder, preprocessing)?;
        seen();
        Ok(frames)
    };
    let all: Vec<Vec<_>> = drives
        .par_iter()
        .enumerate()
        .map(of_drive)
        .collect::<Result<_, _>>()?;
    Ok(all.into_iter().flatten().collect())
}

/// Frames of one drive under each kind of condition, with what the lane model loses there; `number` sets the severities
/// as in [`conditions`]. Frames without lanes are left out.
///
/// # Errors
/// When the encoder cannot be run at all.
pub fn frames_of(
    plain: &DriveSpec,
    number: usize,
    encoder: &Encoder,
    preprocessing: &Preprocessing,
) -> Result<Vec<(ConditionKind, LabelledMeans)>, EncoderError> {
    let mut frames = Vec::new();
    for condition in conditions(number) {
        let mut spec = plain.clone();
        spec.conditions.push(condition);
        let seen = LabelledSurvey::of(&spec, encoder, preprocessing, Keep::Means)?;
        for (frame, &agreement) in seen.survey.frames.into_iter().zip(&seen.agreements) {
            if let (Ok(frame), Some(loss)) = (frame, loss(agreement)) {
                let means = frame.means;
                frames.push((condition.kind, LabelledMeans { means, loss }));
            }
        }
    }
    Ok(frames)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;
    use crate::model::{ModelOptions, ModelSpec};

    #[test]
    fn a_loss_is_what_f1_lacks() {
        let of = |found, truth| Agreement {
            right: found,
            answer: found,
            found,
            truth,
        };
        assert_eq!(loss(of(10, 10)), Some(0.0));
        assert_eq!(loss(of(0, 10)), Some(1.0));
        assert!((loss(of(5, 10)).unwrap() - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(loss(of(0, 0)), None);
    }

    #[test]
    fn grey_levels_of_a_picture_half_black_half_white() {
        let rgb: Vec<u8> = [0_u8; 30].into_iter().chain([255; 30]).collect();
        assert_eq!(grey(&rgb), [127.5, 127.5]);
    }

    #[test]
    fn every_kind_comes_at_every_severity_over_five_drives() {
        let mut seen: Vec<(&str, u32)> = (0..5)
            .flat_map(conditions)
            .map(|c| (c.kind.name(), c.severity.to_bits()))
            .collect();
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), 50);
    }

    #[test]
    fn snow_costs_lanes_and_is_learnt_from() {
        let model = ModelSpec::new(None, ModelOptions::default()).unwrap();
        let encoder = Encoder::load_with_lane(&model).unwrap();
        let drives = ["sim?seed=5&seconds=1&fps=2".parse().unwrap()];
        let frames = training_frames(&drives, &encoder, &model.preprocessing, &|| {}).unwrap();
        let mean = |kind: ConditionKind| {
            let of: Vec<f64> = frames
                .iter()
                .filter(|(of, _)| *of == kind)
                .map(|(_, frame)| frame.loss)
                .collect();
            of.iter().sum::<f64>() / f64::from(u32::try_from(of.len()).unwrap())
        };
        // The severities are 3 and 1.
        assert!(mean(ConditionKind::Snow) > 0.4 + mean(ConditionKind::Askew));
    }
}
