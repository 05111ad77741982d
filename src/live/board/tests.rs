#![allow(clippy::unwrap_used)]
use std::fs;

use super::*;

const LEAST: &str = "[camera]\nsource = \"v4l2:/dev/video0\"\n[can]\nsink = \"none\"\n";

fn read(text: &str) -> Result<Board, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("car.toml");
    fs::write(&path, text).unwrap();
    Board::read(&path).map_err(|error| error.to_string())
}

#[test]
fn the_least_board_has_the_defaults_of_the_dbc() {
    let board = read(LEAST).unwrap();
    assert_eq!(board.can.settings, CanSettings::default());
    assert_eq!(board.can.listen, Duration::from_secs(2));
    assert_eq!(board.camera.wish, CameraWish::default());
    assert!(!board.monitor.strict && board.monitor.reference.is_none());
    // Half of the time between two frames at 10 a second.
    assert_eq!(board.budget.frame, Duration::from_millis(50));
}

#[test]
fn words_are_read_and_paths_taken_from_the_folder_of_the_board() {
    let text = format!(
        "{LEAST}status = {{ id = 0x123 }}\nclear = {{ id = 0x124, data_id = 7 }}\nlisten_s = 0.5\n\
         status_period_ms = 50\n[monitor]\nreference = \"town.json\"\nstrict = true\nrate_hz = 5.0\n"
    )
    .replace("[can]", "format = \"NV12\"\nsize = \"1280x720\"\nfps = 30.0\n[can]");
    let board = read(&text).unwrap();
    let ids = |id, data_id| MessageIds { id, data_id };
    assert_eq!(board.can.settings.status, ids(0x123, 0x123));
    assert_eq!(board.can.settings.clear, ids(0x124, 7));
    // A board from before GapVersion has its default.
    assert_eq!(board.can.settings.version, ids(0x5D3, 0x5D3));
    assert_eq!(board.can.settings.version_period, Duration::from_secs(1));
    assert_eq!(board.can.settings.status_period, Duration::from_millis(50));
    assert_eq!(board.camera.wish.size, Some((1280, 720)));
    assert!(board.monitor.reference.unwrap().ends_with("town.json"));
    assert!(board.monitor.strict);
}

#[test]
fn the_version_has_identifiers_and_a_cycle_like_the_other_messages() {
    let text = format!("{LEAST}version = {{ id = 0x125, data_id = 9 }}\nversion_period_ms = 500\n");
    let settings = read(&text).unwrap().can.settings;
    let (id, data_id) = (0x125, 9);
    assert_eq!(settings.version, MessageIds { id, data_id });
    assert_eq!(settings.version_period, Duration::from_millis(500));
    // A board that gave its default to another message says what must be changed.
    let taken = format!("{LEAST}clear = {{ id = 0x5D3 }}\n");
    let said = read(&taken).unwrap_err();
    assert!(
        said.contains("0x5D3 is given to two messages, version and clear"),
        "{said}"
    );
    let text = format!("{taken}version = {{ id = 0x5D8 }}\n");
    assert_eq!(read(&text).unwrap().can.settings.version.id, 0x5D8);
}

#[test]
fn a_speed_is_read_with_what_a_dbc_file_says_of_it() {
    let speed =
        "[can.speed]\nid = 0x1A0\nstart_bit = 23\nlength = 16\nfactor = 0.01\nbig_endian = true\n";
    let board = read(&format!("{LEAST}{speed}")).unwrap();
    let speed = board.can.settings.speed.unwrap();
    assert_eq!((speed.id, speed.start_bit, speed.length), (0x1A0, 23, 16));
    assert!(speed.big_endian && (speed.parked_below_kmh - 1.0).abs() < 1e-9);
    assert!(read(LEAST).unwrap().can.settings.speed.is_none());
}

