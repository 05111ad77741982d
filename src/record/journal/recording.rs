//! A journal as an MCAP recording: verdicts beside the images that they are about, on one time line.
//!
//! | topic | schema | written as |
//! |---|---|---|
//! | `/gapwatch/image` | `sensor_msgs/msg/CompressedImage`, JPEG | CDR, as ROS 2 does |
//! | `/gapwatch/verdict` | `gapwatch.Verdict`, a JSON schema: a line of the journal | JSON |
//!
//! What the run was made with is the metadata record `gapwatch`.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use byteorder::LittleEndian;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{McapError, WriteOptions, Writer};
use serde::Serialize;
use serde_json::Value;

use super::about::About;
use super::line::Line;
use super::writing::JournalError;
use crate::capture::{Frame, jpeg};
use crate::files::whole_file::WholeFile;
use crate::monitor::judge::Verdict;
use crate::reference::cause::Cause;

/// The journal's line as a schema; the taps are added to its objects, and the causes to its list.
const VERDICT_SCHEMA: &str = include_str!("verdict.schema.json");
/// The objects of a line that have one number for each tap.
const PER_TAP: [&str; 3] = ["tap_gap", "tap_similarity", "tap_score"];
/// Fields of `sensor_msgs/msg/CompressedImage` and of the messages in it, in the notation of ROS 2.
const IMAGE_SCHEMA: &str = "std_msgs/Header header
string format
uint8[] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";
/// Little-endian CDR.
const CDR_HEAD: [u8; 4] = [0, 1, 0, 0];

/// Writes images and verdicts; the file appears whole when it is finished.
pub struct RecordingJournal {
    path: PathBuf,
    writer: Writer<NoSeek<WholeFile>>,
    taps: Vec<String>,
    images: u16,
    verdicts: u16,
    messages: u32,
    began_at: Duration,
}

#[derive(Serialize)]
struct CompressedImage<'a> {
    sec: i32,
    nanosec: u32,
    frame_id: &'a str,
    format: &'a str,
    #[serde(with = "serde_bytes")]
    data: &'a [u8],
}

impl RecordingJournal {
    /// Begins a recording of a run of a model with these taps.
    ///
    /// # Errors
    /// When nothing can be written beside `path`.
    pub fn create(path: &Path, taps: &[String], about: &About) -> Result<Self, JournalError> {
        let begin = || -> io::Result<_> {
            let file = NoSeek::new(WholeFile::create(path)?);
            let mut writer = WriteOptions::new()
                .library(concat!("gapwatch ", env!("CARGO_PKG_VERSION")))
                .profile("")
                .disable_seeking(true)
                .compression_threads(0)
                .create(file)
                .map_err(io_error)?;
            let metadata = Metadata {
                name: "gapwatch".to_owned(),
                metadata: texts(about)?,
            };
            writer.write_metadata(&metadata).map_err(io_error)?;
            let mut channel = |topic, schema: (&str, &str, &[u8]), encoding| {
                let schema = writer.add_schema(schema.0, schema.1, schema.2)?;
                writer.add_channel(schema, topic, encoding, &BTreeMap::new())
            };
            let schema = IMAGE_SCHEMA.as_bytes();
            let schema = ("sensor_msgs/msg/CompressedImage", "ros2msg", schema);
            let images = channel("/gapwatch/image", schema, "cdr").map_err(io_error)?;
            let schema = verdict_schema(taps)?;
            let schema = ("gapwatch.Verdict", "jsonschema", schema.as_slice());
            let verdicts = channel("/gapwatch/verdict", schema, "json").map_err(io_error)?;
            Ok((writer, images, verdicts))
        };
        let (writer, images, verdicts) = begin().map_err(|error| JournalError {
            path: path.to_owned(),
            error,
        })?;
        Ok(Self {
            path: path.to_owned(),
            writer,
            taps: taps.to_vec(),
            images,
            verdicts,
            messages: 0,
            began_at: Duration::ZERO,
        })
    }

