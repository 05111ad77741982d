//! A file of results: JSON with one key for each evaluation. Each key can be made again alone.

use std::io::Write;
use std::path::Path;

use anyhow::{Context, anyhow, bail};
use gapwatch::files::json_fault::fault;
use gapwatch::files::whole_file::{WholeFile, read_text};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use crate::cli::args::EvaluateKey;

/// Key of the version of the program that last wrote the file. A file of results is recognised by this key.
const VERSION: &str = "gapwatch";
/// Largest file of results.
const BYTES_MAX: u64 = 64 << 20;
/// Key that says how the others were made.
const MADE: &str = "made";

/// One row of a key.
#[derive(Serialize, Deserialize)]
pub struct Row<T> {
    /// What was found.
    #[serde(flatten)]
    pub of: T,
    /// Whether it is what the program does if nothing else is asked for.
    pub default: bool,
}

/// How the rows of a key were made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Made {
    /// The command that makes the rows again, on any machine.
    pub command: String,
    /// Version of the program.
    pub gapwatch: String,
    /// The seeds of what was rendered, as text.
    pub seeds: String,
}

/// Rows by key.
#[derive(Debug, Default)]
pub struct Results(Map<String, Value>);

impl Results {
    /// Reads a file of results.
    ///
    /// # Errors
    /// When the file cannot be read, or is another kind of file.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let name = path.display();
        let text = read_text(path, BYTES_MAX).with_context(|| format!("cannot read {name}"))?;
        let wanted = "wanted results written by gapwatch evaluate --out";
        match serde_json::from_str(&text) {
            Ok(Value::Object(of)) if of.get(VERSION).is_some_and(Value::is_string) => Ok(Self(of)),
            Ok(_) => bail!("{name}: JSON without the key {VERSION:?}; {wanted}"),
            Err(error) => bail!("{name}: {}; {wanted}", fault(&error)),
        }
    }

    /// Puts the rows of a key in place of those that were there.
    ///
    /// # Errors
    /// When a row cannot be written as JSON.
    pub fn set<T: Serialize>(
        &mut self,
        key: EvaluateKey,
        rows: &[Row<T>],
        made: &Made,
    ) -> anyhow::Result<()> {
        let (rows, made) = (serde_json::to_value(rows)?, serde_json::to_value(made)?);
        self.put(key, rows, made);
        Ok(())
    }

    /// Takes one key from other results.
    fn take_over(&mut self, key: EvaluateKey, other: &Self) {
        let name = key.name();
        if let Some(rows) = other.0.get(&name) {
            let made = other.0.get(MADE).and_then(|made| made.get(&name));
            self.put(key, rows.clone(), made.cloned().unwrap_or_default());
        }
    }

    fn put(&mut self, key: EvaluateKey, rows: Value, made: Value) {
        let version = json!(env!("CARGO_PKG_VERSION"));
        self.0.insert(VERSION.to_owned(), version);
        self.0.insert(key.name(), rows);
        let all = self.0.entry(MADE).or_insert_with(|| json!({}));
        if !all.is_object() {
            *all = json!({});
        }
        all[key.name()] = made;
    }

    /// The results with only one key.
    pub fn only(&self, key: EvaluateKey) -> Self {
        let mut one = Self::default();
        one.take_over(key, self);
        one
    }

    /// Whether a key is there.
    pub fn has(&self, key: EvaluateKey) -> bool {
        self.0.contains_key(&key.name())
    }

    /// The rows of a key, if it was evaluated.
    ///
    /// # Errors
    /// When the rows are those of another version.
    pub fn rows<T: DeserializeOwned>(
        &self,
        key: EvaluateKey,
    ) -> anyhow::Result<Option<Vec<Row<T>>>> {
        let rows = self.0.get(&key.name()).cloned();
        rows.map(serde_json::from_value)
            .transpose()
            .map_err(|error| {
                let name = key.name();
                anyhow!(
                    "{name}: rows of another version ({}); wanted rows that were made again with --only {name}",
                    fault(&error)
                )
            })
    }

    /// How the rows of a key were made, if that is known.
    pub fn made(&self, key: EvaluateKey) -> Option<Made> {
        let made = self.0.get(MADE)?.get(key.name())?;
        serde_json::from_value(made.clone()).ok()
    }

    /// JSON with one row on each line, so that two versions of a file can be compared.
    ///
    /// # Errors
    /// Never for results that were read or set.
    pub fn to_json(&self) -> anyhow::Result<String> {
        let mut members = Vec::new();
        for (key, value) in &self.0 {
            let lines = match value {
                Value::Array(rows) if !rows.is_empty() => {
                    let rows = rows.iter().map(serde_json::to_string);
                    let rows = rows.collect::<Result<Vec<_>, _>>()?;
                    format!("[\n    {}\n  ]", rows.join(",\n    "))
                }
                other => serde_json::to_string_pretty(other)?.replace('\n', "\n  "),
            };
            members.push(format!("  {}: {lines}", serde_json::to_string(key)?));
        }
        Ok(format!("{{\n{}\n}}\n", members.join(",\n")))
    }
}

