//! The timeline, which the script draws: what stands around it.

use maud::{Markup, html};

use super::content::Report;
use super::data::drawn;

const NAME: &str = "Timeline of score, change, state, cause, health, lanes, gaps and latency; the table of alarms says the same in words";

/// Buttons and the place for the charts.
pub fn timeline(report: &Report) -> Markup {
    let (drawn, lines) = (drawn(&report.entries).len(), report.lines());
    html! {
        section {
            div.bar {
                h2 { "Timeline" }
                div.buttons role="group" aria-label="Zoom of the timeline" {
                    button #back type="button" aria-label="Earlier" { "←" }
                    button #in type="button" aria-label="Zoom in" { "+" }
                    button #out type="button" aria-label="Zoom out" { "−" }
                    button #on type="button" aria-label="Later" { "→" }
                    button #all type="button" { "Whole drive" }
                }
            }
            p.hint {
                "Drag over the chart, or use the buttons or + − ← → 0 on the keyboard, to look closer."
                span #range role="status" {}
            }
            div #charts tabindex="0" role="group" aria-label=(NAME) {}
            p.hint #reading { "\u{a0}" }
            noscript { p { "The charts need JavaScript; the tables below do not." } }
            @if drawn < lines {
                p.hint { "Drawn: " (drawn) " of " (lines) " lines, the extremes of each stretch and every change of state." }
            }
        }
    }
}
