//! The chain: a frame becomes a verdict, with the time as an argument.

pub mod camera_health;

pub mod extraction;
pub mod profile;

pub mod continuity;
pub mod detector;
pub mod scorer;

pub mod alarm;
pub mod rate;
pub mod timing;

pub mod judge;

pub mod pipeline;
