//! How good the monitor is on drives that were not used for tuning (`domain_detection`, `false_alarms`, `cause`,
//! `lane_failure`)
//! and on image sets of other roads (`field_sets`, `paper_table`). This file measures how good a lane model is, and
//! where it looks, on scenes that were not used for training, with all looks of the world and with conditions of
//! increasing severity.
//!
//! Intervals are percentiles over resampled scenes, because the pixels of one scene depend on each other.

pub mod cause;
pub mod domain_detection;
pub mod false_alarms;
pub mod field_sets;
pub mod lane_failure;
pub mod paper_table;
mod ranking;
pub mod real_lanes;
mod resampling;
pub mod scripts;
pub mod separation;
pub mod speed_error;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::capture::Picture;
use crate::capture::pixels::Pixels;
use crate::capture::undefined::Undefined;
use crate::features::attention::{EnergyMap, Upsampler};
use crate::features::energies::EnergyStage;
use crate::features::lane::{LaneMask, Overlap, energy_on_lanes};
use crate::lab::scene::{Condition, ConditionKind, Drive, Look, Renderer, World, scene_moment};
use crate::model::ModelSpec;
use crate::model::encoder::{Encoder, EncoderError};
use crate::statistics::quantile::median;

pub use resampling::binomial_interval;
use resampling::interval;

/// The scene set on which models are measured. Training, validation and test of the trainer use other sets.
pub const SCENE_SET: u32 = 4004;

/// One setting in which a model is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// The world.
    pub world: World,
    /// Its condition; `None` = a plain day.
    pub condition: Option<Condition>,
}

impl Setting {
    /// Every look on a plain day, and under every condition with severities 1 to 5.
    pub fn all() -> Vec<Self> {
        Look::ALL
            .into_iter()
            .flat_map(|look| {
                let graded = ConditionKind::ALL
                    .into_iter()
                    .flat_map(|kind| (1..=5_u8).map(move |severity| Some((kind, severity))));
                std::iter::once(None)
                    .chain(graded)
                    .map(move |condition| Self {
                        world: World::of(look),
                        condition: condition.map(|(kind, severity)| Condition {
                            kind,
                            severity: f32::from(severity),
                            span_s: None,
                        }),
                    })
            })
            .collect()
    }
}

/// How good a model is in one setting.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LaneIou {
    /// The model.
    pub model: String,
    /// Look of the world.
    pub look: String,
    /// Kind of condition, or `none`.
    pub condition: String,
    /// Its severity, 0 to 5.
    pub severity: f32,
    /// Number of scenes.
    pub scenes: usize,
    /// Number of scenes that cannot be given to the model, for example because they are black. They count as if the
    /// model had seen no lane.
    pub unjudged: usize,
    /// Intersection over union, pooled over all pixels of all scenes; `None` if there is no lane at all.
    pub iou: Option<f64>,
    /// Its 95 % interval, from resampling scenes.
    pub interval: Option<(f64, f64)>,
    /// Where the encoder looks, for each tap.
    pub attention: Vec<LaneAttention>,
}

/// How much of one tap's energy is on lanes.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LaneAttention {
    /// Name of the tap.
    pub tap: String,
    /// Median over the scenes of the largest energy.
    pub peak_energy: Option<f64>,
    /// Median share of the energy that is on lanes.
    pub on_lanes: Option<f64>,
    /// Median of that share as a multiple of the lanes' share of the picture; 1 = the energy does not depend on lanes.
    pub lift: Option<f64>,
}

/// The results of one scene.
struct Answer {
    setting: usize,
    overlap: Overlap,
    judged: bool,
    /// One entry for each tap; empty if the scene could not be judged.
    attention: Vec<TapAttention>,
}

/// Where one tap looks in one scene.
struct TapAttention {
    peak_energy: f64,
    /// Share of its energy on lanes; `None` for a scene without lanes.
    on_lanes: Option<f64>,
    /// Share of the picture that is lane.
    area: f64,
}

/// Measures a model on `scenes` scenes of every setting; `seen` is called after each scene.
///
/// # Errors
/// When the encoder cannot be run at all.
pub fn lane_iou(
    spec: &ModelSpec,
    encoder: &Encoder,
    settings: &[Setting],
    scenes: u32,
    seen: &(dyn Fn() + Sync),
) -> Result<Vec<LaneIou>, EncoderError> {
    let jobs: Vec<(usize, u32)> = (0..settings.len())
        .flat_map(|setting| (0..scenes).map(move |index| (setting, index)))
        .collect();
    let answers = jobs
        .into_par_iter()
        .map_init(
            || Judge::new(spec, encoder),
            |judge, (setting, index)| {
                let judge = judge.as_mut().map_err(|error| error.to_string())?;
                let answer = judge.answer(setting, &settings[setting], index);
                seen();
                Ok(answer)
            },
        )
        .collect::<Result<Vec<_>, String>>()
        .map_err(|why| EncoderError::Onnx {
            model: spec.name.clone(),
            why,
        })?;
    Ok(settings
        .iter()
        .enumerate()
        .map(|(index, setting)| {
            let of: Vec<&Answer> = answers.iter().filter(|a| a.setting == index).collect();
            summary(spec, setting, &of)
        })
        .collect())
}

