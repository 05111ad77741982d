//! MCAP recordings: the images of one topic in the order of time, from one file or from the parts of a split recording.

mod bayer;
mod clock;
mod compression;
mod contents;
mod encodings;
mod message;
mod order;
mod records;

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::name_order::name_order;
use super::{Frame, FrameSource, PictureError, SourceError};
use clock::Clock;
use contents::{Contents, all_topics, chosen};
use encodings::NoPicture;
use message::UNDERSTOOD;
use order::InOrder;

/// The file in the folder of a ROS 2 recording that names its parts; longer ones are not read to their end.
const METADATA: &str = "metadata.yaml";
const METADATA_MAX: u64 = 1_000_000;
/// Ends of the names of recordings, also of those that are compressed as a whole.
const ENDS: [&str; 3] = [".mcap", ".mcap.zst", ".mcap.zstd"];
/// First bytes of other recordings, and what can be done with them.
const OTHERS: [(&[u8], &str); 2] = [
    (
        b"SQLite format 3\0",
        "a recording of ROS 2 in SQLite; ros2 bag convert makes an MCAP recording of it",
    ),
    (
        b"#ROSBAG V2.0",
        "a recording of ROS 1; rosbags-convert makes an MCAP recording of ROS 2 of it",
    ),
];

fn ends_like_a_recording(path: &Path) -> bool {
    let name = path
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .to_ascii_lowercase();
    ENDS.iter().any(|end| name.ends_with(end))
}

/// Whether a file begins like a recording, or has the name of a recording.
pub fn is_recording(path: &Path) -> bool {
    ends_like_a_recording(path) || records::begins_like_a_recording(path) || other(path).is_some()
}

/// What can be done with a recording of another kind.
fn other(path: &Path) -> Option<&'static str> {
    let name = path
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .to_ascii_lowercase();
    if name.contains(".mcap.") && !ends_like_a_recording(path) {
        return Some("compressed in a way that is not read here; it must be unpacked first");
    }
    let mut head = Vec::new();
    let mut file = File::open(path).ok()?.take(16);
    file.read_to_end(&mut head).ok()?;
    let known = OTHERS.iter().find(|(magic, _)| head.starts_with(magic));
    known.map(|&(_, what)| what)
}

/// The parts of a recording in a folder, in the order of their names; none if there are no recordings in it.
///
/// # Errors
/// When the folder cannot be read, or a part is missing.
pub fn parts(folder: &Path) -> Result<Vec<PathBuf>, SourceError> {
    let unreadable = |error| SourceError::Unreadable {
        path: folder.to_owned(),
        error,
    };
    let mut parts = Vec::new();
    for entry in fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let is_part = ends_like_a_recording(&path) || name.ends_with(".db3");
        if is_part && !name.starts_with('.') && path.is_file() {
            parts.push(path);
        }
    }
    parts.sort_by_cached_key(|path| {
        name_order(&path.file_name().unwrap_or_default().to_string_lossy())
    });
    if !parts.is_empty()
        && let Some(name) = missing(folder, &parts)
    {
        return Err(SourceError::Recording {
            path: folder.to_owned(),
            why: format!("{METADATA} names {name}, which is not in this folder"),
        });
    }
    Ok(parts)
}

/// A file that the folder's list of parts names, and that is not there. A part may have been compressed or unpacked
/// since.
fn missing(folder: &Path, parts: &[PathBuf]) -> Option<String> {
    let mut list = String::new();
    let file = File::open(folder.join(METADATA)).ok()?;
    file.take(METADATA_MAX).read_to_string(&mut list).ok()?;
    let plain = |name: &str| name.split_once(".mcap").map(|(stem, _)| stem.to_owned());
    let there: BTreeSet<String> = parts
        .iter()
        .filter_map(|path| plain(&path.file_name()?.to_string_lossy()))
        .collect();
    let words = list.split(|c: char| c.is_whitespace() || "[],\"'".contains(c));
    let named = words.filter_map(|word| word.rsplit('/').next());
    let mut named = named.filter(|name| ends_like_a_recording(Path::new(name)));
    named
        .find(|name| plain(name).is_some_and(|stem| !there.contains(&stem)))
        .map(str::to_owned)
}

