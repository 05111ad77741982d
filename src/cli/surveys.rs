//! Whole sources through a model, several at a time.

use anyhow::bail;
use gapwatch::calibration::survey::{Keep, Survey, SurveyError};
use gapwatch::capture::open;
use rayon::prelude::*;

use super::loaded_model::LoadedModel;
use super::progress;

impl LoadedModel {
    /// Looks at whole sources, several at a time. A source that cannot be opened is an error before any source is
    /// looked at.
    pub fn survey(
        &self,
        sources: &[String],
        keep: Keep,
        what: &str,
    ) -> anyhow::Result<Vec<Survey>> {
        let counts = sources
            .iter()
            .map(|name| Ok(open(name)?.frame_count()))
            .collect::<anyhow::Result<Vec<_>>>()?;
        let count: Option<u64> = counts.into_iter().sum();
        let most = keep.frames_max();
        if let Some(count) = count.filter(|&count| count > most) {
            bail!(
                "{count} frames in total; wanted at most {most}: use fewer or shorter drives, or a lower fps"
            );
        }
        let bar = progress::frames(count, what);
        let surveys = sources
            .par_iter()
            .map(|name| {
                Survey::of(name, &self.encoder, &self.spec.preprocessing, keep, &|| {
                    bar.inc(1)
                })
            })
            .collect::<Result<Vec<_>, SurveyError>>()?;
        bar.finish_and_clear();
        Ok(surveys)
    }
}
