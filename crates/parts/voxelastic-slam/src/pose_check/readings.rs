//! Other readings of poses, and the one under which they agree with the scans.

use super::conventions::{CONVENTIONS, quarter_turns};
use super::hand_eye::{Mounting, mounting, rotation};
use super::motions::{Motion, discrepancy, middle};
use nalgebra::UnitQuaternion;
use voxelastic::geometry::{Pose, PoseChange, PoseExt};

/// Units of length that are mixed up.
const SCALES: [f64; 5] = [1.0, 1e-3, 1e-2, 1e2, 1e3];
/// Rows that may be missing, or too many.
const MOST_ROWS: i64 = 20;
/// How far the clocks of poses and scans may be apart, seconds, and the step in which that is searched first.
const MOST_SECONDS: (f64, f64) = (2.0, 0.05);
/// A reading is believed if this share of the pairs agrees ..
const LEAST_AGREEING: f64 = 0.7;
/// .. and if what is left is this share of what was.
const MOST_LEFT: f64 = 0.5;
/// What is left of right poses, at most, in standard deviations.
const LEAST_LEFT: f64 = 0.6;
/// Poses that are this near to the scans in the middle of all pairs are right, whatever a few pairs say: metres, radians.
const EXACT: (f64, f64) = (0.02, 0.0035);
/// What a further change must gain to be believed, in standard deviations; a shift in time is another word for a shift of rows.
const PRICE: f64 = 0.1;
const PRICE_OF_SECONDS: f64 = 0.15;
/// A rotation this near to steps of 90 degrees is meant to be that, radians.
const NEARLY: f64 = 0.035;
/// Discrepancies count up to this, in standard deviations.
const MOST: f64 = 10.0;

/// A reading of poses under which they agree with the scans.
#[derive(Clone, Debug)]
pub struct Reading {
    /// What to change of the poses.
    pub change: PoseChange,
    /// Where the lidar is in the frame that they are of.
    pub mounting: Mounting,
    /// Whether that is another frame than was said.
    pub is_other_frame: bool,
    /// Pairs of scans for which it has poses.
    pub pairs: usize,
    /// Of these, pairs that agree then.
    pub agreeing: usize,
    /// How far apart poses and scans are then, in the middle of all pairs: metres, radians.
    pub median: (f64, f64),
    /// What is left, in standard deviations, and what the changes cost.
    cost: f64,
}

impl Reading {
    /// The motion of the lidar between two rows, by poses that are read so.
    pub(super) fn motion(&self, track: &[(f64, Pose)], said: &Pose, rows: (usize, usize)) -> Option<Pose> {
        let raw: Vec<(f64, Pose)> = track.iter().map(|(time, pose)| (*time, pose * said.inverse())).collect();
        let x = self.mounting.t_base_lidar;
        Some(x.inverse() * base_motion(&raw, rows, &self.change)? * x)
    }
}

