//! The output of the lane model: its lane mask, how well that fits the truth, and how much of the encoder's energy is
//! on lanes. This is not used in the car: it measures models, and not roads.

use serde::{Deserialize, Serialize};

use crate::features::attention::EnergyMap;
use crate::model::encoder::FeatureMap;

/// Where there is lane, `[height, width]`, row by row.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LaneMask {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height, width]`, true on a lane line.
    pub lane: Vec<bool>,
}

impl LaneMask {
    /// The mask of a label image: `labels` is `[height, width]`, 0 where there is no lane.
    pub fn of_labels(width: usize, labels: &[u8]) -> Self {
        Self {
            width,
            height: labels.len() / width.max(1),
            lane: labels.iter().map(|&label| label != 0).collect(),
        }
    }

    /// Reads the lane head's output: there is lane where the logit is above 0.
    pub fn read(&mut self, logits: &FeatureMap<'_>) {
        let [_, height, width] = logits.shape;
        (self.width, self.height) = (width, height);
        self.lane.clear();
        let first = &logits.activations[..height * width];
        self.lane.extend(first.iter().map(|&logit| logit > 0.0));
    }

    /// The mask with lanes in rows `from..to` alone.
    #[must_use]
    pub fn in_rows(&self, from: usize, to: usize) -> Self {
        let mut lane = vec![false; self.lane.len()];
        let own = self.width * from.min(self.height)..self.width * to.min(self.height);
        lane[own.clone()].copy_from_slice(&self.lane[own]);
        Self { lane, ..*self }
    }

    /// Share of the mask that is lane.
    pub fn area(&self) -> f64 {
        share(
            self.lane.iter().filter(|&&lane| lane).count(),
            self.lane.len(),
        )
    }

    /// Share of each cell of a map `size` (width, height) that is lane: the mask's mean over the cell's pixels.
    fn shares(&self, size: (usize, usize)) -> Vec<f64> {
        let edge = |cell: usize, cells: usize, pixels: usize| cell * pixels / cells;
        let mut shares = Vec::with_capacity(size.0 * size.1);
        for row in 0..size.1 {
            let rows = edge(row, size.1, self.height)..edge(row + 1, size.1, self.height);
            for column in 0..size.0 {
                let columns =
                    edge(column, size.0, self.width)..edge(column + 1, size.0, self.width);
                let lane = rows
                    .clone()
                    .map(|y| &self.lane[y * self.width..][columns.clone()])
                    .map(|pixels| pixels.iter().filter(|&&lane| lane).count())
                    .sum();
                shares.push(share(lane, rows.len() * columns.len()));
            }
        }
        shares
    }
}

/// Within this many pixels of a mask that is 320 pixels wide, an output agrees with the truth.
pub const TOLERANCE_320_PX: f64 = 2.0;

/// How well an output agrees with the truth within [`TOLERANCE_320_PX`]: thin lines that lie next to each other agree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Agreement {
    /// Lane pixels of the output near a lane pixel of the truth.
    pub right: u64,
    /// Lane pixels of the output.
    pub answer: u64,
    /// Lane pixels of the truth near a lane pixel of the output.
    pub found: u64,
    /// Lane pixels of the truth.
    pub truth: u64,
}

impl Agreement {
    /// The agreement of an output with the truth of the same size; no output counts as one without lane.
    pub fn of(answer: Option<&LaneMask>, truth: &LaneMask) -> Self {
        let none = vec![false; truth.lane.len()];
        let answer = answer.map_or(none.as_slice(), |mask| &mask.lane);
        let near_truth = grown(&truth.lane, truth.width);
        let near_answer = grown(answer, truth.width);
        let lanes = |lane: &[bool]| lane.iter().filter(|&&lane| lane).count() as u64;
        let shared = |lane: &[bool], near: &[bool]| {
            let both = lane.iter().zip(near);
            both.filter(|&(&lane, &near)| lane && near).count() as u64
        };
        Self {
            right: shared(answer, &near_truth),
            answer: lanes(answer),
            found: shared(&truth.lane, &near_answer),
            truth: lanes(&truth.lane),
        }
    }

