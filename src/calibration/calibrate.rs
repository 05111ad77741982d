//! Surveys of nominal sources → reference: what is nominal, medians, and thresholds for a wanted rate of false alarms.

use std::time::Duration;

use super::drive::{LabelledDrive, LabelledMeans, SurveyedDrive};
use super::error::CalibrationError;
use super::fitting::{Fitting, epsilons_of};
use super::spans;
use super::stretch::{Stretch, Usage, look_at_all};
use super::target::Target;
use super::thresholds;
use crate::capture::undefined::Undefined;
use crate::reference::gap::Metric;
use crate::reference::{
    Component, FalseAlarms, JudgedRate, Role, SPREAD_MIN, ScalePoint, SourceUse, Span,
};
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
    /// `simulation`, or the name of an accepted domain.
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
    /// How often the road was judged.
    pub rate: JudgedRate,
}

/// How often [`calibrate`] looks at drives in total, counting each drive each time.
pub fn looks<D: SurveyedDrive, L: LabelledDrive>(
    domains: &[Domain<'_, D>],
    held_out: &[D],
    labelled: &[L],
    wanted: Target,
) -> u64 {
    // Peaks, then masses and counts for histograms, or moments.
    let of_fitted = match wanted.metric {
        Metric::LogEnergy(_) => 3,
        _ => 2,
    };
    let (mut fitted, mut scaled) = (0, 0);
    for (index, domain) in domains.iter().enumerate() {
        let (fits, scales) = usage(index, domain.drives).stretches();
        (fitted, scaled) = (fitted + fits, scaled + scales);
    }
    let scored = if held_out.is_empty() {
        scaled
    } else {
        held_out.len()
    };
    // With spans, drives are scaled twice, and scored once more; whether there will be spans is known later. With several
    // domains, drives are sorted by domain before, and scored once more after. The rate is looked at first.
    let timed = usize::from(wanted.is_timed());
    let several = if domains.len() > 1 { 2 } else { 0 };
    let (scalings, scorings) = (1 + timed, 2 + timed + several);
    (of_fitted * fitted + scalings * scaled + scorings * scored + labelled.len()) as u64
}

/// Makes the nominal domains of a reference and the thresholds that keep the wanted rate of false alarms.
///
/// The first domain is the simulation: every second drive makes histograms or moments, and the others scale the gaps of
/// windows. Every frame of an accepted domain does both, in turn. The rate is set on three of every four drives of `held_out` and judged on the fourth.
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
    for (index, domain) in domains.iter().enumerate() {
        let usage = usage(index, domain.drives);
        let role = match index {
            0 => Role::Simulation,
            _ => Role::Accepted,
        };
        sources.extend(uses(domain, &usage, role));
        let simulation = components.first();
        components.push(component_of(
            &domain.name,
            &usage,
            simulation,
            labelled,
            taps,
            wanted,
        )?);
        scaling.extend(usage.folds.into_iter().flat_map(|fold| fold.scaled));
    }
    sources.extend(held_out.iter().map(|drive| SourceUse {
        source: drive.source().to_owned(),
        role: Some(Role::HeldOut),
        domain: None,
        frames: drive.frames() as u64,
        fitted: 0,
        held_out: drive.frames() as u64,
    }));
    let optimistic = held_out.is_empty();
    if !optimistic {
        scaling = held_out.iter().map(Stretch::whole).collect();
    }
    let frames_hz = look_at_all(&scaling, |part| Ok(frames_hz(part.times())))?;
    let frames_hz = median(frames_hz.into_iter().flatten().collect());
    let rate = frames_hz.map_or(wanted.rate, |hz| wanted.rate.at_most(hz));
    let wanted = Target { rate, ..wanted };
    let false_alarms = thresholds::set(&mut components, &scaling, wanted, optimistic)?;
    Ok(Calibrated {
        components,
        false_alarms,
        sources,
        rate,
    })
}

