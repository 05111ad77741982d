//! Frame → energy maps of the tapped blocks: preprocessing, encoder and attention in one stage with its buffers.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::capture::Picture;
use crate::capture::pixels::Pixels;
use crate::capture::undefined::Undefined;
use crate::features::attention::{EnergyMap, common_size, energy_from_features};
use crate::features::image_quality::{ImageQuality, QualityMeter};
use crate::features::lane::LaneMask;
use crate::model::encoder::{Encoder, EncoderError, EncoderSession, FeatureMap};
use crate::model::preprocess::{Preprocessing, Preprocessor};
use crate::model::vectors::{Vectors, turned};

/// Called with the name of each stage of the chain when a frame has passed it: `health`, `preprocess`, `quality`,
/// `encoder`, `energy`, `histogram`, `detector`.
pub type StageDone<'a> = dyn FnMut(&'static str) + 'a;

/// Picture → encoder input → feature maps → energy maps, for one thread. Keeps its buffers.
pub struct EnergyStage {
    preprocessor: Preprocessor,
    meter: QualityMeter,
    quality: ImageQuality,
    session: EncoderSession,
    taps: Vec<String>,
    common: (usize, usize),
    maps: Vec<EnergyMap>,
    means: Vec<BlockMeans>,
    lane: Option<LaneMask>,
}

/// Number of rows, and of columns, of the coarse grid of cells over a block's map.
pub const GRID: usize = 4;
/// Number of cells of the grid.
pub const CELLS: usize = GRID * GRID;

/// What one block finds in a picture: for each channel over the whole map, and for each cell over all channels.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BlockMeans {
    /// `[channels]`, mean activation.
    pub activation: Vec<f64>,
    /// `[channels + CELLS]`: mean squared activation of each channel; then, row by row of the grid, the power mean with
    /// exponent 1/4 of the channels' mean squared activations in each cell. Because of the small exponent, weak
    /// channels have an influence. With a plain mean, or without cells, most dirt on the lens is missed.
    pub energy: Vec<f64>,
}

impl EnergyStage {
    /// A stage for one encoder and its preprocessing.
    ///
    /// # Errors
    /// When the encoder's state cannot be set up.
    pub fn new(encoder: &Encoder, preprocessing: &Preprocessing) -> Result<Self, EncoderError> {
        Ok(Self {
            preprocessor: Preprocessor::new(preprocessing),
            meter: QualityMeter::new(preprocessing),
            quality: ImageQuality::default(),
            session: encoder.session()?,
            taps: encoder.taps().to_vec(),
            common: common_size(preprocessing.width, preprocessing.height),
            maps: vec![EnergyMap::default(); encoder.taps().len()],
            means: vec![BlockMeans::default(); encoder.taps().len()],
            lane: encoder.has_lane().then(LaneMask::default),
        })
    }

    /// The size of all maps after resampling, width and height.
    pub fn common_size(&self) -> (usize, usize) {
        self.common
    }

    /// Energy maps of a picture, one for each tap, each at the size of its block.
    ///
    /// # Errors
    /// Why the picture cannot be judged.
    pub fn energies_of(&mut self, pixels: &Pixels) -> Result<&[EnergyMap], Undefined> {
        self.energies_step_by_step(pixels, &mut |_| {})
    }

    /// Like [`energies_of`](Self::energies_of); `done` is called with the name of each completed stage.
    ///
    /// # Errors
    /// Why the picture cannot be judged.
    pub fn energies_step_by_step(
        &mut self,
        pixels: &Pixels,
        done: &mut StageDone<'_>,
    ) -> Result<&[EnergyMap], Undefined> {
        let input = self.preprocessor.input(pixels)?;
        done("preprocess");
        self.quality = self.meter.measure(input);
        done("quality");
        let features = self.session.run(input).map_err(Undefined::Encoder)?;
        done("encoder");
        let blocks = self.maps.iter_mut().zip(&mut self.means);
        for ((tap, features), (map, means)) in self.taps.iter().zip(features.iter()).zip(blocks) {
            energy_from_features(tap, features, map)?;
            means.take(features);
        }
        done("energy");
        if let (Some(lane), Some(logits)) = (&mut self.lane, features.get(self.taps.len())) {
            lane.read(logits);
        }
        Ok(&self.maps)
    }

    /// Means of the last picture that was judged, one entry for each tap.
    pub fn means(&self) -> &[BlockMeans] {
        &self.means
    }

    /// Energy maps of the last picture that was judged.
    pub fn maps(&self) -> &[EnergyMap] {
        &self.maps
    }

