//! Lane models on real pictures whose lanes were drawn by hand: how well they find the lanes, and how well a forecast
//! foretells what they lose.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::ranking::{auroc, spearman};
use crate::features::lane::{Agreement, LaneMask, Overlap};
use crate::monitor::warn::LANES_LOST;
use crate::statistics::bootstrap::{ROUNDS, percentile_interval};
use crate::statistics::random::SplitMix64;

/// Half the width of a drawn line, pixels of a picture that is 320 pixels wide: that of the labels of rendered scenes.
const HALF_WIDTH_320_PX: f64 = 2.0;
/// Length of the blocks that are resampled, seconds.
const BLOCK_S: f64 = 10.0;

/// Pictures with drawn lanes, as a file holds them.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DrawnLanes {
    /// How the drawings were made.
    pub about: String,
    /// One drawing of each picture.
    pub frames: Vec<Drawing>,
    /// Some of the pictures, drawn a second time.
    pub again: Vec<Drawing>,
}

/// A picture with its drawn lanes.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drawing {
    /// The road that it is from.
    pub set: String,
    /// Its file, or the video that it is in, below the folder of image sets.
    pub image: String,
    /// Its number in the video, from 0; `None` for a picture of its own.
    #[serde(default)]
    pub frame: Option<u64>,
    /// Its time in the drive, seconds; `None` where it is not known.
    #[serde(default)]
    pub t_s: Option<f64>,
    /// Width of the picture, pixels.
    pub width: u32,
    /// Height of the picture, pixels.
    pub height: u32,
    /// Lines as points (x, y) in pixels of the picture, the nearest point first.
    pub lines: Vec<Vec<[f64; 2]>>,
}

/// A drawing at the size of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// The drawn lanes.
    pub lanes: LaneMask,
    /// Rows between the farthest and the nearest drawn point. Farther lines are not drawn, and nearer is the bonnet.
    pub rows: (usize, usize),
}

impl Drawing {
    /// What is wrong with it, if anything.
    pub fn fault(&self) -> Option<String> {
        let size = [f64::from(self.width), f64::from(self.height)];
        let inside = |point: &[f64; 2]| {
            let mut axes = point.iter().zip(&size);
            axes.all(|(&at, &end)| at.is_finite() && at >= -1.0 && at <= end + 1.0)
        };
        let points = || self.lines.iter().flatten();
        if self.width == 0 || self.height == 0 {
            return Some(format!("{}: a picture without pixels", self.image));
        }
        if let Some(line) = self.lines.iter().find(|line| line.len() < 2) {
            return Some(format!("{}: a line of {} points", self.image, line.len()));
        }
        let outside = points().find(|point| !inside(point));
        outside.map(|[x, y]| {
            format!(
                "{}: the point {x}, {y} is outside of {}x{}",
                self.image, self.width, self.height
            )
        })
    }

    /// The drawing at the size of a model, pixels.
    // Pictures have a few thousand rows, and faults were refused.
    #[allow(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )]
    pub fn truth(&self, width: usize, height: usize) -> Truth {
        let scale = [
            width as f64 / f64::from(self.width),
            height as f64 / f64::from(self.height),
        ];
        let half = HALF_WIDTH_320_PX * width as f64 / 320.0;
        let mut lanes = LaneMask {
            width,
            height,
            lane: vec![false; width * height],
        };
        let (mut first, mut last) = (f64::INFINITY, f64::NEG_INFINITY);
        for line in &self.lines {
            let scaled: Vec<[f64; 2]> = line
                .iter()
                .map(|p| [p[0] * scale[0], p[1] * scale[1]])
                .collect();
            for pair in scaled.windows(2) {
                paint(&mut lanes, [pair[0], pair[1]], half);
            }
            for [_, y] in scaled {
                (first, last) = (first.min(y), last.max(y));
            }
        }
        // The middle of a judged row lies between the two.
        let rows = if self.lines.is_empty() {
            (0, height)
        } else {
            let row = |y: f64| (y - 0.5).clamp(0.0, height as f64);
            (
                row(first).ceil() as usize,
                (row(last).floor() as usize + 1).min(height),
            )
        };
        Truth { lanes, rows }
    }
}

