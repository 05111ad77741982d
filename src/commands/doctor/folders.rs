//! Whether what the monitor keeps can be written.

use std::path::Path;

use super::Check;

/// `place` is the journal's file or the folder of evidence; where it is not there yet, the folder above must be.
pub fn check(what: &'static str, place: Option<&Path>) -> Check {
    let Some(place) = place else {
        return Check::left_out(what, format!("none asked for (--{what})"));
    };
    let folder = if place.is_dir() {
        place
    } else {
        place.parent().unwrap_or(place)
    };
    let folder = if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    };
    if what == "journal" && place.is_dir() {
        let found = format!("{} is a folder", place.display());
        return Check::fail(what, found, "name a file");
    }
    match tempfile::tempfile_in(folder) {
        Ok(_) => Check::pass(what, format!("{} can be written", place.display())),
        Err(error) => Check::fail(
            what,
            format!("{}: {error}", folder.display()),
            "make the folder, let this user write it (in the service: StateDirectory), or name another",
        ),
    }
}
