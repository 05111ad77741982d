//! How soon events are found: rows and table.

use gapwatch::lab::evaluation::binomial_interval;
use gapwatch::lab::evaluation::domain_detection::{Detection, Event, WITHIN_S, detection};
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
    its onset. Drives that were in `Gap` before, or that reported `SensorFault` instead, do not count as found.";

/// Number of drives for each event in the full evaluation, and in the quick one.
const DRIVES: (u32, u32) = (20, 1);
/// Rates of false alarms at which events are judged.
const RATES: [f64; 2] = [1.0, 0.1];

/// Judges every event on its drives, at every rate.
pub fn rows(watched: &Watched, args: &EvaluateArgs) -> anyhow::Result<Vec<Row<Detection>>> {
    let drives = match (args.drives, args.quick) {
        (Some(drives), _) => drives,
        (None, true) => DRIVES.1,
        (None, false) => DRIVES.0,
    };
    let events = Event::all(args.look);
    let scripts: Vec<Script> = events
        .iter()
        .flat_map(|event| (0..drives).map(|n| event.script(args.look, n.into())))
        .collect();
    let bar = progress::over(Some(scripts.len() as u64), "events", "drives");
    let scores = scores_of(&scripts, &watched.encoder, &watched.reference, &|| {
        bar.inc(1)
    })?;
    bar.finish_and_clear();
    let mut rows = Vec::new();
    for rate in RATES {
        let factor = watched.factor_for(rate)?;
        for (event, scores) in events.iter().zip(scores.chunks(drives as usize)) {
            let scores: Vec<_> = scores.iter().collect();
            rows.push(Row {
                of: detection(args.look, *event, &scores, rate, factor),
                default: watched.default,
            });
        }
    }
    Ok(rows)
}

/// For each rate, a table of the shares found (conditions in rows, severities in columns), and a table of how long it
/// took.
pub fn sheets(rows: &[Row<Detection>]) -> Vec<Sheet> {
    let mut sheets = Vec::new();
    for rate in RATES {
        let of_rate: Vec<&Detection> = rows
            .iter()
            .map(|row| &row.of)
            .filter(|of| of.false_alarms_per_hour.total_cmp(&rate).is_eq())
            .collect();
        if let Some(first) = of_rate.first() {
            sheets.push(found(first, &of_rate));
            sheets.push(delays(first, &of_rate));
        }
    }
    sheets
}

// Counts of drives are small.
#[allow(clippy::cast_precision_loss)]
fn found(first: &Detection, of_rate: &[&Detection]) -> Sheet {
    let title = format!(
        "Gap entered within {WITHIN_S} s, per cent of {} drives each, at {} false alarms an hour (nominal: {})",
        first.drives, first.false_alarms_per_hour, first.nominal
    );
    let mut sheet = by_severity(title, of_rate, |of| {
        format!("{:.0}", 100.0 * of.found_share)
    });
    let of_severe = |which: &str, counts: &dyn Fn(&Detection) -> bool| {
        let severe: Vec<&&Detection> = of_rate.iter().filter(|of| counts(of)).collect();
        let sum = |count: fn(&Detection) -> u64| severe.iter().map(|of| count(of)).sum::<u64>();
        let (hits, all) = (sum(|of| of.found), sum(|of| of.drives));
        let (low, high) = binomial_interval(hits, all);
        format!(
            "{which}: {hits} of {all}, {:.1} % ({:.1} to {:.1}); {} missed, {} SensorFault instead, {} in Gap before.",
            100.0 * hits as f64 / all.max(1) as f64,
            100.0 * low,
            100.0 * high,
            sum(|of| of.missed),
            sum(|of| of.sensor_fault),
            sum(|of| of.alarmed_before),
        )
    };
    sheet.notes.push(of_severe(
        "Conditions of severity 3 and above, the other look and noise",
        &is_severe,
    ));
    sheet
        .notes
        .push(of_severe("Conditions of severity 3 and above", &|of| {
            of.severity.is_some_and(|severity| severity >= 3)
        }));
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
        "Seconds from onset to Gap at {} false alarms an hour, median and longest of the events that were found (conditions \
         grow for 2 s before their onset)",
        first.false_alarms_per_hour
    );
    by_severity(title, of_rate, |of| {
        match (of.delay_median_s, of.delay_max_s) {
            (Some(median), Some(max)) => format!("{median:.1}, {max:.1}"),
            _ => "-".to_owned(),
        }
    })
}

fn by_severity(title: String, of_rate: &[&Detection], cell: fn(&Detection) -> String) -> Sheet {
    let mut sheet = Sheet::new(title, ["severity", "1", "2", "3", "4", "5"]);
    for kind in ConditionKind::ALL.map(ConditionKind::name) {
        let cells = of_rate.iter().filter(|of| of.event == kind);
        let cells = cells.map(|of| cell(of));
        sheet
            .rows
            .push(std::iter::once(kind.to_owned()).chain(cells).collect());
    }
    for of in of_rate.iter().filter(|of| of.severity.is_none()) {
        let mut cells = vec![of.event.clone(), cell(of)];
        cells.resize(6, String::new());
        sheet.rows.push(cells);
    }
    sheet
}
