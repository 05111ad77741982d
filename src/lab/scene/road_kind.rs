//! Kinds of road through which a drive passes, and how each of them looks.

use super::noise::Draws;

/// A kind of road.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RoadKind {
    /// Fields with single trees.
    Open,
    /// High dense trees on both sides.
    Forest,
    /// Houses in gardens behind fences and hedges.
    Suburb,
    /// A street between houses.
    City,
    /// A fast road between rails, barriers and noise walls.
    Motorway,
    /// A road cut into the side of a hill.
    Hillside,
}

/// Measures of a kind of road; pairs are ranges from which a stretch draws.
pub struct Traits {
    /// Width of a lane and of the paved shoulder, metres.
    pub lane_m: (f32, f32),
    pub shoulder_m: (f32, f32),
    /// Chances of no edge line and of one more lane.
    pub no_edge_line: f32,
    pub extra_lane: f32,
    /// Density of objects, and which share of them are buildings, posts and high trees.
    pub density: (f32, f32),
    pub buildings: f32,
    pub posts: f32,
    pub high_trees: f32,
    /// Distance of the objects from the asphalt, as a multiple of that on roads that do not change.
    pub clear: f32,
    /// Chance of a rail.
    pub rail: f32,
    /// Height of the hills, radians.
    pub hills: (f32, f32),
    /// Shade of trees, 0 to 1.
    pub canopy: (f32, f32),
    /// Chance of a bridge.
    pub bridge: f32,
}

const OPEN: Traits = Traits {
    lane_m: (3.0, 3.7),
    shoulder_m: (0.3, 2.0),
    no_edge_line: 0.1,
    extra_lane: 0.15,
    density: (0.03, 0.45),
    buildings: 0.1,
    posts: 0.4,
    high_trees: 0.3,
    clear: 1.3,
    rail: 0.2,
    hills: (0.0, 0.12),
    canopy: (0.0, 0.35),
    bridge: 0.15,
};

impl RoadKind {
    const TWO_WAY: [Self; 5] = [
        Self::Open,
        Self::Forest,
        Self::Hillside,
        Self::Suburb,
        Self::City,
    ];
    const ONE_WAY: [Self; 6] = [
        Self::Open,
        Self::Motorway,
        Self::Forest,
        Self::City,
        Self::Hillside,
        Self::Suburb,
    ];

    fn kinds(two_way: bool) -> &'static [Self] {
        if two_way {
            &Self::TWO_WAY
        } else {
            &Self::ONE_WAY
        }
    }

    /// One of the kinds; there are motorways only without oncoming traffic.
    pub fn drawn(draws: Draws, two_way: bool) -> Self {
        draws.pick("kind", Self::kinds(two_way))
    }

    /// The kind after this one in the list.
    pub fn next(self, two_way: bool) -> Self {
        let kinds = Self::kinds(two_way);
        let mut after = kinds.iter().cycle().skip_while(|kind| **kind != self);
        after.nth(1).copied().unwrap_or(self)
    }

    /// The measures of this kind.
    pub fn traits(self) -> Traits {
        match self {
            Self::Open => OPEN,
            Self::Forest => Traits {
                lane_m: (2.8, 3.4),
                shoulder_m: (0.2, 0.8),
                no_edge_line: 0.15,
                extra_lane: 0.05,
                density: (0.35, 0.6),
                buildings: 0.0,
                posts: 0.05,
                high_trees: 0.85,
                clear: 0.6,
                hills: (0.02, 0.20),
                canopy: (0.7, 1.0),
                bridge: 0.0,
                ..OPEN
            },
            Self::Suburb => Traits {
                lane_m: (2.8, 3.4),
                shoulder_m: (0.8, 2.8),
                no_edge_line: 0.3,
                density: (0.5, 0.9),
                buildings: 0.45,
                posts: 0.25,
                high_trees: 0.2,
                clear: 0.9,
                rail: 0.05,
                hills: (0.0, 0.10),
                canopy: (0.1, 0.7),
                bridge: 0.1,
                ..OPEN
            },
            Self::City => Traits {
                lane_m: (2.8, 3.4),
                shoulder_m: (1.5, 3.2),
                no_edge_line: 0.4,
                density: (0.3, 0.7),
                buildings: 0.0,
                posts: 0.6,
                high_trees: 0.1,
                clear: 0.5,
                rail: 0.0,
                hills: (0.0, 0.05),
                canopy: (0.0, 0.3),
                bridge: 0.2,
                ..OPEN
            },
            Self::Motorway => Traits {
                lane_m: (3.4, 3.8),
                shoulder_m: (1.5, 3.2),
                no_edge_line: 0.0,
                extra_lane: 0.35,
                density: (0.1, 0.5),
                buildings: 0.05,
                posts: 0.3,
                high_trees: 0.3,
                clear: 1.6,
                rail: 0.85,
                canopy: (0.0, 0.1),
                bridge: 0.5,
                ..OPEN
            },
            Self::Hillside => Traits {
                lane_m: (2.9, 3.5),
                shoulder_m: (0.2, 1.0),
                density: (0.3, 0.7),
                buildings: 0.03,
                posts: 0.25,
                high_trees: 0.3,
                clear: 0.8,
                rail: 0.4,
                hills: (0.12, 0.32),
                canopy: (0.2, 1.0),
                bridge: 0.05,
                ..OPEN
            },
        }
    }
}
