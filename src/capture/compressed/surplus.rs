//! Bytes too many in a JPEG file's entropy-coded data.
//!
//! Some cameras fill up the data before a marker, which loses nothing. Damaged data also often end with bytes left
//! over, and libjpeg warns of both in the same way. Here the codes are walked through, without making a picture, to
//! tell them apart.

use super::segments::{DHT, DRI, Outline, SOS, Segments, is_restart, number};

/// Largest number of bytes before a marker that are no data, unless they are all the same.
const SURPLUS_MAX: usize = 16;

/// Whether all codes of the picture are there, and only some bytes too many. Files with other than sequential Huffman
/// codes are never taken.
pub fn is_only_surplus(bytes: &[u8], outline: &Outline, standard: &[u8]) -> bool {
    outline.is_sequential_huffman() && walk(bytes, outline, standard).is_some()
}

/// A Huffman table: for each length of a code, the first code behind those of this length, and where its values are.
#[derive(Clone, Default)]
struct Table {
    /// By length less one: the number above the last code, and what leads from a code to its value.
    lengths: [(i32, i32); 16],
    values: Vec<u8>,
}

/// Tables by class (0 is DC, 1 is AC) and number.
type Tables = [[Option<Table>; 4]; 2];

/// Reads the tables of a segment.
fn read_tables(mut body: &[u8], tables: &mut Tables) -> Option<()> {
    while let [what, rest @ ..] = body {
        let (counts, rest) = rest.split_first_chunk::<16>()?;
        let total = counts.iter().map(|&count| usize::from(count)).sum();
        let mut table = Table {
            values: rest.get(..total)?.to_vec(),
            ..Table::default()
        };
        let (mut code, mut before) = (0, 0);
        for (length, &count) in table.lengths.iter_mut().zip(counts) {
            let count = i32::from(count);
            *length = (code + count, before - code);
            code = (code + count) * 2;
            before += count;
        }
        let of_class = tables.get_mut(usize::from(what >> 4))?;
        *of_class.get_mut(usize::from(what & 15))? = Some(table);
        body = &rest[total..];
    }
    Some(())
}

/// The bits of data between two markers.
struct Bits<'a> {
    bytes: &'a [u8],
    byte: u8,
    left: u32,
}

impl Bits<'_> {
    fn next(&mut self) -> Option<i32> {
        if self.left == 0 {
            let (&byte, rest) = self.bytes.split_first()?;
            self.byte = byte;
            // The 0 behind it only says that it is no marker.
            self.bytes = match (byte, rest) {
                (0xFF, [0, rest @ ..]) => rest,
                (0xFF, _) => return None,
                _ => rest,
            };
            self.left = 8;
        }
        self.left -= 1;
        Some(i32::from(self.byte >> self.left & 1))
    }

    fn skip(&mut self, count: u8) -> Option<()> {
        (0..count).try_for_each(|_| self.next().map(drop))
    }

    fn symbol(&mut self, table: &Table) -> Option<u8> {
        let mut code = 0;
        for (end, to_value) in table.lengths {
            code = code * 2 + self.next()?;
            if code < end {
                let value = usize::try_from(code + to_value).ok()?;
                return table.values.get(value).copied();
            }
        }
        None
    }

    fn block(&mut self, dc: &Table, ac: &Table) -> Option<()> {
        let size = self.symbol(dc)?;
        self.skip(size)?;
        let mut at = 1;
        while at < 64 {
            let symbol = self.symbol(ac)?;
            let (run, size) = (symbol >> 4, symbol & 15);
            if size == 0 && run != 15 {
                break;
            }
            at += run + 1;
            self.skip(size)?;
        }
        (at <= 64).then_some(())
    }

    /// Whether what is left is no data: the last byte is filled up with ones, as the standard wants, and few bytes
    /// or equal ones follow; or all is 0.
    fn is_rest_empty(&self) -> bool {
        let filled = self.byte & ((1 << self.left) - 1);
        let ones = u32::from(filled) == (1 << self.left) - 1;
        let equal = self.bytes.windows(2).all(|pair| pair[0] == pair[1]);
        let zeros = filled == 0 && self.bytes.iter().all(|&byte| byte == 0);
        zeros || (ones && (equal || self.bytes.len() <= SURPLUS_MAX))
    }
}

fn walk(bytes: &[u8], outline: &Outline, standard: &[u8]) -> Option<()> {
    let mut tables = Tables::default();
    for segment in Segments::of(standard)?.filter(|segment| segment.marker == DHT) {
        read_tables(segment.body, &mut tables)?;
    }
    let mut interval = None;
    for segment in Segments::of(bytes)? {
        match segment.marker {
            DHT => read_tables(segment.body, &mut tables)?,
            DRI => interval = Some(u64::from(number(segment.body)?)).filter(|&units| units > 0),
            SOS => scan(segment.body, segment.data, outline, &tables, interval)?,
            _ => {}
        }
    }
    Some(())
}

fn scan(
    header: &[u8],
    data: &[u8],
    outline: &Outline,
    tables: &Tables,
    interval: Option<u64>,
) -> Option<()> {
    let most = |of: fn((u8, u8)) -> u8| outline.components.iter().map(|c| of(c.sampling)).max();
    let (across, down) = (most(|s| s.0)?.max(1), most(|s| s.1)?.max(1));
    let count = usize::from(*header.first()?);
    let mut blocks = Vec::new();
    let mut sampling = (across, down);
    for named in header.get(1..=2 * count)?.chunks_exact(2) {
        let component = outline.components.iter().find(|c| c.id == named[0])?;
        let table = |class: usize, number: u8| tables[class].get(usize::from(number))?.as_ref();
        let (dc, ac) = (table(0, named[1] >> 4)?, table(1, named[1] & 15)?);
        let (h, v) = component.sampling;
        let in_unit = if count == 1 { 1 } else { usize::from(h * v) };
        blocks.extend(std::iter::repeat_n((dc, ac), in_unit));
        if count == 1 {
            sampling = (h, v);
        }
    }
    // A scan of one component has only the blocks that its samples need; others have units of all components.
    let units = |pixels: u32, of: u8, most: u8| match count {
        1 => (pixels * u32::from(of))
            .div_ceil(u32::from(most))
            .div_ceil(8),
        _ => pixels.div_ceil(8 * u32::from(most)),
    };
    let across = units(outline.width, sampling.0, across);
    let down = units(outline.height, sampling.1, down);
    let mut left = u64::from(across) * u64::from(down);
    for piece in pieces(data) {
        let units = left.min(interval.unwrap_or(left));
        if units == 0 {
            return None;
        }
        let mut bits = Bits {
            bytes: piece,
            byte: 0,
            left: 0,
        };
        for _ in 0..units {
            blocks.iter().try_for_each(|(dc, ac)| bits.block(dc, ac))?;
        }
        if !bits.is_rest_empty() {
            return None;
        }
        left -= units;
    }
    (left == 0).then_some(())
}

/// The data between restart markers, without the bytes that fill up before a marker.
fn pieces(mut data: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut ended = false;
    std::iter::from_fn(move || {
        if ended {
            return None;
        }
        let restart = data
            .windows(2)
            .position(|pair| pair[0] == 0xFF && is_restart(pair[1]));
        let end = restart.unwrap_or(data.len());
        let (piece, rest) = data.split_at(end);
        ended = restart.is_none();
        data = rest.get(2..).unwrap_or_default();
        let filled = piece.iter().rev().take_while(|&&byte| byte == 0xFF).count();
        Some(&piece[..piece.len() - filled])
    })
}
