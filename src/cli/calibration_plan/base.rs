//! Whether accepted roads can be added to a reference, before any of them is looked at.

use std::collections::HashSet;

use anyhow::bail;
use gapwatch::reference::{COMPONENTS_MAX, Reference, Role};

use super::CalibrationPlan;

impl CalibrationPlan {
    /// Refuses roads that cannot be added to a reference; `base` is what was typed for it.
    pub fn check_base(&self, reference: &Reference, base: &str) -> anyhow::Result<()> {
        for component in &reference.components {
            if self.accepted.contains_key(&component.name) {
                bail!(
                    "domain {} is in the reference {base} already; wanted another name with --accept-as",
                    component.name
                );
            }
        }
        // A drive with lane labels may also be looked at as a plain drive.
        let plain = reference.provenance.sources.iter();
        let plain = plain.filter(|of| of.role != Some(Role::Labelled));
        let known: HashSet<&str> = plain.map(|of| of.source.as_str()).collect();
        let mut roads = self.accepted.values().flatten();
        if let Some(road) = roads.find(|road| known.contains(road.as_str())) {
            bail!(
                "source {road} is in the reference {base} already; wanted roads that it was not made from"
            );
        }
        let domains = self.accepted.len() + reference.components.len();
        if domains > COMPONENTS_MAX {
            bail!(
                "{domains} nominal domains with those of {base}; wanted at most {COMPONENTS_MAX}"
            );
        }
        Ok(())
    }
}
