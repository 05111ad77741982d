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
        Self {
            // Three chances before the time is over.
            period: watchdog_enabled().map(|limit| limit / 3),
            ready: false,
            said_at: Duration::ZERO,
            rounds: (0, Duration::ZERO),
            longest: pause + HANGS,
        }
    }

    /// After the bus was served at `now`: ready at the first word on the road, or on why there is none, and alive as long
    /// as the judge goes round. One that hangs in a frame is reported as stale, but only a restart helps it.
    pub fn served(&mut self, now: Duration, judged_or_fault: bool, rounds: u64) {
        if rounds != self.rounds.0 {
            self.rounds = (rounds, now);
        }
        if !judged_or_fault || now.saturating_sub(self.rounds.1) > self.longest {
            return;
        }
        if !self.ready {
            self.ready = true;
            say(&[NotifyState::Ready]);
        }
        if self
            .period
            .is_some_and(|period| now >= self.said_at + period)
        {
            self.said_at = now;
            say(&[NotifyState::Watchdog]);
        }
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
    if let Err(error) = notify(what) {
        log::debug!("the service manager does not hear: {error}");
    }
}
