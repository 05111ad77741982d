//! `gapwatch inspect`: what the model sees, as pictures and numbers.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;

use anyhow::{Context, bail};
use gapwatch::attention::{EnergyMap, Upsampler};
use gapwatch::encoder::Encoder;
use gapwatch::energies::EnergyStage;
use gapwatch::frame::{Frame, Picture, open};
use gapwatch::heat;
use gapwatch::lane::energy_on_lanes;
use gapwatch::model::ModelSpec;
use image::ExtendedColorType;
use serde::Serialize;

use super::new_folder::NewFolder;
use super::pictures::write_png;
use crate::args::InspectArgs;

/// Panels of a sheet are enlarged, by a whole factor, to at least this width, pixels.
const PANEL_WIDTH_PX: u32 = 480;

/// `inspect.json`.
#[derive(Serialize)]
struct Inspection {
    source: String,
    model: String,
    frames: Vec<Inspected>,
    median: BTreeMap<String, TapNumbers>,
}

/// One frame.
#[derive(Serialize)]
struct Inspected {
    frame: u64,
    t_s: f64,
    sheet: Option<String>,
    /// Why there is no sheet.
    reason: Option<String>,
    /// Share of the picture that the model calls lane.
    lane_area: Option<f64>,
    taps: BTreeMap<String, TapNumbers>,
}

/// One tap, of a frame or the median over frames.
#[derive(Clone, Default, Serialize)]
struct TapNumbers {
    peak_energy: Option<f64>,
    /// Share of the energy on what the model calls lane.
    energy_on_lanes: Option<f64>,
    /// That share as a multiple of the lanes' share of the picture.
    lift: Option<f64>,
}

pub fn run(args: &InspectArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    let spec = ModelSpec::new(args.model.model.as_deref(), args.model.options())?;
    let encoder = Encoder::load_with_lane(&spec)?;
    let mut stage = EnergyStage::new(&encoder, &spec.preprocessing)?;
    let total = count(&args.source)?;
    let wanted = total.min(u64::from(args.count));
    if wanted == 0 {
        bail!("{}: it has no frames", args.source);
    }
    let folder = NewFolder::beside(&args.out)?;
    let mut source = open(&args.source)?;
    let mut frames: Vec<Inspected> = Vec::new();
    while let Some(frame) = source.next_frame()? {
        // Evenly spread: frame i of n is taken where i * wanted / n steps up.
        let chosen = frame.sequence * wanted % total < wanted;
        if chosen {
            frames.push(inspect(&frame, &spec, &mut stage, &folder)?);
        }
    }
    let inspection = Inspection {
        source: args.source.clone(),
        model: spec.name.clone(),
        median: spec
            .taps
            .iter()
            .map(|tap| (tap.clone(), medians(tap, &frames)))
            .collect(),
        frames,
    };
    let json = serde_json::to_string_pretty(&inspection)? + "\n";
    let file = folder.path().join("inspect.json");
    fs::write(&file, json).with_context(|| format!("cannot write {}", file.display()))?;
    folder.keep()?;
    let sheets = inspection.frames.iter().filter(|f| f.sheet.is_some());
    writeln!(
        out,
        "{}: {} sheets of {} frames",
        args.out.display(),
        sheets.count(),
        inspection.frames.len()
    )?;
    for tap in &spec.taps {
        let TapNumbers {
            peak_energy,
            energy_on_lanes,
            lift,
        } = &inspection.median[tap];
        let Some(peak) = peak_energy else { continue };
        write!(out, "  {tap}: median peak energy {peak:.1}")?;
        if let (Some(share), Some(lift)) = (energy_on_lanes, lift) {
            write!(
                out,
                ", {:.1} % of the energy on the model's lanes, {lift:.1} times their share of the picture",
                100.0 * share
            )?;
        }
        writeln!(out)?;
    }
    Ok(0)
}

/// How many frames a source has; one that does not say is read through.
fn count(name: &str) -> anyhow::Result<u64> {
    let mut source = open(name)?;
    if let Some(count) = source.frame_count() {
        return Ok(count);
    }
    let mut count = 0;
    while source.next_frame()?.is_some() {
        count += 1;
    }
    Ok(count)
}

fn inspect(
    frame: &Frame,
    spec: &ModelSpec,
    stage: &mut EnergyStage,
    folder: &NewFolder,
) -> anyhow::Result<Inspected> {
    let mut inspected = Inspected {
        frame: frame.sequence,
        t_s: frame.captured_at.as_secs_f64(),
        sheet: None,
        reason: None,
        lane_area: None,
        taps: BTreeMap::new(),
    };
    let maps: Vec<EnergyMap> = match stage.energies(frame) {
        Ok(maps) => maps.to_vec(),
        Err(why) => {
            inspected.reason = Some(why.to_string());
            return Ok(inspected);
        }
    };
    let seen = stage.seen();
    let lane = stage.lane();
    inspected.lane_area = lane.map(|lane| lane.area());
    let mut panels: Vec<Picture> = vec![match lane {
        Some(lane) => heat::with_lanes(&seen, lane),
        None => seen.clone(),
    }];
    for (tap, map) in spec.taps.iter().zip(&maps) {
        panels.push(heat::with_energy(&seen, map));
        let mut common = EnergyMap::default();
        Upsampler::new((map.width, map.height), stage.common_size()).resample(map, &mut common);
        let on_lanes = lane.and_then(|lane| energy_on_lanes(&common, lane));
        let area = inspected.lane_area.filter(|&area| area > 0.0);
        inspected.taps.insert(
            tap.clone(),
            TapNumbers {
                peak_energy: Some(map.range().1),
                energy_on_lanes: on_lanes.filter(|_| area.is_some()),
                lift: on_lanes.zip(area).map(|(share, area)| share / area),
            },
        );
    }
    let scale = PANEL_WIDTH_PX.div_ceil(seen.width);
    let sheet = heat::sheet(&panels, 2, scale as usize);
    let name = format!("{:06}.png", frame.sequence);
    write_png(
        &folder.path().join(&name),
        &sheet.rgb,
        (sheet.width, sheet.height),
        ExtendedColorType::Rgb8,
    )?;
    inspected.sheet = Some(name);
    Ok(inspected)
}

fn medians(tap: &str, frames: &[Inspected]) -> TapNumbers {
    let median = |of: fn(&TapNumbers) -> Option<f64>| {
        let numbers = frames.iter().filter_map(|frame| frame.taps.get(tap));
        let mut values: Vec<f64> = numbers.filter_map(of).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    TapNumbers {
        peak_energy: median(|n| n.peak_energy),
        energy_on_lanes: median(|n| n.energy_on_lanes),
        lift: median(|n| n.lift),
    }
}
