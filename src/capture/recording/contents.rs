//! What a recording contains: its topics, and where its chunks are.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

use mcap::sans_io::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};

use super::compression::{RECORD_MAX, is_compressed};
use super::message::{Kind, UNDERSTOOD};
use super::records::{Records, Tables, plain};

/// Largest number of topics that an error lists.
const LISTED_MAX: usize = 20;

/// A topic of a file.
#[derive(Clone)]
pub struct Topic {
    pub schema: String,
    pub encoding: String,
    /// Number of messages, if the file gives it.
    pub messages: Option<u64>,
    /// Log time of its first message in time, nanoseconds, if it is known.
    began: Option<u64>,
}

/// A file and what it contains.
pub struct Contents {
    pub path: PathBuf,
    pub topics: BTreeMap<String, Topic>,
    pub tables: Tables,
    /// The chunks, if the file has an index of all of them.
    chunks: Option<Vec<Chunk>>,
}

struct Chunk {
    /// Log time of its first message in time, nanoseconds.
    began: u64,
    offset: u64,
    length: u64,
    /// Channels with messages in this chunk; empty if the file does not give them.
    channels: BTreeSet<u16>,
}

/// A part of a file that is read from its beginning to its end.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Part {
    /// No message in it was recorded before, nanoseconds.
    pub began: u64,
    /// Number of the file.
    pub file: usize,
    /// Offset and length of a chunk, or the whole file.
    pub chunk: Option<(u64, u64)>,
}

impl Contents {
    /// Reads the summary of a file or, if it has none, the whole file.
    pub fn of(path: &Path) -> Result<Self, String> {
        if !is_compressed(path) {
            match summarised(path) {
                Ok(Some(contents)) if !contents.topics.is_empty() => return Ok(contents),
                Ok(_) => {}
                Err(why) => log::info!(
                    "{}: no summary ({why}); reading the whole file",
                    path.display()
                ),
            }
        }
        scanned(path)
    }

    /// The parts of this file that may hold messages of a topic, if it is the file of this number.
    pub fn parts(&self, topic: &str, file: usize) -> Vec<Part> {
        let Some(found) = self.topics.get(topic) else {
            return vec![];
        };
        let Some(chunks) = &self.chunks else {
            let began = found.began.unwrap_or(0);
            let chunk = None;
            return vec![Part { began, file, chunk }];
        };
        let of_topic = |id: &u16| {
            self.tables
                .channels
                .get(id)
                .is_some_and(|c| c.topic == topic)
        };
        let may_hold =
            |chunk: &&Chunk| chunk.channels.is_empty() || chunk.channels.iter().any(of_topic);
        let parts = chunks.iter().filter(may_hold).map(|chunk| Part {
            began: chunk.began,
            file,
            chunk: Some((chunk.offset, chunk.length)),
        });
        parts.collect()
    }
}

/// What the summary at the end of a file lists; `None` without a summary.
fn summarised(path: &Path) -> Result<Option<Contents>, String> {
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
    let counts = summary.stats.as_ref().map(|s| &s.channel_message_counts);
    let tables = Tables::of_summary(&summary)?;
    let mut topics: BTreeMap<String, Topic> = BTreeMap::new();
    for (id, channel) in &tables.channels {
        let messages = counts.map(|counts| counts.get(id).copied().unwrap_or(0));
        let topic = topics
            .entry(channel.topic.clone())
            .or_insert_with(|| Topic {
                schema: channel.schema.clone(),
                encoding: channel.encoding.clone(),
                messages: counts.map(|_| 0),
                began: summary.stats.as_ref().map(|s| s.message_start_time),
            });
        // One topic may have several channels.
        topic.messages = topic
            .messages
            .zip(messages)
            .map(|(sum, own)| sum.saturating_add(own));
    }
    Ok(Some(Contents {
        path: path.to_owned(),
        chunks: chunks(&summary, &tables),
        topics,
        tables,
    }))
}

