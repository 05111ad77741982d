//! Reference files: what nominal attention looks like, for which model, and from which gap on it is an alarm.
//!
//! A reference is self-describing JSON for people and programs. It carries the fingerprint of the model and its
//! preprocessing, and is refused by any other. Owns reading, checking and writing; it is made by `calibration`.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::capture::undefined::Undefined;
use crate::features::attention::EnergyMap;
use crate::features::energies::BlockMeans;
use crate::features::histogram::Binning;
use crate::files::json_fault::fault;
use crate::files::whole_file::{WholeFile, read_whole};
use crate::model::ModelSpec;
use crate::model::encoder::Encoder;
use crate::model::preprocess::{Preprocessing, RESIZE_KERNEL};
use crate::reference::gap::lane_risk::LaneRisk;
use crate::reference::gap::moments::{EnergyNorm, energy_levels};
use crate::reference::gap::{Comparison, Metric};
use crate::statistics::event_rate::{CountedRate, Loudness};

/// Shortest and longest window of the detector, seconds: it holds 32 frames, which at 10 frames a second is 3 s.
pub const WINDOW_S_MIN: f64 = 0.05;
/// See [`WINDOW_S_MIN`].
pub const WINDOW_S_MAX: f64 = 3.0;
/// Largest gap of a metric that compares histograms: that of a correlation of -1.
const GAP_MAX: f64 = 2.0;
/// Most nominal domains of a reference: each costs a comparison a frame.
pub const COMPONENTS_MAX: usize = 64;
/// Least distance of a threshold from its median.
pub const SPREAD_MIN: f64 = 1e-9;

/// Largest file: four times what all components of the shipped model would take.
pub(crate) const BYTES_MAX: u64 = 64 << 20;
const FORMAT: &str = "gapwatch-reference";
const VERSION: u32 = 4;
/// Most hours and entries of nominal drives that are believed.
const HOURS_MAX: f64 = 1e6;
const ENTRIES_MAX: u64 = 10_000_000;
const BUILT_IN: &str = include_str!("../../calibration/sim.json");

/// What nominal attention looks like to one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    format: String,
    version: u32,
    /// The model that it holds for.
    pub model: ModelFingerprint,
    /// Made of simulation alone, so that any real road is a standing gap. Never of `lane-risk`, which asks what the lane
    /// model loses, not where the road is.
    pub strict: bool,
    /// How gaps are measured.
    pub metric: Metric,
    /// Length of the detector's window, seconds.
    pub window_s: f64,
    /// How often nominal driving enters `Gap`.
    pub false_alarms: FalseAlarms,
    /// Where it came from.
    pub provenance: Provenance,
    /// The domains that are nominal: the simulation first, then what was accepted. The gap is the smallest over them.
    pub components: Vec<Component>,
}

/// One nominal domain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Component {
    /// `simulation`, or the accepted source as typed.
    pub name: String,
    /// One entry a tap, in the order of the model's taps.
    pub taps: Vec<TapReference>,
}

/// Entries into `Gap` on nominal drives, of the whole chain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FalseAlarms {
    /// The rate asked for, entries an hour.
    pub wanted_per_hour: f64,
    /// How the thresholds were found.
    pub method: String,
    /// Factor on all thresholds' distances from their medians that came of it.
    pub factor: f64,
    /// What the factor would be for other rates.
    pub factors: Vec<RateFactor>,
    /// The drives that it was found on.
    pub chosen_on: NominalDrives,
    /// Other drives that it was tried on, if there were any.
    pub judged_on: Option<NominalDrives>,
}

/// The factor that a rate of false alarms asks for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RateFactor {
    /// Entries into `Gap` an hour.
    pub per_hour: f64,
    /// The factor.
    pub factor: f64,
}

/// Entries into `Gap` on a set of nominal drives.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NominalDrives {
    /// Drives in which something could be judged.
    pub drives: u64,
    /// Judged hours in all.
    pub hours: f64,
    /// Entries into `Gap`.
    pub entries: u64,
    /// 95 % interval of the rate an hour (Poisson, exact).
    pub per_hour: (f64, f64),
    /// One-sided 95 % bounds of the rate an hour from resampling drives, in which entries come together; left out where
    /// entries by drive are not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resampled: Option<(f64, f64)>,
}

