//! Reads TOML files key by key. Whatever is wrong is reported in plain words, with its line.
//!
//! It defines the texts for what was found and what was wanted. Unknown keys are refused.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Largest number of characters of a value that an error repeats.
const FOUND_MAX: usize = 40;

/// What is not understood in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wrong {
    /// Line, from 1.
    pub line: usize,
    /// What was found and what was wanted.
    pub what: String,
}

/// A file that is TOML.
pub struct Document<'t> {
    text: &'t str,
    table: Spanned<DeTable<'t>>,
}

impl<'t> Document<'t> {
    /// Reads the text of a file.
    ///
    /// # Errors
    /// When it is not TOML.
    pub fn parse(text: &'t str) -> Result<Self, Wrong> {
        let table = DeTable::parse(text).map_err(|error| {
            let span = error.span().unwrap_or_default();
            let key = text.get(span.clone()).unwrap_or_default();
            Wrong {
                line: line_at(text, span.start),
                what: match error.message() {
                    "duplicate key" => format!("{key} is given twice; wanted it once"),
                    other => format!("not TOML: {}", other.replace('\n', " ")),
                },
            }
        })?;
        Ok(Self { text, table })
    }

    /// The keys of the file itself, which must be among `known`.
    ///
    /// # Errors
    /// The first unknown key.
    pub fn keys<'a>(&'a self, known: &[&str]) -> Result<Keys<'a>, Wrong> {
        Keys::of(self.text, String::new(), 1, self.table.get_ref(), known)
    }
}

/// The keys of a file, or of one of its tables.
pub struct Keys<'a> {
    text: &'a str,
    /// Name as in `[can.speed]`; empty for the file itself.
    name: String,
    line: usize,
    table: &'a DeTable<'a>,
}

impl<'a> Keys<'a> {
    fn of(
        text: &'a str,
        name: String,
        line: usize,
        table: &'a DeTable<'a>,
        known: &[&str],
    ) -> Result<Self, Wrong> {
        let keys = Self {
            text,
            name,
            line,
            table,
        };
        let unknown = table
            .iter()
            .filter(|(key, _)| !known.contains(&&**key.get_ref()));
        // In the order of the file.
        match unknown.min_by_key(|(key, _)| key.span().start) {
            Some((key, _)) => Err(Wrong {
                line: line_at(text, key.span().start),
                what: format!(
                    "unknown key {}{}; wanted {}",
                    key.get_ref(),
                    keys.inside(),
                    any_of(known)
                ),
            }),
            None => Ok(keys),
        }
    }

    /// ` in [can]`; empty for the file itself.
    fn inside(&self) -> String {
        if self.name.is_empty() {
            String::new()
        } else {
            format!(" in [{}]", self.name)
        }
    }

    /// Line of the table, from 1.
    pub fn line(&self) -> usize {
        self.line
    }

    /// Line of a key, from 1; the line of the table if the key is missing.
    pub fn line_of(&self, key: &str) -> usize {
        let named = self.table.get_key_value(key);
        named.map_or(self.line, |(key, _)| line_at(self.text, key.span().start))
    }

    /// The value of a key; `None` if it is missing.
    ///
    /// # Errors
    /// When it is another kind of value.
    pub fn get<T>(&self, key: &str, kind: Kind<T>) -> Result<Option<T>, Wrong> {
        let Some(value) = self.table.get(key) else {
            return Ok(None);
        };
        let read = (kind.read)(value.get_ref()).map_err(|why| Wrong {
            line: self.line_of(key),
            what: why.map_or_else(
                || format!("{key} = {}; wanted {}", self.found(value), kind.wanted),
                |why| format!("{key}: {why}"),
            ),
        });
        read.map(Some)
    }

    /// Like [`get`](Self::get), for a key that must be there.
    ///
    /// # Errors
    /// When it is missing, or is another kind of value.
    pub fn need<T>(&self, key: &str, kind: Kind<T>) -> Result<T, Wrong> {
        let wanted = kind.wanted.clone();
        self.get(key, kind)?.ok_or_else(|| Wrong {
            line: self.line,
            what: format!("no {key}{}; wanted {wanted}", self.inside()),
        })
    }

