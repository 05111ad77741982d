//! What people see on a terminal: a live line, progress, and nothing of either where there is none.
#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::process::Command;

use crate::program::{Ran, ran};

#[test]
#[ignore = "needs the Python packages of tests/requirements.txt: run tests/run"]
fn a_terminal_shows_one_calm_line_that_leaves_nothing_behind() {
    let python = std::env::var("GAPWATCH_PYTHON")
        .expect("GAPWATCH_PYTHON names a Python with the packages of tests/requirements.txt; tests/run sets it");
    let folder = tempfile::tempdir().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/check_terminal.py");
    let mut command = Command::new(python);
    command.arg(script).arg(env!("CARGO_BIN_EXE_gapwatch"));
    let Ran { code, out, err } = ran(command.arg(folder.path()).output().unwrap());
    assert_eq!(code, 0, "{out}\n{err}");
    assert!(out.contains("shows what it should"), "{out}");
}
