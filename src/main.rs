//! Command line → command → exit code.

mod cli;

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use clap::error::ErrorKind;

#[cfg(feature = "lab")]
#[global_allocator]
static ALLOCATOR: cli::counting::Counting = cli::counting::Counting;

/// Exit code of a command that could not do its job.
const COULD_NOT: u8 = 2;

fn main() -> ExitCode {
    #[cfg(feature = "lab")]
    gapwatch::lab::register();
    cli::logging::begin();
    std::panic::set_hook(Box::new(|panic| {
        if !gapwatch::model::encoder::in_tract() {
            complain(&format!("internal error, please report: {panic}"));
        }
    }));
    let typed = match cli::args::Cli::try_parse() {
        Ok(typed) => typed,
        Err(error) => return refuse_or_help(&error),
    };
    let mut out = std::io::stdout().lock();
    match cli::run(typed.command, &mut out).and_then(|code| Ok(out.flush().map(|()| code)?)) {
        Ok(code) => ExitCode::from(code),
        // The reader of our output has closed it, as `head` does. This is no error of ours, but our job is not done
        // either.
        Err(error) if is_broken_pipe(&error) => ExitCode::from(COULD_NOT),
        Err(error) => {
            complain(&format!("{error:#}"));
            ExitCode::from(COULD_NOT)
        }
    }
}

/// Prints help and version as clap writes them, and the error of a wrong command line in one line.
fn refuse_or_help(error: &clap::Error) -> ExitCode {
    let nothing_typed = error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand;
    if !error.use_stderr() || nothing_typed {
        return match error.print() {
            Ok(()) if !nothing_typed => ExitCode::SUCCESS,
            _ => ExitCode::from(COULD_NOT),
        };
    }
    let text = error.render().to_string();
    let said: Vec<&str> = text
        .split("\n\n")
        .next()
        .unwrap_or_default()
        .lines()
        .map(str::trim)
        .collect();
    complain(&format!(
        "{} (see gapwatch --help)",
        said.join(" ").trim_start_matches("error: ")
    ));
    ExitCode::from(COULD_NOT)
}

fn complain(what: &str) {
    let one_line = what.split_whitespace().collect::<Vec<_>>().join(" ");
    let level = cli::logging::prefix(log::Level::Error);
    let _ = writeln!(std::io::stderr(), "{level}gapwatch: {one_line}");
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .chain()
        .filter_map(|cause| cause.downcast_ref::<std::io::Error>())
        .any(|cause| cause.kind() == std::io::ErrorKind::BrokenPipe)
}
