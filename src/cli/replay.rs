//! `gapwatch replay`: a drive through the monitor, its verdicts to journal and bus.

use std::collections::{BTreeMap, HashSet};
use std::io::Write;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use gapwatch::can::{CanSettings, Sink};
use gapwatch::capture::clock::ClockTime;
use gapwatch::capture::{BUILT_IN_DRIVE, Frame, FrameSource, is_rendered, open};
use gapwatch::live::bus::Bus;
use gapwatch::live::outputs::{OutputError, Outputs};
use gapwatch::monitor::alarm::AlarmState;
use gapwatch::monitor::judge::Verdict;
use gapwatch::monitor::pipeline::Monitor;
use gapwatch::monitor::warn::WarnOn;
use gapwatch::record::events::EventRecorder;
use gapwatch::record::journal::{About, Journal, RecordingJournal};
use gapwatch::reference::Reference;

use super::board_settings::accepting;
use super::live::Live;
use super::loaded_model::LoadedModel;
use super::output::{Kind, check_output};
use super::signals;
use super::state_lines::{evidence_line, state_line};
use crate::cli::args::{ReplayArgs, Speed};

/// How soon a wait for the next frame ends after a signal.
const STOPS_WITHIN: Duration = Duration::from_millis(50);
/// With `--check`: if a smaller share of the time after `Init` was judged, the result is "could not judge".
const JUDGED_MIN: f64 = 0.9;
/// Exit codes of `--check`.
const FOUND_NO_GAP: u8 = 0;
const FOUND_GAP: u8 = 1;
const COULD_NOT_JUDGE: u8 = 3;

/// The result of the drive, by time in each state.
#[derive(Default)]
struct Summary {
    frames: u64,
    not_judged: u64,
    time_in: BTreeMap<&'static str, Duration>,
    last: Option<(Duration, AlarmState)>,
    gap: bool,
}

pub fn run(args: &ReplayArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    check_outputs(args)?;
    let model = LoadedModel::load(&args.model)?;
    let reference = Reference::read(args.reference.as_deref())?;
    let reference_name = Reference::name_of(args.reference.as_deref());
    reference.check_fits(&reference_name, &model.fingerprint)?;
    let source_name = args.source.as_deref().unwrap_or(BUILT_IN_DRIVE);
    let warn = warn_on(args, &reference, source_name)?;
    let mut monitor = Monitor::new(&model.encoder, &reference)?.warning_on(warn);
    let mut source = open(source_name)?;
    let about = About::new(source_name, &reference_name, &reference, warn);
    if reference.strict && !is_rendered(source_name) {
        log::warn!(
            "the reference {reference_name} knows simulation alone, so any real road is a gap to it; here the warning comes \
             from {warn}; this command makes a reference that accepts this road: {}",
            accepting(&reference, args.reference.as_deref(), Some(source_name))
        );
    }
    let (taps, began) = (&model.spec.taps, ClockTime::now());
    let journal = args.journal.as_deref();
    let journal = journal.map(|path| Journal::create(path, taps, &began, &about));
    let recording = args.mcap.as_deref();
    let recording = recording.map(|path| RecordingJournal::create(path, taps, &about));
    let (journal, recording) = (journal.transpose()?, recording.transpose()?);
    let mut recorder = args
        .evidence
        .as_deref()
        .map(|folder| {
            EventRecorder::start(folder, args.quota(), &model.spec.taps)
                .map(EventRecorder::patient)
                .with_context(|| format!("cannot keep evidence in {}", folder.display()))
        })
        .transpose()?;
    let settings = CanSettings {
        fd: args.fd,
        ..CanSettings::default()
    };
    let sink = args.can.open(&settings)?;
    let bus = Bus::new(sink, settings, &reference)?;
    // If the CAN log goes to standard output, the readable lines go to standard error, so that they do not mix.
    let (mut aside, mut nowhere) = (std::io::stderr(), std::io::sink());
    let out: &mut dyn Write = match args.can {
        _ if args.quiet => &mut nowhere,
        Sink::Stdout => &mut aside,
        _ => out,
    };
    let stop = signals::stop()?;
    let mut told = Told {
        outputs: Outputs {
            bus,
            journal,
            recording,
        },
        live: Live::new(source.frame_count(), args.quiet),
        summary: Summary::default(),
    };
    let began = Instant::now();
    let ended = told.drive(
        source.as_mut(),
        &mut monitor,
        recorder.as_mut(),
        args.speed,
        &stop,
        out,
    );
    // What was reported up to this point is kept, whatever ended the drive.
    let Told {
        outputs,
        live,
        summary,
    } = told;
    live.finish();
    let finished = first(outputs.finish());
    let kept = recorder.map(EventRecorder::finish);
    ended?;
    finished?;
    summary.tell(began.elapsed(), out)?;
    kept.map_or(Ok(()), |kept| evidence_line(kept, out))?;
    if stop.load(Ordering::Relaxed) {
        bail!(
            "{source_name}: stopped by a signal after {} frames; the files are complete up to that frame",
            summary.frames
        );
    }
    Ok(if args.check { summary.found() } else { 0 })
}

