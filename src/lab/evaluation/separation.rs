//! How well a number distinguishes shifted windows from nominal ones: area under the ROC curve, and recall at few false
//! positives.
//!
//! Neighbouring windows show nearly the same, so intervals come from resampling whole blocks of them (Carlstein 1986),
//! and blocks, not windows, count as data. If all windows are on one side, resamples show no uncertainty, however few
//! windows there are. Therefore an interval is never narrower than the score interval for as many independent values as
//! there are blocks.

use super::resampling::{Z, binomial_interval};
use crate::statistics::bootstrap::{ROUNDS, percentile_interval};
use crate::statistics::random::SplitMix64;

/// Share of nominal windows that may be above the threshold.
pub const FALSE_POSITIVES: f64 = 0.05;

/// How far shifted numbers are above nominal ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Separation {
    /// Share of pairs of a nominal and a shifted window in which the shifted one is larger; ties count half.
    pub auroc: f64,
    /// Its 95 % interval.
    pub auroc_interval: (f64, f64),
    /// Share of shifted windows above the lowest threshold that at most 5 % of the nominal ones exceed.
    pub recall: f64,
    /// Its 95 % interval.
    pub recall_interval: (f64, f64),
    /// Share of nominal windows above that threshold; 0 if there are fewer than 20.
    pub false_positives: f64,
}

/// One window in the list, which is sorted by falling numbers.
struct Ranked {
    value: f64,
    shifted: bool,
    block: usize,
}

/// The result of a weighted pass over ranked windows.
struct Counted {
    auroc: f64,
    recall: f64,
    false_positives: f64,
}

/// Separation of two samples, each in blocks of windows; `None` if one has no window.
pub fn separation(nominal: &[Vec<f64>], shifted: &[Vec<f64>]) -> Option<Separation> {
    let of = |blocks: &[Vec<f64>]| -> Vec<Vec<f64>> {
        let full = blocks.iter().filter(|block| !block.is_empty());
        full.cloned().collect()
    };
    let (nominal, shifted) = (of(nominal), of(shifted));
    if nominal.is_empty() || shifted.is_empty() {
        return None;
    }
    let ranked = ranked(&nominal, &shifted);
    let (n, m) = (nominal.len(), shifted.len());
    let found = counted(&ranked, &vec![1; n], &vec![1; m]);
    let mut dice = SplitMix64::new(0);
    let (mut aurocs, mut recalls) = (Vec::with_capacity(ROUNDS), Vec::with_capacity(ROUNDS));
    for _ in 0..ROUNDS {
        let nominal = dice.multiplicities(n);
        let resampled = counted(&ranked, &nominal, &dice.multiplicities(m));
        aurocs.push(resampled.auroc);
        recalls.push(resampled.recall);
    }
    let recall_least = share_interval(found.recall, m);
    Some(Separation {
        auroc: found.auroc,
        auroc_interval: wider(
            percentile_interval(aurocs),
            auroc_interval(found.auroc, n, m),
        ),
        recall: found.recall,
        recall_interval: wider(percentile_interval(recalls), recall_least),
        false_positives: found.false_positives,
    })
}

fn ranked(nominal: &[Vec<f64>], shifted: &[Vec<f64>]) -> Vec<Ranked> {
    let of = |blocks: &[Vec<f64>], shifted: bool| -> Vec<Ranked> {
        let numbered = blocks.iter().enumerate();
        numbered
            .flat_map(|(block, values)| {
                values.iter().map(move |&value| Ranked {
                    value,
                    shifted,
                    block,
                })
            })
            .collect()
    };
    let mut all = of(nominal, false);
    all.extend(of(shifted, true));
    all.sort_by(|a, b| b.value.total_cmp(&a.value));
    all
}

/// One pass from the largest value down; each window counts as often as its block was drawn.
#[allow(clippy::cast_precision_loss)]
fn counted(ranked: &[Ranked], nominal: &[u32], shifted: &[u32]) -> Counted {
    let weight = |of: &Ranked| match of.shifted {
        true => u64::from(shifted[of.block]),
        false => u64::from(nominal[of.block]),
    };
    let sum = |shifted: bool| -> u64 {
        let own = ranked.iter().filter(|of| of.shifted == shifted);
        own.map(weight).sum()
    };
    let (all_nominal, all_shifted) = (sum(false), sum(true));
    let allowed = FALSE_POSITIVES * all_nominal as f64;
    // Twice the pairs in which the shifted window is larger, so that ties are whole numbers.
    let (mut pairs, mut above_nominal, mut above_shifted) = (0, 0, 0);
    let (mut found, mut exceeded, mut below_threshold) = (0, 0, false);
    for tied in ranked.chunk_by(|a, b| a.value.total_cmp(&b.value).is_eq()) {
        let of = |shifted: bool| -> u64 {
            let own = tied.iter().filter(|of| of.shifted == shifted);
            own.map(weight).sum()
        };
        let (here_nominal, here_shifted) = (of(false), of(true));
        pairs += here_shifted * (2 * (all_nominal - above_nominal) - here_nominal);
        above_nominal += here_nominal;
        above_shifted += here_shifted;
        below_threshold |= above_nominal as f64 > allowed;
        if !below_threshold {
            (found, exceeded) = (above_shifted, above_nominal);
        }
    }
    Counted {
        auroc: pairs as f64 / (2 * all_nominal * all_shifted) as f64,
        recall: found as f64 / all_shifted as f64,
        false_positives: exceeded as f64 / all_nominal as f64,
    }
}

fn wider(resampled: Option<(f64, f64)>, least: (f64, f64)) -> (f64, f64) {
    let (low, high) = resampled.unwrap_or(least);
    (low.min(least.0), high.max(least.1))
}

