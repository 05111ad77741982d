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
    match (verdict.state, &verdict.undefined, verdict.score) {
        (_, Some(why), _) => line += &format!("  {}: {why}", verdict.reason.name()),
        (AlarmState::Init, _, _) => line += "  starting",
        (_, None, Some(score)) => {
            // No minus sign before a score that rounds to zero.
            let hundredths = (100.0 * score).round() + 0.0;
            line += &format!("  score {:.2}{}", hundredths / 100.0, lanes_lost(verdict));
            if let Some(cause) = cause_of_evidence(verdict) {
                line += &format!("  {}, likely cause: {cause}", verdict.reason.name());
            }
        }
        (_, None, None) => line += &format!("  {}", verdict.reason.name()),
    }
    line
}

/// The forecast of lost lanes, if there is one.
pub fn lanes_lost(verdict: &Verdict) -> String {
    let share = verdict.lanes.map(|share| (100.0 * share).round());
    share.map_or_else(String::new, |percent| format!("  lanes lost {percent} %"))
}

/// The likely cause where there is evidence that needs one.
pub fn cause_of_evidence(verdict: &Verdict) -> Option<LikelyCause> {
    let has_evidence = matches!(verdict.state, AlarmState::Suspect | AlarmState::Gap);
    verdict.cause.filter(|_| has_evidence)
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
            cause: Some(LikelyCause {
                cause: Cause::Dirt,
                probability: 0.84,
            }),
            ..Verdict::nothing_yet()
        };
        assert_eq!(
            state_line(&gap),
            "    20.3 s  Gap          score 3.21  change, likely cause: dirt (84 %)"
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
        assert_eq!(state_line(&unknown), "    20.3 s  Gap          score 3.21");
        let ok = Verdict {
            state: AlarmState::Ok,
            reason: Reason::None,
            score: Some(-0.001),
            ..gap.clone()
        };
        assert_eq!(state_line(&ok), "    20.3 s  Ok           score 0.00");
        let costs_little = Verdict {
            lanes: Some(0.146),
            ..gap.clone()
        };
        assert_eq!(
            state_line(&costs_little),
            "    20.3 s  Gap          score 3.21  lanes lost 15 %  change, likely cause: dirt (84 %)"
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
