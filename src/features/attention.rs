//! Feature maps → energy maps: where the encoder looks.
//!
//! Everything from here on has 64 bits. Activations are 32-bit floats, so their squares and sums can neither overflow
//! nor underflow, and no later comparison has to know the scale of a model.

use serde::{Deserialize, Serialize};

use crate::capture::undefined::Undefined;
use crate::model::encoder::FeatureMap;
use crate::model::vectors::Vectors;

/// Energy of one block, `[height, width]`, row by row; finite, never negative, and not everywhere the same.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EnergyMap {
    /// Cells in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height, width]`, squared activation units.
    pub energy: Vec<f64>,
}

impl EnergyMap {
    /// Smallest and largest energy.
    pub fn range(&self) -> (f64, f64) {
        self.energy
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &g| {
                (low.min(g), high.max(g))
            })
    }
}

/// Sums the squared activations over the channels: `g(p) = sum_c A_c(p)^2`.
///
/// - `features`: `[C, h, w]`, activations of any sign
/// - `map`: `[h, w]`, written in place; allocates only when its size changes
///
/// # Errors
/// `NotFinite` at the first NaN or infinity, `ConstantMap` if every cell has the same energy.
///
/// Source: Zagoruyko and Komodakis 2017 (sum of squares over channels); G2sum in Hou et al. 2019.
pub fn energy_from_features(
    tap: &str,
    features: &FeatureMap<'_>,
    map: &mut EnergyMap,
) -> Result<(), Undefined> {
    let [_, height, width] = features.shape;
    let cells = height * width;
    (map.width, map.height) = (width, height);
    map.energy.clear();
    map.energy.resize(cells, 0.0);
    Vectors::fastest().vectorised(
        #[inline(always)]
        || {
            for channel in features.activations.chunks_exact(cells) {
                for (energy, &activation) in map.energy.iter_mut().zip(channel) {
                    let activation = f64::from(activation);
                    *energy += activation * activation;
                }
            }
        },
    );
    if let Some(cell) = map.energy.iter().position(|g| !g.is_finite()) {
        let channel = features
            .activations
            .iter()
            .skip(cell)
            .step_by(cells)
            .position(|a| !a.is_finite());
        return Err(Undefined::NotFinite {
            tap: tap.to_owned(),
            channel: channel.unwrap_or_default(),
            row: cell / width,
            column: cell % width,
        });
    }
    match map.range() {
        (low, high) if low < high => Ok(()),
        _ => Err(Undefined::ConstantMap),
    }
}

/// The common size of all maps of an encoder: a quarter of its input in each direction.
pub fn common_size(input_width: u32, input_height: u32) -> (usize, usize) {
    ((input_width / 4) as usize, (input_height / 4) as usize)
}

/// Resamples energy maps to the common size, bilinearly with half-pixel centres (`align_corners = false`).
#[derive(Clone, Debug)]
pub struct Upsampler {
    columns: Vec<Tap>,
    rows: Vec<Tap>,
}

/// A weighted pair of neighbours.
#[derive(Clone, Copy, Debug)]
struct Tap {
    near: usize,
    far: usize,
    share_of_far: f64,
}

impl Upsampler {
    /// An upsampler from maps of size `from` (width, height) to maps of size `to`.
    pub fn new(from: (usize, usize), to: (usize, usize)) -> Self {
        Self {
            columns: taps(from.0, to.0),
            rows: taps(from.1, to.1),
        }
    }

    /// Writes the resampled map in place; allocates only when its size changes.
    pub fn resample(&self, map: &EnergyMap, common: &mut EnergyMap) {
        (common.width, common.height) = (self.columns.len(), self.rows.len());
        common.energy.clear();
        for row in &self.rows {
            let near = &map.energy[row.near * map.width..][..map.width];
            let far = &map.energy[row.far * map.width..][..map.width];
            common.energy.extend(self.columns.iter().map(|column| {
                let across = |line: &[f64]| {
                    line[column.near] + column.share_of_far * (line[column.far] - line[column.near])
                };
                let (near, far) = (across(near), across(far));
                near + row.share_of_far * (far - near)
            }));
        }
    }
}

fn taps(from: usize, to: usize) -> Vec<Tap> {
    // Sizes are those of feature maps: far below 2^52.
    #[allow(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )]
    (0..to)
        .map(|i| {
            let at =
                ((i as f64 + 0.5) * from as f64 / to as f64 - 0.5).clamp(0.0, (from - 1) as f64);
            let near = (at.floor() as usize).min(from - 1);
            Tap {
                near,
                far: (near + 1).min(from - 1),
                share_of_far: at - near as f64,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    fn energy(shape: [usize; 3], activations: &[f32]) -> Result<Vec<f64>, Undefined> {
        let mut map = EnergyMap::default();
        energy_from_features("e2", &FeatureMap { shape, activations }, &mut map)
            .map(|()| map.energy)
    }

    #[test]
    fn energy_is_the_sum_of_squares_over_channels() {
        // Two channels of 1x3: (1, -2, 3) and (0, 4, -1).
        assert_eq!(
            energy([2, 1, 3], &[1.0, -2.0, 3.0, 0.0, 4.0, -1.0]).unwrap(),
            [1.0, 20.0, 10.0]
        );
    }

    #[test]
    fn activations_at_the_ends_of_f32_neither_overflow_nor_vanish() {
        let map = energy([1, 1, 3], &[f32::MAX, 1e-30, 0.0]).unwrap();
        assert_eq!(map[0], f64::from(f32::MAX).powi(2));
        assert!(map[1] > 9e-61 && map[2] == 0.0);
    }

    #[test]
    fn undefined_activations_are_named_with_their_place() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut activations = [1.0; 12];
            activations[6 + 5] = bad;
            assert_eq!(
                energy([2, 2, 3], &activations),
                Err(Undefined::NotFinite {
                    tap: "e2".into(),
                    channel: 1,
                    row: 1,
                    column: 2
                })
            );
        }
        assert_eq!(energy([3, 2, 2], &[0.0; 12]), Err(Undefined::ConstantMap));
        assert_eq!(energy([1, 2, 2], &[-2.0; 4]), Err(Undefined::ConstantMap));
    }

    #[test]
    fn upsampling_has_half_pixel_centres() {
        let map = EnergyMap {
            width: 2,
            height: 1,
            energy: vec![0.0, 8.0],
        };
        let mut common = EnergyMap::default();
        Upsampler::new((2, 1), (4, 2)).resample(&map, &mut common);
        // PyTorch: interpolate([0, 8], scale 2, align_corners=False) = [0, 2, 6, 8].
        assert_eq!(common.energy, [0.0, 2.0, 6.0, 8.0, 0.0, 2.0, 6.0, 8.0]);
    }

    #[test]
    fn a_map_of_the_common_size_stays_as_it_is() {
        let map = EnergyMap {
            width: 3,
            height: 2,
            energy: vec![1.0, 5.0, 2.0, 0.0, 7.0, 3.0],
        };
        let mut common = EnergyMap::default();
        Upsampler::new((3, 2), (3, 2)).resample(&map, &mut common);
        assert_eq!(common, map);
    }
}
