//! The distance of a drive from a nominal domain, as it is reported.

use std::fmt;

use crate::reference::Role;

/// Distance from which on a held-out drive is far from all domains: it would make thresholds three times as wide. Measured:
/// at most 0.24 for rendered drives among their like, 2.5 for roads that change among roads that do not, 0.1 for halves of a
/// real road; 3.2 and more for another look, other simulators and real roads among drives of 12 to 50 fitted worlds.
const HELD_OUT_FAR: f64 = 3.0;
/// Distance from which on an accepted drive is far from the other ones of its domain, or two drives from each other. Measured: at
/// most 0.5 for rendered drives of one look and for parts of a real road, and 2.2 for a look of which drives differ more;
/// among these, 2.3 and more for another look, another simulator or a real road, but 1.1 and more with the wide margins of
/// the reference inside the program.
const ACCEPTED_FAR: f64 = 2.5;
/// Distance from which on nine of ten windows of an accepted drive would be a gap to the other drives of its domain.
const ACCEPTED_DOUBTFUL: f64 = 1.0;

/// How far a drive is from a nominal domain.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveDistance {
    /// The drive.
    pub source: String,
    /// Its role: held out or accepted.
    pub role: Role,
    /// The domain: of a held-out drive the nearest one, of an accepted drive its own without it.
    pub domain: String,
    /// The drive with which it was compared; `None` for a whole domain.
    pub beside: Option<String>,
    /// What nine of ten windows of the drive are at least. 0 is the median gap of the domain's own windows and 1 their limit:
    /// their 99 % quantile, before held-out drives move it, and for an accepted domain with the margins of the simulation.
    pub distance: f64,
}

impl fmt::Display for DriveDistance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            source,
            domain,
            distance,
            ..
        } = self;
        let limit = self.limit();
        match (&self.beside, self.role) {
            (Some(beside), _) => write!(
                f,
                "accepted drives {source} and {beside} of domain {domain} are {distance:.1} times as far from each other as the limit that each sets alone; far is {limit} or more"
            ),
            (None, Role::Accepted) => write!(
                f,
                "accepted drive {source} is {distance:.1} times as far from the other drives of domain {domain} as the limit that they set; far is {limit} or more"
            ),
            (None, _) => write!(
                f,
                "held-out drive {source} is {distance:.1} times as far from domain {domain}, the nearest one, as its limit; far is {limit} or more"
            ),
        }
    }
}

impl DriveDistance {
    /// Whether the drive is of another kind than the domain, or than the other drive.
    pub fn is_far(&self) -> bool {
        self.distance >= self.limit()
    }

    /// Whether an accepted drive would be a gap to the others of its domain, although it is not far.
    pub fn is_doubtful(&self) -> bool {
        let among = self.role == Role::Accepted && self.beside.is_none();
        among && !self.is_far() && self.distance >= ACCEPTED_DOUBTFUL
    }

    fn limit(&self) -> f64 {
        match self.role {
            Role::Accepted => ACCEPTED_FAR,
            _ => HELD_OUT_FAR,
        }
    }
}
