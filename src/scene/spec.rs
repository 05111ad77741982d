//! A drive as a user writes it: `scene:NAME?seed=7&seconds=60&fps=10&condition=fog:3@20-40`.

use std::str::FromStr;

use super::conditions::{Condition, ConditionError};

/// How the simulator's world looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// The plain look that the shipped lane model is trained on.
    Sim = 0,
}

impl Look {
    const ALL: [(&'static str, Self); 1] = [("sim", Self::Sim)];
}

/// A rendered drive as a frame source.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveSpec {
    /// Look of the world.
    pub look: Look,
    /// Seed of the drive.
    pub seed: u64,
    /// Length, seconds.
    pub seconds: f64,
    /// Frames a second.
    pub fps: f64,
    /// Conditions over the drive's time.
    pub conditions: Vec<Condition>,
}

/// A drive that cannot be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SpecError {
    /// The look is not one of ours.
    #[error("scene {0:?}: no such look; looks are sim")]
    Look(String),
    /// A parameter is unknown or has a value out of range.
    #[error(
        "scene parameter {0:?}: wanted seed=N, seconds=0.1..86400, fps=0.1..240 or condition=KIND:SEVERITY[@FROM-TO]"
    )]
    Parameter(String),
    /// A condition cannot be read.
    #[error(transparent)]
    Condition(#[from] ConditionError),
}

impl FromStr for DriveSpec {
    type Err = SpecError;

    /// Reads what follows `scene:`.
    fn from_str(text: &str) -> Result<Self, SpecError> {
        let (name, parameters) = text.split_once('?').unwrap_or((text, ""));
        let look = Look::ALL
            .iter()
            .find(|(known, _)| *known == name)
            .ok_or_else(|| SpecError::Look(name.to_owned()))?
            .1;
        let mut spec = Self {
            look,
            seed: 1,
            seconds: 60.0,
            fps: 10.0,
            conditions: Vec::new(),
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
                "condition" => spec.conditions.push(value.parse()?),
                _ => return Err(wrong()),
            }
        }
        Ok(spec)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    #[test]
    fn a_drive_is_read_with_its_defaults() {
        let spec: DriveSpec = "sim?seed=7&condition=fog:3@20-40&condition=dirt:1"
            .parse()
            .unwrap();
        assert_eq!((spec.seed, spec.seconds, spec.fps), (7, 60.0, 10.0));
        assert_eq!(spec.conditions.len(), 2);
    }

    #[test]
    fn wrong_drives_are_refused_by_the_part_that_is_wrong() {
        for (text, part) in [
            ("moon", "\"moon\""),
            ("sim?speed=3", "speed=3"),
            ("sim?fps=0", "fps=0"),
            ("sim?seconds=inf", "seconds=inf"),
            ("sim?condition=fog", "fog"),
        ] {
            let message = text.parse::<DriveSpec>().unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
