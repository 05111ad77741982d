//! False alarms on nominal drives: rows and table.

use std::io::Write;

use gapwatch::evaluation::false_alarms::{self, FalseAlarmRate};
use gapwatch::evaluation::watched::{Script, scores_of};

use super::super::progress;
use super::Row;
use super::watched::Watched;
use crate::args::EvaluateArgs;

/// Hours of nominal drives of the full evaluation.
const HOURS: u32 = 24;
/// Nominal drives of the quick evaluation, and their length, seconds.
const QUICK_DRIVES: (u32, f64) = (10, 60.0);

/// Every rate that the reference has thresholds for, on the same drives.
pub fn rows(watched: &Watched, args: &EvaluateArgs) -> anyhow::Result<Vec<Row<FalseAlarmRate>>> {
    let drives_an_hour = 3_600.0 / false_alarms::DRIVE_S;
    let (drives, seconds) = if args.quick {
        QUICK_DRIVES
    } else {
        let hours = f64::from(args.hours.unwrap_or(HOURS));
        // At most 10,000 hours.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        (
            (hours * drives_an_hour).ceil() as u32,
            false_alarms::DRIVE_S,
        )
    };
    let scripts: Vec<Script> = (0..drives)
        .map(|n| false_alarms::script(args.look, n.into(), seconds))
        .collect();
    let bar = progress::frames(Some(scripts.len() as u64), "nominal drives");
    let scores = scores_of(&scripts, &watched.encoder, &watched.reference, &|| {
        bar.inc(1)
    })?;
    bar.finish_and_clear();
    let rates = watched.reference.false_alarms.factors.iter();
    rates
        .map(|rate| {
            let factor = watched.factor_for(rate.per_hour)?;
            Ok(Row {
                of: false_alarms::rate(args.look, &scores, rate.per_hour, factor),
                default: watched.default,
            })
        })
        .collect()
}

pub fn table(rows: &[Row<FalseAlarmRate>], out: &mut dyn Write) -> anyhow::Result<()> {
    for Row { of, .. } in rows {
        writeln!(
            out,
            "{} false alarms an hour wanted (nominal: {}): {} in {:.1} h of {} drives, {:.2} an hour ({:.2} to {:.2}){}",
            of.wanted,
            of.nominal,
            of.entries,
            of.hours,
            of.drives,
            of.measured,
            of.bound.0,
            of.bound.1,
            match (of.demonstrated, of.kept) {
                (false, _) => ": not demonstrated, too few hours",
                (true, true) => ": kept",
                (true, false) => ": not kept",
            }
        )?;
    }
    Ok(())
}
