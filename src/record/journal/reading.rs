//! Reads journals. A line that does not belong in a journal is an error with the line's number, and with what was found
//! and wanted.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use super::about::{About, VERSION};
use crate::capture::clock::ClockTime;
use crate::files::whole_file::without_mark;
use crate::monitor::alarm::AlarmState;
use crate::reference::cause::{Cause, LikelyCause};

/// Longest line that is read: a thousand times a usual one.
const LINE_MAX: u64 = 1 << 20;
/// Largest number of lines that are read: a week at 10 frames a second.
const LINES_MAX: usize = 6_048_000;
/// Largest number of characters of a line that an error repeats.
const SHOWN_MAX: usize = 60;

const STATES: [AlarmState; 6] = [
    AlarmState::Init,
    AlarmState::Ok,
    AlarmState::Suspect,
    AlarmState::Gap,
    AlarmState::SensorFault,
    AlarmState::Unavailable,
];

/// A journal that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be read.
    #[error("journal {}: {error}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// The journal has no line of a frame.
    #[error("journal {}: found no line; wanted at least one frame, as --journal writes them", .0.display())]
    Empty(PathBuf),
    /// The journal was written by another version.
    #[error("journal {}: found {found}; wanted version {VERSION}: make it again with replay --journal or monitor --journal of this gapwatch", path.display())]
    Version {
        /// Which file.
        path: PathBuf,
        /// The version that it has.
        found: String,
    },
    /// A line is wrong.
    #[error("journal {}, line {line}: found {found}; wanted {wanted}", path.display())]
    Line {
        /// Which file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// What was found.
        found: String,
        /// What was wanted.
        wanted: String,
    },
}

/// One line: what was known after a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// When the verdict was reported, seconds since the source began.
    pub t_s: f64,
    /// Time of the frame, seconds since the source began; `None` for a verdict without a frame.
    pub captured_s: Option<f64>,
    /// Number of the frame; `None` for a verdict without a frame.
    pub sequence: Option<u64>,
    /// The state that was reported to the car.
    pub state: AlarmState,
    /// The reason for the state, with the journal's word.
    pub reason: String,
    /// The largest score of the answers that raise the warning; `None` when none of them is known.
    pub score: Option<f64>,
    /// How far the road is from the nearest nominal domain; `None` when the frame was not judged.
    pub gap: Option<f64>,
    /// How far the road differs from its own past; `None` when this is not known.
    pub change: Option<f64>,
    /// Forecast of the share of lanes that the model loses, 0..1; `None` when there is no forecast.
    pub lanes: Option<f64>,
    /// What most likely causes the evidence; `None` when nothing is known of it.
    pub cause: Option<LikelyCause>,
    /// Gap by tap, in the metric's own units.
    pub tap_gap: BTreeMap<String, Option<f64>>,
    /// Similarity by tap.
    pub tap_similarity: BTreeMap<String, Option<f64>>,
    /// Score by tap.
    pub tap_score: BTreeMap<String, Option<f64>>,
    /// `ok`, or why the frame was not judged.
    pub health: String,
    /// Time from frame to verdict, milliseconds.
    pub latency_ms: f64,
}

/// A whole journal.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reading {
    /// What the run was made with.
    pub about: About,
    /// When it began.
    pub began: ClockTime,
    /// Lines in the order of time; never empty after reading.
    pub entries: Vec<Entry>,
    /// Whether the last line is incomplete, because the run was killed or lost its power while it wrote. This line is
    /// left out.
    pub breaks_off: bool,
}

