//! What the encoder saw of a frame → evidence: what the nominal domains take from it, and then the detector.

use std::time::Duration;

use crate::capture::undefined::Undefined;
use crate::features::attention::EnergyMap;
use crate::features::energies::BlockMeans;
use crate::monitor::detector::{Detector, Evidence};
use crate::monitor::extraction::Extraction;
use crate::monitor::profile::TapProfile;
use crate::monitor::warn::WarnOn;
use crate::reference::gap::Metric;
use crate::reference::{Component, Explained, Reference};

/// Compares frames with some nominal domains. Keeps its buffers.
pub struct Scorer {
    components: Vec<Component>,
    extraction: Extraction,
    taken: Vec<u32>,
    detector: Detector,
}

impl Scorer {
    /// For frames whose maps are compared at `common_size`.
    pub fn new(reference: &Reference, common_size: (usize, usize)) -> Self {
        let detector = Detector::new(reference);
        Self::with(
            detector,
            reference.metric,
            reference.components.clone(),
            common_size,
        )
    }

    /// Like [`new`](Self::new), from the relevant parts of a reference.
    pub fn of(
        metric: Metric,
        components: Vec<Component>,
        window_s: f64,
        common_size: (usize, usize),
    ) -> Self {
        let detector = Detector::of(metric, components.clone(), window_s);
        Self::with(detector, metric, components, common_size)
    }

    fn with(
        detector: Detector,
        metric: Metric,
        components: Vec<Component>,
        common_size: (usize, usize),
    ) -> Self {
        let taps = components.first().map_or(0, |of| of.taps.len());
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

    /// See [`Detector::warning_on`].
    #[must_use]
    pub fn warning_on(self, warn: WarnOn) -> Self {
        Self {
            detector: self.detector.warning_on(warn),
            ..self
        }
    }

    /// What a frame adds to what was seen before.
    ///
    /// # Errors
    /// Why the frame cannot be judged.
    pub fn observe(
        &mut self,
        at: Duration,
        maps: &[EnergyMap],
        means: &[BlockMeans],
    ) -> Result<Evidence, Undefined> {
        self.take(maps, means)?;
        self.detect(at)
    }

    /// The first half of [`observe`](Self::observe): what each nominal domain takes from a frame.
    ///
    /// # Errors
    /// Why a domain cannot use the frame.
    pub fn take(&mut self, maps: &[EnergyMap], means: &[BlockMeans]) -> Result<(), Undefined> {
        self.extraction
            .take(maps, means, &self.components, &mut self.taken)
    }

    /// The second half: adds what was taken last to the window, and compares the window with the reference.
    ///
    /// # Errors
    /// Why the frame cannot be judged.
    pub fn detect(&mut self, at: Duration) -> Result<Evidence, Undefined> {
        self.detector.observe(at, &self.taken)
    }

    /// See [`Detector::deviation`].
    pub fn deviation(&mut self, explained: Explained, domain: usize) -> Option<&[f64]> {
        self.detector.deviation(explained, domain)
    }

    /// The window beside what is nominal, one entry for each tap; empty if it cannot be judged.
    pub fn profiles(&self) -> Vec<TapProfile> {
        self.detector.profiles()
    }
}
