//! How far drives are from the nominal domain to which they belong, or to which they are nearest.
//!
//! A drive that belongs to none of the domains moves thresholds without anyone noticing: one held-out drive of another
//! camera makes every threshold of the simulation tens of times as wide, and one such drive in an accepted domain makes
//! that domain accept almost anything. This file only measures; the command line refuses or warns.

use super::distance::DriveDistance;
use super::drive::SurveyedDrive;
use super::error::CalibrationError;
use super::stretch::Stretch;
use super::target::{THRESHOLD_QUANTILE, Target};
use super::windows::Part;
use crate::reference::{Component, Role, SPREAD_MIN, ScalePoint, TapReference};
use crate::statistics::quantile::{median, quantile};

/// Share of the windows of a drive that may be nearer to a domain than the drive is said to be.
const LOW_QUANTILE: f64 = 0.1;
/// Number of accepted drives of one domain from which on each is compared with the others.
const DRIVES_COMPARED: usize = 3;

/// The domain to which a held-out drive is nearest; `None` for a drive without windows.
pub fn of_held_out(
    part: &Part<'_>,
    components: &[Component],
    wanted: Target,
) -> Result<Option<DriveDistance>, CalibrationError> {
    let mut nearest: Option<(&Component, f64)> = None;
    for own in components.chunks(1) {
        let Some(distance) = distance_to(part, own, wanted)? else {
            continue;
        };
        if nearest.is_none_or(|(_, least)| distance < least) {
            nearest = Some((&own[0], distance));
        }
    }
    Ok(nearest.map(|(domain, distance)| DriveDistance {
        source: part.source().to_owned(),
        role: Role::HeldOut,
        domain: domain.name.clone(),
        beside: None,
        distance,
    }))
}

/// Distance of a drive from the one domain in `own`, by the block that decides.
pub fn distance_to(
    part: &Part<'_>,
    own: &[Component],
    wanted: Target,
) -> Result<Option<f64>, CalibrationError> {
    let gaps = part.gaps(wanted, own, &[1])?;
    let deciding = wanted.metric.deciding(gaps.len());
    let of_taps = own[0].taps[deciding.clone()].iter().zip(&gaps[deciding]);
    let scaled_taps = of_taps.filter(|(tap, _)| !tap.scale.is_empty());
    let distances = scaled_taps.filter_map(|(tap, gaps)| scaled(tap.scale_for(1), gaps.first()?));
    Ok(distances.reduce(f64::max))
}

/// What nine of ten gaps are at least, on a scale whose 0 is a median and whose 1 is a threshold. On roads that change, half of
/// the windows may be far from a domain of plain roads, but not nine of ten.
fn scaled((nominal, threshold): (f64, f64), gaps: &[f64]) -> Option<f64> {
    let mut gaps = gaps.to_vec();
    gaps.sort_by(f64::total_cmp);
    let own = quantile(&gaps, LOW_QUANTILE)?;
    Some((own - nominal) / (threshold - nominal).max(SPREAD_MIN))
}

/// Distance of each drive of an accepted domain from what the others of its domain have fitted, with the margins of the
/// `simulation`, because few drives show too small a spread. `gaps`
/// `[stretches][taps][window lengths][windows]` are those of `scaled_by`, each from what its fold has fitted. Empty
/// unless there are three drives or more, each of which is one stretch.
pub fn among<D: SurveyedDrive>(
    domain: &Component,
    simulation: &Component,
    scaled_by: &[&Stretch<'_, D>],
    gaps: &[Vec<Vec<Vec<f64>>>],
    wanted: Target,
) -> Vec<DriveDistance> {
    let whole = |of: &&Stretch<'_, D>| of.range.len() == of.drive.frames();
    if scaled_by.len() < DRIVES_COMPARED || !scaled_by.iter().all(whole) {
        return Vec::new();
    }
    let of_drive = |number: usize| {
        let taps = wanted.metric.deciding(gaps[number].len());
        let distances = taps.filter_map(|tap| {
            let others = gaps
                .iter()
                .enumerate()
                .filter(|&(other, _)| other != number);
            let others = others.filter_map(|(_, drive)| drive[tap].first()).flatten();
            let scale = scale_of(others.copied().collect())?;
            let of_others = TapReference {
                scale: vec![scale],
                spans: Vec::new(),
                ..domain.taps[tap].clone()
            };
            scaled(
                margins_like(of_others, &simulation.taps[tap]),
                gaps[number][tap].first()?,
            )
        });
        distances.reduce(f64::max)
    };
    let drives = scaled_by.iter().enumerate();
    let far = drives.filter_map(|(number, stretch)| {
        Some(DriveDistance {
            source: stretch.drive.source().to_owned(),
            role: Role::Accepted,
            domain: domain.name.clone(),
            beside: None,
            distance: of_drive(number)?,
        })
    });
    far.collect()
}

/// Median and 99 % quantile of the gaps of single frames; `None` without gaps.
fn scale_of(mut gaps: Vec<f64>) -> Option<ScalePoint> {
    gaps.sort_by(f64::total_cmp);
    Some(ScalePoint {
        frames: 1,
        windows: gaps.len(),
        threshold: quantile(&gaps, THRESHOLD_QUANTILE)?,
        median: median(gaps)?,
    })
}

/// Median and threshold of single frames with the margins of the simulation.
fn margins_like(mut own: TapReference, simulation: &TapReference) -> (f64, f64) {
    own.widen_like(simulation);
    own.scale_for(1)
}
