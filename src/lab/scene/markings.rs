//! What is painted on the road: the lines, their positions, and their wear.

use super::light::{Colour, blended, scaled};
use super::noise::{BLOCK, Draws, NoiseRow};
use super::road_kind::Traits;
use super::world::{Element, Look, World};

/// Largest number of lanes in the direction of travel.
const LANES_MAX: usize = 5;
/// Share of the width of one more lane from which a line separates it.
const EXTRA_LANE_FROM: f32 = 0.12;

/// One painted line along the road.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// Offset of its middle from the middle of the ego lane, metres, right positive.
    pub offset_m: f32,
    /// Painted width, metres.
    pub width_m: f32,
    /// Painted length and gap of a dash, metres; `None` for a solid line.
    pub dash_m: Option<(f32, f32)>,
    /// Whether it is yellow instead of white.
    pub yellow: bool,
}

/// The cross-section of the carriageway.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Lines from left to right.
    pub lines: heapless::Vec<Line, 8>,
    /// Left and right edge of the asphalt, metres from the middle of the ego lane.
    pub asphalt_m: (f32, f32),
    /// Offsets of the lanes' middles in the direction of travel.
    pub lanes_m: heapless::Vec<f32, LANES_MAX>,
    /// Offset of the oncoming lane, if the road has one.
    pub oncoming_m: Option<f32>,
    /// Width of a lane, metres.
    pub lane_width_m: f32,
    /// Colours of white and of yellow paint in full light.
    pub colours: [Colour; 2],
    wear: f32,
    wear_seed: u32,
}

/// How the centre line of a road with oncoming traffic is painted.
#[derive(Clone, Copy, Debug)]
pub enum CentreLine {
    Dashed,
    Solid,
    Double,
}

/// The measures of a carriageway, from which its lines follow.
#[derive(Clone, Debug)]
pub struct Cross {
    pub lane_m: f32,
    /// Number of lanes in the direction of travel; a road with one has an oncoming lane too.
    count: usize,
    ego: usize,
    pub line_m: f32,
    pub dash_m: (f32, f32),
    pub centre: CentreLine,
    pub yellow: bool,
    /// Whether the right edge is painted.
    pub edge_line: bool,
    pub shoulder_m: f32,
    /// How much of one more lane on the right there is, 0 to 1.
    pub extra: f32,
    pub wear: f32,
    colours: [Colour; 2],
    wear_seed: u32,
}

impl Cross {
    /// The cross-section of a drive: 2 to 5 lanes one way, or 1 each way.
    pub fn new(draws: Draws, world: &World) -> Self {
        let count = draws.pick("lanes", &[1, 1, 2, 2, 3, 3, 4, 5]);
        let (line_m, dash_m) = match world.look {
            Look::Sim | Look::Realistic => (
                draws.range("line width", 0.11, 0.22),
                draws.pick("dash", &[(3.0, 9.0), (4.0, 8.0), (6.0, 6.0), (6.0, 12.0)]),
            ),
            Look::Game => (0.15, (3.0, 4.5)),
        };
        Self {
            lane_m: draws.range("lane width", 3.0, 3.8),
            count,
            ego: draws.seed("ego lane") as usize % count,
            line_m,
            dash_m,
            centre: draws.pick(
                "centre line",
                &[CentreLine::Dashed, CentreLine::Solid, CentreLine::Double],
            ),
            yellow: world.has(Element::YellowPaint) && draws.chance("yellow", 0.35),
            edge_line: true,
            shoulder_m: draws.range("paved shoulder", 0.3, 2.8),
            extra: 0.0,
            wear: world.when(
                Element::Wear,
                match world.look {
                    Look::Sim => draws.range("wear", 0.0, 0.75),
                    Look::Realistic => draws.range("wear", 0.2, 0.9),
                    Look::Game => 0.05,
                },
                0.0,
            ),
            colours: match world.look {
                Look::Sim => [[0.78, 0.78, 0.76], [0.72, 0.50, 0.10]],
                Look::Realistic => [[0.70, 0.69, 0.65], [0.66, 0.46, 0.12]],
                Look::Game => [[0.98, 0.98, 1.0], [0.95, 0.70, 0.02]],
            },
            wear_seed: draws.seed("wear pattern"),
        }
    }

    /// The cross-section of a stretch of a road that changes; the number of lanes with traffic stays.
    pub fn changed(&self, draws: Draws, traits: &Traits, world: &World) -> Self {
        Self {
            count: self.count,
            ego: self.ego,
            lane_m: draws.range("lane of the stretch", traits.lane_m.0, traits.lane_m.1),
            shoulder_m: draws.range("shoulder", traits.shoulder_m.0, traits.shoulder_m.1),
            edge_line: !draws.chance("no edge line", traits.no_edge_line),
            extra: f32::from(u8::from(draws.chance("extra lane", traits.extra_lane))),
            ..Self::new(draws, world)
        }
    }

