//! Speed against error: rows, table and picture.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use gapwatch::capture::pixels::PixelFormat;
use gapwatch::capture::{Frame, open};
use gapwatch::files::whole_file::WholeFile;
use gapwatch::lab::camera_buffers::buffer_of;
use gapwatch::lab::evaluation::lane_failure::{self, Sizes};
use gapwatch::lab::evaluation::speed_error::{self, SIZES, SpeedError, front};
use gapwatch::live::cost::thread_cpu_time;
use gapwatch::model::encoder::Encoder;
use gapwatch::model::{ModelOptions, ModelSpec};
use gapwatch::monitor::pipeline::Monitor;
use plotters::prelude::{
    BLACK, ChartBuilder, Circle, Color, IntoDrawingArea, IntoLogRange, Palette, Palette99,
    SVGBackend, SeriesLabelPosition, WHITE,
};

use super::super::progress;
use super::super::quick_reference::made_for;
use super::results::Row;
use super::sheet::{Sheet, with_interval};
use crate::cli::args::EvaluateArgs;
use crate::cli::loaded_model::LoadedModel;

/// What the rows mean.
pub const ABOUT: &str = "Cost of a judged second of driving, and what is missed, at thresholds for one false alarm an \
    hour. Cost is CPU time on one thread, from a camera's buffer of 1280x720 YUYV to the verdict, with all taps, on \
    the machine that made this table. Missed drives are drives under a condition of severity 3 to 5 in which `Gap` was \
    not entered within 2 s after the condition had reached its severity. The condition grows for 2 s, and the delay \
    counts from its beginning. AUROC is about failed seconds of the lane model, by the default metric and by \
    `lane-risk`. A point is on the front if no other point is better in cost, missed share, delay and AUROC by \
    `lane-risk` together.";

/// Number of frames whose cost is measured, and of frames before them that fill buffers.
const MEASURED: u32 = 60;
const WARM_UP: u32 = 5;
/// The camera's pictures, pixels.
const SIZE: (u32, u32) = (1280, 720);

const QUICK: Sizes = Sizes::QUICK;

/// Lane models in the order given; the built-in model if none is given.
pub fn models(files: &[PathBuf]) -> anyhow::Result<Vec<(ModelSpec, bool)>> {
    let files: Vec<Option<&Path>> = match files {
        [] => vec![None],
        files => files.iter().map(|file| Some(file.as_path())).collect(),
    };
    let built_in = ModelSpec::new(None, ModelOptions::default())?;
    let default = Encoder::load(&built_in)?.sha256().to_owned();
    let opened = files.into_iter().map(|file| {
        let spec = ModelSpec::new(file, ModelOptions::default())?;
        if spec.lane.is_none() {
            bail!(
                "{}: no lane output is named; wanted lane = \"NAME\" in the .toml beside it",
                spec.name
            );
        }
        let is_default = Encoder::load(&spec)?.sha256() == default;
        Ok((spec, is_default))
    });
    opened.collect()
}

/// Measures every point of every model.
pub fn rows(
    models: &[(ModelSpec, bool)],
    args: &EvaluateArgs,
) -> anyhow::Result<Vec<Row<SpeedError>>> {
    let sizes = if args.quick { QUICK } else { SIZES };
    let mut rows = Vec::new();
    for (spec, is_default) in models {
        let frame_ms = frame_ms(spec)?;
        let bar = progress::frames(Some(sizes.drives()), &spec.name);
        let encoder = Encoder::load_with_lane(spec)?;
        let of_model = speed_error::rows(
            &name_of(spec),
            &spec.taps,
            &encoder,
            &spec.preprocessing,
            sizes,
            frame_ms,
            &|| bar.inc(1),
        )?;
        bar.finish_and_clear();
        rows.extend(of_model.into_iter().map(|of| Row {
            default: *is_default && is_shipped(&of, spec.taps.len()),
            of,
        }));
    }
    Ok(rows)
}

/// Name of the ONNX file, without its folder.
fn name_of(spec: &ModelSpec) -> String {
    let stem = Path::new(&spec.name).file_stem();
    stem.map_or_else(
        || spec.name.clone(),
        |stem| stem.to_string_lossy().into_owned(),
    )
}

