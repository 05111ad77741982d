//! What `monitor` and `doctor` ask of a board beyond its file: rates and a reference that go together.

use std::path::Path;

use anyhow::bail;
use gapwatch::live::board::Board;
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

/// With a reference made of simulation alone, every real road is a gap, so a board must ask for it.
pub fn read_reference(board: &Board, file: &Path) -> anyhow::Result<Reference> {
    let reference = Reference::read(board.monitor.reference.as_deref())?;
    if reference.strict && !board.monitor.strict {
        bail!(
            "{}: the reference {} is made of simulation alone, so any real road is a gap to it; wanted reference = \"FILE\" \
             with accepted roads (gapwatch calibrate --base built-in --accept ROAD --out FILE), or strict = true, in [monitor]",
            file.display(),
            Reference::name_of(board.monitor.reference.as_deref()),
        );
    }
    Ok(reference)
}
