//! Drives with a known cause → what changes and gaps look like under each cause.
//!
//! Of each kind, every second road makes the centres and the spread inside kinds. The others say how near a deviation
//! must be to fit, how sharp kinds are apart, and how many are told right. Another road is learnt from nominal drives: a
//! change is the difference between the windows of one and the past of another one.

use std::collections::{BTreeMap, BTreeSet};

use super::cause_names::cause_of;
use super::drive::SurveyedDrive;
use super::error::{CalibrationError, wrong};
use super::stretch::{Stretch, look_at_all};
use super::target::Target;
use super::windows::{Part, Track};
use crate::reference::cause::Cause;
use crate::reference::gap::Metric;
use crate::reference::gap::energy_norm::pooled_whitening;
use crate::reference::gap::moments::Moments;
use crate::reference::{
    CauseKind, Causes, Component, Discriminant, DiscriminantBlock, Explained, OfKinds, Role,
    SourceUse, Span,
};
use crate::statistics::quantile::quantile;

/// When deviations are taken after the onset, seconds.
const AFTER_S: [f64; 4] = [1.0, 2.0, 4.0, 8.0];
/// Weight of the diagonal in the spread inside kinds: there are not many roads.
const SHRINKAGE: f64 = 0.3;
/// Share of deviations nearer to the centre of their own kind than the distance within which a kind fits.
const FITS_QUANTILE: f64 = 0.97;
/// Deviations of a nominal drive.
const OF_NOMINAL: usize = 4;

/// What was learnt of causes.
pub struct LearntCauses {
    /// The section of a reference.
    pub causes: Causes,
    /// The drives from which it was learnt, without the nominal ones.
    pub sources: Vec<SourceUse>,
}

/// Deviations of some drives, of one kind.
struct Samples {
    cause: Cause,
    /// Whether the drive makes centres.
    fits: bool,
    change: Vec<Vec<f64>>,
    gap: Vec<Vec<f64>>,
}

/// Mean levels of one stretch of a nominal drive.
struct NominalLevels {
    window: Vec<f64>,
    recent: Vec<f64>,
    past: Vec<f64>,
}

/// Learns what causes look like to the first nominal domain, of which `simulation` are the drives. The thresholds of the
/// domain are final. The result does not depend on the number of threads.
///
/// # Errors
/// When a drive does not say its cause or cannot be judged, or when there are too few of them.
pub fn learn_causes<D: SurveyedDrive>(
    drives: &[D],
    simulation: &[D],
    domain: &Component,
    wanted: Target,
) -> Result<LearntCauses, CalibrationError> {
    if !wanted.is_timed() || domain.spans() == 0 {
        return Err(CalibrationError::Causes(
            "wanted --metric mahalanobis with --evidence windows, and drives of --sim that are long enough for changes"
                .to_owned(),
        ));
    }
    let fits = fitting_drives(drives)?;
    let whole: Vec<Stretch<'_, D>> = drives.iter().map(Stretch::whole).collect();
    let own = std::slice::from_ref(domain);
    let mut all = look_at_all(&whole, |part| of_cause(part, own, wanted))?;
    for (of, &fits) in all.iter_mut().zip(&fits) {
        of.fits = fits;
    }
    let sources = drives.iter().zip(&fits).map(|(drive, &fits)| {
        let frames = drive.frames() as u64;
        SourceUse {
            source: drive.source().to_owned(),
            role: Some(Role::Cause),
            domain: None,
            frames,
            fitted: if fits { frames } else { 0 },
            held_out: if fits { 0 } else { frames },
        }
    });
    all.extend(of_another_road(simulation, own, wanted)?);
    let mut of_kinds: BTreeMap<Cause, usize> = BTreeMap::new();
    for of in &all {
        *of_kinds.entry(of.cause).or_default() += 1;
    }
    let kinds: Vec<CauseKind> = of_kinds
        .into_iter()
        .map(|(cause, drives)| CauseKind { cause, drives })
        .collect();
    Ok(LearntCauses {
        causes: Causes {
            change: discriminant(&all, &kinds, domain, |of| &of.change)?,
            gap: discriminant(&all, &kinds, domain, |of| &of.gap)?,
            kinds,
        },
        sources: sources.collect(),
    })
}

