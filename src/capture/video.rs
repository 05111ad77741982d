//! Video files through the `ffmpeg` program: raw RGB frames over a pipe.

use std::ffi::OsString;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};

use serde::Deserialize;

use super::pixels::Pixels;
use super::{Frame, FrameSource, PIXELS_MAX, Picture, SourceError, time_of};

/// Only local files are opened, whatever a playlist says.
const PROTOCOLS: [&str; 2] = ["-protocol_whitelist", "file,pipe"];

#[derive(Deserialize)]
struct Probe {
    #[serde(default)]
    streams: Vec<Stream>,
}

#[derive(Deserialize)]
struct Stream {
    width: u32,
    height: u32,
    avg_frame_rate: String,
}

pub struct VideoSource {
    path: PathBuf,
    ffmpeg: Child,
    frames: BufReader<ChildStdout>,
    /// A file and not a pipe, so that `ffmpeg` never waits until its messages are read.
    complaints: File,
    size: (u32, u32),
    fps: f64,
    next: u64,
}

impl VideoSource {
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        let fail = |why: String| SourceError::Video {
            path: path.to_owned(),
            why,
        };
        let missing = |program: &str, error: &std::io::Error| {
            fail(format!(
                "not an image, and cannot run {program} to read it as a video ({error}); install ffmpeg"
            ))
        };
        let mut input = OsString::from("file:");
        input.push(path);
        let probe = Command::new("ffprobe")
            .args(PROTOCOLS)
            .args(["-v", "error", "-select_streams", "v:0"])
            .args([
                "-show_entries",
                "stream=width,height,avg_frame_rate",
                "-of",
                "json",
            ])
            .arg(&input)
            .stdin(Stdio::null())
            .output()
            .map_err(|error| missing("ffprobe", &error))?;
        let found = serde_json::from_slice::<Probe>(&probe.stdout)
            .ok()
            .and_then(|probe| probe.streams.into_iter().next());
        let Some(stream) = found.filter(|s| s.width > 0 && s.height > 0) else {
            return Err(fail(format!(
                "no picture or video in this file ({})",
                first_line(&probe.stderr)
            )));
        };
        let pixels = u64::from(stream.width) * u64::from(stream.height);
        if pixels > PIXELS_MAX {
            return Err(fail(format!(
                "{pixels} pixels a frame, more than {PIXELS_MAX}"
            )));
        }
        let fps = rate(&stream.avg_frame_rate)
            .ok_or_else(|| fail("no frame rate in this file".to_owned()))?;
        let unreadable = |error| SourceError::Unreadable {
            path: path.to_owned(),
            error,
        };
        let complaints = tempfile::tempfile().map_err(unreadable)?;
        let mut ffmpeg = Command::new("ffmpeg")
            .args(PROTOCOLS)
            .args(["-nostdin", "-v", "error", "-noautorotate", "-i"])
            .arg(&input)
            // Makes the rate constant: frame n is at the time n / rate.
            .args([
                "-map",
                "0:v:0",
                "-vf",
                &format!("fps={}", stream.avg_frame_rate),
            ])
            .args([
                "-sws_flags",
                "bicubic+accurate_rnd+full_chroma_int",
                "-f",
                "rawvideo",
                "-pix_fmt",
                "rgb24",
                "-",
            ])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(complaints.try_clone().map_err(unreadable)?)
            .spawn()
            .map_err(|error| missing("ffmpeg", &error))?;
        let Some(frames) = ffmpeg.stdout.take() else {
            return Err(fail("there is no pipe from ffmpeg".to_owned()));
        };
        Ok(Self {
            path: path.to_owned(),
            ffmpeg,
            frames: BufReader::new(frames),
            complaints,
            size: (stream.width, stream.height),
            fps,
            next: 0,
        })
    }

    /// The end of the pipe: a regular end, or the error message of `ffmpeg`.
    fn finish(&mut self, left_over: usize) -> Result<Option<Frame>, SourceError> {
        let mut said = Vec::new();
        let ended_well = self.ffmpeg.wait().is_ok_and(|status| status.success());
        let _ = self
            .complaints
            .rewind()
            .and_then(|()| self.complaints.read_to_end(&mut said));
        if ended_well && left_over == 0 && self.next > 0 {
            if !said.is_empty() {
                log::warn!("{}: {}", self.path.display(), first_line(&said));
            }
            return Ok(None);
        }
        let why = format!(
            "broke off after {} frames ({})",
            self.next,
            first_line(&said)
        );
        Err(SourceError::Video {
            path: self.path.clone(),
            why,
        })
    }
}

impl FrameSource for VideoSource {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let (width, height) = self.size;
        let mut rgb = vec![0; width as usize * height as usize * 3];
        let mut filled = 0;
        while filled < rgb.len() {
            match self.frames.read(&mut rgb[filled..]) {
                Ok(0) => return self.finish(filled),
                Ok(read) => filled += read,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => {
                    return Err(SourceError::Unreadable {
                        path: self.path.clone(),
                        error,
                    });
                }
            }
        }
        let (sequence, captured_at) = (self.next, time_of(self.next, self.fps));
        self.next += 1;
        Ok(Some(Frame {
            sequence,
            captured_at,
            picture: Ok(Pixels::from(Picture { width, height, rgb })),
        }))
    }

    fn frame_count(&self) -> Option<u64> {
        None
    }
}

impl Drop for VideoSource {
    fn drop(&mut self) {
        let _ = self.ffmpeg.kill();
        let _ = self.ffmpeg.wait();
    }
}

/// Reads a rate such as `30000/1001`.
fn rate(text: &str) -> Option<f64> {
    let (count, seconds) = text.split_once('/')?;
    let fps = count.parse::<f64>().ok()? / seconds.parse::<f64>().ok()?;
    (0.1..=1_000.0).contains(&fps).then_some(fps)
}

fn first_line(said: &[u8]) -> String {
    let text = String::from_utf8_lossy(said);
    text.lines()
        .next()
        .map_or_else(|| "ffmpeg said nothing".to_owned(), str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_fractions() {
        assert_eq!(rate("25/1"), Some(25.0));
        assert!(rate("30000/1001").is_some_and(|fps| (fps - 29.97).abs() < 0.01));
        assert_eq!(rate("0/0"), None);
    }
}
