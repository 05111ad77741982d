//! gapwatch watches the road through a lane model's own encoder and warns when it no longer looks like the simulation
//! that the model was trained in.
//!
//! What happens to a frame, and in which module:
//!
//! ```text
//! Frame            picture [H, W, 3] of 8 bits, sequence, time              capture (from lab::scene when rendered)
//!   -> input       [3, h, w] floats, resized and normalised                 model::preprocess
//!   -> FeatureMap  [C, h', w'] activations of each tapped block             model::encoder
//!   -> EnergyMap   [h', w'] sum of squares over channels                    features::attention
//!      BlockMeans  [energies] by channel, and by cell of a coarse grid      features::energies
//!   -> taken       [bins] pixels, or [energies] levels of log energies      monitor::extraction
//!   -> gap         of a window's sums against a Reference                   reference, monitor::detector
//!      change      of the last seconds against the past of the same road    monitor::history, monitor::span_watch
//!   -> score       0 nominal, 1 alarm threshold                             monitor::detector
//!   -> AlarmState  Init, Ok, Suspect, Gap, SensorFault, Unavailable         monitor::alarm
//!   -> GapStatus   8 bytes with counter and CRC                             can
//! ```
//!
//! [`monitor::pipeline::Monitor::step`] is that chain. What cannot be judged is [`capture::undefined::Undefined`],
//! never a number. The car then receives `Unavailable` or `SensorFault`, never `Ok`.
//!
//! The modules are layers, in this order. Each one uses only those before it:
//!
//! | module | holds |
//! |---|---|
//! | [`files`] | files that are whole, and keys of TOML and JSON |
//! | [`statistics`] | quantiles, intervals, rates of events, random numbers |
//! | [`capture`] | frames, and the sources that give them |
//! | [`model`] | the model file, preprocessing, the encoder |
//! | [`features`] | energies, histograms, picture quality |
//! | [`mod@reference`] | metrics, and the reference file |
//! | [`monitor`] | the chain from a frame to a verdict |
//! | [`can`] | messages, their protection and timing, the bus |
//! | [`record`] | the journal, and the pictures around alarms |
//! | [`live`] | the board file, the live loop, what a frame costs |
//! | [`calibration`] | nominal drives to a reference |
//! | `lab` | rendered drives, studies, comparison, reports; not in the car's program (feature `lab`) |
//!
//! Words, each for one thing:
//!
//! | word | is |
//! |---|---|
//! | source | where frames come from: a camera, a folder, a video, a recording, a rendered drive |
//! | drive | frames of one source in the order of time |
//! | recording | an MCAP file |
//! | tap | an inner value of the model that is looked at; its maps are those of a block |
//! | energy | sum of squared activations, by pixel, by channel or by cell |
//! | extraction | what a nominal domain takes from a frame: counts of bins, or levels of energies |
//! | window | the last frames that are judged together |
//! | gap | distance of a window from the nearest nominal domain, in units of its metric |
//! | span | a longer recent time, or a recent time and the past before it |
//! | change | distance of the last seconds from the road's own past |
//! | cause | the condition that a gap or a change looks like |
//! | score | the gap or change scaled: 0 is the nominal median, 1 the alarm threshold |
//! | change | how far the road differs from its own past, as a score |
//! | lanes | forecast of the share of lanes that the model loses |
//! | evidence | what a window adds for or against an alarm |
//! | cause | what most likely causes the evidence: fog, dirt, another road, ... |
//! | verdict | what is known after a frame, or when no frame came |
//! | reference | nominal domains with their thresholds, for one model |
//! | survey | what the encoder saw of a whole drive |
//! | calibration target | metric, window and rate of false alarms that a reference is made for |
//! | event | the pictures around the beginning of an alarm; `--evidence` keeps them |
//! | journal | a line for each verdict |
//!
//! # Example
//!
//! ```
//! use gapwatch::capture::open;
//! use gapwatch::model::encoder::Encoder;
//! use gapwatch::model::{ModelOptions, ModelSpec};
//! use gapwatch::monitor::pipeline::Monitor;
//! use gapwatch::reference::Reference;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let model = ModelSpec::new(None, ModelOptions::default())?;
//! let encoder = Encoder::load(&model)?;
//! let reference = Reference::read(None)?;
//! let mut monitor = Monitor::new(&encoder, &reference)?;
//! let mut source = open("random:seed=1&frames=3")?;
//! while let Some(frame) = source.next_frame()? {
//!     let verdict = monitor.step(&frame);
//!     println!("{:.1} s: {}, score {:?}", verdict.at.as_secs_f64(), verdict.state.name(), verdict.score);
//! }
//! # Ok(())
//! # }
//! ```

// In the order of the data: each module uses those before it.
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
