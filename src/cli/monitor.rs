//! `gapwatch monitor`: a camera through the monitor to the bus, in real time.
//!
//! Threads and clocks around the live loop: one thread takes frames, another one judges the newest frame, and this
//! thread keeps the cycle of the bus, whatever the others do.

use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use gapwatch::can::Sink;
use gapwatch::can::receiver::Heard;
use gapwatch::capture::clock::ClockTime;
use gapwatch::capture::newest::{Newest, Taken};
use gapwatch::capture::period::WantedPeriod;
use gapwatch::capture::{FrameSource, SourceError, open_camera};
use gapwatch::live::board::{self, Board};
use gapwatch::live::bus::Bus;
use gapwatch::live::judging::Judging;
use gapwatch::live::outputs::{OutputError, Outputs};
use gapwatch::live::service::Service;
use gapwatch::live::teller::{Said, Show, Teller};
use gapwatch::live::{JUDGE_WAITS, Orders, TICK, Word};
use gapwatch::model::ModelOptions;
use gapwatch::monitor::pipeline::Sight;
use gapwatch::record::events::{EventCounts, EventRecorder, Quota};
use gapwatch::record::journal::{About, Journal};
use gapwatch::reference::Reference;

use super::board_settings::{other_rate, periods, read_reference, warn_on};
use super::live::Live;
use super::loaded_model::LoadedModel;
use super::output::check_is_no_input;
use super::state_lines::{evidence_line, state_line};
use super::{service, signals};
use crate::cli::args::MonitorArgs;

/// How soon the bus is served again while a frame waits for it.
const SOON: Duration = Duration::from_millis(2);
/// How long the last message is offered to a bus that is full or down.
const LAST_WORD: Duration = Duration::from_millis(200);
/// How long the end waits for a judge that hangs in a frame.
const JUDGE_ENDS: Duration = Duration::from_secs(2);

pub fn run(args: &MonitorArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    let mut nowhere = std::io::sink();
    let out: &mut dyn Write = if args.quiet { &mut nowhere } else { out };
    let board = Board::read(&args.board)?;
    check_outputs(args, &board)?;
    let model = LoadedModel::load_file(board.monitor.model.as_deref(), ModelOptions::default())?;
    let reference = read_reference(&board)?;
    let name = board.monitor.reference.as_deref();
    let name = Reference::name_of(name);
    reference.check_fits(&name, &model.fingerprint)?;
    let warn = warn_on(&board, &reference, &args.board)?;
    let periods = periods(&board, &reference, &args.board)?;
    if let Some(said) = other_rate(&board, &reference) {
        log::warn!("{}: {said}", args.board.display());
    }
    let wanted = Arc::new(WantedPeriod::new(periods.full));
    let source = open_camera(
        &board.camera.source,
        &board.camera.wish,
        Arc::clone(&wanted),
    )?;
    let stop = signals::stop()?;
    let settings = board.can.settings.clone();
    settings.check()?;
    let sink = board.can.sink.open_live(&settings)?;
    let mut bus = Bus::new(sink, settings, &reference)?.live();
    if !matches!(board.can.sink, Sink::None) {
        listen(&mut bus, &board, &stop)?;
    }
    let about = About {
        live: source.is_live(),
        ..About::new(&board.camera.source, &name, &reference, warn)
    };
    let taps = &model.spec.taps;
    let journal = args.journal.as_deref();
    let journal = journal.map(|path| Journal::live(path, taps, &ClockTime::now(), &about));
    let journal = journal.transpose()?;
    let recorder = recorder(args, &board, &model);

    let speed = board.can.settings.speed.as_ref();
    let parked_after = speed.map_or(Duration::MAX, |speed| speed.parked_after);
    let outputs = Outputs {
        bus,
        journal,
        recording: None,
    };
    let watchdog = sd_notify::watchdog_enabled();
    let service = Service::new(periods.idle, watchdog);
    let teller = Teller::new(outputs, periods.idle, parked_after, service);
    let shared = Arc::new(Shared {
        newest: Newest::default(),
        stop,
        parked: AtomicBool::new(false),
        clear: AtomicBool::new(false),
        wanted,
        rounds: AtomicU64::new(0),
        began: Instant::now(),
    });
    let live = source.is_live();
    take_frames(source, Arc::clone(&shared));
    let (words, told) = channel();
    let judge = Judge {
        sight: Sight::new(&model.encoder, &reference)?
            .with_frames_every(periods.idle)
            .warning_on(warn),
        judging: Judging::new(periods, warn),
        words,
        recorder,
        live,
        shared: Arc::clone(&shared),
    };
    let judged = judge.spawn()?;

    let limit = args.seconds.map(|s| Duration::from_secs(s.into()));
    let mut terminal = Live::new(None, args.quiet);
    let told = tell_all(teller, &told, &shared, limit, &mut |said| {
        show(&said, &mut terminal, out);
    });
    terminal.finish();
    let kept = match judged.recv_timeout(JUDGE_ENDS) {
        Ok(judged) => judged,
        Err(RecvTimeoutError::Timeout) => {
            log::error!("the judge hangs in a frame, and the program does not wait for it");
            Ok(None)
        }
        Err(RecvTimeoutError::Disconnected) => {
            bail!("the judge of frames ended with an internal error")
        }
    };
    told?;
    if let Some(kept) = kept? {
        evidence_line(kept, out)?;
    }
    Ok(0)
}

