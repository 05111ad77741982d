//! How soon events are found: rows and table.

use gapwatch::lab::evaluation::binomial_interval;
use gapwatch::lab::evaluation::domain_detection::{
    Detection, Event, LATER_S, Roads, WITHIN_S, detection,
};
use gapwatch::lab::evaluation::scripts::{Script, scores_of};
use gapwatch::lab::scene::{ConditionKind, Look};

use super::super::progress;
use super::results::Row;
use super::sheet::Sheet;
use super::watched::Watched;
use crate::cli::args::EvaluateArgs;

/// What the rows mean.
pub const ABOUT: &str = "Rendered drives in which an event happens: a condition grows to a severity, the world changes \
    its look, or the picture becomes noise. An event is found if `Gap` is entered between its beginning and 2 s after \
    its onset. Drives that were in `Gap` when it began, or that reported `SensorFault` instead, do not count as \
    found. The road has a past of 40 s before an event, except in the tables of drives that begin under the condition: \
    there, only the gap can speak. Every event has drives of its own.";

/// Number of drives for each event in the full evaluation, and in the quick one.
const DRIVES: (u32, u32) = (13, 1);
/// Rates of false alarms at which events are judged.
const RATES: [f64; 2] = [1.0, 0.1];

/// Judges every event on its drives, at every rate.
pub fn rows(watched: &Watched, args: &EvaluateArgs) -> anyhow::Result<Vec<Row<Detection>>> {
    let drives = args.drives_or(DRIVES);
    let events = Event::all(args.look);
    let mut rows = Vec::new();
    for from_start in [false, true] {
        let roads = Roads {
            nominal: args.look,
            stretch_m: args.stretch,
            from_start,
        };
        rows.extend(rows_on(roads, &events, drives, watched)?);
    }
    Ok(rows)
}

fn rows_on(
    roads: Roads,
    events: &[Event],
    drives: u32,
    watched: &Watched,
) -> anyhow::Result<Vec<Row<Detection>>> {
    let scripts: Vec<Script> = events
        .iter()
        .enumerate()
        .flat_map(|(index, event)| {
            // Every event has drives of its own.
            let first = u64::from(drives) * index as u64;
            (0..u64::from(drives)).map(move |n| event.script(roads, first + n))
        })
        .collect();
    let bar = progress::over(Some(scripts.len() as u64), "events", "drives");
    let scores = scores_of(&scripts, &watched.encoder, &watched.reference, &|| {
        bar.inc(1)
    })?;
    bar.finish_and_clear();
    let evidence = watched.reference.evidence;
    let mut rows = Vec::new();
    for rate in RATES {
        let factor = watched.factor_for(rate)?;
        for (event, scores) in events.iter().zip(scores.chunks(drives as usize)) {
            let scores: Vec<_> = scores.iter().collect();
            rows.push(Row {
                of: detection(roads, *event, &scores, evidence, (rate, factor)),
                default: watched.default,
            });
        }
    }
    Ok(rows)
}

/// For each rate, a table of the shares found (conditions in rows, severities in columns), and a table of how long it
/// took.
pub fn sheets(rows: &[Row<Detection>]) -> Vec<Sheet> {
    let mut kinds: Vec<&Detection> = Vec::new();
    for Row { of, .. } in rows {
        if !kinds.iter().any(|kind| are_alike(kind, of)) {
            kinds.push(of);
        }
    }
    let mut sheets = Vec::new();
    for first in kinds {
        let all = rows.iter().map(|row| &row.of);
        let of_kind: Vec<&Detection> = all.filter(|of| are_alike(first, of)).collect();
        sheets.push(found(first, &of_kind));
        if !first.from_start {
            sheets.push(delays(first, &of_kind));
        }
    }
    sheets
}

/// Whether two rows belong into one table.
fn are_alike(a: &Detection, b: &Detection) -> bool {
    let kind = |of: &Detection| {
        (
            of.stretch_m,
            of.from_start,
            of.evidence.clone(),
            of.nominal.clone(),
        )
    };
    kind(a) == kind(b)
        && a.false_alarms_per_hour
            .total_cmp(&b.false_alarms_per_hour)
            .is_eq()
}

