//! Rendered drives with lane labels → a forecast of the share of lanes that the model loses.

use std::borrow::Cow;

use super::drive::{LabelledDrive, LabelledMeans, SurveyedDrive};
use super::error::{CalibrationError, wrong};
use super::fitting::Fitting;
use super::stretch::Usage;
use super::target::Target;
use crate::reference::gap::Metric;
use crate::reference::gap::lane_risk::{LaneRisk, LaneRiskFit};
use crate::reference::gap::moments::{Moments, energy_levels};
use crate::reference::{Component, JudgedForecast, LaneForecast, Nominal};

/// Learns the forecast of the first nominal domain, of which `simulation` are the drives. Nominal frames have no loss.
///
/// # Errors
/// When there are fewer than two labelled drives, or when a drive can no longer be read.
pub fn learn_lanes<D: SurveyedDrive, L: LabelledDrive>(
    simulation: &[D],
    domain: &Component,
    labelled: &[L],
    wanted: Target,
) -> Result<LaneForecast, CalibrationError> {
    let (Some(tap), true) = (domain.taps.last(), labelled.len() >= 2) else {
        return Err(CalibrationError::Lanes(format!(
            "{} labelled drives; wanted two or more",
            labelled.len()
        )));
    };
    let Nominal::Energies(norm) = &tap.nominal else {
        return Err(CalibrationError::Lanes(format!(
            "a forecast of lanes beside another metric; wanted --metric {}",
            Metric::Mahalanobis
        )));
    };
    let usage = Usage::halves(simulation);
    let taps: Vec<String> = domain.taps.iter().map(|of| of.tap.clone()).collect();
    let fitting = Fitting {
        fitted: &usage.fitted,
        taps: &taps,
        metric: wanted.metric,
    };
    let epsilons = vec![norm.epsilon; taps.len()];
    let moments = fitting.frame_moments(&epsilons)?;
    let nominal = moments.last().cloned().unwrap_or_else(|| Moments::new(0));
    let place = taps.len() - 1;
    let frames = labelled.iter().map(LabelledDrive::means);
    let frames: Vec<Cow<'_, [LabelledMeans]>> = frames.collect::<Result<_, _>>()?;
    let fit = |fits: &dyn Fn(usize) -> bool| -> Result<(LaneRisk, f64, usize), CalibrationError> {
        let own = || {
            let drives = frames.iter().enumerate().filter(|&(drive, _)| fits(drive));
            drives.flat_map(|(_, frames)| frames.iter())
        };
        let count = own().count();
        let failed = |why| wrong(&tap.tap, Metric::LaneRisk, why);
        let mut fit = LaneRiskFit::new(norm.epsilon, &nominal, count).map_err(failed)?;
        let mut losses = 0.0;
        for frame in own() {
            fit.add(&frame.means[place].energy, frame.loss);
            losses += frame.loss;
        }
        #[allow(clippy::cast_precision_loss)]
        let mean = losses / count.max(1) as f64;
        Ok((fit.solve().map_err(failed)?, mean, count))
    };
    let even = |drive: usize| drive.is_multiple_of(2);
    let (risk, mean_loss, _) = fit(&even)?;
    let mut judged = JudgedForecast {
        frames: 0,
        mean_absolute_error: 0.0,
        of_the_mean: 0.0,
    };
    let mut levels = vec![0; norm.mean.len()];
    for frame in frames.iter().skip(1).step_by(2).flat_map(|of| of.iter()) {
        energy_levels(&frame.means[place].energy, norm.epsilon, &mut levels);
        let sums: Vec<u64> = levels.iter().map(|&level| u64::from(level)).collect();
        judged.frames += 1;
        judged.mean_absolute_error += (risk.loss(&sums, 1).clamp(0.0, 1.0) - frame.loss).abs();
        judged.of_the_mean += (mean_loss - frame.loss).abs();
    }
    #[allow(clippy::cast_precision_loss)]
    let share = 1.0 / judged.frames.max(1) as f64;
    judged.mean_absolute_error *= share;
    judged.of_the_mean *= share;
    let (risk, _, count) = fit(&|_| true)?;
    Ok(LaneForecast {
        frames: count,
        judged,
        risk,
    })
}