/// Marks the pixels whose middle is at most `half` away from a line between two points.
// Masks have a few hundred pixels on a side.
#[allow(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss
)]
fn paint(lanes: &mut LaneMask, [from, to]: [[f64; 2]; 2], half: f64) {
    let along = [to[0] - from[0], to[1] - from[1]];
    let length_2 = along[0] * along[0] + along[1] * along[1];
    let span = |axis: usize, end: usize| {
        let (low, high) = (from[axis].min(to[axis]), from[axis].max(to[axis]));
        let place = |at: f64| at.clamp(0.0, end as f64);
        place((low - half - 1.0).floor()) as usize..place((high + half + 1.0).ceil()) as usize
    };
    for y in span(1, lanes.height) {
        for x in span(0, lanes.width) {
            let (px, py) = (x as f64 + 0.5 - from[0], y as f64 + 0.5 - from[1]);
            let share = if length_2 > 0.0 {
                ((px * along[0] + py * along[1]) / length_2).clamp(0.0, 1.0)
            } else {
                0.0
            };
            let (dx, dy) = (px - share * along[0], py - share * along[1]);
            if dx * dx + dy * dy <= half * half {
                lanes.lane[y * lanes.width + x] = true;
            }
        }
    }
}

/// A model on one picture.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RealLanes {
    /// The model.
    pub model: String,
    /// The road that the picture is from.
    pub set: String,
    /// The picture.
    pub image: String,
    /// Its number in a video.
    pub frame: Option<u64>,
    /// Its time in the drive, seconds.
    pub t_s: Option<f64>,
    /// Agreement with the drawn lanes.
    pub agreement: Agreement,
    /// Overlap with the drawn lanes.
    pub overlap: Overlap,
    /// Forecast of the share of lanes that the model loses, from this picture alone; `None` without a forecast.
    pub forecast: Option<f64>,
}

impl RealLanes {
    /// A model's answer beside the drawing.
    pub fn of(model: &str, drawing: &Drawing, answer: &LaneMask, forecast: Option<f64>) -> Self {
        let truth = drawing.truth(answer.width, answer.height);
        let (from, to) = truth.rows;
        let (answer, lanes) = (answer.in_rows(from, to), truth.lanes.in_rows(from, to));
        Self {
            model: model.to_owned(),
            set: drawing.set.clone(),
            image: drawing.image.clone(),
            frame: drawing.frame,
            t_s: drawing.t_s,
            agreement: Agreement::of(Some(&answer), &lanes),
            overlap: Overlap::of(Some(&answer), &lanes),
            forecast,
        }
    }

    /// The forecast and the share of lanes that was lost, if both are known.
    fn forecast_and_loss(&self) -> Option<(f64, f64)> {
        Some((self.forecast?, 1.0 - self.agreement.f1()?))
    }

    /// Mean forecast and mean loss of some pictures; `None` if none has both.
    #[allow(clippy::cast_precision_loss)]
    pub fn means(rows: &[&Self]) -> Option<(f64, f64)> {
        let pairs: Vec<(f64, f64)> = rows
            .iter()
            .filter_map(|of| of.forecast_and_loss())
            .collect();
        let count = pairs.len() as f64;
        let (a, b) = pairs
            .iter()
            .fold((0.0, 0.0), |(a, b), p| (a + p.0, b + p.1));
        (!pairs.is_empty()).then(|| (a / count, b / count))
    }

    /// The block that is resampled with it.
    #[allow(clippy::cast_possible_truncation)]
    fn block(&self) -> (&str, i64) {
        // Without a time, neighbours are not known: all of one road are a block.
        let block = self.t_s.map_or(-1, |t_s| (t_s / BLOCK_S).floor() as i64);
        (&self.set, block)
    }
}

