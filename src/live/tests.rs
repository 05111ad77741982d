//! Hours of scripts through judge and teller, at the pace of the processor: late frames, interruptions, parking, a bus
//! that is down, full or slow, full disks, requests to clear, a program that is suspended, a judge that hangs. What
//! must always hold is checked at every step.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::large_enum_variant,
    clippy::print_stdout
)]

mod script;

use std::cell::RefCell;
use std::collections::VecDeque;
use std::io::{self, Write};
use std::path::Path;
use std::rc::Rc;
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::bus::Bus;
use super::bus::tests::SPEED_ID;
use super::judging::Judging;
use super::outputs::Outputs;
use super::service::Service;
use super::teller::{Said, Teller};
use super::{Orders, Word};
use crate::can::e2e::{E2eReceiver, E2eSender, Sequence};
use crate::can::message::{ClearRequest, GapStatus};
use crate::can::{CanFrame, CanSettings, SinkError, WarningSink};
use crate::capture::clock::ClockTime;
use crate::capture::undefined::Undefined;
use crate::capture::{Frame, Picture};
use crate::monitor::alarm::{AlarmState, Reason};
use crate::monitor::detector::Evidence;
use crate::monitor::judge::{Sighting, Verdict};
use crate::monitor::pipeline::Look;
use crate::monitor::warn::WarnOn;
use crate::record::events::{EventRecorder, Message};
use crate::record::journal::{self, About, Journal};
use crate::reference::Periods;
use crate::reference::Reference;
use crate::statistics::random::SplitMix64;

use script::{Dice, Event, Road, Script, SharedDisk, Sink, Wire, settings};

const MS: Duration = Duration::from_millis(1);
/// A step of the script: the shortest time between two status frames.
const STEP: Duration = Duration::from_millis(20);
/// Total number of steps, unless `GAPWATCH_LIVE_STEPS` says otherwise, and steps in one run.
const STEPS: u64 = 1_000_000;
const STEPS_A_RUN: u64 = 20_000;
/// Seed, unless `GAPWATCH_LIVE_SEED` says otherwise.
const SEED: u64 = 20_261;
const PERIODS: Periods = Periods {
    full: Duration::from_millis(100),
    idle: Duration::from_millis(200),
};
/// Without a verdict for this long, there is none on the bus either: 500 ms, and the wait of the judge.
const SILENT: Duration = Duration::from_millis(550);

/// What the script knows to be true, with which the reports of the loop are compared.
#[derive(Default)]
struct Truth {
    /// When the frame of the last score that came in time was taken.
    judged_at: Option<Duration>,
    /// When the last verdict on a frame came in time.
    heard_at: Option<Duration>,
    /// A gap was reported, and not cleared since.
    stored: bool,
    /// When the bus accepted the last status, and whether it has accepted everything since.
    sent_at: Option<Duration>,
    undisturbed: bool,
    /// The last verdict that was reported, and the one before.
    said: Option<Verdict>,
    /// Number of the last frame that was reported.
    said_of: Option<u64>,
    /// State of the last verdict on a frame, and on one that was judged.
    last_frame: Option<AlarmState>,
    last_judged_state: Option<AlarmState>,
    /// Since when frames have been judged without a long pause, and how many.
    judged_since: Option<(Duration, u32)>,
    last_judged: Option<Duration>,
    journal_read: usize,
    journal_t_s: f64,
    entries: u64,
    statuses: u64,
}

struct World {
    dice: Dice,
    now: Duration,
    judging: Judging,
    teller: Teller,
    wire: Rc<RefCell<Wire>>,
    disk: SharedDisk,
    recorder: EventRecorder,
    evidence: Receiver<Message>,
    script: Script,
    orders: Orders,
    /// According to the orders of the step before.
    was_parked: bool,
    /// The camera's newest frame that was not taken.
    newest: Option<(Duration, u64)>,
    next_frame: Duration,
    sequence: u64,
    road_began: Duration,
    busy_until: Duration,
    looked_at: Duration,
    rounds: u64,
    /// Messages on their way from the judge.
    words: VecDeque<(Duration, Word)>,
    clear: E2eSender,
    status_e2e: E2eReceiver,
    truth: Truth,
    /// Frames whose first verdict of a gap must be in the evidence, once its queue is emptied.
    wanted_evidence: Option<u64>,
    alive_at: Duration,
}

