//! `boards/*.toml` → [`Board`]: what is plugged where, checked once at start.
//!
//! Owns the words of a board file. Refuses what it does not know: a misspelt key is an error with its line, never a
//! default that nobody asked for.

mod evidence;

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;

use crate::can::speed::SpeedSignal;
use crate::can::{CanSettings, LARGEST_ID, MessageIds, Sink};
use crate::whole_file::read_text;

use evidence::EvidenceTable;
pub use evidence::{EvidenceBoard, KEEP};

/// Largest file.
const BYTES_MAX: u64 = 1 << 16;
/// Most frames a second that a board may ask for.
const RATE_MAX_HZ: f64 = 240.0;
/// Pixel formats of cameras that are understood, by the names of V4L2.
pub const CAMERA_FORMATS: [&str; 5] = ["YUYV", "NV12", "MJPG", "RGB3", "BGR3"];
/// Frames a second that are judged, unless the board says otherwise.
const RATE_HZ: f64 = 10.0;
/// Time of listening, unless the board says otherwise.
const LISTEN: Duration = Duration::from_secs(2);
/// A car slower than this stands, unless the board says otherwise.
const PARKED_BELOW_KMH: f64 = 1.0;
/// And one that stands for this long is parked: at a crossing it does not.
const PARKED_AFTER: Duration = Duration::from_secs(60);
/// A frame may take this share of the time between two, unless the board says otherwise: the rest is for everyone else.
const FRAME_SHARE: f64 = 0.5;
/// Memory that is allowed, unless the board says otherwise, MiB: thrice what the shipped model needs, and frames of 1080p.
const MEMORY_MIB: f64 = 192.0;
/// Most milliseconds or MiB that a board may allow.
const AMOUNT_MAX: f64 = 100_000.0;
/// Longest time that a board may ask for: of listening, and of standing before the car is parked.
const SECONDS_MAX: f64 = 60.0;
/// Longest time of listening, seconds: half of what the service has to start in.
const LISTEN_MAX: f64 = 30.0;

/// A board file that cannot be followed.
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
        /// What was found and what would do.
        what: String,
    },
}

/// What a monitor is to do on one computer.
#[derive(Clone, Debug)]
pub struct Board {
    /// Where frames come from.
    pub camera: CameraBoard,
    /// Where warnings go.
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

/// What to ask a camera for; what it grants counts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraWish {
    /// Four characters of V4L2, such as `YUYV`.
    pub format: Option<String>,
    /// Width and height, pixels.
    pub size: Option<(u32, u32)>,
    /// Frames a second.
    pub fps: Option<f64>,
}

/// Where warnings go.
#[derive(Clone, Debug)]
pub struct CanBoard {
    /// The bus or log.
    pub sink: Sink,
    /// Identifiers and periods.
    pub settings: CanSettings,
    /// How long to listen for others on our identifiers before the first frame is sent.
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
    /// Most frames a second that are judged.
    pub rate_hz: f64,
    /// Frames a second while the road is clearly nominal or the car parked; as `rate_hz` unless the board says less.
    pub idle_rate_hz: f64,
}

