#![allow(clippy::unwrap_used)]
use super::*;
use crate::features::histogram::Binning;
use crate::reference::gap::Divergence;
use crate::reference::{Nominal, ScalePoint};

const LOG_ENERGY: Metric = Metric::LogEnergy(Divergence::JensenShannon);

fn histogram(counts: Vec<u64>) -> Nominal {
    Nominal::Histogram {
        binning: Binning::LogEnergy {
            epsilon: 1e-6,
            edges: vec![0.0],
        },
        counts,
    }
}

fn tap(scale: &[(usize, f64, f64)]) -> TapReference {
    TapReference {
        tap: "e2".into(),
        median_peak_energy: 5.0,
        images: 1,
        nominal: histogram(vec![1, 2]),
        scale: scale
            .iter()
            .map(|&(frames, median, threshold)| ScalePoint {
                frames,
                windows: 9,
                median,
                threshold,
            })
            .collect(),
        spans: Vec::new(),
    }
}

#[test]
fn the_scale_between_two_points_is_linear_in_one_over_frames() {
    let tap = tap(&[(1, 1.0, 2.0), (2, 0.5, 1.0), (10, 0.1, 0.2)]);
    for (frames, median) in [
        (1, 1.0),
        (2, 0.5),
        (4, 0.25),
        (5, 0.2),
        (10, 0.1),
        (30, 0.1),
    ] {
        let (found, threshold) = tap.scale_for(frames);
        assert!(
            (found - median).abs() < 1e-12 && (threshold - 2.0 * median).abs() < 1e-12,
            "{frames}: {found}"
        );
    }
}

#[test]
fn malformed_references_are_refused_by_name() {
    for (text, part) in [
        ("", "not JSON"),
        ("{}", "format null"),
        (
            "{\"format\": \"gapwatch-reference\", \"version\": 1}",
            "version 1",
        ),
        (
            "{\"format\": \"gapwatch-reference\", \"version\": 3}",
            "make it again with the command",
        ),
        (
            "{\"format\": \"gapwatch-reference\", \"version\": 5}",
            "no \"model\" at line 1",
        ),
    ] {
        let said = Reference::parse("r.json", text).unwrap_err().to_string();
        assert!(said.contains(part) && said.contains("r.json"), "{said}");
    }
    assert!(tap(&[]).fault(LOG_ENERGY).unwrap().contains("scale"));
    assert!(
        tap(&[(1, 2.0, 1.0)])
            .fault(LOG_ENERGY)
            .unwrap()
            .contains("scale")
    );
    assert!(
        TapReference {
            nominal: histogram(vec![0, 0]),
            ..tap(&[(1, 1.0, 2.0)])
        }
        .fault(LOG_ENERGY)
        .unwrap()
        .contains("counts")
    );
    assert!(
        TapReference {
            nominal: histogram(vec![u64::MAX, 1]),
            ..tap(&[(1, 1.0, 2.0)])
        }
        .fault(LOG_ENERGY)
        .is_some()
    );
    assert_eq!(tap(&[(1, 1.0, 2.0)]).fault(LOG_ENERGY), None);
}

#[test]
fn counts_of_false_alarms_that_no_drive_has_are_refused() {
    let reference = Reference::read(None).unwrap();
    let changes: [fn(&mut FalseAlarms); 5] = [
        |of| of.wanted_per_hour = 0.0,
        |of| of.chosen_on.hours = -1.0,
        |of| of.chosen_on.entries = u64::MAX,
        |of| of.chosen_on.resampled = Some((2.0, 1.0)),
        |of| of.judged_on.as_mut().unwrap().hours = 1e300,
    ];
    for change in changes {
        let mut changed = reference.clone();
        change(&mut changed.false_alarms);
        let refused = Reference::parse("r.json", &changed.to_json()).unwrap_err();
        assert!(refused.to_string().contains("false alarms"), "{refused}");
    }
}

#[test]
fn the_built_in_reference_is_read_and_written_without_loss() {
    let reference = Reference::read(None).unwrap();
    assert_eq!(reference.to_json(), BUILT_IN);
}
