//! Notifies the service manager; without a service manager this does nothing.

use gapwatch::live::service::ServiceWords;
use sd_notify::{NotifyState, notify};

pub fn say(words: ServiceWords) {
    let mut states = heapless::Vec::<NotifyState<'_>, 2>::new();
    if words.ready {
        let _ = states.push(NotifyState::Ready);
    }
    if words.alive {
        let _ = states.push(NotifyState::Watchdog);
    }
    tell(&states);
}

/// Sets the status text of the service.
pub fn status(line: &str) {
    tell(&[NotifyState::Status(line)]);
}

pub fn stopping() {
    tell(&[NotifyState::Stopping]);
}

fn tell(states: &[NotifyState<'_>]) {
    if states.is_empty() {
        return;
    }
    if let Err(error) = notify(states) {
        log::debug!("the service manager cannot be notified: {error}");
    }
}
