//! Why something has no value. This reason is passed on, counted and reported; it is never a NaN.

use serde::{Deserialize, Serialize};

/// The reason why a frame, histogram or comparison has no value.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, Serialize, Deserialize)]
pub enum Undefined {
    /// The picture is too small to see a road in.
    #[error("picture of {width}x{height} pixels is too small to judge")]
    TooSmall {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
    },
    /// Every pixel is black.
    #[error("picture is black")]
    Black,
    /// Every pixel has the same colour.
    #[error("picture is uniform: every pixel has the same colour")]
    Uniform,
    /// The picture has stayed the same, bit for bit, for longer than a camera's noise allows.
    #[error("picture has not changed for {} ms", .0.as_millis())]
    Frozen(std::time::Duration),
    /// A frame whose number or time is not after that of the frame before it.
    #[error("frame {number} came after frame {before}, or its time did not increase")]
    OutOfOrder {
        /// Number of the frame.
        number: u64,
        /// Number of the frame before.
        before: u64,
    },
    /// More than half of the picture is black, but not all of it, or most of it shows neither structure nor motion.
    #[error("{percent} % of the lens is covered")]
    Covered {
        /// Share of the picture.
        percent: u8,
    },
    /// The picture could not be read.
    #[error("{0}")]
    Corrupt(String),
    /// An activation is NaN or infinite.
    #[error(
        "activation of {tap} is not a finite number at channel {channel}, row {row}, column {column}"
    )]
    NotFinite {
        /// Name of the tap.
        tap: String,
        /// Position of the first one.
        channel: usize,
        /// Position of the first one.
        row: usize,
        /// Position of the first one.
        column: usize,
    },
    /// The energy is the same everywhere, so it says nothing about where the encoder looks.
    #[error("energy map is constant")]
    ConstantMap,
    /// No pixel fell into a counted bin.
    #[error("histogram is empty")]
    EmptyHistogram,
    /// A correlation with a histogram whose bins are all equal.
    #[error("histogram is constant, so it correlates with nothing")]
    ConstantHistogram,
    /// The scale of the reference gives no finite score for this gap.
    #[error("gap has no finite score on the reference's scale")]
    NoScore,
    /// Too few images for the wanted statistic.
    #[error("too few images: {found}, wanted at least {wanted}")]
    TooFewImages {
        /// Number of images available.
        found: usize,
        /// Images needed.
        wanted: usize,
    },
    /// The block has another number of channels than the reference.
    #[error("block has {found} channels and cells, but the reference has {wanted}")]
    EnergyCount {
        /// Number in the block.
        found: usize,
        /// Number in the reference.
        wanted: usize,
    },
    /// No frame came.
    #[error("no frame for 500 ms")]
    Silence,
    /// The verdict on the frame came too late.
    #[error("verdict after {} ms", .0.as_millis())]
    Late(std::time::Duration),
    /// The encoder failed on this frame.
    #[error("encoder failed: {0}")]
    Encoder(String),
}