/// The drives and the method of a table, in words.
fn about(first: &Detection) -> String {
    let roads = match first.stretch_m {
        0 => "roads of one kind".to_owned(),
        metres => format!("roads that change every {metres} m"),
    };
    let begin = match first.from_start {
        true => ", drives that begin under the condition",
        false => "",
    };
    format!(
        "{} drives each, {roads}{begin}, evidence {}, at {} false alarms an hour (nominal: {})",
        first.drives, first.evidence, first.false_alarms_per_hour, first.nominal
    )
}

// Counts of drives are small.
#[allow(clippy::cast_precision_loss)]
fn found(first: &Detection, of_rate: &[&Detection]) -> Sheet {
    let title = format!(
        "Gap entered within {WITHIN_S} s, per cent of {}",
        about(first)
    );
    let mut sheet = by_severity(title, of_rate, |of| {
        format!("{:.0}", 100.0 * of.found_share)
    });
    let of_which = |which: &str, counts: &dyn Fn(&Detection) -> bool| {
        let severe: Vec<&&Detection> = of_rate.iter().filter(|of| counts(of)).collect();
        let sum =
            |count: &dyn Fn(&Detection) -> u64| severe.iter().map(|of| count(of)).sum::<u64>();
        let all = sum(&|of| of.drives);
        let share = |hits: u64| {
            let (low, high) = binomial_interval(hits, all);
            format!(
                "{hits} of {all}, {:.1} % ({:.1} to {:.1})",
                100.0 * hits as f64 / all.max(1) as f64,
                100.0 * low,
                100.0 * high
            )
        };
        format!(
            "{which}: within {WITHIN_S} s {}; within {} s {}; within {} s {}; {} missed, {} SensorFault instead, {} in Gap before.",
            share(sum(&|of| of.found)),
            LATER_S[0],
            share(sum(&|of| of.found_later[0])),
            LATER_S[1],
            share(sum(&|of| of.found_later[1])),
            sum(&|of| of.missed),
            sum(&|of| of.sensor_fault),
            sum(&|of| of.alarmed_before),
        )
    };
    sheet.notes.push(of_which(
        "Conditions of severity 3 and above, the other look and noise",
        &is_severe,
    ));
    let severity = |wanted: std::ops::RangeInclusive<u8>| {
        move |of: &Detection| {
            of.severity
                .is_some_and(|severity| wanted.contains(&severity))
        }
    };
    let severe = severity(3..=5);
    sheet
        .notes
        .push(of_which("Conditions of severity 3 and above", &severe));
    let mild = severity(2..=2);
    sheet
        .notes
        .push(of_which("Conditions of severity 2", &mild));
    sheet
}

/// Whether an event must be found. The adapted look is not one of them, because it stands for the simulation that was
/// made to look real. The plain look is not one either, because every reference with accepted roads knows it too.
fn is_severe(of: &Detection) -> bool {
    match of.severity {
        Some(severity) => severity >= 3,
        None => ![Look::Sim, Look::Realistic]
            .map(Look::name)
            .contains(&of.event.as_str()),
    }
}

fn delays(first: &Detection, of_rate: &[&Detection]) -> Sheet {
    let title = format!(
        "Seconds from onset to Gap, median and longest of the events that were found (conditions grow for 2 s before their \
         onset): {}",
        about(first)
    );
    by_severity(title, of_rate, |of| {
        match (of.delay_median_s, of.delay_max_s) {
            (Some(median), Some(max)) => format!("{median:.1}, {max:.1}"),
            _ => "-".to_owned(),
        }
    })
}

fn by_severity(title: String, of_rate: &[&Detection], cell: fn(&Detection) -> String) -> Sheet {
    let mut sheet = Sheet::new(title, ["severity", "2", "3", "4", "5"]);
    for kind in ConditionKind::ALL.map(ConditionKind::name) {
        let cells = of_rate.iter().filter(|of| of.event == kind);
        let cells = cells.map(|of| cell(of));
        sheet
            .rows
            .push(std::iter::once(kind.to_owned()).chain(cells).collect());
    }
    for of in of_rate.iter().filter(|of| of.severity.is_none()) {
        let mut cells = vec![of.event.clone(), cell(of)];
        cells.resize(5, String::new());
        sheet.rows.push(cells);
    }
    sheet
}
