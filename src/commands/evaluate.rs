//! `gapwatch evaluate`: how accurate models and the monitor are, on fixed scenes and drives.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, bail};
use gapwatch::encoder::Encoder;
use gapwatch::evaluation::domain_detection::{Detection, Event, WITHIN_S, detection};
use gapwatch::evaluation::false_alarms::{self, FalseAlarmRate};
use gapwatch::evaluation::watched::{Script, scores_of};
use gapwatch::evaluation::{LaneIou, Setting, lane_iou};
use gapwatch::model::{ModelOptions, ModelSpec};
use gapwatch::reference::{ModelFingerprint, Reference};
use gapwatch::scene::{ConditionKind, Look};
use gapwatch::whole_file::WholeFile;
use serde::Serialize;

use super::progress;
use crate::args::{EvaluateArgs, EvaluateKey, Format};

/// Scenes a setting of the full evaluation, and of the quick one.
const SCENES: (u32, u32) = (100, 6);

/// Drives an event of the full evaluation, and of the quick one.
const DRIVES: (u32, u32) = (20, 1);
/// Hours of nominal drives of the full evaluation.
const HOURS: u32 = 24;
/// Nominal drives of the quick evaluation, and their length, seconds.
const QUICK_DRIVES: (u32, f64) = (10, 60.0);
/// Rates of false alarms at which events are judged.
const DETECTION_RATES: [f64; 2] = [1.0, 0.1];

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
        lane_models(&args.model)?
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
        results.lane_iou = Some(lane_rows(&models, args, &built_in)?);
    }
    if let Some(watched) = &watched {
        if wanted(EvaluateKey::DomainDetection) {
            results.domain_detection = Some(watched.domain_detection(args)?);
        }
        if wanted(EvaluateKey::FalseAlarms) {
            results.false_alarms = Some(watched.false_alarms(args)?);
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
        Format::Csv => csv(results.lane_iou.as_deref().unwrap_or_default(), out)?,
        Format::Table => {
            if let Some(rows) = &results.lane_iou {
                table(rows, out)?;
            }
            if let Some(rows) = &results.domain_detection {
                detection_table(rows, out)?;
            }
            if let Some(rows) = &results.false_alarms {
                false_alarm_table(rows, out)?;
            }
        }
    }
    Ok(0)
}

