//! Records of a recording, one after the other, from a whole file or from one of its chunks.
//!
//! Only records that concern images are kept, and no record may be larger than the largest picture, so memory is
//! bounded whatever the file contains.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use mcap::parse_record;
use mcap::records::Record;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::compression::{RECORD_MAX, uncompressed};
use super::message::Kind;

/// First bytes of a recording.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// Largest number of channels of a recording, and longest name of a topic or schema, bytes.
const CHANNELS_MAX: usize = 4_096;
const NAME_MAX: usize = 1_024;

/// Whether a file begins like a recording, perhaps one compressed as a whole.
pub fn begins_like_a_recording(path: &Path) -> bool {
    let mut head = [0; MAGIC.len()];
    let read = uncompressed(path).and_then(|mut file| file.read_exact(&mut head));
    read.is_ok() && head == MAGIC
}

/// A message of a topic.
pub struct Message {
    pub topic: String,
    pub kind: Option<Kind>,
    /// Nanoseconds.
    pub log_time: u64,
    /// Empty unless the topic was wanted.
    pub data: Vec<u8>,
}

#[derive(Clone)]
pub struct Channel {
    pub topic: String,
    pub schema: String,
    pub encoding: String,
    kind: Option<Kind>,
}

/// The schemas and channels that a file has named so far.
#[derive(Clone, Default)]
pub struct Tables {
    /// Names of schemas.
    schemas: BTreeMap<u16, String>,
    pub channels: BTreeMap<u16, Channel>,
}

impl Tables {
    fn add_schema(&mut self, id: u16, name: &str) -> Result<(), String> {
        check_name(name)?;
        self.schemas.insert(id, name.to_owned());
        self.check_size()
    }

    /// Adds a channel whose schema has been added.
    fn add_channel(
        &mut self,
        id: u16,
        topic: &str,
        schema_id: u16,
        encoding: &str,
    ) -> Result<(), String> {
        check_name(topic)?;
        check_name(encoding)?;
        let schema = self.schemas.get(&schema_id).cloned().unwrap_or_default();
        let channel = Channel {
            topic: topic.to_owned(),
            kind: Kind::of(&schema, encoding),
            schema,
            encoding: encoding.to_owned(),
        };
        self.channels.insert(id, channel);
        self.check_size()
    }

    fn check_size(&self) -> Result<(), String> {
        match self.channels.len().max(self.schemas.len()) {
            0..=CHANNELS_MAX => Ok(()),
            _ => Err(format!("more than {CHANNELS_MAX} channels")),
        }
    }

    /// What the summary of a file names.
    pub fn of_summary(summary: &mcap::Summary) -> Result<Self, String> {
        let mut tables = Self::default();
        for (&id, schema) in &summary.schemas {
            tables.add_schema(id, &schema.name)?;
        }
        for (&id, channel) in &summary.channels {
            let schema = channel.schema.as_ref().map_or(0, |schema| schema.id);
            tables.add_channel(id, &channel.topic, schema, &channel.message_encoding)?;
        }
        Ok(tables)
    }
}

/// The records of a file, or of a chunk, in their order.
pub struct Records {
    path: PathBuf,
    input: Box<dyn Read + Send>,
    reader: LinearReader,
    pub tables: Tables,
    ended: bool,
}

impl Records {
    /// The whole file.
    pub fn open(path: &Path) -> Result<Self, String> {
        Ok(Self {
            path: path.to_owned(),
            input: uncompressed(path).map_err(|error| error.to_string())?,
            reader: LinearReader::new_with_options(options()),
            tables: Tables::default(),
            ended: false,
        })
    }

    /// Nothing yet of a file whose summary names `tables`: see [`go_to`](Self::go_to).
    pub fn of_chunks(path: &Path, tables: Tables) -> Self {
        Self {
            path: path.to_owned(),
            input: Box::new(io::empty()),
            reader: LinearReader::new_with_options(options()),
            tables,
            ended: true,
        }
    }

    /// Goes to the chunk at these bytes of the file.
    pub fn go_to(&mut self, offset: u64, length: u64) -> Result<(), String> {
        let mut file = File::open(&self.path).map_err(|error| error.to_string())?;
        file.seek(SeekFrom::Start(offset))
            .map_err(|error| error.to_string())?;
        self.input = Box::new(BufReader::new(file.take(length)));
        let options = options()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true);
        self.reader = LinearReader::new_with_options(options);
        self.ended = false;
        Ok(())
    }

    /// The next message of a topic. If no topic is named, the next message of any topic, without its data. Returns
    /// nothing after an error.
    pub fn next(&mut self, topic: Option<&str>) -> Result<Option<Message>, String> {
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
                        match self.input.read(self.reader.insert(bytes)) {
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
                Record::Schema { header, .. } => self.tables.add_schema(header.id, &header.name)?,
                Record::Channel(channel) => self.tables.add_channel(
                    channel.id,
                    &channel.topic,
                    channel.schema_id,
                    &channel.message_encoding,
                )?,
                Record::Message { header, data } => {
                    let Some(channel) = self.tables.channels.get(&header.channel_id) else {
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
                        log_time: header.log_time,
                        data,
                    }));
                }
                _ => {}
            }
        }
        Ok(None)
    }
}

fn options() -> LinearReaderOptions {
    LinearReaderOptions::default()
        .with_validate_chunk_crcs(true)
        .with_record_length_limit(RECORD_MAX)
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
pub fn plain(error: &mcap::McapError) -> String {
    match error {
        mcap::McapError::Io(error) => error.to_string(),
        other => other.to_string(),
    }
}
