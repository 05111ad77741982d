//! Frames over time → whether the camera works, before the frames are judged.
//!
//! It detects what no road can produce: a picture that does not change by a single bit; a lens that is black over more
//! than half of its area, or without any structure and motion over more than 60 % of it, and over more than half of the
//! road before the car; and frames whose numbers or times do not increase. On an unlit night, sky, roadsides and bonnet are
//! black, but the headlights show the road. It does not judge light and weather: night, fog, rain, glare, blur and dirt are gaps, and a
//! fault would hide them. A test checks this on rendered drives.

use std::ops::Range;
use std::time::Duration;

use crate::capture::pixels::Pixels;
use crate::capture::undefined::Undefined;
use crate::capture::{Frame, Place};
use crate::model::vectors::Vectors;

/// A picture that stays the same for this long is frozen, because the noise of a sensor changes every frame. The alarm
/// waits for the same time again. Our own choice.
const FROZEN: Duration = Duration::from_millis(500);
/// After a pause longer than this between two frames, and longer than two periods of the slowest frames, the time for
/// which a picture has been the same is counted anew.
const HOLE: Duration = Duration::from_secs(1);
/// Blocks across and down, for the share of the lens that is covered.
const BLOCKS: (usize, usize) = (16, 8);
/// Cells across and down in a block: their means distinguish structure from a sensor's noise.
const CELLS: usize = 4;
/// A block whose brightest value is at most this is covered; a whole picture with this limit is black.
const BLACK_MAX: u8 = 8;
/// If more than this share of the blocks are black, the lens is covered.
const COVERED_PERCENT: usize = 50;
/// Cells of a covered block differ by at most this from each other, and from their values at the beginning.
const FLAT_MAX: u8 = 4;
/// A block without structure and motion for this long is covered.
const STILL: Duration = Duration::from_secs(1);
/// If more than this share of the blocks are without structure and motion, the lens is covered. Fog and tunnels do this
/// to half of a picture, which is everything above the road, also at severity 5.
const STILL_PERCENT: usize = 60;

/// Columns and rows of blocks in which the road before the car is.
const ROAD: (Range<usize>, Range<usize>) = (4..12, 4..7);
/// If more than this share of these blocks show nothing, the road is hidden.
const ROAD_PERCENT: usize = 50;

/// Number of rows whose brightness can be added up without an overflow.
const ROWS_MAX: usize = 257;

/// Remembers the last picture, and for each block since when it has looked the same. In a camera's own format, it looks
/// only at brightness.
#[derive(Debug)]
pub struct CameraHealth {
    hole: Duration,
    last: Option<Pixels>,
    /// When the last picture was first seen.
    since: Duration,
    /// Sums over some rows.
    columns: Vec<Column>,
    cells: Vec<Cell>,
    blocks: Vec<Block>,
    /// Number and time of the last frame.
    before: Option<(u64, Duration)>,
}

/// A part of the picture.
#[derive(Clone, Copy, Debug, Default)]
struct Block {
    black: bool,
    cells: [u8; CELLS * CELLS],
    /// Values of the cells when the block began to be without structure and motion, and when that was.
    began: Option<([u8; CELLS * CELLS], Duration)>,
}

impl Default for CameraHealth {
    fn default() -> Self {
        Self::with_frames_every(Duration::ZERO)
    }
}

impl CameraHealth {
    /// For a camera whose frames may come as slowly as one every `period`.
    pub fn with_frames_every(period: Duration) -> Self {
        Self {
            hole: HOLE.max(2 * period),
            last: None,
            since: Duration::ZERO,
            columns: Vec::new(),
            cells: Vec::new(),
            blocks: Vec::new(),
            before: None,
        }
    }

