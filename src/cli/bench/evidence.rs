//! What the evidence recorder costs the frame loop: the same drive in real time, in blocks with and without the
//! recorder.

use std::ops::Range;
use std::time::{Duration, Instant};

use gapwatch::capture::pixels::Pixels;
use gapwatch::capture::{Frame, open};
use gapwatch::live::cost::{ms, quantile};
use gapwatch::monitor::pipeline::Monitor;
use gapwatch::record::events::{EventRecorder, Quota};
use gapwatch::reference::Reference;
use serde::Serialize;

use crate::cli::args::BenchArgs;
use crate::cli::loaded_model::LoadedModel;

/// Number of blocks; every second block has the recorder.
const BLOCKS: u32 = 4;
/// Frames of a block (14 s) and its frames in fog (3 s): each block has one alarm, which ends within the block.
const BLOCK_FRAMES: u32 = 350;
const FOG: Range<u32> = 25..100;
/// Time between frames.
const PERIOD: Duration = Duration::from_millis(40);

/// Times of a frame through the monitor.
#[derive(Serialize)]
pub struct EvidenceCost {
    /// Frames of each kind.
    frames: usize,
    off_median_ms: f64,
    off_p99_ms: f64,
    on_median_ms: f64,
    on_p99_ms: f64,
    /// Events that were written, and frames for which the writer had no time.
    events: u64,
    dropped_frames: u64,
}

impl EvidenceCost {
    /// The result as one readable line.
    pub fn line(&self) -> String {
        let more = |on: f64, off: f64| 100.0 * (on / off - 1.0);
        format!(
            "evidence off: median {:.3} ms, p99 {:.3} ms; on: {:.3} ({:+.1} %), {:.3} ({:+.1} %); {} frames each, {} events, {} frames left out",
            self.off_median_ms,
            self.off_p99_ms,
            self.on_median_ms,
            more(self.on_median_ms, self.off_median_ms),
            self.on_p99_ms,
            more(self.on_p99_ms, self.off_p99_ms),
            self.frames,
            self.events,
            self.dropped_frames
        )
    }
}

/// Runs a monitor at the pace of a camera.
pub fn cost(
    args: &BenchArgs,
    model: &LoadedModel,
    reference: &Reference,
) -> anyhow::Result<EvidenceCost> {
    let pictures = |condition: &str| -> anyhow::Result<Vec<Pixels>> {
        let (width, height) = (args.frame.width, args.frame.height);
        let name = format!("scene:sim?seed=7&seconds=1&size={width}x{height}{condition}");
        let mut source = open(&name)?;
        let mut pictures = Vec::new();
        while let Some(frame) = source.next_frame()? {
            pictures.extend(frame.picture);
        }
        Ok(pictures)
    };
    let (plain, foggy) = (pictures("")?, pictures("&condition=fog:5")?);
    let folder = tempfile::tempdir()?;
    let mut recorder = EventRecorder::start(folder.path(), Quota::default(), &model.spec.taps)?;
    let mut monitor = Monitor::new(&model.encoder, reference)?;
    let (mut off, mut on) = (Vec::new(), Vec::new());
    let began = Instant::now();
    for index in 0..BLOCKS * BLOCK_FRAMES {
        let (block, place) = (index / BLOCK_FRAMES, index % BLOCK_FRAMES);
        let shown = if FOG.contains(&place) { &foggy } else { &plain };
        let frame = Frame {
            sequence: index.into(),
            captured_at: PERIOD * index,
            picture: Ok(shown[index as usize % shown.len()].clone()),
        };
        std::thread::sleep(frame.captured_at.saturating_sub(began.elapsed()));
        let taken = Instant::now();
        let verdict = monitor.step(&frame);
        if block % 2 == 1 {
            recorder.offer(frame, &verdict, || monitor.look());
            on.push(taken.elapsed());
        } else {
            drop(frame);
            off.push(taken.elapsed());
        }
    }
    let kept = recorder.finish();
    Ok(EvidenceCost {
        frames: on.len().min(off.len()),
        off_median_ms: ms(quantile(off.clone(), 50)),
        off_p99_ms: ms(quantile(off, 99)),
        on_median_ms: ms(quantile(on.clone(), 50)),
        on_p99_ms: ms(quantile(on, 99)),
        events: kept.events,
        dropped_frames: kept.dropped_frames,
    })
}
