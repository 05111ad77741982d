//! What a frame costs on this computer, and what the board file allows.

use std::time::Duration;

use gapwatch::live::board::Board;
use gapwatch::live::cost::{Buffer, chain_times, ms, quantile, resident_bytes};
use gapwatch::monitor::pipeline::Monitor;
use gapwatch::reference::Reference;

use super::camera::Taken;
use super::check::Check;
use crate::cli::loaded_model::LoadedModel;

/// Longest measurement.
const MEASURE: Duration = Duration::from_secs(2);

pub fn check(
    board: &Board,
    model: &LoadedModel,
    reference: &Reference,
    taken: &Taken,
) -> Vec<Check> {
    let mut checks = Vec::new();
    match judged(model, reference, taken) {
        Err(error) => {
            let remedy = "measure what the model needs: gapwatch bench --model FILE";
            return vec![Check::fail("budget", format!("{error:#}"), remedy)];
        }
        Ok((judged, None)) => checks.push(Check::pass(
            "picture",
            format!("{judged} of {} frames can be judged", taken.frames.len()),
        )),
        Ok((_, Some(why))) => {
            let remedy = "check that nothing covers the lens, that there is light, and that the board file names the right camera";
            return vec![
                Check::fail("picture", why, remedy),
                Check::left_out("budget", "no frame can be judged"),
            ];
        }
    }
    checks.push(time(board, model, reference, taken));
    checks.push(memory(board));
    checks
}

/// How many frames can be judged, and what is wrong with the last one or with most of them. (The first frames of a
/// camera may be bad.)
fn judged(
    model: &LoadedModel,
    reference: &Reference,
    taken: &Taken,
) -> anyhow::Result<(usize, Option<String>)> {
    let mut monitor = Monitor::new(&model.encoder, reference)?;
    let steps = taken.frames.iter().map(|frame| monitor.step(frame));
    let faults: Vec<_> = steps.map(|verdict| verdict.undefined).collect();
    let judged = faults.iter().filter(|fault| fault.is_none()).count();
    let latest = faults.iter().rev().flatten().next();
    let last_fails = faults.last().is_some_and(Option::is_some);
    let why = latest.filter(|_| last_fails || 2 * judged < faults.len());
    Ok((judged, why.map(ToString::to_string)))
}

fn time(board: &Board, model: &LoadedModel, reference: &Reference, taken: &Taken) -> Check {
    let pixels = taken
        .frames
        .iter()
        .filter_map(|frame| frame.picture.as_ref().ok());
    let shown: Vec<Buffer> = pixels.map(|p| (p.layout(), p.bytes().to_vec())).collect();
    let times = match chain_times(&model.encoder, reference, &shown, MEASURE) {
        Ok(times) => times,
        Err(error) => {
            let remedy = "check that nothing covers the lens, and that there is light";
            return Check::fail("budget", format!("{error:#}"), remedy);
        }
    };
    let taking = taken.cpu;
    let [median, late] = [50, 99].map(|percent| taking + quantile(times.clone(), percent));
    let allowed = board.budget.frame;
    let found = format!(
        "{:.1} ms a frame, {:.1} ms at 99 %, including {:.1} ms to take and convert it; {:.1} ms allowed at {} a second",
        ms(median),
        ms(late),
        ms(taken.cpu),
        ms(allowed),
        board.monitor.rate_hz
    );
    if late > allowed {
        let remedy = "lower rate_hz in [monitor] or size in [camera], use a smaller model, or check what else runs (top)";
        return Check::fail("budget", found, remedy);
    }
    Check::pass("budget", found)
}

/// Includes the frames of this check, which the monitor does not hold, so it is not less than what the monitor uses.
fn memory(board: &Board) -> Check {
    let allowed = board.budget.memory_mib;
    #[allow(clippy::cast_precision_loss)]
    match resident_bytes().map(|bytes| bytes as f64 / 1_048_576.0) {
        Err(error) => Check::left_out("memory", error.to_string()),
        Ok(used) if used > allowed => Check::fail(
            "memory",
            format!("{used:.0} MiB resident; {allowed:.0} MiB allowed"),
            "allow more (memory_mib in [budget]), or use a smaller model or size",
        ),
        Ok(used) => Check::pass(
            "memory",
            format!("{used:.0} MiB resident; {allowed:.0} MiB allowed"),
        ),
    }
}