    /// Checks whether a frame may be judged. A frame without a picture is not checked.
    ///
    /// # Errors
    /// `OutOfOrder`, `Frozen` or `Covered`.
    pub fn check(&mut self, frame: &Frame) -> Result<(), Undefined> {
        let silence = self.check_order(frame)?;
        let Ok(pixels) = &frame.picture else {
            return Ok(());
        };
        // A camera that gave no frames for a long time may begin again with the last picture.
        if silence > self.hole {
            self.last = None;
            self.blocks.clear();
        }
        if self.last.as_ref() == Some(pixels) {
            let still = frame.captured_at.saturating_sub(self.since);
            // A picture of one colour has a reason of its own (`Uniform`).
            if still >= FROZEN && !pixels.is_uniform() {
                return Err(Undefined::Frozen(still));
            }
        } else {
            self.last = Some(pixels.clone());
            self.since = frame.captured_at;
        }
        self.look_at_blocks(frame.captured_at, pixels);
        let is_still = |block: &Block| {
            let since = |began: &([u8; CELLS * CELLS], Duration)| {
                frame.captured_at.saturating_sub(began.1) >= STILL
            };
            block.black || block.began.as_ref().is_some_and(since)
        };
        let black = share(self.blocks.iter(), |block| block.black);
        let still = share(self.blocks.iter(), is_still);
        let road =
            self.blocks.iter().enumerate().filter(|(n, _)| {
                ROAD.0.contains(&(n % BLOCKS.0)) && ROAD.1.contains(&(n / BLOCKS.0))
            });
        let hides_road = share(road.map(|(_, block)| block), is_still) > ROAD_PERCENT;
        let covered = hides_road && (black > COVERED_PERCENT || still > STILL_PERCENT);
        // A picture that is all black has a reason of its own too.
        if covered && black < 100 && !pixels.is_uniform() {
            let percent = u8::try_from(black.max(still)).unwrap_or(100);
            return Err(Undefined::Covered { percent });
        }
        Ok(())
    }

    /// Checks that numbers and times of frames increase; returns the time since the frame before.
    fn check_order(&mut self, frame: &Frame) -> Result<Duration, Undefined> {
        let place = |number, at| Place {
            number,
            at: Some(at),
        };
        let (number, at) = (frame.sequence, frame.captured_at);
        match self.before.replace((number, at)) {
            Some((before, then)) if place(number, at).is_after(place(before, then)) => {
                Ok(at - then)
            }
            Some((before, _)) => Err(Undefined::OutOfOrder { number, before }),
            None => Ok(Duration::ZERO),
        }
    }

    fn look_at_blocks(&mut self, now: Duration, pixels: &Pixels) {
        let (across, down) = (BLOCKS.0 * CELLS, BLOCKS.1 * CELLS);
        let layout = pixels.layout();
        let (width, height) = (layout.width as usize, layout.height as usize);
        if width < across || height < down {
            self.blocks.clear();
            return;
        }
        self.blocks.resize(BLOCKS.0 * BLOCKS.1, Block::default());
        self.cells.clear();
        self.cells.resize(across * down, Cell::default());
        let brightness = pixels.brightness();
        let columns = width * brightness.a_pixel / brightness.step;
        self.columns.resize(columns, Column::default());
        let row_of = |cell: usize| cell * height / down;
        let kernel = Vectors::fastest();
        for (n, cells) in self.cells.chunks_exact_mut(across).enumerate() {
            let rows = row_of(n)..row_of(n + 1);
            for some in rows.clone().step_by(ROWS_MAX) {
                let some = some..rows.end.min(some + ROWS_MAX);
                let (rows, columns) = (some.clone(), &mut self.columns);
                kernel.vectorised(
                    #[inline(always)]
                    || match brightness.step {
                        2 => add_up::<2, 64>(pixels, rows, columns),
                        _ => add_up::<1, 64>(pixels, rows, columns),
                    },
                );
                let a_pixel = brightness.a_pixel / brightness.step;
                for (column, cell) in cells.iter_mut().enumerate() {
                    let edge = |column: usize| column * width / across * a_pixel;
                    let columns = &self.columns[edge(column)..edge(column + 1)];
                    cell.values += (some.len() * columns.len()) as u64;
                    for column in columns {
                        cell.sum += u64::from(column.sum);
                        cell.brightest = cell.brightest.max(column.brightest);
                    }
                }
            }
        }
        for (n, block) in self.blocks.iter_mut().enumerate() {
            let (left, top) = (n % BLOCKS.0 * CELLS, n / BLOCKS.0 * CELLS);
            let mut brightest = 0;
            for (at, mean) in block.cells.iter_mut().enumerate() {
                let cell = &self.cells[(top + at / CELLS) * across + left + at % CELLS];
                *mean = brightness.of_255(cell.sum / cell.values.max(1));
                brightest = brightest.max(brightness.of_255(cell.brightest.into()));
            }
            block.black = brightest <= BLACK_MAX;
            block.keep_or_begin(now);
        }
    }
}

/// Share of blocks, per cent, rounded up; 0 of none.
fn share<'a>(blocks: impl Iterator<Item = &'a Block>, is: impl Fn(&Block) -> bool) -> usize {
    let (mut all, mut count) = (0, 0);
    for block in blocks {
        all += 1;
        count += usize::from(is(block));
    }
    (100 * count).div_ceil(all.max(1))
}

