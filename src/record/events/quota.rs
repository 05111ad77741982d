//! How much is kept.

use std::time::Duration;

/// How much a folder of evidence may hold, and for how long. The oldest events are removed first. While an event is
/// written, its own files exist in addition to those that count: at most `bytes` once more. An event that cannot be
/// removed continues to count, and a new event for which there is then no room is not kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quota {
    /// Largest number of bytes of all files.
    pub bytes: u64,
    /// Largest number of events.
    pub events: usize,
    /// How long an event is kept; `None` = until its room is needed. An event that was written before the computer's
    /// clock was set has no age.
    pub keep: Option<Duration>,
}

impl Default for Quota {
    /// 256 MB and 200 events: at 1280x720, an event has about a megabyte.
    fn default() -> Self {
        Self {
            bytes: 256_000_000,
            events: 200,
            keep: None,
        }
    }
}
