//! One steady line on a terminal that says how the road looks now. If standard error is not a terminal, there is no
//! line.

use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use console::{Style, StyledObject};
use gapwatch::monitor::alarm::AlarmState;
use gapwatch::monitor::judge::Verdict;
use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::state_lines::{cause_of_evidence, lanes_lost};

/// How often the line changes in a second: as often as it can be read.
const HZ: u8 = 4;
/// Time over which the rate is measured.
const RATE_OVER: Duration = Duration::from_secs(1);
/// Length of the score's bar in characters; its middle is the alarm threshold.
const BAR: usize = 11;

/// The line.
pub struct Live {
    bar: ProgressBar,
    shown: Option<Instant>,
    /// Frames that were looked at, since `since` and in total.
    frames: u32,
    counted: u64,
    since: Instant,
    rate_hz: Option<f64>,
}

impl Live {
    /// A line for `count` frames, if their number is known; with `quiet`, no line.
    pub fn new(count: Option<u64>, quiet: bool) -> Self {
        let target = if quiet || !io::stderr().is_terminal() {
            ProgressDrawTarget::hidden()
        } else {
            ProgressDrawTarget::stderr_with_hz(HZ)
        };
        // One message holds everything. Separate fields for position and estimate would be drawn with every frame.
        let style =
            ProgressStyle::with_template("{msg}").unwrap_or_else(|_| ProgressStyle::default_bar());
        Self {
            bar: ProgressBar::with_draw_target(count, target).with_style(style),
            shown: None,
            frames: 0,
            counted: 0,
            since: Instant::now(),
            rate_hz: None,
        }
    }

    /// Shows what is known; `age` is the age of the last frame that was looked at.
    pub fn show(&mut self, verdict: &Verdict, age: Duration) {
        if self.bar.is_hidden() {
            return;
        }
        let over = self.since.elapsed();
        if over >= RATE_OVER {
            self.rate_hz = Some(f64::from(self.frames) / over.as_secs_f64());
            (self.frames, self.since) = (0, Instant::now());
        }
        let often = Duration::from_secs(1) / u32::from(HZ);
        if self.shown.is_none_or(|at| at.elapsed() >= often) {
            self.shown = Some(Instant::now());
            let line = line(verdict, self.rate_hz, age);
            self.bar.set_message(format!("{line}  {}", self.progress()));
        }
    }

    /// Counts a frame that was looked at.
    pub fn count(&mut self) {
        self.frames += 1;
        self.counted += 1;
    }

    /// How much is done, and how long the rest takes if that is known.
    #[allow(clippy::cast_precision_loss)]
    fn progress(&self) -> String {
        let elapsed = self.bar.elapsed();
        let Some(count) = self.bar.length() else {
            return format!("{:#}", HumanDuration(elapsed));
        };
        let left = count.saturating_sub(self.counted) as f64 / self.counted.max(1) as f64;
        let left = HumanDuration(elapsed.mul_f64(left));
        format!("{}/{count} frames, {left:#} left", self.counted)
    }

    /// Writes a line above this line; the two lines are never mixed.
    pub fn above(&self, write: impl FnOnce() -> io::Result<()>) -> io::Result<()> {
        if self.bar.is_hidden() {
            write()
        } else {
            self.bar.suspend(write)
        }
    }

    /// Removes the line.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

fn line(verdict: &Verdict, rate_hz: Option<f64>, age: Duration) -> String {
    let state = coloured(verdict.state, format!("{:<11}", verdict.state.name()));
    let gap = match verdict.gap {
        Some(gap) => format!("gap {:>5.2}", gap + 0.0),
        None => "no gap   ".to_owned(),
    };
    let change = verdict.change.map_or_else(String::new, |change| {
        format!("  change {:>5.2}", change + 0.0)
    });
    let bar = verdict.score.map_or_else(|| " ".repeat(BAR), score_bar);
    let cause = cause_of_evidence(verdict);
    let cause = cause.map_or_else(String::new, |cause| format!("  {cause}"));
    let lanes = lanes_lost(verdict);
    let rate = rate_hz.map_or_else(|| "  –".to_owned(), |hz| format!("{hz:>3.0}"));
    format!(
        "{state}  {bar} {gap}{change}{lanes}{cause}  {rate} frames/s  {:>4} ms old",
        age.as_millis()
    )
}

/// A bar from 0 to twice the alarm threshold, which is marked.
fn score_bar(score: f64) -> String {
    // From 0 to the bar's own length.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss
    )]
    let filled = ((0.5 * score).clamp(0.0, 1.0) * BAR as f64).round() as usize;
    let sign = |place: usize| match (place == BAR / 2, place < filled) {
        (true, _) => '|',
        (false, true) => '█',
        (false, false) => '·',
    };
    (0..BAR).map(sign).collect()
}

/// The text in the colour of the state, if the terminal and its user allow colours.
fn coloured(state: AlarmState, text: String) -> StyledObject<String> {
    let style = Style::new().for_stderr();
    let style = match state {
        AlarmState::Init => style.dim(),
        AlarmState::Ok => style.green(),
        AlarmState::Suspect => style.yellow(),
        AlarmState::Gap => style.red().bold(),
        AlarmState::SensorFault | AlarmState::Unavailable => style.magenta(),
    };
    style.apply_to(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bar_passes_its_mark_with_the_threshold() {
        let bars: Vec<String> = [-3.0, 0.4, 1.0, 1.3, 99.0].map(score_bar).to_vec();
        assert_eq!(
            bars,
            [
                "·····|·····",
                "██···|·····",
                "█████|·····",
                "█████|█····",
                "█████|█████",
            ]
        );
    }
}
