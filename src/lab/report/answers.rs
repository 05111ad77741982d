//! The three answers over the whole drive, and what to do about each.

use maud::{Markup, html};

use super::content::Report;
use super::table::Column::{Numbers, Words};
use super::table::head;
use super::text::{Number, Percent};
use crate::capture::is_rendered;
use crate::monitor::warn::{Answer, LANES_LOST};
use crate::record::journal::{About, Entry};
use crate::reference::Reference;
use crate::statistics::quantile::median;

/// A row for each answer that the journal has.
pub fn answers(report: &Report) -> Markup {
    let about = &report.about;
    html! {
        section {
            h2 { "Three answers" }
            div.wide { table #answers {
                (head(&[
                    Words("Question"), Numbers("Median"), Numbers("Largest"), Numbers("Beyond its threshold"),
                    Words("Raises the warning"), Words("What to do"),
                ]))
                tbody {
                    @for answer in Answer::ALL {
                        @let given = Given::of(report, answer);
                        @if let Some(given) = given {
                            tr {
                                th scope="row" { (question(answer)) }
                                td.n { (shown(answer, given.median)) }
                                td.n { (shown(answer, given.largest)) }
                                td.n { (Percent(Some(given.beyond))) }
                                td { (raises(about, answer)) }
                                td { (to_do(about, answer, given.beyond)) }
                            }
                        }
                    }
                }
            } }
        }
    }
}

/// The note of a run with a reference that is made of simulation alone, on a road that is no simulation.
pub fn strict_note(about: &About) -> Option<String> {
    (about.strict && !is_rendered(&about.source)).then(|| {
        format!(
            "The reference {} knows simulation alone, so any real road is a gap to it.{}",
            about.reference,
            accepting(about).map_or_else(String::new, |command| format!(
                " This command makes a reference that accepts this road: {command}"
            ))
        )
    })
}

/// The command that accepts the road, if there is one: a camera cannot be accepted, only what was recorded of it.
fn accepting(about: &About) -> Option<String> {
    let can = about.metric == "mahalanobis" && !about.source.is_empty();
    let road = if about.live { "ROAD" } else { &about.source };
    can.then(|| Reference::accepting_command(&about.reference, road))
}

fn question(answer: Answer) -> &'static str {
    match answer {
        Answer::Gap => "Gap: has the road left the domain that the model knows?",
        Answer::Change => "Change: has the road just changed?",
        Answer::Lanes => "Lanes: what share of its lanes will the model lose?",
    }
}

fn raises(about: &About, answer: Answer) -> &'static str {
    let names = about.warn.split(", ");
    match names.into_iter().any(|name| name == answer.name()) {
        true => "yes",
        false => "no",
    }
}

fn to_do(about: &About, answer: Answer, beyond: f64) -> String {
    if beyond <= 0.0 {
        return "Nothing.".to_owned();
    }
    match answer {
        Answer::Gap => match accepting(about) {
            Some(command) => {
                format!("Look at the alarms. If the road is one that you drive on, accept it: {command}")
            }
            None => "Look at the alarms. If the road is one that you drive on, accept it.".to_owned(),
        },
        Answer::Change => "Look at the likely causes: clean a dirty lens, set a camera back, and do not rely on the lane model \
                           in the weather that they name."
            .to_owned(),
        Answer::Lanes => "Do not rely on the lane model there, and train it for such roads.".to_owned(),
    }
}

/// What an answer was over the drive.
struct Given {
    median: f64,
    largest: f64,
    /// Share of the lines with this answer in which it is beyond its threshold.
    beyond: f64,
}

impl Given {
    /// `None` if no line has this answer.
    fn of(report: &Report, answer: Answer) -> Option<Self> {
        let of = |entry: &Entry| match answer {
            Answer::Gap => entry.gap,
            Answer::Change => entry.change,
            Answer::Lanes => entry.lanes,
        };
        let threshold = match answer {
            Answer::Gap | Answer::Change => 1.0,
            Answer::Lanes => LANES_LOST,
        };
        let values: Vec<f64> = report.entries.iter().filter_map(of).collect();
        let beyond = values.iter().filter(|&&value| value >= threshold).count();
        #[allow(clippy::cast_precision_loss)]
        let beyond = beyond as f64 / values.len().max(1) as f64;
        Some(Self {
            largest: values.iter().copied().max_by(f64::total_cmp)?,
            median: median(values)?,
            beyond,
        })
    }
}

fn shown(answer: Answer, value: f64) -> Markup {
    match answer {
        Answer::Lanes => html! { (Percent(Some(value))) },
        Answer::Gap | Answer::Change => html! { (Number(Some(value), 2)) },
    }
}
