//! The commands that are not in the car's program.

use std::path::PathBuf;
use std::str::FromStr;

use clap::{Args, ValueEnum};
use gapwatch::calibration::{PaperBinning, Temperature};
use gapwatch::capture::pixels::PixelFormat;
use gapwatch::lab::scene::{Condition, Element, Look, stretch_m};
use gapwatch::model::encoder::Executor;
use gapwatch::reference::gap::Metric;

use super::model::ModelArgs;
use super::values::{SOURCES, TableFormat, frames_a_second, whole};

/// Compare image sets with the first one
#[derive(Debug, Args)]
#[command(after_help = format!("{SOURCES}\n\n\
    The metrics paper and ...-pearson are correlations (1 = equal). The others are distances (0 = equal): chi2, js (bits), \
    hellinger and w1 on attention or log-energy histograms, frechet and mahalanobis on channels. frechet needs twice as \
    many images as channels.\n\nExample:\n  \
    gapwatch compare town01 town05 highway 'random:' --metric all --format csv"))]
pub struct CompareArgs {
    /// The reference, then the sets to compare with it
    #[arg(value_name = "SOURCE", required = true, num_args = 2..)]
    pub sources: Vec<String>,
    /// Metric, or all of them
    #[arg(long, value_name = "NAME|all", default_value = "all", value_parser = metrics)]
    pub metric: Metrics,
    /// Temperature of the metric paper: in units of energy, or as a multiple of the reference's median peak energy
    /// (0.2peak)
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
    /// Format of the result
    #[arg(long, value_enum, default_value = "table")]
    pub format: Format,
    /// Also write every histogram to this JSON file
    #[arg(long, value_name = "FILE")]
    pub histograms: Option<PathBuf>,
}

/// Format of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    Table,
    Json,
    Csv,
}

/// The metrics that were asked for.
#[derive(Clone, Debug)]
pub struct Metrics(pub Vec<Metric>);

/// Show where the encoder looks, frame by frame
///
/// DIR gets one sheet for each frame, NNNNNN.png. The sheet shows what the model sees, with the lanes that it marks in
/// blue-green. Beside it are the energies of each tap over the darkened picture: brighter is more, from 0 to the peak
/// of that tap. Below them is the picture as it is, and for each tap the 4x4 regions that differ from the reference:
/// brighter is farther, and eight nominal spreads are brightest. Then follows how far each channel is from nominal,
/// over a band of two spreads. With a reference of histograms, the histograms are shown instead of these: the live one
/// in orange, the reference in blue-green, with a white line under the bins that are counted; the other bins are grey.
/// inspect.json has the numbers. Each frame is judged alone.
#[derive(Debug, Args)]
#[command(after_help = format!("{SOURCES}\n\nExample:\n  gapwatch inspect drive.mp4 --out sheets --count 6"))]
pub struct InspectArgs {
    /// Source of the frames
    pub source: String,
    /// Folder to write; it must be new or empty
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Number of frames, evenly spread over the source
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = whole::<u32>(1..=100_000))]
    pub count: u32,
    /// Reference to compare with (default: the one inside the program, if it fits the model)
    #[arg(long, value_name = "FILE")]
    pub reference: Option<PathBuf>,
    #[command(flatten)]
    pub model: ModelArgs,
}

