//! Everything after the encoder against plain formulas written down once more, on cases that are hard for floating point.
//! Prints a table: `cargo test --release --test suite oracle:: -- --nocapture`.
#![allow(
    clippy::unwrap_used,
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::print_stdout
)]

use std::time::Duration;

use gapwatch::capture::undefined::Undefined;
use gapwatch::capture::{Frame, open};
use gapwatch::features::attention::{EnergyMap, Upsampler, energy_from_features};
use gapwatch::features::histogram::{Binning, HistogramSum};
use gapwatch::model::encoder::{Encoder, FeatureMap};
use gapwatch::model::{ModelOptions, ModelSpec};
use gapwatch::monitor::pipeline::Monitor;
use gapwatch::reference::Reference;
use gapwatch::reference::gap::Divergence;

/// Common size of the maps, width and height.
const COMMON: (usize, usize) = (80, 40);
/// A pixel may be in another bin than the oracle's only when it lies so close to an edge, in levels.
const EDGE: f64 = 1e-5;
/// Comparisons of equal bins agree to this.
const SAME: f64 = 1e-6;

/// Feature maps `[C, h, w]` of a hard case.
struct Case {
    name: String,
    shape: [usize; 3],
    activations: Vec<f32>,
    temperature: f64,
}

/// Numbers between 0 and 1, the same on every machine (SplitMix64).
pub struct Dice(pub u64);

impl Dice {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) as f64 / u64::MAX as f64
    }
}

fn cases() -> Vec<Case> {
    let mut dice = Dice(1);
    let mut random = |shape: [usize; 3], scale: &dyn Fn(f64) -> f64| -> Vec<f32> {
        let values = (0..shape.iter().product()).map(|_| scale(dice.next()) as f32);
        values.collect()
    };
    let block = [64, 20, 40];
    let case = |name: &str, shape, activations, temperature| Case {
        name: name.to_owned(),
        shape,
        activations,
        temperature,
    };
    let road = random(block, &|x| 3.0 * x - 1.0);
    let with = |value: f32| {
        let mut activations = road.clone();
        activations[7 * 800 + 123] = value;
        activations
    };
    let mut hot = vec![1.0; 64 * 800];
    hot[5 * 800 + 321] = 40.0;
    let mut cases = vec![
        case("an ordinary block", block, road.clone(), 10.0),
        case("all activations equal", block, vec![0.7; 64 * 800], 10.0),
        case(
            "all activations negative zero",
            block,
            vec![-0.0; 64 * 800],
            10.0,
        ),
        case("one hot pixel", block, hot, 10.0),
        case(
            "energies from 1e-30 to 1e30",
            block,
            random(block, &|x| 10_f64.powf(30.0 * x - 15.0)),
            1e28,
        ),
        case(
            "denormal activations",
            block,
            random(block, &|x| 1e-40 * x),
            1e-80,
        ),
        case(
            "negative zeros among ones",
            block,
            random(block, &|x| [-0.0, 1.0][usize::from(x < 0.5)]),
            10.0,
        ),
        case("NaN in one channel", block, with(f32::NAN), 10.0),
        case("infinity in one channel", block, with(f32::INFINITY), 10.0),
        case(
            "energies beyond 65,504",
            block,
            random(block, &|x| 3_000.0 * x),
            1e7,
        ),
        case(
            "the largest 32-bit activations",
            block,
            random(block, &|x| f64::from(f32::MAX) * x),
            1e77,
        ),
        case("a map of 1x1", [64, 1, 1], random([64, 1, 1], &|x| x), 10.0),
        case(
            "a map of 1x4096",
            [8, 1, 4_096],
            random([8, 1, 4_096], &|x| x),
            1.0,
        ),
    ];
    for temperature in [1e-3, 0.1, 1.0, 100.0, 1e4, 1e6] {
        let name = format!("T = {temperature}");
        cases.push(case(&name, block, road.clone(), temperature));
    }
    cases
}

/// `g(p) = sum_c A_c(p)^2`, with a compensated sum.
fn energies(case: &Case) -> Vec<f64> {
    let cells = case.shape[1] * case.shape[2];
    let cell = |cell: usize| {
        let (mut sum, mut lost) = (0.0, 0.0);
        for channel in 0..case.shape[0] {
            let a = f64::from(case.activations[channel * cells + cell]);
            let term = a * a - lost;
            let next = sum + term;
            lost = (next - sum) - term;
            sum = next;
        }
        sum
    };
    (0..cells).map(cell).collect()
}