/// Reads a journal, also one that is being written.
///
/// # Errors
/// When the file cannot be read, is of another version, has no line of a frame, or has a line that does not belong in a
/// journal.
pub fn read(path: &Path) -> Result<Reading, ReadError> {
    let unreadable = |error| ReadError::Unreadable {
        path: path.to_owned(),
        error,
    };
    let mut lines = BufReader::new(File::open(path).map_err(unreadable)?);
    let mut reading = Reading::default();
    for line in 1.. {
        let refused = |(found, wanted): (String, String)| ReadError::Line {
            path: path.to_owned(),
            line,
            found,
            wanted,
        };
        let mut bytes = Vec::new();
        let length = (&mut lines)
            .take(LINE_MAX)
            .read_until(b'\n', &mut bytes)
            .map_err(unreadable)?;
        if length == 0 {
            break;
        }
        if length as u64 == LINE_MAX {
            let wanted = format!("lines shorter than {LINE_MAX} bytes");
            return Err(refused(("a longer line".to_owned(), wanted)));
        }
        if line > LINES_MAX {
            let wanted = format!("at most {LINES_MAX} lines");
            return Err(refused(("more lines".to_owned(), wanted)));
        }
        if bytes.last() != Some(&b'\n') {
            reading.breaks_off = true;
            break;
        }
        let text = match line {
            1 => without_mark(&bytes),
            _ => &bytes,
        };
        let object = object(text).map_err(refused)?;
        if line == 1 {
            let found = version(&object).map_err(refused)?;
            if found != VERSION {
                return Err(ReadError::Version {
                    path: path.to_owned(),
                    found: format!("version {found}"),
                });
            }
            reading.about = part(&object, "about").map_err(refused)?;
            reading.began = part(&object, "began").map_err(refused)?;
            continue;
        }
        let entry = entry(&object).map_err(refused)?;
        if let Some(before) = reading.entries.last().filter(|e| e.t_s > entry.t_s) {
            return Err(refused((
                format!("t_s {} after {}", entry.t_s, before.t_s),
                "time that does not run backwards".to_owned(),
            )));
        }
        reading.entries.push(entry);
    }
    if reading.entries.is_empty() {
        return Err(ReadError::Empty(path.to_owned()));
    }
    Ok(reading)
}

/// What was found and what was wanted.
type Mismatch = (String, String);

fn object(bytes: &[u8]) -> Result<Map<String, Value>, Mismatch> {
    match serde_json::from_slice(bytes) {
        Ok(Value::Object(object)) => Ok(object),
        _ => Err((
            match std::str::from_utf8(bytes) {
                Ok(text) => shown(text.trim()),
                Err(_) => "no text in UTF-8".to_owned(),
            },
            "one JSON object, {\"t_s\": …, \"state\": …, …}".to_owned(),
        )),
    }
}

/// The version according to the first line. Version 1 did not give it, and began with a frame.
fn version(first: &Map<String, Value>) -> Result<u64, Mismatch> {
    match first.get("gapwatch_journal") {
        Some(version) => version.as_u64().ok_or_else(|| {
            let wanted = VERSION.to_string();
            mismatch(first, "gapwatch_journal", &wanted)
        }),
        None if first.contains_key("t_s") => Ok(1),
        None => Err((
            "no \"gapwatch_journal\"".to_owned(),
            format!("the first line of a journal, {{\"gapwatch_journal\": {VERSION}, …}}"),
        )),
    }
}

/// A part of the first line; a default if it is missing.
fn part<T: Default + DeserializeOwned>(
    first: &Map<String, Value>,
    key: &str,
) -> Result<T, Mismatch> {
    let Some(value) = first.get(key) else {
        return Ok(T::default());
    };
    serde_json::from_value(value.clone())
        .map_err(|_| mismatch(first, key, "an object as gapwatch writes it"))
}

