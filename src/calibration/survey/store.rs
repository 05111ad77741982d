//! Surveys on disk, one file for each drive: what the encoder saw of it, so that it need not look again.
//!
//! A file's name is the hash of everything that its content depends on: model, taps, preprocessing, resize kernel,
//! version of the program, what is kept, and the drive's name. The content of files and folders may change under the
//! same name, so their surveys also contain a stamp of names, sizes and times of change. Energies are kept as 64-bit
//! floats, so that a survey from disk is bit for bit the same as a new one. A file appears whole or not at all, and
//! carries its checksum.

use std::borrow::Cow;
use std::fs;
use std::io::{self, Write};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use super::{Keep, Survey};
use crate::calibration::drive::{LabelledDrive, LabelledMeans, StoreError, SurveyedDrive, VERSION};
use crate::features::attention::common_size;
use crate::features::energies::BlockMeans;
use crate::files::durable::create_folders;
use crate::files::temporary_folder::TemporaryFolder;
use crate::files::whole_file::{WholeFile, unnamed};
use crate::reference::ModelFingerprint;

const MAGIC: &[u8; 16] = b"gapwatch-survey\n";
/// Bytes before the content: magic, version, SHA-256 of the content.
const HEAD: usize = MAGIC.len() + 4 + 32;

/// Where surveys are kept.
pub struct SurveyStore {
    /// The first folder is written to, and all are read from.
    folders: Vec<PathBuf>,
    /// The first folder, if it is temporary.
    _temporary: Option<TemporaryFolder>,
    model: ModelFingerprint,
}

/// What is kept of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum SurveyKind {
    /// Energy maps and means of every frame.
    Maps,
    /// Means of every frame.
    Means,
    /// Frames under every condition, with what the lane model loses there.
    Labelled,
}

/// What can be kept of a drive.
pub trait Content: Serialize + DeserializeOwned {
    /// Number of frames in it.
    fn len(&self) -> usize;

    /// Whether there are no frames.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// What is wrong with it, for a model and the kind that was to be kept.
    fn fault(&self, model: &ModelFingerprint, kept: SurveyKind) -> Option<String>;
}

/// A drive whose survey is on disk.
#[derive(Clone, Debug)]
pub struct Stored<T> {
    path: PathBuf,
    key: String,
    source: String,
    kept: SurveyKind,
    model: ModelFingerprint,
    frames: usize,
    content: PhantomData<fn() -> T>,
}

impl From<Keep> for SurveyKind {
    fn from(keep: Keep) -> Self {
        match keep {
            Keep::Maps => Self::Maps,
            Keep::Means => Self::Means,
        }
    }
}

impl SurveyStore {
    /// Surveys of a model in a folder, which is created if it does not exist.
    ///
    /// # Errors
    /// When the folder cannot be created.
    pub fn open(folder: &Path, model: &ModelFingerprint) -> Result<Self, StoreError> {
        create_folders(folder).map_err(|error| StoreError::File {
            path: folder.to_owned(),
            error,
        })?;
        Ok(Self {
            folders: vec![folder.to_owned()],
            _temporary: None,
            model: model.clone(),
        })
    }

    /// Surveys in a folder that is removed when the program ends, or by the next run if it was killed. It is in
    /// `$TMPDIR`, else in `/var/tmp`, which is on disk also where `/tmp` is in memory.
    ///
    /// # Errors
    /// When the folder cannot be created.
    pub fn temporary(model: &ModelFingerprint) -> Result<Self, StoreError> {
        let disk = Path::new("/var/tmp");
        let place = match std::env::var_os("TMPDIR") {
            None if disk.is_dir() => disk.to_owned(),
            _ => std::env::temp_dir(),
        };
        let folder =
            TemporaryFolder::create(&place, "gapwatch-surveys-", 0o700).map_err(|error| {
                StoreError::File {
                    error: unnamed(&error),
                    path: place,
                }
            })?;
        Ok(Self {
            folders: vec![folder.path().to_owned()],
            _temporary: Some(folder),
            model: model.clone(),
        })
    }

