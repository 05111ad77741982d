//! End-to-end protection of the frames: AUTOSAR E2E profile 11, data id mode BOTH.
//!
//! Byte 0 is a CRC-8 (polynomial 0x1D, start 0x00, xor 0x00) over data id low byte, data id high byte and byte 1 to the
//! last; the low nibble of byte 1 is a counter that runs 0 to 14. The bytes are the same as in profile 1. It manages
//! the counters. It does not detect silence: a receiver must detect that itself.

use autosar_e2e::profile11::{Profile11, Profile11Config, Profile11IdMode};
use autosar_e2e::{E2EProfile, E2EStatus};
use thiserror::Error;

/// Largest counter; the next one is 0, and 15 is invalid.
pub const LARGEST_COUNTER: u8 = 14;

/// Largest step of the counter that a receiver accepts: two frames in a row may be lost. This is our own choice; the
/// standard leaves it open.
pub const LARGEST_STEP: u8 = 3;

fn profile(data_id: u16, length: usize) -> Profile11 {
    Profile11::new(Profile11Config {
        mode: Profile11IdMode::Both,
        data_id,
        crc_offset: 0,
        counter_offset: 8,
        data_length: u8::try_from(8 * length).unwrap_or(u8::MAX),
        ..Profile11Config::default()
    })
    .expect("a layout that profile 11 allows")
}

/// Protects the frames of one message, `LENGTH` bytes each: at most 30, which is the limit of the profile.
#[derive(Clone)]
pub struct E2eSender<const LENGTH: usize = 8> {
    profile: Profile11,
}

impl<const LENGTH: usize> E2eSender<LENGTH> {
    /// A sender whose first frame has the counter 0.
    pub fn new(data_id: u16) -> Self {
        Self {
            profile: profile(data_id, LENGTH),
        }
    }

    /// Writes counter and CRC into `data` and offers it to `send`. The counter is incremented only if `send` accepts
    /// the bytes, so a receiver sees no jump after a failed write.
    ///
    /// # Errors
    /// The error of `send`.
    pub fn protect<E>(
        &mut self,
        mut data: [u8; LENGTH],
        send: impl FnOnce([u8; LENGTH]) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut next = self.profile.clone();
        next.protect(&mut data).expect("a frame of its length");
        send(data)?;
        self.profile = next;
        Ok(())
    }
}

/// How an accepted frame follows the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sequence {
    /// The first frame received.
    First,
    /// The next frame in sequence.
    Next,
    /// Up to [`LARGEST_STEP`] - 1 frames are missing before it.
    SomeLost,
}

/// Why a frame is refused.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum E2eError {
    /// The CRC is wrong: the frame is damaged, or belongs to another message.
    #[error("the CRC does not match the frame and its data id")]
    Corrupt,
    /// The counter is 15.
    #[error("the counter is 15, which is invalid")]
    InvalidCounter,
    /// The counter has not moved.
    #[error("the counter {0} was received twice")]
    Repeated(u8),
    /// The counter jumped by more than [`LARGEST_STEP`].
    #[error("the counter jumped from {from} to {to}")]
    WrongSequence {
        /// Counter of the frame before.
        from: u8,
        /// Counter of this frame.
        to: u8,
    },
}

/// Checks the frames of one message, `LENGTH` bytes each.
#[derive(Clone)]
pub struct E2eReceiver<const LENGTH: usize = 8> {
    profile: Profile11,
    last: Option<u8>,
}

impl<const LENGTH: usize> E2eReceiver<LENGTH> {
    /// A receiver that accepts any valid counter in the first frame.
    pub fn new(data_id: u16) -> Self {
        Self {
            profile: profile(data_id, LENGTH),
            last: None,
        }
    }

