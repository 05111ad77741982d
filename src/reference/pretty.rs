//! JSON for people: it is indented, but the numbers of an array are side by side.

use std::io::{self, Write};

use serde::Serialize;
use serde_json::ser::{Formatter, PrettyFormatter, Serializer};

/// Longest line of numbers, characters.
const LINE: usize = 110;

/// The value as pretty JSON with a final line break.
pub fn to_json(value: &impl Serialize) -> String {
    let mut text = Vec::new();
    let mut serializer = Serializer::with_formatter(&mut text, InRows::default());
    // This cannot fail: our types have string keys and finite numbers, and a Vec accepts every byte.
    value.serialize(&mut serializer).unwrap_or_default();
    text.push(b'\n');
    String::from_utf8_lossy(&text).into_owned()
}

/// [`PrettyFormatter`], but the numbers and strings of an array go on one line until it is full.
#[derive(Default)]
struct InRows {
    pretty: PrettyFormatter<'static>,
    /// Set if an element of an array comes next, with whether it is the first one. Its kind decides how it is
    /// separated.
    pending: Option<bool>,
    column: usize,
}

macro_rules! numbers {
    ($($name:ident: $kind:ty),*) => {
        $(fn $name<W: ?Sized + Write>(&mut self, writer: &mut W, value: $kind) -> io::Result<()> {
            let mut text = Vec::new();
            self.pretty.$name(&mut text, value)?;
            self.in_row(writer, text.len())?;
            writer.write_all(&text)
        })*
    };
}

impl InRows {
    /// Separates a number or string of about `length` characters from the one before it.
    fn in_row<W: ?Sized + Write>(&mut self, writer: &mut W, length: usize) -> io::Result<()> {
        if self.pending.take() == Some(false) {
            if self.column + length + 2 > LINE {
                writer.write_all(b",\n        ")?;
                self.column = 8;
            } else {
                writer.write_all(b", ")?;
                self.column += 2;
            }
        }
        self.column += length;
        Ok(())
    }

    /// Separates an array or object.
    fn on_own_line<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        match self.pending.take() {
            Some(first) => self.pretty.begin_array_value(writer, first),
            None => Ok(()),
        }
    }
}

impl Formatter for InRows {
    numbers!(write_u8: u8, write_u32: u32, write_u64: u64, write_i64: i64, write_f32: f32, write_f64: f64);

    fn begin_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.on_own_line(writer)?;
        self.column = 8;
        self.pretty.begin_array(writer)
    }

    fn begin_array_value<W: ?Sized + Write>(&mut self, _: &mut W, first: bool) -> io::Result<()> {
        self.pending = Some(first);
        Ok(())
    }

    fn end_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.pretty.end_array(writer)
    }

    fn begin_string<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.in_row(writer, 20)?;
        self.pretty.begin_string(writer)
    }

    fn begin_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.on_own_line(writer)?;
        self.pretty.begin_object(writer)
    }

    fn end_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.pretty.end_object(writer)
    }

    fn begin_object_key<W: ?Sized + Write>(
        &mut self,
        writer: &mut W,
        first: bool,
    ) -> io::Result<()> {
        self.pretty.begin_object_key(writer, first)
    }

    fn begin_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.pretty.begin_object_value(writer)
    }

    fn end_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.pretty.end_object_value(writer)
    }
}
