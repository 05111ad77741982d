//! Readable lines that `monitor` and `replay` have in common.

use std::io::Write;

use gapwatch::monitor::alarm::AlarmState;
use gapwatch::monitor::judge::Verdict;
use gapwatch::record::events::EventCounts;
use gapwatch::reference::cause::LikelyCause;

/// One readable line about a change of state.
pub fn state_line(verdict: &Verdict) -> String {
    let mut line = format!(
        "{:8.1} s  {:<11}",
        verdict.at.as_secs_f64(),
        verdict.state.name()
    );
    match (verdict.state, &verdict.undefined, verdict.gap) {
        (_, Some(why), _) => line += &format!("  {}: {why}", verdict.reason.name()),
        (AlarmState::Init, _, _) => line += "  starting",
        (state, None, Some(_)) => {
            line += &answers(verdict);
            if has_evidence(state) {
                line += &format!("  {}", verdict.reason.name());
            }
            if let Some(cause) = cause_of_evidence(verdict) {
                line += &format!(", likely cause: {cause}");
            }
        }
        (_, None, None) => line += &format!("  {}", verdict.reason.name()),
    }
    line
}

/// The answers that are known.
fn answers(verdict: &Verdict) -> String {
    let score = |name, score: Option<f64>| {
        // No minus sign before a score that rounds to zero.
        let rounded = score.map(|score| (100.0 * score).round() / 100.0 + 0.0);
        rounded.map_or_else(String::new, |score| format!("  {name} {score:.2}"))
    };
    score("gap", verdict.gap) + &score("change", verdict.change) + &lanes_lost(verdict)
}

/// The forecast of lost lanes, if there is one.
pub fn lanes_lost(verdict: &Verdict) -> String {
    let share = verdict.lanes.map(|share| (100.0 * share).round());
    share.map_or_else(String::new, |percent| format!("  lanes lost {percent} %"))
}

/// The likely cause where there is evidence that needs one.
pub fn cause_of_evidence(verdict: &Verdict) -> Option<LikelyCause> {
    verdict.cause.filter(|_| has_evidence(verdict.state))
}

fn has_evidence(state: AlarmState) -> bool {
    matches!(state, AlarmState::Suspect | AlarmState::Gap)
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

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use gapwatch::capture::undefined::Undefined;
    use gapwatch::monitor::alarm::Reason;
    use gapwatch::reference::cause::Cause;

    use super::*;

    #[test]
    fn a_line_says_the_cause_of_a_gap_or_suspicion_and_of_nothing_else() {
        let gap = Verdict {
            at: Duration::from_millis(20_340),
            state: AlarmState::Gap,
            reason: Reason::Change,
            score: Some(3.214),
            gap: Some(0.514),
            change: Some(3.214),
            cause: Some(LikelyCause {
                cause: Cause::Dirt,
                probability: 0.84,
            }),
            ..Verdict::nothing_yet()
        };
        assert_eq!(
            state_line(&gap),
            "    20.3 s  Gap          gap 0.51  change 3.21  change, likely cause: dirt (84 %)"
        );
        let suspect = Verdict {
            state: AlarmState::Suspect,
            reason: Reason::Abrupt,
            ..gap.clone()
        };
        let line = state_line(&suspect);
        assert!(
            line.ends_with("abrupt, likely cause: dirt (84 %)"),
            "{line}"
        );
        let unknown = Verdict {
            cause: None,
            ..gap.clone()
        };
        assert_eq!(
            state_line(&unknown),
            "    20.3 s  Gap          gap 0.51  change 3.21  change"
        );
        let ok = Verdict {
            state: AlarmState::Ok,
            reason: Reason::None,
            gap: Some(-0.001),
            change: None,
            ..gap.clone()
        };
        assert_eq!(state_line(&ok), "    20.3 s  Ok           gap 0.00");
        let costs_little = Verdict {
            lanes: Some(0.146),
            ..gap.clone()
        };
        assert_eq!(
            state_line(&costs_little),
            "    20.3 s  Gap          gap 0.51  change 3.21  lanes lost 15 %  change, likely cause: dirt (84 %)"
        );
        let dark = Verdict {
            state: AlarmState::SensorFault,
            reason: Reason::Black,
            undefined: Some(Undefined::Black),
            ..gap
        };
        assert!(!state_line(&dark).contains("dirt"));
    }
}
