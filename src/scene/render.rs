//! Paints one moment of a drive in linear light with depth, labels the lane lines, and hands over to weather and sensor.

use super::Drive;
use super::canvas::{Canvas, Lamp};
use super::conditions::{
    ConditionKind, RAIN_MIRROR, SNOW_ROAD, SNOW_VERGE, Severities, graded, severities_at,
};
use super::lens::{self, Askew};
use super::light::{Colour, blended, scaled};
use super::markings::PaintRow;
use super::noise::{hash, value_noise};
use super::projection::{GroundRow, GroundView, Projection};
use super::road::{Pose, RoadAhead};
use super::surroundings::{ObjectKind, Rail, RoadsideObject};
use super::traffic::Vehicle;
use super::tunnel::Tunnel;
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
            canvas: Canvas::new(width, height),
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
        let askew = Askew::of(&severities, drive.seed);
        let projection = drive.camera.projection(
            (canvas.width, canvas.height),
            &pose,
            (askew.turned, askew.tipped),
        );
        let margin_px = askew.margin_px(canvas.width, canvas.height);
        let scene = Scene {
            drive,
            t_s,
            pose,
            ahead: &ahead,
            severities,
            label_half_px: LABEL_HALF_WIDTH_PX * canvas.width as f32 / 320.0,
        };
        if margin_px == 0 {
            scene.paint(projection, canvas, &mut self.mask);
        } else {
            let mut wide = Canvas::new(canvas.width + 2 * margin_px, canvas.height + 2 * margin_px);
            let mut wide_mask = vec![0; wide.light.len()];
            scene.paint(projection.with_margin(margin_px), &mut wide, &mut wide_mask);
            askew.roll_into((&wide, &wide_mask), margin_px, (canvas, &mut self.mask));
        }
        let time_seed = hash(drive.seed, (t_s * 1_000.0).round() as i64 as i32, 0x71);
        weather::apply(
            canvas,
            &projection,
            &severities,
            drive.light.extinction,
            time_seed,
        );
        lens::apply(
            canvas,
            &projection,
            &severities,
            drive.sensor.softness,
            drive.seed,
        );
        let gain = drive.light.exposure * drive.sensor.gain(&drive.conditions, t_s);
        drive
            .sensor
            .expose(canvas, gain, &severities, time_seed, &mut self.rgb);
        Labelled {
            rgb: &self.rgb,
            mask: &self.mask,
        }
    }
}

/// One moment of a drive, before a camera looks at it.
struct Scene<'a> {
    drive: &'a Drive,
    t_s: f64,
    pose: Pose,
    ahead: &'a RoadAhead,
    severities: Severities,
    label_half_px: f32,
}

