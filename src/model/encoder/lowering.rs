//! tract's graph of a model → our own graph, if every operator has an equivalent there.

use std::sync::Arc;

use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::array::{Pad, PadMode, TypedConcat};
use tract_onnx::tract_core::ops::binary::TypedBinOp;
use tract_onnx::tract_core::ops::cast::Cast;
use tract_onnx::tract_core::ops::change_axes::AxisOp;
use tract_onnx::tract_core::ops::cnn::{Conv, KernelFormat, MaxPool, PoolSpec};
use tract_onnx::tract_core::ops::element_wise::ElementWiseOp;
use tract_onnx::tract_core::ops::identity::Identity;
use tract_onnx::tract_core::ops::nn::{
    CoordTransformer, DataFormat, Interpolator, LeakyRelu, Resize,
};
use tract_onnx::tract_core::ops::source::TypedSource;

use super::graph::{Activation, Graph, NodeId, Op, Window};

/// What one of tract's values is in our graph.
#[derive(Clone)]
enum Value {
    Constant(Arc<Tensor>),
    Node(NodeId),
    /// Node whose channels are being unfolded, the side of the square, and which of tract's four operators comes next.
    Unfolding(NodeId, usize, usize),
}

/// Translates a model as tract has read it, when all shapes are known and before it is rewritten for tract's own
/// execution.
///
/// # Errors
/// The operator that is not supported here.
pub fn lower(model: &TypedModel) -> Result<Graph, String> {
    let mut lowering = Lowering {
        model,
        graph: Graph::default(),
        values: Vec::with_capacity(model.nodes().len()),
    };
    // The numbers of nodes are not in order, because rewrites append nodes. The order of evaluation is used.
    let order = model.eval_order().map_err(|e| e.to_string())?;
    lowering.values.resize(model.nodes().len(), None);
    for id in order {
        let node = &model.nodes()[id];
        let value = lowering
            .node(node)
            .map_err(|why| format!("{} ({}): {why}", node.name, node.op.name()))?;
        lowering.values[id] = Some(value);
    }
    for outlet in &model.outputs {
        match lowering.values[outlet.node] {
            Some(Value::Node(id)) if outlet.slot == 0 => lowering.graph.outputs.push(id),
            _ => return Err("an output that is not computed".to_owned()),
        }
    }
    Ok(lowering.graph)
}

struct Lowering<'a> {
    model: &'a TypedModel,
    graph: Graph,
    values: Vec<Option<Value>>,
}

type Lowered<T> = Result<T, String>;

