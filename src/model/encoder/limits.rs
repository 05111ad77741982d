//! Limits of what an ONNX file may hold, checked on its bytes before they are used.
//!
//! It reads the protobuf's fields without keeping any: a field of two bytes can become a structure of hundreds of
//! bytes, so fields are counted before they are parsed. Data outside the file are refused with an error of their own.
//! The graph itself is checked by tract.

use crate::model::ONNX_BYTES_MAX;

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
}

/// Refuses a file that is too large, holds too much or needs other files.
///
/// # Errors
/// What was found and what is allowed, as text.
pub fn check(onnx: &[u8]) -> Result<(), String> {
    let bytes = onnx.len() as u64;
    if bytes > ONNX_BYTES_MAX {
        return Err(format!("{bytes} bytes, more than {ONNX_BYTES_MAX}"));
    }
    walk(onnx, Message::Model, 0, &mut Counts::default())
}

fn walk(mut rest: &[u8], message: Message, depth: u32, counts: &mut Counts) -> Result<(), String> {
    if depth > DEPTH_MAX {
        return Err(format!("nested deeper than {DEPTH_MAX} levels"));
    }
    while !rest.is_empty() {
        let Some((field, value)) = next_field(&mut rest) else {
            // What cannot be read as a field may be text that only looked like a message; otherwise tract reports the
            // error.
            return Ok(());
        };
        if message == Message::Tensor
            && (field == 13 || (field == 14 && matches!(value, Value::Number(place) if place != 0)))
        {
            return Err(
                "a tensor's data are in another file (external data); wanted one file with all weights"
                    .to_owned(),
            );
        }
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