/// Measure lane models and the monitor on scenes and drives that were not used for tuning
///
/// lane_iou: lane IoU of every model in every look of the world, on plain days and under every condition with
/// severities 1 to 5, and how much of the encoder's energy is on lanes. Each model gets scenes of its own input size.
/// domain_detection: how many drives enter Gap within 2 s of an event, at 1 and 0.1 false alarms an hour. false_alarms:
/// entries into Gap on nominal drives, at thresholds made for 10, 1 and 0.1 false alarms an hour. cause: which cause is told
/// of each kind of condition. These three judge one reference. field_sets: AUROC, and recall at 5 % false positives, of every metric on windows of 1, 5 and 10 images of
/// other roads and simulators. real_lanes: precision, recall and F1 of lane models on real pictures with drawn lanes, and
/// how well the forecast of lost lanes foretells them. paper_table: similarity of whole image sets, as in the paper. With --out, the result of
/// each key is kept as soon as it is done.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  gapwatch evaluate --only field_sets --field sets --out results.json\n  gapwatch evaluate --from results.json --format markdown > RESULTS.md"
)]
pub struct EvaluateArgs {
    /// ONNX files, each with a .toml file of the same name beside it that names its lane output (default: the built-in
    /// model)
    #[arg(long, value_name = "FILE.onnx", num_args = 1..)]
    pub model: Vec<PathBuf>,
    /// What to evaluate (default: everything)
    #[arg(long, value_enum, value_name = "KEY")]
    pub only: Option<EvaluateKey>,
    /// Use few scenes and drives: it takes seconds instead of minutes, and the intervals are wide
    #[arg(long)]
    pub quick: bool,
    /// Reference to judge (default: the one inside the program)
    #[arg(long, value_name = "FILE")]
    pub reference: Option<PathBuf>,
    /// For domain_detection: more references of the same model, judged on the same drives, in tables of their own
    #[arg(long, value_name = "FILE", num_args = 1..)]
    pub also: Vec<PathBuf>,
    /// The look that is nominal for this reference
    #[arg(long, value_name = "NAME", default_value_t = Look::Sim)]
    pub look: Look,
    /// For domain_detection, false_alarms and cause: mean length of the stretches through which the roads of the drives
    /// pass, metres; 0 for roads of one kind
    #[arg(long, value_name = "METRES", default_value_t = 0, value_parser = stretch)]
    pub stretch: u32,
    /// For false_alarms: frames a second of the drives (default: the rate that the reference names)
    #[arg(long, value_name = "HZ", value_parser = frames_a_second)]
    pub fps: Option<f64>,
    /// Number of drives for each event
    #[arg(long, value_name = "N", conflicts_with = "quick", value_parser = whole::<u32>(1..=10_000))]
    pub drives: Option<u32>,
    /// Hours of nominal drives
    #[arg(long, value_name = "HOURS", conflicts_with = "quick", value_parser = whole::<u32>(1..=10_000))]
    pub hours: Option<u32>,
    /// Number of scenes for each look, condition and severity
    #[arg(long, value_name = "N", conflicts_with = "quick", value_parser = whole::<u32>(1..=100_000))]
    pub scenes: Option<u32>,
    /// Folder of image sets for field_sets, real_lanes and paper_table; calibration/README.md lists what it holds
    #[arg(long, value_name = "DIR")]
    pub field: Option<PathBuf>,
    /// Format of the result
    #[arg(long, value_enum, default_value = "table")]
    pub format: ResultsFormat,
    /// Also write the result to this JSON file; in a file that exists, only what is evaluated is replaced
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// For speed_error: name the point that misses least within this share of one core of the measuring machine,
    /// percent
    #[arg(long, value_name = "PERCENT", value_parser = percent)]
    pub budget: Option<f64>,
    /// Also draw speed_error as an SVG picture
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
    /// Show the results of these files, and evaluate nothing
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = ["model", "quick", "reference", "drives", "hours", "scenes", "field", "out"])]
    pub from: Vec<PathBuf>,
}

impl EvaluateArgs {
    /// The number of drives for each event: as asked for, else that of the full or of the quick evaluation.
    pub fn drives_or(&self, (full, quick): (u32, u32)) -> u32 {
        self.drives.unwrap_or(if self.quick { quick } else { full })
    }
}

/// Format of results.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ResultsFormat {
    Table,
    Json,
    /// Only the table lane_iou
    Csv,
    Markdown,
}

/// Keys of an evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum EvaluateKey {
    /// Lane IoU over looks, conditions and severities
    #[value(name = "lane_iou")]
    LaneIou,
    /// How soon the monitor enters Gap after an event that leaves the domain
    #[value(name = "domain_detection")]
    DomainDetection,
    /// Entries into Gap on nominal drives
    #[value(name = "false_alarms")]
    FalseAlarms,
    /// Which cause the monitor tells of an event whose cause is known
    #[value(name = "cause")]
    Cause,
    /// Whether the gap predicts that the lane model fails, by metric and baseline
    #[value(name = "lane_failure")]
    LaneFailure,
    /// Cost of a judged second and share of missed events, by model, taps, window and frame rate
    #[value(name = "speed_error")]
    SpeedError,
    /// How well each metric distinguishes image sets of other roads from those of a simulation; needs --field
    #[value(name = "field_sets")]
    FieldSets,
    /// F1 of lane models on real pictures with drawn lanes, and how well the forecast foretells what they lose; needs
    /// --field
    #[value(name = "real_lanes")]
    RealLanes,
    /// Similarity of adapted simulation, plain simulation and noise to real images and to simulation, as in the paper
    #[value(name = "paper_table")]
    PaperTable,
}

