//! What a frame costs: the chain from a camera's buffer to the bus, and what this process uses.

use std::fs;
use std::io;
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};

use crate::can::{CanFrame, CanSettings, CanSettingsError, SinkError, WarningSink};
use crate::capture::Frame;
use crate::capture::pixels::Layout;
use crate::capture::undefined::Undefined;
use crate::features::energies::StageDone;
use crate::live::bus::Bus;
use crate::model::encoder::{Encoder, EncoderError};
use crate::monitor::pipeline::Monitor;
use crate::reference::Reference;

/// A camera's buffer, and the layout of its pixels.
pub type Buffer = (Layout, Vec<u8>);

/// A chain that cannot be measured.
#[derive(Debug, thiserror::Error)]
pub enum CostError {
    /// The encoder cannot be set up.
    #[error(transparent)]
    Encoder(#[from] EncoderError),
    /// The bus cannot be set up.
    #[error(transparent)]
    Bus(#[from] CanSettingsError),
    /// A buffer is not what its layout says.
    #[error("{0}")]
    Buffer(String),
    /// A frame that cannot be judged does not pass through all stages.
    #[error("a frame cannot be judged: {0}")]
    Frame(Undefined),
}

/// The whole chain, from a camera's buffer to the frames of a bus that accepts everything.
pub struct Chain {
    monitor: Monitor,
    bus: Bus,
}

/// A bus that accepts everything.
struct Swallow;

impl WarningSink for Swallow {
    fn send(&mut self, _at: Duration, frame: &CanFrame) -> Result<(), SinkError> {
        std::hint::black_box(frame);
        Ok(())
    }
}

impl Chain {
    /// A chain that has seen nothing. The reference must fit the encoder.
    ///
    /// # Errors
    /// When encoder or bus cannot be set up.
    pub fn new(encoder: &Encoder, reference: &Reference) -> Result<Self, CostError> {
        Ok(Self {
            monitor: Monitor::new(encoder, reference)?,
            bus: Bus::new(Box::new(Swallow), CanSettings::default(), reference)?,
        })
    }

    /// Passes one frame, taken at `at`, through the chain. `done` is called with `capture`, the stages of the monitor,
    /// and `can`.
    ///
    /// # Errors
    /// When the frame cannot be judged.
    pub fn step(
        &mut self,
        sequence: u64,
        at: Duration,
        (layout, bytes): &Buffer,
        done: &mut StageDone<'_>,
    ) -> Result<(), CostError> {
        let pixels = layout.pixels(bytes);
        let frame = Frame {
            sequence,
            captured_at: at,
            picture: Ok(pixels.map_err(|why| CostError::Buffer(why.to_string()))?),
        };
        done("capture");
        let verdict = self.monitor.step_by_step(&frame, done);
        // This bus refuses nothing.
        let _ = self.bus.tell(at, &verdict, Duration::ZERO);
        done("can");
        verdict
            .undefined
            .map_or(Ok(()), |why| Err(CostError::Frame(why)))
    }
}

/// Time between the frames that are shown.
const PERIOD: Duration = Duration::from_millis(100);
/// Number of first frames, which fill buffers and caches and are not counted.
pub const WARM_UP: u64 = 5;
/// Largest number of frames in a measurement.
const FRAMES_MAX: u64 = 500;

/// Repeats the buffers for at most `longest`, each with its number from 0 and its time.
pub fn shown_for(
    shown: &[Buffer],
    longest: Duration,
) -> impl Iterator<Item = (u64, Duration, &Buffer)> {
    let began = Instant::now();
    let mut at = Duration::ZERO;
    (0..WARM_UP + FRAMES_MAX)
        .zip(shown.iter().cycle())
        .take_while(move |(index, _)| *index <= WARM_UP || began.elapsed() <= longest)
        .map(move |(index, buffer)| {
            let now = at;
            at += PERIOD;
            (index, now, buffer)
        })
}

/// Time of each frame through the chain; the frames are repeated for at most `longest`.
///
/// # Errors
/// When a frame cannot be judged.
pub fn chain_times(
    encoder: &Encoder,
    reference: &Reference,
    shown: &[Buffer],
    longest: Duration,
) -> Result<Vec<Duration>, CostError> {
    let mut chain = Chain::new(encoder, reference)?;
    let mut times = Vec::new();
    for (index, at, buffer) in shown_for(shown, longest) {
        let since = Instant::now();
        chain.step(index, at, buffer, &mut |_| {})?;
        if index >= WARM_UP {
            times.push(since.elapsed());
        }
    }
    Ok(times)
}

/// CPU time that this thread has used, with a resolution of a nanosecond.
pub fn thread_cpu_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    let whole = u64::try_from(time.tv_sec).unwrap_or_default();
    Duration::new(whole, u32::try_from(time.tv_nsec).unwrap_or_default())
}

/// Memory of this program in use now, bytes.
///
/// # Errors
/// When Linux does not report it.
pub fn resident_bytes() -> io::Result<u64> {
    let status = fs::read_to_string("/proc/self/status")?;
    let kib: Option<u64> = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))
        .and_then(|rest| rest.split_whitespace().next()?.parse().ok());
    kib.map(|kib| 1_024 * kib)
        .ok_or_else(|| io::Error::other("/proc/self/status: no VmRSS"))
}

/// Milliseconds, rounded to microseconds.
pub fn ms(time: Duration) -> f64 {
    (time.as_secs_f64() * 1e6).round() / 1e3
}

/// The value that `percent` of the times do not exceed; zero if there are no times.
pub fn quantile(mut times: Vec<Duration>, percent: usize) -> Duration {
    times.sort_unstable();
    let last = times.len().saturating_sub(1);
    times.get(last * percent / 100).copied().unwrap_or_default()
}
