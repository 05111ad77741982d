//! Reference files: what nominal attention looks like, for which model, and from which gap on there is an alarm.
//!
//! A reference is self-describing JSON for people and programs. It carries the fingerprint of the model and its
//! preprocessing, and cannot be used with any other. This module reads, checks and writes it; `calibration` makes it.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::files::json_fault::fault;
use crate::files::shell::quoted;
use crate::files::whole_file::{WholeFile, read_text};
use crate::model::ModelSpec;
use crate::model::encoder::Encoder;
use crate::model::preprocess::{Preprocessing, RESIZE_KERNEL};
use crate::reference::causes::Causes;
use crate::reference::gap::Metric;
use crate::reference::lanes::LaneForecast;
use crate::reference::nominal::TapReference;
use crate::reference::rate::JudgedRate;
use crate::reference::span::EvidenceKind;
use crate::statistics::event_rate::{CountedRate, Loudness};

/// Shortest window of the detector, seconds. The longest one holds 32 frames, which is about 3 s at 10 frames a second.
pub const WINDOW_S_MIN: f64 = 0.05;
/// See [`WINDOW_S_MIN`].
pub const WINDOW_S_MAX: f64 = 3.0;
/// Largest number of nominal domains of a reference: each one costs a comparison for each frame.
pub const COMPONENTS_MAX: usize = 64;
/// Largest file: four times the size of a file with all components for the shipped model.
pub(crate) const BYTES_MAX: u64 = 64 << 20;
const FORMAT: &str = "gapwatch-reference";
const VERSION: u32 = 5;
/// Largest number of hours and entries of nominal drives that is accepted.
const HOURS_MAX: f64 = 1e6;
const ENTRIES_MAX: u64 = 10_000_000;
const BUILT_IN: &str = include_str!("../../calibration/sim.json");

/// What nominal attention looks like to one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    format: String,
    version: u32,
    /// The model for which it was made.
    pub model: ModelFingerprint,
    /// Whether it is made of simulation alone, so that any real road is always a gap. Never true for `lane-risk`, which
    /// forecasts what the lane model loses on any road.
    pub strict: bool,
    /// Metric that measures the gap.
    pub metric: Metric,
    /// Length of the detector's window, seconds.
    pub window_s: f64,
    /// What the road is judged by.
    pub evidence: EvidenceKind,
    /// How often the road is judged: the thresholds are made for this rate.
    pub rate: JudgedRate,
    /// How often nominal driving enters `Gap`.
    pub false_alarms: FalseAlarms,
    /// How it was made.
    pub provenance: Provenance,
    /// Commands that made the references to which accepted roads were added, one after the other, oldest first; the command in
    /// `provenance` added the last ones.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub built_on: Vec<String>,
    /// The domains that are nominal: the simulation first, then what was accepted. The gap is the smallest one over
    /// these domains.
    pub components: Vec<Component>,
    /// What changes and gaps look like under known causes; left out if none were learnt.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub causes: Option<Causes>,
    /// What share of its lanes the model is forecast to lose; left out if no labelled drives were given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lanes: Option<LaneForecast>,
}

/// One nominal domain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Component {
    /// `simulation`, or the name of an accepted domain.
    pub name: String,
    /// One entry for each tap, in the order of the model's taps.
    pub taps: Vec<TapReference>,
}

/// Entries into `Gap` on nominal drives, of the whole chain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FalseAlarms {
    /// The rate that was asked for, entries an hour.
    pub wanted_per_hour: f64,
    /// How the thresholds were found.
    pub method: String,
    /// The result: a factor on the distances of all thresholds from their medians.
    pub factor: f64,
    /// What the factor would be for other rates.
    pub factors: Vec<RateFactor>,
    /// The drives on which the factor was set.
    pub chosen_on: NominalDrives,
    /// Other drives on which it was judged, if there were any.
    pub judged_on: Option<NominalDrives>,
}

