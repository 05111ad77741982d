//! Paints one moment of a drive in linear light with depth, labels the lane lines, and hands over to weather and sensor.

use super::Drive;
use super::canvas::{Canvas, Lamp};
use super::conditions::{ConditionKind, RAIN_MIRROR, Severities, graded, severities_at};
use super::light::{Colour, blended, scaled};
use super::markings::PaintRow;
use super::noise::{hash, value_noise};
use super::projection::{GroundRow, GroundView, Projection};
use super::road::{Pose, RoadAhead};
use super::surroundings::{ObjectKind, RoadsideObject};
use super::traffic::Vehicle;
use super::weather;

/// Lane lines are labelled up to this distance, metres.
const LABEL_REACH_M: f32 = 60.0;
/// Half the width of a label, pixels in a picture 320 wide: lane data sets label lines with a fixed width (CULane's are
/// 16 pixels in 800), so that far lines weigh something.
const LABEL_HALF_WIDTH_PX: f32 = 2.0;

/// A frame and its truth.
pub struct Labelled<'a> {
    /// `[H, W, 3]`, 8-bit RGB.
    pub rgb: &'a [u8],
    /// `[H, W]`, 255 on a lane line, else 0.
    pub mask: &'a [u8],
}

/// Renders drives at one size; buffers are kept between frames.
pub struct Renderer {
    canvas: Canvas,
    mask: Vec<u8>,
    rgb: Vec<u8>,
}

impl Renderer {
    /// A renderer of pictures `width` by `height` pixels.
    pub fn new(width: u32, height: u32) -> Self {
        let (width, height) = (width as usize, height as usize);
        Self {
            canvas: Canvas {
                width,
                height,
                light: vec![[0.0; 3]; width * height],
                depth_m: vec![f32::INFINITY; width * height],
                lamps: Vec::new(),
            },
            mask: vec![0; width * height],
            rgb: vec![0; width * height * 3],
        }
    }

    /// The drive at `t_s` seconds.
    pub fn render(&mut self, drive: &Drive, t_s: f64) -> Labelled<'_> {
        let severities = severities_at(&drive.conditions, t_s);
        let pose = drive.road.pose(t_s);
        let ahead = drive.road.ahead(&pose);
        let canvas = &mut self.canvas;
        let projection = drive.camera.projection(canvas.width, canvas.height, &pose);
        let view = GroundView::new(&projection, &ahead, canvas.height);
        canvas.lamps.clear();
        canvas.depth_m.fill(f32::INFINITY);
        self.mask.fill(0);
        let moment = Moment {
            drive,
            pose,
            ahead: &ahead,
            projection,
            view: &view,
            severities,
        };
        moment.paint_sky(canvas);
        moment.paint_ground(canvas, &mut self.mask);
        moment.paint_objects(t_s, canvas, &mut self.mask);
        let time_seed = hash(drive.seed, (t_s * 1_000.0).round() as i64 as i32, 0x71);
        let gain = weather::apply(canvas, drive, &projection, &severities, time_seed);
        weather::expose(
            canvas,
            drive.light.exposure * gain,
            &severities,
            time_seed,
            &mut self.rgb,
        );
        Labelled {
            rgb: &self.rgb,
            mask: &self.mask,
        }
    }
}

struct Moment<'a> {
    drive: &'a Drive,
    pose: Pose,
    ahead: &'a RoadAhead,
    projection: Projection,
    view: &'a GroundView,
    severities: Severities,
}

