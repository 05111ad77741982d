//! Reports: from a journal to a page, what is refused, and what a browser makes of it.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::program::{Ran, files, gapwatch_in, ran};

const HOSTILE: &str = r#"</script><script>window.hacked=1</script>'\"><img src=x onerror='window.hacked=2'>\u202eäöü 路"#;

/// A journal of a drive with a gap, black frames and silence, whose words are made to break out of the page.
fn hostile_journal() -> String {
    let line = |t: u32, state: &str, score: Option<f64>, cause: Option<&str>| {
        let number =
            |share: f64| score.map_or("null".to_owned(), |score| (score * share).to_string());
        let health = if score.is_some() { "ok" } else { HOSTILE };
        let reason = match state {
            "Ok" => "none",
            "Stopped" => "stopped",
            _ => HOSTILE,
        };
        let state = if state == "Stopped" {
            "Unavailable"
        } else {
            state
        };
        let likely = cause.map_or(String::new(), |cause| {
            format!(
                r#""change":{},"lanes":0.75,"cause":"{cause}","cause_probability":0.5,"#,
                number(0.5)
            )
        });
        format!(
            r#"{{"t_s":{t},"seq":{t},"state":"{state}","reason":"{reason}","score":{},"gap":{},{likely}"tap_gap":{{"{HOSTILE}":{},"e3":{}}},"tap_similarity":{{"{HOSTILE}":null,"e3":0.5}},"health":"{health}","latency_ms":{t}.25,"tap_score":{{"e3":{},"e2":null}},"later":[1]}}"#,
            number(1.0),
            number(1.0),
            number(0.01),
            number(0.02),
            number(1.0),
        )
    };
    let drive = [
        ("Init", Some(0.1), None),
        ("Ok", Some(-0.25), None),
        ("Ok", Some(0.5), None),
        ("Suspect", Some(1.5), Some("another-road")),
        ("Gap", Some(7.125), Some("glare")),
        ("Gap", None, None),
        ("SensorFault", None, None),
        ("Ok", Some(0.3), None),
        ("Suspect", Some(1.01), Some("fog")),
        ("Ok", Some(-0.001), None),
        ("Unavailable", None, None),
        ("Suspect", Some(2.0), None),
        ("Gap", Some(2.5), Some("night")),
        ("Stopped", None, None),
    ];
    let lines = drive
        .iter()
        .zip(0..)
        .map(|((state, score, cause), t)| line(t, state, *score, *cause));
    let first = format!(
        r#"{{"gapwatch_journal":4,"began":{{"utc":"{HOSTILE}"}},"about":{{"source":"{HOSTILE}"}}}}"#
    );
    let lines: Vec<String> = [first].into_iter().chain(lines).collect();
    lines.join("\n") + "\n"
}

#[test]
fn a_report_is_one_file_that_asks_for_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let replay = [
        "replay",
        "scene:sim?seed=7&seconds=3&condition=fog:5@1-3",
        "--journal",
        "j.jsonl",
    ];
    gapwatch_in(folder.path(), &replay).ok();
    let said = gapwatch_in(folder.path(), &["report", "j.jsonl", "--out", "r.html"]).ok();
    assert!(
        said.starts_with("r.html: 30 lines, 2.9 s of drive, "),
        "{said}"
    );
    let page = fs::read_to_string(folder.path().join("r.html")).unwrap();
    for asks in [
        "src=\"http",
        "href=\"http",
        "url(h",
        "url(/",
        "@import",
        "fetch(",
        "//cdn",
    ] {
        assert!(!page.contains(asks), "{asks}");
    }
    assert!(page.contains("default-src 'none'"));
    assert!(page.contains("scene:sim?seed=7&amp;seconds=3") && page.contains("mahalanobis"));
    assert_eq!(files(folder.path()).len(), 2);
}

