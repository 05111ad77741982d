//! The time of day, and the time since the computer started, which nobody can set.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

/// The year 2025: a time of day before it means that the clock was not set.
const SET_AFTER: Duration = Duration::from_secs(1_735_689_600);

/// Whether a clock with this time of day has been set.
pub fn is_set(time_of_day: SystemTime) -> bool {
    let since = time_of_day.duration_since(UNIX_EPOCH);
    since.is_ok_and(|since| since >= SET_AFTER)
}

/// Time since the computer started (`CLOCK_MONOTONIC`).
pub fn monotonic() -> Duration {
    let now = clock_gettime(ClockId::Monotonic);
    let seconds = u64::try_from(now.tv_sec).unwrap_or_default();
    Duration::new(seconds, u32::try_from(now.tv_nsec).unwrap_or_default())
}

/// When something happened, by both clocks.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ClockTime {
    /// Time of day, UTC, as in RFC 3339.
    pub utc: String,
    /// Whether the time of day had been set by then.
    pub is_set: bool,
    /// Seconds since the computer started.
    pub monotonic_s: f64,
}

impl ClockTime {
    /// The present time.
    pub fn now() -> Self {
        let time_of_day = SystemTime::now();
        Self {
            utc: jiff::Timestamp::try_from(time_of_day)
                .map(|time| format!("{time:.3}"))
                .unwrap_or_default(),
            is_set: is_set(time_of_day),
            monotonic_s: monotonic().as_secs_f64(),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_clock_that_was_never_set_is_known_by_its_year() {
        let at = |seconds| UNIX_EPOCH + Duration::from_secs(seconds);
        assert!(!is_set(at(0)) && !is_set(UNIX_EPOCH - Duration::from_secs(9)));
        assert!(!is_set(at(1_735_689_599)) && is_set(at(1_735_689_600)));
    }

    #[test]
    fn a_moment_is_told_by_both_clocks() {
        let before = monotonic().as_secs_f64();
        let moment = ClockTime::now();
        let parsed: jiff::Timestamp = moment.utc.parse().unwrap();
        let away = SystemTime::now().duration_since(parsed.into()).unwrap();
        assert!(away < Duration::from_secs(60), "{}", moment.utc);
        assert!(moment.utc.ends_with('Z') && moment.is_set);
        assert!(moment.monotonic_s >= before && moment.monotonic_s < before + 60.0);
    }
}
