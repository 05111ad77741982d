//! `gapwatch calibrate`: nominal sources → reference file.

use std::collections::HashSet;
use std::io::Write;

use anyhow::{Context, bail};
use gapwatch::calibration::{Calibrated, Domain, LabelledMeans, Wanted, calibrate};
use gapwatch::encoder::Encoder;
use gapwatch::frame::drives;
use gapwatch::gap::Metric;
use gapwatch::labelled::training_frames;
use gapwatch::model::ModelSpec;
use gapwatch::reference::{COMPONENTS_MAX, NominalDrives, Provenance, Reference, SourceUse};
use gapwatch::scene::DriveSpec;
use gapwatch::survey::{Keep, Survey};

use super::{Model, progress};
use crate::args::CalibrateArgs;

/// Name of the first nominal domain.
const SIMULATION: &str = "simulation";

pub fn run(args: &CalibrateArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    if args.metric == Metric::Frechet {
        bail!("--metric frechet compares whole sets; wanted a metric that judges a window");
    }
    if args.accept.len() >= COMPONENTS_MAX {
        bail!(
            "{} accepted sources; wanted at most {}: one source may stand for many drives, as in seed=1..60",
            args.accept.len(),
            COMPONENTS_MAX - 1
        );
    }
    let risk = args.metric == Metric::LaneRisk;
    if risk == args.labelled.is_empty() {
        bail!("--metric lane-risk and --labelled belong together; wanted both or neither");
    }
    if risk && !args.accept.is_empty() {
        bail!(
            "--metric lane-risk judges any road by what the lane model loses; wanted no --accept"
        );
    }
    let model = Model::load(&args.model)?;
    let all_drives = |names: &[String]| -> anyhow::Result<Vec<String>> {
        let all = names.iter().map(|name| drives(name));
        Ok(all.collect::<Result<Vec<_>, _>>()?.concat())
    };
    let groups: Vec<Vec<String>> = std::iter::once(all_drives(&args.sim))
        .chain(args.accept.iter().map(|name| Ok(drives(name)?)))
        .chain([all_drives(&args.held_out)])
        .collect::<anyhow::Result<_>>()?;
    let sources = groups.concat();
    let mut seen = HashSet::new();
    if let Some(twice) = sources.iter().find(|&source| !seen.insert(source)) {
        bail!("source {twice} is given twice; held-out drives must be others than fitted ones");
    }
    let labelled = labelled_drives(&all_drives(&args.labelled)?)?;
    let keep = match args.metric.divergence() {
        None => Keep::Means,
        Some(_) => Keep::Maps,
    };
    let labelled_frames = labelled_frames(&labelled, &model.spec)?;
    let surveys = model.survey(&sources, keep, "calibrating")?;
    let mut rest = surveys.as_slice();
    let mut taken: Vec<&[Survey]> = Vec::new();
    for group in &groups {
        let (own, others) = rest.split_at(group.len());
        taken.push(own);
        rest = others;
    }
    let held_out = taken.pop().unwrap_or_default();
    let names = std::iter::once(SIMULATION).chain(args.accept.iter().map(String::as_str));
    let domains: Vec<Domain<'_>> = names
        .zip(taken)
        .map(|(name, drives)| Domain {
            name: name.to_owned(),
            drives,
        })
        .collect();
    let wanted = Wanted {
        metric: args.metric,
        window_s: args.window,
        false_alarms_per_hour: args.false_alarms_per_hour,
    };
    let Calibrated {
        components,
        false_alarms,
        mut sources,
    } = calibrate(
        &domains,
        held_out,
        &labelled_frames,
        &model.spec.taps,
        wanted,
    )?;
    sources.extend(labelled.iter().map(|(name, spec)| SourceUse {
        source: name.clone(),
        frames: spec.frames(),
        fitted: spec.frames(),
        held_out: 0,
    }));
    let provenance = Provenance {
        gapwatch: env!("CARGO_PKG_VERSION").to_owned(),
        command: command_line(),
        sources,
    };
    let reference = Reference::new(
        model.fingerprint,
        args.metric,
        args.window,
        false_alarms,
        provenance,
        components,
    );
    reference
        .write(&args.out)
        .context("cannot write the reference")?;
    describe(&reference, args, out)?;
    Ok(0)
}

