//! What `ffmpeg` says while it decodes: the times of frames, and problems.

use std::io::{BufRead, BufReader};
use std::process::ChildStderr;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Time in which the report of a frame must come whose picture has come. It is written before the picture.
const REPORTED_WITHIN: Duration = Duration::from_secs(20);

/// Reads on a thread of its own, so that `ffmpeg` never waits until its messages are read.
pub struct Messages {
    times: Receiver<Option<i64>>,
    reader: Option<JoinHandle<Problems>>,
}

/// Number of errors, and the first one.
#[derive(Default)]
struct Problems {
    count: u64,
    first: Option<String>,
}

/// A line of the messages.
#[derive(Debug, PartialEq)]
enum Line<'a> {
    /// A frame with its time in microseconds, if it has one.
    Frame(Option<i64>),
    Problem(&'a str),
    Other,
}

impl Messages {
    pub fn of(stderr: ChildStderr) -> Self {
        let (sender, times) = channel();
        let reader = std::thread::spawn(move || read(stderr, &sender));
        Self {
            times,
            reader: Some(reader),
        }
    }

    /// The time of the next frame in microseconds; the inner `None` if the file gives it none, and the outer `None` if
    /// it was not reported.
    pub fn next_time(&self) -> Option<Option<i64>> {
        self.times.recv_timeout(REPORTED_WITHIN).ok()
    }

    /// Waits for the last message; returns the number of errors and the first one.
    pub fn problems(&mut self) -> (u64, Option<String>) {
        let read = self.reader.take().and_then(|reader| reader.join().ok());
        let Problems { count, first } = read.unwrap_or_default();
        (count, first)
    }
}

fn read(stderr: ChildStderr, times: &Sender<Option<i64>>) -> Problems {
    let mut problems = Problems::default();
    for line in BufReader::new(stderr).split(b'\n').map_while(Result::ok) {
        match meaning(&String::from_utf8_lossy(&line)) {
            Line::Frame(time) => {
                let _ = times.send(time);
            }
            Line::Problem(what) => {
                problems.count += 1;
                problems.first.get_or_insert_with(|| what.to_owned());
            }
            Line::Other => {}
        }
    }
    problems
}

/// Lines look like `[Parsed_showinfo_1 @ 0x55] [info] n:   7 pts: 280000 pts_time:0.28    pos: 48`.
fn meaning(line: &str) -> Line<'_> {
    // Texts from the file are indented, and say nothing about problems.
    let own = !line.starts_with(' ');
    for level in ["[error] ", "[fatal] ", "[panic] "] {
        if own && let Some((_, what)) = line.split_once(level) {
            return Line::Problem(what.trim_end());
        }
    }
    let report = line.strip_prefix("[Parsed_showinfo_");
    let Some((_, report)) = report.and_then(|rest| rest.split_once("] [info] n:")) else {
        return Line::Other;
    };
    let time = report.split_once("pts:").map(|(_, rest)| rest.trim_start());
    let time = time.and_then(|rest| rest.split_ascii_whitespace().next());
    Line::Frame(time.and_then(|time| time.parse().ok()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_frames_problems_or_neither() {
        for (line, wanted) in [
            (
                "[Parsed_showinfo_1 @ 0x55b5] [info] n:   1 pts: -50000 pts_time:-0.05   pos: 48 fmt:gray",
                Line::Frame(Some(-50_000)),
            ),
            (
                "[Parsed_showinfo_1 @ 0x55b5] [info] n:   2 pts:  NOPTS pts_time:NOPTS",
                Line::Frame(None),
            ),
            (
                "[Parsed_showinfo_1 @ 0x55b5] [info] config in time_base: 1/1000000, frame_rate: 10/1",
                Line::Other,
            ),
            (
                "[h264 @ 0x5] [error] Invalid NAL unit size",
                Line::Problem("Invalid NAL unit size"),
            ),
            (
                "[fatal] Conversion failed!",
                Line::Problem("Conversion failed!"),
            ),
            ("    title           : [error] of a poet", Line::Other),
            ("", Line::Other),
        ] {
            assert_eq!(meaning(line), wanted, "{line}");
        }
    }
}
