//! The one surface of a map in parts that move with its submaps, so that a page can show how corrections bent the map.

use crate::surface::{RootPose, Surface};
use hashbrown::HashMap;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// The parts of `whole` that move with each of some submaps, in their frames.
pub(crate) fn split(whole: &Surface, submaps: &[Surface]) -> Vec<Surface> {
    let numbers: HashMap<u32, usize> = submaps.iter().enumerate().map(|(number, submap)| (submap.submap, number)).collect();
    let mut triangles = vec![Vec::new(); submaps.len()];
    for t in &whole.triangles {
        // A triangle at a border moves with its first corner.
        if let Some(&number) = numbers.get(&whole.carriers[t[0] as usize]) {
            triangles[number].push(*t);
        }
    }
    submaps.par_iter().zip(triangles).map(|(submap, triangles)| part_of(whole, submap, &triangles)).collect()
}

/// Some triangles of `whole` in the frame of a submap.
fn part_of(whole: &Surface, submap: &Surface, triangles: &[[u32; 3]]) -> Surface {
    let mut part = Surface { submap: submap.submap, colour: submap.colour, pose: submap.pose, first_pose: submap.first_pose, ..Surface::default() };
    let t_submap_map = isometry(&submap.pose).inverse();
    let mut numbers: HashMap<u32, u32> = HashMap::with_capacity(triangles.len());
    for t in triangles {
        let corners = t.map(|v| {
            *numbers.entry(v).or_insert_with(|| {
                append(&mut part, whole, v as usize, &t_submap_map);
                part.positions.len() as u32 - 1
            })
        });
        part.triangles.push(corners);
    }
    part
}

fn append(part: &mut Surface, whole: &Surface, v: usize, t_submap_map: &Isometry3<f64>) {
    let (position, normal) = (whole.positions[v].map(f64::from), whole.normals[v].map(f64::from));
    part.positions.push(<[f64; 3]>::from((t_submap_map * Point3::from(position)).coords).map(|c| c as f32));
    part.normals.push(<[f64; 3]>::from(t_submap_map * Vector3::from(normal)).map(|c| c as f32));
    part.intensities.extend(whole.intensities.get(v));
    part.colours.extend(whole.colours.get(v));
    part.scales.extend(whole.scales.get(v));
    part.errors.extend(whole.errors.get(v));
}

fn isometry(&RootPose([x, y, z, qx, qy, qz, qw]): &RootPose) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(Quaternion::new(qw, qx, qy, qz)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decimate::tests::slab;

    #[test]
    fn parts_together_are_the_whole() {
        let mut whole = slab(10);
        whole.carriers = whole.positions.iter().map(|p| if p[0] < 0.45 { 7 } else { 3 }).collect();
        // The second submap is turned by 90 degrees around z, and lies elsewhere.
        let half = 0.5f64.sqrt();
        let turned = Surface { submap: 3, pose: RootPose([2.0, 1.0, -0.5, 0.0, 0.0, half, half]), ..Surface::default() };
        let parts = split(&whole, &[turned, Surface { submap: 7, ..Surface::default() }]);
        assert_eq!(
            parts.iter().map(|part| (part.submap, part.triangles.len())).collect::<Vec<_>>(),
            [(3, 200), (7, 200)],
            "five of ten columns each"
        );
        let mut all: Vec<[[i32; 3]; 3]> = Vec::new();
        for (part, is_turned) in parts.iter().zip([true, false]) {
            assert!(part.check(0).is_ok() && part.errors.len() == part.positions.len() && part.colours.len() == part.positions.len());
            let to_map = |p: [f32; 3]| if is_turned { [2.0 - p[1], 1.0 + p[0], p[2] - 0.5] } else { p };
            let rounded = |p: [f32; 3]| p.map(|c| (c * 1e3).round() as i32);
            all.extend(part.triangles.iter().map(|t| t.map(|v| rounded(to_map(part.positions[v as usize])))));
            assert!(part.normals.iter().all(|n| n[2].abs() == 1.0));
        }
        let mut expected: Vec<[[i32; 3]; 3]> =
            whole.triangles.iter().map(|t| t.map(|v| whole.positions[v as usize].map(|c| (c * 1e3).round() as i32))).collect();
        all.sort_unstable();
        expected.sort_unstable();
        assert_eq!(all, expected);
    }
}
