//! The voxel size that suits a sensor where it is.

/// Edges of the finest voxels that are chosen automatically, metres, and their share of the root mean square range.
const VOXEL_SIZES: (f64, f64, f64) = (0.2, 0.7, 0.08);

/// Edge of the finest voxels for a scan with these returns, metres.
pub(crate) fn automatic_voxel_size(points: &[[f32; 3]]) -> f64 {
    let (least, most, share) = VOXEL_SIZES;
    let squares = points.iter().map(|p| p.iter().map(|v| f64::from(*v) * f64::from(*v)).sum::<f64>());
    let square = squares.sum::<f64>() / points.len().max(1) as f64;
    (share * square.sqrt()).clamp(least, most)
}
