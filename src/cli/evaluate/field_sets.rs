//! How well image sets of other roads are distinguished from simulations: rows and tables.

use gapwatch::lab::evaluation::field_sets::{
    Case, FieldSetRow, TapSeparation, WINDOWS, rows as rows_of, steps,
};
use gapwatch::reference::gap::Metric;

use super::super::progress;
use super::field::{BEAMNG, Field, HIGHWAY, POSES, TOWN_05, TOWNS};
use super::results::Row;
use super::sheet::{Sheet, with_interval};
use crate::cli::args::EvaluateArgs;

/// What the rows mean.
pub const ABOUT: &str = "Disjoint windows of N images of other roads are compared with windows of the same size of \
    unseen images of the reference's own domain. AUROC is how often a window of the set has the larger gap. Recall is \
    the share of windows of the set above the lowest threshold that at most 5 % of the nominal windows exceed; if \
    there are fewer than 20 nominal windows, none of them exceeds it. Every second block of the reference makes \
    histograms or moments, and the others scale the gaps of the taps. `fused` is the largest score of the taps, as in \
    the monitor. Intervals are 95 %: percentiles over 1,000 resamples of whole blocks of neighbouring images. Blocks \
    are at least twice as long as the autocorrelation time of the gaps. Intervals are never narrower than the score \
    interval for as many independent values as there are blocks (Newcombe 2006 for AUROC, Wilson for recall). The \
    reference is not resampled. Each set is one drive or town, so intervals say what other moments of the same \
    recordings would give, and not what other roads would give.";

/// Name of the rendered reference.
const RENDERED: &str = "scene:sim";
/// Its drives (the same as those of the shipped reference) and unseen drives, and both for the quick evaluation.
const DRIVES: [&str; 2] = [
    "scene:sim?seed=1001..1400&seconds=3",
    "scene:sim?seed=80001..80100&seconds=3",
];
const QUICK_DRIVES: [&str; 2] = [
    "scene:sim?seed=1001..1030&seconds=1",
    "scene:sim?seed=80001..80020&seconds=1",
];
/// Number of images of random pixels.
const RANDOM: usize = 120;

fn rendered(quick: bool) -> [&'static str; 2] {
    if quick { QUICK_DRIVES } else { DRIVES }
}

/// The seeds of what is rendered, as text.
pub fn seeds(quick: bool) -> String {
    let [reference, nominal] = rendered(quick);
    format!("reference `{reference}`, unseen `{nominal}`, random pixels 1")
}

/// Compares every set with both references.
pub fn rows(field: &Field, args: &EvaluateArgs) -> anyhow::Result<Vec<Row<FieldSetRow>>> {
    let (towns, town_05) = (field.look(&TOWNS)?, field.look(&TOWN_05)?);
    let (highway, beamng, poses) = (
        field.look(&HIGHWAY)?,
        field.look(&BEAMNG)?,
        field.look(&POSES)?,
    );
    let random = field.random(RANDOM)?;
    let [reference, unseen] = rendered(args.quick);
    let drives = field.render(RENDERED, reference)?;
    let unseen = field.render("scene:sim, unseen drives", unseen)?;
    let cases = [
        Case {
            reference: &towns,
            nominal: &town_05,
            shifted: vec![&highway, &beamng, &poses, &random],
        },
        Case {
            reference: &drives,
            nominal: &unseen,
            shifted: vec![&highway, &beamng, &towns, &town_05, &poses, &random],
        },
    ];
    let taps = field.taps();
    let bar = progress::over(
        Some((cases.len() * steps(taps.len())) as u64),
        "field sets",
        "gaps",
    );
    let mut rows = Vec::new();
    for case in &cases {
        let found = rows_of(case, taps, &|| bar.inc(1))?;
        rows.extend(found.into_iter().map(|of| Row {
            default: of.metric == Metric::DEFAULT && of.reference == RENDERED,
            of,
        }));
    }
    bar.finish_and_clear();
    Ok(rows)
}

/// Tables for each reference and number of images, with metrics in rows and sets in columns.
pub fn sheets(rows: &[Row<FieldSetRow>]) -> Vec<Sheet> {
    let mut references: Vec<&str> = rows.iter().map(|row| &*row.of.reference).collect();
    references.dedup();
    let mut sheets = Vec::new();
    for reference in references {
        for images in WINDOWS {
            let own = rows.iter().map(|row| &row.of);
            let own = own.filter(|of| of.reference == reference && of.images == images);
            sheets.extend(of_one(&own.collect::<Vec<_>>()));
        }
    }
    sheets
}

