//! Image files: a folder in name order, or one image.

use std::fs;
use std::path::{Path, PathBuf};

use super::compressed::decoded;
use super::names::name_order;
use super::pixels::Pixels;
use super::{Frame, FrameSource, Picture, PictureError, SourceError, time_of};

/// Frames a second of a folder of images, unless its name says otherwise.
pub const FOLDER_FPS: f64 = 10.0;

/// Whether the name ends like an image that can be read.
pub fn is_image(path: &Path) -> bool {
    let extension = path
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default();
    ["png", "jpg", "jpeg"]
        .iter()
        .any(|known| extension.eq_ignore_ascii_case(known))
}

pub struct ImageSource {
    paths: Vec<PathBuf>,
    fps: f64,
    next: usize,
}

impl ImageSource {
    pub fn single(path: &Path) -> Self {
        Self {
            paths: vec![path.to_owned()],
            fps: FOLDER_FPS,
            next: 0,
        }
    }

    pub fn folder(folder: &Path, fps: f64) -> Result<Self, SourceError> {
        let unreadable = |error| SourceError::Unreadable {
            path: folder.to_owned(),
            error,
        };
        let mut paths = Vec::new();
        for entry in fs::read_dir(folder).map_err(unreadable)? {
            let path = entry.map_err(unreadable)?.path();
            if is_image(&path) && path.is_file() {
                paths.push(path);
            }
        }
        if paths.is_empty() {
            return Err(SourceError::Empty(folder.to_owned()));
        }
        paths.sort_by_cached_key(|path| {
            name_order(&path.file_name().unwrap_or_default().to_string_lossy())
        });
        Ok(Self {
            paths,
            fps,
            next: 0,
        })
    }
}

impl FrameSource for ImageSource {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let Some(path) = self.paths.get(self.next) else {
            return Ok(None);
        };
        let sequence = self.next as u64;
        self.next += 1;
        let picture = read(path).map(Pixels::from).map_err(|found| PictureError {
            path: path.clone(),
            found,
            wanted: "a whole PNG or JPEG image",
        });
        Ok(Some(Frame {
            sequence,
            captured_at: time_of(sequence, self.fps),
            picture,
        }))
    }

    fn frame_count(&self) -> Option<u64> {
        Some(self.paths.len() as u64)
    }
}

fn read(path: &Path) -> Result<Picture, String> {
    decoded(&fs::read(path).map_err(|error| error.to_string())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_ordered_by_their_numbers() {
        let mut names = [
            "b_10.png",
            "b_9.png",
            "b_09.png",
            "a_100.png",
            "b_9_2.png",
            "b_9_10.png",
            "b_0.png",
            "b.png",
        ];
        names.sort_by_cached_key(|name| name_order(name));
        assert_eq!(
            names,
            [
                "a_100.png",
                "b.png",
                "b_0.png",
                "b_09.png",
                "b_9.png",
                "b_9_2.png",
                "b_9_10.png",
                "b_10.png"
            ]
        );
    }
}
