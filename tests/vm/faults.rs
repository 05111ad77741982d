//! The table of faults: each has its name on the bus, soon, and never is it `Ok` or `Gap`.

use std::fmt::Write as _;

use gapwatch::can::message::GapStatus;
use gapwatch::monitor::alarm::{AlarmState, Reason};

use super::share::*;
use crate::machine::report;

/// What a fault must be called, and how soon.
struct Row {
    mark: &'static str,
    what: &'static str,
    wanted: Wanted,
}

enum Wanted {
    /// The state stays `Ok`: the fault costs frames, but no verdict for 500 ms.
    Ok,
    /// This state and reason within so many seconds, until the fault is over.
    State(AlarmState, Reason, f64),
    /// Never `Gap`, and `Ok` again when it is over.
    NoGap,
    /// Nothing is on the bus while it lasts.
    Silence,
}

const FAULTS: [Row; 19] = {
    use AlarmState::{SensorFault, Unavailable};
    use Wanted::{NoGap, Ok, Silence, State};
    const fn row(mark: &'static str, what: &'static str, wanted: Wanted) -> Row {
        Row { mark, what, wanted }
    }
    // The player is up to six frames ahead of the camera.
    [
        row("wrap", "the driver's frame numbers wrap", Ok),
        row(
            "black",
            "black picture",
            State(SensorFault, Reason::Black, 0.9),
        ),
        row(
            "grey",
            "picture of one colour",
            State(SensorFault, Reason::Uniform, 0.9),
        ),
        row(
            "frozen",
            "frozen picture",
            State(SensorFault, Reason::Frozen, 1.4),
        ),
        row(
            "covered",
            "lens covered to 62 %, black",
            State(SensorFault, Reason::Covered, 0.9),
        ),
        row(
            "paper",
            "lens covered to 75 %, bright",
            State(SensorFault, Reason::Covered, 2.0),
        ),
        row("damaged", "a buffer flagged as damaged", Ok),
        row("fatal", "fatal error of the stream", Ok),
        row("lost", "30 % of the frames lost", Ok),
        row(
            "stall",
            "camera gives nothing",
            State(Unavailable, Reason::Stale, 0.7),
        ),
        row("offline", "device error until it is closed", Ok),
        row(
            "unplug",
            "camera unplugged",
            State(Unavailable, Reason::Stale, 0.7),
        ),
        row("format", "camera back with another format", NoGap),
        row(
            "parked",
            "car parked for 1 s, which it says",
            State(Unavailable, Reason::Parked, 1.2),
        ),
        row("busdown", "bus down", Silence),
        row("busfull", "queue of the bus full", Ok),
        row("busgone", "bus deleted", Silence),
        row("foreign", "another node sends our GapHealth once", Ok),
        row("paused", "program stopped for 1.5 s", Silence),
    ]
};

#[test]
#[ignore = "needs qemu and Debian's kernel: run tests/run"]
fn vm_faults_are_called_by_name_and_never_ok_or_gap() {
    let share = machine();
    let log = logged(&share);
    let all = statuses(between(&log, "faults", "killed"));
    let marks: Vec<(f64, String)> = log
        .iter()
        .filter(|logged| logged.id == "7F0")
        .map(|logged| (logged.at, String::from_utf8(logged.data.clone()).unwrap()))
        .collect();
    let mut table =
        "| fault | state | told after, s | Ok again after, s |\n|---|---|---|---|\n".to_owned();
    let mut wrong = vec![];
    for row in &FAULTS {
        let at = marks.iter().position(|mark| mark.1 == row.mark).unwrap();
        let [begin, end, next] = [at, at + 1, at + 2].map(|at| marks[at].0);
        let within = |from: f64, to: f64| all.iter().filter(move |(at, _)| (from..to).contains(at));
        let mut complain = |what: String| wrong.push(format!("{}: {what}", row.what));
        let mut told = None;
        match row.wanted {
            Wanted::Ok => {
                for (at, status) in within(begin, next) {
                    if status.state != AlarmState::Ok {
                        complain(format!("{:?} after {:.2} s", status, at - begin));
                    }
                }
            }
            Wanted::State(state, reason, soon) => {
                let is = |status: &GapStatus| (status.state, status.reason) == (state, reason);
                told = within(begin, end)
                    .find(|(_, status)| is(status))
                    .map(|(at, _)| at - begin);
                let from = begin + told.unwrap_or(0.0);
                if told.is_none_or(|told| told > soon) {
                    complain(format!("{reason:?} told after {told:?} s, wanted {soon} s"));
                }
                for (at, status) in within(from, end).filter(|(_, status)| !is(status)) {
                    complain(format!("{status:?} after {:.2} s", at - begin));
                }
                for (at, status) in
                    within(begin, next).filter(|(_, status)| status.state == AlarmState::Gap)
                {
                    complain(format!("{status:?} after {:.2} s", at - begin));
                }
            }
            Wanted::NoGap => {
                for (at, status) in
                    within(begin, next).filter(|(_, status)| status.state == AlarmState::Gap)
                {
                    complain(format!("{status:?} after {:.2} s", at - begin));
                }
            }
            Wanted::Silence => {
                for (at, status) in within(begin + 0.1, end) {
                    complain(format!("{status:?} after {:.2} s", at - begin));
                }
            }
        }
        let bad = |(_, status): &&(f64, GapStatus)| status.state != AlarmState::Ok;
        let last_bad = within(end, next).rfind(bad).map_or(end, |(at, _)| *at);
        let again = within(last_bad, next).find(|(_, status)| status.state == AlarmState::Ok);
        if again.is_none() {
            complain("no Ok after it was over".to_owned());
        }
        let state = match row.wanted {
            Wanted::Ok => "Ok".to_owned(),
            Wanted::State(state, reason, _) => format!("{}, {}", state.name(), reason.name()),
            Wanted::NoGap => "not Gap".to_owned(),
            Wanted::Silence => "silence".to_owned(),
        };
        let told = told.map_or(String::new(), |told| format!("{told:.2}"));
        let again = match (&row.wanted, again) {
            (Wanted::Ok, _) | (_, None) => String::new(),
            (_, Some((at, _))) => format!("{:.2}", at - end),
        };
        writeln!(table, "| {} | {state} | {told} | {again} |", row.what).unwrap();
    }
    report(&share, "faults", &table);
    let again = marks.iter().position(|mark| mark.1 == "paused").unwrap() + 1;
    let first = all.iter().find(|(at, _)| *at >= marks[again].0).unwrap().1;
    if first.state != AlarmState::Unavailable {
        wrong.push(format!("after a pause the first word was {first:?}"));
    }
    assert!(wrong.is_empty(), "{table}{}", wrong.join("\n"));
}
