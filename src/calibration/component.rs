//! Drives of one domain → what is nominal in it, with thresholds that are quantiles of its own distances.

use super::distance::DriveDistance;
use super::drive::{LabelledDrive, SurveyedDrive};
use super::error::CalibrationError;
use super::far;
use super::fitting::{Fitting, epsilons_of};
use super::spans;
use super::stretch::{Stretch, Usage, look_at_folds};
use super::target::{THRESHOLD_QUANTILE, Target};
use crate::capture::undefined::Undefined;
use crate::reference::{Component, Role, SPREAD_MIN, ScalePoint, SourceUse};
use crate::statistics::quantile::{median, quantile};

/// Window lengths, frames, for which medians and thresholds are kept.
const WINDOW_FRAMES: [usize; 5] = [1, 2, 5, 10, 20];
/// Smallest number of held-out frames for a scale.
const HELD_OUT_MIN: usize = 20;

/// Nominal drives of one domain.
pub struct Domain<'a, D> {
    /// `simulation`, or the name of an accepted domain.
    pub name: String,
    /// Its drives.
    pub drives: &'a [D],
}

/// What the drives of a domain are used for.
pub fn uses<'d, D: SurveyedDrive>(
    domain: &Domain<'d, D>,
    usage: &Usage<'d, D>,
    role: Role,
) -> Vec<SourceUse> {
    let of = |drive: &D| {
        let (fitted, held_out) = usage.frames_of(drive);
        SourceUse {
            source: drive.source().to_owned(),
            role: Some(role),
            domain: (role == Role::Accepted).then(|| domain.name.clone()),
            frames: drive.frames() as u64,
            fitted: fitted as u64,
            held_out: held_out as u64,
        }
    };
    domain.drives.iter().map(of).collect()
}

/// A domain, and how far its drives are from each other.
pub struct Made {
    /// The domain, whose thresholds are the 99 % quantiles of its distances.
    pub component: Component,
    /// Of an accepted domain with three drives or more, the distance of each drive from the others.
    pub distances: Vec<DriveDistance>,
}

/// A domain whose thresholds are the 99 % quantiles of its distances. `simulation` is given for an accepted domain.
pub fn component_of<D: SurveyedDrive, L: LabelledDrive>(
    name: &str,
    usage: &Usage<'_, D>,
    simulation: Option<&Component>,
    labelled: &[L],
    taps: &[String],
    wanted: Target,
) -> Result<Made, CalibrationError> {
    let scaled = usage.folds.iter().flat_map(|fold| &fold.scaled);
    let found: usize = scaled.map(|stretch| stretch.range.len()).sum();
    if found < HELD_OUT_MIN {
        return Err(CalibrationError::TooFew(Undefined::TooFewImages {
            found,
            wanted: HELD_OUT_MIN,
        }));
    }
    let fit = |fitted: &[Stretch<'_, D>]| {
        let fitting = Fitting {
            fitted,
            taps,
            metric: wanted.metric,
        };
        fitted_component(name, &fitting, simulation, labelled, wanted)
    };
    let mut component = fit(&usage.fitted)?;
    let mut of_folds = Vec::new();
    for fold in &usage.folds {
        of_folds.push(match &fold.fitted {
            Some(fitted) => fit(fitted)?,
            None => component.clone(),
        });
    }
    let scaled = usage.folds.iter().map(|fold| fold.scaled.as_slice());
    let folds: Vec<(&Component, &[Stretch<'_, D>])> = of_folds.iter().zip(scaled).collect();
    let gaps = scale(&mut component, &folds, wanted)?;
    let distances = match simulation {
        None => Vec::new(),
        Some(simulation) => {
            let stretches: Vec<_> = folds.iter().flat_map(|(_, scaled)| *scaled).collect();
            far::among(&component, simulation, &stretches, &gaps, wanted)
        }
    };
    if component.spans() > 0 {
        spans::scale(&mut component, &folds, simulation)?;
    }
    Ok(Made {
        component,
        distances,
    })
}

/// What is nominal in a domain, with distances that are not scaled yet. `simulation` is given for an accepted domain.
fn fitted_component<D: SurveyedDrive, L: LabelledDrive>(
    name: &str,
    fitting: &Fitting<'_, D>,
    simulation: Option<&Component>,
    labelled: &[L],
    wanted: Target,
) -> Result<Component, CalibrationError> {
    let mut component = Component {
        name: name.to_owned(),
        taps: Vec::new(),
    };
    if wanted.metric.divergence().is_some() {
        component.taps = fitting.histograms()?;
        return Ok(component);
    }
    let peaks = fitting.median_peaks()?;
    let epsilons = epsilons_of(&peaks, simulation);
    let timed = wanted
        .is_timed()
        .then(|| fitting.timed_moments(&epsilons, wanted.window_s));
    let timed = timed.transpose()?;
    let of_frames = match &timed {
        Some(_) => None,
        None => Some(fitting.frame_moments(&epsilons)?),
    };
    let moments = of_frames.as_ref().or(timed.as_ref().map(|of| &of.window));
    component.taps = fitting.energies(
        &peaks,
        &epsilons,
        moments.map_or(&[], Vec::as_slice),
        simulation,
        labelled,
    )?;
    let timed = timed.filter(|of| match simulation {
        None => spans::are_long_enough(of),
        Some(simulation) => simulation.spans() > 0,
    });
    if let Some(timed) = timed {
        spans::fit(&mut component, &epsilons, &timed, simulation)?;
    }
    Ok(component)
}

/// Scales the gaps of a domain with the gaps of windows of its own drives, each from what its fold has fitted. Returns these
/// gaps, `[stretches][taps][window lengths][windows]`.
fn scale<D: SurveyedDrive>(
    component: &mut Component,
    folds: &[(&Component, &[Stretch<'_, D>])],
    wanted: Target,
) -> Result<Vec<Vec<Vec<Vec<f64>>>>, CalibrationError> {
    // [drives][taps][window lengths][windows]
    let gaps = look_at_folds(folds, |part, own| part.gaps(wanted, own, &WINDOW_FRAMES))?;
    for (index, tap) in component.taps.iter_mut().enumerate() {
        let points = WINDOW_FRAMES.into_iter().enumerate();
        tap.scale = points
            .filter_map(|(length, frames)| {
                let of_drives = gaps.iter().flat_map(|drive| &drive[index][length]);
                scale_point(of_drives.copied().collect(), frames)
            })
            .collect();
    }
    Ok(gaps)
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