impl Lowering<'_> {
    fn node(&mut self, node: &TypedNode) -> Lowered<Value> {
        let fact = &node.outputs.first().ok_or("no output")?.fact;
        if let Some(constant) = &fact.konst {
            return Ok(Value::Constant(constant.clone()));
        }
        if node.op_is::<TypedSource>() {
            let shape = shape(fact)?;
            return Ok(Value::Node(self.graph.push(Op::Picture, &[], shape)));
        }
        if node.op_is::<Identity>() {
            return self.value(node, 0);
        }
        if let Some(cast) = node.op_as::<Cast>() {
            return match self.value(node, 0)? {
                Value::Constant(constant) => {
                    let constant = constant.cast_to_dt(cast.to).map_err(|e| e.to_string())?;
                    Ok(Value::Constant(Arc::new(constant.into_owned())))
                }
                value if cast.to == f32::datum_type() => Ok(value),
                _ => Err("another type".to_owned()),
            };
        }
        if let Some(axes) = node.op_as::<AxisOp>() {
            return self.axes(node, axes);
        }
        let shape = shape(fact)?;
        let id = if let Some(conv) = node.op_as::<Conv>() {
            self.conv(node, conv, shape)?
        } else if let Some(pool) = node.op_as::<MaxPool>() {
            if pool.with_index_outputs.is_some() {
                return Err("with indices".to_owned());
            }
            let input = self.input(node, 0)?;
            let op = Op::MaxPool(self.window(&pool.pool_spec, input)?);
            self.graph.push(op, &[input], shape)
        } else if let Some(op) = node.op_as::<TypedBinOp>() {
            self.binary(node, op, shape)?
        } else if let Some(op) = node.op_as::<ElementWiseOp>() {
            let leaky = op.0.downcast_ref::<LeakyRelu>().ok_or("not known")?;
            let input = self.input(node, 0)?;
            self.graph
                .push_activation(Activation::Leaky(leaky.alpha), input)
        } else if let Some(concat) = node.op_as::<TypedConcat>() {
            if concat.axis != 1 {
                return Err("not of channels".to_owned());
            }
            let inputs = 0..node.inputs.len();
            let inputs = inputs.map(|index| self.input(node, index));
            let inputs = inputs.collect::<Lowered<Vec<_>>>()?;
            self.graph.push(Op::Concat, &inputs, shape)
        } else if let Some(pad) = node.op_as::<Pad>() {
            self.pad(node, pad, shape)?
        } else {
            self.resize(node, shape)?
        };
        Ok(Value::Node(id))
    }

    fn value(&self, node: &TypedNode, index: usize) -> Lowered<Value> {
        let outlet = node.inputs.get(index).ok_or("an input is missing")?;
        match &self.values[outlet.node] {
            Some(value) if outlet.slot == 0 => Ok(value.clone()),
            _ => Err("an input is not computed".to_owned()),
        }
    }

    fn input(&self, node: &TypedNode, index: usize) -> Lowered<NodeId> {
        match self.value(node, index)? {
            Value::Node(id) => Ok(id),
            _ => Err("an input is a constant or has other axes".to_owned()),
        }
    }

    fn constant(&self, node: &TypedNode, index: usize) -> Lowered<Arc<Tensor>> {
        match self.value(node, index)? {
            Value::Constant(constant) => Ok(constant),
            _ => Err("an input is not a constant".to_owned()),
        }
    }

    /// The window over an input, for every notation of its padding.
    fn window(&self, spec: &PoolSpec, input: NodeId) -> Lowered<Window> {
        if spec.data_format != DataFormat::NCHW {
            return Err("another order of axes".to_owned());
        }
        let [_, height, width] = self.graph.nodes[input].shape;
        let padding = spec.computed_padding(&[height, width]);
        let (&[kernel_y, kernel_x], &[stride_y, stride_x], &[dilation_y, dilation_x], [y, x]) = (
            &*spec.kernel_shape,
            &*spec.strides(),
            &*spec.dilations(),
            &padding[..],
        ) else {
            return Err("not of two dimensions".to_owned());
        };
        Ok(Window {
            kernel: [kernel_y, kernel_x],
            stride: [stride_y, stride_x],
            dilation: [dilation_y, dilation_x],
            before: [y.pad_before, x.pad_before],
        })
    }

    fn conv(&mut self, node: &TypedNode, conv: &Conv, shape: [usize; 3]) -> Lowered<NodeId> {
        if conv.group != 1 || conv.q_params.is_some() || conv.kernel_fmt != KernelFormat::OIHW {
            return Err("in groups, quantised or with another order of weights".to_owned());
        }
        let input = self.input(node, 0)?;
        let window = self.window(&conv.pool_spec, input)?;
        let inputs = self.graph.nodes[input].shape[0];
        let weights = floats(&*self.constant(node, 1)?)?;
        let bias = floats(&*self.constant(node, 2)?)?;
        let bias = match bias[..] {
            [all] => vec![all; shape[0]],
            _ => bias,
        };
        let cells = window.kernel[0] * window.kernel[1];
        if bias.len() != shape[0] || weights.len() != shape[0] * inputs * cells {
            return Err("weights of another size".to_owned());
        }
        let op = Op::Conv {
            window,
            weights,
            bias,
        };
        Ok(self.graph.push(op, &[input], shape))
    }

    fn binary(&mut self, node: &TypedNode, op: &TypedBinOp, shape: [usize; 3]) -> Lowered<NodeId> {
        let name = op.0.name();
        let (a, b) = (self.value(node, 0)?, self.value(node, 1)?);
        let (input, constant, constant_first) = match (a, b) {
            (Value::Node(a), Value::Node(b)) => {
                let same = self.graph.nodes[a].shape == self.graph.nodes[b].shape;
                return match name {
                    "Add" if same => Ok(self.graph.push(Op::Add, &[a, b], shape)),
                    _ => Err("of two values".to_owned()),
                };
            }
            (Value::Node(a), Value::Constant(b)) => (a, b, false),
            (Value::Constant(a), Value::Node(b)) => (b, a, true),
            _ => return Err("of other axes".to_owned()),
        };
        if self.graph.nodes[input].shape != shape {
            return Err("with a larger constant".to_owned());
        }
        let constant = per_channel(&constant, shape[0])?;
        let ones = vec![1.0; shape[0]];
        let zeros = vec![0.0; shape[0]];
        let negated = |values: &[f32]| values.iter().map(|value| -value).collect::<Vec<_>>();
        let (factor, offset) = match (name, constant_first) {
            ("Max", _) if constant.iter().all(|&value| value == 0.0) => {
                return Ok(self.graph.push_activation(Activation::Relu, input));
            }
            ("Add", _) => (ones, constant),
            ("Sub", false) => (ones, negated(&constant)),
            ("Sub", true) => (negated(&ones), constant),
            ("Mul", _) => (constant, zeros),
            ("Div", false) => (constant.iter().map(|value| 1.0 / value).collect(), zeros),
            _ => return Err("not known".to_owned()),
        };
        if !factor.iter().chain(&offset).all(|value| value.is_finite()) {
            return Err("by values that are not finite".to_owned());
        }
        Ok(self
            .graph
            .push(Op::Scale { factor, offset }, &[input], shape))
    }

    fn pad(&mut self, node: &TypedNode, pad: &Pad, shape: [usize; 3]) -> Lowered<NodeId> {
        let PadMode::Constant(fill) = &pad.mode else {
            return Err("with other values than a constant".to_owned());
        };
        if floats(fill)?.iter().any(|&value| value != 0.0) {
            return Err("with another constant than 0".to_owned());
        }
        let input = self.input(node, 0)?;
        let op = match pad.pads[..] {
            [(0, 0), (0, _), (0, 0), (0, 0)] => Op::Concat,
            [(0, 0), (0, 0), (top, _), (left, _)] => Op::Margin([top, left]),
            _ => return Err("of more than channels at the end, or rows and columns".to_owned()),
        };
        Ok(self.graph.push(op, &[input], shape))
    }

    /// A resize, either as tract's own operator or as what tract makes of ONNX's operator.
    fn resize(&mut self, node: &TypedNode, shape: [usize; 3]) -> Lowered<NodeId> {
        let patch = match node.op_is::<Resize>() {
            true => None,
            false => node.op.declutter(self.model, node).ok().flatten(),
        };
        let resize = match &patch {
            None => node.op_as::<Resize>(),
            Some(patch) => patch
                .model
                .nodes()
                .iter()
                .find_map(|node| node.op_as::<Resize>()),
        };
        let resize = resize.ok_or("not known")?;
        let linear = resize.interpolator == Interpolator::Linear
            && resize.coord_transformer == CoordTransformer::HalfPixel;
        let input = self.input(node, 0)?;
        if !linear || self.graph.nodes[input].shape[0] != shape[0] {
            return Err("not linear between pixel centres".to_owned());
        }
        Ok(self.graph.push(Op::Resize, &[input], shape))
    }

    /// What tract makes of DepthToSpace (CRD): channels become `[channels, side, side]`, and both sides are moved
    /// behind their axes and merged.
    fn axes(&mut self, node: &TypedNode, axes: &AxisOp) -> Lowered<Value> {
        let sizes = |dims: &[TDim]| {
            let sizes = dims
                .iter()
                .map(|dim| usize::try_from(dim.to_i64().ok()?).ok());
            sizes.collect::<Option<Vec<_>>>().ok_or("sizes not known")
        };
        match (self.value(node, 0)?, axes) {
            (Value::Node(input), AxisOp::Reshape(1, from, to)) => {
                match (&*sizes(from)?, &*sizes(to)?) {
                    (&[all], &[_, side, again])
                        if side == again && side > 0 && all == self.graph.nodes[input].shape[0] =>
                    {
                        Ok(Value::Unfolding(input, side, 1))
                    }
                    _ => Err("of other axes".to_owned()),
                }
            }
            (Value::Unfolding(input, side, 1), AxisOp::Move(3, 5)) => {
                Ok(Value::Unfolding(input, side, 2))
            }
            (Value::Unfolding(input, side, 2), AxisOp::Move(2, 3)) => {
                Ok(Value::Unfolding(input, side, 3))
            }
            (Value::Unfolding(input, side, 3), AxisOp::Reshape(2, from, to)) => {
                let [channels, height, width] = self.graph.nodes[input].shape;
                let whole = [height * side, width * side];
                if *sizes(from)? != [height, side, width, side] || *sizes(to)? != whole {
                    return Err("of other axes".to_owned());
                }
                let shape = [channels / (side * side), whole[0], whole[1]];
                Ok(Value::Node(self.graph.push(
                    Op::Unfold { side },
                    &[input],
                    shape,
                )))
            }
            _ => Err("of other axes".to_owned()),
        }
    }
}

