//! Laps of a run: a lap ends where the sensor comes back to a place where it was, after it was elsewhere.

use super::{Submap, SubmapId};
use crate::geometry::Pose;
use std::collections::BTreeMap;

/// The sensor is back at a place that is this near, metres,
const NEAR: f64 = 5.0;
/// if it was this far away since, metres.
const AWAY: f64 = 10.0;
/// So far may a correction have moved places since the scans came, metres.
const MOVED: f64 = 1.0;

/// By submap, the number of its lap, from 1 on. A submap begins a lap if its first scan was taken within 5 m of an earlier one of the lap before, and one in between
/// 10 m away or more; a metre is allowed for corrections. Submaps are taken in the order of their numbers, which is that of time.
///
/// Where scans of several laps went into one submap, which they do by default, it has the lap in which it began.
pub fn laps<'a>(submaps: impl IntoIterator<Item = &'a Submap>) -> BTreeMap<SubmapId, u32> {
    let mut submaps: Vec<&Submap> = submaps.into_iter().collect();
    submaps.sort_by_key(|submap| submap.id);
    let (mut laps, mut lap, mut before) = (BTreeMap::new(), 1, Vec::new());
    for submap in submaps {
        let comes_back = |first: [f64; 3]| is_back(&first, before.iter().rev().copied(), [NEAR + MOVED, AWAY - MOVED]);
        if places(submap).next().is_some_and(comes_back) {
            before.clear();
            lap += 1;
        }
        before.extend(places(submap));
        laps.insert(submap.id, lap);
    }
    laps
}

/// Whether a scan at `t_map_lidar` would end the lap that began with submap `first`, after all scans of `submaps`, which are ordered by number.
pub(crate) fn ends_lap(submaps: &[Submap], first: SubmapId, t_map_lidar: &Pose) -> bool {
    let before = submaps.iter().rev().take_while(|submap| submap.id >= first).flat_map(|submap| places(submap).rev());
    is_back(&place_of(t_map_lidar), before, [NEAR, AWAY])
}

/// Whether one of the places before, latest first, is `near` to a place and a later one is `away` from it.
fn is_back(place: &[f64; 3], before: impl Iterator<Item = [f64; 3]>, [near, away]: [f64; 2]) -> bool {
    let squared = |other: &[f64; 3]| (0..3).map(|k| (place[k] - other[k]).powi(2)).sum::<f64>();
    let mut distances = before.map(|other| squared(&other));
    distances.any(|d| d >= away * away) && distances.any(|d| d <= near * near)
}

/// Where the scans of a submap were taken, map frame, metres.
fn places(submap: &Submap) -> impl DoubleEndedIterator<Item = [f64; 3]> + '_ {
    let pose = |n: usize| submap.corrected.get(n).unwrap_or(&submap.scans[n].t_submap_lidar);
    (0..submap.scans.len()).map(move |n| place_of(&(submap.t_map_submap * pose(n))))
}

fn place_of(pose: &Pose) -> [f64; 3] {
    pose.translation.vector.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Submaps of `per_submap` scans each, at these places.
    fn submaps(places: &[[f64; 2]], per_submap: usize) -> Vec<Submap> {
        let with_scans = |(id, places): (usize, &[[f64; 2]])| {
            let mut submap = Submap::new(id as SubmapId, 0.1, Pose::translation(places[0][0], places[0][1], 0.0));
            places.iter().enumerate().for_each(|(n, p)| _ = submap.add_scan(n as u64, &Pose::translation(p[0], p[1], 0.0)));
            submap
        };
        places.chunks(per_submap).enumerate().map(with_scans).collect()
    }

    /// A way around a square of 40 m, a scan each metre.
    fn around(count: usize) -> Vec<[f64; 2]> {
        let at = |n: usize| match (n % 40, n / 40 % 4) {
            (k, 0) => [k as f64, 0.0],
            (k, 1) => [40.0, k as f64],
            (k, 2) => [40.0 - k as f64, 40.0],
            (k, _) => [0.0, 40.0 - k as f64],
        };
        (0..count).map(at).collect()
    }

    #[test]
    fn a_lap_ends_where_the_sensor_comes_back() {
        let found: Vec<u32> = laps(&submaps(&around(480), 20)).into_values().collect();
        // Eight submaps go around once.
        assert_eq!(found, [[1; 8], [2; 8], [3; 8]].as_flattened());
        // One that passes the beginning in its middle began in the lap before.
        let found: Vec<u32> = laps(&submaps(&around(300), 30)).into_values().collect();
        assert_eq!(found, [1, 1, 1, 1, 1, 1, 2, 2, 2, 2]);
        assert!(laps(&[]).is_empty());
    }

    #[test]
    fn who_stays_or_goes_on_makes_one_lap() {
        let to_and_fro: Vec<[f64; 2]> = (0..100).map(|n| [f64::from(n % 8), 0.0]).collect();
        let straight: Vec<[f64; 2]> = (0..100).map(|n| [f64::from(n), 0.0]).collect();
        // Corridors side by side are no return until they are 5 m apart.
        let aside: Vec<[f64; 2]> = (0..40).map(|n| [f64::from(n), 0.0]).chain((0..40).map(|n| [f64::from(39 - n), 7.0])).collect();
        for places in [to_and_fro, straight, aside] {
            assert!(laps(&submaps(&places, 10)).into_values().all(|lap| lap == 1));
        }
    }

    #[test]
    fn a_scan_ends_the_lap_that_is_there() {
        let all = submaps(&around(150), 20);
        let at = |x: f64, y: f64| Pose::translation(x, y, 0.0);
        assert!(ends_lap(&all, 0, &at(0.0, 4.0)));
        assert!(!ends_lap(&all, 0, &at(0.0, 10.0)));
        assert!(!ends_lap(&all, 1, &at(0.0, 4.0)), "the submap at the beginning is of an earlier lap");
        assert!(!ends_lap(&[], 0, &at(0.0, 4.0)));
    }
}
