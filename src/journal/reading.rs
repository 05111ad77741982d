//! Journals read again. A line that is not what a journal holds is refused by number, with what was found and wanted.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::About;
use crate::alarm::AlarmState;
use crate::json_fault::fault;

/// Longest line that is read: a thousand times a usual one.
const LINE_MAX: u64 = 1 << 20;
/// Most lines that are read: a week at 10 frames a second.
const LINES_MAX: usize = 6_048_000;
/// Most characters of a line that an error repeats.
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
    /// The file itself.
    #[error("journal {}: {error}", path.display())]
    Unreadable {
        /// Which.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// It has no line.
    #[error("journal {}: found no line; wanted at least one frame, as replay --journal writes them", .0.display())]
    Empty(PathBuf),
    /// One of its lines.
    #[error("journal {}, line {line}: found {found}; wanted {wanted}", path.display())]
    Line {
        /// Which file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// What stands there.
        found: String,
        /// What would do.
        wanted: String,
    },
}

/// One line: what was known after a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Time of the frame, seconds since the source began.
    pub t_s: f64,
    /// Its number; `None` for a verdict that no frame gave.
    pub sequence: Option<u64>,
    /// What the car was told.
    pub state: AlarmState,
    /// Why, in the journal's word.
    pub reason: String,
    /// The largest score of the blocks; `None` when the frame was not judged.
    pub score: Option<f64>,
    /// Gap by tap.
    pub gap: BTreeMap<String, Option<f64>>,
    /// Similarity by tap.
    pub similarity: BTreeMap<String, Option<f64>>,
    /// Score by tap; empty in journals that do not carry it.
    pub tap_score: BTreeMap<String, Option<f64>>,
    /// `ok`, or why the frame was not judged.
    pub health: String,
    /// From frame to verdict, milliseconds.
    pub latency_ms: f64,
}

/// A whole journal.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reading {
    /// What the run was made with, if the journal says so.
    pub about: Option<About>,
    /// In order of time; never empty when read.
    pub entries: Vec<Entry>,
}

/// Reads a journal.
///
/// # Errors
/// When the file cannot be read, has no line, or one of its lines is not a journal's.
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
        let object = object(&bytes).map_err(refused)?;
        let entry = entry(&object).map_err(refused)?;
        if let Some(before) = reading.entries.last().filter(|e| e.t_s > entry.t_s) {
            return Err(refused((
                format!("t_s {} after {}", entry.t_s, before.t_s),
                "time that does not run backwards".to_owned(),
            )));
        }
        if let Some(about) = object.get("about") {
            reading.about = Some(serde_json::from_value(about.clone()).map_err(|error| {
                refused((
                    format!("about: {}", fault(&error)),
                    "texts and numbers".to_owned(),
                ))
            })?);
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
            shown(String::from_utf8_lossy(bytes).trim()),
            "one JSON object, {\"t_s\": …, \"state\": …, …}".to_owned(),
        )),
    }
}

fn entry(object: &Map<String, Value>) -> Result<Entry, Mismatch> {
    let text = |key: &str| {
        let text = value(object, key)?.as_str().map(str::to_owned);
        text.ok_or_else(|| mismatch(object, key, "text"))
    };
    let number_from_0 = |key: &str| {
        let number = value(object, key)?.as_f64().filter(|&n| n >= 0.0);
        number.ok_or_else(|| mismatch(object, key, "a number not below 0"))
    };
    let state = text("state")?;
    let state = STATES.into_iter().find(|s| s.name() == state);
    let sequence = match value(object, "seq")? {
        Value::Null => None,
        number => Some(
            number
                .as_u64()
                .ok_or_else(|| mismatch(object, "seq", "a whole number or null"))?,
        ),
    };
    Ok(Entry {
        t_s: number_from_0("t_s")?,
        sequence,
        state: state
            .ok_or_else(|| mismatch(object, "state", &STATES.map(AlarmState::name).join(", ")))?,
        reason: text("reason")?,
        score: number_or_null(value(object, "score")?)
            .ok_or_else(|| mismatch(object, "score", "a number or null"))?,
        gap: per_tap(object, "gap")?,
        similarity: per_tap(object, "similarity")?,
        tap_score: match object.get("tap_score") {
            Some(_) => per_tap(object, "tap_score")?,
            None => BTreeMap::new(),
        },
        health: text("health")?,
        latency_ms: number_from_0("latency_ms")?,
    })
}

