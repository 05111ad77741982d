//! `gapwatch calibrate`: nominal sources → reference file.

use std::io::Write;
use std::path::Path;

use anyhow::{Context, bail};
use gapwatch::calibration::shard::Shard;
use gapwatch::calibration::survey::store::SurveyStore;
use gapwatch::calibration::{FarDrives, Shown, Target, with_conditions};
use gapwatch::capture::drives;
use gapwatch::reference::gap::Metric;
use gapwatch::reference::gap::energy_norm::SPANS_OWN;
use gapwatch::reference::{
    Causes, Discriminant, EvidenceKind, JudgedRate, NominalDrives, Reference, Role, SourceUse, Span,
};
use gapwatch::statistics::event_rate::{Hours, Loudness, ThreeDigits};

use super::calibration_plan::{CalibrationPlan, Found, PlannedDrive, Widened};
use super::loaded_model::LoadedModel;
use super::output::{Kind, check_output};
use crate::cli::args::CalibrateArgs;

pub fn run(args: &CalibrateArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    if args.metric == Metric::Frechet {
        bail!("--metric frechet compares whole sets; wanted a metric that judges a window");
    }
    check_out(args)?;
    let sources = sources(args)?;
    if let Some(base) = &args.base {
        return accept(args, base, sources, out);
    }
    if sources.is_empty() {
        bail!("no drive; wanted --sim, --accept, --held-out, --labelled or --causes");
    }
    let wanted = Target {
        metric: args.metric,
        window_s: args.window,
        false_alarms_per_hour: args.false_alarms_per_hour,
        evidence: args.evidence,
        rate: JudgedRate {
            rate_hz: args.rate,
            idle_rate_hz: args.idle_rate.unwrap_or(args.rate),
        },
    };
    if let Some(fault) = wanted.rate.fault() {
        bail!("{fault}; wanted --idle-rate at most --rate");
    }
    let model = LoadedModel::load(&args.model)?;
    let plan = CalibrationPlan::new(model.fingerprint.clone(), wanted, sources)?;
    if !args.shard {
        plan.check_whole()?;
    }
    let (_store, found) = look(args, &plan, &model)?;
    if args.shard {
        let sources = plan.sources(&found)?;
        let (drives, frames) = (
            sources.len(),
            sources.iter().map(|of| of.frames).sum::<u64>(),
        );
        Shard::new(model.fingerprint, wanted, sources).write(&args.out)?;
        writeln!(
            out,
            "{}: shard of {drives} drives, {frames} frames, without thresholds, for gapwatch merge",
            args.out.display()
        )?;
        return Ok(0);
    }
    let (reference, doubts) = plan.reference(found, far_drives(args))?;
    reference
        .write(&args.out)
        .context("cannot write the reference")?;
    describe(&reference, &args.out, out)?;
    doubts.iter().for_each(|doubt| log::warn!("{doubt}"));
    Ok(0)
}

fn far_drives(args: &CalibrateArgs) -> FarDrives {
    match args.allow_far {
        true => FarDrives::Allowed,
        false => FarDrives::Refused,
    }
}

/// Refuses to write over anything that is read.
fn check_out(args: &CalibrateArgs) -> anyhow::Result<()> {
    let of_roles = [
        ("--sim", &args.sim),
        ("--accept", &args.accept),
        ("--held-out", &args.held_out),
        ("--labelled", &args.labelled),
        ("--causes", &args.causes),
    ];
    let typed = of_roles.iter().flat_map(|(option, names)| {
        let names = names.iter();
        names.map(|name| (*option, name.as_str()))
    });
    let named = args
        .accept_as
        .iter()
        .map(|(_, name)| ("--accept-as", name.as_str()));
    let files = [("--surveys", &args.surveys), ("--model", &args.model.model)];
    let files = files
        .iter()
        .filter_map(|(option, file)| Some((*option, file.as_ref()?.to_str()?)));
    let base = args.base.iter().map(|base| ("--base", base.as_str()));
    let inputs = typed.chain(named).chain(files).chain(base);
    check_output("--out", &args.out, Kind::Reference, inputs)
}

