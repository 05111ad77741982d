//! Profiles as drawings that stand in the page: no script, so they print.

use std::fmt::{self, Write};

use super::text::Text;
use crate::features::energies::{CELLS, GRID};
use crate::monitor::profile::{ProfileKind, TapProfile};

/// Size of a chart, units of its own.
const WIDE: f64 = 320.0;
const HIGH: f64 = 110.0;
/// Side of a cell of the grid of regions.
const CELL: usize = 44;

/// Draws a tap's profile.
pub fn profile(profile: &TapProfile, out: &mut String) -> fmt::Result {
    write!(
        out,
        "<figure><figcaption><strong>{}</strong> ",
        Text(&profile.tap)
    )?;
    match profile.kind {
        ProfileKind::Histogram => histogram(profile, out)?,
        ProfileKind::Energies => energies(profile, out)?,
    }
    out.write_str("</figure>")
}

/// Bars of the window over the steps of the reference.
fn histogram(profile: &TapProfile, out: &mut String) -> fmt::Result {
    let TapProfile { live, nominal, .. } = profile;
    let apart = live
        .iter()
        .zip(nominal)
        .map(|(live, nominal)| (live - nominal).abs());
    let moved = 50.0 * apart.sum::<f64>();
    write!(
        out,
        "{moved:.0} % of the pixels in other bins than nominal. Bars: this window; line: the reference, of the {} counted bins.\
        </figcaption>",
        live.len()
    )?;
    let top = live.iter().chain(nominal).copied().fold(1e-12, f64::max);
    let step = WIDE / count(live.len());
    let y = |share: f64| HIGH - (HIGH - 4.0) * share / top;
    begin(HIGH, "Histogram of the window over the reference", out)?;
    for (place, &share) in live.iter().enumerate() {
        let x = step * count(place);
        bar("live", (x, y(share)), (0.86 * step, HIGH - y(share)), out)?;
    }
    out.write_str("<path class=\"nominal\" d=\"")?;
    for (place, &share) in nominal.iter().enumerate() {
        let (x, y) = (step * count(place), y(share));
        let letter = if place == 0 { 'M' } else { 'L' };
        write!(out, "{letter}{x:.1} {y:.1}h{step:.2}")?;
    }
    out.write_str("\"/></svg>")
}

/// Deviations of the channels as bars, and of the cells as a grid that lies like the picture.
fn energies(profile: &TapProfile, out: &mut String) -> fmt::Result {
    let channels = profile.channel_deviations();
    let farthest = channels
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    if let Some((channel, deviation)) = farthest {
        write!(
            out,
            "Farthest is channel {channel}, {deviation:+.1} spreads from nominal. Bars: log energy of the {} channels in nominal \
            spreads; band: two spreads.",
            channels.len()
        )?;
    }
    let shares = profile.cell_shares();
    if shares.is_some() {
        out.write_str(" Grid: which part of the picture differs, in %.")?;
    }
    out.write_str("</figcaption>")?;
    let reach = channels
        .iter()
        .fold(4.0, |reach: f64, d| reach.max(d.abs()));
    let y = |deviation: f64| HIGH * (0.5 - 0.48 * deviation / reach);
    begin(
        HIGH,
        "Deviation of each channel from nominal, in spreads",
        out,
    )?;
    bar("band", (0.0, y(2.0)), (WIDE, y(-2.0) - y(2.0)), out)?;
    let step = WIDE / count(channels.len().max(1));
    for (place, &deviation) in channels.iter().enumerate() {
        let (from, to) = (y(deviation.max(0.0)), y(deviation.min(0.0)));
        bar(
            "live",
            (step * count(place), from),
            (0.8 * step, to - from),
            out,
        )?;
    }
    out.write_str("</svg>")?;
    if let Some(shares) = shares {
        grid(&shares, out)?;
    }
    Ok(())
}

fn grid(shares: &[f64; CELLS], out: &mut String) -> fmt::Result {
    let side = CELL * GRID;
    write!(
        out,
        "<svg class=\"regions\" viewBox=\"0 0 {side} {}\" role=\"img\" aria-label=\"Share of the difference by region, row by row:",
        side / 2
    )?;
    for share in shares {
        write!(out, " {:.0} %", 100.0 * share)?;
    }
    out.write_str("\">")?;
    let largest = shares.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    for (place, share) in shares.iter().enumerate() {
        let (x, y) = (place % GRID * CELL, place / GRID * CELL / 2);
        write!(
            out,
            "<rect x=\"{x}\" y=\"{y}\" width=\"{}\" height=\"{}\" class=\"live\" style=\"opacity:{:.2}\"/>\
            <text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{:.0}</text>",
            CELL - 2,
            CELL / 2 - 2,
            0.08 + 0.72 * share / largest,
            x + CELL / 2 - 1,
            y + 15,
            100.0 * share
        )?;
    }
    out.write_str("</svg>")
}

fn begin(high: f64, what: &str, out: &mut String) -> fmt::Result {
    write!(
        out,
        "<svg class=\"profile\" viewBox=\"0 0 {WIDE} {high}\" preserveAspectRatio=\"none\" role=\"img\" aria-label=\"{what}\">"
    )
}

fn bar(class: &str, (x, y): (f64, f64), (wide, high): (f64, f64), out: &mut String) -> fmt::Result {
    write!(
        out,
        "<rect class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{wide:.2}\" height=\"{:.1}\"/>",
        high.max(0.0)
    )
}

/// Places in a profile are far below 2^52.
#[allow(clippy::cast_precision_loss)]
fn count(places: usize) -> f64 {
    places as f64
}
