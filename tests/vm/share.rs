//! The machine, what it is given, and what it left: bus log, journals, pictures.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::clips::{clip, lane_model, pictures, yuyv};
use crate::machine::stage_program;
use crate::program::gapwatch_in;
use gapwatch::can::e2e::{E2eReceiver, E2eSender, Sequence};
use gapwatch::can::message::{ClearRequest, GapStatus};
use gapwatch::capture::pixels::{Layout, PixelFormat, Pixels};
use gapwatch::capture::{Frame, Picture};
use gapwatch::model::encoder::Encoder;
use gapwatch::model::{ModelOptions, ModelSpec};
use gapwatch::monitor::judge::Verdict;
use gapwatch::monitor::pipeline::Monitor;
use gapwatch::record::journal::{self, Entry};
use gapwatch::reference::Reference;

pub const ROOT: &str = env!("CARGO_MANIFEST_DIR");
/// Fog of 60 m visibility between 5 and 9 s.
pub const DRIVE: &str = "scene:sim?seed=7&seconds=14&fps=30&condition=fog:4@5-9";
pub const NOMINAL: &str = "scene:sim?seed=8&seconds=1&fps=30";
pub const NIGHT: &str = "scene:sim?seed=8&seconds=1&fps=30&condition=night:4";
/// Seed of the faults at random.
pub const SOAK_SEED: u32 = 20_261;
/// Scores of one picture on two processors differ by less than this: the encoder's sums are rounded in another order.
pub const SAME: f64 = 1e-5;

/// The folder that the machine shared, with what it left there.
pub fn machine() -> PathBuf {
    crate::machine::machine("vm", stage)
}

/// Puts the program, its libraries, the lane model with a reference, boards and clips where the machine finds them.
pub fn stage(share: &Path) {
    stage_program(share, "guest.sh");
    lane_model(share);
    fs::write(
        share.join("car.toml"),
        "[camera]\nsource = \"v4l2:/dev/video0\"\nformat = \"YUYV\"\nsize = \"320x160\"\n\
         [can]\nsink = \"socketcan:vcan0\"\nlisten_s = 0.5\nfd = true\n\
         [can.speed]\nid = 0x1A0\nstart_bit = 8\nlength = 16\nfactor = 0.01\nparked_after_s = 1.0\n\
         [monitor]\nmodel = \"lane.onnx\"\nreference = \"reference.json\"\nstrict = true\nrate_hz = 10\n",
    )
    .unwrap();
    let clips = share.join("clips");
    fs::create_dir(&clips).unwrap();
    clip(&clips.join("drive"), &pictures(DRIVE));
    let nominal = pictures(NOMINAL);
    clip(&clips.join("nominal"), &nominal);
    clip(&clips.join("frozen"), &vec![nominal[7].clone(); 15]);
    let painted = |paint: &dyn Fn(usize, u32, u32) -> Option<u8>| -> Vec<Picture> {
        let frames = nominal.iter().take(15).cloned().enumerate();
        frames
            .map(|(n, mut picture)| {
                for (at, pixel) in picture.rgb.chunks_exact_mut(3).enumerate() {
                    let (x, y) = (at as u32 % picture.width, at as u32 / picture.width);
                    if let Some(value) = paint(n, x, y) {
                        pixel.fill(value);
                    }
                }
                picture
            })
            .collect()
    };
    clip(&clips.join("black"), &painted(&|_, _, _| Some(0)));
    clip(&clips.join("grey"), &painted(&|_, _, _| Some(120)));
    clip(
        &clips.join("covered"),
        &painted(&|n, x, y| (x < 200).then_some((n as u32 + x + y) as u8 % 4)),
    );
    clip(
        &clips.join("paper"),
        &painted(&|n, x, y| {
            let mixed = n as u32 * 7_919 + x * 104_729 + y * 1_299_709;
            (x < 240).then_some(190 + (mixed / 13 % 7) as u8)
        }),
    );
    clip(&clips.join("night"), &pictures(NIGHT));
    let soak_s = std::env::var("GAPWATCH_VM_SOAK_S").unwrap_or_else(|_| "60".to_owned());
    fs::write(share.join("soak"), format!("{SOAK_SEED} {soak_s}\n")).unwrap();
    // As long as that of a real interface, unless another is asked for.
    let queue = std::env::var("GAPWATCH_VM_QUEUE").unwrap_or_else(|_| "10".to_owned());
    fs::write(share.join("queue"), queue).unwrap();
    fs::write(share.join("clear"), clear_requests()).unwrap();
}

