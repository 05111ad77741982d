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

use v4l::buffer::{Flags, Metadata, Type};
use v4l::device::Handle;
use v4l::io::traits::{CaptureStream, Stream as _};
use v4l::prelude::MmapStream;
use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Device, Format, FourCC, Fraction};

use super::pixels::{Layout, PixelFormat, Pixels};
use super::{CameraFacts, Frame, FrameSource, PictureError, SourceError};
use crate::board::{CAMERA_FORMATS, CameraWish};
use crate::rate::{Pace, WantedPeriod};

/// Buffers of the driver: one being filled, one waiting, one being read, one to spare.
const BUFFERS: u32 = 4;
/// A camera that gives nothing for this long is opened again.
const STALL: Duration = Duration::from_secs(2);
/// First and longest pause between two attempts to open a camera again.
const BACK_OFF: (Duration, Duration) = (Duration::from_millis(100), Duration::from_millis(500));
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
    /// Numbers and times of the driver, since the camera was opened.
    order: Order,
    /// How long the last frame had waited.
    waited: Duration,
    counts: Counts,
    began: Instant,
    /// Frames that nobody will judge are not copied.
    pace: Pace,
    period: Arc<WantedPeriod>,
}

/// What went wrong since the start.
#[derive(Debug, Default)]
struct Counts {
    /// Buffers that the driver flagged as damaged.
    damaged: u64,
    /// Frames that the driver's numbers say are missing.
    lost: u64,
    /// Frames whose number or time did not move or went back.
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
    /// Opens `device`, asking for `wish`, and gives a frame every `period` at most.
    ///
    /// # Errors
    /// When there is no such camera, or none of the formats that are understood is granted.
    pub fn open(
        device: &str,
        wish: &CameraWish,
        period: Arc<WantedPeriod>,
    ) -> Result<Self, SourceError> {
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
            order: Order::default(),
            waited: Duration::ZERO,
            counts: Counts::default(),
            began: Instant::now(),
            pace: Pace::default(),
            period,
        })
    }

    /// Tries to open the camera again, after a back-off.
    fn open_again(&mut self) {
        std::thread::sleep(self.back_off);
        self.back_off = (2 * self.back_off).min(BACK_OFF.1);
        match open(&self.device, &self.wish) {
            Ok(open) => {
                self.counts.reopened += 1;
                log::warn!("{}: open again; {:?}", self.device, self.counts);
                self.open = Some(open);
                self.order = Order::default();
            }
            Err(why) => log::debug!("{}: {why}", self.device),
        }
    }

    /// How far a frame is from the one before; 0 when it does not come after it.
    fn step(&mut self, stamp: &Stamp) -> u64 {
        let step = self.order.step(stamp);
        if step == 0 {
            self.counts.repeated += 1;
        }
        self.counts.lost += step.saturating_sub(1);
        step
    }
}

/// What the driver says of a frame.
#[derive(Clone, Copy, Debug)]
struct Stamp {
    number: u32,
    /// On the system's monotonic clock; `None` when the driver does not say.
    taken_at: Option<Duration>,
}

/// How frames follow each other.
#[derive(Debug, Default)]
struct Order {
    last: Option<Stamp>,
    /// Some drivers number nothing: all their frames are 0.
    numbered: bool,
    /// Nanoseconds by which the driver's clock was ahead of ours for the frame that came fastest, in this span and the one
    /// before: one wrong stamp is forgotten within two spans.
    ahead: [Option<i128>; 2],
    /// When this span began.
    since: Duration,
}

/// Length of a span over which the fastest frame is looked for.
const FASTEST_WITHIN: Duration = Duration::from_secs(5);

impl Order {
    fn step(&mut self, stamp: &Stamp) -> u64 {
        let Some(last) = self.last.replace(*stamp) else {
            return 1;
        };
        let step = stamp.number.wrapping_sub(last.number);
        self.numbered |= step != 0;
        let back = |(then, now): (Duration, Duration)| now <= then;
        if last.taken_at.zip(stamp.taken_at).is_some_and(back) || step > u32::MAX / 2 {
            return 0;
        }
        if self.numbered { step.into() } else { 1 }
    }

    /// How much longer this frame was on its way than the fastest one: the time that it waited for us. What even the fastest
    /// took cannot be known.
    fn waited(&mut self, stamp: &Stamp, now: Duration) -> Duration {
        let Some(taken_at) = stamp.taken_at else {
            return Duration::ZERO;
        };
        let nanos = |time: Duration| i128::try_from(time.as_nanos()).unwrap_or(i128::MAX);
        let ahead = nanos(taken_at) - nanos(now);
        if now.saturating_sub(self.since) >= FASTEST_WITHIN {
            self.ahead = [None, self.ahead[0]];
            self.since = now;
        }
        let own = *self.ahead[0].insert(self.ahead[0].unwrap_or(ahead).max(ahead));
        let most = own.max(self.ahead[1].unwrap_or(own));
        Duration::from_nanos(u64::try_from(most - ahead).unwrap_or(u64::MAX))
    }
}

