//! Files that a command writes replace neither what it reads, nor files of another kind.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::bail;
use gapwatch::can::log;
use gapwatch::record::journal;

/// Bytes at the beginning of a file by which its kind is known.
const HEAD: u64 = 1_024;

/// A kind of file that gapwatch writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Journal,
    CanLog,
    /// An MCAP recording of gapwatch; those of other programs are no file of ours.
    Recording,
    Reference,
    #[cfg(feature = "lab")]
    Report,
    #[cfg(feature = "lab")]
    Chart,
    #[cfg(feature = "lab")]
    Histograms,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Journal => "a journal",
            Self::CanLog => "a CAN log",
            Self::Recording => "a recording written by gapwatch",
            Self::Reference => "a reference or shard",
            #[cfg(feature = "lab")]
            Self::Report => "a report",
            #[cfg(feature = "lab")]
            Self::Chart => "a chart in SVG",
            #[cfg(feature = "lab")]
            Self::Histograms => "histograms in JSON",
        }
    }

    /// Whether a file that begins like this is of this kind, of any version.
    fn begins(self, head: &[u8]) -> bool {
        let text = String::from_utf8_lossy(head);
        let text = text.trim_start_matches('\u{feff}').trim_start();
        match self {
            Self::Journal => journal::begins_like_one(head),
            Self::CanLog => log::begins_like_one(head),
            Self::Recording => head.starts_with(b"\x89MCAP0\r\n") && text.contains("gapwatch "),
            Self::Reference => {
                text.starts_with('{')
                    && ["\"gapwatch-reference\"", "\"gapwatch-shard\""]
                        .iter()
                        .any(|format| text.contains(format))
            }
            #[cfg(feature = "lab")]
            Self::Report => text.starts_with("<!DOCTYPE html>") && text.contains("gapwatch"),
            #[cfg(feature = "lab")]
            Self::Chart => text.starts_with("<svg"),
            #[cfg(feature = "lab")]
            Self::Histograms => text.starts_with("[{\"set\"") || text.trim_end() == "[]",
        }
    }
}

/// Refuses an output that would replace an input, or a file of another kind. Empty files, devices and pipes are taken.
/// `inputs` are as for [`check_is_no_input`].
///
/// # Errors
/// When writing `out` would destroy something.
pub fn check_output<'a>(
    option: &str,
    out: &Path,
    kind: Kind,
    inputs: impl IntoIterator<Item = (&'a str, &'a str)>,
) -> anyhow::Result<()> {
    check_is_no_input(option, out, inputs)?;
    if out.is_file() && !has_kind(out, kind) {
        bail!(
            "{}: {option} exists and is not {}, and would be lost; wanted another name",
            out.display(),
            kind.name()
        );
    }
    Ok(())
}

/// Refuses an output that is an input, or that exists inside a folder which is an input, also if one of them is a link to
/// the other.
///
/// `inputs` are an option (or what else names the input) and the name of each: sources as typed, with what may follow
/// `?`, and other files and folders. Names that are no files, such as rendered drives, are passed over.
///
/// # Errors
/// When writing `out` would destroy an input.
pub fn check_is_no_input<'a>(
    option: &str,
    out: &Path,
    inputs: impl IntoIterator<Item = (&'a str, &'a str)>,
) -> anyhow::Result<()> {
    // A file that does not exist cannot be an input.
    let Ok(place) = out.canonicalize() else {
        return Ok(());
    };
    for (input_option, name) in inputs {
        for input in paths_of(name) {
            if input == place {
                bail!(
                    "{}: {option} is what {input_option} reads, which would be lost; wanted another name",
                    out.display()
                );
            }
            if input.is_dir() && is_inside(&input, out, &place) {
                bail!(
                    "{}: {option} is a file in {name}, a folder of {input_option}; wanted a name outside of it",
                    out.display()
                );
            }
        }
    }
    Ok(())
}

/// Whether a file may be replaced by one of this kind. A file that cannot be read is left to its writer. A file whose
/// beginning is all zeros was cut off by a loss of power, and holds nothing.
fn has_kind(place: &Path, kind: Kind) -> bool {
    let mut head = Vec::new();
    let read = File::open(place).and_then(|file| file.take(HEAD).read_to_end(&mut head));
    read.is_err() || head.iter().all(|&byte| byte == 0) || kind.begins(&head)
}

