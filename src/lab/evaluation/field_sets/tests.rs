#![allow(clippy::unwrap_used, clippy::cast_precision_loss)]
use std::time::Duration;

use super::*;
use crate::calibration::survey::SurveyFrame;
use crate::features::energies::BlockMeans;
use crate::statistics::random::SplitMix64;

/// Sequences of 8x4 maps with four energies that vary randomly around a level.
pub fn sequences(name: &str, images: &[usize], block_images: usize, level: f64) -> SequenceSet {
    let mut dice = SplitMix64::new(name.bytes().map(u64::from).sum());
    let mut frame = || {
        let around = 1.0 + f64::from(dice.byte()) / 256.0;
        let mut near = || level * around * (1.0 + 0.2 * f64::from(dice.byte()) / 256.0);
        let energy: Vec<f64> = (0..32).map(|_| near()).collect();
        let means = BlockMeans {
            activation: (0..4).map(|_| near()).collect(),
            energy: (0..4).map(|_| near()).collect(),
        };
        let peak = energy.iter().copied().fold(0.0, f64::max);
        let map = EnergyMap {
            width: 8,
            height: 4,
            energy,
        };
        SurveyFrame {
            maps: vec![map.clone(), map],
            peaks: vec![peak; 2],
            means: vec![means; 2],
        }
    };
    let sequences = images.iter().map(|&images| ImageSequence {
        survey: Survey {
            source: name.to_owned(),
            times: (0..images as u64).map(Duration::from_secs).collect(),
            frames: (0..images).map(|_| Ok(frame())).collect(),
            common_size: (8, 4),
        },
        block_images,
    });
    SequenceSet {
        name: name.to_owned(),
        sequences: sequences.collect(),
        drives: 1,
    }
}

fn found(shifted: &SequenceSet) -> Vec<FieldSetRow> {
    let case = Case {
        reference: &sequences("town", &[60, 60], 10, 1.0),
        nominal: &sequences("other town", &[47], 5, 1.0),
        shifted: vec![shifted],
    };
    let taps = ["e2", "e3"].map(str::to_owned);
    rows(&case, &taps, &|| {}).unwrap()
}

#[test]
fn windows_are_disjoint_lie_in_one_recording_and_are_counted_with_their_blocks() {
    let rows = found(&sequences("road", &[23, 9], 4, 30.0));
    assert_eq!(rows.len(), Metric::of_sets().len() * WINDOWS.len());
    for row in &rows {
        if row.metric == Metric::Frechet {
            continue;
        }
        assert_eq!((row.fitted, row.scaled), (60, 60));
        let nominal = (row.nominal_windows, row.nominal_blocks);
        let shifted = (row.windows, row.blocks);
        let (wanted_nominal, wanted_shifted) = match row.images {
            1 => ((47, 10), (32, 6 + 3)),
            5 => ((9, 9), (4 + 1, 4 + 1)),
            _ => ((4, 4), (2, 2)),
        };
        assert_eq!(
            (nominal, shifted),
            (wanted_nominal, wanted_shifted),
            "{row:?}"
        );
    }
}

#[test]
fn another_level_of_energy_is_told_apart_and_the_same_is_not() {
    for (level, least, most) in [(30.0, 0.99, 1.0), (1.0, 0.2, 0.8)] {
        let rows = found(&sequences("road", &[60], 5, level));
        let row = rows.iter().find(|row| row.metric == Metric::Mahalanobis);
        for tap in &row.unwrap().taps {
            let auroc = tap.auroc.unwrap();
            assert!(least <= auroc && auroc <= most, "level {level}: {tap:?}");
            let (low, high) = tap.auroc_interval.unwrap();
            assert!(
                low <= auroc && auroc <= high && high - low > 0.05,
                "{tap:?}"
            );
        }
    }
}

#[test]
fn what_is_undefined_says_why_and_what_cannot_be_judged_is_left_out() {
    let mut road = sequences("road", &[20], 5, 30.0);
    road.sequences[0].survey.frames[7] = Err(Undefined::Black);
    let rows = found(&road);
    let of = |metric: Metric, images: usize| {
        let row = rows
            .iter()
            .find(|row| (row.metric, row.images) == (metric, images));
        row.unwrap()
    };
    let tap = &of(Metric::Frechet, 5).taps[2];
    assert_eq!(tap.auroc, None);
    assert!(
        tap.reason.as_ref().unwrap().contains("too few images: 5"),
        "{tap:?}"
    );
    let row = of(Metric::Mahalanobis, 5);
    assert_eq!((row.windows, row.blocks), (3, 3));
    let reason = row.taps[0].reason.as_ref().unwrap();
    assert_eq!(reason, "1 windows have no gap: picture is black");
}

#[test]
fn a_reference_that_cannot_be_judged_is_named() {
    let mut town = sequences("town", &[60], 10, 1.0);
    town.sequences[0].survey.frames[3] = Err(Undefined::Uniform);
    let case = Case {
        reference: &town,
        nominal: &sequences("other town", &[20], 5, 1.0),
        shifted: vec![],
    };
    let said = rows(&case, &["e2".to_owned()], &|| {})
        .unwrap_err()
        .to_string();
    assert!(said.contains("town") && said.contains("uniform"), "{said}");
}
