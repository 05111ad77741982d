//! The command line as typed.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::str::FromStr;

use clap::{Args, Parser, Subcommand, ValueEnum};
use gapwatch::calibration::{PaperBinning, Temperature};
use gapwatch::can::Sink;
use gapwatch::capture::pixels::PixelFormat;
use gapwatch::lab::scene::{Condition, Element, Look};
use gapwatch::model::ModelOptions;
use gapwatch::model::encoder::Executor;
use gapwatch::record::evidence::Quota;
use gapwatch::reference::gap::Metric;
use gapwatch::reference::{WINDOW_S_MAX, WINDOW_S_MIN};

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
    Compare(CompareArgs),
    Scene(SceneArgs),
    Inspect(InspectArgs),
    Evaluate(EvaluateArgs),
    Report(ReportArgs),
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
    /// Journal to write, JSON lines; it appears when the monitor stops
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
    /// Roads that the lane model is known to bear; each argument is one more nominal domain, but rendered drives that differ
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

/// Compare image sets: the first is the reference for the others
#[derive(Debug, Args)]
#[command(after_help = format!("{SOURCES}\n\nThe metrics paper and ...-pearson are correlations (1 = alike), the others \
    distances (0 = alike): chi2, js (bits), hellinger and w1 on attention or log-energy histograms; frechet and mahalanobis on \
    channels. frechet needs twice as many images as channels.\n\nExample:\n  gapwatch compare town01 town05 highway 'random:' --metric all --format csv"))]
pub struct CompareArgs {
    /// The reference, then the sets to compare with it
    #[arg(value_name = "SOURCE", required = true, num_args = 2..)]
    pub sources: Vec<String>,
    /// Metric, or all
    #[arg(long, value_name = "NAME|all", default_value = "all", value_parser = metrics)]
    pub metric: Metrics,
    /// Temperature of the metric paper: energy units, or times the reference's median peak energy as in 0.2peak
    #[arg(long, value_name = "T", default_value = "10", value_parser = temperature)]
    pub temperature: Temperature,
    /// Levels of the metric paper's histogram
    #[arg(long, value_name = "N", default_value_t = PaperBinning::PUBLISHED.levels, value_parser = whole::<usize>(2..=65_536))]
    pub levels: usize,
    /// First level that the metric paper counts
    #[arg(long, value_name = "N", default_value_t = PaperBinning::PUBLISHED.first, value_parser = whole::<usize>(0..=65_536))]
    pub first_level: usize,
    #[command(flatten)]
    pub model: ModelArgs,
    /// How the result is written
    #[arg(long, value_enum, default_value = "table")]
    pub format: Format,
    /// Also write every histogram to this file, JSON
    #[arg(long, value_name = "FILE")]
    pub histograms: Option<PathBuf>,
}

/// How a table is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    Table,
    Json,
    Csv,
}

/// The metrics asked for.
#[derive(Clone, Debug)]
pub struct Metrics(pub Vec<Metric>);

/// Show where the encoder looks, frame by frame
///
/// DIR gets one sheet a frame, NNNNNN.png: what the model sees with the lanes it marks in blue-green, then the energies
/// of each tap over the darkened picture, brighter is more, each from 0 to its own peak; below them the picture as it is, and
/// for each tap which of 4x4 regions differ from the reference, brighter is farther, eight nominal spreads are brightest; and
/// how far each channel is from nominal, over a band of two spreads. With a reference of histograms, instead of these: the
/// live histogram in orange, the reference in blue-green, a white line under the bins that are counted, the others grey.
/// inspect.json has the numbers, each frame judged by itself.
#[derive(Debug, Args)]
#[command(after_help = format!("{SOURCES}\n\nExample:\n  gapwatch inspect drive.mp4 --out sheets --count 6"))]
pub struct InspectArgs {
    /// What to look at
    pub source: String,
    /// Folder to write; must not exist or be empty
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// How many frames, evenly spread over the source
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = whole::<u32>(1..=100_000))]
    pub count: u32,
    /// Reference to compare with; left out = the one inside the program, if it fits the model
    #[arg(long, value_name = "FILE")]
    pub reference: Option<PathBuf>,
    #[command(flatten)]
    pub model: ModelArgs,
}

