//! A trial at loading: whatever is fast must compute the same as tract's graph before it is optimised.
//!
//! tract merges and moves operators to be fast, and some of its rewrites change the result. Our own executor is held to
//! the same.

use std::sync::Arc;

use tract_onnx::prelude::*;

use super::buffers::Buffers;
use super::guard::contained;
use super::inference::root;
use super::maps::{feature_map, run_in_tract};
use super::plan::Plan;

/// Largest difference that is taken for rounding, as a share of a tap's largest activation: a hundred times the difference
/// in the shipped models.
pub const DIFFERENCE_MAX: f32 = 1e-4;

/// A picture of noise, and what a model makes of it before it is optimised.
pub struct Trial {
    shape: [usize; 4],
    picture: Vec<f32>,
    plain: Arc<TypedRunnableModel>,
    wanted: TVec<TValue>,
}

impl Trial {
    /// Runs a model as it was read.
    ///
    /// # Errors
    /// When it cannot run, as text.
    pub fn new(model: &TypedModel, shape: [usize; 4], takes_bytes: bool) -> Result<Self, String> {
        let picture = noise(shape.iter().product(), takes_bytes);
        let plain = model.clone().into_runnable().map_err(|e| root(&e))?;
        let wanted = run(&plain, &shape, &picture)?;
        Ok(Self {
            shape,
            picture,
            plain,
            wanted,
        })
    }

    /// Whether our plan gives the same result.
    pub fn agrees_with(&self, plan: &Plan, name: &str) -> bool {
        let answers = contained(|| {
            let mut buffers = Buffers::new(plan);
            buffers.run(plan, &self.picture);
            let outputs = buffers.outputs().iter();
            outputs.map(|output| output.to_vec()).collect::<Vec<_>>()
        });
        let answers = answers
            .as_ref()
            .map(|answers| answers.iter().map(Vec::as_slice));
        self.judged(
            answers.map_err(|why| why.clone()),
            &format!("{name}: our executor"),
        )
    }

    /// The fastest of tract's graphs that gives the same result.
    pub fn fastest(self, model: TypedModel, name: &str) -> Arc<TypedRunnableModel> {
        let optimised = contained(|| {
            let decluttered = model
                .into_decluttered()
                .and_then(TypedModel::into_optimized);
            let optimised = decluttered
                .and_then(|m| m.into_runnable())
                .map_err(|e| root(&e))?;
            let answers = run(&optimised, &self.shape, &self.picture)?;
            Ok((optimised, answers))
        });
        let said = format!("{name}: tract's optimised graph");
        match optimised.flatten() {
            Ok((optimised, answers)) => {
                let maps = answers
                    .iter()
                    .map(|output| feature_map(output).map(|map| map.activations));
                let maps = maps.collect::<Result<Vec<_>, _>>();
                match self.judged(maps.map(Vec::into_iter), &said) {
                    true => optimised,
                    false => self.plain,
                }
            }
            Err(why) => {
                self.judged(Err::<std::iter::Empty<_>, _>(why), &said);
                self.plain
            }
        }
    }

    /// Whether answers are the wanted ones; says so if they are not.
    fn judged<'a>(
        &self,
        answers: Result<impl Iterator<Item = &'a [f32]>, String>,
        said: &str,
    ) -> bool {
        let difference = answers.and_then(|answers| {
            let mut largest = 0.0_f32;
            for (answer, wanted) in answers.zip(&self.wanted) {
                largest = largest.max(difference(answer, feature_map(wanted)?.activations));
            }
            Ok(largest)
        });
        match difference {
            Ok(difference) if difference <= DIFFERENCE_MAX => return true,
            Ok(difference) => log::warn!(
                "{said} is not used: it differs by {difference:e} of the largest activation"
            ),
            Err(why) => log::warn!("{said} is not used: {why}"),
        }
        false
    }
}

fn run(
    model: &Arc<TypedRunnableModel>,
    shape: &[usize; 4],
    picture: &[f32],
) -> Result<TVec<TValue>, String> {
    let mut state = model.spawn().map_err(|e| root(&e))?;
    run_in_tract(&mut state, shape, picture)
}

/// Largest difference between activations as a share of the largest finite activation; infinite if some are finite only
/// in one of them.
pub fn difference(ours: &[f32], theirs: &[f32]) -> f32 {
    let finite = theirs.iter().filter(|value| value.is_finite());
    let largest = finite.fold(f32::MIN_POSITIVE, |most, value| most.max(value.abs()));
    let apart = ours
        .iter()
        .zip(theirs)
        .map(|(a, b)| match (a.is_finite(), b.is_finite()) {
            (true, true) => (a - b).abs(),
            (false, false) => 0.0,
            _ => f32::INFINITY,
        });
    match apart.fold(0.0, f32::max) / largest {
        share if ours.len() == theirs.len() => share,
        _ => f32::INFINITY,
    }
}

/// Values from -2 to 2, which is the range of a normalised picture, or bytes; always the same values.
fn noise(count: usize, of_bytes: bool) -> Vec<f32> {
    let mut state = 1_u32;
    // A linear congruential generator's upper bits, exact as floats.
    #[allow(clippy::cast_precision_loss)]
    let value = |_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        match of_bytes {
            true => (state >> 24) as f32,
            false => (state >> 16) as f32 / 16_384.0 - 2.0,
        }
    };
    (0..count).map(value).collect()
}
