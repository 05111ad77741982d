//! What `ffprobe` says about a file: which of its streams is the video, and whether it has times.

use std::cmp::Reverse;
use std::ffi::OsStr;
use std::process::{Command, Stdio};

use serde::Deserialize;

/// Only local files are opened, whatever a playlist says.
pub const PROTOCOLS: [&str; 2] = ["-protocol_whitelist", "file,pipe"];
/// Rate of a stream that gives none; `ffmpeg` assumes the same.
const RATE_ASSUMED: f64 = 25.0;
/// From this version of libavcodec on (ffmpeg 5.1), `-fps_mode` is the name of what was `-vsync`.
const FPS_MODE_SINCE: (u32, u32) = (59, 37);
/// Formats without times: one coded picture after the other.
const RAW: [&str; 19] = [
    "av1",
    "avs2",
    "avs3",
    "cavsvideo",
    "dirac",
    "dnxhd",
    "evc",
    "h261",
    "h263",
    "h264",
    "hevc",
    "ingenient",
    "m4v",
    "mjpeg",
    "mjpeg_2000",
    "mpegvideo",
    "obu",
    "vc1",
    "vvc",
];

/// The stream that is read.
#[derive(Debug, PartialEq)]
pub struct Found {
    /// Number of the stream in the file.
    pub index: u32,
    /// Pixels, before rotation.
    pub width: u32,
    /// Pixels, before rotation.
    pub height: u32,
    /// Frames a second as the file states it, or 25.
    pub rate: f64,
    pub timing: Timing,
    /// Number of other streams with video.
    pub others: usize,
    /// The option with which this version of `ffmpeg` neither repeats nor drops frames.
    pub keep_every_frame: [&'static str; 2],
}

/// Where the times of frames come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Timing {
    /// The file gives a time to each frame.
    OfTheFile,
    /// The file is a raw stream, and gives none.
    Raw,
}

#[derive(Deserialize)]
struct Answer {
    #[serde(default)]
    streams: Vec<Stream>,
    #[serde(default)]
    format: Format,
    #[serde(default)]
    library_versions: Vec<Library>,
}

#[derive(Deserialize, Default)]
struct Format {
    #[serde(default)]
    format_name: String,
}

#[derive(Deserialize)]
struct Library {
    name: String,
    major: u32,
    minor: u32,
}

#[derive(Deserialize)]
struct Stream {
    index: u32,
    #[serde(default)]
    width: u32,
    #[serde(default)]
    height: u32,
    #[serde(default)]
    avg_frame_rate: String,
    #[serde(default)]
    r_frame_rate: String,
    #[serde(default)]
    disposition: Disposition,
}

#[derive(Deserialize, Default)]
struct Disposition {
    #[serde(default)]
    default: u32,
}

/// What is said when a program is not installed.
pub fn missing(program: &str, error: &std::io::Error) -> String {
    format!(
        "not an image, and cannot run {program} to read it as a video ({error}); install ffmpeg"
    )
}

/// Asks `ffprobe` about a file.
pub fn probe(input: &OsStr) -> Result<Found, String> {
    let answer = Command::new("ffprobe")
        .args(PROTOCOLS)
        // V: no cover pictures and thumbnails.
        .args(["-v", "error", "-select_streams", "V"])
        .args([
            "-show_entries",
            "stream=index,width,height,avg_frame_rate,r_frame_rate:stream_disposition=default:\
             format=format_name:library_version=name,major,minor",
            "-of",
            "json",
        ])
        .arg(input)
        .stdin(Stdio::null())
        .output()
        .map_err(|error| missing("ffprobe", &error))?;
    found(&answer.stdout).ok_or_else(|| {
        let said = String::from_utf8_lossy(&answer.stderr);
        let why = said.lines().next().map(|line| format!(" ({line})"));
        format!(
            "no picture or video in this file{}",
            why.unwrap_or_default()
        )
    })
}

