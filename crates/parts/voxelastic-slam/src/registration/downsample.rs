//! Voxel-grid downsampling: the mean of the points of each cell, in the order in which cells are first met.

use super::voxel_index::{VoxelIndex, key};

/// A downsampler that keeps its memory from scan to scan.
#[derive(Clone, Debug, Default)]
pub(crate) struct Downsampler {
    index: VoxelIndex,
    cells: Vec<[f32; 4]>,
}

impl Downsampler {
    /// Writes the mean of the points in each cell of edge `size`, metres.
    pub(crate) fn means(&mut self, points: &[[f32; 3]], size: f32, out: &mut Vec<[f32; 3]>) {
        self.index.clear();
        self.cells.clear();
        let per_metre = 1.0 / size;
        // Neighbours in a scan are mostly neighbours in space.
        let (mut last_key, mut last) = (u64::MAX, 0u32);
        for p in points {
            let key = key(p.map(|v| (v * per_metre).floor() as i32));
            if key != last_key {
                let (cell, is_new) = self.index.get_or_insert(key, self.cells.len() as u32);
                if is_new {
                    self.cells.push([0.0; 4]);
                }
                (last_key, last) = (key, cell);
            }
            let cell = &mut self.cells[last as usize];
            *cell = [cell[0] + p[0], cell[1] + p[1], cell[2] + p[2], cell[3] + 1.0];
        }
        out.clear();
        out.extend(self.cells.iter().map(|[x, y, z, n]| [x / n, y / n, z / n]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_of_cells() {
        let mut out = Vec::new();
        let points = [[0.1, 0.1, 0.1], [5.0, 0.0, 0.0], [0.3, 0.1, 0.1], [-0.1, 0.1, 0.1]];
        Downsampler::default().means(&points, 1.0, &mut out);
        assert_eq!(out, [[0.2, 0.1, 0.1], [5.0, 0.0, 0.0], [-0.1, 0.1, 0.1]]);
    }
}
