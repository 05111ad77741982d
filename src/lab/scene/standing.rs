//! Paints the objects on the road and beside it, the farthest first: vehicles, rails, trees, buildings, posts.

use super::beside::BeltPiece;
use super::bridge::Bridge;
use super::canvas::{Canvas, Lamp};
use super::light::{Colour, blended, scaled};
use super::moment::Moment;
use super::noise::{RoughColumn, value_noise};
use super::panels::pixels;
use super::surroundings::{ObjectKind, Rail, RoadsideObject};
use super::textures::SNOW;
use super::traffic::Vehicle;

/// Distance between posts with reflectors, and up to which they shine, metres.
const REFLECTORS_M: (f64, f32) = (25.0, 160.0);
/// Length over which a rail rises from the ground, metres.
const RAIL_RAMP_M: f32 = 8.0;

/// An object, with its distance beside it.
enum Standing<'a> {
    Roadside(RoadsideObject),
    Vehicle(Vehicle),
    /// A rail, its side (0 left, 1 right), its ends, and the point of the road at the far end of the piece.
    Rail(&'a Rail, usize, (f64, f64), usize),
    /// A piece of a belt along the road.
    Belt(BeltPiece<'a>),
    Bridge(&'a Bridge),
}

impl Moment<'_> {
    /// Paints the objects on the road and beside it, the farthest first.
    pub(super) fn paint_standing(&self, canvas: &mut Canvas, mask: &mut [u8]) {
        let (drive, s_m) = (self.drive, self.pose.s_m);
        let hidden = |z_m: f32| self.tunnel.as_ref().is_some_and(|t| t.covers(z_m));
        let changing = self.way.has_roadsides();
        let seen = |object: RoadsideObject| {
            let z_m = (object.s_m - s_m) as f32;
            (z_m, Standing::Roadside(object))
        };
        let mut standing: Vec<(f32, Standing)> = if changing {
            self.changing_objects().into_iter().map(seen).collect()
        } else {
            let objects =
                drive
                    .surroundings
                    .objects(s_m + 5.0, s_m + 260.0, drive.layout.asphalt_m);
            objects.map(seen).collect()
        };
        standing.extend(
            self.belt_pieces()
                .map(|(z_m, piece)| (z_m, Standing::Belt(piece))),
        );
        standing.extend(
            self.bridges_ahead()
                .map(|(z_m, bridge)| (z_m, Standing::Bridge(bridge))),
        );
        let vehicles = drive
            .traffic
            .ahead(self.t_s, &self.pose, &drive.road, |s_m| {
                self.way.layout(s_m)
            });
        standing.extend(
            vehicles
                .into_iter()
                .map(|vehicle| (vehicle.z_m, Standing::Vehicle(vehicle))),
        );
        for (side, rails) in [0, 1]
            .map(|side| self.way.rails(side))
            .into_iter()
            .enumerate()
        {
            for (rail, ends_m) in rails {
                standing.extend((1..self.ahead.nodes.len()).filter_map(|node| {
                    let (near_m, z_m) =
                        (self.ahead.nodes[node - 1].z_m, self.ahead.nodes[node].z_m);
                    let near = (1.0..180.0).contains(&z_m) && near_m >= 1.0;
                    let there =
                        ends_m.0 < s_m + f64::from(z_m) && s_m + f64::from(near_m) < ends_m.1;
                    (near && there).then_some((z_m, Standing::Rail(rail, side, ends_m, node)))
                }));
            }
        }
        if self.unlit_dark() > 0.0 {
            self.push_reflectors(canvas);
        }
        standing.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (z_m, standing) in &standing {
            match standing {
                Standing::Vehicle(vehicle) => self.paint_vehicle(vehicle, canvas, mask),
                _ if hidden(*z_m) => {}
                Standing::Roadside(object) => self.paint_roadside(object, *z_m, canvas, mask),
                Standing::Rail(rail, side, ends_m, node) => {
                    self.paint_rail(rail, *side, *ends_m, *node, canvas, mask);
                }
                Standing::Belt(piece) => self.paint_belt(*piece, canvas, mask),
                Standing::Bridge(bridge) => self.paint_bridge(bridge, canvas, mask),
            }
        }
    }

    /// Paints a piece of a rail between two points of the road; `node` is the farther one. A rail sinks into the ground
    /// at its ends.
    fn paint_rail(
        &self,
        rail: &Rail,
        side: usize,
        ends_m: (f64, f64),
        node: usize,
        canvas: &mut Canvas,
        mask: &mut [u8],
    ) {
        let ends = [node - 1, node].map(|node| {
            let node = &self.ahead.nodes[node];
            let s_m = self.pose.s_m + f64::from(node.z_m);
            let edges_m = self.way.edges_m(s_m);
            let d_m = if side == 0 {
                edges_m.0 - rail.clear_m
            } else {
                edges_m.1 + rail.clear_m
            };
            let inside_m = (s_m - ends_m.0).min(ends_m.1 - s_m) as f32;
            let raised = (inside_m / RAIL_RAMP_M).clamp(0.0, 1.0);
            let (low_m, high_m) = rail.height_m;
            self.corner(node, d_m, (low_m * raised, high_m * raised))
        });
        let light = self.light.ground;
        let shade = self
            .way
            .shade(self.pose.s_m + f64::from(ends[1].z_m))
            .left();
        self.paint_panel(
            &ends,
            canvas,
            mask,
            |_| (),
            |(), up| {
                let tone = 0.7 + 0.3 * up;
                Some([0, 1, 2].map(|c| rail.colour[c] * light[c] * tone * shade))
            },
        );
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

    /// Reflectors on posts along the edges of the road, which send the light of the own lamps back.
    fn push_reflectors(&self, canvas: &mut Canvas) {
        let post = |z_m: f64| ((self.pose.s_m + z_m) / REFLECTORS_M.0).floor() as i64;
        for post in post(8.0)..post(f64::from(REFLECTORS_M.1)) {
            let s_m = (post + 1) as f64 * REFLECTORS_M.0;
            let z_m = (s_m - self.pose.s_m) as f32;
            let Some(node) = self.ahead.at(z_m) else {
                continue;
            };
            let edges_m = self.way.edges_m(s_m);
            let bright = 0.5 * (1.0 - z_m / REFLECTORS_M.1) * (1.0 - z_m / REFLECTORS_M.1);
            for d_m in [edges_m.0 - 0.6, edges_m.1 + 0.6] {
                let corner = self.corner(&node, d_m, (0.0, 0.8));
                if corner.top < self.view.crest(z_m) {
                    canvas.lamps.push(Lamp {
                        at: (corner.x, corner.top),
                        radius_px: 0.03 * self.projection.focal_px / z_m,
                        colour: scaled([1.0, 0.9, 0.7], bright),
                    });
                }
            }
        }
    }

    /// The light on an object at an arc length.
    fn light_on(&self, s_m: f64) -> Colour {
        scaled(self.light.ground, self.way.shade(s_m).left())
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
        let sun = self.light_on(object.s_m);
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
                ObjectKind::HighTree => {
                    let (width_m, height_m) = object.size_m;
                    let (dx, dy) = (2.0 * across - 1.0, (up - 0.64) / 0.36);
                    let place = (seed & 0xFF) as f32;
                    let beyond = dx * dx + dy * dy;
                    let noise = |scale: f32| {
                        RoughColumn::new(place + scale * across * width_m).at(scale * up * height_m)
                    };
                    let ragged = if beyond < 1.2 { noise(0.9) } else { 0.0 };
                    if beyond < 0.45 + 0.75 * ragged {
                        0.35 + (0.5 + 0.5 * up) * ragged
                    } else if up < 0.5 && dx.abs() < 0.05 {
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
        let sun = self.light_on(self.pose.s_m + f64::from(vehicle.z_m));
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
    /// Paints where `colour_at(across, up)` has a colour, with both arguments from 0 to 1; it hides labels behind it.
    fn paint(
        &self,
        canvas: &mut Canvas,
        mask: &mut [u8],
        colour_at: impl Fn(f32, f32) -> Option<Colour>,
    ) {
        let (width_px, height_px) = (self.right - self.left, self.foot - self.top);
        for y in pixels(self.top, self.foot.min(self.crest), canvas.height) {
            let up = ((self.foot - (y as f32 + 0.5)) / height_px).clamp(0.0, 1.0);
            for x in pixels(self.left, self.right, canvas.width) {
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
        for y in pixels(self.foot - 0.4 * reach, self.foot + reach, canvas.height) {
            let down = ((y as f32 + 0.5 - self.foot) / reach).abs().min(1.0);
            for x in pixels(self.left - reach, self.right + reach, canvas.width) {
                let pixel = y * canvas.width + x;
                let light = canvas.light[pixel];
                canvas.light[pixel] = scaled(light, 0.35 + 0.6 * down * down);
            }
        }
    }
}
