//! What a sensor would see from a place: the volume of unknown space along its rays.

use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, Ray, UnknownAs};
use voxelastic_plan::Point;

/// Where neighbouring beams are more voxels apart than this, a map leaves most of the space near surfaces unknown ...
const RESOLVED: f64 = 2.5;
/// An unknown voxel with a surface within this distance is rather a gap in what was seen of the surface than an opening, metres ...
const OPENING: f64 = 0.3;
/// ... and counts by this share: there may be something behind it.
const GAP: f64 = 0.25;
/// From farther away a gap fills less of the angle of a ray, metres.
const NEAR_GAP: f64 = 4.0;

/// Unknown volume that a sensor would see, cubic metres.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct UnknownVolume {
    /// With what may be behind gaps in surfaces, however far away.
    pub possible: f64,
    /// With what is behind gaps by the angle that they fill: from far away a thin wall has many of them, and hardly anything is seen through one.
    pub likely: f64,
}

/// The field of view of a spinning sensor, coarsely.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorView {
    /// Lowest and highest elevation, radians.
    pub elevations: [f64; 2],
    /// Range within which it shows whether space is free, metres.
    pub range: f64,
    /// Rows and columns of rays that are cast.
    pub rays: [usize; 2],
    /// Unknown space is assumed to be seen so far into, metres: something will be in the way.
    pub depth: f64,
}

impl Default for SensorView {
    /// A sensor with 45 degrees from the lowest to the highest row.
    fn default() -> Self {
        Self { elevations: [-0.39, 0.39], range: 20.0, rays: [7, 36], depth: 8.0 }
    }
}

impl SensorView {
    /// That of a sensor with rows at these elevations, radians, whose returns are mapped up to `max_range` metres; no more than 20 m of them count.
    pub fn of(elevations: impl IntoIterator<Item = f64>, max_range: f64) -> Self {
        let (low, high) = elevations.into_iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), e| (low.min(e), high.max(e)));
        let view = Self::default();
        Self { elevations: if low < high { [low, high] } else { view.elevations }, range: max_range.min(view.range), ..view }
    }

    /// The same with a range no longer than that at which beams that are `angle` radians apart still show voxels of `voxel` metres: beyond it, space in front of
    /// surfaces stays unknown until the robot comes nearer.
    pub fn resolving(self, angle: f64, voxel: f64) -> Self {
        Self { range: self.range.min(RESOLVED * voxel / angle.max(1e-9)), ..self }
    }

    /// The steepest way, height over distance, along which the sensor sees where it leads, up and down.
    pub(crate) fn steepest(&self) -> f64 {
        let [low, high] = self.elevations;
        (-low).min(high).clamp(0.0, 1.5).tan()
    }

    /// Radius within which space has to count as free because the robot is there (the mapper's setting `robot_radius`), metres: farther away the field of view is high
    /// enough for a ball of `radius` metres in voxels of `voxel` metres. On wheels, with the sensor `height` metres above the floor, it must not reach below
    /// the floor, and has a voxel more for rounding; in the air that would claim more of the floor that a narrow field of view does not see.
    pub fn own_radius(&self, radius: f64, voxel: f64, height: Option<f64>) -> f64 {
        let [low, high] = self.elevations;
        let voxels = if height.is_some() { 2.0 } else { 1.0 };
        let needed = (radius + voxels * voxel) / (-low).min(high).clamp(0.1, 1.5).sin();
        height.map_or(needed, |height| needed.min(height - 0.1)).clamp(0.0, 5.0)
    }

    /// How far that space has to reach up and down (the mapper's setting `robot_height`), metres: as far as the body in the air, or it would claim that the robot can go straight
    /// down to where it sees nothing. Wheels stay on the floor, and have a ball.
    pub fn own_height(&self, radius: f64, voxel: f64, height: Option<f64>) -> f64 {
        height.map_or(radius + voxel, |_| self.own_radius(radius, voxel, height))
    }

    /// The volume of unknown space that the sensor at `place` would see within the box `bounds`, cubic metres. All in the map frame.
    pub fn unknown_volume(&self, map: &AtlasQuery<'_>, place: Point, bounds: [Point; 2]) -> f64 {
        self.unknown(map, place, bounds).possible
    }

    /// The same, as it may be and as it is likely to be.
    pub(crate) fn unknown(&self, map: &AtlasQuery<'_>, place: Point, bounds: [Point; 2]) -> UnknownVolume {
        let [rows, columns] = self.rays;
        let [low, high] = self.elevations;
        let (step, turn) = ((high - low) / rows as f64, std::f64::consts::TAU / columns as f64);
        let ray = |i: usize| {
            let (elevation, azimuth) = (low + step * ((i / columns) as f64 + 0.5), turn * ((i % columns) as f64 + 0.5));
            let direction = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
            let [possible, likely] = self.along_ray(map, place, direction, bounds).map(|volume| volume * elevation.cos() * step * turn);
            UnknownVolume { possible, likely }
        };
        let add = |sum: UnknownVolume, ray: UnknownVolume| UnknownVolume { possible: sum.possible + ray.possible, likely: sum.likely + ray.likely };
        (0..rows * columns).map(ray).fold(UnknownVolume::default(), add)
    }

    /// Unknown volume along a ray, per steradian: as it may be, and as it is likely to be.
    fn along_ray(&self, map: &AtlasQuery<'_>, origin: Point, direction: Point, bounds: [Point; 2]) -> [f64; 2] {
        let length = leaves(origin, direction, bounds).min(self.range);
        if length <= 0.0 {
            return [0.0; 2];
        }
        let Some(first) = map.ray_cast(&Ray { origin, direction, length }, UnknownAs::Blocked) else { return [0.0; 2] };
        if first.state != State::Unknown {
            return [0.0; 2];
        }
        let depth = self.depth.min(length - first.distance);
        let from = std::array::from_fn(|k| origin[k] + direction[k] * first.distance);
        let is_gap = map.clearance(from, OPENING, UnknownAs::Free) < OPENING;
        let shares = if is_gap { [GAP, gap_share(first.distance)] } else { [1.0; 2] };
        let behind = map.ray_cast(&Ray { origin: from, direction, length: depth }, UnknownAs::Free);
        let last = first.distance + behind.map_or(depth, |hit| hit.distance);
        shares.map(|share| share * (last.powi(3) - first.distance.powi(3)) / 3.0)
    }
}

