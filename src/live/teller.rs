//! The teller's side of the live loop: what is reported to bus, files, terminal and service manager, and when.
//!
//! It decides what is reported: whatever the judge does, the bus receives within half a second that there is no
//! verdict, and it never receives an old verdict. It also handles what is received from the bus: whether the car is
//! parked, and requests to clear the stored bit.

use std::error::Error;
use std::time::Duration;

use super::bus::may_complain;
use super::outputs::{OutputError, Outputs};
use super::service::{Service, ServiceWords};
use super::{JUDGE_WAITS, Orders, Word};
use crate::can::SinkError;
use crate::can::receiver::Heard;
use crate::can::speed::Parking;
use crate::capture::undefined::Undefined;
use crate::monitor::alarm::{AlarmState, Reason};
use crate::monitor::continuity::STALE;
use crate::monitor::judge::Verdict;

/// A verdict on a frame this old is too late for a warning. The limit is the same as for no verdict at all.
const LATE: Duration = STALE;

/// Reports what is known to all outputs.
pub struct Teller {
    outputs: Outputs,
    service: Service,
    has_begun: bool,
    last: Verdict,
    /// When the judge last sent something, or when frames were last not to be judged.
    heard_at: Duration,
    /// Without a message from the judge for this long, there is no verdict.
    silent: Duration,
    parking: Parking,
    parked: bool,
    /// When the last line was logged about what is received from the bus, and about each output.
    complained_at: [Option<Duration>; 2],
}

/// What is shown on the terminal.
#[derive(Clone, Copy, Debug)]
pub struct Said<'a> {
    /// The verdict.
    pub verdict: &'a Verdict,
    /// Age of its frame.
    pub latency: Duration,
    /// State or reason have changed.
    pub is_change: bool,
}

/// Called with what is shown on the terminal.
pub type Show<'a> = dyn FnMut(Said<'_>) + 'a;

impl Teller {
    /// For frames that may come as slowly as one every `period`, and a car that is parked when it has not moved for
    /// `parked_after`.
    pub fn new(
        outputs: Outputs,
        period: Duration,
        parked_after: Duration,
        service: Service,
    ) -> Self {
        Self {
            outputs,
            service,
            has_begun: false,
            last: Verdict::nothing_yet(),
            heard_at: Duration::ZERO,
            silent: STALE.max(period * 3 / 2) + JUDGE_WAITS,
            parking: Parking::new(parked_after),
            parked: false,
            complained_at: [None; 2],
        }
    }

    /// Reports the first state.
    ///
    /// # Errors
    /// As [`tick`](Self::tick).
    pub fn begin(&mut self, now: Duration, show: &mut Show<'_>) -> Result<(), OutputError> {
        self.heard_at = now;
        let nothing = Verdict {
            at: now,
            ..Verdict::nothing_yet()
        };
        self.tell(now, &nothing, Duration::ZERO, show)
    }

    /// Serves the bus at `now`, with what the judge has sent since the last time: receives frames, reports what is new,
    /// and keeps the cycle. Returns the orders for the judge.
    ///
    /// # Errors
    /// When the stream that replaces the bus has no reader any more. Any other error of an output is logged and does
    /// not affect the other outputs.
    pub fn tick(
        &mut self,
        now: Duration,
        words: impl IntoIterator<Item = Word>,
        show: &mut Show<'_>,
    ) -> Result<Orders, OutputError> {
        for word in words {
            self.hear_judge(now, word, show)?;
        }
        let clear = self.hear_bus(now);
        let was_parked = std::mem::replace(&mut self.parked, self.parking.is_parked(now));
        if self.parked || was_parked {
            self.heard_at = now;
        }
        if self.parked && self.last.reason != Reason::Parked {
            let parked = self.without_frame(now, Reason::Parked, None);
            self.tell(now, &parked, Duration::ZERO, show)?;
        }
        if self.is_silent(now) {
            let silent = self.without_frame(now, Reason::Stale, Some(Undefined::Silence));
            self.tell(now, &silent, Duration::ZERO, show)?;
        }
        self.outputs.bus.tell_health(now);
        let polled = self.outputs.bus.poll(now);
        self.survive(now, polled.err().map(OutputError::from))?;
        Ok(Orders {
            parked: self.parked,
            clear,
        })
    }

    /// What is to be sent to the service manager at `now`, when the judge has completed `rounds` rounds.
    pub fn service(&mut self, now: Duration, rounds: u64) -> ServiceWords {
        let judged_or_fault = self.last.gap.is_some() || self.last.is_unjudged();
        self.service.due(now, judged_or_fault, rounds)
    }

    /// Whether something waits for the bus.
    pub fn is_waiting(&self) -> bool {
        self.outputs.bus.is_waiting()
    }

    /// Reports that the monitor stops.
    ///
    /// # Errors
    /// As [`tick`](Self::tick).
    pub fn stop(&mut self, now: Duration, show: &mut Show<'_>) -> Result<(), OutputError> {
        let stopped = self.without_frame(now, Reason::Stopped, None);
        self.tell(now, &stopped, Duration::ZERO, show)
    }

    /// Offers the last message to the bus again.
    pub fn offer(&mut self, now: Duration) {
        let polled = self.outputs.bus.poll(now);
        // Nothing is left that could use the error.
        let _ = self.survive(now, polled.err().map(OutputError::from));
    }

