//! `gapwatch monitor`: a camera through the monitor to the bus, in real time.
//!
//! Three threads: one takes frames, one judges the newest, and this one keeps the cycle of the bus whatever the others do.

use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use gapwatch::alarm::{AlarmState, Reason};
use gapwatch::board::{self, Board};
use gapwatch::can::Sink;
use gapwatch::can::receiver::Heard;
use gapwatch::can::speed::Parking;
use gapwatch::evidence::{Quota, Recorder};
use gapwatch::frame::newest::{Newest, Taken};
use gapwatch::frame::{FrameSource, SourceError, open_camera};
use gapwatch::journal::{About, Journal};
use gapwatch::model::ModelOptions;
use gapwatch::pipeline::{Monitor, Verdict};
use gapwatch::rate::{Periods, RatePolicy, WantedPeriod};
use gapwatch::reference::Reference;
use gapwatch::undefined::Undefined;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use super::bus::{Bus, COMPLAINT};
use super::live::Live;
use super::service::Service;
use super::{Model, state_line, tell_evidence};
use crate::args::MonitorArgs;

/// How often the bus is looked after: half of the shortest time between two frames of `GapStatus`.
const TICK: Duration = Duration::from_millis(10);
/// How long the judge waits for a frame before it looks at the clock.
const PATIENCE: Duration = Duration::from_millis(50);
/// Without a word of the judge for this long the bus is told that there is no verdict: 500 ms, as for a camera that gives
/// no frame, and the judge's patience; more when frames are taken more slowly.
const SILENT: Duration = Duration::from_millis(550);
/// A verdict on a frame this old comes too late to warn of anything: as long as without any verdict.
const LATE: Duration = Duration::from_millis(500);
/// How long a full or absent bus is offered the last message.
const LAST_WORD: Duration = Duration::from_millis(200);

/// A verdict on its way from the judge.
struct Told {
    verdict: Verdict,
    dropped: u64,
}

pub fn run(args: &MonitorArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    let mut nowhere = std::io::sink();
    let out: &mut dyn Write = if args.quiet { &mut nowhere } else { out };
    let board = Board::read(&args.board)?;
    let model = Model::load_file(board.monitor.model.as_deref(), ModelOptions::default())?;
    let reference = read_reference(&board, &args.board)?;
    let name = board.monitor.reference.as_deref();
    let name = name.map_or_else(|| "built-in".to_owned(), |path| path.display().to_string());
    reference.check_fits(&name, &model.fingerprint)?;
    let periods = periods(&board, &reference, &args.board)?;
    let wanted = Arc::new(WantedPeriod::new(periods.full));
    let source = open_camera(
        &board.camera.source,
        &board.camera.wish,
        Arc::clone(&wanted),
    )?;
    let mut journal = args
        .journal
        .as_deref()
        .map(|path| Journal::create(path, &model.spec.taps))
        .transpose()?;
    if let Some(journal) = &mut journal {
        journal.describe(About::new(&board.camera.source, &name, &reference));
    }
    let recorder = recorder(args, &board, &model);
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGTERM, SIGINT] {
        flag::register(signal, Arc::clone(&stop)).context("cannot wait for signals")?;
    }
    let mut bus = Bus::new(&board.can.sink, board.can.settings.clone(), &reference)?;
    if !matches!(board.can.sink, Sink::None) {
        listen(&mut bus, &board, &stop)?;
    }

    let began = Instant::now();
    let limit = args.seconds.map(|s| Duration::from_secs(s.into()));
    let newest = Arc::new(Newest::default());
    // A camera gives no more frames than are asked for, and each is judged as soon as it is there.
    let live = source.is_live();
    let clear = AtomicBool::new(false);
    let cleared = AtomicBool::new(false);
    let speed = board.can.settings.speed.as_ref();
    let parked_after = speed.map_or(Duration::MAX, |speed| speed.parked_after);
    let parked = AtomicBool::new(false);
    let rounds = AtomicU64::new(0);
    take_frames(source, Arc::clone(&newest), began);
    std::thread::scope(|scope| {
        let (verdicts, told) = channel();
        let shared = Shared {
            newest: &newest,
            stop: &stop,
            clear: &clear,
            cleared: &cleared,
            parked: &parked,
            wanted: &wanted,
            rounds: &rounds,
            began,
        };
        let (model, reference) = (&model, &reference);
        let judge = scope.spawn(move || {
            let mut recorder = recorder;
            let judged = judge(
                shared,
                model,
                reference,
                periods,
                live,
                verdicts,
                recorder.as_mut(),
            );
            let kept = recorder.map(Recorder::finish);
            judged.map(|()| kept)
        });
        let mut teller = Teller {
            bus,
            journal,
            last: nothing_yet(),
            last_told: Duration::ZERO,
            silent: SILENT.max(periods.idle * 3 / 2 + PATIENCE),
            parking: Parking::new(parked_after),
            complained_at: Duration::ZERO,
            live: Live::new(None, args.quiet),
            service: Service::new(periods.idle),
            out: &mut *out,
        };
        let told = teller.tell_all(&told, shared, limit);
        // Also when telling failed, so that the judge ends.
        stop.store(true, Ordering::Relaxed);
        // The bus hears the end before evidence is written to its own.
        let ended = teller.last_word(began);
        let judged = judge.join();
        told.and(ended)?;
        let kept = judged
            .map_err(|_| anyhow::anyhow!("the judge of frames ended by an internal error"))??;
        if let Some(kept) = kept {
            tell_evidence(kept, out)?;
        }
        Ok(0)
    })
}

