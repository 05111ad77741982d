//! `boards/*.toml` → [`Board`]: what is connected where, checked once at the start.
//!
//! Defines the keys of a board file. An unknown key is refused: a misspelt key is an error with its line, and never
//! silently a default.

mod evidence;

use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::can::speed::SpeedSignal;
use crate::can::{CanSettings, CanSettingsError, LARGEST_ID, MessageIds, Sink};
use crate::capture::{CAMERA_FORMATS, CameraWish, camera_of};
use crate::files::toml_keys::{self, Document, Keys, Kind, Wrong};
use crate::files::whole_file::read_text;
use crate::monitor::warn::{Answer, WarnOn};
use crate::reference::JudgedRate;

pub use evidence::{EvidenceBoard, KEEP};

/// Largest file.
const BYTES_MAX: u64 = 1 << 16;
/// Highest frame rate that a board may ask for.
const RATE_MAX_HZ: f64 = 240.0;
/// Frames a second that are judged, unless the board says otherwise.
const RATE_HZ: f64 = 10.0;
/// Time of listening, unless the board says otherwise.
const LISTEN: Duration = Duration::from_secs(2);
/// A car that is slower than this is not moving, unless the board says otherwise.
const PARKED_BELOW_KMH: f64 = 1.0;
/// A car that does not move for this long is parked. At a crossing it stops for less.
const PARKED_AFTER: Duration = Duration::from_secs(60);
/// A frame may take this share of the time between two frames, unless the board says otherwise. The rest is for other
/// programs.
const FRAME_SHARE: f64 = 0.5;
/// Memory that is allowed, unless the board says otherwise, MiB: three times what the shipped model needs, and frames
/// of 1080p.
const MEMORY_MIB: f64 = 192.0;
/// Most milliseconds or MiB that a board may allow.
const AMOUNT_MAX: f64 = 100_000.0;
/// Longest time that a board may give for a car that does not move until it is parked.
const SECONDS_MAX: f64 = 60.0;
/// Longest time of listening, seconds: half of the time in which the service must start.
const LISTEN_MAX: f64 = 30.0;

/// A board file that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BoardError {
    /// It cannot be read.
    #[error("{}: {error}", path.display())]
    Unreadable {
        /// Which file.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// Something in it is not understood.
    #[error("{}:{line}: {what}", path.display())]
    Wrong {
        /// Which file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What was found and what was wanted.
        what: String,
    },
}

/// What a monitor does on one computer.
#[derive(Clone, Debug)]
pub struct Board {
    /// Where frames come from.
    pub camera: CameraBoard,
    /// Where warnings are sent.
    pub can: CanBoard,
    /// How the road is watched.
    pub monitor: MonitorBoard,
    /// Pictures of alarms; `None` = none are kept.
    pub evidence: Option<EvidenceBoard>,
    /// What a frame may cost; the doctor checks it.
    pub budget: Budget,
}

/// Where frames come from.
#[derive(Clone, Debug)]
pub struct CameraBoard {
    /// `v4l2:/dev/videoN`, or any recorded or rendered drive, which is then shown at its own pace.
    pub source: String,
    /// What to ask a camera for.
    pub wish: CameraWish,
}

/// Where warnings are sent.
#[derive(Clone, Debug)]
pub struct CanBoard {
    /// The bus or log.
    pub sink: Sink,
    /// Identifiers and periods.
    pub settings: CanSettings,
    /// How long to listen for other senders of our identifiers before the first frame is sent.
    pub listen: Duration,
}

/// How the road is watched.
#[derive(Clone, Debug)]
pub struct MonitorBoard {
    /// Reference file; `None` = the one inside the program.
    pub reference: Option<PathBuf>,
    /// Model file; `None` = the one inside the program.
    pub model: Option<PathBuf>,
    /// A reference made of simulation alone is accepted, although any real road is a gap to it.
    pub strict: bool,
    /// The answers that raise the warning; `None` = those that suit the reference.
    pub warn: Option<WarnOn>,
    /// Highest number of frames that are judged in a second.
    pub rate_hz: f64,
    /// Frames a second while the road is clearly nominal or the car is parked; the same as `rate_hz` unless the board
    /// gives less.
    pub idle_rate_hz: f64,
}

impl MonitorBoard {
    /// How often the road is judged.
    pub fn rate(&self) -> JudgedRate {
        JudgedRate {
            rate_hz: self.rate_hz,
            idle_rate_hz: self.idle_rate_hz,
        }
    }
}

/// What a frame may cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Budget {
    /// Time from a frame to its verdict, for 99 of 100 frames.
    pub frame: Duration,
    /// Memory of the whole program, MiB.
    pub memory_mib: f64,
}