/// What makes two encoders see alike.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelFingerprint {
    /// Name, for people.
    pub name: String,
    /// Hash of the ONNX file.
    pub sha256: String,
    /// Names of the taps.
    pub taps: Vec<String>,
    /// Size, crop and normalisation.
    pub preprocessing: Preprocessing,
    /// How pictures are resized.
    pub resize: String,
}

/// Where a reference came from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Version of the program.
    pub gapwatch: String,
    /// The command that makes it again.
    pub command: String,
    /// What was looked at.
    pub sources: Vec<SourceUse>,
}

/// One source that a reference was made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SourceUse {
    /// As typed.
    pub source: String,
    /// What it was there for; unknown of references that were made before roles were written.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub role: Option<Role>,
    /// Frames it gave.
    pub frames: u64,
    /// Frames that made the histograms.
    pub fitted: u64,
    /// Frames that made medians and thresholds.
    pub held_out: u64,
}

/// What a source was there for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// The first nominal domain.
    Simulation,
    /// One more nominal domain.
    Accepted,
    /// Sets and judges the rate of false alarms.
    HeldOut,
    /// What the lane model loses is learnt from it.
    Labelled,
}

/// Nominal attention of one tapped block.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TapReference {
    /// Name of the tap.
    pub tap: String,
    /// Median over the images of the largest energy, squared activation units: the scale of this block.
    pub median_peak_energy: f64,
    /// Images looked at.
    pub images: u64,
    /// What they have in common.
    pub nominal: Nominal,
    /// Nominal gaps by the number of frames in the window, fewest first.
    pub scale: Vec<ScalePoint>,
}

/// What is taken of a frame, and what that is on nominal ones.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Nominal {
    /// Pixels by their energy.
    Histogram {
        /// How pixels are counted.
        binning: Binning,
        /// `[bins]`, pixels.
        counts: Vec<u64>,
    },
    /// Energies by channel and by cell.
    Energies(EnergyNorm),
    /// The same, and what the lane model loses with them.
    LaneRisk(LaneRisk),
}

/// Nominal gaps of windows of a number of frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScalePoint {
    /// Frames a window.
    pub frames: usize,
    /// Windows looked at.
    pub windows: usize,
    /// Median gap: score 0.
    pub median: f64,
    /// Alarm threshold: score 1.
    pub threshold: f64,
}

/// A reference that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ReferenceError {
    /// The file cannot be read or written.
    #[error("{}: {error}", path.display())]
    File {
        /// Which file.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// The file is no reference of this version.
    #[error(
        "reference {name}: {found}; wanted {FORMAT} version {VERSION} as written by gapwatch calibrate"
    )]
    Malformed {
        /// File or built-in name.
        name: String,
        /// What was found.
        found: String,
    },
    /// It was made for another model or another way of feeding it.
    #[error(
        "reference {name} does not fit the model in use: {what} is {found}, the reference was made with {wanted}; calibrate one for this model, or name its model"
    )]
    OtherModel {
        /// File or built-in name.
        name: String,
        /// Which part differs.
        what: &'static str,
        /// Of the model in use.
        found: String,
        /// Of the reference.
        wanted: String,
    },
}

impl FalseAlarms {
    /// What the judging drives say of the rate asked for; without any it is not shown.
    pub fn loudness(&self) -> Loudness {
        self.judged_rate().loudness(self.wanted_per_hour)
    }

    /// The same in words, with the bound that it rests on, or with what is missing.
    pub fn said(&self) -> String {
        self.judged_rate().said(self.wanted_per_hour)
    }

    /// What is missing before the rate is shown not to be louder than asked; `None` when nothing is missing.
    pub fn missing(&self) -> Option<String> {
        self.judged_rate().missing(self.wanted_per_hour)
    }

    fn judged_rate(&self) -> CountedRate {
        let on = self.judged_on.as_ref();
        on.map_or(CountedRate::new(0, 0.0, None), |on| {
            CountedRate::new(on.entries, on.hours, on.resampled)
        })
    }