    /// Sets the time of the source's clock at time 0 of the run.
    pub fn begin_at(&mut self, began_at: Duration) {
        self.began_at = began_at;
    }

    /// Adds a frame's picture, if it has one.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn add_image(&mut self, frame: &Frame) -> Result<(), JournalError> {
        let Ok(pixels) = &frame.picture else {
            return Ok(());
        };
        let at = self.began_at.saturating_add(frame.captured_at);
        let message = jpeg(&pixels.picture()).and_then(|jpeg| {
            let image = CompressedImage {
                sec: i32::try_from(at.as_secs()).unwrap_or(i32::MAX),
                nanosec: at.subsec_nanos(),
                frame_id: "camera",
                format: "jpeg",
                data: &jpeg,
            };
            let fields = cdr_encoding::to_vec::<_, LittleEndian>(&image);
            Ok([&CDR_HEAD, fields.map_err(io::Error::other)?.as_slice()].concat())
        });
        let message = message.map_err(|error| self.failed(error))?;
        self.write(self.images, at, &message)
    }

    /// Adds a verdict and the time it took from frame to verdict.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn add(&mut self, verdict: &Verdict, latency: Duration) -> Result<(), JournalError> {
        let line = Line::new(&self.taps, verdict.at, verdict, latency);
        let message = serde_json::to_value(line)
            .map(|line| without_nulls(line).to_string())
            .map_err(|error| self.failed(error.into()))?;
        let at = self.began_at.saturating_add(verdict.at);
        self.write(self.verdicts, at, message.as_bytes())
    }

    fn write(&mut self, channel_id: u16, at: Duration, data: &[u8]) -> Result<(), JournalError> {
        // 584 years since the epoch.
        let log_time = u64::try_from(at.as_nanos()).unwrap_or(u64::MAX);
        let header = MessageHeader {
            channel_id,
            sequence: self.messages,
            log_time,
            publish_time: log_time,
        };
        self.messages = self.messages.wrapping_add(1);
        let written = self.writer.write_to_known_channel(&header, data);
        written.map_err(|error| self.failed(io_error(error)))
    }

    /// Puts the file in place.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(mut self) -> Result<(), JournalError> {
        let finished = self.writer.finish().map_err(io_error);
        finished.map_err(|error| self.failed(error))?;
        let placed = self.writer.into_inner().into_inner().finish();
        placed.map_err(|error| JournalError {
            path: self.path,
            error,
        })
    }

    fn failed(&self, error: io::Error) -> JournalError {
        JournalError {
            path: self.path.clone(),
            error,
        }
    }
}

fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

/// The schema of verdicts, with the names of the taps and causes, because viewers offer what a schema names.
fn verdict_schema(taps: &[String]) -> io::Result<Vec<u8>> {
    let mut schema: Value = serde_json::from_str(VERDICT_SCHEMA)?;
    for object in PER_TAP {
        for tap in taps {
            schema["properties"][object]["properties"][tap] =
                serde_json::json!({ "type": "number" });
        }
    }
    schema["properties"]["cause"]["enum"] = Cause::ALL.map(Cause::name).as_slice().into();
    Ok(serde_json::to_vec(&schema)?)
}

/// A missing number is left out, because the types of viewers have no "number or null".
fn without_nulls(value: Value) -> Value {
    match value {
        Value::Object(fields) => fields
            .into_iter()
            .filter(|(_, value)| !value.is_null())
            .map(|(key, value)| (key, without_nulls(value)))
            .collect(),
        other => other,
    }
}

fn texts(about: &About) -> io::Result<BTreeMap<String, String>> {
    let Value::Object(fields) = serde_json::to_value(about)? else {
        return Ok(BTreeMap::new());
    };
    let text = |value: Value| match value {
        Value::String(text) => text,
        other => other.to_string(),
    };
    Ok(fields
        .into_iter()
        .map(|(key, value)| (key, text(value)))
        .collect())
}
