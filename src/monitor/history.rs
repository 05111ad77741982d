//! The last seconds and the past before them, in coarse bins of time.
//!
//! ```text
//!   past, up to 33 s                    newest 2 s       (the newest 5 s reach 3 s into the past)
//!   |--------------------------------|--------------> now
//!        a bin enters the past when it is 2 s old, unless the past is held
//! ```
//!
//! Time is time in which the road was seen: an interruption adds nothing. While the past is held, nothing enters it, so
//! that what lasts is not absorbed. What was seen meanwhile never enters it. Memory is constant, and nothing is
//! allocated after the start.

use std::time::Duration;

use crate::reference::gap::moments::STEPS_PER_NAT;

/// Length of a bin.
pub const BIN: Duration = Duration::from_millis(500);
/// Bins that are the present, and not yet past: those of the shortest span.
const PRESENT_BINS: u64 = 4;
/// Longest recent time, bins.
pub const RECENT_BINS_MAX: usize = 10;
/// Longest past, bins.
pub const PAST_BINS_MAX: usize = 60;
/// Bins of the past that are kept: the longest one, and what of it belongs to the longest recent time.
const PAST_KEPT: usize = PAST_BINS_MAX + RECENT_BINS_MAX;
/// Of this many bins, at least one must hold a frame: frames that come every two seconds fill every fourth bin.
const SPARSE: usize = 4;

/// Sums of the frames of one bin, in a ring.
#[derive(Clone, Debug)]
struct Bins {
    width: usize,
    /// `[capacity, width]`, sums of levels.
    sums: Vec<u32>,
    /// Number of frames, and number of the bin, by slot.
    of: Vec<(u32, u64)>,
    oldest: usize,
    len: usize,
}

impl Bins {
    fn new(width: usize, capacity: usize) -> Self {
        Self {
            width,
            sums: vec![0; width * capacity],
            of: vec![(0, 0); capacity],
            oldest: 0,
            len: 0,
        }
    }

    fn clear(&mut self) {
        (self.oldest, self.len) = (0, 0);
    }

    fn slot(&self, place: usize) -> usize {
        (self.oldest + place) % self.of.len()
    }

    /// Frames, number and sums of the bin at a place, the oldest first.
    fn get(&self, place: usize) -> (u32, u64, &[u32]) {
        let slot = self.slot(place);
        let (frames, number) = self.of[slot];
        (
            frames,
            number,
            &self.sums[slot * self.width..][..self.width],
        )
    }

    fn newest(&self) -> Option<u64> {
        let last = self.len.checked_sub(1)?;
        Some(self.get(last).1)
    }

    fn oldest(&self) -> Option<u64> {
        (self.len > 0).then(|| self.get(0).1)
    }

    /// Adds a bin after the newest, and forgets the oldest one if there is no room. Returns its sums, which are to be
    /// written.
    fn push(&mut self, frames: u32, number: u64) -> &mut [u32] {
        if self.len == self.of.len() {
            self.oldest = self.slot(1);
            self.len -= 1;
        }
        let slot = self.slot(self.len);
        self.of[slot] = (frames, number);
        self.len += 1;
        &mut self.sums[slot * self.width..][..self.width]
    }

    /// Adds a frame to the newest bin.
    fn add(&mut self, levels: &[u32]) {
        let slot = self.slot(self.len - 1);
        self.of[slot].0 += 1;
        let sums = &mut self.sums[slot * self.width..][..self.width];
        sums.iter_mut()
            .zip(levels)
            .for_each(|(sum, &level)| *sum += level);
    }
}

/// What was seen in the last seconds, and before them.
#[derive(Clone, Debug)]
pub struct History {
    /// The newest bins, the begun one last.
    recent: Bins,
    /// Bins that are old enough, and in which nothing had changed. Their numbers follow each other without what was
    /// left out.
    past: Bins,
    /// Bins up to this number have entered the past, or never will.
    settled: u64,
    /// Number of bins that were left out of the past.
    left_out: u64,
    /// Time at which the recent bins began.
    began: Option<Duration>,
}

impl History {
    /// A history of frames with `width` numbers.
    pub fn new(width: usize) -> Self {
        Self {
            recent: Bins::new(width, RECENT_BINS_MAX),
            past: Bins::new(width, PAST_KEPT),
            settled: 0,
            left_out: 0,
            began: None,
        }
    }