/// The factor for a rate of false alarms.
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
    /// Total of judged hours.
    pub hours: f64,
    /// Entries into `Gap`.
    pub entries: u64,
    /// 95 % interval of the rate an hour (Poisson, exact).
    pub per_hour: (f64, f64),
    /// One-sided 95 % bounds of the rate an hour from resampling drives, because entries of a drive depend on each
    /// other; left out if the entries of each drive are not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resampled: Option<(f64, f64)>,
}

/// What two encoders must have in common to see the same.
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

/// How a reference was made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Version of the program.
    pub gapwatch: String,
    /// The command that makes it again.
    pub command: String,
    /// The sources from which it was made.
    pub sources: Vec<SourceUse>,
}

/// One source that a reference was made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SourceUse {
    /// As typed.
    pub source: String,
    /// Its role; unknown in references that were made before roles were written.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub role: Option<Role>,
    /// Name of the accepted domain to which it belongs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub domain: Option<String>,
    /// Number of its frames.
    pub frames: u64,
    /// Frames that made means and covariances, or histograms.
    pub fitted: u64,
    /// Frames that made medians and thresholds.
    pub held_out: u64,
}

/// The role of a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// The first nominal domain.
    Simulation,
    /// Belongs to an accepted domain.
    Accepted,
    /// Sets and judges the rate of false alarms.
    HeldOut,
    /// It is learnt from this source what the lane model loses.
    Labelled,
    /// It is learnt from this source what a cause looks like.
    Cause,
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
    /// The file is not a reference of this version.
    #[error(
        "reference {name}: {found}; wanted {FORMAT} version {VERSION} as written by gapwatch calibrate"
    )]
    Malformed {
        /// File or built-in name.
        name: String,
        /// What was found.
        found: String,
    },
    /// It was made for another model or for another preprocessing.
    #[error(
        "reference {name} does not fit the model in use: {what} is {found}, the reference was made with {wanted}; make a reference for this model, or name its model"
    )]
    OtherModel {
        /// File or built-in name.
        name: String,
        /// Which part differs.
        what: &'static str,
        /// Value of the model in use.
        found: String,
        /// Value of the reference.
        wanted: String,
    },
}

impl FalseAlarms {
    /// What the judging drives say about the rate that was asked for. Without judging drives, it is not shown.
    pub fn loudness(&self) -> Loudness {
        self.judged_rate().loudness(self.wanted_per_hour)
    }

    /// The same as text, with the bound on which it is based, or with what is missing.
    pub fn said(&self) -> String {
        self.judged_rate().said(self.wanted_per_hour)
    }

    /// What is missing to show that the rate is not louder than asked; `None` if nothing is missing.
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

    /// The first part in which another model differs: what the part is, and its value here and there. Names do not
    /// matter.
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
    /// What the reference inside the program is called.
    pub const BUILT_IN: &str = "built-in";

