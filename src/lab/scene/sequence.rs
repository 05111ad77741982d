//! The stretches of a road that changes along the way: where they begin, and of which kind they are. Any place can be
//! accessed directly, and there is no end.

use super::noise::{Draws, hash, smooth};
use super::road_kind::RoadKind;

/// Length of road over which one stretch passes into the next, metres.
const PASSAGE_M: (f32, f32) = (10.0, 60.0);
/// The sequence of the stretches of a road.
#[derive(Clone, Copy, Debug)]
pub struct Sequence {
    draws: Draws,
    length_m: f64,
    two_way: bool,
}

/// One stretch of road.
#[derive(Clone, Copy, Debug)]
pub struct Stretch {
    /// Arc lengths of its two ends, metres.
    pub ends_m: (f64, f64),
    /// Lengths over which it passes into the stretches before and after it, metres.
    pub passages_m: (f32, f32),
    /// Kind of road.
    pub kind: RoadKind,
    /// Draws of its own.
    pub draws: Draws,
}

impl Sequence {
    /// Stretches with a mean length of `length_m`.
    pub fn new(draws: Draws, length_m: u32, two_way: bool) -> Self {
        Self {
            draws,
            length_m: f64::from(length_m),
            two_way,
        }
    }

    fn own(&self, index: i64) -> Draws {
        Draws(hash(self.draws.0, index as i32, 0x57))
    }

    /// Arc length at which the stretch `index` begins, metres.
    fn start_m(&self, index: i64) -> f64 {
        let aside = f64::from(self.own(index).range("start", -0.25, 0.25));
        self.length_m * (index as f64 + aside)
    }

    fn passage_m(&self, index: i64) -> f32 {
        let longest = PASSAGE_M.1.min(0.4 * self.length_m as f32);
        self.own(index).range("passage", PASSAGE_M.0, longest)
    }

    fn stretch(&self, index: i64) -> Stretch {
        let draws = self.own(index);
        let drawn = |index| RoadKind::drawn(self.own(index), self.two_way);
        let (before, kind) = (drawn(index - 1), drawn(index));
        Stretch {
            ends_m: (self.start_m(index), self.start_m(index + 1)),
            passages_m: (self.passage_m(index), self.passage_m(index + 1)),
            kind: if kind == before {
                kind.next(self.two_way)
            } else {
                kind
            },
            draws,
        }
    }

    /// The stretches between two arc lengths, in their order.
    pub fn between(&self, from_m: f64, to_m: f64) -> Vec<Stretch> {
        let index = |s_m: f64| (s_m / self.length_m).floor() as i64;
        (index(from_m) - 1..=index(to_m) + 1)
            .map(|index| self.stretch(index))
            .filter(|stretch| {
                let (into_m, out_m) = stretch.passages_m;
                stretch.ends_m.0 - f64::from(into_m) < to_m
                    && stretch.ends_m.1 + f64::from(out_m) > from_m
            })
            .collect()
    }
}

/// A place between two stretches.
pub struct Passage {
    /// The stretch in which the place is, as an index.
    pub here: usize,
    /// The nearest other stretch.
    pub other: usize,
    /// Share of the other stretch, 0 to 0.5.
    pub share: f32,
}

impl Passage {
    /// The place `s_m` among `stretches`, whose passages are `longer` times as long as they are for the road itself.
    pub fn at(stretches: &[Stretch], s_m: f64, longer: f32) -> Self {
        let here = stretches
            .partition_point(|stretch| stretch.ends_m.1 <= s_m)
            .min(stretches.len().saturating_sub(1));
        let stretch = &stretches[here];
        let (after_m, before_m) = (s_m - stretch.ends_m.0, stretch.ends_m.1 - s_m);
        let half_m = 0.5 * (stretch.ends_m.1 - stretch.ends_m.0) as f32;
        let (beyond_m, passage_m, other) = if after_m < before_m {
            (after_m, stretch.passages_m.0, here.checked_sub(1))
        } else {
            (before_m, stretch.passages_m.1, Some(here + 1))
        };
        let other = other.filter(|&other| other < stretches.len());
        let reach_m = (0.5 * longer * passage_m).min(half_m);
        let inside = (beyond_m as f32 / reach_m).clamp(0.0, 1.0);
        Self {
            here,
            other: other.unwrap_or(here),
            share: if other.is_some() {
                smooth(0.5 - 0.5 * inside)
            } else {
                0.0
            },
        }
    }

    /// A quantity between that of this stretch and that of the other one.
    pub fn between(&self, of: impl Fn(usize) -> f32) -> f32 {
        let here = of(self.here);
        if self.share > 0.0 {
            here + self.share * (of(self.other) - here)
        } else {
            here
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sequences() -> impl Iterator<Item = Sequence> {
        (0..40).map(|seed| Sequence::new(Draws(seed), 100 + 97 * seed, seed % 2 == 0))
    }

    #[test]
    fn stretches_follow_each_other_and_their_lengths_are_in_range() {
        for sequence in sequences() {
            let stretches = sequence.between(0.0, 40.0 * sequence.length_m);
            for pair in stretches.windows(2) {
                assert!((pair[0].ends_m.1 - pair[1].ends_m.0).abs() < 1e-9);
                let length = (pair[0].ends_m.1 - pair[0].ends_m.0) / sequence.length_m;
                assert!((0.5..=1.5).contains(&length), "{length}");
                assert!(pair[0].passages_m.1 <= 60.0);
            }
        }
    }

    #[test]
    fn shares_are_continuous_along_the_road() {
        for sequence in sequences() {
            let stretches = sequence.between(0.0, 12.0 * sequence.length_m);
            for longer in [1.0, 4.0] {
                let share = |s_m: f64| {
                    Passage::at(&stretches, s_m, longer)
                        .between(|index| if index % 2 == 0 { 0.0 } else { 1.0 })
                };
                let mut s_m = sequence.length_m;
                while s_m < 11.0 * sequence.length_m {
                    assert!((share(s_m + 0.1) - share(s_m)).abs() < 0.05);
                    s_m += 0.1;
                }
            }
        }
    }
}
