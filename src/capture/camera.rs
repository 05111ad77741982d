//! V4L2 cameras.
//!
//! The device is opened at the start, or refused. It is opened again whenever it stalls, fails, or is unplugged and
//! connected again. The source never ends: a camera that is gone gives no frame, and the monitor reports the silence.
//! The format that counts is the one that the driver grants, and not the one that was asked for.

use std::io;
use std::mem;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

use rustix::io::Errno;
use v4l::buffer::{Flags, Metadata, Type};
use v4l::device::Handle;
use v4l::io::traits::{CaptureStream, Stream as _};
use v4l::prelude::MmapStream;
use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Device, Format, FourCC, Fraction};

use super::period::{Pace, WantedPeriod};
use super::pixels::{Layout, PixelFormat, Pixels};
use super::{CAMERA_FORMATS, CameraWish};
use super::{CameraFacts, Frame, FrameSource, PictureError, Place, SourceError};
use crate::capture::clock::monotonic;

/// Number of buffers of the driver: one is being filled, one waits, one is being read, and one is spare.
const BUFFERS: u32 = 4;
/// A camera that gives no frame for this long is opened again.
const STALL: Duration = Duration::from_secs(2);
/// First and longest pause between two attempts to open a camera again.
const BACK_OFF: (Duration, Duration) = (Duration::from_millis(100), Duration::from_millis(500));
/// A frame that is older than this when it is read is logged: no camera and no queue of [`BUFFERS`] buffers takes this
/// long.
const OLD: Duration = Duration::from_secs(2);
/// Shortest time between two log lines about such frames.
const COMPLAINT: Duration = Duration::from_secs(1);
/// `POLLIN` of `poll(2)`.
const POLLIN: i16 = 1;
/// Formats that are asked for, in this order, unless the board says otherwise.
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
    clock: Clock,
    /// Age of the last frame when it was returned.
    waited: Duration,
    /// Whether it was logged that the driver gives no times.
    untimed: bool,
    counts: Counts,
    /// Frames that will not be judged are not copied.
    pace: Pace,
    period: Arc<WantedPeriod>,
}

/// Counts of errors since the start.
#[derive(Debug, Default)]
struct Counts {
    /// Buffers that the driver flagged as damaged.
    damaged: u64,
    /// Frames that are missing according to the driver's numbers.
    lost: u64,
    /// Frames whose number or time did not increase.
    repeated: u64,
    reopened: u64,
}

struct OpenCamera {
    /// `None` only while it is being closed.
    stream: Option<MmapStream<'static>>,
    handle: Arc<Handle>,
    layout: Layout,
    started: bool,
}

impl Drop for OpenCamera {
    /// The stream of `v4l` panics when it cannot be stopped, and again when its buffers cannot be released. Therefore
    /// it is stopped here first. If it cannot be stopped, it is left open.
    fn drop(&mut self) {
        let Some(mut stream) = self.stream.take() else {
            return;
        };
        match stream.stop() {
            Err(error) if error.raw_os_error() != Some(Errno::NODEV.raw_os_error()) => {
                log::error!("a camera cannot be stopped and is left open: {error}");
                mem::forget(stream);
            }
            _ => {
                if catch_unwind(AssertUnwindSafe(move || drop(stream))).is_err() {
                    log::error!("a camera's buffers could not be released");
                }
            }
        }
    }
}

impl CameraSource {
    /// Opens `device`, asking for `wish`. The source returns at most one frame every `period`.
    ///
    /// # Errors
    /// When there is no such camera, or when it grants none of the supported formats.
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
            clock: Clock::new(monotonic()),
            waited: Duration::ZERO,
            untimed: false,
            counts: Counts::default(),
            pace: Pace::default(),
            period,
        })
    }

    /// Tries to open the camera again, after a pause.
    fn open_again(&mut self) {
        std::thread::sleep(self.back_off);
        self.back_off = (2 * self.back_off).min(BACK_OFF.1);
        match open(&self.device, &self.wish) {
            Ok(open) => {
                self.counts.reopened += 1;
                log::warn!("{}: is open again; {:?}", self.device, self.counts);
                self.open = Some(open);
                self.order = Order::default();
            }
            Err(why) => log::debug!("{}: {why}", self.device),
        }
    }

    /// Distance of a frame's number from that of the frame before; 0 if it does not come after that frame.
    fn step(&mut self, stamp: &Stamp) -> u64 {
        let step = self.order.step(stamp);
        if step == 0 {
            self.counts.repeated += 1;
        }
        self.counts.lost += step.saturating_sub(1);
        step
    }

    /// When a frame was taken. Times that are missing or long ago are logged.
    fn place(&mut self, stamp: &Stamp) -> Taken {
        let now = monotonic();
        let taken = self.clock.place(stamp.taken_at, now);
        if stamp.taken_at.is_none() && !self.untimed {
            self.untimed = true;
            log::warn!(
                "{}: the driver gives no times of the monotonic clock; the age of frames is not known, and each counts as taken when it is read",
                self.device
            );
        }
        if self.clock.is_complaint(taken.age, now) {
            let age_s = taken.age.as_secs_f64();
            log::warn!(
                "{}: a frame is {age_s:.1} s old when it is read, by the driver's time",
                self.device
            );
        }
        taken
    }
}

