//! What `monitor` and `doctor` ask of a board beyond its file: rates, warnings and a reference that go together.

use std::path::Path;

use anyhow::bail;
use gapwatch::capture::is_rendered;
use gapwatch::files::shell::quoted;
use gapwatch::live::board::Board;
use gapwatch::monitor::warn::{WarnOn, WarnOnError};
use gapwatch::reference::gap::Metric;
use gapwatch::reference::{Periods, Reference};

/// The board's rates. A window must hold more than one frame at the slow rate, so that the time between them is not an
/// interruption.
pub fn periods(board: &Board, reference: &Reference, file: &Path) -> anyhow::Result<Periods> {
    let periods = board.monitor.rate().periods();
    if periods.idle.as_secs_f64() > reference.window_s {
        bail!(
            "{}: idle_rate_hz = {}, but the reference has windows of {} s; wanted at least {:.2} frames a second",
            file.display(),
            board.monitor.idle_rate_hz,
            reference.window_s,
            1.0 / reference.window_s
        );
    }
    Ok(periods)
}

/// What is to be said if the board judges at other rates than those for which the reference has thresholds.
pub fn other_rate(board: &Board, reference: &Reference) -> Option<String> {
    let rate = board.monitor.rate();
    (!rate.is_like(reference.rate)).then(|| {
        format!(
            "judged at {rate}, but the thresholds are made for {}: the rate of false alarms is not known",
            reference.rate
        )
    })
}

/// The board's reference.
pub fn read_reference(board: &Board) -> anyhow::Result<Reference> {
    Ok(Reference::read(board.monitor.reference.as_deref())?)
}

/// The answers that raise the warning: those that the board names, or those that suit its reference. A camera sees a
/// real road, to which a reference made of simulation alone always answers "gap": that raises a warning only if the board
/// says `strict = true`.
pub fn warn_on(board: &Board, reference: &Reference, file: &Path) -> anyhow::Result<WarnOn> {
    let of = &board.monitor;
    let is_real = !of.strict && !is_rendered(&board.camera.source);
    let warn = of.warn.unwrap_or(WarnOn::suited_to(reference, is_real));
    match warn.check(reference, is_real) {
        Ok(()) => Ok(warn),
        Err(error @ WarnOnError::Strict) => bail!(
            "{}: {error}; wanted reference = \"FILE\" with accepted roads ({}), warn = [\"lanes\"], or strict = \
             true, in [monitor]",
            file.display(),
            accepting(reference, of.reference.as_deref(), None)
        ),
        Err(error) => bail!("{}: {error}", file.display()),
    }
}

/// The command that makes a reference which accepts a road, from one that is made of simulation alone.
pub fn accepting(reference: &Reference, file: Option<&Path>, road: Option<&str>) -> String {
    let road = road.unwrap_or("ROAD");
    if reference.metric == Metric::Mahalanobis {
        return Reference::accepting_command(&Reference::name_of(file), road);
    }
    format!(
        "gapwatch calibrate --metric {} --sim SIMULATION --accept {} --out my-roads.json",
        reference.metric,
        quoted(road)
    )
}