/// Images of one topic.
pub struct RecordingSource {
    path: PathBuf,
    topic: String,
    messages: InOrder,
    count: Option<u64>,
    /// The first image; it has been read to see whether this topic can be read at all.
    first: Option<Frame>,
    next: u64,
    clock: Clock,
}

impl RecordingSource {
    /// Opens the only topic with images of a recording, or the topic that is asked for.
    pub fn open(path: &Path, topic: Option<&str>) -> Result<Self, SourceError> {
        Self::of_parts(path, &[path.to_owned()], topic)
    }

    /// The same of a recording that consists of several files, which `path` stands for.
    pub fn of_parts(
        path: &Path,
        parts: &[PathBuf],
        topic: Option<&str>,
    ) -> Result<Self, SourceError> {
        let fail = |path: &Path, why: String| SourceError::Recording {
            path: path.to_owned(),
            why,
        };
        let mut files = Vec::new();
        for part in parts {
            if let Some(what) = other(part) {
                return Err(fail(part, what.to_owned()));
            }
            files.push(Contents::of(part).map_err(|why| fail(part, why))?);
        }
        let topics = all_topics(&files);
        let topic = chosen(&topics, topic).map_err(|why| fail(path, why))?;
        let mut source = Self {
            path: path.to_owned(),
            count: topics[&topic].messages,
            messages: InOrder::new(files, &topic),
            topic,
            first: None,
            next: 0,
            clock: Clock::default(),
        };
        let Some((frame, foreign)) = source.read()? else {
            return Err(fail(path, format!("no message on topic {}", source.topic)));
        };
        if let Some(what) = foreign {
            return Err(fail(path, format!("topic {} holds {what}", source.topic)));
        }
        source.first = Some(frame);
        Ok(source)
    }

    /// The next image; the second value says what it is if it is not what is read here.
    fn read(&mut self) -> Result<Option<(Frame, Option<String>)>, SourceError> {
        let message = self.messages.next();
        let message = message.map_err(|why| SourceError::Recording {
            path: self.path.clone(),
            why: format!(
                "broke off after {} images of {}: {why}",
                self.next, self.topic
            ),
        })?;
        let Some(message) = message else {
            self.check_count();
            return Ok(None);
        };
        let read = message.kind.map_or_else(
            || {
                Err(format!(
                    "a message that is not an image, wanted {UNDERSTOOD}"
                ))
            },
            |kind| kind.image(&message.data),
        );
        let stamp = read.as_ref().ok().map(|image| image.stamp);
        let captured_at = self
            .clock
            .place(Duration::from_nanos(message.log_time), stamp);
        let sequence = self.next;
        self.next += 1;
        let picture = read
            .map_err(NoPicture::from)
            .and_then(|image| image.picture);
        let foreign = match &picture {
            Err(NoPicture::Foreign(what)) => Some(what.clone()),
            _ => None,
        };
        let picture = picture.map_err(|found| PictureError {
            path: self.path.clone(),
            found: format!("{} {sequence}: {found}", self.topic),
            wanted: "a whole image",
        });
        let frame = Frame {
            sequence,
            captured_at,
            picture,
        };
        Ok(Some((frame, foreign)))
    }

    fn check_count(&self) {
        if let Some(count) = self
            .count
            .filter(|&count| count != self.next && self.next > 0)
        {
            log::warn!(
                "{}: {} images of {} were read, and the summary counts {count}",
                self.path.display(),
                self.next,
                self.topic
            );
        }
    }
}

impl FrameSource for RecordingSource {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        if let Some(first) = self.first.take() {
            return Ok(Some(first));
        }
        Ok(self.read()?.map(|(frame, _)| frame))
    }

    fn frame_count(&self) -> Option<u64> {
        self.count
    }

    fn began_at(&self) -> Option<Duration> {
        self.clock.began_at()
    }
}
