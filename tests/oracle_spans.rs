//! What windows and changes compare, against plain formulas over a list of every frame, in hard cases of time and level.
//! Prints a table: `cargo test --release --test suite oracle_spans:: -- --nocapture`.
#![allow(
    clippy::unwrap_used,
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::print_stdout
)]

use std::time::Duration;

use crate::oracle::Dice;

use gapwatch::monitor::span_watch::SpanWatch;
use gapwatch::reference::Span;
use gapwatch::reference::gap::energy_norm::EnergyNorm;
use gapwatch::reference::gap::moments::{Moments, STEPS_PER_NAT};

/// Half a second, as whole nanoseconds.
const BIN_NS: u64 = 500_000_000;
/// Bins of the past that are kept at most.
const KEPT: usize = 70;
/// Levels agree to this, nats.
const SAME: f64 = 1e-9;

/// Energies of the norms.
const ENERGIES: usize = 6;
/// Spread that is added to that of every energy, nats.
const FLOOR: f64 = 0.05;
/// Share by which correlations are shrunk.
const SHRINKAGE: f64 = 0.1;
/// Distances agree to this, relative: matrices that whiten have 32 bits.
const WHITENED: f64 = 1e-4;

/// Frames of one energy at rising times.
struct Case {
    name: &'static str,
    /// Longest time from one frame to the next that a board would name, ms.
    period_ms: u64,
    frames: Box<dyn Iterator<Item = (u64, u32)>>,
    /// Compare after every so many frames.
    every: usize,
}

/// Whole numbers from 0 to any number, the same on every machine.
fn dice(seed: u64) -> impl FnMut(u64) -> u64 {
    let mut dice = Dice(seed);
    move |sides| (dice.next() * sides as f64) as u64
}

fn cases() -> Vec<Case> {
    let (mut jitter, mut level, mut pause) = (dice(1), dice(2), dice(3));
    let (mut now, mut holes) = (0, 0);
    let steady = |step: u64, level: fn(u64) -> u32| {
        Box::new((0..2_000).map(move |n| (n * step, level(n)))) as Box<dyn Iterator<Item = _>>
    };
    vec![
        Case {
            name: "equal frames",
            period_ms: 100,
            frames: steady(100, |_| 9_000),
            every: 1,
        },
        Case {
            name: "a step of one level at 30 frames a second",
            period_ms: 34,
            frames: steady(33, |n| 9_000 + u32::from(n > 1_200)),
            every: 1,
        },
        Case {
            name: "one frame of the largest energy",
            period_ms: 100,
            frames: steady(100, |n| if n == 900 { 150_000 } else { 0 }),
            every: 1,
        },
        Case {
            name: "one frame a second",
            period_ms: 1_000,
            frames: steady(1_000, |n| 5_000 + (n as u32 % 7) * 100),
            every: 1,
        },
        Case {
            name: "a frame every two seconds",
            period_ms: 2_000,
            frames: steady(2_000, |n| 5_000 + (n as u32 % 5) * 100),
            every: 1,
        },
        Case {
            name: "times that jitter by 90 ms",
            period_ms: 100,
            frames: Box::new(
                (0..5_000_u64).map(move |n| (n * 100 + jitter(90), (n % 251) as u32 * 40)),
            ),
            every: 1,
        },
        Case {
            name: "holes of up to a minute",
            period_ms: 100,
            frames: Box::new((0..20_000_u64).map(move |n| {
                holes += u64::from(n % 311 == 310) * (1_000 + pause(58_000));
                (n * 100 + holes, (n / 13 % 101) as u32 * 90)
            })),
            every: 1,
        },
        Case {
            name: "a million frames at 30 to 60 a second",
            period_ms: 34,
            frames: Box::new((0..1_000_000_u64).map(move |_| {
                now += 16 + level(17);
                (now, 20_000 + level(2_000) as u32)
            })),
            every: 997,
        },
    ]
}

/// Every frame that was seen: time in which the road was seen, ns; number of the stretch without an interruption; level.
type Seen = Vec<(u64, usize, f64)>;

fn mean(of: impl Iterator<Item = f64>) -> Option<f64> {
    let all: Vec<f64> = of.collect();
    (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64)
}

/// Mean of the frames in the newest bins of the present stretch.
fn recent(seen: &Seen, bins: u64) -> Option<f64> {
    let &(now, stretch, _) = seen.last()?;
    let own = || seen.iter().rev().take_while(|of| of.1 == stretch);
    let began = own().last()?.0;
    if now - began < BIN_NS * (bins - 1) {
        return None;
    }
    let from = (now / BIN_NS + 1).saturating_sub(bins);
    mean(own().filter(|of| of.0 / BIN_NS >= from).map(|of| of.2))
}

