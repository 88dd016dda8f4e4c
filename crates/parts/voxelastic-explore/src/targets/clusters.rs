//! Clusters of places on the frontier: what is connected, in parts of limited extent.

use hashbrown::HashMap;
use nalgebra::Vector3;
use voxelastic::octree::BLOCK_EDGE;
use voxelastic_plan::Point;

/// How the frontier is clustered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrontierSettings {
    /// Largest extent of a cluster along an axis, metres.
    pub max_extent: f64,
    /// Smallest area of a cluster, square metres.
    pub min_area: f64,
}

impl Default for FrontierSettings {
    fn default() -> Self {
        Self { max_extent: 5.0, min_area: 0.5 }
    }
}

/// A part of the frontier: where free space, connected, meets unknown space.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct FrontierCluster {
    /// Centre: the place on the frontier that is nearest to the mean, map frame, metres.
    pub centre: Point,
    /// Unit vector from free towards unknown space, the mean weighted by area; of any direction if that is zero.
    pub normal: Point,
    /// Area, square metres.
    pub area: f64,
    /// Lengths of the box around it along the axes of the map frame, metres.
    pub extent: [f64; 3],
}

/// A place on the frontier in the map frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    pub position: Point,
    pub normal: Vector3<f64>,
    pub area: f64,
}

impl FrontierSettings {
    /// Clusters of places in a map with voxels of `voxel` metres.
    pub(crate) fn clusters(self, places: Vec<Place>, voxel: f64) -> Vec<FrontierCluster> {
        let edge = BLOCK_EDGE as f64 * voxel;
        let mut bins: HashMap<[i32; 3], Vec<Place>> = HashMap::new();
        for place in places {
            bins.entry(place.position.map(|c| (c / edge).floor() as i32)).or_default().push(place);
        }
        let mut clusters = Vec::new();
        for places in connected(bins) {
            self.split(places, &mut clusters);
        }
        clusters
    }

    /// Divides places along the longest axis until each part is small enough.
    fn split(self, places: Vec<Place>, clusters: &mut Vec<FrontierCluster>) {
        let bound = |k: usize, pick: fn(f64, f64) -> f64| places.iter().map(|p| p.position[k]).reduce(pick).unwrap_or(0.0);
        let (low, high) = ([0, 1, 2].map(|k| bound(k, f64::min)), [0, 1, 2].map(|k| bound(k, f64::max)));
        let extent: [f64; 3] = std::array::from_fn(|k| high[k] - low[k]);
        let longest = (0..3).fold(0, |best, k| if extent[k] > extent[best] { k } else { best });
        if extent[longest] > self.max_extent {
            let middle = 0.5 * (low[longest] + high[longest]);
            let (a, b): (Vec<Place>, Vec<Place>) = places.into_iter().partition(|p| p.position[longest] < middle);
            self.split(a, clusters);
            self.split(b, clusters);
            return;
        }
        let area: f64 = places.iter().map(|p| p.area).sum();
        if area < self.min_area {
            return;
        }
        let mean: Point = std::array::from_fn(|k| places.iter().map(|p| p.position[k] * p.area).sum::<f64>() / area);
        let off = |p: &Place| voxelastic_plan::distance(p.position, mean);
        let Some(centre) = places.iter().min_by(|a, b| off(a).total_cmp(&off(b))) else { return };
        let normal = places.iter().map(|p| p.normal).sum::<Vector3<f64>>().try_normalize(1e-9).unwrap_or_else(Vector3::x);
        clusters.push(FrontierCluster { centre: centre.position, normal: normal.into(), area, extent });
    }
}

/// Joins neighbouring bins: groups of what is in them, in the order of their first bins.
fn connected<T>(mut bins: HashMap<[i32; 3], Vec<T>>) -> Vec<Vec<T>> {
    let mut order: Vec<[i32; 3]> = bins.keys().copied().collect();
    order.sort_unstable();
    let mut left = BinSet::default();
    order.iter().for_each(|bin| left.insert(*bin));
    let mut components = Vec::new();
    let mut stack = Vec::new();
    for first in order {
        let Some(mut component) = bins.remove(&first) else { continue };
        left.remove(first);
        stack.push(first);
        while let Some(bin) = stack.pop() {
            let around = left.around(bin);
            for i in (0..27).filter(|i| around >> i & 1 == 1) {
                let next = [bin[0] + i % 3 - 1, bin[1] + i / 3 % 3 - 1, bin[2] + i / 9 - 1];
                if let Some(places) = bins.remove(&next) {
                    left.remove(next);
                    component.extend(places);
                    stack.push(next);
                }
            }
        }
        components.push(component);
    }
    components
}

/// A set of bins: a bit for each of 4 x 4 x 4, x fastest.
#[derive(Default)]
struct BinSet {
    tiles: HashMap<[i32; 3], u64>,
}

impl BinSet {
    fn bit(bin: [i32; 3]) -> u64 {
        1 << ((bin[0] & 3) + 4 * (bin[1] & 3) + 16 * (bin[2] & 3))
    }

    fn insert(&mut self, bin: [i32; 3]) {
        *self.tiles.entry(bin.map(|c| c >> 2)).or_default() |= Self::bit(bin);
    }

    fn remove(&mut self, bin: [i32; 3]) {
        if let Some(tile) = self.tiles.get_mut(&bin.map(|c| c >> 2)) {
            *tile &= !Self::bit(bin);
        }
    }

    /// Which of the 27 bins in and around a bin are in the set: a bit each, x fastest.
    fn around(&self, bin: [i32; 3]) -> u32 {
        let first = bin.map(|c| (c - 1) >> 2);
        // The tiles around, each looked up once: the next one along an axis only where the bins are in two.
        let mut tiles = [None; 8];
        (0..27).fold(0, |around, i: i32| {
            let next = [bin[0] + i % 3 - 1, bin[1] + i / 3 % 3 - 1, bin[2] + i / 9 - 1];
            let tile = next.map(|c| c >> 2);
            let number = (0..3).fold(0, |number, k| number | usize::from(tile[k] != first[k]) << k);
            let mask = *tiles[number].get_or_insert_with(|| self.tiles.get(&tile).copied().unwrap_or(0));
            around | u32::from(mask & Self::bit(next) != 0) << i
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Groups of bins, each joined with all others that touch it until nothing changes any more.
    fn slow(bins: &[[i32; 3]]) -> Vec<Vec<[i32; 3]>> {
        let touch = |a: &[i32; 3], b: &[i32; 3]| (0..3).all(|k| (a[k] - b[k]).abs() <= 1);
        let mut groups: Vec<Vec<[i32; 3]>> = bins.iter().map(|bin| vec![*bin]).collect();
        loop {
            let pairs = || (0..groups.len()).flat_map(|i| (0..i).map(move |j| (j, i)));
            let Some((j, i)) = pairs().find(|(j, i)| groups[*i].iter().any(|a| groups[*j].iter().any(|b| touch(a, b)))) else { break };
            let group = groups.remove(i);
            groups[j].extend(group);
        }
        groups.iter_mut().for_each(|group| group.sort_unstable());
        groups.sort_unstable();
        groups
    }

    proptest! {
        #[test]
        fn groups_are_what_touches(bins in prop::collection::btree_set(prop::array::uniform3(-4i32..4), 0..50)) {
            let bins: Vec<[i32; 3]> = bins.into_iter().collect();
            let mut groups = connected(bins.iter().map(|bin| (*bin, vec![*bin])).collect());
            groups.iter_mut().for_each(|group| group.sort_unstable());
            // In the order of their first bins.
            prop_assert_eq!(groups, slow(&bins));
        }
    }
}
