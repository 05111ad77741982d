//! The shade of trees and bridges on a road that changes.

/// The shade that falls on a place of the road.
#[derive(Clone, Copy, Default)]
pub struct Shade {
    /// Of trees, 0 to 1.
    pub canopy: f32,
    /// Of a bridge, 0 to 1.
    pub roof: f32,
}

impl Shade {
    /// Light that reaches an upright object, as a share of that in the open.
    pub fn left(self) -> f32 {
        (1.0 - 0.55 * self.canopy) * (1.0 - 0.6 * self.roof)
    }
}
