//! Operators that tract computes in another way than onnxruntime, or not at all, as others that it computes alike.
//!
//! Some need no more than their attributes, the others the shapes of their values, which tract infers.

use std::collections::HashMap;

use tract_onnx::model::{ParseResult, ParsingContext};
use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::{GraphProto, ModelProto, NodeProto, TensorProto};
use tract_onnx::prelude::*;
use tract_onnx::tract_hir::infer::Factoid;
use tract_onnx::tract_hir::internal::InferenceOp;

use super::nearest::{Line, SIMPLE, ratio};
use super::parts::{Attributes, int, ints, node, text};

type Nodes = Result<Vec<NodeProto>, String>;

/// The name of tract's own Resize in its register.
const RESIZE: &str = "Resize of tract";

/// tract's reader of ONNX, which reads Resize in the form of operator set 13 in older models too.
pub fn reader() -> tract_onnx::Onnx {
    // Shapes in the file may be for another batch or size; they are inferred again from our input.
    let mut onnx = tract_onnx::onnx()
        .with_ignore_output_shapes(true)
        .with_ignore_value_info(true);
    if let Some(&original) = onnx.op_register.0.get("Resize") {
        onnx.op_register.insert(RESIZE, original);
        onnx.op_register.insert("Resize", resize);
    }
    onnx
}

type Read = TractResult<(Box<dyn InferenceOp>, Vec<String>)>;

fn resize(context: &ParsingContext, node: &NodeProto) -> Read {
    let mut context = context.clone();
    context.onnx_operator_set_version = context.onnx_operator_set_version.max(13);
    let original = context.framework.op_register.0.get(RESIZE).copied();
    let original = original.ok_or_else(|| TractError::msg("Resize is not known"))?;
    original(&context, node)
}

/// Rewrites operators that need no shapes.
///
/// # Errors
/// Which operator, and what about it is not supported, as text.
pub fn without_shapes(model: &mut ModelProto) -> Result<(), String> {
    let sets = model.opset_import.iter();
    let mut own = sets.filter(|set| matches!(set.domain.as_str(), "" | "ai.onnx"));
    let opset = own.next().map_or(0, |set| set.version);
    rewrite(model, |node, graph| plain(node, graph, opset))
}

/// Whether some operator must be rewritten with [`with_shapes`].
pub fn needs_shapes(model: &ModelProto) -> bool {
    let nodes = model.graph.iter().flat_map(|graph| &graph.node);
    nodes.into_iter().any(wants_shapes)
}

/// Rewrites operators that need the shapes of their values, as tract infers them from `read`.
///
/// # Errors
/// Which operator, and what about it is not supported, as text.
pub fn with_shapes(model: &mut ModelProto, read: &ParseResult) -> Result<(), String> {
    let nodes = model.graph.iter().flat_map(|graph| &graph.node);
    let nodes = nodes.filter(|node| wants_shapes(node));
    let names = nodes.flat_map(|node| node.input.iter().chain(&node.output));
    let facts = names.filter_map(|name| {
        let outlet = *read.outlets_by_name.get(name)?;
        Some((name.clone(), read.model.outlet_fact(outlet).ok()?.clone()))
    });
    let known = Known(facts.collect());
    rewrite(model, |node, graph| shaped(node, graph, &known))
}

fn wants_shapes(node: &NodeProto) -> bool {
    let of = Attributes(node);
    match node.op_type.as_str() {
        "ConvTranspose" => of.ints("output_shape").is_some(),
        "Pad" => node.input.len() > 1,
        "Slice" => of.ints("starts").is_some(),
        "Resize" => is_nearest(&of) || is_halved_cubic(&of) || (is_aligned(&of) && !given(node, 3)),
        _ => false,
    }
}

fn is_nearest(of: &Attributes) -> bool {
    of.text("mode", "nearest") == "nearest"
}

/// A cubic Resize as PyTorch writes it: a single pixel is another than onnxruntime's.
fn is_halved_cubic(of: &Attributes) -> bool {
    let mode = of.text("coordinate_transformation_mode", "half_pixel");
    of.text("mode", "nearest") == "cubic" && mode == "pytorch_half_pixel"
}

fn is_aligned(of: &Attributes) -> bool {
    of.text("coordinate_transformation_mode", "half_pixel") == "align_corners"
}

/// Whether an input is given.
fn given(node: &NodeProto, index: usize) -> bool {
    node.input.get(index).is_some_and(|name| !name.is_empty())
}

