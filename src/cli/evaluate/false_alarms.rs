//! False alarms on nominal drives: rows and table.

use gapwatch::lab::evaluation::false_alarms::{self, FalseAlarmRate};
use gapwatch::lab::evaluation::scripts::{Script, scores_of};
use gapwatch::statistics::event_rate::Loudness;
use serde::{Deserialize, Serialize};

use super::super::progress;
use super::results::Row;
use super::sheet::Sheet;
use super::watched::Watched;
use crate::cli::args::EvaluateArgs;

/// What the rows mean.
pub const ABOUT: &str = "Entries into `Gap` on nominal drives that were not used for tuning, at thresholds made for a \
    wanted rate. Intervals come from resampling drives, because a road near the threshold enters `Gap` more than once. \
    They are never narrower than the exact intervals of independent entries (Poisson). A rate is *not louder than \
    asked* if its one-sided 95 % upper bound is at most the wanted rate, and *louder than asked* if its one-sided 95 % \
    lower bound is above it. Otherwise it is *not shown*, and the number of missing hours without an entry is given. A \
    row without one-sided bounds is judged by the ends of its two-sided interval, which is wider. Only judged hours \
    count.";

/// A row as it is in a file: the words are beside its numbers for the reader. They are not read back, but made from the
/// numbers again.
#[derive(Serialize, Deserialize)]
pub struct Said {
    #[serde(flatten)]
    of: FalseAlarmRate,
    #[serde(skip_deserializing)]
    verdict: &'static str,
    #[serde(skip_deserializing, skip_serializing_if = "Option::is_none")]
    missing_hours: Option<f64>,
}

impl From<FalseAlarmRate> for Said {
    fn from(of: FalseAlarmRate) -> Self {
        let loudness = of.loudness();
        Self {
            verdict: loudness.name(),
            missing_hours: match loudness {
                Loudness::NotShown { missing_hours } => Some(missing_hours),
                Loudness::NotLouder | Loudness::Louder => None,
            },
            of,
        }
    }
}

/// Hours of nominal drives of the full evaluation.
const HOURS: u32 = 24;
/// Nominal drives of the quick evaluation, and their length, seconds.
const QUICK_DRIVES: (u32, f64) = (10, 60.0);

/// Judges every rate for which the reference has thresholds, on the same drives.
pub fn rows(watched: &Watched, args: &EvaluateArgs) -> anyhow::Result<Vec<Row<Said>>> {
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
    let fps = args.fps.unwrap_or(watched.reference.rate.rate_hz);
    let scripts: Vec<Script> = (0..drives)
        .map(|n| false_alarms::script(args.look, args.stretch, n.into(), (seconds, fps)))
        .collect();
    let bar = progress::over(Some(scripts.len() as u64), "false alarms", "drives");
    let scores = scores_of(&scripts, &watched.encoder, &watched.reference, &|| {
        bar.inc(1)
    })?;
    bar.finish_and_clear();
    let rates = watched.reference.false_alarms.factors.iter();
    rates
        .map(|rate| {
            let factor = watched.factor_for(rate.per_hour)?;
            Ok(Row {
                of: false_alarms::rate(
                    (args.look, args.stretch, fps),
                    &scores,
                    rate.per_hour,
                    factor,
                )
                .into(),
                default: watched.default,
            })
        })
        .collect()
}

/// One table with a row for each wanted rate.
pub fn sheets(rows: &[Row<Said>]) -> Vec<Sheet> {
    let mut sheet = Sheet::new(
        "False alarms an hour on nominal drives".to_owned(),
        [
            "nominal",
            "stretch, m",
            "frames/s",
            "wanted",
            "measured",
            "95 % interval",
            "entries",
            "hours",
            "drives",
            "verdict",
        ],
    );
    for of in rows.iter().map(|row| &row.of.of) {
        let verdict = match of.missing() {
            Some(missing) => format!("{}, {missing} are missing", of.loudness().name()),
            None => of.loudness().name().to_owned(),
        };
        let none = || "-".to_owned();
        sheet.rows.push(vec![
            of.nominal.clone(),
            of.stretch_m.to_string(),
            of.fps.to_string(),
            of.wanted.to_string(),
            of.measured.map_or_else(none, |found| format!("{found:.2}")),
            of.bound
                .map_or_else(none, |(low, high)| format!("{low:.2} to {high:.2}")),
            of.entries.to_string(),
            format!("{:.1}", of.hours),
            of.drives.to_string(),
            verdict,
        ]);
    }
    vec![sheet]
}