    /// A table in this one, whose keys must be among `known`; `None` if it is missing.
    ///
    /// # Errors
    /// When it is not a table, or has an unknown key.
    pub fn table(&self, key: &str, known: &[&str]) -> Result<Option<Keys<'a>>, Wrong> {
        let Some(value) = self.table.get(key) else {
            return Ok(None);
        };
        let name = match self.name.as_str() {
            "" => key.to_owned(),
            above => format!("{above}.{key}"),
        };
        let line = self.line_of(key);
        match value.get_ref() {
            DeValue::Table(table) => Self::of(self.text, name, line, table, known).map(Some),
            _ => Err(Wrong {
                line,
                what: format!(
                    "{key} = {}; wanted a table [{name}] with {}",
                    self.found(value),
                    any_of(known)
                ),
            }),
        }
    }

    /// Like [`table`](Self::table), for a table that must be there.
    ///
    /// # Errors
    /// When it is missing, is not a table, or has an unknown key.
    pub fn need_table(&self, key: &str, known: &[&str]) -> Result<Keys<'a>, Wrong> {
        self.table(key, known)?.ok_or_else(|| Wrong {
            line: self.line,
            what: format!("no table [{key}]; wanted one with {}", any_of(known)),
        })
    }

    /// A value as it is written, cut if it is long.
    fn found(&self, value: &Spanned<DeValue<'_>>) -> String {
        let written = match value.get_ref() {
            DeValue::Table(_) => return "a table".to_owned(),
            DeValue::Array(of) if of.iter().any(|item| item.get_ref().is_table()) => {
                return "a list of tables".to_owned();
            }
            _ => self.text.get(value.span()).unwrap_or_default(),
        };
        let words: Vec<&str> = written.split_whitespace().collect();
        let mut found: String = words.join(" ");
        if let Some((cut, _)) = found.char_indices().nth(FOUND_MAX) {
            found.truncate(cut);
            found.push('…');
        }
        found
    }
}

/// Line of a byte, from 1.
fn line_at(text: &str, byte: usize) -> usize {
    let before = &text.as_bytes()[..byte.min(text.len())];
    1 + before.iter().filter(|&&byte| byte == b'\n').count()
}

fn any_of(words: &[&str]) -> String {
    match words {
        [others @ .., last] if !others.is_empty() => format!("{} or {last}", others.join(", ")),
        _ => words.concat(),
    }
}

/// Reads a value. An error may say what is wanted, if this is more than the text of the kind.
type Reading<T> = dyn Fn(&DeValue<'_>) -> Result<T, Option<String>>;

/// A kind of value: how it is read, and the text that says what is wanted.
pub struct Kind<T> {
    wanted: String,
    read: Box<Reading<T>>,
}

impl<T: 'static> Kind<T> {
    fn new(wanted: impl Into<String>, read: impl Fn(&DeValue<'_>) -> Option<T> + 'static) -> Self {
        Self {
            wanted: wanted.into(),
            read: Box::new(move |value| read(value).ok_or(None)),
        }
    }

    /// The same, with another text for what is wanted.
    #[must_use]
    pub fn wanting(self, wanted: impl Into<String>) -> Self {
        Self {
            wanted: wanted.into(),
            ..self
        }
    }

    /// A kind that converts this kind of value, if possible.
    pub fn of<U>(self, make: impl Fn(T) -> Option<U> + 'static) -> Kind<U> {
        Kind {
            wanted: self.wanted,
            read: Box::new(move |value| make((self.read)(value)?).ok_or(None)),
        }
    }

    /// Like [`of`](Self::of), with an error text of its own.
    pub fn or_say<U>(self, make: impl Fn(T) -> Result<U, String> + 'static) -> Kind<U> {
        Kind {
            wanted: self.wanted,
            read: Box::new(move |value| make((self.read)(value)?).map_err(Some)),
        }
    }
}

/// A text that is not empty; `wanted` says what is wanted.
pub fn text(wanted: impl Into<String>) -> Kind<String> {
    Kind::new(wanted, |value| {
        let text = value.as_str().filter(|text| !text.is_empty());
        text.map(str::to_owned)
    })
}

/// One of some words.
pub fn word(words: &'static [&'static str]) -> Kind<String> {
    text(format!("one of {}", words.join(", ")))
        .of(|word| words.contains(&word.as_str()).then_some(word))
}