    /// How good the last picture was in which something could be seen.
    pub fn quality(&self) -> ImageQuality {
        self.quality
    }

    /// The last picture as the encoder saw it.
    pub fn seen(&self) -> Picture {
        self.preprocessor.seen()
    }

    /// The lane head's output for the last picture that was judged; `None` if the encoder was loaded without a lane
    /// head.
    pub fn lane(&self) -> Option<&LaneMask> {
        self.lane.as_ref()
    }
}

impl BlockMeans {
    /// Calculates the means of a block's feature map; allocates only if the number of channels changes.
    pub fn take(&mut self, features: &FeatureMap<'_>) {
        Vectors::fastest().vectorised(
            #[inline(always)]
            || self.take_with_vectors(features),
        );
    }

    #[inline(always)]
    fn take_with_vectors(&mut self, features: &FeatureMap<'_>) {
        let [channels, height, width] = features.shape;
        self.activation.resize(channels, 0.0);
        self.energy.resize(channels + CELLS, 0.0);
        let cells = Cells::new(height, width);
        self.energy[channels..].fill(0.0);
        let map = (height * width).max(1);
        let mut pairs = features.activations.chunks_exact(2 * map);
        for (pair, maps) in pairs.by_ref().enumerate() {
            let (first, second) = maps.split_at(map);
            for (n, sums) in cells.sums([first, second]).iter().enumerate() {
                self.set(2 * pair + n, sums, &cells);
            }
        }
        if let Some(last) = channels.checked_sub(1)
            && let Some(only) = pairs.remainder().get(..map)
        {
            let [sums] = cells.sums([only]);
            self.set(last, &sums, &cells);
        }
        for cell in &mut self.energy[channels..] {
            *cell = (*cell * reciprocal(channels)).powi(4);
        }
    }

    /// Stores one channel, and adds its share to the cells.
    #[inline(always)]
    fn set(&mut self, channel: usize, sums: &[CellSums; GRID], cells: &Cells) {
        let pixels = reciprocal(cells.height * cells.width);
        let (of_channels, of_cells) = self.energy.split_at_mut(self.activation.len());
        let values = sums.iter().flat_map(|row| row.values);
        self.activation[channel] = values.sum::<f64>() * pixels;
        let squares = || sums.iter().flat_map(|row| row.squares);
        of_channels[channel] = squares().sum::<f64>() * pixels;
        for ((cell, square), pixels) in of_cells.iter_mut().zip(squares()).zip(cells.reciprocals) {
            *cell += (square * pixels).sqrt().sqrt();
        }
    }
}

/// The coarse grid over maps of one size: column x of a map is in column `x GRID / width` of the grid, and the same for
/// rows.
struct Cells {
    height: usize,
    width: usize,
    columns: [Range<usize>; GRID],
    /// Reciprocals of the numbers of pixels, row by row.
    reciprocals: [f64; CELLS],
}

/// Sums of values, and of their squares, in the cells of one row of the grid.
#[derive(Clone, Copy, Default)]
struct CellSums {
    values: [f64; GRID],
    squares: [f64; GRID],
}

impl CellSums {
    #[inline(always)]
    fn add(&mut self, cell: usize, value: f32) {
        let value = f64::from(value);
        self.values[cell] += value;
        self.squares[cell] += value * value;
    }
}

impl Cells {
    #[inline(always)]
    fn new(height: usize, width: usize) -> Self {
        let columns: [_; GRID] =
            std::array::from_fn(|cell| edge(cell, width)..edge(cell + 1, width));
        let rows = |cell: usize| edge(cell + 1, height) - edge(cell, height);
        let reciprocals =
            std::array::from_fn(|cell| reciprocal(rows(cell / GRID) * columns[cell % GRID].len()));
        Self {
            height,
            width,
            columns,
            reciprocals,
        }
    }

    /// Sums of the maps of some channels. Channels are added up side by side, because each sum must wait for its
    /// previous addition.
    #[inline(always)]
    fn sums<const N: usize>(&self, maps: [&[f32]; N]) -> [[CellSums; GRID]; N] {
        let mut sums = [[CellSums::default(); GRID]; N];
        for row in 0..GRID {
            let rows = edge(row, self.height)..edge(row + 1, self.height);
            let mut own = [CellSums::default(); N];
            for y in rows {
                let rows = maps.map(|map| &map[y * self.width..][..self.width]);
                self.add_row(&rows, &mut own);
            }
            for (sums, own) in sums.iter_mut().zip(own) {
                sums[row] = own;
            }
        }
        sums
    }

