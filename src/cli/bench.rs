//! `gapwatch bench`: time, memory and allocations of every stage from a camera's buffer to a CAN frame.

pub(super) mod buffers;

mod evidence;

use std::fs;
use std::io::Write;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use gapwatch::calibration::survey::Keep;
use gapwatch::calibration::{Domain, LabelledMeans, Wanted, calibrate};
use gapwatch::can::message::{GapHealth, GapStatus};
use gapwatch::can::sender::StatusSender;
use gapwatch::can::{CanFrame, CanSettings, SinkError, WarningSink};
use gapwatch::capture::pixels::Layout;
use gapwatch::capture::undefined::Undefined;
use gapwatch::capture::{Frame, open};
use gapwatch::features::attention::{EnergyMap, common_size, energy_from_features};
use gapwatch::features::energies::BlockMeans;
use gapwatch::features::image_quality::QualityMeter;
use gapwatch::model::encoder::{EncoderSession, products_in_registers};
use gapwatch::model::preprocess::Preprocessor;
use gapwatch::monitor::alarm::{Alarm, Judgement, Reason};
use gapwatch::monitor::camera_health::CameraHealth;
use gapwatch::monitor::detector::{Detector, Evidence};
use gapwatch::monitor::intake::Intake;
use gapwatch::monitor::pipeline::Monitor;
use gapwatch::reference::{Provenance, Reference};
use serde::Serialize;

use super::Model;
use super::cpu_time::cpu_time;
use crate::cli::args::{BenchArgs, TableFormat};
use crate::cli::counting;
use buffers::buffer_of;
use evidence::EvidenceCost;

/// Frames that are shown, over and over.
const SHOWN: usize = 6;
/// Longest measurement, and most frames: the rest of 20 s is for rendering and loading.
const MEASURE: Duration = Duration::from_secs(8);
const FRAMES_MAX: u64 = 500;
/// First frames, which fill buffers and caches and are not counted.
const WARM_UP: u64 = 5;
/// Products of one run that measures what a core can do: about a millisecond.
const PEAK_PRODUCTS: u64 = 40_000_000;
/// Time between frames of the drive.
const PERIOD: Duration = Duration::from_millis(100);

/// Names of the stages, in the order of the chain.
const STAGES: [&str; 9] = [
    "capture",
    "health",
    "preprocess",
    "quality",
    "encoder",
    "energy",
    "histogram",
    "detector",
    "can",
];

/// Place of the encoder among them.
const ENCODER: usize = 4;

/// What is written.
#[derive(Serialize)]
struct Bench {
    machine: String,
    threads: usize,
    model: String,
    frame: String,
    pixels: String,
    frames: u64,
    stages: Vec<Stage>,
    encoder_ms: f64,
    /// What ran the encoder.
    executor: String,
    /// Of the encoder's convolutions, two operations a product; `None` where their number is not known.
    encoder_gflops: Option<f64>,
    /// Of a loop of products in registers on one core.
    peak_gflops: f64,
    frame_ms: f64,
    frame_p99_ms: f64,
    /// CPU time of a thread for one frame through all stages; `None` where the machine does not tell.
    cpu_ms: Option<f64>,
    /// Rendering one frame of the same size.
    render_ms: f64,
    rss_mib: f64,
    start_ms: f64,
    binary_mib: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    evidence: Option<EvidenceCost>,
}

/// One stage.
#[derive(Serialize)]
struct Stage {
    name: &'static str,
    median_ms: f64,
    p99_ms: f64,
    /// Requests for memory in one frame, median.
    allocations: u64,
}

/// What was measured of one frame.
struct Sample {
    took: [Duration; STAGES.len()],
    allocations: [u64; STAGES.len()],
}

/// What one thread measured.
struct Measured {
    samples: Vec<Sample>,
    cpu: Option<Duration>,
}

