//! Values that several commands take, and how they are read.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;

use clap::ValueEnum;
use gapwatch::reference::{WINDOW_S_MAX, WINDOW_S_MIN};

/// Sources of every build, for the help.
macro_rules! sources {
    ($before:literal, $after:literal) => {
        concat!(
            "Sources (put them in quotes, because shells interpret ? and &):\n",
            $before,
            "  random:[seed=1&frames=60]
      random pixels
  DIR[?fps=10]
      folder of PNG or JPEG images in the order of their names, 10 a second unless ?fps= is given
  FILE[?fps=20]
      one image, or a video (through ffmpeg); ?fps= is for raw streams (.h264, .hevc, .mjpeg), which have no times\n",
            $after
        )
    };
}

/// How sources are named, for the help of every command that takes a source.
#[cfg(feature = "lab")]
pub const SOURCES: &str = sources!(
    "  scene:sim[?seed=7&seconds=60&fps=10&condition=fog:3@20-40]
      rendered drive; the fog has severity 3 at 20 s and is gone at 40 s;
      also size=WxH, stretch=M, unlit=1, without=ELEMENT, and the looks sim-realistic and game\n",
    "  FILE.mcap[?topic=/camera]
      recording with images of ROS 2 or Foxglove, or the folder of one in parts: the topic that
      ?topic= names, or its only topic with images
  DIR or FILE and ?condition=fog:3@20-40
      the same under a rendered condition (DIR?fps=10&condition=...)"
);
/// The same, of the car's program.
#[cfg(not(feature = "lab"))]
pub const SOURCES: &str = sources!(
    "",
    "This build has no rendered drives (scene:) and reads no MCAP recordings; a build with --features lab does."
);

/// How a measurement is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TableFormat {
    Table,
    Json,
}

pub fn numbers<T: FromStr, const N: usize>(text: &str) -> Result<[T; N], String> {
    let numbers: Option<Vec<T>> = text
        .split(',')
        .map(|number| number.trim().parse().ok())
        .collect();
    numbers
        .and_then(|numbers| numbers.try_into().ok())
        .ok_or_else(|| format!("wanted {N} numbers, separated by commas"))
}

pub fn seconds(text: &str) -> Result<f64, String> {
    let range = WINDOW_S_MIN..=WINDOW_S_MAX;
    let seconds = text.parse().ok().filter(|s| range.contains(s));
    seconds.ok_or_else(|| format!("wanted seconds from {WINDOW_S_MIN} to {WINDOW_S_MAX}"))
}

pub fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|r| (1e-6..=3_600.0).contains(r));
    rate.ok_or_else(|| "wanted entries an hour from 0.000001 to 3600".to_owned())
}

pub fn frames_a_second(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|r| (0.1..=240.0).contains(r));
    rate.ok_or_else(|| "wanted frames a second from 0.1 to 240".to_owned())
}

/// Parses a name and what it stands for.
pub fn named(text: &str) -> Result<(String, String), String> {
    let parts = text.split_once('=');
    let parts = parts.filter(|(name, what)| !name.is_empty() && !what.is_empty());
    let (name, what) = parts.ok_or("wanted NAME=SOURCE")?;
    Ok((name.to_owned(), what.to_owned()))
}

/// Parses a whole number in a range; the error says what was wanted.
pub fn whole<T>(
    range: RangeInclusive<T>,
) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync
where
    T: FromStr + PartialOrd + Display + Clone + Send + Sync + 'static,
{
    move |text| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        number.ok_or_else(|| {
            format!(
                "wanted a whole number from {} to {}",
                range.start(),
                range.end()
            )
        })
    }
}
