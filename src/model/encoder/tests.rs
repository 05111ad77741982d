//! Compares our executor with a naive one in 64-bit floats, and with tract.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss
)]

mod files;
mod naive;
mod onnx;
mod operators;

use std::borrow::Cow;
use std::path::Path;

use super::graph::{Activation, Graph, NodeId, Op, Window};
use super::trial::{DIFFERENCE_MAX, Trial, difference};
use super::*;
use crate::model::ModelOptions;
use crate::model::preprocess::Preprocessing;
use crate::model::vectors::Vectors;
use naive::*;
use onnx::*;

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

/// Any operator on any earlier value that fits, and several outputs: fusing, concatenating in place and using memory
/// again must not change the result.
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
            // All nodes except the picture and margins, which only convolutions read.
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
        Plan::new(&graph.fused(), Vectors::Portable).err().unwrap()
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

/// Activations of a model's taps, and its lane head's output, for other values than those that are compared while
/// loading.
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
        // This lane head divides by means of surroundings, which our executor does not compute.
        let all_are_ours = !spec.name.ends_with("-road.onnx");
        assert_eq!(
            own.executor().starts_with("own"),
            all_are_ours,
            "{}",
            spec.name
        );
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
        let alone = Encoder::load(&spec).unwrap();
        assert!(alone.executor().starts_with("own"), "{}", spec.name);
        let taps_alone = answers(&alone, &picture);
        if all_are_ours {
            assert_eq!(taps_alone, ours[..3], "{}", spec.name);
        }
        for (alone, theirs) in taps_alone.iter().zip(&theirs) {
            let apart = difference(alone, theirs);
            assert!(apart <= DIFFERENCE_MAX / 10.0, "{}: {apart:e}", spec.name);
        }
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
    let trial = Trial::new(&typed, [1, 3, 16, 32], false).unwrap();
    let mut graph = lowering::lower(&typed).unwrap().fused();
    let agrees_with = |graph: &Graph| {
        let plan = Plan::new(graph, Vectors::available()[0]).unwrap();
        trial.agrees_with(&plan, "tiny")
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

/// tract's ReLU would turn NaN into 0 and hide it.
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
