//! How pictures of paths show the map below them.

use voxelastic::field::occupancy::State;
use voxelastic_eval::colour::Rgb;

const OCCUPIED: Rgb = [60, 62, 68];
const FREE: Rgb = [255, 255, 255];
const UNKNOWN: Rgb = [200, 203, 208];
/// Largest number of pixels along a side; larger pixels are used beyond.
const MOST_PIXELS: f64 = 2400.0;

/// The legend of [`cells`].
pub const LEGEND: [(Rgb, &str); 3] = [(FREE, "free"), (OCCUPIED, "occupied"), (UNKNOWN, "unknown")];

/// The colours of a slice.
pub fn cells(states: &[State]) -> Vec<Rgb> {
    let colour = |state: &State| match state {
        State::Occupied => OCCUPIED,
        State::Free => FREE,
        State::Unknown => UNKNOWN,
    };
    states.iter().map(colour).collect()
}

/// Edge of a pixel for a picture of this size, metres.
pub fn pixel(voxel: f64, size: [f32; 3]) -> f64 {
    voxel.max(f64::from(size[0].max(size[1])) / MOST_PIXELS)
}
