//! Quantiles, intervals by resampling, and rates of events.
//!
//! ```
//! use gapwatch::statistics::event_rate::poisson_interval;
//!
//! // Three events in six hours: between 0.10 and 1.5 an hour, with 95 % confidence.
//! let (lower, upper) = poisson_interval(3, 6.0);
//! assert!((0.10..0.11).contains(&lower) && (1.4..1.5).contains(&upper));
//! ```

pub mod quantile;

pub mod random;

pub mod bootstrap;
pub mod event_rate;