    /// The counts of all together.
    pub fn pooled(all: impl Iterator<Item = Self>) -> Self {
        all.fold(Self::default(), |sum, one| Self {
            right: sum.right + one.right,
            answer: sum.answer + one.answer,
            found: sum.found + one.found,
            truth: sum.truth + one.truth,
        })
    }

    /// Share of the output's lane pixels that are right; `None` if there are none.
    pub fn precision(self) -> Option<f64> {
        (self.answer > 0).then(|| ratio(self.right, self.answer))
    }

    /// Share of the true lane pixels that are found; `None` if there are none.
    pub fn recall(self) -> Option<f64> {
        (self.truth > 0).then(|| ratio(self.found, self.truth))
    }

    /// Harmonic mean of precision and recall; 0 if no lane is found, `None` without lanes in the truth.
    pub fn f1(self) -> Option<f64> {
        let recall = self.recall()?;
        let precision = self.precision().unwrap_or(0.0);
        let sum = precision + recall;
        Some(if sum > 0.0 {
            2.0 * precision * recall / sum
        } else {
            0.0
        })
    }
}

/// A mask of rows of `width` pixels with all pixels within the tolerance of its lanes.
#[allow(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss
)]
fn grown(lane: &[bool], width: usize) -> Vec<bool> {
    let height = lane.len() / width.max(1);
    let reach = (TOLERANCE_320_PX * width as f64 / 320.0).max(0.0);
    let whole = reach as usize;
    let mut grown = vec![false; lane.len()];
    for (pixel, _) in lane.iter().enumerate().filter(|&(_, &lane)| lane) {
        let (x, y) = (pixel % width, pixel / width);
        for row in y.saturating_sub(whole)..(y + whole + 1).min(height) {
            let up = row.abs_diff(y) as f64;
            let along = (reach * reach - up * up).max(0.0).sqrt() as usize;
            let columns = x.saturating_sub(along)..(x + along + 1).min(width);
            grown[row * width..][columns].fill(true);
        }
    }
    grown
}

// Counts of pixels are far below 2^52.
#[allow(clippy::cast_precision_loss)]
fn ratio(part: u64, whole: u64) -> f64 {
    part as f64 / whole as f64
}

/// Number of lane pixels that two masks have in common, and that at least one of them has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Overlap {
    /// In both masks.
    pub both: u64,
    /// In at least one of them.
    pub either: u64,
}

impl Overlap {
    /// The overlap of an output with the truth of the same size; no output counts as one without lane.
    pub fn of(answer: Option<&LaneMask>, truth: &LaneMask) -> Self {
        let answer = answer.map_or(&[][..], |mask| &mask.lane);
        let answer = answer.iter().copied().chain(std::iter::repeat(false));
        let mut overlap = Self::default();
        for (answer, &truth) in answer.zip(&truth.lane) {
            overlap.both += u64::from(answer && truth);
            overlap.either += u64::from(answer || truth);
        }
        overlap
    }

    /// Intersection over union, pooled over all; `None` if there is no lane in any mask.
    pub fn iou(all: impl Iterator<Item = Self>) -> Option<f64> {
        let sum = all.fold(Self::default(), |sum, one| Self {
            both: sum.both + one.both,
            either: sum.either + one.either,
        });
        // Counts of pixels are far below 2^52.
        #[allow(clippy::cast_precision_loss)]
        (sum.either > 0).then(|| sum.both as f64 / sum.either as f64)
    }
}

/// Share of a map's energy that is on lanes: `sum g(p) a(p) / sum g(p)`, where `a(p)` is the share of cell `p` that is
/// lane. For attention that does not depend on lanes, it is the mask's share of the area.
///
/// `mask` is as large as `energy` or larger; `None` when there is no energy at all.
pub fn energy_on_lanes(energy: &EnergyMap, mask: &LaneMask) -> Option<f64> {
    let shares = mask.shares((energy.width, energy.height));
    let total: f64 = energy.energy.iter().sum();
    let on_lanes: f64 = energy.energy.iter().zip(shares).map(|(g, a)| g * a).sum();
    (total > 0.0).then(|| on_lanes / total)
}

