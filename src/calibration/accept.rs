//! Roads → nominal domains beside the simulation of a reference, whose drives are not needed.

use super::component::{Domain, component_of, uses};
use super::drive::{LabelledMeans, SurveyedDrive};
use super::error::CalibrationError;
use super::stretch::{Stretch, Usage, look_at_all};
use super::target::Target;
use super::timed::independent_spans;
use crate::reference::{Component, Role, SourceUse, Span};

/// The result of an acceptance.
pub struct Accepted {
    /// The accepted domains with their thresholds.
    pub components: Vec<Component>,
    /// The sources that were used.
    pub sources: Vec<SourceUse>,
    /// What stands behind each domain.
    pub shown: Vec<Shown>,
}

/// What stands behind an accepted domain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shown {
    /// Number of drives.
    pub drives: usize,
    /// Their length together, seconds.
    pub seconds: f64,
    /// Number of spans of each kind that do not overlap, in the order of [`Span::ALL`].
    pub spans: [usize; Span::ALL.len()],
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
    let (mut components, mut sources, mut shown) = (Vec::new(), Vec::new(), Vec::new());
    for domain in domains {
        shown.push(shown_by(domain.drives)?);
        let usage = Usage::crossed(domain.drives);
        sources.extend(uses(domain, &usage, Role::Accepted));
        let mut component =
            component_of(&domain.name, &usage, Some(simulation), none, &taps, wanted)?;
        component.widen_like(simulation);
        components.push(component);
    }
    Ok(Accepted {
        components,
        sources,
        shown,
    })
}

fn shown_by<D: SurveyedDrive>(drives: &[D]) -> Result<Shown, CalibrationError> {
    let whole: Vec<Stretch<'_, D>> = drives.iter().map(Stretch::whole).collect();
    let of_drives = look_at_all(&whole, |part| {
        let spans = Span::ALL.map(|span| independent_spans(part.times(), span));
        let period_s = part.frames_hz().map_or(0.0, f64::recip);
        let ends = part.times().first().zip(part.times().last());
        let lasted_s = ends.map_or(0.0, |(first, last)| (*last - *first).as_secs_f64());
        Ok((lasted_s + period_s, spans))
    })?;
    let mut shown = Shown {
        drives: drives.len(),
        seconds: 0.0,
        spans: [0; Span::ALL.len()],
    };
    for (seconds, spans) in of_drives {
        shown.seconds += seconds;
        let all = shown.spans.iter_mut().zip(spans);
        all.for_each(|(sum, found)| *sum += found);
    }
    Ok(shown)
}

/// How often [`accept`] looks at drives in total.
pub fn looks_to_accept<D: SurveyedDrive>(domains: &[Domain<'_, D>], wanted: Target) -> u64 {
    let (mut fitted, mut scaled) = (0, 0);
    for domain in domains {
        let (fits, scales) = Usage::crossed(domain.drives).stretches();
        (fitted, scaled) = (fitted + fits, scaled + scales);
    }
    let drives: usize = domains.iter().map(|domain| domain.drives.len()).sum();
    (drives + 2 * fitted + (1 + usize::from(wanted.is_timed())) * scaled) as u64
}
