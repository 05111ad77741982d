//! The command line as typed.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use gapwatch::scene::Condition;

/// Watches the road through a lane model's own encoder and warns on CAN when it has left the domain the model knows.
#[derive(Debug, Parser)]
#[command(version, propagate_version = true, arg_required_else_help = true)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    Scene(SceneArgs),
}

/// Render labelled scenes of the road simulator
///
/// Each scene is one moment of a drive of its own. DIR gets frames/NNNNNN.png (RGB), masks/NNNNNN.png (255 on a lane
/// line) and scenes.jsonl (seed, time and conditions of each).
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  gapwatch scene --out scenes --count 100 --seed 7 --condition fog:3")]
pub struct SceneArgs {
    /// Folder to write; must not exist or be empty
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// How many scenes
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub count: u32,
    /// Seed of the set
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u32,
    /// Condition over all scenes, KIND:SEVERITY; may be repeated
    #[arg(long, value_name = "KIND:SEVERITY")]
    pub condition: Vec<Condition>,
    /// Size of the pictures, pixels
    #[arg(long, value_name = "WxH", default_value = "320x160")]
    pub size: PictureSize,
}

/// A picture's size as typed, `WxH`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PictureSize {
    pub width: u32,
    pub height: u32,
}

impl std::str::FromStr for PictureSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |side: &str| side.parse().ok().filter(|s| (16..=8_192).contains(s));
        text.split_once('x')
            .and_then(|(width, height)| Some(Self { width: side(width)?, height: side(height)? }))
            .ok_or_else(|| "wanted WIDTHxHEIGHT, each from 16 to 8192, for example 320x160".to_owned())
    }
}