    /// The same store, which also finds surveys in other folders.
    #[must_use]
    pub fn reading(mut self, folders: impl IntoIterator<Item = PathBuf>) -> Self {
        self.folders.extend(folders);
        self
    }

    /// The name of a drive's file, which is also the key inside the file.
    fn key(&self, source: &str, kept: SurveyKind) -> String {
        let ModelFingerprint {
            name: _,
            sha256,
            taps,
            preprocessing,
            resize,
        } = &self.model;
        let of_model = (sha256, taps, preprocessing, resize);
        let all = (VERSION, env!("CARGO_PKG_VERSION"), of_model, kept, source);
        // Writing this into memory cannot fail.
        let bytes = postcard::to_stdvec(&all).unwrap_or_default();
        hex(&Sha256::digest(bytes)[..16])
    }

    /// The survey of a drive, if there is a complete one. With a `stamp`, only a survey that was kept with the same
    /// stamp.
    ///
    /// # Errors
    /// `Damaged` if the file is not a survey of this drive.
    pub fn find<T: Content>(
        &self,
        source: &str,
        kept: SurveyKind,
        stamp: Option<&str>,
    ) -> Result<Option<Stored<T>>, StoreError> {
        let key = self.key(source, kept);
        let name = format!("{key}.survey");
        let mut damaged = None;
        for path in self.folders.iter().map(|folder| folder.join(&name)) {
            if !path.exists() {
                continue;
            }
            let mut stored: Stored<T> = Stored {
                path,
                key: key.clone(),
                source: source.to_owned(),
                kept,
                model: self.model.clone(),
                frames: 0,
                content: PhantomData,
            };
            match stored.read() {
                Ok((own, _)) if stamp.is_some_and(|stamp| stamp != own) => {}
                Ok((_, content)) => {
                    stored.frames = content.len();
                    return Ok(Some(stored));
                }
                Err(error @ StoreError::Damaged { .. }) => damaged = Some(error),
                Err(error) => return Err(error),
            }
        }
        damaged.map_or(Ok(None), Err)
    }

    /// Keeps a drive's survey; it replaces an earlier one.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn keep<T: Content>(
        &self,
        source: &str,
        kept: SurveyKind,
        stamp: &str,
        content: &T,
    ) -> Result<Stored<T>, StoreError> {
        let key = self.key(source, kept);
        let path = self.folders[0].join(format!("{key}.survey"));
        let failed = |error| StoreError::File {
            path: path.clone(),
            error,
        };
        let bytes = postcard::to_stdvec(&(&key, stamp, content))
            .map_err(|error| failed(io::Error::other(error)))?;
        let mut file = WholeFile::create(&path).map_err(failed)?;
        let parts: [&[u8]; 4] = [
            MAGIC,
            &VERSION.to_le_bytes(),
            &Sha256::digest(&bytes),
            &bytes,
        ];
        for part in parts {
            file.write_all(part).map_err(failed)?;
        }
        file.finish().map_err(failed)?;
        Ok(Stored {
            path,
            key,
            source: source.to_owned(),
            kept,
            model: self.model.clone(),
            frames: content.len(),
            content: PhantomData,
        })
    }
}

