//! The command line.

#[cfg(feature = "lab")]
mod lab;
mod model;
mod values;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use gapwatch::can::Sink;
use gapwatch::monitor::warn::Answer;
use gapwatch::record::events::Quota;
use gapwatch::reference::EvidenceKind;
use gapwatch::reference::gap::Metric;

#[cfg(feature = "lab")]
pub use lab::*;
pub use model::ModelArgs;
pub use values::TableFormat;
use values::{SOURCES, frames_a_second, named, rate, seconds, whole};

/// Watches the road through a lane model's own encoder, and warns on CAN when the road has left the domain that the
/// model knows.
#[derive(Debug, Parser)]
#[command(version, propagate_version = true, arg_required_else_help = true)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    Replay(ReplayArgs),
    Monitor(MonitorArgs),
    Calibrate(CalibrateArgs),
    Merge(MergeArgs),
    #[cfg(feature = "lab")]
    Compare(CompareArgs),
    #[cfg(feature = "lab")]
    Scene(SceneArgs),
    #[cfg(feature = "lab")]
    Inspect(InspectArgs),
    #[cfg(feature = "lab")]
    Evaluate(EvaluateArgs),
    #[cfg(feature = "lab")]
    Report(ReportArgs),
    #[cfg(feature = "lab")]
    Bench(BenchArgs),
    Doctor(DoctorArgs),
    PackageFiles(PackageFilesArgs),
}

/// Run a drive through the monitor, as in the car
///
/// Without SOURCE it runs the built-in drive of 60 s, which has fog from 20 s to 40 s. It prints one line on standard
/// output for each change of state.
#[derive(Debug, Args)]
#[command(after_help = format!("{SOURCES}\n\nExit codes with --check:\n  \
    0  at least 90 % of the time was judged, and there was no gap\n  1  there was a gap\n  \
    3  less than 90 % of the time was judged\n\nExample:\n  \
    gapwatch replay 'scene:sim?seed=5&condition=night:3@10-30' --can log:drive.log --journal drive.jsonl"))]
pub struct ReplayArgs {
    /// Source of the frames
    pub source: Option<String>,
    /// Reference file (default: the one inside the program)
    #[arg(long, value_name = "FILE")]
    pub reference: Option<PathBuf>,
    #[command(flatten)]
    pub model: ModelArgs,
    /// Answers that raise the warning: gap, change, lanes [default: gap,change; for pictures and the reference inside the
    /// program lanes]
    #[arg(long, value_name = "ANSWER,...", value_delimiter = ',')]
    pub warn: Vec<Answer>,
    /// Where CAN frames go: log:FILE (candump format), log:- (standard output), socketcan:IFACE (needs --speed
    /// realtime) or none
    #[arg(long, value_name = "SINK", default_value = "none")]
    pub can: Sink,
    /// The bus has CAN FD: also send GapDetail
    #[arg(long)]
    pub fd: bool,
    /// Journal file to write (JSON lines)
    #[arg(long, value_name = "FILE")]
    pub journal: Option<PathBuf>,
    /// MCAP recording to write, for example for Foxglove: the frames as JPEG, with their verdicts
    #[arg(long, value_name = "FILE")]
    pub mcap: Option<PathBuf>,
    /// Folder for frames and heat maps around the beginning of each alarm (default: no picture is kept)
    #[arg(long, value_name = "DIR")]
    pub evidence: Option<PathBuf>,
    /// Largest number of events in the evidence folder; the oldest are removed first
    #[arg(long, value_name = "N", default_value_t = 200, requires = "evidence", value_parser = whole::<u32>(1..=100_000))]
    pub evidence_events: u32,
    /// Largest size of the evidence folder, megabytes
    #[arg(long, value_name = "MB", default_value_t = 256, requires = "evidence", value_parser = whole::<u32>(1..=1_000_000))]
    pub evidence_mb: u32,
    /// Pace of the drive
    #[arg(long, value_enum, default_value = "max")]
    pub speed: Speed,
    /// Report the result in the exit code
    #[arg(long)]
    pub check: bool,
    /// Print only errors
    #[arg(short, long)]
    pub quiet: bool,
}

