//! Rates of events, and intervals by resampling.

pub(crate) mod bootstrap;
pub mod event_rate;
