//! Errors of this crate.

use std::path::PathBuf;

/// Errors of the evaluation crate, each with a remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvalError {
    /// An input is empty (no points, no triangles, or only non-finite ones).
    #[error("{what} is empty: no finite {of} in it; check that the file was read with the right format and that the map holds surfaces")]
    Empty {
        /// Which input.
        what: &'static str,
        /// What it lacks: `points`, `triangles`, `poses`.
        of: &'static str,
    },
    /// A triangle refers to a vertex that does not exist.
    #[error("triangle {triangle} of the mesh refers to vertex {vertex}, but there are only {vertices} vertices; the mesh file is damaged")]
    BadIndex {
        /// Position of the triangle.
        triangle: usize,
        /// The index.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// Two arrays that belong together differ in length.
    #[error("{what}: {got} values for {expected} elements; give one value per element")]
    Length {
        /// Which array.
        what: &'static str,
        /// Its length.
        got: usize,
        /// The length it should have.
        expected: usize,
    },
    /// A setting lies outside its range.
    #[error("{setting} is {value}, but must be {must}")]
    Setting {
        /// Name of the setting.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// The allowed range, in words.
        must: &'static str,
    },
    /// The clouds have no region in common, so that there is nothing to align or compare.
    #[error(
        "the clouds are disjoint: only {:.1} % of the source has a target point within {radius_m} m (source centred at {source_centre:.1?}, target at {target_centre:.1?}); \
         check that both are in the same map frame, or give an initial guess of the alignment",
        overlap * 100.0
    )]
    Disjoint {
        /// Share of source points with a neighbour, 0 to 1.
        overlap: f64,
        /// The search radius, metres.
        radius_m: f64,
        /// Centre of the source's box, metres.
        source_centre: [f32; 3],
        /// Centre of the target's box, metres.
        target_centre: [f32; 3],
    },
    /// The extents suggest that one input is not in metres.
    #[error("{}: the {culprit} seems to be in {unit}, not in metres; multiply its coordinates by {factor}", size_ratio(*source_m, *target_m))]
    Units {
        /// Diagonal of the source over that of the target.
        ratio: f64,
        /// Diagonal of the source, in its own unit.
        source_m: f64,
        /// Diagonal of the target, in its own unit.
        target_m: f64,
        /// Which input seems to be in another unit: `source` or `target`.
        culprit: &'static str,
        /// The unit's name.
        unit: &'static str,
        /// What to multiply its coordinates by.
        factor: f64,
    },
    /// Too few items for the computation.
    #[error("{what}: found {found}, need at least {needed}")]
    TooFew {
        /// Which items.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// A file could not be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A picture could not be made.
    #[error("cannot make a picture of {width} x {height} pixels: {reason}")]
    Picture {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
        /// Why.
        reason: String,
    },
}

/// Result of the evaluation crate.
pub type Result<T> = std::result::Result<T, EvalError>;

/// The sizes of two clouds in words, the larger one first.
fn size_ratio(source: f64, target: f64) -> String {
    let ((larger, a), (smaller, b)) =
        if source >= target { (("source", source), ("target", target)) } else { (("target", target), ("source", source)) };
    let times = a / b;
    let times = if times < 20.0 { format!("{times:.1}") } else { format!("{times:.0}") };
    format!("the {larger} is {times} times as large as the {smaller} (diagonals {a:.1} and {b:.1})")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_errors_name_the_larger_cloud_first() {
        let units = |source_m: f64, target_m: f64, culprit, unit, factor| {
            EvalError::Units { ratio: source_m / target_m, source_m, target_m, culprit, unit, factor }.to_string()
        };
        assert_eq!(
            units(30.0, 29_000.0, "target", "millimetres", 0.001),
            "the target is 967 times as large as the source (diagonals 29000.0 and 30.0): the target seems to be in millimetres, not in metres; \
             multiply its coordinates by 0.001"
        );
        assert!(units(98.4, 30.0, "source", "feet", 0.3048).starts_with("the source is 3.3 times as large as the target"));
    }
}