#[test]
fn evidence_is_kept_only_where_the_board_says_so_and_not_for_ever() {
    assert!(read(LEAST).unwrap().evidence.is_none());
    let board = read(&format!(
        "{LEAST}[evidence]\nfolder = \"seen\"\nevents = 5\n"
    ))
    .unwrap();
    let EvidenceBoard { folder, quota } = board.evidence.unwrap();
    assert!(folder.ends_with("seen") && folder != Path::new("seen"));
    assert_eq!((quota.events, quota.bytes), (5, 256_000_000));
    assert_eq!(quota.keep, Some(Duration::from_secs(30 * 86_400)));
    for (line, said) in [
        ("events = 0", "1 to 100000"),
        ("days = -1", "1 to 3650"),
        ("mb = 3", "megabytes"),
    ] {
        let error = read(&format!("{LEAST}[evidence]\nfolder = \"seen\"\n{line}\n")).unwrap_err();
        assert!(
            error.contains("car.toml:7:") && error.contains(said),
            "{error}"
        );
    }
}

#[test]
fn what_is_not_understood_is_refused_with_its_line_and_what_would_do() {
    for (line, from, to, said) in [
        (
            2,
            "source",
            "sources",
            "unknown key sources in [camera]; wanted source, format, size or fps",
        ),
        (4, "\"none\"", "\"can0\"", "named socketcan:can0"),
        (4, "\"none\"", "3", "sink = 3; wanted log:FILE"),
        (
            1,
            "[camera]",
            "[camara]",
            "unknown key camara; wanted camera, can, monitor, evidence or budget",
        ),
        (3, "[can]", "size = \"9x9\"\n[can]", "WIDTHxHEIGHT"),
        (3, "[can]", "format = \"H264\"\n[can]", "YUYV, NV12"),
        (3, "[can]", "fps = 0.0\n[can]", "0.1 to 240"),
        (
            6,
            "\"none\"\n",
            "\"none\"\n[monitor]\nidle_rate_hz = 12.0\n",
            "at most rate_hz = 10",
        ),
        (4, "sink", "status = { id = 0x800 }\nsink", "0x7FF"),
        (4, "sink", "listen_s = -1.0\nsink", "from 0 to 30 seconds"),
        (4, "sink", "listen_s = 31.0\nsink", "from 0 to 30 seconds"),
        (
            2,
            "[camera]",
            "[budget]\nframe_ms = 0\n[camera]",
            "1 to 100000",
        ),
        (3, "sink", "status = { id = 0x5D1 }\nsink", "two messages"),
        (
            4,
            "sink",
            "status_period_ms = 0\nsink",
            "from 21 to 65535 milliseconds",
        ),
        (
            4,
            "sink",
            "speed = { id = 0x1A0, start_bit = 60, length = 8, factor = 1.0 }\nsink",
            "8 bits from bit 60",
        ),
        (
            3,
            "sink",
            "speed = { id = 0x5D0, start_bit = 0, length = 8, factor = 1.0 }\nsink",
            "two messages",
        ),
    ] {
        let error = read(&LEAST.replacen(from, to, 1)).unwrap_err();
        assert!(error.contains(&format!("car.toml:{line}:")), "{error}");
        assert!(error.contains(said), "{error}");
        assert!(!error.contains('\n'), "{error}");
    }
    assert!(read("").unwrap_err().contains("camera"));
}