impl Scene<'_> {
    /// Paints light, depth and labels of everything that stands or lies there.
    fn paint(&self, projection: Projection, canvas: &mut Canvas, mask: &mut [u8]) {
        let drive = self.drive;
        let view = GroundView::new(&projection, self.ahead, canvas.height);
        canvas.lamps.clear();
        canvas.depth_m.fill(f32::INFINITY);
        mask.fill(0);
        let moment = Moment {
            drive,
            pose: self.pose,
            ahead: self.ahead,
            projection,
            view: &view,
            severities: self.severities,
            label_half_px: self.label_half_px,
            tunnel: Tunnel::near(
                &drive.conditions,
                &drive.road,
                drive.layout.asphalt_m,
                self.pose.s_m,
                drive.seed,
            ),
        };
        moment.paint_sky(canvas);
        moment.paint_ground(canvas, mask);
        moment.paint_standing(self.t_s, canvas, mask);
        if let Some(tunnel) = &moment.tunnel {
            let aside_m = self.pose.sway_m + drive.camera.aside_m;
            tunnel.paint(canvas, mask, &projection, self.ahead, aside_m);
        }
        if let Some(bonnet) = drive.bonnet {
            paint_bonnet(bonnet, canvas, mask);
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
    label_half_px: f32,
    tunnel: Option<Tunnel>,
}

impl Moment<'_> {
    /// Compass direction of the road under the car: turns with the road so that hills and clouds move sideways in curves.
    fn compass(&self) -> f64 {
        // The integral of the curvature has no closed form here; a slow wander with the same period looks the same.
        f64::from(self.drive.road.curvature(self.pose.s_m)) * 60.0
    }

    fn sky_at(&self, x: f32, elevation: f32) -> Colour {
        let azimuth = (x - self.projection.centre_x) / self.projection.focal_px;
        let sky = self
            .drive
            .light
            .sky(azimuth + self.compass() as f32, elevation);
        blended(sky, [0.74, 0.76, 0.79], 0.8 * self.snow_on_verge())
    }

    /// Share of the verge under snow.
    fn snow_on_verge(&self) -> f32 {
        graded(SNOW_VERGE, self.severities.of(ConditionKind::Snow))
    }

    fn paint_sky(&self, canvas: &mut Canvas) {
        let rows = self
            .view
            .rows
            .iter()
            .position(Option::is_some)
            .unwrap_or(canvas.height);
        let hill = blended(
            self.drive.surroundings.hill_colour(),
            SNOW,
            0.7 * self.snow_on_verge(),
        );
        let hill = scaled(hill, self.drive.light.ground[1]);
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
        let label_half_m = self.label_half_px * metres_a_pixel;
        // A line `d` metres aside runs at slope d / height in the picture; its label is as wide across as along a row.
        let camera_d_m = self.lateral(row, self.projection.centre_x);
        let slant = |d_m: f32| {
            let slope = (d_m - camera_d_m) / self.projection.height_m;
            (1.0 + slope * slope).sqrt()
        };
        let labelled = row.z_m <= LABEL_REACH_M;
        let wet = graded(RAIN_MIRROR, self.severities.of(ConditionKind::Rain));
        let mirror = wet * row.z_m / (row.z_m + 12.0);
        let in_tunnel = self.tunnel.as_ref().is_some_and(|t| t.covers(row.z_m));
        let (snow_on_verge, snow_on_road) = if in_tunnel {
            (0.0, 0.0)
        } else {
            (
                self.snow_on_verge(),
                graded(SNOW_ROAD, self.severities.of(ConditionKind::Snow)),
            )
        };
        let below_horizon =
            ((y as f32 + 0.5) - self.projection.horizon_y).max(0.0) / self.projection.focal_px;
        // Places on the ground are measured from the middle of the ego lane; the camera stands beside it by sway and mount.
        let left_m = self.lateral(row, 0.5);
        for (x, (light, mask)) in light.iter_mut().zip(mask).enumerate() {
            let d_m = left_m + x as f32 * metres_a_pixel;
            let (from_m, to_m) = layout.asphalt_m;
            let ground = if (from_m..to_m).contains(&d_m) {
                let phase = d_m - layout.lane_width_m * (d_m / layout.lane_width_m).round();
                let base = textures.asphalt(d_m, phase, metres_a_pixel);
                let painted = match paint.at(d_m, metres_a_pixel) {
                    Some((share, colour)) => blended(base, colour, share),
                    None => base,
                };
                let painted = if snow_on_road > 0.0 {
                    // Wheels clear their tracks as long as there is any road to be seen.
                    let track = 1.0 - ((phase.abs() - 0.85).abs() / 0.45).min(1.0);
                    let cover = snow_on_road * (1.0 - 0.6 * track * (1.0 - snow_on_road));
                    blended(painted, SNOW, textures.snow(d_m, cover))
                } else {
                    painted
                };
                if mirror > 0.0 {
                    let sky = self.sky_at(x as f32, below_horizon);
                    blended(scaled(painted, 1.0 - 0.4 * wet), sky, mirror)
                } else {
                    painted
                }
            } else if in_tunnel {
                KERB
            } else if snow_on_verge > 0.0 {
                blended(textures.verge(d_m), SNOW, textures.snow(d_m, snow_on_verge))
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

    /// Paints what stands on the road and beside it, the farthest first.
    fn paint_standing(&self, t_s: f64, canvas: &mut Canvas, mask: &mut [u8]) {
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
            .ahead(t_s, &self.pose, &drive.road, &drive.layout);
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

    /// Paints a rail between two stations of the road, `node` the farther one.
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
            // Distances are even in 1/z along a line in the picture.
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

/// The walkway along a tunnel's wall.
const KERB: Colour = [0.34, 0.34, 0.33];
/// Snow in full light.
const SNOW: Colour = [0.86, 0.88, 0.92];

/// What stands there, beside its distance.
enum Standing<'a> {
    Roadside(RoadsideObject),
    Vehicle(Vehicle),
    /// A rail, its offset from the middle of the ego lane, and the station at its far end.
    Rail(&'a Rail, f32, usize),
}

/// Paints the own car's bonnet over the foot of the picture.
fn paint_bonnet(colour: Colour, canvas: &mut Canvas, mask: &mut [u8]) {
    let (width, height) = (canvas.width as f32, canvas.height as f32);
    for x in 0..canvas.width {
        let across = (2.0 * (x as f32 + 0.5) / width - 1.0) / 0.92;
        let arch = (1.0 - across * across).max(0.0).sqrt();
        let top = height - 0.11 * height * arch;
        for y in (top.max(0.0) as usize)..canvas.height {
            let down = (y as f32 + 0.5 - top) / (0.11 * height);
            let pixel = y * canvas.width + x;
            canvas.light[pixel] = scaled(colour, 1.6 - down.clamp(0.0, 1.0));
            canvas.depth_m[pixel] = 1.5;
            mask[pixel] = 0;
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