impl Moment<'_> {
    /// Compass direction of the road under the car: turns with the road so that hills and clouds move sideways in curves.
    fn compass(&self) -> f64 {
        // The integral of the curvature has no closed form here; a slow wander with the same period looks the same.
        f64::from(self.drive.road.curvature(self.pose.s_m)) * 60.0
    }

    fn sky_at(&self, x: f32, elevation: f32) -> Colour {
        let azimuth = (x - self.projection.centre_x) / self.projection.focal_px;
        self.drive
            .light
            .sky(azimuth + self.compass() as f32, elevation)
    }

    fn paint_sky(&self, canvas: &mut Canvas) {
        let rows = self
            .view
            .rows
            .iter()
            .position(Option::is_some)
            .unwrap_or(canvas.height);
        let hill = scaled(
            self.drive.surroundings.hill_colour(),
            self.drive.light.ground[1],
        );
        for x in 0..canvas.width {
            let column = x as f32 + 0.5;
            let azimuth = f64::from((column - self.projection.centre_x) / self.projection.focal_px)
                + self.compass();
            let hills_px = self.drive.surroundings.hills(azimuth) * self.projection.focal_px;
            for y in 0..rows {
                let above_px = self.projection.horizon_y - (y as f32 + 0.5);
                let pixel = y * canvas.width + x;
                canvas.light[pixel] = if above_px < hills_px {
                    canvas.depth_m[pixel] = 1_500.0;
                    hill
                } else {
                    self.sky_at(column, above_px.max(0.0) / self.projection.focal_px)
                };
            }
        }
    }

    fn paint_ground(&self, canvas: &mut Canvas, mask: &mut [u8]) {
        let width = canvas.width;
        for (y, row) in self.view.rows.iter().enumerate() {
            let Some(row) = row else { continue };
            let span = y * width..(y + 1) * width;
            canvas.depth_m[span.clone()].fill(row.z_m);
            self.paint_ground_row(y, row, &mut canvas.light[span.clone()], &mut mask[span]);
        }
    }

    fn paint_ground_row(&self, y: usize, row: &GroundRow, light: &mut [Colour], mask: &mut [u8]) {
        let drive = self.drive;
        let layout = &drive.layout;
        let s_m = self.pose.s_m + f64::from(row.z_m);
        let metres_a_pixel = row.z_m / self.projection.focal_px;
        let textures = drive
            .surroundings
            .ground_row(s_m, row.length_m.max(metres_a_pixel));
        let paint = PaintRow::new(layout, s_m, row.length_m);
        let label_half_m = (LABEL_HALF_WIDTH_PX * light.len() as f32 / 320.0) * metres_a_pixel;
        // A line `d` metres aside runs at slope d / height in the picture; its label is as wide across as along a row.
        let camera_d_m = self.lateral(row, self.projection.centre_x);
        let slant = |d_m: f32| {
            let slope = (d_m - camera_d_m) / self.projection.height_m;
            (1.0 + slope * slope).sqrt()
        };
        let labelled = row.z_m <= LABEL_REACH_M;
        let wet = graded(RAIN_MIRROR, self.severities.of(ConditionKind::Rain));
        let mirror = wet * row.z_m / (row.z_m + 12.0);
        let below_horizon =
            ((y as f32 + 0.5) - self.projection.horizon_y).max(0.0) / self.projection.focal_px;
        // Places on the ground are measured from the middle of the ego lane; the camera stands beside it by sway and mount.
        let left_m = self.lateral(row, 0.5);
        for (x, (light, mask)) in light.iter_mut().zip(mask).enumerate() {
            let d_m = left_m + x as f32 * metres_a_pixel;
            let (from_m, to_m) = layout.asphalt_m;
            let ground = if (from_m..to_m).contains(&d_m) {
                let phase = d_m - layout.lane_width_m * (d_m / layout.lane_width_m).round();
                let base = textures.asphalt(d_m, phase);
                let painted = match paint.at(d_m, metres_a_pixel) {
                    Some((share, yellow)) => {
                        let colour = if yellow {
                            [0.72, 0.50, 0.10]
                        } else {
                            [0.78, 0.78, 0.76]
                        };
                        blended(base, colour, share)
                    }
                    None => base,
                };
                if mirror > 0.0 {
                    let sky = self.sky_at(x as f32, below_horizon);
                    blended(scaled(painted, 1.0 - 0.4 * wet), sky, mirror)
                } else {
                    painted
                }
            } else {
                textures.verge(d_m)
            };
            let shade = drive.light.shade(s_m, d_m);
            *light = [0, 1, 2].map(|i| ground[i] * drive.light.ground[i] * shade);
            if labelled {
                let on_line = |l: &super::markings::Line| {
                    (d_m - l.offset_m).abs()
                        <= (0.5 * l.width_m).max(label_half_m * slant(l.offset_m))
                };
                *mask = if layout.lines.iter().any(on_line) {
                    255
                } else {
                    0
                };
            }
        }
    }

    /// Offset from the ego lane's middle that column `x` of a ground row sees, metres.
    fn lateral(&self, row: &GroundRow, x: f32) -> f32 {
        let from_axis_m = (x - self.projection.centre_x) * row.z_m / self.projection.focal_px;
        from_axis_m - row.lateral_m + self.pose.sway_m + self.drive.camera.aside_m
    }

    fn paint_objects(&self, t_s: f64, canvas: &mut Canvas, mask: &mut [u8]) {
        let (drive, s_m) = (self.drive, self.pose.s_m);
        let vehicles = drive
            .traffic
            .ahead(t_s, &self.pose, &drive.road, &drive.layout);
        let mut vehicles = vehicles.iter().peekable();
        for object in drive
            .surroundings
            .objects(s_m + 5.0, s_m + 260.0, drive.layout.asphalt_m)
        {
            let z_m = (object.s_m - s_m) as f32;
            while let Some(vehicle) = vehicles.next_if(|v| v.z_m >= z_m) {
                self.paint_vehicle(vehicle, canvas, mask);
            }
            self.paint_roadside(&object, z_m, canvas, mask);
        }
        for vehicle in vehicles {
            self.paint_vehicle(vehicle, canvas, mask);
        }
    }

    /// The board of something `size_m` wide and high at `z_m`, `d_m`; `None` if it cannot be seen.
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
                ObjectKind::Building => {
                    let pane =
                        (across * 6.0).fract() > 0.35 && (up * 5.0).fract() > 0.4 && up < 0.92;
                    if pane { 0.35 } else { 0.95 }
                }
                ObjectKind::Post => 1.0,
            };
            Some([0, 1, 2].map(|i| object.colour[i] * sun[i] * tone))
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

    /// Paints where `colour_at(across, up)` has a colour, both from 0 to 1; covers labels behind it.
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
                    // Share of the pixel's width that the board covers: edges do not flicker as things come near.
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
