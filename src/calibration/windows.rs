//! Passes frames of a drive through the chain after the encoder: gaps of windows, and the detector's scores.

use std::ops::Range;
use std::time::Duration;

use super::error::{CalibrationError, wrong};
use super::false_alarms::DriveScores;
use super::survey::{Survey, SurveyFrame};
use super::target::Target;
use crate::capture::undefined::Undefined;
use crate::features::attention::{EnergyMap, Upsampler};
use crate::monitor::detector::{Evidence, PARTS_MAX};
use crate::monitor::extraction::Extraction;
use crate::monitor::rate::Looks;
use crate::monitor::scorer::Scorer;
use crate::monitor::warn::WarnOn;
use crate::reference::gap::Metric;
use crate::reference::gap::moments::STEPS_PER_NAT;
use crate::reference::{Component, Nominal};

/// Frames of one drive, all of which can be judged.
pub struct Part<'a> {
    survey: &'a Survey,
    /// Number of the first frame in the drive.
    first: usize,
    pub frames: Vec<&'a SurveyFrame>,
}

impl<'a> Part<'a> {
    pub fn of(survey: &'a Survey, range: Range<usize>) -> Result<Self, CalibrationError> {
        let first = range.start;
        let frames = survey.frames[range]
            .iter()
            .enumerate()
            .map(|(index, frame)| {
                frame.as_ref().map_err(|why| CalibrationError::Frame {
                    source_name: survey.source.clone(),
                    frame: first + index,
                    why: why.clone(),
                })
            });
        Ok(Self {
            survey,
            first,
            frames: frames.collect::<Result<_, _>>()?,
        })
    }

    /// Name of the drive.
    pub fn source(&self) -> &str {
        &self.survey.source
    }

    /// When the frames were taken.
    pub fn times(&self) -> &[Duration] {
        &self.survey.times[self.first..][..self.frames.len()]
    }

    /// Frames a second, from the median time between frames; `None` without two frames.
    pub fn frames_hz(&self) -> Option<f64> {
        let pairs = self.times().windows(2);
        let mut steps: Vec<Duration> = pairs.map(|pair| pair[1].saturating_sub(pair[0])).collect();
        steps.sort_unstable();
        let middle = steps.get(steps.len() / 2).filter(|step| !step.is_zero())?;
        Some(1.0 / middle.as_secs_f64())
    }

    fn wrong(&self, index: usize, why: Undefined) -> CalibrationError {
        CalibrationError::Frame {
            source_name: self.survey.source.clone(),
            frame: self.first + index,
            why,
        }
    }

    /// The maps of one tap at the common size, frame by frame.
    pub fn common_maps(&self, tap: usize, mut each: impl FnMut(&EnergyMap)) {
        let mut upsampler = None;
        let mut common = EnergyMap::default();
        for frame in &self.frames {
            let map = &frame.maps[tap];
            let size = (map.width, map.height);
            let upsampler =
                upsampler.get_or_insert_with(|| Upsampler::new(size, self.survey.common_size));
            upsampler.resample(map, &mut common);
            each(&common);
        }
    }

    /// What the domains take from each frame.
    pub fn track(
        &self,
        metric: Metric,
        components: &[Component],
    ) -> Result<Track, CalibrationError> {
        let width = Component::taken_len(components);
        let mut extraction =
            Extraction::new(metric, components[0].taps.len(), self.survey.common_size);
        let mut taken = vec![0; width * self.frames.len()];
        let rows = taken.chunks_exact_mut(width.max(1));
        for (index, (frame, row)) in self.frames.iter().zip(rows).enumerate() {
            extraction
                .take(&frame.maps, &frame.means, components, row)
                .map_err(|why| self.wrong(index, why))?;
        }
        Ok(Track {
            at: self.survey.times[self.first..][..self.frames.len()].to_vec(),
            width,
            taken,
        })
    }

    /// Gaps from the one domain in `own`, `[taps][lengths][windows]`, for windows of some `lengths`, frames.
    pub fn gaps(
        &self,
        wanted: Target,
        own: &[Component],
        lengths: &[usize],
    ) -> Result<Vec<Vec<Vec<f64>>>, CalibrationError> {
        let track = self.track(wanted.metric, own)?;
        let mut from = 0;
        let of_taps = own[0].taps.iter().map(|tap| {
            let columns = from..from + tap.nominal.len();
            from = columns.end;
            let gaps = lengths
                .iter()
                .map(|&frames| track.gaps(columns.clone(), frames, &tap.nominal, wanted));
            let gaps: Result<Vec<_>, _> = gaps.collect();
            gaps.map_err(|why| wrong(&tap.tap, wanted.metric, why))
        });
        of_taps.collect()
    }

    /// Passes the drive through the detector after a reset, at the rate at which the road is judged.
    pub fn evidence(
        &self,
        wanted: Target,
        components: &[Component],
        mut each: impl FnMut(Duration, &Evidence, &mut Scorer),
    ) -> Result<(), CalibrationError> {
        let common_size = self.survey.common_size;
        let mut scorer = Scorer::of(
            wanted.metric,
            components.to_vec(),
            wanted.window_s,
            common_size,
        )
        .with_frames_every(wanted.rate.periods().idle);
        let mut looks = Looks::new(wanted.rate);
        for (index, (&at, frame)) in self.times().iter().zip(&self.frames).enumerate() {
            if !looks.is_due(at) {
                continue;
            }
            let evidence = scorer
                .observe(at, &frame.maps, &frame.means)
                .map_err(|why| self.wrong(index, why))?;
            looks.judged(
                at,
                evidence.judgement(WarnOn::default()),
                Some(evidence.score()),
            );
            each(at, &evidence, &mut scorer);
        }
        Ok(())
    }

