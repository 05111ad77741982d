//! The order of names with numbers in them.
//!
//! Runs of digits count as numbers, so that `frame_2` comes before `frame_10`. Two things depend on all names of a
//! folder:
//!
//! - A number with a point may be a decimal number, as in the stamps `1700000000.5` and `1700000000.25`, or a counter
//!   within another, as in the versions `1.9` and `1.10`. A program that leaves out zeros at the end of decimal numbers
//!   never writes one there, and a counter without zeros in front never has one there. So the numbers are decimal
//!   unless one of them ends in a 0 behind another digit, if their whole part is as long as seconds since 1970, or if
//!   the part behind the point begins with a 0 in one of them. If all have the same number of digits behind the point,
//!   both orders are the same.
//! - A minus in front of a number is a sign if a plus stands in front of another.

use std::cmp::Reverse;

/// Fewest digits of a number of seconds since 1970 (since 1973).
const STAMP_DIGITS: usize = 9;

/// A number of any length: its digits by their count, and those behind the point.
type Number = ((usize, String), String);

/// A piece of a name.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
pub enum NamePart {
    Negative(Reverse<Number>, String),
    Number(Number, String),
    Text(String),
}

/// How the numbers in names are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NameOrder {
    decimal: bool,
    signed: bool,
}

impl NameOrder {
    /// How numbers are read in all of these names.
    pub fn of<'a>(names: impl Iterator<Item = &'a str> + Clone) -> Self {
        let pieces = names.clone().map(pieces);
        let (mut stamps, mut zero_in_front, mut zero_behind) = (false, false, false);
        for pieces in pieces {
            for at in 0..pieces.len() {
                if let Some((whole, fraction)) = decimal(&pieces, at) {
                    stamps |= whole.len() >= STAMP_DIGITS;
                    zero_in_front |= fraction.starts_with('0');
                    zero_behind |= fraction.len() > 1 && fraction.ends_with('0');
                }
            }
        }
        let has_plus = |name: &str| {
            let mut pairs = name.as_bytes().windows(2);
            pairs.any(|pair| pair[0] == b'+' && pair[1].is_ascii_digit())
        };
        Self {
            decimal: !zero_behind && (stamps || zero_in_front),
            signed: names.clone().any(has_plus),
        }
    }

    /// What a name is sorted by.
    pub fn key(self, name: &str) -> Vec<NamePart> {
        let pieces = pieces(name);
        let mut parts = Vec::new();
        let mut at = 0;
        while let Some(&piece) = pieces.get(at) {
            let next_is_number = pieces.get(at + 1).is_some();
            let sign = ['-', '+']
                .into_iter()
                .find(|&sign| self.signed && next_is_number && piece.ends_with(sign));
            if is_number(piece) {
                let found = decimal(&pieces, at).filter(|_| self.decimal);
                let (number, length) = match found {
                    Some((whole, fraction)) => (number(whole, fraction), 3),
                    None => (number(piece, ""), 1),
                };
                let text = pieces[at..at + length].concat();
                let negative = at > 0 && self.signed && pieces[at - 1].ends_with('-');
                parts.push(match negative {
                    true => NamePart::Negative(Reverse(number), text),
                    false => NamePart::Number(number, text),
                });
                at += length;
            } else {
                let text = sign.map_or(piece, |sign| piece.trim_end_matches(sign));
                if !text.is_empty() {
                    parts.push(NamePart::Text(text.to_owned()));
                }
                at += 1;
            }
        }
        parts
    }
}

/// Natural order of a name by itself.
pub fn name_order(name: &str) -> Vec<NamePart> {
    NameOrder::default().key(name)
}

/// Runs of digits, and what is between them.
fn pieces(name: &str) -> Vec<&str> {
    let bytes = name.as_bytes();
    let runs = bytes.chunk_by(|a, b| a.is_ascii_digit() == b.is_ascii_digit());
    let mut at = 0;
    runs.map(|run| {
        at += run.len();
        // Digits are whole characters, so the runs between them are text.
        name.get(at - run.len()..at).unwrap_or_default()
    })
    .collect()
}

fn is_number(piece: &str) -> bool {
    piece.starts_with(|first: char| first.is_ascii_digit())
}

/// The two numbers around the point of the number that begins at this piece; not of a date or version with more points.
fn decimal<'a>(pieces: &[&'a str], at: usize) -> Option<(&'a str, &'a str)> {
    let &[whole, ".", fraction, ref behind @ ..] = pieces.get(at..)? else {
        return None;
    };
    let before = at.checked_sub(2).map(|at| &pieces[at..at + 2]);
    let more =
        before.is_some_and(|of| is_number(of[0]) && of[1] == ".") || matches!(behind, [".", _, ..]);
    (is_number(whole) && !more).then_some((whole, fraction))
}

fn number(whole: &str, fraction: &str) -> Number {
    let digits = whole.trim_start_matches('0');
    (
        (digits.len(), digits.to_owned()),
        fraction.trim_end_matches('0').to_owned(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sorts names that are given in their right order, from their order as text.
    fn is_kept(names: &[&str]) -> bool {
        let order = NameOrder::of(names.iter().copied());
        let mut sorted = names.to_vec();
        sorted.sort_unstable();
        sorted.sort_by_cached_key(|name| order.key(name));
        sorted == names
    }

    #[test]
    fn names_are_ordered_by_their_numbers() {
        for names in [
            &[
                "a_100", "b", "b_0", "b_09", "b_9", "b_9_2", "b_9_10", "b_10",
            ][..],
            &[
                "9",
                "10",
                "99999999999999999999999999999999999999999999",
                "100000000000000000000000000000000000000000000",
            ],
            &["дорога 道路 é2", "дорога 道路 é10"],
            &["2019-1-1 2h59m9s", "2019-1-1 2h59m10s", "2019-1-12 0h0m0s"],
            &["frame-1", "frame-2", "frame-10"],
            &["t-12", "t-2", "t+0", "t+2", "t+11"],
        ] {
            assert!(is_kept(names), "{names:?}");
        }
    }

    #[test]
    fn stamps_are_decimal_numbers_and_versions_are_not() {
        for names in [
            &["1700000000.25", "1700000000.5", "1700000001.0"][..],
            &["cam_1479425441.1", "cam_1479425441.15", "cam_1479425441.2"],
            &["0.0", "0.05", "0.1", "0.15", "0.2", "1.0", "10.05"],
            &[
                "1305031102.175304",
                "1305031102.208637",
                "1305031103.000001",
            ],
            // Seconds and nanoseconds, both without zeros in front.
            &[
                "1700000000.5000000",
                "1700000000.38333333",
                "1700000000.999999990",
            ],
            &["frame_1.8", "frame_1.9", "frame_1.10", "frame_2.1"],
            &["v1.9.1", "v1.10.0", "v1.10.05"],
            &["2024.01.05", "2024.1.12", "2024.11.05"],
        ] {
            assert!(is_kept(names), "{names:?}");
        }
    }
}
