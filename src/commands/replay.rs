//! `gapwatch replay`: a drive through the monitor, its verdicts to journal and bus.

use std::collections::BTreeMap;
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use gapwatch::alarm::AlarmState;
use gapwatch::can::{CanSettings, Sink};
use gapwatch::evidence::{Kept, Recorder};
use gapwatch::frame::{BUILT_IN_DRIVE, open};
use gapwatch::journal::{About, Journal};
use gapwatch::pipeline::{Monitor, Verdict};
use gapwatch::reference::Reference;
use indicatif::ProgressBar;

use super::bus::Bus;
use super::{Model, progress, state_line};
use crate::args::{ReplayArgs, Speed};

/// With `--check`: a judging state for at least this share of the time after `Init`, or "could not judge".
const JUDGED_MIN: f64 = 0.9;
/// Exit codes of `--check`.
const FOUND_NO_GAP: u8 = 0;
const FOUND_GAP: u8 = 1;
const COULD_NOT_JUDGE: u8 = 3;

/// What came of the drive, by its time.
#[derive(Default)]
struct Summary {
    frames: u64,
    not_judged: u64,
    time_in: BTreeMap<&'static str, Duration>,
    last: Option<(Duration, AlarmState)>,
    gap: bool,
}

pub fn run(args: &ReplayArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    if let (Sink::LogFile(log), Some(journal)) = (&args.can, &args.journal)
        && std::path::absolute(log)? == std::path::absolute(journal)?
    {
        bail!(
            "{}: wanted two files for the journal and the CAN log",
            log.display()
        );
    }
    let model = Model::load(&args.model)?;
    let reference = Reference::read(args.reference.as_deref())?;
    let reference_name = args
        .reference
        .as_ref()
        .map_or_else(|| "built-in".to_owned(), |path| path.display().to_string());
    reference.check_fits(&reference_name, &model.fingerprint)?;
    let mut monitor = Monitor::new(&model.encoder, &reference)?;
    let source_name = args.source.as_deref().unwrap_or(BUILT_IN_DRIVE);
    let mut source = open(source_name)?;
    let mut journal = args
        .journal
        .as_deref()
        .map(|path| Journal::create(path, &model.spec.taps))
        .transpose()?;
    if let Some(journal) = &mut journal {
        journal.describe(About::new(source_name, &reference_name, &reference));
    }
    let mut recorder = args
        .evidence
        .as_deref()
        .map(|folder| {
            Recorder::start(folder, args.quota(), &model.spec.taps)
                .with_context(|| format!("cannot keep evidence in {}", folder.display()))
        })
        .transpose()?;
    let settings = CanSettings {
        fd: args.fd,
        ..CanSettings::default()
    };
    let bus = Bus::new(&args.can, settings, &reference)?;
    let bar = progress::frames(source.frame_count(), "replaying");
    // With the CAN log on standard output, the lines for people go where they do not mix with it.
    let mut aside = std::io::stderr();
    let out: &mut dyn Write = if args.can == Sink::Stdout {
        &mut aside
    } else {
        out
    };
    let mut told = Told {
        journal,
        bus,
        bar,
        summary: Summary::default(),
    };
    let began = Instant::now();
    while let Some(frame) = source.next_frame()? {
        if args.speed == Speed::Realtime {
            std::thread::sleep(frame.captured_at.saturating_sub(began.elapsed()));
        }
        if let Some(silence) = monitor.silence(frame.captured_at) {
            told.tell(&silence, Duration::ZERO, out)?;
        }
        let taken = Instant::now();
        let verdict = monitor.step(&frame);
        told.tell(&verdict, taken.elapsed(), out)?;
        if let Some(recorder) = &mut recorder {
            recorder.offer(&frame, &verdict, || monitor.look());
        }
        told.bar.inc(1);
    }
    let Told {
        journal,
        bus,
        bar,
        summary,
    } = told;
    bar.finish_and_clear();
    bus.finish()?;
    if let Some(journal) = journal {
        journal.finish()?;
    }
    summary.tell(began.elapsed(), out)?;
    if let Some(recorder) = recorder {
        tell_evidence(recorder.finish(), out)?;
    }
    Ok(if args.check { summary.found() } else { 0 })
}

fn tell_evidence(kept: Kept, out: &mut dyn Write) -> std::io::Result<()> {
    write!(out, "evidence: {} events written", kept.events)?;
    for (count, what) in [
        (kept.removed, "older ones removed"),
        (kept.failed, "could not be written"),
        (kept.dropped_frames, "frames left out"),
    ] {
        if count > 0 {
            write!(out, ", {count} {what}")?;
        }
    }
    writeln!(out)
}

/// Everybody who hears of a verdict.
struct Told {
    journal: Option<Journal>,
    bus: Bus,
    bar: ProgressBar,
    summary: Summary,
}

impl Told {
    /// Tells bus and journal, and people when the state has changed.
    fn tell(
        &mut self,
        verdict: &Verdict,
        latency: Duration,
        out: &mut dyn Write,
    ) -> anyhow::Result<()> {
        let before = self.summary.add(verdict);
        self.bus.tell(verdict.at, verdict, latency)?;
        if let Some(journal) = &mut self.journal {
            journal.add(verdict, latency)?;
        }
        if before != Some(verdict.state) {
            tell_change(verdict, &self.bar, out)?;
        }
        Ok(())
    }
}

/// One line for a change of state; never torn by the progress bar.
fn tell_change(verdict: &Verdict, bar: &ProgressBar, out: &mut dyn Write) -> anyhow::Result<()> {
    let line = state_line(verdict);
    if std::io::stderr().is_terminal() {
        bar.suspend(|| writeln!(out, "{line}"))
    } else {
        writeln!(out, "{line}")
    }?;
    out.flush()?;
    Ok(())
}

impl Summary {
    /// Counts a verdict; gives the state before it.
    fn add(&mut self, verdict: &Verdict) -> Option<AlarmState> {
        self.frames += u64::from(verdict.sequence.is_some());
        self.not_judged += u64::from(verdict.sequence.is_some() && verdict.score.is_none());
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
        let total_s = self.total_s();
        let shares = self.time_in.iter().map(|(name, time)| {
            format!(
                "{name} {:.1} %",
                100.0 * time.as_secs_f64() / total_s.max(1e-9)
            )
        });
        let (took_s, shares) = (took.as_secs_f64(), shares.collect::<Vec<_>>().join(", "));
        write!(
            out,
            "{} frames, {total_s:.1} s of drive in {took_s:.1} s: {shares}",
            self.frames
        )?;
        match self.not_judged {
            0 => writeln!(out)?,
            count => writeln!(out, "; {count} frames could not be judged")?,
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
