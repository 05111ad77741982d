//! What the monitor says to the service manager that started it, if one did: when it is ready, that it is alive, and that it
//! stops. systemd restarts a monitor that is silent for too long.

use std::time::Duration;

use sd_notify::{NotifyState, notify, watchdog_enabled};

/// A judge that does not come round for this long, beyond its own pauses, hangs.
const HANGS: Duration = Duration::from_secs(5);

/// One monitor, as the service manager sees it.
pub struct Service {
    /// Time between two signs of life; `None` when nobody waits for them.
    period: Option<Duration>,
    ready: bool,
    /// When it was last said that we live.
    said_at: Duration,
    /// Rounds of the judge, and when their number last changed.
    rounds: (u64, Duration),
    /// Longest time between two rounds of a judge that is well.
    longest: Duration,
}

impl Service {
    /// Of a monitor that judges at least one frame in `pause`.
    pub fn new(pause: Duration) -> Self {
        Self::with_watchdog(pause, watchdog_enabled())
    }

    fn with_watchdog(pause: Duration, limit: Option<Duration>) -> Self {
        Self {
            // Three chances before the time is over.
            period: limit.map(|limit| limit / 3),
            ready: false,
            said_at: Duration::ZERO,
            rounds: (0, Duration::ZERO),
            longest: pause + HANGS,
        }
    }

    /// After the bus was served at `now`: ready at the first word on the road, or on why there is none, and alive as long
    /// as the judge goes round. One that hangs in a frame is reported as stale, but only a restart helps it.
    pub fn served(&mut self, now: Duration, judged_or_fault: bool, rounds: u64) {
        say(&self.due(now, judged_or_fault, rounds));
    }

    fn due(&mut self, now: Duration, judged_or_fault: bool, rounds: u64) -> Vec<NotifyState<'_>> {
        let mut words = Vec::new();
        if rounds != self.rounds.0 {
            self.rounds = (rounds, now);
        }
        if !judged_or_fault || now.saturating_sub(self.rounds.1) > self.longest {
            return words;
        }
        if !self.ready {
            self.ready = true;
            words.push(NotifyState::Ready);
        }
        if self
            .period
            .is_some_and(|period| now >= self.said_at + period)
        {
            self.said_at = now;
            words.push(NotifyState::Watchdog);
        }
        words
    }

    /// What is told to people who ask how the service is.
    pub fn status(&self, line: &str) {
        say(&[NotifyState::Status(line)]);
    }

    pub fn stopping(&self) {
        say(&[NotifyState::Stopping]);
    }
}

/// Without a service manager this does nothing.
fn say(what: &[NotifyState<'_>]) {
    if what.is_empty() {
        return;
    }
    if let Err(error) = notify(what) {
        log::debug!("the service manager does not hear: {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is due at a time in ms.
    fn due(service: &mut Service, ms: u64, judged_or_fault: bool, rounds: u64) -> String {
        let now = Duration::from_millis(ms);
        let words = service.due(now, judged_or_fault, rounds);
        words.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn it_is_ready_with_the_first_word_and_alive_as_long_as_the_judge_goes_round() {
        let at = Duration::from_millis;
        let mut service = Service::with_watchdog(at(100), Some(at(3_000)));
        assert_eq!(due(&mut service, 900, false, 0), "");
        assert_eq!(due(&mut service, 950, true, 1), "READY=1");
        assert_eq!(due(&mut service, 1_000, true, 2), "WATCHDOG=1");
        assert_eq!(due(&mut service, 1_900, true, 3), "");
        assert_eq!(due(&mut service, 2_000, true, 4), "WATCHDOG=1");
        // No word on the road and no fault is no life.
        assert_eq!(due(&mut service, 3_000, false, 5), "");
        // A judge that hangs is alive for its pause and five seconds.
        assert_eq!(due(&mut service, 8_100, true, 5), "WATCHDOG=1");
        assert_eq!(due(&mut service, 9_100, true, 5), "");
        assert_eq!(due(&mut service, 9_200, true, 6), "WATCHDOG=1");
    }

    #[test]
    fn nobody_is_told_of_life_who_does_not_wait_for_it() {
        let mut service = Service::with_watchdog(Duration::ZERO, None);
        assert_eq!(due(&mut service, 1_000, true, 1), "READY=1");
        assert_eq!(due(&mut service, 9_000, true, 2), "");
    }
}
