//! What a run writes lines to: a file that appears whole at the end, one that grows while people read it, or a stream.

use std::io::{self, Write};

use crate::files::live_file::LiveFile;
use crate::files::whole_file::WholeFile;

/// Takes lines, each with one call of `write_all`, and is ended.
pub trait Output: Write + Send {
    /// Ends the output; what it took is then where it belongs.
    ///
    /// # Errors
    /// When it is not.
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

/// A stream that others have opened.
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