fn lane_models(files: &[PathBuf]) -> anyhow::Result<Vec<(ModelSpec, Encoder)>> {
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

fn lane_rows(
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
    let bar = progress::frames(
        Some(models.len() as u64 * settings.len() as u64 * u64::from(scenes)),
        "lane IoU",
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

/// The monitor that is judged.
struct Watched {
    encoder: Encoder,
    reference: Reference,
    default: bool,
}

impl Watched {
    fn open(args: &EvaluateArgs) -> anyhow::Result<Self> {
        let reference = Reference::read(args.reference.as_deref())?;
        let name = args
            .reference
            .as_ref()
            .map_or_else(|| "built-in".to_owned(), |path| path.display().to_string());
        let model = match args.model.as_slice() {
            [] => None,
            [one] => Some(one.as_path()),
            _ => bail!("a reference is of one model; wanted one --model, or --only lane_iou"),
        };
        let spec = ModelSpec::new(model, ModelOptions::default())?;
        let encoder = Encoder::load(&spec)?;
        reference.check_fits(&name, &ModelFingerprint::new(&spec, &encoder))?;
        Ok(Self {
            encoder,
            reference,
            default: args.reference.is_none() && args.look == Look::Sim,
        })
    }

    /// How many times as far from their medians the thresholds for a rate lie as those of the reference.
    fn factor_for(&self, per_hour: f64) -> anyhow::Result<f64> {
        let alarms = &self.reference.false_alarms;
        let rates = &alarms.factors;
        let found = rates
            .iter()
            .find(|rate| rate.per_hour.total_cmp(&per_hour).is_eq());
        let found = found.with_context(|| {
            format!("the reference has no thresholds for {per_hour} false alarms an hour")
        })?;
        Ok(found.factor / alarms.factor)
    }

    fn domain_detection(&self, args: &EvaluateArgs) -> anyhow::Result<Vec<Row<Detection>>> {
        let drives = match (args.drives, args.quick) {
            (Some(drives), _) => drives,
            (None, true) => DRIVES.1,
            (None, false) => DRIVES.0,
        };
        let events = Event::all(args.look);
        let scripts: Vec<Script> = events
            .iter()
            .flat_map(|event| (0..drives).map(|n| event.script(args.look, n.into())))
            .collect();
        let bar = progress::frames(Some(scripts.len() as u64), "events");
        let scores = scores_of(&scripts, &self.encoder, &self.reference, &|| bar.inc(1))?;
        bar.finish_and_clear();
        let mut rows = Vec::new();
        for rate in DETECTION_RATES {
            let factor = self.factor_for(rate)?;
            for (event, scores) in events.iter().zip(scores.chunks(drives as usize)) {
                let scores: Vec<_> = scores.iter().collect();
                rows.push(Row {
                    of: detection(args.look, *event, &scores, rate, factor),
                    default: self.default,
                });
            }
        }
        Ok(rows)
    }

    fn false_alarms(&self, args: &EvaluateArgs) -> anyhow::Result<Vec<Row<FalseAlarmRate>>> {
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
        let scripts: Vec<Script> = (0..drives)
            .map(|n| false_alarms::script(args.look, n.into(), seconds))
            .collect();
        let bar = progress::frames(Some(scripts.len() as u64), "nominal drives");
        let scores = scores_of(&scripts, &self.encoder, &self.reference, &|| bar.inc(1))?;
        bar.finish_and_clear();
        let rates = self.reference.false_alarms.factors.iter();
        rates
            .map(|rate| {
                let factor = self.factor_for(rate.per_hour)?;
                Ok(Row {
                    of: false_alarms::rate(args.look, &scores, rate.per_hour, factor),
                    default: self.default,
                })
            })
            .collect()
    }
}

/// Found shares: conditions down, severities across, a table a rate.
fn detection_table(rows: &[Row<Detection>], out: &mut dyn Write) -> anyhow::Result<()> {
    for rate in DETECTION_RATES {
        let of_rate: Vec<&Detection> = rows
            .iter()
            .map(|row| &row.of)
            .filter(|of| of.false_alarms_per_hour.total_cmp(&rate).is_eq())
            .collect();
        let Some(first) = of_rate.first() else {
            continue;
        };
        writeln!(
            out,
            "Entered as Gap within {WITHIN_S} s, per cent of {} drives each, at {rate} false alarms an hour (nominal: {})",
            first.drives, first.nominal
        )?;
        writeln!(
            out,
            "  {:<14}{:>6}{:>6}{:>6}{:>6}{:>6}",
            "severity", 1, 2, 3, 4, 5
        )?;
        for kind in ConditionKind::ALL.map(ConditionKind::name) {
            write!(out, "  {kind:<14}")?;
            for of in of_rate.iter().filter(|of| of.event == kind) {
                write!(out, "{:>6.0}", 100.0 * of.found_share)?;
            }
            writeln!(out)?;
        }
        for of in of_rate.iter().filter(|of| of.severity.is_none()) {
            writeln!(out, "  {:<14}{:>6.0}", of.event, 100.0 * of.found_share)?;
        }
        let severe = of_rate
            .iter()
            .filter(|of| of.severity.is_none_or(|s| s >= 3));
        let (found, all) = severe.fold((0, 0), |(found, all), of| {
            (found + of.found, all + of.drives)
        });
        writeln!(
            out,
            "  severity 3 and above, looks and noise together: {found} of {all}\n"
        )?;
    }
    Ok(())
}

fn false_alarm_table(rows: &[Row<FalseAlarmRate>], out: &mut dyn Write) -> anyhow::Result<()> {
    for Row { of, .. } in rows {
        writeln!(
            out,
            "{} false alarms an hour wanted (nominal: {}): {} in {:.1} h of {} drives, {:.2} an hour ({:.2} to {:.2}){}",
            of.wanted,
            of.nominal,
            of.entries,
            of.hours,
            of.drives,
            of.measured,
            of.bound.0,
            of.bound.1,
            match (of.demonstrated, of.kept) {
                (false, _) => ": not demonstrated, too few hours",
                (true, true) => ": kept",
                (true, false) => ": not kept",
            }
        )?;
    }
    Ok(())
}

/// One line a setting and model.
fn csv(rows: &[Row<LaneIou>], out: &mut dyn Write) -> anyhow::Result<()> {
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

/// A table a model and look: conditions down, severities across; then where the encoder looks in plain day.
fn table(rows: &[Row<LaneIou>], out: &mut dyn Write) -> anyhow::Result<()> {
    let mut models: Vec<&str> = rows.iter().map(|row| row.of.model.as_str()).collect();
    models.dedup();
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
            writeln!(
                out,
                "{model}, look {look}: lane IoU {} on {} scenes",
                with_interval(plain),
                plain.scenes
            )?;
            for tap in &plain.attention {
                if let (Some(peak), Some(on), Some(lift)) =
                    (tap.peak_energy, tap.on_lanes, tap.lift)
                {
                    writeln!(
                        out,
                        "  {}: median peak energy {peak:.1}, {:.1} % of the energy on lanes, {lift:.1} times their share of the picture",
                        tap.tap,
                        100.0 * on
                    )?;
                }
            }
            writeln!(
                out,
                "  {:<10}{:>8}{:>8}{:>8}{:>8}{:>8}",
                "severity", 1, 2, 3, 4, 5
            )?;
            for kind in ConditionKind::ALL.map(ConditionKind::name) {
                write!(out, "  {kind:<10}")?;
                for severity in 1..=5_u8 {
                    let iou = of(kind, f32::from(severity)).and_then(|of| of.iou);
                    let text = iou.map_or_else(|| "-".to_owned(), |iou| format!("{iou:.3}"));
                    write!(out, "{text:>8}")?;
                }
                writeln!(out)?;
            }
            writeln!(out)?;
        }
    }
    Ok(())
}

fn with_interval(of: &LaneIou) -> String {
    match (of.iou, of.interval) {
        (Some(iou), Some((low, high))) => format!("{iou:.3} ({low:.3} to {high:.3})"),
        _ => "undefined (no lane at all)".to_owned(),
    }
}
