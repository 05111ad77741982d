//! Counts as shares of their totals.

use crate::capture::undefined::Undefined;

/// For each bin, the shares of two histograms in their totals.
///
/// # Errors
/// `EmptyHistogram` if a histogram has no count.
#[allow(clippy::cast_precision_loss)]
pub fn shares<'a>(
    a: &'a [u64],
    b: &'a [u64],
) -> Result<impl Iterator<Item = (f64, f64)> + 'a, Undefined> {
    let (total_a, total_b): (u64, u64) = (a.iter().sum(), b.iter().sum());
    if total_a == 0 || total_b == 0 {
        return Err(Undefined::EmptyHistogram);
    }
    Ok(a.iter()
        .zip(b)
        .map(move |(&a, &b)| (a as f64 / total_a as f64, b as f64 / total_b as f64)))
}
