//! Generated at build time from `can/gapwatch.dbc`, in the style of the generator.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::enum_variant_names,
    clippy::too_many_arguments
)]

/// What the DBC says about a message beyond its signals; filled in by the generated code.
pub struct MessageAttributes {
    pub data_id: u16,
    pub cycle_ms: u64,
    pub minimum_gap_ms: u64,
}

include!(concat!(env!("OUT_DIR"), "/gapwatch_dbc.rs"));
