//! `gapwatch doctor`: whether a computer can do what its board file asks, and what to do if it cannot.
//!
//! The checks run one after the other, in the order of the chain. A check that needs something that failed before is
//! left out, with the reason. Nothing is sent: the doctor only listens to the bus.

mod budget;
mod bus;
mod camera;
mod check;
mod clock;
mod folders;

use std::io::Write;

use anyhow::bail;
use gapwatch::live::board::Board;
use gapwatch::model::ModelOptions;
use gapwatch::reference::Reference;
use gapwatch::statistics::event_rate::Loudness;

use check::{Check, Outcome};

use super::board_settings::{other_rate, periods, read_reference, warn_on};
use super::loaded_model::LoadedModel;
use crate::cli::args::{DoctorArgs, TableFormat};

pub fn run(args: &DoctorArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    let checks = examine(args);
    match args.format {
        TableFormat::Json => writeln!(out, "{}", serde_json::to_string_pretty(&checks)?)?,
        TableFormat::Table => table(&checks, out)?,
    }
    let failed: Vec<&str> = (checks.iter())
        .filter(|check| check.result == Outcome::Fail)
        .map(|check| check.check)
        .collect();
    if !failed.is_empty() {
        out.flush()?;
        bail!(
            "{}: {} of {} checks fail: {}; the remedy is beside each of them",
            args.board.display(),
            failed.len(),
            checks.len(),
            failed.join(", ")
        );
    }
    Ok(0)
}

fn examine(args: &DoctorArgs) -> Vec<Check> {
    let board = match Board::read(&args.board) {
        Ok(board) => board,
        Err(error) => {
            let remedy = "correct the board file; boards/README.md describes it";
            return vec![Check::fail("board", error.to_string(), remedy)];
        }
    };
    let mut checks = vec![Check::pass("board", args.board.display().to_string())];
    let (model, check) = model(&board);
    checks.push(check);
    let (reference, check) = reference(&board, args, model.as_ref());
    checks.push(check);
    let (frames, check) = camera::check(&board);
    checks.push(check);
    checks.extend(bus::check(&board));
    checks.extend(match (model.as_ref().zip(reference.as_ref()), &frames) {
        (None, _) => vec![Check::left_out("budget", "no model and reference to run")],
        (_, None) => vec![Check::left_out("budget", "no frame to run")],
        (Some((model, reference)), Some(taken)) => budget::check(&board, model, reference, taken),
    });
    checks.push(clock::check());
    checks.push(folders::check(
        "journal",
        args.journal.as_deref(),
        &args.board,
    ));
    let evidence = board.evidence.as_ref().map(|kept| kept.folder.as_path());
    let evidence = args.evidence.as_deref().or(evidence);
    checks.push(folders::check("evidence", evidence, &args.board));
    checks
}

fn model(board: &Board) -> (Option<LoadedModel>, Check) {
    match LoadedModel::load_file(board.monitor.model.as_deref(), ModelOptions::default()) {
        Ok(model) => {
            let of = &model.spec.preprocessing;
            let found = format!(
                "{}, {}x{}, taps {}, run by {}",
                model.spec.name,
                of.width,
                of.height,
                model.spec.taps.join(", "),
                model.encoder.executor()
            );
            (Some(model), Check::pass("model", found))
        }
        Err(error) => {
            let remedy = "name an ONNX file that has a .toml file beside it as model in [monitor], or no model for the built-in one";
            (None, Check::fail("model", format!("{error:#}"), remedy))
        }
    }
}

/// The file is read also when the model does not load, so that both faults are reported at the same time.
fn reference(
    board: &Board,
    args: &DoctorArgs,
    model: Option<&LoadedModel>,
) -> (Option<Reference>, Check) {
    let name = board.monitor.reference.as_deref();
    let name = Reference::name_of(name);
    let reference = match read_reference(board) {
        Ok(reference) => reference,
        Err(error) => {
            let remedy = "name a reference of this version as reference in [monitor], or none for the built-in one";
            return (None, Check::fail("reference", format!("{error:#}"), remedy));
        }
    };
    if let Err(error) = periods(board, &reference, &args.board) {
        let remedy =
            "set a higher idle_rate_hz in [monitor], or name a reference with longer windows";
        return (None, Check::fail("reference", format!("{error:#}"), remedy));
    }
    let warn = match warn_on(board, &reference, &args.board) {
        Ok(warn) => warn,
        Err(error) => {
            let remedy = "accept your roads (gapwatch calibrate --base built-in --accept ROAD --out my-roads.json) and name the file in [monitor], or choose other answers with warn";
            return (None, Check::fail("reference", format!("{error:#}"), remedy));
        }
    };
    let Some(model) = model else {
        let why = format!("{name} is complete; there is no model to compare it with");
        return (None, Check::left_out("reference", why));
    };
    if let Err(error) = reference.check_fits(&name, &model.fingerprint) {
        let remedy = "name the model that it was made with, or make a reference for this model";
        return (None, Check::fail("reference", error.to_string(), remedy));
    }
    let strict = if reference.strict {
        "strict: any real road is a gap to it"
    } else {
        "with accepted roads"
    };
    let alarms = &reference.false_alarms;
    let found = format!(
        "{name}, {}, {strict}, warns on {warn}, made for {} false alarms an hour, {}",
        reference.metric,
        alarms.wanted_per_hour,
        alarms.said()
    );
    let found = match other_rate(board, &reference) {
        Some(said) => format!("{found}; {said}"),
        None => found,
    };
    let check = match alarms.loudness() {
        Loudness::NotLouder => Check::pass("reference", found),
        Loudness::NotShown { .. } => Check::warn(
            "reference",
            found,
            "make a reference with more nominal drives as --held-out, every fourth of which judges; until then it is not known how often it warns without a reason",
        ),
        Loudness::Louder => Check::fail(
            "reference",
            found,
            "make a reference with more nominal drives of every kind of road as --held-out, and --accept the roads on which it gives false alarms",
        ),
    };
    (Some(reference), check)
}

fn table(checks: &[Check], out: &mut dyn Write) -> std::io::Result<()> {
    for check in checks {
        let result = check.result.name();
        writeln!(out, "{result:<9} {:<10} {}", check.check, check.found)?;
        if let Some(remedy) = &check.remedy {
            writeln!(out, "{:<21}do: {remedy}", "")?;
        }
    }
    Ok(())
}
