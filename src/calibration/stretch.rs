//! Which frames of which drives are used for what. Each thread holds one drive at a time.

use std::ops::Range;

use rayon::prelude::*;

use super::drive::SurveyedDrive;
use super::error::CalibrationError;
use super::windows::Part;
use crate::reference::Component;

/// Of how many parts of an accepted domain each is scaled with what the others have fitted.
const FOLDS: usize = 3;

/// How the frames of a domain are used.
pub struct Usage<'a, D> {
    /// Frames that make histograms or moments.
    pub fitted: Vec<Stretch<'a, D>>,
    /// Frames that scale gaps, each with what was made without them.
    pub folds: Vec<Fold<'a, D>>,
}

/// Frames that scale gaps.
pub struct Fold<'a, D> {
    /// Frames that make the histograms or moments of this fold; `None`: those of the domain.
    pub fitted: Option<Vec<Stretch<'a, D>>>,
    /// The frames that scale.
    pub scaled: Vec<Stretch<'a, D>>,
}

impl<'a, D: SurveyedDrive> Usage<'a, D> {
    /// Of several drives, every second one fits and the others scale. Of a single drive, the last third scales.
    pub fn halves(drives: &'a [D]) -> Self {
        let alone = drives.len() == 1;
        let fitted = |index: usize, frames: usize| match (alone, index % 2) {
            (true, _) => frames - frames / 3,
            (false, 0) => frames,
            (false, _) => 0,
        };
        let of = |fits: bool| {
            let stretches = drives.iter().enumerate().map(|(index, drive)| {
                let (frames, end) = (drive.frames(), fitted(index, drive.frames()));
                let range = if fits { 0..end } else { end..frames };
                Stretch { drive, range }
            });
            stretches.filter(|of| !of.range.is_empty()).collect()
        };
        Self {
            fitted: of(true),
            folds: vec![Fold {
                fitted: None,
                scaled: of(false),
            }],
        }
    }

    /// Every frame fits, and every third part is scaled with what the other two have fitted (cross-validation), because
    /// accepted roads are short. Parts are whole drives; one or two drives are cut into parts.
    pub fn crossed(drives: &'a [D]) -> Self {
        let part = |index: usize, drive: &'a D, fold: usize| {
            let frames = drive.frames();
            let range = match drives.len() {
                0..FOLDS => fold * frames / FOLDS..(fold + 1) * frames / FOLDS,
                _ if index % FOLDS == fold => 0..frames,
                _ => 0..0,
            };
            Stretch { drive, range }
        };
        let of = |folds: &dyn Fn(usize) -> bool| -> Vec<Stretch<'a, D>> {
            let parts = drives.iter().enumerate().flat_map(|(index, drive)| {
                let own = (0..FOLDS).filter(|&fold| folds(fold));
                own.map(move |fold| part(index, drive, fold))
            });
            parts.filter(|of| !of.range.is_empty()).collect()
        };
        let folds = (0..FOLDS).map(|fold| Fold {
            fitted: Some(of(&|other| other != fold)),
            scaled: of(&|other| other == fold),
        });
        Self {
            fitted: drives.iter().map(Stretch::whole).collect(),
            folds: folds.filter(|fold| !fold.scaled.is_empty()).collect(),
        }
    }

    /// Number of stretches that are fitted, those of folds included, and of those that are scaled.
    pub fn stretches(&self) -> (usize, usize) {
        let of_folds = self.folds.iter().filter_map(|fold| fold.fitted.as_ref());
        let fitted = self.fitted.len() + of_folds.map(Vec::len).sum::<usize>();
        let scaled = self.folds.iter().map(|fold| fold.scaled.len()).sum();
        (fitted, scaled)
    }

    /// Number of frames of a drive that make histograms or moments, and of those that scale.
    pub fn frames_of(&self, drive: &D) -> (usize, usize) {
        let frames = |of: &mut dyn Iterator<Item = &Stretch<'a, D>>| -> usize {
            let own = of.filter(|stretch| std::ptr::eq(stretch.drive, drive));
            own.map(|stretch| stretch.range.len()).sum()
        };
        let scaled = &mut self.folds.iter().flat_map(|fold| &fold.scaled);
        (frames(&mut self.fitted.iter()), frames(scaled))
    }
}

/// Some frames of a drive, which are read again whenever they are needed.
pub struct Stretch<'a, D> {
    pub drive: &'a D,
    pub range: Range<usize>,
}

impl<D> Clone for Stretch<'_, D> {
    fn clone(&self) -> Self {
        Self {
            drive: self.drive,
            range: self.range.clone(),
        }
    }
}

