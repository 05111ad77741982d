//! Lane IoU of models: rows, table and CSV.

use std::io::Write;
use std::path::PathBuf;

use anyhow::bail;
use gapwatch::lab::evaluation::{LaneIou, Setting, lane_iou};
use gapwatch::lab::scene::{ConditionKind, Look};
use gapwatch::model::encoder::Encoder;
use gapwatch::model::{ModelOptions, ModelSpec};

use super::super::progress;
use super::results::Row;
use super::sheet::{Sheet, with_interval};
use crate::cli::args::EvaluateArgs;

/// What the rows mean.
pub const ABOUT: &str = "Intersection over union of the lane model's output with the true lane lines, pooled over all \
    pixels of scenes that were not used for training. The title gives the value on plain days, and the table gives the \
    values under conditions. Intervals are 95 %, from resampling scenes.";

/// Number of scenes for each setting in the full evaluation, and in the quick one.
const SCENES: (u32, u32) = (100, 6);

/// The models to judge. A model that names no lane output is refused.
pub fn models(files: &[PathBuf]) -> anyhow::Result<Vec<(ModelSpec, Encoder)>> {
    let files: Vec<Option<&PathBuf>> = if files.is_empty() {
        vec![None]
    } else {
        files.iter().map(Some).collect()
    };
    let models = files.into_iter().map(|file| {
        let spec = ModelSpec::new(file.map(PathBuf::as_path), ModelOptions::default())?;
        if spec.lane.is_none() {
            bail!(
                "{}: no lane output is named; wanted lane = \"NAME\" in the .toml beside it",
                spec.name
            );
        }
        let encoder = Encoder::load_with_lane(&spec)?;
        Ok((spec, encoder))
    });
    models.collect()
}

/// Measures the lane IoU of every model under every setting.
pub fn rows(
    models: &[(ModelSpec, Encoder)],
    args: &EvaluateArgs,
    built_in: &str,
) -> anyhow::Result<Vec<Row<LaneIou>>> {
    let scenes = match (args.scenes, args.quick) {
        (Some(scenes), _) => scenes,
        (None, true) => SCENES.1,
        (None, false) => SCENES.0,
    };
    let settings = Setting::all();
    let bar = progress::over(
        Some(models.len() as u64 * settings.len() as u64 * u64::from(scenes)),
        "lane IoU",
        "scenes",
    );
    let mut rows = Vec::new();
    for (spec, encoder) in models {
        let default = encoder.sha256() == built_in;
        let cells = lane_iou(spec, encoder, &settings, scenes, &|| bar.inc(1))?;
        rows.extend(cells.into_iter().map(|of| Row { of, default }));
    }
    bar.finish_and_clear();
    Ok(rows)
}

/// Writes one line for each setting and model.
pub fn csv(rows: &[Row<LaneIou>], out: &mut dyn Write) -> anyhow::Result<()> {
    writeln!(
        out,
        "model,default,look,condition,severity,scenes,iou,low,high"
    )?;
    for Row { of, default } in rows {
        let number = |value: Option<f64>| value.map_or_else(String::new, |v| format!("{v:.4}"));
        writeln!(
            out,
            "{},{default},{},{},{},{},{},{},{}",
            of.model,
            of.look,
            of.condition,
            of.severity,
            of.scenes,
            number(of.iou),
            number(of.interval.map(|i| i.0)),
            number(of.interval.map(|i| i.1)),
        )?;
    }
    Ok(())
}

/// A table for each model and look, with conditions in rows and severities in columns, and then where the encoder looks
/// on plain days.
pub fn sheets(rows: &[Row<LaneIou>]) -> Vec<Sheet> {
    let mut models: Vec<&str> = rows.iter().map(|row| row.of.model.as_str()).collect();
    models.dedup();
    let mut sheets = Vec::new();
    for model in models {
        for look in Look::ALL.map(Look::name) {
            let of = |condition: &str, severity: f32| {
                rows.iter().map(|row| &row.of).find(|of| {
                    of.model == model
                        && of.look == look
                        && of.condition == condition
                        && of.severity.total_cmp(&severity).is_eq()
                })
            };
            let Some(plain) = of("none", 0.0) else {
                continue;
            };
            let title = match plain.iou {
                Some(iou) => with_interval(iou, plain.interval, 3),
                None => "undefined (no lane at all)".to_owned(),
            };
            let title = format!(
                "{model}, look {look}: lane IoU {title} on {} scenes",
                plain.scenes
            );
            let mut sheet = Sheet::new(title, ["severity", "1", "2", "3", "4", "5"]);
            for kind in ConditionKind::ALL.map(ConditionKind::name) {
                let cells = (1..=5_u8).map(|severity| {
                    let iou = of(kind, f32::from(severity)).and_then(|of| of.iou);
                    iou.map_or_else(|| "-".to_owned(), |iou| format!("{iou:.3}"))
                });
                sheet
                    .rows
                    .push(std::iter::once(kind.to_owned()).chain(cells).collect());
            }
            for tap in &plain.attention {
                if let (Some(peak), Some(on), Some(lift)) =
                    (tap.peak_energy, tap.on_lanes, tap.lift)
                {
                    sheet.notes.push(format!(
                        "{}: median peak energy {peak:.1}, {:.1} % of the energy on lanes, {lift:.1} times their share of the picture",
                        tap.tap,
                        100.0 * on
                    ));
                }
            }
            sheets.push(sheet);
        }
    }
    sheets
}
