//! `gapwatch scene`: labelled scenes as files.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::Ordering;

use anyhow::{Context, bail};
use gapwatch::lab::scene::{
    ConditionKind, Drive, Element, Labelled, Look, Renderer, World, scene_moment,
};
use image::ExtendedColorType;
use rayon::prelude::*;
use serde::Serialize;
use sha2::{Digest, Sha256};

use super::new_folder::NewFolder;
use super::pictures::write_png;
use super::{progress, signals};
use crate::cli::args::{SceneArgs, SceneList};

/// One line of `scenes.jsonl`.
#[derive(Serialize)]
struct SceneLine {
    frame: String,
    mask: String,
    seed: u64,
    t_s: f64,
    look: &'static str,
    without: Vec<&'static str>,
    conditions: Vec<String>,
    /// SHA-256 of the pixels of frame and mask: the same on every machine.
    sha256: String,
}

pub fn run(args: &SceneArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    if let Some(list) = args.list {
        let names: Vec<&str> = match list {
            SceneList::Looks => Look::ALL.map(Look::name).to_vec(),
            SceneList::Elements => Element::ALL.map(Element::name).to_vec(),
            SceneList::Conditions => ConditionKind::ALL.map(ConditionKind::name).to_vec(),
        };
        writeln!(out, "{}", names.join("\n"))?;
        return Ok(0);
    }
    let Some(target) = &args.out else {
        bail!("wanted --out DIR");
    };
    if let Some(timed) = args.condition.iter().find(|c| c.span_s.is_some()) {
        bail!(
            "condition {timed}: a scene is a single moment; wanted KIND:SEVERITY without @FROM-TO"
        );
    }
    let stop = signals::stop()?;
    let folder = NewFolder::beside(target)?;
    for part in ["frames", "masks"] {
        let path = folder.path().join(part);
        fs::create_dir(&path).with_context(|| format!("cannot create {}", path.display()))?;
    }
    let bar = progress::over(Some(args.count.into()), "rendering", "scenes");
    let lines = (0..args.count)
        .into_par_iter()
        .map_init(
            || Renderer::new(args.size.width, args.size.height),
            |renderer, index| {
                if stop.load(Ordering::Relaxed) {
                    return Ok(None);
                }
                bar.inc(1);
                render_scene(args, index, renderer, folder.path()).map(Some)
            },
        )
        .filter_map(Result::transpose)
        .collect::<anyhow::Result<Vec<_>>>()?;
    bar.finish_and_clear();
    let list = folder.path().join("scenes.jsonl");
    fs::write(&list, lines.concat()).with_context(|| format!("cannot write {}", list.display()))?;
    folder.keep()?;
    if lines.len() < args.count as usize {
        bail!(
            "{}: stopped by a signal after {} of {} scenes; those in scenes.jsonl are complete",
            target.display(),
            lines.len(),
            args.count
        );
    }
    writeln!(
        out,
        "{} scenes of {}x{} in {}",
        args.count,
        args.size.width,
        args.size.height,
        target.display()
    )?;
    Ok(0)
}

fn render_scene(
    args: &SceneArgs,
    index: u32,
    renderer: &mut Renderer,
    folder: &Path,
) -> anyhow::Result<String> {
    let (seed, t_s) = scene_moment(args.seed, index);
    let world = World {
        look: args.look,
        without: args.without.clone(),
        ..World::default()
    };
    let scene = renderer.render(&Drive::new(&world, seed, &args.condition), t_s);
    let size = (args.size.width, args.size.height);
    let line = SceneLine {
        frame: format!("frames/{index:06}.png"),
        mask: format!("masks/{index:06}.png"),
        seed,
        t_s,
        look: args.look.name(),
        without: args.without.iter().map(|e| e.name()).collect(),
        conditions: args.condition.iter().map(ToString::to_string).collect(),
        sha256: hash_of(&scene),
    };
    write_png(
        &folder.join(&line.frame),
        scene.rgb,
        size,
        ExtendedColorType::Rgb8,
    )?;
    write_png(
        &folder.join(&line.mask),
        scene.mask,
        size,
        ExtendedColorType::L8,
    )?;
    Ok(serde_json::to_string(&line)? + "\n")
}

fn hash_of(scene: &Labelled<'_>) -> String {
    let hash = Sha256::new()
        .chain_update(scene.rgb)
        .chain_update(scene.mask)
        .finalize();
    hash.iter().map(|byte| format!("{byte:02x}")).collect()
}