/// The answers that raise the warning: those that are typed, or those that suit the reference. No road of pictures is
/// the simulation inside the program; what a reference of the user's own is made of is not known.
fn warn_on(args: &ReplayArgs, reference: &Reference, source: &str) -> anyhow::Result<WarnOn> {
    let is_real = args.reference.is_none() && !is_rendered(source);
    let warn = match args.warn.as_slice() {
        [] => WarnOn::suited_to(reference, is_real),
        answers => WarnOn::these(answers),
    };
    warn.check(reference, false).context("--warn")?;
    Ok(warn)
}

/// In a replay, an error of any output ends the run.
fn first(troubles: Vec<OutputError>) -> anyhow::Result<()> {
    troubles
        .into_iter()
        .next()
        .map_or(Ok(()), |trouble| Err(trouble.into()))
}

/// Checks that every output has a file of its own, which is no input and no file of another kind.
fn check_outputs(args: &ReplayArgs) -> anyhow::Result<()> {
    let log = match &args.can {
        Sink::LogFile(log) => Some(log),
        _ => None,
    };
    let text = |file: &'_ Option<PathBuf>| {
        file.as_ref()
            .and_then(|file| file.to_str().map(str::to_owned))
    };
    let inputs = [
        ("the source", args.source.clone()),
        ("--reference", text(&args.reference)),
        ("--model", text(&args.model.model)),
    ];
    let mut files = HashSet::new();
    for (option, kind, file) in [
        ("--can", Kind::CanLog, log),
        ("--journal", Kind::Journal, args.journal.as_ref()),
        ("--mcap", Kind::Recording, args.mcap.as_ref()),
    ] {
        let Some(file) = file else { continue };
        let place = file.canonicalize().or_else(|_| std::path::absolute(file))?;
        if !files.insert(place) {
            bail!(
                "{}: wanted a file of its own for each of CAN log, journal and MCAP recording",
                file.display()
            );
        }
        let inputs = inputs.iter();
        let inputs = inputs.filter_map(|(option, name)| Some((*option, name.as_deref()?)));
        check_output(option, file, kind, inputs)?;
    }
    Ok(())
}

/// Waits until the time `at` after `began`, or until `stop` is set.
fn wait_until(at: Duration, began: Instant, stop: &AtomicBool) {
    while began.elapsed() < at && !stop.load(Ordering::Relaxed) {
        std::thread::sleep((at - began.elapsed().min(at)).min(STOPS_WITHIN));
    }
}

/// All receivers of verdicts.
struct Told {
    outputs: Outputs,
    live: Live,
    summary: Summary,
}