/// Replaces every node of the graph by those that `by` gives.
fn rewrite(
    model: &mut ModelProto,
    by: impl Fn(NodeProto, &mut GraphProto) -> Nodes,
) -> Result<(), String> {
    let Some(graph) = &mut model.graph else {
        return Ok(());
    };
    let mut nodes = Vec::new();
    for node in std::mem::take(&mut graph.node) {
        let said = node.output.first().cloned().unwrap_or_default();
        let said = format!(
            "its operator {} (value {said}) is not supported",
            node.op_type
        );
        nodes.extend(by(node, graph).map_err(|why| format!("{said}: {why}"))?);
    }
    graph.node = nodes;
    Ok(())
}

/// Adds weights to a graph and returns their name.
fn weights(
    graph: &mut GraphProto,
    name: String,
    dims: &[i64],
    kind: DataType,
    bytes: Vec<u8>,
) -> String {
    graph.initializer.push(TensorProto {
        name: name.clone(),
        dims: dims.to_vec(),
        data_type: kind as i32,
        raw_data: bytes,
        ..TensorProto::default()
    });
    name
}

fn whole(graph: &mut GraphProto, name: String, values: &[i64]) -> String {
    let bytes = values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    let dims = [i64::try_from(values.len()).unwrap_or_default()];
    weights(graph, name, &dims, DataType::Int64, bytes)
}

fn scalar(graph: &mut GraphProto, name: String, value: f32) -> String {
    weights(
        graph,
        name,
        &[],
        DataType::Float,
        value.to_le_bytes().to_vec(),
    )
}

/// A node with its names.
fn named(mut node: NodeProto, inputs: &[&str], output: &str) -> NodeProto {
    node.input = inputs.iter().map(|&name| name.to_owned()).collect();
    node.output = vec![output.to_owned()];
    node
}

fn plain(mut node: NodeProto, graph: &mut GraphProto, opset: i64) -> Nodes {
    let of = Attributes(&node);
    let output = node.output.first().cloned().unwrap_or_default();
    let input = node.input.first().cloned().unwrap_or_default();
    match node.op_type.as_str() {
        "Celu" => celu(graph, &input, &output, of.float("alpha", 1.0)),
        "Swish" => Ok(swish(graph, &input, &output, of.float("alpha", 1.0))),
        "Upsample" if opset < 9 => {
            let scales = of.floats("scales").unwrap_or_default();
            let bytes = scales
                .iter()
                .flat_map(|scale| scale.to_le_bytes())
                .collect();
            let dims = [i64::try_from(scales.len()).unwrap_or_default()];
            let scales = weights(
                graph,
                format!("{output} (scales)"),
                &dims,
                DataType::Float,
                bytes,
            );
            Ok(vec![as_resize(&node, &scales)])
        }
        "Upsample" => Ok(vec![as_resize(
            &node,
            node.input.get(1).ok_or("without scales")?,
        )]),
        "Resize" if opset < 11 => Ok(vec![as_resize(
            &node,
            node.input.get(1).ok_or("without scales")?,
        )]),
        "ConvTranspose" => {
            if of.ints("output_shape").is_none()
                && of.text("auto_pad", "NOTSET").starts_with("SAME")
            {
                let kernel = kernel_of(&node, graph)?;
                let total = |axis: usize| {
                    let window = Transposed::of(&of, &kernel, axis);
                    (window.adjusted() - window.stride).max(0)
                };
                let totals: Vec<i64> = (0..kernel.len()).map(total).collect();
                padded(&mut node, &totals);
            }
            Ok(vec![node])
        }
        "Dropout" if given(&node, 2) => {
            let off = graph.initializer.iter().any(|weights| {
                weights.name == node.input[2]
                    && weights.raw_data.iter().all(|&byte| byte == 0)
                    && weights.int32_data.iter().all(|&value| value == 0)
            });
            match off {
                true => Ok(vec![named(
                    self::node("Identity", Vec::new()),
                    &[&input],
                    &output,
                )]),
                false => Err("in training mode, or it cannot be known".to_owned()),
            }
        }
        _ => Ok(vec![node]),
    }
}

