//! `[evidence]` of a board file: whether pictures of alarms are kept, how many, and for how long.

use std::path::PathBuf;
use std::time::Duration;

use serde::Deserialize;

use crate::evidence::Quota;

const DAY: Duration = Duration::from_secs(86_400);
/// How long an event is kept, unless the board says otherwise: pictures show people.
pub const KEEP: Duration = Duration::from_secs(30 * 86_400);
const DAYS_MAX: u32 = 3_650;
const EVENTS_MAX: u32 = 100_000;
const MEGABYTES_MAX: u32 = 1_000_000;

/// Pictures of alarms that are kept.
#[derive(Clone, Debug, PartialEq)]
pub struct EvidenceBoard {
    /// Where.
    pub folder: PathBuf,
    /// How much, and for how long.
    pub quota: Quota,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EvidenceTable {
    pub(super) folder: PathBuf,
    events: Option<Count<EVENTS_MAX>>,
    megabytes: Option<Count<MEGABYTES_MAX>>,
    days: Option<Count<DAYS_MAX>>,
}

/// A whole number from 1 to `MAX`.
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "i64")]
struct Count<const MAX: u32>(u32);

impl<const MAX: u32> TryFrom<i64> for Count<MAX> {
    type Error = String;

    fn try_from(count: i64) -> Result<Self, String> {
        match u32::try_from(count) {
            Ok(count) if (1..=MAX).contains(&count) => Ok(Self(count)),
            _ => Err(format!("{count}; wanted a whole number from 1 to {MAX}")),
        }
    }
}

impl EvidenceTable {
    pub(super) fn quota(&self) -> Quota {
        let default = Quota::default();
        let megabytes = self.megabytes.map(|count| u64::from(count.0) * 1_000_000);
        Quota {
            bytes: megabytes.unwrap_or(default.bytes),
            events: self.events.map_or(default.events, |count| count.0 as usize),
            keep: Some(self.days.map_or(KEEP, |count| DAY * count.0)),
        }
    }
}
