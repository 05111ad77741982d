//! Where the time comes from.

use std::fs;
use std::time::SystemTime;

use gapwatch::capture::clock;

use super::check::Check;

/// Where Linux says what its clocks count.
const SOURCE: &str = "/sys/devices/system/clocksource/clocksource0/current_clocksource";

pub fn check() -> Check {
    let source = fs::read_to_string(SOURCE);
    let source = source.map_or_else(|_| "unknown".to_owned(), |name| name.trim().to_owned());
    if source == "jiffies" {
        return Check::fail(
            "clock",
            "the kernel counts time in ticks of milliseconds (jiffies)",
            "enable the processor's own timer in the device tree or kernel",
        );
    }
    let wall = if clock::is_set(SystemTime::now()) {
        "the time of day is set"
    } else {
        "the time of day is not set, which shows in log lines and in the age of evidence from earlier runs"
    };
    Check::pass(
        "clock",
        format!("time since the start from {source}, which no one can set; {wall}"),
    )
}
