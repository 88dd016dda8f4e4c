//! What a scan saw from its pose.

use crate::event::NodeId;
use crate::geometry::{Pose, Rigid};
use crate::sensor::{BeamModel, OUTSIDE, RangeImage, project_chunk};

/// A place is judged only where beams are at most this far apart, metres: between wider ones thin things are missed.
const LARGEST_GAP: f32 = 0.4;
/// Least width of a cell of the windows, metres: poses and edges are uncertain by as much.
const LEAST_CELL: f32 = 0.05;
/// Margin in depth, metres, and the part of it that grows with the range.
const MARGIN: [f32; 2] = [0.1, 0.004];
/// Levels of windows; cells of each are twice as large as those of the one before.
const LEVELS: usize = 5;
/// Ranges are stored in steps of this, metres.
const STEP: f32 = 0.02;
/// Fewer cells of a window with a return tell nothing.
const LEAST_CELLS: u32 = 4;

/// What a view tells of a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sight {
    /// Hidden, out of view, too far, or at an edge.
    Unknown,
    /// A return is there.
    Seen,
    /// All beams around it passed beyond.
    Void,
}

/// Nearest and farthest return, in steps; the nearest is 0 where nothing is known.
type Window = [u16; 2];
/// A cell without return.
const HOLE: Window = [u16::MAX, 0];

/// What a scan saw: windows of 3 x 3 cells around each cell, at several levels.
#[derive(Clone, Debug)]
pub(super) struct View {
    /// The scan's node and its pose in the submap.
    pub node: NodeId,
    pub t_submap_lidar: Pose,
    t_lidar_submap: Rigid,
    levels: Vec<Level>,
    /// Width of a pixel, radians: along rows, and the larger of that and along columns.
    pixel: [f32; 2],
}

#[derive(Clone, Debug)]
struct Level {
    columns: usize,
    windows: Vec<Window>,
}

impl View {
    /// What the scan of `node` saw, of which `image` is as seen from the pose `t_submap_lidar`.
    pub fn new(node: NodeId, t_submap_lidar: &Pose, image: &RangeImage, model: &BeamModel) -> Self {
        let steps = |range: f32| (range / STEP).min(f32::from(u16::MAX) - 1.0);
        let cell = |&range: &f32| if range > 0.0 { [steps(range).floor() as u16, steps(range).ceil() as u16] } else { HOLE };
        let mut cells: Vec<Window> = image.ranges.iter().map(cell).collect();
        let (mut rows, mut columns) = (image.rows, image.columns);
        let mut levels = Vec::with_capacity(LEVELS);
        for level in 0..LEVELS {
            if level > 0 {
                (cells, rows, columns) = halve(&cells, rows, columns);
            }
            levels.push(Level { columns, windows: windows(&cells, rows, columns) });
        }
        let gap = (model.elevations()[0] - model.elevations()[model.rows() - 1]) / (model.rows().max(2) - 1) as f32;
        let pixel = [model.azimuth_step(), model.azimuth_step().max(gap)];
        Self { node, t_submap_lidar: *t_submap_lidar, t_lidar_submap: Rigid::from(&t_submap_lidar.inverse()), levels, pixel }
    }

    /// The same view in another submap.
    pub fn moved(self, t_new_old: &Pose) -> Self {
        let t_submap_lidar = t_new_old * self.t_submap_lidar;
        Self { t_submap_lidar, t_lidar_submap: Rigid::from(&t_submap_lidar.inverse()), ..self }
    }

    /// What it tells of up to [`CHUNK`](crate::sensor::PROJECT_CHUNK) places, submap frame, metres.
    pub fn look(&self, model: &BeamModel, places: &[[f32; 3]], scratch: &mut Scratch, mut tell: impl FnMut(usize, Sight)) {
        let Scratch { points, pixels, ranges } = scratch;
        points.clear();
        points.extend(places.iter().map(|p| self.t_lidar_submap.apply(*p)));
        pixels.resize(places.len(), 0);
        ranges.resize(places.len(), 0.0);
        project_chunk(points, model, pixels, ranges);
        let columns = model.columns() as u32;
        for (i, (&pixel, &range)) in pixels.iter().zip(ranges.iter()).enumerate() {
            if pixel < OUTSIDE && range * self.pixel[1] <= LARGEST_GAP {
                tell(i, self.sight((pixel / columns) as usize, (pixel % columns) as usize, range));
            }
        }
    }

