//! The live loop: what happens between a camera that does not wait, a judge that takes its time, and a bus with a cycle.
//!
//! ```text
//! frames ──► newest ──► judging ──words──► teller ──► bus, journal, recording
//!                          ▲                  │
//!                          └──────orders──────┘        parked, clear
//! ```
//!
//! [`judging::Judging`] is what the judge's thread knows, [`teller::Teller`] what the teller's does. Both are state machines:
//! time comes in as an argument, and the threads and clocks around them are the command's. A test plays hours of scripts through
//! them in seconds. A replay tells the same [`outputs::Outputs`], with the drive's time for a clock.

pub mod board;

pub mod bus;
pub mod cost;
pub mod judging;
pub mod outputs;
pub mod service;
pub mod teller;

#[cfg(test)]
mod tests;

use std::time::Duration;

use crate::monitor::judge::Verdict;

/// How often the bus is looked after: half of the shortest time between two frames of `GapStatus`.
pub const TICK: Duration = Duration::from_millis(10);
/// How long the judge waits for a frame before it looks at the clock.
pub const JUDGE_WAITS: Duration = Duration::from_millis(50);

/// What the judge says to the teller.
// A verdict is most of what is said, and a box would be a request for memory a frame.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Debug, PartialEq)]
pub enum Word {
    /// What is known.
    Verdict {
        /// The verdict.
        verdict: Verdict,
        /// Frames that came so far and were never judged.
        dropped: u64,
    },
    /// A request to clear the stored bit was obeyed, or refused.
    Cleared(bool),
}

/// What the teller says to the judge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Orders {
    /// The car is parked: nobody is to look.
    pub parked: bool,
    /// A request to clear the stored bit was heard.
    pub clear: bool,
}