fn entry(object: &Map<String, Value>) -> Result<Entry, Mismatch> {
    let text = |key: &str| {
        let text = value(object, key)?.as_str().map(str::to_owned);
        text.ok_or_else(|| mismatch(object, key, "text"))
    };
    let from_0 = |key: &str| match given(object, key) {
        None => Ok(None),
        Some(number) => match number.as_f64().filter(|&n| n >= 0.0) {
            Some(number) => Ok(Some(number)),
            None => Err(mismatch(object, key, "a number not below 0")),
        },
    };
    let state = text("state")?;
    let state = STATES.into_iter().find(|s| s.name() == state);
    let whole = |number: &Value| {
        let number = number.as_u64();
        number.ok_or_else(|| mismatch(object, "seq", "a whole number or null"))
    };
    let number = |key: &str| match given(object, key) {
        None => Ok(None),
        Some(number) => match number.as_f64() {
            Some(number) => Ok(Some(number)),
            None => Err(mismatch(object, key, "a number or null")),
        },
    };
    Ok(Entry {
        t_s: from_0("t_s")?.ok_or_else(|| mismatch(object, "t_s", "a number not below 0"))?,
        captured_s: from_0("captured_s")?,
        sequence: given(object, "seq").map(whole).transpose()?,
        state: state
            .ok_or_else(|| mismatch(object, "state", &STATES.map(AlarmState::name).join(", ")))?,
        reason: given(object, "reason").map_or(Ok("none".to_owned()), |_| text("reason"))?,
        score: number("score")?,
        gap: number("gap")?,
        change: number("change")?,
        lanes: share(object, "lanes")?,
        cause: likely_cause(object)?,
        tap_gap: per_tap(object, "tap_gap")?,
        tap_similarity: per_tap(object, "tap_similarity")?,
        tap_score: per_tap(object, "tap_score")?,
        health: given(object, "health").map_or(Ok("ok".to_owned()), |_| text("health"))?,
        latency_ms: from_0("latency_ms")?.unwrap_or_default(),
    })
}

/// A share of 1, if the line has it.
fn share(object: &Map<String, Value>, key: &str) -> Result<Option<f64>, Mismatch> {
    let Some(share) = given(object, key) else {
        return Ok(None);
    };
    match share.as_f64().filter(|share| (0.0..=1.0).contains(share)) {
        Some(share) => Ok(Some(share)),
        None => Err(mismatch(object, key, "a number from 0 to 1")),
    }
}

/// A cause with its probability, if the line has one.
fn likely_cause(object: &Map<String, Value>) -> Result<Option<LikelyCause>, Mismatch> {
    let Some(name) = given(object, "cause") else {
        return Ok(None);
    };
    let cause = name.as_str().and_then(|name| name.parse().ok());
    let probability = share(object, "cause_probability")?;
    Ok(Some(LikelyCause {
        cause: cause
            .ok_or_else(|| mismatch(object, "cause", &Cause::ALL.map(Cause::name).join(", ")))?,
        probability: probability.ok_or_else(|| {
            let found = "a cause without \"cause_probability\"".to_owned();
            (found, "a number from 0 to 1".to_owned())
        })?,
    }))
}

/// One number for each tap; empty if the line does not have them.
fn per_tap(
    object: &Map<String, Value>,
    key: &str,
) -> Result<BTreeMap<String, Option<f64>>, Mismatch> {
    let wanted = || mismatch(object, key, "an object with a number or null for each tap");
    let Some(taps) = given(object, key) else {
        return Ok(BTreeMap::new());
    };
    let taps = taps.as_object().ok_or_else(wanted)?;
    taps.iter()
        .map(|(tap, value)| Ok((tap.clone(), number_or_null(value).ok_or_else(wanted)?)))
        .collect()
}

/// The number, or that there is none; `None` if it is something else.
#[allow(clippy::option_option)]
fn number_or_null(value: &Value) -> Option<Option<f64>> {
    if value.is_null() {
        Some(None)
    } else {
        value.as_f64().map(Some)
    }
}

/// The value of a key, if the line has it.
fn given<'a>(object: &'a Map<String, Value>, key: &str) -> Option<&'a Value> {
    object.get(key).filter(|value| !value.is_null())
}

fn value<'a>(object: &'a Map<String, Value>, key: &str) -> Result<&'a Value, Mismatch> {
    object
        .get(key)
        .ok_or_else(|| (format!("no {key:?}"), "it in every line".to_owned()))
}

fn mismatch(object: &Map<String, Value>, key: &str, wanted: &str) -> Mismatch {
    let found = object.get(key).map(Value::to_string).unwrap_or_default();
    (format!("{key}: {}", shown(&found)), wanted.to_owned())
}