/// Watch a camera and warn on CAN, as the board file says
///
/// Runs until SIGTERM, SIGINT or SIGHUP, and then reports on the bus that it has stopped. A second signal ends it at
/// once. It prints one line on standard output for each change of state. If the source in the board file is a drive,
/// the drive is shown at its own pace, and the monitor ends with it.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  gapwatch monitor --board boards/desk-vcan.toml --seconds 60 --journal drive.jsonl"
)]
pub struct MonitorArgs {
    /// Board file: camera, bus and reference (boards/README.md describes it)
    #[arg(long, value_name = "FILE.toml")]
    pub board: PathBuf,
    /// Stop after this many seconds
    #[arg(long, value_name = "N", value_parser = whole::<u32>(1..=u32::MAX))]
    pub seconds: Option<u32>,
    /// Journal file to write (JSON lines); each line is in the file as soon as it is written
    #[arg(long, value_name = "FILE")]
    pub journal: Option<PathBuf>,
    /// Folder for frames and heat maps around the beginning of each alarm, instead of the board file's folder; if
    /// neither names a folder, no picture is kept
    #[arg(long, value_name = "DIR")]
    pub evidence: Option<PathBuf>,
    /// Print only errors
    #[arg(short, long)]
    pub quiet: bool,
}

impl ReplayArgs {
    /// How much evidence may be kept.
    pub fn quota(&self) -> Quota {
        Quota {
            bytes: u64::from(self.evidence_mb) * 1_000_000,
            events: self.evidence_events as usize,
            keep: None,
        }
    }
}

/// Pace of a replay.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Speed {
    /// At the pace of the drive
    Realtime,
    /// As fast as possible
    Max,
}

/// Make a reference from nominal drives or simulator images
///
/// With several sources, every second one is held out to scale the gaps. Of a single source, the last third is held
/// out. A rendered drive with seed=A..B means one drive for each seed. Of the drives given with --held-out, three of
/// four set the rate of false alarms, and the fourth judges it. Without them, the reference says that its rate is not
/// shown.
///
/// The order of the drives on the command line does not matter. With --surveys, what the encoder sees of each drive is
/// kept on disk. Then a run that was killed continues where it was, another rate or metric needs no second look at the
/// drives (but metrics of histograms need maps, which are kept only for them), and gapwatch merge makes one reference
/// of several.
#[derive(Debug, Args)]
#[command(after_help = format!("{SOURCES}\n\nExample:\n  gapwatch calibrate --sim town01 town02 --model lane.onnx --taps e2,e3,e4 \
    --size 800x288 --mean 0.36,0.37,0.37 --std 0.26,0.27,0.28 --out town.json"))]
pub struct CalibrateArgs {
    /// Nominal sources; each is one drive
    #[arg(long, value_name = "SOURCE", num_args = 1.., required_unless_present_any = ["shard", "base"])]
    pub sim: Vec<String>,
    /// Reference to which accepted roads are added, without looking at its own drives again: built-in, or a file. Its
    /// metric, window, rates and thresholds stay
    #[arg(long, value_name = "built-in|FILE", conflicts_with_all = ["sim", "held_out", "labelled", "causes", "shard",
        "false_alarms_per_hour", "metric", "window", "evidence", "rate", "idle_rate"])]
    pub base: Option<String>,
    /// Roads on which the lane model is known to work; together they are one more nominal domain
    #[arg(long, value_name = "SOURCE", num_args = 1..)]
    pub accept: Vec<String>,
    /// The same for several domains: sources of one name are one domain
    #[arg(long, value_name = "NAME=SOURCE", num_args = 1.., value_parser = named_domain)]
    pub accept_as: Vec<(String, String)>,
    /// Nominal drives that set and judge the rate of false alarms
    #[arg(long, value_name = "SOURCE", num_args = 1..)]
    pub held_out: Vec<String>,
    /// Use drives that are far from all others of their kind all the same, with a warning instead of an error. A held-out
    /// drive that judges the rate may always be far, because it moves no threshold
    #[arg(long)]
    pub allow_far: bool,
    /// Rendered drives from which a forecast of lost lanes is learnt; each is used as it is and under every condition
    #[arg(long, value_name = "scene:…", num_args = 1..)]
    pub labelled: Vec<String>,
    /// Drives from which it learns what the cause of a gap or a change is: a source without a condition stands for itself
    /// under every kind of condition that can be rendered over it, at severities 3 to 5 from 28 s on; a source with one
    /// condition=KIND:SEVERITY@FROM-TO is used as it is
    #[arg(long, value_name = "SOURCE", num_args = 1..)]
    pub causes: Vec<String>,
    /// Wanted rate of false alarms: entries into Gap for each hour of nominal driving
    #[arg(long, value_name = "R", default_value_t = 1.0, value_parser = rate)]
    pub false_alarms_per_hour: f64,
    /// Metric that measures the gap
    #[arg(long, value_name = "NAME", default_value_t = Metric::DEFAULT)]
    pub metric: Metric,
    /// Length of the detector's window, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0, value_parser = seconds)]
    pub window: f64,
    /// What the road is judged by: windows has a nominal spread of each window's length and changes of the road against
    /// its own past, frames has one window with the nominal spread of single frames
    #[arg(long, value_name = "NAME", default_value_t = EvidenceKind::Windows)]
    pub evidence: EvidenceKind,
    /// Frames a second that will be judged, for which the thresholds are made; drives with more frames are thinned
    #[arg(long, value_name = "HZ", default_value_t = 10.0, value_parser = frames_a_second)]
    pub rate: f64,
    /// Frames a second that will be judged while the road is clearly nominal (default: --rate)
    #[arg(long, value_name = "HZ", value_parser = frames_a_second)]
    pub idle_rate: Option<f64>,
    /// Folder that keeps what the encoder sees of each drive, one file for each drive, for later runs and for gapwatch
    /// merge: about 4 KB a frame of the built-in model, 25 KB for histograms (default: a temporary folder in $TMPDIR or
    /// /var/tmp)
    #[arg(long, value_name = "DIR")]
    pub surveys: Option<PathBuf>,
    /// Only look at the drives and list them in FILE, for gapwatch merge; there may be any number of drives, of any
    /// role
    #[arg(long, requires = "surveys")]
    pub shard: bool,
    #[command(flatten)]
    pub model: ModelArgs,
    /// Reference file to write
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// Most characters in the name of an accepted domain.
const DOMAIN_NAME_MAX: usize = 64;

