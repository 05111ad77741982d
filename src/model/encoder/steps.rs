//! The computation for every picture, operator by operator, on activations in blocks. Nothing here allocates.

use std::ops::Range;

use super::graph::{Activation, Window};
use super::layout::{Blocked, LANES, Planar};
use super::loops::{Rivals, Row, Run, larger};
use crate::model::vectors::{Vectors, turned};

/// A run is never left out if it reads only zeros beside the picture for fewer pixels than this at either end.
const SKIPPED_MIN: usize = 5;

/// Number of pixels and channels that are transposed at a time.
const SQUARE: usize = 4;

/// Part of a buffer, beginning at a block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Layout of the whole buffer.
    pub layout: Blocked,
    /// The block at which the value begins.
    pub first: usize,
    /// Number of its blocks.
    pub blocks: usize,
}

impl View {
    #[inline(always)]
    fn pixels(&self, y: usize, block: usize) -> Range<usize> {
        self.layout.pixels(y, self.first + block)
    }
}

/// What a convolution or a pooling reads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Source {
    /// The input of the whole graph.
    Picture(Planar),
    /// A value.
    Blocks(View),
}

/// A convolution for one size of input.
pub struct Convolution {
    /// `[output blocks][products][LANES]`.
    weights: Vec<f32>,
    bias: Vec<[f32; LANES]>,
    /// Runs for rows that use the same part of the window.
    variants: Vec<Vec<Run>>,
    /// For each output row: its variant, and where its runs begin in the input.
    rows: Vec<(usize, usize)>,
    /// Input values from one output pixel to the next.
    step: usize,
    activation: Activation,
}

impl Convolution {
    /// - `weights`: `[outputs, inputs, kernel height, kernel width]`
    /// - `bias`: `[outputs]`
    /// - `channels`: number of channels of the input
    /// - `size`: height and width of the output
    pub fn new(
        window: &Window,
        weights: &[f32],
        bias: &[f32],
        channels: usize,
        source: &Source,
        size: [usize; 2],
        activation: Activation,
    ) -> Self {
        let [kernel_height, kernel_width] = window.kernel;
        let packed = pack(weights, bias.len(), channels, window, source);
        let (input_height, row) = match source {
            Source::Picture(planar) => (planar.height, planar.row()),
            Source::Blocks(view) => (view.layout.height, view.layout.row()),
        };
        let mut seen: Vec<(usize, usize)> = Vec::new();
        let mut variants = Vec::new();
        let rows = (0..size[0])
            .map(|y| {
                let top = y * window.stride[0];
                let inside = |cell: &usize| {
                    let below = top + cell * window.dilation[0];
                    (window.before[0]..input_height + window.before[0]).contains(&below)
                };
                let first = (0..kernel_height).find(inside).unwrap_or(0);
                let count = (0..kernel_height).filter(inside).count();
                let variant = seen.iter().position(|&s| s == (first, count));
                let variant = variant.unwrap_or_else(|| {
                    seen.push((first, count));
                    let cells = first..first + count;
                    variants.push(runs(window, channels, source, size[1], cells));
                    variants.len() - 1
                });
                let origin = match count {
                    0 => 0,
                    _ => (top + first * window.dilation[0] - window.before[0]) * row,
                };
                (variant, origin)
            })
            .collect();
        let mut padded = vec![[0.0; LANES]; bias.len().div_ceil(LANES)];
        for (output, &bias) in bias.iter().enumerate() {
            padded[output / LANES][output % LANES] = bias;
        }
        debug_assert_eq!(
            packed.len(),
            padded.len() * channels * kernel_height * kernel_width * LANES
        );
        let step = window.stride[1]
            * match source {
                Source::Picture(_) => 1,
                Source::Blocks(_) => LANES,
            };
        Self {
            weights: packed,
            bias: padded,
            variants,
            rows,
            step,
            activation,
        }
    }

