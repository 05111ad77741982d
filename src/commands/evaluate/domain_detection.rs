//! How soon events are found: rows and table.

use std::io::Write;

use gapwatch::evaluation::domain_detection::{Detection, Event, WITHIN_S, detection};
use gapwatch::evaluation::watched::{Script, scores_of};
use gapwatch::scene::ConditionKind;

use super::super::progress;
use super::Row;
use super::watched::Watched;
use crate::args::EvaluateArgs;

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

/// Found shares: conditions down, severities across, a table a rate.
pub fn table(rows: &[Row<Detection>], out: &mut dyn Write) -> anyhow::Result<()> {
    for rate in RATES {
        let of_rate: Vec<&Detection> = rows
            .iter()
            .map(|row| &row.of)
            .filter(|of| of.false_alarms_per_hour.total_cmp(&rate).is_eq())
            .collect();
        let Some(first) = of_rate.first() else {
            continue;
        };
        writeln!(
            out,
            "Entered as Gap within {WITHIN_S} s, per cent of {} drives each, at {rate} false alarms an hour (nominal: {})",
            first.drives, first.nominal
        )?;
        writeln!(
            out,
            "  {:<14}{:>6}{:>6}{:>6}{:>6}{:>6}",
            "severity", 1, 2, 3, 4, 5
        )?;
        for kind in ConditionKind::ALL.map(ConditionKind::name) {
            write!(out, "  {kind:<14}")?;
            for of in of_rate.iter().filter(|of| of.event == kind) {
                write!(out, "{:>6.0}", 100.0 * of.found_share)?;
            }
            writeln!(out)?;
        }
        for of in of_rate.iter().filter(|of| of.severity.is_none()) {
            writeln!(out, "  {:<14}{:>6.0}", of.event, 100.0 * of.found_share)?;
        }
        let severe = of_rate
            .iter()
            .filter(|of| of.severity.is_none_or(|s| s >= 3));
        let (found, all) = severe.fold((0, 0), |(found, all), of| {
            (found + of.found, all + of.drives)
        });
        writeln!(
            out,
            "  severity 3 and above, looks and noise together: {found} of {all}\n"
        )?;
    }
    Ok(())
}