    /// Adds a frame's levels, `[width]`, at the time `seen`, which never goes back. While `held`, nothing enters the
    /// past.
    pub fn add(&mut self, seen: Duration, levels: &[u32], held: bool) {
        let number = number_of_bin(seen);
        if self.began.is_none() {
            self.settled = number;
        }
        self.began.get_or_insert(seen);
        if self.recent.newest() != Some(number) {
            self.settle((number + 1).saturating_sub(PRESENT_BINS), held);
            self.recent.push(0, number).fill(0);
        } else if held {
            self.leave_out(number + 1);
        }
        self.recent.add(levels);
    }

    /// Bins before the number `end` are old enough for the past.
    fn settle(&mut self, end: u64, held: bool) {
        if held {
            // What is present while the past is held never enters it.
            return self.leave_out(
                self.recent
                    .newest()
                    .map_or(end, |newest| newest + 1)
                    .max(end),
            );
        }
        for place in 0..self.recent.len {
            let (frames, number, sums) = self.recent.get(place);
            if (self.settled..end).contains(&number) {
                let kept = self.past.push(frames, number - self.left_out);
                kept.copy_from_slice(sums);
            }
        }
        self.settled = self.settled.max(end);
    }

    fn leave_out(&mut self, end: u64) {
        self.left_out += end.saturating_sub(self.settled);
        self.settled = self.settled.max(end);
    }

    /// Nothing was seen for a while: what was present is past, unless the past is held, and the present begins anew.
    pub fn interrupt(&mut self, held: bool) {
        if let Some(newest) = self.recent.newest() {
            self.settle(newest + 1, held);
        }
        self.recent.clear();
        self.began = None;
    }

    /// The past begins anew with the present.
    pub fn forget_past(&mut self) {
        self.past.clear();
        if let Some(oldest) = self.recent.oldest() {
            self.settled = oldest;
        }
        self.left_out = 0;
    }

    /// Forgets everything.
    pub fn forget(&mut self) {
        self.recent.clear();
        self.past.clear();
        self.began = None;
        self.left_out = 0;
    }

    /// Writes the mean level of the newest `bins` bins, nats, `[width]`: every frame counts alike. `false`, and nothing
    /// written, if the present has not lasted that long.
    #[allow(clippy::cast_precision_loss)]
    pub fn recent(&self, seen: Duration, bins: usize, mean: &mut [f64]) -> bool {
        let until_full = BIN * u32::try_from(bins.saturating_sub(1)).unwrap_or(u32::MAX);
        let lasted = self.began.map(|began| seen.saturating_sub(began));
        if lasted.is_none_or(|lasted| lasted < until_full) {
            return false;
        }
        let from = (number_of_bin(seen) + 1).saturating_sub(bins as u64);
        mean.fill(0.0);
        let mut frames = 0;
        for place in 0..self.recent.len {
            let (own, number, sums) = self.recent.get(place);
            if number >= from {
                frames += own;
                mean.iter_mut()
                    .zip(sums)
                    .for_each(|(mean, &sum)| *mean += f64::from(sum));
            }
        }
        scale(mean, f64::from(frames));
        frames > 0
    }

    /// Writes the mean level of `bins` bins of the past, nats, `[width]`, without those that belong to the newest
    /// `recent_bins`: every bin with frames counts alike, so that the past does not depend on a rate that varies.
    /// `false`, and nothing useful written, if the past is shorter.
    #[allow(clippy::cast_precision_loss)]
    pub fn past(&self, recent_bins: usize, bins: usize, mean: &mut [f64]) -> bool {
        let (Some(newest), Some(oldest)) = (self.past.newest(), self.past.oldest()) else {
            return false;
        };
        let skipped = (recent_bins as u64).saturating_sub(PRESENT_BINS);
        let Some(end) = (newest + 1).checked_sub(skipped) else {
            return false;
        };
        let Some(from) = end
            .checked_sub(bins as u64)
            .filter(|&from| from + SPARSE as u64 > oldest)
        else {
            return false;
        };
        mean.fill(0.0);
        let mut used = 0_usize;
        for place in 0..self.past.len {
            let (frames, number, sums) = self.past.get(place);
            if (from..end).contains(&number) {
                used += 1;
                let share = 1.0 / f64::from(frames.max(1));
                mean.iter_mut()
                    .zip(sums)
                    .for_each(|(mean, &sum)| *mean += share * f64::from(sum));
            }
        }
        scale(mean, used as f64);
        used * SPARSE >= bins
    }
}