fn share(part: usize, whole: usize) -> f64 {
    // Counts of pixels are far below 2^52.
    #[allow(clippy::cast_precision_loss)]
    if whole == 0 {
        0.0
    } else {
        part as f64 / whole as f64
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    #[test]
    fn lane_is_where_the_logit_is_above_0() {
        let mut mask = LaneMask::default();
        mask.read(&FeatureMap {
            shape: [1, 1, 4],
            activations: &[-1.0, 0.0, 0.5, f32::NAN],
        });
        assert_eq!(mask.lane, [false, false, true, false]);
        assert_eq!(mask.area(), 0.25);
    }

    #[test]
    fn iou_is_pooled_over_pixels_not_averaged_over_masks() {
        let mask = |labels: &[u8]| LaneMask::of_labels(4, labels);
        let one = Overlap::of(Some(&mask(&[1, 1, 0, 0])), &mask(&[255, 0, 0, 0]));
        let two = Overlap::of(Some(&mask(&[1; 4])), &mask(&[255; 4]));
        assert_eq!(one, Overlap { both: 1, either: 2 });
        assert_eq!(Overlap::iou([one, two].into_iter()), Some(5.0 / 6.0));
        assert_eq!(
            Overlap::of(None, &mask(&[1, 0, 0, 1])),
            Overlap { both: 0, either: 2 }
        );
        assert_eq!(Overlap::iou([Overlap::default()].into_iter()), None);
    }

    #[test]
    fn lines_agree_within_two_pixels_of_320_and_not_beyond() {
        let column = |x: usize| LaneMask {
            width: 320,
            height: 4,
            lane: (0..4 * 320).map(|pixel| pixel % 320 == x).collect(),
        };
        let truth = column(100);
        let f1 = |x| Agreement::of(Some(&column(x)), &truth).f1();
        assert_eq!(
            (f1(100), f1(98), f1(102)),
            (Some(1.0), Some(1.0), Some(1.0))
        );
        assert_eq!((f1(97), f1(103)), (Some(0.0), Some(0.0)));
        assert_eq!(Agreement::of(None, &truth).f1(), Some(0.0));
        let empty = LaneMask {
            lane: vec![false; 4 * 320],
            ..truth.clone()
        };
        assert_eq!(Agreement::of(Some(&truth), &empty).f1(), None);
        // One of two lines is found, and nothing else is marked.
        let both = LaneMask {
            lane: (0..4 * 320)
                .map(|pixel| [100, 200].contains(&(pixel % 320)))
                .collect(),
            ..truth.clone()
        };
        let half = Agreement::of(Some(&truth), &both);
        assert_eq!((half.precision(), half.recall()), (Some(1.0), Some(0.5)));
        assert!((half.f1().unwrap() - 2.0 / 3.0).abs() < 1e-12);
        // Rows outside do not count.
        let two_rows = Agreement::of(Some(&truth.in_rows(1, 3)), &both.in_rows(1, 3));
        assert_eq!((two_rows.answer, two_rows.found, two_rows.truth), (2, 2, 4));
        let pooled = Agreement::pooled([half, two_rows].into_iter());
        assert_eq!((pooled.answer, pooled.truth), (6, 12));
    }

    #[test]
    fn energy_on_lanes_weighs_each_cell_by_its_share_of_lane() {
        // Cells of 2x2 pixels: half of the left one is lane, and the right one has no lane.
        let mask = LaneMask::of_labels(4, &[1, 0, 0, 0, 1, 0, 0, 0]);
        let energy = |energy: &[f64]| EnergyMap {
            width: 2,
            height: 1,
            energy: energy.to_vec(),
        };
        assert_eq!(energy_on_lanes(&energy(&[3.0, 1.0]), &mask), Some(0.375));
        // Attention that does not depend on lanes: the share of the area.
        assert_eq!(
            energy_on_lanes(&energy(&[1.0, 1.0]), &mask),
            Some(mask.area())
        );
        assert_eq!(energy_on_lanes(&energy(&[0.0, 0.0]), &mask), None);
    }
}
