//! Files as people have them: pictures, folders and texts of other programs, each with what is right.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;
use std::process::Command;

use gapwatch::capture::{Picture, jpeg, open};

use crate::program::{gapwatch_in, ran};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

fn picture(path: &Path) -> Result<Picture, String> {
    let mut source = open(path.to_str().unwrap()).unwrap();
    let frame = source.next_frame().unwrap().unwrap();
    let pixels = frame.picture.map_err(|error| error.to_string())?;
    Ok(pixels.picture())
}

#[test]
#[ignore = "needs the Python packages of tests/requirements.txt: run tests/run"]
fn pictures_of_every_kind_are_what_others_read_and_damaged_ones_are_refused() {
    let python = std::env::var("GAPWATCH_PYTHON")
        .expect("GAPWATCH_PYTHON names a Python with the packages of tests/requirements.txt; tests/run sets it");
    let folder = tempfile::tempdir().unwrap();
    let made = ran(Command::new(python)
        .arg(Path::new(ROOT).join("tests/python/make_pictures.py"))
        .arg(folder.path())
        .output()
        .unwrap());
    assert_eq!(made.code, 0, "{}", made.err);
    let mut wrong = Vec::new();
    let mut compared = [0, 0];
    for entry in fs::read_dir(folder.path()).unwrap() {
        let path = entry.unwrap().path();
        let (given, right) = (path.join("given.jpg"), path.join("right.png"));
        let given = Some(given).filter(|given| given.exists());
        let given = given.unwrap_or_else(|| path.join("given.png"));
        // Inks are multiplied in other ways by each reader.
        let most = if path.to_string_lossy().contains("-cmyk") {
            2
        } else {
            0
        };
        let case = path.file_name().unwrap().to_string_lossy().into_owned();
        let (found, right) = (picture(&given), right.exists().then(|| picture(&right)));
        compared[usize::from(right.is_some())] += 1;
        match (found, right.transpose().unwrap()) {
            (Ok(found), Some(right)) => {
                let sizes = [&found, &right].map(|of| (of.width, of.height));
                let apart = found
                    .rgb
                    .iter()
                    .zip(&right.rgb)
                    .map(|(a, b)| a.abs_diff(*b));
                let apart = apart.max().unwrap();
                if sizes[0] != sizes[1] || apart > most {
                    wrong.push(format!("{case}: {sizes:?}, {apart} apart"));
                }
            }
            (Ok(_), None) => wrong.push(format!("{case}: is read")),
            (Err(why), Some(_)) => wrong.push(format!("{case}: {why}")),
            (Err(why), None) => assert!(why.contains("wanted a whole PNG or JPEG image"), "{why}"),
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(compared[0] > 20 && compared[1] > 180, "{compared:?}");
}

/// Pictures of one colour each, darkest first.
fn write_in_order(folder: &Path, names: &[&str]) {
    for (level, name) in (10..).zip(names) {
        let rgb = vec![level; 3 * 64];
        let (width, height) = (8, 8);
        let bytes = jpeg(&Picture { width, height, rgb }).unwrap();
        fs::write(folder.join(name), bytes).unwrap();
    }
}

#[test]
fn folders_are_read_in_the_order_in_which_their_frames_were_taken() {
    for names in [
        &["1.jpg", "2.jpg", "10.jpg"][..],
        &["IMG_001.JPG", "IMG_002.jpeg", "IMG_003.Jpg", "IMG_010.jfif"],
        &[
            "1700000000.5.jpg",
            "1700000000.75.jpg",
            "1700000001.0.jpg",
            "1700000001.25.jpg",
        ],
        &[
            "0.0.jpg", "0.05.jpg", "0.1.jpg", "0.15.jpg", "1.0.jpg", "10.0.jpg",
        ],
        &["clip_1.9.jpg", "clip_1.10.jpg", "clip_2.1.jpg"],
        &["t-12.jpg", "t-1.jpg", "t+0.jpg", "t+11.jpg"],
        &["1403636579763555584.jpg", "1403636579813555584.jpg"],
    ] {
        let folder = tempfile::tempdir().unwrap();
        write_in_order(folder.path(), names);
        // What others leave in folders.
        for name in ["._1.jpg", ".hidden.png", "Thumbs.db", "labels.csv"] {
            fs::write(folder.path().join(name), "no picture").unwrap();
        }
        let mut source = open(folder.path().to_str().unwrap()).unwrap();
        assert_eq!(source.frame_count(), Some(names.len() as u64), "{names:?}");
        let mut last = 0;
        while let Some(frame) = source.next_frame().unwrap() {
            let level = frame.picture.unwrap().picture().rgb[0];
            assert!(level > last, "{names:?}: {level} after {last}");
            last = level;
        }
    }
}

#[test]
fn texts_are_read_with_the_byte_order_mark_of_windows_and_in_another_encoding_refused_in_one_line()
{
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path();
    let with_mark = |text: &str| ["\u{FEFF}", text].concat().replace('\n', "\r\n");
    let utf_16 = |text: &str| -> Vec<u8> {
        let units = "\u{FEFF}".encode_utf16().chain(text.encode_utf16());
        units.flat_map(u16::to_le_bytes).collect()
    };
    let drive = "scene:sim?seed=7&seconds=1";
    let reference = fs::read_to_string(Path::new(ROOT).join("calibration/sim.json")).unwrap();
    let replay = [
        "replay",
        drive,
        "--reference",
        "r.json",
        "--journal",
        "replayed.jsonl",
    ];
    fs::write(place.join("r.json"), with_mark(&reference)).unwrap();
    gapwatch_in(place, &replay).ok();
    let report = ["report", "j.jsonl", "--out", "r.html"];
    let journal = fs::read_to_string(place.join("replayed.jsonl")).unwrap();
    fs::write(place.join("j.jsonl"), with_mark(&journal)).unwrap();
    gapwatch_in(place, &report).ok();
    let board =
        format!("[camera]\nsource = \"{drive}\"\n\n[can]\nsink = \"log:can.log\"\nlisten_s = 0\n");
    let monitor = ["monitor", "--board", "board.toml"];
    fs::write(place.join("board.toml"), with_mark(&board)).unwrap();
    gapwatch_in(place, &monitor).ok();

    fs::write(place.join("r.json"), utf_16(&reference)).unwrap();
    fs::write(place.join("j.jsonl"), utf_16(&journal)).unwrap();
    fs::write(place.join("board.toml"), utf_16(&board)).unwrap();
    for (args, name) in [
        (&replay[..], "r.json"),
        (&report[..], "j.jsonl"),
        (&monitor[..], "board.toml"),
    ] {
        let line = gapwatch_in(place, args).refusal();
        assert!(line.contains(name) && line.contains("UTF-8"), "{line}");
    }
}
