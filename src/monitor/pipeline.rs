//! The whole chain in one file: a frame comes in, a verdict goes out.

use std::time::Duration;

use crate::capture::undefined::Undefined;
use crate::capture::{Frame, Picture};
use crate::features::attention::EnergyMap;
use crate::features::energies::{EnergyStage, StageDone};
use crate::model::encoder::{Encoder, EncoderError};
use crate::monitor::camera_health::CameraHealth;
use crate::monitor::detector::Evidence;
use crate::monitor::judge::{Judge, Sighting, Verdict};
use crate::monitor::profile::TapProfile;
use crate::monitor::scorer::Scorer;
use crate::monitor::warn::WarnOn;
use crate::reference::Reference;

/// Compares one camera with one reference.
pub struct Monitor {
    sight: Sight,
    judge: Judge,
}

/// Frame → energies → histograms → window → evidence: the part of the chain that works on pictures.
pub struct Sight {
    camera: CameraHealth,
    stage: EnergyStage,
    scorer: Scorer,
}

/// Where the encoder looked, and what it saw there.
#[derive(Clone, Debug)]
pub struct Look {
    /// The picture that it saw.
    pub seen: Picture,
    /// Energies of each tap, at the size of its block.
    pub energies: Vec<EnergyMap>,
    /// The window beside what is nominal, one entry for each tap; empty if it cannot be judged.
    pub profiles: Vec<TapProfile>,
}

impl Monitor {
    /// A monitor that has seen nothing. The reference must fit the encoder (`Reference::check_fits`).
    ///
    /// # Errors
    /// When the encoder's state cannot be set up.
    pub fn new(encoder: &Encoder, reference: &Reference) -> Result<Self, EncoderError> {
        Ok(Self {
            sight: Sight::new(encoder, reference)?,
            judge: Judge::default(),
        })
    }

    /// These answers raise the warning; gap and change, if nothing is said.
    #[must_use]
    pub fn warning_on(self, warn: WarnOn) -> Self {
        Self {
            sight: self.sight.warning_on(warn),
            judge: self.judge.warning_on(warn),
        }
    }

    /// Judges a frame. The time is that of the frame.
    pub fn step(&mut self, frame: &Frame) -> Verdict {
        self.step_by_step(frame, &mut |_| {})
    }

    /// Like [`step`](Self::step); `done` is called with the name of each completed stage.
    pub fn step_by_step(&mut self, frame: &Frame, done: &mut StageDone<'_>) -> Verdict {
        let seen = self.sight.see_step_by_step(frame, done);
        self.judge.judge(seen)
    }

    /// See [`Judge::silence`].
    pub fn silence(&mut self, now: Duration) -> Option<Verdict> {
        self.judge.silence(now)
    }

    /// See [`Sight::look`].
    pub fn look(&self) -> Look {
        self.sight.look()
    }
}

impl Sight {
    /// A sight that has seen nothing. The reference must fit the encoder (`Reference::check_fits`).
    ///
    /// # Errors
    /// When the encoder's state cannot be set up.
    pub fn new(encoder: &Encoder, reference: &Reference) -> Result<Self, EncoderError> {
        let stage = EnergyStage::new(encoder, &reference.model.preprocessing)?;
        Ok(Self {
            camera: CameraHealth::default(),
            scorer: Scorer::new(reference, stage.common_size()),
            stage,
        })
    }

    /// Frames may come as slowly as one every `period`.
    pub fn with_frames_every(self, period: Duration) -> Self {
        Self {
            camera: CameraHealth::with_frames_every(period),
            scorer: self.scorer.with_frames_every(period),
            ..self
        }
    }

    /// See [`Detector::warning_on`](crate::monitor::detector::Detector::warning_on).
    #[must_use]
    pub fn warning_on(self, warn: WarnOn) -> Self {
        Self {
            scorer: self.scorer.warning_on(warn),
            ..self
        }
    }

    /// What a frame adds to what was seen before.
    pub fn see(&mut self, frame: &Frame) -> Sighting {
        self.see_step_by_step(frame, &mut |_| {})
    }

    /// Like [`see`](Self::see); `done` is called with the name of each completed stage.
    pub fn see_step_by_step(&mut self, frame: &Frame, done: &mut StageDone<'_>) -> Sighting {
        let evidence = self.evidence(frame, done);
        Sighting {
            at: frame.captured_at,
            sequence: frame.sequence,
            quality: evidence.is_ok().then(|| self.stage.quality()),
            evidence,
        }
    }

    /// Where the encoder looked in the last frame that was judged.
    pub fn look(&self) -> Look {
        Look {
            seen: self.stage.seen(),
            energies: self.stage.maps().to_vec(),
            profiles: self.scorer.profiles(),
        }
    }

    fn evidence(&mut self, frame: &Frame, done: &mut StageDone<'_>) -> Result<Evidence, Undefined> {
        self.camera.check(frame)?;
        done("health");
        self.stage.energies_step_by_step(frame.pixels()?, done)?;
        self.scorer.take(self.stage.maps(), self.stage.means())?;
        done("histogram");
        let evidence = self.scorer.detect(frame.captured_at);
        done("detector");
        evidence
    }
}
