//! Which model: the built-in one, or a user's ONNX file with its size, normalisation and taps.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use crate::files::toml_keys::{self, Document, Wrong};
use crate::files::whole_file::{read_text, read_whole};
use crate::model::data_files::{DataFile, read_beside};
use crate::model::onnx_file::{self, ONNX_BYTES_MAX};
use crate::model::preprocess::{CROP_NOTHING, Preprocessing};

/// Largest number of taps of a model: the CAN message has room for this many block scores.
pub const TAPS_MAX: usize = 3;

/// Largest file of options beside an ONNX file.
const OPTIONS_BYTES_MAX: u64 = 1 << 16;

const BUILT_IN_NAME: &str = "enet-sad-lite-320x160";
const BUILT_IN_ONNX: &[u8] = include_bytes!("../../calibration/enet-sad-lite-320x160.onnx");
const BUILT_IN_OPTIONS: &str = include_str!("../../calibration/enet-sad-lite-320x160.toml");

/// A model and how to feed it.
#[derive(Clone, Debug)]
pub struct ModelSpec {
    /// File name or built-in name, for messages.
    pub name: String,
    /// The ONNX file.
    pub onnx: Cow<'static, [u8]>,
    /// Files with weights that the ONNX file names, in the order of their names; none for most models.
    pub data: Vec<DataFile>,
    /// Names of the tapped values, 1 to [`TAPS_MAX`].
    pub taps: Vec<String>,
    /// Name of the lane head's output, if it is known: one logit for each pixel of the input.
    pub lane: Option<String>,
    /// Size, crop and normalisation of the input.
    pub preprocessing: Preprocessing,
}