/// `max(0, x) + min(0, alpha (exp(x / alpha) - 1))`, as the ELU of `x / alpha` times `alpha`.
fn celu(graph: &mut GraphProto, input: &str, output: &str, alpha: f32) -> Nodes {
    if !alpha.is_normal() {
        return Err(format!("with alpha = {alpha}"));
    }
    let less = scalar(graph, format!("{output} (less)"), 1.0 / alpha);
    let more = scalar(graph, format!("{output} (more)"), alpha);
    let [scaled, bent] = ["scaled", "bent"].map(|part| format!("{output} ({part})"));
    let mul = || node("Mul", Vec::new());
    Ok(vec![
        named(mul(), &[input, &less], &scaled),
        named(node("Elu", Vec::new()), &[&scaled], &bent),
        named(mul(), &[&bent, &more], output),
    ])
}

/// `x sigmoid(alpha x)`.
fn swish(graph: &mut GraphProto, input: &str, output: &str, alpha: f32) -> Vec<NodeProto> {
    let alpha = scalar(graph, format!("{output} (alpha)"), alpha);
    let [scaled, gate] = ["scaled", "gate"].map(|part| format!("{output} ({part})"));
    let mul = || node("Mul", Vec::new());
    vec![
        named(mul(), &[input, &alpha], &scaled),
        named(node("Sigmoid", Vec::new()), &[&scaled], &gate),
        named(mul(), &[input, &gate], output),
    ]
}

/// Upsample, or Resize of operator set 10, in the form of operator set 13.
fn as_resize(old: &NodeProto, scales: &str) -> NodeProto {
    let attributes = vec![
        text("mode", Attributes(old).text("mode", "nearest")),
        text("coordinate_transformation_mode", "asymmetric"),
        int(SIMPLE, 1),
    ];
    let output = old.output.first().map_or("", String::as_str);
    named(
        node("Resize", attributes),
        &[&old.input[0], "", scales],
        output,
    )
}

/// Height and width of the kernel of a node, from its attributes or its weights.
fn kernel_of(node: &NodeProto, graph: &GraphProto) -> Result<Vec<i64>, String> {
    if let Some(kernel) = Attributes(node).ints("kernel_shape") {
        return Ok(kernel.to_vec());
    }
    let mut all = graph.initializer.iter();
    let found = all.find(|weights| node.input.get(1) == Some(&weights.name));
    let dims = found.and_then(|weights| weights.dims.get(2..));
    Ok(dims.ok_or("with weights that are computed")?.to_vec())
}

/// A transposed convolution along one axis.
struct Transposed {
    stride: i64,
    /// Pixels that the kernel covers.
    reach: i64,
    /// Pixels that are added at the end.
    more: i64,
}

impl Transposed {
    fn of(of: &Attributes, kernel: &[i64], axis: usize) -> Self {
        let at = |name: &str, otherwise: i64| {
            let values = of.ints(name).unwrap_or_default();
            values.get(axis).copied().unwrap_or(otherwise)
        };
        Self {
            stride: at("strides", 1),
            reach: (kernel[axis] - 1) * at("dilations", 1) + 1,
            more: at("output_padding", 0),
        }
    }

    /// Size of the result for one pixel, before anything is cut off.
    fn adjusted(&self) -> i64 {
        self.reach + self.more
    }
}

/// Gives a transposed convolution explicit padding. What is left over of an odd sum is cut off at the end for
/// `SAME_UPPER`, and at the beginning otherwise.
fn padded(node: &mut NodeProto, totals: &[i64]) {
    let upper = Attributes(node).text("auto_pad", "NOTSET") == "SAME_UPPER";
    let first = totals.iter().map(|total| match upper {
        true => total / 2,
        false => total - total / 2,
    });
    let first: Vec<i64> = first.collect();
    let last = totals
        .iter()
        .zip(&first)
        .map(|(total, first)| total - first);
    let pads: Vec<i64> = first.iter().copied().chain(last).collect();
    let replaced = ["auto_pad", "pads", "output_shape"];
    node.attribute
        .retain(|attribute| !replaced.contains(&attribute.name.as_str()));
    node.attribute.push(ints("pads", &pads));
}

/// What tract knows of values.
struct Known(HashMap<String, InferenceFact>);

impl Known {
    fn shape(&self, name: &str) -> Result<Vec<i64>, String> {
        let dims = self.0.get(name).and_then(|fact| fact.shape.concretize());
        let dims = dims.into_iter().flatten().map(|dim| dim.to_i64().ok());
        let shape: Option<Vec<i64>> = dims.collect();
        match shape {
            Some(shape) if !shape.is_empty() => Ok(shape),
            _ => Err(format!("the shape of {name} depends on values")),
        }
    }

    fn tensor(&self, name: &str) -> Result<Tensor, String> {
        let value = self.0.get(name).and_then(|fact| fact.value.concretize());
        let value = value.ok_or_else(|| format!("{name} depends on values; wanted a constant"))?;
        Ok((*value).clone())
    }