/// Bilinear with half-pixel centres, `align_corners = false`.
fn resampled(energy: &[f64], (width, height): (usize, usize)) -> Vec<f64> {
    let at = |i: usize, from: usize, to: usize| {
        let centre = (i as f64 + 0.5) * from as f64 / to as f64 - 0.5;
        let centre = centre.max(0.0).min((from - 1) as f64);
        (centre.floor() as usize, centre - centre.floor())
    };
    let mut common = Vec::new();
    for y in 0..COMMON.1 {
        let (row, down) = at(y, height, COMMON.1);
        for x in 0..COMMON.0 {
            let (column, right) = at(x, width, COMMON.0);
            let g = |r: usize, c: usize| energy[r.min(height - 1) * width + c.min(width - 1)];
            common.push(
                (1.0 - down) * ((1.0 - right) * g(row, column) + right * g(row, column + 1))
                    + down * ((1.0 - right) * g(row + 1, column) + right * g(row + 1, column + 1)),
            );
        }
    }
    common
}

/// The level of every pixel before it is cut down, 0 to 255: softmax, then scaled to the image's own range.
fn attention_levels(energy: &[f64], temperature: f64) -> Vec<f64> {
    let high = energy.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let low = energy.iter().copied().fold(f64::INFINITY, f64::min);
    // exp(x) - exp(y) = exp(y) expm1(x - y), all relative to the hottest pixel.
    let above_low =
        |g: f64| ((low - high) / temperature).exp() * ((g - low) / temperature).exp_m1();
    let span = -((low - high) / temperature).exp_m1();
    energy
        .iter()
        .map(|&g| {
            let plain =
                (((g - high) / temperature).exp() - ((low - high) / temperature).exp()) / span;
            // The plain form where it does not cancel, the other where it does not overflow.
            255.0
                * if (high - low) / temperature > 1.0 {
                    plain
                } else {
                    above_low(g) / span
                }
        })
        .collect()
}

/// What differs between a histogram and the oracle's: pixels, and how far from an edge the farthest of them may lie.
struct Counted {
    chain: Vec<u64>,
    oracle: Vec<u64>,
    moved: u64,
    near_edges: u64,
}

fn counted(binning: &Binning, map: &EnergyMap, levels: &[f64]) -> Counted {
    let mut chain = vec![0; binning.bins()];
    binning.count(map, &mut chain).unwrap();
    let mut oracle = vec![0_u64; binning.bins()];
    for level in levels {
        oracle[(level.floor().max(0.0) as usize).min(binning.bins() - 1)] += 1;
    }
    let chain: Vec<u64> = chain.into_iter().map(u64::from).collect();
    let moved: u64 = chain.iter().zip(&oracle).map(|(a, b)| a.abs_diff(*b)).sum();
    let near = |level: &&f64| (*level - level.round()).abs() < EDGE;
    Counted {
        chain,
        oracle,
        moved: moved.div_ceil(2),
        near_edges: levels.iter().filter(near).count() as u64,
    }
}

