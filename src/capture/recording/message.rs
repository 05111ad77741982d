//! Messages that hold an image: their schemas, and how to read the picture.
//!
//! Nothing in them is trusted: lengths must stay inside the message, and sizes are checked before memory is used for a
//! picture.

use std::time::Duration;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use byteorder::{BigEndian, LittleEndian};
use prost::Message as _;
use serde::Deserialize;

use crate::capture::compressed::decoded;
use crate::capture::pixels::{Layout, PixelFormat, Pixels};
use crate::capture::{PIXELS_MAX, Picture};
use crate::files::json_fault::fault;

/// The supported schemas, for error messages.
pub const UNDERSTOOD: &str = "sensor_msgs/msg/Image or CompressedImage in cdr, foxglove.RawImage or CompressedImage in protobuf or json";

/// A schema with an image, and how its messages are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// `sensor_msgs/msg/Image` of ROS 2.
    RosImage,
    /// `sensor_msgs/msg/CompressedImage` of ROS 2.
    RosCompressedImage,
    /// `foxglove.RawImage` as Protocol Buffers.
    RawImageProtobuf,
    /// `foxglove.RawImage` as JSON.
    RawImageJson,
    /// `foxglove.CompressedImage` as Protocol Buffers.
    CompressedImageProtobuf,
    /// `foxglove.CompressedImage` as JSON.
    CompressedImageJson,
}

/// An image with its own time.
#[derive(Debug)]
pub struct Image {
    /// When it was taken, since the epoch of the recording's clock; zero if the message does not give it.
    pub stamp: Duration,
    /// The picture, or what is wrong with it.
    pub picture: Result<Pixels, String>,
}

impl Kind {
    /// The kind for a channel's schema and message encoding; `None` if it is not a supported image.
    pub fn of(schema: &str, encoding: &str) -> Option<Self> {
        match (schema, encoding) {
            ("sensor_msgs/msg/Image", "cdr") => Some(Self::RosImage),
            ("sensor_msgs/msg/CompressedImage", "cdr") => Some(Self::RosCompressedImage),
            ("foxglove.RawImage", "protobuf") => Some(Self::RawImageProtobuf),
            ("foxglove.RawImage", "json") => Some(Self::RawImageJson),
            ("foxglove.CompressedImage", "protobuf") => Some(Self::CompressedImageProtobuf),
            ("foxglove.CompressedImage", "json") => Some(Self::CompressedImageJson),
            _ => None,
        }
    }

    /// The image in a message of this kind.
    ///
    /// # Errors
    /// What is wrong with a message from which neither time nor picture can be read.
    pub fn image(self, message: &[u8]) -> Result<Image, String> {
        match self {
            Self::RosImage => {
                let raw: RosImage<'_> = from_cdr(message)?;
                Ok(Image {
                    stamp: raw.header.stamp.since_epoch(),
                    picture: picture(&raw.encoding, raw.width, raw.height, raw.step, raw.data),
                })
            }
            Self::RosCompressedImage => {
                let compressed: RosCompressedImage<'_> = from_cdr(message)?;
                Ok(Image {
                    stamp: compressed.header.stamp.since_epoch(),
                    picture: decoded(compressed.data).map(Pixels::from),
                })
            }
            Self::RawImageProtobuf => {
                let raw = RawImage::decode(message).map_err(|error| error.to_string())?;
                Ok(raw.image())
            }
            Self::CompressedImageProtobuf => {
                let compressed =
                    CompressedImage::decode(message).map_err(|error| error.to_string())?;
                Ok(Image {
                    stamp: compressed.timestamp.unwrap_or_default().since_epoch(),
                    picture: decoded(&compressed.data).map(Pixels::from),
                })
            }
            Self::RawImageJson => {
                let raw: RawImageJson =
                    serde_json::from_slice(message).map_err(|error| fault(&error))?;
                let data = from_base64(&raw.data)?;
                Ok(Image {
                    stamp: raw.timestamp.since_epoch(),
                    picture: picture(&raw.encoding, raw.width, raw.height, raw.step, &data),
                })
            }
            Self::CompressedImageJson => {
                let compressed: CompressedImageJson =
                    serde_json::from_slice(message).map_err(|error| fault(&error))?;
                Ok(Image {
                    stamp: compressed.timestamp.since_epoch(),
                    picture: decoded(&from_base64(&compressed.data)?).map(Pixels::from),
                })
            }
        }
    }
}

/// `builtin_interfaces/msg/Time`, and a time in Foxglove's JSON.
#[derive(Deserialize)]
struct Stamp {
    sec: i32,
    #[serde(alias = "nsec")]
    nanosec: u32,
}

impl Stamp {
    fn since_epoch(&self) -> Duration {
        // No recording is from before the epoch.
        let seconds = u64::try_from(self.sec).unwrap_or_default();
        Duration::from_secs(seconds) + Duration::from_nanos(self.nanosec.into())
    }
}

