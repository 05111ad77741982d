//! What a page says of a journal: its alarms, what is kept of them, and what was judged.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::capture::clock::ClockTime;
use crate::monitor::alarm::{AlarmState, Reason};
use crate::monitor::profile::TapProfile;
use crate::record::events::{self, Moment};
use crate::record::journal::{About, Entry, Reading};
use crate::reference::cause::{Cause, LikelyCause};

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
    /// When it began, seconds: the first line in `Gap`, if there is one.
    pub from_s: f64,
    /// When the suspicion before a gap began; `None` if there was none.
    pub suspected_s: Option<f64>,
    /// When the state was left, or the last line's time.
    pub to_s: f64,
    /// The run ended before the state was left.
    pub open: bool,
    /// The largest score inside, and in the suspicion before.
    pub score_max: Option<f64>,
    /// The largest gap inside, and in the suspicion before.
    pub gap_max: Option<f64>,
    /// The largest change inside, and in the suspicion before.
    pub change_max: Option<f64>,
    /// The largest forecast of the share of lanes that the model loses, inside and in the suspicion before.
    pub lanes_max: Option<f64>,
    /// The cause that was most probable inside, with its mean probability over the lines that name a cause. A line that
    /// names another cause counts as 0.
    pub cause: Option<LikelyCause>,
    /// The tap whose own score led at that moment, where the journal says so.
    pub leader: Option<String>,
    /// Reasons inside, without `none`, in the order of their first line.
    pub reasons: Vec<String>,
    /// Why frames inside were not judged, with their number.
    pub health: BTreeMap<String, usize>,
    pub(super) lines: Lines,
}

