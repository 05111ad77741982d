//! What happens to the loop: the road, the camera, the judge, the bus and the disk.

use super::*;
use crate::statistics::random::SplitMix64;

/// Random numbers.
pub struct Dice(pub SplitMix64);

impl Dice {
    pub fn below(&mut self, n: u64) -> u64 {
        self.0.bits() % n
    }

    /// True once in `n` times.
    pub fn once_in(&mut self, n: u64) -> bool {
        self.below(n) == 0
    }
}

/// What happens outside, in the order in which it happens.
#[derive(Debug)]
pub enum Event {
    Sent(Duration, CanFrame),
    Said(Verdict),
}

/// What bus and teller share with the script.
#[derive(Default)]
pub struct Wire {
    pub events: VecDeque<Event>,
    pub refuses: bool,
    pub busy: bool,
    pub heard: VecDeque<CanFrame>,
}

pub struct Sink(pub Rc<RefCell<Wire>>);

impl WarningSink for Sink {
    fn send(&mut self, at: Duration, frame: &CanFrame) -> Result<(), SinkError> {
        let mut wire = self.0.borrow_mut();
        if wire.refuses {
            return Err(SinkError::Refused {
                sink: "bus".to_owned(),
                source: io::ErrorKind::NetworkDown.into(),
            });
        }
        wire.events.push_back(Event::Sent(at, *frame));
        Ok(())
    }

    fn is_ready(&mut self, _now: Duration) -> bool {
        !self.0.borrow().busy
    }

    fn receive(&mut self) -> Option<CanFrame> {
        self.0.borrow_mut().heard.pop_front()
    }
}

#[derive(Default)]
pub struct Disk {
    pub bytes: Vec<u8>,
    pub full: bool,
}

#[derive(Clone, Default)]
pub struct SharedDisk(pub Arc<Mutex<Disk>>);

impl Write for SharedDisk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut disk = self.0.lock().unwrap();
        if disk.full {
            return Err(io::ErrorKind::StorageFull.into());
        }
        disk.bytes.extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// What the road shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Road {
    Nominal,
    Evident,
    Alternating,
    Drifting,
    Black,
}

/// The present situation outside, until it changes.
pub struct Script {
    pub road: Road,
    /// Time from one frame of the camera to the next; `None` if the camera gives no frames.
    pub frames_every: Option<Duration>,
    /// Time from taking a frame to its verdict.
    pub judging_takes: Duration,
    pub standing: Option<bool>,
    pub disk_full: bool,
    /// Evidence stays in its queue.
    pub evidence_waits: bool,
}

impl Script {
    /// Changes something now and then; most of the time everything works.
    pub fn change(&mut self, dice: &mut Dice, wire: &mut Wire) {
        if dice.once_in(100) {
            let well = dice.once_in(2);
            self.road = match dice.below(8) {
                0 | 1 => Road::Evident,
                2 => Road::Alternating,
                3 => Road::Drifting,
                4 => Road::Black,
                _ => Road::Nominal,
            };
            self.frames_every = match dice.below(12) {
                _ if well => Some(33 * MS),
                0 => None,
                1 => Some(600 * MS),
                2 => Some(1_000 * MS),
                _ => Some(100 * MS),
            };
            self.judging_takes = match dice.below(12) {
                _ if well => 5 * MS,
                0 => 300 * MS,
                1 => 490 * MS,
                2 => 620 * MS,
                3 if dice.once_in(10) => 8_000 * MS,
                _ => 5 * MS,
            };
            self.standing = match dice.below(6) {
                0 => Some(true),
                1 => None,
                _ => Some(false),
            };
            self.disk_full = dice.once_in(20);
            self.evidence_waits = dice.once_in(10);
            wire.refuses = dice.once_in(10);
            wire.busy = dice.once_in(10);
        }
    }

    /// How long the program, with all its threads, is suspended now.
    pub fn pause(&self, dice: &mut Dice) -> Duration {
        match dice.below(4_000) {
            0 => 800 * MS,
            1 => 1_500 * MS,
            2 => 30_000 * MS,
            3 => 600_000 * MS,
            _ => Duration::ZERO,
        }
    }
}

pub fn settings() -> CanSettings {
    CanSettings {
        fd: false,
        ..super::super::bus::tests::settings()
    }
}