    fn sight(&self, row: usize, column: usize, range: f32) -> Sight {
        let margin = MARGIN[0] + MARGIN[1] * range;
        let window = |level: usize| {
            let Level { columns, windows } = &self.levels[level];
            let [near, far] = windows[(row >> level) * columns + (column >> level).min(columns - 1)];
            (near > 0).then(|| [f32::from(near) * STEP, f32::from(far) * STEP])
        };
        let Some(fine) = window(0) else { return Sight::Unknown };
        if fine.iter().any(|depth| (depth - range).abs() <= margin) {
            return Sight::Seen;
        }
        // The level whose cells are wide enough at this range.
        let wanted = LEAST_CELL / (self.pixel[0] * range).max(1e-6);
        let level = (wanted.max(1.0).log2().ceil() as usize).min(LEVELS - 1);
        match window(level) {
            Some([near, _]) if near > range + margin => Sight::Void,
            _ => Sight::Unknown,
        }
    }
}

/// Scratch memory of [`View::look`].
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    points: Vec<[f32; 3]>,
    pixels: Vec<u32>,
    ranges: Vec<f32>,
}

fn join(a: Window, b: Window) -> Window {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Cells of twice the size. One has a return if two of its four have.
fn halve(cells: &[Window], rows: usize, columns: usize) -> (Vec<Window>, usize, usize) {
    let (half_rows, half_columns) = (rows.div_ceil(2), columns.div_ceil(2));
    let mut halved = Vec::with_capacity(half_rows * half_columns);
    for row in 0..half_rows {
        for column in 0..half_columns {
            let (mut all, mut count, mut inside) = (HOLE, 0, 0);
            for (r, c) in [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(r, c)| (2 * row + r, 2 * column + c)) {
                if r < rows && c < columns {
                    let cell = cells[r * columns + c];
                    inside += 1;
                    count += u32::from(cell != HOLE);
                    all = join(all, cell);
                }
            }
            halved.push(if 2 * count >= inside { all } else { HOLE });
        }
    }
    (halved, half_rows, half_columns)
}

/// The windows around all cells; columns are a circle.
fn windows(cells: &[Window], rows: usize, columns: usize) -> Vec<Window> {
    let mut lines: Vec<(Window, u32)> = Vec::with_capacity(cells.len());
    for row in cells.chunks_exact(columns) {
        lines.extend((0..columns).map(|c| {
            let three = [row[if c == 0 { columns - 1 } else { c - 1 }], row[c], row[if c + 1 == columns { 0 } else { c + 1 }]];
            three.iter().fold((HOLE, 0), |(all, count), &cell| (join(all, cell), count + u32::from(cell != HOLE)))
        }));
    }
    let mut windows = Vec::with_capacity(cells.len());
    for row in 0..rows {
        for c in 0..columns {
            let rows = [row.checked_sub(1), Some(row), Some(row + 1).filter(|r| *r < rows)];
            let lines = rows.into_iter().flatten().map(|r| lines[r * columns + c]);
            let (all, count) = lines.fold((HOLE, 0), |(all, count), (line, cells)| (join(all, line), count + cells));
            windows.push(if count >= LEAST_CELLS { all } else { [0, 0] });
        }
    }
    windows
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A view along x of a wall 10 m away, with a pole 4 m ahead.
    fn view() -> (View, BeamModel) {
        let model = BeamModel::even(32, 720, 0.2, -0.2).unwrap();
        let mut image = RangeImage { rows: 32, columns: 720, ranges: vec![10.0; 32 * 720], points: vec![0; 32 * 720] };
        for row in 0..32 {
            image.ranges[row * 720 + 2] = 4.0;
            image.ranges[row * 720 + 300] = 0.0;
        }
        (View::new(7, &Pose::identity(), &image, &model), model)
    }

    fn look(place: [f32; 3]) -> Sight {
        let (view, model) = view();
        let mut told = Sight::Unknown;
        view.look(&model, &[place], &mut Scratch::default(), |_, sight| told = sight);
        told
    }

    #[test]
    fn places_before_a_wall_are_void_but_not_beside_a_pole_or_near_the_wall() {
        assert_eq!(look([0.0, 6.0, 0.0]), Sight::Void);
        assert_eq!(look([0.0, 10.0, 0.0]), Sight::Seen);
        assert_eq!(look([0.0, 9.9, 0.1]), Sight::Seen);
        assert_eq!(look([0.0, 11.0, 0.0]), Sight::Unknown, "behind the wall");
        assert_eq!(look([4.0, 4.0 * 0.0175, 0.0]), Sight::Seen, "the pole");
        assert_eq!(look([6.0, 6.0 * 0.0175, 0.0]), Sight::Unknown, "behind the pole");
        assert_eq!(look([5.0, 5.0 * 0.035, 0.0]), Sight::Unknown, "beside the pole, behind it");
        assert_eq!(look([3.0, 0.05, 0.0]), Sight::Void, "before the pole");
        assert_eq!(look([0.0, 6.0, 5.0]), Sight::Unknown, "above the field of view");
        let at_hole = (2.0 * std::f32::consts::PI * 300.0 / 720.0).sin_cos();
        assert_eq!(look([6.0 * at_hole.1, 6.0 * at_hole.0, 0.0]), Sight::Void, "one beam without return");
    }
}
