//! Journal, version 4: one JSON object a line. The first line says what the run was made with, and when. Each other
//! line says what was known after a frame, or when no frame came.
//!
//! ```text
//! {"gapwatch_journal":4,"began":{"utc":…,"is_set":true,"monotonic_s":…},"about":{…}}
//! {"t_s":0.105,"captured_s":0.1,"seq":1,"state":"Ok",…}
//! ```
//!
//! `t_s` is the time at which the verdict was reported, and never runs backwards; `captured_s` is the time at which the
//! frame was taken. In a replay, time does not pass while a frame is judged, so they are the same. What is not known
//! may be `null` or left out.
//!
//! ```
//! use std::time::Duration;
//!
//! use gapwatch::capture::clock::ClockTime;
//! use gapwatch::monitor::judge::Verdict;
//! use gapwatch::record::journal::{self, About, Journal};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("drive.jsonl");
//! let taps = ["e2".to_owned()];
//! let mut journal = Journal::create(&path, &taps, &ClockTime::now(), &About::default())?;
//! let verdict = Verdict { sequence: Some(0), ..Verdict::nothing_yet() };
//! journal.add(Duration::ZERO, &verdict, Duration::from_millis(5))?;
//! journal.finish()?;
//! assert_eq!(journal::read(&path)?.entries.len(), 1);
//! # Ok(())
//! # }
//! ```

mod about;
mod line;

mod writing;

mod reading;
#[cfg_attr(not(feature = "lab"), path = "journal/no_recording.rs")]
mod recording;

pub use about::{About, begins_like_one};
pub use reading::{Entry, ReadError, Reading, read};
pub use recording::RecordingJournal;
pub use writing::{Journal, JournalError};
