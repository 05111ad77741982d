//! Lane models on real pictures with drawn lanes: rows and tables.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use gapwatch::capture::open;
use gapwatch::capture::pixels::Pixels;
use gapwatch::features::energies::EnergyStage;
use gapwatch::lab::evaluation::real_lanes::{
    Drawing, DrawnLanes, Foretold, RealLanes, between_drawings, foretold, foretold_by_block, found,
};
use gapwatch::model::ModelSpec;
use gapwatch::model::encoder::Encoder;
use gapwatch::monitor::scorer::Scorer;
use gapwatch::reference::{ModelFingerprint, Reference};

use super::super::progress;
use super::lane_iou;
use super::results::Row;
use super::sheet::{Sheet, with_interval};
use crate::cli::args::EvaluateArgs;

/// What the rows mean.
pub const ABOUT: &str = "Lane models on real pictures, and on pictures of other simulators, whose lanes were drawn by \
    hand (`calibration/real_lanes.json` says how). Precision is the share of the model's lane pixels within 2 pixels of a \
    drawn line, recall the share of the drawn pixels within 2 pixels of the model's, at a width of 320, both over the rows \
    in which lanes are drawn; F1 is their harmonic mean, pooled over all pixels. The forecast is that of the reference, \
    from one picture alone; the loss is 1 - F1 of the same picture, and lanes are lost where F1 is below a half. Intervals \
    are 95 %, from resampling blocks of 10 s. Nothing was chosen on the last 70 s of `california_hills`.";

/// The drawings, shipped with the program.
const DRAWN: &str = include_str!("../../../calibration/real_lanes.json");
/// Width and height at which two drawings of a picture are compared, pixels.
const COMPARED_AT: (usize, usize) = (320, 160);

/// The drawings, the folder of their pictures, and the models to judge.
pub struct Drawn {
    lanes: DrawnLanes,
    folder: PathBuf,
    models: Vec<(ModelSpec, Encoder)>,
    reference: Reference,
}

impl Drawn {
    /// Opens everything. A model that names no lane output is refused, and so is a picture that is missing.
    pub fn open(folder: &Path, args: &EvaluateArgs) -> anyhow::Result<Self> {
        let lanes: DrawnLanes = serde_json::from_str(DRAWN).context("the drawn lanes")?;
        for drawing in lanes.frames.iter().chain(&lanes.again) {
            if let Some(fault) = drawing.fault() {
                bail!("the drawn lanes: {fault}");
            }
            let file = folder.join(&drawing.image);
            if !file.exists() {
                bail!(
                    "{}: no such file; wanted the image sets that calibration/README.md lists in --field {}",
                    file.display(),
                    folder.display()
                );
            }
        }
        Ok(Self {
            lanes,
            folder: folder.to_owned(),
            models: lane_iou::models(&args.model)?,
            reference: Reference::read(args.reference.as_deref())?,
        })
    }

    /// The pixels of a drawn picture.
    fn pixels(&self, drawing: &Drawing) -> anyhow::Result<Pixels> {
        let file = self.folder.join(&drawing.image).display().to_string();
        let wanted = drawing.frame.unwrap_or(0);
        let mut source = open(&file)?;
        while let Some(frame) = source.next_frame()? {
            if frame.sequence < wanted {
                continue;
            }
            let pixels = frame
                .picture
                .map_err(|why| anyhow::anyhow!("{file}: {why}"))?;
            let size = (pixels.layout().width, pixels.layout().height);
            if size != (drawing.width, drawing.height) {
                bail!(
                    "{file}: {}x{} pixels; wanted {}x{}, on which the lanes are drawn",
                    size.0,
                    size.1,
                    drawing.width,
                    drawing.height
                );
            }
            return Ok(pixels);
        }
        bail!("{file}: has no frame {wanted}")
    }
}

