//! Parts of a reference: drives with their roles, the model, and the calibration target. What the encoder saw of the
//! drives is in a survey store.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::calibration::Target;
use crate::files::json_fault::fault;
use crate::files::whole_file::{WholeFile, read_text};
use crate::reference::gap::Metric;
use crate::reference::{
    BYTES_MAX, EvidenceKind, JudgedRate, ModelFingerprint, Reference, ReferenceError, Role,
};

const FORMAT: &str = "gapwatch-shard";
const VERSION: u32 = 2;

/// Drives for a future reference: a file beside their surveys. A reference contains the same about its own drives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shard {
    format: String,
    version: u32,
    /// Version of the program.
    pub gapwatch: String,
    /// The model that looked at the drives.
    pub model: ModelFingerprint,
    /// Metric that will measure the gap.
    pub metric: Metric,
    /// Length of the detector's window, seconds.
    pub window_s: f64,
    /// Target entries into `Gap` an hour.
    pub false_alarms_per_hour: f64,
    /// What the road will be judged by.
    pub evidence: EvidenceKind,
    /// How often it will be judged.
    pub rate: JudgedRate,
    /// The drives.
    pub sources: Vec<ShardSource>,
}

/// A drive of a shard.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShardSource {
    /// As typed.
    pub source: String,
    /// Its role.
    pub role: Role,
    /// Name of the accepted domain to which it belongs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub domain: Option<String>,
    /// Number of its frames.
    pub frames: u64,
}

impl ShardSource {
    /// Whether it is an accepted drive that does not say to which domain it belongs.
    fn is_of_no_domain(&self) -> bool {
        self.role == Role::Accepted && self.domain.is_none()
    }
}

/// A file that is not a part of a reference.
#[derive(Debug, thiserror::Error)]
pub enum ShardError {
    /// The file cannot be read or written, or is a reference that cannot be used.
    #[error(transparent)]
    Reference(#[from] ReferenceError),
    /// The file is neither a shard nor a reference.
    #[error("{}: {found}; wanted a reference, or a shard of version {VERSION}, as written by gapwatch calibrate", path.display())]
    Malformed {
        /// Which file.
        path: PathBuf,
        /// What was found.
        found: String,
    },
}

impl Shard {
    /// A shard with some drives for a future reference.
    pub fn new(model: ModelFingerprint, wanted: Target, sources: Vec<ShardSource>) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            gapwatch: env!("CARGO_PKG_VERSION").to_owned(),
            model,
            metric: wanted.metric,
            window_s: wanted.window_s,
            false_alarms_per_hour: wanted.false_alarms_per_hour,
            evidence: wanted.evidence,
            rate: wanted.rate,
            sources,
        }
    }

    /// Reads a shard, or what a reference says about its drives.
    ///
    /// # Errors
    /// When the file cannot be read, when it is neither a shard nor a reference, or when it is a reference that does
    /// not say the roles of its drives.
    pub fn read(path: &Path) -> Result<Self, ShardError> {
        let malformed = |found: String| ShardError::Malformed {
            path: path.to_owned(),
            found,
        };
        let text = read_text(path, BYTES_MAX).map_err(|error| ReferenceError::File {
            path: path.to_owned(),
            error,
        })?;
        let value: serde_json::Value =
            serde_json::from_str(&text).map_err(|error| malformed(fault(&error)))?;
        if value["format"] == FORMAT {
            if value["version"] != VERSION {
                return Err(malformed(format!(
                    "a shard of version {}",
                    value["version"]
                )));
            }
            let shard: Self =
                serde_json::from_str(&text).map_err(|error| malformed(fault(&error)))?;
            let nameless = shard.sources.iter().filter(|of| of.is_of_no_domain());
            return match nameless.count() {
                0 | 1 => Ok(shard),
                more => Err(malformed(format!(
                    "{more} accepted drives without the names of their domains"
                ))),
            };
        }
        let reference = Reference::read(Some(path))?;
        let accepted: Vec<String> = reference
            .components
            .iter()
            .skip(1)
            .map(|of| of.name.clone())
            .collect();
        let sources = reference.provenance.sources.into_iter().map(|source| {
            let role = source.role.ok_or_else(|| {
                malformed(format!(
                    "a reference that does not say the role of {}",
                    source.source
                ))
            })?;
            let mut of = ShardSource {
                source: source.source,
                role,
                domain: source.domain,
                frames: source.frames,
            };
            if of.is_of_no_domain() {
                let [only] = accepted.as_slice() else {
                    return Err(malformed(format!(
                        "a reference with {} accepted domains that does not say to which {} belongs",
                        accepted.len(),
                        of.source
                    )));
                };
                of.domain = Some(only.clone());
            }
            Ok(of)
        });
        Ok(Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            gapwatch: reference.provenance.gapwatch,
            model: reference.model,
            metric: reference.metric,
            window_s: reference.window_s,
            false_alarms_per_hour: reference.false_alarms.wanted_per_hour,
            evidence: reference.evidence,
            rate: reference.rate,
            sources: sources.collect::<Result<_, ShardError>>()?,
        })
    }

    /// Writes the file whole or not at all.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), ShardError> {
        let failed = |error| ReferenceError::File {
            path: path.to_owned(),
            error,
        };
        let text = serde_json::to_string_pretty(self).map_err(|e| failed(e.into()))?;
        let mut file = WholeFile::create(path).map_err(failed)?;
        writeln!(file, "{text}").map_err(failed)?;
        Ok(file.finish().map_err(failed)?)
    }

    /// The calibration target of the reference.
    pub fn wanted(&self) -> Target {
        Target {
            metric: self.metric,
            window_s: self.window_s,
            false_alarms_per_hour: self.false_alarms_per_hour,
            evidence: self.evidence,
            rate: self.rate,
        }
    }

    /// The first part because of which another shard cannot belong to the same reference: what the part is, and its
    /// value here and there.
    pub fn difference(&self, other: &Self) -> Option<(&'static str, String, String)> {
        let parts = [
            (
                "version of gapwatch",
                self.gapwatch.clone(),
                other.gapwatch.clone(),
            ),
            ("metric", self.metric.to_string(), other.metric.to_string()),
            (
                "window, seconds,",
                self.window_s.to_string(),
                other.window_s.to_string(),
            ),
            (
                "wanted rate of false alarms an hour",
                self.false_alarms_per_hour.to_string(),
                other.false_alarms_per_hour.to_string(),
            ),
            (
                "evidence",
                self.evidence.to_string(),
                other.evidence.to_string(),
            ),
        ];
        let of_model = self.model.difference(&other.model);
        let of_model = of_model.map(|(what, ours, theirs)| match what {
            "hash" => ("hash of the model", ours, theirs),
            what => (what, ours, theirs),
        });
        of_model.or_else(|| parts.into_iter().find(|(_, ours, theirs)| ours != theirs))
    }
}
