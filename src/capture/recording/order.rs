//! Messages of one topic in the order of their log times, from parts of one or several files.
//!
//! Chunks are read in the order in which they begin, and only while an earlier message may be in them. Where a file has
//! no index of its chunks, messages are put in order within a window. Memory is bounded: messages that wait have at
//! most `WAITING_MAX` bytes and one message more.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use super::contents::{Contents, Part};
use super::records::{Message, Records};

/// Largest size of the messages that wait for their turn, bytes.
const WAITING_MAX: usize = 256_000_000;
/// Number of messages among which those of a file without an index are put in order.
const WINDOW: usize = 32;

pub struct InOrder {
    files: Vec<Contents>,
    topic: String,
    /// Parts that were not begun, in the order in which they begin.
    parts: VecDeque<Part>,
    current: Option<Current>,
    waiting: BinaryHeap<Reverse<Waiting>>,
    waiting_bytes: usize,
    /// Number of messages that were read.
    read: u64,
    /// Log time of the last message that was given.
    last: u64,
    /// Why reading ended; told after the messages that were read before.
    failed: Option<String>,
}

/// The file that is being read.
struct Current {
    file: usize,
    records: Records,
    /// Whether a part of it has not ended.
    goes_on: bool,
    has_index: bool,
}

/// By time, then in the order of reading.
struct Waiting {
    key: (u64, u64),
    message: Message,
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.key == other.key
    }
}

impl Eq for Waiting {}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.key.cmp(&other.key)
    }
}

impl InOrder {
    /// Messages of a topic of all these files.
    pub fn new(files: Vec<Contents>, topic: &str) -> Self {
        let of_file = |(number, file): (usize, &Contents)| file.parts(topic, number);
        let mut parts: Vec<Part> = files.iter().enumerate().flat_map(of_file).collect();
        parts.sort_unstable();
        Self {
            files,
            topic: topic.to_owned(),
            parts: parts.into(),
            current: None,
            waiting: BinaryHeap::new(),
            waiting_bytes: 0,
            read: 0,
            last: 0,
            failed: None,
        }
    }

    /// The next message, or `None` at the end.
    ///
    /// # Errors
    /// What is wrong with the file, after all messages before the damage; then the end.
    pub fn next(&mut self) -> Result<Option<Message>, String> {
        while self.is_more_wanted() {
            if let Err(why) = self.read_on() {
                self.failed = Some(why);
                self.parts.clear();
                self.current = None;
            }
        }
        let Some(Reverse(Waiting { key, message })) = self.waiting.pop() else {
            return self.failed.take().map_or(Ok(None), Err);
        };
        self.waiting_bytes -= message.data.len();
        if key.0 < self.last {
            let back_s = std::time::Duration::from_nanos(self.last - key.0).as_secs_f64();
            (self.parts, self.current, self.failed) = (VecDeque::new(), None, None);
            self.waiting.clear();
            return Err(format!(
                "the next message was recorded {back_s:.3} s before the last one, too far back to be put in order; \
                 mcap sort of the MCAP tools makes an ordered file"
            ));
        }
        self.last = key.0;
        Ok(Some(message))
    }

    /// Whether a message may be earlier than all that wait.
    fn is_more_wanted(&self) -> bool {
        if self.waiting_bytes > WAITING_MAX {
            return false;
        }
        match &self.current {
            Some(current) if current.goes_on => current.has_index || self.waiting.len() < WINDOW,
            _ => self.parts.front().is_some_and(|part| {
                let first = self.waiting.peek();
                first.is_none_or(|Reverse(first)| part.began < first.key.0)
            }),
        }
    }

    /// Reads a message, or goes to the next part.
    fn read_on(&mut self) -> Result<(), String> {
        if let Some(current) = self.current.as_mut().filter(|current| current.goes_on) {
            let message = current.records.next(Some(&self.topic))?;
            current.goes_on = message.is_some();
            if let Some(message) = message {
                self.waiting_bytes += message.data.len();
                let key = (message.log_time, self.read);
                self.read += 1;
                self.waiting.push(Reverse(Waiting { key, message }));
            }
            return Ok(());
        }
        let Some(part) = self.parts.pop_front() else {
            return Ok(());
        };
        let file = &self.files[part.file];
        let same = self
            .current
            .take()
            .filter(|current| current.file == part.file);
        let records = match (part.chunk, same) {
            (None, _) => Records::open(&file.path)?,
            (Some((offset, length)), same) => {
                let mut records = same.map_or_else(
                    || Records::of_chunks(&file.path, file.tables.clone()),
                    |current| current.records,
                );
                records.go_to(offset, length)?;
                records
            }
        };
        self.current = Some(Current {
            file: part.file,
            records,
            goes_on: true,
            has_index: part.chunk.is_some(),
        });
        Ok(())
    }
}
