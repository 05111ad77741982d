//! `gapwatch compare`: image sets against a reference set, as in the paper's table.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use anyhow::{Context, bail};
use gapwatch::attention::EnergyMap;
use gapwatch::calibration::{PaperBinning, TapHistogram, counts_of};
use gapwatch::frame::{drives, open};
use gapwatch::gap::Metric;
use gapwatch::histogram::{Binning, HistogramSum};
use gapwatch::survey::{Survey, SurveyError};
use gapwatch::undefined::Undefined;
use gapwatch::whole_file::WholeFile;
use rayon::prelude::*;
use serde::Serialize;
use serde_json::{Map, Value, json};

use super::{Model, progress};
use crate::args::{CompareArgs, Format};

/// A set's comparison by one metric.
struct Row {
    set: String,
    metric: Metric,
    images: usize,
    judged: usize,
    values: Vec<Result<f64, Undefined>>,
}

/// A set's histogram of one tap, for `--histograms`.
#[derive(Serialize)]
struct HistogramRecord<'a> {
    set: &'a str,
    metric: Metric,
    tap: &'a str,
    median_peak_energy: f64,
    binning: Binning,
    images: u64,
    counts: Vec<u64>,
}

/// The frames of a set, which may be several drives.
struct ImageSet {
    name: String,
    surveys: Vec<Survey>,
}

impl ImageSet {
    fn images(&self) -> usize {
        self.surveys.iter().map(|survey| survey.frames.len()).sum()
    }

    fn maps(&self, tap: usize) -> impl Iterator<Item = Result<EnergyMap, Undefined>> + '_ {
        self.surveys
            .iter()
            .flat_map(move |survey| survey.common_maps(tap))
    }
}

