//! What a scan saw from its pose.

use super::cells::{Cells, HOLE, STEP};
use super::packed_plane::PackedPlane;
use super::windows::{LEVELS, Windows};
use crate::event::NodeId;
use crate::geometry::{Pose, Rigid};
use crate::sensor::{BeamModel, OUTSIDE, RangeImage, project_chunk};
use std::sync::Arc;

/// A place is judged only where beams are at most this far apart, metres.
const LARGEST_GAP: f32 = 0.4;

/// Rows above and below whose planes are asked before a place is called void: rows between may be empty.
const ROWS_AROUND: usize = 2;

/// How far poses may be wrong, and with them places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Care {
    /// Least width of a cell of the windows, metres.
    least_cell: f32,
    /// Margin in depth, metres, and the part of it that grows with the range.
    margin: [f32; 2],
    /// A place is void only if it is before the planes of the returns around it by more than this, metres, and per metre of range.
    before_planes: [f32; 2],
    /// A place that is this near to the plane of a return around it is seen, metres, and per metre of range. Nothing for scans just before or after:
    /// much of what moves was kept by it.
    on_plane: [f32; 2],
}

impl Care {
    /// For scans just before or after.
    pub const NEAR: Self = Self { least_cell: 0.05, margin: [0.1, 0.004], before_planes: [0.05, 0.002], on_plane: [0.0, 0.0] };
    /// For scans of another time, between which the graph may be wrong.
    pub const FAR: Self = Self { least_cell: 0.3, margin: [0.4, 0.01], before_planes: [0.4, 0.01], on_plane: [0.2, 0.005] };
}

/// What a view tells of a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Observation {
    /// Hidden, out of view, too far, or at an edge.
    Unknown,
    /// A return is there.
    Seen,
    /// All beams around it passed beyond, and a thing as large as the one there would have been hit.
    Void,
    /// All beams around it passed beyond, but so far apart that they may have missed it.
    Sparse,
}

/// What a scan saw.
#[derive(Clone, Debug)]
pub(super) struct View {
    /// The scan's node and its pose in the submap.
    pub node: NodeId,
    pub t_submap_lidar: Pose,
    windows: Windows,
    cells: Arc<Cells>,
    care: Care,
    /// Width of a cell, radians.
    cell: f32,
    /// Angles between beams along rows and columns, radians.
    gaps: [f32; 2],
}

impl View {
    /// What the scan of `node` saw, of which `cells` are as seen from the pose `t_submap_lidar`.
    pub fn new(node: NodeId, t_submap_lidar: &Pose, cells: &Arc<Cells>, model: &BeamModel, care: Care) -> Self {
        Self {
            node,
            t_submap_lidar: *t_submap_lidar,
            windows: Windows::new(cells),
            cells: Arc::clone(cells),
            care,
            cell: model.azimuth_step() * (1 << cells.shift) as f32,
            gaps: gaps_of(model),
        }
    }

    /// The same view in another submap.
    pub fn moved(self, t_new_old: &Pose) -> Self {
        Self { t_submap_lidar: t_new_old * self.t_submap_lidar, ..self }
    }

    /// From the pose that is known.
    pub fn as_known(&self) -> PlacedView<'_> {
        PlacedView { view: self, t_lidar_submap: Rigid::from(&self.t_submap_lidar.inverse()), slip: 0.0, was_off: 0.0 }
    }

    /// The plane and the range at a pixel of the model; zero where there is no return.
    pub fn at(&self, pixel: u32, model: &BeamModel) -> (PackedPlane, f32) {
        let columns = model.columns() as u32;
        let at = (pixel / columns) as usize * self.cells.columns + ((pixel % columns) >> self.cells.shift) as usize;
        let steps = self.cells.steps[at];
        (self.cells.planes[at], if steps == HOLE { 0.0 } else { f32::from(steps) * STEP })
    }
}

