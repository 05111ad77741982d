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
        Self::of(reference.metric, reference.taps.clone(), reference.window_s)
    }

    fn of(metric: Metric, taps: Vec<TapReference>, window_s: f64) -> Self {
        let bins: usize = taps.iter().map(|tap| tap.binning.bins()).sum();
        Self {
            metric,
            taps,
            span: Duration::from_secs_f64(window_s),
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
            if !score.is_finite() {
                return Err(Undefined::NoScore);
            }
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

#[cfg(test)]
mod tests {
    #![allow(
        clippy::unwrap_used,
        clippy::float_cmp,
        clippy::cast_possible_truncation
    )]
    use super::*;
    use crate::histogram::Binning;
    use crate::reference::ScalePoint;

    /// A detector of one tap with four bins, nominal (1, 1, 1, 1), median 0.1 and threshold 0.3 for any window.
    fn detector(window_s: f64) -> Detector {
        let tap = TapReference {
            tap: "e2".into(),
            median_peak_energy: 1.0,
            binning: Binning::LogEnergy {
                epsilon: 1e-6,
                edges: vec![0.0, 1.0, 2.0],
            },
            images: 1,
            counts: vec![1; 4],
            scale: vec![ScalePoint {
                frames: 1,
                windows: 9,
                median: 0.1,
                threshold: 0.3,
            }],
        };
        Detector::of(Metric::LogEnergyJs, vec![tap], window_s)
    }

    fn at(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn the_score_is_0_at_the_median_and_1_at_the_threshold() {
        let seen = detector(1.0).observe(at(0), &[5, 5, 5, 5]).unwrap();
        assert!((seen.score - (0.0 - 0.1) / (0.3 - 0.1)).abs() < 1e-12);
        let apart = detector(1.0).observe(at(0), &[9, 0, 0, 0]).unwrap();
        assert!(
            (apart.score - (apart.blocks[0].gap - 0.1) / 0.2).abs() < 1e-12 && apart.score > 1.0
        );
    }

    #[test]
    fn the_window_is_the_sum_of_the_frames_in_its_span_at_any_rate() {
        for (step_ms, wanted) in [
            (1_000, 1),
            (500, 2),
            (100, 10),
            (33, 31),
            (10, WINDOW_FRAMES_MAX),
        ] {
            let mut detector = detector(1.0);
            for i in 0..200_u64 {
                let counts = [i as u32, 1, 0, 2 * i as u32];
                let seen = detector.observe(at(i * step_ms), &counts).unwrap();
                assert_eq!(
                    seen.frames,
                    wanted.min(i as usize + 1),
                    "every {step_ms} ms"
                );
                let in_window = (i + 1 - seen.frames as u64)..=i;
                let first: u64 = in_window.clone().sum();
                assert_eq!(detector.sums, [first, seen.frames as u64, 0, 2 * first]);
            }
        }
    }

    #[test]
    fn a_hole_in_time_or_a_step_back_starts_the_window_anew() {
        let mut detector = detector(1.0);
        let frames = |detector: &mut Detector, ms| {
            let seen = detector.observe(at(ms), &[1, 2, 3, 4]).unwrap();
            (seen.frames, seen.fill)
        };
        assert_eq!(frames(&mut detector, 0), (1, 0.0));
        assert_eq!(frames(&mut detector, 500), (2, 0.5));
        assert_eq!(frames(&mut detector, 1_200), (2, 1.0));
        assert_eq!(
            frames(&mut detector, 3_300),
            (1, 0.0),
            "a hole of more than two windows"
        );
        assert_eq!(frames(&mut detector, 3_400), (2, 0.1));
        assert_eq!(frames(&mut detector, 100), (1, 0.0), "time that goes back");
    }

    #[test]
    fn empty_histograms_have_no_score() {
        assert_eq!(
            detector(1.0).observe(at(0), &[0; 4]),
            Err(Undefined::EmptyHistogram)
        );
    }
}
