//! `gapwatch calibrate`: nominal sources → reference file.

use std::collections::HashSet;
use std::io::Write;

use anyhow::{Context, bail};
use gapwatch::calibration::{Calibrated, Domain, Wanted, calibrate};
use gapwatch::frame::drives;
use gapwatch::gap::Metric;
use gapwatch::reference::{COMPONENTS_MAX, NominalDrives, Provenance, Reference};
use gapwatch::survey::{Keep, Survey};

use super::Model;
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
    let keep = match args.metric {
        Metric::Mahalanobis => Keep::Channels,
        _ => Keep::Maps,
    };
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
        sources,
    } = calibrate(&domains, held_out, &model.spec.taps, wanted)?;
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