/// Comparisons as their definitions say, from shares of 64 bits.
fn defined(divergence: Divergence, a: &[u64], b: &[u64]) -> f64 {
    let total = |of: &[u64]| of.iter().sum::<u64>() as f64;
    let (total_a, total_b) = (total(a), total(b));
    let pairs: Vec<(f64, f64)> = (a.iter().zip(b))
        .map(|(&a, &b)| (a as f64 / total_a, b as f64 / total_b))
        .collect();
    let sum = |of: &dyn Fn(f64, f64) -> f64| pairs.iter().map(|&(p, q)| of(p, q)).sum::<f64>();
    let log = |p: f64, q: f64| {
        if p > 0.0 {
            p * (2.0 * p / (p + q)).log2()
        } else {
            0.0
        }
    };
    match divergence {
        Divergence::JensenShannon => 0.5 * sum(&|p, q| log(p, q) + log(q, p)),
        Divergence::Hellinger => (0.5 * sum(&|p, q| (p.sqrt() - q.sqrt()).powi(2))).sqrt(),
        Divergence::ChiSquare => {
            0.5 * sum(&|p, q| {
                if p + q > 0.0 {
                    (p - q) * (p - q) / (p + q)
                } else {
                    0.0
                }
            })
        }
        Divergence::Wasserstein => {
            let mut ahead = 0.0;
            let moved = pairs.iter().map(|(p, q)| {
                ahead += p - q;
                f64::abs(ahead)
            });
            moved.sum::<f64>() / (pairs.len() - 1) as f64
        }
        Divergence::Pearson => {
            // In integers of 128 bits until the last step: nothing cancels.
            let n = a.len() as i128;
            let sums = |x: &[u64]| x.iter().map(|&x| i128::from(x)).sum::<i128>();
            let product = |x: &[u64], y: &[u64]| {
                let both = x
                    .iter()
                    .zip(y)
                    .map(|(&x, &y)| i128::from(x) * i128::from(y));
                n * both.sum::<i128>() - sums(x) * sums(y)
            };
            product(a, b) as f64 / ((product(a, a) as f64).sqrt() * (product(b, b) as f64).sqrt())
        }
    }
}

/// A histogram to compare with: a ramp.
fn ramp(bins: usize) -> Vec<u64> {
    (1..=bins as u64).collect()
}

fn reason(why: &Undefined) -> String {
    format!("undefined: {why}")
}

#[test]
fn the_chain_behind_the_encoder_agrees_with_plain_formulas() {
    println!(
        "| case | energies, relative | pixels in another bin, of those near an edge | comparisons, absolute |"
    );
    println!("|---|---|---|---|");
    for case in cases() {
        let features = FeatureMap {
            shape: case.shape,
            activations: &case.activations,
        };
        let mut map = EnergyMap::default();
        if let Err(why) = energy_from_features("e2", &features, &mut map) {
            let finite = case.activations.iter().all(|a| a.is_finite());
            assert_eq!(
                finite,
                why == Undefined::ConstantMap,
                "{}: {why}",
                case.name
            );
            println!("| {} | {} | | |", case.name, reason(&why));
            continue;
        }
        let oracle = energies(&case);
        let off =
            |(found, wanted): (&f64, &f64)| (found - wanted).abs() / wanted.max(f64::MIN_POSITIVE);
        let energy = map.energy.iter().zip(&oracle).map(off).fold(0.0, f64::max);
        assert!(energy < 1e-12, "{}: energies differ by {energy}", case.name);

        let mut common = EnergyMap::default();
        let size = (case.shape[2], case.shape[1]);
        Upsampler::new(size, COMMON).resample(&map, &mut common);
        let oracle = resampled(&oracle, size);
        let peak = oracle.iter().copied().fold(0.0, f64::max);
        for (found, wanted) in common.energy.iter().zip(&oracle) {
            assert!(
                (found - wanted).abs() <= 1e-12 * peak,
                "{}: {found} {wanted}",
                case.name
            );
        }

        let epsilon = 1e-6 * peak;
        let lowest = oracle.iter().copied().fold(f64::INFINITY, f64::min);
        let (from, to) = ((lowest + epsilon).ln(), (peak + epsilon).ln());
        let edges: Vec<f64> = (1..64)
            .map(|i| from + (to - from) * f64::from(i) / 64.0)
            .collect();
        let steps = |g: &f64| ((g + epsilon).ln() - from) / (to - from) * 64.0;
        let log_levels: Vec<f64> = oracle.iter().map(steps).collect();
        let attention = Binning::Attention {
            temperature: case.temperature,
            levels: 256,
            first: 0,
        };
        let (mut moved, mut near, mut worst) = (0, 0, 0.0_f64);
        for (binning, levels) in [
            (attention, attention_levels(&oracle, case.temperature)),
            (Binning::LogEnergy { epsilon, edges }, log_levels),
        ] {
            let counted = counted(&binning, &common, &levels);
            assert!(
                counted.moved <= counted.near_edges,
                "{}: {} pixels moved, {} near an edge",
                case.name,
                counted.moved,
                counted.near_edges
            );
            (moved, near) = (moved + counted.moved, near + counted.near_edges);
            let ramp = ramp(counted.oracle.len());
            for divergence in Divergence::ALL {
                match divergence.compare(&counted.chain, &ramp) {
                    Ok(found) => {
                        worst = worst
                            .max((found.value - defined(divergence, &counted.chain, &ramp)).abs());
                    }
                    Err(why) => panic!("{}: {why}", case.name),
                }
            }
        }
        assert!(worst < SAME, "{}: comparisons differ by {worst}", case.name);
        println!(
            "| {} | {energy:.1e} | {moved} of {near} | {worst:.1e} |",
            case.name
        );
    }
}

