//! The command line as typed.

#[cfg(feature = "lab")]
mod lab;

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::str::FromStr;

use clap::{Args, Parser, Subcommand, ValueEnum};
use gapwatch::can::Sink;
use gapwatch::model::ModelOptions;
use gapwatch::record::events::Quota;
use gapwatch::reference::gap::Metric;
use gapwatch::reference::{WINDOW_S_MAX, WINDOW_S_MIN};

#[cfg(feature = "lab")]
pub use lab::*;

/// Watches the road through a lane model's own encoder and warns on CAN when it has left the domain the model knows.
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

/// How sources are named, for the help of every command that takes one.
const SOURCES: &str = "Sources (in quotes: shells take ? and & for themselves):
  scene:sim[?seed=7&seconds=60&fps=10&condition=fog:3@20-40]   rendered drive; severity reached at 20 s, gone at 40 s;
                                                               also size=WxH, without=ELEMENT, looks sim-realistic, game
  random:[seed=1&frames=60]                                    random pixels
  DIR[?fps=10]                                                 folder of PNG or JPEG images in name order, 10 a second
                                                               unless ?fps= says otherwise
  FILE                                                         one image, or a video (through ffmpeg)
  FILE.mcap[?topic=/camera]                                    recording with images of ROS 2 or Foxglove; its only topic with
                                                               images unless ?topic= names one";

/// Run a drive through the monitor, as in the car
///
/// Without SOURCE: the built-in drive, 60 s with fog from 20 s to 40 s. One line on standard output for each change of
/// state.
#[derive(Debug, Args)]
#[command(after_help = format!("{SOURCES}\n\nExit code with --check: 0 judged at least 90 % of the time and no gap, 1 gap, \
    3 could not judge\n\nExample:\n  gapwatch replay 'scene:sim?seed=5&condition=night:3@10-30' --can log:drive.log --journal drive.jsonl"))]
pub struct ReplayArgs {
    /// What to look at
    pub source: Option<String>,
    /// Reference file; left out = the one inside the program
    #[arg(long, value_name = "FILE")]
    pub reference: Option<PathBuf>,
    #[command(flatten)]
    pub model: ModelArgs,
    /// Where CAN frames go: log:FILE (candump format), log:-, socketcan:IFACE (with --speed realtime) or none
    #[arg(long, value_name = "SINK", default_value = "none")]
    pub can: Sink,
    /// The bus has CAN FD: send GapDetail too
    #[arg(long)]
    pub fd: bool,
    /// Journal to write, JSON lines
    #[arg(long, value_name = "FILE")]
    pub journal: Option<PathBuf>,
    /// MCAP recording to write: the frames as JPEG with their verdicts on one line of time, as Foxglove shows them
    #[arg(long, value_name = "FILE")]
    pub mcap: Option<PathBuf>,
    /// Folder for frames and heat maps around the beginning of each alarm; left out = no picture is kept
    #[arg(long, value_name = "DIR")]
    pub evidence: Option<PathBuf>,
    /// Most events that the folder of evidence holds; the oldest go first
    #[arg(long, value_name = "N", default_value_t = 200, requires = "evidence", value_parser = whole::<u32>(1..=100_000))]
    pub evidence_events: u32,
    /// Most megabytes that it holds
    #[arg(long, value_name = "MB", default_value_t = 256, requires = "evidence", value_parser = whole::<u32>(1..=1_000_000))]
    pub evidence_mb: u32,
    /// Pace of the drive
    #[arg(long, value_enum, default_value = "max")]
    pub speed: Speed,
    /// Let the exit code say what was found
    #[arg(long)]
    pub check: bool,
    /// Say nothing but errors
    #[arg(short, long)]
    pub quiet: bool,
}

