//! How often the road is judged: the rates for which thresholds are made.

use std::time::Duration;

use serde::{Deserialize, Serialize};

/// Largest rate, frames a second.
const RATE_HZ_MAX: f64 = 240.0;
/// Rates that differ by less than this share are the same.
const SAME_SHARE: f64 = 0.05;

/// Frames a second that are judged. The thresholds keep their rate of false alarms at these rates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JudgedRate {
    /// At full rate.
    pub rate_hz: f64,
    /// While the road is clearly nominal.
    pub idle_rate_hz: f64,
}

impl Default for JudgedRate {
    /// That of a board file that names none.
    fn default() -> Self {
        Self {
            rate_hz: 10.0,
            idle_rate_hz: 10.0,
        }
    }
}

/// Times from one frame to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Periods {
    /// At full rate.
    pub full: Duration,
    /// While the road is clearly nominal; the same as `full` if there is only one rate.
    pub idle: Duration,
}

impl JudgedRate {
    /// The times between frames.
    pub fn periods(self) -> Periods {
        Periods {
            full: Duration::from_secs_f64(1.0 / self.rate_hz),
            idle: Duration::from_secs_f64(1.0 / self.idle_rate_hz),
        }
    }

    /// At most the rate at which frames come.
    #[must_use]
    pub fn at_most(self, frames_hz: f64) -> Self {
        Self {
            rate_hz: self.rate_hz.min(frames_hz),
            idle_rate_hz: self.idle_rate_hz.min(frames_hz),
        }
    }

    /// At least another rate.
    #[must_use]
    pub fn at_least(self, other: Self) -> Self {
        Self {
            rate_hz: self.rate_hz.max(other.rate_hz),
            idle_rate_hz: self.idle_rate_hz.max(other.idle_rate_hz),
        }
    }

    /// Whether thresholds for this rate are thresholds for another one.
    pub fn is_like(self, other: Self) -> bool {
        let same = |a: f64, b: f64| (a - b).abs() <= SAME_SHARE * a.max(b);
        same(self.rate_hz, other.rate_hz) && same(self.idle_rate_hz, other.idle_rate_hz)
    }

    /// What is wrong with rates that were read, if anything.
    pub fn fault(self) -> Option<String> {
        let possible = |hz: f64| hz > 0.0 && hz <= RATE_HZ_MAX;
        let usable = possible(self.rate_hz)
            && possible(self.idle_rate_hz)
            && self.idle_rate_hz <= self.rate_hz;
        (!usable).then(|| {
            format!(
                "rates of {} and {} frames a second",
                self.rate_hz, self.idle_rate_hz
            )
        })
    }
}

impl std::fmt::Display for JudgedRate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} frames a second", self.rate_hz)?;
        if self.idle_rate_hz < self.rate_hz {
            write!(f, ", {} while the road is calm", self.idle_rate_hz)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_alike_up_to_a_twentieth_and_say_when_they_are_slower() {
        let rate = |rate_hz, idle_rate_hz| JudgedRate {
            rate_hz,
            idle_rate_hz,
        };
        let default = JudgedRate::default();
        assert!(default.is_like(rate(9.6, 10.0)) && !default.is_like(rate(9.4, 10.0)));
        assert!(!default.is_like(rate(10.0, 2.0)));
        assert_eq!(default.at_most(4.0), rate(4.0, 4.0));
        assert_eq!(
            rate(10.0, 2.0).to_string(),
            "10 frames a second, 2 while the road is calm"
        );
        for wrong in [
            rate(0.0, 0.0),
            rate(f64::NAN, 1.0),
            rate(2.0, 3.0),
            rate(241.0, 1.0),
        ] {
            assert!(wrong.fault().is_some(), "{wrong}");
        }
        assert_eq!(default.fault(), None);
    }
}
