//! What a reference is made of: drives by role, in a fixed order, and what the encoder saw of them.

mod base;
mod command;
mod labelled;
pub mod warnings;

use std::borrow::Cow;
use std::collections::{BTreeMap, HashSet};

use anyhow::{Context, anyhow, bail};
use gapwatch::calibration::drive::StoreError;
use gapwatch::calibration::shard::ShardSource;
use gapwatch::calibration::survey::store::{Content, Stored, SurveyKind, SurveyStore};
use gapwatch::calibration::survey::{Keep, Survey};
use gapwatch::calibration::{
    Accepted, Calibrated, CalibrationError, Domain, DriveDistance, DriveFacts, FarDrives,
    LabelledDrive, LabelledMeans, Shown, SurveyedDrive, Target, accept, calibrate_with, cause_of,
    facts_of, learn_causes, learn_lanes, looks, looks_to_accept,
};
use gapwatch::capture::{open, sort_drives, stamp};
use gapwatch::model::ModelSpec;
use gapwatch::model::encoder::Encoder;
use gapwatch::reference::gap::Metric;
use gapwatch::reference::{
    COMPONENTS_MAX, ModelFingerprint, Provenance, Reference, Role, SourceUse,
};
use indicatif::ProgressBar;
use rayon::prelude::*;

use super::loaded_model::LoadedModel;
use super::progress;

/// Name of the first nominal domain.
const SIMULATION: &str = "simulation";
/// Name of the domain of accepted drives without a name of their own.
pub const ACCEPTED: &str = "accepted";

/// Drives by role, sorted, and the calibration target.
pub struct CalibrationPlan {
    pub model: ModelFingerprint,
    pub wanted: Target,
    simulation: Vec<String>,
    /// Name and drives of each domain, by name.
    accepted: BTreeMap<String, Vec<String>>,
    held_out: Vec<String>,
    labelled: Vec<String>,
    causes: Vec<String>,
}

/// A drive of a plan.
pub struct PlannedDrive {
    pub role: Role,
    /// Name of an accepted domain; that of [`ACCEPTED`] if none is given.
    pub domain: Option<String>,
    pub source: String,
}

/// What has been found of a plan's drives.
pub struct Found {
    /// Surveys of the simulation, of each accepted domain, of the held-out drives and of those with a known cause, in
    /// this order.
    drives: Vec<Option<Stored<Survey>>>,
    labelled: Vec<Option<Stored<Vec<LabelledMeans>>>>,
}

impl CalibrationPlan {
    /// Sorts drives. Accepted drives of one name are one domain.
    pub fn new(
        model: ModelFingerprint,
        wanted: Target,
        drives: Vec<PlannedDrive>,
    ) -> anyhow::Result<Self> {
        let of_role = |wanted: Role| {
            let own = drives.iter().filter(|drive| drive.role == wanted);
            let mut names: Vec<String> = own.map(|drive| drive.source.clone()).collect();
            sort_drives(&mut names);
            names
        };
        let mut accepted: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for drive in drives.iter().filter(|of| of.role == Role::Accepted) {
            let name = drive.domain.as_deref().unwrap_or(ACCEPTED);
            let own = accepted.entry(name.to_owned()).or_default();
            own.push(drive.source.clone());
        }
        accepted.values_mut().for_each(|names| sort_drives(names));
        if accepted.contains_key(SIMULATION) {
            bail!("an accepted domain named {SIMULATION}; wanted another name");
        }
        let plan = Self {
            model,
            wanted,
            simulation: of_role(Role::Simulation),
            accepted,
            held_out: of_role(Role::HeldOut),
            labelled: of_role(Role::Labelled),
            causes: of_role(Role::Cause),
        };
        let mut seen = HashSet::new();
        let surveyed = plan.surveyed();
        if let Some(twice) = surveyed.iter().find(|&source| !seen.insert(source)) {
            bail!(
                "source {twice} is given twice; held-out drives must be different from fitted drives"
            );
        }
        let mut seen = HashSet::new();
        if let Some(twice) = plan.labelled.iter().find(|&source| !seen.insert(source)) {
            bail!("labelled drive {twice} is given twice");
        }
        if plan.accepted.len() >= COMPONENTS_MAX {
            bail!(
                "{} accepted domains; wanted at most {}: drives of one name are one domain",
                plan.accepted.len(),
                COMPONENTS_MAX - 1
            );
        }
        let risk = wanted.metric == Metric::LaneRisk;
        if !risk && wanted.metric != Metric::Mahalanobis && !plan.labelled.is_empty() {
            bail!(
                "--labelled is for forecasts of lost lanes; wanted --metric {} or {}",
                Metric::Mahalanobis,
                Metric::LaneRisk
            );
        }
        if risk && !plan.accepted.is_empty() {
            bail!(
                "--metric lane-risk judges any road by what the lane model loses; wanted no --accept"
            );
        }
        for name in &plan.labelled {
            labelled::frame_count(name)?;
        }
        if !plan.causes.is_empty() && !wanted.is_timed() {
            bail!(
                "--causes is for changes of energies; wanted --metric mahalanobis and --evidence windows"
            );
        }
        for name in &plan.causes {
            cause_of(name).map_err(|why| anyhow!("--causes {why}"))?;
        }
        Ok(plan)
    }

