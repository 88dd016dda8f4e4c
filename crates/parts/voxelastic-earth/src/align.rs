//! Where a map lies in a plane on Earth: the rigid motion that takes places of the map to measured ones, robustly.
//!
//! The start is the best of many motions, each by two pairs and level, or by three pairs, judged by the median of all residuals; so nearly half of the fixes may be
//! wrong. From there, least squares with the weights of a Cauchy kernel. A map that drifts is off by more than its fixes: the spread of the residuals says how
//! much, and the covariance of the outcome follows it.

use nalgebra::{Matrix3, Matrix6, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};
use voxelastic::Pose;

/// Motions that are tried.
const TRIALS: usize = 400;
/// Fixes by which each of them is judged.
const JUDGES: usize = 500;
/// A map is level to about this, where fixes do not say more, radians.
const LEVEL: f64 = 0.2;
/// Of the Cauchy kernel, in standard deviations.
const CAUCHY: f64 = 2.4;
/// Ratio of the standard deviation to the median of the lengths of three normal numbers.
const OF_MEDIAN: f64 = 1.0 / 1.538;

/// A place in the map, and where that was measured to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Map frame, metres.
    pub in_map: Vector3<f64>,
    /// In the plane: east, north, up, metres.
    pub measured: Vector3<f64>,
    /// Of the measured place, in the plane, square metres.
    pub covariance: Matrix3<f64>,
}

/// Where the map lies.
#[derive(Clone, Debug, PartialEq)]
pub struct Alignment {
    /// The map frame in the plane.
    pub t_plane_map: Pose,
    /// Standard deviations of the turn about east, north and up, radians, and of the middle of the fixes in these directions, metres.
    pub sigmas: [f64; 6],
    /// By how much residuals are larger than the fixes' own standard deviations, at least 1: what the map's drift, or too good an opinion of the fixes, makes of them.
    pub spread: f64,
}

impl Alignment {
    /// The residual of a pair: measured less mapped, east, north, up, metres.
    pub fn residual(&self, pair: &Pair) -> Vector3<f64> {
        pair.measured - (self.t_plane_map * nalgebra::Point3::from(pair.in_map)).coords
    }
}

/// Finds where the map lies; none of fewer than two pairs, or if all are at one place.
pub fn align(pairs: &[Pair]) -> Option<Alignment> {
    if pairs.len() < 2 || !pairs.iter().all(|pair| pair.in_map.iter().chain(&pair.measured).all(|c| c.is_finite())) {
        return None;
    }
    let extent = pairs.iter().map(|pair| (pair.measured - pairs[0].measured).norm()).fold(0.0, f64::max);
    if extent < 1e-3 {
        return None;
    }
    refined(pairs, start(pairs, extent)?)
}

/// The best of many motions.
fn start(pairs: &[Pair], extent: f64) -> Option<Pose> {
    let stride = pairs.len().div_ceil(JUDGES);
    let judges: Vec<&Pair> = pairs.iter().step_by(stride).collect();
    let mut random = 0x9e37_79b9_7f4a_7c15_u64;
    let mut pick = || {
        // Numbers by Steele, Lea and Flood (2014), the same on each run.
        random = random.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (random ^ (random >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        &pairs[((z ^ (z >> 31)) % pairs.len() as u64) as usize]
    };
    let mut best: Option<(f64, Pose)> = None;
    for trial in 0..TRIALS {
        let chosen = [pick(), pick(), pick()];
        let near = |a: &Pair, b: &Pair| (a.measured - b.measured).norm() < 0.1 * extent;
        let motion = if trial % 2 == 0 {
            if near(chosen[0], chosen[1]) {
                continue;
            }
            level(chosen[0], chosen[1])
        } else {
            by_three(chosen)
        };
        let Some(motion) = motion else { continue };
        let mut lengths: Vec<f64> = judges.iter().map(|p| ((motion * nalgebra::Point3::from(p.in_map)).coords - p.measured).norm()).collect();
        let middle = lengths.len() / 2;
        let median = *lengths.select_nth_unstable_by(middle, f64::total_cmp).1;
        if best.is_none_or(|(least, _)| median < least) {
            best = Some((median, motion));
        }
    }
    best.map(|(_, motion)| motion)
}

/// The level motion of two pairs.
fn level(a: &Pair, b: &Pair) -> Option<Pose> {
    let heading = |v: Vector3<f64>| (v.xy().norm() > 1e-9).then(|| v.y.atan2(v.x));
    let turn = heading(b.measured - a.measured)? - heading(b.in_map - a.in_map)?;
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
    let middle = 0.5 * (a.measured + b.measured) - rotation * (0.5 * (a.in_map + b.in_map));
    Some(Pose::from_parts(Translation3::from(middle), rotation))
}

/// The motion of three pairs (Umeyama 1991, without scale); none if they are in a line.
fn by_three(pairs: [&Pair; 3]) -> Option<Pose> {
    let mean = |of: fn(&Pair) -> Vector3<f64>| pairs.iter().map(|pair| of(pair)).sum::<Vector3<f64>>() / 3.0;
    let (a, b) = (mean(|pair| pair.in_map), mean(|pair| pair.measured));
    let sum: Matrix3<f64> = pairs.iter().map(|pair| (pair.measured - b) * (pair.in_map - a).transpose()).sum();
    let svd = sum.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    if svd.singular_values[1] < 1e-2 * svd.singular_values[0] {
        return None;
    }
    let mut flip = Matrix3::identity();
    flip[(2, 2)] = (u * v_t).determinant().signum();
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * flip * v_t));
    Some(Pose::from_parts(Translation3::from(b - rotation * a), rotation))
}

