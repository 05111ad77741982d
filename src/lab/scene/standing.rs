//! Paints the objects on the road and beside it, the farthest first: vehicles, rails, trees, buildings, posts.

use super::canvas::{Canvas, Lamp};
use super::light::{Colour, blended, scaled};
use super::moment::Moment;
use super::noise::value_noise;
use super::surroundings::{ObjectKind, Rail, RoadsideObject};
use super::textures::SNOW;
use super::traffic::Vehicle;

/// An object, with its distance beside it.
enum Standing<'a> {
    Roadside(RoadsideObject),
    Vehicle(Vehicle),
    /// A rail, its offset from the middle of the ego lane, and the point of the road at its far end.
    Rail(&'a Rail, f32, usize),
}

impl Moment<'_> {
    /// Paints the objects on the road and beside it, the farthest first.
    pub(super) fn paint_standing(&self, canvas: &mut Canvas, mask: &mut [u8]) {
        let (drive, s_m) = (self.drive, self.pose.s_m);
        let edges_m = drive.layout.asphalt_m;
        let hidden = |z_m: f32| self.tunnel.as_ref().is_some_and(|t| t.covers(z_m));
        let mut standing: Vec<(f32, Standing)> = drive
            .surroundings
            .objects(s_m + 5.0, s_m + 260.0, edges_m)
            .map(|object| ((object.s_m - s_m) as f32, Standing::Roadside(object)))
            .collect();
        let vehicles = drive
            .traffic
            .ahead(self.t_s, &self.pose, &drive.road, &drive.layout);
        standing.extend(
            vehicles
                .into_iter()
                .map(|vehicle| (vehicle.z_m, Standing::Vehicle(vehicle))),
        );
        let sides = [(edges_m.0, -1.0), (edges_m.1, 1.0)];
        for (rail, (edge_m, side)) in drive.surroundings.rails.iter().zip(sides) {
            let Some(rail) = rail else { continue };
            let d_m = edge_m + side * rail.clear_m;
            standing.extend((1..self.ahead.nodes.len()).filter_map(|node| {
                let z_m = self.ahead.nodes[node].z_m;
                let near = (1.0..180.0).contains(&z_m) && self.ahead.nodes[node - 1].z_m >= 1.0;
                near.then_some((z_m, Standing::Rail(rail, d_m, node)))
            }));
        }
        standing.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (z_m, standing) in &standing {
            match standing {
                Standing::Vehicle(vehicle) => self.paint_vehicle(vehicle, canvas, mask),
                _ if hidden(*z_m) => {}
                Standing::Roadside(object) => self.paint_roadside(object, *z_m, canvas, mask),
                Standing::Rail(rail, d_m, node) => {
                    self.paint_rail(rail, *d_m, *node, canvas, mask);
                }
            }
        }
    }

    /// Paints a rail between two points of the road; `node` is the farther one.
    fn paint_rail(&self, rail: &Rail, d_m: f32, node: usize, canvas: &mut Canvas, mask: &mut [u8]) {
        let ends = [self.ahead.nodes[node - 1], self.ahead.nodes[node]].map(|node| {
            let x_m = d_m + node.lateral_m - self.pose.sway_m - self.drive.camera.aside_m;
            (
                self.projection.column(x_m, node.z_m),
                self.projection.row(node.rise_m + rail.height_m.1, node.z_m),
                self.projection.row(node.rise_m + rail.height_m.0, node.z_m),
                node.z_m,
            )
        });
        let [near, far] = ends;
        let (left, right) = (near.0.min(far.0), near.0.max(far.0));
        let crest = self.view.crest(near.3);
        let light = self.drive.light.ground;
        for x in Board::pixels(left - 0.5, right + 0.5, canvas.width) {
            let across = ((x as f32 + 0.5 - near.0) / (far.0 - near.0)).clamp(0.0, 1.0);
            let across = if across.is_nan() { 0.0 } else { across };
            let at = |near: f32, far: f32| near + across * (far - near);
            let (top, foot) = (at(near.1, far.1), at(near.2, far.2).min(crest));
            // Along a line in the picture, distances are evenly spaced in 1/z.
            let z_m = 1.0 / at(1.0 / near.3, 1.0 / far.3);
            for y in Board::pixels(top - 0.5, foot + 0.5, canvas.height) {
                let cover = (foot.min(y as f32 + 1.0) - top.max(y as f32)).clamp(0.0, 1.0);
                let up = (foot - (y as f32 + 0.5)) / (foot - top).max(0.1);
                let tone = 0.7 + 0.3 * up.clamp(0.0, 1.0);
                let pixel = y * canvas.width + x;
                let colour = [0, 1, 2].map(|c| rail.colour[c] * light[c] * tone);
                canvas.light[pixel] = blended(canvas.light[pixel], colour, cover);
                if cover > 0.5 {
                    canvas.depth_m[pixel] = z_m;
                    mask[pixel] = 0;
                }
            }
        }
    }

    /// The board of an object with width and height `size_m` at `z_m`, `d_m`; `None` if it cannot be seen.
    fn board(&self, z_m: f32, d_m: f32, size_m: (f32, f32)) -> Option<Board> {
        let node = self.ahead.at(z_m).filter(|n| n.z_m > 3.0)?;
        let x_m = d_m + node.lateral_m - self.pose.sway_m - self.drive.camera.aside_m;
        let foot = self.projection.row(node.rise_m, z_m);
        let scale = self.projection.focal_px / z_m;
        let middle = self.projection.column(x_m, z_m);
        let crest = self.view.crest(z_m);
        let board = Board {
            left: middle - 0.5 * size_m.0 * scale,
            right: middle + 0.5 * size_m.0 * scale,
            top: foot - size_m.1 * scale,
            foot,
            crest: crest.max(foot.min(crest)),
            z_m,
        };
        (board.right > 0.0 && board.top < board.crest).then_some(board)
    }

    fn paint_roadside(
        &self,
        object: &RoadsideObject,
        z_m: f32,
        canvas: &mut Canvas,
        mask: &mut [u8],
    ) {
        let Some(board) = self.board(z_m, object.d_m, object.size_m) else {
            return;
        };
        let sun = self.drive.light.ground;
        let seed = object.seed;
        let snow = 0.5 * self.snow_on_verge();
        board.paint(canvas, mask, |across, up| {
            let tone = match object.kind {
                ObjectKind::Tree => {
                    let (dx, dy) = (2.0 * across - 1.0, (up - 0.62) / 0.40);
                    let ragged = value_noise(seed, f64::from(across) * 7.0, f64::from(up) * 9.0);
                    if dx * dx + dy * dy < 0.55 + 0.65 * ragged {
                        0.55 + 0.9 * ragged * (0.6 + 0.4 * up)
                    } else if up < 0.3 && dx.abs() < 0.09 {
                        0.6
                    } else {
                        return None;
                    }
                }
                ObjectKind::Conifer => {
                    let half = 0.5 * (1.0 - (up - 0.12) / 0.88);
                    if up > 0.12 && (across - 0.5).abs() < half {
                        // Facets: flat tones to the left and right, tiers above each other.
                        let tier = (up * 4.0).fract();
                        (if across < 0.5 { 0.75 } else { 1.15 }) * (0.75 + 0.35 * tier)
                    } else if up <= 0.12 && (across - 0.5).abs() < 0.06 {
                        0.7
                    } else {
                        return None;
                    }
                }
                ObjectKind::Building => {
                    let pane =
                        (across * 6.0).fract() > 0.35 && (up * 5.0).fract() > 0.4 && up < 0.92;
                    if pane { 0.35 } else { 0.95 }
                }
                ObjectKind::Post => 1.0,
            };
            let colour = [0, 1, 2].map(|i| object.colour[i] * sun[i] * tone);
            Some(if snow > 0.0 {
                blended(colour, SNOW, snow * up)
            } else {
                colour
            })
        });
    }

    fn paint_vehicle(&self, vehicle: &Vehicle, canvas: &mut Canvas, mask: &mut [u8]) {
        let Some(board) = self.board(vehicle.z_m, vehicle.d_m, vehicle.size_m) else {
            return;
        };
        let sun = self.drive.light.ground;
        board.shadow(canvas);
        let lamp = if vehicle.oncoming {
            [0.8, 0.8, 0.75]
        } else {
            [0.5, 0.04, 0.03]
        };
        let lorry = vehicle.size_m.1 > 2.5;
        board.paint(canvas, mask, |across, up| {
            let side = (2.0 * across - 1.0).abs();
            let inset = if lorry {
                0.0
            } else {
                (up - 0.5).max(0.0) * 0.45
            };
            if side > 1.0 - inset {
                return None;
            }
            let lit = |c: Colour, tone: f32| Some([0, 1, 2].map(|i| c[i] * sun[i] * tone));
            if up < 0.14 {
                if side > 0.62 {
                    lit([0.02; 3], 1.0)
                } else {
                    lit([0.05; 3], 0.7)
                }
            } else if (0.38..0.52).contains(&up) && side > 0.76 {
                Some(lamp)
            } else if !lorry && (0.58..0.92).contains(&up) && side < 0.8 - inset {
                lit([0.07, 0.09, 0.11], 1.0)
            } else if (0.24..0.32).contains(&up) && side < 0.22 {
                lit([0.7, 0.7, 0.65], 1.0)
            } else {
                lit(vehicle.colour, 0.75 + 0.35 * up)
            }
        });
        for side in [0.12, 0.88] {
            canvas.lamps.push(Lamp {
                at: (
                    board.left + side * (board.right - board.left),
                    board.foot - 0.45 * (board.foot - board.top),
                ),
                radius_px: 0.07 * (board.right - board.left),
                colour: lamp,
            });
        }
    }
}