impl Told {
    /// Judges and reports every frame, until there are no more frames or `stop` is set.
    fn drive(
        &mut self,
        source: &mut dyn FrameSource,
        monitor: &mut Monitor,
        mut recorder: Option<&mut EventRecorder>,
        speed: Speed,
        stop: &AtomicBool,
        out: &mut dyn Write,
    ) -> anyhow::Result<()> {
        let began = Instant::now();
        while !stop.load(Ordering::Relaxed)
            && let Some(frame) = source.next_frame()?
        {
            if speed == Speed::Realtime {
                wait_until(frame.captured_at, began, stop);
            }
            self.record(&frame, source.began_at())?;
            if let Some(silence) = monitor.silence(frame.captured_at) {
                self.tell(&silence, Duration::ZERO, out)?;
            }
            let taken = Instant::now();
            let verdict = monitor.step(&frame);
            self.tell(&verdict, taken.elapsed(), out)?;
            if let Some(recorder) = &mut recorder {
                recorder.offer(frame, &verdict, || monitor.look());
            }
            self.live.count();
        }
        Ok(())
    }

    /// Keeps a frame that is about to be judged.
    fn record(&mut self, frame: &Frame, began_at: Option<Duration>) -> anyhow::Result<()> {
        if let Some(recording) = &mut self.outputs.recording {
            recording.begin_at(began_at.unwrap_or_default());
            recording.add_image(frame)?;
        }
        Ok(())
    }

    /// Reports to bus, journal and recording, and to the terminal if the state has changed.
    fn tell(
        &mut self,
        verdict: &Verdict,
        latency: Duration,
        out: &mut dyn Write,
    ) -> anyhow::Result<()> {
        let before = self.summary.add(verdict);
        first(self.outputs.tell(verdict.at, verdict, latency))?;
        if before != Some(verdict.state) {
            self.live.above(|| {
                writeln!(out, "{}", state_line(verdict))?;
                out.flush()
            })?;
        }
        self.live.show(verdict, latency);
        Ok(())
    }
}

impl Summary {
    /// Counts a verdict; returns the state before it.
    fn add(&mut self, verdict: &Verdict) -> Option<AlarmState> {
        self.frames += u64::from(verdict.sequence.is_some());
        self.not_judged += u64::from(verdict.sequence.is_some() && verdict.gap.is_none());
        self.gap |= verdict.state == AlarmState::Gap;
        let (since, state) = self.last.replace((verdict.at, verdict.state))?;
        *self.time_in.entry(state.name()).or_default() += verdict.at - since;
        Some(state)
    }

    fn total_s(&self) -> f64 {
        self.time_in.values().sum::<Duration>().as_secs_f64()
    }

    fn in_s(&self, states: &[AlarmState]) -> f64 {
        let time_in =
            |state: &AlarmState| self.time_in.get(state.name()).copied().unwrap_or_default();
        states.iter().map(time_in).sum::<Duration>().as_secs_f64()
    }

    fn tell(&self, took: Duration, out: &mut dyn Write) -> anyhow::Result<()> {
        let frames = |count| match count {
            0 => "no frame".to_owned(),
            1 => "1 frame".to_owned(),
            count => format!("{count} frames"),
        };
        let (total_s, took_s) = (self.total_s(), took.as_secs_f64());
        write!(
            out,
            "{}, {total_s:.1} s of drive in {took_s:.1} s",
            frames(self.frames)
        )?;
        // A drive of one frame has no length, so there is no share of time to report.
        if total_s > 0.0 {
            let shares = self.time_in.iter().map(|(name, time)| {
                format!("{name} {:.1} %", 100.0 * time.as_secs_f64() / total_s)
            });
            write!(out, ": {}", shares.collect::<Vec<_>>().join(", "))?;
        } else if let Some((_, state)) = self.last {
            write!(out, ": {}", state.name())?;
        }
        match self.not_judged {
            0 => writeln!(out)?,
            count => writeln!(out, "; {} could not be judged", frames(count))?,
        }
        Ok(())
    }

    fn found(&self) -> u8 {
        let judged_s = self.in_s(&[AlarmState::Ok, AlarmState::Suspect, AlarmState::Gap]);
        let started_s = self.total_s() - self.in_s(&[AlarmState::Init]);
        if self.gap {
            FOUND_GAP
        } else if judged_s <= 0.0 || judged_s < JUDGED_MIN * started_s {
            COULD_NOT_JUDGE
        } else {
            FOUND_NO_GAP
        }
    }
}
