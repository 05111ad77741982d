//! The three answers about a road, and which of them raise the warning.

use std::fmt;
use std::str::FromStr;

use crate::reference::Reference;

/// Forecast share of lost lanes from which on the lane model counts as lost.
pub const LANES_LOST: f64 = 0.5;

/// An answer about the road.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// How far the road is from the nearest nominal domain.
    Gap,
    /// How far the road differs from its own past.
    Change,
    /// What share of its lanes the model is forecast to lose.
    Lanes,
}

impl Answer {
    /// All answers.
    pub const ALL: [Self; 3] = [Self::Gap, Self::Change, Self::Lanes];

    /// The word that a user types.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gap => "gap",
            Self::Change => "change",
            Self::Lanes => "lanes",
        }
    }
}

/// Not the name of an answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no answer; wanted gap, change or lanes")]
pub struct NoAnswer(String);

impl FromStr for Answer {
    type Err = NoAnswer;

    fn from_str(text: &str) -> Result<Self, NoAnswer> {
        let named = Self::ALL.into_iter().find(|answer| answer.name() == text);
        named.ok_or_else(|| NoAnswer(text.to_owned()))
    }
}

/// The answers that raise the warning. The others are reported, and set no state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WarnOn {
    /// A gap and its drift.
    pub gap: bool,
    /// A change.
    pub change: bool,
    /// A forecast of at least [`LANES_LOST`].
    pub lanes: bool,
}

impl Default for WarnOn {
    /// Gap and change: they have thresholds for a rate of false alarms. A forecast has none.
    fn default() -> Self {
        Self {
            gap: true,
            change: true,
            lanes: false,
        }
    }
}

/// What cannot raise a warning.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WarnOnError {
    /// The reference has no forecast.
    #[error(
        "lanes raise the warning, but the reference has no forecast of lost lanes; wanted one that was calibrated with --labelled"
    )]
    NoForecast,
    /// The reference knows no changes.
    #[error(
        "changes raise the warning, but the reference knows none; wanted one of mahalanobis that was calibrated with --evidence windows"
    )]
    NoChanges,
    /// Any real road is a gap.
    #[error(
        "gaps raise the warning, but the reference is made of simulation alone, so any real road is a gap to it"
    )]
    Strict,
}

impl WarnOn {
    /// These answers.
    pub fn these(answers: &[Answer]) -> Self {
        Self {
            gap: answers.contains(&Answer::Gap),
            change: answers.contains(&Answer::Change),
            lanes: answers.contains(&Answer::Lanes),
        }
    }

    /// The default for a reference: gap and change. On a real road, a reference made of simulation alone answers "gap"
    /// all the time and "change" most of the time, so there it is its forecast of lanes, if it has one.
    pub fn suited_to(reference: &Reference, is_real: bool) -> Self {
        if reference.strict && is_real && reference.lanes.is_some() {
            Self {
                gap: false,
                change: false,
                lanes: true,
            }
        } else {
            Self::default()
        }
    }

    /// Refuses answers that a reference does not give, and a gap that it would give on any real road.
    ///
    /// # Errors
    /// What cannot raise a warning.
    pub fn check(self, reference: &Reference, is_real: bool) -> Result<(), WarnOnError> {
        if self.lanes && reference.lanes.is_none() {
            return Err(WarnOnError::NoForecast);
        }
        if self.change && !self.gap && !reference.knows_changes() {
            return Err(WarnOnError::NoChanges);
        }
        if self.gap && reference.strict && is_real {
            return Err(WarnOnError::Strict);
        }
        Ok(())
    }

    /// Whether an answer raises the warning.
    pub fn has(self, answer: Answer) -> bool {
        match answer {
            Answer::Gap => self.gap,
            Answer::Change => self.change,
            Answer::Lanes => self.lanes,
        }
    }
}

impl fmt::Display for WarnOn {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = Answer::ALL.into_iter().filter(|&answer| self.has(answer));
        let names: Vec<&str> = names.map(Answer::name).collect();
        f.write_str(&names.join(", "))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn answers_are_read_and_written_by_their_names() {
        let names: Vec<Answer> = ["lanes", "gap"].map(|name| name.parse().unwrap()).into();
        assert_eq!(WarnOn::these(&names).to_string(), "gap, lanes");
        let refused = "score".parse::<Answer>().unwrap_err().to_string();
        assert_eq!(
            refused,
            "\"score\" is no answer; wanted gap, change or lanes"
        );
    }

    #[test]
    fn on_a_real_road_simulation_alone_warns_of_lanes() {
        let shipped = Reference::read(None).unwrap();
        assert!(shipped.strict && shipped.lanes.is_some());
        let lanes = WarnOn::these(&[Answer::Lanes]);
        assert_eq!(WarnOn::suited_to(&shipped, true), lanes);
        assert_eq!(WarnOn::suited_to(&shipped, false), WarnOn::default());
        assert_eq!(
            WarnOn::default().check(&shipped, true),
            Err(WarnOnError::Strict)
        );
        assert_eq!(WarnOn::default().check(&shipped, false), Ok(()));
        let without = shipped.with_lanes(None);
        assert_eq!(WarnOn::suited_to(&without, true), WarnOn::default());
        assert_eq!(lanes.check(&without, true), Err(WarnOnError::NoForecast));
    }
}