fn scale(sums: &mut [f64], count: f64) {
    let share = 1.0 / (STEPS_PER_NAT * count.max(1.0));
    sums.iter_mut().for_each(|sum| *sum *= share);
}

/// The number of the bin of a time.
#[allow(clippy::cast_possible_truncation)]
pub fn number_of_bin(seen: Duration) -> u64 {
    (seen.as_nanos() / BIN.as_nanos()) as u64
}

#[cfg(test)]
mod tests {
    #![allow(clippy::float_cmp)]
    use super::*;

    const NAT: u32 = 1_024;

    fn at(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// Adds a frame every 100 ms, each with this level in nats.
    fn drive(history: &mut History, ms: std::ops::Range<u64>, level: u32, held: bool) {
        for ms in ms.step_by(100) {
            history.add(at(ms), &[level * NAT], held);
        }
    }

    fn past_of(history: &History) -> Option<f64> {
        let mut mean = [0.0];
        history.past(4, 40, &mut mean).then_some(mean[0])
    }

    fn recent_of(history: &History, ms: u64) -> Option<f64> {
        let mut mean = [0.0];
        history.recent(at(ms), 4, &mut mean).then_some(mean[0])
    }

    #[test]
    fn a_past_of_twenty_seconds_is_known_after_twenty_two() {
        let mut history = History::new(1);
        drive(&mut history, 0..1_500, 3, false);
        assert_eq!(recent_of(&history, 1_400), None);
        drive(&mut history, 1_500..20_000, 3, false);
        assert_eq!(
            (recent_of(&history, 19_900), past_of(&history)),
            (Some(3.0), None)
        );
        drive(&mut history, 20_000..22_000, 3, false);
        drive(&mut history, 22_000..24_000, 5, false);
        assert_eq!(
            (recent_of(&history, 23_900), past_of(&history)),
            (Some(5.0), Some(3.0))
        );
    }

    #[test]
    fn what_is_seen_while_the_past_is_held_never_enters_it() {
        let mut history = History::new(1);
        drive(&mut history, 0..30_000, 3, false);
        drive(&mut history, 30_000..31_000, 9, false);
        drive(&mut history, 31_000..90_000, 9, true);
        assert_eq!(
            (recent_of(&history, 89_900), past_of(&history)),
            (Some(9.0), Some(3.0))
        );
        // Released: the road is as before, and so is the past, on both sides of what was left out.
        drive(&mut history, 90_000..120_000, 3, false);
        assert_eq!(
            (recent_of(&history, 119_900), past_of(&history)),
            (Some(3.0), Some(3.0))
        );
        // The past that begins anew is that of the new road.
        drive(&mut history, 120_000..130_000, 7, true);
        history.forget_past();
        assert_eq!(past_of(&history), None);
        drive(&mut history, 130_000..155_000, 7, false);
        assert_eq!(past_of(&history), Some(7.0));
    }

    #[test]
    fn every_bin_of_the_past_counts_alike_at_any_rate() {
        let mut history = History::new(1);
        // 10 s at ten frames a second, then 14 s at one.
        drive(&mut history, 0..10_000, 2, false);
        for second in 10..24 {
            history.add(at(1_000 * second), &[4 * NAT], false);
        }
        // 22 s of past: of the newest 40 bins, 20 were seen often, and every second one of the others once.
        let past = past_of(&history).unwrap_or_default();
        assert!((2.6..2.9).contains(&past), "{past}");
    }

    #[test]
    fn an_interruption_begins_the_present_anew_and_keeps_the_past() {
        let mut history = History::new(1);
        drive(&mut history, 0..25_000, 3, false);
        history.interrupt(false);
        history.add(at(25_000), &[9 * NAT], false);
        assert_eq!(
            (recent_of(&history, 25_000), past_of(&history)),
            (None, Some(3.0))
        );
        history.forget();
        assert_eq!(past_of(&history), None);
    }
}
