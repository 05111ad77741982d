//! Levels over time → what the spans of a reference compare: means of the last seconds, and their differences from the
//! past before them.
//!
//! While a change lasts, the past is held, so that the change is not absorbed. The past begins anew when the change has
//! lasted for [`HELD_MAX`], and after an interruption of more than [`PAST_LOST`].

use std::time::Duration;

use crate::monitor::continuity::Continuity;
use crate::monitor::history::{BIN, History, number_of_bin};
use crate::monitor::unrest::Unrest;
use crate::reference::{Component, Span, SpanNorm};

/// Longest time for which the past is held, in which the road was seen.
pub const HELD_MAX: Duration = Duration::from_secs(60);
/// An interruption that is longer than this makes the past unknown.
pub const PAST_LOST: Duration = Duration::from_secs(60);

/// Follows the spans of a reference.
#[derive(Debug)]
pub struct SpanWatch {
    spans: Vec<Watched>,
    history: History,
    continuity: Continuity,
    /// Time in which the road was seen.
    seen: Duration,
    last: Option<Duration>,
    held_since: Option<Duration>,
    past: Vec<f64>,
    deviations: Vec<f64>,
}

/// One span and what it compares now.
#[derive(Debug)]
struct Watched {
    recent_bins: usize,
    past_bins: Option<usize>,
    /// `[energies]`, nats.
    levels: Vec<f64>,
    is_known: bool,
    /// How much the road changes anyway; for changes.
    unrest: Unrest,
    /// The last distance of this bin, as a multiple of the nominal median, and the number of the bin.
    newest: Option<(u64, f64)>,
}

/// What one span says of one nominal domain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpanScore {
    /// 0 nominal median, 1 alarm threshold; the largest of the blocks.
    pub score: f64,
    /// So far from nominal that the past is to be held.
    pub holds: bool,
    /// The distance as a multiple of its nominal median; the largest of the blocks.
    pub relative: f64,
}

impl SpanScore {
    /// A score that holds nothing.
    pub fn of(score: f64) -> Self {
        Self {
            score,
            holds: false,
            relative: 0.0,
        }
    }
}

impl SpanWatch {
    /// For the spans of nominal domains, whose frames may come as slowly as one every `period`.
    pub fn new(components: &[Component], period: Duration) -> Self {
        let taps = components.first().map_or(&[][..], |first| &first.taps);
        let spans: Vec<Span> = taps.first().map_or_else(Vec::new, |tap| {
            tap.spans.iter().map(|norm| norm.span).collect()
        });
        let width = match spans.as_slice() {
            [] => 0,
            _ => taps.iter().map(|tap| tap.nominal.len()).sum(),
        };
        Self::of(&spans, width, period)
    }

    /// For some spans of frames with `width` energies.
    pub fn of(spans: &[Span], width: usize, period: Duration) -> Self {
        let watched = |span: &Span| Watched {
            recent_bins: bins(span.recent_s),
            past_bins: span.past_s.map(bins),
            levels: vec![0.0; width],
            is_known: false,
            unrest: Unrest::default(),
            newest: None,
        };
        Self {
            spans: spans.iter().map(watched).collect(),
            history: History::new(width),
            continuity: Continuity::with_frames_every(period),
            seen: Duration::ZERO,
            last: None,
            held_since: None,
            past: vec![0.0; width],
            deviations: vec![0.0; width],
        }
    }

    /// Number of spans.
    pub fn len(&self) -> usize {
        self.spans.len()
    }

    /// Whether nothing is watched.
    pub fn is_empty(&self) -> bool {
        self.spans.is_empty()
    }

    /// Whether the span with this index compares the road with its own past.
    pub fn is_change(&self, span: usize) -> bool {
        self.spans
            .get(span)
            .is_some_and(|span| span.past_bins.is_some())
    }

    /// Adds a frame's levels, `[energies]`, at the front of `levels`.
    pub fn add(&mut self, now: Duration, levels: &[u32]) {
        if self.is_empty() {
            return;
        }
        let held = self.held_since.is_some();
        let lost = self
            .last
            .is_some_and(|last| now < last || now - last > PAST_LOST);
        self.last = Some(now);
        match self.continuity.step(now) {
            Some(since) => self.seen += since,
            None if lost => {
                self.history.forget();
                self.forget_unrest();
                self.held_since = None;
            }
            None => self.history.interrupt(held),
        }
        let own = &levels[..self.past.len().min(levels.len())];
        self.history.add(self.seen, own, self.held_since.is_some());
        for span in &mut self.spans {
            span.is_known = self
                .history
                .recent(self.seen, span.recent_bins, &mut span.levels);
            if let (true, Some(past_bins)) = (span.is_known, span.past_bins) {
                span.is_known = self
                    .history
                    .past(span.recent_bins, past_bins, &mut self.past);
                let apart = span.levels.iter_mut().zip(&self.past);
                apart.for_each(|(level, past)| *level -= past);
            }
        }
    }

    /// What the span with this index compares, nats `[energies]`; `None` while it is not known.
    pub fn levels(&self, span: usize) -> Option<&[f64]> {
        let span = self.spans.get(span).filter(|span| span.is_known)?;
        Some(&span.levels)
    }