/// Checks that the outputs are no inputs. Earlier files of any kind are kept beside them.
fn check_outputs(args: &MonitorArgs, board: &Board) -> anyhow::Result<()> {
    let files = [
        ("--board", Some(&args.board)),
        ("the board's reference", board.monitor.reference.as_ref()),
        ("the board's model", board.monitor.model.as_ref()),
    ];
    let files = files
        .iter()
        .filter_map(|(what, file)| Some((*what, file.as_ref()?.to_str()?)));
    let inputs: Vec<_> = files
        .chain([("the board's source", board.camera.source.as_str())])
        .collect();
    if let Some(file) = &args.journal {
        check_is_no_input("--journal", file, inputs.iter().copied())?;
    }
    match &board.can.sink {
        Sink::LogFile(file) => check_is_no_input("the board's CAN log", file, inputs),
        _ => Ok(()),
    }
}

/// Keeps evidence if the command line or the board asks for it. If the disk accepts no evidence, no verdict is lost.
fn recorder(args: &MonitorArgs, board: &Board, model: &LoadedModel) -> Option<EventRecorder> {
    let (asked, on_board) = (args.evidence.as_ref(), board.evidence.as_ref());
    let folder = asked.or(on_board.map(|evidence| &evidence.folder))?;
    let quota = on_board.map_or_else(
        || Quota {
            keep: Some(board::KEEP),
            ..Quota::default()
        },
        |evidence| evidence.quota,
    );
    EventRecorder::start(folder, quota, &model.spec.taps)
        .inspect_err(|error| {
            log::error!(
                "cannot keep evidence in {}, and continues without it: {error}",
                folder.display()
            );
        })
        .ok()
}

/// Listens before the first message, because two senders of one identifier would destroy each other's frames.
fn listen(bus: &mut Bus, board: &Board, stop: &AtomicBool) -> anyhow::Result<()> {
    let began = Instant::now();
    while began.elapsed() < board.can.listen && !stop.load(Ordering::Relaxed) {
        if let Some(Heard::Foreign(id)) = bus.hear() {
            bail!(
                "CAN id {id:#X} is already sent by another node on this bus; wanted an id that no other node sends: set status or health in [can] of the board"
            );
        }
        std::thread::sleep(TICK);
    }
    Ok(())
}

/// What the threads share.
struct Shared {
    newest: Newest,
    stop: Arc<AtomicBool>,
    /// Set by the teller.
    parked: AtomicBool,
    clear: AtomicBool,
    /// Time from one frame to the next.
    wanted: Arc<WantedPeriod>,
    /// How often the judge has looked for a frame.
    rounds: AtomicU64,
    began: Instant,
}

impl Shared {
    fn order(&self, orders: Orders) {
        self.parked.store(orders.parked, Ordering::Relaxed);
        self.clear.fetch_or(orders.clear, Ordering::Relaxed);
    }

    fn orders(&self) -> Orders {
        Orders {
            parked: self.parked.load(Ordering::Relaxed),
            clear: self.clear.swap(false, Ordering::Relaxed),
        }
    }
}

/// Takes frames without end, on a thread that nothing waits for, because a camera may not answer.
fn take_frames(mut source: Box<dyn FrameSource>, shared: Arc<Shared>) {
    std::thread::spawn(move || {
        let all = AssertUnwindSafe(|| all_frames(source.as_mut(), &shared));
        let ended = catch_unwind(all).unwrap_or_else(|_| {
            Err(SourceError::Camera {
                device: "camera".to_owned(),
                why: "ended with an internal error".to_owned(),
            })
        });
        shared.newest.end(ended);
    });
}

fn all_frames(source: &mut dyn FrameSource, shared: &Shared) -> Result<(), SourceError> {
    let live = source.is_live();
    let mut last = Duration::ZERO;
    while let Some(mut frame) = source.next_frame()? {
        if !live {
            std::thread::sleep(frame.captured_at.saturating_sub(shared.began.elapsed()));
        }
        // The time is later than that of the frame before, also when this thread was delayed between two readings of
        // the clock. (A camera whose frames are out of order is recognised by their numbers.)
        let taken = shared.began.elapsed().saturating_sub(source.waited());
        last = taken.max(last + Duration::from_nanos(1));
        frame.captured_at = last;
        shared.newest.put(frame);
    }
    Ok(())
}

/// The judge's thread.
struct Judge {
    sight: Sight,
    judging: Judging,
    words: Sender<Word>,
    recorder: Option<EventRecorder>,
    /// The source is a camera: it gives no more frames than are asked for, and each frame is judged as soon as it is
    /// there.
    live: bool,
    shared: Arc<Shared>,
}

