//! CPU time of this thread, from Linux.

use std::fs;
use std::time::Duration;

/// Time that this thread has run, to the nanosecond; `None` where the system does not tell.
pub fn cpu_time() -> Option<Duration> {
    let text = fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanos = text.split_whitespace().next()?.parse().ok()?;
    Some(Duration::from_nanos(nanos))
}
