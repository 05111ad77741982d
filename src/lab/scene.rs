//! The road simulator: labelled frames of drives, for training the lane model and for changes of the domain with a
//! known truth.
//!
//! A [`Drive`] is a road, its paint, its surroundings, traffic, light and a camera, all drawn from one seed. Any moment
//! of it can be rendered directly. The same seed, time and size give the same bytes on every machine and thread. It
//! models only what the lane task needs: a road surface of clothoids and hills, upright boards on it, light, and a
//! lens.
//!
//! A road may pass into stretches of other kinds along the way (`sequence`, `road_kind`). `way` says how it looks at
//! each place; on other roads, every place looks like the whole drive.
//!
//! Data flow: `Road`, `Layout`, `Surroundings`, `Traffic`, `Light` → [`Renderer`] (linear light and depth) → weather →
//! lens → sensor → 8-bit frame and lane mask. A [`World`] says which look it has, and which elements.
//!
//! Pixel arithmetic converts between integers and floats on every line, within ranges that the code ensures.
#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]

mod belts;
mod beside;
mod bridge;
mod canvas;
mod changes;
mod conditions;
mod drive;
mod ground;
mod lens;
mod light;
mod markings;
mod moment;
mod noise;
mod overlay;
mod panels;
mod projection;
mod render;
mod road;
mod road_kind;
mod roadside;
mod sensor;
mod sequence;
mod shade;
mod source;
mod spec;
mod standing;
mod surroundings;
mod textures;
mod traffic;
mod tunnel;
mod way;
mod weather;
mod world;

pub use conditions::{Condition, ConditionError, ConditionKind, RAMP_S, Severities, severities_at};
pub use drive::Drive;
pub use overlay::lay_over;
pub use render::{Labelled, Renderer};
pub use source::open;
pub use spec::{DriveSpec, SpecError, stretch_m};
pub use world::{Element, Look, World, WorldError};

/// Seed of the drive and time in it, seconds, of scene `index` of the scene set `set`. Each scene is one moment of
/// another drive.
///
/// Seeds of scene sets are above 32 bits, so that no scene is a moment of a drive that a user can name with a small
/// seed.
pub fn scene_moment(set: u32, index: u32) -> (u64, f64) {
    let seed = (u64::from(set) + 1) << 32 | u64::from(index);
    (seed, f64::from(index % 600))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::cast_precision_loss)]
    use super::*;

    const SIZE: (u32, u32) = (160, 80);

    fn frame(world: &World, seed: u64, conditions: &[Condition], t_s: f64) -> (Vec<u8>, Vec<u8>) {
        let mut renderer = Renderer::new(SIZE.0, SIZE.1);
        let scene = renderer.render(&Drive::new(world, seed, conditions), t_s);
        (scene.rgb.to_vec(), scene.mask.to_vec())
    }

    /// Mean difference of two pictures.
    pub fn difference(a: &[u8], b: &[u8]) -> f64 {
        let sum: u64 = a
            .iter()
            .zip(b)
            .map(|(a, b)| u64::from(a.abs_diff(*b)))
            .sum();
        sum as f64 / a.len() as f64
    }

    fn condition(kind: ConditionKind, severity: f32) -> Condition {
        Condition {
            kind,
            severity,
            span_s: None,
        }
    }

    #[test]
    fn a_moment_is_the_same_whatever_was_rendered_before() {
        let rain: Condition = "rain:3@2-9".parse().unwrap();
        let askew = condition(ConditionKind::Askew, 4.0);
        let (sim, game) = (World::default(), World::of(Look::Game));
        let mut renderer = Renderer::new(SIZE.0, SIZE.1);
        for (world, seed, conditions, t_s) in [
            (&game, 3, vec![], 700.0),
            (&sim, 9, vec![askew], 5.0),
            (&sim, 5, vec![rain], 7.5),
            (&sim, 5, vec![rain], 0.0),
            (&sim, 5, vec![rain], 7.5),
        ] {
            let (rgb, mask) = frame(world, seed, &conditions, t_s);
            let again = renderer.render(&Drive::new(world, seed, &conditions), t_s);
            assert!(
                again.rgb == rgb && again.mask == mask,
                "seed {seed} at {t_s} s"
            );
        }
    }

    #[test]
    fn looks_change_the_picture_and_the_realistic_one_not_the_road() {
        for seed in 0..20 {
            let (sim, sim_lanes) = frame(&World::default(), seed, &[], 3.0);
            let (real, real_lanes) = frame(&World::of(Look::Realistic), seed, &[], 3.0);
            let (game, _) = frame(&World::of(Look::Game), seed, &[], 3.0);
            assert!(sim_lanes == real_lanes, "seed {seed}");
            assert!(difference(&sim, &real) > 3.0 && difference(&sim, &game) > 10.0);
        }
    }

    #[test]
    fn every_element_shows_when_it_is_left_out() {
        let changing = World {
            stretch_m: 100,
            ..World::default()
        };
        for element in Element::ALL {
            let without = World {
                without: vec![element],
                ..changing.clone()
            };
            let shows = (0..60)
                .any(|seed| frame(&changing, seed, &[], 11.0) != frame(&without, seed, &[], 11.0));
            assert!(shows, "{element}");
        }
    }

    #[test]
    fn severity_0_is_no_condition_and_worse_looks_worse() {
        let mean = |kind, severity| {
            let shift = |seed| {
                let (clear, _) = frame(&World::default(), seed, &[], 4.0);
                let (shifted, _) =
                    frame(&World::default(), seed, &[condition(kind, severity)], 4.0);
                difference(&clear, &shifted)
            };
            (0..8).map(shift).sum::<f64>() / 8.0
        };
        for kind in ConditionKind::ALL {
            let [none, light, middling, severe] = [0.0, 1.0, 3.0, 5.0].map(|s| mean(kind, s));
            assert!(
                none < 1e-9 && light > 0.3 && middling > light && severe > middling,
                "{}: {none} {light} {middling} {severe}",
                kind.name()
            );
        }
    }

    #[test]
    fn labels_lie_on_the_paint_however_the_camera_is_held() {
        let sides = World {
            without: vec![Element::Traffic, Element::Rails, Element::Shadows],
            ..World::default()
        };
        for conditions in [vec![], vec![condition(ConditionKind::Askew, 5.0)]] {
            let (mut on, mut beside) = ((0.0, 0.0), (0.0, 0.0));
            for seed in 0..20 {
                let (rgb, mask) = frame(&sides, seed, &conditions, 8.0);
                let width = SIZE.0 as usize;
                for pixel in 6..mask.len() - 6 {
                    let bright = f64::from(rgb[3 * pixel]);
                    let near = (pixel - 6..=pixel + 6).any(|p| mask[p] != 0);
                    // Markings far away are thinner than a pixel, so only the lower part of the picture is compared.
                    if pixel / width < 3 * SIZE.1 as usize / 5 {
                        continue;
                    }
                    if mask[pixel] != 0 {
                        on = (on.0 + bright, on.1 + 1.0);
                    } else if near {
                        beside = (beside.0 + bright, beside.1 + 1.0);
                    }
                }
            }
            let (on, beside) = (on.0 / on.1, beside.0 / beside.1);
            assert!(
                on > 1.08 * beside,
                "{conditions:?}: {on} on, {beside} beside"
            );
        }
    }
}