/// A view, and where it looks from.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlacedView<'a> {
    pub view: &'a View,
    pub t_lidar_submap: Rigid,
    /// How far the pose may be wrong beyond what is usual, metres.
    pub slip: f32,
    /// How much farther from its planes the points were from the pose that is known, metres.
    pub was_off: f32,
}

impl PlacedView<'_> {
    /// What it tells of up to [`PROJECT_CHUNK`](crate::sensor::PROJECT_CHUNK) places, submap frame, metres. `size` is the width and the height of the thing at a
    /// place, metres; it is asked for only where beams passed.
    pub fn look(
        &self,
        model: &BeamModel,
        places: impl Iterator<Item = [f32; 3]>,
        mut size: impl FnMut(usize) -> [f32; 2],
        scratch: &mut Scratch,
        mut tell: impl FnMut(usize, Observation),
    ) {
        let Scratch { points, pixels, ranges } = scratch;
        points.clear();
        points.extend(places.map(|p| self.t_lidar_submap.apply(p)));
        pixels.resize(points.len(), 0);
        ranges.resize(points.len(), 0.0);
        project_chunk(points, model, pixels, ranges);
        let columns = model.columns() as u32;
        let mut is_thin = |i: usize, gaps: [f32; 2]| {
            let size = size(i);
            size[0] < gaps[0] || size[1] < gaps[1]
        };
        for (i, (&pixel, &range)) in pixels.iter().zip(ranges.iter()).enumerate() {
            let gaps = self.view.gaps.map(|gap| gap * range);
            if pixel < OUTSIDE && gaps[0].max(gaps[1]) <= LARGEST_GAP {
                let observation =
                    self.observation((pixel / columns) as usize, ((pixel % columns) >> self.view.cells.shift) as usize, range, points[i]);
                let may_be_missed = observation == Observation::Void && is_thin(i, gaps);
                tell(i, if may_be_missed { Observation::Sparse } else { observation });
            }
        }
    }

    fn observation(&self, row: usize, column: usize, range: f32, place: [f32; 3]) -> Observation {
        let margin = self.view.care.margin[0] + self.view.care.margin[1] * range + 2.0 * self.slip;
        let Some(depths) = self.view.windows.around(row, column) else { return Observation::Unknown };
        if depths.iter().any(|depth| (depth - range).abs() <= margin) {
            return Observation::Seen;
        }
        let may_be_on_plane = self.on_plane(range) > 0.0 && range > depths[0] && range < depths[1];
        if may_be_on_plane && self.by_planes(row, column, range, place, 1) == Observation::Seen {
            return Observation::Seen;
        }
        // The level whose cells are wide enough at this range.
        let wanted = self.view.care.least_cell / (self.view.cell * range).max(1e-6);
        let level = (wanted.max(1.0).log2().ceil() as usize).min(LEVELS - 1);
        match self.view.windows.nearest(level, row, column) {
            Some(near) if near > range + margin => self.by_planes(row, column, range, place, ROWS_AROUND),
            _ => Observation::Unknown,
        }
    }

    /// How near a place at this range is to the plane of a return that it is on, metres.
    fn on_plane(&self, range: f32) -> f32 {
        self.view.care.on_plane[0] + self.view.care.on_plane[1] * range + self.slip
    }

    /// What the planes of the returns in so many rows above and below tell of a place, lidar frame, that is nearer than they are: void before all of them.
    fn by_planes(&self, row: usize, column: usize, range: f32, place: [f32; 3], rows_around: usize) -> Observation {
        let View { cells, care, .. } = self.view;
        let least = care.before_planes[0] + care.before_planes[1] * range + 2.0 * self.slip;
        let most = self.on_plane(range);
        let mut lowest = f32::MAX;
        for r in row.saturating_sub(rows_around)..(row + rows_around + 1).min(cells.rows) {
            for c in column + cells.columns - 1..column + cells.columns + 2 {
                let Some(height) = cells.planes[r * cells.columns + c % cells.columns].height(place) else { continue };
                if height.abs() < most {
                    return Observation::Seen;
                }
                if height < least && most <= 0.0 {
                    return Observation::Unknown;
                }
                lowest = lowest.min(height);
            }
        }
        if lowest < least { Observation::Unknown } else { Observation::Void }
    }
}

