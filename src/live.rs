//! The live loop: what happens between a camera that does not wait, a judge that needs time, and a bus with a cycle.
//!
//! ```text
//! frames ──► newest ──► judging ──words──► teller ──► bus, journal, recording
//!                          ▲                  │
//!                          └──────orders──────┘        parked, clear
//! ```
//!
//! [`judging::Judging`] is the state of the judge's thread, and [`teller::Teller`] is the state of the teller's thread.
//! Both are state machines: time comes in as an argument, and the threads and clocks around them belong to the command.
//! A test plays hours of scripts through them in seconds. A replay reports to the same [`outputs::Outputs`], with the
//! drive's time as the clock.

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

/// Time between two rounds of serving the bus: half of the shortest time between two frames of `GapStatus`.
pub const TICK: Duration = Duration::from_millis(10);
/// How long the judge waits for a frame before it reads the clock.
pub const JUDGE_WAITS: Duration = Duration::from_millis(50);

/// A message from the judge to the teller.
// Most messages are verdicts, and a box would request memory for each frame.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Debug, PartialEq)]
pub enum Word {
    /// A verdict.
    Verdict {
        /// The verdict.
        verdict: Verdict,
        /// Number of frames so far that came and were never judged.
        dropped: u64,
    },
    /// A request to clear the stored bit was accepted (true) or refused.
    Cleared(bool),
}

/// Orders from the teller to the judge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Orders {
    /// The car is parked: no frame is to be judged.
    pub parked: bool,
    /// A request to clear the stored bit was received.
    pub clear: bool,
}
