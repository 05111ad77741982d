//! Video files through the `ffmpeg` program: every frame of the file once, upright, at its own time.
//!
//! It reads pictures from the standard output of `ffmpeg`, and their times from its messages. Memory holds one frame,
//! and what `ffmpeg` decodes ahead.

mod messages;
mod probe;
mod timeline;

use std::ffi::OsString;
use std::io::{BufReader, Read};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::time::Duration;

use super::pixels::Pixels;
use super::{Frame, FrameSource, PIXELS_MAX, Picture, SourceError, time_of};
use messages::Messages;
use probe::{PROTOCOLS, Timing, missing, probe};
use timeline::Timeline;

/// Reports every frame with its time in microseconds, in the same way in all versions since 4.2.
const REPORT_TIMES: &str = "settb=AVTB,showinfo=checksum=0";

pub struct VideoSource {
    path: PathBuf,
    ffmpeg: Child,
    frames: BufReader<ChildStdout>,
    messages: Messages,
    /// The rate of a file without times.
    fps: Option<f64>,
    timeline: Timeline,
    next: u64,
    ended: bool,
}

impl VideoSource {
    /// Opens a video; `fps` is the rate of a raw stream, which has no times.
    pub fn open(path: &Path, fps: Option<f64>) -> Result<Self, SourceError> {
        let fail = |why: String| SourceError::Video {
            path: path.to_owned(),
            why,
        };
        let mut input = OsString::from("file:");
        input.push(path);
        let found = probe(&input).map_err(fail)?;
        let pixels = u64::from(found.width) * u64::from(found.height);
        if pixels > PIXELS_MAX {
            return Err(fail(format!(
                "{pixels} pixels a frame, more than {PIXELS_MAX}"
            )));
        }
        if found.others > 0 {
            log::warn!(
                "{}: {} video streams; stream {} of {}x{} is read",
                path.display(),
                found.others + 1,
                found.index,
                found.width,
                found.height
            );
        }
        let fps = match (found.timing, fps) {
            (Timing::Raw, Some(fps)) => Some(fps),
            (Timing::Raw, None) => {
                log::warn!(
                    "{}: this stream has no times; it is read at {} frames a second, and ?fps= sets another rate",
                    path.display(),
                    found.rate
                );
                Some(found.rate)
            }
            (Timing::OfTheFile, None) => None,
            (Timing::OfTheFile, Some(_)) => {
                return Err(fail(
                    "?fps= is for raw streams and folders of images; this file has times of its own".to_owned(),
                ));
            }
        };
        let mut ffmpeg = Command::new("ffmpeg")
            .args(PROTOCOLS)
            .args(["-hide_banner", "-nostdin", "-nostats"])
            .args(["-v", "repeat+level+info", "-i"])
            .arg(&input)
            .args(["-map", &format!("0:{}", found.index)])
            .args(["-vf", REPORT_TIMES])
            .args(found.keep_every_frame)
            // Finer than any frame rate, so that no two frames fall on one time.
            .args(["-enc_time_base", "1:1000000"])
            .args([
                "-sws_flags",
                "bicubic+accurate_rnd+full_chroma_int",
                "-f",
                "image2pipe",
                "-c:v",
                "ppm",
                "-pix_fmt",
                "rgb24",
                "-",
            ])
            .env("AV_LOG_FORCE_NOCOLOR", "1")
            .env_remove("AV_LOG_FORCE_COLOR")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // A terminal sends Ctrl-C to its whole group; the frames that are on their way are still read.
            .process_group(0)
            .spawn()
            .map_err(|error| fail(missing("ffmpeg", &error)))?;
        let (Some(frames), Some(said)) = (ffmpeg.stdout.take(), ffmpeg.stderr.take()) else {
            return Err(fail("there is no pipe from ffmpeg".to_owned()));
        };
        Ok(Self {
            path: path.to_owned(),
            ffmpeg,
            frames: BufReader::with_capacity(1 << 16, frames),
            messages: Messages::of(said),
            fps,
            timeline: Timeline::new(found.rate),
            next: 0,
            ended: false,
        })
    }

