//! The monitor that is judged: one model and its reference.

use std::path::Path;

use anyhow::{Context, bail};
use gapwatch::lab::scene::Look;
use gapwatch::model::encoder::Encoder;
use gapwatch::model::{ModelOptions, ModelSpec};
use gapwatch::reference::{ModelFingerprint, Reference};

use crate::cli::args::EvaluateArgs;

/// The monitor that is judged.
pub struct Watched {
    pub encoder: Encoder,
    pub reference: Reference,
    /// Whether it is the reference inside the program, on the look from which it is made.
    pub default: bool,
}

impl Watched {
    /// Opens model and reference. A reference of another model is refused.
    pub fn open(args: &EvaluateArgs) -> anyhow::Result<Self> {
        Self::of(args, args.reference.as_deref())
    }

    /// The same with each reference that is judged beside it.
    pub fn also(args: &EvaluateArgs) -> anyhow::Result<Vec<Self>> {
        let all = args.also.iter().map(|path| Self::of(args, Some(path)));
        all.collect()
    }

    fn of(args: &EvaluateArgs, file: Option<&Path>) -> anyhow::Result<Self> {
        let reference = Reference::read(file)?;
        let name = Reference::name_of(file);
        let model = match args.model.as_slice() {
            [] => None,
            [one] => Some(one.as_path()),
            _ => bail!("a reference belongs to one model; wanted one --model, or --only lane_iou"),
        };
        let spec = ModelSpec::new(model, ModelOptions::default())?;
        let encoder = Encoder::load(&spec)?;
        reference.check_fits(&name, &ModelFingerprint::new(&spec, &encoder))?;
        Ok(Self {
            encoder,
            reference,
            default: file.is_none() && args.look == Look::Sim,
        })
    }

    /// Factor from the reference's distances between median and threshold to those for another rate.
    pub fn factor_for(&self, per_hour: f64) -> anyhow::Result<f64> {
        let alarms = &self.reference.false_alarms;
        let rates = &alarms.factors;
        let found = rates
            .iter()
            .find(|rate| rate.per_hour.total_cmp(&per_hour).is_eq());
        let found = found.with_context(|| {
            format!("the reference has no thresholds for {per_hour} false alarms an hour")
        })?;
        Ok(found.factor / alarms.factor)
    }
}