/// Watch a camera and warn on CAN, as the board file says
///
/// Runs until SIGTERM, SIGINT or SIGHUP, then says on the bus that it has stopped; a second signal ends it at once. One line on standard output for each change of
/// state. A board whose source is a drive shows it at its own pace and ends with it.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  gapwatch monitor --board boards/desk-vcan.toml --seconds 60 --journal drive.jsonl"
)]
pub struct MonitorArgs {
    /// Board file: camera, bus, reference; boards/README.md has the words
    #[arg(long, value_name = "FILE.toml")]
    pub board: PathBuf,
    /// Stop after this many seconds
    #[arg(long, value_name = "N", value_parser = whole::<u32>(1..=u32::MAX))]
    pub seconds: Option<u32>,
    /// Journal to write, JSON lines; each line is there as soon as it is written
    #[arg(long, value_name = "FILE")]
    pub journal: Option<PathBuf>,
    /// Folder for frames and heat maps around the beginning of each alarm, instead of the board's; without either no picture is
    /// kept
    #[arg(long, value_name = "DIR")]
    pub evidence: Option<PathBuf>,
    /// Say nothing but errors
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
    /// As fast as the drive was
    Realtime,
    /// As fast as the computer can
    Max,
}

/// Make a reference from nominal drives or simulator images
///
/// With several sources every second one is held out to scale the gaps; of a single one, its last third. A rendered
/// drive with seed=A..B stands for one drive a seed. Drives given with --held-out set the rate of false alarms (three
/// of four) and judge it (the fourth); without them the reference says that its rate is not shown.
///
/// Drives are taken in an order of their own, so that on the command line does not matter. With --surveys what the encoder
/// sees of each drive stays on disk: a run that was killed goes on where it was, another rate or metric costs no second look
/// (but histograms need maps, which are kept only for them), and gapwatch merge makes one reference of several.
#[derive(Debug, Args)]
#[command(after_help = format!("{SOURCES}\n\nExample:\n  gapwatch calibrate --sim town01 town02 --model lane.onnx --taps e2,e3,e4 \
    --size 800x288 --mean 0.36,0.37,0.37 --std 0.26,0.27,0.28 --out town.json"))]
pub struct CalibrateArgs {
    /// Nominal sources; each is one drive
    #[arg(long, value_name = "SOURCE", num_args = 1.., required_unless_present = "shard")]
    pub sim: Vec<String>,
    /// Roads on which the lane model is known to work; each argument is one more nominal domain, but rendered drives that differ
    /// in their seeds alone are one
    #[arg(long, value_name = "SOURCE", num_args = 1..)]
    pub accept: Vec<String>,
    /// Nominal drives that set and judge the rate of false alarms
    #[arg(long, value_name = "SOURCE", num_args = 1..)]
    pub held_out: Vec<String>,
    /// For --metric lane-risk: rendered drives from which the model's losses are learnt, each as it is and under every
    /// condition
    #[arg(long, value_name = "scene:…", num_args = 1..)]
    pub labelled: Vec<String>,
    /// Entries into Gap an hour of nominal driving
    #[arg(long, value_name = "R", default_value_t = 1.0, value_parser = rate)]
    pub false_alarms_per_hour: f64,
    /// How gaps are measured
    #[arg(long, value_name = "NAME", default_value_t = Metric::DEFAULT)]
    pub metric: Metric,
    /// Length of the detector's window, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0, value_parser = seconds)]
    pub window: f64,
    /// Folder that keeps what the encoder sees of each drive, one file a drive, for later runs and for gapwatch merge: about 4
    /// KB a frame of the built-in model, 25 KB for histograms. Left out = a temporary folder in $TMPDIR or /var/tmp
    #[arg(long, value_name = "DIR")]
    pub surveys: Option<PathBuf>,
    /// Only look: FILE lists the drives, of which there may be any number of any role, for gapwatch merge
    #[arg(long, requires = "surveys")]
    pub shard: bool,
    #[command(flatten)]
    pub model: ModelArgs,
    /// Reference file to write
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// Merge references, or shards of one, made by gapwatch calibrate
///
/// The result is the reference that calibrate would make of all their drives at once, bit for bit, whatever the order and
/// grouping, on one kind of processor. Surveys are looked for in every folder NAME.surveys beside the files and in those of
/// --surveys; a drive without one is looked at again.
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
    /// More folders of surveys, as calibrate --surveys keeps them
    #[arg(long, value_name = "DIR", num_args = 1..)]
    pub surveys: Vec<PathBuf>,
    #[command(flatten)]
    pub model: ModelArgs,
    /// Reference file to write
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// Check whether a board can do what its file asks, and say what to do where it cannot
///
/// One line a check, pass, warn, fail or left out: board file, model, reference, camera and its formats, bus and who else is on it,
/// time and memory of a frame, clock, folders. Sends nothing. Exit code 0 when nothing fails, else 2. A camera that the
/// monitor is using is busy: stop it first.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  gapwatch doctor --board boards/desk-vcan.toml --journal drive.jsonl"
)]
pub struct DoctorArgs {
    /// Board file: camera, bus, reference; boards/README.md has the words
    #[arg(long, value_name = "FILE.toml")]
    pub board: PathBuf,
    /// Journal that the monitor is to write
    #[arg(long, value_name = "FILE")]
    pub journal: Option<PathBuf>,
    /// Folder that is to hold evidence
    #[arg(long, value_name = "DIR")]
    pub evidence: Option<PathBuf>,
    /// How the result is written
    #[arg(long, value_enum, default_value = "table")]
    pub format: TableFormat,
}

