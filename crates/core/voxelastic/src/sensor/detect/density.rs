//! Sensors whose beams are on no lattice: pixels as large as the directions of returns are apart.

use super::angles::Direction;
use crate::Cloud;
use crate::sensor::beam_model::BeamModel;
use crate::sensor::error::SensorError;
use hashbrown::HashSet;

/// Edge of the cells with which the field of view is measured, radians.
const CELL: f32 = 0.035;
/// Returns in a pixel, on average: four of five pixels of the field of view have one then.
const RETURNS_IN_PIXEL: f32 = 1.5;

/// An even model of the field of view of `clouds`, in which most pixels have a return.
pub(super) fn recognise(clouds: &[&Cloud]) -> Result<BeamModel, SensorError> {
    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
    let (mut seen, mut returns) = (0.0, 0usize);
    for cloud in clouds {
        let mut cells = HashSet::new();
        for direction in cloud.points.iter().filter_map(Direction::of) {
            (low, high) = (low.min(direction.elevation), high.max(direction.elevation));
            returns += 1;
            let row = (direction.elevation / CELL).floor() as i32;
            // Cells of equal area.
            let per_radian = ((row as f32 + 0.5) * CELL).cos().max(0.01) / CELL;
            cells.insert((row, (direction.azimuth * per_radian).floor() as i32));
        }
        seen += cells.len() as f32 * CELL * CELL;
    }
    if returns == 0 || high - low < 1e-3 {
        return Err(SensorError::NoSpread);
    }
    let pixel = (RETURNS_IN_PIXEL * seen / returns as f32).sqrt().max(1e-3);
    let rows = (((high - low) / pixel).ceil() as usize + 1).clamp(4, 1024);
    let columns = ((std::f32::consts::TAU / pixel).round() as usize).clamp(16, 16_384);
    Ok(BeamModel::even(rows, columns, high, low)?.with_name("scattered beams"))
}