    /// The values of a constant, as numbers of this type.
    fn numbers<T: Datum + Copy>(&self, name: &str) -> Result<Vec<T>, String> {
        let tensor = self.tensor(name)?;
        let tensor = tensor.cast_to::<T>().map_err(|error| error.to_string())?;
        let plain = tensor
            .try_as_plain_ram()
            .map_err(|error| error.to_string())?;
        Ok(plain
            .as_slice::<T>()
            .map_err(|error| error.to_string())?
            .to_vec())
    }
}

fn shaped(node: NodeProto, graph: &mut GraphProto, known: &Known) -> Nodes {
    if !wants_shapes(&node) {
        return Ok(vec![node]);
    }
    match node.op_type.as_str() {
        "ConvTranspose" => to_shape(node, known),
        "Pad" => cut(node, graph, known),
        "Slice" => within(node, known),
        _ if is_nearest(&Attributes(&node)) => nearest(&node, graph, known),
        _ if is_halved_cubic(&Attributes(&node)) => {
            let (from, to) = (known.shape(&node.input[0])?, known.shape(&node.output[0])?);
            let to_one = from
                .iter()
                .zip(&to)
                .any(|(from, to)| from != to && *to == 1);
            match to_one {
                true => Err("cubic to a single pixel".to_owned()),
                false => Ok(vec![node]),
            }
        }
        _ => {
            let shape = known.shape(&node.output[0])?;
            let sizes = match Attributes(&node).ints("axes") {
                Some(axes) => axes.iter().map(|&axis| at_axis(&shape, axis)).collect(),
                None => Some(shape),
            };
            let sizes = sizes.ok_or("along axes that do not exist")?;
            let sizes = whole(graph, format!("{} (sizes)", node.output[0]), &sizes);
            let mut node = node;
            node.input.truncate(1);
            node.input.extend([String::new(), String::new(), sizes]);
            Ok(vec![node])
        }
    }
}

fn place(rank: usize, axis: i64) -> Option<usize> {
    let axis = usize::try_from(if axis < 0 {
        axis + i64::try_from(rank).ok()?
    } else {
        axis
    })
    .ok()?;
    (axis < rank).then_some(axis)
}

fn at_axis(shape: &[i64], axis: i64) -> Option<i64> {
    Some(shape[place(shape.len(), axis)?])
}

/// A transposed convolution to a stated size: what is too much is cut off.
fn to_shape(mut node: NodeProto, known: &Known) -> Nodes {
    let shape = known.shape(&node.input[0])?;
    let kernel = known.shape(node.input.get(1).ok_or("without weights")?)?;
    let of = Attributes(&node);
    let wanted = of.ints("output_shape").unwrap_or_default();
    let (Some(sides), Some(kernel)) = (shape.get(2..), kernel.get(2..)) else {
        return Err("of other axes".to_owned());
    };
    // Some exporters state batch and channels too.
    let wanted = &wanted[wanted.len().saturating_sub(sides.len())..];
    if wanted.len() != sides.len() || kernel.len() != sides.len() {
        return Err(format!("with output_shape = {wanted:?}"));
    }
    let mut totals = Vec::new();
    let mut more = Vec::new();
    for (axis, (&side, &wanted)) in sides.iter().zip(wanted).enumerate() {
        let window = Transposed::of(&of, kernel, axis);
        let whole = (side - 1) * window.stride + window.adjusted();
        let missing = (wanted - whole).max(0);
        if missing + window.more >= window.stride.max(2) {
            return Err(format!(
                "with output_shape {wanted}, beyond the reach of its kernel, {whole}"
            ));
        }
        totals.push((whole - wanted).max(0));
        more.push(window.more + missing);
    }
    padded(&mut node, &totals);
    node.attribute
        .retain(|attribute| attribute.name != "output_padding");
    node.attribute.push(ints("output_padding", &more));
    Ok(vec![node])
}

