//! What the nominal domains of a reference take from one frame: counts of pixels, or levels of energies.

use crate::capture::undefined::Undefined;
use crate::features::attention::{EnergyMap, Upsampler};
use crate::features::energies::BlockMeans;
use crate::reference::Component;
use crate::reference::gap::Metric;

/// Extracts from frames what some nominal domains need. Keeps its buffers.
pub struct Extraction {
    /// Energy maps are needed, not only means.
    needs_maps: bool,
    /// Size that maps are resampled to, width and height.
    common_size: (usize, usize),
    /// One for each tap, when the sizes of the maps are known.
    upsamplers: Vec<Upsampler>,
    /// Energy maps at the common size, one for each tap.
    common: Vec<EnergyMap>,
}

impl Extraction {
    /// For frames of `taps` blocks whose maps are compared at `common_size`.
    pub fn new(metric: Metric, taps: usize, common_size: (usize, usize)) -> Self {
        Self {
            needs_maps: metric.divergence().is_some(),
            common_size,
            upsamplers: Vec::new(),
            common: vec![EnergyMap::default(); taps],
        }
    }

    /// Fills `taken` (for each domain, tap after tap) from a frame's maps, at the sizes of their blocks, and from its
    /// means.
    ///
    /// # Errors
    /// Why a domain cannot use the frame.
    pub fn take(
        &mut self,
        maps: &[EnergyMap],
        means: &[BlockMeans],
        components: &[Component],
        mut taken: &mut [u32],
    ) -> Result<(), Undefined> {
        if self.needs_maps {
            if self.upsamplers.is_empty() {
                let sizes = maps.iter().map(|map| (map.width, map.height));
                self.upsamplers = sizes
                    .map(|from| Upsampler::new(from, self.common_size))
                    .collect();
            }
            let resampled = self.upsamplers.iter().zip(&mut self.common);
            for (map, (upsampler, common)) in maps.iter().zip(resampled) {
                upsampler.resample(map, common);
            }
        }
        for component in components {
            let blocks = self.common.iter().zip(means);
            for (tap, (common, means)) in component.taps.iter().zip(blocks) {
                let (own, rest) = taken.split_at_mut(tap.nominal.len());
                tap.nominal.take(common, means, own)?;
                taken = rest;
            }
        }
        Ok(())
    }
}
