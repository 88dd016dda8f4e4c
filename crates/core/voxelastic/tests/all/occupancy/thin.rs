//! Thin objects are kept: rays that pass beside them must not erase them.

use std::f32::consts::TAU;
use voxelastic::Cloud;
use voxelastic::field::occupancy::{OccupancyField, State};
use voxelastic::geometry::Rigid;
use voxelastic::integrate::{OccupancyIntegrator, OccupancySettings, ReturnsView};
use voxelastic::sensor::{BeamModel, CloudLayout, RangeLimits, ScanPreprocessor};

const VOXEL: f32 = 0.065;
const ROWS: usize = 64;
const COLUMNS: usize = 1024;
/// Elevations of the rows reach from this to its negative, radians.
const TOP: f32 = 0.29;
const SENSOR_HEIGHT: f32 = 1.6;

/// A straight bar of some radius from one point to another.
struct Bar {
    from: [f32; 3],
    to: [f32; 3],
    radius: f32,
}

impl Bar {
    /// Distance along the ray to the bar's side.
    fn hit(&self, origin: [f32; 3], ray: [f32; 3]) -> Option<f32> {
        let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let minus = |a: [f32; 3], b: [f32; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
        let length = dot(minus(self.to, self.from), minus(self.to, self.from)).sqrt();
        let axis = minus(self.to, self.from).map(|c| c / length);
        // Without the components along the axis: the ray against a circle.
        let across = |v: [f32; 3]| minus(v, axis.map(|c| c * dot(v, axis)));
        let (p, d) = (across(minus(origin, self.from)), across(ray));
        let (a, b, c) = (dot(d, d), dot(p, d), dot(p, p) - self.radius * self.radius);
        let root = b * b - a * c;
        if root < 0.0 || a < 1e-9 {
            return None;
        }
        let t = (-b - root.sqrt()) / a;
        let along = dot(minus(origin, self.from), axis) + t * dot(ray, axis);
        (t > 0.0 && (0.0..=length).contains(&along)).then_some(t)
    }
}

/// A scan from `origin` of bars on flat ground within a round wall 40 m from the centre.
fn scan(bars: &[Bar], origin: [f32; 3], number: usize) -> Vec<[f32; 3]> {
    let mut points = Vec::new();
    for i in 0..ROWS * COLUMNS {
        let elevation = TOP - 2.0 * TOP * (i / COLUMNS) as f32 / (ROWS - 1) as f32;
        let azimuth = ((i % COLUMNS) as f32 + 0.5) / COLUMNS as f32 * TAU;
        let ray = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
        let (a, b) = (ray[0] * ray[0] + ray[1] * ray[1], origin[0] * ray[0] + origin[1] * ray[1]);
        let c = origin[0] * origin[0] + origin[1] * origin[1] - 1600.0;
        let wall = (-b + (b * b - a * c).sqrt()) / a;
        let ground = if ray[2] < 0.0 { -origin[2] / ray[2] } else { f32::INFINITY };
        let range = bars.iter().filter_map(|bar| bar.hit(origin, ray)).fold(wall.min(ground), f32::min);
        // Noise of 2 cm at most, the same in every run.
        let noise = 0.04 * ((i as f32 * 0.618_034 + number as f32 * 0.414_214).fract() - 0.5);
        points.push(ray.map(|c| c * (range + noise)));
    }
    points
}

/// Maps scans taken at `places`; also returns the points on the bars, in the map frame.
fn map(bars: &[Bar], places: impl Iterator<Item = [f32; 3]>) -> (OccupancyField, Vec<[f32; 3]>) {
    let model = || BeamModel::even(ROWS, COLUMNS, TOP, -TOP).expect("a valid model");
    let mut preprocessor = ScanPreprocessor::new(model(), CloudLayout::Projected, RangeLimits { near: 0.5, max: 60.0 });
    let mut integrator = OccupancyIntegrator::new(OccupancySettings { voxel_size: VOXEL, ..OccupancySettings::default() }, &model());
    let mut field = OccupancyField::default();
    let mut all = Vec::new();
    for (number, place) in places.enumerate() {
        let pose = Rigid { translation: place, ..Rigid::from(&voxelastic::Pose::identity()) };
        let points = scan(bars, place, number);
        let in_map = points.iter().map(|p| pose.apply(*p));
        all.extend(in_map.filter(|p| p[2] > 0.1 && p[0].hypot(p[1]) < 30.0));
        let prepared = preprocessor.prepare(&Cloud::from_points(points));
        let returns = ReturnsView::new(&prepared.returns);
        integrator.integrate(&mut field, &pose, &prepared.image, &returns, true);
    }
    (field, all)
}

/// Share of the places along a bar that are occupied, or have an occupied neighbour, of those that were ever hit.
fn occupied_share(field: &OccupancyField, returns: &[[f32; 3]], from: [f32; 3], to: [f32; 3]) -> f32 {
    let steps = 200;
    let places = (0..=steps).map(|s| -> [f32; 3] { std::array::from_fn(|k| from[k] + (to[k] - from[k]) * s as f32 / steps as f32) });
    let hit = places.filter(|p| returns.iter().any(|r| (0..3).map(|k| (r[k] - p[k]).powi(2)).sum::<f32>() < VOXEL * VOXEL));
    let (mut occupied, mut all) = (0, 0);
    for place in hit {
        let c = place.map(|v| (v / VOXEL).floor() as i32);
        let around = (0..27).map(|i| [c[0] + i % 3 - 1, c[1] + i / 3 % 3 - 1, c[2] + i / 9 - 1]);
        occupied += usize::from(around.into_iter().any(|c| field.state_at(c) == State::Occupied));
        all += 1;
    }
    println!("{occupied} of {all} places are occupied");
    assert!(all > steps / 3, "the bar was hit at {all} of {steps} places");
    occupied as f32 / all as f32
}

#[test]
fn a_pole_and_a_railing_are_occupied_after_fifty_scans_around_them() {
    // A pole of 5 cm in the middle, seen from 20 m all around, and a railing of 4 cm bars passed at 4 to 12 m.
    let pole = Bar { from: [0.01, 0.02, 0.0], to: [0.01, 0.02, 4.0], radius: 0.025 };
    let rail = Bar { from: [12.0, -3.0, 1.0], to: [12.0, 3.0, 1.05], radius: 0.02 };
    let post = Bar { from: [12.0, 0.03, 0.0], to: [12.0, 0.03, 1.0], radius: 0.02 };
    let bars = [pole, rail, post];
    let places = (0..50).map(|i| {
        let angle = i as f32 / 50.0 * TAU;
        // A carried sensor sways.
        [20.0 * angle.cos(), 20.0 * angle.sin(), SENSOR_HEIGHT + 0.1 * (7.0 * angle).sin()]
    });
    let (field, returns) = map(&bars, places);
    let (pole, rail, post) = (
        occupied_share(&field, &returns, [0.01, 0.02, 0.3], [0.01, 0.02, 3.7]),
        occupied_share(&field, &returns, [12.0, -2.9, 1.0], [12.0, 2.9, 1.05]),
        occupied_share(&field, &returns, [12.0, 0.03, 0.2], [12.0, 0.03, 0.9]),
    );
    println!("occupied: pole {pole:.3}, rail {rail:.3}, post {post:.3}");
    assert!(pole > 0.9 && rail > 0.9 && post > 0.9, "pole {pole}, rail {rail}, post {post}");
    // The space beside them is free.
    for free in [[1.0, 0.0], [-0.7, 0.6], [11.0, 1.0], [10.0, -2.0]] {
        let c = [free[0], free[1], 1.5].map(|v: f32| (v / VOXEL).floor() as i32);
        assert_eq!(field.state_at(c), State::Free, "{free:?}");
    }
}
