//! The last step of the chain: what the monitor says, as frames on a CAN bus.
//!
//! `GapStatus, GapHealth -> 8 bytes -> schedule -> counter and CRC -> WarningSink`
//!
//! Owns the messages (`can/gapwatch.dbc` is their single source, the code that packs the bits is
//! generated from it), their E2E protection, their timing, and the log that takes the place of a
//! bus on a desk. Refuses to judge: it sends what it is told, and a value that is not known is
//! sent as not available, never as a good value. It has no clock, time is passed in as the time
//! since the start of the drive, and only `bus` opens a socket.

#[cfg(feature = "can")]
pub mod bus;
pub mod detail;
pub mod e2e;
pub mod log;
pub mod message;
pub mod receiver;
pub mod sender;
pub mod speed;

use std::io;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use embedded_can::Id;
use thiserror::Error;

use self::log::LogSink;
use self::speed::{SpeedError, SpeedSignal};

// Generated at build time from `can/gapwatch.dbc`; the style is the generator's.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::enum_variant_names,
    clippy::too_many_arguments
)]
mod generated {
    include!(concat!(env!("OUT_DIR"), "/gapwatch_dbc.rs"));
}

/// What the DBC says of a message beyond its signals; filled by the generated code.
struct MessageAttributes {
    data_id: u16,
    cycle_ms: u64,
    minimum_gap_ms: u64,
}

/// Largest identifier of a standard frame (11 bits).
pub const LARGEST_ID: u16 = 0x7FF;

/// A classic CAN data frame of 8 bytes with a standard identifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanFrame {
    /// Identifier, 11 bits: 0 to [`LARGEST_ID`].
    pub id: u16,
    /// Payload in bus order.
    pub data: [u8; 8],
}

/// How a message is called on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageIds {
    /// CAN identifier, 11 bits.
    pub id: u16,
    /// E2E data id, 16 bits; part of the CRC, never sent.
    pub data_id: u16,
}

/// Identifiers and periods of the messages. The default is what `gapwatch.dbc` says.
#[derive(Clone, Debug, PartialEq)]
pub struct CanSettings {
    /// Of `GapStatus`; 0x5D0 by default.
    pub status: MessageIds,
    /// Of `GapHealth`; 0x5D1 by default.
    pub health: MessageIds,
    /// Of `GapDetail`; 0x5D2 by default.
    pub detail: MessageIds,
    /// Of `GapClear`; 0x5D8 by default.
    pub clear: MessageIds,
    /// Time between cyclic `GapStatus` frames; 100 ms by default.
    pub status_period: Duration,
    /// Time between `GapHealth` frames; 1 s by default.
    pub health_period: Duration,
    /// Time between `GapDetail` frames; 1 s by default.
    pub detail_period: Duration,
    /// Whether the bus has CAN FD and `GapDetail` is sent; not by default.
    pub fd: bool,
    /// Shortest time between two `GapStatus` frames; 20 ms by default.
    pub minimum_gap: Duration,
    /// Where others send the vehicle's speed; `None` by default.
    pub speed: Option<SpeedSignal>,
}

impl Default for CanSettings {
    fn default() -> Self {
        let status = generated::GapStatus::ATTRIBUTES;
        let health = generated::GapHealth::ATTRIBUTES;
        let detail = generated::GapDetail::ATTRIBUTES;
        let clear = generated::GapClear::ATTRIBUTES;
        Self {
            status: ids(generated::GapStatus::MESSAGE_ID, &status),
            health: ids(generated::GapHealth::MESSAGE_ID, &health),
            detail: ids(generated::GapDetail::MESSAGE_ID, &detail),
            clear: ids(generated::GapClear::MESSAGE_ID, &clear),
            status_period: Duration::from_millis(status.cycle_ms),
            health_period: Duration::from_millis(health.cycle_ms),
            detail_period: Duration::from_millis(detail.cycle_ms),
            fd: false,
            minimum_gap: Duration::from_millis(status.minimum_gap_ms),
            speed: None,
        }
    }
}

fn ids(id: Id, attributes: &MessageAttributes) -> MessageIds {
    match id {
        Id::Standard(id) => MessageIds {
            id: id.as_raw(),
            data_id: attributes.data_id,
        },
        Id::Extended(_) => unreachable!("gapwatch.dbc holds standard identifiers only"),
    }
}

