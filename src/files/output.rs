//! Outputs for lines: a file that appears whole at the end, a file that grows while it is read, or a stream.

use std::io::{self, Write};

use crate::files::live_file::LiveFile;
use crate::files::whole_file::WholeFile;

/// Accepts lines, each with one call of `write_all`, and is then finished.
pub trait Output: Write + Send {
    /// Ends the output. Everything that was written is then in its place.
    ///
    /// # Errors
    /// When this is not the case.
    fn finish(self: Box<Self>) -> io::Result<()>;
}

impl Output for WholeFile {
    fn finish(self: Box<Self>) -> io::Result<()> {
        WholeFile::finish(*self)
    }
}

impl Output for LiveFile {
    fn finish(self: Box<Self>) -> io::Result<()> {
        LiveFile::finish(*self)
    }
}

/// A stream that the caller has opened.
pub struct Stream<W>(pub W);

impl<W: Write> Write for Stream<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl<W: Write + Send> Output for Stream<W> {
    fn finish(mut self: Box<Self>) -> io::Result<()> {
        self.0.flush()
    }
}