    /// Computes all outputs.
    ///
    /// - `residual`: added to the sums, in as many blocks as it has
    pub fn run(
        &self,
        kernel: Vectors,
        input: &[f32],
        residual: Option<(&[f32], View)>,
        (output, view): (&mut [f32], View),
    ) {
        let products = self.weights.len() / self.bias.len();
        for (y, &(variant, origin)) in self.rows.iter().enumerate() {
            let blocks = self.bias.iter().zip(self.weights.chunks_exact(products));
            for (block, (bias, weights)) in blocks.enumerate() {
                kernel.run(Row {
                    input: &input[origin..],
                    runs: &self.variants[variant],
                    weights,
                    bias,
                    residual: residual
                        .filter(|(_, view)| block < view.blocks)
                        .map(|(values, view)| &values[view.pixels(y, block)]),
                    output: &mut output[view.pixels(y, block)],
                    step: self.step,
                    activation: self.activation,
                });
            }
        }
    }
}

/// Weights in the order in which [`runs`] multiplies them.
fn pack(
    weights: &[f32],
    outputs: usize,
    channels: usize,
    window: &Window,
    source: &Source,
) -> Vec<f32> {
    let cells = window.kernel[0] * window.kernel[1];
    let lanes = match source {
        Source::Picture(_) => 1,
        Source::Blocks(_) => LANES,
    };
    let mut packed = Vec::with_capacity(outputs.next_multiple_of(LANES) * channels * cells);
    for first_output in (0..outputs).step_by(LANES) {
        for first_input in (0..channels).step_by(lanes) {
            for cell in 0..cells {
                for input in first_input..channels.min(first_input + lanes) {
                    packed.extend((first_output..first_output + LANES).map(|output| {
                        let place = (output * channels + input) * cells + cell;
                        if output < outputs {
                            weights[place]
                        } else {
                            0.0
                        }
                    }));
                }
            }
        }
    }
    packed
}

/// What one output row reads if it uses the rows `cells` of the window, relative to the first of them.
fn runs(
    window: &Window,
    channels: usize,
    source: &Source,
    width: usize,
    cells: Range<usize>,
) -> Vec<Run> {
    let [kernel_height, kernel_width] = window.kernel;
    // Number of channels side by side, and the values from a group, a row and a column to the next.
    let (lanes, group, row, column, input_width, left) = match source {
        Source::Picture(p) => (1, p.plane(), p.row(), 1, p.width, p.left),
        Source::Blocks(view) => {
            let layout = view.layout;
            let (pitch, row) = (layout.pitch(), layout.row());
            (LANES, pitch, row, LANES, layout.width, layout.left)
        }
    };
    let first_group = match source {
        Source::Picture(_) => 0,
        Source::Blocks(view) => view.first,
    };
    let mut runs: Vec<Run> = Vec::new();
    let mut weights = 0;
    for first in (0..channels).step_by(lanes) {
        let len = lanes.min(channels - first);
        for cell_y in 0..kernel_height {
            for cell_x in 0..kernel_width {
                let (
                    Range {
                        start: from,
                        end: to,
                    },
                    _,
                ) = inside(window, cell_x, input_width, width);
                let run = Run {
                    input: (first_group + first / lanes) * group
                        + cell_y.saturating_sub(cells.start) * window.dilation[0] * row
                        + (left + cell_x * window.dilation[1] - window.before[1]) * column,
                    weights,
                    len,
                    from: if from < SKIPPED_MIN { 0 } else { from },
                    to: if to + SKIPPED_MIN > width { width } else { to },
                };
                weights += len * LANES;
                if !cells.contains(&cell_y) {
                    continue;
                }
                match runs.last_mut() {
                    Some(last)
                        if last.input + last.len == run.input
                            && last.weights + last.len * LANES == run.weights
                            && (last.from, last.to) == (run.from, run.to) =>
                    {
                        last.len += len;
                    }
                    _ => runs.push(run),
                }
            }
        }
    }
    runs
}