/// Whether an output, which is at `place`, is in a folder: by its own name, or by that of what it links to, or because a
/// link in the folder leads to it.
fn is_inside(folder: &Path, out: &Path, place: &Path) -> bool {
    let parent = out.parent().filter(|parent| !parent.as_os_str().is_empty());
    let named = parent.unwrap_or(Path::new(".")).canonicalize();
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let mut leads = entries.map(|entry| entry.ok()?.path().canonicalize().ok());
    place.starts_with(folder)
        || named.is_ok_and(|named| named.starts_with(folder))
        || leads.any(|leads| leads.as_deref() == Some(place))
}

/// The files or folders that a name may mean: as typed, or without the options after a `?`.
fn paths_of(name: &str) -> Vec<PathBuf> {
    let before_options = name.match_indices('?').map(|(at, _)| &name[..at]);
    std::iter::once(name)
        .chain(before_options)
        .filter_map(|path| Path::new(path).canonicalize().ok())
        .collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::fs;

    use super::*;

    #[test]
    fn an_input_is_found_under_each_of_its_names() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("road")).unwrap();
        for file in ["road.mp4", "road/1.png", "other.json"] {
            fs::write(at(file), "{\"format\":\"gapwatch-reference\"").unwrap();
        }
        std::os::unix::fs::symlink(at("road.mp4"), at("link.mp4")).unwrap();
        fs::write(at("elsewhere.png"), "").unwrap();
        std::os::unix::fs::symlink(at("elsewhere.png"), at("road/2.png")).unwrap();
        let text = |path: PathBuf| path.to_str().unwrap().to_owned();
        let refused = |out: &str, input: &str| {
            let inputs = [("--sim", text(at(input)))];
            let inputs = inputs.iter().map(|(option, name)| (*option, name.as_str()));
            check_output("--out", &at(out), Kind::Reference, inputs).is_err()
        };
        for (out, input) in [
            ("road.mp4", "road.mp4"),
            ("road/../road.mp4", "road.mp4?condition=fog:3@1-2"),
            ("link.mp4", "road.mp4"),
            ("road.mp4", "link.mp4"),
            ("road/1.png", "road?fps=4"),
            ("road/1.png", "road/"),
            ("road/2.png", "road?fps=4"),
            ("elsewhere.png", "road?fps=4"),
        ] {
            assert!(refused(out, input), "{out} beside {input}");
        }
        for (out, input) in [
            ("other.json", "road.mp4"),
            ("other.json", "road?fps=4"),
            ("road/new.json", "road"),
            ("other.json", "missing"),
        ] {
            assert!(!refused(out, input), "{out} beside {input}");
        }
        let rendered = [("--sim", "scene:sim?seed=1")];
        assert!(check_output("--out", &at("other.json"), Kind::Reference, rendered).is_ok());
    }

    #[test]
    fn a_file_is_replaced_by_one_of_its_own_kind_alone() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("out");
        let heads: [(&[u8], Option<Kind>); 11] = [
            (b"{\"gapwatch_journal\":1,", Some(Kind::Journal)),
            (b"\xef\xbb\xbf{\"gapwatch_journal\":4,", Some(Kind::Journal)),
            (b"(0000000000.000000) can0 5D0#68", Some(Kind::CanLog)),
            (
                b"\x89MCAP0\r\n\x01\x16\0\0\0\0\0\0\0\x0egapwatch 0.1.0",
                Some(Kind::Recording),
            ),
            (b"\x89MCAP0\r\n\x01\x16\0\0\0\0\0\0\0\x0elibmcap 1.2", None),
            (
                b"{\n  \"format\": \"gapwatch-reference\",",
                Some(Kind::Reference),
            ),
            (b"{\"format\":\"gapwatch-shard\",", Some(Kind::Reference)),
            (b"{\"format\":\"other\",", None),
            (b"\x89PNG\r\n", None),
            (b"(see notes) can0", None),
            (b"text", None),
        ];
        for (head, own) in heads {
            fs::write(&place, head).unwrap();
            for kind in [
                Kind::Journal,
                Kind::CanLog,
                Kind::Recording,
                Kind::Reference,
            ] {
                let taken = check_output("--out", &place, kind, []).is_ok();
                assert_eq!(
                    taken,
                    own == Some(kind),
                    "{kind:?} over {}",
                    head.escape_ascii()
                );
            }
            assert_eq!(fs::read(&place).unwrap(), head);
        }
        for nothing in [vec![], vec![0; 4_096]] {
            fs::write(&place, nothing).unwrap();
            assert!(check_output("--out", &place, Kind::Journal, []).is_ok());
        }
        assert!(check_output("--out", Path::new("/dev/null"), Kind::Journal, []).is_ok());
    }
}