#[test]
fn every_key_answers_other_kinds_and_ranges_in_plain_words() {
    let id = "wanted an identifier of 11 bits, 0 to 0x7FF";
    let speed = "id = 1, start_bit = 0, length = 8, factor = 1.0";
    let in_speed = |rest: &str| format!("speed = {{ {speed}, {rest} }}");
    let monitor = "[monitor]\n";
    let evidence = "[evidence]\nfolder = \"seen\"\n";
    for (lines, said) in [
        (
            "status = 3".to_owned(),
            "status = 3; wanted a table [can.status] with id or data_id",
        ),
        ("clear = { id = \"a\" }".to_owned(), id),
        ("health = { id = -1 }".to_owned(), id),
        ("detail = {}".to_owned(), "no id in [can.detail]"),
        (
            "status = { id = 1, data_id = 70000 }".to_owned(),
            "from 0 to 65535",
        ),
        (
            "status = { id = 1, of = 1 }".to_owned(),
            "unknown key of in [can.status]",
        ),
        (
            "status_period_ms = 20".to_owned(),
            "from 21 to 65535 milliseconds",
        ),
        (
            "health_period_ms = 0".to_owned(),
            "from 1 to 65535 milliseconds",
        ),
        (
            "detail_period_ms = 0.5".to_owned(),
            "detail_period_ms = 0.5; wanted a whole number",
        ),
        (
            "listen_s = \"2\"".to_owned(),
            "listen_s = \"2\"; wanted a number from 0 to 30 seconds",
        ),
        (
            "fd = \"yes\"".to_owned(),
            "fd = \"yes\"; wanted true or false",
        ),
        (
            "speed = 3".to_owned(),
            "speed = 3; wanted a table [can.speed] with id, start_bit",
        ),
        (
            "speed = { id = 1 }".to_owned(),
            "no start_bit in [can.speed]",
        ),
        (
            in_speed("big_endian = 1"),
            "big_endian = 1; wanted true or false",
        ),
        (
            in_speed("offset = nan"),
            "offset = nan; wanted a finite number",
        ),
        (
            in_speed("parked_below_kmh = \"a\""),
            "wanted a finite number",
        ),
        (in_speed("parked_below_kmh = 90"), "at most 10"),
        (in_speed("parked_after_s = 61"), "from 0 to 60 seconds"),
        (
            format!("{monitor}reference = 1"),
            "reference = 1; wanted the name of a file",
        ),
        (
            format!("{monitor}model = \"\""),
            "model = \"\"; wanted the name of a file",
        ),
        (
            format!("{monitor}strict = 1"),
            "strict = 1; wanted true or false",
        ),
        (
            format!("{monitor}rate_hz = \"5\""),
            "from 0.1 to 240 a second",
        ),
        (
            format!("{monitor}idle_rate_hz = 0"),
            "from 0.1 to 240 a second",
        ),
        (
            format!("{evidence}events = 1.5"),
            "events = 1.5; wanted a whole number",
        ),
        (
            format!("{evidence}megabytes = true"),
            "megabytes = true; wanted a whole number",
        ),
        (format!("{evidence}days = 9999"), "from 1 to 3650"),
        (
            "[evidence]\nfolder = [\"a\"]".to_owned(),
            "wanted the name of a folder",
        ),
        ("[evidence]\ndays = 3".to_owned(), "no folder in [evidence]"),
        (
            "[budget]\nframe_ms = []".to_owned(),
            "frame_ms = []; wanted a number",
        ),
        (
            "[budget]\nmemory_mib = 1e9".to_owned(),
            "memory_mib = 1e9; wanted a number",
        ),
    ] {
        let error = read(&format!("{LEAST}{lines}\n")).unwrap_err();
        let table = error.contains("no folder")
            || error.contains("no id")
            || error.contains("no start_bit");
        let line = 4 + lines.lines().count() - usize::from(table && lines.contains('\n'));
        assert!(
            error.contains(&format!("car.toml:{line}: ")),
            "{line}: {error}"
        );
        assert!(error.contains(said), "{said}: {error}");
    }
    for (camera, said) in [
        ("source = \"\"", "wanted v4l2:/dev/videoN"),
        ("source = 3", "source = 3; wanted v4l2:/dev/videoN"),
        (
            "source = \"/dev/video0\"",
            "a camera is named \"v4l2:/dev/video0\"",
        ),
        ("source = \"v4l2:\"", "names no device"),
        ("source = \"random:\"\nformat = 3", "wanted one of YUYV"),
        (
            "source = \"random:\"\nsize = [1, 2]",
            "wanted \"WIDTHxHEIGHT\"",
        ),
        (
            "source = \"random:\"\nfps = \"a\"",
            "from 0.1 to 240 a second",
        ),
    ] {
        let error = read(&format!("[camera]\n{camera}\n[can]\nsink = \"none\"\n")).unwrap_err();
        let line = 1 + camera.lines().count();
        assert!(
            error.contains(&format!("car.toml:{line}: ")),
            "{line}: {error}"
        );
        assert!(error.contains(said), "{said}: {error}");
    }
}
