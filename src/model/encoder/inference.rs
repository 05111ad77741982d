//! Checks of what tract read from a file, before it is used: sizes, shapes, names and constants.

use tract_onnx::prelude::*;
use tract_onnx::tract_hir::infer::{Factoid, GenericFactoid, ShapeFactoid};

/// The value with the most elements among those whose shape is known.
pub fn largest(model: &InferenceModel) -> Option<(String, u64)> {
    let volume = |fact: &InferenceFact| {
        let dims = fact.shape.concretize()?;
        dims.iter().try_fold(1_u64, |volume, dim| {
            Some(volume.saturating_mul(u64::try_from(dim.to_i64().ok()?).ok()?))
        })
    };
    let nodes = model.nodes().iter();
    nodes
        .flat_map(|node| node.outputs.iter().map(move |output| (node, output)))
        .filter_map(|(node, output)| Some((node.name.clone(), volume(&output.fact)?)))
        .max_by_key(|&(_, volume)| volume)
}

/// Whether an input with this declaration accepts pictures of this shape: dimensions that are open or have a name in
/// the file are free.
pub fn admits(declared: &ShapeFactoid, wanted: &[usize; 4]) -> bool {
    let dims: Vec<_> = declared.dims().collect();
    let rank_fits = dims.len() == wanted.len() || (declared.is_open() && dims.len() < wanted.len());
    let fixed = |dim: &GenericFactoid<TDim>| dim.concretize().and_then(|dim| dim.to_i64().ok());
    rank_fits
        && dims.iter().zip(wanted).all(|(dim, &wanted)| {
            fixed(dim).is_none_or(|found| usize::try_from(found) == Ok(wanted))
        })
}

/// The first constant with a NaN, or with an infinity among other values. (A single infinity may be an open bound.) A
/// ReLU of tract turns NaN into 0, so these values would not be visible in the taps.
pub fn broken_constant(model: &InferenceModel) -> Option<String> {
    model.nodes().iter().find_map(|node| {
        let value = node
            .outputs
            .iter()
            .find_map(|output| output.fact.value.concretize())?;
        let values = value.try_as_plain_ram().ok()?.as_slice::<f32>().ok()?;
        let broken = values
            .iter()
            .any(|v| v.is_nan() || (v.is_infinite() && values.len() > 1));
        broken.then(|| node.name.clone())
    })
}

/// tract's chain of contexts in one line, the cause last.
pub fn root(error: &TractError) -> String {
    format!("{error:#}")
        .lines()
        .next()
        .unwrap_or_default()
        .chars()
        .take(300)
        .collect()
}

/// The names in their order, shortened in the middle if there are many.
pub fn listed<'a>(names: impl Iterator<Item = &'a String>) -> String {
    let names: Vec<&str> = names
        .map(String::as_str)
        .filter(|name| !name.is_empty())
        .collect();
    const SHOWN: usize = 60;
    if names.len() <= SHOWN {
        return names.join(", ");
    }
    let (first, last) = (&names[..SHOWN / 2], &names[names.len() - SHOWN / 2..]);
    format!(
        "{}, … {} more …, {}",
        first.join(", "),
        names.len() - SHOWN,
        last.join(", ")
    )
}