pub fn run(args: &BenchArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    let (shown, render) = buffers(args)?;
    let began = Instant::now();
    let model = Model::load_in(&args.model, args.executor.into())?;
    let shipped = Reference::read(None)
        .ok()
        .filter(|reference| reference.check_fits("built-in", &model.fingerprint).is_ok());
    let loaded = began.elapsed();
    let reference = match shipped {
        Some(reference) => reference,
        None => made_for(&model)?,
    };
    let began = Instant::now();
    let (layout, bytes) = shown.first().context("the drive has no frames")?;
    let first = frame_of(0, Duration::ZERO, *layout, bytes)?;
    Monitor::new(&model.encoder, &reference)?.step(&first);
    let start = loaded + began.elapsed();

    let measured = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..args.threads)
            .map(|_| scope.spawn(|| measure(&model, &reference, &shown, MEASURE)))
            .collect();
        threads
            .into_iter()
            .map(|thread| {
                thread
                    .join()
                    .unwrap_or_else(|_| Err(anyhow!("a measuring thread gave up")))
            })
            .collect::<anyhow::Result<Vec<Measured>>>()
    })?;
    let mut bench = summary(args, &model, &measured, start, render)?;
    if args.evidence {
        bench.evidence = Some(evidence::cost(args, &model, &reference)?);
    }
    match args.format {
        TableFormat::Json => writeln!(out, "{}", serde_json::to_string_pretty(&bench)?)?,
        TableFormat::Table => table(&bench, out)?,
    }
    Ok(0)
}

/// A camera's buffer.
type Shown = (Layout, Vec<u8>);

/// What a camera would give of the first frames of a rendered drive, and the median time that rendering one took.
fn buffers(args: &BenchArgs) -> anyhow::Result<(Vec<Shown>, Duration)> {
    let (width, height) = (args.frame.width, args.frame.height);
    let mut source = open(&format!("scene:sim?seed=7&seconds=3&size={width}x{height}"))?;
    let (mut shown, mut took) = (Vec::new(), Vec::new());
    loop {
        let began = Instant::now();
        let Some(frame) = source.next_frame()? else {
            break;
        };
        took.push(began.elapsed());
        if shown.len() < SHOWN {
            shown.push(buffer_of(&frame.picture?.picture(), args.pixels.into())?);
        }
    }
    Ok((shown, quantile(took, 50)))
}

/// A frame as the camera's source makes it of a buffer.
fn frame_of(sequence: u64, at: Duration, layout: Layout, bytes: &[u8]) -> anyhow::Result<Frame> {
    let pixels = layout.pixels(bytes).map_err(|why| anyhow!(why))?;
    Ok(Frame {
        sequence,
        captured_at: at,
        picture: Ok(pixels),
    })
}

/// A reference for a model that has none: of two short drives, enough to have something to compare with.
pub(super) fn made_for(model: &Model) -> anyhow::Result<Reference> {
    let drives = ["scene:sim?seed=1&seconds=3", "scene:sim?seed=2&seconds=3"].map(str::to_owned);
    let surveys = model.survey(&drives, Keep::Maps, "making a reference")?;
    let domain = Domain {
        name: "simulation".to_owned(),
        drives: &surveys,
    };
    let wanted = Wanted {
        metric: "log-energy-js".parse().map_err(|why| anyhow!("{why}"))?,
        window_s: 1.0,
        false_alarms_per_hour: 1.0,
    };
    let no_labels: &[LabelledMeans] = &[];
    let made = calibrate(&[domain], &[], no_labels, &model.spec.taps, wanted)?;
    Ok(Reference::new(
        model.fingerprint.clone(),
        wanted.metric,
        wanted.window_s,
        made.false_alarms,
        Provenance {
            gapwatch: env!("CARGO_PKG_VERSION").to_owned(),
            command: "bench".to_owned(),
            sources: made.sources,
        },
        made.components,
    ))
}

/// The chain with a clock between its stages.
struct Stages<'a> {
    reference: &'a Reference,
    camera: CameraHealth,
    preprocessor: Preprocessor,
    meter: QualityMeter,
    session: EncoderSession,
    maps: Vec<EnergyMap>,
    means: Vec<BlockMeans>,
    intake: Intake,
    taken: Vec<u32>,
    detector: Detector,
    alarm: Alarm,
    sender: StatusSender,
    sink: Swallow,
}

