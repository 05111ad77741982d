//! What is doubtful about the drives of a reference, said as warnings once it is made.

use std::collections::BTreeMap;

use gapwatch::calibration::{DriveDistance, DriveFacts, Shown};
use gapwatch::capture::{is_rendered, open};
use gapwatch::monitor::alarm::Reason;
use gapwatch::monitor::camera_health::CameraHealth;
use gapwatch::reference::JudgedRate;
use rayon::prelude::*;

/// Length of an accepted road below which light and surroundings hardly change, seconds. Our own choice.
const ACCEPTED_MIN_S: f64 = 60.0;
/// Fewest frames for each energy of a block. With fewer frames than energies, some directions of their covariance have no spread
/// at all, and the shrinkage alone says what is nominal there.
const FRAMES_PER_ENERGY: usize = 1;
/// Fewest held-out drives nearest to the simulation: every fourth one judges the rate of false alarms.
const OF_SIMULATION_MIN: usize = 4;
/// Share of a road's frames that are faults of the camera, from which on the road is named. Our own choice.
const FAULTS_MIN: f64 = 0.01;
/// Number of drives that a warning names.
const NAMED_MAX: usize = 3;

/// Drives that are far from all others and were allowed, and accepted drives that would be a gap to the others.
pub fn of_far(distances: &[DriveDistance]) -> impl Iterator<Item = String> {
    distances.iter().filter_map(|of| {
        if of.is_far() {
            Some(format!("{of}; it is used all the same"))
        } else {
            let doubtful = of.is_doubtful();
            doubtful.then(|| format!("{of}; it would be a gap to them, and makes the domain wider"))
        }
    })
}

/// Drives of still pictures.
pub fn of_stills<'f>(option: &str, drives: impl Iterator<Item = &'f DriveFacts>) -> Option<String> {
    let stills = drives.filter(|of| of.is_of_stills());
    let names: Vec<&str> = stills.map(|of| of.source.as_str()).collect();
    let named = named(&names)?;
    Some(format!(
        "{option} {named}: the pictures do not follow each other in time, so their windows and changes say nothing about time; wanted a recorded drive"
    ))
}

/// What an accepted domain is too short for.
pub fn of_accepted(name: &str, shown: &Shown) -> Vec<String> {
    let mut warnings = Vec::new();
    let missing_s = ACCEPTED_MIN_S - shown.seconds;
    if missing_s > 0.0 {
        warnings.push(format!(
            "{name}: this road lasts {:.0} s, and {ACCEPTED_MIN_S:.0} s or more are wanted, so that light and surroundings change as they usually do; {:.0} s are missing",
            shown.seconds,
            missing_s.ceil()
        ));
    }
    let frames = shown.of_drives.iter().map(|of| of.frames).sum();
    warnings.extend(of_few_frames(name, frames, &shown.of_drives));
    warnings
}

/// Says if there are too few frames for the spread of the energies.
pub fn of_few_frames(name: &str, fitted: usize, drives: &[DriveFacts]) -> Option<String> {
    let energies = drives
        .iter()
        .flat_map(|of| of.energies.iter().copied())
        .max()?;
    let wanted = FRAMES_PER_ENERGY * energies;
    (fitted < wanted).then(|| {
        format!(
            "{name}: {fitted} frames show how {energies} energies vary, and {wanted} or more are wanted: {FRAMES_PER_ENERGY} for each energy; {} are missing",
            wanted - fitted
        )
    })
}

/// Says if few held-out drives set the thresholds of the simulation beside accepted domains.
pub fn of_few_held_out(of_simulation: Option<usize>) -> Option<String> {
    let few = of_simulation.filter(|&drives| drives < OF_SIMULATION_MIN)?;
    Some(format!(
        "only {few} of the held-out drives are nearest to the simulation and set its thresholds; wanted {OF_SIMULATION_MIN} or more"
    ))
}

fn named(names: &[&str]) -> Option<String> {
    let (first, rest) = names.split_at(names.len().min(NAMED_MAX));
    let listed = first.join(", ");
    match (first.len(), rest.len()) {
        (0, _) => None,
        (_, 0) => Some(listed),
        (_, more) => Some(format!("{listed} and {more} more")),
    }
}

/// Accepted roads some of whose frames are faults of the camera to the monitor, which then says nothing about the road.
/// The pictures are read once more, without the encoder. Rendered drives have no camera.
///
/// # Errors
/// When a road can no longer be read.
pub fn of_camera_faults(roads: &[&String], rate: JudgedRate) -> anyhow::Result<Vec<String>> {
    let found = roads.par_iter().filter(|road| !is_rendered(road));
    let found = found.map(|road| faults_of(road, rate));
    let found: Vec<Option<String>> = found.collect::<anyhow::Result<_>>()?;
    Ok(found.into_iter().flatten().collect())
}

fn faults_of(road: &str, rate: JudgedRate) -> anyhow::Result<Option<String>> {
    let mut camera = CameraHealth::with_frames_every(rate.periods().idle);
    let mut frames_of = open(road)?;
    let mut faults: BTreeMap<&str, usize> = BTreeMap::new();
    let mut frames = 0_usize;
    while let Some(frame) = frames_of.next_frame()? {
        frames += 1;
        if let Err(why) = camera.check(&frame) {
            *faults.entry(Reason::from(&why).name()).or_default() += 1;
        }
    }
    let all: usize = faults.values().sum();
    // Counts of frames are small.
    #[allow(clippy::cast_precision_loss)]
    let few = (all as f64) < FAULTS_MIN * frames as f64;
    if all == 0 || few {
        return Ok(None);
    }
    let counts: Vec<String> = faults
        .iter()
        .map(|(reason, count)| format!("{count} {reason}"))
        .collect();
    Ok(Some(format!(
        "accepted road {road}: {all} of {frames} frames are faults of the camera to the monitor ({}), which reports SensorFault there and does not judge the road; wanted a road with a clear view",
        counts.join(", ")
    )))
}
