//! ONNX files byte by byte.

use super::*;

pub fn varint(mut value: u64, into: &mut Vec<u8>) {
    while value >= 0x80 {
        into.push(value as u8 | 0x80);
        value >>= 7;
    }
    into.push(value as u8);
}

pub fn number(field: u64, value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    varint(field << 3, &mut bytes);
    varint(value, &mut bytes);
    bytes
}

pub fn block(field: u64, content: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    varint(field << 3 | 2, &mut bytes);
    varint(content.len() as u64, &mut bytes);
    bytes.extend(content);
    bytes
}

pub fn int(name: &str, value: u64) -> Vec<u8> {
    [block(1, name.as_bytes()), number(3, value), number(20, 2)].concat()
}

pub fn ints(name: &str, values: &[u64]) -> Vec<u8> {
    let values = values.iter().flat_map(|&value| number(8, value));
    [block(1, name.as_bytes()), values.collect(), number(20, 7)].concat()
}

pub fn node(op: &str, inputs: &[&str], output: &str, attributes: &[Vec<u8>]) -> Vec<u8> {
    let inputs = inputs.iter().flat_map(|input| block(1, input.as_bytes()));
    let attributes = attributes.iter().flat_map(|attribute| block(5, attribute));
    let mut bytes: Vec<u8> = inputs.collect();
    bytes.extend(block(2, output.as_bytes()));
    bytes.extend(block(4, op.as_bytes()));
    bytes.extend(attributes);
    bytes
}

pub fn relu(output: &str, input: &str) -> Vec<u8> {
    node("Relu", &[input], output, &[])
}

/// A 3x3 convolution of the picture; its weights are the initialiser of that many outputs.
pub fn conv(output: &str, input: &str, outputs: usize) -> Vec<u8> {
    let weights = format!("w{outputs}");
    node(
        "Conv",
        &[input, &weights],
        output,
        &[ints("pads", &[1, 1, 1, 1])],
    )
}

pub fn tensor(name: &str, dims: &[u64], values: &[f32]) -> Vec<u8> {
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

pub fn model(nodes: &[Vec<u8>]) -> Vec<u8> {
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

pub fn spec_of(nodes: &[Vec<u8>]) -> ModelSpec {
    ModelSpec {
        name: "tiny".to_owned(),
        onnx: Cow::Owned(model(nodes)),
        data: Vec::new(),
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
