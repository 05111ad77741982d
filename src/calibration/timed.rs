//! Nominal drives → moments of what windows and spans compare: means over a time, and their changes.

use std::collections::VecDeque;
use std::time::Duration;

use super::windows::Part;
use crate::monitor::history::BIN;
use crate::monitor::span_watch::SpanWatch;
use crate::reference::Span;
use crate::reference::gap::moments::{Moments, STEPS_PER_NAT, energy_levels};

/// Moments of windows and spans, one for each tap.
#[derive(Clone)]
pub struct TimedMoments {
    /// Means over the short window.
    pub window: Vec<Moments>,
    /// For each span: means over its recent time, or differences from the past.
    pub spans: Vec<SpanMoments>,
}

/// Moments of one span.
#[derive(Clone)]
pub struct SpanMoments {
    /// The span.
    pub span: Span,
    /// One for each tap.
    pub taps: Vec<Moments>,
    /// Number of spans that do not overlap.
    pub independent: usize,
}

/// Levels of one frame, tap after tap.
struct Levels<'a> {
    epsilons: &'a [f64],
    /// Number of energies of each tap.
    energies: Vec<usize>,
}

impl TimedMoments {
    /// Moments of nothing yet, for `taps` taps.
    pub fn new(taps: usize) -> Self {
        let nothing = || vec![Moments::new(0); taps];
        Self {
            window: nothing(),
            spans: Span::ALL
                .map(|span| SpanMoments {
                    span,
                    taps: nothing(),
                    independent: 0,
                })
                .to_vec(),
        }
    }

    /// Adds the moments of a part of a drive. Windows and spans are taken every half a second.
    pub fn add(&mut self, part: &Part<'_>, epsilons: &[f64], window_s: f64) {
        let Some(first) = part.frames.first() else {
            return;
        };
        let levels = Levels {
            epsilons,
            energies: first.means.iter().map(|means| means.energy.len()).collect(),
        };
        let mut own = Self::new(epsilons.len());
        own.window = levels.nothing();
        for span in &mut own.spans {
            span.taps = levels.nothing();
        }
        let width = levels.energies.iter().sum();
        let mut watch = SpanWatch::of(&Span::ALL, width, Duration::ZERO);
        let mut window: VecDeque<(Duration, Vec<u32>)> = VecDeque::new();
        let mut mean = vec![0; width];
        let mut next = part.times()[0] + Duration::from_secs_f64(window_s).saturating_sub(BIN);
        for (&at, frame) in part.times().iter().zip(&part.frames) {
            let energies = frame.means.iter().map(|means| means.energy.as_slice());
            let taken = levels.of(energies);
            watch.add(at, &taken);
            window.push_back((at, taken));
            while window
                .front()
                .is_some_and(|of| (at - of.0).as_secs_f64() >= window_s)
            {
                window.pop_front();
            }
            let last = part.times().last() == Some(&at);
            if at < next && !(last && own.window[0].frames() == 0) {
                continue;
            }
            next = at + BIN;
            means(&window, &mut mean);
            levels.each(&mut own.window, &mean, Moments::add);
            for (index, span) in own.spans.iter_mut().enumerate() {
                let Some(compared) = watch.levels(index) else {
                    continue;
                };
                if span.span.is_change() {
                    levels.each(&mut span.taps, compared, |moments, own| {
                        moments.add_differences(own, &mut mean[..own.len()]);
                    });
                } else {
                    let steps = |level: &f64| (STEPS_PER_NAT * level).round();
                    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
                    mean.iter_mut()
                        .zip(compared)
                        .for_each(|(mean, level)| *mean = steps(level) as u32);
                    levels.each(&mut span.taps, &mean, Moments::add);
                }
            }
        }
        for span in &mut own.spans {
            span.independent = independent_spans(part.times(), span.span);
        }
        self.merge(&own);
    }

    /// Adds the moments of other drives.
    pub fn merge(&mut self, other: &Self) {
        let add = |own: &mut Vec<Moments>, others: &[Moments]| {
            let both = own.iter_mut().zip(others);
            both.filter(|(_, other)| other.frames() > 0)
                .for_each(|(own, other)| own.merge(other));
        };
        add(&mut self.window, &other.window);
        for (own, other) in self.spans.iter_mut().zip(&other.spans) {
            add(&mut own.taps, &other.taps);
            own.independent += other.independent;
        }
    }
}

/// Number of spans that do not overlap in a drive with frames at these times.
pub fn independent_spans(times: &[Duration], span: Span) -> usize {
    let lasted = times.last().zip(times.first());
    let lasted_s = lasted.map_or(0.0, |(last, first)| (*last - *first).as_secs_f64() + 0.5);
    // Drives last for hours at most.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let whole = (lasted_s / span.length_s()) as usize;
    whole
}

impl Levels<'_> {
    fn nothing(&self) -> Vec<Moments> {
        self.energies
            .iter()
            .map(|&energies| Moments::new(energies))
            .collect()
    }

    fn of<'e>(&self, energies: impl Iterator<Item = &'e [f64]>) -> Vec<u32> {
        let mut levels = vec![0; self.energies.iter().sum()];
        let mut rest = levels.as_mut_slice();
        for (energies, &epsilon) in energies.zip(self.epsilons) {
            let (own, others) = rest.split_at_mut(energies.len());
            energy_levels(energies, epsilon, own);
            rest = others;
        }
        levels
    }

    /// Adds to the moments of each tap its own part of `values`.
    fn each<T>(&self, taps: &mut [Moments], values: &[T], mut add: impl FnMut(&mut Moments, &[T])) {
        let mut rest = values;
        for (moments, &energies) in taps.iter_mut().zip(&self.energies) {
            let (own, others) = rest.split_at(energies);
            add(moments, own);
            rest = others;
        }
    }
}

/// Mean levels of the frames in a window, rounded.
fn means(window: &VecDeque<(Duration, Vec<u32>)>, mean: &mut [u32]) {
    let frames = window.len().max(1) as u64;
    for (index, mean) in mean.iter_mut().enumerate() {
        let sum: u64 = window
            .iter()
            .map(|(_, levels)| u64::from(levels[index]))
            .sum();
        // A mean is not larger than the largest level.
        #[allow(clippy::cast_possible_truncation)]
        {
            *mean = ((sum + frames / 2) / frames) as u32;
        }
    }
}
