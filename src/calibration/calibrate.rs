//! Surveys of nominal sources → reference: what is nominal, medians, and thresholds for a wanted rate of false alarms.

use super::component::{Domain, component_of, uses};
use super::distance::DriveDistance;
use super::drive::{LabelledDrive, SurveyedDrive};
use super::error::CalibrationError;
use super::false_alarms::is_judging;
use super::far;
use super::pair;
use super::stretch::{Stretch, Usage, look_at_all};
use super::target::Target;
use super::thresholds;
use crate::reference::{Component, FalseAlarms, JudgedRate, Role, SourceUse};
use crate::statistics::quantile::median;

/// The result of a calibration.
pub struct Calibrated {
    /// The nominal domains with their thresholds.
    pub components: Vec<Component>,
    /// How often nominal drives enter `Gap`.
    pub false_alarms: FalseAlarms,
    /// The sources that were used.
    pub sources: Vec<SourceUse>,
    /// How often the road was judged.
    pub rate: JudgedRate,
    /// How far the held-out drives that set the rate are from the nearest domain, and accepted drives from the others of their domain.
    pub distances: Vec<DriveDistance>,
    /// With several domains, the number of held-out drives that are nearest to the simulation; `None` with one domain or
    /// without held-out drives.
    pub held_out_of_simulation: Option<usize>,
}

/// What is done about drives that are far from all domains, see [`DriveDistance::is_far`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FarDrives {
    /// There is no reference with them.
    Refused,
    /// They count like any others.
    Allowed,
}

