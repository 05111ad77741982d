//! The whole chain on one screen: a frame in, a verdict out.

use std::time::Duration;

use crate::capture::undefined::Undefined;
use crate::capture::{Frame, Picture};
use crate::features::attention::EnergyMap;
use crate::features::energies::EnergyStage;
use crate::model::encoder::{Encoder, EncoderError};
use crate::monitor::camera_health::CameraHealth;
use crate::monitor::detector::Detector;
use crate::monitor::intake::Intake;
use crate::monitor::judge::{Judge, Sighting, Verdict};
use crate::monitor::profile::TapProfile;
use crate::reference::{Component, Reference};

/// Watches one camera against one reference.
pub struct Monitor {
    sight: Sight,
    judge: Judge,
}

/// Frame → energies → histograms → window → evidence: all of the chain that looks at pictures.
pub struct Sight {
    camera: CameraHealth,
    stage: EnergyStage,
    components: Vec<Component>,
    intake: Intake,
    taken: Vec<u32>,
    detector: Detector,
}

/// Where the encoder looked, and what it found there.
#[derive(Clone, Debug)]
pub struct Look {
    /// What it saw.
    pub seen: Picture,
    /// Energies of each tap, of its block's own size.
    pub energies: Vec<EnergyMap>,
    /// The window beside what is nominal, one entry a tap; empty when it cannot be judged.
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

    /// What is known after a frame. Time is the frame's own.
    pub fn step(&mut self, frame: &Frame) -> Verdict {
        let seen = self.sight.see(frame);
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
    /// Has seen nothing. The reference must fit the encoder (`Reference::check_fits`).
    ///
    /// # Errors
    /// When the encoder's state cannot be set up.
    pub fn new(encoder: &Encoder, reference: &Reference) -> Result<Self, EncoderError> {
        let stage = EnergyStage::new(encoder, &reference.model.preprocessing)?;
        let common_size = stage.common_size();
        let detector = Detector::new(reference);
        Ok(Self {
            camera: CameraHealth::default(),
            stage,
            components: reference.components.clone(),
            intake: Intake::new(reference.metric, reference.model.taps.len(), common_size),
            taken: vec![0; detector.taken_len()],
            detector,
        })
    }

    /// Frames may come as slowly as one every `period`.
    pub fn with_frames_every(self, period: Duration) -> Self {
        Self {
            camera: CameraHealth::with_frames_every(period),
            detector: self.detector.with_frames_every(period),
            ..self
        }
    }

    /// What a frame adds to what was seen before.
    pub fn see(&mut self, frame: &Frame) -> Sighting {
        let evidence = self
            .camera
            .check(frame)
            .and_then(|()| self.take(frame))
            .and_then(|()| self.detector.observe(frame.captured_at, &self.taken));
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
            profiles: self.detector.profiles(),
        }
    }

    /// Fills `taken` with what each nominal domain looks at in one frame.
    fn take(&mut self, frame: &Frame) -> Result<(), Undefined> {
        self.stage.energies(frame)?;
        let (maps, means) = (self.stage.maps(), self.stage.means());
        self.intake
            .take(maps, means, &self.components, &mut self.taken)
    }
}
