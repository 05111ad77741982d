//! Which operators are known to be computed as onnxruntime does: a model with another one is refused by name.
//!
//! tract ignores attributes that it does not know, and looks up operators without their domain, so a model could load and
//! compute something else. Every operator here, with these attributes, is compared with onnxruntime by
//! `tests/python/onnx_graphs.py`. What is known to differ there is refused here, or written otherwise in
//! [`rewritten`](super::rewritten).

use tract_onnx::pb::{GraphProto, ModelProto, NodeProto};

use super::parts::Attributes;

/// Sets of operators that were compared. Before 7, values were broadcast in another way.
const OPSETS: std::ops::RangeInclusive<i64> = 7..=26;

/// Operators and their attributes.
const OPERATORS: &[(&str, &[&str])] = &[
    ("Abs", &[]),
    ("Add", &[]),
    ("And", &[]),
    ("ArgMax", &["axis", "keepdims", "select_last_index"]),
    ("ArgMin", &["axis", "keepdims", "select_last_index"]),
    ("Atan", &[]),
    (
        "AveragePool",
        &[
            "auto_pad",
            "ceil_mode",
            "count_include_pad",
            "dilations",
            "kernel_shape",
            "pads",
            "strides",
        ],
    ),
    (
        "BatchNormalization",
        &["epsilon", "momentum", "spatial", "training_mode"],
    ),
    ("Cast", &["saturate", "to"]),
    ("CastLike", &["saturate"]),
    ("Ceil", &[]),
    ("Celu", &["alpha"]),
    ("Clip", &["max", "min"]),
    ("Concat", &["axis"]),
    (
        "Constant",
        &[
            "value",
            "value_float",
            "value_floats",
            "value_int",
            "value_ints",
        ],
    ),
    ("ConstantOfShape", &["value"]),
    (
        "Conv",
        &[
            "auto_pad",
            "dilations",
            "group",
            "kernel_shape",
            "pads",
            "strides",
        ],
    ),
    (
        "ConvInteger",
        &[
            "auto_pad",
            "dilations",
            "group",
            "kernel_shape",
            "pads",
            "strides",
        ],
    ),
    (
        "ConvTranspose",
        &[
            "auto_pad",
            "dilations",
            "group",
            "kernel_shape",
            "output_padding",
            "output_shape",
            "pads",
            "strides",
        ],
    ),
    ("Cos", &[]),
    ("CumSum", &["exclusive", "reverse"]),
    ("DepthToSpace", &["blocksize", "mode"]),
    ("DequantizeLinear", &["axis", "block_size"]),
    ("Div", &[]),
    ("Dropout", &["ratio", "seed"]),
    ("DynamicQuantizeLinear", &[]),
    ("Einsum", &["equation"]),
    ("Elu", &["alpha"]),
    ("Equal", &[]),
    ("Erf", &[]),
    ("Exp", &[]),
    ("Expand", &[]),
    ("EyeLike", &["dtype", "k"]),
    ("Flatten", &["axis"]),
    ("Floor", &[]),
    ("Gather", &["axis"]),
    ("GatherElements", &["axis"]),
    ("GatherND", &["batch_dims"]),
    ("Gelu", &["approximate"]),
    ("Gemm", &["alpha", "beta", "transA", "transB"]),
    ("GlobalAveragePool", &[]),
    ("GlobalMaxPool", &[]),
    ("Greater", &[]),
    ("GreaterOrEqual", &[]),
    ("GridSample", &["align_corners", "mode", "padding_mode"]),
    (
        "GroupNormalization",
        &["epsilon", "num_groups", "stash_type"],
    ),
    ("HardSigmoid", &["alpha", "beta"]),
    ("HardSwish", &[]),
    ("Hardmax", &["axis"]),
    ("Identity", &[]),
    ("If", &["else_branch", "then_branch"]),
    ("InstanceNormalization", &["epsilon"]),
    ("LRN", &["alpha", "beta", "bias", "size"]),
    ("LayerNormalization", &["axis", "epsilon", "stash_type"]),
    ("LeakyRelu", &["alpha"]),
    ("Less", &[]),
    ("LessOrEqual", &[]),
    ("Log", &[]),
    ("LogSoftmax", &["axis"]),
    ("LpNormalization", &["axis", "p"]),
    ("MatMul", &[]),
    ("MatMulInteger", &[]),
    ("Max", &[]),
    (
        "MaxPool",
        &[
            "auto_pad",
            "ceil_mode",
            "dilations",
            "kernel_shape",
            "pads",
            "storage_order",
            "strides",
        ],
    ),
    ("Mean", &[]),
    ("MeanVarianceNormalization", &["axes"]),
    ("Min", &[]),
    ("Mish", &[]),
    ("Mod", &["fmod"]),
    ("Mul", &[]),
    ("Neg", &[]),
    ("NonZero", &[]),
    ("Not", &[]),
    ("OneHot", &["axis"]),
    ("Or", &[]),
    ("PRelu", &[]),
    ("Pad", &["mode", "pads", "value"]),
    ("Pow", &[]),
    (
        "QLinearConv",
        &[
            "auto_pad",
            "dilations",
            "group",
            "kernel_shape",
            "pads",
            "strides",
        ],
    ),
    ("QuantizeLinear", &["axis", "saturate"]),
    ("RMSNormalization", &["axis", "epsilon", "stash_type"]),
    ("Range", &[]),
    ("Reciprocal", &[]),
    ("ReduceL1", &["axes", "keepdims", "noop_with_empty_axes"]),
    ("ReduceL2", &["axes", "keepdims", "noop_with_empty_axes"]),
    (
        "ReduceLogSum",
        &["axes", "keepdims", "noop_with_empty_axes"],
    ),
    (
        "ReduceLogSumExp",
        &["axes", "keepdims", "noop_with_empty_axes"],
    ),
    ("ReduceMax", &["axes", "keepdims", "noop_with_empty_axes"]),
    ("ReduceMean", &["axes", "keepdims", "noop_with_empty_axes"]),
    ("ReduceMin", &["axes", "keepdims", "noop_with_empty_axes"]),
    ("ReduceProd", &["axes", "keepdims", "noop_with_empty_axes"]),
    ("ReduceSum", &["axes", "keepdims", "noop_with_empty_axes"]),
    (
        "ReduceSumSquare",
        &["axes", "keepdims", "noop_with_empty_axes"],
    ),
    ("Relu", &[]),
    ("Reshape", &["allowzero"]),
    (
        "Resize",
        &[
            "antialias",
            "axes",
            "coordinate_transformation_mode",
            "cubic_coeff_a",
            "exclude_outside",
            "extrapolation_value",
            "keep_aspect_ratio_policy",
            "mode",
            "nearest_mode",
        ],
    ),
    ("Round", &[]),
    ("ScatterElements", &["axis", "reduction"]),
    ("ScatterND", &["reduction"]),
    ("Selu", &["alpha", "gamma"]),
    ("Shape", &["end", "start"]),
    ("Shrink", &["bias", "lambd"]),
    ("Sigmoid", &[]),
    ("Sign", &[]),
    ("Sin", &[]),
    ("Sinh", &[]),
    ("Size", &[]),
    ("Slice", &["axes", "ends", "starts"]),
    ("Softmax", &["axis"]),
    ("Softplus", &[]),
    ("Softsign", &[]),
    ("SpaceToDepth", &["blocksize"]),
    ("Split", &["axis", "num_outputs", "split"]),
    ("Sqrt", &[]),
    ("Squeeze", &["axes"]),
    ("Sub", &[]),
    ("Sum", &[]),
    ("Swish", &["alpha"]),
    ("Tanh", &[]),
    ("ThresholdedRelu", &["alpha"]),
    ("Tile", &[]),
    ("TopK", &["axis", "largest", "sorted"]),
    ("Transpose", &["perm"]),
    ("Trilu", &["upper"]),
    ("Unsqueeze", &["axes"]),
    ("Upsample", &["mode", "scales"]),
    ("Where", &[]),
    ("Xor", &[]),
];

