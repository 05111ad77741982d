#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss
)]
use super::*;
use crate::features::histogram::Binning;
use crate::monitor::warn::Answer;
use crate::reference::gap::Divergence;
use crate::reference::{Nominal, ScalePoint, TapReference};

#[test]
fn a_score_goes_before_a_drift_and_a_full_window_settles() {
    let evidence = |score, drift, fill| Evidence {
        drift,
        fill,
        ..Evidence::of_gap(score)
    };
    let score = |score, settled| Judgement::Score { score, settled };
    for (found, wanted) in [
        (evidence(0.5, 0.5, 1.0), score(0.5, true)),
        (evidence(0.5, 0.999, 0.999), score(0.5, false)),
        (evidence(0.5, 1.0, 1.0), Judgement::Drift { settled: true }),
        (
            evidence(0.999, 1.0, 0.5),
            Judgement::Drift { settled: false },
        ),
        (evidence(1.0, 1.0, 1.0), score(1.0, true)),
        (evidence(2.0, 0.0, 1.0), score(2.0, true)),
    ] {
        assert_eq!(found.judgement(WarnOn::default()), wanted);
    }
}

#[test]
fn only_the_answers_that_raise_the_warning_are_evidence() {
    let evidence = Evidence {
        change: Some(2.0),
        lanes: Some(0.75),
        drift: 1.0,
        ..Evidence::of_gap(4.0)
    };
    let of = |names: &[Answer]| {
        let warn = WarnOn::these(names);
        (evidence.score_of(warn), evidence.judgement(warn))
    };
    let settled = true;
    let gap = Judgement::Score {
        score: 4.0,
        settled,
    };
    assert_eq!(of(&[Answer::Gap, Answer::Lanes]), (Some(4.0), gap));
    let lanes = Judgement::Lanes { settled };
    assert_eq!(of(&[Answer::Change, Answer::Lanes]), (Some(2.0), lanes));
    assert_eq!(of(&[Answer::Lanes]), (Some(1.5), lanes));
    let change = Judgement::Change { settled };
    assert_eq!(of(&[Answer::Change]), (Some(2.0), change));
    // A forecast below a half, and a past that is not known yet, are no evidence.
    let calm = Evidence {
        change: None,
        lanes: Some(0.49),
        ..Evidence::of_gap(4.0)
    };
    let nominal = Judgement::Score {
        score: 0.0,
        settled,
    };
    assert_eq!(calm.judgement(WarnOn::these(&[Answer::Lanes])), nominal);
    assert_eq!(calm.judgement(WarnOn::these(&[Answer::Change])), nominal);
    assert_eq!(calm.score_of(WarnOn::these(&[Answer::Change])), None);
}

/// A detector of one tap with four bins, nominal (1, 1, 1, 1), median 0.1 and threshold 0.3 for any window.
fn detector(window_s: f64) -> Detector {
    let metric = Metric::LogEnergy(Divergence::JensenShannon);
    Detector::of(metric, vec![component(vec![1; 4])], window_s)
}

fn component(counts: Vec<u64>) -> Component {
    let tap = TapReference {
        tap: "e2".into(),
        median_peak_energy: 1.0,
        images: 1,
        nominal: Nominal::Histogram {
            binning: Binning::LogEnergy {
                epsilon: 1e-6,
                edges: vec![0.0, 1.0, 2.0],
            },
            counts,
        },
        scale: vec![ScalePoint {
            frames: 1,
            windows: 9,
            median: 0.1,
            threshold: 0.3,
        }],
        spans: Vec::new(),
    };
    Component {
        name: "simulation".into(),
        taps: vec![tap],
    }
}

#[test]
fn the_nearest_nominal_domain_counts() {
    let metric = Metric::LogEnergy(Divergence::JensenShannon);
    let two = vec![component(vec![1, 1, 0, 0]), component(vec![0, 0, 1, 1])];
    let mut detector = Detector::of(metric, two, 1.0);
    let seen = detector.observe(at(0), &[0, 0, 7, 7, 0, 0, 7, 7]).unwrap();
    assert_eq!((seen.component, seen.blocks[0].gap), (1, 0.0));
    assert_eq!(detector.taken_len(), 8);
    // Of two domains at the same distance, it is the first.
    let two = vec![component(vec![1; 4]), component(vec![1; 4])];
    let alike = Detector::of(metric, two, 1.0).observe(at(0), &[3, 1, 0, 0, 3, 1, 0, 0]);
    assert_eq!(alike.unwrap().component, 0);
}

