//! A JPEG file's segments and what its headers say. Entropy-coded data are skipped, not decoded.

use image::metadata::Orientation;

/// Largest number of scans. Progressive files have about ten, and 18 with four inks; each further one costs time for the
/// whole picture.
const SCANS_MAX: u32 = 20;

/// Begins every JPEG file.
const SOI: [u8; 2] = [0xFF, 0xD8];
/// End of image.
pub const EOI: u8 = 0xD9;
/// Start of scan; entropy-coded data follow it.
pub const SOS: u8 = 0xDA;
/// Huffman tables.
pub const DHT: u8 = 0xC4;
/// Restart interval.
pub const DRI: u8 = 0xDD;
const APP1: u8 = 0xE1;
/// Begins the EXIF data in a segment APP1.
const EXIF: &[u8] = b"Exif\0";

/// Whether the marker begins a frame.
fn is_frame(marker: u8) -> bool {
    matches!(marker, 0xC0..=0xCF) && !matches!(marker, DHT | 0xC8 | 0xCC)
}

/// Whether the marker stands for itself in entropy-coded data.
pub fn is_restart(marker: u8) -> bool {
    matches!(marker, 0xD0..=0xD7)
}

/// A marker with what belongs to it.
pub struct Segment<'a> {
    pub marker: u8,
    /// Without marker and length.
    pub body: &'a [u8],
    /// The entropy-coded data behind the header of a scan, with their restart markers; else empty.
    pub data: &'a [u8],
}

/// The segments up to the end of the image, or up to where the file ends. Bytes between segments are skipped.
pub struct Segments<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Whether the end of the image was found.
    pub ended: bool,
}

impl<'a> Segments<'a> {
    /// `None` if this does not begin like a JPEG file.
    pub fn of(bytes: &'a [u8]) -> Option<Self> {
        bytes.starts_with(&SOI).then_some(Self {
            bytes,
            at: SOI.len(),
            ended: false,
        })
    }

    /// Bytes read so far: behind the last one, the length of the picture.
    pub fn at(&self) -> usize {
        self.at
    }

    /// The next marker other than a restart.
    fn marker(&mut self) -> Option<u8> {
        loop {
            let rest = self.bytes.get(self.at..)?;
            let begins = rest.iter().position(|&byte| byte == 0xFF)?;
            let fill = rest[begins..].iter().position(|&byte| byte != 0xFF)?;
            let marker = rest[begins + fill];
            self.at += begins + fill + 1;
            if marker > 0x01 && !is_restart(marker) {
                return Some(marker);
            }
        }
    }

    fn next_in_file(&mut self) -> Option<Segment<'a>> {
        let marker = self.marker()?;
        if marker == EOI {
            self.ended = true;
            return None;
        }
        if marker == SOI[1] {
            let (body, data) = (&[][..], &[][..]);
            return Some(Segment { marker, body, data });
        }
        let length = usize::from(number(self.bytes.get(self.at..)?)?);
        let body = self.bytes.get(self.at + 2..self.at + length)?;
        self.at += length;
        let mut data = &[][..];
        if marker == SOS {
            let from = self.at;
            // What begins the next segment ends the data.
            let next = self.marker();
            self.at -= next.map_or(0, |_| 2);
            if next.is_none() {
                self.at = self.bytes.len();
            }
            data = &self.bytes[from..self.at];
        }
        Some(Segment { marker, body, data })
    }
}

impl<'a> Iterator for Segments<'a> {
    type Item = Segment<'a>;

    fn next(&mut self) -> Option<Segment<'a>> {
        if self.ended {
            return None;
        }
        let segment = self.next_in_file();
        if segment.is_none() && !self.ended {
            self.at = self.bytes.len();
        }
        segment
    }
}

/// The number in the first two bytes.
pub fn number(bytes: &[u8]) -> Option<u16> {
    let two = bytes.first_chunk()?;
    Some(u16::from_be_bytes(*two))
}

/// A component of the frame: luma or a colour.
#[derive(Clone, Copy, Debug)]
pub struct Component {
    pub id: u8,
    /// Samples across and down for each of the coarsest component's.
    pub sampling: (u8, u8),
    /// Bit `k` is set when coefficient `k` is known to its last bit.
    known: u64,
}