/// What the driver says about a frame.
#[derive(Clone, Copy, Debug)]
struct Stamp {
    number: u32,
    /// Time on the system's monotonic clock; `None` if the driver does not give it.
    taken_at: Option<Duration>,
}

/// The order of frames.
#[derive(Debug, Default)]
struct Order {
    last: Option<Stamp>,
    /// Whether frames have numbers. With some drivers, all frames have the number 0.
    numbered: bool,
}

impl Order {
    /// Distance of a frame's number from that of the frame before; 0 if it does not come after that frame.
    fn step(&mut self, stamp: &Stamp) -> u64 {
        let Some(last) = self.last.replace(*stamp) else {
            return 1;
        };
        // Numbers wrap around: a step of more than half of the range is a step back.
        let moved = stamp.number.wrapping_sub(last.number);
        self.numbered |= moved != 0;
        let step = match moved {
            _ if !self.numbered => 1,
            back if back > u32::MAX / 2 => 0,
            forward => u64::from(forward),
        };
        let place = |number, at| Place { number, at };
        if place(step, stamp.taken_at).is_after(place(0, last.taken_at)) {
            step
        } else {
            0
        }
    }
}

/// The driver's times of frames → times since the source began. All are from the system's monotonic clock.
#[derive(Debug)]
struct Clock {
    began: Duration,
    /// The driver's time of the last frame, and the time that was derived from it.
    last: Option<(Option<Duration>, Duration)>,
    complained_at: Option<Duration>,
}

/// When a frame was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Taken {
    /// Time since the source began.
    at: Duration,
    /// Age of the frame.
    age: Duration,
}

impl Clock {
    fn new(began: Duration) -> Self {
        Self {
            began,
            last: None,
            complained_at: None,
        }
    }

    /// When the frame that is read `now` was taken, according to the driver's `stamp`. A stamp in the future counts as
    /// now, and so does a missing stamp. A stamp in the past is used, however old it is. The returned times increase as
    /// long as the driver's times increase.
    fn place(&mut self, stamp: Option<Duration>, now: Duration) -> Taken {
        let taken = stamp.map_or(now, |stamp| stamp.min(now));
        let mut at = taken.saturating_sub(self.began);
        if let Some((before, last)) = self.last
            && before
                .zip(stamp)
                .is_none_or(|(before, stamp)| stamp > before)
        {
            // Without this, frames from before the source began would all have the same time.
            at = at.max(last + Duration::from_nanos(1));
        }
        self.last = Some((stamp, at));
        Taken {
            at,
            age: now - taken,
        }
    }

    /// Whether a frame is so old that it is logged, at most once a second.
    fn is_complaint(&mut self, age: Duration, now: Duration) -> bool {
        let quiet = self.complained_at.is_some_and(|at| now < at + COMPLAINT);
        let complain = age > OLD && !quiet;
        if complain {
            self.complained_at = Some(now);
        }
        complain
    }
}