/// `source` in `[camera]`.
fn source() -> Kind<String> {
    toml_keys::text("v4l2:/dev/videoN, or a rendered or recorded drive").or_say(|source| {
        match camera_of(&source) {
            Some(camera) => Err(format!("a camera is named {camera:?}, found {source:?}")),
            None if source == "v4l2:" => {
                Err("\"v4l2:\" names no device; wanted one, as in \"v4l2:/dev/video0\"".to_owned())
            }
            None => Ok(source),
        }
    })
}

/// Width and height, pixels.
fn size() -> Kind<(u32, u32)> {
    toml_keys::text("\"WIDTHxHEIGHT\", each from 16 to 8192").of(|word| {
        let side = |side: &str| side.parse().ok().filter(|s| (16..=8_192).contains(s));
        let (width, height) = word.split_once('x')?;
        Some((side(width)?, side(height)?))
    })
}

fn file_name() -> Kind<PathBuf> {
    toml_keys::text("the name of a file").of(|name| Some(PathBuf::from(name)))
}

/// Answers that raise the warning.
fn warn_on() -> Kind<WarnOn> {
    toml_keys::texts("a list of \"gap\", \"change\" and \"lanes\"").of(|names| {
        let answers: Result<Vec<Answer>, _> = names.iter().map(|name| name.parse()).collect();
        answers
            .ok()
            .filter(|answers| !answers.is_empty())
            .map(|answers| WarnOn::these(&answers))
    })
}

/// Frames a second.
fn rate() -> Kind<f64> {
    toml_keys::number(0.1..=RATE_MAX_HZ, " a second")
}

fn seconds(most: f64) -> Kind<Duration> {
    toml_keys::number(0.0..=most, " seconds").of(|s| Some(Duration::from_secs_f64(s)))
}

/// Milliseconds or MiB.
fn amount() -> Kind<f64> {
    toml_keys::number(1.0..=AMOUNT_MAX, "")
}

fn can_id() -> Kind<u16> {
    toml_keys::whole(0..=LARGEST_ID, "")
        .wanting(format!("an identifier of 11 bits, 0 to {LARGEST_ID:#X}"))
}

/// A period, longer than `above`.
fn milliseconds(above: Duration) -> Kind<Duration> {
    let least = u16::try_from(above.as_millis())
        .unwrap_or(u16::MAX)
        .saturating_add(1);
    toml_keys::whole(least..=u16::MAX, " milliseconds")
        .of(|ms| Some(Duration::from_millis(ms.into())))
}

impl Board {
    /// Reads a board file. Paths of models, references and folders of evidence in it are relative to its folder.
    ///
    /// # Errors
    /// When the file cannot be read, or anything in it is not understood.
    pub fn read(path: &Path) -> Result<Self, BoardError> {
        let text = read_text(path, BYTES_MAX).map_err(|error| BoardError::Unreadable {
            path: path.to_owned(),
            error,
        })?;
        Self::parse(&text, path.parent().unwrap_or(Path::new(""))).map_err(|wrong| {
            BoardError::Wrong {
                path: path.to_owned(),
                line: wrong.line,
                what: wrong.what,
            }
        })
    }

    fn parse(text: &str, folder: &Path) -> Result<Self, Wrong> {
        let beside = |named: PathBuf| folder.join(named);
        let document = Document::parse(text)?;
        let file = document.keys(&["camera", "can", "monitor", "evidence", "budget"])?;
        let camera = file.need_table("camera", &["source", "format", "size", "fps"])?;
        let camera = CameraBoard {
            source: camera.need("source", source())?,
            wish: CameraWish {
                format: camera.get("format", toml_keys::word(&CAMERA_FORMATS))?,
                size: camera.get("size", size())?,
                fps: camera.get("fps", rate())?,
            },
        };
        let can = can(&file)?;
        let monitor = MonitorBoard::of(&file, beside)?;
        let budget = file.table("budget", &["frame_ms", "memory_mib"])?;
        let allowed = |key| match &budget {
            Some(budget) => budget.get(key, amount()),
            None => Ok(None),
        };
        Ok(Self {
            camera,
            can,
            evidence: evidence::read(&file, beside)?,
            budget: Budget {
                frame: match allowed("frame_ms")? {
                    Some(ms) => Duration::from_secs_f64(ms / 1e3),
                    None => Duration::from_secs_f64(FRAME_SHARE / monitor.rate_hz),
                },
                memory_mib: allowed("memory_mib")?.unwrap_or(MEMORY_MIB),
            },
            monitor,
        })
    }
}

