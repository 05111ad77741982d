//! Videos as cameras, phones and recorders write them, against `ffprobe` (times of frames) and `ffmpeg` (pictures).
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss
)]

use std::fs;
use std::path::Path;
use std::process::Command;

use gapwatch::capture::{Frame, SourceError, open};
use serde_json::Value;

use crate::program::{gapwatch_in, journal_of};

const SIZE: (u32, u32) = (160, 96);
const FRAMES: u32 = 40;
const H264: &str = "-c:v libx264 -crf 12 -pix_fmt yuv420p";

/// A picture without any symmetry; its upper left block is brighter with each number.
fn picture(number: u32) -> image::RgbImage {
    image::RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| match (x < 48, y < 48) {
        (true, true) => image::Rgb([16 + 5 * number as u8; 3]),
        _ => image::Rgb([x as u8, 40 + y as u8, 90 + (x + number) as u8 % 60]),
    })
}

/// Writes the pictures as `NNN.png`.
fn write_pictures(folder: &Path) {
    for number in 0..FRAMES {
        let path = folder.join(format!("{number:03}.png"));
        picture(number).save(path).unwrap();
    }
}

/// The number that a picture bears.
fn number(frame: &Frame) -> u32 {
    let picture = frame.picture.as_ref().unwrap().picture();
    let rows = (8..40).flat_map(|y| (8..40).map(move |x| 3 * (y * picture.width as usize + x)));
    let bytes: Vec<u32> = rows.map(|at| u32::from(picture.rgb[at])).collect();
    let mean = f64::from(bytes.iter().sum::<u32>()) / bytes.len() as f64;
    ((mean - 16.0) / 5.0).round() as u32
}

/// Runs `ffmpeg`, words apart by spaces; `IN` stands for the pictures, 10 a second.
fn ffmpeg(folder: &Path, args: &str) {
    let args = args.replace("IN", "-framerate 10 -i %03d.png");
    let status = Command::new("ffmpeg")
        .args(["-v", "error", "-y"])
        .args(args.split_whitespace())
        .current_dir(folder)
        .status()
        .unwrap();
    assert!(status.success(), "{args}");
}

/// Times of frames after the first, in seconds, as `ffprobe` decodes them.
fn times(folder: &Path, name: &str) -> Vec<f64> {
    let entries = "frame=best_effort_timestamp_time";
    let out = Command::new("ffprobe")
        .args([
            "-v",
            "error",
            "-select_streams",
            "V:0",
            "-show_entries",
            entries,
            "-of",
            "json",
        ])
        .arg(name)
        .current_dir(folder)
        .output()
        .unwrap();
    let found: Value = serde_json::from_slice(&out.stdout).unwrap();
    let time = |frame: &Value| {
        let text = frame["best_effort_timestamp_time"].as_str();
        text.unwrap().parse().unwrap()
    };
    let frames = found["frames"].as_array().unwrap();
    let times: Vec<f64> = frames.iter().map(time).collect();
    times.iter().map(|time| time - times[0]).collect()
}

fn frames(folder: &Path, name: &str) -> Result<Vec<Frame>, SourceError> {
    let mut source = open(folder.join(name).to_str().unwrap())?;
    let mut frames = Vec::new();
    while let Some(frame) = source.next_frame()? {
        frames.push(frame);
    }
    Ok(frames)
}

/// Mean difference of the first frame from the picture that `ffmpeg` makes of it.
fn difference(folder: &Path, name: &str, frame: &Frame) -> f64 {
    ffmpeg(
        folder,
        &format!("-i {name} -map 0:V:0 -frames:v 1 -pix_fmt rgb24 first.png"),
    );
    let wanted = image::open(folder.join("first.png")).unwrap().into_rgb8();
    let found = frame.picture.as_ref().unwrap().picture();
    assert_eq!((found.width, found.height), wanted.dimensions(), "{name}");
    let pairs = found.rgb.iter().zip(wanted.as_raw());
    let sum: u32 = pairs.map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
    f64::from(sum) / found.rgb.len() as f64
}

/// Writes how an MP4 file is to be turned into its track header.
fn turn(path: &Path, [a, b, c, d]: [i32; 4]) {
    let mut bytes = fs::read(path).unwrap();
    let header = bytes.windows(4).position(|word| word == b"tkhd").unwrap();
    let matrix = [a << 16, b << 16, 0, c << 16, d << 16, 0, 0, 0, 1 << 30];
    for (at, value) in matrix.iter().enumerate() {
        bytes[header + 44 + 4 * at..][..4].copy_from_slice(&value.to_be_bytes());
    }
    fs::write(path, bytes).unwrap();
}

/// The boxes of an MP4 file.
fn boxes(mut bytes: &[u8]) -> Vec<&[u8]> {
    let mut found = Vec::new();
    while let Some(length) = bytes.first_chunk::<4>() {
        let (first, rest) = bytes.split_at(u32::from_be_bytes(*length) as usize);
        found.push(first);
        bytes = rest;
    }
    found
}

