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

pub mod board;

// In the order in which a frame passes them; rustfmt sorts within a group.
pub mod frame;
pub mod scene;

pub mod camera_health;

pub mod model;
pub mod preprocess;

pub mod image_quality;

pub mod encoder;

pub mod attention;
pub mod lane;

pub mod energies;

pub mod histogram;

pub mod gap;
pub mod reference;

pub mod intake;

pub mod continuity;
pub mod detector;
pub mod profile;
pub mod profile_chart;

pub mod alarm;
pub mod health;
pub mod rate;

pub mod judge;

pub mod pipeline;

pub mod can;

pub mod evidence;
pub mod live;

// Whole sources at once.
pub mod labelled;
pub mod survey;

pub mod calibration;
pub mod comparison;
pub mod shard;

pub mod evaluation;
pub mod heat;
pub mod report;

// What all of them use.
mod bootstrap;
pub mod clock;
pub mod durable;
pub mod event_rate;
pub mod journal;
pub mod live_file;
pub mod output;
pub mod temporary_folder;
pub mod undefined;
pub mod whole_file;
