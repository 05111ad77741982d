//! Weights of a model: those in other files are put in their place, and floats of other sizes become 32-bit floats.

use tract_onnx::pb::tensor_proto::{DataLocation, DataType};
use tract_onnx::pb::type_proto::Value;
use tract_onnx::pb::{AttributeProto, GraphProto, ModelProto, NodeProto, TensorProto};
use tract_onnx::tract_hir::internal::f16;

use crate::model::{DataFile, ONNX_BYTES_MAX};

type Done = Result<(), String>;

const FLOAT: i32 = DataType::Float as i32;
const FLOAT16: i32 = DataType::Float16 as i32;
const BFLOAT16: i32 = DataType::Bfloat16 as i32;
const DOUBLE: i32 = DataType::Double as i32;

/// Calls `change` for every tensor, also of branches and functions.
fn every_tensor(model: &mut ModelProto, change: &mut dyn FnMut(&mut TensorProto) -> Done) -> Done {
    if let Some(graph) = &mut model.graph {
        tensors_of_graph(graph, change)?;
    }
    let mut functions = model.functions.iter_mut();
    functions.try_for_each(|function| tensors_of_nodes(&mut function.node, change))
}

fn tensors_of_graph(
    graph: &mut GraphProto,
    change: &mut dyn FnMut(&mut TensorProto) -> Done,
) -> Done {
    graph.initializer.iter_mut().try_for_each(&mut *change)?;
    tensors_of_nodes(&mut graph.node, change)
}

fn tensors_of_nodes(
    nodes: &mut [NodeProto],
    change: &mut dyn FnMut(&mut TensorProto) -> Done,
) -> Done {
    let mut attributes = nodes.iter_mut().flat_map(|node| &mut node.attribute);
    attributes.try_for_each(|attribute| tensors_of_attribute(attribute, change))
}

fn tensors_of_attribute(
    of: &mut AttributeProto,
    change: &mut dyn FnMut(&mut TensorProto) -> Done,
) -> Done {
    of.t.iter_mut()
        .chain(&mut of.tensors)
        .try_for_each(&mut *change)?;
    let mut graphs = of.g.iter_mut().chain(&mut of.graphs);
    graphs.try_for_each(|graph| tensors_of_graph(graph, change))
}

/// Puts weights that are in other files in their place.
///
/// # Errors
/// Which weights, what was found and what was wanted, as text.
pub fn put_in_place(model: &mut ModelProto, files: &[DataFile]) -> Done {
    let mut left = ONNX_BYTES_MAX;
    every_tensor(model, &mut |tensor| {
        if tensor.data_location != Some(DataLocation::External as i32) {
            return Ok(());
        }
        let bytes =
            outside(tensor, files).map_err(|why| format!("its weights {}: {why}", tensor.name))?;
        // Many weights may be the same part of a file.
        left = left
            .checked_sub(bytes.len() as u64)
            .ok_or_else(|| format!("its weights have more than {ONNX_BYTES_MAX} bytes"))?;
        tensor.raw_data = bytes.to_vec();
        tensor.external_data.clear();
        tensor.data_location = None;
        Ok(())
    })
}

/// The bytes of a tensor that is in another file.
fn outside<'a>(tensor: &TensorProto, files: &'a [DataFile]) -> Result<&'a [u8], String> {
    let said = |key: &str| {
        let mut entries = tensor.external_data.iter();
        entries
            .find(|entry| entry.key == key)
            .map(|entry| entry.value.as_str())
    };
    let number = |key: &str| {
        let read = |text: &str| {
            text.parse::<usize>()
                .map_err(|_| format!("{key} {text:?}; wanted a number"))
        };
        said(key).map(read).transpose()
    };
    let name = said("location").ok_or("they are in another file, but no location is given")?;
    let file = files.iter().find(|file| file.name == name);
    let file = file.ok_or_else(|| format!("they are in {name}, which was not read"))?;
    let (offset, length) = (number("offset")?.unwrap_or(0), number("length")?);
    let length = length.unwrap_or(file.bytes.len().saturating_sub(offset));
    let end = offset
        .checked_add(length)
        .filter(|&end| end <= file.bytes.len());
    let end = end.ok_or_else(|| {
        format!(
            "{length} bytes from byte {offset} of {name}, which has only {} bytes",
            file.bytes.len()
        )
    })?;
    let wanted = size_of(tensor);
    if wanted.is_some_and(|wanted| wanted != length) {
        return Err(format!(
            "{length} bytes in {name}; wanted {} for the shape {:?}",
            wanted.unwrap_or_default(),
            tensor.dims
        ));
    }
    Ok(&file.bytes[offset..end])
}