/// What a frame may cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Budget {
    /// Time from a frame to its verdict, 99 of 100 frames.
    pub frame: Duration,
    /// Memory of the whole program, MiB.
    pub memory_mib: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    camera: CameraTable,
    can: CanTable,
    #[serde(default)]
    monitor: MonitorTable,
    evidence: Option<EvidenceTable>,
    #[serde(default)]
    budget: BudgetTable,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraTable {
    source: String,
    format: Option<Format>,
    size: Option<Size>,
    fps: Option<Rate>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CanTable {
    sink: Word,
    listen_s: Option<Listen>,
    status: Option<Ids>,
    health: Option<Ids>,
    detail: Option<Ids>,
    clear: Option<Ids>,
    status_period_ms: Option<u16>,
    health_period_ms: Option<u16>,
    detail_period_ms: Option<u16>,
    #[serde(default)]
    fd: bool,
    speed: Option<Speed>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Speed {
    id: CanId,
    start_bit: u16,
    length: u16,
    #[serde(default)]
    big_endian: bool,
    factor: f64,
    #[serde(default)]
    offset: f64,
    parked_below_kmh: Option<f64>,
    parked_after_s: Option<Seconds>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Ids {
    id: CanId,
    /// The identifier, if left out.
    data_id: Option<u16>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct MonitorTable {
    reference: Option<PathBuf>,
    model: Option<PathBuf>,
    #[serde(default)]
    strict: bool,
    rate_hz: Option<Rate>,
    idle_rate_hz: Option<Rate>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct BudgetTable {
    frame_ms: Option<Amount>,
    memory_mib: Option<Amount>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "f64")]
struct Amount(f64);

impl TryFrom<f64> for Amount {
    type Error = String;

    fn try_from(amount: f64) -> Result<Self, String> {
        if (1.0..=AMOUNT_MAX).contains(&amount) {
            Ok(Self(amount))
        } else {
            Err(format!("{amount}; wanted a number from 1 to {AMOUNT_MAX}"))
        }
    }
}

#[derive(Clone, Deserialize)]
#[serde(try_from = "String")]
struct Word(Sink);

impl TryFrom<String> for Word {
    type Error = String;

    fn try_from(word: String) -> Result<Self, String> {
        Sink::parse(&word).map(Self).map_err(|e| e.to_string())
    }
}

#[derive(Clone, Deserialize)]
#[serde(try_from = "String")]
struct Format(String);

impl TryFrom<String> for Format {
    type Error = String;

    fn try_from(word: String) -> Result<Self, String> {
        if CAMERA_FORMATS.contains(&word.as_str()) {
            Ok(Self(word))
        } else {
            Err(format!(
                "format {word:?}; wanted one of {}",
                CAMERA_FORMATS.join(", ")
            ))
        }
    }
}

#[derive(Clone, Deserialize)]
#[serde(try_from = "String")]
struct Size(u32, u32);

impl TryFrom<String> for Size {
    type Error = String;

    fn try_from(word: String) -> Result<Self, String> {
        let side = |side: &str| side.parse().ok().filter(|s| (16..=8_192).contains(s));
        word.split_once('x')
            .and_then(|(width, height)| Some(Self(side(width)?, side(height)?)))
            .ok_or_else(|| format!("size {word:?}; wanted WIDTHxHEIGHT, each from 16 to 8192"))
    }
}

#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "f64")]
struct Rate(f64);

impl TryFrom<f64> for Rate {
    type Error = String;

    fn try_from(hz: f64) -> Result<Self, String> {
        if (0.1..=RATE_MAX_HZ).contains(&hz) {
            Ok(Self(hz))
        } else {
            Err(format!(
                "{hz} a second; wanted a number from 0.1 to {RATE_MAX_HZ}"
            ))
        }
    }
}

#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "f64")]
struct Seconds(Duration);

impl TryFrom<f64> for Seconds {
    type Error = String;

    fn try_from(seconds: f64) -> Result<Self, String> {
        if (0.0..=SECONDS_MAX).contains(&seconds) {
            Ok(Self(Duration::from_secs_f64(seconds)))
        } else {
            Err(format!(
                "{seconds} s; wanted seconds from 0 to {SECONDS_MAX}"
            ))
        }
    }
}

#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "f64")]
struct Listen(Seconds);

impl TryFrom<f64> for Listen {
    type Error = String;

    fn try_from(seconds: f64) -> Result<Self, String> {
        if seconds > LISTEN_MAX {
            return Err(format!(
                "{seconds} s of listening; wanted at most {LISTEN_MAX}"
            ));
        }
        Seconds::try_from(seconds).map(Self)
    }
}

#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "u32")]
struct CanId(u16);

impl TryFrom<u32> for CanId {
    type Error = String;

    fn try_from(id: u32) -> Result<Self, String> {
        match u16::try_from(id) {
            Ok(id) if id <= LARGEST_ID => Ok(Self(id)),
            _ => Err(format!(
                "CAN id {id:#X}; wanted 11 bits, at most {LARGEST_ID:#X}"
            )),
        }
    }
}

impl Board {
    /// Reads a board file. Models, references and folders of evidence in it are taken from its folder.
    ///
    /// # Errors
    /// When the file cannot be read, or anything in it is not understood.
    pub fn read(path: &Path) -> Result<Self, BoardError> {
        let text = read_text(path, BYTES_MAX).map_err(|error| BoardError::Unreadable {
            path: path.to_owned(),
            error,
        })?;
        let wrong = |line: usize, what: String| BoardError::Wrong {
            path: path.to_owned(),
            line,
            what,
        };
        let file: File = toml::from_str(&text).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start).min(text.len());
            let line = 1 + text.as_bytes()[..at]
                .iter()
                .filter(|&&b| b == b'\n')
                .count();
            wrong(line, error.message().replace('\n', " "))
        })?;
        let settings = file.can.settings();
        settings.check().map_err(|error| {
            let line = text.lines().position(|line| line.trim() == "[can]");
            wrong(1 + line.unwrap_or(0), format!("in [can]: {error}"))
        })?;
        let rate_hz = file.monitor.rate_hz.map_or(RATE_HZ, |rate| rate.0);
        let idle_rate_hz = file.monitor.idle_rate_hz.map_or(rate_hz, |rate| rate.0);
        if idle_rate_hz > rate_hz {
            let line = text.lines().position(|line| line.contains("idle_rate_hz"));
            let found =
                format!("idle_rate_hz = {idle_rate_hz}, wanted at most rate_hz = {rate_hz}");
            return Err(wrong(1 + line.unwrap_or(0), found));
        }
        let beside = |named: PathBuf| path.parent().unwrap_or(Path::new("")).join(named);
        Ok(Self {
            camera: CameraBoard {
                source: file.camera.source,
                wish: CameraWish {
                    format: file.camera.format.map(|format| format.0),
                    size: file.camera.size.map(|size| (size.0, size.1)),
                    fps: file.camera.fps.map(|fps| fps.0),
                },
            },
            can: CanBoard {
                sink: file.can.sink.0,
                settings,
                listen: file.can.listen_s.map_or(LISTEN, |listen| listen.0.0),
            },
            monitor: MonitorBoard {
                reference: file.monitor.reference.map(beside),
                model: file.monitor.model.map(beside),
                strict: file.monitor.strict,
                rate_hz,
                idle_rate_hz,
            },
            evidence: file.evidence.map(|table| EvidenceBoard {
                quota: table.quota(),
                folder: beside(table.folder),
            }),
            budget: Budget {
                frame: file
                    .budget
                    .frame_ms
                    .map_or(Duration::from_secs_f64(FRAME_SHARE / rate_hz), |ms| {
                        Duration::from_secs_f64(ms.0 / 1e3)
                    }),
                memory_mib: file.budget.memory_mib.map_or(MEMORY_MIB, |mib| mib.0),
            },
        })
    }
}

impl CanTable {
    fn settings(&self) -> CanSettings {
        let default = CanSettings::default();
        let ids = |table: &Option<Ids>, default| {
            table.as_ref().map_or(default, |ids| MessageIds {
                id: ids.id.0,
                data_id: ids.data_id.unwrap_or(ids.id.0),
            })
        };
        let period =
            |ms: Option<u16>, default| ms.map_or(default, |ms| Duration::from_millis(ms.into()));
        CanSettings {
            status: ids(&self.status, default.status),
            health: ids(&self.health, default.health),
            detail: ids(&self.detail, default.detail),
            clear: ids(&self.clear, default.clear),
            status_period: period(self.status_period_ms, default.status_period),
            health_period: period(self.health_period_ms, default.health_period),
            detail_period: period(self.detail_period_ms, default.detail_period),
            fd: self.fd,
            speed: self.speed.as_ref().map(|speed| SpeedSignal {
                id: speed.id.0,
                start_bit: speed.start_bit,
                length: speed.length,
                big_endian: speed.big_endian,
                factor: speed.factor,
                offset: speed.offset,
                parked_below_kmh: speed.parked_below_kmh.unwrap_or(PARKED_BELOW_KMH),
                parked_after: speed.parked_after_s.map_or(PARKED_AFTER, |after| after.0),
            }),
            ..default
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::fs;

    use super::*;

    const LEAST: &str = "[camera]\nsource = \"v4l2:/dev/video0\"\n[can]\nsink = \"none\"\n";

    fn read(text: &str) -> Result<Board, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("car.toml");
        fs::write(&path, text).unwrap();
        Board::read(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn the_least_board_has_the_defaults_of_the_dbc() {
        let board = read(LEAST).unwrap();
        assert_eq!(board.can.settings, CanSettings::default());
        assert_eq!(board.can.listen, Duration::from_secs(2));
        assert_eq!(board.camera.wish, CameraWish::default());
        assert!(!board.monitor.strict && board.monitor.reference.is_none());
        // Half of the time between two frames at 10 a second.
        assert_eq!(board.budget.frame, Duration::from_millis(50));
    }

    #[test]
    fn words_are_read_and_paths_taken_from_the_folder_of_the_board() {
        let text = format!(
            "{LEAST}status = {{ id = 0x123 }}\nclear = {{ id = 0x124, data_id = 7 }}\nlisten_s = 0.5\n\
             status_period_ms = 50\n[monitor]\nreference = \"town.json\"\nstrict = true\nrate_hz = 5.0\n"
        )
        .replace("[can]", "format = \"NV12\"\nsize = \"1280x720\"\nfps = 30.0\n[can]");
        let board = read(&text).unwrap();
        let ids = |id, data_id| MessageIds { id, data_id };
        assert_eq!(board.can.settings.status, ids(0x123, 0x123));
        assert_eq!(board.can.settings.clear, ids(0x124, 7));
        assert_eq!(board.can.settings.status_period, Duration::from_millis(50));
        assert_eq!(board.camera.wish.size, Some((1280, 720)));
        assert!(board.monitor.reference.unwrap().ends_with("town.json"));
        assert!(board.monitor.strict);
    }

    #[test]
    fn a_speed_is_read_with_what_a_dbc_file_says_of_it() {
        let speed = "[can.speed]\nid = 0x1A0\nstart_bit = 23\nlength = 16\nfactor = 0.01\nbig_endian = true\n";
        let board = read(&format!("{LEAST}{speed}")).unwrap();
        let speed = board.can.settings.speed.unwrap();
        assert_eq!((speed.id, speed.start_bit, speed.length), (0x1A0, 23, 16));
        assert!(speed.big_endian && (speed.parked_below_kmh - 1.0).abs() < 1e-9);
        assert!(read(LEAST).unwrap().can.settings.speed.is_none());
    }

    #[test]
    fn evidence_is_kept_only_where_the_board_says_so_and_not_for_ever() {
        assert!(read(LEAST).unwrap().evidence.is_none());
        let board = read(&format!(
            "{LEAST}[evidence]\nfolder = \"seen\"\nevents = 5\n"
        ))
        .unwrap();
        let EvidenceBoard { folder, quota } = board.evidence.unwrap();
        assert!(folder.ends_with("seen") && folder != Path::new("seen"));
        assert_eq!((quota.events, quota.bytes), (5, 256_000_000));
        assert_eq!(quota.keep, Some(Duration::from_secs(30 * 86_400)));
        for (line, said) in [
            ("events = 0", "1 to 100000"),
            ("days = -1", "1 to 3650"),
            ("mb = 3", "megabytes"),
        ] {
            let error =
                read(&format!("{LEAST}[evidence]\nfolder = \"seen\"\n{line}\n")).unwrap_err();
            assert!(
                error.contains("car.toml:7:") && error.contains(said),
                "{error}"
            );
        }
    }

    #[test]
    fn what_is_not_understood_is_refused_with_its_line_and_what_would_do() {
        for (line, from, to, said) in [
            (2, "source", "sources", "expected one of `source`"),
            (4, "\"none\"", "\"can0\"", "socketcan:IFACE"),
            (4, "\"none\"", "3", "string"),
            (1, "[camera]", "[camara]", "expected one of `camera`"),
            (3, "[can]", "size = \"9x9\"\n[can]", "WIDTHxHEIGHT"),
            (3, "[can]", "format = \"H264\"\n[can]", "YUYV, NV12"),
            (3, "[can]", "fps = 0.0\n[can]", "0.1 to 240"),
            (
                6,
                "\"none\"\n",
                "\"none\"\n[monitor]\nidle_rate_hz = 12.0\n",
                "at most rate_hz = 10",
            ),
            (4, "sink", "status = { id = 0x800 }\nsink", "0x7FF"),
            (4, "sink", "listen_s = -1.0\nsink", "seconds from 0"),
            (4, "sink", "listen_s = 31.0\nsink", "at most 30"),
            (
                2,
                "[camera]",
                "[budget]\nframe_ms = 0\n[camera]",
                "1 to 100000",
            ),
            (3, "sink", "status = { id = 0x5D1 }\nsink", "two messages"),
            (3, "sink", "status_period_ms = 0\nsink", "period of 0 ms"),
            (
                3,
                "sink",
                "speed = { id = 0x1A0, start_bit = 60, length = 8, factor = 1.0 }\nsink",
                "8 bits from bit 60",
            ),
            (
                3,
                "sink",
                "speed = { id = 0x5D0, start_bit = 0, length = 8, factor = 1.0 }\nsink",
                "two messages",
            ),
        ] {
            let error = read(&LEAST.replacen(from, to, 1)).unwrap_err();
            assert!(error.contains(&format!("car.toml:{line}:")), "{error}");
            assert!(error.contains(said), "{error}");
            assert!(!error.contains('\n'), "{error}");
        }
        assert!(read("").unwrap_err().contains("camera"));
    }
}