/// The stream that a player shows: the one marked as default, then the largest, then the first.
fn found(answer: &[u8]) -> Option<Found> {
    let answer: Answer = serde_json::from_slice(answer).ok()?;
    let has_size = |stream: &&Stream| stream.width > 0 && stream.height > 0;
    let streams: Vec<&Stream> = answer.streams.iter().filter(has_size).collect();
    let stream = streams.iter().max_by_key(|stream| {
        let pixels = u64::from(stream.width) * u64::from(stream.height);
        (stream.disposition.default, pixels, Reverse(stream.index))
    })?;
    let stated = [&stream.avg_frame_rate, &stream.r_frame_rate];
    let is_raw = RAW.contains(&answer.format.format_name.as_str());
    let mut libraries = answer.library_versions.iter();
    let codecs = libraries.find(|library| library.name == "libavcodec");
    let is_new = codecs.is_some_and(|codecs| (codecs.major, codecs.minor) >= FPS_MODE_SINCE);
    Some(Found {
        index: stream.index,
        width: stream.width,
        height: stream.height,
        rate: stated
            .iter()
            .find_map(|text| rate(text))
            .unwrap_or(RATE_ASSUMED),
        timing: if is_raw {
            Timing::Raw
        } else {
            Timing::OfTheFile
        },
        others: streams.len() - 1,
        keep_every_frame: [if is_new { "-fps_mode" } else { "-vsync" }, "passthrough"],
    })
}

/// Reads a rate such as `30000/1001`.
fn rate(text: &str) -> Option<f64> {
    let (count, seconds) = text.split_once('/')?;
    let fps = count.parse::<f64>().ok()? / seconds.parse::<f64>().ok()?;
    (0.1..=1_000.0).contains(&fps).then_some(fps)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;
    use serde_json::json;

    fn stream(index: u32, width: u32, default: u32) -> serde_json::Value {
        json!({ "index": index, "width": width, "height": 10, "avg_frame_rate": "10/1", "r_frame_rate": "20/1",
            "disposition": { "default": default } })
    }

    fn of(streams: &[serde_json::Value], format: &str) -> Option<Found> {
        let answer = json!({ "streams": streams, "format": { "format_name": format },
            "library_versions": [{ "name": "libavutil", "major": 99, "minor": 0 }, { "name": "libavcodec", "major": 59, "minor": 18 }] });
        found(answer.to_string().as_bytes())
    }

    #[test]
    fn the_default_stream_is_taken_then_the_largest_then_the_first() {
        for (streams, index) in [
            (vec![stream(0, 20, 0), stream(1, 10, 1)], 1),
            (vec![stream(0, 20, 1), stream(1, 40, 1)], 1),
            (vec![stream(3, 20, 0), stream(4, 20, 0)], 3),
            (vec![stream(0, 0, 1), stream(2, 20, 0)], 2),
        ] {
            let found = of(&streams, "mov").unwrap();
            assert_eq!(found.index, index);
            assert_eq!((found.rate, found.timing), (10.0, Timing::OfTheFile));
            assert_eq!(found.keep_every_frame[0], "-vsync");
        }
        assert_eq!(of(&[], "mov"), None);
        assert_eq!(of(&[stream(0, 0, 0)], "mov"), None);
        assert_eq!(found(b"{"), None);
    }

    #[test]
    fn raw_streams_are_known_by_their_format() {
        let mut without = stream(0, 20, 0);
        without["avg_frame_rate"] = json!("0/0");
        for (format, timing) in [
            ("mjpeg", Timing::Raw),
            ("h264", Timing::Raw),
            ("apng", Timing::OfTheFile),
            ("mov,mp4,m4a,3gp,3g2,mj2", Timing::OfTheFile),
        ] {
            let found = of(&[without.clone()], format).unwrap();
            assert_eq!((found.timing, found.rate), (timing, 20.0), "{format}");
        }
    }

    #[test]
    fn rates_are_fractions() {
        assert_eq!(rate("25/1"), Some(25.0));
        assert!(rate("30000/1001").is_some_and(|fps| (fps - 29.97).abs() < 0.01));
        assert_eq!(rate("0/0"), None);
    }
}