/// A bus that takes everything.
struct Swallow;

impl WarningSink for Swallow {
    fn send(&mut self, _at: Duration, frame: &CanFrame) -> Result<(), SinkError> {
        std::hint::black_box(frame);
        Ok(())
    }
}

/// Time of each of some frames through all stages, for `longest` at most.
pub(super) fn chain_times(
    model: &Model,
    reference: &Reference,
    frames: &[Frame],
    longest: Duration,
) -> anyhow::Result<Vec<Duration>> {
    let pixels = frames
        .iter()
        .filter_map(|frame| frame.picture.as_ref().ok());
    let shown: Vec<Shown> = pixels.map(|p| (p.layout(), p.bytes().to_vec())).collect();
    let measured = measure(model, reference, &shown, longest)?;
    let whole = measured.samples.iter().map(|s| s.took.iter().sum());
    Ok(whole.collect())
}

fn measure(
    model: &Model,
    reference: &Reference,
    shown: &[Shown],
    longest: Duration,
) -> anyhow::Result<Measured> {
    let mut stages = Stages::new(model, reference)?;
    let mut samples = Vec::new();
    let mut cpu_before = None;
    let began = Instant::now();
    for (index, (layout, bytes)) in (0..WARM_UP + FRAMES_MAX).zip(shown.iter().cycle()) {
        if index == WARM_UP {
            cpu_before = cpu_time();
        }
        if index > WARM_UP && began.elapsed() > longest {
            break;
        }
        let now = PERIOD * u32::try_from(index)?;
        let sample = stages.step(index, now, *layout, bytes)?;
        if index >= WARM_UP {
            samples.push(sample);
        }
    }
    let count = u32::try_from(samples.len())?.max(1);
    let cpu = cpu_before
        .zip(cpu_time())
        .map(|(before, after)| after.saturating_sub(before) / count);
    Ok(Measured { samples, cpu })
}

impl<'a> Stages<'a> {
    fn new(model: &Model, reference: &'a Reference) -> anyhow::Result<Self> {
        let of = &model.spec.preprocessing;
        let taps = model.spec.taps.len();
        let detector = Detector::new(reference);
        Ok(Self {
            reference,
            camera: CameraHealth::default(),
            preprocessor: Preprocessor::new(of),
            meter: QualityMeter::new(of),
            session: model.encoder.session()?,
            maps: vec![EnergyMap::default(); taps],
            means: vec![BlockMeans::default(); taps],
            intake: Intake::new(reference.metric, taps, common_size(of.width, of.height)),
            taken: vec![0; detector.taken_len()],
            detector,
            alarm: Alarm::default(),
            sender: StatusSender::new(CanSettings::default())?,
            sink: Swallow,
        })
    }

    /// One frame through the camera's source, the stages of `Monitor::step` and the sender.
    fn step(
        &mut self,
        sequence: u64,
        now: Duration,
        layout: Layout,
        bytes: &[u8],
    ) -> anyhow::Result<Sample> {
        let cannot = |why: Undefined| anyhow!("a frame cannot be judged: {why}");
        let mut clock = Clock::start();

        let frame = frame_of(sequence, now, layout, bytes)?;
        clock.lap();

        self.camera.check(&frame).map_err(cannot)?;
        clock.lap();

        let pixels = frame.picture?;
        let input = self.preprocessor.input(&pixels).map_err(cannot)?;
        clock.lap();

        std::hint::black_box(self.meter.measure(input));
        clock.lap();

        let features = self.session.run(input).map_err(|why| anyhow!(why))?;
        clock.lap();

        let blocks = self.maps.iter_mut().zip(&mut self.means);
        for (features, (map, means)) in features.iter().zip(blocks) {
            energy_from_features("", features, map).map_err(cannot)?;
            means.take(features);
        }
        clock.lap();

        let components = &self.reference.components;
        self.intake
            .take(&self.maps, &self.means, components, &mut self.taken)
            .map_err(cannot)?;
        clock.lap();

        let evidence = self.detector.observe(now, &self.taken);
        self.alarm.step(
            now,
            match &evidence {
                Ok(seen) => seen.judgement(),
                Err(why) => Judgement::Cannot(Reason::from(why)),
            },
        );
        clock.lap();

        self.send(now, evidence.as_ref().ok());
        clock.lap();
        Ok(clock.sample)
    }

