//! What changes and gaps look like under known causes: linear discriminants of deviations.
//!
//! A deviation is a vector of whitened numbers, tap after tap: a change against the past, or a gap against what is
//! nominal. Each number `z` is compressed to `sign(z) ln(1 + |z|)`, so that a mild and a severe condition of one kind lie
//! close together. Every kind of cause has a centre there, and all kinds have one spread. The nearest centre is the kind;
//! if no centre is near, the cause is [`Cause::Other`].

use serde::{Deserialize, Serialize};

use crate::reference::cause::{Cause, LikelyCause};
use crate::reference::gap::energy_norm::{EnergyNorm, each_whitened};
use crate::reference::nominal::{Nominal, TapReference};
use crate::reference::span::Span;

/// Largest number of kinds.
pub const KINDS_MAX: usize = Cause::ALL.len();
/// How fast it becomes improbable that a kind fits when its centre is farther than [`Discriminant::fits_within`]. Not
/// critical: at 4, the share told as `other` hardly depends on it.
const FIT_POWER: i32 = 4;

/// One number for each kind, in their order.
pub type OfKinds = heapless::Vec<f64, KINDS_MAX>;

/// What is explained by a cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Explained {
    /// The difference of the last seconds from the past before them.
    Change,
    /// The difference of the window from what is nominal.
    Gap,
}

/// What changes and gaps look like under known causes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Causes {
    /// The kinds that are known, each once.
    pub kinds: Vec<CauseKind>,
    /// What changes look like.
    pub change: Discriminant,
    /// What gaps look like.
    pub gap: Discriminant,
}

/// A kind of cause that is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CauseKind {
    /// The cause.
    pub cause: Cause,
    /// Number of drives from which it was learnt.
    pub drives: usize,
}

/// A linear discriminant of compressed deviations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Discriminant {
    /// One for each tap.
    pub blocks: Vec<DiscriminantBlock>,
    /// Distance from the nearest centre at which it is as likely as not that a kind fits.
    pub fits_within: f64,
    /// How fast a kind becomes less probable with its distance.
    pub sharpness: f64,
    /// Deviations of drives that made no centre.
    pub judged: usize,
    /// Those of them whose cause was told right.
    pub right: usize,
}

/// The part of a discriminant that belongs to one tap.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DiscriminantBlock {
    /// `[energies (energies + 1) / 2]`: lower triangle, row by row, of the matrix that whitens the spread inside kinds.
    pub whitening: Vec<f32>,
    /// `[kinds][energies]`, whitened centres.
    pub centres: Vec<Vec<f32>>,
}

impl Explained {
    /// Place of the span whose change is explained.
    pub fn span() -> usize {
        let change = Span::ALL.iter().position(|span| span.is_change());
        change.unwrap_or(Span::ALL.len())
    }

    /// The norm that whitens deviations of a tap; `None` if the reference has none.
    fn norm(self, tap: &TapReference) -> Option<&EnergyNorm> {
        match (self, &tap.nominal) {
            (Self::Change, _) => tap.spans.get(Self::span()).map(|of| &of.norm),
            (Self::Gap, Nominal::Energies(norm)) => Some(norm),
            (Self::Gap, _) => None,
        }
    }

    /// Writes the compressed deviation from a nominal domain, given by its taps, `[energies of all taps]`, where `level` gives a mean level
    /// or a difference of levels by its place, nats. `None` if the domain has no norm for it. Allocates nothing.
    pub fn deviation(
        self,
        domain: &[TapReference],
        level: impl Fn(usize) -> f64,
        deviation: &mut [f64],
    ) -> Option<()> {
        let mut from = 0;
        for tap in domain {
            let own = deviation.get_mut(from..from + tap.nominal.len())?;
            let level = |column: usize| level(from + column);
            self.norm(tap)?.whiten(level, |row, z| {
                own[row] = z.signum() * z.abs().ln_1p();
            });
            from += own.len();
        }
        Some(())
    }
}

impl Causes {
    /// The cause of a compressed deviation. Allocates nothing.
    pub fn likely(&self, explained: Explained, deviation: &[f64]) -> LikelyCause {
        let discriminant = match explained {
            Explained::Change => &self.change,
            Explained::Gap => &self.gap,
        };
        let (kinds, other) = discriminant.probabilities(&discriminant.distances(deviation));
        let causes = self.kinds.iter().map(|kind| kind.cause);
        causes.zip(kinds).fold(
            LikelyCause {
                cause: Cause::Other,
                probability: other,
            },
            |likely, (cause, probability)| {
                if probability > likely.probability {
                    LikelyCause { cause, probability }
                } else {
                    likely
                }
            },
        )
    }

