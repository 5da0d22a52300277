//! MCAP files of messages that are rows of bytes.
//!
//! A message is a head, which many messages share, with a time stamp in it, and a body. The messages of a topic have
//! bodies of one size, or of sizes that their ends give. [`MessageFile::write`] merges the messages of all topics sample
//! by sample. The file has chunks with an index and a summary with statistics, so readers find messages by time and
//! topic. No function does input or output: the caller takes the bytes that the file continues with.
//!
//! ```
//! use std::collections::BTreeMap;
//! use xbus::message_file::{Bodies, Compression, MessageFile, Rows, Topic};
//!
//! let mut file = MessageFile::new(Compression::None, "xbus", &[])?;
//! let temperature = file.declare(Topic {
//!     name: "/temperature".to_owned(),
//!     schema: "std_msgs/msg/Float64".to_owned(),
//!     definition: "float64 data".to_owned(),
//!     metadata: BTreeMap::new(),
//! });
//! let bodies = [21.5_f64, 22.0].map(f64::to_le_bytes).concat();
//! let rows = Rows { topic: temperature, sample: &[7, 9], head: &[0, 1, 0, 0], stamp: None, body: Bodies::Even(&bodies) };
//! file.write(7, &[100, 110, 120], &[100, 110, 120], &[rows])?;
//! let mut bytes = file.take();
//! bytes.extend(file.finish()?);
//! let messages: Vec<_> = mcap::MessageStream::new(&bytes)?.collect::<Result<_, _>>()?;
//! assert_eq!(messages.iter().map(|message| message.log_time).collect::<Vec<_>>(), [100, 120]);
//! assert_eq!(file.counts(), [2]);
//! # Ok::<(), xbus::message_file::MessageError>(())
//! ```

use std::collections::BTreeMap;
use std::fmt;
use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{McapError, WriteOptions, Writer};

/// Bytes of a chunk before it is compressed, about. A reader decompresses a chunk to find a message.
const CHUNK_BYTES: u64 = 1 << 20;
/// Zstandard's fastest regular level: the default, 3, takes 1.3 times as long for chunks that are 3 % smaller.
const ZSTD_LEVEL: u32 = 1;
/// Bytes of a time stamp in a message: seconds and nanoseconds.
const STAMP_SIZE: usize = 8;
const SECOND: i64 = 1_000_000_000;

/// How chunks are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // the variants are the names
pub enum Compression {
    Zstd,
    Lz4,
    None,
}

impl Compression {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Zstd, Self::Lz4, Self::None];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Zstd => "zstd",
            Self::Lz4 => "lz4",
            Self::None => "none",
        }
    }
}

/// Why messages cannot be written.
#[derive(Debug)]
pub enum MessageError {
    /// The rows of a topic are not what the topic or the samples need.
    Rows {
        /// The topic.
        topic: usize,
        /// What is wrong.
        problem: &'static str,
    },
    /// The format cannot hold them.
    Mcap(McapError),
}

impl From<McapError> for MessageError {
    fn from(error: McapError) -> Self {
        Self::Mcap(error)
    }
}

impl fmt::Display for MessageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rows { topic, problem } => write!(f, "rows of topic {topic}: {problem}"),
            Self::Mcap(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for MessageError {}

/// What the messages of a topic have in common.
#[derive(Clone, Debug)]
pub struct Topic {
    /// Its name.
    pub name: String,
    /// The type of its messages.
    pub schema: String,
    /// The definition of the type, in the language of ROS 2 (`ros2msg`).
    pub definition: String,
    /// What else readers may want to know.
    pub metadata: BTreeMap<String, String>,
}

/// The bodies of messages, joined.
#[derive(Clone, Copy, Debug)]
pub enum Bodies<'a> {
    /// All of one size.
    Even(&'a [u8]),
    /// Where each one ends.
    Ends(&'a [u8], &'a [u64]),
}

/// Messages of a topic.
#[derive(Clone, Copy, Debug)]
pub struct Rows<'a> {
    /// The topic: what [`MessageFile::declare`] returned.
    pub topic: usize,
    /// The sample of each message, rising, counted from the beginning of the log.
    pub sample: &'a [i64],
    /// What all messages begin with.
    pub head: &'a [u8],
    /// Where the head has the time stamp of the message.
    pub stamp: Option<usize>,
    /// How the messages continue.
    pub body: Bodies<'a>,
}

