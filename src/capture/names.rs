//! Names of drives: names that mean many drives, the order of drives, and whether the files of a drive have changed.

use std::fs;
use std::io::ErrorKind;
use std::path::Path;
use std::time::UNIX_EPOCH;

use sha2::{Digest, Sha256};

use super::frame::SourceError;
use super::name_order::name_order;

/// Largest number of drives that one name may mean.
const DRIVES_MAX: u64 = 10_000;
/// The same, as a count.
const RANGE_MAX: usize = 10_000;

/// The name of a camera with its prefix, if a device is named without it; `None` for any other source.
pub fn camera_of(source: &str) -> Option<String> {
    source
        .starts_with("/dev/video")
        .then(|| format!("v4l2:{source}"))
}

/// The name of a file or folder, with the options that may follow it.
pub struct FileName<'a> {
    pub path: &'a Path,
    pub fps: Option<f64>,
    pub topic: Option<&'a str>,
    /// Options of the conditions that are rendered over the pictures.
    pub overlay: Vec<&'a str>,
}

/// The options.
const OPTIONS: [&str; 4] = ["fps=", "topic=", "condition=", "seed="];

/// The sources of this build, for messages.
pub const SOURCES_WANTED: &str = if cfg!(feature = "lab") {
    "wanted scene:…, random:…, a folder, an image, a recording or a video"
} else {
    "wanted random:…, a folder, an image or a video"
};

/// Splits `PATH?OPTION&OPTION`; a path that exists as typed is not split. Refuses what cannot be a file: an empty name,
/// and cameras.
pub fn file_name(name: &str) -> Result<FileName<'_>, SourceError> {
    let camera = camera_of(name).or_else(|| name.starts_with("v4l2:").then(|| name.to_owned()));
    if camera.is_some() || name.is_empty() {
        let watched = |camera| {
            format!(
                "a camera is watched by gapwatch monitor, with source = {camera:?} in [camera] of a board file; {SOURCES_WANTED}"
            )
        };
        return Err(SourceError::Name {
            found: name.to_owned(),
            wanted: camera.map_or_else(|| SOURCES_WANTED.to_owned(), watched),
        });
    }
    let wrong = |wanted: &str| SourceError::Name {
        found: name.to_owned(),
        wanted: wanted.to_owned(),
    };
    let (path, options) = if Path::new(name).exists() {
        (name, None)
    } else {
        split_options(name)
    };
    let mut file = FileName {
        path: Path::new(path),
        fps: None,
        topic: None,
        overlay: vec![],
    };
    for option in options.into_iter().flat_map(|options| options.split('&')) {
        match option.split_once('=') {
            Some(("fps", number)) => {
                let number = number.parse().ok();
                let number = number.filter(|fps| (0.1..=240.0).contains(fps));
                file.fps = Some(number.ok_or_else(|| wrong("wanted ?fps= from 0.1 to 240"))?);
            }
            Some(("topic", topic)) => file.topic = Some(topic),
            Some(("condition" | "seed", _)) => file.overlay.push(option),
            _ => {
                return Err(wrong(
                    "wanted fps=, topic=, condition= or seed=, with & between them",
                ));
            }
        }
    }
    Ok(file)
}

/// The path, and what follows the first `?` that begins an option.
fn split_options(name: &str) -> (&str, Option<&str>) {
    name.match_indices('?')
        .map(|(at, _)| (&name[..at], &name[at + 1..]))
        .find(|(_, rest)| OPTIONS.iter().any(|option| rest.starts_with(option)))
        .map_or((name, None), |(path, options)| (path, Some(options)))
}

/// The drives that a name means: one drive, or one for each seed of `scene:…seed=A..B…`, with both ends.
///
/// # Errors
/// When the range is empty or too long.
pub fn drives(name: &str) -> Result<Vec<String>, SourceError> {
    let Some((before, seeds, after)) = seed_in(name).filter(|(_, seeds, _)| seeds.contains(".."))
    else {
        return Ok(vec![name.to_owned()]);
    };
    let range = seeds
        .split_once("..")
        .and_then(|(from, to)| Some((from.parse::<u64>().ok()?, to.parse::<u64>().ok()?)));
    match range {
        Some((from, to)) if from <= to && to - from < DRIVES_MAX => Ok((from..=to)
            .map(|seed| format!("{before}{seed}{after}"))
            .collect()),
        _ => Err(SourceError::Name {
            found: name.to_owned(),
            wanted: format!("wanted seed=A..B with A not above B and at most {DRIVES_MAX} seeds"),
        }),
    }
}

/// The text before, in and after the seed of a rendered drive.
fn seed_in(name: &str) -> Option<(&str, &str, &str)> {
    let spec = name.strip_prefix("scene:")?;
    let start = name.len() - spec.len() + spec.find("seed=")? + "seed=".len();
    let length = name[start..].find('&').unwrap_or(name.len() - start);
    let (before, rest) = name.split_at(start);
    let (seed, after) = rest.split_at(length);
    Some((before, seed, after))
}

/// A drive's name without its seed, its template, and its seed. Each file or folder is its own template.
fn parts(name: &str) -> (String, Option<u64>) {
    let seeded = seed_in(name).and_then(|(before, seed, after)| {
        let number: u64 = seed.parse().ok()?;
        // A seed that is not in its standard form makes the name its own template.
        (number.to_string() == seed).then(|| (format!("{before}*{after}"), Some(number)))
    });
    seeded.unwrap_or_else(|| (name.to_owned(), None))
}

