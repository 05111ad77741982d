//! How much is kept.

use std::time::Duration;

/// How much a folder of evidence may hold, and for how long; the oldest events go first. While an event is written, its own
/// files lie beside those that count: at most `bytes` once more. An event that cannot be removed keeps its place, and one for
/// which there is no room then is not kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quota {
    /// Bytes of all files.
    pub bytes: u64,
    /// Events.
    pub events: usize,
    /// How long an event is kept; `None` = until the others want its place. One that was written before the computer's clock was
    /// set has no age.
    pub keep: Option<Duration>,
}

impl Default for Quota {
    /// 256 MB and 200 events: a megabyte an event, at 1280x720.
    fn default() -> Self {
        Self {
            bytes: 256_000_000,
            events: 200,
            keep: None,
        }
    }
}
