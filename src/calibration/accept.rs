//! Roads → nominal domains beside the simulation of a reference, whose drives are not needed.

use super::component::{Domain, component_of, uses};
use super::distance::DriveDistance;
use super::drive::{LabelledMeans, SurveyedDrive};
use super::error::CalibrationError;
use super::facts::{DriveFacts, facts_of};
use super::pair;
use super::stretch::Usage;
use super::target::Target;
use crate::reference::{Component, Role, SourceUse, Span};

/// The result of an acceptance.
pub struct Accepted {
    /// The accepted domains with their thresholds.
    pub components: Vec<Component>,
    /// The sources that were used.
    pub sources: Vec<SourceUse>,
    /// What stands behind each domain.
    pub shown: Vec<Shown>,
    /// How far the drives of each domain are from each other.
    pub distances: Vec<DriveDistance>,
}

/// What stands behind an accepted domain.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// Number of drives.
    pub drives: usize,
    /// Their length together, seconds.
    pub seconds: f64,
    /// Number of spans of each kind that do not overlap, in the order of [`Span::ALL`].
    pub spans: [usize; Span::ALL.len()],
    /// What each drive is.
    pub of_drives: Vec<DriveFacts>,
}

/// Makes nominal domains beside those of a reference, without the drives of its simulation. They are the same as if
/// [`calibrate`](super::calibrate::calibrate) had made them with the simulation and with held-out drives of the simulation alone.
///
/// # Errors
/// When a frame cannot be judged, when there are too few frames, or when a drive can no longer be read.
pub fn accept<D: SurveyedDrive>(
    simulation: &Component,
    domains: &[Domain<'_, D>],
    wanted: Target,
) -> Result<Accepted, CalibrationError> {
    let taps: Vec<String> = simulation.taps.iter().map(|of| of.tap.clone()).collect();
    let none: &[LabelledMeans] = &[];
    let mut accepted = Accepted {
        components: Vec::new(),
        sources: Vec::new(),
        shown: Vec::new(),
        distances: Vec::new(),
    };
    for domain in domains {
        let facts = facts_of(domain.drives)?;
        check_energies(&facts, simulation)?;
        accepted.shown.push(Shown::of(facts));
        let usage = Usage::crossed(domain.drives);
        accepted
            .sources
            .extend(uses(domain, &usage, Role::Accepted));
        let mut made = component_of(&domain.name, &usage, Some(simulation), none, &taps, wanted)?;
        made.component.widen_like(simulation);
        accepted.components.push(made.component);
        let pair = pair::between(domain, simulation, &taps, wanted)?;
        accepted
            .distances
            .extend(made.distances.into_iter().chain(pair));
    }
    Ok(accepted)
}

impl Shown {
    /// What drives of one domain show together.
    pub fn of(of_drives: Vec<DriveFacts>) -> Self {
        let mut shown = Self {
            drives: of_drives.len(),
            seconds: 0.0,
            spans: [0; Span::ALL.len()],
            of_drives: Vec::new(),
        };
        for facts in &of_drives {
            shown.seconds += facts.seconds;
            let all = shown.spans.iter_mut().zip(facts.spans);
            all.for_each(|(sum, found)| *sum += found);
        }
        Self { of_drives, ..shown }
    }
}

/// Refuses a reference whose blocks have other numbers of energies than the model gives.
fn check_energies(facts: &[DriveFacts], simulation: &Component) -> Result<(), CalibrationError> {
    let wanted: Vec<usize> = simulation.taps.iter().map(|of| of.nominal.len()).collect();
    let other = facts
        .iter()
        .find(|of| of.frames > 0 && of.energies != wanted);
    match other {
        None => Ok(()),
        Some(facts) => Err(CalibrationError::Energies {
            source_name: facts.source.clone(),
            found: facts.energies.clone(),
            wanted,
        }),
    }
}

/// How often [`accept`] looks at drives in total.
pub fn looks_to_accept<D: SurveyedDrive>(domains: &[Domain<'_, D>], wanted: Target) -> u64 {
    let (mut fitted, mut scaled) = (0, 0);
    for domain in domains {
        let (fits, scales) = Usage::crossed(domain.drives).stretches();
        (fitted, scaled) = (fitted + fits, scaled + scales);
    }
    let drives: usize = domains.iter().map(|domain| domain.drives.len()).sum();
    let pairs: u64 = domains
        .iter()
        .map(|of| pair::looks_between(of.drives, wanted))
        .sum();
    (drives + 2 * fitted + (1 + usize::from(wanted.is_timed())) * scaled) as u64 + pairs
}
