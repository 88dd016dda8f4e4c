//! Decimation of a mesh by vertex clustering: vertices in one cell of a grid that face the same direction become one, with averaged attributes.
//!
//! The mapping library has levels of detail of its own (`voxelastic::surface`). They cannot serve here: they are made during extraction on grids of
//! powers of two of the voxel, whereas a page has a limit of vertices over all submaps; they merge the two sides of thin walls, which a viewer sees;
//! and a page's vertices carry errors, which must be averaged, too.

use crate::surface::Surface;
use hashbrown::HashMap;

/// Sums over the vertices of a cluster.
#[derive(Clone, Copy, Default)]
struct Sum {
    count: u32,
    position: [f64; 3],
    normal: [f32; 3],
    intensity: u32,
    colour: [u32; 3],
    scale: u32,
    /// Of its first vertex.
    carrier: u32,
    error: f64,
    error_count: u32,
}

/// The surface with about the share `keep` of its vertices; unchanged for 1 and more. Vertices that are not finite are removed with their triangles.
pub(crate) fn decimate(surface: &Surface, keep: f64) -> Surface {
    let finite = surface.positions.iter().all(|p| p.iter().all(|c| c.is_finite()));
    if keep >= 1.0 && finite {
        return surface.clone();
    }
    let edge = mean_edge(surface);
    if keep >= 1.0 || edge == 0.0 {
        return clustered(surface, edge.max(1e-4) * 1e-3);
    }
    // Cells of twice the edge leave about a quarter of the vertices. The estimate is corrected once by its result.
    let target = keep * surface.positions.len() as f64;
    let guess = edge * (1.0 / keep).sqrt() as f32;
    let first = clustered(surface, guess);
    let ratio = first.positions.len() as f64 / target;
    if (0.75..=1.1).contains(&ratio) { first } else { clustered(surface, guess * ratio.sqrt() as f32) }
}

