//! `gapwatch inspect`: what the model sees, as pictures and numbers.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::{Context, bail};
use gapwatch::capture::{Frame, Picture, open};
use gapwatch::features::attention::{EnergyMap, Upsampler};
use gapwatch::features::energies::{BlockMeans, CELLS, EnergyStage, GRID};
use gapwatch::features::heat;
use gapwatch::features::histogram::Binning;
use gapwatch::features::lane::energy_on_lanes;
use gapwatch::lab::profile_chart;
use gapwatch::model::ModelSpec;
use gapwatch::model::encoder::Encoder;
use gapwatch::monitor::detector::BlockScore;
use gapwatch::monitor::profile::TapProfile;
use gapwatch::monitor::scorer::Scorer;
use gapwatch::reference::{ModelFingerprint, Nominal, Reference, TapReference};
use image::ExtendedColorType;
use serde::Serialize;

use super::new_folder::NewFolder;
use super::pictures::write_png;
use super::{progress, signals};
use crate::cli::args::InspectArgs;

/// Panels of a sheet are enlarged by a whole factor to at least this width, pixels.
const PANEL_WIDTH_PX: u32 = 480;

/// `inspect.json`.
#[derive(Serialize)]
struct Inspection {
    source: String,
    model: String,
    /// How gaps are measured; `None` without a reference for this model.
    metric: Option<String>,
    frames: Vec<Inspected>,
    median: BTreeMap<String, TapNumbers>,
}

/// One frame.
#[derive(Serialize)]
struct Inspected {
    frame: u64,
    t_s: f64,
    sheet: Option<String>,
    /// Reason why there is no sheet.
    reason: Option<String>,
    /// Share of the picture that the model marks as lane.
    lane_area: Option<f64>,
    taps: BTreeMap<String, TapNumbers>,
}

/// Numbers of one tap, of a frame or as the median over frames.
#[derive(Clone, Default, Serialize)]
struct TapNumbers {
    peak_energy: Option<f64>,
    /// Share of the energy on what the model marks as lane.
    energy_on_lanes: Option<f64>,
    /// That share as a multiple of the lanes' share of the picture.
    lift: Option<f64>,
    /// Gap of only this frame, in the reference's metric.
    gap: Option<f64>,
    /// Score: 0 is nominal, 1 is the alarm threshold for windows of one frame.
    score: Option<f64>,
    /// Which part of the picture differs from the reference.
    regions: Option<Regions>,
    /// Live numbers beside the reference's, of a frame.
    profile: Option<Profile>,
}

/// What causes a gap.
#[derive(Clone, Serialize)]
struct Profile {
    #[serde(flatten)]
    of_tap: TapProfile,
    /// For a histogram: live shares of the bins before the first counted bin, relative to what is counted.
    left_out: Vec<f64>,
}

/// Regions of the picture, row by row from the top.
#[derive(Clone, Serialize)]
struct Regions {
    /// Deviation of the region's log energy from its nominal mean, in nominal spreads.
    deviation: [[f64; GRID]; GRID],
    /// Share of the sum of the squared deviations.
    share: [[f64; GRID]; GRID],
}

/// What a frame is compared with.
struct Comparison {
    reference: Reference,
    common_size: (usize, usize),
}

