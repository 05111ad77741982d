//! SIGINT, SIGTERM and SIGHUP: the first signal asks the program to end cleanly, the second one ends it at once. Commands
//! whose result is whole or nothing end with the first one.

use std::fs;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use gapwatch::files::unfinished;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;
use signal_hook::iterator::Signals;
use signal_hook::low_level::emulate_default_handler;

/// Becomes true with the first signal.
pub fn stop() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGTERM, SIGINT, SIGHUP] {
        // With `nohup`, the program must continue after its terminal is closed.
        if signal == SIGHUP && is_ignored(signal) {
            continue;
        }
        // In this order, so that the first signal finds the flag unset.
        flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&stop))
            .and_then(|_| flag::register(signal, Arc::clone(&stop)))
            .context("cannot wait for signals")?;
    }
    Ok(stop)
}

/// Ends the program with the first signal, and removes what has a temporary name until then.
pub fn end_cleanly() -> anyhow::Result<()> {
    let waited = [SIGTERM, SIGINT, SIGHUP];
    let waited = waited
        .into_iter()
        .filter(|&signal| signal != SIGHUP || !is_ignored(signal));
    let mut signals = Signals::new(waited).context("cannot wait for signals")?;
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || {
            if let Some(signal) = signals.forever().next() {
                unfinished::remove_all();
                if let Err(error) = emulate_default_handler(signal) {
                    log::error!("cannot end by signal {signal}: {error}");
                }
            }
        })
        .context("cannot wait for signals")?;
    Ok(())
}

fn is_ignored(signal: i32) -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status
        .lines()
        .find_map(|line| line.strip_prefix("SigIgn:"))
        .and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
