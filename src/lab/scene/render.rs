//! Renders one moment of a drive as a frame with its truth: painted in linear light with depth, and passed through
//! weather and lens to the sensor.

use super::Drive;
use super::canvas::Canvas;
use super::conditions::severities_at;
use super::lens::{self, Askew};
use super::moment::Moment;
use super::noise::hash;
use super::weather;

/// Half of the width of a label, in pixels of a picture that is 320 pixels wide. Lane data sets label lines with a
/// fixed width (CULane: 16 pixels of 800), so that far lines have some weight.
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
    /// A renderer of pictures with `width` by `height` pixels.
    pub fn new(width: u32, height: u32) -> Self {
        let (width, height) = (width as usize, height as usize);
        Self {
            canvas: Canvas::new(width, height),
            mask: vec![0; width * height],
            rgb: vec![0; width * height * 3],
        }
    }

    /// Renders the drive at `t_s` seconds.
    pub fn render(&mut self, drive: &Drive, t_s: f64) -> Labelled<'_> {
        let severities = severities_at(&drive.conditions, t_s);
        let pose = drive.road.pose(t_s);
        let canvas = &mut self.canvas;
        let askew = Askew::of(&severities, drive.seed);
        let projection = drive.camera.projection(
            (canvas.width, canvas.height),
            &pose,
            (askew.turned, askew.tipped),
        );
        let margin_px = askew.margin_px(canvas.width, canvas.height);
        let label_half_px = LABEL_HALF_WIDTH_PX * canvas.width as f32 / 320.0;
        let moment =
            |projection, height| Moment::new(drive, t_s, severities, pose, projection, height);
        let (extinction, gain_along);
        if margin_px == 0 {
            let moment = moment(projection, canvas.height);
            (extinction, gain_along) = (moment.light.extinction, moment.way.gain(t_s));
            moment.paint(label_half_px, canvas, &mut self.mask);
        } else {
            let mut wide = Canvas::new(canvas.width + 2 * margin_px, canvas.height + 2 * margin_px);
            let mut wide_mask = vec![0; wide.light.len()];
            let projection = projection.with_margin(margin_px);
            let moment = moment(projection, wide.height);
            (extinction, gain_along) = (moment.light.extinction, moment.way.gain(t_s));
            moment.paint(label_half_px, &mut wide, &mut wide_mask);
            askew.roll_into((&wide, &wide_mask), margin_px, (canvas, &mut self.mask));
        }
        let time_seed = hash(drive.seed, (t_s * 1_000.0).round() as i64 as i32, 0x71);
        weather::apply(
            canvas,
            &projection,
            &severities,
            extinction,
            drive.unlit,
            time_seed,
        );
        lens::apply(
            canvas,
            &projection,
            &severities,
            drive.sensor.softness,
            drive.seed,
        );
        let gain = drive.light.exposure * drive.sensor.gain(&drive.conditions, t_s) * gain_along;
        drive
            .sensor
            .expose(canvas, gain, &severities, time_seed, &mut self.rgb);
        Labelled {
            rgb: &self.rgb,
            mask: &self.mask,
        }
    }
}
