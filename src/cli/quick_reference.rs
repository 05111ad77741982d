//! A reference for a model that has none, for measurements.

use anyhow::anyhow;
use gapwatch::calibration::survey::Keep;
use gapwatch::calibration::{Domain, LabelledMeans, Target, calibrate};
use gapwatch::reference::{Provenance, Reference};

use super::loaded_model::LoadedModel;

/// Makes a reference from two short drives, which is enough to have something to compare with.
pub fn made_for(model: &LoadedModel) -> anyhow::Result<Reference> {
    let drives = ["scene:sim?seed=1&seconds=3", "scene:sim?seed=2&seconds=3"].map(str::to_owned);
    let surveys = model.survey(&drives, Keep::Maps, "making a reference")?;
    let domain = Domain {
        name: "simulation".to_owned(),
        drives: &surveys,
    };
    let wanted = Target::new(
        "log-energy-js".parse().map_err(|why| anyhow!("{why}"))?,
        1.0,
        1.0,
    );
    let no_labels: &[LabelledMeans] = &[];
    let made = calibrate(&[domain], &[], no_labels, &model.spec.taps, wanted)?;
    Ok(Reference::new(
        model.fingerprint.clone(),
        wanted.metric,
        wanted.window_s,
        (wanted.evidence, made.rate),
        made.false_alarms,
        Provenance {
            gapwatch: env!("CARGO_PKG_VERSION").to_owned(),
            command: "bench".to_owned(),
            sources: made.sources,
        },
        made.components,
    ))
}
