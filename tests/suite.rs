//! Checks of the program and the library from outside, in one binary: each binary links everything.

mod clips;
mod machine;
mod program;

mod accept;
mod bench;
mod cli;
mod doctor;
mod documents;
mod evaluate;
mod evidence;
mod files;
mod foreign_recordings;
mod fuzz;
mod hard_cases;
mod lab;
mod lanes;
mod layers;
mod merge;
mod monitor;
mod onnx_models;
mod oracle;
mod oracle_spans;
mod outputs;
mod power_cuts;
mod python;
mod recording;
mod replay;
mod report;
mod service;
mod shipped;
mod terminal;
mod vehicle;
mod videos;
mod vm;