    fn fault(&self) -> Option<String> {
        let wanted = self.wanted_per_hour;
        if !(wanted.is_finite() && wanted > 0.0) {
            return Some(format!("{wanted} false alarms an hour wanted"));
        }
        let mut drives = std::iter::once(&self.chosen_on).chain(&self.judged_on);
        drives.find_map(|on| {
            let (low, high) = on.resampled.unwrap_or_default();
            let usable = (0.0..=HOURS_MAX).contains(&on.hours)
                && on.entries <= ENTRIES_MAX
                && (0.0..=high).contains(&low)
                && high.is_finite();
            (!usable).then(|| format!("false alarms: {} entries in {} hours", on.entries, on.hours))
        })
    }
}

impl ModelFingerprint {
    /// The fingerprint of a loaded model.
    pub fn new(spec: &ModelSpec, encoder: &Encoder) -> Self {
        Self {
            name: Path::new(&spec.name)
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned(),
            sha256: encoder.sha256().to_owned(),
            taps: spec.taps.clone(),
            preprocessing: spec.preprocessing.clone(),
            resize: RESIZE_KERNEL.to_owned(),
        }
    }

    /// The first part in which another model sees otherwise: what it is, here and there. Names do not matter.
    pub fn difference(&self, other: &Self) -> Option<(&'static str, String, String)> {
        let parts = [
            ("hash", self.sha256.clone(), other.sha256.clone()),
            ("taps", self.taps.join(","), other.taps.join(",")),
            (
                "preprocessing",
                self.preprocessing.to_string(),
                other.preprocessing.to_string(),
            ),
            ("resize kernel", self.resize.clone(), other.resize.clone()),
        ];
        parts.into_iter().find(|(_, ours, theirs)| ours != theirs)
    }
}

impl Reference {
    /// A reference of this version.
    pub fn new(
        model: ModelFingerprint,
        metric: Metric,
        window_s: f64,
        false_alarms: FalseAlarms,
        provenance: Provenance,
        components: Vec<Component>,
    ) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            model,
            strict: is_strict(metric, &components),
            metric,
            window_s,
            false_alarms,
            provenance,
            components,
        }
    }

    /// Reads a file, or the reference inside the program, and checks that it is whole.
    ///
    /// # Errors
    /// When it cannot be read or is malformed.
    pub fn read(file: Option<&Path>) -> Result<Self, ReferenceError> {
        match file {
            None => Self::parse("built-in", BUILT_IN),
            Some(path) => {
                let text = read_whole(path, BYTES_MAX).map_err(|error| ReferenceError::File {
                    path: path.to_owned(),
                    error,
                })?;
                Self::parse(&path.display().to_string(), &String::from_utf8_lossy(&text))
            }
        }
    }

    fn parse(name: &str, text: &str) -> Result<Self, ReferenceError> {
        let malformed = |found: String| ReferenceError::Malformed {
            name: name.to_owned(),
            found,
        };
        let value: serde_json::Value =
            serde_json::from_str(text).map_err(|error| malformed(fault(&error)))?;
        let (format, version) = (&value["format"], &value["version"]);
        if format == FORMAT && version.as_u64().is_some_and(|of| of < VERSION.into()) {
            return Err(malformed(format!(
                "version {version}, of an older gapwatch; make it again with the command under provenance in it"
            )));
        }
        if format != FORMAT || version != VERSION {
            return Err(malformed(format!("format {format}, version {version}")));
        }
        // Of the text, since a value does not know its lines.
        let reference: Self =
            serde_json::from_str(text).map_err(|error| malformed(fault(&error)))?;
        match reference.fault() {
            Some(fault) => Err(malformed(fault)),
            None => Ok(reference),
        }
    }

    fn fault(&self) -> Option<String> {
        if !(WINDOW_S_MIN..=WINDOW_S_MAX).contains(&self.window_s) {
            return Some(format!(
                "a window of {} s, not {WINDOW_S_MIN} to {WINDOW_S_MAX}",
                self.window_s
            ));
        }
        if self.components.is_empty() || self.components.len() > COMPONENTS_MAX {
            return Some(format!(
                "{} components, not 1 to {COMPONENTS_MAX}",
                self.components.len()
            ));
        }
        if self.strict != is_strict(self.metric, &self.components) {
            return Some(format!(
                "strict = {} beside {} components",
                self.strict,
                self.components.len()
            ));
        }
        if let Some(fault) = self.false_alarms.fault() {
            return Some(fault);
        }
        self.components.iter().find_map(|component| {
            let names: Vec<&String> = component.taps.iter().map(|t| &t.tap).collect();
            if names.is_empty() || names != self.model.taps.iter().collect::<Vec<_>>() {
                return Some(format!(
                    "{}: taps {names:?} beside a model with taps {:?}",
                    component.name, self.model.taps
                ));
            }
            component.taps.iter().find_map(|tap| {
                tap.fault(self.metric)
                    .map(|fault| format!("{}, tap {}: {fault}", component.name, tap.tap))
            })
        })
    }

    /// Refuses a model that the reference was not made with.
    ///
    /// # Errors
    /// `OtherModel` with the first part that differs.
    pub fn check_fits(&self, name: &str, model: &ModelFingerprint) -> Result<(), ReferenceError> {
        match self.model.difference(model) {
            None => Ok(()),
            Some((what, wanted, found)) => Err(ReferenceError::OtherModel {
                name: name.to_owned(),
                what,
                found,
                wanted,
            }),
        }
    }

    /// The file's text: pretty JSON, arrays of numbers on few lines.
    pub fn to_json(&self) -> String {
        super::pretty::to_json(self)
    }

    /// Writes the file whole or not at all.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), ReferenceError> {
        let failed = |error| ReferenceError::File {
            path: path.to_owned(),
            error,
        };
        let mut file = WholeFile::create(path).map_err(failed)?;
        file.write_all(self.to_json().as_bytes()).map_err(failed)?;
        file.finish().map_err(failed)
    }

    /// One byte that tells references apart on the bus: the first of the hash of the file's text.
    pub fn id(&self) -> u8 {
        Sha256::digest(self.to_json().as_bytes())[0]
    }
}

