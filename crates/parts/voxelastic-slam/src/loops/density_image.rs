//! A place seen from above: how much stands in each cell of a square grid.

use super::plane_fft::SIDE;

/// Most heights of a column that count.
const MOST_HEIGHTS: u32 = 12;

/// A cell in which something stands: its centre, metres from the anchor in the levelled frame, and how much.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Column {
    pub(crate) x: f32,
    pub(crate) y: f32,
    pub(crate) value: f32,
}

/// Edge of a cell for voxels of edge `voxel`, metres: so that the grid covers what a sensor sees for which such voxels are chosen.
pub(crate) fn cell_size(voxel: f32) -> f32 {
    1.6 * voxel
}

/// The columns of a levelled cloud (z up). What is one voxel high, such as the ground, does not count.
pub(crate) fn columns(points: impl Iterator<Item = [f32; 3]>, voxel: f32) -> Vec<Column> {
    let cell = cell_size(voxel);
    let half = SIDE as i32 / 2;
    let mut heights = vec![0u64; SIDE * SIDE];
    for [x, y, z] in points {
        let (column, row) = ((x / cell).round() as i32 + half, (y / cell).round() as i32 + half);
        let height = (z / voxel).floor() as i32 + 32;
        if (0..SIDE as i32).contains(&column) && (0..SIDE as i32).contains(&row) && (0..64).contains(&height) {
            heights[row as usize * SIDE + column as usize] |= 1 << height;
        }
    }
    let stands = heights.iter().enumerate().filter(|(_, bits)| bits.count_ones() > 1);
    stands
        .map(|(k, bits)| Column {
            x: ((k % SIDE) as i32 - half) as f32 * cell,
            y: ((k / SIDE) as i32 - half) as f32 * cell,
            value: ((bits.count_ones() - 1).min(MOST_HEIGHTS) as f32).sqrt(),
        })
        .collect()
}

/// The image of columns turned by `yaw` radians about the anchor, row by row, each spread over the four nearest cells.
pub(crate) fn image(columns: &[Column], voxel: f32, yaw: f32) -> Vec<f32> {
    let cell = cell_size(voxel);
    let (sin, cos) = yaw.sin_cos();
    let mut image = vec![0.0; SIDE * SIDE];
    let half = (SIDE / 2) as f32;
    for Column { x, y, value } in columns {
        let (u, v) = ((cos * x - sin * y) / cell + half, (sin * x + cos * y) / cell + half);
        if u < 0.0 || v < 0.0 || u >= (SIDE - 1) as f32 || v >= (SIDE - 1) as f32 {
            continue;
        }
        let (column, row) = (u as usize, v as usize);
        let (a, b) = (u - column as f32, v - row as f32);
        let at = row * SIDE + column;
        image[at] += value * (1.0 - a) * (1.0 - b);
        image[at + 1] += value * a * (1.0 - b);
        image[at + SIDE] += value * (1.0 - a) * b;
        image[at + SIDE + 1] += value * a * b;
    }
    image
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walls_count_and_the_ground_does_not() {
        let ground = (0..100).map(|i| [i as f32 * 0.3 - 15.0, 2.0, 0.05]);
        let wall = (0..40).flat_map(|i| (0..10).map(move |k| [5.0, i as f32 * 0.2 - 4.0, 0.2 * k as f32 + 0.1]));
        let found = columns(ground.chain(wall), 0.2);
        assert!(found.len() > 20 && found.iter().all(|c| (c.x - 5.0).abs() <= 0.17 && c.value > 2.9), "{found:?}");
        // Turned by a quarter, the wall is in front.
        let turned = image(&found, 0.2, std::f32::consts::FRAC_PI_2);
        let sum = |rows: std::ops::Range<usize>| turned[rows.start * SIDE..rows.end * SIDE].iter().sum::<f32>();
        assert!(sum(78..82) > 0.99 * sum(0..SIDE));
    }
}
