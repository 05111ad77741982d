//! What most likely causes a gap, in words for people and in codes for the bus. Only the types: nothing is classified
//! here.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A cause of a gap.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cause {
    /// Fog.
    Fog,
    /// Night.
    Night,
    /// Rain.
    Rain,
    /// Snow.
    Snow,
    /// A low sun or other light that blinds the camera.
    Glare,
    /// Dirt on the lens.
    Dirt,
    /// The picture is out of focus, or blurred by motion.
    Blur,
    /// Noise of the sensor.
    Noise,
    /// The camera does not look where it looked before.
    Askew,
    /// A tunnel.
    Tunnel,
    /// A road of another kind.
    AnotherRoad,
    /// None of these.
    Other,
}

impl Cause {
    /// All causes.
    pub const ALL: [Self; 12] = [
        Self::Fog,
        Self::Night,
        Self::Rain,
        Self::Snow,
        Self::Glare,
        Self::Dirt,
        Self::Blur,
        Self::Noise,
        Self::Askew,
        Self::Tunnel,
        Self::AnotherRoad,
        Self::Other,
    ];

    /// The name, which is the same everywhere.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fog => "fog",
            Self::Night => "night",
            Self::Rain => "rain",
            Self::Snow => "snow",
            Self::Glare => "glare",
            Self::Dirt => "dirt",
            Self::Blur => "blur",
            Self::Noise => "noise",
            Self::Askew => "askew",
            Self::Tunnel => "tunnel",
            Self::AnotherRoad => "another-road",
            Self::Other => "other",
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A word that names no cause.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("unknown cause `{0}`: wanted {all}", all = Cause::ALL.map(Cause::name).join(", "))]
pub struct UnknownCause(pub String);

impl FromStr for Cause {
    type Err = UnknownCause;

    fn from_str(name: &str) -> Result<Self, UnknownCause> {
        let found = Self::ALL.into_iter().find(|cause| cause.name() == name);
        found.ok_or_else(|| UnknownCause(name.to_owned()))
    }
}

/// The cause that is most likely, and how likely it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LikelyCause {
    /// The cause.
    pub cause: Cause,
    /// Its probability, 0 to 1.
    pub probability: f64,
}

impl fmt::Display for LikelyCause {
    /// `dirt (84 %)`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({:.0} %)", self.cause, 100.0 * self.probability)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn every_cause_has_a_name_of_its_own_that_is_read_back() {
        for (place, cause) in Cause::ALL.into_iter().enumerate() {
            assert_eq!(cause.name().parse(), Ok(cause));
            assert_eq!(cause as usize, place, "{cause}");
            // A file that is read by serde has the same word.
            let word = serde_json::to_string(&cause).unwrap();
            assert_eq!(word, format!("\"{cause}\""));
        }
        let said = "Fog".parse::<Cause>().unwrap_err().to_string();
        assert!(
            said.contains("`Fog`") && said.contains("fog, night"),
            "{said}"
        );
    }

    #[test]
    fn a_likely_cause_is_written_with_its_share_of_a_hundred() {
        let likely = LikelyCause {
            cause: Cause::AnotherRoad,
            probability: 0.836,
        };
        assert_eq!(likely.to_string(), "another-road (84 %)");
    }
}