impl World {
    fn new(dice: Dice, reference: &Reference) -> Self {
        let wire = Rc::new(RefCell::new(Wire::default()));
        let sink = Box::new(Sink(Rc::clone(&wire)));
        let disk = SharedDisk::default();
        let (began, about) = (ClockTime::default(), About::default());
        let journal = Journal::stream(Path::new("j"), disk.clone(), &[], &began, &about);
        let outputs = Outputs {
            bus: Bus::new(sink, settings(), reference).unwrap().live(),
            journal: Some(journal.unwrap()),
            recording: None,
        };
        let service = Service::new(PERIODS.idle, Some(3_000 * MS));
        let (recorder, evidence) = EventRecorder::in_memory(8);
        Self {
            dice,
            now: Duration::ZERO,
            judging: Judging::new(PERIODS, WarnOn::default()),
            teller: Teller::new(outputs, PERIODS.idle, 1_000 * MS, service),
            wire,
            disk,
            recorder,
            evidence,
            script: Script {
                road: Road::Nominal,
                frames_every: Some(100 * MS),
                judging_takes: 5 * MS,
                standing: Some(false),
                disk_full: false,
                evidence_waits: false,
            },
            orders: Orders::default(),
            was_parked: false,
            newest: None,
            next_frame: Duration::ZERO,
            sequence: 0,
            road_began: Duration::ZERO,
            busy_until: Duration::ZERO,
            looked_at: Duration::ZERO,
            rounds: 0,
            words: VecDeque::new(),
            clear: E2eSender::new(settings().clear.data_id),
            status_e2e: E2eReceiver::new(settings().status.data_id),
            truth: Truth {
                undisturbed: true,
                ..Truth::default()
            },
            wanted_evidence: None,
            alive_at: Duration::ZERO,
        }
    }

    fn begin(&mut self) {
        let wire = Rc::clone(&self.wire);
        let mut show = |said: Said<'_>| note(&wire, &said);
        self.teller.begin(self.now, &mut show).unwrap();
        self.check(false);
    }

    fn step(&mut self) {
        self.now += STEP;
        let wire = Rc::clone(&self.wire);
        self.script.change(&mut self.dice, &mut wire.borrow_mut());
        let pause = self.script.pause(&mut self.dice);
        self.now += pause;
        self.disk.0.lock().unwrap().full = self.script.disk_full;
        self.say_on_the_bus();
        self.camera();
        self.judge();

        let words = self.words.iter().take_while(|(at, _)| *at <= self.now);
        let words: Vec<Word> = words.map(|(_, word)| word.clone()).collect();
        self.words.drain(..words.len());
        words.iter().for_each(|word| self.expect(word));
        let mut show = |said: Said<'_>| note(&wire, &said);
        let orders = self.teller.tick(self.now, words, &mut show).unwrap();
        self.was_parked = self.orders.parked;
        self.orders.parked = orders.parked;
        self.orders.clear |= orders.clear;
        self.serve();
        self.check(!pause.is_zero());
    }

    /// What other nodes send.
    fn say_on_the_bus(&mut self) {
        let mut wire = self.wire.borrow_mut();
        if let Some(standing) = self.script.standing
            && self.now.as_millis() % 100 < 20
        {
            let data = [if standing { 0 } else { 50 }; 8];
            wire.heard.push_back(CanFrame { id: SPEED_ID, data });
        }
        if self.dice.once_in(500) {
            let spoilt = self.dice.once_in(3);
            let heard = &mut wire.heard;
            let sent = self.clear.protect(ClearRequest.to_bytes(), |mut data| {
                data[0] ^= u8::from(spoilt);
                heard.push_back(CanFrame { id: 0x5D8, data });
                Ok::<(), ()>(())
            });
            sent.unwrap();
        }
    }

    fn camera(&mut self) {
        let Some(every) = self.script.frames_every else {
            self.next_frame = self.now + 100 * MS;
            return;
        };
        if self.now >= self.next_frame {
            self.sequence += 1;
            self.newest = Some((self.now, self.sequence));
            self.next_frame = self.now + every;
        }
    }