#[test]
fn profiles_are_of_the_nearest_domain_and_of_the_whole_window() {
    let metric = Metric::LogEnergy(Divergence::JensenShannon);
    let two = vec![component(vec![1, 1, 0, 0]), component(vec![0, 0, 1, 3])];
    let mut detector = Detector::of(metric, two, 1.0);
    assert_eq!(detector.profiles(), []);
    detector.observe(at(0), &[0, 0, 8, 0, 0, 0, 8, 0]).unwrap();
    detector
        .observe(at(100), &[0, 0, 0, 8, 0, 0, 0, 8])
        .unwrap();
    let profiles = detector.profiles();
    assert_eq!(profiles.len(), 1);
    assert_eq!(profiles[0].live, [0.0, 0.0, 0.5, 0.5]);
    assert_eq!(profiles[0].nominal, [0.0, 0.0, 0.25, 0.75]);
}

fn at(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

#[test]
fn the_score_is_0_at_the_median_and_1_at_the_threshold() {
    let seen = detector(1.0).observe(at(0), &[5, 5, 5, 5]).unwrap();
    assert!((seen.score() - (0.0 - 0.1) / (0.3 - 0.1)).abs() < 1e-12);
    let apart = detector(1.0).observe(at(0), &[9, 0, 0, 0]).unwrap();
    assert!(
        (apart.score() - (apart.blocks[0].gap - 0.1) / 0.2).abs() < 1e-12 && apart.score() > 1.0
    );
}

#[test]
fn the_window_is_the_sum_of_the_frames_in_its_span_at_any_rate() {
    for (step_ms, wanted) in [
        (1_000, 1),
        (500, 2),
        (100, 10),
        (33, 31),
        (10, WINDOW_FRAMES_MAX),
    ] {
        let mut detector = detector(1.0);
        for i in 0..200_u64 {
            let counts = [i as u32, 1, 0, 2 * i as u32];
            let seen = detector.observe(at(i * step_ms), &counts).unwrap();
            assert_eq!(
                seen.frames,
                wanted.min(i as usize + 1),
                "every {step_ms} ms"
            );
            let in_window = (i + 1 - seen.frames as u64)..=i;
            let first: u64 = in_window.clone().sum();
            assert_eq!(detector.sums, [first, seen.frames as u64, 0, 2 * first]);
        }
    }
}

#[test]
fn a_hole_in_time_or_a_step_back_starts_the_window_anew() {
    let mut detector = detector(1.0);
    let frames = |detector: &mut Detector, ms| {
        let seen = detector.observe(at(ms), &[1, 2, 3, 4]).unwrap();
        (seen.frames, seen.fill)
    };
    assert_eq!(frames(&mut detector, 0), (1, 0.0));
    assert_eq!(frames(&mut detector, 500), (2, 0.5));
    assert_eq!(frames(&mut detector, 1_200), (2, 1.0));
    assert_eq!(
        frames(&mut detector, 3_300),
        (1, 0.0),
        "a hole of more than two windows"
    );
    assert_eq!(frames(&mut detector, 3_400), (2, 0.1));
    assert_eq!(frames(&mut detector, 100), (1, 0.0), "time that goes back");
    assert_eq!(frames(&mut detector, 100), (2, 0.0), "time that stands");
    assert_eq!(frames(&mut detector, 2_100), (1, 1.0), "just no hole");
}

#[test]
fn the_window_fills_over_its_own_span_and_drift_counts_once_it_is_full() {
    let mut detector = detector(0.4);
    for i in 0..60 {
        let seen = detector.observe(at(100 * i), &[9, 0, 0, 0]).unwrap();
        let full = i >= 4;
        assert!((seen.fill - (i as f64 / 4.0).min(1.0)).abs() < 1e-12);
        // The first frame of a drift has no time behind it.
        assert_eq!(seen.drift > 0.0, full && i > 4, "frame {i}");
    }
}

#[test]
fn empty_histograms_have_no_score() {
    assert_eq!(
        detector(1.0).observe(at(0), &[0; 4]),
        Err(Undefined::EmptyHistogram)
    );
}
