//! The head of the page: the verdict, what was judged, and the drive in five numbers.

use maud::{Markup, Render, html};

use super::answers::strict_note;
use super::content::Report;
use super::states::sign;
use super::text::{Number, Text};
use crate::monitor::alarm::AlarmState;

/// The verdict over a journal of that name, and where the journal is from.
pub fn header(report: &Report, name: &str) -> Markup {
    let (state, verdict) = verdict(report);
    let (about, began) = (&report.about, &report.began);
    html! {
        header {
            p.brand { "gapwatch report" }
            h1 { (sign(state)) " " (verdict) }
            p.what {
                (Text(name))
                @if !about.source.is_empty() { " · " (Text(&about.source)) }
                @if !began.utc.is_empty() {
                    " · began " (Text(&began.utc))
                    @if !began.is_set { " by a clock that was not set" }
                }
                @if report.about.live { ", seen live" }
                @if report.breaks_off { " · the run was ended while it wrote its last line, which is left out" }
            }
            @if let Some(note) = strict_note(&report.about) { p.note #strict { (Text(&note)) } }
        }
    }
}

fn verdict(report: &Report) -> (AlarmState, String) {
    let gaps = report
        .alarms()
        .iter()
        .filter(|a| a.state == AlarmState::Gap);
    match (gaps.count(), judged_share(report)) {
        (0, None) => (AlarmState::Init, "Nothing was judged".to_owned()),
        (0, Some(share)) if share < 0.9 => (
            AlarmState::Unavailable,
            "No gap was seen, but less than 90 % of the drive was judged".to_owned(),
        ),
        (0, _) => (AlarmState::Ok, "No gap".to_owned()),
        (1, _) => (AlarmState::Gap, "One gap".to_owned()),
        (count, _) => (AlarmState::Gap, format!("{count} gaps")),
    }
}

/// Share of the time after the start in which there was a verdict.
fn judged_share(report: &Report) -> Option<f64> {
    let started = report.span_s() - report.in_state_s(AlarmState::Init);
    (started > 0.0).then(|| {
        let judged = [AlarmState::Ok, AlarmState::Suspect, AlarmState::Gap];
        judged
            .map(|state| report.in_state_s(state))
            .iter()
            .sum::<f64>()
            / started
    })
}

/// The drive in five numbers.
pub fn tiles(report: &Report) -> Markup {
    let span = report.span_s();
    let gap = report.in_state_s(AlarmState::Gap);
    let gap_share = 100.0 * gap / span.max(1e-9);
    let scores = report.entries.iter().filter_map(|e| e.score);
    let best = scores.max_by(f64::total_cmp);
    let judged = judged_share(report).map(|share| 100.0 * share);
    let frames = report.entries.iter().filter(|e| e.sequence.is_some());
    let frames = frames.count();
    let latency = report.latency_ms([0.5, 0.99]);
    let with_unit = |number: Option<f64>, unit: &str| {
        number.map_or("–".to_owned(), |number| format!("{number:.1} {unit}"))
    };
    html! {
        section.tiles aria-label="Summary" {
            (tile("span", "Drive", format!("{span:.1} s"), format!("{frames} frames")))
            (tile("in-gap", "In Gap", format!("{gap:.1} s"), format!("{gap_share:.1} % of the drive")))
            (tile("score-max", "Largest score", Number(best, 2), "alarm threshold: 1"))
            (tile("judged", "Judged", with_unit(judged, "%"), "of the time after the start"))
            (tile(
                "latency",
                "Latency, median",
                with_unit(latency.map(|[p50, _]| p50), "ms"),
                latency.map_or(String::new(), |[_, p99]| format!("99 % below {p99:.1} ms")),
            ))
        }
    }
}

fn tile(id: &str, label: &str, value: impl Render, note: impl Render) -> Markup {
    html! {
        div.tile {
            span.label { (label) }
            strong #(id) { (value) }
            span.note { (note) }
        }
    }
}