/// Whether a point has all taps, a window of 1 s, and the rate that is nearest to the rate of boards.
fn is_shipped(of: &SpeedError, taps: usize) -> bool {
    of.taps.len() == taps && (of.window_s - 1.0).abs() < 1e-9 && (of.fps - 5.0).abs() < 1e-9
}

/// CPU time of a frame, from buffer to verdict, on one thread that does nothing else.
fn frame_ms(spec: &ModelSpec) -> anyhow::Result<f64> {
    let model = LoadedModel::load_spec(spec)?;
    let reference = made_for(&model)?;
    let mut monitor = Monitor::new(&model.encoder, &reference)?;
    let (width, height) = SIZE;
    let mut source = open(&format!(
        "scene:sim?seed=7&seconds=1&fps=6&size={width}x{height}"
    ))?;
    let mut buffers = Vec::new();
    while let Some(frame) = source.next_frame()? {
        buffers.push(buffer_of(&frame.picture?.picture(), PixelFormat::Yuyv)?);
    }
    let mut before = Duration::ZERO;
    for (n, (layout, bytes)) in (0..WARM_UP + MEASURED).zip(buffers.iter().cycle()) {
        if n == WARM_UP {
            before = thread_cpu_time();
        }
        let pixels = layout.pixels(bytes).map_err(|why| anyhow!(why))?;
        monitor.step(&Frame {
            sequence: n.into(),
            captured_at: Duration::from_millis(100) * n,
            picture: Ok(pixels),
        });
    }
    Ok((thread_cpu_time().saturating_sub(before) / MEASURED).as_secs_f64() * 1e3)
}

/// The seeds of what is rendered.
pub fn seeds(quick: bool) -> String {
    lane_failure::seeds_of(if quick { QUICK } else { SIZES })
}

/// One table, with the cheapest point first.
pub fn sheets(rows: &[Row<SpeedError>]) -> Vec<Sheet> {
    let points: Vec<SpeedError> = rows.iter().map(|row| row.of.clone()).collect();
    let on_front = front(&points);
    let mut order: Vec<usize> = (0..rows.len()).collect();
    order.sort_by(|&a, &b| points[a].second_ms.total_cmp(&points[b].second_ms));
    let mut sheet = Sheet::new(
        "Cost of a judged second against what is missed".to_owned(),
        [
            "model",
            "taps",
            "window, s",
            "frames a second",
            "ms a frame",
            "ms a second",
            "missed, %",
            "of",
            "delay, s",
            "AUROC",
            "AUROC, lane-risk",
            "false alarms an hour",
            "front",
        ],
    );
    let number = |value: Option<f64>, decimals: usize| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{value:.decimals$}"))
    };
    for index in order {
        let of = &points[index];
        let percent = |share: f64| 100.0 * share;
        let (low, high) = of.missed_interval;
        // There are few hours and few entries.
        #[allow(clippy::cast_precision_loss)]
        let an_hour = of.false_alarms as f64 / of.nominal_hours.max(f64::MIN_POSITIVE);
        let mark = match (on_front[index], rows[index].default) {
            (true, true) => "yes, default",
            (true, false) => "yes",
            (false, true) => "default",
            (false, false) => "",
        };
        sheet.rows.push(vec![
            of.model.clone(),
            of.taps.join(" "),
            of.window_s.to_string(),
            of.fps.to_string(),
            format!("{:.2}", of.frame_ms),
            format!("{:.1}", of.second_ms),
            with_interval(
                percent(of.missed_share()),
                Some((percent(low), percent(high))),
                0,
            ),
            of.severe.to_string(),
            number(of.delay_median_s, 1),
            number(of.auroc, 3),
            number(of.risk_auroc, 3),
            with_interval(an_hour, Some(of.false_alarms_interval), 1),
            mark.to_owned(),
        ]);
    }
    vec![sheet]
}

