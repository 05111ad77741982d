//! One short file a command: wires a source, the chain and a sink.

mod scene;

use std::io::Write;

use crate::args::Command;

/// Runs a command; the result is the exit code.
pub fn run(command: Command, out: &mut dyn Write) -> anyhow::Result<u8> {
    match command {
        Command::Scene(args) => scene::run(&args, out),
    }
}