/// The chunks that a summary lists, unless it does not list all of them or does not name all of their channels.
fn chunks(summary: &mcap::Summary, tables: &Tables) -> Option<Vec<Chunk>> {
    let listed = &summary.chunk_indexes;
    let stated = summary
        .stats
        .as_ref()
        .map(|stats| stats.chunk_count as usize);
    if listed.is_empty() || stated.is_some_and(|stated| stated != listed.len()) {
        return None;
    }
    let mut seen = BTreeSet::new();
    let chunk = |index: &mcap::records::ChunkIndex| {
        let channels: BTreeSet<u16> = index.message_index_offsets.keys().copied().collect();
        let known = channels.iter().all(|id| tables.channels.contains_key(id));
        (known && seen.insert(index.chunk_start_offset)).then_some(Chunk {
            began: index.message_start_time,
            offset: index.chunk_start_offset,
            length: index.chunk_length,
            channels,
        })
    };
    listed.iter().map(chunk).collect()
}

/// What a file without a summary contains, up to its end or its first damage.
fn scanned(path: &Path) -> Result<Contents, String> {
    let mut records = Records::open(path)?;
    let mut found: BTreeMap<String, (u64, u64)> = BTreeMap::new();
    let broke_off = loop {
        match records.next(None) {
            Ok(Some(message)) => {
                let entry = found.entry(message.topic).or_insert((0, u64::MAX));
                *entry = (entry.0 + 1, entry.1.min(message.log_time));
            }
            Ok(None) => break None,
            // The messages before the damage can still be used.
            Err(why) => break Some(why),
        }
    };
    let channels = records.tables.channels.values();
    let topics: BTreeMap<String, Topic> = channels
        .map(|channel| {
            let found = found.get(&channel.topic);
            let topic = Topic {
                messages: Some(found.map_or(0, |&(count, _)| count)),
                began: found.map(|&(_, began)| began),
                schema: channel.schema.clone(),
                encoding: channel.encoding.clone(),
            };
            (channel.topic.clone(), topic)
        })
        .collect();
    match broke_off {
        Some(why) if topics.is_empty() => Err(why),
        _ => Ok(Contents {
            path: path.to_owned(),
            topics,
            tables: records.tables,
            chunks: None,
        }),
    }
}

/// The topics of all files together.
pub fn all_topics(files: &[Contents]) -> BTreeMap<String, Topic> {
    let mut all: BTreeMap<String, Topic> = BTreeMap::new();
    for (name, topic) in files.iter().flat_map(|file| &file.topics) {
        match all.get_mut(name) {
            Some(sum) => {
                let messages = sum.messages.zip(topic.messages);
                sum.messages = messages.map(|(sum, own)| sum.saturating_add(own));
            }
            None => {
                all.insert(name.clone(), topic.clone());
            }
        }
    }
    all
}

/// The topic that is asked for, or the only one with images.
pub fn chosen(topics: &BTreeMap<String, Topic>, wanted: Option<&str>) -> Result<String, String> {
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
    if let Some(wanted) = wanted {
        return match topics.get(wanted) {
            Some(Topic {
                messages: Some(0), ..
            }) => Err(format!("no message on topic {wanted}")),
            Some(topic) if with_images(topic) => Ok(wanted.to_owned()),
            Some(topic) => Err(format!(
                "topic {wanted} holds {} in {}; wanted {UNDERSTOOD}",
                topic.schema, topic.encoding
            )),
            None => Err(format!(
                "no topic {wanted}; its topics with images: {}",
                listed(true)
            )),
        };
    }
    let images: Vec<(&String, &Topic)> = topics.iter().filter(|(_, t)| with_images(t)).collect();
    let filled = images.iter().filter(|(_, topic)| topic.messages != Some(0));
    match (filled.collect::<Vec<_>>().as_slice(), images.as_slice()) {
        ([(only, _)], _) => Ok((*only).clone()),
        ([], []) => Err(format!(
            "no topic with images; wanted {UNDERSTOOD}; its topics: {}",
            listed(false)
        )),
        ([], _) => Err(format!(
            "no image on its topics with images: {}",
            listed(true)
        )),
        ([(first, _), ..], _) => Err(format!(
            "several topics with images; wanted one of them, as in ?topic={first}: {}",
            listed(true)
        )),
    }
}
