//! Quantiles, intervals by resampling, and rates of events.

pub mod quantile;

pub mod random;

pub mod bootstrap;
pub mod event_rate;
