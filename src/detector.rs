//! Histograms over time → evidence: the gap of a short window, scaled by what is nominal for its number of frames.

use std::time::Duration;

use heapless::Deque;

use crate::gap::Metric;
use crate::model::TAPS_MAX;
use crate::reference::{Reference, TapReference};
use crate::undefined::Undefined;

/// Most frames a window holds; at higher frame rates it spans less time than asked for.
pub const WINDOW_FRAMES_MAX: usize = 32;
/// A pause longer than this many windows is a hole in time: what was seen before it says nothing about now.
const HOLE_WINDOWS: u32 = 2;

/// What one block says of the window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockScore {
    /// Gap in the metric's own units.
    pub gap: f64,
    /// Similarity, 1 for equal histograms.
    pub similarity: f64,
    /// `(gap - median) / (threshold - median)`: 0 nominal, 1 alarm threshold.
    pub score: f64,
}

/// What the window says.
#[derive(Clone, Debug, PartialEq)]
pub struct Evidence {
    /// The largest score of the blocks.
    pub score: f64,
    /// One entry a tap.
    pub blocks: heapless::Vec<BlockScore, TAPS_MAX>,
    /// Frames in the window.
    pub frames: usize,
    /// Share of the window's length looked at without a hole, 0..1.
    pub fill: f64,
}

/// Rolling histograms of the last moments against a reference. Allocates nothing after it is made.
#[derive(Debug)]
pub struct Detector {
    metric: Metric,
    taps: Vec<TapReference>,
    span: Duration,
    /// When each frame in the window was seen, oldest first.
    times: Deque<Duration, WINDOW_FRAMES_MAX>,
    /// Counts of the frames, a ring of `WINDOW_FRAMES_MAX` slots.
    ring: Vec<u32>,
    /// The slot that is written next.
    next_slot: usize,
    /// Sums over the window.
    sums: Vec<u64>,
    began: Option<Duration>,
}

impl Detector {
    /// A detector that has seen nothing.
    pub fn new(reference: &Reference) -> Self {
        let bins: usize = reference.taps.iter().map(|tap| tap.binning.bins()).sum();
        Self {
            metric: reference.metric,
            taps: reference.taps.clone(),
            span: Duration::from_secs_f64(reference.window_s),
            times: Deque::new(),
            ring: vec![0; bins * WINDOW_FRAMES_MAX],
            next_slot: 0,
            sums: vec![0; bins],
            began: None,
        }
    }

    /// Bins of all taps together: the length of the counts of a frame.
    pub fn bins(&self) -> usize {
        self.sums.len()
    }

    /// Adds a frame's counts, `[bins]` of all taps one after the other, and compares the window with the reference.
    ///
    /// # Errors
    /// Why the window has no gap.
    pub fn observe(&mut self, now: Duration, counts: &[u32]) -> Result<Evidence, Undefined> {
        if self
            .times
            .back()
            .is_some_and(|&last| now < last || now - last > HOLE_WINDOWS * self.span)
        {
            self.restart();
        }
        while self
            .times
            .front()
            .is_some_and(|&oldest| now - oldest >= self.span)
            || self.times.is_full()
        {
            self.forget_oldest();
        }
        let slot = self.next_slot;
        self.next_slot = (slot + 1) % WINDOW_FRAMES_MAX;
        self.ring[slot * counts.len()..][..counts.len()].copy_from_slice(counts);
        self.sums
            .iter_mut()
            .zip(counts)
            .for_each(|(sum, &count)| *sum += u64::from(count));
        // There is room: a full window has lost its oldest above.
        let _ = self.times.push_back(now);
        let began = *self.began.get_or_insert(now);
        self.evidence(((now - began).as_secs_f64() / self.span.as_secs_f64()).min(1.0))
    }

    fn evidence(&self, fill: f64) -> Result<Evidence, Undefined> {
        let frames = self.times.len();
        let mut blocks = heapless::Vec::new();
        let mut sums = self.sums.as_slice();
        for tap in &self.taps {
            let (live, rest) = sums.split_at(tap.counts.len());
            sums = rest;
            let compared = self.metric.compare(live, &tap.counts)?;
            let (median, threshold) = tap.scale_for(frames);
            let score = (compared.gap - median) / (threshold - median);
            // A reference has at most as many taps as a model.
            let _ = blocks.push(BlockScore {
                gap: compared.gap,
                similarity: compared.similarity,
                score,
            });
        }
        let score = blocks
            .iter()
            .map(|block| block.score)
            .fold(f64::NEG_INFINITY, f64::max);
        Ok(Evidence {
            score,
            blocks,
            frames,
            fill,
        })
    }

    fn forget_oldest(&mut self) {
        let bins = self.sums.len();
        let slot = (self.next_slot + WINDOW_FRAMES_MAX - self.times.len()) % WINDOW_FRAMES_MAX;
        if self.times.pop_front().is_some() {
            let old = &self.ring[slot * bins..][..bins];
            self.sums
                .iter_mut()
                .zip(old)
                .for_each(|(sum, &count)| *sum -= u64::from(count));
        }
    }

    fn restart(&mut self) {
        self.times.clear();
        self.sums.fill(0);
        self.began = None;
    }
}
