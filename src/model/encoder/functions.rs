//! Functions of a model: their bodies take the place of the nodes that call them.

use std::collections::HashMap;

use tract_onnx::pb::{AttributeProto, FunctionProto, GraphProto, ModelProto, NodeProto};

/// Deepest calls of functions in functions.
const DEPTH_MAX: u32 = 16;
/// Largest number of nodes afterwards.
const NODES_MAX: usize = 20_000;

type Functions = HashMap<(String, String), FunctionProto>;

/// Puts the bodies of functions in the place of the nodes that call them.
///
/// # Errors
/// Which function, and why not, as text.
pub fn inlined(model: &mut ModelProto) -> Result<(), String> {
    let version = version_of(&model.opset_import);
    let mut functions = Functions::new();
    for function in std::mem::take(&mut model.functions) {
        let domain = function.domain.clone().unwrap_or_default();
        let name = function.name.clone().unwrap_or_default();
        let wanted = version_of(&function.opset_import);
        if wanted != 0 && wanted != version {
            return Err(format!(
                "its function {name} is of the operator set {wanted}; wanted that of the model, {version}"
            ));
        }
        functions.insert((domain, name), function);
    }
    match &mut model.graph {
        Some(graph) if !functions.is_empty() => inline(graph, &functions),
        _ => Ok(()),
    }
}

fn version_of(sets: &[tract_onnx::pb::OperatorSetIdProto]) -> i64 {
    let own = sets
        .iter()
        .find(|set| matches!(set.domain.as_str(), "" | "ai.onnx"));
    own.map_or(0, |set| set.version)
}

fn inline(graph: &mut GraphProto, functions: &Functions) -> Result<(), String> {
    for depth in 0.. {
        let is_call =
            |node: &NodeProto| functions.contains_key(&(node.domain.clone(), node.op_type.clone()));
        if !graph.node.iter().any(is_call) {
            break;
        }
        let mut nodes = Vec::new();
        for node in std::mem::take(&mut graph.node) {
            match functions.get(&(node.domain.clone(), node.op_type.clone())) {
                Some(function) => body(function, &node, &mut nodes)?,
                None => nodes.push(node),
            }
            if depth >= DEPTH_MAX || nodes.len() > NODES_MAX {
                return Err("its functions call each other without end".to_owned());
            }
        }
        graph.node = nodes;
    }
    let attributes = graph.node.iter_mut().flat_map(|node| &mut node.attribute);
    let mut graphs =
        attributes.flat_map(|attribute| attribute.g.iter_mut().chain(&mut attribute.graphs));
    graphs.try_for_each(|graph| inline(graph, functions))
}

/// Appends the body of a function as one call wants it.
fn body(
    function: &FunctionProto,
    call: &NodeProto,
    nodes: &mut Vec<NodeProto>,
) -> Result<(), String> {
    let name = function.name();
    let mut names: HashMap<&str, String> = HashMap::new();
    let nothing = String::new();
    for (index, inner) in function.input.iter().enumerate() {
        names.insert(inner, call.input.get(index).unwrap_or(&nothing).clone());
    }
    for (inner, outer) in function.output.iter().zip(&call.output) {
        if function.input.contains(inner) {
            return Err(format!("its function {name} gives back an input"));
        }
        if !outer.is_empty() {
            names.insert(inner, outer.clone());
        }
    }
    let prefix = call
        .output
        .first()
        .map_or(call.name.as_str(), String::as_str);
    let renamed = |inner: &String| match (inner.as_str(), names.get(inner.as_str())) {
        ("", _) => String::new(),
        (_, Some(outer)) => outer.clone(),
        _ => format!("{prefix}/{name}/{inner}"),
    };
    for node in &function.node {
        let mut node = node.clone();
        node.input = node.input.iter().map(renamed).collect();
        node.output = node.output.iter().map(renamed).collect();
        let attributes = node.attribute.into_iter();
        let given = attributes.map(|attribute| as_called(attribute, function, call));
        let given = given.collect::<Result<Vec<_>, _>>()?;
        node.attribute = given.into_iter().flatten().collect();
        if node
            .attribute
            .iter()
            .any(|a| a.g.is_some() || !a.graphs.is_empty())
        {
            return Err(format!("its function {name} has branches or loops"));
        }
        nodes.push(node);
    }
    Ok(())
}

/// An attribute of a body, with the value that the call gives to it; `None` if it is left out. Values that a function
/// has by itself are not read by tract.
fn as_called(
    own: AttributeProto,
    function: &FunctionProto,
    call: &NodeProto,
) -> Result<Option<AttributeProto>, String> {
    let wanted = &own.ref_attr_name;
    if wanted.is_empty() {
        return Ok(Some(own));
    }
    match call.attribute.iter().find(|value| &value.name == wanted) {
        Some(value) => Ok(Some(AttributeProto {
            name: own.name,
            ..value.clone()
        })),
        None if function.attribute.contains(wanted) => Ok(None),
        None => Err(format!(
            "its function {} has a value of its own for {wanted}",
            function.name()
        )),
    }
}