/// The simplest reading under which most pairs agree, if it is much better than none. Where poses agree `roughly` as they are, only readings without a freely placed lidar count.
pub(super) fn find(track: &[(f64, Pose)], has_times: bool, said: &Pose, motions: &[Motion], roughly: bool) -> Option<Reading> {
    let raw: Vec<(f64, Pose)> = track.iter().map(|(time, pose)| (*time, pose * said.inverse())).collect();
    let as_said = Mounting::said(*said);
    let unchanged = rated(&raw, said, motions, PoseChange::default(), as_said)?;
    let is_exact = unchanged.median.0 < EXACT.0 && unchanged.median.1 < EXACT.1;
    if unchanged.cost < LEAST_LEFT || is_exact {
        return None;
    }
    let mut all = Vec::new();
    for change in CONVENTIONS {
        for scale in SCALES {
            let change = PoseChange { scale, ..change };
            all.extend(rated(&raw, said, motions, change, as_said));
            all.extend(mounted(&raw, said, motions, change, !roughly));
        }
    }
    all.extend((-MOST_ROWS..=MOST_ROWS).filter(|rows| *rows != 0).filter_map(|rows| {
        let change = PoseChange { rows, ..PoseChange::default() };
        rated(&raw, said, motions, change, as_said)
    }));
    if has_times {
        all.extend(shifted_in_time(&raw, said, motions, as_said));
    }
    let is_believed = |r: &Reading| r.agreeing as f64 >= LEAST_AGREEING * r.pairs as f64 && r.cost < MOST_LEFT * unchanged.cost;
    all.into_iter().filter(is_believed).min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// A reading with what it leaves; none if it has no poses for many scans.
fn rated(raw: &[(f64, Pose)], said: &Pose, motions: &[Motion], change: PoseChange, mounting: Mounting) -> Option<Reading> {
    let x = mounting.t_base_lidar;
    let off = |motion: &Motion| Some(discrepancy(&(x.inverse() * base_motion(raw, motion.rows, &change)? * x), &motion.measured));
    let off: Vec<_> = motions.iter().filter_map(off).collect();
    if (off.len() as f64) < LEAST_AGREEING * motions.len() as f64 {
        return None;
    }
    let is_turned = x.rotation_distance(said) > 1e-9;
    let is_moved = x.translation_distance(said) > 1e-9;
    let is_free = is_turned && quarter_turns().iter().all(|turn| turn.angle_to(&x.rotation) > 1e-6);
    let flags = [change.inverse, change.w_first, change.scale != 1.0, change.rows != 0, is_turned, is_moved, is_free];
    let of_seconds = if change.seconds == 0.0 { 0.0 } else { PRICE_OF_SECONDS };
    let price = of_seconds + PRICE * flags.iter().filter(|is_changed| **is_changed).count() as f64;
    let left = off.iter().map(|off| off.sigmas.min(MOST)).sum::<f64>() / off.len().max(1) as f64;
    let median = (middle(off.iter().map(|off| off.metres)), middle(off.iter().map(|off| off.radians)));
    let agreeing = off.iter().filter(|off| off.is_small()).count();
    Some(Reading { change, mounting, is_other_frame: is_turned || is_moved, pairs: off.len(), agreeing, median, cost: left + price })
}

/// Readings with the lidar elsewhere on the body: turned by steps of 90 degrees, and freely turned and moved if `freely`.
fn mounted(raw: &[(f64, Pose)], said: &Pose, motions: &[Motion], change: PoseChange, freely: bool) -> Vec<Reading> {
    let base: Option<Vec<Pose>> = motions.iter().map(|motion| base_motion(raw, motion.rows, &change)).collect();
    let Some(base) = base else { return Vec::new() };
    let turned = |rotation: UnitQuaternion<f64>| Mounting::said(Pose::from_parts(said.translation, rotation));
    let mut found: Vec<Mounting> = quarter_turns().into_iter().map(turned).collect();
    if !freely {
        return found.into_iter().filter_map(|mounting| rated(raw, said, motions, change, mounting)).collect();
    }
    let free = rotation(&base, motions);
    found.push(turned(free));
    let best = found.iter().filter_map(|m| rated(raw, said, motions, change, *m)).min_by(|a, b| a.cost.total_cmp(&b.cost));
    for start in best.into_iter().map(|best| best.mounting.t_base_lidar).chain([Pose::from_parts(said.translation, free)]) {
        let Some(refined) = mounting(&base, motions, &start) else { continue };
        let nearest = quarter_turns().into_iter().find(|turn| turn.angle_to(&refined.t_base_lidar.rotation) < NEARLY);
        found.extend(nearest.map(|turn| Mounting { t_base_lidar: Pose::from_parts(refined.t_base_lidar.translation, turn), ..refined }));
        found.push(refined);
    }
    found.into_iter().filter_map(|mounting| rated(raw, said, motions, change, mounting)).collect()
}

/// The best shift between the clocks of poses and scans, first in coarse steps, then in fine ones.
fn shifted_in_time(raw: &[(f64, Pose)], said: &Pose, motions: &[Motion], mounting: Mounting) -> Option<Reading> {
    let at = |seconds: f64| rated(raw, said, motions, PoseChange { seconds, ..PoseChange::default() }, mounting);
    let best = |readings: &mut dyn Iterator<Item = Reading>| readings.min_by(|a, b| a.cost.total_cmp(&b.cost));
    let (most, step) = MOST_SECONDS;
    let steps = (most / step) as i32;
    let coarse = best(&mut (-steps..=steps).filter(|k| *k != 0).filter_map(|k| at(f64::from(k) * step)))?;
    let fine = |k: i32| (coarse.change.seconds * 100.0).round() / 100.0 + f64::from(k) * 0.01;
    best(&mut (-5..=5).filter_map(|k| at((fine(k) * 100.0).round() / 100.0)).filter(|r| r.change.seconds != 0.0))
}

/// How the body moved between two scans, by poses that are read otherwise.
fn base_motion(raw: &[(f64, Pose)], rows: (usize, usize), change: &PoseChange) -> Option<Pose> {
    let pose = |row: usize| {
        let index = usize::try_from(i64::try_from(row).ok()? + change.rows).ok()?;
        let (time, pose) = raw.get(index)?;
        let pose = if change.seconds == 0.0 { *pose } else { at(raw, time + change.seconds)? };
        Some(change.apply(&pose))
    };
    Some(pose(rows.0)?.inv_mul(&pose(rows.1)?))
}

/// The pose at a time, between those before and after.
fn at(track: &[(f64, Pose)], time: f64) -> Option<Pose> {
    let after = track.partition_point(|(t, _)| *t < time);
    let ((t0, a), (t1, b)) = (track.get(after.checked_sub(1)?)?, track.get(after)?);
    let share = (time - t0) / (t1 - t0);
    let rotation = a.rotation.try_slerp(&b.rotation, share, 1e-9)?;
    Some(Pose::from_parts(a.translation.vector.lerp(&b.translation.vector, share).into(), rotation))
}
