#![allow(clippy::unwrap_used)]
use std::time::Duration;

use super::*;
use crate::calibration::drive::LabelledMeans;
use crate::calibration::survey::{Survey, SurveyFrame};
use crate::calibration::{Domain, calibrate};
use crate::features::attention::EnergyMap;
use crate::features::energies::BlockMeans;
use crate::statistics::random::SplitMix64;

const ENERGIES: usize = 4;

/// A drive of a road at two frames a second, whose energies are multiplied from a time on.
fn drive(source: String, road: u64, seconds: u32, from_s: f64, factors: [f64; ENERGIES]) -> Survey {
    let mut dice = SplitMix64::new(road);
    let mut noise = |share: f64| 1.0 + share * (f64::from(dice.byte()) / 255.0 - 0.5);
    let own: Vec<f64> = (0..ENERGIES).map(|_| 10.0 * noise(0.4)).collect();
    let times: Vec<Duration> = (0..2 * seconds)
        .map(|number| 500 * number * Duration::from_millis(1))
        .collect();
    let mut frame = |at: &Duration| {
        let seen = at.as_secs_f64() >= from_s;
        let energies = own.iter().zip(factors);
        let energy = energies.map(|(own, by)| own * noise(0.2) * if seen { by } else { 1.0 });
        Ok(SurveyFrame {
            maps: vec![EnergyMap {
                width: 2,
                height: 1,
                energy: vec![1.0, 2.0],
            }],
            peaks: vec![20.0],
            means: vec![BlockMeans {
                activation: vec![1.0; ENERGIES],
                energy: energy.collect(),
            }],
        })
    };
    Survey {
        source,
        frames: times.iter().map(&mut frame).collect(),
        times,
        common_size: (2, 1),
    }
}

fn nominal(drives: u64) -> Vec<Survey> {
    let plain = |road| drive(format!("plain {road}"), road, 80, 1e9, [1.0; ENERGIES]);
    (1..=drives).map(plain).collect()
}

/// Drives under two kinds of condition, of some roads.
fn conditions(roads: std::ops::Range<u64>) -> Vec<Survey> {
    let of = |kind: &'static str, factors: [f64; ENERGIES]| {
        roads.clone().map(move |road| {
            let name = format!("road{road}?condition={kind}:4@28-90");
            drive(name, road, 40, 27.0, factors)
        })
    };
    of("fog", [3.0, 3.0, 1.0, 1.0])
        .chain(of("night", [1.0, 0.3, 1.0, 0.3]))
        .collect()
}

fn domain(drives: &[Survey]) -> Component {
    let domain = Domain {
        name: "simulation".to_owned(),
        drives,
    };
    let none: &[LabelledMeans] = &[];
    let wanted = Target::new(Metric::Mahalanobis, 1.0, 1.0);
    let made = calibrate(&[domain], &[], none, &["e2".to_owned()], wanted).unwrap();
    made.components[0].clone()
}

#[test]
fn kinds_that_differ_are_told_apart_on_roads_that_made_no_centres() {
    let wanted = Target::new(Metric::Mahalanobis, 1.0, 1.0);
    let plain = nominal(24);
    let domain = domain(&plain);
    let drives = conditions(100..108);
    let learnt = learn_causes(&drives, &plain, &domain, wanted).unwrap();
    let kinds: Vec<(Cause, usize)> = learnt
        .causes
        .kinds
        .iter()
        .map(|kind| (kind.cause, kind.drives))
        .collect();
    let known = [(Cause::Fog, 8), (Cause::Night, 8), (Cause::AnotherRoad, 24)];
    assert_eq!(kinds, known);
    for of in [&learnt.causes.change, &learnt.causes.gap] {
        // Four roads of each kind, four times each, and the nominal drives.
        assert!(of.judged >= 2 * 4 * 4, "{}", of.judged);
        assert!(
            20 * of.right >= 17 * of.judged,
            "{} of {}",
            of.right,
            of.judged
        );
    }
    // Every second road makes centres.
    assert!(learnt.sources.iter().enumerate().all(|(index, of)| {
        let fits = index % 2 == 0;
        of.role == Some(Role::Cause)
            && (of.fitted, of.held_out) == if fits { (80, 0) } else { (0, 80) }
    }));
    // What is like neither kind is other.
    let odd = drive(
        "odd?condition=fog:4@28-90".to_owned(),
        300,
        40,
        27.0,
        [0.01, 1.0, 60.0, 9.0],
    );
    let of_odd = of_cause(
        &Part::of(&odd, 0..odd.frames.len()).unwrap(),
        std::slice::from_ref(&domain),
        wanted,
    )
    .unwrap();
    for deviation in &of_odd.change {
        let likely = learnt.causes.likely(Explained::Change, deviation);
        assert_eq!(likely.cause, Cause::Other, "{likely:?}");
    }
}

#[test]
fn drives_from_which_nothing_can_be_learnt_are_refused() {
    let wanted = Target::new(Metric::Mahalanobis, 1.0, 1.0);
    let plain = nominal(24);
    let domain = domain(&plain);
    let refused = |drives: &[Survey], domain: &Component, wanted: Target| {
        let learnt = learn_causes(drives, &plain, domain, wanted);
        learnt.err().unwrap().to_string()
    };
    let one_road = refused(&conditions(100..101), &domain, wanted);
    assert!(one_road.contains("two or more"), "{one_road}");
    let mut early = conditions(100..102);
    early[0].source = "road100?condition=fog:4@2-90".to_owned();
    early[0].frames.truncate(30);
    early[0].times.truncate(30);
    let early = refused(&early, &domain, wanted);
    assert!(
        early.contains("road100") && early.contains("22 s"),
        "{early}"
    );
    let mut unnamed = conditions(100..102);
    unnamed[0].source = "road100".to_owned();
    let unnamed = refused(&unnamed, &domain, wanted);
    assert!(unnamed.contains("wanted one condition"), "{unnamed}");
    let mut without = domain.clone();
    without.taps[0].spans.clear();
    assert!(refused(&conditions(100..102), &without, wanted).contains("long enough"));
}