/// Rendered drives by name; no other source has lane labels.
fn labelled_drives(names: &[String]) -> anyhow::Result<Vec<(String, DriveSpec)>> {
    let drives = names.iter().map(|name| {
        let Some(spec) = name.strip_prefix("scene:") else {
            bail!("--labelled {name}: has no lane labels; wanted a rendered drive, scene:…");
        };
        let spec: DriveSpec = spec.parse()?;
        if !spec.conditions.is_empty() {
            bail!("--labelled {name}: has a condition; wanted a plain drive, conditions are added");
        }
        Ok((name.clone(), spec))
    });
    drives.collect()
}

/// The labelled drives seen through the lane model, plain and under every condition.
fn labelled_frames(
    drives: &[(String, DriveSpec)],
    spec: &ModelSpec,
) -> anyhow::Result<Vec<LabelledMeans>> {
    if drives.is_empty() {
        return Ok(Vec::new());
    }
    if spec.lane.is_none() {
        bail!(
            "{}: no lane output is named; wanted lane = \"NAME\" in the .toml beside it for lane-risk",
            spec.name
        );
    }
    let encoder = Encoder::load_with_lane(spec)?;
    let drives: Vec<DriveSpec> = drives.iter().map(|(_, drive)| drive.clone()).collect();
    let bar = progress::frames(Some(drives.len() as u64), "labelled drives");
    let frames = training_frames(&drives, &encoder, &spec.preprocessing, &|| bar.inc(1))?;
    bar.finish_and_clear();
    Ok(frames.into_iter().map(|(_, frame)| frame).collect())
}

fn describe(
    reference: &Reference,
    args: &CalibrateArgs,
    out: &mut dyn Write,
) -> anyhow::Result<()> {
    let frames = |of: fn(&gapwatch::reference::SourceUse) -> u64| {
        reference.provenance.sources.iter().map(of).sum::<u64>()
    };
    writeln!(
        out,
        "{}: {} on {} sources, {} frames fitted, {} held out; {}",
        args.out.display(),
        reference.metric,
        reference.provenance.sources.len(),
        frames(|s| s.fitted),
        frames(|s| s.held_out),
        if reference.strict {
            "strict: simulation alone is nominal".to_owned()
        } else {
            format!("{} nominal domains", reference.components.len())
        }
    )?;
    for component in &reference.components {
        for tap in &component.taps {
            let (median, threshold) = tap.scale_for(10);
            writeln!(
                out,
                "  {}, {}: median peak energy {:.4}, windows of 10 frames: median {median:.5}, threshold {threshold:.5}",
                component.name, tap.tap, tap.median_peak_energy
            )?;
        }
    }
    let said = |on: &NominalDrives| {
        format!(
            "{} entries in {:.2} h of {} drives, {:.2} to {:.2} an hour (95 %)",
            on.entries, on.hours, on.drives, on.per_hour.0, on.per_hour.1
        )
    };
    let alarms = &reference.false_alarms;
    writeln!(
        out,
        "  false alarms: {} an hour wanted; set on {}",
        alarms.wanted_per_hour,
        said(&alarms.chosen_on)
    )?;
    if let Some(on) = &alarms.judged_on {
        writeln!(out, "  judged on {}", said(on))?;
    }
    if let Some(missing) = &alarms.missing {
        writeln!(out, "  not demonstrated: wanted {missing}")?;
    }
    Ok(())
}

/// The command as it can be typed again in a shell.
fn command_line() -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:=+@%".contains(c);
    let words = std::env::args_os().skip(1).map(|word| {
        let word = word.to_string_lossy().into_owned();
        if !word.is_empty() && word.chars().all(plain) {
            word
        } else {
            format!("'{}'", word.replace('\'', "'\\''"))
        }
    });
    std::iter::once("gapwatch".to_owned())
        .chain(words)
        .collect::<Vec<_>>()
        .join(" ")
}