/// Angles between beams along rows and columns, radians.
fn gaps_of(model: &BeamModel) -> [f32; 2] {
    [model.azimuth_step(), (model.elevations()[0] - model.elevations()[model.rows() - 1]) / (model.rows().max(2) - 1) as f32]
}

/// Width and height of the piece of surface that is seen in a pixel, metres: from there to where the range jumps, over a few pixels only. A piece that is seen in
/// one pixel may be narrower than it, so half a pixel is taken off.
pub(super) fn extent(image: &RangeImage, model: &BeamModel, pixel: usize) -> [f32; 2] {
    /// Pixels to either side.
    const MOST: isize = 4;
    /// Larger differences of the ranges of neighbours are jumps, metres.
    const JUMP: f32 = 0.4;
    let (rows, columns) = (image.rows as isize, image.columns as isize);
    let (row, column) = (pixel as isize / columns, pixel as isize % columns);
    let length = |steps: [isize; 2]| -> f32 {
        let mut last = image.ranges[pixel];
        let goes_on = |&k: &isize| {
            let (r, c) = (row + k * steps[0], (column + k * steps[1]).rem_euclid(columns));
            let range = if (0..rows).contains(&r) { image.ranges[(r * columns + c) as usize] } else { 0.0 };
            let goes_on = range > 0.0 && (range - last).abs() < JUMP;
            last = range;
            goes_on
        };
        (1..=MOST).take_while(goes_on).count() as f32
    };
    let range = image.ranges[pixel];
    let [across, down] = gaps_of(model);
    [(length([0, 1]) + length([0, -1]) + 0.5) * across * range, (length([1, 0]) + length([-1, 0]) + 0.5) * down * range]
}

