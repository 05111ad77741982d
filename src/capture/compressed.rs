//! Pictures as PNG or JPEG.

mod jpeg;
mod png;
mod segments;
mod surplus;

use image::ImageFormat;

use super::Picture;

pub use jpeg::encoded as jpeg;

/// Decodes a PNG or JPEG image and turns it upright, or returns what is wrong with it.
pub fn decoded(bytes: &[u8]) -> Result<Picture, String> {
    match image::guess_format(bytes) {
        Ok(ImageFormat::Jpeg) => jpeg::decoded(bytes, None),
        Ok(ImageFormat::Png) => png::decoded(bytes),
        Ok(other) => Err(format!("a {other:?} image")),
        Err(_) => Err(format!("{} bytes that are not an image", bytes.len())),
    }
}

/// Decodes a JPEG image of this size. An image of another size is not decoded.
pub fn decoded_jpeg(bytes: &[u8], size: (u32, u32)) -> Result<Picture, String> {
    jpeg::decoded(bytes, Some(size))
        .map_err(|error| format!("a buffer of {} bytes: {error}", bytes.len()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::fs;
    use std::path::Path;

    use super::*;

    /// A picture with something in every block, and its file.
    fn drawn() -> (Picture, Vec<u8>) {
        let (width, height) = (64, 48);
        let byte = |n: u32| n.to_le_bytes()[0];
        let pixels = (0..width * height).map(|n| (n % width, n / width));
        let rgb = pixels.flat_map(|(x, y)| [byte(3 * x), byte(x * y), byte(5 * y)]);
        let rgb = rgb.collect();
        let picture = Picture { width, height, rgb };
        let file = jpeg(&picture).unwrap();
        (decoded(&file).unwrap(), file)
    }

    #[test]
    fn what_stands_behind_a_picture_or_is_missing_there_changes_nothing() {
        let (picture, file) = drawn();
        let end = file.len() - 2;
        let without_end = file[..end].to_vec();
        for given in [
            without_end.clone(),
            [&file, &[0; 512][..]].concat(),
            [file.as_slice(), &file].concat(),
            [&without_end, &[0xFF; 3][..], &file[end..]].concat(),
            [&without_end, &[0; 60][..], &file[end..]].concat(),
        ] {
            assert_eq!(decoded(&given).unwrap(), picture);
        }
    }

    #[test]
    fn a_picture_of_which_something_is_missing_is_refused() {
        let (_, file) = drawn();
        for length in (2..file.len() - 4).step_by(97) {
            let why = decoded(&file[..length]).unwrap_err();
            assert!(
                why.contains("cut off") || why.contains("not an image"),
                "{why}"
            );
        }
        let middle = file.len() / 2;
        let lost = [&file[..middle], &file[middle + 500..]].concat();
        let why = decoded(&lost).unwrap_err();
        assert!(why.contains("damaged"), "{why}");
    }

    #[test]
    fn pictures_are_turned_upright() {
        let (picture, file) = drawn();
        for (orientation, corner, size) in [
            (1, (0, 0), (64, 48)),
            (2, (63, 0), (64, 48)),
            (3, (63, 47), (64, 48)),
            (4, (0, 47), (64, 48)),
            (5, (0, 0), (48, 64)),
            (6, (47, 0), (48, 64)),
            (7, (47, 63), (48, 64)),
            (8, (0, 63), (48, 64)),
            (9, (0, 0), (64, 48)),
        ] {
            let exif = [
                b"\xFF\xE1\x00\x22Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0",
                &[orientation, 0, 0, 0, 0, 0, 0, 0][..],
            ];
            let turned = [&file[..2], &exif.concat(), &file[2..]].concat();
            let turned = decoded(&turned).unwrap();
            assert_eq!((turned.width, turned.height), size, "{orientation}");
            let at = 3 * (corner.1 * size.0 + corner.0) as usize;
            assert_eq!(turned.rgb[at..at + 3], picture.rgb[..3], "{orientation}");
        }
    }

    #[test]
    fn every_process_of_libjpeg_is_read() {
        let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/seeds");
        let read = |name: &str| decoded(&fs::read(seeds.join(name)).unwrap()).unwrap();
        let scans = read("scans.jpg");
        assert_eq!((scans.width, scans.height), (24, 16));
        for name in ["progressive.jpg", "arithmetic.jpg"] {
            assert_eq!(read(name), scans, "{name}");
        }
        // Restarts are coded from the same coefficients; the inks of the other file are not.
        assert_eq!(read("surplus-before-restarts.jpg"), scans);
        assert_eq!(read("four-components.jpg").rgb.len(), scans.rgb.len());
    }

    #[test]
    fn a_colour_profile_is_not_read() {
        let (picture, _) = drawn();
        let mut file = Vec::new();
        let of_png = image::codecs::png::PngEncoder::new(&mut file);
        let (width, height) = (picture.width, picture.height);
        let colour = image::ExtendedColorType::Rgb8;
        image::ImageEncoder::write_image(of_png, &picture.rgb, width, height, colour).unwrap();
        assert_eq!(decoded(&file).unwrap(), picture);
        let behind_header = 8 + 12 + 13;
        let profile = [&1_000_u32.to_be_bytes()[..], b"iCCP", &[0x78; 1_004]].concat();
        for profiles in [1, 100] {
            let given = [
                &file[..behind_header],
                &profile.repeat(profiles),
                &file[behind_header..],
            ];
            assert_eq!(decoded(&given.concat()).unwrap(), picture);
        }
    }

    #[test]
    fn scans_without_end_are_refused_before_they_are_decoded() {
        let seed = "tests/fuzz/seeds/progressive.jpg";
        let file = fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join(seed)).unwrap();
        let mut pairs = file.windows(2);
        let last = pairs.rposition(|pair| pair == [0xFF, 0xDA]).unwrap();
        let again = &file[last..file.len() - 2];
        let given = [&file[..last], &again.repeat(40), &file[file.len() - 2..]].concat();
        let why = decoded(&given).unwrap_err();
        assert!(why.contains("more than 20 scans"), "{why}");
    }

    #[test]
    fn sizes_that_are_too_large_are_refused_before_they_are_decoded() {
        let (_, mut file) = drawn();
        let frame = file
            .windows(2)
            .position(|pair| pair == [0xFF, 0xC0])
            .unwrap();
        file[frame + 5..frame + 9].copy_from_slice(&[0xFF; 4]);
        assert!(decoded(&file).unwrap_err().contains("65535x65535"));
        file[frame + 5..frame + 9].copy_from_slice(&[0; 4]);
        assert!(decoded(&file).is_err());
    }
}