    /// Refuses drives from which no reference can be made.
    pub fn check_whole(&self) -> anyhow::Result<()> {
        if self.simulation.is_empty() {
            bail!("no nominal drive of the simulation; wanted at least one with --sim");
        }
        if self.wanted.metric == Metric::LaneRisk && self.labelled.is_empty() {
            bail!("--metric lane-risk learns from lane labels; wanted --labelled");
        }
        Ok(())
    }

    /// All drives but the labelled ones.
    fn surveyed(&self) -> Vec<String> {
        let accepted = self.accepted.values();
        std::iter::once(&self.simulation)
            .chain(accepted)
            .chain([&self.held_out, &self.causes])
            .flatten()
            .cloned()
            .collect()
    }

    fn keep(&self) -> Keep {
        match self.wanted.metric.divergence() {
            None => Keep::Means,
            Some(_) => Keep::Maps,
        }
    }

    /// What a store has of the drives. If `now` is the model in use, only surveys that would be the same if they were
    /// made now.
    pub fn find(&self, store: &SurveyStore, now: Option<&ModelSpec>) -> anyhow::Result<Found> {
        let surveyed = self.surveyed();
        let drives = surveyed.par_iter().map(|name| {
            let stamp = now.map(|_| stamp(name)).transpose()?;
            let find = |kept| found(store, name, kept, stamp.as_deref());
            match (find(self.keep().into())?, self.keep()) {
                // Surveys with maps have means too.
                (None, Keep::Means) => Ok(find(SurveyKind::Maps)?),
                (there, _) => Ok(there),
            }
        });
        let lane = now.map(lane_stamp);
        let labelled = self
            .labelled
            .par_iter()
            .map(|name| Ok(found(store, name, SurveyKind::Labelled, lane.as_deref())?));
        Ok(Found {
            drives: drives.collect::<anyhow::Result<_>>()?,
            labelled: labelled.collect::<anyhow::Result<_>>()?,
        })
    }

    /// Looks at the drives that were not found. A source that cannot be opened is an error before any drive is looked
    /// at.
    pub fn look(
        &self,
        found: &mut Found,
        model: &LoadedModel,
        store: &SurveyStore,
    ) -> anyhow::Result<()> {
        self.look_at_labelled(found, &model.spec, store)?;
        let keep = self.keep();
        let surveyed = self.surveyed();
        let missing: Vec<_> = surveyed
            .iter()
            .zip(&mut found.drives)
            .filter(|(_, there)| there.is_none())
            .collect();
        let mut total = Some(0);
        for (name, _) in &missing {
            let count = open(name)?.frame_count();
            let most = keep.frames_max();
            if let Some(count) = count.filter(|&count| count > most) {
                bail!(
                    "{name}: {count} frames in one drive; wanted at most {most}: use shorter drives, or a lower fps"
                );
            }
            total = total.zip(count).map(|(total, count)| total + count);
        }
        let bar = progress::frames(total, "looking");
        missing.into_par_iter().try_for_each(|(name, place)| {
            let stamp = stamp(name)?;
            let survey = Survey::of(
                name,
                &model.encoder,
                &model.spec.preprocessing,
                keep,
                &|| bar.inc(1),
            )?;
            *place = Some(store.keep(name, keep.into(), &stamp, &survey)?);
            anyhow::Ok(())
        })?;
        bar.finish_and_clear();
        Ok(())
    }

