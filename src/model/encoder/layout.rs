//! How activations are stored in memory: sixteen channels side by side, with room for zeros left and right of every
//! row.

/// Number of channels side by side: one vector of AVX-512, two of AVX2, four of NEON.
pub const LANES: usize = 16;

/// Activations `[height][blocks][left + width + right][LANES]`. The last block is filled up with channels of zeros.
///
/// A convolution reads the zeros beside the rows like pixels, and leaves out rows above and below the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blocked {
    /// Blocks of [`LANES`] channels.
    pub blocks: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Columns of zeros before the first column.
    pub left: usize,
    /// Columns of zeros after the last column.
    pub right: usize,
}

impl Blocked {
    /// Values from one block of a row to the next.
    #[inline(always)]
    pub fn pitch(&self) -> usize {
        (self.left + self.width + self.right) * LANES
    }

    /// Values from one row to the next.
    #[inline(always)]
    pub fn row(&self) -> usize {
        self.blocks * self.pitch()
    }

    /// Total number of values.
    pub fn len(&self) -> usize {
        self.height * self.row()
    }

    /// Range of the pixels of a block in a row.
    #[inline(always)]
    pub fn pixels(&self, y: usize, block: usize) -> std::ops::Range<usize> {
        let start = y * self.row() + block * self.pitch() + self.left * LANES;
        start..start + self.width * LANES
    }
}

/// The picture `[channels][height][left + width + right]`, with zeros left and right of every row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Planar {
    /// Colours.
    pub channels: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Columns of zeros before the first column.
    pub left: usize,
    /// Columns of zeros after the last column.
    pub right: usize,
}

impl Planar {
    /// Values from one row to the next.
    #[inline(always)]
    pub fn row(&self) -> usize {
        self.left + self.width + self.right
    }

    /// Values from one channel to the next.
    #[inline(always)]
    pub fn plane(&self) -> usize {
        self.height * self.row()
    }

    /// Total number of values.
    pub fn len(&self) -> usize {
        self.channels * self.plane()
    }

    /// Range of the pixels of a row.
    #[inline(always)]
    pub fn pixels(&self, channel: usize, y: usize) -> std::ops::Range<usize> {
        let start = channel * self.plane() + y * self.row() + self.left;
        start..start + self.width
    }
}
