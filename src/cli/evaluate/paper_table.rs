//! The paper's table: rows and tables.

use gapwatch::lab::evaluation::paper_table::{PaperRow, SetSimilarity, Sets, rows as rows_of};
use gapwatch::reference::gap::Metric;

use super::field::{Field, HIGHWAY, HIGHWAY_CLIP, HIGHWAY_REST};
use super::results::Row;
use super::sheet::{Sheet, with_interval};
use crate::cli::args::EvaluateArgs;

/// What the rows mean.
pub const ABOUT: &str = "Whole image sets are compared with a reference set, as in the paper's table: another set of \
    the reference's own domain, adapted simulation (look `sim-realistic`), plain simulation (look `sim`) or real \
    images, and noise, with equal numbers of images. `paper` is Pearson's correlation of softmax attention at T = 10, \
    bins 101 to 255 (1 = equal). `mahalanobis`, a distance, is given for comparison. Intervals are 95 %: percentiles \
    over 1,000 resamples, with replacement, of blocks of images of the reference and of the sets. A block is 2 s of a \
    clip, or a single rendered scene from a drive of its own. The intervals are moved so that their centre is the \
    value found, because drawing with replacement adds noise that lowers every similarity. Order says whether the \
    similarities fall from the first set to the last, and in what share of the resamples they do. The paper's order \
    does not have to hold here, because the encoder is trained on simulation, and the real images show one road.";

/// Rendered sets with one image for each drive: the plain simulation, more of it, and the adapted simulation.
fn rendered(quick: bool) -> [String; 3] {
    let set = |look: &str, first: u32, drives: u32| {
        let drives = if quick { 30 } else { drives };
        let last = first + drives - 1;
        format!("scene:{look}?seed={first}..{last}&seconds=1&fps=1")
    };
    [
        set("sim", 81_001, 200),
        set("sim", 82_001, 120),
        set("sim-realistic", 83_001, 120),
    ]
}

/// The published metric, and the default metric for comparing sets.
const METRICS: [Metric; 2] = [Metric::Paper, Metric::Mahalanobis];
/// Number of images of random pixels.
const RANDOM: usize = 120;

/// The seeds of what is rendered, as text.
pub fn seeds(quick: bool) -> String {
    let [plain, plain_2, adapted] = rendered(quick);
    format!("`{plain}`, `{plain_2}`, `{adapted}`, random pixels 1")
}

/// Compares with real images as the reference, if there are any, and then with the simulation.
pub fn rows(field: &Field, args: &EvaluateArgs) -> anyhow::Result<Vec<Row<PaperRow>>> {
    let [plain, plain_2, adapted] = rendered(args.quick);
    let plain = field.render("plain simulation", &plain)?;
    let plain_2 = field.render("plain simulation 2", &plain_2)?;
    let adapted = field.render("adapted simulation", &adapted)?;
    let random = field.random(RANDOM)?;
    let real = if field.has_images() {
        let sets = [HIGHWAY_CLIP, HIGHWAY_REST, HIGHWAY];
        let looked = sets.iter().map(|set| field.look(set));
        looked.collect::<anyhow::Result<Vec<_>>>()?
    } else {
        Vec::new()
    };
    let mut tables = Vec::new();
    if let [clip, rest, _] = real.as_slice() {
        tables.push(Sets {
            reference: clip,
            sets: vec![rest, &adapted, &plain, &random],
        });
    }
    let all_real = real.get(2);
    let sets = [Some(&plain_2), Some(&adapted), all_real, Some(&random)];
    tables.push(Sets {
        reference: &plain,
        sets: sets.into_iter().flatten().collect(),
    });
    let rows = tables
        .iter()
        .flat_map(|sets| rows_of(sets, field.taps(), &METRICS));
    Ok(rows
        .map(|of| Row {
            default: of.metric == Metric::DEFAULT,
            of,
        })
        .collect())
}

/// A table for each reference and metric, with sets in rows and taps in columns.
pub fn sheets(rows: &[Row<PaperRow>]) -> Vec<Sheet> {
    rows.chunk_by(|a, b| (&a.of.reference, a.of.metric) == (&b.of.reference, b.of.metric))
        .map(sheet)
        .collect()
}

fn sheet(taps: &[Row<PaperRow>]) -> Sheet {
    let mut sheet = Sheet::new(String::new(), ["set"]);
    let taps: Vec<&PaperRow> = taps.iter().map(|row| &row.of).collect();
    let Some(first) = taps.first() else {
        return sheet;
    };
    sheet.title = format!(
        "Reference {}, {} images in {} blocks; metric {}",
        first.reference, first.images, first.blocks, first.metric
    );
    sheet.columns.extend(taps.iter().map(|of| of.tap.clone()));
    sheet.columns.push("images".to_owned());
    sheet.columns.push("blocks".to_owned());
    let shown = |of: &SetSimilarity| match of.value {
        Some(value) => with_interval(value, of.interval, 3),
        None => "undefined".to_owned(),
    };
    for (index, set) in first.sets.iter().enumerate() {
        let mut cells = vec![set.set.clone()];
        let of_taps = taps.iter().filter_map(|of| of.sets.get(index));
        cells.extend(of_taps.map(shown));
        cells.push(set.images.to_string());
        cells.push(set.blocks.to_string());
        sheet.rows.push(cells);
    }
    let order = |of: &&PaperRow| match (of.order_holds, of.order_share) {
        (Some(holds), Some(share)) => format!(
            "{} ({:.0} %)",
            if holds { "holds" } else { "does not hold" },
            100.0 * share
        ),
        _ => "undefined".to_owned(),
    };
    let mut cells = vec!["order".to_owned()];
    cells.extend(taps.iter().map(order));
    cells.resize(sheet.columns.len(), String::new());
    sheet.rows.push(cells);
    for of in &taps {
        for set in &of.sets {
            let said = set.reason.as_ref();
            sheet
                .notes
                .extend(said.map(|why| format!("{}, {}: {why}.", of.tap, set.set)));
        }
    }
    sheet
}
