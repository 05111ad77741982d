//! Evidence of alarms: the frames around the moment at which one began, and where the encoder looked, in a bounded folder.
//!
//! The frame loop only hands over: pictures go through a bounded queue to a thread of their own. It keeps the last moments in
//! memory as their source gave them, compresses them when an alarm begins, and writes the event once it is complete. What does
//! not fit into the queue is dropped and counted; a disk that takes nothing is counted and logged. Each event is a folder that
//! appears whole or not at all, and is on the disk when it is counted:
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
