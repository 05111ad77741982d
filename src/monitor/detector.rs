//! Frames over time → evidence: the gap of a short window, scaled by what is nominal for its number of frames, for abrupt
//! change; and a cumulative sum of scores (CUSUM, Page 1954) for slow drift.

use std::time::Duration;

use heapless::Deque;

use crate::capture::undefined::Undefined;
use crate::model::TAPS_MAX;
use crate::monitor::alarm::Judgement;
use crate::monitor::cusum::Cusum;
use crate::monitor::profile::{TapProfile, spreads_of};
use crate::monitor::span_watch::{SpanScore, SpanWatch};
use crate::monitor::warn::{LANES_LOST, WarnOn};
use crate::reference::cause::LikelyCause;
use crate::reference::gap::Metric;
use crate::reference::gap::moments::STEPS_PER_NAT;
use crate::reference::{Causes, Component, Explained, LaneForecast, Reference, Span};

/// Largest number of frames in a window. At higher frame rates the window is shorter than the wanted time.
pub const WINDOW_FRAMES_MAX: usize = 32;
/// A pause longer than this many windows is an interruption: what was seen before it says nothing about the present.
const HOLE_WINDOWS: u32 = 2;
/// What one block says about the window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockScore {
    /// Gap in the metric's own units.
    pub gap: f64,
    /// Similarity, 1 for equal histograms.
    pub similarity: f64,
    /// `(gap - median) / (threshold - median)`: 0 nominal, 1 alarm threshold.
    pub score: f64,
}

/// Largest number of parts of the evidence: the window, and the spans.
pub const PARTS_MAX: usize = 1 + Span::ALL.len();

/// What is known of the road.
#[derive(Clone, Debug, PartialEq)]
pub struct Evidence {
    /// How far the road is from the nearest nominal domain: the largest score of the blocks that decide, in the window
    /// and over longer times.
    pub gap: f64,
    /// How far the road is from its own past; `None` while the past is too short.
    pub change: Option<f64>,
    /// The score of the window, then that of each span, each for the domain that is nearest to it; `None` while it is
    /// not known.
    pub parts: heapless::Vec<Option<f64>, PARTS_MAX>,
    /// One entry for each tap, against the nearest nominal domain.
    pub blocks: heapless::Vec<BlockScore, TAPS_MAX>,
    /// The nearest nominal domain, by its index in the reference.
    pub component: usize,
    /// How far the scores have added up; 1 is a drift.
    pub drift: f64,
    /// Frames in the window.
    pub frames: usize,
    /// Share of the window's length that was seen without an interruption, 0 to 1.
    pub fill: f64,
    /// What most likely causes it; only if there is something to explain, and if causes are known.
    pub cause: Option<LikelyCause>,
    /// Forecast of the share of lanes that the model loses, 0 to 1; `None` if the reference has no forecast.
    pub lanes: Option<f64>,
}

impl Evidence {
    /// The largest score of all evidence.
    pub fn score(&self) -> f64 {
        self.change.map_or(self.gap, |change| change.max(self.gap))
    }

    /// The largest score of the answers that raise the warning, of those that are known. For lanes, 1 is
    /// [`LANES_LOST`].
    pub fn score_of(&self, warn: WarnOn) -> Option<f64> {
        let gap = warn.gap.then_some(self.gap);
        let change = self.change.filter(|_| warn.change);
        let lanes = self.lanes.filter(|_| warn.lanes);
        let lanes = lanes.map(|share| share / LANES_LOST);
        [gap, change, lanes].into_iter().flatten().reduce(f64::max)
    }

    /// What the evidence contributes to the alarm, if some answers raise it. A gap speaks before lost lanes, these before
    /// a change, and a drift speaks last.
    pub fn judgement(&self, warn: WarnOn) -> Judgement {
        let settled = self.fill >= 1.0;
        let (gap, drift) = match warn.gap {
            true => (self.gap, self.drift),
            false => (0.0, 0.0),
        };
        let lost = warn.lanes && self.lanes.is_some_and(|share| share >= LANES_LOST);
        if gap < 1.0 && lost {
            return Judgement::Lanes { settled };
        }
        judgement(gap, self.change.filter(|_| warn.change), drift, settled)
    }
}

/// What a gap, a change and a drift contribute to the alarm.
pub fn judgement(gap: f64, change: Option<f64>, drift: f64, settled: bool) -> Judgement {
    let changed = gap < 1.0 && change.is_some_and(|change| change >= 1.0);
    if changed {
        Judgement::Change { settled }
    } else if gap < 1.0 && drift >= 1.0 {
        Judgement::Drift { settled }
    } else {
        Judgement::Score {
            score: gap,
            settled,
        }
    }
}

