//! Which model a command runs.

use std::path::PathBuf;

use clap::Args;
use gapwatch::model::ModelOptions;

use super::values::numbers;

/// The model, if it is not the built-in one
#[derive(Debug, Args)]
#[command(next_help_heading = "Model")]
pub struct ModelArgs {
    /// ONNX file of an encoder; options that are not given are read from a .toml file of the same name beside it
    #[arg(long, value_name = "FILE.onnx")]
    pub model: Option<PathBuf>,
    /// Names of the values to tap, one to three
    #[arg(long, value_name = "A,B,C", value_delimiter = ',')]
    pub taps: Option<Vec<String>>,
    /// Name of the lane head's output, one logit for each pixel of the input; only inspect and evaluate run it
    #[arg(long, value_name = "NAME")]
    pub lane: Option<String>,
    /// Input size, pixels
    #[arg(long = "size", id = "model-size", value_name = "WxH")]
    pub size: Option<String>,
    /// Mean of red, green and blue, for values from 0 to 1
    #[arg(long, value_name = "R,G,B", value_parser = numbers::<f32, 3>)]
    pub mean: Option<[f32; 3]>,
    /// Standard deviation of red, green and blue, for values from 0 to 1
    #[arg(long, value_name = "R,G,B", value_parser = numbers::<f32, 3>)]
    pub std: Option<[f32; 3]>,
    /// Part of the picture that is used, as shares of its width and height
    #[arg(long, value_name = "LEFT,TOP,WIDTH,HEIGHT", value_parser = numbers::<f64, 4>)]
    pub crop: Option<[f64; 4]>,
}

impl ModelArgs {
    /// The options without the file.
    pub fn options(&self) -> ModelOptions {
        ModelOptions {
            taps: self.taps.clone(),
            lane: self.lane.clone(),
            size: self.size.clone(),
            mean: self.mean,
            std: self.std,
            crop: self.crop,
        }
    }
}