/// Channels, height and width of a value `[1, C, H, W]` of 32-bit floats.
fn shape(fact: &TypedFact) -> Lowered<[usize; 3]> {
    if fact.datum_type != f32::datum_type() {
        return Err("of another type than 32-bit floats".to_owned());
    }
    match fact.shape.as_concrete() {
        Some(&[1, channels, height, width]) => Ok([channels, height, width]),
        _ => Err("of other axes than [1, C, H, W]".to_owned()),
    }
}

fn floats(tensor: &Tensor) -> Lowered<Vec<f32>> {
    let floats = tensor.cast_to::<f32>().map_err(|e| e.to_string())?;
    let plain = floats.try_as_plain_ram().map_err(|e| e.to_string())?;
    let values = plain.as_slice::<f32>().map_err(|e| e.to_string())?;
    Ok(values.to_vec())
}

/// A constant that is added to or multiplied with `[1, C, H, W]`, if it has one value, or one value for each channel.
fn per_channel(constant: &Tensor, channels: usize) -> Lowered<Vec<f32>> {
    let values = floats(constant)?;
    match *constant.shape() {
        _ if values.len() == 1 => Ok(vec![values[0]; channels]),
        [1, c, 1, 1] | [c, 1, 1] if c == channels => Ok(values),
        _ => Err("with a constant that does not have one value for each channel".to_owned()),
    }
}
