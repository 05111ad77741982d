//! Power cuts, in a virtual machine: the disk under an ext4 keeps a log of its writes, so it can be made as it was at any moment.
//!
//! `tests/vm/power_cuts.sh` is what happens inside: programs write and report, then the power is cut at random moments, and what
//! the disk holds after each is listed. Nothing that was reported may be lost, and nothing may be half there.
#![cfg(feature = "can")]
#![allow(clippy::unwrap_used)]

mod machine;
mod program;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use machine::{machine, report, stage_program};
use program::gapwatch_in;
use sha2::{Digest, Sha256};

/// Another one with `GAPWATCH_VM_POWER_CUT_SEED`.
const SEED: u32 = 20_262;
const MOMENTS: usize = 200;
/// What the monitor wrote longer ago than this is on the disk.
const SYNCED_S: f64 = 2.5;
/// Written by the monitor line by line: after a power cut, the beginning of what it became.
const LIVE: [&str; 2] = ["./monitor/live.jsonl", "./monitor/live.log"];
const MODEL: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/calibration/enet-sad-small-160x80"
);
/// An emulated processor sums slowly, so it looks no deeper than this.
const FIRST_TAP: &str = "taps = [\"encoder/e1.0/relu/Relu\"]";
const SMALL: &str = "scene:sim?size=160x80";
/// Has a file that nobody syncs.
const UNSYNCED: &str = "./unsynced/";

/// What was wrong after a power cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Fault {
    NotMounted,
    ReportedFileMissing,
    ReportedFileNotWhole,
    FileNotWhole,
    EventNotWhole,
    LiveFileOther,
    LiveLinesLost,
}

#[derive(Clone, Debug, Default, PartialEq)]
struct Content {
    bytes: usize,
    sha256: String,
}

/// Results on a disk: names that begin with a dot are none.
#[derive(Clone, Default)]
struct Listing {
    folders: BTreeSet<String>,
    files: BTreeMap<String, Content>,
}

impl Listing {
    fn new(text: &str) -> Self {
        let mut found = Self::default();
        for line in text.lines() {
            let (kind, rest) = line.split_once(' ').unwrap();
            let (value, path) = match kind {
                "folder" => ("", rest),
                _ => rest.split_once(' ').unwrap(),
            };
            let path = path.trim_start().to_owned();
            let hidden = path.split('/').skip(1).any(|name| name.starts_with('.'));
            match kind {
                _ if hidden => {}
                "folder" => drop(found.folders.insert(path)),
                "bytes" => found.files.entry(path).or_default().bytes = value.parse().unwrap(),
                "sha256" => found.files.entry(path).or_default().sha256 = value.to_owned(),
                _ => panic!("{line}"),
            }
        }
        found
    }

    fn below(&self, folder: &str) -> Self {
        let inside = |path: &String| path.starts_with(folder);
        let files = self.files.iter().filter(|(path, _)| inside(path));
        Self {
            folders: self.folders.iter().filter(|f| inside(f)).cloned().collect(),
            files: files.map(|(path, of)| (path.clone(), of.clone())).collect(),
        }
    }

    fn events(&self) -> impl Iterator<Item = &String> {
        self.folders.iter().filter(|folder| {
            let name = folder.rsplit('/').next().unwrap();
            name.len() == 6 && name.bytes().all(|byte| byte.is_ascii_digit())
        })
    }
}

/// A program's end.
struct Report {
    /// Number of the log's entry.
    entry: u64,
    /// With a slash at its end.
    folder: String,
    /// The folder as it was then.
    listing: Listing,
}

/// A time that is marked in the log, with the lines that each of [`LIVE`] had.
struct Tick {
    entry: u64,
    at_s: f64,
    lines: [usize; 2],
}

/// What was written when.
struct Story {
    reports: Vec<Report>,
    ticks: Vec<Tick>,
    /// What became of [`LIVE`].
    live: [Vec<u8>; 2],
}

impl Story {
    fn read(share: &Path) -> Self {
        let (mut reports, mut ticks) = (vec![], vec![]);
        for line in fs::read_to_string(share.join("marks")).unwrap().lines() {
            let (entry, word) = line.split_once(' ').unwrap();
            let entry = entry.parse().unwrap();
            let parts: Vec<&str> = word.split(':').collect();
            match parts[..] {
                ["written", number, folder] => {
                    let code = fs::read_to_string(share.join(format!("{number}.code"))).unwrap();
                    let said = fs::read_to_string(share.join(format!("{number}.err"))).unwrap();
                    assert_eq!(code, "0\n", "{folder}: {said}");
                    let all = fs::read_to_string(share.join(format!("{number}.list"))).unwrap();
                    let folder = format!("./{folder}/");
                    let listing = Listing::new(&all).below(&folder);
                    assert!(!listing.files.is_empty(), "{folder}");
                    reports.push(Report {
                        entry,
                        folder,
                        listing,
                    });
                }
                ["clock", at_s, journal, log] => ticks.push(Tick {
                    entry,
                    at_s: at_s.parse().unwrap(),
                    lines: [journal, log].map(|lines| lines.parse().unwrap()),
                }),
                _ => {}
            }
        }
        let live = ["live.jsonl", "live.log"].map(|name| fs::read(share.join(name)).unwrap());
        Self {
            reports,
            ticks,
            live,
        }
    }

