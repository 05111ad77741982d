//! What one check found, and what to do about it.

use serde::Serialize;

/// What one check found.
#[derive(Serialize)]
pub struct Check {
    pub check: &'static str,
    pub result: Outcome,
    pub found: String,
    /// What to do about it; `None` if there is nothing to do.
    #[serde(rename = "do")]
    pub remedy: Option<String>,
}

#[derive(Clone, Copy, PartialEq, Serialize)]
pub enum Outcome {
    #[serde(rename = "pass")]
    Pass,
    #[serde(rename = "warn")]
    Warn,
    #[serde(rename = "fail")]
    Fail,
    #[serde(rename = "left out")]
    LeftOut,
}

impl Outcome {
    pub fn name(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Warn => "warn",
            Self::Fail => "fail",
            Self::LeftOut => "left out",
        }
    }
}

impl Check {
    pub fn pass(check: &'static str, found: impl Into<String>) -> Self {
        Self {
            check,
            result: Outcome::Pass,
            found: found.into(),
            remedy: None,
        }
    }

    /// It works, but something should be known or done.
    pub fn warn(check: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            result: Outcome::Warn,
            ..Self::fail(check, found, remedy)
        }
    }

    pub fn fail(check: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            check,
            result: Outcome::Fail,
            found: found.into(),
            remedy: Some(remedy.into()),
        }
    }

    pub fn left_out(check: &'static str, why: impl Into<String>) -> Self {
        Self {
            check,
            result: Outcome::LeftOut,
            found: why.into(),
            remedy: None,
        }
    }
}