fn sources(args: &CalibrateArgs) -> anyhow::Result<Vec<PlannedDrive>> {
    let mut sources = Vec::new();
    let mut add = |role: Role, domain: Option<&str>, name: &str| -> anyhow::Result<()> {
        sources.extend(drives(name)?.into_iter().map(|source| PlannedDrive {
            role,
            domain: domain.map(str::to_owned),
            source,
        }));
        Ok(())
    };
    let roles = [
        (Role::Simulation, &args.sim),
        (Role::Accepted, &args.accept),
        (Role::HeldOut, &args.held_out),
        (Role::Labelled, &args.labelled),
    ];
    for (role, names) in roles {
        names.iter().try_for_each(|name| add(role, None, name))?;
    }
    for (domain, name) in &args.accept_as {
        add(Role::Accepted, Some(domain), name)?;
    }
    for name in args.causes.iter().flat_map(|name| with_conditions(name)) {
        add(Role::Cause, None, &name)?;
    }
    Ok(sources)
}

/// What the encoder sees of a plan's drives. It is in the store as long as that lives.
fn look(
    args: &CalibrateArgs,
    plan: &CalibrationPlan,
    model: &LoadedModel,
) -> anyhow::Result<(SurveyStore, Found)> {
    let store = match &args.surveys {
        Some(folder) => SurveyStore::open(folder, &model.fingerprint)?,
        None => SurveyStore::temporary(&model.fingerprint)?,
    };
    let mut found = plan.find(&store, Some(&model.spec))?;
    plan.look(&mut found, model, &store)?;
    Ok((store, found))
}

/// Adds accepted roads to a reference.
fn accept(
    args: &CalibrateArgs,
    base: &str,
    sources: Vec<PlannedDrive>,
    out: &mut dyn Write,
) -> anyhow::Result<u8> {
    if sources.is_empty() {
        bail!("no road; wanted --accept or --accept-as with --base");
    }
    let file = (base != Reference::BUILT_IN).then(|| Path::new(base));
    let reference = Reference::read(file)?;
    if reference.metric != Metric::Mahalanobis {
        bail!(
            "{base}: a reference of {}; wanted one of {} for --base",
            reference.metric,
            Metric::Mahalanobis
        );
    }
    let model = LoadedModel::load(&args.model)?;
    reference.check_fits(base, &model.fingerprint)?;
    let wanted = Target {
        metric: reference.metric,
        window_s: reference.window_s,
        false_alarms_per_hour: reference.false_alarms.wanted_per_hour,
        evidence: reference.evidence,
        rate: reference.rate,
    };
    let plan = CalibrationPlan::new(model.fingerprint.clone(), wanted, sources)?;
    plan.check_base(&reference, base)?;
    let (_store, found) = look(args, &plan, &model)?;
    let Widened {
        reference,
        shown,
        doubts,
    } = plan.accepted(found, reference, base, far_drives(args))?;
    reference
        .write(&args.out)
        .context("cannot write the reference")?;
    describe(&reference, &args.out, out)?;
    for (name, shown) in &shown {
        describe_accepted(name, shown, out)?;
    }
    doubts.iter().for_each(|doubt| log::warn!("{doubt}"));
    Ok(0)
}

/// Says what stands behind an accepted domain, and what is missing.
fn describe_accepted(name: &str, shown: &Shown, out: &mut dyn Write) -> anyhow::Result<()> {
    let drives = match shown.drives {
        1 => "1 drive".to_owned(),
        drives => format!("{drives} drives"),
    };
    writeln!(
        out,
        "  {name}: {drives} of {:.1} minutes together",
        shown.seconds / 60.0
    )?;
    for (span, found) in Span::ALL.iter().zip(shown.spans) {
        let missing = SPANS_OWN.saturating_sub(found);
        let what = if span.is_change() {
            "changes"
        } else {
            "windows"
        };
        write!(
            out,
            "    {what} of {} s that do not overlap: {found}",
            span.length_s()
        )?;
        #[allow(clippy::cast_precision_loss)]
        let minutes = missing as f64 * span.length_s() / 60.0;
        match (missing, span.is_change()) {
            (0, _) => writeln!(out)?,
            (_, true) => writeln!(
                out,
                "; with {minutes:.1} minutes more, the spread of the simulation counts by half or less, until then whole"
            )?,
            (_, false) => writeln!(
                out,
                "; with {minutes:.1} minutes more, the spread of the simulation counts by half or less"
            )?,
        }
    }
    Ok(())
}