/// The rows or columns of an input that a position of a window uses.
#[inline(always)]
pub fn seen(
    window: &Window,
    axis: usize,
    position: usize,
    size: usize,
) -> impl Iterator<Item = usize> {
    let start = position * window.stride[axis];
    let (before, dilation) = (window.before[axis], window.dilation[axis]);
    (0..window.kernel[axis])
        .map(move |cell| start + cell * dilation)
        .filter(move |place| (before..size + before).contains(place))
        .map(move |place| place - before)
}

/// The positions of a window along a row at which one of its cells is inside the row, and where the cell is for the
/// first position.
#[inline(always)]
fn inside(window: &Window, cell: usize, width: usize, positions: usize) -> (Range<usize>, usize) {
    let (stride, before) = (window.stride[1], window.before[1]);
    let shift = cell * window.dilation[1];
    let from = before.saturating_sub(shift).div_ceil(stride).min(positions);
    let to = (width + before).saturating_sub(shift).div_ceil(stride);
    let to = to.clamp(from, positions);
    (from..to, (from * stride + shift).saturating_sub(before))
}

/// Largest values in a window, for a value in blocks.
#[inline(always)]
pub fn pool_blocks(
    kernel: Vectors,
    window: &Window,
    activation: Activation,
    (input, from): (&[f32], View),
    (output, to): (&mut [f32], View),
) {
    let (height, width) = (from.layout.height, from.layout.width);
    for y in 0..to.layout.height {
        for block in 0..to.blocks {
            let pixels = &mut output[to.pixels(y, block)];
            pixels.fill(f32::NEG_INFINITY);
            for row in seen(window, 0, y, height) {
                let row = &input[from.pixels(row, block)];
                for cell in 0..window.kernel[1] {
                    let (positions, start) = inside(window, cell, width, to.layout.width);
                    kernel.rival(Rivals {
                        input: &row[(start * LANES).min(row.len())..],
                        stride: window.stride[1],
                        output: &mut pixels[positions.start * LANES..positions.end * LANES],
                    });
                }
            }
            activation.of_all(pixels);
        }
    }
}

/// Largest values in a window of the picture, written to channels of a value from `channel` on; its other channels are
/// not changed.
///
/// - `scratch`: room for a row of the picture, a row of the output, and one more value
#[inline(always)]
pub fn pool_picture(
    window: &Window,
    activation: Activation,
    (input, from): (&[f32], Planar),
    scratch: &mut [f32],
    (output, to): (&mut [f32], View),
    channel: usize,
) {
    // One value more than the row, so that every second value has a neighbour.
    let (column_best, best) = scratch.split_at_mut(from.width + 1);
    let best = &mut best[..to.layout.width];
    for y in 0..to.layout.height {
        for colour in 0..from.channels {
            let (block, lane) = ((channel + colour) / LANES, (channel + colour) % LANES);
            column_best.fill(f32::NEG_INFINITY);
            for row in seen(window, 0, y, from.height) {
                let row = &input[from.pixels(colour, row)];
                for (best, &value) in column_best.iter_mut().zip(row) {
                    *best = larger(*best, value);
                }
            }
            best.fill(f32::NEG_INFINITY);
            for cell in 0..window.kernel[1] {
                let (positions, start) = inside(window, cell, from.width, best.len());
                let best = &mut best[positions];
                let values = &column_best[start.min(from.width)..];
                if window.stride[1] == 2 {
                    for (best, [value, _]) in best.iter_mut().zip(values.as_chunks::<2>().0) {
                        *best = larger(*best, *value);
                    }
                } else {
                    let values = values.iter().step_by(window.stride[1]);
                    for (best, &value) in best.iter_mut().zip(values) {
                        *best = larger(*best, value);
                    }
                }
            }
            let pixels = output[to.pixels(y, block)].as_chunks_mut::<LANES>().0;
            for (pixel, &value) in pixels.iter_mut().zip(best.iter()) {
                pixel[lane] = activation.of(value);
            }
        }
    }
}

