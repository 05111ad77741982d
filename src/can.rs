//! The last step of the chain: what the monitor says, as frames on a CAN bus.
//!
//! `GapStatus, GapHealth -> 8 bytes -> schedule -> counter and CRC -> WarningSink`
//!
//! Owns the messages (`can/gapwatch.dbc` is their single source, the code that packs the bits is
//! generated from it), their E2E protection, their timing, and the log that takes the place of a
//! bus on a desk. Refuses to judge: it sends what it is told, and a value that is not known is
//! sent as not available, never as a good value. It has no clock, time is passed in as the time
//! since the start of the drive, and only `bus` opens a socket.

mod frame;

pub mod e2e;
mod generated;
pub mod message;
pub mod speed;

mod settings;

pub mod detail;
pub mod receiver;
pub mod sender;

#[cfg(feature = "can")]
pub mod bus;
pub mod log;
mod sink;

pub use frame::{BusState, CanFrame, LARGEST_ID, SinkError, WarningSink};
pub use settings::{CanSettings, CanSettingsError, MessageIds};
pub use sink::{Sink, SinkWordError};