/// The board's rates. A window must hold more than one of the slow frames, so that none of them is a hole in time.
pub(super) fn periods(
    board: &Board,
    reference: &Reference,
    file: &Path,
) -> anyhow::Result<Periods> {
    let period = |rate_hz: f64| Duration::from_secs_f64(1.0 / rate_hz);
    let periods = Periods {
        full: period(board.monitor.rate_hz),
        idle: period(board.monitor.idle_rate_hz),
    };
    if periods.idle.as_secs_f64() > reference.window_s {
        bail!(
            "{}: idle_rate_hz = {}, but the reference has windows of {} s; wanted at least {:.2} frames a second",
            file.display(),
            board.monitor.idle_rate_hz,
            reference.window_s,
            1.0 / reference.window_s
        );
    }
    Ok(periods)
}

/// A reference made of simulation alone is a standing gap on a road, so a board must ask for it.
pub(super) fn read_reference(board: &Board, file: &Path) -> anyhow::Result<Reference> {
    let reference = Reference::read(board.monitor.reference.as_deref())?;
    if reference.strict && !board.monitor.strict {
        bail!(
            "{}: the reference {} is made of simulation alone, so any real road is a gap to it; wanted reference = \"FILE\" \
             of one with accepted drives, or strict = true, in [monitor]",
            file.display(),
            board
                .monitor
                .reference
                .as_ref()
                .map_or_else(|| "built-in".to_owned(), |path| path.display().to_string()),
        );
    }
    Ok(reference)
}

/// Keeps evidence where the command line or the board says so.
/// A disk that takes no evidence costs no verdict.
fn recorder(args: &MonitorArgs, board: &Board, model: &Model) -> Option<Recorder> {
    let (asked, on_board) = (args.evidence.as_ref(), board.evidence.as_ref());
    let folder = asked.or(on_board.map(|evidence| &evidence.folder))?;
    let quota = on_board.map_or_else(
        || Quota {
            keep: Some(board::KEEP),
            ..Quota::default()
        },
        |evidence| evidence.quota,
    );
    Recorder::start(folder, quota, &model.spec.taps)
        .inspect_err(|error| {
            log::error!(
                "cannot keep evidence in {}, and watches without: {error}",
                folder.display()
            );
        })
        .ok()
}

/// Listens before the first word: two senders of one identifier would destroy each other's frames.
fn listen(bus: &mut Bus, board: &Board, stop: &AtomicBool) -> anyhow::Result<()> {
    let began = Instant::now();
    while began.elapsed() < board.can.listen && !stop.load(Ordering::Relaxed) {
        if let Some(Heard::Foreign(id)) = bus.hear() {
            bail!(
                "CAN id {id:#X} is already sent by another node on this bus; wanted an id of our own: set status or health in [can] of the board"
            );
        }
        std::thread::sleep(TICK);
    }
    Ok(())
}