impl Component {
    /// Numbers that some domains take of a frame.
    pub fn taken_len(components: &[Self]) -> usize {
        let taps = components.iter().flat_map(|component| &component.taps);
        taps.map(|tap| tap.nominal.len()).sum()
    }
}

fn is_strict(metric: Metric, components: &[Component]) -> bool {
    components.len() == 1 && metric != Metric::LaneRisk
}

impl TapReference {
    fn fault(&self, metric: Metric) -> Option<String> {
        if self.images == 0 {
            return Some("made of no images".to_owned());
        }
        if !(self.median_peak_energy.is_finite() && self.median_peak_energy > 0.0) {
            return Some(format!(
                "a median peak energy of {}",
                self.median_peak_energy
            ));
        }
        if let Some(fault) = self.nominal.fault(metric) {
            return Some(fault);
        }
        let rising = self
            .scale
            .windows(2)
            .all(|pair| pair[0].frames < pair[1].frames);
        let largest = match self.nominal {
            Nominal::Histogram { .. } => 2.0 * GAP_MAX,
            Nominal::Energies(_) | Nominal::LaneRisk(_) => f64::MAX,
        };
        let least = match self.nominal {
            // A forecast: a little below 0 on an easy road.
            Nominal::LaneRisk(_) => f64::MIN,
            _ => -1e-9,
        };
        let usable = |p: &ScalePoint| {
            let in_range = |gap: f64| (least..=largest).contains(&gap);
            p.frames > 0
                && in_range(p.median)
                && p.threshold.is_finite()
                && p.threshold - p.median >= 0.5 * SPREAD_MIN
        };
        if self.scale.is_empty() || !rising || !self.scale.iter().all(usable) {
            return Some(
                "a scale without rising frame counts and medians below thresholds".to_owned(),
            );
        }
        None
    }

