//! Which model: the built-in one, or a user's ONNX file with its size, normalisation and taps.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::preprocess::{CROP_NOTHING, Preprocessing};
use crate::whole_file::{read_text, read_whole};

/// Most taps a model may have: the CAN message carries this many block scores.
pub const TAPS_MAX: usize = 3;

/// Largest ONNX file: a hundred times the largest lane model that is shipped, and more than a ResNet-101.
pub const ONNX_BYTES_MAX: u64 = 256 << 20;
/// Largest file of options beside it.
const OPTIONS_BYTES_MAX: u64 = 1 << 16;

const BUILT_IN_NAME: &str = "enet-sad-lite-320x160";
const BUILT_IN_ONNX: &[u8] = include_bytes!("../calibration/enet-sad-lite-320x160.onnx");
const BUILT_IN_OPTIONS: &str = include_str!("../calibration/enet-sad-lite-320x160.toml");

/// A model and how to feed it.
#[derive(Clone, Debug)]
pub struct ModelSpec {
    /// File name or built-in name, for messages.
    pub name: String,
    /// The ONNX file.
    pub onnx: Cow<'static, [u8]>,
    /// Names of the tapped values, 1 to [`TAPS_MAX`].
    pub taps: Vec<String>,
    /// Name of the lane head's output, if it is known: a logit a pixel of the input.
    pub lane: Option<String>,
    /// Size, crop and normalisation of the input.
    pub preprocessing: Preprocessing,
}

/// What a user says about a model; the same words as flags and in a `.toml` beside the ONNX file.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelOptions {
    /// Names of the tapped values.
    pub taps: Option<Vec<String>>,
    /// Name of the lane head's output.
    pub lane: Option<String>,
    /// Input size, `WxH` pixels.
    pub size: Option<String>,
    /// Mean of red, green, blue, of values 0..1.
    pub mean: Option<[f32; 3]>,
    /// Standard deviation of red, green, blue, of values 0..1.
    pub std: Option<[f32; 3]>,
    /// Part of the picture used: left, top, width, height as shares of the picture.
    pub crop: Option<[f64; 4]>,
}

/// A model that cannot be set up.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The file cannot be read.
    #[error("{}: {error}", path.display())]
    Unreadable {
        /// Which file.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// The options beside the model cannot be read.
    #[error("{}: {why}; wanted taps, lane, size, mean, std or crop", path.display())]
    Options {
        /// Which file.
        path: PathBuf,
        /// Why.
        why: String,
    },
    /// Something is missing or out of range.
    #[error("model {model}: {what}")]
    Option {
        /// Which model.
        model: String,
        /// What is wrong and what is wanted.
        what: String,
    },
}

impl ModelOptions {
    /// These options, and where they are silent, those of `other`.
    fn or(self, other: Self) -> Self {
        Self {
            taps: self.taps.or(other.taps),
            lane: self.lane.or(other.lane),
            size: self.size.or(other.size),
            mean: self.mean.or(other.mean),
            std: self.std.or(other.std),
            crop: self.crop.or(other.crop),
        }
    }
}

impl ModelSpec {
    /// The model inside the program, or the user's, with the user's options over those of its `.toml`.
    ///
    /// # Errors
    /// When a file cannot be read, or an option is missing or out of range.
    pub fn new(file: Option<&Path>, typed: ModelOptions) -> Result<Self, ModelError> {
        let (name, onnx, beside) = match file {
            None => {
                let options = read_options(Path::new("built-in model"), BUILT_IN_OPTIONS)?;
                (
                    BUILT_IN_NAME.to_owned(),
                    Cow::Borrowed(BUILT_IN_ONNX),
                    options,
                )
            }
            Some(path) => {
                let onnx =
                    read_whole(path, ONNX_BYTES_MAX).map_err(|error| ModelError::Unreadable {
                        path: path.to_owned(),
                        error,
                    })?;
                (
                    path.display().to_string(),
                    Cow::Owned(onnx),
                    options_beside(path)?,
                )
            }
        };
        Self::checked(name, onnx, typed.or(beside))
    }