/// Sorts drives into their fixed order: by template, then by seed; files and folders by name.
pub fn sort_drives(names: &mut [String]) {
    names.sort_by_cached_key(|name| {
        let (template, seed) = parts(name);
        (name_order(&template), seed)
    });
}

/// The fewest names for sorted drives: consecutive seeds become ranges.
pub fn ranges(sorted: &[String]) -> Vec<String> {
    let follows = |before: &String, name: &String| {
        let ((template, seed), (next_template, next)) = (parts(before), parts(name));
        template == next_template
            && seed
                .zip(next)
                .is_some_and(|(a, b)| a.checked_add(1) == Some(b))
    };
    // A range has at most as many drives as one name may mean.
    let runs = sorted
        .chunk_by(follows)
        .flat_map(|run| run.chunks(RANGE_MAX));
    let named = runs.filter_map(|run| {
        let (first, last) = (run.first()?, run.last()?);
        match (seed_in(first), seed_in(last)) {
            (Some((before, from, after)), Some((_, to, _))) if run.len() > 1 => {
                Some(format!("{before}{from}..{to}{after}"))
            }
            _ => Some(first.clone()),
        }
    });
    named.collect()
}

/// Whether a name means a rendered drive or noise, and no pictures of a real road.
pub fn is_rendered(name: &str) -> bool {
    name.starts_with("scene:") || name.starts_with("random:")
}

/// A stamp that changes if the files behind a name change: a hash of the names, sizes and times of change of a file, or
/// of the files in a folder; empty for rendered drives. It does not notice a file that is rewritten with the same size
/// within the time resolution of the disk.
///
/// # Errors
/// When there is no such file or folder.
pub fn stamp(name: &str) -> Result<String, SourceError> {
    if is_rendered(name) {
        return Ok(String::new());
    }
    let FileName { path, .. } = file_name(name)?;
    let unreadable = |error: std::io::Error| match error.kind() {
        ErrorKind::NotFound => SourceError::Missing(path.to_owned()),
        _ => SourceError::Unreadable {
            path: path.to_owned(),
            error,
        },
    };
    let mut lines = Vec::new();
    if path.is_dir() {
        for entry in fs::read_dir(path).map_err(unreadable)? {
            lines.push(line(&entry.map_err(unreadable)?.path()).map_err(unreadable)?);
        }
    } else {
        lines.push(line(path).map_err(unreadable)?);
    }
    lines.sort_unstable();
    let hash = Sha256::digest(lines.join("\n"));
    Ok(hash.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn line(path: &Path) -> std::io::Result<String> {
    let about = path.metadata()?;
    let changed = about.modified()?.duration_since(UNIX_EPOCH);
    Ok(format!(
        "{:?} {} {}",
        path.file_name().unwrap_or_default(),
        about.len(),
        changed.map_or(0, |since| since.as_nanos())
    ))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_range_of_seeds_stands_for_one_drive_a_seed() {
        assert_eq!(
            drives("scene:sim?seed=9..11&seconds=5").unwrap(),
            [
                "scene:sim?seed=9&seconds=5",
                "scene:sim?seed=10&seconds=5",
                "scene:sim?seed=11&seconds=5"
            ]
        );
        assert_eq!(drives("scene:sim?seed=9").unwrap(), ["scene:sim?seed=9"]);
        assert_eq!(drives("a..b").unwrap(), ["a..b"]);
        for wrong in [
            "scene:sim?seed=3..1",
            "scene:sim?seed=..",
            "scene:sim?seed=0..99999",
        ] {
            assert!(drives(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn drives_come_by_template_then_seed_and_are_named_by_ranges_again() {
        let mut names = drives("scene:sim?seed=9..11&seconds=5").unwrap();
        names.extend(["town10", "scene:game?seed=3", "town9", "scene:sim"].map(str::to_owned));
        names.extend(drives("scene:sim?seed=1..2&seconds=5").unwrap());
        names.reverse();
        sort_drives(&mut names);
        let named = ranges(&names);
        assert_eq!(
            named,
            [
                "scene:game?seed=3",
                "scene:sim",
                "scene:sim?seed=1..2&seconds=5",
                "scene:sim?seed=9..11&seconds=5",
                "town9",
                "town10"
            ]
        );
        let again: Vec<String> = named
            .iter()
            .flat_map(|name| drives(name).unwrap())
            .collect();
        assert_eq!(again, names);
        assert_eq!(parts(&names[2]).0, parts(&names[3]).0);
    }

    #[test]
    fn a_folder_whose_files_change_has_another_stamp() {
        let folder = tempfile::tempdir().unwrap();
        let name = folder.path().to_str().unwrap().to_owned();
        fs::write(folder.path().join("a"), "1").unwrap();
        let first = stamp(&name).unwrap();
        assert_eq!(stamp(&name).unwrap(), first);
        fs::write(folder.path().join("a"), "12").unwrap();
        let second = stamp(&name).unwrap();
        fs::rename(folder.path().join("a"), folder.path().join("b")).unwrap();
        assert!(first != second && second != stamp(&name).unwrap());
        assert_eq!(stamp("scene:sim").unwrap(), "");
        assert!(stamp("no-such-file").is_err());
    }
}
