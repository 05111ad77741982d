//! Mosaics of colours, as sensors give them → RGB.

/// Colours of the first two pixels of the first two rows: 0 red, 1 green, 2 blue.
pub type Colours = [[usize; 2]; 2];

pub const RGGB: Colours = [[0, 1], [1, 2]];
pub const BGGR: Colours = [[2, 1], [1, 0]];
pub const GBRG: Colours = [[1, 2], [0, 1]];
pub const GRBG: Colours = [[1, 0], [2, 1]];

/// The pixels as `[height, width, 3]`. A pixel keeps its own colour; each other colour is the mean of it among the
/// pixels around, which is bilinear interpolation. A colour that no pixel around has is 0.
pub fn rgb(rows: &[&[u8]], colours: Colours) -> Vec<u8> {
    let mut rgb = Vec::with_capacity(rows.iter().map(|row| 3 * row.len()).sum());
    for (y, row) in rows.iter().enumerate() {
        let near = &rows[y.saturating_sub(1)..(y + 2).min(rows.len())];
        let first = y.saturating_sub(1);
        for (x, &own) in row.iter().enumerate() {
            let (left, right) = (x.saturating_sub(1), (x + 2).min(row.len()));
            let (mut sums, mut counts) = ([0_u16; 3], [0_u16; 3]);
            for (dy, row) in near.iter().enumerate() {
                let of_row = colours[(first + dy) % 2];
                for (dx, &value) in row[left..right].iter().enumerate() {
                    let colour = of_row[(left + dx) % 2];
                    sums[colour] += u16::from(value);
                    counts[colour] += 1;
                }
            }
            let mut pixel = [0; 3];
            for ((mean, sum), count) in pixel.iter_mut().zip(sums).zip(counts) {
                let rounded = (sum + count / 2).checked_div(count).unwrap_or(0);
                *mean = u8::try_from(rounded).unwrap_or(u8::MAX);
            }
            pixel[colours[y % 2][x % 2]] = own;
            rgb.extend_from_slice(&pixel);
        }
    }
    rgb
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_surface_of_one_colour_is_that_colour_everywhere() {
        for colours in [RGGB, BGGR, GBRG, GRBG] {
            let rows: Vec<Vec<u8>> = (0..5)
                .map(|y| {
                    (0..6)
                        .map(|x| [200, 100, 50][colours[y % 2][x % 2]])
                        .collect()
                })
                .collect();
            let rows: Vec<&[u8]> = rows.iter().map(Vec::as_slice).collect();
            assert_eq!(
                rgb(&rows, colours),
                [200, 100, 50].repeat(30),
                "{colours:?}"
            );
        }
    }

    #[test]
    fn colours_between_pixels_are_means() {
        let rows: [&[u8]; 4] = [
            &[10, 0, 30, 0],
            &[0, 1, 0, 3],
            &[50, 0, 70, 0],
            &[0, 5, 0, 7],
        ];
        let found = rgb(&rows, RGGB);
        let red = |x: usize, y: usize| found[3 * (4 * y + x)];
        assert_eq!(
            [red(0, 0), red(1, 0), red(0, 1), red(1, 1)],
            [10, 20, 30, 40]
        );
        let blue = |x: usize, y: usize| found[3 * (4 * y + x) + 2];
        assert_eq!(
            [blue(0, 0), blue(2, 1), blue(1, 2), blue(2, 2)],
            [1, 2, 3, 4]
        );
    }

    #[test]
    fn a_single_pixel_has_its_own_colour_only() {
        assert_eq!(rgb(&[&[9]], GRBG), [0, 9, 0]);
    }
}