/// Judges every model on every picture. Only the model that the reference fits has a forecast.
pub fn rows(drawn: &Drawn, built_in: &str) -> anyhow::Result<Vec<Row<RealLanes>>> {
    let frames = &drawn.lanes.frames;
    let total = frames.len() * drawn.models.len();
    let bar = progress::over(Some(total as u64), "real lanes", "pictures");
    let pictures: Vec<Pixels> = frames
        .iter()
        .map(|drawing| drawn.pixels(drawing))
        .collect::<anyhow::Result<_>>()?;
    let mut rows = Vec::new();
    for (spec, encoder) in &drawn.models {
        let default = encoder.sha256() == built_in;
        let fits = drawn
            .reference
            .check_fits("the reference", &ModelFingerprint::new(spec, encoder));
        let mut stage = EnergyStage::new(encoder, &spec.preprocessing)?;
        for (drawing, pixels) in frames.iter().zip(&pictures) {
            let judged = stage.energies_of(pixels).map(|_| ());
            judged.map_err(|why| anyhow::anyhow!("{}: {why}", drawing.image))?;
            let forecast = match &fits {
                Ok(()) => {
                    let mut scorer = Scorer::new(&drawn.reference, stage.common_size());
                    let seen = scorer.observe(Default::default(), stage.maps(), stage.means());
                    seen.ok().and_then(|evidence| evidence.lanes)
                }
                Err(_) => None,
            };
            let answer = stage.lane().context("the model has no lane output")?;
            let of = RealLanes::of(&spec.name, drawing, answer, forecast);
            rows.push(Row { of, default });
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    Ok(rows)
}

/// A table of lanes for each model, one of its forecast, and how well two drawings agree.
pub fn sheets(rows: &[Row<RealLanes>]) -> Vec<Sheet> {
    let mut models: Vec<&str> = rows.iter().map(|row| row.of.model.as_str()).collect();
    models.dedup();
    let mut sheets = Vec::new();
    for model in models {
        let own: Vec<&RealLanes> = rows
            .iter()
            .map(|row| &row.of)
            .filter(|of| of.model == model)
            .collect();
        sheets.push(lanes(model, &own));
        if own.iter().any(|of| of.forecast.is_some()) {
            sheets.push(forecasts(model, &own));
        }
    }
    let drawn: Option<DrawnLanes> = serde_json::from_str(DRAWN).ok();
    let between = drawn.and_then(|lanes| {
        let (width, height) = COMPARED_AT;
        Some((lanes.again.len(), between_drawings(&lanes, width, height)?))
    });
    if let (Some((count, f1)), Some(sheet)) = (between, sheets.first_mut()) {
        sheet.notes.push(format!(
            "F1 of one drawing against another of the same picture, {count} pictures: {f1:.3}"
        ));
    }
    sheets
}

/// Names of sets with their rows: each set, and all sets of real roads together.
fn sets<'a>(rows: &[&'a RealLanes]) -> Vec<(String, Vec<&'a RealLanes>)> {
    let mut names: Vec<&str> = rows.iter().map(|of| of.set.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    let of = |wanted: &dyn Fn(&str) -> bool| -> Vec<&'a RealLanes> {
        rows.iter().copied().filter(|of| wanted(&of.set)).collect()
    };
    let mut sets: Vec<(String, Vec<&RealLanes>)> = names
        .iter()
        .map(|&name| (name.to_owned(), of(&|set| set == name)))
        .collect();
    sets.push((
        "all real roads".to_owned(),
        of(&|set| set.starts_with("california")),
    ));
    sets
}

fn lanes(model: &str, rows: &[&RealLanes]) -> Sheet {
    let mut sheet = Sheet::new(
        format!("{model}: lanes on drawn pictures"),
        [
            "set",
            "pictures",
            "F1 within 2 px",
            "precision",
            "recall",
            "IoU",
        ],
    );
    let number =
        |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
    for (name, own) in sets(rows) {
        let (agreement, interval, iou) = found(&own);
        sheet.rows.push(vec![
            name,
            own.len().to_string(),
            agreement
                .f1()
                .map_or_else(|| "-".to_owned(), |f1| with_interval(f1, interval, 3)),
            number(agreement.precision()),
            number(agreement.recall()),
            number(iou),
        ]);
    }
    sheet
}

fn forecasts(model: &str, rows: &[&RealLanes]) -> Sheet {
    let mut sheet = Sheet::new(
        format!("{model}: forecast of lost lanes on drawn pictures"),
        [
            "set",
            "judged",
            "lost",
            "mean loss",
            "mean forecast",
            "Spearman",
            "mean absolute error",
            "AUROC, lost",
        ],
    );
    let shown = |value: Option<(f64, Option<(f64, f64)>)>| {
        value.map_or_else(
            || "-".to_owned(),
            |(value, interval)| with_interval(value, interval, 3),
        )
    };
    let mut add = |name: String, means: Option<(f64, f64)>, of: &Foretold| {
        let mean = |value: Option<f64>| {
            value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"))
        };
        sheet.rows.push(vec![
            name,
            of.count.to_string(),
            of.lost.to_string(),
            mean(means.map(|means| means.1)),
            mean(means.map(|means| means.0)),
            shown(of.spearman),
            shown(of.mean_absolute_error),
            shown(of.auroc),
        ]);
    };
    for (name, own) in sets(rows) {
        let means = RealLanes::means(&own);
        let by_block = own.iter().any(|of| of.t_s.is_some());
        add(name.clone(), means, &foretold(&own));
        if by_block {
            add(format!("{name}, by 10 s"), means, &foretold_by_block(&own));
        }
    }
    sheet
}
