//! Energies as pictures: a colour map in which brighter is more, and panels over what the model sees.

use crate::capture::Picture;
use crate::features::attention::{EnergyMap, Upsampler};
use crate::features::energies::{CELLS, GRID};
use crate::features::lane::LaneMask;

/// Points of the colour map, sRGB: black, violet, red, orange, pale yellow, at equal distances; lightness always
/// increases.
const STATIONS: [[f32; 3]; 5] = [
    [0.0, 0.0, 10.0],
    [90.0, 20.0, 120.0],
    [205.0, 65.0, 75.0],
    [250.0, 150.0, 35.0],
    [255.0, 250.0, 190.0],
];

/// Deviation from which on a region has the brightest colour, nominal spreads.
const DEVIATION_SHOWN: f64 = 8.0;

/// Colour of lanes in overlays: a blue-green that no road has, and that can be distinguished from red with all kinds of
/// colour blindness.
const LANE_COLOUR: [f32; 3] = [0.0, 220.0, 210.0];

/// The colour of a share of the peak, `share` from 0 to 1.
pub fn colour(share: f32) -> [f32; 3] {
    // It is within 0..=4, because there are five points.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss
    )]
    let (low, t) = {
        let at = share.clamp(0.0, 1.0) * 4.0;
        let low = (at as usize).min(3);
        (low, at - low as f32)
    };
    blended(STATIONS[low], STATIONS[low + 1], t)
}

/// A picture with lanes coloured in; `mask` has the picture's size.
pub fn with_lanes(picture: &Picture, mask: &LaneMask) -> Picture {
    let mut shown = picture.clone();
    for (pixel, &lane) in shown.rgb.chunks_exact_mut(3).zip(&mask.lane) {
        if lane {
            paint(pixel, LANE_COLOUR, 0.65);
        }
    }
    shown
}

/// Energies over the darkened picture: each map from 0 to its own peak, interpolated to the picture's size.
pub fn with_energy(picture: &Picture, energy: &EnergyMap) -> Picture {
    let mut shown = picture.clone();
    let size = (picture.width as usize, picture.height as usize);
    let mut large = EnergyMap::default();
    Upsampler::new((energy.width, energy.height), size).resample(energy, &mut large);
    let peak = energy.range().1.max(f64::MIN_POSITIVE);
    for (pixel, g) in shown.rgb.chunks_exact_mut(3).zip(&large.energy) {
        #[allow(clippy::cast_possible_truncation)]
        let share = (g / peak) as f32;
        paint(pixel, [0.0; 3], 0.5);
        paint(pixel, colour(share), (0.1 + 1.5 * share).min(0.9));
    }
    shown
}

/// How far each region is from nominal, over the darkened picture: a larger deviation is brighter, and
/// `DEVIATION_SHOWN` nominal spreads or more are brightest. `deviations` are row by row of the coarse grid.
pub fn with_regions(picture: &Picture, deviations: &[f64; CELLS]) -> Picture {
    let mut shown = picture.clone();
    let (width, height) = (picture.width as usize, picture.height as usize);
    for (place, pixel) in shown.rgb.chunks_exact_mut(3).enumerate() {
        let (x, y) = (place % width.max(1), place / width.max(1));
        let (column, row) = (x * GRID / width, y * GRID / height);
        let of = |x: usize, y: usize| (x * GRID / width, y * GRID / height);
        // A dark line between regions.
        let edge = of(x.saturating_sub(1), y) != (column, row)
            || of(x, y.saturating_sub(1)) != (column, row);
        #[allow(clippy::cast_possible_truncation)]
        let share = (deviations[row * GRID + column].abs() / DEVIATION_SHOWN).min(1.0) as f32;
        paint(pixel, [0.0; 3], if edge { 1.0 } else { 0.5 });
        if !edge {
            paint(pixel, colour(share), (0.1 + share).min(0.8));
        }
    }
    shown
}

