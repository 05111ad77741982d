//! Image sets of other roads, and the model that looks at them.

use std::path::PathBuf;

use anyhow::bail;
use gapwatch::calibration::survey::{Keep, Survey};
use gapwatch::capture::drives;
use gapwatch::lab::evaluation::field_sets::{ImageSequence, SequenceSet};
use gapwatch::model::ModelOptions;

use crate::cli::args::EvaluateArgs;
use crate::cli::loaded_model::LoadedModel;

/// An image set of the folder.
///
/// Blocks are at least twice the integrated autocorrelation time of the gaps of single images against a reference of
/// towns 01 to 03 (mahalanobis and log-energy-js, the largest of the taps): 25 images of the highway clip, 7 of the
/// frames from another clip, 1.5 of town 05 and BeamNG.
pub struct FieldSet {
    pub name: &'static str,
    /// Its sequences in the folder, and the number of neighbouring images that make a block of each.
    sources: &'static [(&'static str, usize)],
    /// Number of roads or drives that they come from, as far as it is known.
    drives: usize,
}

/// CARLA, clear day: every n-th image of ordered sequences in towns 01 to 03, and the last four in town 04.
pub const TOWNS: FieldSet = FieldSet {
    name: "carla_town01-03",
    sources: &[("sim/carla_town01-03", 10)],
    drives: 4,
};
/// The same simulator and camera in another town.
pub const TOWN_05: FieldSet = FieldSet {
    name: "carla_town05",
    sources: &[("sim/carla_town05", 5)],
    drives: 1,
};
/// A highway by day: two clips at 25 frames a second, frames of a third one, and stills of the same road.
pub const HIGHWAY: FieldSet = FieldSet {
    name: "california_highway",
    sources: &[
        (CLIP, 50),
        ("real/california_highway/concrete_bridge.mp4", 50),
        ("real/california_highway/project_video_frames", 15),
        ("real/california_highway", 1),
    ],
    drives: 1,
};
/// Another simulator, with the bonnet in view.
pub const BEAMNG: FieldSet = FieldSet {
    name: "beamng",
    sources: &[("sim/beamng", 5)],
    drives: 1,
};
/// CARLA from other camera poses, most of them at one place.
pub const POSES: FieldSet = FieldSet {
    name: "carla_town04_poses",
    sources: &[
        ("sim/carla_town04_poses/images_raw", 10),
        ("sim/carla_town04_poses/Image_yaw_2_pitch_-3.png", 1),
        (
            "sim/carla_town04_poses/Town04_Clear_Noon_09_09_2020_14_57_22_frame_625_validation_set.png",
            1,
        ),
    ],
    drives: 1,
};

/// One clip of that highway.
pub const HIGHWAY_CLIP: FieldSet = FieldSet {
    name: "real: highway clip",
    sources: &[(CLIP, 50)],
    drives: 1,
};
/// The other images of that highway.
pub const HIGHWAY_REST: FieldSet = FieldSet {
    name: "real 2: other highway images",
    sources: &[
        ("real/california_highway/concrete_bridge.mp4", 50),
        ("real/california_highway/project_video_frames", 15),
        ("real/california_highway", 1),
    ],
    drives: 1,
};

const CLIP: &str = "real/california_highway/solidWhiteRight.mp4";

/// The model, and the folder of image sets if there is one.
pub struct Field {
    folder: Option<PathBuf>,
    model: LoadedModel,
}

impl Field {
    /// Opens the model and checks that all sets are there.
    pub fn open(args: &EvaluateArgs) -> anyhow::Result<Self> {
        if let Some(folder) = &args.field {
            let sources = [TOWNS, TOWN_05, HIGHWAY, BEAMNG, POSES].map(|set| set.sources);
            for source in sources
                .concat()
                .iter()
                .map(|(source, _)| folder.join(source))
            {
                if !source.exists() {
                    bail!(
                        "{}: no such file or folder; wanted the image sets that calibration/README.md lists in --field {}",
                        source.display(),
                        folder.display()
                    );
                }
            }
        }
        let model = match args.model.as_slice() {
            [] => None,
            [one] => Some(one.as_path()),
            _ => bail!("image sets are compared with one model; wanted one --model"),
        };
        Ok(Self {
            folder: args.field.clone(),
            model: LoadedModel::load_file(model, ModelOptions::default())?,
        })
    }

    /// Whether there is a folder of image sets.
    pub fn has_images(&self) -> bool {
        self.folder.is_some()
    }

    /// The model's taps.
    pub fn taps(&self) -> &[String] {
        &self.model.spec.taps
    }

    /// Looks at every image of a set.
    pub fn look(&self, set: &FieldSet) -> anyhow::Result<SequenceSet> {
        let Some(folder) = &self.folder else {
            bail!("{}: is an image set; wanted --field DIR", set.name);
        };
        let sources: Vec<String> = set
            .sources
            .iter()
            .map(|(source, _)| folder.join(source).display().to_string())
            .collect();
        let surveys = self.model.survey(&sources, Keep::Maps, set.name)?;
        let blocks = set.sources.iter().map(|(_, block_images)| *block_images);
        Ok(sequences(set.name, surveys, blocks, set.drives))
    }

    /// Looks at every frame of rendered drives; each is a block.
    pub fn render(&self, name: &str, source: &str) -> anyhow::Result<SequenceSet> {
        let sources = drives(source)?;
        let surveys = self.model.survey(&sources, Keep::Maps, name)?;
        let blocks = std::iter::repeat(usize::MAX);
        Ok(sequences(name, surveys, blocks, sources.len()))
    }

    /// Looks at random pixels; every image is independent of the others.
    pub fn random(&self, images: usize) -> anyhow::Result<SequenceSet> {
        let source = format!("random:seed=1&frames={images}");
        let surveys = self.model.survey(&[source], Keep::Maps, "random")?;
        Ok(sequences("random", surveys, std::iter::once(1), images))
    }
}

fn sequences(
    name: &str,
    surveys: Vec<Survey>,
    blocks: impl Iterator<Item = usize>,
    drives: usize,
) -> SequenceSet {
    let sequences = surveys.into_iter().zip(blocks);
    SequenceSet {
        name: name.to_owned(),
        sequences: sequences
            .map(|(survey, block_images)| ImageSequence {
                survey,
                block_images,
            })
            .collect(),
        drives,
    }
}