/// `std_msgs/msg/Header`. ROS 2 writes messages field by field, in this order.
#[derive(Deserialize)]
struct Header {
    stamp: Stamp,
    #[serde(rename = "frame_id")]
    _frame_id: String,
}

#[derive(Deserialize)]
struct RosImage<'a> {
    header: Header,
    height: u32,
    width: u32,
    encoding: String,
    #[serde(rename = "is_bigendian")]
    _is_bigendian: u8,
    step: u32,
    data: &'a [u8],
}

#[derive(Deserialize)]
struct RosCompressedImage<'a> {
    header: Header,
    /// This field has many spellings; the data itself shows the format better.
    #[serde(rename = "format")]
    _format: String,
    data: &'a [u8],
}

/// A message in the OMG's Common Data Representation: four bytes that describe the representation, then the fields.
fn from_cdr<'a, T: Deserialize<'a>>(message: &'a [u8]) -> Result<T, String> {
    let Some((head, fields)) = message.split_at_checked(4) else {
        return Err(format!("a message of {} bytes", message.len()));
    };
    let read = match head[1] {
        0 => cdr_encoding::from_bytes::<T, BigEndian>(fields),
        1 => cdr_encoding::from_bytes::<T, LittleEndian>(fields),
        other => {
            return Err(format!(
                "a message in representation {other} of CDR, wanted 0 or 1"
            ));
        }
    };
    read.map(|(value, _)| value)
        .map_err(|error| format!("a message of {} bytes: {error}", message.len()))
}

/// `google.protobuf.Timestamp`.
#[derive(Clone, Copy, PartialEq, prost::Message)]
struct Timestamp {
    #[prost(int64, tag = "1")]
    seconds: i64,
    #[prost(int32, tag = "2")]
    nanos: i32,
}

impl Timestamp {
    fn since_epoch(self) -> Duration {
        let seconds = u64::try_from(self.seconds).unwrap_or_default();
        let nanos = u64::try_from(self.nanos).unwrap_or_default();
        Duration::from_secs(seconds).saturating_add(Duration::from_nanos(nanos))
    }
}

/// `foxglove.RawImage`; the frame of reference, tag 7, is skipped.
#[derive(Clone, PartialEq, prost::Message)]
struct RawImage {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(fixed32, tag = "2")]
    width: u32,
    #[prost(fixed32, tag = "3")]
    height: u32,
    #[prost(string, tag = "4")]
    encoding: String,
    #[prost(fixed32, tag = "5")]
    step: u32,
    #[prost(bytes = "vec", tag = "6")]
    data: Vec<u8>,
}

impl RawImage {
    fn image(&self) -> Image {
        Image {
            stamp: self.timestamp.unwrap_or_default().since_epoch(),
            picture: picture(
                &self.encoding,
                self.width,
                self.height,
                self.step,
                &self.data,
            ),
        }
    }
}

/// `foxglove.CompressedImage`; the format, tag 3, is recognised from the data.
#[derive(Clone, PartialEq, prost::Message)]
struct CompressedImage {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(bytes = "vec", tag = "2")]
    data: Vec<u8>,
}

#[derive(Deserialize)]
struct RawImageJson {
    timestamp: Stamp,
    width: u32,
    height: u32,
    encoding: String,
    step: u32,
    data: String,
}

#[derive(Deserialize)]
struct CompressedImageJson {
    timestamp: Stamp,
    data: String,
}

fn from_base64(text: &str) -> Result<Vec<u8>, String> {
    BASE64
        .decode(text)
        .map_err(|error| format!("data that is not base64: {error}"))
}

/// Red, green and blue of a pixel's bytes.
type Colour = fn(&[u8]) -> [u8; 3];