/// `GapClear` with a wrong checksum, and two right ones.
pub fn clear_requests() -> String {
    let mut sender = E2eSender::new(0x5D8);
    let mut lines = String::new();
    for wrong in [1, 0, 0] {
        let mut write = |data: [u8; 8]| {
            let data = [&[data[0] ^ wrong], &data[1..]].concat();
            let hex: String = data.iter().map(|byte| format!("{byte:02X}")).collect();
            writeln!(lines, "{hex}")
        };
        sender.protect(ClearRequest.to_bytes(), &mut write).unwrap();
    }
    lines
}

/// What a camera of this format shows of a picture.
pub fn through_yuyv(picture: &Picture) -> Pixels {
    let layout = Layout {
        format: PixelFormat::Yuyv,
        width: picture.width,
        height: picture.height,
        stride: 0,
    };
    layout.pixels(&yuyv(picture)).unwrap()
}

/// A frame that candump logged.
#[derive(Clone)]
pub struct Logged {
    pub at: f64,
    pub bus: String,
    pub id: String,
    pub data: Vec<u8>,
    pub line: String,
}

pub fn logged(share: &Path) -> Vec<Logged> {
    let log = fs::read_to_string(share.join("bus.log")).unwrap();
    log.lines()
        .map(|line| {
            let mut words = line.split_whitespace();
            let at = words.next().unwrap().trim_matches(['(', ')']);
            let bus = words.next().unwrap();
            let (id, data) = words.next().unwrap().split_once('#').unwrap();
            // Of CAN FD, behind a second sign and a digit of flags.
            let data = data.strip_prefix('#').map_or(data, |of_fd| &of_fd[1..]);
            let bytes = (0..data.len()).step_by(2);
            Logged {
                at: at.parse().unwrap(),
                bus: bus.to_owned(),
                id: id.to_owned(),
                data: bytes
                    .map(|at| u8::from_str_radix(&data[at..at + 2], 16).unwrap())
                    .collect(),
                line: format!("{line}\n"),
            }
        })
        .collect()
}

/// What is between two marks; the marks themselves are left out.
pub fn between<'a>(log: &'a [Logged], from: &str, to: &str) -> &'a [Logged] {
    let marked = |word: &str| {
        let is = |logged: &Logged| logged.id == "7F0" && logged.data == word.as_bytes();
        log.iter()
            .position(is)
            .unwrap_or_else(|| panic!("no mark {word}"))
    };
    &log[marked(from) + 1..marked(to)]
}

/// Status frames with their times, each with a right CRC and the next counter.
pub fn statuses(log: &[Logged]) -> Vec<(f64, GapStatus)> {
    let (all, after_a_loss) = statuses_and_losses(log);
    assert!(after_a_loss.is_empty(), "a hole before {after_a_loss:?}");
    all
}

/// Status frames with their times, each with a right CRC, and the times of those before which some are missing.
pub fn statuses_and_losses(log: &[Logged]) -> (Vec<(f64, GapStatus)>, Vec<f64>) {
    let mut receiver = E2eReceiver::new(0x5D0);
    let ours = log.iter().filter(|l| l.bus == "vcan0" && l.id == "5D0");
    let mut after_a_loss = vec![];
    let all = ours.map(|logged| {
        let data: [u8; 8] = logged.data.as_slice().try_into().unwrap();
        match receiver.check(&data) {
            Ok(Sequence::First | Sequence::Next) => {}
            Ok(Sequence::SomeLost) => after_a_loss.push(logged.at),
            sequence => panic!("{}: {sequence:?}", logged.line),
        }
        (logged.at, GapStatus::from_bytes(&data).unwrap())
    });
    (all.collect(), after_a_loss)
}

