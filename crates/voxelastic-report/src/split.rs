//! The one surface of a map in parts that move with its submaps, so that a page can show how corrections bent the map.

use crate::surface::{RootPose, Surface};

/// The parts of `whole` that move with each of some submaps, in their frames.
pub(crate) fn split(whole: &Surface, submaps: &[&Surface]) -> Vec<Surface> {
    let number = |id: u32| submaps.iter().position(|submap| submap.submap == id);
    let mut parts: Vec<(Surface, Vec<u32>)> = submaps.iter().map(|submap| (frame_of(submap), vec![u32::MAX; whole.positions.len()])).collect();
    for t in &whole.triangles {
        // A triangle at a border moves with its first corner.
        let Some((part, numbers)) = number(whole.carriers[t[0] as usize]).map(|n| &mut parts[n]) else { continue };
        let corners = t.map(|v| {
            let new = &mut numbers[v as usize];
            if *new == u32::MAX {
                *new = part.positions.len() as u32;
                append(part, whole, v as usize);
            }
            *new
        });
        part.triangles.push(corners);
    }
    parts.into_iter().map(|(part, _)| part).collect()
}

/// A submap without a surface.
fn frame_of(submap: &Surface) -> Surface {
    Surface { submap: submap.submap, colour: submap.colour, pose: submap.pose, first_pose: submap.first_pose, ..Surface::default() }
}

fn append(part: &mut Surface, whole: &Surface, v: usize) {
    let RootPose([x, y, z, ..]) = part.pose;
    let at = whole.positions[v].map(f64::from);
    part.positions.push(turned_back(&part.pose, [at[0] - x, at[1] - y, at[2] - z]));
    part.normals.push(turned_back(&part.pose, whole.normals[v].map(f64::from)));
    part.intensities.extend(whole.intensities.get(v));
    part.colours.extend(whole.colours.get(v));
    part.scales.extend(whole.scales.get(v));
    part.errors.extend(whole.errors.get(v));
}

/// A vector of the map frame in the frame at `pose`.
fn turned_back(RootPose([.., qx, qy, qz, qw]): &RootPose, v: [f64; 3]) -> [f32; 3] {
    let (u, w) = ([-qx, -qy, -qz], *qw);
    let cross = |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let t = cross(u, v).map(|c| 2.0 * c);
    let turn = cross(u, t);
    std::array::from_fn(|k| (v[k] + w * t[k] + turn[k]) as f32)
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
        let parts = split(&whole, &[&turned, &Surface { submap: 7, ..Surface::default() }]);
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