/// Text from a file for one line of an error: cut, and without characters that could move the cursor.
fn shown(text: &str) -> String {
    let cut: String = text.chars().take(SHOWN_MAX).collect();
    let more = if cut.len() < text.len() { "…" } else { "" };
    format!("{}{more}", cut.escape_debug())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use std::time::Duration;

    use super::*;
    use crate::monitor::judge::Verdict;
    use crate::record::journal::Journal;

    const FIRST: &str = r#"{"gapwatch_journal":4,"began":{"utc":"2026-01-02T03:04:05.678Z","is_set":true,"monotonic_s":7.5},"about":{"source":"s"}}"#;
    const LINE: &str = r#"{"t_s":0.5,"captured_s":0.49,"seq":5,"state":"Ok","reason":"none","score":0.25,"gap":0.25,"change":-0.5,"lanes":0.75,"cause":"another-road","cause_probability":0.875,"tap_gap":{"e2":0.1,"e3":null},"tap_similarity":{"e2":0.9,"e3":null},"health":"ok","latency_ms":3.5}"#;

    fn reading(text: &str) -> Result<Reading, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j.jsonl");
        std::fs::write(&path, text).unwrap();
        read(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn a_line_is_read_as_it_was_written() {
        let reading = reading(&format!("{FIRST}\n{LINE}\n{LINE}\n")).unwrap();
        assert_eq!((reading.entries.len(), reading.breaks_off), (2, false));
        let entry = &reading.entries[0];
        assert_eq!((entry.t_s, entry.captured_s), (0.5, Some(0.49)));
        assert_eq!(entry.sequence, Some(5));
        assert_eq!((entry.state, entry.score), (AlarmState::Ok, Some(0.25)));
        assert_eq!((entry.change, entry.lanes), (Some(-0.5), Some(0.75)));
        let likely = LikelyCause {
            cause: Cause::AnotherRoad,
            probability: 0.875,
        };
        assert_eq!(entry.cause, Some(likely));
        assert_eq!(entry.gap, Some(0.25));
        assert_eq!(
            (entry.tap_gap["e2"], entry.tap_gap["e3"]),
            (Some(0.1), None)
        );
        assert!(entry.tap_score.is_empty());
        assert_eq!(reading.about.source, "s");
        assert_eq!(reading.began.monotonic_s, 7.5);
    }

    #[test]
    fn what_is_written_of_a_verdict_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j.jsonl");
        let (began, about) = (ClockTime::default(), About::default());
        let mut journal = Journal::create(&path, &[], &began, &about).unwrap();
        let verdicts = Cause::ALL.map(|cause| Verdict {
            score: Some(1.25),
            gap: Some(0.5),
            change: Some(1.25),
            lanes: Some(1.0),
            cause: Some(LikelyCause {
                cause,
                probability: 0.1,
            }),
            ..Verdict::nothing_yet()
        });
        for verdict in &verdicts {
            let now = Duration::ZERO;
            journal.add(now, verdict, now).unwrap();
        }
        journal.finish().unwrap();
        let entries = read(&path).unwrap().entries;
        assert_eq!(entries.len(), verdicts.len());
        for (entry, verdict) in entries.iter().zip(&verdicts) {
            assert_eq!(
                (
                    entry.score,
                    entry.gap,
                    entry.change,
                    entry.lanes,
                    entry.cause
                ),
                (
                    verdict.score,
                    verdict.gap,
                    verdict.change,
                    verdict.lanes,
                    verdict.cause
                )
            );
        }
    }

    #[test]
    fn what_a_line_does_not_say_may_be_left_out_or_null() {
        let short = r#"{"t_s":1,"state":"Unavailable"}"#;
        let nulls = r#"{"t_s":2,"captured_s":null,"seq":null,"state":"Init","reason":null,"score":null,"change":null,"lanes":null,"cause":null,"cause_probability":null,"gap":null,"tap_gap":null,"health":null,"latency_ms":null,"later":1}"#;
        let first = r#"{"gapwatch_journal":4}"#;
        let reading = reading(&format!("{first}\n{short}\n{nulls}\n")).unwrap();
        for entry in &reading.entries {
            assert_eq!(
                (entry.captured_s, entry.sequence, entry.score),
                (None, None, None)
            );
            assert_eq!((entry.change, entry.lanes, entry.cause), (None, None, None));
            assert_eq!(
                (entry.reason.as_str(), entry.health.as_str()),
                ("none", "ok")
            );
            assert!(entry.gap.is_none() && entry.tap_gap.is_empty());
        }
        assert_eq!(reading.about, About::default());
    }

    #[test]
    fn of_a_run_that_was_killed_the_whole_lines_are_read() {
        let text = format!("{FIRST}\n{LINE}\n{LINE}\n");
        let first = FIRST.len() + 1;
        for cut in first + LINE.len() + 1..text.len() {
            let reading = reading(&text[..cut]).unwrap();
            assert_eq!(reading.entries.len(), 1, "{cut}");
            assert_eq!(reading.breaks_off, cut > first + LINE.len() + 1);
        }
        assert!(reading(&text[..first]).unwrap_err().contains("no line"));
    }

    #[test]
    fn a_journal_of_another_version_is_refused_with_what_would_do() {
        for (text, found) in [
            (format!("{LINE}\n"), "found version 1;"),
            (FIRST.replace(":4,", ":2,") + "\n", "found version 2;"),
            (FIRST.replace(":4,", ":3,") + "\n", "found version 3;"),
        ] {
            let said = reading(&text).unwrap_err();
            assert!(said.contains(found) && said.contains("again"), "{said}");
            assert!(
                said.contains("wanted version 4") && !said.contains('\n'),
                "{said}"
            );
        }
    }

    #[test]
    fn what_is_no_journal_is_refused_with_line_found_and_wanted() {
        let second =
            |from: &str, to: &str| format!("{FIRST}\n{LINE}\n{}\n", LINE.replacen(from, to, 1));
        for (text, parts) in [
            (String::new(), ["found no line", "wanted at least one"]),
            ("{}\n".to_owned(), ["line 1", "the first line of a journal"]),
            (
                FIRST.replace(":4,", ":\"4\",") + "\n",
                ["line 1: found gapwatch_journal", "wanted 4"],
            ),
            (
                FIRST.replace("{\"source\":\"s\"}", "7") + "\n",
                ["line 1: found about: 7", "an object"],
            ),
            (
                format!("{FIRST}\n{LINE}\nhello\n"),
                ["line 3: found hello", "JSON object"],
            ),
            (format!("{FIRST}\n{LINE}\n\n"), ["line 3", "JSON object"]),
            (
                second("\"state\":\"Ok\",", ""),
                ["line 3: found no \"state\"", "every line"],
            ),
            (second("0.5", "-1"), ["t_s: -1", "not below 0"]),
            (second("0.5", "0.25"), ["t_s 0.25 after 0.5", "backwards"]),
            (second("0.5", "1e999"), ["line 3", "JSON object"]),
            (
                second("\"Ok\"", "\"Fine\""),
                ["state: \\\"Fine\\\"", "Init, Ok, Suspect"],
            ),
            (
                second("0.25", "\"high\""),
                ["score: \\\"high\\\"", "a number or null"],
            ),
            (
                second("-0.5", "\"much\""),
                ["change: \\\"much\\\"", "a number or null"],
            ),
            (second("0.75", "1.5"), ["lanes: 1.5", "from 0 to 1"]),
            (
                second("another-road", "fogg"),
                ["cause: \\\"fogg\\\"", "wanted fog, night"],
            ),
            (
                second(",\"cause_probability\":0.875", ""),
                ["a cause without \"cause_probability\"", "from 0 to 1"],
            ),
            (
                second("0.875", "-0.5"),
                ["cause_probability: -0.5", "from 0 to 1"],
            ),
            (second("null", "[]"), ["gap: {", "each tap"]),
            (
                second("\"seq\":5", "\"seq\":-5"),
                ["seq: -5", "whole number"],
            ),
            (
                second("3.5", "\"x\""),
                ["latency_ms: \\\"x\\\"", "a number"],
            ),
            (
                "x".repeat(1 << 21),
                ["line 1: found a longer line", "shorter than"],
            ),
        ] {
            let said = reading(&text).unwrap_err();
            for part in parts {
                assert!(said.contains(part), "wanted {part}: {said}");
            }
        }
    }
}