/// Whether each drive makes centres: every second road of a kind does.
fn fitting_drives<D: SurveyedDrive>(drives: &[D]) -> Result<Vec<bool>, CalibrationError> {
    let names = drives.iter().map(|drive| cause_of(drive.source()));
    let names: Vec<_> = names
        .collect::<Result<_, _>>()
        .map_err(CalibrationError::Causes)?;
    // Drives are in their fixed order, and so are the roads of a kind.
    let mut roads: BTreeMap<Cause, Vec<&str>> = BTreeMap::new();
    let mut seen = BTreeSet::new();
    for of in &names {
        if seen.insert((of.cause, &of.road)) {
            roads.entry(of.cause).or_default().push(&of.road);
        }
    }
    if let Some((cause, _)) = roads.iter().find(|(_, roads)| roads.len() < 2) {
        return Err(CalibrationError::Causes(format!(
            "one road with {cause}; wanted two or more of every kind"
        )));
    }
    let place = |cause: Cause, road: &str| roads[&cause].iter().position(|&of| of == road);
    let even = |place: usize| place.is_multiple_of(2);
    let fits = names
        .iter()
        .map(|of| place(of.cause, &of.road).is_some_and(even));
    Ok(fits.collect())
}

/// Deviations of a drive some seconds after the onset of its condition.
fn of_cause(
    part: &Part<'_>,
    domain: &[Component],
    wanted: Target,
) -> Result<Samples, CalibrationError> {
    let name = cause_of(part.source()).map_err(CalibrationError::Causes)?;
    let span_s = Span::ALL
        .get(Explained::span())
        .map_or(0.0, |span| span.length_s());
    let mut samples = Samples {
        cause: name.cause,
        fits: false,
        change: Vec::new(),
        gap: Vec::new(),
    };
    let mut due = AFTER_S
        .iter()
        .map(|after_s| name.onset_s + after_s)
        .peekable();
    part.evidence(wanted, domain, |at, _, scorer| {
        if due.next_if(|&due| at.as_secs_f64() >= due).is_some() {
            let mut keep = |explained, into: &mut Vec<Vec<f64>>| {
                into.extend(scorer.deviation(explained, 0).map(<[f64]>::to_vec));
            };
            keep(Explained::Change, &mut samples.change);
            keep(Explained::Gap, &mut samples.gap);
        }
    })?;
    // A road that was in a gap before has no past.
    let is_long_enough = name.onset_s >= span_s && samples.gap.len() == AFTER_S.len();
    if !is_long_enough && samples.change.is_empty() {
        return Err(CalibrationError::Causes(format!(
            "{}: no change is known after {} s; wanted a condition that grows after {} s or more, and frames after it",
            part.source(),
            name.onset_s,
            span_s,
        )));
    }
    Ok(samples)
}

/// Deviations of nominal drives from each other. None if there are too few drives that are long enough.
fn of_another_road<D: SurveyedDrive>(
    simulation: &[D],
    domain: &[Component],
    wanted: Target,
) -> Result<Vec<Samples>, CalibrationError> {
    let stretches: Vec<Stretch<'_, D>> = simulation.iter().map(Stretch::whole).collect();
    let levels = look_at_all(&stretches, |part| {
        let track = part.track(Metric::Mahalanobis, domain)?;
        Ok(nominal_levels(&track, wanted.window_s))
    })?;
    let (mut all, taps) = (Vec::new(), &domain[0].taps);
    for fits in [true, false] {
        let half: Vec<&Vec<NominalLevels>> = levels
            .iter()
            .skip(usize::from(!fits))
            .step_by(2)
            .filter(|of| !of.is_empty())
            .collect();
        if half.len() < 2 {
            return Ok(Vec::new());
        }
        let others = half.iter().cycle().skip(1);
        for (own, other) in half.iter().zip(others) {
            let mut deviation = vec![0.0; Component::taken_len(domain)];
            let mut samples = Samples {
                cause: Cause::AnotherRoad,
                fits,
                change: Vec::new(),
                gap: Vec::new(),
            };
            for (now, before) in own.iter().zip(other.iter().cycle()) {
                let apart = |place: usize| now.recent[place] - before.past[place];
                let known = Explained::Change.deviation(taps, apart, &mut deviation);
                samples.change.extend(known.map(|()| deviation.clone()));
                let level = |place: usize| now.window[place];
                let known = Explained::Gap.deviation(taps, level, &mut deviation);
                samples.gap.extend(known.map(|()| deviation.clone()));
            }
            all.push(samples);
        }
    }
    Ok(all)
}

