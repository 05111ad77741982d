//! Power cuts, in a virtual machine: the disk under an ext4 keeps a log of its writes, so it can be made as it was at any moment.
//!
//! `tests/vm/power_cuts.sh` is what happens inside: programs write and report, then the power is cut at random moments, and what
//! the disk holds after each is listed. Nothing that was reported may be lost, and nothing may be half there.
#![cfg(feature = "can")]
#![allow(clippy::unwrap_used)]

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use crate::machine::{machine, report, stage_program};
use crate::program::gapwatch_in;
use gapwatch::record::journal;

/// Another one with `GAPWATCH_VM_POWER_CUT_SEED`.
const SEED: u32 = 20_262;
const MOMENTS: usize = 200;
/// A moment so many entries of the log from a report is near it.
const NEAR: u64 = 5;
/// What the monitor wrote longer ago than this is on the disk.
const SYNCED_S: f64 = 2.5;
/// Written by the monitor line by line: after a power cut, the beginning of what it became. Where the file system had noted
/// that a file is longer, and not yet what stands there, NULs follow; readers take them for a line that breaks off.
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
    ReportedFileMissing,
    ReportedFileNotWhole,
    FileNotWhole,
    EventNotWhole,
    LiveLinesLost,
    LiveJournalNotRead,
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
    /// What is in [`LIVE`] after a power cut.
    live: [Vec<u8>; 2],
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
            live: self.live.clone(),
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
        for (path, content) in &reported.files {
            let there = disk.files.get(path);
            // In its place, or where it goes next.
            let places = next.files.iter().filter(|(_, goes)| *goes == content);
            let mut moved = places.map(|(place, _)| place).peekable();
            let replaced = disk.files.contains_key(path) && self.may_become(path, disk, next);
            let kept = if moved.peek().is_none() {
                replaced
            } else {
                moved.any(|place| disk.files.get(place) == Some(content))
            };
            match there {
                Some(there) if there == content => {}
                _ if kept => {}
                Some(_) => complain(Fault::ReportedFileNotWhole, path),
                None => complain(Fault::ReportedFileMissing, path),
            }
        }
        for path in disk.files.keys() {
            let reported = reported.files.contains_key(path);
            if !reported && !self.may_become(path, disk, next) {
                complain(Fault::FileNotWhole, path);
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
            let lines = self.lines_at(cut)[live];
            if !next.files.contains_key(*path) || lines == 0 {
                continue;
            }
            let found = self.beginning(live, disk).unwrap_or_default();
            if found.len() < length(&self.live[live], lines) {
                complain(Fault::LiveLinesLost, path);
            } else if live == 0 && lines > 1 && entries(&disk.live[0]) < Some(lines - 1) {
                complain(Fault::LiveJournalNotRead, path);
            }
        }
    }

    /// Whether a file is what a report will tell of, or the beginning of what is written line by line.
    fn may_become(&self, path: &str, disk: &Listing, next: &Listing) -> bool {
        let live = LIVE.iter().position(|live| *live == path);
        next.files.get(path).is_some_and(|told| {
            let beginning = live.and_then(|live| self.beginning(live, disk));
            beginning.is_some() || disk.files.get(path) == Some(told)
        })
    }

    /// What a disk has of a file of [`LIVE`], without NULs at its end; `None` when it is something else.
    fn beginning<'a>(&self, live: usize, disk: &'a Listing) -> Option<&'a [u8]> {
        let found = without_nuls(&disk.live[live]);
        self.live[live].starts_with(found).then_some(found)
    }

    /// Lines of [`LIVE`] that were written long enough before an entry of the log.
    fn lines_at(&self, cut: u64) -> [usize; 2] {
        let now = self.ticks.iter().rfind(|tick| tick.entry < cut);
        let long_ago = |tick: &&Tick| now.is_some_and(|now| tick.at_s + SYNCED_S <= now.at_s);
        let then = self.ticks.iter().rfind(long_ago);
        then.map_or([0, 0], |tick| tick.lines)
    }
}

fn without_nuls(bytes: &[u8]) -> &[u8] {
    let end = bytes.iter().rposition(|&byte| byte != 0);
    &bytes[..end.map_or(0, |last| last + 1)]
}

/// How many verdicts a reader finds in a journal.
fn entries(bytes: &[u8]) -> Option<usize> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("live.jsonl");
    fs::write(&path, bytes).unwrap();
    Some(journal::read(&path).ok()?.entries.len())
}

/// Bytes of so many lines.
fn length(text: &[u8], lines: usize) -> usize {
    let lines = text.split_inclusive(|&byte| byte == b'\n').take(lines);
    lines.map(<[u8]>::len).sum()
}

/// What was found after a power cut in front of an entry of the log.
fn disk(share: &Path, cut: u64, listing: &str) -> Listing {
    let live = |kind| fs::read(share.join(format!("live/{cut}.{kind}"))).unwrap_or_default();
    Listing {
        live: ["jsonl", "log"].map(live),
        ..Listing::new(listing)
    }
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

    let mut by_path: BTreeMap<(Fault, String), BTreeSet<u64>> = BTreeMap::new();
    let (mut unsynced, mut nuls) = (BTreeSet::new(), BTreeSet::new());
    for (cut, listing) in &cuts {
        let disk = disk(&share, *cut, listing);
        if disk.live.iter().any(|file| file.ends_with(&[0])) {
            nuls.insert(cut);
        }
        let faults = story.faults(*cut, &disk);
        for (fault, path) in faults {
            if path.starts_with(UNSYNCED) {
                unsynced.insert(cut);
            } else {
                by_path.entry((fault, path)).or_default().insert(*cut);
            }
        }
    }
    let near = |cut: u64| story.reports.iter().any(|r| r.entry.abs_diff(cut) <= NEAR);
    let seed = fs::read_to_string(share.join("cuts")).unwrap();
    let mut by_kind: BTreeMap<Fault, BTreeSet<u64>> = BTreeMap::new();
    let mut wrong = String::new();
    for ((fault, path), cuts) in &by_path {
        by_kind.entry(*fault).or_default().extend(cuts);
        writeln!(wrong, "{fault:?} {path} at {cuts:?}").unwrap();
    }
    let bad: BTreeSet<&u64> = by_kind.values().flatten().collect();
    let kinds = by_kind
        .iter()
        .map(|(kind, cuts)| format!(", {kind:?} at {}", cuts.len()));
    let kinds: String = kinds.collect();
    let said = format!(
        "Power cuts, seed {}: {} moments among {} entries of a disk's log, {} of them within {NEAR} entries of one of {} reports; something \
         reported was lost, or something was half there, at {} of them{kinds}; a live file ended in NULs at {}, and a file that nobody \
         synced was lost at {}.\n",
        seed.split(' ').next().unwrap(),
        cuts.len(),
        cuts.iter().map(|cut| cut.0).max().unwrap() - cuts.iter().map(|cut| cut.0).min().unwrap(),
        cuts.iter().filter(|cut| near(cut.0)).count(),
        story.reports.len(),
        bad.len(),
        nuls.len(),
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
    let end = story.reports.iter().rfind(|r| r.folder == "./monitor/");
    let running = story
        .ticks
        .iter()
        .rfind(|tick| tick.entry < end.unwrap().entry);
    assert!(wrong.is_empty(), "{said}{wrong}");
    let lines = running.unwrap().lines;
    assert!(
        lines.iter().all(|&lines| lines > 50),
        "{lines:?} lines at the end of the monitor"
    );
}