/// How well a forecast foretells what was lost.
#[derive(Clone, Debug, PartialEq)]
pub struct Foretold {
    /// Number of pictures, or of blocks.
    pub count: usize,
    /// Number of them in which the lanes were lost.
    pub lost: usize,
    /// Rank correlation, with its interval.
    pub spearman: Option<(f64, Option<(f64, f64)>)>,
    /// Mean absolute difference, with its interval.
    pub mean_absolute_error: Option<(f64, Option<(f64, f64)>)>,
    /// Area under the ROC curve for lost lanes, with its interval.
    pub auroc: Option<(f64, Option<(f64, f64)>)>,
}

/// Judges forecasts of single pictures; intervals are from resampling blocks.
pub fn foretold(rows: &[&RealLanes]) -> Foretold {
    of_blocks(&in_blocks(rows, RealLanes::forecast_and_loss))
}

/// Judges the means over blocks of 10 s.
pub fn foretold_by_block(rows: &[&RealLanes]) -> Foretold {
    #[allow(clippy::cast_precision_loss)]
    let mean = |of: Vec<(f64, f64)>| {
        let (a, b) = of.iter().fold((0.0, 0.0), |(a, b), p| (a + p.0, b + p.1));
        vec![(a / of.len() as f64, b / of.len() as f64)]
    };
    of_blocks(
        &in_blocks(rows, RealLanes::forecast_and_loss)
            .into_iter()
            .map(mean)
            .collect::<Vec<_>>(),
    )
}

/// What is known of some pictures, by block.
fn in_blocks<T>(rows: &[&RealLanes], known: impl Fn(&RealLanes) -> Option<T>) -> Vec<Vec<T>> {
    let mut blocks: BTreeMap<(&str, i64), Vec<T>> = BTreeMap::new();
    for row in rows {
        if let Some(known) = known(row) {
            blocks.entry(row.block()).or_default().push(known);
        }
    }
    blocks.into_values().collect()
}

fn of_blocks(blocks: &[Vec<(f64, f64)>]) -> Foretold {
    let all = blocks.concat();
    let mut dice = SplitMix64::new(0);
    let mut of_rounds: [Vec<f64>; 3] = Default::default();
    // One block says nothing about others.
    for _ in 0..if blocks.len() < 2 { 0 } else { ROUNDS } {
        let drawn: Vec<(f64, f64)> = (0..blocks.len())
            .flat_map(|_| &blocks[dice.below(blocks.len())])
            .copied()
            .collect();
        of_rounds[0].extend(spearman(&drawn));
        of_rounds[1].extend(error(&drawn));
        of_rounds[2].extend(auroc(&drawn, LANES_LOST));
    }
    let [of_spearman, of_error, of_auroc] = of_rounds.map(percentile_interval);
    Foretold {
        count: all.len(),
        lost: all.iter().filter(|(_, loss)| *loss > LANES_LOST).count(),
        spearman: spearman(&all).map(|value| (value, of_spearman)),
        mean_absolute_error: error(&all).map(|value| (value, of_error)),
        auroc: auroc(&all, LANES_LOST).map(|value| (value, of_auroc)),
    }
}

#[allow(clippy::cast_precision_loss)]
fn error(pairs: &[(f64, f64)]) -> Option<f64> {
    let sum: f64 = pairs
        .iter()
        .map(|(forecast, loss)| (forecast - loss).abs())
        .sum();
    (!pairs.is_empty()).then(|| sum / pairs.len() as f64)
}

/// Agreement of some pictures together, its F1 with an interval from resampling blocks, and their IoU.
pub fn found(rows: &[&RealLanes]) -> (Agreement, Option<(f64, f64)>, Option<f64>) {
    let blocks = in_blocks(rows, |row| Some(row.agreement));
    let mut dice = SplitMix64::new(0);
    let mut f1s = Vec::new();
    for _ in 0..if blocks.len() < 2 { 0 } else { ROUNDS } {
        let drawn = (0..blocks.len()).flat_map(|_| &blocks[dice.below(blocks.len())]);
        f1s.extend(Agreement::pooled(drawn.copied()).f1());
    }
    (
        Agreement::pooled(rows.iter().map(|row| row.agreement)),
        percentile_interval(f1s),
        Overlap::iou(rows.iter().map(|row| row.overlap)),
    )
}