/// Mean levels of the first stretches of a drive, each as long as a change.
fn nominal_levels(track: &Track, window_s: f64) -> Vec<NominalLevels> {
    let Some(span) = Span::ALL.get(Explained::span()) else {
        return Vec::new();
    };
    let stretch = |number: usize| {
        // There are few stretches.
        #[allow(clippy::cast_precision_loss)]
        let end_s = (number + 1) as f64 * span.length_s();
        Some(NominalLevels {
            window: track.mean(end_s - window_s, end_s)?,
            recent: track.mean(end_s - span.recent_s, end_s)?,
            past: track.mean(end_s - span.length_s(), end_s - span.recent_s)?,
        })
    };
    (0..OF_NOMINAL).map_while(stretch).collect()
}

fn discriminant(
    all: &[Samples],
    kinds: &[CauseKind],
    domain: &Component,
    deviations: impl Fn(&Samples) -> &Vec<Vec<f64>>,
) -> Result<Discriminant, CalibrationError> {
    let mut blocks = Vec::new();
    let mut from = 0;
    for tap in &domain.taps {
        let own = from..from + tap.nominal.len();
        from = own.end;
        let mut levels = vec![0; own.len()];
        let of_kinds = kinds.iter().map(|kind| {
            let mut moments = Moments::new(own.len());
            let fitting = all.iter().filter(|of| of.fits && of.cause == kind.cause);
            for deviation in fitting.flat_map(&deviations) {
                moments.add_differences(&deviation[own.clone()], &mut levels);
            }
            moments
        });
        let of_kinds: Vec<Moments> = of_kinds.collect();
        let whitening = pooled_whitening(&of_kinds, SHRINKAGE)
            .map_err(|why| wrong(&tap.tap, Metric::Mahalanobis, why))?;
        let centres = of_kinds.iter().map(|of| of.mean_difference());
        let centres = centres.map(|centre| DiscriminantBlock::whitened(&whitening, &centre));
        blocks.push(DiscriminantBlock {
            centres: centres.collect(),
            whitening,
        });
    }
    let mut discriminant = Discriminant {
        blocks,
        fits_within: 1.0,
        sharpness: 1.0,
        judged: 0,
        right: 0,
    };
    // Distances of the deviations that made no centre, with the place of their own kind.
    let mut judged: Vec<(usize, OfKinds)> = Vec::new();
    for of in all.iter().filter(|of| !of.fits) {
        let own = kinds.iter().position(|kind| kind.cause == of.cause);
        let distances = deviations(of).iter().map(|of| discriminant.distances(of));
        judged.extend(
            own.into_iter()
                .flat_map(|own| distances.clone().map(move |of| (own, of))),
        );
    }
    let mut own: Vec<f64> = judged.iter().map(|(own, of)| of[*own]).collect();
    own.sort_by(f64::total_cmp);
    let fits_within = quantile(&own, FITS_QUANTILE).filter(|within| *within > 0.0);
    discriminant.fits_within = fits_within.ok_or_else(|| {
        CalibrationError::Causes("no drive that made no centre shows a deviation".to_owned())
    })?;
    discriminant.sharpness = sharpest(&discriminant, &judged);
    discriminant.judged = judged.len();
    discriminant.right = judged
        .iter()
        .filter(|(own, distances)| {
            let (kinds, other) = discriminant.probabilities(distances);
            let most = kinds.iter().copied().fold(other, f64::max);
            kinds[*own] >= most
        })
        .count();
    Ok(discriminant)
}

/// The sharpness under which the kinds that were true are most probable, among powers of the square root of 2.
fn sharpest(discriminant: &Discriminant, judged: &[(usize, OfKinds)]) -> f64 {
    let likelihood = |sharpness: f64| {
        let of = Discriminant {
            sharpness,
            blocks: Vec::new(),
            ..*discriminant
        };
        let logs = judged.iter().map(|(own, distances)| {
            let (kinds, _) = of.probabilities(distances);
            // A kind that is all but impossible does not decide alone.
            kinds[*own].max(1e-6).ln()
        });
        logs.sum::<f64>()
    };
    let all = (-2..=20).map(|half| 2.0_f64.powf(0.5 * f64::from(half)));
    let best = all.max_by(|&a, &b| likelihood(a).total_cmp(&likelihood(b)));
    best.unwrap_or(1.0)
}

#[cfg(test)]
mod tests;