/// Least squares with weights, from a start.
fn refined(pairs: &[Pair], start: Pose) -> Option<Alignment> {
    let information: Vec<Matrix3<f64>> = pairs.iter().map(|pair| pair.covariance.try_inverse()).collect::<Option<_>>()?;
    let mut motion = start;
    for round in 0..50 {
        let spread = spread(pairs, &information, &motion);
        let (normal, gradient, middle) = normal_equations(pairs, &information, &motion, spread);
        let step = normal.cholesky()?.solve(&gradient);
        let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
        // The turn is about the middle of the fixes, where the way there is not mixed up with it.
        let translation = turn * (motion.translation.vector - middle) + middle + step.fixed_rows::<3>(3);
        motion = Pose::from_parts(Translation3::from(translation), turn * motion.rotation);
        if step.norm() < 1e-10 && round > 3 {
            break;
        }
    }
    let spread = spread(pairs, &information, &motion);
    let (normal, ..) = normal_equations(pairs, &information, &motion, spread);
    let covariance = normal.try_inverse()?;
    motion.rotation.renormalize();
    Some(Alignment { t_plane_map: motion, sigmas: std::array::from_fn(|k| covariance[(k, k)].max(0.0).sqrt()), spread })
}

/// How much larger the residuals are than standard deviations, by their median.
fn spread(pairs: &[Pair], information: &[Matrix3<f64>], motion: &Pose) -> f64 {
    let mut lengths: Vec<f64> = pairs.iter().zip(information).map(|(pair, w)| deviation(&residual(pair, motion), w)).collect();
    let middle = lengths.len() / 2;
    (*lengths.select_nth_unstable_by(middle, f64::total_cmp).1 * OF_MEDIAN).max(1.0)
}

fn residual(pair: &Pair, motion: &Pose) -> Vector3<f64> {
    pair.measured - (motion * nalgebra::Point3::from(pair.in_map)).coords
}

/// Length of a residual in standard deviations.
pub(crate) fn deviation(residual: &Vector3<f64>, information: &Matrix3<f64>) -> f64 {
    residual.dot(&(information * residual)).max(0.0).sqrt()
}