    /// The scores of the drive.
    pub fn scores(
        &self,
        wanted: Target,
        components: &[Component],
    ) -> Result<DriveScores, CalibrationError> {
        let mut drive = DriveScores::default();
        self.evidence(wanted, components, |at, evidence, _| {
            drive.add_evidence(at, &Ok(evidence.clone()));
        })?;
        Ok(drive)
    }

    /// The scores of the drive for each part of the evidence alone: the window, and each span.
    pub fn scores_of_parts(
        &self,
        wanted: Target,
        components: &[Component],
    ) -> Result<Vec<DriveScores>, CalibrationError> {
        let mut drives = vec![DriveScores::default(); PARTS_MAX];
        self.evidence(wanted, components, |at, evidence, _| {
            for (part, drive) in evidence.parts.iter().zip(&mut drives) {
                // What is not known is no evidence.
                drive.add(at, part.unwrap_or(0.0), evidence.fill >= 1.0);
            }
        })?;
        Ok(drives)
    }
}

/// Passes a survey through the detector after a reset: the score of each frame, or why it has none.
pub fn drive_scores(
    survey: &Survey,
    metric: Metric,
    window_s: f64,
    components: &[Component],
) -> DriveScores {
    let mut scorer = Scorer::of(metric, components.to_vec(), window_s, survey.common_size);
    let mut drive = DriveScores::default();
    for (at, evidence) in drive_evidence(survey, &mut scorer) {
        drive.add_evidence(at, &evidence);
    }
    drive
}

/// What is known after each frame of a survey that passes through `scorer`, or why a frame cannot be judged.
pub fn drive_evidence<'a>(
    survey: &'a Survey,
    scorer: &'a mut Scorer,
) -> impl Iterator<Item = (Duration, Result<Evidence, Undefined>)> + 'a {
    let frames = survey.times.iter().zip(&survey.frames);
    frames.map(|(&at, frame)| {
        let frame = frame.as_ref().map_err(Undefined::clone);
        let evidence = frame.and_then(|frame| scorer.observe(at, &frame.maps, &frame.means));
        (at, evidence)
    })
}

/// What was taken from the frames of a drive.
pub struct Track {
    at: Vec<Duration>,
    /// How many numbers are taken from a frame.
    width: usize,
    /// `[frames, width]`
    taken: Vec<u32>,
}

impl Track {
    fn rows(&self, frames: Range<usize>) -> impl Iterator<Item = &[u32]> {
        self.taken[frames.start * self.width..frames.end * self.width]
            .chunks_exact(self.width.max(1))
    }

    /// Time and numbers of each frame.
    pub fn frames(&self) -> impl Iterator<Item = (Duration, &[u32])> {
        self.at.iter().copied().zip(self.rows(0..self.at.len()))
    }

    /// Mean levels of the frames after `from_s` up to `to_s`, nats; `None` without frames there, or if the drive ends
    /// before.
    #[allow(clippy::cast_precision_loss)]
    pub fn mean(&self, from_s: f64, to_s: f64) -> Option<Vec<f64>> {
        let after = |at_s: f64| self.at.partition_point(|at| at.as_secs_f64() <= at_s);
        let range = after(from_s)..after(to_s);
        if range.is_empty() || range.end == self.at.len() {
            return None;
        }
        let share = 1.0 / (STEPS_PER_NAT * range.len() as f64);
        let mut sums = vec![0_u64; self.width];
        for row in self.rows(range) {
            sums.iter_mut()
                .zip(row)
                .for_each(|(sum, &level)| *sum += u64::from(level));
        }
        Some(sums.into_iter().map(|sum| share * sum as f64).collect())
    }

    /// Consecutive windows, each with the frames within `window_s` of its first frame.
    fn windows(&self, window_s: f64) -> impl Iterator<Item = Range<usize>> {
        let mut next = 0;
        std::iter::from_fn(move || {
            let from = next;
            let first = *self.at.get(from)?;
            let within = |at: &Duration| at.saturating_sub(first).as_secs_f64() < window_s;
            next = from
                + self.at[from..]
                    .iter()
                    .take_while(|at| within(at))
                    .count()
                    .max(1);
            Some(from..next)
        })
    }

    /// Gaps of the windows, with `frames` frames of each window, evenly spread.
    fn gaps(
        &self,
        columns: Range<usize>,
        frames: usize,
        nominal: &Nominal,
        wanted: Target,
    ) -> Result<Vec<f64>, Undefined> {
        let mut gaps = Vec::new();
        for window in self.windows(wanted.window_s) {
            if window.len() < frames {
                continue;
            }
            let rows: Vec<&[u32]> = self.rows(window).collect();
            let mut sums = vec![0_u64; columns.len()];
            for index in 0..frames {
                let row = &rows[index * rows.len() / frames][columns.clone()];
                sums.iter_mut()
                    .zip(row)
                    .for_each(|(sum, &value)| *sum += u64::from(value));
            }
            gaps.push(nominal.compare(wanted.metric, &sums, frames)?.gap);
        }
        Ok(gaps)
    }
}