/// What the headers say.
pub struct Outline {
    /// Marker of the frame, which names the process.
    pub process: u8,
    pub width: u32,
    pub height: u32,
    pub components: Vec<Component>,
    pub orientation: Orientation,
    /// Length of the picture in bytes, up to its end marker or the end of the file.
    pub length: usize,
    /// Whether the end marker is there.
    pub ended: bool,
}

impl Outline {
    /// # Errors
    /// When there is no frame, or more scans than any real file has.
    pub fn of(bytes: &[u8]) -> Result<Self, String> {
        let begins = || format!("{} bytes that do not begin like a JPEG image", bytes.len());
        let mut segments = Segments::of(bytes).ok_or_else(begins)?;
        let mut outline: Option<Self> = None;
        let mut orientation = None;
        let mut scans = 0;
        for segment in &mut segments {
            match (segment.marker, &mut outline) {
                (APP1, _) if orientation.is_none() && segment.body.starts_with(EXIF) => {
                    // The name ends in two bytes, of which the second is not always 0.
                    let tiff = segment.body.get(EXIF.len() + 1..).unwrap_or_default();
                    orientation = Some(Orientation::from_exif_chunk(tiff));
                }
                (marker, None) if is_frame(marker) => outline = frame(marker, segment.body),
                (SOS, Some(outline)) => {
                    scans += 1;
                    if scans > SCANS_MAX {
                        return Err(format!("a JPEG image of more than {SCANS_MAX} scans"));
                    }
                    outline.learn(segment.body);
                }
                _ => {}
            }
        }
        let outline = outline.ok_or_else(|| cut_off(bytes.len()))?;
        Ok(Self {
            orientation: orientation.flatten().unwrap_or(Orientation::NoTransforms),
            length: segments.at(),
            ended: segments.ended,
            ..outline
        })
    }

    /// Whether the frame is coded by Huffman, in one pass over each coefficient.
    pub fn is_sequential_huffman(&self) -> bool {
        matches!(self.process, 0xC0 | 0xC1)
    }

    fn is_progressive(&self) -> bool {
        matches!(self.process, 0xC2 | 0xCA)
    }

    /// Notes which coefficients are complete after a scan with this header.
    fn learn(&mut self, header: &[u8]) {
        let progressive = self.is_progressive();
        let count = header.first().copied().unwrap_or_default();
        let after = usize::from(count) * 2 + 1;
        let Some(&[from, to, bits]) = header.get(after..after + 3) else {
            return;
        };
        let (from, to) = if progressive { (from, to) } else { (0, 63) };
        if from > to || to > 63 || (progressive && bits & 15 != 0) {
            return;
        }
        let of_scan = (u64::MAX >> (63 - to)) & (u64::MAX << from);
        for pair in header[1..after].chunks_exact(2) {
            let named = self.components.iter_mut().filter(|c| c.id == pair[0]);
            named.for_each(|component| component.known |= of_scan);
        }
    }

    /// Whether there was a scan for all that makes the picture. A progressive file that ends properly is what its
    /// writer wanted.
    pub fn is_complete(&self) -> bool {
        let mut known = self.components.iter().map(|component| component.known);
        if self.is_progressive() && !self.ended {
            known.all(|known| known == u64::MAX)
        } else {
            known.all(|known| known & 1 != 0) || self.is_progressive()
        }
    }
}

/// What is said of a file that ends too early.
pub fn cut_off(length: usize) -> String {
    format!("an image cut off after {length} bytes")
}

fn frame(process: u8, body: &[u8]) -> Option<Outline> {
    let &[_, h0, h1, w0, w1, count, ref rest @ ..] = body else {
        return None;
    };
    let components = rest.chunks_exact(3).take(usize::from(count));
    Some(Outline {
        process,
        width: u16::from_be_bytes([w0, w1]).into(),
        height: u16::from_be_bytes([h0, h1]).into(),
        components: components
            .map(|of| Component {
                id: of[0],
                sampling: (of[1] >> 4, of[1] & 15),
                known: 0,
            })
            .collect(),
        orientation: Orientation::NoTransforms,
        length: 0,
        ended: false,
    })
}
