//! Which causes are told: rows and tables.

use gapwatch::lab::evaluation::binomial_interval;
use gapwatch::lab::evaluation::cause::{AFTER_S, Event, SEVERE, ToldCauses, told_causes};
use gapwatch::lab::evaluation::scripts::{Script, verdicts_of};
use gapwatch::reference::cause::Cause;

use super::super::progress;
use super::results::Row;
use super::sheet::{Sheet, with_interval};
use super::watched::Watched;
use crate::cli::args::EvaluateArgs;

/// What the rows mean.
pub const ABOUT: &str = "Rendered drives in which a condition grows to a severity after 28 s, or in which another look \
    or another road of the same look follows after 40 s. The cause is that of the verdict 3 s after the onset, or of the \
    first verdict in `Gap` after that. Shares are of the drives of which a cause is told. A drive that is in neither \
    `Suspect` nor `Gap` has no cause. Another look must be told as `other`: nothing like it was learnt. Severity 2 and \
    another road are given for information.";

/// Number of drives for each event in the full evaluation, and in the quick one.
const DRIVES: (u32, u32) = (20, 1);

/// Judges every event on its drives.
pub fn rows(watched: &Watched, args: &EvaluateArgs) -> anyhow::Result<Vec<Row<ToldCauses>>> {
    let drives = args.drives_or(DRIVES);
    let events = Event::all(args.look);
    let scripts: Vec<Script> = events
        .iter()
        .flat_map(|event| (0..drives).map(|n| event.script(args.look, args.stretch, n.into())))
        .collect();
    let bar = progress::over(Some(scripts.len() as u64), "causes", "drives");
    let verdicts = verdicts_of(&scripts, &watched.encoder, &watched.reference, &|| {
        bar.inc(1)
    })?;
    bar.finish_and_clear();
    let of_events = events.iter().zip(verdicts.chunks(drives as usize));
    let rows = of_events.map(|(event, drives)| Row {
        of: told_causes(*event, drives),
        default: watched.default,
    });
    Ok(rows.collect())
}

/// The causes that were told of severe events, then the shares that were right by severity.
pub fn sheets(rows: &[Row<ToldCauses>]) -> Vec<Sheet> {
    let rows: Vec<&ToldCauses> = rows.iter().map(|row| &row.of).collect();
    let mut events: Vec<&str> = rows.iter().map(|of| of.event.as_str()).collect();
    events.dedup();
    vec![confusion(&rows, &events), by_severity(&rows, &events)]
}

fn is_severe(of: &ToldCauses) -> bool {
    of.severity.is_none_or(|severity| severity >= SEVERE)
}

/// Right, told and all drives of some rows.
fn counts<'a>(rows: impl Iterator<Item = &'a ToldCauses>) -> (u64, u64, u64) {
    rows.fold((0, 0, 0), |(right, told, all), of| {
        (
            right + of.right,
            told + of.drives - of.untold,
            all + of.drives,
        )
    })
}

// Counts of drives are small.
#[allow(clippy::cast_precision_loss)]
fn share((right, told, _): (u64, u64, u64)) -> String {
    let (low, high) = binomial_interval(right, told);
    match told {
        0 => "-".to_owned(),
        _ => with_interval(
            100.0 * right as f64 / told as f64,
            Some((100.0 * low, 100.0 * high)),
            0,
        ),
    }
}

fn confusion(rows: &[&ToldCauses], events: &[&str]) -> Sheet {
    let drives = rows.first().map_or(0, |of| of.drives);
    let mut sheet = Sheet {
        title: format!(
            "Causes told {AFTER_S} s after the onset, number of drives: {drives} for each event, conditions of severity \
             {SEVERE} and above"
        ),
        columns: vec!["event".to_owned()],
        ..Sheet::default()
    };
    sheet
        .columns
        .extend(Cause::ALL.map(|cause| cause.name().to_owned()));
    sheet
        .columns
        .extend(["no cause", "right, %"].map(str::to_owned));
    for event in events {
        let own = || rows.iter().filter(|of| of.event == *event && is_severe(of));
        let mut cells = vec![(*event).to_owned()];
        cells.extend(Cause::ALL.map(|cause| {
            let told = own().filter_map(|of| of.told.get(&cause)).sum::<u64>();
            told.to_string()
        }));
        cells.push(own().map(|of| of.untold).sum::<u64>().to_string());
        cells.push(share(counts(own().copied())));
        sheet.rows.push(cells);
    }
    let severe = || {
        rows.iter()
            .filter(|of| of.severity.is_some() && is_severe(of))
    };
    let of = counts(severe().copied());
    sheet.notes.push(format!(
        "Conditions of severity {SEVERE} and above: {} of {} right, {} %; {} of {} drives without a cause.",
        of.0,
        of.1,
        share(of),
        of.2 - of.1,
        of.2
    ));
    sheet
}

fn by_severity(rows: &[&ToldCauses], events: &[&str]) -> Sheet {
    let title = "Causes told right, per cent of the drives of which a cause is told".to_owned();
    let mut sheet = Sheet::new(title, ["severity", "2", "3", "4", "5"]);
    for event in events {
        let of_condition = |of: &&&ToldCauses| of.event == *event && of.severity.is_some();
        if !rows.iter().any(|of| of_condition(&of)) {
            continue;
        }
        let cells = (2..=5).map(|severity| {
            let own = rows.iter().filter(of_condition);
            share(counts(
                own.filter(|of| of.severity == Some(severity)).copied(),
            ))
        });
        sheet
            .rows
            .push(std::iter::once((*event).to_owned()).chain(cells).collect());
    }
    sheet
}
