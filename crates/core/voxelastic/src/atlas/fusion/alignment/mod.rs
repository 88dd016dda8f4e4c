//! Submaps are bent onto each other before they are fused for a surface.
//!
//! After a correction, submaps that saw the same place still lie a few voxels apart, by a different vector from place to place: residual drift. Bands around
//! surfaces are three voxels wide, so means of distances cannot make one surface of two that far apart. Therefore each submap gets a smooth
//! [`Displacement`]: one vector per cell of 64 voxels, by least squares over pairs of places on the surfaces of two submaps. Of two surfaces both move
//! half the way, so that the result is their mean along the normal; where only one direction is known, as on a floor, neighbouring cells decide on the others.
//!
//! Where a correction moved the scans of a submap relative to each other, the submap is bent as the scans moved first: its fields are those of the scans as they were.
//!
//! Two fields whose scans nothing has corrected, and that do not come clearly nearer to each other, are not bent onto each other: what was paired there are different
//! things that stand close together.
//! What is too far apart or does not match in most places is not pulled together: it is refused, and counted.

mod corrections;
mod displacement;
mod found;
mod pairs;
mod solve;
mod surface_points;

pub(crate) use corrections::Corrections;
pub(super) use displacement::{CubeOffset, Displacement};

use super::placement::Placement;
use crate::field::tsdf::TsdfField;
use displacement::{Cell, cell_of, middle_of};
use found::{Found, Term};
use hashbrown::{HashMap, HashSet};
pub use pairs::PairAgreement;
use pairs::{Pairs, REACH};
pub(crate) use surface_points::places_on_surface;
use surface_points::surface_points;

/// How far apart two places may be that are taken for the same surface, voxels: less in each round, once the displacements of the round before are known.
const ROUNDS: [f32; 3] = [REACH, 3.0, 2.0];

/// Where corrections of the scans of a field alone say that it is: the displacement that is expected before it is compared with others.
pub(super) fn expected(field: &TsdfField, placement: &Placement, corrections: &Corrections) -> Displacement {
    if corrections.is_empty() {
        return Displacement::default();
    }
    Displacement::new(cells_of(field, placement).into_iter().map(|cell| (cell, corrections.at(middle_of(cell)))))
}

/// Displacements by all pairs but those of `refused` fields; `first` are the pairs of the first round.
fn bent(pairs: &Pairs, expected: &[HashMap<Cell, [f32; 3]>], first: &Found, refused: &HashSet<[usize; 2]>) -> Vec<Displacement> {
    let terms_of = |found: &Found| found.terms().into_iter().filter(|term| !refused.contains(&term.fields)).collect::<Vec<Term>>();
    let mut terms = terms_of(first);
    for reach in &ROUNDS[1..] {
        // What asks for nothing with a large reach does not with a smaller one.
        if terms.is_empty() {
            break;
        }
        terms = terms_of(&pairs.find(&solve::displacements(expected, &terms), *reach));
    }
    solve::displacements(expected, &terms)
}

/// Displacements of fields that lie in one lattice, and how they agree.
#[derive(Debug, Default)]
pub(super) struct Alignment {
    /// By field.
    pub displacements: Vec<Displacement>,
    /// Of all pairs of fields that have surfaces in the same cells, ascending; numbers of fields instead of submaps.
    pub agreement: Vec<PairAgreement>,
}

impl Alignment {
    /// Aligns fields, each with its placement in the common lattice and the corrections of its scans. The result does not depend on the number of threads.
    pub fn new(fields: &[(&TsdfField, Placement, Corrections)]) -> Self {
        let expected: Vec<HashMap<Cell, [f32; 3]>> = fields
            .iter()
            .map(|(field, placement, corrections)| {
                cells_of(field, placement).into_iter().map(|cell| (cell, corrections.at(middle_of(cell)))).collect()
            })
            .collect();
        let mut owners: HashMap<Cell, u32> = HashMap::new();
        expected.iter().flat_map(HashMap::keys).for_each(|cell| *owners.entry(*cell).or_default() += 1);
        let as_expected: Vec<Displacement> =
            expected.iter().map(|cells| Displacement::new(cells.iter().map(|(cell, vector)| (*cell, *vector)))).collect();
        if owners.values().all(|count| *count < 2) {
            return Self { displacements: as_expected, agreement: Vec::new() };
        }
        let is_shared = |cell: &Cell| owners.get(cell).is_some_and(|count| *count > 1);
        let points = fields.iter().enumerate().flat_map(|(i, (field, placement, _))| surface_points(field, placement, i as u32, is_shared)).collect();
        let pairs = Pairs::new(points, fields.len());
        let unmoved: Vec<Displacement> = fields.iter().map(|_| Displacement::default()).collect();
        let before = pairs.find(&unmoved, REACH);
        let corrected = (as_expected != unmoved).then(|| pairs.find(&as_expected, REACH));
        let first = corrected.as_ref().unwrap_or(&before);
        let all = bent(&pairs, &expected, first, &HashSet::new());
        let after = pairs.find(&all, REACH);
        // Scans that were corrected have drifted; what is left of that is between their submaps.
        let is_trusted = |fields_of: &[usize; 2]| fields_of.iter().all(|field| fields[*field].2.is_empty());
        let mut refused = first.not_explained(&after);
        refused.retain(is_trusted);
        if refused.is_empty() {
            return Self { displacements: all, agreement: pairs.agreement(&before, &after) };
        }
        drop(after);
        let displacements = bent(&pairs, &expected, first, &refused);
        let moved = (displacements != as_expected).then(|| pairs.find(&displacements, REACH));
        let agreement = pairs.agreement(&before, moved.as_ref().unwrap_or(first));
        Self { displacements, agreement }
    }
}

/// The cells in which a field has blocks.
fn cells_of(field: &TsdfField, placement: &Placement) -> HashSet<Cell> {
    field.ids().map(|id| cell_of(placement.middle_in_target(field.block(id).key))).collect()
}

#[cfg(test)]
mod tests;