    #[inline(always)]
    fn add_row<const N: usize>(&self, rows: &[&[f32]; N], sums: &mut [CellSums; N]) {
        let width = self.columns[0].len();
        let alike = self.columns.iter().all(|columns| columns.len() == width);
        let turned_up_to = if alike { width - width % 4 } else { 0 };
        for x in (0..turned_up_to).step_by(4) {
            for (row, sums) in rows.iter().zip(&mut *sums) {
                let of_cell = |cell: usize| {
                    let four = &row[cell * width + x..][..4];
                    [four[0], four[1], four[2], four[3]]
                };
                for values in turned([of_cell(0), of_cell(1), of_cell(2), of_cell(3)]) {
                    for (cell, value) in values.into_iter().enumerate() {
                        sums.add(cell, value);
                    }
                }
            }
        }
        for (cell, columns) in self.columns.iter().enumerate() {
            for x in columns.start + turned_up_to..columns.end {
                for (row, sums) in rows.iter().zip(&mut *sums) {
                    sums.add(cell, row[x]);
                }
            }
        }
    }
}

/// Where a cell of the grid begins on a side of a map.
fn edge(cell: usize, length: usize) -> usize {
    (cell * length).div_ceil(GRID)
}

/// `1 / count`; 0 if `count` is 0.
fn reciprocal(count: usize) -> f64 {
    // Sizes of feature maps are far below 2^52.
    #[allow(clippy::cast_precision_loss)]
    if count == 0 { 0.0 } else { 1.0 / count as f64 }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp, clippy::cast_precision_loss)]
    use super::*;

    fn means(shape: [usize; 3], activations: &[f32]) -> BlockMeans {
        let mut means = BlockMeans::default();
        means.take(&FeatureMap { shape, activations });
        means
    }

    #[test]
    fn channels_and_cells_by_hand() {
        // Two channels of 4x8: one is 2 everywhere, and the other is 16 only in the last cell (columns 6 and 7 of row
        // 3).
        let mut maps = vec![2.0; 32];
        maps.extend([0.0; 30]);
        maps.extend([16.0; 2]);
        let means = means([2, 4, 8], &maps);
        assert_eq!(means.activation, [2.0, 1.0]);
        assert_eq!(means.energy[..2], [4.0, 16.0]);
        // Fourth roots of 4 and 0, and of 4 and 256, averaged over the channels.
        let first = (2_f64.sqrt() / 2.0).powi(4);
        let last = ((2_f64.sqrt() + 4.0) / 2.0).powi(4);
        assert!((means.energy[2] - first).abs() < 1e-12);
        assert!((means.energy[17] - last).abs() < 1e-9);
        assert_eq!(means.energy.len(), 2 + CELLS);
    }

    #[test]
    fn every_set_of_instructions_comes_to_the_same_bits() {
        for shape in [[5, 20, 40], [2, 9, 33], [1, 4, 12]] {
            let values = (0..shape.iter().product()).map(|i| (i as f32 * 0.7).sin());
            let activations = &values.collect::<Vec<f32>>()[..];
            let of_kernel = |kernel: Vectors| {
                let mut means = BlockMeans::default();
                kernel.vectorised(
                    #[inline(always)]
                    || means.take_with_vectors(&FeatureMap { shape, activations }),
                );
                means
            };
            for kernel in Vectors::available() {
                assert_eq!(
                    of_kernel(kernel),
                    of_kernel(Vectors::Portable),
                    "{kernel:?}"
                );
            }
        }
    }

    #[test]
    fn maps_of_any_shape_have_finite_means() {
        for shape in [[1, 1, 1], [3, 1, 4096], [2, 3, 5], [1, 5, 2], [2, 7, 9]] {
            let pixels = shape[1] * shape[2];
            let maps: Vec<f32> = (0..shape[0] * pixels).map(|i| (i % 7) as f32).collect();
            let means = means(shape, &maps);
            assert!(means.energy.iter().all(|e| e.is_finite() && *e >= 0.0));
            for (map, &energy) in maps.chunks(pixels).zip(&means.energy) {
                let wanted = map.iter().map(|a| f64::from(a * a)).sum::<f64>() / pixels as f64;
                assert!((energy - wanted).abs() <= 1e-12 * wanted, "{shape:?}");
            }
        }
        let huge = means([1, 4, 4], &[f32::MAX; 16]);
        assert!(huge.energy.iter().all(|e| e.is_finite()));
    }
}
