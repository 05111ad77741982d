//! Readable lines that `monitor` and `replay` have in common.

use std::io::Write;

use gapwatch::monitor::alarm::AlarmState;
use gapwatch::monitor::judge::Verdict;
use gapwatch::record::events::EventCounts;

/// One readable line about a change of state.
pub fn state_line(verdict: &Verdict) -> String {
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
pub fn evidence_line(kept: EventCounts, out: &mut dyn Write) -> std::io::Result<()> {
    let events = if kept.events == 1 { "event" } else { "events" };
    write!(out, "evidence: {} {events} written", kept.events)?;
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