    fn send(&mut self, now: Duration, seen: Option<&Evidence>) {
        let mut block_scores = [None; 3];
        if let Some(seen) = seen {
            for (score, block) in block_scores.iter_mut().zip(&seen.blocks) {
                *score = Some(block.score);
            }
        }
        let status = GapStatus {
            state: self.alarm.state(),
            reason: self.alarm.reason(),
            gap_stored: self.alarm.gap_stored(),
            score: seen.map(|seen| seen.score),
            block_scores,
            fault_detection_counter: self.alarm.fault_detection_counter(),
            frame_age: Some(Duration::ZERO),
        };
        let health = GapHealth {
            strict: self.reference.strict,
            bus_state: gapwatch::can::BusState::Unknown,
            frame_rate_hz: None,
            dropped_frames: 0,
            latency_p50: None,
            latency_p99: None,
            window_fill: seen.map(|seen| seen.fill),
            reference_id: 0,
        };
        self.sender.update(now, &status);
        self.sender.update_health(now, &health);
        // This bus refuses nothing.
        let _ = self.sender.poll(now, &mut self.sink);
    }
}

/// Time and requests for memory since the last lap.
struct Clock {
    sample: Sample,
    stage: usize,
    allocations: u64,
    since: Instant,
}

impl Clock {
    fn start() -> Self {
        Self {
            sample: Sample {
                took: [Duration::ZERO; STAGES.len()],
                allocations: [0; STAGES.len()],
            },
            stage: 0,
            allocations: counting::requests(),
            since: Instant::now(),
        }
    }

    fn lap(&mut self) {
        self.sample.took[self.stage] = self.since.elapsed();
        self.sample.allocations[self.stage] = counting::requests() - self.allocations;
        self.stage += 1;
        self.allocations = counting::requests();
        self.since = Instant::now();
    }
}

fn summary(
    args: &BenchArgs,
    model: &Model,
    measured: &[Measured],
    start: Duration,
    render: Duration,
) -> anyhow::Result<Bench> {
    let samples: Vec<&Sample> = measured.iter().flat_map(|m| &m.samples).collect();
    let stages: Vec<Stage> = STAGES
        .iter()
        .enumerate()
        .map(|(stage, name)| {
            let took: Vec<Duration> = samples.iter().map(|s| s.took[stage]).collect();
            let mut allocations: Vec<u64> = samples.iter().map(|s| s.allocations[stage]).collect();
            allocations.sort_unstable();
            Stage {
                name,
                median_ms: ms(quantile(took.clone(), 50)),
                p99_ms: ms(quantile(took, 99)),
                allocations: allocations
                    .get(allocations.len() / 2)
                    .copied()
                    .unwrap_or_default(),
            }
        })
        .collect();
    let whole: Vec<Duration> = samples.iter().map(|s| s.took.iter().sum()).collect();
    let cpu: Option<Vec<Duration>> = measured.iter().map(|m| m.cpu).collect();
    Ok(Bench {
        machine: machine(),
        threads: args.threads,
        model: model.spec.name.clone(),
        frame: format!("{}x{}", args.frame.width, args.frame.height),
        pixels: args.pixels.to_string(),
        frames: samples.len() as u64,
        encoder_ms: stages[ENCODER].median_ms,
        render_ms: ms(render),
        executor: model.encoder.executor(),
        encoder_gflops: (model.encoder.products()).map(|products| {
            gflops(
                products,
                Duration::from_secs_f64(stages[ENCODER].median_ms / 1e3),
            )
        }),
        peak_gflops: peak_gflops(),
        stages,
        frame_ms: ms(quantile(whole.clone(), 50)),
        frame_p99_ms: ms(quantile(whole, 99)),
        cpu_ms: cpu.map(|cpu| ms(quantile(cpu, 50))),
        rss_mib: resident_mib()?,
        start_ms: ms(start),
        binary_mib: mib(fs::metadata(std::env::current_exe()?)?.len()),
        evidence: None,
    })
}

