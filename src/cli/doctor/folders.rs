//! Whether the files that the monitor keeps can be written.

use std::path::Path;

use gapwatch::files::whole_file::unnamed;
use gapwatch::record::events::{Found, examine};

use super::check::Check;

/// The only folder that the service may write to, which is made when it starts, and the folder of its board files.
const OF_SERVICE: &str = "/var/lib/gapwatch";
const BOARDS_OF_SERVICE: &str = "/etc/gapwatch";
/// Largest number of names listed of files that are not events.
const NAMED_MAX: usize = 5;

/// `place` is the file of the journal or the folder of the evidence. If it does not exist yet, the folder above it must
/// exist. For a `board` of the service, it is the service that writes.
pub fn check(what: &'static str, place: Option<&Path>, board: &Path) -> Check {
    let Some(place) = place else {
        return Check::left_out(what, format!("none asked for (--{what})"));
    };
    if board.starts_with(BOARDS_OF_SERVICE) && what == "evidence" {
        return if place.starts_with(OF_SERVICE) {
            Check::pass(
                what,
                format!("{}, which the service may write to", place.display()),
            )
        } else {
            Check::fail(
                what,
                format!("{}, which the service may not write to", place.display()),
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
    if what == "evidence" && place.exists() && !place.is_dir() {
        let found = format!("{} is not a folder", place.display());
        return Check::fail(what, found, "name a folder");
    }
    let written = if what == "evidence" && place.is_dir() {
        examine(place).map(|found| format!(", {}", in_words(&found)))
    } else {
        tempfile::tempfile_in(folder).map(|_| String::new())
    };
    match written {
        Ok(found) => Check::pass(what, format!("{} can be written{found}", place.display())),
        Err(error) => Check::fail(
            what,
            format!("{}: {}", folder.display(), unnamed(&error)),
            "create the folder, allow this user to write to it (in the service: StateDirectory), or name another folder",
        ),
    }
}

fn in_words(found: &Found) -> String {
    let megabytes = f64::from(u32::try_from(found.bytes / 1_000).unwrap_or(u32::MAX)) / 1_000.0;
    let mut words = format!("{} events of {megabytes:.1} MB in it", found.events);
    if found.unfinished > 0 {
        words += &format!(
            ", {} unfinished (removed at the next start)",
            found.unfinished
        );
    }
    if !found.others.is_empty() {
        let mut names = found.others.clone();
        names.truncate(NAMED_MAX);
        let more = if found.others.len() > NAMED_MAX {
            ", ..."
        } else {
            ""
        };
        words += &format!(
            "; other files in it are left alone: {}{more}",
            names.join(", ")
        );
    }
    words
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::Outcome;
    use super::*;
    use std::fs;

    #[test]
    fn a_board_of_the_service_is_judged_by_what_the_service_may_write() {
        let here = tempfile::tempdir().unwrap();
        let result = |place: &Path, board: &str| {
            let check = check("evidence", Some(place), Path::new(board));
            check.result
        };
        let service = "/etc/gapwatch/car.toml";
        // The service's own folder is made when it starts.
        let own = Path::new("/var/lib/gapwatch/seen");
        assert!(result(own, service) == Outcome::Pass);
        assert!(result(here.path(), service) == Outcome::Fail);
        assert!(result(here.path(), "car.toml") == Outcome::Pass);
        assert!(result(&here.path().join("no/such"), "car.toml") == Outcome::Fail);
    }
    #[test]
    fn what_lies_in_the_folder_is_said_and_left() {
        let here = tempfile::tempdir().unwrap();
        let evidence = || check("evidence", Some(here.path()), Path::new("car.toml"));
        assert!(
            evidence().found.contains("0 events"),
            "{}",
            evidence().found
        );
        fs::create_dir_all(here.path().join("000007")).unwrap();
        fs::write(here.path().join("000007/event.json"), vec![b' '; 1_500_000]).unwrap();
        fs::create_dir(here.path().join(".unfinished-000008")).unwrap();
        fs::write(here.path().join("000123"), "").unwrap();
        let Check { result, found, .. } = evidence();
        assert!(result == Outcome::Pass);
        for part in ["1 events of 1.5 MB", "1 unfinished", "alone: 000123"] {
            assert!(found.contains(part), "{found}");
        }
        assert!(here.path().join(".unfinished-000008").exists());
        // Like the recorder: not where another recorder writes, and not into a file.
        let quota = gapwatch::record::events::Quota::default();
        let recorder =
            gapwatch::record::events::EventRecorder::start(here.path(), quota, &[]).unwrap();
        assert!(evidence().result == Outcome::Fail);
        recorder.finish();
        assert!(evidence().result == Outcome::Pass);
        let file = here.path().join("000123");
        let of_file = check("evidence", Some(&file), Path::new("car.toml"));
        assert!(of_file.result == Outcome::Fail);
    }
}
