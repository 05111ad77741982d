//! `gapwatch package-files`: man pages and shell completions for a package, made from the definition of the command
//! line.

use std::fs;
use std::io::Write;

use anyhow::Context;
use clap::CommandFactory;
use clap_complete::{Shell, generate_to};
use gapwatch::files::durable::sync_contents;

use crate::cli::args::{Cli, PackageFilesArgs};

/// Paths where the shells of Debian look for them.
const COMPLETIONS: [(Shell, &str); 3] = [
    (Shell::Bash, "bash-completion/completions/gapwatch"),
    (Shell::Zsh, "zsh/vendor-completions/_gapwatch"),
    (Shell::Fish, "fish/vendor_completions.d/gapwatch.fish"),
];

pub fn run(args: &PackageFilesArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    let cannot = || format!("cannot write into {}", args.out.display());
    let pages = args.out.join("man/man1");
    fs::create_dir_all(&pages).with_context(cannot)?;
    clap_mangen::generate_to(Cli::command(), &pages).with_context(cannot)?;
    for (shell, place) in COMPLETIONS {
        let place = args.out.join(place);
        let folder = place.parent().unwrap_or(&args.out);
        fs::create_dir_all(folder).with_context(cannot)?;
        let made =
            generate_to(shell, &mut Cli::command(), "gapwatch", folder).with_context(cannot)?;
        fs::rename(made, &place).with_context(cannot)?;
    }
    sync_contents(&args.out).with_context(cannot)?;
    writeln!(out, "{}: man pages and completions", args.out.display())?;
    Ok(0)
}