fn per_tap(
    object: &Map<String, Value>,
    key: &str,
) -> Result<BTreeMap<String, Option<f64>>, Mismatch> {
    let wanted = || mismatch(object, key, "an object with a number or null for each tap");
    let taps = value(object, key)?.as_object().ok_or_else(wanted)?;
    taps.iter()
        .map(|(tap, value)| Ok((tap.clone(), number_or_null(value).ok_or_else(wanted)?)))
        .collect()
}

/// The number, or that there is none; `None` when it is something else.
#[allow(clippy::option_option)]
fn number_or_null(value: &Value) -> Option<Option<f64>> {
    if value.is_null() {
        Some(None)
    } else {
        value.as_f64().map(Some)
    }
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

/// Text of others for one line of an error: cut, and without what could move the cursor.
fn shown(text: &str) -> String {
    let cut: String = text.chars().take(SHOWN_MAX).collect();
    let more = if cut.len() < text.len() { "…" } else { "" };
    format!("{}{more}", cut.escape_debug())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const LINE: &str = r#"{"t_s":0.5,"seq":5,"state":"Ok","reason":"none","score":0.25,"gap":{"e2":0.1,"e3":null},"similarity":{"e2":0.9,"e3":null},"health":"ok","latency_ms":3.5}"#;

    fn reading(text: &str) -> Result<Reading, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j.jsonl");
        std::fs::write(&path, text).unwrap();
        read(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn a_line_is_read_as_it_was_written() {
        let reading = reading(&format!("{LINE}\n{LINE}")).unwrap();
        assert_eq!(reading.entries.len(), 2);
        let entry = &reading.entries[0];
        assert_eq!((entry.t_s, entry.sequence), (0.5, Some(5)));
        assert_eq!((entry.state, entry.score), (AlarmState::Ok, Some(0.25)));
        assert_eq!((entry.gap["e2"], entry.gap["e3"]), (Some(0.1), None));
        assert!(entry.tap_score.is_empty() && reading.about.is_none());
    }

    #[test]
    fn what_is_no_journal_is_refused_with_line_found_and_wanted() {
        let second = |from: &str, to: &str| format!("{LINE}\n{}\n", LINE.replace(from, to));
        for (text, parts) in [
            (String::new(), ["found no line", "wanted at least one"]),
            (
                format!("{LINE}\nhello\n"),
                ["line 2: found hello", "JSON object"],
            ),
            (format!("{LINE}\n\n"), ["line 2", "JSON object"]),
            (
                format!("{LINE}\n{}", &LINE[..40]),
                ["line 2", "JSON object"],
            ),
            (
                second("\"t_s\":0.5,", ""),
                ["line 2: found no \"t_s\"", "every line"],
            ),
            (second("0.5", "-1"), ["t_s: -1", "not below 0"]),
            (second("0.5", "0.25"), ["t_s 0.25 after 0.5", "backwards"]),
            (second("0.5", "1e999"), ["line 2", "JSON object"]),
            (
                second("\"Ok\"", "\"Fine\""),
                ["state: \\\"Fine\\\"", "Init, Ok, Suspect"],
            ),
            (
                second("0.25", "\"high\""),
                ["score: \\\"high\\\"", "a number or null"],
            ),
            (second("null", "[]"), ["gap: {", "each tap"]),
            (
                second("\"seq\":5", "\"seq\":-5"),
                ["seq: -5", "whole number"],
            ),
            (second("3.5", "null"), ["latency_ms: null", "a number"]),
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
