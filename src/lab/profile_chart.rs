//! Profiles as panels of a sheet: the live histogram over that of the reference, or how far each channel is from
//! nominal.

use crate::capture::Picture;
use crate::monitor::profile::{ProfileKind, TapProfile};

/// Colours, sRGB. They can be distinguished with all kinds of colour blindness, and by their lightness.
const BACKGROUND: [u8; 3] = [18, 18, 26];
const BAND: [u8; 3] = [52, 52, 66];
const LEFT_OUT: [u8; 3] = [110, 110, 120];
const LIVE: [u8; 3] = [250, 150, 35];
const NOMINAL: [u8; 3] = [0, 220, 210];
const COUNTED: [u8; 3] = [255, 255, 255];

/// Rows below a histogram: a gap, and the line under the counted bins.
const FOOT_PX: usize = 5;
/// Smallest deviation at the end of the axis, nominal spreads.
const REACH_MIN: f64 = 4.0;
/// Half of the width of the band around nominal, spreads: 95 % of nominal windows are in it, if they are normally
/// distributed.
const BAND_SPREADS: f64 = 2.0;

/// A profile as a panel of `width` x `height` pixels.
///
/// For a histogram: bars of the live window, steps of the reference, and a white line under the bins that are counted.
/// `left_out` are the live shares of the bins before these, in the unit of the profile; they are grey, and cut if they
/// are higher than the counted ones. For energies: a bar for the deviation of each channel, over a band of two nominal
/// spreads; `left_out` is not used.
pub fn panel(profile: &TapProfile, left_out: &[f64], (width, height): (u32, u32)) -> Picture {
    let mut panel = Panel::new(width, height);
    match profile.kind {
        ProfileKind::Histogram => panel.histogram(profile, left_out),
        ProfileKind::Energies => panel.energies(profile),
    }
    panel.picture
}

struct Panel {
    picture: Picture,
    width: usize,
    height: usize,
}

impl Panel {
    fn new(width: u32, height: u32) -> Self {
        let (wide, high) = (width as usize, height as usize);
        Self {
            picture: Picture {
                width,
                height,
                rgb: BACKGROUND.repeat(wide * high),
            },
            width: wide,
            height: high,
        }
    }

    fn histogram(&mut self, profile: &TapProfile, left_out: &[f64]) {
        if !profile.is_whole() {
            return;
        }
        let bins = left_out.len() + profile.live.len();
        let floor = self.height.saturating_sub(FOOT_PX);
        let both = profile.live.iter().chain(&profile.nominal);
        let top = both.copied().fold(f64::MIN_POSITIVE, f64::max);
        let row = |share: f64| floor - part(share / top, floor);
        for column in 0..self.width {
            let bin = column * bins / self.width;
            let (share, colour) = match bin.checked_sub(left_out.len()) {
                Some(bin) => (profile.live[bin], LIVE),
                None => (left_out[bin], LEFT_OUT),
            };
            self.fill(column, row(share), floor, colour);
            if let Some(bin) = bin.checked_sub(left_out.len()) {
                self.fill(column, self.height.saturating_sub(2), self.height, COUNTED);
                // Down or up to the step of the neighbour, so that the steps are connected.
                let here = row(profile.nominal[bin]);
                let before = match (column.saturating_sub(1) * bins / self.width)
                    .checked_sub(left_out.len())
                {
                    Some(before) => row(profile.nominal[before]),
                    None => here,
                };
                let (from, to) = (here.min(before), here.max(before));
                self.fill(column, from, (to + 1).min(self.height), NOMINAL);
            }
        }
    }

    fn energies(&mut self, profile: &TapProfile) {
        let channels = profile.channel_deviations();
        if channels.is_empty() {
            return;
        }
        let farthest = channels.iter().map(|d| d.abs()).fold(0.0, f64::max);
        let reach = farthest.max(REACH_MIN);
        let row = |deviation: f64| part(0.5 - 0.5 * deviation / reach, self.height);
        let (band, middle) = ((row(BAND_SPREADS), row(-BAND_SPREADS)), row(0.0));
        let ends: Vec<usize> = channels.iter().map(|&deviation| row(deviation)).collect();
        for column in 0..self.width {
            self.fill(column, band.0, band.1, BAND);
            let of = |column: usize| column * ends.len() / self.width;
            let end = ends[of(column)];
            // Wide bars have a gap between them.
            if 4 * ends.len() > self.width || of(column) == of(column + 1) {
                self.fill(column, end.min(middle), end.max(middle), LIVE);
            }
            self.fill(column, middle, middle + 1, NOMINAL);
        }
    }

