//! V4L2 cameras.
//!
//! Owns the device: it is opened at the start or refused, and opened again whenever it stalls, fails or is plugged out and
//! in. Refuses to end: a camera that is gone gives no frame, and the silence is the monitor's to report. The format that the
//! driver grants counts, not the one asked for.

use std::io;
use std::mem;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

use v4l::buffer::{Flags, Type};
use v4l::device::Handle;
use v4l::io::traits::{CaptureStream, Stream as _};
use v4l::prelude::MmapStream;
use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Device, Format, FourCC, Fraction};

use super::pixels::{Layout, PixelFormat};
use super::{Frame, FrameSource, PictureError, SourceError};
use crate::board::{CAMERA_FORMATS, CameraWish};

/// Buffers of the driver: one being filled, one waiting, one being read, one to spare.
const BUFFERS: u32 = 4;
/// A camera that gives nothing for this long is opened again.
const STALL: Duration = Duration::from_secs(2);
/// First and longest pause between two attempts to open a camera again.
const BACK_OFF: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(2));
/// `POLLIN` of `poll(2)`.
const POLLIN: i16 = 1;
/// What is asked for, in this order, unless the board says otherwise.
const PREFERRED: [&str; 5] = CAMERA_FORMATS;

/// A camera.
pub struct CameraSource {
    device: String,
    wish: CameraWish,
    open: Option<OpenCamera>,
    back_off: Duration,
    sequence: u64,
    /// The driver's number of the last frame, since the camera was opened.
    last: Option<u32>,
    counts: Counts,
    began: Instant,
}

/// What went wrong since the start.
#[derive(Debug, Default)]
struct Counts {
    /// Buffers that the driver flagged as damaged.
    damaged: u64,
    /// Frames that the driver's numbers say are missing.
    lost: u64,
    /// Frames whose number did not move or went back.
    repeated: u64,
    reopened: u64,
}

struct OpenCamera {
    /// Empty only while it is closed.
    stream: Option<MmapStream<'static>>,
    handle: Arc<Handle>,
    layout: Layout,
    started: bool,
}

impl Drop for OpenCamera {
    /// The stream of `v4l` panics when it cannot be stopped, and again when its buffers cannot be given back. So it is
    /// stopped here first; one that cannot be is left open.
    fn drop(&mut self) {
        let Some(mut stream) = self.stream.take() else {
            return;
        };
        const ENODEV: i32 = 19;
        match stream.stop() {
            Err(error) if error.raw_os_error() != Some(ENODEV) => {
                log::error!("a camera cannot be stopped and is left open: {error}");
                mem::forget(stream);
            }
            _ => {
                if catch_unwind(AssertUnwindSafe(move || drop(stream))).is_err() {
                    log::error!("a camera's buffers could not be given back");
                }
            }
        }
    }
}

impl CameraSource {
    /// Opens `device`, asking for `wish`.
    ///
    /// # Errors
    /// When there is no such camera, or none of the formats that are understood is granted.
    pub fn open(device: &str, wish: &CameraWish) -> Result<Self, SourceError> {
        let open = open(device, wish).map_err(|why| SourceError::Camera {
            device: device.to_owned(),
            why,
        })?;
        log::info!("{device}: {:?}", open.layout);
        Ok(Self {
            device: device.to_owned(),
            wish: wish.clone(),
            open: Some(open),
            back_off: BACK_OFF.0,
            sequence: 0,
            last: None,
            counts: Counts::default(),
            began: Instant::now(),
        })
    }

    /// The open camera; opened again if it must be, at most once a back-off.
    fn opened(&mut self) -> Option<&mut OpenCamera> {
        if self.open.is_none() {
            std::thread::sleep(self.back_off);
            self.back_off = (2 * self.back_off).min(BACK_OFF.1);
            match open(&self.device, &self.wish) {
                Ok(open) => {
                    self.counts.reopened += 1;
                    log::warn!("{}: open again; {:?}", self.device, self.counts);
                    self.open = Some(open);
                    self.last = None;
                }
                Err(why) => log::debug!("{}: {why}", self.device),
            }
        }
        self.open.as_mut()
    }

    /// How far the frame of this number is from the one before.
    fn step(&mut self, number: u32) -> u64 {
        let Some(last) = self.last.replace(number) else {
            return 1;
        };
        let step = number.wrapping_sub(last);
        if step == 0 || step > u32::MAX / 2 {
            self.counts.repeated += 1;
            return 1;
        }
        self.counts.lost += u64::from(step - 1);
        step.into()
    }
}

