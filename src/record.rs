//! What is kept of a drive: a line for each frame, and the pictures around its alarms.

pub mod journal;

pub mod events;
