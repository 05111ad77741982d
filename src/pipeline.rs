//! The whole chain on one screen: a frame in, a verdict out.

use std::time::Duration;

use crate::alarm::{Alarm, AlarmState, Judgement, Reason};
use crate::attention::EnergyMap;
use crate::camera_health::CameraHealth;
use crate::detector::{BlockScore, Detector, Evidence};
use crate::encoder::{Encoder, EncoderError};
use crate::energies::EnergyStage;
use crate::frame::{Frame, Picture};
use crate::image_quality::ImageQuality;
use crate::intake::Intake;
use crate::model::TAPS_MAX;
use crate::profile::TapProfile;
use crate::reference::{Component, Reference};
use crate::undefined::Undefined;

/// Watches one camera against one reference.
pub struct Monitor {
    camera: CameraHealth,
    stage: EnergyStage,
    components: Vec<Component>,
    intake: Intake,
    taken: Vec<u32>,
    detector: Detector,
    alarm: Alarm,
}

/// What is known after a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// Time of the frame.
    pub at: Duration,
    /// Its number; `None` for a verdict that no frame gave.
    pub sequence: Option<u64>,
    /// What the car is told.
    pub state: AlarmState,
    /// Why.
    pub reason: Reason,
    /// Why this frame has no score, in words.
    pub undefined: Option<Undefined>,
    /// The largest score of the blocks: 0 nominal, 1 alarm threshold; `None` when the frame cannot be judged.
    pub score: Option<f64>,
    /// One entry a tap; empty when the frame cannot be judged.
    pub blocks: heapless::Vec<BlockScore, TAPS_MAX>,
    /// How good the picture was; `None` when the frame cannot be judged.
    pub quality: Option<ImageQuality>,
    /// Frames in the detector's window; `None` when the frame cannot be judged.
    pub window_frames: Option<usize>,
    /// The nominal domain that the window lies nearest to, by its place in the reference.
    pub nominal_domain: Option<usize>,
    /// How far scores have added up, 1 is a drift.
    pub drift: Option<f64>,
    /// Share of the detector's window that is filled, 0..1; `None` when the frame cannot be judged.
    pub window_fill: Option<f64>,
    /// Fault detection counter, -128..127.
    pub fault_detection_counter: i8,
    /// A gap was reported since the start.
    pub gap_stored: bool,
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
            alarm: Alarm::default(),
        })
    }

    /// Frames may come as slowly as one every `period`: see [`Alarm::with_frames_every`].
    pub fn with_frames_every(mut self, period: Duration) -> Self {
        self.camera = CameraHealth::with_frames_every(period);
        self.alarm = Alarm::with_frames_every(period);
        self
    }

    /// Frame → energies → histograms → window → score → state. Time is the frame's own.
    pub fn step(&mut self, frame: &Frame) -> Verdict {
        let now = frame.captured_at;
        let evidence = self
            .camera
            .check(frame)
            .and_then(|()| self.take(frame))
            .and_then(|()| self.detector.observe(now, &self.taken));
        self.alarm.step(
            now,
            match &evidence {
                Ok(seen) => seen.judgement(),
                Err(why) => Judgement::Cannot(Reason::from(why)),
            },
        );
        self.verdict(now, Some(frame.sequence), evidence)
    }

    /// Where the encoder looked in the last frame that was judged.
    pub fn look(&self) -> Look {
        Look {
            seen: self.stage.seen(),
            energies: self.stage.maps().to_vec(),
            profiles: self.detector.profiles(),
        }
    }

    fn verdict(
        &self,
        at: Duration,
        sequence: Option<u64>,
        evidence: Result<Evidence, Undefined>,
    ) -> Verdict {
        let (seen, undefined) = match evidence {
            Ok(seen) => (Some(seen), None),
            Err(why) => (None, Some(why)),
        };
        Verdict {
            at,
            sequence,
            state: self.alarm.state(),
            reason: self.alarm.reason(),
            undefined,
            score: seen.as_ref().map(|seen| seen.score),
            quality: seen.is_some().then(|| self.stage.quality()),
            window_frames: seen.as_ref().map(|seen| seen.frames),
            nominal_domain: seen.as_ref().map(|seen| seen.component),
            drift: seen.as_ref().map(|seen| seen.drift),
            window_fill: seen.as_ref().map(|seen| seen.fill),
            blocks: seen.map_or_else(heapless::Vec::new, |seen| seen.blocks),
            fault_detection_counter: self.alarm.fault_detection_counter(),
            gap_stored: self.alarm.gap_stored(),
        }
    }

    /// Clears the stored bit, and says whether it did: refused while there is a gap.
    pub fn clear_stored(&mut self) -> bool {
        self.alarm.clear_stored()
    }

    /// What is known at `now` when the frame before it came too long ago, at the moment that the silence became too long;
    /// `None` while it has not.
    pub fn silence(&mut self, now: Duration) -> Option<Verdict> {
        let at = self
            .alarm
            .stale_at()
            .filter(|&at| at < now && self.alarm.state() != AlarmState::Unavailable)?;
        self.alarm.step(at, Judgement::Cannot(Reason::Stale));
        Some(self.verdict(at, None, Err(Undefined::Silence)))
    }

    /// Fills `taken` with what each nominal domain looks at in one frame.
    fn take(&mut self, frame: &Frame) -> Result<(), Undefined> {
        self.stage.energies(frame)?;
        let (maps, means) = (self.stage.maps(), self.stage.means());
        self.intake
            .take(maps, means, &self.components, &mut self.taken)
    }
}
