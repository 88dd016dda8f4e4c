//! The levels of each column: surfaces with free space above them, on which something could stand.

use crate::columns::Columns;
use rayon::prelude::*;
use voxelastic::query::{DistanceQuery, SurfaceDistance};

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
    /// Whether the distance field has its surface; in maps without one, of all levels. Voxels that were seen from afar carry levels beyond the edge of a platform, too.
    pub has_surface: bool,
}

/// The levels of all columns.
#[derive(Clone, Debug)]
pub struct Levels {
    starts: Vec<u32>,
    levels: Vec<Level>,
}

impl Levels {
    /// The levels of `columns`, with heights that are those of voxels.
    pub(crate) fn rough(columns: &Columns) -> Self {
        let mut found = Self::empty();
        (0..columns.cells().count()).for_each(|cell| found.push(&levels_of(columns, cell)));
        found
    }

    /// Of no cell yet.
    pub(crate) fn empty() -> Self {
        Self { starts: vec![0], levels: Vec::new() }
    }

    /// Adds the next cell.
    pub(crate) fn push(&mut self, levels: &[Level]) {
        self.levels.extend(levels);
        self.starts.push(self.levels.len() as u32);
    }

    /// Levels at these heights, under the sky or the next.
    #[cfg(test)]
    pub(crate) fn at(heights: &[Vec<f32>]) -> Self {
        let mut made = Self { starts: vec![0], levels: Vec::new() };
        for cell in heights {
            for (k, &height) in cell.iter().enumerate() {
                let headroom = cell.get(k + 1).map_or(f32::INFINITY, |above| above - height - 0.2);
                made.levels.push(Level { height, sigma: 0.01, top: height, headroom, has_surface: true });
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
    pub(crate) fn refine(parts: &mut [(&Columns, &mut Self)], surfaces: &DistanceQuery<'_>) {
        if surfaces.is_empty() {
            parts.iter_mut().flat_map(|(_, levels)| &mut levels.levels).for_each(|level| level.has_surface = true);
            return;
        }
        let samples = ((ABOVE + BELOW) / STEP) as usize + 1;
        let mut all: Vec<Carried<'_>> = parts.par_iter_mut().flat_map_iter(|(columns, levels)| levels.carried(columns)).collect();
        // Some at a time, so that the points of a large map do not fill the memory.
        for some in all.chunks_mut(1 << 18) {
            let points: Vec<[f32; 3]> = some.iter().flat_map(|level| (0..samples).map(|i| level.sample(i))).collect();
            let found = surfaces.sample_many(&points);
            some.par_iter_mut().zip(found.par_chunks(samples)).for_each(|(level, found)| level.refine(found));
        }
    }

    fn carried<'a>(&'a mut self, columns: &'a Columns) -> impl Iterator<Item = Carried<'a>> {
        let cells = self.cells();
        let carried = |(cell, level): (u32, &'a mut Level)| {
            let lowest = carrier_low(columns, cell as usize, level);
            Carried { at: columns.cells().centre(cell as usize), lowest, voxel: columns.voxel(), level }
        };
        cells.into_iter().zip(&mut self.levels).map(carried)
    }
}

/// A level, and what carries it.
struct Carried<'a> {
    /// Centre of its cell, metres.
    at: [f64; 2],
    /// Lower end of the voxels that carry it, metres.
    lowest: f64,
    /// Their edge, metres.
    voxel: f64,
    level: &'a mut Level,
}

impl Carried<'_> {
    /// A point at which surfaces are looked for.
    fn sample(&self, i: usize) -> [f32; 3] {
        let [x, y] = self.at;
        [x, y, f64::from(self.level.top) + (ABOVE - STEP * i as f64) * self.voxel].map(|c| c as f32)
    }

    fn refine(&mut self, found: &[Option<SurfaceDistance>]) {
        let distances = |pair: &[Option<SurfaceDistance>]| Some([pair[0]?.distance, pair[1]?.distance]);
        let crossing =
            found.windows(2).enumerate().find_map(|(i, pair)| Some((i, distances(pair).filter(|[above, below]| *above > 0.0 && *below <= 0.0)?)));
        let Some((i, [above, below])) = crossing else { return };
        let at = i as f64 + f64::from(above / (above - below));
        let height = f64::from(self.level.top) + (ABOVE - STEP * at) * self.voxel;
        if height >= self.lowest - ABOVE * self.voxel {
            self.level.height = height as f32;
            self.level.sigma = (SURFACE_NOISE * self.voxel) as f32;
            // Half of a voxel beyond its edge the field still has a floor, and no gradient.
            self.level.has_surface = found[i..i + 2].iter().flatten().any(|sample| sample.gradient != [0.0; 3]);
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
        let mut above = spans[k + 1..].iter().take_while(|span| !span.occupied);
        if !above.any(|span| span.low - carrier.high <= gap && span.high - span.low >= LEAST_FREE) {
            continue;
        }
        let ceiling = spans[k + 1..].iter().find(|span| span.occupied).map_or(f64::INFINITY, |span| span.low);
        // The surface is within the voxel, in its middle on average.
        let height = (carrier.high - 0.5 * columns.voxel()) as f32;
        levels.push(Level { height, sigma: sigma as f32, top: carrier.high as f32, headroom: (ceiling - carrier.high) as f32, has_surface: false });
    }
    levels
}