impl MonitorBoard {
    /// `[monitor]`; defaults if it is missing.
    fn of(file: &Keys<'_>, beside: impl Fn(PathBuf) -> PathBuf) -> Result<Self, Wrong> {
        let known = [
            "reference",
            "model",
            "strict",
            "warn",
            "rate_hz",
            "idle_rate_hz",
        ];
        let Some(table) = file.table("monitor", &known)? else {
            return Ok(Self {
                reference: None,
                model: None,
                strict: false,
                warn: None,
                rate_hz: RATE_HZ,
                idle_rate_hz: RATE_HZ,
            });
        };
        let rate_hz = table.get("rate_hz", rate())?.unwrap_or(RATE_HZ);
        let idle_rate_hz = table.get("idle_rate_hz", rate())?.unwrap_or(rate_hz);
        if idle_rate_hz > rate_hz {
            return Err(Wrong {
                line: table.line_of("idle_rate_hz"),
                what: format!("idle_rate_hz = {idle_rate_hz}; wanted at most rate_hz = {rate_hz}"),
            });
        }
        Ok(Self {
            reference: table.get("reference", file_name())?.map(&beside),
            model: table.get("model", file_name())?.map(&beside),
            strict: table.get("strict", toml_keys::truth())?.unwrap_or(false),
            warn: table.get("warn", warn_on())?,
            rate_hz,
            idle_rate_hz,
        })
    }
}

/// `[can]`.
fn can(file: &Keys<'_>) -> Result<CanBoard, Wrong> {
    let known = [
        "sink",
        "listen_s",
        "status",
        "health",
        "detail",
        "version",
        "clear",
        "status_period_ms",
        "health_period_ms",
        "detail_period_ms",
        "version_period_ms",
        "fd",
        "speed",
    ];
    let can = file.need_table("can", &known)?;
    let sink = toml_keys::text("log:FILE, log:-, socketcan:IFACE or none")
        .or_say(|word| Sink::parse(&word).map_err(|error| error.to_string()));
    let default = CanSettings::default();
    let ids = |key, default| match can.table(key, &["id", "data_id"])? {
        None => Ok(default),
        Some(table) => {
            let id = table.need("id", can_id())?;
            let data_id = table.get("data_id", toml_keys::whole(0..=u16::MAX, ""))?;
            Ok(MessageIds {
                id,
                // The identifier, if it is not given.
                data_id: data_id.unwrap_or(id),
            })
        }
    };
    let period = |key, above, default| {
        let period = can.get(key, milliseconds(above))?;
        Ok(period.unwrap_or(default))
    };
    let speed = speed(&can)?;
    let settings = CanSettings {
        status: ids("status", default.status)?,
        health: ids("health", default.health)?,
        detail: ids("detail", default.detail)?,
        version: ids("version", default.version)?,
        clear: ids("clear", default.clear)?,
        status_period: period(
            "status_period_ms",
            default.minimum_gap,
            default.status_period,
        )?,
        health_period: period("health_period_ms", Duration::ZERO, default.health_period)?,
        detail_period: period("detail_period_ms", Duration::ZERO, default.detail_period)?,
        version_period: period("version_period_ms", Duration::ZERO, default.version_period)?,
        fd: can.get("fd", toml_keys::truth())?.unwrap_or(false),
        speed,
        ..default
    };
    settings.check().map_err(|error| Wrong {
        line: match error {
            CanSettingsError::Speed(_) => can.line_of("speed"),
            _ => can.line(),
        },
        what: format!("in [can]: {error}"),
    })?;
    Ok(CanBoard {
        sink: can.need("sink", sink)?,
        settings,
        listen: can.get("listen_s", seconds(LISTEN_MAX))?.unwrap_or(LISTEN),
    })
}

/// `[can.speed]`.
fn speed(can: &Keys<'_>) -> Result<Option<SpeedSignal>, Wrong> {
    let known = [
        "id",
        "start_bit",
        "length",
        "big_endian",
        "factor",
        "offset",
        "parked_below_kmh",
        "parked_after_s",
    ];
    let Some(speed) = can.table("speed", &known)? else {
        return Ok(None);
    };
    let number = |key, default: f64| {
        let number = speed.get(key, toml_keys::finite())?;
        Ok(number.unwrap_or(default))
    };
    let after = speed.get("parked_after_s", seconds(SECONDS_MAX))?;
    Ok(Some(SpeedSignal {
        id: speed.need("id", can_id())?,
        start_bit: speed.need("start_bit", toml_keys::whole(0..=63, ""))?,
        length: speed.need("length", toml_keys::whole(1..=32, " bits"))?,
        big_endian: speed
            .get("big_endian", toml_keys::truth())?
            .unwrap_or(false),
        factor: speed.need("factor", toml_keys::finite())?,
        offset: number("offset", 0.0)?,
        parked_below_kmh: number("parked_below_kmh", PARKED_BELOW_KMH)?,
        parked_after: after.unwrap_or(PARKED_AFTER),
    }))
}

#[cfg(test)]
mod tests;