/// Takes frames for ever, on a thread that nobody waits for: a camera may not answer.
fn take_frames(mut source: Box<dyn FrameSource>, newest: Arc<Newest>, began: Instant) {
    std::thread::spawn(move || {
        let all = AssertUnwindSafe(|| all_frames(source.as_mut(), &newest, began));
        let ended = catch_unwind(all).unwrap_or_else(|_| {
            Err(SourceError::Camera {
                device: "camera".to_owned(),
                why: "ended by an internal error".to_owned(),
            })
        });
        newest.end(ended);
    });
}

fn all_frames(
    source: &mut dyn FrameSource,
    newest: &Newest,
    began: Instant,
) -> Result<(), SourceError> {
    let live = source.is_live();
    let mut last = Duration::ZERO;
    while let Some(mut frame) = source.next_frame()? {
        if !live {
            std::thread::sleep(frame.captured_at.saturating_sub(began.elapsed()));
        }
        // Later than the frame before, also when this thread was held up between two looks at the clock: a camera whose
        // frames are not in order says so by their numbers.
        let taken = began.elapsed().saturating_sub(source.waited());
        last = taken.max(last + Duration::from_nanos(1));
        frame.captured_at = last;
        newest.put(frame);
    }
    Ok(())
}

/// What the threads share.
#[derive(Clone, Copy)]
struct Shared<'a> {
    newest: &'a Newest,
    stop: &'a AtomicBool,
    /// A clear request was heard.
    clear: &'a AtomicBool,
    /// It was obeyed.
    cleared: &'a AtomicBool,
    parked: &'a AtomicBool,
    /// Time from one frame to the next.
    wanted: &'a WantedPeriod,
    /// How often the judge has looked for a frame.
    rounds: &'a AtomicU64,
    began: Instant,
}

/// Judges the newest frame, again and again; of a source that is not `live` it rests from one to the next.
fn judge(
    shared: Shared<'_>,
    model: &Model,
    reference: &Reference,
    periods: Periods,
    live: bool,
    verdicts: Sender<Told>,
    mut recorder: Option<&mut Recorder>,
) -> anyhow::Result<()> {
    let mut monitor = Monitor::new(&model.encoder, reference)?.with_frames_every(periods.idle);
    let mut policy = RatePolicy::new(periods);
    let mut next = Duration::ZERO;
    while !shared.stop.load(Ordering::Relaxed) {
        let taken = shared.newest.take(PATIENCE);
        shared.rounds.fetch_add(1, Ordering::Relaxed);
        if shared.clear.swap(false, Ordering::Relaxed) {
            if monitor.clear_stored() {
                shared.cleared.store(true, Ordering::Relaxed);
            } else {
                log::warn!("GapClear is refused while the road is, or was when last seen, a Gap");
            }
        }
        let mut judged = None;
        let verdict = match taken {
            Taken::Ended(how) => return Ok(how?),
            // Nobody looks, but the newest frame is taken, so that none is old when the car drives off.
            _ if shared.parked.load(Ordering::Relaxed) => {
                shared.wanted.set(periods.idle);
                None
            }
            Taken::Frame(frame) => {
                if let Some(silence) = monitor.silence(frame.captured_at) {
                    tell(&verdicts, silence, shared.newest);
                }
                let verdict = monitor.step(&frame);
                judged = Some(frame);
                Some(verdict)
            }
            Taken::Nothing => monitor.silence(shared.began.elapsed()),
        };
        if let Some(verdict) = verdict {
            let period = policy.after(verdict.at, verdict.state, verdict.score);
            shared.wanted.set(period);
            tell(&verdicts, verdict.clone(), shared.newest);
            if let Some(frame) = judged {
                if let Some(recorder) = &mut recorder {
                    recorder.offer(frame, &verdict, || monitor.look());
                }
                if live {
                    continue;
                }
                // Slept in advance of the next frame, which is then the newest.
                let now = shared.began.elapsed();
                next = (next + period).max(now);
                std::thread::sleep((next - now).min(PATIENCE.max(period)));
            }
        }
    }
    Ok(())
}

