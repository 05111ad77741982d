//! Conditions that take a drive out of the nominal domain, and what each severity means.
//!
//! Severity is a number from 0 (none) to 5, which may have a fraction. Physical quantities are interpolated between the
//! whole severities of the tables below.

use std::fmt;
use std::str::FromStr;

/// Seconds in which a scheduled condition grows to its severity, and in which it fades.
pub const RAMP_S: f64 = 2.0;

/// Kinds of condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConditionKind {
    /// Scattering in the air; severity is visibility.
    Fog,
    /// There is less daylight, headlights are on, and the sensor's gain and noise rise.
    Night,
    /// Streaks, a wet road that mirrors the sky, drops on the lens, and haze.
    Rain,
    /// A lens out of focus.
    Blur,
    /// Sensor noise.
    Noise,
    /// A low sun in the picture, with veil and bloom.
    Glare,
    /// Dirt on the lens.
    Dirt,
    /// Snow on the ground and in the air.
    Snow,
    /// A tunnel over the part of the road that is driven in the span of the condition; severity is darkness.
    Tunnel,
    /// A camera out of its place: rolled, turned and tipped.
    Askew,
}

impl ConditionKind {
    /// All kinds, in the order in which they are applied.
    pub const ALL: [Self; 10] = [
        Self::Askew,
        Self::Tunnel,
        Self::Snow,
        Self::Night,
        Self::Rain,
        Self::Fog,
        Self::Glare,
        Self::Dirt,
        Self::Blur,
        Self::Noise,
    ];

    /// The word a user types.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fog => "fog",
            Self::Night => "night",
            Self::Rain => "rain",
            Self::Blur => "blur",
            Self::Noise => "noise",
            Self::Glare => "glare",
            Self::Dirt => "dirt",
            Self::Snow => "snow",
            Self::Tunnel => "tunnel",
            Self::Askew => "askew",
        }
    }
}

/// Severities at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Severities([f32; ConditionKind::ALL.len()]);

impl Severities {
    /// The severity of one kind, 0 to 5.
    pub fn of(&self, kind: ConditionKind) -> f32 {
        self.0[kind as usize]
    }
}

/// A quantity by severity, linear between whole severities; the first entry is severity 0.
pub fn graded(table: [f32; 6], severity: f32) -> f32 {
    let at = severity.clamp(0.0, 5.0);
    let low = (at as usize).min(4);
    table[low] + (table[low + 1] - table[low]) * (at - low as f32)
}

/// Extinction of fog, 1/m: 3.912 / visibility (Koschmieder), visibility 500, 220, 110, 60, 30 m.
pub const FOG_EXTINCTION: [f32; 6] = [0.0, 0.0078, 0.0178, 0.0356, 0.0652, 0.1304];
/// Share of daylight at night: from dusk to a country road without lights.
pub const NIGHT_DAYLIGHT: [f32; 6] = [1.0, 0.40, 0.16, 0.06, 0.02, 0.004];
/// Number of rain streaks in a picture that is 320 pixels wide.
pub const RAIN_STREAKS: [f32; 6] = [0.0, 60.0, 140.0, 260.0, 420.0, 650.0];
/// Extinction of rain haze, 1/m.
pub const RAIN_EXTINCTION: [f32; 6] = [0.0, 0.0015, 0.004, 0.008, 0.014, 0.024];
/// Share of the road's light that is mirrored sky in rain.
pub const RAIN_MIRROR: [f32; 6] = [0.0, 0.15, 0.3, 0.45, 0.6, 0.72];
/// Number of drops on the lens.
pub const RAIN_DROPS: [f32; 6] = [0.0, 3.0, 8.0, 16.0, 28.0, 45.0];
/// Standard deviation of the blur, as a share of the picture's width (1 pixel of 320 is 0.0031).
pub const BLUR_SIGMA: [f32; 6] = [0.0, 0.0022, 0.0041, 0.0066, 0.0105, 0.0165];
/// Standard deviation of sensor noise, 8-bit steps.
pub const NOISE_SIGMA: [f32; 6] = [0.0, 5.0, 10.0, 18.0, 30.0, 48.0];
/// Light of the glare's veil over the whole picture, 1 = white.
pub const GLARE_VEIL: [f32; 6] = [0.0, 0.06, 0.14, 0.26, 0.42, 0.65];
/// Share of the lens under dirt.
pub const DIRT_COVER: [f32; 6] = [0.0, 0.05, 0.10, 0.18, 0.28, 0.42];

/// Share of the verge under snow.
pub const SNOW_VERGE: [f32; 6] = [0.0, 0.40, 0.80, 1.0, 1.0, 1.0];
/// Share of the road under snow; wheel tracks disappear last.
pub const SNOW_ROAD: [f32; 6] = [0.0, 0.03, 0.15, 0.35, 0.65, 0.95];
/// Number of flakes in a picture that is 320 pixels wide.
pub const SNOW_FLAKES: [f32; 6] = [0.0, 40.0, 90.0, 160.0, 260.0, 400.0];
/// Extinction of falling snow, 1/m.
pub const SNOW_EXTINCTION: [f32; 6] = [0.0, 0.001, 0.003, 0.006, 0.012, 0.022];
/// Light in a tunnel as a share of daylight: from a brightly lit tunnel to one without lamps.
pub const TUNNEL_LIGHT: [f32; 6] = [1.0, 0.35, 0.18, 0.09, 0.04, 0.012];
/// Roll of a camera out of its place, degrees; it is turned by half of this angle and tipped by a third.
pub const ASKEW_ROLL_DEG: [f32; 6] = [0.0, 1.5, 3.0, 5.0, 8.0, 12.0];