    fn judge(&mut self) {
        if self.now < self.busy_until {
            return;
        }
        let waited = self.now >= self.looked_at + 50 * MS;
        if self.newest.is_none() && !waited {
            return;
        }
        self.looked_at = self.now;
        self.rounds += 1;
        let orders = self.orders;
        self.orders.clear = false;
        let cleared = self.judging.obey(self.now, orders);
        let told_at = self.now + self.script.judging_takes;
        self.words.extend(cleared.map(|word| (self.now, word)));
        let frame = self.newest.take().filter(|_| self.judging.looks());
        let Some((at, sequence)) = frame else {
            let silence = self.judging.no_frame(self.now);
            self.words.extend(silence.map(|s| (self.now, said(s))));
            return;
        };
        self.busy_until = told_at;
        let seen = self.sighting(at, sequence);
        self.note_judged(&seen);
        let (silence, verdict) = self.judging.frame(seen);
        let words = silence.into_iter().chain([verdict.clone()]);
        self.words
            .extend(words.map(|verdict| (told_at, said(verdict))));
        self.offer(at, sequence, &verdict);
    }

    fn sighting(&mut self, at: Duration, sequence: u64) -> Sighting {
        let (score, drift) = match self.script.road {
            Road::Nominal => (0.1, 0.0),
            Road::Evident => (3.0, 0.0),
            Road::Alternating if sequence.is_multiple_of(2) => (3.0, 0.0),
            Road::Alternating => (0.1, 0.0),
            Road::Drifting => (0.9, 1.0),
            Road::Black => (0.0, 0.0),
        };
        if self
            .truth
            .last_judged
            .is_none_or(|last| at - last > 2_000 * MS)
        {
            self.road_began = at;
        }
        let fill = (at - self.road_began).as_secs_f64().min(1.0);
        Sighting {
            at,
            sequence,
            quality: None,
            evidence: if self.script.road == Road::Black {
                Err(Undefined::Black)
            } else {
                Ok(Evidence {
                    drift,
                    fill,
                    ..Evidence::of_gap(score)
                })
            },
        }
    }

    /// How long frames have been judged without a pause of more than two seconds.
    fn note_judged(&mut self, seen: &Sighting) {
        if seen.evidence.is_err() {
            return;
        }
        let truth = &mut self.truth;
        let long = truth.last_judged.replace(seen.at);
        let long = long.is_none_or(|last| seen.at - last > 2_000 * MS);
        let (since, frames) = truth.judged_since.filter(|_| !long).unwrap_or((seen.at, 0));
        truth.judged_since = Some((since, frames + 1));
    }

    /// Hands a frame to the evidence, and remembers what must be in it.
    fn offer(&mut self, at: Duration, sequence: u64, verdict: &Verdict) {
        if !self.script.evidence_waits {
            self.take_evidence();
        }
        let is_gap = verdict.state == AlarmState::Gap;
        let enters = is_gap && self.truth.last_frame != Some(AlarmState::Gap);
        self.truth.last_frame = Some(verdict.state);
        // A gap that was entered before a moment without sight lasts through it.
        let is_new = self.truth.last_judged_state != Some(AlarmState::Gap);
        if verdict.score.is_some() {
            self.truth.last_judged_state = Some(verdict.state);
        }
        if enters && is_new {
            self.truth.entries += 1;
            let (since, frames) = self.truth.judged_since.unwrap();
            assert!(
                frames >= 3 && at - since >= 900 * MS,
                "Gap {frames} frames and {:?} after a hole",
                at - since
            );
        }
        self.wanted_evidence = if !is_gap {
            None
        } else if enters {
            Some(sequence)
        } else {
            self.wanted_evidence
        };
        let picture = Picture {
            width: 1,
            height: 1,
            rgb: vec![0; 3],
        };
        let frame = Frame {
            sequence,
            captured_at: at,
            picture: Ok(picture.into()),
        };
        let dropped = self.recorder.dropped_frames();
        self.recorder.offer(frame, verdict, || Look {
            seen: Picture {
                width: 1,
                height: 1,
                rgb: vec![0; 3],
            },
            energies: vec![],
            profiles: vec![],
        });
        if !self.script.evidence_waits {
            self.take_evidence();
            // The queue had room, so this frame began the event, or one before it since the gap was entered.
            assert_eq!(self.recorder.dropped_frames(), dropped);
            assert_eq!(self.wanted_evidence, None, "no evidence of a gap");
        }
    }

