//! The vehicle's speed, read from a frame of another control unit.
//!
//! It defines where the signal is in the frame, as in a DBC file, and when the car counts as parked. It does not guess:
//! without a fresh and valid speed, the car is not parked, and the road is watched.

use std::time::Duration;

use thiserror::Error;

use super::LARGEST_ID;

/// A speed older than this is not used; control units send it several times as often.
const FRESH: Duration = Duration::from_secs(1);

/// A car that is faster is not parked, whatever a board file says, kilometres an hour.
const PARKED_BELOW_MAX_KMH: f64 = 10.0;

/// The frame with the speed, and the place of the speed in it.
#[derive(Clone, Debug, PartialEq)]
pub struct SpeedSignal {
    /// CAN identifier, 11 bits.
    pub id: u16,
    /// First bit as in a DBC file: the lowest bit, or the highest bit with `big_endian`.
    pub start_bit: u16,
    /// Number of bits, 1 to 32; unsigned. If all bits are set, the speed is not known.
    pub length: u16,
    /// Motorola's order of bits instead of Intel's.
    pub big_endian: bool,
    /// Kilometres an hour for each step.
    pub factor: f64,
    /// Kilometres an hour at the raw value 0.
    pub offset: f64,
    /// A car that is slower than this is not moving, kilometres an hour.
    pub parked_below_kmh: f64,
    /// A car that does not move for this long is parked.
    pub parked_after: Duration,
}

/// A signal that no frame can hold.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SpeedError {
    /// The signal reaches beyond the 64 bits of a frame.
    #[error("{length} bits from bit {start_bit} do not fit into a frame; wanted 1 to 32 within 64")]
    Place {
        /// First bit.
        start_bit: u16,
        /// Number of bits.
        length: u16,
    },
    /// Its factor or offset cannot be used.
    #[error("factor {factor} and offset {offset}; wanted finite numbers and a factor above 0")]
    Scale {
        /// Kilometres an hour for each step.
        factor: f64,
        /// Kilometres an hour at the raw value 0.
        offset: f64,
    },
    /// The limit below which the car counts as not moving is out of range.
    #[error("parked below {0} km/h; wanted more than 0 and at most {PARKED_BELOW_MAX_KMH}")]
    Parked(f64),
    /// The identifier is too large.
    #[error("CAN id {0:#X}; wanted 11 bits, at most {LARGEST_ID:#X}")]
    Id(u16),
}

impl SpeedSignal {
    /// Checks that the signal fits into a frame.
    ///
    /// # Errors
    /// The first [`SpeedError`] found.
    pub fn check(&self) -> Result<(), SpeedError> {
        if self.id > LARGEST_ID {
            return Err(SpeedError::Id(self.id));
        }
        if !(1..=32).contains(&self.length) || self.bits().is_none() {
            return Err(SpeedError::Place {
                start_bit: self.start_bit,
                length: self.length,
            });
        }
        let (factor, offset) = (self.factor, self.offset);
        if !(factor.is_finite() && offset.is_finite() && factor > 0.0) {
            return Err(SpeedError::Scale { factor, offset });
        }
        let below = self.parked_below_kmh;
        if !(below > 0.0 && below <= PARKED_BELOW_MAX_KMH) {
            return Err(SpeedError::Parked(below));
        }
        Ok(())
    }

    /// Shift and mask in the frame, which is read as one number in its byte order; `None` if the signal reaches beyond
    /// the frame.
    fn bits(&self) -> Option<(u32, u64)> {
        let (start, length) = (u32::from(self.start_bit), u32::from(self.length));
        let shift = if self.big_endian {
            // Bit 7 of byte 0 is the highest of all 64 bits.
            let from_top = start / 8 * 8 + (7 - start % 8);
            64_u32.checked_sub(from_top + length)?
        } else {
            (start + length <= 64).then_some(start)?
        };
        Some((shift, (1_u64 << length) - 1))
    }

    /// Kilometres an hour; `None` if the sender does not know the speed.
    pub fn kmh(&self, data: &[u8; 8]) -> Option<f64> {
        let (shift, mask) = self.bits()?;
        let frame = if self.big_endian {
            u64::from_be_bytes(*data)
        } else {
            u64::from_le_bytes(*data)
        };
        let raw = u32::try_from(frame >> shift & mask).ok()?;
        (u64::from(raw) != mask || mask == 1).then(|| f64::from(raw) * self.factor + self.offset)
    }
}

