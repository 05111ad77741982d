//! The road in view of a drive that changes: how it looks at each place. On a road that does not change, every place
//! looks like the whole drive.

use std::borrow::Cow;

use super::Drive;
use super::belts::Belt;
use super::bridge::Bridge;
use super::changes::Appearance;
use super::light::Light;
use super::markings::Layout;
use super::noise::{Draws, smooth, wander};
use super::roadside::Roadside;
use super::sensor::follow;
use super::sequence::{Passage, Stretch};
use super::shade::Shade;
use super::surroundings::{Rail, Surroundings};
use super::textures::Textures;
use super::world::Element;

/// Part of the road behind and before the car of which the way knows the stretches, metres.
const KNOWN_M: (f64, f64) = (120.0, 600.0);
/// How far the exposure follows the light on the road: the camera meters the sky too, and the larger this is, the less
/// it follows.
const METERED: f32 = 1.7;
/// The hills and the air change over a longer part of the road than the road does.
const FAR_PASSAGES: f32 = 5.0;
/// Mean length of the masses of shade under trees, metres.
const SHADE_M: f64 = 34.0;

/// The road around the car at one moment.
pub struct Way<'a> {
    drive: &'a Drive,
    s_m: f64,
    stretches: Vec<Stretch>,
    appearances: Vec<Appearance>,
}

impl<'a> Way<'a> {
    /// The road around the arc length `s_m`.
    pub fn new(drive: &'a Drive, s_m: f64) -> Self {
        let stretches = drive.changes.as_ref().map_or_else(Vec::new, |changes| {
            let (behind_m, ahead_m) = KNOWN_M;
            changes.sequence.between(s_m - behind_m, s_m + ahead_m)
        });
        Self {
            drive,
            s_m,
            appearances: drive.changes.as_ref().map_or_else(Vec::new, |changes| {
                let of = |stretch| Appearance::of(stretch, changes, &drive.surroundings);
                stretches.iter().map(of).collect()
            }),
            stretches,
        }
    }

    fn passage(&self, s_m: f64, longer: f32) -> Option<Passage> {
        (!self.stretches.is_empty()).then(|| Passage::at(&self.stretches, s_m, longer))
    }