/// The result of an acceptance.
pub struct Accepted {
    /// The accepted domains with their thresholds.
    pub components: Vec<Component>,
    /// The sources that were used.
    pub sources: Vec<SourceUse>,
    /// What stands behind each domain.
    pub shown: Vec<Shown>,
}

/// What stands behind an accepted domain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shown {
    /// Number of drives.
    pub drives: usize,
    /// Their length together, seconds.
    pub seconds: f64,
    /// Number of spans of each kind that do not overlap, in the order of [`Span::ALL`].
    pub spans: [usize; Span::ALL.len()],
}

/// Makes nominal domains beside those of a reference, without the drives of its simulation. They are the same as if
/// [`calibrate`] had made them with the simulation and with held-out drives of the simulation alone.
///
/// # Errors
/// When a frame cannot be judged, when there are too few frames, or when a drive can no longer be read.
pub fn accept<D: SurveyedDrive>(
    simulation: &Component,
    domains: &[Domain<'_, D>],
    wanted: Target,
) -> Result<Accepted, CalibrationError> {
    let taps: Vec<String> = simulation.taps.iter().map(|of| of.tap.clone()).collect();
    let none: &[LabelledMeans] = &[];
    let (mut components, mut sources, mut shown) = (Vec::new(), Vec::new(), Vec::new());
    for domain in domains {
        shown.push(shown_by(domain.drives)?);
        let usage = Usage::crossed(domain.drives);
        sources.extend(uses(domain, &usage, Role::Accepted));
        let mut component =
            component_of(&domain.name, &usage, Some(simulation), none, &taps, wanted)?;
        component.widen_like(simulation);
        components.push(component);
    }
    Ok(Accepted {
        components,
        sources,
        shown,
    })
}

fn shown_by<D: SurveyedDrive>(drives: &[D]) -> Result<Shown, CalibrationError> {
    let whole: Vec<Stretch<'_, D>> = drives.iter().map(Stretch::whole).collect();
    let lengths_s = look_at_all(&whole, |part| {
        let (times, period) = (
            part.times(),
            frames_hz(part.times()).map_or(0.0, f64::recip),
        );
        let ends = times.first().zip(times.last());
        Ok(ends.map_or(0.0, |(first, last)| (*last - *first).as_secs_f64() + period))
    })?;
    // Lengths of drives are hours at most.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let of = |span: Span| {
        let whole = lengths_s
            .iter()
            .map(|length| (length / span.length_s()) as usize);
        whole.sum()
    };
    Ok(Shown {
        drives: drives.len(),
        seconds: lengths_s.iter().sum(),
        spans: Span::ALL.map(of),
    })
}