impl FrameSource for CameraSource {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        loop {
            let Some(open) = self.open.as_mut() else {
                self.open_again();
                continue;
            };
            let (picture, stamp) = match open.read(|| {
                let elapsed = monotonic().saturating_sub(self.clock.began);
                self.pace.is_due(elapsed, self.period.get())
            }) {
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
            let taken = self.place(&stamp);
            self.waited = taken.age;
            let Some(picture) = picture else {
                continue;
            };
            return Ok(Some(Frame {
                sequence: self.sequence,
                captured_at: taken.at,
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

/// A picture, if it is wanted, or what was wrong with it, and what the driver says about it.
type Read = (Option<Result<Pixels, String>>, Stamp);

impl OpenCamera {
    /// The next picture; `None` for a damaged one.
    fn read(&mut self, is_wanted: impl FnOnce() -> bool) -> io::Result<Option<Read>> {
        let stream = self.stream.as_mut().ok_or(io::ErrorKind::NotConnected)?;
        // The first call starts the stream and waits for it. Later, a time-out inside the call would queue a buffer
        // twice.
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
            taken_at: monotonic_stamp(meta),
        };
        let picture = is_wanted().then(|| self.layout.pixels(bytes));
        Ok(Some((picture, stamp)))
    }
}

/// The driver's time of a frame, if it is from the system's monotonic clock.
fn monotonic_stamp(meta: &Metadata) -> Option<Duration> {
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
        // This is only a wish, like the size, because some cameras have only one rate.
        if let Err(error) = device.set_params(&Parameters::new(interval)) {
            log::warn!("{name}: the rate cannot be changed: {error}");
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

/// Asks for the wanted format, or for one after the other; returns the format that is granted.
fn negotiate(device: &Device, wish: &CameraWish) -> Result<Format, String> {
    let now = device
        .format()
        .map_err(|error| format!("it is not a camera that gives video frames: {error}"))?;
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

/// Asks a camera about itself.
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
    // `v4l` panics on texts of a driver that are not UTF-8.
    let odd = || Err(io::Error::other("it describes itself in an unknown way"));
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

    const fn ms(millis: u64) -> Duration {
        Duration::from_millis(millis)
    }

    #[test]
    fn a_constant_delay_is_the_age_of_every_frame() {
        let mut clock = Clock::new(ms(9_000));
        for n in 0..300 {
            let taken_at = ms(9_010 + 33 * n);
            let taken = clock.place(Some(taken_at), taken_at + ms(80));
            assert_eq!(taken.age, ms(80));
            assert_eq!(taken.at, ms(10 + 33 * n));
        }
    }

    #[test]
    fn stamps_of_the_future_and_missing_ones_count_as_now() {
        let mut clock = Clock::new(ms(9_000));
        let mut place = |taken_at: Option<u64>, now| {
            let taken = clock.place(taken_at.map(ms), ms(now));
            (taken.at.as_millis(), taken.age.as_millis())
        };
        assert_eq!(place(Some(9_040), 9_050), (40, 10));
        assert_eq!(place(Some(9_083), 9_083), (83, 0));
        assert_eq!(place(Some(9_130), 9_120), (120, 0));
        assert_eq!(place(Some(9_140), 9_160), (140, 20));
        assert_eq!(place(None, 9_200), (200, 0));
        assert_eq!(place(Some(9_240), 9_241), (240, 1));
        // One wrong stamp does not affect the next one.
        assert_eq!(place(Some(99_000), 9_280), (280, 0));
        assert_eq!(place(Some(9_300), 9_310), (300, 10));
    }

    #[test]
    fn an_old_stamp_is_believed_and_complained_of_once_a_second() {
        let mut clock = Clock::new(ms(9_000));
        let mut complaints = Vec::new();
        for n in 0..100 {
            let now = ms(20_000 + 33 * n);
            let taken = clock.place(Some(now - ms(5_000)), now);
            assert_eq!(taken.age, ms(5_000));
            if clock.is_complaint(taken.age, now) {
                complaints.push(n);
            }
        }
        assert_eq!(complaints, [0, 31, 62, 93]);
        assert!(!clock.is_complaint(OLD, ms(90_000)));
        assert!(clock.is_complaint(OLD + ms(1), ms(90_000)));
    }

    #[test]
    fn times_grow_as_long_as_the_stamps_do() {
        // Frames from before the source began, then some from the future, then late ones.
        let mut clock = Clock::new(ms(9_000));
        let (mut stamp, mut now, mut last) = (ms(8_000), ms(9_001), None);
        for n in 0..1_000_u64 {
            stamp += Duration::from_nanos(1 + n * 15_485_863 % 9_000_000);
            now += Duration::from_nanos(1 + n * 104_729 % 6_000_000);
            let taken = clock.place(Some(stamp), now);
            assert_eq!(taken.age, now.saturating_sub(stamp), "frame {n}");
            assert!(last.is_none_or(|last| taken.at > last), "frame {n}");
            last = Some(taken.at);
        }
        assert!(stamp > now);
    }

    #[test]
    fn the_clock_of_the_source_is_the_one_that_drivers_use() {
        let uptime = || {
            let text = std::fs::read_to_string("/proc/uptime").unwrap();
            let seconds: f64 = text.split_whitespace().next().unwrap().parse().unwrap();
            seconds
        };
        // The time since the start also counts while the computer sleeps, the monotonic clock does not.
        assert!(monotonic().as_secs_f64() <= uptime() + 1.0);
        let before = monotonic();
        std::thread::sleep(ms(5));
        assert!(monotonic() >= before + ms(5));
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
