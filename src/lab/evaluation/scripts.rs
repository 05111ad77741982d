//! Passes drives through the monitor, and gives scores with which the rest of the chain can be run at any rate of false
//! alarms.

use std::time::Duration;

use rayon::prelude::*;

use crate::calibration::DriveScores;
use crate::capture::pixels::Pixels;
use crate::capture::{Frame, Picture};
use crate::lab::scene::{Condition, Drive, Look, Renderer, World};
use crate::model::encoder::{Encoder, EncoderError};
use crate::monitor::detector::Evidence;
use crate::monitor::judge::{Judge, Sighting, Verdict};
use crate::monitor::pipeline::Sight;
use crate::monitor::rate::Looks;
use crate::monitor::warn::WarnOn;
use crate::reference::Reference;

/// What a drive shows in one of its parts.
#[derive(Clone, Debug)]
pub enum Shown {
    /// A rendered drive.
    Drive {
        /// The world's look.
        look: Look,
        /// The drive's seed.
        seed: u64,
        /// Mean length of the stretches of its road, metres; 0 for a road of one kind.
        stretch_m: u32,
        /// Its conditions.
        conditions: Vec<Condition>,
    },
    /// Random pixels.
    Noise {
        /// Their seed.
        seed: u64,
    },
}

/// A drive that consists of parts, each from a time on.
#[derive(Clone, Debug)]
pub struct Script {
    /// Parts and the seconds at which they begin, rising from 0.
    pub parts: Vec<(f64, Shown)>,
    /// Length, seconds.
    pub seconds: f64,
    /// Frames a second.
    pub fps: f64,
}

/// Scores of every script; `seen` is called after each.
///
/// # Errors
/// When the encoder cannot be run at all.
pub fn scores_of(
    scripts: &[Script],
    encoder: &Encoder,
    reference: &Reference,
    seen: &(dyn Fn() + Sync),
) -> Result<Vec<DriveScores>, EncoderError> {
    scripts
        .par_iter()
        .map(|script| {
            let scores = script.scores(encoder, reference)?;
            seen();
            Ok(scores)
        })
        .collect()
}

/// Verdicts of every script; `seen` is called after each.
///
/// # Errors
/// When the encoder cannot be run at all.
pub fn verdicts_of(
    scripts: &[Script],
    encoder: &Encoder,
    reference: &Reference,
    seen: &(dyn Fn() + Sync),
) -> Result<Vec<Vec<Verdict>>, EncoderError> {
    scripts
        .par_iter()
        .map(|script| {
            let (mut judge, mut verdicts) = (Judge::default(), Vec::new());
            script.watch(encoder, reference, |sighting| {
                verdicts.push(judge.judge(sighting));
            })?;
            seen();
            Ok(verdicts)
        })
        .collect()
}

impl Script {
    fn scores(
        &self,
        encoder: &Encoder,
        reference: &Reference,
    ) -> Result<DriveScores, EncoderError> {
        let mut scores = DriveScores::default();
        self.watch(encoder, reference, |seen| {
            scores.add_evidence(seen.at, &seen.evidence);
        })?;
        Ok(scores)
    }

    /// Passes every frame through the part of the monitor that works on pictures.
    fn watch(
        &self,
        encoder: &Encoder,
        reference: &Reference,
        mut each: impl FnMut(Sighting),
    ) -> Result<(), EncoderError> {
        let mut sight = Sight::new(encoder, reference)?;
        let of = &reference.model.preprocessing;
        let mut renderer = Renderer::new(of.width, of.height);
        let drives: Vec<(f64, Option<Drive>, u64)> = self
            .parts
            .iter()
            .map(|(from_s, shown)| match shown {
                Shown::Drive {
                    look,
                    seed,
                    stretch_m,
                    conditions,
                } => {
                    let world = World {
                        stretch_m: *stretch_m,
                        ..World::of(*look)
                    };
                    let drive = Drive::new(&world, *seed, conditions);
                    (*from_s, Some(drive), 0)
                }
                Shown::Noise { seed } => (*from_s, None, *seed),
            })
            .collect();
        let mut looks = Looks::new(reference.rate.at_most(self.fps));
        // Lengths and rates of evaluations are small numbers.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let frames = (self.seconds * self.fps).ceil() as u64;
        for sequence in 0..frames {
            #[allow(clippy::cast_precision_loss)]
            let at_s = sequence as f64 / self.fps;
            if !looks.is_due(Duration::from_secs_f64(at_s)) {
                continue;
            }
            let part = drives.iter().rev().find(|(from_s, ..)| *from_s <= at_s);
            let Some((_, drive, noise)) = part else {
                continue;
            };
            let rgb = match drive {
                Some(drive) => renderer.render(drive, at_s).rgb.to_vec(),
                None => noise_pixels(*noise, sequence, (of.width * of.height) as usize),
            };
            let seen = sight.see(&Frame {
                sequence,
                captured_at: Duration::from_secs_f64(at_s),
                picture: Ok(Pixels::from(Picture {
                    width: of.width,
                    height: of.height,
                    rgb,
                })),
            });
            let score = seen.evidence.as_ref().ok().map(Evidence::score);
            looks.judged(seen.at, seen.judgement(WarnOn::default()), score);
            each(seen);
        }
        Ok(())
    }
}

fn noise_pixels(seed: u64, sequence: u64, pixels: usize) -> Vec<u8> {
    let mut dice = crate::statistics::random::SplitMix64::new(seed ^ (sequence << 20));
    (0..3 * pixels).map(|_| dice.byte()).collect()
}