/// Puts the cover picture of an MP4 file before its tracks, as some cameras do: it becomes stream 0.
fn cover_first(path: &Path) {
    let bytes = fs::read(path).unwrap();
    let all = boxes(&bytes);
    let (moov, before) = all.split_last().unwrap();
    assert_eq!(&moov[4..8], b"moov");
    let mut inner = boxes(&moov[8..]);
    inner.sort_by_key(|part| match &part[4..8] {
        b"mvhd" => 0,
        b"udta" => 1,
        _ => 2,
    });
    let parts = [before.concat(), moov[..8].to_vec(), inner.concat()];
    fs::write(path, parts.concat()).unwrap();
}

#[test]
#[ignore = "needs the ffmpeg program: run tests/run"]
fn every_frame_of_a_video_is_seen_once_upright_and_at_its_own_time() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_pictures(folder);
    ffmpeg(folder, &format!("IN {H264} plain.mp4"));
    for (name, turned) in [("down.mp4", [-1, 0, 0, -1]), ("left.mp4", [0, 1, -1, 0])] {
        fs::copy(folder.join("plain.mp4"), folder.join(name)).unwrap();
        turn(&folder.join(name), turned);
    }
    ffmpeg(folder, "-i 000.png -vf scale=80:48 cover.jpg");
    ffmpeg(
        folder,
        "-i plain.mp4 -i cover.jpg -map 1 -map 0 -c copy -disposition:v:0 attached_pic cover.mp4",
    );
    cover_first(&folder.join("cover.mp4"));
    let late =
        "-f lavfi -i sine=d=6 -itsoffset 1.5 -i plain.mp4 -map 1:v -map 0:a -c:v copy -c:a aac";
    let slower = "select='lt(n,10)+gt(n,25)+not(mod(n,2))'";
    let interlaced = "tinterlace=interleave_top,setfield=tff -flags +ilme+ildct";
    let all: &[&str] = &[
        &format!("{late} late.mp4"),
        "-itsoffset -0.75 -i plain.mp4 -c copy early.mkv",
        &format!("IN -vf {slower} -vsync vfr {H264} slower.mp4"),
        &format!("IN -vf {slower} -vsync vfr -c:v libvpx -b:v 2M -f webm -live 1 live.webm"),
        "-ss 1.23 -i plain.mp4 -c copy cut.mp4",
        &format!("IN {H264} -bf 3 parts.ts"),
        &format!("IN -vf {interlaced} {H264} fields.ts"),
        "IN -c:v libx264 -crf 8 -pix_fmt yuv422p10le ten_bits.mkv",
        "IN -c:v prores_ks -profile:v 4444 -pix_fmt yuva444p10le alpha.mov",
        "IN -vf crop=151:91:0:0 -c:v ffv1 -pix_fmt yuv444p odd.mkv",
        "-framerate 30000/1001 -i %03d.png -c:v mpeg4 -q:v 2 ntsc.avi",
        "IN -plays 1 moving.apng",
        &format!("-framerate 500 -i %03d.png {H264} fast.mp4"),
        &format!(
            "IN -vf settb=1/1000,setpts=N*100+45*mod(N\\,3) -vsync passthrough -enc_time_base 1:1000 {H264} uneven.mkv"
        ),
    ];
    for made in all {
        ffmpeg(folder, made);
    }
    // The numbers of turned pictures cannot be read where they are looked for.
    for (name, count, has_numbers) in [
        ("plain.mp4", FRAMES, true),
        ("down.mp4", FRAMES, false),
        ("left.mp4", FRAMES, false),
        ("cover.mp4", FRAMES, true),
        ("late.mp4", FRAMES, true),
        ("early.mkv", FRAMES, true),
        ("slower.mp4", 32, true),
        ("live.webm", 32, true),
        ("cut.mp4", 27, true),
        ("parts.ts", FRAMES, true),
        ("fields.ts", FRAMES / 2, false),
        ("ten_bits.mkv", FRAMES, true),
        ("alpha.mov", FRAMES, true),
        ("odd.mkv", FRAMES, true),
        ("ntsc.avi", FRAMES, true),
        ("moving.apng", FRAMES, true),
        ("fast.mp4", FRAMES, true),
        ("uneven.mkv", FRAMES, true),
    ] {
        let found = frames(folder, name).unwrap();
        assert_eq!(found.len(), count as usize, "{name}");
        let own = times(folder, name);
        assert_eq!(found.len(), own.len(), "{name}");
        for (frame, own) in found.iter().zip(own) {
            let at = frame.captured_at.as_secs_f64();
            assert!((at - own).abs() < 2e-6, "{name}: {at} and {own}");
        }
        let away = difference(folder, name, &found[0]);
        assert!(away < 1.5, "{name}: {away} from ffmpeg's picture");
        if has_numbers {
            let numbers: Vec<u32> = found.iter().map(number).collect();
            let is_next = |pair: &[u32]| pair[0] < pair[1];
            assert!(numbers.windows(2).all(is_next), "{name}: {numbers:?}");
        }
        let said = gapwatch_in(folder, &["replay", name, "--quiet"]).err;
        assert!(!said.contains("problems"), "{name}: {said}");
    }
}