/// An upright rectangle in the picture, pixels.
struct Board {
    left: f32,
    right: f32,
    top: f32,
    foot: f32,
    /// Rows below this are hidden by nearer ground.
    crest: f32,
    z_m: f32,
}

impl Board {
    fn pixels(from: f32, to: f32, limit: usize) -> std::ops::Range<usize> {
        let inside = |v: f32| v.clamp(0.0, limit as f32);
        inside((from - 0.5).ceil()) as usize..inside((to + 0.5).floor()) as usize
    }

    /// Paints where `colour_at(across, up)` has a colour, with both arguments from 0 to 1; it hides labels behind it.
    fn paint(
        &self,
        canvas: &mut Canvas,
        mask: &mut [u8],
        colour_at: impl Fn(f32, f32) -> Option<Colour>,
    ) {
        let (width_px, height_px) = (self.right - self.left, self.foot - self.top);
        for y in Self::pixels(self.top, self.foot.min(self.crest), canvas.height) {
            let up = ((self.foot - (y as f32 + 0.5)) / height_px).clamp(0.0, 1.0);
            for x in Self::pixels(self.left, self.right, canvas.width) {
                let column = x as f32 + 0.5;
                let across = ((column - self.left) / width_px).clamp(0.0, 1.0);
                if let Some(colour) = colour_at(across, up) {
                    // Share of the pixel's width that the board covers, so that edges do not flicker when objects come
                    // near.
                    let cover = ((self.right - column).min(column - self.left) + 0.5)
                        .clamp(0.0, 1.0)
                        .min(width_px);
                    let pixel = y * canvas.width + x;
                    canvas.light[pixel] = blended(canvas.light[pixel], colour, cover);
                    if cover > 0.5 {
                        canvas.depth_m[pixel] = self.z_m;
                        mask[pixel] = 0;
                    }
                }
            }
        }
    }

    /// Darkens the ground under the board.
    fn shadow(&self, canvas: &mut Canvas) {
        let width_px = self.right - self.left;
        let reach = 0.12 * width_px;
        for y in Self::pixels(self.foot - 0.4 * reach, self.foot + reach, canvas.height) {
            let down = ((y as f32 + 0.5 - self.foot) / reach).abs().min(1.0);
            for x in Self::pixels(self.left - reach, self.right + reach, canvas.width) {
                let pixel = y * canvas.width + x;
                let light = canvas.light[pixel];
                canvas.light[pixel] = scaled(light, 0.35 + 0.6 * down * down);
            }
        }
    }
}
