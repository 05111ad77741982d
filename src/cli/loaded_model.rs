//! The model that the command line names, loaded.

use std::path::Path;

use gapwatch::model::encoder::{Encoder, Executor};
use gapwatch::model::{ModelOptions, ModelSpec};
use gapwatch::reference::ModelFingerprint;

use super::args::ModelArgs;

/// A loaded model with everything that belongs to it.
pub struct LoadedModel {
    pub spec: ModelSpec,
    pub encoder: Encoder,
    pub fingerprint: ModelFingerprint,
}

impl LoadedModel {
    pub fn load(args: &ModelArgs) -> anyhow::Result<Self> {
        Self::load_in(args, Executor::default())
    }

    pub fn load_in(args: &ModelArgs, executor: Executor) -> anyhow::Result<Self> {
        Self::of_spec(
            ModelSpec::new(args.model.as_deref(), args.options())?,
            executor,
        )
    }

    pub fn load_file(file: Option<&Path>, options: ModelOptions) -> anyhow::Result<Self> {
        Self::of_spec(ModelSpec::new(file, options)?, Executor::default())
    }

    #[cfg(feature = "lab")]
    pub fn load_spec(spec: &ModelSpec) -> anyhow::Result<Self> {
        Self::of_spec(spec.clone(), Executor::default())
    }

    fn of_spec(spec: ModelSpec, executor: Executor) -> anyhow::Result<Self> {
        let encoder = Encoder::load_in(&spec, executor)?;
        let fingerprint = ModelFingerprint::new(&spec, &encoder);
        Ok(Self {
            spec,
            encoder,
            fingerprint,
        })
    }
}
