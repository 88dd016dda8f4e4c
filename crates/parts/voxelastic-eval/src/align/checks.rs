//! Checks of the input: empty clouds, disjoint clouds, clouds in different units.

use super::settings::AlignSettings;
use crate::mesh::bounds;
use crate::{EvalError, error::Result};
use nalgebra::Point3;
use voxelastic::Pose;
use voxelastic::geometry::Aabb;

/// Other units of files: name, and factor to metres.
const UNITS: [(&str, f64); 3] = [("millimetres", 0.001), ("centimetres", 0.01), ("feet", 0.3048)];

pub(super) fn settings(s: &AlignSettings) -> Result<()> {
    let bad = |v: f32| !(v > 0.0 && v.is_finite());
    if s.voxels.is_empty() || s.voxels.iter().any(|v| bad(*v)) {
        let value = s.voxels.iter().copied().find(|v| bad(*v)).map_or(0.0, f64::from);
        return Err(EvalError::Setting { setting: "voxel size of the alignment", value, must: "positive, one per level" });
    }
    let guess = &s.t_target_source;
    if !guess.translation.vector.iter().chain(guess.rotation.coords.iter()).all(|v| v.is_finite()) {
        return Err(EvalError::Setting { setting: "initial guess of the alignment", value: f64::NAN, must: "a pose of finite numbers" });
    }
    if bad(s.reach) {
        return Err(EvalError::Setting { setting: "reach", value: f64::from(s.reach), must: "positive" });
    }
    Ok(())
}

/// Boxes of the two clouds.
pub(super) struct Extents {
    source: Aabb,
    target: Aabb,
}

/// Rejects empty clouds, and clouds of which one seems to be in millimetres or centimetres.
pub(super) fn extents(source: &[[f32; 3]], target: &[[f32; 3]]) -> Result<Extents> {
    let extents = Extents { source: bounds(source), target: bounds(target) };
    for (aabb, what) in [(&extents.source, "the source cloud"), (&extents.target, "the target cloud")] {
        if aabb.is_empty() {
            return Err(EvalError::Empty { what, of: "points" });
        }
    }
    // A map may cover only a part of the truth, but hardly a hundredth of it.
    match extents.units(0.5, &UNITS[..2]) {
        Some(error) => Err(error),
        None => Ok(extents),
    }
}

impl Extents {
    /// The error for a unit that explains the extents: the ratios of the two longest sides are within a factor of `1 + slack` of the unit's.
    fn units(&self, slack: f64, units: &[(&'static str, f64)]) -> Option<EvalError> {
        let sides = |b: &Aabb| {
            let mut s = b.size().map(f64::from);
            s.sort_by(f64::total_cmp);
            s
        };
        let (s, t) = (sides(&self.source), sides(&self.target));
        let diagonal = |s: [f64; 3]| s.iter().map(|v| v * v).sum::<f64>().sqrt();
        let (source_m, target_m) = (diagonal(s), diagonal(t));
        let fits = |ratio: f64, factor: f64| (ratio * factor).max(1.0 / (ratio * factor)) <= 1.0 + slack;
        for &(unit, factor) in units {
            for (culprit, inverse) in [("source", false), ("target", true)] {
                let agrees = |k: usize| fits(if inverse { t[k] / s[k] } else { s[k] / t[k] }, factor);
                if agrees(2) && agrees(1) {
                    return Some(EvalError::Units { ratio: source_m / target_m, source_m, target_m, culprit, unit, factor });
                }
            }
        }
        None
    }

    /// Whether one cloud has the size of the other in feet.
    pub fn looks_like_feet(&self) -> bool {
        self.units(0.15, &UNITS[2..]).is_some()
    }

    /// The error for clouds that do not overlap.
    pub fn disjoint(&self, overlap: f64, reach: f32, t_target_source: &Pose) -> EvalError {
        let centre = |b: &Aabb| std::array::from_fn(|k| 0.5 * (b.min[k] + b.max[k]));
        let moved = t_target_source * Point3::from(centre(&self.source)).cast::<f64>();
        let disjoint = EvalError::Disjoint {
            overlap,
            radius_m: f64::from(reach),
            source_centre: [moved.x as f32, moved.y as f32, moved.z as f32],
            target_centre: centre(&self.target),
        };
        self.units(0.15, &UNITS).unwrap_or(disjoint)
    }
}
