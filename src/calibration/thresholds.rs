//! Scores of nominal drives → the thresholds of all domains.
//!
//! Each domain has thresholds of its own, set on the drives that are nearest to it and on its scores alone. Another
//! domain can only take false alarms away: a road is judged by the domain that is nearest. So accepting a road neither
//! lowers nor raises the thresholds of the simulation. A domain with few drives has at least the margins of the
//! simulation, relative to its own distances.

use super::drive::SurveyedDrive;
use super::error::CalibrationError;
use super::false_alarms::{self, DriveScores};
use super::stretch::{Stretch, look_at_all};
use super::target::Target;
use super::windows::Part;
use crate::reference::{Component, FalseAlarms};
use crate::statistics::quantile::median;

/// Number of drives of an accepted domain from which on its margins may be smaller than those of the simulation.
const DRIVES_OWN: usize = 20;

/// Sets the thresholds of all domains for the wanted rate. The first domain is the simulation. `optimistic`: the drives
/// have also scaled the distances, so none of them judges the rate.
pub fn set<D: SurveyedDrive>(
    components: &mut [Component],
    drives: &[Stretch<'_, D>],
    wanted: Target,
    optimistic: bool,
) -> Result<FalseAlarms, CalibrationError> {
    let spans = components.first().map_or(0, Component::spans);
    let mut is_simulation = vec![true; drives.len()];
    if spans > 0 || components.len() > 1 {
        // [drives][domains][parts]
        let (alone, nearest): (Vec<_>, Vec<_>) = look_at_all(drives, |part| {
            let each = components.chunks(1);
            let alone = each.map(|own| part.scores_of_parts(wanted, own));
            Ok((
                alone.collect::<Result<Vec<_>, _>>()?,
                nearest(part, components, wanted)?,
            ))
        })?
        .into_iter()
        .unzip();
        if nearest.contains(&0) {
            is_simulation = nearest.iter().map(|&domain| domain == 0).collect();
        }
        if spans > 0 {
            widen_parts(
                components,
                &alone,
                &is_simulation,
                &nearest,
                wanted,
                optimistic,
            );
        }
    }
    // [drives], against the simulation alone and against all domains
    let several = components.len() > 1;
    let scores = look_at_all(drives, |part| {
        let simulation = part.scores(wanted, &components[..1])?;
        let all = several.then(|| part.scores(wanted, components));
        Ok((simulation, all.transpose()?))
    })?;
    let of_all: Vec<&DriveScores> = scores
        .iter()
        .map(|(simulation, all)| all.as_ref().unwrap_or(simulation))
        .collect();
    let of_simulation = scores.iter().zip(&is_simulation).enumerate();
    let of_simulation: Vec<(usize, &DriveScores)> = of_simulation
        .filter(|&(_, (_, &is_simulation))| is_simulation)
        .map(|(index, ((simulation, _), _))| (index, simulation))
        .collect();
    let per_hour = wanted.false_alarms_per_hour;
    let false_alarms = false_alarms::calibrated(&of_simulation, &of_all, per_hour, optimistic);
    for tap in components.iter_mut().flat_map(|of| &mut of.taps) {
        (0..=spans).for_each(|part| tap.widen(part, false_alarms.factor));
    }
    Ok(false_alarms)
}

/// The domain from which a drive is least far, by the median gap of its frames. The gap counts and not the score: the
/// thresholds of a domain with few frames are so wide that other roads have low scores.
fn nearest(
    part: &Part<'_>,
    components: &[Component],
    wanted: Target,
) -> Result<usize, CalibrationError> {
    let mut least = (0, f64::INFINITY);
    for (domain, own) in components.chunks(1).enumerate() {
        let gaps = part.gaps(wanted, own, &[1])?;
        let of_all_taps: f64 = gaps.into_iter().flatten().filter_map(median).sum();
        if of_all_taps < least.1 {
            least = (domain, of_all_taps);
        }
    }
    Ok(least.0)
}

/// Every part of the evidence gets the same share of the false alarms.
#[allow(clippy::cast_precision_loss)]
fn widen_parts(
    components: &mut [Component],
    alone: &[Vec<Vec<DriveScores>>],
    is_simulation: &[bool],
    nearest: &[usize],
    wanted: Target,
    optimistic: bool,
) {
    let parts = 1 + components.first().map_or(0, Component::spans);
    let share = wanted.false_alarms_per_hour / parts as f64;
    for part in 0..parts {
        let of = |domain: usize, belongs: &dyn Fn(usize) -> bool| -> Vec<(usize, &DriveScores)> {
            let own = alone
                .iter()
                .enumerate()
                .filter(|(index, _)| belongs(*index));
            own.map(|(index, of)| (index, &of[domain][part])).collect()
        };
        let simulation = of(0, &|drive| is_simulation[drive]);
        let of_simulation = false_alarms::factor(&simulation, share, optimistic);
        for (domain, component) in components.iter_mut().enumerate() {
            let own = of(domain, &|drive| nearest[drive] == domain);
            let factor = match own.len() {
                _ if domain == 0 => of_simulation,
                0 => of_simulation,
                1..DRIVES_OWN => of_simulation.max(false_alarms::factor(&own, share, optimistic)),
                _ => false_alarms::factor(&own, share, optimistic),
            };
            component
                .taps
                .iter_mut()
                .for_each(|tap| tap.widen(part, factor));
        }
    }
}