/// Mean of the means of bins of the past. A bin is past when it is two seconds old, or when the road was lost from view; a bin
/// that an interruption cuts is two bins.
fn past(seen: &Seen, recent_bins: u64, bins: u64) -> Option<f64> {
    let &(now, stretch, _) = seen.last()?;
    let newest = now / BIN_NS;
    // The bins that are past, the oldest first: number, stretch, levels.
    let mut all: Vec<(u64, usize, Vec<f64>)> = vec![];
    let from = seen.partition_point(|of| of.0 / BIN_NS + 200 < newest);
    for &(at, of, level) in &seen[from..] {
        let number = at / BIN_NS;
        if of == stretch && number + 4 > newest {
            continue;
        }
        match all.last_mut() {
            Some((last, same, levels)) if *last == number && *same == of => levels.push(level),
            _ => all.push((number, of, vec![level])),
        }
    }
    let all = &all[all.len().saturating_sub(KEPT)..];
    let end = (all.last()?.0 + 1).checked_sub(recent_bins - 4)?;
    let begin = end.checked_sub(bins).filter(|&from| from + 4 > all[0].0)?;
    let used = all.iter().filter(|of| (begin..end).contains(&of.0));
    let means: Vec<f64> = used.filter_map(|of| mean(of.2.iter().copied())).collect();
    (means.len() as u64 * 4 >= bins)
        .then(|| mean(means.into_iter()))
        .flatten()
}

#[test]
fn windows_and_changes_agree_with_plain_means_over_every_frame() {
    println!("| case | frames | comparisons | largest difference, nats |");
    println!("|---|---|---|---|");
    for case in cases() {
        let period = Duration::from_millis(case.period_ms);
        let mut watch = SpanWatch::of(&Span::ALL, 1, period);
        let patience_ms = (case.period_ms * 3 / 2).max(500);
        let mut seen: Seen = vec![];
        let (mut last_ms, mut time_ns, mut stretch) = (None, 0, 0);
        let (mut frames, mut compared, mut worst) = (0, 0, 0.0_f64);
        for (ms, level) in case.frames {
            frames += 1;
            watch.add(Duration::from_millis(ms), &[level]);
            match last_ms.map(|last| ms - last) {
                Some(since) if since <= patience_ms => time_ns += since * 1_000_000,
                Some(_) => stretch += 1,
                None => {}
            }
            last_ms = Some(ms);
            seen.push((time_ns, stretch, f64::from(level) / STEPS_PER_NAT));
            if seen.len() > 8_000 {
                seen.drain(..4_000);
            }
            if frames % case.every != 0 {
                continue;
            }
            for (index, span) in Span::ALL.iter().enumerate() {
                let bins = |seconds: f64| (2.0 * seconds) as u64;
                let now = recent(&seen, bins(span.recent_s));
                let wanted = match span.past_s {
                    None => now,
                    Some(length) => now
                        .zip(past(&seen, bins(span.recent_s), bins(length)))
                        .map(|(now, before)| now - before),
                };
                let found = watch.levels(index).map(|levels| levels[0]);
                let name = case.name;
                match (found, wanted) {
                    (Some(found), Some(wanted)) => worst = worst.max((found - wanted).abs()),
                    (None, None) => continue,
                    different => panic!("{name}, {span:?} at {ms} ms: {different:?}"),
                }
                assert!(worst < SAME, "{name}, {span:?} at {ms} ms: {worst}");
                compared += 1;
            }
        }
        assert!(compared > 100, "{}: {compared} comparisons", case.name);
        println!("| {} | {frames} | {compared} | {worst:.1e} |", case.name);
    }
}

/// Solves a linear system by elimination with pivots.
fn solved(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for column in 0..n {
        let pivot = (column..n)
            .max_by(|&x, &y| a[x][column].abs().total_cmp(&a[y][column].abs()))
            .unwrap();
        a.swap(column, pivot);
        b.swap(column, pivot);
        for row in column + 1..n {
            let share = a[row][column] / a[column][column];
            let (above, below) = a.split_at_mut(row);
            let columns = below[0].iter_mut().zip(&above[column]).skip(column);
            columns.for_each(|(own, pivot)| *own -= share * pivot);
            b[row] -= share * b[column];
        }
    }
    for row in (0..n).rev() {
        let known: f64 = (row + 1..n).map(|k| a[row][k] * b[k]).sum();
        b[row] = (b[row] - known) / a[row][row];
    }
    b
}