/// True or false.
pub fn truth() -> Kind<bool> {
    Kind::new("true or false", |value| value.as_bool())
}

/// A number in a range, written with or without a fraction.
pub fn number(range: RangeInclusive<f64>, unit: &str) -> Kind<f64> {
    let wanted = format!("a number from {} to {}{unit}", range.start(), range.end());
    Kind::new(wanted, move |value| {
        float(value).filter(|number| range.contains(number))
    })
}

/// A number that is not infinite.
pub fn finite() -> Kind<f64> {
    Kind::new("a finite number", |value| {
        float(value).filter(|number| number.is_finite())
    })
}

/// A whole number in a range.
pub fn whole<T>(range: RangeInclusive<T>, unit: &str) -> Kind<T>
where
    T: TryFrom<i64> + PartialOrd + Display + 'static,
{
    let wanted = format!(
        "a whole number from {} to {}{unit}",
        range.start(),
        range.end()
    );
    Kind::new(wanted, move |value| {
        T::try_from(integer(value)?)
            .ok()
            .filter(|number| range.contains(number))
    })
}

/// `N` numbers; `wanted` says what is wanted.
pub fn numbers<T, const N: usize>(wanted: impl Into<String>) -> Kind<[T; N]>
where
    T: FromStr + 'static,
{
    Kind::new(wanted, |value| {
        let numbers = value.as_array()?.iter().map(|item| match item.get_ref() {
            DeValue::Integer(_) => integer(item.get_ref())?.to_string().parse().ok(),
            DeValue::Float(float) => float.as_str().parse().ok(),
            _ => None,
        });
        numbers.collect::<Option<Vec<T>>>()?.try_into().ok()
    })
}

/// A list of texts; `wanted` says what is wanted.
pub fn texts(wanted: impl Into<String>) -> Kind<Vec<String>> {
    Kind::new(wanted, |value| {
        let texts = value.as_array()?.iter();
        texts
            .map(|item| item.get_ref().as_str().map(str::to_owned))
            .collect()
    })
}

