//! `gapwatch compare`: image sets against a reference set, as table, JSON or CSV.

use std::collections::BTreeMap;
use std::io::Write;

use anyhow::{Context, bail};
use gapwatch::calibration::PaperBinning;
use gapwatch::calibration::survey::Keep;
use gapwatch::capture::drives;
use gapwatch::files::whole_file::WholeFile;
use gapwatch::lab::comparison::{Comparisons, ImageSet, Row, compare};
use serde_json::{Map, Value, json};

use super::loaded_model::LoadedModel;
use super::output::{Kind, check_output};
use crate::cli::args::{CompareArgs, Format};

pub fn run(args: &CompareArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    let paper = PaperBinning {
        temperature: args.temperature,
        levels: args.levels,
        first: args.first_level,
    };
    if !(2..=65_536).contains(&paper.levels) || paper.first >= paper.levels {
        bail!(
            "--levels {} --first-level {}: wanted 2 to 65536 levels, and a first level below their number",
            paper.levels,
            paper.first
        );
    }
    let model = args.model.model.iter();
    let inputs = model.filter_map(|file| Some(("--model", file.to_str()?)));
    let sources = args.sources.iter().map(|name| ("compare", name.as_str()));
    if let Some(file) = &args.histograms {
        check_output(
            "--histograms",
            file,
            Kind::Histograms,
            inputs.chain(sources),
        )?;
    }
    let histograms = match &args.histograms {
        Some(path) => {
            let name = path.display().to_string();
            Some((
                WholeFile::create(path).with_context(|| format!("cannot write {name}"))?,
                name,
            ))
        }
        None => None,
    };
    let model = LoadedModel::load(&args.model)?;
    let taken =
        |tap: &&String| ["set", "metric", "images", "judged", "reasons"].contains(&tap.as_str());
    if let Some(tap) = model.spec.taps.iter().find(taken) {
        bail!("tap {tap:?} has the name of another column of the result; rename it in the model");
    }
    let sets = survey_sets(&args.sources, &model)?;
    let Some((reference, others)) = sets.split_first() else {
        bail!("wanted a reference and at least one set")
    };
    let taps = &model.spec.taps;
    let Comparisons {
        rows,
        histograms: records,
    } = compare(reference, others, taps, &args.metric.0, paper)?;
    if let Some((mut file, name)) = histograms {
        serde_json::to_writer(&mut file, &records)
            .map_err(std::io::Error::from)
            .and_then(|()| file.finish())
            .with_context(|| format!("cannot write {name}"))?;
    }
    match args.format {
        Format::Table => write_table(&rows, taps, &reference.name, out)?,
        Format::Json => writeln!(
            out,
            "{:#}",
            Value::Array(rows.iter().map(|row| row_json(row, taps)).collect())
        )?,
        Format::Csv => write_csv(&rows, taps, out)?,
    }
    Ok(0)
}

fn survey_sets(names: &[String], model: &LoadedModel) -> anyhow::Result<Vec<ImageSet>> {
    let drives = names
        .iter()
        .map(|name| drives(name))
        .collect::<Result<Vec<_>, _>>()?;
    let mut surveys = model
        .survey(&drives.concat(), Keep::Maps, "comparing")?
        .into_iter();
    let set = |(name, drives): (&String, &Vec<String>)| ImageSet {
        name: name.clone(),
        surveys: surveys.by_ref().take(drives.len()).collect(),
    };
    Ok(names.iter().zip(&drives).map(set).collect())
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
    let metric_width = column(|row| row.metric.to_string().len(), 6);
    let tap_widths: Vec<usize> = taps.iter().map(|tap| tap.chars().count().max(9)).collect();
    writeln!(out, "reference: {reference}")?;
    write!(out, "{:set_width$}  {:metric_width$}", "set", "metric")?;
    for (tap, width) in taps.iter().zip(&tap_widths) {
        write!(out, "  {tap:>width$}")?;
    }
    writeln!(out, "  {:>7}", "images")?;
    for row in rows {
        write!(out, "{:set_width$}  {:metric_width$}", row.set, row.metric)?;
        for (value, width) in row.values.iter().zip(&tap_widths) {
            match value {
                Ok(value) => write!(out, "  {value:>width$.5}")?,
                Err(_) => write!(out, "  {:>width$}", "undefined")?,
            }
        }
        let images = if row.judged == row.images as u64 {
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