/// Writes a readable description of a reference; `file` is where it was written.
pub fn describe(reference: &Reference, file: &Path, out: &mut dyn Write) -> anyhow::Result<()> {
    let is_accepted = |of: &&SourceUse| of.role == Some(Role::Accepted);
    let all = &reference.provenance.sources;
    let frames = |of: fn(&SourceUse) -> u64| {
        let others = all.iter().filter(|source| !is_accepted(source));
        others.map(of).sum::<u64>()
    };
    // Every frame of an accepted road is fitted, and is also measured by what other frames have fitted.
    let accepted: u64 = all.iter().filter(is_accepted).map(|of| of.fitted).sum();
    let of_accepted = match accepted {
        0 => String::new(),
        frames => format!(", {frames} of accepted roads fitted and scaled crosswise"),
    };
    writeln!(
        out,
        "{}: {} on {} sources, {} frames fitted, {} held out{of_accepted}; {}",
        file.display(),
        reference.metric,
        reference.provenance.sources.len(),
        frames(|s| s.fitted),
        frames(|s| s.held_out),
        if reference.strict {
            "strict: simulation alone is nominal".to_owned()
        } else {
            format!("{} nominal domains", reference.components.len())
        }
    )?;
    for component in &reference.components {
        for tap in &component.taps {
            let (median, threshold) = tap.scale_for(10);
            writeln!(
                out,
                "  {}, {}: median peak energy {:.4}, windows of 10 frames: median {median:.5}, threshold {threshold:.5}",
                component.name, tap.tap, tap.median_peak_energy
            )?;
        }
    }
    if reference.metric == Metric::Mahalanobis && reference.evidence == EvidenceKind::Windows {
        describe_spans(reference, out)?;
    }
    if let Some(causes) = &reference.causes {
        describe_causes(causes, out)?;
    }
    if let Some(lanes) = &reference.lanes {
        let on = lanes.judged;
        writeln!(
            out,
            "  lanes: a forecast from {} labelled frames; on {} frames that a forecast from half of them has not seen, it misses by {:.3} on average, and the mean loss by {:.3}",
            lanes.frames, on.frames, on.mean_absolute_error, on.of_the_mean
        )?;
    }
    let said = |on: &NominalDrives| {
        let counted = format!(
            "{} entries in {} of {} drives",
            on.entries,
            Hours(on.hours),
            on.drives
        );
        if on.hours > 0.0 {
            let (low, high) = (ThreeDigits(on.per_hour.0), ThreeDigits(on.per_hour.1));
            format!("{counted}, {low} to {high} an hour (95 %)")
        } else {
            "no drive that could be judged".to_owned()
        }
    };
    let alarms = &reference.false_alarms;
    writeln!(
        out,
        "  false alarms: {} an hour wanted; set on {}",
        alarms.wanted_per_hour,
        said(&alarms.chosen_on)
    )?;
    if let Some(on) = &alarms.judged_on {
        writeln!(out, "  judged on {}", said(on))?;
    }
    writeln!(out, "  {}", alarms.said())?;
    match alarms.loudness() {
        Loudness::Louder => log::warn!(
            "{}: false alarms are {}; {} an hour wanted",
            file.display(),
            alarms.said(),
            alarms.wanted_per_hour
        ),
        Loudness::NotShown { .. } => {
            writeln!(out, "  every fourth drive of --held-out judges the rate")?;
        }
        Loudness::NotLouder => {}
    }
    Ok(())
}

/// Writes how well causes are told.
fn describe_causes(causes: &Causes, out: &mut dyn Write) -> anyhow::Result<()> {
    // Counts of deviations are small.
    #[allow(clippy::cast_precision_loss)]
    let right = |of: &Discriminant| 100.0 * of.right as f64 / of.judged.max(1) as f64;
    writeln!(
        out,
        "  cause: {} kinds from {} drives; of the half that made no centres, {:.1} % of changes and {:.1} % of gaps are told \
         right",
        causes.kinds.len(),
        causes.kinds.iter().map(|kind| kind.drives).sum::<usize>(),
        right(&causes.change),
        right(&causes.gap),
    )?;
    Ok(())
}

/// Writes what is nominal over longer times, or why nothing is.
fn describe_spans(reference: &Reference, out: &mut dyn Write) -> anyhow::Result<()> {
    writeln!(out, "  judged at {}", reference.rate)?;
    let mut taps = reference.components.iter().flat_map(|of| &of.taps);
    if taps.all(|tap| tap.spans.is_empty()) {
        writeln!(
            out,
            "  no longer windows and no changes: the fitted drives are too short; wanted at least {SPANS_OWN} times {} s in \
             drives of --sim that long",
            Span::ALL
                .map(Span::length_s)
                .into_iter()
                .fold(0.0, f64::max)
        )?;
    }
    Ok(())
}
