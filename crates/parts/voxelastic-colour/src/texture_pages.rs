//! Which triangles of a mesh share an image of its texture.
//!
//! A large mesh needs more texels than fit into one image, and than are painted at once. So it is cut, at the middle of its longest side and again, until each part has
//! few enough: triangles of a part lie together, and cameras that are far from it need not be looked at.

use crate::painter::Surface;
use crate::texture::patch_for;

/// The triangles of each image of the texture, by their numbers, ascending, for texels about `texel` metres apart and at most `most` texels an image, more only if a single
/// triangle has more. A mesh that fits into one image has one.
pub fn texture_pages(surface: &Surface<'_>, texel: f32, most: usize) -> Vec<Vec<u32>> {
    let texels: Vec<usize> = surface.triangles.iter().map(|t| patch_for(surface, t, texel).texels()).collect();
    let middle = |t: u32| -> [f32; 3] {
        let corners = surface.triangles[t as usize].map(|v| surface.positions[v as usize]);
        std::array::from_fn(|k| (corners[0][k] + corners[1][k] + corners[2][k]) / 3.0)
    };
    let mut parts = vec![(0..surface.triangles.len() as u32).collect::<Vec<u32>>()];
    let mut pages = Vec::new();
    while let Some(mut part) = parts.pop() {
        let count: usize = part.iter().map(|t| texels[*t as usize]).sum();
        if count <= most || part.len() < 2 {
            part.sort_unstable();
            pages.push(part);
            continue;
        }
        let extreme =
            |pick: fn(f32, f32) -> f32| part.iter().map(|t| middle(*t)).reduce(|a, b| std::array::from_fn(|k| pick(a[k], b[k]))).unwrap_or_default();
        let (low, high) = (extreme(f32::min), extreme(f32::max));
        let axis = (0..3).max_by(|&a, &b| (high[a] - low[a]).total_cmp(&(high[b] - low[b]))).unwrap_or(0);
        let half = part.len() / 2;
        part.select_nth_unstable_by(half, |&a, &b| middle(a)[axis].total_cmp(&middle(b)[axis]).then(a.cmp(&b)));
        let second = part.split_off(half);
        // The first half comes next.
        parts.extend([second, part]);
    }
    pages
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn each_triangle_is_in_one_page_and_pages_are_small(places in prop::collection::vec(prop::array::uniform3(-50f32..50.0), 1..300), most in 20usize..2000) {
            let positions: Vec<[f32; 3]> = places.iter().flat_map(|p| [*p, [p[0] + 0.3, p[1], p[2]], [p[0], p[1] + 0.3, p[2]]]).collect();
            let triangles: Vec<[u32; 3]> = (0..places.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
            let normals = vec![[0.0, 0.0, 1.0]; positions.len()];
            let surface = Surface { positions: &positions, normals: &normals, triangles: &triangles };
            let pages = texture_pages(&surface, 0.1, most);
            let mut all = pages.concat();
            all.sort_unstable();
            prop_assert!(all.into_iter().eq(0..triangles.len() as u32));
            // 36 texels each.
            prop_assert!(pages.iter().all(|page| page.is_sorted() && (page.len() * 36 <= most || page.len() == 1)));
            prop_assert!(pages.len() <= 1 + 4 * triangles.len() * 36 / most.min(triangles.len() * 36).max(1));
        }
    }

    #[test]
    fn pages_lie_apart() {
        // Two groups of triangles, mixed in order.
        let positions: Vec<[f32; 3]> = (0..60)
            .flat_map(|t| {
                let x = if t % 2 == 0 { 0.0 } else { 100.0 };
                [[x, 0.01 * t as f32, 0.0], [x + 0.3, 0.01 * t as f32, 0.0], [x, 0.01 * t as f32 + 0.3, 0.0]]
            })
            .collect();
        let triangles: Vec<[u32; 3]> = (0..60).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let surface = Surface { positions: &positions, normals: &[[0.0, 0.0, 1.0]; 180], triangles: &triangles };
        let pages = texture_pages(&surface, 0.1, 30 * 36);
        assert_eq!(pages, [(0..60).step_by(2).collect::<Vec<u32>>(), (1..60).step_by(2).collect()]);
        assert_eq!(texture_pages(&surface, 0.1, 1 << 22), [(0..60).collect::<Vec<u32>>()]);
        assert_eq!(texture_pages(&Surface { triangles: &[], ..surface }, 0.1, 9), [[0u32; 0]]);
    }
}
