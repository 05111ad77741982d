//! Computes graphs directly from their definitions.

use super::*;

/// Rounding of a few hundred sums of 32-bit floats, as a share of the largest value.
pub const ROUNDING: f64 = 1e-5;

/// Pseudo-random numbers, always the same.
pub struct Dice(pub u64);

impl Dice {
    pub fn below(&mut self, count: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 33) as usize % count
    }

    pub fn of<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.below(choices.len())]
    }

    pub fn values(&mut self, count: usize) -> Vec<f32> {
        (0..count)
            .map(|_| self.below(2_001) as f32 / 1e3 - 1.0)
            .collect()
    }
}

/// Output size of a window with as many pixels after as before, and `extra` more.
pub fn size_after(size: usize, window: &Window, axis: usize, extra: usize) -> Option<usize> {
    let span = (window.kernel[axis] - 1) * window.dilation[axis] + 1;
    let room = size + 2 * window.before[axis] + extra;
    (room >= span).then(|| (room - span) / window.stride[axis] + 1)
}

pub fn random_window(dice: &mut Dice) -> Window {
    let kernel = dice.of(&[[1, 1], [3, 3], [2, 2], [5, 1], [1, 5], [4, 4], [2, 3]]);
    let dilation = [dice.of(&[1, 1, 2, 5]), dice.of(&[1, 1, 2, 7])];
    let same = [0, 1].map(|axis| (kernel[axis] - 1) * dilation[axis] / 2);
    Window {
        kernel,
        stride: [dice.of(&[1, 1, 2, 3]), dice.of(&[1, 1, 2, 3, 4])],
        dilation,
        before: match dice.below(3) {
            0 => [0, 0],
            1 => same,
            _ => [same[0], dice.below(4)],
        },
    }
}

pub fn push_conv(
    graph: &mut Graph,
    dice: &mut Dice,
    input: NodeId,
    window: Window,
    outputs: usize,
) -> Option<NodeId> {
    let [channels, height, width] = graph.nodes[input].shape;
    let extra = dice.below(2);
    let shape = [
        outputs,
        size_after(height, &window, 0, 0)?,
        size_after(width, &window, 1, extra)?,
    ];
    let cells = window.kernel[0] * window.kernel[1];
    let op = Op::Conv {
        window,
        weights: dice.values(outputs * channels * cells),
        bias: dice.values(outputs),
    };
    Some(graph.push(op, &[input], shape))
}

pub const POINT: Window = Window {
    kernel: [1, 1],
    stride: [1, 1],
    dilation: [1, 1],
    before: [0, 0],
};