    /// What is wrong with a disk after a power cut in front of an entry of the log, by folder.
    fn faults(&self, cut: u64, disk: &Listing) -> Vec<(Fault, String)> {
        let mut wrong = vec![];
        let folders: BTreeSet<&String> = self.reports.iter().map(|r| &r.folder).collect();
        for folder in folders {
            let of_folder = || self.reports.iter().filter(|r| r.folder == *folder);
            let reported = of_folder().rfind(|report| report.entry < cut);
            let next = of_folder().find(|report| report.entry >= cut);
            let reported = reported.map(|r| r.listing.clone()).unwrap_or_default();
            let next = next.map(|r| r.listing.clone()).unwrap_or_default();
            self.faults_of(cut, &disk.below(folder), &reported, &next, &mut wrong);
        }
        wrong
    }

    /// Of one folder: `reported` must be there, `next` may.
    fn faults_of(
        &self,
        cut: u64,
        disk: &Listing,
        reported: &Listing,
        next: &Listing,
        wrong: &mut Vec<(Fault, String)>,
    ) {
        let mut complain = |fault, path: &str| wrong.push((fault, path.to_owned()));
        for path in reported.files.keys() {
            if !disk.files.contains_key(path) {
                complain(Fault::ReportedFileMissing, path);
            }
        }
        for (path, content) in &disk.files {
            let becomes = |listing: &Listing| listing.files.get(path) == Some(content);
            if becomes(reported) || becomes(next) {
                continue;
            }
            match LIVE.iter().position(|live| live == path) {
                _ if reported.files.contains_key(path) => {
                    complain(Fault::ReportedFileNotWhole, path);
                }
                Some(live) if !is_beginning(content, &self.live[live]) => {
                    complain(Fault::LiveFileOther, path);
                }
                Some(_) => {}
                None => complain(Fault::FileNotWhole, path),
            }
        }
        for event in disk.events() {
            let mut files = reported.files.keys().chain(next.files.keys());
            let missing = |path: &String| {
                path.starts_with(&format!("{event}/")) && !disk.files.contains_key(path)
            };
            if files.any(missing) {
                complain(Fault::EventNotWhole, event);
            }
        }
        for (live, path) in LIVE.iter().enumerate() {
            let wanted = length(&self.live[live], self.lines_at(cut)[live]);
            let of_this_folder = next.files.contains_key(*path);
            let found = disk.files.get(*path).map_or(0, |content| content.bytes);
            if of_this_folder && found < wanted {
                complain(Fault::LiveLinesLost, path);
            }
        }
    }

    /// Lines of [`LIVE`] that were written long enough before an entry of the log.
    fn lines_at(&self, cut: u64) -> [usize; 2] {
        let now = self.ticks.iter().rfind(|tick| tick.entry < cut);
        let long_ago = |tick: &&Tick| now.is_some_and(|now| tick.at_s + SYNCED_S <= now.at_s);
        let then = self.ticks.iter().rfind(long_ago);
        then.map_or([0, 0], |tick| tick.lines)
    }
}

fn is_beginning(content: &Content, of: &[u8]) -> bool {
    of.get(..content.bytes)
        .is_some_and(|beginning| content.sha256 == sha256(beginning))
}

fn sha256(bytes: &[u8]) -> String {
    let hash = Sha256::digest(bytes);
    hash.iter().fold(String::new(), |mut hex, byte| {
        write!(hex, "{byte:02x}").unwrap();
        hex
    })
}

/// Bytes of so many lines.
fn length(text: &[u8], lines: usize) -> usize {
    let lines = text.split_inclusive(|&byte| byte == b'\n').take(lines);
    lines.map(<[u8]>::len).sum()
}

fn record(share: &Path, name: &str, drive: &str) {
    let recording = format!("{name}.mcap");
    let files = [
        "--model",
        "lane.onnx",
        "--reference",
        "reference.json",
        "--mcap",
        &recording,
    ];
    gapwatch_in(share, &[&["replay", drive][..], &files].concat()).ok();
}