pub fn run(args: &InspectArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    let spec = ModelSpec::new(args.model.model.as_deref(), args.model.options())?;
    let encoder = Encoder::load_with_lane(&spec)?;
    let mut stage = EnergyStage::new(&encoder, &spec.preprocessing)?;
    let mut comparison = Comparison::new(args, &spec, &encoder, stage.common_size())?;
    let total = count(&args.source)?;
    let wanted = total.min(u64::from(args.count));
    if wanted == 0 {
        bail!("{}: it has no frames", args.source);
    }
    let stop = signals::stop()?;
    let folder = NewFolder::beside(&args.out)?;
    let mut source = open(&args.source)?;
    let bar = progress::frames(Some(total), "inspecting");
    let mut frames: Vec<Inspected> = Vec::new();
    while !stop.load(Ordering::Relaxed)
        && let Some(frame) = source.next_frame()?
    {
        // The chosen frames are evenly spread: frame i of n is taken where i * wanted / n steps up.
        let chosen = frame.sequence * wanted % total < wanted;
        if chosen {
            let compared = comparison.as_mut();
            frames.push(inspect(&frame, &spec, &mut stage, compared, &folder)?);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let inspection = Inspection {
        source: args.source.clone(),
        model: spec.name.clone(),
        metric: comparison.as_ref().map(|c| c.reference.metric.to_string()),
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
    if stop.load(Ordering::Relaxed) {
        bail!(
            "{}: stopped by a signal; it has {} of {wanted} frames, which are complete",
            args.out.display(),
            inspection.frames.len()
        );
    }
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
            score,
            regions,
            ..
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
        if let Some(score) = score.filter(|&score| score >= 1.0) {
            write!(out, ", score {score:.2}")?;
            if let Some(regions) = regions {
                let (row, column, share) = regions.largest();
                write!(
                    out,
                    ", most of it in row {}, column {} of 4x4 ({:.0} %)",
                    row + 1,
                    column + 1,
                    100.0 * share
                )?;
            }
        }
        writeln!(out)?;
    }
    Ok(0)
}

impl Comparison {
    /// Uses the reference that is asked for, or the one inside the program if it fits the model.
    fn new(
        args: &InspectArgs,
        spec: &ModelSpec,
        encoder: &Encoder,
        common_size: (usize, usize),
    ) -> anyhow::Result<Option<Self>> {
        let reference = Reference::read(args.reference.as_deref())?;
        let model = ModelFingerprint::new(spec, encoder);
        match &args.reference {
            Some(file) => reference.check_fits(&file.display().to_string(), &model)?,
            None if reference.check_fits(Reference::BUILT_IN, &model).is_err() => return Ok(None),
            None => {}
        }
        Ok(Some(Self {
            reference,
            common_size,
        }))
    }

    /// One entry for each tap of a single frame; empty if the frame cannot be judged.
    fn compare(
        &mut self,
        maps: &[EnergyMap],
        means: &[BlockMeans],
    ) -> Vec<(BlockScore, TapProfile)> {
        let mut scorer = Scorer::new(&self.reference, self.common_size);
        let seen = scorer.observe(Duration::ZERO, maps, means);
        let blocks = seen.map(|seen| seen.blocks).unwrap_or_default();
        blocks.into_iter().zip(scorer.profiles()).collect()
    }
}

/// The bins that a histogram leaves out, before the first bin that it counts; empty if everything is counted.
#[allow(clippy::cast_precision_loss)]
fn left_out(nominal: &Nominal, common: &EnergyMap) -> Vec<f64> {
    let Nominal::Histogram {
        binning:
            Binning::Attention {
                temperature,
                levels,
                first,
            },
        ..
    } = nominal
    else {
        return Vec::new();
    };
    let all = Binning::Attention {
        temperature: *temperature,
        levels: *levels,
        first: 0,
    };
    let mut counts = vec![0; *levels];
    if all.count(common, &mut counts).is_err() {
        return Vec::new();
    }
    let (before, counted) = counts.split_at(*first);
    let total = counted.iter().sum::<u32>().max(1) as f64;
    before.iter().map(|&count| count as f64 / total).collect()
}

impl Regions {
    /// The median of each region over the frames that have it.
    fn median(tap: &str, frames: &[Inspected]) -> Option<Self> {
        let of_frames: Vec<&Self> = frames
            .iter()
            .filter_map(|frame| frame.taps.get(tap)?.regions.as_ref())
            .collect();
        let median = |of: fn(&Self) -> &[[f64; GRID]; GRID]| {
            std::array::from_fn(|row| {
                std::array::from_fn(|column| {
                    let mut values: Vec<f64> =
                        of_frames.iter().map(|r| of(r)[row][column]).collect();
                    values.sort_by(f64::total_cmp);
                    values.get(values.len() / 2).copied().unwrap_or_default()
                })
            })
        };
        (!of_frames.is_empty()).then(|| Self {
            deviation: median(|r| &r.deviation),
            share: median(|r| &r.share),
        })
    }

    /// Row, column and share of the region that differs most.
    fn largest(&self) -> (usize, usize, f64) {
        let mut largest = (0, 0, 0.0);
        for (row, shares) in self.share.iter().enumerate() {
            for (column, &share) in shares.iter().enumerate() {
                if share > largest.2 {
                    largest = (row, column, share);
                }
            }
        }
        largest
    }
}

fn in_rows(cells: &[f64; CELLS]) -> [[f64; GRID]; GRID] {
    std::array::from_fn(|row| std::array::from_fn(|column| cells[row * GRID + column]))
}

/// Number of frames of a source. A source that does not give it is read to its end.
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
    comparison: Option<&mut Comparison>,
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
    let maps: Vec<EnergyMap> = match frame.pixels().and_then(|pixels| stage.energies_of(pixels)) {
        Ok(maps) => maps.to_vec(),
        Err(why) => {
            inspected.reason = Some(why.to_string());
            return Ok(inspected);
        }
    };
    let seen = stage.seen();
    let lane = stage.lane();
    inspected.lane_area = lane.map(|lane| lane.area());
    let mut compared = Vec::new();
    let mut counted_as: &[TapReference] = &[];
    if let Some(comparison) = comparison {
        compared = comparison.compare(&maps, stage.means());
        counted_as = &comparison.reference.components[0].taps;
    }
    let mut differs: Vec<Picture> = vec![seen.clone()];
    let mut charts: Vec<Picture> = vec![seen.clone()];
    let mut panels: Vec<Picture> = vec![match lane {
        Some(lane) => heat::with_lanes(&seen, lane),
        None => seen.clone(),
    }];
    for (index, (tap, map)) in spec.taps.iter().zip(&maps).enumerate() {
        let of_tap = compared.get(index);
        let deviations = of_tap.and_then(|(_, profile)| profile.cell_deviations());
        if let Some(deviations) = &deviations {
            differs.push(heat::with_regions(&seen, deviations));
        }
        panels.push(heat::with_energy(&seen, map));
        let mut common = EnergyMap::default();
        Upsampler::new((map.width, map.height), stage.common_size()).resample(map, &mut common);
        let profile = of_tap
            .zip(counted_as.get(index))
            .map(|((_, profile), tap)| {
                let left_out = left_out(&tap.nominal, &common);
                charts.push(profile_chart::panel(
                    profile,
                    &left_out,
                    (seen.width, seen.height),
                ));
                Profile {
                    of_tap: profile.clone(),
                    left_out,
                }
            });
        let on_lanes = lane.and_then(|lane| energy_on_lanes(&common, lane));
        let area = inspected.lane_area.filter(|&area| area > 0.0);
        inspected.taps.insert(
            tap.clone(),
            TapNumbers {
                peak_energy: Some(map.range().1),
                energy_on_lanes: on_lanes.filter(|_| area.is_some()),
                lift: on_lanes.zip(area).map(|(share, area)| share / area),
                gap: of_tap.map(|(block, _)| block.gap),
                score: of_tap.map(|(block, _)| block.score),
                regions: of_tap.and_then(|(_, profile)| {
                    Some(Regions {
                        deviation: in_rows(&profile.cell_deviations()?),
                        share: in_rows(&profile.cell_shares()?),
                    })
                }),
                profile,
            },
        );
    }
    let scale = PANEL_WIDTH_PX.div_ceil(seen.width);
    let columns = panels.len();
    for row in [differs, charts] {
        if row.len() == columns {
            panels.extend(row);
        }
    }
    let sheet = heat::sheet(&panels, columns, scale as usize);
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
        gap: median(|n| n.gap),
        score: median(|n| n.score),
        regions: Regions::median(tap, frames),
        profile: None,
    }
}
