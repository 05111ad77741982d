//! Identifiers and periods of the messages.

use std::time::Duration;

use embedded_can::Id;
use thiserror::Error;

use super::frame::LARGEST_ID;
use super::generated::{self, MessageAttributes};
use super::speed::{SpeedError, SpeedSignal};

/// Identifiers of a message on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageIds {
    /// CAN identifier, 11 bits.
    pub id: u16,
    /// E2E data id, 16 bits; part of the CRC, never sent.
    pub data_id: u16,
}

/// Identifiers and periods of the messages. The defaults are those of `gapwatch.dbc`.
#[derive(Clone, Debug, PartialEq)]
pub struct CanSettings {
    /// Identifiers of `GapStatus`; 0x5D0 by default.
    pub status: MessageIds,
    /// Identifiers of `GapHealth`; 0x5D1 by default.
    pub health: MessageIds,
    /// Identifiers of `GapDetail`; 0x5D2 by default.
    pub detail: MessageIds,
    /// Identifiers of `GapVersion`; 0x5D3 by default.
    pub version: MessageIds,
    /// Identifiers of `GapClear`; 0x5D8 by default.
    pub clear: MessageIds,
    /// Time between cyclic `GapStatus` frames; 100 ms by default.
    pub status_period: Duration,
    /// Time between `GapHealth` frames; 1 s by default.
    pub health_period: Duration,
    /// Time between `GapDetail` frames; 1 s by default.
    pub detail_period: Duration,
    /// Time between `GapVersion` frames; 1 s by default.
    pub version_period: Duration,
    /// Whether the bus has CAN FD and `GapDetail` is sent; false by default.
    pub fd: bool,
    /// Shortest time between two `GapStatus` frames; 20 ms by default.
    pub minimum_gap: Duration,
    /// Where another node sends the vehicle's speed; `None` by default.
    pub speed: Option<SpeedSignal>,
}

impl Default for CanSettings {
    fn default() -> Self {
        let status = generated::GapStatus::ATTRIBUTES;
        let health = generated::GapHealth::ATTRIBUTES;
        let detail = generated::GapDetail::ATTRIBUTES;
        let version = generated::GapVersion::ATTRIBUTES;
        let clear = generated::GapClear::ATTRIBUTES;
        Self {
            status: ids(generated::GapStatus::MESSAGE_ID, &status),
            health: ids(generated::GapHealth::MESSAGE_ID, &health),
            detail: ids(generated::GapDetail::MESSAGE_ID, &detail),
            version: ids(generated::GapVersion::MESSAGE_ID, &version),
            clear: ids(generated::GapClear::MESSAGE_ID, &clear),
            status_period: Duration::from_millis(status.cycle_ms),
            health_period: Duration::from_millis(health.cycle_ms),
            detail_period: Duration::from_millis(detail.cycle_ms),
            version_period: Duration::from_millis(version.cycle_ms),
            fd: false,
            minimum_gap: Duration::from_millis(status.minimum_gap_ms),
            speed: None,
        }
    }
}

fn ids(id: Id, attributes: &MessageAttributes) -> MessageIds {
    match id {
        Id::Standard(id) => MessageIds {
            id: id.as_raw(),
            data_id: attributes.data_id,
        },
        Id::Extended(_) => unreachable!("gapwatch.dbc holds standard identifiers only"),
    }
}

