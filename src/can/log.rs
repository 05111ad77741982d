//! A log that replaces a bus: candump log format, one frame on each line.
//!
//! `(0000000012.300000) can0 5D0#0011223344556677`, where the time is that of the drive in seconds. In a replay, the
//! file appears when it is finished. In a live run, every line is in the file as soon as it is sent.

use std::io::{self, Write};
use std::path::Path;
use std::time::Duration;

use super::{CanFrame, SinkError, WarningSink};
use crate::files::live_file::LiveFile;
use crate::files::output::{Output, Stream};
use crate::files::whole_file::WholeFile;

/// Name of the interface in the log.
pub const INTERFACE: &str = "can0";

/// Writes frames in candump log format.
pub struct LogSink {
    /// As the user gave it, for messages.
    name: String,
    out: Box<dyn Output>,
}

impl LogSink {
    /// Writes to `out`; `name` is used in error messages.
    pub fn stream(name: &str, out: impl Write + Send + 'static) -> Self {
        Self {
            name: name.to_owned(),
            out: Box::new(Stream(out)),
        }
    }

    /// Writes to a file that [`WarningSink::finish`] puts in place. It replaces an earlier file.
    ///
    /// # Errors
    /// [`SinkError::Open`] when `path` cannot be written.
    pub fn create(path: &Path) -> Result<Self, SinkError> {
        Self::of_file(path, WholeFile::create(path))
    }

    /// Writes to a file in which every line is present as soon as it is sent. An earlier file is kept beside it.
    ///
    /// # Errors
    /// [`SinkError::Open`] when `path` cannot be written.
    pub fn live(path: &Path) -> Result<Self, SinkError> {
        Self::of_file(path, LiveFile::create(path, begins_like_one))
    }

    fn of_file(path: &Path, file: io::Result<impl Output + 'static>) -> Result<Self, SinkError> {
        let name = path.display().to_string();
        match file {
            Ok(file) => Ok(Self {
                name,
                out: Box::new(file),
            }),
            Err(source) => Err(SinkError::Open { sink: name, source }),
        }
    }

    fn write(&mut self, line: &str) -> Result<(), SinkError> {
        let written = self.out.write_all(line.as_bytes());
        written.map_err(|source| SinkError::Write {
            sink: self.name.clone(),
            source,
        })
    }
}

impl WarningSink for LogSink {
    fn send(&mut self, at: Duration, frame: &CanFrame) -> Result<(), SinkError> {
        self.write(&line(at, frame.id, "#", &frame.data))
    }

    fn send_fd(&mut self, at: Duration, id: u16, data: &[u8]) -> Result<(), SinkError> {
        // After the second `#` there is a digit for flags: none.
        self.write(&line(at, id, "##0", data))
    }

    fn finish(self: Box<Self>) -> Result<(), SinkError> {
        let Self { name, out } = *self;
        let finished = out.finish();
        finished.map_err(|source| SinkError::Finish { sink: name, source })
    }
}

fn line(at: Duration, id: u16, sign: &str, data: &[u8]) -> String {
    let (seconds, micros) = (at.as_secs(), at.subsec_micros());
    let bytes: String = data.iter().map(|byte| format!("{byte:02X}")).collect();
    format!("({seconds:010}.{micros:06}) {INTERFACE} {id:03X}{sign}{bytes}\n")
}

/// Whether a file that begins like this is a CAN log.
pub fn begins_like_one(head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head);
    let stamp = text.strip_prefix('(').and_then(|rest| rest.split_once(')'));
    stamp.is_some_and(|(stamp, _)| stamp.parse::<f64>().is_ok())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::fs;
    use std::io::ErrorKind;
    use tempfile::TempDir;

    const FRAME: CanFrame = CanFrame {
        id: 0x5D0,
        data: [0x00, 0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77],
    };
    const LINE: &str = "(0000000012.300000) can0 5D0#0011223344556677\n";

    fn send(sink: &mut LogSink) {
        sink.send(Duration::from_millis(12_300), &FRAME).unwrap();
    }

    fn names_in(folder: &TempDir) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn line_is_that_of_candump() {
        let at = Duration::from_millis(12_300);
        assert_eq!(line(at, FRAME.id, "#", &FRAME.data), LINE);
        let wanted = "(0000000000.000001) can0 01F##0FF001A\n";
        let at = Duration::from_nanos(1_999);
        assert_eq!(line(at, 0x01F, "##0", &[0xFF, 0, 0x1A]), wanted);
    }

    #[test]
    fn finished_log_takes_the_place_of_the_old_one() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("drive.log");
        fs::write(&path, "old").unwrap();
        let mut sink = LogSink::create(&path).unwrap();
        send(&mut sink);
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        Box::new(sink).finish().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), LINE);
        assert_eq!(names_in(&folder), ["drive.log"]);
    }

    #[test]
    fn unfinished_log_leaves_nothing_behind() {
        let folder = TempDir::new().unwrap();
        let mut sink = LogSink::create(&folder.path().join("drive.log")).unwrap();
        send(&mut sink);
        drop(sink);
        assert!(names_in(&folder).is_empty());
    }

    #[test]
    fn target_that_cannot_be_written_is_reported_at_once() {
        let folder = TempDir::new().unwrap();
        for target in [
            folder.path().join("missing/drive.log"),
            folder.path().into(),
        ] {
            let error = LogSink::create(&target).err().unwrap();
            assert!(matches!(error, SinkError::Open { .. }), "{error:?}");
            let line = error.to_string();
            assert!(line.contains(target.to_str().unwrap()), "{line}");
        }
        assert!(names_in(&folder).is_empty());
    }

    #[test]
    fn refused_write_names_the_sink() {
        struct Full;
        impl Write for Full {
            fn write(&mut self, _: &[u8]) -> io::Result<usize> {
                Err(ErrorKind::StorageFull.into())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let mut sink = LogSink::stream("log:-", Full);
        let error = sink.send(Duration::ZERO, &FRAME).unwrap_err();
        assert!(error.to_string().ends_with("CAN sink log:-"), "{error}");
    }
}