impl<'a, D: SurveyedDrive> Stretch<'a, D> {
    /// All frames of a drive.
    pub fn whole(drive: &'a D) -> Self {
        Self {
            drive,
            range: 0..drive.frames(),
        }
    }

    /// Looks at the frames. It must be possible to judge all of them.
    pub fn look<T>(
        &self,
        at: impl FnOnce(&Part<'_>) -> Result<T, CalibrationError>,
    ) -> Result<T, CalibrationError> {
        let survey = self.drive.survey()?;
        at(&Part::of(&survey, self.range.clone())?)
    }
}

/// Looks at many stretches, one at a time on each thread; returns the results in their order.
pub fn look_at_all<D: SurveyedDrive, T: Send>(
    stretches: &[Stretch<'_, D>],
    at: impl Fn(&Part<'_>) -> Result<T, CalibrationError> + Sync,
) -> Result<Vec<T>, CalibrationError> {
    let seen: Vec<_> = stretches
        .par_iter()
        .map(|stretch| stretch.look(&at))
        .collect();
    seen.into_iter().collect()
}

/// Looks at the frames that scale a domain, each with what their fold has fitted.
pub fn look_at_folds<D: SurveyedDrive, T: Send>(
    folds: &[(&Component, &[Stretch<'_, D>])],
    at: impl Fn(&Part<'_>, &[Component]) -> Result<T, CalibrationError> + Sync,
) -> Result<Vec<T>, CalibrationError> {
    let mut seen = Vec::new();
    for &(own, scaled) in folds {
        let own = std::slice::from_ref(own);
        seen.extend(look_at_all(scaled, |part| at(part, own))?);
    }
    Ok(seen)
}

/// Sums over many stretches, one at a time on each thread. The result of `merge` must not depend on the order, as with
/// sums of integers.
pub fn sum_over_all<D: SurveyedDrive, T: Send + Sync + Clone>(
    stretches: &[Stretch<'_, D>],
    nothing: &T,
    add: impl Fn(&mut T, &Part<'_>) -> Result<(), CalibrationError> + Sync,
    merge: impl Fn(&mut T, &T) + Sync,
) -> Result<T, CalibrationError> {
    stretches
        .par_iter()
        .try_fold(
            || nothing.clone(),
            |mut sum, stretch| stretch.look(|part| add(&mut sum, part)).map(|()| sum),
        )
        .try_reduce(
            || nothing.clone(),
            |mut sum, other| {
                merge(&mut sum, &other);
                Ok(sum)
            },
        )
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::borrow::Cow;

    use super::*;
    use crate::calibration::drive::StoreError;
    use crate::calibration::survey::Survey;

    /// A drive that is never looked at.
    struct Long(usize);

    impl SurveyedDrive for Long {
        fn source(&self) -> &str {
            "a drive"
        }

        fn frames(&self) -> usize {
            self.0
        }

        fn survey(&self) -> Result<Cow<'_, Survey>, StoreError> {
            unreachable!("nobody looks at it")
        }
    }

    #[test]
    fn every_frame_of_an_accepted_domain_scales_once_with_what_others_have_fitted() {
        for lengths in [vec![100], vec![50, 70], vec![30, 40, 50], vec![20; 7]] {
            let drives: Vec<Long> = lengths.iter().copied().map(Long).collect();
            let usage = Usage::crossed(&drives);
            for drive in &drives {
                assert_eq!(usage.frames_of(drive), (drive.0, drive.0));
            }
            for fold in &usage.folds {
                let fitted = fold.fitted.as_ref().unwrap();
                let frames = |of: &[Stretch<'_, Long>]| -> usize {
                    of.iter().map(|stretch| stretch.range.len()).sum()
                };
                let all: usize = lengths.iter().sum();
                assert_eq!(frames(fitted) + frames(&fold.scaled), all);
                for (own, other) in fold
                    .scaled
                    .iter()
                    .flat_map(|own| fitted.iter().map(move |other| (own, other)))
                {
                    let apart =
                        own.range.end <= other.range.start || other.range.end <= own.range.start;
                    assert!(apart || !std::ptr::eq(own.drive, other.drive));
                }
            }
        }
    }

    #[test]
    fn of_the_simulation_every_second_drive_fits() {
        let drives = [Long(10), Long(20), Long(30)];
        let usage = Usage::halves(&drives);
        let used = drives.each_ref().map(|drive| usage.frames_of(drive));
        assert_eq!(used, [(10, 0), (0, 20), (30, 0)]);
        let lone = [Long(10)];
        assert_eq!(Usage::halves(&lone).frames_of(&lone[0]), (7, 3));
    }
}
