//! `gapwatch evaluate`: measures how accurate models and the monitor are on fixed scenes and drives.
//!
//! Each key has a file below: `rows` makes its results, `ABOUT` says what they mean, and `sheets` shows them.

mod cause;
mod command;
mod domain_detection;
mod false_alarms;
mod field;
mod field_sets;
mod lane_failure;
mod lane_iou;
mod paper_table;
mod real_lanes;
mod results;
mod sheet;
mod speed_error;
mod watched;

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::ValueEnum;
use gapwatch::model::encoder::Encoder;
use gapwatch::model::{ModelOptions, ModelSpec};
use serde::de::DeserializeOwned;

use super::output::{Kind, check_output};
use crate::cli::args::{EvaluateArgs, EvaluateKey, ResultsFormat};
use field::Field;
use results::{Results, Row, Store};
use sheet::Sheet;
use watched::Watched;

pub fn run(args: &EvaluateArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    if args.format == ResultsFormat::Csv && args.only != Some(EvaluateKey::LaneIou) {
        bail!("--format csv is for --only lane_iou; wanted table, json or markdown");
    }
    if !args.from.is_empty() {
        let pages = matches!(args.format, ResultsFormat::Table | ResultsFormat::Markdown);
        if args.from.len() > 1 && !pages {
            bail!("several files can be shown only as table or markdown; wanted one --from");
        }
        if args.format == ResultsFormat::Markdown {
            made_from(&args.from, out)?;
        }
        for (index, path) in args.from.iter().enumerate() {
            let all = Results::read(path)?;
            if index > 0 && args.format == ResultsFormat::Markdown {
                writeln!(out, "# Results of `{}`\n", command::portable(path))?;
            }
            match args.only {
                Some(key) if !all.has(key) => {
                    bail!("{}: no key {}", path.display(), key.name())
                }
                Some(key) => show(&all.only(key), args, out)?,
                None => show(&all, args, out)?,
            }
        }
        return Ok(0);
    }
    let wanted = |key: EvaluateKey| args.only.is_none_or(|only| only == key);
    for (asked, flag) in [
        (args.plot.is_some(), "--plot"),
        (args.budget.is_some(), "--budget"),
    ] {
        if asked && !wanted(EvaluateKey::SpeedError) {
            bail!("{flag} is for speed_error; wanted --only speed_error, or everything");
        }
    }
    let built_in = ModelSpec::new(None, ModelOptions::default())?;
    let built_in = Encoder::load(&built_in)?.sha256().to_owned();
    // Whatever cannot be opened is an error before any work is done that could be lost.
    let models = if wanted(EvaluateKey::LaneIou) {
        lane_iou::models(&args.model)?
    } else {
        Vec::new()
    };
    let of_watched = [
        EvaluateKey::DomainDetection,
        EvaluateKey::FalseAlarms,
        EvaluateKey::Cause,
    ];
    let watched = if of_watched.into_iter().any(wanted) {
        Some(Watched::open(args)?)
    } else {
        None
    };
    let also = Watched::also(args)?;
    if let Some(watched) = watched.as_ref().filter(|_| wanted(EvaluateKey::Cause)) {
        let knows = watched.reference.causes.is_some();
        if args.only == Some(EvaluateKey::Cause) && !knows {
            bail!("the reference knows no causes; wanted one made with calibrate --causes");
        }
        if !knows {
            log::warn!("cause is left out, because the reference knows no causes");
        }
    }
    for key in [EvaluateKey::FieldSets, EvaluateKey::RealLanes] {
        if args.only == Some(key) && args.field.is_none() {
            bail!(
                "{} needs the image sets of other roads; wanted --field DIR",
                key.name()
            );
        }
    }
    let drawn = match &args.field {
        Some(folder) if wanted(EvaluateKey::RealLanes) => {
            Some(real_lanes::Drawn::open(folder, args)?)
        }
        _ => None,
    };
    let field = if wanted(EvaluateKey::FieldSets) || wanted(EvaluateKey::PaperTable) {
        Some(Field::open(args)?)
    } else {
        None
    };
    let failing = if wanted(EvaluateKey::LaneFailure) {
        Some(lane_failure::Judged::open(args)?)
    } else {
        None
    };
    let family = if wanted(EvaluateKey::SpeedError) {
        speed_error::models(&args.model)?
    } else {
        Vec::new()
    };
    if let Some(file) = &args.plot {
        check_output("--plot", file, Kind::Chart, [])?;
    }
    let store = args.out.as_deref().map(Store::open).transpose()?;
    if args.field.is_none() && args.only.is_none() {
        log::warn!(
            "field_sets, real_lanes and the real images of paper_table are left out, because they need --field DIR"
        );
    }
    let mut results = Results::default();
    for &key in EvaluateKey::value_variants() {
        if !wanted(key) {
            continue;
        }
        match (key, &watched, &field) {
            (EvaluateKey::LaneIou, ..) => {
                let rows = lane_iou::rows(&models, args, &built_in)?;
                results.set(key, &rows, &command::made(key, args))?;
            }
            (EvaluateKey::DomainDetection, Some(watched), _) => {
                let mut rows = domain_detection::rows(watched, args)?;
                for watched in &also {
                    rows.extend(domain_detection::rows(watched, args)?);
                }
                results.set(key, &rows, &command::made(key, args))?;
            }
            (EvaluateKey::FalseAlarms, Some(watched), _) => {
                let rows = false_alarms::rows(watched, args)?;
                results.set(key, &rows, &command::made(key, args))?;
            }
            (EvaluateKey::Cause, Some(watched), _) if watched.reference.causes.is_some() => {
                let rows = cause::rows(watched, args)?;
                results.set(key, &rows, &command::made(key, args))?;
            }
            (EvaluateKey::LaneFailure, ..) => {
                let Some(failing) = &failing else { continue };
                let rows = lane_failure::rows(failing, args)?;
                results.set(key, &rows, &command::made(key, args))?;
            }
            (EvaluateKey::SpeedError, ..) => {
                let rows = speed_error::rows(&family, args)?;
                results.set(key, &rows, &command::made(key, args))?;
            }
            (EvaluateKey::FieldSets, _, Some(field)) if field.has_images() => {
                let rows = field_sets::rows(field, args)?;
                results.set(key, &rows, &command::made(key, args))?;
            }
            (EvaluateKey::RealLanes, ..) => {
                let Some(drawn) = &drawn else { continue };
                let rows = real_lanes::rows(drawn, &built_in)?;
                results.set(key, &rows, &command::made(key, args))?;
            }
            (EvaluateKey::PaperTable, _, Some(field)) => {
                let rows = paper_table::rows(field, args)?;
                results.set(key, &rows, &command::made(key, args))?;
            }
            _ => continue,
        }
        if let Some(store) = &store {
            store.keep(key, &results)?;
        }
    }
    if let Some(store) = store {
        store.finish(&results)?;
    }
    show(&results, args, out)?;
    Ok(0)
}

