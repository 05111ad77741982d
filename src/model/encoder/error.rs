//! Why a model cannot be used.

/// A model that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum EncoderError {
    /// The bytes are not an ONNX model that tract can read.
    #[error("{model}: not a usable ONNX model: {why}")]
    Onnx {
        /// File or built-in name.
        model: String,
        /// What was found.
        why: String,
    },
    /// A tap that the model does not have.
    #[error("{model}: no tap named {tap:?}; the model's values are {known}")]
    NoTap {
        /// File or built-in name.
        model: String,
        /// Name that was asked for.
        tap: String,
        /// Names that exist: the outputs, then the inner values in the order of the graph.
        known: String,
    },
    /// The model's input is not a picture of the wanted size.
    #[error("{model}: input {input} is {found}; wanted [1, 3, {height}, {width}]")]
    Input {
        /// File or built-in name.
        model: String,
        /// Name of the input.
        input: String,
        /// Its shape in the file.
        found: String,
        /// Wanted height, pixels.
        height: u32,
        /// Wanted width, pixels.
        width: u32,
    },
    /// A tap that is not a stack of maps.
    #[error(
        "{model}: tap {tap} has shape {found}; wanted [1, channels, height, width] of at least 2 by 2 cells"
    )]
    TapShape {
        /// File or built-in name.
        model: String,
        /// Name of the tap.
        tap: String,
        /// Its shape.
        found: String,
    },
    /// A lane head that does not give one value for each pixel.
    #[error("{model}: lane output {lane} has shape {found}; wanted [1, 1, {height}, {width}]")]
    LaneShape {
        /// File or built-in name.
        model: String,
        /// Name of the output.
        lane: String,
        /// Its shape.
        found: String,
        /// Height of the input, pixels.
        height: usize,
        /// Width of the input, pixels.
        width: usize,
    },
}
