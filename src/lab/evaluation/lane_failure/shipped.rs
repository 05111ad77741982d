//! The forecast that a reference carries, warning of lanes as a monitor with this reference does.

use super::{Entered, Judged, LaneFailure, Looked, RATES_PER_HOUR, Ranks};
use crate::calibration::survey::Survey;
use crate::calibration::{DriveScores, drive_evidence};
use crate::monitor::alarm::Reason;
use crate::monitor::scorer::Scorer;
use crate::monitor::warn::{Answer, WarnOn};
use crate::reference::Reference;

/// Name of the method.
const NAME: &str = "lanes of the reference";

impl Looked {
    /// Rows of the reference's forecast. It warns from a half on, at whatever rate of false alarms that gives:
    /// every rate has the same row. `reference` was made for the encoder that looked, and has a forecast.
    pub(super) fn rows_as_shipped(&self, reference: &Reference) -> Vec<LaneFailure> {
        let drives: Vec<(&Judged, DriveScores, usize)> = self
            .judged
            .iter()
            .map(|judged| (judged, forecasts(&judged.drive.survey, reference), 0))
            .collect();
        let nominal = self.held_out.iter().map(|drive| {
            let scores = forecasts(&drive.survey, reference);
            (scores.entries(1.0), scores.hours())
        });
        let nominal = nominal.fold((0, 0.0), |(entries, hours), (more, longer)| {
            (entries + more, hours + longer)
        });
        let mut row = Ranks::of(&drives).row(NAME.to_owned(), false);
        let entered = drives.iter();
        row.count(entered.map(|(judged, scores, _)| (*judged, Entered::of(scores, 1.0))));
        row.count_nominal(vec![nominal]);
        let at_rate = |&wanted_per_hour| LaneFailure {
            wanted_per_hour,
            ..row.clone()
        };
        RATES_PER_HOUR.iter().map(at_rate).collect()
    }
}

/// The forecasts of a drive, as a monitor that warns of lanes alone scores them.
fn forecasts(drive: &Survey, reference: &Reference) -> DriveScores {
    let lanes = WarnOn::these(&[Answer::Lanes]);
    let mut scorer = Scorer::new(reference, drive.common_size);
    let mut scores = DriveScores::default();
    for (at, evidence) in drive_evidence(drive, &mut scorer) {
        match evidence {
            Ok(of) => scores.add(at, of.score_of(lanes).unwrap_or(0.0), of.fill >= 1.0),
            Err(why) => scores.add_unjudged(at, Reason::from(&why)),
        }
    }
    scores
}