/// Parses the name of an accepted domain and its source. A source without a name is not cut at its own `=`.
fn named_domain(text: &str) -> Result<(String, String), String> {
    let (name, source) = named(text)?;
    let wrong = |c: char| matches!(c, '?' | ':' | '/') || c.is_control();
    if name.trim().is_empty() || name.chars().count() > DOMAIN_NAME_MAX || name.contains(wrong) {
        return Err(format!(
            "wanted NAME=SOURCE, with a name of 1 to {DOMAIN_NAME_MAX} characters without ?, : and /"
        ));
    }
    Ok((name, source))
}

/// Merge references, or shards of one, made by gapwatch calibrate
///
/// On one kind of processor, the result is bit for bit the reference that calibrate would make of all their drives, in
/// any order and grouping. Surveys are read from every folder NAME.surveys beside the files, and from the folders of
/// --surveys. A drive without a survey is looked at again.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  gapwatch calibrate --sim 'scene:sim?seed=1..200' --surveys a.surveys --shard --out a.json\n  \
    gapwatch calibrate --sim 'scene:sim?seed=201..400' --surveys b.surveys --shard --out b.json\n  \
    gapwatch merge a.json b.json --out sim.json"
)]
pub struct MergeArgs {
    /// References or shards of the same model, metric, window and wanted rate; no drive may be in two of them
    #[arg(value_name = "FILE", required = true, num_args = 1..)]
    pub files: Vec<PathBuf>,
    /// More folders of surveys, written by calibrate --surveys
    #[arg(long, value_name = "DIR", num_args = 1..)]
    pub surveys: Vec<PathBuf>,
    #[command(flatten)]
    pub model: ModelArgs,
    /// Reference file to write
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// Check whether a computer can do what its board asks, and say what to do if it cannot
///
/// Prints one line for each check, with pass, warn, fail or left out: board file, model, reference, camera and its
/// formats, bus and its other nodes, time and memory of a frame, clock, folders. It sends nothing. The exit code is 0
/// if no check fails, else 2. A camera that the monitor is using is busy: stop the monitor first.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  gapwatch doctor --board boards/desk-vcan.toml --journal drive.jsonl"
)]
pub struct DoctorArgs {
    /// Board file: camera, bus and reference (boards/README.md describes it)
    #[arg(long, value_name = "FILE.toml")]
    pub board: PathBuf,
    /// Journal that the monitor will write
    #[arg(long, value_name = "FILE")]
    pub journal: Option<PathBuf>,
    /// Folder that will hold the evidence
    #[arg(long, value_name = "DIR")]
    pub evidence: Option<PathBuf>,
    /// Format of the result
    #[arg(long, value_enum, default_value = "table")]
    pub format: TableFormat,
}

/// Write the man pages and shell completions of a package
#[derive(Debug, Args)]
#[command(hide = true)]
pub struct PackageFilesArgs {
    /// Folder to write to, laid out like /usr/share
    #[arg(value_name = "DIR")]
    pub out: PathBuf,
}