/// `a + b`, where `b` may have fewer blocks: its missing blocks are 0.
#[inline(always)]
pub fn add(
    activation: Activation,
    (a, a_view): (&[f32], View),
    (b, b_view): (&[f32], View),
    (output, to): (&mut [f32], View),
) {
    for y in 0..to.layout.height {
        for block in 0..to.blocks {
            let pixels = &mut output[to.pixels(y, block)];
            pixels.copy_from_slice(&a[a_view.pixels(y, block)]);
            if block < b_view.blocks {
                for (sum, term) in pixels.iter_mut().zip(&b[b_view.pixels(y, block)]) {
                    *sum += term;
                }
            }
            activation.of_all(pixels);
        }
    }
}

/// A factor and an offset for every lane of every block, and an activation.
pub struct Scaling {
    factor: Vec<[f32; LANES]>,
    offset: Vec<[f32; LANES]>,
    activation: Activation,
}

impl Scaling {
    /// Made from factors and offsets `[channels]`.
    pub fn new(factor: &[f32], offset: &[f32], activation: Activation) -> Self {
        let padded = |values: &[f32]| {
            let mut blocks = vec![[0.0; LANES]; values.len().div_ceil(LANES)];
            for (channel, &value) in values.iter().enumerate() {
                blocks[channel / LANES][channel % LANES] = value;
            }
            blocks
        };
        Self {
            factor: padded(factor),
            offset: padded(offset),
            activation,
        }
    }

    /// Applies it to a value in blocks.
    #[inline(always)]
    pub fn run(&self, (input, from): (&[f32], View), (output, to): (&mut [f32], View)) {
        for y in 0..to.layout.height {
            for block in 0..to.blocks {
                let source = input[from.pixels(y, block)].as_chunks::<LANES>().0;
                let target = output[to.pixels(y, block)].as_chunks_mut::<LANES>().0;
                let (factor, offset) = (&self.factor[block], &self.offset[block]);
                for (target, source) in target.iter_mut().zip(source) {
                    *target =
                        std::array::from_fn(|lane| source[lane] * factor[lane] + offset[lane]);
                }
                self.activation.of_all(target.as_flattened_mut());
            }
        }
    }

    /// Applies it to a value in blocks, and writes `[channels, height, width]`.
    #[inline(always)]
    pub fn unpack(&self, input: &[f32], from: View, output: &mut [f32]) {
        let (height, width) = (from.layout.height, from.layout.width);
        let plane = height * width;
        for (index, planes) in output.chunks_mut(SQUARE * plane).enumerate() {
            let (block, square) = (index * SQUARE / LANES, index % (LANES / SQUARE));
            let factor = &self.factor[block].as_chunks::<SQUARE>().0[square];
            let offset = &self.offset[block].as_chunks::<SQUARE>().0[square];
            let mut planes: [Option<&mut [f32]>; SQUARE] = {
                let mut planes = planes.chunks_exact_mut(plane);
                std::array::from_fn(|_| planes.next())
            };
            for y in 0..height {
                let pixels = input[from.pixels(y, block)].as_chunks::<LANES>().0;
                let scaled = |pixel: &[f32; LANES]| {
                    let values = &pixel.as_chunks::<SQUARE>().0[square];
                    std::array::from_fn(|i| values[i] * factor[i] + offset[i])
                };
                let row = y * width..(y + 1) * width;
                if let [Some(a), Some(b), Some(c), Some(d)] = &mut planes {
                    let [(a, a_rest), (b, b_rest), (c, c_rest), (d, d_rest)] =
                        [a, b, c, d].map(|plane| plane[row.clone()].as_chunks_mut::<SQUARE>());
                    let (squares, rest) = pixels.as_chunks::<SQUARE>();
                    // Transposed in registers, four pixels by four channels.
                    let fours = a.iter_mut().zip(b).zip(c).zip(d).zip(squares);
                    for ((((a, b), c), d), square) in fours {
                        [*a, *b, *c, *d] = turned(square.each_ref().map(scaled));
                    }
                    let rest_of = a_rest.iter_mut().zip(b_rest).zip(c_rest).zip(d_rest);
                    for ((((a, b), c), d), pixel) in rest_of.zip(rest) {
                        [*a, *b, *c, *d] = scaled(pixel);
                    }
                } else {
                    for (i, plane) in planes.iter_mut().flatten().enumerate() {
                        for (value, pixel) in plane[row.clone()].iter_mut().zip(pixels) {
                            *value = scaled(pixel)[i];
                        }
                    }
                }
            }
        }
        self.activation.of_all(output);
    }
}

