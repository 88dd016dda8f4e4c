//! What can go wrong while measuring.

use std::path::PathBuf;

/// Errors of the evaluation crate. Each says what was wrong and what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvalError {
    /// An input holds nothing that can be measured (no points, no triangles, or only non-finite ones).
    #[error("{what} is empty: no finite {of} in it; check that the file was read with the right format and that the map holds surfaces")]
    Empty {
        /// Which input.
        what: &'static str,
        /// What it should hold: `points`, `triangles`, `poses`.
        of: &'static str,
    },
    /// A triangle names a vertex that does not exist.
    #[error("triangle {triangle} of the mesh names vertex {vertex}, but there are only {vertices} vertices; the mesh file is damaged")]
    BadIndex {
        /// Position of the triangle.
        triangle: usize,
        /// The index it names.
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
         check that both are in the same map frame, or give a first guess of the alignment",
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
    #[error(
        "the source measures {source_m:.1} m and the target {target_m:.1} m, {ratio:.4} to 1: the {culprit} seems to be in {unit}; convert it to metres (multiply by {factor})"
    )]
    Units {
        /// Extent of the source over that of the target.
        ratio: f64,
        /// Diagonal of the source, in its own unit.
        source_m: f64,
        /// Diagonal of the target, in its own unit.
        target_m: f64,
        /// Which input seems to be in the other unit.
        culprit: &'static str,
        /// The unit's name.
        unit: &'static str,
        /// What to multiply the culprit by.
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