/// The bytes that were written and not yet taken.
#[derive(Clone, Debug, Default)]
struct Sink(Arc<Mutex<Vec<u8>>>);

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A topic, with its number in the file as soon as it has a message.
struct Channel {
    topic: Topic,
    id: Option<u16>,
    count: u64,
}

/// An MCAP file with messages of ROS 2.
pub struct MessageFile {
    writer: Writer<NoSeek<Sink>>,
    sink: Sink,
    channels: Vec<Channel>,
    message: Vec<u8>,
}

impl fmt::Debug for MessageFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("MessageFile").field("counts", &self.counts()).finish_non_exhaustive()
    }
}

impl MessageFile {
    /// A file. `library` names the program that writes it; `metadata` are records with a name and entries.
    ///
    /// # Errors
    /// [`MessageError`] if a record is too long.
    pub fn new(
        compression: Compression,
        library: &str,
        metadata: &[(String, BTreeMap<String, String>)],
    ) -> Result<Self, MessageError> {
        let sink = Sink::default();
        let (codec, level) = match compression {
            Compression::Zstd => (Some(mcap::Compression::Zstd), ZSTD_LEVEL),
            Compression::Lz4 => (Some(mcap::Compression::Lz4), 0),
            Compression::None => (None, 0),
        };
        let mut writer = WriteOptions::new()
            .profile("ros2")
            .library(library)
            .compression(codec)
            .compression_level(level)
            // With threads, where they cut a chunk would depend on the machine.
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true)
            .create(NoSeek::new(sink.clone()))?;
        for (name, entries) in metadata {
            writer.write_metadata(&Metadata { name: name.clone(), metadata: entries.clone() })?;
        }
        Ok(Self { writer, sink, channels: vec![], message: vec![] })
    }

    /// Adds a topic and returns its number. The file has it if it has messages.
    pub fn declare(&mut self, topic: Topic) -> usize {
        self.channels.push(Channel { topic, id: None, count: 0 });
        self.channels.len() - 1
    }

    /// Number of messages of each topic so far.
    #[must_use]
    pub fn counts(&self) -> Vec<u64> {
        self.channels.iter().map(|channel| channel.count).collect()
    }

    /// Writes the messages of some samples: those of one sample after those of the sample before, in the order of `rows`.
    ///
    /// `first` is the number of the first sample. `stamps` has the time stamp of each sample and `log_times` the time by
    /// which readers order messages, both in nanoseconds since 1970.
    ///
    /// # Errors
    /// [`MessageError`] if the rows of a topic do not fit, before any message is written, or if the format cannot hold
    /// them.
    pub fn write(
        &mut self,
        first: i64,
        stamps: &[i64],
        log_times: &[u64],
        rows: &[Rows<'_>],
    ) -> Result<(), MessageError> {
        let mut cursors =
            rows.iter().map(|rows| self.cursor(first, stamps.len(), rows)).collect::<Result<Vec<_>, _>>()?;
        for ((sample, stamp), log_time) in (first..).zip(stamps).zip(log_times) {
            for cursor in &mut cursors {
                while let Some(body) = cursor.next(sample) {
                    let channel = &mut self.channels[cursor.rows.topic];
                    let id = match channel.id {
                        Some(id) => id,
                        None => *channel.id.insert(register(&mut self.writer, &channel.topic)?),
                    };
                    self.message.clear();
                    self.message.extend_from_slice(cursor.rows.head);
                    if let Some(at) = cursor.rows.stamp {
                        self.message[at..at + STAMP_SIZE].copy_from_slice(&time(*stamp));
                    }
                    self.message.extend_from_slice(body);
                    let header =
                        MessageHeader { channel_id: id, sequence: 0, log_time: *log_time, publish_time: *log_time };
                    self.writer.write_to_known_channel(&header, &self.message)?;
                    channel.count += 1;
                }
            }
        }
        Ok(())
    }

    /// The bytes that the file continues with.
    #[must_use]
    pub fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.sink.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// The bytes that the file ends with. No message may follow.
    ///
    /// # Errors
    /// [`MessageError`] if writing has failed before.
    pub fn finish(&mut self) -> Result<Vec<u8>, MessageError> {
        self.writer.finish()?;
        Ok(self.take())
    }

    fn cursor<'a>(&self, first: i64, samples: usize, rows: &Rows<'a>) -> Result<Cursor<'a>, MessageError> {
        let problem = if rows.topic >= self.channels.len() {
            Some("no such topic")
        } else if !rows.sample.is_sorted() {
            Some("samples descend")
        } else if rows.sample.first().is_some_and(|sample| *sample < first)
            || rows.sample.last().is_some_and(|sample| sample.abs_diff(first) >= samples as u64)
        {
            Some("a sample has no time stamp")
        } else if rows.stamp.is_some_and(|at| rows.head.len() < STAMP_SIZE || at > rows.head.len() - STAMP_SIZE) {
            Some("the time stamp lies behind the head")
        } else if !rows.body.has(rows.sample.len()) {
            Some("the bodies are not as many as the samples")
        } else {
            None
        };
        match problem {
            Some(problem) => Err(MessageError::Rows { topic: rows.topic, problem }),
            None => Ok(Cursor { rows: *rows, row: 0, at: 0 }),
        }
    }
}