/// Mean length of the edges of a sample of triangles, metres.
fn mean_edge(surface: &Surface) -> f32 {
    let sample = surface.triangles.iter().step_by(surface.triangles.len() / 10_000 + 1);
    let lengths = sample.map(|t| {
        let [a, b] = [t[0], t[1]].map(|v| surface.positions[v as usize]);
        (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt()
    });
    let finite: Vec<f32> = lengths.filter(|l| l.is_finite()).collect();
    if finite.is_empty() { 0.0 } else { finite.iter().sum::<f32>() / finite.len() as f32 }
}

/// One vertex per cell of `cell` metres and main direction of the normal, so that the two sides of a thin wall stay apart.
fn clustered(surface: &Surface, cell: f32) -> Surface {
    let mut clusters = Clusters::default();
    let mut sums: Vec<Sum> = Vec::new();
    let cluster_of: Vec<Option<u32>> = (0..surface.positions.len())
        .map(|v| {
            let p = surface.positions[v];
            if !p.iter().all(|c| c.is_finite()) {
                return None;
            }
            let cluster = clusters.get_or_add(p.map(|c| (c / cell).floor() as i32), facing(surface.normals[v]));
            if cluster as usize == sums.len() {
                sums.push(Sum::default());
            }
            add(&mut sums[cluster as usize], surface, v);
            Some(cluster)
        })
        .collect();
    let mut triangles = Vec::with_capacity(surface.triangles.len() / 2);
    for t in &surface.triangles {
        if let [Some(a), Some(b), Some(c)] = t.map(|v| cluster_of[v as usize])
            && a != b
            && b != c
            && c != a
        {
            // The smallest corner first, so that equal triangles have equal corners.
            let least = a.min(b).min(c);
            triangles.push(if least == a {
                [a, b, c]
            } else if least == b {
                [b, c, a]
            } else {
                [c, a, b]
            });
        }
    }
    triangles.sort_unstable();
    triangles.dedup();
    means(surface, &sums, triangles)
}

/// Edge of a block of cells, as an exponent of two.
const BLOCK_BITS: u32 = 6;

/// Numbers of clusters, in order of their first vertices. Vertices come tile by tile, so that few blocks are used at a time: one table for all cells would be in use
/// everywhere all the time, which is slow if memory is limited.
#[derive(Default)]
struct Clusters {
    /// By block, and by cell of the block and direction.
    blocks: HashMap<[i32; 3], HashMap<u32, u32>>,
    count: u32,
}

impl Clusters {
    /// The cluster of a cell and a direction, 0 to 5; the next number if it has none yet.
    fn get_or_add(&mut self, cell: [i32; 3], facing: u8) -> u32 {
        let block = self.blocks.entry(cell.map(|c| c >> BLOCK_BITS)).or_default();
        let within = cell.map(|c| c as u32 & ((1 << BLOCK_BITS) - 1));
        let key = within.into_iter().fold(u32::from(facing), |key, c| key << BLOCK_BITS | c);
        *block.entry(key).or_insert_with(|| {
            self.count += 1;
            self.count - 1
        })
    }
}

/// The axis that a normal is nearest to, and its sign: 0 to 5.
fn facing(n: [f32; 3]) -> u8 {
    let axis = (0..3).max_by(|&a, &b| n[a].abs().total_cmp(&n[b].abs())).unwrap_or(2);
    axis as u8 * 2 + u8::from(n[axis] < 0.0)
}

fn add(sum: &mut Sum, surface: &Surface, v: usize) {
    if sum.count == 0 {
        sum.carrier = surface.carriers.get(v).copied().unwrap_or_default();
    }
    sum.count += 1;
    (0..3).for_each(|k| sum.position[k] += f64::from(surface.positions[v][k]));
    (0..3).for_each(|k| sum.normal[k] += surface.normals[v][k]);
    sum.intensity += surface.intensities.get(v).copied().map_or(0, u32::from);
    (0..3).for_each(|k| sum.colour[k] += surface.colours.get(v).map_or(0, |c| u32::from(c[k])));
    sum.scale += surface.scales.get(v).copied().map_or(0, u32::from);
    if let Some(error) = surface.errors.get(v).filter(|e| e.is_finite()) {
        sum.error += f64::from(error.abs());
        sum.error_count += 1;
    }
}

fn means(surface: &Surface, sums: &[Sum], triangles: Vec<[u32; 3]>) -> Surface {
    let unit = |n: [f32; 3]| {
        let length = n.iter().map(|c| c * c).sum::<f32>().sqrt();
        if length > 0.0 { n.map(|c| c / length) } else { [0.0, 0.0, 1.0] }
    };
    let rounded = |total: u32, count: u32| ((total + count / 2) / count.max(1)) as u8;
    let of = |wanted: bool, f: &dyn Fn(&Sum) -> u8| if wanted { sums.iter().map(f).collect() } else { Vec::new() };
    let colours = sums.iter().map(|s| s.colour.map(|c| rounded(c, s.count)));
    Surface {
        positions: sums.iter().map(|s| s.position.map(|c| (c / f64::from(s.count)) as f32)).collect(),
        normals: sums.iter().map(|s| unit(s.normal)).collect(),
        intensities: of(!surface.intensities.is_empty(), &|s| rounded(s.intensity, s.count)),
        colours: if surface.colours.is_empty() { Vec::new() } else { colours.collect() },
        scales: of(!surface.scales.is_empty(), &|s| rounded(s.scale, s.count)),
        errors: if surface.errors.is_empty() {
            Vec::new()
        } else {
            sums.iter().map(|s| if s.error_count == 0 { f32::NAN } else { (s.error / f64::from(s.error_count)) as f32 }).collect()
        },
        carriers: if surface.carriers.is_empty() { Vec::new() } else { sums.iter().map(|s| s.carrier).collect() },
        triangles,
        submap: surface.submap,
        colour: surface.colour,
        pose: surface.pose,
        first_pose: surface.first_pose,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A slab of `n` by `n` squares of 0.1 m with a top and, 2 cm below, a bottom.
    pub(crate) fn slab(n: u32) -> Surface {
        let mut s = Surface::default();
        for (z, up) in [(0.0, 1.0f32), (-0.02, -1.0)] {
            let first = s.positions.len() as u32;
            for i in 0..(n + 1) * (n + 1) {
                s.positions.push([(i % (n + 1)) as f32 * 0.1, (i / (n + 1)) as f32 * 0.1, z]);
                s.normals.push([0.0, 0.0, up]);
                s.intensities.push((i % 256) as u8);
                s.colours.push([200, 100, (i % 7) as u8]);
                s.errors.push(0.01 * up);
            }
            for i in 0..n * n {
                let a = first + i / n * (n + 1) + i % n;
                s.triangles.extend([[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]);
            }
        }
        s
    }

    #[test]
    fn decimated_slab_keeps_its_sides_area_and_errors() {
        let fine = slab(100);
        let decimated = decimate(&fine, 0.2);
        let share = decimated.positions.len() as f64 / fine.positions.len() as f64;
        assert!((0.12..0.25).contains(&share), "{share}");
        assert!(decimated.positions.iter().all(|p| p[2] == 0.0 || (p[2] + 0.02).abs() < 1e-6), "no vertex between the sides");
        assert!(decimated.errors.iter().all(|e| (e - 0.01).abs() < 1e-6));
        assert!(decimated.colours.len() == decimated.positions.len() && decimated.colours.iter().all(|c| c[..2] == [200, 100] && c[2] < 7));
        let area: f32 = decimated
            .triangles
            .iter()
            .map(|t| t.map(|v| decimated.positions[v as usize]))
            .map(|[a, b, c]| 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs())
            .sum();
        assert!((area - 200.0).abs() < 8.0, "{area}");
    }

    #[test]
    fn cells_and_directions_have_clusters_of_their_own() {
        let mut clusters = Clusters::default();
        let mut expected: HashMap<([i32; 3], u8), u32> = HashMap::new();
        // Cells on both sides of zero and of the borders of blocks, in an order of no kind, and all of them twice.
        for i in (0..20_000u32).map(|i| i.wrapping_mul(2_654_435_761)).chain((0..20_000).map(|i: u32| i.wrapping_mul(2_654_435_761))) {
            let cell = [i % 151, i / 151 % 7, i / 1057 % 140].map(|c| c as i32 - 75);
            let facing = (i / 200_000 % 6) as u8;
            let next = expected.len() as u32;
            assert_eq!(clusters.get_or_add(cell, facing), *expected.entry((cell, facing)).or_insert(next));
        }
        assert!(clusters.count as usize == expected.len() && clusters.count > 10_000);
    }

    #[test]
    fn unreduced_meshes_are_unchanged_except_for_vertices_that_are_not_finite() {
        let mut s = slab(3);
        assert_eq!(decimate(&s, 1.0), s);
        s.positions[0] = [f32::NAN; 3];
        let decimated = decimate(&s, 1.0);
        assert_eq!((decimated.positions.len(), decimated.triangles.len()), (31, 34));
        assert!(decimate(&Surface::default(), 0.5).positions.is_empty());
    }
}
