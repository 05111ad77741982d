//! `gapwatch merge`: references and shards → one reference.

use std::collections::HashMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use gapwatch::calibration::shard::Shard;
use gapwatch::calibration::survey::store::SurveyStore;
use gapwatch::calibration::{FarDrives, Target};
use gapwatch::reference::{JudgedRate, Role};

use super::calibrate::describe;
use super::calibration_plan::{CalibrationPlan, PlannedDrive};
use super::loaded_model::LoadedModel;
use super::output::{Kind, check_output};
use crate::cli::args::MergeArgs;

pub fn run(args: &MergeArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    let files = args.files.iter().map(|file| ("merge", file));
    let files = files.chain(args.model.model.iter().map(|file| ("--model", file)));
    let inputs = files.filter_map(|(option, file)| Some((option, file.to_str()?)));
    check_output("--out", &args.out, Kind::Reference, inputs)?;
    let parts = args
        .files
        .iter()
        .map(|path| Ok((path.as_path(), Shard::read(path)?)))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let Some(((first_path, first), others)) = parts.split_first() else {
        bail!("no file; wanted references or shards");
    };
    for (path, part) in others {
        if let Some((what, wanted, found)) = first.difference(part) {
            bail!(
                "{}: {what} {found}; wanted {wanted} as in {}",
                path.display(),
                first_path.display()
            );
        }
    }
    let ours = env!("CARGO_PKG_VERSION");
    if first.gapwatch != ours {
        bail!(
            "{}: made by gapwatch {}; wanted {ours}, the version of this program",
            first_path.display(),
            first.gapwatch
        );
    }
    check_apart(&parts)?;
    let mut model = first.model.clone();
    // This name is the same for any order of the parts.
    if let Some(name) = parts.iter().map(|(_, part)| &part.model.name).min() {
        model.name.clone_from(name);
    }
    let sources = || parts.iter().flat_map(|(_, part)| &part.sources);
    let drives = sources().map(|of| PlannedDrive {
        role: of.role,
        domain: of.domain.clone(),
        source: of.source.clone(),
    });
    let drives = drives.collect();
    // A reference names the rate of its own drives, which may be slower than that asked for.
    let rates = parts.iter().map(|(_, part)| part.rate);
    let wanted = Target {
        rate: rates.fold(first.rate, JudgedRate::at_least),
        ..first.wanted()
    };
    let plan = CalibrationPlan::new(model, wanted, drives)?;
    plan.check_whole()?;
    let store = SurveyStore::temporary(&plan.model)?.reading(folders(args)?);
    let mut found = plan.find(&store, None)?;
    if found.missing() > 0 {
        log::warn!(
            "{} drives without a survey are looked at again; calibrate --surveys keeps them",
            found.missing()
        );
        let model = LoadedModel::load(&args.model)?;
        if let Some((what, wanted, found)) = first.model.difference(&model.fingerprint) {
            bail!(
                "{}: drives without a survey, of another model than the one in use: {what} is {found}; wanted {wanted}: name it with --model, or their folders with --surveys",
                first_path.display()
            );
        }
        plan.look(&mut found, &model, &store)?;
    }
    let frames: HashMap<(Role, String), u64> = plan
        .sources(&found)?
        .into_iter()
        .map(|of| ((of.role, of.source), of.frames))
        .collect();
    for (path, part) in &parts {
        for of in &part.sources {
            let found = frames.get(&(of.role, of.source.clone())).copied();
            if found != Some(of.frames) {
                bail!(
                    "{}: {} frames of {}, but its survey has {}; wanted the survey that the file was made with",
                    path.display(),
                    of.frames,
                    of.source,
                    found.unwrap_or_default()
                );
            }
        }
    }
    // Drives that are far were refused or allowed when the parts were made, or are named now.
    let (reference, doubts) = plan.reference(found, FarDrives::Allowed)?;
    reference
        .write(&args.out)
        .context("cannot write the reference")?;
    describe(&reference, &args.out, out)?;
    doubts.iter().for_each(|doubt| log::warn!("{doubt}"));
    Ok(0)
}

/// Refuses a drive that two files have.
fn check_apart(parts: &[(&Path, Shard)]) -> anyhow::Result<()> {
    let mut owners: HashMap<(bool, &str), &Path> = HashMap::new();
    for (path, part) in parts {
        for of in &part.sources {
            // A drive with lane labels may also be looked at as a plain drive.
            let drive = (of.role == Role::Labelled, of.source.as_str());
            if let Some(other) = owners.insert(drive, path) {
                bail!(
                    "{}: drive {} is in {} too; wanted each drive once",
                    path.display(),
                    of.source,
                    other.display()
                );
            }
        }
    }
    Ok(())
}

/// Folders in which surveys may be: the folders named, and the folders `*.surveys` beside the files.
fn folders(args: &MergeArgs) -> anyhow::Result<Vec<PathBuf>> {
    let mut folders = Vec::new();
    for folder in &args.surveys {
        if !folder.is_dir() {
            bail!("{}: no such folder of surveys", folder.display());
        }
        folders.push(folder.clone());
    }
    let mut beside: Vec<PathBuf> = Vec::new();
    for file in &args.files {
        let parent = file
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        let entries = fs::read_dir(parent).with_context(|| parent.display().to_string())?;
        let paths = entries.flatten().map(|entry| entry.path());
        beside.extend(
            paths.filter(|path| {
                path.extension().is_some_and(|end| end == "surveys") && path.is_dir()
            }),
        );
    }
    beside.sort();
    beside.dedup();
    folders.extend(beside);
    Ok(folders)
}
