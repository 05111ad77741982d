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

use super::compression::{ZSTD_MAGIC, unpacked};
use super::encodings::{NoPicture, Raw};
use crate::capture::compressed::decoded;
use crate::capture::pixels::Pixels;
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
    pub picture: Result<Pixels, NoPicture>,
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
        // The recorder of ROS 2 can compress every message by itself.
        if message.starts_with(ZSTD_MAGIC) {
            return self.plain_image(&unpacked(message)?);
        }
        self.plain_image(message)
    }

    fn plain_image(self, message: &[u8]) -> Result<Image, String> {
        match self {
            Self::RosImage => {
                let raw: RosImage<'_> = from_cdr(message)?;
                let pixels = Raw {
                    encoding: &raw.encoding,
                    width: raw.width,
                    height: raw.height,
                    step: raw.step,
                    is_bigendian: raw.is_bigendian != 0,
                    data: raw.data,
                };
                Ok(Image {
                    stamp: raw.header.stamp.since_epoch(),
                    picture: pixels.pixels(),
                })
            }
            Self::RosCompressedImage => {
                let compressed: RosCompressedImage<'_> = from_cdr(message)?;
                Ok(Image {
                    stamp: compressed.header.stamp.since_epoch(),
                    picture: uncompressed(&compressed.format, compressed.data),
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
                    picture: uncompressed(&compressed.format, &compressed.data),
                })
            }
            Self::RawImageJson => {
                let raw: RawImageJson =
                    serde_json::from_slice(message).map_err(|error| fault(&error))?;
                let pixels = Raw {
                    encoding: &raw.encoding,
                    width: raw.width,
                    height: raw.height,
                    step: raw.step,
                    is_bigendian: false,
                    data: &from_base64(&raw.data)?,
                };
                Ok(Image {
                    stamp: raw.timestamp.since_epoch(),
                    picture: pixels.pixels(),
                })
            }
            Self::CompressedImageJson => {
                let compressed: CompressedImageJson =
                    serde_json::from_slice(message).map_err(|error| fault(&error))?;
                Ok(Image {
                    stamp: compressed.timestamp.since_epoch(),
                    picture: uncompressed(&compressed.format, &from_base64(&compressed.data)?),
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
    is_bigendian: u8,
    step: u32,
    data: &'a [u8],
}

#[derive(Deserialize)]
struct RosCompressedImage<'a> {
    header: Header,
    format: String,
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
            picture: Raw {
                encoding: &self.encoding,
                width: self.width,
                height: self.height,
                step: self.step,
                is_bigendian: false,
                data: &self.data,
            }
            .pixels(),
        }
    }
}

/// `foxglove.CompressedImage`.
#[derive(Clone, PartialEq, prost::Message)]
struct CompressedImage {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(bytes = "vec", tag = "2")]
    data: Vec<u8>,
    #[prost(string, tag = "3")]
    format: String,
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
    #[serde(default)]
    format: String,
}

/// The picture in a compressed image. Its format has many spellings, and the data shows better what it is; the format
/// only says what data is that shows neither JPEG nor PNG.
fn uncompressed(format: &str, data: &[u8]) -> Result<Pixels, NoPicture> {
    let name = format.to_ascii_lowercase();
    if name.contains("compresseddepth") {
        return Err(NoPicture::Foreign(format!(
            "distances ({format:?}), wanted pictures"
        )));
    }
    let begins = |magic: &[u8]| data.starts_with(magic);
    let known = begins(b"\xFF\xD8") || begins(b"\x89PNG");
    let named = ["jpeg", "jpg", "png"]
        .iter()
        .any(|known| name.contains(known));
    if !known && !named && !name.trim().is_empty() {
        return Err(NoPicture::Foreign(format!(
            "images in format {format:?}, wanted jpeg or png"
        )));
    }
    Ok(decoded(data).map(Pixels::from)?)
}

fn from_base64(text: &str) -> Result<Vec<u8>, String> {
    BASE64
        .decode(text)
        .map_err(|error| format!("data that is not base64: {error}"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

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
