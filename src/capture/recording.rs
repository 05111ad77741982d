//! MCAP recordings: the images of one topic with their own time stamps.
//!
//! It chooses the topic and the times of frames. Only records that concern images are kept, and no record may be larger
//! than the largest picture, so memory is bounded whatever the file contains.

mod message;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek};
use std::path::{Path, PathBuf};
use std::time::Duration;

use mcap::parse_record;
use mcap::records::Record;
use mcap::sans_io::{
    LinearReadEvent, LinearReader, LinearReaderOptions, SummaryReadEvent, SummaryReader,
    SummaryReaderOptions,
};

use super::{Frame, FrameSource, PictureError, SourceError};
use message::{Kind, UNDERSTOOD};

/// First bytes of a recording.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// Longest record, bytes: the largest picture with three bytes for each pixel in base64, and its other fields.
const RECORD_MAX: usize = 140_000_000;
/// Largest number of channels of a recording, and longest name of a topic or schema, bytes.
const CHANNELS_MAX: usize = 4_096;
const NAME_MAX: usize = 1_024;
/// Largest number of topics that an error lists.
const LISTED_MAX: usize = 20;
/// A longer step from one image to the next counts as a wrong time stamp.
const STEP_MAX: Duration = Duration::from_secs(3_600);

/// The stamps are too coarse for a clock if this many images have the same time as the image before. The count begins
/// anew after `MOVING` images in a row that do not. Our own choice.
const STILL_MAX: u32 = 3;
const MOVING: u32 = 10;

/// Whether a file begins like a recording, or has the name of a recording.
pub fn is_recording(path: &Path) -> bool {
    let begins = || {
        let mut head = [0; MAGIC.len()];
        let read = File::open(path).and_then(|mut file| file.read_exact(&mut head));
        read.is_ok() && head == MAGIC
    };
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("mcap"))
        || begins()
}

/// Images of one topic.
pub struct RecordingSource {
    path: PathBuf,
    topic: String,
    records: Records,
    count: Option<u64>,
    next: u64,
    clock: Clock,
}

/// A topic of a file.
struct Topic {
    schema: String,
    encoding: String,
    /// Number of messages, if the file gives it.
    messages: Option<u64>,
}

impl RecordingSource {
    /// Opens the only topic with images of a recording, or the topic that is asked for.
    pub fn open(path: &Path, topic: Option<&str>) -> Result<Self, SourceError> {
        let fail = |why: String| SourceError::Recording {
            path: path.to_owned(),
            why,
        };
        let topics = topics(path).map_err(fail)?;
        let topic = chosen(&topics, topic).map_err(fail)?;
        Ok(Self {
            path: path.to_owned(),
            count: topics[&topic].messages,
            topic,
            records: Records::open(path).map_err(fail)?,
            next: 0,
            clock: Clock::default(),
        })
    }
}

impl FrameSource for RecordingSource {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let message = self.records.next(Some(&self.topic));
        let message = message.map_err(|why| SourceError::Recording {
            path: self.path.clone(),
            why: format!(
                "broke off after {} images of {}: {why}",
                self.next, self.topic
            ),
        })?;
        let Some(Message {
            kind,
            log_time,
            data,
            ..
        }) = message
        else {
            return Ok(None);
        };
        let read = kind.map_or_else(
            || {
                Err(format!(
                    "a message that is not an image, wanted {UNDERSTOOD}"
                ))
            },
            |kind| kind.image(&data),
        );
        let stamp = read.as_ref().ok().map(|image| image.stamp);
        let captured_at = self.clock.place(log_time, stamp);
        let sequence = self.next;
        self.next += 1;
        let picture = read.and_then(|image| image.picture);
        let picture = picture.map_err(|found| PictureError {
            path: self.path.clone(),
            found: format!("{} {sequence}: {found}", self.topic),
            wanted: "a whole image",
        });
        Ok(Some(Frame {
            sequence,
            captured_at,
            picture,
        }))
    }

    fn frame_count(&self) -> Option<u64> {
        self.count
    }

    fn began_at(&self) -> Option<Duration> {
        self.clock.began_at
    }
}

/// Time stamps of images → time since the source began.
#[derive(Default)]
struct Clock {
    /// The first image's time since the epoch of the recording.
    began_at: Option<Duration>,
    /// Whether the images' own times are used; otherwise the times at which they were recorded are used.
    own: bool,
    /// Number of images that have the time of the image before although they were recorded later, and how many other
    /// images have followed since.
    still: u32,
    moving: u32,
    last_stamp: Duration,
    last_log_time: Duration,
    last: Duration,
}

