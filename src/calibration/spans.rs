//! Spans of nominal drives → their nominal distances.

use std::time::Duration;

use super::error::{CalibrationError, wrong};
use super::stretch::{Stretch, look_at_all};
use super::timed::TimedMoments;
use super::windows::Part;
use crate::calibration::drive::SurveyedDrive;
use crate::capture::undefined::Undefined;
use crate::monitor::history::BIN;
use crate::monitor::span_watch::SpanWatch;
use crate::reference::gap::Metric;
use crate::reference::gap::moments::{EnergyNorm, SPANS_OWN};
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
    simulation: Option<&TimedMoments>,
) -> Result<(), CalibrationError> {
    for (tap, of) in component.taps.iter_mut().enumerate() {
        for (index, span) in own.spans.iter().enumerate() {
            let moments = &span.taps[tap];
            let wider = simulation.map(|of| &of.spans[index].taps[tap]);
            let norm = if span.span.is_change() {
                EnergyNorm::fit_changes(epsilons[tap], moments, span.independent, wider)
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

/// Scales the distances of a domain with those of its own drives. `simulation` is given for an accepted domain, whose
/// scale is not narrower while its drives show few distances.
pub fn scale<D: SurveyedDrive>(
    component: &mut Component,
    scaled: &[Stretch<'_, D>],
    simulation: Option<&Component>,
) -> Result<(), CalibrationError> {
    let own = std::slice::from_ref(&*component);
    // [drives][taps][spans][distances]
    let distances = look_at_all(scaled, |part| distances(part, own))?;
    for (tap, of) in component.taps.iter_mut().enumerate() {
        for (span, norm) in of.spans.iter_mut().enumerate() {
            let all = distances.iter().flat_map(|drive| &drive[tap][span]);
            let mut all: Vec<f64> = all.copied().collect();
            all.sort_by(f64::total_cmp);
            norm.windows = all.len();
            let high = quantile(&all, HELD_QUANTILE);
            let found = median(all).zip(high);
            let wider = simulation.map(|of| &of.taps[tap].spans[span]);
            let (middle, high) = match (found, wider) {
                (Some(found), None) => found,
                (Some(found), Some(_)) if norm.windows >= DISTANCES_MIN => found,
                (Some((middle, high)), Some(wider)) => {
                    (middle.max(wider.median), high.max(wider.held_from))
                }
                (None, Some(wider)) => (wider.median, wider.held_from),
                (None, None) => {
                    return Err(wrong(&of.tap, Metric::Mahalanobis, Undefined::NoScore));
                }
            };
            norm.median = middle;
            norm.held_from = high.max(middle + SPREAD_MIN);
            norm.threshold = norm.held_from;
        }
    }
    Ok(())
}

/// Distances of a part of a drive, `[taps][spans][distances]`, one every half a second.
fn distances(part: &Part<'_>, own: &[Component]) -> Result<Vec<Vec<Vec<f64>>>, CalibrationError> {
    let track = part.track(Metric::Mahalanobis, own)?;
    let mut watch = SpanWatch::new(own, Duration::ZERO);
    let taps = &own[0].taps;
    let mut found = vec![vec![Vec::new(); watch.len()]; taps.len()];
    let mut deviations = vec![0.0; Component::taken_len(own)];
    let mut next = Duration::ZERO;
    for (at, levels) in track.frames() {
        watch.add(at, levels);
        if at < next {
            continue;
        }
        next = at + BIN;
        for span in 0..watch.len() {
            let Some(mut levels) = watch.levels(span) else {
                continue;
            };
            for (tap, found) in taps.iter().zip(&mut found) {
                let (own, rest) = levels.split_at(tap.nominal.len());
                levels = rest;
                found[span].push(tap.spans[span].norm.distance_of(own, &mut deviations));
            }
        }
    }
    Ok(found)
}
