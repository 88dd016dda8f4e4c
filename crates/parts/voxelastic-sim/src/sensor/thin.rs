//! Thinned clouds, as SLAM systems keep them.

use hashbrown::HashMap;
use voxelastic::Cloud;

/// Replaces the returns in each cube of `cell` metres by their mean, as a voxel filter does: an unorganised cloud without rings, in the order of the cubes. `labels` holds a label of each
/// point, if there are any; the largest of a cube stays.
pub(crate) fn thin(cloud: &Cloud, labels: &mut Vec<u8>, cell: f64) -> Cloud {
    let mut index: HashMap<[i32; 3], usize> = HashMap::new();
    let mut sums: Vec<([i32; 3], Sum)> = Vec::new();
    for (i, p) in cloud.points.iter().enumerate().filter(|(_, p)| Cloud::is_return(p)) {
        let key = p.map(|c| (f64::from(c) / cell).floor() as i32);
        let at = *index.entry(key).or_insert_with(|| {
            sums.push((key, Sum::default()));
            sums.len() - 1
        });
        let sum = &mut sums[at].1;
        (0..3).for_each(|k| sum.point[k] += f64::from(p[k]));
        sum.intensity += cloud.intensity.as_ref().map_or(0.0, |v| f64::from(v[i]));
        sum.time += cloud.time.as_ref().map_or(0.0, |v| f64::from(v[i]));
        sum.count += 1.0;
        sum.label = sum.label.max(labels.get(i).copied().unwrap_or(0));
    }
    sums.sort_unstable_by_key(|(key, _)| [key[2], key[1], key[0]]);
    if !labels.is_empty() {
        *labels = sums.iter().map(|(_, sum)| sum.label).collect();
    }
    let mean = |value: fn(&Sum) -> f64| sums.iter().map(|(_, sum)| (value(sum) / sum.count) as f32).collect::<Vec<f32>>();
    let mut thinned = Cloud::from_points(sums.iter().map(|(_, sum)| sum.point.map(|c| (c / sum.count) as f32)).collect());
    thinned.intensity = cloud.intensity.as_ref().map(|_| mean(|sum| sum.intensity));
    thinned.time = cloud.time.as_ref().map(|_| mean(|sum| sum.time));
    thinned
}

/// Sums over the returns in a cube.
#[derive(Clone, Copy, Default)]
struct Sum {
    point: [f64; 3],
    intensity: f64,
    time: f64,
    count: f64,
    label: u8,
}

/// The returns only, as an unorganised cloud without rings; `labels` loses the same points.
pub(crate) fn returns_only(cloud: &Cloud, labels: &mut Vec<u8>) -> Cloud {
    let kept: Vec<usize> = (0..cloud.len()).filter(|&i| Cloud::is_return(&cloud.points[i])).collect();
    if !labels.is_empty() {
        *labels = kept.iter().map(|&i| labels[i]).collect();
    }
    let pick = |values: &Option<Vec<f32>>| values.as_ref().map(|v| kept.iter().map(|&i| v[i]).collect());
    Cloud { intensity: pick(&cloud.intensity), time: pick(&cloud.time), ..Cloud::from_points(kept.iter().map(|&i| cloud.points[i]).collect()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cube_keeps_the_mean_of_its_returns() {
        let points = vec![[0.1, 0.1, 0.1], [f32::NAN; 3], [0.9, 0.2, 0.1], [0.3, 0.1, 0.3], [-0.1, 0.1, 0.1]];
        let cloud = Cloud { intensity: Some(vec![1.0, 0.0, 5.0, 3.0, 7.0]), ..Cloud::from_points(points) };
        let mut labels = vec![0, 0, 2, 1, 0];
        let thinned = thin(&cloud, &mut labels, 0.5);
        assert_eq!((thinned.len(), thinned.width, labels), (3, 3, vec![0, 1, 2]));
        assert!((thinned.points[1][0] - 0.2).abs() < 1e-6 && thinned.intensity.as_ref().is_some_and(|v| v[1] == 2.0));
        let mut labels = vec![0, 9, 2, 1, 0];
        let kept = returns_only(&cloud, &mut labels);
        assert_eq!((kept.len(), labels, kept.intensity), (4, vec![0, 2, 1, 0], Some(vec![1.0, 5.0, 3.0, 7.0])));
    }
}