/// Brightness in one column of some rows.
#[derive(Clone, Copy, Debug, Default)]
struct Column {
    sum: u16,
    brightest: u8,
}

/// Adds up rows in which every `STEP`-th byte counts, `BYTES` bytes of each row at a time.
#[inline(always)]
fn add_up<const STEP: usize, const BYTES: usize>(
    pixels: &Pixels,
    rows: Range<usize>,
    columns: &mut [Column],
) {
    let stride = pixels.layout().stride as usize;
    for (block, columns) in columns.chunks_mut(BYTES / STEP).enumerate() {
        let (mut sums, mut brightest) = ([0_u16; BYTES], [0_u8; BYTES]);
        let used = STEP * columns.len();
        for row in rows.clone() {
            let bytes = &pixels.bytes()[row * stride + block * BYTES..];
            let sums = sums.iter_mut().zip(&mut brightest);
            let add = |bytes: &[u8]| {
                for ((sum, brightest), &byte) in sums.zip(bytes) {
                    *sum += u16::from(byte);
                    *brightest = (*brightest).max(byte);
                }
            };
            // Most blocks are complete, and this form lets the compiler know their size.
            match bytes.first_chunk::<BYTES>() {
                Some(whole) => add(whole),
                None => add(&bytes[..used]),
            }
        }
        for (at, column) in columns.iter_mut().enumerate() {
            (column.sum, column.brightest) = (sums[STEP * at], brightest[STEP * at]);
        }
    }
}

/// Sums over a part of a block.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    sum: u64,
    values: u64,
    brightest: u8,
}

impl Block {
    fn keep_or_begin(&mut self, now: Duration) {
        let darkest = self.cells.iter().min().copied().unwrap_or(0);
        let brightest = self.cells.iter().max().copied().unwrap_or(0);
        let flat = brightest - darkest <= FLAT_MAX;
        let unmoved = |(cells, _): &([u8; CELLS * CELLS], Duration)| {
            let mut pairs = cells.iter().zip(&self.cells);
            pairs.all(|(then, now)| then.abs_diff(*now) <= FLAT_MAX)
        };
        if !flat {
            self.began = None;
        } else if !self.began.as_ref().is_some_and(unmoved) {
            self.began = Some((self.cells, now));
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::cast_possible_truncation)]
    use super::*;
    use crate::capture::pixels::{Layout, PixelFormat};
    use crate::capture::{Picture, open};

