//! Prediction of failures of the lane model: rows and tables.

use anyhow::bail;
use gapwatch::lab::evaluation::lane_failure::{self, LaneFailure, RATES_PER_HOUR, Sizes};
use gapwatch::model::encoder::Encoder;
use gapwatch::model::{ModelOptions, ModelSpec};
use gapwatch::reference::gap::Metric;
use gapwatch::reference::{ModelFingerprint, Reference};

use super::super::progress;
use super::results::Row;
use super::sheet::{Sheet, with_interval};
use crate::cli::args::EvaluateArgs;

/// What the rows mean.
pub const ABOUT: &str = "A failure is a second in which the lane model's F1 within 2 pixels (at a width of 320) is below a \
    half, but not in the same second on a plain day. \
    It is found if `Gap` is entered between 5 s before and 1 s after its onset. The drives have the plain look and \
    were not used for tuning. Each kind of condition, at severities 1 to 5, grows for 2 s, stays for 8 s and fades for \
    2 s. AUROC and Spearman are over the seconds under a condition; their intervals come from resampling roads. A \
    drive is benign if its F1 is at most 0.1 below that on a plain day. Every method has its own reference and thresholds from the same \
    nominal drives. False alarms are counted on other nominal drives; with several forecasts, those of the forecast \
    with the most are given. `lane-risk` is fitted on drives under the same kinds of condition, and `lane-risk, fitted \
    on other kinds` never on the kind that is judged. `lanes of the reference` is the \
    forecast of the reference as it is, which warns from a half on and has no thresholds of rates.";

/// The model that is judged.
pub struct Judged {
    spec: ModelSpec,
    encoder: Encoder,
    default: bool,
    reference: Option<Reference>,
}

impl Judged {
    /// Opens the one model, which must have a lane head.
    pub fn open(args: &EvaluateArgs) -> anyhow::Result<Self> {
        let file = match args.model.as_slice() {
            [] => None,
            [one] => Some(one.as_path()),
            _ => bail!("lane_failure judges one model at a time; wanted one --model"),
        };
        let spec = ModelSpec::new(file, ModelOptions::default())?;
        if spec.lane.is_none() {
            bail!(
                "{}: no lane output is named; wanted lane = \"NAME\" in the .toml beside it",
                spec.name
            );
        }
        let encoder = Encoder::load_with_lane(&spec)?;
        let reference = Reference::read(args.reference.as_deref())?;
        let fits = reference.check_fits("the reference", &ModelFingerprint::new(&spec, &encoder));
        Ok(Self {
            reference: fits.is_ok().then_some(reference),
            encoder,
            spec,
            default: file.is_none(),
        })
    }
}

fn sizes(quick: bool) -> Sizes {
    if quick { Sizes::QUICK } else { Sizes::FULL }
}

/// Judges every method at every rate.
pub fn rows(judged: &Judged, args: &EvaluateArgs) -> anyhow::Result<Vec<Row<LaneFailure>>> {
    let sizes = sizes(args.quick);
    let bar = progress::over(Some(sizes.drives()), "lane failure", "drives");
    let Judged { spec, encoder, .. } = judged;
    let rows = lane_failure::rows(
        &spec.taps,
        encoder,
        &spec.preprocessing,
        judged.reference.as_ref(),
        sizes,
        &|| bar.inc(1),
    )?;
    bar.finish_and_clear();
    let default = Metric::DEFAULT.to_string();
    Ok(rows
        .into_iter()
        .map(|of| Row {
            default: judged.default && of.method == default,
            of,
        })
        .collect())
}

/// The seeds of what is rendered.
pub fn seeds(quick: bool) -> String {
    lane_failure::seeds_of(sizes(quick))
}

/// A table of what does not depend on the rate, then one table for each rate.
pub fn sheets(rows: &[Row<LaneFailure>]) -> Vec<Sheet> {
    let per_cent = |share: Option<f64>, interval: (f64, f64)| {
        share.map_or_else(
            || "-".to_owned(),
            |share| {
                with_interval(
                    100.0 * share,
                    Some((100.0 * interval.0, 100.0 * interval.1)),
                    0,
                )
            },
        )
    };
    let number = |value: Option<f64>, interval| {
        value.map_or_else(|| "-".to_owned(), |value| with_interval(value, interval, 3))
    };
    let mut ranks = Sheet::new(
        "Score and loss of F1, second by second".to_owned(),
        [
            "method",
            "AUROC, failures",
            "Spearman, loss",
            "seconds",
            "failed",
            "not judged",
        ],
    );
    for Row { of, .. } in rows {
        if of.wanted_per_hour.total_cmp(&RATES_PER_HOUR[0]).is_eq() {
            ranks.rows.push(vec![
                label(of),
                number(of.auroc, of.auroc_interval),
                number(of.spearman, of.spearman_interval),
                of.seconds.to_string(),
                of.failed_seconds.to_string(),
                of.unjudged_seconds.to_string(),
            ]);
        }
    }
    let mut sheets = vec![ranks];
    for rate in RATES_PER_HOUR {
        let mut sheet = Sheet::new(
            format!("Failures found at {rate} false alarms an hour"),
            [
                "method",
                "recall, %",
                "within 3 s after, %",
                "of",
                "precision, %",
                "lead, s",
                "alarms on benign drives, %",
                "of",
                "severity 3 and above found within 2 s, %",
                "of",
                "false alarms an hour, nominal drives",
            ],
        );
        for Row { of, .. } in rows {
            if !of.wanted_per_hour.total_cmp(&rate).is_eq() {
                continue;
            }
            let plain = |value: Option<f64>, scale: f64, decimals: usize| {
                value.map_or_else(|| "-".to_owned(), |v| format!("{:.decimals$}", scale * v))
            };
            sheet.rows.push(vec![
                label(of),
                per_cent(of.recall, of.recall_interval),
                plain(share(of.found_late, of.failures), 100.0, 0),
                of.failures.to_string(),
                plain(of.precision, 100.0, 0),
                plain(of.lead_median_s, 1.0, 1),
                per_cent(of.benign_share, of.benign_interval),
                of.benign.to_string(),
                per_cent(share(of.severe_found, of.severe), of.severe_interval),
                of.severe.to_string(),
                with_interval(of.false_alarms_per_hour, Some(of.false_alarms_interval), 2),
            ]);
        }
        sheets.push(sheet);
    }
    sheets
}

// Counts of drives are small.
#[allow(clippy::cast_precision_loss)]
fn share(of: u64, all: u64) -> Option<f64> {
    (all > 0).then(|| of as f64 / all as f64)
}

fn label(of: &LaneFailure) -> String {
    if of.baseline {
        format!("{} (baseline)", of.method)
    } else {
        of.method.clone()
    }
}
