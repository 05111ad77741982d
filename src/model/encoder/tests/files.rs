//! Files that say too much, or whose weights are in other files.

use super::*;
use crate::model::DataFile;

fn refused(spec: &ModelSpec) -> String {
    Encoder::load(spec).err().unwrap().to_string()
}

fn refusal(onnx: Vec<u8>) -> String {
    refused(&ModelSpec {
        onnx: Cow::Owned(onnx),
        ..spec_of(&[])
    })
}

/// A tiny model whose weights of the convolution are `length` bytes from `offset` of `w.bin`, and that file.
fn in_two_files(offset: &str, length: &str) -> ModelSpec {
    let whole = Dice(3).values(81);
    let bytes = whole.iter().flat_map(|value| value.to_le_bytes());
    let entry = |key: &str, value: &str| {
        block(
            13,
            &[block(1, key.as_bytes()), block(2, value.as_bytes())].concat(),
        )
    };
    let weights = [
        number(1, 3),
        number(1, 3),
        number(1, 3),
        number(1, 3),
        number(2, 1),
        block(8, b"outside"),
        entry("location", "w.bin"),
        entry("offset", offset),
        entry("length", length),
        number(14, 1),
    ];
    let pads = [ints("pads", &[1, 1, 1, 1])];
    let conv = node("Conv", &["image", "outside"], "tap", &pads);
    let more = block(7, &block(5, &weights.concat()));
    ModelSpec {
        // Fields of a message that comes twice are merged.
        onnx: Cow::Owned([model(&[conv]), more].concat()),
        data: vec![DataFile {
            name: "w.bin".to_owned(),
            bytes: [0; 8].into_iter().chain(bytes).collect(),
        }],
        ..spec_of(&[])
    }
}

#[test]
fn weights_in_another_file_are_those_in_the_model() {
    let picture = Dice(10).values(3 * 16 * 32);
    let outside = Encoder::load(&in_two_files("8", "324")).unwrap();
    let inside = Encoder::load(&spec_of(&[conv("tap", "image", 3)])).unwrap();
    assert_eq!(answers(&outside, &picture), answers(&inside, &picture));
    let mut other = in_two_files("8", "324");
    other.data[0].bytes[0] = 1;
    let other = Encoder::load(&other).unwrap();
    assert_eq!(answers(&other, &picture), answers(&inside, &picture));
    assert_ne!(other.sha256(), outside.sha256());
}

#[test]
fn weights_outside_of_their_file_are_refused() {
    for (offset, length, said) in [
        (
            "9",
            "324",
            "324 bytes from byte 9 of w.bin, which has only 332 bytes",
        ),
        ("18446744073709551615", "324", "which has only"),
        (
            "8",
            "320",
            "320 bytes in w.bin; wanted 324 for the shape [3, 3, 3, 3]",
        ),
        ("-8", "324", "offset \"-8\"; wanted a number"),
    ] {
        let refused = refused(&in_two_files(offset, length));
        assert!(
            refused.contains("outside") && refused.contains(said),
            "{refused}"
        );
    }
    let spec = ModelSpec {
        data: Vec::new(),
        ..in_two_files("8", "324")
    };
    assert!(refused(&spec).contains("which was not read"));
}

#[test]
fn a_file_that_would_cost_too_much_is_refused_before_it_is_read() {
    // They have two bytes each in the file, and hundreds in memory.
    let nodes = block(7, &block(1, &[]).repeat(20_001));
    assert!(refusal(nodes).contains("more than 20000 nodes"));
    let attributes = block(7, &block(1, &block(5, &[]).repeat(400_001)));
    assert!(refusal(attributes).contains("more than 400000 parts"));
    let mut deep = Vec::new();
    for _ in 0..20 {
        deep = block(1, &block(5, &block(6, &deep)));
    }
    assert!(refusal(block(7, &deep)).contains("nested deeper"));
    let large = onnx_file::described(&vec![0; 257 << 20]);
    assert!(large.is_err_and(|why| why.contains("bytes")));
    let names = (0..65).map(|n| {
        block(
            13,
            &[block(1, b"location"), block(2, format!("{n}").as_bytes())].concat(),
        )
    });
    let tensors = names.flat_map(|entry| block(5, &entry)).collect::<Vec<_>>();
    assert!(refusal(block(7, &tensors)).contains("more than 64 files"));
}

#[test]
fn every_shipped_model_is_far_within_the_limits() {
    for spec in shipped() {
        let described = onnx_file::described(&spec.onnx);
        assert_eq!(
            described,
            Ok(onnx_file::Described::default()),
            "{}",
            spec.name
        );
    }
}

#[test]
fn files_of_weights_and_bytes_are_seen_wherever_they_are() {
    let outside = block(13, &[block(1, b"location"), block(2, b"../w.bin")].concat());
    let value = [block(1, b"value"), block(5, &outside)].concat();
    let inner = block(6, &block(1, &node("Constant", &[], "c", &[value])));
    let file = block(7, &block(1, &node("If", &["image"], "tap", &[inner])));
    let described = onnx_file::described(&file).unwrap();
    assert!(described.data_files.iter().eq(["../w.bin"]) && !described.takes_bytes);
    let kind = |elem: u64| block(2, &block(1, &number(1, elem)));
    let input = |name: &str, elem| block(11, &[block(1, name.as_bytes()), kind(elem)].concat());
    let bytes = |graph: &[Vec<u8>]| {
        onnx_file::described(&block(7, &graph.concat()))
            .unwrap()
            .takes_bytes
    };
    assert!(bytes(&[input("x", 2)]));
    assert!(!bytes(&[input("x", 1)]));
    assert!(!bytes(&[
        input("x", 1),
        input("w", 2),
        block(5, &block(8, b"w"))
    ]));
}
