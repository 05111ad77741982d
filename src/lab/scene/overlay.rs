//! Conditions rendered over the pictures of any source, for example fog over a real road.
//!
//! A picture has no depth. The ground is taken as flat, seen by a camera that is mounted as the cameras of drives are on
//! average, and everything above the horizon as 100 m away. What changes the scene itself cannot be laid over a picture:
//! rain does not wet the road, snow only falls, and a tunnel is refused.

use super::canvas::Canvas;
use super::conditions::{Condition, ConditionKind, Severities, severities_at};
use super::lens::{self, Askew};
use super::light::blended;
use super::noise::{Draws, hash};
use super::projection::Projection;
use super::sensor::{Sensor, light_of};
use super::weather;
use super::world::World;
use crate::capture::pixels::Pixels;
use crate::capture::{Frame, FrameSource, Picture, SourceError};

/// Focal length, as a share of the picture's width: 60 degrees of horizontal view.
const FOCAL: f32 = 0.866;
/// Row of the horizon, as a share of the picture's height.
const HORIZON: f32 = 0.45;
/// Height of the camera above the road, metres.
const HEIGHT_M: f32 = 1.4;
/// Distance of everything that is not the nearer ground, metres.
const FAR_M: f32 = 100.0;

/// Renders conditions over the pictures of `source`. Each option is `condition=KIND:SEVERITY[@FROM-TO]`, with seconds
/// of the source, or `seed=N`, from which dirt, drops and the sun are drawn.
///
/// # Errors
/// When an option is not understood, or is a tunnel.
pub fn lay_over(
    source: Box<dyn FrameSource>,
    options: &[&str],
) -> Result<Box<dyn FrameSource>, SourceError> {
    let (mut conditions, mut seed) = (Vec::new(), 7);
    for option in options {
        let refused = |why: String| SourceError::Scene(format!("source option {option:?}: {why}"));
        if let Some(number) = option.strip_prefix("seed=") {
            let wanted = |_| refused("wanted a whole number from 0 to 4294967295".to_owned());
            seed = number.parse().map_err(wanted)?;
        } else {
            let text = option.trim_start_matches("condition=");
            let condition: Condition = text.parse().map_err(|error| refused(format!("{error}")))?;
            if condition.kind == ConditionKind::Tunnel {
                return Err(refused(
                    "a tunnel cannot be laid over a picture; wanted another condition".to_owned(),
                ));
            }
            conditions.push(condition);
        }
    }
    Ok(Box::new(Overlay {
        source,
        conditions,
        seed,
        sensor: Sensor::new(Draws(0), &World::default()),
    }))
}

struct Overlay {
    source: Box<dyn FrameSource>,
    conditions: Vec<Condition>,
    seed: u32,
    sensor: Sensor,
}

impl FrameSource for Overlay {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let frame = self.source.next_frame()?;
        Ok(frame.map(|frame| Frame {
            picture: frame.picture.map(|pixels| {
                let t_s = frame.captured_at.as_secs_f64();
                let severities = severities_at(&self.conditions, t_s);
                let layout = pixels.layout();
                let is_empty = layout.width == 0 || layout.height == 0;
                if is_empty || severities == Severities::default() {
                    pixels
                } else {
                    Pixels::from(self.render(pixels.picture(), &severities, t_s))
                }
            }),
            ..frame
        }))
    }

    fn frame_count(&self) -> Option<u64> {
        self.source.frame_count()
    }
}

impl Overlay {
    fn render(&self, picture: Picture, severities: &Severities, t_s: f64) -> Picture {
        let (width, height) = (picture.width as usize, picture.height as usize);
        let askew = Askew::of(severities, self.seed);
        let projection = Projection {
            focal_px: FOCAL * width as f32,
            centre_x: 0.5 * width as f32,
            horizon_y: HORIZON * height as f32,
            height_m: HEIGHT_M,
        };
        let mut canvas = on_flat_ground(&picture, &projection);
        if askew.roll.abs() > 0.0 {
            canvas = turned(&canvas, askew, projection.focal_px);
        }
        let time_seed = hash(self.seed, (t_s * 1_000.0).round() as i64 as i32, 0x71);
        weather::apply(&mut canvas, &projection, severities, 0.0, false, time_seed);
        lens::apply(&mut canvas, &projection, severities, 0.0, self.seed);
        let gain = self.sensor.gain(&self.conditions, t_s);
        let mut rgb = picture.rgb;
        self.sensor
            .expose(&canvas, gain, severities, time_seed, &mut rgb);
        Picture { rgb, ..picture }
    }
}

/// The light of a picture, with the depth of flat ground below the horizon.
fn on_flat_ground(picture: &Picture, projection: &Projection) -> Canvas {
    let (width, height) = (picture.width as usize, picture.height as usize);
    let mut canvas = Canvas::new(width, height);
    for (light, pixel) in canvas.light.iter_mut().zip(picture.rgb.chunks_exact(3)) {
        *light = [0, 1, 2].map(|channel| light_of(pixel[channel]));
    }
    for (y, row) in canvas.depth_m.chunks_exact_mut(width).enumerate() {
        let below = (y as f32 + 0.5 - projection.horizon_y).max(1e-3);
        row.fill((projection.focal_px * projection.height_m / below).min(FAR_M));
    }
    canvas
}