impl Clock {
    /// The time of an image. If its time is not after the image before, or is more than an hour after it, it gets the
    /// time of the image before, which the monitor treats as a fault of the camera; time continues from there. If the
    /// stamps often do not increase, they are no clock: from then on, the time of recording is used.
    fn place(&mut self, log_time: Duration, own: Option<Duration>) -> Duration {
        if self.began_at.is_none() {
            self.own = own.is_some_and(|stamp| !stamp.is_zero());
        } else if self.own && log_time > self.last_log_time {
            self.watch_stamps(own);
        }
        let stamp = match own.filter(|_| self.own) {
            Some(own) => own,
            // For an image that cannot be read: as long after the image before as it was recorded.
            None if self.own => self
                .last_stamp
                .saturating_add(log_time.saturating_sub(self.last_log_time)),
            None => log_time,
        };
        self.last_log_time = log_time;
        let before = std::mem::replace(&mut self.last_stamp, stamp);
        if self.began_at.is_none() {
            self.began_at = Some(stamp);
        } else if let Some(step) = stamp.checked_sub(before)
            && step <= STEP_MAX
        {
            self.last += step;
        }
        self.last
    }

    fn watch_stamps(&mut self, own: Option<Duration>) {
        if own == Some(self.last_stamp) {
            (self.still, self.moving) = (self.still + 1, 0);
        } else {
            self.moving += 1;
        }
        if self.moving >= MOVING {
            self.still = 0;
        }
        if self.still >= STILL_MAX {
            log::warn!(
                "the stamps of images often do not increase; from now on the time of recording is used"
            );
            self.own = false;
            self.last_stamp = self.last_log_time;
        }
    }
}

/// The topics of a file: from its summary or, if it has none, from the whole file.
fn topics(path: &Path) -> Result<BTreeMap<String, Topic>, String> {
    match summary(path) {
        Ok(Some(topics)) if !topics.is_empty() => return Ok(topics),
        Ok(_) => {}
        Err(why) => log::info!(
            "{}: no summary ({why}); reading the whole file",
            path.display()
        ),
    }
    let mut records = Records::open(path)?;
    let mut counts: BTreeMap<String, u64> = BTreeMap::new();
    let broke_off = loop {
        match records.next(None) {
            Ok(Some(message)) => *counts.entry(message.topic).or_default() += 1,
            Ok(None) => break None,
            // The messages before the damage can still be used.
            Err(why) => break Some(why),
        }
    };
    let topics: BTreeMap<String, Topic> = records
        .channels
        .into_values()
        .map(|channel| {
            let topic = Topic {
                messages: Some(counts.get(&channel.topic).copied().unwrap_or(0)),
                schema: channel.schema,
                encoding: channel.encoding,
            };
            (channel.topic, topic)
        })
        .collect();
    match broke_off {
        Some(why) if topics.is_empty() => Err(why),
        _ => Ok(topics),
    }
}

/// The topics that the summary at the end of a file lists; `None` without a summary.
fn summary(path: &Path) -> Result<Option<BTreeMap<String, Topic>>, String> {
    let mut file = File::open(path).map_err(|error| error.to_string())?;
    let size = file.metadata().map_err(|error| error.to_string())?.len();
    let mut reader = SummaryReader::new_with_options(
        SummaryReaderOptions::default()
            .with_file_size(size)
            .with_record_length_limit(RECORD_MAX),
    );
    while let Some(event) = reader.next_event() {
        match event.map_err(|error| plain(&error))? {
            SummaryReadEvent::ReadRequest(wanted) => {
                let read = file.read(reader.insert(wanted));
                reader.notify_read(read.map_err(|error| error.to_string())?);
            }
            SummaryReadEvent::SeekRequest(to) => {
                let at = file.seek(to).map_err(|error| error.to_string())?;
                reader.notify_seeked(at);
            }
        }
    }
    let Some(summary) = reader.finish() else {
        return Ok(None);
    };
    let mut topics: BTreeMap<String, Topic> = BTreeMap::new();
    for (id, channel) in &summary.channels {
        let counts = summary.stats.as_ref().map(|s| &s.channel_message_counts);
        let messages = counts.map(|counts| counts.get(id).copied().unwrap_or(0));
        let schema = channel.schema.as_ref();
        let topic = topics
            .entry(channel.topic.clone())
            .or_insert_with(|| Topic {
                schema: schema.map_or_else(String::new, |schema| schema.name.clone()),
                encoding: channel.message_encoding.clone(),
                messages: counts.map(|_| 0),
            });
        // One topic may have several channels.
        topic.messages = topic
            .messages
            .zip(messages)
            .map(|(sum, own)| sum.saturating_add(own));
    }
    Ok(Some(topics))
}