impl FrameSource for CameraSource {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        loop {
            let Some(open) = self.open.as_mut() else {
                self.open_again();
                continue;
            };
            let (picture, stamp) =
                match open.read(|| self.pace.is_due(self.began.elapsed(), self.period.get())) {
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
            self.sequence += self.step(&stamp);
            let now = self.began.elapsed();
            self.waited = self.order.waited(&stamp, now);
            let Some(picture) = picture else {
                continue;
            };
            return Ok(Some(Frame {
                sequence: self.sequence,
                captured_at: now.saturating_sub(self.waited),
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

    fn waited(&self) -> Duration {
        self.waited
    }
}

/// A picture, if it is wanted, or what was wrong with it; and what the driver says of it.
type Read = (Option<Result<Pixels, String>>, Stamp);

impl OpenCamera {
    /// The next picture; `None` for a damaged one.
    fn read(&mut self, is_wanted: impl FnOnce() -> bool) -> io::Result<Option<Read>> {
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
        let stamp = Stamp {
            number: meta.sequence,
            taken_at: monotonic(meta),
        };
        let picture = is_wanted().then(|| self.layout.pixels(bytes));
        Ok(Some((picture, stamp)))
    }
}

/// The driver's time of a frame, if it is of the system's monotonic clock.
fn monotonic(meta: &Metadata) -> Option<Duration> {
    let clock = meta.flags & Flags::TIMESTAMP_MASK;
    let (sec, usec) = (meta.timestamp.sec, meta.timestamp.usec);
    let time = Duration::from_secs(u64::try_from(sec).ok()?)
        + Duration::from_micros(u64::try_from(usec).ok()?);
    (clock == Flags::TIMESTAMP_MONOTONIC).then_some(time)
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

/// What a camera says of itself.
pub fn facts(name: &str) -> Result<CameraFacts, SourceError> {
    let ask = || -> io::Result<CameraFacts> {
        let device = Device::with_path(name)?;
        let about = device.query_caps()?;
        let format = device.format()?;
        let offered = device.enum_formats()?.into_iter();
        Ok(CameraFacts {
            name: format!("{} ({})", about.card, about.driver),
            set_to: format!("{} {}x{}", format.fourcc, format.width, format.height),
            formats: offered.map(|offer| offer.fourcc.to_string()).collect(),
        })
    };
    // Texts of a driver that are not UTF-8 make `v4l` panic.
    let odd = || Err(io::Error::other("it describes itself in no known way"));
    let told = catch_unwind(AssertUnwindSafe(ask)).unwrap_or_else(|_| odd());
    told.map_err(|error| SourceError::Camera {
        device: name.to_owned(),
        why: error.to_string(),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn stamp(number: u32, millis: u64) -> Stamp {
        Stamp {
            number,
            taken_at: Some(Duration::from_millis(millis)),
        }
    }

    #[test]
    fn numbers_step_wrap_and_do_not_go_on() {
        let mut order = Order::default();
        let steps = [
            (u32::MAX, 10, 1),
            (0, 20, 1),
            (4, 60, 4),
            (4, 70, 0),
            (5, 70, 0),
            (6, 65, 0),
            (3, 80, 0),
            (4, 90, 1),
        ];
        for (number, millis, step) in steps {
            assert_eq!(
                order.step(&stamp(number, millis)),
                step,
                "{number} at {millis}"
            );
        }
        let mut unnumbered = Order::default();
        for millis in [10, 20, 30] {
            assert_eq!(unnumbered.step(&stamp(0, millis)), 1);
        }
        assert_eq!(unnumbered.step(&stamp(0, 30)), 0);
    }

    #[test]
    fn a_frame_has_waited_what_it_took_longer_than_the_fastest() {
        let mut order = Order::default();
        let mut waited = |taken, given| {
            let waited = order.waited(&stamp(0, taken), Duration::from_millis(given));
            waited.as_millis()
        };
        assert_eq!(waited(9_000, 40), 0);
        assert_eq!(waited(9_033, 63), 0);
        assert_eq!(waited(9_066, 116), 20);
        // A stamp 2 s in the future makes the others look late, but not for ever.
        assert_eq!(waited(11_099, 139), 0);
        assert_eq!(waited(9_166, 206), 2_000);
        assert_eq!(waited(14_260, 5_300), 2_000);
        assert_eq!(waited(19_360, 10_400), 0);
        let unknown = Stamp {
            number: 0,
            taken_at: None,
        };
        assert_eq!(
            Order::default().waited(&unknown, Duration::ZERO),
            Duration::ZERO
        );
    }

    #[test]
    fn what_is_no_camera_is_named_with_the_reason() {
        for device in ["/dev/video-of-nobody", "/dev/null"] {
            let period = Arc::new(WantedPeriod::new(Duration::from_millis(100)));
            let error = CameraSource::open(device, &CameraWish::default(), period);
            let said = error.err().unwrap().to_string();
            assert!(said.starts_with(device), "{said}");
        }
    }
}