/// Judge lane models and the monitor on scenes and drives that nothing was tuned on
///
/// lane_iou: lane IoU of every model in every look of the world, in plain day and under every condition at severities 1 to
/// 5, and how much of the encoder's energy lies on lanes; each model is asked at its own size. domain_detection: how many
/// drives enter Gap within 2 s of an event, at 1 and 0.1 false alarms an hour. false_alarms: entries into Gap on nominal
/// drives, at thresholds made for 10, 1 and 0.1 an hour. These two judge one reference. field_sets: AUROC and recall at 5 %
/// false positives of every metric on windows of 1, 5 and 10 images of other roads and simulators. paper_table: similarity
/// of image sets as wholes, as in the paper. With --out, each key is kept as soon as it is done.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  gapwatch evaluate --only field_sets --field sets --out results.json\n  gapwatch evaluate --from results.json --format markdown > RESULTS.md"
)]
pub struct EvaluateArgs {
    /// ONNX files, each with a .toml of the same name beside it that names its lane output; left out = the built-in model
    #[arg(long, value_name = "FILE.onnx", num_args = 1..)]
    pub model: Vec<PathBuf>,
    /// What to evaluate; left out = everything
    #[arg(long, value_enum, value_name = "KEY")]
    pub only: Option<EvaluateKey>,
    /// Few scenes and drives: seconds instead of minutes, with wide intervals
    #[arg(long)]
    pub quick: bool,
    /// Reference to judge; left out = the one inside the program
    #[arg(long, value_name = "FILE")]
    pub reference: Option<PathBuf>,
    /// The look that is nominal to that reference
    #[arg(long, value_name = "NAME", default_value_t = Look::Sim)]
    pub look: Look,
    /// Drives an event
    #[arg(long, value_name = "N", conflicts_with = "quick", value_parser = whole::<u32>(1..=10_000))]
    pub drives: Option<u32>,
    /// Hours of nominal drives
    #[arg(long, value_name = "HOURS", conflicts_with = "quick", value_parser = whole::<u32>(1..=10_000))]
    pub hours: Option<u32>,
    /// Scenes a look, condition and severity
    #[arg(long, value_name = "N", conflicts_with = "quick", value_parser = whole::<u32>(1..=100_000))]
    pub scenes: Option<u32>,
    /// Folder of image sets for field_sets and paper_table; calibration/README.md lists what it holds
    #[arg(long, value_name = "DIR")]
    pub field: Option<PathBuf>,
    /// How the result is written
    #[arg(long, value_enum, default_value = "table")]
    pub format: ResultsFormat,
    /// File that gets the result as JSON too; of a file that is there, only what is evaluated is replaced
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Of speed_error, name the point that misses least at this share of one core of the machine that measured, percent
    #[arg(long, value_name = "PERCENT", value_parser = percent)]
    pub budget: Option<f64>,
    /// Draw speed_error as an SVG picture too
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
    /// Show the results in these files instead of evaluating
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = ["model", "quick", "reference", "drives", "hours", "scenes", "field", "out"])]
    pub from: Vec<PathBuf>,
}

/// How results are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ResultsFormat {
    Table,
    Json,
    /// One table alone: lane_iou
    Csv,
    Markdown,
}

/// Keys of an evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum EvaluateKey {
    /// Lane IoU over looks, conditions and severities
    #[value(name = "lane_iou")]
    LaneIou,
    /// How soon events that leave the domain are entered as Gap
    #[value(name = "domain_detection")]
    DomainDetection,
    /// Entries into Gap on nominal drives
    #[value(name = "false_alarms")]
    FalseAlarms,
    /// Whether the gap foretells that the lane model fails, by metric and baseline
    #[value(name = "lane_failure")]
    LaneFailure,
    /// Cost of a judged second against what is missed, by model, taps, window and frame rate
    #[value(name = "speed_error")]
    SpeedError,
    /// How well each metric tells other roads' image sets from a simulation's; needs --field
    #[value(name = "field_sets")]
    FieldSets,
    /// Similarity of adapted simulation, plain simulation and noise with real images, and with simulation, as in the paper
    #[value(name = "paper_table")]
    PaperTable,
}

impl EvaluateKey {
    /// As it is typed and written.
    pub fn name(self) -> String {
        let value = self.to_possible_value();
        value.map_or_else(String::new, |value| value.get_name().to_owned())
    }
}

/// Show a journal as one HTML file
///
/// Timeline, alarms with what is behind them, gaps by tap, what was judged and what not. The file needs no network.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  gapwatch replay --journal drive.jsonl --evidence seen\n  gapwatch report drive.jsonl --evidence seen --out drive.html"
)]
pub struct ReportArgs {
    /// Journal, as replay --journal writes it
    #[arg(value_name = "JOURNAL")]
    pub journal: PathBuf,
    /// Folder of replay --evidence: its pictures are shown beside the alarms
    #[arg(long, value_name = "DIR")]
    pub evidence: Option<PathBuf>,
    /// HTML file to write
    #[arg(long, value_name = "FILE.html")]
    pub out: PathBuf,
}

/// Measure time, memory and allocations from picture to CAN frame
///
/// A short rendered drive passes stage by stage, with everything rendered and loaded beforehand; about 10 s.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  gapwatch bench --model lane.onnx --frame 1920x1080 --format json"
)]
pub struct BenchArgs {
    #[command(flatten)]
    pub model: ModelArgs,
    /// How the result is written
    #[arg(long, value_enum, default_value = "table")]
    pub format: TableFormat,
    /// Chains that run at the same time, one thread each
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = threads)]
    pub threads: usize,
    /// Size of the camera's pictures, pixels
    #[arg(long, value_name = "WxH", default_value = "1280x720")]
    pub frame: PictureSize,
    /// Format of the camera's pixels
    #[arg(long, value_enum, default_value = "yuyv")]
    pub pixels: PixelChoice,
    /// Who runs the encoder: the fastest that can, or tract, to compare with
    #[arg(long, value_enum, default_value = "fastest")]
    pub executor: ExecutorChoice,
    /// Also measure what the evidence recorder costs the frame loop, at 25 frames a second: a minute more
    #[arg(long)]
    pub evidence: bool,
}