    fn frame(millis: u64, value: impl Fn(u32, u32) -> u8) -> Frame {
        let (width, height) = (64, 32);
        let rgb = (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .flat_map(|(x, y)| [value(x, y); 3])
            .collect();
        Frame {
            sequence: millis / 100,
            captured_at: Duration::from_millis(millis),
            picture: Ok(Picture { width, height, rgb }.into()),
        }
    }

    #[test]
    fn a_picture_that_stays_the_same_for_half_a_second_is_frozen_until_it_changes() {
        let mut health = CameraHealth::default();
        let still = |millis| frame(millis, |x, _| 100 + u8::try_from(x).unwrap());
        for millis in (0..500).step_by(100) {
            assert_eq!(health.check(&still(millis)), Ok(()), "{millis} ms");
        }
        for millis in (500..5_000).step_by(100) {
            let frozen = Undefined::Frozen(Duration::from_millis(millis));
            assert_eq!(health.check(&still(millis)), Err(frozen));
        }
        let moved = frame(5_100, |x, y| u8::from(x + y == 3) + 100);
        assert_eq!(health.check(&moved), Ok(()));
        assert_eq!(health.check(&still(5_200)), Ok(()));
        // Nothing came for 2 s, and then the same picture.
        assert_eq!(health.check(&still(7_200)), Ok(()));
        assert_eq!(health.check(&still(7_600)), Ok(()));
        let frozen = Undefined::Frozen(Duration::from_millis(500));
        assert_eq!(health.check(&still(7_700)), Err(frozen));
    }

    #[test]
    fn a_hole_begins_after_its_second_not_with_it() {
        let mut health = CameraHealth::default();
        let still = |millis| frame(millis, |x, _| 100 + u8::try_from(x).unwrap());
        assert_eq!(health.check(&still(0)), Ok(()));
        assert_eq!(health.check(&still(1_000)), Err(Undefined::Frozen(HOLE)));
        assert_eq!(health.check(&still(2_001)), Ok(()));
    }

    #[test]
    fn a_frozen_picture_is_found_at_slow_rates_too() {
        for period in [500, 1_000, 3_000] {
            let slow = Duration::from_millis(period);
            let mut health = CameraHealth::with_frames_every(slow);
            for n in 0..5 {
                // A little slower than specified, as cameras are.
                let mut frame = frame(n * (period + 30), |x, _| 100 + u8::try_from(x).unwrap());
                frame.sequence = n;
                assert_eq!(
                    health.check(&frame).is_err(),
                    n > 0,
                    "{period} ms, frame {n}"
                );
            }
        }
    }

    #[test]
    fn a_lens_is_covered_when_more_than_half_of_it_is_black() {
        let covered_to = |millis, edge| {
            frame(millis, move |x, y| {
                if x < edge {
                    5
                } else {
                    u8::try_from(60 + x + y).unwrap()
                }
            })
        };
        let mut health = CameraHealth::default();
        assert_eq!(health.check(&covered_to(0, 0)), Ok(()));
        assert_eq!(health.check(&covered_to(100, 32)), Ok(()));
        assert_eq!(
            health.check(&covered_to(200, 36)),
            Err(Undefined::Covered { percent: 57 })
        );
        // An all black picture is recognised by its brightness.
        let black = frame(300, |x, y| u8::try_from((x + y) % 4).unwrap());
        assert_eq!(health.check(&black), Ok(()));
    }

    #[test]
    fn an_unlit_night_shows_the_road_and_a_hand_before_it_does_not() {
        // Black sky, roadsides and bonnet, and a cone of headlights in the middle, with the road moving through it.
        let night = |millis: u64, lit: std::ops::Range<u32>| {
            frame(millis, move |x, y| {
                let in_cone = lit.contains(&x) && (15..28).contains(&y);
                let road = 30 + (x * 7 + y * 11 + millis as u32 / 20) % 60;
                if in_cone { road as u8 } else { 3 }
            })
        };
        let mut health = CameraHealth::default();
        for n in 0..30 {
            assert_eq!(health.check(&night(100 * n, 16..48)), Ok(()), "{n}");
        }
        // The same night, and something before three quarters of the cone.
        let covered = health.check(&night(3_000, 40..48));
        assert!(
            matches!(covered, Err(Undefined::Covered { .. })),
            "{covered:?}"
        );
    }

    #[test]
    fn a_lens_covered_by_something_bright_is_told_after_a_second_without_motion() {
        // A little noise where the lens is covered, and a moving road beside it.
        let noise = |millis: u64, x: u32, y: u32| {
            let mixed = (millis / 100) as u32 * 7_919 + x * 104_729 + y * 1_299_709;
            u8::try_from(mixed / 13 % 4).unwrap()
        };
        // A block is 4x4 pixels; one more column of blocks in the upper half.
        let covered_to = |millis: u64, edge: u32, more: u32| {
            frame(millis, move |x, y| {
                if x < edge || (y < 16 && x < edge + more) {
                    180 + noise(millis, x, y)
                } else {
                    u8::try_from((x * 5 + y * 3 + millis as u32 / 10) % 200).unwrap()
                }
            })
        };
        let told = |edge, more| {
            let mut health = CameraHealth::default();
            let mut found =
                (0..30).map(|n| (100 * n, health.check(&covered_to(100 * n, edge, more))));
            found.find_map(|(at, found)| Some((at, found.err()?)))
        };
        assert_eq!(told(36, 0), None);
        // 76 of 128 blocks: not more than 60 %.
        assert_eq!(told(36, 4), None);
        let covered = Undefined::Covered { percent: 63 };
        assert_eq!(told(40, 0), Some((1_000, covered)));
    }

    /// Noise, which has only low values in every third part of the picture, with padding after the rows.
    fn noise(format: PixelFormat, width: u32, height: u32) -> Pixels {
        let row_bytes = match format {
            PixelFormat::Yuyv => 2 * width.next_multiple_of(2),
            PixelFormat::Nv12 => width.next_multiple_of(2),
            _ => 3 * width,
        };
        let stride = row_bytes + 10;
        let rows = height + height.div_ceil(2);
        let bytes: Vec<u8> = (0..rows * stride)
            .map(|n| {
                let mixed = n.wrapping_mul(2_654_435_761) >> 7;
                let part = n % stride * 5 / stride + n / stride * 7 / height;
                (mixed % if part.is_multiple_of(3) { 24 } else { 256 }) as u8
            })
            .collect();
        let layout = Layout {
            format,
            width,
            height,
            stride,
        };
        layout.pixels(&bytes).unwrap()
    }

    #[test]
    fn blocks_are_those_of_plain_loops_in_every_format_and_size() {
        let formats = [
            PixelFormat::Yuyv,
            PixelFormat::Nv12,
            PixelFormat::Rgb3,
            PixelFormat::Bgr3,
        ];
        // The last one has more rows in a cell than can be added up in one step.
        for (width, height) in [(64, 32), (67, 35), (130, 71), (64, 8_320)] {
            for format in formats {
                let pixels = noise(format, width, height);
                let (width, height) = (width as usize, height as usize);
                let brightness = pixels.brightness();
                let rows: Vec<&[u8]> = pixels.rows().collect();
                let mut health = CameraHealth::default();
                health.look_at_blocks(Duration::ZERO, &pixels);
                assert_eq!(health.blocks.len(), 16 * 8);
                let mut black = 0;
                for (n, block) in health.blocks.iter().enumerate() {
                    let mut brightest = 0;
                    for (at, found) in block.cells.iter().enumerate() {
                        let (column, row) = (n % 16 * 4 + at % 4, n / 16 * 4 + at / 4);
                        let (mut sum, mut count) = (0, 0);
                        for row in &rows[row * height / 32..(row + 1) * height / 32] {
                            for x in column * width / 64..(column + 1) * width / 64 {
                                let values = match format {
                                    PixelFormat::Yuyv => &row[2 * x..=2 * x],
                                    PixelFormat::Nv12 => &row[x..=x],
                                    _ => &row[3 * x..3 * x + 3],
                                };
                                for &value in values {
                                    sum += u64::from(value);
                                    count += 1;
                                    brightest = brightest.max(value);
                                }
                            }
                        }
                        let wanted = brightness.of_255(sum / count);
                        assert_eq!(*found, wanted, "{format:?} {width}x{height}: {n}, {at}");
                    }
                    let wanted = brightness.of_255(brightest.into()) <= BLACK_MAX;
                    assert_eq!(block.black, wanted, "{format:?} {width}x{height}: {n}");
                    black += usize::from(wanted);
                }
                let low = format == PixelFormat::Yuyv || format == PixelFormat::Nv12;
                assert!(!low || (1..128).contains(&black), "{black} black blocks");
            }
        }
    }

    #[test]
    fn pictures_with_fewer_pixels_than_cells_have_no_blocks() {
        let mut health = CameraHealth::default();
        for (width, height, blocks) in [
            (64, 32, 128),
            (63, 32, 0),
            (64, 31, 0),
            (200, 31, 0),
            (63, 200, 0),
        ] {
            let pixels = noise(PixelFormat::Rgb3, width, height);
            health.look_at_blocks(Duration::ZERO, &pixels);
            assert_eq!(health.blocks.len(), blocks, "{width}x{height}");
        }
    }

    #[test]
    fn numbers_and_times_that_do_not_go_on_are_refused_and_gaps_are_not() {
        let mut health = CameraHealth::default();
        let mut check = |sequence, millis| {
            let frame = Frame {
                sequence,
                ..frame(millis, |x, _| {
                    u8::try_from(x).unwrap().wrapping_add(millis as u8)
                })
            };
            health.check(&frame).is_ok()
        };
        assert!(check(3, 100) && check(4, 200) && check(90, 300));
        assert!(!check(90, 400));
        assert!(check(91, 500));
        assert!(!check(60, 600));
        assert!(check(61, 700));
        assert!(!check(62, 650));
        // Both must increase.
        assert!(!check(63, 650));
        assert!(check(64, 651));
        assert!(!check(64, 652));
        assert!(check(65, 653));
    }

    #[test]
    #[cfg(feature = "lab")]
    fn weather_light_and_dirt_up_to_severity_4_are_no_fault() {
        crate::lab::register();
        for kind in [
            "night", "fog", "rain", "glare", "blur", "dirt", "snow", "tunnel", "noise",
        ] {
            for look in ["sim", "sim-realistic", "game"] {
                for seed in [5, 6] {
                    let drive = format!("seed={seed}&seconds=2&fps=10&condition={kind}:4");
                    let name = format!("scene:{look}?{drive}");
                    let mut source = open(&name).unwrap();
                    let mut health = CameraHealth::default();
                    while let Some(frame) = source.next_frame().unwrap() {
                        assert_eq!(health.check(&frame), Ok(()), "{name}");
                        let black = health.blocks.iter().filter(|block| block.black).count();
                        assert!(4 * black < health.blocks.len(), "{name}: {black} blocks");
                    }
                }
            }
        }
    }
}
