//! What is sent to the service manager that started the monitor, if there is one: when the monitor is ready, and that
//! it is alive. systemd restarts a monitor that is silent for too long.

use std::time::Duration;

/// A judge hangs if it completes no round for this long, beyond its own pauses.
const HANGS: Duration = Duration::from_secs(5);

/// What is to be sent to the service manager now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ServiceWords {
    /// The monitor is ready.
    pub ready: bool,
    /// It is alive.
    pub alive: bool,
}

/// One monitor, as the service manager sees it.
#[derive(Debug)]
pub struct Service {
    /// Time between two signs of life; `None` if they are not expected.
    period: Option<Duration>,
    ready: bool,
    /// When the last sign of life was sent.
    said_at: Duration,
    /// Rounds of the judge, and when their number last changed.
    rounds: (u64, Duration),
    /// Longest time between two rounds of a judge that works.
    longest: Duration,
}

impl Service {
    /// For a monitor that judges at least one frame in `pause`. If there is a `limit`, the monitor is restarted when no
    /// sign of life comes for that time.
    pub fn new(pause: Duration, limit: Option<Duration>) -> Self {
        Self {
            // Three signs of life fit into the limit.
            period: limit.map(|limit| limit / 3),
            ready: false,
            said_at: Duration::ZERO,
            rounds: (0, Duration::ZERO),
            longest: pause + HANGS,
        }
    }

    /// What is due after the bus was served at `now`. The monitor is ready at the first verdict on the road, or on why
    /// there is none. It is alive as long as the judge completes rounds. If the judge hangs in a frame, the bus reports
    /// `stale`, but only a restart helps.
    pub fn due(&mut self, now: Duration, judged_or_fault: bool, rounds: u64) -> ServiceWords {
        if rounds != self.rounds.0 {
            self.rounds = (rounds, now);
        }
        if !judged_or_fault || now.saturating_sub(self.rounds.1) > self.longest {
            return ServiceWords::default();
        }
        let words = ServiceWords {
            ready: !self.ready,
            alive: (self.period).is_some_and(|period| now >= self.said_at + period),
        };
        self.ready = true;
        if words.alive {
            self.said_at = now;
        }
        words
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is due at a time in ms.
    fn due(service: &mut Service, ms: u64, judged_or_fault: bool, rounds: u64) -> (bool, bool) {
        let now = Duration::from_millis(ms);
        let words = service.due(now, judged_or_fault, rounds);
        (words.ready, words.alive)
    }

    const NOTHING: (bool, bool) = (false, false);
    const READY: (bool, bool) = (true, false);
    const ALIVE: (bool, bool) = (false, true);

    #[test]
    fn it_is_ready_with_the_first_word_and_alive_as_long_as_the_judge_goes_round() {
        let at = Duration::from_millis;
        let mut service = Service::new(at(100), Some(at(3_000)));
        assert_eq!(due(&mut service, 900, false, 0), NOTHING);
        assert_eq!(due(&mut service, 950, true, 1), READY);
        assert_eq!(due(&mut service, 1_000, true, 2), ALIVE);
        assert_eq!(due(&mut service, 1_900, true, 3), NOTHING);
        assert_eq!(due(&mut service, 2_000, true, 4), ALIVE);
        // Without a verdict on the road or a fault, there is no sign of life.
        assert_eq!(due(&mut service, 3_000, false, 5), NOTHING);
        // A judge that hangs counts as alive for its pause and five seconds.
        assert_eq!(due(&mut service, 8_100, true, 5), ALIVE);
        assert_eq!(due(&mut service, 9_100, true, 5), NOTHING);
        assert_eq!(due(&mut service, 9_200, true, 6), ALIVE);
    }

    #[test]
    fn nobody_is_told_of_life_who_does_not_wait_for_it() {
        let mut service = Service::new(Duration::ZERO, None);
        assert_eq!(due(&mut service, 1_000, true, 1), READY);
        assert_eq!(due(&mut service, 9_000, true, 2), NOTHING);
    }
}