    fn checked(
        name: String,
        onnx: Cow<'static, [u8]>,
        options: ModelOptions,
    ) -> Result<Self, ModelError> {
        let wrong = |what: &str| ModelError::Option {
            model: name.clone(),
            what: what.to_owned(),
        };
        let taps = options
            .taps
            .ok_or_else(|| wrong("no taps; wanted --taps a,b,c or taps in a .toml beside it"))?;
        if taps.is_empty()
            || taps.len() > TAPS_MAX
            || (1..taps.len()).any(|i| taps[..i].contains(&taps[i]))
        {
            return Err(wrong("wanted 1 to 3 taps, each another"));
        }
        if options
            .lane
            .as_ref()
            .is_some_and(|lane| taps.contains(lane))
        {
            return Err(wrong("the lane output is one of the taps; wanted another"));
        }
        let size = options.size.ok_or_else(|| {
            wrong("no input size; wanted --size WxH or size in a .toml beside it")
        })?;
        let side = |side: &str| {
            side.parse::<u32>()
                .ok()
                .filter(|s| (16..=4_096).contains(s))
        };
        let (width, height) = size
            .split_once('x')
            .and_then(|(w, h)| Some((side(w)?, side(h)?)))
            .ok_or_else(|| wrong("wanted a size of WxH pixels, each from 16 to 4096"))?;
        let (Some(mean), Some(std)) = (options.mean, options.std) else {
            return Err(wrong(
                "no normalisation; wanted --mean r,g,b and --std r,g,b of values 0..1, or both in a .toml beside it",
            ));
        };
        if !mean.iter().all(|m| (0.0..=1.0).contains(m))
            || !std.iter().all(|s| s.is_normal() && (0.0..=1.0).contains(s))
        {
            return Err(wrong(
                "wanted means from 0 to 1 and standard deviations above 0 up to 1, of values 0..1 (divide by 255)",
            ));
        }
        let crop = options.crop.unwrap_or(CROP_NOTHING);
        let [left, top, wide, high] = crop;
        let inside =
            |from: f64, length: f64| from >= 0.0 && length > 0.0 && from + length <= 1.0 + 1e-9;
        if !inside(left, wide) || !inside(top, high) {
            return Err(wrong(
                "wanted a crop of left, top, width, height inside the picture, as shares from 0 to 1",
            ));
        }
        Ok(Self {
            name,
            onnx,
            taps,
            lane: options.lane,
            preprocessing: Preprocessing {
                width,
                height,
                mean,
                std,
                crop,
            },
        })
    }
}

fn options_beside(model: &Path) -> Result<ModelOptions, ModelError> {
    let path = model.with_extension("toml");
    match read_text(&path, OPTIONS_BYTES_MAX) {
        Ok(text) => read_options(&path, &text),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(ModelOptions::default()),
        Err(error) => Err(ModelError::Unreadable { path, error }),
    }
}

fn read_options(path: &Path, text: &str) -> Result<ModelOptions, ModelError> {
    toml::from_str(text).map_err(|error| ModelError::Options {
        path: path.to_owned(),
        why: error
            .message()
            .lines()
            .next()
            .unwrap_or_default()
            .to_owned(),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn complaint(options: &str) -> String {
        let options = read_options(Path::new("m.toml"), options);
        options
            .and_then(|o| ModelSpec::checked("m.onnx".into(), Cow::Borrowed(b""), o))
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn what_is_missing_or_wrong_is_said() {
        let rest = "size = \"32x16\"\nmean = [0, 0, 0]\nstd = [1, 1, 1]\n";
        for (options, part) in [
            (rest.to_owned(), "--taps"),
            (format!("taps = [\"a\", \"a\"]\n{rest}"), "each another"),
            (
                "taps = [\"a\"]\nmean = [0, 0, 0]\nstd = [1, 1, 1]".to_owned(),
                "--size",
            ),
            ("taps = [\"a\"]\nsize = \"32x16\"".to_owned(), "--mean"),
            (
                "taps = [\"a\"]\nsize = \"32x16\"\nmean = [0, 0, 0]\nstd = [1, 0, 1]".to_owned(),
                "above 0",
            ),
            (
                format!("taps = [\"a\"]\ncrop = [0, 0.6, 1, 0.6]\n{rest}"),
                "crop",
            ),
            (format!("tips = [\"a\"]\n{rest}"), "tips"),
            (
                format!("taps = [\"a\"]\nlane = \"a\"\n{rest}"),
                "one of the taps",
            ),
        ] {
            let said = complaint(&options);
            assert!(said.contains(part), "{said}");
        }
    }

    #[test]
    fn the_built_in_model_is_complete() {
        let spec = ModelSpec::new(None, ModelOptions::default()).unwrap();
        assert_eq!(spec.taps, ["e2", "e3", "e4"]);
        assert_eq!(spec.lane.as_deref(), Some("lane"));
    }
}