    fn take_evidence(&mut self) {
        for message in self.evidence.try_iter() {
            let began = message.edge && message.moment.state == "Gap";
            if began
                && self
                    .wanted_evidence
                    .is_some_and(|from| message.moment.seq >= from)
            {
                self.wanted_evidence = None;
            }
        }
    }

    /// What a message of the judge must lead to.
    fn expect(&mut self, word: &Word) {
        match word {
            Word::Verdict { verdict, .. } if verdict.sequence.is_some() => {
                let in_time = self.now - verdict.at < 500 * MS;
                if in_time && !self.orders.parked {
                    self.truth.heard_at = Some(self.now);
                    if verdict.score.is_some() {
                        self.truth.judged_at = Some(verdict.at);
                    }
                }
                self.truth.stored = verdict.gap_stored;
            }
            Word::Verdict { .. } => {}
            Word::Cleared(done) => self.truth.stored &= !done,
        }
    }

    fn serve(&mut self) {
        let words = self.teller.service(self.now, self.rounds);
        if words.alive {
            assert!(self.now - self.alive_at >= 1_000 * MS);
            self.alive_at = self.now;
            let hangs = self.now - self.looked_at;
            assert!(
                hangs <= 5_000 * MS + PERIODS.idle + STEP,
                "alive after {hangs:?}"
            );
        }
    }

    /// Checks what must always hold. `paused`: the program was suspended before this step.
    fn check(&mut self, paused: bool) {
        let disturbs = {
            let wire = self.wire.borrow();
            wire.refuses || wire.busy
        };
        self.truth.undisturbed &= !disturbs && !paused;
        let events: Vec<Event> = self.wire.borrow_mut().events.drain(..).collect();
        for (n, event) in events.iter().enumerate() {
            match event {
                Event::Said(verdict) => {
                    if let Some(sequence) = verdict.sequence {
                        let before = self.truth.said_of.replace(sequence);
                        assert!(before < Some(sequence), "frame {sequence} after {before:?}");
                    }
                    self.truth.said = Some(verdict.clone());
                }
                Event::Sent(at, frame) if frame.id == 0x5D0 => {
                    assert_eq!(*at, self.now, "sent with another time");
                    let next = events[n..].iter().find_map(|event| match event {
                        Event::Said(verdict) => Some(verdict.clone()),
                        Event::Sent(..) => None,
                    });
                    self.check_status(*at, frame, next.as_ref());
                }
                Event::Sent(at, _) => assert_eq!(*at, self.now),
            }
        }
        let pause = self.now - self.truth.sent_at.unwrap_or_default();
        if self.truth.undisturbed {
            assert!(pause <= 120 * MS, "no status for {pause:?}");
        }
        if !disturbs && pause <= 120 * MS {
            self.truth.undisturbed = true;
        }
        self.check_journal();
    }

    fn check_status(&mut self, at: Duration, frame: &CanFrame, next: Option<&Verdict>) {
        self.truth.statuses += 1;
        let sequence = self.status_e2e.check(&frame.data);
        assert!(
            matches!(sequence, Ok(Sequence::First | Sequence::Next)),
            "{sequence:?}"
        );
        let status = GapStatus::from_bytes(&frame.data).unwrap();
        if let Some(before) = self.truth.sent_at.replace(at) {
            assert!(at - before >= 20 * MS);
        }
        // What is sent is what was reported last, or what is being reported.
        let is = |said: &Verdict| {
            (said.state, said.reason, said.gap_stored)
                == (status.state, status.reason, status.gap_stored)
        };
        let said = [self.truth.said.as_ref(), next];
        assert!(
            said.into_iter().flatten().any(is),
            "sent {status:?}, said {said:?}"
        );
        let age = status.frame_age.unwrap_or(Duration::MAX);
        if let Some(judged_at) = self.truth.judged_at
            && age < 1_400 * MS
        {
            assert!(
                at - judged_at <= age,
                "{:?} old, said {age:?}",
                at - judged_at
            );
        }
        let judging = [AlarmState::Ok, AlarmState::Suspect, AlarmState::Gap];
        if judging.contains(&status.state) {
            let silence = at - self.truth.heard_at.unwrap_or_default();
            assert!(silence <= SILENT, "{status:?} {silence:?} after a verdict");
            assert!(!self.was_parked, "{status:?} while parked");
        }
        if status.state == AlarmState::Ok {
            let counter = status.fault_detection_counter;
            assert!(counter <= 0, "Ok with the counter at {counter}");
        }
        assert!(
            status.gap_stored || status.state != AlarmState::Gap,
            "a gap that is not stored"
        );
        if next.is_none() {
            assert_eq!(status.gap_stored, self.truth.stored, "{status:?}");
        }
    }