fn tell(verdicts: &Sender<Told>, verdict: Verdict, newest: &Newest) {
    let dropped = newest.dropped();
    // Nobody listens any more when the monitor is about to end.
    let _ = verdicts.send(Told { verdict, dropped });
}

/// A verdict that comes too late is none.
fn in_time(verdict: Verdict, latency: Duration) -> Verdict {
    if latency < LATE || verdict.sequence.is_none() {
        return verdict;
    }
    Verdict {
        state: AlarmState::Unavailable,
        reason: Reason::Lagging,
        undefined: Some(Undefined::Late(latency)),
        score: None,
        quality: None,
        blocks: heapless::Vec::new(),
        window_frames: None,
        nominal_domain: None,
        drift: None,
        ..verdict
    }
}

fn nothing_yet() -> Verdict {
    Verdict {
        at: Duration::ZERO,
        sequence: None,
        state: AlarmState::Init,
        reason: Reason::Starting,
        undefined: None,
        score: None,
        quality: None,
        blocks: heapless::Vec::new(),
        window_frames: None,
        nominal_domain: None,
        drift: None,
        window_fill: None,
        fault_detection_counter: 0,
        gap_stored: false,
    }
}

fn is_unjudged(verdict: &Verdict) -> bool {
    matches!(
        verdict.state,
        AlarmState::Unavailable | AlarmState::SensorFault
    )
}

/// Whether silence is news after this last word: not after a fault, but after what was said of a car that stood and drives.
fn is_news(last: &Verdict, parked: bool) -> bool {
    !is_unjudged(last) || (last.reason == Reason::Parked && !parked)
}

/// Tells bus, journal and people.
struct Teller<'a> {
    bus: Bus,
    journal: Option<Journal>,
    last: Verdict,
    last_told: Duration,
    /// Without a word of the judge for this long there is no verdict.
    silent: Duration,
    parking: Parking,
    complained_at: Duration,
    live: Live,
    service: Service,
    out: &'a mut dyn Write,
}