/// How often [`calibrate`] looks at drives in total, counting each drive each time.
pub fn looks<D: SurveyedDrive, L: LabelledDrive>(
    domains: &[Domain<'_, D>],
    held_out: &[D],
    labelled: &[L],
    wanted: Target,
) -> u64 {
    let of_fitted = pair::looks_of_fit(wanted);
    let (mut fitted, mut scaled) = (0, 0);
    for (index, domain) in domains.iter().enumerate() {
        let (fits, scales) = usage(index, domain.drives).stretches();
        (fitted, scaled) = (fitted + fits, scaled + scales);
    }
    let scored = if held_out.is_empty() {
        scaled
    } else {
        held_out.len()
    };
    // With spans, drives are scaled twice, and scored once more; whether there will be spans is known later. With several
    // domains, drives are sorted by domain before, and scored once more after. The rate is looked at first.
    let timed = usize::from(wanted.is_timed());
    let several = if domains.len() > 1 { 2 } else { 0 };
    let (scalings, scorings) = (1 + timed, 2 + timed + several);
    let accepted = domains.iter().skip(1);
    let pairs: u64 = accepted
        .map(|of| pair::looks_between(of.drives, wanted))
        .sum();
    (of_fitted * fitted + scalings * scaled + scorings * scored + labelled.len()) as u64 + pairs
}

/// Makes the nominal domains of a reference like [`calibrate_with`], whatever drives are far.
///
/// # Errors
/// Like [`calibrate_with`].
pub fn calibrate<D: SurveyedDrive, L: LabelledDrive>(
    domains: &[Domain<'_, D>],
    held_out: &[D],
    labelled: &[L],
    taps: &[String],
    wanted: Target,
) -> Result<Calibrated, CalibrationError> {
    calibrate_with(
        domains,
        held_out,
        labelled,
        taps,
        wanted,
        FarDrives::Allowed,
    )
}

/// Makes the nominal domains of a reference and the thresholds that keep the wanted rate of false alarms.
///
/// The first domain is the simulation: every second drive makes histograms or moments, and the others scale the gaps of
/// windows. Every frame of an accepted domain does both, in turn. The rate is set on three of every four drives of
/// `held_out` and judged on the fourth. Without held-out drives, the rate is set on the drives that scale the gaps, and the reference says so. `labelled`
/// frames are only for the metric `lane-risk`.
///
/// Drives are looked at several times, and each thread holds one drive at a time. In between, less than 100 bytes are
/// kept for each frame. The result does not depend on the number of threads.
///
/// # Errors
/// When a frame cannot be judged, when there are too few frames, when a drive can no longer be read, when no held-out drive
/// is nearest to the simulation, or when drives are far and refused.
pub fn calibrate_with<D: SurveyedDrive, L: LabelledDrive>(
    domains: &[Domain<'_, D>],
    held_out: &[D],
    labelled: &[L],
    taps: &[String],
    wanted: Target,
    far_drives: FarDrives,
) -> Result<Calibrated, CalibrationError> {
    let mut distances = Vec::new();
    let mut sources = Vec::new();
    let mut components: Vec<Component> = Vec::new();
    let mut scaling: Vec<Stretch<'_, D>> = Vec::new();
    for (index, domain) in domains.iter().enumerate() {
        let usage = usage(index, domain.drives);
        let role = match index {
            0 => Role::Simulation,
            _ => Role::Accepted,
        };
        sources.extend(uses(domain, &usage, role));
        let simulation = components.first();
        let made = component_of(&domain.name, &usage, simulation, labelled, taps, wanted)?;
        distances.extend(made.distances);
        if let Some(simulation) = simulation {
            distances.extend(pair::between(domain, simulation, taps, wanted)?);
        }
        components.push(made.component);
        scaling.extend(usage.folds.into_iter().flat_map(|fold| fold.scaled));
    }
    sources.extend(held_out.iter().map(|drive| SourceUse {
        source: drive.source().to_owned(),
        role: Some(Role::HeldOut),
        domain: None,
        frames: drive.frames() as u64,
        fitted: 0,
        held_out: drive.frames() as u64,
    }));
    let optimistic = held_out.is_empty();
    if !optimistic {
        scaling = held_out.iter().map(Stretch::whole).collect();
    }
    let looked = look_at_all(&scaling, |part| {
        let distance = match optimistic {
            true => None,
            false => far::of_held_out(part, &components, wanted)?,
        };
        Ok((part.frames_hz(), distance))
    })?;
    let (frames_hz, of_held_out): (Vec<_>, Vec<_>) = looked.into_iter().unzip();
    // A drive that judges moves no threshold, and the rate says so if it is loud.
    let setting = of_held_out.into_iter().enumerate();
    let setting = setting.filter(|&(number, _)| !is_judging(number));
    distances.extend(setting.filter_map(|(_, distance)| distance));
    if far_drives == FarDrives::Refused && distances.iter().any(DriveDistance::is_far) {
        return Err(CalibrationError::Far(distances));
    }
    let frames_hz = median(frames_hz.into_iter().flatten().collect());
    let rate = frames_hz.map_or(wanted.rate, |hz| wanted.rate.at_most(hz));
    let wanted = Target { rate, ..wanted };
    let (false_alarms, of_simulation) =
        thresholds::set(&mut components, &scaling, wanted, optimistic)?;
    let several = components.len() > 1 && !optimistic;
    Ok(Calibrated {
        components,
        false_alarms,
        sources,
        rate,
        distances,
        held_out_of_simulation: several.then_some(of_simulation),
    })
}

/// How the frames of the domain with this number are used.
fn usage<D: SurveyedDrive>(index: usize, drives: &[D]) -> Usage<'_, D> {
    match index {
        0 => Usage::halves(drives),
        _ => Usage::crossed(drives),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp, clippy::cast_precision_loss)]
    use std::borrow::Cow;
    use std::time::Duration;

    use super::super::binning::tests::ramp;
    use super::*;
    use crate::calibration::accept;
    use crate::calibration::drive::{LabelledMeans, StoreError};
    use crate::calibration::survey::{Survey, SurveyFrame};
    use crate::features::energies::BlockMeans;
    use crate::reference::EvidenceKind;
    use crate::reference::gap::{Divergence, Metric};

    const LOG_ENERGY: Metric = Metric::LogEnergy(Divergence::JensenShannon);
    const ATTENTION: Metric = Metric::Attention(Divergence::JensenShannon);

    /// A drive that counts how often it is looked at.
    struct Counted(Survey, std::sync::atomic::AtomicU64);

    impl SurveyedDrive for Counted {
        fn source(&self) -> &str {
            &self.0.source
        }

        fn frames(&self) -> usize {
            self.0.frames.len()
        }

        fn survey(&self) -> Result<Cow<'_, Survey>, StoreError> {
            self.1.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            Ok(Cow::Borrowed(&self.0))
        }
    }

    /// A drive of 60 frames, each with a different map.
    fn counted(seed: usize) -> Counted {
        let frames = (0..60).map(|frame| {
            let map = ramp(100 * (seed + frame), 100 * (seed + frame) + 64);
            let energy = map.energy.iter().take(20).copied().collect();
            Ok(SurveyFrame {
                peaks: vec![map.range().1],
                means: vec![BlockMeans {
                    activation: vec![1.0; 4],
                    energy,
                }],
                maps: vec![map],
            })
        });
        let survey = Survey {
            source: format!("drive {seed}"),
            times: (0..60).map(|i| Duration::from_millis(100 * i)).collect(),
            frames: frames.collect(),
            common_size: (64, 1),
        };
        Counted(survey, Default::default())
    }

    #[test]
    fn looks_are_as_many_as_were_foretold() {
        for metric in [Metric::Mahalanobis, LOG_ENERGY, ATTENTION] {
            for (fitting, held_out) in [(1, 0), (4, 0), (5, 3)] {
                let drives: Vec<Counted> = (0..fitting).map(counted).collect();
                let held_out: Vec<Counted> = (0..held_out).map(|i| counted(20 + i)).collect();
                let domain = Domain {
                    name: "simulation".to_owned(),
                    drives: &drives,
                };
                let wanted = Target {
                    evidence: EvidenceKind::Frames,
                    ..Target::new(metric, 1.0, 1.0)
                };
                let domains = [domain];
                let none: &[LabelledMeans] = &[];
                let predicted = looks(&domains, &held_out, none, wanted);
                calibrate(&domains, &held_out, none, &["e2".to_owned()], wanted).unwrap();
                let all = drives.iter().chain(&held_out);
                let looked: u64 = all
                    .map(|d| d.1.load(std::sync::atomic::Ordering::Relaxed))
                    .sum();
                assert_eq!(looked, predicted, "{metric}, {fitting} drives");
            }
        }
    }

    #[test]
    fn an_accepted_road_moves_no_threshold_of_the_simulation() {
        let simulation: Vec<Counted> = (0..8).map(counted).collect();
        let held_out: Vec<Counted> = (8..16).map(counted).collect();
        let road = [counted(90)];
        let domain = |name: &str, drives| Domain {
            name: name.to_owned(),
            drives,
        };
        let wanted = Target {
            evidence: EvidenceKind::Frames,
            ..Target::new(Metric::Mahalanobis, 1.0, 1.0)
        };
        let none: &[LabelledMeans] = &[];
        let taps = ["e2".to_owned()];
        let made = |domains: &[Domain<'_, Counted>]| {
            calibrate(domains, &held_out, none, &taps, wanted).unwrap()
        };
        let alone = made(&[domain("simulation", &simulation)]);
        let both = made(&[domain("simulation", &simulation), domain("road", &road)]);
        assert_eq!(both.components[0], alone.components[0]);
        assert_eq!(both.false_alarms.factor, alone.false_alarms.factor);
        // Without its drives, the simulation's domain is enough to accept the road as it was accepted with them.
        let later = accept(&alone.components[0], &[domain("road", &road)], wanted).unwrap();
        assert_eq!(later.components, both.components[1..]);
        assert_eq!(later.shown[0].drives, 1);
        assert!((later.shown[0].seconds - 6.0).abs() < 1e-6);
        assert_eq!(later.shown[0].spans, [1, 0, 0]);
        // The road has the margins of the simulation, or those that its own frames need.
        let times = |of: &Component| of.taps[0].scale[0].threshold / of.taps[0].scale[0].median;
        assert!(times(&both.components[1]) >= times(&both.components[0]) * 0.999_999);
    }
}