#[test]
fn comparisons_of_hard_histograms_agree_with_their_definitions() {
    let billion = 1_000_000_000_u64;
    let near = |of: u64| -> Vec<u64> { (0..64).map(|i| of + u64::from(i % 3 == 0)).collect() };
    let one = |bin: usize| {
        let mut counts = vec![0; 64];
        counts[bin] = 1;
        counts
    };
    println!("| histograms | largest difference over all comparisons |");
    println!("|---|---|");
    for (name, a, b) in [
        ("all but constant, 1e9 a bin", near(billion), ramp(64)),
        ("both all but constant", near(billion), near(billion + 7)),
        ("one count each, in one bin", one(3), one(3)),
        ("one count each, far apart", one(0), one(63)),
        (
            "1e9 frames of 3,200 pixels",
            ramp(64).iter().map(|n| n * 1_538_461_538).collect(),
            near(5),
        ),
    ] {
        let mut worst = 0.0_f64;
        for divergence in Divergence::ALL {
            let found = divergence.compare(&a, &b).unwrap().value;
            let off = (found - defined(divergence, &a, &b)).abs();
            assert!(off < SAME, "{name}, {}: {off}", divergence.name());
            worst = worst.max(off);
        }
        println!("| {name} | {worst:.1e} |");
    }
    for (name, counts, wanted) in [
        ("no count", vec![0; 64], Undefined::EmptyHistogram),
        (
            "constant, in a correlation",
            vec![billion; 64],
            Undefined::ConstantHistogram,
        ),
    ] {
        let found = Divergence::Pearson.compare(&counts, &ramp(64)).unwrap_err();
        assert_eq!(found, wanted);
        println!("| {name} | {} |", reason(&found));
    }
}

#[test]
fn a_thousand_million_frames_sum_up_exactly_in_any_order() {
    let counts: Vec<u32> = (0..256).map(|bin| bin * 50).collect();
    let mut of_one = HistogramSum::new(256);
    of_one.add(&counts);
    // Doubled thirty times, and added to the parts of another grouping.
    let mut doubled = of_one.clone();
    for _ in 0..30 {
        doubled.merge(&doubled.clone());
    }
    let mut grouped = HistogramSum::new(256);
    let mut part = of_one;
    for _ in 0..15 {
        part.merge(&part.clone());
    }
    for _ in 0..1 << 15 {
        grouped.merge(&part);
    }
    assert_eq!(doubled, grouped);
    assert_eq!(doubled.images, 1 << 30);
    for (sum, &count) in doubled.counts.iter().zip(&counts) {
        assert_eq!(*sum, u64::from(count) << 30);
    }
}

#[test]
fn verdicts_have_the_same_bits_on_one_thread_and_on_four() {
    let spec = ModelSpec::new(None, ModelOptions::default()).unwrap();
    let encoder = Encoder::load(&spec).unwrap();
    let reference = Reference::read(None).unwrap();
    let drive = "scene:sim?seed=7&seconds=2&fps=5&condition=fog:4@0-2";
    let verdicts = || {
        let mut monitor = Monitor::new(&encoder, &reference).unwrap();
        gapwatch::lab::register();
        let mut source = open(drive).unwrap();
        let mut bits = Vec::new();
        while let Some(frame) = source.next_frame().unwrap() {
            let verdict = monitor.step(&Frame {
                captured_at: frame.captured_at + Duration::from_secs(1),
                ..frame
            });
            bits.push(verdict.score.unwrap().to_bits());
            bits.extend(verdict.blocks.iter().map(|block| block.gap.to_bits()));
        }
        bits
    };
    let alone = verdicts();
    assert_eq!(alone.len(), 40);
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(verdicts)).collect();
        for thread in threads {
            assert_eq!(thread.join().unwrap(), alone);
        }
    });
}
