//! What a page says of a journal: its alarms, what is kept of them, and what was judged.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::capture::clock::ClockTime;
use crate::monitor::alarm::AlarmState;
use crate::monitor::profile::TapProfile;
use crate::record::events::{self, Moment};
use crate::record::journal::{About, Entry, Reading};

/// Times that differ less are the same: the journal writes every digit.
const SAME_TIME_S: f64 = 1e-6;
/// About how many moments of an event are shown.
const SHOWN_MOMENTS: usize = 6;
/// Most alarms with pictures: each takes up to a megabyte of the page.
const SHOWN_ALARMS_MAX: usize = 50;

/// What a journal says as a whole.
#[derive(Debug)]
pub struct Report {
    pub(super) about: About,
    pub(super) began: ClockTime,
    /// The run was ended while it wrote its last line.
    pub(super) breaks_off: bool,
    pub(super) entries: Vec<Entry>,
    pub(super) alarms: Vec<Alarm>,
    pub(super) taps: Vec<String>,
    /// By the alarm's place.
    pub(super) shown: BTreeMap<usize, ShownEvent>,
}

/// What is kept of an alarm.
#[derive(Debug, Default)]
pub struct ShownEvent {
    pub(super) pictures: Vec<Shown>,
    /// The window at the gap's beginning, or, where it came to none, at the suspicion's; one entry a tap.
    pub(super) profiles: Vec<TapProfile>,
}

/// A picture beside an alarm.
#[derive(Debug)]
pub struct Shown {
    /// Bytes of a JPEG file.
    pub(super) jpeg: Vec<u8>,
    /// What it shows.
    pub(super) caption: String,
    /// Where the encoder looked, of this tap.
    pub(super) tap: Option<String>,
}

/// A stretch of one kind of trouble: `Suspect` and `Gap` together, `SensorFault`, or `Unavailable`.
#[derive(Clone, Debug, PartialEq)]
pub struct Alarm {
    /// `Gap`, `Suspect` when it went no further, `SensorFault` or `Unavailable`.
    pub state: AlarmState,
    /// When it began, seconds.
    pub from_s: f64,
    /// When the state was left, or the last line's time.
    pub to_s: f64,
    /// The journal ends before the state was left.
    pub open: bool,
    /// The largest score inside.
    pub score_max: Option<f64>,
    /// The tap whose own score led at that moment, where the journal says so.
    pub leader: Option<String>,
    /// Reasons inside, without `none`, in the order of their first line.
    pub reasons: Vec<String>,
    /// Why frames inside were not judged, with their number.
    pub health: BTreeMap<String, usize>,
    /// Its lines: first, the one with the largest score, and the one after the last.
    pub(super) lines: (usize, usize, usize),
}

impl Report {
    /// The report of a journal; an empty one gives an empty report.
    pub fn new(reading: Reading) -> Self {
        let Reading {
            about,
            began,
            entries,
            breaks_off,
        } = reading;
        let taps: BTreeSet<String> = entries
            .iter()
            .flat_map(|entry| entry.gap.keys().cloned())
            .collect();
        Self {
            alarms: alarms(&entries),
            taps: taps.into_iter().collect(),
            about,
            began,
            breaks_off,
            entries,
            shown: BTreeMap::new(),
        }
    }

    /// Shows the evidence of a folder beside the alarms that it belongs to: those in which the journal has the moment that
    /// began it.
    ///
    /// # Errors
    /// When the folder or a file in it cannot be read.
    pub fn show(&mut self, folder: &Path) -> Result<(), events::ReadError> {
        for (folder, event) in events::read(folder)? {
            let began = &event.moments[event.edge];
            let place = self.alarms.iter().position(|alarm| {
                let (first, _, next) = alarm.lines;
                self.entries[first..next].iter().any(|entry| {
                    (entry.sequence, entry.score) == (Some(began.seq), began.score)
                        && entry
                            .captured_s
                            .is_some_and(|at| (at - began.t_s).abs() < SAME_TIME_S)
                })
            });
            let Some(place) = place.filter(|_| self.shown.len() < SHOWN_ALARMS_MAX) else {
                continue;
            };
            let evidence = self.shown.entry(place).or_default();
            let profiled = event.moments.iter().rfind(|m| !m.profiles.is_empty());
            if let Some(moment) = profiled.filter(|_| evidence.profiles.is_empty()) {
                evidence.profiles.clone_from(&moment.profiles);
            }
            let shown = &mut evidence.pictures;
            for moment in thinned(&event.moments, event.edge) {
                let caption = format!("{:.2} s, {}", moment.t_s, moment.state);
                shown.push(Shown {
                    jpeg: events::picture(&folder, &moment.frame)?,
                    caption: caption.clone(),
                    tap: None,
                });
                for (tap, file) in &moment.heat {
                    shown.push(Shown {
                        jpeg: events::picture(&folder, file)?,
                        caption: caption.clone(),
                        tap: Some(tap.clone()),
                    });
                }
            }
        }
        Ok(())
    }

