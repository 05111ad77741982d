//! The reference and the model that the run was made with.

use maud::{Markup, html};

use super::text::Text;
use crate::record::journal::About;

/// A list of what is known of them.
pub fn calibration(about: &About) -> Markup {
    let window = format!("{} s", about.window_s);
    let made_of = if about.strict {
        "simulation alone: any real road is a gap to it"
    } else {
        "simulation and accepted drives"
    };
    let list = [
        ("Reference", about.reference.as_str()),
        ("Made of", made_of),
        ("Warns of", &about.warn),
        ("Metric", &about.metric),
        ("Window", &window),
        ("Thresholds", &about.thresholds),
        ("False alarms", &about.false_alarms),
        ("Made by", &about.calibrated_by),
        ("Model", &about.model),
        ("SHA-256 of the model", &about.model_sha256),
        ("Run with gapwatch", &about.gapwatch),
    ];
    html! {
        section {
            h2 { "Calibration" }
            dl {
                @for (what, text) in list {
                    @if !text.is_empty() { dt { (what) } dd { (Text(text)) } }
                }
            }
        }
    }
}
