//! Spans of nominal drives → their nominal distances.

use std::time::Duration;

use super::error::{CalibrationError, wrong};
use super::stretch::{Stretch, look_at_folds};
use super::timed::TimedMoments;
use super::windows::Part;
use crate::calibration::drive::SurveyedDrive;
use crate::capture::undefined::Undefined;
use crate::monitor::history::BIN;
use crate::monitor::span_watch::SpanWatch;
use crate::monitor::unrest::Unrest;
use crate::reference::gap::Metric;
use crate::reference::gap::energy_norm::{EnergyNorm, SPANS_OWN};
use crate::reference::{Component, SPREAD_MIN, SpanNorm};
use crate::statistics::quantile::{median, quantile};

/// Share of nominal distances below which the past is not held. It also sets the relative weight of the taps.
const HELD_QUANTILE: f64 = 0.99;
/// Smallest number of distances of an accepted domain for a scale of its own.
const DISTANCES_MIN: usize = 100;

/// Whether the fitted drives of the simulation are long enough for all spans.
pub fn are_long_enough(moments: &TimedMoments) -> bool {
    moments
        .spans
        .iter()
        .all(|span| span.independent >= SPANS_OWN)
}

/// Adds what is nominal over the spans to each tap of a domain; distances are not scaled yet. `simulation` is given for
/// an accepted domain.
pub fn fit(
    component: &mut Component,
    epsilons: &[f64],
    own: &TimedMoments,
    simulation: Option<&Component>,
) -> Result<(), CalibrationError> {
    for (tap, of) in component.taps.iter_mut().enumerate() {
        for (index, span) in own.spans.iter().enumerate() {
            let moments = &span.taps[tap];
            let wider = simulation.map(|of| &of.taps[tap].spans[index].norm);
            let norm = if span.span.is_change() {
                let windows = &own.window[tap];
                EnergyNorm::fit_changes(epsilons[tap], moments, windows, span.independent, wider)
            } else {
                let (drives, wider) = (span.independent, wider);
                // A domain without one whole span has the mean of its windows.
                let moments = match moments.frames() {
                    0 | 1 => &own.window[tap],
                    _ => moments,
                };
                EnergyNorm::fit(epsilons[tap], moments, wider.map(|of| (of, drives)))
            };
            let norm = norm.map_err(|why| wrong(&of.tap, Metric::Mahalanobis, why))?;
            of.spans.push(SpanNorm {
                span: span.span,
                norm,
                windows: 0,
                median: 0.0,
                held_from: SPREAD_MIN,
                threshold: SPREAD_MIN,
            });
        }
    }
    Ok(())
}

/// Scales the distances of a domain with those of its own drives, each from what its fold has fitted. `simulation` is
/// given for an accepted domain, whose scale is not narrower while its drives show few distances.
pub fn scale<D: SurveyedDrive>(
    component: &mut Component,
    folds: &[(&Component, &[Stretch<'_, D>])],
    simulation: Option<&Component>,
) -> Result<(), CalibrationError> {
    // [drives][taps][spans][distances]
    let mut distances = look_at_folds(folds, distances_of)?;
    let spans = component.spans();
    for (tap, of) in component.taps.iter_mut().enumerate() {
        for (span, norm) in of.spans.iter_mut().enumerate() {
            let all: Vec<f64> = distances
                .iter()
                .flat_map(|drive| &drive[tap][span])
                .copied()
                .collect();
            norm.windows = all.len();
            let wider = simulation.map(|of| of.taps[tap].spans[span].median);
            norm.median = match (median(all), wider) {
                (Some(own), None) => own,
                (Some(own), Some(_)) if norm.windows >= DISTANCES_MIN => own,
                (Some(own), Some(wider)) => own.max(wider),
                (None, Some(wider)) => wider,
                (None, None) => {
                    return Err(wrong(&of.tap, Metric::Mahalanobis, Undefined::NoScore));
                }
            };
        }
    }
    let changes = (0..spans).filter(|&span| component.taps[0].spans[span].span.is_change());
    for span in changes {
        let medians: Vec<f64> = component
            .taps
            .iter()
            .map(|of| of.spans[span].median)
            .collect();
        distances
            .iter_mut()
            .for_each(|drive| calm(drive, span, &medians));
    }
    for (tap, of) in component.taps.iter_mut().enumerate() {
        for (span, norm) in of.spans.iter_mut().enumerate() {
            let all = distances.iter().flat_map(|drive| &drive[tap][span]);
            let mut all: Vec<f64> = all.copied().collect();
            all.sort_by(f64::total_cmp);
            let wider = simulation.map(|of| of.taps[tap].spans[span].held_from);
            let high = match (quantile(&all, HELD_QUANTILE), wider) {
                (Some(own), Some(wider)) if norm.windows < DISTANCES_MIN => own.max(wider),
                (own, wider) => own.or(wider).unwrap_or(norm.median),
            };
            norm.held_from = high.max(norm.median + SPREAD_MIN);
            norm.threshold = norm.held_from;
        }
    }
    Ok(())
}

/// Divides the distances of a drive's changes by how much its road changes anyway, as the monitor does.
fn calm(drive: &mut [Vec<Vec<f64>>], span: usize, medians: &[f64]) {
    let mut unrest = Unrest::default();
    let bins = drive.first().map_or(0, |of| of[span].len());
    for bin in 0..bins {
        let level = unrest.level();
        let relative = drive
            .iter()
            .zip(medians)
            .map(|(of, median)| of[span][bin] / median);
        unrest.push(relative.fold(0.0, f64::max));
        drive.iter_mut().for_each(|of| of[span][bin] /= level);
    }
}

/// Distances of a part of a drive, `[taps][spans][distances]`, one every half a second.
fn distances_of(
    part: &Part<'_>,
    own: &[Component],
) -> Result<Vec<Vec<Vec<f64>>>, CalibrationError> {
    let track = part.track(Metric::Mahalanobis, own)?;
    let mut watch = SpanWatch::new(own, Duration::ZERO);
    let mut found = vec![vec![Vec::new(); watch.len()]; own[0].taps.len()];
    let mut deviations = vec![0.0; Component::taken_len(own)];
    let mut next = Duration::ZERO;
    for (at, levels) in track.frames() {
        watch.add(at, levels);
        if at < next {
            continue;
        }
        next = at + BIN;
        for span in 0..watch.len() {
            let Some(levels) = watch.levels(span) else {
                continue;
            };
            for ((tap, own), found) in own[0].by_tap(levels).zip(&mut found) {
                found[span].push(tap.spans[span].norm.distance_of(own, &mut deviations));
            }
        }
    }
    Ok(found)
}
