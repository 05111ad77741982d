//! The page itself: what stands still as HTML, the numbers as JSON for the script that draws them.

use base64::display::Base64Display;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use sha2::{Digest, Sha256};

use super::alarms::alarms;
use super::answers::answers;
use super::calibration::calibration;
use super::content::Report;
use super::data::data;
use super::judged::judged;
use super::summary::{header, tiles};
use super::text::Plain;
use super::timeline::timeline;

const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

impl Report {
    /// The page, for a journal of that name.
    pub fn page(&self, name: &str) -> String {
        let parts = [
            header(self, name),
            tiles(self),
            answers(self),
            timeline(self),
            alarms(self),
            judged(self),
        ];
        let page = html! {
            (DOCTYPE) "\n"
            html lang="en" {
                (head(name))
                body {
                    main {
                        "\n"
                        @for part in parts { (part) "\n" }
                        @if !self.about.reference.is_empty() { (calibration(&self.about)) "\n" }
                        footer {
                            "Gap is how far the road is from the nearest nominal domain: 0 is the median of nominal drives, \
                            1 the alarm threshold. Change is how far the road differs from its own past, on the same \
                            scale. Lanes lost is a forecast of the share of lanes \
                            that the lane model loses. Made by gapwatch "
                            (env!("CARGO_PKG_VERSION")) "."
                        }
                    }
                    "\n"
                    script #data type="application/json" { (numbers(self)) }
                    "\n"
                    script { (PreEscaped(SCRIPT)) }
                }
            }
            "\n"
        };
        page.into_string()
    }
}

fn head(name: &str) -> Markup {
    let hash = Sha256::digest(SCRIPT);
    let policy = format!(
        "default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{}'; base-uri 'none'; \
        form-action 'none'",
        Base64Display::new(&hash, &STANDARD)
    );
    html! {
        head {
            meta charset="utf-8";
            meta http-equiv="Content-Security-Policy" content=(policy);
            meta name="viewport" content="width=device-width, initial-scale=1";
            meta name="color-scheme" content="light dark";
            link rel="icon" href="data:,";
            title { "gapwatch report: " (Plain(name)) }
            "\n"
            style { "\n" (PreEscaped(STYLE)) }
        }
    }
}

/// The numbers as JSON inside of a script, where text is not escaped as elsewhere.
fn numbers(report: &Report) -> Markup {
    let json = serde_json::to_string(&data(report)).unwrap_or_default();
    // These stand only inside strings, where the escape means the same.
    PreEscaped(json.replace('<', "\\u003c").replace('&', "\\u0026"))
}