/// Wilson's interval of a share of `n` values; the share may be a fraction of values.
#[allow(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss
)]
fn share_interval(share: f64, n: usize) -> (f64, f64) {
    let count = share * n as f64;
    let low = binomial_interval(count.floor() as u64, n as u64).0;
    (low, binomial_interval(count.ceil() as u64, n as u64).1)
}

/// 95 % score interval of an area under the ROC curve of `n` nominal and `m` shifted independent values (Newcombe 2006,
/// part 2, method 5).
#[allow(clippy::cast_precision_loss)]
fn auroc_interval(auroc: f64, n: usize, m: usize) -> (f64, f64) {
    let (n, m) = (n as f64, m as f64);
    let others = 0.5 * (n + m) - 1.0;
    let outside = |theta: f64| {
        let spread = 1.0 + others * ((1.0 - theta) / (2.0 - theta) + theta / (1.0 + theta));
        (auroc - theta).abs() > Z * (theta * (1.0 - theta) * spread / (n * m)).sqrt()
    };
    let end = |mut outer: f64| {
        let mut inner = auroc;
        for _ in 0..60 {
            let middle = 0.5 * (outer + inner);
            if outside(middle) {
                outer = middle;
            } else {
                inner = middle;
            }
        }
        outer
    };
    (end(0.0), end(1.0))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;
    use proptest::prelude::*;

    fn each_alone(values: &[f64]) -> Vec<Vec<f64>> {
        values.iter().map(|&value| vec![value]).collect()
    }

    #[test]
    fn auroc_and_recall_by_hand() {
        // Pairs: 2 is above both 1 and 1.5; 1 is equal to 1; 0.5 is above none: (2 + 0.5) of 6.
        let found = separation(&each_alone(&[1.0, 1.5]), &each_alone(&[2.0, 1.0, 0.5])).unwrap();
        assert!((found.auroc - 2.5 / 6.0).abs() < 1e-12);
        // Two nominal windows allow no false positive: only 2 is above 1.5.
        assert!((found.recall - 1.0 / 3.0).abs() < 1e-12 && found.false_positives == 0.0);
        // Of forty windows, two may be above.
        let nominal: Vec<f64> = (0..40).map(f64::from).collect();
        let found = separation(&each_alone(&nominal), &each_alone(&[37.0, 37.5, 50.0])).unwrap();
        assert_eq!((found.false_positives, found.recall), (0.05, 2.0 / 3.0));
    }

    #[test]
    fn few_windows_that_are_all_found_leave_doubt() {
        // (1 - t) = z^2 t (1 + 9 ((1 - t) / (2 - t) + t / (1 + t))) / 100 at t = 0.800.
        let (low, high) = auroc_interval(1.0, 10, 10);
        assert!((low - 0.800).abs() < 0.001 && high > 0.999, "{low} {high}");
        let ten = |from: u8| each_alone(&(from..from + 10).map(f64::from).collect::<Vec<_>>());
        let found = separation(&ten(0), &ten(20)).unwrap();
        assert_eq!((found.auroc, found.recall), (1.0, 1.0));
        assert!((found.auroc_interval.0 - low).abs() < 1e-9);
        // Wilson: 10 of 10.
        assert!((found.recall_interval.0 - 0.7225).abs() < 1e-3);
    }

    #[test]
    fn what_hangs_together_counts_once() {
        let nominal: Vec<f64> = (0..40).map(|i| f64::from(i % 7)).collect();
        let shifted: Vec<f64> = (0..40).map(|i| 2.0 + f64::from(i % 5)).collect();
        let width = |of: &Separation| of.auroc_interval.1 - of.auroc_interval.0;
        let blocks =
            |values: &[f64]| -> Vec<Vec<f64>> { values.chunks(10).map(<[f64]>::to_vec).collect() };
        let alone = separation(&each_alone(&nominal), &each_alone(&shifted)).unwrap();
        let whole = separation(&blocks(&nominal), &blocks(&shifted)).unwrap();
        assert_eq!(alone.auroc, whole.auroc);
        assert!(width(&whole) > 1.5 * width(&alone));
    }

    proptest! {
        #[test]
        fn intervals_hold_what_was_found(
            nominal in prop::collection::vec(0..9_u8, 1..30), shifted in prop::collection::vec(0..9_u8, 1..30)
        ) {
            let of = |values: &[u8]| -> Vec<Vec<f64>> {
                values.chunks(3).map(|block| block.iter().map(|&v| f64::from(v)).collect()).collect()
            };
            let found = separation(&of(&nominal), &of(&shifted)).unwrap();
            let above = nominal.iter().flat_map(|n| shifted.iter().map(move |s| match s.cmp(n) {
                std::cmp::Ordering::Greater => 1.0,
                std::cmp::Ordering::Equal => 0.5,
                std::cmp::Ordering::Less => 0.0,
            })).sum::<f64>();
            #[allow(clippy::cast_precision_loss)]
            let wanted = above / (nominal.len() * shifted.len()) as f64;
            prop_assert!((found.auroc - wanted).abs() < 1e-12);
            prop_assert!(found.false_positives <= FALSE_POSITIVES);
            for (value, (low, high)) in [(found.auroc, found.auroc_interval), (found.recall, found.recall_interval)] {
                prop_assert!(0.0 <= low && low <= value + 1e-9 && value - 1e-9 <= high && high <= 1.0);
            }
        }
    }

    #[test]
    fn without_windows_there_is_no_separation() {
        assert_eq!(separation(&[], &[vec![1.0]]), None);
        assert_eq!(separation(&[vec![]], &[vec![1.0]]), None);
    }
}