/// Where results are kept: a file that grows key by key, or a device that gets them all at the end.
pub struct Store<'a> {
    path: &'a Path,
    device: Option<WholeFile>,
}

impl<'a> Store<'a> {
    /// Checks that results can be kept there, before any result is made.
    ///
    /// # Errors
    /// When nothing can be written there, or when there is already another kind of file.
    pub fn open(path: &'a Path) -> anyhow::Result<Self> {
        let file = WholeFile::create(path).with_context(|| cannot_write(path))?;
        let device = path.exists() && !path.is_file();
        if path.is_file() {
            Results::read(path)?;
        }
        Ok(Self {
            path,
            device: device.then_some(file),
        })
    }

    /// Puts one key into the file as it is now; for a device, this waits until the end.
    ///
    /// # Errors
    /// When the file cannot be read or written.
    pub fn keep(&self, key: EvaluateKey, results: &Results) -> anyhow::Result<()> {
        if self.device.is_some() {
            return Ok(());
        }
        let mut kept = match self.path.is_file() {
            true => Results::read(self.path)?,
            false => Results::default(),
        };
        kept.take_over(key, results);
        let mut file = WholeFile::create(self.path).with_context(|| cannot_write(self.path))?;
        file.write_all(kept.to_json()?.as_bytes())
            .and_then(|()| file.finish())
            .with_context(|| cannot_write(self.path))
    }

    /// Writes the results that have waited.
    ///
    /// # Errors
    /// When the device does not accept them.
    pub fn finish(self, results: &Results) -> anyhow::Result<()> {
        let Some(mut device) = self.device else {
            return Ok(());
        };
        device
            .write_all(results.to_json()?.as_bytes())
            .and_then(|()| device.finish())
            .with_context(|| cannot_write(self.path))
    }
}

fn cannot_write(path: &Path) -> String {
    format!("cannot write {}", path.display())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::fs;

    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Found {
        drives: u64,
        share: Option<f64>,
    }

    fn made(command: &str) -> Made {
        Made {
            command: command.to_owned(),
            gapwatch: "0".to_owned(),
            seeds: "1 and on".to_owned(),
        }
    }

    fn results(key: EvaluateKey, drives: u64) -> Results {
        let of = Found {
            drives,
            share: Some(0.1 + 0.2),
        };
        let mut results = Results::default();
        let row = Row { of, default: true };
        results
            .set(key, &[row], &made(&format!("of {drives}")))
            .unwrap();
        results
    }

    #[test]
    fn a_key_is_replaced_and_the_others_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("results.json");
        // A key that this version does not know, perhaps of a later version, is kept too.
        fs::write(&path, r#"{"gapwatch": "9", "weather": [{"wet": 1}]}"#).unwrap();
        let (iou, alarms) = (EvaluateKey::LaneIou, EvaluateKey::FalseAlarms);
        for (key, drives) in [(iou, 1), (alarms, 2), (iou, 3)] {
            let store = Store::open(&path).unwrap();
            let results = results(key, drives);
            store.keep(key, &results).unwrap();
            store.finish(&results).unwrap();
        }
        let kept = Results::read(&path).unwrap();
        assert_eq!(kept.0["weather"], json!([{"wet": 1}]));
        for (key, drives) in [(iou, 3), (alarms, 2)] {
            let rows = kept.rows::<Found>(key).unwrap().unwrap();
            assert_eq!(
                (rows.len(), rows[0].of.drives, rows[0].default),
                (1, drives, true)
            );
            // Floats are read back bit for bit.
            assert_eq!(rows[0].of.share, Some(0.1 + 0.2));
            assert_eq!(kept.made(key), Some(made(&format!("of {drives}"))));
        }
        assert!(
            kept.rows::<Found>(EvaluateKey::DomainDetection)
                .unwrap()
                .is_none()
        );
        assert!(
            kept.to_json()
                .unwrap()
                .contains("\n    {\"default\":true,\"drives\":3,")
        );
    }

    #[test]
    fn other_files_are_refused_by_name_and_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mine.json");
        for (text, said) in [
            ("precious", "not JSON"),
            ("[1]", "without the key"),
            ("{\"a\": 1}", "without the key"),
        ] {
            fs::write(&path, text).unwrap();
            let refused = Store::open(&path).err().unwrap().to_string();
            assert!(
                refused.contains("mine.json") && refused.contains(said),
                "{refused}"
            );
            assert_eq!(fs::read_to_string(&path).unwrap(), text);
        }
        let other = Results(Map::from_iter([("lane_iou".to_owned(), json!([{"a": 1}]))]));
        let refused = other.rows::<Found>(EvaluateKey::LaneIou).err().unwrap();
        assert!(refused.to_string().contains("--only lane_iou"));
    }
}