impl FrameSource for CameraSource {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        loop {
            let Some(open) = self.opened() else {
                continue;
            };
            let (picture, number) = match open.read() {
                Ok(Some(read)) => read,
                Ok(None) => {
                    self.counts.damaged += 1;
                    continue;
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => {
                    log::warn!("{}: {error}; {:?}", self.device, self.counts);
                    self.open = None;
                    continue;
                }
            };
            self.back_off = BACK_OFF.0;
            self.sequence += self.step(number);
            return Ok(Some(Frame {
                sequence: self.sequence,
                captured_at: self.began.elapsed(),
                picture: picture.map_err(|found| PictureError {
                    path: self.device.clone().into(),
                    found,
                    wanted: "a whole frame of the granted format",
                }),
            }));
        }
    }

    fn frame_count(&self) -> Option<u64> {
        None
    }

    fn is_live(&self) -> bool {
        true
    }
}

type Read = (Result<super::Picture, String>, u32);

impl OpenCamera {
    /// The next picture with the driver's number of it; `None` for a damaged one.
    fn read(&mut self) -> io::Result<Option<Read>> {
        let stream = self.stream.as_mut().ok_or(io::ErrorKind::NotConnected)?;
        // The first call starts the stream and waits itself. Later a time-out inside it would queue a buffer twice.
        if self.started && self.handle.poll(POLLIN, milliseconds(STALL))? == 0 {
            return Err(io::ErrorKind::TimedOut.into());
        }
        let (buffer, meta) = CaptureStream::next(stream)?;
        self.started = true;
        if meta.flags.contains(Flags::ERROR) {
            return Ok(None);
        }
        let used = usize::try_from(meta.bytesused).unwrap_or(usize::MAX);
        let bytes = &buffer[..used.min(buffer.len())];
        Ok(Some((self.layout.picture(bytes), meta.sequence)))
    }
}

fn milliseconds(time: Duration) -> i32 {
    i32::try_from(time.as_millis()).unwrap_or(i32::MAX)
}

fn open(name: &str, wish: &CameraWish) -> Result<OpenCamera, String> {
    let device = Device::with_path(name).map_err(|error| error.to_string())?;
    let granted = negotiate(&device, wish)?;
    let format = PixelFormat::from_fourcc(granted.fourcc.repr).ok_or_else(|| {
        format!(
            "the camera grants {} only; wanted one of {}",
            granted.fourcc,
            CAMERA_FORMATS.join(", ")
        )
    })?;
    if let Some(fps) = wish.fps {
        let interval = Fraction::new(1_000, milli(fps));
        // A wish, as the size: some cameras have one rate only.
        if let Err(error) = device.set_params(&Parameters::new(interval)) {
            log::warn!("{name}: the rate stays as it is: {error}");
        }
    }
    let mut stream = MmapStream::with_buffers(&device, Type::VideoCapture, BUFFERS)
        .map_err(|error| format!("no buffers for streaming: {error}"))?;
    stream.set_timeout(STALL);
    Ok(OpenCamera {
        handle: stream.handle(),
        stream: Some(stream),
        layout: Layout {
            format,
            width: granted.width,
            height: granted.height,
            stride: granted.stride,
        },
        started: false,
    })
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn milli(fps: f64) -> u32 {
    (1_000.0 * fps).round().max(1.0) as u32
}

/// Asks for the wished format, or for one after the other, and gives what is granted in the end.
fn negotiate(device: &Device, wish: &CameraWish) -> Result<Format, String> {
    let now = device
        .format()
        .map_err(|error| format!("no camera for video frames: {error}"))?;
    let (width, height) = wish.size.unwrap_or((now.width, now.height));
    let asked: Vec<&str> = match &wish.format {
        Some(format) => vec![format.as_str()],
        None => PREFERRED.to_vec(),
    };
    let mut granted = now;
    for name in asked {
        let Ok(fourcc) = <[u8; 4]>::try_from(name.as_bytes()) else {
            continue;
        };
        granted = device
            .set_format(&Format::new(width, height, FourCC::new(&fourcc)))
            .map_err(|error| format!("{name} of {width}x{height} is refused: {error}"))?;
        if granted.fourcc.repr == fourcc {
            break;
        }
    }
    Ok(granted)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn what_is_no_camera_is_named_with_the_reason() {
        for device in ["/dev/video-of-nobody", "/dev/null"] {
            let error = CameraSource::open(device, &CameraWish::default());
            let said = error.err().unwrap().to_string();
            assert!(said.starts_with(device), "{said}");
        }
    }
}
