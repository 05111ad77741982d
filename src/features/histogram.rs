//! Energy maps → attention histograms: integer counts of pixels, so that sums are exact in any order.

use serde::{Deserialize, Serialize};

use crate::capture::undefined::Undefined;
use crate::features::attention::EnergyMap;

/// How the pixels of an energy map are counted. It is fixed by a reference, and the same for every image that is
/// compared with it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind", deny_unknown_fields)]
pub enum Binning {
    /// Spatial softmax of the energy, scaled so that the smallest and largest attention of the image are 0 and 1.
    Attention {
        /// Softmax temperature, energy units.
        temperature: f64,
        /// Number of levels into which the scaled attention is divided: `bin = floor((levels - 1) a)`.
        levels: usize,
        /// The first level that is counted; lower levels are left out.
        first: usize,
    },
    /// `ln(energy + epsilon)`.
    LogEnergy {
        /// Value that is added before the logarithm, energy units.
        epsilon: f64,
        /// Rising inner edges; bin `i` holds `edges[i-1] <= ln(g + epsilon) < edges[i]`, the outer bins are open.
        edges: Vec<f64>,
    },
}

impl Binning {
    /// How many bins are counted.
    pub fn bins(&self) -> usize {
        match self {
            Self::Attention { levels, first, .. } => levels - first,
            Self::LogEnergy { edges, .. } => edges.len() + 1,
        }
    }

    /// Adds the pixels of one energy map to `counts`, `[bins]`. Allocates nothing.
    ///
    /// # Errors
    /// `ConstantMap` if the map is constant; `counts` is then unchanged.
    pub fn count(&self, map: &EnergyMap, counts: &mut [u32]) -> Result<(), Undefined> {
        let (low, high) = map.range();
        if low >= high || !(high - low).is_finite() {
            return Err(Undefined::ConstantMap);
        }
        match self {
            Self::Attention {
                temperature,
                levels,
                first,
            } => {
                let attention = ScaledAttention::new(low, high, *temperature);
                // No pixel below this energy can reach the first counted level.
                let least = attention.energy_below(level_of_bin(*first, *levels));
                for &g in map.energy.iter().filter(|&&g| g >= least) {
                    if let Some(bin) = attention.level(g, *levels).checked_sub(*first) {
                        counts[bin] += 1;
                    }
                }
            }
            Self::LogEnergy { epsilon, edges } => {
                for &g in &map.energy {
                    let value = (g + epsilon).ln();
                    counts[edges.partition_point(|&edge| edge <= value)] += 1;
                }
            }
        }
        Ok(())
    }

    /// What is wrong with a binning read from a file, if anything.
    pub fn fault(&self) -> Option<&'static str> {
        match self {
            Self::Attention {
                temperature,
                levels,
                first,
            } => {
                let fits = temperature.is_normal()
                    && *temperature > 0.0
                    && (2..=65_536).contains(levels)
                    && first < levels;
                (!fits).then_some(
                    "wanted a temperature above 0 and a first level below the 2 to 65536 levels",
                )
            }
            Self::LogEnergy { epsilon, edges } => {
                let rising = edges.windows(2).all(|pair| pair[0] < pair[1]);
                let fits = epsilon.is_normal()
                    && *epsilon > 0.0
                    && edges.iter().all(|e| e.is_finite())
                    && rising;
                (!fits || edges.len() > 65_535)
                    .then_some("wanted an epsilon above 0 and rising edges")
            }
        }
    }
}

/// Attention at the lower edge of a level, 0..1.
#[allow(clippy::cast_precision_loss)]
fn level_of_bin(first: usize, levels: usize) -> f64 {
    first as f64 / (levels - 1) as f64
}

/// Softmax attention scaled to 0..1 over one image: `(a - min a) / (max a - min a)`, in which the denominator of the
/// softmax cancels. There is no overflow for any energy and temperature.
struct ScaledAttention {
    low: f64,
    high: f64,
    temperature: f64,
    /// `exp((low - high) / T)`: attention of the coldest pixel relative to the hottest.
    coldest: f64,
    /// `-expm1((low - high) / T)`.
    span: f64,
    /// Whether `(high - low) / T` is below 1, where differences of exponentials would lose precision.
    nearly_flat: bool,
}

impl ScaledAttention {
    fn new(low: f64, high: f64, temperature: f64) -> Self {
        let depth = (low - high) / temperature;
        Self {
            low,
            high,
            temperature,
            coldest: depth.exp(),
            span: -depth.exp_m1(),
            nearly_flat: -depth < 1.0,
        }
    }

    fn at(&self, g: f64) -> f64 {
        if self.nearly_flat {
            self.coldest * ((g - self.low) / self.temperature).exp_m1() / self.span
        } else {
            (((g - self.high) / self.temperature).exp() - self.coldest) / self.span
        }
    }

    fn level(&self, g: f64, levels: usize) -> usize {
        if g >= self.high {
            return levels - 1;
        }
        // 0 <= at < 1 up to rounding, and levels is at most 65,536.
        #[allow(
            clippy::cast_precision_loss,
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss
        )]
        let level = ((levels - 1) as f64 * self.at(g)).floor().max(0.0) as usize;
        level.min(levels - 1)
    }

    /// An energy that is certainly below that of every pixel whose scaled attention reaches `share`.
    fn energy_below(&self, share: f64) -> f64 {
        if share <= 0.0 {
            return f64::NEG_INFINITY;
        }
        let least = self.high + self.temperature * (share * self.span + self.coldest).ln();
        least - 1e-6 * (self.high - least).abs() - 1e-9 * self.temperature
    }
}

