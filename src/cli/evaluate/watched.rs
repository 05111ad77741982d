//! The monitor that is judged: one model and its reference.

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
    /// The reference inside the program, on the look that it is made of.
    pub default: bool,
}

impl Watched {
    /// Opens model and reference; a reference of another model is refused.
    pub fn open(args: &EvaluateArgs) -> anyhow::Result<Self> {
        let reference = Reference::read(args.reference.as_deref())?;
        let name = args
            .reference
            .as_ref()
            .map_or_else(|| "built-in".to_owned(), |path| path.display().to_string());
        let model = match args.model.as_slice() {
            [] => None,
            [one] => Some(one.as_path()),
            _ => bail!("a reference is of one model; wanted one --model, or --only lane_iou"),
        };
        let spec = ModelSpec::new(model, ModelOptions::default())?;
        let encoder = Encoder::load(&spec)?;
        reference.check_fits(&name, &ModelFingerprint::new(&spec, &encoder))?;
        Ok(Self {
            encoder,
            reference,
            default: args.reference.is_none() && args.look == Look::Sim,
        })
    }

    /// How many times as far from their medians the thresholds for a rate lie as those of the reference.
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
