//! What is kept of a drive: a line a frame, and the pictures around its alarms.

pub mod journal;

pub mod events;
