//! Files that a command writes never replace what it reads.

use std::path::{Path, PathBuf};

use anyhow::bail;

/// Refuses an output that is one of the inputs, or that exists inside a folder which is an input, also if one of them is a
/// link to the other. `inputs` are the option
/// and the name of each: sources as typed, with what may follow `?`, and other files and folders. Names that are no
/// files, such as rendered drives, are passed over.
///
/// # Errors
/// When writing `out` would destroy an input.
pub fn check_is_no_input<'a>(
    out: &Path,
    inputs: impl IntoIterator<Item = (&'a str, &'a str)>,
) -> anyhow::Result<()> {
    // A file that does not exist cannot be an input.
    let Ok(place) = out.canonicalize() else {
        return Ok(());
    };
    for (option, name) in inputs {
        for input in paths_of(name) {
            if input == place {
                bail!(
                    "{}: --out is a source of {option}, which would be lost; wanted another name",
                    out.display()
                );
            }
            if input.is_dir() && is_inside(&input, out, &place) {
                bail!(
                    "{}: --out is a file in {name}, a folder of {option}; wanted a name outside of it",
                    out.display()
                );
            }
        }
    }
    Ok(())
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
            fs::write(at(file), "1").unwrap();
        }
        std::os::unix::fs::symlink(at("road.mp4"), at("link.mp4")).unwrap();
        fs::write(at("elsewhere.png"), "1").unwrap();
        std::os::unix::fs::symlink(at("elsewhere.png"), at("road/2.png")).unwrap();
        let text = |path: PathBuf| path.to_str().unwrap().to_owned();
        let refused = |out: &str, input: &str| {
            check_is_no_input(&at(out), [("--sim", text(at(input)).as_str())]).is_err()
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
        assert!(check_is_no_input(&at("other.json"), [("--sim", "scene:sim?seed=1")]).is_ok());
    }
}