/// Compares rolling sums over the window with a reference. Allocates nothing after it is made.
#[derive(Debug)]
pub struct Detector {
    metric: Metric,
    components: Vec<Component>,
    /// Nominal spreads of energies by component and tap, for profiles.
    spreads: Vec<Vec<Vec<f64>>>,
    cusum: Cusum,
    watch: SpanWatch,
    /// Frames may come as slowly as one in this time.
    period: Duration,
    span: Duration,
    /// When each frame in the window was seen, oldest first.
    times: Deque<Duration, WINDOW_FRAMES_MAX>,
    /// What was taken from the frames, a ring of `WINDOW_FRAMES_MAX` slots.
    ring: Vec<u32>,
    /// The slot that is written next.
    next_slot: usize,
    /// Sums over the window.
    sums: Vec<u64>,
    began: Option<Duration>,
    /// The domain that was nearest last.
    nearest: Option<usize>,
    /// A road beyond the threshold of the gap is no past to compare with.
    gap_holds_past: bool,
    causes: Option<Causes>,
    lanes: Option<LaneForecast>,
    /// `[energies of all taps]`, what is to be explained.
    deviation: Vec<f64>,
}

impl Detector {
    /// A detector that has seen nothing.
    pub fn new(reference: &Reference) -> Self {
        Self::of(
            reference.metric,
            reference.components.clone(),
            reference.window_s,
        )
        .with_causes(reference.causes.clone())
        .with_lanes(reference.lanes.clone())
    }

    /// A detector that compares with some nominal domains.
    pub fn of(metric: Metric, components: Vec<Component>, window_s: f64) -> Self {
        let bins = Component::taken_len(&components);
        let of_one = components.first().map(std::slice::from_ref);
        Self {
            metric,
            spreads: components
                .iter()
                .map(|component| component.taps.iter().map(spreads_of).collect())
                .collect(),
            watch: SpanWatch::new(&components, Duration::ZERO),
            causes: None,
            lanes: None,
            deviation: vec![0.0; Component::taken_len(of_one.unwrap_or_default())],
            components,
            cusum: Cusum::default(),
            period: Duration::ZERO,
            span: Duration::from_secs_f64(window_s),
            times: Deque::new(),
            ring: vec![0; bins * WINDOW_FRAMES_MAX],
            next_slot: 0,
            sums: vec![0; bins],
            began: None,
            nearest: None,
            gap_holds_past: true,
        }
    }

    /// Frames may come as slowly as one every `period`.
    pub fn with_frames_every(self, period: Duration) -> Self {
        Self {
            cusum: Cusum::with_frames_every(period),
            watch: SpanWatch::new(&self.components, period),
            period,
            ..self
        }
    }

    /// For some answers that raise the warning. If the gap does not, a road that is a gap all the time is a past to compare
    /// with like any other.
    pub fn warning_on(self, warn: WarnOn) -> Self {
        Self {
            gap_holds_past: warn.gap,
            ..self
        }
    }

    /// Tells the cause of evidence.
    pub fn with_causes(self, causes: Option<Causes>) -> Self {
        Self { causes, ..self }
    }

    /// Forecasts lost lanes.
    pub fn with_lanes(self, lanes: Option<LaneForecast>) -> Self {
        Self { lanes, ..self }
    }

    /// How many numbers are taken from a frame: for each nominal domain, tap after tap.
    pub fn taken_len(&self) -> usize {
        self.sums.len()
    }