    /// Lines of the journal.
    pub fn lines(&self) -> usize {
        self.entries.len()
    }

    /// From the first line to the last, seconds.
    pub fn span_s(&self) -> f64 {
        match (self.entries.first(), self.entries.last()) {
            (Some(first), Some(last)) => last.t_s - first.t_s,
            _ => 0.0,
        }
    }

    /// Alarms and outages in order of time.
    pub fn alarms(&self) -> &[Alarm] {
        &self.alarms
    }

    /// Time spent in a state: each line's state holds until the next line.
    pub fn in_state_s(&self, state: AlarmState) -> f64 {
        self.entries
            .windows(2)
            .filter(|pair| pair[0].state == state)
            .map(|pair| pair[1].t_s - pair[0].t_s)
            // An empty sum is -0.
            .fold(0.0, |sum, seconds| sum + seconds)
    }

    /// Why frames were not judged, with their number.
    pub fn not_judged(&self) -> BTreeMap<&str, usize> {
        let mut reasons = BTreeMap::new();
        for entry in self.entries.iter().filter(|entry| entry.score.is_none()) {
            *reasons.entry(entry.health.as_str()).or_default() += 1;
        }
        reasons
    }

    /// Nearest-rank quantiles of the time from frame to verdict, milliseconds; `None` without frames.
    pub fn latency_ms<const N: usize>(&self, shares: [f64; N]) -> Option<[f64; N]> {
        let frames = self.entries.iter().filter(|e| e.sequence.is_some());
        let mut sorted: Vec<f64> = frames.map(|entry| entry.latency_ms).collect();
        sorted.sort_by(f64::total_cmp);
        let last = sorted.len().checked_sub(1)?;
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss
        )]
        let rank = |share: f64| (share * sorted.len() as f64).ceil() as usize;
        Some(shares.map(|share| sorted[rank(share).saturating_sub(1).min(last)]))
    }

    /// Frames that the source numbered but the journal does not have.
    pub fn missing_frames(&self) -> u64 {
        let numbers: BTreeSet<u64> = self.entries.iter().filter_map(|e| e.sequence).collect();
        match (numbers.first(), numbers.last()) {
            (Some(first), Some(last)) => (last - first).saturating_sub(numbers.len() as u64 - 1),
            _ => 0,
        }
    }
}

/// Few moments of many: those with heat maps and some between, evenly spread.
fn thinned(moments: &[Moment], edge: usize) -> impl Iterator<Item = &Moment> {
    let every = moments.len().div_ceil(SHOWN_MOMENTS).max(1);
    let chosen = move |place: usize, moment: &Moment| {
        place % every == edge % every || !moment.heat.is_empty()
    };
    let moments = moments.iter().enumerate();
    moments.filter_map(move |(place, moment)| chosen(place, moment).then_some(moment))
}

/// States that belong to one alarm have the same kind; those that are none have no kind.
fn kind(state: AlarmState) -> Option<AlarmState> {
    match state {
        AlarmState::Init | AlarmState::Ok => None,
        AlarmState::Suspect | AlarmState::Gap => Some(AlarmState::Gap),
        AlarmState::SensorFault | AlarmState::Unavailable => Some(state),
    }
}

fn alarms(entries: &[Entry]) -> Vec<Alarm> {
    let mut alarms = Vec::new();
    let mut first = 0;
    for lines in entries.chunk_by(|a, b| kind(a.state) == kind(b.state)) {
        let next = first + lines.len();
        if kind(lines[0].state).is_some() {
            alarms.push(alarm(entries, first, next));
        }
        first = next;
    }
    alarms
}