    /// Ends all outputs; returns their errors.
    pub fn finish(self) -> Vec<OutputError> {
        self.outputs.finish()
    }

    fn hear_judge(
        &mut self,
        now: Duration,
        word: Word,
        show: &mut Show<'_>,
    ) -> Result<(), OutputError> {
        match word {
            Word::Verdict { verdict, dropped } => {
                self.outputs.bus.dropped_frames = dropped;
                if self.parked {
                    // The frame is from before the car was parked: only its stored bit is used.
                    return self.tell_stored(now, verdict.gap_stored, show);
                }
                let is_silence = verdict.sequence.is_none();
                if is_silence && !self.is_silence_news() {
                    return Ok(());
                }
                let latency = now.saturating_sub(verdict.at);
                self.heard_at = now;
                let verdict = in_time(verdict, latency);
                self.tell(now, &verdict, latency, show)
            }
            Word::Cleared(true) => self.tell_stored(now, false, show),
            Word::Cleared(false) => {
                log::warn!(
                    "GapClear is refused, because the state is Gap, or would be Gap if the road could be seen"
                );
                Ok(())
            }
        }
    }

    /// Reports the stored bit without waiting for a frame, because no frame is judged while the car is parked.
    fn tell_stored(
        &mut self,
        now: Duration,
        gap_stored: bool,
        show: &mut Show<'_>,
    ) -> Result<(), OutputError> {
        if self.last.gap_stored == gap_stored {
            return Ok(());
        }
        if self.is_silent(now) {
            // The next report contains it. The verdict before is too old to be reported again.
            self.last.gap_stored = gap_stored;
            return Ok(());
        }
        let verdict = Verdict {
            sequence: None,
            gap_stored,
            ..self.last.clone()
        };
        self.tell(now, &verdict, now.saturating_sub(verdict.at), show)
    }

    /// Receives what other nodes send; returns whether they ask to clear the stored bit.
    fn hear_bus(&mut self, now: Duration) -> bool {
        let mut clear = false;
        while let Some(heard) = self.outputs.bus.hear() {
            match heard {
                Heard::Clear => clear = true,
                Heard::Standing(standing) => self.parking.hear(now, standing),
                Heard::Foreign(_) | Heard::Invalid => {
                    if may_complain(&mut self.complained_at[0], now) {
                        log::warn!("on the bus: {heard}");
                    }
                }
            }
        }
        clear
    }

    /// The judge has sent nothing for too long, and this was not yet reported.
    fn is_silent(&self, now: Duration) -> bool {
        now.saturating_sub(self.heard_at) > self.silent && self.is_silence_news()
    }

    /// Silence is not reported again after a fault. It is reported after `Parked` if the car drives again.
    fn is_silence_news(&self) -> bool {
        !self.last.is_unjudged() || (self.last.reason == Reason::Parked && !self.parked)
    }

    fn without_frame(&self, at: Duration, reason: Reason, why: Option<Undefined>) -> Verdict {
        Verdict {
            at,
            state: AlarmState::Unavailable,
            reason,
            undefined: why,
            fault_detection_counter: self.last.fault_detection_counter,
            gap_stored: self.last.gap_stored,
            ..Verdict::nothing_yet()
        }
    }

    fn tell(
        &mut self,
        now: Duration,
        verdict: &Verdict,
        latency: Duration,
        show: &mut Show<'_>,
    ) -> Result<(), OutputError> {
        let troubles = self.outputs.tell(now, verdict, latency);
        let before = (self.last.state, self.last.reason);
        let is_change = (verdict.state, verdict.reason) != before || !self.has_begun;
        self.has_begun = true;
        self.last = verdict.clone();
        show(Said {
            verdict,
            latency,
            is_change,
        });
        self.survive(now, troubles)
    }

    /// An error of one output does not affect the others. But when a stream has no reader any more, the run ends.
    fn survive(
        &mut self,
        now: Duration,
        troubles: impl IntoIterator<Item = OutputError>,
    ) -> Result<(), OutputError> {
        for trouble in troubles {
            if let OutputError::Bus(SinkError::Write { source, .. }) = &trouble
                && source.kind() == std::io::ErrorKind::BrokenPipe
            {
                return Err(trouble);
            }
            if may_complain(&mut self.complained_at[1], now) {
                log::error!("{}", with_causes(&trouble));
            }
        }
        Ok(())
    }
}

/// An error and what caused it, in one line.
fn with_causes(error: &dyn Error) -> String {
    let mut line = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        line += &format!(": {error}");
        cause = error.source();
    }
    line
}

/// A verdict that comes too late becomes "no verdict".
fn in_time(verdict: Verdict, latency: Duration) -> Verdict {
    if latency < LATE || verdict.sequence.is_none() {
        return verdict;
    }
    Verdict {
        at: verdict.at,
        sequence: verdict.sequence,
        state: AlarmState::Unavailable,
        reason: Reason::Lagging,
        undefined: Some(Undefined::Late(latency)),
        window_fill: verdict.window_fill,
        fault_detection_counter: verdict.fault_detection_counter,
        gap_stored: verdict.gap_stored,
        ..Verdict::nothing_yet()
    }
}

#[cfg(test)]
mod tests;