impl Teller<'_> {
    /// Keeps the cycle of the bus until the end of the frames, a signal or the limit.
    fn tell_all(
        &mut self,
        verdicts: &Receiver<Told>,
        shared: Shared<'_>,
        limit: Option<Duration>,
    ) -> anyhow::Result<()> {
        let began = shared.began;
        let nothing = nothing_yet();
        self.tell(Duration::ZERO, &nothing, Duration::ZERO)?;
        while !shared.stop.load(Ordering::Relaxed)
            && limit.is_none_or(|limit| began.elapsed() < limit)
        {
            let word = verdicts.recv_timeout(TICK);
            let now = began.elapsed();
            self.bus.skip_missed(now);
            match word {
                // Of a frame from before the car was parked.
                Ok(_) if shared.parked.load(Ordering::Relaxed) => {}
                Ok(told) => {
                    self.bus.dropped_frames = told.dropped;
                    let latency = now.saturating_sub(told.verdict.at);
                    self.tell(now, &in_time(told.verdict, latency), latency)?;
                    self.last_told = now;
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            let unjudged = is_unjudged(&self.last);
            // No frame tells the bus while nobody looks.
            if shared.cleared.swap(false, Ordering::Relaxed) && unjudged && self.last.gap_stored {
                let mut cleared = self.last.clone();
                (cleared.at, cleared.sequence, cleared.gap_stored) = (now, None, false);
                self.tell(now, &cleared, Duration::ZERO)?;
            }
            let silence = now.saturating_sub(self.last_told);
            if silence > self.silent && is_news(&self.last, shared.parked.load(Ordering::Relaxed)) {
                let silent = self.without_frame(now, Reason::Stale, Some(Undefined::Silence));
                self.tell(now, &silent, Duration::ZERO)?;
            }
            while let Some(heard) = self.bus.hear() {
                match heard {
                    Heard::Clear => shared.clear.store(true, Ordering::Relaxed),
                    Heard::Standing(standing) => self.parking.hear(now, standing),
                    _ if now >= self.complained_at + COMPLAINT => {
                        self.complained_at = now;
                        log::warn!("on the bus: {heard}");
                    }
                    _ => {}
                }
            }
            let parked = self.parking.is_parked(now);
            shared.parked.store(parked, Ordering::Relaxed);
            if parked {
                self.last_told = now;
                if self.last.reason != Reason::Parked {
                    let verdict = self.without_frame(now, Reason::Parked, None);
                    self.tell(now, &verdict, Duration::ZERO)?;
                }
            }
            self.bus.tell_health(now);
            self.bus.poll(now)?;
            let judged_or_fault = self.last.score.is_some() || is_unjudged(&self.last);
            let rounds = shared.rounds.load(Ordering::Relaxed);
            self.service.served(now, judged_or_fault, rounds);
        }
        Ok(())
    }

    fn without_frame(&self, at: Duration, reason: Reason, why: Option<Undefined>) -> Verdict {
        Verdict {
            at,
            state: AlarmState::Unavailable,
            reason,
            undefined: why,
            fault_detection_counter: self.last.fault_detection_counter,
            gap_stored: self.last.gap_stored,
            ..nothing_yet()
        }
    }

    fn tell(&mut self, now: Duration, verdict: &Verdict, latency: Duration) -> anyhow::Result<()> {
        self.bus.tell(now, verdict, latency)?;
        // The bus must hear what the disk or a terminal does not take.
        if let Some(journal) = &mut self.journal
            && let Err(error) = journal.add(verdict, latency)
        {
            log::error!("{error}; there will be no journal");
            self.journal = None;
        }
        if (verdict.state, verdict.reason) != (self.last.state, self.last.reason) || now.is_zero() {
            let line = state_line(verdict);
            let _ = self.live.above(|| {
                writeln!(self.out, "{line}")?;
                self.out.flush()
            });
            self.service.status(line.trim());
        }
        if verdict.sequence.is_some() {
            self.live.count();
        }
        self.live.show(verdict, latency);
        self.last = verdict.clone();
        Ok(())
    }

    /// Says that the monitor has stopped, and completes what was written.
    fn last_word(mut self, began: Instant) -> anyhow::Result<()> {
        self.live.finish();
        self.service.stopping();
        self.bus.skip_missed(began.elapsed());
        let stopped = self.without_frame(began.elapsed(), Reason::Stopped, None);
        let mut said = self.tell(stopped.at, &stopped, Duration::ZERO);
        while said.is_ok() && began.elapsed() < stopped.at + LAST_WORD {
            std::thread::sleep(TICK);
            said = self.bus.poll(began.elapsed());
        }
        said.and(self.bus.finish())?;
        if let Some(journal) = self.journal {
            journal.finish()?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_is_news_but_after_a_fault_or_while_parked() {
        let last = |state, reason| Verdict {
            state,
            reason,
            ..nothing_yet()
        };
        let parked = last(AlarmState::Unavailable, Reason::Parked);
        assert!(!is_news(&parked, true) && is_news(&parked, false));
        for parked in [false, true] {
            assert!(is_news(&last(AlarmState::Ok, Reason::None), parked));
            assert!(is_news(&last(AlarmState::Gap, Reason::Abrupt), parked));
            let fault = last(AlarmState::SensorFault, Reason::Black);
            assert!(!is_news(&fault, parked));
            let stale = last(AlarmState::Unavailable, Reason::Stale);
            assert!(!is_news(&stale, parked));
        }
    }

    #[test]
    fn a_late_verdict_is_lagging_whatever_it_says() {
        for state in [AlarmState::Ok, AlarmState::Gap] {
            let verdict = Verdict {
                sequence: Some(7),
                state,
                score: Some(0.1),
                ..nothing_yet()
            };
            assert_eq!(
                in_time(verdict.clone(), Duration::from_millis(499)),
                verdict
            );
            let late = in_time(verdict, Duration::from_millis(500));
            assert_eq!(late.state, AlarmState::Unavailable);
            assert_eq!((late.reason, late.score), (Reason::Lagging, None));
        }
    }
}