pub(super) fn quantile(mut of: Vec<Duration>, percent: usize) -> Duration {
    of.sort_unstable();
    let last = of.len().saturating_sub(1);
    of.get(last * percent / 100).copied().unwrap_or_default()
}

/// Operations per second in billions, to a tenth.
#[allow(clippy::cast_precision_loss)]
fn gflops(products: u64, time: Duration) -> f64 {
    (2.0 * products as f64 / time.as_secs_f64().max(1e-9) / 1e8).round() / 10.0
}

/// What a core can do at most: the best of a few short runs, since others may be using it.
fn peak_gflops() -> f64 {
    let run = |_| {
        let began = Instant::now();
        gflops(products_in_registers(PEAK_PRODUCTS), began.elapsed())
    };
    (0..20).map(run).fold(0.0, f64::max)
}

/// To the microsecond.
pub(super) fn ms(time: Duration) -> f64 {
    (time.as_secs_f64() * 1e6).round() / 1e3
}

#[allow(clippy::cast_precision_loss)]
fn mib(bytes: u64) -> f64 {
    (bytes as f64 / 1_048_576.0 * 100.0).round() / 100.0
}

/// Processor, cores and system, as far as they are told.
fn machine() -> String {
    let processor = fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("model name"))?;
        Some(line.split_once(':')?.1.trim().to_owned())
    });
    format!(
        "{}, {} cores, {} {}",
        processor.as_deref().unwrap_or("processor not told"),
        std::thread::available_parallelism().map_or(1, usize::from),
        std::env::consts::OS,
        std::env::consts::ARCH
    )
}

/// Memory of this program in use now.
pub(super) fn resident_mib() -> anyhow::Result<f64> {
    let status = "/proc/self/status";
    let text = fs::read_to_string(status).context(status)?;
    let kib: Option<u64> = text
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))
        .and_then(|rest| rest.split_whitespace().next()?.parse().ok());
    Ok(mib(
        1024 * kib.with_context(|| format!("{status}: no VmRSS"))?
    ))
}

fn table(bench: &Bench, out: &mut dyn Write) -> anyhow::Result<()> {
    let Bench {
        machine,
        model,
        threads,
        frame,
        pixels,
        frames,
        ..
    } = bench;
    writeln!(
        out,
        "{machine}\n{model}, {frames} frames of {frame} {pixels}, {threads} at a time"
    )?;
    writeln!(
        out,
        "{:<12}{:>12}{:>12}{:>13}",
        "stage", "median ms", "p99 ms", "allocations"
    )?;
    for stage in &bench.stages {
        writeln!(
            out,
            "{:<12}{:>12.3}{:>12.3}{:>13}",
            stage.name, stage.median_ms, stage.p99_ms, stage.allocations
        )?;
    }
    writeln!(
        out,
        "{:<12}{:>12.3}{:>12.3}",
        "frame", bench.frame_ms, bench.frame_p99_ms
    )?;
    let speed = bench.encoder_gflops;
    let speed = speed.map_or(String::new(), |speed| format!("{speed:.1} of "));
    writeln!(
        out,
        "encoder run by {}: {speed}{:.1} GFLOP/s that a core can do",
        bench.executor, bench.peak_gflops
    )?;
    writeln!(
        out,
        "rendering a frame of this size {:.2} ms, {:.0} a second on one thread",
        bench.render_ms,
        1e3 / bench.render_ms
    )?;
    if let Some(cpu_ms) = bench.cpu_ms {
        writeln!(out, "CPU time {cpu_ms:.3} ms a frame")?;
    }
    writeln!(
        out,
        "resident {:.1} MiB, start to first verdict {:.0} ms, program {:.1} MiB",
        bench.rss_mib, bench.start_ms, bench.binary_mib
    )?;
    if let Some(cost) = &bench.evidence {
        writeln!(out, "{}", cost.line())?;
    }
    Ok(())
}
