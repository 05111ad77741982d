//! A frame, and the trait of what accepts frames.

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

/// State of the controller on its bus, after ISO 11898-1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BusState {
    /// The state is not known.
    #[default]
    Unknown,
    /// The controller takes part (error active).
    Active,
    /// The controller takes part, and has counted many errors.
    Warning,
    /// The controller may no longer report errors: no node acknowledges, or the bus is disturbed.
    Passive,
    /// The controller is in bus-off, and what is written is lost.
    Off,
}

/// Accepts frames: a bus, a log or nothing at all.
pub trait WarningSink {
    /// Writes one frame, due at `at` since the start of the drive.
    ///
    /// # Errors
    /// When the frame was not accepted; the same frame may be offered again.
    fn send(&mut self, at: Duration, frame: &CanFrame) -> Result<(), SinkError>;

    /// Writes one CAN FD frame of at most 64 bytes with a standard identifier, at `at` since the start of the drive. A
    /// sink without CAN FD drops it.
    ///
    /// # Errors
    /// When the frame was not accepted.
    fn send_fd(&mut self, _at: Duration, _id: u16, _data: &[u8]) -> Result<(), SinkError> {
        Ok(())
    }

    /// Whether the frames that were sent have left this computer, as far as that is known. A frame that is written
    /// before would wait behind them and become old. Never blocks.
    fn is_ready(&mut self, _now: Duration) -> bool {
        true
    }

    /// The next frame received from the bus, if there is one. Never blocks.
    fn receive(&mut self) -> Option<CanFrame> {
        None
    }

    /// State of the controller, as far as [`receive`](Self::receive) has learned it.
    fn bus_state(&self) -> BusState {
        BusState::Unknown
    }

    /// Ends the output after the last frame. Without this call, a log file is not put in place.
    ///
    /// # Errors
    /// When frames that were accepted before cannot be kept.
    fn finish(self: Box<Self>) -> Result<(), SinkError> {
        Ok(())
    }
}

/// An error of a sink; `sink` is the path or interface as the user gave it.
#[derive(Debug, Error)]
pub enum SinkError {
    /// The sink cannot be opened or created.
    #[error("cannot open the CAN sink {sink}")]
    Open {
        /// Path or interface.
        sink: String,
        /// What the system answered.
        source: io::Error,
    },
    /// A frame could not be written.
    #[error("cannot write a frame to the CAN sink {sink}")]
    Write {
        /// Path or interface.
        sink: String,
        /// What the system answered.
        source: io::Error,
    },
    /// A bus that is down, full or unplugged did not accept a frame, but may accept it later.
    #[error("the bus {sink} accepts no frame")]
    Refused {
        /// Interface.
        sink: String,
        /// What the system answered.
        source: io::Error,
    },
    /// The log cannot be completed.
    #[error("cannot put the CAN log {sink} in place")]
    Finish {
        /// Path or interface.
        sink: String,
        /// What the system answered.
        source: io::Error,
    },
}
