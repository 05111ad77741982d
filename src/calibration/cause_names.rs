//! Names of drives with a known cause: `…condition=KIND:SEVERITY@FROM-TO`.

use crate::reference::cause::Cause;

/// Severities under which a plain source is seen.
const SEVERITIES: std::ops::RangeInclusive<u8> = 3..=5;
/// When a condition reaches its severity and when it is gone, seconds: it grows for 2 s before, after a past that is
/// long enough for a change, and stays to the end of the drive.
const SPAN_S: (u32, u32) = (28, 90);
/// Length of a rendered drive, seconds, if its name has none: long enough for all that is learnt after the onset.
const SECONDS: u32 = 40;
const CONDITION: &str = "condition=";

/// What the name of a drive says of its cause.
#[derive(Clone, Debug, PartialEq)]
pub struct CauseName {
    /// The kind of its condition.
    pub cause: Cause,
    /// When the condition has reached its severity, seconds.
    pub onset_s: f64,
    /// The name without the condition: the same road.
    pub road: String,
}

/// The drives that a source for causes means. A source without a condition stands for itself under every kind of
/// condition that can be rendered over it, at several severities; another source for itself.
pub fn with_conditions(name: &str) -> Vec<String> {
    if conditions(name).next().is_some() {
        return vec![name.to_owned()];
    }
    let rendered = name.starts_with("scene:");
    let kinds = Cause::ALL.into_iter().filter(|&cause| match cause {
        Cause::AnotherRoad | Cause::Other => false,
        // A tunnel cannot be laid over a picture.
        Cause::Tunnel => rendered,
        _ => true,
    });
    let has_options = match rendered {
        true => name.contains('?'),
        false => ["?fps=", "?topic=", "?seed="]
            .iter()
            .any(|option| name.contains(option)),
    };
    let mut plain = name.to_owned();
    plain.push(if has_options { '&' } else { '?' });
    if rendered && !plain.contains("seconds=") {
        plain += &format!("seconds={SECONDS}&");
    }
    let (from, to) = SPAN_S;
    kinds
        .flat_map(|kind| SEVERITIES.map(move |severity| (kind, severity)))
        .map(|(kind, severity)| format!("{plain}{CONDITION}{kind}:{severity}@{from}-{to}"))
        .collect()
}

/// Reads the cause from the name of a drive.
///
/// # Errors
/// In words, when the name does not have exactly one condition, of a known kind and with an onset.
pub fn cause_of(name: &str) -> Result<CauseName, String> {
    let wanted =
        || format!("{name}: wanted one {CONDITION}KIND:SEVERITY@FROM-TO in a source for causes");
    let mut found = conditions(name);
    let (Some((at, value)), None) = (found.next(), found.next()) else {
        return Err(wanted());
    };
    let (kind, rest) = value.split_once(':').ok_or_else(wanted)?;
    let cause = kind.parse().ok().filter(|&cause| cause_is_rendered(cause));
    let from = rest
        .split_once('@')
        .and_then(|(_, span)| span.split_once('-'));
    let onset_s = from.and_then(|(from, _)| from.parse().ok());
    let onset_s = onset_s.filter(|onset_s: &f64| onset_s.is_finite() && *onset_s >= 0.0);
    let before = name[..at].trim_end_matches(['&', '?']);
    let after = &name[at + CONDITION.len() + value.len()..];
    Ok(CauseName {
        cause: cause.ok_or_else(wanted)?,
        onset_s: onset_s.ok_or_else(wanted)?,
        road: format!("{before}{after}"),
    })
}

fn cause_is_rendered(cause: Cause) -> bool {
    !matches!(cause, Cause::AnotherRoad | Cause::Other)
}

/// Place and value of every condition in a name.
fn conditions(name: &str) -> impl Iterator<Item = (usize, &str)> {
    let option = |&at: &usize| name[..at].ends_with(['?', '&']);
    let places = name.match_indices(CONDITION).map(|(at, _)| at);
    places.filter(option).map(|at| {
        let value = &name[at + CONDITION.len()..];
        (at, value.split('&').next().unwrap_or(value))
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_plain_source_stands_for_every_condition() {
        let of_scene = with_conditions("scene:sim?seed=1..6&fps=2");
        assert_eq!(of_scene.len(), 30);
        assert_eq!(
            of_scene[0],
            "scene:sim?seed=1..6&fps=2&seconds=40&condition=fog:3@28-90"
        );
        assert!(of_scene.iter().any(|name| name.contains("tunnel:5@")));
        assert_eq!(
            with_conditions("scene:sim")[1],
            "scene:sim?seconds=40&condition=fog:4@28-90"
        );
        let longer = with_conditions("scene:sim?seconds=50");
        assert_eq!(longer[0], "scene:sim?seconds=50&condition=fog:3@28-90");
        // Over pictures there is no tunnel.
        let of_folder = with_conditions("town/");
        assert_eq!(of_folder.len(), 27);
        assert_eq!(of_folder[0], "town/?condition=fog:3@28-90");
        assert!(!of_folder.iter().any(|name| name.contains("tunnel")));
        assert_eq!(
            with_conditions("town?fps=4")[26],
            "town?fps=4&condition=askew:5@28-90"
        );
        let own = "town?fps=4&condition=fog:4@30-60";
        assert_eq!(with_conditions(own), [own]);
    }

    #[test]
    fn the_cause_and_its_onset_are_read_from_the_name() {
        for name in with_conditions("scene:sim?seed=3") {
            let of = cause_of(&name).unwrap();
            assert!(name.contains(&format!("={}:", of.cause)), "{name}");
            assert!((of.onset_s - 28.0).abs() < 1e-9);
            assert_eq!(of.road, "scene:sim?seed=3&seconds=40");
        }
        let of = cause_of("town?condition=glare:2@12.5-60&seed=4").unwrap();
        assert_eq!((of.cause, of.road.as_str()), (Cause::Glare, "town&seed=4"));
        assert!((of.onset_s - 12.5).abs() < 1e-9);
        for wrong in [
            "scene:sim",
            "scene:sim?condition=fog:3",
            "scene:sim?condition=other:3@28-90",
            "scene:sim?condition=another-road:3@28-90",
            "scene:sim?condition=mist:3@28-90",
            "scene:sim?condition=fog:3@x-90",
            "scene:sim?condition=fog@28-90",
            "scene:sim?condition=fog:3@28-90&condition=rain:3@28-90",
        ] {
            let said = cause_of(wrong).unwrap_err();
            assert!(
                said.contains(wrong) && said.contains("wanted one"),
                "{said}"
            );
        }
    }
}