/// F1 of one drawing against the other of the same picture, over all pictures that were drawn twice.
pub fn between_drawings(lanes: &DrawnLanes, width: usize, height: usize) -> Option<f64> {
    let pairs = lanes.again.iter().filter_map(|again| {
        let same = |of: &&Drawing| (&of.image, of.frame) == (&again.image, again.frame);
        let once = lanes.frames.iter().find(same)?.truth(width, height);
        let again = again.truth(width, height);
        let from = once.rows.0.max(again.rows.0);
        let to = once.rows.1.min(again.rows.1);
        Some(Agreement::of(
            Some(&again.lanes.in_rows(from, to)),
            &once.lanes.in_rows(from, to),
        ))
    });
    Agreement::pooled(pairs).f1()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    fn drawing(lines: Vec<Vec<[f64; 2]>>) -> Drawing {
        Drawing {
            set: "road".to_owned(),
            image: "a.png".to_owned(),
            frame: None,
            t_s: None,
            width: 640,
            height: 320,
            lines,
        }
    }

    #[test]
    fn a_line_is_four_pixels_wide_at_320_and_judged_between_its_ends() {
        let truth = drawing(vec![vec![[200.0, 320.0], [200.0, 160.0]]]).truth(320, 160);
        let row = &truth.lanes.lane[120 * 320..121 * 320];
        let lane: Vec<usize> = (0..320).filter(|&x| row[x]).collect();
        assert_eq!(lane, [98, 99, 100, 101]);
        assert_eq!(truth.rows, (80, 160));
        assert_eq!(drawing(Vec::new()).truth(320, 160).rows, (0, 160));
    }

    #[test]
    fn drawings_with_faults_are_named() {
        let short = drawing(vec![vec![[1.0, 1.0]]]).fault().unwrap();
        assert_eq!(short, "a.png: a line of 1 points");
        let outside = drawing(vec![vec![[1.0, 1.0], [700.0, 1.0]]])
            .fault()
            .unwrap();
        assert_eq!(outside, "a.png: the point 700, 1 is outside of 640x320");
        assert_eq!(
            drawing(vec![vec![[0.0, 0.0], [640.0, 320.0]]]).fault(),
            None
        );
    }

    #[test]
    fn a_forecast_is_judged_by_hand() {
        let row = |t_s: f64, forecast: f64, found: u64| RealLanes {
            model: "m".to_owned(),
            set: "road".to_owned(),
            image: "a".to_owned(),
            frame: None,
            t_s: Some(t_s),
            agreement: Agreement {
                right: found,
                answer: found,
                found,
                truth: 10,
            },
            overlap: Overlap::default(),
            forecast: Some(forecast),
        };
        // Losses 0, 1 and 1/3.
        let rows = [row(0.0, 0.1, 10), row(11.0, 0.8, 0), row(12.0, 0.3, 5)];
        let rows: Vec<&RealLanes> = rows.iter().collect();
        let of = foretold(&rows);
        assert_eq!((of.count, of.lost), (3, 1));
        assert!((of.spearman.unwrap().0 - 1.0).abs() < 1e-12);
        let missed = (0.1 + 0.2 + 1.0 / 3.0 - 0.3) / 3.0;
        assert!((of.mean_absolute_error.unwrap().0 - missed).abs() < 1e-12);
        assert_eq!(of.auroc.unwrap().0, 1.0);
        assert_eq!(foretold_by_block(&rows).count, 2);
        let (agreement, _, _) = found(&rows);
        assert_eq!((agreement.recall(), agreement.truth), (Some(0.5), 30));
    }
}