    /// Looks at the labelled drives with the lane model, plain and under every condition.
    fn look_at_labelled(
        &self,
        found: &mut Found,
        spec: &ModelSpec,
        store: &SurveyStore,
    ) -> anyhow::Result<()> {
        let missing: Vec<_> = self
            .labelled
            .iter()
            .zip(&mut found.labelled)
            .filter(|(_, there)| there.is_none())
            .collect();
        if missing.is_empty() {
            return Ok(());
        }
        if spec.lane.is_none() {
            bail!(
                "{}: no lane output is named; wanted lane = \"NAME\" in the .toml beside it for lane-risk",
                spec.name
            );
        }
        let encoder = Encoder::load_with_lane(spec)?;
        let bar = progress::frames(Some(missing.len() as u64), "labelled drives");
        missing.into_par_iter().try_for_each(|(name, place)| {
            let frames = labelled::frames(name, &encoder, &spec.preprocessing)?;
            *place = Some(store.keep(name, SurveyKind::Labelled, &lane_stamp(spec), &frames)?);
            bar.inc(1);
            anyhow::Ok(())
        })?;
        bar.finish_and_clear();
        Ok(())
    }

    /// The drives with their roles and frames.
    pub fn sources(&self, found: &Found) -> anyhow::Result<Vec<ShardSource>> {
        let of = |names: &[String], role: Role, domain: Option<&str>| -> Vec<_> {
            let all = names.iter();
            all.map(|name| (name.clone(), role, domain.map(str::to_owned)))
                .collect()
        };
        let mut surveyed = of(&self.simulation, Role::Simulation, None);
        for (name, drives) in &self.accepted {
            surveyed.extend(of(drives, Role::Accepted, Some(name)));
        }
        surveyed.extend(of(&self.held_out, Role::HeldOut, None));
        surveyed.extend(of(&self.causes, Role::Cause, None));
        let mut sources = Vec::new();
        for ((source, role, domain), drive) in surveyed.into_iter().zip(&found.drives) {
            let frames = drive.as_ref().map_or(0, SurveyedDrive::frames) as u64;
            sources.push(ShardSource {
                source,
                role,
                domain,
                frames,
            });
        }
        for source in &self.labelled {
            sources.push(ShardSource {
                source: source.clone(),
                role: Role::Labelled,
                domain: None,
                frames: labelled::frame_count(source)?,
            });
        }
        Ok(sources)
    }

