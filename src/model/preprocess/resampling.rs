//! Resamples rows and columns from one size to another with an antialiased triangle kernel.
//!
//! It contains the weights and the two inner loops. [`ROWS`] output rows are made at a time: first each row is summed
//! up from the input rows around it, with all bytes side by side. Then the rows are transposed, so that columns are
//! summed for all these rows together. Products and sums are never fused and always in the same order, so every
//! processor gives the same result bit for bit.

use std::ops::Range;

use crate::model::vectors::turned;

/// Number of output rows that are made together.
pub const ROWS: usize = 8;
/// One value of each of these rows.
pub type Column = [f32; ROWS];
/// Number of bytes of a row that are processed together.
const BLOCK: usize = 64;

/// The inputs and weights from which each output is made.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// First input of each output.
    starts: Vec<usize>,
    /// Where the weights of each output begin, and where those of the last output end.
    offsets: Vec<usize>,
    /// Weights; those of one output sum to 1.
    weights: Vec<f32>,
}

impl Axis {
    /// `outputs` centres over `length` of `full` inputs, beginning at `from`. The triangle reaches from one centre to
    /// the next, or over one input if inputs are wider. It reaches beyond `length` if there are inputs.
    #[allow(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )]
    pub fn new(from: f64, length: f64, full: usize, outputs: usize) -> Self {
        let scale = length / outputs as f64;
        let reach = scale.max(1.0);
        let weighted = |output: usize| {
            let centre = from + (output as f64 + 0.5) * scale;
            let weight = |input: usize| {
                let away = (input as f64 + 0.5 - centre).abs() / reach;
                (1.0 - away).max(0.0)
            };
            let first = (centre - reach).floor().max(0.0) as usize;
            let last = ((centre + reach).ceil() as usize).min(full);
            let all = (first..last).map(|input| (input, weight(input)));
            let weights: Vec<(usize, f64)> = all.filter(|&(_, weight)| weight > 0.0).collect();
            let sum: f64 = weights.iter().map(|&(_, weight)| weight).sum();
            let start = weights.first().map_or(0, |&(input, _)| input);
            let share = |(_, weight): (usize, f64)| (weight / sum) as f32;
            (start, weights.into_iter().map(share).collect())
        };
        Self::of((0..outputs).map(weighted))
    }

    /// The same outputs from inputs that each represent two inputs.
    pub fn of_pairs(&self) -> Self {
        let weighted = |output: usize| {
            let (start, weights) = self.taps(output);
            let mut pairs = vec![0.0; (start % 2 + weights.len()).div_ceil(2)];
            for (tap, weight) in weights.iter().enumerate() {
                pairs[(start % 2 + tap) / 2] += weight;
            }
            (start / 2, pairs)
        };
        Self::of((0..self.starts.len()).map(weighted))
    }

    fn of(outputs: impl Iterator<Item = (usize, Vec<f32>)>) -> Self {
        let mut axis = Self {
            starts: Vec::new(),
            offsets: vec![0],
            weights: Vec::new(),
        };
        for (start, weights) in outputs {
            axis.starts.push(start);
            axis.weights.extend(weights);
            axis.offsets.push(axis.weights.len());
        }
        axis
    }

    /// First input of an output, and its weights from there on.
    fn taps(&self, output: usize) -> (usize, &[f32]) {
        let weights = self.offsets[output]..self.offsets[output + 1];
        (self.starts[output], &self.weights[weights])
    }

    /// The inputs that have a weight.
    pub fn inputs(&self) -> Range<usize> {
        let ends = (0..self.starts.len()).map(|output| {
            let (start, weights) = self.taps(output);
            start + weights.len()
        });
        let first = self.starts.iter().copied().min();
        first.unwrap_or(0)..ends.max().unwrap_or(0)
    }

    /// The same axis with inputs counted from `first` on.
    pub fn counted_from(mut self, first: usize) -> Self {
        for start in &mut self.starts {
            *start = start.saturating_sub(first);
        }
        self
    }

    /// Sums up at most [`ROWS`] output rows, byte column by byte column. `rows` holds a row of inputs every `stride`
    /// bytes, and `columns.len()` bytes of each row count.
    #[inline(always)]
    pub fn stack(&self, outputs: Range<usize>, rows: &[u8], stride: usize, columns: &mut [Column]) {
        for (block, columns) in columns.chunks_mut(BLOCK).enumerate() {
            let mut sums = [[0.0; BLOCK]; ROWS];
            for (sums, output) in sums.iter_mut().zip(outputs.clone()) {
                let (start, weights) = self.taps(output);
                let mut own = [0.0; BLOCK];
                for (row, weight) in (start..).zip(weights) {
                    let bytes = &rows[row * stride + block * BLOCK..];
                    // The last block may be short.
                    let mut padded = [0; BLOCK];
                    let bytes: &[u8; BLOCK] = match bytes.first_chunk() {
                        Some(bytes) => bytes,
                        None => {
                            padded[..columns.len()].copy_from_slice(&bytes[..columns.len()]);
                            &padded
                        }
                    };
                    for (sum, &byte) in own.iter_mut().zip(bytes) {
                        *sum += weight * f32::from(byte);
                    }
                }
                *sums = own;
            }
            turn(&sums, columns);
        }
    }