/// Refuses a model with an operator that is not known to be computed as onnxruntime does.
///
/// # Errors
/// The node, and what about it is not known, as text.
pub fn check(model: &ModelProto) -> Result<(), String> {
    let mut sets = model.opset_import.iter();
    let own = sets
        .find(|set| is_own(&set.domain))
        .map_or(0, |set| set.version);
    if !OPSETS.contains(&own) {
        return Err(format!(
            "it is of ONNX's operator set {own}; wanted {} to {}",
            OPSETS.start(),
            OPSETS.end()
        ));
    }
    match &model.graph {
        Some(graph) => check_graph(graph, own, false),
        None => Ok(()),
    }
}

fn is_own(domain: &str) -> bool {
    matches!(domain, "" | "ai.onnx")
}

fn check_graph(graph: &GraphProto, opset: i64, is_branch: bool) -> Result<(), String> {
    if let Some(weights) = graph.sparse_initializer.first() {
        let name = weights.values.as_ref().map_or("", |values| &values.name);
        return Err(format!("its weights {name} are sparse; wanted dense ones"));
    }
    for node in &graph.node {
        check_node(node, opset, is_branch).map_err(|why| {
            let output = node.output.first().map_or("", String::as_str);
            format!(
                "its operator {} (value {output}) is not supported: {why}",
                node.op_type
            )
        })?;
        let attributes = node.attribute.iter();
        let mut branches =
            attributes.flat_map(|attribute| attribute.g.iter().chain(&attribute.graphs));
        branches.try_for_each(|branch| check_graph(branch, opset, true))?;
    }
    Ok(())
}

