//! Log lines for their reader: with colour and time on a terminal, and with only the level in front if systemd's
//! journal reads them, because it adds the time.

use std::io::Write;
use std::os::unix::fs::MetadataExt;

use env_logger::{Builder, Env};
use log::Level;

/// Begins to log to standard error: warnings and errors, unless `RUST_LOG` says otherwise.
pub fn begin() {
    let mut builder = Builder::from_env(Env::default().default_filter_or("warn"));
    if is_read_by_systemd() {
        builder.format(|out, record| {
            let (level, text) = (prefix(record.level()), record.args());
            writeln!(out, "{level}{text}")
        });
    }
    builder.init();
}

/// `<N>` of `syslog(3)` before a line that the journal reads, else nothing.
pub fn prefix(level: Level) -> &'static str {
    if is_read_by_systemd() {
        of_level(level)
    } else {
        ""
    }
}

fn of_level(level: Level) -> &'static str {
    match level {
        Level::Error => "<3>",
        Level::Warn => "<4>",
        Level::Info => "<6>",
        Level::Debug | Level::Trace => "<7>",
    }
}

/// Whether standard error is the stream that systemd says it gave us: `JOURNAL_STREAM` holds its device and number.
fn is_read_by_systemd() -> bool {
    let named = std::env::var("JOURNAL_STREAM").unwrap_or_default();
    let ours = std::fs::metadata("/proc/self/fd/2");
    ours.is_ok_and(|ours| named == format!("{}:{}", ours.dev(), ours.ino()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_those_of_syslog() {
        let levels = [Level::Error, Level::Warn, Level::Info, Level::Debug];
        assert_eq!(levels.map(of_level), ["<3>", "<4>", "<6>", "<7>"]);
    }
}