/// Settings that no bus can be served with.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CanSettingsError {
    /// An identifier needs more than 11 bits.
    #[error("CAN id {0:#X} does not fit into 11 bits (largest is 0x7FF)")]
    IdTooLarge(u16),
    /// Two messages share an identifier.
    #[error("CAN id {0:#X} is given to two messages")]
    SameId(u16),
    /// The vehicle's speed cannot be read so.
    #[error("the speed: {0}")]
    Speed(#[from] SpeedError),
    /// A period of zero would send without end.
    #[error("a CAN period of 0 ms cannot be kept")]
    NoPeriod,
    /// The minimum gap leaves no room for the cyclic frames.
    #[error("a minimum gap of {gap:?} does not fit into a status period of {period:?}")]
    GapTooLong {
        /// Wanted minimum gap.
        gap: Duration,
        /// Wanted status period.
        period: Duration,
    },
}

impl CanSettings {
    /// Checks that the settings can be kept.
    ///
    /// # Errors
    /// The first [`CanSettingsError`] found: identifier above 11 bits, identifier given twice,
    /// speed that no frame holds, period of zero, minimum gap not shorter than the status period.
    pub fn check(&self) -> Result<(), CanSettingsError> {
        let ids = [
            self.status.id,
            self.health.id,
            self.detail.id,
            self.clear.id,
        ];
        for (n, &id) in ids.iter().enumerate() {
            if id > LARGEST_ID {
                return Err(CanSettingsError::IdTooLarge(id));
            }
            if ids[..n].contains(&id) {
                return Err(CanSettingsError::SameId(id));
            }
        }
        if let Some(speed) = &self.speed {
            speed.check()?;
            if ids.contains(&speed.id) {
                return Err(CanSettingsError::SameId(speed.id));
            }
        }
        let periods = [self.status_period, self.health_period, self.detail_period];
        if periods.contains(&Duration::ZERO) {
            return Err(CanSettingsError::NoPeriod);
        }
        if self.minimum_gap >= self.status_period {
            return Err(CanSettingsError::GapTooLong {
                gap: self.minimum_gap,
                period: self.status_period,
            });
        }
        Ok(())
    }
}

/// How the controller stands on its bus, after ISO 11898-1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BusState {
    /// It has not said.
    #[default]
    Unknown,
    /// It takes part.
    Active,
    /// It takes part, and has counted many errors.
    Warning,
    /// It may no longer report errors: nobody acknowledges, or the bus is disturbed.
    Passive,
    /// It is off the bus, and what is written is lost.
    Off,
}

/// Takes frames: a bus, a log or nothing at all.
pub trait WarningSink {
    /// Takes one frame, due at `at` since the start of the drive.
    ///
    /// # Errors
    /// When the frame was not taken; the same frame may be offered again.
    fn send(&mut self, at: Duration, frame: &CanFrame) -> Result<(), SinkError>;

    /// Takes one CAN FD frame of at most 64 bytes with a standard identifier, at `at` since the start of the drive. What has
    /// no CAN FD lets it go.
    ///
    /// # Errors
    /// When the frame was not taken.
    fn send_fd(&mut self, _at: Duration, _id: u16, _data: &[u8]) -> Result<(), SinkError> {
        Ok(())
    }

    /// Whether the frames that were sent have left this computer, as far as that is known: one that is handed over before
    /// would wait behind them, and grow old. Never blocks.
    fn is_ready(&mut self, _now: Duration) -> bool {
        true
    }

    /// A frame that came over the bus and waits, if there is one. Never blocks.
    fn receive(&mut self) -> Option<CanFrame> {
        None
    }

    /// How the controller stands, as far as it was heard by [`receive`](Self::receive).
    fn bus_state(&self) -> BusState {
        BusState::Unknown
    }

    /// Ends the output, after the last frame; without it a log file is not put in place.
    ///
    /// # Errors
    /// When frames taken before cannot be kept.
    fn finish(self: Box<Self>) -> Result<(), SinkError> {
        Ok(())
    }
}

