//! Points on things that moved, as the log of a run keeps them: a part of them, so that the log stays small however long the run is.

use serde::{Deserialize, Serialize};

/// The log keeps at most this many points.
const MOST_POINTS: usize = 120_000;

/// Points that were set aside because they are on things that move.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MovingLog {
    /// Points that were set aside in all.
    pub total: u64,
    /// One of so many of them is kept.
    pub every: u64,
    /// The scans that have some that are kept, in order.
    pub node: Vec<u64>,
    /// How many each has.
    pub count: Vec<u32>,
    /// The points of all of these scans: frame of the scan's lidar, metres, to centimetres.
    pub position: Vec<[f32; 3]>,
}

impl MovingLog {
    /// Adds the points of the next scan: frame of its lidar, metres.
    pub fn push(&mut self, node: u64, points: impl IntoIterator<Item = [f32; 3]>) {
        self.every = self.every.max(1);
        let before = self.position.len();
        for point in points {
            if self.total.is_multiple_of(self.every) {
                self.position.push(point.map(centimetres));
            }
            self.total += 1;
        }
        let added = self.position.len() - before;
        if added > 0 {
            self.node.push(node);
            self.count.push(added as u32);
        }
        while self.position.len() > MOST_POINTS {
            self.halve();
        }
    }

    /// Keeps every second point.
    fn halve(&mut self) {
        self.every *= 2;
        let mut first = 0;
        for count in &mut self.count {
            let end = first + *count as usize;
            *count = (end.div_ceil(2) - first.div_ceil(2)) as u32;
            first = end;
        }
        let mut number = 0..;
        self.position.retain(|_| number.next().is_some_and(|n: u64| n.is_multiple_of(2)));
        let counts = std::mem::take(&mut self.count);
        self.node = self.node.iter().zip(&counts).filter(|(_, count)| **count > 0).map(|(node, _)| *node).collect();
        self.count = counts.into_iter().filter(|count| *count > 0).collect();
    }

    /// The scans with their points.
    pub fn scans(&self) -> impl Iterator<Item = (u64, &[[f32; 3]])> {
        let mut end = 0;
        self.node.iter().zip(&self.count).map(move |(&node, &count)| {
            let first = end;
            end += count as usize;
            (node, &self.position[first..end])
        })
    }

    /// Whether the counts are those of the points.
    pub(crate) fn is_whole(&self) -> bool {
        let points: u64 = self.count.iter().map(|&count| u64::from(count)).sum();
        self.node.len() == self.count.len() && points == self.position.len() as u64
    }
}

/// Rounds, to keep logs and pages short.
pub(crate) fn centimetres(metres: f32) -> f32 {
    (metres * 100.0).round() / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_runs_keep_an_even_part_of_the_points() {
        let mut log = MovingLog::default();
        assert!(log.is_whole());
        // Scans of 0 to 12 points; x is the number of the point, y that of the scan.
        let mut total = 0u32;
        for node in 0..100_000u64 {
            let first = total;
            total += node as u32 % 13;
            log.push(node, (first..total).map(|i| [i as f32, node as f32, 0.0]));
        }
        assert!(log.is_whole() && log.total == u64::from(total) && (MOST_POINTS / 2..=MOST_POINTS).contains(&log.position.len()));
        assert_eq!(log.every, 8);
        let kept: Vec<f32> = log.position.iter().map(|p| p[0]).collect();
        assert_eq!(kept, (0..total).step_by(8).map(|i| i as f32).collect::<Vec<_>>());
        assert!(log.scans().all(|(node, points)| !points.is_empty() && points.iter().all(|p| p[1] == node as f32)));
    }

    #[test]
    fn few_points_are_all_kept_to_centimetres() {
        let mut log = MovingLog::default();
        log.push(3, [[1.234, -0.006, 2.0]]);
        log.push(4, []);
        log.push(7, [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]);
        let scans: Vec<(u64, Vec<[f32; 3]>)> = log.scans().map(|(node, points)| (node, points.to_vec())).collect();
        assert_eq!(scans, [(3, vec![[1.23, -0.01, 2.0]]), (7, vec![[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]])]);
        assert_eq!((log.total, log.every), (3, 1));
    }
}