    /// Median and threshold for windows of `frames`, linear in `1 / frames` between the points of the scale: the gap of
    /// an average of `n` histograms falls as `1 / n` towards that of infinitely many.
    #[allow(clippy::cast_precision_loss)]
    pub fn scale_for(&self, frames: usize) -> (f64, f64) {
        let next = self
            .scale
            .partition_point(|point| point.frames < frames)
            .min(self.scale.len() - 1);
        let (low, high) = (self.scale[next.saturating_sub(1)], self.scale[next]);
        if low.frames == high.frames {
            return (high.median, high.threshold);
        }
        let inverse = |frames: usize| 1.0 / frames as f64;
        let frames = frames.clamp(low.frames, high.frames);
        let share =
            (inverse(low.frames) - inverse(frames)) / (inverse(low.frames) - inverse(high.frames));
        (
            low.median + share * (high.median - low.median),
            low.threshold + share * (high.threshold - low.threshold),
        )
    }
}

impl Nominal {
    /// Numbers that are taken of a frame: bins or energies.
    pub fn len(&self) -> usize {
        match self {
            Self::Histogram { counts, .. } => counts.len(),
            Self::Energies(norm) => norm.energies(),
            Self::LaneRisk(risk) => risk.mean.len(),
        }
    }

    /// Whether nothing is taken of a frame; never of a reference that was read whole.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Takes one block of a frame: `common` is its energy map at the common size, `taken` `[len]`. Allocates nothing.
    ///
    /// # Errors
    /// `ConstantMap` when the map says nothing, `EnergyCount` when the block has other channels than the reference.
    pub fn take(
        &self,
        common: &EnergyMap,
        means: &BlockMeans,
        taken: &mut [u32],
    ) -> Result<(), Undefined> {
        match self {
            Self::Histogram { binning, .. } => {
                taken.fill(0);
                binning.count(common, taken)
            }
            Self::Energies(EnergyNorm { epsilon, .. })
            | Self::LaneRisk(LaneRisk { epsilon, .. }) => {
                if means.energy.len() != taken.len() {
                    return Err(Undefined::EnergyCount {
                        found: means.energy.len(),
                        wanted: taken.len(),
                    });
                }
                energy_levels(&means.energy, *epsilon, taken);
                Ok(())
            }
        }
    }

    /// Compares the sum over a window of `frames` frames with the nominal ones.
    ///
    /// # Errors
    /// Why there is no value.
    pub fn compare(
        &self,
        metric: Metric,
        sums: &[u64],
        frames: usize,
    ) -> Result<Comparison, Undefined> {
        match self {
            Self::Histogram { counts, .. } => metric
                .divergence()
                .ok_or(Undefined::NoScore)?
                .compare(sums, counts),
            Self::Energies(norm) => {
                let distance = norm.distance(sums, frames);
                Ok(Comparison {
                    value: distance,
                    gap: distance,
                    similarity: 1.0 / (1.0 + distance),
                })
            }
            Self::LaneRisk(risk) => {
                let loss = risk.loss(sums, frames);
                Ok(Comparison {
                    value: loss,
                    gap: loss,
                    similarity: 1.0 - loss,
                })
            }
        }
    }