fn alarm(entries: &[Entry], first: usize, next: usize) -> Alarm {
    let lines = &entries[first..next];
    let mut reasons: Vec<String> = Vec::new();
    let mut health = BTreeMap::new();
    let mut worst = first;
    for (entry, place) in lines.iter().zip(first..) {
        if entry.reason != "none" && !reasons.contains(&entry.reason) {
            reasons.push(entry.reason.clone());
        }
        if entry.score.is_none() {
            *health.entry(entry.health.clone()).or_default() += 1;
        }
        if entry.score > entries[worst].score {
            worst = place;
        }
    }
    let scores = entries[worst].tap_score.iter();
    let leader = scores
        .filter_map(|(tap, score)| Some((tap, (*score)?)))
        .max_by(|a, b| a.1.total_cmp(&b.1));
    let suspect_only = lines.iter().all(|e| e.state == AlarmState::Suspect);
    Alarm {
        state: if suspect_only {
            AlarmState::Suspect
        } else {
            kind(lines[0].state).unwrap_or(lines[0].state)
        },
        from_s: lines[0].t_s,
        to_s: entries[next.min(entries.len() - 1)].t_s,
        open: next == entries.len(),
        score_max: entries[worst].score,
        leader: leader.map(|(tap, _)| tap.clone()),
        reasons,
        health,
        lines: (first, worst, next),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    fn entry(t_s: f64, state: AlarmState, score: Option<f64>) -> Entry {
        let taps = [("e2", 0.5), ("e3", 1.0)];
        Entry {
            t_s,
            captured_s: Some(t_s),
            sequence: Some(0),
            state,
            reason: "none".to_owned(),
            score,
            gap: taps.map(|(tap, _)| (tap.to_owned(), score)).into(),
            similarity: BTreeMap::new(),
            tap_score: taps
                .map(|(tap, share)| (tap.to_owned(), score.map(|s| s * share)))
                .into(),
            health: if score.is_some() {
                "ok"
            } else {
                "picture is black"
            }
            .to_owned(),
            latency_ms: 10.0 * t_s,
        }
    }

    fn report() -> Report {
        use AlarmState::{Gap, Init, Ok, SensorFault, Suspect};
        Report::new(Reading {
            entries: vec![
                entry(0.0, Init, Some(0.0)),
                entry(1.0, Ok, Some(0.1)),
                entry(2.0, Suspect, Some(1.5)),
                entry(3.0, Gap, Some(2.5)),
                entry(4.0, Gap, Some(2.0)),
                entry(5.0, Ok, Some(0.2)),
                entry(6.0, Suspect, Some(1.1)),
                entry(7.0, SensorFault, None),
            ],
            ..Reading::default()
        })
    }

    #[test]
    fn alarms_run_from_the_first_suspicion_to_the_line_that_ends_them() {
        let report = report();
        let told: Vec<_> = report
            .alarms()
            .iter()
            .map(|a| (a.state, a.from_s, a.to_s, a.open, a.score_max))
            .collect();
        assert_eq!(
            told,
            [
                (AlarmState::Gap, 2.0, 5.0, false, Some(2.5)),
                (AlarmState::Suspect, 6.0, 7.0, false, Some(1.1)),
                (AlarmState::SensorFault, 7.0, 7.0, true, None),
            ]
        );
        assert_eq!(report.alarms()[0].leader.as_deref(), Some("e3"));
        assert_eq!(report.alarms()[2].health["picture is black"], 1);
    }

    #[test]
    fn time_in_states_adds_up_to_the_span() {
        let report = report();
        assert_eq!(report.in_state_s(AlarmState::Gap), 2.0);
        assert_eq!(report.in_state_s(AlarmState::Suspect), 2.0);
        assert_eq!(report.in_state_s(AlarmState::SensorFault), 0.0);
        assert_eq!(report.span_s(), 7.0);
        assert_eq!(report.not_judged()["picture is black"], 1);
    }

    #[test]
    fn latency_quantiles_are_lines_of_the_journal() {
        assert_eq!(report().latency_ms([0.5, 1.0]), Some([30.0, 70.0]));
        assert_eq!(Report::new(Reading::default()).latency_ms([0.5]), None);
    }

    #[test]
    fn what_the_journal_says_is_text_on_the_page_and_never_markup() {
        let hostile = "</script><script>alert(1)</script>'\"><img src=x onerror=alert(2)>\u{202e}";
        let mut bad = entry(0.0, AlarmState::Unavailable, None);
        bad.reason = hostile.to_owned();
        bad.health = hostile.to_owned();
        bad.gap = [(hostile.to_owned(), None)].into();
        bad.tap_score = [(hostile.to_owned(), Some(1.0))].into();
        let about = About {
            source: hostile.to_owned(),
            thresholds: hostile.to_owned(),
            ..About::default()
        };
        let reading = Reading {
            about,
            entries: vec![bad],
            ..Reading::default()
        };
        let page = Report::new(reading).page(hostile);
        assert!(!page.contains("<script>alert") && !page.contains("<img src=x"));
        assert_eq!(page.matches("</script>").count(), 2, "data and program");
        assert!(page.contains("&lt;/script&gt;&lt;script&gt;alert(1)"));
    }
}