/// By which share the volume behind a gap is likely to be seen that is so far away, metres.
fn gap_share(distance: f64) -> f64 {
    GAP * (NEAR_GAP / distance.max(NEAR_GAP)).powi(2)
}

/// How far a ray that starts in a box goes until it leaves the box.
fn leaves(origin: Point, direction: Point, [low, high]: [Point; 2]) -> f64 {
    let along = |k: usize| match direction[k] {
        d if d > 0.0 => (high[k] - origin[k]) / d,
        d if d < 0.0 => (low[k] - origin[k]) / d,
        _ => f64::INFINITY,
    };
    along(0).min(along(1)).min(along(2)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::event::{Event, Scan};
    use voxelastic::mapper::Mapper;
    use voxelastic::settings::{FieldKind, Settings};
    use voxelastic::{Cloud, Pose};

    const VOXEL: f64 = 0.1;
    const PLACE: Point = [2.0, 0.0, 0.0];

    /// The map of a wall at x = 5 m with a hole of this width ahead, seen from the origin.
    fn wall_with_hole(width: f32) -> Mapper {
        let mut mapper = Mapper::new(Settings { voxel_size: VOXEL as f32, field: FieldKind::Occupancy, ..Settings::default() }).unwrap();
        let points = (0..81 * 81).map(|k| [5.0, (k % 81) as f32 * 0.05 - 2.0, (k / 81) as f32 * 0.05 - 2.0]);
        let cloud = Cloud::from_points(points.filter(|p| p[1].abs().max(p[2].abs()) > 0.5 * width).collect());
        mapper.handle(Event::Scan(Scan { node: 0, time: 0.0, t_map_lidar: Pose::identity(), cloud })).unwrap();
        mapper
    }

    /// The slow way along a ray: a look every millimetre, and at all voxels around the first unknown place.
    fn slowly(map: &AtlasQuery<'_>, view: &SensorView, direction: Point) -> (f64, bool) {
        let at = |length: f64| -> Point { std::array::from_fn(|k| PLACE[k] + direction[k] * length) };
        let steps = |from: f64, to: f64| (0..).map(move |k| from + 1e-3 * f64::from(k)).take_while(move |length| *length < to);
        let Some(first) = steps(0.0, view.range).find(|length| map.state(at(*length)) != State::Free) else { return (0.0, false) };
        if map.state(at(first)) == State::Occupied {
            return (0.0, false);
        }
        let last = steps(first, first + view.depth).find(|length| map.state(at(*length)) == State::Occupied).unwrap_or(first + view.depth);
        let offsets = (0..30i32.pow(3)).map(|k| [k % 30, k / 30 % 30, k / 900].map(|c| f64::from(c - 15) * 0.02));
        let is_gap = offsets.filter(|o| o.iter().map(|c| c * c).sum::<f64>() < OPENING * OPENING).any(|o| {
            let p = at(first);
            map.state(std::array::from_fn(|k| p[k] + o[k])) == State::Occupied
        });
        ((last.powi(3) - first.powi(3)) / 3.0, is_gap)
    }

    #[test]
    fn a_gap_in_a_surface_counts_less_than_an_opening() {
        let (view, bounds) = (SensorView::default(), [[-20.0; 3], [20.0; 3]]);
        let direction = [1.0, 0.003, 0.004];
        for (width, expected_gap) in [(-1.0, false), (0.3, true), (2.0, false)] {
            let mapper = wall_with_hole(width);
            let map = mapper.atlas().query().unwrap();
            let (volume, is_gap) = slowly(&map, &view, direction);
            assert_eq!((is_gap, volume > 0.0), (expected_gap, width > 0.0), "hole of {width} m");
            let expected = if is_gap { GAP * volume } else { volume };
            // The hole is nearer than from where it would fill less of the angle.
            for found in view.along_ray(&map, PLACE, direction, bounds) {
                assert!((found - expected).abs() <= 0.02 * expected, "{found} m3, slowly {expected}, hole of {width} m");
            }
        }
        // From three times as far away, the same gap is a ninth of the angle.
        assert_eq!([0.0, NEAR_GAP, 3.0 * NEAR_GAP].map(gap_share), [GAP, GAP, GAP / 9.0]);
    }

    #[test]
    fn coarse_beams_see_less_far() {
        let view = SensorView { range: 20.0, ..SensorView::default() };
        // 64 rows over 45 degrees, and over 90.
        let ranges = [0.7f64, 1.4].map(|angle| view.resolving(angle.to_radians(), 0.1).range);
        assert!((ranges[0] - 20.0).abs() < 1e-9 && (ranges[1] - 10.23).abs() < 0.01, "{ranges:?}");
        assert_eq!(view.resolving(0.0, 0.1), view);
    }

    #[test]
    fn own_space_is_as_high_as_the_body_in_the_air_and_a_ball_on_wheels() {
        let view = SensorView { elevations: [-0.4, 0.4], ..SensorView::default() };
        let own = |height| [view.own_radius(0.4, 0.1, height), view.own_height(0.4, 0.1, height)];
        let is = |own: [f64; 2], expected: [f64; 2]| (0..2).all(|k| (own[k] - expected[k]).abs() < 1e-9);
        assert!(is(own(None), [0.5 / 0.4f64.sin(), 0.5]), "{:?}", own(None));
        // Not below the floor, but as far as that at most.
        assert!(is(own(Some(3.0)), [0.6 / 0.4f64.sin(); 2]) && is(own(Some(0.8)), [0.7; 2]), "{:?} {:?}", own(Some(3.0)), own(Some(0.8)));
    }

    #[test]
    fn the_steepest_way_is_that_of_the_lesser_limit() {
        let steepest = |low, high| SensorView { elevations: [low, high], ..SensorView::default() }.steepest();
        assert!((steepest(-0.4, 0.2) - 0.2f64.tan()).abs() < 1e-12 && steepest(0.1, 0.3) == 0.0);
    }
}