    /// Whether there is oncoming traffic.
    pub fn two_way(&self) -> bool {
        self.count == 1
    }

    /// This cross-section with the widths on the way to those of `other`.
    pub fn towards(&self, other: &Self, share: f32) -> Self {
        let between = |a: f32, b: f32| a + share * (b - a);
        Self {
            lane_m: between(self.lane_m, other.lane_m),
            shoulder_m: between(self.shoulder_m, other.shoulder_m),
            extra: between(self.extra, other.extra),
            ..self.clone()
        }
    }

    /// Left and right edge of the asphalt, metres from the middle of the ego lane.
    pub fn edges_m(&self) -> (f32, f32) {
        let left_edge = -(self.ego as f32 + 0.5) * self.lane_m;
        let right_edge = (self.count as f32 - self.ego as f32 - 0.5) * self.lane_m;
        (
            if self.two_way() {
                left_edge - self.lane_m - self.shoulder_m
            } else {
                left_edge - 0.6 * self.shoulder_m - 0.2
            },
            right_edge + self.extra * self.lane_m + self.shoulder_m,
        )
    }

    /// The lines and lanes.
    pub fn layout(&self) -> Layout {
        let (lane, count, ego, width_m) = (self.lane_m, self.count, self.ego, self.line_m);
        let (dash, yellow, two_way) = (self.dash_m, self.yellow, self.two_way());
        let left_edge = -(ego as f32 + 0.5) * lane;
        let right_edge = (count as f32 - ego as f32 - 0.5) * lane;
        let mut lines = heapless::Vec::new();
        let mut paint = |offset_m, dash_m, yellow| {
            // At most 5 lanes one way and one more: 7 of 8 lines.
            let _ = lines.push(Line {
                offset_m,
                width_m,
                dash_m,
                yellow,
            });
        };
        if two_way {
            paint(left_edge - lane, None, false);
            match self.centre {
                CentreLine::Dashed => paint(left_edge, Some(dash), yellow),
                CentreLine::Solid => paint(left_edge, None, yellow),
                CentreLine::Double => {
                    paint(left_edge - width_m, None, yellow);
                    paint(left_edge + width_m, None, yellow);
                }
            }
        } else {
            paint(left_edge, None, yellow);
        }
        for boundary in 1..count {
            paint(left_edge + boundary as f32 * lane, Some(dash), false);
        }
        if self.extra > EXTRA_LANE_FROM {
            paint(right_edge, Some(dash), false);
        }
        let right_edge = right_edge + self.extra * lane;
        if self.edge_line {
            paint(right_edge, None, false);
        }
        Layout {
            lines,
            asphalt_m: self.edges_m(),
            lanes_m: (0..count.min(LANES_MAX))
                .map(|i| (i as f32 - ego as f32) * lane)
                .collect(),
            oncoming_m: two_way.then_some(-lane),
            lane_width_m: lane,
            colours: self.colours,
            wear: self.wear,
            wear_seed: self.wear_seed,
        }
    }
}

/// The paint along one image row: the lines on the part of the road that the row shows.
pub struct PaintRow<'a> {
    layout: &'a Layout,
    /// Lines from left to right that are painted here, and their shares of the length.
    lines: heapless::Vec<(&'a Line, f32), 8>,
    wear: NoiseRow,
    worn: bool,
    colours: [Colour; 2],
}

impl<'a> PaintRow<'a> {
    /// The paint on a length of `length_m` around arc length `s_m`.
    pub fn new(layout: &'a Layout, s_m: f64, length_m: f32) -> Self {
        Self {
            layout,
            lines: layout
                .lines
                .iter()
                .map(|line| {
                    let cover = line
                        .dash_m
                        .map_or(1.0, |dash| dash_cover(dash, s_m, length_m));
                    (line, cover)
                })
                .filter(|(_, cover)| *cover > 0.0)
                .collect(),
            wear: NoiseRow::new(layout.wear_seed, s_m / 0.35),
            worn: length_m < 2.0,
            colours: layout.colours,
        }
    }

    /// The same paint when it sends `times` as much of the light back to the car.
    pub fn reflecting(self, times: f32) -> Self {
        Self {
            colours: self.colours.map(|colour| scaled(colour, times)),
            ..self
        }
    }

