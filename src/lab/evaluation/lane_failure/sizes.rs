//! How much is looked at.

use crate::lab::scene::ConditionKind;

/// How many drives are looked at.
#[derive(Clone, Copy, Debug)]
pub struct Sizes {
    /// Nominal drives of 2 s that make the references.
    pub fitted: u64,
    /// Nominal drives that set and judge thresholds.
    pub held_out: u64,
    /// Their length, seconds.
    pub held_out_s: f64,
    /// Drives of 4 s that teach `lane-risk`, each plain and under every kind of condition.
    pub labelled: u64,
    /// Roads that are judged, each plain and under every kind of condition at severities 1 to 5.
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
    /// A look at whether it works.
    pub const QUICK: Self = Self {
        fitted: 30,
        held_out: 6,
        held_out_s: 10.0,
        labelled: 1,
        roads: 1,
    };

    /// Drives in all.
    pub fn drives(&self) -> u64 {
        self.fitted + self.held_out + self.labelled + self.roads * (1 + CASES)
    }
}

/// Kinds of condition times severities.
const CASES: u64 = 5 * ConditionKind::ALL.len() as u64;
