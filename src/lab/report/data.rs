//! The numbers that the script draws.

use serde::Serialize;

use super::alarms::ALARMS_MAX;
use super::content::Report;
use super::states::{self, STATES};
use crate::record::journal::Entry;
use crate::reference::cause::Cause;

/// Most lines that are drawn; of longer journals, per stretch the lines with the smallest and the largest gap and all
/// changes of state.
const DRAWN_MAX: usize = 20_000;

/// What the script draws.
#[derive(Serialize)]
pub struct Data<'a> {
    t: Vec<f64>,
    state: Vec<usize>,
    states: [&'static str; 6],
    gap: Vec<Option<f64>>,
    change: Vec<Option<f64>>,
    /// Shares of 1.
    lanes: Vec<Option<f64>>,
    /// Place of the likely cause in `causes`.
    cause: Vec<Option<usize>>,
    probability: Vec<Option<f64>>,
    causes: [&'static str; 12],
    latency: Vec<f64>,
    /// Place of the reason in `healths`; 0 is `ok`.
    health: Vec<usize>,
    healths: Vec<&'a str>,
    taps: Vec<Tap<'a>>,
    alarms: Vec<(f64, f64, &'static str)>,
}

#[derive(Serialize)]
struct Tap<'a> {
    name: &'a str,
    gap: Vec<Option<f64>>,
}

/// The lines to draw, by place.
pub fn drawn(entries: &[Entry]) -> Vec<usize> {
    if entries.len() <= DRAWN_MAX {
        return (0..entries.len()).collect();
    }
    let stretch = entries.len().div_ceil(DRAWN_MAX / 4);
    let mut places = Vec::new();
    for from in (0..entries.len()).step_by(stretch) {
        let to = (from + stretch).min(entries.len());
        let by_gap = |&a: &usize, &b: &usize| {
            let gap = |i: usize| entries[i].gap.unwrap_or(f64::NEG_INFINITY);
            gap(a).total_cmp(&gap(b))
        };
        places.extend((from..to).min_by(by_gap));
        places.extend((from..to).max_by(by_gap));
        places.extend((from.max(1)..to).filter(|&i| entries[i].state != entries[i - 1].state));
    }
    places.push(entries.len() - 1);
    places.sort_unstable();
    places.dedup();
    places
}

fn place_of_cause(entry: &Entry) -> Option<usize> {
    let likely = entry.cause?;
    Cause::ALL.iter().position(|cause| *cause == likely.cause)
}

/// The numbers of a report.
pub fn data(report: &Report) -> Data<'_> {
    let lines: Vec<&Entry> = drawn(&report.entries)
        .into_iter()
        .map(|place| &report.entries[place])
        .collect();
    let mut healths = vec!["ok"];
    let health = lines
        .iter()
        .map(|entry| {
            healths
                .iter()
                .position(|h| *h == entry.health)
                .unwrap_or_else(|| {
                    healths.push(&entry.health);
                    healths.len() - 1
                })
        })
        .collect();
    Data {
        t: lines.iter().map(|e| e.t_s).collect(),
        state: lines.iter().map(|e| states::place(e.state)).collect(),
        states: STATES.map(|(state, _)| state.name()),
        gap: lines.iter().map(|e| e.gap).collect(),
        change: lines.iter().map(|e| e.change).collect(),
        lanes: lines.iter().map(|e| e.lanes).collect(),
        cause: lines.iter().map(|e| place_of_cause(e)).collect(),
        probability: lines.iter().map(|e| Some(e.cause?.probability)).collect(),
        causes: Cause::ALL.map(Cause::name),
        latency: lines.iter().map(|e| e.latency_ms).collect(),
        health,
        healths,
        taps: report
            .taps
            .iter()
            .map(|name| Tap {
                name,
                gap: lines
                    .iter()
                    .map(|e| e.tap_gap.get(name).copied().flatten())
                    .collect(),
            })
            .collect(),
        alarms: report
            .alarms()
            .iter()
            .take(ALARMS_MAX)
            .map(|a| (a.from_s, a.to_s, a.state.name()))
            .collect(),
    }
}
