//! A journal as one HTML page: when the road left the domain, what is behind each alarm, what was judged and what not.
//!
//! The page needs nothing from outside and nothing outside it: styles, script and numbers stand in the file, and its own
//! content policy forbids everything else. What came from the journal is text there, never markup.

mod content;

mod states;
mod table;
mod text;

// In the order of the page.
mod summary;

mod data;
mod timeline;

mod alarms;
mod answers;
mod behind;
mod chart;

mod judged;

mod calibration;

mod page;

pub use content::{Alarm, Report};
