//! A frame, and the trait of what gives frames.

use std::path::PathBuf;
use std::time::Duration;

use super::picture::PictureError;
use super::pixels::Pixels;
use super::undefined::Undefined;

/// A picture with its time, or why there is none.
#[derive(Debug)]
pub struct Frame {
    /// Number of the frame in its source, from 0.
    pub sequence: u64,
    /// Time since the source began.
    pub captured_at: Duration,
    /// The picture, or what was wrong with it.
    pub picture: Result<Pixels, PictureError>,
}

impl Frame {
    /// The picture.
    ///
    /// # Errors
    /// `Corrupt` when there is none.
    pub fn pixels(&self) -> Result<&Pixels, Undefined> {
        let pixels = self.picture.as_ref();
        pixels.map_err(|error| Undefined::Corrupt(error.to_string()))
    }
}

/// A source that cannot be opened or cannot continue.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// There is no file or folder of this name.
    #[error("{}: no such file or folder", .0.display())]
    Missing(PathBuf),
    /// A folder without images.
    #[error("{}: no PNG or JPEG image in this folder; {holds}", path.display())]
    Empty {
        /// The folder.
        path: PathBuf,
        /// What is in it instead.
        holds: String,
    },
    /// A file or folder that cannot be read.
    #[error("{}: {error}", path.display())]
    Unreadable {
        /// The file, folder or device.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// A name that is not understood.
    #[error("source {found:?}: {wanted}")]
    Name {
        /// The name as typed.
        found: String,
        /// What was wanted.
        wanted: String,
    },
    /// A rendered drive that is not understood: what was found and what was wanted.
    #[error("{0}")]
    Scene(String),
    /// A camera that cannot be opened.
    #[error("{device}: {why}")]
    Camera {
        /// The file, folder or device.
        device: String,
        /// What the system answered, or what is missing.
        why: String,
    },
    /// A recording that cannot be read.
    #[error("{}: {why}", path.display())]
    Recording {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it, or which of its topics to name.
        why: String,
    },
    /// A video that cannot be decoded.
    #[error("{}: {why}", path.display())]
    Video {
        /// Which file.
        path: PathBuf,
        /// What `ffmpeg` said, or that it is missing.
        why: String,
    },
}

/// Position of a frame in its source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Number of the frame.
    pub number: u64,
    /// When it was taken; `None` if that is not known.
    pub at: Option<Duration>,
}

impl Place {
    /// The rule of order: the number is larger than that of the frame `before`, and so is the time if both times are
    /// known.
    pub fn is_after(self, before: Self) -> bool {
        let times = before.at.zip(self.at);
        self.number > before.number && times.is_none_or(|(then, now)| now > then)
    }
}

/// Gives frames in the order of time.
pub trait FrameSource: Send {
    /// The next frame, or `None` at the end.
    ///
    /// # Errors
    /// When the source cannot continue. A single unreadable picture is not an error, but a [`Frame`] without a picture.
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError>;

    /// The number of frames, if it is known.
    fn frame_count(&self) -> Option<u64>;

    /// When the source began, since the epoch of its clock, if it has one; known after its first frame.
    fn began_at(&self) -> Option<Duration> {
        None
    }

    /// Whether frames come at their own pace, as from a camera.
    fn is_live(&self) -> bool {
        false
    }

    /// Age of the last frame of a live source when it was returned; zero if that is not known.
    fn waited(&self) -> Duration {
        Duration::ZERO
    }
}

/// The time of frame `sequence` at a steady rate.
pub fn time_of(sequence: u64, fps: f64) -> Duration {
    // Exact to the nanosecond for more than 50 days of 100 frames a second.
    #[allow(clippy::cast_precision_loss)]
    Duration::from_secs_f64(sequence as f64 / fps)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_after_another_by_number_and_time() {
        let place = |number, nanos: Option<u64>| Place {
            number,
            at: nanos.map(Duration::from_nanos),
        };
        for (number, nanos, after) in [
            (8, Some(101), true),
            (u64::MAX, Some(u64::MAX), true),
            (7, Some(101), false),
            (6, Some(101), false),
            (0, Some(101), false),
            (8, Some(100), false),
            (8, Some(99), false),
            (8, Some(0), false),
            (8, None, true),
            (7, None, false),
        ] {
            let found = place(number, nanos).is_after(place(7, Some(100)));
            assert_eq!(found, after, "{number} at {nanos:?}");
        }
        assert!(place(8, Some(0)).is_after(place(7, None)));
    }
}
