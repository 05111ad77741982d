//! Says to the service manager what is due; without one this does nothing.

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

/// What is told to people who ask how the service is.
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
        log::debug!("the service manager does not hear: {error}");
    }
}