fn register(writer: &mut Writer<NoSeek<Sink>>, topic: &Topic) -> Result<u16, McapError> {
    let schema = writer.add_schema(&topic.schema, "ros2msg", topic.definition.as_bytes())?;
    writer.add_channel(schema, &topic.name, "cdr", &topic.metadata)
}

impl Bodies<'_> {
    /// Whether these are the bodies of this many messages.
    fn has(&self, messages: usize) -> bool {
        match self {
            Self::Even(bytes) => bytes.len().checked_rem(messages).is_some_and(|rest| rest == 0) || bytes.is_empty(),
            Self::Ends(bytes, ends) => {
                ends.len() == messages && ends.is_sorted() && ends.last().copied().unwrap_or(0) == bytes.len() as u64
            }
        }
    }
}

/// A position in the messages of a topic.
struct Cursor<'a> {
    rows: Rows<'a>,
    row: usize,
    at: usize,
}

impl<'a> Cursor<'a> {
    /// The body of the next message, if it belongs to this sample.
    #[inline]
    fn next(&mut self, sample: i64) -> Option<&'a [u8]> {
        if *self.rows.sample.get(self.row)? != sample {
            return None;
        }
        let (bytes, end) = match self.rows.body {
            Bodies::Even(bytes) => (bytes, self.at + bytes.len() / self.rows.sample.len()),
            #[allow(clippy::cast_possible_truncation)] // at most the length of `bytes`
            Bodies::Ends(bytes, ends) => (bytes, ends[self.row] as usize),
        };
        let body = &bytes[self.at..end];
        (self.row, self.at) = (self.row + 1, end);
        Some(body)
    }
}

/// Seconds and nanoseconds, as messages have them.
#[allow(clippy::cast_possible_truncation)] // seconds beyond the year 2038 do not fit, which callers check
fn time(stamp: i64) -> [u8; STAMP_SIZE] {
    let (seconds, nanoseconds) = (stamp.div_euclid(SECOND) as i32, stamp.rem_euclid(SECOND) as u32);
    let mut bytes = [0; STAMP_SIZE];
    bytes[..4].copy_from_slice(&seconds.to_le_bytes());
    bytes[4..].copy_from_slice(&nanoseconds.to_le_bytes());
    bytes
}