/// A sink that cannot do its work; `sink` is the path or interface as the user gave it.
#[derive(Debug, Error)]
pub enum SinkError {
    /// It cannot be opened or created.
    #[error("cannot open the CAN sink {sink}")]
    Open {
        /// Path or interface.
        sink: String,
        /// What the system answered.
        source: io::Error,
    },
    /// It did not take a frame.
    #[error("cannot write a frame to the CAN sink {sink}")]
    Write {
        /// Path or interface.
        sink: String,
        /// What the system answered.
        source: io::Error,
    },
    /// A bus did not take a frame now, and may take it later: down, full or unplugged.
    #[error("the bus {sink} takes no frame")]
    Refused {
        /// Interface.
        sink: String,
        /// What the system answered.
        source: io::Error,
    },
    /// It cannot be completed.
    #[error("cannot put the CAN log {sink} in place")]
    Finish {
        /// Path or interface.
        sink: String,
        /// What the system answered.
        source: io::Error,
    },
}

/// Where the frames go, as the command line says it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Sink {
    /// `none`: nowhere.
    None,
    /// `log:-`: candump log format to standard output.
    Stdout,
    /// `log:FILE`: candump log format to a file.
    LogFile(PathBuf),
    /// `socketcan:IFACE`: a CAN interface.
    #[cfg(feature = "can")]
    Socket(String),
}

/// A word that names no sink of this build.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum SinkWordError {
    /// Not a kind of sink.
    #[error("unknown CAN sink `{0}`: give log:FILE, log:-, socketcan:IFACE or none")]
    Unknown(String),
    /// `log:` without a file.
    #[error("the CAN sink `log:` names no file: give log:FILE, or log:- for standard output")]
    NoFile,
    /// `socketcan:` without an interface that Linux could have.
    #[cfg(feature = "can")]
    #[error(
        "`{0}` names no interface: give socketcan:IFACE with 1 to 15 characters, as in socketcan:can0"
    )]
    NoInterface(String),
    /// A socket, which this build does not have.
    #[cfg(not(feature = "can"))]
    #[error(
        "this build has no CAN socket for `{0}` (build with --features can): give log:FILE, log:- or none"
    )]
    NoSocket(String),
}

impl Sink {
    /// Reads `log:FILE`, `log:-`, `socketcan:IFACE` or `none`.
    ///
    /// # Errors
    /// A [`SinkWordError`] of one line for anything else.
    pub fn parse(word: &str) -> Result<Self, SinkWordError> {
        match word.split_once(':') {
            None if word == "none" => Ok(Self::None),
            Some(("log", "")) => Err(SinkWordError::NoFile),
            Some(("log", "-")) => Ok(Self::Stdout),
            Some(("log", path)) => Ok(Self::LogFile(path.into())),
            #[cfg(feature = "can")]
            Some(("socketcan", interface)) if is_interface(interface) => {
                Ok(Self::Socket(interface.to_owned()))
            }
            #[cfg(feature = "can")]
            Some(("socketcan", _)) => Err(SinkWordError::NoInterface(word.to_owned())),
            #[cfg(not(feature = "can"))]
            Some(("socketcan", _)) => Err(SinkWordError::NoSocket(word.to_owned())),
            _ => Err(SinkWordError::Unknown(word.to_owned())),
        }
    }

    /// As [`open`](Self::open), for a live run: a log file holds every frame as soon as it is sent.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_live(&self, settings: &CanSettings) -> Result<Box<dyn WarningSink>, SinkError> {
        match self {
            Self::LogFile(path) => Ok(Box::new(LogSink::live(path)?)),
            other => other.open(settings),
        }
    }

    /// Opens the sink; a bus lets the identifiers of `settings` through.
    ///
    /// # Errors
    /// [`SinkError::Open`] when the log file cannot be written or there is no such interface.
    #[cfg_attr(not(feature = "can"), expect(unused_variables))]
    pub fn open(&self, settings: &CanSettings) -> Result<Box<dyn WarningSink>, SinkError> {
        match self {
            Self::None => Ok(Box::new(Nowhere)),
            Self::Stdout => Ok(Box::new(LogSink::stream("log:-", io::stdout()))),
            Self::LogFile(path) => Ok(Box::new(LogSink::create(path)?)),
            #[cfg(feature = "can")]
            Self::Socket(interface) => {
                let mut others = vec![settings.clear.id];
                others.extend(settings.speed.as_ref().map(|speed| speed.id));
                let mut own = vec![settings.status.id, settings.health.id];
                own.extend(settings.fd.then_some(settings.detail.id));
                let heard = bus::Heard { others, own };
                let sink = bus::SocketSink::open(interface, heard, settings.fd)?;
                Ok(Box::new(sink))
            }
        }
    }
}