/// What one thread needs to render scenes and to run the model on them.
struct Judge {
    renderer: Renderer,
    stage: EnergyStage,
    /// One for each tap, when the sizes of the maps are known.
    upsamplers: Vec<Upsampler>,
    size: (u32, u32),
}

impl Judge {
    fn new(spec: &ModelSpec, encoder: &Encoder) -> Result<Self, EncoderError> {
        let size = (spec.preprocessing.width, spec.preprocessing.height);
        Ok(Self {
            renderer: Renderer::new(size.0, size.1),
            stage: EnergyStage::new(encoder, &spec.preprocessing)?,
            upsamplers: Vec::new(),
            size,
        })
    }

    fn answer(&mut self, setting: usize, of: &Setting, index: u32) -> Answer {
        let (seed, t_s) = scene_moment(SCENE_SET, index);
        let conditions: Vec<Condition> = of.condition.into_iter().collect();
        let scene = self
            .renderer
            .render(&Drive::new(&of.world, seed, &conditions), t_s);
        let picture = Picture {
            width: self.size.0,
            height: self.size.1,
            rgb: scene.rgb.to_vec(),
        };
        let truth = LaneMask::of_labels(self.size.0 as usize, scene.mask);
        let attention = self.attention(&picture.into(), &truth);
        let answer = attention.as_ref().ok().and(self.stage.lane());
        Answer {
            setting,
            overlap: Overlap::of(answer, &truth),
            judged: attention.is_ok(),
            attention: attention.unwrap_or_default(),
        }
    }

    /// Where the encoder looks in one picture, for each tap.
    fn attention(
        &mut self,
        pixels: &Pixels,
        truth: &LaneMask,
    ) -> Result<Vec<TapAttention>, Undefined> {
        let area = truth.area();
        let common_size = self.stage.common_size();
        let maps = self.stage.energies_of(pixels)?;
        if self.upsamplers.is_empty() {
            let sizes = maps.iter().map(|map| (map.width, map.height));
            self.upsamplers = sizes
                .map(|from| Upsampler::new(from, common_size))
                .collect();
        }
        let mut common = EnergyMap::default();
        let taps = maps.iter().zip(&self.upsamplers).map(|(map, upsampler)| {
            upsampler.resample(map, &mut common);
            let on_lanes = energy_on_lanes(&common, truth);
            TapAttention {
                peak_energy: map.range().1,
                on_lanes: on_lanes.filter(|_| area > 0.0),
                area,
            }
        });
        Ok(taps.collect())
    }
}

fn summary(spec: &ModelSpec, setting: &Setting, answers: &[&Answer]) -> LaneIou {
    let overlaps: Vec<Overlap> = answers.iter().map(|a| a.overlap).collect();
    let taps = spec.taps.iter().enumerate();
    LaneIou {
        model: spec.name.clone(),
        look: setting.world.look.name().to_owned(),
        condition: setting
            .condition
            .map_or("none", |c| c.kind.name())
            .to_owned(),
        severity: setting.condition.map_or(0.0, |c| c.severity),
        scenes: answers.len(),
        unjudged: answers.iter().filter(|a| !a.judged).count(),
        iou: Overlap::iou(overlaps.iter().copied()),
        interval: interval(&overlaps),
        attention: taps
            .map(|(index, tap)| {
                let of: Vec<&TapAttention> = answers
                    .iter()
                    .filter_map(|answer| answer.attention.get(index))
                    .collect();
                LaneAttention {
                    tap: tap.clone(),
                    peak_energy: median(of.iter().map(|a| a.peak_energy).collect()),
                    on_lanes: median(of.iter().filter_map(|a| a.on_lanes).collect()),
                    lift: median(
                        of.iter()
                            .filter_map(|a| Some(a.on_lanes? / a.area))
                            .collect(),
                    ),
                }
            })
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::model::ModelOptions;

    #[test]
    fn severe_fog_costs_the_built_in_model_lanes() {
        let spec = ModelSpec::new(None, ModelOptions::default()).unwrap();
        let encoder = Encoder::load_with_lane(&spec).unwrap();
        let settings = [None, Some("fog:5".parse().unwrap())].map(|condition| Setting {
            world: World::default(),
            condition,
        });
        let [clear, fog] = &lane_iou(&spec, &encoder, &settings, 12, &|| {}).unwrap()[..] else {
            panic!("two settings, two answers");
        };
        assert_eq!((&*clear.condition, &*fog.condition), ("none", "fog"));
        assert!(clear.iou.unwrap() > 0.75, "{clear:?}");
        assert!(fog.iou.unwrap() < 0.8 * clear.iou.unwrap(), "{fog:?}");
        let (low, high) = clear.interval.unwrap();
        assert!(low <= clear.iou.unwrap() && clear.iou.unwrap() <= high);
    }
}
