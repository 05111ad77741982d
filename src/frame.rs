//! Frames and where they come from: the entrance of the chain.
//!
//! Owns opening sources by name and reading pictures. A picture that cannot be read is not the end of a source: it
//! travels as a frame with its error, so that the monitor can say what it did not see.

#[cfg(feature = "camera")]
mod camera;
mod compressed;
mod drive;
mod images;
mod names;
pub mod newest;
pub mod pixels;
mod random;
mod recording;
mod video;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

pub use compressed::jpeg;
pub use names::{drives, ranges, sort_drives, stamp, template};

use crate::board::{CameraWish, camera_of};
use crate::rate::WantedPeriod;
use crate::scene::{DriveSpec, SpecError};
use pixels::Pixels;

/// Frames a second of a folder of images, unless its name says otherwise.
pub const FOLDER_FPS: f64 = 10.0;

/// Most pixels of a picture that is decoded; a larger one is refused before it costs memory. 8K video has 33 million.
const PIXELS_MAX: u64 = 34_000_000;

/// The built-in drive: nominal for 20 s, fog of 60 m visibility to 40 s, nominal again to 60 s.
pub const BUILT_IN_DRIVE: &str = "scene:sim?seed=7&seconds=60&fps=10&condition=fog:4@20-40";

/// An 8-bit RGB picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// `[height, width, 3]`, sRGB as the source gave it.
    pub rgb: Vec<u8>,
}

/// A picture with its place in time, or why there is none.
#[derive(Debug)]
pub struct Frame {
    /// Count of frames of the source, from 0.
    pub sequence: u64,
    /// Time since the source began.
    pub captured_at: Duration,
    /// The picture, or what was wrong with it.
    pub picture: Result<Pixels, PictureError>,
}

/// A picture that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {found}; wanted {wanted}", path.display())]
pub struct PictureError {
    path: PathBuf,
    found: String,
    wanted: &'static str,
}