/// Scratch memory of [`View::look`].
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    points: Vec<[f32; 3]>,
    pixels: Vec<u32>,
    ranges: Vec<f32>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A view along x of a wall 10 m away, with a pole 4 m ahead.
    fn view() -> (View, BeamModel) {
        let model = BeamModel::even(32, 720, 0.2, -0.2).unwrap();
        let mut image = RangeImage { rows: 32, columns: 720, ranges: vec![10.0; 32 * 720], points: vec![0; 32 * 720] };
        for row in 0..32 {
            image.ranges[row * 720 + 2] = 4.0;
            image.ranges[row * 720 + 300] = 0.0;
        }
        (View::new(7, &Pose::identity(), &Arc::new(Cells::of_image(&image)), &model, Care::NEAR), model)
    }

    fn look(place: [f32; 3]) -> Observation {
        let (view, model) = view();
        let mut observed = Observation::Unknown;
        view.as_known().look(&model, [place].into_iter(), |_| [1.0; 2], &mut Scratch::default(), |_, observation| observed = observation);
        let mut of_thin = Observation::Unknown;
        view.as_known().look(&model, [place].into_iter(), |_| [0.01, 1.0], &mut Scratch::default(), |_, observation| of_thin = observation);
        assert_eq!(of_thin, if observed == Observation::Void { Observation::Sparse } else { observed });
        observed
    }

    #[test]
    fn pieces_of_surface_are_as_large_as_they_are_seen() {
        let model = BeamModel::even(32, 720, 0.2, -0.2).unwrap();
        let mut image = RangeImage { rows: 32, columns: 720, ranges: vec![10.0; 32 * 720], points: vec![0; 32 * 720] };
        for (row, column) in (10..14).flat_map(|row| [719, 0, 1].map(|column| (row, column))) {
            image.ranges[row * 720 + column] = 5.0;
        }
        let (across, down) = (std::f32::consts::TAU / 720.0, 0.4 / 31.0);
        let close = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-4;
        for (row, column) in [(10, 719), (12, 0), (13, 1)] {
            let size = extent(&image, &model, row * 720 + column);
            assert!(close(size, [2.5 * across * 5.0, 3.5 * down * 5.0]), "{size:?}");
        }
        assert!(close(extent(&image, &model, 20 * 720 + 300), [8.5 * across * 10.0, 8.5 * down * 10.0]));
        assert!(close(extent(&image, &model, 31 * 720 + 300), [8.5 * across * 10.0, 4.5 * down * 10.0]));
    }

    /// Ground 1.7 m below the sensor, of which rings are metres apart, some of them empty.
    fn road(empty: impl Fn(usize) -> bool) -> (View, BeamModel) {
        let model = BeamModel::even(64, 720, 0.05, -0.45).unwrap();
        let mut cloud = crate::Cloud::from_points(
            (0..64 * 720)
                .map(|pixel| {
                    let d = model.direction((pixel / 720) as f32, (pixel % 720) as f32);
                    if d[2] < -0.03 && !empty(pixel / 720) { d.map(|c| -1.7 * c / d[2]) } else { [f32::NAN; 3] }
                })
                .collect(),
        );
        (cloud.width, cloud.height) = (720, 64);
        let limits = crate::sensor::RangeLimits { near: 0.5, max: 60.0 };
        let mut preprocessor = crate::sensor::ScanPreprocessor::new(model.clone(), crate::sensor::CloudLayout::grid_of(&model), limits);
        let cells = Arc::new(Cells::new(preprocessor.prepare(&cloud)));
        (View::new(7, &Pose::identity(), &cells, &model, Care::NEAR), model)
    }

    proptest! {
        #[test]
        fn ground_at_flat_angles_is_not_void_and_what_stood_on_it_is(
            (every, first) in (3usize..9, 0usize..9),
            (azimuth, distance) in (0f32..std::f32::consts::TAU, 4f32..25.0),
            off in -0.05f32..0.05,
        ) {
            let (view, model) = road(|row| (row + first) % every == 0);
            let at = |height: f32| {
                let mut observed = Observation::Unknown;
                let place = [distance * azimuth.cos(), distance * azimuth.sin(), height - 1.7];
                view.as_known().look(&model, [place].into_iter(), |_| [1.0; 2], &mut Scratch::default(), |_, observation| observed = observation);
                observed
            };
            prop_assert_ne!(at(off), Observation::Void);
            prop_assert_eq!(at(0.5), Observation::Void);
        }
    }

    #[test]
    fn places_before_a_wall_are_void_but_not_beside_a_pole_or_near_the_wall() {
        assert_eq!(look([0.0, 6.0, 0.0]), Observation::Void);
        assert_eq!(look([0.0, 10.0, 0.0]), Observation::Seen);
        assert_eq!(look([0.0, 9.9, 0.1]), Observation::Seen);
        assert_eq!(look([0.0, 11.0, 0.0]), Observation::Unknown, "behind the wall");
        assert_eq!(look([4.0, 4.0 * 0.0175, 0.0]), Observation::Seen, "the pole");
        assert_eq!(look([6.0, 6.0 * 0.0175, 0.0]), Observation::Unknown, "behind the pole");
        assert_eq!(look([5.0, 5.0 * 0.035, 0.0]), Observation::Unknown, "beside the pole, behind it");
        assert_eq!(look([3.0, 0.05, 0.0]), Observation::Void, "before the pole");
        assert_eq!(look([0.0, 6.0, 5.0]), Observation::Unknown, "above the field of view");
        let at_hole = (2.0 * std::f32::consts::PI * 300.0 / 720.0).sin_cos();
        assert_eq!(look([6.0 * at_hole.1, 6.0 * at_hole.0, 0.0]), Observation::Void, "one beam without return");
    }
}