/// What the rows of a key mean, and how they are shown.
struct Page {
    about: &'static str,
    sheets: Vec<Sheet>,
}

/// The page of a key, if it was evaluated.
fn page(results: &Results, key: EvaluateKey) -> anyhow::Result<Option<Page>> {
    match key {
        EvaluateKey::LaneIou => page_of(results, key, lane_iou::ABOUT, lane_iou::sheets),
        EvaluateKey::DomainDetection => page_of(
            results,
            key,
            domain_detection::ABOUT,
            domain_detection::sheets,
        ),
        EvaluateKey::FalseAlarms => {
            page_of(results, key, false_alarms::ABOUT, false_alarms::sheets)
        }
        EvaluateKey::Cause => page_of(results, key, cause::ABOUT, cause::sheets),
        EvaluateKey::LaneFailure => {
            page_of(results, key, lane_failure::ABOUT, lane_failure::sheets)
        }
        EvaluateKey::SpeedError => page_of(results, key, speed_error::ABOUT, speed_error::sheets),
        EvaluateKey::FieldSets => page_of(results, key, field_sets::ABOUT, field_sets::sheets),
        EvaluateKey::RealLanes => page_of(results, key, real_lanes::ABOUT, real_lanes::sheets),
        EvaluateKey::PaperTable => page_of(results, key, paper_table::ABOUT, paper_table::sheets),
    }
}

fn page_of<T: DeserializeOwned>(
    results: &Results,
    key: EvaluateKey,
    about: &'static str,
    sheets: fn(&[Row<T>]) -> Vec<Sheet>,
) -> anyhow::Result<Option<Page>> {
    let rows = results.rows(key)?;
    Ok(rows.map(|rows| Page {
        about,
        sheets: sheets(&rows),
    }))
}

fn show(results: &Results, args: &EvaluateArgs, out: &mut dyn Write) -> anyhow::Result<()> {
    if let Some(path) = &args.plot {
        let rows = results.rows(EvaluateKey::SpeedError)?;
        let rows = rows.context("--plot draws speed_error, which is not among the results")?;
        speed_error::plot(&rows, path)?;
    }
    match args.format {
        ResultsFormat::Json => out.write_all(results.to_json()?.as_bytes())?,
        ResultsFormat::Csv => {
            let rows = results.rows(EvaluateKey::LaneIou)?;
            lane_iou::csv(&rows.unwrap_or_default(), out)?;
        }
        ResultsFormat::Table => {
            for &key in EvaluateKey::value_variants() {
                for sheet in page(results, key)?.iter().flat_map(|page| &page.sheets) {
                    sheet.text(out)?;
                }
            }
        }
        ResultsFormat::Markdown => markdown(results, out)?,
    }
    if let Some(percent) = args.budget {
        let rows = results.rows(EvaluateKey::SpeedError)?;
        let rows = rows.context("--budget is for speed_error, which is not among the results")?;
        writeln!(out, "{}", speed_error::within(&rows, percent)?)?;
    }
    Ok(())
}

fn made_from(paths: &[PathBuf], out: &mut dyn Write) -> anyhow::Result<()> {
    let names: Vec<String> = paths.iter().map(|path| command::portable(path)).collect();
    writeln!(
        out,
        "# Results\n\nMade by `gapwatch evaluate --from {} --format markdown`. Do not edit.\n",
        names.join(" ")
    )?;
    Ok(())
}

fn markdown(results: &Results, out: &mut dyn Write) -> anyhow::Result<()> {
    for &key in EvaluateKey::value_variants() {
        let Some(page) = page(results, key)? else {
            continue;
        };
        writeln!(out, "## {}\n\n{}\n", key.name(), page.about)?;
        if let Some(made) = results.made(key) {
            writeln!(
                out,
                "Seeds: {}. Made by gapwatch {} with:\n\n```\n{}\n```\n",
                made.seeds, made.gapwatch, made.command
            )?;
        }
        for sheet in &page.sheets {
            sheet.markdown(out)?;
        }
    }
    Ok(())
}