    /// Makes the reference from the drives, all of which have been found, and says what is doubtful about them.
    pub fn reference(
        &self,
        found: Found,
        far_drives: FarDrives,
    ) -> anyhow::Result<(Reference, Vec<String>)> {
        let drives = all(found.drives)?;
        let labelled = all(found.labelled)?;
        let bar = progress::over(Some(0), "thresholds", "looks at drives");
        let drives: Vec<CountedDrive<'_, _>> = counted(&drives, &bar);
        let labelled: Vec<CountedDrive<'_, _>> = counted(&labelled, &bar);
        let nominal = drives.len() - self.causes.len();
        let (simulation, rest) = drives.split_at(self.simulation.len());
        let mut domains = vec![Domain {
            name: SIMULATION.to_owned(),
            drives: simulation,
        }];
        let (accepted, rest) = self.accepted_domains(rest);
        domains.extend(accepted);
        let (held_out, causes) = rest.split_at(self.held_out.len());
        let is_risk = self.wanted.metric == Metric::LaneRisk;
        let of_metric = if is_risk { labelled.as_slice() } else { &[] };
        let mut length = looks(&domains, held_out, of_metric, self.wanted);
        if !is_risk && !labelled.is_empty() {
            length += (simulation.len().div_ceil(2) + labelled.len()) as u64;
        }
        if !causes.is_empty() {
            length += (simulation.len() + causes.len()) as u64;
        }
        bar.set_length(length + nominal as u64);
        let facts = facts_of(&drives[..nominal])?;
        let Calibrated {
            components,
            false_alarms,
            mut sources,
            rate,
            distances,
            held_out_of_simulation,
        } = calibrate_with(
            &domains,
            held_out,
            of_metric,
            &self.model.taps,
            self.wanted,
            far_drives,
        )?;
        tell(&distances);
        let mut doubts = self.doubts(&facts, &sources)?;
        doubts.extend(warnings::of_far(&distances));
        doubts.extend(warnings::of_few_held_out(held_out_of_simulation));
        let learnt = match causes {
            [] => None,
            drives => Some(learn_causes(
                drives,
                simulation,
                &components[0],
                self.wanted,
            )?),
        };
        let lanes = match labelled.as_slice() {
            [] => None,
            _ if is_risk => None,
            drives => Some(learn_lanes(
                simulation,
                &components[0],
                drives,
                self.wanted,
            )?),
        };
        bar.finish_and_clear();
        for name in &self.labelled {
            let frames = labelled::frame_count(name)?;
            sources.push(SourceUse {
                source: name.clone(),
                role: Some(Role::Labelled),
                domain: None,
                frames,
                fitted: frames,
                held_out: 0,
            });
        }
        let causes = learnt.map(|learnt| {
            sources.extend(learnt.sources);
            learnt.causes
        });
        let provenance = Provenance {
            gapwatch: env!("CARGO_PKG_VERSION").to_owned(),
            command: self.command(rate)?,
            sources,
        };
        let reference = Reference::new(
            self.model.clone(),
            self.wanted.metric,
            self.wanted.window_s,
            (self.wanted.evidence, rate),
            false_alarms,
            provenance,
            components,
        )
        .with_causes(causes)
        .with_lanes(lanes);
        Ok((reference, doubts))
    }

    /// What is doubtful about the drives of the simulation, the accepted domains and the held-out drives, of which `facts`
    /// are in this order.
    fn doubts(&self, facts: &[DriveFacts], sources: &[SourceUse]) -> anyhow::Result<Vec<String>> {
        let (simulation, mut rest) = facts.split_at(self.simulation.len());
        let mut doubts = Vec::new();
        let fitted = sources
            .iter()
            .filter(|of| of.role == Some(Role::Simulation));
        let fitted = usize::try_from(fitted.map(|of| of.fitted).sum::<u64>())?;
        doubts.extend(warnings::of_stills("--sim", simulation.iter()));
        if self.wanted.metric == Metric::Mahalanobis {
            doubts.extend(warnings::of_few_frames("--sim", fitted, simulation));
        }
        for (name, names) in &self.accepted {
            let (own, others) = rest.split_at(names.len());
            rest = others;
            doubts.extend(self.doubts_about_accepted(name, &Shown::of(own.to_vec())));
        }
        doubts.extend(warnings::of_stills("--held-out", rest.iter()));
        doubts.extend(self.camera_faults()?);
        Ok(doubts)
    }

    /// Faults of the camera in accepted roads.
    fn camera_faults(&self) -> anyhow::Result<Vec<String>> {
        let roads: Vec<&String> = self.accepted.values().flatten().collect();
        warnings::of_camera_faults(&roads, self.wanted.rate)
    }

    /// What is doubtful about one accepted domain.
    fn doubts_about_accepted(&self, name: &str, shown: &Shown) -> Vec<String> {
        let stills = warnings::of_stills("accepted", shown.of_drives.iter());
        let mut doubts = warnings::of_accepted(name, shown);
        doubts.extend(stills);
        doubts
    }

