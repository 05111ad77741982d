//! Surveys of nominal sources → reference: what is nominal, medians, and thresholds for a wanted rate of false alarms.

use super::drive::{LabelledDrive, SurveyedDrive};
use super::error::{CalibrationError, wrong};
use super::false_alarms;
use super::fitting::Fitting;
use super::stretch::{Split, Stretch, look_at_all, split};
use super::target::Target;
use crate::capture::undefined::Undefined;
use crate::reference::gap::Metric;
use crate::reference::gap::moments::Moments;
use crate::reference::{Component, FalseAlarms, Role, SPREAD_MIN, ScalePoint, SourceUse};
use crate::statistics::quantile::{median, quantile};

/// Window lengths, frames, for which medians and thresholds are kept.
const WINDOW_FRAMES: [usize; 5] = [1, 2, 5, 10, 20];
/// Smallest number of held-out frames for a scale.
const HELD_OUT_MIN: usize = 20;
/// Share of held-out windows below the threshold, before the rate of false alarms moves all thresholds together. It
/// sets the relative weight of the taps and window lengths.
const THRESHOLD_QUANTILE: f64 = 0.99;

/// Nominal drives of one domain.
pub struct Domain<'a, D> {
    /// `simulation`, or the accepted source as typed.
    pub name: String,
    /// Its drives.
    pub drives: &'a [D],
}

/// The result of a calibration.
pub struct Calibrated {
    /// The nominal domains with their thresholds.
    pub components: Vec<Component>,
    /// How often nominal drives enter `Gap`.
    pub false_alarms: FalseAlarms,
    /// The sources that were used.
    pub sources: Vec<SourceUse>,
}

