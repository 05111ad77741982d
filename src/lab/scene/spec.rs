//! A drive as a user writes it: `scene:NAME?seed=7&seconds=60&fps=10&condition=fog:3@20-40`.

use std::str::FromStr;

use super::conditions::{Condition, ConditionError};
use super::world::{Look, World, WorldError};

/// Default size of rendered drives, pixels: that of the built-in encoder.
const SIZE_PX: (u32, u32) = (320, 160);

/// A rendered drive as a frame source.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveSpec {
    /// Look, and elements that are left out.
    pub world: World,
    /// Seed of the drive.
    pub seed: u64,
    /// Length, seconds.
    pub seconds: f64,
    /// Frames a second.
    pub fps: f64,
    /// Width and height of the pictures, pixels.
    pub size_px: (u32, u32),
    /// Conditions over the drive's time.
    pub conditions: Vec<Condition>,
}

impl Default for DriveSpec {
    /// Values for everything that a user does not give.
    fn default() -> Self {
        Self {
            world: World::default(),
            seed: 1,
            seconds: 60.0,
            fps: 10.0,
            size_px: SIZE_PX,
            conditions: Vec::new(),
        }
    }
}

impl DriveSpec {
    /// Number of frames of the whole drive.
    pub fn frames(&self) -> u64 {
        // Both factors are positive and their product is at most 86,400 s of 240 frames.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        {
            (self.seconds * self.fps).ceil() as u64
        }
    }
}

/// A drive that cannot be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SpecError {
    /// The look or an element does not exist.
    #[error("scene {found:?}: {error}")]
    World {
        /// The text as typed.
        found: String,
        /// What was wanted.
        error: WorldError,
    },
    /// A parameter is unknown or has a value out of range.
    #[error(
        "scene parameter {0:?}: wanted seed=N, seconds=0.1..86400, fps=0.1..240, size=WxH, stretch=0 or 100..10000, unlit=0 or 1, without=ELEMENT or condition=KIND:SEVERITY[@FROM-TO]"
    )]
    Parameter(String),
    /// A condition cannot be read.
    #[error("scene condition {found:?}: {error}")]
    Condition {
        /// The text as typed.
        found: String,
        /// What was wanted.
        error: ConditionError,
    },
}

impl FromStr for DriveSpec {
    type Err = SpecError;

    /// Reads what follows `scene:`.
    fn from_str(text: &str) -> Result<Self, SpecError> {
        let (name, parameters) = text.split_once('?').unwrap_or((text, ""));
        let look_or_element = |found: &str, error: WorldError| SpecError::World {
            found: found.to_owned(),
            error,
        };
        let look: Look = name.parse().map_err(|error| look_or_element(name, error))?;
        let mut spec = Self {
            world: World::of(look),
            ..Self::default()
        };
        for parameter in parameters.split('&').filter(|p| !p.is_empty()) {
            let wrong = || SpecError::Parameter(parameter.to_owned());
            let (key, value) = parameter.split_once('=').ok_or_else(wrong)?;
            let number = |range: std::ops::RangeInclusive<f64>| {
                value
                    .parse::<f64>()
                    .ok()
                    .filter(|v| range.contains(v))
                    .ok_or_else(wrong)
            };
            match key {
                "seed" => spec.seed = value.parse().map_err(|_| wrong())?,
                "seconds" => spec.seconds = number(0.1..=86_400.0)?,
                "fps" => spec.fps = number(0.1..=240.0)?,
                "stretch" => spec.world.stretch_m = stretch_m(value).ok_or_else(wrong)?,
                "unlit" => {
                    spec.world.unlit = match value {
                        "0" => false,
                        "1" => true,
                        _ => return Err(wrong()),
                    }
                }
                "size" => spec.size_px = size(value).ok_or_else(wrong)?,
                "without" => {
                    let element = value.parse().map_err(|error| look_or_element(value, error));
                    spec.world.without.push(element?);
                }
                "condition" => {
                    let condition = value.parse().map_err(|error| SpecError::Condition {
                        found: value.to_owned(),
                        error,
                    });
                    spec.conditions.push(condition?);
                }
                _ => return Err(wrong()),
            }
        }
        Ok(spec)
    }
}

/// Reads the mean length of a stretch, whole metres: 0 or 100 to 10000.
pub fn stretch_m(text: &str) -> Option<u32> {
    let stretch_m = text.parse().ok()?;
    (stretch_m == 0 || (100..=10_000).contains(&stretch_m)).then_some(stretch_m)
}

/// Reads `WxH`, each side from 16 to 8192.
fn size(text: &str) -> Option<(u32, u32)> {
    let side = |side: &str| side.parse().ok().filter(|s| (16..=8_192).contains(s));
    let (width, height) = text.split_once('x')?;
    Some((side(width)?, side(height)?))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    #[test]
    fn a_drive_is_read_with_its_defaults() {
        let spec: DriveSpec =
            "sim?seed=7&condition=fog:3@20-40&condition=dirt:1&without=traffic&stretch=400&unlit=1"
                .parse()
                .unwrap();
        assert_eq!(spec.world.without, [super::super::Element::Traffic]);
        assert_eq!((spec.world.stretch_m, spec.world.unlit), (400, true));
        assert_eq!((spec.seed, spec.seconds, spec.fps), (7, 60.0, 10.0));
        assert_eq!(spec.conditions.len(), 2);
    }

    #[test]
    fn wrong_drives_are_refused_by_the_part_that_is_wrong() {
        for (text, part) in [
            ("moon", "\"moon\""),
            ("sim?speed=3", "speed=3"),
            ("sim?fps=0", "fps=0"),
            ("sim?size=8x8", "size=8x8"),
            ("sim?stretch=99", "stretch=99"),
            ("sim?stretch=-1", "stretch=-1"),
            ("sim?stretch=10001", "stretch=10001"),
            ("sim?stretch=4e2", "stretch=4e2"),
            ("sim?unlit=yes", "unlit=yes"),
            ("sim?without=rain", "no such element; wanted curves"),
            ("sim?seconds=inf", "seconds=inf"),
            ("sim?condition=fog", "scene condition \"fog\": wanted KIND"),
        ] {
            let message = text.parse::<DriveSpec>().unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