/// A camera's pixel format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PixelChoice {
    Yuyv,
    Nv12,
    Mjpg,
    Rgb3,
    Bgr3,
}

impl From<PixelChoice> for PixelFormat {
    fn from(choice: PixelChoice) -> Self {
        match choice {
            PixelChoice::Yuyv => Self::Yuyv,
            PixelChoice::Nv12 => Self::Nv12,
            PixelChoice::Mjpg => Self::Mjpg,
            PixelChoice::Rgb3 => Self::Rgb3,
            PixelChoice::Bgr3 => Self::Bgr3,
        }
    }
}

impl std::fmt::Display for PixelChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&format!("{self:?}").to_uppercase())
    }
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

/// Who runs the encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ExecutorChoice {
    Fastest,
    Tract,
}

impl From<ExecutorChoice> for Executor {
    fn from(choice: ExecutorChoice) -> Self {
        match choice {
            ExecutorChoice::Fastest => Self::Fastest,
            ExecutorChoice::Tract => Self::Tract,
        }
    }
}

/// How a measurement is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TableFormat {
    Table,
    Json,
}

fn percent(text: &str) -> Result<f64, String> {
    let percent = text.parse().ok().filter(|p| (0.01..=10_000.0).contains(p));
    percent.ok_or_else(|| "wanted a share of one core from 0.01 to 10000 percent".to_owned())
}

fn threads(text: &str) -> Result<usize, String> {
    let threads = text.parse().ok().filter(|n| (1..=64).contains(n));
    threads.ok_or_else(|| "wanted a number of threads from 1 to 64".to_owned())
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

fn metrics(text: &str) -> Result<Metrics, String> {
    if text == "all" {
        return Ok(Metrics(Metric::of_sets()));
    }
    let Ok(metric) = text.parse::<Metric>() else {
        let names: Vec<String> = Metric::of_sets().iter().map(Metric::to_string).collect();
        return Err(format!("wanted all, or one of {}", names.join(", ")));
    };
    metric.check_of_sets().map_err(|why| why.to_string())?;
    Ok(Metrics(vec![metric]))
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

fn temperature(text: &str) -> Result<Temperature, String> {
    let positive = |number: &str| {
        number
            .parse::<f64>()
            .ok()
            .filter(|t| t.is_normal() && *t > 0.0)
    };
    match text.strip_suffix("peak") {
        Some(share) => positive(share).map(Temperature::OfPeak),
        None => positive(text).map(Temperature::Absolute),
    }
    .ok_or_else(|| "wanted a temperature above 0, as in 10 or 0.2peak".to_owned())
}

/// Render labelled scenes of the road simulator
///
/// Each scene is one moment of a drive of its own. DIR gets frames/NNNNNN.png (RGB), masks/NNNNNN.png (255 on a lane
/// line) and scenes.jsonl (seed, time, world, conditions and SHA-256 of the pixels of each).
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  gapwatch scene --out scenes --count 100 --seed 7 --condition fog:3"
)]
pub struct SceneArgs {
    /// Folder to write; must not exist or be empty
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    pub out: Option<PathBuf>,
    /// Print the names that can be used instead of rendering
    #[arg(long, value_enum, exclusive = true, value_name = "WHAT")]
    pub list: Option<SceneList>,
    /// How the world looks
    #[arg(long, value_name = "NAME", default_value_t = Look::Sim)]
    pub look: Look,
    /// Element left out of the world; may be repeated
    #[arg(long, value_name = "ELEMENT")]
    pub without: Vec<Element>,
    /// How many scenes
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = whole::<u32>(1..=1_000_000))]
    pub count: u32,
    /// Seed of the set
    #[arg(long, value_name = "S", default_value_t = 1, value_parser = whole::<u32>(0..=u32::MAX - 1))]
    pub seed: u32,
    /// Condition over all scenes, KIND:SEVERITY; may be repeated
    #[arg(long, value_name = "KIND:SEVERITY")]
    pub condition: Vec<Condition>,
    /// Size of the pictures, pixels
    #[arg(long, value_name = "WxH", default_value = "320x160")]
    pub size: PictureSize,
}

/// Names that `scene --list` prints.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SceneList {
    /// Looks of the world
    Looks,
    /// Elements that can be left out
    Elements,
    /// Kinds of condition
    Conditions,
}

/// A picture's size as typed, `WxH`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PictureSize {
    pub width: u32,
    pub height: u32,
}

impl FromStr for PictureSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |side: &str| side.parse().ok().filter(|s| (16..=8_192).contains(s));
        text.split_once('x')
            .and_then(|(width, height)| {
                Some(Self {
                    width: side(width)?,
                    height: side(height)?,
                })
            })
            .ok_or_else(|| {
                "wanted WIDTHxHEIGHT, each from 16 to 8192, for example 320x160".to_owned()
            })
    }
}
