//! The page itself: what stands still as HTML, the numbers as JSON for the script that draws them.

use std::fmt::{self, Display, Write};

use serde::Serialize;
use sha2::{Digest, Sha256};

use super::chart;
use super::content::{Alarm, Report, Shown, ShownEvent};
use super::text::{Escaped, Text};
use crate::monitor::alarm::AlarmState;
use crate::record::journal::Entry;

const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

/// Most lines that are drawn; of longer journals, per stretch the lines with the smallest and the largest score and all
/// changes of state.
const DRAWN_MAX: usize = 20_000;
/// Lines shown of an alarm: around its beginning.
const SHOWN_BEFORE: usize = 3;
const SHOWN_AFTER: usize = 6;
/// Most alarms in the table.
const ALARMS_MAX: usize = 500;

/// States in the order of the rows of the timeline, with the sign that stands for each beside its colour.
const STATES: [(AlarmState, &str); 6] = [
    (AlarmState::Init, "·"),
    (AlarmState::Ok, "●"),
    (AlarmState::Suspect, "▲"),
    (AlarmState::Gap, "■"),
    (AlarmState::SensorFault, "✕"),
    (AlarmState::Unavailable, "○"),
];

/// A number with so many decimals, or a dash.
struct Number(Option<f64>, usize);

impl Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            // No minus sign before what rounds to nothing.
            Some(n) => {
                let shown = format!("{n:.*}", self.1);
                let nothing = shown.trim_start_matches(['-', '0', '.']).is_empty();
                f.write_str(if nothing {
                    shown.trim_start_matches('-')
                } else {
                    &shown
                })
            }
            None => f.write_str("–"),
        }
    }
}