/// Panels side by side, `columns` in each row, each enlarged `scale` times; all have the size of the first.
pub fn sheet(panels: &[Picture], columns: usize, scale: usize) -> Picture {
    let Some(first) = panels.first() else {
        return Picture {
            width: 0,
            height: 0,
            rgb: Vec::new(),
        };
    };
    let (width, height) = (first.width as usize, first.height as usize);
    let columns = columns.min(panels.len()).max(1);
    let rows = panels.len().div_ceil(columns);
    let (wide, high) = (columns * width * scale, rows * height * scale);
    let mut rgb = vec![0; 3 * wide * high];
    for (index, panel) in panels.iter().enumerate() {
        let (left, top) = (
            index % columns * width * scale,
            index / columns * height * scale,
        );
        for y in 0..height * scale {
            for x in 0..width * scale {
                let from = 3 * (y / scale * width + x / scale);
                let to = 3 * ((top + y) * wide + left + x);
                rgb[to..to + 3].copy_from_slice(&panel.rgb[from..from + 3]);
            }
        }
    }
    // Both are calculated from sizes of pictures that fit into 32 bits.
    #[allow(clippy::cast_possible_truncation)]
    Picture {
        width: wide as u32,
        height: high as u32,
        rgb,
    }
}

fn paint(pixel: &mut [u8], colour: [f32; 3], opacity: f32) {
    for (value, colour) in pixel.iter_mut().zip(colour) {
        let mixed = f32::from(*value) + (colour - f32::from(*value)) * opacity;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        {
            *value = mixed.round().clamp(0.0, 255.0) as u8;
        }
    }
}

fn blended(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    [0, 1, 2].map(|c| a[c] + (b[c] - a[c]) * t)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::cast_precision_loss)]
    use super::*;

    #[test]
    fn more_energy_is_always_brighter() {
        // Relative luminance of sRGB, ITU-R BT.709.
        let luminance = |share: f32| {
            let linear = colour(share).map(|c| (c / 255.0).powf(2.2));
            0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
        };
        for i in 0..100 {
            let share = i as f32 / 100.0;
            assert!(luminance(share + 0.01) > luminance(share), "at {share}");
        }
    }

    #[test]
    fn the_hottest_cell_is_the_brightest_place_of_the_panel() {
        let picture = Picture {
            width: 4,
            height: 2,
            rgb: vec![100; 24],
        };
        let mut energy = EnergyMap {
            width: 4,
            height: 2,
            energy: vec![1.0; 8],
        };
        energy.energy[6] = 50.0;
        let shown = with_energy(&picture, &energy);
        let sums: Vec<u32> = shown
            .rgb
            .chunks_exact(3)
            .map(|p| p.iter().map(|&v| u32::from(v)).sum())
            .collect();
        assert!((0..8).all(|i| i == 6 || sums[i] < sums[6]), "{sums:?}");
    }

    #[test]
    fn the_region_that_differs_most_is_the_brightest() {
        let picture = Picture {
            width: 16,
            height: 8,
            rgb: vec![100; 3 * 16 * 8],
        };
        let mut deviations = [1.0; CELLS];
        deviations[GRID + 2] = -6.0;
        let shown = with_regions(&picture, &deviations);
        // The middles of the region at row 1, column 2 and of its neighbours.
        let sum = |x: usize, y: usize| -> u32 {
            shown.rgb[3 * (16 * y + x)..][..3]
                .iter()
                .map(|&v| u32::from(v))
                .sum()
        };
        let others = [(6, 3), (14, 3), (10, 1), (10, 5)];
        assert!(others.iter().all(|&(x, y)| sum(x, y) < sum(10, 3)));
    }

    #[test]
    fn a_sheet_holds_its_panels_in_rows() {
        let panel = |value| Picture {
            width: 2,
            height: 1,
            rgb: vec![value; 6],
        };
        let sheet = sheet(&[panel(1), panel(2), panel(3)], 2, 2);
        assert_eq!((sheet.width, sheet.height), (8, 4));
        assert_eq!(
            (sheet.rgb[0], sheet.rgb[3 * 4], sheet.rgb[3 * 8 * 2]),
            (1, 2, 3)
        );
        assert_eq!(sheet.rgb[3 * (8 * 2 + 4)], 0);
    }
}