pub fn journal_of(folder: &Path, name: &str) -> Vec<Entry> {
    let read = journal::read(&folder.join(name)).unwrap().entries;
    read.into_iter()
        .filter(|entry| entry.sequence.is_some())
        .collect()
}

/// The lane model and reference of the machine.
pub struct Judge {
    pub encoder: Encoder,
    pub reference: Reference,
}

impl Judge {
    pub fn new(share: &Path) -> Self {
        let model = share.join("lane.onnx");
        let spec = ModelSpec::new(Some(&model), ModelOptions::default()).unwrap();
        Self {
            encoder: Encoder::load(&spec).unwrap(),
            reference: Reference::read(Some(&share.join("reference.json"))).unwrap(),
        }
    }

    pub fn monitor(&self) -> Monitor {
        Monitor::new(&self.encoder, &self.reference).unwrap()
    }
}

pub fn look(monitor: &mut Monitor, entry: &Entry, pixels: &Pixels) -> Verdict {
    monitor.step(&Frame {
        sequence: entry.sequence.unwrap(),
        captured_at: Duration::from_secs_f64(entry.captured_s.unwrap()),
        picture: Ok(pixels.clone()),
    })
}

/// Which frames of the clip the camera showed when the monitor looked. It starts anywhere, and where the clocks of vivid's
/// two nodes touch it shows a frame twice or leaves one out; what was shown is what gives the same verdict, to the last
/// bits.
pub fn shown(share: &Path, seen: &[Entry], clip: &[Pixels]) -> Vec<usize> {
    let judge = Judge::new(share);
    let explains = |verdict: &Verdict, entry: &Entry| {
        let close = |(a, b): (f64, f64)| (a - b).abs() < SAME;
        verdict.score.zip(entry.score).is_some_and(close) && verdict.state == entry.state
    };
    let mut shown: Vec<usize> = vec![];
    let mut monitor = judge.monitor();
    for (n, entry) in seen.iter().enumerate() {
        let wanted: Vec<usize> = match (n.checked_sub(1), shown.last()) {
            (Some(before), Some(&last)) => {
                let step = entry.sequence.unwrap() - seen[before].sequence.unwrap();
                let slip = |slip| last.saturating_add_signed(step as isize + slip);
                [0, 1, -1, 2, -2].map(slip).into()
            }
            _ => (0..clip.len() / 2).collect(),
        };
        let found = wanted
            .into_iter()
            .filter(|&at| at < clip.len())
            .find(|&at| {
                let fits = explains(&look(&mut monitor, entry, &clip[at]), entry);
                if !fits {
                    // A monitor cannot forget: another one sees all that came before.
                    monitor = judge.monitor();
                    for (entry, &at) in seen.iter().zip(&shown) {
                        look(&mut monitor, entry, &clip[at]);
                    }
                }
                fits
            });
        shown.push(found.unwrap_or_else(|| panic!("no frame of the clip explains {entry:?}")));
    }
    shown
}

/// Replays pictures as files, at 10 a second.
pub fn replayed<'a>(share: &Path, pictures: impl Iterator<Item = &'a Picture>) -> Vec<Entry> {
    let folder = tempfile::tempdir().unwrap();
    for (n, picture) in pictures.enumerate() {
        image::RgbImage::from_raw(picture.width, picture.height, picture.rgb.clone())
            .unwrap()
            .save(folder.path().join(format!("{n:04}.png")))
            .unwrap();
    }
    let path = |name: &str| share.join(name).display().to_string();
    let (model, reference) = (path("lane.onnx"), path("reference.json"));
    let files = ["--model", &model, "--reference", &reference];
    let replay = ["replay", ".", "--journal", "replay.jsonl"];
    gapwatch_in(folder.path(), &[&replay[..], &files].concat()).ok();
    journal_of(folder.path(), "replay.jsonl")
}

/// A journal's frames at their times, with other pictures: what they look like without a camera between.
pub fn judged(share: &Path, seen: &[Entry], pictures: &[&Picture]) -> Vec<Verdict> {
    let judge = Judge::new(share);
    let mut monitor = judge.monitor();
    let frames = seen.iter().zip(pictures);
    frames
        .map(|(entry, &picture)| look(&mut monitor, entry, &picture.clone().into()))
        .collect()
}
