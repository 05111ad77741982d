//! Profiles as drawings that stand in the page: no script, so they print.

use maud::{Markup, html};

use super::text::Text;
use crate::features::energies::{CELLS, GRID};
use crate::monitor::profile::{ProfileKind, TapProfile};

/// Size of a chart, units of its own.
const WIDE: f64 = 320.0;
const HIGH: f64 = 110.0;
/// Side of a cell of the grid of regions.
const CELL: usize = 44;

/// Draws a tap's profile.
pub fn profile(profile: &TapProfile) -> Markup {
    let (caption, drawing) = match profile.kind {
        ProfileKind::Histogram => histogram(profile),
        ProfileKind::Energies => energies(profile),
    };
    html! {
        figure {
            figcaption { strong { (Text(&profile.tap)) } " " (caption) }
            (drawing)
        }
    }
}

/// Bars of the window over the steps of the reference.
fn histogram(profile: &TapProfile) -> (String, Markup) {
    let TapProfile { live, nominal, .. } = profile;
    let apart = live
        .iter()
        .zip(nominal)
        .map(|(live, nominal)| (live - nominal).abs());
    let caption = format!(
        "{:.0} % of the pixels in other bins than nominal. Bars: this window; line: the reference, of the {} counted bins.",
        50.0 * apart.sum::<f64>(),
        live.len()
    );
    let top = live.iter().chain(nominal).copied().fold(1e-12, f64::max);
    let step = WIDE / count(live.len());
    let y = |share: f64| HIGH - (HIGH - 4.0) * share / top;
    let bars = html! {
        @for (place, &share) in live.iter().enumerate() {
            (bar("live", (step * count(place), y(share)), (0.86 * step, HIGH - y(share))))
        }
        path.nominal d={
            @for (place, &share) in nominal.iter().enumerate() {
                (if place == 0 { 'M' } else { 'L' })
                (format_args!("{:.1} {:.1}h{step:.2}", step * count(place), y(share)))
            }
        } {}
    };
    let what = "Histogram of the window over the reference";
    (caption, drawing(what, &bars))
}

/// Deviations of the channels as bars, and of the cells as a grid that lies like the picture.
fn energies(profile: &TapProfile) -> (String, Markup) {
    let channels = profile.channel_deviations();
    let shares = profile.cell_shares();
    let farthest = channels
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    let mut caption = farthest.map_or(String::new(), |(channel, deviation)| {
        format!(
            "Farthest is channel {channel}, {deviation:+.1} spreads from nominal. Bars: log energy of the {} channels in nominal \
            spreads; band: two spreads.",
            channels.len()
        )
    });
    if shares.is_some() {
        caption += " Grid: which part of the picture differs, in %.";
    }
    let reach = channels
        .iter()
        .fold(4.0, |reach: f64, d| reach.max(d.abs()));
    let y = |deviation: f64| HIGH * (0.5 - 0.48 * deviation / reach);
    let step = WIDE / count(channels.len().max(1));
    let bars = html! {
        (bar("band", (0.0, y(2.0)), (WIDE, y(-2.0) - y(2.0))))
        @for (place, &deviation) in channels.iter().enumerate() {
            @let (from, to) = (y(deviation.max(0.0)), y(deviation.min(0.0)));
            (bar("live", (step * count(place), from), (0.8 * step, to - from)))
        }
    };
    let drawings = html! {
        (drawing("Deviation of each channel from nominal, in spreads", &bars))
        @if let Some(shares) = shares { (grid(&shares)) }
    };
    (caption, drawings)
}

fn grid(shares: &[f64; CELLS]) -> Markup {
    let side = CELL * GRID;
    let largest = shares.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    html! {
        svg.regions viewBox=(format_args!("0 0 {side} {}", side / 2)) role="img" aria-label={
            "Share of the difference by region, row by row:"
            @for share in shares { (format_args!(" {:.0} %", 100.0 * share)) }
        } {
            @for (place, share) in shares.iter().enumerate() {
                @let (x, y) = (place % GRID * CELL, place / GRID * CELL / 2);
                @let opacity = 0.08 + 0.72 * share / largest;
                rect.live x=(x) y=(y) width=(CELL - 2) height=(CELL / 2 - 2) style=(format_args!("opacity:{opacity:.2}")) {}
                text x=(x + CELL / 2 - 1) y=(y + 15) text-anchor="middle" { (format_args!("{:.0}", 100.0 * share)) }
            }
        }
    }
}

fn drawing(what: &str, inside: &Markup) -> Markup {
    html! {
        svg.profile viewBox=(format_args!("0 0 {WIDE} {HIGH}")) preserveAspectRatio="none" role="img" aria-label=(what) {
            (inside)
        }
    }
}

fn bar(class: &str, (x, y): (f64, f64), (wide, high): (f64, f64)) -> Markup {
    let short = |number: f64| format!("{number:.1}");
    html! {
        rect.(class) x=(short(x)) y=(short(y)) width=(format_args!("{wide:.2}")) height=(short(high.max(0.0))) {}
    }
}

/// Places in a profile are far below 2^52.
#[allow(clippy::cast_precision_loss)]
fn count(places: usize) -> f64 {
    places as f64
}
