//! A small network as an ONNX file.

// Protobuf, field by field.

fn varint(mut value: u64, into: &mut Vec<u8>) {
    while value >= 0x80 {
        into.push(value.to_le_bytes()[0] | 0x80);
        value >>= 7;
    }
    into.push(value.to_le_bytes()[0]);
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
    [bytes, content.to_vec()].concat()
}

/// A picture through a convolution of four channels, pooled, and a ReLU; the weights may be in a second file.
pub fn tiny_onnx(outside: bool) -> Vec<u8> {
    let node = |op: &str, inputs: &[&str], output: &str, attributes: &[(&str, &[u64])]| {
        let inputs = inputs.iter().flat_map(|name| block(1, name.as_bytes()));
        let attributes = attributes.iter().flat_map(|(name, values)| {
            let values = values.iter().flat_map(|&value| number(8, value));
            let parts = [block(1, name.as_bytes()), values.collect(), number(20, 7)];
            block(5, &parts.concat())
        });
        let mut bytes: Vec<u8> = inputs.collect();
        bytes.extend(block(2, output.as_bytes()));
        bytes.extend(block(4, op.as_bytes()));
        bytes.extend(attributes);
        block(1, &bytes)
    };
    let mut weights: Vec<u8> = [4, 3, 3, 3]
        .iter()
        .flat_map(|&dim| number(1, dim))
        .collect();
    weights.extend(number(2, 1));
    weights.extend(block(8, b"w"));
    if outside {
        for (key, value) in [("location", "w.bin"), ("offset", "4"), ("length", "432")] {
            let entry = [block(1, key.as_bytes()), block(2, value.as_bytes())];
            weights.extend(block(13, &entry.concat()));
        }
        weights.extend(number(14, 1));
    } else {
        weights.extend(block(9, &values()));
    }
    let dims = [1, 3, 16, 32]
        .iter()
        .flat_map(|&dim| block(1, &number(1, dim)));
    let input = [number(1, 1), block(2, &dims.collect::<Vec<u8>>())].concat();
    let graph = [
        node("Conv", &["image", "w"], "c", &[("pads", &[1, 1, 1, 1])]),
        node(
            "MaxPool",
            &["c"],
            "p",
            &[("kernel_shape", &[2, 2]), ("strides", &[2, 2])],
        ),
        node("Relu", &["p"], "tap", &[]),
        block(2, b"tiny"),
        block(5, &weights),
        block(
            11,
            &[block(1, b"image"), block(2, &block(1, &input))].concat(),
        ),
        block(
            12,
            &[block(1, b"tap"), block(2, &block(1, &number(1, 1)))].concat(),
        ),
    ];
    [
        number(1, 8),
        block(8, &number(2, 13)),
        block(7, &graph.concat()),
    ]
    .concat()
}

/// The weights of the tiny network.
pub fn values() -> Vec<u8> {
    let values = (0..108_u8).flat_map(|n| (f32::from(n) / 108.0 - 0.5).to_le_bytes());
    values.collect()
}
