//! Paints upright panels between two points of the road.

use super::canvas::Canvas;
use super::light::{Colour, blended};
use super::moment::Moment;
use super::road::Node;

/// Where the end of something that stands along the road is in the picture, pixels.
pub(super) struct Corner {
    pub x: f32,
    pub top: f32,
    pub foot: f32,
    pub z_m: f32,
}

/// The pixels between two places, inside `limit`.
pub(super) fn pixels(from: f32, to: f32, limit: usize) -> std::ops::Range<usize> {
    let inside = |v: f32| v.clamp(0.0, limit as f32);
    inside((from - 0.5).ceil()) as usize..inside((to + 0.5).floor()) as usize
}

impl Moment<'_> {
    /// The foot and the top of what stands at the offset `d_m` beside a point of the road, between two heights.
    pub(super) fn corner(&self, node: &Node, d_m: f32, heights_m: (f32, f32)) -> Corner {
        let x_m = d_m + node.lateral_m - self.pose.sway_m - self.drive.camera.aside_m;
        Corner {
            x: self.projection.column(x_m, node.z_m),
            top: self.projection.row(node.rise_m + heights_m.1, node.z_m),
            foot: self.projection.row(node.rise_m + heights_m.0, node.z_m),
            z_m: node.z_m,
        }
    }

    /// Paints what stands between a near and a far corner. `column` gives what is the same in a column of the picture
    /// from its distance, and `colour` the colour at a share of the height; both edges are softened.
    pub(super) fn paint_panel<T>(
        &self,
        [near, far]: &[Corner; 2],
        canvas: &mut Canvas,
        mask: &mut [u8],
        column: impl Fn(f32) -> T,
        colour: impl Fn(&T, f32) -> Option<Colour>,
    ) {
        let (left, right) = (near.x.min(far.x), near.x.max(far.x));
        let crest = self.view.crest(near.z_m);
        for x in pixels(left - 0.5, right + 0.5, canvas.width) {
            let across = ((x as f32 + 0.5 - near.x) / (far.x - near.x)).clamp(0.0, 1.0);
            let across = if across.is_nan() { 0.0 } else { across };
            let at = |near: f32, far: f32| near + across * (far - near);
            let (top, foot) = (at(near.top, far.top), at(near.foot, far.foot).min(crest));
            // Along a line in the picture, distances are evenly spaced in 1/z.
            let z_m = 1.0 / at(1.0 / near.z_m, 1.0 / far.z_m);
            let column = column(z_m);
            for y in pixels(top - 0.5, foot + 0.5, canvas.height) {
                let cover = (foot.min(y as f32 + 1.0) - top.max(y as f32)).clamp(0.0, 1.0);
                let up = (foot - (y as f32 + 0.5)) / (foot - top).max(0.1);
                let Some(colour) = colour(&column, up.clamp(0.0, 1.0)) else {
                    continue;
                };
                let pixel = y * canvas.width + x;
                canvas.light[pixel] = blended(canvas.light[pixel], colour, cover);
                if cover > 0.5 {
                    canvas.depth_m[pixel] = z_m;
                    mask[pixel] = 0;
                }
            }
        }
    }
}
