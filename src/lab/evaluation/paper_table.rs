//! The paper's table: similarity of image sets to a reference set, for each tap, and whether the sets are in the order
//! that the paper found: another set of the reference's own domain, then adapted simulation, plain simulation and
//! noise.
//!
//! Whole sets are compared with equal numbers of images, because the similarity of an average rises with the number of
//! images. Intervals resample blocks of images of the reference and of the sets, together in every round, so that the
//! order can be judged in each; see [`PaperRow::order_share`].

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::field_sets::SequenceSet;
use crate::calibration::survey::Survey;
use crate::calibration::{PaperBinning, TapHistogram, counts_of};
use crate::capture::undefined::Undefined;
use crate::features::attention::EnergyMap;
use crate::features::histogram::Binning;
use crate::reference::Nominal;
use crate::reference::gap::energy_norm::EnergyNorm;
use crate::reference::gap::moments::{self, Moments, energy_levels};
use crate::reference::gap::{Divergence, Metric};
use crate::statistics::bootstrap::{ROUNDS, percentile_interval};
use crate::statistics::quantile::median;
use crate::statistics::random::SplitMix64;

/// One reference, metric and tap.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PaperRow {
    /// The reference set.
    pub reference: String,
    /// Number of its images.
    pub images: usize,
    /// Number of blocks in which they are.
    pub blocks: usize,
    /// The metric.
    pub metric: Metric,
    /// The tap.
    pub tap: String,
    /// The sets in the order that the paper found: the most similar set first.
    pub sets: Vec<SetSimilarity>,
    /// Whether each set is more similar than the next one; `None` when a value is undefined.
    pub order_holds: Option<bool>,
    /// Share of resamples in which the order holds, after the resamples of each set have been moved so that their
    /// centre is its value.
    pub order_share: Option<f64>,
    /// Number of resamples.
    pub rounds: usize,
}

/// One set compared with the reference.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SetSimilarity {
    /// The set.
    pub set: String,
    /// Number of images taken from it, evenly spread.
    pub images: usize,
    /// Number of blocks in which they are.
    pub blocks: usize,
    /// The value of the metric: a correlation or a distance.
    pub value: Option<f64>,
    /// Its 95 % interval.
    pub interval: Option<(f64, f64)>,
    /// Why there is no value.
    pub reason: Option<String>,
}

/// The sets of a table, the most similar set first, as in the paper.
pub struct Sets<'a> {
    /// The set with which the others are compared.
    pub reference: &'a SequenceSet,
    /// The other sets.
    pub sets: Vec<&'a SequenceSet>,
}

/// Rows of a table, for each metric and tap.
pub fn rows(of: &Sets<'_>, taps: &[String], metrics: &[Metric]) -> Vec<PaperRow> {
    let pairs: Vec<(Metric, usize)> = metrics
        .iter()
        .flat_map(|&metric| (0..taps.len()).map(move |tap| (metric, tap)))
        .collect();
    pairs
        .par_iter()
        .map(|&(metric, tap)| row(of, &taps[tap], metric, tap))
        .collect()
}

/// Sums over the images of a block.
struct Block {
    images: usize,
    /// Counts or levels.
    sums: Vec<u64>,
    /// Moments of levels.
    moments: Option<Moments>,
}

/// How the images of one tap are counted. In every resample, bins and scales are those of the whole reference.
enum Counting {
    Histogram(Binning),
    /// Levels of energies, with the energy below which a channel counts as inactive.
    Levels(f64),
}

