//! Evidence of alarms: the frames around the beginning of each alarm, and where the encoder looked, in a bounded
//! folder.
//!
//! The frame loop only hands pictures over, through a bounded queue, to a thread of their own. This thread keeps the
//! last moments in memory as their source gave them, compresses them when an alarm begins, and writes the event when it
//! is complete. Pictures that do not fit into the queue are dropped and counted. Errors of the disk are counted and
//! logged. Each event is a folder that appears whole or not at all, and that is on the disk when it is counted:
//!
//! ```text
//! DIR/000012/event.json        what, when, why; the files below by name
//! DIR/000012/frame-000196.jpg  a frame
//! DIR/000012/heat-000199-2.jpg    energies of a tap over what the encoder saw, brighter is more
//! ```

mod event;
mod quota;

mod folder;

mod reading;
mod recorder;

pub use event::{Event, Moment};
pub use folder::{Found, examine};
pub use quota::Quota;
pub use reading::{ReadError, picture, read};
#[cfg(test)]
pub(crate) use recorder::Message;
pub use recorder::{EventCounts, EventRecorder};
