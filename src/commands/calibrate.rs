//! `gapwatch calibrate`: nominal sources → reference file.

use std::io::Write;

use anyhow::{Context, bail};
use gapwatch::calibration::{THRESHOLD_MARGIN, calibrate};
use gapwatch::frame::drives;
use gapwatch::reference::{Provenance, Reference};

use super::Model;
use crate::args::CalibrateArgs;

pub fn run(args: &CalibrateArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    let model = Model::load(&args.model)?;
    let sources = args
        .sim
        .iter()
        .map(|name| drives(name))
        .collect::<Result<Vec<_>, _>>()?
        .concat();
    if let Some(twice) = (1..sources.len()).find(|&i| sources[..i].contains(&sources[i])) {
        bail!(
            "source {} is given twice; held-out drives must be others than fitted ones",
            sources[twice]
        );
    }
    let surveys = model.survey(&sources, "calibrating")?;
    let (taps, sources) = calibrate(&surveys, &model.spec.taps, args.metric)?;
    let provenance = Provenance {
        gapwatch: env!("CARGO_PKG_VERSION").to_owned(),
        command: command_line(),
        thresholds: format!(
            "median + {THRESHOLD_MARGIN} x (worst held-out window - median), per tap and frames a window; no rate of false alarms is promised"
        ),
        sources,
    };
    let reference = Reference::new(
        model.fingerprint,
        args.metric,
        args.window,
        provenance,
        taps,
    );
    reference
        .write(&args.out)
        .context("cannot write the reference")?;
    let frames = |of: fn(&gapwatch::reference::SourceUse) -> u64| {
        reference.provenance.sources.iter().map(of).sum::<u64>()
    };
    writeln!(
        out,
        "{}: {} on {} sources, {} frames fitted, {} held out; strict, no rate of false alarms promised",
        args.out.display(),
        reference.metric,
        reference.provenance.sources.len(),
        frames(|s| s.fitted),
        frames(|s| s.held_out),
    )?;
    for tap in &reference.taps {
        let (median, threshold) = tap.scale_for(10);
        writeln!(
            out,
            "  {}: median peak energy {:.4}, windows of 10 frames: median {median:.5}, threshold {threshold:.5}",
            tap.tap, tap.median_peak_energy
        )?;
    }
    Ok(0)
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