    /// Colours a column's rows `from..to`.
    fn fill(&mut self, column: usize, from: usize, to: usize, colour: [u8; 3]) {
        for row in from..to.min(self.height) {
            let at = 3 * (row * self.width + column);
            self.picture.rgb[at..at + 3].copy_from_slice(&colour);
        }
    }
}

/// A share of some rows as a whole number of rows; shares are limited to 0 to 1.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss
)]
fn part(share: f64, rows: usize) -> usize {
    (share.clamp(0.0, 1.0) * rows as f64).round() as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::energies::CELLS;

    fn histogram(live: Vec<f64>, nominal: Vec<f64>) -> TapProfile {
        TapProfile {
            tap: "e2".to_owned(),
            kind: ProfileKind::Histogram,
            live,
            nominal,
            spread: vec![],
        }
    }

    /// Rows of a column that have a colour.
    fn rows(panel: &Picture, column: usize, colour: [u8; 3]) -> usize {
        let width = panel.width as usize;
        let pixels = panel.rgb.chunks_exact(3).enumerate();
        pixels
            .filter(|(place, pixel)| place % width == column && *pixel == colour)
            .count()
    }

    #[test]
    fn bars_are_as_high_as_their_shares_and_counted_bins_are_marked() {
        // Two bins are left out, the first one far higher than what is counted; each bin has ten columns; 100 rows are
        // above the foot.
        let profile = histogram(vec![0.5, 0.25], vec![0.1, 0.9]);
        let size = (40, 100 + u32::try_from(FOOT_PX).unwrap_or(0));
        let shown = panel(&profile, &[7.0, 0.09], size);
        let high = |column, colour| rows(&shown, column, colour);
        assert_eq!(high(5, LEFT_OUT), 100, "cut at the top");
        assert_eq!(high(15, LEFT_OUT), 10);
        // The step of the reference is drawn over the bar of the first bin, and above the bar of the second one.
        assert_eq!(high(25, LIVE) + high(25, NOMINAL), 56);
        assert_eq!((high(35, LIVE), high(35, NOMINAL)), (28, 1));
        assert_eq!(
            [5, 15, 25, 35].map(|column| high(column, COUNTED)),
            [0, 0, 2, 2]
        );
    }

    #[test]
    fn a_channel_reaches_up_when_it_is_above_nominal_and_down_when_below() {
        let mut live = vec![1.0; 2 + CELLS];
        (live[0], live[1]) = (3.0, 0.0);
        let profile = TapProfile {
            kind: ProfileKind::Energies,
            nominal: vec![1.0; live.len()],
            spread: vec![0.5; live.len()],
            ..histogram(live, vec![])
        };
        let shown = panel(&profile, &[], (20, 80));
        // The axis reaches four spreads; the channels are four above and two below.
        let sums = |from: usize, to: usize, column| {
            let cut = Picture {
                rgb: shown.rgb[3 * 20 * from..3 * 20 * to].to_vec(),
                ..shown.clone()
            };
            rows(&cut, column, LIVE)
        };
        assert_eq!((sums(0, 40, 4), sums(41, 80, 4)), (40, 0));
        assert_eq!((sums(0, 40, 14), sums(41, 80, 14)), (0, 19));
    }

    #[test]
    fn panels_of_any_size_and_of_nothing_are_drawn() {
        for size in [(0, 0), (1, 1), (3, 2), (64, 4)] {
            let shown = panel(&histogram(vec![1.0; 9], vec![0.0; 9]), &[f64::MAX], size);
            assert_eq!(shown.rgb.len(), 3 * (size.0 * size.1) as usize);
            panel(&histogram(vec![], vec![]), &[], size);
        }
    }
}