/// Writes channels as squares of one picture `[channels / side², height side, width side]`.
#[inline(always)]
pub fn unfold(side: usize, input: &[f32], from: View, channels: usize, output: &mut [f32]) {
    let (height, width) = (from.layout.height, from.layout.width);
    let planes = output.chunks_exact_mut(height * width * side * side);
    for (plane, target) in planes.take(channels / (side * side)).enumerate() {
        for (y, row) in target.chunks_exact_mut(width * side).enumerate() {
            for (x, value) in row.iter_mut().enumerate() {
                let channel = (plane * side + y % side) * side + x % side;
                let pixels = from.pixels(y / side, channel / LANES);
                *value = input[pixels.start + x / side * LANES + channel % LANES];
            }
        }
    }
}

/// Copies the channels of a value to those of another from `channel` on.
#[inline(always)]
pub fn copy_channels(
    (input, from): (&[f32], View),
    channels: usize,
    (output, to): (&mut [f32], View),
    channel: usize,
) {
    for y in 0..to.layout.height {
        for source in 0..channels {
            let target = channel + source;
            let source_row = input[from.pixels(y, source / LANES)].as_chunks::<LANES>().0;
            let pixels = to.pixels(y, target / LANES);
            let target_row = output[pixels].as_chunks_mut::<LANES>().0;
            for (to, from) in target_row.iter_mut().zip(source_row) {
                to[target % LANES] = from[source % LANES];
            }
        }
    }
}

/// Fills a value with zeros.
#[inline(always)]
pub fn clear((output, to): (&mut [f32], View)) {
    for y in 0..to.layout.height {
        for block in 0..to.blocks {
            output[to.pixels(y, block)].fill(0.0);
        }
    }
}

/// The two input rows or columns between which an output row or column is: the first, the second, and the share of the
/// second.
#[inline(always)]
pub fn between(position: usize, size: usize, output_size: usize) -> (usize, usize, f32) {
    // Sizes of pictures are far below 2^24.
    #[allow(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )]
    {
        let place = (position as f32 + 0.5) * (size as f32 / output_size as f32) - 0.5;
        let first = place.max(0.0) as usize;
        let share = (place - first as f32).clamp(0.0, 1.0);
        (first.min(size - 1), (first + 1).min(size - 1), share)
    }
}

/// Bilinear interpolation.
#[inline(always)]
pub fn resize(
    activation: Activation,
    (input, from): (&[f32], View),
    (output, to): (&mut [f32], View),
) {
    for y in 0..to.layout.height {
        let (top, bottom, below) = between(y, from.layout.height, to.layout.height);
        for block in 0..to.blocks {
            let top = input[from.pixels(top, block)].as_chunks::<LANES>().0;
            let bottom = input[from.pixels(bottom, block)].as_chunks::<LANES>().0;
            let pixels = output[to.pixels(y, block)].as_chunks_mut::<LANES>().0;
            for (x, pixel) in pixels.iter_mut().enumerate() {
                let (left, right, aside) = between(x, from.layout.width, to.layout.width);
                for (lane, value) in pixel.iter_mut().enumerate() {
                    let mixed = |row: &[[f32; LANES]]| {
                        row[left][lane] * (1.0 - aside) + row[right][lane] * aside
                    };
                    let mixed = mixed(top) * (1.0 - below) + mixed(bottom) * below;
                    *value = activation.of(mixed);
                }
            }
        }
    }
}
