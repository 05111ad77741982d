//! Frame → energy maps of the tapped blocks: preprocessing, encoder and attention in one stage with its buffers.

use crate::attention::{EnergyMap, common_size, energy_from_features};
use crate::encoder::{Encoder, EncoderError, EncoderSession};
use crate::frame::{Frame, Picture};
use crate::lane::LaneMask;
use crate::preprocess::{Preprocessing, Preprocessor};
use crate::undefined::Undefined;

/// Picture → encoder input → feature maps → energy maps, for one thread. Keeps its buffers.
pub struct EnergyStage {
    preprocessor: Preprocessor,
    session: EncoderSession,
    taps: Vec<String>,
    common: (usize, usize),
    maps: Vec<EnergyMap>,
    lane: Option<LaneMask>,
}

impl EnergyStage {
    /// For one encoder and the way it is fed.
    ///
    /// # Errors
    /// When the encoder's state cannot be set up.
    pub fn new(encoder: &Encoder, preprocessing: &Preprocessing) -> Result<Self, EncoderError> {
        Ok(Self {
            preprocessor: Preprocessor::new(preprocessing),
            session: encoder.session()?,
            taps: encoder.taps().to_vec(),
            common: common_size(preprocessing.width, preprocessing.height),
            maps: vec![EnergyMap::default(); encoder.taps().len()],
            lane: encoder.has_lane().then(LaneMask::default),
        })
    }

    /// The size of all maps after resampling, width and height.
    pub fn common_size(&self) -> (usize, usize) {
        self.common
    }

    /// Energy maps of a frame, one a tap, each of its block's own size.
    ///
    /// # Errors
    /// Why this frame cannot be judged.
    pub fn energies(&mut self, frame: &Frame) -> Result<&[EnergyMap], Undefined> {
        let picture: &Picture = frame
            .picture
            .as_ref()
            .map_err(|error| Undefined::Corrupt(error.to_string()))?;
        self.energies_of(picture)
    }

    /// Energy maps of a picture, one a tap, each of its block's own size.
    ///
    /// # Errors
    /// Why it cannot be judged.
    pub fn energies_of(&mut self, picture: &Picture) -> Result<&[EnergyMap], Undefined> {
        let input = self.preprocessor.input(picture)?;
        let features = self.session.run(input).map_err(Undefined::Encoder)?;
        for ((tap, features), map) in self.taps.iter().zip(&features).zip(&mut self.maps) {
            energy_from_features(tap, features, map)?;
        }
        if let (Some(lane), Some(logits)) = (&mut self.lane, features.get(self.taps.len())) {
            lane.read(logits);
        }
        Ok(&self.maps)
    }

    /// What the encoder saw of the last picture.
    pub fn seen(&self) -> Picture {
        self.preprocessor.seen()
    }

    /// The lane head's answer to the last picture that was judged; `None` of an encoder loaded without it.
    pub fn lane(&self) -> Option<&LaneMask> {
        self.lane.as_ref()
    }
}
