//! `gapwatch evaluate`: how accurate models and the monitor are, on fixed scenes and drives.

mod domain_detection;
mod false_alarms;
mod lane_iou;
mod watched;

use std::io::Write;

use anyhow::{Context, bail};
use gapwatch::encoder::Encoder;
use gapwatch::evaluation::LaneIou;
use gapwatch::evaluation::domain_detection::Detection;
use gapwatch::evaluation::false_alarms::FalseAlarmRate;
use gapwatch::model::{ModelOptions, ModelSpec};
use gapwatch::whole_file::WholeFile;
use serde::Serialize;

use crate::args::{EvaluateArgs, EvaluateKey, Format};
use watched::Watched;

/// What is evaluated, under the keys of the JSON.
#[derive(Serialize)]
struct Results {
    gapwatch: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    lane_iou: Option<Vec<Row<LaneIou>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    domain_detection: Option<Vec<Row<Detection>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    false_alarms: Option<Vec<Row<FalseAlarmRate>>>,
}

#[derive(Serialize)]
struct Row<T> {
    #[serde(flatten)]
    of: T,
    default: bool,
}

pub fn run(args: &EvaluateArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    if args.format == Format::Csv && args.only != Some(EvaluateKey::LaneIou) {
        bail!("--format csv is for --only lane_iou; wanted table or json");
    }
    let wanted = |key: EvaluateKey| args.only.is_none_or(|only| only == key);
    let built_in = ModelSpec::new(None, ModelOptions::default())?;
    let built_in = Encoder::load(&built_in)?.sha256().to_owned();
    // What cannot be opened is refused before any work is done that could be lost.
    let models = if wanted(EvaluateKey::LaneIou) {
        lane_iou::models(&args.model)?
    } else {
        Vec::new()
    };
    let watched = if wanted(EvaluateKey::DomainDetection) || wanted(EvaluateKey::FalseAlarms) {
        Some(Watched::open(args)?)
    } else {
        None
    };
    let file = match &args.out {
        Some(path) => {
            let file = WholeFile::create(path);
            Some((
                file.with_context(|| format!("cannot write {}", path.display()))?,
                path,
            ))
        }
        None => None,
    };
    let mut results = Results {
        gapwatch: env!("CARGO_PKG_VERSION"),
        lane_iou: None,
        domain_detection: None,
        false_alarms: None,
    };
    if wanted(EvaluateKey::LaneIou) {
        results.lane_iou = Some(lane_iou::rows(&models, args, &built_in)?);
    }
    if let Some(watched) = &watched {
        if wanted(EvaluateKey::DomainDetection) {
            results.domain_detection = Some(domain_detection::rows(watched, args)?);
        }
        if wanted(EvaluateKey::FalseAlarms) {
            results.false_alarms = Some(false_alarms::rows(watched, args)?);
        }
    }
    let json = serde_json::to_string_pretty(&results)? + "\n";
    if let Some((mut file, path)) = file {
        file.write_all(json.as_bytes())
            .and_then(|()| file.finish())
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    match args.format {
        Format::Json => out.write_all(json.as_bytes())?,
        Format::Csv => lane_iou::csv(results.lane_iou.as_deref().unwrap_or_default(), out)?,
        Format::Table => {
            if let Some(rows) = &results.lane_iou {
                lane_iou::table(rows, out)?;
            }
            if let Some(rows) = &results.domain_detection {
                domain_detection::table(rows, out)?;
            }
            if let Some(rows) = &results.false_alarms {
                false_alarms::table(rows, out)?;
            }
        }
    }
    Ok(0)
}