/// The topic that is asked for, or the only one with images.
fn chosen(topics: &BTreeMap<String, Topic>, wanted: Option<&str>) -> Result<String, String> {
    let with_images = |topic: &Topic| Kind::of(&topic.schema, &topic.encoding).is_some();
    let listed = |images: bool| {
        let of_kind = topics.iter().filter(|(_, t)| !images || with_images(t));
        let named = of_kind.take(LISTED_MAX).map(|(name, topic)| {
            let messages = topic
                .messages
                .map_or_else(String::new, |n| format!(", {n} messages"));
            format!("{name} ({} in {}{messages})", topic.schema, topic.encoding)
        });
        let named: Vec<String> = named.collect();
        if named.is_empty() {
            "none".to_owned()
        } else {
            named.join(", ")
        }
    };
    let images: Vec<&String> = topics
        .iter()
        .filter_map(|(name, topic)| with_images(topic).then_some(name))
        .collect();
    match (wanted, images.as_slice()) {
        (Some(wanted), _) => match topics.get(wanted) {
            Some(topic) if with_images(topic) => Ok(wanted.to_owned()),
            Some(topic) => Err(format!(
                "topic {wanted} holds {} in {}; wanted {UNDERSTOOD}",
                topic.schema, topic.encoding
            )),
            None => Err(format!(
                "no topic {wanted}; its topics with images: {}",
                listed(true)
            )),
        },
        (None, [only]) => Ok((*only).clone()),
        (None, []) => Err(format!(
            "no topic with images; wanted {UNDERSTOOD}; its topics: {}",
            listed(false)
        )),
        (None, _) => Err(format!(
            "several topics with images; wanted one of them, as in ?topic={}: {}",
            images[0],
            listed(true)
        )),
    }
}

/// A message of a topic.
struct Message {
    topic: String,
    kind: Option<Kind>,
    log_time: Duration,
    data: Vec<u8>,
}

struct Channel {
    topic: String,
    schema: String,
    encoding: String,
    kind: Option<Kind>,
}

/// The records of a file, in their order.
struct Records {
    file: BufReader<File>,
    reader: LinearReader,
    /// Names of schemas.
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, Channel>,
    ended: bool,
}

impl Records {
    fn open(path: &Path) -> Result<Self, String> {
        let options = LinearReaderOptions::default()
            .with_validate_chunk_crcs(true)
            .with_record_length_limit(RECORD_MAX);
        Ok(Self {
            file: BufReader::new(File::open(path).map_err(|error| error.to_string())?),
            reader: LinearReader::new_with_options(options),
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            ended: false,
        })
    }

    /// The next message of a topic. If no topic is named, the next message of any topic, without its data. Returns
    /// nothing after an error.
    fn next(&mut self, topic: Option<&str>) -> Result<Option<Message>, String> {
        if self.ended {
            return Ok(None);
        }
        let found = self.find(topic);
        self.ended = !matches!(found, Ok(Some(_)));
        found
    }