/// A source that cannot be opened or goes on no more.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// Nothing of that name.
    #[error("{}: no such file or folder", .0.display())]
    Missing(PathBuf),
    /// A folder without images.
    #[error("{}: no PNG or JPEG image in this folder (those of a scene set are in its folder frames)", .0.display())]
    Empty(PathBuf),
    /// A file or folder that cannot be read.
    #[error("{}: {error}", path.display())]
    Unreadable {
        /// Which.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// A name that is not understood.
    #[error("source {found:?}: {wanted}")]
    Name {
        /// As typed.
        found: String,
        /// What would do.
        wanted: String,
    },
    /// A rendered drive that is not understood.
    #[error(transparent)]
    Scene(#[from] SpecError),
    /// A camera that cannot be opened.
    #[error("{device}: {why}")]
    Camera {
        /// Which.
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

/// Where a frame stands among the others of its source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Its number.
    pub number: u64,
    /// When it was taken; `None` where that is not known.
    pub at: Option<Duration>,
}

impl Place {
    /// The one rule of order: the number is larger than that of the frame `before`, and so is the time where both are known.
    pub fn is_after(self, before: Self) -> bool {
        let times = before.at.zip(self.at);
        self.number > before.number && times.is_none_or(|(then, now)| now > then)
    }
}

/// Gives frames in order of time.
pub trait FrameSource: Send {
    /// The next frame, or `None` at the end.
    ///
    /// # Errors
    /// When the source breaks off; a single unreadable picture is not an error but a [`Frame`] without picture.
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError>;

    /// How many frames there will be, when known.
    fn frame_count(&self) -> Option<u64>;

    /// When the source began, since the epoch of its clock, where it has one; known with its first frame.
    fn began_at(&self) -> Option<Duration> {
        None
    }

    /// Whether frames come at their own pace, as from a camera.
    fn is_live(&self) -> bool {
        false
    }

    /// How long ago the last frame of a live source was taken when it was given; zero where that is not known.
    fn waited(&self) -> Duration {
        Duration::ZERO
    }
}

/// Opens what a board names as its camera: `v4l2:/dev/videoN`, asked for what is wished, of which a frame every `period` is
/// given at most; or any other source.
///
/// # Errors
/// When there is no such camera, or as [`open`].
#[cfg_attr(not(feature = "camera"), expect(unused_variables))]
pub fn open_camera(
    name: &str,
    wish: &CameraWish,
    period: Arc<WantedPeriod>,
) -> Result<Box<dyn FrameSource>, SourceError> {
    match name.strip_prefix("v4l2:") {
        #[cfg(feature = "camera")]
        Some(device) => Ok(Box::new(camera::CameraSource::open(device, wish, period)?)),
        #[cfg(not(feature = "camera"))]
        Some(_) => Err(no_camera(name)),
        None => open(name),
    }
}

/// What a camera says of itself.
#[derive(Clone, Debug)]
pub struct CameraFacts {
    /// Its name and the driver's.
    pub name: String,
    /// What it is set to.
    pub set_to: String,
    /// Pixel formats that it offers, by the names of V4L2.
    pub formats: Vec<String>,
}

/// Asks the camera `v4l2:/dev/videoN` about itself, without taking frames; `None` of any other source.
///
/// # Errors
/// When there is no such camera, or this build has none.
pub fn camera_facts(name: &str) -> Result<Option<CameraFacts>, SourceError> {
    match name.strip_prefix("v4l2:") {
        #[cfg(feature = "camera")]
        Some(device) => camera::facts(device).map(Some),
        #[cfg(not(feature = "camera"))]
        Some(_) => Err(no_camera(name)),
        None => Ok(None),
    }
}

#[cfg(not(feature = "camera"))]
fn no_camera(name: &str) -> SourceError {
    SourceError::Name {
        found: name.to_owned(),
        wanted: "this build has no camera source (build with --features camera); wanted scene:…, random:…, a folder, an image, a recording or a video".to_owned(),
    }
}

/// Opens a source by the name a user types: `scene:…`, `random:…`, a folder, an image, a recording or a video file.
///
/// # Errors
/// When the name is not understood or nothing readable is behind it.
pub fn open(name: &str) -> Result<Box<dyn FrameSource>, SourceError> {
    if let Some(spec) = name.strip_prefix("scene:") {
        return Ok(Box::new(drive::DriveSource::new(
            &spec.parse::<DriveSpec>()?,
        )));
    }
    if let Some(spec) = name.strip_prefix("random:") {
        return Ok(Box::new(random::RandomSource::parse(name, spec)?));
    }
    let FileName { path, fps, topic } = file_name(name)?;
    if path.is_dir() && topic.is_none() {
        return Ok(Box::new(images::ImageSource::folder(
            path,
            fps.unwrap_or(FOLDER_FPS),
        )?));
    }
    if !path.exists() {
        return Err(SourceError::Missing(path.to_owned()));
    }
    let wrong = |wanted: &str| {
        Err(SourceError::Name {
            found: name.to_owned(),
            wanted: wanted.to_owned(),
        })
    };
    if fps.is_some() {
        return wrong(
            "?fps= is for folders of images; a video or recording has its own times, one image has none",
        );
    }
    if path.is_file() && recording::is_recording(path) {
        return Ok(Box::new(recording::RecordingSource::open(path, topic)?));
    }
    if topic.is_some() {
        return wrong("?topic= is for MCAP recordings");
    }
    if images::is_image(path) {
        return Ok(Box::new(images::ImageSource::single(path)));
    }
    Ok(Box::new(video::VideoSource::open(path)?))
}

/// The name of a file or folder with what may stand behind it.
struct FileName<'a> {
    path: &'a Path,
    fps: Option<f64>,
    topic: Option<&'a str>,
}

/// Splits `PATH?fps=N` or `PATH?topic=NAME`; a path that exists as typed is taken whole. Refuses what is no file: nothing,
/// and cameras.
fn file_name(name: &str) -> Result<FileName<'_>, SourceError> {
    let camera = camera_of(name).or_else(|| name.starts_with("v4l2:").then(|| name.to_owned()));
    let wanted = "wanted scene:…, random:…, a folder, an image, a recording or a video";
    if camera.is_some() || name.is_empty() {
        let watched = |camera| {
            format!(
                "a camera is watched by gapwatch monitor, with source = {camera:?} in [camera] of a board file; {wanted}"
            )
        };
        return Err(SourceError::Name {
            found: name.to_owned(),
            wanted: camera.map_or_else(|| wanted.to_owned(), watched),
        });
    }
    let (mut path, mut fps, mut topic) = (name, None, None);
    if !Path::new(name).exists() {
        if let Some((before, number)) = name.rsplit_once("?fps=") {
            let number = number
                .parse()
                .ok()
                .filter(|fps| (0.1..=240.0).contains(fps));
            fps = Some(number.ok_or_else(|| SourceError::Name {
                found: name.to_owned(),
                wanted: "wanted ?fps= from 0.1 to 240".to_owned(),
            })?);
            path = before;
        } else if let Some((before, wanted)) = name.split_once("?topic=") {
            topic = Some(wanted);
            path = before;
        }
    }
    Ok(FileName {
        path: Path::new(path),
        fps,
        topic,
    })
}

/// The time of frame `sequence` at a steady rate.
pub(crate) fn time_of(sequence: u64, fps: f64) -> Duration {
    // Exact to the nanosecond for more than 50 days of 100 frames a second.
    #[allow(clippy::cast_precision_loss)]
    Duration::from_secs_f64(sequence as f64 / fps)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn sources_that_cannot_be_opened_say_why() {
        for (name, part) in [
            ("no-such-folder", "no such file or folder"),
            ("", "wanted scene:"),
            (
                "v4l2:/dev/video0",
                "source = \"v4l2:/dev/video0\" in [camera]",
            ),
            ("/dev/video0", "source = \"v4l2:/dev/video0\" in [camera]"),
            ("random:frames=0", "frames=1..100000"),
            ("src?fps=0", "?fps="),
            ("src", "no PNG or JPEG image"),
        ] {
            let said = open(name).err().unwrap().to_string();
            assert!(said.contains(part), "{said}");
        }
    }

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
