//! An ONNX file as tract shall read it: whole, with only what leads to the taps, of 32-bit floats, and with one picture
//! `[1, 3, H, W]` of floats as its input.

use std::collections::HashSet;

use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::tensor_shape_proto::Dimension;
use tract_onnx::pb::tensor_shape_proto::dimension::Value as Size;
use tract_onnx::pb::type_proto::Value as Kind;
use tract_onnx::pb::{GraphProto, ModelProto, NodeProto, ValueInfoProto};
use tract_onnx::prelude::Framework;

use super::error::EncoderError;
use super::inference::{listed, root};
use super::parts::{int, ints, node};
use super::{functions, rewritten, tensors, vouched};
use crate::model::{ModelSpec, onnx_file};

/// Reads a model for its outputs: taps, and the lane head if it is wanted.
///
/// # Errors
/// When the file or one with its weights is damaged, when an output is unknown, or when an operator that leads to them
/// is not supported.
pub fn opened(spec: &ModelSpec, outputs: &[&String]) -> Result<ModelProto, EncoderError> {
    let broken = |why: String| EncoderError::Onnx {
        model: spec.name.clone(),
        why,
    };
    onnx_file::described(&spec.onnx).map_err(broken)?;
    let read = tract_onnx::onnx().proto_model_for_read(&mut spec.onnx.as_ref());
    let mut model = read.map_err(|error| broken(root(&error)))?;
    tensors::put_in_place(&mut model, &spec.data).map_err(broken)?;
    functions::inlined(&mut model).map_err(broken)?;
    let graph = model.graph.as_mut();
    let graph = graph.ok_or_else(|| broken("it has no graph".to_owned()))?;
    check_names(graph, spec, outputs)?;
    keep_what_leads_to(outputs, graph);
    vouched::check(&model).map_err(broken)?;
    tensors::widened(&mut model).map_err(broken)?;
    take_picture(&mut model).map_err(broken)?;
    rewritten::without_shapes(&mut model).map_err(broken)?;
    Ok(model)
}

fn check_names(
    graph: &GraphProto,
    spec: &ModelSpec,
    wanted: &[&String],
) -> Result<(), EncoderError> {
    let made = graph.node.iter().flat_map(|node| &node.output);
    let inputs = graph.input.iter().map(|input| &input.name);
    let weights = graph.initializer.iter().map(|weights| &weights.name);
    let names: HashSet<&String> = made.chain(inputs).chain(weights).collect();
    let Some(tap) = wanted.iter().find(|name| !names.contains(*name)) else {
        return Ok(());
    };
    let outputs = graph.output.iter().map(|output| &output.name);
    let inner = graph.node.iter().flat_map(|node| &node.output);
    let inner = inner.filter(|name| graph.output.iter().all(|output| &output.name != *name));
    Err(EncoderError::NoTap {
        model: spec.name.clone(),
        tap: (*tap).clone(),
        known: listed(outputs.chain(inner)),
    })
}

/// Leaves out what does not lead to the outputs, so that it need not be supported.
fn keep_what_leads_to(outputs: &[&String], graph: &mut GraphProto) {
    let mut needed: HashSet<String> = outputs.iter().map(|&name| name.clone()).collect();
    let nodes = std::mem::take(&mut graph.node).into_iter().rev();
    let mut kept: Vec<NodeProto> = nodes
        .filter(|node| {
            let is_needed = node.output.iter().any(|name| needed.contains(name));
            if is_needed {
                names_used(node, &mut needed);
            }
            is_needed
        })
        .collect();
    kept.reverse();
    graph.node = kept;
    graph.input.retain(|input| needed.contains(&input.name));
    graph
        .initializer
        .retain(|weights| needed.contains(&weights.name));
    // tract wants names of nodes that differ; without one, it takes that of a node's value.
    graph.node.iter_mut().for_each(|node| node.name.clear());
    graph.value_info.clear();
    graph.output = outputs
        .iter()
        .map(|&name| ValueInfoProto {
            name: name.clone(),
            ..ValueInfoProto::default()
        })
        .collect();
}

/// Adds the names that a node uses, also in its branches.
fn names_used(node: &NodeProto, names: &mut HashSet<String>) {
    names.extend(node.input.iter().cloned());
    let attributes = node.attribute.iter();
    for branch in attributes.flat_map(|attribute| attribute.g.iter().chain(&attribute.graphs)) {
        names.extend(branch.output.iter().map(|output| output.name.clone()));
        branch.node.iter().for_each(|node| names_used(node, names));
    }
}

/// Makes the input `[1, 3, H, W]` of 32-bit floats, whatever the model takes: bytes, or channels last.
fn take_picture(model: &mut ModelProto) -> Result<(), String> {
    let Some(graph) = &mut model.graph else {
        return Ok(());
    };
    let weights: HashSet<&String> = graph
        .initializer
        .iter()
        .map(|weights| &weights.name)
        .collect();
    let mut pictures = graph
        .input
        .iter_mut()
        .filter(|input| !weights.contains(&input.name));
    let (Some(input), None) = (pictures.next(), pictures.next()) else {
        return Ok(());
    };
    let kind = input.r#type.as_mut().and_then(|kind| kind.value.as_mut());
    let Some(Kind::TensorType(tensor)) = kind else {
        return Ok(());
    };
    let mut adapt = Vec::new();
    match DataType::try_from(tensor.elem_type) {
        Ok(DataType::Float) => {}
        Ok(DataType::Uint8) => {
            tensor.elem_type = DataType::Float as i32;
            adapt.push(node("Round", Vec::new()));
            adapt.push(node("Cast", vec![int("to", DataType::Uint8 as i64)]));
        }
        _ => {
            return Err(format!(
                "its input {} is of ONNX's type {}; wanted 32-bit or 16-bit floats, or bytes (uint8)",
                input.name, tensor.elem_type
            ));
        }
    }
    let name = input.name.clone();
    if let Some([_, second, _, last]) = tensor.shape.as_mut().map(|shape| &mut shape.dim[..])
        && fixed(last) == Some(3)
        && fixed(second) != Some(3)
    {
        let shape = tensor.shape.as_mut().map(|shape| &mut shape.dim);
        let dims = shape.into_iter().flatten();
        let dims: Vec<Dimension> = dims.map(|dim| dim.clone()).collect();
        let turned = [0, 3, 1, 2].map(|index: usize| dims[index].clone());
        if let Some(shape) = &mut tensor.shape {
            shape.dim = turned.to_vec();
        }
        input.name = format!("{name} (channels first)");
        adapt.push(node("Transpose", vec![ints("perm", &[0, 2, 3, 1])]));
    }
    if adapt.is_empty() {
        return Ok(());
    }
    if input.name == name {
        input.name = format!("{name} (bytes)");
    }
    let mut before = input.name.clone();
    let count = adapt.len();
    for (index, node) in adapt.iter_mut().enumerate() {
        node.input = vec![before];
        before = match index + 1 == count {
            true => name.clone(),
            false => format!("{name} ({})", node.op_type),
        };
        node.output = vec![before.clone()];
    }
    graph.node.splice(0..0, adapt);
    Ok(())
}

fn fixed(dim: &Dimension) -> Option<i64> {
    match dim.value {
        Some(Size::DimValue(size)) => Some(size),
        _ => None,
    }
}
