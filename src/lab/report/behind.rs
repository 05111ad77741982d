//! What is behind an alarm: a closer look, the taps at its beginning and worst, and the lines around its beginning.

use base64::display::Base64Display;
use base64::engine::general_purpose::STANDARD;
use maud::{Markup, html};

use super::chart;
use super::content::{Alarm, Lines, Report, Shown, ShownEvent};
use super::states::badge;
use super::table::Column::{Numbers, Words};
use super::table::head;
use super::text::{Number, Percent, Plain, Text};
use crate::record::journal::Entry;

/// Lines shown of an alarm: around its beginning.
const SHOWN_BEFORE: usize = 3;
const SHOWN_AFTER: usize = 6;

/// All that is known of an alarm, with what is kept of it.
pub fn behind(report: &Report, alarm: &Alarm, shown: Option<&ShownEvent>) -> Markup {
    let Lines { first, next, .. } = alarm.lines;
    let from = first.saturating_sub(SHOWN_BEFORE);
    let to = (first + SHOWN_AFTER)
        .min(next + 1)
        .min(report.entries.len());
    html! {
        div.closer data-from=(alarm.from_s) data-to=(alarm.to_s) {}
        @if let Some(suspected_s) = alarm.suspected_s {
            p { "Suspected since " (format_args!("{suspected_s:.1} s")) "." }
        }
        @if let Some(shown) = shown { (evidence(shown)) }
        h3 { "By tap" }
        (taps(report, alarm))
        @if !alarm.health.is_empty() {
            h3 { "Not judged inside" }
            ul {
                @for (why, count) in &alarm.health { li { (Text(why)) ": " (count) } }
            }
        }
        h3 { "Lines around its beginning" }
        (lines(&report.entries[from..to]))
    }
}

fn evidence(ShownEvent { pictures, profiles }: &ShownEvent) -> Markup {
    let (seen, heat): (Vec<&Shown>, Vec<&Shown>) =
        pictures.iter().partition(|shown| shown.tap.is_none());
    html! {
        @if !seen.is_empty() {
            h3 { "What the camera saw" }
            (list("Frame", &seen))
        }
        @if !heat.is_empty() {
            h3 { "Where the encoder looked, brighter is more" }
            (list("Energies over the frame", &heat))
        }
        @if !profiles.is_empty() {
            h3 { "What it found there, against the reference" }
            div.profiles {
                @for profile in profiles { (chart::profile(profile)) }
            }
        }
    }
}

fn list(what: &str, pictures: &[&Shown]) -> Markup {
    html! {
        ul.evidence {
            @for Shown { jpeg, caption, tap } in pictures {
                @let caption = match tap {
                    Some(tap) => format!("{caption}, {tap}"),
                    None => caption.clone(),
                };
                li {
                    img alt={ (what) ", " (Plain(&caption)) }
                        src={ "data:image/jpeg;base64," (Base64Display::new(jpeg, &STANDARD)) };
                    span { (Text(&caption)) }
                }
            }
        }
    }
}

fn taps(report: &Report, alarm: &Alarm) -> Markup {
    let Lines {
        suspected,
        first,
        worst,
        ..
    } = alarm.lines;
    let gap = |line: Option<&Entry>, tap: &str| {
        let gap = line.and_then(|line| line.tap_gap.get(tap).copied().flatten());
        Number(gap, 4)
    };
    let before = suspected.checked_sub(1).map(|line| &report.entries[line]);
    let (first, worst) = (&report.entries[first], &report.entries[worst]);
    html! {
        table {
            (head(&[
                Words("Tap"), Numbers("Gap before"), Numbers("at the start"), Numbers("at the largest score"),
                Numbers("Similarity there"),
            ]))
            tbody {
                @for tap in &report.taps {
                    tr {
                        th scope="row" { (Text(tap)) }
                        td.n { (gap(before, tap)) }
                        td.n { (gap(Some(first), tap)) }
                        td.n { (gap(Some(worst), tap)) }
                        td.n { (Number(worst.tap_similarity.get(tap).copied().flatten(), 4)) }
                    }
                }
            }
        }
    }
}

fn lines(entries: &[Entry]) -> Markup {
    html! {
        table.lines {
            (head(&[
                Numbers("Time"), Numbers("Frame"), Words("State"), Numbers("Gap"), Numbers("Change"),
                Numbers("Lanes lost"), Words("Likely cause"), Words("Health"),
            ]))
            tbody {
                @for entry in entries {
                    tr {
                        td.n { (format_args!("{:.2} s", entry.t_s)) }
                        td.n { @if let Some(number) = entry.sequence { (number) } @else { "–" } }
                        td { (badge(entry.state)) }
                        td.n { (Number(entry.gap, 2)) }
                        td.n { (Number(entry.change, 2)) }
                        td.n { (Percent(entry.lanes)) }
                        td.likely { @if let Some(cause) = entry.cause { (cause.to_string()) } @else { "–" } }
                        td { (Text(&entry.health)) }
                    }
                }
            }
        }
    }
}