/// A condition over the time of a drive, as in `fog:3` or `fog:3@20-40`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Condition {
    /// Kind of the condition.
    pub kind: ConditionKind,
    /// Severity, 0 to 5.
    pub severity: f32,
    /// The severity is reached at the first time, and the condition is gone at the second time, seconds; `None` =
    /// always.
    pub span_s: Option<(f64, f64)>,
}

impl Condition {
    /// Severity at `t_s`: grows over `RAMP_S` before the span begins, and fades over the last `RAMP_S` of it.
    pub fn severity_at(&self, t_s: f64) -> f32 {
        let Some((full_s, gone_s)) = self.span_s else {
            return self.severity;
        };
        let grown = (t_s - (full_s - RAMP_S)) / RAMP_S;
        let left = (gone_s - t_s) / RAMP_S;
        self.severity * grown.min(left).clamp(0.0, 1.0) as f32
    }
}

/// Severities of a list of conditions at `t_s`. Of two conditions of the same kind, the worse one counts.
pub fn severities_at(conditions: &[Condition], t_s: f64) -> Severities {
    let mut severities = Severities::default();
    for condition in conditions {
        let slot = &mut severities.0[condition.kind as usize];
        *slot = slot.max(condition.severity_at(t_s));
    }
    severities
}

/// A condition that cannot be read. The caller reports what was found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("wanted KIND:SEVERITY or KIND:SEVERITY@FROM-TO, for example fog:3@20-40 ({wanted})")]
pub struct ConditionError {
    wanted: String,
}

impl FromStr for Condition {
    type Err = ConditionError;

    fn from_str(text: &str) -> Result<Self, ConditionError> {
        let error = |wanted: &str| ConditionError {
            wanted: wanted.to_owned(),
        };
        let (kind, rest) = text
            .split_once(':')
            .ok_or_else(|| error("there is no severity after ':'"))?;
        let kind = ConditionKind::ALL
            .into_iter()
            .find(|k| k.name() == kind)
            .ok_or_else(|| {
                error(&format!(
                    "the kinds are {}",
                    ConditionKind::ALL.map(ConditionKind::name).join(", ")
                ))
            })?;
        let (severity, span) = match rest.split_once('@') {
            Some((severity, span)) => (severity, Some(span)),
            None => (rest, None),
        };
        let severity: f32 = severity
            .parse()
            .map_err(|_| error("the severity is a number from 0 to 5"))?;
        if !(0.0..=5.0).contains(&severity) {
            return Err(error("the severity is a number from 0 to 5"));
        }
        let span_s = span
            .map(|span| {
                let (from, to) = span.split_once('-')?;
                let (from, to) = (from.parse::<f64>().ok()?, to.parse::<f64>().ok()?);
                (from.is_finite() && to.is_finite() && from >= 0.0 && to - from >= RAMP_S)
                    .then_some((from, to))
            })
            .map(|span| {
                span.ok_or_else(|| error("the span is FROM-TO in seconds, at least 2 s long"))
            })
            .transpose()?;
        Ok(Self {
            kind,
            severity,
            span_s,
        })
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.kind.name(), self.severity)?;
        match self.span_s {
            Some((from, to)) => write!(f, "@{from}-{to}"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    #[test]
    fn a_scheduled_condition_is_reached_and_gone_at_its_times() {
        let fog: Condition = "fog:3@20-40".parse().unwrap();
        assert_eq!(fog.severity_at(17.9), 0.0);
        assert_eq!(fog.severity_at(19.0), 1.5);
        assert_eq!(fog.severity_at(20.0), 3.0);
        assert_eq!(fog.severity_at(38.0), 3.0);
        assert_eq!(fog.severity_at(40.0), 0.0);
        assert_eq!(fog.to_string(), "fog:3@20-40");
    }

    #[test]
    fn wrong_conditions_are_refused_with_what_is_wanted() {
        for (text, part) in [
            ("fog", "no severity"),
            ("mist:3", "the kinds are askew, tunnel, snow, night"),
            ("fog:6", "0 to 5"),
            ("fog:NaN", "0 to 5"),
            ("fog:3@40-20", "at least 2 s long"),
            ("fog:3@x", "FROM-TO"),
        ] {
            let message = text.parse::<Condition>().unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }

    #[test]
    fn severities_between_table_entries_are_interpolated() {
        assert_eq!(graded(NOISE_SIGMA, 0.0), 0.0);
        assert_eq!(graded(NOISE_SIGMA, 5.0), 48.0);
        assert_eq!(graded(NOISE_SIGMA, 1.5), 7.5);
    }
}
