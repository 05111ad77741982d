//! Scores of nominal drives → the thresholds of all domains.
//!
//! Each domain has thresholds of its own, set on the drives that are nearest to it and on its scores alone. Another
//! domain can only take false alarms away: a road is judged by the domain that is nearest. So accepting a road neither
//! lowers nor raises the thresholds of the simulation. A domain without enough drives has the margins of the simulation:
//! its thresholds are as many times its medians, and not below what its own frames show.

use super::drive::SurveyedDrive;
use super::error::CalibrationError;
use super::false_alarms::{self, DriveScores};
use super::stretch::{Stretch, look_at_all};
use super::target::Target;
use super::windows::Part;
use crate::reference::{Component, FalseAlarms};
use crate::statistics::quantile::median;

/// Number of drives from which on an accepted domain has margins of its own.
const DRIVES_OWN: usize = 20;

/// Nominal drives, and the domain to which each belongs.
struct Sorted<'a, 'd, D> {
    drives: &'a [Stretch<'d, D>],
    domain: Vec<usize>,
    /// The drives have also scaled the distances, so none of them judges the rate.
    optimistic: bool,
}

/// Sets the thresholds of all domains for the wanted rate. The first domain is the simulation. `optimistic`: the drives
/// have also scaled the distances, so none of them judges the rate. Returns the number of drives nearest to the simulation
/// too.
///
/// # Errors
/// `NoneOfSimulation` if every held-out drive is nearest to an accepted domain.
pub fn set<D: SurveyedDrive>(
    components: &mut [Component],
    drives: &[Stretch<'_, D>],
    wanted: Target,
    optimistic: bool,
) -> Result<(FalseAlarms, usize), CalibrationError> {
    let several = components.len() > 1;
    let domain = match several {
        true => look_at_all(drives, |part| nearest(part, components, wanted))?,
        false => vec![0; drives.len()],
    };
    if !optimistic && !drives.is_empty() && !domain.contains(&0) {
        return Err(CalibrationError::NoneOfSimulation {
            held_out: drives.len(),
        });
    }
    // Without held-out drives, those of the domains set the margins of the simulation, whatever they are nearest to.
    let domain = match domain.contains(&0) {
        true => domain,
        false => vec![0; drives.len()],
    };
    let sorted = Sorted {
        drives,
        domain,
        optimistic,
    };
    let mut false_alarms = sorted.set_one(components, 0, wanted)?;
    for domain in 1..components.len() {
        if sorted.of(domain).len() >= DRIVES_OWN {
            sorted.set_one(components, domain, wanted)?;
        } else if let Some((simulation, accepted)) = components.split_first_mut() {
            accepted[domain - 1].widen_like(simulation);
        }
    }
    if several {
        let scores = look_at_all(drives, |part| part.scores(wanted, components))?;
        let scores: Vec<(usize, DriveScores)> = scores.into_iter().enumerate().collect();
        false_alarms::count(&mut false_alarms, &scores, optimistic);
    }
    let of_simulation = sorted.of(0).len();
    Ok((false_alarms, of_simulation))
}

impl<D: SurveyedDrive> Sorted<'_, '_, D> {
    /// Numbers of the drives of a domain.
    fn of(&self, domain: usize) -> Vec<usize> {
        let all = self.domain.iter().enumerate();
        all.filter(|&(_, &of)| of == domain)
            .map(|(number, _)| number)
            .collect()
    }

    /// Sets the thresholds of one domain on its drives.
    fn set_one(
        &self,
        components: &mut [Component],
        domain: usize,
        wanted: Target,
    ) -> Result<FalseAlarms, CalibrationError> {
        let numbers = self.of(domain);
        let drives: Vec<Stretch<'_, D>> = numbers.iter().map(|&n| self.drives[n].clone()).collect();
        let own = &mut components[domain..=domain];
        let spans = own[0].spans();
        if spans > 0 {
            // Every part of the evidence gets the same share of the false alarms. [drives][parts]
            let of_parts = look_at_all(&drives, |part| part.scores_of_parts(wanted, own))?;
            #[allow(clippy::cast_precision_loss)]
            let share = wanted.false_alarms_per_hour / (1 + spans) as f64;
            for part in 0..=spans {
                let of_part = of_parts.iter().map(|of| of[part].clone());
                let scores: Vec<(usize, DriveScores)> =
                    numbers.iter().copied().zip(of_part).collect();
                let factor = false_alarms::factor(&scores, share, self.optimistic);
                own[0]
                    .taps
                    .iter_mut()
                    .for_each(|tap| tap.widen(part, factor));
            }
        }
        let scores = look_at_all(&drives, |part| part.scores(wanted, own))?;
        let scores: Vec<(usize, DriveScores)> = numbers.into_iter().zip(scores).collect();
        let per_hour = wanted.false_alarms_per_hour;
        let false_alarms = false_alarms::calibrated(&scores, per_hour, self.optimistic);
        for tap in &mut own[0].taps {
            (0..=spans).for_each(|part| tap.widen(part, false_alarms.factor));
        }
        Ok(false_alarms)
    }
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