    fn fault(&self, metric: Metric) -> Option<String> {
        match (self, metric) {
            (Self::Energies(norm), Metric::Mahalanobis) => norm.fault(),
            (Self::LaneRisk(risk), Metric::LaneRisk) => risk.fault(),
            (
                Self::Histogram {
                    binning: binning @ Binning::LogEnergy { .. },
                    counts,
                },
                Metric::LogEnergy(_),
            )
            | (
                Self::Histogram {
                    binning: binning @ Binning::Attention { .. },
                    counts,
                },
                Metric::Attention(_) | Metric::Paper,
            ) => {
                if let Some(fault) = binning.fault() {
                    return Some(fault.to_owned());
                }
                if counts.len() != binning.bins() {
                    return Some(format!(
                        "{} counts for {} bins",
                        counts.len(),
                        binning.bins()
                    ));
                }
                counts
                    .iter()
                    .try_fold(0_u64, |sum, &n| sum.checked_add(n))
                    .is_none_or(|sum| sum == 0)
                    .then(|| "counts that do not add up".to_owned())
            }
            _ => Some(format!("nominal values of another kind than {metric} has")),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::reference::gap::Divergence;

    const LOG_ENERGY: Metric = Metric::LogEnergy(Divergence::JensenShannon);

    fn histogram(counts: Vec<u64>) -> Nominal {
        Nominal::Histogram {
            binning: Binning::LogEnergy {
                epsilon: 1e-6,
                edges: vec![0.0],
            },
            counts,
        }
    }

    fn tap(scale: &[(usize, f64, f64)]) -> TapReference {
        TapReference {
            tap: "e2".into(),
            median_peak_energy: 5.0,
            images: 1,
            nominal: histogram(vec![1, 2]),
            scale: scale
                .iter()
                .map(|&(frames, median, threshold)| ScalePoint {
                    frames,
                    windows: 9,
                    median,
                    threshold,
                })
                .collect(),
        }
    }

    #[test]
    fn the_scale_between_two_points_is_linear_in_one_over_frames() {
        let tap = tap(&[(1, 1.0, 2.0), (2, 0.5, 1.0), (10, 0.1, 0.2)]);
        for (frames, median) in [
            (1, 1.0),
            (2, 0.5),
            (4, 0.25),
            (5, 0.2),
            (10, 0.1),
            (30, 0.1),
        ] {
            let (found, threshold) = tap.scale_for(frames);
            assert!(
                (found - median).abs() < 1e-12 && (threshold - 2.0 * median).abs() < 1e-12,
                "{frames}: {found}"
            );
        }
    }

    #[test]
    fn malformed_references_are_refused_by_name() {
        for (text, part) in [
            ("", "not JSON"),
            ("{}", "format null"),
            (
                "{\"format\": \"gapwatch-reference\", \"version\": 1}",
                "version 1",
            ),
            (
                "{\"format\": \"gapwatch-reference\", \"version\": 3}",
                "make it again with the command",
            ),
            (
                "{\"format\": \"gapwatch-reference\", \"version\": 4}",
                "no \"model\" at line 1",
            ),
        ] {
            let said = Reference::parse("r.json", text).unwrap_err().to_string();
            assert!(said.contains(part) && said.contains("r.json"), "{said}");
        }
        assert!(tap(&[]).fault(LOG_ENERGY).unwrap().contains("scale"));
        assert!(
            tap(&[(1, 2.0, 1.0)])
                .fault(LOG_ENERGY)
                .unwrap()
                .contains("scale")
        );
        assert!(
            TapReference {
                nominal: histogram(vec![0, 0]),
                ..tap(&[(1, 1.0, 2.0)])
            }
            .fault(LOG_ENERGY)
            .unwrap()
            .contains("counts")
        );
        assert!(
            TapReference {
                nominal: histogram(vec![u64::MAX, 1]),
                ..tap(&[(1, 1.0, 2.0)])
            }
            .fault(LOG_ENERGY)
            .is_some()
        );
        assert_eq!(tap(&[(1, 1.0, 2.0)]).fault(LOG_ENERGY), None);
    }

    #[test]
    fn counts_of_false_alarms_that_no_drive_has_are_refused() {
        let reference = Reference::read(None).unwrap();
        let changes: [fn(&mut FalseAlarms); 5] = [
            |of| of.wanted_per_hour = 0.0,
            |of| of.chosen_on.hours = -1.0,
            |of| of.chosen_on.entries = u64::MAX,
            |of| of.chosen_on.resampled = Some((2.0, 1.0)),
            |of| of.judged_on.as_mut().unwrap().hours = 1e300,
        ];
        for change in changes {
            let mut changed = reference.clone();
            change(&mut changed.false_alarms);
            let refused = Reference::parse("r.json", &changed.to_json()).unwrap_err();
            assert!(refused.to_string().contains("false alarms"), "{refused}");
        }
    }

    #[test]
    fn the_built_in_reference_is_read_and_written_without_loss() {
        let reference = Reference::read(None).unwrap();
        assert_eq!(reference.to_json(), BUILT_IN);
    }
}