#[test]
fn the_first_line_says_what_a_run_was_made_with_and_others_do_not() {
    let folder = tempfile::tempdir().unwrap();
    let drive = "scene:sim?seed=7&seconds=1";
    gapwatch_in(folder.path(), &["replay", drive, "--journal", "j"]).ok();
    let journal = fs::read_to_string(folder.path().join("j")).unwrap();
    let lines: Vec<serde_json::Value> = journal
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let (first, lines) = lines.split_first().unwrap();
    let about = &first["about"];
    assert_eq!(
        (&about["source"], &about["reference"]),
        (&drive.into(), &"built-in".into())
    );
    assert_eq!(about["model_sha256"].as_str().unwrap().len(), 64);
    let utc = first["began"]["utc"].as_str().unwrap();
    assert!(utc.len() == 24 && utc.ends_with('Z'), "{utc}");
    assert!(first["began"]["monotonic_s"].as_f64().unwrap() > 0.0);
    assert!(lines.iter().all(|line| line.get("about").is_none()));
    let largest = |line: &serde_json::Value| {
        let scores = line["tap_score"].as_object().unwrap().values();
        scores
            .filter_map(serde_json::Value::as_f64)
            .fold(f64::MIN, f64::max)
    };
    for line in lines {
        assert!((largest(line) - line["score"].as_f64().unwrap()).abs() < 1e-12);
    }
}

#[test]
fn what_is_no_journal_is_refused_and_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("empty"), "").unwrap();
    let good = hostile_journal();
    let (first, second) = {
        let mut lines = good.lines();
        (lines.next().unwrap(), lines.next().unwrap())
    };
    let with = |last: &str| format!("{first}\n{second}\n{last}\n");
    fs::write(folder.path().join("cut"), with(&second[..30])).unwrap();
    fs::write(folder.path().join("old"), format!("{second}\n")).unwrap();
    fs::write(folder.path().join("picture"), [0xff, 0xd8, 0xff, 0, b'\n']).unwrap();
    fs::write(folder.path().join("good"), &good).unwrap();
    let before = files(folder.path());
    for (journal, out, said) in [
        ("missing", "r.html", "journal missing: No such file"),
        (
            "empty",
            "r.html",
            "journal empty: found no line; wanted at least one frame",
        ),
        ("cut", "r.html", "journal cut, line 3: found {"),
        (
            "old",
            "r.html",
            "journal old: found version 1; wanted version 4",
        ),
        ("picture", "r.html", "journal picture, line 1"),
        ("good", "no/such/r.html", "cannot write no/such/r.html"),
        ("good", "good", "another name"),
        ("good", "./good", "another name"),
    ] {
        let line = gapwatch_in(folder.path(), &["report", journal, "--out", out]).refusal();
        assert!(line.contains(said), "{line}");
        assert_eq!(files(folder.path()), before, "{journal}");
    }
    // Of a run that was killed while it wrote, what is whole is shown, and that it breaks off.
    fs::write(folder.path().join("killed"), with(&second[..30]).trim_end()).unwrap();
    gapwatch_in(folder.path(), &["report", "killed", "--out", "k.html"]).ok();
    let page = fs::read_to_string(folder.path().join("k.html")).unwrap();
    assert!(page.contains("ended while it wrote its last line"));
    let help = gapwatch_in(folder.path(), &["report", "--help"]).ok();
    assert!(
        help.contains("Example:") && help.contains("gapwatch report"),
        "{help}"
    );
}

/// Opens a report in Chromium and compares it with its journal.
fn check_in_browser(folder: &Path, journal: &str, report: &str) {
    let python = std::env::var("GAPWATCH_PYTHON")
        .expect("GAPWATCH_PYTHON names a Python with the packages of tests/requirements.txt; tests/run sets it");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/browser/check_report.py");
    let mut command = Command::new(python);
    command
        .arg(script)
        .args([journal, report])
        .current_dir(folder);
    // Where GAPWATCH_SHOTS names a folder, pictures of the page are left in it.
    if let Ok(shots) = std::env::var("GAPWATCH_SHOTS") {
        let shots = Path::new(&shots).join(journal);
        fs::create_dir_all(&shots).unwrap();
        command.arg(shots);
    }
    let Ran { code, out, err } = ran(command.output().unwrap());
    assert_eq!(code, 0, "{out}\n{err}");
}

#[test]
#[ignore = "needs Chromium and the Python packages of tests/requirements.txt: run tests/run"]
fn a_browser_shows_the_numbers_of_the_journal_and_opens_each_alarm() {
    let folder = tempfile::tempdir().unwrap();
    let replay = ["replay", "--journal", "drive", "--evidence", "seen"];
    gapwatch_in(folder.path(), &replay).ok();
    fs::write(folder.path().join("hostile"), hostile_journal()).unwrap();
    for journal in ["drive", "hostile"] {
        let report = format!("{journal}.html");
        let args = ["report", journal, "--evidence", "seen", "--out", &report];
        gapwatch_in(folder.path(), &args).ok();
        check_in_browser(folder.path(), journal, &report);
    }
}