/// What a user says about a model, with flags or in a `.toml` file beside the ONNX file; the keys are the same.
#[derive(Clone, Debug, Default)]
pub struct ModelOptions {
    /// Names of the tapped values.
    pub taps: Option<Vec<String>>,
    /// Name of the lane head's output.
    pub lane: Option<String>,
    /// Input size, `WxH` pixels.
    pub size: Option<String>,
    /// Mean of red, green and blue, for values from 0 to 1; neither this nor `std` for a model that takes bytes.
    pub mean: Option<[f32; 3]>,
    /// Standard deviation of red, green and blue, for values from 0 to 1.
    pub std: Option<[f32; 3]>,
    /// Part of the picture that is used: left, top, width and height, as shares of the picture.
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
    /// Something in the file of options is not understood.
    #[error("{}:{line}: {what}", path.display())]
    Options {
        /// Which file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What was found and what was wanted.
        what: String,
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
    /// These options, completed with those of `other`.
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
    /// The model inside the program, or a user's model. Options that were typed replace those of its `.toml` file.
    ///
    /// # Errors
    /// When a file cannot be read, or an option is missing or out of range.
    pub fn new(file: Option<&Path>, typed: ModelOptions) -> Result<Self, ModelError> {
        let (name, onnx, data, beside) = match file {
            None => {
                let options = read_options(Path::new("built-in model"), BUILT_IN_OPTIONS)?;
                let name = BUILT_IN_NAME.to_owned();
                (name, Cow::Borrowed(BUILT_IN_ONNX), Vec::new(), options)
            }
            Some(path) => {
                let onnx =
                    read_whole(path, ONNX_BYTES_MAX).map_err(|error| ModelError::Unreadable {
                        path: path.to_owned(),
                        error,
                    })?;
                let name = path.display().to_string();
                // What a damaged file says of itself does not matter: the encoder refuses it.
                let names = onnx_file::described(&onnx).unwrap_or_default().data_files;
                let data = read_beside(path, onnx.len() as u64, &names).map_err(|what| {
                    let model = name.clone();
                    ModelError::Option { model, what }
                })?;
                (name, Cow::Owned(onnx), data, options_beside(path)?)
            }
        };
        Self::checked(name, onnx, data, typed.or(beside))
    }

    fn checked(
        name: String,
        onnx: Cow<'static, [u8]>,
        data: Vec<DataFile>,
        options: ModelOptions,
    ) -> Result<Self, ModelError> {
        let wrong = |what: String| ModelError::Option {
            model: name.clone(),
            what,
        };
        let missing = |what: &str| wrong(what.to_owned());
        let taps = options
            .taps
            .ok_or_else(|| missing("no taps; wanted --taps a,b,c or taps in a .toml beside it"))?;
        if !are_taps(&taps) {
            return Err(wrong(format!("taps {}; wanted {TAPS}", taps.join(","))));
        }
        if let Some(lane) = options.lane.as_ref().filter(|lane| taps.contains(lane)) {
            return Err(wrong(format!(
                "the lane output {lane} is one of the taps; wanted another output"
            )));
        }
        let size = options.size.ok_or_else(|| {
            missing("no input size; wanted --size WxH or size in a .toml beside it")
        })?;
        let (width, height) =
            sides(&size).ok_or_else(|| wrong(format!("size {size}; wanted {SIZE}")))?;
        let takes_bytes = onnx_file::described(&onnx).is_ok_and(|described| described.takes_bytes);
        let (mean, std) = match (options.mean, options.std) {
            (None, None) if takes_bytes => BYTES,
            _ if takes_bytes => {
                return Err(missing(
                    "its input takes bytes from 0 to 255 (uint8) and is normalised inside the model; wanted neither mean nor std",
                ));
            }
            (Some(mean), Some(std)) => (mean, std),
            _ => {
                return Err(missing(
                    "no normalisation; wanted --mean r,g,b and --std r,g,b for values from 0 to 1, or both in a .toml beside it",
                ));
            }
        };
        if !is_mean(&mean) {
            return Err(wrong(format!("mean {mean:?}; wanted {MEAN}")));
        }
        if !is_std(&std) {
            return Err(wrong(format!("std {std:?}; wanted {STD}")));
        }
        let crop = options.crop.unwrap_or(CROP_NOTHING);
        if !is_crop(&crop) {
            return Err(wrong(format!("crop {crop:?}; wanted {CROP}")));
        }
        Ok(Self {
            name,
            onnx,
            data,
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
    parse_options(text).map_err(|Wrong { line, what }| ModelError::Options {
        path: path.to_owned(),
        line,
        what,
    })
}

fn parse_options(text: &str) -> Result<ModelOptions, Wrong> {
    let document = Document::parse(text)?;
    let keys = document.keys(&["taps", "lane", "size", "mean", "std", "crop"])?;
    let taps = toml_keys::texts(format!("a list of {TAPS}"));
    let size = toml_keys::text(format!("{SIZE}, as in \"800x288\""));
    let mean = toml_keys::numbers(MEAN);
    let std = toml_keys::numbers(STD);
    let crop = toml_keys::numbers(CROP);
    Ok(ModelOptions {
        taps: keys.get("taps", taps.of(|taps| are_taps(&taps).then_some(taps)))?,
        lane: keys.get(
            "lane",
            toml_keys::text("the name of the lane head's output"),
        )?,
        size: keys.get("size", size.of(|size| sides(&size).map(|_| size)))?,
        mean: keys.get("mean", mean.of(|mean| is_mean(&mean).then_some(mean)))?,
        std: keys.get("std", std.of(|std| is_std(&std).then_some(std)))?,
        crop: keys.get("crop", crop.of(|crop| is_crop(&crop).then_some(crop)))?,
    })
}

/// Mean and standard deviation that leave values from 0 to 255.
const BYTES: ([f32; 3], [f32; 3]) = ([0.0; 3], [1.0 / 255.0; 3]);

/// What is wanted for each option.
const TAPS: &str = "one to three distinct names of values";
const SIZE: &str = "WxH pixels, each from 16 to 4096";
const MEAN: &str = "three means from 0 to 1, for values from 0 to 1 (divide by 255)";
const STD: &str =
    "three standard deviations above 0 up to 1, for values from 0 to 1 (divide by 255)";
const CROP: &str = "left, top, width and height inside the picture, as shares from 0 to 1";

fn are_taps(taps: &[String]) -> bool {
    let twice = (1..taps.len()).any(|i| taps[..i].contains(&taps[i]));
    (1..=TAPS_MAX).contains(&taps.len()) && !twice && taps.iter().all(|tap| !tap.is_empty())
}

fn sides(size: &str) -> Option<(u32, u32)> {
    let side = |side: &str| side.parse().ok().filter(|s| (16..=4_096).contains(s));
    let (width, height) = size.split_once('x')?;
    Some((side(width)?, side(height)?))
}

fn is_mean(mean: &[f32; 3]) -> bool {
    mean.iter().all(|m| (0.0..=1.0).contains(m))
}

fn is_std(std: &[f32; 3]) -> bool {
    std.iter().all(|s| s.is_normal() && (0.0..=1.0).contains(s))
}

fn is_crop(&[left, top, width, height]: &[f64; 4]) -> bool {
    let inside =
        |from: f64, length: f64| from >= 0.0 && length > 0.0 && from + length <= 1.0 + 1e-9;
    inside(left, width) && inside(top, height)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn complaint(options: &str) -> String {
        let options = read_options(Path::new("m.toml"), options);
        options
            .and_then(|o| ModelSpec::checked("m.onnx".into(), Cow::Borrowed(b""), Vec::new(), o))
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn what_is_missing_is_said() {
        let rest = "size = \"32x16\"\nmean = [0, 0, 0]\nstd = [1, 1, 1]\n";
        for (options, part) in [
            (rest.to_owned(), "--taps"),
            (
                "taps = [\"a\"]\nmean = [0, 0, 0]\nstd = [1, 1, 1]".to_owned(),
                "--size",
            ),
            ("taps = [\"a\"]\nsize = \"32x16\"".to_owned(), "--mean"),
            (
                format!("taps = [\"a\"]\nlane = \"a\"\n{rest}"),
                "the lane output a is one of the taps",
            ),
        ] {
            let said = complaint(&options);
            assert!(said.contains(part), "{said}");
        }
    }

    #[test]
    fn what_is_wrong_in_a_file_is_said_with_its_line_what_was_found_and_what_would_do() {
        for (line, said) in [
            (
                "tips = [\"a\"]",
                "unknown key tips; wanted taps, lane, size, mean, std or crop",
            ),
            (
                "taps = \"a\"",
                "taps = \"a\"; wanted a list of one to three distinct names of values",
            ),
            ("taps = []", "taps = []; wanted a list of one to three"),
            (
                "taps = [\"a\", \"a\"]",
                "taps = [\"a\", \"a\"]; wanted a list of one to three distinct",
            ),
            (
                "taps = [\"a\", \"b\", \"c\", \"d\"]",
                "wanted a list of one to three",
            ),
            ("taps = [\"a\", 1]", "taps = [\"a\", 1]; wanted a list"),
            ("lane = 1", "lane = 1; wanted the name"),
            (
                "size = 320",
                "size = 320; wanted WxH pixels, each from 16 to 4096",
            ),
            ("size = \"9x9\"", "size = \"9x9\"; wanted WxH"),
            ("mean = 0.5", "mean = 0.5; wanted three means from 0 to 1"),
            ("mean = [0, 0]", "mean = [0, 0]; wanted three means"),
            (
                "mean = [0, 0, \"0\"]",
                "mean = [0, 0, \"0\"]; wanted three means",
            ),
            ("mean = [90, 90, 90]", "(divide by 255)"),
            (
                "std = [1, 0, 1]",
                "std = [1, 0, 1]; wanted three standard deviations above 0",
            ),
            (
                "crop = [0, 0.6, 1, 0.6]",
                "crop = [0, 0.6, 1, 0.6]; wanted left, top, width and height",
            ),
            ("crop = [0, 0, 1]", "crop = [0, 0, 1]; wanted left"),
            ("size = ", "not TOML: "),
        ] {
            let complaint = complaint(&format!("# What to feed it.\n{line}\n"));
            assert!(
                complaint.starts_with("m.toml:2: ") && complaint.contains(said),
                "{complaint}"
            );
        }
    }

    #[test]
    fn what_is_wrong_on_the_command_line_is_said_too() {
        let spec = |typed| {
            let refused = ModelSpec::new(None, typed).unwrap_err();
            refused.to_string()
        };
        let nothing = ModelOptions::default;
        let taps = Some(["a", "a"].map(str::to_owned).to_vec());
        for (typed, said) in [
            (
                ModelOptions { taps, ..nothing() },
                "taps a,a; wanted one to three distinct",
            ),
            (
                ModelOptions {
                    size: Some("3".to_owned()),
                    ..nothing()
                },
                "size 3; wanted WxH",
            ),
            (
                ModelOptions {
                    mean: Some([2.0; 3]),
                    ..nothing()
                },
                "mean [2.0, 2.0, 2.0]; wanted",
            ),
            (
                ModelOptions {
                    std: Some([0.0; 3]),
                    ..nothing()
                },
                "std [0.0, 0.0, 0.0]; wanted",
            ),
            (
                ModelOptions {
                    crop: Some([0.5; 4]),
                    ..nothing()
                },
                "",
            ),
            (
                ModelOptions {
                    crop: Some([0.6; 4]),
                    ..nothing()
                },
                "crop [0.6, 0.6, 0.6, 0.6]; wanted",
            ),
        ] {
            if said.is_empty() {
                assert!(ModelSpec::new(None, typed).is_ok());
            } else {
                let refused = spec(typed);
                assert!(refused.contains(said), "{refused}");
            }
        }
    }

    #[test]
    fn the_built_in_model_is_complete() {
        let spec = ModelSpec::new(None, ModelOptions::default()).unwrap();
        assert_eq!(spec.taps, ["e2", "e3", "e4"]);
        assert_eq!(spec.lane.as_deref(), Some("lane"));
    }
}
