//! The command that makes a reference again.

use gapwatch::calibration::Target;
use gapwatch::capture::ranges;
use gapwatch::files::shell::quoted;
use gapwatch::model::preprocess::CROP_NOTHING;
use gapwatch::model::{ModelOptions, ModelSpec};
use gapwatch::reference::JudgedRate;

use super::{ACCEPTED, CalibrationPlan};

impl CalibrationPlan {
    /// A command that adds the accepted roads to a reference again; `base` is what was typed for it.
    pub(super) fn command_on(&self, base: &str) -> anyhow::Result<String> {
        let mut words = words(&["gapwatch", "calibrate", "--base"]);
        words.push(quoted(base));
        self.add_accepted(&mut words);
        self.add_model(&mut words)?;
        words.extend(self::words(&["--out", "reference.json"]));
        Ok(words.join(" "))
    }

    /// A command that makes the reference again. It does not depend on what was typed, so it has no names of files on
    /// one machine.
    pub(super) fn command(&self, rate: JudgedRate) -> anyhow::Result<String> {
        let mut words = words(&["gapwatch", "calibrate"]);
        add_to(&mut words, "--sim", &ranges(&self.simulation));
        self.add_accepted(&mut words);
        let mut add = |flag: &str, values: &[String]| {
            add_to(&mut words, flag, values);
        };
        add("--held-out", &ranges(&self.held_out));
        add("--labelled", &ranges(&self.labelled));
        add("--causes", &ranges(&self.causes));
        let Target {
            metric,
            window_s,
            false_alarms_per_hour,
            evidence,
            rate: _,
        } = self.wanted;
        add(
            "--false-alarms-per-hour",
            &[false_alarms_per_hour.to_string()],
        );
        add("--metric", &[metric.to_string()]);
        add("--window", &[window_s.to_string()]);
        add("--evidence", &[evidence.to_string()]);
        add("--rate", &[rate.rate_hz.to_string()]);
        add("--idle-rate", &[rate.idle_rate_hz.to_string()]);
        self.add_model(&mut words)?;
        add_to(&mut words, "--out", &["reference.json".to_owned()]);
        Ok(words.join(" "))
    }

    /// Adds the options of a model that is not the built-in one.
    fn add_model(&self, words: &mut Vec<String>) -> anyhow::Result<()> {
        let mut add = |flag: &str, values: &[String]| add_to(words, flag, values);
        let built_in = ModelSpec::new(None, ModelOptions::default())?;
        let of = &self.model.preprocessing;
        if self.model.name != built_in.name {
            add("--model", std::slice::from_ref(&self.model.name));
        }
        if self.model.name != built_in.name
            || self.model.taps != built_in.taps
            || *of != built_in.preprocessing
        {
            add("--taps", &[self.model.taps.join(",")]);
            add("--size", &[format!("{}x{}", of.width, of.height)]);
            add("--mean", &[comma_separated(&of.mean)]);
            add("--std", &[comma_separated(&of.std)]);
            if of.crop != CROP_NOTHING {
                add("--crop", &[comma_separated(&of.crop)]);
            }
        }
        Ok(())
    }

    fn add_accepted(&self, words: &mut Vec<String>) {
        for (name, drives) in &self.accepted {
            if name == ACCEPTED {
                words.push("--accept".to_owned());
                words.extend(ranges(drives).iter().map(|drive| quoted(drive)));
            } else {
                let named = ranges(drives);
                let named = named.iter().map(|drive| quoted(&format!("{name}={drive}")));
                words.push("--accept-as".to_owned());
                words.extend(named);
            }
        }
    }
}

fn comma_separated<T: ToString>(values: &[T]) -> String {
    let values: Vec<String> = values.iter().map(ToString::to_string).collect();
    values.join(",")
}

fn words(of: &[&str]) -> Vec<String> {
    of.iter().map(|&word| word.to_owned()).collect()
}

/// Adds an option and its values to a command.
fn add_to(words: &mut Vec<String>, flag: &str, values: &[String]) {
    if !values.is_empty() {
        words.push(flag.to_owned());
        words.extend(values.iter().map(|value| quoted(value)));
    }
}
