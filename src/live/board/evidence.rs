//! `[evidence]` of a board file: whether pictures of alarms are kept, how many, and for how long.

use std::path::PathBuf;
use std::time::Duration;

use crate::files::toml_keys::{self, Keys, Kind, Wrong};
use crate::record::events::Quota;

const DAY: Duration = Duration::from_secs(86_400);
/// How long an event is kept, unless the board says otherwise. It is limited because pictures show people.
pub const KEEP: Duration = Duration::from_secs(30 * 86_400);
const DAYS_MAX: u32 = 3_650;
const EVENTS_MAX: u32 = 100_000;
const MEGABYTES_MAX: u32 = 1_000_000;

/// Pictures of alarms that are kept.
#[derive(Clone, Debug, PartialEq)]
pub struct EvidenceBoard {
    /// Folder of the events.
    pub folder: PathBuf,
    /// How much is kept, and for how long.
    pub quota: Quota,
}

/// `[evidence]`; `None` without it.
pub(super) fn read(
    file: &Keys<'_>,
    beside: impl Fn(PathBuf) -> PathBuf,
) -> Result<Option<EvidenceBoard>, Wrong> {
    let Some(table) = file.table("evidence", &["folder", "events", "megabytes", "days"])? else {
        return Ok(None);
    };
    let count = |key, most: u32| table.get(key, toml_keys::whole(1..=most, ""));
    let default = Quota::default();
    let events = count("events", EVENTS_MAX)?;
    let megabytes = count("megabytes", MEGABYTES_MAX)?;
    let days = count("days", DAYS_MAX)?;
    Ok(Some(EvidenceBoard {
        folder: beside(table.need("folder", folder())?),
        quota: Quota {
            bytes: megabytes.map_or(default.bytes, |megabytes| u64::from(megabytes) * 1_000_000),
            events: events.map_or(default.events, |events| events as usize),
            keep: Some(days.map_or(KEEP, |days| DAY * days)),
        },
    }))
}

fn folder() -> Kind<PathBuf> {
    toml_keys::text("the name of a folder").of(|name| Some(PathBuf::from(name)))
}
