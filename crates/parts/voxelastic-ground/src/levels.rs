//! The levels of each column: surfaces with free space above them, on which something could stand.

use crate::columns::Columns;
use rayon::prelude::*;
use voxelastic::query::DistanceQuery;

/// Free space above a level begins no higher than this above what carries it, metres: in between nothing is known, as beams that meet a floor at a flat angle are far apart.
pub(crate) const GAP: f64 = 0.4;
/// Least free space above a level, metres.
const LEAST_FREE: f64 = 0.2;
/// A surface is looked for this many voxels above the top of what is occupied ...
const ABOVE: f64 = 1.5;
/// ... to this many below: far from the sensor, voxels are up to eight times as large.
const BELOW: f64 = 8.0;
/// Distance between the points at which surfaces are looked for, voxels.
const STEP: f64 = 0.5;
/// Noise of a height that the distance field shows, voxels; of one that is the top of a voxel it is that of a uniform error.
const SURFACE_NOISE: f64 = 0.08;

/// A level of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Height of its surface in the map frame, metres.
    pub height: f32,
    /// Standard deviation of that, metres.
    pub sigma: f32,
    /// Upper end of the voxels that carry it, metres.
    pub top: f32,
    /// From there to what is occupied above, metres; infinite if nothing is.
    pub headroom: f32,
}

/// The levels of all columns.
#[derive(Clone, Debug)]
pub struct Levels {
    starts: Vec<u32>,
    levels: Vec<Level>,
}

impl Levels {
    /// The levels of `columns`, with their heights from the distance field where there is one.
    pub fn of(columns: &Columns, surfaces: &DistanceQuery<'_>) -> Self {
        let cells = columns.cells();
        let of_row = |y: usize| -> Vec<(u32, Vec<Level>)> {
            let row = y * cells.size[0]..(y + 1) * cells.size[0];
            row.map(|cell| levels_of(columns, cell)).map(|levels| (levels.len() as u32, levels)).collect()
        };
        let rows: Vec<Vec<(u32, Vec<Level>)>> = (0..cells.size[1]).into_par_iter().map(of_row).collect();
        let mut found = Self { starts: vec![0], levels: Vec::new() };
        for (_, levels) in rows.into_iter().flatten() {
            found.levels.extend(levels);
            found.starts.push(found.levels.len() as u32);
        }
        if !surfaces.is_empty() {
            found.refine(columns, surfaces);
        }
        found
    }

    /// Levels at these heights, under the sky or the next.
    #[cfg(test)]
    pub(crate) fn at(heights: &[Vec<f32>]) -> Self {
        let mut made = Self { starts: vec![0], levels: Vec::new() };
        for cell in heights {
            for (k, &height) in cell.iter().enumerate() {
                let headroom = cell.get(k + 1).map_or(f32::INFINITY, |above| above - height - 0.2);
                made.levels.push(Level { height, sigma: 0.01, top: height, headroom });
            }
            made.starts.push(made.levels.len() as u32);
        }
        made
    }

    /// Numbers of the levels of a cell, from below.
    #[inline]
    pub fn of_cell(&self, cell: usize) -> std::ops::Range<usize> {
        self.starts[cell] as usize..self.starts[cell + 1] as usize
    }

    /// The levels, by number.
    pub fn all(&self) -> &[Level] {
        &self.levels
    }

    /// The cell of each level.
    pub fn cells(&self) -> Vec<u32> {
        let mut cells = vec![0; self.levels.len()];
        for (cell, pair) in self.starts.windows(2).enumerate() {
            cells[pair[0] as usize..pair[1] as usize].fill(cell as u32);
        }
        cells
    }

    /// Takes heights from where the distance field changes its sign, the highest place around the top of the voxels.
    fn refine(&mut self, columns: &Columns, surfaces: &DistanceQuery<'_>) {
        let voxel = columns.voxel();
        let samples = ((ABOVE + BELOW) / STEP) as usize + 1;
        let cells = self.cells();
        let lowest: Vec<f64> = cells.par_iter().zip(&self.levels).map(|(cell, level)| carrier_low(columns, *cell as usize, level)).collect();
        // In parts, so that the points of a large map do not fill the memory.
        for first in (0..self.levels.len()).step_by(1 << 18) {
            let part = first..(first + (1 << 18)).min(self.levels.len());
            let points: Vec<[f32; 3]> = part
                .clone()
                .flat_map(|k| {
                    let ([x, y], top) = (columns.cells().centre(cells[k] as usize), f64::from(self.levels[k].top));
                    (0..samples).map(move |i| [x, y, top + (ABOVE - STEP * i as f64) * voxel].map(|c| c as f32))
                })
                .collect();
            let distances = surfaces.sample_distances(&points);
            self.levels[part.clone()].par_iter_mut().zip(distances.par_chunks(samples)).zip(&lowest[part]).for_each(
                |((level, distances), lowest)| {
                    let crossing = distances.windows(2).position(|pair| pair[0] > 0.0 && pair[1] <= 0.0);
                    let Some(i) = crossing else { return };
                    let [above, below] = [distances[i], distances[i + 1]];
                    let at = i as f64 + f64::from(above / (above - below));
                    let height = f64::from(level.top) + (ABOVE - STEP * at) * voxel;
                    if height >= lowest - ABOVE * voxel {
                        level.height = height as f32;
                        level.sigma = (SURFACE_NOISE * voxel) as f32;
                    }
                },
            );
        }
    }
}

/// Lower end of the voxels that carry a level.
fn carrier_low(columns: &Columns, cell: usize, level: &Level) -> f64 {
    let top = f64::from(level.top);
    columns.spans(cell).find(|span| span.occupied && (span.high - top).abs() < 1e-3).map_or(top, |span| span.low)
}

fn levels_of(columns: &Columns, cell: usize) -> Vec<Level> {
    let gap = GAP + 1e-6;
    let sigma = columns.voxel() / 12f64.sqrt();
    let spans: Vec<_> = columns.spans(cell).collect();
    let mut levels = Vec::new();
    for (k, carrier) in spans.iter().enumerate().filter(|(_, span)| span.occupied) {
        let Some(above) = spans.get(k + 1).filter(|s| !s.occupied && s.low - carrier.high <= gap && s.high - s.low >= LEAST_FREE) else { continue };
        let ceiling = spans[k + 1..].iter().find(|span| span.occupied).map_or(f64::INFINITY, |span| span.low);
        debug_assert!(above.low < ceiling);
        // The surface is within the voxel, in its middle on average.
        let height = (carrier.high - 0.5 * columns.voxel()) as f32;
        levels.push(Level { height, sigma: sigma as f32, top: carrier.high as f32, headroom: (ceiling - carrier.high) as f32 });
    }
    levels
}