fn stage(share: &Path) {
    stage_program(share, "power_cuts.sh");
    fs::copy(format!("{MODEL}.onnx"), share.join("lane.onnx")).unwrap();
    let spec = fs::read_to_string(format!("{MODEL}.toml")).unwrap();
    let spec = spec.lines().filter(|line| !line.starts_with("taps"));
    let spec: String = spec.map(|line| format!("{line}\n")).collect();
    fs::write(share.join("lane.toml"), format!("{FIRST_TAP}\n{spec}")).unwrap();
    let sim = format!("{SMALL}&seed=1001..1020&seconds=3");
    let calibrate = ["calibrate", "--model", "lane.onnx", "--sim", &sim];
    gapwatch_in(
        share,
        &[&calibrate[..], &["--out", "reference.json"]].concat(),
    )
    .ok();
    // Recorded here, since a processor that is emulated renders slowly.
    let noise =
        |seed, seconds| format!("{SMALL}&seed={seed}&seconds={seconds}&condition=noise:5@2-5");
    record(share, "short", &noise(7, 7));
    record(share, "other", &noise(8, 7));
    record(share, "long", &(noise(9, 14) + "&condition=noise:5@9-12"));
    for seed in 1..5 {
        record(
            share,
            &format!("nominal-{seed}"),
            &format!("{SMALL}&seed={seed}&seconds=1.5"),
        );
    }
    fs::write(
        share.join("car.toml"),
        "[camera]\nsource = \"long.mcap\"\n\
         [can]\nsink = \"log:/disk/monitor/live.log\"\n\
         [monitor]\nmodel = \"lane.onnx\"\nreference = \"reference.json\"\nstrict = true\nrate_hz = 10\n\
         [evidence]\nfolder = \"/disk/monitor/seen\"\n",
    )
    .unwrap();
    let seed = std::env::var("GAPWATCH_VM_POWER_CUT_SEED").unwrap_or_else(|_| SEED.to_string());
    fs::write(share.join("cuts"), format!("{seed} {MOMENTS}\n")).unwrap();
}

#[test]
#[ignore = "needs qemu and Debian's kernel: run tests/run"]
fn vm_a_power_cut_loses_nothing_reported_and_leaves_nothing_half() {
    let share = machine("power-cuts", stage);
    let story = Story::read(&share);
    let cuts = fs::read_to_string(share.join("cuts.list")).unwrap();
    let cuts: Vec<(u64, &str)> = cuts
        .split("cut ")
        .skip(1)
        .map(|cut| cut.split_once('\n').unwrap())
        .map(|(entry, listing)| (entry.parse().unwrap(), listing))
        .collect();
    assert_eq!(cuts.len(), MOMENTS);

    let mut by_kind: BTreeMap<Fault, BTreeSet<u64>> = BTreeMap::new();
    let (mut wrong, mut unsynced) = (String::new(), BTreeSet::new());
    for (cut, listing) in &cuts {
        let faults = match *listing {
            "unmountable\n" => vec![(Fault::NotMounted, String::new())],
            _ => story.faults(*cut, &Listing::new(listing)),
        };
        for (fault, path) in faults {
            if path.starts_with(UNSYNCED) {
                unsynced.insert(cut);
            } else {
                by_kind.entry(fault).or_default().insert(*cut);
                writeln!(wrong, "{cut}: {fault:?} {path}").unwrap();
            }
        }
    }
    let after_a_report = cuts.iter().filter(|cut| cut.0 > story.reports[0].entry);
    let seed = fs::read_to_string(share.join("cuts")).unwrap();
    let bad: BTreeSet<&u64> = by_kind.values().flatten().collect();
    let kinds: BTreeMap<Fault, usize> = by_kind.iter().map(|(k, of)| (*k, of.len())).collect();
    let said = format!(
        "Power cuts, seed {}: {} moments among {} entries of the log, {} of them after the first of {} reports; faults at {} of them, by \
         kind: {kinds:?}; the file that nobody synced was lost at {}.\n",
        seed.split(' ').next().unwrap(),
        cuts.len(),
        cuts.iter().map(|cut| cut.0).max().unwrap() - cuts.iter().map(|cut| cut.0).min().unwrap(),
        after_a_report.count(),
        story.reports.len(),
        bad.len(),
        unsynced.len(),
    );
    report(&share, "power-cuts", &said);
    assert!(!unsynced.is_empty(), "every power cut was harmless");
    let events: usize = story
        .reports
        .iter()
        .map(|r| r.listing.events().count())
        .sum();
    assert!(events >= 4, "{events} events");
    let running = story.ticks.iter().map(|tick| tick.lines[0]).max();
    assert!(wrong.is_empty(), "{said}{wrong}");
    assert!(running > Some(50), "the monitor's journal was not live");
}