    /// Computes all outputs of [`ROWS`] rows from every `step`-th column of them.
    #[inline(always)]
    pub fn shorten(&self, columns: &[Column], step: usize, short: &mut [Column]) {
        for (output, short) in short.iter_mut().enumerate() {
            let (start, weights) = self.taps(output);
            let inputs = columns[start * step..].iter().step_by(step);
            let mut sums = [0.0; ROWS];
            for (weight, inputs) in weights.iter().zip(inputs) {
                for (sum, input) in sums.iter_mut().zip(inputs) {
                    *sum += weight * input;
                }
            }
            *short = sums;
        }
    }
}

/// Transposes rows to columns.
#[inline(always)]
fn turn(rows: &[[f32; BLOCK]; ROWS], columns: &mut [Column]) {
    for (square, columns) in columns.chunks_mut(4).enumerate() {
        for half in [0, 4] {
            let of_row = |row: usize| {
                let values = &rows[half + row][4 * square..][..4];
                [values[0], values[1], values[2], values[3]]
            };
            let values = turned([of_row(0), of_row(1), of_row(2), of_row(3)]);
            for (column, values) in columns.iter_mut().zip(values) {
                column[half..half + 4].copy_from_slice(&values);
            }
        }
    }
}

/// Transposes columns to rows: row `row` of [`ROWS`] rows.
#[inline(always)]
pub fn turn_back(columns: &[Column], width: usize, rows: &mut [f32]) {
    for (square, columns) in columns.chunks(4).enumerate() {
        let full = columns.len() == 4;
        for half in [0, 4] {
            let of_column = |column: usize| {
                let values = &columns[column.min(columns.len() - 1)][half..half + 4];
                [values[0], values[1], values[2], values[3]]
            };
            let values = turned([of_column(0), of_column(1), of_column(2), of_column(3)]);
            for (row, values) in values.iter().enumerate() {
                let at = (half + row) * width + 4 * square;
                if full && let Some(to) = rows.get_mut(at..at + 4) {
                    to.copy_from_slice(values);
                } else if let Some(to) = rows.get_mut(at..at + columns.len()) {
                    to.copy_from_slice(&values[..columns.len()]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    #[test]
    fn weights_of_every_output_sum_to_one_and_lie_inside() {
        for (from, length, full, outputs) in [
            (0.0, 1280.0, 1280, 320),
            (0.0, 720.0, 720, 160),
            (100.5, 333.3, 480, 97),
            (0.0, 7.0, 7, 64),
            (479.0, 1.0, 480, 3),
        ] {
            let axis = Axis::new(from, length, full, outputs);
            assert!(axis.inputs().end <= full);
            for axis in [axis.of_pairs(), axis] {
                for output in 0..outputs {
                    let sum: f32 = axis.taps(output).1.iter().sum();
                    assert!((sum - 1.0).abs() < 1e-5, "{output}: {sum}");
                }
            }
        }
    }

    #[test]
    fn the_same_size_changes_nothing() {
        let (rows, columns) = (Axis::new(0.0, 5.0, 5, 5), Axis::new(0.0, 7.0, 7, 7));
        let bytes: Vec<u8> = (0..35).collect();
        let wanted: Vec<f32> = bytes.iter().map(|&byte| byte.into()).collect();
        let (mut tall, mut short) = ([[0.0; ROWS]; 7], [[0.0; ROWS]; 7]);
        rows.stack(0..5, &bytes, 7, &mut tall);
        columns.shorten(&tall, 1, &mut short);
        let mut found = [-1.0; 35];
        turn_back(&short, 7, &mut found);
        assert_eq!(found[..], wanted);
    }

    #[test]
    fn a_colour_that_two_pixels_share_weighs_as_both() {
        let axis = Axis::new(0.3, 21.4, 24, 5);
        let colours: Vec<Column> = (0..12u8).map(|j| [f32::from(j * j); ROWS]).collect();
        let pixels: Vec<Column> = (0..24).map(|i| colours[i / 2]).collect();
        let (mut of_pairs, mut of_pixels) = ([[0.0; ROWS]; 5], [[0.0; ROWS]; 5]);
        axis.of_pairs().shorten(&colours, 1, &mut of_pairs);
        axis.shorten(&pixels, 1, &mut of_pixels);
        for (a, b) in of_pairs.into_iter().zip(of_pixels) {
            assert!((a[0] - b[0]).abs() < 1e-4, "{a:?} {b:?}");
        }
    }
}
