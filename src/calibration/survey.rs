//! Whole sources as seen by the encoder: the input of `calibrate` and `compare`.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::capture::undefined::Undefined;
use crate::capture::{SourceError, open};
use crate::features::attention::{EnergyMap, Upsampler};
use crate::features::energies::{BlockMeans, EnergyStage};
use crate::model::encoder::{Encoder, EncoderError};
use crate::model::preprocess::Preprocessing;

pub mod store;

/// What the encoder saw of a source.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Survey {
    /// As typed.
    pub source: String,
    /// When each frame was taken.
    pub times: Vec<Duration>,
    /// For every frame, in order: what the encoder saw, or why it saw nothing.
    pub frames: Vec<Result<SurveyFrame, Undefined>>,
    /// Size that maps are resampled to, width and height.
    pub common_size: (usize, usize),
}

/// One frame of a survey.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SurveyFrame {
    /// Energy maps of the blocks, each at the size of its block; empty if only means are kept.
    pub maps: Vec<EnergyMap>,
    /// Largest energy of each block at its own size.
    pub peaks: Vec<f64>,
    /// Means of each block.
    pub means: Vec<BlockMeans>,
}

/// What a survey keeps of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keep {
    /// Energy maps and means: about 20 KB for each frame of the built-in model.
    Maps,
    /// Only means: about 4 KB for each frame.
    Means,
}

impl Keep {
    /// Largest number of frames in memory at a time: of all sources that are compared, or of one drive in calibration.
    pub const fn frames_max(self) -> u64 {
        match self {
            Self::Maps => 100_000,
            Self::Means => 600_000,
        }
    }
}

/// A source that could not be surveyed.
#[derive(Debug, thiserror::Error)]
pub enum SurveyError {
    /// The source failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The encoder failed.
    #[error(transparent)]
    Encoder(#[from] EncoderError),
    /// A picture of a set cannot be read.
    #[error("{0}")]
    Picture(String),
}

impl SurveyFrame {
    /// The last picture that a stage has processed.
    pub fn of(stage: &EnergyStage, keep: Keep) -> Self {
        Self {
            maps: match keep {
                Keep::Maps => stage.maps().to_vec(),
                Keep::Means => Vec::new(),
            },
            peaks: stage.maps().iter().map(|map| map.range().1).collect(),
            means: stage.means().to_vec(),
        }
    }
}

impl Survey {
    /// Looks at every frame of a source; `seen` is called after each.
    ///
    /// # Errors
    /// When the source or the encoder fails, or when a picture cannot be read: a set is measured completely or not at
    /// all.
    pub fn of(
        source: &str,
        encoder: &Encoder,
        preprocessing: &Preprocessing,
        keep: Keep,
        seen: &(dyn Fn() + Sync),
    ) -> Result<Self, SurveyError> {
        let mut stage = EnergyStage::new(encoder, preprocessing)?;
        let mut frames_of = open(source)?;
        let (mut times, mut frames) = (Vec::new(), Vec::new());
        while let Some(frame) = frames_of.next_frame()? {
            if let Err(error) = &frame.picture {
                return Err(SurveyError::Picture(error.to_string()));
            }
            times.push(frame.captured_at);
            let judged = frame
                .pixels()
                .and_then(|pixels| stage.energies_of(pixels).map(|_| ()));
            frames.push(judged.map(|()| SurveyFrame::of(&stage, keep)));
            seen();
        }
        Ok(Self {
            source: source.to_owned(),
            times,
            frames,
            common_size: stage.common_size(),
        })
    }

    /// The maps of one tap at the common size, frame by frame; the survey must have kept them.
    ///
    /// # Errors
    /// In each item, why a frame has no map.
    pub fn common_maps(
        &self,
        tap: usize,
    ) -> impl Iterator<Item = Result<EnergyMap, Undefined>> + '_ {
        let mut upsampler: Option<Upsampler> = None;
        self.frames.iter().map(move |energies| {
            let map = &energies.as_ref().map_err(Undefined::clone)?.maps[tap];
            let upsampler = upsampler
                .get_or_insert_with(|| Upsampler::new((map.width, map.height), self.common_size));
            let mut common = EnergyMap::default();
            upsampler.resample(map, &mut common);
            Ok(common)
        })
    }
}
