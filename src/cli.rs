//! One short file for each command. It connects a source, the chain and a sink.

pub mod args;
#[cfg(feature = "lab")]
mod bench;
mod calibrate;
mod calibration_plan;
#[cfg(feature = "lab")]
mod compare;
#[cfg(feature = "lab")]
pub mod counting;
mod doctor;
#[cfg(feature = "lab")]
mod evaluate;
#[cfg(feature = "lab")]
mod inspect;
mod live;
pub mod logging;
mod merge;
mod monitor;
#[cfg(feature = "lab")]
mod new_folder;
mod package_files;
#[cfg(feature = "lab")]
mod pictures;
mod progress;
#[cfg(feature = "lab")]
mod quick_reference;
mod replay;
#[cfg(feature = "lab")]
mod report;
#[cfg(feature = "lab")]
mod scene;
mod service;
mod signals;
#[cfg(feature = "lab")]
mod surveys;

use std::io::Write;
use std::path::Path;

use gapwatch::calibration::survey::Keep;
use gapwatch::model::encoder::{Encoder, Executor};
use gapwatch::model::{ModelOptions, ModelSpec};
use gapwatch::monitor::alarm::AlarmState;
use gapwatch::monitor::judge::Verdict;
use gapwatch::record::events::EventCounts;
use gapwatch::reference::ModelFingerprint;

use crate::cli::args::{Command, ModelArgs};

/// Runs a command; the result is the exit code.
pub fn run(command: Command, out: &mut dyn Write) -> anyhow::Result<u8> {
    match command {
        Command::Replay(args) => replay::run(&args, out),
        Command::Monitor(args) => monitor::run(&args, out),
        Command::Calibrate(args) => calibrate::run(&args, out),
        Command::Merge(args) => merge::run(&args, out),
        #[cfg(feature = "lab")]
        Command::Compare(args) => compare::run(&args, out),
        #[cfg(feature = "lab")]
        Command::Scene(args) => scene::run(&args, out),
        #[cfg(feature = "lab")]
        Command::Inspect(args) => inspect::run(&args, out),
        #[cfg(feature = "lab")]
        Command::Evaluate(args) => evaluate::run(&args, out),
        #[cfg(feature = "lab")]
        Command::Report(args) => report::run(&args, out),
        #[cfg(feature = "lab")]
        Command::Bench(args) => bench::run(&args, out),
        Command::Doctor(args) => doctor::run(&args, out),
        Command::PackageFiles(args) => package_files::run(&args, out),
    }
}

/// Largest number of frames in memory at a time: of all sources that are compared, or of one drive in calibration. A
/// frame of the built-in model takes about 25 KB with its energy maps, or 4 KB with only the means.
const fn frames_max(keep: Keep) -> u64 {
    match keep {
        Keep::Maps => 100_000,
        Keep::Means => 600_000,
    }
}

/// A loaded model with everything that belongs to it.
struct Model {
    spec: ModelSpec,
    encoder: Encoder,
    fingerprint: ModelFingerprint,
}

impl Model {
    fn load(args: &ModelArgs) -> anyhow::Result<Self> {
        Self::load_in(args, Executor::default())
    }

    fn load_in(args: &ModelArgs, executor: Executor) -> anyhow::Result<Self> {
        Self::of_spec(
            ModelSpec::new(args.model.as_deref(), args.options())?,
            executor,
        )
    }

    fn load_file(file: Option<&Path>, options: ModelOptions) -> anyhow::Result<Self> {
        Self::of_spec(ModelSpec::new(file, options)?, Executor::default())
    }

    fn of_spec(spec: ModelSpec, executor: Executor) -> anyhow::Result<Self> {
        let encoder = Encoder::load_in(&spec, executor)?;
        let fingerprint = ModelFingerprint::new(&spec, &encoder);
        Ok(Self {
            spec,
            encoder,
            fingerprint,
        })
    }
}

/// One readable line about a change of state.
fn state_line(verdict: &Verdict) -> String {
    let mut line = format!(
        "{:8.1} s  {:<11}",
        verdict.at.as_secs_f64(),
        verdict.state.name()
    );
    match (verdict.state, &verdict.undefined, verdict.score) {
        (_, Some(why), _) => line += &format!("  {}: {why}", verdict.reason.name()),
        (AlarmState::Init, _, _) => line += "  starting",
        (_, None, Some(score)) => {
            // No minus sign before a score that rounds to zero.
            let hundredths = (100.0 * score).round() + 0.0;
            line += &format!("  score {:.2}", hundredths / 100.0);
        }
        (_, None, None) => line += &format!("  {}", verdict.reason.name()),
    }
    line
}

/// One readable line about the evidence of a run.
fn tell_evidence(kept: EventCounts, out: &mut dyn Write) -> std::io::Result<()> {
    write!(out, "evidence: {} events written", kept.events)?;
    for (count, what) in [
        (kept.removed, "older ones removed"),
        (kept.failed, "could not be written"),
        (kept.dropped_frames, "frames left out"),
    ] {
        if count > 0 {
            write!(out, ", {count} {what}")?;
        }
    }
    writeln!(out)
}