    /// Accepted domains, and the drives after theirs.
    fn accepted_domains<'d, D>(&self, drives: &'d [D]) -> (Vec<Domain<'d, D>>, &'d [D]) {
        let (mut domains, mut rest) = (Vec::new(), drives);
        for (name, names) in &self.accepted {
            let (own, others) = rest.split_at(names.len());
            domains.push(Domain {
                name: name.clone(),
                drives: own,
            });
            rest = others;
        }
        (domains, rest)
    }

    /// Adds the accepted drives, all of which have been found, to a reference, and says what stands behind each domain and
    /// what is doubtful; `base` is what was typed for the reference.
    pub fn accepted(
        &self,
        found: Found,
        reference: Reference,
        base: &str,
        far_drives: FarDrives,
    ) -> anyhow::Result<Widened> {
        let drives = all(found.drives)?;
        let bar = progress::over(Some(0), "thresholds", "looks at drives");
        let drives: Vec<CountedDrive<'_, _>> = counted(&drives, &bar);
        let (domains, _) = self.accepted_domains(&drives);
        bar.set_length(looks_to_accept(&domains, self.wanted));
        let Accepted {
            components,
            sources,
            shown,
            distances,
        } = accept(&reference.components[0], &domains, self.wanted)?;
        bar.finish_and_clear();
        tell(&distances);
        if far_drives == FarDrives::Refused && distances.iter().any(DriveDistance::is_far) {
            return Err(CalibrationError::Far(distances).into());
        }
        let names = domains.iter().map(|domain| domain.name.clone());
        let shown: Vec<(String, Shown)> = names.zip(shown).collect();
        let mut doubts = Vec::new();
        for (name, shown) in &shown {
            doubts.extend(self.doubts_about_accepted(name, shown));
        }
        doubts.extend(self.camera_faults()?);
        doubts.extend(warnings::of_far(&distances));
        Ok(Widened {
            reference: reference.accepting(components, sources, self.command_on(base)?),
            shown,
            doubts,
        })
    }
}

/// Logs every distance for `RUST_LOG=info`.
fn tell(distances: &[DriveDistance]) {
    distances.iter().for_each(|of| log::info!("{of}"));
}

/// A reference with accepted roads.
pub struct Widened {
    pub reference: Reference,
    /// Name of each accepted domain, and what stands behind it.
    pub shown: Vec<(String, Shown)>,
    /// What is doubtful about the roads.
    pub doubts: Vec<String>,
}

/// A drive that counts in the progress bar how often its survey is read.
struct CountedDrive<'a, T> {
    drive: &'a Stored<T>,
    bar: &'a ProgressBar,
}

fn counted<'a, T>(drives: &'a [Stored<T>], bar: &'a ProgressBar) -> Vec<CountedDrive<'a, T>> {
    drives
        .iter()
        .map(|drive| CountedDrive { drive, bar })
        .collect()
}

impl SurveyedDrive for CountedDrive<'_, Survey> {
    fn source(&self) -> &str {
        self.drive.source()
    }

    fn frames(&self) -> usize {
        SurveyedDrive::frames(self.drive)
    }

    fn survey(&self) -> Result<Cow<'_, Survey>, StoreError> {
        self.bar.inc(1);
        self.drive.survey()
    }
}

impl LabelledDrive for CountedDrive<'_, Vec<LabelledMeans>> {
    fn frames(&self) -> usize {
        LabelledDrive::frames(self.drive)
    }

    fn means(&self) -> Result<Cow<'_, [LabelledMeans]>, StoreError> {
        self.bar.inc(1);
        self.drive.means()
    }
}

impl Found {
    /// How many drives were not found.
    pub fn missing(&self) -> usize {
        let drives = self.drives.iter().filter(|there| there.is_none());
        let labelled = self.labelled.iter().filter(|there| there.is_none());
        drives.count() + labelled.count()
    }
}

/// A drive's survey in a store. A damaged survey is logged and counts as not found.
fn found<T: Content>(
    store: &SurveyStore,
    name: &str,
    kept: SurveyKind,
    stamp: Option<&str>,
) -> Result<Option<Stored<T>>, StoreError> {
    match store.find(name, kept, stamp) {
        Err(error @ StoreError::Damaged { .. }) => {
            log::warn!("{error}; looking at it again");
            Ok(None)
        }
        other => other,
    }
}

fn all<T>(found: Vec<Option<T>>) -> anyhow::Result<Vec<T>> {
    let all: Option<Vec<T>> = found.into_iter().collect();
    all.context("a drive was not looked at")
}

/// What a labelled drive's frames depend on besides the encoder: the lane output.
fn lane_stamp(spec: &ModelSpec) -> String {
    // What a loss is belongs to it.
    format!("{} 1-F1", spec.lane.as_deref().unwrap_or_default())
}