fn integer(value: &DeValue<'_>) -> Option<i64> {
    let integer = value.as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

fn float(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Float(float) => float.as_str().parse().ok(),
        // It is exact up to 2^53, which is far beyond any range that is used.
        #[allow(clippy::cast_precision_loss)]
        DeValue::Integer(_) => integer(value).map(|integer| integer as f64),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    fn said<T: 'static>(text: &str, kind: Kind<T>) -> String {
        let document = Document::parse(text).unwrap();
        let wrong = document
            .keys(&["key"])
            .unwrap()
            .get("key", kind)
            .err()
            .unwrap();
        format!("{}: {}", wrong.line, wrong.what)
    }

    fn read<T: 'static>(text: &str, kind: Kind<T>) -> T {
        let document = Document::parse(text).unwrap();
        document.keys(&["key"]).unwrap().need("key", kind).unwrap()
    }

    #[test]
    fn values_of_their_kind_are_read() {
        assert_eq!(read("key = 3", number(3.0..=4.0, "")), 3.0);
        assert_eq!(read("key = 4.0", number(3.0..=4.0, "")), 4.0);
        assert_eq!(read("key = 0x7ff", whole(0_u16..=0x7ff, "")), 0x7ff);
        assert_eq!(read("key = 1_000", whole(0_u16..=1_000, "")), 1_000);
        assert!(read("key = true", truth()));
        assert_eq!(read("key = 'a'", word(&["a", "b"])), "a");
        assert_eq!(
            read("key = [1, 0.25]", numbers::<f32, 2>("two")),
            [1.0, 0.25]
        );
        assert_eq!(read("key = ['a', 'b']", texts("names")), ["a", "b"]);
        assert_eq!(read("key = -2.5e0", finite()), -2.5);
    }

    #[test]
    fn other_values_are_answered_with_line_found_and_wanted() {
        let from_3 = || number(3.0..=4.0, " seconds");
        let wanted = "wanted a number from 3 to 4 seconds";
        for found in [
            "\"3\"",
            "true",
            "2.9",
            "4.1",
            "nan",
            "inf",
            "[3]",
            "1979-05-27",
        ] {
            assert_eq!(
                said(&format!("\nkey = {found}"), from_3()),
                format!("2: key = {found}; {wanted}")
            );
        }
        assert_eq!(
            said("key = { a = 1 }", from_3()),
            format!("1: key = a table; {wanted}")
        );
        assert_eq!(
            said("[[key]]", from_3()),
            format!("1: key = a list of tables; {wanted}")
        );
        for found in ["-1", "8.0", "0x10", "99999999999999999999999"] {
            assert_eq!(
                said(&format!("key = {found}"), whole(0_u8..=9, "")),
                format!("1: key = {found}; wanted a whole number from 0 to 9")
            );
        }
        assert_eq!(
            said("key = ''", text("a name")),
            "1: key = ''; wanted a name"
        );
        assert_eq!(said("key = 1", truth()), "1: key = 1; wanted true or false");
        assert_eq!(
            said("key = 'c'", word(&["a", "b"])),
            "1: key = 'c'; wanted one of a, b"
        );
        assert_eq!(
            said("key = [1]", numbers::<f32, 2>("two")),
            "1: key = [1]; wanted two"
        );
        assert_eq!(
            said("key = ['a', 1]", texts("names")),
            "1: key = ['a', 1]; wanted names"
        );
        let long = said(&format!("key = \"\"\"{}\n\"\"\"", "é".repeat(99)), truth());
        assert!(
            long.ends_with("é…; wanted true or false") && long.chars().count() < 90,
            "{long}"
        );
        let own = text("a name").or_say(|name| Err::<(), _>(format!("{name} is taken")));
        assert_eq!(said("key = 'x'", own), "1: key: x is taken");
    }

    #[test]
    fn keys_and_tables_are_answered_by_name() {
        let whole = "a = 1\n\n[b]\nc = 2\n[b.d]\ne = 3\n";
        let document = Document::parse(whole).unwrap();
        let keys = document.keys(&["a", "b"]).unwrap();
        let b = keys.need_table("b", &["c", "d"]).unwrap();
        assert_eq!((b.line(), b.line_of("c"), b.line_of("x")), (3, 4, 3));
        let wrong = |line, what: &str| Wrong {
            line,
            what: what.to_owned(),
        };
        let first = document.keys(&["x"]).err().unwrap();
        assert_eq!(first, wrong(1, "unknown key a; wanted x"));
        let unknown = b.table("d", &["f", "g", "h"]).err().unwrap();
        assert_eq!(
            unknown,
            wrong(6, "unknown key e in [b.d]; wanted f, g or h")
        );
        let missing = b.need("x", truth()).unwrap_err();
        assert_eq!(missing, wrong(3, "no x in [b]; wanted true or false"));
        let missing = keys.need_table("x", &["y", "z"]).err().unwrap();
        assert_eq!(missing, wrong(1, "no table [x]; wanted one with y or z"));
        let no_table = keys.table("a", &["y"]).err().unwrap();
        assert_eq!(no_table, wrong(1, "a = 1; wanted a table [a] with y"));
        assert!(keys.table("x", &[]).unwrap().is_none());
        let twice = Document::parse("a = 1\na = 2\n").err().unwrap();
        assert_eq!(twice, wrong(2, "a is given twice; wanted it once"));
        let no_toml = Document::parse("a = 1\nb = [\n").err().unwrap();
        assert!(no_toml.what.starts_with("not TOML: "), "{no_toml:?}");
        assert!(
            !no_toml.what.contains('\n') && no_toml.line >= 2,
            "{no_toml:?}"
        );
    }
}
