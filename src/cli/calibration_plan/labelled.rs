//! Drives with lane labels, which are rendered: what the lane model loses in them is learnt.

use gapwatch::calibration::LabelledMeans;
use gapwatch::model::encoder::Encoder;
use gapwatch::model::preprocess::Preprocessing;

/// Frames of a drive.
pub fn frame_count(name: &str) -> anyhow::Result<u64> {
    #[cfg(feature = "lab")]
    return Ok(spec(name)?.frames());
    #[cfg(not(feature = "lab"))]
    return Err(not_here(name));
}

/// What the encoder sees of each frame, and what the lane model loses there.
#[cfg_attr(not(feature = "lab"), expect(unused_variables))]
pub fn frames(
    name: &str,
    encoder: &Encoder,
    preprocessing: &Preprocessing,
) -> anyhow::Result<Vec<LabelledMeans>> {
    #[cfg(feature = "lab")]
    {
        let drive = spec(name)?;
        // By its seed, not its place: the drive is the same in any shard. Only its rest by 5 counts.
        let number = usize::try_from(drive.seed % 5)?;
        let frames = gapwatch::lab::labelled::frames_of(&drive, number, encoder, preprocessing)?;
        return Ok(frames.into_iter().map(|(_, frame)| frame).collect());
    }
    #[cfg(not(feature = "lab"))]
    return Err(not_here(name));
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
            "--labelled {name}: has a condition; wanted a plain drive, conditions are added"
        );
    }
    Ok(spec)
}

#[cfg(not(feature = "lab"))]
fn not_here(name: &str) -> anyhow::Error {
    anyhow::anyhow!(
        "--labelled {name}: this build has no rendered drives (build with --features lab)"
    )
}
