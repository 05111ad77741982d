//! Reads events. Nothing in them is trusted: names must stay inside their folder, and the size of files is limited.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::event::{EVENT_FILE, Event};
use super::folder::Content;
use crate::files::json_fault::fault;

/// Largest file that is read.
const FILE_MAX: u64 = 16 << 20;

/// Evidence that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("evidence {}: {found}; wanted {wanted}", path.display())]
pub struct ReadError {
    path: PathBuf,
    found: String,
    wanted: &'static str,
}

/// The events of a folder with their folders, the oldest first. What is not an event is skipped.
///
/// # Errors
/// When the folder or an event cannot be read.
pub fn read(folder: &Path) -> Result<Vec<(PathBuf, Event)>, ReadError> {
    let wanted = "a folder written by --evidence";
    let refused = |path: &Path, found: String| ReadError {
        path: path.to_owned(),
        found,
        wanted,
    };
    let content = Content::of(folder).map_err(|error| refused(folder, error.to_string()))?;
    let events = content.events.into_iter().map(|event| {
        let folder = folder.join(event.name());
        let path = folder.join(EVENT_FILE);
        let event: Event = bytes(&path)
            .map_err(|error| error.to_string())
            .and_then(|bytes| serde_json::from_slice(&bytes).map_err(|error| fault(&error)))
            .map_err(|why| refused(&path, why))?;
        if event.edge >= event.moments.len() {
            return Err(refused(&path, format!("edge {}", event.edge)));
        }
        let mut profiles = event.moments.iter().flat_map(|moment| &moment.profiles);
        if let Some(broken) = profiles.find(|profile| !profile.is_whole()) {
            let found = format!("numbers of {} that do not belong together", broken.tap);
            return Err(refused(&path, found));
        }
        Ok((folder, event))
    });
    events.collect()
}

/// A JPEG file of an event.
///
/// # Errors
/// When it is not a JPEG file, or when its name leads out of the folder.
pub fn picture(folder: &Path, name: &str) -> Result<Vec<u8>, ReadError> {
    let path = folder.join(name);
    let refused = |found: String| ReadError {
        path: path.clone(),
        found,
        wanted: "a JPEG image inside the event's folder",
    };
    if Path::new(name).file_name() != Some(name.as_ref()) {
        return Err(refused("a name that is not the name of a file".to_owned()));
    }
    let bytes = bytes(&path).map_err(|error| refused(error.to_string()))?;
    if !bytes.starts_with(&[0xff, 0xd8, 0xff]) {
        return Err(refused("other bytes".to_owned()));
    }
    Ok(bytes)
}

fn bytes(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?
        .take(FILE_MAX + 1)
        .read_to_end(&mut bytes)?;
    if bytes.len() as u64 > FILE_MAX {
        return Err(std::io::Error::other(format!("more than {FILE_MAX} bytes")));
    }
    Ok(bytes)
}
