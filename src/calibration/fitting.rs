//! Nominal frames → what is nominal: histograms, moments, or the forecast of lost lanes.

use super::binning::{Cut, Masses, PaperBinning, TapHistogram};
use super::drive::{LabelledDrive, SurveyedDrive};
use super::error::{CalibrationError, wrong};
use super::stretch::{Stretch, look_at_all, sum_over_all};
use super::timed::TimedMoments;
use super::windows::Part;
use crate::capture::undefined::Undefined;
use crate::reference::gap::Metric;
use crate::reference::gap::energy_norm::EnergyNorm;
use crate::reference::gap::lane_risk::LaneRiskFit;
use crate::reference::gap::moments::{self, Moments};
use crate::reference::{Component, Nominal, TapReference};
use crate::statistics::quantile::median;

/// The input from which the nominal values of a domain are made.
pub struct Fitting<'a, D> {
    pub fitted: &'a [Stretch<'a, D>],
    pub taps: &'a [String],
    pub metric: Metric,
}

impl<D: SurveyedDrive> Fitting<'_, D> {
    fn wrong(&self, tap: usize, why: Undefined) -> CalibrationError {
        wrong(&self.taps[tap], self.metric, why)
    }

    /// For each tap, the values of all frames of all stretches, in their order.
    fn peaks(
        &self,
        of: impl Fn(&Part<'_>, usize) -> Vec<f64> + Sync,
    ) -> Result<Vec<Vec<f64>>, CalibrationError> {
        let taps = 0..self.taps.len();
        let seen = look_at_all(self.fitted, |part| {
            Ok(taps.clone().map(|tap| of(part, tap)).collect::<Vec<_>>())
        })?;
        let of_tap = |tap: usize| seen.iter().flat_map(move |part| part[tap].iter().copied());
        Ok(taps.map(|tap| of_tap(tap).collect()).collect())
    }

    /// What is nominal for each tap, as a histogram; the gaps are not scaled yet.
    pub fn histograms(&self) -> Result<Vec<TapReference>, CalibrationError> {
        let peaks = self.peaks(|part, tap| {
            let mut peaks = Vec::with_capacity(part.frames.len());
            part.common_maps(tap, |map| peaks.push(map.range().1));
            peaks
        })?;
        let cut = |(tap, peaks)| {
            Cut::of(peaks, self.metric, PaperBinning::PUBLISHED).map_err(|why| self.wrong(tap, why))
        };
        let cuts: Vec<Cut> = peaks
            .into_iter()
            .enumerate()
            .map(cut)
            .collect::<Result<_, _>>()?;
        let mut masses: Vec<Masses> = cuts.iter().map(Cut::masses).collect();
        if masses.iter().any(|masses| !masses.grid.is_empty()) {
            masses = sum_over_all(
                self.fitted,
                &masses,
                |sums, part| {
                    for (tap, sum) in sums.iter_mut().enumerate() {
                        part.common_maps(tap, |map| sum.add(map));
                    }
                    Ok(())
                },
                |sums, others| sums.iter_mut().zip(others).for_each(|(a, b)| a.merge(b)),
            )?;
        }
        let nothing: Vec<TapHistogram> = cuts
            .iter()
            .zip(&masses)
            .map(|(cut, masses)| cut.nothing_counted(masses))
            .collect();
        let counted = sum_over_all(
            self.fitted,
            &nothing,
            |sums, part| {
                for (tap, sum) in sums.iter_mut().enumerate() {
                    let mut counted = Ok(());
                    part.common_maps(tap, |map| {
                        if counted.is_ok() {
                            counted = sum.add(map);
                        }
                    });
                    counted.map_err(|why| self.wrong(tap, why))?;
                }
                Ok(())
            },
            |sums, others| {
                let sums = sums.iter_mut().zip(others);
                sums.for_each(|(a, b)| a.sum.merge(&b.sum));
            },
        )?;
        let nominal = self
            .taps
            .iter()
            .zip(counted)
            .map(|(tap, fitted)| TapReference {
                tap: tap.clone(),
                median_peak_energy: fitted.median_peak_energy,
                images: fitted.sum.images,
                nominal: Nominal::Histogram {
                    binning: fitted.binning,
                    counts: fitted.sum.counts,
                },
                scale: Vec::new(),
                spans: Vec::new(),
            });
        Ok(nominal.collect())
    }

    /// Median peak energy of each tap.
    pub fn median_peaks(&self) -> Result<Vec<f64>, CalibrationError> {
        let peaks =
            self.peaks(|part, tap| part.frames.iter().map(|seen| seen.peaks[tap]).collect())?;
        let medians = peaks
            .into_iter()
            .enumerate()
            .map(|(tap, peaks)| median(peaks).ok_or_else(|| self.wrong(tap, Undefined::NoScore)));
        medians.collect()
    }

    /// Moments of single frames, for each tap.
    pub fn frame_moments(&self, epsilons: &[f64]) -> Result<Vec<Moments>, CalibrationError> {
        let nothing = vec![Moments::new(0); self.taps.len()];
        sum_over_all(
            self.fitted,
            &nothing,
            |sums, part| {
                for (tap, (sum, &epsilon)) in sums.iter_mut().zip(epsilons).enumerate() {
                    let energies = part
                        .frames
                        .iter()
                        .map(|seen| seen.means[tap].energy.as_slice());
                    sum.merge(&Moments::of(energies, epsilon));
                }
                Ok(())
            },
            |sums, others| sums.iter_mut().zip(others).for_each(|(a, b)| a.merge(b)),
        )
    }

    /// Moments of windows and spans, for each tap.
    pub fn timed_moments(
        &self,
        epsilons: &[f64],
        window_s: f64,
    ) -> Result<TimedMoments, CalibrationError> {
        sum_over_all(
            self.fitted,
            &TimedMoments::new(self.taps.len()),
            |sums, part| {
                sums.add(part, epsilons, window_s);
                Ok(())
            },
            TimedMoments::merge,
        )
    }

    /// What is nominal for each tap, as energies; the gaps are not scaled yet. `simulation` is given for an accepted domain.
    pub fn energies<L: LabelledDrive>(
        &self,
        peaks: &[f64],
        epsilons: &[f64],
        moments: &[Moments],
        simulation: Option<&Component>,
        labelled: &[L],
    ) -> Result<Vec<TapReference>, CalibrationError> {
        let epsilon = |tap: usize| epsilons[tap];
        let images = self.fitted.iter().map(|of| of.range.len() as u64).sum();
        let nominal: Vec<Nominal> = if self.metric == Metric::LaneRisk {
            let frames = labelled.iter().map(LabelledDrive::frames).sum();
            let mut fits = (0..self.taps.len())
                .map(|tap| {
                    LaneRiskFit::new(epsilon(tap), &moments[tap], frames)
                        .map_err(|why| self.wrong(tap, why))
                })
                .collect::<Result<Vec<_>, _>>()?;
            for drive in labelled {
                for frame in drive.means()?.iter() {
                    for (fit, means) in fits.iter_mut().zip(&frame.means) {
                        fit.add(&means.energy, frame.loss);
                    }
                }
            }
            let fitted = fits.into_iter().enumerate().map(|(tap, fit)| {
                let risk = fit.solve().map_err(|why| self.wrong(tap, why))?;
                Ok(Nominal::LaneRisk(risk))
            });
            fitted.collect::<Result<_, CalibrationError>>()?
        } else {
            let norms = (0..self.taps.len()).map(|tap| {
                let wider = simulation.and_then(|of| match &of.taps[tap].nominal {
                    Nominal::Energies(norm) => Some((norm, self.fitted.len())),
                    _ => None,
                });
                EnergyNorm::fit(epsilon(tap), &moments[tap], wider)
                    .map(Nominal::Energies)
                    .map_err(|why| self.wrong(tap, why))
            });
            norms.collect::<Result<_, _>>()?
        };
        let taps = self.taps.iter().zip(nominal).enumerate();
        let references = taps.map(|(index, (tap, nominal))| TapReference {
            tap: tap.clone(),
            median_peak_energy: peaks[index],
            images,
            nominal,
            scale: Vec::new(),
            spans: Vec::new(),
        });
        Ok(references.collect())
    }
}

/// The energies below which channels count as inactive, for each tap: those of the simulation if it is given.
pub fn epsilons_of(peaks: &[f64], simulation: Option<&Component>) -> Vec<f64> {
    let peaks = peaks.iter().enumerate();
    peaks
        .map(|(tap, &peak)| epsilon_of(peak, tap, simulation))
        .collect()
}

fn epsilon_of(median_peak_energy: f64, tap: usize, simulation: Option<&Component>) -> f64 {
    match simulation.map(|of| &of.taps[tap].nominal) {
        Some(Nominal::Energies(norm)) => norm.epsilon,
        _ => moments::EPSILON_SHARE * median_peak_energy,
    }
}