/// The picture in rows of pixels, with the names of encodings in ROS and Foxglove.
fn picture(
    encoding: &str,
    width: u32,
    height: u32,
    step: u32,
    data: &[u8],
) -> Result<Pixels, String> {
    if width == 0 || height == 0 || u64::from(width) * u64::from(height) > PIXELS_MAX {
        return Err(format!("{width}x{height} pixels"));
    }
    let layout = |format| Layout {
        format,
        width,
        height,
        stride: step,
    };
    let (channels, rgb): (usize, Colour) = match encoding.to_ascii_lowercase().as_str() {
        "rgb8" => return layout(PixelFormat::Rgb3).pixels(data),
        "bgr8" | "8uc3" => return layout(PixelFormat::Bgr3).pixels(data),
        "yuv422_yuy2" | "yuyv" => return layout(PixelFormat::Yuyv).pixels(data),
        "nv12" => return layout(PixelFormat::Nv12).pixels(data),
        "yuv422" | "uyvy" => {
            let pairs = data.chunks_exact(2).flat_map(|pair| [pair[1], pair[0]]);
            return layout(PixelFormat::Yuyv).pixels(&pairs.collect::<Vec<u8>>());
        }
        "mono8" | "8uc1" => (1, |pixel| [pixel[0]; 3]),
        "rgba8" => (4, |pixel| [pixel[0], pixel[1], pixel[2]]),
        "bgra8" | "8uc4" => (4, |pixel| [pixel[2], pixel[1], pixel[0]]),
        _ => {
            return Err(format!(
                "encoding {encoding:?}, wanted rgb8, bgr8, rgba8, bgra8, mono8, yuv422, yuv422_yuy2 or nv12"
            ));
        }
    };
    let row_bytes = channels * width as usize;
    let step = (step as usize).max(row_bytes);
    let wanted = step * (height as usize - 1) + row_bytes;
    if data.len() < wanted {
        return Err(format!("{} bytes of pixels, wanted {wanted}", data.len()));
    }
    let rows = data.chunks(step).take(height as usize);
    let pixels = rows.flat_map(|row| row[..row_bytes].chunks_exact(channels));
    Ok(Pixels::from(Picture {
        width,
        height,
        rgb: pixels.flat_map(rgb).collect(),
    }))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn pixels_by_the_names_of_their_encodings() {
        // Two rows of two pixels, with rows of 10 bytes: red and blue, then grey and black.
        let rows = |first: &[u8], second: &[u8]| {
            let padded = |row: &[u8]| [row, &[77; 10][row.len()..]].concat();
            [padded(first), padded(second)].concat()
        };
        let colours = [200, 10, 20, 30, 40, 220, 90, 90, 90, 0, 0, 0];
        for (encoding, data) in [
            ("rgb8", rows(&colours[..6], &colours[6..])),
            ("bgr8", rows(&[20, 10, 200, 220, 40, 30], &colours[6..])),
            (
                "RGBA8",
                rows(
                    &[200, 10, 20, 1, 30, 40, 220, 2],
                    &[90, 90, 90, 3, 0, 0, 0, 4],
                ),
            ),
            (
                "bgra8",
                rows(
                    &[20, 10, 200, 1, 220, 40, 30, 2],
                    &[90, 90, 90, 3, 0, 0, 0, 4],
                ),
            ),
        ] {
            let seen = picture(encoding, 2, 2, 10, &data).unwrap().picture();
            assert_eq!(seen.rgb, colours, "{encoding}");
            let short = picture(encoding, 2, 2, 10, &data[..12]).unwrap_err();
            assert!(short.contains("12 bytes"), "{short}");
        }
        let grey = picture("mono8", 2, 2, 10, &rows(&[1, 2], &[3, 4]))
            .unwrap()
            .picture();
        assert_eq!(grey.rgb, [1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4]);
        // White and black: luma first in YUYV, colour first in UYVY.
        let wanted = [255, 255, 255, 0, 0, 0];
        for (encoding, data) in [
            ("yuv422_yuy2", [235, 128, 16, 128]),
            ("yuyv", [235, 128, 16, 128]),
            ("yuv422", [128, 235, 128, 16]),
            ("uyvy", [128, 235, 128, 16]),
        ] {
            assert_eq!(
                picture(encoding, 2, 1, 4, &data).unwrap().picture().rgb,
                wanted,
                "{encoding}"
            );
        }
    }

    #[test]
    fn impossible_pictures_are_refused_before_they_cost_memory() {
        for encoding in ["rgb8", "mono8", "yuyv"] {
            assert!(picture(encoding, 0, 5, 0, &[0; 64]).is_err());
            assert!(picture(encoding, u32::MAX, u32::MAX, 0, &[0; 64]).is_err());
            assert!(picture(encoding, 5, 5, u32::MAX, &[0; 64]).is_err());
        }
        let unknown = picture("bayer_rggb8", 2, 2, 0, &[0; 64]).unwrap_err();
        assert!(
            unknown.contains("bayer_rggb8") && unknown.contains("rgb8"),
            "{unknown}"
        );
    }

    #[test]
    fn no_message_is_trusted() {
        for kind in [
            Kind::RosImage,
            Kind::RosCompressedImage,
            Kind::RawImageProtobuf,
            Kind::RawImageJson,
            Kind::CompressedImageProtobuf,
            Kind::CompressedImageJson,
        ] {
            // Lengths beyond the end, and beyond what 32 bits hold.
            for byte in [0x00, 0x01, 0x7f, 0xff] {
                for length in [0, 1, 3, 4, 5, 20, 64] {
                    let mut message = vec![byte; length];
                    let seen = kind.image(&message).map(|image| image.picture.is_err());
                    assert_ne!(seen, Ok(false), "{kind:?} {length} times {byte}");
                    if let Some(head) = message.get_mut(..4) {
                        head.copy_from_slice(&[0, 1, 0, 0]);
                        let seen = kind.image(&message).map(|image| image.picture.is_err());
                        assert_ne!(seen, Ok(false), "{kind:?} {length} times {byte}");
                    }
                }
            }
        }
    }
}
