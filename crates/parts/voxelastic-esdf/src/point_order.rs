//! An order of many points in which those near each other follow each other, so that what is looked up for them stays in the processor's caches.

/// Fewer points than this are taken as they come.
const FEW: usize = 1 << 14;
/// Cells along each axis of the box around the points.
const CELLS: usize = 16;

/// Numbers of the points, cell by cell of the box around them; none for few points, or more than can be numbered.
pub(crate) fn by_cells<T: Copy + Into<f64>>(points: &[[T; 3]]) -> Option<Vec<u32>> {
    if points.len() < FEW || u32::try_from(points.len()).is_err() {
        return None;
    }
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for p in points {
        // Not what is not a number.
        (0..3).for_each(|k| (low[k], high[k]) = (low[k].min(p[k].into()), high[k].max(p[k].into())));
    }
    let scale: [f64; 3] = std::array::from_fn(|k| CELLS as f64 / (high[k] - low[k]).max(1e-9));
    let cell = |p: &[T; 3]| (0..3).fold(0, |cell, k| cell * CELLS + (((p[k].into() - low[k]) * scale[k]) as usize).min(CELLS - 1));
    let cells: Vec<u16> = points.iter().map(|p| cell(p) as u16).collect();
    // Where each cell's points begin, then where its next one goes.
    let mut next = vec![0u32; CELLS.pow(3) + 1];
    cells.iter().for_each(|cell| next[usize::from(*cell) + 1] += 1);
    (1..next.len()).for_each(|i| next[i] += next[i - 1]);
    let mut order = vec![0; points.len()];
    for (i, cell) in (0..).zip(cells) {
        let place = &mut next[usize::from(cell)];
        order[*place as usize] = i;
        *place += 1;
    }
    Some(order)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_is_there_once_and_neighbours_follow_each_other() {
        assert!(by_cells(&[[0.0f64; 3]; FEW - 1]).is_none());
        let share = |i: usize, step: f64| (i as f64 * step).fract();
        let mut points: Vec<[f64; 3]> = (0..FEW).map(|i| [share(i, 0.7549) * 90.0, -20.0 + share(i, 0.5698), share(i, 0.4302)]).collect();
        let apart =
            |order: &[u32], points: &[[f64; 3]]| order.windows(2).map(|w| (points[w[0] as usize][0] - points[w[1] as usize][0]).abs()).sum::<f64>();
        let order = by_cells(&points).unwrap();
        let as_they_come: Vec<u32> = (0..FEW as u32).collect();
        assert!(apart(&order, &points) < 0.2 * apart(&as_they_come, &points));
        points[7] = [f64::NAN, f64::INFINITY, 1e300];
        let mut order = by_cells(&points).unwrap();
        order.sort_unstable();
        assert_eq!(order, as_they_come);
    }
}