    /// A reference of this version.
    pub fn new(
        model: ModelFingerprint,
        metric: Metric,
        window_s: f64,
        (evidence, rate): (EvidenceKind, JudgedRate),
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
            evidence,
            rate,
            false_alarms,
            provenance,
            built_on: Vec::new(),
            components,
            causes: None,
            lanes: None,
        }
    }

    /// The same with more nominal domains, made of some sources by a command.
    #[must_use]
    pub fn accepting(
        mut self,
        components: Vec<Component>,
        sources: Vec<SourceUse>,
        command: String,
    ) -> Self {
        self.components.extend(components);
        self.strict = is_strict(self.metric, &self.components);
        self.provenance.sources.extend(sources);
        let before = std::mem::replace(&mut self.provenance.command, command);
        self.built_on.push(before);
        self
    }

    /// Whether it knows how far a road may differ from its own past.
    pub fn knows_changes(&self) -> bool {
        self.components.iter().all(|of| of.spans() > 0)
    }

    /// The same with what is known of causes.
    #[must_use]
    pub fn with_causes(self, causes: Option<Causes>) -> Self {
        Self { causes, ..self }
    }

    /// The same with a forecast of lanes.
    #[must_use]
    pub fn with_lanes(self, lanes: Option<LaneForecast>) -> Self {
        Self { lanes, ..self }
    }

    /// What a reference is called that is read from a file, or is inside the program.
    pub fn name_of(file: Option<&Path>) -> String {
        file.map_or_else(
            || Self::BUILT_IN.to_owned(),
            |path| path.display().to_string(),
        )
    }

    /// The command that makes a reference which accepts a road (a source as it is typed) beside what the reference of this
    /// name knows.
    pub fn accepting_command(name: &str, road: &str) -> String {
        let [name, road] = [name, road].map(quoted);
        format!("gapwatch calibrate --base {name} --accept {road} --out my-roads.json")
    }

    /// Reads a file, or the reference inside the program, and checks that it is whole.
    ///
    /// # Errors
    /// When it cannot be read or is malformed.
    pub fn read(file: Option<&Path>) -> Result<Self, ReferenceError> {
        match file {
            None => Self::parse(Self::BUILT_IN, BUILT_IN),
            Some(path) => {
                let text = read_text(path, BYTES_MAX).map_err(|error| ReferenceError::File {
                    path: path.to_owned(),
                    error,
                })?;
                Self::parse(&path.display().to_string(), &text)
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
        // Read from the text, because a value does not know its lines.
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
        if let Some(fault) = self.rate.fault() {
            return Some(fault);
        }
        if let Some(fault) = self.false_alarms.fault() {
            return Some(fault);
        }
        let of_causes = self.causes.as_ref().zip(self.components.first());
        if let Some(fault) = of_causes.and_then(|(of, first)| of.fault(&first.taps)) {
            return Some(format!("causes: {fault}"));
        }
        let of_lanes = self.lanes.as_ref().zip(self.components.first());
        if let Some(fault) = of_lanes.and_then(|(of, first)| of.fault(&first.taps)) {
            return Some(format!("lanes: {fault}"));
        }
        let spans = self.components.first().map_or(0, Component::spans);
        self.components.iter().find_map(|component| {
            if component.taps.iter().any(|tap| tap.spans.len() != spans) {
                return Some(format!(
                    "{}: other spans than the simulation",
                    component.name
                ));
            }
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

    /// Refuses a model with which the reference was not made.
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

    /// Four bytes that distinguish references on the bus: the first ones of the SHA-256 of the file's text.
    pub fn id(&self) -> [u8; 4] {
        let hash: [u8; 32] = Sha256::digest(self.to_json().as_bytes()).into();
        let [a, b, c, d, ..] = hash;
        [a, b, c, d]
    }
}

impl Component {
    /// Number of its spans.
    pub fn spans(&self) -> usize {
        self.taps.first().map_or(0, |tap| tap.spans.len())
    }

    /// Each tap with its own part of `values`, which are those of all taps, one after the other.
    pub fn by_tap<'a, T>(
        &'a self,
        mut values: &'a [T],
    ) -> impl Iterator<Item = (&'a TapReference, &'a [T])> {
        self.taps.iter().map(move |tap| {
            let (own, rest) = values.split_at(tap.nominal.len());
            values = rest;
            (tap, own)
        })
    }

    /// Takes the margins of another domain, see [`TapReference::widen_like`].
    pub fn widen_like(&mut self, other: &Self) {
        let taps = self.taps.iter_mut().zip(&other.taps);
        taps.for_each(|(own, of)| own.widen_like(of));
    }

    /// How many numbers some domains take from a frame.
    pub fn taken_len(components: &[Self]) -> usize {
        let taps = components.iter().flat_map(|component| &component.taps);
        taps.map(|tap| tap.nominal.len()).sum()
    }
}

fn is_strict(metric: Metric, components: &[Component]) -> bool {
    components.len() == 1 && metric != Metric::LaneRisk
}

#[cfg(test)]
mod tests;
