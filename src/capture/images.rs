//! Image files: a folder in the order of names, or one image.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::compressed::decoded;
use super::name_order::NameOrder;
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
    ["png", "jpg", "jpeg", "jpe", "jfif"]
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

    /// The images in a folder; hidden files are left out, as every tool does.
    pub fn folder(folder: &Path, fps: f64) -> Result<Self, SourceError> {
        let unreadable = |error| SourceError::Unreadable {
            path: folder.to_owned(),
            error,
        };
        let mut images = Vec::new();
        let mut folders = Vec::new();
        let mut others = BTreeMap::new();
        for entry in fs::read_dir(folder).map_err(unreadable)? {
            let path = entry.map_err(unreadable)?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if name.starts_with('.') {
                continue;
            }
            if path.is_dir() {
                folders.push(name.into_owned());
            } else if is_image(&path) && path.is_file() {
                let stem = path.file_stem().unwrap_or_default().to_string_lossy();
                images.push((stem.into_owned(), path));
            } else if let Some(kind) = path.extension() {
                *others
                    .entry(kind.to_string_lossy().into_owned())
                    .or_insert(0) += 1;
            }
        }
        if images.is_empty() {
            return Err(SourceError::Empty {
                path: folder.to_owned(),
                holds: holds(folders, &others),
            });
        }
        let order = NameOrder::of(images.iter().map(|(stem, _)| stem.as_str()));
        images.sort_by_cached_key(|(stem, path)| (order.key(stem), path.clone()));
        if let Some(kinds) = kinds_in_turn(images.iter().map(|(stem, _)| stem.as_str())) {
            log::warn!(
                "{}: images of {} kinds take turns ({}) and are read as one drive; give each kind a folder of its own",
                folder.display(),
                kinds.len(),
                kinds.join(", ")
            );
        }
        let paths = images.into_iter().map(|(_, path)| path).collect();
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

/// Largest number of cameras, or kinds of pictures, that are looked for.
const KINDS_MAX: usize = 8;

/// The first of each kind, if names of some kinds take turns in their order, as `0_depth`, `0_rgb`, `1_depth`, `1_rgb`.
fn kinds_in_turn<'a>(sorted: impl Iterator<Item = &'a str>) -> Option<Vec<&'a str>> {
    let names: Vec<&str> = sorted.collect();
    let kind = |name: &str| name.replace(|digit: char| digit.is_ascii_digit(), "");
    let kinds: Vec<String> = names.iter().map(|name| kind(name)).collect();
    let again = kinds.iter().skip(1).position(|of| *of == kinds[0])? + 1;
    let in_turn = kinds.len().is_multiple_of(again)
        && kinds
            .iter()
            .zip(kinds.iter().skip(again))
            .all(|(a, b)| a == b);
    ((2..=KINDS_MAX).contains(&again) && in_turn).then(|| names[..again].to_vec())
}

/// What is in a folder without images: a folder inside it, or its largest kind of files.
fn holds(mut folders: Vec<String>, others: &BTreeMap<String, u32>) -> String {
    folders.sort_unstable();
    let most = others.iter().max_by_key(|(_, count)| **count);
    match (folders.first(), most) {
        (Some(folder), _) => format!("it holds the folder {folder}; name the folder of the images"),
        (None, Some((kind, count))) => {
            format!(
                "it holds {count} files .{kind}; convert images to PNG, for example with ffmpeg"
            )
        }
        (None, None) => "it is empty".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn kinds_of_images_that_take_turns_are_noticed() {
        let kinds = |names: &[&str]| kinds_in_turn(names.iter().copied()).map(|kinds| kinds.len());
        assert_eq!(kinds(&["0_depth", "0_rgb", "1_depth", "1_rgb"]), Some(2));
        assert_eq!(kinds(&["a1", "b1", "c1", "a2", "b2", "c2"]), Some(3));
        for one in [
            &["1", "2", "10"][..],
            &["town1_1", "town1_2"],
            &["a1", "b1"],
            &["a1", "b1", "a2"],
            &[],
        ] {
            assert_eq!(kinds(one), None, "{one:?}");
        }
    }

    #[test]
    fn hidden_and_foreign_files_are_left_out_and_a_folder_without_images_says_what_it_holds() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str| fs::write(folder.path().join(name), "no picture").unwrap();
        let said = || {
            let opened = ImageSource::folder(folder.path(), 10.0);
            opened
                .map(|source| source.paths)
                .map_err(|error| error.to_string())
        };
        assert!(said().unwrap_err().ends_with("it is empty"));
        put("._a.png");
        put(".hidden.jpg");
        put("a.bmp");
        put("b.bmp");
        put("notes.txt");
        assert!(said().unwrap_err().contains("2 files .bmp"));
        fs::create_dir(folder.path().join("cam0.png")).unwrap();
        assert!(said().unwrap_err().contains("the folder cam0.png"));
        for name in ["10.JPG", "9.jfif", "8.jpe", "7.PNG"] {
            put(name);
        }
        let names = ["7.PNG", "8.jpe", "9.jfif", "10.JPG"];
        assert_eq!(said().unwrap(), names.map(|name| folder.path().join(name)));
    }
}
