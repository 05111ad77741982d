//! The table of alarms, suspicions and outages.

use maud::{Markup, html};

use super::behind::behind;
use super::content::{Alarm, Report};
use super::states::badge;
use super::table::Column::{Numbers, Words};
use super::table::head;
use super::text::{Number, Percent, Text};

/// Most alarms in the table.
pub const ALARMS_MAX: usize = 500;

/// A row for each alarm, and one to open with what is behind it.
pub fn alarms(report: &Report) -> Markup {
    let alarms = report.alarms();
    html! {
        section {
            h2 { "Alarms, suspicions and outages" }
            @if alarms.is_empty() {
                p { "None." }
            } @else {
                p.hint { "Open one to see what is behind it." }
                div.wide { (table(report)) }
            }
            @if alarms.len() > ALARMS_MAX {
                p.hint { "The first " (ALARMS_MAX) " of " (alarms.len()) "." }
            }
        }
    }
}

fn table(report: &Report) -> Markup {
    let alarms = report.alarms().iter().take(ALARMS_MAX);
    html! {
        table #alarms {
            (head(&[
                Words("State"), Numbers("From"), Numbers("To"), Numbers("Lasted"), Numbers("Largest gap"),
                Numbers("Largest change"), Numbers("Lanes lost"), Words("Likely cause"), Words("Tap that led"),
                Words("Reason"),
            ]))
            tbody {
                @for (place, alarm) in alarms.enumerate() {
                    @let number = place + 1;
                    @let id = format!("alarm-{number}");
                    tr.alarm data-alarm=(number) {
                        td {
                            button.opens type="button" aria-expanded="false" aria-controls=(id) {
                                span.number { (number) } " " (badge(alarm.state))
                            }
                        }
                        (cells(report, alarm))
                    }
                    tr.behind #(id) hidden {
                        td colspan="10" { (behind(report, alarm, report.shown.get(&place))) }
                    }
                }
            }
        }
    }
}

fn cells(report: &Report, alarm: &Alarm) -> Markup {
    let Alarm { from_s, to_s, .. } = alarm;
    html! {
        td.n {
            (format_args!("{from_s:.1} s"))
            @if let Some(time) = report.time_of_day(*from_s) { br; (time) }
        }
        td.n { (format_args!("{to_s:.1} s")) @if alarm.open { " (end)" } }
        td.n { (format_args!("{:.1} s", to_s - from_s)) }
        td.n { (Number(alarm.gap_max, 2)) }
        td.n { (Number(alarm.change_max, 2)) }
        td.n { (Percent(alarm.lanes_max)) }
        td.likely { @if let Some(cause) = alarm.cause { (cause.to_string()) } @else { "–" } }
        td { @if let Some(tap) = &alarm.leader { (Text(tap)) } @else { "–" } }
        td { @if alarm.reasons.is_empty() { "–" } @else { (Text(&alarm.reasons.join(", "))) } }
    }
}