    /// The cross-section of the road at a place.
    pub fn layout(&self, s_m: f64) -> Cow<'a, Layout> {
        self.passage(s_m, 1.0)
            .map_or(Cow::Borrowed(&self.drive.layout), |passage| {
                let cross = |index: usize| &self.appearances[index].cross;
                let here = cross(passage.here);
                Cow::Owned(if passage.share > 0.0 {
                    here.towards(cross(passage.other), passage.share).layout()
                } else {
                    here.layout()
                })
            })
    }

    /// Left and right edge of the asphalt at a place.
    pub fn edges_m(&self, s_m: f64) -> (f32, f32) {
        self.passage(s_m, 1.0)
            .map_or(self.drive.layout.asphalt_m, |passage| {
                let here = self.appearances[passage.here].cross.edges_m();
                if passage.share > 0.0 {
                    let other = self.appearances[passage.other].cross.edges_m();
                    let between = |a: f32, b: f32| a + passage.share * (b - a);
                    (between(here.0, other.0), between(here.1, other.1))
                } else {
                    here
                }
            })
    }

    /// The textures of the ground at a place: there is an edge between two kinds of asphalt, and none in the verge.
    pub fn textures(&self, s_m: f64) -> Cow<'_, Textures> {
        self.passage(s_m, 1.0).map_or(
            Cow::Borrowed(&self.drive.surroundings.textures),
            |passage| {
                let textures = |index: usize| &self.appearances[index].textures;
                let here = textures(passage.here);
                if passage.share > 0.0 {
                    Cow::Owned(here.with_verge_towards(textures(passage.other), passage.share))
                } else {
                    Cow::Borrowed(here)
                }
            },
        )
    }

    /// The ground and the hills around the car.
    pub fn surroundings(&self) -> Cow<'a, Surroundings> {
        let base = &self.drive.surroundings;
        self.passage(self.s_m + 60.0, FAR_PASSAGES)
            .map_or(Cow::Borrowed(base), |passage| {
                let height = passage.between(|index| self.appearances[index].hill_height);
                Cow::Owned(base.with_hills(height))
            })
    }

    /// The shade at a place.
    pub fn shade(&self, s_m: f64) -> Shade {
        let Some(passage) = self.passage(s_m, 1.0) else {
            return Shade::default();
        };
        let canopy = passage.between(|index| self.appearances[index].canopy);
        let mass = if canopy > 0.0 {
            let seed = self.drive.seed ^ 0x5AD3;
            smooth((0.55 + 0.9 * wander(seed, s_m / SHADE_M)).clamp(0.0, 1.0))
        } else {
            0.0
        };
        Shade {
            canopy: (1.3 * canopy * mass.max(canopy - 0.45)).min(1.0),
            roof: self
                .bridges()
                .map(|bridge| bridge.shade(s_m))
                .fold(0.0, f32::max),
        }
    }

    /// The light at `t_s`.
    pub fn light(&self, t_s: f64) -> Cow<'a, Light> {
        let base = &self.drive.light;
        let changes = self.drive.changes.as_ref();
        let passage = self.passage(self.s_m + 40.0, FAR_PASSAGES);
        changes
            .zip(passage)
            .map_or(Cow::Borrowed(base), |(changes, passage)| {
                let haze = passage.between(|index| self.appearances[index].extinction);
                Cow::Owned(base.changed(changes.sun(base, t_s), haze))
            })
    }

    /// Gain that the exposure has reached at `t_s`, because it follows the light along the road.
    pub fn gain(&self, t_s: f64) -> f32 {
        let Some(changes) = &self.drive.changes else {
            return 1.0;
        };
        let wanted = |ago_s: f64| {
            let at_m = self.s_m - ago_s * f64::from(self.drive.road.speed_mps);
            let kept = [7.0, 13.0, 22.0].map(|ahead_m| {
                let shade = self.shade(at_m + ahead_m);
                (1.0 - 0.8 * shade.canopy) * (1.0 - 0.6 * shade.roof)
            });
            let light =
                changes.sun(&self.drive.light, t_s - ago_s) * kept.iter().sum::<f32>() / 3.0;
            let passage = self.passage(at_m + 15.0, 1.0);
            let enclosed = passage.map_or(0.0, |passage| {
                passage.between(|index| self.appearances[index].enclosed)
            });
            METERED / (METERED - 1.0 + light) * (0.85 + 0.6 * enclosed)
        };
        follow(changes.world.has(Element::Exposure), wanted)
    }

    /// The bridges over the road in view.
    pub fn bridges(&self) -> impl Iterator<Item = &Bridge> {
        self.appearances.iter().filter_map(|a| a.bridge.as_ref())
    }

    /// The roadside at a place of the road; in a passage, `draws` says of which of the two stretches.
    pub fn roadside(&self, s_m: f64, draws: Draws) -> Option<&Roadside> {
        let passage = self.passage(s_m, 1.0)?;
        let index = if draws.chance("passage", passage.share) {
            passage.other
        } else {
            passage.here
        };
        self.appearances[index].roadside.as_ref()
    }

    /// Whether objects are those of the stretches.
    pub fn has_roadsides(&self) -> bool {
        self.appearances.iter().any(|a| a.roadside.is_some())
    }

    /// What stands along the side `side` (0 left, 1 right) of each stretch, with the ends of the stretch.
    pub fn belts(&self, side: usize) -> impl Iterator<Item = (usize, &Belt)> {
        let belts = self.appearances.iter().enumerate();
        belts.filter_map(move |(index, a)| {
            let belt = a.roadside.as_ref()?.belts[side].as_ref()?;
            Some((index, belt))
        })
    }

    /// How much of a belt of the stretch `index` has grown at a place, 0 to 1.
    pub fn grown(&self, index: usize, s_m: f64) -> f32 {
        let Some(passage) = self.passage(s_m, 1.0) else {
            return 1.0;
        };
        let share = if passage.here == index {
            1.0 - passage.share
        } else if passage.other == index {
            passage.share
        } else {
            0.0
        };
        (2.0 * share).min(1.0)
    }

    /// The rails on the side `side` (0 left, 1 right), and the arc lengths of their ends.
    pub fn rails(&self, side: usize) -> Vec<(&Rail, (f64, f64))> {
        if self.has_roadsides() {
            let stretches = self.stretches.iter().zip(&self.appearances);
            stretches
                .filter_map(|(stretch, a)| {
                    Some((a.roadside.as_ref()?.rails[side].as_ref()?, stretch.ends_m))
                })
                .collect()
        } else {
            let everywhere = (f64::NEG_INFINITY, f64::INFINITY);
            let rail = self.drive.surroundings.rails[side].as_ref();
            rail.map(|rail| (rail, everywhere)).into_iter().collect()
        }
    }

    /// The ends of the stretch `index`, with a share of its passages.
    pub fn ends_m(&self, index: usize, share: f32) -> (f64, f64) {
        let stretch = &self.stretches[index];
        let passages_m = stretch.passages_m;
        (
            stretch.ends_m.0 - f64::from(share * passages_m.0),
            stretch.ends_m.1 + f64::from(share * passages_m.1),
        )
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::cast_precision_loss)]

    use super::super::tests::difference;
    use super::super::{Condition, Drive, Element, Look, Renderer, World};

    const SIZE: (u32, u32) = (160, 80);

    fn changing(look: Look) -> World {
        World {
            stretch_m: 150,
            ..World::of(look)
        }
    }

    fn frame(drive: &Drive, t_s: f64) -> (Vec<u8>, Vec<u8>) {
        let mut renderer = Renderer::new(SIZE.0, SIZE.1);
        let scene = renderer.render(drive, t_s);
        (scene.rgb.to_vec(), scene.mask.to_vec())
    }

    #[test]
    fn a_moment_of_a_drive_that_changes_is_the_same_whatever_was_rendered_before() {
        let askew: Condition = "askew:3".parse().unwrap();
        for look in Look::ALL {
            let drive = Drive::new(&changing(look), 5, &[askew]);
            let mut renderer = Renderer::new(SIZE.0, SIZE.1);
            for t_s in [40.0, 3.5, 80_000.0, 40.0] {
                let again = renderer.render(&drive, t_s);
                assert!((again.rgb.to_vec(), again.mask.to_vec()) == frame(&drive, t_s));
            }
        }
    }

    #[test]
    fn elements_of_drives_that_change_have_no_effect_on_others() {
        let all = World {
            without: Element::OF_CHANGES.to_vec(),
            ..World::default()
        };
        for seed in 0..6 {
            let frame = |world: &World| frame(&Drive::new(world, seed, &[]), 21.0);
            assert!(frame(&World::default()) == frame(&all));
        }
    }

    #[test]
    fn nothing_jumps_from_one_picture_to_the_next() {
        let largest = |world: &World| {
            let mut steps = Vec::new();
            for seed in 0..6 {
                let drive = Drive::new(world, seed, &[]);
                let mut last = frame(&drive, 0.0).0;
                for n in 1..150 {
                    let next = frame(&drive, f64::from(n) * 0.1).0;
                    steps.push(difference(&last, &next));
                    last = next;
                }
            }
            steps.sort_by(f64::total_cmp);
            steps[steps.len() * 99 / 100]
        };
        let without = World {
            without: vec![Element::Bridges],
            ..changing(Look::Sim)
        };
        let (same, changes) = (largest(&World::default()), largest(&without));
        assert!(changes < 3.0 * same, "{same} {changes}");
    }

    #[test]
    fn labels_lie_on_the_lines_of_every_cross_section() {
        let world = World {
            without: vec![Element::Traffic, Element::Rails, Element::Scenery],
            ..changing(Look::Sim)
        };
        let (mut on, mut beside) = ((0.0, 0.0), (0.0, 0.0));
        for seed in 0..8 {
            let drive = Drive::new(&world, seed, &[]);
            for step in 0..12 {
                let (rgb, mask) = frame(&drive, f64::from(step) * 2.5);
                let from = mask.len() * 3 / 5;
                for pixel in from + 6..mask.len() - 6 {
                    let bright = f64::from(rgb[3 * pixel]);
                    if mask[pixel] != 0 {
                        on = (on.0 + bright, on.1 + 1.0);
                    } else if (pixel - 6..=pixel + 6).any(|p| mask[p] != 0) {
                        beside = (beside.0 + bright, beside.1 + 1.0);
                    }
                }
            }
        }
        let (on, beside) = (on.0 / on.1, beside.0 / beside.1);
        assert!(on > 1.08 * beside, "{on} on, {beside} beside");
    }

    #[test]
    fn an_unlit_night_is_dark_but_for_the_road_before_the_car() {
        let night: Condition = "night:4".parse().unwrap();
        let unlit = World {
            unlit: true,
            ..World::default()
        };
        let mean = |rgb: &[u8]| rgb.iter().map(|&b| f64::from(b)).sum::<f64>() / rgb.len() as f64;
        for seed in 0..10 {
            let [lit, unlit] = [&World::default(), &unlit]
                .map(|world| frame(&Drive::new(world, seed, &[night]), 9.0).0);
            let (sky, road) = (3 * 160 * 12, 3 * 160 * 60);
            assert!(mean(&unlit[..sky]) < 0.6 * mean(&lit[..sky]), "seed {seed}");
            assert!(
                mean(&unlit[road..]) > 2.0 * mean(&unlit[..sky]),
                "seed {seed}"
            );
            let day = |world| frame(&Drive::new(world, seed, &[]), 9.0);
            assert!(
                day(&World::default())
                    == day(&World {
                        unlit: true,
                        ..World::default()
                    })
            );
        }
    }
}