/// Describes the point that misses least at a cost of at most `percent` of one core; of several such points, the
/// cheapest one.
pub fn within(rows: &[Row<SpeedError>], percent: f64) -> anyhow::Result<String> {
    let affordable = rows.iter().filter(|row| row.of.second_ms <= 10.0 * percent);
    let best = affordable.min_by(|a, b| {
        let missed = a.of.missed_share().total_cmp(&b.of.missed_share());
        missed.then(a.of.second_ms.total_cmp(&b.of.second_ms))
    });
    let Some(Row { of, .. }) = best else {
        let cheapest = rows
            .iter()
            .map(|row| row.of.second_ms)
            .fold(f64::INFINITY, f64::min);
        bail!(
            "no point costs at most {percent} % of a core; the cheapest costs {:.1} %",
            cheapest / 10.0
        );
    };
    Ok(format!(
        "within {percent} % of a core: {}, taps {}, window {} s, {} frames a second: {:.1} % of a core, {:.1} % missed \
         (calibrate --model --taps --window; rate_hz of the board)",
        of.model,
        of.taps.join(","),
        of.window_s,
        of.fps,
        of.second_ms / 10.0,
        100.0 * of.missed_share()
    ))
}

/// Draws every point by cost and missed share, in one colour for each model. Points on the front are filled.
pub fn plot(rows: &[Row<SpeedError>], path: &Path) -> anyhow::Result<()> {
    let points: Vec<SpeedError> = rows.iter().map(|row| row.of.clone()).collect();
    let mut svg = String::new();
    draw(&points, rows, &mut svg).map_err(|why| anyhow!("the picture cannot be drawn: {why}"))?;
    let mut file = WholeFile::create(path).with_context(|| path.display().to_string())?;
    std::io::Write::write_all(&mut file, svg.as_bytes())?;
    file.finish().with_context(|| path.display().to_string())?;
    Ok(())
}

fn draw(
    points: &[SpeedError],
    rows: &[Row<SpeedError>],
    svg: &mut String,
) -> Result<(), Box<dyn std::error::Error>> {
    let costs = points.iter().map(|of| of.second_ms);
    let (least, most) = costs.fold((f64::INFINITY, 0.0_f64), |(low, high), cost| {
        (low.min(cost), high.max(cost))
    });
    let missed = points.iter().map(SpeedError::missed_share);
    let highest = (120.0 * missed.fold(0.0, f64::max)).clamp(10.0, 100.0);
    let area = SVGBackend::with_string(svg, (900, 560)).into_drawing_area();
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&area)
        .caption(
            "Cost of a judged second against what is missed",
            ("sans-serif", 20),
        )
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(56)
        .build_cartesian_2d((0.8 * least..1.25 * most).log_scale(), 0.0..highest)?;
    chart
        .configure_mesh()
        .x_desc("CPU time of a judged second, ms (one thread)")
        .y_desc("severe conditions missed, %")
        .x_label_formatter(&|x| format!("{x:.0}"))
        .light_line_style(BLACK.mix(0.04))
        .draw()?;
    let at = |of: &SpeedError| (of.second_ms, 100.0 * of.missed_share());
    let on_front = front(points);
    let mut models: Vec<&str> = points.iter().map(|of| of.model.as_str()).collect();
    models.dedup();
    for (n, model) in models.into_iter().enumerate() {
        let colour = Palette99::pick(n).to_rgba();
        let own = points.iter().zip(&on_front);
        let own = own.filter(|(of, _)| of.model == model);
        chart
            .draw_series(own.map(|(of, &on_front)| {
                let style = if on_front {
                    colour.filled()
                } else {
                    colour.stroke_width(1)
                };
                Circle::new(at(of), 4, style)
            }))?
            .label(model)
            .legend(move |(x, y)| Circle::new((x + 8, y), 4, colour.filled()));
    }
    let shipped = rows.iter().filter(|row| row.default);
    chart
        .draw_series(shipped.map(|row| Circle::new(at(&row.of), 9, BLACK.stroke_width(2))))?
        .label("default")
        .legend(|(x, y)| Circle::new((x + 8, y), 6, BLACK.stroke_width(2)));
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.9))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    area.present()?;
    Ok(())
}