fn row(of: &Sets<'_>, tap_name: &str, metric: Metric, tap: usize) -> PaperRow {
    let images = of.sets.iter().map(|set| set.images()).min().unwrap_or(0);
    let counting = Counting::fit(of.reference, metric, tap);
    let take = |set: &SequenceSet, images: usize| {
        let counting = counting.as_ref().map_err(Undefined::clone)?;
        counting.take(set, images, tap)
    };
    let reference = take(of.reference, of.reference.images());
    let sets: Vec<Result<Vec<Block>, Undefined>> =
        of.sets.iter().map(|set| take(set, images)).collect();
    let compared = |draw: &mut dyn FnMut(usize) -> Vec<u32>| -> Vec<Result<f64, Undefined>> {
        let nominal = counting.as_ref().map_err(Undefined::clone);
        let nominal = nominal.and_then(|counting| {
            let reference = reference.as_ref().map_err(Undefined::clone)?;
            counting.nominal(reference, &draw(reference.len()))
        });
        let compared = sets.iter().map(|set| {
            let nominal = nominal.as_ref().map_err(Undefined::clone)?;
            let set = set.as_ref().map_err(Undefined::clone)?;
            let (sums, images) = sums(set, &draw(set.len()));
            Ok(nominal.compare(metric, &sums, images)?.value)
        });
        compared.collect()
    };
    let found = compared(&mut |blocks| vec![1; blocks]);
    let mut dice = SplitMix64::new(0);
    let rounds: Vec<Vec<Result<f64, Undefined>>> = (0..ROUNDS)
        .map(|_| compared(&mut |blocks| dice.multiplicities(blocks)))
        .collect();
    let scale = Scale::of(metric);
    let resampled: Vec<Vec<f64>> = found
        .iter()
        .enumerate()
        .map(|(set, found)| {
            let values = rounds.iter().filter_map(|round| round[set].as_ref().ok());
            let values = values.copied().collect();
            found
                .as_ref()
                .map_or(Vec::new(), |&found| scale.recentred(values, found))
        })
        .collect();
    let blocks = |of: &Result<Vec<Block>, Undefined>| of.as_ref().map_or(0, |blocks| blocks.len());
    let similarities = of.sets.iter().zip(&sets).zip(found.iter().zip(&resampled));
    let similarities = similarities.map(|((set, taken), (found, resampled))| SetSimilarity {
        set: set.name.clone(),
        images,
        blocks: blocks(taken),
        value: found.as_ref().ok().copied(),
        interval: percentile_interval(resampled.clone()),
        reason: found.as_ref().err().map(ToString::to_string),
    });
    let values: Option<Vec<f64>> = found.iter().map(|of| of.as_ref().ok().copied()).collect();
    let in_every_set = resampled.iter().all(|values| values.len() == ROUNDS);
    PaperRow {
        reference: of.reference.name.clone(),
        images: of.reference.images(),
        blocks: blocks(&reference),
        metric,
        tap: tap_name.to_owned(),
        sets: similarities.collect(),
        order_holds: values.map(|values| scale.falls(&values)),
        order_share: in_every_set.then(|| {
            let round = |round: usize| -> Vec<f64> {
                resampled.iter().map(|values| values[round]).collect()
            };
            let held = (0..ROUNDS).filter(|&of| scale.falls(&round(of))).count();
            // It is at most a thousand.
            #[allow(clippy::cast_precision_loss)]
            {
                held as f64 / ROUNDS as f64
            }
        }),
        rounds: ROUNDS,
    }
}

/// How the values of a metric are read: correlations from -1 to 1, or distances from 0 on.
#[derive(Clone, Copy)]
enum Scale {
    Correlation,
    Distance,
}

impl Scale {
    fn of(metric: Metric) -> Self {
        match metric.divergence() {
            Some(Divergence::Pearson) => Self::Correlation,
            _ => Self::Distance,
        }
    }

    /// The value on an unbounded scale: Fisher's z of a correlation, the logarithm of a distance.
    fn open(self, value: f64) -> f64 {
        const LEAST: f64 = 1e-12;
        match self {
            Self::Correlation => value.clamp(LEAST - 1.0, 1.0 - LEAST).atanh(),
            Self::Distance => value.max(LEAST).ln(),
        }
    }

    fn close(self, value: f64) -> f64 {
        match self {
            Self::Correlation => value.tanh(),
            Self::Distance => value.exp(),
        }
    }

    /// The values of resamples, moved so that their centre is the value found. Drawing with replacement adds noise,
    /// which makes every set look less similar than it is.
    #[allow(clippy::cast_precision_loss)]
    fn recentred(self, values: Vec<f64>, found: f64) -> Vec<f64> {
        let opened: Vec<f64> = values.into_iter().map(|value| self.open(value)).collect();
        let mean = opened.iter().sum::<f64>() / opened.len().max(1) as f64;
        let shift = self.open(found) - mean;
        opened
            .into_iter()
            .map(|value| self.close(value + shift))
            .collect()
    }

