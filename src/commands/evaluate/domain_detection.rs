//! How soon events are found: rows and table.

use gapwatch::evaluation::domain_detection::{Detection, Event, WITHIN_S, detection};
use gapwatch::evaluation::watched::{Script, scores_of};
use gapwatch::scene::ConditionKind;

use super::super::progress;
use super::results::Row;
use super::sheet::Sheet;
use super::watched::Watched;
use crate::args::EvaluateArgs;

/// What the rows mean.
pub const ABOUT: &str = "Rendered drives on which a condition grows to a severity, the world changes its look or the \
    picture becomes noise. Found: `Gap` is entered from the beginning of the event to 2 s after its onset; drives that \
    were in `Gap` before, or reported `SensorFault` instead, do not count as found.";

/// Drives an event of the full evaluation, and of the quick one.
const DRIVES: (u32, u32) = (20, 1);
/// Rates of false alarms at which events are judged.
const RATES: [f64; 2] = [1.0, 0.1];

/// Every event on its drives, at every rate.
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
    let bar = progress::frames(Some(scripts.len() as u64), "events");
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

/// A table a rate: found shares, conditions down and severities across.
pub fn sheets(rows: &[Row<Detection>]) -> Vec<Sheet> {
    RATES
        .into_iter()
        .filter_map(|rate| sheet(rows, rate))
        .collect()
}

fn sheet(rows: &[Row<Detection>], rate: f64) -> Option<Sheet> {
    let of_rate: Vec<&Detection> = rows
        .iter()
        .map(|row| &row.of)
        .filter(|of| of.false_alarms_per_hour.total_cmp(&rate).is_eq())
        .collect();
    let first = of_rate.first()?;
    let title = format!(
        "Entered as Gap within {WITHIN_S} s, per cent of {} drives each, at {rate} false alarms an hour (nominal: {})",
        first.drives, first.nominal
    );
    let mut sheet = Sheet::new(title, ["severity", "1", "2", "3", "4", "5"]);
    let cell = |of: &&Detection| format!("{:.0}", 100.0 * of.found_share);
    for kind in ConditionKind::ALL.map(ConditionKind::name) {
        let cells = of_rate.iter().filter(|of| of.event == kind).map(cell);
        sheet
            .rows
            .push(std::iter::once(kind.to_owned()).chain(cells).collect());
    }
    for of in of_rate.iter().filter(|of| of.severity.is_none()) {
        let mut cells = vec![of.event.clone(), cell(of)];
        cells.resize(6, String::new());
        sheet.rows.push(cells);
    }
    let severe = of_rate
        .iter()
        .filter(|of| of.severity.is_none_or(|s| s >= 3));
    let (found, all) = severe.fold((0, 0), |(found, all), of| {
        (found + of.found, all + of.drives)
    });
    sheet.notes.push(format!(
        "Severity 3 and above, looks and noise together: {found} of {all}."
    ));
    Some(sheet)
}
