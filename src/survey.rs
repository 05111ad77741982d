//! Whole sources through the encoder: what `calibrate` and `compare` work on.

use crate::attention::{EnergyMap, Upsampler};
use crate::encoder::{Encoder, EncoderError};
use crate::energies::EnergyStage;
use crate::frame::{SourceError, open};
use crate::preprocess::Preprocessing;
use crate::undefined::Undefined;

/// A source seen through the encoder.
#[derive(Debug)]
pub struct Survey {
    /// As typed.
    pub source: String,
    /// Of every frame, in order: energy maps of the blocks, each of its block's own size, or why there are none.
    pub frames: Vec<Result<Vec<EnergyMap>, Undefined>>,
    /// Size that maps are resampled to, width and height.
    pub common_size: (usize, usize),
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
    /// A picture of a set that is to be measured cannot be read.
    #[error("{0}")]
    Picture(String),
}

impl Survey {
    /// Looks at every frame of a source; `seen` is called after each.
    ///
    /// # Errors
    /// When the source or the encoder fails, and for a picture that cannot be read: a set is measured whole or not at all.
    pub fn of(
        source: &str,
        encoder: &Encoder,
        preprocessing: &Preprocessing,
        seen: &(dyn Fn() + Sync),
    ) -> Result<Self, SurveyError> {
        let mut stage = EnergyStage::new(encoder, preprocessing)?;
        let mut frames_of = open(source)?;
        let mut frames = Vec::new();
        while let Some(frame) = frames_of.next_frame()? {
            if let Err(error) = &frame.picture {
                return Err(SurveyError::Picture(error.to_string()));
            }
            frames.push(stage.energies(&frame).map(<[EnergyMap]>::to_vec));
            seen();
        }
        Ok(Self {
            source: source.to_owned(),
            frames,
            common_size: stage.common_size(),
        })
    }

    /// The maps of one tap at the common size, frame by frame.
    ///
    /// # Errors
    /// Item by item, why a frame has none.
    pub fn common_maps(
        &self,
        tap: usize,
    ) -> impl Iterator<Item = Result<EnergyMap, Undefined>> + '_ {
        let mut upsampler: Option<Upsampler> = None;
        self.frames.iter().map(move |energies| {
            let map = &energies.as_ref().map_err(Undefined::clone)?[tap];
            let upsampler = upsampler
                .get_or_insert_with(|| Upsampler::new((map.width, map.height), self.common_size));
            let mut common = EnergyMap::default();
            upsampler.resample(map, &mut common);
            Ok(common)
        })
    }
}
