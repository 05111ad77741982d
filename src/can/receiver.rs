//! What is received from the bus: requests to clear the stored bit, frames of other senders with our identifiers, and
//! the car's speed.
//!
//! It checks `GapClear`, but does not act on it: the alarm decides whether a request is accepted.

use std::fmt;

use super::e2e::{E2eError, E2eReceiver};
use super::message::ClearRequest;
use super::{CanFrame, CanSettings};

/// What a frame from the bus means to the monitor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heard {
    /// A valid request to clear the stored bit.
    Clear,
    /// A frame on the identifier of `GapClear` that is not valid.
    Invalid,
    /// Another node sends with one of our identifiers.
    Foreign(u16),
    /// Whether the car is not moving; `None` if the sender of its speed does not know.
    Standing(Option<bool>),
}

impl fmt::Display for Heard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Clear => f.write_str("a valid GapClear"),
            Self::Invalid => f.write_str("an invalid GapClear, which is ignored"),
            Self::Standing(standing) => write!(f, "whether the car is not moving: {standing:?}"),
            Self::Foreign(id) => write!(f, "another node sends our CAN id {id:#X}"),
        }
    }
}

/// Interprets the frames that are received.
pub struct Receiver {
    settings: CanSettings,
    clear: E2eReceiver,
}

impl Receiver {
    /// A receiver that has received nothing yet.
    pub fn new(settings: &CanSettings) -> Self {
        Self {
            clear: E2eReceiver::new(settings.clear.data_id),
            settings: settings.clone(),
        }
    }

    /// What `frame` means; `None` for a frame that does not concern the monitor.
    pub fn hear(&mut self, frame: &CanFrame) -> Option<Heard> {
        if frame.id == self.settings.clear.id {
            let checked = match self.clear.check(&frame.data) {
                // After a pause of the tester, its counter may have any value.
                Ok(_) | Err(E2eError::WrongSequence { .. }) => {
                    ClearRequest::from_bytes(&frame.data).is_ok()
                }
                Err(_) => false,
            };
            return Some(if checked {
                Heard::Clear
            } else {
                Heard::Invalid
            });
        }
        if let Some(speed) = self
            .settings
            .speed
            .as_ref()
            .filter(|speed| speed.id == frame.id)
        {
            let kmh = speed.kmh(&frame.data);
            return Some(Heard::Standing(
                kmh.map(|kmh| kmh.abs() < speed.parked_below_kmh),
            ));
        }
        let settings = &self.settings;
        let ours = [
            settings.status.id,
            settings.health.id,
            settings.detail.id,
            settings.version.id,
        ];
        ours.contains(&frame.id).then_some(Heard::Foreign(frame.id))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::can::e2e::E2eSender;

    fn requests(count: usize) -> Vec<CanFrame> {
        let settings = CanSettings::default();
        let mut sender = E2eSender::new(settings.clear.data_id);
        let mut frames = vec![];
        for _ in 0..count {
            sender
                .protect(ClearRequest.to_bytes(), |data| {
                    let id = settings.clear.id;
                    frames.push(CanFrame { id, data });
                    Ok::<(), std::convert::Infallible>(())
                })
                .unwrap();
        }
        frames
    }

    #[test]
    fn a_protected_request_clears_also_after_a_pause() {
        let mut receiver = Receiver::new(&CanSettings::default());
        let frames = requests(10);
        for frame in [frames[0], frames[1], frames[9]] {
            assert_eq!(receiver.hear(&frame), Some(Heard::Clear));
        }
    }

    #[test]
    fn a_damaged_or_repeated_request_or_another_code_is_invalid() {
        let mut receiver = Receiver::new(&CanSettings::default());
        let [first, second] = requests(2).try_into().unwrap();
        let mut damaged = first;
        damaged.data[2] ^= 1;
        assert_eq!(receiver.hear(&damaged), Some(Heard::Invalid));
        assert_eq!(receiver.hear(&first), Some(Heard::Clear));
        assert_eq!(receiver.hear(&first), Some(Heard::Invalid));
        let mut other_code = second;
        E2eSender::new(0x5D8)
            .protect([0, 0, 0x5A, 0, 0, 0, 0, 0], |data| {
                other_code.data = data;
                Ok::<(), std::convert::Infallible>(())
            })
            .unwrap();
        let mut fresh = Receiver::new(&CanSettings::default());
        assert_eq!(fresh.hear(&other_code), Some(Heard::Invalid));
    }

    #[test]
    fn another_sender_on_our_identifiers_is_foreign() {
        let mut receiver = Receiver::new(&CanSettings::default());
        let mut hear = |id| receiver.hear(&CanFrame { id, data: [0; 8] });
        assert_eq!(hear(0x5D0), Some(Heard::Foreign(0x5D0)));
        assert_eq!(hear(0x5D1), Some(Heard::Foreign(0x5D1)));
        assert_eq!(hear(0x5D2), Some(Heard::Foreign(0x5D2)));
        assert_eq!(hear(0x5D3), Some(Heard::Foreign(0x5D3)));
        assert_eq!(hear(0x123), None);
    }

    #[test]
    fn a_car_stands_below_the_speed_that_says_so() {
        let speed = crate::can::speed::SpeedSignal {
            id: 0x1A0,
            start_bit: 0,
            length: 8,
            big_endian: false,
            factor: 0.5,
            offset: -10.0,
            parked_below_kmh: 1.0,
            parked_after: std::time::Duration::from_secs(1),
        };
        let settings = CanSettings {
            speed: Some(speed),
            ..CanSettings::default()
        };
        let mut receiver = Receiver::new(&settings);
        let mut hear = |id, byte| {
            let data = [byte, 0, 0, 0, 0, 0, 0, 0];
            receiver.hear(&CanFrame { id, data })
        };
        // Bytes of 20 mean 0 km/h; if the car rolls back, they are less.
        for (byte, standing) in [
            (0, Some(false)),
            (18, Some(false)),
            (19, Some(true)),
            (20, Some(true)),
            (21, Some(true)),
            (22, Some(false)),
            (255, None),
        ] {
            assert_eq!(hear(0x1A0, byte), Some(Heard::Standing(standing)), "{byte}");
        }
        assert_eq!(hear(0x1A1, 20), None);
        assert_eq!(hear(0x5D0, 20), Some(Heard::Foreign(0x5D0)));
    }
}
