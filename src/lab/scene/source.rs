//! A rendered drive as a frame source.

use super::{Drive, DriveSpec, Renderer};
use crate::capture::pixels::Pixels;
use crate::capture::{Frame, FrameSource, Picture, SourceError, time_of};

/// Opens a rendered drive from the text after `scene:`.
///
/// # Errors
/// When the text is not understood.
pub fn open(spec: &str) -> Result<Box<dyn FrameSource>, SourceError> {
    let spec: DriveSpec = spec
        .parse()
        .map_err(|error: super::SpecError| SourceError::Scene(error.to_string()))?;
    Ok(Box::new(DriveSource::new(&spec)))
}

pub struct DriveSource {
    drive: Drive,
    renderer: Renderer,
    size_px: (u32, u32),
    fps: f64,
    next: u64,
    count: u64,
}

impl DriveSource {
    pub fn new(spec: &DriveSpec) -> Self {
        Self {
            drive: Drive::new(&spec.world, spec.seed, &spec.conditions),
            renderer: Renderer::new(spec.size_px.0, spec.size_px.1),
            size_px: spec.size_px,
            fps: spec.fps,
            next: 0,
            count: spec.frames(),
        }
    }
}

impl FrameSource for DriveSource {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        if self.next == self.count {
            return Ok(None);
        }
        let (sequence, captured_at) = (self.next, time_of(self.next, self.fps));
        self.next += 1;
        let rgb = self
            .renderer
            .render(&self.drive, captured_at.as_secs_f64())
            .rgb
            .to_vec();
        Ok(Some(Frame {
            sequence,
            captured_at,
            picture: Ok(Pixels::from(Picture {
                width: self.size_px.0,
                height: self.size_px.1,
                rgb,
            })),
        }))
    }

    fn frame_count(&self) -> Option<u64> {
        Some(self.count)
    }
}