/// What the script draws.
#[derive(Serialize)]
struct Data<'a> {
    t: Vec<f64>,
    state: Vec<usize>,
    states: [&'static str; 6],
    score: Vec<Option<f64>>,
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

impl Report {
    /// The page, for a journal of that name.
    pub fn page(&self, name: &str) -> String {
        let mut page = String::new();
        // Writing to a String cannot fail.
        let _ = write_page(self, name, &mut page);
        page
    }
}

fn write_page(report: &Report, name: &str, out: &mut String) -> fmt::Result {
    let script_hash = base64(&Sha256::digest(SCRIPT));
    let title = Escaped(name);
    write!(
        out,
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
        <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; \
        img-src data:; script-src 'sha256-{script_hash}'; base-uri 'none'; form-action 'none'\">\
        <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
        <meta name=\"color-scheme\" content=\"light dark\"><link rel=\"icon\" href=\"data:,\">\
        <title>gapwatch report: {title}</title>\n<style>\n{STYLE}</style></head><body><main>\n"
    )?;
    header(report, name, out)?;
    tiles(report, out)?;
    timeline(report, out)?;
    alarms(report, out)?;
    judged(report, out)?;
    calibration(report, out)?;
    writeln!(
        out,
        "<footer>Score 0 is the median of nominal drives, 1 the alarm threshold. Made by gapwatch {}.</footer></main>",
        env!("CARGO_PKG_VERSION")
    )?;
    let json = serde_json::to_string(&data(report)).unwrap_or_default();
    // In JSON these stand only inside strings, where the escape means the same.
    let json = json.replace('<', "\\u003c").replace('&', "\\u0026");
    writeln!(
        out,
        "<script type=\"application/json\" id=\"data\">{json}</script>\n<script>{SCRIPT}</script></body></html>"
    )
}

fn header(report: &Report, name: &str, out: &mut String) -> fmt::Result {
    let gaps = report
        .alarms()
        .iter()
        .filter(|a| a.state == AlarmState::Gap);
    let (state, verdict) = match (gaps.count(), judged_share(report)) {
        (0, None) => (AlarmState::Init, "Nothing was judged".to_owned()),
        (0, Some(share)) if share < 0.9 => (
            AlarmState::Unavailable,
            "No gap was seen, but less than 90 % of the drive was judged".to_owned(),
        ),
        (0, _) => (AlarmState::Ok, "No gap".to_owned()),
        (1, _) => (AlarmState::Gap, "One gap".to_owned()),
        (count, _) => (AlarmState::Gap, format!("{count} gaps")),
    };
    write!(
        out,
        "<header><p class=\"brand\">gapwatch report</p><h1>{} {verdict}</h1><p class=\"what\">{}",
        badge(state, false),
        Text(name)
    )?;
    if !report.about.source.is_empty() {
        write!(out, " · {}", Text(&report.about.source))?;
    }
    if !report.began.utc.is_empty() {
        write!(out, " · began {}", Text(&report.began.utc))?;
        if !report.began.is_set {
            out.write_str(" by a clock that was not set")?;
        }
    }
    if report.breaks_off {
        out.write_str(" · the run was ended while it wrote its last line, which is left out")?;
    }
    writeln!(out, "</p></header>")
}

/// The coloured sign of a state, with its name or without.
fn badge(state: AlarmState, named: bool) -> String {
    let sign = STATES
        .iter()
        .find(|(s, _)| *s == state)
        .map_or("", |(_, sign)| sign);
    let name = state.name();
    if named {
        format!(
            "<span class=\"state {name}\"><span aria-hidden=\"true\">{sign}</span> {name}</span>"
        )
    } else {
        format!("<span class=\"state {name}\" aria-hidden=\"true\">{sign}</span>")
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

fn tiles(report: &Report, out: &mut String) -> fmt::Result {
    let span = report.span_s();
    let gap = report.in_state_s(AlarmState::Gap);
    let best = report
        .entries
        .iter()
        .filter_map(|e| e.score)
        .max_by(f64::total_cmp);
    let latency = report.latency_ms([0.5, 0.99]);
    let share = judged_share(report).map(|s| 100.0 * s);
    let frames = report
        .entries
        .iter()
        .filter(|e| e.sequence.is_some())
        .count();
    out.write_str("<section class=\"tiles\" aria-label=\"Summary\">")?;
    let mut tile = |id: &str, label: &str, value: String, note: String| {
        write!(
            out,
            "<div class=\"tile\"><span class=\"label\">{label}</span><strong id=\"{id}\">{value}</strong><span class=\"note\">{note}</span></div>"
        )
    };
    tile(
        "span",
        "Drive",
        format!("{span:.1} s"),
        format!("{frames} frames"),
    )?;
    tile(
        "in-gap",
        "In Gap",
        format!("{gap:.1} s"),
        format!("{:.1} % of the drive", 100.0 * gap / span.max(1e-9)),
    )?;
    tile(
        "score-max",
        "Largest score",
        Number(best, 2).to_string(),
        "alarm threshold: 1".to_owned(),
    )?;
    tile(
        "judged",
        "Judged",
        share.map_or("–".to_owned(), |s| format!("{s:.1} %")),
        "of the time after the start".to_owned(),
    )?;
    tile(
        "latency",
        "Latency, median",
        latency.map_or("–".to_owned(), |[p50, _]| format!("{p50:.1} ms")),
        latency.map_or(String::new(), |[_, p99]| format!("99 % below {p99:.1} ms")),
    )?;
    writeln!(out, "</section>")
}

fn timeline(report: &Report, out: &mut String) -> fmt::Result {
    out.write_str(
        "<section><div class=\"bar\"><h2>Timeline</h2><div class=\"buttons\" role=\"group\" aria-label=\"Zoom of the timeline\">\
        <button type=\"button\" id=\"back\" aria-label=\"Earlier\">←</button>\
        <button type=\"button\" id=\"in\" aria-label=\"Zoom in\">+</button>\
        <button type=\"button\" id=\"out\" aria-label=\"Zoom out\">−</button>\
        <button type=\"button\" id=\"on\" aria-label=\"Later\">→</button>\
        <button type=\"button\" id=\"all\">Whole drive</button></div></div>\
        <p class=\"hint\">Drag over the chart, or use the buttons or + − ← → 0 on the keyboard, to look closer.\
        <span id=\"range\" role=\"status\"></span></p>\
        <div id=\"charts\" tabindex=\"0\" role=\"group\" aria-label=\"Timeline of score, state, health, gaps and latency; the \
        table of alarms says the same in words\"></div><p id=\"reading\" class=\"hint\">&nbsp;</p>\
        <noscript><p>The charts need JavaScript; the tables below do not.</p></noscript>",
    )?;
    let drawn = drawn(&report.entries).len();
    if drawn < report.lines() {
        write!(
            out,
            "<p class=\"hint\">Drawn: {drawn} of {} lines, the extremes of each stretch and every change of state.</p>",
            report.lines()
        )?;
    }
    writeln!(out, "</section>")
}

fn alarms(report: &Report, out: &mut String) -> fmt::Result {
    out.write_str("<section><h2>Alarms and outages</h2>")?;
    if report.alarms().is_empty() {
        return writeln!(out, "<p>None.</p></section>");
    }
    out.write_str(
        "<p class=\"hint\">Open one to see what is behind it.</p><div class=\"wide\"><table id=\"alarms\"><thead><tr>\
        <th scope=\"col\">State</th><th scope=\"col\" class=\"n\">From</th><th scope=\"col\" class=\"n\">To</th>\
        <th scope=\"col\" class=\"n\">Lasted</th><th scope=\"col\" class=\"n\">Largest score</th>\
        <th scope=\"col\">Tap that led</th><th scope=\"col\">Reason</th></tr></thead><tbody>",
    )?;
    for (place, alarm) in report.alarms().iter().enumerate().take(ALARMS_MAX) {
        let number = place + 1;
        let reasons = match alarm.reasons.as_slice() {
            [] => "–".to_owned(),
            reasons => Text(&reasons.join(", ")).to_string(),
        };
        let leader = alarm
            .leader
            .as_ref()
            .map_or("–".to_owned(), |tap| Text(tap).to_string());
        write!(
            out,
            "<tr class=\"alarm\" data-alarm=\"{number}\"><td><button type=\"button\" class=\"opens\" aria-expanded=\"false\" \
            aria-controls=\"alarm-{number}\"><span class=\"number\">{number}</span> {}</button></td>\
            <td class=\"n\">{:.1} s</td><td class=\"n\">{:.1} s{}</td><td class=\"n\">{:.1} s</td><td class=\"n\">{}</td>\
            <td>{leader}</td><td>{reasons}</td></tr>\
            <tr class=\"behind\" id=\"alarm-{number}\" hidden><td colspan=\"7\">",
            badge(alarm.state, true),
            alarm.from_s,
            alarm.to_s,
            if alarm.open { " (end)" } else { "" },
            alarm.to_s - alarm.from_s,
            Number(alarm.score_max, 2),
        )?;
        behind(report, alarm, report.shown.get(&place), out)?;
        out.write_str("</td></tr>")?;
    }
    out.write_str("</tbody></table></div>")?;
    if report.alarms().len() > ALARMS_MAX {
        write!(
            out,
            "<p class=\"hint\">The first {ALARMS_MAX} of {}.</p>",
            report.alarms().len()
        )?;
    }
    writeln!(out, "</section>")
}

/// What is behind an alarm: a closer look, the taps at its beginning and worst, and the lines around its beginning.
fn behind(
    report: &Report,
    alarm: &Alarm,
    shown: Option<&ShownEvent>,
    out: &mut String,
) -> fmt::Result {
    let (first, worst, next) = alarm.lines;
    let entries = &report.entries;
    write!(
        out,
        "<div class=\"closer\" data-from=\"{}\" data-to=\"{}\"></div>",
        alarm.from_s, alarm.to_s
    )?;
    if let Some(ShownEvent {
        pictures: shown,
        profiles,
    }) = shown
    {
        let (seen, heat): (Vec<&Shown>, Vec<&Shown>) =
            shown.iter().partition(|shown| shown.tap.is_none());
        pictures("What the camera saw", "Frame", &seen, out)?;
        let title = "Where the encoder looked, brighter is more";
        pictures(title, "Energies over the frame", &heat, out)?;
        if !profiles.is_empty() {
            out.write_str(
                "<h3>What it found there, against the reference</h3><div class=\"profiles\">",
            )?;
            for profile in profiles {
                chart::profile(profile, out)?;
            }
            out.write_str("</div>")?;
        }
    }
    out.write_str(
        "<h3>By tap</h3><table><thead><tr><th scope=\"col\">Tap</th><th scope=\"col\" class=\"n\">Gap before</th>\
        <th scope=\"col\" class=\"n\">at the start</th><th scope=\"col\" class=\"n\">at the largest score</th>\
        <th scope=\"col\" class=\"n\">Similarity there</th></tr></thead><tbody>",
    )?;
    let gap = |line: Option<usize>, tap: &str| {
        let gap = line.and_then(|line| entries[line].gap.get(tap).copied().flatten());
        Number(gap, 4)
    };
    for tap in &report.taps {
        write!(
            out,
            "<tr><th scope=\"row\">{}</th><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td></tr>",
            Text(tap),
            gap(first.checked_sub(1), tap),
            gap(Some(first), tap),
            gap(Some(worst), tap),
            Number(entries[worst].similarity.get(tap).copied().flatten(), 4),
        )?;
    }
    out.write_str("</tbody></table>")?;
    if !alarm.health.is_empty() {
        out.write_str("<h3>Not judged inside</h3><ul>")?;
        for (why, count) in &alarm.health {
            write!(out, "<li>{}: {count}</li>", Text(why))?;
        }
        out.write_str("</ul>")?;
    }
    out.write_str(
        "<h3>Lines around its beginning</h3><table class=\"lines\"><thead><tr><th scope=\"col\" class=\"n\">Time</th>\
        <th scope=\"col\" class=\"n\">Frame</th><th scope=\"col\">State</th><th scope=\"col\" class=\"n\">Score</th>\
        <th scope=\"col\">Health</th></tr></thead><tbody>",
    )?;
    let from = first.saturating_sub(SHOWN_BEFORE);
    let to = (first + SHOWN_AFTER).min(next + 1).min(entries.len());
    for entry in &entries[from..to] {
        write!(
            out,
            "<tr><td class=\"n\">{:.2} s</td><td class=\"n\">{}</td><td>{}</td><td class=\"n\">{}</td><td>{}</td></tr>",
            entry.t_s,
            entry.sequence.map_or("–".to_owned(), |n| n.to_string()),
            badge(entry.state, true),
            Number(entry.score, 2),
            Text(&entry.health),
        )?;
    }
    out.write_str("</tbody></table>")
}

fn pictures(title: &str, what: &str, shown: &[&Shown], out: &mut String) -> fmt::Result {
    if shown.is_empty() {
        return Ok(());
    }
    write!(out, "<h3>{title}</h3><ul class=\"evidence\">")?;
    for Shown { jpeg, caption, tap } in shown {
        let caption = match tap {
            Some(tap) => format!("{caption}, {tap}"),
            None => caption.clone(),
        };
        write!(
            out,
            "<li><img alt=\"{what}, {}\" src=\"data:image/jpeg;base64,{}\"><span>{}</span></li>",
            Escaped(&caption),
            base64(jpeg),
            Text(&caption)
        )?;
    }
    out.write_str("</ul>")
}

fn judged(report: &Report, out: &mut String) -> fmt::Result {
    let span = report.span_s().max(1e-9);
    out.write_str(
        "<section><h2>What was judged, and what not</h2><div class=\"stack\" aria-hidden=\"true\">",
    )?;
    let spent = STATES.map(|(state, _)| (state, report.in_state_s(state)));
    let spent = spent
        .iter()
        .filter(|(state, s)| *s > 0.0 || report.entries.iter().any(|entry| entry.state == *state));
    for (state, seconds) in spent.clone() {
        write!(
            out,
            "<span class=\"{}\" style=\"flex-grow:{:.4}\"></span>",
            state.name(),
            100.0 * seconds / span
        )?;
    }
    out.write_str(
        "</div><table id=\"shares\"><thead><tr><th scope=\"col\">State</th><th scope=\"col\" class=\"n\">Time</th>\
        <th scope=\"col\" class=\"n\">Share</th><th scope=\"col\">Means</th></tr></thead><tbody>",
    )?;
    for (state, seconds) in spent {
        let means = match state {
            AlarmState::Init => "not judged: the first window was not full",
            AlarmState::Ok => "judged: like the domain the model knows",
            AlarmState::Suspect => "judged: beyond the threshold, being debounced",
            AlarmState::Gap => "judged: the road had left the domain",
            AlarmState::SensorFault => {
                "not judged: the picture showed nothing that a scene could make"
            }
            AlarmState::Unavailable => "not judged, for another reason",
        };
        write!(
            out,
            "<tr><td>{}</td><td class=\"n\">{seconds:.1} s</td><td class=\"n\">{:.1} %</td><td>{means}</td></tr>",
            badge(*state, true),
            100.0 * seconds / span
        )?;
    }
    out.write_str("</tbody></table>")?;
    let not_judged = report.not_judged();
    if not_judged.is_empty() {
        out.write_str("<p>Every frame was judged.</p>")?;
    } else {
        out.write_str("<h3>Frames without a score</h3><ul id=\"unjudged\">")?;
        for (why, count) in not_judged {
            write!(out, "<li>{}: {count}</li>", Text(why))?;
        }
        out.write_str("</ul>")?;
    }
    match report.missing_frames() {
        0 => {}
        count => write!(
            out,
            "<p>{count} frames that the source numbered are not in the journal.</p>"
        )?,
    }
    if let Some([p50, p90, p99, max]) = report.latency_ms([0.5, 0.9, 0.99, 1.0]) {
        write!(
            out,
            "<h3>From frame to verdict</h3><table id=\"latencies\"><thead><tr><th scope=\"col\" class=\"n\">Median</th>\
            <th scope=\"col\" class=\"n\">90 %</th><th scope=\"col\" class=\"n\">99 %</th><th scope=\"col\" class=\"n\">Longest</th>\
            </tr></thead><tbody><tr><td class=\"n\">{p50:.1} ms</td><td class=\"n\">{p90:.1} ms</td><td class=\"n\">{p99:.1} ms</td>\
            <td class=\"n\">{max:.1} ms</td></tr></tbody></table>"
        )?;
    }
    writeln!(out, "</section>")
}

fn calibration(report: &Report, out: &mut String) -> fmt::Result {
    let about = &report.about;
    if about.reference.is_empty() {
        return Ok(());
    }
    out.write_str("<section><h2>Calibration</h2><dl>")?;
    let window = format!("{} s", about.window_s);
    let strict = if about.strict {
        "simulation alone: any real road is a standing gap to it"
    } else {
        "simulation and accepted drives"
    };
    for (what, text) in [
        ("Reference", about.reference.as_str()),
        ("Made of", strict),
        ("Metric", &about.metric),
        ("Window", &window),
        ("Thresholds", &about.thresholds),
        ("False alarms", &about.false_alarms),
        ("Made by", &about.calibrated_by),
        ("Model", &about.model),
        ("SHA-256 of the model", &about.model_sha256),
        ("Run with gapwatch", &about.gapwatch),
    ] {
        if !text.is_empty() {
            write!(out, "<dt>{what}</dt><dd>{}</dd>", Text(text))?;
        }
    }
    writeln!(out, "</dl></section>")
}

/// The lines to draw, by place.
fn drawn(entries: &[Entry]) -> Vec<usize> {
    if entries.len() <= DRAWN_MAX {
        return (0..entries.len()).collect();
    }
    let stretch = entries.len().div_ceil(DRAWN_MAX / 4);
    let mut places = Vec::new();
    for from in (0..entries.len()).step_by(stretch) {
        let to = (from + stretch).min(entries.len());
        let by_score = |&a: &usize, &b: &usize| {
            let score = |i: usize| entries[i].score.unwrap_or(f64::NEG_INFINITY);
            score(a).total_cmp(&score(b))
        };
        places.extend((from..to).min_by(by_score));
        places.extend((from..to).max_by(by_score));
        places.extend((from.max(1)..to).filter(|&i| entries[i].state != entries[i - 1].state));
    }
    places.push(entries.len() - 1);
    places.sort_unstable();
    places.dedup();
    places
}

fn data(report: &Report) -> Data<'_> {
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
        state: lines
            .iter()
            .map(|e| STATES.iter().position(|(s, _)| *s == e.state).unwrap_or(0))
            .collect(),
        states: STATES.map(|(state, _)| state.name()),
        score: lines.iter().map(|e| e.score).collect(),
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
                    .map(|e| e.gap.get(name).copied().flatten())
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

fn base64(bytes: &[u8]) -> String {
    use base64::Engine;
    base64::engine::general_purpose::STANDARD.encode(bytes)
}