impl<T: Content> Stored<T> {
    /// The stamp and the content.
    fn read(&self) -> Result<(String, T), StoreError> {
        let damaged = |found: String| StoreError::Damaged {
            path: self.path.clone(),
            found,
            source_name: self.source.clone(),
        };
        let bytes = fs::read(&self.path).map_err(|error| StoreError::File {
            path: self.path.clone(),
            error,
        })?;
        let Some((head, content)) = bytes.split_at_checked(HEAD) else {
            return Err(damaged(format!("{} bytes", bytes.len())));
        };
        let (magic, rest) = head.split_at(MAGIC.len());
        let (version, checksum) = rest.split_at(4);
        if magic != MAGIC {
            return Err(damaged("not a survey".to_owned()));
        }
        if version != VERSION.to_le_bytes() {
            let version = version
                .iter()
                .rev()
                .fold(0_u32, |v, &b| v << 8 | u32::from(b));
            return Err(damaged(format!("version {version}")));
        }
        if checksum != &Sha256::digest(content)[..] {
            return Err(damaged("a damaged file with another checksum".to_owned()));
        }
        let (key, stamp, content): (String, String, T) =
            postcard::from_bytes(content).map_err(|error| damaged(error.to_string()))?;
        if key != self.key {
            return Err(damaged("a survey of another drive or model".to_owned()));
        }
        match content.fault(&self.model, self.kept) {
            Some(fault) => Err(damaged(fault)),
            None => Ok((stamp, content)),
        }
    }
}

impl SurveyedDrive for Stored<Survey> {
    fn source(&self) -> &str {
        &self.source
    }

    fn frames(&self) -> usize {
        self.frames
    }

    fn survey(&self) -> Result<Cow<'_, Survey>, StoreError> {
        Ok(Cow::Owned(self.read()?.1))
    }
}

impl LabelledDrive for Stored<Vec<LabelledMeans>> {
    fn frames(&self) -> usize {
        self.frames
    }

    fn means(&self) -> Result<Cow<'_, [LabelledMeans]>, StoreError> {
        Ok(Cow::Owned(self.read()?.1))
    }
}

impl Content for Survey {
    fn len(&self) -> usize {
        self.frames.len()
    }

    fn fault(&self, model: &ModelFingerprint, kept: SurveyKind) -> Option<String> {
        let (width, height) = (model.preprocessing.width, model.preprocessing.height);
        if self.common_size != common_size(width, height) {
            return Some(format!("maps compared at {:?}", self.common_size));
        }
        if self.times.len() != self.frames.len() {
            let (times, frames) = (self.times.len(), self.frames.len());
            return Some(format!("{times} times of {frames} frames"));
        }
        let maps = match kept {
            SurveyKind::Maps => model.taps.len(),
            SurveyKind::Means | SurveyKind::Labelled => 0,
        };
        self.frames.iter().flatten().find_map(|frame| {
            let whole = frame.maps.len() == maps
                && frame.peaks.len() == model.taps.len()
                && frame.maps.iter().all(|map| {
                    map.width > 0
                        && map.width.checked_mul(map.height) == Some(map.energy.len())
                        && !map.energy.is_empty()
                });
            let of_maps = (!whole).then(|| "a frame with other taps or sizes".to_owned());
            of_maps.or_else(|| means_fault(&frame.means, model))
        })
    }
}

impl Content for Vec<LabelledMeans> {
    fn len(&self) -> usize {
        self.len()
    }

    fn fault(&self, model: &ModelFingerprint, _: SurveyKind) -> Option<String> {
        self.iter()
            .find_map(|frame| means_fault(&frame.means, model))
    }
}

