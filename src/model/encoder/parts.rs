//! Nodes of an ONNX graph and their attributes: reading them, and making new ones.

use tract_onnx::pb::attribute_proto::AttributeType;
use tract_onnx::pb::{AttributeProto, NodeProto};

/// What a node's attributes are, with ONNX's own values for those that are not given.
pub struct Attributes<'a>(pub &'a NodeProto);

impl<'a> Attributes<'a> {
    fn get(&self, name: &str) -> Option<&'a AttributeProto> {
        self.0
            .attribute
            .iter()
            .find(|attribute| attribute.name == name)
    }

    /// A whole number.
    pub fn int(&self, name: &str, otherwise: i64) -> i64 {
        self.get(name).map_or(otherwise, |attribute| attribute.i)
    }

    /// A float.
    pub fn float(&self, name: &str, otherwise: f32) -> f32 {
        self.get(name).map_or(otherwise, |attribute| attribute.f)
    }

    /// A text.
    pub fn text(&self, name: &str, otherwise: &'static str) -> &'a str {
        let given = self.get(name).map(|attribute| attribute.s.as_slice());
        given.map_or(otherwise, |text| {
            std::str::from_utf8(text).unwrap_or_default()
        })
    }

    /// Whole numbers; none if they are not given.
    pub fn ints(&self, name: &str) -> Option<&'a [i64]> {
        self.get(name).map(|attribute| attribute.ints.as_slice())
    }

    /// Floats; none if they are not given.
    pub fn floats(&self, name: &str) -> Option<&'a [f32]> {
        self.get(name).map(|attribute| attribute.floats.as_slice())
    }
}

/// A node without names.
pub fn node(op: &str, attribute: Vec<AttributeProto>) -> NodeProto {
    NodeProto {
        op_type: op.to_owned(),
        attribute,
        ..NodeProto::default()
    }
}

/// An attribute that is a whole number.
pub fn int(name: &str, value: i64) -> AttributeProto {
    AttributeProto {
        name: name.to_owned(),
        i: value,
        r#type: AttributeType::Int as i32,
        ..AttributeProto::default()
    }
}

/// An attribute of whole numbers.
pub fn ints(name: &str, values: &[i64]) -> AttributeProto {
    AttributeProto {
        name: name.to_owned(),
        ints: values.to_vec(),
        r#type: AttributeType::Ints as i32,
        ..AttributeProto::default()
    }
}

/// An attribute that is a text.
pub fn text(name: &str, value: &str) -> AttributeProto {
    AttributeProto {
        name: name.to_owned(),
        s: value.as_bytes().to_vec(),
        r#type: AttributeType::String as i32,
        ..AttributeProto::default()
    }
}
