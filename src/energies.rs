//! Frame → energy maps of the tapped blocks: preprocessing, encoder and attention in one stage with its buffers.

use crate::attention::{EnergyMap, common_size, energy_from_features};
use crate::encoder::{Encoder, EncoderError, EncoderSession, FeatureMap};
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
    channels: Vec<ChannelMeans>,
    lane: Option<LaneMask>,
}

/// Means over the map of one block's channels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ChannelMeans {
    /// `[channels]`, mean activation.
    pub activation: Vec<f64>,
    /// `[channels]`, mean squared activation: the energy that the channel contributes to each cell.
    pub energy: Vec<f64>,
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
            channels: vec![ChannelMeans::default(); encoder.taps().len()],
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
        let blocks = self.maps.iter_mut().zip(&mut self.channels);
        for ((tap, features), (map, channels)) in self.taps.iter().zip(&features).zip(blocks) {
            energy_from_features(tap, features, map)?;
            channels.take(features);
        }
        if let (Some(lane), Some(logits)) = (&mut self.lane, features.get(self.taps.len())) {
            lane.read(logits);
        }
        Ok(&self.maps)
    }

    /// Channel means of the last picture that was judged, one entry a tap.
    pub fn channels(&self) -> &[ChannelMeans] {
        &self.channels
    }

    /// Energy maps of the last picture that was judged.
    pub fn maps(&self) -> &[EnergyMap] {
        &self.maps
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

impl ChannelMeans {
    /// Takes over a block's feature map; allocates only when the number of channels changes.
    pub fn take(&mut self, features: &FeatureMap<'_>) {
        let [channels, height, width] = features.shape;
        let cells = (height * width).max(1);
        // Sizes of feature maps are far below 2^52.
        #[allow(clippy::cast_precision_loss)]
        let share = 1.0 / cells as f64;
        self.activation.resize(channels, 0.0);
        self.energy.resize(channels, 0.0);
        let means = self.activation.iter_mut().zip(&mut self.energy);
        for (channel, (activation, energy)) in features.activations.chunks_exact(cells).zip(means) {
            let (sum, squares) = channel.iter().fold((0.0, 0.0), |(sum, squares), &a| {
                let a = f64::from(a);
                (sum + a, squares + a * a)
            });
            (*activation, *energy) = (sum * share, squares * share);
        }
    }
}
