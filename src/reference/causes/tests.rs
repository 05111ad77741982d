#![allow(clippy::unwrap_used, clippy::float_cmp)]
use super::*;
use crate::reference::gap::energy_norm::EnergyNorm;
use crate::reference::gap::moments::NO_DIFFERENCE;
use crate::reference::{ScalePoint, SpanNorm};

fn norm() -> EnergyNorm {
    EnergyNorm {
        epsilon: 1.0,
        mean: vec![1.0, 0.0],
        whitening: vec![2.0, 0.0, 1.0],
    }
}

/// A domain of one tap with two energies.
fn domain() -> Vec<TapReference> {
    let spans = Span::ALL.map(|span| SpanNorm {
        span,
        norm: EnergyNorm {
            mean: vec![0.0; 2],
            ..norm()
        },
        windows: 9,
        median: 1.0,
        held_from: 2.0,
        threshold: 3.0,
    });
    vec![TapReference {
        tap: "e2".to_owned(),
        median_peak_energy: 1.0,
        images: 1,
        nominal: Nominal::Energies(norm()),
        scale: vec![ScalePoint {
            frames: 1,
            windows: 9,
            median: 1.0,
            threshold: 2.0,
        }],
        spans: spans.to_vec(),
    }]
}

/// Fog at (2, 0) and night at (0, 4), whitened by halves of the numbers.
fn causes() -> Causes {
    let discriminant = Discriminant {
        blocks: vec![DiscriminantBlock {
            whitening: vec![0.5, 0.0, 0.5],
            centres: vec![vec![1.0, 0.0], vec![0.0, 2.0]],
        }],
        fits_within: 1.0,
        sharpness: 2.0,
        judged: 4,
        right: 3,
    };
    let kind = |cause| CauseKind { cause, drives: 2 };
    Causes {
        kinds: vec![kind(Cause::Fog), kind(Cause::Night)],
        change: discriminant.clone(),
        gap: discriminant,
    }
}

#[test]
fn deviations_are_whitened_and_compressed_by_hand() {
    let mut deviation = [0.0; 2];
    let levels = [1.5, -3.0];
    // A gap: (1.5 - 1) * 2 = 1, and -3.
    let level = |place: usize| levels[place];
    Explained::Gap
        .deviation(&domain(), level, &mut deviation)
        .unwrap();
    assert_eq!(deviation, [2.0_f64.ln(), -(4.0_f64.ln())]);
    // A change has no mean.
    Explained::Change
        .deviation(&domain(), level, &mut deviation)
        .unwrap();
    assert_eq!(deviation, [4.0_f64.ln(), -(4.0_f64.ln())]);
    let mut without = domain();
    without[0].spans.clear();
    assert!(
        Explained::Change
            .deviation(&without, level, &mut deviation)
            .is_none()
    );
    // Compressed numbers are far inside of what sums of differences can hold.
    assert!(f64::MAX.ln_1p() * 1024.0 < f64::from(NO_DIFFERENCE));
}

#[test]
fn distances_and_probabilities_by_hand() {
    let of = causes().change;
    // (2, 2) is whitened to (1, 1): 0 + 1 from fog, 1 + 1 from night, over two numbers.
    let distances = of.distances(&[2.0, 2.0]);
    assert_eq!(distances, [0.5, 1.0]);
    let (kinds, other) = of.probabilities(&distances);
    let fits = 1.0 / (1.0 + 0.5_f64.powi(4));
    let fog = fits / (1.0 + (-1.0_f64).exp());
    assert!((kinds[0] - fog).abs() < 1e-12, "{kinds:?}");
    assert!((other - (1.0 - fits)).abs() < 1e-12, "{other}");
}

#[test]
fn the_nearest_kind_is_told_and_what_fits_none_is_other() {
    let causes = causes();
    for (deviation, wanted) in [
        ([2.0, 0.0], Cause::Fog),
        ([0.0, 4.0], Cause::Night),
        ([2.5, 1.0], Cause::Fog),
        ([-6.0, 0.0], Cause::Other),
        ([40.0, -90.0], Cause::Other),
    ] {
        for explained in [Explained::Change, Explained::Gap] {
            let likely = causes.likely(explained, &deviation);
            assert_eq!(likely.cause, wanted, "{deviation:?}");
            assert!((0.4..=1.0).contains(&likely.probability), "{likely:?}");
        }
        let (kinds, other) = causes.gap.probabilities(&causes.gap.distances(&deviation));
        let all = kinds.iter().sum::<f64>() + other;
        assert!((all - 1.0).abs() < 1e-12, "{deviation:?}: {all}");
    }
}

#[test]
fn a_section_that_cannot_be_is_refused() {
    assert_eq!(causes().fault(&domain()), None);
    let with = |change: &dyn Fn(&mut Causes)| {
        let mut causes = causes();
        change(&mut causes);
        causes.fault(&domain())
    };
    for (fault, said) in [
        (with(&|of| of.kinds.truncate(1)), "kinds"),
        (with(&|of| of.kinds[1].cause = Cause::Fog), "kinds"),
        (with(&|of| of.kinds[1].cause = Cause::Other), "kinds"),
        (with(&|of| of.gap.fits_within = 0.0), "fits_within"),
        (with(&|of| of.change.sharpness = f64::NAN), "sharpness"),
        (with(&|of| of.gap.right = 5), "5 right of 4"),
        (with(&|of| of.gap.blocks.clear()), "0 blocks"),
        (
            with(&|of| of.change.blocks[0].whitening.truncate(2)),
            "whitening weights",
        ),
        (
            with(&|of| of.change.blocks[0].whitening[0] = f32::NAN),
            "whitening weights",
        ),
        (with(&|of| of.gap.blocks[0].centres.truncate(1)), "centres"),
        (with(&|of| of.gap.blocks[0].centres[1].push(0.0)), "centres"),
        (
            with(&|of| of.gap.blocks[0].centres[1][0] = f32::INFINITY),
            "centres",
        ),
    ] {
        assert!(
            fault.as_ref().is_some_and(|of| of.contains(said)),
            "{said}: {fault:?}"
        );
    }
    let mut without = domain();
    without[0].spans.clear();
    assert!(causes().fault(&without).unwrap().contains("spans"));
}