impl Judge {
    /// Judges until there are no more frames or the monitor stops; returns how much evidence was kept.
    fn spawn(mut self) -> anyhow::Result<Receiver<anyhow::Result<Option<EventCounts>>>> {
        let (says_how, ended) = channel();
        let thread = std::thread::Builder::new().name("judge".to_owned());
        let judge = thread.spawn(move || {
            let judged = self.run();
            let Self {
                recorder, words, ..
            } = self;
            // The bus receives the end before the rest of the evidence is written.
            drop(words);
            let kept = recorder.map(EventRecorder::finish);
            // There is no receiver if the program's end did not wait.
            let _ = says_how.send(judged.map(|()| kept));
        });
        judge.context("no thread for the judge of frames")?;
        Ok(ended)
    }

    /// Judges the newest frame, again and again. If the source is not live, it rests between frames.
    fn run(&mut self) -> anyhow::Result<()> {
        let shared = Arc::clone(&self.shared);
        let mut next = Duration::ZERO;
        while !shared.stop.load(Ordering::Relaxed) {
            let taken = shared.newest.take(JUDGE_WAITS);
            shared.rounds.fetch_add(1, Ordering::Relaxed);
            let now = shared.began.elapsed();
            if let Some(word) = self.judging.obey(now, shared.orders()) {
                self.say(word);
            }
            match taken {
                Taken::Ended(how) => return Ok(how?),
                Taken::Frame(frame) if self.judging.looks() => {
                    let (silence, verdict) = self.judging.frame(self.sight.see(&frame));
                    silence
                        .into_iter()
                        .for_each(|silence| self.say_verdict(silence));
                    self.say_verdict(verdict.clone());
                    if let Some(recorder) = &mut self.recorder {
                        recorder.offer(frame, &verdict, || self.sight.look());
                    }
                    if !self.live {
                        // Sleep before the next frame, which is then the newest.
                        let (now, period) = (shared.began.elapsed(), self.judging.period());
                        next = (next + period).max(now);
                        std::thread::sleep((next - now).min(JUDGE_WAITS.max(period)));
                    }
                }
                Taken::Frame(_) | Taken::Nothing => {
                    if let Some(silence) = self.judging.no_frame(now) {
                        self.say_verdict(silence);
                    }
                }
            }
            shared.wanted.set(self.judging.period());
        }
        Ok(())
    }

    fn say_verdict(&self, verdict: gapwatch::monitor::judge::Verdict) {
        let dropped = self.shared.newest.dropped();
        self.say(Word::Verdict { verdict, dropped });
    }

    fn say(&self, word: Word) {
        // There is no receiver any more when the monitor is about to end.
        let _ = self.words.send(word);
    }
}

/// Keeps the cycle of the bus until the end of the frames, a signal or the limit. Then it sends the last message, and
/// completes the files.
fn tell_all(
    mut teller: Teller,
    words: &Receiver<Word>,
    shared: &Shared,
    limit: Option<Duration>,
    show: &mut Show<'_>,
) -> anyhow::Result<()> {
    let began = shared.began;
    let goes_on = || {
        !shared.stop.load(Ordering::Relaxed) && limit.is_none_or(|limit| began.elapsed() < limit)
    };
    let mut told = teller.begin(began.elapsed(), show);
    let mut ended = false;
    while told.is_ok() && !ended && goes_on() {
        let wait = if teller.is_waiting() { SOON } else { TICK };
        let word = words.recv_timeout(wait);
        ended = matches!(word, Err(RecvTimeoutError::Disconnected));
        let now = began.elapsed();
        let orders = teller.tick(now, word.into_iter().chain(words.try_iter()), show);
        let rounds = shared.rounds.load(Ordering::Relaxed);
        service::say(teller.service(now, rounds));
        told = orders.map(|orders| shared.order(orders));
    }
    // Set also after an error, so that the judge ends.
    shared.stop.store(true, Ordering::Relaxed);
    service::stopping();
    let stopped_at = began.elapsed();
    let stopped = teller.stop(stopped_at, show);
    while teller.is_waiting() && began.elapsed() < stopped_at + LAST_WORD {
        std::thread::sleep(SOON);
        teller.offer(began.elapsed());
    }
    let troubles = [told.err(), stopped.err()].into_iter().flatten();
    let mut of_bus = None;
    for trouble in troubles.chain(teller.finish()) {
        match trouble {
            OutputError::Bus(_) if of_bus.is_none() => of_bus = Some(trouble),
            // A journal that is not complete has not suppressed any warning.
            trouble => log::error!("{:#}", anyhow::Error::from(trouble)),
        }
    }
    of_bus.map_or(Ok(()), |trouble| Err(trouble.into()))
}

/// Shows on the terminal what is reported.
fn show(said: &Said<'_>, terminal: &mut Live, out: &mut dyn Write) {
    if said.is_change {
        let line = state_line(said.verdict);
        // The bus must receive messages also when the terminal accepts none.
        let _ = terminal.above(|| {
            writeln!(out, "{line}")?;
            out.flush()
        });
        service::status(line.trim());
    }
    if said.verdict.sequence.is_some() {
        terminal.count();
    }
    terminal.show(said.verdict, said.latency);
}