/// Decides from the received speeds whether the car is parked.
#[derive(Debug)]
pub struct Parking {
    after: Duration,
    heard_at: Option<Duration>,
    standing_since: Option<Duration>,
}

impl Parking {
    /// A car that does not move for `after` is parked.
    pub fn new(after: Duration) -> Self {
        Self {
            after,
            heard_at: None,
            standing_since: None,
        }
    }

    /// Takes what was received at `now`: whether the car is not moving, or that this is not known.
    pub fn hear(&mut self, now: Duration, standing: Option<bool>) {
        self.heard_at = Some(now);
        if standing == Some(true) {
            self.standing_since.get_or_insert(now);
        } else {
            self.standing_since = None;
        }
    }

    /// Whether it is known that the car has not moved for long enough.
    pub fn is_parked(&mut self, now: Duration) -> bool {
        let old = |at: Duration| now.saturating_sub(at) > FRESH;
        if self.heard_at.is_none_or(old) {
            self.standing_since = None;
        }
        self.standing_since
            .is_some_and(|since| now.saturating_sub(since) >= self.after)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn signal(start_bit: u16, length: u16, big_endian: bool) -> SpeedSignal {
        SpeedSignal {
            id: 0x1A0,
            start_bit,
            length,
            big_endian,
            factor: 0.01,
            offset: 0.0,
            parked_below_kmh: 1.0,
            parked_after: Duration::from_secs(10),
        }
    }

    fn close(found: Option<f64>, wanted: f64) -> bool {
        found.is_some_and(|kmh| (kmh - wanted).abs() < 1e-9)
    }

    #[test]
    fn both_orders_of_bits_are_those_of_dbc_files() {
        // 0x1234 = 4660 steps.
        let intel = [0, 0, 0x34, 0x12, 0, 0, 0, 0];
        assert!(close(signal(16, 16, false).kmh(&intel), 46.6));
        let motorola = [0, 0, 0x12, 0x34, 0, 0, 0, 0];
        assert!(close(signal(23, 16, true).kmh(&motorola), 46.6));
        // Twelve bits that cross the border of two bytes.
        assert!(close(
            signal(4, 12, false).kmh(&[0xF0, 0x23, 0, 0, 0, 0, 0, 0]),
            5.75
        ));
        assert!(close(
            signal(3, 12, true).kmh(&[0x02, 0x3F, 0, 0, 0, 0, 0, 0]),
            5.75
        ));
        assert_eq!(signal(16, 16, false).kmh(&[0xFF; 8]), None);
    }

    #[test]
    fn a_limit_that_no_parked_car_has_is_refused() {
        for below in [0.0, -1.0, 10.5, f64::INFINITY, f64::NAN] {
            let signal = SpeedSignal {
                parked_below_kmh: below,
                ..signal(16, 16, false)
            };
            assert!(
                matches!(signal.check(), Err(SpeedError::Parked(_))),
                "{below}"
            );
        }
    }

    #[test]
    fn what_no_frame_holds_is_refused() {
        assert_eq!(signal(48, 16, false).check(), Ok(()));
        assert_eq!(signal(55, 16, true).check(), Ok(()));
        for (start_bit, length, big_endian) in [
            (49, 16, false),
            (54, 16, true),
            (0, 0, false),
            (0, 33, false),
            (u16::MAX, 8, true),
        ] {
            let refused = signal(start_bit, length, big_endian).check();
            assert_eq!(refused, Err(SpeedError::Place { start_bit, length }));
        }
        let still = SpeedSignal {
            factor: 0.0,
            ..signal(0, 8, false)
        };
        assert!(matches!(still.check(), Err(SpeedError::Scale { .. })));
    }

    #[test]
    fn parked_is_standing_for_long_with_a_fresh_speed() {
        let s = Duration::from_secs;
        let mut parking = Parking::new(s(10));
        assert!(!parking.is_parked(s(100)));
        for second in 0..=10 {
            parking.hear(s(second), Some(true));
            assert_eq!(parking.is_parked(s(second)), second >= 10);
        }
        parking.hear(s(11), Some(false));
        assert!(!parking.is_parked(s(11)));
        for second in 12..=30 {
            parking.hear(s(second), Some(true));
        }
        assert!(parking.is_parked(s(31)));
        assert!(!parking.is_parked(s(32)), "silence is no standing");
        parking.hear(s(33), Some(true));
        assert!(!parking.is_parked(s(33)), "nor does it count as such later");
        parking.hear(s(34), None);
        assert!(!parking.is_parked(s(60)));
    }
}
