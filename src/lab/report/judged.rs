//! What was judged, and what not.

use maud::{Markup, html};

use super::content::{Report, is_end};
use super::states::{STATES, badge};
use super::table::Column::{Numbers, Words};
use super::table::head;
use super::text::Text;
use crate::monitor::alarm::AlarmState;

/// Time in each state, frames without a score, and time to a verdict.
pub fn judged(report: &Report) -> Markup {
    let not_judged = report.not_judged();
    let missing = report.missing_frames();
    html! {
        section {
            h2 { "What was judged, and what not" }
            (shares(report))
            @if not_judged.is_empty() {
                p { "Every frame was judged." }
            } @else {
                h3 { "Frames without a score" }
                ul #unjudged {
                    @for (why, count) in not_judged { li { (Text(why)) ": " (count) } }
                }
            }
            @if missing > 0 {
                p { (missing) " frames that the source numbered are not in the journal." }
            }
            @if let Some(latencies) = report.latency_ms([0.5, 0.9, 0.99, 1.0]) {
                h3 { "From frame to verdict" }
                table #latencies {
                    (head(&[Numbers("Median"), Numbers("90 %"), Numbers("99 %"), Numbers("Longest")]))
                    tbody {
                        tr {
                            @for latency in latencies { td.n { (format_args!("{latency:.1} ms")) } }
                        }
                    }
                }
            }
        }
    }
}

/// The states that occur, as a bar and as a table.
fn shares(report: &Report) -> Markup {
    let span = report.span_s().max(1e-9);
    let lasting = || report.entries.iter().filter(|entry| !is_end(entry));
    let occurs = |state| lasting().any(|entry| entry.state == state);
    let spent = STATES
        .iter()
        .filter(|(state, _)| occurs(*state))
        .map(|&(state, _)| (state, report.in_state_s(state)));
    html! {
        div.stack aria-hidden="true" {
            @for (state, seconds) in spent.clone() {
                span.(state.name()) style=(format_args!("flex-grow:{:.4}", 100.0 * seconds / span)) {}
            }
        }
        table #shares {
            (head(&[Words("State"), Numbers("Time"), Numbers("Share"), Words("Means")]))
            tbody {
                @for (state, seconds) in spent {
                    tr {
                        td { (badge(state)) }
                        td.n { (format_args!("{seconds:.1} s")) }
                        td.n { (format_args!("{:.1} %", 100.0 * seconds / span)) }
                        td { (means(state)) }
                    }
                }
            }
        }
    }
}

fn means(state: AlarmState) -> &'static str {
    match state {
        AlarmState::Init => "not judged: the first window was not full",
        AlarmState::Ok => "judged: like the domain the model knows",
        AlarmState::Suspect => "judged: beyond the threshold, being debounced",
        AlarmState::Gap => "judged: the road had left the domain",
        AlarmState::SensorFault => "not judged: the picture showed nothing that a scene could make",
        AlarmState::Unavailable => "not judged, for another reason",
    }
}
