//! What an encoder gives: the feature maps of one picture.

use std::ops::Deref;

use tract_onnx::prelude::*;

use super::guard::contained;
use super::inference::root;
use crate::model::TAPS_MAX;

/// Largest number of outputs of an encoder: the taps and the lane head.
const OUTPUTS_MAX: usize = TAPS_MAX + 1;

/// Activations of one tapped block.
#[derive(Clone, Copy)]
pub struct FeatureMap<'a> {
    /// Channels, height, width.
    pub shape: [usize; 3],
    /// `[channels, height, width]`, raw activations of any sign.
    pub activations: &'a [f32],
}

/// Feature maps of one picture, in the order of the taps, the lane head's logits last.
pub struct FeatureMaps<'a> {
    maps: [FeatureMap<'a>; OUTPUTS_MAX],
    count: usize,
}

impl<'a> FeatureMaps<'a> {
    /// Gathers maps in their order.
    ///
    /// # Errors
    /// The first error among them.
    pub fn collect(
        maps: impl Iterator<Item = Result<FeatureMap<'a>, String>>,
    ) -> Result<Self, String> {
        let nothing = FeatureMap {
            shape: [0; 3],
            activations: &[],
        };
        let mut all = [nothing; OUTPUTS_MAX];
        let mut count = 0;
        for (place, map) in all.iter_mut().zip(maps) {
            *place = map?;
            count += 1;
        }
        Ok(Self { maps: all, count })
    }
}

impl<'a> Deref for FeatureMaps<'a> {
    type Target = [FeatureMap<'a>];

    fn deref(&self) -> &Self::Target {
        &self.maps[..self.count]
    }
}

/// Runs a model in tract on `[3, H, W]`.
///
/// # Errors
/// What tract says, as text.
pub fn run_in_tract(
    state: &mut TypedSimpleState,
    shape: &[usize],
    input: &[f32],
) -> Result<TVec<TValue>, String> {
    let input = Tensor::from_shape(shape, input).map_err(|e| root(&e))?;
    contained(|| state.run(tvec!(input.into())))?.map_err(|e| root(&e))
}

/// An output of tract as a feature map.
///
/// # Errors
/// What it is instead, as text.
pub fn feature_map(output: &Tensor) -> Result<FeatureMap<'_>, String> {
    let [_, channels, height, width] = *output.shape() else {
        return Err(format!("a tap has shape {:?}", output.shape()));
    };
    let activations = output
        .try_as_plain_ram()
        .and_then(|plain| plain.as_slice::<f32>())
        .map_err(|e| root(&e))?;
    Ok(FeatureMap {
        shape: [channels, height, width],
        activations,
    })
}
