//! The world in which a drive is rendered: its look and its elements.

use std::fmt;
use std::str::FromStr;

/// How the simulator's world looks. The same seed gives the same road, traffic and times in every look.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Look {
    /// The plain look that the shipped lane models are trained on.
    #[default]
    Sim,
    /// The plain look, changed towards a real camera: finer and dirtier surfaces, hazy air, lens and sensor. It has the
    /// role of the adapted simulation in a sim-to-real study.
    Realistic,
    /// Another simulator: other materials and light, a wide camera high in a van with its bonnet in view.
    Game,
}

impl Look {
    /// All looks.
    pub const ALL: [Self; 3] = [Self::Sim, Self::Realistic, Self::Game];

    /// The word a user types.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sim => "sim",
            Self::Realistic => "sim-realistic",
            Self::Game => "game",
        }
    }
}

/// A look or an element that does not exist. The caller reports what was found.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no such {what}; wanted {known}")]
pub struct WorldError {
    what: &'static str,
    known: String,
}

impl FromStr for Look {
    type Err = WorldError;

    fn from_str(text: &str) -> Result<Self, WorldError> {
        let named = Self::ALL.into_iter().find(|look| look.name() == text);
        named.ok_or_else(|| WorldError {
            what: "look",
            known: Self::ALL.map(Self::name).join(", "),
        })
    }
}

impl fmt::Display for Look {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What a scene contains besides a flat straight road with paint under an even sky. Each element can be left out, to
/// measure its effect on the lane model or on the gap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Element {
    /// Curvature of the road.
    Curves,
    /// Rise and fall of the road.
    Grades,
    /// Sway in the lane, and pitch of the body.
    Motion,
    /// Worn paint.
    Wear,
    /// Yellow lines.
    YellowPaint,
    /// Grain of asphalt and verge.
    Texture,
    /// Wheel tracks and mended patches.
    Patches,
    /// Joints along and across the road.
    Joints,
    /// Far hills.
    FarHills,
    /// Clouds.
    Clouds,
    /// Shadows across the road.
    Shadows,
    /// Trees, buildings and posts.
    Roadside,
    /// Guard rails and concrete barriers.
    Rails,
    /// Other vehicles.
    Traffic,
    /// Exposure that differs from drive to drive and follows the light.
    Exposure,
    /// In drives that change: trees, buildings, banks, rails, verge and hills, by kind of stretch.
    Scenery,
    /// In drives that change: asphalt with its patches and joints.
    Surface,
    /// In drives that change: width of the lanes, shoulders, one more lane, and kinds of lines.
    Markings,
    /// In drives that change: clouds before the sun.
    Sunlight,
    /// In drives that change: shade of trees.
    Canopy,
    /// In drives that change: bridges over the road.
    Bridges,
    /// In drives that change: haze.
    Haze,
}

impl Element {
    /// All elements.
    pub const ALL: [Self; 22] = [
        Self::Curves,
        Self::Grades,
        Self::Motion,
        Self::Wear,
        Self::YellowPaint,
        Self::Texture,
        Self::Patches,
        Self::Joints,
        Self::FarHills,
        Self::Clouds,
        Self::Shadows,
        Self::Roadside,
        Self::Rails,
        Self::Traffic,
        Self::Exposure,
        Self::Scenery,
        Self::Surface,
        Self::Markings,
        Self::Sunlight,
        Self::Canopy,
        Self::Bridges,
        Self::Haze,
    ];

    /// The elements that only drives with stretches have.
    pub const OF_CHANGES: [Self; 7] = [
        Self::Scenery,
        Self::Surface,
        Self::Markings,
        Self::Sunlight,
        Self::Canopy,
        Self::Bridges,
        Self::Haze,
    ];

    /// The word a user types.
    pub fn name(self) -> &'static str {
        match self {
            Self::Curves => "curves",
            Self::Grades => "grades",
            Self::Motion => "motion",
            Self::Wear => "wear",
            Self::YellowPaint => "yellow-paint",
            Self::Texture => "texture",
            Self::Patches => "patches",
            Self::Joints => "joints",
            Self::FarHills => "far-hills",
            Self::Clouds => "clouds",
            Self::Shadows => "shadows",
            Self::Roadside => "roadside",
            Self::Rails => "rails",
            Self::Traffic => "traffic",
            Self::Exposure => "exposure",
            Self::Scenery => "scenery",
            Self::Surface => "surface",
            Self::Markings => "markings",
            Self::Sunlight => "sunlight",
            Self::Canopy => "canopy",
            Self::Bridges => "bridges",
            Self::Haze => "haze",
        }
    }
}

impl FromStr for Element {
    type Err = WorldError;

    fn from_str(text: &str) -> Result<Self, WorldError> {
        let named = Self::ALL.into_iter().find(|element| element.name() == text);
        named.ok_or_else(|| WorldError {
            what: "element",
            known: Self::ALL.map(Self::name).join(", "),
        })
    }
}

impl fmt::Display for Element {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A look, the elements that are left out of it, and how a drive changes along the way.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct World {
    /// The look.
    pub look: Look,
    /// Elements left out.
    pub without: Vec<Element>,
    /// Mean length of the stretches of different kinds through which the road passes, metres; 0 = the road is of one
    /// kind.
    pub stretch_m: u32,
    /// Whether nothing but the lamps of vehicles lights the night.
    pub unlit: bool,
}

impl World {
    /// The whole world of a look.
    pub fn of(look: Look) -> Self {
        Self {
            look,
            ..Self::default()
        }
    }

    /// Whether an element is there.
    pub fn has(&self, element: Element) -> bool {
        !self.without.contains(&element)
    }

    /// `value` if the element is there, else `absent`.
    pub fn when<T>(&self, element: Element, value: T, absent: T) -> T {
        if self.has(element) { value } else { absent }
    }
}
