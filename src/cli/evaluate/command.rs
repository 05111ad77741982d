//! The command that makes the results of a key again, on any machine.

use std::path::Path;

use gapwatch::lab::evaluation::{SCENE_SET, cause, domain_detection, false_alarms};
use gapwatch::lab::scene::Look;

use super::results::Made;
use super::{field_sets, lane_failure, paper_table, speed_error};
use crate::cli::args::{EvaluateArgs, EvaluateKey};

/// How the folder of image sets is named, wherever it is.
const FIELD: &str = "--field \"$GAPWATCH_FIELD\"";

/// How the results of a key are made.
pub fn made(key: EvaluateKey, args: &EvaluateArgs) -> Made {
    let seeds = match key {
        EvaluateKey::LaneIou => format!("scene set {SCENE_SET}"),
        EvaluateKey::DomainDetection => {
            format!("drives {} and on", domain_detection::FIRST_SEED)
        }
        EvaluateKey::FalseAlarms => format!("drives {} and on", false_alarms::FIRST_SEED),
        EvaluateKey::Cause => format!("drives {} and on", cause::FIRST_SEED),
        EvaluateKey::LaneFailure => lane_failure::seeds(args.quick),
        EvaluateKey::SpeedError => speed_error::seeds(args.quick),
        EvaluateKey::FieldSets => field_sets::seeds(args.quick),
        EvaluateKey::RealLanes => "none".to_owned(),
        EvaluateKey::PaperTable => paper_table::seeds(args.quick),
    };
    Made {
        command: command(key, args),
        gapwatch: env!("CARGO_PKG_VERSION").to_owned(),
        seeds,
    }
}

fn command(key: EvaluateKey, args: &EvaluateArgs) -> String {
    let mut words = vec![format!("gapwatch evaluate --only {}", key.name())];
    if !args.model.is_empty() {
        let models: Vec<String> = args.model.iter().map(|path| portable(path)).collect();
        words.push(format!("--model {}", models.join(" ")));
    }
    if args.quick {
        words.push("--quick".to_owned());
    }
    let number = |name: &str, value: Option<u32>| value.map(|value| format!("--{name} {value}"));
    words.extend(match key {
        EvaluateKey::LaneIou => number("scenes", args.scenes),
        EvaluateKey::DomainDetection | EvaluateKey::Cause => number("drives", args.drives),
        EvaluateKey::FalseAlarms => number("hours", args.hours),
        EvaluateKey::LaneFailure | EvaluateKey::SpeedError => None,
        EvaluateKey::FieldSets | EvaluateKey::RealLanes => Some(FIELD.to_owned()),
        EvaluateKey::PaperTable => args.field.as_ref().map(|_| FIELD.to_owned()),
    });
    if matches!(
        key,
        EvaluateKey::DomainDetection
            | EvaluateKey::FalseAlarms
            | EvaluateKey::Cause
            | EvaluateKey::RealLanes
    ) && let Some(path) = &args.reference
    {
        words.push(format!("--reference {}", portable(path)));
    }
    if matches!(
        key,
        EvaluateKey::DomainDetection | EvaluateKey::FalseAlarms | EvaluateKey::Cause
    ) {
        if key == EvaluateKey::DomainDetection && !args.also.is_empty() {
            let also: Vec<String> = args.also.iter().map(|path| portable(path)).collect();
            words.push(format!("--also {}", also.join(" ")));
        }
        if args.look != Look::Sim {
            words.push(format!("--look {}", args.look));
        }
        if args.stretch > 0 {
            words.push(format!("--stretch {}", args.stretch));
        }
        let fps = args.fps.filter(|_| key == EvaluateKey::FalseAlarms);
        words.extend(fps.map(|fps| format!("--fps {fps}")));
    }
    if let Some(path) = &args.out {
        words.push(format!("--out {}", portable(path)));
    }
    words.join(" ")
}

/// A path that means the same on another machine: as typed if it is below the working folder, otherwise its last part.
pub fn portable(path: &Path) -> String {
    let below = path.is_relative() && !path.starts_with("..");
    let part = path.file_name().map(Path::new).filter(|_| !below);
    part.unwrap_or(path).display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_of_one_machine_are_left_out() {
        let said = |path: &str| portable(Path::new(path));
        assert_eq!(said("calibration/sim.json"), "calibration/sim.json");
        assert_eq!(said("/home/me/r.json"), "r.json");
        assert_eq!(said("../r.json"), "r.json");
    }

    #[test]
    fn the_roads_and_the_rate_are_in_the_command() {
        let args = |words: &str| {
            use clap::Parser as _;
            #[derive(clap::Parser)]
            struct Typed {
                #[command(flatten)]
                args: EvaluateArgs,
            }
            Typed::parse_from(words.split(' ')).args
        };
        let args = args("evaluate --stretch 800 --fps 2 --hours 6 --drives 4 --also frames.json");
        assert_eq!(
            command(EvaluateKey::FalseAlarms, &args),
            "gapwatch evaluate --only false_alarms --hours 6 --stretch 800 --fps 2"
        );
        assert_eq!(
            command(EvaluateKey::Cause, &args),
            "gapwatch evaluate --only cause --drives 4 --stretch 800"
        );
        assert_eq!(
            command(EvaluateKey::DomainDetection, &args),
            "gapwatch evaluate --only domain_detection --drives 4 --also frames.json --stretch 800"
        );
    }
}