    /// The end of the pipe: a regular end, or the error message of `ffmpeg`.
    fn finish(&mut self, whole: bool) -> Result<Option<Frame>, SourceError> {
        self.ended = true;
        let status = self.ffmpeg.wait();
        let (problems, first) = self.messages.problems();
        let ended_well = status.as_ref().is_ok_and(ExitStatus::success);
        let first = first.unwrap_or_else(|| match status {
            Ok(status) => format!("ffmpeg ended without a message, {status}"),
            Err(error) => error.to_string(),
        });
        if ended_well && whole && self.next > 0 {
            if problems > 0 {
                log::warn!(
                    "{}: {} frames were read; ffmpeg reported {problems} problems, first: {first}",
                    self.path.display(),
                    self.next
                );
            }
            return Ok(None);
        }
        Err(self.broke_off(&first))
    }

    fn broke_off(&self, why: &str) -> SourceError {
        SourceError::Video {
            path: self.path.clone(),
            why: format!("broke off after {} frames ({why})", self.next),
        }
    }

    /// The time of the next frame, from its time in the file in microseconds.
    fn place(&mut self, own: Option<i64>) -> Duration {
        let before = self.timeline.corrected();
        let at = self.timeline.place(own);
        if before == 0 && self.timeline.corrected() > 0 {
            log::warn!(
                "{}: the time of frame {} does not follow that of the frame before; such frames are placed behind it",
                self.path.display(),
                self.next
            );
        }
        at
    }

    /// Reads the header of a picture in PPM, `P6 WIDTH HEIGHT 255`; `None` at the end of the pipe.
    fn header(&mut self) -> std::io::Result<Option<(u32, u32)>> {
        let mut magic = [0; 3];
        match self.frames.read_exact(&mut magic) {
            Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => return Ok(None),
            read => read?,
        }
        let mut numbers = [0_u32; 3];
        for number in &mut numbers {
            let mut byte = [0];
            loop {
                self.frames.read_exact(&mut byte)?;
                if !byte[0].is_ascii_digit() {
                    break;
                }
                *number = number
                    .saturating_mul(10)
                    .saturating_add(u32::from(byte[0] - b'0'));
            }
        }
        let [width, height, white] = numbers;
        let pixels = u64::from(width) * u64::from(height);
        if magic != *b"P6\n" || white != 255 || pixels == 0 || pixels > PIXELS_MAX {
            return Err(std::io::Error::other("what ffmpeg wrote is not a picture"));
        }
        Ok(Some((width, height)))
    }

    fn picture(&mut self) -> std::io::Result<Option<Picture>> {
        let Some((width, height)) = self.header()? else {
            return Ok(None);
        };
        let mut rgb = vec![0; width as usize * height as usize * 3];
        self.frames.read_exact(&mut rgb)?;
        Ok(Some(Picture { width, height, rgb }))
    }
}

impl FrameSource for VideoSource {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        if self.ended {
            return Ok(None);
        }
        let picture = match self.picture() {
            Ok(Some(picture)) => picture,
            Ok(None) => return self.finish(true),
            Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
                return self.finish(false);
            }
            Err(error) => {
                self.ended = true;
                return Err(self.broke_off(&error.to_string()));
            }
        };
        let sequence = self.next;
        let Some(reported) = self.messages.next_time() else {
            self.ended = true;
            return Err(self.broke_off("ffmpeg did not report the time of a frame"));
        };
        let captured_at = match self.fps {
            Some(fps) => time_of(sequence, fps),
            None => self.place(reported),
        };
        self.next += 1;
        Ok(Some(Frame {
            sequence,
            captured_at,
            picture: Ok(Pixels::from(picture)),
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