fn check_node(node: &NodeProto, opset: i64, is_branch: bool) -> Result<(), String> {
    if !is_own(&node.domain) {
        return Err(format!(
            "it is of {}, not of ONNX; wanted the model as it was exported, before another program optimised it",
            node.domain
        ));
    }
    let known = OPERATORS.iter().find(|(name, _)| *name == node.op_type);
    let Some((_, attributes)) = known else {
        return Err(
            "not known; wanted taps before it, or an export with other operators".to_owned(),
        );
    };
    for attribute in &node.attribute {
        if !attribute.ref_attr_name.is_empty() {
            return Err(format!("its {} is that of a function", attribute.name));
        }
        if !attributes.contains(&attribute.name.as_str()) {
            return Err(format!("with the attribute {}", attribute.name));
        }
    }
    let of = Attributes(node);
    let not = |what: &str, is: bool| match is {
        true => Err(what.to_owned()),
        false => Ok(()),
    };
    let text = |name| of.text(name, "");
    match node.op_type.as_str() {
        "BatchNormalization" => {
            not("in training mode", of.int("training_mode", 0) != 0)?;
            not("with spatial = 0", of.int("spatial", 1) != 1)
        }
        "DequantizeLinear" => not("in blocks", of.int("block_size", 0) != 0),
        "GridSample" => not(
            "bicubic with the padding of a border",
            matches!(text("mode"), "bicubic" | "cubic") && text("padding_mode") == "border",
        ),
        "LRN" => not("with an even size", of.int("size", 1) % 2 == 0),
        "AveragePool" | "MaxPool" => {
            let auto = of.text("auto_pad", "NOTSET");
            let is_dilated = of
                .ints("dilations")
                .is_some_and(|all| all.iter().any(|&one| one != 1));
            not(
                "with dilations and auto_pad SAME",
                auto.starts_with("SAME") && is_dilated,
            )?;
            not(
                "with ceil_mode and auto_pad VALID",
                auto == "VALID" && of.int("ceil_mode", 0) != 0,
            )?;
            not("with columns first", of.int("storage_order", 0) != 0)
        }
        "Einsum" => not("with dots", text("equation").contains('.')),
        "Pad" => {
            not("with the mode wrap", text("mode") == "wrap")?;
            not("inside a branch", is_branch)
        }
        "Resize" => {
            let is_nearest = of.text("mode", "nearest") == "nearest";
            let crops = text("coordinate_transformation_mode") == "tf_crop_and_resize";
            not("nearest of a crop", is_nearest && crops)?;
            let policy = of.text("keep_aspect_ratio_policy", "stretch");
            let excludes = of.int("exclude_outside", 0) != 0;
            let is_aligned = text("coordinate_transformation_mode") == "align_corners";
            not(
                "align_corners with antialias",
                is_aligned && of.int("antialias", 0) != 0,
            )?;
            not(
                "linear with exclude_outside",
                excludes && text("mode") == "linear",
            )?;
            not(
                "nearest with an aspect ratio",
                is_nearest && policy != "stretch",
            )?;
            not("inside a branch", is_branch)
        }
        // They are written otherwise outside of branches.
        "Celu" | "ConvTranspose" | "Upsample" | "Swish" => not("inside a branch", is_branch),
        "Slice" => not("inside a branch of an old model", is_branch && opset < 10),
        _ => Ok(()),
    }
}