    /// Paints the pixels at the ascending offsets `d_m` from the middle of the ego lane; each covers `width_m`.
    ///
    /// Coverage is the exact overlap of line and pixel, so that thin lines far away fade and do not flicker.
    #[inline(always)]
    pub fn paint(&self, d_m: &[f32], width_m: f32, colours: &mut [Colour]) {
        let pixels_of = |line: &Line| pixels(line, d_m, width_m);
        let mut lines = self.lines.as_slice();
        while let Some((first, _)) = lines.first() {
            // Far away, several lines can be in one pixel.
            let (mut pixels, mut together) = (pixels_of(first), 1);
            while let Some((next, _)) = lines.get(together) {
                let next = pixels_of(next);
                if next.start >= pixels.end {
                    break;
                }
                pixels.end = pixels.end.max(next.end);
                together += 1;
            }
            let (these, rest) = lines.split_at(together);
            let (d_m, colours) = (&d_m[pixels.clone()], &mut colours[pixels]);
            for (d_m, colours) in d_m.chunks(BLOCK).zip(colours.chunks_mut(BLOCK)) {
                self.paint_block(these, d_m, width_m, colours);
            }
            lines = rest;
        }
    }

    /// Paints `lines` in up to [`BLOCK`] pixels; the first of the lines in a pixel is seen.
    #[inline(always)]
    fn paint_block(
        &self,
        lines: &[(&Line, f32)],
        d_m: &[f32],
        width_m: f32,
        colours: &mut [Colour],
    ) {
        let (mut shares, mut yellow) = ([0.0; BLOCK], [false; BLOCK]);
        for (line, cover) in lines {
            let most = (line.width_m / width_m).min(1.0);
            for ((share, yellow), d_m) in shares.iter_mut().zip(&mut yellow).zip(d_m) {
                let overlap =
                    (0.5 * (line.width_m + width_m) - (d_m - line.offset_m).abs()) / width_m;
                let of_line = overlap.max(0.0).min(most) * cover;
                if *share <= 0.0 && of_line > 0.0 {
                    (*share, *yellow) = (of_line, line.yellow);
                }
            }
        }
        let grains = if self.worn {
            self.wear.block(d_m, |d| f64::from(d) / 0.12)
        } else {
            [0.5; BLOCK]
        };
        let paints = shares.iter().zip(&yellow);
        for ((colour, grain), (share, yellow)) in colours.iter_mut().zip(&grains).zip(paints) {
            let kept = 1.0 - self.layout.wear * (0.35 + 0.65 * grain);
            *colour = blended(*colour, self.colours[usize::from(*yellow)], share * kept);
        }
    }
}

/// The pixels at the ascending offsets `d_m`, each `width_m` wide, that a line may touch, and a few more.
fn pixels(line: &Line, d_m: &[f32], width_m: f32) -> std::ops::Range<usize> {
    let reach_m = 0.5 * (line.width_m + width_m);
    let first_m = d_m.first().copied().unwrap_or_default();
    let pixel = |at_m: f32| ((at_m - first_m) / width_m).clamp(-2.0, d_m.len() as f32);
    let (from, to) = (
        pixel(line.offset_m - reach_m) - 1.0,
        pixel(line.offset_m + reach_m) + 3.0,
    );
    (from.max(0.0) as usize).min(d_m.len())..(to.max(0.0) as usize).min(d_m.len())
}

fn dash_cover((paint, gap): (f32, f32), s_m: f64, length_m: f32) -> f32 {
    let period = f64::from(paint + gap);
    // Painted length before `s`, from the start of the road.
    let painted = |s: f64| {
        let periods = (s / period).floor();
        periods * f64::from(paint) + (s - periods * period).min(f64::from(paint))
    };
    let half = 0.5 * f64::from(length_m).max(0.01);
    ((painted(s_m + half) - painted(s_m - half)) / (2.0 * half)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dashes_cover_their_share_of_a_long_stretch() {
        let cover = dash_cover((3.0, 9.0), 500.0, 1_200.0);
        assert!((cover - 0.25).abs() < 1e-3, "{cover}");
        assert!((dash_cover((3.0, 9.0), 12.0 * 7.0 + 1.5, 0.5) - 1.0).abs() < 1e-5);
        assert!(dash_cover((3.0, 9.0), 12.0 * 7.0 + 6.0, 0.5).abs() < 1e-5);
    }

    #[test]
    fn the_ego_lane_lies_between_two_lines() {
        for seed in 0..200 {
            let layout = Cross::new(Draws(seed), &World::default()).layout();
            let left = layout
                .lines
                .iter()
                .any(|l| l.offset_m < 0.0 && l.offset_m > -2.3);
            let right = layout
                .lines
                .iter()
                .any(|l| l.offset_m > 0.0 && l.offset_m < 2.3);
            assert!(left && right, "seed {seed}: {:?}", layout.lines);
        }
    }
}
