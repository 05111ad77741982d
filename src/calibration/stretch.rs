//! Which frames of which drives are used for what. Each thread holds one drive at a time.

use std::ops::Range;

use rayon::prelude::*;

use super::drive::SurveyedDrive;
use super::error::CalibrationError;
use super::windows::Part;

/// A drive whose frames before `fitted` make histograms or moments, and whose other frames scale gaps.
pub struct Split<'a, D> {
    pub drive: &'a D,
    pub fitted: usize,
}

/// With several drives, every second one is held out completely. Of a single drive, the last third is held out.
pub fn split<D: SurveyedDrive>(drives: &[D]) -> Vec<Split<'_, D>> {
    let alone = drives.len() == 1;
    let share = |index: usize, frames: usize| match (alone, index % 2) {
        (true, _) => frames - frames / 3,
        (false, 0) => frames,
        (false, _) => 0,
    };
    drives
        .iter()
        .enumerate()
        .map(|(i, drive)| Split {
            drive,
            fitted: share(i, drive.frames()),
        })
        .collect()
}

impl<'a, D: SurveyedDrive> Split<'a, D> {
    pub fn fitted(&self) -> Stretch<'a, D> {
        Stretch {
            drive: self.drive,
            range: 0..self.fitted,
        }
    }

    pub fn rest(&self) -> Stretch<'a, D> {
        Stretch {
            drive: self.drive,
            range: self.fitted..self.drive.frames(),
        }
    }
}

/// Some frames of a drive, which are read again whenever they are needed.
pub struct Stretch<'a, D> {
    pub drive: &'a D,
    pub range: Range<usize>,
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
