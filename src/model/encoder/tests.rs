//! Our executor against a naive one in 64-bit floats, and against tract.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss
)]

use std::borrow::Cow;
use std::path::Path;

use super::graph::{Activation, Graph, NodeId, Op, Window};
use super::kernel::Kernel;
use super::*;
use crate::model::ModelOptions;
use crate::model::preprocess::Preprocessing;

/// Rounding of a few hundred sums of 32-bit floats, as a share of the largest value.
const ROUNDING: f64 = 1e-5;

/// Numbers that look random, always the same.
struct Dice(u64);

impl Dice {
    fn below(&mut self, count: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 33) as usize % count
    }

    fn of<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.below(choices.len())]
    }

    fn values(&mut self, count: usize) -> Vec<f32> {
        (0..count)
            .map(|_| self.below(2_001) as f32 / 1e3 - 1.0)
            .collect()
    }
}

/// Output size of a window with as many pixels after as before, and `extra` more.
fn size_after(size: usize, window: &Window, axis: usize, extra: usize) -> Option<usize> {
    let span = (window.kernel[axis] - 1) * window.dilation[axis] + 1;
    let room = size + 2 * window.before[axis] + extra;
    (room >= span).then(|| (room - span) / window.stride[axis] + 1)
}

fn random_window(dice: &mut Dice) -> Window {
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

fn push_conv(
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

const POINT: Window = Window {
    kernel: [1, 1],
    stride: [1, 1],
    dilation: [1, 1],
    before: [0, 0],
};

/// Every value of a graph, straight from the definitions.
fn naive(graph: &Graph, picture: &[f32]) -> Vec<Vec<f64>> {
    let mut values: Vec<Vec<f64>> = Vec::new();
    for node in &graph.nodes {
        let [channels, height, width] = node.shape;
        let of = |index: usize| {
            let id = node.inputs[index];
            (&values[id], graph.nodes[id].shape)
        };
        // 0 outside.
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

/// What each kernel makes of a graph is what the definitions say, and those that fuse products agree to the bit.
fn assert_computed(graph: &Graph, picture: &[f32], what: &str) {
    let wanted = naive(graph, picture);
    let mut fused_outputs: Option<Vec<Vec<u32>>> = None;
    for kernel in Kernel::available() {
        let plan =
            Plan::new(&graph.clone().fused(), kernel).unwrap_or_else(|why| panic!("{what}: {why}"));
        let mut buffers = Buffers::new(&plan);
        // Twice: what a picture leaves behind does not matter to the next.
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
        if kernel != Kernel::Portable {
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

#[test]
fn convolutions_of_all_shapes_are_what_they_should() {
    let mut dice = Dice(1);
    let mut done = 0;
    while done < 400 {
        let (height, width) = (1 + dice.below(9), 1 + dice.below(45));
        let channels = dice.of(&[1, 3, 4, 16, 17, 40]);
        let of_picture = dice.below(2) == 0;
        let mut graph = Graph::default();
        let colours = if of_picture { channels } else { 2 };
        let mut input = graph.push(Op::Picture, &[], [colours, height, width]);
        if !of_picture {
            input = push_conv(&mut graph, &mut dice, input, POINT, channels).unwrap();
        }
        let window = random_window(&mut dice);
        let outputs = dice.of(&[1, 4, 13, 16, 33]);
        let Some(output) = push_conv(&mut graph, &mut dice, input, window, outputs) else {
            continue;
        };
        let output = match dice.below(3) {
            0 => graph.push_activation(Activation::Relu, output),
            1 => graph.push_activation(Activation::Leaky(0.1), output),
            _ => output,
        };
        graph.outputs = vec![output];
        let [_, y, x] = graph.nodes[output].shape;
        if (window.before[0] >= height && y > 2) || x == 0 {
            continue;
        }
        let picture = dice.values(colours * height * width);
        assert_computed(
            &graph,
            &picture,
            &format!("{channels} of {height}x{width}, {window:?}"),
        );
        done += 1;
    }
}

#[test]
fn poolings_of_all_shapes_are_what_they_should() {
    let mut dice = Dice(2);
    let mut done = 0;
    while done < 200 {
        let (height, width) = (1 + dice.below(9), 1 + dice.below(30));
        let channels = dice.of(&[1, 3, 16, 20]);
        let of_picture = dice.below(2) == 0;
        let mut graph = Graph::default();
        let colours = if of_picture { channels } else { 2 };
        let mut input = graph.push(Op::Picture, &[], [colours, height, width]);
        if !of_picture {
            input = push_conv(&mut graph, &mut dice, input, POINT, channels).unwrap();
        }
        let mut window = random_window(&mut dice);
        for axis in 0..2 {
            window.before[axis] = window.before[axis].min(window.kernel[axis] / 2);
        }
        let sizes = [0, 1].map(|axis| size_after([height, width][axis], &window, axis, 0));
        let [Some(rows), Some(columns)] = sizes else {
            continue;
        };
        let output = graph.push(Op::MaxPool(window), &[input], [channels, rows, columns]);
        graph.outputs = vec![output];
        let sees = |axis: usize, position: usize| {
            let size = [height, width][axis];
            steps::seen(&window, axis, position, size).next().is_some()
        };
        if !(0..rows).all(|y| sees(0, y)) || !(0..columns).all(|x| sees(1, x)) {
            continue;
        }
        let picture = dice.values(colours * height * width);
        assert_computed(
            &graph,
            &picture,
            &format!("{channels} of {height}x{width}, {window:?}"),
        );
        done += 1;
    }
}

/// Any operator on any earlier value that it fits, and several outputs: fusing, concatenating in place and using memory again
/// must not change what is computed.
#[test]
fn graphs_of_all_operators_are_what_they_should() {
    let mut dice = Dice(3);
    let mut kinds = [0; 8];
    for round in 0..400 {
        let mut graph = Graph::default();
        let (height, width) = (2 + dice.below(4), 3 + dice.below(22));
        graph.push(Op::Picture, &[], [3, height, width]);
        let outputs = dice.of(&[13, 16, 16, 32]);
        push_conv(&mut graph, &mut dice, 0, POINT, outputs).unwrap();
        let pool = Window {
            kernel: [3, 3],
            before: [1, 1],
            ..POINT
        };
        graph.push(Op::MaxPool(pool), &[0], [3, height, width]);
        for _ in 0..12 {
            // All but the picture and margins, which only convolutions read.
            let usable = |&id: &NodeId| id > 0 && !matches!(graph.nodes[id].op, Op::Margin(_));
            let usable: Vec<NodeId> = (0..graph.nodes.len()).filter(usable).collect();
            let input = dice.of(&usable);
            let shape = graph.nodes[input].shape;
            let [channels, height, width] = shape;
            // A later value of the same size, or of the same number of rows and columns.
            let mut later = usable.iter().rev().copied();
            let other = later.clone().find(|&id| graph.nodes[id].shape == shape);
            let beside = later.find(|&id| graph.nodes[id].shape[1..] == shape[1..] && id != input);
            let kind = dice.below(8);
            match (kind, other, beside) {
                (0, Some(other), _) => graph.push(Op::Add, &[input, other], shape),
                (1, _, Some(beside)) => {
                    let channels = channels + graph.nodes[beside].shape[0];
                    graph.push(Op::Concat, &[input, beside], [channels, height, width])
                }
                (2, ..) => {
                    let more = dice.of(&[0, 3, 16]);
                    graph.push(Op::Concat, &[input], [channels + more, height, width])
                }
                (3, ..) => {
                    let activation = dice.of(&[Activation::Relu, Activation::Leaky(0.2)]);
                    graph.push_activation(activation, input)
                }
                (4, ..) => {
                    let (factor, offset) = (dice.values(channels), dice.values(channels));
                    graph.push(Op::Scale { factor, offset }, &[input], shape)
                }
                (5, ..) if height < 8 => {
                    graph.push(Op::Resize, &[input], [channels, 2 * height, 2 * width])
                }
                (6, ..) => graph.push(Op::MaxPool(pool), &[input], shape),
                (7, ..) => {
                    let margin = [channels, height + 2, width + 4];
                    let margin = graph.push(Op::Margin([1, 2]), &[input], margin);
                    let window = Window {
                        kernel: [3, 5],
                        ..POINT
                    };
                    let outputs = dice.of(&[5, 16, 32]);
                    push_conv(&mut graph, &mut dice, margin, window, outputs).unwrap()
                }
                _ => {
                    let window = Window {
                        kernel: [3, 3],
                        dilation: [1, 2],
                        before: [1, 2],
                        ..POINT
                    };
                    push_conv(&mut graph, &mut dice, input, window, channels).unwrap()
                }
            };
            kinds[kind] += 1;
        }
        let last = graph.nodes.len() - 1;
        graph.outputs = vec![last, 1 + dice.below(last)];
        if graph.nodes.iter().any(|node| node.shape[0] > 200)
            || graph
                .outputs
                .iter()
                .any(|&id| matches!(graph.nodes[id].op, Op::Margin(_)))
        {
            continue;
        }
        // Values grow from sum to sum; the comparison is relative to the largest.
        let picture = dice.values(3 * height * width);
        assert_computed(&graph, &picture, &format!("graph {round}"));
    }
    assert!(kinds.iter().all(|&count| count > 50), "{kinds:?}");
}

#[test]
fn channels_unfold_to_squares() {
    let mut dice = Dice(4);
    let mut graph = Graph::default();
    let picture = graph.push(Op::Picture, &[], [3, 4, 5]);
    let conv = push_conv(&mut graph, &mut dice, picture, POINT, 18).unwrap();
    let output = graph.push(Op::Unfold { side: 3 }, &[conv], [2, 12, 15]);
    graph.nodes[conv].shape = [18, 4, 5];
    graph.outputs = vec![output];
    assert_computed(&graph, &dice.values(60), "unfolded");
}

#[test]
fn what_no_step_computes_is_refused() {
    let refused = |op: Op, shape: [usize; 3]| {
        let mut graph = Graph::default();
        let picture = graph.push(Op::Picture, &[], [3, 4, 5]);
        graph.outputs = vec![graph.push(op, &[picture], shape)];
        Plan::new(&graph.fused(), Kernel::Portable).err().unwrap()
    };
    let scale = |value: f32| Op::Scale {
        factor: vec![value; 3],
        offset: vec![0.0; 3],
    };
    assert!(refused(scale(2.0), [3, 4, 5]).contains("not known"));
    assert!(refused(Op::Resize, [3, 8, 10]).contains("not known"));
    assert!(refused(Op::Margin([1, 1]), [3, 6, 7]).contains("zeros around"));
    let far = Window {
        kernel: [1, 1],
        before: [0, 5_000],
        ..POINT
    };
    assert!(refused(Op::MaxPool(far), [3, 4, 5_005]).contains("odd"));
    let beside = Window {
        before: [0, 2],
        ..POINT
    };
    assert!(refused(Op::MaxPool(beside), [3, 4, 9]).contains("largest value of nothing"));
    let infinite = Op::Conv {
        window: POINT,
        weights: vec![f32::INFINITY; 3],
        bias: vec![0.0],
    };
    assert!(refused(infinite, [1, 4, 5]).contains("not finite"));
}

fn shipped() -> Vec<ModelSpec> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration");
    let files = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    files
        .filter(|path| path.extension().is_some_and(|e| e == "onnx"))
        .map(|path| ModelSpec::new(Some(&path), ModelOptions::default()).unwrap())
        .collect()
}

/// Activations of a model's taps, and its lane head's answer, for values other than those that loading compares.
fn answers(encoder: &Encoder, picture: &[f32]) -> Vec<Vec<f32>> {
    let mut session = encoder.session().unwrap();
    let maps = session.run(picture).unwrap();
    maps.iter().map(|map| map.activations.to_vec()).collect()
}

#[test]
fn the_shipped_models_run_in_our_executor_and_answer_as_in_tract() {
    let models = shipped();
    assert!(models.len() >= 5, "{} models", models.len());
    for spec in models {
        let [own, tract] = [Executor::Fastest, Executor::Tract]
            .map(|executor| Encoder::load_for(&spec, spec.lane.as_ref(), executor).unwrap());
        assert!(own.executor().starts_with("own"), "{}", spec.name);
        assert_eq!(tract.executor(), "tract");
        let mut dice = Dice(5);
        let picture = dice.values(own.input_shape.iter().product());
        let (ours, theirs) = (answers(&own, &picture), answers(&tract, &picture));
        assert_eq!((ours.len(), theirs.len()), (4, 4));
        for (ours, theirs) in ours.iter().zip(&theirs) {
            let apart = difference(ours, theirs);
            assert!(apart <= DIFFERENCE_MAX / 10.0, "{}: {apart:e}", spec.name);
        }
        // The taps do not depend on what else is computed.
        let taps_alone = answers(&Encoder::load(&spec).unwrap(), &picture);
        assert_eq!(taps_alone, ours[..3], "{}", spec.name);
    }
}

#[test]
fn a_model_computes_the_same_bits_in_every_thread() {
    let spec = ModelSpec::new(None, ModelOptions::default()).unwrap();
    let encoder = Encoder::load(&spec).unwrap();
    let picture = Dice(6).values(encoder.input_shape.iter().product());
    let alone = answers(&encoder, &picture);
    let together = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..3)
            .map(|_| scope.spawn(|| answers(&encoder, &picture)))
            .collect();
        threads
            .into_iter()
            .map(|thread| thread.join().unwrap())
            .collect::<Vec<_>>()
    });
    assert!(together.iter().all(|answer| *answer == alone));
}

#[test]
fn a_plan_that_differs_from_tract_is_not_used() {
    let bytes = model(&[conv("c", "image", 4), relu("tap", "c")]);
    let typed = {
        let mut model = tract_onnx::onnx().model_for_read(&mut &*bytes).unwrap();
        model
            .set_input_fact(0, f32::fact([1, 3, 16, 32]).into())
            .unwrap();
        model.into_typed().unwrap()
    };
    let tract = typed
        .clone()
        .into_optimized()
        .unwrap()
        .into_runnable()
        .unwrap();
    let mut graph = lowering::lower(&typed).unwrap().fused();
    let agrees_with = |graph: &Graph| {
        let plan = Plan::new(graph, Kernel::available()[0]).unwrap();
        agrees(&plan, &tract, &[1, 3, 16, 32], "tiny")
    };
    assert!(agrees_with(&graph));
    bias_of(&mut graph)[0] += 0.01;
    assert!(!agrees_with(&graph));
    bias_of(&mut graph)[0] = f32::MAX;
    assert!(!agrees_with(&graph));
}

fn bias_of(graph: &mut Graph) -> &mut [f32] {
    match &mut graph.nodes[1].op {
        Op::Conv { bias, .. } => bias,
        op => panic!("{op:?}"),
    }
}

#[test]
fn known_operators_run_in_our_executor_and_others_in_tract() {
    let ours = [
        vec![
            conv("c", "image", 20),
            node("LeakyRelu", &["c"], "tap", &[]),
        ],
        vec![
            conv("c", "image", 4),
            relu("r", "c"),
            node("Identity", &["r"], "tap", &[]),
        ],
        vec![
            conv("a", "image", 5),
            conv("b", "image", 5),
            node("Add", &["a", "b"], "s", &[]),
            node("Concat", &["s", "a"], "tap", &[int("axis", 1)]),
        ],
        vec![
            conv("c", "image", 3),
            node("Mul", &["c", "half"], "m", &[]),
            relu("tap", "m"),
        ],
        vec![
            conv("c", "image", 3),
            node("Sub", &["half", "c"], "tap", &[]),
        ],
        vec![
            conv("c", "image", 3),
            node("Div", &["c", "half"], "tap", &[]),
        ],
        vec![
            conv("c", "image", 3),
            node(
                "MaxPool",
                &["c"],
                "tap",
                &[ints("kernel_shape", &[2, 2]), ints("strides", &[2, 2])],
            ),
        ],
    ];
    for nodes in ours {
        let spec = spec_of(&nodes);
        let encoder = Encoder::load(&spec).unwrap();
        assert!(encoder.executor().starts_with("own"), "{nodes:?}");
        let picture = Dice(7).values(3 * 16 * 32);
        let tract = Encoder::load_in(&spec, Executor::Tract).unwrap();
        let (ours, theirs) = (answers(&encoder, &picture), answers(&tract, &picture));
        assert!(difference(&ours[0], &theirs[0]) < 1e-6, "{nodes:?}");
    }
    let theirs = [
        vec![conv("c", "image", 4), node("Sigmoid", &["c"], "tap", &[])],
        vec![conv("c", "image", 4), node("Mul", &["c", "c"], "tap", &[])],
        vec![
            conv("c", "image", 4),
            node("Div", &["half", "c"], "tap", &[]),
        ],
        vec![relu("tap", "image")],
        vec![
            conv("c", "image", 4),
            node(
                "AveragePool",
                &["c"],
                "tap",
                &[ints("kernel_shape", &[2, 2])],
            ),
        ],
    ];
    for nodes in theirs {
        let encoder = Encoder::load(&spec_of(&nodes)).unwrap();
        assert_eq!(encoder.executor(), "tract", "{nodes:?}");
        let picture = Dice(8).values(3 * 16 * 32);
        assert_eq!(answers(&encoder, &picture).len(), 1);
    }
}

/// Where tract's ReLU would make 0 of NaN and hide it.
#[test]
fn values_that_are_not_finite_stay_visible() {
    let window = [ints("kernel_shape", &[3, 3]), ints("pads", &[1, 1, 1, 1])];
    for nodes in [
        vec![conv("c", "image", 20), relu("tap", "c")],
        vec![
            conv("c", "image", 20),
            node("LeakyRelu", &["c"], "tap", &[]),
        ],
        vec![
            conv("c", "image", 4),
            relu("r", "c"),
            node("MaxPool", &["r"], "tap", &window),
        ],
        vec![
            conv("c", "image", 13),
            node("MaxPool", &["image"], "p", &window),
            node("Concat", &["c", "p"], "s", &[int("axis", 1)]),
            relu("tap", "s"),
        ],
    ] {
        let encoder = Encoder::load(&spec_of(&nodes)).unwrap();
        assert!(encoder.executor().starts_with("own"), "{nodes:?}");
        for broken in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut picture = Dice(9).values(3 * 16 * 32);
            picture[5 * 32 + 7] = broken;
            let tap = &answers(&encoder, &picture)[0];
            assert!(tap.iter().any(|v| !v.is_finite()), "{nodes:?} {broken}");
            assert!(tap[12 * 32 + 20].is_finite(), "{nodes:?} {broken}");
        }
    }
}

#[test]
fn an_input_of_another_size_is_refused() {
    let encoder = Encoder::load(&spec_of(&[conv("tap", "image", 4)])).unwrap();
    let mut session = encoder.session().unwrap();
    let why = session.run(&[0.0; 12]).err().unwrap();
    assert!(
        why.contains("12 values") && why.contains("[3, 16, 32]"),
        "{why}"
    );
}

fn refusal(onnx: Vec<u8>) -> String {
    let spec = ModelSpec {
        onnx: Cow::Owned(onnx),
        ..spec_of(&[])
    };
    Encoder::load(&spec).err().unwrap().to_string()
}

#[test]
fn a_file_that_needs_other_files_is_refused() {
    let outside = block(13, &[block(1, b"location"), block(2, b"../w.bin")].concat());
    let weights = |more: &[u8]| {
        let tensor = [tensor("w3", &[3, 3, 3, 3], &[]), more.to_vec()].concat();
        let graph = [block(1, &relu("tap", "image")), block(5, &tensor)].concat();
        [number(1, 8), block(7, &graph)].concat()
    };
    for more in [outside.clone(), number(14, 1)] {
        let said = refusal(weights(&more));
        assert!(said.contains("external data"), "{said}");
    }
    // In an attribute of a node of a graph in an attribute, too.
    let constant = node(
        "Constant",
        &[],
        "c",
        &[[block(1, b"value"), block(5, &outside)].concat()],
    );
    let inner = block(6, &block(1, &constant));
    let said = refusal(block(
        7,
        &block(1, &node("If", &["image"], "tap", &[inner])),
    ));
    assert!(said.contains("external data"), "{said}");
}

#[test]
fn a_file_that_would_cost_too_much_is_refused_before_it_is_read() {
    // Two bytes each, hundreds once they are read.
    let nodes = block(7, &block(1, &[]).repeat(20_001));
    assert!(refusal(nodes).contains("more than 20000 nodes"));
    let attributes = block(7, &block(1, &block(5, &[]).repeat(400_001)));
    assert!(refusal(attributes).contains("more than 400000 parts"));
    let mut deep = Vec::new();
    for _ in 0..20 {
        deep = block(1, &block(5, &block(6, &deep)));
    }
    assert!(refusal(block(7, &deep)).contains("nested deeper"));
    assert!(limits::check(&vec![0; 257 << 20]).is_err_and(|why| why.contains("bytes")));
}

#[test]
fn every_shipped_model_is_far_within_the_limits() {
    for spec in shipped() {
        assert_eq!(limits::check(&spec.onnx), Ok(()), "{}", spec.name);
    }
}

// Tiny ONNX files, written field by field.

fn varint(mut value: u64, into: &mut Vec<u8>) {
    while value >= 0x80 {
        into.push(value as u8 | 0x80);
        value >>= 7;
    }
    into.push(value as u8);
}

fn number(field: u64, value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    varint(field << 3, &mut bytes);
    varint(value, &mut bytes);
    bytes
}

fn block(field: u64, content: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    varint(field << 3 | 2, &mut bytes);
    varint(content.len() as u64, &mut bytes);
    bytes.extend(content);
    bytes
}

fn int(name: &str, value: u64) -> Vec<u8> {
    [block(1, name.as_bytes()), number(3, value), number(20, 2)].concat()
}

fn ints(name: &str, values: &[u64]) -> Vec<u8> {
    let values = values.iter().flat_map(|&value| number(8, value));
    [block(1, name.as_bytes()), values.collect(), number(20, 7)].concat()
}

fn node(op: &str, inputs: &[&str], output: &str, attributes: &[Vec<u8>]) -> Vec<u8> {
    let inputs = inputs.iter().flat_map(|input| block(1, input.as_bytes()));
    let attributes = attributes.iter().flat_map(|attribute| block(5, attribute));
    let mut bytes: Vec<u8> = inputs.collect();
    bytes.extend(block(2, output.as_bytes()));
    bytes.extend(block(4, op.as_bytes()));
    bytes.extend(attributes);
    bytes
}

fn relu(output: &str, input: &str) -> Vec<u8> {
    node("Relu", &[input], output, &[])
}

/// A 3x3 convolution of the picture; its weights are the initialiser of that many outputs.
fn conv(output: &str, input: &str, outputs: usize) -> Vec<u8> {
    let weights = format!("w{outputs}");
    node(
        "Conv",
        &[input, &weights],
        output,
        &[ints("pads", &[1, 1, 1, 1])],
    )
}

fn tensor(name: &str, dims: &[u64], values: &[f32]) -> Vec<u8> {
    let dims = dims.iter().flat_map(|&dim| number(1, dim));
    let mut bytes: Vec<u8> = dims.collect();
    bytes.extend(number(2, 1));
    bytes.extend(block(8, name.as_bytes()));
    let raw: Vec<u8> = values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    bytes.extend(block(9, &raw));
    bytes
}

fn model(nodes: &[Vec<u8>]) -> Vec<u8> {
    let value = |name: &str, dims: &[u64]| {
        let dims: Vec<u8> = dims
            .iter()
            .flat_map(|&dim| block(1, &number(1, dim)))
            .collect();
        let tensor = [number(1, 1), block(2, &dims)].concat();
        [block(1, name.as_bytes()), block(2, &block(1, &tensor))].concat()
    };
    let mut graph: Vec<u8> = nodes.iter().flat_map(|node| block(1, node)).collect();
    graph.extend(block(2, b"tiny"));
    for outputs in [3, 4, 5, 13, 20] {
        let weights = Dice(outputs).values(27 * outputs as usize);
        graph.extend(block(
            5,
            &tensor(&format!("w{outputs}"), &[outputs, 3, 3, 3], &weights),
        ));
    }
    graph.extend(block(5, &tensor("half", &[], &[0.5])));
    graph.extend(block(11, &value("image", &[1, 3, 16, 32])));
    let output = [block(1, b"tap"), block(2, &block(1, &number(1, 1)))].concat();
    graph.extend(block(12, &output));
    let opset = block(8, &number(2, 13));
    [number(1, 8), opset, block(7, &graph)].concat()
}

fn spec_of(nodes: &[Vec<u8>]) -> ModelSpec {
    ModelSpec {
        name: "tiny".to_owned(),
        onnx: Cow::Owned(model(nodes)),
        taps: vec!["tap".to_owned()],
        lane: None,
        preprocessing: Preprocessing {
            width: 32,
            height: 16,
            mean: [0.5; 3],
            std: [0.5; 3],
            crop: crate::model::preprocess::CROP_NOTHING,
        },
    }
}