    /// Adds what was taken from a frame, `[taken_len]`, and compares the window with the reference.
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
        self.nearest = None;
        let began = *self.began.get_or_insert(now);
        let fill = ((now - began).as_secs_f64() / self.span.as_secs_f64()).min(1.0);
        self.watch.add(now, counts);
        let mut evidence = self.evidence(fill)?;
        if fill >= 1.0 {
            evidence.drift = self.cusum.add(now, evidence.gap);
        }
        self.nearest = Some(evidence.component);
        if self.causes.is_some() && evidence.score() >= 1.0 {
            evidence.cause = self.cause(&evidence);
        }
        let forecast = self.lanes.as_ref().zip(self.components.first());
        evidence.lanes =
            forecast.and_then(|(of, first)| of.share(&first.taps, &self.sums, self.times.len()));
        Ok(evidence)
    }

    /// The cause of a change if there is one, else that of the gap.
    fn cause(&mut self, evidence: &Evidence) -> Option<LikelyCause> {
        let changed = evidence.change.is_some_and(|change| change >= 1.0);
        let of_change = changed
            && self
                .deviation(Explained::Change, evidence.component)
                .is_some();
        let explained = if of_change {
            Explained::Change
        } else {
            self.deviation(Explained::Gap, evidence.component)?;
            Explained::Gap
        };
        let causes = self.causes.as_ref()?;
        Some(causes.likely(explained, &self.deviation))
    }

    /// How the present deviates from its past or from a nominal domain, see [`Explained::deviation`]; `None` while the
    /// past is unknown, or if the domain has no norm for it. Allocates nothing.
    pub fn deviation(&mut self, explained: Explained, domain: usize) -> Option<&[f64]> {
        let (before, rest) = self.components.split_at_checked(domain)?;
        let taps = &rest.first()?.taps;
        match explained {
            Explained::Change => {
                let apart = self.watch.levels(Explained::span())?;
                explained.deviation(taps, |place| apart[place], &mut self.deviation)?;
            }
            Explained::Gap => {
                let sums = &self.sums[Component::taken_len(before)..];
                // A window has few frames.
                #[allow(clippy::cast_precision_loss)]
                let level = |place: usize| {
                    sums[place] as f64 / (STEPS_PER_NAT * self.times.len().max(1) as f64)
                };
                explained.deviation(taps, level, &mut self.deviation)?;
            }
        }
        Some(&self.deviation)
    }

    /// The present evidence. Every part counts for the nominal domain that is nearest to it.
    fn evidence(&mut self, fill: f64) -> Result<Evidence, Undefined> {
        let mut parts = [None::<SpanScore>; PARTS_MAX];
        let spans = self.watch.len();
        let mut nearest: Option<Evidence> = None;
        let mut sums = self.sums.as_slice();
        for (index, component) in self.components.iter().enumerate() {
            let len = Component::taken_len(std::slice::from_ref(component));
            let (own, rest) = sums.split_at(len);
            sums = rest;
            let blocks = blocks(self.metric, component, own, self.times.len())?;
            let deciding = self.metric.deciding(blocks.len());
            let scores = blocks[deciding].iter().map(|block| block.score);
            let window = scores.fold(f64::NEG_INFINITY, f64::max);
            keep_least(&mut parts[0], SpanScore::of(window));
            let mut gap = window;
            for span in 0..spans {
                let Some(found) = self.watch.score(span, component) else {
                    continue;
                };
                keep_least(&mut parts[1 + span], found);
                if !self.watch.is_change(span) {
                    gap = gap.max(found.score);
                }
            }
            if nearest.as_ref().is_none_or(|nearest| gap < nearest.gap) {
                nearest = Some(Evidence {
                    gap,
                    change: None,
                    parts: heapless::Vec::new(),
                    blocks,
                    component: index,
                    drift: 0.0,
                    frames: self.times.len(),
                    fill,
                    cause: None,
                    lanes: None,
                });
            }
        }
        let mut evidence = nearest.ok_or(Undefined::NoScore)?;
        let changes = (0..spans).filter(|&span| self.watch.is_change(span));
        let changes = changes.filter_map(|span| parts[1 + span]);
        evidence.change = changes.map(|of| of.score).reduce(f64::max);
        let held = self.gap_holds_past && evidence.gap >= 1.0;
        self.watch.note(&parts[1..=spans], held);
        let known = parts.iter().take(1 + spans);
        evidence.parts = known.map(|part| part.map(|of| of.score)).collect();
        Ok(evidence)
    }

    /// The window beside its nearest nominal domain, tap after tap; empty if it cannot be judged.
    pub fn profiles(&self) -> Vec<TapProfile> {
        let Some(nearest) = self.nearest else {
            return Vec::new();
        };
        let (before, rest) = self.components.split_at(nearest);
        let sums = &self.sums[Component::taken_len(before)..];
        let taps = rest.first().into_iter().flat_map(|of| of.by_tap(sums));
        taps.zip(&self.spreads[nearest])
            .map(|((tap, own), spread)| TapProfile::new(tap, spread, own, self.times.len()))
            .collect()
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
        self.cusum = Cusum::with_frames_every(self.period);
    }
}

/// What each block of a domain says of a window of `frames` frames.
fn blocks(
    metric: Metric,
    component: &Component,
    sums: &[u64],
    frames: usize,
) -> Result<heapless::Vec<BlockScore, TAPS_MAX>, Undefined> {
    let mut blocks = heapless::Vec::new();
    for (tap, live) in component.by_tap(sums) {
        let compared = tap.nominal.compare(metric, live, frames)?;
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
    Ok(blocks)
}

/// Keeps the smaller score.
fn keep_least(least: &mut Option<SpanScore>, found: SpanScore) {
    if least.is_none_or(|least| found.score < least.score) {
        *least = Some(found);
    }
}

#[cfg(test)]
impl Evidence {
    /// A full window of ten frames with this score, and nothing else.
    pub fn of_gap(gap: f64) -> Self {
        Self {
            gap,
            change: None,
            parts: heapless::Vec::new(),
            blocks: heapless::Vec::new(),
            component: 0,
            drift: 0.0,
            frames: 10,
            fill: 1.0,
            cause: None,
            lanes: None,
        }
    }
}

#[cfg(test)]
mod tests;
