//! What stands along the whole of one side of a stretch: edges of woods, hedges, banks, walls and rows of houses.

use super::light::{Colour, blended};
use super::noise::{Draws, RoughColumn, hash, unit};
use super::road_kind::RoadKind;
use super::world::{Look, World};

/// Width of a house in a row, metres.
const HOUSE_M: f32 = 16.0;
/// Numbers of values of coarse and of fine noise in a metre.
const COARSE: f32 = 0.7;
const FINE: f32 = 3.0;
/// Distance up to which windows and leaves can be seen one by one, metres.
const FINE_M: f32 = 22.0;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Leaves,
    Bank,
    Wall,
    Houses,
}

/// A belt along one side of a stretch.
#[derive(Clone, Copy, Debug)]
pub struct Belt {
    kind: Kind,
    /// Distance from the edge of the asphalt, metres.
    pub clear_m: f32,
    /// Its height, metres.
    pub height_m: f32,
    colour: Colour,
    seed: u32,
}

impl Belt {
    /// The belt of a stretch, if it has one on this side; a road in a hill has its bank on the side `uphill`.
    pub fn drawn(draws: Draws, road: RoadKind, uphill: bool, world: &World) -> Option<Self> {
        let pick = draws.range("belt", 0.0, 1.0);
        let (kind, clear_m, height_m) = match road {
            RoadKind::Open if pick < 0.2 => (Kind::Leaves, (2.0, 6.0), (1.2, 3.5)),
            RoadKind::Open if pick < 0.5 => (Kind::Leaves, (18.0, 40.0), (6.0, 14.0)),
            RoadKind::Forest => (Kind::Leaves, (2.5, 8.0), (7.0, 18.0)),
            RoadKind::Suburb if pick < 0.4 => (Kind::Leaves, (1.0, 4.0), (1.2, 3.0)),
            RoadKind::Suburb if pick < 0.7 => (Kind::Wall, (1.5, 4.0), (1.0, 2.2)),
            RoadKind::City if pick < 0.85 => (Kind::Houses, (2.0, 6.0), (7.0, 20.0)),
            RoadKind::City => (Kind::Wall, (1.5, 4.0), (1.5, 3.0)),
            RoadKind::Motorway if pick < 0.4 => (Kind::Wall, (1.5, 5.0), (2.5, 5.0)),
            RoadKind::Motorway if pick < 0.7 => (Kind::Bank, (2.0, 6.0), (2.0, 6.0)),
            RoadKind::Hillside if uphill => (Kind::Bank, (0.8, 4.0), (4.0, 16.0)),
            RoadKind::Hillside if pick < 0.4 => (Kind::Leaves, (2.0, 8.0), (2.0, 8.0)),
            _ => return None,
        };
        let game = world.look == Look::Game;
        let hue = draws.range("hue", 0.0, 1.0);
        let grey = draws.range("grey", 0.2, 0.5);
        let colour = match kind {
            Kind::Leaves if game => blended([0.02, 0.22, 0.05], [0.05, 0.30, 0.16], hue),
            Kind::Leaves => blended([0.04, 0.09, 0.03], [0.15, 0.16, 0.06], hue),
            Kind::Bank if game => blended([0.30, 0.26, 0.08], [0.06, 0.30, 0.05], hue),
            Kind::Bank => blended([0.32, 0.24, 0.14], [0.12, 0.17, 0.06], hue),
            Kind::Wall => blended([grey; 3], [0.30, 0.22, 0.15], hue * hue),
            Kind::Houses => [1.0; 3],
        };
        Some(Self {
            kind,
            clear_m: draws.range("clear", clear_m.0, clear_m.1),
            height_m: draws.range("height", height_m.0, height_m.1),
            colour,
            seed: draws.seed("belt surface"),
        })
    }

    /// How much it hides of its half of the sky, 0 to 1.
    pub fn hides(&self) -> f32 {
        (self.height_m / (self.clear_m + 4.0)).min(1.0)
    }

    /// Whether it is high right from its ends.
    pub fn ends_abruptly(&self) -> bool {
        matches!(self.kind, Kind::Wall | Kind::Houses)
    }

    /// The column of the belt at the length `along_m` of road.
    pub fn column(&self, along_m: f32, z_m: f32) -> Column {
        let fine = (FINE_M / z_m).min(1.0);
        let full = Column {
            along_m,
            fine,
            coarse_noise: RoughColumn::new(COARSE * along_m),
            fine_noise: RoughColumn::new(FINE * along_m),
            top: 1.0,
            colour: self.colour,
        };
        match self.kind {
            Kind::Leaves => {
                let crown = RoughColumn::new(0.22 * along_m).near(3.0);
                let twig = RoughColumn::new(1.1 * along_m).near(9.0);
                Column {
                    top: 0.55 + 0.33 * crown + 0.12 * twig,
                    ..full
                }
            }
            Kind::Bank => Column {
                top: 0.6 + 0.4 * RoughColumn::new(0.04 * along_m).near(5.0),
                ..full
            },
            Kind::Wall => full,
            Kind::Houses => {
                let house = hash(self.seed, (along_m / HOUSE_M) as i32, 0);
                const PAINTS: [Colour; 5] = [
                    [0.50, 0.45, 0.38],
                    [0.35, 0.18, 0.13],
                    [0.60, 0.60, 0.58],
                    [0.30, 0.32, 0.36],
                    [0.55, 0.42, 0.25],
                ];
                Column {
                    top: 0.55 + 0.45 * unit(house),
                    colour: PAINTS[house as usize % PAINTS.len()],
                    ..full
                }
            }
        }
    }

    /// Tone of the belt at a height of `up_m`, which is the share `up` of its height; `None` above its top.
    #[inline(always)]
    pub fn tone(&self, column: &Column, up: f32, up_m: f32) -> Option<f32> {
        let along_m = column.along_m;
        if up > column.top {
            return None;
        }
        Some(match self.kind {
            Kind::Leaves => {
                let twigs = if column.fine > 0.3 {
                    0.4 * column.fine * (column.fine_noise.near(FINE * up_m) - 0.5)
                } else {
                    0.0
                };
                let leaves = 0.6 * column.coarse_noise.at(COARSE * up_m) + twigs + 0.1;
                0.25 + (0.5 + 0.9 * up) * leaves
            }
            Kind::Bank => {
                let soil = column.coarse_noise.at(up_m) - 0.5;
                0.85 + 0.4 * up + 0.5 * (0.3 + 0.7 * column.fine) * soil
            }
            Kind::Wall => {
                let post = part(0.25 * along_m) < 0.07;
                let panel = 0.8 + 0.2 * column.coarse_noise.near(0.3 * up_m);
                panel - if post { 0.35 * column.fine } else { 0.0 } - 0.15 * (1.0 - up)
            }
            Kind::Houses => {
                let (across, floor) = (part(along_m / 3.2), part(up_m / 3.0));
                let pane = across > 0.45 && floor > 0.42 && up < 0.93 * column.top;
                let ground_floor = up_m < 3.0;
                let dark = if pane || (ground_floor && across > 0.2 && floor < 0.85) {
                    0.62
                } else {
                    0.0
                };
                0.95 - dark * (0.35 + 0.65 * column.fine)
            }
        })
    }
}

/// What a number above 0 has beyond its whole part.
#[inline(always)]
fn part(number: f32) -> f32 {
    number - (number as u32) as f32
}

/// What all pixels of one column of a belt have in common.
pub struct Column {
    along_m: f32,
    fine: f32,
    coarse_noise: RoughColumn,
    fine_noise: RoughColumn,
    top: f32,
    /// Colour in full light.
    pub colour: Colour,
}