/// Padding by less than nothing cuts off.
fn cut(mut node: NodeProto, graph: &mut GraphProto, known: &Known) -> Nodes {
    let pads: Vec<i64> = known.numbers(&node.input[1])?;
    if pads.iter().all(|&pad| pad >= 0) {
        return Ok(vec![node]);
    }
    let shape = known.shape(&node.input[0])?;
    let axes = match given(&node, 3) {
        true => known.numbers::<i64>(&node.input[3])?,
        false => (0..).take(shape.len()).collect(),
    };
    let sides: Option<Vec<i64>> = axes.iter().map(|&axis| at_axis(&shape, axis)).collect();
    let sides = sides.filter(|sides| sides.len() * 2 == pads.len());
    let sides = sides.ok_or("with pads of another length")?;
    let (before, after) = pads.split_at(axes.len());
    let starts: Vec<i64> = before.iter().map(|pad| (-pad).max(0)).collect();
    let ends: Vec<i64> = sides
        .iter()
        .zip(after)
        .map(|(side, pad)| side + pad.min(&0))
        .collect();
    if starts.iter().zip(&ends).any(|(start, end)| start >= end) {
        return Err("which leaves nothing".to_owned());
    }
    let output = node.output[0].clone();
    let names = [("starts", &starts), ("ends", &ends), ("axes", &axes)]
        .map(|(part, values)| whole(graph, format!("{output} ({part})"), values));
    let [starts, ends, axes] = &names;
    let smaller = format!("{output} (cut)");
    let slice = named(
        self::node("Slice", Vec::new()),
        &[&node.input[0], starts, ends, axes],
        &smaller,
    );
    let left: Vec<i64> = pads.iter().map(|&pad| pad.max(0)).collect();
    node.input[0] = smaller;
    node.input[1] = whole(graph, format!("{output} (pads)"), &left);
    Ok(vec![slice, node])
}

/// A slice of an old operator set from before the first value begins with it.
fn within(mut node: NodeProto, known: &Known) -> Nodes {
    let shape = known.shape(&node.input[0])?;
    let axes = Attributes(&node).ints("axes").map(<[i64]>::to_vec);
    let axes = axes.unwrap_or_else(|| (0..).take(shape.len()).collect());
    let sides: Option<Vec<i64>> = axes.iter().map(|&axis| at_axis(&shape, axis)).collect();
    let sides = sides.ok_or("along axes that do not exist")?;
    let ends = node
        .attribute
        .iter_mut()
        .filter(|a| matches!(a.name.as_str(), "starts" | "ends"));
    for attribute in ends {
        for (end, side) in attribute.ints.iter_mut().zip(&sides) {
            *end = (*end).clamp(-side, *side);
        }
    }
    Ok(vec![node])
}

/// The nearest pixels, which are gathered along each axis.
fn nearest(node: &NodeProto, graph: &mut GraphProto, known: &Known) -> Nodes {
    let of = Attributes(node);
    let (input, output) = (&node.input[0], &node.output[0]);
    let (from, to) = (known.shape(input)?, known.shape(output)?);
    let scales = match given(node, 2) {
        true => Some(known.numbers::<f32>(&node.input[2])?).filter(|scales| !scales.is_empty()),
        false => None,
    };
    let axes = match of.ints("axes") {
        Some(axes) => axes.iter().map(|&axis| place(from.len(), axis)).collect(),
        None => Some((0..from.len()).collect::<Vec<usize>>()),
    };
    let axes = axes.ok_or("along axes that do not exist")?;
    let mode = of.text("coordinate_transformation_mode", "half_pixel");
    let rounding = match of.int(SIMPLE, 0) {
        0 => of.text("nearest_mode", "round_prefer_floor"),
        _ => SIMPLE,
    };
    let mut nodes: Vec<NodeProto> = Vec::new();
    let mut last = input.clone();
    for (index, &axis) in axes.iter().enumerate() {
        let scale = match &scales {
            Some(scales) => *scales.get(index).ok_or("with too few scales")?,
            None => ratio(to[axis], from[axis]),
        };
        let line = Line {
            from: from[axis],
            to: to[axis],
            scale,
        };
        // A scale of 1 is exact, and leaves every pixel in its place.
        #[allow(clippy::float_cmp)]
        if scale == 1.0 && line.from == line.to {
            continue;
        }
        let pixels: Option<Vec<i64>> = (0..line.to)
            .map(|pixel| line.nearest(pixel, mode, rounding))
            .collect();
        let pixels = pixels.ok_or_else(|| format!("nearest with {mode} and {rounding}"))?;
        let indices = whole(graph, format!("{output} (pixels {axis})"), &pixels);
        let next = format!("{output} (axis {axis})");
        let along = vec![int("axis", i64::try_from(axis).unwrap_or_default())];
        nodes.push(named(
            self::node("Gather", along),
            &[&last, &indices],
            &next,
        ));
        last = next;
    }
    nodes.push(named(self::node("Identity", Vec::new()), &[&last], output));
    Ok(nodes)
}
