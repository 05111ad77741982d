//! Progress bars on standard error, if it is a terminal.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar over frames; if their number is not known, it only counts. It is invisible if standard error is not a
/// terminal.
pub fn frames(count: Option<u64>, what: &str) -> ProgressBar {
    over(count, what, "frames")
}

/// The same over other things.
pub fn over(count: Option<u64>, what: &str, things: &str) -> ProgressBar {
    let (bar, template) = match count {
        Some(count) => (
            ProgressBar::new(count),
            format!("{{msg}} {{bar:30}} {{pos}}/{{len}} {things}, {{eta}} left"),
        ),
        None => (
            ProgressBar::no_length(),
            format!("{{msg}} {{spinner}} {{pos}} {things} in {{elapsed}}"),
        ),
    };
    let style =
        ProgressStyle::with_template(&template).unwrap_or_else(|_| ProgressStyle::default_bar());
    bar.with_style(style).with_message(what.to_owned())
}