/// Draws the levels of a frame from dice with any number of sides.
type Draw = fn(&mut dyn FnMut(u64) -> u64) -> [u64; ENERGIES];

/// Nominal levels, `[frames][energies]`, and what is measured with them.
struct Plain {
    mean: Vec<f64>,
    matrix: Vec<Vec<f64>>,
}

impl Plain {
    /// Variances get a floor, and correlations are shrunk towards none.
    fn of(rows: &[[f64; ENERGIES]]) -> Self {
        let average = |of: &dyn Fn(&[f64; ENERGIES]) -> f64| {
            rows.iter().map(of).sum::<f64>() / rows.len() as f64
        };
        let mean: Vec<f64> = (0..ENERGIES).map(|i| average(&|row| row[i])).collect();
        let covariance: Vec<Vec<f64>> = (0..ENERGIES)
            .map(|i| {
                let with = |j: usize| average(&|row| (row[i] - mean[i]) * (row[j] - mean[j]));
                (0..ENERGIES).map(with).collect()
            })
            .collect();
        let spread = |i: usize| (covariance[i][i] + FLOOR * FLOOR).sqrt();
        let entry = |i: usize, j: usize| {
            let own = if i == j {
                SHRINKAGE * spread(i).powi(2)
            } else {
                0.0
            };
            (1.0 - SHRINKAGE) * covariance[i][j] + own
        };
        let matrix = (0..ENERGIES)
            .map(|i| (0..ENERGIES).map(|j| entry(i, j)).collect())
            .collect();
        Self { mean, matrix }
    }

    /// `d' S^-1 d / n`
    fn distance(&self, levels: &[f64]) -> f64 {
        let apart: Vec<f64> = levels.iter().zip(&self.mean).map(|(a, b)| a - b).collect();
        let across = solved(self.matrix.clone(), apart.clone());
        let sum: f64 = apart.iter().zip(across).map(|(a, b)| a * b).sum();
        sum / ENERGIES as f64
    }
}

#[test]
fn norms_of_windows_and_changes_agree_with_plain_covariances() {
    println!("| nominal levels | frames | largest difference of a distance, relative |");
    println!("|---|---|---|");
    let mut dice = dice(4);
    let mut rows = |frames: usize, of: Draw| (0..frames).map(|_| of(&mut dice)).collect::<Vec<_>>();
    let cases = [
        (
            "a million frames near the largest energy",
            rows(1_000_000, |dice| {
                std::array::from_fn(|_| 280_000 + dice(40))
            }),
        ),
        (
            "energies that go together, and one that never moves",
            rows(20_000, |dice| {
                let both = dice(3_000);
                [both, both + dice(20), 4_000 - both, 7, dice(2), 9_000]
            }),
        ),
        ("equal frames", rows(5_000, |_| [5_000; ENERGIES])),
        (
            "two frames",
            rows(2, |dice| std::array::from_fn(|_| dice(9_000))),
        ),
    ];
    for (name, levels) in cases {
        let mut moments = Moments::new(ENERGIES);
        let mut differences = Moments::new(ENERGIES);
        let mut scratch = [0; ENERGIES];
        let nats = |of: u64| of as f64 / STEPS_PER_NAT;
        let rows: Vec<[f64; ENERGIES]> = levels.iter().map(|row| row.map(nats)).collect();
        for (row, nats) in levels.iter().zip(&rows) {
            moments.add(&row.map(|level| level as u32));
            differences.add_differences(nats, &mut scratch);
        }
        let window = EnergyNorm::fit(1e-3, &moments, None).unwrap();
        let change = EnergyNorm::fit_changes(1e-3, &differences, &moments, 0, None).unwrap();
        let plain = Plain::of(&rows);
        let mut worst = 0.0_f64;
        for step in 0..20 {
            let apart: [f64; ENERGIES] = std::array::from_fn(|i| 0.3 * f64::from(step) - i as f64);
            let at: Vec<f64> = apart.iter().zip(&plain.mean).map(|(a, b)| a + b).collect();
            let wanted = plain.distance(&at);
            for found in [
                window.distance_of(&at, &mut [0.0; ENERGIES]),
                change.distance_of(&apart, &mut [0.0; ENERGIES]),
            ] {
                worst = worst.max((found - wanted).abs() / wanted);
            }
        }
        assert!(worst < WHITENED, "{name}: distances differ by {worst}");
        println!("| {name} | {} | {worst:.1e} |", levels.len());
    }
}