    /// What is wrong with it beside a domain of the same reference, if anything.
    pub(super) fn fault(&self, domain: &[TapReference]) -> Option<String> {
        let kinds = &self.kinds;
        let unique = (1..kinds.len()).all(|at| {
            let mut earlier = kinds[..at].iter();
            earlier.all(|of| of.cause != kinds[at].cause)
        });
        if !unique || kinds.len() < 2 || kinds.iter().any(|of| of.cause == Cause::Other) {
            let names: Vec<&str> = kinds.iter().map(|of| of.cause.name()).collect();
            return Some(format!(
                "kinds {names:?}, wanted two or more different ones"
            ));
        }
        [
            (Explained::Change, &self.change),
            (Explained::Gap, &self.gap),
        ]
        .into_iter()
        .find_map(|(explained, of)| {
            if domain.iter().any(|tap| explained.norm(tap).is_none()) {
                return Some("wanted a reference of energies with spans".to_owned());
            }
            of.fault(domain, kinds.len())
        })
    }
}

impl Discriminant {
    /// Squared distance of a compressed deviation from the centre of every kind, divided by the number of energies.
    /// Allocates nothing.
    pub fn distances(&self, deviation: &[f64]) -> OfKinds {
        let kinds = self.blocks.first().map_or(0, |block| block.centres.len());
        let mut distances: OfKinds = std::iter::repeat_n(0.0, kinds.min(KINDS_MAX)).collect();
        let mut rest = deviation;
        for block in &self.blocks {
            let energies = block.centres.first().map_or(0, Vec::len).min(rest.len());
            let (own, others) = rest.split_at(energies);
            rest = others;
            each_whitened(
                &block.whitening,
                energies,
                |column| own[column],
                |row, across| {
                    for (distance, centre) in distances.iter_mut().zip(&block.centres) {
                        *distance += (across - f64::from(centre[row])).powi(2);
                    }
                },
            );
        }
        // Deviations have a few hundred numbers.
        #[allow(clippy::cast_precision_loss)]
        let share = 1.0 / deviation.len().max(1) as f64;
        distances.iter_mut().for_each(|distance| *distance *= share);
        distances
    }

    /// The probability of every kind, and that no kind fits.
    pub fn probabilities(&self, distances: &OfKinds) -> (OfKinds, f64) {
        let nearest = distances.iter().copied().fold(f64::INFINITY, f64::min);
        let fits = 1.0 / (1.0 + (nearest / self.fits_within).powi(FIT_POWER));
        let weight = |distance: &f64| (self.sharpness * (nearest - distance)).exp();
        let all: f64 = distances.iter().map(weight).sum();
        let kinds = distances.iter().map(|of| fits * weight(of) / all);
        (kinds.collect(), 1.0 - fits)
    }

    fn fault(&self, domain: &[TapReference], kinds: usize) -> Option<String> {
        let positive = |number: f64| number.is_normal() && number > 0.0;
        if !positive(self.fits_within) || !positive(self.sharpness) {
            return Some(format!(
                "fits_within {} and sharpness {}, wanted numbers above 0",
                self.fits_within, self.sharpness
            ));
        }
        if self.right > self.judged {
            return Some(format!("{} right of {}", self.right, self.judged));
        }
        if self.blocks.len() != domain.len() {
            return Some(format!(
                "{} blocks beside {} taps",
                self.blocks.len(),
                domain.len()
            ));
        }
        let mut blocks = self.blocks.iter().zip(domain);
        blocks.find_map(|(block, tap)| block.fault(tap.nominal.len(), kinds))
    }
}

impl DiscriminantBlock {
    /// A centre as it is kept: whitened.
    pub fn whitened(whitening: &[f32], centre: &[f64]) -> Vec<f32> {
        let mut whitened = Vec::with_capacity(centre.len());
        // Compressed numbers are far inside of what an f32 can hold.
        #[allow(clippy::cast_possible_truncation)]
        each_whitened(
            whitening,
            centre.len(),
            |column| centre[column],
            |_, across| {
                whitened.push(across as f32);
            },
        );
        whitened
    }

    fn fault(&self, energies: usize, kinds: usize) -> Option<String> {
        let wanted = energies * (energies + 1) / 2;
        let finite = |numbers: &[f32]| numbers.iter().all(|number| number.is_finite());
        if self.whitening.len() != wanted || !finite(&self.whitening) {
            return Some(format!(
                "{} whitening weights for {energies} energies, wanted {wanted} finite ones",
                self.whitening.len()
            ));
        }
        let whole = |centre: &Vec<f32>| centre.len() == energies && finite(centre);
        (self.centres.len() != kinds || !self.centres.iter().all(whole)).then(|| {
            format!(
                "{} centres, wanted {kinds} of {energies} finite numbers each",
                self.centres.len()
            )
        })
    }
}

#[cfg(test)]
mod tests;
