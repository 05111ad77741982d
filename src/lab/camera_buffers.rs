//! Rendered pictures → the buffers that a camera would give for them.

use std::io;

use crate::capture::pixels::{Layout, PixelFormat};
use crate::capture::{Picture, jpeg};

/// A buffer with its layout.
///
/// # Errors
/// When a picture cannot be encoded as a JPEG image.
pub fn buffer_of(picture: &Picture, format: PixelFormat) -> io::Result<(Layout, Vec<u8>)> {
    let layout = Layout {
        format,
        width: picture.width,
        height: picture.height,
        stride: 0,
    };
    let bytes = match format {
        PixelFormat::Rgb3 => picture.rgb.clone(),
        PixelFormat::Bgr3 => {
            let pixels = picture.rgb.chunks_exact(3);
            pixels.flat_map(|rgb| [rgb[2], rgb[1], rgb[0]]).collect()
        }
        PixelFormat::Yuyv => rows(picture).flat_map(yuyv).collect(),
        PixelFormat::Nv12 => {
            let luma = picture.rgb.chunks_exact(3).map(|rgb| yuv(rgb)[0]);
            let colour_rows = rows(picture).step_by(2);
            let colour = colour_rows.flat_map(|row| {
                let pairs = yuyv(row);
                pairs
                    .chunks_exact(4)
                    .flat_map(|p| [p[1], p[3]])
                    .collect::<Vec<u8>>()
            });
            luma.chain(colour).collect()
        }
        PixelFormat::Mjpg => jpeg(picture)?,
    };
    Ok((layout, bytes))
}

fn rows(picture: &Picture) -> impl Iterator<Item = &[u8]> {
    picture
        .rgb
        .chunks_exact(3 * (picture.width as usize).max(1))
}

/// Two neighbouring pixels share the colour of the left one.
fn yuyv(row: &[u8]) -> Vec<u8> {
    let pixels: Vec<[u8; 3]> = row.chunks_exact(3).map(yuv).collect();
    let pairs = pixels.chunks(2);
    pairs
        .flat_map(|pair| {
            let [left, right] = [pair[0], pair[pair.len() - 1]];
            [left[0], left[1], right[0], left[2]]
        })
        .collect()
}

/// Luma and colour, BT.601 with limited range.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn yuv(rgb: &[u8]) -> [u8; 3] {
    let [r, g, b] = [rgb[0], rgb[1], rgb[2]].map(f64::from);
    let luma = 0.299 * r + 0.587 * g + 0.114 * b;
    let byte = |value: f64| value.round().clamp(0.0, 255.0) as u8;
    let colour = |away: f64, widest: f64| byte(128.0 + away * 112.0 / 255.0 / widest);
    [
        byte(16.0 + luma * 219.0 / 255.0),
        colour(b - luma, 0.886),
        colour(r - luma, 0.701),
    ]
}