/// What Linux allows as the name of an interface.
#[cfg(feature = "can")]
fn is_interface(name: &str) -> bool {
    const LONGEST: usize = 15;
    (1..=LONGEST).contains(&name.len())
        && name
            .chars()
            .all(|c| c.is_ascii_graphic() && !matches!(c, '/' | ':'))
}

impl FromStr for Sink {
    type Err = SinkWordError;

    fn from_str(word: &str) -> Result<Self, Self::Err> {
        Self::parse(word)
    }
}

/// Takes every frame and keeps none.
struct Nowhere;

impl WarningSink for Nowhere {
    fn send(&mut self, _at: Duration, _frame: &CanFrame) -> Result<(), SinkError> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn default_settings_are_those_of_the_dbc_file() {
        let settings = CanSettings::default();
        for (ids, id) in [
            (settings.status, 0x5D0),
            (settings.health, 0x5D1),
            (settings.clear, 0x5D8),
        ] {
            assert_eq!(ids, MessageIds { id, data_id: id });
        }
        assert_eq!(settings.status_period, Duration::from_millis(100));
        assert_eq!(settings.health_period, Duration::from_secs(1));
        assert_eq!(settings.minimum_gap, Duration::from_millis(20));
        assert_eq!(settings.check(), Ok(()));
    }

    #[test]
    fn settings_that_cannot_be_kept_are_refused() {
        let mut settings = CanSettings::default();
        settings.clear.id = 0x800;
        assert_eq!(settings.check(), Err(CanSettingsError::IdTooLarge(0x800)));

        let mut settings = CanSettings::default();
        settings.health.id = 0x5D0;
        assert_eq!(settings.check(), Err(CanSettingsError::SameId(0x5D0)));

        let settings = CanSettings {
            health_period: Duration::ZERO,
            ..CanSettings::default()
        };
        assert_eq!(settings.check(), Err(CanSettingsError::NoPeriod));

        let settings = CanSettings {
            minimum_gap: Duration::from_millis(100),
            ..CanSettings::default()
        };
        assert!(matches!(
            settings.check(),
            Err(CanSettingsError::GapTooLong { .. })
        ));
    }

    #[test]
    fn sink_words_are_read() {
        assert_eq!(Sink::parse("none"), Ok(Sink::None));
        assert_eq!(Sink::parse("log:-"), Ok(Sink::Stdout));
        assert_eq!(
            Sink::parse("log:a:b.log"),
            Ok(Sink::LogFile("a:b.log".into()))
        );
        assert_eq!("log:x".parse(), Ok(Sink::LogFile("x".into())));
    }

    #[test]
    fn unknown_sink_words_are_refused_in_one_line() {
        assert_eq!(Sink::parse("log:"), Err(SinkWordError::NoFile));
        for word in ["", "nono", "log", "none:", "file:x"] {
            let line = Sink::parse(word).unwrap_err().to_string();
            assert!(line.contains(&format!("`{word}`")), "{line}");
            assert!(line.contains("give log:FILE"), "{line}");
            assert!(!line.contains('\n'), "{line}");
        }
    }

    #[cfg(feature = "can")]
    #[test]
    fn interfaces_are_names_that_linux_allows() {
        assert_eq!(
            Sink::parse("socketcan:vcan0"),
            Ok(Sink::Socket("vcan0".to_owned()))
        );
        for word in [
            "socketcan:",
            "socketcan:a/b",
            "socketcan:a-name-too-long-for-it",
        ] {
            let line = Sink::parse(word).unwrap_err().to_string();
            assert!(line.contains("as in socketcan:can0"), "{line}");
        }
    }

    #[cfg(not(feature = "can"))]
    #[test]
    fn a_build_without_sockets_says_so() {
        let line = Sink::parse("socketcan:vcan0").unwrap_err().to_string();
        assert!(line.contains("this build has no CAN socket"), "{line}");
    }

    #[test]
    fn no_sink_takes_every_frame() {
        let frame = CanFrame {
            id: 0x5D0,
            data: [0; 8],
        };
        let mut sink = Sink::None.open(&CanSettings::default()).unwrap();
        sink.send(Duration::ZERO, &frame).unwrap();
        sink.finish().unwrap();
    }
}