/// The matrix and the right side of a step: a turn about the middle of the fixes, and a shift; and that middle.
fn normal_equations(pairs: &[Pair], information: &[Matrix3<f64>], motion: &Pose, spread: f64) -> (Matrix6<f64>, Vector6<f64>, Vector3<f64>) {
    let middle = pairs.iter().map(|pair| pair.measured).sum::<Vector3<f64>>() / pairs.len() as f64;
    let (mut normal, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
    for (pair, information) in pairs.iter().zip(information) {
        let there = (motion * nalgebra::Point3::from(pair.in_map)).coords;
        let residual = pair.measured - there;
        let size = deviation(&residual, information) / (spread * CAUCHY);
        let weight = information / ((1.0 + size * size) * spread * spread);
        let mut jacobian = nalgebra::Matrix3x6::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&-(there - middle).cross_matrix());
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
        normal += jacobian.transpose() * weight * jacobian;
        gradient += jacobian.transpose() * (weight * residual);
    }
    // Level, if nothing else says so: the up axis of the map is turned by `turn x up`.
    let up = motion.rotation * Vector3::z();
    let tilt = nalgebra::Matrix2x3::new(0.0, up.z, -up.y, -up.z, 0.0, up.x) / LEVEL;
    let off = nalgebra::Vector2::new(-up.x, -up.y) / LEVEL;
    let mut turning = normal.fixed_view_mut::<3, 3>(0, 0);
    turning += tilt.transpose() * tilt;
    let mut pull = gradient.fixed_rows_mut::<3>(0);
    pull += tilt.transpose() * off;
    (normal, gradient, middle)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn numbers(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        move || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        }
    }

    fn pairs(t_plane_map: &Pose, count: usize, wrong: usize, seed: u64) -> Vec<Pair> {
        let mut random = numbers(seed);
        let mut pair = |k: usize| {
            let in_map = Vector3::new(200.0 * random(), 80.0 * random(), 6.0 * random());
            let noise = Vector3::new(random(), random(), random()) * 0.06;
            let off =
                if k.is_multiple_of(count.div_ceil(wrong.max(1))) && wrong > 0 { Vector3::new(30.0 * random(), 40.0, 5.0) } else { Vector3::zeros() };
            let measured = (t_plane_map * nalgebra::Point3::from(in_map)).coords + noise + off;
            Pair { in_map, measured, covariance: Matrix3::identity() * 4e-4 }
        };
        (0..count).map(&mut pair).collect()
    }

    proptest! {
        #[test]
        fn a_motion_is_found_with_a_fifth_of_wrong_fixes(yaw in -3.1..3.1, tilt in -0.1..0.1, east in -1e3..1e3, seed in 1u64..1000) {
            let truth = Pose::from_parts(Translation3::new(east, -20.0, 5.0), UnitQuaternion::from_euler_angles(tilt, 0.0, yaw));
            let found = align(&pairs(&truth, 100, 20, seed)).unwrap();
            let off = found.t_plane_map.inverse() * truth;
            prop_assert!(off.rotation.angle() < 1e-3 && off.translation.vector.norm() < 0.05, "{off}");
            // Ten times the standard deviations would be a wrong opinion of them.
            prop_assert!(found.sigmas[5] < 0.01 && found.sigmas[5] > 1e-3 && off.rotation.angle() < 10.0 * found.sigmas[0].max(found.sigmas[1]), "{:?}", found.sigmas);
        }
    }

    #[test]
    fn without_wrong_fixes_it_is_the_least_squares_solution() {
        // Umeyama's closed form over all pairs, by a slow loop of the three-point one would not do: its own sums.
        let truth = Pose::from_parts(Translation3::new(5.0, -20.0, 5.0), UnitQuaternion::from_euler_angles(0.02, -0.01, 1.0));
        let all = pairs(&truth, 60, 0, 7);
        let n = all.len() as f64;
        let (a, b) = (all.iter().map(|p| p.in_map).sum::<Vector3<f64>>() / n, all.iter().map(|p| p.measured).sum::<Vector3<f64>>() / n);
        let sum: Matrix3<f64> = all.iter().map(|p| (p.measured - b) * (p.in_map - a).transpose()).sum();
        let svd = sum.svd(true, true);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(svd.u.unwrap() * svd.v_t.unwrap()));
        let closed = Pose::from_parts(Translation3::from(b - rotation * a), rotation);
        let off = align(&all).unwrap().t_plane_map.inverse() * closed;
        // The kernel weighs residuals a little.
        assert!(off.translation.vector.norm() < 0.01 && off.rotation.angle() < 3e-4, "{off}");
    }

    #[test]
    fn a_straight_line_leaves_the_map_level_and_says_how_unsure_that_is() {
        let pair = |k: i32| {
            let in_map = Vector3::new(f64::from(k), 0.0, 0.0);
            Pair { in_map, measured: Vector3::new(0.0, f64::from(k), 0.0) + Vector3::repeat(1.0), covariance: Matrix3::identity() * 1e-4 }
        };
        let line: Vec<Pair> = (0..50).map(pair).collect();
        let found = align(&line).unwrap();
        assert!((found.t_plane_map.rotation * Vector3::z() - Vector3::z()).norm() < 1e-6);
        assert!((found.sigmas[1] - LEVEL).abs() < 0.01 && found.sigmas[2] < 1e-3, "the roll about the line, which leads north: {:?}", found.sigmas);
        assert!(align(&line[..1]).is_none() && align(&[line[0]; 5]).is_none());
    }
}
