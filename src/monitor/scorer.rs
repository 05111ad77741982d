//! What the encoder saw of a frame → evidence: what the nominal domains take of it, and the detector behind.

use std::time::Duration;

use crate::capture::undefined::Undefined;
use crate::features::attention::EnergyMap;
use crate::features::energies::BlockMeans;
use crate::monitor::detector::{Detector, Evidence};
use crate::monitor::extraction::Extraction;
use crate::monitor::profile::TapProfile;
use crate::reference::gap::Metric;
use crate::reference::{Component, Reference};

/// Scores frames against some nominal domains. Keeps its buffers.
pub struct Scorer {
    components: Vec<Component>,
    extraction: Extraction,
    taken: Vec<u32>,
    detector: Detector,
}

impl Scorer {
    /// For frames whose maps are compared at `common_size`.
    pub fn new(reference: &Reference, common_size: (usize, usize)) -> Self {
        let components = reference.components.clone();
        Self::of(
            reference.metric,
            components,
            reference.window_s,
            common_size,
        )
    }

    /// As [`new`](Self::new), of the parts of a reference that count.
    pub fn of(
        metric: Metric,
        components: Vec<Component>,
        window_s: f64,
        common_size: (usize, usize),
    ) -> Self {
        let taps = components.first().map_or(0, |of| of.taps.len());
        let detector = Detector::of(metric, components.clone(), window_s);
        Self {
            extraction: Extraction::new(metric, taps, common_size),
            taken: vec![0; detector.taken_len()],
            components,
            detector,
        }
    }

    /// Frames may come as slowly as one every `period`.
    #[must_use]
    pub fn with_frames_every(self, period: Duration) -> Self {
        Self {
            detector: self.detector.with_frames_every(period),
            ..self
        }
    }

    /// What a frame adds to what was seen before.
    ///
    /// # Errors
    /// Why it cannot be judged.
    pub fn observe(
        &mut self,
        at: Duration,
        maps: &[EnergyMap],
        means: &[BlockMeans],
    ) -> Result<Evidence, Undefined> {
        self.take(maps, means)?;
        self.detect(at)
    }

    /// The first half of [`observe`](Self::observe): what each nominal domain takes of a frame.
    ///
    /// # Errors
    /// Why a domain has no use for it.
    pub fn take(&mut self, maps: &[EnergyMap], means: &[BlockMeans]) -> Result<(), Undefined> {
        self.extraction
            .take(maps, means, &self.components, &mut self.taken)
    }

    /// The second half: what was taken last, against the window.
    ///
    /// # Errors
    /// Why it cannot be judged.
    pub fn detect(&mut self, at: Duration) -> Result<Evidence, Undefined> {
        self.detector.observe(at, &self.taken)
    }

    /// The window beside what is nominal, one entry a tap; empty when it cannot be judged.
    pub fn profiles(&self) -> Vec<TapProfile> {
        self.detector.profiles()
    }
}
