//! Where frames go, as the user names it: a bus, a log or nowhere.

use std::io;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use thiserror::Error;

#[cfg(feature = "can")]
use super::bus;
use super::frame::{CanFrame, SinkError, WarningSink};
use super::log::LogSink;
use super::settings::CanSettings;

/// Where the frames go, as named on the command line.
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

/// A text that names no sink of this build.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum SinkWordError {
    /// Not a kind of sink.
    #[error(
        "unknown CAN sink `{word}`: give log:FILE, log:-, socketcan:IFACE or none{hint}",
        word = .0,
        hint = interface_hint(.0)
    )]
    Unknown(String),
    /// `log:` without a file.
    #[error("the CAN sink `log:` names no file: give log:FILE, or log:- for standard output")]
    NoFile,
    /// `socketcan:` without a possible name of an interface.
    #[cfg(feature = "can")]
    #[error(
        "`{0}` names no interface: give socketcan:IFACE with 1 to 15 characters, as in socketcan:can0"
    )]
    NoInterface(String),
    /// A socket, which this build does not support.
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
    /// A [`SinkWordError`] for anything else.
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

    /// Like [`open`](Self::open), for a live run: a log file holds every frame as soon as it is sent.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_live(&self, settings: &CanSettings) -> Result<Box<dyn WarningSink>, SinkError> {
        match self {
            Self::LogFile(path) => Ok(Box::new(LogSink::live(path)?)),
            other => other.open(settings),
        }
    }

    /// Opens the sink. A bus receives the identifiers of `settings`.
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
                let mut own = vec![settings.status.id, settings.health.id, settings.version.id];
                own.extend(settings.fd.then_some(settings.detail.id));
                let heard = bus::Heard { others, own };
                let sink = bus::SocketSink::open(interface, heard, settings.fd)?;
                Ok(Box::new(sink))
            }
        }
    }
}

/// A hint on how to name an interface, if a text looks like the name of one: can0, vcan1.
fn interface_hint(word: &str) -> String {
    let kind = word.trim_end_matches(|c: char| c.is_ascii_digit());
    if kind != word && ["can", "vcan", "vxcan", "slcan"].contains(&kind) {
        format!("; an interface is named socketcan:{word}")
    } else {
        String::new()
    }
}

/// Whether Linux allows this as the name of an interface.
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

/// Accepts every frame and keeps none.
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
            assert!(!line.contains("is named"), "{line}");
        }
        let line = Sink::parse("vcan1").unwrap_err().to_string();
        assert!(
            line.ends_with("or none; an interface is named socketcan:vcan1"),
            "{line}"
        );
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
