//! The last step of the chain: what the monitor reports, as frames on a CAN bus.
//!
//! `GapStatus, GapHealth, GapVersion -> 8 bytes -> schedule -> counter and CRC -> WarningSink`
//!
//! It defines the messages (`can/gapwatch.dbc` is their single source, from which the code that packs the bits is
//! generated), their E2E protection, their timing, and the log that replaces a bus on a desk. It does not judge: it
//! sends what it is given, and a value that is not known is sent as not available, and never as a good value. It has no
//! clock: time is an argument, measured from the start of the drive. Only `bus` opens a socket.
//!
//! ```
//! use std::time::Duration;
//!
//! use gapwatch::can::message::GapStatus;
//! use gapwatch::monitor::alarm::{AlarmState, Reason};
//! use gapwatch::reference::cause::Cause;
//!
//! let status = GapStatus {
//!     state: AlarmState::Gap,
//!     reason: Reason::Abrupt,
//!     gap_stored: true,
//!     cause: Some(Cause::Fog),
//!     gap: Some(1.44),
//!     change: Some(0.5),
//!     lanes: Some(0.25),
//!     fault_detection_counter: 127,
//!     frame_age: Some(Duration::from_millis(100)),
//! };
//! assert_eq!(GapStatus::from_bytes(&status.to_bytes()), Ok(status));
//! ```

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
