//! Whether what the monitor keeps can be written.

use std::path::Path;

use gapwatch::whole_file::unnamed;

use super::Check;

/// The only folder that the service may write, made when it starts; and where its boards are.
const OF_SERVICE: &str = "/var/lib/gapwatch";
const BOARDS_OF_SERVICE: &str = "/etc/gapwatch";

/// `place` is the journal's file or the folder of evidence; where it is not there yet, the folder above must be. Of a `board` of
/// the service it is the service that writes.
pub fn check(what: &'static str, place: Option<&Path>, board: &Path) -> Check {
    let Some(place) = place else {
        return Check::left_out(what, format!("none asked for (--{what})"));
    };
    if board.starts_with(BOARDS_OF_SERVICE) && what == "evidence" {
        return if place.starts_with(OF_SERVICE) {
            Check::pass(
                what,
                format!("{}, which the service may write", place.display()),
            )
        } else {
            Check::fail(
                what,
                format!("{}, which the service may not write", place.display()),
                format!("name an absolute folder below {OF_SERVICE}"),
            )
        };
    }
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
            format!("{}: {}", folder.display(), unnamed(&error)),
            "make the folder, let this user write it (in the service: StateDirectory), or name another",
        ),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::Outcome;
    use super::*;

    #[test]
    fn a_board_of_the_service_is_judged_by_what_the_service_may_write() {
        let here = tempfile::tempdir().unwrap();
        let result = |place: &Path, board: &str| {
            let check = check("evidence", Some(place), Path::new(board));
            check.result
        };
        let service = "/etc/gapwatch/car.toml";
        // Its own folder is made when it starts.
        let own = Path::new("/var/lib/gapwatch/seen");
        assert!(result(own, service) == Outcome::Pass);
        assert!(result(here.path(), service) == Outcome::Fail);
        assert!(result(here.path(), "car.toml") == Outcome::Pass);
        assert!(result(&here.path().join("no/such"), "car.toml") == Outcome::Fail);
    }
}