/// Bytes of a tensor of whole bytes.
fn size_of(tensor: &TensorProto) -> Option<usize> {
    let each = match DataType::try_from(tensor.data_type).ok()? {
        DataType::Uint8 | DataType::Int8 | DataType::Bool => 1,
        DataType::Uint16 | DataType::Int16 | DataType::Float16 | DataType::Bfloat16 => 2,
        DataType::Uint32 | DataType::Int32 | DataType::Float => 4,
        DataType::Uint64 | DataType::Int64 | DataType::Double => 8,
        _ => return None,
    };
    let mut dims = tensor.dims.iter();
    dims.try_fold(each, |size: usize, &dim| {
        size.checked_mul(usize::try_from(dim).ok()?)
    })
}

/// Makes 32-bit floats of half floats everywhere, and of doubles too if the picture is given as doubles.
///
/// # Errors
/// Which weights cannot be read, as text.
pub fn widened(model: &mut ModelProto) -> Done {
    let inputs = model.graph.iter().flat_map(|graph| &graph.input);
    let mut kinds = inputs.filter_map(|input| match input.r#type.as_ref()?.value.as_ref()? {
        Value::TensorType(tensor) => Some(tensor.elem_type),
    });
    let of_doubles = kinds.any(|kind| kind == DOUBLE);
    let changes = |kind: i32| kind == FLOAT16 || kind == BFLOAT16 || (of_doubles && kind == DOUBLE);
    every_tensor(model, &mut |tensor| {
        if changes(tensor.data_type) {
            let values = floats(tensor)
                .ok_or_else(|| format!("its weights {} cannot be read", tensor.name))?;
            tensor.raw_data = values
                .iter()
                .flat_map(|value| value.to_le_bytes())
                .collect();
            tensor.int32_data.clear();
            tensor.double_data.clear();
            tensor.data_type = FLOAT;
        }
        Ok(())
    })?;
    if let Some(graph) = &mut model.graph {
        widen_types(graph, &changes);
    }
    Ok(())
}

fn widen_types(graph: &mut GraphProto, changes: &dyn Fn(i32) -> bool) {
    for input in &mut graph.input {
        let kind = input.r#type.as_mut().and_then(|kind| kind.value.as_mut());
        if let Some(Value::TensorType(tensor)) = kind
            && changes(tensor.elem_type)
        {
            tensor.elem_type = FLOAT;
        }
    }
    for attribute in graph.node.iter_mut().flat_map(|node| &mut node.attribute) {
        let is_type = matches!(
            attribute.name.as_str(),
            "to" | "dtype" | "stash_type" | "output_dtype"
        );
        if is_type && i32::try_from(attribute.i).is_ok_and(changes) {
            attribute.i = FLOAT.into();
        }
        let graphs = attribute.g.iter_mut().chain(&mut attribute.graphs);
        graphs.for_each(|graph| widen_types(graph, changes));
    }
}

/// The values of a tensor of half floats or doubles, as the file has them.
// Doubles become the nearest 32-bit float; half floats are the lower bits of a field.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn floats(tensor: &TensorProto) -> Option<Vec<f32>> {
    let narrow = |bits: u16| match tensor.data_type {
        FLOAT16 => f16::from_bits(bits).to_f32(),
        _ => f32::from_bits(u32::from(bits) << 16),
    };
    let raw = &tensor.raw_data;
    Some(match (tensor.data_type, raw.is_empty()) {
        (DOUBLE, true) => tensor
            .double_data
            .iter()
            .map(|&value| value as f32)
            .collect(),
        (DOUBLE, false) => {
            let (values, rest) = raw.as_chunks::<8>();
            rest.is_empty().then_some(())?;
            values
                .iter()
                .map(|bytes| f64::from_le_bytes(*bytes) as f32)
                .collect()
        }
        (_, true) => tensor
            .int32_data
            .iter()
            .map(|&bits| narrow(bits as u16))
            .collect(),
        (_, false) => {
            let (values, rest) = raw.as_chunks::<2>();
            rest.is_empty().then_some(())?;
            values
                .iter()
                .map(|bytes| narrow(u16::from_le_bytes(*bytes)))
                .collect()
        }
    })
}