    /// What the span with this index says of a nominal domain; `None` while it is not known.
    pub fn score(&mut self, span: usize, component: &Component) -> Option<SpanScore> {
        let of = self.spans.get(span).filter(|span| span.is_known)?;
        let unrest = of.unrest.level();
        let mut found = SpanScore {
            score: f64::NEG_INFINITY,
            ..SpanScore::of(0.0)
        };
        for (tap, own) in component.by_tap(&of.levels) {
            let norm: &SpanNorm = tap.spans.get(span)?;
            let distance = norm.norm.distance_of(own, &mut self.deviations);
            found.relative = found
                .relative
                .max(distance / norm.median.max(f64::MIN_POSITIVE));
            found.score = found.score.max(norm.score(distance / unrest));
            found.holds |= distance / unrest >= norm.held_from;
        }
        Some(found)
    }

    /// Takes the scores of the spans for the domains that are nearest to them, and whether the road is beyond a threshold
    /// of the gap. While it is, or something has changed, the past is held, at most for [`HELD_MAX`]; then it begins anew.
    pub fn note(&mut self, scores: &[Option<SpanScore>], in_gap: bool) {
        let changes = self.spans.iter().zip(scores);
        let mut changes = changes.filter(|(span, _)| span.past_bins.is_some());
        let changed = changes.any(|(_, score)| score.is_some_and(|score| score.holds));
        if !changed && !in_gap {
            self.held_since = None;
            let bin = number_of_bin(self.seen);
            for (span, score) in self.spans.iter_mut().zip(scores) {
                if let (Some(_), Some(score)) = (span.past_bins, score) {
                    span.see(bin, score.relative);
                }
            }
            return;
        }
        let since = *self.held_since.get_or_insert(self.seen);
        if self.seen - since >= HELD_MAX {
            self.history.forget_past();
            self.forget_unrest();
            self.held_since = None;
        }
    }

    fn forget_unrest(&mut self) {
        for span in &mut self.spans {
            span.unrest.forget();
            span.newest = None;
        }
    }
}

impl Watched {
    /// Takes the distance that was seen in a bin. The last one of a bin counts.
    fn see(&mut self, bin: u64, relative: f64) {
        match self.newest {
            Some((of, before)) if of != bin => self.unrest.push(before),
            _ => {}
        }
        self.newest = Some((bin, relative));
    }
}

// Spans are a few seconds long.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn bins(seconds: f64) -> usize {
    (seconds / BIN.as_secs_f64()).round() as usize
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    fn at(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// Runs at ten frames a second, and calls a score that holds while the level is above 5 nats away from the past.
    fn run(watch: &mut SpanWatch, from_ms: u64, to_ms: u64, level: u32) -> Option<f64> {
        let mut last = None;
        for ms in (from_ms..to_ms).step_by(100) {
            watch.add(at(ms), &[1_024 * level]);
            last = watch.levels(1).map(|levels| levels[0]);
            let found = last.map(|apart| SpanScore {
                score: apart.abs(),
                holds: apart.abs() > 5.0,
                relative: 1.0,
            });
            watch.note(&[None, found, None], false);
        }
        last
    }

    fn watch() -> SpanWatch {
        SpanWatch::of(&Span::ALL, 1, Duration::ZERO)
    }

    #[test]
    fn a_change_lasts_until_the_road_is_as_before() {
        let mut watch = watch();
        assert_eq!(run(&mut watch, 0, 30_000, 3), Some(0.0));
        assert_eq!(run(&mut watch, 30_000, 70_000, 13), Some(10.0), "a tunnel");
        assert_eq!(run(&mut watch, 70_000, 73_000, 3), Some(0.0), "its end");
        assert_eq!(run(&mut watch, 73_000, 120_000, 3), Some(0.0));
    }

    #[test]
    fn a_gap_never_enters_the_past() {
        let mut watch = watch();
        for second in 0..40 {
            // A gap from the start, before any change can be known.
            let in_gap = second < 8;
            let level = if in_gap { 13 } else { 3 };
            for tenth in 0..10 {
                watch.add(at(1_000 * second + 100 * tenth), &[1_024 * level]);
                watch.note(&[None, None, None], in_gap);
            }
        }
        assert_eq!(watch.levels(1).unwrap(), [0.0]);
    }

    #[test]
    fn a_change_that_lasts_for_a_minute_is_the_new_past() {
        let mut watch = watch();
        run(&mut watch, 0, 30_000, 3);
        assert_eq!(run(&mut watch, 30_000, 91_000, 13), Some(10.0));
        assert_eq!(
            run(&mut watch, 91_000, 95_000, 13),
            None,
            "the past begins anew"
        );
        assert_eq!(run(&mut watch, 95_000, 125_000, 13), Some(0.0));
    }

    #[test]
    fn a_short_interruption_keeps_the_past_and_a_long_one_loses_it() {
        for (pause_ms, known) in [(3_000, true), (59_000, true), (61_000, false)] {
            let mut watch = watch();
            run(&mut watch, 0, 30_000, 3);
            let again = 30_000 + pause_ms;
            assert_eq!(
                run(&mut watch, again, again + 1_000, 13),
                None,
                "no present yet"
            );
            let found = run(&mut watch, again + 1_000, again + 3_000, 13);
            assert_eq!(found, known.then_some(10.0), "{pause_ms} ms");
        }
    }

    #[test]
    fn one_frame_a_second_is_enough() {
        let mut watch = SpanWatch::of(&Span::ALL, 1, at(1_000));
        for second in 0..60 {
            watch.add(at(1_000 * second), &[1_024 * 3]);
        }
        assert_eq!(watch.levels(1).unwrap(), [0.0]);
        for second in 60..62 {
            watch.add(at(1_000 * second), &[1_024 * 5]);
        }
        assert_eq!(watch.levels(1).unwrap(), [2.0]);
    }
}