    /// Checks one received frame.
    ///
    /// # Errors
    /// An [`E2eError`]; the frame is then to be ignored. After a jump the next frame in sequence
    /// is accepted again.
    pub fn check(&mut self, data: &[u8; LENGTH]) -> Result<Sequence, E2eError> {
        if self.profile.check(data) == Ok(E2EStatus::CrcError) {
            return Err(E2eError::Corrupt);
        }
        // The counter is checked here, because the crate accepts 15 like any other number, and because it treats a
        // receiver that joins later as one that has missed frames since 0.
        let to = data[1] & 0x0F;
        if to > LARGEST_COUNTER {
            return Err(E2eError::InvalidCounter);
        }
        let Some(from) = self.last.replace(to) else {
            return Ok(Sequence::First);
        };
        match (to + LARGEST_COUNTER + 1 - from) % (LARGEST_COUNTER + 1) {
            0 => Err(E2eError::Repeated(to)),
            1 => Ok(Sequence::Next),
            step if step <= LARGEST_STEP => Ok(Sequence::SomeLost),
            _ => Err(E2eError::WrongSequence { from, to }),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::convert::Infallible;

    fn protect(sender: &mut E2eSender, data: [u8; 8]) -> [u8; 8] {
        let mut sent = data;
        sender
            .protect(data, |data| {
                sent = data;
                Ok::<(), Infallible>(())
            })
            .unwrap();
        sent
    }

    /// `count` protected frames with the counters 0, 1, ...
    fn frames(count: usize) -> Vec<[u8; 8]> {
        let mut sender = E2eSender::new(0x123);
        (0..count)
            .map(|_| protect(&mut sender, [0, 0xA0, 1, 2, 3, 4, 5, 6]))
            .collect()
    }

    #[test]
    fn check_vectors_of_profile_11_are_met() {
        // Computed with the Python package autosar-e2e: data id 0x123, mode BOTH, zero bytes.
        let mut sender = E2eSender::new(0x123);
        assert_eq!(protect(&mut sender, [0; 8])[..2], [0xCC, 0x00]);
        assert_eq!(protect(&mut sender, [0; 8])[..2], [0x91, 0x01]);
    }

    #[test]
    fn counter_runs_from_0_to_14_and_leaves_the_high_nibble_alone() {
        let bytes: Vec<u8> = frames(17).iter().map(|data| data[1]).collect();
        let wanted: Vec<u8> = (0xA0..=0xAE).chain([0xA0, 0xA1]).collect();
        assert_eq!(bytes, wanted);
    }

    #[test]
    fn refused_write_keeps_the_counter() {
        let mut sender = E2eSender::new(0x123);
        protect(&mut sender, [0; 8]);
        let mut offered = [0; 8];
        let refused = sender.protect([0; 8], |data| {
            offered = data;
            Err("bus full")
        });
        assert_eq!(refused, Err("bus full"));
        assert_eq!(protect(&mut sender, [0; 8]), offered);
        assert_eq!(offered[1], 1);
    }

    #[test]
    fn frames_in_sequence_are_accepted_over_the_wrap() {
        let mut receiver = E2eReceiver::new(0x123);
        for (n, data) in frames(40).iter().enumerate() {
            let wanted = if n == 0 {
                Sequence::First
            } else {
                Sequence::Next
            };
            assert_eq!(receiver.check(data), Ok(wanted));
        }
    }

    #[test]
    fn one_flipped_bit_in_any_position_is_refused() {
        for good in frames(15) {
            for bit in 0..64 {
                let mut data = good;
                data[bit / 8] ^= 1 << (bit % 8);
                let mut receiver = E2eReceiver::new(0x123);
                assert_eq!(receiver.check(&data), Err(E2eError::Corrupt), "bit {bit}");
            }
        }
    }

    #[test]
    fn another_data_id_is_refused() {
        let data = frames(1)[0];
        for data_id in [0x122, 0x023, 0x5D0] {
            let mut receiver = E2eReceiver::new(data_id);
            assert_eq!(receiver.check(&data), Err(E2eError::Corrupt));
        }
    }

    #[test]
    fn receiver_may_join_anywhere_and_counts_lost_frames() {
        let frames = frames(20);
        let mut receiver = E2eReceiver::new(0x123);
        assert_eq!(receiver.check(&frames[9]), Ok(Sequence::First));
        assert_eq!(receiver.check(&frames[9]), Err(E2eError::Repeated(9)));
        assert_eq!(receiver.check(&frames[12]), Ok(Sequence::SomeLost));
        assert_eq!(
            receiver.check(&frames[16]),
            Err(E2eError::WrongSequence { from: 12, to: 1 })
        );
        assert_eq!(receiver.check(&frames[17]), Ok(Sequence::Next));
    }

    #[test]
    fn counter_15_is_refused() {
        // CRC of data id 0x123 with the bytes 0F 00 00 00 00 00 00.
        let data = [0x90, 0x0F, 0, 0, 0, 0, 0, 0];
        let mut receiver = E2eReceiver::new(0x123);
        assert_eq!(receiver.check(&data), Err(E2eError::InvalidCounter));
    }
}
