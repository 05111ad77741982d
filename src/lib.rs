//! gapwatch watches the road through a lane model's own encoder and says when it no longer looks like the simulation
//! that the model was trained in.
//!
//! What happens to a frame, one file a step:
//!
//! ```text
//! Frame            picture [H, W, 3] of 8 bits, sequence, time              frame (from scene/ when rendered)
//!   -> input       [3, h, w] floats, resized and normalised                 preprocess
//!   -> FeatureMap  [C, h', w'] activations of each tapped block             encoder, of a model
//!   -> EnergyMap   [h', w'] sum of squares over channels                    attention
//!      BlockMeans  [energies] by channel, and by cell of a coarse grid      energies
//!   -> taken       [bins] pixels, or [energies] levels of log energies      histogram, gap, intake
//!   -> gap         of a window's sums against a Reference                   gap, reference, detector
//!   -> score       0 nominal, 1 alarm threshold                             detector
//!   -> AlarmState  Init, Ok, Suspect, Gap, SensorFault, Unavailable         alarm
//!   -> GapStatus   8 bytes with counter and CRC                             can
//! ```
//!
//! Beside the chain, for people: a line a frame as JSON or, with the pictures, as an MCAP recording (`journal`); the
//! pictures around an alarm (`evidence`) with what is behind it, number by number and region by region (`profile`); all of it as
//! one page (`report`).
//!
//! [`pipeline::Monitor::step`] is that chain. What cannot be judged is [`undefined::Undefined`], never a number, and the
//! car is told `Unavailable` or `SensorFault`, never `Ok`.

// In the order of the data: each uses those before it.
pub mod files;
pub mod statistics;

pub mod capture;

pub mod model;

pub mod features;

pub mod reference;

pub mod monitor;

pub mod can;

pub mod record;

pub mod live;

pub mod calibration;

#[cfg(feature = "lab")]
pub mod lab;
