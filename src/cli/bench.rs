//! `gapwatch bench`: time, memory and allocations of every stage from a camera's buffer to a CAN frame.

mod evidence;

use std::fs;
use std::io::Write;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use gapwatch::capture::open;
use gapwatch::lab::camera_buffers::buffer_of;
use gapwatch::live::cost::{
    Buffer, Chain, WARM_UP, ms, quantile, resident_bytes, shown_for, thread_cpu_time,
};
use gapwatch::model::encoder::products_in_registers;
use gapwatch::reference::Reference;
use serde::Serialize;

use super::loaded_model::LoadedModel;
use super::quick_reference::made_for;
use crate::cli::args::{BenchArgs, TableFormat};
use crate::cli::counting;
use evidence::EvidenceCost;

/// Number of frames, which are shown again and again.
const SHOWN: usize = 6;
/// Longest measurement: the rest of 20 s is for rendering and loading.
const MEASURE: Duration = Duration::from_secs(8);
/// Products of one run that measures what a core can do: about a millisecond.
const PEAK_PRODUCTS: u64 = 40_000_000;
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

/// Index of the encoder in [`STAGES`].
const ENCODER: usize = 4;

/// The result.
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
    /// Speed of the encoder's convolutions, two operations for each product; `None` if their number is not known.
    encoder_gflops: Option<f64>,
    /// Speed of a loop of products in registers on one core.
    peak_gflops: f64,
    frame_ms: f64,
    frame_p99_ms: f64,
    /// CPU time of a thread for one frame through all stages.
    cpu_ms: f64,
    /// Time to render one frame of the same size.
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

/// What was measured for one frame.
struct Sample {
    took: [Duration; STAGES.len()],
    allocations: [u64; STAGES.len()],
}

/// What one thread measured.
struct Measured {
    samples: Vec<Sample>,
    cpu: Duration,
}

pub fn run(args: &BenchArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    let (shown, render) = buffers(args)?;
    let began = Instant::now();
    let model = LoadedModel::load_in(&args.model, args.executor.into())?;
    let shipped = Reference::read(None).ok().filter(|reference| {
        reference
            .check_fits(Reference::BUILT_IN, &model.fingerprint)
            .is_ok()
    });
    let loaded = began.elapsed();
    let reference = match shipped {
        Some(reference) => reference,
        None => made_for(&model)?,
    };
    let began = Instant::now();
    let first = shown.first().context("the drive has no frames")?;
    Chain::new(&model.encoder, &reference)?.step(0, Duration::ZERO, first, &mut |_| {})?;
    let start = loaded + began.elapsed();

    let measured = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..args.threads)
            .map(|_| scope.spawn(|| measure(&model, &reference, &shown, MEASURE)))
            .collect();
        threads
            .into_iter()
            .map(|thread| {
                thread.join().unwrap_or_else(|_| {
                    Err(anyhow!("a measuring thread ended with an internal error"))
                })
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

/// The buffers that a camera would give for the first frames of a rendered drive, and the median time to render one.
fn buffers(args: &BenchArgs) -> anyhow::Result<(Vec<Buffer>, Duration)> {
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

fn measure(
    model: &LoadedModel,
    reference: &Reference,
    shown: &[Buffer],
    longest: Duration,
) -> anyhow::Result<Measured> {
    let mut chain = Chain::new(&model.encoder, reference)?;
    let mut samples = Vec::new();
    let mut cpu_before = Duration::ZERO;
    for (index, now, buffer) in shown_for(shown, longest) {
        if index == WARM_UP {
            cpu_before = thread_cpu_time();
        }
        let mut clock = Clock::start();
        chain.step(index, now, buffer, &mut |stage| clock.lap(stage))?;
        if index >= WARM_UP {
            samples.push(clock.sample);
        }
    }
    let count = u32::try_from(samples.len())?.max(1);
    Ok(Measured {
        samples,
        cpu: thread_cpu_time().saturating_sub(cpu_before) / count,
    })
}

/// Time and requests for memory since the last lap.
struct Clock {
    sample: Sample,
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
            allocations: counting::requests(),
            since: Instant::now(),
        }
    }

    fn lap(&mut self, stage: &str) {
        let took = self.since.elapsed();
        let requests = counting::requests() - self.allocations;
        if let Some(place) = STAGES.iter().position(|&name| name == stage) {
            self.sample.took[place] = took;
            self.sample.allocations[place] = requests;
        }
        self.allocations = counting::requests();
        self.since = Instant::now();
    }
}

fn summary(
    args: &BenchArgs,
    model: &LoadedModel,
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
    let cpu = measured.iter().map(|m| m.cpu).collect();
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
        cpu_ms: ms(quantile(cpu, 50)),
        rss_mib: mib(resident_bytes()?),
        start_ms: ms(start),
        binary_mib: mib(fs::metadata(std::env::current_exe()?)?.len()),
        evidence: None,
    })
}

/// Billions of operations per second, rounded to one decimal.
#[allow(clippy::cast_precision_loss)]
fn gflops(products: u64, time: Duration) -> f64 {
    (2.0 * products as f64 / time.as_secs_f64().max(1e-9) / 1e8).round() / 10.0
}

/// The peak speed of a core: the best of a few short runs, because other programs may use the core.
fn peak_gflops() -> f64 {
    let run = |_| {
        let began = Instant::now();
        gflops(products_in_registers(PEAK_PRODUCTS), began.elapsed())
    };
    (0..20).map(run).fold(0.0, f64::max)
}

#[allow(clippy::cast_precision_loss)]
fn mib(bytes: u64) -> f64 {
    (bytes as f64 / 1_048_576.0 * 100.0).round() / 100.0
}

/// Processor, cores and system, as far as they are known.
fn machine() -> String {
    let processor = fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("model name"))?;
        Some(line.split_once(':')?.1.trim().to_owned())
    });
    format!(
        "{}, {} cores, {} {}",
        processor.as_deref().unwrap_or("unknown processor"),
        std::thread::available_parallelism().map_or(1, usize::from),
        std::env::consts::OS,
        std::env::consts::ARCH
    )
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
    writeln!(out, "CPU time {:.3} ms a frame", bench.cpu_ms)?;
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
