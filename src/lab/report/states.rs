//! States as the page shows them.

use maud::{Markup, html};

use crate::monitor::alarm::AlarmState;

/// States in the order of the rows of the timeline, with the sign that stands for each beside its colour.
pub const STATES: [(AlarmState, &str); 6] = [
    (AlarmState::Init, "·"),
    (AlarmState::Ok, "●"),
    (AlarmState::Suspect, "▲"),
    (AlarmState::Gap, "■"),
    (AlarmState::SensorFault, "✕"),
    (AlarmState::Unavailable, "○"),
];

/// Place of a state in [`STATES`].
pub fn place(state: AlarmState) -> usize {
    STATES.iter().position(|(s, _)| *s == state).unwrap_or(0)
}

/// The coloured sign of a state.
pub fn sign(state: AlarmState) -> Markup {
    html! {
        span.state.(state.name()) aria-hidden="true" { (STATES[place(state)].1) }
    }
}

/// The coloured sign of a state with its name.
pub fn badge(state: AlarmState) -> Markup {
    html! {
        span.state.(state.name()) {
            span aria-hidden="true" { (STATES[place(state)].1) }
            " " (state.name())
        }
    }
}
