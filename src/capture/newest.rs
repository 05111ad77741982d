//! Passes frames from a camera that does not wait to a judge that needs time: only the newest frame is kept.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::{Frame, SourceError};

/// Holds one frame. A frame that is not taken before the next one comes is dropped and counted.
#[derive(Default)]
pub struct Newest {
    slot: Mutex<Slot>,
    filled: Condvar,
}

#[derive(Default)]
struct Slot {
    frame: Option<Frame>,
    ended: Option<Result<(), SourceError>>,
    dropped: u64,
}

/// What is found in a [`Newest`].
#[derive(Debug)]
pub enum Taken {
    /// A frame.
    Frame(Frame),
    /// There is no frame yet.
    Nothing,
    /// There will be no more frames, and the error if there was one.
    Ended(Result<(), SourceError>),
}

impl Newest {
    /// Puts a frame in, instead of the one before.
    pub fn put(&self, frame: Frame) {
        let mut slot = self.slot();
        slot.dropped += u64::from(slot.frame.replace(frame).is_some());
        self.filled.notify_one();
    }

    /// Says that no frame will follow.
    pub fn end(&self, how: Result<(), SourceError>) {
        self.slot().ended = Some(how);
        self.filled.notify_one();
    }

    /// Takes the newest frame, waiting for it at most `patience`.
    pub fn take(&self, patience: Duration) -> Taken {
        let empty = |slot: &mut Slot| slot.frame.is_none() && slot.ended.is_none();
        let (mut slot, _) = self
            .filled
            .wait_timeout_while(self.slot(), patience, empty)
            .unwrap_or_else(PoisonError::into_inner);
        if let Some(frame) = slot.frame.take() {
            return Taken::Frame(frame);
        }
        slot.ended.take().map_or(Taken::Nothing, Taken::Ended)
    }

    /// Number of frames that were not taken.
    pub fn dropped(&self) -> u64 {
        self.slot().dropped
    }

    /// The slot is consistent, also if its last user panicked.
    fn slot(&self) -> MutexGuard<'_, Slot> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::Picture;
    use crate::capture::pixels::Pixels;

    fn frame(sequence: u64) -> Frame {
        let rgb = vec![];
        Frame {
            sequence,
            captured_at: Duration::ZERO,
            picture: Ok(Pixels::from(Picture {
                width: 0,
                height: 0,
                rgb,
            })),
        }
    }

    #[test]
    fn the_newest_frame_wins_and_the_others_are_counted() {
        let newest = Newest::default();
        for sequence in 0..5 {
            newest.put(frame(sequence));
        }
        let taken = newest.take(Duration::ZERO);
        assert!(matches!(taken, Taken::Frame(Frame { sequence: 4, .. })));
        assert!(matches!(newest.take(Duration::ZERO), Taken::Nothing));
        assert_eq!(newest.dropped(), 4);
    }

    #[test]
    fn the_last_frame_is_taken_before_the_end() {
        let newest = Newest::default();
        newest.put(frame(0));
        newest.end(Ok(()));
        assert!(matches!(newest.take(Duration::ZERO), Taken::Frame(_)));
        assert!(matches!(newest.take(Duration::ZERO), Taken::Ended(Ok(()))));
    }

    #[test]
    fn who_waits_is_woken_by_a_frame() {
        let newest = Newest::default();
        std::thread::scope(|scope| {
            let taken = scope.spawn(|| newest.take(Duration::from_secs(30)));
            newest.put(frame(7));
            assert!(matches!(taken.join(), Ok(Taken::Frame(_))));
        });
    }
}