    /// Whether each value means a higher similarity than the next one.
    fn falls(self, values: &[f64]) -> bool {
        values.windows(2).all(|pair| match self {
            Self::Correlation => pair[0] > pair[1],
            Self::Distance => pair[0] < pair[1],
        })
    }
}

/// Sums over blocks, each as often as it was drawn, and the number of their images.
fn sums(blocks: &[Block], times: &[u32]) -> (Vec<u64>, usize) {
    let mut sums = vec![0; blocks.first().map_or(0, |block| block.sums.len())];
    let mut images = 0;
    for (block, &times) in blocks.iter().zip(times) {
        images += block.images * times as usize;
        let pairs = sums.iter_mut().zip(&block.sums);
        pairs.for_each(|(sum, &own)| *sum += u64::from(times) * own);
    }
    (sums, images)
}

impl Counting {
    fn fit(reference: &SequenceSet, metric: Metric, tap: usize) -> Result<Self, Undefined> {
        if metric == Metric::Mahalanobis {
            let frames = reference.sequences.iter().flat_map(|of| &of.survey.frames);
            let peaks =
                frames.map(|frame| Ok(frame.as_ref().map_err(Undefined::clone)?.peaks[tap]));
            let peak = median(peaks.collect::<Result<_, Undefined>>()?);
            return Ok(Self::Levels(
                moments::EPSILON_SHARE * peak.ok_or(Undefined::NoScore)?,
            ));
        }
        let maps = reference
            .sequences
            .iter()
            .flat_map(|of| of.survey.common_maps(tap));
        let maps = maps.collect::<Result<Vec<EnergyMap>, _>>()?;
        let maps: Vec<&EnergyMap> = maps.iter().collect();
        let fitted = TapHistogram::fit(&maps, metric, PaperBinning::PUBLISHED)?;
        Ok(Self::Histogram(fitted.binning))
    }

    /// Takes `images` images of a set, evenly spread, and sums them for each block.
    fn take(&self, set: &SequenceSet, images: usize, tap: usize) -> Result<Vec<Block>, Undefined> {
        let all = set.images();
        let mut chosen = (0..images).map(|index| index * all / images).peekable();
        let (mut blocks, mut before) = (Vec::new(), 0);
        for sequence in &set.sequences {
            let numbers = self.numbers(&sequence.survey, tap);
            for range in sequence.blocks() {
                let mut block = Block {
                    images: 0,
                    sums: Vec::new(),
                    moments: None,
                };
                while let Some(index) = chosen.next_if(|&index| index < before + range.end) {
                    block.add(
                        numbers[index - before].as_ref().map_err(Undefined::clone)?,
                        self,
                    );
                }
                if block.images > 0 {
                    blocks.push(block);
                }
            }
            before += numbers.len();
        }
        Ok(blocks)
    }

    /// What is taken from every image of a sequence.
    fn numbers(&self, survey: &Survey, tap: usize) -> Vec<Result<Vec<u32>, Undefined>> {
        match self {
            Self::Histogram(binning) => survey
                .common_maps(tap)
                .map(|map| counts_of(binning, &map?))
                .collect(),
            Self::Levels(epsilon) => survey
                .frames
                .iter()
                .map(|frame| {
                    let energies = &frame.as_ref().map_err(Undefined::clone)?.means[tap].energy;
                    let mut levels = vec![0; energies.len()];
                    energy_levels(energies, *epsilon, &mut levels);
                    Ok(levels)
                })
                .collect(),
        }
    }

    /// The reference made from blocks, each as often as it was drawn.
    fn nominal(&self, blocks: &[Block], times: &[u32]) -> Result<Nominal, Undefined> {
        match self {
            Self::Histogram(binning) => Ok(Nominal::Histogram {
                binning: binning.clone(),
                counts: sums(blocks, times).0,
            }),
            Self::Levels(epsilon) => {
                let energies = blocks.first().map_or(0, |block| block.sums.len());
                let mut moments = Moments::new(energies);
                for (block, &times) in blocks.iter().zip(times) {
                    let own = block.moments.iter().cycle().take(times as usize);
                    own.for_each(|own| moments.merge(own));
                }
                EnergyNorm::fit(*epsilon, &moments, None).map(Nominal::Energies)
            }
        }
    }
}

