//! How far the two drives of an accepted domain are from each other.

use super::component::{Domain, component_of};
use super::distance::DriveDistance;
use super::drive::{LabelledMeans, SurveyedDrive};
use super::error::CalibrationError;
use super::far::distance_to;
use super::stretch::{Stretch, Usage, look_at_all};
use super::target::Target;
use crate::reference::gap::Metric;
use crate::reference::{Component, Role};

/// How far the two drives of a domain are from each other: the smaller of the distances of each from what the other has
/// fitted alone, because a short drive may be a part of what a long one shows. Each has the
/// margins of the simulation. `None` unless there are two drives,
/// each long enough for a domain.
pub fn between<D: SurveyedDrive>(
    domain: &Domain<'_, D>,
    simulation: &Component,
    taps: &[String],
    wanted: Target,
) -> Result<Option<DriveDistance>, CalibrationError> {
    let [first, second] = domain.drives else {
        return Ok(None);
    };
    let mut least: Option<f64> = None;
    for (own, other) in [(first, second), (second, first)] {
        let alone = Usage::crossed(std::slice::from_ref(own));
        let none: &[LabelledMeans] = &[];
        let made = component_of(&domain.name, &alone, Some(simulation), none, taps, wanted);
        let mut made = match made {
            Err(CalibrationError::TooFew(_)) => return Ok(None),
            made => made?,
        };
        made.component.widen_like(simulation);
        let own = std::slice::from_ref(&made.component);
        let stretch = [Stretch::whole(other)];
        let distance = look_at_all(&stretch, |part| distance_to(part, own, wanted))?;
        let Some(distance) = distance.into_iter().flatten().next() else {
            return Ok(None);
        };
        least = Some(least.map_or(distance, |least| least.min(distance)));
    }
    Ok(least.map(|distance| DriveDistance {
        source: first.source().to_owned(),
        role: Role::Accepted,
        domain: domain.name.clone(),
        beside: Some(second.source().to_owned()),
        distance,
    }))
}

/// How often [`between`] looks at drives.
pub fn looks_between<D: SurveyedDrive>(drives: &[D], wanted: Target) -> u64 {
    let [first, second] = drives else {
        return 0;
    };
    let of = [first, second].map(|drive| {
        let (fitted, scaled) = Usage::crossed(std::slice::from_ref(drive)).stretches();
        (looks_of_fit(wanted) * fitted + (1 + usize::from(wanted.is_timed())) * scaled + 1) as u64
    });
    of.iter().sum()
}

/// How often a domain's fit looks at each stretch: peaks, then masses and counts for histograms, or moments.
pub fn looks_of_fit(wanted: Target) -> usize {
    match wanted.metric {
        Metric::LogEnergy(_) => 3,
        _ => 2,
    }
}