/// How often [`accept`] looks at drives in total.
pub fn looks_to_accept<D: SurveyedDrive>(domains: &[Domain<'_, D>], wanted: Target) -> u64 {
    let (mut fitted, mut scaled) = (0, 0);
    for domain in domains {
        let (fits, scales) = Usage::crossed(domain.drives).stretches();
        (fitted, scaled) = (fitted + fits, scaled + scales);
    }
    let drives: usize = domains.iter().map(|domain| domain.drives.len()).sum();
    (drives + 2 * fitted + (1 + usize::from(wanted.is_timed())) * scaled) as u64
}

fn uses<'d, D: SurveyedDrive>(
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

/// A domain whose thresholds are the 99 % quantiles of its distances. `simulation` is given for an accepted domain.
fn component_of<D: SurveyedDrive, L: LabelledDrive>(
    name: &str,
    usage: &Usage<'_, D>,
    simulation: Option<&Component>,
    labelled: &[L],
    taps: &[String],
    wanted: Target,
) -> Result<Component, CalibrationError> {
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
    scale(&mut component, &folds, wanted)?;
    if component.spans() > 0 {
        spans::scale(&mut component, &folds, simulation)?;
    }
    Ok(component)
}

/// How the frames of the domain with this number are used.
fn usage<D: SurveyedDrive>(index: usize, drives: &[D]) -> Usage<'_, D> {
    match index {
        0 => Usage::halves(drives),
        _ => Usage::crossed(drives),
    }
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

/// Frames a second, from the median time between frames; `None` without two frames.
fn frames_hz(times: &[Duration]) -> Option<f64> {
    let pairs = times.windows(2);
    let mut steps: Vec<Duration> = pairs.map(|pair| pair[1].saturating_sub(pair[0])).collect();
    steps.sort_unstable();
    let middle = steps.get(steps.len() / 2).filter(|step| !step.is_zero())?;
    Some(1.0 / middle.as_secs_f64())
}

/// Scales the gaps of a domain with the gaps of windows of its own drives, each from what its fold has fitted.
fn scale<D: SurveyedDrive>(
    component: &mut Component,
    folds: &[(&Component, &[Stretch<'_, D>])],
    wanted: Target,
) -> Result<(), CalibrationError> {
    // [drives][taps][window lengths][windows]
    let mut gaps = Vec::new();
    for &(own, scaled) in folds {
        let own = std::slice::from_ref(own);
        gaps.extend(look_at_all(scaled, |part| {
            part.gaps(wanted, own, &WINDOW_FRAMES)
        })?);
    }
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
    use crate::calibration::drive::StoreError;
    use crate::calibration::survey::{Survey, SurveyFrame};
    use crate::features::energies::BlockMeans;
    use crate::reference::EvidenceKind;
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
                    evidence: EvidenceKind::Frames,
                    ..Target::new(metric, 1.0, 1.0)
                };
                let domains = [domain];
                let none: &[LabelledMeans] = &[];
                let predicted = looks(&domains, &held_out, none, wanted);
                calibrate(&domains, &held_out, none, &["e2".to_owned()], wanted).unwrap();
                let all = drives.iter().chain(&held_out);
                let looked: u64 = all
                    .map(|d| d.1.load(std::sync::atomic::Ordering::Relaxed))
                    .sum();
                assert_eq!(looked, predicted, "{metric}, {fitting} drives");
            }
        }
    }

    #[test]
    fn an_accepted_road_moves_no_threshold_of_the_simulation() {
        let simulation: Vec<Counted> = (0..8).map(counted).collect();
        let held_out: Vec<Counted> = (8..16).map(counted).collect();
        let road = [counted(90)];
        let domain = |name: &str, drives| Domain {
            name: name.to_owned(),
            drives,
        };
        let wanted = Target {
            evidence: EvidenceKind::Frames,
            ..Target::new(Metric::Mahalanobis, 1.0, 1.0)
        };
        let none: &[LabelledMeans] = &[];
        let taps = ["e2".to_owned()];
        let made = |domains: &[Domain<'_, Counted>]| {
            calibrate(domains, &held_out, none, &taps, wanted).unwrap()
        };
        let alone = made(&[domain("simulation", &simulation)]);
        let both = made(&[domain("simulation", &simulation), domain("road", &road)]);
        assert_eq!(both.components[0], alone.components[0]);
        assert_eq!(both.false_alarms.factor, alone.false_alarms.factor);
        // Without its drives, the simulation's domain is enough to accept the road as it was accepted with them.
        let later = accept(&alone.components[0], &[domain("road", &road)], wanted).unwrap();
        assert_eq!(later.components, both.components[1..]);
        assert_eq!(later.shown[0].drives, 1);
        assert!((later.shown[0].seconds - 6.0).abs() < 1e-6);
        assert_eq!(later.shown[0].spans, [1, 0, 0]);
        // The road has the margins of the simulation, or those that its own frames need.
        let times = |of: &Component| of.taps[0].scale[0].threshold / of.taps[0].scale[0].median;
        assert!(times(&both.components[1]) >= times(&both.components[0]) * 0.999_999);
    }
}