    fn find(&mut self, wanted: Option<&str>) -> Result<Option<Message>, String> {
        while let Some(event) = self.reader.next_event() {
            let (opcode, data) = match event.map_err(|error| plain(&error))? {
                LinearReadEvent::ReadRequest(bytes) => {
                    let read = loop {
                        match self.file.read(self.reader.insert(bytes)) {
                            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                            read => break read.map_err(|error| error.to_string())?,
                        }
                    };
                    self.reader.notify_read(read);
                    continue;
                }
                LinearReadEvent::Record { opcode, data } => (opcode, data),
            };
            match parse_record(opcode, data).map_err(|error| plain(&error))? {
                Record::Schema { header, .. } => {
                    check_name(&header.name)?;
                    self.schemas.insert(header.id, header.name);
                }
                Record::Channel(channel) => {
                    let schema = self.schemas.get(&channel.schema_id).cloned();
                    let schema = schema.unwrap_or_default();
                    for name in [&channel.topic, &channel.message_encoding] {
                        check_name(name)?;
                    }
                    let kind = Kind::of(&schema, &channel.message_encoding);
                    let (topic, encoding) = (channel.topic, channel.message_encoding);
                    let channel_of_file = Channel {
                        topic,
                        schema,
                        encoding,
                        kind,
                    };
                    self.channels.insert(channel.id, channel_of_file);
                }
                Record::Message { header, data } => {
                    let Some(channel) = self.channels.get(&header.channel_id) else {
                        return Err(format!(
                            "a message of unknown channel {}",
                            header.channel_id
                        ));
                    };
                    let data = match wanted {
                        None => Vec::new(),
                        Some(topic) if topic == channel.topic => data.into_owned(),
                        Some(_) => continue,
                    };
                    return Ok(Some(Message {
                        topic: channel.topic.clone(),
                        kind: channel.kind,
                        log_time: Duration::from_nanos(header.log_time),
                        data,
                    }));
                }
                _ => {}
            }
            if self.channels.len().max(self.schemas.len()) > CHANNELS_MAX {
                return Err(format!("more than {CHANNELS_MAX} channels"));
            }
        }
        Ok(None)
    }
}

fn check_name(name: &str) -> Result<(), String> {
    if name.len() <= NAME_MAX {
        return Ok(());
    }
    Err(format!(
        "a name of {} bytes, wanted at most {NAME_MAX}",
        name.len()
    ))
}

/// An error with its cause, in one line.
fn plain(error: &mcap::McapError) -> String {
    match error {
        mcap::McapError::Io(error) => error.to_string(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_goes_on_after_a_wrong_stamp() {
        let mut clock = Clock::default();
        let s = Duration::from_secs_f64;
        let placed: Vec<f64> = [
            (0.0, Some(1000.0)),
            (0.1, Some(1000.1)),
            // An image that cannot be read.
            (0.2, None),
            (0.3, Some(1000.3)),
            // A time far ahead, and then back.
            (0.4, Some(2e9)),
            (0.5, Some(2e9 + 0.1)),
            (0.6, Some(1000.6)),
            (0.7, Some(1000.7)),
        ]
        .into_iter()
        .map(|(log, own)| clock.place(s(log), own.map(s)).as_secs_f64())
        .collect();
        let wanted = [0.0, 0.1, 0.2, 0.3, 0.3, 0.4, 0.4, 0.5];
        for (found, wanted) in placed.iter().zip(wanted) {
            assert!((found - wanted).abs() < 1e-6, "{placed:?}");
        }
        assert_eq!(clock.began_at, Some(s(1000.0)));
    }

    #[test]
    fn images_without_a_stamp_lie_where_they_were_recorded() {
        let mut clock = Clock::default();
        let ms = Duration::from_millis;
        let placed = [500, 600, 700].map(|log| clock.place(ms(log), Some(Duration::ZERO)));
        assert_eq!(placed, [0, 100, 200].map(ms));
        assert_eq!(clock.began_at, Some(ms(500)));
    }

    /// Times of images at 10 and 2 a second whose stamps are whole seconds.
    #[test]
    fn stamps_too_coarse_to_be_a_clock_are_left_for_the_time_of_recording() {
        for period in [100, 500] {
            let mut clock = Clock::default();
            let placed: Vec<Duration> = (0..100)
                .map(|n| {
                    let recorded = Duration::from_millis(1_500_000 + period * n);
                    clock.place(recorded, Some(Duration::from_secs(recorded.as_secs())))
                })
                .collect();
            let still = placed.windows(2).filter(|pair| pair[0] == pair[1]).count();
            assert_eq!(still, 2, "every {period} ms: {placed:?}");
            let steady = placed[10..].windows(2).map(|pair| pair[1] - pair[0]);
            assert!(
                steady
                    .into_iter()
                    .all(|step| step == Duration::from_millis(period))
            );
        }
    }

    #[test]
    fn an_image_that_bears_the_time_of_the_one_before_now_and_then_stands_still_alone() {
        let mut clock = Clock::default();
        let ms = Duration::from_millis;
        let mut still = 0;
        let mut last = None;
        for n in 0..200 {
            let stamp = if n % 20 == 7 { n - 1 } else { n };
            let placed = clock.place(ms(1_000 + 100 * n), Some(ms(5_000 + 100 * stamp)));
            still += u32::from(last == Some(placed));
            last = Some(placed);
        }
        assert!(clock.own);
        assert_eq!((still, last), (10, Some(ms(19_900))));
    }
}