/// Histograms of a set of images: the sum of their counts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HistogramSum {
    /// `[bins]`, pixels.
    pub counts: Vec<u64>,
    /// Number of images summed.
    pub images: u64,
}

impl HistogramSum {
    /// A sum with nothing counted yet.
    pub fn new(bins: usize) -> Self {
        Self {
            counts: vec![0; bins],
            images: 0,
        }
    }

    /// Adds one image's counts.
    pub fn add(&mut self, counts: &[u32]) {
        self.counts
            .iter_mut()
            .zip(counts)
            .for_each(|(sum, &count)| *sum += u64::from(count));
        self.images += 1;
    }

    /// Adds another set.
    pub fn merge(&mut self, other: &Self) {
        self.counts
            .iter_mut()
            .zip(&other.counts)
            .for_each(|(sum, count)| *sum += count);
        self.images += other.images;
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;
    use proptest::prelude::*;

    fn map(energy: &[f64]) -> EnergyMap {
        EnergyMap {
            width: energy.len(),
            height: 1,
            energy: energy.to_vec(),
        }
    }

    fn counted(binning: &Binning, energy: &[f64]) -> Vec<u32> {
        let mut counts = vec![0; binning.bins()];
        binning.count(&map(energy), &mut counts).unwrap();
        counts
    }

    fn attention(temperature: f64, first: usize) -> Binning {
        Binning::Attention {
            temperature,
            levels: 256,
            first,
        }
    }

    #[test]
    fn the_papers_arithmetic_by_hand() {
        // T = 10, energies 0, 10 ln 2, 10 ln 3: softmax is 1/6, 2/6, 3/6; scaled 0, 0.5, 1; bins 0, 127, 255.
        let energies = [0.0, 10.0 * 2.0_f64.ln(), 10.0 * 3.0_f64.ln()];
        let all = counted(&attention(10.0, 0), &energies);
        assert_eq!((all[0], all[127], all[255]), (1, 1, 1));
        assert_eq!(all.iter().sum::<u32>(), 3);
        // Bins 0..100 are left out: 155 remain, and bin 127 is the 27th of them.
        let kept = counted(&attention(10.0, 101), &energies);
        assert_eq!(kept.len(), 155);
        assert_eq!((kept[26], kept[154], kept.iter().sum::<u32>()), (1, 1, 2));
    }

    #[test]
    fn both_forms_of_the_scaled_attention_agree() {
        for temperature in [1e-3, 0.5, 10.0, 99.0, 101.0, 1e6] {
            let scaled = ScaledAttention::new(0.0, 100.0, temperature);
            for g in [0.0, 1e-9, 1.0, 50.0, 99.0, 100.0] {
                // The plain form, which is exact enough in 64 bits unless the map is flat compared with T.
                let e = |g: f64| ((g - 100.0) / temperature).exp();
                let plain = (e(g) - e(0.0)) / (1.0 - e(0.0));
                assert!(
                    (scaled.at(g) - plain).abs() < 1e-9,
                    "T {temperature}, g {g}"
                );
            }
        }
    }

    #[test]
    fn log_energy_counts_every_pixel_once() {
        let binning = Binning::LogEnergy {
            epsilon: 1.0,
            edges: vec![0.5, 1.5, 2.5],
        };
        let at = |ln: f64| ln.exp() - 1.0;
        assert_eq!(
            counted(&binning, &[0.0, at(1.0), at(2.0), at(2.2), 1e30]),
            [1, 1, 2, 1]
        );
        // A value on an edge belongs to the bin above it.
        let on_edge = Binning::LogEnergy {
            epsilon: 1.0,
            edges: vec![2.0_f64.ln()],
        };
        assert_eq!(counted(&on_edge, &[1.0, 0.999]), [1, 1]);
    }

    #[test]
    fn a_constant_map_is_undefined_and_counts_nothing() {
        let mut counts = vec![0; 256];
        let flat = map(&[4.0; 6]);
        assert_eq!(
            attention(1.0, 0).count(&flat, &mut counts),
            Err(Undefined::ConstantMap)
        );
        assert_eq!(counts, vec![0; 256]);
    }

    proptest! {
        #[test]
        fn the_hottest_pixel_is_always_counted_and_skipping_changes_nothing(
            energy in prop::collection::vec(0.0..1e5_f64, 2..60), exponent in -3.0..6.0_f64, first in 0..255_usize
        ) {
            prop_assume!(map(&energy).range().0 < map(&energy).range().1);
            let temperature = 10.0_f64.powf(exponent);
            let all = counted(&attention(temperature, 0), &energy);
            let kept = counted(&attention(temperature, first), &energy);
            prop_assert_eq!(all.iter().sum::<u32>() as usize, energy.len());
            prop_assert!(all[255] >= 1);
            prop_assert_eq!(&all[first..], &kept[..]);
        }

        #[test]
        fn merging_in_any_order_and_grouping_is_identical(
            images in prop::collection::vec(prop::collection::vec(0..1000_u32, 8), 1..12), cut in 0..12_usize
        ) {
            let sum = |images: &[Vec<u32>]| {
                let mut sum = HistogramSum::new(8);
                images.iter().for_each(|counts| sum.add(counts));
                sum
            };
            let (a, b) = images.split_at(cut.min(images.len()));
            let (mut forward, mut backward) = (sum(a), sum(b));
            forward.merge(&sum(b));
            backward.merge(&sum(a));
            prop_assert_eq!(&forward, &backward);
            prop_assert_eq!(forward, sum(&images));
        }
    }
}
