//! A frame, and what takes frames.

use std::io;
use std::time::Duration;

use thiserror::Error;

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
