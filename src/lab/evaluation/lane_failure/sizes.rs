//! The size of the evaluation.

use crate::lab::scene::ConditionKind;

/// Number of drives that are looked at.
#[derive(Clone, Copy, Debug)]
pub struct Sizes {
    /// Number of nominal drives of 2 s that make the references.
    pub fitted: u64,
    /// Number of nominal drives that set and judge thresholds.
    pub held_out: u64,
    /// Their length, seconds.
    pub held_out_s: f64,
    /// Number of drives of 4 s to which `lane-risk` is fitted, each plain and under every kind of condition.
    pub labelled: u64,
    /// Number of roads that are judged, each plain and under every kind of condition with severities 1 to 5.
    pub roads: u64,
}

impl Sizes {
    /// The full evaluation: 6 hours of nominal drives, 500 drives with conditions.
    pub const FULL: Self = Self {
        fitted: 600,
        held_out: 72,
        held_out_s: 300.0,
        labelled: 40,
        roads: 10,
    };
    /// A quick check of whether it works.
    pub const QUICK: Self = Self {
        fitted: 30,
        held_out: 6,
        held_out_s: 10.0,
        labelled: 1,
        roads: 1,
    };

    /// Total number of drives.
    pub fn drives(&self) -> u64 {
        self.fitted + self.held_out + self.labelled + self.roads * (1 + CASES)
    }
}

/// Number of kinds of condition times number of severities.
const CASES: u64 = 5 * ConditionKind::ALL.len() as u64;
