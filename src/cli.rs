//! One short file for each command. It connects a source, the chain and a sink.

pub mod args;
#[cfg(feature = "lab")]
mod bench;
mod board_settings;
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
mod loaded_model;
pub mod logging;
mod merge;
mod monitor;
#[cfg(feature = "lab")]
mod new_folder;
mod output;
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
mod state_lines;
#[cfg(feature = "lab")]
mod surveys;

use std::io::Write;

use crate::cli::args::Command;

/// Runs a command; the result is the exit code.
pub fn run(command: Command, out: &mut dyn Write) -> anyhow::Result<u8> {
    if !stops_by_itself(&command) {
        signals::end_cleanly()?;
    }
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

/// Whether a command keeps what it has so far when a signal stops it.
fn stops_by_itself(command: &Command) -> bool {
    match command {
        Command::Replay(_) | Command::Monitor(_) => true,
        #[cfg(feature = "lab")]
        Command::Scene(_) | Command::Inspect(_) => true,
        _ => false,
    }
}
