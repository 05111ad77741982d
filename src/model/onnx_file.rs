//! What an ONNX file says of itself before it is used: its size, the files with its weights, the type of its picture.
//!
//! It reads the protobuf's fields without keeping any: a field of two bytes can become a structure of hundreds of
//! bytes, so fields are counted before they are parsed. The graph itself is read in [`encoder`](super::encoder).

use std::collections::{BTreeSet, HashSet};

/// Largest ONNX file, and its files of weights together: a hundred times the largest lane model that is shipped, and more
/// than a ResNet-101.
pub const ONNX_BYTES_MAX: u64 = 256 << 20;
/// Largest number of files with weights.
const DATA_FILES_MAX: usize = 64;
/// `UINT8` among the types of ONNX's tensors.
const UINT8: u64 = 2;

/// Largest number of nodes. The largest shipped model has 180; a network with a hundred layers has some thousands.
const NODES_MAX: u64 = 20_000;
/// Largest number of fields that become strings or structures of their own.
const PARTS_MAX: u64 = 400_000;
/// Deepest nesting: a graph in an attribute of a node of a graph is three levels.
const DEPTH_MAX: u32 = 24;

/// Messages of ONNX whose fields are read (`onnx.proto`).
#[derive(Clone, Copy, PartialEq)]
enum Message {
    Model,
    Graph,
    Function,
    Node,
    Attribute,
    Tensor,
    SparseTensor,
    /// Messages of strings and numbers, or of types and shapes: their parts are counted as if all could be messages.
    Other,
}

impl Message {
    /// What a field holds, if it is a message.
    fn of_field(self, field: u64) -> Option<Self> {
        match (self, field) {
            (Self::Model, 7) => Some(Self::Graph),
            (Self::Model, 25) => Some(Self::Function),
            (Self::Model, 8 | 14 | 20) => Some(Self::Other),
            (Self::Graph, 1) | (Self::Function, 7) => Some(Self::Node),
            (Self::Graph, 5) => Some(Self::Tensor),
            (Self::Graph, 15) => Some(Self::SparseTensor),
            (Self::Graph, 11..=14 | 16) => Some(Self::Other),
            (Self::Function, 11) => Some(Self::Attribute),
            (Self::Function, 9 | 12 | 14) => Some(Self::Other),
            (Self::Node, 5) => Some(Self::Attribute),
            (Self::Node, 9) => Some(Self::Other),
            (Self::Attribute, 5 | 10) => Some(Self::Tensor),
            (Self::Attribute, 6 | 11) => Some(Self::Graph),
            (Self::Attribute, 22 | 23) => Some(Self::SparseTensor),
            (Self::Attribute, 14 | 15) => Some(Self::Other),
            (Self::SparseTensor, 1 | 2) => Some(Self::Tensor),
            (Self::Tensor, 3 | 13 | 16) => Some(Self::Other),
            // Types are nested in types. In the worst case, a text in them looks like a message.
            (Self::Other, 1..=9) => Some(Self::Other),
            _ => None,
        }
    }

    /// Fields of packed numbers or raw bytes, which take no more memory than room in the file.
    fn is_data(self, field: u64) -> bool {
        match self {
            Self::Tensor => matches!(field, 1 | 4 | 5 | 7 | 9 | 10 | 11),
            Self::Attribute => matches!(field, 7 | 8),
            Self::SparseTensor => field == 3,
            _ => false,
        }
    }
}

/// What was counted so far.
#[derive(Default)]
struct Counts {
    nodes: u64,
    parts: u64,
    data_files: BTreeSet<String>,
}

/// What a file says of itself.
#[derive(Debug, Default, PartialEq)]
pub struct Described {
    /// Names of the files with weights (external data), as the file has them.
    pub data_files: BTreeSet<String>,
    /// Whether the picture is given as bytes from 0 to 255.
    pub takes_bytes: bool,
}

