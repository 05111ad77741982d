//! Whether frames come, in what form and how often.

use std::fs::OpenOptions;
use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use gapwatch::capture::period::WantedPeriod;
use gapwatch::capture::{Frame, FrameSource, SourceError, camera_facts, open_camera};
use gapwatch::live::board::Board;
use gapwatch::live::cost::{quantile, thread_cpu_time};

use super::check::Check;

/// Number of frames that are taken.
const FRAMES: usize = 11;
/// Longest wait for the frames, and the same as a multiple of the board's time between frames, if that is longer: a
/// camera may need a second to start.
const PATIENCE: Duration = Duration::from_secs(4);
const PERIODS: f64 = 15.0;
/// Frames may come at this share of the rate that was asked for, because cameras have rates of their own.
const RATE_SHARE: f64 = 0.8;

/// Frames that came.
pub struct Taken {
    pub frames: Vec<Frame>,
    /// CPU time to take and convert one frame, median.
    pub cpu: Duration,
    /// How many frames came in a second.
    rate_hz: f64,
}

struct Given {
    frame: Result<Option<Frame>, SourceError>,
    cpu: Duration,
}

pub fn check(board: &Board) -> (Option<Taken>, Check) {
    let name = &board.camera.source;
    let rate_hz = board.monitor.rate_hz;
    let fail = |why: String| (None, Check::fail("camera", why, remedy(name)));
    let period = Arc::new(WantedPeriod::new(Duration::from_secs_f64(1.0 / rate_hz)));
    let source = match open_camera(name, &board.camera.wish, period) {
        Ok(source) => source,
        Err(error) => return fail(error.to_string()),
    };
    let live = source.is_live();
    let facts = match camera_facts(name) {
        Ok(facts) => facts,
        Err(error) => return fail(error.to_string()),
    };
    let said = facts.map_or_else(
        || name.clone(),
        |facts| {
            let offers = facts.formats.join(", ");
            format!(
                "{name}: {}, set to {}, offers {offers}",
                facts.name, facts.set_to
            )
        },
    );
    let patience = PATIENCE.max(Duration::from_secs_f64(PERIODS / rate_hz));
    let taken = match take(source, patience) {
        Ok(taken) => taken,
        Err(why) => return fail(format!("{said}: {why}")),
    };
    if let Some(error) = taken.frames.iter().find_map(|f| f.picture.as_ref().err()) {
        return fail(format!("{said}: {error}"));
    }
    if !live {
        let found = format!("{said}: a recorded or rendered drive, shown at its own pace");
        return (Some(taken), Check::pass("camera", found));
    }
    let rate = taken.rate_hz;
    let found = format!("{said}; {rate:.1} of the wanted {rate_hz} frames a second");
    if rate < RATE_SHARE * rate_hz {
        let remedy = "set another format, a smaller size or a higher fps in [camera], give the camera more light, or lower rate_hz in [monitor]";
        return (Some(taken), Check::fail("camera", found, remedy));
    }
    (Some(taken), Check::pass("camera", found))
}

/// Takes frames on a thread that nothing waits for, because a camera may not answer.
#[allow(clippy::cast_precision_loss)]
fn take(source: Box<dyn FrameSource>, patience: Duration) -> Result<Taken, String> {
    let (sender, given) = channel();
    let until = Instant::now() + patience;
    std::thread::spawn(move || give(source, &sender));
    let (mut frames, mut cpu) = (Vec::new(), Vec::new());
    let mut in_time = true;
    while frames.len() < FRAMES {
        match given.recv_timeout(until.saturating_duration_since(Instant::now())) {
            Ok(Given {
                frame: Ok(Some(frame)),
                cpu: took,
            }) => {
                frames.push(frame);
                cpu.push(took);
            }
            Ok(Given { frame: Err(e), .. }) => return Err(e.to_string()),
            Ok(Given { .. }) | Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => {
                in_time = false;
                break;
            }
        }
    }
    if frames.is_empty() {
        return Err(format!("no frame within {:.0} s", patience.as_secs_f64()));
    }
    // The rate of a camera that stalls is taken over the whole time of waiting.
    let rate_hz = if in_time {
        rate_of(&frames)
    } else {
        frames.len() as f64 / patience.as_secs_f64()
    };
    Ok(Taken {
        frames,
        cpu: quantile(cpu, 50),
        rate_hz,
    })
}

fn give(mut source: Box<dyn FrameSource>, sender: &Sender<Given>) {
    loop {
        let before = thread_cpu_time();
        let frame = source.next_frame();
        let cpu = thread_cpu_time().saturating_sub(before);
        let more = matches!(frame, Ok(Some(_)));
        if sender.send(Given { frame, cpu }).is_err() || !more {
            return;
        }
    }
}

/// Frames a second between the first and the last.
#[allow(clippy::cast_precision_loss)]
fn rate_of(frames: &[Frame]) -> f64 {
    match frames {
        [first, .., last] => {
            let span = last.captured_at.saturating_sub(first.captured_at);
            (frames.len() - 1) as f64 / span.as_secs_f64().max(1e-3)
        }
        _ => 0.0,
    }
}

fn remedy(source: &str) -> String {
    let Some(device) = source.strip_prefix("v4l2:") else {
        return "name a camera, v4l2:/dev/videoN, or a drive as source in [camera]".to_owned();
    };
    if cfg!(not(feature = "camera")) {
        return "use a program that is built with --features camera".to_owned();
    }
    let opened = OpenOptions::new().read(true).write(true).open(device);
    match opened.map_err(|error| error.kind()) {
        Err(ErrorKind::NotFound) if !Path::new("/dev/video0").exists() => {
            "plug the camera in, or load its driver: there is no /dev/video0".to_owned()
        }
        Err(ErrorKind::NotFound) => {
            "use another /dev/videoN; this lists the cameras: v4l2-ctl --list-devices".to_owned()
        }
        Err(ErrorKind::PermissionDenied) => {
            format!("add this user to the group of {device}, for example: usermod -a -G video USER")
        }
        _ => format!(
            "check that no other program uses it (fuser {device}), for example a running monitor, and what it offers: v4l2-ctl -d {device} --list-formats-ext"
        ),
    }
}
