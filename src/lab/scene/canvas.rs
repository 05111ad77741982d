//! Linear light and depth of one moment, which the painter fills and the weather changes.

use super::light::Colour;

/// A light source.
#[derive(Clone, Copy)]
pub struct Lamp {
    /// Column and row, pixels.
    pub at: (f32, f32),
    /// Radius, pixels.
    pub radius_px: f32,
    /// Its light.
    pub colour: Colour,
}

/// Linear light on its way to the sensor.
pub struct Canvas {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[H, W]`, linear light.
    pub light: Vec<Colour>,
    /// `[H, W]`, distance in metres; infinite in the sky.
    pub depth_m: Vec<f32>,
    /// `[H, W]`, what a step reads while it replaces the light.
    pub spare: Vec<Colour>,
    /// Light sources.
    pub lamps: Vec<Lamp>,
}

impl Canvas {
    /// A canvas of `width` by `height` pixels without light.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            light: vec![[0.0; 3]; width * height],
            depth_m: vec![f32::INFINITY; width * height],
            spare: vec![[0.0; 3]; width * height],
            lamps: Vec::new(),
        }
    }
}