/// The picture of a camera that is out of its place. It is enlarged so that the rolled picture is complete; where it is
/// turned or tipped beyond the edge, the edge is repeated.
fn turned(from: &Canvas, askew: Askew, focal_px: f32) -> Canvas {
    let mut to = Canvas::new(from.width, from.height);
    let (sin, cos) = (libm::sinf(askew.roll), libm::cosf(askew.roll));
    let (width, height) = (from.width as f32, from.height as f32);
    let enlarged = cos + sin.abs() * (width / height).max(height / width);
    let (aside, up) = (focal_px * askew.turned, focal_px * askew.tipped);
    for y in 0..to.height {
        for x in 0..to.width {
            let dx = (x as f32 + 0.5 - 0.5 * width + aside) / enlarged;
            let dy = (y as f32 + 0.5 - 0.5 * height - up) / enlarged;
            let at_x = (0.5 * width + cos * dx - sin * dy - 0.5).clamp(0.0, width - 1.0);
            let at_y = (0.5 * height + sin * dx + cos * dy - 0.5).clamp(0.0, height - 1.0);
            let (x0, y0) = (at_x as usize, at_y as usize);
            let (x1, y1) = ((x0 + 1).min(from.width - 1), (y0 + 1).min(from.height - 1));
            let row = |y: usize| {
                let at = y * from.width;
                blended(from.light[at + x0], from.light[at + x1], at_x - x0 as f32)
            };
            let pixel = y * to.width + x;
            to.light[pixel] = blended(row(y0), row(y1), at_y - y0 as f32);
            to.depth_m[pixel] = from.depth_m[y0 * from.width + x0];
        }
    }
    to
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::capture::open;

    fn frames(options: &[&str]) -> Vec<Vec<u8>> {
        let drive = open_drive();
        let mut source = lay_over(drive, options).unwrap();
        std::iter::from_fn(|| source.next_frame().unwrap())
            .map(|frame| frame.picture.unwrap().picture().rgb)
            .collect()
    }

    fn open_drive() -> Box<dyn FrameSource> {
        crate::lab::register();
        open("scene:sim?seed=3&seconds=6&fps=1&size=160x80").unwrap()
    }

    struct Empty(Option<Frame>);

    impl FrameSource for Empty {
        fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
            Ok(self.0.take())
        }

        fn frame_count(&self) -> Option<u64> {
            None
        }
    }

    #[test]
    fn an_empty_picture_stays_empty() {
        for kind in ConditionKind::ALL.map(ConditionKind::name) {
            if kind == ConditionKind::Tunnel.name() {
                continue;
            }
            let source = Empty(Some(Frame {
                sequence: 0,
                captured_at: std::time::Duration::ZERO,
                picture: Ok(Pixels::from(Picture {
                    width: 0,
                    height: 0,
                    rgb: vec![],
                })),
            }));
            let mut source = lay_over(Box::new(source), &[&format!("condition={kind}:4")]).unwrap();
            let frame = source.next_frame().unwrap().unwrap();
            assert!(frame.picture.unwrap().picture().rgb.is_empty(), "{kind}");
        }
    }

    fn difference(a: &[u8], b: &[u8]) -> f64 {
        let pairs = a.iter().zip(b);
        let sum: u64 = pairs.map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        sum as f64 / a.len() as f64
    }

    #[test]
    fn every_byte_is_the_same_after_the_light_of_it_is_exposed() {
        let rgb: Vec<u8> = (0..=255).flat_map(|byte| [byte; 3]).collect();
        let picture = Picture {
            width: 256,
            height: 1,
            rgb: rgb.clone(),
        };
        let overlay = Overlay {
            source: open_drive(),
            conditions: vec![],
            seed: 7,
            sensor: Sensor::new(Draws(0), &World::default()),
        };
        assert_eq!(
            overlay.render(picture, &Severities::default(), 0.0).rgb,
            rgb
        );
    }

    #[test]
    fn each_condition_changes_the_pictures_more_with_its_severity_and_only_in_its_span() {
        let plain = frames(&[]);
        for kind in ConditionKind::ALL {
            let at = |severity: u8| format!("condition={}:{severity}@3-5", kind.name());
            if kind == ConditionKind::Tunnel {
                let refused = lay_over(open_drive(), &[&at(3)]).err().unwrap();
                assert!(refused.to_string().contains("tunnel"), "{refused}");
                continue;
            }
            let [light, heavy] = [at(1), at(5)].map(|option| frames(&[&option]));
            for outside in [0, 1, 5] {
                assert_eq!(plain[outside], heavy[outside], "{}", kind.name());
            }
            let [light, heavy] = [&light, &heavy].map(|of| difference(&plain[3], &of[3]));
            assert!(
                light > 0.1 && heavy > 1.3 * light,
                "{}: {light} {heavy}",
                kind.name()
            );
        }
    }

    #[test]
    fn the_seed_draws_the_dirt_and_wrong_options_are_named() {
        let of = |seed: &str| frames(&["condition=dirt:4", seed])[0].clone();
        assert_eq!(of("seed=1"), of("seed=1"));
        assert!(difference(&of("seed=1"), &of("seed=2")) > 1.0);
        for (option, part) in [
            ("condition=fog", "\"condition=fog\": wanted KIND"),
            ("seed=x", "\"seed=x\": wanted a whole number"),
        ] {
            let refused = lay_over(open_drive(), &[option]).err().unwrap().to_string();
            assert!(refused.contains(part), "{refused}");
        }
    }
}
