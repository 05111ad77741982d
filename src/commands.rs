//! One short file a command: wires a source, the chain and a sink.

mod calibrate;
mod compare;
mod progress;
mod replay;
mod scene;

use std::io::Write;

use gapwatch::encoder::Encoder;
use gapwatch::frame::open;
use gapwatch::model::ModelSpec;
use gapwatch::reference::ModelFingerprint;
use gapwatch::survey::{Survey, SurveyError};
use rayon::prelude::*;

use crate::args::{Command, ModelArgs};

/// Runs a command; the result is the exit code.
pub fn run(command: Command, out: &mut dyn Write) -> anyhow::Result<u8> {
    match command {
        Command::Replay(args) => replay::run(&args, out),
        Command::Calibrate(args) => calibrate::run(&args, out),
        Command::Compare(args) => compare::run(&args, out),
        Command::Scene(args) => scene::run(&args, out),
    }
}

/// A loaded model with all that belongs to it.
struct Model {
    spec: ModelSpec,
    encoder: Encoder,
    fingerprint: ModelFingerprint,
}

impl Model {
    fn load(args: &ModelArgs) -> anyhow::Result<Self> {
        let spec = ModelSpec::new(args.model.as_deref(), args.options())?;
        let encoder = Encoder::load(&spec)?;
        let fingerprint = ModelFingerprint::new(&spec, &encoder);
        Ok(Self {
            spec,
            encoder,
            fingerprint,
        })
    }

    /// Looks at whole sources, several at a time; a source that cannot be opened fails before any is looked at.
    fn survey(&self, sources: &[String], what: &str) -> anyhow::Result<Vec<Survey>> {
        let counts = sources
            .iter()
            .map(|name| Ok(open(name)?.frame_count()))
            .collect::<anyhow::Result<Vec<_>>>()?;
        let bar = progress::frames(counts.into_iter().sum(), what);
        let surveys = sources
            .par_iter()
            .map(|name| {
                Survey::of(name, &self.encoder, &self.spec.preprocessing, &|| {
                    bar.inc(1)
                })
            })
            .collect::<Result<Vec<_>, SurveyError>>()?;
        bar.finish_and_clear();
        Ok(surveys)
    }
}