/// The tables of one reference and number of images.
fn of_one(rows: &[&FieldSetRow]) -> Vec<Sheet> {
    let Some(first) = rows.first() else {
        return Vec::new();
    };
    let taps: Vec<&str> = first.taps.iter().map(|tap| &*tap.tap).collect();
    let taps = taps.split_last().map(|(_, taps)| taps.join(" / "));
    let of_title = |what: &str| {
        format!(
            "{what} against {}, {} a window, reference {}",
            first.nominal,
            count(first.images, "image"),
            first.reference
        )
    };
    let fused = |of: &FieldSetRow, shown: fn(&TapSeparation) -> Option<String>| {
        of.taps.last().and_then(shown)
    };
    let auroc = table(rows, of_title("AUROC"), |of| {
        fused(of, |tap| {
            Some(with_interval(tap.auroc?, tap.auroc_interval, 2))
        })
    });
    let recall = table(rows, of_title("Recall"), |of| {
        fused(of, |tap| {
            Some(with_interval(tap.recall?, tap.recall_interval, 2))
        })
    });
    let by_tap = format!("AUROC of {}", taps.unwrap_or_default());
    let by_tap = table(rows, of_title(&by_tap), |of| {
        let (_, taps) = of.taps.split_last()?;
        let cells = taps.iter().map(|tap| Some(format!("{:.2}", tap.auroc?)));
        Some(cells.collect::<Option<Vec<_>>>()?.join(" / "))
    });
    let mut sheets = vec![auroc, recall, by_tap];
    sheets[0].notes = notes(rows, first);
    sheets
}

/// A table with metrics in rows and sets in columns.
fn table(
    rows: &[&FieldSetRow],
    title: String,
    cell: impl Fn(&FieldSetRow) -> Option<String>,
) -> Sheet {
    let mut sheet = Sheet::new(title, ["metric"]);
    for of_metric in rows.chunk_by(|a, b| a.metric == b.metric) {
        if sheet.rows.is_empty() {
            sheet
                .columns
                .extend(of_metric.iter().map(|of| of.set.clone()));
        }
        let cells = of_metric
            .iter()
            .map(|of| cell(of).unwrap_or_else(|| "undefined".to_owned()));
        let name = of_metric.first().map(|of| of.metric.to_string());
        sheet.rows.push(name.into_iter().chain(cells).collect());
    }
    sheet
}

/// Notes with counts, and with what is undefined.
fn notes(rows: &[&FieldSetRow], first: &FieldSetRow) -> Vec<String> {
    let counted = |name: &str, windows: usize, blocks: usize, drives: usize| {
        format!(
            "{name}: {} in {} of {}",
            count(windows, "window"),
            count(blocks, "block"),
            count(drives, "drive")
        )
    };
    let mut said = vec![counted(
        &first.nominal,
        first.nominal_windows,
        first.nominal_blocks,
        first.nominal_drives,
    )];
    // The counts are those of the first metric that has all of them.
    let of_metrics = rows.chunk_by(|a, b| a.metric == b.metric);
    let whole = of_metrics.max_by_key(|of| of.iter().map(|of| of.windows).sum::<usize>());
    for of in whole.unwrap_or_default() {
        said.push(counted(&of.set, of.windows, of.blocks, of.drives));
    }
    let counts = format!(
        "Reference: {} fitted, {} to scale. {}.",
        count(first.fitted, "image"),
        first.scaled,
        said.join("; ")
    );
    let reasons = rows.iter().filter_map(|of| {
        let reason = of.taps.iter().find_map(|tap| tap.reason.as_ref())?;
        Some(format!("{}, {}: {reason}.", of.metric, of.set))
    });
    let mut reasons: Vec<String> = reasons.collect();
    if let Some((more, shown)) = reasons.len().checked_sub(3).zip(reasons.get(..2)) {
        let mut shown = shown.to_vec();
        shown.push(format!("The same or similar for {} more.", more + 1));
        reasons = shown;
    }
    std::iter::once(counts).chain(reasons).collect()
}

fn count(number: usize, of: &str) -> String {
    format!("{number} {of}{}", if number == 1 { "" } else { "s" })
}