fn means_fault(means: &[BlockMeans], model: &ModelFingerprint) -> Option<String> {
    (means.len() != model.taps.len())
        .then(|| format!("means of {} taps, not {}", means.len(), model.taps.len()))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::time::Duration;

    use super::*;
    use crate::calibration::survey::SurveyFrame;
    use crate::capture::undefined::Undefined;
    use crate::features::attention::EnergyMap;
    use crate::model::preprocess::{CROP_NOTHING, Preprocessing};

    fn model(sha256: &str) -> ModelFingerprint {
        ModelFingerprint {
            name: "m".to_owned(),
            sha256: sha256.to_owned(),
            taps: vec!["e2".to_owned()],
            preprocessing: Preprocessing {
                width: 8,
                height: 8,
                mean: [0.0; 3],
                std: [1.0; 3],
                crop: CROP_NOTHING,
            },
            resize: "r".to_owned(),
        }
    }

    fn survey() -> Survey {
        let means = BlockMeans {
            activation: vec![-0.1, f64::MIN_POSITIVE],
            energy: vec![1.0 / 3.0; 18],
        };
        Survey {
            source: "drive".to_owned(),
            times: vec![Duration::ZERO, Duration::from_nanos(333_333_333)],
            frames: vec![
                Ok(SurveyFrame {
                    maps: vec![EnergyMap {
                        width: 1,
                        height: 2,
                        energy: vec![0.1, 1e300],
                    }],
                    peaks: vec![1e300],
                    means: vec![means],
                }),
                Err(Undefined::Frozen(Duration::from_secs(1))),
            ],
            common_size: (2, 2),
        }
    }

    fn find(store: &SurveyStore, name: &str) -> Result<Option<Stored<Survey>>, StoreError> {
        store.find(name, SurveyKind::Maps, Some("today"))
    }

    #[test]
    fn a_survey_from_disk_is_the_fresh_one() {
        let folder = tempfile::tempdir().unwrap();
        let store = SurveyStore::open(&folder.path().join("new"), &model("a")).unwrap();
        assert!(find(&store, "drive").unwrap().is_none());
        store
            .keep("drive", SurveyKind::Maps, "today", &survey())
            .unwrap();
        let stored = find(&store, "drive").unwrap().unwrap();
        assert_eq!(SurveyedDrive::frames(&stored), 2);
        // These texts have every digit that distinguishes floats.
        let read = format!("{:?}", stored.survey().unwrap());
        assert_eq!(read, format!("{:?}", survey()));
    }

    #[test]
    fn what_is_of_another_model_time_kind_or_drive_is_not_found() {
        let folder = tempfile::tempdir().unwrap();
        let store = SurveyStore::open(folder.path(), &model("a")).unwrap();
        store
            .keep("drive", SurveyKind::Maps, "today", &survey())
            .unwrap();
        assert!(find(&store, "other").unwrap().is_none());
        let other = |stamp, kept| {
            store
                .find::<Survey>("drive", kept, stamp)
                .unwrap()
                .is_none()
        };
        assert!(other(Some("tomorrow"), SurveyKind::Maps) && other(None, SurveyKind::Means));
        assert!(!other(None, SurveyKind::Maps));
        let of_b = SurveyStore::open(folder.path(), &model("b")).unwrap();
        assert!(find(&of_b, "drive").unwrap().is_none());
        let reading = SurveyStore::temporary(&model("a")).unwrap();
        let reading = reading.reading([folder.path().to_owned()]);
        assert!(find(&reading, "drive").unwrap().is_some());
    }

    #[test]
    fn whatever_is_changed_in_a_file_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let store = SurveyStore::open(folder.path(), &model("a")).unwrap();
        let stored = store
            .keep("drive", SurveyKind::Maps, "today", &survey())
            .unwrap();
        let whole = fs::read(&stored.path).unwrap();
        for place in 0..whole.len() {
            let mut changed = whole.clone();
            changed[place] ^= 0x10;
            fs::write(&stored.path, changed).unwrap();
            let said = find(&store, "drive").unwrap_err().to_string();
            assert!(
                said.contains(".survey: ") && said.contains("drive"),
                "{said}"
            );
            fs::write(&stored.path, &whole[..place]).unwrap();
            assert!(find(&store, "drive").is_err(), "{place}");
        }
        // Complete files with the wrong content.
        for wrong in [
            Survey {
                common_size: (9, 9),
                ..survey()
            },
            Survey {
                times: vec![],
                ..survey()
            },
        ] {
            store
                .keep("drive", SurveyKind::Maps, "today", &wrong)
                .unwrap();
            assert!(find(&store, "drive").is_err());
        }
        let mut wrong = survey();
        wrong.frames[0].as_mut().unwrap().maps[0].width = 3;
        store
            .keep("drive", SurveyKind::Maps, "today", &wrong)
            .unwrap();
        assert!(find(&store, "drive").is_err());
    }
}
