//! Rendered drives with lane labels, from which it is learnt what the lane model loses.

use gapwatch::calibration::LabelledMeans;
use gapwatch::model::encoder::Encoder;
use gapwatch::model::preprocess::Preprocessing;

/// Number of frames of a drive.
pub fn frame_count(name: &str) -> anyhow::Result<u64> {
    #[cfg(feature = "lab")]
    let count = spec(name)?.frames();
    #[cfg(not(feature = "lab"))]
    let count = not_here(name)?;
    Ok(count)
}

/// What the encoder sees of each frame, and what the lane model loses there.
#[cfg(feature = "lab")]
pub fn frames(
    name: &str,
    encoder: &Encoder,
    preprocessing: &Preprocessing,
) -> anyhow::Result<Vec<LabelledMeans>> {
    let drive = spec(name)?;
    // The number is the seed and not the position, so that it is the same in any shard. Only the seed modulo 5 matters.
    let number = usize::try_from(drive.seed % 5)?;
    let frames = gapwatch::lab::labelled::frames_of(&drive, number, encoder, preprocessing)?;
    Ok(frames.into_iter().map(|(_, frame)| frame).collect())
}

/// What the encoder sees of each frame, and what the lane model loses there.
#[cfg(not(feature = "lab"))]
pub fn frames(name: &str, _: &Encoder, _: &Preprocessing) -> anyhow::Result<Vec<LabelledMeans>> {
    not_here(name)
}

/// A rendered drive by name; no other source has lane labels.
#[cfg(feature = "lab")]
fn spec(name: &str) -> anyhow::Result<gapwatch::lab::scene::DriveSpec> {
    let Some(spec) = name.strip_prefix("scene:") else {
        anyhow::bail!("--labelled {name}: has no lane labels; wanted a rendered drive, scene:…");
    };
    let spec: gapwatch::lab::scene::DriveSpec = spec.parse()?;
    if !spec.conditions.is_empty() {
        anyhow::bail!(
            "--labelled {name}: has a condition; wanted a plain drive, to which conditions are added"
        );
    }
    Ok(spec)
}

#[cfg(not(feature = "lab"))]
fn not_here<T>(name: &str) -> anyhow::Result<T> {
    anyhow::bail!(
        "--labelled {name}: this build has no rendered drives (build with --features lab)"
    )
}