pub fn run(args: &CompareArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    let paper = PaperBinning {
        temperature: args.temperature,
        levels: args.levels,
        first: args.first_level,
    };
    if !(2..=65_536).contains(&paper.levels) || paper.first >= paper.levels {
        bail!(
            "--levels {} --first-level {}: wanted 2 to 65536 levels and a first one below that",
            paper.levels,
            paper.first
        );
    }
    let histograms = args.histograms.as_deref().map(create).transpose()?;
    let model = Model::load(&args.model)?;
    let sets = survey_sets(args, &model)?;
    let Some((reference, others)) = sets.split_first() else {
        bail!("wanted a reference and at least one set")
    };
    let (mut rows, mut records) = (Vec::new(), Vec::new());
    for &metric in &args.metric.0 {
        let fitted = (0..model.spec.taps.len())
            .map(|tap| fit(reference, tap, metric, paper))
            .collect::<anyhow::Result<Vec<_>>>()?;
        let mut record = |set: &ImageSet, tap: usize, sum: HistogramSum| {
            records.push(json!(HistogramRecord {
                set: &set.name,
                metric,
                tap: &model.spec.taps[tap],
                median_peak_energy: fitted[tap].median_peak_energy,
                binning: fitted[tap].binning.clone(),
                images: sum.images,
                counts: sum.counts,
            }));
        };
        fitted
            .iter()
            .enumerate()
            .for_each(|(tap, fitted)| record(reference, tap, fitted.sum.clone()));
        for set in others {
            let summed: Vec<_> = fitted
                .iter()
                .enumerate()
                .map(|(tap, fitted)| sum_of(set, tap, &fitted.binning))
                .collect();
            let judged = summed.iter().map(|(sum, _)| sum.images).min().unwrap_or(0);
            let values = fitted
                .iter()
                .zip(&summed)
                .map(|(fitted, (sum, reason))| match reason {
                    Some(reason) if sum.images == 0 => Err(reason.clone()),
                    _ => metric
                        .compare(&sum.counts, &fitted.sum.counts)
                        .map(|compared| compared.value),
                });
            let (images, judged) = (set.images(), usize::try_from(judged).unwrap_or(usize::MAX));
            rows.push(Row {
                set: set.name.clone(),
                metric,
                images,
                judged,
                values: values.collect(),
            });
            summed
                .into_iter()
                .enumerate()
                .for_each(|(tap, (sum, _))| record(set, tap, sum));
        }
    }
    if let (Some(mut file), Some(path)) = (histograms, &args.histograms) {
        serde_json::to_writer(&mut file, &records)
            .map_err(std::io::Error::from)
            .and_then(|()| file.finish())
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    match args.format {
        Format::Table => write_table(&rows, &model.spec.taps, &reference.name, out)?,
        Format::Json => writeln!(
            out,
            "{:#}",
            Value::Array(
                rows.iter()
                    .map(|row| row_json(row, &model.spec.taps))
                    .collect()
            )
        )?,
        Format::Csv => write_csv(&rows, &model.spec.taps, out)?,
    }
    Ok(0)
}

fn create(path: &Path) -> anyhow::Result<WholeFile> {
    WholeFile::create(path).with_context(|| format!("cannot write {}", path.display()))
}

fn survey_sets(args: &CompareArgs, model: &Model) -> anyhow::Result<Vec<ImageSet>> {
    let names = args
        .sources
        .iter()
        .map(|name| drives(name))
        .collect::<Result<Vec<_>, _>>()?;
    let counts = names
        .iter()
        .flatten()
        .map(|name| Ok(open(name)?.frame_count()))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let bar = progress::frames(counts.into_iter().sum(), "comparing");
    let sets = args
        .sources
        .par_iter()
        .zip(&names)
        .map(|(set, names)| {
            let surveys = names
                .par_iter()
                .map(|name| {
                    Survey::of(name, &model.encoder, &model.spec.preprocessing, &|| {
                        bar.inc(1)
                    })
                })
                .collect::<Result<Vec<_>, SurveyError>>()?;
            Ok(ImageSet {
                name: set.clone(),
                surveys,
            })
        })
        .collect::<Result<Vec<_>, SurveyError>>()?;
    bar.finish_and_clear();
    Ok(sets)
}

/// The reference must be whole: every image of it counts.
fn fit(
    reference: &ImageSet,
    tap: usize,
    metric: Metric,
    paper: PaperBinning,
) -> anyhow::Result<TapHistogram> {
    let maps = reference.maps(tap).enumerate().map(|(index, map)| {
        map.with_context(|| {
            format!(
                "reference {}: image {} in order cannot be judged",
                reference.name,
                index + 1
            )
        })
    });
    let maps = maps.collect::<anyhow::Result<Vec<_>>>()?;
    TapHistogram::fit(&maps, metric, paper).with_context(|| format!("reference {}", reference.name))
}

/// Counts of the images that can be judged, and why the first of the others cannot.
fn sum_of(set: &ImageSet, tap: usize, binning: &Binning) -> (HistogramSum, Option<Undefined>) {
    let (mut sum, mut reason) = (HistogramSum::new(binning.bins()), None);
    for map in set.maps(tap) {
        match map.and_then(|map| counts_of(binning, &map)) {
            Ok(counts) => sum.add(&counts),
            Err(why) => {
                reason.get_or_insert(why);
            }
        }
    }
    (sum, reason)
}

fn row_json(row: &Row, taps: &[String]) -> Value {
    let mut object = Map::new();
    object.insert("set".to_owned(), json!(row.set));
    object.insert("metric".to_owned(), json!(row.metric));
    let mut reasons = BTreeMap::new();
    for (tap, value) in taps.iter().zip(&row.values) {
        object.insert(tap.clone(), json!(value.as_ref().ok()));
        if let Err(reason) = value {
            reasons.insert(tap, reason.to_string());
        }
    }
    object.insert("images".to_owned(), json!(row.images));
    object.insert("judged".to_owned(), json!(row.judged));
    if !reasons.is_empty() {
        object.insert("reasons".to_owned(), json!(reasons));
    }
    Value::Object(object)
}

fn write_table(
    rows: &[Row],
    taps: &[String],
    reference: &str,
    out: &mut dyn Write,
) -> anyhow::Result<()> {
    let column =
        |of: fn(&Row) -> usize, title: usize| rows.iter().map(of).chain([title]).max().unwrap_or(0);
    let set_width = column(|row| row.set.chars().count(), 3);
    let metric_width = column(|row| row.metric.name().len(), 6);
    let tap_widths: Vec<usize> = taps.iter().map(|tap| tap.chars().count().max(9)).collect();
    writeln!(out, "reference: {reference}")?;
    write!(out, "{:set_width$}  {:metric_width$}", "set", "metric")?;
    for (tap, width) in taps.iter().zip(&tap_widths) {
        write!(out, "  {tap:>width$}")?;
    }
    writeln!(out, "  {:>7}", "images")?;
    for row in rows {
        write!(
            out,
            "{:set_width$}  {:metric_width$}",
            row.set,
            row.metric.name()
        )?;
        for (value, width) in row.values.iter().zip(&tap_widths) {
            match value {
                Ok(value) => write!(out, "  {value:>width$.5}")?,
                Err(_) => write!(out, "  {:>width$}", "undefined")?,
            }
        }
        let images = if row.judged == row.images {
            row.images.to_string()
        } else {
            format!("{}/{}", row.judged, row.images)
        };
        write!(out, "  {images:>7}")?;
        match row.values.iter().find_map(|value| value.as_ref().err()) {
            Some(reason) => writeln!(out, "  {reason}")?,
            None => writeln!(out)?,
        }
    }
    Ok(())
}

fn write_csv(rows: &[Row], taps: &[String], out: &mut dyn Write) -> anyhow::Result<()> {
    let quoted = |text: &str| {
        if text.contains(['"', ',', '\n']) {
            format!("\"{}\"", text.replace('"', "\"\""))
        } else {
            text.to_owned()
        }
    };
    let taps: Vec<String> = taps.iter().map(|tap| quoted(tap)).collect();
    writeln!(out, "set,metric,{},images,judged,reason", taps.join(","))?;
    for row in rows {
        let values: Vec<String> = row
            .values
            .iter()
            .map(|v| v.as_ref().map_or_else(|_| String::new(), f64::to_string))
            .collect();
        let reason = row
            .values
            .iter()
            .find_map(|v| v.as_ref().err())
            .map(ToString::to_string)
            .unwrap_or_default();
        let (set, values, reason) = (quoted(&row.set), values.join(","), quoted(&reason));
        writeln!(
            out,
            "{set},{},{values},{},{},{reason}",
            row.metric, row.images, row.judged
        )?;
    }
    Ok(())
}