impl EvaluateKey {
    /// The name on the command line and in results.
    pub fn name(self) -> String {
        let value = self.to_possible_value();
        value.map_or_else(String::new, |value| value.get_name().to_owned())
    }
}

/// Show a journal as one HTML file
///
/// The file shows a timeline, the alarms with their causes, the gaps by tap, and what was judged and what was not. It
/// needs no network.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  gapwatch replay --journal drive.jsonl --evidence seen\n  gapwatch report drive.jsonl --evidence seen --out drive.html"
)]
pub struct ReportArgs {
    /// Journal, written with --journal
    #[arg(value_name = "JOURNAL")]
    pub journal: PathBuf,
    /// Folder written with --evidence; its pictures are shown beside the alarms
    #[arg(long, value_name = "DIR")]
    pub evidence: Option<PathBuf>,
    /// HTML file to write
    #[arg(long, value_name = "FILE.html")]
    pub out: PathBuf,
}

/// Measure time, memory and allocations from picture to CAN frame
///
/// Runs a short rendered drive through every stage. The drive is rendered and the model is loaded before. It takes
/// about 10 s.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  gapwatch bench --model lane.onnx --frame 1920x1080 --format json"
)]
pub struct BenchArgs {
    #[command(flatten)]
    pub model: ModelArgs,
    /// Format of the result
    #[arg(long, value_enum, default_value = "table")]
    pub format: TableFormat,
    /// Number of chains that run at the same time, each on its own thread
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = threads)]
    pub threads: usize,
    /// Size of the camera's pictures, pixels
    #[arg(long, value_name = "WxH", default_value = "1280x720")]
    pub frame: PictureSize,
    /// Format of the camera's pixels
    #[arg(long, value_enum, default_value = "yuyv")]
    pub pixels: PixelChoice,
    /// What runs the encoder: the fastest executor that can, or tract for comparison
    #[arg(long, value_enum, default_value = "fastest")]
    pub executor: ExecutorChoice,
    /// Also measure what the evidence recorder costs the frame loop, at 25 frames a second; this takes one more minute
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

/// Render labelled scenes of the road simulator
///
/// Each scene is one moment of another drive. DIR gets frames/NNNNNN.png (RGB), masks/NNNNNN.png (255 on a lane line)
/// and scenes.jsonl (seed, time, world, conditions and SHA-256 of the pixels of each).
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  gapwatch scene --out scenes --count 100 --seed 7 --condition fog:3"
)]
pub struct SceneArgs {
    /// Folder to write; it must be new or empty
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    pub out: Option<PathBuf>,
    /// Print the names that can be used, and render nothing
    #[arg(long, value_enum, exclusive = true, value_name = "WHAT")]
    pub list: Option<SceneList>,
    /// Look of the world
    #[arg(long, value_name = "NAME", default_value_t = Look::Sim)]
    pub look: Look,
    /// Element to leave out of the world; may be repeated
    #[arg(long, value_name = "ELEMENT")]
    pub without: Vec<Element>,
    /// Number of scenes
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = whole::<u32>(1..=1_000_000))]
    pub count: u32,
    /// Seed of the set
    #[arg(long, value_name = "S", default_value_t = 1, value_parser = whole::<u32>(0..=u32::MAX - 1))]
    pub seed: u32,
    /// Condition of all scenes, KIND:SEVERITY; may be repeated
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

/// A picture's size, `WxH`.
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

/// What runs the encoder.
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

fn percent(text: &str) -> Result<f64, String> {
    let percent = text.parse().ok().filter(|p| (0.01..=10_000.0).contains(p));
    percent.ok_or_else(|| "wanted a share of one core from 0.01 to 10000 percent".to_owned())
}

fn threads(text: &str) -> Result<usize, String> {
    let threads = text.parse().ok().filter(|n| (1..=64).contains(n));
    threads.ok_or_else(|| "wanted a number of threads from 1 to 64".to_owned())
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

fn stretch(text: &str) -> Result<u32, &'static str> {
    stretch_m(text).ok_or("wanted 0 or 100 to 10000 metres")
}