/// Reads what a file says of itself.
///
/// # Errors
/// What was found and what is allowed, as text, if the file is too large or holds too much.
pub fn described(onnx: &[u8]) -> Result<Described, String> {
    let bytes = onnx.len() as u64;
    if bytes > ONNX_BYTES_MAX {
        return Err(format!("{bytes} bytes, more than {ONNX_BYTES_MAX}"));
    }
    let mut counts = Counts::default();
    walk(onnx, Message::Model, 0, &mut counts)?;
    Ok(Described {
        data_files: counts.data_files,
        takes_bytes: takes_bytes(onnx),
    })
}

fn walk(mut rest: &[u8], message: Message, depth: u32, counts: &mut Counts) -> Result<(), String> {
    if depth > DEPTH_MAX {
        return Err(format!("nested deeper than {DEPTH_MAX} levels"));
    }
    // What cannot be read as a field may be text that only looked like a message; otherwise tract reports the error.
    while let Some((field, value)) = next_field(&mut rest) {
        let Value::Bytes(content) = value else {
            continue;
        };
        if message.is_data(field) {
            continue;
        }
        counts.parts += 1;
        if counts.parts > PARTS_MAX {
            return Err(format!("more than {PARTS_MAX} parts"));
        }
        let Some(inner) = message.of_field(field) else {
            continue;
        };
        if (message, field) == (Message::Tensor, 13)
            && text(content, 1).as_deref() == Some("location")
            && let Some(location) = text(content, 2)
        {
            counts.data_files.insert(location);
            if counts.data_files.len() > DATA_FILES_MAX {
                return Err(format!("weights in more than {DATA_FILES_MAX} files"));
            }
        }
        if inner == Message::Node {
            counts.nodes += 1;
            if counts.nodes > NODES_MAX {
                return Err(format!("more than {NODES_MAX} nodes"));
            }
        }
        walk(content, inner, depth + 1, counts)?;
    }
    Ok(())
}

/// Whether an input of the graph that is no weight is of bytes.
fn takes_bytes(onnx: &[u8]) -> bool {
    let Some(graph) = messages(onnx, 7).last() else {
        return false;
    };
    let weights: HashSet<String> = messages(graph, 5)
        .filter_map(|tensor| text(tensor, 8))
        .collect();
    messages(graph, 11).any(|input| {
        let kind = messages(input, 2).last();
        let tensor = kind.and_then(|kind| messages(kind, 1).last());
        let is_weight = text(input, 1).is_some_and(|name| weights.contains(&name));
        !is_weight && tensor.is_some_and(|tensor| number(tensor, 1) == Some(UINT8))
    })
}

/// The contents of a message's fields with this number.
fn messages(mut rest: &[u8], wanted: u64) -> impl Iterator<Item = &[u8]> {
    std::iter::from_fn(move || next_field(&mut rest)).filter_map(
        move |(field, value)| match value {
            Value::Bytes(content) if field == wanted => Some(content),
            _ => None,
        },
    )
}

fn number(mut rest: &[u8], wanted: u64) -> Option<u64> {
    std::iter::from_fn(move || next_field(&mut rest)).find_map(|(field, value)| match value {
        Value::Number(number) if field == wanted => Some(number),
        _ => None,
    })
}

fn text(message: &[u8], field: u64) -> Option<String> {
    let content = messages(message, field).last()?;
    String::from_utf8(content.to_vec()).ok()
}

enum Value<'a> {
    Number(u64),
    Bytes(&'a [u8]),
}

/// Removes the next field and returns its number and value; `None` if there is none.
fn next_field<'a>(rest: &mut &'a [u8]) -> Option<(u64, Value<'a>)> {
    let tag = varint(rest)?;
    let value = match tag & 7 {
        0 => Value::Number(varint(rest)?),
        1 => Value::Bytes(take(rest, 8)?),
        2 => {
            let length = varint(rest)?;
            Value::Bytes(take(rest, usize::try_from(length).ok()?)?)
        }
        5 => Value::Bytes(take(rest, 4)?),
        _ => return None,
    };
    Some((tag >> 3, value))
}

fn take<'a>(rest: &mut &'a [u8], length: usize) -> Option<&'a [u8]> {
    let (taken, after) = rest.split_at_checked(length)?;
    *rest = after;
    Some(taken)
}

fn varint(rest: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let (&byte, after) = rest.split_first()?;
        *rest = after;
        value |= u64::from(byte & 0x7F) << shift;
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}
