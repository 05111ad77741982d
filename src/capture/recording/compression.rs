//! What is compressed with zstd: whole files and single messages.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

use zstd::stream::read::Decoder;

/// First bytes of what is compressed with zstd.
pub const ZSTD_MAGIC: &[u8] = b"\x28\xB5\x2F\xFD";
/// Longest record, bytes: the largest picture with three bytes for each pixel in base64, and its other fields.
pub const RECORD_MAX: usize = 140_000_000;

/// Whether a file is compressed as a whole.
pub fn is_compressed(path: &Path) -> bool {
    let mut head = [0; ZSTD_MAGIC.len()];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut head));
    read.is_ok() && head == ZSTD_MAGIC
}

/// The bytes of a file, without its compression.
pub fn uncompressed(path: &Path) -> io::Result<Box<dyn Read + Send>> {
    let file = File::open(path)?;
    Ok(match is_compressed(path) {
        true => Box::new(BufReader::new(Decoder::new(file)?)),
        false => Box::new(BufReader::new(file)),
    })
}

/// A message without its compression with zstd.
pub fn unpacked(message: &[u8]) -> Result<Vec<u8>, String> {
    let fail = |error: io::Error| format!("a message compressed with zstd: {error}");
    let limit = u64::try_from(RECORD_MAX).unwrap_or(u64::MAX);
    let mut plain = Vec::new();
    Decoder::with_buffer(message)
        .and_then(|decoder| decoder.take(limit + 1).read_to_end(&mut plain))
        .map_err(fail)?;
    match plain.len() > RECORD_MAX {
        true => Err(format!("a message of more than {RECORD_MAX} bytes")),
        false => Ok(plain),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_message_that_unpacks_to_more_than_a_record_is_refused() {
        let zeros = vec![0; RECORD_MAX + 1];
        let packed = zstd::stream::encode_all(&zeros[..], 1).unwrap();
        assert!(packed.len() < 100_000);
        assert!(unpacked(&packed).unwrap_err().contains("more than"));
        let packed = zstd::stream::encode_all(&zeros[..1_000], 1).unwrap();
        assert_eq!(unpacked(&packed).unwrap(), zeros[..1_000]);
        assert!(unpacked(&packed[..packed.len() - 1]).is_err());
    }
}
