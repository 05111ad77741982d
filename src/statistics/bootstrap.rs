//! Intervals by resampling: draws as many items as there are, with replacement, many times.

use super::random::SplitMix64;

/// Number of resamples for an interval: at each end of a 95 % interval, 25 resamples are outside.
pub const ROUNDS: usize = 1_000;

/// 95 % percentile interval of the values of resamples; `None` without values.
pub fn percentile_interval(values: Vec<f64>) -> Option<(f64, f64)> {
    percentiles(values, 25, 975)
}

/// One-sided 95 % bounds of the values of resamples: 5 % are below the first bound, and 5 % above the second. `None`
/// without values.
pub fn one_sided_bounds(values: Vec<f64>) -> Option<(f64, f64)> {
    percentiles(values, 50, 950)
}

fn percentiles(mut values: Vec<f64>, low: usize, high: usize) -> Option<(f64, f64)> {
    values.sort_by(f64::total_cmp);
    let (low, high) = (values.len() * low / 1_000, values.len() * high / 1_000);
    Some((*values.get(low)?, *values.get(high.saturating_sub(1))?))
}

/// Events an hour of resampled drives, which are given as events and hours of each drive. The result is the same for
/// the same drives on every machine. Drives without hours are left out.
pub fn rates(drives: &[(u64, f64)]) -> Vec<f64> {
    let drives: Vec<(u64, f64)> = drives.iter().copied().filter(|of| of.1 > 0.0).collect();
    if drives.is_empty() {
        return Vec::new();
    }
    let mut dice = SplitMix64::new(0);
    let mut round = || {
        let (mut events, mut hours) = (0, 0.0);
        for _ in 0..drives.len() {
            let (of_one, its_hours) = drives[dice.below(drives.len())];
            events += of_one;
            hours += its_hours;
        }
        // Counts of entries are small.
        #[allow(clippy::cast_precision_loss)]
        {
            events as f64 / hours
        }
    };
    (0..ROUNDS).map(|_| round()).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    #[test]
    fn bounds_leave_out_the_share_that_they_say() {
        let values: Vec<f64> = (0..1_000).rev().map(f64::from).collect();
        assert_eq!(percentile_interval(values.clone()), Some((25.0, 974.0)));
        assert_eq!(one_sided_bounds(values), Some((50.0, 949.0)));
        assert_eq!(one_sided_bounds(vec![]), None);
    }

    #[test]
    fn resampled_rates_are_of_the_hours_that_were_drawn() {
        // The rate of every drive is 2 an hour, so the rate of all resamples is too; a drive without hours does not
        // count.
        let drives = [(1, 0.5), (2, 1.0), (8, 4.0), (0, 0.0)];
        let found = rates(&drives);
        assert_eq!(
            (found.len(), found.iter().all(|&rate| rate == 2.0)),
            (ROUNDS, true)
        );
        assert_eq!(rates(&[(0, 0.0)]), Vec::<f64>::new());
        // Eight entries in one of ten drives of an hour: that drive is drawn up to three times in 98.7 % of resamples, and up
        // to twice in 93.0 %.
        let mut drives = [(0, 1.0); 10];
        drives[3] = (8, 1.0);
        let (low, high) = one_sided_bounds(rates(&drives)).unwrap();
        assert_eq!((low, high), (0.0, 2.4));
    }
}