/// How often [`calibrate`] looks at drives in total, counting each drive each time.
pub fn looks<D: SurveyedDrive, L: LabelledDrive>(
    domains: &[Domain<'_, D>],
    held_out: &[D],
    labelled: &[L],
    metric: Metric,
) -> u64 {
    // Peaks, then masses and counts for histograms, or moments.
    let of_fitted = match metric {
        Metric::LogEnergy(_) => 3,
        _ => 2,
    };
    let (mut fitted, mut scaled) = (0, 0);
    for split in domains.iter().flat_map(|domain| split(domain.drives)) {
        fitted += usize::from(split.fitted > 0);
        scaled += usize::from(split.fitted < split.drive.frames());
    }
    let scored = if held_out.is_empty() {
        scaled
    } else {
        held_out.len()
    };
    (of_fitted * fitted + scaled + scored + labelled.len()) as u64
}

/// Makes the nominal domains of a reference and the thresholds that keep the wanted rate of false alarms.
///
/// The first domain is the simulation. Every second drive of each domain makes histograms or moments, and the others
/// scale the gaps of windows. The rate is set on three of every four drives of `held_out` and judged on the fourth.
/// Without held-out drives, the rate is set on the drives that scale the gaps, and the reference says so. `labelled`
/// frames are only for the metric `lane-risk`.
///
/// Drives are looked at several times, and each thread holds one drive at a time. In between, less than 100 bytes are
/// kept for each frame. The result does not depend on the number of threads.
///
/// # Errors
/// When a frame cannot be judged, when there are too few frames, or when a drive can no longer be read.
pub fn calibrate<D: SurveyedDrive, L: LabelledDrive>(
    domains: &[Domain<'_, D>],
    held_out: &[D],
    labelled: &[L],
    taps: &[String],
    wanted: Target,
) -> Result<Calibrated, CalibrationError> {
    let mut sources = Vec::new();
    let mut components: Vec<Component> = Vec::new();
    let mut scaling: Vec<Stretch<'_, D>> = Vec::new();
    let mut simulation: Option<Vec<Moments>> = None;
    for (index, domain) in domains.iter().enumerate() {
        let splits = split(domain.drives);
        sources.extend(splits.iter().map(|split| SourceUse {
            source: split.drive.source().to_owned(),
            role: Some(match index {
                0 => Role::Simulation,
                _ => Role::Accepted,
            }),
            frames: split.drive.frames() as u64,
            fitted: split.fitted as u64,
            held_out: split.rest().range.len() as u64,
        }));
        let some = |stretch: &Stretch<'_, D>| !stretch.range.is_empty();
        let fitted: Vec<_> = splits.iter().map(Split::fitted).filter(some).collect();
        let scaled: Vec<_> = splits.iter().map(Split::rest).filter(some).collect();
        let found: usize = scaled.iter().map(|stretch| stretch.range.len()).sum();
        if found < HELD_OUT_MIN {
            return Err(CalibrationError::TooFew(Undefined::TooFewImages {
                found,
                wanted: HELD_OUT_MIN,
            }));
        }
        let fitting = Fitting {
            fitted: &fitted,
            taps,
            metric: wanted.metric,
        };
        let taps = match wanted.metric.divergence() {
            Some(_) => fitting.histograms()?,
            None => {
                let (peaks, moments) = fitting.moments(components.first())?;
                let taps = fitting.energies(
                    &peaks,
                    &moments,
                    simulation.as_deref(),
                    components.first(),
                    labelled,
                )?;
                simulation.get_or_insert(moments);
                taps
            }
        };
        let mut component = Component {
            name: domain.name.clone(),
            taps,
        };
        scale(&mut component, &scaled, wanted)?;
        components.push(component);
        scaling.extend(scaled);
    }
    sources.extend(held_out.iter().map(|drive| SourceUse {
        source: drive.source().to_owned(),
        role: Some(Role::HeldOut),
        frames: drive.frames() as u64,
        fitted: 0,
        held_out: drive.frames() as u64,
    }));
    let optimistic = held_out.is_empty();
    if !optimistic {
        let whole = held_out.iter().map(|drive| Stretch {
            drive,
            range: 0..drive.frames(),
        });
        scaling = whole.collect();
    }
    let drives = look_at_all(&scaling, |part| part.scores(wanted, &components))?;
    let false_alarms = false_alarms::calibrated(&drives, wanted.false_alarms_per_hour, optimistic);
    for tap in components
        .iter_mut()
        .flat_map(|component| &mut component.taps)
    {
        for point in &mut tap.scale {
            point.threshold = point.median + false_alarms.factor * (point.threshold - point.median);
        }
    }
    Ok(Calibrated {
        components,
        false_alarms,
        sources,
    })
}

/// Scales the gaps of a domain with the gaps of windows of its own drives.
fn scale<D: SurveyedDrive>(
    component: &mut Component,
    scaled: &[Stretch<'_, D>],
    wanted: Target,
) -> Result<(), CalibrationError> {
    let own = std::slice::from_ref(&*component);
    // [drives][taps][window lengths][windows]
    let gaps = look_at_all(scaled, |part| {
        let track = part.track(wanted.metric, own)?;
        let mut from = 0;
        let of_taps = own[0].taps.iter().map(|tap| {
            let columns = from..from + tap.nominal.len();
            from = columns.end;
            let lengths = WINDOW_FRAMES
                .iter()
                .map(|&frames| track.gaps(columns.clone(), frames, &tap.nominal, wanted));
            let gaps: Result<Vec<_>, _> = lengths.collect();
            gaps.map_err(|why| wrong(&tap.tap, wanted.metric, why))
        });
        of_taps.collect::<Result<Vec<_>, _>>()
    })?;
    for (index, tap) in component.taps.iter_mut().enumerate() {
        let points = WINDOW_FRAMES.into_iter().enumerate();
        tap.scale = points
            .filter_map(|(length, frames)| {
                let of_drives = gaps.iter().flat_map(|drive| &drive[index][length]);
                scale_point(of_drives.copied().collect(), frames)
            })
            .collect();
    }
    Ok(())
}

/// Median and threshold of the gaps of windows of `frames` frames; `None` without enough windows.
fn scale_point(mut gaps: Vec<f64>, frames: usize) -> Option<ScalePoint> {
    let windows = gaps.len();
    gaps.sort_by(f64::total_cmp);
    let high = quantile(&gaps, THRESHOLD_QUANTILE);
    let (Some(median), Some(high)) = (median(gaps), high) else {
        return None;
    };
    // A metric that cannot distinguish windows still gets a threshold above its median.
    let threshold = high.max(median + SPREAD_MIN);
    (windows >= 2).then_some(ScalePoint {
        frames,
        windows,
        median,
        threshold,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp, clippy::cast_precision_loss)]
    use std::borrow::Cow;
    use std::time::Duration;

    use super::super::binning::tests::ramp;
    use super::*;
    use crate::calibration::drive::{LabelledMeans, StoreError};
    use crate::calibration::survey::{Survey, SurveyFrame};
    use crate::features::energies::BlockMeans;
    use crate::reference::gap::Divergence;

    const LOG_ENERGY: Metric = Metric::LogEnergy(Divergence::JensenShannon);
    const ATTENTION: Metric = Metric::Attention(Divergence::JensenShannon);

    /// A drive that counts how often it is looked at.
    struct Counted(Survey, std::sync::atomic::AtomicU64);

    impl SurveyedDrive for Counted {
        fn source(&self) -> &str {
            &self.0.source
        }

        fn frames(&self) -> usize {
            self.0.frames.len()
        }

        fn survey(&self) -> Result<Cow<'_, Survey>, StoreError> {
            self.1.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            Ok(Cow::Borrowed(&self.0))
        }
    }

    /// A drive of 60 frames, each with a different map.
    fn counted(seed: usize) -> Counted {
        let frames = (0..60).map(|frame| {
            let map = ramp(100 * (seed + frame), 100 * (seed + frame) + 64);
            let energy = map.energy.iter().take(20).copied().collect();
            Ok(SurveyFrame {
                peaks: vec![map.range().1],
                means: vec![BlockMeans {
                    activation: vec![1.0; 4],
                    energy,
                }],
                maps: vec![map],
            })
        });
        let survey = Survey {
            source: format!("drive {seed}"),
            times: (0..60).map(|i| Duration::from_millis(100 * i)).collect(),
            frames: frames.collect(),
            common_size: (64, 1),
        };
        Counted(survey, Default::default())
    }

    #[test]
    fn looks_are_as_many_as_were_foretold() {
        for metric in [Metric::Mahalanobis, LOG_ENERGY, ATTENTION] {
            for (fitting, held_out) in [(1, 0), (4, 0), (5, 3)] {
                let drives: Vec<Counted> = (0..fitting).map(counted).collect();
                let held_out: Vec<Counted> = (0..held_out).map(|i| counted(20 + i)).collect();
                let domain = Domain {
                    name: "simulation".to_owned(),
                    drives: &drives,
                };
                let wanted = Target {
                    metric,
                    window_s: 1.0,
                    false_alarms_per_hour: 1.0,
                };
                let domains = [domain];
                let none: &[LabelledMeans] = &[];
                let predicted = looks(&domains, &held_out, none, metric);
                calibrate(&domains, &held_out, none, &["e2".to_owned()], wanted).unwrap();
                let all = drives.iter().chain(&held_out);
                let looked: u64 = all
                    .map(|d| d.1.load(std::sync::atomic::Ordering::Relaxed))
                    .sum();
                assert_eq!(looked, predicted, "{metric}, {fitting} drives");
            }
        }
    }
}