/// Write what a package holds beside the program: man pages and shell completions
#[derive(Debug, Args)]
#[command(hide = true)]
pub struct PackageFilesArgs {
    /// Folder to write, laid out as /usr/share
    #[arg(value_name = "DIR")]
    pub out: PathBuf,
}

/// How a measurement is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TableFormat {
    Table,
    Json,
}

/// The model, if not the built-in one
#[derive(Debug, Args)]
#[command(next_help_heading = "Model")]
pub struct ModelArgs {
    /// ONNX file of an encoder; options left out are read from a .toml of the same name beside it
    #[arg(long, value_name = "FILE.onnx")]
    pub model: Option<PathBuf>,
    /// Names of one to three tapped values
    #[arg(long, value_name = "A,B,C", value_delimiter = ',')]
    pub taps: Option<Vec<String>>,
    /// Name of the lane head's output, a logit a pixel of the input; only inspect and evaluate run it
    #[arg(long, value_name = "NAME")]
    pub lane: Option<String>,
    /// Input size, pixels
    #[arg(long = "size", id = "model-size", value_name = "WxH")]
    pub size: Option<String>,
    /// Mean of red, green, blue, of values 0..1
    #[arg(long, value_name = "R,G,B", value_parser = numbers::<f32, 3>)]
    pub mean: Option<[f32; 3]>,
    /// Standard deviation of red, green, blue, of values 0..1
    #[arg(long, value_name = "R,G,B", value_parser = numbers::<f32, 3>)]
    pub std: Option<[f32; 3]>,
    /// Part of the picture used, as shares of it
    #[arg(long, value_name = "LEFT,TOP,WIDTH,HEIGHT", value_parser = numbers::<f64, 4>)]
    pub crop: Option<[f64; 4]>,
}

impl ModelArgs {
    /// The options without the file.
    pub fn options(&self) -> ModelOptions {
        ModelOptions {
            taps: self.taps.clone(),
            lane: self.lane.clone(),
            size: self.size.clone(),
            mean: self.mean,
            std: self.std,
            crop: self.crop,
        }
    }
}

fn numbers<T: FromStr, const N: usize>(text: &str) -> Result<[T; N], String> {
    let numbers: Option<Vec<T>> = text
        .split(',')
        .map(|number| number.trim().parse().ok())
        .collect();
    numbers
        .and_then(|numbers| numbers.try_into().ok())
        .ok_or_else(|| format!("wanted {N} numbers between commas"))
}

fn seconds(text: &str) -> Result<f64, String> {
    let range = WINDOW_S_MIN..=WINDOW_S_MAX;
    let seconds = text.parse().ok().filter(|s| range.contains(s));
    seconds.ok_or_else(|| format!("wanted seconds from {WINDOW_S_MIN} to {WINDOW_S_MAX}"))
}

fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|r| (1e-6..=3_600.0).contains(r));
    rate.ok_or_else(|| "wanted entries an hour from 0.000001 to 3600".to_owned())
}

/// A whole number in a range, refused in plain words.
fn whole<T>(range: RangeInclusive<T>) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync
where
    T: FromStr + PartialOrd + Display + Clone + Send + Sync + 'static,
{
    move |text| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        number.ok_or_else(|| {
            format!(
                "wanted a whole number from {} to {}",
                range.start(),
                range.end()
            )
        })
    }
}
