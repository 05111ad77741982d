//! Operators that are refused, or computed in another way than tract would.

use super::*;

fn refusal(nodes: &[Vec<u8>]) -> String {
    Encoder::load(&spec_of(nodes)).err().unwrap().to_string()
}

fn float(name: &str, value: f32) -> Vec<u8> {
    let bits = [&[0x15][..], &value.to_le_bytes()].concat();
    [block(1, name.as_bytes()), bits, number(20, 1)].concat()
}

fn word(name: &str, value: &str) -> Vec<u8> {
    [
        block(1, name.as_bytes()),
        block(4, value.as_bytes()),
        number(20, 3),
    ]
    .concat()
}

#[test]
fn an_operator_that_is_not_known_is_refused_by_name() {
    let after = |op: &str, attributes: &[Vec<u8>]| {
        refusal(&[conv("c", "image", 4), node(op, &["c"], "tap", attributes)])
    };
    assert!(
        after("LpPool", &[])
            .contains("its operator LpPool (value tap) is not supported: not known")
    );
    assert!(after("Relu", &[int("odd", 1)]).contains("with the attribute odd"));
    assert!(after("LRN", &[int("size", 4)]).contains("with an even size"));
    assert!(after("GlobalLpPool", &[]).contains("GlobalLpPool"));
    let mut foreign = node("Relu", &["c"], "tap", &[]);
    foreign.extend(block(7, b"com.other"));
    let said = refusal(&[conv("c", "image", 4), foreign]);
    assert!(said.contains("it is of com.other, not of ONNX"), "{said}");
}

#[test]
fn what_does_not_lead_to_the_taps_need_not_be_known() {
    let nodes = [
        conv("tap", "image", 4),
        node("Unheard", &["tap"], "boxes", &[]),
        node("Unheard", &["other"], "more", &[]),
    ];
    assert!(Encoder::load(&spec_of(&nodes)).is_ok());
}

#[test]
fn celu_is_what_it_should_be() {
    let values = |op: &str, attributes: &[Vec<u8>]| {
        let nodes = [conv("c", "image", 4), node(op, &["c"], "tap", attributes)];
        let encoder = Encoder::load(&spec_of(&nodes)).unwrap();
        answers(&encoder, &Dice(11).values(3 * 16 * 32)).remove(0)
    };
    let (before, after) = (
        values("Identity", &[]),
        values("Celu", &[float("alpha", 2.0)]),
    );
    assert!(before.iter().any(|&x| x < -0.5) && before.iter().any(|&x| x > 0.5));
    for (x, y) in before.iter().zip(after) {
        let wanted = x.max(0.0) + (2.0 * ((x / 2.0).exp() - 1.0)).min(0.0);
        assert!((y - wanted).abs() < 1e-5, "{x}: {y}, wanted {wanted}");
    }
}

/// tract turns the difference around when it merges it into the convolution.
#[test]
fn what_tract_makes_worse_by_optimising_runs_as_it_is() {
    let offset = [block(
        5,
        &tensor("offsets", &[4, 1, 1], &[1.0, 2.0, 3.0, 4.0]),
    )]
    .concat();
    let graph = |nodes: &[Vec<u8>]| ModelSpec {
        onnx: Cow::Owned([model(nodes), block(7, &offset)].concat()),
        ..spec_of(&[])
    };
    let picture = Dice(12).values(3 * 16 * 32);
    let plain = Encoder::load(&graph(&[conv("tap", "image", 4)])).unwrap();
    let less = [
        conv("c", "image", 4),
        node("Sub", &["offsets", "c"], "tap", &[]),
    ];
    for executor in [Executor::Fastest, Executor::Tract] {
        let less = Encoder::load_in(&graph(&less), executor).unwrap();
        assert_eq!(less.executor() == "tract", executor == Executor::Tract);
        let (values, less) = (answers(&plain, &picture), answers(&less, &picture));
        for (index, (value, less)) in values[0].iter().zip(&less[0]).enumerate() {
            let wanted = [1.0, 2.0, 3.0, 4.0][index / (16 * 32)] - value;
            assert!(
                (less - wanted).abs() < 1e-4,
                "{executor:?}: {less}, wanted {wanted}"
            );
        }
    }
}

#[test]
fn the_nearest_pixels_are_gathered() {
    let scales = tensor("scales", &[4], &[1.0, 1.0, 2.0, 2.0]);
    let attributes = [
        word("mode", "nearest"),
        word("coordinate_transformation_mode", "asymmetric"),
        word("nearest_mode", "floor"),
    ];
    let nodes = [
        conv("c", "image", 4),
        node("Resize", &["c", "", "scales"], "tap", &attributes),
    ];
    let spec = ModelSpec {
        onnx: Cow::Owned([model(&nodes), block(7, &block(5, &scales))].concat()),
        ..spec_of(&[])
    };
    let picture = Dice(13).values(3 * 16 * 32);
    let large = answers(&Encoder::load(&spec).unwrap(), &picture).remove(0);
    let small = Encoder::load(&spec_of(&[conv("tap", "image", 4)])).unwrap();
    let small = answers(&small, &picture).remove(0);
    assert_eq!(large.len(), 4 * small.len());
    for (index, value) in large.iter().enumerate() {
        let (channel, y, x) = (index / (32 * 64), index / 64 % 32, index % 64);
        let wanted = small[channel * 16 * 32 + y / 2 * 32 + x / 2];
        assert!((value - wanted).abs() < 1e-6);
    }
}

#[test]
fn bytes_are_fed_as_they_are() {
    let input = [
        number(1, 2),
        block(
            2,
            &[1, 3, 16, 32].map(|dim| block(1, &number(1, dim))).concat(),
        ),
    ];
    let input = [block(1, b"bytes"), block(2, &block(1, &input.concat()))].concat();
    let cast = node("Cast", &["bytes"], "floats", &[int("to", 1)]);
    let graph = [
        block(1, &cast),
        block(1, &conv("tap", "floats", 3)),
        block(5, &tensor("w3", &[3, 3, 3, 3], &[0.1; 81])),
        block(11, &input),
        block(12, &block(1, b"tap")),
    ];
    let onnx = [
        number(1, 8),
        block(8, &number(2, 13)),
        block(7, &graph.concat()),
    ]
    .concat();
    let spec = ModelSpec {
        onnx: Cow::Owned(onnx),
        ..spec_of(&[])
    };
    let encoder = Encoder::load(&spec).unwrap();
    // A resized picture lies between whole numbers.
    let tap = answers(&encoder, &vec![200.4; 3 * 16 * 32]).remove(0);
    assert!(
        (tap[5 * 32 + 5] - 27.0 * 20.0).abs() < 1e-2,
        "{}",
        tap[5 * 32 + 5]
    );
}