    fn check_journal(&mut self) {
        let disk = self.disk.0.lock().unwrap();
        let new = &disk.bytes[self.truth.journal_read..];
        for line in new.split_inclusive(|&byte| byte == b'\n') {
            assert!(line.ends_with(b"\n"), "half a line");
            let line = std::str::from_utf8(line).unwrap();
            let Some((_, rest)) = line.split_once("{\"t_s\":") else {
                continue;
            };
            let t_s: f64 = rest.split(',').next().unwrap().parse().unwrap();
            assert!(t_s >= self.truth.journal_t_s, "{line}");
            self.truth.journal_t_s = t_s;
        }
        // What was reported last is in the journal, if the disk accepted it.
        if let Some(said) = &self.truth.said
            && !disk.full
            && !new.is_empty()
        {
            let state = format!("\"state\":\"{}\"", said.state.name());
            let last = std::str::from_utf8(new).unwrap().lines().last().unwrap();
            assert!(last.contains(&state), "said {said:?}: {last}");
        }
        self.truth.journal_read = disk.bytes.len();
    }

    /// Ends the run: the last message must be on the bus if the bus accepts it, and the journal is read.
    fn end(mut self) -> (u64, u64) {
        let wire = Rc::clone(&self.wire);
        (wire.borrow_mut().refuses, wire.borrow_mut().busy) = (false, false);
        self.now += STEP;
        let mut show = |said: Said<'_>| note(&wire, &said);
        self.teller.stop(self.now, &mut show).unwrap();
        while self.teller.is_waiting() {
            self.now += MS;
            self.teller.offer(self.now);
        }
        let events = wire.borrow_mut().events.split_off(0);
        let last = events.iter().rev().find_map(|event| match event {
            Event::Sent(_, frame) if frame.id == 0x5D0 => GapStatus::from_bytes(&frame.data).ok(),
            _ => None,
        });
        let last = last.unwrap();
        let stopped = (AlarmState::Unavailable, Reason::Stopped);
        assert_eq!((last.state, last.reason), stopped);
        assert!(self.teller.finish().is_empty());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j");
        std::fs::write(&path, &self.disk.0.lock().unwrap().bytes).unwrap();
        journal::read(&path).unwrap();
        (self.truth.entries, self.truth.statuses)
    }
}

fn said(verdict: Verdict) -> Word {
    Word::Verdict {
        verdict,
        dropped: 0,
    }
}

fn note(wire: &Rc<RefCell<Wire>>, said: &Said<'_>) {
    let verdict = said.verdict.clone();
    wire.borrow_mut().events.push_back(Event::Said(verdict));
}

fn number(variable: &str, default: u64) -> u64 {
    let set = std::env::var(variable).ok();
    set.map_or(default, |number| number.parse().unwrap())
}

#[test]
fn whatever_happens_the_loop_keeps_its_promises() {
    let steps = number("GAPWATCH_LIVE_STEPS", STEPS);
    let seed = number("GAPWATCH_LIVE_SEED", SEED);
    println!("seed {seed}, {steps} steps of {STEP:?}");
    let reference = Reference::read(None).unwrap();
    let (mut entries, mut statuses) = (0, 0);
    for run in 0..steps.div_ceil(STEPS_A_RUN) {
        let dice = Dice(SplitMix64::new(
            seed.wrapping_mul(1_000_003).wrapping_add(run),
        ));
        let mut world = World::new(dice, &reference);
        world.begin();
        for _ in 0..STEPS_A_RUN.min(steps - run * STEPS_A_RUN) {
            world.step();
        }
        let ended = world.end();
        (entries, statuses) = (entries + ended.0, statuses + ended.1);
    }
    println!("{entries} entries into Gap, {statuses} status frames");
    assert!(entries > steps / 5_000, "{entries} entries into Gap");
}