/// Settings that cannot be used on a bus.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CanSettingsError {
    /// An identifier needs more than 11 bits.
    #[error("CAN id {0:#X} does not fit into 11 bits (largest is 0x7FF)")]
    IdTooLarge(u16),
    /// Two messages share an identifier.
    #[error("CAN id {id:#X} is given to two messages, {} and {}", .messages[0], .messages[1])]
    SameId {
        /// The identifier.
        id: u16,
        /// The messages, by their keys in a board file.
        messages: [&'static str; 2],
    },
    /// The signal of the vehicle's speed is wrong.
    #[error("the speed: {0}")]
    Speed(#[from] SpeedError),
    /// A period of zero would send without end.
    #[error("a CAN period of 0 ms is not possible")]
    NoPeriod,
    /// The minimum gap leaves no room for the cyclic frames.
    #[error("a minimum gap of {gap:?} does not fit into a status period of {period:?}")]
    GapTooLong {
        /// Wanted minimum gap.
        gap: Duration,
        /// Wanted status period.
        period: Duration,
    },
}

impl CanSettings {
    /// Checks that the settings can be used.
    ///
    /// # Errors
    /// The first [`CanSettingsError`] found: an identifier above 11 bits, an identifier given twice, a speed that does
    /// not fit into a frame, a period of zero, or a minimum gap that is not shorter than the status period.
    pub fn check(&self) -> Result<(), CanSettingsError> {
        let ids = [
            ("status", self.status.id),
            ("health", self.health.id),
            ("detail", self.detail.id),
            ("version", self.version.id),
            ("clear", self.clear.id),
        ];
        let same = |before: &[(&'static str, u16)], (name, id)| {
            let other = before.iter().find(|(_, other)| *other == id);
            other.map_or(Ok(()), |&(other, id)| {
                let messages = [other, name];
                Err(CanSettingsError::SameId { id, messages })
            })
        };
        for (n, &(name, id)) in ids.iter().enumerate() {
            if id > LARGEST_ID {
                return Err(CanSettingsError::IdTooLarge(id));
            }
            same(&ids[..n], (name, id))?;
        }
        if let Some(speed) = &self.speed {
            speed.check()?;
            same(&ids, ("speed", speed.id))?;
        }
        let periods = [
            self.status_period,
            self.health_period,
            self.detail_period,
            self.version_period,
        ];
        if periods.contains(&Duration::ZERO) {
            return Err(CanSettingsError::NoPeriod);
        }
        if self.minimum_gap >= self.status_period {
            return Err(CanSettingsError::GapTooLong {
                gap: self.minimum_gap,
                period: self.status_period,
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn default_settings_are_those_of_the_dbc_file() {
        let settings = CanSettings::default();
        for (ids, id) in [
            (settings.status, 0x5D0),
            (settings.health, 0x5D1),
            (settings.detail, 0x5D2),
            (settings.version, 0x5D3),
            (settings.clear, 0x5D8),
        ] {
            assert_eq!(ids, MessageIds { id, data_id: id });
        }
        assert_eq!(settings.status_period, Duration::from_millis(100));
        assert_eq!(settings.health_period, Duration::from_secs(1));
        assert_eq!(settings.version_period, Duration::from_secs(1));
        assert_eq!(settings.minimum_gap, Duration::from_millis(20));
        assert_eq!(settings.check(), Ok(()));
    }

    #[test]
    fn settings_that_cannot_be_kept_are_refused() {
        let mut settings = CanSettings::default();
        settings.clear.id = 0x800;
        assert_eq!(settings.check(), Err(CanSettingsError::IdTooLarge(0x800)));

        let mut settings = CanSettings::default();
        settings.health.id = 0x5D0;
        let same = |messages| CanSettingsError::SameId {
            id: 0x5D0,
            messages,
        };
        assert_eq!(settings.check(), Err(same(["status", "health"])));

        let mut settings = CanSettings::default();
        settings.version.id = 0x5D0;
        let refused = settings.check().unwrap_err();
        assert_eq!(refused, same(["status", "version"]));
        assert_eq!(
            refused.to_string(),
            "CAN id 0x5D0 is given to two messages, status and version"
        );

        let settings = CanSettings {
            health_period: Duration::ZERO,
            ..CanSettings::default()
        };
        assert_eq!(settings.check(), Err(CanSettingsError::NoPeriod));

        let settings = CanSettings {
            version_period: Duration::ZERO,
            ..CanSettings::default()
        };
        assert_eq!(settings.check(), Err(CanSettingsError::NoPeriod));

        let settings = CanSettings {
            minimum_gap: Duration::from_millis(100),
            ..CanSettings::default()
        };
        assert!(matches!(
            settings.check(),
            Err(CanSettingsError::GapTooLong { .. })
        ));
    }
}