#[test]
#[ignore = "needs the ffmpeg program: run tests/run"]
fn a_raw_stream_has_the_rate_that_is_stated() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_pictures(folder);
    ffmpeg(folder, &format!("IN {H264} -bf 2 a.h264"));
    ffmpeg(
        folder,
        "IN -c:v libx265 -x265-params log-level=error:vui-timing-info=0 -pix_fmt yuv420p a.hevc",
    );
    ffmpeg(folder, "IN -c:v mjpeg -q:v 2 a.mjpeg");
    ffmpeg(folder, &format!("IN {H264} a.mp4"));
    // Without ?fps=: the rate in the stream, or the 25 a second that ffmpeg assumes too.
    for (name, fps) in [("a.h264", 10.0), ("a.hevc", 25.0), ("a.mjpeg", 25.0)] {
        for (query, fps) in [("", fps), ("?fps=20", 20.0), ("?fps=7.5", 7.5)] {
            let found = frames(folder, &format!("{name}{query}")).unwrap();
            assert_eq!(found.len(), FRAMES as usize, "{name}{query}");
            for (sequence, frame) in (0..).zip(&found) {
                let wanted = f64::from(sequence) / fps;
                let at = frame.captured_at.as_secs_f64();
                assert!((at - wanted).abs() < 1e-6, "{name}{query}: {at}, {wanted}");
                assert_eq!(number(frame), sequence);
            }
        }
        let said = gapwatch_in(folder, &["replay", name, "--quiet"]).err;
        assert!(said.contains("this stream has no times"), "{said}");
        let said = gapwatch_in(folder, &["replay", &format!("{name}?fps=20"), "--quiet"]).err;
        assert!(!said.contains("no times"), "{said}");
    }
    let refused = gapwatch_in(folder, &["replay", "a.mp4?fps=20", "--warn", "gap"]).err;
    assert!(refused.contains("has times of its own"), "{refused}");
}

#[test]
#[ignore = "needs the ffmpeg program: run tests/run"]
fn a_pause_in_a_video_is_a_camera_that_gives_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    gapwatch_in(
        folder,
        &["scene", "--out", "s", "--count", "1", "--seed", "2"],
    )
    .ok();
    gapwatch::lab::register();
    let mut source = open("scene:sim?seed=7&seconds=6").unwrap();
    while let Some(frame) = source.next_frame().unwrap() {
        let picture = frame.picture.unwrap().picture();
        let saved = image::RgbImage::from_raw(picture.width, picture.height, picture.rgb).unwrap();
        saved
            .save(folder.join(format!("{:03}.png", frame.sequence)))
            .unwrap();
    }
    ffmpeg(
        folder,
        &format!("IN -vf select='lt(n,20)+gt(n,44)' -vsync vfr {H264} pause.mp4"),
    );
    gapwatch_in(
        folder,
        &["replay", "pause.mp4", "--quiet", "--journal", "j"],
    );
    let lines = journal_of(&folder.join("j"));
    let mut states: Vec<(String, String)> = lines
        .iter()
        .map(|line| [&line["state"], &line["reason"]].map(|v| v.as_str().unwrap().to_owned()))
        .map(|[state, reason]| (state, reason))
        .collect();
    states.dedup();
    let stale = ("Unavailable".to_owned(), "stale".to_owned());
    assert!(states.contains(&stale), "{states:?}");
    assert!(
        states.iter().all(|(state, _)| state != "SensorFault"),
        "{states:?}"
    );
    let last = lines.last().unwrap();
    assert!((last["t_s"].as_f64().unwrap() - 5.9).abs() < 1e-6, "{last}");
}

#[test]
#[ignore = "needs the ffmpeg program: run tests/run"]
fn a_video_that_is_cut_off_gives_the_frames_before_the_cut() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_pictures(folder);
    ffmpeg(folder, &format!("IN {H264} plain.mp4"));
    ffmpeg(
        folder,
        &format!("IN {H264} -g 5 -movflags frag_keyframe+empty_moov parts.mp4"),
    );
    let cut = |from: &str, to: &str| {
        let bytes = fs::read(folder.join(from)).unwrap();
        fs::write(folder.join(to), &bytes[..bytes.len() * 2 / 3]).unwrap();
    };
    cut("plain.mp4", "no_index.mp4");
    cut("parts.mp4", "cut.mp4");
    let line = gapwatch_in(folder, &["replay", "no_index.mp4"]).refusal();
    assert!(line.contains("moov atom not found"), "{line}");
    let found = frames(folder, "cut.mp4").unwrap();
    assert!(
        (15..FRAMES as usize).contains(&found.len()),
        "{}",
        found.len()
    );
    let said = gapwatch_in(folder, &["replay", "cut.mp4", "--quiet"]);
    let wanted = format!("{} frames were read; ffmpeg reported", found.len());
    assert!(said.code == 0 && said.err.contains(&wanted), "{}", said.err);
    fs::write(folder.join("sound.wav"), "RIFF").unwrap();
    let line = gapwatch_in(folder, &["replay", "sound.wav"]).refusal();
    assert!(line.contains("no picture or video"), "{line}");
}