/// The lines of an alarm, by their places.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lines {
    /// The first one of the suspicion before, or of the alarm if there was none.
    pub(super) suspected: usize,
    /// The first one of the alarm.
    pub(super) first: usize,
    /// The one with the largest score.
    pub(super) worst: usize,
    /// The one after the last.
    pub(super) next: usize,
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
            .flat_map(|entry| entry.tap_gap.keys().cloned())
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
                let Lines {
                    suspected, next, ..
                } = alarm.lines;
                self.entries[suspected..next].iter().any(|entry| {
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
                let caption = caption(moment);
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

    /// Alarms, suspicions that came to nothing, and outages, in order of time.
    pub fn alarms(&self) -> &[Alarm] {
        &self.alarms
    }

    /// Number of those that are in one of these states.
    pub fn count(&self, states: &[AlarmState]) -> usize {
        let alarms = self.alarms.iter();
        alarms.filter(|alarm| states.contains(&alarm.state)).count()
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
        for entry in self.entries.iter().filter(|entry| is_unjudged(entry)) {
            *reasons.entry(why(entry)).or_default() += 1;
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

    /// Time of day, UTC, of a moment of a run that was seen live; `None` of others, and if the clock was not set.
    pub(super) fn time_of_day(&self, t_s: f64) -> Option<String> {
        let began: jiff::Timestamp = self.began.utc.parse().ok()?;
        let since = jiff::SignedDuration::try_from_secs_f64(t_s).ok()?;
        let at = began.checked_add(since).ok()?;
        (self.about.live && self.began.is_set).then(|| at.strftime("%H:%M:%S UTC").to_string())
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

/// What the caption of a moment's picture says.
fn caption(moment: &Moment) -> String {
    let mut caption = format!("{:.2} s, {}", moment.t_s, moment.state);
    if let (Some(cause), Some(probability)) = (moment.cause, moment.cause_probability) {
        caption += &format!(", {}", LikelyCause { cause, probability });
    }
    caption
}

/// Whether this is the last line of a run that was stopped: it says nothing of the road or of the camera.
pub(super) fn is_end(entry: &Entry) -> bool {
    entry.reason == Reason::Stopped.name()
}

fn is_unjudged(entry: &Entry) -> bool {
    entry.gap.is_none() && !is_end(entry)
}

/// Why a line has no score. A line without a frame has no health.
fn why(entry: &Entry) -> &str {
    match entry.health.as_str() {
        "ok" => &entry.reason,
        health => health,
    }
}

/// Lines that belong to one alarm have the same kind; those that belong to none have no kind.
fn kind(entry: &Entry) -> Option<AlarmState> {
    match entry.state {
        _ if is_end(entry) => None,
        AlarmState::Init | AlarmState::Ok => None,
        AlarmState::Suspect | AlarmState::Gap => Some(AlarmState::Gap),
        AlarmState::SensorFault | AlarmState::Unavailable => Some(entry.state),
    }
}

fn alarms(entries: &[Entry]) -> Vec<Alarm> {
    let mut alarms = Vec::new();
    let mut first = 0;
    for lines in entries.chunk_by(|a, b| kind(a) == kind(b)) {
        let next = first + lines.len();
        if let Some(kind) = kind(&lines[0]) {
            alarms.push(alarm(entries, kind, first, next));
        }
        first = next;
    }
    alarms
}

/// The alarm of the lines from `suspected` to the one before `next`, which are of one kind.
fn alarm(entries: &[Entry], kind: AlarmState, suspected: usize, next: usize) -> Alarm {
    let lines = &entries[suspected..next];
    let begun = lines.iter().position(|entry| entry.state == kind);
    let first = suspected + begun.unwrap_or_default();
    let mut reasons: Vec<String> = Vec::new();
    let mut health = BTreeMap::new();
    let mut worst = suspected;
    for (entry, place) in lines.iter().zip(suspected..) {
        if entry.reason != "none" && !reasons.contains(&entry.reason) {
            reasons.push(entry.reason.clone());
        }
        if is_unjudged(entry) {
            *health.entry(why(entry).to_owned()).or_default() += 1;
        }
        if entry.score > entries[worst].score {
            worst = place;
        }
    }
    let scores = entries[worst].tap_score.iter();
    let leader = scores
        .filter_map(|(tap, score)| Some((tap, (*score)?)))
        .max_by(|a, b| a.1.total_cmp(&b.1));
    let largest =
        |of: fn(&Entry) -> Option<f64>| lines.iter().filter_map(of).max_by(f64::total_cmp);
    Alarm {
        state: begun.map_or(AlarmState::Suspect, |_| kind),
        from_s: entries[first].t_s,
        suspected_s: (first > suspected).then_some(lines[0].t_s),
        to_s: entries[next.min(entries.len() - 1)].t_s,
        open: entries[next..].iter().all(is_end),
        score_max: entries[worst].score,
        gap_max: largest(|entry| entry.gap),
        change_max: largest(|entry| entry.change),
        lanes_max: largest(|entry| entry.lanes),
        cause: likely_cause(&entries[first..next]),
        leader: leader.map(|(tap, _)| tap.clone()),
        reasons,
        health,
        lines: Lines {
            suspected,
            first,
            worst,
            next,
        },
    }
}

/// The cause that was most probable over these lines, see [`Alarm::cause`].
fn likely_cause(lines: &[Entry]) -> Option<LikelyCause> {
    let mut sums: BTreeMap<Cause, f64> = BTreeMap::new();
    let mut count = 0.0;
    for likely in lines.iter().filter_map(|entry| entry.cause) {
        *sums.entry(likely.cause).or_default() += likely.probability;
        count += 1.0;
    }
    let (cause, sum) = sums.into_iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(LikelyCause {
        cause,
        probability: sum / count,
    })
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
            change: score.map(|s| s - 0.25),
            lanes: score.map(|s| s / 10.0),
            cause: None,
            gap: score,
            tap_gap: taps.map(|(tap, _)| (tap.to_owned(), score)).into(),
            tap_similarity: BTreeMap::new(),
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
    fn alarms_run_from_the_first_gap_to_the_line_that_ends_them() {
        let report = report();
        let told: Vec<_> = report
            .alarms()
            .iter()
            .map(|a| (a.state, a.from_s, a.to_s, a.open, a.score_max))
            .collect();
        assert_eq!(
            told,
            [
                (AlarmState::Gap, 3.0, 5.0, false, Some(2.5)),
                (AlarmState::Suspect, 6.0, 7.0, false, Some(1.1)),
                (AlarmState::SensorFault, 7.0, 7.0, true, None),
            ]
        );
        let [gap, suspicion, fault] = report.alarms() else {
            panic!("{:?}", report.alarms());
        };
        assert_eq!(gap.leader.as_deref(), Some("e3"));
        assert_eq!((gap.change_max, gap.lanes_max), (Some(2.25), Some(0.25)));
        assert_eq!(gap.suspected_s, Some(2.0));
        assert_eq!((suspicion.suspected_s, fault.suspected_s), (None, None));
        assert_eq!((fault.change_max, fault.lanes_max), (None, None));
        assert_eq!(fault.health["picture is black"], 1);
        assert_eq!(report.count(&[AlarmState::Gap]), 1);
    }

    #[test]
    fn the_line_that_says_that_the_monitor_stopped_is_no_outage() {
        use AlarmState::{Gap, Ok, Unavailable};
        let mut stopped = entry(3.0, Unavailable, None);
        (stopped.reason, stopped.health) = ("stopped".to_owned(), "ok".to_owned());
        stopped.sequence = None;
        let report = |state| {
            let mut parked = entry(1.0, Unavailable, None);
            (parked.reason, parked.health) = ("parked".to_owned(), "ok".to_owned());
            let entries = vec![
                entry(0.0, Ok, Some(0.1)),
                parked,
                entry(2.0, state, Some(2.0)),
                stopped.clone(),
            ];
            Report::new(Reading {
                entries,
                ..Reading::default()
            })
        };
        let told = |report: &Report| -> Vec<_> {
            let alarms = report.alarms().iter();
            alarms
                .map(|a| (a.state, a.from_s, a.to_s, a.open))
                .collect()
        };
        let outage = (Unavailable, 1.0, 2.0, false);
        assert_eq!(told(&report(Ok)), [outage]);
        // An alarm that goes on until the monitor stops has no end.
        assert_eq!(told(&report(Gap)), [outage, (Gap, 2.0, 3.0, true)]);
        assert_eq!(report(Ok).not_judged(), [("parked", 1)].into());
    }

    #[test]
    fn the_cause_of_an_alarm_is_the_one_with_the_largest_mean_probability_from_its_first_gap_on() {
        use AlarmState::{Gap, Suspect};
        let line = |t_s, state, cause: Option<(Cause, f64)>| Entry {
            cause: cause.map(|(cause, probability)| LikelyCause { cause, probability }),
            ..entry(t_s, state, Some(2.0))
        };
        let report = Report::new(Reading {
            entries: vec![
                line(0.0, Suspect, Some((Cause::Night, 1.0))),
                line(1.0, Gap, Some((Cause::Fog, 0.75))),
                line(2.0, Gap, Some((Cause::Dirt, 0.95))),
                line(3.0, Gap, None),
                line(4.0, Gap, Some((Cause::Fog, 0.45))),
                entry(5.0, AlarmState::Ok, Some(0.0)),
                line(6.0, Gap, None),
            ],
            ..Reading::default()
        });
        let likely = report.alarms()[0].cause.unwrap();
        assert_eq!(likely.cause, Cause::Fog);
        assert!((likely.probability - 0.4).abs() < 1e-12);
        assert_eq!(report.alarms()[1].cause, None);
        let page = report.page("drive.jsonl");
        assert!(page.contains("<td class=\"likely\">fog (40 %)</td>"));
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
        bad.tap_gap = [(hostile.to_owned(), None)].into();
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