/// Every value of a graph, straight from the definitions.
pub fn naive(graph: &Graph, picture: &[f32]) -> Vec<Vec<f64>> {
    let mut values: Vec<Vec<f64>> = Vec::new();
    for node in &graph.nodes {
        let [channels, height, width] = node.shape;
        let of = |index: usize| {
            let id = node.inputs[index];
            (&values[id], graph.nodes[id].shape)
        };
        // It is 0 outside.
        let at = |index: usize, c: usize, y: isize, x: isize| {
            let (values, [channels, height, width]) = of(index);
            let inside = c < channels
                && (0..height as isize).contains(&y)
                && (0..width as isize).contains(&x);
            inside.then(|| values[(c * height + y as usize) * width + x as usize])
        };
        let mut made = Vec::new();
        for c in 0..channels {
            for y in 0..height as isize {
                for x in 0..width as isize {
                    let cells = |window: &Window| {
                        let window = *window;
                        let place = move |axis: usize, position: isize, cell: usize| {
                            position * window.stride[axis] as isize
                                + (cell * window.dilation[axis]) as isize
                                - window.before[axis] as isize
                        };
                        (0..window.kernel[0]).flat_map(move |cell_y| {
                            (0..window.kernel[1]).map(move |cell_x| {
                                let cell = cell_y * window.kernel[1] + cell_x;
                                (cell, place(0, y, cell_y), place(1, x, cell_x))
                            })
                        })
                    };
                    let value = match &node.op {
                        Op::Picture => f64::from(picture[made.len()]),
                        Op::Conv {
                            window,
                            weights,
                            bias,
                        } => {
                            let inputs = of(0).1[0];
                            let count = window.kernel[0] * window.kernel[1];
                            let mut sum = f64::from(bias[c]);
                            for input in 0..inputs {
                                for (cell, y, x) in cells(window) {
                                    let weight = weights[(c * inputs + input) * count + cell];
                                    sum += f64::from(weight) * at(0, input, y, x).unwrap_or(0.0);
                                }
                            }
                            sum
                        }
                        Op::MaxPool(window) => cells(window)
                            .filter_map(|(_, y, x)| at(0, c, y, x))
                            .fold(f64::NEG_INFINITY, f64::max),
                        Op::Add => at(0, c, y, x).unwrap() + at(1, c, y, x).unwrap(),
                        Op::Concat => {
                            let mut first = 0;
                            let mut value = 0.0;
                            for index in 0..node.inputs.len() {
                                let count = of(index).1[0];
                                if (first..first + count).contains(&c) {
                                    value = at(index, c - first, y, x).unwrap();
                                }
                                first += count;
                            }
                            value
                        }
                        Op::Margin(before) => {
                            let (y, x) = (y - before[0] as isize, x - before[1] as isize);
                            at(0, c, y, x).unwrap_or(0.0)
                        }
                        Op::Scale { factor, offset } => {
                            at(0, c, y, x).unwrap() * f64::from(factor[c]) + f64::from(offset[c])
                        }
                        Op::Resize => {
                            let [_, from_height, from_width] = of(0).1;
                            let between = |position: isize, from: usize, to: usize| {
                                let place = (position as f64 + 0.5) * from as f64 / to as f64 - 0.5;
                                let place = place.clamp(0.0, (from - 1) as f64);
                                (place.floor() as isize, place.fract())
                            };
                            let (top, below) = between(y, from_height, height);
                            let (left, aside) = between(x, from_width, width);
                            let near = |dy: isize, dx: isize| {
                                let y = (top + dy).min(from_height as isize - 1);
                                let x = (left + dx).min(from_width as isize - 1);
                                at(0, c, y, x).unwrap()
                            };
                            let upper = near(0, 0) * (1.0 - aside) + near(0, 1) * aside;
                            let lower = near(1, 0) * (1.0 - aside) + near(1, 1) * aside;
                            upper * (1.0 - below) + lower * below
                        }
                        Op::Unfold { side } => {
                            let side = *side as isize;
                            let channel = (c as isize * side + y % side) * side + x % side;
                            at(0, channel as usize, y / side, x / side).unwrap()
                        }
                    };
                    made.push(match node.activation {
                        Activation::Relu => value.max(0.0),
                        Activation::Leaky(slope) if value < 0.0 => value * f64::from(slope),
                        _ => value,
                    });
                }
            }
        }
        values.push(made);
    }
    graph.outputs.iter().map(|&id| values[id].clone()).collect()
}

/// Checks that each kernel computes a graph as its definitions say, and that kernels with fused products agree bit for
/// bit.
pub fn assert_computed(graph: &Graph, picture: &[f32], what: &str) {
    let wanted = naive(graph, picture);
    let mut fused_outputs: Option<Vec<Vec<u32>>> = None;
    for kernel in Vectors::available() {
        let plan =
            Plan::new(&graph.clone().fused(), kernel).unwrap_or_else(|why| panic!("{what}: {why}"));
        let mut buffers = Buffers::new(&plan);
        // Run twice: what a picture leaves in the buffers must not affect the next one.
        buffers.run(&plan, &vec![f32::NAN; picture.len()]);
        buffers.run(&plan, picture);
        for (found, wanted) in buffers.outputs().iter().zip(&wanted) {
            assert_eq!(found.len(), wanted.len(), "{what}");
            let peak = wanted.iter().fold(1.0_f64, |m, v| m.max(v.abs()));
            for (place, (&found, &wanted)) in found.iter().zip(wanted).enumerate() {
                assert!(
                    (f64::from(found) - wanted).abs() <= ROUNDING * peak,
                    "{what}, {kernel:?}: {found} at {place}; wanted {wanted}"
                );
            }
        }
        if kernel != Vectors::Portable {
            let bits = buffers.outputs().iter();
            let bits: Vec<Vec<u32>> = bits
                .map(|values| values.iter().map(|v| (v + 0.0).to_bits()).collect())
                .collect();
            assert_eq!(
                *fused_outputs.get_or_insert_with(|| bits.clone()),
                bits,
                "{what}"
            );
        }
    }
}