impl Block {
    fn add(&mut self, numbers: &[u32], counting: &Counting) {
        self.images += 1;
        self.sums.resize(numbers.len(), 0);
        let pairs = self.sums.iter_mut().zip(numbers);
        pairs.for_each(|(sum, &number)| *sum += u64::from(number));
        if matches!(counting, Counting::Levels(_)) {
            let moments = self
                .moments
                .get_or_insert_with(|| Moments::new(numbers.len()));
            moments.add(numbers);
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::super::field_sets::tests::sequences;
    use super::*;

    #[test]
    fn sets_that_lie_farther_and_farther_off_are_in_order() {
        let reference = sequences("reference", &[40], 1, 1.0);
        let sets = [("near", 1.0), ("farther", 2.0), ("far", 9.0)]
            .map(|(name, level)| sequences(name, &[30, 5], 1, level));
        let table = |order: [usize; 3]| Sets {
            reference: &reference,
            sets: order.map(|index| &sets[index]).to_vec(),
        };
        let taps = ["e2".to_owned()];
        let metrics = [Metric::Mahalanobis];
        let [row] = &rows(&table([0, 1, 2]), &taps, &metrics)[..] else {
            panic!("one metric, one tap, one row");
        };
        assert_eq!((row.order_holds, row.order_share), (Some(true), Some(1.0)));
        assert_eq!((row.images, row.blocks), (40, 40));
        for set in &row.sets {
            assert_eq!((set.images, set.blocks), (35, 35));
            let (low, high) = set.interval.unwrap();
            assert!(
                low < set.value.unwrap() && set.value.unwrap() < high,
                "{set:?}"
            );
        }
        let row = &rows(&table([0, 2, 1]), &taps, &metrics)[0];
        assert_eq!((row.order_holds, row.order_share), (Some(false), Some(0.0)));
    }

    #[test]
    fn equally_many_images_are_taken_evenly_spread() {
        let reference = sequences("reference", &[40], 10, 1.0);
        let (few, many) = (
            sequences("few", &[7], 2, 1.0),
            sequences("many", &[30, 12], 10, 1.0),
        );
        let sets = Sets {
            reference: &reference,
            sets: vec![&few, &many],
        };
        let row = &rows(&sets, &["e2".to_owned()], &[Metric::Paper])[0];
        let counted: Vec<_> = row
            .sets
            .iter()
            .map(|set| (set.images, set.blocks))
            .collect();
        // Images 0, 6, 12, .. 36 of many: three blocks of ten, and the last two in the second sequence.
        assert_eq!((row.blocks, counted), (4, vec![(7, 4), (7, 4)]));
    }

    #[test]
    fn undefined_stays_undefined_with_its_reason() {
        let reference = sequences("reference", &[40], 10, 1.0);
        let mut black = sequences("black", &[20], 10, 1.0);
        black.sequences[0].survey.frames[19] = Err(Undefined::Black);
        let sets = Sets {
            reference: &reference,
            sets: vec![&reference, &black],
        };
        let row = &rows(&sets, &["e2".to_owned()], &[Metric::Mahalanobis])[0];
        assert_eq!((row.order_holds, row.order_share), (None, None));
        assert!(row.sets[0].value.is_some());
        let black = &row.sets[1];
        assert_eq!((black.value, black.interval), (None, None));
        assert_eq!(black.reason.as_deref(), Some("picture is black"));
    }

    #[test]
    fn resamples_centre_on_what_was_found_and_stay_in_range() {
        let moved = Scale::Correlation.recentred(vec![0.9, 0.92, 0.96], 0.97);
        assert!(
            moved[0] < 0.97 && moved[2] > 0.97 && moved[2] < 1.0,
            "{moved:?}"
        );
        let moved = Scale::Distance.recentred(vec![2.0, 8.0], 1.0);
        assert!((moved[0] - 0.5).abs() < 1e-12 && (moved[1] - 2.0).abs() < 1e-12);
        assert!(
            Scale::Distance
                .recentred(vec![0.0, 1.0], 0.0)
                .iter()
                .all(|v| v.is_finite())
        );
    }
}
