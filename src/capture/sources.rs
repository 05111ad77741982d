//! Names → sources: opens what a user types.

use std::sync::{Arc, OnceLock};

#[cfg(feature = "camera")]
use super::camera;
use super::frame::{FrameSource, SourceError};
use super::names::{FileName, SOURCES_WANTED, file_name};
use super::period::WantedPeriod;
#[cfg(feature = "lab")]
use super::recording;
use super::wish::{CameraFacts, CameraWish};
use super::{images, random, video};

/// The built-in drive: nominal up to 20 s, fog with 60 m visibility up to 40 s, nominal again up to 60 s.
pub const BUILT_IN_DRIVE: &str = "scene:sim?seed=7&seconds=60&fps=10&condition=fog:4@20-40";

/// Opens a rendered drive from the text after `scene:`.
type OpenScene = fn(&str) -> Result<Box<dyn FrameSource>, SourceError>;

static SCENES: OnceLock<OpenScene> = OnceLock::new();

/// Registers the function with which [`open`] opens `scene:…`. Only the first registration counts.
pub fn register_scenes(open: OpenScene) {
    let _ = SCENES.set(open);
}

/// Renders conditions over the pictures of a source, from the options after its name.
type LayOver = fn(Box<dyn FrameSource>, &[&str]) -> Result<Box<dyn FrameSource>, SourceError>;

static OVERLAY: OnceLock<LayOver> = OnceLock::new();

/// Registers the function with which [`open`] renders conditions over pictures. Only the first registration counts.
pub fn register_overlay(lay_over: LayOver) {
    let _ = OVERLAY.set(lay_over);
}

/// Opens what a board names as its camera: `v4l2:/dev/videoN`, which is asked for `wish` and returns at most one frame
/// every `period`, or any other source.
///
/// # Errors
/// When there is no such camera, or like [`open`].
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

/// Asks the camera `v4l2:/dev/videoN` about itself, without taking frames; `None` for any other source.
///
/// # Errors
/// When there is no such camera, or when this build has no cameras.
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
    let missing = "this build has no camera source (build with --features camera)";
    wrong_name(name, &format!("{missing}; {SOURCES_WANTED}"))
}

fn wrong_name(found: &str, wanted: &str) -> SourceError {
    SourceError::Name {
        found: found.to_owned(),
        wanted: wanted.to_owned(),
    }
}

/// Opens a source by the name a user types: `scene:…`, `random:…`, a folder, an image, a recording or a video file.
///
/// # Errors
/// When the name is not understood, or nothing readable is there.
pub fn open(name: &str) -> Result<Box<dyn FrameSource>, SourceError> {
    if let Some(spec) = name.strip_prefix("scene:") {
        let Some(open) = SCENES.get() else {
            let missing = "this build has no rendered drives (build with --features lab)";
            return Err(wrong_name(name, &format!("{missing}; {SOURCES_WANTED}")));
        };
        return open(spec);
    }
    if let Some(spec) = name.strip_prefix("random:") {
        return Ok(Box::new(random::RandomSource::parse(name, spec)?));
    }
    let file = file_name(name)?;
    let source = open_file(name, &file)?;
    if file.overlay.is_empty() {
        return Ok(source);
    }
    let Some(lay_over) = OVERLAY.get() else {
        let missing = "this build renders no conditions (build with --features lab)";
        return Err(wrong_name(name, missing));
    };
    lay_over(source, &file.overlay)
}

/// Options that do not fit.
#[cfg(feature = "lab")]
const OF_RECORDING: &str =
    "?fps= is for folders of images and raw video streams; a recording has its own times";
const OF_TOPIC: &str = "?topic= is for MCAP recordings";

fn open_file(name: &str, file: &FileName<'_>) -> Result<Box<dyn FrameSource>, SourceError> {
    let &FileName {
        path, fps, topic, ..
    } = file;
    let wrong = |wanted: &str| Err(wrong_name(name, wanted));
    if path.is_dir() {
        return open_folder(name, file);
    }
    if !path.exists() {
        return Err(SourceError::Missing(path.to_owned()));
    }
    #[cfg(not(feature = "lab"))]
    if path.file_name().is_some_and(|name| {
        name.to_string_lossy()
            .to_ascii_lowercase()
            .contains(".mcap")
    }) {
        return wrong("this build reads no MCAP recordings (build with --features lab)");
    }
    #[cfg(feature = "lab")]
    if path.is_file() && recording::is_recording(path) {
        if fps.is_some() {
            return wrong(OF_RECORDING);
        }
        return Ok(Box::new(recording::RecordingSource::open(path, topic)?));
    }
    if topic.is_some() {
        return wrong(OF_TOPIC);
    }
    if images::is_image(path) {
        if fps.is_some() {
            return wrong(
                "?fps= is for folders of images and raw video streams; a single image has no rate",
            );
        }
        return Ok(Box::new(images::ImageSource::single(path)));
    }
    Ok(Box::new(video::VideoSource::open(path, fps)?))
}

/// Opens a folder of images or, if there are none in it, the recording whose parts are in it.
fn open_folder(name: &str, file: &FileName<'_>) -> Result<Box<dyn FrameSource>, SourceError> {
    let &FileName {
        path, fps, topic, ..
    } = file;
    let wrong = |wanted: &str| Err(wrong_name(name, wanted));
    let images = images::ImageSource::folder(path, fps.unwrap_or(images::FOLDER_FPS));
    #[cfg(feature = "lab")]
    if topic.is_some() || matches!(images, Err(SourceError::Empty { .. })) {
        let parts = recording::parts(path)?;
        if !parts.is_empty() && fps.is_some() {
            return wrong(OF_RECORDING);
        }
        if !parts.is_empty() {
            let source = recording::RecordingSource::of_parts(path, &parts, topic)?;
            return Ok(Box::new(source));
        }
    }
    if topic.is_some() {
        return wrong(OF_TOPIC);
    }
    Ok(Box::new(images?))
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
}
